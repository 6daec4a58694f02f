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
# So many plots are set against all targets at a time.
_AT_ONCE = 4096


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
    """Clusters every radar plot with the reference about it, and lets a track's plots vote for the targets that they fall to.

    With a plot go those targets that have a fix within one scan (`period_s`) and within `height_limit_m` of its height: of each
    the fix nearest in time, since several fixes of one target would make a cluster of their own.  There are as many clusters as
    such targets (or `clusters`, if not 0; never more than points), and the plot votes where all reference points of its cluster
    are of one target.  A track belongs to the target with the most votes where these are at least `threshold` of its votes, or
    of all its plots: the `denominator` decides everything, and the paper does not say which.  Raises SettingsError for values
    that make no sense.
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
        tracks, track = np.unique(radar.track, return_inverse=True)
        targets = np.unique(reference.track)
        votes = self._votes(radar, track, len(tracks), reference)
        plots = np.bincount(track, minlength=len(tracks))
        most, best = votes.max(axis=1), votes.argmax(axis=1)
        given = votes.sum(axis=1) if self.denominator == "votes" else plots
        share = most / np.maximum(given, 1)
        found = (most > 0) & (share >= self.threshold)
        named = targets[best] if len(targets) else np.full(len(tracks), -1)
        return Matched(tracks, np.where(found, named, -1), share, votes.sum(axis=1), plots)

    def _votes(self, radar: Traces, track: IntArray, tracks: int, reference: Traces) -> IntArray:
        """How many plots of each track voted for each target (tracks, targets); one column of 0 without targets."""
        order = np.lexsort((reference.time_s, reference.track))
        begins = np.flatnonzero(np.diff(reference.track[order], prepend=np.nan))
        votes = np.zeros((tracks, max(len(begins), 1)), np.int64)
        if not len(begins):
            return votes
        rng = np.random.default_rng(self.seed)
        for some in np.array_split(np.arange(len(radar.time_s)), len(radar.time_s) // _AT_ONCE + 1):
            near = np.empty((len(begins), len(some)), np.int64)
            for k, own in enumerate(np.split(order, begins[1:])):
                near[k] = own[_nearest_in_time(reference.time_s[own], radar.time_s[some])]
            apart = np.abs(reference.height_m[near] - radar.height_m[some])
            alike = np.isnan(apart) | (apart < self.height_limit_m)
            alike &= np.abs(reference.time_s[near] - radar.time_s[some]) < self.period_s
            for at, plot in enumerate(some):
                target = np.flatnonzero(alike[:, at])
                if not len(target):
                    continue
                position = np.concatenate([radar.position[[plot]], reference.position[near[target, at]]])
                off = position[:, None] - position
                count = min(self.clusters or len(target), len(position))
                label = k_medoids(np.sqrt(np.einsum("ijk,ijk->ij", off, off)), count, rng).label
                own_cluster = target[label[1:] == label[0]]
                if len(own_cluster) == 1:
                    votes[track[plot], own_cluster[0]] += 1
        return votes


def _nearest_in_time(given_s: FloatArray, asked_s: FloatArray) -> IntArray:
    """Of each time asked for (m,) the row of the nearest of those given (n,), which ascend."""
    after = np.clip(np.searchsorted(given_s, asked_s), 1, max(len(given_s) - 1, 1))
    before = after - 1
    last = np.minimum(after, len(given_s) - 1)
    return np.where(asked_s - given_s[before] <= given_s[last] - asked_s, before, last)
