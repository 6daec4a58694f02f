"""One writer for all formats: the ending of the name chooses, and what cannot be carried is counted."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .._files import check_place
from ..errors import InputError, NothingToDo, SettingsError
from ..model import Fixes, Recording, Sensors
from .features import tables_of

# Endings, and what each format holds.
ENDINGS = {
    ".parquet": ("plots", "fixes", "tracks", "platform"),
    ".csv": ("plots", "fixes", "tracks", "platform"),
    ".geojson": ("plots", "fixes", "tracks", "platform"),
    ".json": ("plots", "fixes", "tracks", "platform"),
    ".kml": ("plots", "fixes", "tracks", "platform"),
    ".ast": ("plots", "fixes"),
    ".nmea": ("plots", "fixes", "tracks", "platform"),
}
_SEPARATE = (".parquet", ".csv")
# What needs latitude and longitude.
_ON_EARTH = (".geojson", ".json", ".kml", ".nmea", ".ast")
KINDS = ("plots", "fixes", "tracks", "platform")


class Converted(msgspec.Struct, frozen=True):
    """What was written: files, rows of each table, and what the format could not hold (column or reason: how many rows)."""

    files: tuple[str, ...]
    rows: dict[str, int]
    left_out: dict[str, int]


def files_for(path: str | Path, recording: Recording, *, kind: str | None = None) -> dict[Path, tuple[str, ...]]:
    """The files that `write_any` would write, and the tables that go into each.

    Raises SettingsError for an unknown ending or kind, and where a table format would need a choice; NothingToDo where the
    recording holds nothing of it.
    """
    path = Path(path)
    _check(path, kind)
    return _planned(path, recording.path, list(tables_of(recording)), kind)


def _check(path: Path, kind: str | None) -> None:
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise SettingsError(
            f"the ending {ending or '(none)'} of {path.name} is no known format",
            where="out",
            remedy=f"Known: {', '.join(ENDINGS)}.",
        )
    if kind is not None and kind not in (*KINDS, "all"):
        raise SettingsError(f"{kind!r} is no kind of table", where="kind", remedy=f"Kinds: {', '.join(KINDS)}, all.")


def _planned(path: Path, name: str, held: list[str], kind: str | None) -> dict[Path, tuple[str, ...]]:
    """As `files_for`, of the tables that are held."""
    ending = path.suffix.lower()
    if kind not in (None, "all"):
        if kind not in held:
            there = f"it holds {', '.join(held)}" if held else "it is empty"
            raise NothingToDo(f"{name} holds no {kind}: {there}", remedy="Choose another kind.")
        held = [kind]
    fitting = [k for k in held if k in ENDINGS[ending]]
    if not fitting:
        what = (
            f"holds only {', '.join(held)}, which {ending} cannot hold" if held else "holds no plots, fixes, tracks or positions"
        )
        raise NothingToDo(f"{name} {what}", remedy="Choose another format." if held else "Is it the right file?")
    if ending not in _SEPARATE:
        return {path: tuple(fitting)}
    if len(fitting) == 1:
        return {path: tuple(fitting)}
    if kind == "all":
        return {path.with_name(f"{path.stem}-{k}{path.suffix}"): (k,) for k in fitting}
    raise SettingsError(
        f"{name} holds {', '.join(fitting)}, and {ending} holds one table",
        where="kind",
        remedy=f"Choose one of them, or all: then {path.stem}-{fitting[0]}{path.suffix} and so on are written.",
    )


def write_any(
    path: str | Path,
    recording: Recording,
    *,
    sensors: Sensors | None = None,
    kind: str | None = None,
    lines: bool = False,
    source: int | None = None,
) -> Converted:
    """Write a recording in the format that the ending of `path` names: .parquet .csv .geojson .json .kml .ast .nmea.

    `kind` (plots, fixes, tracks, platform) chooses one table.  Parquet and CSV hold one table a file: with several in the
    recording a choice is needed, or "all", which writes ``name-plots.parquet``, ``name-fixes.parquet`` and so on.  The other
    formats hold all of them; what one has no place for is in `left_out`.  `sensors` is needed where plots go on a map
    (GeoJSON, KML); `lines` adds each target's track as a line to GeoJSON.  Every file is written as a whole or not at all.

    ASTERIX names senders by SAC and SIC: `source` (``sac << 8 | sic``) is given to rows whose sensor or source has none.

    Raises SettingsError for an ending or kind that does not exist and a choice that is missing, NothingToDo where there is
    nothing to write, and what the formats' own writers raise.
    """
    plan = files_for(path, recording, kind=kind)
    ending = Path(path).suffix.lower()
    tables = tables_of(recording)
    chosen = [k for kinds in plan.values() for k in kinds]
    rows = {k: len(tables[k]) for k in chosen}
    left: dict[str, int] = {}
    if kind in (None, "all"):
        left |= {f"{k} (no place in {ending})": len(t) for k, t in tables.items() if k not in chosen}
    if "fixes" in chosen and ending in _ON_EARTH:
        tables["fixes"] = _located(tables["fixes"], recording, sensors)
    if ending in _SEPARATE:
        from .tables import write_table

        for file, (one,) in plan.items():
            write_table(file, tables[one])
    elif ending == ".kml":
        from .kml import write_kml

        counts = write_kml(path, {k: tables[k] for k in chosen}, sensors=sensors, platform=recording.platform)
        left |= {k: n for k, n in counts.items() if k == "without position"}
    elif ending in (".geojson", ".json"):
        from .geojson import write_geojson

        counts = write_geojson(path, {k: tables[k] for k in chosen}, sensors=sensors, platform=recording.platform, lines=lines)
        left |= {k: n for k, n in counts.items() if k == "without position"}
    elif ending == ".nmea":
        from .nmea import write_nmea

        left |= write_nmea(path, **{k: tables[k] for k in chosen}, sensors=sensors).left_out
    else:
        from .asterix import write_asterix

        named = {k: _with_source(tables[k], source) for k in chosen}
        fixes = named.get("fixes")
        if fixes is not None:
            there = np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad) & np.isfinite(fixes.time_s)
            if not there.all():
                left["fixes without a time or position"] = int(np.count_nonzero(~there))
                fixes = fixes[there]
        plots = named.get("plots")
        left |= write_asterix(path, plots, fixes, category=_category(recording, plots)).left_out
    return Converted(tuple(str(f) for f in plan), rows, left)


def write_parts(
    path: str | Path,
    parts: Iterable[Any],
    *,
    name: str,
    kind: str | None = None,
    check: Callable[[Path], None] = lambda _: None,
) -> Converted:
    """As `write_any` for Parquet and CSV, from parts that come one behind the other: memory does not grow with their number.

    Each part has tables as attributes: plots, fixes, tracks, platform.  `name` is what they come from, for messages.  The files
    are those that the joined tables would give.  Until all parts are there they wait in a folder beside `path`, which is removed
    in any case; `check` is asked for each file before it is put in its place, and may raise.

    Raises what `write_any` does; that a choice of table is missing is said as soon as a second table turns up.
    """
    from .tables import Pieces

    path = Path(path)
    _check(path, kind)
    ending = path.suffix.lower()
    if ending not in _SEPARATE:
        raise SettingsError(f"{ending} is not written part by part", where="out", remedy=f"These are: {', '.join(_SEPARATE)}.")
    check_place(path)
    if kind != "all":
        check(path)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder, ExitStack() as at_end:
            pieces: dict[str, Pieces] = {}
            for part in parts:
                for one in KINDS:
                    table = getattr(part, one, ())
                    if not len(table):
                        continue
                    if one not in pieces:
                        pieces[one] = Pieces(Path(folder), one, ending == ".csv")
                        at_end.callback(pieces[one].close)
                        if kind is None:
                            _planned(path, name, [k for k in KINDS if k in pieces], kind)
                    if kind in (None, "all", one):
                        pieces[one].append(table)
            plan = _planned(path, name, [k for k in KINDS if k in pieces], kind)
            for file in plan:
                check(file)
            for file, (one,) in plan.items():
                pieces[one].publish(file)
    except OSError as error:
        why = error.strerror or str(error)
        raise InputError(
            f"cannot be written ({why})", path=path, remedy="Nothing was changed; free some space or write elsewhere."
        ) from error
    return Converted(tuple(str(f) for f in plan), {one: pieces[one].rows for (one,) in plan.values()}, {})


def _with_source(table: Any, source: int | None) -> Any:
    """The table with the id `source` where a row has no SAC and SIC."""
    if source is None:
        return table
    column = "source" if hasattr(table, "source") else "sensor"
    key = getattr(table, column)
    return table.replace(**{column: np.where((key >= 0) & (key < 65536), key, source)})


def _category(recording: Recording, plots: Any) -> int:
    """Category 010 for plots of a surface radar, as they came; 048 for all others."""
    surface = {s.id for s in recording.sources if s.category == 10}
    return 10 if plots is not None and surface and set(np.unique(plots.sensor).tolist()) <= surface else 48


def _located(fixes: Fixes, recording: Recording, sensors: Sensors | None) -> Fixes:
    """The fixes with Cartesian positions placed on Earth, where the recording or sensors.toml tells their reference point."""
    cartesian = np.isnan(fixes.latitude_rad) & np.isfinite(fixes.x_m) & np.isfinite(fixes.y_m)
    if not cartesian.any():
        return fixes
    from ..alignment import locate

    try:
        placed, _ = locate(fixes, sensors or Sensors(sensor=()), recording.sources)
    except SettingsError:
        # They stay without a position, and are counted as such.
        return fixes
    return fixes.replace(latitude_rad=placed.latitude_rad, longitude_rad=placed.longitude_rad)
