"""A simulated ship: its way, its swinging, its antenna and its reports; and what a calibration of its radar makes of them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from boresight.alignment import apply_time_offsets, locate, states, trajectories
from boresight.association import search
from boresight.calibration import Calibration
from boresight.errors import NothingToDo, SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, local_enu, rotate
from boresight.measure import polar_from_enu, polar_from_position, site_of, wrap_rad
from boresight.model import Fixes, Flag, Platform, Plots, Sensor, Sensors
from boresight.platform import platform_views
from boresight.reading.nmea import read_nmea
from boresight.registration import register
from boresight.simulation.vessel import Vessel, attitude, check_vessel, own_ship, pose, settled
from boresight.writing.nmea import write_nmea

DEG = np.pi / 180
EPOCH = 1.7e9
SHIP = Vessel(lat_deg=54.5, lon_deg=10.5, height_m=30.0, speed_mps=8.0, course_deg=60.0)


def change(vessel: Vessel, **what: object) -> Vessel:
    return msgspec.structs.replace(vessel, **what)


def east_north(vessel: Vessel, seconds: np.ndarray) -> np.ndarray:
    start = np.radians(vessel.lat_deg), np.radians(vessel.lon_deg), vessel.height_m
    return local_enu(attitude(vessel, seconds).position, *start)


# ------------------------------------------------------------------------------------------------------------------- the way


def test_a_straight_way_goes_on_at_its_speed_and_course() -> None:
    when = np.array([-20.0, 0.0, 100.0, 700.0])
    place = east_north(SHIP, when)
    np.testing.assert_allclose(place[:, 0], 8.0 * when * np.sin(60 * DEG), atol=4.0)
    np.testing.assert_allclose(place[:, 1], 8.0 * when * np.cos(60 * DEG), atol=4.0)
    ship = attitude(SHIP, when)
    np.testing.assert_allclose(ship.speed_mps, 8.0, rtol=1e-6)
    np.testing.assert_allclose(ship.heading_rad, 60 * DEG, atol=1e-9)
    np.testing.assert_allclose(geodetic_from_ecef(ship.position)[2], 30.0, atol=1e-6)


def test_a_steady_turn_is_a_circle() -> None:
    """6 m/s at 0.5 deg/s: a radius of 687.5 m, and round in 720 s."""
    ship = change(SHIP, speed_mps=6.0, turn_degps=0.5, course_deg=0.0)
    place = east_north(ship, np.arange(0.0, 721.0, 10.0))
    radius = 6.0 / (0.5 * DEG)
    np.testing.assert_allclose(np.hypot(place[:, 0] - radius, place[:, 1]), radius, rtol=1e-3)
    assert np.linalg.norm(place[-1]) < 1.0


def test_waypoints_are_passed_with_limited_turns() -> None:
    corners = ((54.5, 10.53), (54.52, 10.53), (54.52, 10.5))
    ship = change(SHIP, waypoints=corners, max_turn_degps=1.5)
    when = np.arange(0.0, 800.0)
    lies = attitude(ship, when)
    for lat, lon in corners:
        away = np.linalg.norm(lies.position - ecef_from_geodetic(np.radians(lat), np.radians(lon), 30.0), axis=1)
        assert away.min() < 250.0
    turn = np.diff(np.unwrap(lies.course_rad))
    assert np.abs(turn).max() <= 1.51 * DEG
    assert np.abs(turn).max() > 1.0 * DEG
    # A smooth way: no jump of the rate of turn.
    assert np.abs(np.diff(turn)).max() < 0.25 * DEG
    np.testing.assert_allclose(lies.speed_mps, 8.0, rtol=1e-3)


def test_the_way_does_not_depend_on_how_far_it_is_asked_for() -> None:
    when = np.linspace(0.0, 1500.0, 50)
    short, long = attitude(SHIP, when).position, attitude(SHIP, np.r_[when, 9000.0]).position[:-1]
    np.testing.assert_allclose(short, long, atol=1e-6)


# ------------------------------------------------------------------------------------------------------------------ the antenna


def test_the_antennas_axes_turn_and_lean_as_the_ship_does() -> None:
    ship = change(
        SHIP, speed_mps=0.0, course_deg=30.0, crab_deg=5.0, roll_deg=6.0, pitch_deg=3.0, yaw_deg=2.0, phase_deg=(90.0, 0, 90.0, 0)
    )
    zero = np.zeros(1)
    lies = attitude(ship, zero)
    np.testing.assert_allclose(
        [lies.heading_rad[0], lies.roll_rad[0], lies.pitch_rad[0]], np.radians([37.0, 6.0, 0.0]), atol=1e-12
    )
    level = enu_from_ecef(np.radians(54.5), np.radians(10.5))
    deck = pose(change(ship, angles="deck"), zero)[1][0] @ level.T
    np.testing.assert_allclose(deck @ deck.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(deck), 1.0)
    np.testing.assert_allclose(deck[1], [np.sin(37 * DEG), np.cos(37 * DEG), 0.0], atol=1e-9)
    assert deck[0, 2] == pytest.approx(-np.sin(6 * DEG))
    bow = pose(change(ship, angles="bow"), zero)[1][0] @ level.T
    np.testing.assert_allclose(bow[2], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(pose(ship, zero)[1][0], level, atol=1e-12)


def test_the_lever_arm_swings_with_the_ship() -> None:
    ship = change(SHIP, speed_mps=0.0, course_deg=90.0, roll_deg=10.0, phase_deg=(90.0, 0, 0, 0), lever_arm_m=(20.0, 3.0, 12.0))
    place, _ = pose(ship, np.zeros(1))
    # Heading east, starboard is south, and rolled to it.
    south = 3.0 * np.cos(10 * DEG) + 12.0 * np.sin(10 * DEG)
    up = 12.0 * np.cos(10 * DEG) - 3.0 * np.sin(10 * DEG)
    away = local_enu(place, np.radians(54.5), np.radians(10.5), 30.0)[0]
    np.testing.assert_allclose(away, [20.0, -south, up], atol=1e-6)


def test_heave_lifts_the_ship() -> None:
    ship = change(SHIP, heave_m=2.0, heave_period_s=8.0)
    height = geodetic_from_ecef(attitude(ship, np.array([0.0, 2.0, 6.0])).position)[2]
    np.testing.assert_allclose(height, [30.0, 32.0, 28.0], atol=1e-6)


# ------------------------------------------------------------------------------------------------------------------ own ship


def test_own_ship_reports_the_truth_with_its_errors() -> None:
    ship = change(
        SHIP, roll_deg=5.0, phase_deg=(0.0, 0, 0, 0), report_s=0.2, position_sd_m=2.0, heading_sd_deg=0.3, heading_bias_deg=1.0,
        roll_sd_deg=0.1, roll_bias_deg=-0.5,
    )  # fmt: skip
    told = own_ship(ship, 65536, EPOCH, 1200.0, np.random.default_rng(1))
    assert len(told) == 6002
    np.testing.assert_allclose(np.diff(told.time_s), 0.2, atol=1e-6)
    lies = attitude(ship, told.time_s - EPOCH)
    off = ecef_from_geodetic(told.latitude_rad, told.longitude_rad, told.height_m) - lies.position
    np.testing.assert_allclose(off.std(axis=0), 2.0, rtol=0.06)
    for name, bias, sd in (("heading_rad", 1.0, 0.3), ("roll_rad", -0.5, 0.1), ("pitch_rad", 0.0, 0.0)):
        error = wrap_rad(getattr(told, name) - getattr(lies, name)) / DEG
        assert abs(error.mean() - bias) < 5 * sd / np.sqrt(len(told)) + 1e-6
        assert error.std() == pytest.approx(sd, rel=0.06, abs=1e-6)
    again = own_ship(ship, 65536, EPOCH, 1200.0, np.random.default_rng(1))
    np.testing.assert_array_equal(told.latitude_rad, again.latitude_rad)


def test_phases_are_drawn_once() -> None:
    drawn = settled(SHIP, np.random.default_rng(3))
    assert drawn.phase_deg is not None
    assert drawn == settled(SHIP, np.random.default_rng(3))
    assert settled(drawn, np.random.default_rng(4)) is drawn


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"angles": "mast"}, "angles"),
        ({"roll_deg": 60.0}, "roll_deg"),
        ({"roll_period_s": 0.0}, "roll_period_s"),
        ({"report_s": 0.0}, "report_s"),
        ({"speed_mps": float("nan")}, "speed_mps"),
        ({"lever_arm_m": (float("inf"), 0.0, 0.0)}, "lever_arm_m"),
        ({"waypoints": ((54.0, 10.0),), "turn_degps": 1.0}, "waypoints"),
        ({"waypoints": ((95.0, 10.0),)}, "latitudes"),
    ],
)
def test_ships_that_cannot_be_are_refused(wrong: dict[str, object], text: str) -> None:
    check_vessel(SHIP, "here")
    with pytest.raises(SettingsError, match=text):
        check_vessel(change(SHIP, **wrong), "here")


# ----------------------------------------------------------------------------------------------------------------- end to end

BIAS = {"range_bias": 25.0, "azimuth_bias": 0.8, "time_offset": 0.15}
SWINGING = change(
    SHIP, lever_arm_m=(20.0, 2.0, 15.0), roll_deg=5.0, pitch_deg=1.5, yaw_deg=1.5, turn_degps=0.05, angles="deck", report_s=0.2,
    position_sd_m=0.5, heading_sd_deg=0.05, roll_sd_deg=0.05, pitch_sd_deg=0.05, phase_deg=(10.0, 80.0, 200.0, 0.0),
)  # fmt: skip
TARGETS, SPAN_S, SCAN_S = 14, 900.0, 2.5


def recordings(vessel: Vessel, seed: int, *, elevation_bias_deg: float | None = None) -> tuple[Plots, Fixes, Platform]:
    """What the ship's radar (30 m, 0.2 deg) measured of aircraft that pass, what these told, and what own ship told."""
    rng = np.random.default_rng(seed)
    level = enu_from_ecef(np.radians(SHIP.lat_deg), np.radians(SHIP.lon_deg))
    origin = ecef_from_geodetic(np.radians(SHIP.lat_deg), np.radians(SHIP.lon_deg), 0.0)
    plots, fixes = [], []
    for k in range(TARGETS):
        way = rng.uniform(0, 2 * np.pi)
        velocity = 120.0 * np.array([np.sin(way), np.cos(way), 0.0])
        middle = np.r_[rng.uniform(-12e3, 12e3, 2), rng.uniform(1500, 5000)]

        def place(seconds: np.ndarray, middle: np.ndarray = middle, velocity: np.ndarray = velocity) -> np.ndarray:
            return np.asarray(origin + (middle + (seconds - SPAN_S / 2)[:, None] * velocity) @ level)

        seconds = np.arange(rng.uniform(0, SCAN_S), SPAN_S, SCAN_S)
        antenna, axes = pose(vessel, seconds)
        seen = polar_from_enu(rotate(axes, place(seconds) - antenna))
        near = (seen[:, 0] < 40e3) & (seen[:, 2] > 1 * DEG) & (seen[:, 2] < 60 * DEG)
        seen, seconds = seen[near], seconds[near]
        n = len(seconds)
        elevation = np.full(n, np.nan)
        if elevation_bias_deg is not None:
            elevation = seen[:, 2] + (elevation_bias_deg + rng.normal(0, 0.2, n)) * DEG
        plots.append(
            Plots(
                time_s=EPOCH + seconds + BIAS["time_offset"],
                sensor=np.full(n, 65536),
                channel=np.full(n, 3),
                range_m=seen[:, 0] + BIAS["range_bias"] + rng.normal(0, 30.0, n),
                azimuth_rad=np.mod(seen[:, 1] + (BIAS["azimuth_bias"] + rng.normal(0, 0.2, n)) * DEG, 2 * np.pi),
                elevation_rad=elevation,
                mode_s=np.full(n, 0x400000 + k),
                track=np.full(n, k),
            )
        )
        told = np.arange(rng.uniform(0, 1), SPAN_S, 1.0)
        lat, lon, height = geodetic_from_ecef(place(told))
        m = len(told)
        fixes.append(
            Fixes(
                time_s=EPOCH + told,
                latitude_rad=lat,
                longitude_rad=lon,
                height_m=height,
                mode_s=np.full(m, 0x400000 + k),
                horizontal_sd_m=np.full(m, 5.0),
                vertical_sd_m=np.full(m, 5.0),
            )
        )
    return Plots.concat(plots), Fixes.concat(fixes), own_ship(vessel, 65536, EPOCH, SPAN_S, rng)


