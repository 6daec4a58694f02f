"""A simulated ship that carries a radar: where its antenna truly is and how it is turned, and what own ship reports of itself."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from .._types import FloatArray
from ..errors import SettingsError
from ..geodesy import E2, SEMI_MAJOR_M, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate_back
from ..measure import wrap_turn
from ..model import ANGLES, Platform
from ..platform import antenna_axes, deck_from_enu

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

_STEP_S = 1.0
# The way is known this long before and after what is asked for, so that differences of it are smooth there too.
_MARGIN_S = 60.0
# A helmsman takes off an error of course in about this time, and changes the rate of turn as slowly.
_STEER_S = 10.0


class Vessel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a ship sails, swings and reports itself, and where its radar's antenna stands on it.

    The position is the ship's reference point, `height_m` ellipsoidal.  It sails at `speed_mps` on `course_deg`, which changes at
    a steady `turn_degps` (to starboard), or along the `waypoints` (lat, lon, degrees), turning no faster than `max_turn_degps`;
    behind the last one it keeps its course.  It points `crab_deg` to the right of its course.  Roll (positive to starboard),
    pitch (bow up), yaw and heave (up) are sines of an amplitude and a period, with the phases `phase_deg` in this order
    (`settled` draws them).  `lever_arm_m` is the antenna's forward, starboard and up from the reference point, and `angles` what
    its azimuths are measured from (as in sensors.toml).

    Own ship reports every `report_s`, with white errors of the sds given, about constant errors (`_bias`): reported minus true.
    """

    lat_deg: float
    lon_deg: float
    height_m: float = 0.0
    speed_mps: float = 6.0
    course_deg: float = 0.0
    turn_degps: float = 0.0
    waypoints: tuple[tuple[float, float], ...] = ()
    max_turn_degps: float = 1.0
    crab_deg: float = 0.0
    roll_deg: float = 0.0
    roll_period_s: float = 9.0
    pitch_deg: float = 0.0
    pitch_period_s: float = 6.5
    yaw_deg: float = 0.0
    yaw_period_s: float = 14.0
    heave_m: float = 0.0
    heave_period_s: float = 7.5
    phase_deg: tuple[float, float, float, float] | None = None
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angles: str = "north"
    report_s: float = 0.5
    position_sd_m: float = 0.0
    heading_sd_deg: float = 0.0
    heading_bias_deg: float = 0.0
    roll_sd_deg: float = 0.0
    roll_bias_deg: float = 0.0
    pitch_sd_deg: float = 0.0
    pitch_bias_deg: float = 0.0


class Attitude(NamedTuple):
    """A ship's reference point (n, 3), ECEF metres, its heading, roll and pitch (n,), rad, its course (n,) and speed (n,)."""

    position: FloatArray
    heading_rad: FloatArray
    roll_rad: FloatArray
    pitch_rad: FloatArray
    course_rad: FloatArray
    speed_mps: FloatArray


def check_vessel(vessel: Vessel, where: str) -> None:
    """Raise SettingsError for a ship that cannot be simulated, naming the place and what would do."""
    for name in vessel.__struct_fields__:
        value = getattr(vessel, name)
        numbers = np.ravel(value) if name in ("waypoints", "lever_arm_m", "phase_deg") else [value]
        if value is not None and name != "angles" and not all(math.isfinite(v) for v in numbers):
            raise SettingsError(f"{name} = {value} is not a number", where=where)
    places = ((vessel.lat_deg, vessel.lon_deg), *vessel.waypoints)
    if any(abs(lat) > 80 or abs(lon) > 360 for lat, lon in places):
        raise SettingsError("its places need latitudes within -80 … 80 and longitudes within -360 … 360", where=where)
    if vessel.angles not in ANGLES:
        raise SettingsError(f"angles = {vessel.angles!r} is unknown", where=where, remedy=f"Known: {', '.join(ANGLES)}.")
    for name, low, high in (
        ("speed_mps", 0.0, 60.0),
        ("turn_degps", -10.0, 10.0),
        ("roll_deg", 0.0, 45.0),
        ("pitch_deg", 0.0, 30.0),
        ("yaw_deg", 0.0, 45.0),
        ("heave_m", 0.0, 20.0),
        ("position_sd_m", 0.0, 1000.0),
        ("heading_sd_deg", 0.0, 45.0),
        ("roll_sd_deg", 0.0, 45.0),
        ("pitch_sd_deg", 0.0, 45.0),
    ):
        if not low <= getattr(vessel, name) <= high:
            raise SettingsError(f"{name} = {getattr(vessel, name)} is not within {low:g} … {high:g}", where=where)
    for name in ("roll_period_s", "pitch_period_s", "yaw_period_s", "heave_period_s"):
        if not 1.0 <= getattr(vessel, name) <= 600.0:
            raise SettingsError(f"{name} = {getattr(vessel, name)} is not within 1 … 600", where=where)
    if not 0.01 <= vessel.report_s <= 600.0 or not 0.0 < vessel.max_turn_degps <= 10.0:
        raise SettingsError("report_s must be within 0.01 … 600, max_turn_degps within 0 … 10", where=where)
    if vessel.waypoints and (vessel.turn_degps or not vessel.speed_mps):
        raise SettingsError("waypoints need a speed, and no turn_degps", where=where, remedy="Give speed_mps alone.")


