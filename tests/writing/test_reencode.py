"""Recordings written again: libasterix reads them, what is corrected is right, and all else is byte for byte as it was."""

from __future__ import annotations

import datetime
import struct
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import asterix.base as base
import asterix.generated as generated
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import InputError
from boresight.model import Plots
from boresight.reading import uap
from boresight.reading.asterix import decode_items
from boresight.writing.reencode import Original, Reencoded, open_original, reencode

DATE = datetime.date(2016, 5, 10)
MIDNIGHT = 1462838400.0
DAY = 86400.0
NM = 1852.0
# What a field is worth (m, deg), by category: range, and x and y.
RANGE_M = {1: NM / 128, 10: 1.0, 48: NM / 256}
PLANE_M = {1: NM / 64, 10: 1.0, 48: NM / 128}
TURN = 65536 / 360
MEASURED = {"040", "042", "140", "141"}


# ------------------------------------------------------------------------------------------------------------ making records


def record(form: int, items: dict[str, bytes]) -> bytes:
    """One record: its FSPEC and items, from the standard's order of items (256: a track of category 001)."""
    order = [i.name if i is not None else None for i in uap.items_of(form, uap.default_edition(form & 255 or 1))]
    bits = [name in items for name in order]
    assert sum(bits) == len(items)
    octets = [bits[k : k + 7] for k in range(0, len(bits), 7)]
    while not any(octets[-1]):
        octets.pop()
    fspec = bytes(sum(0x80 >> j for j, bit in enumerate(octet) if bit) | (k + 1 < len(octets)) for k, octet in enumerate(octets))
    return fspec + b"".join(items[name] for name in order if name in items)


def block(category: int, *records: bytes) -> bytes:
    body = b"".join(records)
    return bytes([category]) + (len(body) + 3).to_bytes(2, "big") + body


def tod(seconds: float) -> bytes:
    return round(seconds % DAY * 128).to_bytes(3, "big")


def plot(form: int, seconds: float, rho: int, theta: int, more: dict[str, bytes] | None = None) -> bytes:
    category = {256: 1}.get(form, form)
    own = {
        1: {"010": b"\x19\xc9", "020": b"\x30", "141": tod(seconds)[1:]},
        256: {"010": b"\x19\xc9", "020": b"\xb0", "141": tod(seconds)[1:], "161": b"\1\x23"},
        10: {"010": b"\0\7", "000": b"\1", "020": b"\x60", "140": tod(seconds)},
        48: {"010": b"\x14\x81", "140": tod(seconds), "020": b"\xa0"},
    }[form]
    assert category in RANGE_M
    return record(form, own | {"040": struct.pack(">HH", rho, theta)} | (more or {}))


def plane(form: int, rho: int, theta: int, east: int = 0, north: int = 0) -> bytes:
    """The Cartesian item of a polar position, moved by some codes."""
    category = {256: 1}.get(form, form)
    r, a = rho * RANGE_M[category], theta / TURN * np.pi / 180
    return struct.pack(">hh", round(r * np.sin(a) / PLANE_M[category]) + east, round(r * np.cos(a) / PLANE_M[category]) + north)


def mark(seconds: float) -> bytes:
    return block(34, record(34, {"010": b"\x14\x81", "000": b"\2", "030": tod(seconds), "020": b"\x40"}))


def full(seconds: float) -> bytes:
    """The full time of day of the radar whose plots tell it cut."""
    return block(2, record(2, {"010": b"\x19\xc9", "000": b"\1", "030": tod(seconds)}))


def recording(seed: int = 0, n: int = 300, start: float = DAY - 60.0) -> bytes:
    """A mixed file that crosses midnight: plots of three categories with and without other items, marks, a foreign block."""
    rng = np.random.default_rng(seed)
    out = [full(start)]
    for k in range(n):
        t = start + k * 0.5
        form = int(rng.choice([1, 256, 10, 48]))
        rho, theta = int(rng.integers(2000, 30000)), int(rng.integers(0, 65536))
        more: dict[str, bytes] = {}
        if form == 48:
            if rng.random() < 0.5:
                more["130"] = b"\x86" + bytes(rng.integers(0, 256, 3).tolist())
            more |= {"161": k.to_bytes(2, "big"), "220": bytes(rng.integers(0, 256, 3).tolist())}
            more |= {"250": b"\2" + bytes(rng.integers(0, 256, 16).tolist())} if rng.random() < 0.3 else {}
        if form == 10:
            more |= {"270": b"\x43\x61\x0a"} if rng.random() < 0.5 else {}
        if form != 1 and rng.random() < 0.7:
            away = int(rng.choice([0, 0, 40]))
            more["042"] = plane(form, rho, theta, away, -away)
        here = [plot(form, t, rho, theta, more)]
        if form in (10, 48):
            here.append(plot(form, t + 0.125, rho + 3, theta))
        out.append(block({256: 1}.get(form, form), *here))
        if k % 10 == 5:
            out.append(mark(t))
        if k % 20 == 7:
            out.append(full(t))
        if k % 50 == 9:
            out.append(block(221, b"\1\2\3\4\5"))
    return b"".join(out)