def calibrate(plots: Plots, fixes: Fixes, own: Platform, sensor: Sensor) -> Calibration:
    """What `boresight calibrate` does after reading."""
    sensors = Sensors((sensor,))
    placed, _ = locate(fixes, sensors)
    plots, views, sensors, _ = platform_views(plots, own, sensors)
    pairs = search(plots, placed, sensors, views=views).pairs
    solid = ("elevation_bias",) if np.isfinite(plots.elevation_rad).any() else ()
    return register(pairs, sensors, model=(*BIAS, *solid))


def misses(found: Calibration) -> dict[str, float]:
    """How many of its own sd each error found is from the true one."""
    out = {}
    for name, true in BIAS.items():
        k = found.index(65536, name)
        assert k is not None
        si = DEG if name == "azimuth_bias" else 1.0
        out[name] = float((found.value[0, k] - true * si) / np.sqrt(found.covariance[0, k, k]))
    return out


RADAR = Sensor(name="ship", id=65536, kind="mode_s", lever_arm_m=SWINGING.lever_arm_m, angles="deck")


@pytest.mark.parametrize("seed", [1, 2])
def test_known_errors_are_found_from_a_swinging_ship(seed: int) -> None:
    found = misses(calibrate(*recordings(SWINGING, seed), RADAR))
    assert all(abs(miss) < 3.0 for miss in found.values()), found


