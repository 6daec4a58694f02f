"""Scripted targets: aircraft and ships whose ways a scenario gives, or that a recording gave, as smooth functions of time.

Ways on the ellipsoid are integrated from their exact equations (fourth-order Runge-Kutta); a constant course is a geodesic.
Where a rate begins or ends it is blended over seconds, so that velocity, acceleration and jerk are continuous.  As with all
other targets the truth is then the quintic spline through these positions.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import msgspec
import numpy as np

from .._types import AnyArray, FloatArray, IntArray
from ..errors import InputError, SettingsError
from ..geodesy import E2, SEMI_MAJOR_M, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from ..measure import position_from_height, position_from_plane
from ..model import Fixes, Recording, Sensors, Tracks, pack_callsigns, unpack_callsigns
from .reference import equip_aircraft
from .truth import GRAVITY_MPS2, STEP_S, Aircraft, Atmosphere, Ships, Traffic, Truth, smooth_curve

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .radar import Radar
    from .reference import Adsb, Ais


class Waypoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A place on a target's way.  `speed_mps` holds from here to the next one; `time_s` is when it is reached instead.

    Times count from the scene's start; all waypoints of a target have one, or none has.  `height_m` is left out for ships.
    """

    lat_deg: float
    lon_deg: float
    height_m: float | None = None
    speed_mps: float | None = None
    time_s: float | None = None


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A target whose way is given: a ``[[target]]`` table of a scenario.

    It begins at `start_s` after the scene's start at `lat_deg`, `lon_deg`, or at slant range `range_m` and true azimuth
    `azimuth_deg` of the radar named `radar` (which may be left out where there is but one), and moves over ground with
    `speed_mps`.  Its `kind`:

    * ``straight``: along `course_deg`, a geodesic.
    * ``turning``: from that course with `turn_dps` degrees a second (positive to the right) from `turn_after_s` on, altogether by
      `turn_by_deg` degrees (left out: for ever).
    * ``serpentine``: along that course, aside of it by ``amplitude_m sin(2 pi t / period_s + phase_deg)``, positive right.  The
      speed is that along the course.
    * ``approaching``: straight towards the radar named `towards`, or towards `towards_lat_deg`, `towards_lon_deg`; it ends there.
    * ``waypoints``: from `waypoint` to waypoint; corners are rounded with the bank of an airliner or the rudder of a ship.
    * ``replay``: what `recording` (any file that can be read) tells of one target, which `mode_s`, `mmsi`, `callsign` or `track`
      names where it holds several.  Without `start_s` at the times of the recording, else from `start_s` on.  The positions are
      smoothed as those of a reference are, gaps up to two minutes are bridged; of what is longer apart the longest piece counts.
      `date` is the UTC date of a file that tells only times of day.

    `height_m` is ellipsoidal, or with `pressure_levels` a pressure altitude, as flight levels are.  Of the first four kinds any
    may climb: with `climb_mps` (negative: descend) from `climb_after_s` on, up to `to_height_m` (left out: for ever).

    `craft` is ``aircraft`` or ``ship`` (left out: ship where there is an MMSI).  A ship sails on the sea and needs no height.
    With `count` there are copies of it, each `spacing_m` from the last one in the direction `spacing_deg` (left out: to the right
    of the first course; of a replay east) and `spacing_s` later.  Addresses (hexadecimal) and MMSI of copies count upwards,
    callsigns have their number appended.  What is not given of identity and size is drawn; `adsb` says whether an aircraft
    has ADS-B (left out: drawn with the share of the scene).  It ends at `end_s` or with the scene.
    """

    name: str = ""
    kind: str = "straight"
    craft: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    radar: str | None = None
    range_m: float | None = None
    azimuth_deg: float | None = None
    height_m: float | None = None
    pressure_levels: bool = False
    speed_mps: float | None = None
    course_deg: float | None = None
    turn_dps: float | None = None
    turn_after_s: float = 0.0
    turn_by_deg: float | None = None
    amplitude_m: float | None = None
    period_s: float | None = None
    phase_deg: float = 0.0
    climb_mps: float = 0.0
    climb_after_s: float = 0.0
    to_height_m: float | None = None
    towards: str | None = None
    towards_lat_deg: float | None = None
    towards_lon_deg: float | None = None
    waypoint: tuple[Waypoint, ...] = ()
    recording: str | None = None
    track: int | None = None
    date: datetime.date | None = None
    start_s: float | None = None
    end_s: float | None = None
    count: int = 1
    spacing_m: float = 0.0
    spacing_deg: float | None = None
    spacing_s: float = 0.0
    mode_s: str | None = None
    mode_3a: str | None = None
    callsign: str | None = None
    mmsi: int | None = None
    length_m: float | None = None
    adsb: bool | None = None


_START = ("lat_deg", "lon_deg", "radar", "range_m", "azimuth_deg", "speed_mps", "height_m", "pressure_levels")
_CLIMB = ("climb_mps", "climb_after_s", "to_height_m")
# What each kind needs, and what else it may have.
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "straight": (("speed_mps", "course_deg"), (*_START, *_CLIMB)),
    "turning": (("speed_mps", "course_deg", "turn_dps"), (*_START, *_CLIMB, "turn_after_s", "turn_by_deg")),
    "serpentine": (("speed_mps", "course_deg", "amplitude_m", "period_s"), (*_START, *_CLIMB, "phase_deg")),
    "approaching": (("speed_mps",), (*_START, *_CLIMB, "towards", "towards_lat_deg", "towards_lon_deg")),
    "waypoints": (("waypoint",), ("speed_mps", "height_m", "pressure_levels")),
    "replay": (("recording",), ("track", "date", "height_m", "pressure_levels")),
}
_ANY = (
    "name", "kind", "craft", "start_s", "end_s", "count", "spacing_m", "spacing_deg", "spacing_s", "mode_s", "mode_3a",
    "callsign", "mmsi", "length_m", "adsb",
)  # fmt: skip
_FASTEST_MPS = {"aircraft": 1000.0, "ship": 60.0}
_LOWEST_M, _HIGHEST_M = -500.0, 40e3


def is_ship(target: Target) -> bool:
    """Whether a target is a ship: what `craft` says, else whether it has an MMSI."""
    return target.craft == "ship" if target.craft is not None else target.mmsi is not None


def check_target(target: Target, radars: Sequence[Radar], duration_s: float, *, adsb: bool = True, where: str = "target") -> None:
    """Raise SettingsError for a target that cannot be simulated, with what would do.

    `adsb` tells whether the scene has ADS-B.  What only the recording of a replay can tell is not asked here.
    """
    error = next(target_faults(target, radars, duration_s, adsb), None)
    if error is not None:
        raise SettingsError(error[0], where=where, remedy=error[1])


def target_faults(target: Target, radars: Sequence[Radar], duration_s: float, adsb: bool) -> Iterator[tuple[str, str]]:
    """What is wrong with a target, and the remedy (which may be empty), one after the other; arguments as in `check_target`."""
    if target.kind not in _KINDS:
        yield (
            f"kind = {target.kind!r} is no way that a target moves",
            f'Known: {", ".join(_KINDS)}. A climb is climb_mps, a ship is craft = "ship".',
        )
        return
    if target.craft not in (None, "aircraft", "ship"):
        yield f"craft = {target.craft!r} is not simulated", "Known: aircraft, ship."
    needs, may = _KINDS[target.kind]
    for name in needs:
        if getattr(target, name) in (None, ()):
            yield f"kind = {target.kind!r} needs {name}", ""
    given = [name for name in target.__struct_fields__ if getattr(target, name) != getattr(_PLAIN, name)]
    idle = [name for name in given if name not in (*needs, *may, *_ANY)]
    if idle:
        yield f"{', '.join(idle)}: of no use for kind = {target.kind!r}", f"It has: {', '.join(dict.fromkeys((*needs, *may)))}."
    for name in given:
        value = getattr(target, name)
        if isinstance(value, float) and not math.isfinite(value):
            yield f"{name} = {value} is no number to work with", ""
    ship = is_ship(target)
    fastest = _FASTEST_MPS["ship" if ship else "aircraft"]
    if target.speed_mps is not None and not 0 <= target.speed_mps <= fastest:
        yield f"speed_mps = {target.speed_mps:g} is not within 0 … {fastest:g}", ""
    yield from _faults_of_time(target, duration_s)
    yield from _faults_of_identity(target, ship, adsb)
    if target.kind == "replay" and target.pressure_levels and target.height_m is None:
        yield "pressure_levels says what height_m is, and there is none", "Leave it out: the recording's own are known."
    if target.kind in ("waypoints", "replay"):
        yield from _faults_of_waypoints(target, ship, fastest) if target.kind == "waypoints" else ()
        return
    yield from _faults_of_start(target, radars, ship)
    if target.kind == "turning" and target.turn_dps is not None:
        if not 0 < abs(target.turn_dps) <= 30:
            yield f"turn_dps = {target.turn_dps:g} is not within -30 … 30, or it is 0", ""
        if target.turn_after_s < 0 or (target.turn_by_deg is not None and not target.turn_by_deg > 0):
            yield "turn_after_s must not be negative, turn_by_deg must be positive", "The sign of turn_dps says which way."
    if target.kind == "serpentine" and target.amplitude_m is not None and target.period_s is not None:
        if not (0 < target.amplitude_m <= 50e3 and 2 <= target.period_s <= 36_000):
            yield "amplitude_m must be within 0 … 50,000 and period_s within 2 … 36,000", ""
        else:
            pull = target.amplitude_m * (2 * math.pi / target.period_s) ** 2 / GRAVITY_MPS2
            if pull > 12:
                yield f"such a serpentine pulls {pull:.0f} g", "Lessen amplitude_m, or lengthen period_s."
    yield from _faults_of_climb(target, ship)


def _faults_of_time(target: Target, duration_s: float) -> Iterator[tuple[str, str]]:
    start, end = target.start_s or 0.0, target.end_s
    if not (start >= 0 and start + (target.count - 1) * target.spacing_s < duration_s):
        yield f"start_s = {start:g} is not within the scene (0 … {duration_s:g} s)", "Copies start spacing_s one after the other."
    if end is not None and not end > start:
        yield f"end_s = {end:g} is not after start_s = {start:g}", ""
    if not 1 <= target.count <= 1000:
        yield f"count = {target.count} is not within 1 … 1,000", ""
    if target.count == 1 and (target.spacing_m, target.spacing_deg, target.spacing_s) != (0.0, None, 0.0):
        yield "spacing is that of copies, and there is one target", "Give count, or leave out the spacing."
    if target.count > 1 and target.spacing_m == 0 and target.spacing_s == 0:
        yield "its copies lie on one another", "Give spacing_m or spacing_s."
    if target.spacing_s < 0 or not 0 <= target.spacing_m <= 100e3:
        yield "spacing_m must be within 0 … 100,000 and spacing_s not negative", ""
    if target.spacing_deg is not None and target.spacing_m == 0:
        yield "spacing_deg is of no use without spacing_m", ""


def _faults_of_identity(target: Target, ship: bool, adsb: bool) -> Iterator[tuple[str, str]]:
    if target.mode_s is not None and not _is_number(target.mode_s, 16, 0xFFFFFF - target.count):
        yield f"mode_s = {target.mode_s!r} is no address", "Six hexadecimal digits, as 3C6589."
    if target.mode_3a is not None and not _is_number(target.mode_3a, 8, 0o7777, zero=True):
        yield f"mode_3a = {target.mode_3a!r} is no code", "Four octal digits, as 2053."
    longest = 8 - (len(str(target.count)) if target.count > 1 else 0) - ship
    callsign = target.callsign
    if callsign is not None and not (callsign.isascii() and callsign.isalnum() and len(callsign) <= longest):
        yield f"callsign = {callsign!r} is not one of letters and digits, at most {longest}", ""
    if target.mmsi is not None and not 100_000_000 <= target.mmsi <= 799_999_999 - target.count:
        yield f"mmsi = {target.mmsi} is none of a ship", "Nine digits, the first from 1 to 7."
    if target.length_m is not None and not 1 <= target.length_m <= 500:
        yield f"length_m = {target.length_m:g} is not within 1 … 500", ""
    if ship and target.kind != "replay":
        for name in ("mode_s", "mode_3a", "adsb"):
            if getattr(target, name) is not None:
                yield f"{name} is of aircraft, and this is a ship", 'Give craft = "aircraft" where it is none.'
    if not ship and target.craft is not None and target.mmsi is not None:
        yield "mmsi is of ships, and this is an aircraft", ""
    if target.adsb and not adsb:
        yield "adsb = true, but the scene has no ADS-B", "Give [adsb]."


def _is_number(text: str, base: int, most: int, zero: bool = False) -> bool:
    """Whether a text is a number of so many digits as `most` has, and within it."""
    digits = "0123456789abcdef"[:base]
    return bool(text) and all(c in digits for c in text.lower()) and (1 - zero) <= int(text, base) <= most


def _faults_of_start(target: Target, radars: Sequence[Radar], ship: bool) -> Iterator[tuple[str, str]]:
    place = (target.lat_deg, target.lon_deg)
    polar = (target.range_m, target.azimuth_deg)
    if (None in place) == (None in polar) or place.count(None) == 1 or polar.count(None) == 1:
        yield "where it starts is not told, or told twice", "Give lat_deg and lon_deg, or range_m and azimuth_deg of a radar."
    for name in (target.radar, target.towards):
        if name is not None and name not in [r.name for r in radars]:
            yield f"there is no radar {name!r}", f"Known: {', '.join(r.name for r in radars) or 'none'}."
    if target.range_m is not None:
        if target.radar is None and len(radars) != 1:
            yield "range_m and azimuth_deg are of which radar?", 'Name it: radar = "...".'
        if not 0 < target.range_m <= 1e6:
            yield f"range_m = {target.range_m:g} is not within 0 … 1,000,000", ""
    elif target.radar is not None:
        yield "radar is of no use without range_m and azimuth_deg", ""
    if target.lat_deg is not None and not abs(target.lat_deg) <= _POLAR_DEG:
        yield f"lat_deg = {target.lat_deg:g} is not within -{_POLAR_DEG:g} … {_POLAR_DEG:g}", ""
    if target.lon_deg is not None and not abs(target.lon_deg) <= 180:
        yield f"lon_deg = {target.lon_deg:g} is not within -180 … 180", ""
    if ship:
        if target.height_m is not None or target.pressure_levels or target.climb_mps:
            yield (
                "a ship sails on the sea: it has no height, and does not climb",
                "The sea's height is sea_level_m of [shipping].",
            )
    elif target.height_m is None:
        yield "an aircraft needs height_m", 'Give craft = "ship" where it is one.'
    elif not _LOWEST_M <= target.height_m <= _HIGHEST_M:
        yield f"height_m = {target.height_m:g} is not within {_LOWEST_M:g} … {_HIGHEST_M:,.0f}", ""
    if target.kind == "approaching":
        goal = (target.towards_lat_deg, target.towards_lon_deg)
        if (target.towards is None) == (None in goal) or goal.count(None) == 1:
            yield "what it approaches is not told, or told twice", "Give towards, or towards_lat_deg and towards_lon_deg."
        if target.speed_mps is not None and not target.speed_mps > 0:
            yield "without speed it does not approach", ""


def _faults_of_climb(target: Target, ship: bool) -> Iterator[tuple[str, str]]:
    if not abs(target.climb_mps) <= 300 or target.climb_after_s < 0:
        yield "climb_mps must be within -300 … 300, climb_after_s not negative", ""
    if target.climb_mps == 0 and (target.to_height_m is not None or target.climb_after_s):
        yield "to_height_m and climb_after_s are of no use without climb_mps", ""
    if ship or target.height_m is None or target.to_height_m is None:
        return
    if (target.to_height_m - target.height_m) * target.climb_mps <= 0:
        yield f"with climb_mps = {target.climb_mps:g} it never comes to to_height_m = {target.to_height_m:g}", "Change the sign."
    if not _LOWEST_M <= target.to_height_m <= _HIGHEST_M:
        yield f"to_height_m = {target.to_height_m:g} is not within {_LOWEST_M:g} … {_HIGHEST_M:,.0f}", ""


def _faults_of_waypoints(target: Target, ship: bool, fastest: float) -> Iterator[tuple[str, str]]:
    points = target.waypoint
    if len(points) < 2:
        yield "at least two waypoints are needed", ""
    timed = [p.time_s is not None for p in points]
    if any(timed) and not all(timed):
        yield "some waypoints have a time, and some have none", "Give time_s to all of them, or to none."
    if any(timed) and (
        target.start_s is not None or target.speed_mps is not None or any(p.speed_mps is not None for p in points)
    ):
        yield "waypoints with times need no speed_mps and no start_s", "Leave out either of them."
    for number, (point, following) in enumerate(zip(points, [*points[1:], None], strict=True), 1):
        if not (abs(point.lat_deg) <= _POLAR_DEG and abs(point.lon_deg) <= 180):
            yield f"waypoint {number} lies nowhere where targets go", f"lat_deg is within -{_POLAR_DEG:g} … {_POLAR_DEG:g}."
        height = target.height_m if point.height_m is None else point.height_m
        if ship and height is not None:
            yield f"waypoint {number} of a ship has a height", "Leave out height_m."
        if not ship and (height is None or not _LOWEST_M <= height <= _HIGHEST_M):
            yield f"waypoint {number} has no height_m within {_LOWEST_M:g} … {_HIGHEST_M:,.0f}", ""
        if following is None:
            continue
        if (point.lat_deg, point.lon_deg) == (following.lat_deg, following.lon_deg):
            yield f"waypoints {number} and {number + 1} are one place", ""
        if all(timed) and not (following.time_s or 0.0) - (point.time_s or 0.0) >= 1:
            yield f"waypoint {number + 1} is not reached a second or more after waypoint {number}", ""
        speed = target.speed_mps if point.speed_mps is None else point.speed_mps
        if not any(timed) and (speed is None or not 0 < speed <= fastest):
            yield f"waypoint {number} has no speed_mps within 0 … {fastest:g}", "Give it, or one for the whole target."


# A target of which nothing is told: its fields are the defaults.
_PLAIN = Target()
# Beyond it courses turn too fast for a table of them to be smooth.
_POLAR_DEG = 85.0
_ROLL_S = 6.0
_VERTICAL_MPS2 = 0.4
_BANK_MPS2 = GRAVITY_MPS2 * math.tan(math.radians(25.0))
# The steepest slope of the blending from 0 to 1 over a unit.
_STEEPEST = 1.875
_BRIDGED_S = 120.0
# Of positions that do not tell how good they are.
_UNTOLD_SD_M = 5.0


class _Way(NamedTuple):
    """A way before it is a curve: times (n,), seconds after the scene's start; latitude, longitude, height; where it points.

    It exists from `first_s` to `last_s`.
    """

    seconds: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray
    heading: FloatArray
    first_s: float
    last_s: float


class _Who(NamedTuple):
    """What is known of a target's identity, -1 or None where it is not."""

    mode_s: int = -1
    mode_3a: int = -1
    callsign: int = -1
    mmsi: int = -1
    length_m: float = math.nan


