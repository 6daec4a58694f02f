"""Tables: CSV and Parquet with a column map, and the tables that Boresight itself writes.

A column map is a TOML file that says where each of our columns comes from and in which unit it is written there::

    name = "harbour radar"

    [format]                 # optional, CSV only
    separator = ";"          # found from the header line where it is not given
    decimal = ","            # "." where it is not given
    header = ["a", "b"]      # the names, where the file has no header line
    skip = 2                 # lines to pass over before the header

    [plots]                  # or [fixes], [tracks], [platform]; several may stand beside each other
    time = { column = "ts", unit = "ms" }
    range = { column = "Rng", unit = "NM" }
    azimuth = { column = "Brg", unit = "deg" }
    height = { column = "Alt", unit = "ft", absent = [-9999] }
    sensor = { value = 65536 }

Names of columns are those of the table, with or without their unit (``range_m`` or ``range``).  Besides them there are
`speed` and `course` for fixes and tracks, which become velocities, and `on_ground`, which becomes a flag.  `absent` lists values
that mean "not known", `optional` columns may be missing, `format` is a pattern of strftime for times that are written in another
way.  Times without a zone are UTC.

A cell that cannot be read, or holds what cannot be (a latitude of 91 deg), makes its row damaged: the row is left out, and told
with its byte offset.  All other rows are read.
"""

from __future__ import annotations

import datetime
import math
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..errors import InputError, SettingsError
from ..model import Channel, Damage, Fixes, Flag, Platform, Plots, Recording, Source, Tracks, pack_callsigns
from .lines import SEPARATORS, fields_of, head_of, header_line, look_over, rewrite, separator_of

TABLES: dict[str, Any] = {"plots": Plots, "fixes": Fixes, "tracks": Tracks, "platform": Platform}
NEEDED = {
    "plots": ("range_m", "azimuth_rad"),
    "fixes": ("latitude_rad", "longitude_rad"),
    "tracks": ("latitude_rad", "longitude_rad"),
    "platform": ("time_s", "latitude_rad", "longitude_rad"),
}
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "km": 1000.0, "NM": 1852.0, "ft": 0.3048, "FL": 30.48, "cm": 0.01},
    "angle": {"deg": math.pi / 180, "rad": 1.0, "mrad": 1e-3},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "kn": 1852 / 3600, "ft/min": 0.3048 / 60, "ft/s": 0.3048},
    "acceleration": {"m/s2": 1.0, "g": 9.80665},
    "duration": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0},
    "time": {"iso": 1.0, "unix": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "s of day": 1.0},
    "address": {"hex": 1.0, "decimal": 1.0},
    "code": {"octal": 1.0, "decimal": 1.0},
}
_ABSENT_WORDS = ("nan", "null", "none", "na", "n/a", "-")
_OWN = "Boresight "
_MOST_TOLD = 100_000
_LATEST_S = 7258118400.0  # the year 2200


class Cell(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where one column comes from: a `column` of the file and its `unit`, or a constant `value`."""

    column: str | None = None
    unit: str | None = None
    value: str | int | float | bool | None = None
    absent: tuple[str | int | float, ...] = ()
    optional: bool = False
    format: str | None = None


class TextFormat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a CSV file is written, where its header line does not tell."""

    separator: str | None = None
    decimal: str = "."
    header: tuple[str, ...] = ()
    skip: int = 0


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A column map; see the head of this module."""

    name: str = ""
    format: TextFormat = TextFormat()
    plots: dict[str, Cell] | None = None
    fixes: dict[str, Cell] | None = None
    tracks: dict[str, Cell] | None = None
    platform: dict[str, Cell] | None = None

    def sections(self) -> Iterator[tuple[str, dict[str, Cell]]]:
        """The tables that it maps, with their cells."""
        for kind in TABLES:
            cells = getattr(self, kind)
            if cells is not None:
                yield kind, cells


def load_columns(path: str | Path) -> ColumnMap:
    """Read a column map.  Raises SettingsError with the place and the remedy for anything in it that makes no sense."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"cannot be read ({getattr(error, 'strerror', None) or error})", where=str(path)) from error
    return _columns_of(text, str(path))


def _columns_of(text: str, where: str) -> ColumnMap:
    try:
        columns = msgspec.convert(tomllib.loads(text), ColumnMap)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"is not TOML: {error}", where=where) from error
    except msgspec.ValidationError as error:
        raise SettingsError(
            str(error),
            where=where,
            remedy="Tables: format, plots, fixes, tracks, platform; a column is { column = …, unit = … } or { value = … }.",
        ) from error
    if not any(True for _ in columns.sections()):
        raise SettingsError("maps nothing", where=where, remedy="Add a table [plots], [fixes], [tracks] or [platform].")
    for kind, cells in columns.sections():
        _plan(kind, cells, where)
    return columns


