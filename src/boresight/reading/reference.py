"""References that are neither ASTERIX nor NMEA: RTKLIB solutions, OpenSky state vectors, the Autoferry benchmark."""

from __future__ import annotations

import datetime
import math
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .._types import FloatArray
from ..errors import InputError
from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate, rotate_back
from ..measure import polar_from_position, position_from_plane
from ..model import Damage, Fixes, Platform, Plots, Recording
from .gpstime import WEEK_S, gps_from_week, utc_from_gps
from .lines import fields_of, head_of, header_line, separator_of
from .tables import ColumnMap, read_table, sources_of

# --------------------------------------------------------------------------------------------------------------- RTKLIB

QUALITY = {1: "fixed", 2: "float", 3: "SBAS", 4: "differential", 5: "single", 6: "PPP", 7: "dead reckoning"}
_ROLLOVER_WEEKS = 1024
# RTKLIB is of 2006: an earlier week number has lost its multiples of 1,024.
_FIRST_WEEK = 1356
_LAST_WEEK = 4000
_JST_S = 9 * 3600.0
_CALENDAR = re.compile(r"(\d{4})/(\d{1,2})/(\d{1,2})[\s,;]+(\d{1,2}):(\d{1,2}):(\d{1,2}(?:\.\d*)?)[\s,;]+")
_WEEK = re.compile(r"(\d{1,5})[\s,;]+(-?\d+(?:\.\d*)?)[\s,;]+")
_LAYOUTS = {"latitude(deg)": "deg", "latitude(d'\")": "dms", "x-ecef(m)": "xyz", "e-baseline(m)": "enu"}


class _Header(msgspec.Struct):
    """What the comment lines of a solution tell."""

    system: str = "GPST"
    layout: str = ""
    told: bool = False
    geoid: bool = False
    datum: str = "WGS84"
    reference: tuple[float, ...] = ()
    velocity: bool = False


def looks_like_rtklib(head: bytes) -> bool:
    """Whether a file that begins with `head` is a solution as RTKLIB writes it, with or without its header."""
    text = head[:16384].decode("latin-1").removeprefix("ï»¿")
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        return False
    if any(line.startswith("%") and any(name in line for name in _LAYOUTS) for line in lines):
        return True
    first = lines[0]
    if first.startswith("%"):
        return "RTK" in first or "inp file" in text
    stamp = _CALENDAR.match(first + " ") or _WEEK.match(first + " ")
    if stamp is None:
        return False
    rest = re.split(r"[\s,;]+", first[stamp.end() :].strip())
    return len(rest) >= 11 and all(re.fullmatch(r"-?\d+(\.\d*)?", v) for v in rest)


