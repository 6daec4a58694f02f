"""ASTERIX: raw data blocks to columns.

`decode` does no input or output: bytes and a state go in, tables and the next state come out, for files and datagrams alike.
`read_asterix` serves files, `decode_items` shows single records.  One kernel walks the field specifications (FSPEC) of all
records with the tables of `uap` and notes where each item lies; a second one takes bits from there into columns.

What is damaged costs itself only: a record that does not add up is skipped and said, with its offset and the reason, and reading
goes on where blocks fit together again.
"""

from __future__ import annotations

import datetime
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from .._jit import kernel
from .._types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from ..errors import InputError
from ..model import Channel, Damage, Fixes, Flag, Marks, Plots, Recording, Source, Tracks, unpack_callsigns
from . import uap
from .capture import CHUNK, READABLE, Tally, kind_of, link_name, portions, runs, unwrapped

DAY_S = 86400.0
EARTH_M = 6371000.0
# Rows of the table of item offsets that are filled at once: 65,535 bytes hold at most 21,845 records, so a block always fits.
_ROWS = 1 << 16
# Bytes that are searched at once for where blocks fit together again: no block is longer.
_SKIP = 1 << 16
# So far blocks of categories without a table may follow each other until one with a table shows that they are blocks.
_CHAIN = 1 << 16
_AHEAD = 512
# Datagrams of a portion that are decoded one by one because their blocks do not add up; where there are more, they are a stream.
_APART = 2000
# Blocks that are looked at to infer an edition: few enough for a stream to start soon, many enough not to be fooled.
_SAMPLE = 16
# Fewer positions than these say nothing of an edition: they may as well be damaged.
_JUDGED = 8
# Records that follow each other in a sample of a file are this close in time, whatever the file.
_GAP_S = 3600.0
# A stamp that is further than this from the one ahead of it is doubted until another one confirms it.
_LEAP_S = 600.0
# What is not known of the time of a position where only the report's transmission is stamped (METHODS section 6).
TRANSMISSION_SD_S = 0.5
# What no target can be: a value beyond these limits is taken for damage and left out.  Heights are those that category 021 allows
# (-15 to 1,500 flight levels), with room for the geoid where they are geometric; speeds reach beyond those of any aircraft.
_LIMITS = {
    "pressure_altitude_m": (-457.2, 45720.0),
    "height_m": (-700.0, 46000.0),
    "speed_mps": (0.0, 2000.0),
    "velocity_east_mps": (-2000.0, 2000.0),
    "velocity_north_mps": (-2000.0, 2000.0),
    "velocity_up_mps": (-500.0, 500.0),
}
_SAID = {
    "pressure_altitude_m": "pressure altitude",
    "height_m": "height",
    "speed_mps": "speed",
    "velocity_east_mps": "velocity east",
    "velocity_north_mps": "velocity north",
    "velocity_up_mps": "vertical rate",
}
# Digests of records that are held at once to find duplicates (32 MB), and the shares of those of longer recordings on disk.
_HELD = 1 << 22
_SHARES = 64

# How a walk ended.
_MORE, _FULL, _RECORD, _HEADER, _STRANGE, _PENDING, _CUT = range(7)
# Why a record does not add up; the kernel returns these times 1,000, plus the number of the FSPEC bit.
_WHY = {
    1: "the list of its items (FSPEC) does not end within its block",
    2: "it claims an item that its category does not have (FSPEC bit {frn})",
    3: "the item of FSPEC bit {frn} runs over the end of its block",
    4: "the item of FSPEC bit {frn} has an impossible length",
    5: "it has no data source identifier (item 010), which every record must have",
}

# --------------------------------------------------------------------------------------------------------- tables as arrays


class Layout(NamedTuple):
    """The tables of some categories as arrays, for the kernels.

    `cats` (257, 4): the first node of a category (-1: unknown, -2: its edition is not known yet), the number of its FSPEC bits,
    the bit of its data source identifier, the row of its second list of items (0: none).  `nodes` (n, 7): kind, size, step, most,
    first sub-node, number of sub-nodes, slot.  A slot is a column of the table of item offsets.
    """

    cats: IntArray
    nodes: IntArray
    width: int


@cache
def _slots(category: int, edition: str) -> dict[str, int]:
    """The slot of each item ("040") and sub-item ("130/RPD")."""
    items = uap.items_of(category, edition)
    out = {item.name: n for n, item in enumerate(items) if item is not None}
    at = len(items)
    for item in items:
        if item is not None:
            for sub in item.subitems:
                if sub is not None:
                    out[f"{item.name}/{sub.name}"] = at
                at += 1
    return out


@cache
def _layout(editions: tuple[tuple[int, str], ...], pending: tuple[int, ...]) -> Layout:
    cats = np.full((257, 4), -1, np.int64)
    cats[:, 3] = 0
    rows: list[list[int]] = []
    width = 1
    for category, edition in [*editions, *((uap.SECOND[c], e) for c, e in editions if c in uap.SECOND)]:
        items = uap.items_of(category, edition)
        base, at = len(rows), len(items)
        cats[category] = base, len(items), _slots(category, edition)["010"], uap.SECOND.get(category, 0)
        children: list[list[int]] = []
        for slot, item in enumerate(items):
            if item is None:
                rows.append([uap.UNDEFINED, 0, 0, 0, 0, 0, slot])
                continue
            rows.append([item.kind, item.size, item.step, item.most, base + at, len(item.subitems), slot])
            for sub in item.subitems:
                children.append([0, 0, 0, 0, 0, 0, at] if sub is None else [sub.kind, sub.size, sub.step, sub.most, 0, 0, at])
                at += 1
        rows.extend(children)
        width = max(width, at)
    for category in pending:
        cats[category, 0] = -2
    return Layout(cats, np.array(rows, np.int64), width)


def _layout_of(editions: Mapping[int, str]) -> Layout:
    """The layout for these editions; other categories have their usual one, or wait for it to be inferred."""
    known: list[tuple[int, str]] = []
    pending: list[int] = []
    for category in uap.categories():
        if category in editions:
            known.append((category, editions[category]))
        elif category in uap.INFERRED:
            pending.append(category)
        else:
            known.append((category, uap.default_edition(category)))
    return _layout(tuple(known), tuple(pending))


# ------------------------------------------------------------------------------------------------------------------ kernels


# A byte as a signed integer.  Numba makes int() of a byte unsigned, and unsigned with signed is a float.
_int: Any = np.int64


@kernel
def _after(data: ByteArray, q: int, end: int, kind: int, size: int, step: int, most: int) -> int:
    """Where an item that begins at `q` ends; -3 where it runs over `end`, -4 where its length is impossible."""
    if kind == 1:
        q += size
    elif kind == 2:
        q += size
        more = 0
        while q <= end and data[q - 1] & 1 and (most == 0 or more < most):
            q += step
            more += 1
    elif kind == 3:
        if q >= end:
            return -3
        q += 1 + size * _int(data[q])
    else:
        if q >= end:
            return -3
        if data[q] == 0:
            return -4
        q += _int(data[q])
    return q if q <= end else -3


@kernel
def _record(data: ByteArray, p: int, end: int, cats: IntArray, nodes: IntArray, category: int, row: AnyArray) -> int:
    """Walk one record that begins at `p`: its items' places go to `row`; returns where it ends, or -(reason * 1000 + bit)."""
    q = p
    while q < end and data[q] & 1:
        q += 1
    if q >= end:
        return -1000
    q += 1
    octets = q - p
    if cats[category, 3] and data[p] & 0x40:
        # The first bit of item 020, which follows item 010, chooses the list of items.
        n = q + 2 if data[p] & 0x80 else q
        if n < end and data[n] & 0x80:
            category = cats[category, 3]
    first, count, identifier = cats[category, 0], cats[category, 1], cats[category, 2]
    for octet in range(octets):
        bits = _int(data[p + octet])
        if bits & 0xFE == 0:
            continue
        for k in range(7):
            if bits & (0x80 >> k) == 0:
                continue
            n = octet * 7 + k
            if n >= count:
                return -2000 - n - 1
            node = first + n
            kind = nodes[node, 0]
            if kind == 0:
                return -2000 - n - 1
            row[n] = q - p
            if kind == 1:
                q += nodes[node, 1]
                if q > end:
                    return -3000 - n - 1
            elif kind == 6:
                # Random field sequencing: passed over.
                if q >= end:
                    return -3000 - n - 1
                left = _int(data[q])
                q += 1
                while left:
                    if q >= end:
                        return -3000 - n - 1
                    m = _int(data[q]) - 1
                    if m < 0 or m >= count:
                        return -4000 - n - 1
                    child = first + m
                    if nodes[child, 0] == 0 or nodes[child, 0] > 4:
                        return -4000 - n - 1
                    q = _after(data, q + 1, end, nodes[child, 0], nodes[child, 1], nodes[child, 2], nodes[child, 3])
                    if q < 0:
                        return q * 1000 - n - 1
                    left -= 1
            elif kind != 5:
                q = _after(data, q, end, kind, nodes[node, 1], nodes[node, 2], nodes[node, 3])
                if q < 0:
                    return q * 1000 - n - 1
            else:
                # A compound item: its own FSPEC, then the sub-items.
                f = q
                while q < end and data[q] & 1:
                    q += 1
                if q >= end:
                    return -3000 - n - 1
                q += 1
                for sub_octet in range(q - f):
                    bits2 = _int(data[f + sub_octet])
                    for j in range(7):
                        if bits2 & (0x80 >> j) == 0:
                            continue
                        m = sub_octet * 7 + j
                        if m >= nodes[node, 5]:
                            return -4000 - n - 1
                        child = nodes[node, 4] + m
                        if nodes[child, 0] == 0:
                            return -4000 - n - 1
                        row[nodes[child, 6]] = q - p
                        q = _after(data, q, end, nodes[child, 0], nodes[child, 1], nodes[child, 2], nodes[child, 3])
                        if q < 0:
                            return q * 1000 - n - 1
    if row[identifier] == 0:
        return -5000
    return q


@kernel
def _records(
    data: ByteArray, start: IntArray, length: IntArray, cats: IntArray, nodes: IntArray, category: int, items: AnyArray
) -> int:
    """Walk records of one category that begin at `start` (n,): their items' places go to `items`; returns how many do not fit."""
    bad = 0
    for i in range(len(start)):
        end = start[i] + length[i]
        if _record(data, start[i], end, cats, nodes, category, items[i]) != end:
            items[i] = 0
            bad += 1
    return bad


@kernel
def _length(data: ByteArray, p: int) -> int:
    """The length that the block at `p` claims."""
    long: int = _int(data[p + 1]) << 8 | _int(data[p + 2])
    return long


@kernel
def _walk(
    data: ByteArray, pos: int, final: bool, cats: IntArray, nodes: IntArray,
    start: IntArray, length: IntArray, category: AnyArray, items: AnyArray,
) -> tuple[int, int, int, int, int, int, int]:  # fmt: skip
    """Read blocks from `pos` on; fills rows.

    Returns the number of rows, the block where it stopped, how, the record there, the reason, and for the block before it (whose
    end is only believed when what follows makes sense) the number of rows ahead of it and its place (-1: none).
    """
    size, n, room = len(data), 0, len(start)
    prev, rows_prev = -1, 0
    while True:
        if size - pos < 3:
            return n, pos, 0 if pos == size or not final else 6, pos, 0, rows_prev, prev
        cat = _int(data[pos])
        long = _length(data, pos)
        if long < 3:
            return n, pos, 3, pos, long, rows_prev, prev
        end = pos + long
        if end > size and not final:
            return n, pos, 0, pos, 0, rows_prev, prev
        first = cats[cat, 0]
        if first == -2:
            return n, pos, 5, pos, 0, rows_prev, prev
        if first < 0:
            return n, pos, 4, pos, 0, rows_prev, prev
        before = n
        p = pos + 3
        stop = min(end, size)
        while p < stop:
            if n == room:
                # No more room: the whole block waits for the next call.
                items[before:n] = 0
                return before, pos, 1, pos, 0, rows_prev, prev
            q = _record(data, p, stop, cats, nodes, cat, items[n])
            if q < 0:
                items[n] = 0
                return n, pos, 2, p, -q, rows_prev, prev
            start[n], length[n], category[n] = p, q - p, cat
            n += 1
            p = q
        if end > size:
            return n, pos, 6, p, 0, rows_prev, prev
        prev, rows_prev = pos, before
        pos = end


