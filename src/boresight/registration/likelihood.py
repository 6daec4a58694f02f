"""Two baselines of paper 001: maximum likelihood (its reference [6]) and the Kalman transform matrix (its reference [7]).

The paper names both without their equations; what is built here is the plain reading: the polar bias and the noise that make the
differences from a trusted reference likeliest, and a transform matrix that a filter follows from the traffic of the last minute.
METHODS section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from .rigid import Clouds

# Fewer tracks tell less of how errors scatter than their pairs do.
_FEW_TRACKS = 12
_LEAST = 4
_NORMAL_SD_PER_MAD = 1.4826
# No plot is known better than this (m, rad, rad), however alike the differences are.
_FLOOR = np.array([1e-3, 1e-8, 1e-8])
# Positions are counted from the radar in units of so many metres, so that the entries of a transform are of one size.
SCALE_M = 50e3


@dataclass(frozen=True, slots=True, eq=False)
class PolarBias:
    """Constant errors measured - true in range (m), azimuth and elevation (rad), and how they were found.

    `value` (3,), `covariance` (3, 3) and `noise` (3, 3), the covariance of one plot's own error; NaN in what was not measured.
    `inliers` (n,) are the pairs it rests on, `log_likelihood` theirs, `ended` how the search ended.
    """

    value: FloatArray
    covariance: FloatArray
    noise: FloatArray
    inliers: BoolArray
    log_likelihood: float
    iterations: int
    ended: str


class MaximumLikelihood(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="maximum-likelihood"):
    """The constant polar bias and the noise that make the differences likeliest, by expectation and maximisation.

    A pair further than `gate_sd` standard deviations from the bias takes no part.
    """

    gate_sd: float = 6.0
    max_iterations: int = 100

    def __call__(self, difference: FloatArray, reference: FloatArray, track: IntArray) -> PolarBias:
        """From differences measured - reference (n, 3) in m, rad, rad, and covariances (n, 3, 3) of the reference alone.

        A column that is NaN throughout was not measured.  `track` (n,) names the target: errors are shared within it.  Raises
        SettingsError, and NothingToDo for fewer than four pairs.
        """
        if not self.gate_sd > 0 or self.max_iterations < 1:
            raise SettingsError(
                f"gate_sd = {self.gate_sd}, max_iterations = {self.max_iterations} make no sense",
                where="maximum-likelihood",
                remedy="Give a positive gate and at least one iteration.",
            )
        axes = np.flatnonzero(np.isfinite(difference).any(axis=0)) if len(difference) else np.arange(3)
        d, known = difference[:, axes], reference[:, axes[:, None], axes]
        used = np.isfinite(d).all(axis=1) & np.isfinite(known).all(axis=(1, 2))
        if used.sum() < _LEAST:
            raise NothingToDo(f"{int(used.sum())} pairs are too few for a bias and its noise", remedy="Give at least four pairs.")
        # A start that gross errors do not move.
        bias = np.median(d[used], axis=0)
        scale = np.maximum(_NORMAL_SD_PER_MAD * np.median(np.abs(d[used] - bias), axis=0), _FLOOR[axes])
        noise, inside, ended, steps = np.diag(scale**2), np.asarray(used), "iteration limit", 0
        while steps < self.max_iterations:
            steps += 1
            far = _distance(d - bias, noise + known)
            inside = np.asarray(used & (far <= self.gate_sd**2))
            weight = np.linalg.inv(noise + known[inside])
            information = weight.sum(axis=0)
            new = np.linalg.solve(information, np.einsum("nij,nj->i", weight, d[inside]))
            off = np.einsum("nij,nj->ni", weight, d[inside] - new) @ noise
            expected = off.T @ off / len(off) + noise - noise @ weight.mean(axis=0) @ noise
            expected = (expected + expected.T) / 2 + np.diag(_FLOOR[axes] ** 2)
            moved = np.abs(new - bias) / scale
            grown = np.abs(np.diag(expected) / np.diag(noise) - 1)
            bias, noise = new, expected
            if max(moved.max(), grown.max()) < 1e-9:
                ended = "converged"
                break
        off = d[inside] - bias
        spread = noise + known[inside]
        weight = np.linalg.inv(spread)
        bread = np.linalg.solve(weight.sum(axis=0), np.eye(len(axes)))
        covariance = bread
        _, number = np.unique(track[inside], return_inverse=True)
        groups = int(number.max()) + 1
        if groups > _FEW_TRACKS:
            score = np.zeros((groups, len(axes)))
            np.add.at(score, number, np.einsum("nij,nj->ni", weight, off))
            covariance = bread @ (score.T @ score) @ bread * groups / (groups - 1)
        _, log_size = np.linalg.slogdet(2 * np.pi * spread)
        likelihood = -0.5 * float((np.einsum("ni,nij,nj->n", off, weight, off) + log_size).sum())
        return PolarBias(_wide(bias, axes), _wide(covariance, axes), _wide(noise, axes), inside, likelihood, steps, ended)


def _distance(off: FloatArray, spread: FloatArray) -> FloatArray:
    """Squared statistical distances (n,); NaN rows are infinitely far."""
    known = np.isfinite(off).all(axis=1) & np.isfinite(spread).all(axis=(1, 2))
    out = np.full(len(off), np.inf)
    out[known] = np.einsum("ni,ni->n", off[known], np.linalg.solve(spread[known], off[known][..., None])[..., 0])
    return out


def _wide(value: FloatArray, axes: IntArray) -> FloatArray:
    """The value of some of three components among all three, NaN elsewhere."""
    out = np.full((3,) * value.ndim, np.nan)
    out[np.ix_(*(axes,) * value.ndim)] = value
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Transforms:
    """A transform matrix over time, and how it was found: corrected = z + H (z / 50 km, 1).

    `value` (k, 3, 4) is H after each of the `epoch_s` (k,), metres; `covariance` (k, 4, 4) is that of each row of it.  `inliers`
    (n,) are the pairs that were taken in.
    """

    epoch_s: FloatArray
    value: FloatArray
    covariance: FloatArray
    inliers: BoolArray
    ended: str

    def __call__(self, measured: FloatArray, time_s: FloatArray) -> FloatArray:
        """Corrected positions (n, 3), east, north, up about the radar, with what was known at each `time_s` (n,).

        Before the first epoch nothing is known, and nothing is corrected.
        """
        at = np.searchsorted(self.epoch_s, time_s, side="right") - 1
        value = np.where((at >= 0)[:, None, None], self.value[np.maximum(at, 0)], 0.0)
        return np.asarray(measured + np.einsum("nij,nj->ni", value, _regressor(measured)))


class KalmanTransform(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="kalman-transform"):
    """A transform matrix from the surrounding traffic's offsets, followed in real time.

    A Kalman filter in its information form over the twelve entries of H, each `prior_sd_m` at first; what is older than
    `memory_s` fades, so that H follows errors that change.  Plots have errors of `sd_m` an axis (0, where a calibration is made
    of a radar's pairs: as its kind has at the median range), those further than `gate_sd`
    from what H says take no part, and `slot_s` seconds of them are taken in at once.
    """

    memory_s: float = 60.0
    sd_m: float = 150.0
    prior_sd_m: float = 1000.0
    gate_sd: float = 6.0
    slot_s: float = 4.0

    def __call__(self, clouds: Clouds, time_s: FloatArray) -> Transforms:
        """From clouds and the times (n,) of their pairs.  Raises SettingsError, and NothingToDo without any pair."""
        for name in ("memory_s", "sd_m", "prior_sd_m", "gate_sd", "slot_s"):
            if not getattr(self, name) > 0:
                raise SettingsError(
                    f"{name} = {getattr(self, name)} is not positive", where="kalman-transform", remedy="Raise it."
                )
        finite = np.isfinite(clouds.measured).all(axis=1) & np.isfinite(clouds.reference).all(axis=1) & np.isfinite(time_s)
        rows = np.flatnonzero(finite)
        if not len(rows):
            raise NothingToDo("there is no pair to find a transform from", remedy="Give pairs of finite positions and times.")
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        slot = np.floor((time_s[rows] - time_s[rows[0]]) / self.slot_s).astype(np.int64)
        first = np.flatnonzero(np.diff(slot, prepend=-1))
        u = _regressor(clouds.measured[rows])
        e = (clouds.reference - clouds.measured)[rows]
        prior = np.eye(4) * (self.sd_m / self.prior_sd_m) ** 2
        information, known = prior.copy(), np.zeros((4, 3))
        inliers = np.zeros(len(clouds), bool)
        values, spreads, epochs = [], [], []
        last = 0
        for begin, end in zip(first, [*first[1:], len(rows)], strict=True):
            fade = np.exp(-(slot[begin] - last) * self.slot_s / self.memory_s)
            last = slot[begin]
            information, known = fade * information + (1 - fade) * prior, fade * known
            here, off = u[begin:end], e[begin:end]
            ahead = np.linalg.solve(information, np.concatenate([known, here.T], axis=1))
            innovation = off - here @ ahead[:, :3]
            room = 3 * self.sd_m**2 * (1 + np.einsum("ni,in->n", here, ahead[:, 3:]))
            good = np.einsum("ni,ni->n", innovation, innovation) <= self.gate_sd**2 * room
            inliers[rows[begin:end][good]] = True
            information = information + here[good].T @ here[good]
            known = known + here[good].T @ off[good]
            both = np.linalg.solve(information, np.concatenate([known, np.eye(4)], axis=1))
            values.append(both[:, :3].T)
            spreads.append((both[:, 3:] + both[:, 3:].T) / 2 * self.sd_m**2)
            epochs.append(time_s[rows[end - 1]])
        return Transforms(np.array(epochs), np.array(values), np.array(spreads), inliers, "end of data")


def _regressor(measured: FloatArray) -> FloatArray:
    return np.concatenate([measured / SCALE_M, np.ones((len(measured), 1))], axis=1)
