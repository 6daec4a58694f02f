"""Damage costs itself only: mutated blocks in files of every wrapping, and each fault that they once brought to light."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import mutation
import numpy as np
import pytest
from test_asterix import DATE, MIDNIGHT, adsb, block, number, old_track, position, radar, record, smr, tod, write
from test_capture import START, Frame, ethernet, final_format, frames, gps_stamped, ip4, messages, pcap, pcapng, udp

from boresight.reading import capture
from boresight.reading.asterix import DecodeState, Stream, decode, read_asterix

# How many files have which wrapping, five times over: captures, whose damaged datagrams are looked at singly, take longest.
SHARES = {"raw": 12, "pcap": 1, "pcapng": 1, "final": 1, "gps": 7}
FILES = 20


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[mutation.Sound]]:
    return mutation.pools(None, tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize("form", mutation.FORMATS)
@pytest.mark.parametrize("name", ["written", "other categories"])
def test_mutated_blocks_cost_only_themselves(
    tmp_path: Path, sound: dict[str, list[mutation.Sound]], name: str, form: str
) -> None:
    """Half of the blocks of each file are mutated: 100,000 in all."""
    mutated = missed = 0
    for seed in range(FILES * SHARES[form] // 4):
        rng = random.Random(f"{name} {form} {seed}")
        one = rng.choice(sound[name])
        made = mutation.make(rng, one.blocks, one.stamps, form, 0.5)
        result = mutation.check(made, one, tmp_path / "mutated")
        assert not result.faults, f"seed {seed}"
        assert not result.refused, f"seed {seed}"
        assert (result.far, result.moved) == (0, 0), f"seed {seed}"
        mutated, missed = mutated + sum(made.kinds.values()), missed + result.missed
    assert mutated > 450 * (FILES * SHARES[form] // 4)
    assert missed <= mutation.MISSED * mutated


@pytest.mark.parametrize("form", ["pcap", "pcapng"])
@pytest.mark.parametrize("ending", ["half", "link"])
def test_a_mutated_capture_that_is_cut_or_of_a_wrong_link_type(
    tmp_path: Path, sound: dict[str, list[mutation.Sound]], form: str, ending: str
) -> None:
    for seed in range(4):
        rng = random.Random(f"{form} {ending} {seed}")
        one = sound["written"][seed]
        made = mutation.make(rng, one.blocks, one.stamps, form, 0.2, ending)
        result = mutation.check(made, one, tmp_path / "mutated")
        assert not result.faults
        assert result.far == 0
        assert ("link type" in result.refused) == (ending == "link")


@pytest.mark.real
@pytest.mark.slow
def test_mutated_blocks_of_the_recordings(data: Path, tmp_path: Path) -> None:
    for name, pool in mutation.pools(data, tmp_path).items():
        for form in mutation.FORMATS:
            mutated = missed = 0
            for seed in range(5):
                made, one = mutation.one_file(random.Random(f"{name} {form} {seed}"), pool, form)
                result = mutation.check(made, one, tmp_path / "mutated")
                assert not result.faults, (name, form, seed)
                assert (result.far, result.moved) == (0, 0), (name, form, seed)
                mutated, missed = mutated + sum(made.kinds.values()), missed + result.missed
            assert missed <= max(3, 0.03 * mutated), (name, form)


# ------------------------------------------------------------------------------------------------------------------ captures


def stamps_of(path: Path) -> set[float]:
    found = read_asterix(path, date=DATE)
    return {*found.plots.time_s.tolist(), *found.marks.time_s.tolist()}


def own_stamps(first: int) -> set[float]:
    """The stamps of the messages of test_capture from number `first` on."""
    data = b"".join(messages()[first:])
    records, _, _ = decode(data, DecodeState.begin(DATE), final=True)
    return {*records.plots.time_s.tolist(), *records.marks.time_s.tolist()}


@pytest.mark.parametrize("make", [pcap, pcapng])
@pytest.mark.parametrize("size", [1, 3, 7, 16, 50])
def test_bytes_between_all_packets_cost_no_packet(tmp_path: Path, make: Callable[[list[Frame]], bytes], size: int) -> None:
    rng = np.random.default_rng(size)
    packets = frames()
    whole = make(packets)
    step = [len(make(packets[:k])) for k in range(len(packets) + 1)]
    data = whole[: step[0]] + b"".join(rng.bytes(size) + whole[a:b] for a, b in pairwise(step))
    assert stamps_of(write(tmp_path, data)) == own_stamps(0)


@pytest.mark.parametrize("length", [300_000, 5000, 1])
@pytest.mark.parametrize("place", [0, 20, 38])
def test_a_packet_with_a_wrong_length_swallows_nothing(tmp_path: Path, length: int, place: int) -> None:
    packets = frames()
    data = bytearray(pcap(packets))
    at = len(pcap(packets[:place]))
    data[at + 8 : at + 16] = struct.pack("<II", length, length)
    assert own_stamps(place + 1) <= stamps_of(write(tmp_path, bytes(data)))
    found = read_asterix(write(tmp_path, bytes(data)), date=DATE)
    assert found.records >= 46
    assert any("no packet of that length" in d.why for d in found.damaged)


def test_a_damaged_time_of_the_first_packet_does_not_hide_the_others(tmp_path: Path) -> None:
    data = bytearray(pcap(frames()))
    data[24:28] = struct.pack("<I", 0x7FFFFFFF)
    at = len(pcap(frames()[:3]))
    data[at + 8 : at + 12] = b"\xff" * 4
    assert len(stamps_of(write(tmp_path, bytes(data))) & own_stamps(4)) == len(own_stamps(4))


def test_two_packets_with_the_same_damaged_time_hide_nothing_between_them(tmp_path: Path) -> None:
    packets = [(float(2**31) if k in (0, 30) else time, frame) for k, (time, frame) in enumerate(frames())]
    data = bytearray(pcap(packets))
    at = len(pcap(packets[:1]))
    data[at + 8 : at + 12] = b"\xff" * 4
    assert own_stamps(2) <= stamps_of(write(tmp_path, bytes(data)))


@pytest.mark.parametrize("shift", [-90 * 86400, 90 * 86400, 5 * 86400])
def test_a_damaged_time_of_a_packet_moves_no_record(tmp_path: Path, shift: int) -> None:
    packets = [(time + (shift if k == 15 else 0), frame) for k, (time, frame) in enumerate(frames())]
    found = read_asterix(write(tmp_path, pcap(packets)))
    assert np.ptp(found.plots.time_s) < 20
    assert any("impossible times of reception" in w for w in found.warnings)


def test_a_gap_of_a_day_in_a_capture_is_no_damage(tmp_path: Path) -> None:
    packets = [(time + (86400 * 3 if k >= 30 else 0), frame) for k, (time, frame) in enumerate(frames())]
    found = read_asterix(write(tmp_path, pcap(packets)))
    assert not found.warnings
    assert np.ptp(found.plots.time_s) > 3 * 86400 - 10


def test_sound_blocks_behind_a_damaged_one_of_their_datagram_are_read(tmp_path: Path) -> None:
    """The first block of each third datagram begins with zeros: what follows it in the datagram is still ASTERIX."""
    packets = []
    for k in range(30):
        one, two = block(48, radar(3600.0 + k)), block(48, radar(3600.5 + k))
        content = bytes(6) + one[6:] + two if k % 3 == 0 else one + two
        packets.append((START + k, ethernet(ip4(udp(content)))))
    packets.append((START + 30, ethernet(ip4(udp(b"HELLO, this is something else")))))
    found = read_asterix(write(tmp_path, pcap(packets)))
    assert {MIDNIGHT + 3600.5 + k for k in range(30)} <= set(found.plots.time_s.tolist())
    assert len(found.damaged) == 10
    assert any(w.startswith("1 of 31 datagrams hold no ASTERIX") for w in found.warnings)


def test_a_block_of_another_category_costs_itself_only_in_a_datagram(tmp_path: Path) -> None:
    """Datagrams tell where blocks end: a record that does not fit its category cannot lead astray."""
    packets = []
    for k in range(30):
        one = bytearray(block(48, radar(3600.0 + k)))
        if k % 2:
            one[0] = 62 if k % 4 == 1 else 200
        packets.append((START + k, ethernet(ip4(udp(bytes(one))))))
    found = read_asterix(write(tmp_path, pcap(packets)), editions={62: "1.x"})
    assert set(found.plots.time_s.tolist()) == {MIDNIGHT + 3600.0 + k for k in range(0, 30, 2)}
    assert any(w.startswith("7 blocks of category 200 were passed over") for w in found.warnings)
    assert len(found.damaged) == 8


# ------------------------------------------------------------------------------------------------------------- stamped files


@pytest.mark.parametrize("spoilt", [0, 1, 2, 7, 8, 30])
@pytest.mark.parametrize("how", ["category", "length", "cut"])
def test_a_damaged_block_of_a_stamped_file_costs_itself_only(tmp_path: Path, spoilt: int, how: str) -> None:
    for data in (gps_stamped(), final_format()):
        at = 2200 if data[:1] == b"\xcd" else 8
        for _ in range(spoilt):
            size = int.from_bytes(data[at + 1 : at + 3], "big")
            at += size + 10 if data[:1] == b"\xcd" else int.from_bytes(data[at - 8 : at - 6], "big")
        one = bytearray(data)
        if how == "category":
            one[at] = 77
        elif how == "length":
            one[at + 1 : at + 3] = b"\x03\x07"
        else:
            del one[at + 5 : at + 9]
        path = write(tmp_path, bytes(one))
        assert len(own_stamps(0) - stamps_of(path)) <= 3
        assert own_stamps(spoilt + 1) - stamps_of(path) <= own_stamps(spoilt) - own_stamps(spoilt + 1)


@pytest.mark.parametrize("damaged", [False, True])
@pytest.mark.parametrize("form", ["pcap", "pcapng", "final", "gps"])
@pytest.mark.parametrize("chunk", [64, 333, 5000])
def test_a_wrapped_file_read_part_by_part_is_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sound: dict[str, list[mutation.Sound]], form: str, chunk: int, damaged: bool
) -> None:
    """However small the pieces are that a file is read in: the same records at the same places, and the same times."""
    one = sound["written"][0]
    rng = random.Random(f"{form} {damaged}")
    made = mutation.make(rng, one.blocks[:200], one.stamps[:200], form, 0.0)
    data = made.data
    if damaged:
        at = int(made.place[60])
        data = data[:at] + bytes(9) + data[at + 9 :]
    path = write(tmp_path, data)
    whole = read_asterix(path, date=DATE)
    monkeypatch.setattr(capture, "CHUNK", chunk)
    stream = Stream.open(path, date=DATE)
    parts = list(stream)
    assert len(parts) > 1
    for name in ("offset", "receive_s"):
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), getattr(whole, name))
    for name in ("plots", "fixes", "marks"):
        table = getattr(whole, name)
        for column, value in type(table).concat([getattr(p, name) for p in parts])._flat():
            np.testing.assert_array_equal(value, dict(table._flat())[column], err_msg=f"{name}.{column}")
    # Damage of a stamped file that lies across pieces is told in pieces.
    assert bool(stream.damaged) == bool(whole.damaged)
    assert stream.warnings == whole.warnings
    assert (bool(whole.damaged) or any("hold no ASTERIX" in w for w in whole.warnings)) == damaged


# --------------------------------------------------------------------------------------------------------------- raw streams


def test_a_sound_block_between_two_damaged_ones_is_read(tmp_path: Path) -> None:
    good = [block(10, smr(float(k))) for k in range(40)]
    data = b"".join(b"\x0a\xff\xff" + one[3:] if k % 2 else one for k, one in enumerate(good))
    found = read_asterix(write(tmp_path, data), date=DATE)
    assert {MIDNIGHT + k for k in range(0, 40, 2)} <= set(found.plots.time_s.tolist())


@pytest.mark.parametrize("wrong", [[0], [0, 1], [10, 11], [10, 11, 12], [5, 6, 30, 31]])
def test_damaged_stamps_do_not_move_what_follows_to_another_day(tmp_path: Path, wrong: list[int]) -> None:
    """Each leaps by less than half a day, together they go around the clock."""
    leaps = (39600.0, 76000.0, 30000.0, 70000.0)
    odd = dict(zip(wrong, leaps, strict=False))
    data = b"".join(block(10, smr(odd.get(k, 7200.0 + k))) for k in range(60))
    time_s = read_asterix(write(tmp_path, data), date=DATE).plots.time_s
    right = np.array([k not in odd for k in range(60)])
    np.testing.assert_array_equal(time_s[right] - MIDNIGHT, 7200.0 + np.flatnonzero(right))


def test_a_long_pause_goes_on_behind_it(tmp_path: Path) -> None:
    """The first stamp behind a pause is doubted, but not lost."""
    times = [*np.arange(50) + 70000.0, *np.arange(50) + 3000.0]
    time_s = read_asterix(write(tmp_path, b"".join(block(10, smr(t)) for t in times)), date=DATE).plots.time_s
    np.testing.assert_array_equal(time_s - MIDNIGHT, [*times[:50], *(t + 86400.0 for t in times[50:])])


# --------------------------------------------------------------------------------------------------------------- impossible


def test_what_is_not_on_earth_is_left_out_and_counted(tmp_path: Path) -> None:
    sound = [block(21, adsb("2.x", float(k), {"130": position(41.0, 2.0), "080": b"\x34\0\1"}, "073")) for k in range(30)]
    spoilt = [block(21, adsb("2.x", 3.0, {"130": position(lat, 2.0), "080": b"\x34\0\1"}, "073")) for lat in (91.0, -120.0)]
    found = read_asterix(write(tmp_path, b"".join([*sound[:10], *spoilt, *sound[10:]])), date=DATE)
    assert len(found.fixes) == 30
    assert found.records == 32
    assert any(w.startswith("2 positions of category 021 are not on Earth") for w in found.warnings)


def test_values_that_no_target_can_have_are_absent_and_counted(tmp_path: Path) -> None:
    level = number(-8000, 2)[0] & 0x3F, number(-8000, 2)[1]
    data = block(48, radar(1.0, {"090": bytes(level), "200": b"\xff\xff\0\0"}), radar(2.0, {"090": b"\x05\x78"}))
    found = read_asterix(write(tmp_path, data), date=DATE)
    assert np.isnan(found.plots.pressure_altitude_m).tolist() == [True, False]
    assert np.isnan(found.plots.speed_mps).all()
    assert any("pressure altitude (1), speed (1)" in w for w in found.warnings)


def test_a_track_that_is_not_on_earth_keeps_its_other_values(tmp_path: Path) -> None:
    far = {"010": b"\x19\x64", "070": tod(5.0), "105": number(2**29, 4) + number(5, 4), "040": b"\0\1", "080": b"\0"}
    near = far | {"105": number(2**22, 4) + number(5, 4)}
    data = block(62, *(record(62, "1.x", near) for _ in range(9)), record(62, "1.x", far))
    tracks = read_asterix(write(tmp_path, data), date=DATE, editions={62: "1.x"}).tracks
    assert np.isnan(tracks.latitude_rad).tolist() == [False] * 9 + [True]
    assert tracks.track.tolist() == [1] * 10


def test_fields_that_are_skipped_by_their_length_are_counted(tmp_path: Path) -> None:
    special = {"RE": b"\x04abc", "SP": b"\x02x"}
    data = block(48, radar(1.0, special), radar(2.0, {"RE": b"\x01"}), radar(3.0)) + block(1, old_track(4.0, {"SP": b"\x03ab"}))
    assert read_asterix(write(tmp_path, data), date=DATE).passed_over == {"048 RE": 2, "048 SP": 1, "001 SP": 1}
