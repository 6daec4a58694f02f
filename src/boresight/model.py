"""The tables that pass between the steps: plots, fixes, pairs, and the sensors that they belong to.

Every table is a frozen structure of arrays of one length.  Inside, everything is SI and radians; angles are clockwise from
true north; `time_s` is UTC seconds since 1970.  What is absent is NaN, or -1 for integers.  A callsign is packed, six bits
a character, into one int64 (`pack_callsigns`).  Plots carry the intrinsic `sensor` id (``sac << 8 | sic``), so tables
of several recordings can be joined without renumbering.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from ._types import AnyArray, FloatArray, IntArray
from .errors import InputError, SettingsError


class Channel(IntEnum):
    """Which chain measured a plot's position.  The position of a combined plot is the secondary radar's."""

    UNKNOWN = 0
    PSR = 1
    SSR = 2
    MODE_S = 3
    SSR_PSR = 4
    MODE_S_PSR = 5
    MLAT = 6
    ADS_B = 7


class Flag(IntFlag):
    """What a record says of its own quality.  A plot with any flag of `EXCLUDED` takes no part in a registration.

    `FROM_BOW`: the record's bearing was relative to the bow, and own ship's heading was added where it was read.
    """

    SIMULATED = 1
    TEST = 2
    GARBLED = 4
    REFLECTION = 8
    SIDE_LOBE = 16
    SECOND_TIME = 32
    FIELD_MONITOR = 64
    GROUND = 128
    EXTRAPOLATED = 256
    TRACK_END = 512
    VEHICLE = 1024
    TIME_OF_RECEPTION = 2048
    ACQUIRING = 4096
    MAGNETIC_NORTH = 8192
    CHAIN_2 = 16384
    FROM_BOW = 32768


EXCLUDED = (
    Flag.SIMULATED
    | Flag.TEST
    | Flag.GARBLED
    | Flag.REFLECTION
    | Flag.SIDE_LOBE
    | Flag.SECOND_TIME
    | Flag.FIELD_MONITOR
    | Flag.EXTRAPOLATED
)

_ABSENT: dict[str, Any] = {"f": np.nan, "i": -1, "u": 0}


def _column(dtype: Any, absent: float | None = None, shape: tuple[int, ...] = ()) -> Any:
    """A column of `dtype`; where a constructor does not name it, it is filled with `absent` (NaN, -1 or no flags)."""
    kind = np.dtype(dtype)
    fill = _ABSENT[kind.kind] if absent is None else absent
    return field(default=None, metadata={"dtype": kind, "absent": fill, "shape": shape})


def _float(*shape: int) -> Any:
    return _column(np.float64, shape=shape)


class _Table:
    """What all tables share.  Subclasses are frozen dataclasses whose fields are columns, or tables of the same length."""

    __slots__ = ()

    def __post_init__(self) -> None:
        given = [getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None]  # type: ignore[arg-type]
        n = len(given[0]) if given else 0
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if "table" in f.metadata:
                value = f.metadata["table"]() if value is None else value
            else:
                shape = (n, *f.metadata["shape"])
                if value is None:
                    value = np.full(shape, f.metadata["absent"], f.metadata["dtype"])
                else:
                    value = np.ascontiguousarray(value, f.metadata["dtype"])
            if len(value) != n or ("table" not in f.metadata and value.shape != (n, *f.metadata["shape"])):
                raise InputError(
                    f"{type(self).__name__}.{f.name} has the shape {np.shape(value)}, but {(n, *f.metadata.get('shape', ()))} "
                    "is needed: every column of a table has one row a record"
                )
            object.__setattr__(self, f.name, value)

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def __getitem__(self, rows: AnyArray | slice) -> Self:
        """The rows of a boolean mask, an index array or a slice, as a new table."""
        if isinstance(rows, int | np.integer):
            raise TypeError(f"{type(self).__name__}[{rows}] would be a row; ask for a column, or for a slice of rows")
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})  # type: ignore[arg-type]

    def take(self, index: IntArray) -> Self:
        """The rows at `index` (n,), in that order."""
        return self[np.asarray(index, np.int64)]

    def replace(self, **columns: Any) -> Self:
        """The same table with some columns exchanged."""
        return type(self)(**({f.name: getattr(self, f.name) for f in fields(self)} | columns))  # type: ignore[arg-type]

    @classmethod
    def concat(cls, tables: Sequence[Self]) -> Self:
        """The tables one behind the other."""
        if not tables:
            return cls()
        if len(tables) == 1:
            return tables[0]
        columns: dict[str, Any] = {}
        for f in fields(cls):  # type: ignore[arg-type]
            parts = [getattr(t, f.name) for t in tables]
            columns[f.name] = f.metadata["table"].concat(parts) if "table" in f.metadata else np.concatenate(parts)
        return cls(**columns)

    def to_frame(self, library: str | None = None) -> Any:
        """The table as a polars (or else pandas) data frame; `library` names one of the two.

        Raises ImportError where neither is installed.
        """
        columns: dict[str, AnyArray] = {}
        for name, value in self._flat():
            columns[name] = value
        for candidate in [library] if library else ["polars", "pandas"]:
            try:
                module = __import__(candidate)
            except ImportError:
                continue
            return module.DataFrame(columns)
        raise ImportError("to_frame needs polars or pandas: pip install polars")

    def _flat(self) -> Iterator[tuple[str, AnyArray]]:
        """Names and one-dimensional columns: (n, 3) columns become name_0, name_1, name_2; inner tables are prefixed."""
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if isinstance(value, _Table):
                for name, column in value._flat():
                    yield f"{f.name}_{name}", column
            elif value.ndim == 1:
                yield f.name, value
            else:
                flat = value.reshape(len(value), -1)
                for k in range(flat.shape[1]):
                    yield f"{f.name}_{k}", flat[:, k]

    @classmethod
    def from_frame(cls, frame: Any) -> Self:
        """A table from a polars or pandas frame, or a dict of arrays, with this table's column names.

        Unknown columns raise InputError and name the columns that exist; missing ones are absent.
        """
        names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        given = list(frame) if isinstance(frame, dict) else list(frame.columns)
        columns: dict[str, Any] = {}
        flat: dict[str, dict[int, Any]] = {}
        for name in given:
            values = np.asarray(frame[name])
            stem, _, number = name.rpartition("_")
            if name in names:
                columns[name] = values
            elif stem in names and number.isdigit():
                flat.setdefault(stem, {})[int(number)] = values
            else:
                raise InputError(f"{cls.__name__} has no column {name!r}; it has: {', '.join(names)}")
        for f in fields(cls):  # type: ignore[arg-type]
            if f.name in flat:
                parts = np.stack([flat[f.name][k] for k in sorted(flat[f.name])], axis=1)
                columns[f.name] = parts.reshape(len(parts), *f.metadata["shape"])
        return cls(**columns)


@dataclass(frozen=True, slots=True, eq=False)
class Plots(_Table):
    """What radars measured, one row a plot: polar, about the antenna.

    `record` is the number of the record in its file.  `heading_rad` is the orientation or course that the record carries.
    The sd columns are the plot's own, where a record gives them.
    """

    time_s: FloatArray = _float()
    sensor: AnyArray = _column(np.int32)
    channel: AnyArray = _column(np.int8, 0)
    range_m: FloatArray = _float()
    azimuth_rad: FloatArray = _float()
    elevation_rad: FloatArray = _float()
    height_m: FloatArray = _float()
    pressure_altitude_m: FloatArray = _float()
    mode_s: AnyArray = _column(np.int32)
    mode_3a: AnyArray = _column(np.int16)
    callsign: IntArray = _column(np.int64)
    mmsi: AnyArray = _column(np.int32)
    track: AnyArray = _column(np.int32)
    psr_ssr_range_m: FloatArray = _float()
    psr_ssr_azimuth_rad: FloatArray = _float()
    length_m: FloatArray = _float()
    width_m: FloatArray = _float()
    heading_rad: FloatArray = _float()
    speed_mps: FloatArray = _float()
    flags: AnyArray = _column(np.uint32)
    range_sd_m: FloatArray = _float()
    azimuth_sd_rad: FloatArray = _float()
    elevation_sd_rad: FloatArray = _float()
    record: IntArray = _column(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Fixes(_Table):
    """Positions of targets from a reference, one row a report.

    A position is geodetic (WGS-84, `height_m` ellipsoidal), or Cartesian (`x_m` east, `y_m` north of the source's own reference
    point, until `alignment.locate` has made it geodetic).  `heading_rad` is a heading that the record carries, not the course.
    The sd are per axis; `time_sd_s` is what is not known of the stamp.
    """

    time_s: FloatArray = _float()
    source: AnyArray = _column(np.int32)
    channel: AnyArray = _column(np.int8, 0)
    latitude_rad: FloatArray = _float()
    longitude_rad: FloatArray = _float()
    height_m: FloatArray = _float()
    pressure_altitude_m: FloatArray = _float()
    x_m: FloatArray = _float()
    y_m: FloatArray = _float()
    velocity_east_mps: FloatArray = _float()
    velocity_north_mps: FloatArray = _float()
    velocity_up_mps: FloatArray = _float()
    heading_rad: FloatArray = _float()
    mode_s: AnyArray = _column(np.int32)
    mode_3a: AnyArray = _column(np.int16)
    callsign: IntArray = _column(np.int64)
    mmsi: AnyArray = _column(np.int32)
    track: AnyArray = _column(np.int32)
    length_m: FloatArray = _float()
    width_m: FloatArray = _float()
    horizontal_sd_m: FloatArray = _float()
    vertical_sd_m: FloatArray = _float()
    time_sd_s: FloatArray = _float()
    flags: AnyArray = _column(np.uint32)
    record: IntArray = _column(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(_Table):
    """States of tracked targets, one row an update: what a tracker says, not what a sensor measured.

    `source` is the system that tracks, `track` its number for the target.  Positions are geodetic (WGS-84), velocities local; the
    sd are per axis.  `age_s` is the time since the last measurement that went in.  `x_m` and `y_m` are the Cartesian position in
    the system's own plane, where a record has one.
    """

    time_s: FloatArray = _float()
    source: AnyArray = _column(np.int32)
    track: AnyArray = _column(np.int32)
    latitude_rad: FloatArray = _float()
    longitude_rad: FloatArray = _float()
    height_m: FloatArray = _float()
    pressure_altitude_m: FloatArray = _float()
    velocity_east_mps: FloatArray = _float()
    velocity_north_mps: FloatArray = _float()
    velocity_up_mps: FloatArray = _float()
    acceleration_east_mps2: FloatArray = _float()
    acceleration_north_mps2: FloatArray = _float()
    mode_s: AnyArray = _column(np.int32)
    mode_3a: AnyArray = _column(np.int16)
    callsign: IntArray = _column(np.int64)
    mmsi: AnyArray = _column(np.int32)
    length_m: FloatArray = _float()
    width_m: FloatArray = _float()
    heading_rad: FloatArray = _float()
    horizontal_sd_m: FloatArray = _float()
    vertical_sd_m: FloatArray = _float()
    age_s: FloatArray = _float()
    flags: AnyArray = _column(np.uint32)
    record: IntArray = _column(np.int64)
    x_m: FloatArray = _float()
    y_m: FloatArray = _float()


@dataclass(frozen=True, slots=True, eq=False)
class Marks(_Table):
    """Marks of an antenna's turn, one row a message: `azimuth_rad` is where it pointed at `time_s` (north, south or a sector).

    `period_s` is the period of rotation where the message tells it.
    """

    time_s: FloatArray = _float()
    sensor: AnyArray = _column(np.int32)
    azimuth_rad: FloatArray = _float()
    period_s: FloatArray = _float()
    record: IntArray = _column(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Platform(_Table):
    """Where a moving radar's platform was, one row a report: own ship.

    The position is the platform's reference point; `heading_rad` is true, `roll_rad` positive to starboard, `pitch_rad` bow up.
    """

    time_s: FloatArray = _float()
    sensor: AnyArray = _column(np.int32)
    latitude_rad: FloatArray = _float()
    longitude_rad: FloatArray = _float()
    height_m: FloatArray = _float()
    heading_rad: FloatArray = _float()
    roll_rad: FloatArray = _float()
    pitch_rad: FloatArray = _float()
    speed_mps: FloatArray = _float()
    course_rad: FloatArray = _float()
    record: IntArray = _column(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Pairs(_Table):
    """Plots with the reference at each plot's own stamp.

    `plots` are the paired plots themselves, `plot` their row in the table that was associated.  `target` is the row number of the
    reference's target, `track` that of the radar's track (both only names: equal means the same).  Positions are ECEF metres
    (n, 3), velocities and accelerations likewise; `covariance` (n, 3, 3) is the reference's position, with what interpolation
    adds.  `heading_rad` is where the target points (carried, else its course above 3 m/s, else NaN), `source` the id of the
    reference that answered.
    """

    plot: IntArray = _column(np.int64)
    plots: Plots = field(default=None, metadata={"table": Plots})  # type: ignore[assignment]
    target: IntArray = _column(np.int64)
    track: IntArray = _column(np.int64)
    position: FloatArray = _float(3)
    velocity: FloatArray = _float(3)
    acceleration: FloatArray = _float(3)
    covariance: FloatArray = _float(3, 3)
    heading_rad: FloatArray = _float()
    length_m: FloatArray = _float()
    weight: FloatArray = _column(np.float64, 1.0)
    source: AnyArray = _column(np.int32)


class Damage(msgspec.Struct, frozen=True):
    """One place of a file that could not be read."""

    offset: int
    why: str


class Source(msgspec.Struct, frozen=True, kw_only=True):
    """What one SAC/SIC sent in one category.  `start` and `end` are UTC seconds; a position is what the stream itself says.

    `notes` are facts that it tells of itself or of its sensors, in words.
    """

    sac: int
    sic: int
    category: int
    edition: str
    records: int
    plots: int
    start_s: float
    end_s: float
    targets: int
    latitude_rad: float = float("nan")
    longitude_rad: float = float("nan")
    height_m: float = float("nan")
    notes: tuple[str, ...] = ()

    @property
    def id(self) -> int:
        """The intrinsic sensor id."""
        return self.sac << 8 | self.sic


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What a file held: tables, who sent it, and what was wrong with it.

    `offset` (records,) is the byte offset of each record, `by_category` the number of records of each.  `receive_s` (records,) is
    when each was received (UTC seconds), where the recording tells (else it is empty); `marks` are the antenna's north and
    sector marks.  `passed_over` counts the records with ASTERIX fields that are skipped by their length ("021 RE").
    """

    path: str
    plots: Plots
    fixes: Fixes
    sources: tuple[Source, ...]
    damaged: tuple[Damage, ...]
    warnings: tuple[str, ...]
    by_category: dict[int, int]
    offset: IntArray
    tracks: Tracks = field(default_factory=Tracks)
    platform: Platform = field(default_factory=Platform)
    marks: Marks = field(default_factory=Marks)
    receive_s: FloatArray = field(default_factory=lambda: np.empty(0))
    passed_over: dict[str, int] = field(default_factory=dict)

    @property
    def records(self) -> int:
        """The number of records that were read."""
        return len(self.offset)


