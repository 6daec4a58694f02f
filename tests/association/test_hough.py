"""The search of coarse biases, against planted ones, naive sums, and chance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.association import hough
from boresight.association.hough import Bias, Candidates, Window

WINDOW = Window(2000.0, np.radians(3.5), 2.5)


def candidates(rng, true_tracks, false_tracks, bias=(0.0, 0.0, 0.0), points=12, targets=4):
    """`true_tracks` whose first target agrees with `bias`; all other targets err anywhere in the window."""
    tracks = true_tracks + false_tracks
    track = np.repeat(np.arange(tracks), points * targets)
    target = np.tile(np.repeat(np.arange(targets), points), tracks)
    n = len(track)
    pair = track * targets + target
    rate_r, rate_a = rng.uniform(-250, 250, n // points)[pair], rng.uniform(-0.004, 0.004, n // points)[pair]
    # A false target is at a random place and drifts away from the track while it lasts.
    drift = np.tile(np.linspace(-1, 1, points), n // points) * 100.0
    error_r = rng.uniform(-3000, 3000, n // points)[pair] + drift * rng.uniform(-200, 200, n // points)[pair]
    error_a = rng.uniform(-0.1, 0.1, n // points)[pair] + drift * rng.uniform(-0.002, 0.002, n // points)[pair]
    true = (track < true_tracks) & (target == 0)
    error_r[true] = (bias[0] - rate_r * bias[2] + rng.normal(0, 50, n))[true]
    error_a[true] = (bias[1] - rate_a * bias[2] + rng.normal(0, 0.0017, n))[true]
    distance, azimuth = rng.uniform(2e4, 2e5, n // points)[pair], rng.uniform(0, 6.28, n // points)[pair]
    return Candidates(
        track,
        target,
        np.full(n, 1 / points),
        error_r,
        error_a,
        rate_r,
        rate_a,
        np.full(n, 60.0),
        np.full(n, 0.002),
        distance,
        azimuth,
    )


def test_late_stamps_leave_no_residual():
    """A target flies straight away at 200 m/s, stamped 2 s late, range bias 100 m: the signs in closed form."""
    truth = 10_000.0 + 200.0 * np.arange(5.0)
    stamp = np.arange(5.0) + 2.0
    reference_at_stamp = 10_000.0 + 200.0 * stamp
    n = np.zeros(5)
    c = Candidates(n.astype(int), n.astype(int), n + 0.2, truth + 100.0 - reference_at_stamp, n, n + 200.0, n, n + 1, n + 1, n, n)
    left, _ = hough.residuals(c, Bias(100.0, 0.0, 2.0))
    assert np.allclose(left, 0.0, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 10_000), st.floats(-1800, 1800), st.floats(-3.2, 3.2), st.floats(-2.2, 2.2), st.integers(3, 25)
)  # fmt: skip
def test_planted_biases_are_found(seed, range_m, azimuth_deg, late_s, tracks):
    """Among false candidates the peak is at the planted biases, within what the noise allows."""
    rng = np.random.default_rng(seed)
    c = candidates(rng, tracks, 10, (range_m, np.radians(azimuth_deg), late_s))
    peak = hough.search_peak(c, WINDOW)
    assert tracks <= peak.tracks <= tracks + 1
    # With few tracks range and time hide behind each other: the tolerance is for what the pairs see, not for each alone.
    true = (c.track < tracks) & (c.target == 0)
    left = np.array(hough.residuals(c.keep(true), peak.bias))
    assert np.all(np.abs(np.median(left, axis=1)) < (40.0, 0.0015))
    if tracks >= 10:
        assert abs(peak.bias.range_m - range_m) < 40
        assert abs(peak.bias.azimuth_rad - np.radians(azimuth_deg)) < 0.0015
        assert abs(peak.bias.time_s - late_s) < 0.25


def test_scores_are_the_naive_sum():
    """`explained` against loops over pairs and points."""
    rng = np.random.default_rng(3)
    c = candidates(rng, 3, 2, (100.0, 0.01, 0.5), points=5)
    score, track, target, pair = hough.explained(c, Bias(100.0, 0.01, 0.5), 3.0)
    for k in range(len(score)):
        total = 0.0
        for i in np.flatnonzero((c.track == track[k]) & (c.target == target[k])):
            assert pair[i] == k
            r = (c.range_error_m[i] + 0.5 * c.range_rate_mps[i] - 100.0) / 60.0
            a = (c.azimuth_error_rad[i] + 0.5 * c.azimuth_rate_radps[i] - 0.01) / 0.002
            total += c.weight[i] * max(0.0, 1 - (r * r + a * a) / 9)
        assert score[k] == pytest.approx(total, abs=1e-12)
    assert set(zip(track, target, strict=True)) == set(zip(c.track, c.target, strict=True))


def test_chance_is_refused_and_truth_is_not():
    """Of 40 searches without any true pair none passes; with three true tracks all pass."""
    chance = [hough.search_peak(candidates(np.random.default_rng(seed), 0, 20), WINDOW) for seed in range(48)]
    for k in range(40):
        assert not hough.is_significant(chance[k], chance[40:], 2)
        c = candidates(np.random.default_rng(1000 + k), 3, 17, (500.0, 0.02, 1.0))
        assert hough.is_significant(hough.search_peak(c, WINDOW), chance[40:], 2)


def test_nothing_to_vote():
    """No candidates, or none within the window, give no peak, not an error."""
    rng = np.random.default_rng(0)
    c = candidates(rng, 2, 2)
    assert hough.search_peak(c.keep(np.zeros(len(c.track), bool)), WINDOW) == hough.NO_PEAK
    far = c._replace(range_error_m=c.range_error_m + 1e6)
    assert hough.search_peak(far, WINDOW) == hough.NO_PEAK


def test_without_a_time_window_the_time_bias_is_zero():
    """A window of 0 s searches range and azimuth alone."""
    c = candidates(np.random.default_rng(5), 10, 5, (300.0, 0.01, 0.0))
    peak = hough.search_peak(c, Window(2000.0, 0.06, 0.0))
    assert abs(peak.bias.time_s) < 1e-6
    assert abs(peak.bias.range_m - 300) < 40


def test_shared_offset_counts_each_track_once():
    """Five tracks meet targets 1,000 s apart, one talkative track meets one all the time at 50 s: the five win."""
    rng = np.random.default_rng(2)
    plot_track = np.r_[np.arange(5), np.full(40, 5)]
    plot_time = np.r_[rng.uniform(5000, 6000, 5), np.linspace(5000, 6000, 40)]
    fix_time = np.r_[plot_time[:5] - 1000 + rng.uniform(-3, 3, 5), plot_time[5:] - 50]
    near = np.arange(45), np.arange(45)
    late, tracks, _ = hough.shared_offset(plot_time, plot_track, fix_time, near, 10.0)
    assert abs(late - 1000) < 5
    assert tracks == 5
    assert hough.shared_offset(plot_time, plot_track, fix_time, (np.empty(0, int), np.empty(0, int)), 10.0)[1] == 0


def test_gain_and_eccentricity_are_followed():
    """True errors bent by 6 m/km and 0.8° of eccentricity: wide votes find them, and `bent` follows them to the noise."""
    rng = np.random.default_rng(7)
    c = candidates(rng, 25, 5, (200.0, 0.01, 0.3))
    true = (c.track < 25) & (c.target == 0)
    bend = Bias(0.0, 0.0, 0.0, 0.006, 0.012, -0.008).at(c.range_m, c.azimuth_rad)
    c = c._replace(
        range_error_m=c.range_error_m + np.where(true, bend[0], 0.0),
        azimuth_error_rad=c.azimuth_error_rad + np.where(true, bend[1], 0.0),
    )
    wide = Window(6000.0, 0.18, 2.5)
    assert hough.search_peak(c, wide).tracks < 15
    start = hough.search_peak(hough.widened(c, 10.0), wide)
    found = hough.bent(c, wide, start.bias, 10.0)
    assert found.tracks >= 24
    assert found.bias.range_gain == pytest.approx(0.006, abs=0.0006)
    assert found.bias.azimuth_cos_rad == pytest.approx(0.012, abs=0.001)
    assert found.bias.azimuth_sin_rad == pytest.approx(-0.008, abs=0.001)


def test_what_the_geometry_does_not_show_stays_small():
    """All tracks at one range and azimuth: gain and eccentricity cannot be told from the constants, and are not invented."""
    c = candidates(np.random.default_rng(8), 20, 0, (300.0, 0.02, 0.0))
    c = c._replace(range_m=np.full(len(c.track), 8e4), azimuth_rad=np.full(len(c.track), 1.0))
    peak = hough.refine(c, WINDOW, Bias(300.0, 0.02, 0.0), bends=True)
    assert abs(peak.bias.range_gain) < 5e-4
    left = peak.bias.at(np.array([8e4]), np.array([1.0]))
    assert left[0][0] == pytest.approx(300, abs=40)
    assert left[1][0] == pytest.approx(0.02, abs=0.0015)
