"""K-medoids against every possible choice; matches of tracks for small biases, and what the denominator decides."""

from __future__ import annotations

from itertools import combinations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.alignment import locate
from boresight.association import association_of, search
from boresight.association.cluster import Traces, TrackMatch, k_medoids
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.simulation import simulate
from boresight.simulation.demo import association_scene


def distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points, axis=2)


def cost(d: np.ndarray, medoids: tuple[int, ...]) -> float:
    return float(d[list(medoids)].min(axis=0).sum())


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000), st.integers(1, 12), st.integers(1, 5))
def test_no_swap_of_one_point_improves_and_the_cost_is_what_it_says(seed: int, n: int, count: int) -> None:
    count = min(count, n)
    rng = np.random.default_rng(seed)
    points = np.round(rng.normal(size=(n, 2)), 1)
    d = distances(points)
    found = k_medoids(d, count, rng)
    assert found.ended == "no swap lowers the cost"
    assert len(set(found.medoid.tolist())) == count
    assert found.cost == pytest.approx(cost(d, tuple(found.medoid)))
    np.testing.assert_allclose(d[found.medoid[found.label], np.arange(n)], d[found.medoid].min(axis=0))
    for k in range(count):
        for other in range(n):
            tried = found.medoid.copy()
            tried[k] = other
            assert cost(d, tuple(tried)) >= found.cost - 1e-9


def test_the_best_of_a_few_starts_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        d = distances(rng.normal(size=(14, 2)))
        best = min(cost(d, c) for c in combinations(range(14), 3))
        found = min(k_medoids(d, 3, rng).cost for _ in range(8))
        assert found == pytest.approx(best)


def traffic(seed: int, bias_m: float, lone: int = 0, count: int = 40) -> tuple[Traces, Traces]:
    """Radar tracks 100 … of aircraft 0 …, the last `lone` of which have no reference."""
    rng = np.random.default_rng(seed)
    course, t = rng.uniform(0, 2 * np.pi, count), np.arange(30) * 4.0
    place = np.concatenate([rng.uniform(-90e3, 90e3, (count, 2)), rng.uniform(3e3, 11e3, (count, 1))], axis=1)
    way = np.stack([np.sin(course), np.cos(course), np.zeros(count)], axis=1) * 220.0
    where = place[:, None] + way[:, None] * t[None, :, None]
    number = np.repeat(np.arange(count), len(t))
    stamp = np.tile(t, count)
    seen = where.reshape(-1, 3) + np.array([bias_m, bias_m, 0.0]) + rng.normal(size=(count * len(t), 3)) * 50.0
    radar = Traces(seen, seen[:, 2], stamp, number + 100)
    known = number < count - lone
    flat = where.reshape(-1, 3)
    return radar, Traces(flat[known], flat[known][:, 2], stamp[known] + 0.5, number[known])


def test_small_biases_are_matched() -> None:
    radar, reference = traffic(1, 200.0)
    found = TrackMatch()(radar, reference)
    np.testing.assert_array_equal(found.track, np.arange(40) + 100)
    right = found.target == found.track - 100
    assert right.mean() >= 0.8
    assert (~right & (found.target >= 0)).mean() <= 0.05
    assert ((found.share >= 0) & (found.share <= 1)).all()
    assert (found.votes <= found.plots).all()


def test_the_denominator_decides_and_lone_tracks_are_paired() -> None:
    radar, reference = traffic(2, 200.0, lone=10)
    by_votes, by_plots = TrackMatch()(radar, reference), TrackMatch(denominator="plots")(radar, reference)
    assert (by_votes.target >= 0).sum() >= (by_plots.target >= 0).sum()
    assert (by_plots.share <= by_votes.share + 1e-12).all()
    # The weakness that METHODS states: tracks without a reference are paired all the same.
    assert (by_votes.target[-10:] >= 0).any()


def test_heights_apart_are_screened_and_nothing_is_matched_to_nothing() -> None:
    radar, reference = traffic(3, 100.0, count=5)
    low = Traces(radar.position, radar.height_m - 20e3, radar.time_s, radar.track)
    assert (TrackMatch()(low, reference).target == -1).all()
    empty = Traces(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0, int))
    assert (TrackMatch()(radar, empty).target == -1).all()
    assert len(TrackMatch()(empty, reference).target) == 0
    later = Traces(reference.position, reference.height_m, reference.time_s + 1e6, reference.track)
    assert (TrackMatch()(radar, later).target == -1).all()


