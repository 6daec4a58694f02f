"""Sets of plots that cannot tell everything: limits are named, no number is given for what cannot be known, nothing fails."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import DEG, FULL, RADARS, WHITE, airliner, path, scene

from boresight.calibration import Calibration
from boresight.errors import NothingToDo
from boresight.model import Pairs, Sensors
from boresight.registration import LeastSquares, register

ONE = Sensors((RADARS.sensor[0],))
TRUTH = {"A": {"range_bias": 100.0, "azimuth_bias": 0.2 * DEG, "time_offset": 0.3}}
AUTO = [LeastSquares(), LeastSquares(criterion="bic"), LeastSquares(criterion="none")]


def checked(pairs: Pairs, settings: LeastSquares = AUTO[0], model: str = "auto") -> Calibration:
    """The result, with what every result must hold."""
    found = register(pairs, ONE, model=model, settings=settings)
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.sd).all()
    assert (found.sd > 0).all()
    known = {k.name for k in found.terms}
    missing = {n.term for n in found.not_determined}
    assert not known & missing
    assert all(n.why for n in found.not_determined)
    # What nobody could tell is said of each core term.
    assert {"range_bias", "azimuth_bias", "time_offset"} <= known | missing
    for verdict in found.sensors[0].verdicts:
        assert verdict.why
        k = found.index(next(iter(ONE)).key, verdict.term)
        if verdict.decision == "apply" and not verdict.gain_low_m > 0:
            # Only what is there beyond doubt, and does help, is applied without that.
            assert verdict.gain_m > 0
            assert k is not None
            assert abs(found.value[0, k]) > 3.3 * found.sd[0, k]
        else:
            assert (verdict.decision == "apply") == (verdict.gain_low_m > 0)
    str(found)
    return found


def radial(begin_m: float = 60e3) -> Pairs:
    """One aircraft straight towards the radar."""
    position = path(46.0, 14.0, 0.0, begin_m, np.pi, 200.0, 0.0, 9e3, 0.0, 400.0)
    return scene(2, TRUTH, sensors=ONE, errors=WHITE, targets=1, track=lambda rng: (position, 0.0, 480.0, 40.0)).pairs


@pytest.mark.parametrize("settings", AUTO, ids=lambda s: s.criterion)
def test_one_radial_track(settings: LeastSquares) -> None:
    found = checked(radial(), settings)
    assert "time_offset" in {n.term for n in found.not_determined}
    assert any("range_bias also holds what there is of time_offset" in note for note in found.sensors[0].notes)
    assert {v.decision for v in found.sensors[0].verdicts} == {"insufficient"}
    assert "time_offset" in {v.term for v in found.sensors[0].verdicts}


@pytest.mark.parametrize("settings", AUTO, ids=lambda s: s.criterion)
def test_one_target(settings: LeastSquares) -> None:
    s = scene(6, TRUTH, sensors=ONE, errors=FULL, targets=6)
    found = checked(s.pairs[s.pairs.target == 3], settings)
    assert {v.decision for v in found.sensors[0].verdicts} == {"insufficient"}
    assert all("1 target" in v.why for v in found.sensors[0].verdicts if v.term in {k.name for k in found.terms})
    # Its own delay and latency are in everything: the sd say so.
    assert found.sd[0, 0] > 8
    if settings.criterion != "none":
        assert {k.name for k in found.terms} <= {"range_bias", "azimuth_bias", "time_offset"}
        assert "azimuth_cos" in {n.term for n in found.not_determined}


@pytest.mark.parametrize("settings", AUTO[:2], ids=lambda s: s.criterion)
def test_one_sector(settings: LeastSquares) -> None:
    """All traffic within ten degrees: harmonics, tilt and a bias are one."""

    def track(rng: np.random.Generator) -> tuple:
        bearing = rng.uniform(40, 50) * DEG
        far = rng.uniform(40e3, 100e3)
        position = path(
            46.0, 14.0, far * np.sin(bearing), far * np.cos(bearing), rng.uniform(0, 2 * np.pi), 60.0, 0.0, 9e3, 0.0, 100.0
        )
        return position, 0.0, 200.0, 40.0

    s = scene(3, TRUTH, sensors=ONE, errors=FULL, targets=20, track=track)
    found = checked(s.pairs, settings)
    for k, key in enumerate(found.terms):
        assert abs(found.value[0, k] - TRUTH["A"].get(key.name, 0.0)) <= 4 * found.sd[0, k]
    assert not {"azimuth_cos", "azimuth_sin"} & {k.name for k in found.terms}


def test_elevation_zero() -> None:
    """Targets at the height of the antenna: tan E is nothing, sec E is 1."""

    def track(rng: np.random.Generator) -> tuple:
        x, y = rng.uniform(-8e3, 8e3, 2)
        return path(46.0, 14.0, x, y, rng.uniform(0, 6), 12.0, 0.0, 300.0, 0.0, 100.0), 0.0, 200.0, 40.0

    s = scene(4, TRUTH, sensors=ONE, errors=WHITE, targets=12, track=track, near_m=500.0)
    found = checked(s.pairs)
    assert not {"tilt_north", "tilt_east", "nonorthogonality", "collimation", "site_up"} & {k.name for k in found.terms}
    asked = checked(s.pairs, model="range_bias,azimuth_bias,time_offset,tilt_north,tilt_east,nonorthogonality,collimation")
    assert {"tilt_north", "tilt_east", "nonorthogonality", "collimation"} <= {n.term for n in asked.not_determined}


def test_all_outliers() -> None:
    rng = np.random.default_rng(0)
    p = scene(6, {}, sensors=ONE, targets=6).pairs
    wild = p.replace(
        plots=p.plots.replace(range_m=rng.uniform(1e3, 150e3, len(p)), azimuth_rad=rng.uniform(0, 2 * np.pi, len(p)))
    )
    try:
        found = checked(wild)
    except NothingToDo:
        return
    assert found.sensors[0].noise.range_m > 1e3
    assert "apply" not in {v.decision for v in found.sensors[0].verdicts}


@pytest.mark.parametrize("settings", AUTO, ids=lambda s: s.criterion)
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_plots(count: int, settings: LeastSquares) -> None:
    found = checked(radial()[:count], settings)
    assert {v.decision for v in found.sensors[0].verdicts} == {"insufficient"}
    assert "time_offset" in {n.term for n in found.not_determined}
    assert found.sd[0, 0] > 8


def test_the_same_plot_twice() -> None:
    p = radial()[:1]
    found = checked(Pairs.concat([p, p]))
    assert {v.decision for v in found.sensors[0].verdicts} == {"insufficient"}
    many = scene(1, TRUTH, sensors=ONE, targets=8).pairs
    once, twice = checked(many, model="atc"), checked(Pairs.concat([many, many]), model="atc")
    assert np.allclose(once.value, twice.value, atol=2 * once.sd.max())


def test_three_targets_are_too_few_for_a_search() -> None:
    rng = np.random.default_rng(1)
    tracks = iter([airliner(rng) for _ in range(3)])
    s = scene(1, TRUTH, sensors=ONE, targets=3, track=lambda _: next(tracks))
    found = checked(s.pairs)
    assert {c.action for c in found.sensors[0].choices} <= {"not tested"}
    assert all("3 targets" in v.why or "at least" in v.why for v in found.sensors[0].verdicts)
