"""Corrected recordings: the measured items of an ASTERIX file encoded anew where they stand, every other byte as it was.

Of each record with a measured polar position three things change: its time of day (I048/140, I010/140, I001/141), its polar
position (I048/040, I010/040, I001/040) and, where it has one, its Cartesian position (I048/042, I010/042, I001/042).  Lengths,
blocks, other items, other categories and what wraps the blocks (packets, recorders' headers) stay; only the UDP checksum of a
packet that was changed follows its content.

A value that lies between two codes goes to either of them, with the odds that keep the mean: an error of a third of a code would
else come out whole or not at all.  Which one is drawn from the record's own bytes, so that the same file gives the same file and
duplicated records stay duplicates; for the time it is drawn from the stamp, so that what was in order stays in order.
"""

from __future__ import annotations

import datetime
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .._types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from ..errors import InputError
from ..model import Damage, Plots
from ..reading import uap
from ..reading.asterix import DAY_S, Stream, digests, item_places
from ..reading.capture import Tally, portions
from . import atomic

# Bytes of the file that are patched at once.
_PIECE = 8 << 20
# Nearer to a code than this (of a code) a value is that code: what was not corrected must not move by the rounding of floats.
_SAME = 1e-4
# A Cartesian position within so many codes of the polar one is made from it; else it is tracked, projected, or counts from
# another origin, and is moved along.
_SAME_PLACE = 1.0
_TIMES_PER_S = 128


@dataclass(frozen=True, slots=True)
class _Codes:
    """The items of one list of a category that are encoded anew: item and field of time, range, azimuth, x and y ("": none)."""

    time: str
    range: str
    azimuth: str
    x: str = ""
    y: str = ""


_ITEMS: dict[int, _Codes] = {
    1: _Codes("141.141", "040.RHO", "040.THETA"),
    256: _Codes("141.141", "040.RHO", "040.THETA", "042.X", "042.Y"),
    10: _Codes("140.140", "040.RHO", "040.TH", "042.X", "042.Y"),
    48: _Codes("140.140", "040.RHO", "040.THETA", "042.X", "042.Y"),
}
_NAMES = ("140", "141", "040", "042")

_NEGATIVE = "get a negative range"
_BEYOND = "get a position beyond what their items can hold"
_UNKNOWN = "have no finite position or correction"
_PIECES = "lie in datagrams that were sent in pieces"


