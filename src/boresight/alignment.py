"""One frame and one clock: the reference's positions on the ellipsoid, and where each target was at each plot's time.

`locate` makes every fix geodetic with an ellipsoidal height and an accuracy; `overlap` checks the clocks of two recordings
before anything is compared; `trajectories` and `states` give position, velocity, acceleration, heading and covariance of any
target at any time.  METHODS section 6 (heights, reference quality), section 3 (alignment: nearest, linear, cubic).
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from ._jit import kernel
from ._parallel import in_threads, slices
from ._types import AnyArray, BoolArray, FloatArray, IntArray
from .errors import InputError, NothingToDo, SettingsError
from .geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate_back
from .heights import SENSORS_TOML, TRAFFIC, HeightProfile, height_profile
from .measure import position_from_plane
from .model import Channel, Fixes, Flag, Plots, Sensors, Source
from .targets import targets_of

_DAY_S = 86400.0
_T = TypeVar("_T", Plots, Fixes)

# ---------------------------------------------------------------------------------------------------------------- clocks


class ClockCheck(NamedTuple):
    """How two recordings lie in time (UTC seconds).

    `overlap_s` is the length of the common span; `overlap_earlier_s` and `overlap_later_s` what it would be with the fixes 24 h
    earlier or later.  `inside` is the share of the plots that lie within the span of the fixes.  `message` is empty where all
    is well.
    """

    plots_start_s: float
    plots_end_s: float
    fixes_start_s: float
    fixes_end_s: float
    overlap_s: float
    overlap_earlier_s: float
    overlap_later_s: float
    inside: float
    message: str


def apply_time_offsets(table: _T, sensors: Sensors) -> _T:
    """The same plots or fixes with every sensor's (or source's) fixed `time_offset_s` taken from its stamps.

    This is the only place where fixed offsets are applied: call it once.
    """
    column = table.sensor if isinstance(table, Plots) else table.source
    time = table.time_s.copy()
    for sensor in sensors:
        if sensor.time_offset_s != 0:
            time[column == sensor.key] -= sensor.time_offset_s
    return table.replace(time_s=time)


def overlap(plots: Plots, fixes: Fixes) -> ClockCheck:
    """Whether two recordings have time in common.

    Raises NothingToDo where they have none (or where no plot lies within the span of the fixes): it says by how much they miss
    each other, and names 24 h where a shift by a day would help.
    """
    p, f = plots.time_s[np.isfinite(plots.time_s)], fixes.time_s[np.isfinite(fixes.time_s)]
    if not len(p) or not len(f):
        which = "plot" if not len(p) else "reference"
        raise NothingToDo(f"no {which} record has a time stamp", remedy="Without time, plots and reference cannot be compared.")
    p0, p1, f0, f1 = float(p.min()), float(p.max()), float(f.min()), float(f.max())

    def common(shift: float) -> float:
        return min(p1, f1 + shift) - max(p0, f0 + shift)

    inside = float(np.mean((p >= f0) & (p <= f1)))
    both = max(common(0.0), 0.0)
    spans = f"plots {_utc(p0)} to {_utc(p1)}, reference {_utc(f0)} to {_utc(f1)}"
    if inside == 0:
        gap = -common(0.0)
        text = f"the recordings do not overlap in time: {spans}"
        if gap > 0:
            text += f"; they miss each other by {_duration(gap)}"
        helps = [("earlier", common(-_DAY_S)), ("later", common(_DAY_S))]
        way, best = max(helps, key=lambda pair: pair[1])
        if best > 0:
            remedy = f"With the reference 24 h {way} they would overlap for {_duration(best)}: check the dates given (--date)."
        else:
            remedy = (
                "If a clock is off, give time_offset_s (stamp minus true time) of that sensor or source in sensors.toml; "
                "otherwise other recordings are needed."
            )
        raise NothingToDo(text, remedy=remedy)
    message = ""
    if inside < 0.9:
        message = f"only {inside:.0%} of the plots lie within the reference's span ({spans}); the others cannot be compared"
    return ClockCheck(p0, p1, f0, f1, both, max(common(-_DAY_S), 0.0), max(common(_DAY_S), 0.0), inside, message)


def _utc(time_s: float) -> str:
    if not 0 <= time_s < 4e9:
        return f"{time_s:.3f} s"
    stamp = datetime.datetime.fromtimestamp(round(time_s), datetime.UTC)
    # Day 0 stands for a recording without a date.
    return stamp.strftime("%H:%M:%S") if time_s < 2 * _DAY_S else stamp.strftime("%Y-%m-%d %H:%M:%S")


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    if seconds < 7200:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


# ------------------------------------------------------------------------------------------------------------- positions

_KIND_OF_CHANNEL = {Channel.MLAT: "mlat", Channel.ADS_B: "adsb"}
# One sd per axis where a fix says nothing of its accuracy (METHODS section 6 gives what NACp says).
_HORIZONTAL_SD_M = {"adsb": 15.0, "mlat": 5.0, "ais": 10.0}
_OTHER_SD_M = 25.0
_GEOMETRIC_SD_M = 20.0
_GROUND_SD_M = 5.0
_NAMES = {"adsb": "ADS-B", "mlat": "multilateration", "ais": "AIS"}
_FEW = 20


def locate(
    fixes: Fixes, sensors: Sensors, sources: Sequence[Source] = (), *, heights: HeightProfile | None = None
) -> tuple[Fixes, tuple[str, ...]]:
    """The same fixes, all geodetic with ellipsoidal heights and accuracies; and what the user must know of how that was done.

    Cartesian positions become geodetic about their source's reference point (`sensors`, else what the stream itself says in
    `sources`), at the target's own height on the ellipsoid.  Heights that a fix lacks come from its pressure altitude and the
    profile `heights` of geometric minus pressure altitude (default: `height_profile` of these fixes: of the traffic itself, else
    of what `sensors` tells of the atmosphere, else the standard atmosphere), whose sd goes into `vertical_sd_m`; for targets on
    the ground, ships, or targets without any altitude at a surface site, from the ground's height.  Missing accuracies are
    filled by the kind of the source.

    Rows keep their order; a row that cannot be placed keeps NaN and is counted in a warning.  Raises SettingsError where a
    source's reference point is not known.
    """
    said: list[str] = []
    points = {int(key): _reference_point(int(key), sensors, sources) for key in np.unique(fixes.source)}
    height, vertical_sd = _heights(fixes, sensors, points, heights, said)
    latitude, longitude = fixes.latitude_rad.copy(), fixes.longitude_rad.copy()
    cartesian = ~(np.isfinite(latitude) & np.isfinite(longitude)) & np.isfinite(fixes.x_m) & np.isfinite(fixes.y_m)
    for key in np.unique(fixes.source[cartesian]).tolist():
        lat, lon, up = points[key]
        if not (np.isfinite(lat) and np.isfinite(lon)):
            raise SettingsError(
                f"the positions of SAC/SIC {_codes(key)} are Cartesian, but their reference point is not known",
                where="sensors.toml",
                remedy=f'Add a [[sensor]] with {_entry(key)}, kind = "mlat", and lat_deg, lon_deg, height_m of that point.',
            )
        rows = np.flatnonzero(cartesian & (fixes.source == key))
        origin, rotation = ecef_from_geodetic(lat, lon, up if np.isfinite(up) else 0.0), enu_from_ecef(lat, lon)
        # A row without a height gets a latitude and longitude all the same, but stays unusable.
        at = np.where(np.isfinite(height[rows]), height[rows], 0.0)
        placed = position_from_plane(fixes.x_m[rows], fixes.y_m[rows], at, origin, rotation)
        latitude[rows], longitude[rows], _ = geodetic_from_ecef(placed)
    horizontal_sd = _horizontal_sd(fixes, sensors, said)
    lost = ~(np.isfinite(latitude) & np.isfinite(longitude))
    if lost.any():
        said.append(f"{lost.sum():,} of {len(fixes):,} reference records hold no position: not used")
    timeless = ~np.isfinite(fixes.time_s) & ~lost
    if timeless.any():
        said.append(f"{timeless.sum():,} of {len(fixes):,} reference records have no time: not used")
    placed_fixes = fixes.replace(
        latitude_rad=latitude, longitude_rad=longitude, height_m=height, vertical_sd_m=vertical_sd, horizontal_sd_m=horizontal_sd
    )
    return placed_fixes, tuple(said)


def _codes(key: int) -> str:
    return f"{key >> 8}/{key & 255}" if 0 <= key < 65536 else str(key)


def _whose(key: int) -> str:
    return f"SAC/SIC {_codes(key)}" if 0 <= key < 65536 else f"a source without SAC/SIC (id {key})"


def _entry(key: int) -> str:
    return f"sac = {key >> 8}, sic = {key & 255}" if 0 <= key < 65536 else f"id = {key}"


def _reference_point(key: int, sensors: Sensors, sources: Sequence[Source]) -> tuple[float, float, float]:
    """Latitude, longitude (rad) and height (m) of a source's reference point; NaN for what is not known."""
    sensor = sensors.find(key)
    told = next((s for s in sources if s.id == key and np.isfinite(s.latitude_rad) and np.isfinite(s.longitude_rad)), None)
    if sensor is not None and sensor.lat_deg is not None and sensor.lon_deg is not None:
        height = sensor.ellipsoidal_height_m
        if height is None:
            height = told.height_m if told is not None else float("nan")
        return float(np.radians(sensor.lat_deg)), float(np.radians(sensor.lon_deg)), height
    if told is not None:
        return told.latitude_rad, told.longitude_rad, told.height_m
    return float("nan"), float("nan"), float("nan")


