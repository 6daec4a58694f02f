"""Biases of one radar against another, without a reference: exact polar differences, and where they gather (paper 002).

Two radars at one place see only the difference of their biases, b' = b_radar - b_main (METHODS section 5).  One sample of it is
the radar's plot minus the main radar's plot of the same target, the latter re-expressed in the radar's own polar frame.  A bias
that changes with time is the mode of the samples so far, the newer ones counting more: the mean shift finds it (eqs. 12 to 18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import msgspec
import numpy as np

from .. import frames
from .._jit import kernel
from .._parallel import in_threads, slices
from .._types import BoolArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from ..measure import from_true_north, plot_positions, polar_from_position, site_of
from ..model import Plots, Sensor, Sensors
from ..terms import DEG

# Beyond so many time constants a sample counts for less than three thousandths.
_MEMORY = 6.0
# The newest samples from which a search starts, beside the last mode and the average.
_NEWEST = 3
_STEPS = 60
# What is assumed of the height of a target whose radar measures no elevation, and of its accelerations (one sigma).
_HEIGHT_SD_M = 50.0
_ACCELERATION_SD = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Differences measured - true (or radar - main) of one radar in range, azimuth and elevation, in order of time.

    `time_s` (n,), `value` (n, 3) in m, rad, rad (NaN where not measured) and `covariance` (n, 3, 3); `polar` (n, 3) is what the
    radar measured.  `target` (n,) names the target and `main` (n,) the main radar's plot (-1: unknown): samples that share one
    are not independent; `main_variance` (n, 3) is its part of the variance.
    `turn` (n, 3, 3) is d(radar's polar) / d(main's polar), NaN for a trusted reference.
    """

    time_s: FloatArray
    value: FloatArray
    covariance: FloatArray
    polar: FloatArray
    target: IntArray
    main: IntArray
    main_variance: FloatArray
    turn: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def take(self, rows: IntArray | BoolArray) -> Samples:
        """Some of the samples."""
        return Samples(
            self.time_s[rows], self.value[rows], self.covariance[rows], self.polar[rows], self.target[rows], self.main[rows],
            self.main_variance[rows], self.turn[rows],
        )  # fmt: skip


class Estimate(NamedTuple):
    """Biases of m series at k times: `value`, `variance` (m, k); `missed` (m,), at how many no search settled."""

    value: FloatArray
    variance: FloatArray
    missed: IntArray


class Online(Protocol):
    """A way to follow a bias: the estimate at each time rests on the samples up to then."""

    def __call__(self, time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray) -> Estimate:
        """Biases at `epoch_s` (k,) of series `value` (m, n) with `variance` (m, n) at `time_s` (n,), in order of time."""
        ...


