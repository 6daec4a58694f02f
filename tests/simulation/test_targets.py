"""Do scripted targets move as they are told? Judged by closed forms, and by recordings that are replayed."""

from __future__ import annotations

import datetime
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from boresight.errors import SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.measure import polar_from_position, wrap_rad
from boresight.model import Fixes, unpack_callsigns
from boresight.reading import read
from boresight.simulation.radar import Radar, observe_radar
from boresight.simulation.reference import Adsb, Ais, equip_aircraft, observe_adsb, observe_ais
from boresight.simulation.targets import Target, Waypoint, check_target, script_targets
from boresight.simulation.truth import Atmosphere, Motion, Shipping, Traffic, Truth, fly_traffic, sail_shipping
from boresight.writing.rtklib import write_rtklib
from boresight.writing.tables import write_table

EPOCH_S = 1_772_359_200.0  # 2026-03-01 10:00
AIR = Atmosphere(isa_deviation_k=10.0, shift_m=80.0)
RADAR = Radar(name="hill", sac=20, sic=1, lat_deg=41.5, lon_deg=1.9, height_m=780.0)
COAST = Radar(name="coast", sac=20, sic=4, lat_deg=41.36, lon_deg=2.17, height_m=130.0, kind="marine", min_elevation_deg=-20.0)
START = {"lat_deg": 41.2, "lon_deg": 2.4, "height_m": 3000.0}


def nothing(aircraft: int = 0, duration_s: float = 1200.0) -> Truth:
    traffic = Traffic(aircraft=aircraft, arrivals=0.0, departures=0.0)
    craft = equip_aircraft(aircraft, traffic, Adsb(), np.random.default_rng(1))
    return fly_traffic(traffic, (), AIR, EPOCH_S, duration_s, craft, np.random.default_rng(2))


def scripted(*targets: Target, duration_s: float = 1200.0, **changes: object) -> Truth:
    options = {"adsb": Adsb(share=1.0), "ais": Ais(), "sea_level_m": 49.5} | changes
    return script_targets(targets, nothing(0, duration_s), duration_s, (RADAR, COAST), np.random.default_rng(3), **options)


def motion_of(truth: Truth, when: np.ndarray, target: int = 0, derivatives: int = 3) -> Motion:
    return truth.motion(np.full(len(when), target), when, derivatives)


def local(position: np.ndarray, vector: np.ndarray) -> np.ndarray:
    latitude, longitude, _ = geodetic_from_ecef(position)
    return rotate(enu_from_ecef(latitude, longitude), vector)


def inside(truth: Truth, target: int = 0, count: int = 400) -> np.ndarray:
    return np.linspace(truth.first_s[target], truth.last_s[target], count)


EVERY_KIND = (
    Target(**START, speed_mps=220.0, course_deg=70.0, climb_mps=9.0, climb_after_s=100.0, to_height_m=6000.0),
    Target(**START, kind="turning", speed_mps=150.0, course_deg=10.0, turn_dps=-2.0, turn_after_s=60.0, turn_by_deg=200.0),
    Target(**START, kind="turning", speed_mps=150.0, course_deg=10.0, turn_dps=3.0),
    Target(**START, kind="serpentine", speed_mps=100.0, course_deg=20.0, amplitude_m=800.0, period_s=90.0, phase_deg=30.0),
    Target(kind="approaching", radar="hill", range_m=120e3, azimuth_deg=133.0, height_m=9000.0, speed_mps=230.0, towards="hill",
           climb_mps=-8.0, to_height_m=3000.0),
    Target(kind="waypoints", speed_mps=180.0, waypoint=(
        Waypoint(lat_deg=41.2, lon_deg=2.0, height_m=3000.0), Waypoint(lat_deg=41.5, lon_deg=2.0, height_m=5000.0),
        Waypoint(lat_deg=41.6, lon_deg=2.5, height_m=5000.0, speed_mps=210.0),
        Waypoint(lat_deg=41.3, lon_deg=3.0, height_m=2000.0),
    )),
    Target(craft="ship", kind="turning", lat_deg=41.3, lon_deg=2.3, speed_mps=7.0, course_deg=200.0, turn_dps=0.8,
           turn_after_s=200.0, turn_by_deg=90.0, length_m=34.0),
    Target(craft="ship", kind="waypoints", speed_mps=8.0, waypoint=(
        Waypoint(lat_deg=41.3, lon_deg=2.3), Waypoint(lat_deg=41.32, lon_deg=2.3), Waypoint(lat_deg=41.32, lon_deg=2.35),
    )),
)  # fmt: skip


