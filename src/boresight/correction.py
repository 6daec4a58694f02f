"""Correction: plots without the systematic errors that a calibration found."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ._parallel import slices
from ._types import BoolArray, FloatArray, IntArray
from .calibration import Calibration, advised
from .errors import InputError
from .model import Channel, Plots, Sensors
from .terms import CHANNELS, DEG, TERMS, TIME_TERMS, Geometry, Whose, late_s, touches

log = logging.getLogger(__name__)

_EARTH_M = 6371e3
_TOLERANCE_M = 1e-4
_CHUNK = 1 << 16
_STEPS = 50
# Plots of a track that are further apart tell nothing of each other; so many on either side tell its velocity.
_TRACK_GAP_S, _AROUND = 60.0, 4
# A target points where it goes from this speed on; faster than that it is no target (METHODS section 6).
_LEAST_SPEED_MPS, _FASTEST_MPS = 3.0, 1000.0


def correct(
    plots: Plots, calibration: Calibration, *, sensors: Sensors | None = None, terms: str | Sequence[str] = "advised"
) -> Plots:
    """The plots without the errors of the calibration.

    The model is inverted by fixed point to 1 mm: each error is evaluated at the corrected position, not at the measured one.
    Offset and drift of the clock are taken from the stamps.  Terms of heading and length are applied where these are known: the
    course of the plot's track from 3 m/s on, else the heading that it carries; the median length of its track, else its own.  How
    many went without is logged, and returned by `correct_and_say`.

    `terms` says which errors are taken out: those that the calibration's verdicts advise, "all", or names; the values are those
    that hold with the others at zero (`calibration.advised`).

    A plot's sd grow by what the calibration itself does not know of the terms applied, clock terms by the target's own motion
    (that of its track, else the speed and heading that it carries).  Where a plot has no sd, the sensor's estimated noise takes
    its place.  The added part is the same error in all plots: averaging does not make it smaller; and as plots carry one sd an
    axis, its correlation between range and azimuth is not kept.

    `sensors` gives antenna heights and north references; without it heights are counted from the ellipsoid and the azimuths are
    taken as true.  Corrected azimuths stay in the sensor's own north reference.  Plots of sensors without a calibration are
    left as they are.  Raises InputError where the calibration has no sensor of these plots, SettingsError for unknown `terms`.
    """
    corrected, said = correct_and_say(plots, calibration, sensors=sensors, terms=terms)
    for text in said:
        log.warning(text)
    return corrected


def correct_and_say(
    plots: Plots, calibration: Calibration, *, sensors: Sensors | None = None, terms: str | Sequence[str] = "advised"
) -> tuple[Plots, tuple[str, ...]]:
    """`correct`, with what must be said of it: which plots were left as they are, and to which a term could not be applied."""
    # Whose sensors they are is asked of the whole calibration: all its terms may be held.
    calibrated = {key.sensor for key in calibration.terms}
    calibration = advised(calibration, terms)
    said: list[str] = []
    keys, counts = np.unique(plots.sensor, return_counts=True)
    summaries = {s.sensor: s for s in calibration.sensors}
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
    blank = int((np.isin(plots.sensor, list(calibrated)) & ~(np.isfinite(plots.range_m) & np.isfinite(plots.azimuth_rad))).sum())
    if blank:
        said.append(f"{blank:,} plots have no range or no azimuth: what they have not cannot be corrected")
    columns = {
        name: getattr(plots, name).copy()
        for name in ("time_s", "range_m", "azimuth_rad", "elevation_rad", "range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")
    }
    used = [TERMS[key.name] for key in calibration.terms]
    length, velocity = plots.length_m, np.full((len(plots), 2), np.nan)
    if any("heading" in term.needs or term.is_time for term in used):
        tracks = _tracks(plots)
        length, velocity = _lengths(plots, tracks), _velocity(plots, tracks)
    tally: dict[str, list[int]] = {}
    for key in sorted(calibrated):
        mine = plots.sensor == key
        groups = {k.channel for k in calibration.terms if k.sensor == key}
        # Plots of different channels may have different terms: each plot is corrected once, with all that touch it.
        for rows, own in _by_terms(plots, calibration, key, mine, groups):
            name = summaries[key].name if key in summaries else _place(key)
            # A part at a time: what is computed on the way is many times as large as the plots.
            for part in slices(len(rows), _CHUNK):
                _correct_rows(plots, calibration, sensors, key, name, rows[part], own, length, velocity, columns, tally)
    said += [text.format(f"{count:,} of {total:,}") for text, (count, total) in tally.items() if count]
    columns["azimuth_rad"] = np.where(
        np.isfinite(columns["azimuth_rad"]), np.mod(columns["azimuth_rad"], 2 * np.pi), columns["azimuth_rad"]
    )
    untouched = ~np.isin(plots.sensor, list(calibrated))
    columns["azimuth_rad"][untouched] = plots.azimuth_rad[untouched]
    return plots.replace(**columns), tuple(said)


def _place(key: int) -> str:
    return f"{key >> 8}/{key & 255}" if 0 <= key < 65536 else f"id {key}"


def _touched(plots: Plots, channel: str) -> BoolArray:
    """Which plots (n,) the terms of a channel act on."""
    if channel != "all" and channel.lower() not in (*CHANNELS, *(c.name.lower() for c in Channel)):
        raise InputError(
            f"the calibration has terms of a channel {channel!r}, which plots do not have",
            remedy=f"Channels: all, {', '.join(CHANNELS)}.",
        )
    return np.zeros(len(plots), bool) | touches(channel, _whose(plots))


def _whose(plots: Plots) -> Whose:
    return Whose(plots.channel, plots.flags, np.full(len(plots), -1, np.int32))


def _by_terms(
    plots: Plots, calibration: Calibration, sensor: int, mine: BoolArray, channels: set[str]
) -> list[tuple[IntArray, list[int]]]:
    """The sensor's plots in groups that the same terms touch: (rows (k,), indices of the terms)."""
    signature = np.zeros(len(plots), np.int64)
    names = sorted(channels)
    for bit, channel in enumerate(names):
        signature |= np.where(_touched(plots, channel), 1 << bit, 0)
    out = []
    for value in np.unique(signature[mine]).tolist():
        active = {name for bit, name in enumerate(names) if value >> bit & 1}
        terms = [k for k, key in enumerate(calibration.terms) if key.sensor == sensor and key.channel in active]
        if terms:
            out.append((np.flatnonzero(mine & (signature == value)), terms))
    return out


