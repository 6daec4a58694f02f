"""Tables as things on a map: where each row lies, which target it belongs to, and what is said of it in people's units."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._types import AnyArray, FloatArray, IntArray
from ..errors import InputError, SettingsError
from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef
from ..measure import plot_positions, position_from_height
from ..model import Channel, Platform, Plots, Sensors, unpack_callsigns
from ..platform import plot_places
from .tables import _columns

BLOCK = 16384
# A target's line is broken where it was not seen for so long.
GAP_S = 120.0
_BEYOND_S = 5.0
_IDENTITIES = ("mode_s", "mmsi", "callsign", "target", "track")
_ABSENT = ("sensor", "source", "mmsi", "track", "target", "plot", "record")


@dataclass(frozen=True, slots=True)
class Features:
    """The rows of a table that have a place on Earth, in their order.

    `longitude_deg`, `latitude_deg` and ellipsoidal `height_m` (NaN: not known) are (n,), as are `time_s` and `target` (a
    number for each target; -1: none is known).  `names` are the targets' names; `columns` the properties with how each is
    written; `without` how many rows have no place.
    """

    kind: str
    longitude_deg: FloatArray
    latitude_deg: FloatArray
    height_m: FloatArray
    time_s: FloatArray
    target: IntArray
    names: tuple[str, ...]
    columns: tuple[tuple[str, AnyArray, Callable[[Any], Any]], ...]
    without: int

    def __len__(self) -> int:
        return len(self.time_s)

    def properties(self, begin: int, end: int) -> Iterator[dict[str, Any]]:
        """What is said of the rows begin … end - 1: absent values are not named."""
        values = [(name, column[begin:end].tolist(), write) for name, column, write in self.columns]
        for k in range(end - begin):
            out = {}
            for name, column, write in values:
                told = write(column[k])
                if told is not None:
                    out[name] = told
            yield out

    def lines(self, gap_s: float = GAP_S) -> Iterator[tuple[int, IntArray]]:
        """Each target's rows in the order of time, in pieces of two rows or more without a gap longer than `gap_s`."""
        rows = np.flatnonzero((self.target >= 0) & np.isfinite(self.time_s))
        rows = rows[np.lexsort((self.time_s[rows], self.target[rows]))]
        if not len(rows):
            return
        new = np.diff(self.target[rows]) != 0
        cuts = np.flatnonzero(new | (np.diff(self.time_s[rows]) > gap_s)) + 1
        for piece in np.split(rows, cuts):
            if len(piece) > 1:
                yield int(self.target[piece[0]]), piece


def features_of(
    table: Any, sensors: Sensors | None = None, *, kind: str | None = None, platform: Platform | None = None
) -> Features:
    """Where the rows of a table lie.

    `table` is a Plots (which needs `sensors`, or for a moving radar its `platform`), Fixes, Tracks or Platform table, or any
    dataclass or mapping of arrays with `latitude_rad` and `longitude_rad` (or `latitude_deg`, `longitude_deg`), such as
    residuals.  Raises SettingsError where plots come without sensors, InputError for a table without positions.
    """
    flat = dict(_columns(table))
    kind = kind or type(table).__name__.lower()
    if isinstance(table, Plots):
        latitude, longitude, height = geodetic_from_ecef(_plot_places(table, sensors, platform))
        latitude, longitude = np.degrees(latitude), np.degrees(longitude)
        # Where only the ground or a pressure level placed it, the height is no measured one.
        height = np.where(np.isfinite(table.height_m) | np.isfinite(table.elevation_rad), height, np.nan)
    else:
        latitude, longitude = (_degrees(flat, name) for name in ("latitude", "longitude"))
        height = np.asarray(flat.get("height_m", np.full(len(latitude), np.nan)), np.float64)
        flat = {n: v for n, v in flat.items() if n not in ("latitude_rad", "longitude_rad", "latitude_deg", "longitude_deg")}
    there = np.isfinite(latitude) & np.isfinite(longitude) & (np.abs(latitude) <= 90)
    longitude = np.where(longitude > 180, longitude - 360, longitude)
    time = np.asarray(flat.get("time_s", np.full(len(latitude), np.nan)), np.float64)
    target, names = _targets(flat, len(latitude), kind)
    columns = tuple(
        (_outside(name), np.asarray(values)[there], _writer(name, np.asarray(values)))
        for name, values in flat.items()
        if not _is_empty(name, np.asarray(values))
    )
    return Features(
        kind, longitude[there], latitude[there], height[there], time[there], target[there], names, columns,
        int(np.count_nonzero(~there)),
    )  # fmt: skip


