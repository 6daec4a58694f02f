"""AIS: the messages in AIVDM and AIVDO sentences, and positions moved to the middle of the hull.

pyais decodes the messages' bits; here the sentences of a message are brought together, what a message must hold to be believed is
checked, values that say "not available" become NaN, and a position of the GNSS antenna is moved to the hull's centre by the
antenna's place that the ship's static data give (METHODS section 6: a radar sees the hull, not the antenna).
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..geodesy import E2, SEMI_MAJOR_M
from ..model import Damage, Fixes, pack_callsigns

KNOT_MPS = 1852.0 / 3600.0
# Sentences of one message come together; a rest that is this many AIS sentences old is not completed any more.
_PATIENCE = 200
_PAYLOAD = re.compile(rb"[0-W`-w]*")
# The bits that must be there for what is read from a message to be whole.
_LEAST = {1: 143, 2: 143, 3: 143, 4: 78, 5: 270, 11: 78, 18: 139, 19: 301, 27: 94}
# Per axis: the accuracy flag says better or worse than 10 m.  Type 27 rounds to tenths of a minute (185 m), which adds to it.
ACCURATE_SD_M, INACCURATE_SD_M, COARSE_SD_M = 10.0, 30.0, 53.0
# What is not known of the time of a report: it tells its second, or nothing at all.
SECOND_SD_S, UNSTAMPED_SD_S = 0.3, 1.0
# Above this speed the course stands for a heading that is not given.
_STEERED_MPS = 3.0
# The coarse time tells the minute of a report's second only if it is this good.
_MINUTE_S = 25.0
# A second is looked for from this long before its sentence's time to the rest of the minute after it; beyond the second figure
# the transmitter's clock may be wrong, and the time's sd is half of what it is off.
_EARLIER_S, _PROMPT_S = 45.0, 10.0


class Part(NamedTuple):
    """One sentence: its record, which part of how many it is, what joins the parts, and its bytes."""

    record: int
    offset: int
    number: int
    of: int
    key: tuple[bytes, bytes, bytes, int]
    payload: bytes
    fill: int
    order: int


@dataclass(frozen=True, slots=True)
class Messages:
    """Decoded messages as columns.

    `kind` holds record and type of every message; `report` the positions, `static` the ships' dimensions, `clock` the UTC that
    base stations send.  `empty` counts sentences without any content.
    """

    kind: dict[str, AnyArray]
    report: dict[str, AnyArray]
    static: dict[str, AnyArray]
    clock: dict[str, AnyArray]
    damaged: list[Damage]
    empty: int
    missing: int


_KIND = {"record": np.int64, "type": np.int64, "mmsi": np.int64, "own": np.bool_}
_REPORT = {
    "record": np.int64,
    "type": np.int64,
    "mmsi": np.int64,
    "own": np.bool_,
    "accurate": np.bool_,
    "lat_deg": np.float64,
    "lon_deg": np.float64,
    "speed_kn": np.float64,
    "course_deg": np.float64,
    "heading_deg": np.float64,
    "second": np.int64,
}
_STATIC = {
    "record": np.int64,
    "mmsi": np.int64,
    "bow": np.int64,
    "stern": np.int64,
    "port": np.int64,
    "starboard": np.int64,
    "callsign": np.int64,
}
_CLOCK = {"record": np.int64, "time_s": np.float64}


def _columns(rows: Sequence[tuple[Any, ...]], types: dict[str, Any]) -> dict[str, AnyArray]:
    if not rows:
        return {name: np.empty(0, dtype) for name, dtype in types.items()}
    return {name: np.array(values, dtype) for (name, dtype), values in zip(types.items(), zip(*rows, strict=True), strict=True)}


def available() -> bool:
    """Whether pyais is installed."""
    import importlib.util

    return importlib.util.find_spec("pyais") is not None


def part_of(record: int, offset: int, order: int, text: bytes) -> Part | str:
    """A sentence (`text` from its "!" up to its "*") as a part of a message, or why it is none."""
    fields = text.split(b",")
    if len(fields) < 7:
        return f"{len(fields) - 1} fields where 6 belong"
    # Some receivers add a field of their own behind these.
    address, of, number, sequence, channel, payload, fill = fields[:7]
    if b" " in text:
        of, number, payload, fill = of.strip(), number.strip(), payload.strip(), fill.strip()
    if not (of.isdigit() and number.isdigit() and len(of) == 1 and len(number) == 1 and 1 <= int(number) <= int(of)):
        return f"part {_text(number)} of {_text(of)} makes no sense"
    if fill not in (b"0", b"1", b"2", b"3", b"4", b"5", b""):
        return f"{_text(fill)} fill bits where 0 to 5 are possible"
    if not _PAYLOAD.fullmatch(payload):
        return "a character that AIS does not use"
    key = (address, sequence, channel, int(of))
    return Part(record, offset, int(number), int(of), key, payload, int(fill or b"0"), order)


def _text(field: bytes) -> str:
    return repr(field.decode("latin-1"))


def join(parts: Sequence[Part], pending: dict[Any, list[Part]], final: bool) -> tuple[list[list[Part]], list[Damage]]:
    """Bring the parts of messages together: whole messages in the order of their last part, and what never became whole.

    `pending` holds begun messages and is changed; with `final` what is left in it is given up.
    """
    whole: list[list[Part]] = []
    damaged: list[Damage] = []

    def give_up(key: Any) -> None:
        got = pending.pop(key)
        missing = sorted(set(range(1, got[0].of + 1)) - {p.number for p in got})
        which = "part " + ", ".join(map(str, missing))
        damaged.append(Damage(got[0].offset, f"{which} of {got[0].of} of this AIS message never came"))

    for part in parts:
        if part.of == 1:
            whole.append([part])
            continue
        got = pending.get(part.key)
        if got is not None and (part.order - got[-1].order > _PATIENCE or part.number in {p.number for p in got}):
            give_up(part.key)
            got = None
        if got is None:
            pending[part.key] = [part]
            continue
        got.append(part)
        if len(got) == part.of:
            del pending[part.key]
            whole.append(sorted(got, key=lambda p: p.number))
    last = parts[-1].order if parts else 0
    for key in [k for k, got in pending.items() if final or last - got[-1].order > _PATIENCE]:
        give_up(key)
    return whole, damaged


def decode(messages: Sequence[Sequence[Part]]) -> Messages:
    """Decode whole messages by pyais.  A message counts as read at its first part (its stamp is the earliest).

    What cannot be decoded, is too short for what it claims to be, or lies beyond the poles is damage.  Without pyais nothing is
    decoded and `missing` says how many there were.
    """
    kind: list[tuple[Any, ...]] = []
    report: list[tuple[Any, ...]] = []
    static: list[tuple[Any, ...]] = []
    clock: list[tuple[Any, ...]] = []
    damaged: list[Damage] = []
    empty = 0
    if messages and not available():
        return Messages(
            _columns([], _KIND), _columns([], _REPORT), _columns([], _STATIC), _columns([], _CLOCK), [], 0, len(messages)
        )
    for parts in messages:
        head = parts[0]
        bits = 6 * sum(len(p.payload) for p in parts) - parts[-1].fill
        if not any(p.payload for p in parts):
            empty += 1
            continue
        first = parts[0].payload[:1] or b"0"
        number = first[0] - 48 - (8 if first[0] > 88 else 0)
        if not 1 <= number <= 27 or bits < 38:
            why = f"has {bits} bits" if 1 <= number <= 27 else f"is of the type {number}, which does not exist"
            damaged.append(Damage(head.offset, f"an AIS message {why}"))
            continue
        if bits < _LEAST.get(number, 38):
            damaged.append(Damage(head.offset, f"an AIS message of type {number} has only {bits} bits"))
            continue
        try:
            m = _decoded(parts)
            mmsi = int(m.mmsi)
            own = head.key[0].endswith(b"VDO")
            if number in (1, 2, 3, 18, 19, 27):
                lat, lon = float(m.lat), float(m.lon)
                if (abs(lat) > 90 and round(lat, 4) != 91) or (abs(lon) > 180 and round(lon, 4) != 181):
                    where = f"latitude {lat:.4f}°, longitude {lon:.4f}°"
                    damaged.append(Damage(head.offset, f"an AIS message of type {number} gives {where}: no place on Earth"))
                    continue
                heading, second = (511, 60) if number == 27 else (int(m.heading), int(m.second))
                speed, course = float(m.speed), float(m.course)
                if number == 27:
                    speed = 102.3 if speed >= 63 else speed
                row = (head.record, number, mmsi, own, bool(m.accuracy), lat, lon, speed, course, heading, second)
                report.append(row)
            if number in (5, 19) or (number == 24 and int(m.partno) == 1 and bits >= 162 and mmsi // 10_000_000 != 98):
                sign = -1 if number == 19 else int(pack_callsigns([(m.callsign or "").strip(" @")])[0])
                size = (int(m.to_bow), int(m.to_stern), int(m.to_port), int(m.to_starboard))
                static.append((head.record, mmsi, *size, sign))
            if number in (4, 11):
                time = _utc(m)
                if time is not None:
                    clock.append((head.record, time))
        except Exception as error:  # whatever a library makes of bits from the air must not stop the reading
            damaged.append(
                Damage(head.offset, f"an AIS message of type {number} cannot be decoded ({error or type(error).__name__})")
            )
            continue
        kind.append((head.record, number, mmsi, own))
    columns = (_columns(kind, _KIND), _columns(report, _REPORT), _columns(static, _STATIC), _columns(clock, _CLOCK))
    return Messages(*columns, damaged, empty, 0)


def _decoded(parts: Sequence[Part]) -> Any:
    import pyais

    # Built anew, so that what a receiver added to its sentences cannot matter; the checksums were verified before.
    return pyais.decode(*(b"!AIVDM,%d,%d,1,A,%b,%d*00" % (p.of, p.number, p.payload, p.fill) for p in parts))


def _utc(m: Any) -> float | None:
    """The UTC that a base station sends, or None where it sends none or an impossible one."""
    try:
        time = datetime.datetime(
            int(m.year), int(m.month), int(m.day), int(m.hour), int(m.minute), int(m.second), tzinfo=datetime.UTC
        )
    except ValueError:
        return None
    return time.timestamp() if 1990 <= time.year < 2100 else None


def hull_centre(
    latitude_rad: FloatArray, longitude_rad: FloatArray, heading_rad: FloatArray, forward_m: FloatArray, starboard_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude (n,), radians, of points that lie `forward_m` ahead of and `starboard_m` right of the given ones.

    All are (n,); the heading is clockwise from true north.  Along the ellipsoid's radii of curvature: exact to 1 mm for 500 m,
    up to a latitude of 80 degrees.
    """
    north = forward_m * np.cos(heading_rad) - starboard_m * np.sin(heading_rad)
    east = forward_m * np.sin(heading_rad) + starboard_m * np.cos(heading_rad)
    w = 1 - E2 * np.sin(latitude_rad) ** 2
    prime = SEMI_MAJOR_M / np.sqrt(w)
    # The latitude half way, and the meridian's convergence, give the second order.
    d_lat = north / (prime * (1 - E2) / w)
    parallel = prime * np.cos(latitude_rad + d_lat)
    d_lon = east / parallel
    sag = east * east * np.tan(latitude_rad) / (2 * prime * prime) * w / (1 - E2)
    longitude = longitude_rad + d_lon
    return latitude_rad + d_lat - sag, (longitude + np.pi) % (2 * np.pi) - np.pi


