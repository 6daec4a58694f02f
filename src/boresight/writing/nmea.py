"""NMEA 0183: a marine radar's targets (TTM), targets with a position (TLL), own ship (GGA, OSD, XDR, RMC), the date (ZDA).

Quanta: distance 0.00001 NM (2 cm), bearing 0.0001 deg, position 0.0000001 min (0.2 mm), time 0.001 s, speed 0.001 kn.
Bearings are true, unless the sensor measures from the bow.  What the sentences have no field for is counted, not written.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import InputError, SettingsError
from ..measure import from_true_north, sensors_of
from ..model import Fixes, Flag, Platform, Plots, Sensors, Tracks, unpack_callsigns
from . import atomic
from .features import BLOCK

NAUTICAL_MILE_M = 1852.0
KNOT_MPS = NAUTICAL_MILE_M / 3600.0
_DAY_S = 86400.0
# The quality that a receiver would tell for an accuracy, per axis in metres: RTK fixed, RTK float; beyond them GPS alone.
_FIXED_SD_M, _FLOAT_SD_M = 0.2, 1.0


class NmeaWritten(msgspec.Struct, frozen=True):
    """What became of the tables: sentences written, and what they could not hold (column or reason: how many rows)."""

    sentences: int
    left_out: dict[str, int]


def checksum(body: str) -> str:
    """The two hexadecimal digits of a sentence's checksum; `body` is what stands between ``$`` and ``*``."""
    value = 0
    for c in body.encode("ascii", "replace"):
        value ^= c
    return f"{value:02X}"


