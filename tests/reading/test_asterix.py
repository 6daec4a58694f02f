"""Reading ASTERIX: framing, damage, time, editions and columns."""

from __future__ import annotations

import datetime
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from boresight.errors import InputError, SettingsError
from boresight.model import Channel, Fixes, Flag, Marks, Plots, unpack_callsigns
from boresight.reading import read, sha256_of, uap
from boresight.reading.asterix import DecodeState, Records, decode, read_asterix

DATE = datetime.date(2016, 5, 10)
DAY = 86400.0
MIDNIGHT = 1462838400.0  # 2016-05-10 00:00 UTC


# ------------------------------------------------------------------------------------------------------------ making records


def record(category: int, edition: str, items: dict[str, bytes]) -> bytes:
    """One record: its FSPEC and items, from the standard's order of items."""
    order = [i.name if i is not None else None for i in uap.items_of(category, edition)]
    bits = [name in items for name in order]
    assert sum(bits) == len(items), "an item that the category does not have"
    octets = [bits[k : k + 7] for k in range(0, len(bits), 7)]
    while not any(octets[-1]):
        octets.pop()
    fspec = bytes(sum(0x80 >> j for j, bit in enumerate(octet) if bit) | (k + 1 < len(octets)) for k, octet in enumerate(octets))
    return fspec + b"".join(items[name] for name in order if name in items)


def block(category: int, *records: bytes) -> bytes:
    body = b"".join(records)
    return bytes([category]) + (len(body) + 3).to_bytes(2, "big") + body


def tod(seconds: float) -> bytes:
    return round(seconds * 128).to_bytes(3, "big")


def number(value: int, size: int) -> bytes:
    return value.to_bytes(size, "big", signed=True)


def smr(seconds: float, *, sic: int = 7, items: dict[str, bytes] | None = None) -> bytes:
    """A plot of a surface radar at 1,000 m and 90 degrees."""
    base = {"010": bytes([0, sic]), "000": b"\1", "020": b"\x60", "140": tod(seconds), "040": b"\x03\xe8\x40\x00"}
    return record(10, "1.1", base | (items or {}))


def radar(seconds: float, items: dict[str, bytes] | None = None) -> bytes:
    base = {"010": b"\x14\x81", "140": tod(seconds), "020": b"\xa0", "040": b"\x0a\x00\x80\x00"}
    return record(48, "1.x", base | (items or {}))


def old_plot(seconds: float, items: dict[str, bytes] | None = None) -> bytes:
    """A combined plot of category 001 at 10 NM and 180 degrees."""
    base = {"010": b"\x19\xc9", "020": b"\x30", "040": b"\x05\x00\x80\x00", "141": tod(seconds)[1:]}
    return record(1, "1.x", base | (items or {}))


def old_track(seconds: float, items: dict[str, bytes] | None = None) -> bytes:
    base = {"010": b"\x19\xc9", "020": b"\xb0", "040": b"\x05\x00\x80\x00", "141": tod(seconds)[1:], "161": b"\1\x23"}
    return record(256, "1.x", base | (items or {}))


def adsb(edition: str, seconds: float, items: dict[str, bytes], time_item: str | None = None) -> bytes:
    base = {"010": b"\x00\x6b", time_item or ("030" if edition[0] == "0" else "071"): tod(seconds)}
    return record(21, edition, base | items)


def name(callsign: str) -> bytes:
    """Eight characters of six bits: A is 1, a digit is 48 and more, a blank is 32."""
    codes = [ord(c) - 64 if c.isalpha() else ord(c) for c in callsign.ljust(8)]
    return sum(code << 6 * (7 - k) for k, code in enumerate(codes)).to_bytes(6, "big")


def position(lat: float, lon: float) -> bytes:
    return number(round(lat * 2**23 / 180), 3) + number(round(lon * 2**23 / 180), 3)


def whole(data: bytes, **begin: object) -> Records:
    records, _, consumed = decode(data, DecodeState.begin(**begin), final=True)
    assert consumed == len(data)
    return records


def same_tables(a: Plots | Fixes | Marks, b: Plots | Fixes | Marks) -> None:
    for (name, x), (_, y) in zip(a._flat(), b._flat(), strict=True):
        np.testing.assert_array_equal(x, y, err_msg=name)


def write(folder: Path, data: bytes, name: str = "some.ast") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


# ------------------------------------------------------------------------------------------------------------------ columns


