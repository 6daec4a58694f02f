"""The quick form of the study of paper 001: its bounds hold, its cells are there, its scenes have the errors that they should."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.studies import Settings, Study, run_study, write_study
from boresight.studies.adsb_registration import (
    DEG,
    METHODS,
    MODEL,
    OFFSET_M,
    PRINTED,
    SCENES,
    TIME_S,
    Clustered,
    Errors,
    draw,
    errors_of,
    least_squares,
    predicted_with_bias,
    rotation_of,
)
from boresight.studies.page import bound_text


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study("adsb-registration", Settings(quick=True, seed=1))


def test_every_bound_of_the_quick_form_holds(study: Study, tmp_path_factory: pytest.TempPathFactory) -> None:
    assert not study.failed, "\n".join(f"{r.id}: {r.ours} is not within {bound_text(r.bound)}" for r in study.failed)
    assert sum(r.bound is not None for r in study.rows) >= 85
    cells = [r for r in study.rows if r.id.startswith("table-1") and r.printed is not None]
    assert len(cells) == 3 * (len(PRINTED) + 1) + 1
    assert {"figure-3", "figure-4", "figure-5"} < {f.name for f in study.figures}
    page = write_study(study, tmp_path_factory.mktemp("page") / "study.html").read_text()
    assert page.count("<figure") == len(study.figures) == 5
    for scene in SCENES:
        assert sum(r.table == f"Mean absolute error, {scene}" for r in study.rows) == 3 * len(METHODS)


def test_each_claim_has_a_bounded_row(study: Study) -> None:
    bounded = {r.id for r in study.rows if r.bound is not None}
    wanted = {"radial-range", "radial-time", "radial-named", "medoids-lone", "search-right", "search-wrong", "eq-7-ratio",
              "time-found", "alias-columns", "sector-ratio", "pairing-nearest", "limit-flat-earth", "limit-pressure"}  # fmt: skip
    wanted |= {f"{kind}-{scene.replace(' ', '-')}" for kind in ("genetic", "sd", "sd-share", "nees") for scene in SCENES}
    assert wanted <= bounded
    verdicts = [r for r in study.rows if r.id.startswith("verdict-")]
    assert all(isinstance(r.printed, str) and isinstance(r.ours, str) for r in verdicts)
    assert len(verdicts) >= 13


def test_k_medoids_pairs_lone_tracks_only_where_votes_are_the_denominator() -> None:
    (shares,) = Clustered("scene 1")(np.random.default_rng(5), 2)
    assert shares.shape == (2, 2, 3)
    assert shares[:, 0, 0].mean() > 0.1
    assert (shares[:, 1, 0] <= shares[:, 0, 0]).all()
    assert (shares[:, 0, 1] > 0.9).all()


def test_traffic_stays_in_its_area_and_moves_like_airliners() -> None:
    traffic = draw(np.random.default_rng(1), 90)
    t = np.broadcast_to(TIME_S, (90, len(TIME_S)))
    where = traffic.enu(t)
    far = np.linalg.norm(where, axis=2)
    assert far.shape == (90, len(TIME_S))
    assert far.min() > 20e3
    assert far.max() < 100e3
    speed = np.linalg.norm(np.diff(where, axis=1), axis=2) / np.diff(TIME_S)
    # A sphere's degrees on an ellipsoid: within half a per cent; and a climb.
    assert speed.min() > 188
    assert speed.max() < 253
    np.testing.assert_allclose(speed.std(axis=1), 0.0, atol=1.5)


def test_without_noise_the_truth_is_found_by_the_second_fit() -> None:
    rng = np.random.default_rng(2)
    turn = np.array([0.25, -0.2, 0.3]) * DEG
    exact = Errors(OFFSET_M, turn, np.zeros(3), 0.3, np.full(3, 0.01), True)
    traffic = draw(rng, 40)
    found = least_squares(exact.measure(rng, traffic), traffic)
    off = dict(zip(MODEL, found.value - exact.truth(), strict=True))
    for name in ("site_east", "site_north", "site_up", "range_bias"):
        assert abs(off[name]) < 3.0
    for name in ("azimuth_bias", "elevation_bias", "tilt_north", "tilt_east"):
        assert abs(off[name]) < 0.003 * DEG
    assert abs(off["time_offset"]) < 0.003


def test_scenes_have_the_errors_that_they_should() -> None:
    rng = np.random.default_rng(3)
    shifted = errors_of("scene 1", rng)
    traffic = draw(rng, 90)
    plots = shifted.measure(rng, traffic)
    truth = traffic.enu(np.broadcast_to(TIME_S, plots.shape[:2]))
    from boresight.measure import enu_from_polar

    off = (enu_from_polar(plots) - truth).reshape(-1, 3)
    np.testing.assert_allclose(off.mean(axis=0), OFFSET_M, atol=2.5)
    np.testing.assert_allclose(off.std(axis=0), 50.0, rtol=0.03)
    turned = errors_of("scene 2", rng)
    assert ((np.abs(turned.turn_rad) >= 0.2 * DEG) & (np.abs(turned.turn_rad) <= 0.3 * DEG)).all()
    np.testing.assert_allclose(rotation_of(turned.turn_rad) @ rotation_of(turned.turn_rad).T, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(errors_of("white", rng).truth()[3:], 0.0)


def test_a_bias_in_every_prediction_changes_the_velocity_and_nothing_else() -> None:
    t = TIME_S
    z = np.stack([1e4 + 200 * t, 2e4 - 50 * t, np.full(len(t), 9e3)], axis=1)[None]
    r = np.tile(np.eye(3) * 50.0**2, (1, len(t), 1, 1))
    plain, biased = predicted_with_bias(z, r, np.zeros(3)), predicted_with_bias(z, r, np.array([100.0, -50.0, 20.0]))
    assert np.abs(plain - biased)[:, 5:].max() > 0.0
    assert np.abs(plain - biased)[:, 60:].max() < 1.0