class _Tracks(NamedTuple):
    """The plots that belong to tracks: their rows (m,) track by track, each in the order of time, and the track's number (m,)."""

    row: IntArray
    track: IntArray


def _tracks(plots: Plots) -> _Tracks:
    """Tracks by their number, else by Mode S address; after a gap a number stands for another target."""
    whose = np.where(plots.track >= 0, plots.track.astype(np.int64), plots.mode_s.astype(np.int64) + (1 << 40))
    known = np.flatnonzero(((plots.track >= 0) | (plots.mode_s >= 0)) & np.isfinite(plots.time_s))
    row = known[np.lexsort((plots.time_s[known], whose[known], plots.sensor[known]))]
    begins = (np.diff(whose[row]) != 0) | (np.diff(plots.sensor[row]) != 0) | (np.diff(plots.time_s[row]) > _TRACK_GAP_S)
    return _Tracks(row, np.concatenate([np.zeros(min(len(row), 1), np.int64), np.cumsum(begins)]))


def _lengths(plots: Plots, tracks: _Tracks) -> FloatArray:
    """The length (n,) of each plot's target: the median of its track's, which a single look misses by metres; else its own."""
    length = plots.length_m.copy()
    if not np.isfinite(length[tracks.row]).any():
        return length
    measured = length[tracks.row]
    in_order = measured[np.lexsort((measured, tracks.track))]  # what is not known comes last in each track
    first = np.flatnonzero(np.diff(tracks.track, prepend=-1))
    count = np.add.reduceat(np.isfinite(measured).astype(np.int64), first)
    low, high = in_order[first + np.maximum(count - 1, 0) // 2], in_order[first + count // 2 - (count == 0)]
    length[tracks.row] = np.where(count > 0, (low + high) / 2, np.nan)[tracks.track]
    return length


def _velocity(plots: Plots, tracks: _Tracks) -> FloatArray:
    """East and north velocity (n, 2): the slope over the plots around each one in its track; NaN where alone.

    Both are of the radar's plane and north, and slant range stands for the ground's: enough for a course and an uncertainty.
    """
    out = np.full((len(plots), 2), np.nan)
    row, n = tracks.row, len(tracks.row)
    if n < 2:
        return out
    time = plots.time_s[row]
    turn = np.stack([np.sin(plots.azimuth_rad[row]), np.cos(plots.azimuth_rad[row])], axis=1)
    place = plots.range_m[row, None] * turn
    place = np.where(np.isfinite(place), place, np.nan)
    count, t, tt, p, pt = np.ones(n), np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2))
    for away in [k for k in range(-_AROUND, _AROUND + 1) if k and abs(k) < n]:
        here, there = (slice(0, n - away), slice(away, n)) if away > 0 else (slice(-away, n), slice(0, n + away))
        dt, dp = time[there] - time[here], place[there] - place[here]
        near = (tracks.track[there] == tracks.track[here]) & (np.abs(dt) <= _TRACK_GAP_S) & np.isfinite(dp[:, 0])
        dt, dp = np.where(near, dt, 0.0), np.where(near[:, None], dp, 0.0)
        count[here] += near
        t[here] += dt
        tt[here] += dt**2
        p[here] += dp
        pt[here] += dp * dt[:, None]
    spread = tt - t**2 / count
    slope = (pt - p * (t / count)[:, None]) / np.where(spread > 0, spread, np.nan)[:, None]
    fast = np.hypot(slope[:, 0], slope[:, 1]) > _FASTEST_MPS
    out[row] = np.where(fast[:, None], np.nan, slope)
    return out