def shipped_maps() -> dict[str, ColumnMap]:
    """The column maps that come with the package, by name."""
    folder = resources.files(__package__) / "maps"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    maps = [_columns_of(f.read_text(encoding="utf-8"), f.name) for f in files]
    return {m.name: m for m in maps}


# ------------------------------------------------------------------------------------------------------------------ the plan


class _Step(NamedTuple):
    """One column of ours: how it is read."""

    name: str
    quantity: str
    cell: Cell
    factor: float


_ENDINGS = (("_mps2", "acceleration"), ("_mps", "speed"), ("_rad", "angle"), ("_m", "length"), ("_s", "duration"))
_QUANTITY = {"mode_s": "address", "mode_3a": "code", "callsign": "text", "channel": "channel", "on_ground": "truth"}


def _quantity(name: str) -> str:
    if name == "time_s":
        return "time"
    if name in _QUANTITY:
        return _QUANTITY[name]
    return next((quantity for ending, quantity in _ENDINGS if name.endswith(ending)), "whole")


def _names(kind: str) -> dict[str, str]:
    """What a column may be called in a map, and which column of ours that is."""
    out: dict[str, str] = {}
    for f in fields(TABLES[kind]):
        if f.name == "record":
            continue
        out[f.name] = f.name
        ending = next((e for e, _ in _ENDINGS if f.name.endswith(e) and f.name not in _QUANTITY), "")
        out.setdefault(f.name.removesuffix(ending), f.name)
    if kind in ("fixes", "tracks"):
        out |= {"speed": "speed_mps", "speed_mps": "speed_mps", "course": "course_rad", "course_rad": "course_rad"}
    if "flags" in out:
        out["on_ground"] = "on_ground"
    return out


def _plan(kind: str, cells: Mapping[str, Cell], where: str) -> list[_Step]:
    """The steps of one table; raises SettingsError for names and units that do not exist, and for what is missing."""
    names = _names(kind)
    out: list[_Step] = []
    for key, cell in cells.items():
        place = f"{where}: [{kind}] {key}"
        if key not in names:
            known = ", ".join(n for n in names if names[n] != n or n in ("sensor", "source", "callsign", "on_ground", "mmsi"))
            raise SettingsError("is no column of this table", where=place, remedy=f"Columns: {known}.")
        name = names[key]
        if any(s.name == name for s in out):
            raise SettingsError("is given twice", where=place)
        if (cell.column is None) == (cell.value is None):
            raise SettingsError("needs either a column of the file or a value", where=place)
        quantity = _quantity(name)
        units = UNITS.get(quantity, {})
        unit = cell.unit
        if unit is None and cell.format is not None and quantity == "time":
            unit = "iso"
        if unit is None and quantity in ("address", "code"):
            unit = next(iter(units))
        if unit is None and units:
            raise SettingsError("has no unit", where=place, remedy=f"Units: {', '.join(units)}.")
        if unit is not None and unit not in units:
            remedy = f"Units: {', '.join(units)}." if units else "This column has none."
            raise SettingsError(f"has the unknown unit {unit!r}", where=place, remedy=remedy)
        if cell.value is not None:
            _constant(cell.value, quantity, unit, place)
        out.append(_Step(name, quantity, msgspec.structs.replace(cell, unit=unit), units.get(unit or "", 1.0)))
    missing = [n for n in NEEDED[kind] if all(s.name != n for s in out)]
    if kind == "fixes" and all(any(s.name == n for s in out) for n in ("x_m", "y_m")):
        missing = []
    if missing:
        raise SettingsError(f"lacks {', '.join(missing)}", where=f"{where}: [{kind}]", remedy="Name the columns that hold them.")
    return out


def _constant(value: str | int | float | bool, quantity: str, unit: str | None, place: str) -> float:
    """A constant in our unit; raises SettingsError where it does not fit."""
    text = str(value).strip()
    try:
        if quantity == "channel":
            return float(Channel[text.upper()].value)
        if quantity == "text":
            return 0.0
        if quantity == "truth":
            return float(value is True or text.lower() in ("true", "1", "yes"))
        if quantity == "time" and unit == "iso":
            moment = datetime.datetime.fromisoformat(text)
            return (moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)).timestamp()
        if unit in ("hex", "octal"):
            return float(int(text, 16 if unit == "hex" else 8))
        number = float(value)
        if math.isfinite(number):
            return number
    except (ValueError, KeyError):
        pass
    remedy = f"Channels: {', '.join(c.name.lower() for c in Channel)}." if quantity == "channel" else ""
    raise SettingsError(f"the value {value!r} cannot be read", where=place, remedy=remedy)


