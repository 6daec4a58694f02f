"""GeoJSON, KML and NMEA: valid by the standard library's readers, right by PROJ; `write_any` loses nothing in silence."""

from __future__ import annotations

import datetime
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import Geod

from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.model import Fixes, Flag, Platform, Plots, Recording, Sensor, Sensors, Tracks, pack_callsigns
from boresight.reading.nmea import read_nmea
from boresight.reading.tables import read_table
from boresight.writing.anyfile import ENDINGS, write_any
from boresight.writing.features import iso
from boresight.writing.geojson import write_geojson
from boresight.writing.kml import write_kml
from boresight.writing.nmea import checksum, write_nmea

T0 = 1_772_323_200.0  # 2026-03-01
SITE = Sensor(name="R", sac=1, sic=2, lat_deg=50.0, lon_deg=1.0, height_m=100.0, ground_height_m=100.0, kind="marine")
SENSORS = Sensors(sensor=(SITE,))
KML = "{http://www.opengis.net/kml/2.2}"


def plots(n: int = 50) -> Plots:
    rng = np.random.default_rng(1)
    return Plots(
        time_s=T0 + 86_390 + np.arange(n) * 0.7,
        sensor=np.full(n, 0x102),
        channel=np.ones(n),
        range_m=rng.uniform(100, 20_000, n),
        azimuth_rad=rng.uniform(0, 2 * np.pi, n),
        mode_s=np.where(np.arange(n) % 3 == 0, 0xABC123, -1),
        track=np.arange(n) % 4,
        speed_mps=rng.uniform(0, 20, n),
        heading_rad=rng.uniform(0, 2 * np.pi, n),
        flags=np.where(np.arange(n) == 7, int(Flag.TRACK_END), 0),
        record=np.arange(n),
    )


def fixes() -> Fixes:
    return Fixes(
        time_s=[T0 + 0.25, T0 + 1, T0 + 2, np.nan],
        latitude_rad=np.radians([50.123456789, -0.5, 51.0, np.nan]),
        longitude_rad=np.radians([1.0, 179.9, -179.9, 3.0]),
        height_m=[12.34567, np.nan, 100.0, 1.0],
        callsign=pack_callsigns(["A<&>B", "X", "X", ""]),
        mode_s=[0x00ABCD, -1, -1, -1],
        mode_3a=[0o0123, -1, -1, -1],
        record=np.arange(4),
    )


def recording(**tables: Any) -> Recording:
    given = {"plots": Plots(), "fixes": Fixes()} | tables
    return Recording(path="x", sources=(), damaged=(), warnings=(), by_category={}, offset=np.arange(60), **given)


def features(path: Path) -> list[Any]:
    document = json.loads(path.read_text(encoding="utf-8"))
    assert document["type"] == "FeatureCollection"
    return list(document["features"])


# ---------------------------------------------------------------------------------------------------------------- GeoJSON


def test_plots_lie_where_the_radar_saw_them(tmp_path: Path) -> None:
    table = plots()
    assert write_geojson(tmp_path / "x.geojson", table, sensors=SENSORS) == {"plots": 50}
    points = features(tmp_path / "x.geojson")
    lon, lat = np.array([f["geometry"]["coordinates"][:2] for f in points]).T
    azimuth, _, distance = Geod(ellps="WGS84").inv(np.full(50, 1.0), np.full(50, 50.0), lon, lat)
    # On the ground at the antenna's height: the chord over the ellipsoid, 100 m up.
    np.testing.assert_allclose(distance * (1 + 100 / 6.37e6), table.range_m, atol=0.02)
    np.testing.assert_allclose(np.angle(np.exp(1j * (np.radians(azimuth) - table.azimuth_rad))), 0, atol=2e-5)
    first = points[0]["properties"]
    assert first["kind"] == "plots"
    assert first["time"] == "2026-03-01T23:59:50Z"
    assert first["mode_s"] == "ABC123"
    assert first["azimuth_deg"] == pytest.approx(np.degrees(table.azimuth_rad[0]), abs=1e-7)
    assert "mode_s" not in points[1]["properties"]
    assert "elevation_deg" not in first


