"""Filters on what radars measure: range, azimuth, elevation or height, and range rate, of several radars in one state.

The state is about an anchor (east, north, up, as in `motion`); every radar has its own site and axes.  Each plot says of itself
which of the five it measured: what is NaN is not taken in.  Height is above the ellipsoid where the target is, not the anchor's
up; a pressure altitude becomes one first (`boresight.heights`).

The update is the extended Kalman filter's, of first or second order, or the unscented one's.  Of second order the curvature of
range and angles over the prediction's spread counts as noise, and so does (in all but the first order) the chance that the
target is on the other side of the antenna: overhead, and at range 0, an angle that says nothing then weighs nothing.

Sources: Bar-Shalom, Li & Kirubarajan 2001, section 10.3 (extended, second order); Julier & Uhlmann 2004 (unscented).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from .._jit import kernel
from .._parallel import in_threads, slices
from .._types import FloatArray, IntArray
from ..errors import SettingsError
from ..frames import Automatic, Enu, Polar, convert
from ..geodesy import E2, SEMI_MAJOR_M, SEMI_MINOR_M, geodetic_from_ecef, height_and_up, rotate, rotate_back
from ..measure import polar_from_position, position_from_height, position_from_polar
from .imm import Imm, Mixed, changes, combine, combined_spread, fill_change, mix, weigh
from .kalman import Filtered, _accelerate, check_start, predict
from .motion import PARAMETER, TURN, Motion, fill, size, table, vertical

COMPONENTS = ("range", "azimuth", "elevation", "height", "range_rate")
_RANGE, _AZIMUTH, _ELEVATION, _HEIGHT, _RATE = 0, 1, 2, 3, 4
_ROWS = 16
# Nearer to the antenna, or to the vertical through it, than a metre directions change as at a metre.
_NEAR_M = 1.0
# Sites nearer to the origin than this are on a plane, not on the Earth.
_FLAT_M = 1e6
_EP2 = E2 / (1 - E2)
_UNMEASURED = 1.0


class ExtendedKalman(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="extended"):
    """The measurement linearised at the prediction; with `order` 2 its curvature counts, too: as mean and as noise."""

    order: int = 2


class UnscentedKalman(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="unscented"):
    """Sigma points on what is measured, position or (with a range rate) position and velocity; the rest of the state follows.

    The centre weighs kappa / (n + kappa) of n coordinates.  With kappa = 1 the variance along the line of sight is right for a
    position in space; with 0 it is half of that (METHODS section 1).
    """

    kappa: float = 1.0


Update = ExtendedKalman | UnscentedKalman
_EXTENDED = ExtendedKalman()


class RadarPlots(NamedTuple):
    """Plots of n targets (or Monte Carlo runs) that are seen at the same times; `radar_plots` makes them of columns.

    `value` (n, K, 5): slant range m, azimuth rad from true north, elevation rad, ellipsoidal height m, range rate m/s; NaN is not
    measured.  `covariance` (n, K, 5, 5) of each plot; `time_s` (K,), in order; `radar` (K,) the index of each plot's radar.
    """

    value: FloatArray
    covariance: FloatArray
    time_s: FloatArray
    radar: IntArray


def radar_plots(
    time_s: ArrayLike,
    radar: ArrayLike,
    *,
    range_m: FloatArray,
    azimuth_rad: FloatArray,
    range_sd_m: ArrayLike,
    azimuth_sd_rad: ArrayLike,
    elevation_rad: FloatArray | None = None,
    elevation_sd_rad: ArrayLike = _UNMEASURED,
    height_m: FloatArray | None = None,
    height_sd_m: ArrayLike = _UNMEASURED,
    range_rate_mps: FloatArray | None = None,
    range_rate_sd_mps: ArrayLike = _UNMEASURED,
) -> RadarPlots:
    """Plots of columns (n, K) with independent errors; standard deviations are numbers, or (K,), or (n, K).

    `time_s` (K,) and `radar` (K,), or one index for all.  Raises SettingsError for shapes that do not fit.
    """
    time = np.asarray(time_s, np.float64)
    shape = np.shape(range_m)
    columns = (range_m, azimuth_rad, elevation_rad, height_m, range_rate_mps)
    sds = (range_sd_m, azimuth_sd_rad, elevation_sd_rad, height_sd_m, range_rate_sd_mps)
    if len(shape) != 2 or time.shape != shape[1:] or any(c is not None and np.shape(c) != shape for c in columns):
        raise SettingsError(
            f"columns {[np.shape(c) for c in columns if c is not None]} and times {time.shape} do not fit",
            where="radar plots",
            remedy="Give every column as (n, K) and the times as (K,).",
        )
    value = np.full((*shape, 5), np.nan)
    covariance = np.zeros((*shape, 5, 5))
    for k, (column, sd) in enumerate(zip(columns, sds, strict=True)):
        if column is not None:
            value[..., k] = column
        covariance[..., k, k] = np.square(np.broadcast_to(np.asarray(sd, np.float64), shape))
    return RadarPlots(value, covariance, time, np.array(np.broadcast_to(np.asarray(radar, np.int64), time.shape)))


# ------------------------------------------------------------------------------------------------------ one measurement's kernels
@kernel
def _height(p: FloatArray, origin: FloatArray, turned: FloatArray, normal: FloatArray) -> float:
    """Height above the ellipsoid at `p` (3,) about the anchor; fills its gradient (3,).  Bowring's method, two steps.

    `origin` is the anchor's, Earth-centred (at the origin: a flat scene, where height is up); `turned` its ``enu_from_ecef``.
    """
    if abs(origin[0]) + abs(origin[1]) + abs(origin[2]) < _FLAT_M:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
        return float(p[2])
    x = origin[0] + turned[0, 0] * p[0] + turned[1, 0] * p[1] + turned[2, 0] * p[2]
    y = origin[1] + turned[0, 1] * p[0] + turned[1, 1] * p[1] + turned[2, 1] * p[2]
    z = origin[2] + turned[0, 2] * p[0] + turned[1, 2] * p[1] + turned[2, 2] * p[2]
    rho = np.sqrt(x * x + y * y)
    radius = np.sqrt(rho * rho + z * z)
    out, up = SEMI_MAJOR_M * rho, SEMI_MINOR_M * z * (1 + _EP2 * SEMI_MINOR_M / max(radius, 1.0))
    for turn in range(2):
        norm = max(np.sqrt(out * out + up * up), 1e-300)
        c, s = out / norm, up / norm
        up, out = z + _EP2 * SEMI_MINOR_M * s * s * s, rho - E2 * SEMI_MAJOR_M * c * c * c
        if turn == 0:
            up *= SEMI_MINOR_M / SEMI_MAJOR_M
    norm = max(np.sqrt(out * out + up * up), 1e-300)
    c, s = out / norm, up / norm
    side = c / max(rho, 1e-300)
    for i in range(3):
        normal[i] = turned[i, 0] * side * x + turned[i, 1] * side * y + turned[i, 2] * s
    return float(rho * c + z * s - SEMI_MAJOR_M * np.sqrt(1 - E2 * s * s))


@kernel
def _seen(
    p: FloatArray,
    radar: int,
    axes: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    turned: FloatArray,
    normal: FloatArray,
    value: FloatArray,
) -> None:
    """Fill the five components (5,) of position and velocity `p` (6,) about the anchor, as a radar sees them."""
    e, n, u = offset[radar, 0], offset[radar, 1], offset[radar, 2]
    ve, vn, vu = 0.0, 0.0, 0.0
    for i in range(3):
        e += axes[radar, 0, i] * p[i]
        n += axes[radar, 1, i] * p[i]
        u += axes[radar, 2, i] * p[i]
        ve += axes[radar, 0, i] * p[3 + i]
        vn += axes[radar, 1, i] * p[3 + i]
        vu += axes[radar, 2, i] * p[3 + i]
    ground = np.sqrt(e * e + n * n)
    r = np.sqrt(e * e + n * n + u * u)
    value[_RANGE] = r
    value[_AZIMUTH] = np.arctan2(e, n)
    value[_ELEVATION] = np.arctan2(u, ground)
    value[_HEIGHT] = _height(p, origin, turned, normal)
    value[_RATE] = (e * ve + n * vn + u * vu) / max(r, _NEAR_M)


@kernel
def _linearised(
    spread: FloatArray,
    m: int,
    radar: int,
    axes: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    turned: FloatArray,
    order: int,
    k: int,
    p: FloatArray,
    normal: FloatArray,
    frame: FloatArray,
    value: FloatArray,
    shift: FloatArray,
    jacobian: FloatArray,
    bent: FloatArray,
    curve: FloatArray,
) -> None:
    """Fill what is expected (5,), by how much curvature shifts its mean (5,), and the noise of the curvature (5, 5).

    `jacobian` (5, 2 k) is by position and velocity.
    Everything is computed on axes along the ground range, across it, and up: there the second derivatives are sparse.
    """
    _seen(p, radar, axes, offset, origin, turned, normal, value)
    sin_a, cos_a = np.sin(value[_AZIMUTH]), np.cos(value[_AZIMUTH])
    r = max(value[_RANGE], _NEAR_M)
    c, s = np.cos(value[_ELEVATION]), np.sin(value[_ELEVATION])
    ground = max(value[_RANGE] * c, _NEAR_M)
    vg, vt, vu = 0.0, 0.0, 0.0
    for i in range(3):
        east, north = axes[radar, 0, i], axes[radar, 1, i]
        frame[0, i] = sin_a * east + cos_a * north
        frame[1, i] = cos_a * east - sin_a * north
        frame[2, i] = axes[radar, 2, i]
        vg += frame[0, i] * p[3 + i]
        vt += frame[1, i] * p[3 + i]
        vu += frame[2, i] * p[3 + i]
    rate = c * vg + s * vu
    for i in range(k):
        sight = c * frame[0, i] + s * frame[2, i]
        jacobian[_RANGE, i] = sight
        jacobian[_AZIMUTH, i] = frame[1, i] / ground
        jacobian[_ELEVATION, i] = (c * frame[2, i] - s * frame[0, i]) / r
        jacobian[_HEIGHT, i] = normal[i]
        jacobian[_RATE, i] = (vg * frame[0, i] + vt * frame[1, i] + vu * frame[2, i] - rate * sight) / r
        for j in range(4):
            jacobian[j, k + i] = 0.0
        jacobian[_RATE, k + i] = sight
    for i in range(5):
        for j in range(5):
            bent[i, j] = 0.0
    if order < 2:
        return
    # The prediction's covariance on those axes, and each second derivative times it: (3, 3) of range, azimuth, elevation.
    for a in range(3):
        for b in range(3):
            total = 0.0
            for i in range(k):
                for j in range(k):
                    total += frame[a, i] * spread[m, i, j] * frame[b, j]
            curve[3, a, b] = total
    for b in range(3):
        g, t, u = curve[3, 0, b], curve[3, 1, b], curve[3, 2, b]
        curve[0, 0, b], curve[0, 1, b], curve[0, 2, b] = s * (s * g - c * u) / r, t / r, c * (c * u - s * g) / r
        curve[1, 0, b], curve[1, 1, b], curve[1, 2, b] = -t / ground**2, -g / ground**2, 0.0
        curve[2, 0, b] = (2 * s * c * g + (s * s - c * c) * u) / (r * r)
        curve[2, 1, b] = -s * t / (ground * r)
        curve[2, 2, b] = ((s * s - c * c) * g - 2 * s * c * u) / (r * r)
    for i in range(3):
        shift[i] = 0.5 * (curve[i, 0, 0] + curve[i, 1, 1] + curve[i, 2, 2])
        for j in range(i + 1):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += curve[i, a, b] * curve[j, b, a]
            bent[i, j] = 0.5 * total
            bent[j, i] = 0.5 * total


@kernel
def _sample(
    ahead: FloatArray,
    spread: FloatArray,
    m: int,
    radar: int,
    axes: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    turned: FloatArray,
    kappa: float,
    k: int,
    n: int,
    p: FloatArray,
    normal: FloatArray,
    root: FloatArray,
    seen: FloatArray,
    value: FloatArray,
    shift: FloatArray,
    total: FloatArray,
    cross: FloatArray,
) -> None:
    """By sigma points on the first n coordinates: value at the centre (5,), shift of the mean, covariances (5, 5), (d, 5)."""
    d = ahead.shape[1]
    # The root L of the covariance of the first n coordinates, and of the others' with them: rows B with B L' = P.
    for j in range(n):
        s = spread[m, j, j]
        for h in range(j):
            s -= root[j, h] * root[j, h]
        pivot = np.sqrt(max(s, 1e-14 * spread[m, j, j]))
        root[j, j] = pivot
        for i in range(j + 1, d):
            s = spread[m, i, j]
            for h in range(j):
                s -= root[i, h] * root[j, h]
            root[i, j] = s / pivot if pivot > 0.0 else 0.0
    _seen(p, radar, axes, offset, origin, turned, normal, value)
    scale = np.sqrt(n + kappa)
    weight = 0.5 / (n + kappa)
    centre = kappa / (n + kappa)
    for h in range(2 * n):
        sign = scale if h % 2 == 0 else -scale
        j = h // 2
        for i in range(k):
            p[i] = ahead[m, i] + (sign * root[i, j] if i >= j else 0.0)
            p[3 + i] = ahead[m, k + i] + (sign * root[k + i, j] if n > k and k + i >= j else 0.0)
        _seen(p, radar, axes, offset, origin, turned, normal, seen[h])
        for i in range(5):
            off = seen[h, i] - value[i]
            if i == _AZIMUTH:
                off -= 2 * np.pi * np.round(off / (2 * np.pi))
            seen[h, i] = off
            shift[i] += weight * off
    for i in range(5):
        for j in range(i + 1):
            s = centre * shift[i] * shift[j]
            for h in range(2 * n):
                s += weight * (seen[h, i] - shift[i]) * (seen[h, j] - shift[j])
            total[i, j] = s
            total[j, i] = s
        for a in range(d):
            s = 0.0
            for j in range(min(n, a + 1)):
                s += root[a, j] * (seen[2 * j, i] - seen[2 * j + 1, i])
            cross[a, i] = weight * scale * s


@kernel
def _update(
    ahead: FloatArray,
    spread: FloatArray,
    m: int,
    z: FloatArray,
    r: FloatArray,
    row: int,
    step: int,
    radar: int,
    axes: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    turned: FloatArray,
    order: int,
    kappa: float,
    k: int,
    work: FloatArray,
    root: FloatArray,
    seen: FloatArray,
    x: FloatArray,
) -> tuple[float, float]:
    """Take in plot ``z[row, step]`` (5,): row m of `ahead` into `x`, of `spread` in place; `order` 0 is unscented.

    Returns the normalised innovation squared and the determinant of the innovation's covariance, of the components given.
    """
    d = ahead.shape[1]
    p, normal = np.zeros(6), np.zeros(3)
    value, shift, total, cross = np.zeros(5), np.zeros(5), np.zeros((5, 5)), np.zeros((d, 5))
    for i in range(k):
        p[i], p[3 + i] = ahead[m, i], ahead[m, k + i]
    if order > 0:
        jacobian = np.zeros((5, 2 * k))
        _linearised(
            spread, m, radar, axes, offset, origin, turned, order, k, p, normal, work[0], value, shift, jacobian, total, work[1:]
        )  # fmt: skip
        for i in range(5):
            for a in range(d):
                s = 0.0
                for b in range(2 * k if i == _RATE else k):
                    s += spread[m, a, b] * jacobian[i, b]
                cross[a, i] = s
        for i in range(5):
            for j in range(i + 1):
                s = total[i, j]
                for b in range(2 * k):
                    s += jacobian[i, b] * cross[b, j]
                total[i, j] = s
                total[j, i] = s
    else:
        n = k if np.isnan(z[row, step, _RATE]) else 2 * k
        _sample(
            ahead, spread, m, radar, axes, offset, origin, turned, kappa, k, n, p, normal, root, seen, value, shift, total, cross
        )
    if order != 1:
        # The target may be on the other side of the antenna, which no series about the prediction knows: half a turn off.
        sin_a, cos_a = np.sin(value[_AZIMUTH]), np.cos(value[_AZIMUTH])
        variance = 1e-300
        for i in range(k):
            along = sin_a * axes[radar, 0, i] + cos_a * axes[radar, 1, i]
            for j in range(k):
                variance += along * spread[m, i, j] * (sin_a * axes[radar, 0, j] + cos_a * axes[radar, 1, j])
        ratio = value[_RANGE] * np.cos(value[_ELEVATION]) / np.sqrt(2 * max(variance, 1e-300))
        total[_AZIMUTH, _AZIMUTH] += 0.5 * np.pi**2 * math.erfc(ratio)
    off, least, given = np.zeros(5), np.zeros(5), np.zeros(5, np.bool_)
    for i in range(5):
        given[i] = not np.isnan(z[row, step, i])
        off[i] = z[row, step, i] - value[i]
        # Nothing is known a million times better than foreseen: rounding would leave negative variances.
        least[i] = 1e-12 * total[i, i]
        for j in range(5):
            total[i, j] += r[row, step, i, j] if i != j else max(r[row, step, i, i], least[i])
    # An angle is compared the short way round; what curvature adds to its mean is no angle.
    off[_AZIMUTH] -= 2 * np.pi * np.round(off[_AZIMUTH] / (2 * np.pi))
    for i in range(5):
        off[i] -= shift[i]
    # S = L D L': one independent number after the other, the rest made independent of it.
    d2, det = 0.0, 1.0
    for a in range(d):
        x[m, a] = ahead[m, a]
    for i in range(5):
        if not given[i]:
            continue
        pivot = max(total[i, i], least[i])
        d2 += off[i] * off[i] / pivot
        det *= pivot
        for a in range(d):
            gain = cross[a, i] / pivot
            x[m, a] += gain * off[i]
            for b in range(a, d):
                spread[m, a, b] -= gain * cross[b, i]
        for j in range(i + 1, 5):
            if given[j]:
                share = total[j, i] / pivot
                off[j] -= share * off[i]
                for a in range(d):
                    cross[a, j] -= share * cross[a, i]
                for h in range(i + 1, 5):
                    total[j, h] -= share * total[i, h]
    for a in range(d):
        for b in range(a):
            spread[m, a, b] = spread[m, b, a]
    return d2, det


# ------------------------------------------------------------------------------------------------------------------ the filters
@kernel
def _run(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    radar: IntArray,
    axes: FloatArray,
    offset: FloatArray,
    origin: FloatArray,
    turned: FloatArray,
    models: FloatArray,
    order: int,
    kappa: float,
    stay: float,
    stay_s: float,
    given_change: FloatArray,
    begin: FloatArray,
    start: FloatArray,
    start_spread: FloatArray,
    first: int,
    like: tuple[int, ...],
    blocks: tuple[int, ...],
    mean: FloatArray,
    covariance: FloatArray,
    nis: FloatArray,
    likelihood: FloatArray,
    probability: FloatArray,
    rate: FloatArray,
) -> None:
    """Interacting models, or one, over targets (n, K); fills the results, `covariance` unless that is empty."""
    d, k, count = len(like), len(blocks), models.shape[0]
    x, p = np.zeros((count, d)), np.zeros((count, d, d))
    mixed, mixed_spread, ahead = np.zeros((count, d)), np.zeros((count, d, d)), np.zeros((count, d))
    transition, noise = np.zeros((count, d, d)), np.zeros((count, d, d))
    change, prior, score, weight = np.zeros((count, count)), np.zeros(count), np.zeros(count), np.zeros(count)
    up, work, square, root, seen = np.zeros(3), np.zeros((5, 3, 3)), np.zeros((d, d)), np.zeros((d, d)), np.zeros((4 * k, 5))
    one, one_spread = np.zeros((1, d)), np.zeros((d, d))
    up[2] = 1.0
    keep = covariance.shape[0] > 0
    for row in range(z.shape[0]):
        for m in range(count):
            weight[m] = begin[m]
            for i in range(d):
                x[m, i] = start[row, i]
                for j in range(d):
                    p[m, i, j] = start_spread[row, i, j]
        for step in range(first, z.shape[1]):
            if step > first:
                dt = time_s[step] - time_s[step - 1]
                combine(x, p, weight, like, count, one[0])
                if k == 3:
                    vertical(one, 0, up)
                for m in range(count):
                    fill(models, m, dt, up, transition, noise, like, blocks)
                if given_change.shape[0] > 0:
                    change[:] = given_change
                else:
                    fill_change(change, stay, stay_s, dt, count)
                mix(x, p, weight, change, like, count, mixed, mixed_spread, prior, score)
                components = 0
                for i in range(5):
                    components += not np.isnan(z[row, step, i])
                total, nearest = 0.0, np.inf
                for m in range(count):
                    predict(mixed, mixed_spread, m, transition, noise, like, square, ahead, p)
                    if components > 0:
                        score[m], weight[m] = _update(
                            ahead, p, m, z, r, row, step, radar[step], axes, offset, origin, turned, order, kappa, k, work, root,
                            seen, x,
                        )  # fmt: skip
                        total += prior[m] * score[m]
                        nearest = min(nearest, score[m])
                    else:
                        for i in range(d):
                            x[m, i] = ahead[m, i]
                        weight[m] = prior[m]
                if components > 0:
                    nis[row, step] = total
                    likelihood[row, step] = weigh(prior, score, weight, count, nearest, components)
            combine(x, p, weight, like, count, one[0])
            turn = 0.0
            for m in range(count):
                probability[row, step, m] = weight[m]
                turn += weight[m] * models[m, PARAMETER] if models[m, 0] == TURN else 0.0
            rate[row, step] = turn
            for i in range(d):
                mean[row, step, i] = one[0, i]
            if keep:
                combined_spread(x, p, weight, one[0], like, count, one_spread)
                covariance[row, step] = one_spread


def _filter(
    plots: RadarPlots,
    radars: Sequence[Polar],
    anchor: Enu,
    models: Sequence[Motion],
    update: Update,
    start: tuple[FloatArray, FloatArray],
    first: int,
    covariances: bool,
    chances: tuple[float, float, FloatArray, FloatArray],
) -> Mixed:
    x, p = (np.ascontiguousarray(a, np.float64) for a in start)
    z, r, time_s, radar, k = _check(plots, radars, models, x, p, first)
    n, steps, _ = z.shape
    d, count = x.shape[1], len(models)
    order = update.order if isinstance(update, ExtendedKalman) else 0
    kappa = update.kappa if isinstance(update, UnscentedKalman) else 0.0
    if isinstance(update, ExtendedKalman) and order not in (1, 2):
        raise _refuse(f"an extended Kalman filter of order {order} does not exist", "Give 1 or 2.")
    if k + kappa <= 0:
        raise _refuse(f"kappa = {kappa} is too small for {k} coordinates", f"Give more than {-k}.")
    origin, turned = np.ascontiguousarray(anchor.site, np.float64), np.ascontiguousarray(anchor.rotation, np.float64)
    axes = np.array([s.rotation @ turned.T for s in radars]).reshape(-1, 3, 3)
    offset = np.array([s.rotation @ (origin - s.site) for s in radars]).reshape(-1, 3)
    out = Mixed(
        time_s,
        np.full((n, steps, d), np.nan),
        np.full((n, steps, d, d) if covariances else (0, 0, 0, 0), np.nan),
        np.full((n, steps), np.nan),
        np.full((n, steps), np.nan),
        np.full((n, steps, count), np.nan),
        np.full((n, steps), np.nan),
    )
    numbers = table(models)

    def piece(rows: slice) -> None:
        _run(
            z[rows], r[rows], time_s, radar, axes, offset, origin, turned, numbers, order, kappa, *chances, x[rows], p[rows],
            first, (0,) * d, (0,) * k,
            out.mean[rows], out.covariance[rows] if covariances else out.covariance, out.nis[rows], out.likelihood[rows],
            out.probability[rows], out.rate_rad_s[rows],
        )  # fmt: skip

    in_threads(piece, slices(n, _ROWS))
    return out


def radar_filter(
    plots: RadarPlots,
    radars: Sequence[Polar],
    anchor: Enu,
    motion: Motion,
    start: tuple[FloatArray, FloatArray],
    *,
    update: Update = _EXTENDED,
    first: int = 0,
    covariances: bool = True,
) -> Filtered:
    """The extended or unscented Kalman filter of one motion model over the plots of any number of radars.

    `radars` are their frames, `anchor` the state's.  `start` is the state (n, d) and its covariance (n, d, d) at plot number
    `first`, which is not taken in again; before it all results are NaN (`radar_start` makes one of a plot).  Results as of
    `kalman.kalman_filter`.  A state of two axes is in the anchor's plane: no elevation and no height can be taken in.

    A target over the antenna has no azimuth, one at range 0 no direction: what is measured then changes the state as little as
    its uncertainty allows (`ExtendedKalman(order=1)` does not know that).  Raises SettingsError for shapes that do not fit, times
    that go backwards, and covariances that are none.
    """
    alone = (0.5, 1.0, np.zeros((0, 0)), np.ones(1))
    found = _filter(plots, radars, anchor, [motion], update, start, first, covariances, alone)
    return Filtered(*found[:5])


def radar_imm(
    plots: RadarPlots,
    radars: Sequence[Polar],
    anchor: Enu,
    method: Imm,
    start: tuple[FloatArray, FloatArray],
    *,
    update: Update = _EXTENDED,
    first: int = 0,
    covariances: bool = True,
) -> Mixed:
    """Interacting models over the plots of any number of radars: as `radar_filter`, with results as of `imm.imm_filter`."""
    return _filter(plots, radars, anchor, method.models, update, start, first, covariances, changes(method))


def radar_start(
    plots: RadarPlots,
    radars: Sequence[Polar],
    anchor: Enu,
    d: int,
    *,
    step: int = 0,
    axes: int = 3,
    speed_sd_mps: float = 300.0,
    height_m: float = 6000.0,
    height_sd_m: float = 4000.0,
) -> tuple[FloatArray, FloatArray]:
    """State (n, d) and covariance (n, d, d) at plot number `step`, at rest with so large a sd of each velocity.

    The height comes from the elevation, else from the plot's height, else it is `height_m` with `height_sd_m`.  A plot whose
    range is less than the difference of heights is straight above or below the radar.  Where range or azimuth is missing the
    start is NaN.  With 2 axes the target is in the anchor's plane.
    """
    source = radars[int(plots.radar[step])]
    value = np.array(plots.value[:, step])
    spread = np.array(np.broadcast_to(plots.covariance, (*plots.value.shape, 5))[:, step])
    n = len(value)
    if axes == 2:
        value[:, _ELEVATION], spread[:, 2, :3], spread[:, :3, 2] = 0.0, 0.0, 0.0
    low = np.isnan(value[:, _ELEVATION])
    guessed = low & np.isnan(value[:, _HEIGHT])
    value[guessed, _HEIGHT] = height_m
    spread[guessed, _HEIGHT, :], spread[guessed, :, _HEIGHT] = 0.0, 0.0
    spread[guessed, _HEIGHT, _HEIGHT] = height_sd_m**2
    rows = np.flatnonzero(low & np.isfinite(value[:, :2]).all(axis=1))
    if len(rows):
        _elevate(value, spread, rows, source)
    position, r = convert(value[:, :3], spread[:, :3, :3], source, anchor, method=Automatic(in_track=True))
    x, p = np.zeros((n, d)), np.zeros((n, d, d))
    x[:, :axes], p[:, :axes, :axes] = position[:, :axes], r[:, :axes, :axes]
    p[:, range(axes, 2 * axes), range(axes, 2 * axes)] = speed_sd_mps**2
    _accelerate(p, axes)
    return x, p


def _elevate(value: FloatArray, spread: FloatArray, rows: IntArray, source: Polar) -> None:
    """Fill elevation and its covariances of some rows from their height."""
    flat = float(np.abs(source.site).sum()) < _FLAT_M
    site, rotation = source.site, source.rotation
    r, a, h = (value[rows, i] for i in (_RANGE, _AZIMUTH, _HEIGHT))
    above = h - (site[2] if flat else geodetic_from_ecef(site)[2])
    if flat:
        elevation = np.arcsin(np.clip(above / np.maximum(r, _NEAR_M), -1, 1))
    else:
        found = polar_from_position(position_from_height(r, a, h, site, rotation), site, rotation)[:, 2]
        elevation = np.where(np.isfinite(found), found, np.copysign(np.pi / 2, above))
    polar = np.stack([r, a, elevation], axis=1)
    normal = rotate_back(rotation, np.tile([0.0, 0.0, 1.0], (len(r), 1)))
    if not flat:
        normal = height_and_up(position_from_polar(polar, site, rotation))[1]
    plumb = rotate(rotation, normal)
    out = np.stack([np.sin(a), np.cos(a), np.zeros_like(a)], axis=1)
    s, c = np.sin(elevation)[:, None], np.cos(elevation)[:, None]
    vertical_axis = np.array([0.0, 0.0, 1.0])
    along = (plumb * (c * out + s * vertical_axis)).sum(axis=1)
    arc = r * (plumb * (c * vertical_axis - s * out)).sum(axis=1)
    # Overhead the height tells next to nothing of the elevation.
    arc = np.maximum(arc, np.sqrt(spread[rows, _HEIGHT, _HEIGHT] + spread[rows, 0, 0]) / 2)
    turn = np.zeros((len(rows), 3, 5))
    turn[:, 0, _RANGE] = turn[:, 1, _AZIMUTH] = 1.0
    turn[:, 2, _RANGE], turn[:, 2, _HEIGHT] = -along / arc, 1 / arc
    value[rows, _ELEVATION] = elevation
    spread[rows, :3, :3] = turn @ spread[rows] @ np.swapaxes(turn, 1, 2)


def _refuse(what: str, remedy: str) -> SettingsError:
    return SettingsError(what, where="radar filter", remedy=remedy)


def _check(
    plots: RadarPlots, radars: Sequence[Polar], models: Sequence[Motion], x: FloatArray, p: FloatArray, first: int
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, int]:
    """Plots as contiguous arrays and the number of axes; raises SettingsError where they do not fit."""
    z = np.ascontiguousarray(plots.value, np.float64)
    n, steps, five = z.shape if z.ndim == 3 else (0, 0, 0)
    time_s = np.ascontiguousarray(plots.time_s, np.float64)
    radar = np.ascontiguousarray(plots.radar, np.int64)
    k = next((k for k in (2, 3) if x.ndim == 2 and x.shape[1] == size(models, k)), 0)
    shapes = np.shape(plots.covariance)
    if (
        five != 5 or shapes not in ((n, steps, 5, 5), (steps, 5, 5)) or time_s.shape != (steps,) or radar.shape != (steps,)
        or k == 0 or x.shape[0] != n or p.shape != (*x.shape, x.shape[1])
    ):  # fmt: skip
        raise _refuse(
            f"plots {z.shape}, covariances {shapes}, times {time_s.shape}, radars {radar.shape}, start {x.shape}, {p.shape} "
            "do not fit",
            f"Give (n, K, 5), (n, K, 5, 5), (K,), (K,), and with these models a state of {size(models, 2)} or {size(models, 3)}.",
        )
    if steps and not 0 <= int(radar.min()) <= int(radar.max()) < len(radars):
        raise _refuse(f"plots name radars {int(radar.min())} to {int(radar.max())}", f"There are {len(radars)}, from 0.")
    if any(np.shape(s.site) != (3,) for s in radars):
        raise _refuse("a radar has a site for each plot", "Give radars at one site each.")
    if not 0 <= first < max(steps, 1):
        raise _refuse(f"first = {first} is not among the {steps} plots", "Number the plots from 0.")
    if not np.isfinite(time_s).all():
        raise _refuse("a time is not a number", "Leave such plots out.")
    back = np.flatnonzero(np.diff(time_s) < 0)
    if len(back):
        raise _refuse(f"time goes backwards at plot {int(back[0]) + 1}", "Sort the plots by time.")
    r = np.ascontiguousarray(np.broadcast_to(plots.covariance, (n, steps, 5, 5)), np.float64)
    given = np.isfinite(z)
    if np.isinf(z).any():
        raise _refuse("a plot holds an infinite value", "Give NaN for what was not measured.")
    if k == 2 and given[..., [_ELEVATION, _HEIGHT]].any():
        raise _refuse("a state of two axes has no elevation and no height", "Leave them out, or give a state of three axes.")
    diagonal = np.diagonal(r, axis1=2, axis2=3)
    both = given[..., :, None] & given[..., None, :]
    with np.errstate(invalid="ignore"):
        limit = np.sqrt(diagonal[..., :, None] * diagonal[..., None, :])
        fine = (np.abs(r - np.swapaxes(r, 2, 3)) <= 1e-9 * limit) & (np.abs(r) <= (1 + 1e-9) * limit)
    fine &= (diagonal[..., :, None] > 0) & np.isfinite(limit)
    bad = (both & ~fine).any(axis=(2, 3))
    if bad.any():
        row, step = (int(v[0]) for v in np.nonzero(bad))
        raise _refuse(
            f"the covariance of plot {step} of target {row} is not symmetric with positive variances",
            "Give variances of what was measured, in metres, radians and metres a second, squared.",
        )
    check_start(x, p)
    return z, r, time_s, radar, k
