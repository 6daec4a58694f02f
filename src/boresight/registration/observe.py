"""What one sensor saw of the reference: pairs sorted by target and time, and their residuals at given error values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..geodesy import geodetic_from_ecef, height_and_up, rotate
from ..measure import polar_jacobian, polar_motion, position_from_height, site_of, true_azimuth, wrap_rad
from ..model import Pairs, Sensor, Sensors
from ..terms import Geometry, Term

# Rows that are worked on at a time: large enough for NumPy, small enough for the memory.
CHUNK = 1 << 15
_TIME_TERMS = frozenset({"time_offset"})


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """The pairs of one sensor that can be used, sorted by target and time.

    `row` (n,) is the row in the pairs; `enu`, `velocity`, `acceleration` (n, 3) the reference about the antenna at the stamp,
    local axes; `measured` (n, 3) range, azimuth from true north, elevation (NaN where not measured); `reference_variance` (n,
    3) the reference's variance in these; `cluster` (n,) numbers the targets from 0; `time_s` counts from `epoch_s`.
    """

    sensor: Sensor
    site: FloatArray
    rotation: FloatArray
    epoch_s: float
    row: IntArray
    enu: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    measured: FloatArray
    reference_variance: FloatArray
    heading_rad: FloatArray
    length_m: FloatArray
    time_s: FloatArray
    weight: FloatArray
    cluster: IntArray
    cluster_key: IntArray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def has_elevation(self) -> bool:
        """Whether the sensor measures elevation."""
        return bool(np.isfinite(self.measured[:, 2]).any())


def fill_lengths(pairs: Pairs) -> Pairs:
    """The pairs with the length (m) of each target wherever anything tells it.

    The reference's own length comes first; else the median of the lengths that the radar measured of that target (its plots'
    `length_m`); else NaN.
    """
    missing = ~np.isfinite(pairs.length_m)
    measured = pairs.plots.length_m
    if not missing.any() or not np.isfinite(measured[missing]).any():
        return pairs
    length = pairs.length_m.copy()
    key = _cluster_key(pairs)
    order = np.lexsort((measured, key))  # NaN sort last within each target
    sorted_key = key[order]
    first = np.flatnonzero(np.r_[True, sorted_key[1:] != sorted_key[:-1]])
    known = np.add.reduceat(np.isfinite(measured[order]).astype(np.int64), first)
    low, high = first + np.maximum(known - 1, 0) // 2, first + known // 2
    median = np.where(known > 0, (measured[order[low]] + measured[order[np.minimum(high, len(order) - 1)]]) / 2, np.nan)
    length[missing] = median[np.searchsorted(sorted_key[first], key[missing])]
    return pairs.replace(length_m=length)


def _cluster_key(pairs: Pairs) -> IntArray:
    """One number a target; a pair without a target counts by its radar track, and without either by itself."""
    alone = np.arange(len(pairs))
    track = np.where(pairs.track >= 0, 2 * pairs.track, 2 * alone + 1)
    key: IntArray = np.where(pairs.target >= 0, pairs.target, -2 - track)
    return key


def unusable(pairs: Pairs) -> dict[str, BoolArray]:
    """Why pairs cannot be used: reason -> rows (n,), each pair under its first reason only."""
    plots = pairs.plots

    def finite(*columns: FloatArray) -> BoolArray:
        ok = np.ones(len(pairs), bool)
        for column in columns:
            ok &= np.isfinite(column) if column.ndim == 1 else np.isfinite(column).all(axis=1)
        return ok

    reasons = {
        "the stamp is not a number": ~finite(plots.time_s),
        "the range is not a positive number": ~(finite(plots.range_m) & (plots.range_m > 0)),
        "the azimuth is not a number": ~finite(plots.azimuth_rad),
        "the reference has no position": ~finite(pairs.position),
        "the reference has no velocity": ~finite(pairs.velocity),
        "the weight is not positive": ~(finite(pairs.weight) & (pairs.weight > 0)),
    }
    seen = np.zeros(len(pairs), bool)
    out: dict[str, BoolArray] = {}
    for reason, rows in reasons.items():
        fresh = rows & ~seen
        seen |= fresh
        if fresh.any():
            out[reason] = fresh
    return out


def observe(pairs: Pairs, rows: IntArray, sensor: Sensor, epoch_s: float) -> Observed:
    """The usable pairs at `rows` (n,), all of `sensor`, ready for estimation."""
    key = _cluster_key(pairs)[rows]
    order = np.lexsort((pairs.plot[rows], pairs.plots.time_s[rows], key))
    rows, key = rows[order], key[order]
    own = pairs if np.array_equal(rows, np.arange(len(pairs))) else pairs[rows]
    site, rotation = site_of(sensor)
    enu = rotate(rotation, own.position - site)
    variance = np.zeros((len(rows), 3))
    for k in range(0, len(rows), CHUNK):
        jacobian = polar_jacobian(enu[k : k + CHUNK]) @ rotation
        local = jacobian @ np.nan_to_num(own.covariance[k : k + CHUNK], posinf=0.0, neginf=0.0) @ np.swapaxes(jacobian, 1, 2)
        variance[k : k + CHUNK] = np.maximum(np.einsum("nii->ni", local), 0.0)
    keys, cluster = np.unique(key, return_inverse=True)
    azimuth = true_azimuth(own.plots, Sensors((sensor,)))
    elevation = np.where(np.isfinite(own.plots.elevation_rad), own.plots.elevation_rad, np.nan)
    return Observed(
        sensor=sensor,
        site=site,
        rotation=rotation,
        epoch_s=epoch_s,
        row=rows,
        enu=enu,
        velocity=rotate(rotation, own.velocity),
        acceleration=rotate(rotation, np.nan_to_num(own.acceleration, posinf=0.0, neginf=0.0)),
        measured=np.stack([own.plots.range_m, azimuth, elevation], axis=1),
        reference_variance=variance,
        heading_rad=np.where(np.isfinite(own.heading_rad), own.heading_rad, np.nan),
        length_m=np.where(np.isfinite(own.length_m), own.length_m, np.nan),
        time_s=own.plots.time_s - epoch_s,
        weight=own.weight,
        cluster=cluster,
        cluster_key=keys,
    )


def chunks(n: int) -> Iterator[slice]:
    """Slices that cover n rows."""
    for k in range(0, n, CHUNK):
        yield slice(k, min(k + CHUNK, n))


def time_offset(terms: Sequence[Term], value: FloatArray) -> float:
    """The value (s) of the time offset among the terms, 0 where it is not one of them."""
    return float(sum(v for term, v in zip(terms, value, strict=True) if term.name in _TIME_TERMS))


def geometry(seen: Observed, rows: slice | IntArray, late_s: float) -> Geometry:
    """Where the targets truly were, as the radar saw them: `late_s` before their stamps."""
    acceleration, velocity = seen.acceleration[rows], seen.velocity[rows]
    enu = seen.enu[rows] - late_s * velocity + (0.5 * late_s**2) * acceleration
    polar, rate, second, third = polar_motion(enu, velocity - late_s * acceleration, acceleration)
    return Geometry(
        polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, seen.heading_rad[rows], seen.length_m[rows], seen.time_s[rows]
    )


def linearise(
    seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: FloatArray
) -> tuple[Geometry, FloatArray, FloatArray]:
    """Geometry, residuals (n, 3) and columns (n, 3, p), SI, at the error values (p,).

    The time offset enters through the target's motion, all other terms through their columns; elevation residuals are NaN where
    none was measured.
    """
    place = geometry(seen, rows, time_offset(terms, value))
    columns = np.empty((len(place.range_m), 3, len(terms)))
    residual = seen.measured[rows] - np.stack([place.range_m, place.azimuth_rad, place.elevation_rad], axis=1)
    residual[:, 1] = wrap_rad(residual[:, 1])
    for k, term in enumerate(terms):
        columns[:, :, k] = term.columns(place)
        if term.name not in _TIME_TERMS:
            residual -= columns[:, :, k] * value[k]
    residual[:, 1] = wrap_rad(residual[:, 1])
    return place, residual, columns


def distances(seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: FloatArray) -> FloatArray:
    """Horizontal distance (n,), metres, of the corrected plots from the reference, put at the reference's height.

    NaN where the slant range is too short for that height.
    """
    late = time_offset(terms, value)
    place, residual, _ = linearise(seen, rows, terms, value)
    enu = seen.enu[rows] - late * seen.velocity[rows] + (0.5 * late**2) * seen.acceleration[rows]
    position = seen.site + enu @ seen.rotation
    height = geodetic_from_ecef(position)[2]
    lies = position_from_height(
        place.range_m + residual[:, 0], place.azimuth_rad + residual[:, 1], height, seen.site, seen.rotation
    )
    _, up = height_and_up(position)
    off = lies - position
    off -= np.einsum("ni,ni->n", off, up)[:, None] * up
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", off, off)))