def polar_difference(
    value: FloatArray,
    covariance: FloatArray,
    frame: frames.Polar,
    main_value: FloatArray,
    main_covariance: FloatArray,
    main_frame: frames.Polar,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The radar's polar values minus the main radar's of the same targets at the same times, in the radar's frame.

    Values (n, 3) in m, rad, rad and covariances (n, 3, 3).  The main plot is re-expressed exactly; the first-order form
    C^-1 Psi of paper 002 (eq. 9) is 17 m off for a bias of one degree.  Gives differences (n, 3), their covariances, and
    the Jacobian (n, 3, 3) of the re-expression.
    """
    position, outward = main_frame.to_ecef(main_value)
    seen, inward = frame.from_ecef(position)
    turn = inward @ outward
    return frame.difference(value, seen), covariance + frames.propagate(turn, main_covariance), turn


def relative_samples(
    plots: Plots,
    sensors: Sensors,
    main: Sensor,
    *,
    target: IntArray | None = None,
    gap_s: float = 15.0,
    window: tuple[float, float, float] = (5e3, 10 * DEG, 10 * DEG),
) -> dict[int, Samples]:
    """Differences of every radar in `plots` from the `main` one, by the radar's id.

    Plots of one `target` (n,; by default the Mode S address, else the MMSI; negative: unknown) are paired: the main radar's
    are interpolated between two that are at most `gap_s` apart.  Differences beyond `window` (m, rad, rad) are other targets'.
    Where a radar measures no elevation, the target's height comes from `plot_positions`.

    Raises SettingsError for settings that make no sense and a radar without position; NothingToDo where the radars have no
    target in common, or all differences lie outside the window.
    """
    if not gap_s > 0 or not all(w > 0 for w in window):
        raise SettingsError("gap_s and window must be positive", where="relative_samples")
    if target is None:
        target = np.where(plots.mode_s >= 0, plots.mode_s.astype(np.int64), np.where(plots.mmsi >= 0, plots.mmsi, -1))
    others = [key for key in np.unique(plots.sensor).tolist() if key != main.key]
    if not (plots.sensor == main.key).any() or not others:
        raise NothingToDo(
            f"plots of the main radar {main.name!r} and of another one are needed; there are plots of {1 + len(others)} radars"
            if others
            else f"there are plots of one radar only, {main.name!r}: nothing to compare it with",
            remedy="Name a main radar that the recording holds, and give recordings of at least two.",
        )
    position, spread, polar = _placed(plots, sensors)
    usable = np.isfinite(position).all(axis=1) & np.isfinite(plots.time_s) & (target >= 0)
    frame = {s.key: frames.Polar(*site_of(s)) for s in sensors if s.lat_deg is not None and s.lon_deg is not None}
    found: dict[int, Samples] = {}
    said = []
    for key in others:
        sensor = sensors.find(key)
        name = sensor.name if sensor else str(key)
        rows, first, second, share = _brackets(plots, usable, target, main.key, key, gap_s)
        if not len(rows):
            said.append(f"{name!r} and {main.name!r} have no target in common within {gap_s:g} s")
            continue
        between, step = share[:, None], np.abs(plots.time_s[second] - plots.time_s[first])
        there = (1 - between) * position[first] + between * position[second]
        # A main plot serves two of the radar's: to weigh variances by the shares, not by their squares, gives averages over
        # many samples the variance that they have.
        r = (1 - between[:, None]) * spread[first] + between[:, None] * spread[second]
        r = r + (0.5 * _ACCELERATION_SD * share * (1 - share) * step**2)[:, None, None] ** 2 * np.eye(3)
        seen, inward = frame[key].from_ecef(there)
        value = frame[key].difference(polar[rows], seen)
        value[~np.isfinite(plots.elevation_rad[rows]), 2] = np.nan
        own = _polar_covariance(plots, rows, sensors, polar[rows])
        outward = frame[main.key].to_ecef(polar_from_position(there, frame[main.key].site, frame[main.key].rotation))[1]
        within = (np.abs(np.nan_to_num(value)) <= window).all(axis=1)
        if not within.any():
            median = np.nanmedian(np.abs(np.where(np.isfinite(value), value, 0.0)), axis=0)
            said.append(
                f"all {len(rows):,} differences of {name!r} from {main.name!r} lie outside the window: the median is "
                f"{median[0]:,.0f} m, {median[1] / DEG:.2f} and {median[2] / DEG:.2f} deg"
            )
            continue
        near = np.where(share < 0.5, first, second)
        theirs = frames.propagate(inward, r)
        samples = Samples(
            plots.time_s[rows],
            value,
            own + theirs,
            polar[rows],
            target[rows],
            near,
            np.diagonal(theirs, axis1=1, axis2=2),
            inward @ outward,
        )
        rows_in = np.flatnonzero(within)
        found[key] = samples.take(rows_in[np.argsort(samples.time_s[rows_in], kind="stable")])
    if not found:
        raise NothingToDo("; ".join(said), remedy="Do the recordings share time and area? Else widen gap_s or window.")
    return found


def _placed(plots: Plots, sensors: Sensors) -> tuple[FloatArray, FloatArray, FloatArray]:
    """ECEF positions (n, 3) and covariances (n, 3, 3) of the plots, and their polar values (n, 3) from true north."""
    position = plot_positions(plots, sensors)
    polar, spread = np.full((len(plots), 3), np.nan), np.full((len(plots), 3, 3), np.nan)
    for key in np.unique(plots.sensor).tolist():
        sensor = sensors.find(key)
        if sensor is None:
            continue
        rows = np.flatnonzero(plots.sensor == key)
        site, rotation = site_of(sensor)
        polar[rows] = polar_from_position(position[rows], site, rotation)
        polar[rows, 0], polar[rows, 1] = plots.range_m[rows], from_true_north(plots.azimuth_rad[rows], sensor)
        measured = np.isfinite(plots.elevation_rad[rows])
        polar[rows[measured], 2] = plots.elevation_rad[rows[measured]]
        outward = frames.Polar(site, rotation).to_ecef(polar[rows])[1]
        spread[rows] = frames.propagate(outward, _polar_covariance(plots, rows, sensors, polar[rows]))
    return position, spread, polar


def _polar_covariance(plots: Plots, rows: IntArray, sensors: Sensors, polar: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3), m and rad, of plots: their own sd, else the sensor's, else what is usual (50 m, 0.1 deg)."""
    out = np.zeros((len(rows), 3, 3))
    keys = plots.sensor[rows]
    for key in np.unique(keys).tolist():
        sensor = sensors.find(key)
        mine = np.flatnonzero(keys == key)
        usual = (50.0, 0.1, 0.1) if sensor is None else (
            sensor.range_sd_m or 50.0, sensor.azimuth_sd_deg or 0.1, sensor.elevation_sd_deg or 0.1,
        )  # fmt: skip
        own = (plots.range_sd_m, plots.azimuth_sd_rad, plots.elevation_sd_rad)
        for c, (column, sd) in enumerate(zip(own, usual, strict=True)):
            told = column[rows[mine]]
            out[mine, c, c] = np.where(np.isfinite(told) & (told > 0), told, sd * (1.0 if c == 0 else DEG)) ** 2
        no_elevation = mine[~np.isfinite(plots.elevation_rad[rows[mine]])]
        out[no_elevation, 2, 2] = (_HEIGHT_SD_M / np.maximum(polar[no_elevation, 0], 1.0)) ** 2
    return out


def _brackets(
    plots: Plots, usable: BoolArray, target: IntArray, main: int, other: int, gap_s: float
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Rows of the radar's plots, of the main radar's plots before and after, and the second's share (n,)."""
    theirs = np.flatnonzero(usable & (plots.sensor == main))
    mine = np.flatnonzero(usable & (plots.sensor == other))
    theirs = theirs[np.lexsort((plots.time_s[theirs], target[theirs]))]
    if not len(theirs) or not len(mine):
        empty = np.empty(0, np.int64)
        return empty, empty, empty, np.empty(0)
    # One sorted key of target and time; the target's rank times more than the whole span keeps them apart.
    names, rank = np.unique(target[theirs], return_inverse=True)
    begin = plots.time_s[theirs].min()
    span = 2 * (max(plots.time_s[theirs].max(), plots.time_s[mine].max()) - min(begin, plots.time_s[mine].min())) + 10.0
    at = np.searchsorted(names, target[mine])
    known = (at < len(names)) & (names[np.minimum(at, len(names) - 1)] == target[mine])
    mine, at = mine[known], at[known]
    key = rank * span + (plots.time_s[theirs] - begin)
    after = np.searchsorted(key, at * span + (plots.time_s[mine] - begin))
    after = np.clip(after, 0, len(theirs) - 1)
    same = plots.time_s[theirs[after]] == plots.time_s[mine]
    before = np.where(same, after, np.maximum(after - 1, 0))
    first, second = theirs[before], theirs[after]
    t, t1, t2 = plots.time_s[mine], plots.time_s[first], plots.time_s[second]
    good = (target[first] == target[mine]) & (target[second] == target[mine]) & (t1 <= t) & (t <= t2) & (t2 - t1 <= gap_s)
    share = np.where(t2 > t1, (t - t1) / np.where(t2 > t1, t2 - t1, 1.0), 0.0)
    return mine[good], first[good], second[good], share[good]


def absolute_condition(samples: Samples) -> float:
    """The condition number of the normal equations for the biases of *both* radars from these differences.

    A sample is b_radar - T b_main with T the `turn`: only where T changes with the target's place do the two differ.  Columns
    are scaled to unit length; infinite for radars at one point.  NaN without turns.
    """
    known = np.isfinite(samples.turn).all(axis=(1, 2)) & np.isfinite(samples.covariance).all(axis=(1, 2))
    if not known.any():
        return float("nan")
    rows = np.flatnonzero(known)[:: max(1, int(known.sum()) // 5000)]
    sd = np.sqrt(np.diagonal(samples.covariance[rows], axis1=1, axis2=2))
    columns = np.concatenate([np.broadcast_to(np.eye(3), (len(rows), 3, 3)), -samples.turn[rows]], axis=2) / sd[:, :, None]
    normal = np.einsum("nij,nik->jk", columns, columns)
    size = np.sqrt(np.diag(normal))
    values = np.linalg.eigvalsh(normal / size[:, None] / size)
    return float(values[-1] / values[0]) if values[0] > 1e-14 * values[-1] else float("inf")


def first_order_difference(
    value: FloatArray, frame: frames.Polar, main_value: FloatArray, main_frame: frames.Polar
) -> FloatArray:
    """The paper's own sample C^-1 Psi (n, 3): the difference of positions, turned by the Jacobian at the radar's plot (eq. 9).

    For the study: it is off by the curvature of the polar frame.
    """
    here, outward = frame.to_ecef(value)
    there, _ = main_frame.to_ecef(main_value)
    return np.asarray(np.linalg.solve(outward, (here - there)[..., None])[..., 0])


# -------------------------------------------------------------------------------------------------------------- the mean shift
class MeanShift(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="mean-shift"):
    """Mean-shift registration with the flat kernel over all history (MSR: paper 002 eqs. 12 and 13; kappa = 0).

    `bandwidth` is the radius in units of each sample's own sd.  Good for a bias that stays.
    """

    bandwidth: float = 3.0

    def __call__(self, time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray) -> Estimate:
        """See `Online`."""
        return _search(self.bandwidth, np.inf, False, True, time_s, value, variance, epoch_s)


class Igmsr(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="igmsr"):
    """Improved Gaussian mean-shift registration (IGMSR: paper 002 eqs. 14 to 18).

    Of lambda and kappa in eq. 17 only lambda^kappa matters: `tau_s` = -1 / (kappa ln lambda) is the time constant.  `bandwidth`
    is in units of each sample's own sd.  With `multi_start` the search starts from the last mode, the newest samples and the
    average, and takes the densest mode; without, from the last mode only (at first from the newest sample), which may be a
    crowd of outliers.
    """

    tau_s: float = 10.0
    bandwidth: float = 3.0
    multi_start: bool = True

    def __call__(self, time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray) -> Estimate:
        """See `Online`."""
        return _search(self.bandwidth, self.tau_s, True, self.multi_start, time_s, value, variance, epoch_s)


class ExponentialAverage(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="exponential-average"):
    """The average of the samples so far, weighted by exp(-age / tau_s): IGMSR's limit of an infinite bandwidth."""

    tau_s: float = 10.0

    def __call__(self, time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray) -> Estimate:
        """See `Online`."""
        return _search(np.inf, self.tau_s, False, False, time_s, value, variance, epoch_s)


def checked(
    time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray, where: str
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The arguments of a method, contiguous and of the right shapes.  Raises SettingsError."""
    t, e = np.ascontiguousarray(time_s, np.float64), np.ascontiguousarray(epoch_s, np.float64)
    z = np.ascontiguousarray(value, np.float64)
    if t.ndim != 1 or e.ndim != 1 or z.ndim != 2 or z.shape[1] != len(t) or not len(t) or not len(e):
        raise SettingsError(
            f"times {t.shape}, values {z.shape} and epochs {e.shape} do not fit",
            where=where,
            remedy="Give times (n,), values and variances (m, n) and epochs (k,), none empty.",
        )
    r = np.ascontiguousarray(np.broadcast_to(np.asarray(variance, np.float64), z.shape))
    if not (np.isfinite(t).all() and np.isfinite(e).all() and (np.diff(t) >= 0).all() and (np.diff(e) >= 0).all()):
        raise SettingsError("times and epochs must be numbers in order", where=where, remedy="Sort them, and leave out NaN.")
    if not (r[np.isfinite(z)] > 0).all():
        raise SettingsError("variances must be positive", where=where, remedy="Give the samples' variances.")
    return t, z, r, e


def _search(
    bandwidth: float,
    tau_s: float,
    gaussian: bool,
    multi_start: bool,
    time_s: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    epoch_s: FloatArray,
) -> Estimate:
    if not bandwidth > 0 or not tau_s > 0:
        raise SettingsError(
            f"tau_s = {tau_s} and bandwidth = {bandwidth} make no sense", where="mean shift", remedy="Give positive numbers."
        )
    t, z, r, e = checked(time_s, value, variance, epoch_s, "mean shift")
    # Over all history with an infinite bandwidth the numbers below stay finite.
    h, tau = float(min(bandwidth, 1e150)), float(min(tau_s, 1e150))
    shape = _shape(h, gaussian)

    def part(rows: slice) -> Estimate:
        own = np.ascontiguousarray(z[rows])
        out, spread = np.full((len(own), len(e)), np.nan), np.full((len(own), len(e)), np.nan)
        missed = np.zeros(len(own), np.int64)
        _modes(t, own, np.ascontiguousarray(r[rows]), e, tau, h, gaussian, multi_start, out, shape, spread, missed)
        return Estimate(out, spread, missed)

    return joined(in_threads(part, slices(len(z), 8)))


def _shape(h: float, gaussian: bool) -> float:
    """For normal noise: the mean of g^2 u^2 over that of g^2, and for the flat kernel what its edge takes from the slope too."""
    if gaussian:
        return 1 / (1 + 2 / h**2)
    edge = 2 * h * np.exp(-0.5 * min(h, 30.0) ** 2) / np.sqrt(2 * np.pi)
    inside = math.erf(h / math.sqrt(2))
    # Below a bandwidth of one the edge is all there is.
    return float(inside / max(inside - edge, 0.2 * inside))


def joined(parts: list[Estimate]) -> Estimate:
    """Estimates of several groups of series as one."""
    return Estimate(*(np.concatenate([p[c] for p in parts]) for c in range(3)))


@kernel
def _modes(
    time: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    epoch: FloatArray,
    tau: float,
    h: float,
    gaussian: bool,
    multi_start: bool,
    out: FloatArray,
    shape: float,
    spread: FloatArray,
    missed: IntArray,
) -> None:
    """Fill modes (m, k), their variances (m, k) and the numbers (m,) of searches that did not settle; NaN before any sample."""
    # Modes of a Gaussian density lie more than a bandwidth apart: what is nearer to one climbs to it.
    near = (0.5 if gaussian else 0.02) * h
    starts, found, age = np.empty(_NEWEST + 2), np.empty(_NEWEST + 2), np.empty(len(time))
    for s in range(value.shape[0]):
        z, r = value[s], variance[s]
        begin, end, newest, have, last = 0, 0, -1, False, 0.0
        for k in range(len(epoch)):
            while end < len(time) and time[end] <= epoch[k]:
                if not np.isnan(z[end]):
                    newest = end
                end += 1
            if newest < 0:
                continue
            # Only differences of ages count: with no new sample the last estimate stays.
            now = time[newest]
            while now - time[begin] > _MEMORY * tau:
                begin += 1
            sd = np.sqrt(r[newest])
            count = 0
            if have:
                starts[count] = last
                count += 1
            i, taken = newest, 0
            while i >= begin and taken < (_NEWEST if multi_start else 0 if have else 1):
                if not np.isnan(z[i]):
                    starts[count] = z[i]
                    count, taken = count + 1, taken + 1
                i -= 1
            # Plots of one scan mostly share a stamp: the weight of an age is found once.
            for i in range(begin, newest + 1):
                age[i] = age[i - 1] if i > begin and time[i] == time[i - 1] else np.exp(-(now - time[i]) / tau)
            if multi_start:
                total, mean = 0.0, 0.0
                for i in range(begin, newest + 1):
                    if not np.isnan(z[i]):
                        w = age[i] / r[i]
                        total += w
                        mean += w * z[i]
                starts[count] = mean / total
                count += 1
            best, at, different, settled = -1.0, starts[0], 0, True
            for c in range(count):
                x, density, again, done = starts[c], 0.0, False, False
                for _ in range(_STEPS):
                    for f in range(different):
                        again = again or abs(x - found[f]) < near * sd
                    if again:
                        break
                    total, shift, density = 0.0, 0.0, 0.0
                    for i in range(begin, newest + 1):
                        if np.isnan(z[i]):
                            continue
                        off = z[i] - x
                        u2 = off * off / (h * h * r[i])
                        if gaussian:
                            if u2 > 1400.0:
                                continue
                            w = age[i] * np.exp(-0.5 * u2)
                            density += w
                        else:
                            # The flat kernel climbs the density of Epanechnikov's.
                            if u2 > 1.0:
                                continue
                            w = age[i]
                            density += w * (1.0 - u2)
                        total += w / r[i]
                        shift += w / r[i] * off
                    if total == 0.0:
                        break
                    x += shift / total
                    if abs(shift / total) < 1e-4 * sd:
                        done = True
                        break
                if again:
                    continue
                found[different] = x
                different += 1
                if density > best:
                    best, at, settled = density, x, done
            last, have = at, True
            out[s, k] = at
            if not settled:
                missed[s] += 1
            # What noise does to the root of the sum of influences w g (z - x) / r: its variance over its slope squared, with
            # the samples' variances for the squares, which few samples do not show.
            top, slope, weight = 0.0, 0.0, 0.0
            for i in range(begin, newest + 1):
                if np.isnan(z[i]):
                    continue
                u2 = (z[i] - at) ** 2 / (h * h * r[i])
                if u2 > (1400.0 if gaussian else 1.0):
                    continue
                w = age[i] * (np.exp(-0.5 * u2) if gaussian else 1.0) / r[i]
                top += w * w * r[i]
                weight += w
                slope += w * (1.0 - u2) if gaussian else w
            spread[s, k] = shape * top / max(slope, 0.2 * weight) ** 2 if weight > 0.0 else r[newest]
