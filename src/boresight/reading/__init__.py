"""Reading recordings: the file's content, not its name, tells what it is."""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Mapping
from pathlib import Path

from ..model import Recording

__all__ = ["read", "sha256_of"]


def read(path: str | Path, *, editions: Mapping[int, str] | None = None, date: datetime.date | None = None) -> Recording:
    """Read a recording: its plots, fixes, sources, damage and warnings.

    `editions` names the edition of an ASTERIX category (``{21: "0.23"}``; inferred where it is not given), `date` is the UTC date
    of the first record of a file that tells only times of day.  Raises InputError for a file that cannot be used, with what to
    do about it.
    """
    from .asterix import read_asterix

    return read_asterix(path, editions=editions, date=date)


def sha256_of(path: str | Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal: it says which input a result was made from.

    Raises InputError where the file cannot be read.
    """
    from ..errors import InputError

    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=path) from error
