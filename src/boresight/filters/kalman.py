"""The Kalman filter's two steps on positions, and one model run over many targets or Monte Carlo runs.

The kernels `predict` and `update` work on model m of a stack of states x (M, d), P (M, d, d); the single filter, the interacting
models and the tracker all call them.  Tuples `like` and `axes` carry the lengths d and k as constants of the compiler.
Covariances are computed on one triangle and mirrored: they are symmetric to the bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._jit import inlined, kernel
from .._parallel import in_threads, slices
from .._types import FloatArray
from ..errors import SettingsError
from .motion import SAME_S, Motion, fill, size, table, vertical

_ROWS = 64


class Filtered(NamedTuple):
    """States after each measurement: of n targets (or runs), K times, d coordinates.

    `mean` (n, K, d) and `covariance` (n, K, d, d; empty where it was not asked for); `nis` (n, K) is the normalised innovation
    squared and `likelihood` (n, K) the logarithm of the measurement's density (NaN where there was none, and at the start).
    """

    time_s: FloatArray
    mean: FloatArray
    covariance: FloatArray
    nis: FloatArray
    likelihood: FloatArray


@inlined
def predict(
    x: FloatArray,
    p: FloatArray,
    m: int,
    transition: FloatArray,
    noise: FloatArray,
    like: tuple[int, ...],
    work: FloatArray,
    ahead: FloatArray,
    spread: FloatArray,
) -> None:
    """x- = F x, P- = F P F' + Q: from state m of `x`, `p` into row m of `ahead`, `spread`; `work` is (d, d)."""
    d = len(like)
    for i in range(d):
        s = 0.0
        for j in range(d):
            s += transition[m, i, j] * x[m, j]
        ahead[m, i] = s
        for j in range(d):
            s = 0.0
            for h in range(d):
                s += transition[m, i, h] * p[m, h, j]
            work[i, j] = s
    for i in range(d):
        for j in range(i, d):
            s = noise[m, i, j]
            for h in range(d):
                s += work[i, h] * transition[m, j, h]
            spread[m, i, j] = s
            spread[m, j, i] = s


@inlined
def update(
    ahead: FloatArray,
    spread: FloatArray,
    m: int,
    z: FloatArray,
    r: FloatArray,
    row: int,
    step: int,
    like: tuple[int, ...],
    axes: tuple[int, ...],
    gain: FloatArray,
    x: FloatArray,
) -> tuple[float, float]:
    """Take in position `z[row, step]` (k,) with covariance `r[row, step]`: row m of `ahead` into `x`, of `spread` in place.

    Returns the normalised innovation squared and the determinant of the innovation's covariance.  `gain` is
    (d, 2 k): the gain, and the prediction's covariance with the position.
    """
    d, k = len(like), len(axes)
    if k == 2:
        a = spread[m, 0, 0] + r[row, step, 0, 0]
        b = spread[m, 0, 1] + r[row, step, 0, 1]
        c = spread[m, 1, 1] + r[row, step, 1, 1]
        det = a * c - b * b
        inverse = 1.0 / det
        v0, v1 = z[row, step, 0] - ahead[m, 0], z[row, step, 1] - ahead[m, 1]
        for i in range(d):
            p0, p1 = spread[m, i, 0], spread[m, i, 1]
            g0, g1 = (p0 * c - p1 * b) * inverse, (p1 * a - p0 * b) * inverse
            gain[i, 0], gain[i, 1], gain[i, 2], gain[i, 3] = g0, g1, p0, p1
            x[m, i] = ahead[m, i] + g0 * v0 + g1 * v1
        for i in range(d):
            for j in range(i, d):
                if i < 2:
                    # (I - G H) P H' = G R: no difference of large numbers, however uncertain the prediction was.
                    s = r[row, step, i, 0] * gain[j, 0] + r[row, step, i, 1] * gain[j, 1]
                else:
                    s = spread[m, i, j] - gain[i, 0] * gain[j, 2] - gain[i, 1] * gain[j, 3]
                spread[m, i, j] = s
                spread[m, j, i] = s
        return (v0 * v0 * c - 2 * v0 * v1 * b + v1 * v1 * a) * inverse, det
    a = spread[m, 0, 0] + r[row, step, 0, 0]
    b = spread[m, 0, 1] + r[row, step, 0, 1]
    c = spread[m, 0, 2] + r[row, step, 0, 2]
    e = spread[m, 1, 1] + r[row, step, 1, 1]
    f = spread[m, 1, 2] + r[row, step, 1, 2]
    g = spread[m, 2, 2] + r[row, step, 2, 2]
    # S = L D L', which keeps its digits where cofactors would not.
    l10, l20 = b / a, c / a
    d1 = e - l10 * b
    l21 = (f - l20 * b) / d1
    d2 = g - l20 * c - l21 * l21 * d1
    v0, v1, v2 = z[row, step, 0] - ahead[m, 0], z[row, step, 1] - ahead[m, 1], z[row, step, 2] - ahead[m, 2]
    y1 = v1 - l10 * v0
    y2 = v2 - l20 * v0 - l21 * y1
    for i in range(d):
        p0, p1, p2 = spread[m, i, 0], spread[m, i, 1], spread[m, i, 2]
        w1 = p1 - l10 * p0
        g2 = (p2 - l20 * p0 - l21 * w1) / d2
        g1 = w1 / d1 - l21 * g2
        g0 = p0 / a - l10 * g1 - l20 * g2
        gain[i, 0], gain[i, 1], gain[i, 2], gain[i, 3], gain[i, 4], gain[i, 5] = g0, g1, g2, p0, p1, p2
        x[m, i] = ahead[m, i] + g0 * v0 + g1 * v1 + g2 * v2
    for i in range(d):
        for j in range(i, d):
            if i < 3:
                s = r[row, step, i, 0] * gain[j, 0] + r[row, step, i, 1] * gain[j, 1] + r[row, step, i, 2] * gain[j, 2]
            else:
                s = spread[m, i, j] - gain[i, 0] * gain[j, 3] - gain[i, 1] * gain[j, 4] - gain[i, 2] * gain[j, 5]
            spread[m, i, j] = s
            spread[m, j, i] = s
    return v0 * v0 / a + y1 * y1 / d1 + y2 * y2 / d2, a * d1 * d2


