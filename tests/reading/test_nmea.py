"""NMEA 0183: fields, times, headings, own ship, damage; judged by closed forms and by how the sentences were made."""

from __future__ import annotations

import datetime
import math
import random
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import InputError
from boresight.model import Flag, Recording
from boresight.reading.nmea import NmeaState, decode_nmea, looks_like_nmea, read_ais, read_nmea
from boresight.reading.sentences import numbers, scan

NOON = datetime.datetime(2021, 6, 1, 12, 0, 0, tzinfo=datetime.UTC).timestamp()


def sentence(body: str, start: str = "$") -> str:
    return f"{start}{body}*{reduce(lambda a, b: a ^ b, body.encode('latin-1'), 0):02X}"


def rmc(
    clock: str,
    date: str = "010621",
    lat: str = "6000.000,N",
    lon: str = "01030.000,E",
    rest: str = "10.0,90.0",
    tail: str = ",,A",
) -> str:
    return sentence(f"GPRMC,{clock},A,{lat},{lon},{rest},{date}{tail}")


def ttm(
    number: int,
    distance: str,
    bearing: str,
    side: str = "T",
    unit: str = "N",
    clock: str = "",
    status: str = "T",
    course: str = "20.0,T",
) -> str:
    return sentence(f"RATTM,{number:02d},{distance},{bearing},{side},7.0,{course},0.0,0.0,{unit},,{status},,{clock},A")


def read(tmp_path: Path, lines: list[str] | bytes, **how: object) -> Recording:
    path = tmp_path / "log.nmea"
    path.write_bytes(lines if isinstance(lines, bytes) else "".join(line + "\r\n" for line in lines).encode("latin-1"))
    return read_nmea(path, **how)


def test_real_target_sentence(tmp_path: Path) -> None:
    """The sentence that data/README.md gives: 11.4 NM, 13.6 degrees true, being acquired, 15:41:25.82."""
    text = "$RATTM,11,11.4,13.6,T,7.0,20.0,T,0.0,0.0,N,,Q,,154125.82,A,*17"
    r = read(tmp_path, [text], date=datetime.date(2021, 6, 1))
    assert len(r.plots) == 1
    assert not r.damaged
    p = r.plots
    assert p.range_m[0] == pytest.approx(11.4 * 1852, rel=1e-15)
    assert p.azimuth_rad[0] == pytest.approx(math.radians(13.6), rel=1e-15)
    assert p.speed_mps[0] == pytest.approx(7 * 1852 / 3600, rel=1e-15)
    assert p.heading_rad[0] == pytest.approx(math.radians(20), rel=1e-15)
    assert p.track[0] == 11
    assert p.sensor[0] == 65536
    assert p.flags[0] == Flag.ACQUIRING
    assert p.time_s[0] == datetime.datetime(2021, 6, 1, 15, 41, 25, 820000, datetime.UTC).timestamp()
    source = next(s for s in r.sources if s.plots)
    assert (source.edition, source.records, source.plots, source.targets) == ("NMEA RATTM", 1, 1, 1)


@pytest.mark.parametrize(("unit", "metres"), [("K", 1000.0), ("N", 1852.0), ("S", 1609.344)])
def test_units_of_distance_and_speed(tmp_path: Path, unit: str, metres: float) -> None:
    p = read(tmp_path, [rmc("120000"), ttm(1, "2.5", "10.0", unit=unit, clock="120000.00")]).plots
    assert p.range_m[0] == pytest.approx(2.5 * metres, rel=1e-15)
    assert p.speed_mps[0] == pytest.approx(7.0 * metres / 3600, rel=1e-15)


def test_status_letters(tmp_path: Path) -> None:
    lines = [rmc("120000"), *(ttm(n, "2.5", "10.0", status=s, clock="120000") for n, s in enumerate("TQL"))]
    assert read(tmp_path, lines).plots.flags.tolist() == [0, Flag.ACQUIRING, Flag.EXTRAPOLATED | Flag.TRACK_END]


