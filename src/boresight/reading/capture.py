"""Recordings that wrap ASTERIX: packet captures (pcap, pcapng), final-format files, GPS-stamped files.

Each is walked in chunks and gives portions: the contents of datagrams one behind the other, where each lies in the file, and when
it was received.  What the packets of a capture hold is found with array operations, packet by packet only where a datagram was
split or has extension headers.  What does not belong is counted; what is damaged costs itself only.
"""

from __future__ import annotations

import struct
from collections import Counter, OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from .._jit import kernel
from .._types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from ..errors import InputError
from ..model import Damage

# Bytes that are held at once.
CHUNK = 8 << 20
# No packet is longer than what capture programs take by default, with room; a length beyond shows that the place is no packet.
_LONGEST = 1 << 20
_PACKETS = 1 << 16
# Datagrams in pieces that are waited for at once.
_WAITING = 1024
# Times of packets beyond the year 2200, or this far from those around them, are damaged.
_LATEST, _APART_S = 7.26e9, 400 * 86400.0
# A time is doubted where no more than so many of the packets around have one within an hour of it.
_AROUND, _FEW, _NEAR_S = 8, 3, 3600.0
# Bytes that are searched for where packets go on after damage.
_SEARCH = 1 << 20
# Ahead of its first block a GPS-stamped file has a header of this size, behind each block a trailer of that size.
_GPS_HEADER, _GPS_TRAILER = 2200, 10
# Times of stamped blocks that follow each other; how many bytes at the beginning of all trailers of a file are the same.
_GPS_APART_S, _GPS_MARK = 60.0, 4
_PAD = b"\xa5\xa5\xa5\xa5"
# The header that some recorders put ahead of each message: its length with the header, and a time of day in ms.
_HEADER = 6

_PCAP = {
    b"\xd4\xc3\xb2\xa1": (False, 1e-6, 16),
    b"\xa1\xb2\xc3\xd4": (True, 1e-6, 16),
    b"\x4d\x3c\xb2\xa1": (False, 1e-9, 16),
    b"\xa1\xb2\x3c\x4d": (True, 1e-9, 16),
    b"\x34\xcd\xb2\xa1": (False, 1e-6, 24),
    b"\xa1\xb2\xcd\x34": (True, 1e-6, 24),
}
_SECTION = 0x0A0D0D0A

# Link types of captures (the numbers of the pcap project).  Those that can be read, and the names of common others.
_NULL, _ETHERNET, _RAW, _SLL, _SLL2 = (0, 108), (1,), (12, 14, 101, 228, 229), (113,), (276,)
READABLE = frozenset((*_NULL, *_ETHERNET, *_RAW, *_SLL, *_SLL2))
LINKS = {
    0: "BSD loopback", 1: "Ethernet", 6: "Token Ring", 8: "SLIP", 9: "PPP", 10: "FDDI", 12: "raw IP", 14: "raw IP",
    50: "PPP in HDLC", 101: "raw IP", 104: "Cisco HDLC", 105: "IEEE 802.11", 108: "OpenBSD loopback", 113: "Linux cooked",
    119: "Prism 802.11", 127: "802.11 with radiotap", 147: "user 0", 189: "USB", 220: "USB", 228: "IPv4", 229: "IPv6",
    276: "Linux cooked 2",
}  # fmt: skip


def link_name(link: int) -> str:
    """The name and number of a link type."""
    return f"{link} ({LINKS[link]})" if link in LINKS else str(link)


class Portion(NamedTuple):
    """Contents of datagrams one behind the other: each begins at `begin` (k,), lies at `offset` in the file, came at `receive_s`.

    Receive times are UTC seconds in captures, seconds of the first day (and beyond) elsewhere.
    """

    data: ByteArray
    begin: IntArray
    offset: IntArray
    receive_s: FloatArray


@dataclass(slots=True)
class Tally:
    """What a container held beside datagrams.

    `cut` counts packets that were captured in part, `untimed` those with impossible times, `links` packets by link type.
    """

    packets: int = 0
    datagrams: int = 0
    other: int = 0
    cut: int = 0
    untimed: int = 0
    links: Counter[int] = field(default_factory=Counter)
    damaged: list[Damage] = field(default_factory=list)


def kind_of(head: bytes, size: int, known: frozenset[int]) -> str:
    """What a file is by its first bytes: "pcap", "pcapng", "final", "gps", else "raw"; `known` are the categories with a table.

    `head` must hold at least 4,096 bytes of a file that has them; `size` is the file's.
    """
    if head[:4] in _PCAP:
        return "pcap"
    if head[:4] == _SECTION.to_bytes(4, "big"):
        return "pcapng"
    if len(head) >= 15 and (_is_final(head, size, known) or _final_later(head, known)):
        return "final"
    if not _chained(head, 0, known) and _gps_begin(head, known) >= 0:
        return "gps"
    return "raw"


def _is_final(head: bytes, size: int, known: frozenset[int]) -> bool:
    """Whether a final-format record stands at the beginning."""
    length = int.from_bytes(head[:2], "big")
    if not (15 <= length <= size and (head[length - 4 : length] == _PAD or length > len(head)) and head[8] in known):
        return False
    inner = int.from_bytes(head[9:11], "big")
    return 3 <= inner <= length - 12 and int.from_bytes(head[5:8], "big") < 8_640_000


def _final_later(head: bytes, known: frozenset[int]) -> bool:
    """Whether final-format records follow something else: one behind the padding of another, ending in its own padding."""
    at = head.find(_PAD, 0, 1 << 16)
    while at >= 0:
        begin = at + len(_PAD)
        length = int.from_bytes(head[begin : begin + 2], "big")
        if length >= 15 and begin + length <= len(head) and _is_final(head[begin : begin + length], length, known):
            return True
        at = head.find(_PAD, begin, 1 << 16)
    return False