def seconds_to_time(coarse_s: FloatArray, gap_s: FloatArray, second: IntArray) -> tuple[FloatArray, FloatArray]:
    """Time (n,) and its sd (n,) of reports that tell their second of the minute, from the coarse time of their sentence.

    `gap_s` is how far apart the times are that the coarse time stands between; where it cannot tell the minute, or the report
    tells no second (60 and above), the coarse time is kept.
    """
    usable = (second >= 0) & (second < 60) & (gap_s <= _MINUTE_S)
    # A report comes after its second, by up to some ten seconds through repeaters, or a little before it where clocks differ.
    off = (second - coarse_s + _EARLIER_S) % 60.0 - _EARLIER_S
    # Whole seconds: the sum would carry the rounding of the coarse time.
    time = np.where(usable, np.round(coarse_s + np.where(usable, off, 0.0)), coarse_s)
    strange = np.where(np.abs(off) > _PROMPT_S, np.abs(off) / 2, 0.0)
    return time, np.where(
        usable, np.maximum(SECOND_SD_S, strange), np.maximum(UNSTAMPED_SD_S, np.minimum(gap_s, 1e6) / np.sqrt(12.0))
    )


class Moved(NamedTuple):
    """How the reports fared: without a position, moved to the hull's centre, with an antenna known but no heading."""

    nowhere: int
    centred: int
    headless: int


