"""Residuals: what every paired plot is off by, before and after correction.

Before: measured - reference at the plot's stamp.  After: the corrected plot - reference at the corrected stamp, with the errors
of the calibration evaluated at the reference (METHODS section 6), so that terms of heading and length apply wherever the
reference knows them.
"""

# ruff: noqa: RUF009  (columns are declared by a call that returns a dataclass field)

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .._parallel import in_threads, slices
from .._types import AnyArray, FloatArray, IntArray
from ..calibration import Calibration
from ..errors import InputError
from ..geodesy import enu_from_ecef, geodetic_from_ecef, height_and_up, rotate
from ..measure import (
    from_true_north,
    heading_about,
    polar_from_enu,
    polar_motion,
    position_from_height,
    sensors_of,
    site_of,
    wrap_rad,
)
from ..model import Channel, Pairs, Sensor, Sensors, _column, _float, _Table
from ..registration.observe import fill_lengths
from ..terms import TERMS, Geometry, Whose, late_s, order_of, touches

_LEAST_SPEED_MPS = 1.0
# No radar is off by more.
_FARTHEST_M = 1e9
# Rows that are worked on at a time: large enough for NumPy, small enough for the processor's cache.
_CHUNK = 1 << 14


@dataclass(frozen=True, slots=True, eq=False)
class Residuals(_Table):
    """What every paired plot is off by (measured - reference), one row a pair, in the order of the pairs.

    The reference's range, azimuth, elevation are about the sensor at the plot's stamp, height is ellipsoidal; course is NaN below
    1 m/s.  Elevation residuals are NaN where no elevation was measured.  East, north and distance are horizontal at the target,
    with the plot put at the reference's height; along and across (positive to the right) follow the reference's course.  Latitude
    and longitude are those of the reference, and of the plot before and after.
    """

    time_s: FloatArray = _float()
    sensor: AnyArray = _column(np.int32)
    channel: AnyArray = _column(np.int8, 0)
    target: IntArray = _column(np.int64)
    track: IntArray = _column(np.int64)
    plot: IntArray = _column(np.int64)
    weight: FloatArray = _column(np.float64, 1.0)
    reference_range_m: FloatArray = _float()
    reference_azimuth_rad: FloatArray = _float()
    reference_elevation_rad: FloatArray = _float()
    reference_height_m: FloatArray = _float()
    reference_speed_mps: FloatArray = _float()
    reference_course_rad: FloatArray = _float()
    range_before_m: FloatArray = _float()
    range_after_m: FloatArray = _float()
    azimuth_before_rad: FloatArray = _float()
    azimuth_after_rad: FloatArray = _float()
    elevation_before_rad: FloatArray = _float()
    elevation_after_rad: FloatArray = _float()
    east_before_m: FloatArray = _float()
    east_after_m: FloatArray = _float()
    north_before_m: FloatArray = _float()
    north_after_m: FloatArray = _float()
    along_before_m: FloatArray = _float()
    along_after_m: FloatArray = _float()
    across_before_m: FloatArray = _float()
    across_after_m: FloatArray = _float()
    distance_before_m: FloatArray = _float()
    distance_after_m: FloatArray = _float()
    latitude_rad: FloatArray = _float()
    longitude_rad: FloatArray = _float()
    latitude_before_rad: FloatArray = _float()
    longitude_before_rad: FloatArray = _float()
    latitude_after_rad: FloatArray = _float()
    longitude_after_rad: FloatArray = _float()


def residuals(pairs: Pairs, sensors: Sensors, calibration: Calibration) -> Residuals:
    """What every paired plot is off by, before and after the errors of `calibration` are taken away.

    Terms of other sensors or channels than a plot's own do not touch it; a calibration over time is interpolated linearly and
    held beyond its ends.  Lengths of targets are filled in as `register` does; where a term needs a heading or a length that
    nothing tells, it is 0 for that plot.  Raises SettingsError for a sensor without an entry or a position in `sensors`.
    """
    pairs = fill_lengths(pairs)
    # By sensor, so that each piece has one antenna; then back into the order of the pairs.
    groups = [(s, np.flatnonzero(pairs.plots.sensor == key)) for key, s in sensors_of(pairs.plots, sensors).items()]
    pieces = [(sensor, rows[part]) for sensor, rows in groups for part in slices(len(rows), _CHUNK)]
    out = {f.name: np.empty(len(pairs), f.metadata["dtype"]) for f in fields(Residuals)}

    def work(piece: tuple[Sensor, IntArray]) -> None:
        sensor, rows = piece
        for name, column in _residuals(pairs, rows, sensor, calibration).items():
            out[name][rows] = column

    in_threads(work, pieces)
    return Residuals(**out)


