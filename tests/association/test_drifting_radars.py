"""Radars whose biases drift and jump: tracks of known identity are paired all the same, and wrong ones still are not."""

from pathlib import Path

import duckdb
import numpy as np
import pytest

from boresight import locate
from boresight.association import Association, search
from boresight.cli import main
from boresight.errors import NothingToDo
from boresight.model import Fixes, Plots
from boresight.simulation import Adsb, Radar, Scenario, Simulated, Traffic, load_scenario, simulate
from boresight.simulation.drift import Drift, Sine, Step, history
from boresight.targets import targets_of

# Paper 002's noise, and drifts of its sines' sizes in units of it (METHODS section 5).
RANGE_SD_M, AZIMUTH_SD_DEG = 100.0, 0.3


def sine(value: float, amplitude: float) -> Drift:
    return Drift(value=value, sine=(Sine(amplitude=amplitude, period_s=400.0),))


def steps(value: float, *at: tuple[float, float]) -> Drift:
    return Drift(value=value, step=tuple(Step(at_s=when, by=by) for when, by in at))


ERRORS: dict[str, dict[str, float | Drift]] = {
    "the paper's": {"range_bias": sine(250.0, 120.0), "azimuth_bias": sine(0.5, 1.0)},
    "five sd": {"range_bias": sine(250.0, 5 * RANGE_SD_M), "azimuth_bias": sine(0.5, 5 * AZIMUTH_SD_DEG)},
    "late as well": {"range_bias": sine(250.0, 500.0), "azimuth_bias": sine(0.5, 1.5), "time_offset": 1.0},
    "steps of ten sd": {"range_bias": steps(50.0, (500.0, 1000.0)), "azimuth_bias": steps(0.5, (800.0, 3.0))},
    "a step near the end": {"range_bias": steps(50.0, (1100.0, 1000.0))},
    "there and back": {"azimuth_bias": steps(-1.0, (300.0, 3.0), (600.0, -3.0), (900.0, 3.0))},
    "walks": {"range_bias": Drift(ramp_per_h=3000.0, walk_per_sqrt_h=600.0), "azimuth_bias": Drift(walk_per_sqrt_h=3.0)},
}


def flown(
    errors: dict[str, float | Drift], seed: int = 1, aircraft: int = 12, seconds: float = 1200.0
) -> tuple[Simulated, Fixes]:
    """A radar over traffic that all sends ADS-B; sensors.toml tells nothing of the noise."""
    radar = Radar(
        name="R", sac=1, sic=1, lat_deg=45.0, lon_deg=8.0, height_m=204.0, kind="mode_s", scan_s=2.0, max_range_m=80e3,
        range_sd_m=RANGE_SD_M, azimuth_sd_deg=AZIMUTH_SD_DEG, errors=errors,
    )  # fmt: skip
    traffic = Traffic(aircraft=aircraft, lat_deg=45.0, lon_deg=8.0, radius_m=60e3, arrivals=0.0, departures=0.0, local=0.5)
    run = simulate(Scenario(duration_s=seconds, traffic=traffic, radar=(radar,), adsb=Adsb(share=1.0)), seed=seed)
    fixes, _ = locate(run.fixes, run.sensors, ())
    return run, fixes


def wrong(run: Simulated, fixes: Fixes, found: Association) -> int:
    """How many pairs are of another target."""
    target = targets_of(fixes)
    owner = np.full(int(target.max()) + 1, -2)
    owner[target] = run.fix_target
    return int(np.sum(owner[found.pairs.target] != run.plot_target[found.pairs.plot]))


def pairable(found: Association) -> int:
    return len(found.reason) - found.not_used.get("no reference at that time", 0)


def with_codes(plots: Plots, new: dict[int, int]) -> Plots:
    """Some Mode S addresses replaced by others; callsigns and Mode 3/A codes taken away from all."""
    code = plots.mode_s.copy()
    for old, other in new.items():
        code[plots.mode_s == old] = other
    nobody = np.full(len(plots), -1)
    return plots.replace(mode_s=code, callsign=nobody, mode_3a=nobody)


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("seed", [1, 2])
def test_drifting_radars_are_paired_whole(name: str, seed: int) -> None:
    """Every plot that has a reference is paired with the right one: no part of a drift or a step is cut off."""
    run, fixes = flown(ERRORS[name], seed)
    found = search(run.plots, fixes, run.sensors)
    assert wrong(run, fixes, found) == 0
    assert len(found.pairs) >= 0.995 * pairable(found)
    assert found.bias[0].by == "identity"
    assert any("biases change while it records" in said for said in found.warnings)
    late = ERRORS[name].get("time_offset", 0.0)
    assert isinstance(late, float)
    assert found.bias[0].time_s == pytest.approx(late, abs=0.25)
    # The pairs hold what was measured: their errors are the true ones, drift and all.
    assert np.array_equal(found.pairs.plots.range_m, run.plots.range_m[found.pairs.plot])


