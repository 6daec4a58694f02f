"""Plots and fixes to ASTERIX: CAT048 or CAT010 for plots, CAT034 for north marks and sectors, CAT020 and CAT021 for fixes.

The bytes are what editions 1.27 to 1.32 of CAT048, 2.1 to 2.6 of CAT021, 1.9 to 1.11 of CAT020, 1.27 to 1.29 of CAT034 and
1.1 of CAT010 all read alike.  Values are rounded to the standard's quantum (range 1/256 NM or 1 m, azimuth 360/65536 deg, time
1/128 s, level 1/4 FL, high-resolution position 180/2^30 deg, multilaterated 180/2^25 deg).  The standard keeps only the time of
day, so the date of a file's first record must be told when it is read back.

All is done a column at a time: records with the same items form one byte matrix, and the matrices are laid into the file in
the order of time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from .._types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray
from ..errors import InputError
from ..model import Channel, Fixes, Flag, Plots
from . import write_bytes

NAUTICAL_MILE_M = 1852.0
FOOT_M = 0.3048
DAY_S = 86400.0
# 95 % bound of the horizontal error (m) of the navigation accuracy categories 1 ... 11, DO-260B table 2-14.
EPU_M = (18520.0, 7408.0, 3704.0, 1852.0, 926.0, 555.6, 185.2, 92.6, 30.0, 10.0, 3.0)
# The radius that holds 95 % of a circular Gaussian error, in sd of one axis.
RADIUS_95 = math.sqrt(-2.0 * math.log(0.05))


class Marks(NamedTuple):
    """North marks and sector crossings of rotating antennas (CAT034), one row a message.

    `azimuth_rad` is NaN for a north mark, else where the sector begins.  `rotation_s` and the position (written with north marks,
    I034/120, quantum 2.4 m) may be NaN.
    """

    time_s: FloatArray
    sensor: AnyArray
    azimuth_rad: FloatArray
    rotation_s: FloatArray
    latitude_rad: FloatArray
    longitude_rad: FloatArray
    height_m: FloatArray


class Written(msgspec.Struct, frozen=True):
    """What became of the tables: records, blocks and bytes, and what the standard could not hold (column: how many rows)."""

    records: int
    blocks: int
    bytes: int
    left_out: dict[str, int]


@dataclass(slots=True)
class _Items:
    """The items of one table, in the order of the UAP: field reference number (0: continues the item before), rows, bytes."""

    n: int
    frn: list[int] = field(default_factory=list)
    present: list[BoolArray] = field(default_factory=list)
    octets: list[ByteArray] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)

    def add(self, frn: int, octets: ByteArray, present: BoolArray | None = None) -> None:
        self.frn.append(frn)
        self.present.append(np.ones(self.n, np.bool_) if present is None else present)
        self.octets.append(octets)

    def scaled(self, name: str, values: FloatArray, lsb: float, bits: int, signed: bool = True) -> tuple[BoolArray, IntArray]:
        """Which values are there and fit, and they in quanta.  What is finite but does not fit is counted under `name`."""
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        finite = np.isfinite(values)
        quanta = np.rint(np.where(finite, values, 0.0) / lsb)
        fits = (quanta >= low) & (quanta <= high)
        self.lose(name, finite & ~fits)
        present = finite & fits
        return present, np.where(present, quanta, 0.0).astype(np.int64)

    def lose(self, name: str, rows: BoolArray) -> None:
        count = int(np.count_nonzero(rows))
        if count:
            self.left_out[name] = self.left_out.get(name, 0) + count


class _Group(NamedTuple):
    """Records of one layout: which rows they are, and their bytes (rows, length)."""

    rows: IntArray
    octets: ByteArray


class _Encoded(NamedTuple):
    category: int
    time_s: FloatArray
    source: IntArray
    length: IntArray
    groups: list[_Group]
    left_out: dict[str, int]


def _bytes(values: IntArray, count: int) -> ByteArray:
    """The low `count` bytes of each value, big end first (n, count); negative values come out as two's complement."""
    return np.ascontiguousarray(values, ">i8").view(np.uint8).reshape(len(values), 8)[:, 8 - count :]