def test_a_plot_has_range_azimuth_identity_and_flags_in_si() -> None:
    data = block(
        48,
        radar(
            3600.5,
            {
                "020": b"\xa1\x80",
                "070": b"\x0f\xc0",
                "090": b"\x05\x78",
                "130": b"\x06\x0a\xfc",
                "220": b"\x34\x12\xcd",
                "240": name("IAW1234"),
                "161": b"\x01\x23",
                "200": b"\x08\x00\x40\x00",
                "030": b"\x05\x08",
                "110": b"\x01\x90",
                "230": b"\x04\x00",
            },
        ),
    )
    plots = whole(data, date=DATE).plots
    assert len(plots) == 1
    assert plots.time_s[0] == MIDNIGHT + 3600.5
    assert plots.sensor[0] == 20 << 8 | 129
    assert plots.channel[0] == Channel.MODE_S
    assert plots.range_m[0] == pytest.approx(10 * 1852)
    assert plots.azimuth_rad[0] == pytest.approx(math.pi)
    assert plots.mode_3a[0] == 0o7700
    assert plots.pressure_altitude_m[0] == pytest.approx(350 * 30.48)
    assert plots.psr_ssr_range_m[0] == pytest.approx(10 / 256 * 1852)
    assert plots.psr_ssr_azimuth_rad[0] == pytest.approx(-4 / 16384 * 2 * math.pi)
    assert plots.mode_s[0] == 0x3412CD
    assert unpack_callsigns(plots.callsign) == ["IAW1234"]
    assert plots.track[0] == 0x123
    assert plots.speed_mps[0] == pytest.approx(1852 * 2048 / 2**14)
    assert plots.heading_rad[0] == pytest.approx(math.pi / 2)
    assert plots.height_m[0] == pytest.approx(400 * 25 * 0.3048)
    # TST; warnings 2 (side lobe) and 4 (second time around); transponder on the ground.
    assert plots.flags[0] == Flag.TEST | Flag.SIDE_LOBE | Flag.SECOND_TIME | Flag.GROUND


@pytest.mark.parametrize(
    ("bits", "code", "level"), [(0x00, 0o1234, 30480.0), (0x80, -1, math.nan), (0x40, -1, math.nan), (0x20, 0o1234, 30480.0)]
)
def test_codes_and_levels_that_are_garbled_or_not_validated_are_absent(bits: int, code: int, level: float) -> None:
    first, second = 0o1234.to_bytes(2, "big")
    top, low = (4000).to_bytes(2, "big")
    data = block(48, radar(1.0, {"070": bytes([bits | first, second]), "090": bytes([(bits & 0xC0) | top, low])}))
    plots = whole(data).plots
    assert plots.mode_3a[0] == code
    assert plots.pressure_altitude_m[0] == pytest.approx(level, nan_ok=True)
    assert bool(plots.flags[0] & Flag.GARBLED) == bool(bits & 0x40)


def test_the_surface_radar_gives_plot_and_fix_with_size_and_orientation() -> None:
    items = {
        "042": number(-1000, 2) + number(500, 2),
        "202": number(40, 2) + number(-40, 2),
        "270": bytes([36 << 1 | 1, 32 << 1 | 1, 30 << 1]),
        "500": b"\x28\x28\x00\x00",
        "170": b"\x01\x01\x80",
    }
    records = whole(block(10, smr(5.0, items=items), record(10, "1.1", {"010": b"\0\7", "000": b"\2", "140": tod(6.0)})))
    plots, fixes = records.plots, records.fixes
    assert (len(records.offset), len(plots), len(fixes)) == (2, 1, 1)
    assert plots.channel[0] == Channel.PSR
    assert (plots.range_m[0], plots.length_m[0], plots.width_m[0]) == (1000.0, 36.0, 30.0)
    assert plots.azimuth_rad[0] == pytest.approx(math.pi / 2)
    assert plots.heading_rad[0] == pytest.approx(math.pi / 2)
    assert plots.speed_mps[0] == pytest.approx(10 * math.sqrt(2))
    assert (fixes.x_m[0], fixes.y_m[0]) == (-1000.0, 500.0)
    assert (fixes.velocity_east_mps[0], fixes.velocity_north_mps[0]) == (10.0, -10.0)
    assert fixes.horizontal_sd_m[0] == pytest.approx(10.0)
    assert plots.flags[0] == Flag.REFLECTION  # a ghost track


def test_a_cartesian_position_beyond_its_sixteen_bits_is_no_fix() -> None:
    far = {"010": b"\0\x6b", "000": b"\1", "140": tod(1.0), "042": number(32767, 2) + number(5, 2)}
    records = whole(block(10, record(10, "1.1", far), smr(2.0, items={"042": number(7, 2) + number(8, 2)})))
    assert len(records.fixes) == 1
    assert records.clipped == 1


