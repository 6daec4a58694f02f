"""What simulated radars say of the truth.

A radar's plot is ``measured = h(truth at t - late) + sum of value * column(geometry) + noise`` with the columns of `terms`,
stamped t: the truth is taken when the rotating antenna points at the target, not on a grid of scans.  The values may change
with time.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..assessment.detection import RadarEquation
from ..errors import SettingsError
from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from ..measure import heading_about, polar_from_enu, polar_motion, position_from_polar, wrap_turn
from ..model import Channel, Flag, Platform, Plots, Sensor
from ..terms import Geometry, Whose, late_s, term_of
from ..writing.asterix import Marks
from . import vessel
from .drift import Drift, History, Streams, drift_mistakes, gauss_markov, history
from .lint import Mistake
from .truth import STEP_S, Motion, Truth
from .vessel import Vessel

# The quanta of CAT048 and CAT021.
ASTERIX_RANGE_M = 1852.0 / 256
ASTERIX_AZIMUTH_DEG = 360.0 / 65536
ASTERIX_TIME_S = 1.0 / 128


# What `Radar.noise` may be of.
NOISES = ("range", "azimuth", "elevation", "time", "all")


class Noise(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a random error is, beyond its sd: as it stands, normal and new in every plot.

    Of the variance the share `correlated` wanders along each target's plots, with exp(-time apart / `correlation_s`); what is new
    in every plot is Student's t with `t_degrees` of freedom (above 2), where given.  The sd stays what the radar has.  A share
    `outliers` of the plots has `outlier_factor` times the error, which comes on top.
    """

    correlated: float = 0.0
    correlation_s: float = 30.0
    t_degrees: float | None = None
    outliers: float = 0.0
    outlier_factor: float = 5.0


