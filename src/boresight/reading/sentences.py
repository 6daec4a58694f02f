"""NMEA 0183 as text: lines to sentences, their checksums, fields and stamps.

Nothing here knows what a sentence means (`nmea` and `ais` do).  `scan` finds the sentences of a buffer by array operations alone:
every `$` or `!` may begin one, every `*` may end one, and the checksums of all stretches between them come from one running
exclusive or.  What does not add up is said with its offset; a sound sentence is found wherever it lies, behind rubbish, behind a
sentence that was cut, or after another one on the same line.
"""

from __future__ import annotations

import datetime
import re
from typing import NamedTuple

import numpy as np

from .._types import BoolArray, ByteArray, FloatArray, IntArray
from ..model import Damage

# No sentence is longer: the standard allows 82 bytes, real ones reach some 200.
LONGEST = 1024
# A line's stamp must be within these, 1980 to 2100: anything else is some other number.
_EARLIEST_S, _LATEST_S = 315532800.0, 4102444800.0

_END, _START, _STAR, _COMMA = 1, 2, 3, 4
_CLASS = np.zeros(256, np.uint8)
_CLASS[[10, 13]] = _END
_CLASS[[ord("$"), ord("!")]] = _START
_CLASS[ord("*")] = _STAR
_CLASS[ord(",")] = _COMMA
_HEX = np.full(256, 255, np.uint8)
_HEX[list(b"0123456789")] = np.arange(10)
_HEX[list(b"ABCDEF")] = np.arange(10, 16)
_HEX[list(b"abcdef")] = np.arange(10, 16)
_CAPITAL = np.zeros(256, bool)
_CAPITAL[65:91] = True
_NAME = _CAPITAL.copy()
_NAME[48:58] = True
_TEXT = np.zeros(256, bool)
_TEXT[32:127] = True
_TEXT[[9, 10, 13]] = True

_ISO = rb"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d)(?:[.,](\d{1,9}))?\s?(Z|[+-]\d\d:?\d\d)?"
# A stamp before a sentence: seconds, milli- or microseconds since 1970, or ISO time; then whatever names the source.
_BEFORE = re.compile(
    rb"\s*[\[(\"']?(?:(\d{16}|\d{13}|\d{9,10}(?:\.\d+)?)(?![\d.])|" + _ISO + rb")[\])\"']?(?:[;,:|\s][^$!\\]{0,80})?"
)
_AFTER = re.compile(rb"(?:[,;][A-Za-z][\w.-]*|[,;\"'])*[,;\s\"']*(\d{16}|\d{13}|\d{9,10}(?:\.\d+)?)\s*[\"']?")
_TAG = re.compile(rb"\\([^\\*]*)\*([0-9A-Fa-f]{2})\\")
_TAG_TIME = re.compile(rb"(?:^|,)c:(\d{9,16}(?:\.\d+)?)(?:,|$)")


class Scan(NamedTuple):
    """The sentences of a buffer, in its order.

    `data` is the buffer (with a few bytes added), `start` (n,) where each sentence's `$` or `!` is, `star` (n,) where its fields
    end; the address ("RATTM", up to eight bytes, big-endian) is `address` (n,).  `first` (n,) and `fields` (n,) tell which of the
    `commas` are its own.  `stamp_s` (n,) is the time that its line or its tag block carries (NaN: none).  Damage is at absolute
    offsets.  `consumed` bytes need not be given again.
    """

    data: ByteArray
    start: IntArray
    star: IntArray
    address: IntArray
    commas: IntArray
    first: IntArray
    fields: IntArray
    stamp_s: FloatArray
    damaged: list[Damage]
    consumed: int
    comments: int
    strange: int
    zoneless: int