def read_rtklib(
    path: str | Path, *, date: datetime.date | None = None, source: int = -1, geoid_m: float | None = None
) -> Recording:
    """Read an RTKLIB solution (``.pos``) as the fixes of one target.

    Times are calendar dates or GPS weeks and seconds, of GPS time, UTC or JST as the header says; they become UTC.  Positions
    are latitude and longitude (degrees, or degrees, minutes and seconds), Earth-centred, or east, north and up of the reference
    position in the header; without one they stay Cartesian (`x_m`, `y_m`), about a point that sensors.toml must tell.
    `horizontal_sd_m` is per axis, the root of the mean of the two variances; sd are as the solution states them.  How many
    positions are fixed, float or single is said in the warnings.

    `source` is the id that the fixes get.  Where the header says that heights are above the geoid, they need `geoid_m`, or are
    left out.  A GPS week that has lost a multiple of 1,024 is put right by `date`, a UTC date within nine years of it, and
    named otherwise.  Raises InputError where the file cannot be read, is of another format, or holds no record to read.
    """
    head = head_of(path)
    if not looks_like_rtklib(head):
        raise InputError("this is no RTKLIB solution", path=path, offset=0, remedy="Give a .pos file: positions, not statistics.")
    data = Path(path).read_bytes()
    header, said = _Header(), []
    stamps: list[float] = []
    calendar: list[bool] = []
    rows: list[list[float]] = []
    offsets: list[int] = []
    damaged: list[Damage] = []
    at = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    for raw in data[at:].split(b"\n"):
        offset, at = at, at + len(raw) + 1
        line = raw.decode("latin-1").strip()
        if not line:
            continue
        if line.startswith("%"):
            _header_line(line, header)
            continue
        got = _solution(line, header)
        if isinstance(got, str):
            damaged.append(Damage(offset, got))
            continue
        stamp, dated, values = got
        stamps.append(stamp)
        calendar.append(dated)
        rows.append(values)
        offsets.append(offset)
    if not rows:
        why = damaged[0].why if damaged else "the file holds a header and nothing below it"
        raise InputError(f"no solution could be read: {why}", path=path, offset=damaged[0].offset if damaged else None,
                         remedy="Is the file whole?")  # fmt: skip
    if not header.told:
        said.append("it has no header: GPS time and WGS-84 are assumed")
    time = _solution_times(np.array(stamps), np.array(calendar), header, date, said)
    table = np.array(rows, np.float64)
    fixes = _solution_fixes(time, table, header, source, geoid_m, said)
    quality = table[:, 3].astype(np.int64)
    kinds, counts = np.unique(quality, return_counts=True)
    parts = [f"{n:,} {QUALITY.get(q, 'of unknown kind')} (Q {q})" for q, n in zip(kinds.tolist(), counts.tolist(), strict=True)]
    said.append(f"of {len(table):,} positions {', '.join(parts)}: each carries its own sd")
    back = int(np.count_nonzero(np.diff(time) < 0))
    if back:
        said.append(f"{back:,} records are stamped before the one ahead of them; they were kept in the order of the file")
    return Recording(
        path=str(path),
        plots=Plots(),
        fixes=fixes,
        sources=sources_of([fixes], "RTKLIB"),
        damaged=tuple(damaged),
        warnings=tuple(said),
        by_category={},
        offset=np.array(offsets, np.int64),
    )


def _header_line(line: str, header: _Header) -> None:
    for name, layout in _LAYOUTS.items():
        if name in line:
            header.layout, header.told = layout, True
            header.system = next((s for s in ("GPST", "UTC", "JST") if s in line), "GPST")
            header.velocity = "vn(" in line or "vx(" in line or "ve(" in line
            return
    if "ref pos" in line:
        text = line.partition(":")[2]
        numbers = re.findall(r"-?\d+(?:\.\d*)?", text)
        header.reference = tuple(float(n) for n in numbers)
    datum = re.search(r"(?:height|ecef|baseline)=([^,/)]+)(/geodetic)?", line)
    if datum:
        header.datum = datum[1].strip()
        header.geoid = datum[2] is not None


