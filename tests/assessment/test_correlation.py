"""Correlation of two targets' errors: coefficients against closed forms, segments against truth, the command on real files."""

from __future__ import annotations

import json

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
    shared,
    theil,
)
from boresight.errors import NothingToDo, SettingsError
from boresight.measure import enu_from_polar

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
    assert alone.channels[1].models[0].first_by_second > 0.5
    # The filter takes random errors down.
    assert alone.channels[0].filtered.first.variance < 0.5 * alone.channels[0].raw.first.variance
    assert alone.datasets["curved, both at once"] == pytest.approx(39, abs=12)
    text = correlation_text(alone)
    assert "second-order" in text
    assert "adds no information" in text
    out = json.loads(json.dumps(correlation_json(alone), allow_nan=False))
    assert out["channels"][1]["raw"]["first"]["mean"] == pytest.approx(0.5, abs=0.05)


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
