"""What one sensor saw of the reference: pairs sorted by target and time, and their residuals at given error values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .._parallel import in_threads, slices
from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..geodesy import height_and_up, rotate
from ..measure import (
    from_true_north,
    heading_about,
    polar_jacobian,
    polar_motion,
    position_from_height,
    site_of,
    wrap_rad,
)  # fmt: skip
from ..model import Pairs, Sensor
from ..terms import Geometry, Term, Whose, late_s, order_of

# Rows that are worked on at a time: large enough for NumPy, small enough for the memory.
CHUNK = 1 << 15
# One value a term, or where errors change with time one (n,) for the rows.
Values = FloatArray | Sequence[FloatArray]
_BY_ROW = (
    "row", "enu", "velocity", "acceleration", "measured", "reference_variance", "heading_rad", "length_m", "time_s", "weight",
    "cluster", "channel", "flags", "source",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """The pairs of one sensor that can be used, sorted by target and time.

    `row` (n,) is the row in the pairs; `enu`, `velocity`, `acceleration` (n, 3) the reference about the antenna at the stamp,
    local axes; `measured` (n, 3) range, azimuth from true north, elevation (NaN where not measured); `reference_variance` (n,
    3) the reference's variance in these; `heading_rad` is from the antenna's north; `cluster` (n,)
    numbers the targets from 0; `time_s` counts from `epoch_s`.  `channel` and `flags` are the plots', `source` is the
    reference's id.
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
    channel: AnyArray
    flags: AnyArray
    source: AnyArray

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
    key = cluster_key(pairs)
    order = np.lexsort((measured, key))  # NaN sort last within each target
    sorted_key = key[order]
    first = np.flatnonzero(np.r_[True, sorted_key[1:] != sorted_key[:-1]])
    known = np.add.reduceat(np.isfinite(measured[order]).astype(np.int64), first)
    low, high = first + np.maximum(known - 1, 0) // 2, first + known // 2
    median = np.where(known > 0, (measured[order[low]] + measured[order[np.minimum(high, len(order) - 1)]]) / 2, np.nan)
    length[missing] = median[np.searchsorted(sorted_key[first], key[missing])]
    return pairs.replace(length_m=length)


def cluster_key(pairs: Pairs) -> IntArray:
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
    key = cluster_key(pairs)[rows]
    order = np.lexsort((pairs.plot[rows], pairs.plots.time_s[rows], key))
    rows, key = rows[order], key[order]
    plots, n = pairs.plots, len(rows)
    site, rotation = site_of(sensor)
    enu, velocity, acceleration = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    variance, heading = np.zeros((n, 3)), np.empty(n)

    def piece(part: slice) -> None:
        mine = rows[part]
        position = pairs.position[mine]
        enu[part] = rotate(rotation, position - site)
        velocity[part] = rotate(rotation, pairs.velocity[mine])
        acceleration[part] = rotate(rotation, np.nan_to_num(pairs.acceleration[mine], posinf=0.0, neginf=0.0))
        jacobian = polar_jacobian(enu[part]) @ rotation
        covariance = np.nan_to_num(pairs.covariance[mine], posinf=0.0, neginf=0.0)
        variance[part] = np.maximum(np.einsum("nij,njk,nik->ni", jacobian, covariance, jacobian), 0.0)
        carried = pairs.heading_rad[mine]
        heading[part] = heading_about(np.where(np.isfinite(carried), carried, np.nan), position, rotation)

    in_threads(piece, slices(n, CHUNK))
    keys, cluster = np.unique(key, return_inverse=True)
    length, elevation = pairs.length_m[rows], plots.elevation_rad[rows]
    azimuth = from_true_north(plots.azimuth_rad[rows], sensor)
    return Observed(
        sensor=sensor,
        site=site,
        rotation=rotation,
        epoch_s=epoch_s,
        row=rows,
        enu=enu,
        velocity=velocity,
        acceleration=acceleration,
        measured=np.stack([plots.range_m[rows], azimuth, np.where(np.isfinite(elevation), elevation, np.nan)], axis=1),
        reference_variance=variance,
        heading_rad=heading,
        length_m=np.where(np.isfinite(length), length, np.nan),
        time_s=plots.time_s[rows] - epoch_s,
        weight=pairs.weight[rows],
        cluster=cluster,
        cluster_key=keys,
        channel=plots.channel[rows],
        flags=plots.flags[rows],
        source=pairs.source[rows],
    )


