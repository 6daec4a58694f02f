"""The comparison of two calibrations, judged against known differences and against SciPy's distributions."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2
from test_report import Page

from boresight.calibration import Accuracy, Calibration, Input, Noise, NotDetermined, Summary, TermKey, save_calibration
from boresight.errors import NothingToDo
from boresight.report.compare import compare, comparison_text, conclusion, drift, render_comparison
from boresight.terms import DEG, TERMS

NAMES = ("range_bias", "azimuth_bias", "time_offset")


def calibration(
    value: np.ndarray, covariance: np.ndarray, *, day: float = 0.0, sensor: int = 257, files: str = "a", names=NAMES
) -> Calibration:
    scale = np.array([TERMS[name].si_per_unit for name in names])
    summary = Summary(
        sensor=sensor, name="Alpha", model="auto", noise=Noise(50.0, 0.05 * DEG), plots=900, tracks=30, targets=30,
        before=Accuracy(200.0, 500.0), after=Accuracy(50.0, 120.0),
    )  # fmt: skip
    return Calibration(
        tuple(TermKey(sensor, "all", name, TERMS[name].unit) for name in names),
        np.array([1.7e9 + 86400 * day]), (value * scale)[None], (covariance * np.outer(scale, scale))[None], (summary,),
        (NotDetermined(sensor, "site_up", "too far away"),), (Input(f"{files}.ast", files * 64, 10),), version="0.1.0",
    )  # fmt: skip


VALUE = np.array([100.0, 0.2, 0.5])
SD = np.array([4.0, 0.01, 0.05])
COVARIANCE = np.diag(SD**2)


def test_difference_its_sd_and_chance_are_those_of_the_sums() -> None:
    move = np.array([8.0, 0.0, -0.2])
    c = compare(calibration(VALUE, COVARIANCE), calibration(VALUE + move, 4 * COVARIANCE, day=10, files="b"))
    np.testing.assert_allclose([t.difference for t in c.terms], move, atol=1e-12)
    np.testing.assert_allclose([t.difference_sd for t in c.terms], SD * np.sqrt(5))
    assert c.overall.chi_square == pytest.approx(np.sum((move / SD) ** 2 / 5))
    assert c.overall.freedom == 3
    assert c.overall.p == pytest.approx(chi2.sf(c.overall.chi_square, 3), rel=1e-3)
    assert c.days == pytest.approx(10)
    assert c.shared == ()


def test_agreement_is_as_frequent_as_it_says() -> None:
    """Of 2,000 pairs of estimates of the same truth, one in twenty is said to differ, with correlated terms."""
    random = np.random.default_rng(11)
    mixing = np.array([[4.0, 0, 0], [0.006, 0.008, 0], [0.0, 0.03, 0.04]])
    covariance = mixing @ mixing.T
    draws = random.standard_normal((2, 2000, 3)) @ mixing.T
    found = [
        compare(calibration(VALUE + a, covariance), calibration(VALUE + b, covariance, files="b"))
        for a, b in zip(*draws, strict=True)
    ]
    assert 0.035 < np.mean([not c.overall.agrees for c in found]) < 0.065
    assert 0.04 < np.mean([[not t.agrees for t in c.terms] for c in found]) < 0.06


def test_drift_and_conclusion_in_words() -> None:
    second = calibration(VALUE + np.array([0.0, 0.1, 0.0]), COVARIANCE, day=20, files="b")
    c = compare(calibration(VALUE, COVARIANCE), second, ("May", "June"))
    assert conclusion(c) == "The two calibrations differ by more than chance, in azimuth bias."
    (sentence,) = drift(c)
    assert "azimuth bias rose by 0.100° ± 0.014° in 20.0 days: +0.00500 ± 0.00071° a day" in sentence
    assert "agree in all 3" in conclusion(compare(second, second))
    assert drift(compare(second, second)) == []
    back = drift(compare(second, calibration(VALUE, COVARIANCE), ("June", "May")))
    assert "fell" in back[0]
    assert "the older one" in back[1]


def test_what_is_shared_and_what_is_alone_is_named() -> None:
    first = calibration(VALUE, COVARIANCE)
    other = calibration(VALUE[:2], COVARIANCE[:2, :2], names=("range_bias", "site_up"))
    c = compare(first, other, ("one", "two"))
    assert c.shared == ("a.ast",)
    assert any("not independent" in note for note in c.notes)
    assert [(a.calibration, a.term, a.why) for a in c.alone] == [
        ("one", "azimuth_bias", "its model has no such term"), ("one", "time_offset", "its model has no such term"),
        ("two", "site_up", "too far away"),
    ]  # fmt: skip
    page = Page(render_comparison(c, first, other))
    for words in ("a.ast", "too far away", "range bias", "chi-square", "in both"):
        assert words in page.text
    assert page.tags.count("svg") == 1
    assert "script" not in page.tags
    assert all(link.startswith("#") for link in page.links)
    assert "only in two: site up" in comparison_text(c)


def test_terms_that_neither_knows_do_not_count() -> None:
    tied = np.array([[16.0, 16.0, 0], [16.0, 16.0, 0], [0, 0, 0.01]])
    first, second = calibration(VALUE, tied), calibration(VALUE + np.array([1.0, 1.0, 0.0]), tied, files="b")
    assert compare(first, second).overall.freedom == 2


def test_calibrations_without_a_common_radar_are_refused() -> None:
    with pytest.raises(NothingToDo, match=r"no radar in common: first has Alpha \(1/1\) and second has Alpha \(1/2\)"):
        compare(calibration(VALUE, COVARIANCE), calibration(VALUE, COVARIANCE, sensor=258))


def test_few_targets_make_a_difference_less_certain() -> None:
    first, second = calibration(VALUE, COVARIANCE), calibration(VALUE + np.array([14.0, 0, 0]), COVARIANCE, files="b")
    few = [replace(c, sensors=(msgspec.structs.replace(c.sensors[0], effective_targets=5.0),)) for c in (first, second)]
    sure, unsure = compare(first, second).terms[0], compare(*few).terms[0]
    assert sure.p < unsure.p < 0.1
    assert sure.difference_sd == unsure.difference_sd


def test_command_prints_writes_and_refuses(tmp_path: Path) -> None:
    for name, value in (("may", VALUE), ("june", VALUE + np.array([0.0, 0.1, 0.0]))):
        (tmp_path / name).mkdir()
        save_calibration(calibration(value, COVARIANCE, files=name[0]), tmp_path / name / "calibration.json")

    def run(*more: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "boresight", "compare", "may/calibration.json", "june/calibration.json", *more]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)

    done = run("--out", "compare.html", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["agrees"] is False
    assert result["names"] == ["may", "june"]
    assert result["terms"][1]["difference"] == pytest.approx(0.1)
    html = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert "azimuth bias" in Page(html).text
    again = run("--out", "compare.html")
    assert again.returncode == 2
    assert "compare.html exists" in again.stderr