KINDS = ("psr", "ssr", "combined", "mode_s", "surface", "marine", "mlat", "adsb", "ais", "system")
# What azimuths are measured from: true north about the vertical, the bow about the vertical, the bow in the plane of the deck.
ANGLES = ("north", "bow", "deck")


class Sensor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One radar or reference station, as `sensors.toml` tells of it.  `height_m` is the ellipsoidal height of the phase centre.

    Heights above mean sea level are given as `height_msl_m` with `geoid_m`.  `time_offset_s` is taken from every stamp before
    anything else (positive where the stamps are late).  `ground_height_m` is the ellipsoidal height of targets on the ground.
    On a ship, `lever_arm_m` is where the phase centre is from own ship's reference point, forward, starboard and up, and `angles`
    (one of `ANGLES`) what azimuths and elevations are measured from.
    """

    name: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    height_m: float | None = None
    height_msl_m: float | None = None
    geoid_m: float | None = None
    ground_height_m: float | None = None
    sac: int | None = None
    sic: int | None = None
    id: int | None = None
    kind: str = "combined"
    model: str | list[str] | None = None
    north: str = "true"
    north_offset_deg: float = 0.0
    scan_s: float | None = None
    range_sd_m: float | None = None
    azimuth_sd_deg: float | None = None
    elevation_sd_deg: float | None = None
    min_range_m: float = 0.0
    max_range_m: float | None = None
    time_offset_s: float = 0.0
    lever_arm_m: tuple[float, float, float] | None = None
    angles: str = "north"

    @property
    def key(self) -> int:
        """The id that plots carry: ``sac << 8 | sic``, else the given `id`."""
        if self.sac is not None and self.sic is not None:
            return self.sac << 8 | self.sic
        return -1 if self.id is None else self.id

    @property
    def ellipsoidal_height_m(self) -> float | None:
        """The height of the phase centre above the ellipsoid, or None where nothing tells."""
        if self.height_m is not None:
            return self.height_m
        return None if self.height_msl_m is None else self.height_msl_m + (self.geoid_m or 0.0)


class Atmosphere(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What an operator knows of the air, ``[atmosphere]`` in `sensors.toml`: for pressure altitudes where no traffic tells more.

    `qnh_hpa` is the pressure reduced to mean sea level, `isa_deviation_k` how much warmer the air is than the standard
    atmosphere, `geoid_m` how high mean sea level lies above the ellipsoid.  What is not known is left out.
    """

    qnh_hpa: float | None = None
    isa_deviation_k: float | None = None
    geoid_m: float | None = None