class _One(NamedTuple):
    """One target of the truth: its name and way, which copy of which scripted target it is, and who it was in a recording."""

    name: str
    way: _Way
    target: Target
    copy: int
    who: _Who


def _ramp(x: FloatArray, blend: float) -> FloatArray:
    """0 before, x after 0, with a slope that grows from 0 to 1 over `blend` about 0 and has two continuous derivatives."""
    if blend <= 0:
        return np.maximum(x, 0.0)
    u = np.clip(x / blend + 0.5, 0.0, 1.0)
    return np.where(x >= blend / 2, x, blend * u**4 * (2.5 - 3.0 * u + u * u))


def _for_a_while(t: FloatArray, after: float, amount: float | None, rate: float, blend: float) -> FloatArray:
    """The integral over t of a rate that holds from `after` on until it has made up `amount` (None: for ever)."""
    span = math.inf if amount is None else abs(amount / rate)
    blend = min(blend, span)
    out = rate * (_ramp(t - after, min(blend, 2 * after)) if after > 0 else t)
    return out if amount is None else out - rate * _ramp(t - after - span, blend)


def _geodesic(
    latitude: float,
    longitude: float,
    course: float,
    speed: float,
    step: float,
    turned: FloatArray,
    height: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude, longitude and heading every `step`: a geodesic, but for what it `turned` besides.

    `turned` (rad) and `height` (2 n - 1,) are given every half step.
    """
    n = (len(turned) + 1) // 2
    out = np.empty((n, 3))
    lat, lon, bent = latitude, longitude, 0.0
    way, up = turned.tolist(), height.tolist()

    def rates(lat: float, bent: float, k: int) -> tuple[float, float, float]:
        sin = math.sin(lat)
        heading = course + bent + way[k]
        w = 1.0 - E2 * sin * sin
        normal = SEMI_MAJOR_M / math.sqrt(w)
        east = speed * math.sin(heading) / ((normal + up[k]) * math.cos(lat))
        # Meridians converge: along a geodesic the heading itself turns.
        return speed * math.cos(heading) / (normal * (1.0 - E2) / w + up[k]), east, east * sin

    for k in range(n):
        out[k] = lat, lon, course + bent + way[2 * k]
        if k == n - 1 or not abs(lat) < 1.55:
            out[k + 1 :] = np.nan
            break
        a = rates(lat, bent, 2 * k)
        b = rates(lat + 0.5 * step * a[0], bent + 0.5 * step * a[2], 2 * k + 1)
        c = rates(lat + 0.5 * step * b[0], bent + 0.5 * step * b[2], 2 * k + 1)
        d = rates(lat + step * c[0], bent + step * c[2], 2 * k + 2)
        lat += step * (a[0] + 2 * b[0] + 2 * c[0] + d[0]) / 6
        lon += step * (a[1] + 2 * b[1] + 2 * c[1] + d[1]) / 6
        bent += step * (a[2] + 2 * b[2] + 2 * c[2] + d[2]) / 6
    return out[:, 0], out[:, 1], out[:, 2]


def _moved(latitude: float, longitude: float, height: float, bearing: float, distance: float) -> tuple[float, float]:
    """The place so far away, in the horizontal plane."""
    if distance == 0:
        return latitude, longitude
    origin, axes = ecef_from_geodetic(latitude, longitude, height), enu_from_ecef(latitude, longitude)
    east, north = np.array([distance * math.sin(bearing)]), np.array([distance * math.cos(bearing)])
    lat, lon, _ = geodetic_from_ecef(position_from_plane(east, north, np.array([height]), origin, axes))
    return float(lat[0]), float(lon[0])


def _bearing(latitude: float, longitude: float, to_latitude: float, to_longitude: float) -> float:
    """The azimuth of one place at another, both on the ellipsoid; within 0.1 arc seconds of the geodesic's at 200 km."""
    there = ecef_from_geodetic(to_latitude, to_longitude, 0.0) - ecef_from_geodetic(latitude, longitude, 0.0)
    east, north, _ = rotate(enu_from_ecef(latitude, longitude), there)
    return math.atan2(east, north)


class _Scene(NamedTuple):
    """What of the scene the ways depend on."""

    epoch_s: float
    duration_s: float
    atmosphere: Atmosphere
    sea_level_m: float
    radars: Sequence[Radar]
    recordings: dict[tuple[str, datetime.date | None], Recording]

    def radar(self, name: str | None) -> Radar:
        return next(r for r in self.radars if name in (None, r.name))

    def heights(self, target: Target, level: FloatArray) -> FloatArray:
        """Ellipsoidal heights of what a target calls its heights."""
        if is_ship(target):
            return np.full(len(level), self.sea_level_m)
        return self.atmosphere.geometric_m(level) if target.pressure_levels else level


def _from_start(target: Target, copy: int, scene: _Scene) -> _Way:
    """The way of a target that is given by its start, course and speed."""
    speed = target.speed_mps or 0.0
    level = scene.heights(target, np.array([target.height_m or 0.0]))
    if target.range_m is not None:
        radar = scene.radar(target.radar)
        place = math.radians(radar.lat_deg), math.radians(radar.lon_deg)
        site, axes = ecef_from_geodetic(*place, radar.height_m), enu_from_ecef(*place)
        azimuth = np.radians(np.array([target.azimuth_deg or 0.0]))
        found = position_from_height(np.array([target.range_m]), azimuth, level, site, axes)
        if not np.isfinite(found).all():
            raise SettingsError(f"no place at height {level[0]:.0f} m is {target.range_m:g} m from the radar")
        lat, lon = (float(v[0]) for v in geodetic_from_ecef(found)[:2])
    else:
        lat, lon = math.radians(target.lat_deg or 0.0), math.radians(target.lon_deg or 0.0)
    goal: tuple[float, float] | None = None
    if target.kind == "approaching":
        if target.towards is not None:
            radar = scene.radar(target.towards)
            goal = math.radians(radar.lat_deg), math.radians(radar.lon_deg)
        else:
            goal = math.radians(target.towards_lat_deg or 0.0), math.radians(target.towards_lon_deg or 0.0)
    if goal is not None and math.dist((lat, lon), goal) < 1e-6:
        raise SettingsError("it is where it is to go to", remedy="Let it start some way off.")
    course = math.radians(target.course_deg or 0.0) if goal is None else _bearing(lat, lon, *goal)
    aside = course + math.pi / 2 if target.spacing_deg is None else math.radians(target.spacing_deg)
    lat, lon = _moved(lat, lon, float(level[0]), aside, copy * target.spacing_m)
    course = course if goal is None else _bearing(lat, lon, *goal)

    start = (target.start_s or 0.0) + copy * target.spacing_s
    end = scene.duration_s if target.end_s is None else min(target.end_s + copy * target.spacing_s, scene.duration_s)
    turn = math.radians(target.turn_dps or 0.0)
    fastest = max(abs(turn), 2 * math.pi / (target.period_s or math.inf))
    step = min(STEP_S, 2 * math.pi / 80 / max(fastest, 1e-9))
    half = 0.5 * step * np.arange(2 * (math.ceil((end - start) / step) + 8) + 1, dtype=np.float64)
    turned = np.zeros(len(half))
    if turn:
        by = None if target.turn_by_deg is None else math.radians(target.turn_by_deg)
        turned = _for_a_while(half, target.turn_after_s, by, turn, _ROLL_S)
    levels = np.full(len(half), target.height_m or 0.0, np.float64)
    if target.climb_mps:
        rise = None if target.to_height_m is None else target.to_height_m - levels[0]
        blend = _STEEPEST * abs(target.climb_mps) / _VERTICAL_MPS2
        levels += _for_a_while(half, target.climb_after_s, rise, target.climb_mps, blend)
    height = scene.heights(target, levels)
    latitude, longitude, heading = _geodesic(lat, lon, course, speed, step, turned, height)
    seconds, height = half[::2], height[::2]
    if target.kind == "serpentine":
        swing = 2 * math.pi / (target.period_s or 1.0) * seconds + math.radians(target.phase_deg)
        across = (target.amplitude_m or 0.0) * np.sin(swing)
        axes = enu_from_ecef(latitude, longitude)
        right = np.cos(heading)[:, None] * axes[:, 0] - np.sin(heading)[:, None] * axes[:, 1]
        shifted = ecef_from_geodetic(latitude, longitude, height) + across[:, None] * right
        latitude, longitude, _ = geodetic_from_ecef(shifted)
        heading = _course(seconds, latitude, longitude, height)
    if goal is not None:
        site, axes = ecef_from_geodetic(*goal, 0.0), enu_from_ecef(*goal)
        local = rotate(axes, ecef_from_geodetic(latitude, longitude, height) - site)
        along = local[:, :2] @ (local[0, :2] / np.hypot(*local[0, :2]))
        if along[-1] < 0:
            end = min(end, start + float(np.interp(0.0, -along, seconds)))
    return _Way(start + seconds, latitude, longitude, height, heading, start, end)


def _through_waypoints(target: Target, copy: int, scene: _Scene) -> _Way:
    """The way along waypoints: legs of constant velocity, whose changes are blended as fast as the craft can."""
    points, ship = target.waypoint, is_ship(target)
    place = np.radians([[p.lat_deg, p.lon_deg] for p in points])
    aside = _bearing(*place[0], *place[1]) + math.pi / 2 if target.spacing_deg is None else math.radians(target.spacing_deg)
    level = np.array([target.height_m if p.height_m is None else p.height_m for p in points], np.float64)
    level = np.where(np.isfinite(level), level, 0.0)
    height = scene.heights(target, level)
    moved = [
        _moved(lat, lon, up, aside, copy * target.spacing_m)
        for (lat, lon), up in zip(place.tolist(), height.tolist(), strict=True)
    ]
    spot = ecef_from_geodetic([lat for lat, _ in moved], [lon for _, lon in moved], height)
    leg = np.diff(spot, axis=0)
    start = (target.start_s or 0.0) + copy * target.spacing_s
    if points[0].time_s is not None:
        when = np.array([p.time_s for p in points], np.float64) + copy * target.spacing_s
    else:
        speed = np.array([target.speed_mps if p.speed_mps is None else p.speed_mps for p in points[:-1]], np.float64)
        # The chord of a leg is shorter than its arc.
        chord = np.linalg.norm(leg, axis=1)
        arc = chord * (1.0 + (chord / SEMI_MAJOR_M) ** 2 / 24)
        when = start + np.concatenate([[0.0], np.cumsum(arc / speed)])
    lasts = np.diff(when)
    velocity = leg / lasts[:, None]
    speeds = np.linalg.norm(velocity, axis=1)
    fastest = _FASTEST_MPS["ship" if ship else "aircraft"]
    if speeds.max() > fastest:
        leg_number = int(np.argmax(speeds)) + 1
        raise SettingsError(
            f"from waypoint {leg_number} to {leg_number + 1} it would move with {speeds.max():.0f} m/s, more than {fastest:g}"
        )
    change = np.diff(velocity, axis=0)
    hardest = np.full(len(change), _BANK_MPS2)
    if ship:
        hardest = np.clip(speeds[1:] ** 2 / (3.0 * (target.length_m or 60.0)), 0.02, 0.8)
    room = np.minimum(lasts[1:], lasts[:-1])
    blend = np.minimum(np.maximum(_STEEPEST * np.linalg.norm(change, axis=1) / hardest, 10.0), room)
    first, last = float(when[0]), float(when[-1] if target.end_s is None else min(target.end_s, when[-1]))
    last = min(last, scene.duration_s)
    if not (first < scene.duration_s and last > max(first, 0.0)):
        raise SettingsError("none of its way lies within the scene", remedy="Change the times of its waypoints.")
    step = min(STEP_S, float(min(blend, default=STEP_S * 8)) / 8)
    seconds = first + step * np.arange(math.ceil((last - first) / step) + 8, dtype=np.float64)
    position = spot[0] + (seconds - first)[:, None] * velocity[0]
    levels = level[0] + (seconds - first) * (level[1] - level[0]) / lasts[0]
    rise = np.diff(level) / lasts
    for k in range(len(change)):
        position += _ramp(seconds - when[k + 1], float(blend[k]))[:, None] * change[k]
        steep = _STEEPEST * abs(rise[k + 1] - rise[k]) / _VERTICAL_MPS2
        levels += _ramp(seconds - when[k + 1], float(min(max(steep, 10.0), room[k]))) * (rise[k + 1] - rise[k])
    latitude, longitude, _ = geodetic_from_ecef(position)
    height = scene.heights(target, levels)
    heading = _course(seconds, latitude, longitude, height)
    return _Way(seconds, latitude, longitude, height, heading, max(first, 0.0), last)


def _recorded(target: Target, scene: _Scene) -> tuple[_Way, _Who, Target]:
    """The way of a target as a recording tells it, its identity there, and the target, now known to be a ship or not."""
    from ..alignment import locate, states, trajectories
    from ..reading import read

    path = target.recording or ""
    if (path, target.date) not in scene.recordings:
        scene.recordings[path, target.date] = read(path, date=target.date)
    recording = scene.recordings[path, target.date]
    fixes = recording.fixes if len(recording.fixes) else _fixes_of(recording.tracks)
    if len(fixes) and not np.isfinite(fixes.latitude_rad).any():
        fixes, _ = locate(fixes, Sensors(sensor=()), recording.sources)
    fixes = fixes[np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad) & np.isfinite(fixes.time_s)]
    if not len(fixes):
        raise InputError("there are no positions in it to be replayed", path=path, remedy="Give another recording.")
    fixes, who = _one_of(fixes, target)
    if target.craft is None:
        target = msgspec.structs.replace(target, craft="ship" if target.mmsi is not None or who.mmsi >= 0 else "aircraft")
    fixes = _with_heights(fixes, target, scene)
    order = np.argsort(fixes.time_s, kind="stable")
    fixes = fixes[order]
    cuts = np.flatnonzero(np.diff(fixes.time_s) > _BRIDGED_S) + 1
    piece = max(np.split(np.arange(len(fixes)), cuts), key=lambda rows: float(np.ptp(fixes.time_s[rows])))
    fixes = fixes[piece]
    updates = np.diff(fixes.time_s)
    step = float(np.clip(np.median(updates[updates > 0]), STEP_S, 10.0)) if (updates > 0).any() else STEP_S
    span = float(fixes.time_s[-1] - fixes.time_s[0])
    if span < 8 * step:
        raise InputError(f"its positions of that target span {span:.0f} s, which is no way", path=path)
    # One target, whoever sent it: the identity is settled already.
    plain = Fixes(**{
        name: getattr(fixes, name)
        for name in ("time_s", "latitude_rad", "longitude_rad", "height_m", "velocity_east_mps", "velocity_north_mps",
                     "velocity_up_mps", "heading_rad", "horizontal_sd_m", "vertical_sd_m", "time_sd_s", "flags")
    }, source=np.zeros(len(fixes), np.int64), track=np.ones(len(fixes), np.int64))  # fmt: skip
    fitted = trajectories(plain)
    number = int(np.bincount(fitted.target[fitted.target >= 0]).argmax())
    grid = fixes.time_s[0] + step * np.arange(math.floor(span / step) + 1)
    found = states(fitted, np.full(len(grid), number), grid)
    known = np.flatnonzero(found.valid)
    if len(known) < 8:
        raise InputError("its positions of that target do not make a way", path=path, remedy="Give another target.")
    grid, at = grid[known[0] : known[-1] + 1], known - known[0]
    tell = fixes.horizontal_sd_m[np.isfinite(fixes.horizontal_sd_m) & (fixes.horizontal_sd_m > 0)]
    position = _smoothed(len(grid), at, found.position[known], float(np.median(tell)) if len(tell) else _UNTOLD_SD_M)
    heading = np.zeros(len(grid))
    told = known[np.isfinite(found.heading_rad[known])]
    if len(told):
        # A target that hardly moves points where it last did.
        heading = np.interp(grid, grid[told - known[0]], np.unwrap(found.heading_rad[told]))
    latitude, longitude, height = geodetic_from_ecef(position)
    if is_ship(target):
        height = np.full(len(grid), scene.sea_level_m)
    shift = -scene.epoch_s if target.start_s is None else target.start_s - grid[0]
    seconds = grid + shift
    return _Way(seconds, latitude, longitude, height, heading, float(seconds[0]), float(seconds[-1])), who, target


