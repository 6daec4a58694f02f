"""Which track is which target: a truncated Mahalanobis cost over whole tracks, and the cheapest consistent assignment.

METHODS section 4.  The cost of a pair is the sum over the track's plots of min(d², gate²); leaving a track unassigned costs a
fixed amount per plot.  A target may be taken by several tracks of one radar, but never by two at the same time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import FloatArray, IntArray


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
    used only if its cost is under `unassigned`.  `start_s`, `end_s` (k,) are each track's span: two tracks of one target may
    overlap by no more than `overlap_s`.  A track whose best target is taken is not pushed to another that is worse by
    `margin` or more: it stays unassigned.

    What is maximised is the sum of (unassigned - cost) weight, exactly: candidates fall into connected components, in which
    tracks that all overlap are an assignment problem (`linear_sum_assignment`), and others a small integer program (`milp`):
    first giving each target its best track and then looking for more would force the second best on the rest.
    """
    chosen = np.full(len(start_s), -1, np.int64)
    chosen_cost = np.full(len(start_s), np.nan)
    best = np.full(len(start_s), np.inf)
    np.minimum.at(best, track, cost)
    rows = np.flatnonzero((cost < unassigned) & (cost <= best[track] + margin) & (weight > 0))
    rows = rows[np.lexsort((target[rows], track[rows]))]
    if len(rows):
        take = rows[_best(track[rows], target[rows], (unassigned - cost[rows]) * weight[rows], start_s, end_s, overlap_s)]
        chosen[track[take]], chosen_cost[track[take]] = target[take], cost[take]
    runner_up = np.full(len(start_s), np.inf)
    other = target != chosen[track]
    np.minimum.at(runner_up, track[other], cost[other])
    return Decision(chosen, chosen_cost, np.where(np.isfinite(runner_up), runner_up, np.nan))


def _best(
    track: IntArray, target: IntArray, gain: FloatArray, start_s: FloatArray, end_s: FloatArray, overlap_s: float
) -> IntArray:
    """The pairs (index into the arguments) of the assignment with the greatest total gain, all gains positive."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, row = np.unique(track, return_inverse=True)
    slot = _slots(track, target, start_s, end_s, overlap_s)
    rows = int(row.max()) + 1
    links = coo_array((np.ones(len(row)), (row, slot + rows)), shape=(rows + int(slot.max()) + 1,) * 2)
    _, label = connected_components(links, directed=False)
    part = label[row]
    by = np.argsort(part, kind="stable")
    picked: list[IntArray] = []
    for members in np.split(by, np.flatnonzero(np.diff(part[by])) + 1):
        if len(members) == 1:
            picked.append(members)
            continue
        start, end = start_s[track[members]], end_s[track[members]]
        together = np.minimum.reduce(end) - np.maximum.reduce(start) > overlap_s
        solve = _all_at_once if together else _over_time
        picked.append(members[solve(track[members], slot[members], gain[members], start, end, overlap_s)])
    return np.sort(np.concatenate(picked))


def _slots(track: IntArray, target: IntArray, start_s: FloatArray, end_s: FloatArray, overlap_s: float) -> IntArray:
    """A number (p,) for each target and stretch of time: candidates of one target in different slots never meet in time."""
    start, end = start_s[track], end_s[track] - overlap_s
    by = np.lexsort((start, target))
    width = float(max(end_s.max(), start_s.max()) - min(start_s.min(), end.min())) + 1.0
    low = float(min(start_s.min(), end.min()))
    # Shifting each target by more than the whole span lets one running maximum serve them all.
    begins, until = start[by] - low + target[by] * width, np.maximum.accumulate(end[by] - low + target[by] * width)
    new = np.r_[True, (np.diff(target[by]) != 0) | (begins[1:] >= until[:-1])]
    out = np.empty(len(track), np.int64)
    out[by] = np.cumsum(new) - 1
    return out


def _all_at_once(
    track: IntArray, slot: IntArray, gain: FloatArray, start: FloatArray, end: FloatArray, overlap_s: float
) -> IntArray:
    """One track a target: the assignment problem."""
    from scipy.optimize import linear_sum_assignment

    r, i = np.unique(track, return_inverse=True)
    c, j = np.unique(slot, return_inverse=True)
    table = np.zeros((len(r), len(c)))
    index = np.full(table.shape, -1, np.int64)
    table[i, j], index[i, j] = gain, np.arange(len(gain))
    found = index[linear_sum_assignment(table, maximize=True)]
    # What the solver pairs with no gain stands for "unassigned".
    return found[found >= 0]


def _over_time(
    track: IntArray, slot: IntArray, gain: FloatArray, start: FloatArray, end: FloatArray, overlap_s: float
) -> IntArray:
    """One track a target at any time: an integer program over the candidates.

    Intervals that pairwise overlap share a moment, and one of them begins then: a row for each beginning holds all conflicts.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    n = len(gain)
    of_track = np.unique(track)[:, None] == track[None, :]
    long = end - start > overlap_s
    begins = (slot[:, None] == slot[None, :]) & (start[None, :] <= start[:, None]) & (end[None, :] - start[:, None] > overlap_s)
    rows = np.unique(np.concatenate([of_track, begins[long] & long[None, :]]), axis=0).astype(np.float64)
    solved = milp(-gain, constraints=LinearConstraint(rows, -np.inf, 1.0), integrality=np.ones(n, np.int64), bounds=Bounds(0, 1))
    return np.flatnonzero(np.asarray(solved.x) > 0.5)