def _kinds(fixes: Fixes, sensors: Sensors) -> dict[str, BoolArray]:
    """Which rows come from which kind of source: what sensors.toml says, else what the channel says."""
    kind = np.full(len(fixes), "", dtype="U8")
    for channel, name in _KIND_OF_CHANNEL.items():
        kind[fixes.channel == channel] = name
    kind[(kind == "") & (fixes.mmsi >= 0)] = "ais"
    for sensor in sensors:
        if sensor.kind in _HORIZONTAL_SD_M:
            kind[(fixes.source == sensor.key) & (kind == "")] = sensor.kind
    return {str(name): kind == name for name in np.unique(kind)}


def _horizontal_sd(fixes: Fixes, sensors: Sensors, said: list[str]) -> FloatArray:
    sd = np.where(fixes.horizontal_sd_m > 0, fixes.horizontal_sd_m, np.nan)
    for kind, rows in _kinds(fixes, sensors).items():
        missing = rows & ~np.isfinite(sd)
        if missing.any():
            sd[missing] = _HORIZONTAL_SD_M.get(kind, _OTHER_SD_M)
            said.append(
                f"{missing.sum():,} {_NAMES.get(kind, 'reference')} records do not tell their accuracy: "
                f"{_HORIZONTAL_SD_M.get(kind, _OTHER_SD_M):g} m per axis is assumed"
            )
    return sd


def _heights(
    fixes: Fixes,
    sensors: Sensors,
    points: dict[int, tuple[float, float, float]],
    profile: HeightProfile | None,
    said: list[str],
) -> tuple[FloatArray, FloatArray]:
    """Ellipsoidal heights and their sd (n,) each; NaN where nothing tells."""
    height = fixes.height_m.copy()
    sd = np.where(fixes.vertical_sd_m > 0, fixes.vertical_sd_m, np.nan)
    sd[np.isfinite(height) & ~np.isfinite(sd)] = _GEOMETRIC_SD_M
    on_ground = (fixes.flags & np.uint32(Flag.GROUND)) != 0

    rows = ~np.isfinite(height) & np.isfinite(fixes.pressure_altitude_m) & ~on_ground
    if rows.any():
        profile = height_profile(fixes, sensors) if profile is None else profile
        level = fixes.pressure_altitude_m[rows]
        difference, sd[rows] = profile.at(level, fixes.time_s[rows])
        height[rows] = level + difference
        typical = f"(median {np.median(difference):+.0f} m, sd {np.median(sd[rows]):.0f} m)"
        if profile.source == TRAFFIC:
            whose = f"the geometric-minus-pressure difference that {profile.targets:,} targets of the traffic tell {typical}"
        elif profile.source == SENSORS_TOML:
            whose = f"what [atmosphere] in sensors.toml tells {typical}"
        else:
            whose = (
                "the standard atmosphere, since neither traffic nor [atmosphere] in sensors.toml tells the pressure: "
                f"sd 30 m + 5 % of the height (median {np.median(sd[rows]):.0f} m)"
            )
        said.append(f"{rows.sum():,} reference heights come from pressure altitude and {whose}")

    surface_site, by_the_sea = (any(s.kind == kind for s in sensors) for kind in ("surface", "marine"))
    low = ~np.isfinite(height)
    # Off a coast, what has an aircraft's address and tells no altitude is not therefore a ship.
    rows = low & (on_ground | surface_site | (by_the_sea & (fixes.mode_s < 0)) | (fixes.mmsi >= 0))
    for key in np.unique(fixes.source[rows]).tolist():
        mine = rows & (fixes.source == key)
        ground, ground_sd, why = _ground_height(key, fixes, sensors, points)
        if np.isfinite(ground):
            height[mine], sd[mine] = ground, ground_sd
            said.append(
                f"{mine.sum():,} records of {_whose(key)} without an altitude are taken at {ground:.1f} m on the ellipsoid: {why}"
            )
    if not np.isfinite(height).all():
        nowhere = ~np.isfinite(height) & (np.isfinite(fixes.latitude_rad) | np.isfinite(fixes.x_m))
        if nowhere.any():
            remedy = (
                "give ground_height_m in sensors.toml"
                if (on_ground & nowhere).any()
                else "they carry neither altitude nor ground bit"
            )
            said.append(f"{nowhere.sum():,} reference positions have no height: not used ({remedy})")
    return height, sd