def _smoothed(n: int, at: IntArray, position: FloatArray, sd: float) -> FloatArray:
    """Positions (n, 3) on a regular grid from those (k, 3) at its points `at`: the smoothest that stay near them.

    The sum of squared distances plus a multiple of the sum of squared third differences is smallest (Whittaker 1923), so gaps
    are bridged with the least jerk.  The multiple passes motion slower than a period; that is as long as the rms distance per
    axis stays below half of `sd`.
    """
    from scipy.linalg import solveh_banded

    weight = np.zeros(n)
    weight[at] = 1.0
    wanted = np.zeros((n, 3))
    wanted[at] = position - position[0]
    # The bands of the third differences' normal matrix.
    third = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for i in range(4):
        for j in range(i, 4):
            bands[3 - (j - i), j : n - 3 + j] += third[i] * third[j]
    out = position
    for period in (48.0, 32.0, 24.0, 16.0, 12.0, 8.0, 6.0, 4.0, 3.0):
        stiff = bands / (2.0 * math.sin(math.pi / period)) ** 6
        stiff[3] += weight
        out = solveh_banded(stiff, wanted)
        if math.sqrt(float(np.mean((out[at] - wanted[at]) ** 2))) <= 0.5 * sd:
            break
    smooth: FloatArray = out + position[0]
    return smooth


