"""A moving radar's reference about one fixed point: ranges, azimuths and elevations are those seen from its antenna."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from boresight.alignment import States, Trajectories, states, trajectories
from boresight.errors import SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef
from boresight.measure import heading_about, polar_from_position, polar_motion, site_of, wrap_rad
from boresight.model import Fixes, Flag, Platform, Plots, Sensor, Sensors, check_sensors
from boresight.platform import antenna_axes, deck_from_enu, moving, platform_views, plot_places, position_at, view_of

FERRY = Sensor(name="ferry", id=65536, kind="marine")
DEG = np.pi / 180


def sail(rng: np.random.Generator, latitude_deg: float, longitude_deg: float) -> tuple[Platform, Fixes]:
    """Own ship reported every second, and a boat seen at other times within some kilometres; both go straight on."""
    t = np.arange(100.0)
    east, north = rng.uniform(-8e-7, 8e-7, (2, 2))
    own = Platform(
        time_s=t,
        sensor=np.full(100, 65536),
        latitude_rad=np.radians(latitude_deg) + north[0] * t,
        longitude_rad=np.radians(longitude_deg) + east[0] * t,
        height_m=np.full(100, 12.0),
    )
    when = np.linspace(0.5, 98.5, 80) + rng.uniform(-0.4, 0.4, 80)
    boat = Fixes(
        time_s=when,
        latitude_rad=np.radians(latitude_deg) + rng.uniform(-5e-4, 5e-4) + north[1] * when,
        longitude_rad=np.radians(longitude_deg) + rng.uniform(-5e-4, 5e-4) + east[1] * when,
        height_m=np.full(80, rng.uniform(0, 30)),
        mmsi=np.full(80, 257000001),
        horizontal_sd_m=np.full(80, 1.0),
    )
    return own, boat


def look(own: Platform, boat: Fixes, sensor: Sensor, time_s: np.ndarray) -> tuple[States, np.ndarray, Sensor]:
    """The boat's states as `sensor` sees them, and its polar positions (n, 3)."""
    view, fixed, _ = view_of(own, sensor)
    way = trajectories(boat)
    seen = view(states(way, np.zeros(len(time_s), np.int64), time_s), time_s)
    return seen, polar_from_position(seen.position, *site_of(fixed)), fixed


def still(heading_deg: float = 0.0, roll_deg: float = 0.0, pitch_deg: float = 0.0) -> Platform:
    """A ship that lies still at 60 N 5 E, on the ellipsoid, turned so."""
    t = np.arange(0.0, 60.0, 0.5)
    one = np.ones(len(t))
    return Platform(
        time_s=t, sensor=65536 * one, latitude_rad=60 * DEG * one, longitude_rad=5 * DEG * one, height_m=0 * one,
        heading_rad=heading_deg * DEG * one, roll_rad=roll_deg * DEG * one, pitch_rad=pitch_deg * DEG * one,
    )  # fmt: skip


def buoy(bearing_deg: float, distance_m: float = 3000.0, up_m: float = 0.0) -> Fixes:
    """A target that lies still, so far in that direction from the ship, over the tangent plane."""
    from boresight.geodesy import geodetic_from_ecef

    lat, lon = np.radians(60.0), np.radians(5.0)
    enu = [distance_m * np.sin(bearing_deg * DEG), distance_m * np.cos(bearing_deg * DEG), up_m]
    place = geodetic_from_ecef(ecef_from_geodetic(lat, lon, 0.0) + enu @ enu_from_ecef(lat, lon))
    t = np.arange(0.0, 60.0)
    one = np.ones(len(t))
    return Fixes(
        time_s=t, latitude_rad=place[0] * one, longitude_rad=place[1] * one, height_m=place[2] * one, mmsi=257000001 * one,
        horizontal_sd_m=one,
    )  # fmt: skip


def place_of(target: Fixes) -> np.ndarray:
    return ecef_from_geodetic(target.latitude_rad[:1], target.longitude_rad[:1], target.height_m[:1])


def polar(ship: Platform, target: Fixes, **sensor: Any) -> np.ndarray:
    """Range, azimuth (deg) and elevation (deg) of the target for an antenna of that ship, in the middle of the time."""
    found = look(ship, target, Sensor(name="ferry", id=65536, kind="marine", **sensor), np.array([30.2]))[1][0]
    return np.asarray(found / [1.0, DEG, DEG])