def test_fixes_in_order_and_digits(tmp_path: Path) -> None:
    counts = write_geojson(tmp_path / "x.geojson", fixes())
    assert counts == {"fixes": 3, "without position": 1}
    points = features(tmp_path / "x.geojson")
    assert points[0]["geometry"] == {"type": "Point", "coordinates": [1.0, 50.1234568, 12.346]}
    assert points[1]["geometry"]["coordinates"] == [179.9, -0.5]
    assert points[0]["properties"]["mode_s"] == "00ABCD"
    assert points[0]["properties"]["mode_3a"] == "0123"
    assert points[0]["properties"]["time"] == "2026-03-01T00:00:00.25Z"
    assert max(len(d) for d in re.findall(r"\d\.(\d+)", (tmp_path / "x.geojson").read_text())) <= 7
    assert not re.search(r"nan|inf", (tmp_path / "x.geojson").read_text(), re.I)


def test_lines_by_target_are_cut_at_the_antimeridian_and_broken_over_gaps(tmp_path: Path) -> None:
    write_geojson(tmp_path / "x.geojson", fixes(), points=False, lines=True)
    (line,) = features(tmp_path / "x.geojson")
    assert line["geometry"]["type"] == "MultiLineString"
    one, two = line["geometry"]["coordinates"]
    assert (one[-1][0], two[0][0]) == (180.0, -180.0)
    assert one[-1][1] == two[0][1] == pytest.approx(25.25)
    table = Fixes(time_s=[0, 10, 20, 500, 510.0], latitude_rad=[0.1] * 5, longitude_rad=[0.1, 0.2, 0.3, 0.4, 0.5], track=[7] * 5)
    write_geojson(tmp_path / "x.geojson", table, points=False, lines=True)
    assert [len(f["geometry"]["coordinates"]) for f in features(tmp_path / "x.geojson")] == [3, 2]
    assert features(tmp_path / "x.geojson")[0]["properties"]["target"] == "track 7"


def test_tables_like_residuals(tmp_path: Path) -> None:
    table = {"time_s": np.array([T0]), "latitude_rad": np.array([0.5]), "longitude_rad": np.array([0.1]),
             "range_before_m": np.array([12.5]), "azimuth_before_rad": np.array([0.01])}  # fmt: skip
    write_geojson(tmp_path / "x.geojson", table)
    properties = features(tmp_path / "x.geojson")[0]["properties"]
    assert properties["range_before_m"] == 12.5
    assert properties["azimuth_before_deg"] == pytest.approx(np.degrees(0.01), abs=1e-7)
    with pytest.raises(InputError, match="latitude"):
        write_geojson(tmp_path / "y.geojson", {"range_m": np.array([1.0])})
    assert not (tmp_path / "y.geojson").exists()
    with pytest.raises(SettingsError, match=r"sensors\.toml"):
        write_geojson(tmp_path / "y.geojson", plots())
    assert list(tmp_path.glob(".*")) == []


def test_a_moving_radar_is_drawn_about_its_platform(tmp_path: Path) -> None:
    own = Platform(
        time_s=[T0, T0 + 100], sensor=[65536] * 2, latitude_rad=np.radians([50, 50.01]), longitude_rad=np.radians([1, 1])
    )
    seen = Plots(time_s=[T0, T0 + 50, T0 + 500], sensor=[65536] * 3, range_m=[1000.0] * 3, azimuth_rad=[np.pi / 2] * 3)
    counts = write_geojson(tmp_path / "x.geojson", seen, platform=own)
    assert counts == {"plots": 2, "without position": 1}
    at = np.array([f["geometry"]["coordinates"][:2] for f in features(tmp_path / "x.geojson")])
    _, _, away = Geod(ellps="WGS84").inv([1, 1], [50, 50.005], at[:, 0], at[:, 1])
    np.testing.assert_allclose(away, 1000, atol=0.01)
    np.testing.assert_allclose(at[:, 1], [50, 50.005], atol=2e-6)


def test_iso_times() -> None:
    rng = np.random.default_rng(0)
    for t in [0.0, T0, T0 + 0.999999, *(T0 + rng.uniform(0, 1e6, 50))]:
        text = iso(t)
        assert text is not None
        assert datetime.datetime.fromisoformat(text).timestamp() == pytest.approx(t, abs=1e-6)
    assert iso(float("nan")) is None


# -------------------------------------------------------------------------------------------------------------------- KML