def _ground_height(
    key: int, fixes: Fixes, sensors: Sensors, points: dict[int, tuple[float, float, float]]
) -> tuple[float, float, str]:
    """Height of the ground (m, ellipsoidal), its sd, and where it comes from, for the targets of one source."""
    own = sensors.find(key)
    if own is not None and own.ground_height_m is not None:
        return own.ground_height_m, _GROUND_SD_M, f"ground_height_m of {own.name!r}"
    radars = [s for s in sensors if s.ground_height_m is not None]
    radars.sort(key=lambda s: s.kind not in ("surface", "marine"))
    if radars:
        return radars[0].ground_height_m or 0.0, _GROUND_SD_M, f"ground_height_m of {radars[0].name!r}"
    if np.isfinite(points[key][2]):
        return points[key][2], _GROUND_SD_M, "the height of its reference point (give ground_height_m for a better one)"
    seen = fixes.height_m[((fixes.flags & np.uint32(Flag.GROUND)) != 0) & np.isfinite(fixes.height_m)]
    if len(seen) >= _FEW:
        return float(np.median(seen)), 10.0, f"the median height that {len(seen):,} records of targets on the ground carry"
    antennas = [s for s in sensors if s.kind in ("surface", "marine") and s.ellipsoidal_height_m is not None]
    if antennas:
        return (
            antennas[0].ellipsoidal_height_m or 0.0,
            30.0,
            f"the height of the antenna of {antennas[0].name!r}; an antenna 30 m above the ground makes 0.5 m of range at 1 km "
            "(give ground_height_m)",
        )
    return float("nan"), float("nan"), ""


# ---------------------------------------------------------------------------------------------------------- trajectories

METHODS = ("nearest", "linear", "cubic", "smooth")
_FASTEST_MPS = 400.0
_FASTEST_ON_GROUND_MPS = 120.0
# Half widths of the windows that velocity is fitted over, and how many rows each holds at least (the first: a reported
# velocity alone).  The widest that agrees with the next two narrower ones is used.
_LADDER_S = (0.0, 2.5, 4.5, 8.5, 16.5)
_FEWEST = (1, 3, 5, 7, 9)
_MOST_POINTS = 240
_AGREEMENT = 10.0
# No target pulls much more than this (variance per axis, m^2/s^4): it steadies short windows at the ends of a segment.
_PULL2 = 25.0
_SPIKE = 100.0
_ROUNDS = 2
# Reported velocities are worth using below this sd; neighbouring ones share their errors, hence the factor on the variance.
_WORTH_MPS = 4.0
_SHARED = 2.0
_WILD_MPS = 60.0
_COURSE_MPS = 3.0
# Unknown manoeuvres between two fixes: white acceleration, m^2/s^3.
_MANOEUVRE = 0.05
# Rows that one thread works on at a time.
_PIECE = 1 << 15


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """The targets' ways, ready to be asked for any time with `states`.

    One lane is one target as one source saw it; the rows (k,) are sorted by lane and time.  `row` is each row's fix, `segment`
    changes at every gap.  Positions, velocities and accelerations (k, 3) are ECEF, `up` the local vertical.  `slow_m2` and
    `white_m2` (k, 2), horizontal and vertical, are the variances of a fix's error that neighbouring fixes share and do not
    share.  By lane: `lane_start` (lanes + 1,), `update_s`, `max_gap_s`, `source`; by target: `first_lane` (targets + 1,),
    `length_m`.  `target` (n,) is `targets_of` the fixes.  The counts say what was not used, `warnings` say it in words.  With a
    `view`, `states` are as a moving radar sees them (`platform.View`): it gets them with their times.
    """

    method: str
    target: IntArray
    row: IntArray
    time_s: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    velocity_var: FloatArray
    up: FloatArray
    slow_m2: FloatArray
    white_m2: FloatArray
    time_sd_s: FloatArray
    heading_rad: FloatArray
    segment: IntArray
    lane_start: IntArray
    update_s: FloatArray
    max_gap_s: FloatArray
    source: AnyArray
    first_lane: IntArray
    length_m: FloatArray
    unusable: int
    duplicates: int
    jumps: int
    spikes: int
    warnings: tuple[str, ...]
    view: Viewer | None = None

    @property
    def targets(self) -> int:
        """The number of targets."""
        return len(self.first_lane) - 1


class States(NamedTuple):
    """Where targets are at given times: ECEF position, velocity, acceleration (m, 3), covariance (m, 3, 3) of the position.

    `heading_rad` (m,) is where the target points (carried, else its course above 3 m/s, else NaN), `length_m` (m,) how long it
    is, `source` (m,) the id of the reference that answers. What is not `valid` (no reference near that time) is NaN, and -1.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    covariance: FloatArray
    heading_rad: FloatArray
    length_m: FloatArray
    valid: BoolArray
    source: AnyArray


class Viewer(Protocol):
    """How a moving radar sees the reference (`platform.View`)."""

    def __call__(self, seen: States, time_s: FloatArray) -> States:
        """The states (n,) at times (n,) about one fixed point."""

    def steady(self, plots: Plots) -> Plots:
        """The radar's plots with azimuths that do not turn with the ship: to be followed as tracks, not to be compared."""