def _fixes_of(tracks: Tracks) -> Fixes:
    """A tracker's states as positions of targets."""
    shared = {f.name for f in fields(Fixes)} & {f.name for f in fields(Tracks)}
    return Fixes(**{name: getattr(tracks, name) for name in shared})


def _one_of(fixes: Fixes, target: Target) -> tuple[Fixes, _Who]:
    """The fixes of the one target that is meant, and its identity.  Raises SettingsError where that is not one."""
    from ..targets import targets_of

    rows = np.ones(len(fixes), np.bool_)
    asked = []
    if target.mode_s is not None:
        rows &= fixes.mode_s == int(target.mode_s, 16)
        asked.append(f"mode_s {target.mode_s}")
    if target.mmsi is not None:
        rows &= fixes.mmsi == target.mmsi
        asked.append(f"mmsi {target.mmsi}")
    if target.callsign is not None and not asked:
        told = targets_of(fixes)
        named = fixes.callsign == pack_callsigns([target.callsign])[0]
        # Not every report carries the callsign of its target.
        rows &= named | np.isin(told, np.unique(told[named & (told >= 0)]))
        asked.append(f"callsign {target.callsign}")
    if target.track is not None:
        rows &= fixes.track == target.track
        asked.append(f"track {target.track}")
    told = targets_of(fixes)
    numbers, counts = np.unique(told[told >= 0], return_counts=True)
    if not asked and len(numbers) > 1:
        most = numbers[np.argsort(-counts, kind="stable")][:6]
        names = [_called(fixes, int(np.argmax(told == k))) for k in most.tolist()]
        raise SettingsError(
            f"{target.recording} holds {len(numbers)} targets: which one is to be replayed?",
            remedy=f"Name one by mode_s, mmsi, callsign or track; those with the most reports: {', '.join(names)}.",
        )
    if not rows.any():
        raise SettingsError(f"{target.recording} holds no target of {' and '.join(asked)}")
    mine = fixes[rows]

    def common(column: AnyArray) -> int:
        known = np.asarray(column, np.int64)
        values, count = np.unique(known[known >= 0], return_counts=True)
        return int(values[np.argmax(count)]) if len(values) else -1

    length = mine.length_m[np.isfinite(mine.length_m) & (mine.length_m > 0)]
    return mine, _Who(
        common(mine.mode_s), common(mine.mode_3a), common(mine.callsign), common(mine.mmsi),
        float(np.median(length)) if len(length) else math.nan,
    )  # fmt: skip