@pytest.mark.parametrize(
    ("version", "nacp", "sd"),
    [
        (2, 8, 92.6 / 2.448),
        (2, 9, 30 / 2.448),
        (1, 10, 10 / 2.448),
        (2, 11, 3 / 2.448),
        (2, 0, math.nan),
        (0, 9, math.nan),
        (2, 14, math.nan),
    ],
)
def test_ads_b_accuracy_comes_from_nacp_and_only_where_the_version_has_it(version: int, nacp: int, sd: float) -> None:
    items = {
        "130": position(41.3, 2.1),
        "090": bytes([0xF1, nacp << 1 | 1, 2 << 1]),
        "210": bytes([version << 3 | 2]),
        "140": number(1600, 2),
        "145": number(1400, 2),
        "080": b"\x34\x12\xcd",
        "160": b"\x08\x00\x80\x00",
        "157": bytes([0x7F, 0x9C]),  # no RE, -100 in 15 bits
    }
    fixes = whole(block(21, adsb("2.x", 10.0, items)), editions={21: "2.x"}).fixes
    assert fixes.horizontal_sd_m[0] == pytest.approx(sd, nan_ok=True)
    assert fixes.vertical_sd_m[0] == pytest.approx(45 / 1.96 if version == 2 else math.nan, nan_ok=True)
    assert fixes.height_m[0] == pytest.approx(10000 * 0.3048)
    assert fixes.pressure_altitude_m[0] == pytest.approx(350 * 30.48)
    assert fixes.latitude_rad[0] == pytest.approx(math.radians(41.3), abs=4e-7)
    assert fixes.velocity_north_mps[0] == pytest.approx(-1852 / 8)
    assert fixes.velocity_east_mps[0] == pytest.approx(0, abs=1e-9)
    assert fixes.velocity_up_mps[0] == pytest.approx(-100 * 6.25 * 0.3048 / 60)
    assert fixes.channel[0] == Channel.ADS_B


def test_the_fine_position_goes_before_the_coarse_one() -> None:
    fine = number(round(41.3 * 2**30 / 180), 4) + number(round(2.1 * 2**30 / 180), 4)
    fixes = whole(block(21, adsb("2.x", 10.0, {"130": position(41.0, 2.0), "131": fine})), editions={21: "2.x"}).fixes
    assert math.degrees(fixes.latitude_rad[0]) == pytest.approx(41.3, abs=2e-7)


def test_the_time_of_an_ads_b_position_is_its_applicability_else_its_reception_else_its_transmission() -> None:
    place = {"130": position(41.3, 2.1)}
    fraction = round(0.25 * 2**30)
    data = block(
        21,
        adsb("2.x", 100.0, place | {"073": tod(200.0)}),
        adsb("2.x", 101.0, place, "073"),
        adsb("2.x", 102.0, place | {"074": fraction.to_bytes(4, "big")}, "073"),
        adsb("2.x", 103.0, place | {"074": (fraction | 1 << 30).to_bytes(4, "big")}, "073"),
        adsb("2.x", 104.0, place | {"074": (fraction | 2 << 30).to_bytes(4, "big")}, "073"),
        adsb("2.x", 105.0, place, "077"),
    )
    fixes = whole(data, editions={21: "2.x"}).fixes
    np.testing.assert_allclose(fixes.time_s, [100, 101, 102.25, 104.25, 103.25, 105], atol=1e-9)
    late = (fixes.flags & Flag.TIME_OF_RECEPTION) != 0
    assert late.tolist() == [False, True, True, True, True, False]
    assert np.isnan(fixes.time_sd_s[:5]).all()
    assert fixes.time_sd_s[5] == 0.5


def test_a_report_that_tells_only_its_transmission_is_said(tmp_path: Path) -> None:
    data = block(21, *[adsb("2.x", 5.0 + k, {"130": position(41.3, 2.1)}, "077") for k in range(3)])
    recording = read(write(tmp_path, data), date=DATE)
    assert any("I021/077" in w and w.startswith("3 ") for w in recording.warnings)


def test_a_height_beyond_its_range_is_absent() -> None:
    data = block(21, adsb("2.x", 1.0, {"130": position(41, 2), "140": b"\x7f\xff"}))
    assert np.isnan(whole(data, editions={21: "2.x"}).fixes.height_m[0])


@pytest.mark.parametrize(
    ("raw", "told"),
    [(name("IBE04KZ"), "IBE04KZ"), (bytes(6), ""), (name(""), ""), (name("ALME")[:3] + bytes(3), "ALME")],
)
def test_callsigns_end_where_the_sender_stopped(raw: bytes, told: str) -> None:
    plots = whole(block(48, radar(1.0, {"240": raw}))).plots
    assert unpack_callsigns(plots.callsign) == [told]
    assert (plots.callsign[0] == -1) == (told == "")


def test_the_stream_tells_its_own_position(tmp_path: Path) -> None:
    north = record(
        34, "1.x", {"010": b"\x14\x81", "000": b"\1", "030": tod(1.0), "120": number(27, 2) + position(41.3007, 2.1021)}
    )
    recording = read(write(tmp_path, block(34, north) + block(48, radar(1.5))), date=DATE)
    assert {s.category for s in recording.sources} == {34, 48}
    for source in recording.sources:
        assert (source.sac, source.sic) == (20, 129)
        assert math.degrees(source.latitude_rad) == pytest.approx(41.3007, abs=2e-5)
        assert source.height_m == 27.0


