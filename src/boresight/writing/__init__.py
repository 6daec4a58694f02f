"""Writing: ASTERIX bytes, tables, and what maps and ships read.  Every file is whole or not there."""

from .._files import atomic, write_bytes, write_text

__all__ = ["atomic", "write_bytes", "write_text"]