def test_relative_bearings_turn_with_the_heading_across_north(tmp_path: Path) -> None:
    """Headings 358 and 2 degrees at whole seconds: a target at the half has 0, and 0.25 s after 12:00:00 it has 359."""
    lines = [rmc("120000"), sentence("HEHDT,358.0,T"), rmc("120001"), sentence("HEHDT,2.0,T"), rmc("120002")]
    # HDT has no time of its own: it lies half way between the fixes around it, at 0.5 and 1.5 s.
    lines += [
        ttm(1, "1.0", "90.0", "R", clock="120001.00", course="10.0,R"),
        ttm(2, "1.0", "90.0", "R", clock="120000.75"),
        rmc("120003"),
    ]
    r = read(tmp_path, lines)
    np.testing.assert_allclose(np.degrees(r.plots.azimuth_rad), [90.0, 89.0], atol=1e-9)
    assert np.degrees(r.plots.heading_rad[0]) == pytest.approx(10.0)
    assert r.plots.flags.tolist() == [Flag.FROM_BOW, Flag.FROM_BOW]


def test_magnetic_headings_become_true_by_their_variation(tmp_path: Path) -> None:
    """Deviation and variation: east is added, west is taken off."""
    lines = [rmc("120000"), sentence("HCHDG,100.0,2.0,E,5.0,W"), ttm(1, "1.0", "0.0", "R", clock="120000"), rmc("120001")]
    assert np.degrees(read(tmp_path, lines).plots.azimuth_rad[0]) == pytest.approx(97.0)
    # Without its own variation a heading takes that of RMC.
    lines = [rmc("120000", tail=",3.5,E,A"), sentence("HCHDM,100.0,M"), ttm(1, "1.0", "0.0", "R", clock="120000"), rmc("120001")]
    r = read(tmp_path, lines)
    assert np.degrees(r.plots.azimuth_rad[0]) == pytest.approx(103.5)
    assert r.plots.flags[0] == Flag.FROM_BOW
    # With none at all the azimuth is magnetic, and both the plot and a warning say so.
    lines = [rmc("120000"), sentence("HCHDM,100.0,M"), ttm(1, "1.0", "0.0", "R", clock="120000"), rmc("120001")]
    r = read(tmp_path, lines)
    assert np.degrees(r.plots.azimuth_rad[0]) == pytest.approx(100.0)
    assert r.plots.flags[0] == (Flag.MAGNETIC_NORTH | Flag.FROM_BOW)
    assert any("magnetic" in w for w in r.warnings)


def test_relative_bearing_without_a_heading_is_left_out_and_said(tmp_path: Path) -> None:
    r = read(tmp_path, [rmc("120000"), ttm(1, "1.0", "0.0", "R", clock="120000"), ttm(2, "1.0", "5.0", clock="120000")])
    assert r.plots.track.tolist() == [2]
    assert any("relative bearing" in w for w in r.warnings)


def test_own_ship_is_joined_by_time(tmp_path: Path) -> None:
    lines = []
    for k in range(10):
        lines.append(rmc(f"1200{k:02d}", lat=f"60{k:02d}.000,N"))
        lines.append(sentence(f"GPGGA,1200{k:02d},60{k:02d}.000,N,01030.000,E,4,10,0.8,{20 + k}.0,M,40.0,M,,"))
        lines.append(sentence(f"HEHDT,{10 + k}.0,T"))
    lines.append(ttm(1, "1.0", "0.0", clock="120003"))
    p = read(tmp_path, lines).platform
    whole = np.isin(p.time_s, NOON + np.arange(1, 9))
    np.testing.assert_allclose(np.degrees(p.latitude_rad[whole]), 60 + np.arange(1, 9) / 60, atol=1e-12)
    np.testing.assert_allclose(p.height_m[whole], 60.0 + np.arange(1, 9), atol=1e-9)
    np.testing.assert_allclose(p.speed_mps[whole], 10 * 1852 / 3600, atol=1e-9)
    np.testing.assert_allclose(np.degrees(p.course_rad[whole]), 90.0, atol=1e-9)
    assert np.isfinite(p.heading_rad).all()
    # Between two fixes the heading's own rows have the position half way.
    between = (p.time_s > NOON + 3) & (p.time_s < NOON + 4)
    assert between.sum() == 1
    share = p.time_s[between] - NOON
    np.testing.assert_allclose(np.degrees(p.latitude_rad[between]), 60 + share / 60, atol=1e-9)
    assert set(p.sensor.tolist()) == {65536}


