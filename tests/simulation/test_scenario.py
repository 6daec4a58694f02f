"""Scenario files, the ready-made scenes, and their files read back."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import numpy as np
import pytest

from boresight.errors import InputError, SettingsError
from boresight.measure import wrap_rad
from boresight.model import load_sensors
from boresight.reading import read
from boresight.simulation import Radar, Scenario, Simulated, load_scenario, simulate
from boresight.simulation.demo import association_scene, demo_scene, write_demo
from boresight.simulation.files import sensors_toml, write_scene
from boresight.terms import TERMS

SCENE = """
name = "two radars"
start = 2026-05-04T23:50:00Z
duration_s = 900.0

[traffic]
aircraft = 8
lat_deg = 50.0
lon_deg = 8.5

[[airport]]
lat_deg = 50.03
lon_deg = 8.56
height_m = 160.0

[atmosphere]
isa_deviation_k = -5.0

[[radar]]
name = "one"
sac = 1
sic = 2
lat_deg = 50.1
lon_deg = 8.6
errors = { range_bias = 80.0, time_offset = -0.25 }

[[radar]]
name = "two"
sac = 1
sic = 3
lat_deg = 49.9
lon_deg = 8.2
kind = "psr"
elevation_sd_deg = 0.2
errors = { elevation_bias = 0.3, tilt_north = -0.1 }

