"""Grouping of plots: every plot once, in time order, cut where one target cannot be."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.association import tracklets
from boresight.model import Plots

OPTIONS = {"gap_s": 30.0, "speed_mps": 300.0, "azimuth_sd_rad": 0.002}


def line(times, number, first_m=20_000.0, speed=100.0):
    times = np.asarray(times, float)
    return Plots(
        time_s=times,
        range_m=first_m + speed * (times - times[0]),
        azimuth_rad=np.full(len(times), 1.0),
        track=np.full(len(times), number),
    )


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 200))
def test_every_plot_is_in_one_place(seed, n):
    """Whatever the table, each row is in one tracklet or alone; tracklets are in time order, of one number, without long gaps."""
    rng = np.random.default_rng(seed)
    plots = Plots(
        time_s=rng.uniform(0, 500, n), range_m=rng.uniform(1e3, 3e4, n), azimuth_rad=rng.uniform(0, 6.2, n),
        track=rng.integers(-1, 4, n), mode_s=rng.integers(-1, 3, n),
    )  # fmt: skip
    rows = np.flatnonzero(rng.random(n) < 0.8)
    found = tracklets.build(plots, rows, **OPTIONS)
    assert sorted([*found.order.tolist(), *found.alone.tolist()]) == rows.tolist()
    assert found.start[0] == 0
    assert found.start[-1] == len(found.order)
    for k in range(len(found)):
        mine = found.order[found.start[k] : found.start[k + 1]]
        assert len(mine)
        step = np.diff(plots.time_s[mine])
        assert np.all((step >= 0) & (step <= 30))
        assert len(set(plots.track[mine].tolist())) == 1
    assert np.all(plots.track[found.alone] < 0)
    assert np.all(plots.mode_s[found.alone] < 0)


def test_a_number_used_again_is_another_target():
    """A pause longer than the gap, and a jump that no aircraft makes, begin a new tracklet."""
    plots = Plots.concat(
        [line(np.arange(0, 40, 4.0), 5), line(np.arange(200, 240, 4.0), 5), line(np.arange(244, 280, 4.0), 5, 60_000.0)]
    )
    found = tracklets.build(plots, np.arange(len(plots)), **OPTIONS)
    assert found.length.tolist() == [10, 10, 9]
    assert found.number.tolist() == [5, 5, 5]


def test_the_order_of_records_does_not_matter():
    """Shuffled records give the same groups."""
    plots = Plots.concat([line(np.arange(0, 400, 4.0), k, 10_000.0 * k) for k in range(1, 6)])
    mix = np.random.default_rng(1).permutation(len(plots))
    straight = tracklets.build(plots, np.arange(len(plots)), **OPTIONS)
    shuffled = tracklets.build(plots.take(mix), np.arange(len(plots)), **OPTIONS)
    assert np.array_equal(plots.time_s[straight.order], plots.take(mix).time_s[shuffled.order])
    assert np.array_equal(straight.start, shuffled.start)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=6), st.integers(2, 20))
def test_samples_are_spread_and_never_twice(lengths, points):
    """min(length, points) different plots of each tracklet, the largest step between them at most twice the mean one."""
    start = np.r_[0, np.cumsum(lengths)]
    t = tracklets.Tracklets(np.arange(start[-1]), start, np.arange(len(lengths)), np.empty(0, np.int64))
    who, row = tracklets.sample(t, points)
    for k, n in enumerate(lengths):
        mine = row[who == k] - start[k]
        assert len(mine) == min(n, points) == len(set(mine.tolist()))
        assert np.all((mine >= 0) & (mine < n))
        if len(mine) > 1:
            assert np.diff(mine).max() <= 2 * n / len(mine) + 1


def test_parked_targets_stand_still():
    """Of a target that stands for a minute under noise and then taxies at 8 m/s, the minute is still and the taxiing is not."""
    rng = np.random.default_rng(4)
    time = np.arange(120.0)
    distance = 1500.0 + 8.0 * np.maximum(time - 60, 0) + rng.normal(0, 1.5, 120)
    plots = Plots(time_s=time, range_m=distance, azimuth_rad=np.full(120, 2.0), track=np.ones(120))
    found = tracklets.build(plots, np.arange(120), **OPTIONS)
    still = tracklets.still(plots, found, 1.0)
    assert set(range(54)) <= set(still.tolist())
    assert not set(range(66, 120)) & set(still.tolist())