@kernel
def _strict(data: ByteArray, p: int, final: bool, cats: IntArray, nodes: IntArray, row: AnyArray) -> int:
    """Where a faultless block that begins at `p` ends; 0 where there is none, -1 where more data are needed to know."""
    size = len(data)
    if size - p < 3:
        return 0 if final else -1
    cat = _int(data[p])
    end = p + _length(data, p)
    if cats[cat, 0] < 0 or end < p + 5:
        return 0
    if end > size:
        return 0 if final else -1
    q = p + 3
    while q < end:
        row[:] = 0
        q = _record(data, q, end, cats, nodes, cat, row)
        if q < 0:
            return 0
    return end


@kernel
def _follows(data: ByteArray, p: int, final: bool, cats: IntArray, nodes: IntArray, row: AnyArray) -> int:
    """1 where the data end at `p` or a faultless block begins there, 0 where not, -1 where more data are needed to know."""
    if p == len(data) and final:
        return 1
    if len(data) - p >= 3 and cats[data[p], 0] == -2:
        # A block of a category whose edition is not known yet cannot be looked into.
        return 1 if _length(data, p) > 4 else 0
    return min(_strict(data, p, final, cats, nodes, row), 1)


@kernel
def _looks(data: ByteArray, p: int, final: bool, cats: IntArray) -> int:
    """As `_follows`, but for a block's header alone: a faulty block will do."""
    size = len(data)
    if p == size and final:
        return 1
    if size - p < 3:
        return 0 if final else -1
    return 1 if cats[data[p], 0] != -1 and _length(data, p) > 4 else 0


@kernel
def _sender(data: ByteArray, p: int, end: int, cats: IntArray, nodes: IntArray, row: AnyArray) -> int:
    """The category and the source of the faultless block at `p`, as one number."""
    row[:] = 0
    _record(data, p + 3, end, cats, nodes, _int(data[p]), row)
    at = p + 3 + _int(row[cats[data[p], 2]])
    sender: int = _int(data[p]) << 16 | _int(data[at]) << 8 | _int(data[at + 1])
    return sender


@kernel
def _related(data: ByteArray, p: int, q: int, final: bool, cats: IntArray, nodes: IntArray, row: AnyArray) -> int:
    """1 where soon behind `q` begins a faultless block of the sender of the one at `p`; 0: none, -1: only more data can tell."""
    size = len(data)
    sender = _sender(data, p, p + _length(data, p), cats, nodes, row)
    for r in range(q, min(q + 1024, size)):
        if data[r] == data[p]:
            end = _strict(data, r, final, cats, nodes, row)
            if end < 0 or (end > 0 and _sender(data, r, end, cats, nodes, row) == sender):
                return -1 if end < 0 else 1
    return 0 if final or size >= q + 1024 else -1


@kernel
def _hidden(
    data: ByteArray, low: int, high: int, end: int, crossing: bool, final: bool, cats: IntArray, nodes: IntArray, row: AnyArray
) -> int:
    """The first place in `low` … `high` where faultless blocks begin; 0: none, -1: only more data can tell.

    They must reach `end` or be two, and something like a block must follow, or soon one of the same category and source; with
    `crossing`, they must go beyond `end`.
    """
    size = len(data)
    for p in range(low, high):
        if cats[data[p], 0] < 0:
            continue
        q, blocks, first = p, 0, 0
        while q == p or (q < end and q < size):
            q = _strict(data, q, final, cats, nodes, row)
            blocks += 1
            if blocks == 1:
                first = q
            if q <= 0 or (blocks == 2 and not crossing):
                break
        if q == 0 and blocks == 2:
            # One between two that are damaged.
            q = _related(data, p, first, final, cats, nodes, row)
            if q == 1:
                return p
        if q > 0 and (q > end or not crossing):
            follows = q
            q = _looks(data, q, final, cats)
            if q == 0:
                q = _related(data, p, follows, final, cats, nodes, row)
            if q == 1:
                return p
        if q == -1:
            return -1
    return 0


@kernel
def _end_well(data: ByteArray, begin: IntArray, end: IntArray, cats: IntArray, nodes: IntArray, row: AnyArray) -> BoolArray:
    """Whether each part of the data, from `begin` (k,) to `end` (k,), ends with faultless blocks."""
    out = np.zeros(len(begin), np.bool_)
    for k in range(len(begin)):
        part = data[begin[k] : end[k]]
        for p in range(len(part)):
            q = p
            while 0 < q < len(part) or q == p:
                q = _strict(part, q, True, cats, nodes, row)
                if q == 0:
                    break
            if q == len(part):
                out[k] = True
                break
    return out


@kernel
def _pass_over(
    data: ByteArray,
    pos: int,
    final: bool,
    cats: IntArray,
    nodes: IntArray,
    unknown: IntArray,
    row: AnyArray,
    most: int,
    ahead: int,
) -> int:
    """Where blocks without a table that begin at `pos` end; `pos` where these are no blocks, -1 where only more data can tell.

    They are blocks if they lead, within `most` bytes, to one that can be read, to another of the same category or to the end of
    the data, and if none that can be read begins in them (looked at up to `ahead` bytes behind).  Counts them in `unknown`.
    """
    size, begin = len(data), pos
    while size - pos >= 3 and cats[data[pos], 0] == -1:
        end = pos + _length(data, pos)
        known, q = 0, end
        while end > pos + 2 and q <= size and q < end + most:
            known = _follows(data, q, final, cats, nodes, row)
            if known != 0 or size - q < 3 or cats[data[q], 0] >= 0 or _length(data, q) < 3:
                break
            if data[q] == data[pos]:
                known = 1
                break
            q += _length(data, q)
        if known == 0 and end > pos + 2 and q > size and not final:
            known = -1
        if known == 1 and q + ahead > size and not final:
            known = -1
        if known == 1 and _hidden(data[: q + ahead], pos + 3, q, q, False, True, cats, nodes, row) > 0:
            known = 0
        if known <= 0:
            return pos if known == 0 or pos > begin else -1
        unknown[data[pos]] += 1
        pos = end
    return pos


@kernel
def _resume(
    data: ByteArray, low: int, place: int, end: int, final: bool, cats: IntArray, nodes: IntArray, row: AnyArray, most: int
) -> int:
    """Where reading goes on after damage at `place`, in a block that has its records from `low` on and claims to end at `end`.

    Faultless blocks within it, two or up to that end, show that the length was wrong.  Else the length is believed if a faultless
    block follows.  Else the first faultless block is sought, within `most` bytes; the length is believed again if none lies
    before its end.  Returns -1 where only more data can tell.
    """
    size = len(data)
    p = _hidden(data, low, min(end, size), end, False, final, cats, nodes, row)
    if p != 0:
        return p
    if end <= size:
        known = _follows(data, end, final, cats, nodes, row) if end > place else 0
        if known != 0:
            return end if known == 1 else -1
    stop = place + most
    found = 0
    for p in range(place, min(stop, size)):
        found = _hidden(data, p, p + 1, p, False, final, cats, nodes, row)
        if found != 0:
            break
    if found == -1 or (found == 0 and size < stop and not final):
        return -1
    if found == 0:
        found = min(stop, size)
    if place < end <= found:
        # Two damaged blocks in a row: the second one must not reach beyond the first faultless one.
        known = _looks(data, end, final, cats)
        if known < 0 or (known == 1 and (end == size or end + _length(data, end) <= found)):
            return end if known == 1 else -1
    return found


@kernel
def _extract(
    data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, spec: IntArray, scale: FloatArray, table: IntArray,
    numbers: FloatArray, codes: IntArray, flags: IntArray,
) -> None:  # fmt: skip
    """Bits to columns.

    A row of `spec` is one field: slot, byte, bytes, shift, mask, sign bit, first part, step, part, what, out, guard byte, guard
    mask, limit (a value there says only that it is beyond).  What: 0 a quantity into `numbers[out]`, 1 a code into `codes[out]`,
    2 flags by `table[out]`, 3 the same for a list of codes that FX continues.
    """
    for k in range(len(rows)):
        i = rows[k]
        for m in range(len(spec)):
            at = _int(items[i, spec[m, 0]])
            if at == 0:
                continue
            at += start[i]
            what, out = spec[m, 9], spec[m, 10]
            if what == 3:
                while True:
                    flags[k] |= table[out, _int(data[at]) >> 1]
                    if data[at] & 1 == 0:
                        break
                    at += 1
                continue
            missing = False
            # Parts of an extended item that are not there.
            for j in range(spec[m, 8]):
                if data[at + spec[m, 6] - 1 + j * spec[m, 7]] & 1 == 0:
                    missing = True
            if missing or data[at + spec[m, 11]] & spec[m, 12]:
                continue
            value = 0
            for j in range(at + spec[m, 1], at + spec[m, 1] + spec[m, 2]):
                value = value << 8 | _int(data[j])
            value = value >> spec[m, 3] & spec[m, 4]
            if value & spec[m, 5]:
                value -= spec[m, 5] << 1
            if spec[m, 13] and (value == spec[m, 13] or value == -spec[m, 13] - 1):
                continue
            if what == 0:
                if np.isnan(numbers[out, k]):
                    numbers[out, k] = value * scale[m]
            elif what == 1:
                if codes[out, k] < 0:
                    codes[out, k] = value
            else:
                flags[k] |= table[out, value & 255]


@kernel
def _unwrap(
    tod: FloatArray, period: FloatArray, source: IntArray, receive: FloatArray, last: FloatArray, heard: FloatArray,
    doubted: FloatArray, latest: float, day_s: float, out: FloatArray,
) -> float:  # fmt: skip
    """Times of day to times since 1970 (s): each within half a day of its reception, else of its source's last or of `latest`.

    One that leaps away from the last is `doubted` until the next one of its source is near it: else two damaged ones in a row
    could lead all that follow to another day.

    A time with a `period` is the rest of a time of day by it: it is taken next to its source's last time (and what has passed
    since by the receiver's clock, `heard` being when that was received), else next to its reception.
    """
    for i in range(len(tod)):
        if np.isnan(tod[i]):
            continue
        near = last[source[i]]
        if period[i] == 0.0:
            if np.isnan(near):
                near = latest
            if not np.isnan(receive[i]):
                near = receive[i]
            t = day_s + tod[i]
            if not np.isnan(near):
                t = tod[i] + 86400.0 * np.rint((near - tod[i]) / 86400.0)
                if np.isnan(receive[i]) and abs(t - near) > _LEAP_S:
                    doubt = doubted[source[i]]
                    again = tod[i] + 86400.0 * np.rint((doubt - tod[i]) / 86400.0)
                    if np.isnan(doubt) or abs(again - doubt) > _LEAP_S:
                        out[i] = doubted[source[i]] = t
                        heard[source[i]] = receive[i]
                        continue
                    t = again
            doubted[source[i]] = np.nan
        else:
            passed = receive[i] - heard[source[i]]
            if np.isnan(near):
                near = receive[i]
            elif not np.isnan(passed):
                near += passed
            if np.isnan(near):
                continue
            # A day is no whole number of periods: each day is tried by itself.
            t = np.inf
            most = np.floor((86399.999 - tod[i]) / period[i])
            for day in range(-1, 2):
                begin = 86400.0 * (np.floor(near / 86400.0) + day) + tod[i]
                one = begin + period[i] * min(max(np.rint((near - begin) / period[i]), 0.0), most)
                if abs(one - near) < abs(t - near):
                    t = one
        out[i] = last[source[i]] = latest = t
        heard[source[i]] = receive[i]
    return latest