def write(folder: Path, data: bytes, name: str = "some.ast") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def shifted(plots: Plots, late_s: float = 0.31, far_m: float = 23.4, turned_deg: float = 0.123) -> Plots:
    """The plots without these errors, which are no whole number of codes."""
    return plots.replace(
        time_s=plots.time_s - late_s,
        range_m=plots.range_m * 0.9995 - far_m,
        azimuth_rad=np.mod(plots.azimuth_rad - np.radians(turned_deg) * (1 + 0.3 * np.cos(plots.azimuth_rad)), 2 * np.pi),
    )


def done(folder: Path, data: bytes, change: Any = shifted, name: str = "some.ast") -> tuple[Original, Plots, Reencoded, bytes]:
    """The recording, its corrected plots, what was done, and the new bytes."""
    original = open_original(write(folder, data, name), date=DATE)
    corrected = change(original.plots)
    result = reencode(original, corrected, folder / f"new-{name}")
    return original, corrected, result, (folder / f"new-{name}").read_bytes()


# ----------------------------------------------------------------------------------------------------------------- libasterix


@cache
def newest(category: int) -> Any:
    return generated.manifest["CATS"][category][-1].cv_uap


def their_records(data: bytes) -> list[tuple[int, dict[str, bytes]]]:
    """Every record that libasterix finds: its category and the bytes of its items; a byte too many or too few is an error."""
    out: list[tuple[int, dict[str, bytes]]] = []
    at = 0
    while at < len(data):
        # One by one: libasterix takes many blocks by recursion.
        end = at + int.from_bytes(data[at + 1 : at + 3], "big")
        blocks = base.RawDatablock.parse(base.Bits.from_bytes(data[at:end]))
        assert not isinstance(blocks, ValueError), blocks
        category, bits = blocks[0].get_category(), blocks[0].get_raw_records()
        at = end
        if category not in (1, 2, 10, 34, 48):
            out.append((category, {"": bits.to_bytes()}))
            continue
        found = newest(category)
        if not issubclass(found, base.UapMultiple):
            records = found.parse(bits)
            assert not isinstance(records, ValueError), records
        else:
            records = []
            while len(bits):
                for name, kind in found.cv_uaps.items():
                    parsed = kind._parse(base.ParsingMode.StrictParsing, bits)
                    first = None if isinstance(parsed, ValueError) else parsed[0].items_regular["020"].unparse().to_bytes()[0]
                    if first is not None and (first >> 7 == 1) == (name == "track"):
                        break
                records.append(parsed[0])
                bits = parsed[1]
        out += [(category, {name: i.unparse().to_bytes() for name, i in r.items_regular.items()}) for r in records]
    return out


