"""Which plots belong together before any reference is looked at: the radar's own tracks, cut where they cannot be one target.

A track number is used again after a while, and sometimes jumps to another target.  Both are cut here, so that a tracklet is one
target as far as the radar can tell.  Plots without a number but with an identity are grouped by that; the rest stand alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..model import Plots

_SLACK_M = 250.0


class Tracklets(NamedTuple):
    """Groups of plots: tracklet k holds the rows ``order[start[k]:start[k + 1]]`` of a table, in the order of time.

    `order` (m,) are row numbers, `start` (k + 1,) limits, `number` (k,) the radar's track number (-1 where grouped by
    identity), `alone` the rows (of those that were asked for) that neither a number nor an identity groups.
    """

    order: IntArray
    start: IntArray
    number: IntArray
    alone: IntArray

    def __len__(self) -> int:
        return len(self.number)

    @property
    def length(self) -> IntArray:
        """The number of plots of each tracklet (k,)."""
        return np.diff(self.start)

    def member(self) -> IntArray:
        """The tracklet of each entry of `order` (m,)."""
        return np.repeat(np.arange(len(self)), self.length)


def group_key(plots: Plots, rows: IntArray) -> IntArray:
    """One int64 (m,) per row of `rows`: equal where track number (else Mode S, MMSI, callsign) are equal; -1 where there is none.

    A Mode 3/A code alone does not group: several aircraft may share one.
    """
    key = np.full(len(rows), -1, np.int64)
    for kind, column in enumerate((plots.track, plots.mode_s, plots.mmsi, plots.callsign)):
        value = column[rows].astype(np.int64)
        take = (key < 0) & (value >= 0)
        # Callsigns fill 48 bits, so the kind goes above them.
        key[take] = value[take] | kind << 50
    return key


def build(plots: Plots, rows: IntArray, *, gap_s: float, speed_mps: float, azimuth_sd_rad: float) -> Tracklets:
    """Group the `rows` (m,) of one sensor's plots into tracklets.

    A tracklet ends where the next plot comes more than `gap_s` later, or farther away than `speed_mps` and the azimuth's noise
    (6 `azimuth_sd_rad`) allow.
    """
    key = group_key(plots, rows)
    alone = rows[key < 0]
    grouped = rows[key >= 0]
    key = key[key >= 0]
    time = plots.time_s[grouped]
    if np.any(np.diff(time) < 0):
        by_time = np.argsort(time, kind="stable")
        grouped, key = grouped[by_time], key[by_time]
    by_key = np.argsort(key, kind="stable")
    order, key = grouped[by_key], key[by_key]
    if not len(order):
        return Tracklets(order, np.zeros(1, np.int64), np.empty(0, np.int64), alone)
    first = np.r_[True, key[1:] != key[:-1]] | _broken(plots, order, gap_s, speed_mps, azimuth_sd_rad)
    start = np.flatnonzero(first)
    return Tracklets(order, np.r_[start, len(order)], plots.track[order[start]].astype(np.int64), alone)


def _broken(plots: Plots, order: IntArray, gap_s: float, speed_mps: float, azimuth_sd_rad: float) -> BoolArray:
    """Whether each plot of `order` (m,) cannot continue the one before it."""
    time, distance, azimuth = plots.time_s[order], plots.range_m[order], plots.azimuth_rad[order]
    east, north = distance * np.sin(azimuth), distance * np.cos(azimuth)
    step = np.diff(time)
    jump: FloatArray = np.hypot(np.diff(east), np.diff(north))
    allowed = speed_mps * np.abs(step) + 6 * azimuth_sd_rad * distance[1:] + _SLACK_M
    broken: BoolArray = np.r_[True, (step > gap_s) | (jump > allowed)]
    return broken


def sample(tracklets: Tracklets, points: int, which: IntArray | None = None) -> tuple[IntArray, IntArray]:
    """At most `points` plots of each tracklet, evenly spread: (tracklet (m,), row (m,)).

    `which` (k,) restricts to some tracklets; the returned tracklet numbers are those of the whole table.
    """
    chosen = np.arange(len(tracklets)) if which is None else which
    length = tracklets.length[chosen]
    count = np.minimum(length, points)
    tracklet = np.repeat(chosen, count)
    inside = np.arange(len(tracklet)) - np.repeat(np.cumsum(count) - count, count)
    n, c = np.repeat(length, count), np.repeat(count, count)
    # Centres of c equal parts of n plots: never the same plot twice, and never only the ends.
    at = (2 * inside + 1) * n // (2 * c)
    return tracklet, tracklets.order[tracklets.start[tracklet] + at]


def still(plots: Plots, tracklets: Tracklets, speed_mps: float, half_s: float = 6.0) -> IntArray:
    """The rows (m,) of plots whose tracklet, by its own plots, moved slower than `speed_mps` over the `half_s` before and after.

    A tracklet shorter than that in time is judged by what there is of it; single plots are still.
    """
    order, member = tracklets.order, tracklets.member()
    if not len(order):
        return order
    time = plots.time_s[order]
    low = float(time.min())
    width = float(time.max()) - low + 4 * half_s
    key = member * width + (time - low)
    back = np.maximum(np.searchsorted(key, key - half_s, "left"), tracklets.start[member])
    ahead = np.minimum(np.searchsorted(key, key + half_s, "right") - 1, tracklets.start[member + 1] - 1)
    distance, azimuth = plots.range_m[order], plots.azimuth_rad[order]
    east, north = distance * np.sin(azimuth), distance * np.cos(azimuth)
    moved = np.hypot(east[ahead] - east[back], north[ahead] - north[back])
    return order[~(moved > speed_mps * np.maximum(time[ahead] - time[back], half_s))]
