"""Where simulated aircraft and ships truly are: routes with limited bank, turn, speed and climb, as smooth functions of time.

A flight or voyage is first gone through in steps of one second by a simple autopilot along its waypoints.  The truth is then, by
definition, the quintic spline through these positions in Earth-centred axes: its velocity, acceleration and jerk at any time are
exact derivatives of its position.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from ..model import pack_callsigns

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


GRAVITY_MPS2 = 9.80665
FLIGHT_LEVEL_M = 30.48
STEP_S = 1.0
_EARTH_M = 6_371_000.0


class Airport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where flights land and take off.  `height_m` is ellipsoidal, `runway_deg` the direction of landing and take-off."""

    lat_deg: float
    lon_deg: float
    height_m: float = 0.0
    runway_deg: float = 250.0


class Traffic(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How many aircraft, and the shares of what they do; what the shares leave to 1 flies over.

    `delay_sd_m` is the spread between transponders of half the reply delay's error, as range; `altimetry_sd_m` that of the
    altimeters.  `radius_m` is the region around its centre where flights begin and end.
    """

    aircraft: int = 30
    lat_deg: float = 41.3
    lon_deg: float = 2.1
    radius_m: float = 220e3
    arrivals: float = 0.25
    departures: float = 0.2
    local: float = 0.1
    holding: float = 0.3
    delay_sd_m: float = 10.0
    altimetry_sd_m: float = 12.0


class Atmosphere(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How geometric height differs from pressure altitude: ISA + `isa_deviation_k`, shifted by `shift_m` at sea level.

    `shift_m` holds all that is constant: (QNH - 1013.25 hPa) times 8.2 m/hPa plus the geoid's height above the ellipsoid.
    """

    isa_deviation_k: float = 0.0
    shift_m: float = 0.0

    def geometric_m(self, pressure_altitude_m: FloatArray) -> FloatArray:
        """Ellipsoidal heights (n,) of pressure altitudes (n,), metres: each layer is thicker by T / T_isa (hydrostatic)."""
        low = np.minimum(pressure_altitude_m, 11_000.0)
        stretch = np.log(288.15 / (288.15 - 0.0065 * low)) / 0.0065 + np.maximum(pressure_altitude_m - 11_000.0, 0.0) / 216.65
        return pressure_altitude_m + self.shift_m + self.isa_deviation_k * stretch

    def pressure_m(self, height_m: FloatArray) -> FloatArray:
        """Pressure altitudes (n,) of ellipsoidal heights (n,), metres: the inverse of `geometric_m`, to a micrometre."""
        guess = np.asarray(height_m, np.float64) - self.shift_m
        for _ in range(12):
            guess = guess - (self.geometric_m(guess) - height_m)
        return guess


@dataclass(frozen=True, slots=True, eq=False)
class Aircraft:
    """The simulated aircraft: columns (n,); the row number is the target's number.

    `transponder_delay_m` is added to the range of every secondary plot, `altimetry_m` to the pressure altitude.  `accuracy` is
    the navigation accuracy category NACp, -1 where the aircraft has no ADS-B; `latency_s` is by how much its reports are stamped
    late; `interval_s` is the mean time between them.
    """

    mode_s: IntArray
    mode_3a: IntArray
    callsign: IntArray
    length_m: FloatArray
    transponder_delay_m: FloatArray
    altimetry_m: FloatArray
    altitude_quantum_m: FloatArray
    accuracy: IntArray
    latency_s: FloatArray
    interval_s: FloatArray


class Shipping(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How many ships sail off a port, and the shares of what they do; what the shares leave to 1 are pleasure craft.

    `lat_deg` and `lon_deg` are the port's entrance, `seaward_deg` the direction from it straight out to sea; the coast runs at
    right angles.  `passing` merchant ships keep to two lanes along the coast, one for each direction, `calling` ones go in and
    out, `fishing` boats and pleasure craft wander, `anchored` ships swing at the roads.  `sea_level_m` is ellipsoidal;
    `current_mps` sets roughly along the coast, so that headings differ from courses.
    """

    ships: int = 20
    lat_deg: float = 41.3
    lon_deg: float = 2.2
    seaward_deg: float = 140.0
    radius_m: float = 30e3
    passing: float = 0.4
    calling: float = 0.3
    fishing: float = 0.15
    anchored: float = 0.05
    sea_level_m: float = 0.0
    current_mps: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Ships:
    """The simulated ships: columns (m,).

    Where a ship is, is where the middle of its hull is; its GNSS antenna is `bow_m` behind the bow and `port_m` right of the port
    side, whole metres as static data tell them.  `ship_type` is AIS's code, `class_b` the lighter equipment of small craft.
    `gyro_rad` is the compass's error, `latency_s` by how much positions are stamped late, `position_sd_m` the accuracy of the
    ship's receiver, an sd per axis.
    """

    mmsi: IntArray
    callsign: IntArray
    ship_type: IntArray
    length_m: FloatArray
    width_m: FloatArray
    bow_m: FloatArray
    port_m: FloatArray
    class_b: BoolArray
    gyro_rad: FloatArray
    latency_s: FloatArray
    position_sd_m: FloatArray

    def __len__(self) -> int:
        return len(self.mmsi)


def no_ships() -> Ships:
    """No ships at all."""
    none, nothing = np.empty(0, np.int64), np.empty(0)
    return Ships(none, none, none, nothing, nothing, nothing, nothing, np.empty(0, np.bool_), nothing, nothing, nothing)


class Motion(NamedTuple):
    """Position and its derivatives (n, 3), Earth-centred axes, SI; NaN outside the flight."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """All flights and voyages as functions of time.

    `epoch_s` is the scene's begin (UTC); target k exists from `first_s[k]` to `last_s[k]`, seconds after the epoch.  The aircraft
    come first, then the ships; `headings` are the ships' alone (an aircraft points where it flies).  `names` are those of
    scripted targets, empty for all others.
    """

    epoch_s: float
    first_s: FloatArray
    last_s: FloatArray
    aircraft: Aircraft
    atmosphere: Atmosphere
    curves: tuple[BSpline, ...]
    ships: Ships = field(default_factory=no_ships)
    headings: tuple[BSpline, ...] = ()
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.curves)

    @property
    def flights(self) -> int:
        """The number of aircraft: the number of the first ship."""
        return len(self.curves) - len(self.headings)

    @property
    def length_m(self) -> FloatArray:
        """The length of every target (n,)."""
        return np.concatenate([self.aircraft.length_m, self.ships.length_m])

    def motion(self, target: IntArray, seconds: FloatArray, derivatives: int = 3) -> Motion:
        """Position, velocity, acceleration and jerk of targets (n,) at times (n,), seconds after the epoch.

        Only the first `derivatives` derivatives are computed, the others are NaN.
        """
        out = np.full((4, len(target), 3), np.nan)
        order = np.argsort(target, kind="stable")
        cuts = np.flatnonzero(np.diff(np.asarray(target)[order])) + 1
        for rows in np.split(order, cuts) if len(order) else []:
            k = int(target[rows[0]])
            when = seconds[rows]
            inside = (when >= self.first_s[k]) & (when <= self.last_s[k])
            for nu in range(derivatives + 1):
                out[nu, rows[inside]] = self.curves[k](when[inside], nu=nu)
        return Motion(out[0], out[1], out[2], out[3])

    def geodetic(self, position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Latitude and longitude (radians) and pressure altitude (metres, without any altimeter's error) of positions (n, 3)."""
        latitude, longitude, height = geodetic_from_ecef(position)
        return latitude, longitude, self.atmosphere.pressure_m(height)

    def course_rad(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """The direction of flight over ground (n,), clockwise from true north."""
        latitude, longitude, _ = geodetic_from_ecef(position)
        local = rotate(enu_from_ecef(latitude, longitude), velocity)
        return np.arctan2(local[:, 0], local[:, 1])

    def heading_rad(self, target: IntArray, seconds: FloatArray, motion: Motion) -> FloatArray:
        """Where targets (n,) point, clockwise from true north: aircraft along their course, ships where they are steered."""
        out = self.course_rad(motion.position, motion.velocity)
        for k in np.unique(target[target >= self.flights]).tolist():
            rows = target == k
            out[rows] = self.headings[k - self.flights](np.clip(seconds[rows], self.first_s[k], self.last_s[k]))
        return out


def smooth_curve(seconds: FloatArray, values: FloatArray, degree: int = 5) -> BSpline:
    """The spline through positions (n, 3), or values (n,), at rising times (n,): what a target's truth is.

    Of the fifth degree it is continuous up to the fourth derivative.
    """
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(seconds, values, k=degree)


class _Plan(NamedTuple):
    """What the autopilot is to do, one row a flight; waypoints are padded with the last one (n, w)."""

    latitude: FloatArray
    longitude: FloatArray
    waypoints: IntArray
    speed_mps: FloatArray
    height_m: FloatArray
    cruise_m: FloatArray
    final_m: FloatArray
    climb_mps: FloatArray
    pace: FloatArray
    lands: BoolArray


# True air speed of an airliner by altitude; a flight's pace scales it.
_LEVELS_M = np.array([0.0, 3000.0, 3800.0, 9000.0, 12000.0])
_SPEEDS_MPS = np.array([118.0, 145.0, 175.0, 232.0, 236.0])
_BANK_RAD = math.radians(25.0)
_TURN_RADPS = math.radians(3.0)


def _fly(plan: _Plan, steps: int) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Fly all plans in steps of a second: latitude, longitude, pressure altitude (n, steps), and how many steps each flew."""
    n = len(plan.waypoints)
    row = np.arange(n)
    lat, lon = plan.latitude[:, 0].copy(), plan.longitude[:, 0].copy()
    north = np.diff(plan.latitude, axis=1) * _EARTH_M
    east = np.diff(plan.longitude, axis=1) * _EARTH_M * np.cos(plan.latitude[:, 1:])
    bearing = np.arctan2(east, north)
    # Path length from each waypoint to the end.
    tail = np.concatenate([np.cumsum(np.hypot(east, north)[:, ::-1], axis=1)[:, ::-1], np.zeros((n, 1))], axis=1)
    goal = np.ones(n, np.int64)
    heading, bank = bearing[:, 0].copy(), np.zeros(n)
    speed, height, rise = plan.speed_mps.copy(), plan.height_m.copy(), np.zeros(n)
    track = np.empty((3, n, steps))
    flown = np.full(n, steps, np.int64)
    flying = np.ones(n, np.bool_)
    for k in range(steps):
        track[0, :, k], track[1, :, k], track[2, :, k] = lat, lon, height
        far_north = (plan.latitude[row, goal] - lat) * _EARTH_M
        far_east = (plan.longitude[row, goal] - lon) * _EARTH_M * np.cos(lat)
        far = np.hypot(far_east, far_north)
        last = goal == plan.waypoints - 1
        steepest = np.minimum(_BANK_RAD, np.arctan(_TURN_RADPS * speed / GRAVITY_MPS2))
        radius = speed * speed / (GRAVITY_MPS2 * np.tan(steepest))
        wish = np.arctan2(far_east, far_north)
        # Turn early enough to roll out on the next leg; a goal that has come abeam is passed.
        following = bearing[row, np.minimum(goal, plan.waypoints - 2)]
        change = np.abs(np.mod(following - wish + np.pi, 2 * np.pi) - np.pi)
        lead = np.where(last, 0.0, radius * np.tan(np.minimum(change, 2.0) / 2)) + 2.0 * speed
        error = np.mod(wish - heading + np.pi, 2 * np.pi) - np.pi
        reached = (far < lead) | ((np.abs(error) > 1.5) & (far < 1.5 * radius))
        done = flying & reached & last
        flown[done] = k + 1
        flying &= ~done
        if not flying.any():
            break
        step = np.where(flying, STEP_S, 0.0)
        goal = np.where(reached & ~last, goal + 1, goal)

        wanted = np.clip(np.arctan(speed * error / (8.0 * GRAVITY_MPS2)), -steepest, steepest)
        bank += np.clip(0.4 * (wanted - bank), -math.radians(5), math.radians(5)) * step
        to_go = far + tail[row, goal]
        pace = plan.pace * np.interp(height, _LEVELS_M, _SPEEDS_MPS)
        pace = np.where(plan.lands, np.minimum(pace, 70.0 + to_go * 2.6e-3), pace)
        speed += np.clip((pace - speed) / 8.0, -0.7, 0.9) * step
        glide = plan.final_m + to_go * math.tan(math.radians(3.0))
        level = np.where(plan.lands, np.minimum(plan.cruise_m, glide), plan.cruise_m)
        climb = plan.climb_mps * (1.15 - height / 14_000.0)
        rise += np.clip(np.clip((level - height) / 10.0, -16.0, climb) - rise, -0.4, 0.4) * step
        height += rise * step
        lat_rate = speed * np.cos(heading) / (_EARTH_M + height)
        lon_rate = speed * np.sin(heading) / ((_EARTH_M + height) * np.cos(lat))
        # Meridians converge: along a great circle the heading itself turns.
        heading += (GRAVITY_MPS2 * np.tan(bank) / speed + lon_rate * np.sin(lat)) * step
        lat += lat_rate * step
        lon += lon_rate * step
    lat_all, lon_all, level = track[:, :, : int(flown.max())]
    return lat_all, lon_all, level, flown


def _unit(angle: float) -> FloatArray:
    """The unit vector (east, north) of a bearing."""
    return np.array([math.sin(angle), math.cos(angle)])


def _overflight(rng: np.random.Generator, edge: FloatArray, inner: FloatArray, radius: float) -> list[FloatArray]:
    """In over one boundary fix, along one or two inner fixes near the straight line, out over another."""
    first = int(rng.integers(len(edge)))
    ahead = [k for k in range(len(edge)) if np.dot(edge[k], edge[first]) < -0.2 * radius * radius]
    last = int(rng.choice(ahead))
    line = edge[last] - edge[first]
    length = float(np.hypot(*line))
    line = line / length
    offset = inner - edge[first]
    along, aside = offset @ line, offset @ np.array([line[1], -line[0]])
    near = np.flatnonzero((np.abs(aside) < 0.28 * length) & (along > 0.2 * length) & (along < 0.8 * length))
    via: list[int] = []
    for k in rng.permutation(near):
        if len(via) < 2 and all(abs(along[k] - along[j]) > 0.3 * length for j in via):
            via.append(int(k))
    return [edge[first], *(inner[k] for k in sorted(via, key=lambda j: along[j])), edge[last]]


def _arrival(rng: np.random.Generator, edge: FloatArray, airport: FloatArray, runway: float, holds: bool) -> list[FloatArray]:
    """From a boundary fix to an initial fix, some rounds of a racetrack, base leg, final, threshold."""
    start = edge[int(rng.integers(len(edge)))]
    along = _unit(runway)
    final = airport - 16e3 * along
    across = _unit(runway + math.pi / 2)
    side = 1.0 if float(np.dot(start - airport, across)) > 0 else -1.0
    base = final + side * 9e3 * across - 4e3 * along
    inbound = base - start
    inbound = inbound / np.hypot(*inbound)
    fix = base - inbound * rng.uniform(25e3, 45e3)
    points = [start, fix]
    if holds:
        right = np.array([inbound[1], -inbound[0]])
        for _ in range(int(rng.integers(1, 4))):
            points += [fix + 9e3 * right, fix + 9e3 * right - 12e3 * inbound, fix - 12e3 * inbound, fix]
    return [*points, base, final, airport]


def _departure(rng: np.random.Generator, edge: FloatArray, airport: FloatArray, runway: float) -> list[FloatArray]:
    """Straight ahead, a turn towards a boundary fix, and out."""
    ahead = airport + 9e3 * _unit(runway)
    end = edge[int(rng.integers(len(edge)))]
    outward = end - ahead
    turned = math.atan2(outward[0], outward[1]) + rng.uniform(-0.5, 0.5)
    return [airport, ahead, ahead + rng.uniform(35e3, 60e3) * _unit(turned), end]


def _local(rng: np.random.Generator, radius: float) -> list[FloatArray]:
    """A low flight over a few places near the centre."""
    points = [rng.uniform(-1, 1, 2) * min(0.25 * radius, 45e3)]
    while len(points) < 5:
        step = points[-1] + rng.uniform(9e3, 25e3) * _unit(rng.uniform(0, 2 * math.pi))
        if np.hypot(*step) < min(0.35 * radius, 60e3):
            points.append(step)
    return points


def fly_traffic(
    traffic: Traffic,
    airports: tuple[Airport, ...],
    atmosphere: Atmosphere,
    epoch_s: float,
    duration_s: float,
    aircraft: Aircraft,
    rng: np.random.Generator,
) -> Truth:
    """The flights of a scene, from its begin to `duration_s` after it.

    Airways join fixes on the region's boundary over shared inner fixes; arrivals, departures and holdings belong to the airports;
    local flights stay low near the centre.  Flights keep pressure levels (semicircular rule), so their geometric height follows
    the atmosphere.  Each takes part for at least a third of its length or of the scene.
    """
    n = traffic.aircraft
    if not n:
        return Truth(
            epoch_s=epoch_s, first_s=np.empty(0), last_s=np.empty(0), aircraft=aircraft, atmosphere=atmosphere, curves=()
        )  # fmt: skip
    radius = traffic.radius_m
    lat0, lon0 = math.radians(traffic.lat_deg), math.radians(traffic.lon_deg)

    bearings = (np.arange(14) + rng.uniform(-0.35, 0.35, 14)) * 2 * math.pi / 14
    edge = np.stack([np.sin(bearings), np.cos(bearings)], axis=1) * radius
    reach, turn = radius * np.sqrt(rng.uniform(0.01, 0.4, 10)), (np.arange(10) + rng.uniform(-0.4, 0.4, 10)) * 2 * math.pi / 10
    inner = np.stack([np.sin(turn), np.cos(turn)], axis=1) * reach[:, None]
    # Whole numbers of each kind, so that two seeds differ in routes and not in what there is.
    lands = round(traffic.arrivals * n) if airports else 0
    starts = round(traffic.departures * n) if airports else 0
    low = round(traffic.local * n)
    holding = round(traffic.holding * lands)
    routes: list[list[FloatArray]] = []
    begin: list[float] = []
    speed, cruise, final, pace = np.empty(n), np.empty(n), np.zeros(n), np.empty(n)
    for k in range(n):
        if k < lands + starts:
            airport = airports[k % len(airports)]
            place = np.array(
                [
                    (math.radians(airport.lon_deg) - lon0) * _EARTH_M * math.cos(lat0),
                    (math.radians(airport.lat_deg) - lat0) * _EARTH_M,
                ]
            )
            ground = float(atmosphere.pressure_m(np.array([airport.height_m]))[0])
            runway = math.radians(airport.runway_deg)
            pace[k] = rng.uniform(0.9, 1.05)
            if k < lands:
                routes.append(_arrival(rng, edge, place, runway, k < holding))
                cruise[k] = FLIGHT_LEVEL_M * 10 * rng.integers(*((13, 19) if k < holding else (20, 36)))
                final[k] = ground + 15.0
                begin.append(cruise[k])
                speed[k] = pace[k] * np.interp(cruise[k], _LEVELS_M, _SPEEDS_MPS)
            else:
                routes.append(_departure(rng, edge, place, runway))
                cruise[k] = FLIGHT_LEVEL_M * 10 * rng.integers(24, 39)
                begin.append(ground + 60.0)
                speed[k] = 78.0
        elif k < lands + starts + low:
            routes.append(_local(rng, radius))
            cruise[k] = rng.uniform(450.0, 2200.0)
            begin.append(cruise[k])
            pace[k] = rng.uniform(0.45, 0.7)
            speed[k] = pace[k] * np.interp(cruise[k], _LEVELS_M, _SPEEDS_MPS)
        else:
            routes.append(_overflight(rng, edge, inner, radius))
            eastbound = routes[-1][-1][0] > routes[-1][0][0]
            cruise[k] = FLIGHT_LEVEL_M * 10 * (2 * rng.integers(13, 20) + (1 if eastbound else 0))
            pace[k] = rng.uniform(0.88, 1.06)
            speed[k] = pace[k] * np.interp(cruise[k], _LEVELS_M, _SPEEDS_MPS)
            # A change of level somewhere on the way: some overflights enter 2,000 ft lower.
            begin.append(cruise[k] - (2000 * 0.3048 if rng.random() < 0.3 else 0.0))
    width = max(len(route) for route in routes)
    points = np.array([[*route, *([route[-1]] * (width - len(route)))] for route in routes])
    latitude = lat0 + points[:, :, 1] / _EARTH_M
    plan = _Plan(
        latitude=latitude,
        longitude=lon0 + points[:, :, 0] / (_EARTH_M * math.cos(lat0)),
        waypoints=np.array([len(route) for route in routes]),
        speed_mps=speed,
        height_m=np.array(begin),
        cruise_m=cruise,
        final_m=final,
        climb_mps=rng.uniform(9.0, 14.0, n),
        pace=pace,
        lands=np.arange(n) < lands,
    )
    longest = float((np.hypot(*np.moveaxis(np.diff(points, axis=1), 2, 0)).sum(axis=1) / (60.0 + 0.5 * speed)).max())
    lat, lon, level, flown = _fly(plan, int(longest / STEP_S) + 300)
    height = atmosphere.geometric_m(level)
    position = ecef_from_geodetic(lat, lon, height)

    length_s = (flown - 1) * STEP_S
    earliest, latest = -0.4 * length_s, np.maximum(duration_s - 0.6 * length_s, -0.35 * length_s)
    start = np.rint(rng.uniform(earliest, latest))
    curves = []
    for k in range(n):
        # The knots beyond the scene are not needed, save a few at each end.
        first = max(0, int(-start[k] / STEP_S) - 10)
        last = min(int(flown[k]), int((duration_s - start[k]) / STEP_S) + 12)
        when = start[k] + STEP_S * np.arange(first, last)
        curves.append(smooth_curve(when, position[k, first:last]))
    return Truth(
        epoch_s=epoch_s,
        first_s=np.maximum(start, 0.0),
        last_s=np.minimum(start + length_s, duration_s),
        aircraft=aircraft,
        atmosphere=atmosphere,
        curves=tuple(curves),
    )


# What sails: AIS type, shortest and longest (m), slowest and fastest (knots), antenna's place (share of the length from the bow).
_MERCHANT = ((70, 80.0, 300.0, 10.0, 20.0, 0.82), (80, 90.0, 280.0, 9.0, 15.0, 0.82))
_CALLER = ((70, 70.0, 220.0, 9.0, 18.0, 0.82), (60, 110.0, 225.0, 15.0, 20.0, 0.3))
_FISHING = ((30, 12.0, 30.0, 5.0, 9.0, 0.4),)
_PLEASURE = ((37, 10.0, 24.0, 5.0, 18.0, 0.55), (36, 10.0, 18.0, 5.0, 7.0, 0.6))
_KNOT_MPS = 1852.0 / 3600.0
_COUNTRIES = (224, 225, 247, 228, 248, 256, 311, 636, 538, 255)


def sail_shipping(
    shipping: Shipping, truth: Truth, duration_s: float, latency_s: tuple[float, float], rng: np.random.Generator
) -> Truth:
    """The same truth with the ships of a scene added behind the aircraft.

    Lengths, speeds, antennas and turning follow the kind of ship; big ships turn slowly.  Each sails through the water where it
    points and drifts with the current, so heading and course differ by some degrees.  `latency_s` is the mean and sd over ships
    of how late positions are stamped.
    """
    n = shipping.ships
    if not n:
        return truth
    passing, calling = round(shipping.passing * n), round(shipping.calling * n)
    fishing, anchored = round(shipping.fishing * n), round(shipping.anchored * n)
    rest = max(n - passing - calling - fishing - anchored, 0)
    trade = np.repeat([0, 1, 2, 3, 4], [passing, calling, fishing, anchored, rest])[:n]
    kinds = (_MERCHANT, _CALLER, _FISHING, _MERCHANT, _PLEASURE)
    kind = [kinds[t][int(rng.integers(len(kinds[t])))] for t in trade]
    code = np.array([k[0] for k in kind], np.int64)
    low, high, slow, fast, antenna = np.array([k[1:] for k in kind]).T
    length = np.rint(low * (high / low) ** rng.random(n))
    speed = rng.uniform(slow, fast) * _KNOT_MPS
    width = np.maximum(np.rint(length / rng.uniform(5.5, 7.5, n) + 1.5), 3.0)
    bow = np.clip(np.rint(length * (antenna + rng.uniform(-0.06, 0.06, n))), 1.0, length - 1.0)
    port = np.clip(np.rint(width * rng.uniform(0.35, 0.65, n)), 1.0, width - 1.0)
    mmsi = rng.choice(_COUNTRIES, n).astype(np.int64) * 1_000_000 + rng.choice(999_999, n, replace=False)
    exact = rng.random(n) < 0.5
    ships = Ships(
        mmsi=mmsi,
        callsign=pack_callsigns([f"E{chr(65 + k % 26)}{int(v):04d}" for k, v in enumerate(rng.choice(9999, n, replace=False))]),
        ship_type=code,
        length_m=length,
        width_m=width,
        bow_m=bow,
        port_m=port,
        class_b=trade == 4,
        gyro_rad=np.radians(rng.normal(0.0, 0.7, n)),
        latency_s=latency_s[0] + latency_s[1] * rng.normal(0.0, 1.0, n),
        position_sd_m=np.where(exact, 2.0, 5.0),
    )
    points, lasts = _voyages(shipping, trade, speed, duration_s, rng)
    place, heading, sailed = _sail(points, speed, length, lasts, shipping, int(duration_s / STEP_S) + 12)
    when = STEP_S * np.arange(place.shape[1], dtype=np.float64)
    for k in np.flatnonzero(trade == 3):
        turns = when / rng.uniform(500.0, 900.0) + rng.random()
        swing = rng.uniform(0.0, 2 * math.pi) + math.radians(25.0) * np.sin(2 * math.pi * turns)
        place[k] = points[k, 0] - (0.6 * length[k] + 80.0) * np.stack([np.sin(swing), np.cos(swing)], axis=1)
        heading[k], sailed[k] = swing, len(when)

    lat0, lon0 = math.radians(shipping.lat_deg), math.radians(shipping.lon_deg)
    latitude = lat0 + place[:, :, 1] / _EARTH_M
    longitude = lon0 + place[:, :, 0] / (_EARTH_M * math.cos(lat0))
    position = ecef_from_geodetic(latitude, longitude, np.full(latitude.shape, shipping.sea_level_m))

    last = np.minimum((sailed - 1) * STEP_S, duration_s)
    curves = tuple(smooth_curve(when[: sailed[k]], position[k, : sailed[k]]) for k in range(n))
    headings = tuple(smooth_curve(when[: sailed[k]], heading[k, : sailed[k]], degree=3) for k in range(n))
    return replace(
        truth,
        first_s=np.concatenate([truth.first_s, np.zeros(n)]),
        last_s=np.concatenate([truth.last_s, last]),
        curves=truth.curves + curves,
        ships=ships,
        headings=headings,
    )


def _voyages(
    shipping: Shipping, trade: IntArray, speed: FloatArray, duration_s: float, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Waypoints (n, w, 2) east and north of the port, padded with the last one, and which ships stop at their last one."""
    out, along = _unit(math.radians(shipping.seaward_deg)), _unit(math.radians(shipping.seaward_deg + 90.0))
    reach = shipping.radius_m
    routes: list[list[FloatArray]] = []
    for k, what in enumerate(trade.tolist()):
        way = speed[k] * duration_s
        if what == 0:
            side = 1.0 if k % 2 else -1.0
            # Traffic keeps to starboard: the two directions have lanes of their own.
            lane = out * reach * ((0.42 if side > 0 else 0.58) + rng.uniform(-0.04, 0.04))
            middle = rng.uniform(-0.45, 0.45) * reach
            bend = out * rng.uniform(-0.08, 0.08) * reach
            ends = middle - side * way / 2, middle + side * (way / 2 + 5e3)
            routes.append([lane + ends[0] * along, lane + middle * along + bend, lane + ends[1] * along])
        elif what == 1:
            fan = math.radians(shipping.seaward_deg + rng.uniform(-55.0, 55.0))
            pilot = 0.12 * reach * out
            far = pilot + rng.uniform(0.5, 0.85) * reach * _unit(fan)
            part = min(1.0, way / float(np.hypot(*(far - pilot))))
            if k % 2:
                routes.append([pilot + rng.uniform(0.5 * part, part) * (far - pilot), pilot, 300.0 * out])
            else:
                begin = pilot + rng.uniform(0.0, max(1.0 - part, 0.05)) * (far - pilot)
                routes.append([begin, far, far + 20e3 * _unit(fan)])
        elif what == 3:
            routes.append([(0.16 + 0.08 * rng.random()) * reach * out + rng.uniform(-0.2, 0.2) * reach * along])
        else:
            here = rng.uniform(0.12, 0.6) * reach * out + rng.uniform(-0.5, 0.5) * reach * along
            legs = [here]
            while len(legs) < 14:
                ahead = legs[-1] + rng.uniform(1.5e3, 6e3) * _unit(rng.uniform(0.0, 2 * math.pi))
                if 0.06 * reach < ahead @ out < 0.75 * reach and abs(ahead @ along) < 0.7 * reach:
                    legs.append(ahead)
            routes.append(legs)
    width = max(2, *(len(route) for route in routes))
    points = np.array([[*route, *([route[-1]] * (width - len(route)))] for route in routes])
    return points, (trade == 1) & (np.arange(len(trade)) % 2 == 1)


def _sail(
    points: FloatArray, speed: FloatArray, length: FloatArray, stops: BoolArray, shipping: Shipping, steps: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Sail all routes in steps of a second: positions (n, steps, 2) east and north of the port, headings, and steps sailed."""
    n = len(points)
    row = np.arange(n)
    current = shipping.current_mps * _unit(math.radians(shipping.seaward_deg + 60.0))
    # A ship turns about three lengths wide, and takes its time to begin to.
    sharpest = np.minimum(speed / (3.0 * length), math.radians(3.0))
    inertia = np.clip(length / 6.0, 4.0, 40.0)
    here = points[:, 0].copy()
    first = points[:, 1] - here
    heading, turning, now = np.arctan2(first[:, 0], first[:, 1]), np.zeros(n), speed.copy()
    goal = np.ones(n, np.int64)
    place, pointing = np.empty((n, steps, 2)), np.empty((n, steps))
    sailed, going = np.full(n, steps, np.int64), np.ones(n, np.bool_)
    for k in range(steps):
        place[:, k], pointing[:, k] = here, heading
        there = points[row, goal] - here
        far = np.hypot(there[:, 0], there[:, 1])
        arrived = far < 4.0 * length + 100.0
        final = (points[row, goal] == points[:, -1]).all(axis=1)
        done = going & stops & (far < 200.0) & final
        sailed[done] = k + 1
        going &= ~done
        goal = np.where(arrived & ~final, goal + 1, goal)
        # At its last waypoint a ship that does not stop there holds its course.
        wish = np.where(arrived & final, heading, np.arctan2(there[:, 0], there[:, 1]))
        error = np.mod(wish - heading + np.pi, 2 * np.pi) - np.pi
        turning += (np.clip(error / (3.0 * inertia), -sharpest, sharpest) - turning) / inertia * STEP_S
        heading = heading + turning * STEP_S
        # Into the port at manoeuvring speed.
        wanted = np.where(stops & final, np.minimum(speed, 3.0 + far * 1.2e-3), speed)
        now = now + np.clip((wanted - now) / 60.0, -0.05, 0.05) * STEP_S
        step = now[:, None] * np.stack([np.sin(heading), np.cos(heading)], axis=1) + current
        here = here + np.where(going[:, None], step * STEP_S, 0.0)
    return place, pointing, sailed
