"""Rigid registration of two clouds of positions: RANSAC, iterated closest points, and a genetic algorithm (paper 001; METHODS 4).

What a radar measured is turned about the radar and shifted until it lies on the reference: corrected = R z + t.  The rotation
is about the radar (about the Earth's centre 0.25 degrees would be 27.8 km), but parametrised about the cloud's centroid, where
it and the shift do not compete.  A rigid transform cannot represent a polar bias: these are methods to compare with, never the
default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import InputError, NothingToDo, SettingsError
from ..geodesy import height_and_up, rotate
from ..measure import from_true_north, position_from_height, position_from_polar, sensors_of, site_of
from ..model import Pairs, Sensors

# Minimal sets of pairs, the rows that a start is judged on, and Gauss-Newton steps that bring any turn below 30 degrees home.
_MINIMAL = 3
_JUDGED = 2000
_STEPS = 6
_TURN_SD_DEG = 1.0
_STALLED = 40
_SAME_SHARE = 1e-9
_FEW_TRACKS = 12
# The prior's own part of the scores' covariance is of the turns alone.
_TURNS = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Clouds:
    """Positions as measured and as the reference has them at the same times: (n, 3), east, north, up about the radar, metres.

    `track` (n,) names the target of each.
    """

    measured: FloatArray
    reference: FloatArray
    track: IntArray

    def __post_init__(self) -> None:
        n = len(self.measured)
        if np.shape(self.measured) != (n, 3) or np.shape(self.reference) != (n, 3) or np.shape(self.track) != (n,):
            raise InputError(
                f"clouds of the shapes {np.shape(self.measured)}, {np.shape(self.reference)} and tracks {np.shape(self.track)} "
                "do not fit",
                remedy="Give measured and reference positions (n, 3) and tracks (n,).",
            )

    def __len__(self) -> int:
        return len(self.measured)

    def take(self, rows: IntArray | BoolArray) -> Clouds:
        """Some of the pairs."""
        return Clouds(self.measured[rows], self.reference[rows], self.track[rows])


def clouds_of(pairs: Pairs, sensors: Sensors) -> Clouds:
    """The pairs of one radar as clouds about it; plots without an elevation are put at the reference's height.

    Raises InputError where the pairs are of several radars.
    """
    found = sensors_of(pairs.plots, sensors)
    if len(found) != 1:
        raise InputError(
            f"a rigid transform is of one radar, and these pairs are of {len(found)}", remedy="Give the pairs of one radar."
        )
    sensor = next(iter(found.values()))
    site, rotation = site_of(sensor)
    azimuth = from_true_north(pairs.plots.azimuth_rad, sensor)
    polar = np.stack([pairs.plots.range_m, azimuth, pairs.plots.elevation_rad], axis=1)
    level = ~np.isfinite(polar[:, 2])
    position = position_from_polar(np.where(level[:, None], 0.0, polar), site, rotation)
    if level.any():
        height, _ = height_and_up(pairs.position[level])
        position[level] = position_from_height(polar[level, 0], azimuth[level], height, site, rotation)
    return Clouds(rotate(rotation, position - site), rotate(rotation, pairs.position - site), pairs.target)


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A transform that corrects what was measured: ``centre + rotation (z - centre) + shift``, and how it was found.

    `covariance` (6, 6) is of the rotation vector (rad, right-hand rule, east north up) about `centre` and of `shift` (m),
    clustered by track; a turn that the cloud does not determine keeps the sd that it was assumed to have.  `inliers` (n,) are the
    pairs it rests on, `rms_m` their distance afterwards, `ended` how the search ended in a word or two.
    """

    rotation: FloatArray
    shift: FloatArray
    centre: FloatArray
    covariance: FloatArray
    inliers: BoolArray
    rms_m: float
    iterations: int
    ended: str

    @property
    def translation(self) -> FloatArray:
        """The shift t (3,) of ``R z + t``, with the rotation about the radar."""
        return np.asarray(self.centre + self.shift - self.rotation @ self.centre)

    @property
    def rotation_vector(self) -> FloatArray:
        """The rotation (3,), rad."""
        return _log(self.rotation)

    def __call__(self, measured: FloatArray) -> FloatArray:
        """Corrected positions (..., 3), east, north, up about the radar, metres."""
        return np.asarray(measured @ self.rotation.T + self.translation)


class _Solved(NamedTuple):
    """Batches of transforms about the centroids of their own pairs."""

    rotation: FloatArray
    shift: FloatArray
    centre: FloatArray


