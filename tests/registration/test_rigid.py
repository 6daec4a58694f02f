"""Rigid transforms: the truth within its covariance; nearest points lose what lies along a track; the genetic optimum."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import synthetic
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.registration.rigid import Clouds, Genetic, RansacIcp, clouds_of, joint_fit

DEG = np.pi / 180


def tracks(rng: np.random.Generator, count: int, scans: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Straight tracks (count * scans, 3) across 100 km, and their numbers."""
    course, t = rng.uniform(0, 2 * np.pi, count), np.arange(scans) * 4.0 - scans * 2.0
    along = np.stack([np.sin(course), np.cos(course), np.zeros(count)], axis=1)[:, None] * (t * 220.0)[None, :, None]
    middle = np.concatenate([rng.uniform(-70e3, 70e3, (count, 2)), rng.uniform(3e3, 11e3, (count, 1))], axis=1)
    return (middle[:, None] + along).reshape(-1, 3), np.repeat(np.arange(count), scans)


def scene(seed: int, count: int = 90, sd: float = 80.0) -> tuple[Clouds, np.ndarray, np.ndarray]:
    """Clouds of a picture turned and shifted by known amounts, and the R and t that put it right."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    truth, number = tracks(rng, count)
    turn = Rotation.from_rotvec(rng.uniform(0.2, 0.3, 3) * rng.choice((-1, 1), 3) * DEG).as_matrix()
    shift = rng.uniform(-400, 400, 3)
    seen = truth @ turn.T + shift + rng.normal(size=truth.shape) * sd
    return Clouds(seen, truth, number), turn.T, -turn.T @ shift


def test_joint_fit_is_that_of_an_independent_library() -> None:
    from scipy.spatial.transform import Rotation

    clouds, _, _ = scene(1)
    found = joint_fit(clouds)
    z, y = clouds.measured, clouds.reference
    turn, _ = Rotation.align_vectors(y - y.mean(axis=0), z - z.mean(axis=0))
    np.testing.assert_allclose(found.rotation, turn.as_matrix(), atol=1e-7)
    np.testing.assert_allclose(found.translation, y.mean(axis=0) - turn.as_matrix() @ z.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(found(z), z @ found.rotation.T + found.translation)


def test_covariance_is_what_the_errors_are() -> None:
    from scipy.spatial.transform import Rotation

    nees = []
    for seed in range(60):
        clouds, turn, shift = scene(seed, count=30, sd=60.0)
        found = RansacIcp(seed=seed)(clouds)
        assert found.ended == "converged"
        wrong = Rotation.from_matrix(found.rotation @ turn.T).as_rotvec()
        off = np.concatenate([wrong, found(found.centre) - (turn @ found.centre + shift)])
        nees.append(off @ np.linalg.solve(found.covariance, off) / 6)
    # Clustered by 30 tracks: Hotelling's n / (n - p - 1) above one.
    assert 0.8 < np.mean(nees) < 1.6


def test_outliers_take_no_part() -> None:
    clouds, turn, shift = scene(3)
    rng = np.random.default_rng(3)
    bad = rng.random(len(clouds)) < 0.3
    seen = clouds.measured + bad[:, None] * rng.uniform(3e3, 20e3, (len(clouds), 1)) * np.array([1.0, 0.5, 0.0])
    found = RansacIcp(distance_m=1000.0)(Clouds(seen, clouds.reference, clouds.track))
    assert not (found.inliers & bad).any()
    assert found.inliers.sum() > 0.99 * (~bad).sum()
    assert np.abs(found(found.centre) - (turn @ found.centre + shift)).max() < 10.0
    with pytest.raises(NothingToDo, match="within 1 m"):
        RansacIcp(distance_m=1.0)(clouds)


def test_nearest_points_lose_the_offset_along_a_straight_track_and_time_does_not() -> None:
    # The reference's points stand 40 m apart: an offset of 206 m is as good as one of 6 m.
    x = np.arange(-40e3, 40e3, 40.0)
    truth = np.stack([x, np.full(len(x), 30e3), np.full(len(x), 9e3)], axis=1)
    rng = np.random.default_rng(4)
    offset = np.array([206.0, 60.0, -40.0])
    clouds = Clouds(truth + offset + rng.normal(size=truth.shape) * 5.0, truth, np.zeros(len(x), int))
    timed, lost = RansacIcp()(clouds), RansacIcp(pairing="nearest")(clouds)
    middle = clouds.measured.mean(axis=0)
    assert abs(timed(middle)[0] - middle[0] + 206.0) < 3.0
    assert abs(lost(middle)[0] - middle[0]) < 10.0
    assert abs(lost(middle)[1] - middle[1] + 60.0) < 3.0


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.integers(8, 90), st.floats(20, 300))
def test_the_genetic_optimum_is_the_joint_fit_within_two_per_cent(seed: int, count: int, sd: float) -> None:
    clouds, _, _ = scene(seed, count, sd)
    found, joint = Genetic(seed=seed)(clouds), joint_fit(clouds)
    assert found.rms_m <= 1.02 * joint.rms_m
    assert found.inliers.all()
    away = np.abs(found(clouds.measured) - joint(clouds.measured)).max()
    assert away < 0.05 * sd


def test_pairs_of_a_radar_become_clouds_about_it() -> None:
    for elevation in (True, False):
        made = synthetic.scene(5, {}, targets=4, sensors=synthetic.Sensors((next(iter(synthetic.RADARS)),)), elevation=elevation,
                               errors=synthetic.Errors(range_m=0.01, azimuth_rad=1e-8, elevation_rad=1e-8))  # fmt: skip
        clouds = clouds_of(made.pairs, made.sensors)
        assert np.abs(clouds.measured - clouds.reference).max() < 0.2
        np.testing.assert_allclose(np.linalg.norm(clouds.measured, axis=1), made.pairs.plots.range_m)


def test_what_cannot_be_registered_is_said() -> None:
    clouds, _, _ = scene(1, count=2)
    with pytest.raises(NothingToDo, match="three pairs"):
        joint_fit(clouds.take(np.arange(2)))
    with pytest.raises(NothingToDo, match="no track"):
        Genetic()(Clouds(clouds.measured[:6], clouds.reference[:6], np.arange(6)))
    with pytest.raises(SettingsError, match="inlier_share"):
        RansacIcp(inlier_share=0.0)(clouds)
    with pytest.raises(SettingsError, match="population"):
        Genetic(population=2)(clouds)
    with pytest.raises(InputError, match="do not fit"):
        Clouds(np.zeros((3, 3)), np.zeros((2, 3)), np.zeros(3))
    made = synthetic.scene(5, {}, targets=3)
    with pytest.raises(InputError, match="one radar"):
        clouds_of(made.pairs, made.sensors)


def test_one_straight_track_leaves_the_turn_about_itself_as_wide_as_it_was_assumed() -> None:
    clouds, _, _ = scene(6, count=1, sd=1.0)
    found = RansacIcp()(clouds)
    sd = np.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3])) / DEG
    assert sd[-1] > 0.3
    assert sd[0] < 0.01
    assert np.isfinite(found.covariance).all()


@pytest.mark.parametrize("shift_m", [0.0, 50.0])
def test_a_straight_track_without_any_noise_has_a_transform(shift_m: float) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        true = np.outer(rng.uniform(-1e5, 1e5, 60), [1.0, 1.0, 0.0])
        found = RansacIcp()(Clouds(true + shift_m, true, np.zeros(60, int)))
        assert np.isfinite(found.covariance).all()
        np.testing.assert_allclose(found(true + shift_m), true, atol=1e-3)


def test_the_page_on_these_methods_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).parents[2] / "docs" / "adsb-registration.md"
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.S | re.M):
        exec(compile(block, page.name, "exec"), names)
    assert "closed form" in capsys.readouterr().out
    found = names["found"]
    middle = names["measured"].mean(axis=0)
    np.testing.assert_allclose(found(middle) - middle, (-200, -200, -400), atol=6)
