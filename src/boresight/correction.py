"""Correction: plots without the systematic errors that a calibration found."""

from __future__ import annotations

import logging

import numpy as np

from ._types import BoolArray, FloatArray
from .calibration import Calibration
from .errors import InputError
from .model import Channel, Plots, Sensors
from .terms import DEG, TERMS, Geometry

log = logging.getLogger(__name__)

_EARTH_M = 6371e3
_TOLERANCE_M = 1e-4
_STEPS = 50


def correct(plots: Plots, calibration: Calibration, *, sensors: Sensors | None = None) -> Plots:
    """The plots without the errors of the calibration.

    The model is inverted by fixed point to 1 mm: each error is evaluated at the corrected position, not at the measured one.  A
    time offset is taken from the stamps.  Terms of heading and length are applied only to plots that carry a heading (and a
    length, else the median of their track's); how many went without is logged, and returned by `correct_and_say`.  A plot's sd
    grow by what the calibration itself does not know of the other terms; where a plot has none, the sensor's estimated noise
    takes its place.

    `sensors` gives antenna heights and north references; without it heights are counted from the ellipsoid and the azimuths are
    taken as true.  Corrected azimuths stay in the sensor's own north reference.  Plots of sensors without a calibration are
    left as they are.  Raises InputError where the calibration has no sensor of these plots.
    """
    corrected, said = correct_and_say(plots, calibration, sensors=sensors)
    for text in said:
        log.warning(text)
    return corrected


def correct_and_say(plots: Plots, calibration: Calibration, *, sensors: Sensors | None = None) -> tuple[Plots, tuple[str, ...]]:
    """`correct`, with what must be said of it: which plots were left as they are, and to which a term could not be applied."""
    said: list[str] = []
    keys, counts = np.unique(plots.sensor, return_counts=True)
    summaries = {s.sensor: s for s in calibration.sensors}
    calibrated = {key.sensor for key in calibration.terms}
    if len(plots) and not calibrated & set(keys.tolist()):
        there = ", ".join(_place(int(k)) for k in keys)
        known = ", ".join(f"{s.name} ({_place(s.sensor)})" for s in calibration.sensors) or "none"
        raise InputError(
            f"the calibration has no sensor of these plots: they are of SAC/SIC {there}, it is of {known}",
            remedy="Give the calibration that was made with this radar.",
        )
    for key, count in zip(keys.tolist(), counts.tolist(), strict=True):
        if key not in calibrated:
            said.append(f"{count:,} plots of SAC/SIC {_place(key)} were left as they are: the calibration has no such sensor")
    columns = {
        name: getattr(plots, name).copy()
        for name in ("time_s", "range_m", "azimuth_rad", "elevation_rad", "range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")
    }
    length = _track_lengths(plots)
    for key in sorted(calibrated):
        mine = plots.sensor == key
        groups = {k.channel for k in calibration.terms if k.sensor == key}
        # Plots of different channels may have different terms: each plot is corrected once, with all that touch it.
        for rows in _by_terms(plots, calibration, key, mine, groups):
            name = summaries[key].name if key in summaries else _place(key)
            _correct_rows(plots, calibration, sensors, key, name, rows, length, columns, said)
    columns["azimuth_rad"] = np.where(
        np.isfinite(columns["azimuth_rad"]), np.mod(columns["azimuth_rad"], 2 * np.pi), columns["azimuth_rad"]
    )
    untouched = ~np.isin(plots.sensor, list(calibrated))
    columns["azimuth_rad"][untouched] = plots.azimuth_rad[untouched]
    return plots.replace(**columns), tuple(said)


def _place(key: int) -> str:
    return f"{key >> 8}/{key & 255}" if 0 <= key < 65536 else f"id {key}"


def _touches(plots: Plots, channel: str) -> BoolArray:
    if channel == "all":
        return np.ones(len(plots), bool)
    return np.isin(plots.channel, [c.value for c in Channel if c.name.lower() == channel.lower()])


def _by_terms(
    plots: Plots, calibration: Calibration, sensor: int, mine: BoolArray, channels: set[str]
) -> list[tuple[BoolArray, list[int]]]:
    """The sensor's plots in groups that the same terms touch: (rows (n,), indices of the terms)."""
    signature = np.zeros(len(plots), np.int64)
    names = sorted(channels)
    for bit, channel in enumerate(names):
        signature |= np.where(_touches(plots, channel), 1 << bit, 0)
    out = []
    for value in np.unique(signature[mine]).tolist():
        active = {name for bit, name in enumerate(names) if value >> bit & 1}
        terms = [k for k, key in enumerate(calibration.terms) if key.sensor == sensor and key.channel in active]
        if terms:
            out.append((mine & (signature == value), terms))
    return out


def _track_lengths(plots: Plots) -> FloatArray:
    """Each plot's length (n,), else the median of its track's, else NaN."""
    length = plots.length_m.copy()
    missing = ~np.isfinite(length) & (plots.track >= 0)
    if not missing.any() or not np.isfinite(length).any():
        return length
    key = plots.sensor.astype(np.int64) << 32 | np.maximum(plots.track, 0).astype(np.int64)
    known = np.isfinite(length) & (plots.track >= 0)
    for one in np.unique(key[missing]):
        track = key == one
        if (known & track).any():
            length[track & missing] = np.median(length[known & track])
    return length