@pytest.mark.parametrize("offset_s", [0.0, 0.4])
def test_a_recording_comes_back_from_nmea(tmp_path: Path, offset_s: float) -> None:
    """Bearings relative to the bow, own ship's heading, roll and pitch: written, read, and turned back to what was measured."""
    plots, _, own = recordings(SWINGING, 1)
    order = np.argsort(plots.time_s, kind="stable")
    plots = plots.take(order)
    written = write_nmea(tmp_path / "ship.nmea", plots, platform=own, sensors=Sensors((RADAR,)))
    assert written.left_out.get("roll_rad", 0) == 0
    assert b",R," in (tmp_path / "ship.nmea").read_bytes()
    back = read_nmea(tmp_path / "ship.nmea")
    assert not back.damaged
    assert len(back.plots) == len(plots)
    assert ((back.plots.flags & np.uint32(Flag.FROM_BOW)) != 0).all()
    sensors = Sensors((msgspec.structs.replace(RADAR, time_offset_s=offset_s),))
    same, _, _, _ = platform_views(apply_time_offsets(back.plots, sensors), back.platform, sensors)
    np.testing.assert_allclose(wrap_rad(same.azimuth_rad - plots.azimuth_rad), 0.0, atol=2e-6)
    for name, quantum in (("roll_rad", 1e-6), ("pitch_rad", 1e-6), ("heading_rad", 1e-6)):
        told = np.isin(np.rint(back.platform.time_s * 1e3), np.rint(own.time_s * 1e3)) & np.isfinite(back.platform.roll_rad)
        at = np.searchsorted(np.rint(own.time_s * 1e3), np.rint(back.platform.time_s[told] * 1e3))
        assert told.sum() == len(own)
        np.testing.assert_allclose(wrap_rad(getattr(back.platform, name)[told] - getattr(own, name)[at]), 0.0, atol=quantum)