def _solution(line: str, header: _Header) -> tuple[float, bool, list[float]] | str:
    """Stamp (seconds since 1970 on the file's own calendar), whether it was a date, and nine or more numbers; or what is wrong.

    The numbers are three of position, Q, ns, three sd and three covariances, and three of velocity where the header has them.
    """
    text = line + " "
    match = _CALENDAR.match(text)
    if match:
        year, month, day, hour, minute = (int(v) for v in match.groups()[:5])
        second = float(match[6])
        try:
            midnight = datetime.date(year, month, day).toordinal() - datetime.date(1970, 1, 1).toordinal()
        except ValueError:
            return f"no date: {match[0].strip()!r}"
        if hour > 23 or minute > 59 or second > 60 or year < 1980 or year > 2200:
            return f"no time: {match[0].strip()!r}"
        stamp, dated = midnight * 86400.0 + hour * 3600.0 + minute * 60.0 + second, True
    else:
        match = _WEEK.match(text)
        if match is None:
            return f"no time at its start: {line[:30]!r}"
        week, tow = int(match[1]), float(match[2])
        if not 0 <= tow < WEEK_S:
            return f"{tow:g} s is no second of a week"
        if week > _LAST_WEEK:
            return f"{week} is no GPS week"
        stamp, dated = float(gps_from_week(week, tow)), False
    try:
        values = [float(v) for v in re.split(r"[\s,;]+", text[match.end() :].strip())]
    except ValueError:
        return f"not all of it is numbers: {line[:60]!r}"
    if not header.layout:
        if len(values) >= 3 and 6.2e6 < math.hypot(*values[:3]) < 7e6:
            header.layout = "xyz"
        elif len(values) >= 3 and abs(values[0]) <= 90 and abs(values[1]) <= 360:
            header.layout = "deg"
        else:
            return "without a header it cannot be told what its numbers are"
    if header.layout == "dms":
        if len(values) < 7 or not all(0 <= v < 60.0001 for v in (values[1], values[2], values[4], values[5])):
            return "no degrees, minutes and seconds"
        degrees = []
        # The sign stands at the degrees, and "-0" has one too.
        words = re.split(r"[\s,;]+", text[match.end() :].strip())
        for k in (0, 3):
            size = abs(values[k]) + values[k + 1] / 60 + values[k + 2] / 3600
            degrees.append(-size if words[k].startswith("-") else size)
        values = degrees + values[6:]
    if len(values) < 11:
        return f"{len(values)} numbers, at least 11 are needed"
    if not all(map(math.isfinite, values)):
        return "numbers that are not finite"
    first, second_, third = values[:3]
    if header.layout in ("deg", "dms") and not (abs(first) <= 90 and abs(second_) <= 360 and abs(third) < 1e8):
        return f"{first:g}, {second_:g} is no position"
    if header.layout == "xyz" and not 6.2e6 < math.hypot(first, second_, third) < 1e8:
        return "no Earth-centred position"
    if header.layout == "enu" and math.hypot(first, second_, third) > 2e7:
        return "no baseline on Earth"
    if not 1 <= values[3] <= 9 or values[3] != int(values[3]):
        return f"Q = {values[3]:g} is no quality"
    if min(values[5:8]) < 0:
        return "a negative sd"
    wanted = 13 + (3 if header.velocity else 0)
    values = (values + [math.nan] * wanted)[:wanted]
    return stamp, dated, values