def test_roll_and_pitch_come_from_transducers_and_from_inertial_systems(tmp_path: Path) -> None:
    """XDR has the time of what is around it, PASHR its own; between reports nothing is made up."""
    lines = []
    for k in range(6):
        lines += [
            rmc(f"12000{k}"),
            sentence(f"YXXDR,C,19.5,C,AIR,A,{-2.5 + k},D,ROLL,A,{0.5 * k},D,Ptch,P,1.01,B,BARO"),
            rmc(f"12000{k}"),
        ]
    p = read(tmp_path, lines).platform
    np.testing.assert_allclose(p.time_s, NOON + np.arange(6))
    np.testing.assert_allclose(np.degrees(p.roll_rad), -2.5 + np.arange(6.0), atol=1e-12)
    np.testing.assert_allclose(np.degrees(p.pitch_rad), 0.5 * np.arange(6.0), atol=1e-12)
    lines += [
        sentence(f"PASHR,12000{k}.500,{100 + k}.25,T,{1.25 + k:+.2f},{-0.75:+.2f},+0.10,0.02,0.02,0.05,2,1") for k in range(6)
    ]
    p = read(tmp_path, lines).platform
    own = np.isclose(p.time_s % 1.0, 0.5)
    assert own.sum() == 6
    np.testing.assert_allclose(np.degrees(p.roll_rad[own]), 1.25 + np.arange(6.0), atol=1e-12)
    np.testing.assert_allclose(np.degrees(p.pitch_rad[own]), -0.75, atol=1e-12)
    np.testing.assert_allclose(np.degrees(p.heading_rad[own]), 100.25 + np.arange(6.0), atol=1e-9)
    # The inertial system is the better source: where it speaks, the transducers are not asked.
    assert np.isnan(p.roll_rad[~own]).all()


def test_what_else_is_called_xdr_or_pashr_is_passed_over(tmp_path: Path) -> None:
    lines = [
        rmc("120000"),
        sentence("YXXDR,A,12.5,D,RUDDER,A,3.0,P,ROLL,A,,D,PTCH"),
        sentence("PASHR,POS,0,08,120000.00,6000.0,N,01030.0,E,10.0,,5.0,1.0,0.5,1,1,1,1,AB00"),
        rmc("120001"),
    ]
    r = read(tmp_path, lines)
    assert not r.damaged
    assert np.isnan(r.platform.roll_rad).all()
    assert np.isnan(r.platform.pitch_rad).all()


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        (sentence("YXXDR,A,95.0,D,ROLL"), "roll"),
        (sentence("YXXDR,A,1.0,D,ROLL,A,x,D,PTCH"), "pitch"),
        (sentence("PASHR,120001.0,361.0,T,1.0,1.0,0.0,0.1,0.1,0.1,1,1"), "heading"),
        (sentence("PASHR,126001.0,100.0,T,1.0,1.0,0.0,0.1,0.1,0.1,1,1"), "time"),
        (sentence("PASHR,120001.0,100.0,T,1.0,-91.0,0.0,0.1,0.1,0.1,1,1"), "pitch"),
        (sentence("YXXDR,A,1.0,D,ROLL")[:-1] + "?", "hexadecimal"),
        ("$YXXDR,A,1.0,D,RO", "no checksum"),
    ],
)
def test_damaged_attitudes_cost_themselves_only(tmp_path: Path, broken: str, why: str) -> None:
    lines = [rmc("120000"), sentence("IIXDR,A,2.0,D,ROLL"), rmc("120000"), broken, rmc("120002")]
    lines += [sentence("IIXDR,A,4.0,D,ROLL"), rmc("120002")]
    r = read(tmp_path, lines)
    assert len(r.damaged) == 1
    assert why in r.damaged[0].why
    roll = np.degrees(r.platform.roll_rad)
    np.testing.assert_allclose(roll[np.isfinite(roll)], [2.0, 4.0], atol=1e-12)


def test_a_log_without_a_radar_gives_own_ship_as_a_target(tmp_path: Path) -> None:
    lines = [sentence(f"GPGGA,12000{k},3320.500,S,07030.250,W,{q},10,2.0,5.0,M,30.0,M,,") for k, q in enumerate((1, 2, 4, 0, 8))]
    r = read(tmp_path, [*lines, sentence("GPZDA,120005,01,06,2021,00,00")])
    assert r.fixes.track.tolist() == [0, 0, 0]
    np.testing.assert_allclose(np.degrees(r.fixes.latitude_rad), -(33 + 20.5 / 60), atol=1e-12)
    np.testing.assert_allclose(np.degrees(r.fixes.longitude_rad), -(70 + 30.25 / 60), atol=1e-12)
    np.testing.assert_allclose(r.fixes.height_m, 35.0)
    np.testing.assert_allclose(r.fixes.horizontal_sd_m, [6.0, 2.0, 0.05])
    np.testing.assert_allclose(r.fixes.time_s, NOON + np.arange(3))
    assert any("simulated" in w for w in r.warnings)
    assert any("no fix" in w for w in r.warnings)


