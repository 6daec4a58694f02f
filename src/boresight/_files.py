"""Files written beside their place and renamed, so that none is ever half there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def together(folder: str | Path, names: Collection[str]) -> Iterator[Path]:
    """Give a place to write files to, which appear in `folder` together when all went well; `folder` is made where there is none.

    Files of these `names` that were in `folder` are kept in ``earlier-1``, ``earlier-2`` …  On any exception (Ctrl-C too) the
    folder is as it was before.  A full disk or a forbidden place raises InputError with the path and the remedy.
    """
    folder = Path(folder)
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    part = ""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".boresight-", dir=folder) as part:
            yield Path(part)
            written = sorted(Path(part).iterdir())
            keep_earlier(folder, {*names, *(path.name for path in written)})
            for path in written:
                path.rename(folder / path.name)
    except BaseException as error:
        # What somebody else has put there meanwhile stays.
        with suppress(OSError):
            for new in made:
                new.rmdir()
        if isinstance(error, InputError):
            raise InputError(str(error).replace(f"{part}/", f"{folder}/")) from error
        if not isinstance(error, OSError):
            raise
        why = error.strerror or str(error)
        raise InputError(
            f"the folder cannot be made or written to ({why})", path=folder, remedy="Nothing was changed; name another one."
        ) from error


def keep_earlier(folder: Path, names: Collection[str]) -> Path | None:
    """Move files of these names into the first free ``earlier-N``, so that no result is ever lost; None where there are none."""
    there = [folder / name for name in sorted(names) if (folder / name).exists()]
    if not there:
        return None
    number = 1
    while (folder / f"earlier-{number}").exists():
        number += 1
    kept = folder / f"earlier-{number}"
    kept.mkdir()
    for path in there:
        path.rename(kept / path.name)
    return kept
