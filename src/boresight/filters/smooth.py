"""Smoothing: what all measurements together say of each time.

Sources: Rauch, Tung & Striebel 1965 (one model); Blom & Bar-Shalom 1990 and Helmick, Blair & Hoffman 1995 (interacting models:
two filters that meet, fused by pairs of models).
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from .._jit import kernel
from .._types import BoolArray, FloatArray
from ..errors import SettingsError
from .imm import ExpectedMode, Imm, Mixed, imm_filter
from .kalman import Filtered, one_point
from .motion import CoordinatedTurn, Motion, fill, table, vertical


class Smoothed(NamedTuple):
    """States at each time given all measurements: `mean` (n, K, d), `covariance` (n, K, d, d), `probability` (n, K, M) of the
    models."""

    time_s: FloatArray
    mean: FloatArray
    covariance: FloatArray
    probability: FloatArray


@kernel
def _matrices(
    models: FloatArray,
    x: FloatArray,
    dt: float,
    like: tuple[int, ...],
    axes: tuple[int, ...],
    transition: FloatArray,
    noise: FloatArray,
) -> None:
    """Fill transition and noise (n, d, d) of the model of each row (n, 4) at the state of each row (n, d)."""
    up = np.zeros(3)
    up[2] = 1.0
    for row in range(x.shape[0]):
        if len(axes) == 3:
            vertical(x, row, up)
        fill(models, row, dt, up, transition, noise, like, axes)


def _steps(models: FloatArray, x: FloatArray, dt: float, axes: int) -> tuple[FloatArray, FloatArray]:
    d = x.shape[1]
    transition, noise = np.zeros((len(x), d, d)), np.zeros((len(x), d, d))
    _matrices(np.ascontiguousarray(models), np.ascontiguousarray(x), dt, (0,) * d, (0,) * axes, transition, noise)
    return transition, noise


def _back(
    x: FloatArray, p: FloatArray, after: FloatArray, spread: FloatArray, transition: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One step back (n, d), (n, d, d): from the filter's state here and the smoothed one after it."""
    flipped = np.swapaxes(transition, 1, 2)
    ahead = transition @ p @ flipped + noise
    # In units of each coordinate's sd: positions and accelerations differ by many orders.
    size = np.sqrt(np.maximum(np.diagonal(ahead, axis1=1, axis2=2), 1e-300))
    scaled = ahead / size[:, :, None] / size[:, None, :] + 1e-14 * np.eye(x.shape[1])
    gain = np.swapaxes(np.linalg.solve(scaled, transition @ p / size[:, :, None]), 1, 2) / size[:, None, :]
    mean = x + (gain @ (after - (transition @ x[:, :, None])[:, :, 0])[:, :, None])[:, :, 0]
    out = p + gain @ (spread - ahead) @ np.swapaxes(gain, 1, 2)
    return mean, (out + np.swapaxes(out, 1, 2)) / 2


def smooth(filtered: Filtered, motion: Motion, axes: int) -> Smoothed:
    """The filter's result run backwards with its motion model (Rauch, Tung & Striebel); `axes` is 2 or 3 as in the filter.

    Raises SettingsError where the filter kept no covariances.
    """
    if not len(filtered.covariance) and len(filtered.mean):
        raise SettingsError("the filter kept no covariances", where="smooth", remedy="Filter with covariances=True.")
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    n, steps, _ = mean.shape
    models = np.repeat(table([motion]), n, axis=0)
    first = int(np.argmax(np.isfinite(mean[0, :, 0]))) if n and steps else 0
    for k in range(steps - 2, first - 1, -1):
        transition, noise = _steps(models, filtered.mean[:, k], filtered.time_s[k + 1] - filtered.time_s[k], axes)
        mean[:, k], covariance[:, k] = _back(
            filtered.mean[:, k], filtered.covariance[:, k], mean[:, k + 1], covariance[:, k + 1], transition, noise
        )
    return Smoothed(filtered.time_s, mean, covariance, np.ones((n, steps, 1)))