[adsb]
share = 0.75
classes = { "9" = 1.0 }
"""


def test_a_scenario_from_toml(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    scenario = load_scenario(path)
    assert scenario.start == datetime.datetime(2026, 5, 4, 23, 50, tzinfo=datetime.UTC)
    assert [r.name for r in scenario.radar] == ["one", "two"]
    assert scenario.radar[0].errors["time_offset"] == -0.25
    run = simulate(scenario, 3)
    assert np.count_nonzero(run.truth.aircraft.accuracy == 9) == 6
    assert run.errors["two"] == {"elevation_bias": 0.3, "tilt_north": -0.1}
    assert np.isfinite(run.observations[1].plots.elevation_rad).all()
    assert [s.name for s in run.sensors] == ["one", "two"]
    # The scene crosses midnight.
    assert run.plots.time_s.max() > datetime.datetime(2026, 5, 5, tzinfo=datetime.UTC).timestamp()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("range_bias = 80.0", "range_bais = 80.0", "range_bais.*Terms: range_bias"),
        ('kind = "psr"', 'kind = "lidar"', "lidar"),
        ("elevation_sd_deg = 0.2", "", "needs a radar that measures elevation"),
        ("aircraft = 8", "aircraft = 0", "aircraft = 0"),
        ("aircraft = 8", "aircrafts = 8", r"aircrafts.*Known keys: aircraft"),
        ("sic = 3", "sic = 2", "used before"),
        ("duration_s = 900.0", 'duration_s = "long"', r"float.*duration_s"),
        ("2026-05-04T23:50:00Z", "2026-05-04T23:50:00", "time zone"),
        ('"9" = 1.0', '"12" = 1.0', "NACp"),
        ("[[airport]]", "[[[airport", "not TOML"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "scene.toml"
    assert old in SCENE
    path.write_text(SCENE.replace(old, new, 1))
    with pytest.raises(SettingsError, match=says) as caught:
        load_scenario(path)
    assert "scene.toml" in str(caught.value)


def test_a_missing_scenario_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        load_scenario(tmp_path / "none.toml")


def test_radar_defaults_make_a_scene() -> None:
    radar = Radar(name="r", sac=1, sic=1, lat_deg=41.3, lon_deg=2.1)
    from boresight.simulation import Traffic

    run = simulate(Scenario(duration_s=300.0, traffic=Traffic(aircraft=4, arrivals=0, departures=0), radar=(radar,)), 1)
    assert len(run.plots) > 100
    assert len(run.fixes) == 0


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Simulated, Path]:
    folder = tmp_path_factory.mktemp("demo")
    run = simulate(demo_scene(7), 7)
    write_scene(run, folder)
    return run, folder


def test_the_files_hold_the_scene(demo: tuple[Simulated, Path]) -> None:
    """What the reader gives is what was simulated, row by row, to the quanta of ASTERIX."""
    run, folder = demo
    date = run.scenario.start.date()
    for radar, seen in zip(run.scenario.radar, run.observations, strict=True):
        recording = read(folder / f"{radar.name}.ast", date=date)
        assert not recording.damaged
        assert recording.records == len(seen.plots) + len(seen.marks.time_s)
        found, given = recording.plots, seen.plots
        assert len(found) == len(given)
        np.testing.assert_allclose(found.time_s, given.time_s, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.range_m, given.range_m, rtol=0, atol=1e-6)
        np.testing.assert_allclose(wrap_rad(found.azimuth_rad - given.azimuth_rad), 0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.pressure_altitude_m, given.pressure_altitude_m, rtol=0, atol=1e-6)
        for column in ("sensor", "channel", "mode_s", "mode_3a", "callsign", "track", "flags"):
            np.testing.assert_array_equal(getattr(found, column), getattr(given, column), err_msg=column)
        if radar.kind == "marine":
            assert {s.category for s in recording.sources} == {10}
            continue
        (source,) = [s for s in recording.sources if s.category == 34]
        assert np.degrees(source.latitude_rad) == pytest.approx(radar.lat_deg, abs=1.1e-5)
        assert np.degrees(source.longitude_rad) == pytest.approx(radar.lon_deg, abs=1.1e-5)
        assert source.height_m == pytest.approx(radar.height_m, abs=0.5)
    recording = read(folder / "adsb.ast", date=date)
    found_fixes, fixes = recording.fixes, run.fixes
    assert not recording.damaged
    assert len(found_fixes) == len(fixes)
    np.testing.assert_allclose(found_fixes.time_s, fixes.time_s, rtol=0, atol=1e-6)
    for name, quantum in (
        ("latitude_rad", np.radians(180 / 2**30)),
        ("longitude_rad", np.radians(180 / 2**30)),
        ("height_m", 1e-5),
        ("pressure_altitude_m", 1e-5),
        ("velocity_up_mps", 6.25 * 0.3048 / 60),
        ("horizontal_sd_m", 0.01),
    ):
        np.testing.assert_allclose(getattr(found_fixes, name), getattr(fixes, name), rtol=0, atol=0.51 * quantum, err_msg=name)
    for name in ("velocity_east_mps", "velocity_north_mps"):
        np.testing.assert_allclose(getattr(found_fixes, name), getattr(fixes, name), rtol=0, atol=0.08, err_msg=name)
    for column in ("source", "channel", "mode_s", "mode_3a", "callsign", "track", "flags"):
        np.testing.assert_array_equal(getattr(found_fixes, column), getattr(fixes, column), err_msg=column)


def test_sensors_and_truth_files(demo: tuple[Simulated, Path]) -> None:
    run, folder = demo
    sensors = load_sensors(folder / "sensors.toml")
    assert sensors == run.sensors
    truth = json.loads((folder / "truth.json").read_text())["sensors"]
    for radar in run.scenario.radar:
        assert {term: row["true"] for term, row in truth[radar.name].items()} == radar.errors
        assert all(row["unit"] == TERMS[term].unit for term, row in truth[radar.name].items())
        # Nothing of the true errors may be given away.
        assert not any(term in sensors_toml(sensors) for term in radar.errors if term != "time_offset")
        assert sensors.find(radar.sac << 8 | radar.sic).time_offset_s == 0.0


def test_the_demonstration_shows_a_region(demo: tuple[Simulated, Path]) -> None:
    """Plots near and far, low and high, all around: or the errors could not be told apart."""
    run, _ = demo
    for seen, furthest in zip(run.observations[:2], (200e3, 100e3), strict=True):
        assert len(np.unique(seen.target)) >= 40
        assert seen.target.max() < 60
        assert seen.plots.range_m.max() > furthest
        assert seen.plots.range_m.min() < 20e3
        sectors = np.unique((seen.plots.azimuth_rad / (np.pi / 4)).astype(int))
        assert len(sectors) == 8
    coast = run.observations[2]
    assert set(np.unique(coast.target)) <= set(range(60, 80))
    assert len(np.unique(coast.target)) >= 18
    assert (coast.plots.mode_s == -1).all()
    assert np.isnan(coast.plots.pressure_altitude_m).all()
    assert len(run.truth) == 80
    assert len(np.unique(run.fix_target)) == 54
    assert run.ais is not None
    assert len(np.unique(run.ais.target)) == 20


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    first, again, other = (write_demo(tmp_path / name, seed) for name, seed in (("a", 1), ("b", 1), ("c", 2)))
    for x, y, z in zip(first.plots + first.reference, again.plots + again.reference, other.plots + other.reference, strict=True):
        assert x.read_bytes() == y.read_bytes()
        assert x.read_bytes() != z.read_bytes()
    assert first.truth_file.read_bytes() == again.truth_file.read_bytes()
    assert first.truth != other.truth
    assert first.date == datetime.date(2026, 3, 1)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here")
    with pytest.raises(InputError, match="cannot be made"):
        write_demo(tmp_path / "file" / "demo")


def test_the_association_scene_is_hard() -> None:
    biases = [association_scene(seed).radar[0].errors for seed in range(30)]
    azimuth = np.abs([b["azimuth_bias"] for b in biases])
    assert azimuth.min() >= 1.4
    assert 2.5 < azimuth.max() <= 2.8
    run = simulate(association_scene(3), 3)
    seen = run.observations[0]
    assert len(np.unique(seen.target)) == 90
    without = run.truth.aircraft.accuracy < 0
    assert np.count_nonzero(without) == 18
    assert not np.isin(run.fix_target, np.flatnonzero(without)).any()
    assert (seen.plots.mode_s == -1).all()
    assert (seen.plots.mode_3a == -1).all()
    assert np.isnan(seen.plots.pressure_altitude_m).all()
    assert (seen.plots.track > 0).all()
    assert seen.plots.range_m.max() < 106e3