def _plot_places(plots: Plots, sensors: Sensors | None, platform: Platform | None) -> FloatArray:
    """ECEF positions (n, 3) of plots: of fixed radars by `sensors`, of moving ones about where their platform was."""
    out = np.full((len(plots), 3), np.nan)
    moving = np.isin(plots.sensor, platform.sensor) if platform is not None else np.zeros(len(plots), bool)
    if not moving.all():
        if sensors is None:
            raise SettingsError(
                "plots are ranges and azimuths: where they lie depends on the radar's own position",
                where="sensors",
                remedy="Give sensors.toml.",
            )
        out[~moving] = plot_positions(plots[~moving], sensors)
    if platform is None:
        return out
    for key in np.unique(plots.sensor[moving]).tolist():
        rows = np.flatnonzero(moving & (plots.sensor == key))
        own = platform[(platform.sensor == key) & np.isfinite(platform.latitude_rad) & np.isfinite(platform.time_s)]
        time, first = np.unique(own.time_s, return_index=True)
        if not len(time):
            continue
        own = own[first]
        own_height = np.nan_to_num(own.height_m)
        path = ecef_from_geodetic(own.latitude_rad, own.longitude_rad, own_height)
        at = np.stack([np.interp(plots.time_s[rows], time, path[:, k]) for k in range(3)], axis=1)
        sensor = sensors.find(key) if sensors is not None else None
        ground = sensor.ground_height_m if sensor is not None and sensor.ground_height_m is not None else None
        level = np.interp(plots.time_s[rows], time, own_height) if ground is None else np.full(len(rows), ground)
        height = np.where(np.isfinite(plots.height_m[rows]), plots.height_m[rows], level)
        if sensor is not None and (sensor.angles != "north" or sensor.lever_arm_m is not None):
            out[rows] = plot_places(plots.take(rows), platform, sensor, height)
            continue
        # Beyond the platform's reports by more than this nobody knows where it was.
        known = (plots.time_s[rows] >= time[0] - _BEYOND_S) & (plots.time_s[rows] <= time[-1] + _BEYOND_S)
        rows, at, height = rows[known], at[known], height[known]
        latitude, longitude, _ = geodetic_from_ecef(at)
        north = 0.0 if sensor is None else math.radians(sensor.north_offset_deg)
        azimuth = plots.azimuth_rad[rows] + north
        out[rows] = position_from_height(plots.range_m[rows], azimuth, height, at, enu_from_ecef(latitude, longitude))
    return out


def _degrees(flat: Mapping[str, AnyArray], name: str) -> FloatArray:
    if f"{name}_rad" in flat:
        return np.degrees(np.asarray(flat[f"{name}_rad"], np.float64))
    if f"{name}_deg" in flat:
        return np.asarray(flat[f"{name}_deg"], np.float64)
    raise InputError(
        f"the table has no {name}_rad or {name}_deg; it has: {', '.join(flat)}", remedy="Only what has a position goes on a map."
    )


