"""AIS: parts to messages, hull centres against geodesics, values that are not available, seconds to times."""

from __future__ import annotations

from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.model import Recording
from boresight.reading.ais import hull_centre, seconds_to_time
from boresight.reading.nmea import NmeaState, decode_nmea, read_ais, read_nmea

pyais = pytest.importorskip("pyais")
pyproj = pytest.importorskip("pyproj")

NOON = 1622548800.0  # 2021-06-01 12:00:00 UTC


def sentence(body: str, start: str = "$") -> str:
    return f"{start}{body}*{reduce(lambda a, b: a ^ b, body.encode('latin-1'), 0):02X}"


def clock(second: float, minute: int = 0) -> str:
    return sentence(f"GPRMC,12{minute:02d}{second:05.2f},A,6000.000,N,01030.000,E,0.0,0.0,010621,,,A")


def message(sequence: int = 1, **fields: Any) -> list[str]:
    return list(pyais.encode_dict(fields, radio_channel="A", talker_id="AI", sentence_type="VDM", seq_id=sequence))


def position(mmsi: int = 1, **fields: Any) -> list[str]:
    given = {
        "type": 1,
        "mmsi": mmsi,
        "lat": 60.0,
        "lon": 10.5,
        "speed": 10.0,
        "course": 90.0,
        "heading": 45,
        "second": 0,
        "accuracy": 1,
    }
    return message(**(given | fields))


def static(mmsi: int, bow: int, stern: int, port: int, starboard: int, **fields: Any) -> list[str]:
    given = {"type": 5, "mmsi": mmsi, "to_bow": bow, "to_stern": stern, "to_port": port, "to_starboard": starboard}
    return message(**(given | fields))


def read(tmp_path: Path, lines: list[str]) -> Recording:
    path = tmp_path / "ais.nmea"
    path.write_text("\r\n".join(lines) + "\r\n")
    return read_nmea(path)


def targets(r: Recording) -> Any:
    return r.fixes[r.fixes.mmsi >= 0]


@given(
    st.floats(-80, 80), st.floats(-180, 179.999), st.floats(0, 360), st.floats(-250, 250), st.floats(-60, 60)
)  # fmt: skip
def test_hull_centre_lies_on_the_geodesic(lat: float, lon: float, heading: float, forward: float, right: float) -> None:
    """Against geodesics of pyproj, to a millimetre."""
    got = hull_centre(*(np.radians([v]) for v in (lat, lon, heading)), np.array([forward]), np.array([right]))
    geod = pyproj.Geod(ellps="WGS84")
    lon2, lat2, _ = geod.fwd(lon, lat, heading + np.degrees(np.arctan2(right, forward)), np.hypot(forward, right))
    _, _, distance = geod.inv(lon2, lat2, np.degrees(got[1][0]), np.degrees(got[0][0]))
    assert distance < 1e-3


def test_position_moves_to_the_middle_of_the_hull(tmp_path: Path) -> None:
    """Antenna 20 m from the bow, 80 from the stern, 5 from port, 15 from starboard: the middle is 30 m aft, 5 to starboard."""
    r = read(tmp_path, [clock(0), *static(7, 20, 80, 5, 15, callsign="LAXY"), *position(7), clock(1)])
    fix = targets(r)
    east, north = (-30 * np.sin(np.pi / 4) + 5 * np.cos(np.pi / 4)), (-30 * np.cos(np.pi / 4) - 5 * np.sin(np.pi / 4))
    lon, lat, _ = pyproj.Geod(ellps="WGS84").fwd(10.5, 60.0, np.degrees(np.arctan2(east, north)), np.hypot(east, north))
    assert np.degrees(fix.latitude_rad[0]) == pytest.approx(lat, abs=1e-9)
    assert np.degrees(fix.longitude_rad[0]) == pytest.approx(lon, abs=1e-9)
    assert (fix.length_m[0], fix.width_m[0]) == (100, 20)
    assert np.degrees(fix.heading_rad[0]) == pytest.approx(45)
    np.testing.assert_allclose([fix.velocity_east_mps[0], fix.velocity_north_mps[0]], [10 * 1852 / 3600, 0], atol=1e-9)
    assert fix.horizontal_sd_m[0] == 10.0
    assert fix.callsign[0] >= 0


def test_static_data_serve_their_own_ship_before_and_after(tmp_path: Path) -> None:
    """The last static data before a report count, else the first after it; another ship's never."""
    lines = [clock(0), *position(7), *position(8), *static(7, 10, 20, 3, 3), *position(7), *static(7, 30, 40, 3, 3), *position(7)]
    fix = targets(read(tmp_path, lines))
    np.testing.assert_array_equal(fix.length_m, [30, np.nan, 30, 70])