def test_a_plot_is_clustered_with_the_nearest_fixes_at_its_height() -> None:
    """One plot between two targets at its own height, one above and one too late: its cluster is the nearer of the two."""
    radar = Traces(np.array([[0.0, 0.0, 5e3]]), np.array([5e3]), np.array([10.0]), np.array([7]))
    where = np.array([[900.0, 0, 5.2e3], [500.0, 0, 5.2e3], [-2e3, 0, 5.1e3], [10.0, 0, 6e3], [10.0, 0, 5e3]])
    # The first target has two fixes within the scan: the second is the nearer in time.
    reference = Traces(where, where[:, 2], np.array([7.0, 10.5, 10.0, 10.0, 14.0]), np.array([1, 1, 2, 3, 4]))
    for clusters, target in ((0, 1), (1, -1), (9, -1)):
        found = TrackMatch(clusters=clusters)(radar, reference)
        assert found.target.tolist() == [target]
        assert found.votes.tolist() == [int(target == 1)]


def test_bad_input_is_refused() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(SettingsError, match="5 clusters of 3 points"):
        k_medoids(np.zeros((3, 3)), 5, rng)
    with pytest.raises(InputError, match="square"):
        k_medoids(np.full((3, 3), np.nan), 1, rng)
    with pytest.raises(InputError, match="do not fit"):
        Traces(np.zeros((3, 3)), np.zeros(2), np.zeros(3), np.zeros(3))
    radar, reference = traffic(1, 0.0, count=3)
    with pytest.raises(SettingsError, match="threshold"):
        TrackMatch(threshold=0.0)(radar, reference)


def test_whole_tracks_are_paired_by_clusters_in_place_of_the_search() -> None:
    """A primary radar with errors that are small against the distances of the aircraft, and one with large ones."""
    scene = association_scene(1)
    radar = msgspec.structs.replace(scene.radar[0], errors={"range_bias": 80.0, "azimuth_bias": 0.1})
    traffic = msgspec.structs.replace(scene.traffic, aircraft=12)
    seen = simulate(msgspec.structs.replace(scene, radar=(radar,), traffic=traffic, duration_s=300.0), 1)
    plots, truth = seen.observations[0].plots, seen.observations[0].target
    assert (plots.track >= 0).any()
    fixes = locate(seen.fixes, seen.sensors)[0]
    found = search(plots, fixes, seen.sensors, association_of("k-medoids", {"threshold": "0.6", "height_limit_m": "1000"}))
    assert found.bias[0].by == "k-medoids"
    assert abs(found.bias[0].range_m - 80.0) < 60.0
    assert len(found.pairs) > 0.3 * len(plots)
    # Whom a target of the reference is paired with is one aircraft, but for a few that are near each other.
    aircraft = truth[found.pairs.plot]
    by_target = [aircraft[found.pairs.target == one] for one in np.unique(found.pairs.target)]
    right = sum(np.unique(own, return_counts=True)[1].max() for own in by_target)
    assert right > 0.9 * len(found.pairs)
    with pytest.raises(NothingToDo, match=r"pair none of its \d+ tracks .* and 85 % are needed.*hough"):
        search(plots, fixes, seen.sensors, association_of("k-medoids", {"clusters": "1"}))
    with pytest.raises(NothingToDo, match=r"neither track numbers nor identities.*hough"):
        search(plots.replace(track=np.full(len(plots), -1)), fixes, seen.sensors, association_of("k-medoids", {}))


def test_options_of_association_are_told_before_anything_is_done() -> None:
    assert association_of("hough", {"gate_sd": "8", "use_identity": "false"}).gate_sd == 8.0
    found = association_of("k-medoids", {"period_s": "10", "denominator": "plots", "gate_m": "900"})
    assert found.matching == TrackMatch(period_s=10.0, denominator="plots")
    assert found.gate_m == 900.0
    for name, options, said in (
        ("medoids", {}, "Known: hough, k-medoids"),
        ("hough", {"threshold": "0.9"}, "It has: range_window_m"),
        ("k-medoids", {"threshhold": "0.9"}, "It has: period_s, height_limit_m, threshold, denominator, clusters"),
        ("k-medoids", {"threshold": "much"}, "threshold"),
        ("k-medoids", {"threshold": "1.5"}, "threshold = 1.5 makes no sense"),
        ("hough", {"gate_m": "-1"}, "gate_m = -1.0 must be positive"),
    ):
        with pytest.raises(SettingsError, match=said):
            association_of(name, options)
