"""Maximum likelihood against closed forms and truth; the transform matrix follows a picture that turns, and forgets."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.errors import NothingToDo, SettingsError
from boresight.registration.likelihood import KalmanTransform, MaximumLikelihood
from boresight.registration.rigid import Clouds

DEG = np.pi / 180
SD = np.array([64.0, 0.088 * DEG, 0.238 * DEG])
BIAS = np.array([30.0, 0.18 * DEG, -0.18 * DEG])


def differences(seed: int, tracks: int = 30, plots: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return BIAS + rng.normal(size=(tracks * plots, 3)) * SD, np.repeat(np.arange(tracks), plots)


def test_with_an_exact_reference_it_is_the_mean_and_the_sample_covariance() -> None:
    d, track = differences(1)
    found = MaximumLikelihood()(d, np.zeros((len(d), 3, 3)), track)
    np.testing.assert_allclose(found.value, d.mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(found.noise, np.cov(d.T, bias=True), rtol=1e-6, atol=1e-12)
    assert found.ended == "converged"
    assert found.inliers.all()
    from scipy.stats import multivariate_normal

    expected = multivariate_normal(d.mean(axis=0), np.cov(d.T, bias=True), allow_singular=True).logpdf(d).sum()
    assert found.log_likelihood == pytest.approx(expected, rel=1e-6)


def test_a_known_error_of_the_reference_is_not_the_radars_noise() -> None:
    d, track = differences(2, 60)
    rng = np.random.default_rng(2)
    poor = rng.random(len(d)) < 0.5
    size = np.where(poor[:, None], 3.0, 0.2) * SD
    reference = np.einsum("ni,ij->nij", size**2, np.eye(3))
    found = MaximumLikelihood(max_iterations=500)(d + rng.normal(size=d.shape) * size, reference, track)
    np.testing.assert_allclose(np.sqrt(np.diag(found.noise)), SD, rtol=0.08)
    assert np.abs((found.value - BIAS) / np.sqrt(np.diag(found.covariance))).max() < 4


def test_errors_shared_within_a_track_widen_the_covariance_and_outliers_take_no_part() -> None:
    nees = []
    for seed in range(40):
        d, track = differences(seed)
        rng = np.random.default_rng([seed, 1])
        d += (rng.normal(size=(30, 3)) * SD * 0.3)[track]
        bad = rng.random(len(d)) < 0.05
        d[bad, 0] += rng.uniform(3e3, 9e3, bad.sum())
        found = MaximumLikelihood()(d, np.zeros((len(d), 3, 3)), track)
        assert not (found.inliers & bad).any()
        off = found.value - BIAS
        nees.append(off @ np.linalg.solve(found.covariance, off) / 3)
    assert 0.7 < np.mean(nees) < 1.5


def test_what_was_not_measured_is_absent() -> None:
    d, track = differences(3)
    d[:, 2] = np.nan
    d[5, 0] = np.nan
    found = MaximumLikelihood()(d, np.zeros((len(d), 3, 3)), track)
    assert np.isnan(found.value[2])
    assert np.isnan(found.covariance[2]).all()
    assert np.isfinite(found.covariance[:2, :2]).all()
    assert not found.inliers[5]
    with pytest.raises(NothingToDo, match="too few"):
        MaximumLikelihood()(d[:3], np.zeros((3, 3, 3)), track[:3])
    with pytest.raises(SettingsError, match="gate_sd"):
        MaximumLikelihood(gate_sd=0.0)(d, np.zeros((len(d), 3, 3)), track)


def turning(rng: np.random.Generator, n: int = 8000) -> tuple[Clouds, np.ndarray]:
    """A picture whose shift changes half way through 800 s; one plot in fifty is far off."""
    t = np.sort(rng.uniform(0, 800, n))
    truth = np.stack([*rng.uniform(-80e3, 80e3, (2, n)), rng.uniform(3e3, 11e3, n)], axis=1)
    turned = truth @ (np.eye(3) + 0.25 * DEG * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]]))
    seen = turned + np.where(t[:, None] < 400, [200.0, 200, 400], [-100.0, 0, 100]) + rng.normal(size=(n, 3)) * 60
    bad = rng.random(n) < 0.02
    seen[bad, 0] += 20e3
    return Clouds(seen, truth, bad.astype(int)), t


def test_the_transform_follows_the_picture() -> None:
    clouds, t = turning(np.random.default_rng(4))
    found = KalmanTransform(sd_m=60.0)(clouds, t)
    good = clouds.track == 0
    assert not (found.inliers & ~good).any()
    assert found.inliers.sum() > 0.99 * good.sum()
    left = found(clouds.measured, t) - clouds.reference
    for part in ((t > 100) & (t < 400), t > 650):
        rows = part & good
        assert np.abs(left[rows].mean(axis=0)).max() < 6.0
        np.testing.assert_allclose(left[rows].std(axis=0), 60.0, rtol=0.08)
    before = clouds.measured[:3]
    np.testing.assert_array_equal(found(before, np.full(3, -1.0)), before)
    np.testing.assert_array_equal(found(before, np.full(3, t[-1])), found(before, np.full(3, 1e9)))


def test_with_a_long_memory_it_is_weighted_least_squares() -> None:
    rng = np.random.default_rng(5)
    clouds, t = turning(rng, 400)
    good = clouds.track == 0
    clouds, t = clouds.take(good), t[good]
    method = KalmanTransform(memory_s=1e12, prior_sd_m=1e6, gate_sd=1e6)
    found = method(clouds, t)
    design = np.concatenate([clouds.measured / 50e3, np.ones((len(t), 1))], axis=1)
    expected, *_ = np.linalg.lstsq(design, clouds.reference - clouds.measured, rcond=None)
    np.testing.assert_allclose(found.value[-1].T, expected, rtol=1e-4, atol=0.01)
    np.testing.assert_allclose(found.covariance[-1], method.sd_m**2 * np.linalg.inv(design.T @ design), rtol=1e-4)


def test_settings_and_empty_input_are_refused() -> None:
    clouds = Clouds(np.full((2, 3), np.nan), np.zeros((2, 3)), np.zeros(2, int))
    with pytest.raises(NothingToDo, match="no pair"):
        KalmanTransform()(clouds, np.zeros(2))
    with pytest.raises(SettingsError, match="memory_s"):
        KalmanTransform(memory_s=0.0)(clouds, np.zeros(2))