def _correct_rows(
    plots: Plots,
    calibration: Calibration,
    sensors: Sensors | None,
    sensor: int,
    name: str,
    rows: IntArray,
    terms: list[int],
    length: FloatArray,
    velocity: FloatArray,
    columns: dict[str, FloatArray],
    tally: dict[str, list[int]],
) -> None:
    """Correct the plots at `rows` (k,) for the terms at `terms` of the calibration; what must be said is counted in `tally`."""

    def say(what: str, count: int) -> None:
        counts = tally.setdefault(f"{name.replace('{', '{{').replace('}', '}}')}: {what}", [0, 0])
        counts[0] += count
        counts[1] += len(rows)

    kinds = [TERMS[calibration.terms[k].name] for k in terms]
    time = plots.time_s[rows]
    entry = sensors.find(sensor) if sensors is not None else None
    site_height = (entry.ellipsoidal_height_m or 0.0) if entry is not None else 0.0
    north = entry.north_offset_deg * DEG if entry is not None else 0.0
    # A calibration over time: linear between its epochs, held beyond them.  A plot without a time gets the last.
    known = np.where(np.isfinite(time), time, calibration.epoch_s[-1])
    values = [np.interp(known, calibration.epoch_s, calibration.value[:, k]) for k in terms]
    nearest = np.abs(known[:, None] - calibration.epoch_s).argmin(axis=1) if len(calibration.epoch_s) > 1 else np.zeros(len(time))
    since = known - calibration.epoch_s[0]
    columns["time_s"][rows] -= late_s(kinds, values, since)
    heading, own_length = plots.heading_rad[rows], length[rows]
    if entry is not None and entry.lat_deg is not None:
        # A carried heading is from the north where the target is (the convergence of the meridians on a sphere is enough).
        east = plots.range_m[rows] * np.sin(plots.azimuth_rad[rows] + north)
        heading = heading - east / _EARTH_M * np.tan(entry.lat_deg * DEG)
    # Where the target goes tells better where it points than the shape of its echo, which has no front.  Seen from a moving radar
    # (one without a place) it does not.
    own = velocity[rows]
    if entry is not None and entry.lat_deg is None:
        own = np.full_like(own, np.nan)
    course = np.arctan2(own[:, 0], own[:, 1]) + north
    heading = np.where(np.hypot(own[:, 0], own[:, 1]) >= _LEAST_SPEED_MPS, course, heading)
    measured = np.stack([plots.range_m[rows], plots.azimuth_rad[rows] + north, plots.elevation_rad[rows]], axis=1)
    measured = np.where(np.isfinite(measured), measured, np.nan)
    has_elevation = np.isfinite(measured[:, 2])
    polar = []
    for term, value in zip(kinds, values, strict=True):
        if term.name in TIME_TERMS:
            continue
        if term.needs & {"rate", "second", "third"}:
            say(f"{term.name} was not applied to {{}} plots: they do not tell the accelerations that it needs", len(rows))
            continue
        polar.append((term, value))
        lacking = np.zeros(len(time), bool)
        if "heading" in term.needs:
            lacking |= ~np.isfinite(heading)
        if "length" in term.needs:
            lacking |= ~np.isfinite(own_length)
        what = " or no ".join(sorted(term.needs & {"heading", "length"}))
        say(f"{term.name} was not applied to {{}} plots, of which no {what} is known", int(np.count_nonzero(lacking)))
    height = np.where(np.isfinite(plots.height_m[rows]), plots.height_m[rows], plots.pressure_altitude_m[rows])
    still = np.zeros((len(time), 3))
    whose = _whose(plots[rows])

    def geometry(at: FloatArray, rate: FloatArray) -> Geometry:
        elevation = np.where(has_elevation, at[:, 2], _elevation(at[:, 0], height, site_height))
        return Geometry(at[:, 0], at[:, 1], elevation, rate, still, still, heading, own_length, since, whose)

    at = measured
    for _ in range(_STEPS):
        place = geometry(at, still)
        error = np.zeros_like(measured)
        for term, value in polar:
            error += term.columns(place) * value[:, None]
        new = measured - error
        moved = np.abs(new - at) * np.stack([np.ones(len(time)), at[:, 0], at[:, 0]], axis=1)
        at = new
        moving = (moved > _TOLERANCE_M).any(axis=1)
        if not moving.any():
            break
    else:
        say("the correction of {} plots did not settle to 1 mm: these errors are too large for them", int(moving.sum()))
    columns["range_m"][rows] = at[:, 0]
    columns["azimuth_rad"][rows] = at[:, 1] - north
    columns["elevation_rad"][rows] = np.where(has_elevation, at[:, 2], plots.elevation_rad[rows])

    # What the calibration does not know of itself, at the target's own motion for what it does not know of the clock.
    carried = plots.speed_mps[rows, None] * np.stack([np.sin(heading), np.cos(heading)], axis=1)
    turned = np.hypot(own[:, 0], own[:, 1])[:, None] * np.stack([np.sin(course), np.cos(course)], axis=1)
    rate = _rate(at, np.where(np.isfinite(turned), turned, carried))
    if any(term.name in TIME_TERMS for term in kinds):
        alone = np.isnan(rate[:, 0]) & np.isfinite(at[:, 0])
        what = "what the calibration does not know of the clock is not in the sd of {} plots, whose motion nothing tells"
        say(what, int(np.count_nonzero(alone)))
    place = geometry(at, np.nan_to_num(rate))
    jacobian = np.stack([term.columns(place) for term in kinds], axis=2)
    added = np.zeros_like(measured)
    for epoch in range(len(calibration.epoch_s)):
        here = nearest == epoch
        c = calibration.covariance[epoch][np.ix_(terms, terms)]
        added[here] = np.einsum("nki,ij,nkj->nk", jacobian[here], c, jacobian[here], optimize=True)
    summary = next((s for s in calibration.sensors if s.sensor == sensor), None)
    noise = (np.nan,) * 3 if summary is None else (summary.noise.range_m, summary.noise.azimuth_rad, summary.noise.elevation_rad)
    for c, column in enumerate(("range_sd_m", "azimuth_sd_rad", "elevation_sd_rad")):
        own = columns[column][rows]
        own = np.where(np.isfinite(own), own, noise[c])
        columns[column][rows] = np.where(np.isfinite(measured[:, c]), np.sqrt(own**2 + np.maximum(added[:, c], 0.0)), own)


def _rate(polar: FloatArray, velocity: FloatArray) -> FloatArray:
    """How fast range, azimuth and elevation (n, 3) of a target in level flight change; its elevation is taken as small."""
    sin_a, cos_a = np.sin(polar[:, 1]), np.cos(polar[:, 1])
    along = velocity[:, 0] * sin_a + velocity[:, 1] * cos_a
    across = velocity[:, 0] * cos_a - velocity[:, 1] * sin_a
    return np.stack([along, across / np.maximum(polar[:, 0], 1.0), np.zeros(len(polar))], axis=1)


def _elevation(range_m: FloatArray, height_m: FloatArray, site_height_m: float) -> FloatArray:
    """Elevation (n,) of a target at a slant range and height over a sphere; 0 where the height is unknown.

    It only places the error terms, which change by parts in a thousand with it: a sphere is enough.
    """
    centre = _EARTH_M + site_height_m
    sine = ((_EARTH_M + height_m) ** 2 - centre**2 - range_m**2) / (2 * np.maximum(range_m, 1.0) * centre)
    return np.where(np.isfinite(sine), np.arcsin(np.clip(np.nan_to_num(sine), -1.0, 1.0)), 0.0)