class Sensors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The sensors of `sensors.toml`, in its order, and what it tells of the atmosphere."""

    sensor: tuple[Sensor, ...]
    atmosphere: Atmosphere | None = None

    def __iter__(self) -> Iterator[Sensor]:
        return iter(self.sensor)

    def __len__(self) -> int:
        return len(self.sensor)

    def find(self, key: int) -> Sensor | None:
        """The sensor with the id `key`, or None."""
        return next((s for s in self.sensor if s.key == key), None)


def load_sensors(path: str | Path) -> Sensors:
    """Read `sensors.toml`.

    Raises SettingsError with the file, the table and the remedy for a missing file, TOML that is not TOML, an unknown or
    impossible value, two sensors of one name or id.
    """
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"cannot be read ({error.strerror})", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        remedy = "Each sensor is a table headed [[sensor]]."
        raise SettingsError(f"is not TOML: {error}", where=str(path), remedy=remedy) from error
    try:
        sensors = msgspec.convert(data, Sensors)
    except msgspec.ValidationError as error:
        raise SettingsError(str(error), where=str(path), remedy=f"Known keys: {', '.join(Sensor.__struct_fields__)}.") from error
    check_sensors(sensors, where=str(path))
    return sensors


def check_sensors(sensors: Sensors, where: str = "sensors") -> None:
    """Raise SettingsError for impossible positions, unknown kinds, and names or ids that occur twice."""
    air = sensors.atmosphere
    if air is not None:
        for name, low, high in (("qnh_hpa", 850.0, 1100.0), ("isa_deviation_k", -60.0, 60.0), ("geoid_m", -120.0, 120.0)):
            value = getattr(air, name)
            if value is not None and not low <= value <= high:
                raise SettingsError(f"{name} = {value} is not within {low:g} … {high:g}", where=f"{where}: atmosphere")
    names: set[str] = set()
    keys: set[int] = set()
    for number, s in enumerate(sensors):
        place = f"{where}: sensor {number + 1} ({s.name!r})"
        if s.lat_deg is not None and not abs(s.lat_deg) <= 90:
            raise SettingsError(f"lat_deg = {s.lat_deg} is not within -90 … 90", where=place)
        if s.lon_deg is not None and not abs(s.lon_deg) <= 360:
            raise SettingsError(f"lon_deg = {s.lon_deg} is not within -360 … 360", where=place)
        if s.kind not in KINDS:
            raise SettingsError(f"kind = {s.kind!r} is unknown", where=place, remedy=f"Known kinds: {', '.join(KINDS)}.")
        if s.north not in ("true", "magnetic", "grid"):
            raise SettingsError(f"north = {s.north!r} is unknown", where=place, remedy="Known: true, magnetic, grid.")
        if s.angles not in ANGLES:
            raise SettingsError(f"angles = {s.angles!r} is unknown", where=place, remedy=f"Known: {', '.join(ANGLES)}.")
        if s.lever_arm_m is not None and not all(abs(v) <= 1000 for v in s.lever_arm_m):
            remedy = "Give [forward, starboard, up] in metres."
            raise SettingsError(f"lever_arm_m = {list(s.lever_arm_m)} is not within 1,000 m", where=place, remedy=remedy)
        for name in ("range_sd_m", "azimuth_sd_deg", "elevation_sd_deg", "scan_s", "max_range_m"):
            value = getattr(s, name)
            if value is not None and not value > 0:
                raise SettingsError(f"{name} = {value} must be positive", where=place)
        heights = ("height_m", "height_msl_m", "geoid_m", "ground_height_m")
        for name in (*heights, "north_offset_deg", "time_offset_s", "min_range_m"):
            value = getattr(s, name)
            if value is not None and not math.isfinite(value):
                raise SettingsError(f"{name} = {value} is not a number", where=place)
        for name in ("sac", "sic"):
            value = getattr(s, name)
            if value is not None and not 0 <= value <= 255:
                raise SettingsError(f"{name} = {value} is not within 0 … 255", where=place)
        if s.key < 0:
            remedy = "Give sac and sic, or id = 65536 or more."
            raise SettingsError("has neither sac and sic nor an id", where=place, remedy=remedy)
        if s.name in names or s.key in keys:
            raise SettingsError("its name or its sac/sic was used before", where=place, remedy="Each sensor has its own.")
        names.add(s.name)
        keys.add(s.key)


# The six-bit alphabet of ICAO Annex 10; what it leaves undefined reads as "?".
_ALPHABET = "?ABCDEFGHIJKLMNOPQRSTUVWXYZ????? ???????????????0123456789??????"


def pack_callsigns(names: Sequence[str]) -> IntArray:
    """Callsigns as int64 (n,), eight characters of six bits (ICAO Annex 10); empty names give -1."""
    codes = {c: i for i, c in enumerate(_ALPHABET) if c != "?"}
    out = np.full(len(names), -1, np.int64)
    for k, name in enumerate(names):
        if name.strip():
            value = 0
            for c in name.upper()[:8].ljust(8):
                value = value << 6 | codes.get(c, 32)
            out[k] = value
    return out


def unpack_callsigns(packed: IntArray) -> list[str]:
    """The names behind `pack_callsigns`, without trailing blanks; -1 gives an empty name."""
    return ["" if v < 0 else "".join(_ALPHABET[int(v) >> s & 63] for s in range(42, -1, -6)).rstrip() for v in packed]