def _called(fixes: Fixes, row: int) -> str:
    """How one names the target of a row."""
    if fixes.mode_s[row] >= 0:
        return f'mode_s = "{fixes.mode_s[row]:06X}"'
    if fixes.mmsi[row] >= 0:
        return f"mmsi = {fixes.mmsi[row]}"
    if fixes.callsign[row] >= 0:
        return f'callsign = "{unpack_callsigns(fixes.callsign[row : row + 1])[0]}"'
    return f"track = {fixes.track[row]}"


def _with_heights(fixes: Fixes, target: Target, scene: _Scene) -> Fixes:
    """The fixes with heights of one kind: the sea's, those told, pressure altitudes in the scene's air, or the one given."""
    n = len(fixes)
    if is_ship(target):
        return fixes.replace(height_m=np.full(n, scene.sea_level_m))
    if target.height_m is not None:
        return fixes.replace(height_m=scene.heights(target, np.full(n, target.height_m)))
    high, level = np.isfinite(fixes.height_m), np.isfinite(fixes.pressure_altitude_m)
    if high.any() and 2 * int(high.sum()) >= int(level.sum()):
        return fixes[high]
    if level.any():
        return fixes[level].replace(height_m=scene.atmosphere.geometric_m(fixes.pressure_altitude_m[level]))
    raise SettingsError(f"{target.recording} tells no height of that target", remedy="Give height_m.")


