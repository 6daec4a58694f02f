"""Simulated ships: do they sail as ships do, and do their AIS messages say so in the words of the standard?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyais
import pytest

from boresight.errors import SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.measure import wrap_rad
from boresight.model import unpack_callsigns
from boresight.reading import read
from boresight.simulation import Ais, Radar, Scenario, Shipping, Simulated, Traffic, simulate
from boresight.writing.nmea import AisPositions, AisStatics, checksum, write_ais

KNOT_MPS = 1852 / 3600
SEA_M = 49.5
COAST = Radar(
    name="coast", sac=20, sic=4, lat_deg=41.36, lon_deg=2.17, height_m=SEA_M + 80.0, kind="marine", scan_s=3.0, min_range_m=300.0,
    max_range_m=45e3, min_elevation_deg=-20.0, detection=1.0, range_sd_m=1e-9, azimuth_sd_deg=1e-9, range_quantum_m=0.0,
    azimuth_quantum_deg=0.0, time_quantum_s=0.0, ground_height_m=SEA_M, errors={"along_heading_per_length": -0.3},
)  # fmt: skip


def scene(seed: int = 1, **changes: object) -> Simulated:
    shipping = Shipping(**({"ships": 30, "lat_deg": 41.335, "lon_deg": 2.18, "sea_level_m": SEA_M} | changes))
    return simulate(
        Scenario(
            duration_s=1800.0, traffic=Traffic(aircraft=2, arrivals=0, departures=0), shipping=shipping, radar=(COAST,),
            ais=Ais(loss=0.0),
        ), seed,
    )  # fmt: skip


@pytest.fixture(scope="module")
def sea() -> Simulated:
    return scene()


def sampled(run: Simulated, step: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    truth = run.truth
    when = [np.arange(truth.first_s[k], truth.last_s[k], step) for k in range(truth.flights, len(truth))]
    return truth.flights + np.repeat(np.arange(len(when)), [len(w) for w in when]), np.concatenate(when)


def test_ships_sail_as_ships_do(sea: Simulated) -> None:
    target, when = sampled(sea)
    motion = sea.truth.motion(target, when)
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    assert np.abs(height - SEA_M).max() < 1e-3
    local = enu_from_ecef(latitude, longitude)
    velocity, acceleration = rotate(local, motion.velocity), rotate(local, motion.acceleration)
    speed = np.hypot(velocity[:, 0], velocity[:, 1]) / KNOT_MPS
    ships, row = sea.truth.ships, target - sea.truth.flights
    assert speed.max() < 22
    assert np.hypot(acceleration[:, 0], acceleration[:, 1]).max() < 0.6
    # Big ships turn slowly; small boats may do three degrees a second.
    sailing = speed > 3
    rate = np.degrees(velocity[:, 1] * acceleration[:, 0] - velocity[:, 0] * acceleration[:, 1]) / (speed * KNOT_MPS) ** 2
    assert np.abs(rate[sailing & (ships.length_m[row] > 100)]).max() < 1.2
    assert np.abs(rate[sailing]).max() < 4
    assert ships.length_m.min() >= 10
    assert ships.length_m.max() <= 300
    assert np.ptp(ships.length_m) > 150
    # At anchor they swing, hardly moving over the ground.
    anchored = speed < 2
    assert 1 <= len(np.unique(target[anchored])) <= 3
    assert (ships.bow_m < ships.length_m).all()
    assert (ships.port_m < ships.width_m).all()
    assert len(np.unique(ships.mmsi)) == 30


def test_heading_is_not_course_but_nearly(sea: Simulated) -> None:
    """The current sets ships off by some degrees; without one they go where they point (but for a step's half in sharp turns)."""
    for run, low, high in ((sea, 0.5, 12.0), (scene(current_mps=0.0, anchored=0.0), 0.0, 2.5)):
        target, when = sampled(run)
        motion = run.truth.motion(target, when)
        moving = np.sqrt((motion.velocity**2).sum(axis=1)) > 2.0
        drift = wrap_rad(run.truth.heading_rad(target, when, motion) - run.truth.course_rad(motion.position, motion.velocity))
        drift = np.degrees(np.abs(drift[moving]))
        assert low <= np.percentile(drift, 90)
        assert drift.max() < high
        assert np.median(drift) < (0.3 if low == 0 else 4.0)


def test_lanes_have_two_directions(sea: Simulated) -> None:
    """Passing ships keep to the lane of their direction along the coast."""
    passing = sea.truth.flights + np.arange(12)
    middle = (sea.truth.first_s[passing] + sea.truth.last_s[passing]) / 2
    motion = sea.truth.motion(passing, middle)
    port = ecef_from_geodetic(np.radians(41.335), np.radians(2.18), SEA_M)
    enu = enu_from_ecef(np.radians(41.335), np.radians(2.18))
    out = np.array([np.sin(np.radians(140.0)), np.cos(np.radians(140.0)), 0])
    along = np.array([np.sin(np.radians(230.0)), np.cos(np.radians(230.0)), 0])
    off = rotate(enu, motion.position - port) @ out
    way = rotate(enu, motion.velocity) @ along
    assert (np.abs(way) > 3).all()
    assert 3 <= np.count_nonzero(way > 0) <= 9
    assert off[way > 0].max() < off[way < 0].min()


def test_the_marine_radar_sees_ships_and_their_extent(sea: Simulated) -> None:
    """The echo lies 0.3 of the ship's length behind the middle of the hull: exactly there, seen from the antenna."""
    seen = sea.observations[0]
    assert seen.target.min() == sea.truth.flights
    assert (seen.plots.mode_s == -1).all()
    assert len(seen.marks.time_s) == 0
    motion = sea.truth.motion(seen.target, seen.plots.time_s - sea.truth.epoch_s)
    heading = sea.truth.heading_rad(seen.target, seen.plots.time_s - sea.truth.epoch_s, motion)
    latitude, longitude, _ = geodetic_from_ecef(motion.position)
    local = enu_from_ecef(latitude, longitude)
    behind = -0.3 * sea.truth.length_m[seen.target]
    echo = motion.position + (behind * np.sin(heading))[:, None] * local[:, 0] + (behind * np.cos(heading))[:, None] * local[:, 1]
    place = np.radians([COAST.lat_deg, COAST.lon_deg])
    enu = rotate(enu_from_ecef(*place), echo - ecef_from_geodetic(*place, COAST.height_m))
    far = np.linalg.norm(enu, axis=1) > 3000
    # First order in extent over range: 90 m at 3 km bend by a metre.
    assert np.abs(seen.plots.range_m - np.linalg.norm(enu, axis=1))[far].max() < 1.5
    across = wrap_rad(seen.plots.azimuth_rad - np.arctan2(enu[:, 0], enu[:, 1])) * seen.plots.range_m
    assert np.abs(across[far]).max() < 3.0


def test_reports_come_as_often_as_the_standard_says(sea: Simulated) -> None:
    """ITU-R M.1371: class A every 10 s, above 14 kn every 6 s, in turns a third of it, at anchor 3 min; class B every 30 s."""
    assert sea.ais is not None
    p, ships = sea.ais.positions, sea.truth.ships
    steady = {}
    for k in range(len(ships)):
        mine = sea.ais.target == sea.truth.flights + k
        speed = np.median(p.speed_mps[mine]) / KNOT_MPS
        gap = np.diff(p.sent_s[mine])
        if ships.class_b[k]:
            assert np.median(gap) == pytest.approx(30, rel=0.1)
        elif speed < 3:
            assert np.median(gap) == pytest.approx(180, rel=0.1)
        elif np.ptp(np.unwrap(p.course_rad[mine])) < np.radians(10):
            steady[k] = (speed, np.median(gap))
        assert gap.min() > 1.5
    assert len(steady) >= 5
    for speed, gap in steady.values():
        assert gap == pytest.approx(6 if speed > 14.05 else 10, rel=0.1) or 13.9 < speed < 14.1
    told = sea.ais.statics
    for mmsi in ships.mmsi:
        assert np.diff(told.sent_s[told.mmsi == mmsi]) == pytest.approx(360.0)


def test_the_file_reads_back_as_the_ships_hulls(sea: Simulated, tmp_path: Path) -> None:
    """Antenna, heading and dimensions give back the middle of the hull, to the receivers' accuracy and AIS's own steps."""
    assert sea.ais is not None
    count = write_ais(tmp_path / "ais.nmea", sea.ais.positions, sea.ais.statics)
    recording = read(tmp_path / "ais.nmea")
    assert not recording.damaged
    assert recording.records == count
    fixes = recording.fixes
    assert len(fixes) == len(sea.ais.target)
    np.testing.assert_array_equal(fixes.mmsi, sea.ais.positions.mmsi)
    # The time of a report is its second of UTC.
    late = sea.ais.positions.sent_s - fixes.time_s
    assert late.min() > 0.05
    assert late.max() < 2.0
    row = sea.ais.target - sea.truth.flights
    ships = sea.truth.ships
    np.testing.assert_array_equal(fixes.length_m, ships.length_m[row])
    np.testing.assert_array_equal(fixes.width_m, ships.width_m[row])
    when = fixes.time_s - sea.truth.epoch_s - ships.latency_s[row]
    motion = sea.truth.motion(sea.ais.target, when)
    hull = ecef_from_geodetic(fixes.latitude_rad, fixes.longitude_rad, np.full(len(fixes), SEA_M))
    off = np.linalg.norm(hull - motion.position, axis=1)
    placed = ~ships.class_b[row]
    assert np.percentile(off[placed], 95) < 18
    assert np.sqrt(np.mean((off[placed] / np.hypot(ships.position_sd_m[row][placed], 2.0)) ** 2)) < 2.0
    # Without the lever arm it would be far off: the antenna of most merchant ships is aft.
    assert np.percentile(np.abs(ships.length_m[row] / 2 - ships.bow_m[row]), 75) > 40
    assert fixes.horizontal_sd_m[placed].max() == 30.0
    assert set(unpack_callsigns(fixes.callsign)) >= set(unpack_callsigns(ships.callsign[:20]))


def test_messages_say_what_was_given(tmp_path: Path) -> None:
    """By pyais itself: fields, steps, values that are not available, both classes, tag blocks with their checksum."""
    who, small = np.array([224000001, 247000002]), np.array([False, True])
    positions = AisPositions(
        sent_s=1.8e9 + np.array([0.4, 1.6]), mmsi=who, class_b=small, latitude_rad=np.radians([41.3, -0.0000017]),
        longitude_rad=np.radians([2.2, -179.9999]), speed_mps=np.array([10.0, 80.0]), course_rad=np.radians([359.96, -90.0]),
        heading_rad=np.radians([359.6, np.nan]), second=np.array([59, 0]), accurate=~small,
    )  # fmt: skip
    statics = AisStatics(
        sent_s=1.8e9 + np.array([3.0, 4.0]), mmsi=who, class_b=small, callsign=np.array([-1, -1]), ship_type=np.array([70, 37]),
        bow_m=np.array([200.0, 5.0]), stern_m=np.array([40.0, 7.0]), port_m=np.array([12.0, 2.0]),
        starboard_m=np.array([20.0, 2.0]),
    )  # fmt: skip
    assert write_ais(tmp_path / "a.nmea", positions, statics) == 6
    lines = (tmp_path / "a.nmea").read_bytes().decode("ascii").splitlines()
    for line in lines:
        _, tag, sentence = line.split("\\")
        body, given = tag.split("*")
        assert checksum(body) == given
        body, given = sentence[1:].split("*")
        assert checksum(body) == given
    assert [int(line.split("c:")[1].split("*")[0]) - 1_800_000_000 for line in lines] == [0, 1, 3, 3, 4, 4]
    raw = [line.split("\\")[2] for line in lines]
    first, second = pyais.decode(raw[0]), pyais.decode(raw[1])
    assert (first.msg_type, second.msg_type) == (1, 18)
    assert (first.mmsi, first.speed, first.course, first.heading, first.second) == (224000001, 19.4, 0.0, 0, 59)
    assert (first.lat, first.lon) == (41.3, 2.2)
    assert (first.accuracy, second.accuracy) == (True, False)
    assert (second.speed, second.course, second.heading) == (102.2, 270.0, 511)
    assert (second.lat, second.lon) == pytest.approx((-0.000002, -179.9999), abs=1e-6)
    whole = pyais.decode(*raw[2:4])
    assert (whole.msg_type, whole.ship_type, whole.to_bow, whole.to_stern, whole.to_port, whole.to_starboard) == (
        5, 70, 200, 40, 12, 20,
    )  # fmt: skip
    part = pyais.decode(raw[5])
    assert (part.msg_type, part.partno, part.ship_type, part.to_bow, part.to_stern) == (24, 1, 37, 5, 7)


def test_ships_change_nothing_of_the_air() -> None:
    """The same seed with and without ships: the same flights."""
    base = Scenario(duration_s=300.0, traffic=Traffic(aircraft=4, arrivals=0, departures=0))
    with_ships = Scenario(duration_s=300.0, traffic=base.traffic, shipping=Shipping(ships=3), ais=Ais())
    one, two = simulate(base, 5), simulate(with_ships, 5)
    when = np.full(4, 150.0)
    np.testing.assert_array_equal(one.truth.motion(np.arange(4), when).position, two.truth.motion(np.arange(4), when).position)
    assert (len(one.truth), len(two.truth)) == (4, 7)
    assert one.ais is None


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"radar": (COAST,)}, "there are none"),
        ({"ais": Ais()}, "there are none"),
        ({"shipping": Shipping(ships=0)}, "ships = 0 is not within"),
        ({"shipping": Shipping(passing=0.8, calling=0.5)}, "are more than 1"),
        ({"shipping": Shipping(radius_m=1.0)}, "radius_m = 1.0 is not within"),
        ({"shipping": Shipping(), "ais": Ais(loss=1.0)}, "loss = 1.0 is not within"),
    ],
)
def test_seas_that_make_no_sense_are_refused(changes: dict[str, object], match: str) -> None:
    with pytest.raises(SettingsError, match=match):
        simulate(Scenario(traffic=Traffic(aircraft=1, arrivals=0, departures=0), **changes), 1)