# ------------------------------------------------------------------------------------------------------------------ the axes


@given(st.floats(-4, 4), st.floats(-1.4, 1.4), st.floats(-1.4, 1.4))
def test_the_decks_axes_are_those_of_the_aerospace_sequence(heading: float, roll: float, pitch: float) -> None:
    """SciPy's intrinsic z-y-x rotation takes forward, starboard, down to north, east, down."""
    ned = Rotation.from_euler("ZYX", [heading, pitch, roll]).as_matrix()
    swap = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    expected = (swap @ ned @ swap).T
    np.testing.assert_allclose(deck_from_enu(np.array([heading]), np.array([roll]), np.array([pitch]))[0], expected, atol=1e-12)
    np.testing.assert_allclose(
        antenna_axes("deck", np.array([heading]), np.array([roll]), np.array([pitch]))[0], expected, atol=1e-12
    )
    np.testing.assert_array_equal(antenna_axes("north", np.array([heading]), np.array([roll]), np.array([pitch]))[0], np.eye(3))


def test_positive_roll_puts_starboard_down_and_positive_pitch_the_bow_up() -> None:
    starboard, _, _ = deck_from_enu(np.zeros(1), np.array([0.1]), np.zeros(1))[0]
    assert starboard[2] < 0
    _, bow, _ = deck_from_enu(np.zeros(1), np.zeros(1), np.array([0.1]))[0]
    assert bow[2] > 0


# --------------------------------------------------------------------------------------------------------------- closed forms


def test_a_target_straight_ahead_of_a_rolling_ship_stays_ahead() -> None:
    for roll in (-12.0, 0.0, 12.0):
        r, a, e = polar(still(50.0, roll), buoy(50.0), angles="deck")
        assert abs(r - 3000.0) < 1e-3
        assert abs(wrap_rad(a * DEG)) < 1e-7
        assert abs(e) < 1e-5


def test_a_target_abeam_of_a_rolling_ship_rises_by_the_roll() -> None:
    """Starboard goes down, so what lies level there is up from the deck by the roll."""
    _, a, e = polar(still(50.0, 8.0), buoy(140.0), angles="deck")
    assert abs(a - 90.0) < 1e-6
    assert abs(e - 8.0) < 1e-5
    assert abs(polar(still(50.0, 8.0), buoy(320.0), angles="deck")[2] + 8.0) < 1e-5


def test_pitch_takes_the_elevation_of_what_is_ahead() -> None:
    """Ahead at elevation e a bow that is up by p leaves e - p; beside it the azimuth moves by tan e sin p, to first order."""
    up = 3000.0 * np.tan(10 * DEG)
    _, a, e = polar(still(0.0, 0.0, 4.0), buoy(0.0, 3000.0, up), angles="deck")
    assert abs(wrap_rad(a * DEG)) < 1e-7
    assert abs(e - 6.0) < 1e-5
    a = polar(still(0.0, 0.0, 4.0), buoy(90.0, 3000.0, up), angles="deck")[1]
    assert abs(a - 90.0 + np.degrees(np.arctan(np.tan(10 * DEG) * np.sin(4 * DEG)))) < 1e-5


def test_azimuths_from_the_bow_are_less_by_the_heading_and_do_not_lean() -> None:
    level = polar(still(200.0), buoy(230.0, 3000.0, 300.0))
    bow = polar(still(200.0, 10.0, 5.0), buoy(230.0, 3000.0, 300.0), angles="bow")
    np.testing.assert_allclose(bow, level - [0, 200.0, 0], atol=1e-6)


def test_a_lever_arm_of_20_m_forward_shifts_range_ahead_and_not_abeam() -> None:
    arm = (20.0, 0.0, 0.0)
    assert abs(polar(still(70.0), buoy(70.0), lever_arm_m=arm)[0] - 2980.0) < 1e-3
    assert abs(polar(still(70.0), buoy(250.0), lever_arm_m=arm)[0] - 3020.0) < 1e-3
    r, a, _ = polar(still(70.0), buoy(160.0), lever_arm_m=arm)
    assert abs(r - np.hypot(3000.0, 20.0)) < 1e-3
    assert abs(a - 160.0 - np.degrees(np.arctan(20.0 / 3000.0))) < 1e-4