def test_without_a_heading_the_course_serves_above_walking_pace(tmp_path: Path) -> None:
    lines = [
        clock(0),
        *static(7, 20, 80, 10, 10),
        *position(7, heading=511),
        *position(7, heading=511, speed=1.0),
        *position(7, speed=1.0),
    ]
    r = read(tmp_path, lines)
    fix = targets(r)
    moved = np.hypot(np.degrees(fix.latitude_rad) - 60, np.degrees(fix.longitude_rad) - 10.5) > 1e-7
    assert moved.tolist() == [True, False, True]
    # Not moved: the middle is 30 m away in an unknown direction, 30/sqrt(2) m an axis.
    np.testing.assert_allclose(fix.horizontal_sd_m, [10, np.hypot(10, 30 / np.sqrt(2)), 10])


def test_unknown_place_of_the_antenna(tmp_path: Path) -> None:
    """A = C = 0 with B, D: only length and width are known."""
    fix = targets(read(tmp_path, [clock(0), *static(7, 0, 90, 0, 14), *position(7)]))
    assert (fix.length_m[0], fix.width_m[0]) == (90, 14)
    assert np.degrees(fix.latitude_rad[0]) == pytest.approx(60.0, abs=1e-12)


def test_class_b_static_data_and_motherships(tmp_path: Path) -> None:
    part_b = message(type=24, mmsi=7, partno=1, to_bow=5, to_stern=7, to_port=2, to_starboard=2)
    craft = message(type=24, mmsi=982345678, partno=1, mothership_mmsi=257000123)
    report = message(type=18, mmsi=7, lat=60.0, lon=10.5, speed=5.0, course=10.0, heading=10, second=0, accuracy=0)
    tender = message(type=18, mmsi=982345678, lat=60.0, lon=10.5, speed=5.0, course=10.0, heading=10, second=0, accuracy=0)
    fix = targets(read(tmp_path, [clock(0), *part_b, *craft, *report, *tender]))
    np.testing.assert_array_equal(fix.length_m, [12, np.nan])
    assert fix.horizontal_sd_m[0] == 30.0


def test_values_that_are_not_available(tmp_path: Path) -> None:
    lines = [
        clock(0),
        *position(1, speed=102.3, course=360.0, heading=511),
        *position(2, lat=91.0, lon=181.0),
        *position(3, second=60),
        clock(1),
    ]
    r = read(tmp_path, lines)
    fix = targets(r)
    assert fix.mmsi.tolist() == [1, 3]
    assert np.isnan(fix.velocity_east_mps[0])
    assert np.isnan(fix.heading_rad[0])
    assert fix.time_sd_s[1] > fix.time_sd_s[0]
    assert any("1 AIS reports say that their position is not available" in w for w in r.warnings)
    assert not r.damaged


def test_long_range_report_is_coarse(tmp_path: Path) -> None:
    fix = targets(read(tmp_path, [clock(0), *message(type=27, mmsi=5, lat=60.1, lon=10.5, speed=12, course=90, accuracy=1)]))
    assert np.degrees(fix.latitude_rad[0]) == pytest.approx(60.1, abs=1e-9)
    assert fix.horizontal_sd_m[0] > 50
    assert fix.velocity_east_mps[0] == pytest.approx(12 * 1852 / 3600)


def test_latitude_beyond_the_pole_is_damage(tmp_path: Path) -> None:
    body = bytearray(position(1)[0].split(",")[5].encode())
    bits = int("".join(f"{(c - 48 if c < 96 else c - 56):06b}" for c in body), 2)
    n = 6 * len(body)
    raw = round(95.0 * 600000)
    bits = bits & ~(((1 << 27) - 1) << (n - 116)) | raw << (n - 116)
    payload = "".join(chr(v + 48 if v < 40 else v + 56) for v in ((bits >> s) & 63 for s in range(n - 6, -1, -6)))
    r = read(tmp_path, [clock(0), sentence(f"AIVDM,1,1,,A,{payload},0", "!"), *position(2)])
    assert targets(r).mmsi.tolist() == [2]
    assert "95.0000" in r.damaged[0].why
    assert r.damaged[0].offset == len(clock(0)) + 2


