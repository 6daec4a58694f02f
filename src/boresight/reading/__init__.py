"""Reading recordings: the file's content, not its name, tells what it is."""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from ..errors import InputError
from ..model import Recording

__all__ = ["is_asterix", "read", "sha256_of"]

_HEAD = 1 << 16
# A column map of its own lies beside a table, under its name with this behind it.
_MAP = ".map.toml"
# How packed files begin, what they are, and how to unpack them.
_PACKED = (
    (b"\x1f\x8b", "packed with gzip", "gunzip"),
    (b"PK\x03\x04", "a zip archive", "unzip"),
    (b"BZh", "packed with bzip2", "bunzip2"),
    (b"\xfd7zXZ\x00", "packed with xz", "unxz"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", "7z x"),
    (b"\x28\xb5\x2f\xfd", "packed with Zstandard", "unzstd"),
)


def read(
    path: str | Path,
    *,
    editions: Mapping[int, str] | None = None,
    date: datetime.date | None = None,
    columns: str | Path | None = None,
    categories: Collection[int] | None = None,
    sources: Collection[int] | None = None,
) -> Recording:
    """Read a recording: its plots, fixes, tracks, own ship, sources, damage and warnings.

    ASTERIX (raw data blocks, packet captures, final-format and GPS-stamped files), NMEA 0183 with AIS, RTKLIB solutions, OpenSky
    state vectors, CSV and Parquet tables, and the Autoferry benchmark (a file or a scenario's folder) are told apart by what is
    in them.  `editions` names the edition of an ASTERIX category (``{21: "0.23"}``; inferred where it is not given), `date` is
    the UTC date of the first record of a file that tells only times of day, `columns` the column map (TOML) of a table; where
    none is given, the one that lies beside the table under its name and ``.map.toml`` counts, and is said in the warnings.
    `categories` and `sources` (``sac << 8 | sic``) choose records of ASTERIX.

    Raises InputError for a file that cannot be used, with what to do about it.
    """
    from .asterix import read_asterix
    from .nmea import looks_like_nmea, read_nmea
    from .reference import (
        looks_like_autoferry,
        looks_like_opensky,
        looks_like_rtklib,
        read_autoferry,
        read_opensky,
        read_rtklib,
    )
    from .tables import looks_like_table, read_table

    beside = Path(f"{path}{_MAP}")
    if columns is not None:
        _head(path)
        return read_table(path, columns, date=date)
    if Path(path).is_dir() and list(Path(path).glob("*_detections.json")):
        return read_autoferry(path)
    head = _head(path)
    if beside.is_file():
        found = read_table(path, beside, date=date)
        return replace(found, warnings=(f"its columns are read as {beside} says", *found.warnings))
    if looks_like_autoferry(head):
        return read_autoferry(path)
    if looks_like_rtklib(head):
        return read_rtklib(path, date=date)
    if looks_like_nmea(head):
        return read_nmea(path, date=date)
    if looks_like_opensky(head):
        return read_opensky(path)
    if looks_like_table(head):
        return read_table(path, date=date)
    return read_asterix(path, editions=editions, date=date, categories=categories, sources=sources)


def is_asterix(path: str | Path) -> bool:
    """Whether `read` would take a file for ASTERIX: it is none of the other formats.  Raises InputError as it does."""
    from .nmea import looks_like_nmea
    from .reference import looks_like_autoferry, looks_like_opensky, looks_like_rtklib
    from .tables import looks_like_table

    if Path(path).is_dir() or Path(f"{path}{_MAP}").is_file():
        return False
    head = _head(path)
    others = (looks_like_autoferry, looks_like_rtklib, looks_like_nmea, looks_like_opensky, looks_like_table)
    return not any(looks_like(head) for looks_like in others)


def _head(path: str | Path) -> bytes:
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
    except IsADirectoryError as error:
        raise InputError("is a folder, not a recording", path=path, remedy="Name the files in it.") from error
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=path) from error
    for begin, what, how in _PACKED:
        if head.startswith(begin):
            raise InputError(f"this is {what}", path=path, remedy=f"Unpack it first ({how}), and give what is in it.")
    return head


def sha256_of(path: str | Path) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal: it says which input a result was made from.

    Raises InputError where the file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=path) from error
