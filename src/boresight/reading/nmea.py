"""NMEA 0183: a ship's or a station's log to plots, fixes, tracks and own ship.

`decode_nmea` does no input or output: bytes and a state go in, tables and the next state come out, for files and live lines
alike; `read_nmea` and `read_ais` serve files.  Reading has two steps.  `_observe` takes the fields of each kind of sentence, a
kind at a time, into columns; `_resolve` then finds the time of every sentence and own ship's heading, and makes the tables.

Time: a sentence's own UTC comes first, then the stamp of its tag block or line, then the times of the sentences around it.  The
date is that of RMC or ZDA, else of the stamps, else of AIS base stations, else the given one, else day 0.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from ..errors import InputError
from ..model import Channel, Damage, Fixes, Flag, Platform, Plots, Recording, Source, Tracks
from . import ais
from .sentences import Numbers, Scan, address_of, clock, degrees, letters, name_of, numbers, scan, words

DAY_S = 86400.0
# The id of a radar that tells no SAC and SIC, unless sensors.toml gives another.
DEFAULT_SENSOR = 65536
# A GPS receiver whose count of weeks ran over is wrong by this.
_WEEKS_S = 1024 * 7 * DAY_S
# Times of sentences without one come from their neighbours if those are this close together, else from the last one.
_AROUND_S = 30.0
# Headings, speeds and positions of own ship are interpolated over gaps up to these; one that is alone holds for a moment.
_HEADING_GAP_S, _POSITION_GAP_S, _ALONE_S = 10.0, 30.0, 2.0
# A second source of own ship's heading or position is used where the first one is silent for this long.
_SILENT_S = 5.0
# A line's stamp that differs by more than this from the sentences' own UTC comes from a clock that is wrong, not from latency.
_WRONG_CLOCK_S = 2.0
_MOST_RANGE_M, _MOST_SPEED_MPS = 500e3, 1500.0
_CHUNK = 1 << 24
# Metres, and metres per second, of the units K (kilometres), N (nautical miles) and S (statute miles).
_LENGTH = {ord("K"): 1000.0, ord("N"): 1852.0, ord("S"): 1609.344}
# Per axis, by the quality that GGA tells: GPS alone, differential, precise, RTK fixed and float, dead reckoning.
_QUALITY_SD_M = {1: 5.0, 2: 2.0, 3: 3.0, 4: 0.05, 5: 0.5, 6: 50.0, 9: 1.0}

Columns = dict[str, AnyArray]

_TABLES: dict[str, dict[str, type]] = {
    "position": {"record": int, "lat": float, "lon": float, "height": float, "sd": float, "rank": int, "talker": int},
    "motion": {"record": int, "speed": float, "course": float, "rank": int, "talker": int},
    "heading": {"record": int, "value": float, "magnetic": bool, "rank": int, "talker": int},
    "variation": {"record": int, "value": float},
    "roll": {"record": int, "value": float, "rank": int, "talker": int},
    "pitch": {"record": int, "value": float, "rank": int, "talker": int},
    "ttm": {
        "record": int,
        "range": float,
        "bearing": float,
        "relative": bool,
        "speed": float,
        "course": float,
        "course_relative": bool,
        "track": int,
        "flags": int,
        "talker": int,
    },
    "tll": {"record": int, "lat": float, "lon": float, "track": int, "flags": int, "talker": int},
    "scale": {"record": int, "range": float},
}


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a stretch of sentences said: a row a sentence, and the columns of each kind."""

    offset: IntArray
    address: IntArray
    gnss: BoolArray
    tod_s: FloatArray
    day: IntArray
    stamp_s: FloatArray
    tables: dict[str, Columns]
    messages: ais.Messages
    damaged: tuple[Damage, ...]
    counts: dict[str, int]


