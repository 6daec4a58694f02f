"""Tables: round trips with the writer, units, maps, and files with every kind of damage."""

from __future__ import annotations

import bz2
import csv
import datetime
import gzip
import io
import lzma
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.errors import InputError, SettingsError
from boresight.model import Channel, Fixes, Flag, Platform, Plots, Tracks, pack_callsigns, unpack_callsigns
from boresight.reading import is_asterix, read
from boresight.reading.tables import UNITS, load_columns, looks_like_table, read_table, shipped_maps
from boresight.writing.tables import write_table

T0 = 1_772_323_200.0  # 2026-03-01


def filled(table: Any, seed: int, n: int = 300) -> Any:
    """A table with every column filled and holes in all but what places a row."""
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {}
    for f in fields(table):
        kind, name = f.metadata["dtype"], f.name
        if name == "time_s":
            values = np.round(T0 + rng.uniform(0, 1e5, n), 6)
        elif name == "latitude_rad":
            values = rng.uniform(-1.5, 1.5, n)
        elif name == "elevation_rad":
            values = rng.uniform(-0.1, 1.5, n)
        elif name.endswith("_rad"):
            values = rng.uniform(-3.1, 3.1, n)
        elif kind.kind == "f":
            values = rng.uniform(0, 5000, n)
        elif name == "channel":
            values = rng.integers(0, len(Channel), n)
        elif name == "callsign":
            values = pack_callsigns(["KLM123", "A", "RYR 7"])[rng.integers(0, 3, n)]
        elif name == "record":
            values = np.arange(n)
        else:
            top = {"int16": 4095, "uint32": 2**32 - 1}.get(str(kind), 2**24 if name == "mode_s" else 999_999_999)
            values = rng.integers(0, top, n)
        if name not in ("range_m", "azimuth_rad", "latitude_rad", "longitude_rad", "time_s", "record", "channel", "flags"):
            values = np.where(rng.random(n) < 0.2, np.nan if kind.kind == "f" else -1, values)
        columns[name] = values
    return table(**columns)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("table", [Plots, Fixes, Tracks, Platform])
def test_what_is_written_comes_back(tmp_path: Path, table: Any, ending: str) -> None:
    path = tmp_path / f"x{ending}"
    before = filled(table, 5)
    write_table(path, before)
    recording = read_table(path)
    held = [t for t in (recording.plots, recording.fixes, recording.tracks, recording.platform) if len(t)]
    assert [type(t) for t in held] == [table]
    assert recording.damaged == ()
    for (name, a), (_, b) in zip(before._flat(), held[0]._flat(), strict=True):
        assert a.dtype == b.dtype, name
        if a.dtype.kind == "f":
            # A time is a whole number of microseconds; degrees and back cost a rounding.
            np.testing.assert_allclose(b, a, rtol=1e-14, atol=1.1e-6 if name == "time_s" else 1e-14, err_msg=name)
        else:
            np.testing.assert_array_equal(a, b, err_msg=name)


def test_cartesian_fixes_come_back(tmp_path: Path) -> None:
    write_table(tmp_path / "x.parquet", Fixes(time_s=[T0, T0 + 1], x_m=[1.0, 2.0], y_m=[3.0, np.nan]))
    np.testing.assert_array_equal(read_table(tmp_path / "x.parquet").fixes.y_m, [3.0, np.nan])


