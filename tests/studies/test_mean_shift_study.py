"""The quick form of the study of paper 002: its bounds hold, its cells are there, the measure of accuracy is the paper's."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.studies import Settings, Study, run_study, write_study
from boresight.studies.mean_shift import PERIOD_S, SAMPLE_SD, TABLE_1, Scene, accuracy, spoilt
from boresight.studies.page import bound_text


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study("mean-shift", Settings(quick=True, seed=5))


def test_every_bound_of_the_quick_form_holds(study: Study, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert not study.failed, "\n".join(f"{r.id}: {r.ours} is not within {bound_text(r.bound)}" for r in study.failed)
    assert sum(r.bound is not None for r in study.rows) >= 55
    cells = [r for r in study.rows if r.id.startswith("table-1") and r.printed is not None]
    assert sorted(float(r.printed) for r in cells) == sorted(v for row in TABLE_1.values() for v in row)
    page = write_study(study, tmp_path_factory.mktemp("page") / "study.html").read_text()
    assert page.count("<figure") == len(study.figures) == 5


def test_the_bank_is_better_than_igmsr_in_every_component(study: Study) -> None:
    ours = {r.id: r.ours for r in study.rows}
    for component in ("distance", "azimuth", "elevation"):
        assert ours[f"table-1-kalman-bank-{component}"] > ours[f"table-1-igmsr-{component}"] > ours[f"table-1-msr-{component}"]


def test_accuracy_counts_biases_beyond_the_noise_only() -> None:
    truth = np.array([4.0, -2.0, 0.5])[None, None] * SAMPLE_SD[:, None]
    error = np.array([0.4, 0.4, 9.0])[None, None] * SAMPLE_SD[:, None]
    np.testing.assert_allclose(accuracy(error, truth), 100 * (0.9 + 0.8) / 2)


def test_samples_of_the_scene_have_the_bias_and_the_noise_that_they_should() -> None:
    rng = np.random.default_rng(1)
    time_s, value, variance, bias = Scene().samples(rng, 20)
    off = (value - bias) / SAMPLE_SD[:, None]
    assert np.abs(off.mean(axis=(0, 2))).max() < 0.03
    np.testing.assert_allclose(off.std(axis=(0, 2)), 1.0, atol=0.04)
    np.testing.assert_allclose(np.sqrt(variance.mean(axis=(0, 2))), SAMPLE_SD, rtol=0.02)
    same = np.abs(bias[..., time_s == 0] - bias[..., time_s == PERIOD_S])
    assert same.max() < 1e-9 * SAMPLE_SD[0]
    wrong = spoilt(rng, value, "one-sided") - value
    assert (wrong >= 0).all()
    assert (wrong > 0).mean() == pytest.approx(0.1, abs=0.01)
