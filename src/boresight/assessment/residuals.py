"""Residuals: what every paired plot is off by, before and after correction.

Before: measured - reference at the plot's stamp.  After: the corrected plot - reference at the corrected stamp, with the errors
of the calibration evaluated at the reference (METHODS section 6), so that terms of heading and length apply wherever the
reference knows them.
"""

# ruff: noqa: RUF009  (columns are declared by a call that returns a dataclass field)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..calibration import Calibration
from ..geodesy import enu_from_ecef, geodetic_from_ecef, rotate
from ..measure import polar_from_enu, polar_motion, position_from_height, sites, true_azimuth, wrap_rad
from ..model import Channel, Pairs, Sensors, _column, _float, _Table
from ..registration.observe import fill_lengths
from ..terms import TERMS, Geometry

_LEAST_SPEED_MPS = 1.0
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
    return Residuals.concat([_residuals(pairs[k : k + _CHUNK], sensors, calibration) for k in range(0, len(pairs), _CHUNK)])


def _residuals(pairs: Pairs, sensors: Sensors, calibration: Calibration) -> Residuals:
    plots = pairs.plots
    pairs = pairs.replace(velocity=np.nan_to_num(pairs.velocity), acceleration=np.nan_to_num(pairs.acceleration))
    site, rotation = sites(plots, sensors)
    measured = np.stack([plots.range_m, true_azimuth(plots, sensors), plots.elevation_rad], axis=1)
    lat, lon, height = geodetic_from_ecef(pairs.position)
    level = enu_from_ecef(lat, lon)
    velocity = rotate(level, pairs.velocity)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    course = np.where(speed >= _LEAST_SPEED_MPS, np.arctan2(velocity[:, 0], velocity[:, 1]) % (2 * np.pi), np.nan)

    late = _values(pairs, calibration, "time_offset")
    moved = pairs.position - late[:, None] * pairs.velocity + 0.5 * late[:, None] ** 2 * pairs.acceleration
    at_stamp = polar_from_enu(rotate(rotation, pairs.position - site))
    error, at_true = _errors(pairs, calibration, rotate(rotation, moved - site), rotation, late)
    corrected = measured - error

    columns: dict[str, AnyArray] = {}
    for when, polar, target, position in (
        ("before", measured, at_stamp, pairs.position),
        ("after", corrected, at_true, moved),
    ):
        columns[f"range_{when}_m"] = polar[:, 0] - target[:, 0]
        columns[f"azimuth_{when}_rad"] = wrap_rad(polar[:, 1] - target[:, 1])
        columns[f"elevation_{when}_rad"] = polar[:, 2] - target[:, 2]
        own_height = height if when == "before" else geodetic_from_ecef(position)[2]
        lies = position_from_height(polar[:, 0], polar[:, 1], own_height, site, rotation)
        east, north, _ = rotate(level, lies - position).T
        columns[f"east_{when}_m"], columns[f"north_{when}_m"] = east, north
        columns[f"along_{when}_m"] = east * np.sin(course) + north * np.cos(course)
        columns[f"across_{when}_m"] = east * np.cos(course) - north * np.sin(course)
        columns[f"distance_{when}_m"] = np.hypot(east, north)
        columns[f"latitude_{when}_rad"], columns[f"longitude_{when}_rad"], _ = geodetic_from_ecef(lies)
    return Residuals(
        time_s=plots.time_s,
        sensor=plots.sensor,
        channel=plots.channel,
        target=pairs.target,
        track=pairs.track,
        plot=pairs.plot,
        weight=pairs.weight,
        reference_range_m=at_stamp[:, 0],
        reference_azimuth_rad=at_stamp[:, 1],
        reference_elevation_rad=at_stamp[:, 2],
        reference_height_m=height,
        reference_speed_mps=speed,
        reference_course_rad=course,
        latitude_rad=lat,
        longitude_rad=lon,
        **columns,
    )


def _touches(pairs: Pairs, sensor: int, channel: str) -> BoolArray:
    """The pairs (n,) that a term of this sensor and channel applies to."""
    rows: BoolArray = pairs.plots.sensor == sensor
    if channel != "all":
        wanted = [c.value for c in Channel if c.name.lower() == channel.lower()]
        rows &= np.isin(pairs.plots.channel, wanted)
    return rows


def _values(pairs: Pairs, calibration: Calibration, name: str) -> FloatArray:
    """The value (n,), SI, of the term `name` at each pair; 0 where the calibration has none."""
    out = np.zeros(len(pairs))
    for k, key in enumerate(calibration.terms):
        if key.name == name:
            rows = _touches(pairs, key.sensor, key.channel)
            out[rows] += np.interp(pairs.plots.time_s[rows], calibration.epoch_s, calibration.value[:, k])
    return out


def _errors(
    pairs: Pairs, calibration: Calibration, enu: FloatArray, rotation: FloatArray, late: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The calibration's errors (n, 3) but for the time offset, and the polar position (n, 3), of targets at `enu` (n, 3)."""
    acceleration = rotate(rotation, pairs.acceleration)
    velocity = rotate(rotation, pairs.velocity) - late[:, None] * acceleration
    polar, rate, second, third = polar_motion(enu, velocity, acceleration)
    geometry = Geometry(
        polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, pairs.heading_rad, pairs.length_m,
        pairs.plots.time_s - calibration.epoch_s[0],
    )  # fmt: skip
    error = np.zeros((len(pairs), 3))
    for k, key in enumerate(calibration.terms):
        if key.name == "time_offset":
            continue
        rows = _touches(pairs, key.sensor, key.channel)
        if not rows.any():
            continue
        own = geometry if rows.all() else Geometry(*(column[rows] for column in geometry))
        value = np.interp(pairs.plots.time_s[rows], calibration.epoch_s, calibration.value[:, k])
        error[rows] += TERMS[key.name].columns(own) * value[:, None]
    return error, polar