def _chained(data: bytes, at: int, known: frozenset[int]) -> bool:
    """Whether a block begins at `at` and another one (or the end) follows it."""
    if len(data) < at + 3 or data[at] not in known:
        return False
    end = at + int.from_bytes(data[at + 1 : at + 3], "big")
    return end >= at + 5 and (end >= len(data) or data[end] in known)


def _gps_begin(head: bytes, known: frozenset[int]) -> int:
    """Where GPS-stamped blocks begin: three of them, or all that are there, with stamps within a minute; -1: nowhere.

    Looked for behind the header that such files have, and near there, in case that something was lost.
    """
    places: list[int] = [_GPS_HEADER, *range(min(2 * _GPS_HEADER, len(head)))]
    for place in places:
        at, stamp, found = place, -1.0, 0
        while found < 3 and at + 3 <= len(head) and head[at] in known:
            end = at + int.from_bytes(head[at + 1 : at + 3], "big")
            told = int.from_bytes(head[end + 6 : end + 9], "big") / 128.0
            if end < at + 5 or end + _GPS_TRAILER > len(head) or told > 86400 or (found and abs(told - stamp) > 60):
                break
            at, stamp, found = end + _GPS_TRAILER, told, found + 1
        if found == 3 or (found and at == len(head)):
            return place
    return -1


def portions(path: str | Path, kind: str, tally: Tally, known: frozenset[int]) -> Iterator[Portion]:
    """The datagrams of a container of `kind`; what else it holds is counted in `tally`.

    Raises InputError where the file cannot be read, or nothing of its link type can.
    """
    try:
        with open(path, "rb") as file:
            if kind == "pcap":
                yield from _pcap(path, file, tally)
            elif kind == "pcapng":
                yield from _pcapng(path, file, tally)
            else:
                yield from _stamped(file, tally, kind, known)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=path) from error


# ------------------------------------------------------------------------------------------------------------------ captures

_int: Any = np.int64


@kernel
def _u32(data: ByteArray, p: int, big: bool) -> int:
    a, b, c, d = _int(data[p]), _int(data[p + 1]), _int(data[p + 2]), _int(data[p + 3])
    value: int = a << 24 | b << 16 | c << 8 | d if big else d << 24 | c << 16 | b << 8 | a
    return value


@kernel
def _packet(data: ByteArray, p: int, big: bool, most: int, ticks: int, near: int) -> int:
    """Bytes captured of the packet whose header is at `p`, -1 where it cannot be one; with `near` >= 0 its time must be near."""
    long, whole, fraction = _u32(data, p + 8, big), _u32(data, p + 12, big), _u32(data, p + 4, big)
    if long > most or long > whole or whole > most or fraction >= ticks:
        return -1
    if near >= 0 and abs(_u32(data, p, big) - near) > 86400:
        return -1
    return long


@kernel
def _frames(
    data: ByteArray, pos: int, big: bool, head: int, most: int, ticks: int, trusted: int, out: IntArray
) -> tuple[int, int, int]:
    """Walk packets from `pos` on; returns their number, where it stopped, and why.

    Why: 0 end, 1 no room, 2 damage, 3 section, 4 what follows the packet is none, so that its length may be wrong (but for the
    packet at `trusted`).  With `head` (bytes of a packet's header) rows of `out` are: place of the frame, bytes captured, bytes
    of the packet, seconds, fraction.  With 0 the blocks of pcapng are walked: place, length, kind.
    """
    size, n = len(data), 0
    while True:
        if n == len(out):
            return n, pos, 1
        if size - pos < max(head, 12):
            return n, pos, 0
        if head == 0:
            kind, long = _u32(data, pos, big), _u32(data, pos + 4, big)
            if kind == 0x0A0D0D0A:
                return n, pos, 3
            if long < 12 or long & 3 or long > most:
                return n, pos, 2
            if pos + long > size:
                return n, pos, 0
            if _u32(data, pos + long - 4, big) != long:
                return n, pos, 2
            out[n, 0], out[n, 1], out[n, 2] = pos, long, kind
            pos += long
        else:
            long = _packet(data, pos, big, most, ticks, -1)
            if long < 0:
                return n, pos, 2
            end = pos + head + long
            if end > size:
                return n, pos, 0
            if pos != trusted and end + head <= size and _packet(data, end, big, most, ticks, -1) < 0:
                return n, pos, 4
            out[n, 0], out[n, 1], out[n, 2] = pos + head, long, _u32(data, pos + 12, big)
            out[n, 3], out[n, 4] = _u32(data, pos, big), _u32(data, pos + 4, big)
            pos = end
        n += 1


@kernel
def _next_packet(data: ByteArray, begin: int, end: int, big: bool, head: int, most: int, ticks: int, near: int) -> int:
    """The first place from `begin` to `end` where a packet begins; -1: none.

    Its time is near `near` (s; -1: not known) and that of the packet that follows it; where what follows is no packet, the time
    has to do, and a length of its own that is no more than that of other packets.
    """
    size = len(data)
    for p in range(begin, min(end, size - head + 1)):
        long = _packet(data, p, big, most, ticks, near)
        if long < 20:
            continue
        follows = p + head + long
        if follows == size:
            return p
        if follows > size:
            continue
        if follows + head > size or _packet(data, follows, big, most, ticks, _u32(data, p, big)) >= 20:
            return p
        time_s = _u32(data, p, big)
        if near >= 0 and long <= 2048 and abs(time_s - near) <= 600:
            return p
        if near < 0:
            # The next one that there is, soon, has to have a time like it.
            for q in range(follows + 1, min(follows + 4096, size - head + 1)):
                if _packet(data, q, big, most, ticks, time_s) >= 20 and abs(_u32(data, q, big) - time_s) <= 600:
                    return p
    return -1