def check_against_libasterix(original: Original, corrected: Plots, before: bytes, after: bytes, left: set[int]) -> Counter[str]:
    """Every record: the measured items are those of `corrected` to a code, all other items have the same bytes.

    `left` are rows of plots that must be as they were.  Returns how many items of each name were compared.
    """
    old, new = their_records(before), their_records(after)
    assert len(old) == len(new)
    row = -1
    seen: Counter[str] = Counter()
    for (category, had), (same, has) in zip(old, new, strict=True):
        assert category == same
        assert list(had) == list(has)
        is_plot = category in RANGE_M and "040" in had
        row += is_plot
        for name in had:
            seen[name] += 1
            if not is_plot or row in left or name not in MEASURED:
                assert had[name] == has[name], (category, name)
        if not is_plot or row in left:
            continue
        rho, theta = struct.unpack(">HH", has["040"])
        assert abs(rho * RANGE_M[category] - corrected.range_m[row]) < 1.0001 * RANGE_M[category]
        assert abs((theta - np.degrees(corrected.azimuth_rad[row]) * TURN + 32768) % 65536 - 32768) < 1.001
        clock = "141" if category == 1 else "140"
        ticks = int.from_bytes(has[clock], "big") / 128
        period = 512.0 if category == 1 else DAY
        assert abs((ticks - corrected.time_s[row] % DAY + period / 2) % period - period / 2) < 1.001 / 128
        if "042" in had:
            x, y = struct.unpack(">hh", had["042"])
            u, v = struct.unpack(">hh", has["042"])
            lsb = PLANE_M[category]
            places = [
                p.range_m[row] * np.array([np.sin(p.azimuth_rad[row]), np.cos(p.azimuth_rad[row])]) / lsb
                for p in (original.plots, corrected)
            ]
            # From the corrected polar position, or moved as far as that was.
            on = np.abs(np.array([x, y]) - places[0]).max() <= 1
            goal = places[1] if on else np.array([x, y]) + places[1] - places[0]
            assert np.abs(np.array([u, v]) - goal).max() < (0.5001 if on else 1.001)
    assert row + 1 == len(original.plots)
    return seen


# --------------------------------------------------------------------------------------------------------------------- tests


@pytest.mark.parametrize("seed", range(3))
def test_libasterix_reads_what_is_written_and_all_else_is_as_it_was(tmp_path: Path, seed: int) -> None:
    data = recording(seed)
    original, corrected, result, new = done(tmp_path, data)
    assert len(new) == len(data)
    assert set(original.category.tolist()) == {1, 10, 48}
    seen = check_against_libasterix(original, corrected, data, new, set())
    assert min(seen[name] for name in ("040", "042", "130", "140", "141", "161", "220", "250", "270")) > 10
    # What is not within the measured items has not changed by a byte: blocks, other categories, what no table describes.
    allowed = np.zeros(len(data), bool)
    for r in decode_items(data):
        at = r.offset + 1
        for name, raw in r.items.items():
            if "/" not in name and name in MEASURED and r.category in RANGE_M:
                place = data.index(raw, at, r.offset + 60)
                allowed[place : place + len(raw)] = True
    changed = np.frombuffer(data, np.uint8) != np.frombuffer(new, np.uint8)
    assert not (changed & ~allowed).any()
    assert result.changed == result.plots == len(original.plots)
    assert result.records == original.records
    assert sum(result.left.values()) == original.records - len(original.plots)
    assert any("not the polar one" in note for note in result.notes)
    # The same file gives the same file.
    reencode(original, corrected, tmp_path / "again.ast")
    assert (tmp_path / "again.ast").read_bytes() == new
    # And it reads back as what was asked for, midnight and all.
    back = open_original(tmp_path / "new-some.ast", date=DATE).plots
    assert np.abs(back.time_s - corrected.time_s).max() < 1.001 / 128
    assert corrected.time_s.min() < MIDNIGHT + DAY < corrected.time_s.max()


def test_rounding_keeps_the_mean_and_is_reported_as_it_is(tmp_path: Path) -> None:
    """Errors of a third of a code: rounding to the nearest would leave them whole."""
    rng = np.random.default_rng(1)
    n = 4000
    records = [
        plot(48, 3600 + k * 0.25, int(rng.integers(5000, 20000)), int(rng.integers(0, 65536)), {"161": k.to_bytes(2, "big")})
        for k in range(n)
    ]
    data = b"".join(block(48, one) for one in records)

    def change(p: Plots) -> Plots:
        return p.replace(
            time_s=p.time_s - 0.3 / 128, range_m=p.range_m - 0.3 * NM / 256, azimuth_rad=p.azimuth_rad - 0.3 * 2 * np.pi / 65536
        )

    _, corrected, result, _ = done(tmp_path, data, change)
    back = open_original(tmp_path / "new-some.ast", date=DATE).plots
    off = {
        "I048/140": (back.time_s - corrected.time_s) * 128,
        "I048/040 RHO": (back.range_m - corrected.range_m) / NM * 256,
        "I048/040 THETA": ((back.azimuth_rad - corrected.azimuth_rad + np.pi) % (2 * np.pi) - np.pi) / (2 * np.pi) * 65536,
    }
    assert {r.item for r in result.rounding} == set(off)
    for one in result.rounding:
        # sd of a mean of n draws of 0.7 or -0.3 with the odds that make it 0: 0.46 / sqrt(n).
        assert abs(off[one.item].mean()) < 4 * 0.46 / np.sqrt(n), one.item
        assert np.isclose(one.rms / one.lsb, np.sqrt(np.mean(off[one.item] ** 2)), rtol=1e-3)
        assert np.isclose(one.rms / one.lsb, np.sqrt(0.3 * 0.7), rtol=0.05)
        assert one.count == n
    # What is drawn for one item tells nothing of what is drawn for another.
    correlation = np.corrcoef(np.array(list(off.values())))
    assert np.abs(correlation - np.eye(3)).max() < 0.07
    # Stamps that were in order are in order.
    assert (np.diff(back.time_s) >= 0).all()