@pytest.mark.parametrize("target", EVERY_KIND, ids=lambda t: f"{t.craft or 'aircraft'}-{t.kind}")
def test_derivatives_are_those_of_the_position_and_continuous(target: Target) -> None:
    truth = scripted(target)
    when = inside(truth, count=1500)[3:-3]
    h = 0.02
    before, at, after = (motion_of(truth, when + d) for d in (-h, 0.0, h))
    for lower, upper in ((0, 1), (1, 2), (2, 3)):
        np.testing.assert_allclose((after[lower] - before[lower]) / (2 * h), at[upper], rtol=0, atol=3e-3)
    # Nothing begins with a jerk: an airliner's roll, a ship's rudder.
    assert np.linalg.norm(at.jerk, axis=1).max() < 10.0
    assert np.linalg.norm(at.acceleration, axis=1).max() < 11.0


def test_a_constant_course_is_a_geodesic_at_constant_speed_and_pressure_level() -> None:
    truth = scripted(Target(**START | {"height_m": 9144.0}, pressure_levels=True, speed_mps=240.0, course_deg=60.0))
    when = inside(truth)
    motion = motion_of(truth, when)
    _, longitude, height = geodetic_from_ecef(motion.position)
    np.testing.assert_allclose(truth.geodetic(motion.position)[2], 9144.0, atol=1e-3)
    # ISA + 10 at 9,144 m and 80 m of shift: far from the ellipsoidal height.
    assert height.mean() == pytest.approx(float(AIR.geometric_m(np.array([9144.0]))[0]), abs=1e-3)
    assert height.mean() - 9144.0 > 400
    assert np.degrees(truth.course_rad(motion.position, motion.velocity))[0] == pytest.approx(60.0, abs=1e-5)
    flat = local(motion.position, motion.velocity)
    np.testing.assert_allclose(np.hypot(flat[:, 0], flat[:, 1]), 240.0, atol=1e-3)
    across = local(motion.position, motion.acceleration)[:, :2]
    assert np.abs(across).max() < 0.02  # what is left is the frame: meridians converge, the local level turns
    # Clairaut: along a geodesic of a surface of revolution, the distance from the axis times sin(course) is constant.
    course = truth.course_rad(motion.position, motion.velocity)
    clairaut = np.hypot(motion.position[:, 0], motion.position[:, 1]) * np.sin(course)
    assert np.ptp(clairaut) / clairaut.mean() < 2e-9
    assert np.ptp(longitude) > 0.03


def test_a_turn_has_the_radius_of_speed_over_rate_and_closes() -> None:
    rate = math.radians(3.0)
    truth = scripted(Target(**START, kind="turning", speed_mps=200.0, course_deg=90.0, turn_dps=3.0))
    when = np.linspace(0.0, 120.0, 361)
    motion = motion_of(truth, when)
    position = motion.position
    assert np.linalg.norm(position[0] - position[-1]) < 0.1
    centre = (position[0] + position[180]) / 2
    around = local(centre[None], position - centre)[:, :2]
    # At 3,000 m and over 8 km the Earth's curvature is worth a metre in a hundred thousand.
    np.testing.assert_allclose(np.hypot(around[:, 0], around[:, 1]), 200.0 / rate, rtol=3e-6)
    turned = np.unwrap(truth.course_rad(position, motion.velocity))
    # Seen from the ground; the meridians there have converged by the longitude times the sine of the latitude.
    latitude, longitude, _ = geodetic_from_ecef(position)
    converged = (longitude - longitude[0]) * np.sin(latitude.mean())
    np.testing.assert_allclose(turned, math.radians(90.0) + rate * when + converged, atol=2e-6)
    lateral = np.hypot(*local(position, motion.acceleration)[:, :2].T)
    np.testing.assert_allclose(lateral, 200.0 * rate, rtol=2e-3)


def test_a_turn_begins_and_ends_where_it_is_told() -> None:
    truth = scripted(EVERY_KIND[1])
    course = np.unwrap(truth.course_rad(*motion_of(truth, np.array([0.0, 50.0, 110.0, 170.0, 300.0]))[:2]))
    # Meridians converge by 0.1 degree over this.
    assert np.degrees(course[1] - course[0]) == pytest.approx(0.0, abs=0.1)
    assert np.degrees(course[2] - course[0]) == pytest.approx(-100.0, abs=0.2)
    assert np.degrees(course[4] - course[0]) == pytest.approx(-200.0, abs=0.3)
    assert np.degrees(course[3] - course[0]) == pytest.approx(-200.0, abs=0.3)