def _replayed(target: Target, copy: int, way: _Way, scene: _Scene) -> _Way:
    """A copy of a recorded way, cut to the scene."""
    aside = math.pi / 2 if target.spacing_deg is None else math.radians(target.spacing_deg)
    late = copy * target.spacing_s
    latitude, longitude = way.latitude, way.longitude
    if copy and target.spacing_m:
        axes = enu_from_ecef(latitude, longitude)
        move = copy * target.spacing_m * (math.sin(aside) * axes[:, 0] + math.cos(aside) * axes[:, 1])
        latitude, longitude, _ = geodetic_from_ecef(ecef_from_geodetic(latitude, longitude, way.height) + move)
    first = max(way.first_s + late, 0.0)
    last = min(way.last_s + late, scene.duration_s, math.inf if target.end_s is None else target.end_s + late)
    if last - first < 8 * STEP_S:
        begin, end = (
            f"{datetime.datetime.fromtimestamp(scene.epoch_s + t, datetime.UTC):%Y-%m-%d %H:%M:%S}"
            for t in (way.first_s + late, way.last_s + late)
        )
        raise SettingsError(
            f"what is replayed lasts from {begin} to {end} UTC, which is not within the scene",
            remedy="Give start_s to have it begin so long after the scene's start.",
        )
    seconds = way.seconds + late
    step = seconds[1] - seconds[0]
    kept = (seconds >= first - 12 * step) & (seconds <= last + 12 * step)
    return _Way(seconds[kept], latitude[kept], longitude[kept], way.height[kept], way.heading[kept], first, last)