def _solution_times(stamp: FloatArray, dated: Any, header: _Header, date: datetime.date | None, said: list[str]) -> FloatArray:
    """UTC (n,) of stamps on the file's own scale."""
    stamp = stamp.copy()
    rollover = _ROLLOVER_WEEKS * WEEK_S
    early = ~dated & (stamp < float(gps_from_week(_FIRST_WEEK, 0.0)))
    if date is not None:
        middle = (datetime.datetime.combine(date, datetime.time(12), datetime.UTC)).timestamp()
        lost = np.where(dated, 0.0, np.rint((middle - stamp) / rollover))
        if np.any(lost != 0):
            said.append(f"{np.count_nonzero(lost):,} GPS weeks had lost a multiple of 1,024; the date {date} put them right")
        stamp += lost * rollover
    elif early.any():
        week = int((stamp[early][0] - float(gps_from_week(0, 0.0))) // WEEK_S)
        said.append(
            f"GPS week {week} is before RTKLIB was: the week number has lost a multiple of 1,024; give the date of the recording "
            f"to have it put right (week {week + _ROLLOVER_WEEKS} or {week + 2 * _ROLLOVER_WEEKS} may be meant)"
        )
    if header.system == "UTC":
        return stamp
    return stamp - _JST_S if header.system == "JST" else utc_from_gps(stamp)


def _solution_fixes(
    time: FloatArray, table: FloatArray, header: _Header, source: int, geoid_m: float | None, said: list[str]
) -> Fixes:
    n = len(table)
    columns: dict[str, Any] = {
        "time_s": time,
        "source": np.full(n, source),
        "track": np.ones(n, np.int64),
        "record": np.arange(n),
    }
    if header.datum != "WGS84":
        said.append(f"its datum is {header.datum}, not WGS-84: positions may be hundreds of metres off")
    sd = table[:, 5:8]
    covariance = np.zeros((n, 3, 3))
    for k in range(3):
        covariance[:, k, k] = sd[:, k] ** 2
    for column, (i, j) in zip((8, 9, 10), ((0, 1), (1, 2), (2, 0)), strict=True):
        # RTKLIB writes the root of a covariance, with its sign.
        value = np.sign(table[:, column]) * table[:, column] ** 2
        covariance[:, i, j] = covariance[:, j, i] = np.nan_to_num(value)
    velocity = table[:, 13:16] if header.velocity else np.full((n, 3), np.nan)
    if header.layout == "xyz":
        latitude, longitude, height = geodetic_from_ecef(table[:, :3])
        rotation = enu_from_ecef(latitude, longitude)
        local = np.asarray(rotation @ covariance @ np.swapaxes(rotation, 1, 2))
        velocity = rotate(rotation, velocity)
        east2, north2, up2 = local[:, 0, 0], local[:, 1, 1], local[:, 2, 2]
    elif header.layout == "enu":
        east2, north2, up2 = sd[:, 0] ** 2, sd[:, 1] ** 2, sd[:, 2] ** 2
        origin = _reference_of(header)
        if origin is None:
            columns |= {"x_m": table[:, 0], "y_m": table[:, 1]}
            latitude = longitude = height = np.full(n, np.nan)
            said.append("its baselines have no reference position in the header: give it in sensors.toml")
        else:
            at, axes = ecef_from_geodetic(*origin), enu_from_ecef(origin[0], origin[1])
            latitude, longitude, height = geodetic_from_ecef(at + rotate_back(axes, table[:, :3]))
    else:
        latitude, longitude, height = np.radians(table[:, 0]), np.radians(table[:, 1]), table[:, 2]
        north2, east2, up2 = sd[:, 0] ** 2, sd[:, 1] ** 2, sd[:, 2] ** 2
        # Here the velocity is written north, east, up.
        velocity = velocity[:, [1, 0, 2]]
        if header.geoid and geoid_m is None:
            height = np.full(n, np.nan)
            said.append("its heights are above the geoid, not the ellipsoid: they are left out; geoid_m would place them")
        elif header.geoid and geoid_m is not None:
            height = height + geoid_m
    horizontal = np.sqrt(np.maximum(east2 + north2, 0.0) / 2)
    vertical = np.sqrt(np.maximum(up2, 0.0))
    unknown = (horizontal == 0) & (vertical == 0)
    columns |= {
        "latitude_rad": latitude,
        "longitude_rad": np.where(longitude > np.pi, longitude - 2 * np.pi, longitude),
        "height_m": height,
        "velocity_east_mps": velocity[:, 0],
        "velocity_north_mps": velocity[:, 1],
        "velocity_up_mps": velocity[:, 2],
        "horizontal_sd_m": np.where(unknown, np.nan, horizontal),
        "vertical_sd_m": np.where(unknown, np.nan, vertical),
    }
    return Fixes(**columns)


def _reference_of(header: _Header) -> tuple[float, float, float] | None:
    """Latitude, longitude (rad) and height (m) of the base station that the header tells, or None."""
    numbers = header.reference
    if len(numbers) == 3 and math.hypot(*numbers) > 6e6:
        latitude, longitude, height = geodetic_from_ecef(np.array(numbers))
        return float(latitude), float(longitude), float(height)
    if len(numbers) == 3 and abs(numbers[0]) <= 90:
        return math.radians(numbers[0]), math.radians(numbers[1]), numbers[2]
    if len(numbers) == 7:
        places = [math.copysign(abs(numbers[k]) + numbers[k + 1] / 60 + numbers[k + 2] / 3600, numbers[k]) for k in (0, 3)]
        return math.radians(places[0]), math.radians(places[1]), numbers[6]
    return None


# --------------------------------------------------------------------------------------------------------------- OpenSky

# The stamps are a server's clock, of receivers that are not all GPS-synchronised: METHODS.md section 6 takes 0.5 s for such.
OPENSKY_TIME_SD_S = 0.5


def looks_like_opensky(head: bytes) -> bool:
    """Whether a text file that begins with `head` is a table of OpenSky state vectors."""
    line, _ = header_line(head[:16384])
    names = set(fields_of(line, separator_of(line))) if line else set()
    return "icao24" in names and bool(names & {"lastposupdate", "time_position"})


def read_opensky(path: str | Path, columns: ColumnMap | str | Path | None = None) -> Recording:
    """Read OpenSky state vectors (CSV or Parquet) as fixes.

    A row of them is the last state known at its `time`, so a position is stamped when it was last updated (`lastposupdate`,
    `time_position`), and rows that repeat a position already seen are dropped and counted, as are those without a position.
    `velocity` and `heading` (the course) become east and north; `baroaltitude` is the pressure altitude; `geoaltitude` is the
    transponder's GNSS height, which DO-260B makes ellipsoidal (older transponders may send height above the geoid, and nothing
    in the row tells).  `onground` sets Flag.GROUND.  Stamps are a server's: `time_sd_s` is 0.5.

    Raises InputError as `read_table` does.
    """
    recording = read_table(path, columns)
    fixes = recording.fixes
    if not len(fixes):
        raise InputError("no state vectors in it", path=path, remedy="Columns as icao24, lat, lon, lastposupdate are needed.")
    said = list(recording.warnings)
    key = np.stack([fixes.mode_s.astype(np.float64), fixes.time_s], axis=1)
    _, first = np.unique(key, axis=0, return_index=True)
    timed = np.isfinite(fixes.time_s)
    keep = np.zeros(len(fixes), bool)
    keep[first] = True
    keep &= timed
    repeated, untimed = int(np.count_nonzero(~keep & timed)), int(np.count_nonzero(~timed))
    if repeated:
        said.append(f"{repeated:,} of {len(fixes):,} state vectors repeat a position that was not updated; they were dropped")
    if untimed:
        said = [s for s in said if not s.endswith("rows have no time")]
        said.append(f"{untimed:,} state vectors do not tell when their position was updated; they were dropped")
    said.append(f"its stamps are the server's, not GPS time: they are taken as {OPENSKY_TIME_SD_S} s (sd) uncertain")
    fixes = fixes[keep]
    fixes = fixes.replace(time_sd_s=np.full(len(fixes), OPENSKY_TIME_SD_S))
    return Recording(
        path=recording.path,
        plots=recording.plots,
        fixes=fixes,
        sources=sources_of([fixes], "OpenSky"),
        damaged=recording.damaged,
        warnings=tuple(said),
        by_category={},
        offset=recording.offset,
    )


# ------------------------------------------------------------------------------------------------------------- Autoferry

# README of the data set: the local frame "Piren" is north-east-down about this point.
AUTOFERRY_ORIGIN = (math.radians(63.4389029083), math.radians(10.39908278), 39.923)
AUTOFERRY_RADAR = 65536
AUTOFERRY_TRUTH = 65537
# The files tell no accuracy; satellite positions of small boats with their antennas off the hull's centre.
AUTOFERRY_TRUTH_SD_M = 1.0
_RADAR = 2


def looks_like_autoferry(head: bytes) -> bool:
    """Whether a file that begins with `head` is JSON of the Autoferry benchmark: detections or ground truth."""
    text = head[:4096].lstrip(b"\xef\xbb\xbf \t\r\n")
    if not text.startswith(b"["):
        return False
    return (b'"sensorID"' in text and b'"ownshipPosition"' in text) or (b'"targetID"' in text and b'"position"' in text)


def read_autoferry(path: str | Path, *, sensor: int = AUTOFERRY_RADAR, source: int = AUTOFERRY_TRUTH) -> Recording:
    """Read a scenario of the Autoferry benchmark: a marine radar on a moving ferry, and the true tracks of two boats.

    `path` is a detections file (plots and the ferry's positions), a ground-truth file (fixes), or a scenario's folder (both).

    What the fields are, as the data set's README says and the data confirm (radar and truth agree within 7 m in the median so
    read, within 4 m with stamps taken as 2 s late; with axes exchanged or reversed they are 85 m apart or more):

    * `time`: UTC, seconds since 1970.  `ownshipPosition`: (north, east) metres of the local frame "Piren", north-east-down about
      63.4389029083 N 10.39908278 E, 39.923 m.
    * `measurement` of sensorID 2 (the radar): north and east of the own ship, metres, along the axes of the local frame, so the
      ship's heading is already in it.  M detections are two rows of M numbers, all norths and all easts; one detection is
      (north, east); none is empty.  It has no Doppler, height or strength.
    * Ground truth: `position` (north, east, 0) of the local frame, `targetID` 1 or 2.  The list repeats the last known position
      for each detection; only different ones are kept.

    Plots are polar about the own ship at their own stamp: slant range and azimuth from true north, exact on the ellipsoid, at
    sea level (39.923 m).  `Platform` holds the own ship's positions of all sensors' records; the files tell no heading.  Other
    sensors (1 lidar, 3 infrared and 4 daylight camera) are passed over and counted.  `sensor` and `source` are the ids given.

    Raises InputError where a file cannot be read or nothing in it can be used.
    """
    folder = Path(path)
    if folder.is_dir():
        files = sorted([*folder.glob("*_detections.json"), *folder.glob("*_groundTruth.json")])
        if not files:
            raise InputError("it holds no *_detections.json or *_groundTruth.json", path=path, remedy="Give a scenario's folder.")
        parts = [read_autoferry(f, sensor=sensor, source=source) for f in files]
        before = np.cumsum([0, *(r.records for r in parts)])
        plots = Plots.concat([r.plots.replace(record=r.plots.record + b) for r, b in zip(parts, before, strict=False)])
        fixes = Fixes.concat([r.fixes.replace(record=r.fixes.record + b) for r, b in zip(parts, before, strict=False)])
        own = Platform.concat([r.platform.replace(record=r.platform.record + b) for r, b in zip(parts, before, strict=False)])
        hurt, said = [d for r in parts for d in r.damaged], [w for r in parts for w in r.warnings]
        return _autoferry(path, plots, fixes, own, hurt, said, np.concatenate([r.offset for r in parts]))
    head = head_of(path)
    if not looks_like_autoferry(head):
        raise InputError("this is no file of the Autoferry benchmark", path=path, offset=0, remedy="Give detections or truth.")
    records, offset, damaged = _json_records(Path(path).read_bytes())
    if b'"ownshipPosition"' in head[:4096]:
        return _detections(path, records, offset, damaged, sensor)
    return _ground_truth(path, records, offset, damaged, source)


def _json_records(data: bytes) -> tuple[list[Any], list[int], list[Damage]]:
    """The elements of a JSON array with their offsets.  Where one is damaged, reading goes on at the next one."""
    import json

    text = data.decode("utf-8", "replace")
    plain = text.isascii()
    decoder = json.JSONDecoder()
    records: list[Any] = []
    offset: list[int] = []
    damaged: list[Damage] = []
    nested = re.compile(r"\[\s*\[").match(text) is not None
    opener = "[" if nested else "{"
    at = text.find("[") + 1
    while True:
        begin = text.find(opener, at)
        if begin < 0:
            break
        place = begin if plain else len(text[:begin].encode())
        try:
            value, at = decoder.raw_decode(text, begin)
        except (ValueError, RecursionError) as error:
            why = str(error).split(":")[0]
            damaged.append(Damage(place, f"an element that is not JSON ({why})"))
            # A record begins where its first field does.
            following = re.compile(r'\{\s*"(sensorID|targetID)"').search(text, begin + 2 if nested else begin + 1)
            if following is None:
                break
            at = following.start()
            if nested:
                back = text.rfind("[", begin + 1, at)
                at = back if back > 0 and not text[back + 1 : at].strip() else at
                if text[at] != "[":
                    # In the middle of a group: its other half is lost with it.
                    at = following.end()
            continue
        records.append(value)
        offset.append(place)
    return records, offset, damaged


def _numbers(value: Any, count: int) -> list[float] | None:
    """`value` as `count` finite numbers, or None."""
    if not isinstance(value, list) or len(value) < count:
        return None
    out = value[:count]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) and abs(v) < 1e6 for v in out):
        return None
    return [float(v) for v in out]