def mapped(tmp_path: Path, toml: str, text: str | bytes) -> Any:
    (tmp_path / "map.toml").write_text(toml, encoding="utf-8")
    (tmp_path / "x.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_table(tmp_path / "x.csv", tmp_path / "map.toml")


PLOTS = """
[plots]
time = { column = "ts", unit = "ms" }
range = { column = "Rng", unit = "NM" }
azimuth = { column = "Brg", unit = "deg" }
"""


def test_units_against_their_definitions(tmp_path: Path) -> None:
    definitions = {  # in SI, from their definitions
        "length": {"m": 1, "km": 1000, "NM": 1852, "ft": 0.3048, "FL": 30.48, "cm": 0.01},
        "angle": {"deg": np.pi / 180, "rad": 1, "mrad": 0.001},
        "speed": {"m/s": 1, "km/h": 1000 / 3600, "kn": 1852 / 3600, "ft/min": 0.3048 / 60, "ft/s": 0.3048},
    }
    column = {"length": "range", "angle": "azimuth", "speed": "speed"}
    rest = {
        "length": 'azimuth = { column = "b", unit = "rad" }',
        "angle": 'range = { column = "b", unit = "m" }',
        "speed": 'range = { column = "b", unit = "m" }\nazimuth = { column = "b", unit = "rad" }',
    }
    for quantity, units in definitions.items():
        assert set(units) == set(UNITS[quantity])
        for unit, factor in units.items():
            toml = f'[plots]\n{column[quantity]} = {{ column = "a", unit = "{unit}" }}\n{rest[quantity]}\n'
            plots = mapped(tmp_path, toml, "a,b\n2.5,1\n").plots
            got = {"length": plots.range_m, "angle": plots.azimuth_rad, "speed": plots.speed_mps}[quantity][0]
            assert got == pytest.approx(2.5 * factor, rel=1e-15), unit


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("iso", "2026-03-01T01:02:03.250Z"),
        ("iso", "2026-03-01 01:02:03.25"),
        ("iso", "2026-03-01T03:02:03.250+02:00"),
        ("iso", "2026-02-28T20:02:03.25-0500"),
        ("unix", "1772326923.25"),
        ("s", "1772326923.25"),
        ("ms", "1772326923250"),
        ("us", "1772326923250000"),
        ("ns", "1772326923250000000"),
    ],
)
def test_times(tmp_path: Path, unit: str, text: str) -> None:
    toml = PLOTS.replace('unit = "ms"', f'unit = "{unit}"')
    truth = datetime.datetime(2026, 3, 1, 1, 2, 3, 250000, datetime.UTC).timestamp()
    assert mapped(tmp_path, toml, f"ts,Rng,Brg\n{text},1,2\n").plots.time_s[0] == pytest.approx(truth, abs=1e-6)


def test_time_in_another_pattern_and_time_of_day_over_midnight(tmp_path: Path) -> None:
    toml = PLOTS.replace('unit = "ms"', 'format = "%d/%m/%Y %H:%M:%S"')
    assert mapped(tmp_path, toml, "ts,Rng,Brg\n01/03/2026 00:00:07,1,2\n").plots.time_s[0] == T0 + 7
    toml = PLOTS.replace('unit = "ms"', 'unit = "s of day"')
    assert "1970-01-01" in " ".join(mapped(tmp_path, toml, "ts,Rng,Brg\n5,1,2\n").warnings)
    (tmp_path / "x.csv").write_text("ts,Rng,Brg\n86399,1,2\n86399.5,1,2\n0.5,1,2\n86399.9,1,2\n1.5,1,2\n")
    plots = read_table(tmp_path / "x.csv", tmp_path / "map.toml", date=datetime.date(2026, 3, 1)).plots
    np.testing.assert_allclose(plots.time_s - T0, [86399, 86399.5, 86400.5, 86399.9, 86401.5])