def test_a_mast_leans_over_with_the_roll() -> None:
    """30 m up and 10 degrees to starboard: 30 sin 10 nearer to what lies there, about a point of the mast's height."""
    arm = (0.0, 0.0, 30.0)
    r = polar(still(0.0, 10.0), buoy(90.0), lever_arm_m=arm)[0]
    assert abs(r - np.hypot(3000.0 - 30.0 * np.sin(10 * DEG), 30.0 * np.cos(10 * DEG))) < 1e-3


@given(st.integers(0, 2**31), st.floats(-75, 75), st.floats(-180, 180))
def test_polar_positions_are_those_from_the_platform(seed: int, latitude_deg: float, longitude_deg: float) -> None:
    own, boat = sail(np.random.default_rng(seed), latitude_deg, longitude_deg)
    when = boat.time_s[5:-5]
    seen, found, _ = look(own, boat, FERRY, when)
    assert seen.valid.all()
    at, known = position_at(own, when)
    assert known.all()
    place = ecef_from_geodetic(boat.latitude_rad, boat.longitude_rad, boat.height_m)[5:-5]
    # The chord between two reports a second apart lies less than a micrometre below the surface.
    np.testing.assert_allclose(found[:, 0], np.linalg.norm(place - at, axis=1), atol=1e-3)


def test_rates_are_those_of_what_the_antenna_measures() -> None:
    """A late stamp's effect in the deck's axes: rates against differences of the polar positions themselves."""
    t = np.arange(0.0, 120.0, 0.1)
    own = Platform(
        time_s=t, sensor=np.full(len(t), 65536), latitude_rad=1.0 + 1e-6 * t, longitude_rad=0.1 + 1e-6 * t, height_m=0 * t,
        heading_rad=0.3 + 0.01 * t, roll_rad=0.09 * np.sin(2 * np.pi * t / 9), pitch_rad=0.04 * np.sin(2 * np.pi * t / 6.5),
    )  # fmt: skip
    boat = sail(np.random.default_rng(4), float(np.degrees(1.0)) + 0.01, float(np.degrees(0.1)) + 0.02)[1]
    sensor = Sensor(name="ferry", id=65536, lever_arm_m=(20.0, -3.0, 25.0), angles="deck")
    when = np.linspace(20.0, 80.0, 200)
    seen, _, fixed = look(own, boat, sensor, when)
    site, rotation = site_of(fixed)
    local = [v @ rotation.T for v in (seen.position - site, seen.velocity, seen.acceleration)]
    _, rate, second, _ = polar_motion(*local)
    h = 0.1
    before, now, after = (look(own, boat, sensor, when + d)[1] for d in (-h, 0.0, h))
    across, bend = (after - before) / (2 * h), (after - 2 * now + before) / h**2
    across[:, 1] = wrap_rad(after[:, 1] - before[:, 1]) / (2 * h)
    bend[:, 1] = wrap_rad(wrap_rad(after[:, 1] - now[:, 1]) - wrap_rad(now[:, 1] - before[:, 1])) / h**2
    # The deck swings by up to 3.6 deg/s: rates may be off by 1 % of that and of its own rate.
    assert np.abs(rate - across)[:, 1:].max() < 0.015 * np.abs(across[:, 1:]).max()
    assert np.abs(rate - across)[:, 0].max() < 0.01 * np.abs(across[:, 0]).max()
    assert np.abs(second - bend)[:, 1:].max() < 0.05 * np.abs(bend[:, 1:]).max()


def test_the_covariance_and_heading_turn_with_the_axes() -> None:
    ship, target = still(90.0), buoy(20.0)
    target = target.replace(heading_rad=np.full(len(target), 30 * DEG), vertical_sd_m=np.full(len(target), 5.0))
    seen, _, fixed = look(ship, target, Sensor(name="ferry", id=65536, angles="bow"), np.array([30.2]))
    # From the bow, which points east, the target heads for -60 degrees (and the convergence of the meridians).
    _, rotation = site_of(fixed)
    true = heading_about(np.array([30 * DEG]), place_of(target), rotation)
    turned = heading_about(seen.heading_rad, seen.position, rotation)
    assert abs(wrap_rad(turned - true + 90 * DEG)[0]) < 1e-9
    assert abs(wrap_rad(true - 30 * DEG)[0]) < 2e-3
    local = site_of(fixed)[1] @ seen.covariance[0] @ site_of(fixed)[1].T
    plain = look(ship, target, FERRY, np.array([30.2]))[0].covariance[0]
    np.testing.assert_allclose(np.linalg.eigvalsh(local), np.linalg.eigvalsh(plain), atol=1e-9)
    assert local[2, 2] > 5 * local[0, 0]