def smooth_models(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    method: Imm | ExpectedMode,
    start: tuple[FloatArray, FloatArray],
    *,
    first: int = 0,
    speed_sd_mps: float = 500.0,
) -> Smoothed:
    """Interacting models over positions, forwards and backwards in time, and both fused pair by pair of their models.

    Arguments as for `imm.imm_filter`.  The backward filter starts at the last position with velocities of `speed_sd_mps`.  A pair
    weighs by its models' probabilities and by how well the two states agree, which a smoother that only runs over the filter's
    result cannot know.  `probability` is of the forward filter's models.
    """
    filtered = imm_filter(z, r, time_s, method, start, first=first, keep=True)
    kept = filtered.kept
    assert kept is not None
    n, steps, count, d = kept.mean.shape
    axes = z.shape[2]
    time_s = filtered.time_s
    mean, covariance = np.full((n, steps, d), np.nan), np.full((n, steps, d, d), np.nan)
    probability = np.full((n, steps, count), np.nan)
    out = Smoothed(time_s, mean, covariance, probability)
    if not n:
        return out
    mean[:, -1], covariance[:, -1], probability[:, -1] = (
        filtered.mean[:, -1],
        filtered.covariance[:, -1],
        filtered.probability[:, -1],
    )
    last = int(np.flatnonzero(np.isfinite(z).all(axis=2).any(axis=0))[-1]) if np.isfinite(z).all(axis=2).any() else first
    back = _backwards(z[:, first : last + 1], r[:, first : last + 1], time_s[first : last + 1], method, d, speed_sd_mps)
    flip = np.where((np.arange(d) >= axes) & (np.arange(d) < 2 * axes), -1.0, 1.0)
    for k in range(steps - 2, first - 1, -1):
        if k >= last:
            # No measurement comes after: the filter has said all there is.
            mean[:, k], covariance[:, k] = filtered.mean[:, k], filtered.covariance[:, k]
            probability[:, k] = filtered.probability[:, k]
            continue
        x, p, mu = _ahead(back, last - k, axes)
        x, p = x * flip, p * flip[:, None] * flip
        change = kept.change[k + 1] if isinstance(method, Imm) else np.ones((count, count))
        _fuse(kept.mean[:, k], kept.covariance[:, k], kept.probability[:, k], x, p, mu, change, out, k)
    return out


def _backwards(
    z: FloatArray, r: FloatArray, time_s: FloatArray, method: Imm | ExpectedMode, d: int, speed_sd_mps: float
) -> Mixed:
    """The filter run from the last measurement to the first: velocities and turns change sign, times too."""
    if isinstance(method, Imm):
        turned = tuple(
            msgspec.structs.replace(m, rate_deg_s=-m.rate_deg_s) if isinstance(m, CoordinatedTurn) else m for m in method.models
        )
        change, even = None, None
        if method.transition is not None:
            given = np.array(method.transition)
            value, vectors = np.linalg.eig(given.T)
            stay = np.abs(np.real(vectors[:, np.argmin(np.abs(value - 1))]))
            stay /= stay.sum()
            reverse = given.T * stay / np.maximum(stay[:, None], 1e-300)
            change, even = tuple(map(tuple, (reverse / reverse.sum(axis=1, keepdims=True)).tolist())), tuple(stay.tolist())
        reversed_method: Imm | ExpectedMode = msgspec.structs.replace(method, models=turned, transition=change, start=even)
    else:
        reversed_method = msgspec.structs.replace(method, rates_deg_s=tuple(-w for w in reversed(method.rates_deg_s)))
    # Targets whose last position is missing start there all the same, knowing nothing of it.
    known: BoolArray = np.asarray(np.isfinite(z[:, -1]).all(axis=1))
    k = z.shape[2]
    begin = np.where(known[:, None], z[:, -1], np.nan_to_num(_last_known(z)))
    spread = np.where(known[:, None, None], r[:, -1], np.eye(k) * 1e10)
    x, p = one_point(begin, spread, d, speed_sd_mps)
    return imm_filter(z[:, ::-1], r[:, ::-1], -time_s[::-1], reversed_method, (x, p), covariances=False, keep=True)