def _angle(radians: FloatArray, bits: int) -> IntArray:
    """An unsigned angle in quanta of 2 pi / 2^bits; absent (NaN) gives 0."""
    turns = np.where(np.isfinite(radians), radians, 0.0) / (2 * np.pi)
    return np.rint(turns * (1 << bits)).astype(np.int64) % (1 << bits)


def _time_of_day(time_s: FloatArray) -> IntArray:
    """The time of day in 1/128 s."""
    return np.rint(np.mod(time_s, DAY_S) * 128.0).astype(np.int64) % int(DAY_S * 128)


def _octet(*bits: tuple[BoolArray | IntArray, int]) -> IntArray:
    """An octet from (value, shift) parts."""
    total = bits[0][0].astype(np.int64) << bits[0][1]
    for value, shift in bits[1:]:
        total = total | value.astype(np.int64) << shift
    return total


def _flag(flags: AnyArray, flag: Flag) -> BoolArray:
    chosen: BoolArray = (flags & np.uint32(flag)) != 0
    return chosen


def _refuse(rows: BoolArray, what: str, remedy: str) -> None:
    if rows.any():
        raise InputError(f"{what} ({np.count_nonzero(rows)} such rows)", record=int(np.argmax(rows)), remedy=remedy)


_SD = ("range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")


def _lose_columns(items: _Items, table: Plots | Fixes, *columns: str) -> None:
    """Count what the category has no item for."""
    for name in columns:
        items.lose(name, np.isfinite(getattr(table, name)))
    items.lose("mmsi", table.mmsi >= 0)


def _source_item(items: _Items, key: AnyArray, column: str, frn: int) -> IntArray:
    source = key.astype(np.int64)
    _refuse(
        (source < 0) | (source > 0xFFFF),
        f"{column} is not a SAC/SIC, which ASTERIX needs",
        "Give the sensor sac and sic in sensors.toml, or write a table instead.",
    )
    items.add(frn, _bytes(source, 2))
    return source


