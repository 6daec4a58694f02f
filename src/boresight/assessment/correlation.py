"""Correlation of two targets' errors: does what one target shows of a radar's errors hold for another one?  (Paper 000.)

Traces are cut into straight and curved segments, errors are matched scan by scan, raw and behind an IMM filter.  Theil's
coefficient and the normalised Euclidean distance are the paper's; because both say "alike" of independent errors too, beside them
stand Lin's concordance of the detrended errors, the variance of the difference, and the cross-target correction.  METHODS
section 3.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from .. import filters
from .._types import BoolArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from ..filters import ConstantVelocity, CoordinatedTurn, Imm, imm_filter, one_point
from ..measure import enu_from_polar, polar_motion, wrap_rad
from ..registration.per_channel import (
    CHANNELS,
    ORDERS,
    ChannelFit,
    Order,
    PerChannel,
    PerChannelFit,
    design,
    distance_correlation,
    normalised_distance,
    rows_of,
)
from ..terms import DEG, Geometry
from .distribution import memory, result_residuals, target_numbers
from .residuals import Residuals

Motion = Literal["straight", "curved", "all"]
# So many scans matched are needed to say anything, and so many of one motion to take it alone.
_LEAST = 10
_ENOUGH = 30
# Scans in which the filter finds its feet.
_SETTLING = 10
# Draws of the bootstrap.
_DRAWS = 400
UNITS = ("m", "rad", "rad")
_DATASETS = ("dataset 1: straight, first target", "dataset 2: straight, second target", "dataset 3: straight, both at once")


# ------------------------------------------------------------------------------------------------------------------- coefficients
def theil(x: FloatArray, y: FloatArray) -> float:
    """Theil's inequality coefficient of two series (n,), 0 (equal) to 1; paper 000, eq. 7.

    The denominator is the sum of two roots: the one root that is printed reaches 1.41.  Two series of zeros are equal: 0.
    """
    if not len(x):
        return 0.0
    size = float(np.sqrt(np.mean(np.square(x))) + np.sqrt(np.mean(np.square(y))))
    # Rounding must not take it above 1.
    return min(float(np.sqrt(np.mean(np.square(np.subtract(x, y)))) / size), 1.0) if size > 0 else 0.0


class Concordance(msgspec.Struct, frozen=True):
    """Lin's concordance (-1 … 1) with its 95 % interval, and how many independent pairs the series are worth."""

    value: float
    low: float
    high: float
    effective: float


def detrended(x: FloatArray, time_s: FloatArray) -> FloatArray:
    """The series (n,) less its straight line over time; what rounding leaves of a constant is exactly zero."""
    x = np.asarray(x, np.float64)
    if len(x) < 3:
        return np.zeros(len(x))
    t = time_s - time_s.mean()
    spread = float(t @ t)
    off = x - x.mean() - (float(t @ x) / spread * t if spread > 0 else 0.0)
    return np.zeros(len(x)) if np.sqrt(np.mean(off**2)) <= 1e-12 * np.abs(x).max(initial=0.0) else off