def test_a_serpentine_has_its_amplitude_and_period_about_its_course() -> None:
    wave = {"speed_mps": 100.0, "course_deg": 20.0}
    truth = scripted(
        Target(**START, **wave), Target(**START, **wave, kind="serpentine", amplitude_m=800.0, period_s=90.0, phase_deg=30.0)
    )
    when = np.linspace(0.0, 1000.0, 2001)
    middle, swung = (motion_of(truth, when, k) for k in (0, 1))
    course = truth.course_rad(middle.position, middle.velocity)
    off = local(middle.position, swung.position - middle.position)
    right = off[:, 0] * np.cos(course) - off[:, 1] * np.sin(course)
    along = off[:, 0] * np.sin(course) + off[:, 1] * np.cos(course)
    np.testing.assert_allclose(right, 800.0 * np.sin(2 * np.pi * when / 90.0 + np.radians(30.0)), atol=2e-3)
    assert np.abs(along).max() < 0.01
    np.testing.assert_allclose(geodetic_from_ecef(swung.position)[2], 3000.0, atol=1e-3)


def test_a_climb_has_its_rate_and_levels_off_at_its_height() -> None:
    truth = scripted(EVERY_KIND[0])
    when = np.array([0.0, 70.0, 200.0, 300.0, 600.0, 1100.0])
    motion = motion_of(truth, when)
    height = geodetic_from_ecef(motion.position)[2]
    rise = local(motion.position, motion.velocity)[:, 2]
    np.testing.assert_allclose(rise, [0.0, 0.0, 9.0, 9.0, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(height, [3000.0, 3000.0, 3900.0, 4800.0, 6000.0, 6000.0], atol=1e-2)
    every = motion_of(truth, inside(truth, count=3000))
    assert np.abs(local(every.position, every.acceleration)[:, 2]).max() < 0.42


def test_a_radial_approach_keeps_its_azimuth_and_ends_at_the_radar() -> None:
    site = ecef_from_geodetic(np.radians(41.5), np.radians(1.9), 780.0)
    axes = enu_from_ecef(np.radians(41.5), np.radians(1.9))
    truth = scripted(EVERY_KIND[4])
    polar = polar_from_position(motion_of(truth, inside(truth)).position, site, axes)
    assert polar[0, 0] == pytest.approx(120e3, abs=1e-2)
    assert np.degrees(polar[0, 1]) == pytest.approx(133.0, abs=1e-7)
    far = polar[:, 0] > 10e3
    assert np.degrees(np.abs(polar[far, 1] - polar[0, 1])).max() < 3e-3
    ground = polar[:, 0] * np.cos(polar[:, 2])
    assert (np.diff(ground) < 0).all()
    assert ground[-1] < 1.0
    place = {"towards_lat_deg": 41.5, "towards_lon_deg": 1.9, "lat_deg": 41.0, "lon_deg": 1.9, "height_m": 1000.0}
    truth = scripted(Target(kind="approaching", speed_mps=100.0, **place))
    # 0.5 degrees of the meridian at 41.25 N are 55,534 m (Vincenty), and the path lies 1,000 m above it.
    assert truth.last_s[0] == pytest.approx(555.34 * (1 + 1000 / 6.36e6), abs=0.05)


def test_waypoints_are_passed_at_their_time_and_corners_rounded() -> None:
    points = [(41.2, 2.0, 3000.0, 0.0), (41.5, 2.0, 5000.0, 200.0), (41.5, 2.6, 5000.0, 500.0), (41.1, 2.9, 4000.0, 800.0)]
    way = tuple(Waypoint(lat_deg=a, lon_deg=b, height_m=h, time_s=t) for a, b, h, t in points)
    truth = scripted(Target(kind="waypoints", waypoint=way))
    assert (truth.first_s[0], truth.last_s[0]) == (0.0, 800.0)
    motion = motion_of(truth, np.array([p[3] for p in points]))
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    off = (
        np.hypot(latitude - np.radians([p[0] for p in points]), (longitude - np.radians([p[1] for p in points])) * 0.75) * 6.37e6
    )
    assert off[[0, 3]].max() < 1e-3
    assert 50 < off[1] < 4000
    assert 50 < off[2] < 4000
    np.testing.assert_allclose(height[[0, 3]], [3000.0, 4000.0], atol=1e-2)
    every = motion_of(truth, inside(truth, count=2000))
    flat = local(every.position, every.acceleration)
    assert np.hypot(flat[:, 0], flat[:, 1]).max() < 1.05 * 9.80665 * math.tan(math.radians(25.0))
    # Half-way between waypoints, away from corners, it flies straight with the speed of the leg.
    leg = np.linalg.norm(np.diff(ecef_from_geodetic(*np.radians([[p[0], p[1]] for p in points]).T, 5000.0), axis=0), axis=1)
    middle = motion_of(truth, np.array([350.0]))
    assert np.linalg.norm(middle.velocity) == pytest.approx(leg[1] / 300.0, rel=2e-4)


def test_ships_sail_on_the_sea_with_their_length_and_are_seen() -> None:
    truth = scripted(EVERY_KIND[6], EVERY_KIND[7], Target(kind="straight", mmsi=224_000_001, callsign="ECAB", lat_deg=41.25,
                                                       lon_deg=2.3, speed_mps=5.0, course_deg=0.0, length_m=120.0))  # fmt: skip
    assert truth.flights == 0
    for k in range(3):
        motion = motion_of(truth, inside(truth, k), k)
        np.testing.assert_allclose(geodetic_from_ecef(motion.position)[2], 49.5, atol=1e-3)
        heading = truth.heading_rad(np.full(400, k), inside(truth, k), motion)
        assert np.abs(wrap_rad(heading - truth.course_rad(motion.position, motion.velocity))).max() < 2e-3
    assert truth.length_m[[0, 2]].tolist() == [34.0, 120.0]
    assert truth.ships.mmsi[2] == 224_000_001
    assert unpack_callsigns(truth.ships.callsign)[2] == "ECAB"
    assert set(observe_radar(truth, COAST, np.random.default_rng(4)).target.tolist()) == {0, 1, 2}
    assert set(observe_ais(truth, Ais(), np.random.default_rng(4)).target.tolist()) == {0, 1, 2}


def test_what_lasts_but_a_moment_or_began_before_the_scene_is_smooth_too() -> None:
    early = (Waypoint(lat_deg=41.0, lon_deg=2.0, time_s=-300.0), Waypoint(lat_deg=41.0, lon_deg=2.5, time_s=200.0))
    truth = scripted(
        Target(**START, speed_mps=200.0, course_deg=90.0, start_s=1199.9),
        Target(**START, speed_mps=200.0, course_deg=90.0, end_s=0.5),
        Target(**START, speed_mps=0.0, course_deg=90.0),
        Target(kind="waypoints", height_m=1000.0, waypoint=early),
    )
    assert truth.first_s.tolist() == [1199.9, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(truth.last_s, [1200.0, 0.5, 1200.0, 200.0])
    for k in range(4):
        assert np.linalg.norm(motion_of(truth, inside(truth, k), k).jerk, axis=1).max() < 1e-3
    begun = geodetic_from_ecef(motion_of(truth, np.zeros(1), 3).position)
    assert np.degrees(begun[1][0]) == pytest.approx(2.3, abs=1e-4)
    assert len(observe_radar(truth, RADAR, np.random.default_rng(1)).plots) > 0


def test_copies_fly_in_formation_with_identities_that_count_upwards() -> None:
    truth = scripted(
        Target(
            **START, name="viper", speed_mps=200.0, course_deg=30.0, count=4, spacing_m=500.0, mode_s="3C6580", callsign="VIPER"
        ),
        Target(**START, speed_mps=200.0, course_deg=30.0, count=2, spacing_s=60.0, end_s=600.0, adsb=False),
    )
    assert truth.names == ("viper-1", "viper-2", "viper-3", "viper-4", "target 2-1", "target 2-2")
    assert [f"{v:06X}" for v in truth.aircraft.mode_s[:4]] == ["3C6580", "3C6581", "3C6582", "3C6583"]
    assert unpack_callsigns(truth.aircraft.callsign)[:4] == ["VIPER1", "VIPER2", "VIPER3", "VIPER4"]
    assert len(set(truth.aircraft.mode_s.tolist())) == 6
    for seconds, within in ((0.0, 1e-3), (300.0, 4.0)):
        # Each keeps the course of 30 degrees where it began; over 60 km those converge a little.
        first = motion_of(truth, np.array([seconds]))
        course = float(truth.course_rad(first.position, first.velocity)[0])
        for k in (1, 2, 3):
            off = local(first.position, motion_of(truth, np.array([seconds]), k).position - first.position)[0]
            np.testing.assert_allclose(off[:2], 500.0 * k * np.array([math.cos(course), -math.sin(course)]), atol=k * within)
    assert truth.first_s[4:].tolist() == [0.0, 60.0]
    assert truth.last_s[4:].tolist() == [600.0, 660.0]
    np.testing.assert_allclose(motion_of(truth, np.array([100.0]), 4)[0], motion_of(truth, np.array([160.0]), 5)[0], atol=1e-6)
    assert (truth.aircraft.accuracy[4:] == -1).all()
    seen = observe_adsb(truth, Adsb(share=1.0), np.random.default_rng(1))[1]
    assert set(seen.tolist()) == {0, 1, 2, 3}


def test_they_join_traffic_and_shipping_without_changing_them() -> None:
    plain = sail_shipping(Shipping(ships=4), nothing(5), 1200.0, (0.0, 0.0), np.random.default_rng(5))
    assert script_targets((), plain, 1200.0, (), np.random.default_rng(6)) is plain
    both = script_targets((EVERY_KIND[0], EVERY_KIND[6]), plain, 1200.0, (RADAR,), np.random.default_rng(6))
    assert (both.flights, len(both)) == (6, 11)
    assert both.names == ("",) * 5 + ("target 1",) + ("",) * 4 + ("target 2",)
    when = np.linspace(200.0, 900.0, 50)
    for old, new in ((0, 0), (4, 4), (5, 6), (8, 9)):
        np.testing.assert_array_equal(motion_of(plain, when, old).position, motion_of(both, when, new).position)
    np.testing.assert_array_equal(both.aircraft.mode_s[:5], plain.aircraft.mode_s)
    np.testing.assert_array_equal(both.ships.mmsi[:4], plain.ships.mmsi)
    again = script_targets((EVERY_KIND[0], EVERY_KIND[6]), plain, 1200.0, (RADAR,), np.random.default_rng(6))
    np.testing.assert_array_equal(again.aircraft.mode_s, both.aircraft.mode_s)
    assert set(observe_radar(both, RADAR, np.random.default_rng(4)).target.tolist()) >= {5}
    assert set(observe_radar(nothing(), RADAR, np.random.default_rng(4)).target.tolist()) == set()


def fixes_of(truth: Truth, target: int, when: np.ndarray, **columns: object) -> Fixes:
    motion = motion_of(truth, when, target, 1)
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    return Fixes(time_s=EPOCH_S + when, latitude_rad=latitude, longitude_rad=longitude, height_m=height, track=np.ones(len(when)),
                 horizontal_sd_m=np.full(len(when), 0.02), vertical_sd_m=np.full(len(when), 0.04), **columns)  # fmt: skip


def test_a_replay_passes_through_what_was_recorded(tmp_path: Path) -> None:
    made = scripted(EVERY_KIND[1])
    fixes = fixes_of(made, 0, np.arange(10.0, 400.0, 0.5))
    # A gap of 20 s, straight ahead, is bridged.
    fixes = fixes[(fixes.time_s < EPOCH_S + 250) | (fixes.time_s > EPOCH_S + 270)]
    write_rtklib(tmp_path / "flight.pos", fixes)
    replay = Target(kind="replay", recording=str(tmp_path / "flight.pos"), mode_3a="2053")
    truth = scripted(replay)
    assert truth.first_s[0] == pytest.approx(10.0, abs=1e-6)
    assert truth.last_s[0] == pytest.approx(399.0, abs=1.0)
    assert truth.aircraft.mode_3a.tolist() == [0o2053]
    when = fixes.time_s - EPOCH_S
    when = when[(when >= truth.first_s[0]) & (when <= truth.last_s[0])]
    off = np.linalg.norm(motion_of(truth, when).position - motion_of(made, when).position, axis=1)
    assert np.median(off) < 0.02
    assert off.max() < 0.3
    gap = np.arange(252.0, 269.0)
    assert np.linalg.norm(motion_of(truth, gap).position - motion_of(made, gap).position, axis=1).max() < 1.0
    steady = np.linspace(20.0, 390.0, 300)
    np.testing.assert_allclose(motion_of(truth, steady).velocity, motion_of(made, steady).velocity, atol=0.3)
    later = scripted(msgspec.structs.replace(replay, start_s=300.0, count=2, spacing_m=1000.0, spacing_deg=0.0))
    assert later.first_s.tolist() == [300.0, 300.0]
    np.testing.assert_allclose(motion_of(later, steady + 290.0).position, motion_of(truth, steady).position, atol=0.2)
    one, other = (motion_of(later, np.array([400.0]), k).position for k in (0, 1))
    np.testing.assert_allclose(local(one, other - one)[0, :2], [0.0, 1000.0], atol=0.5)


def test_a_replay_of_noisy_positions_is_smooth_and_stays_near_them(tmp_path: Path) -> None:
    made = scripted(EVERY_KIND[5])
    rng = np.random.default_rng(8)
    fixes = fixes_of(made, 0, np.arange(0.0, 680.0, 1.0))
    noise = rng.normal(0.0, 8.0 / 6.37e6, (2, len(fixes)))
    fixes = fixes.replace(latitude_rad=fixes.latitude_rad + noise[0], longitude_rad=fixes.longitude_rad + noise[1],
                          horizontal_sd_m=np.full(len(fixes), 8.0), vertical_sd_m=np.full(len(fixes), 8.0))  # fmt: skip
    write_rtklib(tmp_path / "noisy.pos", fixes)
    truth = scripted(Target(kind="replay", recording=str(tmp_path / "noisy.pos")))
    when = np.linspace(20.0, 660.0, 2000)
    replayed, real = motion_of(truth, when), motion_of(made, when)
    assert np.sqrt(np.mean((replayed.position - real.position) ** 2)) < 5.0
    assert np.linalg.norm(replayed.acceleration - real.acceleration, axis=1).max() < 2.5
    assert np.linalg.norm(replayed.jerk, axis=1).max() < 2.0


def test_replaying_names_what_there_is_and_what_is_missing(tmp_path: Path) -> None:
    k = np.repeat(np.arange(40), 2)
    second = np.tile([False, True], 40)
    path = tmp_path / "two.csv"
    write_table(path, Fixes(
        time_s=EPOCH_S + 2.0 * k, mode_s=np.where(second, 0x3C658A, 0x3C6589), height_m=np.full(80, 3000.0),
        latitude_rad=np.radians(41.0 + np.where(second, 0.002, 0.004) * k), longitude_rad=np.radians(2.0 + second),
    ))  # fmt: skip
    with pytest.raises(SettingsError, match=r"target 1 \('copycat'\): .*holds 2 targets.*3C6589"):
        scripted(Target(kind="replay", name="copycat", recording=str(path)))
    with pytest.raises(SettingsError, match="holds no target of mode_s ABCDEF"):
        scripted(Target(kind="replay", recording=str(path), mode_s="ABCDEF"))
    truth = scripted(Target(kind="replay", recording=str(path), mode_s="3C658A"))
    assert truth.aircraft.mode_s.tolist() == [0x3C658A]
    speed = np.linalg.norm(motion_of(truth, np.array([40.0])).velocity)
    assert speed == pytest.approx(0.001 * 111_111, rel=2e-3)
    elsewhere = replace(nothing(), epoch_s=EPOCH_S + 900.0)
    with pytest.raises(SettingsError, match="not within the scene"):
        script_targets(
            (Target(kind="replay", recording=str(path), mode_s="3C658A"),), elsewhere, 1200.0, (), np.random.default_rng(1)
        )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "zigzag"}, "no way that a target moves.*serpentine"),
        ({"kind": "turning"}, "needs turn_dps"),
        ({"turn_dps": 3.0}, "of no use for kind = 'straight'"),
        ({"lat_deg": None}, "where it starts"),
        ({"range_m": 1000.0, "azimuth_deg": 3.0, "radar": "hill"}, "told twice"),
        ({"radar": "hill"}, "no use without range_m"),
        ({"lat_deg": None, "lon_deg": None, "range_m": 1e4, "azimuth_deg": 3.0}, "of which radar"),
        ({"lat_deg": None, "lon_deg": None, "range_m": 1e4, "azimuth_deg": 3.0, "radar": "hil"}, "no radar 'hil'.*hill, coast"),
        ({"height_m": None}, "needs height_m"),
        ({"craft": "ship", "speed_mps": 9.0}, "has no height"),
        ({"craft": "tank"}, "Known: aircraft, ship"),
        ({"speed_mps": -3.0}, "speed_mps"),
        ({"speed_mps": math.nan}, "speed_mps"),
        ({"start_s": 5000.0}, "not within the scene"),
        ({"start_s": 50.0, "end_s": 40.0}, "not after"),
        ({"count": 3}, "lie on one another"),
        ({"spacing_m": 30.0}, "there is one target"),
        ({"climb_mps": 5.0, "to_height_m": 100.0}, "never comes to"),
        ({"to_height_m": 100.0}, "without climb_mps"),
        ({"climb_mps": 200.0}, "height runs from 3,000"),
        ({"mode_s": "G12"}, "no address"),
        ({"mode_3a": "9999"}, "Four octal"),
        ({"callsign": "TOOLONGNAME"}, "at most 8"),
        ({"mmsi": 12, "craft": "aircraft"}, "none of a ship"),
        ({"length_m": 0.0}, "length_m"),
        ({"kind": "serpentine", "amplitude_m": 5000.0, "period_s": 10.0}, "pulls .* g"),
        ({"kind": "approaching", "course_deg": None}, "what it approaches"),
        ({"kind": "approaching", "course_deg": None, "towards_lat_deg": 41.2, "towards_lon_deg": 2.4}, "it is where it is to go"),
        ({"kind": "replay"}, "needs recording"),
    ],
)  # fmt: skip
def test_mistakes_are_one_clear_line(changes: dict[str, object], words: str) -> None:
    target = Target(**START | {"speed_mps": 200.0, "course_deg": 30.0} | changes)
    with pytest.raises(SettingsError, match=words) as caught:
        scripted(target)
    assert str(caught.value).startswith("target 1: ")
    assert "\n" not in str(caught.value)