@inlined
def measured(z: FloatArray, row: int, step: int, axes: tuple[int, ...]) -> bool:
    """Whether there is a measurement `z[row, step]`."""
    total = 0.0
    for i in range(len(axes)):
        total += z[row, step, i]
    return bool(np.isfinite(total))


@kernel
def _run(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    models: FloatArray,
    start: FloatArray,
    start_spread: FloatArray,
    first: int,
    like: tuple[int, ...],
    axes: tuple[int, ...],
    mean: FloatArray,
    covariance: FloatArray,
    nis: FloatArray,
    likelihood: FloatArray,
) -> None:
    """One model over runs (n, K): fills `mean`, `nis`, `likelihood`, and `covariance` unless that is empty."""
    d, k = len(like), len(axes)
    x, p = np.zeros((1, d)), np.zeros((1, d, d))
    ahead, spread = np.zeros((1, d)), np.zeros((1, d, d))
    transition, noise = np.zeros((1, d, d)), np.zeros((1, d, d))
    work, gain, up = np.zeros((d, d)), np.zeros((d, 2 * k)), np.zeros(3)
    up[2] = 1.0
    keep = covariance.shape[0] > 0
    last = -1.0
    for row in range(z.shape[0]):
        for i in range(d):
            x[0, i] = start[row, i]
            for j in range(d):
                p[0, i, j] = start_spread[row, i, j]
        for step in range(first, z.shape[1]):
            if step > first:
                dt = time_s[step] - time_s[step - 1]
                if k == 3:
                    vertical(x, 0, up)
                if k == 3 or abs(dt - last) > SAME_S:
                    fill(models, 0, dt, up, transition, noise, like, axes)
                    last = dt
                predict(x, p, 0, transition, noise, like, work, ahead, spread)
                if measured(z, row, step, axes):
                    d2, det = update(ahead, spread, 0, z, r, row, step, like, axes, gain, x)
                    nis[row, step] = d2
                    likelihood[row, step] = -0.5 * (d2 + np.log(det) + k * 1.8378770664093453)
                else:
                    x, ahead = ahead, x
                p, spread = spread, p
            for i in range(d):
                mean[row, step, i] = x[0, i]
            if keep:
                for i in range(d):
                    for j in range(d):
                        covariance[row, step, i, j] = p[0, i, j]


def kalman_filter(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    motion: Motion,
    start: tuple[FloatArray, FloatArray],
    *,
    first: int = 0,
    covariances: bool = True,
) -> Filtered:
    """The Kalman filter of one motion model over positions `z` (n, K, k) with covariances `r` (n, K, k, k) at `time_s` (K,).

    n targets or Monte Carlo runs share the times; NaN positions are times without a measurement.  `start` is the state (n, d) and
    its covariance (n, d, d) at measurement number `first`, which is not taken in again; before it all results are NaN.  Axes and
    state as in `motion`: k = 2 or 3.  Raises SettingsError for shapes that do not fit, times that go backwards, and covariances
    that are none, of a measurement or of the start.
    """
    z, r, time_s, x, p = check(z, r, time_s, start, first, size([motion], z.shape[-1] if np.ndim(z) == 3 else 3))
    d = x.shape[1]
    out = empty(z, time_s, d, covariances)

    def piece(rows: slice) -> None:
        _run(
            z[rows], r[rows], time_s, table([motion]), x[rows], p[rows], first, (0,) * d, (0,) * z.shape[2],
            out.mean[rows], out.covariance[rows] if covariances else out.covariance, out.nis[rows], out.likelihood[rows],
        )  # fmt: skip

    in_threads(piece, slices(len(z), _ROWS))
    return out