@kernel
def _copy(data: ByteArray, place: IntArray, length: IntArray, out: ByteArray) -> None:
    """The bytes at `place` (k,), `length` (k,) of each, one behind the other."""
    at = 0
    for i in range(len(place)):
        for j in range(place[i], place[i] + length[i]):
            out[at] = data[j]
            at += 1


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, bool]]:
    """The file's next bytes, and whether they are the last."""
    here = file.read(CHUNK)
    while True:
        following = file.read(CHUNK)
        yield here, not following
        if not following:
            return
        here = following


def _pcap(path: str | Path, file: BinaryIO, tally: Tally) -> Iterator[Portion]:
    head = file.read(24)
    big, tick, size = _PCAP[head[:4]]
    if len(head) < 24:
        raise InputError("the capture ends within its header", path=path, offset=len(head), remedy="Copy the file again.")
    link = int.from_bytes(head[20:24], "big" if big else "little") & 0xFFFF
    if link not in READABLE:
        raise _unreadable(path, {link})
    pieces = _Pieces(tally)
    rest, base = b"", 24
    stray = _Stray()
    ticks = 1_000_000_000 if tick < 1e-6 else 1_000_001
    trusted = -1
    # The last times: the middle one is not led astray by one that is damaged.
    recent: deque[int] = deque(maxlen=9)
    for chunk, final in _chunks(file):
        raw = rest + chunk
        data = np.frombuffer(raw, np.uint8)
        pos = 0
        out, filled = np.empty((_PACKETS, 5), np.int64), 0
        while True:
            n, pos, why = _frames(data, pos, big, size, _LONGEST, ticks, trusted, out[filled:])
            filled += n
            recent.extend(out[max(filled - n, filled - 9) : filled, 3].tolist())
            last = sorted(recent)[len(recent) // 2] if recent else -1
            if why == 1:
                yield from _found_in(data, out, tick, link, base, tally, pieces, stray)
                filled = 0
                continue
            if why == 4:
                # Packets that begin within this one show that its length is wrong.
                end = pos + size + _packet(data, pos, big, _LONGEST, ticks, -1)
                resumed = _next_packet(data, pos + size, end, big, size, _LONGEST, ticks, last)
                if resumed < 0:
                    trusted = pos
                    continue
            elif why == 2 or (why == 0 and final and len(raw) - pos > size):
                # Perhaps the times of those ahead were damaged: what goes on without them counts too.
                ends = [_next_packet(data, pos + 1, pos + _SEARCH, big, size, _LONGEST, ticks, near) for near in (last, -1)]
                resumed = min((place for place in ends if place >= 0), default=-1)
                if resumed < 0 and why == 0:
                    break
                resumed = min(len(raw), pos + _SEARCH) if resumed < 0 else resumed
            else:
                break
            tally.damaged.append(Damage(base + pos, f"no packet of that length begins here; {resumed - pos} bytes are skipped"))
            pos = resumed
        yield from _found_in(data, out[:filled], tick, link, base, tally, pieces, stray)
        rest, base, trusted = raw[pos:], base + pos, -1
        if final and rest:
            tally.damaged.append(Damage(base, f"the capture ends within a packet: {len(rest)} bytes are left of it"))
    yield from pieces.finish()
    stray.check(path, tally)


def _found_in(
    data: ByteArray, rows: IntArray, tick: float, link: int, base: int, tally: Tally, pieces: _Pieces, stray: _Stray
) -> Iterator[Portion]:
    """The datagrams of the rows that `_frames` filled."""
    frame, taken, whole, second, fraction = np.ascontiguousarray(rows.T)
    links = np.full(len(rows), link)
    yield from _found(data, frame, taken, whole, second + fraction * tick, links, base, tally, pieces, stray)


def _words(data: ByteArray, at: IntArray, big: bool) -> IntArray:
    """The 32-bit numbers at `at` (k,)."""
    order = (0, 1, 2, 3) if big else (3, 2, 1, 0)
    value = np.zeros(len(at), np.int64)
    for k in order:
        value = value << 8 | data[np.minimum(at + k, len(data) - 1)]
    return value


def _shorts(data: ByteArray, at: IntArray) -> IntArray:
    """The 16-bit numbers at `at` (k,), in network order; beyond the data their last byte stands."""
    return _pairs(data, np.ascontiguousarray(at, np.int64))


@kernel
def _pairs(data: ByteArray, at: IntArray) -> IntArray:
    last = len(data) - 1
    out = np.empty(len(at), np.int64)
    for k in range(len(at)):
        out[k] = _int(data[min(at[k], last)]) << 8 | _int(data[min(at[k] + 1, last)])
    return out


class _Interface(NamedTuple):
    link: int
    snap: int
    tick: float
    shift: float


def _pcapng(path: str | Path, file: BinaryIO, tally: Tally) -> Iterator[Portion]:
    rest, base = b"", 0
    big = False
    interfaces: list[_Interface] = []
    pieces, stray = _Pieces(tally), _Stray()
    for chunk, final in _chunks(file):
        raw = rest + chunk
        data = np.frombuffer(raw, np.uint8)
        pos = 0
        out, filled = np.empty((_PACKETS, 5), np.int64), 0
        while True:
            n, stop, why = _frames(data, pos, big, 0, _LONGEST << 4, 0, -1, out[filled:])
            filled += n
            pos = stop
            if why in (1, 3):
                yield from _sections(raw, data, out[:filled], big, interfaces, base, tally, pieces, stray)
                filled = 0
            if why == 3:
                order = raw[pos + 8 : pos + 12]
                if len(order) < 4:
                    break
                if order in (b"\x1a\x2b\x3c\x4d", b"\x4d\x3c\x2b\x1a"):
                    big = order[0] == 0x1A
                    length = int.from_bytes(raw[pos + 4 : pos + 8], "big" if big else "little")
                    if length >= 28 and length % 4 == 0 and length < _LONGEST:
                        if pos + length > len(raw):
                            break
                        interfaces = []
                        pos += length
                        continue
                why = 2
            if why == 2 or (why == 0 and final and len(raw) - pos > 12):
                resumed = _next_block(raw, pos + 1, big)
                if why == 0 and resumed in (len(raw), pos + 1 + _SEARCH):
                    break
                tally.damaged.append(
                    Damage(base + pos, f"no block of the capture begins here; {resumed - pos} bytes are skipped")
                )
                pos = resumed
            elif why == 0:
                break
        yield from _sections(raw, data, out[:filled], big, interfaces, base, tally, pieces, stray)
        rest, base = raw[pos:], base + pos
        if final and rest:
            tally.damaged.append(Damage(base, f"the capture ends within a block: {len(rest)} bytes are left of it"))
    yield from pieces.finish()
    stray.check(path, tally)


def _sections(
    raw: bytes, data: ByteArray, blocks: IntArray, big: bool, interfaces: list[_Interface], base: int, tally: Tally,
    pieces: _Pieces, stray: _Stray,
) -> Iterator[Portion]:  # fmt: skip
    """The datagrams of the rows that `_frames` filled; those between descriptions of interfaces are taken together."""
    low = 0
    for high in [*np.flatnonzero(blocks[:, 2] == 1).tolist(), len(blocks)]:
        yield from _blocks(data, blocks[low:high], big, interfaces, base, tally, pieces, stray)
        if high < len(blocks):
            interfaces.append(_interface(raw, int(blocks[high, 0]), int(blocks[high, 1]), big))
        low = high


def _next_block(raw: bytes, begin: int, big: bool) -> int:
    """Where the next block begins: its length stands at both ends."""
    end = min(len(raw), begin + _SEARCH)
    data = np.frombuffer(raw, np.uint8)
    places = np.arange(begin, max(begin, end - 8))
    if not len(places):
        return len(raw)
    kind, length = _words(data, places, big), _words(data, places + 4, big)
    good = np.isin(kind, (1, 2, 3, 4, 5, 6, 10, _SECTION)) & (length >= 12) & (length % 4 == 0) & (length < _LONGEST)
    good &= places + length <= len(raw)
    good &= _words(data, np.where(good, places + length - 4, 0), big) == length
    found = np.flatnonzero(good)
    return int(places[found[0]]) if len(found) else end


def _interface(raw: bytes, at: int, length: int, big: bool) -> _Interface:
    order = ">" if big else "<"
    link, _, snap = struct.unpack_from(f"{order}HHI", raw, at + 8)
    tick, shift = 1e-6, 0.0
    p, end = at + 16, at + length - 4
    while p + 4 <= end:
        code, size = struct.unpack_from(f"{order}HH", raw, p)
        if code == 0 or p + 4 + size > end:
            break
        if code == 9 and size == 1:
            value = raw[p + 4]
            tick = 2.0 ** -(value & 127) if value & 128 else 10.0**-value
        elif code == 14 and size == 8:
            shift = float(struct.unpack_from(f"{order}q", raw, p + 4)[0])
        p += 4 + (size + 3) // 4 * 4
    return _Interface(link, snap, tick, shift)


def _blocks(
    data: ByteArray, blocks: IntArray, big: bool, interfaces: list[_Interface], base: int, tally: Tally, pieces: _Pieces,
    stray: _Stray,
) -> Iterator[Portion]:  # fmt: skip
    """The packets of enhanced (6), simple (3) and old (2) packet blocks."""
    blocks = blocks[np.isin(blocks[:, 2], (2, 3, 6)) & (blocks[:, 1] >= 20)]
    if not len(blocks):
        return
    at, long, kind = blocks[:, 0], blocks[:, 1], blocks[:, 2]
    simple = kind == 3
    number = np.where(simple, 0, np.where(kind == 6, _words(data, at + 8, big), 0))
    old = kind == 2
    if old.any():
        first, second = data[at[old] + 8].astype(np.int64), data[at[old] + 9].astype(np.int64)
        number[old] = first << 8 | second if big else second << 8 | first
    known = number < len(interfaces)
    for place in at[~known].tolist():
        tally.damaged.append(Damage(base + place, "the packet is of an interface that was not described"))
    at, long, simple, number = at[known], long[known], simple[known], number[known]
    if not len(at):
        return
    snap = np.array([i.snap or _LONGEST for i in interfaces])[number]
    whole = np.where(simple, _words(data, at + 8, big), _words(data, at + 24, big))
    taken = np.where(simple, np.minimum(whole, snap), _words(data, at + 20, big))
    frame = np.where(simple, at + 12, at + 28)
    taken = np.minimum(taken, at + long - 4 - frame)
    ticks = (_words(data, at + 12, big).astype(np.float64) * 4294967296.0 + _words(data, at + 16, big)) * np.array(
        [i.tick for i in interfaces]
    )[number] + np.array([i.shift for i in interfaces])[number]
    seconds = np.where(simple, np.nan, ticks)
    good = taken >= 0
    links = np.array([i.link for i in interfaces])[number]
    yield from _found(data, frame[good], taken[good], whole[good], seconds[good], links[good], base, tally, pieces, stray)


def _unreadable(path: str | Path, links: set[int]) -> InputError:
    names = ", ".join(link_name(link) for link in sorted(links))
    readable = ", ".join(link_name(link) for link in (1, 113, 276, 101, 0))
    return InputError(
        f"the packets of this capture are of link type {names}, which cannot be read", path=path,
        remedy=f"Known link types: {readable}.  Convert the capture (editcap -T), or record it on another interface.",
    )  # fmt: skip


@dataclass(slots=True)
class _Stray:
    """What speaks for a wrong link type: packets without IP, and how many of them would be IP of another one."""

    without: int = 0
    as_raw: int = 0
    as_ethernet: int = 0

    def check(self, path: str | Path, tally: Tally) -> None:
        """Raise InputError where no packet holds a datagram, with what the packets look like."""
        unreadable = {link for link in tally.links if link not in READABLE}
        if tally.datagrams or not tally.packets:
            return
        if unreadable and len(unreadable) == len(tally.links):
            raise _unreadable(path, unreadable)
        names = ", ".join(link_name(link) for link in sorted(tally.links))
        if self.without and max(self.as_raw, self.as_ethernet) > 0.5 * self.without:
            likely = 101 if self.as_raw >= self.as_ethernet else 1
            raise InputError(
                f"the capture says that its link type is {names}, but its packets look like {link_name(likely)}", path=path,
                remedy=f"Correct the link type (editcap -T {'rawip' if likely == 101 else 'ether'}).",
            )  # fmt: skip
        raise InputError(
            f"none of the {tally.packets} packets of this capture (link type {names}) holds a UDP datagram", path=path,
            remedy="ASTERIX is looked for in UDP over IPv4 or IPv6.",
        )  # fmt: skip


def _found(
    data: ByteArray, frame: IntArray, taken: IntArray, whole: IntArray, seconds: FloatArray, links: IntArray, base: int,
    tally: Tally, pieces: _Pieces, stray: _Stray,
) -> Iterator[Portion]:  # fmt: skip
    """The UDP datagrams of frames that lie at `frame` (k,) in the data."""
    n = len(frame)
    if not n:
        return
    tally.packets += n
    for link, count in zip(*np.unique(links, return_counts=True), strict=True):
        tally.links[int(link)] += int(count)
    # A damaged stamp must not move records by years.
    known = seconds[np.isfinite(seconds)]
    strange = np.isfinite(seconds) & ((seconds < 0) | (seconds > _LATEST))
    if len(known):
        strange |= np.abs(seconds - np.median(known)) > _APART_S
        strange |= _astray(np.where(strange, np.nan, seconds))
    if strange.any():
        tally.untimed += int(np.count_nonzero(strange))
        seconds = np.where(strange, np.nan, seconds)
    end = frame + taken
    last = len(data) - 1
    at, kind = _network(data, frame, end, links)
    version = data[np.minimum(at, last)] >> 4
    four = (kind == 0x0800) & (version == 4) & (at + 20 <= end)
    six = (kind == 0x86DD) & (version == 6) & (at + 40 <= end)
    if not (four | six).all():
        lost = ~(four | six)
        stray.without += int(np.count_nonzero(lost))
        for shift, name in ((0, "as_raw"), (14, "as_ethernet")):
            first = data[np.minimum(frame[lost] + shift, last)]
            looks = (first == 0x45) | (first >> 4 == 6)
            if shift:
                looks &= np.isin(_shorts(data, frame[lost] + 12), (0x0800, 0x86DD))
            setattr(stray, name, getattr(stray, name) + int(np.count_nonzero(looks)))
    head = np.where(four, (data[np.minimum(at, last)] & 15).astype(np.int64) * 4, 40)
    total = np.where(four, _shorts(data, at + 2), _shorts(data, at + 4) + 40)
    following = np.where(four, data[np.minimum(at + 9, last)], data[np.minimum(at + 6, last)])
    # Senders that leave the cutting to the network card write no length.
    stop = np.where(((four) & (total == 0)) | (six & (total == 40)), end, at + total)
    split = four & (_shorts(data, at + 6) & 0x3FFF != 0)
    slow = split & (following == 17) | six & np.isin(following, (0, 43, 44, 60, 51))
    udp = (four | six) & (following == 17) & ~slow & (head >= 20)
    begin = at + head
    size = _shorts(data, begin + 4)
    size = np.where(size == 0, stop - begin, size)
    good = udp & (begin + 8 <= end) & (size >= 8)
    fits = good & (begin + size <= np.minimum(end, stop))
    cut = udp & ~fits
    tally.cut += int(np.count_nonzero(cut))
    for k in np.flatnonzero(cut).tolist():
        why = "the packet was captured in part" if taken[k] < whole[k] else "the datagram is longer than its packet"
        tally.damaged.append(Damage(base + int(frame[k]), f"{why}: {int(taken[k])} of {int(whole[k])} bytes are there"))
    # What is there of a datagram that was cut is still read: it may hold whole blocks.
    partly = cut & good
    use = fits | partly
    tally.other += int(np.count_nonzero(~(use | slow | cut)))
    place = begin + 8
    length = np.where(fits, size - 8, np.maximum(np.minimum(end, stop) - place, 0))
    if not slow.any():
        yield from _portion(data, place[use], length[use], seconds[use], base, tally)
        return
    # In the order of the packets: runs of whole datagrams, and those that their last piece completes.
    low = 0
    for k in np.flatnonzero(slow).tolist():
        joined = pieces.add(data, int(at[k]), int(min(end[k], stop[k])), float(seconds[k]), base)
        if joined is not None:
            run = np.arange(low, k)[use[low:k]]
            yield from _portion(data, place[run], length[run], seconds[run], base, tally)
            low = k + 1
            yield from _joined(joined, float(seconds[k]), tally)
    run = np.arange(low, n)[use[low:]]
    yield from _portion(data, place[run], length[run], seconds[run], base, tally)


def _astray(seconds: FloatArray) -> BoolArray:
    """Which times stand alone: hardly any packet around has one like it, and it is out of order or half a day apart."""
    known = np.flatnonzero(np.isfinite(seconds))
    out = np.zeros(len(seconds), bool)
    time_s = seconds[known]
    if len(time_s) < 2 * _AROUND or not (np.abs(np.diff(time_s)) > _NEAR_S).any():
        return out
    around = np.lib.stride_tricks.sliding_window_view(np.pad(time_s, _AROUND, constant_values=np.nan), 2 * _AROUND + 1)
    alone = np.count_nonzero(np.abs(around - time_s[:, None]) <= _NEAR_S, axis=1) <= _FEW
    if alone.all():
        return out
    good = np.flatnonzero(~alone)
    place = np.searchsorted(good, np.flatnonzero(alone))
    before, after = time_s[good[np.maximum(place - 1, 0)]], time_s[good[np.minimum(place, len(good) - 1)]]
    mine = time_s[alone]
    outside = (mine < np.minimum(before, after) - _NEAR_S) | (mine > np.maximum(before, after) + _NEAR_S)
    inner = (place > 0) & (place < len(good))
    apart = np.minimum(np.abs(mine - before), np.abs(mine - after)) > 43200.0
    out[known[alone]] = (outside & inner) | apart
    return out


def _network(data: ByteArray, frame: IntArray, end: IntArray, links: IntArray) -> tuple[IntArray, IntArray]:
    """Where the network layer of each frame begins, and its EtherType (0: none)."""
    at, kind = frame.copy(), np.zeros(len(frame), np.int64)
    for link in np.unique(links).tolist():
        alone = (links == link).all()
        mine = slice(None) if alone else links == link
        here = frame[mine]
        if link in _ETHERNET:
            at[mine], kind[mine] = here + 14, _shorts(data, here + 12)
        elif link in _SLL:
            at[mine], kind[mine] = here + 16, _shorts(data, here + 14)
        elif link in _SLL2:
            at[mine], kind[mine] = here + 20, _shorts(data, here)
        elif link in _RAW or link in _NULL:
            here = here + (4 if link in _NULL else 0)
            version = data[np.minimum(here, len(data) - 1)] >> 4
            at[mine], kind[mine] = here, np.where(version == 4, 0x0800, np.where(version == 6, 0x86DD, 0))
    for _ in range(4):
        tagged = np.isin(kind, (0x8100, 0x88A8, 0x9100))
        if not tagged.any():
            break
        kind[tagged] = _shorts(data, at[tagged] + 2)
        at[tagged] += 4
    # IEEE 802.3 frames tell their length instead, and their kind behind a SNAP header.
    snap = (kind > 0) & (kind <= 1500)
    if snap.any():
        snap[snap] = (_shorts(data, at[snap]) == 0xAAAA) & (_shorts(data, at[snap] + 2) == 0x0300)
        kind[snap] = _shorts(data, at[snap] + 6)
        at[snap] += 8
    kind[at >= end] = 0
    return at, kind


def _portion(
    data: ByteArray, place: IntArray, length: IntArray, seconds: FloatArray, base: int, tally: Tally
) -> Iterator[Portion]:
    some = length > 0
    if not some.all():
        place, length, seconds = place[some], length[some], seconds[some]
    if not len(place):
        return
    tally.datagrams += len(place)
    out = np.empty(int(length.sum()), np.uint8)
    _copy(data, np.ascontiguousarray(place), np.ascontiguousarray(length), out)
    yield Portion(out, np.cumsum(length) - length, place + base, seconds)


def _joined(joined: tuple[bytes, int], seconds: float, tally: Tally) -> Iterator[Portion]:
    """A datagram that came in pieces, or behind extension headers: its UDP header is looked at here."""
    body, offset = joined
    size = int.from_bytes(body[4:6], "big")
    content = body[8 : size or len(body)]
    if len(body) < 8 or (size and size < 8) or size > len(body):
        tally.damaged.append(Damage(offset, "the datagram is longer than its packets"))
        tally.cut += 1
        return
    if content:
        tally.datagrams += 1
        yield Portion(np.frombuffer(content, np.uint8), np.zeros(1, np.int64), np.array([offset + 8]), np.array([seconds]))


@dataclass(slots=True)
class _Waiting:
    offset: int
    parts: dict[int, bytes] = field(default_factory=dict)
    total: int = -1


@dataclass(slots=True)
class _Pieces:
    """Datagrams whose pieces are waited for, and IPv6 packets with extension headers."""

    tally: Tally
    waiting: OrderedDict[tuple[bytes, ...], _Waiting] = field(default_factory=OrderedDict)

    def add(self, data: ByteArray, at: int, end: int, seconds: float, base: int) -> tuple[bytes, int] | None:
        """Take a packet; returns the datagram that it completes (with its UDP header) and where in the file that begins."""
        raw = data[at:end].tobytes()
        if raw[0] >> 4 == 4:
            head = (raw[0] & 15) * 4
            part = int.from_bytes(raw[6:8], "big")
            begin, more = (part & 0x1FFF) * 8, bool(part & 0x2000)
            return self._piece((raw[12:20], raw[4:6]), raw[head:], begin, more, base + at + head)
        following, p = raw[6], 40
        while p + 8 <= len(raw):
            if following in (0, 43, 60):
                following, p = raw[p], p + 8 + raw[p + 1] * 8
            elif following == 51:
                following, p = raw[p], p + 8 + raw[p + 1] * 4
            elif following == 44:
                part = int.from_bytes(raw[p + 2 : p + 4], "big")
                if raw[p] != 17:
                    break
                return self._piece(
                    (raw[8:40], raw[p + 4 : p + 8]), raw[p + 8 :], part & 0xFFF8, bool(part & 1), base + at + p + 8
                )
            elif following == 17:
                return raw[p:], base + at + p
            else:
                break
        self.tally.other += 1
        return None

    def _piece(self, key: tuple[bytes, ...], body: bytes, begin: int, more: bool, offset: int) -> tuple[bytes, int] | None:
        one = self.waiting.get(key)
        if one is None:
            if len(self.waiting) >= _WAITING:
                self._lost(self.waiting.popitem(last=False)[1])
            one = self.waiting[key] = _Waiting(offset)
        one.parts[begin] = body
        if begin == 0:
            one.offset = offset
        if not more:
            one.total = begin + len(body)
        if one.total < 0:
            return None
        out, p = bytearray(one.total), 0
        for at in sorted(one.parts):
            part = one.parts[at]
            if at > p:
                return None
            out[at : at + len(part)] = part[: max(0, one.total - at)]
            p = max(p, at + len(part))
        if p < one.total:
            return None
        del self.waiting[key]
        return bytes(out[: one.total]), one.offset

    def _lost(self, one: _Waiting) -> None:
        there = sum(len(part) for part in one.parts.values())
        told = f" of {one.total}" if one.total >= 0 else ""
        self.tally.damaged.append(Damage(one.offset, f"pieces of a datagram are missing: {there}{told} bytes are there"))

    def finish(self) -> Iterator[Portion]:
        """Count what never became whole."""
        for one in self.waiting.values():
            self._lost(one)
        self.waiting.clear()
        yield from ()


# ------------------------------------------------------------------------------------------------------ stamped block by block


def _stamped(file: BinaryIO, tally: Tally, kind: str, known: frozenset[int]) -> Iterator[Portion]:
    """Final format and GPS-stamped blocks.  Their stamps are times of day: midnight is taken where they fall by half a day."""
    base, mark = 0, b""
    if kind == "gps":
        head = file.read(1 << 16)
        base = max(_gps_begin(head, known), 0)
        file.seek(base)
        mark = _gps_mark(head, base)
    one = _final_record if kind == "final" else _gps_record
    rest, latest, day = b"", float("nan"), 0.0
    for chunk, final in _chunks(file):
        raw = rest + chunk
        content: list[bytes] = []
        places: list[int] = []
        stamps: list[float] = []
        pos = 0
        while pos < len(raw):
            begin, length, end, stamp = one(raw, pos, final, known, latest, mark)
            if end < 0:
                break
            if length < 0:
                why = f"no {'record' if kind == 'final' else 'stamped block'} begins here; {end - pos} bytes are skipped"
                tally.damaged.append(Damage(base + pos, why))
            else:
                if latest - stamp > 43200:
                    day += 86400.0
                elif stamp - latest > 43200:
                    day -= 86400.0
                latest = stamp
                content.append(raw[begin : begin + length])
                places.append(base + begin)
                stamps.append(day + stamp)
            pos = end
        rest, base = raw[pos:], base + pos
        tally.packets += len(content)
        tally.datagrams += len(content)
        if content:
            sizes = np.array([len(c) for c in content])
            data = np.frombuffer(b"".join(content), np.uint8)
            yield Portion(data, np.cumsum(sizes) - sizes, np.array(places), np.array(stamps))
    if rest:
        tally.damaged.append(Damage(base, f"the file ends within a record: {len(rest)} bytes are left of it"))


def _final_record(
    raw: bytes, pos: int, final: bool, known: frozenset[int], latest: float, mark: bytes
) -> tuple[int, int, int, float]:
    """(begin, length, end, time of day) of a final-format record; end -1: more is needed; length -1: none begins here."""
    if len(raw) - pos >= 2:
        end = pos + int.from_bytes(raw[pos : pos + 2], "big")
        if end >= pos + 12:
            if end > len(raw) and (not final or raw.find(_PAD, pos) < 0):
                return 0, 0, -1, 0.0
            stamp = int.from_bytes(raw[pos + 5 : pos + 8], "big") / 100.0
            if raw[end - 4 : end] == _PAD and stamp < 86400:
                return pos + 8, end - pos - 12, end, stamp
        found = raw.find(_PAD, pos)
        if found >= 0:
            return 0, -1, found + 4, 0.0
        return (0, -1, len(raw), 0.0) if final or len(raw) - pos > 1 << 17 else (0, 0, -1, 0.0)
    return 0, 0, -1, 0.0


def _gps_mark(head: bytes, base: int) -> bytes:
    """How all trailers begin; nothing where the first ones differ."""
    one, _ = _gps_stamp(head, base)
    two, _ = _gps_stamp(head, max(one, 0))
    mark = head[one - _GPS_TRAILER : one - _GPS_TRAILER + _GPS_MARK] if one > 0 else b""
    return mark if two > 0 and head[two - _GPS_TRAILER : two - _GPS_TRAILER + _GPS_MARK] == mark else b""


def _gps_stamp(raw: bytes, place: int) -> tuple[int, float]:
    """(end, time of day) of a block at `place` with its trailer, which has that time in 1/128 s from its seventh byte.

    The end is 0 where there can be none, -1 where more is needed to know.
    """
    if len(raw) - place < 3:
        return -1, 0.0
    length = int.from_bytes(raw[place + 1 : place + 3], "big")
    end = place + length + _GPS_TRAILER
    if length < 5:
        return 0, 0.0
    if end > len(raw):
        return -1, 0.0
    stamp = int.from_bytes(raw[end - 4 : end - 1], "big") / 128.0
    return (end, stamp) if stamp < 86400 else (0, 0.0)


def _gps_block(raw: bytes, place: int, final: bool, known: frozenset[int], latest: float, mark: bytes) -> tuple[int, float]:
    """As `_gps_stamp`, for what is a stamped block.

    Its trailer begins as the last one did (`mark`), with a time near that one's or behind a block of a known category (a recorder
    that was stopped meanwhile goes on hours later); or it goes so with the one that follows.
    """
    end, stamp = _gps_stamp(raw, place)
    if end <= 0:
        return (0 if final else end), stamp
    own = raw[end - _GPS_TRAILER : end - _GPS_TRAILER + len(mark)]
    if mark and raw.find(mark, place, end - _GPS_TRAILER) >= 0:
        # A length that is wrong ends at the trailer of another block.
        return 0, stamp
    near = not _apart_s(stamp, latest) > _GPS_APART_S
    if own == mark and (near or (mark and raw[place] in known) or (end == len(raw) and final)):
        return end, stamp
    follows, then = _gps_stamp(raw, end)
    if follows < 0 and not final:
        return -1, stamp
    if follows <= 0 or raw[place] not in known or raw[end] not in known or _apart_s(stamp, then) > _GPS_APART_S:
        return 0, stamp
    return (end, stamp) if raw[follows - _GPS_TRAILER : follows - _GPS_TRAILER + len(mark)] == own else (0, stamp)


def _apart_s(a: float, b: float) -> float:
    """How far two times of day are apart."""
    apart = abs(a - b)
    return min(apart, 86400.0 - apart)


def _gps_record(
    raw: bytes, pos: int, final: bool, known: frozenset[int], latest: float, mark: bytes
) -> tuple[int, int, int, float]:
    """The same for a block with its trailer; what is damaged ends where the next one begins."""
    stop = min(len(raw), pos + (1 << 17))
    for place in range(pos, stop):
        end, stamp = _gps_block(raw, place, final, known, latest, mark)
        if end < 0:
            return (0, 0, -1, 0.0) if place == pos else (0, -1, place, 0.0)
        if end:
            return (place, end - _GPS_TRAILER - place, end, stamp) if place == pos else (0, -1, place, 0.0)
    if final and stop == len(raw):
        return 0, 0, -1, 0.0
    return 0, -1, stop, 0.0


def whole(data: ByteArray, begin: IntArray) -> BoolArray:
    """Whether the lengths of the blocks of each datagram add up to its own: datagrams begin at `begin` (k,) in the data."""
    end = np.append(begin[1:], len(data))
    at = begin.copy()
    good = np.ones(len(begin), bool)
    active = np.flatnonzero(at < end)
    while len(active):
        here = at[active]
        length = _shorts(data, here + 1)
        follows = here + length
        bad = (length < 3) | (follows > end[active])
        good[active[bad]] = False
        at[active] = follows
        active = active[~bad & (follows < end[active])]
    return good


def unwrapped(portion: Portion, known: BoolArray) -> tuple[Portion, BoolArray]:
    """The portion without the headers that some recorders put ahead of each message, and whether each part is whole blocks.

    Such a header is a length (2 bytes, counting it) and the recorder's time of day (4 bytes, ms).  A datagram counts as wrapped
    where its own bytes are no blocks, the lengths add up to its own, and a category of `known` (256,) follows each header.
    """
    good = whole(portion.data, portion.begin)
    first = portion.data[portion.begin]
    suspects = np.flatnonzero(~(good & known[first]))
    if not len(suspects):
        return portion, good
    end = np.append(portion.begin[1:], len(portion.data))
    place, length, owner = [portion.begin], [end - portion.begin], [np.arange(len(end))]
    kept = np.ones(len(end), bool)
    for k in suspects.tolist():
        p, stop = int(portion.begin[k]), int(end[k])
        found: list[tuple[int, int]] = []
        while p + _HEADER + 3 <= stop and known[portion.data[p + _HEADER]]:
            size = int(portion.data[p]) << 8 | int(portion.data[p + 1])
            if size < _HEADER + 3 or p + size > stop:
                break
            found.append((p + _HEADER, size - _HEADER))
            p += size
        if found and p == stop:
            kept[k] = False
            place.append(np.array([a for a, _ in found]))
            length.append(np.array([b for _, b in found]))
            owner.append(np.full(len(found), k))
    if kept.all():
        return portion, good
    place[0], length[0], owner[0] = place[0][kept], length[0][kept], owner[0][kept]
    at, size_of, whose = np.concatenate(place), np.concatenate(length), np.concatenate(owner)
    order = np.argsort(at, kind="stable")
    at, size_of, whose = at[order], size_of[order], whose[order]
    out = np.empty(int(size_of.sum()), np.uint8)
    _copy(portion.data, at, size_of, out)
    begin = np.cumsum(size_of) - size_of
    offset = portion.offset[whose] + at - portion.begin[whose]
    part = Portion(out, begin, offset, portion.receive_s[whose])
    return part, whole(out, begin)


def runs(good: AnyArray) -> list[tuple[int, int, bool]]:
    """Runs of equal values as (from, to, value); those that are not good come one by one."""
    edges = np.flatnonzero(np.diff(good.astype(np.int8))) + 1
    out: list[tuple[int, int, bool]] = []
    for low, high in zip([0, *edges.tolist()], [*edges.tolist(), len(good)], strict=True):
        out += [(low, high, True)] if good[low] else [(k, k + 1, False) for k in range(low, high)]
    return out