def take(seen: Observed, rows: IntArray) -> Observed:
    """The rows (m,) alone; clusters keep their numbers."""
    return replace(seen, **{name: getattr(seen, name)[rows] for name in _BY_ROW})


def late(seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: Values) -> FloatArray | None:
    """Stamp minus true time, (n, 1) s, at the error values (p,); None where it is nothing."""
    if not any(t.is_time and np.any(v != 0) for t, v in zip(terms, value, strict=True)):
        return None
    return late_s(terms, value, seen.time_s[rows], whose(seen, rows))[:, None]


def whose(seen: Observed, rows: slice | IntArray) -> Whose:
    """Channel, flags and reference of the rows."""
    return Whose(seen.channel[rows], seen.flags[rows], seen.source[rows])


def geometry(seen: Observed, rows: slice | IntArray, before: FloatArray | None, order: int = 1) -> Geometry:
    """Where the targets truly were, as the radar saw them: (n, 1) seconds `before` their stamps; with rates up to the `order`."""
    acceleration, velocity = seen.acceleration[rows], seen.velocity[rows]
    enu = seen.enu[rows]
    if before is not None:
        enu = enu - before * velocity + (0.5 * before**2) * acceleration
        velocity = velocity - before * acceleration
    polar, rate, second, third = polar_motion(enu, velocity, acceleration, order=order)
    return Geometry(
        polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, seen.heading_rad[rows], seen.length_m[rows],
        seen.time_s[rows], whose(seen, rows),
    )  # fmt: skip


def look(
    seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: Values, also: Sequence[Term] = ()
) -> tuple[Geometry, FloatArray, dict[str, FloatArray]]:
    """Geometry, residuals (n, 3) at the error values (p,), SI, and the columns (n, 3) of the terms and `also` of others, by name.

    A late stamp enters through the target's motion, all other terms through their columns; elevation residuals are NaN where
    none was measured.
    """
    place = geometry(seen, rows, late(seen, rows, terms, value), order_of([*terms, *also]))
    columns = {term.name: term.columns(place) for term in [*terms, *also]}
    residual = seen.measured[rows] - np.stack([place.range_m, place.azimuth_rad, place.elevation_rad], axis=1)
    for term, v in zip(terms, value, strict=True):
        if not term.is_time and np.any(v != 0):
            residual -= columns[term.name] * np.asarray(v)[..., None]
    residual[:, 1] = wrap_rad(residual[:, 1])
    return place, residual, columns


def linearise(
    seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: FloatArray
) -> tuple[Geometry, FloatArray, FloatArray]:
    """`look` with the terms' columns as one array (n, 3, p)."""
    place, residual, columns = look(seen, rows, terms, value)
    return place, residual, np.stack([columns[term.name] for term in terms], axis=2)


def distances(seen: Observed, rows: slice | IntArray, terms: Sequence[Term], value: Values) -> FloatArray:
    """Horizontal distance (n,), metres, of the corrected plots from the reference, put at the reference's height.

    NaN where the slant range is too short for that height.
    """
    before = late(seen, rows, terms, value)
    # What a late stamp does is in the motion: its own column is not needed.
    others = [(t, v) for t, v in zip(terms, value, strict=True) if not t.is_time and np.any(v != 0)]
    place = geometry(seen, rows, before, order_of([t for t, _ in others]))
    residual = seen.measured[rows] - np.stack([place.range_m, place.azimuth_rad, place.elevation_rad], axis=1)
    for term, v in others:
        residual -= term.columns(place) * np.asarray(v)[..., None]
    enu = seen.enu[rows]
    if before is not None:
        enu = enu - before * seen.velocity[rows] + (0.5 * before**2) * seen.acceleration[rows]
    position = seen.site + enu @ seen.rotation
    height, up = height_and_up(position)
    lies = position_from_height(
        place.range_m + residual[:, 0], place.azimuth_rad + residual[:, 1], height, seen.site, seen.rotation
    )
    off = lies - position
    off -= np.einsum("ni,ni->n", off, up)[:, None] * up
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", off, off)))