def test_latitudes_of_the_southern_and_western_half_in_tll(tmp_path: Path) -> None:
    r = read(tmp_path, [rmc("120000"), sentence("RATLL,07,3320.500,S,07030.250,W,buoy,120000.50,T,")])
    assert np.degrees(r.tracks.latitude_rad[0]) == pytest.approx(-(33 + 20.5 / 60))
    assert np.degrees(r.tracks.longitude_rad[0]) == pytest.approx(-(70 + 30.25 / 60))
    assert (r.tracks.track[0], r.tracks.source[0], r.tracks.time_s[0]) == (7, 65536, NOON + 0.5)


def test_osd_and_rsd(tmp_path: Path) -> None:
    lines = [
        rmc("120000"),
        sentence("RAOSD,35.1,A,36.0,P,10.2,P,15.3,0.1,N"),
        sentence("RARSD,,,,,,,,,0.8,38.1,6.0,N,N"),
        rmc("120002"),
    ]
    lines.insert(2, ttm(1, "1.0", "0.0", "R", clock="120001"))
    r = read(tmp_path, lines)
    assert np.degrees(r.plots.azimuth_rad[0]) == pytest.approx(35.1)
    assert any("11,112 m" in w for w in r.warnings)
    # A heading that is marked invalid is none.
    lines[1] = sentence("RAOSD,35.1,V,36.0,P,10.2,P,15.3,0.1,N")
    assert len(read(tmp_path, lines).plots) == 0


# ---------------------------------------------------------------------------------------------------------------------- time


def test_midnight(tmp_path: Path) -> None:
    """RMC's date turns a sentence after the first TTM of the new day; sentences jitter about midnight."""
    lines = [rmc("235958", "311221"), ttm(1, "1.0", "0.0", clock="235959.50"), ttm(1, "1.0", "0.0", clock="000000.20")]
    lines += [
        rmc("235959.90", "311221"),
        ttm(1, "1.0", "0.0", clock="235959.95"),
        rmc("000001", "010122"),
        ttm(1, "1.0", "0.0", clock="000002"),
    ]
    new_year = datetime.datetime(2022, 1, 1, tzinfo=datetime.UTC).timestamp()
    np.testing.assert_allclose(read(tmp_path, lines).plots.time_s - new_year, [-0.5, 0.2, -0.05, 2.0], atol=1e-6)


def test_date_is_given_or_day_zero(tmp_path: Path) -> None:
    lines = [ttm(1, "1.0", "0.0", clock="235959"), ttm(1, "1.0", "0.0", clock="000001")]
    r = read(tmp_path, lines)
    assert r.plots.time_s.tolist() == [86399.0, 86401.0]
    assert any("day 0" in w and "--date" in w for w in r.warnings)
    r = read(tmp_path, lines, date=datetime.date(1970, 1, 3))
    assert r.plots.time_s.tolist() == [2 * 86400 + 86399.0, 3 * 86400 + 1.0]
    assert not r.warnings


def test_week_rollover_of_a_receiver_is_put_right(tmp_path: Path) -> None:
    """1,024 weeks before 2021-06-01 is 2001-10-16."""
    lines = [rmc(f"12000{k}", "161001") for k in range(5)]
    r = read(tmp_path, lines, date=datetime.date(2021, 6, 1))
    np.testing.assert_allclose(r.fixes.time_s, NOON + np.arange(5))
    assert any("1,024 weeks" in w or "1024 weeks" in w for w in r.warnings)


@pytest.mark.parametrize(
    "prefix",
    [
        "1622548800500;I;",
        "1622548800.500 ",
        "2021-06-01T12:00:00.500Z ",
        "2021-06-01 14:00:00.500+02:00;x;",
        "[2021-06-01T12:00:00.500Z] ",
        "\\s:radar1,c:1622548800500*{}\\",
    ],
)
def test_stamps_before_a_sentence(tmp_path: Path, prefix: str) -> None:
    if "{}" in prefix:
        inside = prefix[1 : prefix.index("*")]
        prefix = prefix.format(f"{reduce(lambda a, b: a ^ b, inside.encode(), 0):02X}")
    r = read(tmp_path, [prefix + ttm(1, "1.0", "0.0")])
    assert r.plots.time_s[0] == NOON + 0.5
    assert not r.damaged


