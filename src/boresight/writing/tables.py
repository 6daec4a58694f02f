"""Tables to Parquet or CSV, in the units that people read: degrees, UTC timestamps, hexadecimal addresses, octal codes."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._types import AnyArray
from ..errors import InputError
from ..model import Channel, unpack_callsigns
from . import atomic

# Integer columns in which -1 says "absent"; they come out empty there.
_IDENTITIES = ("sensor", "source", "mode_s", "mode_3a", "callsign", "mmsi", "track", "target", "plot", "record")


def write_table(path: str | Path, table: Any, *, metadata: Mapping[str, str] | None = None) -> int:
    """Write a table as Parquet or CSV, as the ending of `path` says, and return its number of rows.

    `table` is a `Plots`, `Fixes`, `Pairs`, another dataclass of arrays, or a mapping of names to arrays of one length.
    Columns are renamed with their unit: `…_rad` becomes `…_deg`; `time_s` becomes `time`, a UTC timestamp (microseconds; ISO
    8601 in CSV).  `mode_s` is six hexadecimal digits, `mode_3a` four octal ones, `callsign` and `channel` are words.  NaN and
    the -1 of identities are empty.  (n, k) columns become `name_0` … `name_k-1`.  The same table gives the same bytes.  A Parquet
    file can hold `metadata` (key to text).

    Raises InputError for another ending, for columns of unequal length, and where the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".parquet", ".csv"):
        raise InputError(f"the ending {kind or '(none)'} is no table format", path=path, remedy="Name it .parquet or .csv.")
    with atomic(path) as beside, _connected() as connection:
        return _copy(connection, table, beside, csv=kind == ".csv", metadata=metadata)


# Rows of a piece of a long table: two row groups of Parquet, so that the file is the one that is written at once.
PIECE = 2 * 122_880


@dataclass(slots=True)
class Pieces:
    """A long table that comes part by part: `append` them, then `publish` the file, which is the one `write_table` makes.

    What has come waits in `folder`, which is the caller's to remove after `close`, in files whose names begin with `name`.  A
    piece is written while the parts of the next one come; no more than these two are in memory.
    """

    folder: Path
    name: str
    csv: bool
    rows: int = 0
    count: int = 0
    held: list[Any] = field(default_factory=list)
    waiting: int = 0
    writer: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    written: Future[None] | None = None

    def append(self, table: Any) -> None:
        """The next rows: a table of the same class as those before."""
        self.held.append(table)
        self.waiting += len(table)
        self.rows += len(table)
        if self.waiting < PIECE:
            return
        joined = type(table).concat(self.held)
        whole = self.waiting - self.waiting % PIECE
        for begin in range(0, whole, PIECE):
            self._write(joined[begin : begin + PIECE])
        self.held, self.waiting = ([joined[whole:]], self.waiting - whole) if whole < self.waiting else ([], 0)

    def publish(self, path: Path) -> None:
        """Make the file, as a whole or not at all.  Raises InputError as `atomic` does."""
        rest = type(self.held[0]).concat(self.held) if self.held else None
        self.held, self.waiting = [], 0
        if rest is not None and not self.count:
            write_table(path, rest)
            return
        if rest is not None:
            self._write(rest)
        self._wait()
        with atomic(path) as beside:
            if self.csv:
                os.replace(self.folder / f"{self.name}.csv", beside)
                return
            pieces = ", ".join(_text(self.folder / f"{self.name}-{k}.parquet") for k in range(self.count))
            with _connected() as connection:
                _run(connection, f"COPY (SELECT * FROM read_parquet([{pieces}])) TO {_text(beside)} ({_PARQUET})")

    def close(self) -> None:
        """Wait for what is being written: after this nothing more comes into the folder."""
        self.writer.shutdown(cancel_futures=True)

    def _write(self, table: Any) -> None:
        self._wait()
        self.written = self.writer.submit(self._write_piece, table, self.count)
        self.count += 1

    def _wait(self) -> None:
        """Raise what the piece that was being written met with."""
        if self.written is not None:
            self.written.result()
            self.written = None

    def _write_piece(self, table: Any, number: int) -> None:
        with _connected() as connection:
            if not self.csv:
                # Read once and thrown away: quickly rather than well compressed.
                _copy(connection, table, self.folder / f"{self.name}-{number}.parquet", compression="snappy")
                return
            piece = self.folder / f"{self.name}-piece.csv"
            _copy(connection, table, piece, csv=True, header=number == 0)
            with open(piece, "rb") as file, open(self.folder / f"{self.name}.csv", "ab") as out:
                shutil.copyfileobj(file, out, 1 << 20)


_PARQUET = "FORMAT parquet, COMPRESSION zstd"


def _connected() -> Any:
    """A database of its own.  One thread: with two, memory grows with the number of pieces.  No extension is ever fetched."""
    import duckdb

    settings: dict[str, str | bool | int | float | list[str]] = {
        "threads": 1,
        "memory_limit": "1GB",
        # What was read of a piece is not kept in memory, and nothing is ever put into the user's folder on the way.
        "enable_external_file_cache": False,
        "temp_directory": "",
        "autoload_known_extensions": False,
        "autoinstall_known_extensions": False,
    }
    return duckdb.connect(":memory:", config=settings)


def metadata_of(path: str | Path) -> dict[str, str]:
    """The metadata that `write_table` has put into a Parquet file; nothing of what is none."""
    import duckdb

    with _connected() as connection:
        try:
            rows = connection.execute(f"SELECT key, value FROM parquet_kv_metadata({_text(Path(path))})").fetchall()
        except duckdb.Error:
            return {}
    return {bytes(key).decode("utf-8", "replace"): bytes(value).decode("utf-8", "replace") for key, value in rows}


def _copy(
    connection: Any,
    table: Any,
    to: Path,
    *,
    csv: bool = False,
    header: bool = True,
    compression: str = "zstd",
    metadata: Mapping[str, str] | None = None,
) -> int:
    """Write a table to `to` and return its number of rows."""
    columns = dict(_columns(table))
    lengths = {name: len(values) for name, values in columns.items()}
    if not columns or len(set(lengths.values())) != 1:
        raise InputError(f"a table needs columns of one length, these have {lengths}", path=to)
    source: dict[str, AnyArray] = {}
    chosen: list[str] = []
    for number, (name, values) in enumerate(columns.items()):
        inner = f"c{number}"
        source[inner], expression, outer = _outward(name, values, inner, csv=csv)
        chosen.append(f"{expression} AS {_quoted(outer)}")
    options = f"FORMAT csv, HEADER {str(header).lower()}" if csv else f"FORMAT parquet, COMPRESSION {compression}"
    if metadata and not csv:
        held = ", ".join(f"{_quoted(key)}: {_literal(value)}" for key, value in metadata.items())
        options += f", KV_METADATA {{{held}}}"
    connection.register("source", source)
    _run(connection, f"COPY (SELECT {', '.join(chosen)} FROM source) TO {_text(to)} ({options})")
    return next(iter(lengths.values()))


def _run(connection: Any, command: str) -> None:
    """Raises OSError for what the system refused, with its number and in its own words."""
    import duckdb

    try:
        connection.execute(command)
    except duckdb.IOException as error:
        text = str(error).splitlines()[0]
        # With several layers at work the message is their JSON, which ends in the number of the system's error.
        number = re.search(r'"errno":"(\d+)"', text)
        if number:
            raise OSError(int(number[1]), os.strerror(int(number[1]))) from error
        raise OSError(text) from error


def _text(path: Path) -> str:
    return _literal(str(path))


def _literal(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


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