def test_kml_is_xml_with_a_folder_for_each_target(tmp_path: Path) -> None:
    table = {"time_s": np.array([T0, T0 + 1]), "latitude_rad": np.array([0.5, 0.6]), "longitude_rad": np.array([0.1, 0.2]),
             "note": np.array(["<b>&\"'\x01", "ok"])}  # fmt: skip
    counts = write_kml(tmp_path / "x.kml", {"fixes": fixes(), "a & b": table})
    root = ET.parse(tmp_path / "x.kml").getroot()
    assert root.tag == f"{KML}kml"
    assert counts == {"fixes": 4, "without position": 1, "a & b": 2}
    marks = root.findall(f".//{KML}Placemark")
    assert len(marks) == 6
    assert [m.find(f"{KML}name").text for m in marks[:4]] == ["00ABCD", "X", "X", "X"]
    assert [e.text for e in root.iter(f"{KML}when")][:1] == ["2026-03-01T00:00:00.25Z"]
    assert next(e.text for e in root.iter(f"{KML}coordinates")) == "1.0000000,50.1234568"
    line = root.find(f".//{KML}LineString/{KML}coordinates")
    assert line is not None
    assert line.text == "179.9000000,-0.5000000 -179.9000000,51.0000000"
    values = [e.text for e in root.iter(f"{KML}value")]
    assert "<b>&\"'" in values
    assert "12.346" in values


# ------------------------------------------------------------------------------------------------------------------- NMEA


def test_checksum_of_a_known_sentence() -> None:
    assert checksum("RATTM,11,11.4,13.6,T,7.0,20.0,T,0.0,0.0,N,,Q,,154125.82,A,") == "17"


def test_plots_come_back_within_a_quantum_over_midnight(tmp_path: Path) -> None:
    table = plots()
    own = Platform(
        time_s=T0 + 86_390 + np.arange(40.0), sensor=np.full(40, 65536), latitude_rad=np.radians(np.linspace(-50, -50.01, 40)),
        longitude_rad=np.radians(np.linspace(-179.999, -179.98, 40)), height_m=np.full(40, 45.5), heading_rad=np.full(40, 1.0),
        speed_mps=np.full(40, 5.0), course_rad=np.full(40, 1.1), roll_rad=0.1 * np.sin(np.arange(40.0)),
        pitch_rad=np.where(np.arange(40) % 5, -0.02 * np.cos(np.arange(40.0)), np.nan),
    )  # fmt: skip
    written = write_nmea(tmp_path / "x.nmea", table, platform=own)
    assert written.left_out == {}
    lines = (tmp_path / "x.nmea").read_bytes().split(b"\r\n")
    assert written.sentences == len(lines) - 1
    for line in lines[:-1]:
        body, _, told = line[1:].partition(b"*")
        assert checksum(body.decode()) == told.decode()
        assert len(line) <= 100
    back = read_nmea(tmp_path / "x.nmea")
    assert back.damaged == ()
    assert len(back.plots) == len(table)
    np.testing.assert_allclose(back.plots.time_s, table.time_s, atol=0.0006)
    np.testing.assert_allclose(back.plots.range_m, table.range_m, atol=0.00001 * 1852)
    np.testing.assert_allclose(np.angle(np.exp(1j * (back.plots.azimuth_rad - table.azimuth_rad))), 0, atol=np.radians(0.0001))
    np.testing.assert_allclose(back.plots.speed_mps, table.speed_mps, atol=0.001)
    np.testing.assert_array_equal(back.plots.track, table.track)
    np.testing.assert_array_equal((back.plots.flags & int(Flag.TRACK_END)) > 0, table.flags > 0)
    # Own ship is told by several sentences a report, all at its time.
    ship = back.platform[np.isin(np.arange(len(back.platform)), np.unique(back.platform.time_s, return_index=True)[1])]
    np.testing.assert_allclose(ship.time_s, own.time_s, atol=1e-3)
    np.testing.assert_allclose(ship.latitude_rad, own.latitude_rad, atol=1e-10)
    np.testing.assert_allclose(ship.longitude_rad, own.longitude_rad, atol=1e-10)
    np.testing.assert_allclose(ship.height_m, own.height_m, atol=1e-3)
    np.testing.assert_allclose(ship.heading_rad, own.heading_rad, atol=1e-5)
    np.testing.assert_allclose(ship.roll_rad, own.roll_rad, atol=1e-6)
    np.testing.assert_allclose(ship.pitch_rad, own.pitch_rad, atol=1e-6)
    np.testing.assert_allclose(ship.speed_mps[1:], own.speed_mps[1:], atol=1e-3)