@dataclass(frozen=True, slots=True)
class NmeaState:
    """What one stretch of a stream hands to the next; `NmeaState()` begins one.

    `offset` and `records` count what was read.  `checksums` False accepts sentences without a checksum.  `day` is the date of the
    first sentence, in days since 1970, where none tells one.  `radars` are the talkers that sent targets, in the order in which
    they came: the first has the id `sensor`, the next one more.
    """

    offset: int = 0
    records: int = 0
    sensor: int = DEFAULT_SENSOR
    checksums: bool = True
    day: int | None = None
    clock_s: float = float("nan")
    dated: bool = False
    heading: tuple[float, float, bool] | None = None
    variation_rad: float = float("nan")
    radars: tuple[int, ...] = ()
    parts: tuple[ais.Part, ...] = ()
    ais_sentences: int = 0
    static: tuple[tuple[int, ...], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class NmeaRecords:
    """The tables of some sentences, and one row a sentence: its byte `offset`, `address` and `time_s` (n,).

    `messages` is the kind of each AIS message with its record; `notes` says what a reader should know.
    """

    plots: Plots
    fixes: Fixes
    tracks: Tracks
    platform: Platform
    offset: IntArray
    address: IntArray
    time_s: FloatArray
    messages: Columns
    damaged: tuple[Damage, ...]
    notes: tuple[str, ...]
    dated: bool


# --------------------------------------------------------------------------------------------------------------- recognising

_LOOKS = re.compile(rb"[$!][A-Z][A-Z0-9]{3,7},[^$!*\r\n]{0,1000}\*([0-9A-Fa-f]{2})")
_SHAPE = re.compile(rb"(?:^|[\r\n;\s\\])[$!][A-Z]{2}[A-Z]{3},[\x20-\x7e]*")


def looks_like_nmea(head: bytes) -> bool:
    """Whether the first kilobytes of a file hold NMEA 0183: a sentence whose checksum is right, or lines of that form."""
    for found in list(_LOOKS.finditer(head))[:64]:
        check = 0
        for c in found[0][1:-3]:
            check ^= c
        if check == int(found[1], 16):
            return True
    lines = [line for line in re.split(rb"[\r\n]+", head)[:200] if line.strip()]
    return bool(lines) and sum(_SHAPE.match(line) is not None for line in lines) >= 0.6 * len(lines)


# ----------------------------------------------------------------------------------------------------------------- observing


class _Kind(NamedTuple):
    """The sentences of one kind while their fields are taken; `bad` collects what makes no sense."""

    s: Scan
    rows: IntArray
    talker: IntArray
    bad: list[tuple[BoolArray, str]]

    def number(self, k: int, what: str, least: float = -np.inf, most: float = np.inf) -> Numbers:
        v = numbers(self.s, self.rows, k)
        self.bad.append((v.bad | (v.value < least) | (v.value > most), what))
        return v

    def angle(self, k: int, what: str) -> FloatArray:
        return np.radians(self.number(k, what, 0.0, 360.0).value)

    def letter(self, k: int) -> ByteArray:
        return letters(self.s, self.rows, k)

    def time(self, k: int) -> FloatArray:
        out, bad = clock(self.s, self.rows, k)
        self.bad.append((bad, "time"))
        return out

    def place(self, k: int) -> tuple[FloatArray, FloatArray]:
        lat, bad = degrees(self.s, self.rows, k, "N", "S")
        lon, worse = degrees(self.s, self.rows, k + 2, "E", "W")
        self.bad.append((bad, "latitude"))
        self.bad.append((worse, "longitude"))
        return np.radians(lat), np.radians(lon)

    def east(self, k: int, what: str) -> FloatArray:
        """An angle with its letter E (positive) or W, radians; NaN where either is empty."""
        value = np.radians(self.number(k, what, -180.0, 180.0).value)
        side = self.letter(k + 1)
        self.bad.append((np.isfinite(value) & (side != ord("E")) & (side != ord("W")) & (side != 0), f"{what}'s side"))
        return np.where(side == ord("E"), value, np.where(side == ord("W"), -value, np.nan))


def _observe(s: Scan, record: int, offset: int) -> tuple[dict[str, list[Columns]], Columns, list[Damage], dict[str, int]]:
    """Take the fields of all sentences: rows of tables, the columns of each sentence, what makes no sense, and counts."""
    n = len(s.start)
    tod, day = np.full(n, np.nan), np.full(n, -1, np.int64)
    gnss = np.zeros(n, bool)
    rows_of: dict[str, list[Columns]] = {name: [] for name in _TABLES}
    counts: dict[str, int] = {}
    damaged: list[Damage] = []
    standard = (s.address >= 1 << 32) & (s.address < 1 << 40) & (s.address >> 32 != ord("P"))
    formatter = np.where(standard, s.address & 0xFFFFFF, 0)
    # Its maker sends other things by this name too; only the attitude has the T of a true heading there.
    ours = np.flatnonzero(s.address == _ATTITUDE)
    formatter[ours[letters(s, ours, 3) == ord("T")]] = _ATTITUDE
    for code in np.unique(formatter).tolist():
        take = _KINDS.get(name_of(code))
        if take is None:
            continue
        rows = np.flatnonzero(formatter == code)
        k = _Kind(s, rows, s.address[rows] >> 24, [])
        got = take(k)
        sound = np.ones(len(rows), bool)
        for bad, what in k.bad:
            for row in rows[bad & sound].tolist():
                text = bytes(s.data[s.start[row] : s.star[row]])[:80].decode("latin-1")
                damaged.append(Damage(offset + int(s.start[row]), f"{text} … makes no sense: its {what}"))
            sound &= ~bad
        for name, (columns, use) in got.tables.items():
            keep = sound & use
            rows_of[name].append(
                {"record": record + rows[keep]} | {c: np.asarray(v)[keep] for c, v in columns.items()}
                | ({"talker": k.talker[keep]} if "talker" in _TABLES[name] else {})
            )  # fmt: skip
        for what, mask in got.counts.items():
            counts[what] = counts.get(what, 0) + int(np.count_nonzero(mask & sound))
        if got.tod is not None:
            tod[rows] = np.where(sound & got.timed, got.tod, np.nan)
            gnss[rows] = got.gnss & np.isfinite(tod[rows])
        if got.day is not None:
            day[rows] = np.where(sound, got.day, -1)
    columns = {"offset": offset + s.start, "address": s.address, "gnss": gnss, "tod": tod, "day": day, "stamp": s.stamp_s}
    return rows_of, columns, damaged, counts


class _Got(NamedTuple):
    """What the sentences of one kind gave: tables with the rows that count, times of day, dates, counts of what was left out."""

    tables: dict[str, tuple[Columns, BoolArray]]
    tod: FloatArray | None = None
    timed: BoolArray | bool = True
    day: IntArray | None = None
    gnss: bool = False
    counts: dict[str, BoolArray] = {}  # noqa: RUF012  never written to


def _days(year: IntArray, month: IntArray, day: IntArray) -> tuple[IntArray, BoolArray]:
    """Days since 1970 of dates (n,), and where there is no such day."""
    ok = (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & (year >= 1970) & (year <= 2200)
    month0 = np.where(ok, (year - 1970) * 12 + month - 1, 0).astype("datetime64[M]")
    first = month0.astype("datetime64[D]")
    out = first.astype(np.int64) + day - 1
    ok &= out < (month0 + 1).astype("datetime64[D]").astype(np.int64)
    return np.where(ok, out, -1), ~ok


def _gga(k: _Kind) -> _Got:
    tod = k.time(1)
    lat, lon = k.place(2)
    quality = k.number(6, "quality", 0, 9)
    hdop = k.number(8, "dilution of precision", 0, 1000).value
    height, geoid = k.number(9, "height", -12e3, 1e5).value, k.number(11, "geoid's height", -300, 300).value
    q = np.where(np.isfinite(quality.value), quality.whole, 0)
    sd = np.full(len(q), np.nan)
    for level, base in _QUALITY_SD_M.items():
        sd[q == level] = base
    # Without corrections the satellites' geometry decides: some 3 m an axis where the dilution is 1.
    sd = np.where((q == 1) & (hdop > 0) & (hdop < 50), 3.0 * hdop, sd)
    there = np.isfinite(lat) & np.isfinite(lon)
    unreal = (q == 7) | (q == 8)
    columns = {"lat": lat, "lon": lon, "height": height + geoid, "sd": sd, "rank": np.zeros(len(q), np.int64)}
    return _Got(
        {"position": (columns, there & (q > 0) & ~unreal)},
        tod,
        gnss=True,
        counts={"simulated": unreal & there, "no fix": there & (q == 0)},
    )


def _status(k: _Kind, status: int, mode: int) -> tuple[BoolArray, BoolArray]:
    """Where the status says valid, and where the mode says manual or simulated."""
    unreal = np.isin(k.letter(mode), list(b"MS"))
    return ~np.isin(k.letter(status), list(b"V")) & (k.letter(mode) != ord("N")) & ~unreal, unreal


def _rmc(k: _Kind) -> _Got:
    tod = k.time(1)
    valid, unreal = _status(k, 2, 12)
    lat, lon = k.place(3)
    speed = k.number(7, "speed", 0, _MOST_SPEED_MPS).value * ais.KNOT_MPS
    course = k.angle(8, "course")
    date = k.number(9, "date", 0, 311299)
    year = date.whole % 100
    day, bad = _days(np.where(year >= 80, 1900, 2000) + year, date.whole // 100 % 100, date.whole // 10000)
    k.bad.append((bad & np.isfinite(date.value), "date"))
    variation = k.east(10, "variation")
    there = np.isfinite(lat) & np.isfinite(lon)
    one = np.ones(len(lat), np.int64)
    nothing = np.full(len(lat), np.nan)
    return _Got(
        {
            "position": ({"lat": lat, "lon": lon, "height": nothing, "sd": nothing, "rank": one}, there & valid),
            "motion": ({"speed": speed, "course": course, "rank": 0 * one}, valid & np.isfinite(speed)),
            "variation": ({"value": variation}, np.isfinite(variation)),
        },
        tod,
        # A receiver without a fix may send the date and time at which it woke.
        timed=valid | unreal,
        day=np.where(valid & np.isfinite(date.value), day, -1),
        gnss=True,
        counts={"simulated": unreal & there, "no fix": ~valid & ~unreal},
    )


def _gll(k: _Kind) -> _Got:
    lat, lon = k.place(1)
    tod = k.time(5)
    valid, unreal = _status(k, 6, 7)
    there = np.isfinite(lat) & np.isfinite(lon)
    nothing = np.full(len(lat), np.nan)
    columns = {"lat": lat, "lon": lon, "height": nothing, "sd": nothing, "rank": np.full(len(lat), 2)}
    return _Got(
        {"position": (columns, there & valid)}, tod, gnss=True, counts={"simulated": unreal & there, "no fix": ~valid & ~unreal}
    )


def _vtg(k: _Kind) -> _Got:
    named = (k.letter(2) == ord("T")) | (k.letter(2) == 0)
    course = np.where(named, k.angle(1, "course"), np.nan)
    knots, kmh = k.number(5, "speed", 0, _MOST_SPEED_MPS), k.number(7, "speed", 0, 2 * _MOST_SPEED_MPS)
    speed = np.where(np.isfinite(knots.value), knots.value * ais.KNOT_MPS, kmh.value / 3.6)
    valid = k.letter(9) != ord("N")
    columns = {"speed": speed, "course": course, "rank": np.ones(len(speed), np.int64)}
    return _Got({"motion": (columns, named & valid & np.isfinite(speed))})


def _heading(value: FloatArray, rank: int, magnetic: BoolArray | bool, use: BoolArray | bool = True) -> tuple[Columns, BoolArray]:
    n = len(value)
    columns = {"value": value, "magnetic": np.broadcast_to(magnetic, n), "rank": np.full(n, rank)}
    return columns, np.isfinite(value) & use


def _hdt(k: _Kind) -> _Got:
    return _Got({"heading": _heading(k.angle(1, "heading"), 0, False)})


def _ths(k: _Kind) -> _Got:
    value, mode = k.angle(1, "heading"), k.letter(2)
    return _Got(
        {"heading": _heading(value, 0, False, ~np.isin(mode, list(b"VSM")))}, counts={"simulated": np.isin(mode, list(b"SM"))}
    )


def _hdg(k: _Kind) -> _Got:
    value, deviation, variation = k.angle(1, "heading"), k.east(2, "deviation"), k.east(4, "variation")
    value = value + np.where(np.isfinite(deviation), deviation, 0.0)
    magnetic = np.isnan(variation)
    value = value + np.where(magnetic, 0.0, variation)
    return _Got({"heading": _heading(value, 1, magnetic), "variation": ({"value": variation}, ~magnetic)})


def _tilts(roll: FloatArray, pitch: FloatArray, rank: int) -> dict[str, tuple[Columns, BoolArray]]:
    ranks = np.full(len(roll), rank)
    return {
        name: ({"value": value, "rank": ranks}, np.isfinite(value)) for name, value in (("roll", roll), ("pitch", pitch))
    }  # fmt: skip


def _pashr(k: _Kind) -> _Got:
    """Attitude of an inertial system: time, true heading, roll (port side up), pitch (bow up), heave, their sds, two qualities.

    Source: the sentence $PASHR as NovAtel, Trimble and Applanix describe it.
    """
    tod = k.time(1)
    roll, pitch = (np.radians(k.number(at, what, -90.0, 90.0).value) for at, what in ((4, "roll"), (5, "pitch")))
    return _Got({"heading": _heading(k.angle(2, "heading"), 0, False)} | _tilts(roll, pitch, 0), tod, gnss=True)


def _xdr(k: _Kind) -> _Got:
    """Transducers, four fields each: angles (A) in degrees (D) named ROLL and PTCH or PITCH; all others are passed over.

    Source: NMEA 0183 XDR, with the names and signs of Airmar's and other motion sensors: to starboard, and bow up, positive.
    """
    found = {"roll": np.full(len(k.rows), np.nan), "pitch": np.full(len(k.rows), np.nan)}
    for begin in range(1, int(k.s.fields[k.rows].max(initial=0)) - 2, 4):
        degrees_ = (k.letter(begin) == ord("A")) & (k.letter(begin + 2) == ord("D"))
        name = words(k.s, k.rows, begin + 3)
        for what, called in (("roll", ("ROLL",)), ("pitch", ("PTCH", "PITCH"))):
            mine = degrees_ & np.isin(name, [address_of(c) for c in called])
            v = numbers(k.s, k.rows, begin + 1)
            k.bad.append((mine & (v.bad | (np.abs(v.value) > 90.0)), what))
            found[what] = np.where(mine & np.isnan(found[what]), np.radians(v.value), found[what])
    return _Got(_tilts(found["roll"], found["pitch"], 1))


def _hdm(k: _Kind) -> _Got:
    return _Got({"heading": _heading(k.angle(1, "heading"), 3, True)})


def _vhw(k: _Kind) -> _Got:
    return _Got({"heading": _heading(k.angle(1, "heading"), 4, False)})


def _osd(k: _Kind) -> _Got:
    heading, course = k.angle(1, "heading"), k.angle(3, "course")
    valid = k.letter(2) != ord("V")
    unit = _unit(k, 9)
    speed = k.number(5, "speed", 0, 2 * _MOST_SPEED_MPS).value * unit / 3600.0
    # Over the ground only if the source says so: a speed through the water is not own ship's velocity.
    ground = np.isin(k.letter(6), list(b"BPR"))
    columns = {"speed": speed, "course": course, "rank": np.full(len(speed), 2)}
    return _Got({"heading": _heading(heading, 2, False, valid), "motion": (columns, np.isfinite(speed) & ground)})


def _unit(k: _Kind, at: int) -> FloatArray:
    """Metres in the unit that field `at` names."""
    letter = k.letter(at)
    out = np.full(len(letter), np.nan)
    for code, metres in _LENGTH.items():
        out[letter == code] = metres
    k.bad.append((np.isnan(out) & (letter != 0), "unit of distance (K, N or S)"))
    return out


def _rsd(k: _Kind) -> _Got:
    scale = k.number(11, "range scale", 0, 1000).value * _unit(k, 12)
    return _Got({"scale": ({"range": scale}, np.isfinite(scale))})


def _zda(k: _Kind) -> _Got:
    tod = k.time(1)
    day, month, year = k.number(2, "day", 1, 31), k.number(3, "month", 1, 12), k.number(4, "year", 0, 2200)
    # Some write the year with two digits.
    century = np.where(year.whole >= 100, 0, np.where(year.whole >= 80, 1900, 2000))
    given = np.isfinite(day.value) & np.isfinite(month.value) & np.isfinite(year.value)
    days, bad = _days(century + year.whole, month.whole, day.whole)
    k.bad.append((bad & given, "date"))
    return _Got({}, tod, day=np.where(given, days, -1), gnss=True)


def _rot(k: _Kind) -> _Got:
    k.number(1, "rate of turn", -7200.0, 7200.0)
    return _Got({})


def _target(k: _Kind, status: int) -> tuple[IntArray, IntArray]:
    """Track number and flags of a target: lost ones are where the radar thinks they would be, queried ones are still acquired."""
    number = k.number(1, "target number", 0, 99999)
    letter = k.letter(status)
    k.bad.append((~np.isin(letter, [0, *b"LQT"]), "status (L, Q or T)"))
    flags = np.where(letter == ord("L"), int(Flag.EXTRAPOLATED | Flag.TRACK_END), 0)
    flags = np.where(letter == ord("Q"), int(Flag.ACQUIRING), flags)
    return np.where(np.isfinite(number.value), number.whole, -1), flags


def _ttm(k: _Kind) -> _Got:
    track, flags = _target(k, 12)
    unit = _unit(k, 10)
    distance = k.number(2, "distance", 0, 1000).value * unit
    k.bad.append((distance > _MOST_RANGE_M, "distance"))
    bearing, side = k.angle(3, "bearing"), k.letter(4)
    speed = k.number(5, "speed", 0, 2 * _MOST_SPEED_MPS).value * unit / 3600.0
    course, course_side = k.angle(6, "course"), k.letter(7)
    for letter, value, what in ((side, bearing, "bearing"), (course_side, course, "course")):
        k.bad.append((np.isfinite(value) & ~np.isin(letter, list(b"TR")), f"{what}'s reference (T or R)"))
    k.bad.append((np.isnan(unit) & np.isfinite(k.number(2, "distance").value), "unit of distance (K, N or S)"))
    tod = k.time(14)
    columns = {
        "range": distance,
        "bearing": bearing,
        "relative": side == ord("R"),
        "speed": speed,
        "course": course,
        "course_relative": course_side == ord("R"),
        "track": track,
        "flags": flags,
    }
    there = np.isfinite(distance) & np.isfinite(bearing)
    return _Got({"ttm": (columns, there)}, tod, counts={"targets without a position": ~there})


def _tll(k: _Kind) -> _Got:
    track, flags = _target(k, 8)
    lat, lon = k.place(2)
    tod = k.time(7)
    there = np.isfinite(lat) & np.isfinite(lon)
    columns = {"lat": lat, "lon": lon, "track": track, "flags": flags}
    return _Got({"tll": (columns, there)}, tod, counts={"targets without a position": ~there})


_KINDS: dict[str, Callable[[_Kind], _Got]] = {
    "GGA": _gga,
    "RMC": _rmc,
    "GLL": _gll,
    "VTG": _vtg,
    "HDT": _hdt,
    "THS": _ths,
    "HDG": _hdg,
    "HDM": _hdm,
    "VHW": _vhw,
    "OSD": _osd,
    "RSD": _rsd,
    "ZDA": _zda,
    "ROT": _rot,
    "TTM": _ttm,
    "TLL": _tll,
    "XDR": _xdr,
    "PASHR": _pashr,
}
_ATTITUDE = address_of("PASHR")
_RADAR = tuple(address_of(name) for name in ("TTM", "TLL", "OSD", "RSD"))
_AIS = tuple(address_of(name) for name in ("VDM", "VDO"))


def _see(data: ByteArray, state: NmeaState, final: bool) -> tuple[_Seen, NmeaState, int]:
    """The sentences of a stretch; the state counts them and keeps the AIS messages that have begun."""
    s = scan(data, checksums=state.checksums, final=final, offset=state.offset)
    rows_of, own, damaged, counts = _observe(s, state.records, state.offset)
    parts: list[ais.Part] = []
    order = state.ais_sentences
    empty = 0
    whole_text = s.data.tobytes()
    for row in np.flatnonzero(np.isin(s.address & 0xFFFFFF, _AIS) & (s.address < 1 << 40)).tolist():
        order += 1
        text = whole_text[s.start[row] : s.star[row]]
        part = ais.part_of(state.records + row, state.offset + int(s.start[row]), order, text)
        if isinstance(part, str):
            damaged.append(Damage(state.offset + int(s.start[row]), f"an AIS sentence has {part}"))
        elif part.of == 1 and not part.payload:
            empty += 1
        else:
            parts.append(part)
    pending: dict[object, list[ais.Part]] = {}
    for part in state.parts:
        pending.setdefault(part.key, []).append(part)
    whole, lost = ais.join(parts, pending, final)
    messages = ais.decode(whole)
    for what, n in (
        ("comments", s.comments),
        ("strange", s.strange),
        ("zoneless", s.zoneless),
        ("empty", empty + messages.empty),
    ):
        counts[what] = n
    counts["undecoded"] = messages.missing
    told = messages.report
    mine = told["own"] & (told["heading_deg"] < 360) & (told["record"] >= state.records)
    if mine.any():
        n = int(np.count_nonzero(mine))
        own_heading = {"value": np.radians(told["heading_deg"][mine]), "magnetic": np.zeros(n, bool), "rank": np.full(n, 6)}
        rows_of["heading"].append({"record": told["record"][mine], "talker": np.zeros(n, np.int64)} | own_heading)
    tables = {name: _stack(name, parts_of) for name, parts_of in rows_of.items()}
    damaged = s.damaged + damaged + lost + messages.damaged
    seen = _Seen(
        own["offset"], own["address"], own["gnss"], own["tod"], own["day"], own["stamp"], tables, messages, tuple(damaged), counts
    )  # fmt: skip
    after = replace(
        state,
        offset=state.offset + s.consumed,
        records=state.records + len(s.start),
        parts=tuple(p for got in pending.values() for p in got),
        ais_sentences=order,
    )
    return seen, after, s.consumed


def _stack(name: str, parts: list[Columns]) -> Columns:
    """Tables of one kind as one, in the order of records."""
    if not parts:
        return {c: np.empty(0, t) for c, t in _TABLES[name].items()}
    joined = {c: np.concatenate([np.asarray(p[c], t) for p in parts]) for c, t in _TABLES[name].items()}
    order = np.argsort(joined["record"], kind="stable")
    return {c: v[order] for c, v in joined.items()}


def _join(seen: list[_Seen]) -> _Seen:
    if len(seen) == 1:
        return seen[0]

    def glue(parts: list[Columns]) -> Columns:
        return {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}

    counts: dict[str, int] = {}
    for one in seen:
        for what, n in one.counts.items():
            counts[what] = counts.get(what, 0) + n
    messages = ais.Messages(
        kind=glue([s.messages.kind for s in seen]),
        report=glue([s.messages.report for s in seen]),
        static=glue([s.messages.static for s in seen]),
        clock=glue([s.messages.clock for s in seen]),
        damaged=[],
        empty=0,
        missing=0,
    )
    row = {
        name: np.concatenate([getattr(s, name) for s in seen])
        for name in ("offset", "address", "gnss", "tod_s", "day", "stamp_s")
    }
    tables = {name: glue([s.tables[name] for s in seen]) for name in _TABLES}
    return _Seen(**row, tables=tables, messages=messages, damaged=tuple(d for s in seen for d in s.damaged), counts=counts)


# ---------------------------------------------------------------------------------------------------------------------- time


class _Times(NamedTuple):
    """The time (n,) of every sentence; how far apart the times are that it was taken from (0: its own); what to say of it."""

    time_s: FloatArray
    gap_s: FloatArray
    notes: list[str]
    dated: bool
    clock_s: float


def _time(seen: _Seen, state: NmeaState, receive_s: float | None) -> _Times:
    n = len(seen.offset)
    notes: list[str] = []
    stamp = seen.stamp_s
    index = np.arange(n)
    stamped = np.flatnonzero(np.isfinite(stamp))
    timed = np.flatnonzero(np.isfinite(seen.tod_s))
    base_rows, base_time = seen.messages.clock["record"] - state.records, seen.messages.clock["time_s"]
    base_time = base_time[(base_rows >= 0) & (base_rows < n)]
    base_rows = base_rows[(base_rows >= 0) & (base_rows < n)]
    own = np.full(n, np.nan)
    dated = state.dated
    if len(timed):
        tod = seen.tod_s[timed]
        before = state.clock_s % DAY_S if np.isfinite(state.clock_s) else tod[0]
        step = np.diff(tod, prepend=before)
        turns = np.cumsum((step < -DAY_S / 2).astype(np.int64) - (step > DAY_S / 2))
        known = np.flatnonzero(seen.day[timed] >= 0)
        others: tuple[IntArray, FloatArray] | None = None
        if len(stamped):
            others = stamped, stamp[stamped]
        elif receive_s is not None:
            others = np.zeros(1, np.int64), np.array([receive_s])
        elif len(base_rows):
            others = base_rows, base_time
        near = np.interp(timed, *others) if others is not None else None
        if len(known):
            offset = seen.day[timed[known]] - turns[known]
            if len(offset) > 2:
                # A lone date between two others that agree is a damaged one.
                offset[1:-1] = np.where(offset[:-2] == offset[2:], offset[:-2], offset[1:-1])
            after = np.searchsorted(known, np.arange(len(timed)))
            right, left = np.minimum(after, len(known) - 1), np.maximum(after - 1, 0)
            closer = np.abs(known[left] - np.arange(len(timed))) < np.abs(known[right] - np.arange(len(timed)))
            day = offset[np.where(closer, left, right)]
            dated = True
        elif near is not None:
            day = np.round((near - tod) / DAY_S).astype(np.int64) - turns
            dated = True
        elif np.isfinite(state.clock_s):
            day = np.full(len(timed), int(state.clock_s // DAY_S))
        else:
            day = np.full(len(timed), state.day or 0)
            dated = state.day is not None
        time = (day + turns) * DAY_S + tod
        hint = near if near is not None else (np.full(len(timed), state.day * DAY_S) if state.day is not None else None)
        if hint is not None and len(known):
            weeks = np.round(np.median(hint - time) / _WEEKS_S)
            if weeks and abs(np.median(hint - time) - weeks * _WEEKS_S) < 2 * DAY_S:
                notes.append(
                    f"the receiver's dates are {int(weeks) * 1024:+,} weeks wrong (its count of GPS weeks ran over): "
                    "they were put right"
                )
                time = time + weeks * _WEEKS_S
            elif state.day is not None and abs(time[0] // DAY_S - state.day) >= 1 and near is None:
                notes.append("the file's own dates were used: they are not the date that was given")
        own[timed] = time
        both = timed[np.isfinite(stamp[timed]) & seen.gnss[timed]]
        late = stamp[both] - own[both]
        wrong = float(np.median(late)) if len(late) >= 5 else 0.0
        if abs(wrong) > _WRONG_CLOCK_S:
            notes.append(f"the lines' stamps are {wrong:+.2f} s off the sentences' own UTC: that was taken off the stamps")
            stamp = stamp - wrong
        elif len(late) >= 5:
            notes.append(f"the lines' stamps are {wrong:+.2f} s (median) after the sentences' own UTC")
    time_s = np.where(np.isfinite(own), own, stamp)
    gap_s = np.where(np.isfinite(time_s), 0.0, np.inf)
    # Radars tell when they saw a target, not when they sent it, and a few stamped lines may come from elsewhere: these times
    # serve other sentences only where there is nothing better.
    better = seen.gnss.copy()
    if not better.any() or 2 * len(stamped) > n:
        better |= np.isfinite(stamp)
    anchors = np.flatnonzero(better if better.any() else np.isfinite(time_s))
    values = np.where(seen.gnss, own, stamp)[anchors] if better.any() else time_s[anchors]
    if not len(anchors) and len(base_rows):
        order = np.argsort(base_rows, kind="stable")
        anchors, values = base_rows[order], base_time[order]
        notes.append(f"no sentence tells a time: it was taken from the {len(anchors):,} reports of AIS base stations")
        dated = True
    missing = np.isnan(time_s)
    if missing.any() and len(anchors):
        around, gap = _between(index[missing], anchors, values)
        time_s[missing], gap_s[missing] = around, gap
    elif missing.any() and np.isfinite(state.clock_s) and receive_s is None:
        time_s[missing], gap_s[missing] = state.clock_s, _WRONG_CLOCK_S
    elif missing.any() and receive_s is not None:
        time_s[missing], gap_s[missing], dated = receive_s, 0.0, True
    if len(anchors):
        dated = dated or not len(timed)
    if len(anchors) and not dated and n:
        notes.append("no sentence tells a date: times count from day 0 (1970-01-01)")
    last = values[-1] if len(values) else state.clock_s
    return _Times(time_s, gap_s, notes, dated, float(last))


def _between(rows: IntArray, anchors: IntArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times at `rows` between the anchors around them, and how far those are apart; beyond the ends, at the anchors' rate."""
    after = np.searchsorted(anchors, rows)
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(anchors) - 1)
    gap = values[right] - values[left]
    share = (rows - anchors[left]) / np.maximum(anchors[right] - anchors[left], 1)
    smooth = (gap >= 0) & (gap <= _AROUND_S)
    time = values[left] + np.where(smooth, share * gap, 0.0)
    gap = np.where(gap < 0, _WRONG_CLOCK_S, gap)
    span = anchors[-1] - anchors[0]
    rate = max(0.0, (values[-1] - values[0]) / span) if span else 0.0
    for outside, end in ((after == 0, 0), (after == len(anchors), -1)):
        beyond = (rows - anchors[end]) * rate
        near = np.abs(beyond) <= _AROUND_S
        time = np.where(outside, values[end] + np.where(near, beyond, 0.0), time)
        gap = np.where(outside, np.where(near, np.maximum(np.abs(beyond), 1.0), np.abs(beyond)), gap)
    return time, gap


# ------------------------------------------------------------------------------------------------------------------ own ship


def _preferred(time_s: FloatArray, rank: IntArray, talker: IntArray) -> BoolArray:
    """Of several sources of one thing, the rows to use: those of the best source, and of the next where that one is silent.

    Sources are ordered by rank, then by how many rows they have.
    """
    sources, which, count = np.unique(rank * (1 << 20) + talker, return_inverse=True, return_counts=True)
    use = np.zeros(len(time_s), bool)
    covered = np.empty(0)
    for source in sorted(range(len(sources)), key=lambda k: (sources[k] >> 20, -count[k])):
        mine = np.flatnonzero((which == source) & np.isfinite(time_s))
        if len(covered) and len(mine):
            at = np.searchsorted(covered, time_s[mine])
            distance = np.minimum(
                np.abs(time_s[mine] - covered[np.maximum(at - 1, 0)]),
                np.abs(covered[np.minimum(at, len(covered) - 1)] - time_s[mine]),
            )
            mine = mine[distance > _SILENT_S]
        use[mine] = True
        covered = np.sort(np.concatenate([covered, time_s[mine]]))
    return use


def _interpolate(at_s: FloatArray, time_s: FloatArray, value: FloatArray, gap_s: float, circular: bool) -> FloatArray:
    """`value` (m,) at the times `at_s` (n,): linear (on the circle) over gaps up to `gap_s`, NaN beyond."""
    good = np.isfinite(time_s) & np.isfinite(value)
    order = np.argsort(time_s[good], kind="stable")
    t, v = time_s[good][order], value[good][order]
    if not len(t):
        return np.full(len(at_s), np.nan)
    if circular:
        v = np.unwrap(v)
    out = np.interp(at_s, t, v)
    after = np.searchsorted(t, at_s)
    left, right = t[np.maximum(after - 1, 0)], t[np.minimum(after, len(t) - 1)]
    inside = (right >= at_s) & (left <= at_s) & (right - left <= gap_s)
    near_left, near_right = np.abs(at_s - left) <= _ALONE_S, np.abs(right - at_s) <= _ALONE_S
    nearest = np.where(np.abs(at_s - left) <= np.abs(right - at_s), np.maximum(after - 1, 0), np.minimum(after, len(t) - 1))
    out = np.where(inside, out, np.where(near_left | near_right, v[nearest], np.nan))
    return np.asarray(out % (2 * np.pi) if circular else out)


class _Headings(NamedTuple):
    time_s: FloatArray
    value: FloatArray
    record: IntArray
    magnetic: bool


def _headings(seen: _Seen, times: _Times, state: NmeaState, notes: list[str]) -> _Headings:
    """Own ship's headings, true where any is (or a variation is known), else magnetic."""
    h, v = seen.tables["heading"], seen.tables["variation"]
    time = times.time_s[h["record"] - state.records]
    value, magnetic = h["value"].copy(), h["magnetic"].copy()
    if magnetic.any():
        at = np.searchsorted(v["record"], h["record"], side="right") - 1
        if len(v["record"]):
            variation = v["value"][np.maximum(at, 0)]
            variation = np.where((at < 0) & np.isfinite(state.variation_rad), state.variation_rad, variation)
        else:
            variation = np.full(len(value), state.variation_rad)
        fix = magnetic & np.isfinite(variation)
        value[fix] += variation[fix]
        magnetic &= ~fix
    if magnetic.any() and not magnetic.all():
        notes.append(f"{np.count_nonzero(magnetic):,} magnetic headings have no variation: they were not used")
        keep = ~magnetic
        time, value = time[keep], value[keep]
        h = {c: x[keep] for c, x in h.items()}
    elif magnetic.any():
        notes.append(
            "headings are magnetic and nothing tells the variation: own ship's heading, and what comes from relative bearings, "
            'is from magnetic north (set north = "magnetic" and north_offset_deg in sensors.toml)'
        )
    use = _preferred(time, h["rank"], h["talker"])
    only_magnetic = bool(magnetic.any() and magnetic.all())
    time, value, record = time[use], value[use] % (2 * np.pi), h["record"][use]
    if state.heading is not None and state.heading[2] == only_magnetic:
        time, value = np.append(state.heading[0], time), np.append(state.heading[1], value)
        record = np.append(state.records - 1, record)
    elif state.heading is not None and not len(time):
        time, value = np.array([state.heading[0]]), np.array([state.heading[1]])
        record, only_magnetic = np.array([state.records - 1]), state.heading[2]
    return _Headings(time, value, record, only_magnetic)


def _own_position(seen: _Seen, times: _Times, state: NmeaState, notes: list[str]) -> Columns:
    """Own ship's positions with their times, from the best source."""
    p = seen.tables["position"]
    time = times.time_s[p["record"] - state.records]
    use = _preferred(time, p["rank"], p["talker"])
    talkers = np.unique(p["talker"])
    if len(talkers) > 1:
        names = ", ".join(name_of(int(t)) for t in talkers)
        first = name_of(int(p["talker"][use][0])) if use.any() else "none"
        notes.append(f"own ship's position comes from several receivers ({names}): the first in use is {first}")
    return {c: x[use] for c, x in p.items()} | {"time": time[use]}


def _platform(position: Columns, h: _Headings, seen: _Seen, times: _Times, state: NmeaState, sensor: int) -> Platform:
    """Own ship at every time at which its position, heading, roll or pitch is told.

    Positions and headings are interpolated to the times of the others.  Roll and pitch are not: in a swing the way between two
    reports is no straight line.
    """
    m = seen.tables["motion"]
    motion_time = times.time_s[m["record"] - state.records]
    use = _preferred(motion_time, m["rank"], m["talker"])
    m, motion_time = {c: x[use] for c, x in m.items()}, motion_time[use]
    mine = h.record >= state.records
    tilts = {}
    for what in ("roll", "pitch"):
        told = seen.tables[what]
        time = times.time_s[told["record"] - state.records]
        chosen = _preferred(time, told["rank"], told["talker"]) & np.isfinite(time)
        tilts[what] = time[chosen], told["value"][chosen], told["record"][chosen]
    at = np.concatenate([position["time"], h.time_s[mine], *(time for time, _, _ in tilts.values())])
    record = np.concatenate([position["record"], h.record[mine], *(rows for _, _, rows in tilts.values())])
    good = np.isfinite(at)
    at, first = np.unique(at[good], return_index=True)
    record = record[good][first]
    tilt = {}
    for what, (time, value, _) in tilts.items():
        tilt[what] = np.full(len(at), np.nan)
        tilt[what][np.searchsorted(at, time)] = value
    lat = _interpolate(at, position["time"], position["lat"], _POSITION_GAP_S, False)
    lon = _interpolate(at, position["time"], position["lon"], _POSITION_GAP_S, True)
    return Platform(
        time_s=at,
        sensor=np.full(len(at), sensor),
        latitude_rad=lat,
        longitude_rad=(lon + np.pi) % (2 * np.pi) - np.pi,
        height_m=_interpolate(at, position["time"], position["height"], _POSITION_GAP_S, False),
        heading_rad=_interpolate(at, h.time_s, h.value, _HEADING_GAP_S, True),
        roll_rad=tilt["roll"],
        pitch_rad=tilt["pitch"],
        speed_mps=_interpolate(at, motion_time, m["speed"], _HEADING_GAP_S, False),
        course_rad=_interpolate(at, motion_time, m["course"], _HEADING_GAP_S, True),
        record=record,
    )


# ----------------------------------------------------------------------------------------------------------------- resolving


def _resolve(seen: _Seen, state: NmeaState, after: NmeaState, receive_s: float | None) -> tuple[NmeaRecords, NmeaState]:
    """Times, own ship and tables of what was seen; `state` was before it, `after` counts it."""
    times = _time(seen, state, receive_s)
    notes = list(times.notes)
    headings = _headings(seen, times, state, notes)
    ttm, tll = seen.tables["ttm"], seen.tables["tll"]
    radars = list(state.radars)
    for talker, _ in sorted(
        [(int(t), int(r)) for x in (ttm, tll) for t, r in zip(*_first(x["talker"], x["record"]), strict=True)], key=lambda x: x[1]
    ):
        if talker not in radars:
            radars.append(talker)
    if len(radars) > 1:
        ids = ", ".join(f"{name_of(t)} = {state.sensor + k}" for k, t in enumerate(radars))
        notes.append(f"several talkers send targets: each is a sensor of its own ({ids})")
    plots = _plots(ttm, times, headings, state, radars, notes)
    row = tll["record"] - state.records
    tracks = Tracks(
        time_s=times.time_s[row],
        source=_ids(tll["talker"], radars, state.sensor),
        track=tll["track"],
        latitude_rad=tll["lat"],
        longitude_rad=tll["lon"],
        flags=tll["flags"],
        record=tll["record"],
    )
    static = _static(seen, state)
    report = seen.messages.report["record"] - state.records
    # A message whose first part came in an earlier stretch has the time of this one's first sentence.
    early = report < 0
    report = np.maximum(report, 0)
    coarse = times.time_s[report] if len(times.time_s) else np.full(len(report), np.nan)
    gap = np.where(early, _WRONG_CLOCK_S, times.gap_s[report]) if len(times.time_s) else np.full(len(report), np.inf)
    fixes, moved = ais.fixes_of(seen.messages, static, coarse, gap, state.sensor)
    position = _own_position(seen, times, state, notes)
    if len(position["time"]) == 0:
        position = _own_from_ais(seen, fixes)
    platform = _platform(position, headings, seen, times, state, state.sensor)
    if len(radars) > 1:
        platform = Platform.concat(
            [platform.replace(sensor=np.full(len(platform), state.sensor + k)) for k in range(len(radars))]
        )
    if len(position["time"]) and not state.radars and not np.isin(seen.address & 0xFFFFFF, _RADAR).any():
        fixes = Fixes.concat([fixes, _own_fixes(position, platform, state.sensor)])
        fixes = fixes[np.argsort(fixes.record, kind="stable")]
    notes += _remarks(seen, times, moved, plots, state.records)
    damaged = tuple(sorted(seen.damaged, key=lambda d: d.offset))
    own = seen.offset, seen.address, times.time_s, seen.messages.kind
    records = NmeaRecords(plots, fixes, tracks, platform, *own, damaged, tuple(notes), times.dated)
    heading, variation = state.heading, state.variation_rad
    if len(headings.time_s):
        last = int(np.argmax(headings.time_s))
        heading = float(headings.time_s[last]), float(headings.value[last]), headings.magnetic
    if len(seen.tables["variation"]["value"]):
        variation = float(seen.tables["variation"]["value"][-1])
    names = ("record", "mmsi", "bow", "stern", "port", "starboard", "callsign")
    newest = {int(m): k for k, m in enumerate(static["mmsi"])}
    kept = tuple((-1, *(int(static[n][k]) for n in names[1:])) for k in newest.values())
    after = replace(after, clock_s=times.clock_s, dated=times.dated, heading=heading, variation_rad=variation)
    return records, replace(after, radars=tuple(radars), static=kept)


def _first(key: AnyArray, record: IntArray) -> tuple[AnyArray, IntArray]:
    values, at = np.unique(key, return_index=True)
    return values, record[at]


def _ids(talker: IntArray, radars: list[int], sensor: int) -> IntArray:
    out = np.full(len(talker), sensor, np.int64)
    for k, code in enumerate(radars):
        out[talker == code] = sensor + k
    return out


def _static(seen: _Seen, state: NmeaState) -> Columns:
    """The ships' static data of before and of now."""
    now = seen.messages.static
    if not state.static:
        return now
    before = np.array(state.static, np.int64).T
    return {name: np.concatenate([old, now[name]]) for name, old in zip(now, before, strict=True)}


def _plots(ttm: Columns, times: _Times, h: _Headings, state: NmeaState, radars: list[int], notes: list[str]) -> Plots:
    """Targets as plots; relative bearings are turned by own ship's heading at their time, and flagged as such."""
    row = ttm["record"] - state.records
    time = times.time_s[row]
    heading = _interpolate(time, h.time_s, h.value, _HEADING_GAP_S, True)
    azimuth = np.where(ttm["relative"], ttm["bearing"] + heading, ttm["bearing"]) % (2 * np.pi)
    course = np.where(ttm["course_relative"], ttm["course"] + heading, ttm["course"]) % (2 * np.pi)
    unknown = ttm["relative"] & np.isnan(heading)
    if unknown.any():
        notes.append(
            f"{np.count_nonzero(unknown):,} targets have a relative bearing and own ship's heading is not known then: they were "
            "left out (is a sentence HDT, THS or HDG in the log?)"
        )
    flags = ttm["flags"] | np.where(ttm["relative"] & h.magnetic, int(Flag.MAGNETIC_NORTH), 0)
    flags |= np.where(ttm["relative"], int(Flag.FROM_BOW), 0)
    plots = Plots(
        time_s=time,
        sensor=_ids(ttm["talker"], radars, state.sensor),
        channel=np.full(len(time), int(Channel.PSR)),
        range_m=ttm["range"],
        azimuth_rad=azimuth,
        track=ttm["track"],
        heading_rad=course,
        speed_mps=ttm["speed"],
        flags=flags,
        record=ttm["record"],
    )
    return plots[~unknown]


def _own_from_ais(seen: _Seen, fixes: Fixes) -> Columns:
    """Own ship's positions from its own AIS reports (AIVDO)."""
    own = np.isin(fixes.record, seen.messages.report["record"][seen.messages.report["own"]])
    mine = fixes[own]
    n = len(mine)
    return {
        "record": mine.record,
        "lat": mine.latitude_rad,
        "lon": mine.longitude_rad,
        "height": np.full(n, np.nan),
        "sd": mine.horizontal_sd_m,
        "rank": np.full(n, -1),
        "time": mine.time_s,
    }


def _own_fixes(position: Columns, platform: Platform, sensor: int) -> Fixes:
    """Own ship as a target (track 0): a log without a radar may be the reference that another one's radar saw."""
    keep = position["rank"] >= 0
    p = {c: x[keep] for c, x in position.items()}
    if not len(p["time"]):
        return Fixes()
    at = np.minimum(np.searchsorted(platform.time_s, p["time"]), len(platform) - 1)
    speed, course = platform.speed_mps[at], platform.course_rad[at]
    return Fixes(
        time_s=p["time"],
        source=np.full(len(at), sensor),
        latitude_rad=p["lat"],
        longitude_rad=p["lon"],
        height_m=p["height"],
        velocity_east_mps=speed * np.sin(course),
        velocity_north_mps=speed * np.cos(course),
        heading_rad=platform.heading_rad[at],
        track=np.zeros(len(at), np.int64),
        horizontal_sd_m=np.where(np.isfinite(p["sd"]), p["sd"], _QUALITY_SD_M[1]),
        record=p["record"],
    )


def _remarks(seen: _Seen, times: _Times, moved: ais.Moved, plots: Plots, first: int) -> list[str]:
    """What a reader should know of what was read."""
    out: list[str] = []
    for what, text in (
        ("simulated", "own ship sentences say manual or simulated: their positions and headings were not used"),
        ("no fix", "own ship sentences say that the receiver has no fix: they were not used"),
        ("targets without a position", "target sentences have no distance and bearing, or no position: they were passed over"),
        ("strange", "lines carry something before the sentence that is no time stamp: it was passed over"),
        ("zoneless", "lines are stamped without a time zone: the stamps were taken as UTC"),
        ("empty", "AIS sentences have no content"),
        ("undecoded", "AIS messages were not decoded: install pyais"),
    ):
        if seen.counts.get(what):
            out.append(f"{seen.counts[what]:,} {text}")
    if moved.nowhere:
        out.append(f"{moved.nowhere:,} AIS reports say that their position is not available")
    if moved.centred:
        out.append(f"{moved.centred:,} AIS positions were moved from the antenna to the middle of the hull")
    if moved.headless:
        out.append(f"{moved.headless:,} AIS positions stay at the antenna: the ship's heading is not known (their sd was raised)")
    untimed = int(np.count_nonzero(np.isnan(times.time_s)))
    if untimed:
        out.append(f"{untimed:,} sentences have no time, and nothing around them tells one")
    borrowed = int(np.count_nonzero(times.gap_s[plots.record - first] > 0))
    if borrowed:
        out.append(f"{borrowed:,} plots tell no time: it was taken from the sentences around them")
    scale = np.unique(seen.tables["scale"]["range"])
    if len(scale):
        names = f"{scale[0]:,.0f} m" if len(scale) == 1 else f"{scale[0]:,.0f} to {scale[-1]:,.0f} m"
        out.append(f"the radar's range scale is {names} (RSD)")
    return out


def decode_nmea(
    data: bytes, state: NmeaState | None = None, receive_s: float | None = None
) -> tuple[NmeaRecords, NmeaState, int]:
    """Read the whole lines of `data`: tables, the state for the next call, and how many bytes were consumed.

    Give what was not consumed again, with what came after it.  `receive_s` (UTC) is when the bytes came: it gives the date, and
    the time where nothing else does.  Relative bearings have the last heading known.  Raises nothing: damage is in the records.
    """
    state = state or NmeaState()
    seen, after, consumed = _see(np.frombuffer(data, np.uint8), state, final=False)
    records, after = _resolve(seen, state, after, receive_s)
    return records, after, consumed


def read_nmea(path: str | Path, *, date: datetime.date | None = None, sensor: int | None = None) -> Recording:
    """Read an NMEA 0183 log: targets of a radar (TTM) as plots, TLL as tracks, AIS as fixes, own ship as the platform.

    `date` is the UTC date of the first sentence, for a log that tells none; `sensor` the id of the radar in sensors.toml
    (65536).  A log without a radar gives own ship's positions as fixes too (track 0).  Raises InputError for a file that cannot
    be read, or holds no sentence.
    """
    state = NmeaState(
        sensor=DEFAULT_SENSOR if sensor is None else sensor,
        day=None if date is None else (date - datetime.date(1970, 1, 1)).days,
    )
    state, stretches = _stretches(path, state)
    begin = replace(state, offset=0, records=0, parts=(), ais_sentences=0)
    seen = _join(stretches)
    if not len(seen.offset):
        first = seen.damaged[0] if seen.damaged else Damage(0, "there are only blank lines")
        raise InputError(
            f"no NMEA sentence could be read: {first.why}", path=path, offset=first.offset,
            remedy="A log holds lines such as $RATTM,…*17 or !AIVDM,…*5C, each with its checksum.",
        )  # fmt: skip
    records, _ = _resolve(seen, begin, begin, None)
    notes = list(records.notes)
    if not records.dated and any("day 0" in n for n in notes):
        notes = [n + "; give --date" if "day 0" in n else n for n in notes]
    if not state.checksums:
        notes.insert(0, "no sentence of this file has a checksum: they were accepted as they are, so damage cannot be told")
    return Recording(
        path=str(path),
        plots=records.plots,
        fixes=records.fixes,
        tracks=records.tracks,
        platform=records.platform,
        sources=_sources(records),
        damaged=records.damaged,
        warnings=tuple(notes),
        by_category={},
        offset=records.offset,
    )


def read_ais(path: str | Path, *, date: datetime.date | None = None, sensor: int | None = None) -> Recording:
    """Read a log of AIS sentences (AIVDM, AIVDO): position reports as fixes, about the middle of the hull.

    It is `read_nmea`, but a file without any AIS message, or a machine without pyais, raises InputError.
    """
    if not ais.available():
        raise InputError("AIS needs pyais", path=path, remedy="pip install pyais")
    recording = read_nmea(path, date=date, sensor=sensor)
    if not any(s.edition.startswith("AIS ") for s in recording.sources):
        raise InputError("no AIS message could be read", path=path, remedy="Give a log of !AIVDM or !AIVDO sentences.")
    return recording


def _stretches(path: str | Path, state: NmeaState) -> tuple[NmeaState, list[_Seen]]:
    """What all sentences of a file said, read a stretch at a time."""
    try:
        with open(path, "rb") as file:
            if not _has_checksums(file.read):
                state = replace(state, checksums=False)
            file.seek(0)
            out: list[_Seen] = []
            rest = b""
            while True:
                data = file.read(_CHUNK)
                final = len(data) < _CHUNK
                seen, state, consumed = _see(np.frombuffer(rest + data, np.uint8), state, final)
                rest = (rest + data)[consumed:]
                out.append(seen)
                if final:
                    break
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})", path=path, remedy="Check the file's name and that you may read it."
        ) from error
    if not state.offset:
        raise InputError("the file is empty", path=path, remedy="Give a log of NMEA 0183 sentences.")
    return state, out


def _has_checksums(read: Callable[[int], bytes]) -> bool:
    """Whether any line of the file ends in a checksum."""
    while data := read(_CHUNK):
        if re.search(rb"\*[0-9A-Fa-f]{2}", data):
            return True
    return False


def _sources(r: NmeaRecords) -> tuple[Source, ...]:
    """One source a kind of sentence and talker, then one a type of AIS message, each in the order of their names."""
    plot_of, fix_of = r.address[r.plots.record], r.address[np.maximum(r.fixes.record, 0)]
    out: list[Source] = []
    for address in sorted(np.unique(r.address).tolist(), key=name_of):
        times = r.time_s[r.address == address]
        track = np.concatenate([r.plots.track[plot_of == address], r.tracks.track[r.address[r.tracks.record] == address]])
        mmsi = r.fixes.mmsi[fix_of == address]
        targets = len(np.unique(track[track >= 0])) + len(np.unique(mmsi[mmsi >= 0]))
        out.append(_source(f"NMEA {name_of(address)}", len(times), int(np.count_nonzero(plot_of == address)), times, targets))
    for kind in np.unique(r.messages["type"]).tolist():
        mine = r.messages["type"] == kind
        times = r.time_s[r.messages["record"][mine]]
        out.append(_source(f"AIS {kind}", int(np.count_nonzero(mine)), 0, times, len(np.unique(r.messages["mmsi"][mine]))))
    return tuple(out)


def _source(edition: str, records: int, plots: int, times: FloatArray, targets: int) -> Source:
    times = times[np.isfinite(times)]
    start, end = (float(times.min()), float(times.max())) if len(times) else (float("nan"), float("nan"))
    return Source(
        sac=0, sic=0, category=0, edition=edition, records=records, plots=plots, start_s=start, end_s=end, targets=targets
    )  # fmt: skip
