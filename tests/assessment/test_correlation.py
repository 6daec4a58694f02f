"""Correlation of two targets' errors: coefficients against closed forms, segments against truth, the command on real files."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.assessment.correlation import (
    choose_alignment,
    concordance,
    correlate,
    correlation_json,
    correlation_text,
    effective_number,
    find_segments,
    is_curved,
    make_trace,
    match,
    motion_of,
    reduction_interval,
    shared,
    theil,
)
from boresight.assessment.residuals import Residuals
from boresight.calibration import Accuracy, Calibration, Noise, Summary, TermKey, save_calibration
from boresight.cli import main
from boresight.errors import NothingToDo, SettingsError
from boresight.measure import enu_from_polar
from boresight.registration.per_channel import PerChannel
from boresight.writing.tables import write_table

DEG = np.pi / 180
numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40)


@given(x=numbers, y=numbers)
@settings(max_examples=200, deadline=None)
def test_theil_lies_in_0_to_1_and_is_defined(x: list[float], y: list[float]) -> None:
    n = min(len(x), len(y))
    a, b = np.array(x[:n]), np.array(y[:n])
    assert 0 <= theil(a, b) <= 1
    assert theil(a, b) == theil(b, a)
    assert theil(a, a) == 0
    assert theil(a, -a) == (pytest.approx(1.0) if np.any(a**2 > 0) else 0.0)


@given(x=numbers, y=numbers)
@settings(max_examples=100, deadline=None)
def test_nothing_is_ever_not_a_number(x: list[float], y: list[float]) -> None:
    n = min(len(x), len(y))
    a, b, t = np.array(x[:n]), np.array(y[:n]), np.arange(n, dtype=float)
    said = concordance(a, b, t)
    assert np.isfinite([said.value, said.low, said.high, said.effective]).all()
    assert -1 <= said.low <= said.value + 1e-12 <= said.high + 2e-12 <= 1 + 1e-9
    assert np.isfinite([shared(a, b, t).ratio, shared(a, b, t).ratio_low, shared(a, b, t).ratio_high]).all()


def test_constant_and_equal_series_have_defined_values() -> None:
    t = np.arange(50.0)
    noise = np.random.default_rng(1).normal(size=50)
    equal, one = concordance(np.full(50, 3.1), np.full(50, 7.0), t), concordance(noise, np.full(50, 0.1), t)
    assert (equal.value, equal.low, equal.high) == (1.0, -1.0, 1.0)
    assert (one.value, one.low, one.high) == (0.0, -1.0, 1.0)
    same = concordance(noise, noise, t)
    assert same.value == pytest.approx(1.0) == same.low == same.high
    assert shared(np.full(50, 1.0), np.full(50, 2.0), t).ratio == 1.0
    assert shared(noise, noise, t).ratio == 0.0
    for n in (0, 1, 2):
        assert np.isfinite(concordance(noise[:n], noise[:n], t[:n]).value)


def test_concordance_is_lins_formula() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(400.0)
    x = rng.normal(size=400)
    y = 0.6 * x + rng.normal(size=400) * 0.5
    u, v = (s - np.polyval(np.polyfit(t, s, 1), t) for s in (x, y))
    expected = 2 * np.cov(u, v, bias=True)[0, 1] / (u.var() + v.var() + (u.mean() - v.mean()) ** 2)
    said = concordance(x + 5 + 0.1 * t, y - 3, t)
    assert said.value == pytest.approx(expected, rel=1e-9)
    assert said.low < expected < said.high
    assert said.effective == pytest.approx(400, rel=0.25)


def test_effective_number_of_autoregressive_series_is_bartletts() -> None:
    rng = np.random.default_rng(2)
    n, a = 6_000, 0.9
    found = []
    for _ in range(3):
        x = np.empty((2, n))
        x[:, 0] = rng.normal(size=2)
        for k in range(1, n):
            x[:, k] = a * x[:, k - 1] + np.sqrt(1 - a**2) * rng.normal(size=2)
        found.append(effective_number(*x))
    # 1 + 2 sum of a^(2 k).
    assert np.mean(found) == pytest.approx(n * (1 - a**2) / (1 + a**2), rel=0.15)


def path(seconds: np.ndarray, rate_deg_s: np.ndarray, speed: float, start: tuple[float, float]) -> np.ndarray:
    heading = 0.5 + np.cumsum(rate_deg_s * DEG * np.gradient(seconds))
    step = speed * np.gradient(seconds)
    return np.stack(
        [
            start[0] + np.cumsum(np.sin(heading) * step),
            start[1] + np.cumsum(np.cos(heading) * step),
            np.full(len(seconds), -10.0),
        ],
        axis=1,
    )


def test_segments_are_those_that_were_sailed() -> None:
    t = np.arange(0, 400, 1.0)
    turning = ((t > 100) & (t <= 160)) | ((t > 260) & (t <= 320))
    enu = path(t, np.where(turning, 3.0, 0.0), 8.0, (500.0, 900.0))
    enu[:, :2] += np.random.default_rng(3).normal(size=(400, 2)) * 0.02
    found = find_segments(t, *motion_of(t, enu))
    assert [s.curved for s in found] == [False, True, False, True, False]
    assert np.mean(is_curved(found, 400) == turning) > 0.96
    assert [found[0].first, found[-1].last] == [0, 399]
    still = find_segments(t, *motion_of(t, np.ones((400, 3))))
    assert [s.curved for s in still] == [False]
    assert find_segments(t[:0], np.zeros((0, 3)), np.zeros((0, 3))) == ()


def test_motion_is_that_of_a_parabola() -> None:
    t = np.sort(np.random.default_rng(3).uniform(0, 60, 80))
    enu = np.stack([3 + 2 * t + 0.05 * t**2, 1 - t, 0.02 * t**2], axis=1)
    velocity, acceleration = motion_of(t, enu)
    np.testing.assert_allclose(velocity, np.stack([2 + 0.1 * t, -np.ones(80), 0.04 * t], axis=1), atol=1e-5)
    np.testing.assert_allclose(acceleration, np.tile([0.1, 0, 0.04], (80, 1)), atol=1e-5)


def test_alignment_follows_the_papers_rule() -> None:
    t = np.arange(0, 100, 1.0)
    fast = np.tile([8.0, 0.0, 0.0], (100, 1))
    assert choose_alignment(t, fast, 0 * fast).method == "linear"
    assert choose_alignment(5 * t, 0.01 * fast, 0 * fast).method == "nearest"
    assert choose_alignment(5 * t, fast, 0 * fast).nearest_m == pytest.approx(20.0)


def test_scans_are_matched_one_to_one() -> None:
    a = np.arange(0, 20, 4.0)
    b = np.r_[a[:3] + 0.5, a[4:] - 0.7, 100.0]
    one, two = match(a, b)
    assert one.tolist() == [0, 1, 2, 4]
    assert two.tolist() == [0, 1, 2, 3]
    assert [len(rows) for rows in match(a, b[:0])] == [0, 0]


def two_traces(seed: int, common_deg: float, seconds: int = 300):
    rng = np.random.default_rng(seed)
    t = np.arange(seconds, dtype=float)
    shared_rad = common_deg * DEG * rng.normal(size=seconds)
    out = []
    for k, start in enumerate(((700.0, 900.0), (-900.0, 1200.0))):
        enu = path(t, np.where((t > 120) & (t < 160), 3.0, 0.0), 6.0 + k, start)
        error = np.stack(
            [
                rng.normal(size=seconds) * 5 - 5.5,
                rng.normal(size=seconds) * 0.1 * DEG + 0.5 * DEG + shared_rad,
                np.full(seconds, np.nan),
            ],
            axis=1,
        )
        out.append(make_trace("AB"[k], t, enu, error))
    return out


def test_independent_errors_are_told_from_shared_ones() -> None:
    alone, together = correlate(*two_traces(1, 0.0)).found, correlate(*two_traces(1, 0.3)).found
    assert [c.channel for c in alone.channels] == ["range", "azimuth"]
    assert alone.motion == "straight"
    assert alone.channels[1].raw.ratio_low < 1 < alone.channels[1].raw.ratio_high
    assert alone.channels[1].raw.concordance.low < 0 < alone.channels[1].raw.concordance.high
    assert together.channels[1].raw.ratio_high < 0.5
    assert together.channels[1].raw.concordance.low > 0.7
    # Theil's coefficient says "alike" of both.
    assert max(alone.channels[1].models[0].theil, together.channels[1].models[0].theil) < 0.3
    assert any("Theil" in remark for remark in alone.remarks)
    constant = alone.channels[0].models[0]
    assert constant.distance == pytest.approx(2 * np.sqrt(alone.matched), abs=1e-9)
    constant = alone.channels[1].models[0]
    assert 0.5 < constant.first_by_second_interval[0] < constant.first_by_second < constant.first_by_second_interval[1] < 1
    # The filter takes random errors down.
    assert alone.channels[0].filtered.first.variance < 0.5 * alone.channels[0].raw.first.variance
    assert alone.datasets["curved, both at once"] == pytest.approx(39, abs=12)
    text = correlation_text(alone)
    assert "second-order" in text
    assert "adds no information" in text
    out = json.loads(json.dumps(correlation_json(alone), allow_nan=False))
    assert out["channels"][1]["raw"]["first"]["mean"] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("last", "common", "first", "second"),
    [(0.0, 0.0, 2.0, 2.0), (0.8, 0.0, 2.0, 1.5), (0.9, 0.0, 1.0, 1.0), (0.8, 0.5, 1.0, 0.0)],
)
def test_the_interval_of_the_reduction_holds_the_truth(last: float, common: float, first: float, second: float) -> None:
    """Constant biases of two targets under errors of unit variance that last, and of which a share is common."""
    rng = np.random.default_rng(3)
    n, runs, hits = 300, 60, 0
    t, nothing = np.arange(300.0), np.full(300, np.nan)
    places = tuple(
        make_trace("A", t, np.stack([2e3 + east * t, 1500 + 4 * t, np.full(n, -10.0)], axis=1), np.zeros((n, 3))).place
        for east in (5.0, -5.0)
    )
    truth = 1 - np.sqrt(1 + (second - first) ** 2) / np.sqrt(1 + second**2)
    for _ in range(runs):
        e = rng.normal(size=(3, n))
        for k in range(1, n):
            e[:, k] = last * e[:, k - 1] + np.sqrt(1 - last**2) * e[:, k]
        x, y = (np.sqrt(1 - common) * e[k] + np.sqrt(common) * e[2] + mean for k, mean in enumerate((first, second)))
        model = PerChannel(model="constant").fit(places[0], -np.stack([x, 1e-3 * x, nothing], axis=1)).channels[0]
        assert model is not None
        low, high = reduction_interval(model, places, (x, y))
        hits += low <= truth <= high
    assert 51 <= hits <= 60


def test_errors_that_do_not_vary_have_a_reduction_and_its_interval() -> None:
    t = np.arange(60.0)
    enu = path(t, np.zeros(60), 8.0, (500.0, 900.0))
    for first, second, expected in ((4.0, 4.0, 1.0), (4.0, 0.0, 0.0), (2.0, 4.0, 0.5)):
        traces = [
            make_trace(name, t, enu, np.stack([np.full(60, e), np.zeros(60), np.full(60, np.nan)], axis=1))
            for name, e in (("A", first), ("B", second))
        ]
        found = correlate(*traces).found
        json.dumps(correlation_json(found), allow_nan=False)
        model = found.channels[0].models[0]
        assert model.second_by_first == pytest.approx(expected, abs=1e-6)
        assert model.second_by_first_interval == pytest.approx((expected, expected), abs=1e-6)


def test_curved_motion_alone_and_too_little_of_it() -> None:
    one, two = two_traces(1, 0.0)
    assert correlate(one, two, motion="curved").found.matched < 60
    short = correlate(*two_traces(1, 0.0, seconds=140), motion="curved").found
    assert short.motion == "all"
    assert "all" in short.remarks[0]
    with pytest.raises(SettingsError, match="no motion"):
        correlate(one, two, motion="sideways")


def test_targets_that_were_not_seen_together() -> None:
    one, two = two_traces(1, 0.0)
    later = make_trace("later", two.time_s + 5000, two.enu, two.error)
    with pytest.raises(NothingToDo, match="same scan 0 times"):
        correlate(one, later)


def test_a_still_target_at_the_antennas_height() -> None:
    t = np.arange(100.0)
    enu = enu_from_polar(np.tile([1500.0, 0.3, 0.0], (100, 1)))
    rng = np.random.default_rng(1)
    still = [
        make_trace(name, t, enu, np.stack([rng.normal(size=100), rng.normal(size=100) * 0.01, np.zeros(100)], axis=1))
        for name in "AB"
    ]
    found = correlate(*still).found
    json.dumps(correlation_json(found), allow_nan=False)
    assert len(found.channels) == 3
    # Elevation errors of exactly zero: equal constant series.
    assert found.channels[2].models[0].theil == 0.0
    assert found.channels[2].models[0].r == 1.0


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result of two radars: both saw BOAT-A and BOAT-B, the first one also a target of three plots."""
    folder = tmp_path_factory.mktemp("result")
    parts = []
    for sensor, names in ((1, "AB"), (2, "AB")):
        for k, trace in enumerate(two_traces(sensor, 0.0)):
            n = len(trace)
            columns = {f.name: np.zeros(n, f.metadata["dtype"]) for f in fields(Residuals)}
            columns |= {
                "time_s": 1.7e9 + trace.time_s,
                "sensor": np.full(n, sensor, np.int32),
                "target": np.full(n, k + 10),
                "reference_range_m": trace.place.range_m,
                "reference_azimuth_rad": trace.place.azimuth_rad % (2 * np.pi),
                "reference_elevation_rad": trace.place.elevation_rad,
                "range_before_m": trace.error[:, 0],
                "azimuth_before_rad": trace.error[:, 1],
                "elevation_before_rad": np.full(n, np.nan),
            }
            columns["target_name"] = np.full(n, f"BOAT-{names[k]}", object)
            parts.append(columns)
    short = {name: column[:3].copy() for name, column in parts[0].items()}
    short["target"][:], short["target_name"][:] = 12, "BUOY"
    parts.append(short)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    write_table(folder / "residuals.parquet", joined)
    nothing = Accuracy(1.0, 2.0)
    summaries = tuple(
        Summary(sensor=key, name=f"radar {key}", model="constant", noise=Noise(5.0, 0.001), plots=600, tracks=2, targets=2,
                before=nothing, after=nothing)
        for key in (1, 2)
    )  # fmt: skip
    save_calibration(
        Calibration((TermKey(1, "all", "range_bias", "m"),), np.zeros(1), np.zeros((1, 1)), np.ones((1, 1, 1)), summaries),
        folder / "calibration.json",
    )
    return folder


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str) -> tuple[int, str, str]:
        status = 0
        try:
            main(arguments)
        except SystemExit as stop:
            status = int(stop.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return call


def test_the_command_prints_text_json_and_a_page(result: Path, run: Run, tmp_path: Path) -> None:
    page, numbers = tmp_path / "page.html", tmp_path / "numbers.json"
    begin = ("assess", "correlation", str(result), "--targets", "BOAT-A", "BOAT-B", "--sensor", "radar 1")
    status, out, err = run(*begin, "--out", str(page))
    assert (status, err) == (0, "")
    assert "BOAT-A and BOAT-B" in out
    assert "2 √N" in out
    text = page.read_text()
    assert text.count("<figure") == 3
    assert "http" not in text.replace("http://www.w3.org", "")
    status, out, _ = run(*begin, "--json", "--out", str(numbers))
    assert status == 0
    assert json.loads(out)["correlation"] == json.loads(numbers.read_text())
    channel = json.loads(out)["correlation"]["channels"][0]
    assert channel["models"][0]["distance"] == pytest.approx(2 * np.sqrt(json.loads(out)["correlation"]["matched"]), abs=1e-9)
    # By number, too.
    assert run("assess", "correlation", str(result), "--targets", "10", "11", "--sensor", "radar 2")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--targets", "BOAT-A", "NOBODY"), "no target is called 'NOBODY'. Those with most plots: BOAT-A, BOAT-B, BUOY"),
        (("--targets", "BOAT-A"), "two different targets"),
        (("--targets", "BOAT-A", "BOAT-A"), "two different targets"),
        (("--targets", "BOAT-A", "BOAT-B"), "several radars saw both targets: radar 1, radar 2"),
        (("--targets", "BOAT-A", "BOAT-B", "--sensor", "radar 9"), "no sensor 'radar 9'"),
        (("--targets", "BOAT-A", "BUOY", "--sensor", "radar 1"), "BUOY has 3 plots: too few"),
        (("--targets", "BOAT-A", "BUOY", "--sensor", "radar 2"), "no radar saw both"),
        (("--targets", "BOAT-A", "BOAT-B", "--sensor", "radar 1", "--out", "x.txt"), "neither .html nor .json"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(result: Path, run: Run, arguments: tuple[str, ...], said: str) -> None:
    status, out, err = run("assess", "correlation", str(result), *arguments)
    assert status == 2
    assert out == ""
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_a_folder_without_a_result(run: Run, tmp_path: Path) -> None:
    status, _, err = run("assess", "correlation", str(tmp_path), "--targets", "A", "B")
    assert status == 2
    assert "no residuals.parquet" in err


def test_the_page_tells_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "correlation.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    exec(compile(block, "correlation.md", "exec"), {})
    assert "boat and platform" in capsys.readouterr().out
