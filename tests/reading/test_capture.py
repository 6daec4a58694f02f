"""Captures and other wrappings: the same records come out whatever they are wrapped in, and damage costs itself only."""

from __future__ import annotations

import datetime
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_asterix import DAY, MIDNIGHT, adsb, block, old_plot, old_track, position, radar, record, smr, tod, write

from boresight.errors import InputError, SettingsError
from boresight.model import Plots, Recording
from boresight.reading.asterix import read_asterix

START = MIDNIGHT + 3600.0
COUNT = 40


def messages(n: int = COUNT) -> list[bytes]:
    """What a radar sends, one datagram each: plots, marks, two blocks in one."""
    out = []
    for k in range(n):
        t = 3600.0 + k * 0.25
        if k % 5 == 4:
            mark = record(34, "1.x", {"010": b"\x14\x81", "000": b"\2", "030": tod(t), "020": bytes([k % 256])})
            out.append(block(34, mark) + block(48, radar(t), radar(t + 0.125)))
        else:
            out.append(block(48, radar(t, {"161": k.to_bytes(2, "big")})))
    return out


def udp(payload: bytes) -> bytes:
    return struct.pack(">HHHH", 30000, 8600, len(payload) + 8, 0) + payload


def ip4(body: bytes, number: int = 1, part: int = 0, protocol: int = 17, options: bytes = b"") -> bytes:
    head = struct.pack(">BBHHHBBH4s4s", 0x45 + len(options) // 4, 0, 20 + len(options) + len(body), number, part, 9, protocol, 0,
                       b"\x0a\0\0\1", b"\xe0\0\0\2")  # fmt: skip
    return head + options + body


def ip6(body: bytes, following: int = 17) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), following, 9) + bytes(15) + b"\1" + b"\xff\2" + bytes(13) + b"\1" + body


def ethernet(packet: bytes, tags: tuple[int, ...] = ()) -> bytes:
    kind = 0x0800 if packet[0] >> 4 == 4 else 0x86DD
    return bytes(12) + b"".join(struct.pack(">HH", tag, 7) for tag in tags) + kind.to_bytes(2, "big") + packet


def snap(packet: bytes) -> bytes:
    body = b"\xaa\xaa\x03\0\0\0\x08\0" + packet
    return bytes(12) + len(body).to_bytes(2, "big") + body


def cooked(packet: bytes) -> bytes:
    return bytes(14) + b"\x08\0" + packet


def cooked2(packet: bytes) -> bytes:
    return b"\x08\0" + bytes(18) + packet


def null(packet: bytes) -> bytes:
    return b"\2\0\0\0" + packet


Frame = tuple[float, bytes]


def frames(wrap: Callable[[bytes], bytes] = lambda m: ethernet(ip4(udp(m))), n: int = COUNT) -> list[Frame]:
    return [(START + k * 0.25 + 0.5, wrap(m)) for k, m in enumerate(messages(n))]