def _own_maps() -> dict[str, dict[str, Cell]]:
    """The maps of the tables that `write_table` writes: columns by the names that they have outside."""
    out: dict[str, dict[str, Cell]] = {}
    units = {"time": "iso", "angle": "deg", "length": "m", "speed": "m/s", "acceleration": "m/s2", "duration": "s"}
    units |= {"address": "hex", "code": "octal"}
    for kind, table in TABLES.items():
        cells: dict[str, Cell] = {}
        for f in fields(table):
            if f.name == "record":
                continue
            outside = f.name.removesuffix("_rad") + "_deg" if f.name.endswith("_rad") else f.name
            outside = "time" if f.name == "time_s" else outside
            cells[f.name] = Cell(column=outside, unit=units.get(_quantity(f.name)), optional=f.name not in NEEDED[kind])
        out[kind] = cells
    return out


def _recognise(path: str | Path, names: list[str], kind: str | None) -> ColumnMap:
    """The map of a file without one, from the names of its columns; raises InputError with what exists."""
    own = _own_maps()
    given = set(names) - {"record"}
    fitting = [
        (len({c.column for c in cells.values()} - given), k)
        for k, cells in own.items()
        if given <= {c.column for c in cells.values()}
        and all(cells[n].column in given for n in NEEDED[k])
        and (kind is None or k == kind)
    ]
    if not fitting and {"x_m", "y_m", "time", "source"} <= given <= {c.column for c in own["fixes"].values()}:
        fitting = [(0, "fixes")]
    if fitting:
        # Tables share names: the one with the fewest columns left over is meant, fixes before the others where that is equal.
        order = {"plots": 0, "fixes": 1, "tracks": 2, "platform": 3}
        best = min(fitting, key=lambda pair: (pair[0], order[pair[1]]))[1]
        return msgspec.structs.replace(ColumnMap(name=_OWN + best), **{best: own[best]})
    for m in sorted(shipped_maps().values(), key=lambda m: -sum(len(cells) for _, cells in m.sections())):
        if all(c.column is None or c.optional or c.column in given for _, cells in m.sections() for c in cells.values()):
            return m
    shown = ", ".join(names[:40]) + (" …" if len(names) > 40 else "")
    raise InputError(
        f"it is not known what its columns mean; they are: {shown}",
        path=path,
        remedy="Give a column map (TOML) that says which column holds the time, the position and so on, in which unit: beside it "
        f"as {Path(path).name}.map.toml, or with --columns of convert.",
    )


# --------------------------------------------------------------------------------------------------------------- reading


def looks_like_table(head: bytes) -> bool:
    """Whether a file that begins with `head` is Parquet, or text with a header line of at least three fields."""
    if head.startswith(b"PAR1"):
        return True
    if b"\0" in head[:4096] or not head:
        return False
    line, _ = header_line(head[:65536])
    names = fields_of(line, separator_of(line)) if line else []
    if len(names) < 3 or line[0] in "!$%\\{[<":
        return False
    printable = sum(c.isprintable() or c == "\t" for c in line)
    words = sum(bool(n) and not _is_number(n) for n in names)
    return printable == len(line) and words >= 0.8 * len(names)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_table(
    path: str | Path,
    columns: str | Path | ColumnMap | None = None,
    *,
    kind: str | None = None,
    date: datetime.date | None = None,
) -> Recording:
    """Read a CSV or Parquet table into a Recording.

    `columns` is a column map (a TOML file, or loaded).  Without one the tables that `write_table` writes are known by the names
    of their columns, and so are those of the maps that come with the package; `kind` ("plots", "fixes", "tracks", "platform")
    decides where names alone do not.  `date` is the UTC date of the first row of a table with times of day.

    `record` counts the rows that were read, `offset` is the byte where each begins (in Parquet: its row).  What is absent is
    empty, a word such as NaN or null, or listed as `absent`.  Rows that cannot be read are in `damaged` with their place.

    Raises InputError for a file that cannot be read, for columns that the map names and the file lacks (with those that
    exist), and where no row at all can be read; SettingsError for a map that makes no sense.
    """
    import duckdb

    if kind is not None and kind not in TABLES:
        raise SettingsError(f"{kind!r} is no kind of table", where="kind", remedy=f"Kinds: {', '.join(TABLES)}.")
    chosen = load_columns(columns) if isinstance(columns, str | Path) else columns
    head = head_of(path)
    settings: dict[str, str | bool | int | float | list[str]] = {
        "threads": 1,
        "memory_limit": "4GB",
        "autoload_known_extensions": False,
        "autoinstall_known_extensions": False,
    }
    with tempfile.TemporaryDirectory(prefix="boresight-") as folder, duckdb.connect(":memory:", config=settings) as connection:
        connection.execute("SET TimeZone = 'UTC'")
        try:
            if head.startswith(b"PAR1"):
                return _read_parquet(connection, path, chosen, kind, date)
            return _read_csv(connection, path, head, chosen, kind, date, Path(folder))
        except duckdb.Error as error:
            raise InputError(
                f"cannot be read as a table ({str(error).splitlines()[0]})", path=path, remedy="Is the file whole?"
            ) from error