def write_nmea(
    path: str | Path,
    plots: Plots | None = None,
    fixes: Fixes | None = None,
    platform: Platform | None = None,
    tracks: Tracks | None = None,
    *,
    sensors: Sensors | None = None,
) -> NmeaWritten:
    """Write tables as one NMEA 0183 log in the order of time, as a whole or not at all.

    Plots become TTM (distance and bearing about own ship, number, speed, course, time): the bearing is true, or relative where
    the radar's `angles` in `sensors` are from the bow.  With `sensors` a fixed radar's own position goes ahead as GGA.  The
    platform becomes GGA, with OSD and RMC where it has a heading or speed and XDR where it has roll or pitch.  Fixes and tracks
    become TLL; fixes of one target without identity, alone in the log (a GNSS receiver's), become GGA with height.  ZDA gives
    the date at the beginning and at each midnight.  Rows without a time or position are left out and counted, as are columns
    for which there is no field.

    Raises InputError where plots are of several radars, whose own positions one log cannot tell, or for the file;
    SettingsError where `sensors` lacks the radar.
    """
    left: dict[str, int] = {}
    streams: list[tuple[FloatArray, Iterator[str]]] = []
    if platform is not None and len(platform):
        streams.append(_platform(platform, left))
    if fixes is not None and len(fixes):
        alone = not any(table is not None and len(table) for table in (plots, platform, tracks))
        streams.append(_positions(fixes, left) if alone and _is_receiver(fixes) else _targets(fixes, left))
    if tracks is not None and len(tracks):
        streams.append(_targets(tracks, left))
    if plots is not None and len(plots):
        if len(np.unique(plots.sensor)) > 1:
            raise InputError("the plots are of several radars, and a log tells only one own position", path=path,
                             remedy="Write one file a radar.")  # fmt: skip
        streams.append(_plots(plots, sensors, left))
    header = (
        _fixed_site(plots, sensors) if plots is not None and len(plots) and not (platform is not None and len(platform)) else ""
    )
    count = 0
    day = -1
    with atomic(path) as beside, open(beside, "w", encoding="ascii", newline="") as file:
        times = np.concatenate([t for t, _ in streams]) if streams else np.empty(0)
        owner = np.repeat(np.arange(len(streams)), [len(t) for t, _ in streams])
        if not len(times):
            raise InputError(
                "nothing in it has both a time and a position", path=path, remedy="A log needs the time of each row."
            )
        order = np.argsort(times, kind="stable")
        for k in order.tolist():
            time = _rounded(float(times[k]))
            if int(time // _DAY_S) != day:
                day = int(time // _DAY_S)
                date = datetime.date(1970, 1, 1) + datetime.timedelta(days=day)
                file.write(_sentence(f"GPZDA,{_clock(time)},{date.day:02d},{date.month:02d},{date.year:04d},00,00"))
                count += 1
                if header:
                    file.write(_sentence(f"GPGGA,{_clock(time)},{header}"))
                    count += 1
            # Streams are sorted by time themselves, so the next of each is always the one that is due.
            text = next(streams[owner[k]][1])
            file.write(text)
            count += text.count("\n")
    return NmeaWritten(count, {name: n for name, n in left.items() if n})


def _sentence(body: str) -> str:
    return f"${body}*{checksum(body)}\r\n"


def _rounded(time_s: float) -> float:
    return math.floor(time_s * 1000 + 0.5) / 1000


def _clock(time_s: float) -> str:
    milliseconds = round(_rounded(time_s) % _DAY_S * 1000) % 86_400_000
    seconds, rest = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}{seconds // 60 % 60:02d}{seconds % 60:02d}.{rest:03d}"


def _angle(radians: float, digits: int = 4) -> str:
    if not math.isfinite(radians):
        return ""
    turned = round(math.degrees(radians) % 360.0, digits)
    return f"{0.0 if turned >= 360.0 else turned:.{digits}f}"


def _value(value: float, unit: float = 1.0, digits: int = 3) -> str:
    return f"{value / unit:.{digits}f}" if math.isfinite(value) else ""


def _latitude(radians: float) -> str:
    return _minutes(math.degrees(radians), "N", "S", 2)


def _longitude(radians: float) -> str:
    return _minutes((math.degrees(radians) + 180.0) % 360.0 - 180.0, "E", "W", 3)


def _minutes(degrees: float, positive: str, negative: str, width: int) -> str:
    units = round(abs(degrees) * 60 * 10**7)
    whole, rest = divmod(units, 60 * 10**7)
    return f"{whole:0{width}d}{rest // 10**7:02d}.{rest % 10**7:07d},{negative if degrees < 0 else positive}"


def _count(left: dict[str, int], table: object, *columns: str) -> None:
    """Count the rows in which these columns hold something that will not be written."""
    for name in columns:
        values = getattr(table, name)
        known = np.isfinite(values) if values.dtype.kind == "f" else values > 0 if values.dtype.kind == "u" else values >= 0
        left[name] = left.get(name, 0) + int(np.count_nonzero(known))


def _number(track: int) -> str:
    return f"{track:02d}" if 0 <= track <= 99999 else ""


def _named(table: Plots | Fixes | Tracks) -> Iterator[str]:
    """A target's name for each row: its callsign, else its MMSI or address."""
    for begin in range(0, len(table), BLOCK):
        part = table[begin : begin + BLOCK]
        for callsign, mmsi, mode_s in zip(unpack_callsigns(part.callsign), part.mmsi.tolist(), part.mode_s.tolist(), strict=True):
            name = callsign or (f"{mmsi:09d}" if mmsi >= 0 else f"{mode_s:06X}" if mode_s >= 0 else "")
            yield "".join(c for c in name if c.isalnum() or c == " ")


def _status(flags: int) -> str:
    if flags & (Flag.TRACK_END | Flag.EXTRAPOLATED):
        return "L"
    return "Q" if flags & Flag.ACQUIRING else "T"


_STATED = np.uint32(Flag.TRACK_END | Flag.EXTRAPOLATED | Flag.ACQUIRING)


def _plots(plots: Plots, sensors: Sensors | None, left: dict[str, int]) -> tuple[FloatArray, Iterator[str]]:
    azimuth, side = plots.azimuth_rad, np.full(len(plots), "T")
    if sensors is not None:
        sensor = sensors.find(int(plots.sensor[0]))
        sensor = next(iter(sensors_of(plots, sensors).values())) if sensor is None else sensor
        azimuth = from_true_north(azimuth, sensor)
        if sensor.angles != "north":
            side[(plots.flags & np.uint32(Flag.FROM_BOW)) == 0] = "R"
    there = np.isfinite(plots.time_s) & np.isfinite(plots.range_m) & np.isfinite(azimuth)
    left["plots without a time or position"] = int(np.count_nonzero(~there))
    far = there & (plots.range_m > 1000 * NAUTICAL_MILE_M)
    left["plots beyond 1,000 NM"] = int(np.count_nonzero(far))
    there &= ~far
    order = np.flatnonzero(there)[np.argsort(plots.time_s[there], kind="stable")]
    mine, azimuth, side = plots[order], azimuth[order], side[order]
    _count(left, mine, "elevation_rad", "height_m", "pressure_altitude_m", "mode_3a", "psr_ssr_range_m", "psr_ssr_azimuth_rad",
           "length_m", "width_m", "range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")  # fmt: skip
    left["flags"] = left.get("flags", 0) + int(np.count_nonzero(mine.flags & ~_STATED))
    left["channel"] = left.get("channel", 0) + int(np.count_nonzero(mine.channel > 1))
    _count_names(left, mine)

    def write() -> Iterator[str]:
        columns = (mine.time_s, mine.track, mine.range_m, azimuth, side, mine.speed_mps, mine.heading_rad, mine.flags)
        for (t, track, r, a, from_, v, course, flags), name in zip(_rows(*columns), _named(mine), strict=True):
            yield _sentence(
                f"RATTM,{_number(track)},{_value(r, NAUTICAL_MILE_M, 5)},{_angle(a)},{from_},{_value(v, KNOT_MPS)},"
                f"{_angle(course)},T,,,N,{name},{_status(flags)},,{_clock(t)},A"
            )

    return mine.time_s, write()


def _count_names(left: dict[str, int], table: Plots | Fixes | Tracks) -> None:
    """The name's field holds one identity; the others are lost."""
    has_callsign, has_mmsi = table.callsign >= 0, table.mmsi >= 0
    left["mode_s"] = left.get("mode_s", 0) + int(np.count_nonzero((table.mode_s >= 0) & (has_callsign | has_mmsi)))
    left["mmsi"] = left.get("mmsi", 0) + int(np.count_nonzero(has_mmsi & has_callsign))


def _rows(*columns: object) -> Iterator[tuple]:  # type: ignore[type-arg]
    """The rows of columns, as tuples, a block at a time."""
    arrays = [np.asarray(c) for c in columns]
    for begin in range(0, len(arrays[0]), BLOCK):
        yield from zip(*(a[begin : begin + BLOCK].tolist() for a in arrays), strict=True)


def _is_receiver(fixes: Fixes) -> bool:
    """Whether the fixes are one target's own: a receiver's log, not a list of targets."""
    nameless = not ((fixes.mode_s >= 0).any() or (fixes.mmsi >= 0).any() or (fixes.callsign >= 0).any())
    return nameless and len(np.unique(fixes.track)) == 1


def _gga(t: float, latitude: float, longitude: float, height: float, sd: float) -> str:
    quality = "4" if sd <= _FIXED_SD_M else "5" if sd <= _FLOAT_SD_M else "1"
    hdop = _value(sd / 3.0, 1.0, 2) if quality == "1" else ""
    # The height is ellipsoidal: it is written above a geoid that is the ellipsoid.
    up = f"{_value(height)},M,0.0,M" if math.isfinite(height) else ",M,,M"
    return f"{_latitude(latitude)},{_longitude(longitude)},{quality},,{hdop},{up},,"


def _positions(fixes: Fixes, left: dict[str, int]) -> tuple[FloatArray, Iterator[str]]:
    mine = _placed(fixes, "fixes", left)
    _count(left, mine, "pressure_altitude_m", "velocity_up_mps", "heading_rad", "vertical_sd_m", "time_sd_s", "flags", "length_m")
    left["velocity"] = int(np.count_nonzero(np.isfinite(mine.velocity_east_mps)))

    def write() -> Iterator[str]:
        columns = (mine.time_s, mine.latitude_rad, mine.longitude_rad, mine.height_m, mine.horizontal_sd_m)
        for t, latitude, longitude, height, sd in _rows(*columns):
            yield _sentence(f"GPGGA,{_clock(t)},{_gga(t, latitude, longitude, height, sd)}")

    return mine.time_s, write()


def _placed(table: Fixes | Tracks | Platform, kind: str, left: dict[str, int]) -> Fixes:
    there = np.isfinite(table.time_s) & np.isfinite(table.latitude_rad) & np.isfinite(table.longitude_rad)
    left[f"{kind} without a time or position"] = int(np.count_nonzero(~there))
    return table[np.flatnonzero(there)[np.argsort(table.time_s[there], kind="stable")]]  # type: ignore[return-value]


def _targets(table: Fixes | Tracks, left: dict[str, int]) -> tuple[FloatArray, Iterator[str]]:
    mine = _placed(table, "tracks" if isinstance(table, Tracks) else "fixes", left)
    _count(
        left, mine, "height_m", "pressure_altitude_m", "velocity_up_mps", "heading_rad", "mode_3a", "horizontal_sd_m", "length_m"
    )
    left["velocity"] = left.get("velocity", 0) + int(np.count_nonzero(np.isfinite(mine.velocity_east_mps)))
    left["flags"] = left.get("flags", 0) + int(np.count_nonzero(mine.flags & ~_STATED))
    _count_names(left, mine)

    def write() -> Iterator[str]:
        columns = (mine.time_s, mine.track, mine.latitude_rad, mine.longitude_rad, mine.flags)
        for (t, track, latitude, longitude, flags), name in zip(_rows(*columns), _named(mine), strict=True):
            yield _sentence(
                f"RATLL,{_number(track)},{_latitude(latitude)},{_longitude(longitude)},{name},{_clock(t)},{_status(flags)},"
            )

    return mine.time_s, write()


def _platform(platform: Platform, left: dict[str, int]) -> tuple[FloatArray, Iterator[str]]:
    mine: Platform = _placed(platform, "platform positions", left)  # type: ignore[assignment]

    def write() -> Iterator[str]:
        columns = (
            mine.time_s,
            mine.latitude_rad,
            mine.longitude_rad,
            mine.height_m,
            mine.heading_rad,
            mine.course_rad,
            mine.speed_mps,
            mine.roll_rad,
            mine.pitch_rad,
        )
        for t, latitude, longitude, height, heading, course, speed, roll, pitch in _rows(*columns):
            text = _sentence(f"GPGGA,{_clock(t)},{_gga(t, latitude, longitude, height, math.nan)}")
            tilts = [f"A,{math.degrees(v):.4f},D,{name}" for v, name in ((roll, "ROLL"), (pitch, "PTCH")) if math.isfinite(v)]
            # OSD and XDR have no time of their own: between two sentences of one time they can only be of that.
            if math.isfinite(heading) or math.isfinite(speed):
                way = f"{_angle(course)},P,{_value(speed, KNOT_MPS)}"
                text += _sentence(f"RAOSD,{_angle(heading)},A,{way},P,,,N")
            if tilts:
                text += _sentence(f"IIXDR,{','.join(tilts)}")
            if tilts or math.isfinite(heading) or math.isfinite(speed):
                date = datetime.date(1970, 1, 1) + datetime.timedelta(days=int(_rounded(t) // _DAY_S))
                place = f"{_latitude(latitude)},{_longitude(longitude)}"
                way = f"{_value(speed, KNOT_MPS)},{_angle(course)},{date:%d%m%y}"
                text += _sentence(f"GPRMC,{_clock(t)},A,{place},{way},,,A")
            yield text

    return mine.time_s, write()


def _fixed_site(plots: Plots, sensors: Sensors | None) -> str:
    """What a GGA sentence says of a radar that stands still, without its time; empty where nothing tells where it is."""
    if sensors is None:
        return ""
    try:
        sensor = next(iter(sensors_of(plots, sensors).values()))
    except SettingsError:
        return ""
    assert sensor.lat_deg is not None
    assert sensor.lon_deg is not None
    height = sensor.ellipsoidal_height_m
    return _gga(0.0, math.radians(sensor.lat_deg), math.radians(sensor.lon_deg), math.nan if height is None else height, math.nan)


class AisPositions(NamedTuple):
    """Position reports to be sent, columns (n,): where a ship's GNSS antenna was, and its motion.

    `sent_s` is when the report goes out, `second` the UTC second that its position is of; a heading that is not available is NaN.
    Class A reports become messages of type 1, those of `class_b` of type 18.
    """

    sent_s: FloatArray
    mmsi: IntArray
    class_b: BoolArray
    latitude_rad: FloatArray
    longitude_rad: FloatArray
    speed_mps: FloatArray
    course_rad: FloatArray
    heading_rad: FloatArray
    second: IntArray
    accurate: BoolArray


class AisStatics(NamedTuple):
    """Static data to be sent, columns (n,): call sign (packed), AIS ship type, and how far the antenna is from each side, metres.

    Class A becomes type 5, class B type 24 in its two parts.
    """

    sent_s: FloatArray
    mmsi: IntArray
    class_b: BoolArray
    callsign: IntArray
    ship_type: IntArray
    bow_m: FloatArray
    stern_m: FloatArray
    port_m: FloatArray
    starboard_m: FloatArray


def write_ais(path: str | Path, positions: AisPositions, statics: AisStatics) -> int:
    """Write AIS messages as a shore station logs them: AIVDM sentences in the order of time, each with a tag block of its time.

    The tag block tells the whole second in which a message came.  As AIS has it, positions are told to 1/10,000 minute, speeds
    to 0.1 kn, courses to 0.1 and headings to 1 degree.  Written as a whole or not at all; returns the number of sentences.
    Raises InputError for the file.
    """
    from pyais import encode_msg
    from pyais.messages import MessageType1, MessageType5, MessageType18, MessageType24PartA, MessageType24PartB

    position = _position_fields(positions)
    names = unpack_callsigns(statics.callsign)
    both = np.concatenate([positions.sent_s, statics.sent_s])
    lines: list[str] = []
    for k in np.argsort(both, kind="stable").tolist():
        messages: list[Any]
        if k < len(positions.sent_s):
            kind = MessageType18 if positions.class_b[k] else MessageType1
            messages = [kind.create(**{name: column[k] for name, column in position.items()})]
        else:
            j = k - len(positions.sent_s)
            fields = {"mmsi": int(statics.mmsi[j]), "callsign": names[j], "ship_type": int(statics.ship_type[j])}
            for side in ("bow", "stern", "port", "starboard"):
                fields[f"to_{side}"] = round(float(getattr(statics, f"{side}_m")[j]))
            if statics.class_b[j]:
                first = MessageType24PartA.create(mmsi=fields["mmsi"], partno=0, shipname=f"{names[j]}")
                messages = [first, MessageType24PartB.create(partno=1, **fields)]
            else:
                messages = [MessageType5.create(shipname=names[j], epfd=1, **fields)]
        tag = f"s:shore,c:{math.floor(both[k])}"
        channel = "AB"[len(lines) % 2]
        for message in messages:
            for sentence in encode_msg(message, sentence_type="VDM", radio_channel=channel, seq_id=len(lines) % 10):
                lines.append(f"\\{tag}*{checksum(tag)}\\{sentence}\r\n")
    with atomic(path) as beside, open(beside, "w", encoding="ascii", newline="") as file:
        file.writelines(lines)
    return len(lines)


def _position_fields(p: AisPositions) -> dict[str, list[Any]]:
    """The fields of position reports in AIS's own units and steps, one list of numbers a field."""

    def steps(values: FloatArray, step: float, absent: float) -> list[Any]:
        return list(np.where(np.isfinite(values), np.rint(values / step) * step, absent).round(9).tolist())

    course = np.rint(np.degrees(p.course_rad) * 10) % 3600 / 10
    heading = np.rint(np.degrees(p.heading_rad)) % 360
    return {
        "mmsi": p.mmsi.tolist(),
        "accuracy": p.accurate.tolist(),
        "lat": steps(np.degrees(p.latitude_rad), 1 / 600000, 91.0),
        "lon": steps((np.degrees(p.longitude_rad) + 180.0) % 360.0 - 180.0, 1 / 600000, 181.0),
        "speed": steps(np.minimum(p.speed_mps / KNOT_MPS, 102.2), 0.1, 102.3),
        "course": np.where(np.isfinite(course), course, 360.0).tolist(),
        "heading": np.where(np.isfinite(heading), heading, 511).astype(np.int64).tolist(),
        "second": p.second.tolist(),
    }