def test_stamp_behind_a_sentence(tmp_path: Path) -> None:
    assert read(tmp_path, [ttm(1, "1.0", "0.0") + ",r003669970,1622548800"]).plots.time_s[0] == NOON


def test_damaged_tag_block_gives_no_time(tmp_path: Path) -> None:
    r = read(tmp_path, ["\\c:1622548800*00\\" + ttm(1, "1.0", "0.0")])
    assert len(r.plots) == 1
    assert np.isnan(r.plots.time_s[0])
    assert "tag block" in r.damaged[0].why


def test_wrong_clock_of_the_logger_is_taken_off(tmp_path: Path) -> None:
    """Stamps 30 s fast, beside receivers' own UTC: a target without time gets the receivers' clock."""
    lines = [f"{int((NOON + 30 + k) * 1000)};" + rmc(f"12000{k}") for k in range(6)]
    lines.insert(3, f"{int((NOON + 30 + 2.5) * 1000)};" + ttm(1, "1.0", "0.0"))
    r = read(tmp_path, lines)
    assert r.plots.time_s[0] == pytest.approx(NOON + 2.5, abs=1e-6)
    assert any("+30.00 s" in w for w in r.warnings)


def test_time_of_the_surroundings(tmp_path: Path) -> None:
    r = read(tmp_path, [rmc("120000"), ttm(1, "1.0", "0.0"), ttm(2, "1.0", "0.0"), ttm(3, "1.0", "0.0"), rmc("120002")])
    np.testing.assert_allclose(r.plots.time_s - NOON, [0.5, 1.0, 1.5])
    assert any("around them" in w for w in r.warnings)


# -------------------------------------------------------------------------------------------------------------------- damage


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "\n\r", "\r\r\n", "\n\n"])
def test_line_ends(tmp_path: Path, end: str) -> None:
    lines = [rmc(f"12000{k}") for k in range(5)]
    r = read(tmp_path, end.join(lines).encode())
    assert r.records == 5
    assert not r.damaged


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        ("$GPRMC,120001,A,6000.000,N,01030.000,E,10.0,90.0,010621,,,A*00", "checksum"),
        ("$GPRMC,120001,A,6000.000,N,01030", "cut"),
        ("$GPRMC,120001,A,6000.000,N,01030.000,E*G7", "hexadecimal"),
        (rmc("120001", lat="9100.000,N"), "latitude"),
        (rmc("120001", lat="6060.000,N"), "latitude"),
        (rmc("120001", lon="18100.000,E"), "longitude"),
        (rmc("250001"), "time"),
        (rmc("120001", date="320621"), "date"),
        (rmc("120001", date="300221"), "date"),
        (rmc("120001", rest="1x.0,90.0"), "speed"),
        (rmc("120001", rest="10.0,361.0"), "course"),
        (ttm(1, "1.0", "0.0", unit="Q"), "unit"),
        (ttm(1, "900.0", "0.0"), "distance"),
        (ttm(1, "-1.0", "0.0"), "distance"),
        (ttm(1, "1.0", "400.0"), "bearing"),
        (ttm(1, "1.0", "0.0", side="X"), "reference"),
        (ttm(1, "1.0", "0.0", status="Z"), "status"),
        ("\x00\x01\x02\xff\xfe", "bytes"),
        ("hello world", "text"),
        ("$" + "A" * 5000, "cut|runs on"),
    ],
)
def test_what_is_damaged_is_said_where_it_lies_and_costs_itself_only(tmp_path: Path, broken: str, why: str) -> None:
    good = [rmc("120000"), rmc("120002")]
    r = read(tmp_path, [good[0], broken, good[1]])
    assert len(r.damaged) == 1
    assert r.damaged[0].offset == len(good[0]) + 2
    assert any(word in r.damaged[0].why for word in why.split("|"))
    np.testing.assert_allclose(r.platform.time_s, [NOON, NOON + 2])
    assert len(r.plots) == 0


def test_sentences_that_run_into_each_other(tmp_path: Path) -> None:
    """A line that lost its end, and one that was cut in the middle, leave the next sentence whole."""
    whole = [rmc(f"12000{k}") for k in range(4)]
    r = read(tmp_path, [whole[0] + whole[1], whole[2][:30] + whole[3]])
    assert r.offset.tolist() == [0, len(whole[0]), len(whole[0] + whole[1]) + 2 + 30]
    assert [d.offset for d in r.damaged] == [len(whole[0] + whole[1]) + 2]