def joint_fit(clouds: Clouds) -> Rigid:
    """The least-squares rigid transform of all pairs of all tracks together, no pair left out.

    Raises NothingToDo for fewer than three pairs of finite positions.
    """
    used = _finite(clouds)
    return _finish(clouds, used, _one(_solve(clouds.measured[used][None], clouds.reference[used][None])), 1, "closed form")


class RansacIcp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="ransac-icp"):
    """Random samples give the start, iterated closest points refine it.

    `iterations` samples of three pairs; a pair within `distance_m` of the reference is an inlier, and a sample with the share
    `inlier_share` of them ends the search.  `pairing` is "time": a plot belongs to the reference at its own time; or "nearest":
    to the nearest point of the reference's whole cloud, as the paper has it, which on one straight track loses the whole offset
    along it (METHODS section 4).
    """

    iterations: int = 200
    distance_m: float = 2000.0
    inlier_share: float = 0.95
    pairing: Literal["time", "nearest"] = "time"
    max_refinements: int = 50
    seed: int = 1

    def __call__(self, clouds: Clouds) -> Rigid:
        """The transform.  Raises SettingsError, and NothingToDo for fewer than three pairs or inliers."""
        for name, value, ok in (
            ("iterations", self.iterations, self.iterations >= 1),
            ("distance_m", self.distance_m, self.distance_m > 0),
            ("inlier_share", self.inlier_share, 0 < self.inlier_share <= 1),
            ("pairing", self.pairing, self.pairing in ("time", "nearest")),
            ("max_refinements", self.max_refinements, self.max_refinements >= 1),
            ("seed", self.seed, self.seed >= 0),
        ):
            if not ok:
                raise SettingsError(f"{name} = {value} makes no sense", where="ransac-icp", remedy="See its documentation.")
        used = _finite(clouds)
        rows = np.flatnonzero(used)
        z, y = clouds.measured[rows], clouds.reference[rows]
        tree = None
        if self.pairing == "nearest":
            from scipy.spatial import KDTree

            tree = KDTree(y)
        start = self._start(z, y if tree is None else y[tree.query(z)[1]])
        return self._refine(clouds, rows, start, tree)

    def _start(self, z: FloatArray, y: FloatArray) -> _Solved:
        rng = np.random.default_rng(self.seed)
        draws = rng.integers(0, len(z), (self.iterations, _MINIMAL))
        tried = _solve(z[draws], y[draws])
        judged = rng.permutation(len(z))[:_JUDGED]
        best, most = 0, -1.0
        for k in range(self.iterations):
            off = _apply(tried, k, z[judged]) - y[judged]
            share = float((np.einsum("ni,ni->n", off, off) < self.distance_m**2).mean())
            if share > most:
                best, most = k, share
            if share >= self.inlier_share:
                break
        return _Solved(tried.rotation[best], tried.shift[best], tried.centre[best])

    def _refine(self, clouds: Clouds, rows: IntArray, found: _Solved, tree: Any) -> Rigid:
        z, y = clouds.measured[rows], clouds.reference[rows]
        before: IntArray | None = None
        inside: BoolArray = np.ones(len(z), np.bool_)
        target, ended, steps = y, "iteration limit", 0
        while steps < self.max_refinements:
            steps += 1
            moved = _moved(found, z)
            if tree is None:
                off = moved - y
                inside = np.asarray(np.einsum("ni,ni->n", off, off) < self.distance_m**2)
                now = np.flatnonzero(inside)
            else:
                distance, nearest = tree.query(moved)
                inside = distance < self.distance_m
                target, now = y[nearest], np.where(inside, nearest, -1)
            if inside.sum() < _MINIMAL:
                raise NothingToDo(
                    f"{int(inside.sum())} pairs lie within {self.distance_m:g} m of the reference, and three are needed",
                    remedy="Give a greater distance_m, or better pairs.",
                )
            if before is not None and np.array_equal(before, now):
                ended = "converged"
                break
            before = now
            found = _one(_solve(z[inside][None], target[inside][None]))
        paired = Clouds(clouds.measured, clouds.reference.copy(), clouds.track)
        paired.reference[rows] = target
        used = np.zeros(len(clouds), bool)
        used[rows[inside]] = True
        return _finish(paired, used, found, steps, ended)