def test_duplicated_records_stay_duplicates_and_what_does_not_change_keeps_its_code(tmp_path: Path) -> None:
    once = b"".join(block(48, plot(48, 100.0 + k, 9000 + 7 * k, 1000 * k % 65536)) for k in range(50))
    _, _, _, new = done(tmp_path, once + once)
    assert new[: len(once)] == new[len(once) :]
    # Only the azimuth: the range and the time have the codes that they had, although floats do not carry them exactly.
    original, _, _, new = done(tmp_path, once, lambda p: p.replace(azimuth_rad=np.mod(p.azimuth_rad + 0.01 - 1e-13, 2 * np.pi)))
    for (_, had), (_, has) in zip(their_records(once), their_records(new), strict=True):
        assert had["140"] == has["140"]
        assert had["040"][:2] == has["040"][:2]
        assert had["040"][2:] != has["040"][2:]
    # Nothing to change: the same bytes.
    result = reencode(original, original.plots, tmp_path / "same.ast")
    assert (tmp_path / "same.ast").read_bytes() == once
    assert result.changed == 0
    assert sum(result.left.values()) == 50
    assert result.rounding == ()


def test_what_items_cannot_hold_is_left_as_a_whole_and_counted(tmp_path: Path) -> None:
    cases = [
        plot(48, 10.0, 5, 0),  # gets a negative range
        plot(48, 11.0, 65534, 0),  # beyond 256 NM
        plot(48, 12.0, 65535, 0),  # stands for all that is beyond
        plot(10, 13.0, 30000, 16384, {"042": struct.pack(">hh", 32760, 0)}),  # x beyond 32,767 m
        plot(10, 14.0, 30000, 16384, {"042": struct.pack(">hh", 32767, 0)}),  # x was beyond already: the rest is corrected
        plot(48, 15.0, 9000, 0),  # no finite value
        plot(48, 16.0, 9000, 0),
        plot(48, 17.0, 9000, 0),
    ]
    data = b"".join(block(10 if k in (3, 4) else 48, one) for k, one in enumerate(cases))
    move = np.array([-100.0, 20.0, -20.0, 50.0, 50.0, np.nan, 0.0, 40.0])

    original, corrected, result, new = done(
        tmp_path, data, lambda p: p.replace(range_m=p.range_m + move, time_s=p.time_s - 0.5 * (move != 0))
    )
    assert result.left == {
        "get a negative range": 1,
        "get a position beyond what their items can hold": 3,
        "have no finite position or correction": 1,
        "have nothing to correct: the calibration is not of their radar or channel": 1,
    }
    assert result.changed == 2
    assert any("at the end of its range" in note and note.startswith("1 ") for note in result.notes)
    old, fresh = their_records(data), their_records(new)
    for k in (0, 1, 2, 3, 5, 6):
        assert old[k] == fresh[k], k
    assert fresh[4][1]["042"] == old[4][1]["042"]
    assert abs(struct.unpack(">H", fresh[4][1]["040"][:2])[0] - 30050) <= 1
    assert fresh[7][1] != old[7][1]
    assert original.records == 8
    assert len(corrected) == 8


