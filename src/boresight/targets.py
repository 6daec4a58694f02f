"""Which records of a reference are one target's."""

from __future__ import annotations

import numpy as np

from ._types import FloatArray, IntArray
from .model import Fixes

_TRACK_GAP_S = 300.0
_SAME_TRACK_S = 60.0
_KIND_MODE_S, _KIND_MMSI, _KIND_CALLSIGN, _KIND_TRACK = 0, 1, 2, 3


def targets_of(fixes: Fixes) -> IntArray:
    """The number of each fix's target (n,), 0 … count - 1; -1 where nothing tells.

    A target is told by its Mode S address, else MMSI, else callsign, else the source's track number.  A record without an
    address takes that of its own track number within a minute, or that of its callsign where only one address ever used it, so
    that the same aircraft in several recordings is one target.  Track numbers are used again: a pause of 5 minutes begins
    another target.  The numbers do not depend on the order of the records.
    """
    n = len(fixes)
    code = np.full(n, -1, np.int64)
    address = np.where((fixes.mode_s > 0) & (fixes.mode_s < 0xFFFFFF), fixes.mode_s.astype(np.int64), -1)
    code = np.where(address >= 0, address | _KIND_MODE_S << 56, code)
    code = np.where((code < 0) & (fixes.mmsi > 0), fixes.mmsi.astype(np.int64) | _KIND_MMSI << 56, code)

    has_track = fixes.track >= 0
    rows = np.flatnonzero(has_track)
    if len(rows) and (code[rows] < 0).any() and (code[rows] >= 0).any():
        time = np.where(np.isfinite(fixes.time_s[rows]), fixes.time_s[rows], -np.inf)
        order = rows[np.lexsort((rows, time, fixes.track[rows], fixes.source[rows]))]
        code[order] = _fill_from_neighbours(code[order], fixes.source[order], fixes.track[order], fixes.time_s[order])

    named = fixes.callsign >= 0
    both = named & (code >= 0)
    if both.any() and (named & (code < 0)).any():
        pairs = np.unique(np.stack([fixes.callsign[both], code[both]], axis=1), axis=0)
        name, first, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)
        name, owner = name[count == 1], pairs[first[count == 1], 1]
        rows = np.flatnonzero(named & (code < 0))
        if len(name):
            at = np.minimum(np.searchsorted(name, fixes.callsign[rows]), len(name) - 1)
            hit = name[at] == fixes.callsign[rows]
            code[rows[hit]] = owner[at[hit]]
    code = np.where((code < 0) & named, fixes.callsign | _KIND_CALLSIGN << 56, code)

    rows = np.flatnonzero((code < 0) & has_track)
    if len(rows):
        time = np.where(np.isfinite(fixes.time_s[rows]), fixes.time_s[rows], -np.inf)
        order = rows[np.lexsort((rows, time, fixes.track[rows], fixes.source[rows]))]
        new = np.r_[True, (np.diff(fixes.source[order]) != 0) | (np.diff(fixes.track[order]) != 0)]
        with np.errstate(invalid="ignore"):
            new[1:] |= np.diff(fixes.time_s[order]) > _TRACK_GAP_S
        code[order] = (np.cumsum(new) - 1) | _KIND_TRACK << 56
    known = code >= 0
    out = np.full(n, -1, np.int64)
    out[known] = np.unique(code[known], return_inverse=True)[1]
    return out


def _fill_from_neighbours(code: IntArray, source: IntArray, track: IntArray, time: FloatArray) -> IntArray:
    """Codes (n,) of rows sorted by source, track and time, with the missing ones taken from the nearest row of the same track."""
    n = len(code)
    index = np.arange(n)
    group = np.cumsum(np.r_[True, (np.diff(source) != 0) | (np.diff(track) != 0)])
    before = np.maximum.accumulate(np.where(code >= 0, index, -1))
    after = np.minimum.accumulate(np.where(code >= 0, index, n)[::-1])[::-1]

    def distance(other: IntArray) -> FloatArray:
        there = (other >= 0) & (other < n)
        at = np.where(there, other, 0)
        with np.errstate(invalid="ignore"):
            near = there & (group[at] == group) & (np.abs(time[at] - time) <= _SAME_TRACK_S)
            return np.where(near, np.abs(time[at] - time), np.inf)

    back, ahead = distance(before), distance(after)
    best = np.where(ahead < back, after, before)
    take = (code < 0) & np.isfinite(np.minimum(back, ahead))
    return np.where(take, code[np.where(take, best, 0)], code)