class _Outcome(NamedTuple):
    """What the query gave: values of each step, and which rows hold something that cannot be read in it."""

    steps: list[list[_Step]]
    values: dict[str, AnyArray]
    bad: dict[str, BoolArray]
    rows: int


def _read_parquet(connection: Any, path: str | Path, columns: ColumnMap | None, kind: str | None, date: Any) -> Recording:
    source = f"read_parquet({_text(str(path))})"
    types = {name: str(kind_) for name, kind_, *_ in connection.execute(f"DESCRIBE SELECT * FROM {source}").fetchall()}
    chosen = columns or _recognise(path, list(types), kind)
    outcome = _query(connection, path, source, types, {n: n for n in types}, chosen, ".")
    return _recording(path, chosen, outcome, np.arange(outcome.rows), [], [], "row", date)


def _read_csv(
    connection: Any, path: str | Path, head: bytes, columns: ColumnMap | None, kind: str | None, date: Any, folder: Path
) -> Recording:
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError("this is UTF-16", path=path, offset=0, remedy="Save it as UTF-8 (in a spreadsheet: CSV UTF-8).")
    layout = columns.format if columns else TextFormat()
    begin = 0
    for _ in range(layout.skip):
        end = head.find(b"\n", begin)
        begin = len(head) if end < 0 else end + 1
    line, after = header_line(head[begin:])
    after += begin
    if len(line) >= 60000:
        raise InputError("its first line is longer than 60,000 bytes", path=path, offset=0, remedy="Give a CSV or Parquet table.")
    if not line:
        raise InputError("no line with anything in it", path=path, remedy="Give a table with a header line.")
    if sum(c.isprintable() or c == "\t" for c in line) < len(line):
        raise InputError("this is not text", path=path, offset=0, remedy="Give a CSV or Parquet table.")
    separator = layout.separator or separator_of(line)
    if layout.separator is not None and (len(separator) != 1 or separator in '"\r\n'):
        raise SettingsError(f"separator = {separator!r} is not one character", where="[format]")
    if layout.decimal not in (".", ",") or layout.decimal == separator:
        raise SettingsError(f"decimal = {layout.decimal!r} is neither '.' nor ',', or is the separator", where="[format]")
    names = list(layout.header) or fields_of(line, separator)
    if layout.header:
        after = begin + (3 if begin == 0 and head.startswith(b"\xef\xbb\xbf") else 0)
    doubles = sorted({n for n in names if names.count(n) > 1 and n})
    if len(names) < 2:
        raise InputError(
            f"one column only ({line[:40]!r} …)", path=path, offset=0,
            remedy=f"Columns are separated by one of {' '.join(repr(s) for s in SEPARATORS)}; another one is told in the map.",
        )  # fmt: skip
    chosen = columns or _recognise(path, names, kind)
    named = {c.column for _, cells in chosen.sections() for c in cells.values()}
    if named & set(doubles):
        raise InputError(f"several columns are called {', '.join(doubles)}", path=path, offset=0, remedy="Rename them.")
    inner = {name: f"c{k}" for k, name in reversed(list(enumerate(names)))}
    types = dict.fromkeys(names, "VARCHAR")
    look = look_over(path, after)
    # The fast reader is told to pass over one line: anything else above the rows, and it gets a file without it.
    above = head[:after]
    if after and (above.count(b"\n") != 1 or above.count(b'"') % 2 or begin):
        look = look._replace(plain=False, why_not=look.why_not or "lines above its header")
    damaged: list[Damage] = []
    warnings: list[str] = []
    if look.plain:
        source = _csv_source(path, after, names, separator, look.newline, quoted=look.quoted)
        outcome = _query(connection, path, source, types, inner, chosen, layout.decimal)
        start, damaged, whole = _without_rejects(connection, look.start, outcome.rows)
        if whole:
            return _recording(path, chosen, outcome, start, damaged, warnings, "byte", date)
        del outcome
        connection.execute("DROP TABLE reject_errors; DROP TABLE reject_scans")
    else:
        warnings.append(f"it holds {look.why_not}; it was read line by line")
    # The slow way: every record is made sure of before the fast reader sees it.
    clean = folder / "clean.csv"
    start, damaged = rewrite(path, clean, after, separator, len(names))
    source = _csv_source(clean, 0, names, separator, b"\n", quoted=False)
    outcome = _query(connection, path, source, types, inner, chosen, layout.decimal)
    start, more, whole = _without_rejects(connection, start, outcome.rows)
    if not whole:
        raise InputError(f"{outcome.rows} rows were read where {len(start)} are", path=path, remedy="Please report this file.")
    return _recording(path, chosen, outcome, start, damaged + more, warnings, "byte", date)


