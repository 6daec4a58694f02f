"""Assignment against brute force, and what it may never do."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.association.assign import assign, track_cost


def dense(rng, tracks, targets, density=0.7):
    track, target = np.nonzero(rng.random((tracks, targets)) < density)
    return track, target, rng.uniform(0, 20, len(track)), rng.integers(1, 50, len(track)).astype(float)


def gain_of(decision_target, track, target, cost, weight, unassigned):
    table = {(i, j): (unassigned - c) * w for i, j, c, w in zip(track, target, cost, weight, strict=True)}
    return sum(table[i, j] for i, j in enumerate(decision_target) if j >= 0)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 6), st.integers(1, 3), st.booleans())
def test_the_cheapest_assignment(seed, tracks, targets, at_once):
    """The total gain is that of the best of all possible assignments, whether tracks all overlap in time or not."""
    rng = np.random.default_rng(seed)
    track, target, cost, weight = dense(rng, tracks, targets)
    start = np.zeros(tracks) if at_once else rng.uniform(0, 10, tracks)
    end = start + (1.0 if at_once else rng.uniform(0, 6, tracks))
    found = assign(track, target, cost, weight, 12.0, start, end, overlap_s=0.5, margin=1e9)
    table = np.full((tracks, targets), -np.inf)
    table[track, target] = (12.0 - cost) * weight
    best = 0.0
    for order in itertools.product(range(-1, targets), repeat=tracks):
        clash = any(
            order[i] == order[k] >= 0 and min(end[i], end[k]) - max(start[i], start[k]) > 0.5
            for i, k in itertools.combinations(range(tracks), 2)
        )
        if not clash:
            best = max(best, sum(table[i, j] for i, j in enumerate(order) if j >= 0))
    assert gain_of(found.target, track, target, cost, weight, 12.0) == pytest.approx(best)
    assert np.all(found.cost[found.target >= 0] < 12.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 40), st.integers(1, 8))
def test_a_target_is_never_in_two_tracks_at_a_time(seed, tracks, targets):
    """Whatever the spans, two tracks of one target overlap by no more than is allowed; no pair is invented."""
    rng = np.random.default_rng(seed)
    track, target, cost, weight = dense(rng, tracks, targets)
    start = rng.uniform(0, 100, tracks)
    end = start + rng.uniform(0, 60, tracks)
    found = assign(track, target, cost, weight, 12.0, start, end, overlap_s=2.0)
    offered = set(zip(track.tolist(), target.tolist(), strict=True))
    for i, j in itertools.combinations(np.flatnonzero(found.target >= 0), 2):
        if found.target[i] == found.target[j]:
            assert min(end[i], end[j]) - max(start[i], start[j]) <= 2.0
    assert all((i, j) in offered for i, j in enumerate(found.target.tolist()) if j >= 0)
    # The same candidates in another order decide the same.
    mix = rng.permutation(len(track))
    again = assign(track[mix], target[mix], cost[mix], weight[mix], 12.0, start, end, overlap_s=2.0)
    assert np.array_equal(found.target, again.target)


def test_broken_tracks_share_their_target():
    """Three pieces of one flight, one after the other, all take its target; a fourth at the same time does not."""
    start, end = np.array([0.0, 100.0, 200.0, 90.0]), np.array([95.0, 190.0, 300.0, 150.0])
    found = assign(np.arange(4), np.zeros(4, int), np.array([1.0, 1.0, 1.0, 2.0]), np.full(4, 20.0), 12.0, start, end)
    assert found.target.tolist() == [0, 0, 0, -1]


def test_a_long_track_does_not_push_others_aside():
    """Two cars in convoy, each in two tracks: the long track of the one must not force the other's first track on to it."""
    # Tracks 0 and 1 at the same time, 2 and 3 later; targets 0 and 1; the wrong pairing is only a little worse.
    track, target = np.repeat(np.arange(4), 2), np.tile([0, 1], 4)
    cost = np.array([0.1, 0.9, 0.9, 0.1, 0.1, 0.9, 0.9, 0.1])
    weight = np.repeat([20.0, 150.0, 600.0, 10.0], 2)
    start, end = np.array([0.0, 0, 200, 200]), np.array([150.0, 150, 800, 800])
    assert assign(track, target, cost, weight, 12.0, start, end).target.tolist() == [0, 1, 0, 1]


def test_a_track_is_not_pushed_to_a_far_worse_target():
    """Both tracks are target 0 at the same time; the second one stays alone rather than take target 1, which fits much worse."""
    track, target = np.array([0, 1, 1]), np.array([0, 0, 1])
    spans = np.zeros(2), np.ones(2)
    found = assign(track, target, np.array([0.5, 0.6, 9.0]), np.full(3, 20.0), 12.0, *spans, margin=2.0)
    assert found.target.tolist() == [0, -1]
    close = assign(track, target, np.array([0.5, 0.6, 1.5]), np.full(3, 20.0), 12.0, *spans, margin=2.0)
    assert close.target.tolist() == [0, 1]
    assert close.runner_up[1] == pytest.approx(0.6)


def test_no_candidates():
    """Nothing to choose from is an answer."""
    empty = np.empty(0, np.int64)
    found = assign(empty, empty, np.empty(0), np.empty(0), 12.0, np.zeros(3), np.ones(3))
    assert found.target.tolist() == [-1, -1, -1]


def test_track_cost_is_the_naive_mean():
    """Mean of min(d², gate²) over what could be compared, by loops."""
    rng = np.random.default_rng(1)
    track, target = rng.integers(0, 4, 200), rng.integers(0, 3, 200)
    d2, weight = rng.exponential(10, 200), rng.uniform(0.01, 0.1, 200)
    t, j, cost, share, seen = track_cost(track, target, d2, weight, 36.0)
    for k in range(len(t)):
        rows = (track == t[k]) & (target == j[k])
        assert cost[k] == pytest.approx(np.average(np.minimum(d2[rows], 36.0), weights=weight[rows]))
        assert share[k] == pytest.approx(np.average(d2[rows] < 36.0, weights=weight[rows]))
        assert seen[k] == pytest.approx(weight[rows].sum())
