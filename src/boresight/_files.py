"""Files written beside their place and renamed, so that none is ever half there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


def check_place(target: Path) -> None:
    """Raise InputError where `target` cannot become a file: it is a folder, or its own folder does not exist."""
    if target.is_dir():
        raise InputError("is a folder, not a file", path=target, remedy="Give the name of a file to write.")
    if not target.parent.is_dir():
        raise InputError(f"the folder {target.parent} does not exist", path=target, remedy="Make it first, or write elsewhere.")


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path` to write to, and rename it to `path` when all went well.

    On any exception (Ctrl-C too) the temporary file is removed and what stood at `path` before stays as it was.  A full disk,
    a missing folder or a forbidden one raises InputError with the path and the remedy.
    """
    target = Path(path)
    check_place(target)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield beside
        os.replace(beside, target)
    except OSError as error:
        beside.unlink(missing_ok=True)
        why = error.strerror or str(error)
        raise InputError(
            f"cannot be written ({why})", path=target, remedy="Nothing was changed; free some space or write elsewhere."
        ) from error
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` as a whole or not at all.  Raises InputError as `atomic` does."""
    with atomic(path) as beside, open(beside, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def write_text(path: str | Path, text: str) -> None:
    """Write `text` (UTF-8) to `path` as a whole or not at all.  Raises InputError as `atomic` does."""
    write_bytes(path, text.encode())