def _csv_source(path: str | Path, after: int, names: list[str], separator: str, newline: bytes, *, quoted: bool) -> str:
    """The SQL that reads a CSV file; nothing about it is guessed."""
    declared = ", ".join(f"'c{k}': 'VARCHAR'" for k in range(len(names)))
    quote = '"' if quoted else ""
    return (
        f"read_csv({_text(str(path))}, auto_detect=false, header=false, delim={_text(separator)}, quote={_text(quote)}, "
        f"escape={_text(quote)}, new_line={_text(newline.decode().encode('unicode_escape').decode())}, "
        f"columns={{{declared}}}, store_rejects=true, rejects_limit=0, max_line_size=2000000, skip={'1' if after else '0'})"
    )


def _without_rejects(connection: Any, start: IntArray, rows: int) -> tuple[IntArray, list[Damage], bool]:
    """Offsets of the rows that were read, what was rejected, and whether the two together are all lines."""
    found = connection.execute(
        "SELECT line_byte_position, min(line), min(error_message) FROM reject_errors GROUP BY ALL ORDER BY ALL"
    ).fetchall()
    rejected = np.array([int(place) - 1 for place, *_ in found], np.int64)
    damaged = [Damage(int(place) - 1, f"line {number}: {why}") for place, number, why in found]
    index = np.searchsorted(start, rejected)
    known = (index < len(start)) & (start[np.minimum(index, len(start) - 1)] == rejected) if len(start) else rejected < 0
    return np.delete(start, index[known]), damaged, bool(np.all(known)) and rows == len(start) - len(rejected)


def _text(value: str) -> str:
    return "'" + value.replace("'", "''") + "'"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _query(
    connection: Any,
    path: str | Path,
    source: str,
    types: dict[str, str],
    inner: dict[str, str],
    columns: ColumnMap,
    decimal: str,
) -> _Outcome:
    """Read the mapped columns; raises InputError for columns that the file has not."""
    plans: list[list[_Step]] = []
    used: dict[str, list[_Step]] = {}
    for kind, cells in columns.sections():
        plan = []
        for step in _plan(kind, cells, columns.name or "columns"):
            name = step.cell.column
            if name is not None and name not in types:
                if step.cell.optional:
                    continue
                shown = ", ".join(list(types)[:40]) + (" …" if len(types) > 40 else "")
                raise InputError(
                    f"has no column {name!r}, which {step.name} comes from; its columns are: {shown}",
                    path=path,
                    remedy="Correct the column map: names are compared letter by letter.",
                )
            plan.append(step)
            if name is not None:
                used.setdefault(_key(step), []).append(step)
        plans.append(plan)
    texts, chosen = [], []
    for number, steps in enumerate(used.values()):
        step = steps[0]
        assert step.cell.column is not None
        raw = _quoted(inner[step.cell.column])
        value, absent = _expression(f"t{number}", types[step.cell.column], step, decimal)
        texts.append(f"{absent.format(raw)} AS t{number}")
        chosen += [f"{value} AS v{number}", f"(t{number} IS NOT NULL AND {value} IS NULL) AS b{number}"]
    if not chosen:
        raise SettingsError("names no column of the file", where=columns.name or "columns")
    fetched = connection.execute(f"SELECT {', '.join(chosen)} FROM (SELECT {', '.join(texts)} FROM {source})").fetchnumpy()
    values: dict[str, AnyArray] = {}
    bad: dict[str, BoolArray] = {}
    rows = 0
    for number, key in enumerate(used):
        column = fetched.pop(f"v{number}")
        if column.dtype.kind == "f":
            column = np.ma.filled(column, np.nan)
        elif column.dtype.kind in "iub":
            column = np.where(np.ma.getmaskarray(column), np.nan, np.ma.filled(column, 0)).astype(np.float64)
        else:
            mask = np.ma.getmaskarray(column)
            column = np.asarray(np.ma.getdata(column), object)
            column[mask] = None
        values[key], rows = column, len(column)
        bad[key] = np.asarray(np.ma.filled(fetched.pop(f"b{number}"), False), bool)
    return _Outcome(plans, values, bad, rows)


def _key(step: _Step) -> str:
    return f"{step.cell.column}\0{step.quantity}\0{step.cell.unit}\0{step.cell.format}\0{step.cell.absent}"