def test_identities_constants_words_and_velocities(tmp_path: Path) -> None:
    toml = """
    [fixes]
    time = { column = "t", unit = "s" }
    latitude = { column = "la", unit = "deg" }
    longitude = { column = "lo", unit = "deg", absent = [181] }
    mode_s = { column = "hex" }
    mode_3a = { column = "sq" }
    callsign = { column = "cs" }
    on_ground = { column = "g" }
    speed = { column = "v", unit = "kn", absent = [102.3] }
    course = { column = "c", unit = "deg" }
    height = { column = "h", unit = "ft", absent = ["unknown"] }
    source = { value = 70000 }
    channel = { value = "ads_b" }
    """
    text = (
        "t,la,lo,hex,sq,cs,g,v,c,h\n"
        "1,50,1,3c4591,1174.0, BOX413 ,False,10,90,1000\n"
        "2,50,1,ABC,174,,TRUE,102.3,90,unknown\n"
        "3,50,181,,,NaN,0,0,,\n"
        "4,50,200,,,,,,,null\n"
    )
    recording = mapped(tmp_path, toml, text)
    f = recording.fixes
    assert recording.damaged == ()
    assert f.time_s.tolist() == [1, 2, 4]  # the third has no longitude
    assert any("1 of 4 rows hold no position" in w for w in recording.warnings)
    assert f.mode_s.tolist() == [0x3C4591, 0xABC, -1]
    assert f.mode_3a.tolist() == [0o1174, 0o174, -1]
    assert unpack_callsigns(f.callsign) == ["BOX413", "", ""]
    assert f.flags.tolist() == [0, int(Flag.GROUND), 0]
    np.testing.assert_allclose(f.velocity_east_mps, [18520 / 3600, np.nan, np.nan])
    np.testing.assert_allclose(f.velocity_north_mps[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(f.height_m, [304.8, np.nan, np.nan])
    np.testing.assert_allclose(np.degrees(f.longitude_rad), [1, 1, -160])
    assert set(f.source.tolist()) == {70000}
    assert set(f.channel.tolist()) == {Channel.ADS_B}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('unit = "NM"', 'unit = "furlong"'), ["furlong", "m, km, NM, ft, FL"]),
        ((', unit = "NM"', ""), ["no unit", "km"]),
        (('azimuth = { column = "Brg", unit = "deg" }', ""), ["azimuth_rad"]),
        (("range", "rnge"), ["rnge", "range"]),
        (('column = "ts", ', ""), ["column", "value"]),
        (('column = "ts"', 'colum = "ts"'), ["colum"]),
        (("[plots]", "[plotz]"), ["plotz"]),
        (("[plots]", "[plots"), ["TOML"]),
        (('column = "ts"', 'value = "soon"'), ["soon"]),
    ],
)
def test_maps_that_make_no_sense(tmp_path: Path, change: tuple[str, str], words: list[str]) -> None:
    (tmp_path / "map.toml").write_text(PLOTS.replace(*change))
    with pytest.raises(SettingsError) as error:
        load_columns(tmp_path / "map.toml")
    for word in ["map.toml", *words]:
        assert word in str(error.value)