def scan(data: bytes | memoryview | ByteArray, *, checksums: bool = True, final: bool = True, offset: int = 0) -> Scan:
    """Find the sentences of a buffer.

    `checksums` False accepts sentences without a checksum (a wrong one is damage all the same).  Unless `final`, what follows
    the last line end is left for the next call.  `offset` is where the buffer lies in its file, for the damage's offsets.
    """
    raw = np.frombuffer(data, np.uint8) if not isinstance(data, np.ndarray) else data
    if not final:
        ends = np.flatnonzero((raw[-LONGEST:] == 10) | (raw[-LONGEST:] == 13))
        if len(ends):
            raw = raw[: max(0, len(raw) - LONGEST) + int(ends[-1]) + 1]
        elif len(raw) <= LONGEST:
            raw = raw[:0]
        else:  # a line longer than any sentence: all but what may still become one can be judged now
            raw = raw[: len(raw) - LONGEST]
    consumed = len(raw)
    buffer = np.concatenate([raw, np.array([10, 0, 0, 0], np.uint8)])
    kind = _CLASS[buffer]
    marks = np.flatnonzero(kind)
    what = kind[marks]
    ends = marks[what == _END]
    starts = marks[what == _START]
    commas = np.append(marks[what == _COMMA], len(buffer))
    breaks = marks[(what == _END) | (what == _STAR)]
    running = np.bitwise_xor.accumulate(buffer)

    # Each start with the next line end or star, whichever comes first.
    segment = np.searchsorted(breaks, starts)
    stop = breaks[segment]
    starred = buffer[stop] == ord("*")
    given_high, given_low = _HEX[buffer[stop + 1]], _HEX[buffer[stop + 2]]
    has_hex = starred & (given_high < 16) & (given_low < 16)
    actual = running[stop - 1] ^ running[starts]
    sound = has_hex & ((given_high << 4 | (given_low & 15)) == actual)
    first = np.searchsorted(commas, starts)
    address_end = np.minimum(commas[first], stop)
    length = address_end - starts - 1
    proper = (length >= 4) & (length <= 15) & (stop - starts <= LONGEST)
    for k in range(1, 6):
        allowed = _CAPITAL if k == 1 else _NAME
        proper &= (k > length) | allowed[buffer[np.minimum(starts + k, len(buffer) - 1)]]
    if not checksums:
        sound |= ~starred
    sound &= proper

    # Of the starts before one star, the last that adds up is the sentence: what lies before it is the rest of a cut one.
    good = np.flatnonzero(sound)
    good = good[np.diff(segment[good], append=-1) != 0]
    bad = np.flatnonzero(~np.isin(segment, segment[good]))
    bad = bad[np.unique(segment[bad], return_index=True)[1]]

    start, star = starts[good], stop[good]
    # A start before the one that adds up is a sentence that was cut, unless it adds up as well (then it holds the other one).
    lead = np.searchsorted(segment, segment[good])
    cut = lead[(lead < good) & ~sound[lead]]
    damaged = [
        Damage(
            offset + int(starts[k]), f"{_show(bytes(buffer[starts[k] : starts[k] + 24]))} … is cut: another sentence begins in it"
        )
        for k in cut.tolist()
    ]
    damaged += [
        Damage(
            offset + int(starts[k]),
            _why(buffer, int(starts[k]), int(stop[k]), bool(starred[k]), bool(has_hex[k]), bool(proper[k])),
        )
        for k in bad.tolist()
    ]
    rubbish, comments, lines = _rubbish(buffer, ends, starts, offset)
    damaged += rubbish
    address = np.zeros(len(start), np.int64)
    for k in range(1, 8):
        address = np.where(k <= length[good], address << 8 | buffer[np.minimum(start + k, len(buffer) - 1)], address)
    stamp, strange, zoneless, broken = _stamps(buffer, start, star, ends, lines, offset)
    damaged += broken
    damaged.sort(key=lambda d: d.offset)
    count = np.searchsorted(commas, star) - first[good]
    return Scan(buffer, start, star, address, commas, first[good], count, stamp, damaged, consumed, comments, strange, zoneless)


def _why(buffer: ByteArray, start: int, stop: int, starred: bool, has_hex: bool, proper: bool) -> str:
    """Why a stretch that begins like a sentence is none."""
    head = _show(bytes(buffer[start : min(start + 24, stop)]))
    if stop - start > LONGEST:
        return f"{head} … runs on for {stop - start:,} bytes: no sentence is longer than {LONGEST:,}"
    if not starred:
        return f"{head} … is cut: it has no checksum"
    if not has_hex:
        return f"{head} … has no two hexadecimal digits after its *"
    given = bytes(buffer[stop + 1 : stop + 3]).decode("ascii").upper()
    actual = int(np.bitwise_xor.reduce(buffer[start + 1 : stop])) if stop > start + 1 else 0
    if not proper and int(given, 16) == actual:
        return f"{head} … does not begin with the address of a sentence"
    return f"{head} … has the checksum {given}, but its bytes give {actual:02X}"


def _show(text: bytes) -> str:
    return "".join(chr(c) if 32 <= c < 127 else "?" for c in text)