def _expression(t: str, kind: str, step: _Step, decimal: str) -> tuple[str, str]:
    """SQL for a value (in the file's unit, NULL where it cannot be read), and for the cell (NULL where it is absent)."""
    text = kind == "VARCHAR"
    words = [*_ABSENT_WORDS, *(str(a).strip().lower() for a in step.cell.absent if isinstance(a, str))]
    listed = ", ".join(_text(w) for w in words)
    absent = f"CASE WHEN lower(trim({{0}})) IN ('', {listed}) THEN NULL ELSE trim({{0}}) END" if text else "{0}"
    whole = kind.endswith(("INT", "INTEGER")) or kind == "HUGEINT"
    number = whole or kind in ("DOUBLE", "FLOAT") or kind.startswith("DECIMAL")
    if kind in ("DOUBLE", "FLOAT"):
        absent = "CASE WHEN isnan({0}) THEN NULL ELSE {0} END"
    as_text = t if text else f"CAST({t} AS VARCHAR)"
    point = f"replace({t}, ',', '.')" if decimal == "," else t
    # A number in which digits are grouped by underscores would be read by SQL; here it is damage.
    as_number = (
        f"CASE WHEN contains({t}, '_') THEN NULL ELSE try_cast({point} AS DOUBLE) END"
        if text
        else (f"CAST({t} AS DOUBLE)" if number else f"CAST(NULL AS DOUBLE) /* {kind} */")
    )
    digits = f"regexp_replace({as_text}, '\\.0+$', '')"
    if step.quantity == "time" and step.cell.unit == "iso":
        if kind.startswith("TIMESTAMP"):
            return (f"epoch_us({t}) / 1e6", absent) if "NS" not in kind else (f"epoch_ns({t}) / 1e9", absent)
        if not text:
            return "CAST(NULL AS DOUBLE)", absent
        pattern = step.cell.format
        moment = f"try_strptime({t}, {_text(pattern)})" if pattern else f"try_cast({point} AS TIMESTAMPTZ)"
        return f"CASE WHEN isfinite({moment}) THEN epoch_us({moment}) / 1e6 END", absent
    if step.quantity == "address" and step.cell.unit == "hex":
        hexadecimal = f"try_cast('0x' || {as_text} AS BIGINT)"
        return f"CASE WHEN regexp_full_match({as_text}, '[0-9a-fA-F]{{1,6}}') THEN {hexadecimal} END", absent
    if step.quantity == "code" and step.cell.unit == "octal":
        padded = f"lpad({digits}, 4, '0')"
        places = " + ".join(f"{8 ** (3 - k)} * try_cast(substr({padded}, {k + 1}, 1) AS BIGINT)" for k in range(4))
        return f"CASE WHEN regexp_full_match({digits}, '[0-7]{{1,4}}') THEN {places} END", absent
    if step.quantity == "text":
        return f"CAST({as_text} AS VARCHAR)", absent
    if step.quantity == "channel":
        cases = " ".join(f"WHEN '{c.name.lower()}' THEN {c.value}" for c in Channel)
        return f"CASE lower({as_text}) {cases} END", absent
    if step.quantity == "truth":
        return (
            f"CASE WHEN lower({as_text}) IN ('true', 't', 'yes', 'y', '1', '1.0') THEN 1 "
            f"WHEN lower({as_text}) IN ('false', 'f', 'no', 'n', '0', '0.0') THEN 0 END",
            absent,
        )
    return as_number, absent


# ------------------------------------------------------------------------------------------------------- values to tables


def _impossible(step: _Step, values: FloatArray) -> tuple[BoolArray, str]:
    """Which values (in our unit) cannot be, and what is the matter with them."""
    name, size = step.name, np.abs(values)
    with np.errstate(invalid="ignore"):
        if name == "time_s":
            return ~((values >= 0) & (values < _LATEST_S)), "no time between 1970 and 2200"
        if name == "latitude_rad":
            return ~(size <= np.pi / 2), "no latitude"
        if name == "longitude_rad":
            return ~((values >= -np.pi) & (values <= 2 * np.pi)), "no longitude"
        if name == "elevation_rad":
            return ~(size <= np.pi / 2), "no elevation"
        if step.quantity == "angle":
            return ~(size <= 4 * np.pi), "no angle"
        if name == "range_m":
            return ~((values >= 0) & (values < 1e8)), "no range"
        if name.endswith("_sd_m") or name in ("length_m", "width_m"):
            return ~((values >= 0) & (values < 1e8)), "neither a length nor an accuracy"
        if step.quantity == "length":
            return ~(size < 1e8), "no length"
        if step.quantity == "speed":
            return ~(size < 2e4), "no speed"
        if step.quantity == "address":
            return ~((values >= 0) & (values < 2**24) & (values == np.floor(values))), "no 24-bit address"
        if step.quantity == "code":
            return ~((values >= 0) & (values < 4096) & (values == np.floor(values))), "no Mode 3/A code"
        if name == "mmsi":
            return ~((values >= 0) & (values < 1e9) & (values == np.floor(values))), "no MMSI"
        if step.quantity == "whole":
            least, most = (0, 2**32) if name == "flags" else (-1, 2**31)
            return ~((values >= least) & (values < most) & (values == np.floor(values))), "no whole number of its kind"
        return ~np.isfinite(values), "no number"


