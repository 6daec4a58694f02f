"""RTKLIB solutions, OpenSky state vectors and the Autoferry benchmark, against dates, PROJ and the truth in the files."""

from __future__ import annotations

import csv
import datetime
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Transformer

from boresight.errors import InputError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, rotate
from boresight.measure import position_from_height
from boresight.model import Flag
from boresight.reading.gpstime import LEAP_UTC_S, gps_from_week, utc_from_gps
from boresight.reading.reference import (
    AUTOFERRY_ORIGIN,
    AUTOFERRY_RADAR,
    looks_like_autoferry,
    looks_like_opensky,
    looks_like_rtklib,
    read_autoferry,
    read_opensky,
    read_rtklib,
)


def utc(*when: int) -> float:
    return datetime.datetime(*when, tzinfo=datetime.UTC).timestamp()


# ---------------------------------------------------------------------------------------------------------------- GPS time


def test_leap_seconds() -> None:
    # IERS Bulletin C: the first of these days began one second later than 86,400 s after the day before.
    days = [
        (1981, 7),
        (1982, 7),
        (1983, 7),
        (1985, 7),
        (1988, 1),
        (1990, 1),
        (1991, 1),
        (1992, 7),
        (1993, 7),
        (1994, 7),
        (1996, 1),
        (1997, 7),
        (1999, 1),
        (2006, 1),
        (2009, 1),
        (2012, 7),
        (2015, 7),
        (2017, 1),
    ]
    assert LEAP_UTC_S.tolist() == [utc(year, month, 1) for year, month in days]
    # ICD-GPS-200: week 0 begins on 1980-01-06, when GPS and UTC agreed; 18 s since 2017.
    assert utc_from_gps(gps_from_week(0, 0.0)) == utc(1980, 1, 6)
    assert utc_from_gps(gps_from_week(2137, 422922.0)) == utc(2020, 12, 24, 21, 28, 24)
    # Around a leap second: GPS runs on, UTC repeats a second.
    leap = utc(2017, 1, 1)
    np.testing.assert_array_equal(utc_from_gps(leap + np.array([16.0, 17.0, 18.0, 19.0])), leap + np.array([-1.0, 0.0, 0.0, 1.0]))


# ----------------------------------------------------------------------------------------------------------------- RTKLIB

LLH = "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"  # noqa: E501
ROW = "2020/12/24 21:28:42.500   40.097025378 -105.147247371  1578.8456   1  11   0.3   0.4   0.9 -0.4 0.9 -1.1 0.00 0.0\n"
TAIL = "1 11 0.3 0.4 0.9 0 0 0 0.0 0.0\n"


def solved(tmp_path: Path, text: str, **options: Any) -> Any:
    (tmp_path / "x.pos").write_text(text, newline="")
    return read_rtklib(tmp_path / "x.pos", **options)


def test_calendar_degrees_and_accuracy(tmp_path: Path) -> None:
    recording = solved(tmp_path, LLH + ROW)
    f = recording.fixes
    assert f.time_s[0] == utc(2020, 12, 24, 21, 28, 24) + 0.5
    np.testing.assert_allclose([np.degrees(f.latitude_rad[0]), np.degrees(f.longitude_rad[0])], [40.097025378, -105.147247371])
    assert f.height_m[0] == 1578.8456
    assert f.horizontal_sd_m[0] == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 2))
    assert f.vertical_sd_m[0] == 0.9
    assert any("1 fixed (Q 1)" in w for w in recording.warnings)


@pytest.mark.parametrize(("system", "seconds"), [("GPST", 18), ("UTC ", 0), ("JST ", 9 * 3600)])
def test_time_systems(tmp_path: Path, system: str, seconds: int) -> None:
    for stamp in ("2020/12/24 21:28:42.000", "2137 422922.000"):
        text = LLH.replace("GPST", system) + ROW.replace("2020/12/24 21:28:42.500", stamp)
        assert solved(tmp_path, text).fixes.time_s[0] == utc(2020, 12, 24, 21, 28, 42) - seconds


def test_degrees_minutes_seconds(tmp_path: Path) -> None:
    header = "%  GPST   latitude(d'\")   longitude(d'\")  height(m)   Q  ns  sdn(m)\n"
    f = solved(tmp_path, header + "2137 0.0   -0 30 36.0000  105 08 50.0905  10.0 " + TAIL).fixes
    np.testing.assert_allclose(np.degrees([f.latitude_rad[0], f.longitude_rad[0]]), [-0.51, 105 + 8 / 60 + 50.0905 / 3600])