def test_mistakes_of_waypoints() -> None:
    near, far = Waypoint(lat_deg=41.0, lon_deg=2.0, height_m=1000.0), Waypoint(lat_deg=41.5, lon_deg=2.0, height_m=1000.0)
    for points, words in (
        ((near,), "at least two"),
        ((near, near), "one place"),
        ((near, far), "no speed_mps"),
        ((near, msgspec.structs.replace(far, time_s=10.0)), "some waypoints have a time"),
        ((msgspec.structs.replace(near, time_s=0.0), msgspec.structs.replace(far, time_s=10.0)), "5554 m/s, more than 1000"),
        ((msgspec.structs.replace(near, time_s=9.0), msgspec.structs.replace(far, time_s=9.0)), "a second or more after"),
        ((msgspec.structs.replace(near, height_m=None), far), "no height_m"),
    ):
        with pytest.raises(SettingsError, match=words):
            scripted(Target(kind="waypoints", waypoint=points))
    with pytest.raises(SettingsError, match="adsb = true"):
        check_target(Target(**START, speed_mps=9.0, course_deg=0.0, adsb=True), (), 100.0, adsb=False)
    with pytest.raises(SettingsError, match="have the same mode_s"):
        scripted(*[Target(**START, speed_mps=9.0, course_deg=0.0, mode_s="3C6589")] * 2)