class Genetic(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="genetic"):
    """A genetic algorithm over the rough transforms of the tracks (paper 001, section 2.1, step 5).

    Each track's own RANSAC-ICP transform is one of the first generation; what survives is what brings all tracks together nearest
    to their references.  It finds the joint least-squares fit to one or two per cent, later.
    """

    rough: RansacIcp = RansacIcp(iterations=50)
    population: int = 96
    generations: int = 400
    seed: int = 1

    def __call__(self, clouds: Clouds) -> Rigid:
        """The transform.  Raises SettingsError, and NothingToDo where no track has three pairs."""
        if self.population < 8 or self.generations < 1 or self.seed < 0:
            raise SettingsError(
                f"population = {self.population}, generations = {self.generations}, seed = {self.seed} make no sense",
                where="genetic",
                remedy="Give a population of at least 8, one generation and a seed of 0 or more.",
            )
        used = _finite(clouds)
        rough = []
        inliers = np.zeros(len(clouds), bool)
        for track in np.unique(clouds.track[used]):
            rows = np.flatnonzero(used & (clouds.track == track))
            if len(rows) < _MINIMAL:
                continue
            try:
                found = self.rough(clouds.take(rows))
            except NothingToDo:
                continue
            inliers[rows[found.inliers]] = True
            rough.append(found)
        if not rough:
            raise NothingToDo(
                "no track has three pairs within the distance", remedy="Give longer tracks, or a greater distance_m."
            )
        z, y = clouds.measured[inliers], clouds.reference[inliers]
        centre = z.mean(axis=0)
        genes = np.array([np.concatenate([f.rotation_vector, f(centre) - centre]) for f in rough])
        best, steps, ended = self._evolve(genes, z - centre, y - centre)
        return _finish(clouds, inliers, _Solved(_exp(best[:3]), best[3:], centre), steps, ended)

    def _evolve(self, first: FloatArray, q: FloatArray, y: FloatArray) -> tuple[FloatArray, int, str]:
        """The fittest genes (6,), the generations, and how it ended, from `q`, `y` (n, 3) about one centroid."""
        rng = np.random.default_rng(self.seed)
        n = len(q)
        # A sum of squares needs the clouds' moments only, whatever the number of pairs.
        cross, mean_y = q.T @ y / n, y.mean(axis=0)
        constant = float((np.einsum("ni,ni->", q, q) + np.einsum("ni,ni->", y, y)) / n)

        def cost(genes: FloatArray) -> FloatArray:
            shift = genes[:, 3:]
            turned = np.einsum("bij,ji->b", _exp(genes[:, :3]), cross)
            return np.asarray(constant - 2 * turned + np.einsum("bi,bi->b", shift, shift) - 2 * shift @ mean_y)

        genes = first[np.arange(self.population) % len(first)]
        copies = np.arange(self.population) >= len(first)
        spread = first.std(axis=0) if len(first) > 1 else np.array([1e-3] * 3 + [50.0] * 3)
        genes = genes + copies[:, None] * rng.normal(size=genes.shape) * spread
        score = cost(genes)
        best, waited = float(score.min()), 0
        for generation in range(1, self.generations + 1):
            rivals = rng.integers(0, self.population, (2, self.population, 3))
            mother, father = (r[np.arange(self.population), score[r].argmin(axis=1)] for r in rivals)
            # Blend crossover: anywhere between the parents and half as far beyond either.
            blend = rng.uniform(-0.5, 1.5, genes.shape)
            children = genes[mother] + blend * (genes[father] - genes[mother])
            mutated = rng.random(genes.shape) < 0.05
            children = children + mutated * rng.normal(size=genes.shape) * genes.std(axis=0)
            # The two fittest live on.
            elite = np.argsort(score, kind="stable")[:2]
            children[:2] = genes[elite]
            genes, score = children, cost(children)
            waited = 0 if score.min() < best * (1 - _SAME_SHARE) else waited + 1
            best = min(best, float(score.min()))
            if waited >= _STALLED:
                return genes[score.argmin()], generation, "stalled at the optimum"
        return genes[score.argmin()], self.generations, "generation limit"


def _finite(clouds: Clouds) -> BoolArray:
    used = np.isfinite(clouds.measured).all(axis=1) & np.isfinite(clouds.reference).all(axis=1)
    if used.sum() < _MINIMAL:
        raise NothingToDo(
            f"a rigid transform needs at least three pairs, and there are {int(used.sum())}",
            remedy="Give more pairs of positions.",
        )
    return np.asarray(used)