def test_binary_before_a_sentence_on_its_line(tmp_path: Path) -> None:
    r = read(tmp_path, b"\x00\xff\x80\x01" + rmc("120000").encode() + b"\r\n")
    assert r.records == 1
    assert "no NMEA" in r.damaged[0].why


def test_names_that_are_not_ascii_and_comments(tmp_path: Path) -> None:
    body = "RATTM,01,1.0,0.0,T,7.0,20.0,T,0.0,0.0,N,Øresund,T,,120000,A"
    r = read(tmp_path, ["# a comment", rmc("120000"), sentence(body)])
    assert len(r.plots) == 1
    assert not r.damaged


def test_no_checksums_at_all_are_accepted_and_said(tmp_path: Path) -> None:
    lines = [line[: line.index("*")] for line in (rmc("120000"), ttm(1, "1.0", "30.0", clock="120000"))]
    r = read(tmp_path, lines)
    assert len(r.plots) == 1
    assert "checksum" in r.warnings[0]
    # In a file that has checksums a sentence without one is damage.
    r = read(tmp_path, [*lines, rmc("120001")])
    assert len(r.plots) == 0
    assert len(r.damaged) == 2


@pytest.mark.parametrize("content", [b"", b"\r\n\r\n", b"\0" * 1000, b"time,range\n1,2\n", bytes(range(256)) * 20])
def test_nothing_to_read_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError, match=r"log\.nmea"):
        read(tmp_path, content)
    assert not looks_like_nmea(content)


def test_missing_file_and_log_without_ais(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_nmea(tmp_path / "absent.nmea")
    (tmp_path / "own.nmea").write_text(rmc("120000") + "\n")
    with pytest.raises(InputError, match="no AIS message"):
        read_ais(tmp_path / "own.nmea")


def test_two_radars_are_two_sensors(tmp_path: Path) -> None:
    other = sentence("R2TTM,05,2.0,10.0,T,7.0,20.0,T,0.0,0.0,N,,T,,120001,A")
    r = read(tmp_path, [rmc("120000"), ttm(1, "1.0", "0.0", clock="120000"), other, rmc("120001")], sensor=70000)
    assert r.plots.sensor.tolist() == [70000, 70001]
    assert set(r.platform.sensor.tolist()) == {70000, 70001}
    assert any("70001" in w for w in r.warnings)


def test_two_receivers_do_not_mix(tmp_path: Path) -> None:
    """Positions of the receiver with more of them; the other one fills in only where the first is silent."""
    lines = []
    for k in range(40):
        if not 10 <= k < 26:
            lines += [sentence(f"GPGGA,1200{k:02d},6000.000,N,01000.000,E,1,8,1.0,,M,,M,,")]
        if k % 2:
            lines += [sentence(f"GNGGA,1200{k:02d},6000.010,N,01000.000,E,1,8,1.0,,M,,M,,")]
    r = read(tmp_path, lines, date=datetime.date(2021, 6, 1))
    second = np.round((np.degrees(r.fixes.latitude_rad) - 60) * 60000) == 10
    assert set((r.fixes.time_s[second] - NOON).astype(int)) == {15, 17, 19}
    assert any("several receivers" in w for w in r.warnings)


# -------------------------------------------------------------------------------------------------------------------- stream


@given(st.lists(st.integers(1, 400), max_size=12), st.randoms(use_true_random=False))
def test_any_cut_of_a_stream_gives_the_same_plots(cuts: list[int], rng: random.Random) -> None:
    lines = [rmc("115959")]
    for k in range(30):
        lines.append(ttm(k, f"{rng.uniform(0.1, 20):.2f}", f"{rng.uniform(0, 359):.1f}", clock=f"1200{k:02d}.00"))
    data = b"\x00\xffrubbish\n" + "\r\n".join(lines).encode() + b"\r\n$RATTM,1,2"
    whole, _, consumed = decode_nmea(data)
    assert consumed == data.rindex(b"\n") + 1
    state, rest, at, plots, offsets = NmeaState(), b"", 0, [], []
    for size in [*cuts, len(data)]:
        rest += data[at : at + size]
        at += size
        part, state, used = decode_nmea(rest, state)
        rest = rest[used:]
        plots.append(part.plots)
        offsets.append(part.offset)
    joined = type(whole.plots).concat(plots)
    for name in ("time_s", "range_m", "azimuth_rad", "track", "record", "sensor"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole.plots, name))
    np.testing.assert_array_equal(np.concatenate(offsets), whole.offset)
    assert rest == b"$RATTM,1,2"