def pcap(packets: list[Frame], link: int = 1, big: bool = False, nano: bool = False, snap_length: int = 1 << 18) -> bytes:
    order, scale = ">" if big else "<", 1e9 if nano else 1e6
    out = struct.pack(f"{order}IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, snap_length, link)
    for time, frame in packets:
        kept = frame[:snap_length]
        fraction = round((time - int(time)) * scale)
        out += struct.pack(f"{order}IIII", int(time), fraction, len(kept), len(frame)) + kept
    return out


def pcapng(packets: list[Frame], link: int = 1, big: bool = False, tick: int | None = None, kind: int = 6) -> bytes:
    order = ">" if big else "<"

    def one(number: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = len(body) + 12
        return struct.pack(f"{order}II", number, size) + body + struct.pack(f"{order}I", size)

    options = b"" if tick is None else struct.pack(f"{order}HHB3xHH", 9, 1, tick, 0, 0)
    out = one(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    out += one(1, struct.pack(f"{order}HHI", link, 0, 0) + options) + one(4, bytes(8))
    scale = 1e6 if tick is None else 2.0 ** (tick & 127) if tick & 128 else 10.0**tick
    for time, frame in packets:
        ticks = round(time * scale)
        if kind == 6:
            head = struct.pack(f"{order}IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
        elif kind == 2:
            head = struct.pack(f"{order}HHIIII", 0, 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
        else:
            head = struct.pack(f"{order}I", len(frame))
        out += one(kind, head + frame)
    return out


def final_format(n: int = COUNT) -> bytes:
    out = b""
    for k, m in enumerate(messages(n)):
        hundredths = round((3600.0 + k * 0.25 + 0.5) * 100)
        out += (len(m) + 12).to_bytes(2, "big") + bytes(3) + hundredths.to_bytes(3, "big") + m + b"\xa5" * 4
    return out


def gps_stamped() -> bytes:
    out = b"\xcd" * 2200
    for k, m in enumerate(messages()):
        at = 0
        while at < len(m):
            size = int.from_bytes(m[at + 1 : at + 3], "big")
            out += m[at : at + size] + b"\x11\xd2\x8f\x0a\0\0" + tod(3600.0 + k * 0.25 + 0.5) + b"\0"
            at += size
    return out


def the_same(a: Plots, b: Plots) -> None:
    for (name, x), (_, y) in zip(a._flat(), b._flat(), strict=True):
        np.testing.assert_array_equal(x, y, err_msg=name)


DAY_OF_START = datetime.date(2016, 5, 10)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The same messages as raw blocks: what everything else is judged by."""
    return read_asterix(write(tmp_path_factory.mktemp("raw"), b"".join(messages())), date=DAY_OF_START)


WRAPPED = {
    "ethernet": pcap(frames()),
    "big endian": pcap(frames(), big=True),
    "nanoseconds": pcap(frames(), nano=True),
    "vlan": pcap(frames(lambda m: ethernet(ip4(udp(m)), (0x8100,)))),
    "vlan in vlan": pcap(frames(lambda m: ethernet(ip4(udp(m)), (0x88A8, 0x8100)))),
    "snap": pcap(frames(lambda m: snap(ip4(udp(m))))),
    "trailer": pcap(frames(lambda m: ethernet(ip4(udp(m))) + b"\0" * 30)),
    "options": pcap(frames(lambda m: ethernet(ip4(udp(m), options=bytes(8))))),
    "ipv6": pcap(frames(lambda m: ethernet(ip6(udp(m))))),
    "ipv6 extensions": pcap(frames(lambda m: ethernet(ip6(b"\x11\0" + bytes(6) + udp(m), 0)))),
    "cooked": pcap(frames(lambda m: cooked(ip4(udp(m)))), link=113),
    "cooked 2": pcap(frames(lambda m: cooked2(ip4(udp(m)))), link=276),
    "raw ip": pcap(frames(lambda m: ip4(udp(m))), link=101),
    "raw ip 6": pcap(frames(lambda m: ip6(udp(m))), link=101),
    "loopback": pcap(frames(lambda m: null(ip4(udp(m)))), link=0),
    "pcapng": pcapng(frames()),
    "pcapng big endian": pcapng(frames(), big=True),
    "pcapng nanoseconds": pcapng(frames(), tick=9),
    "pcapng binary ticks": pcapng(frames(), tick=128 + 20),
    "pcapng old packets": pcapng(frames(), kind=2),
    "two sections": pcapng(frames()[:15]) + pcapng(frames()[15:], big=True),
    "recorder's header": pcap(frames(lambda m: ethernet(ip4(udp((len(m) + 6).to_bytes(2, "big") + bytes(4) + m))))),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_every_wrapping_gives_the_records_of_the_raw_blocks(tmp_path: Path, plain: Recording, name: str) -> None:
    data = WRAPPED[name]
    found = read_asterix(write(tmp_path, data, "a.pcap"))
    the_same(found.plots, plain.plots)
    assert found.by_category == plain.by_category
    assert not found.damaged
    assert not found.warnings
    # Each record lies where its offset says.
    raw = b"".join(messages())
    for at, there in zip(plain.offset.tolist(), found.offset.tolist(), strict=True):
        assert data[there : there + 8] == raw[at : at + 8]
    # Received half a second after the first stamp of its datagram, to what the capture's clock resolves.
    first = np.array([k for k in range(COUNT) for _ in range(3 if k % 5 == 4 else 1)])
    np.testing.assert_allclose(found.receive_s, START + first * 0.25 + 0.5, atol=2e-6)


def test_simple_packets_of_pcapng_have_no_time(tmp_path: Path, plain: Recording) -> None:
    found = read_asterix(write(tmp_path, pcapng(frames(), kind=3)), date=DAY_OF_START)
    the_same(found.plots, plain.plots)
    assert np.isnan(found.receive_s).all()


def test_datagrams_in_pieces_come_together_in_any_order(tmp_path: Path, plain: Recording) -> None:
    packets: list[Frame] = []
    for k, (time, body) in enumerate(frames(udp)):
        cuts = list(range(0, len(body), 16))
        pieces = [(time, ethernet(ip4(body[c : c + 16], k, (c // 8) | (0x2000 if c != cuts[-1] else 0)))) for c in cuts]
        packets += pieces[::-1] if k % 2 else pieces
    found = read_asterix(write(tmp_path, pcap(packets)))
    the_same(found.plots, plain.plots)
    assert not found.damaged
    # One piece is missing: that datagram only.
    del packets[1]
    found = read_asterix(write(tmp_path, pcap(packets)))
    assert found.records == plain.records - 1
    assert len(found.damaged) == 1
    assert "pieces of a datagram are missing" in found.damaged[0].why


def test_ipv6_datagrams_in_pieces_come_together(tmp_path: Path, plain: Recording) -> None:
    packets: list[Frame] = []
    for k, (time, body) in enumerate(frames(udp)):
        for c in range(0, len(body), 24):
            more = c + 24 < len(body)
            head = struct.pack(">BBHI", 17, 0, c | more, k)
            packets.append((time, ethernet(ip6(head + body[c : c + 24], 44))))
    found = read_asterix(write(tmp_path, pcap(packets)))
    the_same(found.plots, plain.plots)


@pytest.mark.parametrize("make", [final_format, gps_stamped])
def test_stamped_files_give_the_records_of_the_raw_blocks(tmp_path: Path, plain: Recording, make: Callable[[], bytes]) -> None:
    found = read_asterix(write(tmp_path, make()), date=DAY_OF_START)
    the_same(found.plots, plain.plots)
    assert not found.damaged
    assert found.receive_s[0] == START + 0.5
    assert any("--date" in w for w in read_asterix(write(tmp_path, make())).warnings)


def test_what_is_no_datagram_or_no_asterix_is_passed_over_and_counted(tmp_path: Path, plain: Recording) -> None:
    packets = frames()
    packets.insert(3, (START + 1, bytes(12) + b"\x08\x06" + bytes(28)))  # ARP
    packets.insert(9, (START + 2, ethernet(ip4(bytes(30), protocol=6))))  # TCP
    packets.insert(20, (START + 3, ethernet(ip4(udp(b"HELLO, this is something else")))))
    found = read_asterix(write(tmp_path, pcap(packets)))
    the_same(found.plots, plain.plots)
    assert not found.damaged
    assert any(w.startswith("2 of 43 packets are no UDP datagrams") for w in found.warnings)
    assert any(w.startswith("1 of 41 datagrams hold no ASTERIX") for w in found.warnings)


def test_a_date_that_is_given_counts_and_a_difference_is_said(tmp_path: Path, plain: Recording) -> None:
    found = read_asterix(write(tmp_path, pcap(frames())), date=datetime.date(2020, 1, 1))
    moved = found.plots.time_s - plain.plots.time_s
    assert np.all(moved == (datetime.date(2020, 1, 1) - DAY_OF_START).days * DAY)
    assert any("2016-05-10" in w and "2020-01-01" in w for w in found.warnings)


# -------------------------------------------------------------------------------------------------------------- bad captures


def test_half_a_capture_is_read_and_the_cut_is_said(tmp_path: Path) -> None:
    for data in (pcap(frames()), pcapng(frames())):
        half = data[: len(data) // 2]
        found = read_asterix(write(tmp_path, half))
        assert 0.4 * COUNT < found.records < COUNT
        assert len(found.damaged) == 1
        assert found.damaged[0].why.startswith("the capture ends within a")


def test_packets_captured_in_part_are_damage_and_their_whole_records_are_read(tmp_path: Path, plain: Recording) -> None:
    found = read_asterix(write(tmp_path, pcap(frames(), snap_length=75)))
    assert any("captured in part" in d.why for d in found.damaged)
    assert plain.records / 2 < found.records < plain.records


@pytest.mark.parametrize("make", [pcap, pcapng])
def test_a_damaged_header_costs_its_packet_only(tmp_path: Path, plain: Recording, make: Callable[[list[Frame]], bytes]) -> None:
    data = bytearray(make(frames()))
    one = data.index(ethernet(ip4(udp(messages()[7]))))
    data[one - (8 if make is pcap else 24) : one] = b"\xff" * (8 if make is pcap else 24)
    found = read_asterix(write(tmp_path, bytes(data)))
    assert found.records == plain.records - 1
    assert len(found.damaged) >= 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (pcap(frames(), link=105), r"link type 105 \(IEEE 802.11\), which cannot be read"),
        (pcapng(frames(), link=189), r"link type 189 \(USB\), which cannot be read"),
        (pcap(frames(), link=101), r"says that its link type is 101 \(raw IP\), but its packets look like 1 \(Ethernet\)"),
        (pcap(frames(lambda m: ip4(udp(m))), link=1), r"link type is 1 \(Ethernet\), but its packets look like 101 \(raw IP\)"),
        (pcap(frames(lambda m: ethernet(ip4(m, protocol=6)))), "none of the 40 packets .* holds a UDP datagram"),
        (pcap(frames(lambda m: ethernet(ip4(udp(b"no radar at all"))))), "none of the 40 datagrams .* ASTERIX"),
        (pcap([]), "no"),
        (pcap(frames())[:20], "ends within its header"),
    ],
)
def test_a_capture_of_which_nothing_can_be_read_says_why(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_asterix(write(tmp_path, data))


def test_damage_in_one_datagram_stays_in_it(tmp_path: Path, plain: Recording) -> None:
    rng = np.random.default_rng(1)
    packets, hurt = [], 0
    for k, (time, body) in enumerate(frames(lambda m: m)):
        if k % 4 == 1:
            body = rng.bytes(2) + body[2:-3]
            hurt += 1
        packets.append((time, ethernet(ip4(udp(body)))))
    found = read_asterix(write(tmp_path, pcap(packets)))
    assert found.records >= plain.records - 3 * hurt
    kept = np.isin(plain.plots.time_s, found.plots.time_s)
    stamps = np.array([3600.0 + k * 0.25 for k in range(COUNT) if k % 4 != 1]) + MIDNIGHT
    assert np.isin(stamps[stamps < plain.plots.time_s.max()], np.r_[found.plots.time_s, found.marks.time_s]).all()
    assert kept.sum() == len(found.plots)


@pytest.mark.parametrize("name", ["ethernet", "pcapng", "final", "gps"])
def test_mutated_wrappings_neither_fail_nor_hang_and_lose_little(tmp_path: Path, plain: Recording, name: str) -> None:
    """300 files with one to five bytes or runs changed, put in or lost: a recording or one clear error, most records there."""
    rng = np.random.default_rng(5)
    whole = {"final": final_format(), "gps": gps_stamped()}.get(name) or WRAPPED[name]
    shares = []
    for _ in range(75):
        data = bytearray(whole)
        for _ in range(int(rng.integers(1, 6))):
            at, kind, n = int(rng.integers(24, len(data))), int(rng.integers(4)), int(rng.integers(1, 40))
            if kind == 0:
                data[at] ^= int(rng.integers(1, 256))
            elif kind == 1:
                data[at : at + n] = rng.bytes(len(data[at : at + n]))
            elif kind == 2:
                data[at:at] = rng.bytes(n)
            else:
                del data[at : at + n]
        try:
            found = read_asterix(write(tmp_path, bytes(data)), date=DAY_OF_START)
        except InputError:
            shares.append(0.0)
            continue
        shares.append(found.records / plain.records)
        assert found.offset.min(initial=0) >= 0
        assert found.offset.max(initial=0) < len(data)
        # What was lost to the byte, block and stamp, nothing can tell.
        if found.records < plain.records - 2:
            assert found.damaged or found.warnings
    assert np.median(shares) > 0.8


def test_an_impossible_time_of_a_packet_moves_nothing(tmp_path: Path, plain: Recording) -> None:
    packets = frames()
    packets[7] = (START + 9e8, packets[7][1])
    packets[0] = (4.0e9, packets[0][1])
    found = read_asterix(write(tmp_path, pcap(packets)))
    the_same(found.plots, plain.plots)
    assert np.isnan(found.receive_s[[0]]).all()
    assert any(w.startswith("2 packets have impossible times") for w in found.warnings)


# ---------------------------------------------------------------------------------------- times of day that are cut to 512 s


def full(t: float, source: bytes = b"\x19\xc9") -> bytes:
    return block(2, record(2, "1.x", {"010": source, "000": b"\1", "030": tod(t % DAY)}))


@pytest.mark.parametrize("start", [100.0, 40000.0, DAY - 400.0, DAY - 1000.0])
def test_the_cut_time_is_completed_from_the_full_time_of_its_source(tmp_path: Path, start: float) -> None:
    """Over several wraps of 512 s and over midnight, where the rest begins anew as well."""
    times = [start + 90.0 * k for k in range(20)]
    data = b"".join(full(t) + block(1, old_plot(t % DAY + 0.5), old_track(t % DAY + 1.0)) for t in times)
    found = read_asterix(write(tmp_path, data), date=DAY_OF_START)
    expected = MIDNIGHT + np.array([[t + 0.5, t + 1.0] for t in times]).ravel()
    np.testing.assert_allclose(found.plots.time_s, expected, atol=0.005)
    assert found.plots.track.tolist() == [-1, 0x123] * 20


def test_plots_ahead_of_the_first_full_time_are_completed_from_it(tmp_path: Path) -> None:
    data = b"".join(block(1, old_plot(t)) for t in (5000.0, 5001.0, 5002.0)) + full(5003.0) + block(1, old_plot(5004.0))
    found = read_asterix(write(tmp_path, data), date=DAY_OF_START)
    np.testing.assert_array_equal(found.plots.time_s, MIDNIGHT + np.array([5000.0, 5001.0, 5002.0, 5004.0]))


def test_a_cut_time_that_nothing_completes_is_not_known_and_said(tmp_path: Path) -> None:
    other = b"\x19\x01"
    data = b"".join(block(1, old_plot(t)) for t in (5000.0, 5001.0)) + full(5003.0, other)
    found = read_asterix(write(tmp_path, data), date=DAY_OF_START)
    assert np.isnan(found.plots.time_s).all()
    assert any(w.startswith("2 records of category 001 tell only the rest") for w in found.warnings)


def test_the_time_of_reception_completes_a_cut_time(tmp_path: Path) -> None:
    packets = [(MIDNIGHT + t + 0.3, ethernet(ip4(udp(block(1, old_plot(t)))))) for t in (5000.0, 5600.0, 6300.0)]
    found = read_asterix(write(tmp_path, pcap(packets)))
    np.testing.assert_array_equal(found.plots.time_s, MIDNIGHT + np.array([5000.0, 5600.0, 6300.0]))


# ------------------------------------------------------------------------------------------------------------------ choosing


def test_categories_and_sources_are_chosen(tmp_path: Path) -> None:
    data = b"".join(
        block(10, smr(5.0 + k, sic=7 + k % 2))
        + block(48, radar(6.0 + k))
        + block(21, adsb("0.23", 7.0 + k, {"130": position(41, 2)}))
        for k in range(6)
    )
    path = write(tmp_path, data)
    everything = read_asterix(path, date=DAY_OF_START)
    assert everything.by_category == {10: 6, 21: 6, 48: 6}
    some = read_asterix(path, date=DAY_OF_START, categories=[10, 48])
    assert some.by_category == {10: 6, 48: 6}
    one = read_asterix(path, date=DAY_OF_START, sources=[8])
    assert {(s.sac, s.sic) for s in one.sources} == {(0, 8)}
    for found in (some, one):
        assert len(found.plots) > 0
        raw = np.frombuffer(data, np.uint8)
        # Each plot's record is the one that its number points to: its own source stands behind the FSPEC.
        for row in range(len(found.plots)):
            at = int(found.offset[found.plots.record[row]])
            while raw[at] & 1:
                at += 1
            assert int(raw[at + 1]) << 8 | int(raw[at + 2]) == found.plots.sensor[row]
    with pytest.raises(SettingsError, match="247 cannot be read"):
        read_asterix(path, categories=[247])
    with pytest.raises(InputError, match="no record is of what was asked for"):
        read_asterix(path, sources=[99])


def test_a_file_longer_than_what_is_held_at_once_is_read_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = b"".join(messages(400))
    wrapped = pcap(frames(n=400))
    expected = read_asterix(write(tmp_path, raw), date=DAY_OF_START)
    for module in ("asterix", "capture"):
        monkeypatch.setattr(f"boresight.reading.{module}.CHUNK", 1000)
    for data in (raw, wrapped, final_format(400), pcapng(frames(n=400))):
        found = read_asterix(write(tmp_path, data), date=DAY_OF_START)
        the_same(found.plots, expected.plots)
        assert not found.damaged


# ------------------------------------------------------------------------------------------------------------ tracks, status


def test_a_track_has_position_velocity_identity_accuracy_and_age_in_si(tmp_path: Path) -> None:
    wgs = struct.pack(">ii", round(45.5 * 2**25 / 180), round(-16.25 * 2**25 / 180))
    items = {
        "010": b"\x19\x64", "070": tod(3600.0), "105": wgs, "185": struct.pack(">hh", 400, -200), "210": b"\x04\xfc",
        "060": b"\x0f\xc0", "380": b"\xc0\x34\x12\xcd" + bytes.fromhex("24a1f1cb3820"), "040": b"\x12\x34", "080": b"\x01\x40",
        "290": b"\x24\x10\x06", "136": struct.pack(">h", 1400), "130": struct.pack(">h", 1600),
        "220": struct.pack(">h", -160), "500": b"\x90\x00\x14\x00\x1c\x08", "270": b"\x49\x40",
    }  # fmt: skip
    tracks = read_asterix(write(tmp_path, block(62, record(62, "1.x", items))), date=DAY_OF_START, editions={62: "1.x"}).tracks
    assert len(tracks) == 1
    assert tracks.time_s[0] == START
    assert tracks.track[0] == 0x1234
    np.testing.assert_allclose(np.degrees([tracks.latitude_rad[0], tracks.longitude_rad[0]]), [45.5, -16.25], atol=5e-6)
    assert (tracks.velocity_east_mps[0], tracks.velocity_north_mps[0]) == (100.0, -50.0)
    assert (tracks.acceleration_east_mps2[0], tracks.acceleration_north_mps2[0]) == (1.0, -1.0)
    assert tracks.mode_s[0] == 0x3412CD
    assert tracks.mode_3a[0] == 0o7700
    assert tracks.pressure_altitude_m[0] == pytest.approx(35000 * 0.3048)
    assert tracks.height_m[0] == pytest.approx(10000 * 0.3048)
    assert tracks.velocity_up_mps[0] == pytest.approx(-1000 * 0.3048 / 60)
    # SSR age 4 s, ES 1.5 s, none of them PSR; APC 10 and 14 m.
    assert tracks.age_s[0] == 1.5
    assert tracks.horizontal_sd_m[0] == pytest.approx(np.sqrt((10**2 + 14**2) / 2))
    assert tracks.vertical_sd_m[0] == pytest.approx(8 * 6.25 * 0.3048)
    assert tracks.length_m[0] == 36.0


def test_the_sensors_biases_of_category_063_are_told(tmp_path: Path) -> None:
    items = {
        "010": b"\x19\x64", "030": tod(10.0), "050": b"\x14\x81", "060": b"\x00", "070": struct.pack(">h", -25),
        "080": struct.pack(">hh", 30, 7), "081": struct.pack(">h", 18), "091": struct.pack(">h", -9),
    }  # fmt: skip
    found = read_asterix(write(tmp_path, block(63, record(63, "1.x", items))), date=DAY_OF_START)
    (source,) = found.sources
    assert source.notes == (
        "sensor 20/129: operational, time bias -25 ms, SSR range gain +0.3 m/km, SSR range bias +101.28 m, "
        "SSR azimuth bias +0.098877 deg, PSR azimuth bias -0.049438 deg",
    )


# ---------------------------------------------------------------------------------------------------------- real recordings


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "categories", "rows"),
    [
        ("asterix.pcap", {62: 100}, (0, 0, 100)),
        ("cat048.raw", {48: 1}, (1, 0, 0)),
        ("cat21_re.ast", {21: 2}, (0, 2, 0)),
        ("cat_001_002.pcap", {1: 7, 2: 1}, (7, 0, 0)),
        ("cat_034_048.pcap", {34: 34, 48: 128}, (126, 64, 0)),
        ("cat_062_065.pcap", {62: 2, 65: 1}, (0, 0, 2)),
        ("parsegps.gps", {34: 3, 48: 15}, (14, 0, 0)),
    ],
)
def test_the_small_samples_hold_what_is_known_of_them(
    data: Path, name: str, categories: dict[int, int], rows: tuple[int, int, int]
) -> None:
    found = read_asterix(data / "croatia" / name)
    assert found.by_category == categories
    assert (len(found.plots), len(found.fixes), len(found.tracks)) == rows
    assert not found.damaged
    assert np.isfinite(found.plots.time_s).all()
    # Whoever recorded them had a clock that is right to a few seconds (one radar's is 20 s late), which is a check of the times.
    if len(found.receive_s):
        timed = np.r_[found.plots.record, found.tracks.record]
        late = found.receive_s[timed] - np.r_[found.plots.time_s, found.tracks.time_s]
        assert np.quantile(np.abs(late), 0.9) < 4.0
    if len(found.tracks):
        # Tracks of Zagreb's centre: over the Adriatic and the north-west Balkans, at the speeds of airliners.
        assert np.all(np.abs(np.degrees(found.tracks.latitude_rad) - 45) < 4)
        assert np.all(np.abs(np.degrees(found.tracks.longitude_rad) - 17) < 5)
        speed = np.hypot(found.tracks.velocity_east_mps, found.tracks.velocity_north_mps)
        assert np.median(speed) == pytest.approx(220, abs=60)


@pytest.mark.real
def test_the_draft_of_category_062_has_tracks_that_go_where_their_velocities_say(data: Path) -> None:
    """Edition 0.17 is in no other library: its positions against its own velocities, over the seconds between two updates."""
    tracks = read_asterix(data / "croatia/asterix.pcap").tracks
    told, moved = [], []
    for number in np.unique(tracks.track):
        one = tracks[tracks.track == number]
        step = np.diff(one.time_s)
        use = step > 2
        north = np.diff(one.latitude_rad) * 6371e3
        east = np.diff(one.longitude_rad) * 6371e3 * np.cos(one.latitude_rad[1:])
        told += [one.velocity_north_mps[1:][use] * step[use], one.velocity_east_mps[1:][use] * step[use]]
        moved += [north[use], east[use]]
    v, w = np.concatenate(told), np.concatenate(moved)
    assert len(v) > 30
    assert np.sum(v * w) / np.sum(v * v) == pytest.approx(1.0, abs=0.03)
    assert np.corrcoef(v, w)[0, 1] > 0.99