# ----------------------------------------------------------------------------------------------------------- what is not known


def test_a_still_platform_changes_nothing() -> None:
    own, boat = sail(np.random.default_rng(1), 63.0, 10.0)
    held = own.replace(latitude_rad=np.full(100, own.latitude_rad[0]), longitude_rad=np.full(100, own.longitude_rad[0]))
    seen, _, _ = look(held, boat, FERRY, boat.time_s)
    plain = states(trajectories(boat), np.zeros(len(boat), np.int64), boat.time_s)
    for name, digits in (("position", 1e-6), ("velocity", 1e-6), ("acceleration", 1e-5), ("covariance", 1e-9)):
        np.testing.assert_allclose(getattr(seen, name), getattr(plain, name), atol=digits)
    np.testing.assert_allclose(wrap_rad(seen.heading_rad - plain.heading_rad), 0.0, atol=1e-6)


def plots_at(time_s: np.ndarray, key: int = 65536, **columns: Any) -> Plots:
    n = len(time_s)
    return Plots(time_s=time_s, sensor=np.full(n, key), range_m=np.full(n, 500.0), azimuth_rad=np.linspace(0, 6, n), **columns)


def test_silence_is_not_bridged_and_is_counted() -> None:
    own, boat = sail(np.random.default_rng(2), 63.0, 10.0)
    silent = own[(own.time_s < 30) | (own.time_s > 60)]
    when = np.linspace(1.0, 98.0, 98)
    gone = (when > 29.6) & (when < 60.4)
    _, views, _, said = platform_views(plots_at(when), silent, Sensors((FERRY,)))
    seen = views[65536](states(trajectories(boat), np.zeros(98, np.int64), when), when)
    assert not seen.valid[gone].any()
    assert np.isnan(seen.position[gone]).all()
    assert (seen.source[gone] == -1).all()
    assert f"{np.count_nonzero(gone):,} of 98 plots" in said[1]


def test_a_pause_between_two_trials_leaves_both() -> None:
    own, _ = sail(np.random.default_rng(2), 63.0, 10.0)
    later = own.replace(time_s=own.time_s + 86400.0)
    when = np.r_[np.linspace(1, 98, 20), 86400 + np.linspace(1, 98, 20)]
    said = platform_views(plots_at(when), Platform.concat([later, own]), Sensors((FERRY,)))[3]
    assert len(said) == 1


def test_roll_is_not_bridged_over_seconds_but_heading_is() -> None:
    ship = still(30.0, 5.0)
    gap = (ship.time_s > 20) & (ship.time_s < 26)
    ship = ship.replace(
        roll_rad=np.where(gap, np.nan, ship.roll_rad), heading_rad=np.where(gap, np.nan, ship.heading_rad)
    )  # fmt: skip
    sensor = Sensor(name="ferry", id=65536, angles="deck")
    said = platform_views(plots_at(np.arange(5.0, 55.0)), ship, Sensors((sensor,)))[3]
    assert len(said) == 2
    assert "6 of 50 plots" in said[1]
    assert "roll and pitch" in said[1]


def test_the_curve_through_reports_follows_a_swing() -> None:
    """Roll of 8 s told once a second is followed to 2 % between the reports, over the turn of a heading at north as well."""
    t = np.arange(0.0, 60.0)
    ship = Platform(
        time_s=t, sensor=np.full(60, 65536), latitude_rad=np.full(60, 1.0), longitude_rad=np.full(60, 0.1), height_m=0 * t,
        heading_rad=np.mod(0.1 * np.sin(2 * np.pi * t / 8), 2 * np.pi), roll_rad=0.1 * np.sin(2 * np.pi * t / 8), pitch_rad=0 * t,
    )  # fmt: skip
    view, _, _ = view_of(ship, Sensor(name="ferry", id=65536, angles="deck"))
    assert view.roll is not None
    when = np.linspace(2.0, 57.0, 999)
    for curve in (view.roll, view.heading):
        value, known = curve.at(when)
        assert known.all()
        assert np.abs(wrap_rad(value - 0.1 * np.sin(2 * np.pi * when / 8))).max() < 0.002


