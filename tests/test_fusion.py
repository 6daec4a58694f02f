"""Track fusion: closed forms, what the covariance promises, and what correlated errors do to it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from boresight.errors import SettingsError
from boresight.fusion import (
    BarShalomCampo,
    CovarianceIntersection,
    DiagonalWeighted,
    Equal,
    FullWeighted,
    TraceWeighted,
    cross_covariance_step,
)

METHODS = (Equal(), TraceWeighted(), DiagonalWeighted(), FullWeighted(), CovarianceIntersection())


def _spreads(rng: np.random.Generator, s: int, d: int) -> np.ndarray:
    root = rng.normal(size=(s, d, d)) * np.geomspace(1, 50, d)[:, None]
    return root @ np.swapaxes(root, 1, 2) + np.eye(d)


def _draw(rng: np.random.Generator, spreads: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (s, n, d) of independent sources with these covariances (s, d, d), and the covariances for each state."""
    mean = np.stack([rng.multivariate_normal(np.zeros(len(p)), p, n, method="cholesky") for p in spreads])
    return mean, np.broadcast_to(spreads[:, None], (*mean.shape, mean.shape[2]))


@pytest.mark.parametrize("method", METHODS[:4], ids=lambda m: type(m).__name__)
def test_covariance_is_that_of_the_fused_errors(method) -> None:
    """Independent errors: over 40,000 draws the fused errors have the covariance that is said, and no bias."""
    rng = np.random.default_rng(1)
    mean, covariance = _draw(rng, _spreads(rng, 3, 4), 40_000)
    fused, spread = method(mean, covariance)
    sd = np.sqrt(np.diag(spread[0]))
    assert np.abs(np.cov(fused.T) - spread[0]).max() < 0.04 * np.outer(sd, sd).max()
    assert np.abs(fused.mean(axis=0) / sd).max() < 4 / np.sqrt(40_000)


