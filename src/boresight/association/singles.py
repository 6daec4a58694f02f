"""Plots that neither a track number nor an identity groups: each takes the nearest target, and targets make the tracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import alignment, measure
from .._types import BoolArray, FloatArray, IntArray
from . import identity
from .coarse import CoarseBias
from .scene import Compared, Scene


def left_over(c: Compared, bias: CoarseBias) -> tuple[FloatArray, FloatArray]:
    """Range (m) and azimuth (rad) errors (m,) once the biases are taken off; the stamps were repaired by the comparison."""
    range_bias, azimuth_bias = bias.errors.at(c.range_m, c.azimuth_rad)
    return c.range_error_m - range_bias, measure.wrap_rad(c.azimuth_error_rad - azimuth_bias)


def nearest(scene: Scene, rows: IntArray, bias: CoarseBias) -> IntArray:
    """The target nearest to each of the `rows` (m,) once the biases are taken off, -1 where none is within the gate."""
    from scipy.spatial import cKDTree

    out = np.full(len(rows), -1, np.int64)
    if not len(rows):
        return out
    reference, plots = scene.reference, scene.plots
    first, last = float(plots.time_s[rows].min()) - 10.0, float(plots.time_s[rows].max()) + 10.0
    low, high = np.maximum(reference.start_s, first), np.minimum(reference.end_s, last)
    length = np.maximum(high - low, 0.0)
    step = max(0.5 * scene.assumed.scan_s, float(length.sum()) / 500_000)
    count = np.where(high >= low, np.floor(length / step).astype(np.int64) + 2, 0)
    target = np.repeat(np.arange(len(low)), count)
    if not len(target):
        return out
    time = low[target] + step * (np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count))
    states = alignment.states(reference.trajectories, target, time)
    target, time = target[states.valid], time[states.valid]
    enu = scene.local(states.position[states.valid] - scene.site)
    if not len(enu):
        return out
    polar = measure.polar_from_enu(enu)
    # Time is a third axis: a sample a step away costs as much as half of what the fastest target moves in it.
    slow = 0.5 * scene.assumed.speed_mps

    def place(distance: FloatArray, azimuth: FloatArray, at: FloatArray) -> FloatArray:
        return np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth), slow * (at - first)], axis=1)

    errors = bias.errors.at(polar[:, 0], polar[:, 1])
    tree = cKDTree(place(polar[:, 0] + errors[0], polar[:, 1] + errors[1], time + bias.time_s))
    a, farthest, gate = scene.assumed, float(plots.range_m[rows].max()), scene.settings.gate_sd
    bound = (
        gate * np.hypot(a.range_sd_m, farthest * (a.azimuth_sd_rad + a.unmodelled_rad)) + gate * a.extent_m + a.speed_mps * step
    )
    _, near = tree.query(
        place(plots.range_m[rows], scene.azimuth_rad[rows], plots.time_s[rows]), k=min(6, len(target)), distance_upper_bound=bound
    )
    near = near.reshape(len(rows), -1)
    best = np.full(len(rows), gate**2)
    done = np.full(near.shape, -1, np.int64)
    code = np.where(identity.is_discrete(plots.mode_3a[rows]), plots.mode_3a[rows], -1)
    for k in range(near.shape[1]):
        hit = near[:, k] < len(target)
        j = np.where(hit, target[np.minimum(near[:, k], len(target) - 1)], -1)
        fresh = np.flatnonzero(hit & ~np.any(done[:, :k] == j[:, None], axis=1))
        done[:, k] = j
        c = scene.compare(rows[fresh], j[fresh], late_s=bias.time_s)
        along, across = left_over(c, bias)
        d2 = (along / c.range_sd_m) ** 2 + (across / c.azimuth_sd_rad) ** 2
        theirs = reference.names.value[identity.MODE_3A][j[fresh]]
        d2 += np.where((code[fresh] >= 0) & (theirs >= 0) & (code[fresh] != theirs), 9.0, 0.0)
        better = c.valid & (d2 < best[fresh])
        out[fresh[better]], best[fresh[better]] = j[fresh[better]], d2[better]
    return out


class Spans(NamedTuple):
    """Plots of one target without a gap: `row` (m,) with its `span` (m,); of each span target, mean d², begin and end (k,)."""

    row: IntArray
    span: IntArray
    target: IntArray
    cost: FloatArray
    start_s: FloatArray
    end_s: FloatArray


def spans(scene: Scene, rows: IntArray, target: IntArray, d2: FloatArray, gap_s: float) -> Spans:
    """Make tracks of plots that were paired one by one (`rows`, `target`, `d2` (m,)).

    One plot per target and scan stays, the nearest; a span ends after `gap_s`; spans that hold few plots, or plots in few of
    their scans, are stray hits of clutter and left out.
    """
    time = scene.plots.time_s
    by = np.lexsort((time[rows], target))
    rows, target, d2 = rows[by], target[by], d2[by]
    scan = scene.sensor.scan_s or _rotation(time[rows], target, scene.assumed.scan_s)
    kept = one_a_scan(time[rows], target, d2, scan)
    rows, target, d2 = rows[kept], target[kept], d2[kept]
    start = np.flatnonzero(np.r_[True, (np.diff(target) != 0) | (np.diff(time[rows]) > gap_s)]) if len(rows) else rows
    count = np.diff(np.r_[start, len(rows)])
    begin, end = time[rows[start]], time[rows[start + count - 1]]
    enough = (count >= max(scene.settings.min_plots, 5)) & (count >= 0.3 * ((end - begin) / scan + 1))
    stays = np.repeat(enough, count)
    label = np.repeat(np.cumsum(enough) - 1, count)[stays]
    n = int(enough.sum())
    cost = np.bincount(label, d2[stays], n) / np.maximum(count[enough], 1)
    return Spans(rows[stays], label, target[start][enough], cost, begin[enough], end[enough])


def _rotation(time_s: FloatArray, target: IntArray, otherwise: float) -> float:
    """The scan period (s) that plots sorted by target and time show, where sensors.toml does not give it."""
    step = np.diff(time_s)[np.diff(target) == 0]
    step = step[(step > 0.3) & (step < 30.0)]
    return float(np.median(step)) if len(step) >= 20 else otherwise


def one_a_scan(time_s: FloatArray, target: IntArray, d2: FloatArray, scan_s: float) -> BoolArray:
    """Which plots (m,), sorted by target and time, stay if plots of a target closer than half a scan are one too many."""
    keep = np.ones(len(time_s), bool)
    # Each round drops the worse of two neighbours; three hits in one scan need two rounds.
    for _ in range(8):
        at = np.flatnonzero(keep)
        close = np.flatnonzero((np.diff(target[at]) == 0) & (np.diff(time_s[at]) < 0.5 * scan_s))
        if not len(close):
            break
        worse = np.where(d2[at[close]] > d2[at[close + 1]], close, close + 1)
        keep[at[worse]] = False
    return keep