def settled(vessel: Vessel, rng: np.random.Generator) -> Vessel:
    """The same ship with the phases of its swinging drawn, where they are not given."""
    drawn = rng.uniform(0.0, 360.0, 4).tolist()
    return vessel if vessel.phase_deg is not None else msgspec.structs.replace(vessel, phase_deg=tuple(drawn))


def pose(vessel: Vessel, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the antenna is (n, 3), ECEF metres, and the rotation (n, 3, 3) from ECEF to the axes it measures in, at times (n,).

    The axes' rows are what azimuth 0 + 90 degrees, azimuth 0 and up are for it: east, north, up; or starboard, bow and up, level
    or of the deck, as `angles` says.  Phases that are not given are 0.  Times are seconds after the start; the ship sails on
    beyond any of them.
    """
    ship = attitude(vessel, seconds)
    latitude, longitude, _ = geodetic_from_ecef(ship.position)
    level = enu_from_ecef(latitude, longitude)
    deck = deck_from_enu(ship.heading_rad, ship.roll_rad, ship.pitch_rad)
    forward, starboard, up = vessel.lever_arm_m
    arm = rotate_back(level, rotate_back(deck, np.array([starboard, forward, up])))
    return ship.position + arm, antenna_axes(vessel.angles, ship.heading_rad, ship.roll_rad, ship.pitch_rad) @ level


def attitude(vessel: Vessel, seconds: FloatArray) -> Attitude:
    """How the ship truly lies at times (n,), seconds after the start."""
    when = np.asarray(seconds, np.float64)
    latest = float(np.max(when, initial=0.0))
    # Few lengths of the way, so that most calls find it made.
    way = _way(vessel, 1800.0 * 2.0 ** max(0, math.ceil(math.log2(max(latest, 1.0) / 1800.0))))
    earliest = float(way.t[0])
    if float(np.min(when, initial=0.0)) < earliest:
        raise ValueError(f"the ship's way begins {-earliest:.0f} s before the start")
    latitude, longitude, course = way(when).T
    rate = way(when, nu=1)
    roll, pitch, yaw, heave = _swing(vessel, when)
    north, east = _radii(latitude, vessel.height_m)
    heading = course + math.radians(vessel.crab_deg) + np.radians(yaw)
    return Attitude(
        position=ecef_from_geodetic(latitude, longitude, vessel.height_m + heave),
        heading_rad=wrap_turn(heading),
        roll_rad=np.radians(roll),
        pitch_rad=np.radians(pitch),
        course_rad=wrap_turn(course),
        speed_mps=np.hypot(rate[:, 0] * north, rate[:, 1] * east),
    )


def own_ship(vessel: Vessel, sensor: int, epoch_s: float, duration_s: float, rng: np.random.Generator) -> Platform:
    """What own ship reports of itself, every `report_s` from the scene's start to its end: the `Platform` of the radar `sensor`.

    `epoch_s` is the scene's start, UTC seconds.
    """
    # One more than the scene needs: late stamps lie behind its end.
    seconds = np.arange(math.ceil(duration_s / vessel.report_s) + 2, dtype=np.float64) * vessel.report_s
    n = len(seconds)
    ship = attitude(vessel, seconds)
    latitude, longitude, _ = geodetic_from_ecef(ship.position)
    off = rotate_back(enu_from_ecef(latitude, longitude), rng.normal(0.0, 1.0, (n, 3)) * vessel.position_sd_m)
    latitude, longitude, height = geodetic_from_ecef(ship.position + off)
    sds = (vessel.heading_sd_deg, vessel.roll_sd_deg, vessel.pitch_sd_deg)
    biases = (vessel.heading_bias_deg, vessel.roll_bias_deg, vessel.pitch_bias_deg)
    error = np.radians(rng.normal(0.0, 1.0, (n, 3)) * sds + biases)
    return Platform(
        time_s=epoch_s + seconds,
        sensor=np.full(n, sensor),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
        heading_rad=wrap_turn(ship.heading_rad + error[:, 0]),
        roll_rad=ship.roll_rad + error[:, 1],
        pitch_rad=ship.pitch_rad + error[:, 2],
        speed_mps=ship.speed_mps,
        course_rad=ship.course_rad,
        record=np.arange(n),
    )


def _swing(vessel: Vessel, seconds: FloatArray) -> list[FloatArray]:
    phases = np.radians(vessel.phase_deg or (0.0, 0.0, 0.0, 0.0))
    sizes = (vessel.roll_deg, vessel.pitch_deg, vessel.yaw_deg, vessel.heave_m)
    periods = (vessel.roll_period_s, vessel.pitch_period_s, vessel.yaw_period_s, vessel.heave_period_s)
    return [
        size * np.sin(2 * np.pi * seconds / period + phase) for size, period, phase in zip(sizes, periods, phases, strict=True)
    ]


def _radii(latitude_rad: FloatArray | float, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Metres a radian of latitude and of longitude."""
    sin2 = np.sin(latitude_rad) ** 2
    normal = SEMI_MAJOR_M / np.sqrt(1 - E2 * sin2)
    meridian = normal * (1 - E2) / (1 - E2 * sin2)
    return np.asarray(meridian + height_m), np.asarray((normal + height_m) * np.cos(latitude_rad))


@lru_cache(maxsize=32)
def _way(vessel: Vessel, end_s: float) -> BSpline:
    """Latitude, longitude and course (unwrapped), rad, as functions of time, until some time after `end_s`.

    The ship is steered in steps of a second; the truth is the quintic spline through these.
    """
    from scipy.interpolate import make_interp_spline

    ahead = round((end_s + _MARGIN_S) / _STEP_S)
    astern = round(_MARGIN_S / _STEP_S)
    row = np.empty((astern + ahead + 1, 3))
    start = math.radians(vessel.lat_deg), math.radians(vessel.lon_deg)
    marks = [(math.radians(lat), math.radians(lon)) for lat, lon in vessel.waypoints]
    course = math.radians(vessel.course_deg) if not marks else _bearing(*start, *marks[0])
    steady, most = math.radians(vessel.turn_degps), math.radians(vessel.max_turn_degps)
    latitude, longitude, course0, turn = *start, course, steady
    for k in range(astern, len(row)):
        row[k] = latitude, longitude, course
        if marks:
            north, east = (float(v) for v in _radii(latitude, vessel.height_m))
            away = math.hypot((marks[0][0] - latitude) * north, (marks[0][1] - longitude) * east)
            wish = _bearing(latitude, longitude, *marks[0])
            # Close enough to come onto the next leg, or come abeam within the circle that it can turn.
            if away < vessel.speed_mps * (0.5 * math.pi / most if len(marks) > 1 else 1.0) / 2 + 2 * vessel.speed_mps:
                marks = marks[1:]
                wish = course if not marks else _bearing(latitude, longitude, *marks[0])
            off = math.remainder(wish - course, 2 * math.pi)
            step = max(-most, min(most, off / _STEER_S)) - turn
            turn += max(-most / _STEER_S, min(most / _STEER_S, step)) * _STEP_S
        elif vessel.waypoints:
            turn *= math.exp(-_STEP_S / _STEER_S)
        latitude, longitude, course = _moved(latitude, longitude, course, turn, _STEP_S, vessel)
    latitude, longitude, course = *start, course0
    for k in range(astern - 1, -1, -1):
        latitude, longitude, course = _moved(latitude, longitude, course, steady, -_STEP_S, vessel)
        row[k] = latitude, longitude, course
    return make_interp_spline(_STEP_S * (np.arange(len(row)) - astern), row, k=5)


def _moved(
    latitude: float, longitude: float, course: float, turn: float, step_s: float, vessel: Vessel
) -> tuple[float, float, float]:
    """Latitude, longitude and course after a step at a rate of turn: the chord lies in the mean course."""
    middle = course + 0.5 * turn * step_s
    chord = vessel.speed_mps * step_s * float(np.sinc(0.5 * turn * step_s / math.pi))
    north, east = (float(v) for v in _radii(latitude, vessel.height_m))
    return latitude + chord * math.cos(middle) / north, longitude + chord * math.sin(middle) / east, course + turn * step_s


def _bearing(latitude: float, longitude: float, to_latitude: float, to_longitude: float) -> float:
    """The course to a place nearby, rad."""
    north, east = (float(v) for v in _radii(0.5 * (latitude + to_latitude), 0.0))
    return math.atan2((to_longitude - longitude) * east, (to_latitude - latitude) * north)