class Clutter(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An area of clutter about the antenna: `plots` a scan on average, from `places` drawn once.

    The places lie evenly in the box of ranges and azimuths (clockwise from the first to the second, over north too), at up to a
    degree above the radar's lowest elevation.  Each shows in a scan with the probability `plots` / `places`, off by the sd
    `scatter_m` along and across, and is measured as any echo is.
    """

    range_m: tuple[float, float]
    azimuth_deg: tuple[float, float] = (0.0, 360.0)
    plots: float = 5.0
    places: int = 50
    scatter_m: float = 50.0


class Gaps(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When and where a radar gives no plots at all, false ones included.

    `outage_s` are given outages (from, to), seconds after the start.  Others begin every `every_s` on average (0: none), and last
    `length_s` on average, as chance has it.  `blind_deg` are sectors (from, to), clockwise from the first to the second.
    """

    outage_s: tuple[tuple[float, float], ...] = ()
    every_s: float = 0.0
    length_s: float = 20.0
    blind_deg: tuple[tuple[float, float], ...] = ()


class Radar(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One simulated radar: where it stands, how it turns, how well it measures, and its errors.

    `errors` maps names of terms (`terms.term_of`, so for one channel too) to values in the terms' own units (deg, m, m/km, s),
    each a number or a `Drift`.  Of the clock, ``time_offset`` is by how much stamps are late, be it a day, and jumps where it has
    steps; ``clock_drift`` is a rate that adds up from the scene's start; within each (from, to) of `stuck_s` it stands still;
    `time_sd_s` is jitter.  `detection` is a probability, or a `RadarEquation` that gives it by range.  `noise` says what the
    random errors of "range", "azimuth", "elevation" and "time" are beyond their sds, "all" what those are that it does not name.
    With `elevation_sd_deg` the radar measures elevation.  A quantum of 0 leaves the value as it is.

    `kind` decides the identity that its plots carry: mode_s and combined all of it, ssr Mode 3/A and altitude, psr and marine
    none; a marine radar sees the ships, all others the aircraft.  ``identity=False`` takes address, code and callsign away and
    leaves the altitude.  Secondary ranges carry each aircraft's transponder delay.  Of a combined radar the share `primary_only`
    of the plots is the primary's alone; during the share `second_chain` of the scene, its end, the second processing chain works.
    `false_plots` are per scan, anywhere; `clutter` has places.  `first_north_s` is when the antenna first points north (None:
    drawn).  `ground_height_m` is what sensors.toml tells of the ground, or the sea.  On a `platform` the radar sails along, from
    the place that is given; the phases of the ship's swinging are drawn where it has none.
    """

    name: str
    sac: int
    sic: int
    lat_deg: float
    lon_deg: float
    height_m: float = 0.0
    kind: str = "mode_s"
    scan_s: float = 4.0
    first_north_s: float | None = None
    min_range_m: float = 1000.0
    max_range_m: float = 200e3
    min_elevation_deg: float = 0.2
    max_elevation_deg: float = 45.0
    detection: float | RadarEquation = 0.97
    range_sd_m: float = 30.0
    azimuth_sd_deg: float = 0.06
    elevation_sd_deg: float | None = None
    time_sd_s: float = 0.0
    range_quantum_m: float = ASTERIX_RANGE_M
    azimuth_quantum_deg: float = ASTERIX_AZIMUTH_DEG
    elevation_quantum_deg: float = 0.0
    time_quantum_s: float = ASTERIX_TIME_S
    identity: bool = True
    height_from_elevation: bool = False
    false_plots: float = 0.0
    ground_height_m: float | None = None
    primary_only: float = 0.0
    second_chain: float = 0.0
    errors: dict[str, float | Drift] = msgspec.field(default_factory=dict)
    noise: dict[str, Noise] = msgspec.field(default_factory=dict)
    clutter: tuple[Clutter, ...] = ()
    gaps: Gaps = Gaps()
    stuck_s: tuple[tuple[float, float], ...] = ()
    platform: Vessel | None = None

    @property
    def sensor(self) -> Sensor:
        """The entry of sensors.toml: what an operator would know of this radar, so without its errors and noise."""
        sensor = Sensor(
            name=self.name,
            sac=self.sac,
            sic=self.sic,
            kind=self.kind,
            scan_s=self.scan_s,
            max_range_m=self.max_range_m,
            ground_height_m=self.ground_height_m,
        )
        if self.platform is not None:
            # Where it is, own ship reports.
            return msgspec.structs.replace(sensor, lever_arm_m=self.platform.lever_arm_m, angles=self.platform.angles)
        return msgspec.structs.replace(sensor, lat_deg=self.lat_deg, lon_deg=self.lon_deg, height_m=self.height_m)


def check_radar(radar: Radar, where: str) -> None:
    """Raise SettingsError with the first of `radar_mistakes`."""
    for place, text, remedy in radar_mistakes(radar):
        raise SettingsError(text, where=f"{where}: {'.'.join(map(str, place))}", remedy=remedy)


def radar_mistakes(radar: Radar) -> Iterator[Mistake]:
    """What makes no sense of a radar's drifts, detection, noise, clutter, gaps, clock and ship, each with its place in the radar.

    What is of names, kinds and places is the scenario's to check.
    """
    for name, error in radar.errors.items():
        for text in drift_mistakes(error if isinstance(error, Drift) else Drift(value=error)):
            yield Mistake(("errors", name), text)
    if isinstance(radar.detection, RadarEquation):
        try:
            # What is wrong with a detector is said by it.
            radar.detection.probability(radar.detection.range_m)
        except SettingsError as error:
            yield Mistake(("detection",), str(error.args[0]), error.remedy)
    elif not 0 < radar.detection <= 1:
        yield Mistake(("detection",), f"detection = {radar.detection} is not within 0 … 1")
    for name, noise in radar.noise.items():
        place = ("noise", name)
        if name not in NOISES:
            yield Mistake(place, f"there is no noise {name!r}", f"Known: {', '.join(NOISES)}.")
        if name == "elevation" and radar.elevation_sd_deg is None:
            yield Mistake(place, "needs a radar that measures elevation", "Give elevation_sd_deg.")
        if not (0 <= noise.correlated <= 1 and 0 < noise.correlation_s < math.inf):
            yield Mistake(place, "needs correlated within 0 … 1 and correlation_s above 0")
        if noise.t_degrees is not None and not 2 < noise.t_degrees < math.inf:
            remedy = "Give more than 2; leave it out for a normal error."
            yield Mistake(place, f"t_degrees = {noise.t_degrees:g} has no sd", remedy)
        if not (0 <= noise.outliers <= 1 and 0 <= noise.outlier_factor < math.inf):
            yield Mistake(place, "needs outliers within 0 … 1 and an outlier_factor not below 0")
    for number, area in enumerate(radar.clutter):
        if not radar.min_range_m <= area.range_m[0] < area.range_m[1] <= radar.max_range_m:
            limits = f"{radar.min_range_m:g} … {radar.max_range_m:g} m"
            yield Mistake(("clutter", number), f"range_m must rise, within what the radar sees ({limits})")
        if not all(map(math.isfinite, area.azimuth_deg)) or not 0 <= area.scatter_m < math.inf:
            yield Mistake(("clutter", number), "needs azimuth_deg that are numbers and scatter_m not below 0")
        if not 0 < area.plots <= area.places:
            text = f"plots = {area.plots:g} a scan cannot come from {area.places} places, which give at most one each"
            yield Mistake(("clutter", number), text, "Give plots above 0, and as many places or more.")
    gaps = radar.gaps
    if not _are_spans(gaps.outage_s):
        yield Mistake(("gaps",), "outage_s needs pairs (from, to), the second the later")
    if not (0 <= gaps.every_s < math.inf and 0 < gaps.length_s < math.inf):
        yield Mistake(("gaps",), "needs every_s not below 0 and length_s above 0")
    if not all(math.isfinite(angle) for sector in gaps.blind_deg for angle in sector):
        yield Mistake(("gaps",), "blind_deg needs pairs of angles")
    if not _are_spans(radar.stuck_s):
        yield Mistake(("stuck_s",), "stuck_s needs pairs (from, to), the second the later")
    if radar.platform is not None:
        yield from _vessel_mistakes(radar, radar.platform)


def _vessel_mistakes(radar: Radar, ship: Vessel) -> Iterator[Mistake]:
    try:
        vessel.check_vessel(ship, "platform")
    except SettingsError as error:
        yield Mistake(("platform",), str(error.args[0]).removeprefix("platform: "), error.remedy)
    if max(abs(ship.lat_deg - radar.lat_deg), abs(ship.lon_deg - radar.lon_deg)) > 1e-9:
        text = f"starts at lat_deg = {ship.lat_deg}, lon_deg = {ship.lon_deg}, and the radar elsewhere"
        yield Mistake(("platform",), text, "Give both the same place.")


def _are_spans(spans: Iterable[tuple[float, float]]) -> bool:
    return all(-math.inf < begin < end < math.inf for begin, end in spans)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A radar's plots in the order of their stamps, and what is true of each (n,).

    Where the clock jumps or sticks they are in the order of measuring.  `target` is -1 for false plots and clutter; `seconds` is
    when the antenna pointed at the target, after the epoch; `noise` (n, 3) is what was added at random to range, azimuth and
    elevation, quantisation not included.  `errors` are the true values of each term as functions of the seconds, in the term's
    unit; `outage_s` (m, 2) is from when to when the radar was silent.  `radar` is the radar with all that was drawn of it, for
    `pose` and `geometry_at`, and `own_ship` what its platform reported of itself, empty on land.
    """

    plots: Plots
    target: IntArray
    seconds: FloatArray
    noise: FloatArray
    marks: Marks
    errors: dict[str, History]
    outage_s: FloatArray
    radar: Radar
    own_ship: Platform


def site(radar: Radar) -> tuple[FloatArray, FloatArray]:
    """Position (3,) and enu_from_ecef (3, 3) of the place that the radar is given at."""
    latitude, longitude = math.radians(radar.lat_deg), math.radians(radar.lon_deg)
    return ecef_from_geodetic(latitude, longitude, radar.height_m), enu_from_ecef(latitude, longitude)


def pose(radar: Radar, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the antenna is (n, 3), ECEF metres, and the rotation (n, 3, 3) to the axes it measures in, at times (n,).

    Times are seconds after the epoch.  Of a radar that stands still both are one for all times, (3,) and (3, 3).
    """
    return site(radar) if radar.platform is None else vessel.pose(radar.platform, seconds)


# Rates of a pose come from its values so many seconds apart, by central differences of sixth (third rate: fourth) order.
_POSE_STEP_S = 0.05
_POSE_RATES = np.array(
    [
        [-1 / 60, 3 / 20, -3 / 4, 0.0, 3 / 4, -3 / 20, 1 / 60],
        [1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90],
        [1 / 8, -1.0, 13 / 8, 0.0, -13 / 8, 1.0, -1 / 8],
    ]
)


def _relative(truth: Truth, radar: Radar, target: IntArray, seconds: FloatArray, motion: Motion) -> Motion:
    """Targets (n,) in the antenna's axes: where they are from it, and how that moves, as far as `motion` tells."""
    origin, rotation = pose(radar, seconds)
    away = motion.position - origin
    if rotation.ndim == 2:
        return Motion(*(rotate(rotation, part) for part in (away, *motion[1:])))
    near = [pose(radar, seconds + k * _POSE_STEP_S) for k in range(-3, 4)]
    scale = _POSE_STEP_S ** -np.arange(1.0, 4.0)
    # About the place at the time itself: differences of Earth-centred positions would lose digits.
    moved = np.einsum("dk,knj,d->dnj", _POSE_RATES, np.stack([at - origin for at, _ in near]), scale)
    turned = np.einsum("dk,knij,d->dnij", _POSE_RATES, np.stack([turn for _, turn in near]), scale)
    turn, p = [rotation, *turned], [away, *(own - ours for own, ours in zip(motion[1:], moved, strict=True))]
    choose = ((1,), (1, 1), (1, 2, 1), (1, 3, 3, 1))
    return Motion(*(sum((c * rotate(turn[j], p[k - j]) for j, c in enumerate(choose[k])), np.zeros_like(away)) for k in range(4)))


def geometry_at(truth: Truth, radar: Radar, target: IntArray, seconds: FloatArray) -> Geometry:
    """How targets (n,) truly stand and move as the radar sees them, at times (n,) after the epoch."""
    motion = truth.motion(target, seconds)
    polar, rate, second, third = polar_motion(*_relative(truth, radar, target, seconds, motion))
    _, rotation = pose(radar, seconds)
    return Geometry(
        range_m=polar[:, 0],
        azimuth_rad=polar[:, 1],
        elevation_rad=polar[:, 2],
        rate=rate,
        second=second,
        third=third,
        heading_rad=heading_about(truth.heading_rad(target, seconds, motion), motion.position, rotation),
        length_m=truth.length_m[target],
        time_s=seconds,
    )


def _passings(truth: Truth, radar: Radar, first_north_s: float) -> tuple[IntArray, FloatArray]:
    """When the antenna points at each target that this kind of radar sees: targets and times (n,), seconds after the epoch.

    The target's azimuth less the antenna's falls steadily, so every whole turn of it is one passing: found on a grid of a second
    (or a quarter of a scan), then by Newton's method.
    """
    step = min(STEP_S, radar.scan_s / 4)
    targets: list[IntArray] = []
    times: list[FloatArray] = []
    for k in range(truth.flights, len(truth)) if radar.kind == "marine" else range(truth.flights):
        if truth.last_s[k] - truth.first_s[k] < step:
            continue
        count = int((truth.last_s[k] - truth.first_s[k]) / step) + 1
        when = np.linspace(truth.first_s[k], truth.last_s[k], count)
        position = truth.motion(np.full(count, k), when, derivatives=0).position
        origin, rotation = pose(radar, when)
        azimuth = np.unwrap(polar_from_enu(rotate(rotation, position - origin))[:, 1])
        turns = (when - first_north_s) / radar.scan_s - azimuth / (2 * np.pi)
        # A target over the antenna can outrun the beam for a moment; such turns are not passings.
        turns = np.maximum.accumulate(turns)
        whole = np.arange(math.ceil(turns[0]), math.floor(turns[-1]) + 1)
        times.append(np.interp(whole, turns, when))
        targets.append(np.full(len(whole), k, np.int64))
    target = np.concatenate(targets) if targets else np.empty(0, np.int64)
    seconds = np.concatenate(times) if times else np.empty(0)
    left = np.zeros(len(target))
    for _ in range(6):
        seen = _relative(truth, radar, target, seconds, truth.motion(target, seconds, derivatives=1))
        polar, rate, _, _ = polar_motion(*seen, order=1)
        turns = (seconds - first_north_s) / radar.scan_s - polar[:, 1] / (2 * np.pi)
        left = turns - np.rint(turns)
        speed = 1.0 / radar.scan_s - rate[:, 1] / (2 * np.pi)
        seconds = np.clip(seconds - left / np.maximum(speed, 0.2 / radar.scan_s), truth.first_s[target], truth.last_s[target])
    good = np.abs(left) < 1e-9
    return target[good], seconds[good]


def rounded(values: FloatArray, quantum: float) -> FloatArray:
    """Values (n,) to the nearest multiple of the quantum; 0 leaves them as they are."""
    return np.rint(values / quantum) * quantum if quantum > 0 else values


def _track_numbers(target: IntArray, seconds: FloatArray, longest_gap_s: float, rng: np.random.Generator) -> IntArray:
    """Track numbers (n,) of plots in the order of time: a target's changes after a gap; no two tracks share one (below 4,096)."""
    order = np.lexsort((seconds, target))
    new = np.ones(len(order), np.bool_)
    new[1:] = (np.diff(target[order]) != 0) | (np.diff(seconds[order]) > longest_gap_s)
    numbers = rng.permutation(4095) + 1
    out = np.empty(len(order), np.int64)
    out[order] = numbers[(np.cumsum(new) - 1) % 4095]
    return out


class _Seen(NamedTuple):
    """Echoes in no order: whose they are, when the antenna pointed at them, their stamps, polar values and noise (n, 3)."""

    target: IntArray
    seconds: FloatArray
    stamp: FloatArray
    measured: FloatArray
    noise: FloatArray
    whose: Whose

    def take(self, rows: AnyArray) -> _Seen:
        whose = Whose(*(part[rows] for part in self.whose))
        return _Seen(self.target[rows], self.seconds[rows], self.stamp[rows], self.measured[rows], self.noise[rows], whose)


def observe_radar(truth: Truth, radar: Radar, rng: np.random.Generator) -> Observation:
    """The plots of one radar.

    Source: METHODS section 6.  Terms of time are applied exactly (the stamp is the true time plus what it is late); all others
    by their columns at the true geometry, with their values when the antenna points at the target.
    """
    drawn = rng.uniform(0.0, radar.scan_s)
    north = drawn if radar.first_north_s is None else radar.first_north_s
    streams = Streams(rng)
    if radar.platform is not None:
        radar = msgspec.structs.replace(radar, platform=vessel.settled(radar.platform, streams("swinging")))
    span = float(truth.last_s.max()) if len(truth) else 0.0
    errors = {name: history(error, span, streams(f"error {name}")) for name, error in radar.errors.items()}
    outage = outages(span, radar.gaps, streams("gaps"))
    ship, key = radar.platform, radar.sac << 8 | radar.sic
    own = Platform() if ship is None else vessel.own_ship(ship, key, truth.epoch_s, span, streams("own ship"))
    target, seconds = _passings(truth, radar, north)
    whose = _whose(truth, radar, target, seconds, rng)
    late, stuck = _late(radar, errors, seconds, whose)
    jitter = _shaped(rng.normal(0.0, 1.0, len(target)), radar, "time", target, seconds, streams)
    stamp = truth.epoch_s + seconds + late + np.where(stuck, 0.0, jitter) * radar.time_sd_s
    if radar.time_quantum_s > 0:
        stamp = rounded(stamp, radar.time_quantum_s)
    elif radar.time_sd_s == 0:
        # A POSIX time has a resolution of 0.2 us: take the truth exactly when the stamp says.
        seconds = np.clip((stamp - truth.epoch_s) - late, truth.first_s[target], truth.last_s[target])
    noise = _noise(radar, rng.normal(0.0, 1.0, (len(target), 3)), target, seconds, streams)
    chance = rng.random(len(target))
    geometry = geometry_at(truth, radar, target, seconds)._replace(whose=whose)
    seen = chance < _probability(radar, geometry.range_m)
    low, high = math.radians(radar.min_elevation_deg), math.radians(radar.max_elevation_deg)
    seen &= (geometry.elevation_rad >= low) & (geometry.elevation_rad <= high)
    seen &= (geometry.range_m >= radar.min_range_m) & (geometry.range_m <= radar.max_range_m)
    seen &= ~_silent(outage, seconds) & ~_blind(radar, geometry.azimuth_rad)

    measured = _measured(geometry, errors)
    secondary = whose.channel != Channel.PSR
    measured[secondary, 0] += truth.aircraft.transponder_delay_m[target[secondary]]
    measured += noise
    seen &= measured[:, 0] > 0

    echoes = _Seen(target, seconds, stamp, measured, noise, whose).take(np.flatnonzero(seen))
    # A clock that jumps or sticks does not change in what order a radar tells its plots.
    leaps = bool(radar.stuck_s) or any(term_of(name).is_time and one.drift.step for name, one in errors.items())
    echoes = echoes.take(np.argsort(echoes.seconds if leaps else echoes.stamp, kind="stable"))
    plots = _plots(truth, radar, echoes, rng)
    marks = _north_marks(truth, radar, north, errors, outage)
    nobodys = [_false(truth, radar, north, span, errors, rng)] if radar.false_plots > 0 else []
    for number, area in enumerate(radar.clutter):
        nobodys.append(_clutter(truth, radar, area, north, span, errors, streams, f"clutter {number}"))
    if nobodys:
        false = [one.take(~_silent(outage, one.seconds)) for one in nobodys]
        plots = Plots.concat([plots, *(_nameless(radar, one) for one in false)])
        target, seconds, noise = (
            np.concatenate(parts) for parts in zip(*((e.target, e.seconds, e.noise) for e in (echoes, *false)), strict=True)
        )
        order = np.argsort(seconds if leaps else plots.time_s, kind="stable")
        plots, target, seconds, noise = plots.take(order), target[order], seconds[order], noise[order]
    else:
        target, seconds, noise = echoes.target, echoes.seconds, echoes.noise
    plots = plots.replace(record=np.arange(len(plots)))
    return Observation(plots, target, seconds, noise, marks, errors, outage, radar, own)


def _late(radar: Radar, errors: dict[str, History], seconds: FloatArray, whose: Whose | None) -> tuple[FloatArray, BoolArray]:
    """By how much stamps are late (n,) at times (n,), and where the clock is stuck; terms of a channel only with `whose`."""
    held = seconds.copy()
    for begin, end in radar.stuck_s:
        held[(seconds >= begin) & (seconds < end)] = begin
    terms = [term_of(name) for name in errors if term_of(name).is_time and (whose is not None or "@" not in name)]
    # A rate of the clock adds up: its mean until then, times the time.
    values = [(errors[t.name].mean if t.base == "clock_drift" else errors[t.name])(held) * t.si_per_unit for t in terms]
    return late_s(terms, values, held, whose) + (held - seconds), held != seconds


def _measured(geometry: Geometry, errors: dict[str, History]) -> FloatArray:
    """Range, azimuth and elevation (n, 3) with all errors but those of time and of chance."""
    measured = np.stack([geometry.range_m, geometry.azimuth_rad, geometry.elevation_rad], axis=1)
    for name, error in errors.items():
        term = term_of(name)
        if not term.is_time:
            measured += (error(geometry.time_s) * term.si_per_unit)[:, None] * term.columns(geometry)
    return measured


def _shaped(
    white: FloatArray, radar: Radar, what: str, track: IntArray, seconds: FloatArray, streams: Streams, place: str = ""
) -> FloatArray:
    """Standard normal numbers (n,) made into what `Radar.noise` says of this channel: correlated, with tails, with outliers."""
    noise = radar.noise.get(what, radar.noise.get("all"))
    if noise is None:
        return white
    out, n = white, len(white)
    if noise.t_degrees is not None:
        energy = streams(f"tails {what} {place}").chisquare(noise.t_degrees, n)
        out = out * np.sqrt((noise.t_degrees - 2.0) / energy)
    if noise.correlated > 0:
        slow = gauss_markov(track, seconds, noise.correlation_s, streams(f"correlated {what} {place}"))
        out = math.sqrt(noise.correlated) * slow + math.sqrt(1.0 - noise.correlated) * out
    if noise.outliers > 0:
        out = np.where(streams(f"outliers {what} {place}").random(n) < noise.outliers, noise.outlier_factor * out, out)
    return out


def _noise(
    radar: Radar, white: FloatArray, track: IntArray, seconds: FloatArray, streams: Streams, place: str = ""
) -> FloatArray:
    """The random errors (n, 3) of range, azimuth and elevation, SI, of standard normal numbers (n, 3)."""
    sd = [radar.range_sd_m, math.radians(radar.azimuth_sd_deg), math.radians(radar.elevation_sd_deg or 0.0)]
    parts = [_shaped(white[:, k], radar, what, track, seconds, streams, place) for k, what in enumerate(NOISES[:3])]
    return np.stack(parts, axis=1) * sd


# The probability of detection is computed at so many ranges and is straight between: good to 1e-5.
_RANGES = 2001


def _probability(radar: Radar, range_m: FloatArray) -> FloatArray | float:
    """The probability of detection (n,) at ranges (n,)."""
    if not isinstance(radar.detection, RadarEquation):
        return radar.detection
    grid = np.linspace(radar.min_range_m, radar.max_range_m, _RANGES)
    return np.interp(range_m, grid, radar.detection.probability(grid))


def outages(span_s: float, gaps: Gaps, rng: np.random.Generator) -> FloatArray:
    """The silences (m, 2), from and to, within a scene of `span_s`: those given and those drawn, in the order of their begin."""
    count = int(rng.poisson(span_s / gaps.every_s)) if gaps.every_s > 0 else 0
    begin = rng.uniform(0.0, span_s, count)
    drawn = np.stack([begin, begin + rng.exponential(gaps.length_s, count)], axis=1)
    both = np.concatenate([np.reshape(np.array(gaps.outage_s, np.float64), (-1, 2)), drawn])
    return both[np.argsort(both[:, 0], kind="stable")]


def _silent(outage_s: FloatArray, seconds: FloatArray) -> BoolArray:
    """Which times (n,) lie in an outage."""
    silent = np.zeros(len(seconds), np.bool_)
    for begin, end in outage_s:
        silent |= (seconds >= begin) & (seconds < end)
    return silent


def _blind(radar: Radar, azimuth_rad: FloatArray) -> BoolArray:
    """Which azimuths (n,) lie in a blind sector."""
    blind = np.zeros(len(azimuth_rad), np.bool_)
    for first, last in radar.gaps.blind_deg:
        blind |= (np.degrees(azimuth_rad) - first) % 360.0 <= _width_deg(first, last)
    return blind


def _width_deg(first_deg: float, last_deg: float) -> float:
    """How far it is clockwise from the first to the last angle; a whole turn from one to the same a turn on."""
    return 360.0 if last_deg - first_deg >= 360.0 else (last_deg - first_deg) % 360.0


def _plots(truth: Truth, radar: Radar, echoes: _Seen, rng: np.random.Generator) -> Plots:
    """The table of the measured values, with the identity that each plot's channel gives."""
    target, seconds, stamp, measured, _, whose = echoes
    craft = truth.aircraft
    secondary, addressed = whose.channel != Channel.PSR, np.isin(whose.channel, (Channel.MODE_S, Channel.MODE_S_PSR))
    azimuth = wrap_turn(rounded(measured[:, 1], math.radians(radar.azimuth_quantum_deg)))
    columns: dict[str, AnyArray] = {
        "time_s": stamp,
        "sensor": np.full(len(target), radar.sac << 8 | radar.sic),
        "channel": whose.channel,
        "flags": whose.flags,
        "range_m": rounded(measured[:, 0], radar.range_quantum_m),
        "azimuth_rad": azimuth,
        "track": _track_numbers(target, seconds, 5.5 * radar.scan_s, rng),
    }
    if radar.elevation_sd_deg is not None:
        columns["elevation_rad"] = rounded(measured[:, 2], math.radians(radar.elevation_quantum_deg))
        if radar.height_from_elevation:
            columns["height_m"] = geodetic_from_ecef(position_from_polar(measured, *pose(radar, seconds)))[2]
    if secondary.any():
        position = truth.motion(target, seconds, derivatives=0).position
        altitude = truth.geodetic(position)[2] + craft.altimetry_m[target]
        quantum = craft.altitude_quantum_m[target]
        columns["pressure_altitude_m"] = np.where(secondary, np.rint(altitude / quantum) * quantum, np.nan)
        if radar.identity:
            columns["mode_3a"] = np.where(secondary, craft.mode_3a[target], -1)
            columns["mode_s"] = np.where(addressed, craft.mode_s[target], -1)
            columns["callsign"] = np.where(addressed, craft.callsign[target], -1)
    return Plots(**columns)


def _whose(truth: Truth, radar: Radar, target: IntArray, seconds: FloatArray, rng: np.random.Generator) -> Whose:
    """Channel and flags of the plots: of a combined radar some are the primary's alone, and its second chain takes over late."""
    n = len(target)
    channel = np.full(n, _CHANNELS[radar.kind], np.int8)
    if radar.primary_only > 0:
        channel[rng.random(n) < radar.primary_only] = Channel.PSR
    flags = np.zeros(n, np.uint32)
    if radar.second_chain > 0:
        span = float(truth.last_s.max()) if len(truth) else 0.0
        flags[seconds >= (1.0 - radar.second_chain) * span] = Flag.CHAIN_2
    return Whose(channel, flags, np.full(n, -1, np.int32))


_CHANNELS = {
    "psr": Channel.PSR,
    "marine": Channel.PSR,
    "ssr": Channel.SSR,
    "mode_s": Channel.MODE_S,
    "combined": Channel.MODE_S_PSR,
}


def _nobodys(radar: Radar, n: int) -> Whose:
    """Channel and flags of echoes (n,) that no target gives."""
    channel = Channel.PSR if radar.kind == "combined" else _CHANNELS[radar.kind]
    return Whose(np.full(n, channel, np.int8), np.zeros(n, np.uint32), np.full(n, -1, np.int32))


def _stamped(truth: Truth, radar: Radar, errors: dict[str, History], seconds: FloatArray) -> FloatArray:
    """The stamps (n,) of echoes (n,) that no target gives."""
    late, _ = _late(radar, errors, seconds, _nobodys(radar, len(seconds)))
    return rounded(truth.epoch_s + seconds + late, radar.time_quantum_s)


def _false(truth: Truth, radar: Radar, north: float, span: float, errors: dict[str, History], rng: np.random.Generator) -> _Seen:
    """False plots: uniform over the covered area and over time."""
    count = int(rng.poisson(radar.false_plots * span / radar.scan_s))
    when = np.sort(rng.uniform(0.0, span, count))
    inner, outer = radar.min_range_m**2, radar.max_range_m**2
    elevation = rng.uniform(math.radians(radar.min_elevation_deg), math.radians(10.0), count)
    measured = np.stack([np.sqrt(rng.uniform(inner, outer, count)), 2 * np.pi * (when - north) / radar.scan_s, elevation], axis=1)
    nobody = np.full(count, -1, np.int64)
    stamp = _stamped(truth, radar, errors, when)
    echoes = _Seen(nobody, when, stamp, measured, np.zeros((count, 3)), _nobodys(radar, count))
    return echoes.take(~_blind(radar, measured[:, 1]))


def _clutter(
    truth: Truth,
    radar: Radar,
    area: Clutter,
    north: float,
    span: float,
    errors: dict[str, History],
    streams: Streams,
    name: str,
) -> _Seen:
    """What an area of clutter gives in all scans, measured with the radar's errors and noise."""
    rng, n = streams(name), area.places
    distance = np.sqrt(rng.uniform(area.range_m[0] ** 2, area.range_m[1] ** 2, n))
    bearing = np.radians(area.azimuth_deg[0] + _width_deg(*area.azimuth_deg) * rng.random(n))
    lowest = math.radians(radar.min_elevation_deg)
    height = rng.uniform(lowest, min(lowest + math.radians(1.0), math.radians(radar.max_elevation_deg)), n)
    turns = np.arange(math.floor(-north / radar.scan_s) - 1, math.ceil((span - north) / radar.scan_s) + 1)
    turn, place = np.nonzero(rng.random((len(turns), n)) < area.plots / n)
    scatter = rng.normal(0.0, area.scatter_m, (len(turn), 2))
    range_m = np.maximum(distance[place] + scatter[:, 0], 1.0)
    azimuth = bearing[place] + scatter[:, 1] / range_m
    when = np.asarray(north + radar.scan_s * (turns[turn] + azimuth / (2 * np.pi)), np.float64)
    rows = np.flatnonzero((when >= 0.0) & (when <= span))
    place, when, still = place[rows], when[rows], np.zeros((len(rows), 3))
    unknown = np.full(len(rows), np.nan)
    geometry = Geometry(
        range_m[rows], wrap_turn(azimuth[rows]), height[place], still, still, still, unknown, unknown, when,
        whose=_nobodys(radar, len(rows)),
    )  # fmt: skip
    noise = _noise(radar, rng.normal(0.0, 1.0, (len(rows), 3)), place, when, streams, name)
    measured = _measured(geometry, errors) + noise
    nobody = np.full(len(rows), -1, np.int64)
    echoes = _Seen(nobody, when, _stamped(truth, radar, errors, when), measured, noise, _nobodys(radar, len(rows)))
    return echoes.take((measured[:, 0] > 0) & ~_blind(radar, geometry.azimuth_rad))


def _nameless(radar: Radar, echoes: _Seen) -> Plots:
    """The table of false plots and clutter: without identity, altitude or track."""
    count = len(echoes.target)
    return Plots(
        time_s=echoes.stamp,
        sensor=np.full(count, radar.sac << 8 | radar.sic),
        channel=echoes.whose.channel,
        range_m=rounded(echoes.measured[:, 0], radar.range_quantum_m),
        azimuth_rad=wrap_turn(rounded(echoes.measured[:, 1], math.radians(radar.azimuth_quantum_deg))),
        elevation_rad=rounded(echoes.measured[:, 2], math.radians(radar.elevation_quantum_deg))
        if radar.elevation_sd_deg is not None
        else np.full(count, np.nan),
    )


def _north_marks(truth: Truth, radar: Radar, north: float, errors: dict[str, History], outage_s: FloatArray) -> Marks:
    """One north mark a turn, with the radar's position and its rotation period; a marine radar gives none."""
    span = float(truth.last_s.max()) if len(truth) else 0.0
    turns = 0 if radar.kind == "marine" else max(0, math.floor((span - north) / radar.scan_s) + 1)
    when = np.asarray(north + radar.scan_s * np.arange(turns), np.float64)
    when = when[~_silent(outage_s, when)]
    n = len(when)
    origin, rotation = pose(radar, when)
    still = math.radians(radar.lat_deg), math.radians(radar.lon_deg), radar.height_m
    latitude, longitude, height = (np.full(n, v) for v in still) if rotation.ndim == 2 else geodetic_from_ecef(origin)
    return Marks(
        time_s=truth.epoch_s + when + _late(radar, errors, when, None)[0],
        sensor=np.full(n, radar.sac << 8 | radar.sic),
        azimuth_rad=np.full(n, np.nan),
        rotation_s=np.full(n, radar.scan_s),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
    )
