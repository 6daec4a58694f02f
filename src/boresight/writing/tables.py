"""Tables to Parquet or CSV, in the units that people read: degrees, UTC timestamps, hexadecimal addresses, octal codes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._types import AnyArray
from ..errors import InputError
from ..model import Channel, unpack_callsigns
from . import atomic

# Integer columns in which -1 says "absent"; they come out empty there.
_IDENTITIES = ("sensor", "source", "mode_s", "mode_3a", "callsign", "mmsi", "track", "target", "plot", "record")


def write_table(path: str | Path, table: Any) -> int:
    """Write a table as Parquet or CSV, as the ending of `path` says, and return its number of rows.

    `table` is a `Plots`, `Fixes`, `Pairs`, another dataclass of arrays, or a mapping of names to arrays of one length.
    Columns are renamed with their unit: `…_rad` becomes `…_deg`; `time_s` becomes `time`, a UTC timestamp (microseconds; ISO
    8601 in CSV).  `mode_s` is six hexadecimal digits, `mode_3a` four octal ones, `callsign` and `channel` are words.  NaN and
    the -1 of identities are empty.  (n, k) columns become `name_0` … `name_k-1`.  The same table gives the same bytes.

    Raises InputError for another ending, for columns of unequal length, and where the file cannot be written.
    """
    import duckdb

    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".parquet", ".csv"):
        raise InputError(f"the ending {kind or '(none)'} is no table format", path=path, remedy="Name it .parquet or .csv.")
    columns = dict(_columns(table))
    lengths = {name: len(values) for name, values in columns.items()}
    if not columns or len(set(lengths.values())) != 1:
        raise InputError(f"a table needs columns of one length, these have {lengths}", path=path)
    source: dict[str, AnyArray] = {}
    chosen: list[str] = []
    for number, (name, values) in enumerate(columns.items()):
        inner = f"c{number}"
        source[inner], expression, outer = _outward(name, values, inner, csv=kind == ".csv")
        chosen.append(f"{expression} AS {_quoted(outer)}")
    options = "FORMAT parquet, COMPRESSION zstd" if kind == ".parquet" else "FORMAT csv, HEADER true"
    # One thread: the same table must give the same bytes.  No extension is ever fetched.
    settings: dict[str, str | bool | int | float | list[str]] = {
        "threads": 1,
        "memory_limit": "1GB",
        "autoload_known_extensions": False,
        "autoinstall_known_extensions": False,
    }
    with atomic(path) as beside, duckdb.connect(":memory:", config=settings) as connection:
        connection.register("source", source)
        try:
            connection.execute(
                f"COPY (SELECT {', '.join(chosen)} FROM source) TO '{str(beside).replace(chr(39), chr(39) * 2)}' ({options})"
            )
        except duckdb.IOException as error:
            raise OSError(str(error).splitlines()[0]) from error
    return next(iter(lengths.values()))


def _columns(table: Any) -> Iterator[tuple[str, AnyArray]]:
    """Names and one-dimensional columns of a table, in its order."""
    flat: Callable[[], Iterator[tuple[str, AnyArray]]] | None = getattr(table, "_flat", None)
    if flat is not None:
        yield from flat()
        return
    if isinstance(table, Mapping):
        items: Iterator[tuple[str, Any]] = iter(table.items())
    elif is_dataclass(table):
        items = ((f.name, getattr(table, f.name)) for f in fields(table))
    else:
        raise InputError(f"a {type(table).__name__} is no table", remedy="Give a Plots or Fixes table, or a dict of arrays.")
    for name, values in items:
        array = np.asarray(values)
        if array.ndim == 1:
            yield name, array
        else:
            rows = array.reshape(len(array), -1)
            for k in range(rows.shape[1]):
                yield f"{name}_{k}", rows[:, k]


def _outward(name: str, values: AnyArray, inner: str, *, csv: bool) -> tuple[AnyArray, str, str]:
    """The array to hand over, the SQL that turns it outward, and the column's name outside."""
    whole = values.dtype.kind in "iu"
    stem = next((known for known in _IDENTITIES if whole and (name == known or name.endswith(f"_{known}"))), None)
    values = np.ascontiguousarray(values)
    if values.dtype.kind in "US":
        return values.astype(object), inner, name
    if stem == "callsign":
        packed, back = np.unique(values, return_inverse=True)
        words = np.array([*unpack_callsigns(packed), ""], object)[:-1]
        return words[back], f"nullif({inner}, '')", name
    if stem == "mode_s":
        return values, f"CASE WHEN {inner} >= 0 THEN format('{{:06X}}', {inner}) END", name
    if stem == "mode_3a":
        return values, f"CASE WHEN {inner} >= 0 THEN format('{{:04o}}', {inner}) END", name
    if stem is not None:
        return values, f"nullif({inner}, -1)", name
    if whole and (name == "channel" or name.endswith("_channel")):
        words = np.array([channel.name.lower() for channel in Channel], object)
        return words[values], inner, name
    if name == "time_s" or name.endswith("_time_s"):
        moment = f"make_timestamp(CAST(round({inner} * 1e6) AS BIGINT))"
        return values, f"strftime({moment}, '%Y-%m-%dT%H:%M:%S.%fZ')" if csv else moment, name.removesuffix("_s")
    angle = re.fullmatch(r"(.*_)rad(_\d+)?", name)
    if angle:
        return np.degrees(values), inner, f"{angle[1]}deg{angle[2] or ''}"
    return values, inner, name


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