@dataclass(frozen=True, slots=True, eq=False)
class Original:
    """A recording of ASTERIX with the place of each plot's record in the file.

    `plots` (n,) with `offset` (n,), `length` (n,), `category` (n,) and `digest` (n,) of their records; `kind` is "raw", "pcap",
    "pcapng", "final" or "gps"; `records` counts all records, `editions` are those given or inferred.
    """

    path: Path
    kind: str
    plots: Plots
    offset: IntArray
    length: IntArray
    category: AnyArray
    digest: IntArray
    editions: Mapping[int, str]
    records: int
    damaged: tuple[Damage, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Rounding:
    """What encoding added to a value: `lsb` and root mean square `rms` of the rounding, in `unit`, over `count` records."""

    item: str
    unit: str
    lsb: float
    rms: float
    count: int


@dataclass(frozen=True, slots=True)
class Reencoded:
    """What became of a recording: records in all, records changed, and why others were left as they were (reason: how many).

    `notes` says what else must be known of the changed ones.
    """

    kind: str
    records: int
    plots: int
    changed: int
    left: Mapping[str, int]
    rounding: tuple[Rounding, ...]
    notes: tuple[str, ...] = ()


def open_original(path: str | Path, *, editions: Mapping[int, str] | None = None, date: datetime.date | None = None) -> Original:
    """Read the plots of a recording of ASTERIX and where their records lie; arguments and errors as `read_asterix`."""
    stream = Stream.open(path, editions=editions, date=date)
    plots: list[Plots] = []
    rows: list[tuple[AnyArray, ...]] = []
    base = 0
    for part in stream:
        mine = part.plots.record - base
        plots.append(part.plots)
        rows.append((part.offset[mine], part.length[mine], part.category[mine], part.digest[mine]))
        base += len(part.offset)
    offset, length, category, digest = (np.concatenate(column) for column in zip(*rows, strict=True))
    return Original(
        path=Path(path),
        kind=stream.reader.kind,
        plots=Plots.concat(plots),
        offset=offset,
        length=length,
        category=category,
        digest=digest,
        editions=dict(stream.reader.state.editions),
        records=base,
        damaged=stream.damaged,
        warnings=stream.warnings,
    )


def reencode(original: Original, corrected: Plots, out: str | Path) -> Reencoded:
    """Write the recording again with its plots' times and positions as in `corrected`, and every other byte as it was.

    `corrected` has the rows of ``original.plots``, in their order, as `boresight.correct` returns them.  Rows whose time, range
    and azimuth did not change are left alone.  A record whose corrected values its items cannot hold stays as it was, as a whole,
    and is counted.  The file is whole or not there.  Raises InputError where it cannot be written.
    """
    plots = original.plots
    if len(corrected) != len(plots):
        raise InputError(f"{len(corrected)} corrected plots do not fit the {len(plots)} of the recording", path=original.path)
    if Path(out).resolve() == original.path.resolve():
        raise InputError("the recording itself is never written to", path=out, remedy="Name another file.")
    pairs = [(getattr(plots, n), getattr(corrected, n)) for n in ("time_s", "range_m", "azimuth_rad")]
    touched = np.logical_or.reduce([(a != b) & ~(np.isnan(a) & np.isnan(b)) for a, b in pairs])
    order = np.flatnonzero(touched)[np.argsort(original.offset[touched], kind="stable")]
    tally = _Tally()
    done = np.zeros(len(plots), bool)
    try:
        with atomic(out) as beside:
            shutil.copyfile(original.path, beside)
            with open(original.path, "rb") as source, open(beside, "r+b") as target:
                for rows in _pieces(original, order):
                    begin = int(original.offset[rows[0]])
                    size = int((original.offset[rows] + original.length[rows]).max()) - begin
                    source.seek(begin)
                    data = np.frombuffer(bytearray(source.read(size)), np.uint8)
                    done[rows] = _patch(data, begin, original, corrected, rows, tally)
                    target.seek(begin)
                    target.write(data.tobytes())
                if original.kind in ("pcap", "pcapng"):
                    target.flush()
                    _renew_checksums(original, np.sort(original.offset[done]), source, target)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=original.path) from error
    notes = [f"{count:,} records {text}" for text, count in tally.notes.items()]
    timed = np.flatnonzero(np.isfinite(plots.time_s) & np.isfinite(corrected.time_s))[:1]
    days = [np.floor(table.time_s[timed] / DAY_S).astype(np.int64).tolist() for table in (plots, corrected)]
    if days[0] != days[1] and done[timed].any():
        date = datetime.date(1970, 1, 1) + datetime.timedelta(days=days[1][0])
        notes.append(f"the first plot is of {date} now: that is the date (--date) of the corrected recording")
    if len(plots) - len(order):
        tally.left["have nothing to correct: the calibration is not of their radar or channel"] = len(plots) - len(order)
    if original.records - len(plots):
        tally.left["hold no measured polar position (north marks, status): they keep the radar's own clock"] = (
            original.records - len(plots)
        )
    return Reencoded(
        kind=original.kind,
        records=original.records,
        plots=len(plots),
        changed=int(np.count_nonzero(done)),
        left=tally.left,
        rounding=tally.rounding(),
        notes=tuple(notes),
    )


@dataclass(slots=True)
class _Tally:
    """What is counted on the way: reasons and remarks, and the rounding of each field (unit, LSB, sum of squares, count)."""

    left: dict[str, int] = field(default_factory=dict)
    notes: dict[str, int] = field(default_factory=dict)
    rounded: dict[str, tuple[str, float, float, int]] = field(default_factory=dict)

    def leave(self, why: str, rows: BoolArray) -> None:
        _count(self.left, why, rows)

    def note(self, what: str, rows: BoolArray) -> None:
        _count(self.notes, what, rows)

    def add(self, item: str, bits: uap.Field, off: FloatArray) -> None:
        """The rounding `off` (n,) of a field, in codes."""
        _, _, squares, count = self.rounded.get(item, ("", 0.0, 0.0, 0))
        scale = bits.lsb * (uap.SI["NM"] if bits.unit == "NM" else 1.0)
        unit = "m" if bits.unit == "NM" else bits.unit
        self.rounded[item] = unit, scale, squares + float(np.sum(off**2)), count + len(off)

    def rounding(self) -> tuple[Rounding, ...]:
        return tuple(
            Rounding(item, unit, lsb, float(lsb * np.sqrt(squares / count)), count)
            for item, (unit, lsb, squares, count) in sorted(self.rounded.items())
            if count
        )


def _count(table: dict[str, int], key: str, rows: BoolArray) -> None:
    count = int(np.count_nonzero(rows))
    if count:
        table[key] = table.get(key, 0) + count