def test_a_missing_column_is_named_with_those_that_exist(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        mapped(tmp_path, PLOTS, "ts,Range,Brg\n1,2,3\n")
    for word in ("'Rng'", "range_m", "ts, Range, Brg"):
        assert word in str(error.value)
    (tmp_path / "y.csv").write_text("when,where,what\n1,2,3\n")
    with pytest.raises(InputError, match="when, where, what"):
        read_table(tmp_path / "y.csv")


def test_impossible_values_are_left_out_with_their_place(tmp_path: Path) -> None:
    toml = """
    [fixes]
    latitude = { column = "la", unit = "deg" }
    longitude = { column = "lo", unit = "deg" }
    mode_s = { column = "h" }
    time = { column = "t", unit = "s" }
    """
    cells = (
        "50,1,abc,9 91,1,abc,9 50,-181,abc,9 5,1,xyz,9 5,1,1abcdef,9 5_0,1,abc,9 inf,1,abc,9 50,1,abc,1e12 50,x,abc,9 49,1,a,9"
    )
    lines = ["la,lo,h,t", *cells.split()]
    recording = mapped(tmp_path, toml, "\n".join(lines) + "\n")
    np.testing.assert_allclose(np.degrees(recording.fixes.latitude_rad), [50, 49])
    begins = np.cumsum([0, *(len(line) + 1 for line in lines)])
    assert [d.offset for d in recording.damaged] == begins[2:10].tolist()
    assert "latitude" in recording.damaged[0].why
    assert "'lo'" in recording.damaged[1].why
    assert recording.offset.tolist() == [begins[1], begins[10]]
    assert recording.fixes.record.tolist() == [0, 1]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
def test_separators_line_ends_and_byte_order_marks(tmp_path: Path, end: str, bom: bytes, separator: str) -> None:
    lines = ["ts,Rng,Brg,note", "1000,1,10,a", "", "2000,2,20,b", "3000,3,30"]
    text = end.join(lines).replace(",", separator) + end
    recording = mapped(tmp_path, PLOTS, bom + text.encode())
    np.testing.assert_allclose(recording.plots.time_s, [1, 2])
    np.testing.assert_allclose(recording.plots.range_m, [1852, 3704])
    whole = bom + text.encode()
    assert [d.offset for d in recording.damaged] == [whole.index(b"3000")]
    assert recording.offset.tolist() == [whole.index(b"1000"), whole.index(b"2000")]


def test_decimal_commas_mixed_ends_and_a_file_without_a_header(tmp_path: Path) -> None:
    toml = '[format]\ndecimal = ","\nskip = 1\n' + PLOTS
    recording = mapped(tmp_path, toml, b"made by hand\nts;Rng;Brg\r\n1000;1,5;10\n2000;2,5;20\r\n3000;3,5;30\r4000;4,5;40\n")
    np.testing.assert_allclose(recording.plots.range_m / 1852, [1.5, 2.5, 3.5, 4.5])
    toml = '[format]\nheader = ["ts", "Rng", "Brg"]\n' + PLOTS
    assert mapped(tmp_path, toml, "1000,1,10\n2000,2,20").plots.time_s.tolist() == [1, 2]


def test_quotes(tmp_path: Path) -> None:
    rows = [
        ["1000", "1", "10", "plain"],
        ["2000", "2", "20", "a, b"],
        ["3000", "3", "30", 'with "quotes"'],
        ["4000", "4", "40", "over\ntwo lines\nor three"],
        ["5000", "5", "50", ""],
    ]
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n", quoting=csv.QUOTE_ALL).writerows([["ts", "Rng", "Brg", "note"], *rows])
    recording = mapped(tmp_path, PLOTS, buffer.getvalue())
    assert recording.damaged == ()
    np.testing.assert_allclose(recording.plots.time_s, [1, 2, 3, 4, 5])
    # The same file without line ends in its fields takes the fast way, and must say the same.
    again = mapped(tmp_path, PLOTS, buffer.getvalue().replace("over\ntwo lines\nor three", "one line"))
    np.testing.assert_array_equal(again.plots.azimuth_rad, recording.plots.azimuth_rad)
    assert again.warnings == ()


def test_a_stray_quote_swallows_nothing_but_its_line(tmp_path: Path) -> None:
    lines = ["ts,Rng,Brg,note"] + [f"{k}000,{k},{k % 360},n{k}" for k in range(1, 2000)]
    lines[700] = '700000,"700,700,n700'
    lines[900] = '900000,900,180",n900'
    text = "\n".join(lines) + "\n"
    recording = mapped(tmp_path, PLOTS, text)
    assert sorted(set(range(1, 2000)) - set(recording.plots.time_s.astype(int).tolist())) == [700, 900]
    assert [d.offset for d in recording.damaged] == [text.index('700000,"'), text.index('900000,900,180"')]


def test_zeros_binary_and_very_long_lines(tmp_path: Path) -> None:
    text = b"ts,Rng,Brg\n1000,1,10\n2000,\0,20\n3000,3,30\n" + b"9" * 3_000_000 + b"\n4000,4,\xff\n5000,5,50\n"
    recording = mapped(tmp_path, PLOTS, text)
    assert recording.plots.time_s.tolist() == [1, 3, 5]
    assert [d.offset for d in recording.damaged] == [text.index(b"2000"), text.index(b"9" * 10), text.index(b"4000")]
    # A byte that is no UTF-8 in a column that is not read hurts nothing.
    recording = mapped(tmp_path, PLOTS, b"ts,Rng,Brg,name\n1000,1,10,Malm\xf6\n")
    assert len(recording.plots) == 1


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "empty"),
        (b"\n\n\n", "no line"),
        (b"ts,Rng,Brg\n", "no row"),
        (b"ts,Rng,Brg\nx,y,z\n", "no row could be read"),
        (b"\xff\xfet\0s\0", "UTF-16"),
        (b"ts\n1\n", "one column"),
        (b"ts,Rng,Brg,ts\n1,2,3,4\n", "several"),
        (bytes(range(256)) * 10, ""),
        (b"PAR1" + b"\0" * 100, ""),
        (b"PAR1 this is no parquet PAR1", ""),
    ],
)
def test_files_of_which_nothing_can_be_read(tmp_path: Path, content: bytes, word: str) -> None:
    with pytest.raises(InputError) as error:
        mapped(tmp_path, PLOTS, content)
    assert word in str(error.value)
    assert "x.csv" in str(error.value)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_table(path)
    with pytest.raises(SettingsError, match="no kind"):
        read_table(tmp_path / "none.csv", kind="plot")