# --------------------------------------------------------------------------------------------------------------------- time


def test_the_day_goes_on_across_midnight_in_both_directions() -> None:
    """Records out of order around midnight keep their day."""
    seconds = [DAY - 2.0, DAY - 0.5, 0.25, DAY - 0.25, 1.0, 0.5, DAY - 1.0, 2.0]
    true = [-2.0, -0.5, 0.25, -0.25, 1.0, 0.5, -1.0, 2.0]
    times = whole(b"".join(block(10, smr(t)) for t in seconds), date=DATE).time_s
    np.testing.assert_array_equal(times, MIDNIGHT + DAY + np.array(true))


def test_the_day_is_kept_by_source_and_a_new_source_joins_the_others() -> None:
    data = block(10, smr(DAY - 1.0)) + block(10, smr(0.5)) + block(10, smr(1.0, sic=9)) + block(10, smr(DAY - 0.5, sic=8))
    np.testing.assert_array_equal(whole(data, date=DATE).time_s - MIDNIGHT, [DAY - 1, DAY + 0.5, DAY + 1, DAY - 0.5])


def test_a_time_of_day_beyond_a_day_is_not_known(tmp_path: Path) -> None:
    recording = read(write(tmp_path, block(10, smr(5.0)) + block(10, smr(100000.0)) + block(10, smr(6.0))), date=DATE)
    assert np.isnan(recording.plots.time_s).tolist() == [False, True, False]
    assert any("no time of day" in w for w in recording.warnings)


def test_the_time_of_reception_tells_the_day_of_a_datagram() -> None:
    state = DecodeState.begin()
    late = MIDNIGHT + DAY + 0.1
    records, state, _ = decode(block(10, smr(DAY - 0.5)), state, late, final=True)
    assert records.time_s[0] == MIDNIGHT + DAY - 0.5
    records, state, _ = decode(block(10, smr(0.0625)), state, late, final=True)
    assert records.time_s[0] == MIDNIGHT + DAY + 0.0625
    assert (state.records, state.offset) == (2, 2 * len(block(10, smr(0.0))))


def test_no_date_counts_from_day_0_and_says_so(tmp_path: Path) -> None:
    recording = read(write(tmp_path, block(10, smr(5.0))))
    assert recording.plots.time_s[0] == 5.0
    assert any("--date" in w for w in recording.warnings)


def test_duplicates_and_disorder_are_kept_and_counted(tmp_path: Path) -> None:
    data = block(10, smr(5.0)) + block(10, smr(6.0)) + block(10, smr(5.0)) + block(10, smr(7.0))
    recording = read(write(tmp_path, data), date=DATE)
    assert recording.records == len(recording.plots) == 4
    assert any(w.startswith("1 records are byte for byte the same") for w in recording.warnings)
    assert any(w.startswith("1 records of SAC/SIC 0/7 are stamped before") and "1.000 s" in w for w in recording.warnings)


# ---------------------------------------------------------------------------------------------------------------- editions


def traffic(edition: str, n: int = 60) -> bytes:
    """ADS-B of one aircraft flying north, in blocks of one and two records."""
    out = b""
    for k in range(n):
        size = 8 if edition in ("0.25", "0.26") else 6
        lat, lon = 41.0 + k * 1e-3, 2.1
        place = position(lat, lon) if size == 6 else number(round(lat * 2**25 / 180), 4) + number(round(lon * 2**25 / 180), 4)
        items = {"130": place, "080": b"\x34\x12\xcd", "170": name("IAW1234")}
        if edition[0] == "0":
            items |= {"040": b"\x00\x00", "090": b"\x00\x08", "210": b"\x08", "145": number(1400, 2)}
        else:
            items |= {"040": b"\x01\x00", "161": b"\x00\x07", "145": number(1400, 2), "210": b"\x12"}
        one = adsb(edition, 1000.0 + k, items)
        out += block(21, one) if k % 3 else block(21, one, one)
    return out


@pytest.mark.parametrize("edition", ["0.23", "0.26", "2.x"])
def test_the_edition_of_category_021_is_inferred_and_said(tmp_path: Path, edition: str) -> None:
    recording = read(write(tmp_path, traffic(edition)), date=DATE)
    assert recording.records == len(recording.fixes) == 80
    assert [s.edition for s in recording.sources] == [edition]
    assert any(f"edition {edition}, inferred" in w for w in recording.warnings)
    assert np.ptp(np.degrees(recording.fixes.latitude_rad)) == pytest.approx(0.059, abs=1e-4)