def _rubbish(buffer: ByteArray, ends: IntArray, starts: IntArray, offset: int) -> tuple[list[Damage], int, IntArray]:
    """Lines that hold no `$` or `!` at all, neighbours joined; the number of comment lines (`#`); where lines begin."""
    begin = np.concatenate([[0], ends + 1])[: len(ends)]
    holds = np.searchsorted(starts, ends) > np.searchsorted(starts, begin)
    rows = np.flatnonzero(~holds & (ends > begin))
    comments = 0
    out: list[Damage] = []
    last_row, from_, to, text = -2, 0, 0, True
    for row in rows.tolist():
        line = bytes(buffer[begin[row] : ends[row]])
        if not line.strip(b" \t\0"):
            continue
        if line.lstrip()[:1] == b"#":
            comments += 1
            continue
        plain = bool(_TEXT[np.frombuffer(line, np.uint8)].all())
        # An empty line (CR LF) may lie between neighbours.
        if out and row - last_row <= 2 and int(begin[row]) - to <= 2:
            to, text = int(ends[row]), text and plain
            out.pop()
        else:
            from_, to, text = int(begin[row]), int(ends[row]), plain
        last_row = row
        what = f"{_show(bytes(buffer[from_ : from_ + 24]))!r} … is text" if text else "these are bytes"
        out.append(Damage(offset + from_, f"{what}, but no NMEA sentence ({to - from_:,} bytes)"))
    return out, comments, begin


def _stamps(
    buffer: ByteArray, start: IntArray, star: IntArray, ends: IntArray, lines: IntArray, offset: int
) -> tuple[FloatArray, int, int, list[Damage]]:
    """The time (n,) of each sentence's tag block or line; how many lines begin with something else; damaged tag blocks."""
    stamp = np.full(len(start), np.nan)
    if not len(start):
        return stamp, 0, 0, []
    row = np.searchsorted(ends, start)
    begin = lines[row]
    same = np.zeros(len(start), bool)
    same[1:] = row[1:] == row[:-1]
    begin[1:] = np.where(same[1:], np.minimum(star[:-1] + 3, start[1:]), begin[1:])
    strange = zoneless = 0
    damaged: list[Damage] = []
    for k in np.flatnonzero(start > begin).tolist():
        text = bytes(buffer[begin[k] : start[k]])
        if text.isspace():
            continue
        for found in _TAG.finditer(text):
            time = _TAG_TIME.search(found[1])
            check = 0
            for c in found[1]:
                check ^= c
            if check != int(found[2], 16):
                place = offset + int(begin[k]) + found.start()
                damaged.append(Damage(place, f"a tag block has the checksum {found[2].decode()}, but its bytes give {check:02X}"))
            elif time is not None:
                stamp[k] = _epoch(time[1])
        rest = _TAG.sub(b"", text)
        if rest.strip() and np.isnan(stamp[k]):
            before = _BEFORE.fullmatch(rest)
            if before is not None:
                stamp[k] = _epoch(before[1]) if before[1] else _iso(before)
                zoneless += not before[1] and not before[9]
            if not _TEXT[np.frombuffer(rest, np.uint8)].all():
                damaged.append(
                    Damage(offset + int(begin[k]), f"there are {len(rest):,} bytes that are no NMEA before a sentence")
                )
            elif np.isnan(stamp[k]) and not same[k]:
                strange += b"$" not in rest and b"!" not in rest
    # Text behind the checksum: some loggers put the time there.
    after = star + 3
    limit = ends[row]
    limit[:-1] = np.where(same[1:], start[1:], limit[:-1])
    for k in np.flatnonzero((limit - after >= 10) & np.isnan(stamp)).tolist():
        behind = _AFTER.fullmatch(bytes(buffer[after[k] : limit[k]][:120]))
        if behind is not None:
            stamp[k] = _epoch(behind[1])
    return stamp, strange, zoneless, damaged


def _epoch(digits: bytes) -> float:
    """Seconds since 1970 of a number of seconds, milli- or microseconds; NaN where that is not within 1980 to 2100."""
    value = float(digits)
    for scale in (1.0, 1e3, 1e6):
        if _EARLIEST_S <= value / scale <= _LATEST_S:
            return value / scale
    return float("nan")


def _iso(found: re.Match[bytes]) -> float:
    year, month, day, hour, minute, second = (int(found[k]) for k in range(2, 8))
    try:
        time = datetime.datetime(year, month, day, hour, minute, min(second, 59), tzinfo=datetime.UTC).timestamp()
    except ValueError:
        return float("nan")
    time += (second == 60) + float(b"0." + (found[8] or b"0"))
    zone = found[9] or b"Z"
    if zone != b"Z":
        ahead = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        time -= ahead if zone[:1] == b"+" else -ahead
    return time if _EARLIEST_S <= time <= _LATEST_S else float("nan")


# ------------------------------------------------------------------------------------------------------------------- fields


class Numbers(NamedTuple):
    """A field of many sentences as decimal numbers: `value` (n,), NaN where it is `empty` or `bad` (not a number)."""

    value: FloatArray
    whole: IntArray
    decimals: IntArray
    empty: BoolArray
    bad: BoolArray


def bounds(s: Scan, rows: IntArray, field: int) -> tuple[IntArray, IntArray]:
    """Where field number `field` (from 1) of the sentences `rows` (n,) begins and ends; nothing where there is no such field."""
    there = field <= s.fields[rows]
    at = np.minimum(s.first[rows] + field - 1, len(s.commas) - 1)
    begin = np.where(there, s.commas[at] + 1, 0)
    end = np.where(there, np.minimum(s.commas[np.minimum(at + 1, len(s.commas) - 1)], s.star[rows]), 0)
    return begin, end