def _last_known(z: FloatArray) -> FloatArray:
    """The last position (n, k) of each target; NaN where there is none."""
    given: BoolArray = np.asarray(np.isfinite(z).all(axis=2))
    row = z.shape[1] - 1 - np.argmax(given[:, ::-1], axis=1)
    return np.asarray(z[np.arange(len(z)), row])


def _ahead(filtered: Mixed, step: int, axes: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What the filter's models foresee at `step` (n, M, d), (n, M, d, d), and their probabilities (n, M), before measuring."""
    kept = filtered.kept
    assert kept is not None
    change, weight = kept.change[step], kept.probability[:, step - 1]
    dt = filtered.time_s[step] - filtered.time_s[step - 1]
    mu = weight @ change
    x, p = np.empty_like(kept.mean[:, step]), np.empty_like(kept.covariance[:, step])
    for i in range(x.shape[1]):
        share = weight * change[:, i] / np.maximum(mu[:, i], 1e-300)[:, None]
        mixed, spread = _merge(kept.mean[:, step - 1], kept.covariance[:, step - 1], share)
        transition, noise = _steps(kept.models[:, step, i], mixed, dt, axes)
        x[:, i] = (transition @ mixed[:, :, None])[:, :, 0]
        p[:, i] = transition @ spread @ np.swapaxes(transition, 1, 2) + noise
    return x, p, mu


def _fuse(
    x: FloatArray,
    p: FloatArray,
    mu: FloatArray,
    other: FloatArray,
    its: FloatArray,
    chance: FloatArray,
    change: FloatArray,
    out: Smoothed,
    k: int,
) -> None:
    """Fill time k of `out` from the forward models (n, M, …) and the backward ones (n, M, …), independent of each other."""
    n, count, d = x.shape
    log_weight = np.empty((n, count, count))
    means, spreads = np.empty((n, count, count, d)), np.empty((n, count, count, d, d))
    for j in range(count):
        for i in range(count):
            total = p[:, j] + its[:, i]
            size = np.sqrt(np.diagonal(total, axis1=1, axis2=2))
            scaled = total / size[:, :, None] / size[:, None, :]
            off = (other[:, i] - x[:, j]) / size
            # The gain of the forward state towards the backward one: P (P + P')^-1.
            right = np.concatenate([np.swapaxes(p[:, j], 1, 2) / size[:, :, None], off[:, :, None]], axis=2)
            solved = np.linalg.solve(scaled, right)
            gain = np.swapaxes(solved[:, :, :d], 1, 2)
            means[:, j, i] = x[:, j] + (gain @ off[:, :, None])[:, :, 0]
            joint = p[:, j] - gain @ (p[:, j] / size[:, :, None])
            spreads[:, j, i] = (joint + np.swapaxes(joint, 1, 2)) / 2
            distance = np.einsum("nd,nd->n", off, solved[:, :, d])
            log_size = np.linalg.slogdet(scaled)[1] + 2 * np.log(size).sum(axis=1)
            with np.errstate(divide="ignore"):
                log_weight[:, j, i] = np.log(mu[:, j] * change[j, i] * chance[:, i]) - 0.5 * (distance + log_size)
    weight = np.exp(log_weight - log_weight.max(axis=(1, 2), keepdims=True))
    weight /= weight.sum(axis=(1, 2), keepdims=True)
    flat = count * count
    out.mean[:, k], out.covariance[:, k] = _merge(
        means.reshape(n, flat, d), spreads.reshape(n, flat, d, d), weight.reshape(n, flat)
    )
    out.probability[:, k] = weight.sum(axis=2)


def _merge(x: FloatArray, p: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, d) and covariance (n, d, d) of mixtures of m parts (n, m, d), (n, m, d, d) with weights (n, m)."""
    mean = np.einsum("nm,nmd->nd", weight, x)
    off = x - mean[:, None]
    spread = np.einsum("nm,nmab->nab", weight, p) + np.einsum("nm,nma,nmb->nab", weight, off, off)
    return mean, (spread + np.swapaxes(spread, 1, 2)) / 2