def trajectories(fixes: Fixes, *, method: str = "smooth", max_gap_s: float | None = None) -> Trajectories:
    """Sort, clean and fit the fixes of each target, for `states`.

    `fixes` are geodetic with heights (as `locate` makes them); others are counted as unusable.  Equal stamps are averaged;
    jumps that no target can make (400 m/s, on the ground 120 m/s, plus the sd) and lone spikes are dropped.  Nothing is
    interpolated over `max_gap_s` (default: 4 median updates, at least 3 s and at most 20 s, of ships
    120 s).

    Velocity and acceleration come from quadratics fitted over windows of 2 to 16 s on either side, for each fix the widest that
    agrees with the narrower ones (intersection of confidence intervals), with the reported velocity where that is good.
    `method` says how the position is taken between two fixes: `nearest`, `linear`, `cubic` (through the fixes, with the fitted
    velocities) or `smooth` (the same, through the fitted positions).  The default, `smooth`, has 2.5 times less error than
    `cubic` where noise is white (3 m at 1 Hz), is never worse in the tests, and leaves less scatter of a real surface radar
    against both multilateration and ADS-B.

    Raises SettingsError for an unknown method or a gap that is not positive, InputError where the positions are still Cartesian.
    """
    if method not in METHODS:
        raise SettingsError(f"there is no interpolation {method!r}", where="method", remedy=f"Known: {', '.join(METHODS)}.")
    if max_gap_s is not None and not max_gap_s > 0:
        raise SettingsError(f"max_gap_s = {max_gap_s} must be positive", where="max_gap_s")
    target = targets_of(fixes)
    geodetic = np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad)
    if len(fixes) and not geodetic.any() and np.isfinite(fixes.x_m).any():
        raise InputError(
            "the reference's positions are still Cartesian", remedy="Call alignment.locate(fixes, sensors, sources) first."
        )
    usable = geodetic & np.isfinite(fixes.height_m) & np.isfinite(fixes.time_s) & (target >= 0)
    unusable = len(fixes) - int(usable.sum())
    row = np.flatnonzero(usable)
    position = ecef_from_geodetic(fixes.latitude_rad[row], fixes.longitude_rad[row], fixes.height_m[row])
    sd = np.where(fixes.horizontal_sd_m[row] > 0, fixes.horizontal_sd_m[row], _OTHER_SD_M)
    lane_key, lane = _lanes(target[row], fixes.source[row])
    # Rows ascend, and stay so where all else is equal.
    order = np.lexsort((sd, fixes.time_s[row], lane))
    row, position, sd, lane = row[order], position.take(order, axis=0), sd[order], lane[order]
    time = fixes.time_s[row]

    position, keep = _resolve_equal_stamps(lane, time, position, sd)
    duplicates = int((~keep).sum())
    row, position, sd, lane, time = _only(keep, row, position, sd, lane, time)
    on_ground = (fixes.flags[row] & np.uint32(Flag.GROUND)) != 0
    keep = _possible(lane, time, position, sd, on_ground)
    jumps = int((~keep).sum())
    row, position, sd, lane, time = _only(keep, row, position, sd, lane, time)

    spikes = 0
    fitted = _unfitted(len(row))
    redo = np.arange(len(row))
    worth: dict[int, float] = {}
    for attempt in range(_ROUNDS + 1):
        k = len(row)
        lane_start = np.searchsorted(lane, np.arange(len(lane_key) + 1)).astype(np.int64)
        update = _median_update(lane_start, time)
        # Ships do in two minutes what aircraft do in twenty seconds, and small ones report every half minute.
        longest = np.where(np.bincount(lane, fixes.mmsi[row] >= 0, len(lane_key)) > 0, 120.0, 20.0)
        gap = np.full(len(update), max_gap_s) if max_gap_s is not None else np.clip(4 * update, 3.0, longest)
        gap = np.where(np.isfinite(gap), gap, 3.0)
        new = np.r_[True, (np.diff(lane) != 0) | (np.diff(time) > gap[lane[1:]])] if k else np.empty(0, bool)
        segment = np.cumsum(new).astype(np.int64) - 1
        fitted = _fit_all(fixes, row, lane, lane_start, segment, time, position, sd, redo, fitted, worth)
        spike = _lone_spikes(segment, fitted.miss2)
        if not spike.any() or attempt == _ROUNDS:
            break
        spikes += int(spike.sum())
        # Lanes that lose no row keep their fit.
        touched = np.zeros(len(lane_key), bool)
        touched[lane[spike]] = True
        row, position, sd, lane, time = _only(~spike, row, position, sd, lane, time)
        fitted = _Fitted(*_only(~spike, *fitted))
        redo = np.flatnonzero(touched[lane])

    said: list[str] = []
    if unusable:
        said.append(f"{unusable:,} of {len(fixes):,} reference records have no position, height, time or identity: not used")
    if jumps + spikes:
        said.append(
            f"{jumps + spikes:,} of {len(fixes):,} reference positions are outliers (impossible jumps or lone spikes): not used"
        )
    first_lane = np.searchsorted(lane_key >> 32, np.arange(int(target.max(initial=-1)) + 2)).astype(np.int64)
    vertical = np.where(fixes.vertical_sd_m[row] > 0, fixes.vertical_sd_m[row], sd)
    variance = np.stack([sd**2, vertical**2], axis=1)
    white = fitted.scale * variance
    stamp = np.where(fixes.time_sd_s[row] > 0, fixes.time_sd_s[row], 0.0)
    smooth = method == "smooth"
    return Trajectories(
        method=method,
        target=target,
        row=row,
        time_s=time,
        position=np.ascontiguousarray(fitted.position if smooth else position),
        velocity=fitted.velocity,
        acceleration=fitted.acceleration,
        velocity_var=fitted.velocity_var,
        up=fitted.up,
        slow_m2=np.maximum(variance - white, 0.0),
        white_m2=white * fitted.shrink[:, None] if smooth else white,
        time_sd_s=stamp,
        heading_rad=fixes.heading_rad[row],
        segment=segment,
        lane_start=lane_start,
        update_s=update,
        max_gap_s=gap,
        source=lane_key.astype(np.int32),
        first_lane=first_lane,
        length_m=_lengths(fixes, target, len(first_lane) - 1),
        unusable=unusable,
        duplicates=duplicates,
        jumps=jumps,
        spikes=spikes,
        warnings=tuple(said),
    )


def _lanes(target: IntArray, source: AnyArray) -> tuple[IntArray, IntArray]:
    """A key of every pair of target and source that occurs (lanes,), ascending, and the number of each row's (n,)."""
    sources, index = np.unique(source.astype(np.int64) & 0xFFFFFFFF, return_inverse=True)
    pair = target * len(sources) + index
    there = np.bincount(pair, minlength=(int(target.max(initial=-1)) + 1) * len(sources)) > 0
    which = np.flatnonzero(there)
    key = which // max(len(sources), 1) << 32 | sources[which % max(len(sources), 1)]
    return key, (np.cumsum(there) - 1)[pair]


def _only(keep: BoolArray, *columns: AnyArray) -> tuple[AnyArray, ...]:
    """The rows of every column that are kept; the columns themselves where all are."""
    if keep.all():
        return columns
    rows = np.flatnonzero(keep)
    return tuple(column.take(rows, axis=0) for column in columns)