@pytest.mark.parametrize(("true", "given"), [("0.23", "2.4"), ("2.x", "0.23"), ("0.26", "2.x"), ("0.26", "0.23")])
def test_the_wrong_edition_is_an_error_that_names_the_right_one(tmp_path: Path, true: str, given: str) -> None:
    path = write(tmp_path, traffic(true))
    with pytest.raises(InputError, match=rf"021 are not of edition {given}.*they fit edition {true}.*--edition 021={true}"):
        read(path, editions={21: given}, date=DATE)


def test_the_edition_that_was_given_is_the_one_that_is_told(tmp_path: Path) -> None:
    recording = read(write(tmp_path, traffic("2.x")), editions={21: "2.4"}, date=DATE)
    assert [s.edition for s in recording.sources] == ["2.4"]
    assert not any("inferred" in w for w in recording.warnings)


def test_unknown_editions_and_categories_name_the_known_ones() -> None:
    with pytest.raises(SettingsError, match=r"'9\.9' of ASTERIX category 021 .*Known editions: .*0\.23"):
        DecodeState.begin(editions={21: "9.9"})
    with pytest.raises(SettingsError, match=r"category 247 cannot be read.*Known categories: 001, 002, 010, 019"):
        DecodeState.begin(editions={247: "1.2"})


def test_a_stream_waits_until_it_can_tell_the_edition() -> None:
    data = traffic("0.23")
    records, state, consumed = decode(data[:200], DecodeState.begin())
    assert (len(records.offset), consumed, dict(state.editions)) == (0, 0, {})
    records, state, consumed = decode(data, state)
    assert dict(state.editions) == {21: "0.23"}
    assert len(records.offset) > 70


# --------------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the file is empty"),
        (b"time,range,azimuth\n1,2,3\n" * 50, r"this is text \('time,range,azimuth' …\), not ASTERIX"),
        (bytes(5000), "nothing but zeros"),
        (b"\x15", "at least 2 bytes are missing"),
        (b"\x0a\x00\x03", "every block is empty"),
        (block(10, smr(1.0))[:12], "no ASTERIX record could be read"),
        (block(247, b"\x80\x01\x02") + block(252, b"\x80\x01\x02"), r"cannot be read \(247, 252\)"),
    ],
)
def test_a_file_of_which_nothing_can_be_read_is_one_clear_error(tmp_path: Path, data: bytes, message: str) -> None:
    path = write(tmp_path, data)
    with pytest.raises(InputError, match=message) as caught:
        read_asterix(path, date=DATE)
    assert caught.value.path == path
    assert caught.value.remedy


def test_random_bytes_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, np.random.default_rng(4).integers(0, 256, 200_000, dtype=np.uint8).tobytes())
    with pytest.raises(InputError, match="no ASTERIX record could be read"):
        read(path, date=DATE)


def test_a_file_that_is_not_there_or_a_folder_says_so(tmp_path: Path) -> None:
    for path, why in ((tmp_path / "none.ast", "cannot be read"), (tmp_path, "is a folder, not a recording")):
        with pytest.raises(InputError, match=why):
            read(path)
        with pytest.raises(InputError, match="cannot be read"):
            sha256_of(path)


def test_the_digest_of_a_file_is_its_sha_256(tmp_path: Path) -> None:
    assert sha256_of(write(tmp_path, b"abc")) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_truncated_file_keeps_all_but_the_last_record(tmp_path: Path) -> None:
    data = b"".join(block(10, smr(float(k))) for k in range(10))
    recording = read_asterix(write(tmp_path, data[:-5]), date=DATE)
    assert recording.records == 9
    (damage,) = recording.damaged
    assert damage.offset == 9 * len(data) // 10 + 3
    assert "runs over the end of its block" in damage.why


def test_a_damaged_record_costs_itself_only_and_its_place_is_told(tmp_path: Path) -> None:
    """The first record of a block is read, the second is broken, the next block is read."""
    good = smr(1.0)
    broken = b"\xff\xff\xff\xff\xff" + bytes(9)
    data = block(10, smr(0.5)) + block(10, good, broken) + block(10, smr(2.0))
    recording = read(write(tmp_path, data), date=DATE)
    np.testing.assert_array_equal(recording.plots.time_s - MIDNIGHT, [0.5, 1.0, 2.0])
    (damage,) = recording.damaged
    assert damage.offset == len(block(10, smr(0.5))) + 3 + len(good)
    assert "FSPEC" in damage.why
    assert recording.offset.tolist() == [3, len(block(10, smr(0.5))) + 3, len(data) - len(good)]


def test_a_record_without_a_source_is_damage(tmp_path: Path) -> None:
    data = block(10, smr(1.0)) + block(10, record(10, "1.1", {"000": b"\1", "140": tod(2.0)})) + block(10, smr(3.0))
    recording = read(write(tmp_path, data), date=DATE)
    assert recording.records == 2
    assert "item 010" in recording.damaged[0].why