def test_earth_centred_against_proj(tmp_path: Path) -> None:
    lat, lon, height = 63.4, 10.4, 45.0
    x, y, z = Transformer.from_crs(4979, 4978).transform(lat, lon, height)
    header = (
        "%  GPST   x-ecef(m)   y-ecef(m)   z-ecef(m)   Q  ns  sdx(m)   sdy(m)   sdz(m)  sdxy(m)  sdyz(m)  sdzx(m) age(s)  ratio\n"
    )
    # A covariance that is round in the local horizontal: 2 m east and north, 5 m up.
    axes = enu_from_ecef(np.radians(lat), np.radians(lon))
    c = axes.T @ np.diag([4.0, 4.0, 25.0]) @ axes
    root = [np.sqrt(c[k, k]) for k in range(3)] + [np.sign(c[i, j]) * np.sqrt(abs(c[i, j])) for i, j in ((0, 1), (1, 2), (2, 0))]
    row = f"2137 0.0 {x:.4f} {y:.4f} {z:.4f} 5 8 {' '.join(f'{v:.6f}' for v in root)} 0 0\n"
    f = solved(tmp_path, header + row).fixes
    np.testing.assert_allclose(np.degrees([f.latitude_rad[0], f.longitude_rad[0]]), [lat, lon], atol=2e-9)
    np.testing.assert_allclose([f.height_m[0], f.horizontal_sd_m[0], f.vertical_sd_m[0]], [height, 2.0, 5.0], atol=1e-4)


def test_baselines_with_and_without_their_reference(tmp_path: Path) -> None:
    header = "%  GPST   e-baseline(m) n-baseline(m) u-baseline(m)   Q  ns   sde(m)   sdn(m)   sdu(m)  sden(m)\n"
    reference = "% ref pos   : 40.129954154 -105.233055352  1669.9904\n"
    row = "2137 0.0 7312.4 -3650.1 -95.6 " + TAIL
    f = solved(tmp_path, reference + header + row).fixes
    x, y, z = Transformer.from_crs(4979, 4978).transform(np.degrees(f.latitude_rad), np.degrees(f.longitude_rad), f.height_m)
    base = np.radians([40.129954154, -105.233055352])
    enu = rotate(enu_from_ecef(*base), np.stack([x, y, z], axis=1) - ecef_from_geodetic(*base, 1669.9904))
    np.testing.assert_allclose(enu[0], [7312.4, -3650.1, -95.6], atol=1e-4)
    recording = solved(tmp_path, header + row)
    assert (recording.fixes.x_m[0], recording.fixes.y_m[0]) == (7312.4, -3650.1)
    assert np.isnan(recording.fixes.latitude_rad[0])
    assert any("reference" in w for w in recording.warnings)


def test_heights_above_the_geoid_are_no_ellipsoidal_heights(tmp_path: Path) -> None:
    text = "% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n" + LLH + ROW
    recording = solved(tmp_path, text)
    assert np.isnan(recording.fixes.height_m[0])
    assert any("geoid" in w for w in recording.warnings)
    assert solved(tmp_path, text, geoid_m=-17.0).fixes.height_m[0] == pytest.approx(1561.8456)
    tokyo = solved(tmp_path, "% (lat/lon/height=Tokyo/ellipsoidal,Q=1:fix)\n" + LLH + ROW)
    assert any("Tokyo" in w for w in tokyo.warnings)


def test_a_week_that_ran_over(tmp_path: Path) -> None:
    text = LLH + ROW.replace("2020/12/24 21:28:42.500", "89 422922.000")
    recording = solved(tmp_path, text)
    assert any("GPS week 89" in w and "1,024" in w for w in recording.warnings)
    recording = solved(tmp_path, text, date=datetime.date(2020, 12, 1))
    assert recording.fixes.time_s[0] == utc(2020, 12, 24, 21, 28, 24)
    assert any("put them right" in w for w in recording.warnings)


@pytest.mark.parametrize(
    "line",
    [
        "2020/13/24 21:28:42.5 40 -105 10 " + TAIL,
        "2020/02/30 21:28:42.5 40 -105 10 " + TAIL,
        "2020/12/24 25:28:42.5 40 -105 10 " + TAIL,
        "2137 604800.5 40 -105 10 " + TAIL,
        "2137 -1 40 -105 10 " + TAIL,
        "99999 5 40 -105 10 " + TAIL,
        "2137 5 91 -105 10 " + TAIL,
        "2137 5 40 -1O5 10 " + TAIL,
        "2137 5 40 -105 10 1 11 0.3",
        "2137 5 40 -105 10 0 11 0.3 0.4 0.9 0 0 0 0.0 0.0",
        "2137 5 40 -105 10 1 11 -0.3 0.4 0.9 0 0 0 0.0 0.0",
        "2137 5 nan -105 10 " + TAIL,
        "garbage",
        "\0\0\0\0",
    ],
)
def test_damaged_rows_are_counted_with_their_place(tmp_path: Path, line: str) -> None:
    recording = solved(tmp_path, LLH + ROW + line.strip("\n") + "\r\n" + ROW)
    assert len(recording.fixes) == 2
    assert [d.offset for d in recording.damaged] == [len(LLH + ROW)]
    assert recording.offset.tolist() == [len(LLH), len(LLH + ROW + line.strip("\n") + "\r\n")]