def test_an_elevation_from_a_swinging_deck_is_the_antennas_own() -> None:
    """Roll of 5 degrees moves elevations by as much; 0.4 degrees of bias are found within 3 sd, beside a late stamp."""
    found = calibrate(*recordings(SWINGING, 4, elevation_bias_deg=0.4), RADAR)
    assert all(abs(miss) < 3.0 for miss in misses(found).values()), misses(found)
    k = found.index(65536, "elevation_bias")
    assert k is not None
    sd = np.sqrt(found.covariance[0, k, k])
    assert abs(found.value[0, k] - 0.4 * DEG) < 3.0 * sd
    assert sd < 0.02 * DEG
    assert found.sensors[0].noise.elevation_rad == pytest.approx(0.2 * DEG, rel=0.15)


def test_what_ignoring_the_platform_costs() -> None:
    """Without roll, pitch and lever arm 5 degrees of roll are refused or give far more than 3 sd; so do the right pairs."""
    armless = msgspec.structs.replace(RADAR, lever_arm_m=None)
    for seed in (3, 2, 1):
        plots, fixes, own = recordings(SWINGING, seed)
        nothing = np.full(len(own), np.nan)
        level = own.replace(roll_rad=nothing, pitch_rad=nothing)
        if seed > 1:
            with pytest.raises(NothingToDo, match="agree on the biases"):
                calibrate(plots, fixes, level, armless)
        else:
            guess = calibrate(plots, fixes, level, armless)
            assert max(abs(miss) for miss in misses(guess).values()) > 5.0
            assert guess.sensors[0].noise.azimuth_rad > 0.3 * DEG
    # The right pairs, looked at as if the deck were level.
    placed, _ = locate(fixes, Sensors((RADAR,)))
    measured, views, sensors, _ = platform_views(plots, own, Sensors((RADAR,)))
    pairs = search(measured, placed, sensors, views=views).pairs
    right = register(pairs, sensors, model=tuple(BIAS))
    _, views, sensors, _ = platform_views(plots, level, Sensors((armless,)))
    way = trajectories(placed)
    target = way.target[np.searchsorted(placed.mode_s, pairs.plots.mode_s)]
    seen = views[65536](states(way, target, pairs.plots.time_s), pairs.plots.time_s)
    wrong = register(
        pairs.replace(position=seen.position, velocity=seen.velocity, acceleration=seen.acceleration, covariance=seen.covariance),
        sensors,
        model=tuple(BIAS),
    )
    assert all(abs(miss) < 3.0 for miss in misses(right).values())
    assert max(abs(miss) for miss in misses(wrong).values()) > 3.0, misses(wrong)
    assert wrong.sensors[0].noise.azimuth_rad > 1.5 * right.sensors[0].noise.azimuth_rad
    assert wrong.sensors[0].after.median_m > 1.5 * right.sensors[0].after.median_m