def test_fixes_and_what_has_no_field(tmp_path: Path) -> None:
    written = write_nmea(tmp_path / "x.nmea", fixes=fixes())
    assert written.left_out == {"fixes without a time or position": 1, "height_m": 2, "mode_3a": 1, "mode_s": 1}
    back = read_nmea(tmp_path / "x.nmea").tracks
    np.testing.assert_allclose(back.latitude_rad, fixes().latitude_rad[:3], atol=1e-10)
    np.testing.assert_allclose(back.longitude_rad, fixes().longitude_rad[:3], atol=1e-10)
    # One nameless target alone is a receiver's log: with heights.
    alone = fixes()[:3].replace(callsign=[-1] * 3, mode_s=[-1] * 3, track=[1] * 3, horizontal_sd_m=[0.02, 0.5, 6.0])
    write_nmea(tmp_path / "x.nmea", fixes=alone)
    got = read_nmea(tmp_path / "x.nmea").fixes
    np.testing.assert_allclose(got.height_m, [12.346, np.nan, 100.0])
    np.testing.assert_allclose(got.horizontal_sd_m, [0.05, 0.5, 6.0])


def test_angles_and_minutes_never_round_to_impossible_ones(tmp_path: Path) -> None:
    edge = Plots(time_s=[T0 - 1e-5, T0], sensor=[1, 1], range_m=[1, 1], azimuth_rad=[2 * np.pi - 1e-12, -1e-12])
    write_nmea(tmp_path / "x.nmea", edge, fixes=Fixes(time_s=[T0], latitude_rad=[np.radians(50 - 1e-13)], longitude_rad=[np.pi]))
    text = (tmp_path / "x.nmea").read_text()
    assert "360.0" not in text
    assert "60.0000000" not in text
    assert "240000" not in text
    assert read_nmea(tmp_path / "x.nmea").damaged == ()


def test_plots_of_two_radars_need_two_logs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="several radars"):
        write_nmea(tmp_path / "x.nmea", plots().replace(sensor=np.arange(50) % 2))
    with pytest.raises(InputError, match="time"):
        write_nmea(tmp_path / "x.nmea", plots().replace(time_s=np.full(50, np.nan)))
    assert list(tmp_path.iterdir()) == []


# -------------------------------------------------------------------------------------------------------------- write_any


def test_every_ending_writes(tmp_path: Path) -> None:
    held = recording(plots=plots())
    for ending in ENDINGS:
        done = write_any(tmp_path / f"x{ending}", held, sensors=SENSORS)
        assert done.rows == {"plots": 50}
        assert (tmp_path / f"x{ending}").stat().st_size > 500
    assert len(read_table(tmp_path / "x.parquet").plots) == 50
    with pytest.raises(SettingsError, match=r"\.parquet, \.csv"):
        write_any(tmp_path / "x.docx", held)


def test_several_tables_are_never_lost_in_silence(tmp_path: Path) -> None:
    held = recording(plots=plots(), fixes=fixes(), platform=Platform(time_s=[T0], latitude_rad=[0.1], longitude_rad=[0.1]))
    with pytest.raises(SettingsError, match="plots, fixes, platform"):
        write_any(tmp_path / "x.csv", held)
    assert list(tmp_path.iterdir()) == []
    assert write_any(tmp_path / "x.csv", held, kind="fixes").files == (str(tmp_path / "x.csv"),)
    done = write_any(tmp_path / "y.csv", held, kind="all")
    assert sorted(p.name for p in tmp_path.glob("y*")) == ["y-fixes.csv", "y-platform.csv", "y-plots.csv"]
    assert done.rows == {"plots": 50, "fixes": 4, "platform": 1}
    done = write_any(tmp_path / "z.ast", held, source=0x0102)
    assert done.left_out["platform (no place in .ast)"] == 1
    assert done.left_out["fixes without a time or position"] == 1
    write_any(tmp_path / "z.geojson", held, sensors=SENSORS)
    assert {f["properties"]["kind"] for f in features(tmp_path / "z.geojson")} == {"plots", "fixes", "platform"}
    with pytest.raises(NothingToDo, match="no tracks"):
        write_any(tmp_path / "x.csv", held, kind="tracks")
    with pytest.raises(NothingToDo):
        write_any(tmp_path / "x.ast", recording(tracks=Tracks(time_s=[T0], latitude_rad=[0.1], longitude_rad=[0.1])))
    with pytest.raises(SettingsError, match="no kind"):
        write_any(tmp_path / "x.csv", held, kind="plot")
