"""Distributions with a known answer: normal, Student t, mixtures, quantised, constant; independent libraries as judges."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from boresight.assessment.distribution import (
    distribution,
    memory,
    mixture_fit,
    quantisation_step,
    shape_words,
    step_words,
    student_fit,
    verdict,
)
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


def alike(rng: np.random.Generator, targets: int, plots: int, last: float, own: float) -> tuple[np.ndarray, np.ndarray]:
    """Normal errors of unit variance: a share `own` is each target's, the rest is correlated by `last` from plot to plot."""
    x = rng.normal(size=(targets, plots))
    for k in range(1, plots):
        x[:, k] = last * x[:, k - 1] + np.sqrt(1 - last**2) * x[:, k]
    x = np.sqrt(1 - own) * x + np.sqrt(own) * rng.normal(size=(targets, 1))
    return x.ravel(), np.repeat(np.arange(targets), plots)


SCENES = ((40, 80, 0.9, 0.0), (40, 80, 0.0, 0.5), (30, 100, 0.8, 0.3), (5, 400, 0.95, 0.2))


@pytest.mark.parametrize("scene", SCENES)
def test_errors_are_worth_as_many_as_tell_the_mean_so_well(scene: tuple[int, int, float, float]) -> None:
    """Against the variance of the mean that follows from the correlations, and over 60 scenes."""
    targets, plots, last, own = scene
    lags = np.arange(1, plots)
    rho = (1 - own) * last**lags + own
    exact, shape = ((targets * plots) ** 2 / (targets * (plots + 2 * ((plots - lags) @ rho**power))) for power in (1, 3))
    rng = np.random.default_rng(1)
    found = [memory(*alike(rng, *scene), np.tile(np.arange(plots) * 4.0, targets)) for _ in range(60)]
    assert np.median([f.effective for f in found]) == pytest.approx(exact, rel=0.35)
    assert np.median([f.effective_shape for f in found]) == pytest.approx(shape, rel=0.5)
    assert found[0].lag_s[:3] == pytest.approx((4.0, 8.0, 12.0))
    assert found[0].correlation[0] == pytest.approx(rho[0], abs=0.25)


@pytest.mark.parametrize("scene", SCENES)
def test_normal_errors_that_targets_share_are_not_called_anything_else(scene: tuple[int, int, float, float]) -> None:
    rng = np.random.default_rng(1)
    words, rejected, naive = [], 0, 0
    for _ in range(12):
        x, target = alike(rng, *scene)
        found = distribution(x, target=target, most=2)
        words.append(shape_words(found).partition(":")[0])
        rejected += found.jarque_bera < 0.05
        naive += distribution(x, most=1).jarque_bera < 0.05
    assert words.count("normal") >= 10
    assert set(words) <= {"normal", "nearly normal"}
    assert rejected <= 2
    # Taken for independent they would be rejected wherever they are many.
    assert naive >= 4


def test_heavy_tails_are_seen_though_targets_share_errors() -> None:
    rng = np.random.default_rng(3)
    x, target = alike(rng, 40, 80, 0.0, 0.2)
    assert shape_words(distribution(x + 0.8 * rng.standard_t(3, len(x)), target=target)).startswith("heavy-tailed")
    apart = np.where(target % 2 == 0, 6.0, 0.0)
    assert shape_words(distribution(x + apart, target=target)).startswith(("mixture of 2", "not decided"))
    # Hardly more than one value a target: nothing is claimed.
    few, of = alike(rng, 6, 200, 0.0, 0.98)
    assert shape_words(distribution(few, target=of)).startswith("not decided")


def test_rows_may_come_in_any_order() -> None:
    x, target = alike(np.random.default_rng(5), 10, 60, 0.8, 0.1)
    time_s = np.tile(np.arange(60) * 5.0, 10)
    mixed = np.random.default_rng(6).permutation(600)
    one, other = distribution(x, target=target, time_s=time_s), distribution(x[mixed], target=target[mixed], time_s=time_s[mixed])
    assert one.memory == other.memory
    assert one.best == other.best


def test_outliers_however_far_leave_the_rest_as_it_is() -> None:
    rng = np.random.default_rng(7)
    for far in (1e2, 1e6, 1e12):
        x = np.r_[rng.normal(0, 1, 500), far, -far]
        found = distribution(x)
        assert found.best != "normal"
        assert found.robust_sd == pytest.approx(1.0, rel=0.15)
        assert np.isfinite([found.skew, found.kurtosis, found.student.scale, found.jarque_bera, found.shapiro]).all()
        assert found.student.scale < 2
        two = mixture_fit(x, 2, rng)
        assert two.share[0] > 0.98
        assert two.sd[0] == pytest.approx(1.0, rel=0.15)


def test_steps_are_those_of_what_was_measured() -> None:
    """Errors against a fine reference hide them."""
    rng = np.random.default_rng(8)
    true = rng.uniform(1e4, 2e5, 4000)
    for step, name in ((18.52, "18.52 m = 0.01 NM"), (1852 / 256, "7.234 m = 1/256 NM"), (1852.0, "1852 m = 1 NM"), (3.0, "3 m")):
        measured = np.round((true + rng.normal(0, 30, 4000)) / step) * step
        found = distribution(measured - true, measured=measured, most=1)
        assert quantisation_step(measured - true) == 0.0
        assert found.step == pytest.approx(step, rel=1e-6)
        assert step_words(found.step, "m") == name
        assert name in verdict(found, "m")
    assert step_words(360 / 4096, "deg") == "0.08789 deg = 360 deg / 4,096"
    assert step_words(0.1, "deg") == "0.1 deg"


def test_equal_errors_are_constant_whatever_they_are_counted_as() -> None:
    found = distribution(np.full(40, 7.0), target=np.repeat(np.arange(4), 10))
    assert verdict(found, "m") == "constant: all values are equal"
    assert (found.memory.effective, found.robust_sd) == (40.0, 0.0)


def test_the_page_tells_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "distribution.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    exec(compile(block, "distribution.md", "exec"), {})
    said = capsys.readouterr().out
    assert said.startswith("heavy-tailed: Student t")
    assert "18.52 m = 0.01 NM" in said