def test_stream_carries_heading_variation_and_date() -> None:
    state = NmeaState()
    lines = [rmc("120000", tail=",3.5,E,A"), sentence("HCHDM,100.0,M"), ttm(1, "1.0", "0.0", "R", clock="120001")]
    for line in lines:
        records, state, _ = decode_nmea((line + "\r\n").encode(), state)
    assert np.degrees(records.plots.azimuth_rad[0]) == pytest.approx(103.5)
    assert records.plots.time_s[0] == NOON + 1


def test_stream_takes_the_time_of_reception_where_nothing_else_tells() -> None:
    records, _, _ = decode_nmea((ttm(1, "1.0", "0.0") + "\n").encode(), None, NOON)
    assert records.plots.time_s.tolist() == [NOON]
    records, _, _ = decode_nmea((ttm(1, "1.0", "0.0", clock="115959.50") + "\n").encode(), None, NOON)
    assert records.plots.time_s.tolist() == [NOON - 0.5]


@given(st.binary(max_size=400))
def test_any_bytes_are_survived(data: bytes) -> None:
    s = scan(data)
    assert len(s.start) == len(s.star)
    decode_nmea(data)
    looks_like_nmea(data)


@given(
    st.one_of(
        st.floats(-1e6, 1e6).map(lambda v: f"{v:.4f}"),
        st.integers(-(10**9), 10**9).map(str),
        st.text("0123456789.-+ eExX", max_size=12),
    )
)
def test_numbers_are_those_of_python(text: str) -> None:
    """A field is a number exactly where Python's float agrees, without its exponents and underscores."""
    s = scan(sentence(f"GPXXX,{text}").encode())
    got = numbers(s, np.zeros(1, np.int64), 1)
    stripped = text.strip(" ")
    try:
        want = float(stripped) if not set(stripped) & set("eExX") and stripped else math.nan
    except ValueError:
        want = math.nan
    assert bool(got.empty[0]) == (not stripped)
    np.testing.assert_array_equal(got.value[0], want)
    assert bool(got.bad[0]) == (math.isnan(want) and bool(stripped))


# ------------------------------------------------------------------------------------------------------------------ mutations


def log_of(rng: random.Random, lines: int) -> list[bytes]:
    """A log of own ship, a radar and AIS."""
    out = []
    for k in range(lines):
        t = f"{k // 3600 % 24:02d}{k // 60 % 60:02d}{k % 60:02d}.00"
        out.append(
            rng.choice(
                [
                    rmc(t, lat=f"60{rng.uniform(0, 59):06.3f},N"),
                    sentence(f"GPGGA,{t},60{rng.uniform(0, 59):06.3f},N,01030.000,E,1,10,0.8,20.0,M,40.0,M,,"),
                    sentence(f"HEHDT,{rng.uniform(0, 359):.1f},T"),
                    sentence(f"IIXDR,A,{rng.uniform(-9, 9):.2f},D,ROLL,A,{rng.uniform(-9, 9):.2f},D,PTCH"),
                    sentence(f"PASHR,{t},{rng.uniform(0, 359):.2f},T,{rng.uniform(-9, 9):+.2f},1.00,0.10,0.1,0.1,0.2,2,1"),
                    ttm(k % 100, f"{rng.uniform(0.1, 20):.2f}", f"{rng.uniform(0, 359):.1f}", rng.choice("RT"), clock=t),
                    sentence("AIVDM,1,1,,A,15MgK45P3@G?fl0E`JbR0OwT0@MS,0", "!"),
                    sentence("AIVDM,2,1,1,A,55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0", "!"),
                    sentence("AIVDM,2,2,1,A,88888888880,2", "!"),
                ]
            ).encode()
        )
    return out