@pytest.mark.parametrize("junk", [b"\x00" * 7, b"\x0a\x00\x02", b"\xde\xad\xbe\xef" * 9, b"\x0a\x00\xff\x80", b"\x0b\x01"])
def test_bytes_between_blocks_are_skipped_and_said(tmp_path: Path, junk: bytes) -> None:
    one = block(10, smr(1.0))
    recording = read(write(tmp_path, one * 3 + junk + one * 3), date=DATE)
    assert recording.records == 6
    assert len(recording.damaged) == 1
    assert len(one) * 3 <= recording.damaged[0].offset <= len(one) * 3 + len(junk)


def test_categories_that_cannot_be_read_are_passed_over_and_counted(tmp_path: Path) -> None:
    other = block(247, bytes(range(30)))
    recording = read(write(tmp_path, block(10, smr(1.0)) + other * 2 + block(10, smr(2.0)) + other), date=DATE)
    assert recording.records == 2
    assert not recording.damaged
    assert any(w.startswith("3 blocks of category 247 were passed over") for w in recording.warnings)


def test_blocks_of_several_unknown_categories_in_a_row_are_passed_over() -> None:
    other = block(23, b"\x80\x01\x02") + block(247, bytes(9)) + block(25, bytes(range(40)))
    records = whole((block(10, smr(1.0)) + other) * 5)
    assert len(records.offset) == 5
    assert records.unknown == {23: 5, 25: 5, 247: 5}
    assert not records.damaged


def test_garbage_without_end_does_not_hold_up_a_stream() -> None:
    garbage = np.random.default_rng(1).integers(0, 256, 400_000, dtype=np.uint8).tobytes()
    data = garbage + b"".join(block(10, smr(float(k))) for k in range(50))
    state = DecodeState.begin()
    _, state, consumed = decode(data[:300_000], state)
    assert consumed > 100_000
    records, _, _ = decode(data[consumed:], state, final=True)
    assert len(records.plots) >= 49


# ---------------------------------------------------------------------------------------------------------- streams, damage