def test_what_ignoring_the_lever_arm_costs() -> None:
    """60 m forward: over targets all around it makes no bias, but it is in every range, by the cosine of the bearing."""
    ship = change(SWINGING, lever_arm_m=(60.0, 0.0, 0.0), turn_degps=0.0, roll_deg=0.5)
    plots, fixes, own = recordings(ship, 3)
    with_arm = msgspec.structs.replace(RADAR, lever_arm_m=(60.0, 0.0, 0.0))
    armless = msgspec.structs.replace(RADAR, lever_arm_m=None)
    assert all(abs(miss) < 3.0 for miss in misses(calibrate(plots, fixes, own, with_arm)).values())
    left = {}
    for name, sensor in (("right", with_arm), ("wrong", armless)):
        measured, views, sensors, _ = platform_views(plots, own, Sensors((sensor,)))
        pairs = search(measured, locate(fixes, sensors)[0], sensors, views=views).pairs
        polar = polar_from_position(pairs.position, *site_of(sensors.sensor[0]))
        ahead = np.cos(polar[:, 1]) * np.cos(polar[:, 2])
        left[name] = np.polyfit(ahead, pairs.plots.range_m - polar[:, 0], 1)[0]
    assert abs(left["right"]) < 4.0
    assert left["wrong"] == pytest.approx(-60.0, abs=6.0)
