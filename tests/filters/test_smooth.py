"""Smoothing against the joint least squares of all measurements, and its covariance against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.errors import SettingsError
from boresight.filters import (
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    ExpectedMode,
    Imm,
    imm_filter,
    kalman_filter,
    matrices,
    one_point,
    smooth,
    smooth_models,
)


@pytest.mark.parametrize("model", [ConstantVelocity(noise=3.0), ConstantAcceleration(noise=0.02)])
def test_smoothed_states_are_the_joint_least_squares(model) -> None:
    """All states and measurements as one normal vector: its conditional mean and covariance are what the smoother must give."""
    rng = np.random.default_rng(1)
    time_s = np.array([0.0, 4.0, 4.0, 9.5, 14.0, 30.0])
    steps, axes = len(time_s), 2
    z = rng.normal(size=(1, steps, axes)) * 100 + time_s[:, None] * [50.0, -80.0]
    z[0, 3] = np.nan
    r = np.broadcast_to(np.diag([60.0, 40.0]) ** 2, (1, steps, axes, axes))
    d = axes * (2 if isinstance(model, ConstantVelocity) else 3)
    x0, p0 = one_point(z[:, 0], r[:, 0], d, 150.0)
    found = smooth(kalman_filter(z, r, time_s, model, (x0, p0)), model, axes)
    mean, cov = np.zeros(steps * d), np.zeros((steps * d, steps * d))
    mean[:d], cov[:d, :d] = x0[0], p0[0]
    for k in range(1, steps):
        f, q = matrices(model, time_s[k] - time_s[k - 1], axes)
        a, b = slice((k - 1) * d, k * d), slice(k * d, (k + 1) * d)
        mean[b] = f @ mean[a]
        cov[b, : k * d] = f @ cov[a, : k * d]
        cov[: k * d, b] = cov[b, : k * d].T
        cov[b, b] = f @ cov[a, a] @ f.T + q
    rows = [k * d + i for k in (1, 2, 4, 5) for i in range(axes)]
    seen = np.concatenate([z[0, k] for k in (1, 2, 4, 5)])
    s = cov[np.ix_(rows, rows)] + np.kron(np.eye(4), r[0, 0])
    gain = cov[:, rows] @ np.linalg.inv(s)
    expected, spread = mean + gain @ (seen - mean[rows]), cov - gain @ cov[rows]
    for k in range(steps):
        b = slice(k * d, (k + 1) * d)
        assert found.mean[0, k] == pytest.approx(expected[b], rel=1e-7, abs=1e-5)
        scale = np.sqrt(np.diag(spread[b, b]))
        assert np.abs((found.covariance[0, k] - spread[b, b]) / np.outer(scale, scale)).max() < 1e-5


def _turning(n: int, seed: int, axes: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Targets that fly straight, turn at 3 degrees a second for a while, and fly on: truth, z, r, time."""
    rng = np.random.default_rng(seed)
    steps, dt, sd = 60, 4.0, 60.0
    heading = rng.uniform(0, 2 * np.pi, n)
    rate = np.zeros((n, steps))
    begin, sense = rng.integers(15, 30, n), rng.choice([-1, 1], n)
    for i in range(n):
        rate[i, begin[i] : begin[i] + 12] = sense[i] * np.radians(3.0)
    x = np.zeros((n, 2 * axes))
    x[:, :2] = rng.normal(size=(n, 2)) * 2e4
    x[:, axes], x[:, axes + 1] = 180 * np.sin(heading), 180 * np.cos(heading)
    truth = np.empty((n, steps, 2 * axes))
    for k in range(steps):
        truth[:, k] = x
        for w in np.unique(rate[:, k]):
            f, _ = matrices(CoordinatedTurn(rate_deg_s=np.degrees(w)), dt, axes)
            rows = rate[:, k] == w
            x[rows] = x[rows] @ f.T
    z = truth[..., :axes] + rng.normal(size=(n, steps, axes)) * sd
    return truth, z, np.broadcast_to(np.eye(axes) * sd**2, (n, steps, axes, axes)), np.arange(steps) * dt


@pytest.mark.parametrize("method", [
    Imm(models=(ConstantVelocity(noise=0.1), *(CoordinatedTurn(rate_deg_s=w, noise=0.1) for w in (-3.0, 3.0)))),
    ExpectedMode(noise=0.1),
])  # fmt: skip
def test_smoothed_models_beat_the_filter_and_stay_honest(method) -> None:
    truth, z, r, time_s = _turning(150, 2)
    start = one_point(z[:, 0], r[:, 0], 4, 200.0)
    filtered = imm_filter(z, r, time_s, method, start)
    smoothed = smooth_models(z, r, time_s, method, start)

    def rms(mean: np.ndarray, part: slice) -> float:
        return float(np.sqrt(np.mean((mean - truth)[:, 5:-5, part] ** 2)))

    assert rms(smoothed.mean, slice(0, 2)) < 0.7 * rms(filtered.mean, slice(0, 2))
    assert rms(smoothed.mean, slice(2, 4)) < 0.6 * rms(filtered.mean, slice(2, 4))
    error = (smoothed.mean - truth)[:, 5:-5]
    nees = np.einsum("nki,nki->nk", error, np.linalg.solve(smoothed.covariance[:, 5:-5], error[..., None])[..., 0]).mean()
    assert 2.0 < nees < 6.5
    # At the last time there is nothing more to know.
    assert smoothed.mean[:, -1] == pytest.approx(filtered.mean[:, -1])
    assert smoothed.probability.sum(axis=2) == pytest.approx(np.ones((150, 60)))


def test_two_filters_that_meet_are_the_smoother_of_one_model() -> None:
    _, z, r, time_s = _turning(3, 4, axes=3)
    model = ConstantVelocity(noise=2.0)
    start = one_point(z[:, 0], r[:, 0], 6, 200.0)
    plain = smooth(kalman_filter(z, r, time_s, model, start), model, 3)
    # The backward filter knows next to nothing of the velocity, as the forward one at its start does.
    mixed = smooth_models(z, r, time_s, Imm(models=(model,)), start, speed_sd_mps=1e6)
    sd = np.sqrt(np.diagonal(plain.covariance, axis1=2, axis2=3))
    assert np.abs((mixed.mean - plain.mean) / sd).max() < 1e-3
    assert np.abs((mixed.covariance - plain.covariance) / (sd[..., None] * sd[..., None, :])).max() < 1e-3


def test_what_was_not_kept_cannot_be_smoothed() -> None:
    _, z, r, time_s = _turning(2, 5)
    start = one_point(z[:, 0], r[:, 0], 4, 200.0)
    with pytest.raises(SettingsError, match="no covariances"):
        smooth(kalman_filter(z, r, time_s, ConstantVelocity(), start, covariances=False), ConstantVelocity(), 2)
