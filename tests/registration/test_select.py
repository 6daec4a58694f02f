"""The search for a model, the verdicts and the error budget, against the truth of simulated scenes."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import DEG, FULL, RADARS, SURFACE, WHITE, Errors, Scene, random_truth, scene, taxiing

from boresight.calibration import Calibration, advised
from boresight.errors import SettingsError
from boresight.model import Sensors
from boresight.registration import LeastSquares, register
from boresight.registration.select import CORE, EXTENTS, held_out, misfit, units
from boresight.terms import precision, terms_of

ONE = Sensors((RADARS.sensor[0],))
PLAIN = {"range_bias": 80.0, "azimuth_bias": 0.3 * DEG, "time_offset": 0.4}


def names(found: Calibration) -> set[str]:
    return {k.name for k in found.terms}


def simulated(seed: int, truth: dict[str, float], errors: Errors = FULL, targets: int = 24) -> Scene:
    return scene(seed, {"A": truth}, sensors=ONE, errors=errors, targets=targets, scan_s=12.0)


def test_a_model_that_lacks_nothing_is_seldom_added_to_and_its_sd_stay_true() -> None:
    """Over 60 seeds 5 % of the scenes get a term that is not there; of 8 more than 3 would be one chance in a thousand."""
    more, z = 0, []
    for seed in range(8):
        found = register((s := simulated(seed, PLAIN)).pairs, s.sensors)
        assert set(PLAIN) <= names(found)
        more += bool(names(found) - set(CORE))
        z += [(found.value[0, k] - PLAIN.get(t.name, 0.0)) / found.sd[0, k] for k, t in enumerate(found.terms) if t.name in PLAIN]
    assert more <= 3
    assert np.mean(np.abs(z) <= 2) >= 0.85
    assert np.abs(z).max() <= 4


@pytest.mark.parametrize("criterion", ["cross-validation", "bic"])
@pytest.mark.parametrize(
    "extra",
    [
        {"azimuth_cos": 0.06 * DEG, "azimuth_sin": -0.05 * DEG},
        {"azimuth_cos2": 0.05 * DEG, "azimuth_sin2": 0.05 * DEG},
        {"range_gain": 6e-4},
        {"tilt_north": 0.4 * DEG, "tilt_east": -0.4 * DEG},
    ],
    ids=lambda extra: next(iter(extra)),
)
def test_what_matters_is_chosen(extra: dict[str, float], criterion: str) -> None:
    s = simulated(3, PLAIN | extra)
    found = register(s.pairs, s.sensors, settings=LeastSquares(criterion=criterion))
    summary = found.sensors[0]
    assert set(extra) <= names(found)
    assert summary.criterion == criterion
    assert summary.choices[0].action == "start"
    assert {c.action for c in summary.choices} <= {"start", "add", "drop", "replace", "leave out"}
    for k, term in enumerate(found.terms):
        assert abs(found.value[0, k] - s.truth["A"].get(term.name, 0.0)) <= 4.5 * found.sd[0, k], term.name
    decisions = {v.term: v.decision for v in summary.verdicts}
    assert set(decisions) == names(found)
    assert all(decisions[name] == "apply" for name in extra)


def test_a_lag_is_chosen_where_targets_turn() -> None:
    s = scene(
        2, {"SMR": {"range_bias": 3.0, "azimuth_bias": 0.2 * DEG, "along_heading_per_length": -0.4, "range_lag": 4.0}},
        sensors=SURFACE, track=taxiing, errors=Errors(range_m=1.0, azimuth_rad=0.05 * DEG, offset_m=0.5, offset_memory_s=60.0),
        scan_s=1.0, near_m=150.0,
    )  # fmt: skip
    found = register(s.pairs, s.sensors)
    assert {"range_lag", "along_heading_per_length"} <= names(found)


@pytest.mark.parametrize(("extent", "value"), [("along_heading_per_length", -0.4), ("along_heading", -9.0)])
def test_one_extent_stays_the_one_that_is_there(extent: str, value: float) -> None:
    noise = Errors(range_m=2.0, azimuth_rad=0.1 * DEG, offset_m=1.0, offset_memory_s=60.0)
    s = scene(4, {"SMR": {extent: value}}, sensors=SURFACE, track=taxiing, errors=noise, scan_s=1.0, near_m=150.0)
    found = register(s.pairs, s.sensors)
    assert names(found) & set(EXTENTS) == {extent}
    assert "no extent" in {c.term for c in found.sensors[0].choices}


def test_none_takes_the_usual_terms_and_a_model_that_is_given_stays_as_it_is() -> None:
    s = simulated(1, PLAIN)
    usual = register(s.pairs, s.sensors, settings=LeastSquares(criterion="none"))
    given = register(s.pairs, s.sensors, model="atc")
    assert usual.sensors[0].model == "atc"
    assert names(usual) == names(given) > set(PLAIN)
    assert np.array_equal(usual.value, given.value)
    assert given.sensors[0].criterion == ""
    assert not given.sensors[0].choices
    # Terms that are not there are held, those that are there applied.
    decisions = {v.term: v.decision for v in given.sensors[0].verdicts}
    assert {decisions[t] for t in PLAIN} == {"apply"}
    assert decisions["azimuth_cos"] == decisions["azimuth_sin"] == "hold"
    assert names(advised(given)) == {t for t, decision in decisions.items() if decision == "apply"}
    with pytest.raises(SettingsError, match="criterion"):
        register(s.pairs, s.sensors, settings=LeastSquares(criterion="aic"))


def test_the_gain_is_what_held_out_targets_gain() -> None:
    """A range bias of 200 m among errors known otherwise: without it the error grows as the squares say."""
    s = simulated(5, {"range_bias": 200.0}, errors=WHITE)
    found = register(s.pairs, s.sensors, model="range_bias,azimuth_bias,time_offset")
    verdict = next(v for v in found.sensors[0].verdicts if v.term == "range_bias")
    # Each coordinate counts by its inverse variance; a distance has two of them.
    along, across = WHITE.range_m**-2.0, np.mean((s.pairs.plots.range_m * WHITE.azimuth_rad) ** -2.0)
    weight = (along + across) / 2
    left = np.sqrt(2 / weight)
    # The other terms take up a part of it where they can, so the gain is somewhat smaller.
    assert verdict.gain_m == pytest.approx(np.sqrt(left**2 + 200.0**2 * along / weight) - left, rel=0.1)
    assert verdict.gain_low_m < verdict.gain_m < verdict.gain_high_m
    held = next(v for v in found.sensors[0].verdicts if v.term == "time_offset")
    assert held.decision == "hold"
    assert held.gain_low_m <= 0


def test_the_budget_adds_up_to_the_error_that_is_there() -> None:
    s = simulated(6, random_truth(6)["A"], errors=Errors(delay_m=15.0, latency_s=0.1, offset_m=15.0), targets=40)
    found = register(s.pairs, s.sensors)
    shares = {b.cause: b for b in found.sensors[0].budget}
    assert list(shares) == ["bias", "noise", "reference", "timing", "height"]
    from test_register import geometry_of_pairs

    from boresight.measure import wrap_rad

    site = geometry_of_pairs(s)
    off = s.pairs.plots.range_m - site.range_m
    across = wrap_rad(s.pairs.plots.azimuth_rad - site.azimuth_rad) * site.range_m * np.cos(site.elevation_rad)
    assert sum(b.range_m**2 for b in shares.values()) == pytest.approx(np.mean(off**2), rel=0.1)
    assert sum(b.cross_m**2 for b in shares.values()) == pytest.approx(np.mean(across**2), rel=0.1)
    assert shares["noise"].range_m == pytest.approx(FULL.range_m, rel=0.1)
    # An uncertain height shows in range, and nowhere else.
    up = s.pairs.position / np.linalg.norm(s.pairs.position, axis=1)[:, None]
    high = s.pairs.replace(covariance=300.0**2 * np.einsum("ni,nj->nij", up, up))
    height = {b.cause: b for b in register(high, s.sensors, model="atc").sensors[0].budget}["height"]
    assert height.range_m > 1
    assert height.cross_m == 0


def test_held_out_values_are_those_of_the_other_targets() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(12, 40, 3)), rng.normal(size=(12, 40))
    m = np.concatenate([x, y[:, :, None]], axis=2)
    normal, fold = np.swapaxes(m, 1, 2) @ m, np.arange(12) % 5
    value = held_out(normal, np.eye(3) * 1e-9, fold)
    for k in range(5):
        rest = fold != k
        expected = np.linalg.lstsq(x[rest].reshape(-1, 3), y[rest].ravel(), rcond=None)[0]
        assert np.allclose(value[~rest], expected)
    assert np.allclose(misfit(normal, value), ((y - np.einsum("gnp,gp->gn", x, value)) ** 2).sum(axis=1))


def test_harmonics_and_tables_come_and_go_together() -> None:
    terms = terms_of("range_bias,azimuth_cos,azimuth_bias,azimuth_sin,range_table")
    found = {tuple(sorted({terms[k].name.rpartition("_")[0] for k in u})): len(u) for u in units(terms)}
    assert found[("azimuth",)] in (1, 2)
    assert found[("range_table",)] == len(terms) - 4
    assert sorted(k for u in units(terms) for k in u) == list(range(len(terms)))
    assert precision(terms).shape == (len(terms), len(terms))
