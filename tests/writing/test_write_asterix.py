"""The ASTERIX writer against libasterix, which decodes every record that it writes."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import asterix.generated as gen
import numpy as np
import pytest
from asterix.base import Bits, RawDatablock
from hypothesis import given, settings
from hypothesis import strategies as st
from random_tables import MIDNIGHT_S, some_fixes, some_plots

from boresight.errors import InputError
from boresight.model import Channel, Fixes, Flag, Plots, unpack_callsigns
from boresight.writing import atomic
from boresight.writing.asterix import EPU_M, RADIUS_95, Marks, accuracy_category, accuracy_sd_m, encode_asterix, write_asterix

EDITIONS = {
    10: [gen.Cat_010_1_1],
    20: [gen.Cat_020_1_9, gen.Cat_020_1_11],
    21: [gen.Cat_021_2_1, gen.Cat_021_2_6],
    34: [gen.Cat_034_1_27, gen.Cat_034_1_29],
    48: [gen.Cat_048_1_27, gen.Cat_048_1_32],
}


def records(data: bytes, newest: bool = True) -> list[tuple[int, Any]]:
    """Every record that libasterix finds, with its category; a byte too many or too few anywhere is an error."""
    blocks = RawDatablock.parse(Bits.from_bytes(data))
    assert not isinstance(blocks, ValueError), blocks
    out = []
    for block in blocks:
        category = block.get_category()
        found = EDITIONS[category][-1 if newest else 0].cv_uap.parse(block.get_raw_records())
        assert not isinstance(found, ValueError), found
        out += [(category, record) for record in found]
    return out


def item(record: Any, name: str, *path: str) -> Any:
    """The content of an item (or of a part of it), or None where the record lacks it."""
    found = record.get_item(name)
    for part in path:
        if found is None:
            return None
        found = found.variation.get_item(part)
    return None if found is None else found.variation


def uint(record: Any, name: str, *path: str) -> int | None:
    found = item(record, name, *path)
    return None if found is None else found.as_uint()


def quantity(record: Any, unit: str, name: str, *path: str) -> float:
    found = item(record, name, *path)
    return math.nan if found is None else found.content.as_quantity(unit)


def text(record: Any, name: str, *path: str) -> str:
    found = item(record, name, *path)
    return "" if found is None else found.content.as_string().rstrip()


def near(found: float, given: float, quantum: float) -> bool:
    """Within half a quantum, or both absent."""
    return (math.isnan(found) and math.isnan(given)) or abs(found - given) <= 0.5001 * quantum


def near_angle(found_deg: float, given_rad: float, quantum_deg: float) -> bool:
    return abs((found_deg - math.degrees(given_rad) + 180) % 360 - 180) <= 0.5001 * quantum_deg


@pytest.mark.parametrize("newest", [False, True])
def test_plots_as_cat048(newest: bool) -> None:
    plots = some_plots(1)
    data, written = encode_asterix(plots)
    found = records(data, newest)
    assert written.records == len(found) == len(plots)
    assert written.bytes == len(data)
    kinds = {Channel.PSR: 1, Channel.SSR: 2, Channel.SSR_PSR: 3, Channel.MODE_S: 5, Channel.MODE_S_PSR: 7}
    for k, (category, r) in enumerate(found):
        flags = Flag(int(plots.flags[k]))
        assert category == 48
        assert uint(r, "010") == plots.sensor[k]
        late = quantity(r, "s", "140") - plots.time_s[k] % 86400
        assert abs((late + 43200) % 86400 - 43200) <= 0.5001 / 128
        assert uint(r, "020", "TYP") == kinds[Channel(plots.channel[k])]
        assert uint(r, "020", "SIM") == (Flag.SIMULATED in flags)
        assert uint(r, "020", "RAB") == (Flag.FIELD_MONITOR in flags)
        assert (uint(r, "020", "TST") or 0) == (Flag.TEST in flags)
        assert near(quantity(r, "NM", "040", "RHO") * 1852, plots.range_m[k], 1852 / 256)
        assert near_angle(quantity(r, "°", "040", "THETA"), plots.azimuth_rad[k], 360 / 65536)
        if plots.mode_3a[k] >= 0:
            assert text(r, "070", "MODE3A") == f"{plots.mode_3a[k]:04o}"
        assert (uint(r, "070", "G") or 0) == (Flag.GARBLED in flags)
        # Before edition 1.32 libasterix takes the level as unsigned.
        level = quantity(r, "FL", "090", "FL")
        assert near((level - 4096 if level > 2048 else level) * 30.48, plots.pressure_altitude_m[k], 7.62)
        assert near(quantity(r, "NM", "130", "RPD") * 1852, plots.psr_ssr_range_m[k], 1852 / 256)
        assert near(math.radians(quantity(r, "°", "130", "APD")), plots.psr_ssr_azimuth_rad[k], 2 * math.pi / 16384)
        assert (uint(r, "220") if uint(r, "220") is not None else -1) == plots.mode_s[k]
        assert text(r, "240") == unpack_callsigns(plots.callsign[k : k + 1])[0]
        assert (uint(r, "161", "TRN") if item(r, "161") else -1) == plots.track[k]
        if np.isfinite(plots.speed_mps[k]) and np.isfinite(plots.heading_rad[k]):
            assert near(quantity(r, "NM/s", "200", "GSP") * 1852, plots.speed_mps[k], 1852 / 16384)
            assert near_angle(quantity(r, "°", "200", "HDG"), plots.heading_rad[k], 360 / 65536)
        else:
            assert item(r, "200") is None
        assert (uint(r, "170", "TRE") or 0) == (Flag.TRACK_END in flags)
        warned = item(r, "030")
        expected = [n for flag, n in ((Flag.REFLECTION, 1), (Flag.SIDE_LOBE, 2), (Flag.SECOND_TIME, 4)) if flag in flags]
        assert [v.as_uint() for v in (warned.get_list() if warned is not None else [])] == expected
        assert near(quantity(r, "ft", "110", "3DH") * 0.3048, plots.height_m[k], 7.62)
    assert written.left_out["length_m"] == np.isfinite(plots.length_m).sum()
    assert "pressure_altitude_m" not in written.left_out


def test_plots_as_cat010() -> None:
    plots = some_plots(2, furthest_m=60e3)
    plots = plots.replace(
        flags=plots.flags | np.where(np.arange(len(plots)) % 3 == 0, int(Flag.GROUND | Flag.VEHICLE), 0).astype(np.uint32)
    )
    data, written = encode_asterix(plots, category=10)
    found = records(data)
    assert written.records == len(found) == len(plots)
    for k, (category, r) in enumerate(found):
        flags = Flag(int(plots.flags[k]))
        assert category == 10
        assert (uint(r, "010"), uint(r, "000")) == (plots.sensor[k], 1)
        assert near(quantity(r, "m", "040", "RHO"), plots.range_m[k], 1.0)
        assert near_angle(quantity(r, "°", "040", "TH"), plots.azimuth_rad[k], 360 / 65536)
        assert uint(r, "020", "GBS") == (Flag.GROUND in flags)
        assert (uint(r, "020", "TOT") or 0) == (2 if Flag.VEHICLE in flags else 0)
        assert (uint(r, "020", "SIM") or 0) == (Flag.SIMULATED in flags)
        assert (uint(r, "220") if uint(r, "220") is not None else -1) == plots.mode_s[k]
        assert (uint(r, "161", "TRK") if item(r, "161") else -1) == plots.track[k]
        assert near(quantity(r, "FL", "090", "FL") * 30.48, plots.pressure_altitude_m[k], 7.62)
        assert near(quantity(r, "ft", "091") * 0.3048, plots.height_m[k], 6.25 * 0.3048)
        assert text(r, "245", "CHR") == unpack_callsigns(plots.callsign[k : k + 1])[0]
        assert near(quantity(r, "m", "270", "LENGTH"), plots.length_m[k], 1.0)
        if np.isfinite(plots.length_m[k]) and np.isfinite(plots.heading_rad[k]):
            assert near_angle(quantity(r, "°", "270", "ORIENTATION"), plots.heading_rad[k], 360 / 128)
            assert near(quantity(r, "m", "270", "WIDTH"), plots.width_m[k], 1.0)


@pytest.mark.parametrize("newest", [False, True])
def test_fixes_as_cat021(newest: bool) -> None:
    fixes = some_fixes(3)
    data, written = encode_asterix(fixes=fixes)
    found = records(data, newest)
    assert written.records == len(found) == len(fixes)
    for k, (category, r) in enumerate(found):
        flags = Flag(int(fixes.flags[k]))
        assert category == 21
        assert uint(r, "010") == fixes.source[k]
        time, other = ("073", "071") if Flag.TIME_OF_RECEPTION in flags else ("071", "073")
        assert near(quantity(r, "s", time), fixes.time_s[k] % 86400, 1 / 128)
        assert item(r, other) is None
        for name, bits in (("130", 23), ("131", 30)):
            lsb = 180 / 2**bits
            assert near(quantity(r, "°", name, "LAT"), math.degrees(fixes.latitude_rad[k]), lsb)
            assert near_angle(quantity(r, "°", name, "LON"), fixes.longitude_rad[k], lsb)
        assert near(quantity(r, "ft", "140") * 0.3048, fixes.height_m[k], 6.25 * 0.3048)
        assert near(quantity(r, "FL", "145") * 30.48, fixes.pressure_altitude_m[k], 7.62)
        assert near(quantity(r, "ft/min", "157", "GVR") * 0.3048 / 60, fixes.velocity_up_mps[k], 6.25 * 0.3048 / 60)
        speed = math.hypot(fixes.velocity_east_mps[k], fixes.velocity_north_mps[k])
        assert near(quantity(r, "NM/s", "160", "GS") * 1852, speed, 1852 / 16384)
        if math.isfinite(speed):
            course = math.atan2(fixes.velocity_east_mps[k], fixes.velocity_north_mps[k])
            assert near_angle(quantity(r, "°", "160", "TA"), course, 360 / 65536)
        assert (uint(r, "080") if uint(r, "080") is not None else -1) == fixes.mode_s[k]
        assert (text(r, "070", "MODE3A") or "-1") == (f"{fixes.mode_3a[k]:04o}" if fixes.mode_3a[k] >= 0 else "-1")
        assert text(r, "170") == unpack_callsigns(fixes.callsign[k : k + 1])[0]
        assert (uint(r, "161", "TRNUM") if item(r, "161") else -1) == fixes.track[k]
        nacp = uint(r, "090", "NACP") or 0
        sd = fixes.horizontal_sd_m[k]
        if math.isfinite(sd):
            assert nacp == 0 or sd * RADIUS_95 <= EPU_M[nacp - 1] * 1.0011
            assert nacp == 11 or sd * RADIUS_95 >= EPU_M[nacp] * 0.999
        assert uint(r, "210", "VN") == 2
        assert (uint(r, "040", "GBS") or 0) == (Flag.GROUND in flags)
        assert (uint(r, "040", "SIM") or 0) == (Flag.SIMULATED in flags)
        assert (uint(r, "040", "TST") or 0) == (Flag.TEST in flags)
        assert uint(r, "040", "RAB") == (Flag.FIELD_MONITOR in flags)
        assert (uint(r, "020") or 0) == (21 if Flag.VEHICLE in flags else 0)


@pytest.mark.parametrize("newest", [True, False])
def test_multilaterated_fixes_as_cat020(newest: bool) -> None:
    fixes = some_fixes(7)
    fixes = fixes.replace(channel=np.full(len(fixes), Channel.MLAT), latitude_rad=np.clip(fixes.latitude_rad, -1.5, 1.5))
    data, written = encode_asterix(fixes=fixes)
    found = records(data, newest)
    assert written.records == len(found) == len(fixes)
    for k, (category, r) in enumerate(found):
        flags = Flag(int(fixes.flags[k]))
        assert category == 20
        assert uint(r, "010") == fixes.source[k]
        assert near(quantity(r, "s", "140"), fixes.time_s[k] % 86400, 1 / 128)
        assert near(quantity(r, "°", "041", "LAT"), math.degrees(fixes.latitude_rad[k]), 180 / 2**25)
        assert near_angle(quantity(r, "°", "041", "LON"), fixes.longitude_rad[k], 180 / 2**25)
        assert near(quantity(r, "ft", "105") * 0.3048, fixes.height_m[k], 6.25 * 0.3048)
        assert near(quantity(r, "FL", "090", "FL") * 30.48, fixes.pressure_altitude_m[k], 7.62)
        if np.isfinite(fixes.velocity_east_mps[k] + fixes.velocity_north_mps[k]):
            assert near(quantity(r, "m/s", "202", "VX"), fixes.velocity_east_mps[k], 0.25)
            assert near(quantity(r, "m/s", "202", "VY"), fixes.velocity_north_mps[k], 0.25)
        else:
            assert item(r, "202") is None
        assert (uint(r, "220") if uint(r, "220") is not None else -1) == fixes.mode_s[k]
        assert (text(r, "070", "MODE3A") or "-1") == (f"{fixes.mode_3a[k]:04o}" if fixes.mode_3a[k] >= 0 else "-1")
        assert (uint(r, "161", "TRN") if item(r, "161") else -1) == fixes.track[k]
        if fixes.horizontal_sd_m[k] < 16e3:
            assert near(quantity(r, "m", "500", "SDP", "X"), fixes.horizontal_sd_m[k], 0.25)
            assert quantity(r, "m", "500", "SDP", "X") == quantity(r, "m", "500", "SDP", "Y")
        if np.isfinite(fixes.vertical_sd_m[k]):
            assert near(quantity(r, "m", "500", "SDH"), fixes.vertical_sd_m[k], 0.5)
        assert (uint(r, "020", "MS"), uint(r, "020", "SSR")) == ((1, 0) if fixes.mode_s[k] >= 0 else (0, 1))
        assert (uint(r, "020", "GBS") or 0) == (Flag.GROUND in flags)
        assert (uint(r, "020", "SIM") or 0) == (Flag.SIMULATED in flags)
        assert (uint(r, "020", "TST") or 0) == (Flag.TEST in flags)
        assert (uint(r, "020", "RAB") or 0) == (Flag.FIELD_MONITOR in flags)
        assert (item(r, "300") is not None) == (Flag.VEHICLE in flags)


def test_north_marks_and_sectors_as_cat034() -> None:
    n = 9
    north = np.arange(n) % 3 == 0
    marks = Marks(
        time_s=MIDNIGHT_S + 4.0 * np.arange(n),
        sensor=np.full(n, 5249),
        azimuth_rad=np.where(north, np.nan, 2 * np.pi * (np.arange(n) % 3) / 4),
        rotation_s=np.where(north, 4.0015, np.nan),
        latitude_rad=np.full(n, math.radians(41.3007023)),
        longitude_rad=np.full(n, math.radians(2.1020582)),
        height_m=np.full(n, 27.257),
    )
    found = records(encode_asterix(marks=marks)[0])
    assert [c for c, _ in found] == [34] * n
    for k, (_, r) in enumerate(found):
        assert uint(r, "000") == (1 if north[k] else 2)
        assert near(quantity(r, "s", "030"), 4.0 * k, 1 / 128)
        assert near(quantity(r, "s", "041"), marks.rotation_s[k], 1 / 128)
        if north[k]:
            assert near(quantity(r, "°", "120", "LAT"), 41.3007023, 180 / 2**23)
            assert near(quantity(r, "°", "120", "LON"), 2.1020582, 180 / 2**23)
            assert near(quantity(r, "m", "120", "HGT"), 27.257, 1.0)
        else:
            assert near(quantity(r, "°", "020"), 90.0 * (k % 3), 360 / 256)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 30))
def test_blocks_hold_all_records_in_the_order_of_time(seed: int, n: int, per_block: int) -> None:
    plots, fixes = some_plots(seed, n), some_fixes(seed, n)
    fixes = fixes.replace(time_s=plots.time_s + 0.1)
    data, written = encode_asterix(plots, fixes, records_per_block=per_block)
    assert written.records == 2 * n
    found = records(data)
    both = np.concatenate([plots.time_s, fixes.time_s])
    kind = np.repeat([48, 21], n)[np.argsort(both, kind="stable")]
    assert [c for c, _ in found] == list(kind)
    times = np.array([quantity(r, "s", "140" if c == 48 else "071") for c, r in found if c == 48])
    steps = (np.diff(times) + 43200) % 86400 - 43200
    assert (steps >= 0).all()
    blocks = RawDatablock.parse(Bits.from_bytes(data))
    assert written.blocks == len(blocks)


def test_midnight_rounds_to_zero() -> None:
    plots = Plots(time_s=[MIDNIGHT_S - 1 / 512], sensor=[7], range_m=[1e3], azimuth_rad=[2 * np.pi - 1e-6])
    ((_, record),) = records(encode_asterix(plots)[0])
    assert quantity(record, "s", "140") == 0
    assert quantity(record, "°", "040", "THETA") == 0


def test_what_does_not_fit_is_counted() -> None:
    plots = Plots(
        time_s=[0.0, 1.0],
        sensor=[7, 7],
        range_m=[1e3, 1e3],
        azimuth_rad=[0, 0],
        pressure_altitude_m=[9e3, 70e3],
        psr_ssr_range_m=[1e3, 5.0],
    )
    _, written = encode_asterix(plots)
    assert written.left_out == {"pressure_altitude_m": 1, "psr_ssr_range_m": 1}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"time_s": [np.nan, 0]}, "record 0: a plot has no time"),
        ({"range_m": [1e3, np.nan]}, "record 1: a plot has no range"),
        ({"range_m": [1e3, 5e5]}, "256 NM"),
        ({"sensor": [7, 70000]}, "record 1: sensor is not a SAC/SIC"),
        ({"track": [4096, 1]}, "above 4095"),
    ],
)
def test_refuses_what_it_cannot_say(change: dict[str, Any], says: str) -> None:
    plots = Plots(time_s=[0.0, 1.0], sensor=[7, 7], range_m=[1e3, 1e3], azimuth_rad=[0, 0]).replace(**change)
    with pytest.raises(InputError, match=says):
        encode_asterix(plots)


def test_empty_tables_make_no_bytes() -> None:
    assert encode_asterix(Plots(), Fixes())[0] == b""


def test_accuracy_categories_are_their_own_inverse() -> None:
    assert list(accuracy_category(accuracy_sd_m(np.arange(1, 12)))) == list(range(1, 12))
    assert list(accuracy_category(np.array([np.nan, 1e6, 0.0]))) == [0, 0, 11]
    assert accuracy_sd_m(np.array([8, 9, 10, 11])) == pytest.approx([37.8, 12.3, 4.1, 1.2], abs=0.06)


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.ast"
    path.write_bytes(b"before")

    def interrupted() -> None:
        with atomic(path) as beside:
            beside.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [p.name for p in tmp_path.iterdir()] == ["a.ast"]
    assert path.read_bytes() == b"before"
    with pytest.raises(InputError, match="does not exist"):
        write_asterix(tmp_path / "none" / "a.ast", some_plots(1, 5))
    with pytest.raises(InputError, match="folder"):
        write_asterix(tmp_path, some_plots(1, 5))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_one_clear_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        with open("/dev/full", "wb", buffering=0) as file:
            file.write(b"x")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        write_asterix(tmp_path / "a.ast", some_plots(1, 5))
    assert list(tmp_path.iterdir()) == []