def load_residuals(path: str | Path) -> Residuals:
    """Read residuals.parquet, as `calibrate` writes it; stamps are those of the file, to the microsecond.

    Raises InputError where the file cannot be read, or is no table of residuals.
    """
    from ..reading.tables import parquet_columns

    inside = parquet_columns(path)
    out: dict[str, AnyArray] = {}
    for f in fields(Residuals):
        angle = f.name.endswith("_rad")
        outer = f"{f.name[:-4]}_deg" if angle else "time" if f.name == "time_s" else f.name
        if outer not in inside:
            raise InputError(f"has no column {outer!r}", path=path, remedy="Give the residuals.parquet of a calibration.")
        column = inside[outer]
        if f.name == "channel":
            numbers = {channel.name.lower(): channel.value for channel in Channel}
            column = np.array([numbers.get(word, -1) for word in column.tolist()])
            if (column < 0).any():
                raise InputError("has a channel that does not exist", path=path)
        out[f.name] = np.ascontiguousarray(np.radians(column) if angle else column, f.metadata["dtype"])
    read = Residuals(**out)
    for name in ("range_before_m", "range_after_m"):
        largest = float(np.nan_to_num(np.abs(getattr(read, name))).max(initial=0.0))
        if largest > _FARTHEST_M:
            raise InputError(
                f"holds {name} of {largest:.3g} m, which no radar can measure",
                path=path,
                remedy="Leave such plots out, and calibrate again.",
            )
    return read


def _residuals(pairs: Pairs, rows: IntArray, sensor: Sensor, calibration: Calibration) -> dict[str, AnyArray]:
    """The columns of `Residuals` for the pairs at `rows` (n,), all of `sensor`."""
    plots = pairs.plots
    site, rotation = site_of(sensor)
    reference = pairs.position[rows]
    velocity, acceleration = np.nan_to_num(pairs.velocity[rows]), np.nan_to_num(pairs.acceleration[rows])
    time, channel = plots.time_s[rows], plots.channel[rows]
    azimuth = from_true_north(plots.azimuth_rad[rows], sensor)
    measured = np.stack([plots.range_m[rows], azimuth, plots.elevation_rad[rows]], axis=1)
    lat, lon, height = geodetic_from_ecef(reference)
    level = enu_from_ecef(lat, lon)
    over_ground = rotate(level, velocity)
    speed = np.hypot(over_ground[:, 0], over_ground[:, 1])
    course = np.where(speed >= _LEAST_SPEED_MPS, np.arctan2(over_ground[:, 0], over_ground[:, 1]) % (2 * np.pi), np.nan)

    whose = Whose(channel, plots.flags[rows], pairs.source[rows])
    values = [
        (TERMS[key.name], np.interp(time, calibration.epoch_s, calibration.value[:, k]) * touches(key.channel, whose))
        for k, key in enumerate(calibration.terms)
        if key.sensor == sensor.key
    ]
    late = late_s([term for term, _ in values], [value for _, value in values], time - calibration.epoch_s[0])
    moved = reference - late[:, None] * velocity + 0.5 * late[:, None] ** 2 * acceleration
    at_stamp = polar_from_enu(rotate(rotation, reference - site))
    others = [(term, value) for term, value in values if not term.is_time]
    at_true, rate, second, third = polar_motion(
        rotate(rotation, moved - site),
        rotate(rotation, velocity - late[:, None] * acceleration),
        rotate(rotation, acceleration),
        order=order_of([term for term, _ in others]),
    )
    place = Geometry(
        at_true[:, 0], at_true[:, 1], at_true[:, 2], rate, second, third,
        heading_about(pairs.heading_rad[rows], reference, rotation), pairs.length_m[rows], time - calibration.epoch_s[0],
        whose,
    )  # fmt: skip
    corrected = measured.copy()
    for term, value in others:
        corrected -= term.columns(place) * value[:, None]

    columns: dict[str, AnyArray] = {}
    for when, polar, target, position in (
        ("before", measured, at_stamp, reference),
        ("after", corrected, at_true, moved),
    ):
        columns[f"range_{when}_m"] = polar[:, 0] - target[:, 0]
        columns[f"azimuth_{when}_rad"] = wrap_rad(polar[:, 1] - target[:, 1])
        columns[f"elevation_{when}_rad"] = polar[:, 2] - target[:, 2]
        own_height = height if when == "before" else height_and_up(position)[0]
        lies = position_from_height(polar[:, 0], polar[:, 1], own_height, site, rotation)
        east, north, _ = rotate(level, lies - position).T
        columns[f"east_{when}_m"], columns[f"north_{when}_m"] = east, north
        columns[f"along_{when}_m"] = east * np.sin(course) + north * np.cos(course)
        columns[f"across_{when}_m"] = east * np.cos(course) - north * np.sin(course)
        columns[f"distance_{when}_m"] = np.hypot(east, north)
        columns[f"latitude_{when}_rad"], columns[f"longitude_{when}_rad"], _ = geodetic_from_ecef(lies)
    return columns | {
        "time_s": time,
        "sensor": plots.sensor[rows],
        "channel": channel,
        "target": pairs.target[rows],
        "track": pairs.track[rows],
        "plot": pairs.plot[rows],
        "weight": pairs.weight[rows],
        "reference_range_m": at_stamp[:, 0],
        "reference_azimuth_rad": at_stamp[:, 1],
        "reference_elevation_rad": at_stamp[:, 2],
        "reference_height_m": height,
        "reference_speed_mps": speed,
        "reference_course_rad": course,
        "latitude_rad": lat,
        "longitude_rad": lon,
    }