def _solve(z: FloatArray, y: FloatArray) -> _Solved:
    """Rigid transforms of batches of pairs (b, m, 3): least squares, with turns held near zero where the pairs tell nothing.

    About the centroid the shift is the difference of the means and the turn is alone: Gauss-Newton on three numbers.  A straight
    track says nothing of the turn about itself: a prior of one degree keeps that from being any turn at all.
    """
    centre = z.mean(axis=1)
    shift = y.mean(axis=1) - centre
    q, e = z - centre[:, None], y - (centre + shift)[:, None]
    rotation = np.tile(np.eye(3), (len(z), 1, 1))
    for _ in range(_STEPS):
        p = np.einsum("bij,bmj->bmi", rotation, q)
        left = e - p
        noise = np.einsum("bmi,bmi->b", left, left) / max(3 * z.shape[1] - 6, 1)
        outer = np.einsum("bmi,bmj->bij", p, p)
        size = np.einsum("bii->b", outer)
        # Where the pairs have no noise either, the prior still has to be seen beside the size of the cloud.
        held = noise / np.radians(_TURN_SD_DEG) ** 2 + 1e-9 + 1e-12 * size
        inertia = size[:, None, None] * np.eye(3) - outer
        pull = np.cross(p, left).sum(axis=1) - held[:, None] * _log(rotation)
        step = np.linalg.solve(inertia + held[:, None, None] * np.eye(3), pull[..., None])[..., 0]
        rotation = _exp(step) @ rotation
    return _Solved(rotation, shift, centre)


def _one(solved: _Solved) -> _Solved:
    return _Solved(solved.rotation[0], solved.shift[0], solved.centre[0])


def _moved(found: _Solved, z: FloatArray) -> FloatArray:
    return np.asarray((z - found.centre) @ found.rotation.T + found.centre + found.shift)


def _apply(tried: _Solved, k: int, z: FloatArray) -> FloatArray:
    return _moved(_Solved(tried.rotation[k], tried.shift[k], tried.centre[k]), z)


def _finish(clouds: Clouds, used: BoolArray, found: _Solved, iterations: int, ended: str) -> Rigid:
    """The transform about the centroid of the inliers, with its covariance clustered by track."""
    z, y = clouds.measured[used], clouds.reference[used]
    centre = z.mean(axis=0)
    shift = _moved(found, centre) - centre
    p = (z - centre) @ found.rotation.T
    e = y - centre - shift - p
    n = len(z)
    outer = p.T @ p
    noise = float(np.einsum("ni,ni->", e, e)) / max(3 * n - 6, 1)
    held = noise / np.radians(_TURN_SD_DEG) ** 2 + 1e-9 + 1e-12 * float(np.trace(outer))
    information = np.zeros((6, 6))
    information[:3, :3] = np.trace(outer) * np.eye(3) - outer + held * np.eye(3)
    information[3:, 3:] = n * np.eye(3)
    score = np.concatenate([np.cross(p, e), e], axis=1)
    _, number = np.unique(clouds.track[used], return_inverse=True)
    groups = int(number.max()) + 1
    by_track = np.zeros((groups, 6))
    np.add.at(by_track, number, score)
    bread = np.linalg.solve(information, np.eye(6))
    covariance = bread * noise
    # The scatter of few tracks tells less of the errors than that of their pairs does.
    if groups > _FEW_TRACKS:
        covariance = bread @ (by_track.T @ by_track + held * noise * _TURNS) @ bread * groups / (groups - 1)
    return Rigid(
        rotation=found.rotation,
        shift=shift,
        centre=centre,
        covariance=(covariance + covariance.T) / 2,
        inliers=used,
        rms_m=float(np.sqrt(np.einsum("ni,ni->", e, e) / n)),
        iterations=iterations,
        ended=ended,
    )


def _skew(v: FloatArray) -> FloatArray:
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def _exp(vector: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of rotation vectors (..., 3), rad: Rodrigues' formula."""
    angle = np.sqrt(np.einsum("...i,...i->...", vector, vector))[..., None, None]
    cross = _skew(vector)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + np.sinc(angle / 2 / np.pi) ** 2 / 2 * (cross @ cross))


def _log(rotation: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) of rotations below a half turn."""
    odd = rotation - np.swapaxes(rotation, -1, -2)
    axis = np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1) / 2
    sine = np.sqrt(np.einsum("...i,...i->...", axis, axis))
    angle = np.arctan2(sine, (np.einsum("...ii->...", rotation) - 1) / 2)
    return np.asarray(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0)[..., None])