def mutate(line: bytes, rng: random.Random) -> bytes:
    """One of the things that happen to a line, its end included."""
    b = bytearray(line + b"\r\n")
    at = rng.randrange(len(b))
    what = rng.randrange(11)
    if what == 0:
        b[at] ^= 1 << rng.randrange(8)
    elif what == 1:
        b[at] = rng.randrange(256)
    elif what == 2:
        del b[at]
    elif what == 3:
        b.insert(at, rng.randrange(256))
    elif what == 4:
        del b[at:]
    elif what == 5:
        del b[:at]
    elif what == 6:
        b[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(200)))
    elif what == 7:
        b[at : at + 10] = b"\0" * len(b[at : at + 10])
    elif what == 8:
        b[at:at] = rng.choice([b"$", b"!", b"*", b"*00", b"\r", b"\n", b"\\", b"," * 50, b"9" * 300])
    elif what == 9:
        b = bytearray(b.replace(b"\r\n", b""))
    else:
        comma = [k for k, c in enumerate(b) if c == 44]
        if len(comma) > 1:
            k = rng.randrange(len(comma) - 1)
            body = (
                b[1 : comma[k] + 1]
                + rng.choice([b"", b"-1", b"1e9", b"99999999", b"x", b"\xff", b"nan"])
                + b[comma[k + 1] : b.rfind(b"*")]
            )
            b = bytearray(sentence(body.decode("latin-1"), chr(b[0])).encode("latin-1") + b"\r\n")
    return bytes(b)


def check_mutated(lines: int, seed: int, path: Path) -> tuple[int, int, int]:
    """Mutate half of the lines of a log and read it: the numbers of lines that were left alone, of damage, of plots and fixes."""
    rng = random.Random(seed)
    data, sound = bytearray(), []
    for line in log_of(rng, lines):
        if rng.random() < 0.5:
            data += mutate(line, rng)
        else:
            sound.append(len(data))
            data += line + b"\r\n"
    path.write_bytes(bytes(data))
    r = read_nmea(path, date=datetime.date(2021, 6, 1))
    missing = sorted(set(sound) - set(r.offset.tolist()))
    assert not missing, f"line at byte {missing[0]} was lost: {bytes(data[missing[0] - 80 : missing[0] + 80])!r}"
    for table in (r.fixes, r.tracks, r.platform):
        assert not np.any(np.abs(table.latitude_rad) > np.pi / 2)
        assert not np.any(np.abs(table.longitude_rad) > np.pi)
    p = r.plots
    assert np.all((p.range_m >= 0) & (p.range_m <= 500e3))
    assert np.all((p.azimuth_rad >= 0) & (p.azimuth_rad < 2 * np.pi))
    assert not np.any((p.speed_mps < 0) | (p.speed_mps > 3000))
    assert np.all(np.isfinite(p.time_s))
    assert r.damaged
    assert all(0 <= d.offset < len(data) and d.why for d in r.damaged)
    return len(sound), len(r.damaged), len(p) + len(r.fixes)


@pytest.mark.parametrize("seed", range(4))
def test_mutated_lines(tmp_path: Path, seed: int) -> None:
    sound, damaged, rows = check_mutated(4000, seed, tmp_path / "mutated.nmea")
    # About a third of the mutations leave no trace that a checksum shows (line ends, empty fields): the rest must be counted.
    assert sound > 1800
    assert damaged > 1000
    assert rows > 400


# ------------------------------------------------------------------------------------------------------------ real recordings


@pytest.mark.real
def test_logs_tell_what_they_are(data: Path) -> None:
    """Counts by grep over the files themselves, and what data/README.md says: no radar targets in them."""
    for name in ("opencpn_Go_to_Guernesey.txt", "signalk_gofree-merrimac.log", "signalk_plaka.log"):
        path = data / "nmea" / name
        raw = path.read_bytes()
        assert looks_like_nmea(raw[:4096])
        r = read_nmea(path, date=datetime.date(2014, 4, 16) if "plaka" in name else None)
        assert len(r.plots) == 0
        counts = {s.edition[5:]: s.records for s in r.sources if s.edition.startswith("NMEA ")}
        assert sum(counts.values()) == r.records
        lines = [line.strip() for line in raw.replace(b"\r", b"\n").split(b"\n") if line.strip()]
        for address, n in counts.items():
            assert n <= sum(line[1:6] == address.encode() for line in lines)
        assert r.records + len(r.damaged) >= len(lines)
        assert np.all(np.isfinite(r.fixes.time_s))


@pytest.mark.real
@pytest.mark.parametrize("name", ["nmea/signalk_gofree-merrimac.log", "ais/pyais_nmea_data_sample.txt"])
def test_undamaged_logs_have_no_bad_line(data: Path, name: str) -> None:
    r = read_nmea(data / name)
    assert not [d for d in r.damaged if "checksum" in d.why or "cut" in d.why or "makes no sense" in d.why]