def test_times_wrap_at_midnight_and_a_cut_time_with_them(tmp_path: Path) -> None:
    """Half a second after midnight, 0.75 s late: 23:59:59.75, of which category 001 keeps the rest by 512 s."""
    data = full(0.25) + block(1, plot(1, 0.5, 3000, 0)) + block(48, plot(48, 0.5, 3000, 0))
    _, _, result, new = done(tmp_path, data, lambda p: p.replace(time_s=p.time_s - 0.75))
    records = their_records(new)
    assert "the first plot is of 2016-05-09 now" in result.notes[-1]
    assert records[1][1]["141"] == round((DAY - 0.25) * 128).to_bytes(3, "big")[1:]
    assert records[2][1]["140"] == round((DAY - 0.25) * 128).to_bytes(3, "big")
    # And a radar that was early, from the last half second of a day into the next.
    data = full(DAY - 1) + block(1, plot(256, DAY - 0.5, 3000, 0)) + block(48, plot(48, DAY - 0.5, 3000, 0))
    _, _, _, new = done(tmp_path, data, lambda p: p.replace(time_s=p.time_s + 0.75))
    records = their_records(new)
    assert records[1][1]["141"] == b"\0\x20"
    assert records[2][1]["140"] == b"\0\0\x20"
    # A time that nothing completes is left; the position is corrected all the same.
    data = block(1, plot(1, 5.0, 3000, 0))
    _, _, result, new = done(tmp_path, data, lambda p: p.replace(time_s=p.time_s - 0.75, range_m=p.range_m + 10 * RANGE_M[1]))
    ((_, items),) = their_records(new)
    assert items["141"] == tod(5.0)[1:]
    assert items["040"] == struct.pack(">HH", 3010, 0)
    assert result.notes == ("1 records have no known time; only their position was corrected",)


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_damage_is_left_as_it_is_and_costs_itself_only(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Bytes that were destroyed anywhere: nothing outside records that can be read changes, and nothing fails."""
    rng = np.random.default_rng(seed)
    data = bytearray(recording(seed % 7, 60))
    hit = []
    for _ in range(int(rng.integers(1, 6))):
        # Not the first blocks: by them a file is known as ASTERIX at all.
        at = int(rng.integers(100, len(data)))
        data[at : at + int(rng.integers(1, 9))] = bytes(rng.integers(0, 256, 4).tolist())
        hit.append(at)
    folder = tmp_path_factory.mktemp("damage")
    original, _, result, new = done(folder, bytes(data))
    assert len(new) == len(data)
    changed = np.frombuffer(bytes(data), np.uint8) != np.frombuffer(new, np.uint8)
    inside = np.zeros(len(data), bool)
    for offset, length in zip(original.offset.tolist(), original.length.tolist(), strict=True):
        inside[offset : offset + length] = True
    assert not (changed & ~inside).any()
    assert result.changed + sum(result.left.values()) == original.records
    back = open_original(folder / "new-some.ast", date=DATE)
    # Where blocks begin amid damage is judged by their stamps too, which a correction moves: away from it nothing changes.
    apart = np.abs(original.offset[:, None] - np.array(hit)).min(axis=1)
    away = original.offset[apart > 150]
    assert np.isin(away, back.offset).all()
    assert abs(back.records - original.records) <= 2 * len(hit)


def test_the_recording_itself_is_never_written_to_and_rows_must_fit(tmp_path: Path) -> None:
    data = recording(1, 20)
    original = open_original(write(tmp_path, data), date=DATE)
    with pytest.raises(InputError, match="never written to"):
        reencode(original, shifted(original.plots), tmp_path / "some.ast")
    with pytest.raises(InputError, match="do not fit"):
        reencode(original, original.plots[1:], tmp_path / "out.ast")
    with pytest.raises(InputError, match="does not exist"):
        reencode(original, shifted(original.plots), tmp_path / "nowhere" / "out.ast")
    assert (tmp_path / "some.ast").read_bytes() == data
    assert [p.name for p in tmp_path.iterdir()] == ["some.ast"]


# ---------------------------------------------------------------------------------------------------------------- containers


def checksum(source: bytes, target: bytes, udp: bytes) -> int:
    """The UDP checksum of RFC 768, from the datagram with a checksum of zero."""
    data = source + target + (b"\0\x11" if len(source) == 4 else b"\0\0\0\0\0\0\0\x11") + len(udp).to_bytes(2, "big") + udp
    if len(source) == 16:
        data = source + target + len(udp).to_bytes(4, "big") + b"\0\0\0\x11" + udp
    total = sum(struct.unpack(f">{len(data + bytes(len(data) % 2)) // 2}H", data + bytes(len(data) % 2)))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return (~total & 0xFFFF) or 0xFFFF


ENDS4 = b"\x0a\0\0\1", b"\xe0\0\0\2"
ENDS6 = b"\xfe\x80" + bytes(13) + b"\1", b"\xff\2" + bytes(13) + b"\1"


def udp(payload: bytes, ends: tuple[bytes, bytes], summed: bool = True) -> bytes:
    head = struct.pack(">HHHH", 30000, 8600, len(payload) + 8, 0)
    check = checksum(*ends, head + payload) if summed else 0
    return head[:6] + check.to_bytes(2, "big") + payload


def ip4(body: bytes, number: int = 1, part: int = 0) -> bytes:
    return struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), number, part, 9, 17, 0, *ENDS4) + body


def ip6(body: bytes) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), 17, 9) + ENDS6[0] + ENDS6[1] + body


def ethernet(packet: bytes) -> bytes:
    return bytes(12) + (b"\x08\0" if packet[0] >> 4 == 4 else b"\x86\xdd") + packet


def pcap(frames: list[bytes]) -> bytes:
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, 1)
    for k, frame in enumerate(frames):
        out += struct.pack("<IIII", int(MIDNIGHT) + 3600 + k, 0, len(frame), len(frame)) + frame
    return out


def messages(n: int = 30) -> list[bytes]:
    out = []
    for k in range(n):
        # Of odd and even length, with records at odd and even places.
        extra = {"161": k.to_bytes(2, "big")} | ({"170": b"\x40"} if k % 2 else {})
        out.append(
            mark(3600.0 + k)
            + block(48, plot(48, 3600.0 + k, 9000 + k, 2000 * k, extra), plot(48, 3600.5 + k, 8000, 3000, {"042": b"\0\1\0\2"}))
        )
    return out


def test_a_capture_stays_a_capture_and_its_checksums_are_right(tmp_path: Path) -> None:
    frames = [
        ethernet(ip4(udp(m, ENDS4, k % 3 != 0))) if k % 2 else ethernet(ip6(udp(m, ENDS6))) for k, m in enumerate(messages())
    ]
    data = pcap(frames)
    original, corrected, result, new = done(tmp_path, data, name="some.pcap")
    assert (result.kind, result.changed, result.records) == ("pcap", 60, 90)
    assert len(new) == len(data)
    place = 24
    for k, frame in enumerate(frames):
        place += 16
        fresh = new[place : place + len(frame)]
        place += len(frame)
        head = 14 + (20 if k % 2 else 40)
        assert fresh[: head + 6] == frame[: head + 6]
        told = int.from_bytes(fresh[head + 6 : head + 8], "big")
        if k % 2 and k % 3 == 0:
            assert told == 0
        else:
            bare = fresh[head : head + 6] + b"\0\0" + fresh[head + 8 :]
            assert told == checksum(*(ENDS4 if k % 2 else ENDS6), bare)
        assert fresh[head + 8 :] != frame[head + 8 :]
    back = open_original(tmp_path / "new-some.pcap").plots
    assert np.abs(back.range_m - corrected.range_m).max() < NM / 256
    assert np.array_equal(back.track, original.plots.track)


def test_records_in_datagrams_that_came_in_pieces_are_corrected_where_they_are_whole(tmp_path: Path) -> None:
    """The first record of each lies in the first piece; the second one runs over its end and is left."""
    message = block(48, plot(48, 3600.0, 9000, 2000), plot(48, 3600.0, 9100, 2000))
    first = len(plot(48, 3600.0, 9000, 2000))
    cut = (8 + 3 + first + 7) // 8 * 8
    body = udp(message, ENDS4)
    assert cut < len(body)
    data = pcap([ethernet(ip4(body[:cut], 5, 0x2000)), ethernet(ip4(body[cut:], 5, cut // 8))])
    _, _, result, new = done(tmp_path, data, lambda p: p.replace(range_m=p.range_m - 700.0), name="pieces.pcap")
    assert result.changed == 1
    assert result.left == {"lie in datagrams that were sent in pieces": 1}
    at = 24 + 16 + 14 + 20
    second = at + cut + 16 + 14 + 20
    fresh = new[at : at + cut] + new[second:]
    assert int.from_bytes(fresh[6:8], "big") == checksum(*ENDS4, fresh[:6] + b"\0\0" + fresh[8:])
    # Beside the record and the checksum nothing changed.
    changed = [k for k in range(len(data)) if data[k] != new[k]]
    assert set(changed) <= {at + 6, at + 7, *range(at + 11, at + 11 + first)}


def final_format() -> bytes:
    return b"".join(
        (len(m) + 12).to_bytes(2, "big") + bytes(3) + (360000 + k * 100).to_bytes(3, "big") + m + b"\xa5" * 4
        for k, m in enumerate(messages())
    )


def gps_stamped() -> bytes:
    out = b"\xcd" * 2200
    for k, m in enumerate(messages()):
        at = 0
        while at < len(m):
            size = int.from_bytes(m[at + 1 : at + 3], "big")
            out += m[at : at + size] + b"\x11\xd2\x8f\x0a\0\0" + tod(3600.0 + k) + b"\0"
            at += size
    return out


@pytest.mark.parametrize(("kind", "make"), [("final", final_format), ("gps", gps_stamped)])
def test_recorders_files_keep_their_own_bytes(tmp_path: Path, kind: str, make: Any) -> None:
    data = make()
    original, corrected, result, new = done(tmp_path, data)
    assert (result.kind, result.changed) == (kind, 60)
    inside = np.zeros(len(data), bool)
    for offset, length in zip(original.offset.tolist(), original.length.tolist(), strict=True):
        inside[offset : offset + length] = True
    changed = np.frombuffer(data, np.uint8) != np.frombuffer(new, np.uint8)
    assert not (changed & ~inside).any()
    back = open_original(tmp_path / "new-some.ast", date=DATE).plots
    assert np.abs(back.range_m - corrected.range_m).max() < NM / 256


# ------------------------------------------------------------------------------------------------------------ real recordings


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "checked"),
    [
        ("lebl-2016/smr_cat010_160510-lebl-220001.ast", 1500),
        ("bcn-2023/230502-est-080001_BCN_60MN_08_09.ast", 1500),
        ("croatia/cat_001_002.pcap", 0),
        ("croatia/cat_034_048.pcap", 0),
        ("croatia/parsegps.gps", 0),
    ],
)
def test_real_recordings_come_back_with_only_their_measured_items_changed(
    data: Path, tmp_path: Path, name: str, checked: int
) -> None:
    """Item by item for all records; the first blocks of raw files by libasterix too (all of them in the slow form)."""
    path = data / name
    original = open_original(path)
    corrected = shifted(original.plots, far_m=2.3)
    result = reencode(original, corrected, tmp_path / path.name)
    before, after = path.read_bytes(), (tmp_path / path.name).read_bytes()
    back = open_original(tmp_path / path.name)
    assert np.array_equal(back.offset, original.offset)
    assert result.changed >= 0.99 * len(original.plots) > 0
    close = np.abs(back.plots.range_m - corrected.range_m) < 1.001 * NM / 128
    assert np.count_nonzero(~close) <= len(close) - result.changed
    if checked:
        ours = zip(decode_items(before), decode_items(after), strict=True)
        for old, new in ours:
            assert {k: v for k, v in old.items.items() if k not in MEASURED} == {
                k: v for k, v in new.items.items() if k not in MEASURED
            }
            assert list(old.items) == list(new.items)
        some = cut(before, checked)
        few = len(open_original(write(tmp_path, before[:some], "few.ast")).plots)
        left = {k for k in range(few) if before[slice(*span(original, k))] == after[slice(*span(original, k))]}
        assert len(left) < 0.01 * few
        check_against_libasterix(part(original, few), corrected[:few], before[:some], after[:some], left)


@pytest.mark.real
@pytest.mark.slow
def test_libasterix_reads_all_of_the_surface_radars_corrected_recording(data: Path, tmp_path: Path) -> None:
    path = data / "lebl-2016" / "smr_cat010_160510-lebl-220001.ast"
    original = open_original(path)
    corrected = shifted(original.plots, far_m=2.3)
    reencode(original, corrected, tmp_path / "new.ast")
    before, after = path.read_bytes(), (tmp_path / "new.ast").read_bytes()
    left = {k for k in range(len(original.plots)) if before[slice(*span(original, k))] == after[slice(*span(original, k))]}
    seen = check_against_libasterix(original, corrected, before, after, left)
    assert seen["040"] == 62_097
    assert len(left) < 100


def cut(data: bytes, records: int) -> int:
    """Where the block ends that holds the record of this number."""
    at = 0
    last = [r.offset for _, r in zip(range(records), decode_items(data), strict=False)][-1]
    while at <= last:
        at += int.from_bytes(data[at + 1 : at + 3], "big")
    return at


def span(original: Original, row: int) -> tuple[int, int]:
    return int(original.offset[row]), int(original.offset[row] + original.length[row])


def part(original: Original, rows: int) -> Original:
    from dataclasses import replace

    return replace(original, plots=original.plots[:rows])