def _resolve_equal_stamps(lane: IntArray, time: FloatArray, position: FloatArray, sd: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Positions with each group of equal stamps averaged into its first row (the best sd), and which rows to keep."""
    n = len(lane)
    if not n:
        return position, np.empty(0, bool)
    first = np.r_[True, (np.diff(lane) != 0) | (np.diff(time) != 0)]
    if first.all():
        return position, first
    start = np.flatnonzero(first)
    leader = start[np.cumsum(first) - 1]
    apart = np.linalg.norm(position - position[leader], axis=1)
    agrees = apart <= 5 * np.hypot(sd, sd[leader])
    weight = np.where(agrees, 1 / sd**2, 0.0)
    shift = np.add.reduceat(weight[:, None] * (position - position[leader]), start) / np.add.reduceat(weight, start)[:, None]
    out = position.copy()
    out[start] += shift
    return out, first


def _lone_spikes(segment: IntArray, miss2: FloatArray) -> BoolArray:
    """Rows that their neighbours' fit misses by ten sd, and by more than it misses the two rows on either side of them."""
    out = miss2 > _SPIKE
    for reach in (1, 2):
        if len(segment) > reach:
            together = segment[reach:] == segment[:-reach]
            out[reach:] &= ~together | (miss2[reach:] > miss2[:-reach])
            out[:-reach] &= ~together | (miss2[:-reach] > miss2[reach:])
    return out


def _possible(lane: IntArray, time: FloatArray, position: FloatArray, sd: FloatArray, on_ground: BoolArray) -> BoolArray:
    """Which rows to keep so that no two neighbours are further apart than a target can move: the most rows, by lane."""
    n = len(lane)
    keep = np.ones(n, bool)
    if n < 2:
        return keep

    def reachable(i: IntArray, j: IntArray) -> BoolArray:
        fastest = np.where(on_ground[i] & on_ground[j], _FASTEST_ON_GROUND_MPS, _FASTEST_MPS)
        # A stamp may be coarse: an eighth of a second is given to each step.
        reach = fastest * (time[j] - time[i] + 0.125) + 6 * np.hypot(sd[i], sd[j])
        return np.asarray(np.linalg.norm(position[j] - position[i], axis=1) <= reach)

    index = np.arange(n)
    broken = (lane[1:] == lane[:-1]) & ~reachable(index[:-1], index[1:])
    for number in np.unique(lane[1:][broken]).tolist():
        begin, end = np.searchsorted(lane, [number, number + 1])
        cut = np.flatnonzero(broken[begin : end - 1]) + begin + 1
        head, tail = np.r_[begin, cut], np.r_[cut, end] - 1
        # The heaviest chain of pieces, each reachable from the one before it; a look back over 50 pieces is enough.
        score, before = (tail - head + 1).astype(np.int64), np.full(len(head), -1)
        for c in range(1, len(head)):
            back = np.arange(max(0, c - 50), c)
            ok = back[reachable(tail[back], np.full(len(back), head[c]))]
            if len(ok):
                best = ok[len(ok) - 1 - int(np.argmax(score[ok][::-1]))]
                score[c], before[c] = score[c] + score[best], best
        keep[begin:end] = False
        c = int(np.argmax(score))
        while c >= 0:
            keep[head[c] : tail[c] + 1] = True
            c = int(before[c])
    return keep


def _median_update(lane_start: IntArray, time: FloatArray) -> FloatArray:
    """Median time between fixes (lanes,); NaN for lanes of fewer than two."""
    count = np.diff(lane_start)
    lane = np.repeat(np.arange(len(count)), count)
    step = np.full(len(time), np.nan)
    if len(time) > 1:
        step[1:] = np.where(np.diff(lane) == 0, np.diff(time), np.nan)
    return _group_median(lane, step, len(count))


def _group_median(group: IntArray, value: FloatArray, groups: int) -> FloatArray:
    """The lower median of the finite values of each group (groups,); NaN for groups without."""
    known = np.isfinite(value)
    g, v = group[known], value[known]
    if np.any(g[1:] < g[:-1]):
        order = np.argsort(g, kind="stable")
        g, v = g[order], v[order]
    start = np.searchsorted(g, np.arange(groups + 1)).tolist()
    out = np.full(groups, np.nan)
    # Selecting within each group is several times faster than sorting all.
    for k, (begin, end) in enumerate(pairwise(start)):
        if end > begin:
            middle = (end - begin - 1) // 2
            out[k] = np.partition(v[begin:end], middle)[middle]
    return out


def _lengths(fixes: Fixes, target: IntArray, targets: int) -> FloatArray:
    return _group_median(np.maximum(target, 0), np.where((target >= 0) & (fixes.length_m > 0), fixes.length_m, np.nan), targets)


class _Fitted(NamedTuple):
    """What is known of every row (k,): its fit, and on the way there the noise ratios `flat` and `tall` of the narrowest window
    and the reported velocities and their weights."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    velocity_var: FloatArray
    up: FloatArray
    scale: FloatArray
    shrink: FloatArray
    miss2: FloatArray
    flat: FloatArray
    tall: FloatArray
    reported: FloatArray
    reported_weight: FloatArray


def _unfitted(k: int) -> _Fitted:
    shapes = ((3,), (3,), (3,), (), (3,), (2,), (), (), (), (), (3,), ())
    return _Fitted(*(np.empty((k, *shape)) for shape in shapes))


def _fit_all(
    fixes: Fixes,
    row: IntArray,
    lane: IntArray,
    lane_start: IntArray,
    segment: IntArray,
    time: FloatArray,
    position: FloatArray,
    sd: FloatArray,
    redo: IntArray,
    before: _Fitted,
    worth: dict[int, float],
) -> _Fitted:
    """Quadratics about every fix; the white part of the noise, by lane; how far each fix lies from its neighbours' fit.

    Only the rows `redo` are fitted; the others stay as they were `before`, whose arrays are written to.  What each source's
    velocities are `worth` is found the first time, and kept.
    """
    k = len(row)
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    low, high = starts[segment], np.append(starts[1:], k)[segment]
    local = time - (time.min() if k else 0.0)
    weight = 1 / sd**2
    no_velocity, no_weight = np.zeros((k, 3)), np.zeros(k)
    up, flat, tall, scale = before.up, before.flat, before.tall, before.scale
    vertical = np.where(fixes.vertical_sd_m[row] > 0, fixes.vertical_sd_m[row], sd)

    def fit(
        rows: IntArray, velocity: FloatArray, velocity_weight: FloatArray, scale: FloatArray, ladder: FloatArray, fewest: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        return _fit(
            rows, local, position, weight, velocity, velocity_weight, up, low, high, scale, ladder, fewest, _AGREEMENT,
            _MOST_POINTS,
        )  # fmt: skip

    def rotation(rows: IntArray) -> FloatArray:
        return enu_from_ecef(fixes.latitude_rad[row[rows]], fixes.longitude_rad[row[rows]])

    # Piece by piece, so that what lies between two steps stays in the processor's cache.
    pieces = [redo[part] for part in slices(len(redo), _PIECE)]

    def noise(rows: IntArray) -> None:
        """The noise that neighbours do not share shows in the narrowest windows, whatever a fix says of its accuracy."""
        up[rows] = rotation(rows)[:, 2]
        # A scale of 0 leaves out what is assumed of accelerations, which would hide some of it.
        found = fit(rows, no_velocity, no_weight, no_weight, np.array(_LADDER_S[1:2]), np.array([5], np.int64))
        leverage = np.minimum(found[4] * weight[rows], 1.0)
        free = leverage < 0.95
        miss = found[0] - position[rows]
        miss_up = np.einsum("ij,ij->i", miss, up[rows])
        miss_flat2 = np.maximum(np.einsum("ij,ij->i", miss, miss) - miss_up**2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            flat[rows] = np.where(free, miss_flat2 / (2 * np.log(2) * (1 - leverage) * sd[rows] ** 2), np.nan)
            tall[rows] = np.where(free, miss_up**2 / (0.4549 * (1 - leverage) * vertical[rows] ** 2), np.nan)

    in_threads(noise, pieces)
    source = fixes.source[row]
    scale[redo, 0] = _pooled_scale(lane, lane_start, source, flat)[redo]
    scale[redo, 1] = _pooled_scale(lane, lane_start, source, tall)[redo]
    flat_scale = np.ascontiguousarray(scale[:, 0])
    ladder, fewest = np.array(_LADDER_S), np.array(_FEWEST, np.int64)
    over_ground = np.empty((k, 3))

    def keep(rows: IntArray, found: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]) -> None:
        before.position[rows], before.velocity[rows], before.acceleration[rows] = found[:3]
        before.velocity_var[rows] = found[3] * flat_scale[rows]
        before.shrink[rows] = np.minimum(found[4] * weight[rows], 1.0)

    def positions(rows: IntArray) -> None:
        found = fit(rows, no_velocity, no_weight, flat_scale, ladder, fewest)
        keep(rows, found)
        over_ground[rows] = np.einsum("nij,nj->ni", rotation(rows), found[1])

    in_threads(positions, pieces)
    velocity, velocity_weight = before.reported, before.reported_weight
    reported, velocity_weight[redo] = _reported(fixes, row[redo], over_ground[redo], before.velocity_var[redo], worth)
    useful = bool((velocity_weight[redo] > 0).any())
    over_ground[redo] = reported

    def turn(rows: IntArray) -> None:
        velocity[rows] = rotate_back(rotation(rows), over_ground[rows])

    in_threads(turn, pieces)
    # Weights are in units of the assumed position noise, so the reported velocity's is scaled to match.
    scaled = velocity_weight * flat_scale

    def both(rows: IntArray) -> None:
        if useful:
            keep(rows, fit(rows, velocity, scaled, flat_scale, ladder, fewest))
        leverage = before.shrink[rows]
        miss = position[rows] - before.position[rows]
        miss -= np.einsum("ij,ij->i", miss, up[rows])[:, None] * up[rows]
        # Out of its own fit: what the fix misses the fit of its neighbours by, in units of that difference's variance.
        own = (1 - leverage) * sd[rows] ** 2 * np.maximum(flat_scale[rows], 0.04)
        with np.errstate(divide="ignore", invalid="ignore"):
            before.miss2[rows] = np.where(leverage < 0.95, np.einsum("ij,ij->i", miss, miss) / (2 * own), 0.0)

    in_threads(both, pieces)
    return before


def _pooled_scale(lane: IntArray, lane_start: IntArray, source: IntArray, ratio: FloatArray) -> FloatArray:
    """Variance of the white noise over the assumed one (k,): the lane's median, drawn to its source's where rows are few."""
    lanes = len(lane_start) - 1
    by_lane = _group_median(lane, ratio, lanes)
    count = np.bincount(lane[np.isfinite(ratio)], minlength=lanes).astype(np.float64)
    key, number = np.unique(source, return_inverse=True)
    by_source = _group_median(number.reshape(-1), ratio, len(key))
    overall = np.where(np.isfinite(by_source), by_source, 1.0)[number.reshape(-1)]
    share = (count / (count + 20.0))[lane]
    mine = np.where(np.isfinite(by_lane[lane]), by_lane[lane], overall)
    return np.clip(share * mine + (1 - share) * overall, 1e-4, 25.0)


def _reported(
    fixes: Fixes, row: IntArray, fitted: FloatArray, fitted_var: FloatArray, worth: dict[int, float]
) -> tuple[FloatArray, FloatArray]:
    """Reported velocities (k, 3), east, north, up, and weights 1 / variance (k,): 0 where there is none or the source's is not
    good.

    What a source's velocities are `worth` (its weight) is measured and noted there, unless it is known: their median distance
    from the `fitted` ones, less the fit's own variance.  A missing vertical rate is the fitted one.
    """
    east, north, climb = fixes.velocity_east_mps[row], fixes.velocity_north_mps[row], fixes.velocity_up_mps[row]
    there = np.isfinite(east) & np.isfinite(north)
    weight = np.zeros(len(row))
    if not there.any():
        return np.zeros((len(row), 3)), weight
    difference2 = (east - fitted[:, 0]) ** 2 + (north - fitted[:, 1]) ** 2
    source = fixes.source[row]
    for key in np.unique(source[there]).tolist():
        mine = there & (source == key)
        if key not in worth:
            worth[key] = 0.0
            # Parked targets would say that any velocity is perfect.
            moving = mine & np.isfinite(fitted_var) & (np.hypot(fitted[:, 0], fitted[:, 1]) > _COURSE_MPS)
            if moving.sum() >= 20:
                # The median, since the tails are mostly those of positions (stamps that jitter).  2 ln 2: chi-square of 2 dof.
                sd2 = float(np.median(difference2[moving])) / (2 * np.log(2)) - float(np.median(fitted_var[moving]))
                worth[key] = 1 / (_SHARED * max(sd2, 0.15**2)) if sd2 <= _WORTH_MPS**2 else 0.0
        weight[mine & (difference2 <= _WILD_MPS**2)] = worth[key]
    return np.stack(
        [np.where(there, east, 0.0), np.where(there, north, 0.0), np.where(np.isfinite(climb), climb, fitted[:, 2])], axis=1
    ), weight


@kernel
def _fit(
    wanted: IntArray,
    time: FloatArray,
    position: FloatArray,
    weight: FloatArray,
    velocity: FloatArray,
    velocity_weight: FloatArray,
    up: FloatArray,
    low: IntArray,
    high: IntArray,
    scale: FloatArray,
    ladder: FloatArray,
    fewest: IntArray,
    agreement: float,
    most: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Weighted quadratics about the `wanted` rows (k,), over the widest window of the ladder that agrees with the next two
    narrower ones.

    A window reaches `ladder` (levels,) seconds to either side, and at least to its `fewest` (levels,) rows.  Rows low[i] …
    high[i] - 1 belong to row i's segment.  `weight` is 1 / variance of a position, `velocity_weight` likewise; `scale` turns
    these variances into true ones for the comparison of windows (Lepski; intersection of confidence intervals): the squared
    horizontal difference of two velocities stays below `agreement` times the variance of that difference.  Returns position,
    velocity, acceleration (k, 3) and the unscaled variances of velocity and position (k,).
    """
    k = len(wanted)
    p_out, v_out, a_out = np.empty((k, 3)), np.full((k, 3), np.nan), np.full((k, 3), np.nan)
    vv_out, pv_out = np.full(k, np.nan), np.empty(k)
    levels = len(ladder)
    seen_p, seen_v, seen_a = np.empty((levels, 3)), np.empty((levels, 3)), np.empty((levels, 3))
    seen_vv, seen_pv = np.empty(levels), np.empty(levels)
    c, m = np.empty((3, 3)), np.empty((3, 3))
    for q in range(k):
        i = wanted[q]
        pv_out[q] = 1.0 / weight[i]
        for d in range(3):
            p_out[q, d] = position[i, d]
        s0 = s1 = s2 = s3 = s4 = 0.0
        g0 = g1 = g2 = 0.0
        m[:] = 0.0
        j_low, j_high = i, i
        count, speeds, seen, last = 0, 0, 0, -1
        begin, end, alone = i, i + 1, False
        for level in range(levels):
            half = ladder[level]
            while True:
                # Take the next nearest row on either side while it is within the window, or while there are too few.
                back = time[i] - time[j_low - 1] if j_low > low[i] else np.inf
                ahead = time[j_high + 1] - time[i] if j_high + 1 < high[i] else np.inf
                nearest = min(back, ahead)
                if nearest == np.inf or count >= most or (nearest > half and j_high - j_low + 1 >= fewest[level]):
                    break
                if back <= ahead:
                    j_low -= 1
                else:
                    j_high += 1
                count += 1
            # Rows that came in since the last level.
            for side in range(2):
                first, stop = (j_low, begin) if side == 0 else (end, j_high + 1)
                for j in range(first, stop):
                    t = time[j] - time[i]
                    w = weight[j]
                    s0 += w
                    s1 += w * t
                    s2 += w * t * t
                    s3 += w * t * t * t
                    s4 += w * t * t * t * t
                    for d in range(3):
                        y = position[j, d] - position[i, d]
                        m[0, d] += w * y
                        m[1, d] += w * t * y
                        m[2, d] += 0.5 * w * t * t * y
                    g = velocity_weight[j]
                    if g > 0.0:
                        speeds += 1
                        g0 += g
                        g1 += g * t
                        g2 += g * t * t
                        for d in range(3):
                            m[1, d] += g * velocity[j, d]
                            m[2, d] += g * t * velocity[j, d]
            if level == 0:
                # The row itself: it is in no ring, and holds no lever but its velocity.
                s0 += weight[i]
                g = velocity_weight[i]
                if g > 0.0:
                    speeds += 1
                    g0 += g
                    for d in range(3):
                        m[1, d] += g * velocity[i, d]
            begin, end = j_low, j_high + 1
            rows = end - begin
            if rows == last:
                continue
            last = rows
            if rows < 2 and speeds == 0:
                continue
            alone = alone or rows < 2
            # Times in units of the window keep the matrix well scaled.
            u = max(time[i] - time[begin], time[end - 1] - time[i], 1e-3)
            n00, n01, n11 = s0, s1 / u, (s2 + g0) / (u * u)
            n02, n12, n22 = (
                0.5 * s2 / (u * u),
                (0.5 * s3 + g1) / (u * u * u),
                (0.25 * s4 + g2 + scale[i] / _PULL2) / (u * u * u * u),
            )
            l00 = np.sqrt(n00)
            l10 = n01 / l00
            rest = n11 - l10 * l10
            if rest <= 1e-9 * n11:
                break
            l11 = np.sqrt(rest)
            quadratic = rows + speeds >= 3
            l20 = l21 = 0.0
            l22 = 1.0
            if quadratic:
                l20 = n02 / l00
                l21 = (n12 - l20 * l10) / l11
                rest = n22 - l20 * l20 - l21 * l21
                if rest > 1e-6 * n22:
                    l22 = np.sqrt(rest)
                else:
                    quadratic = False
                    l20 = l21 = 0.0
            # The inverse of the Cholesky factor, column by column, gives the covariance of the coefficients.
            i00, i11 = 1.0 / l00, 1.0 / l11
            i10 = -l10 * i00 * i11
            i22 = 1.0 / l22 if quadratic else 0.0
            i21 = -l21 * i11 * i22
            i20 = -(l20 * i00 + l21 * i10) * i22
            c[0, 0] = i00 * i00 + i10 * i10 + i20 * i20
            c[0, 1] = i10 * i11 + i20 * i21
            c[0, 2] = i20 * i22
            c[1, 1] = i11 * i11 + i21 * i21
            c[1, 2] = i21 * i22
            c[2, 2] = i22 * i22
            for d in range(3):
                y0, y1, y2 = m[0, d], m[1, d] / u, m[2, d] / (u * u)
                seen_p[seen, d] = position[i, d] + c[0, 0] * y0 + c[0, 1] * y1 + c[0, 2] * y2
                seen_v[seen, d] = (c[0, 1] * y0 + c[1, 1] * y1 + c[1, 2] * y2) / u
                seen_a[seen, d] = (c[0, 2] * y0 + c[1, 2] * y1 + c[2, 2] * y2) / (u * u)
            seen_vv[seen], seen_pv[seen] = c[1, 1] / (u * u), c[0, 0]
            seen += 1
        for level in range(seen - 1, -1, -1):
            agrees = True
            for other in range(max(level - 2, 0), level):
                d2, du = 0.0, 0.0
                for d in range(3):
                    y = seen_v[level, d] - seen_v[other, d]
                    d2 += y * y
                    du += y * up[i, d]
                spread = (seen_vv[other] - seen_vv[level]) * scale[i]
                if d2 - du * du > agreement * max(spread, 0.0) + 1e-12:
                    agrees = False
            if agrees:
                # One velocity alone tells no acceleration: the next window does.
                bent = level + 1 if level == 0 and alone and seen > 1 else level
                for d in range(3):
                    p_out[q, d], v_out[q, d], a_out[q, d] = seen_p[level, d], seen_v[level, d], seen_a[bent, d]
                vv_out[q], pv_out[q] = seen_vv[level], seen_pv[level]
                break
    return p_out, v_out, a_out, vv_out, pv_out


# ---------------------------------------------------------------------------------------------------------------- states


def states(trajectories: Trajectories, target: IntArray, time_s: FloatArray) -> States:
    """Where `target` (m,) (numbers of `targets_of`) is at `time_s` (m,), UTC seconds.

    Never across a gap of the reference, never more than half an update beyond its ends: there `valid` is False and all is NaN.
    Of several sources that see a target at that time, the one with the smallest covariance answers.  The covariance holds the
    fix's own variance, what interpolation adds, and the velocity times the uncertainty of the stamp.
    """
    target = np.ascontiguousarray(target, np.int64)
    time = np.ascontiguousarray(time_s, np.float64)
    if target.shape != time.shape or target.ndim != 1:
        raise InputError(f"target {target.shape} and time_s {time.shape} need one row each a state")
    t, m = trajectories, len(time)
    if not len(t.time_s):
        nothing, vector = np.full(m, np.nan), np.full((m, 3), np.nan)
        return States(
            vector, vector, vector, np.full((m, 3, 3), np.nan), nothing, nothing, np.zeros(m, bool), np.full(m, -1, np.int32)
        )

    position, velocity, acceleration, covariance = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
    heading, valid, lane = np.empty(m), np.empty(m, bool), np.empty(m, np.int64)

    def piece(part: slice) -> None:
        _states(
            target[part], time[part], METHODS.index(t.method), t.time_s, t.position, t.velocity, t.acceleration, t.velocity_var,
            t.up, t.slow_m2, t.white_m2, t.time_sd_s, t.heading_rad, t.segment, t.lane_start, t.update_s, t.first_lane,
            position[part], velocity[part], acceleration[part], covariance[part], heading[part], valid[part], lane[part],
        )  # fmt: skip

    in_threads(piece, slices(m, _PIECE))
    known = (target >= 0) & (target < t.targets)
    length = np.where(known & valid, t.length_m[np.where(known, target, 0)], np.nan)
    source = np.where(valid, t.source[np.maximum(lane, 0)], np.int32(-1))
    found = States(position, velocity, acceleration, covariance, heading, length, valid, source)
    return found if t.view is None else t.view(found, time)


@kernel
def _states(
    target: IntArray,
    time: FloatArray,
    method: int,
    knot: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    velocity_var: FloatArray,
    up: FloatArray,
    slow: FloatArray,
    white: FloatArray,
    stamp_sd: FloatArray,
    carried: FloatArray,
    segment: IntArray,
    lane_start: IntArray,
    update: FloatArray,
    first_lane: IntArray,
    p_out: FloatArray,
    v_out: FloatArray,
    a_out: FloatArray,
    c_out: FloatArray,
    heading: FloatArray,
    valid: BoolArray,
    answers: IntArray,
) -> None:
    """Interpolate (see `states`) into the last seven arguments.  `method` is the index in `METHODS`."""
    m = len(time)
    p_out[:], v_out[:], a_out[:], c_out[:], heading[:] = np.nan, np.nan, np.nan, np.nan, np.nan
    valid[:], answers[:] = False, -1
    p, v, a = np.empty(3), np.empty(3), np.empty(3)
    for q in range(m):
        if target[q] < 0 or target[q] >= len(first_lane) - 1 or not np.isfinite(time[q]):
            continue
        best = np.inf
        for lane in range(first_lane[target[q]], first_lane[target[q] + 1]):
            begin, end = lane_start[lane], lane_start[lane + 1]
            if end - begin < 2:
                continue
            t = time[q]
            # The last row that is not later than t, by halving (clipped so that there is a next one).
            i, above = begin, end - 1
            while above - i > 1:
                middle = (i + above) // 2
                if knot[middle] <= t:
                    i = middle
                else:
                    above = middle
            j = i + 1
            half = 0.5 * update[lane]
            if segment[i] != segment[j] or t < knot[i] or t > knot[j]:
                # Beyond an end: the nearer knot alone answers, for half an update.
                i = i if abs(t - knot[i]) <= abs(t - knot[j]) else j
                j = i
                if abs(t - knot[i]) > half:
                    continue
            if not np.isfinite(velocity_var[i]) or not np.isfinite(velocity_var[j]):
                continue
            step = knot[j] - knot[i]
            s = t - knot[i]
            w = s / step if j > i else 0.0
            near = j if w > 0.5 else i
            flat, tall, along, bend = 0.0, 0.0, 0.0, 0.0
            for d in range(3):
                vi, vj = velocity[i, d] + acceleration[i, d] * s, velocity[j, d] + acceleration[j, d] * (s - step)
                v[d] = (1 - w) * vi + w * vj
                a[d] = (1 - w) * acceleration[i, d] + w * acceleration[j, d]
            if method == 0:
                f = 1.0
                for d in range(3):
                    p[d] = position[near, d]
                along = t - knot[near]
            elif j == i:
                f = 1.0
                for d in range(3):
                    p[d] = position[i, d] + velocity[i, d] * s + (0.5 * s * s * acceleration[i, d] if method != 1 else 0.0)
                flat = s * s * velocity_var[i] + 0.25 * s * s * s * s
            elif method == 1:
                f = (1 - w) * (1 - w) + w * w
                for d in range(3):
                    p[d] = (1 - w) * position[i, d] + w * position[j, d]
                bend = 0.5 * s * (step - s)
                flat = _MANOEUVRE * step * step * step * w * w * (1 - w) * (1 - w) / 3
            else:
                h00, h01 = (1 + 2 * w) * (1 - w) * (1 - w), w * w * (3 - 2 * w)
                h10, h11 = w * (1 - w) * (1 - w) * step, w * w * (w - 1) * step
                f = h00 * h00 + h01 * h01 if method == 2 else 1.0
                speed2, pull2 = 0.0, 0.0
                for d in range(3):
                    p[d] = h00 * position[i, d] + h01 * position[j, d] + h10 * velocity[i, d] + h11 * velocity[j, d]
                    speed2 += v[d] * v[d]
                    pull2 += a[d] * a[d]
                # A cubic through a circle misses by a omega^2 step^4 w^2 (1-w)^2 / 24; the rest is what may happen between.
                miss = pull2 * np.sqrt(pull2) / max(speed2, 1.0) * (s * (step - s)) ** 2 / 24
                flat = h10 * h10 * velocity_var[i] + h11 * h11 * velocity_var[j] + miss * miss
                flat += _MANOEUVRE * (s * (step - s) / step) ** 3 / 3
            hor = (1 - w) * slow[i, 0] + w * slow[j, 0] + f * ((1 - w) * white[i, 0] + w * white[j, 0]) + flat
            ver = (1 - w) * slow[i, 1] + w * slow[j, 1] + f * ((1 - w) * white[i, 1] + w * white[j, 1]) + flat + tall
            tau = max(stamp_sd[i], stamp_sd[j])
            stamped = tau * tau + along * along
            total = 2 * hor + ver
            for d in range(3):
                total += stamped * v[d] * v[d] + bend * bend * a[d] * a[d]
            if not total < best:
                continue
            best = total
            valid[q] = True
            answers[q] = lane
            for d in range(3):
                p_out[q, d], v_out[q, d], a_out[q, d] = p[d], v[d], a[d]
                for e in range(d + 1):
                    both = (ver - hor) * (up[near, d] * up[near, e]) + stamped * (v[d] * v[e]) + bend * bend * (a[d] * a[e])
                    c_out[q, d, e] = both
                    c_out[q, e, d] = both
                c_out[q, d, d] += hor
            hi, hj = carried[i], carried[j]
            if np.isfinite(hi) and np.isfinite(hj):
                turn = (hj - hi + np.pi) % (2 * np.pi) - np.pi
                heading[q] = (hi + w * turn) % (2 * np.pi)
            elif np.isfinite(hi) or np.isfinite(hj):
                heading[q] = (hi if np.isfinite(hi) else hj) % (2 * np.pi)
            else:
                # Course over ground: east is along (-up_y, up_x, 0), north is up x east.
                side = max(np.hypot(up[near, 0], up[near, 1]), 1e-12)
                east = (-up[near, 1] * v[0] + up[near, 0] * v[1]) / side
                north = side * v[2] - up[near, 2] * (up[near, 0] * v[0] + up[near, 1] * v[1]) / side
                heading[q] = np.arctan2(east, north) % (2 * np.pi) if np.hypot(east, north) > _COURSE_MPS else np.nan