def numbers(s: Scan, rows: IntArray, field: int) -> Numbers:
    """Field number `field` (from 1) of the sentences `rows` (n,) as numbers: sign, digits, one point, blanks around them."""
    begin, end = bounds(s, rows, field)
    width = end - begin
    n, longest = len(rows), int(min(width.max(initial=0), 24))
    whole, decimals, digits = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    pointed, negative, begun, ended = np.zeros(n, bool), np.zeros(n, bool), np.zeros(n, bool), np.zeros(n, bool)
    bad = width > 24
    for k in range(longest):
        here = k < width
        c = np.where(here, s.data[np.where(here, begin + k, 0)], 32)
        digit = (c >= 48) & (c <= 57)
        whole = np.where(digit & (digits < 18), whole * 10 + (c.astype(np.int64) - 48), whole)
        digits += digit
        decimals += digit & pointed
        point = c == 46
        sign = (c == 45) | (c == 43)
        blank = c == 32
        bad |= here & ~(digit | point | sign | blank) | point & pointed | sign & begun | ~blank & ended
        pointed |= point
        negative |= c == 45
        ended |= blank & begun
        begun |= ~blank
    empty = ~begun & ~bad
    bad |= (digits > 17) | begun & (digits == 0)
    value = np.where(negative, -1.0, 1.0) * whole / 10.0**decimals
    value[bad | empty] = np.nan
    return Numbers(value, whole, decimals, empty, bad)


def letters(s: Scan, rows: IntArray, field: int) -> ByteArray:
    """The one letter of field number `field` (from 1), in capitals; 0 where it is empty, 255 where it is longer than one byte."""
    begin, end = bounds(s, rows, field)
    c = np.where(end > begin, s.data[begin], 0).astype(np.uint8)
    c = np.where(end - begin > 1, 255, c)
    return np.where((c >= 97) & (c <= 122), c - 32, c).astype(np.uint8)


def words(s: Scan, rows: IntArray, field: int) -> IntArray:
    """The text of field number `field` (from 1), in capitals, packed like an address; 0 where empty, -1 where beyond 7 bytes."""
    begin, end = bounds(s, rows, field)
    out = np.zeros(len(rows), np.int64)
    for k in range(7):
        here = begin + k < end
        c = np.where(here, s.data[np.where(here, begin + k, 0)], 0).astype(np.int64)
        out = np.where(here, out << 8 | np.where((c >= 97) & (c <= 122), c - 32, c), out)
    return np.where(end - begin > 7, -1, out)


def clock(s: Scan, rows: IntArray, field: int) -> tuple[FloatArray, BoolArray]:
    """Seconds of the day (n,) of a field hhmmss.ss, NaN where it is empty; and where it is no time of day (n,)."""
    v = numbers(s, rows, field)
    scale = 10 ** np.minimum(v.decimals, 12)
    seconds = v.whole // scale
    hour, minute, second = seconds // 10000, seconds // 100 % 100, seconds % 100
    bad = v.bad | (v.value < 0) | (~v.empty & ((hour > 23) | (minute > 59) | (second > 60)))
    out = hour * 3600.0 + minute * 60.0 + second + (v.whole % scale) / scale
    out[v.empty | bad] = np.nan
    return out, bad


def degrees(s: Scan, rows: IntArray, field: int, positive: str, negative: str) -> tuple[FloatArray, BoolArray]:
    """Degrees (n,) of a field (d)ddmm.mmm and the letter of its hemisphere in the next one; and where they make no sense (n,).

    `positive` and `negative` are the letters (N and S, E and W); NaN where the field is empty.
    """
    v = numbers(s, rows, field)
    side = letters(s, rows, field + 1)
    scale = 10 ** np.minimum(v.decimals, 14)
    whole = v.whole // (scale * 100)
    minutes = v.whole % (scale * 100) / scale
    out = whole + minutes / 60.0
    limit = 90.0 if positive == "N" else 180.0
    known = (side == ord(positive)) | (side == ord(negative))
    bad = v.bad | ~v.empty & (~known | (v.value < 0) | (minutes >= 60) | (out > limit))
    out = np.where(side == ord(negative), -out, out)
    out[v.empty | bad] = np.nan
    return out, bad


def address_of(name: str) -> int:
    """The number that `Scan.address` has for an address."""
    return int.from_bytes(name.encode("ascii")[:7], "big")


def name_of(address: int) -> str:
    """The address behind a number of `Scan.address`."""
    return address.to_bytes(8, "big").lstrip(b"\0").decode("ascii", "replace")