def test_full_weights_are_the_least_squares_of_all() -> None:
    rng = np.random.default_rng(2)
    spreads = _spreads(rng, 3, 3)
    mean, covariance = _draw(rng, spreads, 5)
    fused, spread = FullWeighted()(mean, covariance)
    design = np.tile(np.eye(3), (3, 1))
    weight = np.zeros((9, 9))
    for k in range(3):
        weight[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = np.linalg.inv(spreads[k])
    normal = design.T @ weight @ design
    for row in range(5):
        assert fused[row] == pytest.approx(np.linalg.solve(normal, design.T @ weight @ mean[:, row].ravel()), rel=1e-9)
    assert spread[0] == pytest.approx(np.linalg.inv(normal), rel=1e-9)
    # No other method says that it knows more.
    for method in METHODS:
        assert np.trace(method(mean, covariance)[1][0]) >= np.trace(spread[0]) * (1 - 1e-9)


def test_equal_sources_are_equal_for_every_method_but_intersection() -> None:
    """s equal independent sources: the mean, and a covariance of 1 / s; intersection must not claim it."""
    p = np.diag([4.0, 9.0, 25.0])
    mean, covariance = _draw(np.random.default_rng(3), np.stack([p] * 4), 3)
    for method in METHODS[:4]:
        fused, spread = method(mean, covariance)
        assert fused == pytest.approx(mean.mean(axis=0))
        assert spread[0] == pytest.approx(p / 4)
    assert CovarianceIntersection()(mean, covariance)[1][0] == pytest.approx(p, rel=1e-6)


def test_intersection_takes_the_best_weight() -> None:
    """Two sources: the trace of the fused covariance is the least over all weights (a bounded search as the judge)."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        spreads = _spreads(rng, 2, 3)
        mean, covariance = _draw(rng, spreads, 1)
        a, b = (np.linalg.inv(p) for p in spreads)
        best = minimize_scalar(
            lambda w, a=a, b=b: np.trace(np.linalg.inv(w * a + (1 - w) * b)),
            bounds=(0, 1),
            method="bounded",
            options={"xatol": 1e-10},
        )
        assert np.trace(CovarianceIntersection()(mean, covariance)[1][0]) == pytest.approx(best.fun, rel=1e-6)


def test_intersection_holds_whatever_the_sources_share() -> None:
    """Sources whose errors are half the same: full weights claim too much (NEES beyond d), intersection never does."""
    rng = np.random.default_rng(5)
    n, d = 20_000, 3
    common = rng.normal(size=(n, d)) * [30, 20, 10]
    own = [rng.normal(size=(n, d)) * s for s in ([20, 40, 10], [40, 20, 10])]
    mean = np.stack([common + o for o in own])
    spreads = np.stack([np.diag(np.square([30.0, 20, 10]) + np.square(s)) for s in ([20.0, 40, 10], [40.0, 20, 10])])
    covariance = np.broadcast_to(spreads[:, None], (2, n, d, d))

    def nees(fused: np.ndarray, spread: np.ndarray) -> float:
        return float(np.mean(np.einsum("ni,ni->n", fused, np.linalg.solve(spread, fused[:, :, None])[:, :, 0])))

    assert nees(*FullWeighted()(mean, covariance)) > 1.2 * d
    assert nees(*CovarianceIntersection()(mean, covariance)) < d
    cross = np.broadcast_to(np.diag(np.square([30.0, 20, 10])), (n, d, d))
    assert nees(*BarShalomCampo()(mean, covariance, cross)) == pytest.approx(d, rel=0.03)


def test_two_filters_of_one_target_with_their_cross_covariance() -> None:
    """Bar-Shalom & Campo: two filters of one manoeuvring target; with the recursion the NEES is d, without it too large."""
    rng = np.random.default_rng(6)
    n, steps, dt, q, sd = 4000, 40, 4.0, 20.0, (60.0, 90.0)
    f = np.array([[1, dt], [0, 1]])
    noise = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    h = np.array([[1.0, 0.0]])
    x = np.zeros((n, 2))
    est, p = np.zeros((2, n, 2)), np.stack([np.diag([s**2, 100.0**2]) for s in sd])
    x = x + rng.normal(size=(n, 2)) * [0.0, 100.0]
    est[:, :, 0] = x[:, 0] + rng.normal(size=(2, n)) * np.array(sd)[:, None]
    cross = np.diag([0.0, 100.0**2])[None]  # both start at rest: the velocity is the same error
    for _ in range(steps):
        x = x @ f.T + rng.multivariate_normal([0, 0], noise, n, method="cholesky")
        gains = []
        for k in range(2):
            est[k] = est[k] @ f.T
            ahead = f @ p[k] @ f.T + noise
            gain = ahead @ h.T / (ahead[0, 0] + sd[k] ** 2)
            z = x[:, 0] + rng.normal(size=n) * sd[k]
            est[k] += (z - est[k][:, 0])[:, None] * gain.T
            p[k] = ahead - gain @ h @ ahead
            gains.append(gain)
        cross = cross_covariance_step(cross, f, noise, gains[0], gains[1], h)
    covariance = np.broadcast_to(p[:, None], (2, n, 2, 2))
    for method, arguments, low, high in (
        (BarShalomCampo(), (np.broadcast_to(cross, (n, 2, 2)),), 1.93, 2.07),
        (FullWeighted(), (), 2.2, 4.0),
    ):
        fused, spread = method(est, covariance, *arguments)
        error = fused - x
        nees = np.mean(np.einsum("ni,ni->n", error, np.linalg.solve(spread, error[:, :, None])[:, :, 0]))
        assert low < nees < high


def test_wrong_axes_spoil_full_weights() -> None:
    """METHODS section 1: exchanged axes leave trace weights alone, and make full weights worse than the plain mean."""
    rng = np.random.default_rng(7)
    spreads = np.stack([np.diag([10.0, 400, 50]), np.diag([400.0, 10, 50])]) ** 2
    mean, covariance = _draw(rng, spreads, 5000)
    swapped = covariance[:, :, [1, 0, 2]][:, :, :, [1, 0, 2]]

    def rms(method, c) -> float:
        return float(np.sqrt(np.mean(method(mean, c)[0] ** 2)))

    assert rms(TraceWeighted(), swapped) == pytest.approx(rms(TraceWeighted(), covariance))
    assert rms(FullWeighted(), covariance) < 0.3 * rms(Equal(), covariance)
    assert rms(FullWeighted(), swapped) > rms(Equal(), covariance)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(SettingsError, match="do not fit"):
        FullWeighted()(np.zeros((2, 3, 3)), np.zeros((2, 3, 2, 2)))
    with pytest.raises(SettingsError, match="3 sources"):
        BarShalomCampo()(np.zeros((3, 1, 2)), np.ones((3, 1, 2, 2)), np.zeros((1, 2, 2)))
