"""Distributions with a known answer: normal, Student t, mixtures, quantised, constant; independent libraries as judges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from boresight.assessment.distribution import distribution, mixture_fit, quantisation_step, student_fit
from boresight.errors import NothingToDo, SettingsError


def test_moments_and_tests_are_those_of_an_independent_library() -> None:
    x = np.random.default_rng(1).gamma(4.0, 2.0, 800)
    found = distribution(x, most=2)
    assert found.skew == pytest.approx(stats.skew(x))
    assert found.kurtosis == pytest.approx(stats.kurtosis(x))
    assert found.jarque_bera == pytest.approx(stats.jarque_bera(x).pvalue)
    assert found.shapiro == pytest.approx(stats.shapiro(x).pvalue)
    w = np.sort((x - x.mean()) / x.std(ddof=1))
    i = np.arange(1, 801)
    expected = -800 - np.sum((2 * i - 1) / 800 * (stats.norm.logcdf(w) + stats.norm.logsf(w[::-1])))
    assert found.anderson == pytest.approx(expected, rel=1e-9)
    assert found.anderson > found.anderson_5_percent


def test_normal_errors_are_called_normal_and_one_part_wins() -> None:
    rng = np.random.default_rng(2)
    best, rejected = [], 0
    for _ in range(20):
        found = distribution(rng.normal(3.0, 2.0, 1000), most=3)
        best.append(found.best)
        rejected += found.anderson > found.anderson_5_percent
        assert len(found.mixture.share) == 1
    assert best.count("normal") >= 19
    assert rejected <= 4


def test_heavy_tails_are_student_t() -> None:
    x = 5.0 + 2.0 * np.random.default_rng(3).standard_t(4, 6000)
    found = distribution(x, most=2)
    assert found.student.freedom == pytest.approx(4.0, rel=0.2)
    assert found.student.scale == pytest.approx(2.0, rel=0.05)
    assert found.student.location == pytest.approx(5.0, abs=0.1)
    assert found.student.bic < found.normal_bic
    freedom, location, scale = stats.t.fit(x)
    ours = stats.t.logpdf(x, found.student.freedom, found.student.location, found.student.scale).sum()
    assert ours >= stats.t.logpdf(x, freedom, location, scale).sum() - 0.1


def test_a_mixture_is_found_with_its_parts() -> None:
    rng = np.random.default_rng(4)
    x = np.concatenate([rng.normal(0, 1, 3000), rng.normal(6, 2, 1000)])
    found = distribution(x)
    assert found.best == "mixture of 2"
    np.testing.assert_allclose(found.mixture.share, (0.75, 0.25), atol=0.02)
    np.testing.assert_allclose(found.mixture.mean, (0, 6), atol=0.25)
    np.testing.assert_allclose(found.mixture.sd, (1, 2), atol=0.2)
    grid = np.linspace(-10, 20, 6001)
    assert found.mixture.density(grid).sum() * (grid[1] - grid[0]) == pytest.approx(1.0, abs=1e-6)
    wide = np.concatenate([rng.normal(0, 1, 3000), rng.normal(0, 8, 150)])
    assert len(distribution(wide, most=3).mixture.share) == 2


@pytest.mark.parametrize("step", [18.52, 0.01, 1 / 128])
def test_the_step_of_quantisation_is_found(step: float) -> None:
    rng = np.random.default_rng(5)
    exact = rng.normal(0, 20 * step, 3000)
    found = distribution(np.round(exact / step) * step + 0.3 * step, most=1)
    assert found.step == pytest.approx(step, rel=1e-6)
    assert found.step_sd == pytest.approx(step / np.sqrt(12))
    assert quantisation_step(exact) == 0.0
    assert 18.52 / np.sqrt(12) == pytest.approx(5.35, abs=0.005)


def test_equal_and_few_values_have_a_defined_result() -> None:
    found = distribution(np.full(50, 7.0))
    assert (found.mean, found.sd, found.skew, found.kurtosis, found.best) == (7.0, 0.0, 0.0, 0.0, "normal")
    with pytest.raises(NothingToDo, match="3 values"):
        distribution(np.array([1.0, 2.0, 3.0, np.nan]))
    two = distribution(np.array([0.0, 1.0] * 20))
    assert len(two.mixtures) == 2
    assert np.isfinite([two.kurtosis, two.student.freedom, two.mixture.bic]).all()
    with pytest.raises(SettingsError, match="mixture of 9"):
        mixture_fit(np.arange(8.0), 9, np.random.default_rng(1))
    with pytest.raises(SettingsError, match="most"):
        distribution(np.arange(20.0), most=0)


def test_the_same_values_give_the_same_fit_in_any_unit() -> None:
    x = np.random.default_rng(6).standard_t(3, 500)
    a, b = student_fit(x), student_fit(1000 * x + 5)
    assert b.scale == pytest.approx(1000 * a.scale, rel=1e-4)
    assert b.freedom == pytest.approx(a.freedom, rel=1e-3)