def effective_number(x: FloatArray, y: FloatArray) -> float:
    """How many independent pairs two zero-mean series (n,) are worth.

    Bartlett's formula: n over 1 + 2 times the sum of the product of both autocorrelations, until this first is not positive.
    """
    n = len(x)
    a, b = float(x @ x), float(y @ y)
    if a == 0 or b == 0:
        return float(n)
    total = 1.0
    for lag in range(1, n // 2):
        product = float(x[lag:] @ x[:-lag]) / a * (float(y[lag:] @ y[:-lag]) / b)
        if product <= 0:
            break
        total += 2 * product
    return n / total


def concordance(x: FloatArray, y: FloatArray, time_s: FloatArray) -> Concordance:
    """Lin's concordance of the detrended series (n,): 1 where they move as one, 0 where they know nothing of each other.

    The interval is by Fisher's z with the effective number of pairs.  Series that do not vary: 1 if neither does, 0 if one does;
    then nothing is known, and the interval is -1 … 1.
    """
    u, v = detrended(x, time_s), detrended(y, time_s)
    a, b = float(np.mean(u**2)) if len(u) else 0.0, float(np.mean(v**2)) if len(v) else 0.0
    if a == 0 or b == 0:
        return Concordance(1.0 if a == b else 0.0, -1.0, 1.0, float(len(u)))
    # Root by root: the product of very small variances would be zero.
    size = np.sqrt(a) * np.sqrt(b)
    scale = 2 * size / (a + b)
    r = float(np.clip(np.mean(u * v) / size, -1.0, 1.0))
    value = float(scale * r)
    effective = effective_number(u, v)
    if 1 - abs(value) < 1e-12:
        return Concordance(value, value, value, effective)
    # Lin 1989, with both means taken off.
    sd = scale * np.sqrt((1 - r**2) / (1 - value**2) / max(effective - 2, 1.0))
    z = np.arctanh(value)
    return Concordance(float(value), float(np.tanh(z - 1.96 * sd)), float(np.tanh(z + 1.96 * sd)), effective)


# ------------------------------------------------------------------------------------------------------------------------- traces
class Segment(msgspec.Struct, frozen=True):
    """A piece of a trace: rows `first` … `last` (inclusive), straight or curved."""

    first: int
    last: int
    curved: bool


def motion_of(time_s: FloatArray, enu: FloatArray, *, window_s: float = 10.0) -> tuple[FloatArray, FloatArray]:
    """Velocity and acceleration (n, 3) at each row of a trace: a parabola through what lies within half the window, or the
    five rows before and after where these are further apart."""
    n = len(time_s)
    velocity, acceleration = np.zeros((n, 3)), np.zeros((n, 3))
    if n < 3:
        return velocity, acceleration
    step = float(np.median(np.diff(time_s)))
    half = int(np.clip(np.ceil(window_s / 2 / max(step, 1e-3)), min(5, (n - 1) // 2), 200))
    rows = np.arange(n)
    around = np.clip(rows[:, None] + np.arange(-half, half + 1), 0, n - 1)
    off = time_s[around] - time_s[:, None]
    reach = max(window_s / 2, 1.5 * half * step)
    # Rows beyond the ends are repeated, and count once.
    weight = (np.abs(off) <= reach) & (around == rows[:, None] + np.arange(-half, half + 1))
    t = off / reach
    basis = np.stack([np.ones_like(t), t, t**2], axis=-1)
    weighted = basis * weight[:, :, None]
    normal = np.einsum("nwi,nwj->nij", weighted, basis) + 1e-9 * np.eye(3)
    right = np.einsum("nwi,nwk->nik", weighted, enu[around] - enu[:, None])
    slope = np.linalg.solve(normal, right)
    return slope[:, 1] / reach, 2 * slope[:, 2] / reach**2


def find_segments(
    time_s: FloatArray, velocity: FloatArray, acceleration: FloatArray, *, turn_deg_s: float = 0.5, least_s: float = 10.0
) -> tuple[Segment, ...]:
    """Straight and curved pieces of a trace, in order, by its turn rate; pieces shorter than `least_s` join their neighbours."""
    n = len(time_s)
    if not n:
        return ()
    speed2 = velocity[:, 0] ** 2 + velocity[:, 1] ** 2
    cross = velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]
    curved = np.abs(cross) > turn_deg_s * DEG * np.maximum(speed2, 0.25)
    edges = np.r_[0, np.flatnonzero(np.diff(curved)) + 1, n]
    runs = [[int(a), int(b) - 1, bool(curved[a])] for a, b in itertools.pairwise(edges)]
    while len(runs) > 1:
        long = [time_s[last] - time_s[first] for first, last, _ in runs]
        k = int(np.argmin(long))
        if long[k] >= least_s:
            break
        first, last = max(k - 1, 0), min(k + 1, len(runs) - 1)
        kind = runs[first][2] if k else runs[last][2]
        runs[first : last + 1] = [[runs[first][0], runs[last][1], kind]]
    return tuple(Segment(first, last, bool(kind)) for first, last, kind in runs)


def is_curved(segments: Sequence[Segment], n: int) -> BoolArray:
    """Which rows (n,) are in curved segments."""
    out = np.zeros(n, bool)
    for s in segments:
        out[s.first : s.last + 1] = s.curved
    return out


class Alignment(NamedTuple):
    """How a reference is brought to the plots' times, and what each way is off by at most (m): `text` says why."""

    method: Literal["nearest", "linear"]
    nearest_m: float
    linear_m: float
    text: str


def choose_alignment(
    time_s: FloatArray, velocity: FloatArray, acceleration: FloatArray, *, sparse_s: float = 2.0, smooth_m: float = 1.0
) -> Alignment:
    """The paper's rule (its section III.C): the nearest fix where the trace is sparse and smooth, else linear interpolation.

    Sparse is a fix in `sparse_s` seconds or less often; smooth means that the nearest one is off by less than `smooth_m`.
    """
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf
    speed = float(np.percentile(np.sqrt((velocity**2).sum(axis=1)), 95)) if len(velocity) else 0.0
    bend = float(np.percentile(np.sqrt((acceleration**2).sum(axis=1)), 95)) if len(acceleration) else 0.0
    nearest, linear = speed * step / 2, bend * step**2 / 8
    method: Literal["nearest", "linear"] = "nearest" if step >= sparse_s and nearest < smooth_m else "linear"
    text = (
        f"{method}: with a fix every {step:.3g} s the nearest one is off by up to {nearest:.2g} m, "
        f"linear interpolation by {linear:.2g} m"
    )
    return Alignment(method, nearest, linear, text)


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One target as a radar saw it: reference geometry with rates, and errors (n, 3), measured - true (NaN: not measured)."""

    name: str
    place: Geometry
    enu: FloatArray
    error: FloatArray
    segments: tuple[Segment, ...]
    filtered: FloatArray

    def __len__(self) -> int:
        return len(self.error)

    @property
    def time_s(self) -> FloatArray:
        """The stamps (n,)."""
        return self.place.time_s


def make_trace(
    name: str, time_s: FloatArray, enu: FloatArray, error: FloatArray, *, turn_deg_s: float = 0.5, window_s: float = 10.0
) -> Trace:
    """A trace of reference positions (n, 3), local axes about the antenna, and errors (n, 3), at increasing times (n,)."""
    velocity, acceleration = motion_of(time_s, enu, window_s=window_s)
    polar, rate, second, third = polar_motion(enu, velocity, acceleration, order=2)
    nothing = np.full(len(time_s), np.nan)
    place = Geometry(polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, nothing, nothing, time_s)
    segments = find_segments(time_s, velocity, acceleration, turn_deg_s=turn_deg_s)
    return Trace(name, place, enu, error, segments, prefilter(time_s, polar, error, velocity, acceleration))


def trace_of(found: Residuals, target: int, name: str, *, turn_deg_s: float = 0.5) -> Trace:
    """The trace of one target from a result's residuals (of one sensor).  Raises NothingToDo where it is too short."""
    rows = np.flatnonzero((found.target == target) & np.isfinite(found.time_s) & np.isfinite(found.range_before_m))
    rows = rows[np.argsort(found.time_s[rows], kind="stable")]
    if len(rows):
        rows = rows[np.r_[True, np.diff(found.time_s[rows]) > 1e-6]]
    if len(rows) < _LEAST:
        raise NothingToDo(
            f"target {name} has {len(rows)} plots: too few to correlate", remedy=f"At least {_LEAST} are needed of each target."
        )
    polar = np.stack(
        [found.reference_range_m[rows], found.reference_azimuth_rad[rows], found.reference_elevation_rad[rows]], axis=1
    )
    error = np.stack([found.range_before_m[rows], found.azimuth_before_rad[rows], found.elevation_before_rad[rows]], axis=1)
    return make_trace(name, found.time_s[rows], enu_from_polar(polar), error, turn_deg_s=turn_deg_s)


def traces_of_result(folder: str | Path, targets: tuple[str, str], sensor: str | None = None) -> tuple[Trace, Trace]:
    """The traces of two targets, by name or number, from the folder that `calibrate` has written.

    Raises InputError for a folder without residuals, SettingsError for a target or a sensor that is not in it or where several
    sensors saw both, NothingToDo for traces that are too short.
    """
    found, named, called = result_residuals(folder)
    wanted = target_numbers(found, named, targets)
    seen = [set(found.sensor[found.target == number].tolist()) for number in wanted]
    both = sorted(seen[0] & seen[1])
    if sensor is not None:
        if sensor not in called:
            raise SettingsError(f"there is no sensor {sensor!r}", where="--sensor", remedy=f"Sensors: {', '.join(called)}.")
        both = [key for key in both if key == called[sensor]]
    if not both:
        raise NothingToDo(f"no radar saw both {targets[0]} and {targets[1]}", remedy="Take two targets that one radar saw.")
    if len(both) > 1:
        which = ", ".join(name for name, key in called.items() if key in both)
        raise SettingsError(f"several radars saw both targets: {which}", where="--sensor", remedy="Name one of them.")
    mine = found[found.sensor == both[0]]
    return trace_of(mine, wanted[0], targets[0]), trace_of(mine, wanted[1], targets[1])


# ------------------------------------------------------------------------------------------------------------------------- filter
def prefilter(
    time_s: FloatArray, polar: FloatArray, error: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Errors (n, 3) of range and azimuth behind an IMM filter (steady, and turns of 3 degrees a second); elevation as it is.

    The filter takes random error away, and adds no information: a fit of filtered errors is no better than one of the raw ones.
    `polar` (n, 3) is the reference, `error` measured - reference; the noise of the measurements is taken from
    the errors' own changes, that of the motion from the reference's velocity and acceleration (n, 3).
    """
    out = error.copy()
    known = np.flatnonzero(np.isfinite(error[:, :2]).all(axis=1) & np.r_[True, np.diff(time_s) > 0])
    if len(known) < 3:
        return out
    measured = (polar + np.nan_to_num(error))[known]
    filtered = filter_positions(time_s[known], measured[None], error[known, :2], velocity, acceleration)
    level = np.hypot(filtered[0, :, 0], filtered[0, :, 1])
    # Seen at the reference's elevation, as the measured range was.
    out[known, 0] = level / np.cos(polar[known, 2]) - polar[known, 0]
    out[known, 1] = wrap_rad(np.arctan2(filtered[0, :, 0], filtered[0, :, 1]) - polar[known, 1])
    return out


def filter_positions(
    time_s: FloatArray, measured: FloatArray, error: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """East and north (m, K, 2) of m targets behind the IMM filter, from measured range, azimuth, elevation (m, K, 3).

    `error` (…, K, 2) gives the noise of range and azimuth, from its changes from scan to scan.
    """
    change = np.diff(error, axis=-2)
    sd = np.sqrt(np.mean(change**2, axis=tuple(range(change.ndim - 1))) / 2)
    sd = np.maximum(sd, [0.1, 1e-5])
    ground, azimuth = measured[..., 0] * np.cos(measured[..., 2]), measured[..., 1]
    sin, cos = np.sin(azimuth), np.cos(azimuth)
    z = np.stack([ground * sin, ground * cos], axis=-1)
    along, across = sd[0] ** 2, (ground * sd[1]) ** 2
    r = np.empty((*z.shape, 2))
    r[..., 0, 0] = along * sin**2 + across * cos**2
    r[..., 1, 1] = along * cos**2 + across * sin**2
    r[..., 0, 1] = r[..., 1, 0] = (along - across) * sin * cos
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    usual = float(np.median(speed))
    # Turns are the models' own; what speeds up and slows down is noise to them, forgotten over some five seconds.
    along_track = (velocity * acceleration).sum(axis=1) / np.maximum(speed, 0.5)
    noise = 1e-3 + 1e-5 * usual**2 + 10.0 * float(np.mean(along_track**2))
    models: tuple[filters.Motion, ...] = (
        ConstantVelocity(noise=noise),
        *(CoordinatedTurn(rate_deg_s=w, noise=noise) for w in (-3.0, 3.0)),
    )
    start = one_point(z[:, 0], r[:, 0], 4, max(2 * usual, 3.0))
    mixed = imm_filter(z, r, time_s, Imm(models=models, stay=0.98), start, covariances=False)
    return np.asarray(mixed.mean[..., :2])


# -------------------------------------------------------------------------------------------------------------------- correlation
class Spread(msgspec.Struct, frozen=True):
    """Mean, population variance and peak-to-peak of a series, SI."""

    mean: float
    variance: float
    peak_to_peak: float


class Agreement(msgspec.Struct, frozen=True, kw_only=True):
    """How alike the two targets' errors are as one order of model fits them, and what one target's model does to the other.

    `rmse` are those of the residuals of the two fits; the reductions are of the root mean square error of one target by the
    model of the other (1: all of it, negative: worse), with their 95 % intervals.
    """

    order: Order
    theil: float
    distance: float
    r: float
    rmse: tuple[float, float]
    first_by_second: float
    second_by_first: float
    first_by_second_interval: tuple[float, float]
    second_by_first_interval: tuple[float, float]
    dropped: tuple[str, ...] = ()


class Shared(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of error series (raw, filtered) of both targets and their difference.

    `ratio` is the variance of the difference over the sum of the variances with its 95 % interval: 1 where the random errors are
    independent, below where they are shared.
    """

    first: Spread
    second: Spread
    difference: Spread
    ratio: float
    ratio_low: float
    ratio_high: float
    theil: float
    concordance: Concordance


class ChannelCorrelation(msgspec.Struct, frozen=True, kw_only=True):
    """What one channel shows; `alike` is the order that the paper's rule takes (conclusion iv)."""

    channel: str
    unit: str
    raw: Shared
    filtered: Shared
    models: tuple[Agreement, ...]
    alike: Order


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of a correlation; `datasets` are the rows of the paper's datasets 1, 2, 3 (and of the curved ones)."""

    targets: tuple[str, str]
    matched: int
    motion: Motion
    datasets: dict[str, int]
    matching: str
    channels: tuple[ChannelCorrelation, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """The numbers, both traces, and the rows of each that were matched."""

    found: Found
    first: Trace
    second: Trace
    rows: tuple[IntArray, IntArray]


def match(first_s: FloatArray, second_s: FloatArray, within_s: float | None = None) -> tuple[IntArray, IntArray]:
    """Rows of two targets in the same scan: each other's nearest in time, no more than half a scan apart."""
    empty = np.zeros(0, np.int64)
    if not len(first_s) or not len(second_s):
        return empty, empty
    if within_s is None:
        steps = np.r_[np.diff(first_s), np.diff(second_s)]
        within_s = 0.55 * float(np.median(steps)) if len(steps) else 1.0

    def nearest(a: FloatArray, b: FloatArray) -> IntArray:
        after = np.clip(np.searchsorted(b, a), 0, len(b) - 1)
        before = np.maximum(after - 1, 0)
        return np.asarray(np.where(np.abs(b[before] - a) <= np.abs(b[after] - a), before, after))

    there, back = nearest(first_s, second_s), nearest(second_s, first_s)
    rows = np.flatnonzero((back[there] == np.arange(len(first_s))) & (np.abs(second_s[there] - first_s) <= within_s))
    return rows, there[rows]


def correlate(first: Trace, second: Trace, *, motion: Motion = "straight", seed: int = 1) -> Correlation:
    """Correlate the errors of two targets over the scans in which both move so; `seed` is that of the bootstrap's draws.

    Of too few scans of one `motion` all are taken, and said.  Raises NothingToDo where the targets were not seen at the same
    time, SettingsError for a motion that does not exist.
    """
    if motion not in ("straight", "curved", "all"):
        raise SettingsError(f"there is no motion {motion!r}", where="--motion", remedy="Motions: straight, curved, all.")
    one, two = match(first.time_s, second.time_s)
    if len(one) < _LEAST:
        raise NothingToDo(
            f"{first.name} and {second.name} were seen in the same scan {len(one)} times: too few",
            remedy="Take two targets that the radar saw at the same time.",
        )
    remarks: list[str] = []
    settled = (one >= _SETTLING) & (two >= _SETTLING)
    if settled.sum() >= _LEAST:
        one, two = one[settled], two[settled]
    curved = [is_curved(t.segments, len(t)) for t in (first, second)]
    straight_one, straight_two = ~curved[0], ~curved[1]
    datasets = {
        _DATASETS[0]: int(straight_one.sum()),
        _DATASETS[1]: int(straight_two.sum()),
        _DATASETS[2]: int((straight_one[one] & straight_two[two]).sum()),
        "curved, first target": int(curved[0].sum()),
        "curved, second target": int(curved[1].sum()),
        "curved, both at once": int((curved[0][one] & curved[1][two]).sum()),
    }
    if motion != "all":
        wanted = straight_one[one] & straight_two[two] if motion == "straight" else curved[0][one] & curved[1][two]
        if wanted.sum() >= _ENOUGH:
            one, two = one[wanted], two[wanted]
        else:
            remarks.append(f"only {int(wanted.sum())} scans show both targets in {motion} motion: all {len(one)} are taken")
            motion = "all"
    measured = np.isfinite(first.error[one, :2]).all(axis=1) & np.isfinite(second.error[two, :2]).all(axis=1)
    one, two = one[measured], two[measured]
    if len(one) < _LEAST:
        raise NothingToDo(f"{first.name} and {second.name} have {len(one)} measured scans in common: too few")
    channels = [c for c in range(3) if np.isfinite(first.error[one, c]).all() and np.isfinite(second.error[two, c]).all()]
    models = {order: (_fit(first, one, order), _fit(second, two, order)) for order in ORDERS}
    found = tuple(_channel(c, first, second, one, two, models, seed) for c in channels)
    step = float(np.median(np.abs(first.time_s[one] - second.time_s[two])))
    remarks.append("the filter takes random error away and adds no information: models are fitted to the raw errors")
    for c in found:
        if c.filtered.first.variance > c.raw.first.variance or c.filtered.second.variance > c.raw.second.variance:
            remarks.append(f"{c.channel}: the filter does not help here: a target moves more sharply than it follows")
        constant = c.models[0]
        if constant.theil < 0.3 and c.raw.concordance.low <= 0 <= c.raw.concordance.high:
            remarks.append(
                f"{c.channel}: the Theil coefficient of {constant.theil:.2f} only says that both means are alike; scan by scan "
                "nothing shows that the errors are shared (the concordance's interval holds 0)"
            )
    remarks.append("constant models are 2 √N apart whatever the data: their r tells how many scans there were, and nothing else")
    return Correlation(
        Found(
            targets=(first.name, second.name),
            matched=len(one),
            motion=motion,
            datasets=datasets,
            matching=f"errors matched scan by scan, nearest in time ({step:.2f} s apart in the median), none interpolated",
            channels=found,
            remarks=tuple(remarks),
        ),
        first,
        second,
        (one, two),
    )


def _fit(trace: Trace, rows: IntArray, order: Order) -> PerChannelFit:
    return PerChannel(model=order).fit(rows_of(trace.place, rows), -trace.error[rows])


def _channel(
    c: int,
    first: Trace,
    second: Trace,
    one: IntArray,
    two: IntArray,
    models: dict[Order, tuple[PerChannelFit, PerChannelFit]],
    seed: int,
) -> ChannelCorrelation:
    time_s = first.time_s[one]
    x, y = first.error[one, c], second.error[two, c]
    places = rows_of(first.place, one), rows_of(second.place, two)
    agreements = []
    for fits in models.values():
        a, b = fits[0].channels[c], fits[1].channels[c]
        assert a is not None
        assert b is not None
        agreements.append(agreement(a, b, places, (x, y), seed=seed))
    # The highest r; of equal ones the simplest.
    alike = max(agreements, key=lambda m: round(m.r, 12)).order
    return ChannelCorrelation(
        channel=CHANNELS[c],
        unit=UNITS[c],
        raw=shared(x, y, time_s),
        filtered=shared(first.filtered[one, c], second.filtered[two, c], time_s),
        models=tuple(agreements),
        alike=alike,
    )


def agreement(
    first: ChannelFit,
    second: ChannelFit,
    places: tuple[Geometry, Geometry],
    errors: tuple[FloatArray, FloatArray],
    *,
    seed: int = 1,
) -> Agreement:
    """How alike two targets' fits are at their `places`, and what each does to the other's `errors` (n,), measured - true.

    Both are of the same scans, in order of time.
    """
    x, y = errors
    u, v = -first.correction(places[0]), -second.correction(places[1])
    distance = normalised_distance(u, v)
    return Agreement(
        order=first.order,
        theil=theil(u, v),
        distance=distance,
        r=distance_correlation(distance),
        rmse=(first.rmse, second.rmse),
        first_by_second=_reduction(x, x + second.correction(places[0])),
        second_by_first=_reduction(y, y + first.correction(places[1])),
        first_by_second_interval=reduction_interval(second, places[::-1], (y, x), seed=seed),
        second_by_first_interval=reduction_interval(first, places, (x, y), seed=seed),
        dropped=tuple(name for name, _ in first.dropped),
    )


def _reduction(before: FloatArray, after: FloatArray) -> float:
    """By which share the root mean square falls; 0 where there was nothing."""
    was, now = float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2)))
    return 1 - now / was if was > 0 else 0.0


def reduction_interval(
    model: ChannelFit, places: tuple[Geometry, Geometry], errors: tuple[FloatArray, FloatArray], *, seed: int = 1
) -> tuple[float, float]:
    """The 95 % interval of the share by which a target's root mean square falls when the model of another one corrects it.

    `model` was fitted to the first of the `errors` (n,), measured - true, at the first of the `places`, and corrects the second.
    Whole blocks of scans are drawn, three times as long as the errors remember, the same for both targets: what they share stays
    shared.  The model's columns are fitted anew to each draw.  Errors that are all zero give 0 … 0.
    """
    from scipy import stats

    x, y = errors
    n = len(x)
    value = _reduction(y, y + model.correction(places[1]))
    if not np.any(y) or value >= 1:
        return value, value
    time_s, alone = places[0].time_s, np.zeros(n, np.int64)
    memory_scans = n / min(memory(e, alone, time_s).effective for e in errors)
    # At least six blocks, however long the errors remember.
    block = int(np.clip(np.ceil(3 * memory_scans), 1, max(n // 6, 1)))
    blocks = -(-n // block)
    starts = np.random.default_rng(seed).integers(0, n, (_DRAWS, blocks))
    rows = (starts[:, :, None] + np.arange(block)).reshape(_DRAWS, -1)[:, :n] % n
    weight = np.zeros((_DRAWS, n))
    np.add.at(weight, (np.arange(_DRAWS)[:, None], rows), 1.0)
    # Columns that are orthonormal where they are fitted, so that every draw's normal equations are well posed.
    fitted, applied = (_columns(model, place) for place in places)
    q, triangle = np.linalg.qr(fitted)
    applied = np.linalg.solve(triangle.T, applied.T).T
    p = q.shape[1]
    normal = (weight @ (q[:, :, None] * q[:, None, :]).reshape(n, -1)).reshape(-1, p, p) + 1e-9 * np.eye(p)
    share = np.linalg.solve(normal, (weight @ (q * -x[:, None]))[:, :, None])[:, :, 0]
    after = (weight * (y + share @ applied.T) ** 2).sum(axis=1)
    before = weight @ y**2
    good = (before > 0) & (after > 0)
    if good.sum() < _DRAWS // 2:
        return value, value
    log_ratio = 0.5 * np.log(after[good] / before[good])
    half = float(stats.t.ppf(0.975, max(blocks - 1, 1)) * log_ratio.std(ddof=1))
    return 1 - (1 - value) * float(np.exp(half)), 1 - (1 - value) * float(np.exp(-half))


def _columns(model: ChannelFit, place: Geometry) -> FloatArray:
    """The columns (n, p) that a model kept, at these places."""
    offered, x = design(place, model.channel, model.order, jerk=model.jerk, parallax=model.parallax)
    at = {column.name: k for k, column in enumerate(offered)}
    return np.asarray(x[:, [at[column.name] for column in model.columns]])


def spread(x: FloatArray) -> Spread:
    """Mean, population variance and peak-to-peak of a series (n,)."""
    return Spread(float(x.mean()), float(x.var()), float(np.ptp(x)))


def shared(x: FloatArray, y: FloatArray, time_s: FloatArray) -> Shared:
    """What two series of errors (n,), matched scan by scan, have in common.  The ratio of constants is 1: nothing is shared."""
    u, v = x - x.mean(), y - y.mean()
    a, b = float(np.mean(u**2)), float(np.mean(v**2))
    ratio = float(np.mean((u - v) ** 2)) / (a + b) if a + b > 0 else 1.0
    # The variance of a covariance of independent series of these variances, over the effective number.
    sd = 2 * np.sqrt(a * b) / (a + b) / np.sqrt(max(effective_number(u, v), 1.0)) if a + b > 0 else 0.0
    return Shared(
        first=spread(x),
        second=spread(y),
        difference=spread(x - y),
        ratio=ratio,
        ratio_low=float(max(ratio - 1.96 * sd, 0.0)),
        ratio_high=float(ratio + 1.96 * sd),
        theil=theil(x, y),
        concordance=concordance(x, y, time_s),
    )


# --------------------------------------------------------------------------------------------------------------------- text, JSON
def correlation_json(found: Found) -> dict[str, object]:
    """The numbers for programs: metres and degrees."""
    out: dict[str, object] = msgspec.to_builtins(found)
    channels = []
    for c in found.channels:
        scale = DEG if c.unit == "rad" else 1.0
        one = msgspec.to_builtins(c)
        one["unit"] = "deg" if c.unit == "rad" else c.unit
        for kind in ("raw", "filtered"):
            for which in ("first", "second", "difference"):
                one[kind][which]["mean"] /= scale
                one[kind][which]["peak_to_peak"] /= scale
                one[kind][which]["variance"] /= scale**2
        for model in one["models"]:
            model["rmse"] = [value / scale for value in model["rmse"]]
        channels.append(one)
    return out | {"channels": channels}


def correlation_text(found: Found) -> str:
    """The numbers as tables for a terminal: metres and degrees."""
    lines = [f"{found.targets[0]} and {found.targets[1]}: {found.matched:,} scans, {found.motion} motion"]
    lines += [f"  {name}: {count:,}" for name, count in found.datasets.items()]
    lines.append(f"  {found.matching}")
    for c in found.channels:
        scale, unit, digits = (DEG, "deg", 4) if c.unit == "rad" else (1.0, c.unit, 2)
        lines += ["", f"{c.channel} ({unit})"]
        rows: list[tuple[str, ...]] = [("errors", "mean", "sd", "peak to peak")]
        for kind, what in (("raw", c.raw), ("filtered", c.filtered)):
            for name, one in ((found.targets[0], what.first), (found.targets[1], what.second), ("difference", what.difference)):
                values = (one.mean / scale, np.sqrt(one.variance) / scale, one.peak_to_peak / scale)
                rows.append((f"{name}, {kind}", *(f"{value:.{digits}f}" for value in values)))
        lines += _table(rows)
        for kind, what in (("raw", c.raw), ("filtered", c.filtered)):
            k = what.concordance
            lines.append(
                f"  {kind}: variance of the difference {what.ratio:.3f} of the sum of variances "
                f"({what.ratio_low:.3f} … {what.ratio_high:.3f}; 1: independent); concordance {k.value:+.3f} "
                f"({k.low:+.3f} … {k.high:+.3f}), worth {k.effective:.0f} pairs"
            )
        rows = [("model", "Theil", "distance", "r", "rmse", "first by second", "second by first")]
        for m in c.models:
            errors = f"{m.rmse[0] / scale:.{digits}f} / {m.rmse[1] / scale:.{digits}f}"
            cross = (
                f"{100 * value:+.1f} % ({100 * low:+.1f} … {100 * high:+.1f})"
                for value, (low, high) in (
                    (m.first_by_second, m.first_by_second_interval), (m.second_by_first, m.second_by_first_interval),
                )
            )  # fmt: skip
            rows.append((m.order, f"{m.theil:.3f}", f"{m.distance:.3f}", f"{m.r:.3f}", errors, *cross))
        lines += _table(rows)
        lines.append(f"  most alike (the paper's rule): {c.alike}")
        for m in c.models:
            if m.dropped:
                lines.append(f"  left out of {m.order}: {', '.join(m.dropped)}")
    lines += ["", *(f"note: {remark}" for remark in found.remarks)]
    return "\n".join(lines)


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    wide = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(f"{cell:<{w}}" if k == 0 else f"{cell:>{w}}" for k, (cell, w) in enumerate(zip(row, wide, strict=True)))
        for row in rows
    ]
