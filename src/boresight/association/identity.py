"""Which tracks and targets call themselves the same, and which cannot be the same.

An identity is taken from a whole tracklet or target (the value that most of its records carry), so that one garbled reply
decides nothing.  Identity only proposes: geometry must agree before a pair is declared, because addresses are duplicated,
wrong, or reused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import AnyArray, BoolArray, IntArray
from ..model import Fixes, Plots

# Kinds of identity in the order of their trust.  A Mode 3/A code is reused all the time and counts as a hint only.
KINDS = ("Mode S", "MMSI", "callsign", "Mode 3/A")
_COLUMNS = ("mode_s", "mmsi", "callsign", "mode_3a")
MODE_3A = 3

# Octal codes that many aircraft share: conspicuity, VFR, emergencies.  A code ending in 00 is not discrete (ICAO Doc 4444).
_SHARED = (0o7000, 0o7001, 0o7004, 0o7010, 0o7500, 0o7600, 0o7700, 0o7777, 0o1000, 0o2000, 0o0000, 0o1200, 0o4000)


class Links(NamedTuple):
    """Pairs of equal identity: tracklet `track` (m,) and row number `target` (m,) agree in `kind` (m,), a row of `KINDS`."""

    track: IntArray
    target: IntArray
    kind: IntArray


def is_discrete(code: AnyArray) -> BoolArray:
    """Whether a Mode 3/A code (n,) (the number, as 0o1234) belongs to one aircraft at a time."""
    code = np.asarray(code, np.int64)
    return np.asarray((code > 0) & (code % 64 != 0) & ~np.isin(code, _SHARED))


def modal(value: AnyArray, start: IntArray) -> IntArray:
    """The commonest non-negative value of each group ``value[start[k]:start[k + 1]]`` (k,), -1 where a group has none.

    Of equally common ones the smallest.
    """
    groups = len(start) - 1
    out = np.full(groups, -1, np.int64)
    value = value.astype(np.int64)
    if not len(value) or value.max() < 0:
        return out
    known = value >= 0
    most = np.maximum.reduceat(value, start[:-1])
    least = np.minimum.reduceat(np.where(known, value, np.iinfo(np.int64).max), start[:-1])
    plain = most == least
    out[plain] = most[plain]
    # Only the groups that hold several values need counting.
    group = np.repeat(np.arange(groups), np.diff(start))
    mixed = known & ((most >= 0) & ~plain)[group]
    if np.any(mixed):
        by = np.lexsort((value[mixed], group[mixed]))
        g, v = group[mixed][by], value[mixed][by]
        first = np.flatnonzero(np.r_[True, (g[1:] != g[:-1]) | (v[1:] != v[:-1])])
        count = np.diff(np.r_[first, len(g)])
        best = np.lexsort((v[first], -count, g[first]))
        winner = best[np.r_[True, g[first][best][1:] != g[first][best][:-1]]]
        out[g[first][winner]] = v[first][winner]
    return out


class Names(NamedTuple):
    """The identities of groups: `value` (kinds, k), -1 where a group has none of that kind."""

    value: IntArray

    def known(self, kind: int) -> BoolArray:
        """Which groups (k,) carry an identity of this kind."""
        return np.asarray(self.value[kind] >= 0)


def names_of(table: Plots | Fixes, order: IntArray, start: IntArray) -> Names:
    """The identity of each group of rows ``order[start[k]:start[k + 1]]`` of a table."""
    value = np.stack([modal(getattr(table, column)[order], start) for column in _COLUMNS])
    value[MODE_3A, ~is_discrete(value[MODE_3A])] = -1
    return Names(value)


def names_of_targets(fixes: Fixes, target: IntArray) -> Names:
    """The identity of each target: `target` (n,) are the row numbers of the fixes' targets, 0 … k - 1; -1 belongs to none."""
    rows = np.flatnonzero(target >= 0)
    order = rows[np.argsort(target[rows], kind="stable")]
    count = int(target.max(initial=-1)) + 1
    start = np.searchsorted(target[order], np.arange(count + 1))
    if np.any(np.diff(start) == 0):
        # reduceat needs non-empty groups: targets without a fix get the name "none" by hand.
        filled = np.flatnonzero(np.diff(start) > 0)
        value = np.full((len(KINDS), count), -1, np.int64)
        value[:, filled] = names_of(fixes, order, np.r_[start[filled], len(order)]).value
        return Names(value)
    return names_of(fixes, order, start)


def links(tracks: Names, targets: Names, compatible: BoolArray) -> Links:
    """All pairs that agree in some kind of identity and overlap in time and identity (`compatible`, (tracks, targets)).

    A pair that agrees in several kinds is listed with the most trusted one.
    """
    kind = np.full(compatible.shape, -1, np.int8)
    for k in range(len(KINDS) - 1, -1, -1):
        a, b = tracks.value[k], targets.value[k]
        # Sorted lookup: a full table of comparisons would be slow for thousands of tracks and targets.
        rows = np.flatnonzero(a >= 0)
        by = np.argsort(b, kind="stable")
        low, high = np.searchsorted(b[by], a[rows], "left"), np.searchsorted(b[by], a[rows], "right")
        count = high - low
        track = np.repeat(rows, count)
        inside = np.arange(len(track)) - np.repeat(np.cumsum(count) - count, count)
        kind[track, by[np.repeat(low, count) + inside]] = k
    kind[~compatible] = -1
    track, target = np.nonzero(kind >= 0)
    return Links(track, target, kind[track, target].astype(np.int64))


def conflict(tracks: Names, targets: Names) -> BoolArray:
    """Which pairs (tracks, targets) cannot be the same: both carry a Mode S address (or an MMSI), and they differ."""
    out = np.zeros((tracks.value.shape[1], targets.value.shape[1]), bool)
    for k in (0, 1):
        a, b = tracks.value[k][:, None], targets.value[k][None, :]
        out |= (a >= 0) & (b >= 0) & (a != b)
    return out