def test_parts_that_are_interleaved_lost_or_doubled(tmp_path: Path) -> None:
    a, b = static(7, 20, 80, 5, 15, callsign="A"), static(8, 30, 30, 5, 5)
    b = [line.replace(",2,1,1,A,", ",2,1,2,A,").replace(",2,2,1,A,", ",2,2,2,A,") for line in b]
    b = [sentence(line[1 : line.index("*")], "!") for line in b]
    assert len(a) == len(b) == 2
    r = read(tmp_path, [clock(0), a[0], b[0], a[1], b[1], *position(7), *position(8)])
    assert not r.damaged
    np.testing.assert_array_equal(targets(r).length_m, [100, 60])
    # The second part first; the first part twice; no second part.
    assert targets(read(tmp_path, [clock(0), a[1], a[0], *position(7)])).length_m.tolist() == [100]
    r = read(tmp_path, [clock(0), a[0], a[0], a[1], *position(7)])
    assert targets(r).length_m.tolist() == [100]
    assert [d.offset for d in r.damaged] == [len(clock(0)) + 2]
    r = read(tmp_path, [clock(0), a[0], *position(7)])
    assert "part 2 of 2" in r.damaged[0].why


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("AIVDM,1,1,,A,15MgK45P3@,0", "only"),
        ("AIVDM,1,1,,A,15Mg{45P3@G?fl0E`JbR0OwT0@MS,0", "character"),
        ("AIVDM,1,1,,A,15MgK45P3@G?fl0E`JbR0OwT0@MS,9", "fill bits"),
        ("AIVDM,1,2,,A,15MgK45P3@G?fl0E`JbR0OwT0@MS,0", "part"),
        ("AIVDM,1,1,A,15MgK45P3@G?fl0E`JbR0OwT0@MS", "fields"),
        ("AIVDM,1,1,,A,w5MgK45P3@G?fl0E`JbR0OwT0@MS,0", "type 63"),
    ],
)
def test_what_is_no_message_is_said(tmp_path: Path, body: str, why: str) -> None:
    r = read(tmp_path, [clock(0), sentence(body, "!"), *position(7)])
    assert targets(r).mmsi.tolist() == [7]
    assert why in r.damaged[0].why


def test_times_are_the_reports_own_seconds(tmp_path: Path) -> None:
    """A report of second 58 that comes at 12:01:01 is of 12:00:58, and one of second 2 that comes at 12:00:59 is of 12:01:02."""
    lines = [clock(59), *position(1, second=2), clock(1, 1), *position(2, second=58), clock(2, 1)]
    np.testing.assert_array_equal(targets(read(tmp_path, lines)).time_s - NOON, [62, 58])


@given(st.floats(1e9, 2e9), st.integers(0, 59))
def test_the_minute_of_a_second_is_the_one_that_fits_its_sentence(coarse: float, second: int) -> None:
    time, sd = seconds_to_time(np.array([coarse]), np.zeros(1), np.array([second]))
    assert time[0] % 60 == second
    assert -45.5 <= time[0] - coarse <= 15.5
    assert sd[0] == pytest.approx(0.3 if abs(time[0] - coarse) < 9.5 else max(0.3, abs(time[0] - coarse) / 2), abs=0.3) or (
        abs(abs(time[0] - coarse) - 10) < 0.6
    )


def test_base_station_gives_the_time_where_nothing_else_does(tmp_path: Path) -> None:
    def station(second: int) -> list[str]:
        return message(type=4, mmsi=2570001, year=2021, month=6, day=1, hour=12, minute=0, second=second, lat=60.0, lon=10.0)

    r = read(tmp_path, [*station(10), *position(1, second=13), *position(2, second=16), *station(20), *position(3, second=21)])
    np.testing.assert_array_equal(targets(r).time_s - NOON, [13, 16, 21])
    assert any("base stations" in w for w in r.warnings)


def test_own_ship_from_aivdo_turns_relative_bearings(tmp_path: Path) -> None:
    vdo = [sentence(line[1 : line.index("*")].replace("AIVDM", "AIVDO"), "!") for line in position(9, heading=100, second=0)]
    target = sentence("RATTM,01,1.0,20.0,R,7.0,20.0,T,0.0,0.0,N,,T,,120001,A")
    r = read(tmp_path, ["1622548800;" + vdo[0], "1622548801;" + target])
    np.testing.assert_allclose(np.degrees(r.platform.latitude_rad), 60.0, atol=1e-9)
    assert np.degrees(r.plots.azimuth_rad[0]) == pytest.approx(120.0)


def test_stream_joins_parts_and_keeps_dimensions() -> None:
    state = NmeaState()
    for line in [clock(0), *static(7, 20, 80, 5, 15), clock(1), *position(7, second=1)]:
        records, state, _ = decode_nmea((line + "\n").encode(), state)
    assert records.fixes.length_m.tolist() == [100]
    assert records.fixes.time_s.tolist() == [NOON + 1]


@pytest.mark.real
def test_sample_is_read(data: Path) -> None:
    """898 sentences, 100 of them empty; the six base station reports are of 2015-06-21 09:30:40 to 09:31:40."""
    r = read_ais(data / "ais" / "pyais_nmea_data_sample.txt")
    assert r.records == 898
    assert any(w.startswith("100 AIS sentences have no content") for w in r.warnings)
    begin, end = 1434879005.0, 1434879115.0
    prompt = r.fixes.time_sd_s < 5
    assert np.all((r.fixes.time_s[prompt] > begin) & (r.fixes.time_s[prompt] < end))
    # A few ships tell a second that is far from everybody else's: their stamps are marked as uncertain.
    assert 0 < np.count_nonzero(~prompt) < 0.05 * len(prompt)