def _correct_rows(
    plots: Plots,
    calibration: Calibration,
    sensors: Sensors | None,
    sensor: int,
    name: str,
    group: tuple[BoolArray, list[int]],
    length: FloatArray,
    columns: dict[str, FloatArray],
    said: list[str],
) -> None:
    rows, terms = group
    time = plots.time_s[rows]
    entry = sensors.find(sensor) if sensors is not None else None
    site_height = (entry.ellipsoidal_height_m or 0.0) if entry is not None else 0.0
    north = entry.north_offset_deg * DEG if entry is not None else 0.0
    # A calibration over time: linear between its epochs, held beyond them.
    values = {k: np.interp(time, calibration.epoch_s, calibration.value[:, k]) for k in terms}
    nearest = (
        np.abs(time[:, None] - calibration.epoch_s).argmin(axis=1)
        if len(calibration.epoch_s) > 1
        else np.zeros(len(time), np.int64)
    )
    heading, own_length = plots.heading_rad[rows], length[rows]
    if entry is not None and entry.lat_deg is not None:
        # A carried heading is from the north where the target is (the convergence of the meridians on a sphere is enough).
        east = plots.range_m[rows] * np.sin(plots.azimuth_rad[rows] + north)
        heading = heading - east / _EARTH_M * np.tan(entry.lat_deg * DEG)
    polar = []
    for k in terms:
        term = TERMS[calibration.terms[k].name]
        if term.name == "time_offset":
            columns["time_s"][rows] -= values[k]
            continue
        polar.append(k)
        lacking = np.zeros(len(time), bool)
        if "heading" in term.needs:
            lacking |= ~np.isfinite(heading)
        if "length" in term.needs:
            lacking |= ~np.isfinite(own_length)
        if "elevation" in term.needs:
            lacking |= ~np.isfinite(plots.elevation_rad[rows])
        if lacking.any() and "elevation" not in term.needs:
            said.append(
                f"{name}: {term.name} was not applied to {lacking.sum():,} of {len(time):,} plots, which carry no "
                f"{' or no '.join(sorted(term.needs & {'heading', 'length'}))}"
            )
    measured = np.stack([plots.range_m[rows], plots.azimuth_rad[rows] + north, plots.elevation_rad[rows]], axis=1)
    measured = np.where(np.isfinite(measured), measured, np.nan)
    has_elevation = np.isfinite(measured[:, 2])
    height = np.where(np.isfinite(plots.height_m[rows]), plots.height_m[rows], plots.pressure_altitude_m[rows])
    still = np.zeros((len(time), 3))

    def geometry(at: FloatArray) -> Geometry:
        elevation = np.where(has_elevation, at[:, 2], _elevation(at[:, 0], height, site_height))
        return Geometry(at[:, 0], at[:, 1], elevation, still, still, still, heading, own_length, time - calibration.epoch_s[0])

    at = measured
    for _ in range(_STEPS):
        place = geometry(at)
        error = np.zeros_like(measured)
        for k in polar:
            error += TERMS[calibration.terms[k].name].columns(place) * values[k][:, None]
        new = measured - error
        moved = np.abs(new - at) * np.stack([np.ones(len(time)), at[:, 0], at[:, 0]], axis=1)
        at = new
        moved = moved[np.isfinite(moved)]
        if not len(moved) or moved.max() <= _TOLERANCE_M:
            break
    else:
        said.append(f"{name}: the correction did not settle to 1 mm: these errors are too large for these plots")
    columns["range_m"][rows] = at[:, 0]
    columns["azimuth_rad"][rows] = at[:, 1] - north
    columns["elevation_rad"][rows] = np.where(has_elevation, at[:, 2], plots.elevation_rad[rows])

    # What the calibration does not know of itself.
    added = np.zeros_like(measured)
    if polar:
        place = geometry(at)
        jacobian = np.stack([TERMS[calibration.terms[k].name].columns(place) for k in polar], axis=2)
        for epoch in range(len(calibration.epoch_s)):
            here = nearest == epoch
            c = calibration.covariance[epoch][np.ix_(polar, polar)]
            added[here] = np.einsum("nki,ij,nkj->nk", jacobian[here], c, jacobian[here])
    summary = next((s for s in calibration.sensors if s.sensor == sensor), None)
    noise = (np.nan,) * 3 if summary is None else (summary.noise.range_m, summary.noise.azimuth_rad, summary.noise.elevation_rad)
    for c, column in enumerate(("range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")):
        own = columns[column][rows]
        own = np.where(np.isfinite(own), own, noise[c])
        columns[column][rows] = np.where(np.isfinite(measured[:, c]), np.sqrt(own**2 + np.maximum(added[:, c], 0.0)), own)


def _elevation(range_m: FloatArray, height_m: FloatArray, site_height_m: float) -> FloatArray:
    """Elevation (n,) of a target at a slant range and height over a sphere; 0 where the height is unknown.

    It only places the error terms, which change by parts in a thousand with it: a sphere is enough.
    """
    centre = _EARTH_M + site_height_m
    sine = ((_EARTH_M + height_m) ** 2 - centre**2 - range_m**2) / (2 * np.maximum(range_m, 1.0) * centre)
    return np.where(np.isfinite(sine), np.arcsin(np.clip(np.nan_to_num(sine), -1.0, 1.0)), 0.0)
