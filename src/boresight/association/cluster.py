"""Association by K-medoids and the percentage of matches of tracks (paper 001, section 1.2; METHODS section 4).

It works for small biases only, and pairs many radar tracks that have no reference at all: a method to compare with.  The default
of the product is the search over biases of `hough`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from .._types import FloatArray, IntArray
from ..errors import InputError, SettingsError

_PASSES = 100


class Medoids(NamedTuple):
    """Clusters about points of their own: rows of the medoids (k,), the cluster (n,) of each point, the sum of distances, and
    how the search ended."""

    medoid: IntArray
    label: IntArray
    cost: float
    swaps: int
    ended: str


def k_medoids(distance: FloatArray, count: int, rng: np.random.Generator) -> Medoids:
    """K-medoids of a matrix of distances (n, n): FasterPAM (Schubert & Rousseeuw 2021), from a random start.

    A point takes the place of a medoid as soon as that lowers the sum of the distances to the nearest medoids; the search ends
    where no swap of one point for one medoid does.  Raises SettingsError for a count that is not within 1 … n, InputError for a
    matrix that is not square or holds what is no distance.
    """
    d = np.ascontiguousarray(distance, np.float64)
    n = len(d)
    if d.shape != (n, n) or not np.isfinite(d).all() or (d < 0).any():
        raise InputError(f"distances of the shape {d.shape} are not a square of finite numbers of 0 or more")
    if not 1 <= count <= n:
        raise SettingsError(
            f"{count} clusters of {n} points", where="k-medoids", remedy="Give at least 1, and no more than points."
        )
    medoid = np.sort(rng.choice(n, count, replace=False))
    near, first, second = _nearest(d, medoid)
    swaps, since, ended = 0, 0, "iteration limit"
    # What is lost by leaving each medoid out; a candidate's gain is summed up in one pass over the points.
    loss = np.bincount(near, second - first, count)
    for candidate in np.tile(np.arange(n), _PASSES):
        if since >= n:
            ended = "no swap lowers the cost"
            break
        since += 1
        if first[candidate] == 0.0 and candidate in medoid:
            continue
        to = d[candidate]
        closer = to < first
        change = np.where(closer, first - second, np.minimum(to - second, 0.0))
        by_medoid = loss + np.bincount(near, change, count)
        shared = float((to - first)[closer].sum())
        worst = int(by_medoid.argmin())
        if shared + by_medoid[worst] < -1e-12 * max(float(first.sum()), 1e-300):
            medoid[worst] = candidate
            near, first, second = _nearest(d, medoid)
            loss = np.bincount(near, second - first, count)
            swaps, since = swaps + 1, 0
    return Medoids(medoid, near, float(first.sum()), swaps, ended)


def _nearest(d: FloatArray, medoid: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Of each point its cluster (n,), and the distances of the nearest and the second nearest medoid."""
    to = d[medoid]
    near = to.argmin(axis=0)
    points = np.arange(d.shape[1])
    first = to[near, points]
    if len(medoid) == 1:
        return near, first, np.full_like(first, d.max() * 2 + 1)
    others = to.copy()
    others[near, points] = np.inf
    return near, first, others.min(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """Points of tracks: positions (n, 3), any Cartesian axes, and heights (n,), metres, times (n,), numbers of their tracks (n,).

    A height that is NaN passes every screen.
    """

    position: FloatArray
    height_m: FloatArray
    time_s: FloatArray
    track: IntArray

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if np.shape(self.position) != (n, 3) or np.shape(self.height_m) != (n,) or np.shape(self.track) != (n,):
            raise InputError("positions (n, 3), heights, times and tracks (n,) of traces do not fit")


class Matched(NamedTuple):
    """Of each radar track (m,): the reference's track that it belongs to (-1: none), its percentage of matches as a share, its
    votes, and its plots."""

    track: IntArray
    target: IntArray
    share: FloatArray
    votes: IntArray
    plots: IntArray


class TrackMatch(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="k-medoids"):
    """Clusters every scan's points of radar and reference, and lets a radar track's plots vote for the targets that they fall to.

    `period_s` is the scan, and the screen of time; points further than `height_limit_m` from every point of the other side are
    screened out.  A plot votes where all reference points of its cluster are of one target.  A track belongs to the target with
    the most votes where these are at least `threshold` of its votes, or of all its plots: the `denominator` decides everything,
    and the paper does not say which.  `clusters` is how many a scan is cut into (0: as many as it has targets; never more than
    it has points).  Raises SettingsError for values that make no sense.
    """

    period_s: float = 4.0
    height_limit_m: float = 500.0
    threshold: float = 0.85
    denominator: Literal["votes", "plots"] = "votes"
    clusters: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        for name, ok in (
            ("period_s", self.period_s > 0),
            ("height_limit_m", self.height_limit_m > 0),
            ("threshold", 0 < self.threshold <= 1),
            ("denominator", self.denominator in ("votes", "plots")),
            ("clusters", self.clusters >= 0),
            ("seed", self.seed >= 0),
        ):
            if not ok:
                raise SettingsError(f"{name} = {getattr(self, name)} makes no sense", where="k-medoids", remedy="Give another.")

    def __call__(self, radar: Traces, reference: Traces) -> Matched:
        """The matches, in order of the radar tracks' numbers."""
        rng = np.random.default_rng(self.seed)
        tracks, track = np.unique(radar.track, return_inverse=True)
        targets, target = np.unique(reference.track, return_inverse=True)
        votes = np.zeros((len(tracks), max(len(targets), 1)), np.int64)
        if len(radar.time_s) and len(reference.time_s):
            begin = min(radar.time_s.min(), reference.time_s.min())
            slot, other = (np.floor((t - begin) / self.period_s).astype(np.int64) for t in (radar.time_s, reference.time_s))
            for number in np.intersect1d(slot, other):
                self._vote(
                    radar, np.flatnonzero(slot == number), track, reference, np.flatnonzero(other == number), target, votes, rng
                )
        plots = np.bincount(track, minlength=len(tracks))
        most, best = votes.max(axis=1), votes.argmax(axis=1)
        given = votes.sum(axis=1) if self.denominator == "votes" else plots
        share = most / np.maximum(given, 1)
        found = (most > 0) & (share >= self.threshold)
        named = targets[best] if len(targets) else np.full(len(tracks), -1)
        return Matched(tracks, np.where(found, named, -1), share, votes.sum(axis=1), plots)

    def _vote(
        self,
        radar: Traces,
        mine: IntArray,
        track: IntArray,
        reference: Traces,
        theirs: IntArray,
        target: IntArray,
        votes: IntArray,
        rng: np.random.Generator,
    ) -> None:
        """Add the votes of one scan."""
        apart = np.abs(radar.height_m[mine][:, None] - reference.height_m[theirs])
        alike = np.isnan(apart) | (apart < self.height_limit_m)
        mine, theirs = mine[alike.any(axis=1)], theirs[alike.any(axis=0)]
        if not len(mine) or not len(theirs):
            return
        position = np.concatenate([radar.position[mine], reference.position[theirs]])
        off = position[:, None] - position
        distance = np.sqrt(np.einsum("ijk,ijk->ij", off, off))
        present = min(self.clusters or len(np.unique(target[theirs])), len(position))
        label = k_medoids(distance, present, rng).label
        own, of_reference = label[: len(mine)], label[len(mine) :]
        lowest, highest = np.full(present, np.iinfo(np.int64).max), np.full(present, -1)
        np.minimum.at(lowest, of_reference, target[theirs])
        np.maximum.at(highest, of_reference, target[theirs])
        alone = (lowest == highest)[own]
        np.add.at(votes, (track[mine[alone]], lowest[own[alone]]), 1)
