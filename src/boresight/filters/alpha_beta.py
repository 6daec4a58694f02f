"""The alpha-beta filter: position and velocity with two fixed gains, the cheapest tracker there is."""

from __future__ import annotations

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray
from ..errors import SettingsError


class AlphaBeta(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="alpha-beta"):
    """Fixed gains: `alpha` of the position, `beta` of the velocity (over the time since the last measurement)."""

    alpha: float = 0.5
    beta: float = 0.1

    @classmethod
    def steady(cls, acceleration_sd_mps2: float, dt_s: float, position_sd_m: float) -> AlphaBeta:
        """The gains of the steady-state Kalman filter for piecewise constant white acceleration (Kalata 1984)."""
        index = acceleration_sd_mps2 * dt_s**2 / position_sd_m
        r = (4 + index - np.sqrt(8 * index + index**2)) / 4
        alpha = 1 - r * r
        return cls(alpha=float(alpha), beta=float(2 * (2 - alpha) - 4 * np.sqrt(1 - alpha)))


def alpha_beta_filter(z: FloatArray, time_s: FloatArray, gains: AlphaBeta, velocity: FloatArray | None = None) -> FloatArray:
    """States (n, K, 2 k), position and velocity, after each of the positions `z` (n, K, k) at `time_s` (K,).

    Starts at each target's first position with `velocity` (n, k), else at rest; before it states are NaN.  NaN positions are
    times without a measurement, which count towards the time since the last one.  Raises SettingsError for gains that do not
    settle (0 < alpha <= 1, 0 <= beta, 2 alpha + beta < 4) and times that go backwards.
    """
    z, time_s = np.asarray(z, np.float64), np.asarray(time_s, np.float64)
    if not (0 < gains.alpha <= 1 and gains.beta >= 0 and 2 * gains.alpha + gains.beta < 4):
        raise SettingsError(
            f"alpha = {gains.alpha}, beta = {gains.beta} do not settle",
            where="alpha-beta",
            remedy="Give 0 < alpha <= 1 and 0 <= beta < 4 - 2 alpha.",
        )
    if z.ndim != 3 or time_s.shape != z.shape[1:2] or not np.isfinite(time_s).all() or (np.diff(time_s) < 0).any():
        raise SettingsError(
            f"positions {z.shape} and times {time_s.shape} do not fit, or time goes backwards",
            where="alpha-beta",
            remedy="Give (n, K, k) and (K,), sorted by time.",
        )
    n, steps, k = z.shape
    out = np.empty((n, steps, 2 * k))
    position, speed = np.full((n, k), np.nan), np.zeros((n, k)) if velocity is None else np.array(velocity, np.float64)
    last = np.full(n, np.nan)
    for step in range(steps):
        given: BoolArray = np.asarray(np.isfinite(z[:, step]).all(axis=1))
        if step:
            position = position + (time_s[step] - time_s[step - 1]) * speed
        begins = given & np.isnan(last)
        position[begins] = z[begins, step]
        off = np.where(given[:, None], z[:, step] - position, 0.0)
        position = position + gains.alpha * off
        since = (time_s[step] - last)[:, None]
        speed = speed + np.where(since > 0, gains.beta / np.where(since > 0, since, 1.0), 0.0) * off
        last[given] = time_s[step]
        out[:, step, :k] = position
        out[:, step, k:] = np.where(np.isnan(position), np.nan, speed)
    return out


def alpha_beta_covariance(variance: FloatArray, time_s: FloatArray, gains: AlphaBeta) -> FloatArray:
    """What noise does to the states of `alpha_beta_filter`: covariances (n, K, 2, 2) of one position and its rate.

    `variance` (n, K) is that of each position, NaN where there is none.  The rate that the filter starts with counts as known,
    and what changes faster than the gains follow is not in it.  At even steps the position's settles at Kalata's
    sigma^2 (2 alpha^2 + beta (2 - 3 alpha)) / (alpha (4 - 2 alpha - beta)).
    """
    variance, time_s = np.asarray(variance, np.float64), np.asarray(time_s, np.float64)
    n, steps = variance.shape
    out = np.full((n, steps, 2, 2), np.nan)
    p, last = np.full((n, 2, 2), np.nan), np.full(n, np.nan)
    for step in range(steps):
        given: BoolArray = np.isfinite(variance[:, step])
        if step:
            forward = np.array([[1.0, time_s[step] - time_s[step - 1]], [0.0, 1.0]])
            p = forward @ p @ forward.T
        begins = given & np.isnan(last)
        p[begins] = 0.0
        p[begins, 0, 0] = variance[begins, step]
        goes_on = given & ~begins
        since = time_s[step] - last[goes_on]
        gain = np.stack(
            [np.full(len(since), gains.alpha), np.where(since > 0, gains.beta / np.where(since > 0, since, 1.0), 0.0)]
        )
        left = np.eye(2) - gain.T[:, :, None] * np.array([1.0, 0.0])
        noise = gain.T[:, :, None] * gain.T[:, None] * variance[goes_on, step][:, None, None]
        p[goes_on] = left @ p[goes_on] @ np.swapaxes(left, 1, 2) + noise
        last[given] = time_s[step]
        out[:, step] = p
    return out