def _recording(
    path: str | Path,
    columns: ColumnMap,
    outcome: _Outcome,
    start: IntArray,
    damaged: list[Damage],
    warnings: list[str],
    place: str,
    date: datetime.date | None,
) -> Recording:
    """The tables of what was read, without the rows that hold something impossible."""
    rows = outcome.rows
    left = np.zeros(rows, bool)
    why: dict[int, str] = {}

    def leave_out(which: BoolArray, step: _Step, reason: str) -> None:
        fresh = np.flatnonzero(which & ~left)
        for k in fresh[: max(0, _MOST_TOLD - len(why))].tolist():
            why[k] = f"column {step.cell.column!r}: {reason}"
        left[fresh] = True

    converted: list[tuple[str, list[tuple[_Step, AnyArray]]]] = []
    for (kind, _), plan in zip(columns.sections(), outcome.steps, strict=True):
        mine: list[tuple[_Step, AnyArray]] = []
        for step in plan:
            if step.cell.column is None:
                continue
            key = _key(step)
            values = outcome.values[key]
            leave_out(outcome.bad[key], step, "what it holds cannot be read")
            if values.dtype.kind == "f":
                known = ~np.isnan(values)
                for missing in step.cell.absent:
                    if isinstance(missing, int | float):
                        known &= values != missing
                values = np.where(known, values * step.factor, np.nan)
                if step.quantity == "time" and step.cell.unit == "s of day":
                    values = _from_time_of_day(values, date, warnings)
                impossible, reason = _impossible(step, values)
                leave_out(known & impossible, step, f"holds {reason}")
            mine.append((step, values))
        converted.append((kind, mine))
    kept = ~left
    offsets = start[kept]
    damaged = damaged + [Damage(int(start[k]), text) for k, text in why.items()]
    damaged.sort(key=lambda d: d.offset)
    unlisted = int(np.count_nonzero(left)) - len(why)
    if unlisted:
        warnings.append(f"{unlisted:,} more damaged rows are not listed one by one")
    if not kept.any():
        reason = damaged[0].why if damaged else "there is no row below the header"
        raise InputError(
            f"no row could be read: {reason}",
            path=path,
            offset=damaged[0].offset if damaged and place == "byte" else None,
            record=damaged[0].offset if damaged and place == "row" else None,
            remedy="Check the names, units and separators of the map against the file." if damaged else "Is the file whole?",
        )
    found: dict[str, Any] = {}
    for (kind, mine), (_, cells) in zip(converted, columns.sections(), strict=True):
        constants = [(s, s.cell.value) for s in _plan(kind, cells, columns.name) if s.cell.value is not None]
        table = _table(kind, [(s, v[kept]) for s, v in mine], constants, int(kept.sum()))
        # Our own tables may hold rows without a position; they come back as they went.
        empty = np.zeros(len(table), bool) if columns.name.startswith(_OWN) else _without_position(kind, table)
        if empty.any():
            warnings.append(f"{np.count_nonzero(empty):,} of {len(table):,} rows hold no position: left out of the {kind}")
            table = table[~empty]
        found[kind] = table
    untimed = sum(int(np.count_nonzero(np.isnan(t.time_s))) for t in found.values())
    if untimed:
        warnings.append(f"{untimed:,} rows have no time")
    return Recording(
        path=str(path),
        plots=found.get("plots", Plots()),
        fixes=found.get("fixes", Fixes()),
        tracks=found.get("tracks", Tracks()),
        platform=found.get("platform", Platform()),
        sources=sources_of(found.values(), columns.name or "table"),
        damaged=tuple(damaged),
        warnings=tuple(warnings),
        by_category={},
        offset=offsets,
    )


def _from_time_of_day(seconds: FloatArray, date: datetime.date | None, warnings: list[str]) -> FloatArray:
    """Times of rows that tell only seconds of the day; a step back of more than half a day is midnight."""
    if date is None:
        warnings.append("its times are times of day and no date is given: they are counted from 1970-01-01")
    day = (date or datetime.date(1970, 1, 1)).toordinal() - datetime.date(1970, 1, 1).toordinal()
    known = np.flatnonzero(np.isfinite(seconds))
    turns = np.zeros(len(seconds))
    turns[known[1:]] = np.cumsum(-np.rint(np.diff(seconds[known]) / 86400.0))
    if len(known):
        turns[known] -= turns[known[0]]
    return seconds + (day + turns) * 86400.0