def fixes_of(
    messages: Messages, static: dict[str, AnyArray], time_s: FloatArray, gap_s: FloatArray, source: int
) -> tuple[Fixes, Moved]:
    """The position reports as fixes about the hull's centre.

    `time_s` and `gap_s` (n,) are the coarse time of each report and how uncertain it is, `static` all static data known so far,
    in the order of records.  A ship has the static data that came last before a report, else the first after it.
    """
    r = messages.report
    time, time_sd = seconds_to_time(time_s, gap_s, r["second"])
    known = (np.abs(r["lat_deg"]) <= 90) & (np.abs(r["lon_deg"]) <= 180)
    # pyais rounds to 1e-6 degrees; the message counts in 1/10,000 minutes (type 27: 1/10).
    step = np.where(r["type"] == 27, 600.0, 600000.0)
    lat, lon = (np.radians(np.where(known, np.round(r[n] * step) / step, np.nan)) for n in ("lat_deg", "lon_deg"))
    speed = np.where(r["speed_kn"] < 102.25, r["speed_kn"], np.nan) * KNOT_MPS
    course = np.where(r["course_deg"] < 360, np.radians(r["course_deg"]), np.nan)
    heading = np.where(r["heading_deg"] < 360, np.radians(r["heading_deg"]), np.nan)
    row, found = _latest(static, r["mmsi"], r["record"])
    bow, stern, port, starboard = (
        np.where(found, static[n][row] if len(static[n]) else 0, 0) for n in ("bow", "stern", "port", "starboard")
    )
    sized = found & (bow + stern > 0)
    # A and C zero, B and D not: the antenna's place is not known, B and D are length and width.
    placed = sized & ~((bow == 0) & (port == 0))
    forward, right = np.where(placed, (bow - stern) / 2.0, 0.0), np.where(placed, (starboard - port) / 2.0, 0.0)
    steered = np.where(np.isfinite(heading), heading, np.where(speed > _STEERED_MPS, course, np.nan))
    move = placed & known & np.isfinite(steered)
    moved = hull_centre(lat, lon, np.where(move, steered, 0.0), np.where(move, forward, 0.0), np.where(move, right, 0.0))
    lat, lon = np.where(move, moved[0], lat), np.where(move, moved[1], lon)
    sd = np.where(r["accurate"], ACCURATE_SD_M, INACCURATE_SD_M)
    sd = np.where(r["type"] == 27, np.hypot(sd, COARSE_SD_M), sd)
    # Not moved: the antenna is anywhere on a circle about the centre.
    sd = np.where(placed & ~move, np.sqrt(sd**2 + (forward**2 + right**2) / 2), sd)
    still = np.where(np.isfinite(course) | (speed != 0), course, 0.0)
    fixes = Fixes(
        time_s=time,
        source=np.full(len(time), source),
        latitude_rad=lat,
        longitude_rad=lon,
        velocity_east_mps=speed * np.sin(still),
        velocity_north_mps=speed * np.cos(still),
        heading_rad=heading,
        mmsi=r["mmsi"],
        callsign=np.where(found, static["callsign"][row] if len(static["callsign"]) else -1, -1),
        length_m=np.where(sized, bow + stern, np.nan),
        width_m=np.where(sized & (port + starboard > 0), port + starboard, np.nan),
        horizontal_sd_m=sd,
        time_sd_s=time_sd,
        record=r["record"],
    )
    count = Moved(int(np.count_nonzero(~known)), int(np.count_nonzero(move)), int(np.count_nonzero(placed & known & ~move)))
    return fixes[known], count


def _latest(static: dict[str, AnyArray], mmsi: IntArray, record: IntArray) -> tuple[IntArray, BoolArray]:
    """The row of `static` for each report: its ship's last one before it, else the first after; and whether there is one."""
    n = len(static["mmsi"])
    if not n:
        return np.zeros(len(mmsi), np.int64), np.zeros(len(mmsi), bool)
    order = np.lexsort((static["record"], static["mmsi"]))
    # One ordered number a row: the ship, then its place in the file (records carried over from before are negative).
    key = (static["mmsi"][order] << 33) + static["record"][order]
    at = np.searchsorted(key, (mmsi << 33) + record, side="right") - 1
    before = (at >= 0) & (static["mmsi"][order[np.maximum(at, 0)]] == mmsi)
    after = np.minimum(at + 1, n - 1)
    at = np.where(before, np.maximum(at, 0), after)
    return order[at], static["mmsi"][order[at]] == mmsi