def _ways(target: Target, scene: _Scene) -> tuple[list[_Way], _Who, Target]:
    """The ways of all copies, what a recording tells of the target's identity, and the target, whose craft is known then."""
    copies = range(target.count)
    if target.kind == "replay":
        way, who, target = _recorded(target, scene)
        return [_replayed(target, k, way, scene) for k in copies], who, target
    make: Callable[[Target, int, _Scene], _Way] = _through_waypoints if target.kind == "waypoints" else _from_start
    return [make(target, k, scene) for k in copies], _Who(), target


def script_targets(
    targets: Sequence[Target],
    truth: Truth,
    duration_s: float,
    radars: Sequence[Radar],
    rng: np.random.Generator,
    *,
    traffic: Traffic | None = None,
    adsb: Adsb | None = None,
    ais: Ais | None = None,
    sea_level_m: float = 0.0,
) -> Truth:
    """The same truth with the scripted targets added: aircraft behind the traffic's, ships behind the shipping's.

    The targets keep their order.  `radars` are what names in the targets mean; `traffic` tells the spread of delays and of
    altimeters (default: as it stands in `Traffic`), `adsb` and `ais` the equipment and its latency.  Ships sail at `sea_level_m`,
    ellipsoidal.  Without targets the truth is returned as it is.

    Raises SettingsError for what cannot be simulated, with the number and name of the target, and InputError as `read` does for
    a recording.
    """
    if not targets:
        return truth
    scene = _Scene(truth.epoch_s, duration_s, truth.atmosphere, sea_level_m, radars, {})
    flying: list[_One] = []
    sailing: list[_One] = []
    for number, target in enumerate(targets, 1):
        where = f"target {number} ({target.name!r})" if target.name else f"target {number}"
        check_target(target, radars, duration_s, adsb=adsb is not None, where=where)
        try:
            ways, who, target = _ways(target, scene)
        except SettingsError as error:
            raise SettingsError(str(error.args[0]), where=where, remedy=error.remedy) from error
        for way in ways:
            if not (np.isfinite(way.latitude).all() and np.abs(way.latitude).max() <= math.radians(_POLAR_DEG) + 0.03):
                raise SettingsError(f"it goes beyond {_POLAR_DEG:g} degrees of latitude", where=where, remedy="Give end_s.")
            if not (way.height.min() >= _LOWEST_M - 200 and way.height.max() <= _HIGHEST_M + 2000):
                raise SettingsError(
                    f"its height runs from {way.height.min():,.0f} to {way.height.max():,.0f} m", where=where,
                    remedy="Give to_height_m or end_s.",
                )  # fmt: skip
        name = target.name or f"target {number}"
        into = sailing if is_ship(target) else flying
        into += [_One(name if target.count == 1 else f"{name}-{k + 1}", w, target, k, who) for k, w in enumerate(ways)]
    return _with_targets(truth, flying, sailing, traffic or Traffic(), adsb, ais, rng)