def _stamp(value: Any) -> float | None:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and 1e9 < value < 7e9
    return float(value) if known else None


def _detections(path: str | Path, records: list[Any], offset: list[int], damaged: list[Damage], sensor: int) -> Recording:
    good: list[int] = []
    own: list[tuple[float, float, float]] = []
    found: list[tuple[int, float, float]] = []
    passed: dict[int, int] = {}
    for record, place in zip(records, offset, strict=True):
        fields_ = record if isinstance(record, dict) else {}
        time, position = _stamp(fields_.get("time")), _numbers(fields_.get("ownshipPosition"), 2)
        identity, measured = fields_.get("sensorID"), fields_.get("measurement")
        if time is None or position is None or not isinstance(identity, int):
            damaged.append(Damage(place, "an element without a time, the own ship's position or the sensor's number"))
            continue
        pairs: list[tuple[float, float]] = []
        if identity == _RADAR:
            rows = _radar_rows(measured)
            if rows is None:
                damaged.append(Damage(place, "a radar's element whose measurement is not two rows of numbers"))
                continue
            pairs = rows
        else:
            passed[identity] = passed.get(identity, 0) + 1
        found += [(len(good), *pair) for pair in pairs]
        good.append(place)
        own.append((time, position[0], position[1]))
    if not good:
        why = damaged[0].why if damaged else "the list is empty"
        raise InputError(f"no detection could be read: {why}", path=path, remedy="Is the file whole?")
    said = []
    if passed:
        others = ", ".join(f"sensor {k} ({n:,})" for k, n in sorted(passed.items()))
        said.append(f"records of {others} were passed over: only the radar, sensor {_RADAR}, measures a polar position")
    ship = np.array(own)
    where = _place(ship[:, 1], ship[:, 2])
    latitude, longitude, height = geodetic_from_ecef(where)
    order = np.argsort(ship[:, 0], kind="stable")
    back = int(np.count_nonzero(np.diff(ship[:, 0]) < 0))
    if back:
        said.append(f"{back:,} records are stamped before the one ahead of them; all were put in the order of time")
    platform = Platform(
        time_s=ship[order, 0], sensor=np.full(len(order), sensor), latitude_rad=latitude[order], longitude_rad=longitude[order],
        height_m=height[order], record=order,
    )  # fmt: skip
    plots = Plots()
    if found:
        measured_ = np.array(found)
        row = measured_[:, 0].astype(np.int64)
        target = _place(ship[row, 1] + measured_[:, 1], ship[row, 2] + measured_[:, 2])
        polar = polar_from_position(target, where[row], enu_from_ecef(latitude[row], longitude[row]))
        plots = Plots(
            time_s=ship[row, 0], sensor=np.full(len(row), sensor), channel=np.full(len(row), 1),
            range_m=polar[:, 0], azimuth_rad=polar[:, 1], record=row,
        )  # fmt: skip
        plots = plots[np.argsort(plots.time_s, kind="stable")]
    return _autoferry(path, plots, Fixes(), platform, damaged, said, np.array(good, np.int64))