@kernel
def _digest(data: ByteArray, start: IntArray, length: IntArray, out: IntArray) -> None:
    """A number of 63 bits for the bytes of each record: equal bytes give equal numbers (two FNV-1 sums of 32 bits)."""
    for i in range(len(start)):
        a, b = 2166136261, 40389
        for j in range(start[i], start[i] + length[i]):
            byte = _int(data[j])
            a = a * 16777619 & 0xFFFFFFFF ^ byte
            b = b * 16777633 & 0xFFFFFFFF ^ byte
        out[i] = (b & 0x7FFFFFFF) << 32 | a


# ------------------------------------------------------------------------------------------------------------- fields wanted


class _Program(NamedTuple):
    """What `_extract` is to do for one category: the arrays that it takes, and the columns' names in their order."""

    spec: IntArray
    scale: FloatArray
    table: IntArray
    numbers: tuple[str, ...]
    codes: tuple[str, ...]


def _listed(item: uap.Item) -> bool:
    """Whether an item is a list of codes that goes on while FX is set."""
    return item.kind == uap.EXTENDED and ((len(item.fields) == 1 and item.fields[0].bits == 7) or item.size == 3)


def _find(category: int, edition: str, text: str) -> tuple[int, uap.Item, uap.Field]:
    path, _, name = text.partition(".")
    wanted, _, child = path.partition("/")
    items = uap.items_of(category, edition)
    item = next(i for i in items if i is not None and i.name == wanted)
    if child:
        item = next(i for i in item.subitems if i is not None and i.name == child)
    return _slots(category, edition)[path], item, next(f for f in item.fields if f.name == name)


def _spec_row(category: int, edition: str, text: str, what: int, out: int) -> tuple[list[int], float]:
    text, _, guards = text.partition(" unless ")
    slot, item, bits = _find(category, edition, text.strip())
    first = bits.bit // 8
    last = (bits.bit + bits.bits - 1) // 8
    guard_byte = guard_mask = limit = 0
    for name in guards.split():
        if name == "clipped":
            limit = (1 << (bits.bits - 1)) - 1
            continue
        guard = _find(category, edition, f"{text.partition('.')[0].strip()}.{name}")[2]
        guard_byte, guard_mask = guard.bit // 8, guard_mask | 0x80 >> guard.bit % 8
    row = [
        slot, first, last - first + 1, (last + 1) * 8 - bits.bit - bits.bits, (1 << bits.bits) - 1,
        1 << (bits.bits - 1) if bits.signed else 0, item.size, item.step, bits.part, what, out, guard_byte, guard_mask, limit,
    ]  # fmt: skip
    return row, bits.lsb * uap.SI[bits.unit]


@cache
def _program(category: int, edition: str, columns: tuple[tuple[str, str], ...], flagged: bool) -> _Program:
    names = [name for name, _ in columns]
    numbers = tuple(n for n in names if n not in uap.CODES)
    codes = [n for n in names if n in uap.CODES]
    rows: list[list[int]] = []
    scales: list[float] = []
    table: list[list[int]] = []

    def add(text: str, what: int, out: int) -> None:
        row, scale = _spec_row(category, edition, text, what, out)
        rows.append(row)
        scales.append(scale)

    for name, text in columns:
        what, out = (1, codes.index(name)) if name in uap.CODES else (0, numbers.index(name))
        for choice in text.split(" | "):
            add(choice, what, out)
    if flagged:
        for text, values, flag in uap.FLAGS.get((category, uap.family(category, edition)), ()):
            chosen = values or range(1, 256)
            table.append([int(flag) if v in chosen else 0 for v in range(256)])
            item = _find(category, edition, text)[1]
            add(text, 3 if _listed(item) else 2, len(table) - 1)
        channel, _ = uap.CHANNELS[category]
        if channel:
            add(channel, 1, len(codes))
            codes.append("channel")
    spec, flags = np.array(rows, np.int64).reshape(-1, 14), np.array(table, np.int64).reshape(-1, 256)
    return _Program(spec, np.array(scales), flags, numbers, tuple(codes))


# ---------------------------------------------------------------------------------------------------------------- the decoder