def _with_targets(
    truth: Truth,
    flying: Sequence[_One],
    sailing: Sequence[_One],
    traffic: Traffic,
    adsb: Adsb | None,
    ais: Ais | None,
    rng: np.random.Generator,
) -> Truth:
    """Make the curves, draw what is not given, and put it all in its place."""
    air, sea = rng.spawn(2)
    aircraft = _aircraft(flying, truth.aircraft, traffic, adsb, air)
    ships = _ships(sailing, truth.ships, ais, sea)
    curves = [
        smooth_curve(way.seconds, ecef_from_geodetic(way.latitude, way.longitude, way.height))
        for way in (one.way for one in (*flying, *sailing))
    ]
    headings = tuple(smooth_curve(one.way.seconds, np.unwrap(one.way.heading), degree=3) for one in sailing)
    at = truth.flights
    first, last = (np.array([getattr(one.way, end) for one in (*flying, *sailing)]) for end in ("first_s", "last_s"))

    def placed(column: FloatArray, own: FloatArray) -> FloatArray:
        return np.concatenate([column[:at], own[: len(flying)], column[at:], own[len(flying) :]])

    names = truth.names or ("",) * len(truth)
    return replace(
        truth,
        first_s=placed(truth.first_s, first),
        last_s=placed(truth.last_s, last),
        aircraft=aircraft,
        curves=(*truth.curves[:at], *curves[: len(flying)], *truth.curves[at:], *curves[len(flying) :]),
        ships=ships,
        headings=(*truth.headings, *headings),
        names=(*names[:at], *(one.name for one in flying), *names[at:], *(one.name for one in sailing)),
    )


def _course(seconds: FloatArray, latitude: FloatArray, longitude: FloatArray, height: FloatArray) -> FloatArray:
    """The course over ground (n,) along a way."""
    velocity = np.asarray(smooth_curve(seconds, ecef_from_geodetic(latitude, longitude, height))(seconds, nu=1))
    local = rotate(enu_from_ecef(latitude, longitude), velocity)
    return np.arctan2(local[:, 0], local[:, 1])


_Columns = TypeVar("_Columns", Aircraft, Ships)


def _joined(first: _Columns, second: _Columns) -> _Columns:
    """Two tables of columns, one behind the other."""
    return type(first)(*(np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(first)))


def _aircraft(ones: Sequence[_One], others: Aircraft, traffic: Traffic, adsb: Adsb | None, rng: np.random.Generator) -> Aircraft:
    """The columns of all aircraft: those that are there, then the scripted ones."""
    drawn = equip_aircraft(len(ones), traffic, adsb, rng)
    drawn = replace(drawn, mode_s=_numbers(ones, "mode_s", drawn.mode_s, others.mode_s))
    for k, (_, _, target, copy, who) in enumerate(ones):
        if target.mode_3a is not None or who.mode_3a >= 0:
            drawn.mode_3a[k] = int(target.mode_3a, 8) if target.mode_3a is not None else who.mode_3a
        drawn.callsign[k] = _callsign(int(drawn.callsign[k]), target, copy, who)
        drawn.length_m[k] = _length(float(drawn.length_m[k]), target, who)
        if target.adsb is False:
            drawn.accuracy[k] = -1
        elif target.adsb and drawn.accuracy[k] < 0 and adsb is not None:
            shares = np.array(list(adsb.classes.values()), np.float64)
            drawn.accuracy[k] = int(rng.choice([int(c) for c in adsb.classes], p=shares / shares.sum()))
    return _joined(others, drawn)


def _ships(ones: Sequence[_One], others: Ships, ais: Ais | None, rng: np.random.Generator) -> Ships:
    """The columns of all ships: those that are there, then the scripted ones.  They carry AIS of class A."""
    n = len(ones)
    length = np.rint(15.0 * (200.0 / 15.0) ** rng.random(n))
    length = np.array([_length(v, one.target, one.who) for v, one in zip(length.tolist(), ones, strict=True)])
    width = np.clip(np.rint(length / rng.uniform(4.5, 7.0, n) + 1.5), 1.0, None)
    bow = np.clip(np.rint(length * rng.uniform(0.3, 0.8, n)), 0.0, length)
    port = np.clip(np.rint(width * rng.uniform(0.35, 0.65, n)), 0.0, width)
    drawn_mmsi = 200_000_000 + rng.choice(99_999_999, n, replace=False)
    drawn_names = pack_callsigns([f"S{int(v):05d}" for v in rng.choice(99_999, n, replace=False)])
    names = [_callsign(name, one.target, one.copy, one.who) for name, one in zip(drawn_names.tolist(), ones, strict=True)]
    latency = (0.0, 0.0) if ais is None else (ais.latency_mean_s, ais.latency_sd_s)
    own = Ships(
        mmsi=_numbers(ones, "mmsi", drawn_mmsi, others.mmsi),
        callsign=np.array(names, np.int64),
        ship_type=np.full(n, 70),
        length_m=length,
        width_m=width,
        bow_m=bow,
        port_m=port,
        class_b=np.zeros(n, np.bool_),
        gyro_rad=np.radians(rng.normal(0.0, 0.7, n)),
        latency_s=latency[0] + latency[1] * rng.normal(0.0, 1.0, n),
        position_sd_m=np.where(rng.random(n) < 0.5, 2.0, 5.0),
    )
    return _joined(others, own)


def _numbers(ones: Sequence[_One], column: str, drawn: IntArray, taken: IntArray) -> IntArray:
    """Addresses or MMSI: those that are given, else those drawn; no two alike."""
    out = np.full(len(ones), -1, np.int64)
    holder: dict[int, str] = {}
    for k, one in enumerate(ones):
        told = getattr(one.target, column)
        first = getattr(one.who, column) if told is None else int(told, 16) if isinstance(told, str) else told
        if first >= 0:
            out[k] = first + one.copy
            if out[k] in holder:
                raise SettingsError(f"{holder[int(out[k])]} and {one.name} have the same {column}", remedy="Change one of them.")
            holder[int(out[k])] = one.name
    used = {*holder, *taken.tolist()}
    for k in np.flatnonzero(out < 0).tolist():
        number = int(drawn[k])
        while number in used:
            number += 1
        out[k] = number
        used.add(number)
    return out


def _callsign(drawn: int, target: Target, copy: int, who: _Who) -> int:
    if target.callsign is not None:
        return int(pack_callsigns([target.callsign if target.count == 1 else f"{target.callsign}{copy + 1}"])[0])
    return who.callsign if who.callsign >= 0 and copy == 0 else drawn


def _length(drawn: float, target: Target, who: _Who) -> float:
    if target.length_m is not None:
        return target.length_m
    return who.length_m if math.isfinite(who.length_m) else drawn