def _pieces(original: Original, order: IntArray) -> Iterator[IntArray]:
    """The rows of `order` in runs whose records lie near each other in the file."""
    low = 0
    begin = original.offset[order]
    while low < len(order):
        high = max(int(np.searchsorted(begin, begin[low] + _PIECE)), low + 1)
        yield order[low:high]
        low = high


def _field(form: int, edition: str, text: str) -> tuple[str, uap.Field]:
    """The item and the field that a text like "040.RHO" names."""
    name, _, part = text.partition(".")
    item = next(i for i in uap.items_of(form, edition) if i is not None and i.name == name)
    return name, next(f for f in item.fields if f.name == part)


def _get(data: ByteArray, at: IntArray, bits: uap.Field) -> IntArray:
    """The codes of a field whose item begins at `at` (n,)."""
    value = np.zeros(len(at), np.int64)
    for k in range(bits.bit // 8, (bits.bit + bits.bits) // 8):
        value = value << 8 | data[at + k]
    return value - ((value >> (bits.bits - 1)) << bits.bits) if bits.signed else value


def _put(data: ByteArray, at: IntArray, bits: uap.Field, code: IntArray) -> None:
    count = bits.bits // 8
    for k in range(count):
        data[at + bits.bit // 8 + k] = (code >> 8 * (count - 1 - k) & 255).astype(np.uint8)


def _uniform(key: IntArray, salt: int) -> FloatArray:
    """A number in [0, 1) from each key: the finisher of splitmix64."""
    z = key.astype(np.uint64) + np.uint64((salt * 0x9E3779B97F4A7C15) % (1 << 64))
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        z = (z ^ (z >> np.uint64(shift))) * np.uint64(factor)
    return (z ^ (z >> np.uint64(31))).astype(np.float64) * 2.0**-64 % 1.0


def _coded(value: FloatArray, key: IntArray, salt: int) -> IntArray:
    """Values in codes as whole codes: one of the two beside, with the odds that keep the mean."""
    near = np.rint(value)
    return np.where(np.abs(value - near) < _SAME, near, np.floor(value + _uniform(key, salt))).astype(np.int64)


def _patch(data: ByteArray, begin: int, original: Original, corrected: Plots, rows: IntArray, tally: _Tally) -> BoolArray:
    """Encode some rows anew in `data`, which begins at `begin` in the file; returns which ones were changed (n,)."""
    done = np.zeros(len(rows), bool)
    start = original.offset[rows] - begin
    length = original.length[rows]
    there = start + length <= len(data)
    there[there] = digests(data, start[there], length[there]) == original.digest[rows[there]]
    tally.leave(_PIECES, ~there)
    for category in np.unique(original.category[rows[there]]).tolist():
        mine = np.flatnonzero(there & (original.category[rows] == category))
        edition = original.editions.get(category) or uap.default_edition(category)
        for form, some, places in item_places(data, start[mine], length[mine], category, edition, _NAMES):
            if form in _ITEMS:
                index = mine[some]
                done[index] = _patch_form(data, original, corrected, rows[index], places, form, category, edition, tally)
    return done


def _patch_form(
    data: ByteArray, original: Original, corrected: Plots, rows: IntArray, places: IntArray,
    form: int, category: int, edition: str, tally: _Tally,
) -> BoolArray:  # fmt: skip
    """The same for rows of one list of items, whose items lie at `places` (n, k)."""
    old, items = original.plots, _ITEMS[form]
    key = original.digest[rows]
    where = dict(zip(_NAMES, places.T, strict=True))
    good = np.isfinite(corrected.range_m[rows] + corrected.azimuth_rad[rows])
    tally.leave(_UNKNOWN, ~good)
    below = good & (corrected.range_m[rows] < 0)
    tally.leave(_NEGATIVE, below)
    good &= ~below

    # Polar.
    name, rho = _field(form, edition, items.range)
    _, theta = _field(form, edition, items.azimuth)
    polar_at = where[name]
    lsb_m = rho.lsb * uap.SI[rho.unit]
    turn = 1 << theta.bits
    new_range = np.where(good, corrected.range_m[rows], 0.0)
    new_azimuth = np.where(good, corrected.azimuth_rad[rows], 0.0)
    exact_range, exact_azimuth = new_range / lsb_m, new_azimuth / (2 * np.pi) * turn
    range_code, azimuth_code = _coded(exact_range, key, 1), _coded(exact_azimuth, key, 2)
    # The highest code also stands for all that is beyond.
    most = (1 << rho.bits) - 1
    beyond = good & ((range_code >= most) | (_get(data, polar_at, rho) == most))

    # Cartesian: the position that the corrected polar one gives, or moved as far as the polar one.
    flat: list[tuple[uap.Field, FloatArray, IntArray, BoolArray]] = []
    plane_at = np.zeros(len(rows), np.int64)
    if items.x:
        name, x = _field(form, edition, items.x)
        _, y = _field(form, edition, items.y)
        plane_at = where[name]
        has = plane_at > 0
        lsb_xy = x.lsb * uap.SI[x.unit]
        codes = [np.where(has, _get(data, np.where(has, plane_at, 0), f), 0) for f in (x, y)]
        edge = (1 << (x.bits - 1)) - 1
        clipped = has & ((codes[0] >= edge) | (codes[0] <= -edge - 1) | (codes[1] >= edge) | (codes[1] <= -edge - 1))
        before = [old.range_m[rows] * f(old.azimuth_rad[rows]) / lsb_xy for f in (np.sin, np.cos)]
        after = [new_range * f(new_azimuth) / lsb_xy for f in (np.sin, np.cos)]
        same = np.logical_and(*(np.abs(c - b) <= _SAME_PLACE for c, b in zip(codes, before, strict=True)))
        has &= ~clipped
        for salt, bits, code, b, a in zip((3, 4), (x, y), codes, before, after, strict=True):
            exact = np.where(same, a, code + (a - b))
            new = np.where(same, np.rint(a).astype(np.int64), _coded(exact, key, salt))
            beyond |= good & has & (np.abs(new) >= edge)
            flat.append((bits, exact, new, has))
        tally.note("have a Cartesian position at the end of its range, which was left", good & clipped)
        moved = good & has & ~beyond & ~same
        tally.note("have a Cartesian position that is not the polar one; it was moved along with it", moved)
    tally.leave(_BEYOND, beyond)
    good &= ~beyond

    # Time: counted within the day, so that midnight and the cut of truncated times come by themselves.
    name, clock = _field(form, edition, items.time)
    time_at = where[name]
    late = np.where(good, old.time_s[rows] - corrected.time_s[rows], 0.0)
    timed = good & (time_at > 0) & np.isfinite(old.time_s[rows]) & np.isfinite(late)
    whole = np.rint(np.mod(np.where(timed, old.time_s[rows], 0.0), DAY_S) * _TIMES_PER_S).astype(np.int64)
    exact_time = whole - np.where(timed, late, 0.0) * _TIMES_PER_S
    time_code = _coded(exact_time, whole, 5)
    tally.note("have no known time; only their position was corrected", good & ~timed)

    prefix = f"I{category:03d}/"
    for bits, at, exact, code, use in (
        (rho, polar_at, exact_range, range_code, good),
        (theta, polar_at, exact_azimuth, azimuth_code, good),
        *((b, plane_at, e, c, h & good) for b, e, c, h in flat),
        (clock, time_at, exact_time, time_code, timed),
    ):
        item = next(n for n, places_of in where.items() if places_of is at)
        own = f"{prefix}{item}" if bits.name == item else f"{prefix}{item} {bits.name}"
        tally.add(own, bits, (code - exact)[use])
        wrapped = np.mod(code, int(DAY_S) * _TIMES_PER_S) if bits is clock else code
        _put(data, at[use], bits, wrapped[use])
    return good


def _renew_checksums(original: Original, changed: IntArray, source: BinaryIO, target: BinaryIO) -> None:
    """Let the UDP checksums of a capture follow what changed in the datagrams that hold the records at `changed` (n,), sorted.

    By the difference (RFC 1624): one that was wrong, as captures of a sender's own packets have them, stays as wrong as it was.
    """
    for portion in portions(original.path, original.kind, Tally(), frozenset(uap.categories())):
        length = np.diff(np.append(portion.begin, len(portion.data)))
        low, high = (np.searchsorted(changed, portion.offset + more) for more in (0, length))
        for k in np.flatnonzero(high > low).tolist():
            # The checksum is the last field ahead of the content.
            place, size = int(portion.offset[k]) - 2, int(length[k]) + 2
            source.seek(place)
            target.seek(place)
            before, after = (np.frombuffer(file.read(size), np.uint8) for file in (source, target))
            check = int(before[0]) << 8 | int(before[1])
            if check:
                total = ((check ^ 0xFFFF) + _words(after[2:]) - _words(before[2:])) % 0xFFFF
                target.seek(place)
                target.write((total ^ 0xFFFF).to_bytes(2, "big"))


def _words(data: ByteArray) -> int:
    """The sum of the 16-bit words of some bytes."""
    even = data if len(data) % 2 == 0 else np.append(data, np.uint8(0))
    return int(even.view(">u2").sum(dtype=np.int64)) if len(even) else 0