def test_what_is_missing_is_said_with_its_effect() -> None:
    ship = still(30.0, 5.0)
    nothing = np.full(len(ship), np.nan)
    deck = Sensor(name="ferry", id=65536, angles="deck", lever_arm_m=(20.0, 0.0, 10.0))
    _, _, said = view_of(ship.replace(roll_rad=nothing), deck)
    assert "level deck" in said[1]
    assert "each degree shifts elevations by up to 1°" in said[1]
    assert "moves the antenna by up to 0.39 m" in said[1]
    north = Sensor(name="ferry", id=65536, lever_arm_m=(20.0, 0.0, 10.0))
    view, _, said = view_of(ship.replace(heading_rad=nothing), north)
    assert "lever arm is not applied" in said[1]
    assert "22.4 m" in said[1]
    assert not view.arm.any()
    for angles in ("bow", "deck"):
        with pytest.raises(SettingsError, match="heading"):
            view_of(ship.replace(heading_rad=nothing), Sensor(name="ferry", id=65536, angles=angles))


def test_impossible_settings_are_refused() -> None:
    for wrong, text in (
        ({"angles": "mast"}, "angles = 'mast' is unknown"),
        ({"lever_arm_m": (float("nan"), 0.0, 0.0)}, "lever_arm_m"),
        ({"lever_arm_m": (0.0, 5000.0, 0.0)}, "lever_arm_m"),
    ):
        with pytest.raises(SettingsError, match=text):
            check_sensors(Sensors((Sensor(name="ferry", id=65536, **wrong),)))


def test_angles_from_the_bow_without_own_ship_are_refused() -> None:
    coast = Sensor(name="coast", sac=1, sic=1, lat_deg=63.0, lon_deg=10.0, angles="bow")
    with pytest.raises(SettingsError, match="nothing of own ship"):
        platform_views(plots_at(np.arange(5.0), 257), Platform(), Sensors((coast,)))
    fixed = Sensor(name="coast", sac=1, sic=1, lat_deg=63.0, lon_deg=10.0, lever_arm_m=(1.0, 0.0, 0.0))
    assert "not used" in platform_views(plots_at(np.arange(5.0), 257), Platform(), Sensors((fixed,)))[3][0]


# ---------------------------------------------------------------------------------------------------------------- several radars


def test_radars_that_stand_still_are_left_as_they_are_beside_moving_ones() -> None:
    own, _ = sail(np.random.default_rng(3), 63.0, 10.0)
    coast = Sensor(name="coast", sac=1, sic=1, lat_deg=63.0, lon_deg=10.0, height_m=0.0)
    sensors = Sensors((FERRY, coast))
    when = np.arange(10.0, 90.0)
    both = Plots.concat([plots_at(when), plots_at(when, 257)])
    assert moving(both, own) == [65536]
    same, views, found, said = platform_views(both, own, sensors)
    assert same is both
    assert list(views) == [65536]
    assert found.sensor[1] is coast
    assert found.sensor[0].lat_deg is not None
    assert len(said) == 1
    _, views, found, said = platform_views(plots_at(when, 257), own, sensors)
    assert (views, found, said) == ({}, sensors, ())


def test_one_position_is_where_a_radar_stands() -> None:
    own, _ = sail(np.random.default_rng(3), 63.0, 10.0)
    _, views, found, said = platform_views(plots_at(np.arange(5.0)), own[:1], Sensors((FERRY,)))
    assert not views
    assert found.sensor[0].lat_deg == pytest.approx(np.degrees(own.latitude_rad[0]))
    assert "stand there" in said[0]
    placed = Sensor(name="ferry", id=65536, lat_deg=1.0, lon_deg=2.0)
    assert platform_views(plots_at(np.arange(5.0)), own[:1], Sensors((placed,)))[2].sensor[0] is placed


def test_the_heading_that_a_reader_added_is_taken_off_again() -> None:
    ship = still(40.0)
    when = np.arange(5.0, 55.0)
    flags = np.where(when < 30, int(Flag.FROM_BOW), 0).astype(np.uint32)
    plots = plots_at(when, flags=flags)
    north = platform_views(plots, ship, Sensors((FERRY,)))[0]
    assert north is plots
    bow = platform_views(plots, ship, Sensors((Sensor(name="ferry", id=65536, angles="bow"),)))[0]
    np.testing.assert_allclose(
        wrap_rad(bow.azimuth_rad - plots.azimuth_rad), np.where(when < 30, -40 * DEG, 0.0), atol=1e-12
    )  # fmt: skip