def _finish(items: _Items, category: int, time_s: FloatArray, source: IntArray) -> _Encoded:
    """Group the rows by layout and lay each group's items side by side behind its FSPEC."""
    pattern = np.zeros(items.n, np.int64)
    for k, present in enumerate(items.present):
        pattern |= present.astype(np.int64) << k
    length = np.zeros(items.n, np.int64)
    groups: list[_Group] = []
    order = np.argsort(pattern, kind="stable")
    cuts = np.flatnonzero(np.diff(pattern[order])) + 1
    for rows in np.split(order, cuts) if items.n else []:
        first = int(pattern[rows[0]])
        chosen = [k for k in range(len(items.frn)) if first >> k & 1]
        frns = [items.frn[k] for k in chosen if items.frn[k]]
        fspec = np.zeros((max(frns) + 6) // 7, np.uint8)
        for frn in frns:
            fspec[(frn - 1) // 7] |= 0x80 >> (frn - 1) % 7
        fspec[:-1] |= 1
        parts = [np.broadcast_to(fspec, (len(rows), len(fspec))), *(items.octets[k][rows] for k in chosen)]
        octets = np.concatenate(parts, axis=1)
        length[rows] = octets.shape[1]
        groups.append(_Group(rows, octets))
    return _Encoded(category, time_s, source, length, groups, items.left_out)


def _check_plots(plots: Plots) -> None:
    _refuse(~np.isfinite(plots.time_s), "a plot has no time", "Leave such rows out.")
    _refuse(
        ~(np.isfinite(plots.range_m) & np.isfinite(plots.azimuth_rad) & (plots.range_m >= 0)),
        "a plot has no range or azimuth",
        "Leave such rows out.",
    )
    _refuse(plots.track > 0xFFF, "a track number is above 4095, the largest that ASTERIX holds", "Number the tracks anew.")


def _range(range_m: FloatArray, lsb_m: float, what: str, remedy: str) -> IntArray:
    """Ranges (n,) in quanta; raises InputError, saying `what`, for those that two octets do not hold."""
    quanta = np.rint(range_m / lsb_m)
    _refuse(quanta > 0xFFFF, what, remedy)
    return quanta.astype(np.int64)


def _identity(items: _Items, column: AnyArray, frn: int, count: int) -> None:
    items.add(frn, _bytes(column.astype(np.int64), count), column >= 0)


_TYPE_048 = {
    Channel.UNKNOWN: 0, Channel.PSR: 1, Channel.SSR: 2, Channel.SSR_PSR: 3, Channel.MODE_S: 5, Channel.MODE_S_PSR: 7,
    Channel.MLAT: 0, Channel.ADS_B: 0,
}  # fmt: skip
_WARNINGS_048 = ((Flag.REFLECTION, 1), (Flag.SIDE_LOBE, 2), (Flag.SECOND_TIME, 4))


def _encode_048(plots: Plots) -> _Encoded:
    _check_plots(plots)
    items = _Items(len(plots))
    flags, none = plots.flags, np.zeros(len(plots), np.int64)
    source = _source_item(items, plots.sensor, "sensor", 1)
    items.add(2, _bytes(_time_of_day(plots.time_s), 3))

    kind = np.array([_TYPE_048[Channel(k)] for k in range(len(Channel))])[plots.channel]
    kind = np.where(_flag(flags, Flag.EXTRAPOLATED), 0, kind)
    test = _flag(flags, Flag.TEST)
    simulated, monitor = _flag(flags, Flag.SIMULATED), _flag(flags, Flag.FIELD_MONITOR)
    chain = _flag(flags, Flag.CHAIN_2)
    items.add(3, _bytes(_octet((kind, 5), (simulated, 4), (chain, 3), (monitor, 1), (test, 0)), 1))
    items.add(0, _bytes(none + 0x80, 1), test)

    what = "a range is above 256 NM, the longest that I048/040 holds"
    quanta = _range(plots.range_m, NAUTICAL_MILE_M / 256, what, "Leave such rows out.")
    items.add(4, np.concatenate([_bytes(quanta, 2), _bytes(_angle(plots.azimuth_rad, 16), 2)], axis=1))

    garbled = _flag(flags, Flag.GARBLED)
    code = np.maximum(plots.mode_3a.astype(np.int64), 0) & 0xFFF
    items.add(5, _bytes(code | garbled.astype(np.int64) << 14, 2), (plots.mode_3a >= 0) | garbled)
    level, quarter = items.scaled("pressure_altitude_m", plots.pressure_altitude_m, 25 * FOOT_M, 14)
    items.add(6, _bytes(quarter & 0x3FFF, 2), level)

    far, range_difference = items.scaled("psr_ssr_range_m", plots.psr_ssr_range_m, NAUTICAL_MILE_M / 256, 8)
    aside, azimuth_difference = items.scaled("psr_ssr_azimuth_rad", plots.psr_ssr_azimuth_rad, 2 * np.pi / (1 << 14), 8)
    items.add(7, _bytes(_octet((far, 2), (aside, 1)), 1), far | aside)
    items.add(0, _bytes(range_difference, 1), far)
    items.add(0, _bytes(azimuth_difference, 1), aside)

    _identity(items, plots.mode_s, 8, 3)
    _identity(items, plots.callsign, 9, 6)
    _identity(items, plots.track, 11, 2)
    moving, speed = items.scaled("speed_mps", plots.speed_mps, NAUTICAL_MILE_M / (1 << 14), 16, signed=False)
    moving &= np.isfinite(plots.heading_rad)
    items.add(13, np.concatenate([_bytes(speed, 2), _bytes(_angle(plots.heading_rad, 16), 2)], axis=1), moving)
    secondary = np.isin(plots.channel, (Channel.SSR, Channel.MODE_S))
    radar = np.where(plots.channel == Channel.PSR, 1, np.where(secondary, 2, 0))
    ended = _flag(flags, Flag.TRACK_END)
    items.add(14, _bytes(_octet((radar, 5), (ended, 0)), 1), (plots.track >= 0) | ended)
    items.add(0, _bytes(none + 0x80, 1), ended)
    # I048/030 grows by an octet a warning; the last bit of each octet says whether another follows.
    hits = [_flag(flags, flag) for flag, _ in _WARNINGS_048]
    for k, (_, value) in enumerate(_WARNINGS_048):
        earlier = np.any(hits[:k], axis=0) if k else np.zeros(len(plots), np.bool_)
        later = np.any(hits[k + 1 :], axis=0) if k + 1 < len(hits) else np.zeros(len(plots), np.bool_)
        octet = _bytes(_octet((none + value, 1), (later, 0)), 1)
        items.add(16, octet, hits[k] & ~earlier)
        items.add(0, octet, hits[k] & earlier)
    above, height = items.scaled("height_m", plots.height_m, 25 * FOOT_M, 14)
    items.add(19, _bytes(height & 0x3FFF, 2), above)

    _lose_columns(items, plots, "elevation_rad", "length_m", "width_m", *_SD)
    items.lose("heading_rad", np.isfinite(plots.heading_rad) & ~moving)
    items.lose("flags", _flag(flags, Flag.GROUND | Flag.VEHICLE | Flag.TIME_OF_RECEPTION))
    return _finish(items, 48, plots.time_s, source)


_TYPE_010 = {
    Channel.UNKNOWN: 6, Channel.PSR: 3, Channel.SSR: 0, Channel.SSR_PSR: 7, Channel.MODE_S: 1, Channel.MODE_S_PSR: 7,
    Channel.MLAT: 1, Channel.ADS_B: 2,
}  # fmt: skip


def _encode_010(plots: Plots) -> _Encoded:
    _check_plots(plots)
    items = _Items(len(plots))
    flags, none = plots.flags, np.zeros(len(plots), np.int64)
    source = _source_item(items, plots.sensor, "sensor", 1)
    items.add(2, _bytes(none + 1, 1))
    kind = np.array([_TYPE_010[Channel(k)] for k in range(len(Channel))])[plots.channel]
    simulated, test, monitor = (_flag(flags, f) for f in (Flag.SIMULATED, Flag.TEST, Flag.FIELD_MONITOR))
    vehicle = _flag(flags, Flag.VEHICLE)
    more = simulated | test | monitor | vehicle
    garbled = _flag(flags, Flag.GARBLED)
    items.add(3, _bytes(_octet((kind, 5), (_flag(flags, Flag.GROUND), 2), (garbled, 1), (more, 0)), 1))
    items.add(0, _bytes(_octet((simulated, 7), (test, 6), (monitor, 5), (vehicle, 2)), 1), more)
    items.add(4, _bytes(_time_of_day(plots.time_s), 3))
    what = "a range is above 65,535 m, the longest that I010/040 holds"
    quanta = _range(plots.range_m, 1.0, what, "Write CAT048 instead (category=48).")
    items.add(6, np.concatenate([_bytes(quanta, 2), _bytes(_angle(plots.azimuth_rad, 16), 2)], axis=1))
    _identity(items, plots.track, 10, 2)
    ended = _flag(flags, Flag.TRACK_END)
    extrapolated = _flag(flags, Flag.EXTRAPOLATED)
    items.add(11, _bytes(_octet((ended, 6), (extrapolated, 4)), 1), (plots.track >= 0) | ended | extrapolated)
    items.add(12, _bytes(np.maximum(plots.mode_3a.astype(np.int64), 0) & 0xFFF, 2), plots.mode_3a >= 0)
    _identity(items, plots.mode_s, 13, 3)
    items.add(14, np.concatenate([_bytes(none, 1), _bytes(plots.callsign, 6)], axis=1), plots.callsign >= 0)
    level, quarter = items.scaled("pressure_altitude_m", plots.pressure_altitude_m, 25 * FOOT_M, 14)
    items.add(17, _bytes(quarter & 0x3FFF, 2), level)
    above, height = items.scaled("height_m", plots.height_m, 6.25 * FOOT_M, 16)
    items.add(18, _bytes(height, 2), above)
    long, length = items.scaled("length_m", plots.length_m, 1.0, 7, signed=False)
    wide, width = items.scaled("width_m", plots.width_m, 1.0, 7, signed=False)
    # Each octet of I010/270 needs the one before it: an unknown length or heading before a known value is written as 0.
    turned = np.isfinite(plots.heading_rad) & long
    wide &= turned
    items.add(19, _bytes(_octet((length, 1), (turned, 0)), 1), long)
    items.add(0, _bytes(_octet((_angle(plots.heading_rad, 7), 1), (wide, 0)), 1), turned)
    items.add(0, _bytes(width << 1, 1), wide)
    items.lose("heading_rad", np.isfinite(plots.heading_rad) & ~turned)
    items.lose("flags", _flag(flags, Flag.REFLECTION | Flag.SIDE_LOBE | Flag.SECOND_TIME | Flag.TIME_OF_RECEPTION | Flag.CHAIN_2))
    _lose_columns(items, plots, "elevation_rad", "psr_ssr_range_m", "psr_ssr_azimuth_rad", "speed_mps", *_SD)
    return _finish(items, 10, plots.time_s, source)


def _encode_034(marks: Marks) -> _Encoded:
    items = _Items(len(marks.time_s))
    _refuse(~np.isfinite(marks.time_s), "a north mark has no time", "Leave such rows out.")
    source = _source_item(items, marks.sensor, "sensor", 1)
    north = ~np.isfinite(marks.azimuth_rad)
    items.add(2, _bytes(np.where(north, 1, 2), 1))
    items.add(3, _bytes(_time_of_day(marks.time_s), 3))
    items.add(4, _bytes(_angle(marks.azimuth_rad, 8), 1), ~north)
    turning, period = items.scaled("rotation_s", marks.rotation_s, 1 / 128, 16, signed=False)
    items.add(5, _bytes(period, 2), turning)
    high, height = items.scaled("height_m", marks.height_m, 1.0, 16)
    fits_north, latitude = items.scaled("latitude_rad", np.rad2deg(marks.latitude_rad), 180 / (1 << 23), 24)
    fits_east, longitude = items.scaled("longitude_rad", np.rad2deg(marks.longitude_rad), 180 / (1 << 23), 24)
    octets = np.concatenate([_bytes(height, 2), _bytes(latitude, 3), _bytes(longitude, 3)], axis=1)
    items.add(11, octets, north & high & fits_north & fits_east)
    return _finish(items, 34, marks.time_s, source)


def accuracy_category(horizontal_sd_m: FloatArray) -> IntArray:
    """The navigation accuracy category NACp (n,) whose bound holds for an error of `horizontal_sd_m` an axis; NaN gives 0.

    The bound is the radius of 95 % of the errors, 2.448 sd of one axis (METHODS section 6), with 0.1 % leeway for rounding.
    """
    bound = np.array(EPU_M) / RADIUS_95 * 1.001
    sd = np.where(np.isfinite(horizontal_sd_m), horizontal_sd_m, np.inf)
    return np.searchsorted(-bound, -sd, side="right").astype(np.int64)


def accuracy_sd_m(category: AnyArray) -> FloatArray:
    """The sd of one axis (n,) in metres that the accuracy category NACp stands for; category 0 gives NaN."""
    table = np.concatenate([[np.nan], np.array(EPU_M) / RADIUS_95])
    return table[np.clip(np.asarray(category, np.int64), 0, 11)]


def _check_fixes(fixes: Fixes) -> None:
    _refuse(~np.isfinite(fixes.time_s), "a fix has no time", "Leave such rows out.")
    _refuse(
        ~(np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad)),
        "a fix has no latitude and longitude, which ASTERIX needs",
        "Make Cartesian positions geodetic first, or leave such rows out.",
    )
    _refuse(fixes.track > 0xFFF, "a track number is above 4095, the largest that ASTERIX holds", "Number the tracks anew.")


def _position(fixes: Fixes, bits: int, fraction: int) -> ByteArray:
    """Latitude and longitude side by side, `bits` each, in quanta of 180 deg / 2^fraction."""
    # A longitude of 180 deg does not fit a signed field that ends there; -180 deg is the same place.
    longitude = np.mod(np.rad2deg(fixes.longitude_rad) + 180.0, 360.0) - 180.0
    parts = [np.rint(v / (180 / (1 << fraction))).astype(np.int64) for v in (np.rad2deg(fixes.latitude_rad), longitude)]
    parts[1] = np.where(parts[1] >= 1 << fraction, parts[1] - (2 << fraction), parts[1])
    return np.concatenate([_bytes(p, bits // 8) for p in parts], axis=1)


def _encode_020(fixes: Fixes) -> _Encoded:
    """Fixes of multilateration (edition 1.5 and later); the sd of both axes is the horizontal one."""
    _check_fixes(fixes)
    items = _Items(len(fixes))
    flags, none = fixes.flags, np.zeros(len(fixes), np.int64)
    source = _source_item(items, fixes.source, "source", 1)
    addressed = fixes.mode_s >= 0
    more = [_flag(flags, f) for f in (Flag.FIELD_MONITOR, Flag.GROUND, Flag.SIMULATED, Flag.TEST)]
    second = np.any(more, axis=0)
    items.add(2, _bytes(_octet((~addressed, 7), (addressed, 6), (second, 0)), 1))
    items.add(0, _bytes(_octet((more[0], 7), (more[1], 4), (more[2], 2), (more[3], 1)), 1), second)
    items.add(3, _bytes(_time_of_day(fixes.time_s), 3))
    items.add(4, _position(fixes, 32, 25))
    _identity(items, fixes.track, 6, 2)
    ended, extrapolated = _flag(flags, Flag.TRACK_END), _flag(flags, Flag.EXTRAPOLATED)
    items.add(7, _bytes(_octet((ended, 6), (extrapolated, 5)), 1), (fixes.track >= 0) | ended | extrapolated)
    garbled = _flag(flags, Flag.GARBLED)
    code = np.maximum(fixes.mode_3a.astype(np.int64), 0) & 0xFFF
    items.add(8, _bytes(code | garbled.astype(np.int64) << 14, 2), (fixes.mode_3a >= 0) | garbled)
    east, vx = items.scaled("velocity_east_mps", fixes.velocity_east_mps, 0.25, 16)
    north, vy = items.scaled("velocity_north_mps", fixes.velocity_north_mps, 0.25, 16)
    items.add(9, np.concatenate([_bytes(vx, 2), _bytes(vy, 2)], axis=1), east & north)
    level, quarter = items.scaled("pressure_altitude_m", fixes.pressure_altitude_m, 25 * FOOT_M, 14)
    items.add(10, _bytes(quarter & 0x3FFF, 2), level)
    _identity(items, fixes.mode_s, 12, 3)
    items.add(13, np.concatenate([_bytes(none, 1), _bytes(fixes.callsign, 6)], axis=1), fixes.callsign >= 0)
    high, height = items.scaled("height_m", fixes.height_m, 6.25 * FOOT_M, 16)
    items.add(15, _bytes(height, 2), high)
    items.add(17, _bytes(none, 1), _flag(flags, Flag.VEHICLE))
    known, sd = items.scaled("horizontal_sd_m", fixes.horizontal_sd_m, 0.25, 16, signed=False)
    third, vertical = items.scaled("vertical_sd_m", fixes.vertical_sd_m, 0.5, 16, signed=False)
    items.add(19, _bytes(_octet((known, 6), (third, 5)), 1), known | third)
    # The third number is the covariance of the two axes: none.
    items.add(0, np.concatenate([_bytes(sd, 2), _bytes(sd, 2), _bytes(none, 2)], axis=1), known)
    items.add(0, _bytes(vertical, 2), third)
    items.lose("flags", _flag(flags, Flag.TIME_OF_RECEPTION))
    _lose_columns(items, fixes, "velocity_up_mps", "heading_rad", "length_m", "width_m", "time_sd_s")
    return _finish(items, 20, fixes.time_s, source)


def _encode_021(fixes: Fixes) -> _Encoded:
    _check_fixes(fixes)
    items = _Items(len(fixes))
    flags, none = fixes.flags, np.zeros(len(fixes), np.int64)
    source = _source_item(items, fixes.source, "source", 1)
    ground, simulated, test = (_flag(flags, f) for f in (Flag.GROUND, Flag.SIMULATED, Flag.TEST))
    more = ground | simulated | test
    items.add(2, _bytes(_octet((_flag(flags, Flag.FIELD_MONITOR), 1), (more, 0)), 1))
    items.add(0, _bytes(_octet((ground, 6), (simulated, 5), (test, 4)), 1), more)
    _identity(items, fixes.track, 3, 2)
    received = _flag(flags, Flag.TIME_OF_RECEPTION)
    stamp = _bytes(_time_of_day(fixes.time_s), 3)
    items.add(5, stamp, ~received)
    items.add(6, _position(fixes, 24, 23))
    items.add(7, _position(fixes, 32, 30))
    _identity(items, fixes.mode_s, 11, 3)
    items.add(12, stamp, received)
    high, height = items.scaled("height_m", fixes.height_m, 6.25 * FOOT_M, 16)
    items.add(16, _bytes(height, 2), high)

    category = accuracy_category(fixes.horizontal_sd_m)
    bounded = 1.959964 * fixes.vertical_sd_m
    vertical = np.where(bounded <= 45.0, 2, np.where(bounded <= 150.0, 1, 0))
    known, third = category > 0, vertical > 0
    items.add(17, _bytes(none + 1, 1), known | third)
    items.add(0, _bytes(_octet((category, 1), (third, 0)), 1), known | third)
    items.add(0, _bytes(_octet((vertical, 1)), 1), third)
    # Version 2 (DO-260B) over 1090 MHz: only from version 1 on does I021/090 carry NACp.
    items.add(18, _bytes(none + 0x12, 1))
    items.add(19, _bytes(np.maximum(fixes.mode_3a.astype(np.int64), 0) & 0xFFF, 2), fixes.mode_3a >= 0)
    level, quarter = items.scaled("pressure_altitude_m", fixes.pressure_altitude_m, 25 * FOOT_M, 16)
    items.add(21, _bytes(quarter, 2), level)
    rising, climb = items.scaled("velocity_up_mps", fixes.velocity_up_mps, 6.25 * FOOT_M / 60, 15)
    items.add(25, _bytes(climb & 0x7FFF, 2), rising)
    east, north = fixes.velocity_east_mps, fixes.velocity_north_mps
    moving, speed = items.scaled("velocity_east_mps", np.hypot(east, north), NAUTICAL_MILE_M / (1 << 14), 15, signed=False)
    course = np.arctan2(np.where(moving, east, 0.0), np.where(moving, north, 1.0))
    items.add(26, np.concatenate([_bytes(speed, 2), _bytes(_angle(course, 16), 2)], axis=1), moving)
    _identity(items, fixes.callsign, 29, 6)
    items.add(30, _bytes(none + 21, 1), _flag(flags, Flag.VEHICLE))
    _lose_columns(items, fixes, "heading_rad", "length_m", "width_m", "time_sd_s")
    return _finish(items, 21, fixes.time_s, source)


def _assemble(tables: Sequence[_Encoded], records_per_block: int) -> tuple[bytes, Written]:
    """Lay all records into blocks in the order of time; a block holds one category and source and at most half a second."""
    if not tables or not sum(len(t.time_s) for t in tables):
        return b"", Written(0, 0, 0, {})
    time = np.concatenate([t.time_s for t in tables])
    length = np.concatenate([t.length for t in tables])
    category = np.concatenate([np.full(len(t.time_s), t.category, np.int64) for t in tables])
    source = np.concatenate([t.source for t in tables])
    order = np.argsort(time, kind="stable")
    kind = category[order] << 16 | source[order]
    window = np.floor(time[order] * 2.0).astype(np.int64)
    starts_run = np.ones(len(order), np.bool_)
    starts_run[1:] = (np.diff(kind) != 0) | (np.diff(window) != 0)
    place = np.arange(len(order))
    in_run = place - np.maximum.accumulate(np.where(starts_run, place, 0))
    starts = in_run % records_per_block == 0
    block = np.cumsum(starts) - 1

    end = np.cumsum(length[order]) + 3 * (block + 1)
    offset = np.empty(len(order), np.int64)
    offset[order] = end - length[order]
    out = np.empty(int(end[-1]), np.uint8)
    header = end[starts] - length[order][starts] - 3
    size = np.diff(np.append(header, len(out)))
    out[header] = category[order][starts]
    out[header + 1], out[header + 2] = size >> 8, size & 0xFF
    base = 0
    for table in tables:
        for group in table.groups:
            out[offset[base + group.rows][:, None] + np.arange(group.octets.shape[1])] = group.octets
        base += len(table.time_s)
    left_out: dict[str, int] = {}
    for table in tables:
        for name, count in table.left_out.items():
            left_out[name] = left_out.get(name, 0) + count
    return out.tobytes(), Written(len(order), int(np.count_nonzero(starts)), len(out), left_out)


def encode_asterix(
    plots: Plots | None = None,
    fixes: Fixes | None = None,
    marks: Marks | None = None,
    *,
    category: int = 48,
    records_per_block: int = 16,
) -> tuple[bytes, Written]:
    """The tables as ASTERIX data blocks in the order of time, and an account of them.

    Plots become CAT048 records, or CAT010 ones with ``category=10``; fixes of multilateration become CAT020, all others CAT021
    (edition 2.x), marks CAT034.  Rows of one time keep their order within a category.  `Plots.height_m` goes to I048/110 (25 ft)
    as it stands, though the standard means one above mean sea level.  Elevation has no item in CAT048 or CAT010; what is not
    written is counted in `Written.left_out`.

    Raises InputError, with the row, for rows without time or position, sources without SAC/SIC, track numbers above 4095 and
    ranges that the category cannot hold.
    """
    if category not in (10, 48):
        raise InputError(f"plots cannot be written as CAT{category:03d}", remedy="Take category 48 or 10.")
    if not 1 <= records_per_block <= 500:
        raise InputError(f"records_per_block = {records_per_block} is not within 1 … 500")
    tables: list[_Encoded] = []
    if marks is not None:
        tables.append(_encode_034(marks))
    if plots is not None:
        tables.append(_encode_048(plots) if category == 48 else _encode_010(plots))
    if fixes is not None:
        located = fixes.channel == Channel.MLAT
        if located.any():
            tables.append(_encode_020(fixes[located]))
        if not located.all():
            tables.append(_encode_021(fixes[~located]))
    return _assemble(tables, records_per_block)


def write_asterix(
    path: str | Path,
    plots: Plots | None = None,
    fixes: Fixes | None = None,
    marks: Marks | None = None,
    *,
    category: int = 48,
    records_per_block: int = 16,
) -> Written:
    """Write `encode_asterix`'s blocks to `path`, as a whole or not at all.  Raises InputError as it does, and for the file."""
    data, written = encode_asterix(plots, fixes, marks, category=category, records_per_block=records_per_block)
    write_bytes(path, data)
    return written