@dataclass(frozen=True, slots=True)
class DecodeState:
    """What the next bytes of a stream depend on.

    `day` is the UTC day (since 1970) of the first record; `latest_s` the last time read, and `stamps` the last one of each source
    (``sac << 8 | sic``), received at `heard`: they keep the day across midnight, in both directions; those in `doubted` leap away
    from the ones ahead of them.  `editions` are those given
    or inferred so far.  `offset` bytes and `records` records have been read, so that places and numbers are those of the whole
    stream.  Records of other than the wanted `categories` and `sources` (None: all) are read for their time and site, but not
    kept.
    """

    day: int = 0
    latest_s: float = float("nan")
    stamps: Mapping[int, float] = field(default_factory=dict)
    heard: Mapping[int, float] = field(default_factory=dict)
    doubted: Mapping[int, float] = field(default_factory=dict)
    editions: Mapping[int, str] = field(default_factory=dict)
    offset: int = 0
    records: int = 0
    categories: frozenset[int] | None = None
    sources: frozenset[int] | None = None

    @classmethod
    def begin(
        cls,
        date: datetime.date | None = None,
        editions: Mapping[int, str] | None = None,
        *,
        categories: Collection[int] | None = None,
        sources: Collection[int] | None = None,
    ) -> DecodeState:
        """The state before the first byte; `date` is the UTC date of the first record (none: day 0).

        `categories` and `sources` (``sac << 8 | sic``) choose records.  Raises SettingsError for a category or edition that is
        unknown.
        """
        given = dict(editions or {})
        for category, edition in given.items():
            uap.table_of(category, edition)
        for category in categories or ():
            uap.table_of(category, given.get(category) or (uap.default_edition(category) if category in uap.categories() else ""))
        return cls(
            day=0 if date is None else (date - datetime.date(1970, 1, 1)).days,
            editions=given,
            categories=None if categories is None else frozenset(categories),
            sources=None if sources is None else frozenset(sources),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """What some bytes held.  `plots.record` and `fixes.record` are numbers of records in the whole stream.

    One row a record, in the order of the stream: absolute byte `offset`, `length`, `category`, `source` (``sac << 8 | sic``),
    `time_s` (NaN where the record has none), `receive_s` (NaN where not known), `digest` (equal for equal bytes).  `site` has the
    positions that the stream tells: source, latitude, longitude (rad), height (m).  `unknown` counts the blocks of categories
    that cannot be read; `clipped` the positions beyond what their item can hold and `misplaced` (by category) those that are not
    on Earth: they are no fixes.  `impossible` counts the values that no target can have, by column: they are absent, and
    `passed_over` the records with reserved expansion or special purpose fields ("021 RE"), which nothing reads.  `truncated`
    counts the times of day that nothing completed; `notes` is what systems say of their sensors: source, category, sensor, what.
    """

    plots: Plots
    fixes: Fixes
    tracks: Tracks
    marks: Marks
    offset: IntArray
    length: IntArray
    category: AnyArray
    source: AnyArray
    time_s: FloatArray
    receive_s: FloatArray
    digest: IntArray
    site: tuple[tuple[int, float, float, float], ...]
    damaged: tuple[Damage, ...]
    unknown: Mapping[int, int]
    clipped: int = 0
    truncated: int = 0
    notes: Mapping[tuple[int, int, int], str] = field(default_factory=dict)
    misplaced: Mapping[int, int] = field(default_factory=dict)
    impossible: Mapping[str, int] = field(default_factory=dict)
    passed_over: Mapping[str, int] = field(default_factory=dict)


def _columns(
    data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, category: int, edition: str, columns: dict[str, str],
    flagged: bool,
) -> tuple[dict[str, Any], IntArray]:  # fmt: skip
    """The wanted fields of some records of one category, and their flags (n,); with flags come the channels."""
    program = _program(category, edition, tuple(columns.items()), flagged)
    n = len(rows)
    numbers = np.full((len(program.numbers), n), np.nan)
    codes = np.full((len(program.codes), n), -1, np.int64)
    flags = np.zeros(n, np.int64)
    _extract(data, start, items, rows, program.spec, program.scale, program.table, numbers, codes, flags)
    out: dict[str, Any] = dict(zip(program.numbers, numbers, strict=True)) | dict(zip(program.codes, codes, strict=True))
    if flagged:
        lookup = np.array(uap.CHANNELS[category][1], np.int8)
        channel = out.pop("channel", None)
        if channel is None:
            out["channel"] = np.full(n, lookup[0], np.int8)
        else:
            out["channel"] = np.where(channel < 0, np.int8(Channel.UNKNOWN), lookup[np.maximum(channel, 0)])
    if "mode_s" in out:
        out["mode_s"][out["mode_s"] == 0] = -1
    if "callsign" in out:
        out["callsign"] = _callsigns(out["callsign"])
    return out, flags


def _callsigns(packed: IntArray) -> IntArray:
    """Trailing zeros (which some senders use to fill up) become blanks; nothing but blanks becomes -1."""
    if np.any((packed & 63 == 0) & (packed >= 0)):
        packed = packed.copy()
        tail = packed >= 0
        for shift in range(0, 48, 6):
            tail &= (packed >> shift) & 63 == 0
            packed[tail] |= 32 << shift
            if not tail.any():
                break
    blank = 0x820820820820
    return np.where(packed == blank, -1, packed)


def _has(items: AnyArray, rows: IntArray, slots: list[int]) -> BoolArray:
    out: BoolArray = items[rows, slots[0]] != 0
    for slot in slots[1:]:
        out = out | (items[rows, slot] != 0)
    return out


def _motion(columns: dict[str, Any]) -> tuple[Any, Any]:
    """East and north velocity from the Cartesian columns, where absent from speed and course; the raw columns are taken out."""
    vx, vy = columns.pop("vx", None), columns.pop("vy", None)
    speed, course = columns.pop("speed", None), columns.pop("course", None)
    if speed is not None:
        east, north = speed * np.sin(course), speed * np.cos(course)
        if vx is None:
            return east, north
        return np.where(np.isnan(vx), east, vx), np.where(np.isnan(vy), north, vy)
    return vx, vy


def _positive(sd: AnyArray) -> AnyArray:
    """An sd of nothing says nothing."""
    return np.where(sd > 0, sd, np.nan)


def _plots(columns: dict[str, Any]) -> dict[str, Any]:
    """The columns of Plots: heading is the orientation, else the course; speed is that of the track."""
    vx, vy = columns.pop("vx", None), columns.pop("vy", None)
    speed, course, pointing = columns.pop("speed", None), columns.pop("course", None), columns.pop("orientation", None)
    if speed is None:
        return columns
    if vx is not None:
        speed = np.where(np.isnan(speed), np.hypot(vx, vy), speed)
        course = np.where(np.isnan(course), np.mod(np.arctan2(vx, vy), 2 * np.pi), course)
    columns["speed_mps"] = speed
    columns["heading_rad"] = course if pointing is None else np.where(np.isnan(pointing), course, pointing)
    return columns


def _fixes(columns: dict[str, Any]) -> dict[str, Any]:
    """The columns of Fixes: velocities, sd and sizes from what the record has."""
    east, north = _motion(columns)
    if east is not None:
        columns["velocity_east_mps"], columns["velocity_north_mps"] = east, north
    if "orientation" in columns:
        columns["heading_rad"] = columns.pop("orientation")
    sd_x, sd_y = columns.pop("sd_x", None), columns.pop("sd_y", None)
    if sd_x is not None and sd_y is not None:
        columns["horizontal_sd_m"] = _positive(np.sqrt((sd_x**2 + sd_y**2) / 2))
    if "vertical_sd_m" in columns:
        columns["vertical_sd_m"] = _positive(columns["vertical_sd_m"])
    if "nacp" in columns:
        nacp, gva, version, size = (columns.pop(n) for n in ("nacp", "gva", "version", "length_width"))
        # Version 0 (DO-260) has no NACp: what stands there is made up from the NUC, which is containment, not accuracy.
        nacp = np.where(version == 0, -1, nacp)
        columns["horizontal_sd_m"] = np.array([*uap.EPU_M, *[np.nan] * 5])[nacp] / 2.448
        columns["vertical_sd_m"] = np.array([*uap.GVA_M, np.nan])[np.where(version == 2, gva, -1)] / 1.96
        columns["length_m"], columns["width_m"] = np.array([*uap.LENGTH_M, np.nan])[size], np.array([*uap.WIDTH_M, np.nan])[size]
    # A bound on the error of the stamp, taken as evenly spread.
    bound = columns.pop("time_bound", None)
    if bound is not None:
        columns["time_sd_s"] = bound / np.sqrt(3)
    return columns


def _tracks(columns: dict[str, Any]) -> dict[str, Any]:
    """The columns of Tracks: the age is that of the youngest measurement, the sd that of the plane, else of the ellipsoid."""
    ages = np.array([columns.pop(name) for name in list(columns) if name.startswith("age_")])
    columns["age_s"] = np.where(np.isnan(ages).all(axis=0), np.nan, np.nanmin(np.where(np.isnan(ages), np.inf, ages), axis=0))
    if "speed" in columns:
        columns["velocity_east_mps"], columns["velocity_north_mps"] = _motion(columns)
    # Flight plans have the callsign in seven letters of 8 bits; the low 6 bits of each are the code of ICAO Annex 10.
    flight = columns.pop("flight")
    packed = np.full(len(flight), 32, np.int64)
    for k in range(7):
        packed |= (flight >> 8 * k & 63) << 6 * (k + 1)
    columns["callsign"] = np.where((columns["callsign"] < 0) & (flight > 0), _callsigns(packed), columns["callsign"])
    if "sd_x" not in columns:
        columns.pop("channel")
        return columns
    sd_x, sd_y = columns.pop("sd_x"), columns.pop("sd_y")
    # An angle's worth on the ellipsoid, to the 0.5 % that an accuracy needs.
    north = columns.pop("sd_latitude") * EARTH_M
    east = columns.pop("sd_longitude") * EARTH_M * np.cos(columns["latitude_rad"])
    plane = np.sqrt((sd_x**2 + sd_y**2) / 2)
    columns["horizontal_sd_m"] = _positive(np.where(np.isnan(plane), np.sqrt((north**2 + east**2) / 2), plane))
    columns["vertical_sd_m"] = _positive(columns["vertical_sd_m"])
    columns.pop("channel")
    return columns


def _times(
    data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, category: int, edition: str
) -> tuple[FloatArray, AnyArray]:
    """Times of day (s) of records (NaN: none, or beyond a day), and which of the category's time items (0, 1 …) it was."""
    choices = uap.TIMES[category, uap.family(category, edition)]
    wanted = {f"t{k}": text for k, (text, _) in enumerate(choices)}
    wanted |= {f"{part}{k}": f"{fine}.{name}" for k, (_, fine) in enumerate(choices) if fine
               for part, name in (("fsi", "FSI"), ("fine", "TOMRP"))}  # fmt: skip
    columns, _ = _columns(data, start, items, rows, category, edition, wanted, False)
    tod = np.full(len(rows), np.nan)
    which = np.full(len(rows), -1, np.int8)
    for k, (_, fine) in enumerate(choices):
        value = columns[f"t{k}"]
        if fine:
            # FSI tells whether the whole second is that of the coarse item, the next or the one before.
            second = np.floor(value) + np.array([0.0, 1.0, -1.0, np.nan])[np.nan_to_num(columns[f"fsi{k}"]).astype(np.int64)]
            precise = np.mod(second + columns[f"fine{k}"], DAY_S)
            value = np.where(np.isnan(precise), value, precise)
        use = np.isnan(tod) & (value < DAY_S)
        tod[use], which[use] = value[use], k
    return tod, which


def _possible(table: Any, impossible: Counter[str]) -> Any:
    """The table without the values that no target can have; they are counted by column."""
    mended: dict[str, FloatArray] = {}
    for name, (low, high) in _LIMITS.items():
        value = getattr(table, name, None)
        if value is None:
            continue
        wrong = (value < low) | (value > high)
        if wrong.any():
            impossible[name] += int(np.count_nonzero(wrong))
            mended[name] = np.where(wrong, np.nan, value)
    return table.replace(**mended) if mended else table


def _on_earth(table: Fixes | Tracks) -> BoolArray:
    """Whether each geodetic position can be one; true where there is none."""
    return ~((np.abs(table.latitude_rad) > np.pi / 2) | (np.abs(table.longitude_rad) > np.pi))


def _score(data: ByteArray, places: list[int], category: int, edition: str) -> float:
    """How well an edition fits the blocks at `places`: the share of blocks that add up, times that of plausible records."""
    layout = _layout_of({category: edition})
    found: list[IntArray] = []
    kept: list[AnyArray] = []
    whole = 0
    for place in places:
        block = data[place : _end(data, place)]
        room = len(block) // 3 + 1
        start, length, cats = np.zeros(room, np.int64), np.zeros(room, np.int64), np.zeros(room, np.uint8)
        items = np.zeros((room, _width()), np.uint16)
        n, _, how, *_ = _walk(block, 0, True, layout.cats, layout.nodes, start, length, cats, items)
        if how == _MORE and n:
            whole += 1
            found.append(start[:n] + place)
            kept.append(items[:n])
    if not found:
        return 0.0
    begin, items = np.concatenate(found), np.concatenate(kept)
    rows = np.arange(len(begin))
    position = (uap.FIXES | uap.TRACKS)[category, uap.family(category, edition)].columns
    wanted = {name: position[name] for name in ("latitude_rad", "longitude_rad")}
    columns, _ = _columns(data, begin, items, rows, category, edition, wanted, False)
    tod, _ = _times(data, begin, items, rows, category, edition)
    good = np.isnan(columns["latitude_rad"]) | (np.abs(columns["latitude_rad"]) <= np.pi / 2)
    good &= np.isnan(columns["longitude_rad"]) | (np.abs(columns["longitude_rad"]) <= np.pi)
    # Neighbours in a stream are stamped within minutes of each other; a wrong edition puts them anywhere in 36 hours.
    apart = np.abs(np.diff(tod, prepend=tod[:1]))
    good &= np.isfinite(apart) & (np.minimum(apart, DAY_S - apart) < _GAP_S)
    return whole / len(places) * float(np.mean(good))


def _infer(data: ByteArray, places: list[int], category: int) -> tuple[str, float]:
    """The edition that fits the blocks at `places` best, and how well (0 … 1)."""
    scores = {edition: _score(data, places, category, edition) for edition in uap.INFERRED[category]}
    best = max(scores, key=lambda edition: scores[edition])
    return best, scores[best]


def _blocks(data: ByteArray, pos: int, category: int, most: int) -> tuple[list[int], bool]:
    """The places of the first `most` whole blocks of a category from `pos` on, and whether the data ended before."""
    out: list[int] = []
    while len(out) < most:
        if len(data) - pos < 3:
            return out, True
        end = _end(data, pos)
        if end < pos + 3:
            return out, False
        if end > len(data):
            return out, True
        if data[pos] == category:
            out.append(pos)
        pos = end
    return out, False


def decode(
    data: bytes | bytearray | memoryview | ByteArray, state: DecodeState, receive_s: float | None = None, *, final: bool = False
) -> tuple[Records, DecodeState, int]:
    """Decode ASTERIX data blocks: (records, next state, number of bytes consumed).

    What is not consumed is what only the bytes that follow can settle: a block that is not complete, and the block before it.
    Give it again, with more behind it.  However a stream is cut, the records, the damage and the last state are the same.
    `final` says that nothing follows: then everything is consumed, and what is incomplete is damage.  A datagram is final.
    `receive_s` (UTC seconds) is when the data were received: it tells the day; without it, times follow on from the state.
    """
    told = np.nan if receive_s is None else float(receive_s)
    parts, state, consumed = _decode_all(_buffer(data), state, np.zeros(1, np.int64), np.array([told]), final)
    return parts[0] if len(parts) == 1 else _join(parts), state, consumed


def _decode_all(
    buffer: ByteArray, state: DecodeState, begin: IntArray, receive_s: FloatArray, final: bool, framed: bool = False
) -> tuple[list[Records], DecodeState, int]:
    """As `decode`, in parts; what begins at `begin` (k,) and after was received at `receive_s` (k,; NaN: not known).

    `framed` says that the lengths of the blocks are right: they add up to those of their datagrams.
    """
    parts: list[Records] = []
    consumed = 0
    while True:
        receive = _Reception(begin - consumed, receive_s)
        records, state, used, go_on = _decode_some(buffer[consumed:], state, receive, final, framed)
        parts.append(records)
        consumed += used
        if not go_on:
            return parts, state, consumed


class _Reception(NamedTuple):
    """When the bytes were received: from `begin` (k,) on at `receive_s` (k,)."""

    begin: IntArray
    receive_s: FloatArray

    def __call__(self, start: IntArray) -> FloatArray:
        return self.receive_s[np.maximum(np.searchsorted(self.begin, start, side="right") - 1, 0)]


def _buffer(data: bytes | bytearray | memoryview | ByteArray) -> ByteArray:
    """The data as one kind of array (read-only), so that the kernels are compiled once."""
    buffer = np.ascontiguousarray(data, np.uint8) if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
    buffer = buffer.view()
    buffer.flags.writeable = False
    return buffer


def _end(data: ByteArray, pos: int) -> int:
    """Where the block that begins at `pos` claims to end."""
    return pos + (int(data[pos + 1]) << 8 | int(data[pos + 2]))


_ROW_COLUMNS = ("offset", "length", "category", "source", "time_s", "receive_s", "digest")


def _join(parts: list[Records]) -> Records:
    """The parts one behind the other.  The list is emptied, and columns are let go one by one: nothing is there twice."""
    unknown: dict[int, int] = {}
    notes: dict[tuple[int, int, int], str] = {}
    site: dict[tuple[int, float, float, float], None] = {}
    damaged: list[Damage] = []
    clipped = truncated = 0
    misplaced: Counter[int] = Counter()
    impossible: Counter[str] = Counter()
    passed_over: Counter[str] = Counter()
    rows: dict[str, list[AnyArray]] = {name: [] for name in _ROW_COLUMNS}
    tables: dict[str, list[Any]] = {name: [] for name in ("plots", "fixes", "tracks", "marks")}
    for part in parts:
        for category, count in part.unknown.items():
            unknown[category] = unknown.get(category, 0) + count
        notes |= part.notes
        site |= dict.fromkeys(part.site)
        damaged += part.damaged
        clipped, truncated = clipped + part.clipped, truncated + part.truncated
        misplaced.update(part.misplaced)
        impossible.update(part.impossible)
        passed_over.update(part.passed_over)
        for name, columns in rows.items():
            columns.append(getattr(part, name))
        for name, found in tables.items():
            if len(getattr(part, name)):
                found.append(getattr(part, name))
    parts.clear()
    if not rows["offset"]:
        return _empty()
    kinds = {"plots": Plots, "fixes": Fixes, "tracks": Tracks, "marks": Marks}
    joined: dict[str, Any] = {name: _stack(kind, tables[name]) for name, kind in kinds.items()}
    joined |= {name: np.concatenate(rows.pop(name)) for name in _ROW_COLUMNS}
    return Records(
        **joined,
        site=tuple(site), damaged=tuple(damaged), unknown=unknown, clipped=clipped, truncated=truncated, notes=notes,
        misplaced=misplaced, impossible=impossible, passed_over=passed_over,
    )  # fmt: skip


def _empty() -> Records:
    none = np.empty(0, np.int64)
    return Records(
        plots=Plots(), fixes=Fixes(), tracks=Tracks(), marks=Marks(), offset=none, length=none, category=none.astype(np.uint8),
        source=none.astype(np.int32), time_s=np.empty(0), receive_s=np.empty(0), digest=none, site=(), damaged=(), unknown={},
    )  # fmt: skip


def _stack(kind: Any, tables: list[Any]) -> Any:
    """As `kind.concat`, but the list is emptied and its columns are let go as soon as they are copied."""
    if len(tables) <= 1:
        return tables[0] if tables else kind()
    columns = {f.name: [getattr(t, f.name) for t in tables] for f in fields(kind)}
    tables.clear()
    return kind(**{name: np.concatenate(columns.pop(name)) for name in list(columns)})


def _decode_some(
    data: ByteArray, state: DecodeState, receive: _Reception, final: bool, framed: bool
) -> tuple[Records, DecodeState, int, bool]:
    """One table full of `decode`; the last value says whether there is more to do."""
    editions = dict(state.editions)
    layout = _layout_of(editions)
    # Most records are longer than 20 bytes; where they are not, another round follows.  A block always fits.
    room = min(_ROWS, max(256, len(data) // 3 + 1))
    start, length = np.empty(room, np.int64), np.empty(room, np.int64)
    category = np.empty(room, np.uint8)
    # Wide enough for every edition: one that is inferred on the way changes the layout, not the table.
    items = np.zeros((room, _width()), np.uint16)
    unknown = np.zeros(256, np.int64)
    damaged: list[Damage] = []
    row = np.zeros(_width(), np.uint16)
    n = pos = 0
    go_on = False
    while True:
        m, pos, how, place, code, rows_before, before = _walk(
            data, pos, final, layout.cats, layout.nodes, start[n:], length[n:], category[n:], items[n:]
        )
        rows_before += n
        n += m
        if how == _PENDING:
            which = int(data[pos])
            places, ended = _blocks(data, pos, which, _SAMPLE)
            best, score = _infer(data, places, which) if places and (final or not ended) else ("", 0.0)
            if score >= 0.5:
                editions[which] = best
                layout = _layout_of(editions)
                # What was read is not read again.
                continue
        passed = pos
        if how == _STRANGE and framed:
            unknown[data[pos]] += 1
            pos = _end(data, pos)
            continue
        if how == _STRANGE:
            passed = _pass_over(data, pos, final, layout.cats, layout.nodes, unknown, row, _CHAIN, _AHEAD)
            if passed > pos:
                pos = passed
                continue
        waits = passed < 0 or how == _FULL or (how == _MORE and not final) or (how == _PENDING and ended and not final)
        if how == _MORE and final:
            break
        if not waits:
            found = _after_damage(data, pos, how, place, code, before, final, framed, editions, row)
            waits = found is None
        if waits:
            # The block before waits too: whether it really ended there, only what follows can tell.
            go_on = how == _FULL
            if before >= 0:
                pos = before
            keep = rows_before if before >= 0 else int(np.searchsorted(start[:n], pos))
            items[keep:n] = 0
            n = keep
            break
        assert found is not None
        resumed, lost, why = found
        # Records that reach beyond the place where reading goes on were made of other blocks' bytes.
        while n and start[n - 1] + length[n - 1] > resumed:
            n -= 1
            items[n] = 0
            lost = min(lost, int(start[n]))
        damaged.append(Damage(state.offset + lost, why))
        pos = resumed
        if final and pos >= len(data):
            pos = len(data)
            break
        if room - n < _ROWS // 3 and room == _ROWS:
            go_on = True
            break
    records, state = _assemble(data, state, receive, editions, start[:n], length[:n], category[:n], items[:n])
    records = replace(records, damaged=tuple(damaged), unknown={int(c): int(unknown[c]) for c in np.flatnonzero(unknown)})
    return records, replace(state, offset=state.offset + pos), pos, go_on


def _after_damage(
    data: ByteArray, pos: int, how: int, place: int, code: int, before: int, final: bool, framed: bool, editions: dict[int, str],
    row: AnyArray,
) -> tuple[int, int, str] | None:  # fmt: skip
    """Where reading goes on after damage, where the damage is and what it is; None where only more data can tell."""
    end = _end(data, pos) if len(data) - pos >= 3 else pos + 3
    if how == _RECORD:
        why = _WHY[code // 1000].format(frn=code % 1000)
    elif how == _CUT:
        why = f"the data end within a block: at least {end - len(data)} bytes are missing"
    elif how == _HEADER:
        why, end = f"a block cannot be {code} bytes long", pos + 1
    elif how == _STRANGE:
        why, end = f"no block begins here (category {int(data[pos])})", pos + 1
    else:
        why = f"the block fits no known edition of category {int(data[pos]):03d}"
    if framed:
        lost = place if how == _RECORD else pos
        return end, lost, f"{why}; {end - lost} bytes are skipped"
    choices = _choices(editions)
    if before >= 0 and how in (_HEADER, _STRANGE, _RECORD):
        # Perhaps the block before is shorter than it says, and this is the middle of the next one.
        back = [_hidden(data, before + 1, pos, pos, True, final, c.cats, c.nodes, row) for c in choices]
        if min(back) < 0:
            return None
        if max(back) > 0:
            resumed = min(p for p in back if p > 0)
            return resumed, before, "the block is longer than what there is of it: it runs into the next one"
    search = place if how in (_RECORD, _CUT) else pos + 1
    onward = [_resume(data, pos + 1, search, end, final, c.cats, c.nodes, row, _SKIP) for c in choices]
    if min(onward) < 0:
        return None
    resumed = min(onward)
    lost = place if how in (_RECORD, _CUT) else pos
    if resumed > lost:
        why += f"; {resumed - lost} bytes are skipped"
    return resumed, lost, why


def _choices(editions: Mapping[int, str]) -> list[Layout]:
    """The layouts that may hold: while an edition is not known, a block of any of its editions will do."""
    pending = [c for c in uap.INFERRED if c not in editions]
    known = dict(editions)
    return [_layout_of(known | {c: e}) for c in pending for e in uap.INFERRED[c]] or [_layout_of(known)]


@cache
def _width() -> int:
    return max(_layout(((c, e),), ()).width for c in uap.categories() for e in uap.editions_of(c))


def _assemble(
    data: ByteArray, state: DecodeState, receive: _Reception, editions: dict[int, str],
    start: IntArray, length: IntArray, category: AnyArray, items: AnyArray,
) -> tuple[Records, DecodeState]:  # fmt: skip
    """The walked records as tables, and the state behind them (but for its offset)."""
    n = len(start)
    source = np.zeros(n, np.int32)
    tod, period = np.full(n, np.nan), np.zeros(n)
    which = np.full(n, -1, np.int8)
    groups: list[tuple[int, str, IntArray]] = []
    for cat in np.unique(category).tolist():
        edition = editions.get(cat) or uap.default_edition(cat)
        rows = np.flatnonzero(category == cat)
        at = start[rows] + items[rows, _slots(cat, edition)["010"]]
        source[rows] = data[at].astype(np.int32) << 8 | data[at + 1]
        period[rows] = uap.TRUNCATED_S.get(cat, 0.0)
        for form, mine in _forms(data, start, items, rows, cat):
            groups.append((form, edition, mine))
            tod[mine], which[mine] = _times(data, start, items, mine, form, edition)
    # Days.
    ids, index = np.unique(source, return_inverse=True)
    last = np.array([state.stamps.get(int(s), np.nan) for s in ids])
    time_s = np.full(n, np.nan)
    heard = np.array([state.heard.get(int(s), np.nan) for s in ids])
    received = receive(start)
    rows = index.astype(np.int64)
    doubted = np.array([state.doubted.get(int(s), np.nan) for s in ids])
    latest = float(_unwrap(tod, period, rows, received, last, heard, doubted, state.latest_s, state.day * DAY_S, time_s))
    doubts = {s: t for s, t in state.doubted.items() if s not in set(ids.tolist())}
    doubts |= {int(s): float(t) for s, t in zip(ids, doubted, strict=True) if np.isfinite(t)}
    clocks = dict(state.heard) | {int(s): float(t) for s, t in zip(ids, heard, strict=True) if np.isfinite(t)}
    stamps = dict(state.stamps) | {int(s): float(t) for s, t in zip(ids, last, strict=True) if np.isfinite(t)}
    # Sites and notes, also of records that are not wanted.
    site: dict[tuple[int, float, float, float], None] = {}
    notes: dict[tuple[int, int, int], str] = {}
    for form, edition, rows in groups:
        if form in uap.SITES:
            texts = uap.SITES[form]
            mine = rows[_has(items, rows, [_slots(form, edition)[texts[0].partition(".")[0]]])]
            if len(mine):
                names = ["lat", "lon", "up"]
                columns, _ = _columns(data, start, items, mine, form, edition, dict(zip(names, texts, strict=True)), False)
                told = np.column_stack([source[mine], *(columns[name] for name in names)])
                for s, *place in np.unique(told, axis=0).tolist():
                    site[int(s), place[0], place[1], place[2]] = None
        if form in uap.SENSOR_STATUS:
            notes |= _notes(data, start, items, rows, source, form, edition)
    # Numbers of records: those that are not wanted have none.
    kept = np.ones(n, bool)
    if state.categories is not None:
        kept &= np.isin(category, list(state.categories))
    if state.sources is not None:
        kept &= np.isin(source, list(state.sources))
    number = state.records + np.cumsum(kept) - 1
    plots: list[Plots] = []
    fixes: list[Fixes] = []
    tracks: list[Tracks] = []
    marks: list[Marks] = []
    clipped = 0
    misplaced: Counter[int] = Counter()
    impossible: Counter[str] = Counter()
    passed_over: Counter[str] = Counter()
    for form, edition, rows in groups:
        rows = rows[kept[rows]]
        slots = _slots(form, edition)
        for name in ("RE", "SP"):
            count = int(np.count_nonzero(items[rows, slots[name]])) if name in slots else 0
            if count:
                passed_over[f"{1 if form == uap.SECOND[1] else form:03d} {name}"] += count
        if form in uap.PLOTS:
            needs, wanted = uap.PLOTS[form]
            mine = rows[_has(items, rows, [slots[i] for i in needs])]
            columns, flags = _columns(data, start, items, mine, form, edition, wanted, True)
            seen = Plots(time_s=time_s[mine], sensor=source[mine], flags=flags, record=number[mine], **_plots(columns))
            plots.append(_possible(seen, impossible))
        if (form, uap.family(form, edition)) in uap.FIXES:
            needs, wanted = uap.FIXES[form, uap.family(form, edition)]
            mine = rows[_has(items, rows, [slots[i] for i in needs])]
            if len(mine):
                columns, flags = _columns(data, start, items, mine, form, edition, wanted, True)
                columns = _fixes(columns)
                if form == 21:
                    # Only a time of applicability is that of the position; a reception is a little later, a transmission by far.
                    names = [text for text, _ in uap.TIMES[form, uap.family(form, edition)]]
                    reception = np.array([text == "073.073" for text in names] + [False])[which[mine]]
                    transmission = np.array([text == "077.077" for text in names] + [False])[which[mine]]
                    flags = flags | np.where(reception, int(Flag.TIME_OF_RECEPTION), 0)
                    if transmission.any():
                        columns["time_sd_s"] = np.where(transmission, TRANSMISSION_SD_S, columns.get("time_sd_s", np.nan))
                table = Fixes(time_s=time_s[mine], source=source[mine], flags=flags, record=number[mine], **columns)
                there = _on_earth(table)
                placed = np.isfinite(table.latitude_rad + table.longitude_rad) | np.isfinite(table.x_m + table.y_m)
                clipped += int(np.count_nonzero(~placed))
                if not there.all():
                    misplaced[form] += int(np.count_nonzero(~there))
                    placed &= there
                fixes.append(_possible(table if placed.all() else table[placed], impossible))
        if (form, uap.family(form, edition)) in uap.TRACKS:
            needs, wanted = uap.TRACKS[form, uap.family(form, edition)]
            mine = rows[_has(items, rows, [slots[i] for i in needs])]
            columns, flags = _columns(data, start, items, mine, form, edition, wanted, True)
            state_of = Tracks(time_s=time_s[mine], source=source[mine], flags=flags, record=number[mine], **_tracks(columns))
            there = _on_earth(state_of)
            if not there.all():
                misplaced[form] += int(np.count_nonzero(~there))
                absent = {name: np.where(there, getattr(state_of, name), np.nan) for name in ("latitude_rad", "longitude_rad")}
                state_of = state_of.replace(**absent)
            tracks.append(_possible(state_of, impossible))
        if form in uap.MARKS:
            marks.append(_marks(data, start, items, rows, time_s, source, number, form, edition))
    digest = np.empty(n, np.int64)
    _digest(data, start, length, digest)
    rows = np.flatnonzero(kept)
    records = Records(
        plots=_ordered(Plots, plots), fixes=_ordered(Fixes, fixes), tracks=_ordered(Tracks, tracks),
        marks=_ordered(Marks, marks), offset=start[rows] + state.offset, length=length[rows], category=category[rows],
        source=source[rows], time_s=time_s[rows], receive_s=received[rows], digest=digest[rows], site=tuple(site), damaged=(),
        unknown={}, clipped=clipped, truncated=int(np.count_nonzero((period > 0) & np.isfinite(tod) & np.isnan(time_s) & kept)),
        notes=notes, misplaced=misplaced, impossible=impossible, passed_over=passed_over,
    )  # fmt: skip
    return records, replace(
        state, latest_s=latest, stamps=stamps, heard=clocks, doubted=doubts, editions=editions, records=state.records + len(rows)
    )


def _forms(data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, category: int) -> list[tuple[int, IntArray]]:
    """The records by their list of items: that of the category, or its second one."""
    if category not in uap.SECOND:
        return [(category, rows)]
    at = items[rows, 1]
    second = (at > 0) & (data[start[rows] + at] >= 0x80)
    forms = [(category, rows[~second]), (uap.SECOND[category], rows[second])]
    return [(form, mine) for form, mine in forms if len(mine)]


def _marks(
    data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, time_s: FloatArray, source: AnyArray, number: IntArray,
    category: int, edition: str,
) -> Marks:  # fmt: skip
    kind, sector, period = uap.MARKS[category]
    wanted = {"kind": kind, "azimuth_rad": sector, "period_s": period}
    columns, _ = _columns(data, start, items, rows, category, edition, wanted, False)
    told = columns.pop("kind")
    azimuth = np.where(told == uap.NORTH_MARK, 0.0, np.where(told == uap.SOUTH_MARK, np.pi, columns["azimuth_rad"]))
    use = (told == uap.NORTH_MARK) | (told == uap.SECTOR_MARK) | ((told == uap.SOUTH_MARK) & (category == 2))
    use &= np.isfinite(azimuth)
    mine = rows[use]
    return Marks(
        time_s=time_s[mine], sensor=source[mine], azimuth_rad=azimuth[use], period_s=columns["period_s"][use], record=number[mine]
    )


def _notes(
    data: ByteArray, start: IntArray, items: AnyArray, rows: IntArray, source: AnyArray, category: int, edition: str
) -> dict[tuple[int, int, int], str]:
    """What a system says of its sensors, the last word on each: (source, category, sensor) to a sentence."""
    told = uap.SENSOR_STATUS[category]
    wanted = {f"v{k}": text for k, (text, *_) in enumerate(told)}
    wanted |= dict(zip(("sac", "sic", "state"), uap.STATUS_OF[category], strict=True))
    columns, _ = _columns(data, start, items, rows, category, edition, wanted, False)
    out: dict[tuple[int, int, int], str] = {}
    for k, row in enumerate(rows.tolist()):
        sac, sic, state = (columns[name][k] for name in ("sac", "sic", "state"))
        if np.isnan(sac):
            continue
        words = [] if np.isnan(state) else [("operational", "degraded", "initialising", "not connected")[int(state)]]
        words += [
            f"{name} {'bias ' if 'gain' not in name else ''}{columns[f'v{j}'][k] * factor:+.5g} {unit}"
            for j, (_, name, unit, factor) in enumerate(told)
            if np.isfinite(columns[f"v{j}"][k])
        ]
        out[int(source[row]), category, int(sac) << 8 | int(sic)] = ", ".join(words)
    return out


def _ordered(kind: Any, parts: list[Any]) -> Any:
    """The parts as one table in the order of the records."""
    parts = [p for p in parts if len(p)]
    if len(parts) == 1:
        return parts[0]
    table = kind.concat(parts)
    return table.take(np.argsort(table.record, kind="stable")) if len(parts) > 1 else table


# ------------------------------------------------------------------------------------------------------------------- files


def read_asterix(
    path: str | Path,
    *,
    editions: Mapping[int, str] | None = None,
    date: datetime.date | None = None,
    categories: Collection[int] | None = None,
    sources: Collection[int] | None = None,
) -> Recording:
    """Read a recording of ASTERIX: raw data blocks, a packet capture, a final-format or a GPS-stamped file.

    `editions` names the edition of a category (``{21: "0.23"}``); where it is not given it is inferred, and said in the warnings.
    `date` is the UTC date of the file's first record; without it a capture's own date counts, else the first day is day 0
    (1970-01-01), and that is said.  `categories` and `sources` (``sac << 8 | sic``) choose records; the others are not kept.
    Duplicated records and records out of order are kept and counted in the warnings.  Raises InputError where nothing at all
    could be read, and where the records do not fit the edition (with the one that they fit); SettingsError for an unknown one.
    """
    stream = Stream.open(path, editions=editions, date=date, categories=categories, sources=sources)
    reader = stream.reader
    records = _join(list(reader))
    stream.told.add(records)
    stream.finish()
    return Recording(
        path=str(path),
        plots=records.plots,
        fixes=records.fixes,
        tracks=records.tracks,
        marks=records.marks,
        sources=_sources(records, reader.state.editions),
        damaged=stream.damaged,
        warnings=stream.warnings,
        by_category={int(c): int(np.count_nonzero(records.category == c)) for c in np.unique(records.category)},
        offset=records.offset,
        receive_s=np.empty(0) if reader.kind == "raw" else records.receive_s,
        passed_over=dict(records.passed_over),
    )


@dataclass(slots=True)
class Stream:
    """A recording of ASTERIX part by part, so that memory does not grow with its length.

    Iterating (once) gives `Records`; after the last part `damaged` and `warnings` are those that `read_asterix` would tell.
    """

    reader: Reader
    date: datetime.date | None
    given: dict[int, str]
    told: _Told
    damaged: tuple[Damage, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def open(
        cls,
        path: str | Path,
        *,
        editions: Mapping[int, str] | None = None,
        date: datetime.date | None = None,
        categories: Collection[int] | None = None,
        sources: Collection[int] | None = None,
    ) -> Stream:
        """Look at a file; the arguments and the errors raised, here or while iterating, are those of `read_asterix`."""
        reader = Reader.open(path, editions=editions, date=date, categories=categories, sources=sources)
        given = dict(editions or {})
        _check_editions(path, reader.sample, given)
        return cls(reader, date, given, _Told())

    def __iter__(self) -> Iterator[Records]:
        try:
            for part in self.reader:
                self.told.add(part)
                yield part
            self.finish()
        finally:
            self.told.digests.close()

    def finish(self) -> None:
        """After the last part: fill in what was damaged and the warnings.  Raises InputError as `read_asterix` does."""
        reader, told = self.reader, self.told
        if not told.records:
            raise _nothing(reader.path, reader, told)
        warnings = reader.remarks(self.date)
        for category, edition in reader.state.editions.items():
            if category not in self.given:
                name = f"{category:03d}"
                warnings.append(
                    f"category {name} was read as edition {edition}, inferred from the records (--edition {name}=… sets it)"
                )
        _check_positions(reader.path, reader.sample, told, reader.state.editions)
        self.warnings = (*warnings, *told.remarks())
        self.damaged = tuple(sorted((*told.damaged, *reader.tally.damaged), key=lambda d: d.offset))


@dataclass(slots=True)
class _Digests:
    """How many records are the same as another one.  Beyond `_HELD` of them their digests wait on disk, 64 shares of them."""

    held: list[IntArray] = field(default_factory=list)
    count: int = 0
    shares: list[IO[bytes]] = field(default_factory=list)

    def add(self, digest: IntArray) -> None:
        self.held.append(digest)
        self.count += len(digest)
        if self.count <= _HELD:
            return
        if not self.shares:
            self.shares = [tempfile.TemporaryFile() for _ in range(_SHARES)]  # noqa: SIM115 (`close` closes them)
        for part in self.held:
            share = (part & (_SHARES - 1)).astype(np.uint8)
            order = np.argsort(share, kind="stable")
            ends = np.cumsum(np.bincount(share, minlength=_SHARES))[:-1]
            for file, piece in zip(self.shares, np.split(part[order], ends), strict=True):
                file.write(piece.tobytes())
        self.held.clear()

    def duplicates(self) -> int:
        """The count; to be asked for once."""
        count = _repeated(np.concatenate(self.held)) if self.held else 0
        for file in self.shares:
            file.seek(0)
            count += _repeated(np.frombuffer(file.read(), np.int64))
        self.close()
        return count

    def close(self) -> None:
        """Let go of what waits on disk."""
        for file in self.shares:
            file.close()


def _repeated(digest: IntArray) -> int:
    order = np.sort(digest)
    return int(np.count_nonzero(order[1:] == order[:-1]))


@dataclass(slots=True)
class _Told:
    """What is to be said of a recording, gathered part by part."""

    records: int = 0
    damaged: list[Damage] = field(default_factory=list)
    unknown: dict[int, int] = field(default_factory=dict)
    digests: _Digests = field(default_factory=_Digests)
    clipped: int = 0
    truncated: int = 0
    untimed: int = 0
    plane: int = 0
    late: int = 0
    # Of each source: how often a stamp goes back, by how much at most, and the last stamp.
    back: dict[int, tuple[int, float, float]] = field(default_factory=dict)
    # Of each category: positions that are not on Earth, and (where its edition is inferred) all of them.
    places: dict[int, tuple[int, int]] = field(default_factory=dict)
    # Values that no target can have, by column.
    impossible: Counter[str] = field(default_factory=Counter)

    def add(self, records: Records) -> None:
        """The next part."""
        self.damaged += records.damaged
        for category, count in records.unknown.items():
            self.unknown[category] = self.unknown.get(category, 0) + count
        self.digests.add(records.digest)
        self.clipped += records.clipped
        self.truncated += records.truncated
        self.untimed += int(np.count_nonzero(np.isnan(records.time_s))) - records.truncated
        self.plane += int(np.count_nonzero(np.isnan(records.tracks.latitude_rad) & np.isfinite(records.tracks.x_m)))
        self.late += int(np.count_nonzero(records.fixes.time_sd_s == TRANSMISSION_SD_S))
        for source in np.unique(records.source).tolist():
            times = records.time_s[records.source == source]
            times = times[np.isfinite(times)]
            if not len(times):
                continue
            times_back, most, last = self.back.get(source, (0, 0.0, times[0]))
            back = -np.diff(times, prepend=last)
            self.back[source] = times_back + int(np.count_nonzero(back > 0)), max(most, float(back.max())), float(times[-1])
        for table in (records.fixes, records.tracks):
            if not len(table):
                continue
            sent = records.category[table.record - self.records]
            for category in np.unique(sent).tolist():
                if category not in uap.INFERRED:
                    continue
                wrong, known = self.places.get(category, (0, 0))
                self.places[category] = wrong, known + int(np.count_nonzero(np.isfinite(table.latitude_rad[sent == category])))
        for category, count in records.misplaced.items():
            wrong, known = self.places.get(category, (0, 0))
            self.places[category] = wrong + count, known + count
        self.impossible.update(records.impossible)
        self.records += len(records.offset)

    def remarks(self) -> list[str]:
        """What a reader should know of records that were kept: categories passed over, duplicates, disorder, stamps."""
        out = [
            f"{n} blocks of category {category:03d} were passed over: it cannot be read" for category, n in self.unknown.items()
        ]
        duplicates = self.digests.duplicates()
        if duplicates:
            out.append(f"{duplicates} records are byte for byte the same as another one; they were kept")
        if self.truncated:
            out.append(
                f"{self.truncated} records of category 001 tell only the rest of their time of day by 512 s, and nothing of "
                "their source (I002/030) nor a time of reception completes it: their time is not known"
            )
        if self.plane:
            out.append(
                f"{self.plane} track states have a position only in their system's own plane (I062/100), not on the ellipsoid"
            )
        if self.clipped:
            out.append(f"{self.clipped} positions are beyond what their item can hold: they are left out of the fixes")
        for category, (wrong, _) in sorted(self.places.items()):
            if wrong:
                out.append(f"{wrong} positions of category {category:03d} are not on Earth: they are left out")
        if self.impossible:
            names = ", ".join(f"{_SAID[name]} ({count})" for name, count in self.impossible.items())
            out.append(f"values that no target can have are left out: {names}")
        if self.untimed:
            out.append(f"{self.untimed} records have no time of day, or one beyond 24 hours: their time is not known")
        for source, (count, most, _) in sorted(self.back.items()):
            if count:
                out.append(
                    f"{count} records of SAC/SIC {source >> 8}/{source & 255} are stamped before the one ahead "
                    f"of them (by up to {most:.3f} s); they were kept in the order of the file"
                )
        if self.late:
            out.append(
                f"{self.late} ADS-B reports tell only when the station sent them (I021/077), not when the position was valid: "
                f"their time is taken as {TRANSMISSION_SD_S} s (sd) uncertain"
            )
        return out


@dataclass(slots=True)
class Reader:
    """A file of ASTERIX, read in chunks: iterating gives `Records`, with the offsets of the file.

    `kind` is "raw", "pcap", "pcapng", "final" or "gps"; `sample` some of its blocks; `tally` what a container held beside
    datagrams, `strange` how many of these held no ASTERIX; `first_s` is when the first one was received.
    """

    path: Path
    kind: str
    state: DecodeState
    sample: ByteArray
    dated: bool
    tally: Tally = field(default_factory=Tally)
    strange: int = 0
    first_s: float = float("nan")

    @classmethod
    def open(
        cls,
        path: str | Path,
        *,
        editions: Mapping[int, str] | None = None,
        date: datetime.date | None = None,
        categories: Collection[int] | None = None,
        sources: Collection[int] | None = None,
    ) -> Reader:
        """Look at a file; the arguments are those of `read_asterix`.  Raises InputError where it cannot be read or is empty."""
        state = DecodeState.begin(date, editions, categories=categories, sources=sources)
        path = Path(path)
        try:
            with open(path, "rb") as file:
                head = file.read(CHUNK)
            size = path.stat().st_size
        except OSError as error:
            raise InputError(
                f"cannot be read ({error.strerror or error})", path=path, remedy="Check the file's name and that you may read it."
            ) from error
        if not head:
            raise InputError("the file is empty", path=path, remedy="Give a recording of ASTERIX data blocks.")
        known = frozenset(uap.categories())
        kind = kind_of(head, size, known)
        if kind == "raw":
            sample = _buffer(head)
        else:
            first = next(portions(path, kind, Tally(), known), None)
            sample = _buffer(b"" if first is None else first.data)
        return cls(path, kind, state, sample, date is not None)

    def __iter__(self) -> Iterator[Records]:
        """The file's records, part by part; to be asked for once."""
        return self._raw() if self.kind == "raw" else self._wrapped()

    def _raw(self) -> Iterator[Records]:
        try:
            with open(self.path, "rb") as file:
                rest, here, first = b"", file.read(CHUNK), True
                while here:
                    following = file.read(CHUNK)
                    buffer = _buffer(rest + here)
                    nothing = np.zeros(1, np.int64), np.array([np.nan])
                    parts, state, used = _decode_all(buffer, self.state, *nothing, not following)
                    begin_s = _first_time(parts) if first else float("nan")
                    if np.isfinite(begin_s):
                        # The first stamp is damaged: it must not decide the day of all others.
                        state = replace(self.state, latest_s=self.state.day * DAY_S + begin_s)
                        parts, state, used = _decode_all(buffer, state, *nothing, not following)
                    if first and any(p.truncated for p in parts):
                        # What came ahead of the first full time of its source is completed from that one.
                        begin = _first_full_times(parts)
                        if begin:
                            parts, state, used = _decode_all(buffer, replace(self.state, stamps=begin), *nothing, not following)
                    self.state, rest, here, first = state, bytes(buffer[used:]), following, False
                    yield from parts
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror or error})", path=self.path) from error

    def _wrapped(self) -> Iterator[Records]:
        known = np.zeros(256, bool)
        known[list(uap.categories())] = True
        shift = float("nan")
        for portion in portions(self.path, self.kind, self.tally, frozenset(uap.categories())):
            portion, good = unwrapped(portion, known)
            received = portion.receive_s
            told = received[np.isfinite(received)]
            if np.isnan(shift) and len(told):
                # A damaged time of the first packet must not decide the day.
                near = np.abs(told[:9] - np.median(told[:9])) <= 3600.0
                self.first_s = float(told[np.argmax(near)])
                # The date that was given counts; in a capture the time of day of its clock goes with it.
                own = np.floor(self.first_s / DAY_S) if self.kind in ("pcap", "pcapng") else 0.0
                shift = (self.state.day - own) * DAY_S if self.dated or own == 0.0 else 0.0
                if not self.dated and own:
                    self.state = replace(self.state, day=int(own))
            received = received + (0.0 if np.isnan(shift) else shift)
            framed = int(np.count_nonzero(~good)) <= _APART
            if not framed:
                good[:] = True
            end = np.append(portion.begin[1:], len(portion.data))
            stranger = ~good & ~known[portion.data[portion.begin]]
            if stranger.any():
                # Behind a damaged block there may be others.
                whose = np.flatnonzero(stranger)
                for layout in _choices(self.state.editions):
                    row = np.zeros(_width(), np.uint16)
                    stranger[whose] &= ~_end_well(portion.data, portion.begin[whose], end[whose], layout.cats, layout.nodes, row)
            self.strange += int(np.count_nonzero(stranger))
            for low, high, sound in runs(good):
                if stranger[low]:
                    continue
                begin = portion.begin[low:high]
                buffer = _buffer(portion.data[begin[0] : end[high - 1]])
                here = replace(self.state, offset=0)
                parts, state, _ = _decode_all(buffer, here, begin - begin[0], received[low:high], True, framed and sound)
                self.state = state
                place = portion.offset[low:high]
                yield from (_moved(p, begin - begin[0], place) for p in parts)

    def remarks(self, date: datetime.date | None) -> list[str]:
        """What a reader should know of the container and of the date."""
        out: list[str] = []
        if self.kind not in ("pcap", "pcapng") or np.isnan(self.first_s):
            if date is None:
                out.append("no date was given: the first record's day counts as 1970-01-01 (--date gives its UTC date)")
        else:
            own = datetime.datetime.fromtimestamp(self.first_s, datetime.UTC).date()
            if date is not None and date != own:
                out.append(f"the capture was made on {own}, but the date given is {date}: that one counts")
        if self.tally.other:
            out.append(f"{self.tally.other} of {self.tally.packets} packets are no UDP datagrams: they were passed over")
        if self.tally.untimed:
            out.append(f"{self.tally.untimed} packets have impossible times of reception: they were not used")
        if self.strange:
            out.append(f"{self.strange} of {self.tally.datagrams} datagrams hold no ASTERIX: they were passed over")
        unread = [link_name(link) for link in self.tally.links if link not in READABLE]
        if unread:
            out.append(f"packets of link type {', '.join(unread)} cannot be read: they were passed over")
        return out


def _first_time(parts: list[Records]) -> float:
    """The first time of day (s) that goes with those that follow it, where the very first one does not; else NaN."""
    known = [p.time_s[np.isfinite(p.time_s)] for p in parts]
    tod = np.mod(np.concatenate([np.empty(0), *known])[:200], DAY_S)
    apart = np.abs(tod[:, None] - tod)
    alike = np.count_nonzero(np.minimum(apart, DAY_S - apart) <= _LEAP_S, axis=1)
    if len(tod) < 8 or alike[0] > 0.1 * len(tod) or alike.max() < 0.5 * len(tod):
        return float("nan")
    return float(tod[np.argmax(alike >= 0.5 * len(tod))])


def _first_full_times(parts: list[Records]) -> dict[int, float]:
    """The first time of each source that comes with a full time of day, where it has truncated ones too."""
    out: dict[int, float] = {}
    short = {int(s) for p in parts for s in np.unique(p.source[np.isin(p.category, list(uap.TRUNCATED_S)) & np.isnan(p.time_s)])}
    for part in parts:
        full = ~np.isin(part.category, list(uap.TRUNCATED_S)) & np.isfinite(part.time_s)
        for source in short - set(out):
            rows = np.flatnonzero(full & (part.source == source))
            if len(rows):
                out[source] = float(part.time_s[rows[0]])
    return out


def _moved(records: Records, begin: IntArray, place: IntArray) -> Records:
    """The same with the offsets of the file: what begins at `begin` (k,) in the data lies at `place` (k,)."""

    def move(at: AnyArray) -> IntArray:
        k = np.maximum(np.searchsorted(begin, at, side="right") - 1, 0)
        return np.asarray(place[k] + at - begin[k], np.int64)

    damaged = tuple(Damage(int(move(np.array([d.offset]))[0]), d.why) for d in records.damaged)
    return replace(records, offset=move(records.offset), damaged=damaged)


def _nothing(path: str | Path, reader: Reader, told: _Told) -> InputError:
    """Why no record at all could be read."""
    if reader.state.categories is not None or reader.state.sources is not None:
        chosen = [f"{c:03d}" for c in sorted(reader.state.categories or ())]
        chosen += [f"{s >> 8}/{s & 255}" for s in sorted(reader.state.sources or ())]
        return InputError(
            f"no record is of what was asked for ({', '.join(chosen)})", path=path, remedy="Ask for others, or all."
        )
    if reader.kind != "raw":
        name = {"pcap": "this capture", "pcapng": "this capture"}.get(reader.kind, "this file")
        worst = (*told.damaged, *reader.tally.damaged)[:1]
        why = f": byte {worst[0].offset}: {worst[0].why}" if worst else ""
        return InputError(
            f"none of the {reader.tally.datagrams} datagrams of {name} could be read as ASTERIX{why}", path=path,
            remedy=f"Categories that can be read: {', '.join(f'{c:03d}' for c in uap.categories())}.",
        )  # fmt: skip
    data = reader.sample
    known = ", ".join(f"{c:03d}" for c in uap.categories())
    remedy = f"A recording holds raw data blocks (category, length, records) of the categories {known}."
    head = data[:4096]
    printable = np.count_nonzero((head >= 32) & (head < 127) | (head == 9) | (head == 10) | (head == 13))
    if printable >= 0.95 * len(head):
        lines = bytes(head[:40]).decode("ascii", "replace").split("\n")
        return InputError(f"this is text ({lines[0].strip()!r} …), not ASTERIX", path=path, offset=0, remedy=remedy)
    if not head.any():
        return InputError("this is nothing but zeros, not ASTERIX", path=path, offset=0, remedy=remedy)
    if told.unknown and not told.damaged:
        found = ", ".join(f"{c:03d}" for c in told.unknown)
        return InputError(f"this holds only ASTERIX categories that cannot be read ({found})", path=path, remedy=remedy)
    first = told.damaged[0] if told.damaged else Damage(0, "every block is empty")
    return InputError(f"no ASTERIX record could be read: {first.why}", path=path, offset=first.offset, remedy=remedy)


def _spread(data: ByteArray, category: int, most: int = 256) -> list[int]:
    """Places of up to `most` whole blocks of a category, spread over the data."""
    places, _ = _blocks(data, 0, category, len(data))
    return places if len(places) <= most else [places[k] for k in np.linspace(0, len(places) - 1, most).astype(int)]


def _check_editions(path: str | Path, data: ByteArray, given: Mapping[int, str]) -> None:
    """Raise InputError where the records fit another edition clearly better than the one that was given."""
    for category, edition in given.items():
        if category not in uap.INFERRED:
            continue
        places = _spread(data, category)
        if not places:
            continue
        best, score = _infer(data, places, category)
        if score >= 0.5 and _score(data, places, category, edition) < 0.5 * score:
            raise _other_edition(path, category, edition, best, "their lengths, positions or times do not make sense")


def _check_positions(path: str | Path, data: ByteArray, told: _Told, editions: Mapping[int, str]) -> None:
    """Raise InputError where a fifth of the positions is impossible and another edition fits, or where most are."""
    for category, edition in editions.items():
        wrong, known = told.places.get(category, (0, 0))
        if category in uap.INFERRED and known >= _JUDGED and wrong > 0.2 * known:
            best, _ = _infer(data, _spread(data, category), category)
            if uap.table_of(category, edition) == uap.table_of(category, best) and wrong <= 0.5 * known:
                # A damaged file: what is right in it is of use.
                continue
            raise _other_edition(path, category, edition, best, f"{wrong} of {known} positions are not on Earth")


def _other_edition(path: str | Path, category: int, edition: str, best: str, what: str) -> InputError:
    name = f"{category:03d}"
    if uap.table_of(category, edition) == uap.table_of(category, best):
        return InputError(f"the records of category {name} fit no known edition ({edition} the best): {what}", path=path,
                          remedy="Is the file damaged, or of an edition that is not known?")  # fmt: skip
    return InputError(
        f"the records of category {name} are not of edition {edition} ({what}); they fit edition {best}", path=path,
        remedy=f"Give --edition {name}={best}, or none to have it inferred.",
    )  # fmt: skip


def _sources(records: Records, editions: Mapping[int, str]) -> tuple[Source, ...]:
    """Who sent what: one a SAC/SIC and category, in that order."""
    key = records.source.astype(np.int64) << 8 | records.category
    places = {source: place for source, *place in records.site}
    tables = (records.plots, records.fixes, records.tracks)
    plot_key = key[records.plots.record]
    row_key = np.concatenate([key[t.record] for t in tables])
    mode_s, track = np.concatenate([t.mode_s for t in tables]), np.concatenate([t.track for t in tables])
    out: list[Source] = []
    for k in np.unique(key).tolist():
        source, category = k >> 8, k & 255
        times = records.time_s[key == k]
        times = times[np.isfinite(times)]
        span = (float(times.min()), float(times.max())) if len(times) else (float("nan"),) * 2
        known = mode_s[(row_key == k) & (mode_s >= 0)]
        if not len(known):
            known = track[(row_key == k) & (track >= 0)]
        latitude, longitude, height = places.get(source, [float("nan")] * 3)
        out.append(
            Source(
                sac=source >> 8,
                sic=source & 255,
                category=category,
                edition=editions.get(category) or uap.default_edition(category),
                records=int(np.count_nonzero(key == k)),
                plots=int(np.count_nonzero(plot_key == k)),
                start_s=span[0],
                end_s=span[1],
                targets=len(np.unique(known)),
                latitude_rad=latitude,
                longitude_rad=longitude,
                height_m=height,
                notes=tuple(
                    f"sensor {about >> 8}/{about & 255}: {text}"
                    for (whose, which, about), text in sorted(records.notes.items())
                    if (whose, which) == (source, category) and text
                ),
            )
        )
    return tuple(out)


# ----------------------------------------------------------------------------------------------------------- single records


def item_places(
    data: ByteArray, start: IntArray, length: IntArray, category: int, edition: str, items: Collection[str]
) -> list[tuple[int, IntArray, IntArray]]:
    """Where items of known records lie: by list of items, its number, the rows that have it (m,), and places (m, k) in `data`.

    The records of one category begin at `start` (n,) and have `length` (n,) bytes.  A place is 0 where the record does not have
    the item (nor its list), or is no whole record.
    """
    layout = _layout_of({category: edition})
    places = np.zeros((len(start), layout.width), np.uint16)
    start = np.ascontiguousarray(start, np.int64)
    _records(_buffer(data), start, np.ascontiguousarray(length, np.int64), layout.cats, layout.nodes, category, places)
    out: list[tuple[int, IntArray, IntArray]] = []
    for form, rows in _forms(_buffer(data), start, places, np.arange(len(start)), category):
        slots = _slots(form, edition)
        at = np.zeros((len(rows), len(items)), np.int64)
        for k, name in enumerate(items):
            if name in slots:
                inside = places[rows, slots[name]].astype(np.int64)
                at[:, k] = np.where(inside > 0, start[rows] + inside, 0)
        out.append((form, rows, at))
    return out


def digests(data: ByteArray, start: IntArray, length: IntArray) -> IntArray:
    """The `Records.digest` (n,) of the records that begin at `start` (n,) and have `length` (n,) bytes."""
    out = np.empty(len(start), np.int64)
    _digest(_buffer(data), np.ascontiguousarray(start, np.int64), np.ascontiguousarray(length, np.int64), out)
    return out


@dataclass(frozen=True, slots=True)
class ItemRecord:
    """One record with the bytes of each of its items ("040") and sub-items ("130/RPD"), in the order of the record."""

    offset: int
    category: int
    edition: str
    items: dict[str, bytes]

    @property
    def form(self) -> int:
        """The number of the list of items that the record has: its category, or that of its category's second list."""
        second = self.category in uap.SECOND and self.items.get("020", b"\0")[0] >= 0x80
        return uap.SECOND[self.category] if second else self.category

    def values(self, name: str) -> list[dict[str, int | float | str]]:
        """The fields of an item, as its category document has them (its units, codes as integers); one dict a repetition.

        Extended items have the fields of the parts that are there.  Items without a described inside (RE, SP) give no fields.
        """
        wanted, _, child = name.partition("/")
        item = next(i for i in uap.items_of(self.form, self.edition) if i is not None and i.name == wanted)
        if child:
            item = next(i for i in item.subitems if i is not None and i.name == child)
        raw = self.items[name]
        if item.kind == uap.REPETITIVE:
            return [_values(item, raw[at : at + item.size]) for at in range(1, len(raw), item.size)]
        if item.kind == uap.EXTENDED and _listed(item):
            return [_values(item, raw[at : at + item.size]) for at in range(0, len(raw), item.size)]
        return [] if item.kind in (uap.EXPLICIT, uap.COMPOUND, uap.RANDOM) else [_values(item, raw)]


def _values(item: uap.Item, raw: bytes) -> dict[str, int | float | str]:
    whole = int.from_bytes(raw, "big")
    out: dict[str, int | float | str] = {}
    for f in item.fields:
        shift = len(raw) * 8 - f.bit - f.bits
        if shift < 0:
            continue
        value = whole >> shift & (1 << f.bits) - 1
        if f.signed and value >> (f.bits - 1):
            value -= 1 << f.bits
        if f.text:
            out[f.name] = unpack_callsigns(np.array([value]))[0]
        else:
            out[f.name] = value * f.lsb if f.scaled else value
    return out


def decode_items(data: bytes, editions: Mapping[int, str] | None = None) -> Iterator[ItemRecord]:
    """Every item of every record, as bytes: to look at records, and to compare decoders.

    `data` are whole blocks; damaged records are passed over.  `editions` as in `read_asterix`; a category whose edition has to be
    inferred and is not given has its usual one.
    """
    known = {c: uap.default_edition(c) for c in uap.categories()} | dict(editions or {})
    layout = _layout_of(known)
    buffer = _buffer(data)
    room = min(_ROWS, len(buffer) // 3 + 1)
    start, length, cats = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.uint8)
    pos = 0
    while pos < len(buffer):
        items = np.zeros((room, layout.width), np.uint16)
        n, stop, how, *_ = _walk(buffer[pos:], 0, True, layout.cats, layout.nodes, start, length, cats, items)
        for i in range(n):
            begin, category = pos + int(start[i]), int(cats[i])
            places = items[i].tolist()
            ((form, _),) = _forms(buffer[pos:], start, items, np.array([i]), category)
            here = {name: places[slot] for name, slot in _slots(form, known[category]).items() if places[slot]}
            raw = bytes(buffer[begin : begin + int(length[i])])
            yield ItemRecord(begin, category, known[category], _cut(raw, here))
        pos += stop
        if how in (_RECORD, _STRANGE):
            pos = _end(buffer, pos)
        elif how != _FULL:
            return


def _cut(record: bytes, places: dict[str, int]) -> dict[str, bytes]:
    """The bytes of each item: up to where the next one begins; those of a sub-item within those of its item."""
    order = sorted(places, key=lambda name: (places[name], "/" in name))
    top = [name for name in order if "/" not in name]
    ends = {name: (places[top[k + 1]] if k + 1 < len(top) else len(record)) for k, name in enumerate(top)}
    for k, name in enumerate(order):
        if "/" in name:
            owner = name.partition("/")[0]
            last = k + 1 == len(order) or order[k + 1].partition("/")[0] != owner
            ends[name] = ends[owner] if last else places[order[k + 1]]
    return {name: record[places[name] : ends[name]] for name in order}