def test_two_aircraft_are_enough() -> None:
    """The paper's two targets: what they agree on while both are seen is believed."""
    run, fixes = flown(ERRORS["five sd"], 1, aircraft=2)
    found = search(run.plots, fixes, run.sensors)
    assert wrong(run, fixes, found) == 0
    assert len(found.pairs) >= 0.99 * pairable(found)


def test_a_radar_that_does_not_drift_is_not_said_to() -> None:
    """Constant biases, and a noise three times that assumed: paired whole, and nothing is said of changes."""
    run, fixes = flown({"range_bias": 50.0, "azimuth_bias": 0.5})
    found = search(run.plots, fixes, run.sensors)
    assert wrong(run, fixes, found) == 0
    assert len(found.pairs) >= 0.995 * pairable(found)
    assert not any("change while" in said for said in found.warnings)
    assert found.bias[0].by == "identity"


def test_some_swapped_codes_in_a_drift() -> None:
    """Four of twelve aircraft carry each other's address: none is paired by it, the others are."""
    run, fixes = flown(ERRORS["five sd"])
    codes = np.unique(run.plots.mode_s)[:4].tolist()
    plots = with_codes(run.plots, dict(zip(codes, np.roll(codes, 1).tolist(), strict=True)))
    fixes = fixes.replace(callsign=np.full(len(fixes), -1), mode_3a=np.full(len(fixes), -1))
    found = search(plots, fixes, run.sensors)
    assert wrong(run, fixes, found) == 0
    honest = ~np.isin(run.plots.mode_s, codes) & (found.reason != 8)
    assert np.isin(np.flatnonzero(honest), found.pairs.plot).mean() > 0.99


@pytest.mark.parametrize("name", ["the paper's", "steps of ten sd"])
def test_all_codes_swapped_are_refused(name: str) -> None:
    """Each aircraft carries the next one's address: a course that changes does not explain that."""
    run, fixes = flown(ERRORS[name])
    codes = np.unique(run.plots.mode_s).tolist()
    plots = with_codes(run.plots, dict(zip(codes, np.roll(codes, 1).tolist(), strict=True)))
    fixes = fixes.replace(callsign=np.full(len(fixes), -1), mode_3a=np.full(len(fixes), -1))
    with pytest.raises(NothingToDo):
        search(plots, fixes, run.sensors)


@pytest.mark.parametrize("aircraft", [2, 12])
@pytest.mark.parametrize("late_s", [20.0, 120.0, 300.0])
def test_clocks_that_are_far_off_are_refused(late_s: float, aircraft: int) -> None:
    """A late clock moves each track along its own way: that is no course of the radar's."""
    run, fixes = flown(ERRORS["the paper's"], 1, aircraft)
    with pytest.raises(NothingToDo):
        search(run.plots.replace(time_s=run.plots.time_s + late_s), fixes, run.sensors)


def test_the_course_is_taken_off_for_the_pairing_only() -> None:
    """What association calls the biases is about the mean of what they truly were."""
    run, fixes = flown(ERRORS["five sd"])
    bias = search(run.plots, fixes, run.sensors).bias[0]
    assert bias.range_m == pytest.approx(250.0, abs=60.0)
    assert np.degrees(bias.azimuth_rad) == pytest.approx(0.5, abs=0.15)
    assert bias.tracks >= 12


@pytest.mark.slow
def test_the_papers_two_radars_from_end_to_end(tmp_path: Path) -> None:
    """The example of paper 002: without a reference the difference of the radars' errors is followed, its jump too."""
    (scene,) = (Path(__file__).parents[2] / "examples").glob("two-radars-at-one-place.toml")
    out = tmp_path / "relative"
    recordings = [tmp_path / "run" / name for name in ("main.ast", "second.ast")]
    calls: list[list[object]] = [
        ["simulate", scene, "--out", tmp_path / "run"],
        ["calibrate", *recordings, "--sensors", tmp_path / "run" / "sensors.toml", "--date", "2026-04-01", "--out", out],
    ]
    for words in calls:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        assert ended.value.code in (0, None)
    first, second = load_scenario(scene).radar
    start = np.datetime64("2026-04-01T12:00:00")
    for term, worst in (("range_bias", 40.0), ("azimuth_bias", 0.15)):
        rows = duckdb.sql(f"SELECT time, value FROM '{out / 'biases.csv'}' WHERE term = '{term}'").fetchnumpy()
        seconds = (rows["time"].astype("datetime64[us]") - start) / np.timedelta64(1, "s")
        truth = history(second.errors[term], 1200.0, np.random.default_rng(0))(seconds) - first.errors[term]
        settled = seconds > 30.0
        assert settled.sum() > 300
        assert np.sqrt(np.mean((rows["value"] - truth)[settled] ** 2)) < worst
        assert np.ptp(truth) > 6 * worst