@pytest.mark.parametrize("angles", ["north", "bow", "deck"])
@pytest.mark.parametrize("solid", [True, False])
def test_plots_are_put_where_the_target_is(angles: str, solid: bool) -> None:
    """Seen from a leaning deck with the antenna on its mast, and put back: by elevation, and by height alone."""
    ship = still(50.0, 9.0, -4.0)
    sensor = Sensor(name="ferry", id=65536, angles=angles, lever_arm_m=(20.0, 3.0, 25.0))
    for bearing in range(0, 360, 45):
        target = buoy(float(bearing), 3000.0, 400.0)
        found = look(ship, target, sensor, np.array([30.0]))[1]
        plots = Plots(
            time_s=np.array([30.0]), sensor=np.array([65536]), range_m=found[:, 0], azimuth_rad=found[:, 1],
            elevation_rad=found[:, 2] if solid else np.array([np.nan]),
        )  # fmt: skip
        place = plot_places(plots, ship, sensor, np.array([np.nan]) if solid else target.height_m[:1])
        assert np.linalg.norm(place - place_of(target)) < 0.02
    too_high = plot_places(plots.replace(elevation_rad=np.array([np.nan])), ship, sensor, np.array([9000.0]))
    assert np.isnan(too_high).all()


def test_a_view_is_asked_by_states() -> None:
    from dataclasses import replace

    own, boat = sail(np.random.default_rng(5), 10.0, 20.0)
    view, _, _ = view_of(own, FERRY)
    way: Trajectories = replace(trajectories(boat), view=view)
    when = boat.time_s[10:20]
    seen = states(way, np.zeros(10, np.int64), when)
    plain = view(states(trajectories(boat), np.zeros(10, np.int64), when), when)
    np.testing.assert_array_equal(seen.position, plain.position)


@pytest.mark.real
def test_autoferry_pooled(data: Path) -> None:
    """Five scenarios of a marine radar on a moving ferry: stamped about 2 s late (an independent fit gave 1.98 ± 0.18 s)."""
    from boresight import flow

    scenarios = sorted((data / "autoferry").glob("scenario*"))
    run = flow.calibrate(scenarios, scenarios, Sensors((FERRY,)))
    k = run.calibration.index(65536, "time_offset")
    assert k is not None
    assert 1.4 <= run.calibration.value[0, k] <= 2.6
    (summary,) = run.calibration.sensors
    assert summary.after.median_m < 0.6 * summary.before.median_m


@pytest.mark.parametrize(
    ("step_s", "period_s", "sd_deg", "most_deg", "most_degps"),
    [
        # As it was: too seldom for the swing, and without noise.
        (1.0, 6.0, 0.0, 0.1, 0.5),
        (0.2, 6.0, 0.0, 1e-3, 0.02),
        # Noise that would look like 0.35 degrees a second from one report to the next.
        (0.2, 20.0, 0.05, 0.02, 0.04),
        (0.2, 6.0, 0.05, 0.04, 0.12),
        # From 4.2 degrees a second.
        (0.1, 60.0, 0.3, 0.08, 0.15),
    ],
)
def test_noise_of_own_ships_heading_does_not_look_like_turning(
    step_s: float, period_s: float, sd_deg: float, most_deg: float, most_degps: float
) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 300.0, step_s)
    truth = 5 * DEG * np.sin(2 * np.pi * t / period_s)
    own = Platform(
        time_s=t,
        sensor=np.full(len(t), 65536),
        latitude_rad=np.full(len(t), 1.0) + 1e-9 * t,
        longitude_rad=np.full(len(t), 0.1),
        height_m=np.zeros(len(t)),
        heading_rad=np.mod(truth + sd_deg * DEG * rng.normal(size=len(t)), 2 * np.pi),
    )
    view, _, _ = view_of(own, Sensor(name="ferry", id=65536, kind="marine", angles="bow"))
    asked = np.linspace(5.0, 295.0, 4001)
    true, rate = (5 * DEG * f(2 * np.pi * asked / period_s) * k for f, k in ((np.sin, 1.0), (np.cos, 2 * np.pi / period_s)))
    heading = view.heading.at(asked)[0]
    assert np.sqrt(np.mean(wrap_rad(heading - true) ** 2)) < most_deg * DEG
    slope = (view.heading.at(asked + 0.01)[0] - view.heading.at(asked - 0.01)[0]) / 0.02
    assert np.sqrt(np.mean((slope - rate) ** 2)) < most_degps * DEG