@pytest.mark.real
def test_a_recorded_airliner_flies_again(data: Path) -> None:
    """An approach to Barcelona: near the reports of a receiver, and flyable, which the reports themselves are not."""
    path, date = data / "lebl-2016" / "adsb_cat021v023_160510-lebl-220001.ast", datetime.date(2016, 5, 10)
    fixes = read(path, date=date).fixes
    mine = fixes[fixes.mode_s == 0x34469A]
    began = replace(nothing(duration_s=7200.0), epoch_s=float(fixes.time_s[0]))
    target = Target(kind="replay", recording=str(path), mode_s="34469A", date=date)
    truth = script_targets((target,), began, 7200.0, (), np.random.default_rng(1))
    when = mine.time_s - truth.epoch_s
    inside_it = (when > truth.first_s[0]) & (when < truth.last_s[0])
    assert np.count_nonzero(inside_it) > 1500
    motion = motion_of(truth, when[inside_it])
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    away = np.hypot(latitude - mine.latitude_rad[inside_it], (longitude - mine.longitude_rad[inside_it]) * 0.75) * 6.37e6
    assert np.median(away) < 5
    assert np.linalg.norm(motion.acceleration, axis=1).max() < 6
    level = mine.pressure_altitude_m[inside_it]
    assert np.nanmedian(np.abs(height - AIR.geometric_m(level))) < 10