def _targets(flat: Mapping[str, AnyArray], n: int, kind: str) -> tuple[IntArray, tuple[str, ...]]:
    """A number for each row's target and the targets' names, by the best identity that the row carries."""
    number = np.full(n, -1, np.int64)
    names: list[str] = []
    owner = flat.get("sensor", flat.get("source"))
    if kind == "platform":
        owner, flat = None, dict(flat) | {"target": np.asarray(flat.get("sensor", np.zeros(n)))}
    for identity in _IDENTITIES:
        values = flat.get(identity)
        if values is None or np.asarray(values).dtype.kind not in "iu":
            continue
        values = np.asarray(values, np.int64)
        rows = np.flatnonzero((number < 0) & (values >= 0))
        if not len(rows):
            continue
        # Track numbers are the source's own.
        source = np.asarray(owner, np.int64)[rows] if identity == "track" and owner is not None else np.zeros(len(rows), np.int64)
        pairs, back = np.unique(np.stack([source, values[rows]], axis=1), axis=0, return_inverse=True)
        number[rows] = len(names) + back.reshape(-1)
        several = len(np.unique(source)) > 1
        names += [_name(identity, int(value), int(one) if several else None) for one, value in pairs]
    if kind == "platform":
        names = [f"own ship {n.removeprefix('target ')}" for n in names]
    return number, tuple(names)


def _name(identity: str, value: int, source: int | None) -> str:
    if identity == "mode_s":
        return f"{value:06X}"
    if identity == "callsign":
        return unpack_callsigns(np.array([value], np.int64))[0]
    if identity == "mmsi":
        return f"MMSI {value:09d}"
    return f"{identity} {value}" + ("" if source is None else f" of {source}")


def _is_empty(name: str, values: AnyArray) -> bool:
    if values.dtype.kind == "f":
        return not np.isfinite(values).any()
    if values.dtype.kind in "iu" and (name in _ABSENT or name in _IDENTITIES or name == "mode_3a"):
        return not (values >= 0).any()
    return name in ("flags", "channel") and not values.any()


def _outside(name: str) -> str:
    if name == "time_s" or name.endswith("_time_s"):
        return name.removesuffix("_s")
    angle = re.fullmatch(r"(.*_)rad(_\d+)?", name)
    return f"{angle[1]}deg{angle[2] or ''}" if angle else name


def iso(time_s: float) -> str | None:
    """UTC as 2016-01-12T13:02:11.218Z, with as many decimals as it needs (at most six); None where it is not known."""
    if not math.isfinite(time_s):
        return None
    # Whole microseconds, so that nothing is rounded twice.
    moment = datetime.datetime(1970, 1, 1) + datetime.timedelta(microseconds=round(time_s * 1e6))
    text = moment.isoformat(timespec="microseconds").rstrip("0").rstrip(".")
    return text + "Z"


def _number(digits: int) -> Callable[[Any], Any]:
    def write(value: Any) -> Any:
        return round(value, digits) if math.isfinite(value) else None

    return write


def _known(value: Any) -> Any:
    return None if value < 0 else value


def _writer(name: str, values: AnyArray) -> Callable[[Any], Any]:
    """How a value is written; absent ones give None."""
    if values.dtype.kind == "f":
        if _outside(name) != name and not _outside(name).endswith("deg") and "deg_" not in _outside(name):
            return iso
        if "_rad" in name:
            return lambda v: round(math.degrees(v), 7) if math.isfinite(v) else None
        return _number(4)
    if values.dtype.kind in "iu":
        if name == "channel":
            return {c.value: c.name.lower() for c in Channel}.get
        if name == "mode_s":
            return lambda v: None if v < 0 else f"{v:06X}"
        if name == "mode_3a":
            return lambda v: None if v < 0 else f"{v:04o}"
        if name == "callsign":
            return lambda v: None if v < 0 else unpack_callsigns(np.array([v], np.int64))[0]
        if name == "flags":
            return lambda v: v or None
        return _known if name in _ABSENT else lambda v: v
    if values.dtype.kind == "b":
        return bool
    return lambda v: None if v in (None, "") else str(v)


def tables_of(recording: Any) -> dict[str, Any]:
    """The tables of a recording that hold anything, by kind: plots, fixes, tracks, platform."""
    named: dict[str, Any] = {
        "plots": recording.plots,
        "fixes": recording.fixes,
        "tracks": recording.tracks,
        "platform": recording.platform,
    }
    return {kind: table for kind, table in named.items() if len(table)}