def empty(z: FloatArray, time_s: FloatArray, d: int, covariances: bool) -> Filtered:
    """Results of which nothing is known yet."""
    n, steps = z.shape[:2]
    return Filtered(
        time_s,
        np.full((n, steps, d), np.nan),
        np.full((n, steps, d, d) if covariances else (0, 0, 0, 0), np.nan),
        np.full((n, steps), np.nan),
        np.full((n, steps), np.nan),
    )


def check(
    z: FloatArray, r: FloatArray, time_s: FloatArray, start: tuple[FloatArray, FloatArray], first: int, d: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Measurements, times and start as contiguous arrays; raises SettingsError where they do not fit."""
    z, r, time_s = (np.ascontiguousarray(a, np.float64) for a in (z, r, time_s))
    x, p = (np.ascontiguousarray(a, np.float64) for a in start)
    n, steps, k = z.shape if z.ndim == 3 else (0, 0, 0)

    def refuse(what: str, remedy: str) -> SettingsError:
        return SettingsError(what, where="filter", remedy=remedy)

    if k not in (2, 3) or r.shape != (n, steps, k, k) or time_s.shape != (steps,) or x.shape != (n, d) or p.shape != (n, d, d):
        raise refuse(
            f"positions {z.shape}, covariances {r.shape}, times {time_s.shape} and start {x.shape}, {p.shape} do not fit",
            f"Give (n, K, k), (n, K, k, k), (K,), and with this model (n, {d}), (n, {d}, {d}); k is 2 or 3.",
        )
    if not 0 <= first < max(steps, 1):
        raise refuse(f"first = {first} is not among the {steps} measurements", "Number the measurements from 0.")
    if not np.isfinite(time_s).all():
        raise refuse("a time is not a number", "Leave such measurements out.")
    back = np.flatnonzero(np.diff(time_s) < 0)
    if len(back):
        raise refuse(f"time goes backwards at measurement {int(back[0]) + 1}", "Sort the measurements by time.")
    row, step, what = _first_fault(z, r)
    if row >= 0:
        raise refuse(
            f"the covariance of measurement {step} of target {row} {_FAULTS[what]}",
            "Give the measurement's covariance in the filter's axes, metres squared.",
        )
    check_start(x, p)
    return z, r, time_s, x, p


_FAULTS = (
    "is not symmetric with positive variances",
    "holds a correlation beyond 1",
    "is not positive semidefinite: its correlations contradict each other",
)


def check_start(x: FloatArray, p: FloatArray) -> None:
    """Raise SettingsError, naming the target, for a start (n, d) that is no number or whose covariance (n, d, d) is none."""
    bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
    row, what = (int(bad[0]), -1) if len(bad) else _first_start(p)
    if row >= 0:
        fault = "is not a number" if what < 0 else f"has a covariance that {_START_FAULTS[what]}"
        raise SettingsError(
            f"the start of target {row} {fault}", where="filter", remedy="Give a state and its covariance, as one_point does."
        )


_START_FAULTS = (
    "is not symmetric with variances of 0 or more",
    "holds a correlation beyond 1",
    "is not positive semidefinite: its correlations contradict each other",
)


@kernel
def _first_start(p: FloatArray) -> tuple[int, int]:
    """The first of the covariances (n, d, d) that is none, and which of `_START_FAULTS` it has; (-1, 0) if all are."""
    n, d = p.shape[0], p.shape[1]
    size, low = np.zeros(d), np.zeros((d, d))
    for row in range(n):
        for i in range(d):
            if not (p[row, i, i] >= 0 and np.isfinite(p[row, i, i])):
                return row, 0
            size[i] = np.sqrt(p[row, i, i])
            for j in range(i):
                one, limit = p[row, i, j], size[i] * size[j]
                if not (abs(one - p[row, j, i]) <= 1e-9 * limit):
                    return row, 0
                if abs(one) > (1 + 1e-6) * limit:
                    return row, 1
        # Cholesky of the correlations, a little more on the diagonal: what rounding does to a filter's own result is forgiven.
        for i in range(d):
            for j in range(i + 1):
                limit = size[i] * size[j]
                s = p[row, i, j] / limit if limit > 0 else 0.0
                if i == j:
                    s = 1.0 + 1e-6
                for h in range(j):
                    s -= low[i, h] * low[j, h]
                if i > j:
                    low[i, j] = s / low[j, j]
                elif s <= 0:
                    return row, 2
                else:
                    low[i, i] = np.sqrt(s)
    return -1, 0


@kernel
def _first_fault(z: FloatArray, r: FloatArray) -> tuple[int, int, int]:
    """The first row and step whose position is given and whose covariance is none, and which of `_FAULTS` (-1, -1, 0: none)."""
    k = z.shape[2]
    for row in range(z.shape[0]):
        for step in range(z.shape[1]):
            given, good, whole = True, True, True
            for i in range(k):
                given = given and np.isfinite(z[row, step, i])
                good = good and r[row, step, i, i] > 0 and np.isfinite(r[row, step, i, i])
                for j in range(i):
                    one, other = r[row, step, i, j], r[row, step, j, i]
                    size = r[row, step, i, i] * r[row, step, j, j]
                    good = good and (one == other or (one - other) ** 2 <= 1e-18 * size) and np.isfinite(one)
                    whole = whole and one * one <= (1 + 1e-9) * size
            if not given:
                continue
            if not good:
                return row, step, 0
            if not whole:
                return row, step, 1
            if k == 3:
                a, b, c = r[row, step, 0, 0], r[row, step, 1, 1], r[row, step, 2, 2]
                d, e, f = r[row, step, 1, 0], r[row, step, 2, 0], r[row, step, 2, 1]
                if a * b * c + 2 * d * e * f - a * f * f - b * e * e - c * d * d < -1e-8 * a * b * c:
                    return row, step, 2
    return -1, -1, 0


# ------------------------------------------------------------------------------------------------------------------- the start
def two_point(z: FloatArray, r: FloatArray, time_s: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """State (n, d) and covariance (n, d, d) at the second of two positions `z` (n, 2, k): velocity is their difference over time.

    Exact for straight motion without process noise.  Acceleration, where the state has one, is 0 +- 10 m/s^2.  Raises
    SettingsError where both have the same time.
    """
    n, _, k = z.shape
    dt = float(time_s[1] - time_s[0])
    if not dt > 0:
        raise SettingsError("two positions of the same time tell no velocity", where="start", remedy="Take a later second one.")
    x, p = np.zeros((n, d)), np.zeros((n, d, d))
    x[:, :k], x[:, k : 2 * k] = z[:, 1], (z[:, 1] - z[:, 0]) / dt
    p[:, :k, :k] = r[:, 1]
    p[:, :k, k : 2 * k] = p[:, k : 2 * k, :k] = r[:, 1] / dt
    p[:, k : 2 * k, k : 2 * k] = (r[:, 0] + r[:, 1]) / dt**2
    _accelerate(p, k)
    return x, p


def one_point(z: FloatArray, r: FloatArray, d: int, speed_sd_mps: float) -> tuple[FloatArray, FloatArray]:
    """State (n, d) and covariance (n, d, d) at one position `z` (n, k), at rest with so large a sd of each velocity."""
    n, k = z.shape
    x, p = np.zeros((n, d)), np.zeros((n, d, d))
    x[:, :k], p[:, :k, :k] = z, r
    p[:, range(k, 2 * k), range(k, 2 * k)] = speed_sd_mps**2
    _accelerate(p, k)
    return x, p


def range_rate_start(
    z: FloatArray, r: FloatArray, d: int, site: FloatArray, rate_mps: FloatArray, rate_sd_mps: float, speed_sd_mps: float
) -> tuple[FloatArray, FloatArray]:
    """State and covariance at one position `z` (n, k) with a measured range rate (n,), seen from `site` (k,).

    Along the line of sight the velocity is the range rate, across it 0 with `speed_sd_mps`.
    """
    x, p = one_point(z, r, d, speed_sd_mps)
    k = z.shape[1]
    sight = z - site
    sight = sight / np.maximum(np.sqrt((sight**2).sum(axis=1, keepdims=True)), 1e-3)
    x[:, k : 2 * k] = sight * np.asarray(rate_mps)[:, None]
    p[:, k : 2 * k, k : 2 * k] += (rate_sd_mps**2 - speed_sd_mps**2) * sight[:, :, None] * sight[:, None, :]
    return x, p


def _accelerate(p: FloatArray, k: int) -> None:
    if p.shape[1] == 3 * k:
        p[:, range(2 * k, 3 * k), range(2 * k, 3 * k)] = 10.0**2