def test_without_a_header(tmp_path: Path) -> None:
    recording = solved(tmp_path, ROW)
    assert any("no header" in w for w in recording.warnings)
    assert np.degrees(recording.fixes.latitude_rad[0]) == pytest.approx(40.097025378)


@pytest.mark.parametrize("text", ["", "hello\n", LLH, "$POS,2137,1,2\n"])
def test_no_solution(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"x\.pos"):
        solved(tmp_path, text)


def test_mutated_solutions(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rows = [ROW.replace("21:28:42.500", f"21:{k // 60:02d}:{k % 60:02d}.000").encode() for k in range(3600)]
    rows = [r for r in rows[:3000]]
    hurt = rng.choice(len(rows), 1000, replace=False)
    for k in hurt.tolist():
        line = bytearray(rows[k])
        at = int(rng.integers(0, len(line) - 1))
        line[at : at + int(rng.integers(0, 4))] = rng.integers(0, 256, int(rng.integers(0, 6)), np.uint8).tobytes()
        rows[k] = bytes(line)
    (tmp_path / "x.pos").write_bytes(LLH.encode() + b"".join(rows))
    recording = read_rtklib(tmp_path / "x.pos")
    begins = len(LLH) + np.cumsum([0, *map(len, rows)])[:-1]
    sound = np.setdiff1d(np.arange(len(rows)), hurt)
    # What was deleted may be a line's end: then the next line is hurt with it.
    whole = [k for k in sound.tolist() if k == 0 or rows[k - 1].endswith(b"\n")]
    assert set(begins[whole].tolist()) <= set(recording.offset.tolist())
    assert np.all(np.abs(recording.fixes.latitude_rad) <= np.pi / 2)


@pytest.mark.real
def test_real_solutions(data: Path) -> None:
    long = read_rtklib(data / "rtk" / "demo5_b34f_f.pos")
    lines = [line.split() for line in (data / "rtk" / "demo5_b34f_f.pos").read_text().splitlines() if not line.startswith("%")]
    assert len(long.fixes) == len(lines) == 4521
    assert long.damaged == ()
    np.testing.assert_allclose(np.degrees(long.fixes.latitude_rad), [float(v[2]) for v in lines], atol=1e-12)
    np.testing.assert_array_equal(long.fixes.vertical_sd_m, [float(v[9]) for v in lines])
    short = read_rtklib(data / "rtk" / "rover.pos")
    # The same drive, once in calendar time and once in weeks: the same seconds, and the same place to the rover's own sd.
    both, i, j = np.intersect1d(long.fixes.time_s, short.fixes.time_s, return_indices=True)
    assert len(both) == 63
    away = 6.37e6 * np.hypot(
        long.fixes.latitude_rad[i] - short.fixes.latitude_rad[j],
        (long.fixes.longitude_rad[i] - short.fixes.longitude_rad[j]) * np.cos(long.fixes.latitude_rad[i]),
    )
    assert np.median(away / short.fixes.horizontal_sd_m[j]) < 3


# ---------------------------------------------------------------------------------------------------------------- OpenSky


@pytest.mark.real
def test_opensky(data: Path, tmp_path: Path) -> None:
    path = data / "opensky" / "OpenSky_Plane_States.csv"
    recording = read_opensky(path)
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6052
    unique = {(r["icao24"], r["lastposupdate"]) for r in rows}
    f = recording.fixes
    assert len(f) == len(unique)
    assert any(f"{6052 - len(unique):,} of 6,052" in w for w in recording.warnings)
    first = rows[0]
    assert f"{f.mode_s[0]:06x}" == first["icao24"]
    assert f.time_s[0] == float(first["lastposupdate"])
    assert np.degrees(f.latitude_rad[0]) == pytest.approx(float(first["lat"]), abs=1e-12)
    assert f.mode_3a[0] == 0o1174
    assert (f.pressure_altitude_m[0], f.height_m[0]) == (10668.0, 10843.26)
    assert not np.any(f.flags & int(Flag.GROUND))
    # x_speed and y_speed are the same velocity, east and north, as the file's author computed it.
    places = f.record
    np.testing.assert_allclose(f.velocity_east_mps, [float(rows[k]["x_speed"]) for k in places], atol=1e-6)
    np.testing.assert_allclose(f.velocity_north_mps, [float(rows[k]["y_speed"]) for k in places], atol=1e-6)
    # The same as Parquet.
    import duckdb

    duckdb.sql(f"COPY (SELECT * FROM read_csv('{path}')) TO '{tmp_path / 'x.parquet'}'")
    again = read_opensky(tmp_path / "x.parquet").fixes
    for (name, a), (_, b) in zip(f._flat(), again._flat(), strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_opensky_as_the_live_interface_names_it(tmp_path: Path) -> None:
    header = "icao24,callsign,origin_country,time_position,last_contact,longitude,latitude,baro_altitude,on_ground,velocity,true_track,vertical_rate,geo_altitude,squawk,spi\n"  # noqa: E501
    rows = "3c4591,DLH1,Germany,1626098400,1626098401,8.5,50.0,,true,5,180,0,,1000,false\n"
    rows += "abc123,,X,,1626098401,,,,false,,,,,,false\n"
    (tmp_path / "x.csv").write_text(header + rows + rows)
    recording = read_opensky(tmp_path / "x.csv")
    assert len(recording.fixes) == 1
    assert recording.fixes.flags[0] == int(Flag.GROUND)
    assert recording.fixes.velocity_north_mps[0] == pytest.approx(-5)


# -------------------------------------------------------------------------------------------------------------- Autoferry


def scene(tmp_path: Path, detections: Any) -> Path:
    path = tmp_path / "x_detections.json"
    path.write_text(detections if isinstance(detections, str) else json.dumps(detections))
    return path


def seen(measurement: Any, sensor: int = 2, time: float = 1.6e9) -> dict[str, Any]:
    return {"sensorID": sensor, "measurements": [], "ownshipPosition": [300.0, -500.0], "time": time, "measurement": measurement}


def test_detections_are_where_they_were_put(tmp_path: Path) -> None:
    recording = read_autoferry(
        scene(
            tmp_path,
            [seen([[100.0, -50.0, 7.0], [20.0, 80.0, -9.0]]), seen([30.0, 40.0], time=1.6e9 + 2), seen([]), seen(1.5, 3)],
        )
    )
    plots, own = recording.plots, recording.platform
    assert len(plots) == 4
    assert len(own) == 4
    np.testing.assert_allclose(plots.range_m, np.hypot([100, -50, 7, 30], [20, 80, -9, 40]), rtol=1e-5)
    # North of the own ship's own meridian is turned against the local frame's by the convergence of the meridians.
    turned = (own.longitude_rad[0] - AUTOFERRY_ORIGIN[1]) * np.sin(AUTOFERRY_ORIGIN[0])
    truth = np.arctan2([20, 80, -9, 40], [100, -50, 7, 30]) + turned
    np.testing.assert_allclose(np.angle(np.exp(1j * (plots.azimuth_rad - truth))), 0, atol=2e-6)
    # Back to the local frame through PROJ: own ship + measurement.
    at = ecef_from_geodetic(own.latitude_rad[0], own.longitude_rad[0], own.height_m[0])
    axes = enu_from_ecef(own.latitude_rad[0], own.longitude_rad[0])
    position = position_from_height(plots.range_m, plots.azimuth_rad, np.full(4, AUTOFERRY_ORIGIN[2]), at, axes)
    lat, lon, height = Transformer.from_crs(4978, 4979).transform(*position.T)
    lat0, lon0 = np.degrees(AUTOFERRY_ORIGIN[:2])
    local = Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={lon0} +lat_0={lat0} +h_0={AUTOFERRY_ORIGIN[2]}"
    )
    east, north, _ = local.transform(lon, lat, height)
    np.testing.assert_allclose(north, [400, 250, 307, 330], atol=1e-3)
    np.testing.assert_allclose(east, [-480, -420, -509, -460], atol=1e-3)


def test_damaged_elements_are_left_out(tmp_path: Path) -> None:
    good = [seen([[k, 2.0], [3.0, 4.0]], time=1.6e9 + k) for k in range(1, 6)]
    bad = [
        seen([[1.0, 2.0], [3.0]]),
        seen("x"),
        seen([1.0, 2.0, 3.0]),
        seen([None, 1.0]),
        {"sensorID": 2},
        seen([1.0, 2.0], time=-5),
    ]
    recording = read_autoferry(scene(tmp_path, [good[0], *bad, *good[1:]]))
    assert len(recording.plots) == 10
    assert len(recording.damaged) == len(bad)
    # A file that is cut, and one with rubbish in the middle: the rest is read.
    text = json.dumps(good)
    third = text.index('{"sensorID"', text.index('{"sensorID"', 2) + 1)
    assert len(read_autoferry(scene(tmp_path, text[:-30])).plots) == 8
    recording = read_autoferry(scene(tmp_path, text[: third + 40] + "\0\0}]{" + text[third + 45 :]))
    assert len(recording.plots) == 8
    assert [d.offset for d in recording.damaged] == [third]
    with pytest.raises(InputError, match="no detection"):
        read_autoferry(scene(tmp_path, '[{"sensorID": 2, "ownshipPosition": '))
    with pytest.raises(InputError, match="no file of"):
        read_autoferry(scene(tmp_path, '{"a": 1}'))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no"):
        read_autoferry(tmp_path / "empty")


@pytest.mark.real
@pytest.mark.parametrize("scenario", [2, 3, 5, 13, 16])
def test_the_radar_sees_the_boats_where_the_truth_says(data: Path, scenario: int) -> None:
    recording = read_autoferry(data / "autoferry" / f"scenario{scenario}")
    assert recording.damaged == ()
    plots, fixes, own = recording.plots, recording.fixes, recording.platform
    assert set(plots.sensor.tolist()) == {AUTOFERRY_RADAR}
    assert sorted(set(fixes.track.tolist())) == [1, 2]
    assert np.all(np.diff(plots.time_s) >= 0)
    assert np.all(np.diff(own.time_s) >= 0)
    raw = json.loads((data / "autoferry" / f"scenario{scenario}" / f"scenario{scenario}_detections.json").read_text())
    # Scale alone: the ranges are those of the file's vectors.
    ranges = sorted(
        float(r) for d in raw if d["sensorID"] == 2 for r in np.hypot(*np.array(d["measurement"], float).reshape(2, -1))
    )
    np.testing.assert_allclose(np.sort(plots.range_m), ranges, atol=2e-3)
    where = [np.interp(plots.time_s, *[np.unique(own.time_s), c[np.unique(own.time_s, return_index=True)[1]]])
             for c in (own.latitude_rad, own.longitude_rad)]  # fmt: skip
    height = np.full(len(plots), AUTOFERRY_ORIGIN[2])
    site, axes = ecef_from_geodetic(*where, height), enu_from_ecef(*where)

    def nearest(azimuth: Any) -> float:
        position = position_from_height(plots.range_m, azimuth, height, site, axes)
        best = []
        for boat in (1, 2):
            truth = fixes[fixes.track == boat]
            path = ecef_from_geodetic(truth.latitude_rad, truth.longitude_rad, truth.height_m)
            at = np.stack([np.interp(plots.time_s - 2.0, truth.time_s, path[:, k]) for k in range(3)], axis=1)
            away = np.linalg.norm(position - at, axis=1)
            # Other ships and the shore are seen too: of each scan, the plot nearest to the boat.
            best += [away[plots.time_s == t].min() for t in np.unique(plots.time_s)]
        return float(np.median(best))

    right = nearest(plots.azimuth_rad)
    assert right < 10
    for wrong in (np.pi / 2 - plots.azimuth_rad, plots.azimuth_rad + np.pi, -plots.azimuth_rad):
        assert nearest(wrong) > 2 * right


@pytest.mark.real
def test_content_is_recognised(data: Path) -> None:
    heads = {
        "rtk/rover.pos": "rtk",
        "rtk/demo5_b34f_f.pos": "rtk",
        "opensky/OpenSky_Plane_States.csv": "sky",
        "autoferry/scenario2/scenario2_detections.json": "ferry",
        "autoferry/scenario2/scenario2_groundTruth.json": "ferry",
        "ais/SolentAIS_20160112_130211.csv": "",
        "ais/pyais_nmea_data_sample.txt": "",
        "nmea/signalk_plaka.log": "",
        "croatia/cat048.raw": "",
        "croatia/asterix.pcap": "",
        "lebl-2016/mlat_cat010_160510-lebl-220001.ast": "",
        "README.md": "",
    }
    for name, kind in heads.items():
        head = (data / name).read_bytes()[:65536]
        found = (looks_like_rtklib(head), looks_like_opensky(head), looks_like_autoferry(head))
        assert found == (kind == "rtk", kind == "sky", kind == "ferry"), name