def stream(seed: int, damage: bool) -> bytes:
    """A mixed stream: two radars, their service messages, ADS-B, blocks of several records; some blocks damaged."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(90):
        t = DAY - 20 + k * 0.5
        t = t % DAY
        choice = k % 5
        if choice == 0:
            one = block(10, smr(t), smr(t + 0.1 if t < 80000 else t), smr(t))
        elif choice == 1:
            one = block(48, radar(t, {"130": b"\x06\x0a\xfc", "250": b"\x02" + rng.bytes(16)}))
        elif choice == 2 and k % 2:
            one = block(34, record(34, "1.x", {"010": b"\x14\x81", "000": b"\2", "030": tod(t), "020": b"\x40"}))
        elif choice == 2:
            one = block(2, record(2, "1.x", {"010": b"\x19\xc9", "000": b"\2", "030": tod(t), "020": b"\x40"})) + block(
                1, old_plot(t), old_track(t + 0.25)
            )
        elif choice == 3:
            one = block(247, rng.bytes(12))
        else:
            one = block(21, adsb("0.23", t, {"040": b"\0\0", "130": position(41.3, 2.1), "080": rng.bytes(3)}))
        if damage and rng.random() < 0.25:
            one = mutated(rng, one, short=True)
        out.append(one)
    return b"".join(out)


def mutated(rng: np.random.Generator, one: bytes, short: bool) -> bytes:
    """A block with bits flipped, its length or category wrong, bytes put in, overwritten or (short) lost."""
    b = bytearray(one)
    kind = int(rng.integers(6 if short else 5))
    at = int(rng.integers(len(b)))
    if kind == 0:
        b[at] ^= int(rng.integers(1, 256))
    elif kind == 1:
        b[1 + at % 2] = int(rng.integers(256))
    elif kind == 2:
        b[0] = int(rng.integers(256))
    elif kind == 3:
        b[at:at] = rng.bytes(int(rng.integers(1, 20)))
    elif kind == 4:
        b[at : at + 8] = rng.bytes(len(b[at : at + 8]))
    else:
        del b[at:]
    return bytes(b)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 30), damage=st.booleans(), cuts=st.lists(st.integers(0, 6000), max_size=6))
def test_however_a_stream_is_cut_records_damage_and_state_are_the_same(seed: int, damage: bool, cuts: list[int]) -> None:
    data = stream(seed, damage)
    begin = DecodeState.begin(DATE, {21: "0.23"} if seed % 2 else None)
    once, end, _ = decode(data, begin, final=True)
    state, rest, done = begin, b"", 0
    parts: list[Records] = []
    for cut in [*sorted(c % (len(data) + 1) for c in cuts), len(data)]:
        rest, done = rest + data[done:cut], cut
        records, state, consumed = decode(rest, state)
        parts.append(records)
        rest = rest[consumed:]
    records, state, _ = decode(rest, state, final=True)
    parts.append(records)
    same_tables(Plots.concat([p.plots for p in parts]), once.plots)
    same_tables(Fixes.concat([p.fixes for p in parts]), once.fixes)
    same_tables(Marks.concat([p.marks for p in parts]), once.marks)
    for name in ("offset", "length", "category", "source", "time_s", "digest"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(once, name))
    assert tuple(d for p in parts for d in p.damaged) == once.damaged
    assert state == end


def test_the_stream_of_the_split_test_holds_what_it_should() -> None:
    """Else the property above would be empty: records of all categories, and damage in the damaged form."""
    clean, damaged = whole(stream(1, False), date=DATE), whole(stream(1, True), date=DATE)
    assert set(clean.category.tolist()) == {1, 2, 10, 21, 34, 48}
    assert clean.unknown == {247: 18}
    assert not clean.damaged
    assert len(damaged.damaged) >= 5
    assert np.ptp(clean.time_s) < 60


def blocks_of(data: bytes) -> list[bytes]:
    out, at = [], 0
    while at < len(data):
        end = at + int.from_bytes(data[at + 1 : at + 3], "big")
        out.append(data[at:end])
        at = end
    return out


def made_pool(rng: np.random.Generator, n: int = 1200) -> list[bytes]:
    """Blocks of the older radars and of trackers: categories 001, 002, 034, 062, 063, 065, with many items each."""
    out = []
    for k in range(n):
        t = 3600.0 + k * 0.1
        if k % 6 < 2:
            more = {"070": rng.bytes(2), "090": rng.bytes(2), "131": rng.bytes(1)}
            out.append(block(1, *(old_plot(t, more) if j % 2 else old_track(t, more) for j in range(1 + k % 3))))
        elif k % 6 == 2:
            out.append(
                block(
                    2,
                    record(2, "1.x", {"010": b"\x19\xc9", "000": b"\2", "030": tod(t), "020": rng.bytes(1), "041": rng.bytes(2)}),
                )
            )
        elif k % 6 == 3:
            out.append(
                block(
                    63,
                    record(63, "1.x", {"010": b"\x19\x64", "030": tod(t), "050": b"\x19\xc9", "060": b"\0", "081": rng.bytes(2)}),
                )
            )
        elif k % 6 == 4:
            out.append(
                block(65, record(65, "1.x", {"010": b"\x19\x64", "000": b"\2", "015": b"\1", "030": tod(t), "020": rng.bytes(1)}))
            )
        else:
            track = {
                "010": b"\x19\x64", "070": tod(t), "105": rng.bytes(8), "185": rng.bytes(4), "380": b"\xc0" + rng.bytes(9),
                "040": rng.bytes(2), "080": b"\0", "290": b"\x60" + rng.bytes(2), "136": rng.bytes(2),
                "500": b"\x80" + rng.bytes(4),
            }  # fmt: skip
            out.append(block(62, record(62, "1.x", track), record(62, "1.x", track | {"220": rng.bytes(2)})))
    return out


@pytest.mark.real
@pytest.mark.parametrize(
    "name",
    [
        "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast",
        "lebl-2016/smr_cat010_160510-lebl-220001.ast",
        "lebl-2016/mlat_cat020_160510-lebl-220001.ast",
        "lebl-2016/adsb_cat021v023_160510-lebl-220001.ast",
        "made",
    ],
)
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_every_undamaged_block_is_read_between_damaged_ones(data: Path, name: str, seed: int) -> None:
    """Every fifth of 1,000 blocks mutated: 4,000 mutations in all.

    Blocks that lost bytes are apart: where what is left of one happens to make a valid record of the length that it claims with
    the bytes of the next block, nothing can tell; that is rare, and the block after next is read again.
    """
    rng = np.random.default_rng(seed)
    pool = made_pool(rng) if name == "made" else blocks_of((data / name).read_bytes())
    first = int(rng.integers(len(pool) - 1000))
    for short in (False, True):
        out, good, at, hurt = [], set(), 0, 0
        for k, one in enumerate(pool[first : first + 1000]):
            if k % 5 == 2:
                one = mutated(rng, one, short)
                hurt += 1
            else:
                good.add((at + 3, at + len(one)))
            out.append(one)
            at += len(one)
        records = whole(b"".join(out), editions={21: "0.23", 62: "1.x"})
        ends = set(zip((records.offset).tolist(), (records.offset + records.length).tolist(), strict=True))
        starts, stops = {a for a, _ in ends}, {b for _, b in ends}
        missed = [g for g in good if g[0] not in starts or g[1] not in stops]
        assert hurt == 200
        assert len(missed) <= (2 if short else 0)


# --------------------------------------------------------------------------------------------------------- real recordings


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "category", "records", "plots", "fixes", "targets", "edition"),
    [
        ("lebl-2016/smr_cat010_160510-lebl-220001.ast", 10, 77345, 62097, 62097, None, "1.1"),
        ("lebl-2016/mlat_cat010_160510-lebl-220001.ast", 10, 84453, 0, 69920, 37, "1.1"),
        ("lebl-2016/mlat_cat020_160510-lebl-220001.ast", 20, 69933, 0, 69933, 37, "1.x"),
        ("lebl-2016/adsb_cat021v023_160510-lebl-220001.ast", 21, 49330, 0, 49330, 47, "0.23"),
        ("bcn-2023/230502-est-080001_BCN_60MN_08_09.ast", 48, 44085, 44085, 0, 177, "1.x"),
    ],
)
def test_the_recordings_hold_what_is_known_of_them(
    data: Path, name: str, category: int, records: int, plots: int, fixes: int, targets: int | None, edition: str
) -> None:
    date = datetime.date(2023, 5, 2) if "bcn" in name else DATE
    recording = read(data / name, date=date)
    assert recording.by_category[category] == records
    assert (len(recording.plots), len(recording.fixes)) == (plots, fixes)
    assert not recording.damaged
    source = next(s for s in recording.sources if s.category == category)
    assert (source.records, source.plots, source.edition) == (records, plots, edition)
    assert targets is None or source.targets == targets
    start = datetime.datetime.fromtimestamp(source.start_s, datetime.UTC)
    end = datetime.datetime.fromtimestamp(source.end_s, datetime.UTC)
    if "bcn" in name:
        assert (start.isoformat()[:16], end.isoformat()[:16]) == ("2023-05-02T08:00", "2023-05-02T09:00")
    else:
        assert (start.isoformat()[:16], end.isoformat()[:16]) == ("2016-05-10T22:00", "2016-05-11T00:01")
    assert np.array_equal(np.sort(recording.offset), recording.offset)


@pytest.mark.real
def test_the_multilateration_tells_its_reference_point_and_both_categories_agree(data: Path) -> None:
    ten = read(data / "lebl-2016/mlat_cat010_160510-lebl-220001.ast", date=DATE)
    twenty = read(data / "lebl-2016/mlat_cat020_160510-lebl-220001.ast", date=DATE)
    for source in twenty.sources:
        assert math.degrees(source.latitude_rad) == pytest.approx(41.297079, abs=1e-5)
        assert math.degrees(source.longitude_rad) == pytest.approx(2.078463, abs=1e-5)
        assert source.height_m == 51.0
    # The same targets in two formats: same stamps and, within half a metre and a metre of rounding, the same places.
    a, b = ten.fixes, twenty.fixes
    order_a, order_b = np.lexsort((a.mode_s, a.time_s)), np.lexsort((b.mode_s, b.time_s))
    key_a, key_b = (a.time_s * 128).astype(np.int64) << 24 | a.mode_s, (b.time_s * 128).astype(np.int64) << 24 | b.mode_s
    common, i, j = np.intersect1d(key_a[order_a], key_b[order_b], return_indices=True)
    assert len(common) > 0.95 * len(a)
    near = np.hypot(a.x_m[order_a][i] - b.x_m[order_b][j], a.y_m[order_a][i] - b.y_m[order_b][j])
    assert np.quantile(near, 0.99) <= 1.5


@pytest.mark.real
def test_the_edition_of_the_real_ads_b_recording_is_found_and_the_wrong_one_refused(data: Path) -> None:
    path = data / "lebl-2016/adsb_cat021v023_160510-lebl-220001.ast"
    fixes = read_asterix(path, editions={21: "0.23"}, date=DATE).fixes
    assert np.median(np.degrees(fixes.latitude_rad)) == pytest.approx(41.29, abs=0.05)
    assert np.count_nonzero(fixes.flags & Flag.GROUND) == 20039
    with pytest.raises(InputError, match=r"not of edition 2\.6.*they fit edition 0\.23"):
        read_asterix(path, editions={21: "2.6"}, date=DATE)


@pytest.mark.real
def test_the_radar_of_barcelona_has_the_known_difference_of_its_two_chains(data: Path) -> None:
    """METHODS section 7: PSR - SSR +192 m, sd 59 m, +0.019 degrees, n = 28,945."""
    plots = read(data / "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast").plots
    known = np.isfinite(plots.psr_ssr_range_m)
    assert np.count_nonzero(known) == pytest.approx(28945, abs=10)
    assert np.mean(plots.psr_ssr_range_m[known]) == pytest.approx(192, abs=1)
    assert np.std(plots.psr_ssr_range_m[known]) == pytest.approx(59, abs=1)
    assert np.degrees(np.mean(plots.psr_ssr_azimuth_rad[known])) == pytest.approx(0.019, abs=0.001)