def _radar_rows(measured: Any) -> list[tuple[float, float]] | None:
    """(north, east) of each detection, or None where the value is not of that form."""
    if measured == []:
        return []
    if not isinstance(measured, list) or len(measured) != 2:
        return None
    if not isinstance(measured[0], list):
        one = _numbers(measured, 2)
        return None if one is None else [(one[0], one[1])]
    if not isinstance(measured[1], list) or len(measured[0]) != len(measured[1]):
        return None
    north, east = (_numbers(row, len(measured[0])) for row in measured)
    return None if north is None or east is None else list(zip(north, east, strict=True))


def _place(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    """ECEF positions (n, 3) at sea level of north and east in the local frame."""
    latitude, longitude, height = AUTOFERRY_ORIGIN
    origin, axes = ecef_from_geodetic(latitude, longitude, height), enu_from_ecef(latitude, longitude)
    return position_from_plane(east_m, north_m, np.full(len(np.atleast_1d(north_m)), height), origin, axes)


def _ground_truth(path: str | Path, records: list[Any], offset: list[int], damaged: list[Damage], source: int) -> Recording:
    good: list[int] = []
    rows: dict[tuple[int, float], tuple[int, float, float]] = {}
    total = other = 0
    for record, place in zip(records, offset, strict=True):
        inner = record if isinstance(record, list) else [record]
        found: list[tuple[int, float, list[float]]] = []
        for one in inner:
            fields_ = one if isinstance(one, dict) else {}
            time, position, target = _stamp(fields_.get("time")), _numbers(fields_.get("position"), 2), fields_.get("targetID")
            if time is None or position is None or not isinstance(target, int) or not 0 <= target < 2**31:
                found = []
                break
            found.append((target, time, position))
        if not found:
            damaged.append(Damage(place, "an element without the time, position or number of a target"))
            continue
        for target, time, position in found:
            total += 1
            before = rows.setdefault((target, time), (len(good), position[0], position[1]))
            other += before[1:] != tuple(position[:2])
        good.append(place)
    if not rows:
        why = damaged[0].why if damaged else "the list is empty"
        raise InputError(f"no true position could be read: {why}", path=path, remedy="Is the file whole?")
    said = []
    if total > len(rows):
        said.append(f"{total - len(rows):,} of {total:,} true positions repeat one already listed; they were dropped")
    if other:
        said.append(f"{other:,} true positions contradict an earlier one of the same target and time; the earlier was kept")
    keys = sorted(rows)
    table = np.array([rows[k] for k in keys], np.float64)
    latitude, longitude, height = geodetic_from_ecef(_place(table[:, 1], table[:, 2]))
    fixes = Fixes(
        time_s=np.array([t for _, t in keys]), source=np.full(len(keys), source), track=np.array([k for k, _ in keys]),
        latitude_rad=latitude, longitude_rad=longitude, height_m=height, record=table[:, 0].astype(np.int64),
        horizontal_sd_m=np.full(len(keys), AUTOFERRY_TRUTH_SD_M), vertical_sd_m=np.full(len(keys), AUTOFERRY_TRUTH_SD_M),
    )  # fmt: skip
    fixes = fixes[np.argsort(fixes.time_s, kind="stable")]
    return _autoferry(path, Plots(), fixes, Platform(), damaged, said, np.array(good, np.int64))


def _autoferry(
    path: str | Path, plots: Plots, fixes: Fixes, platform: Platform, damaged: list[Damage], said: list[str], offset: Any
) -> Recording:
    return Recording(
        path=str(path),
        plots=plots,
        fixes=fixes,
        sources=sources_of([plots, fixes], "Autoferry"),
        damaged=tuple(damaged),
        warnings=tuple(said),
        by_category={},
        offset=offset,
        platform=platform,
    )