def _table(kind: str, columns: list[tuple[_Step, AnyArray]], constants: list[tuple[_Step, Any]], rows: int) -> Any:
    """A table of ours, one row for each that was read."""
    dtypes = {f.name: f.metadata["dtype"] for f in fields(TABLES[kind])}
    values: dict[str, AnyArray] = {}
    for step, column in columns:
        if step.quantity == "text":
            words = {w: 0 for w in column.tolist() if w}
            packed = dict(zip(words, pack_callsigns(list(words)).tolist(), strict=True))
            values[step.name] = np.array([packed[w] if w else -1 for w in column.tolist()], np.int64)
        else:
            values[step.name] = column
    for step, value in constants:
        if step.quantity == "text":
            values[step.name] = np.full(rows, pack_callsigns([str(value)])[0])
        else:
            number = _constant(value, step.quantity, step.cell.unit, step.name) * step.factor
            values[step.name] = np.full(rows, number)
    if "speed_mps" in values and "speed_mps" not in dtypes:
        speed, course = values.pop("speed_mps"), values.pop("course_rad", np.full(rows, np.nan))
        # Who stands still has a velocity, whatever the course.
        course = np.where((speed == 0) & np.isnan(course), 0.0, course)
        values.setdefault("velocity_east_mps", speed * np.sin(course))
        values.setdefault("velocity_north_mps", speed * np.cos(course))
    if "course_rad" not in dtypes:
        values.pop("course_rad", None)
    if "on_ground" in values:
        on_ground = np.where(values.pop("on_ground") == 1, float(Flag.GROUND), 0.0)
        flags = np.nan_to_num(values.get("flags", np.zeros(rows)))
        values["flags"] = (flags.astype(np.uint32) | on_ground.astype(np.uint32)).astype(np.float64)
    if "longitude_rad" in values:
        longitude = values["longitude_rad"]
        values["longitude_rad"] = np.where(longitude > np.pi, longitude - 2 * np.pi, longitude)
    out: dict[str, AnyArray] = {}
    for name, column in values.items():
        dtype = dtypes[name]
        if dtype.kind == "f" or column.dtype.kind != "f":
            out[name] = column
        else:
            absent = 0 if dtype.kind == "u" or name == "channel" else -1
            out[name] = np.where(np.isnan(column), absent, column).astype(np.int64).astype(dtype)
    out["record"] = np.arange(rows)
    return TABLES[kind](**out)


def _without_position(kind: str, table: Any) -> BoolArray:
    """Rows (n,) that have none of what their table is for."""
    lacking = np.any([np.isnan(getattr(table, name)) for name in NEEDED[kind] if name != "time_s"], axis=0)
    if kind == "fixes":
        lacking &= np.isnan(table.x_m) | np.isnan(table.y_m)
    return np.asarray(lacking)


def sources_of(tables: Any, edition: str) -> tuple[Source, ...]:
    """Who is in these tables: one a sensor or source (-1: not told), with its counts and its span."""
    out: list[Source] = []
    for table in tables:
        if not len(table):
            continue
        key = table.source if hasattr(table, "source") else table.sensor
        for k in np.unique(key).tolist():
            mine = table[key == k] if len(np.unique(key)) > 1 else table
            time = mine.time_s[np.isfinite(mine.time_s)]
            targets = 0
            for name in ("mode_s", "mmsi", "track", "callsign"):
                known = getattr(mine, name, np.full(1, -1))
                if (known >= 0).any():
                    targets = len(np.unique(known[known >= 0]))
                    break
            out.append(
                Source(
                    sac=k >> 8, sic=k & 255, category=0, edition=edition, records=len(mine),
                    plots=len(mine) if isinstance(mine, Plots) else 0,
                    start_s=float(time.min()) if len(time) else math.nan,
                    end_s=float(time.max()) if len(time) else math.nan,
                    targets=targets,
                )
            )  # fmt: skip
    return tuple(out)


def parquet_columns(path: str | Path) -> dict[str, AnyArray]:
    """The columns of a Parquet file that Boresight wrote, as they stand there: NaN and -1 where empty, timestamps in UTC seconds.

    Words stay an array of objects.  Raises InputError where the file cannot be read or is no Parquet.
    """
    import duckdb

    if not Path(path).is_file():
        raise InputError("does not exist" if not Path(path).exists() else "is no file", path=path)
    with duckdb.connect(":memory:", config={"threads": 1, "autoload_known_extensions": False}) as connection:
        try:
            fetched = connection.execute(f"SELECT * FROM read_parquet({_text(str(path))})").fetchnumpy()
        except duckdb.Error as error:
            raise InputError(f"is no Parquet: {str(error).splitlines()[0]}", path=path) from error
    columns: dict[str, AnyArray] = {}
    for name, column in fetched.items():
        kind = column.dtype.kind
        if kind == "M":
            whole = np.ma.filled(column, np.datetime64("NaT")).astype("datetime64[us]")
            seconds = whole.astype(np.int64) / 1e6
            columns[name] = np.where(np.isnat(whole), np.nan, seconds)
        elif kind == "f":
            columns[name] = np.asarray(np.ma.filled(column, np.nan))
        elif kind in "iu":
            columns[name] = np.asarray(np.ma.filled(column, -1))
        else:
            columns[name] = np.asarray(np.ma.getdata(column), object)
    return columns
