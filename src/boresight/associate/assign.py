"""Which track is which target: a truncated Mahalanobis cost over whole tracks, and the cheapest consistent assignment.

METHODS section 4.  The cost of a pair is the sum over the track's plots of min(d², gate²); leaving a track unassigned costs a
fixed amount per plot.  A target may be taken by several tracks of one radar, but never by two at the same time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import BoolArray, FloatArray, IntArray


class Decision(NamedTuple):
    """The target of each track (k,), -1 where it has none, its cost and the next best target's (NaN where there is none)."""

    target: IntArray
    cost: FloatArray
    runner_up: FloatArray


def track_cost(
    track: IntArray, target: IntArray, d2: FloatArray, weight: FloatArray, gate2: float
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """Mean truncated cost of each pair of track and target.

    `track`, `target`, `d2`, `weight` (m,) are plots against candidate targets (squared Mahalanobis distance; weight 1 / plots
    looked at of the track, so that plots without a reference are missing weight).  Returns (track, target, cost, share, seen)
    per pair (p,): the cost is the mean of min(d², gate²) over the plots that could be compared, `share` how much of these
    lies inside the gate, `seen` how much of the track could be compared.
    """
    span = int(target.max(initial=0)) + 1
    unique, pair = np.unique(track * span + target, return_inverse=True)
    total: FloatArray = np.bincount(pair, weight, len(unique)).astype(np.float64)
    cost = np.bincount(pair, weight * np.minimum(d2, gate2), len(unique)) / np.maximum(total, 1e-12)
    share = np.bincount(pair, weight * (d2 < gate2), len(unique)) / np.maximum(total, 1e-12)
    return unique // span, unique % span, cost, share, total


def assign(
    track: IntArray,
    target: IntArray,
    cost: FloatArray,
    weight: FloatArray,
    unassigned: float,
    start_s: FloatArray,
    end_s: FloatArray,
    overlap_s: float = 0.0,
    margin: float = 1.0,
) -> Decision:
    """The cheapest assignment of tracks to targets, with the choice to leave a track unassigned.

    `track`, `target`, `cost`, `weight` (p,) are candidate pairs (cost per plot, and how many plots it speaks for); a pair is
    used only if its cost is under `unassigned`.  `start_s`, `end_s` (k,) are each track's span: two tracks with one target
    may overlap by no more than `overlap_s`.  A track whose best target is taken is not pushed to a second one that is worse
    by `margin` or more: it stays unassigned.  Connected components are solved one by one with
    `scipy.optimize.linear_sum_assignment`; tracks of a target that follow each other are found in further rounds.
    """
    tracks = len(start_s)
    chosen = np.full(tracks, -1, np.int64)
    chosen_cost = np.full(tracks, np.nan)
    best = np.full(tracks, np.inf)
    np.minimum.at(best, track, cost)
    allowed = (cost < unassigned) & (cost <= best[track] + margin)
    rows = np.flatnonzero(allowed)
    gain = (unassigned - cost) * weight
    while len(rows):
        picked = _one_to_one(track[rows], target[rows], gain[rows])
        take = rows[picked]
        chosen[track[take]], chosen_cost[track[take]] = target[take], cost[take]
        # Another track of a target that is now taken stays a candidate only where the two do not meet in time.
        rows = rows[chosen[track[rows]] < 0]
        rows = rows[~_meets(track[rows], target[rows], chosen, start_s, end_s, overlap_s)]
    runner_up = np.full(tracks, np.inf)
    other = target != chosen[track]
    np.minimum.at(runner_up, track[other], cost[other])
    return Decision(chosen, chosen_cost, np.where(np.isfinite(runner_up), runner_up, np.nan))


def _meets(
    track: IntArray, target: IntArray, chosen: IntArray, start_s: FloatArray, end_s: FloatArray, overlap_s: float
) -> BoolArray:
    """Whether each candidate pair (p,) shares time with a track that already has its target."""
    taken = np.flatnonzero(chosen >= 0)
    by = taken[np.argsort(chosen[taken], kind="stable")]
    low, high = np.searchsorted(chosen[by], target, "left"), np.searchsorted(chosen[by], target, "right")
    count = high - low
    pair = np.repeat(np.arange(len(track)), count)
    other = by[np.repeat(low, count) + np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)]
    shared = np.minimum(end_s[track[pair]], end_s[other]) - np.maximum(start_s[track[pair]], start_s[other])
    out = np.zeros(len(track), bool)
    out[pair[shared > overlap_s]] = True
    return out


def _one_to_one(track: IntArray, target: IntArray, gain: FloatArray) -> IntArray:
    """The pairs (index into the arguments) of the assignment with the greatest total gain, all gains positive."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, row = np.unique(track, return_inverse=True)
    b, column = np.unique(target, return_inverse=True)
    links = coo_array((np.ones(len(row)), (row, column + len(a))), shape=(len(a) + len(b),) * 2)
    _, label = connected_components(links, directed=False)
    part = label[row]
    by = np.argsort(part, kind="stable")
    picked: list[IntArray] = []
    for members in np.split(by, np.flatnonzero(np.diff(part[by])) + 1):
        if len(members) == 1:
            picked.append(members)
            continue
        r, i = np.unique(row[members], return_inverse=True)
        c, j = np.unique(column[members], return_inverse=True)
        table = np.zeros((len(r), len(c)))
        index = np.full(table.shape, -1, np.int64)
        table[i, j], index[i, j] = gain[members], members
        at = linear_sum_assignment(table, maximize=True)
        # What the solver pairs with no gain stands for "unassigned".
        found = index[at]
        picked.append(found[found >= 0])
    return np.sort(np.concatenate(picked))