def test_several_tables_of_one_file(tmp_path: Path) -> None:
    toml = (
        PLOTS
        + """
    [platform]
    time = { column = "ts", unit = "ms" }
    latitude = { column = "la", unit = "deg" }
    longitude = { column = "lo", unit = "deg" }
    """
    )
    recording = mapped(tmp_path, toml, "ts,Rng,Brg,la,lo\n1000,1,2,50,1\n2000,,,51,1\n3000,3,4,,\n")
    assert recording.plots.record.tolist() == [0, 2]
    assert recording.platform.record.tolist() == [0, 1]


def test_own_ship_with_roll_and_pitch_comes_from_a_table(tmp_path: Path) -> None:
    toml = """
    [platform]
    time = { column = "ts", unit = "s" }
    sensor = { value = 65536 }
    latitude = { column = "la", unit = "deg" }
    longitude = { column = "lo", unit = "deg" }
    heading = { column = "hdg", unit = "deg" }
    roll = { column = "roll", unit = "deg" }
    pitch = { column = "pitch", unit = "rad", optional = true }
    """
    text = "ts,la,lo,hdg,roll,pitch\n1,50,1,359.5,-4.5,-0.02\n2,50,1,0.5,3.25,0.01\n3,50,1,1.5,,\n4,50,1,1.5,abc,0\n"
    recording = mapped(tmp_path, toml, text)
    own = recording.platform
    np.testing.assert_allclose(np.degrees(own.roll_rad[:3]), [-4.5, 3.25, np.nan])
    np.testing.assert_allclose(own.pitch_rad[:3], [-0.02, 0.01, np.nan])
    np.testing.assert_allclose(np.degrees(own.heading_rad[:2]), [359.5, 0.5])
    assert len(recording.damaged) == 1


def test_content_is_recognised() -> None:
    assert looks_like_table(b"a,b,c\n1,2,3\n")
    assert looks_like_table(b"PAR1....")
    foreign = [b"", b"$GPGGA,1,2,3\n", b"!AIVDM,1,1,,A\n", b"1,2,3\n4,5,6\n", b"0\x00\x10,b,c\n", b"% x,y,z\n"]
    for head in [*foreign, b'[{"a":1,"b":2,"c":3}]']:
        assert not looks_like_table(head)


def test_shipped_maps_hold_together() -> None:
    assert {"OpenSky history", "AIS, Solent"} <= set(shipped_maps())


@pytest.mark.parametrize("rounds", [8, pytest.param(50, marks=pytest.mark.slow)])
def test_mutated_lines(tmp_path: Path, rounds: int) -> None:
    """Two thousand lines a round are hurt in one way each; every line that was not is read, and as it was."""
    rng = np.random.default_rng(rounds)
    for round_ in range(rounds):
        n = 4000
        lines = [f"{k}000,{k % 90}.5,{k % 360},name {k}".encode() for k in range(1, n + 1)]
        hurt: set[int] = set()
        for k in rng.choice(n, 2000, replace=False).tolist():
            hurt.add(k)
            line = bytearray(lines[k])
            how = int(rng.integers(0, 7))
            at = int(rng.integers(0, len(line)))
            if how == 0:
                line[at] = int(rng.integers(0, 256))
            elif how == 1:
                del line[at:]
            elif how == 2:
                line[at:at] = rng.integers(0, 256, int(rng.integers(1, 9)), np.uint8).tobytes()
            elif how == 3:
                line[at:at] = b'"'
            elif how == 4:
                line[at:at] = b","
            elif how == 5:
                line[at:at] = b"\0" * 4
            else:
                line[at:at] = b'"\n'
            lines[k] = bytes(line)
        ends = [b"\n", b"\r\n"] if round_ % 2 else [b"\n", b"\n"]
        text = b"ts,Rng,Brg,note\n" + b"".join(line + ends[k % 2] for k, line in enumerate(lines))
        recording = mapped(tmp_path, PLOTS, text)
        sound = np.array([k for k in range(n) if k not in hurt])
        offset = dict(zip(recording.offset[recording.plots.record].tolist(), range(len(recording.plots)), strict=True))
        begins = np.cumsum([16, *(len(line) + len(ends[k % 2]) for k, line in enumerate(lines))])[:-1]
        missing = [k for k in sound.tolist() if int(begins[k]) not in offset]
        assert missing == []
        rows = np.array([offset[int(begins[k])] for k in sound.tolist()])
        np.testing.assert_allclose(recording.plots.time_s[rows], sound + 1)
        np.testing.assert_allclose(recording.plots.range_m[rows], ((sound + 1) % 90 + 0.5) * 1852)
        # Nothing outside the plausible, and every damage stands where a line was hurt.
        assert np.all((recording.plots.range_m >= 0) & (recording.plots.range_m < 1e8))
        edges = np.sort(begins)
        places = np.searchsorted(edges, [d.offset for d in recording.damaged], side="right") - 1
        assert set(places.tolist()) <= hurt


def test_mutated_parquet(tmp_path: Path) -> None:
    write_table(tmp_path / "good.parquet", filled(Plots, 1, 500))
    good = (tmp_path / "good.parquet").read_bytes()
    rng = np.random.default_rng(3)
    for k in range(40):
        data = bytearray(good)
        for _ in range(int(rng.integers(1, 8))):
            data[int(rng.integers(4, len(data)))] = int(rng.integers(0, 256))
        if k % 4 == 0:
            del data[int(rng.integers(4, len(data))) :]
        (tmp_path / "x.parquet").write_bytes(data)
        try:
            recording = read_table(tmp_path / "x.parquet")
        except (InputError, SettingsError):
            continue
        assert recording.records <= 500 * 2


@pytest.mark.real
def test_solent_ais(data: Path) -> None:
    path = data / "ais" / "SolentAIS_20160112_130211.csv"
    recording = read_table(path)
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    f = recording.fixes
    assert len(f) == len(rows) == 18_623
    assert recording.damaged == ()
    assert f.mmsi.tolist() == [int(r["MMSI"]) for r in rows]
    np.testing.assert_allclose(np.degrees(f.latitude_rad), [float(r["Latitude_degrees"]) for r in rows], atol=1e-12)
    times = [datetime.datetime.fromisoformat(r["Time"]).replace(tzinfo=datetime.UTC).timestamp() for r in rows]
    np.testing.assert_allclose(f.time_s, times, atol=1e-6)
    lost = np.array([float(r["COG_degrees"]) == 360 and float(r["SOG_knots"]) != 0 for r in rows])
    np.testing.assert_array_equal(np.isnan(f.velocity_east_mps), lost)
    speed = np.hypot(f.velocity_east_mps, f.velocity_north_mps)
    np.testing.assert_allclose(speed[~lost], np.array([float(r["SOG_knots"]) for r in rows])[~lost] * 1852 / 3600, atol=1e-9)


def test_a_table_may_bring_its_column_map(tmp_path: Path) -> None:
    """`read` finds it by its name, and so every command does."""
    path = tmp_path / "own.csv"
    path.write_text("when,wide,long\n2020-01-01T00:00:00Z,41,2\n2020-01-01T00:00:01Z,41.5,2.5\n")
    with pytest.raises(InputError, match=r"when, wide, long.*own\.csv\.map\.toml"):
        read(path)
    beside = tmp_path / "own.csv.map.toml"
    beside.write_text(
        '[fixes]\ntime = { column = "when", unit = "iso" }\nlatitude = { column = "wide", unit = "deg" }\n'
        'longitude = { column = "long", unit = "deg" }\n'
    )
    found = read(path)
    np.testing.assert_allclose(np.degrees(found.fixes.latitude_rad), [41.0, 41.5])
    assert found.warnings[0] == f"its columns are read as {beside} says"
    assert not is_asterix(path)


@pytest.mark.parametrize(("pack", "word"), [(gzip.compress, "gzip"), (bz2.compress, "bzip2"), (lzma.compress, "xz")])
def test_a_packed_file_is_named_with_the_way_to_unpack_it(tmp_path: Path, pack: Callable[[bytes], bytes], word: str) -> None:
    path = tmp_path / "packed"
    path.write_bytes(pack(b"when,wide,long\n"))
    with pytest.raises(InputError, match=f"packed with {word}.*Unpack it first"):
        read(path)
    with pytest.raises(InputError, match="Unpack it first"):
        read(path, columns=tmp_path / "map.toml")
