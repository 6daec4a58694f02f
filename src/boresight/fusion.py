"""Fusion of tracks: several estimates of one target's state, with covariances in one frame, into one.

A method is a value that is called with means (s, n, d) and covariances (s, n, d, d) of s sources (radars) for n states, and
gives a mean (n, d) and a covariance (n, d, d).  Tracks of one target share its process noise, so their errors correlate: `full`
and the rest take them as independent, `BarShalomCampo` is told the cross-covariance, and `CovarianceIntersection` holds
whatever it is.
Sources: paper 004 section 3.3 (equal and covariance-weighted fusion); Bar-Shalom & Campo 1986; Julier & Uhlmann 1997.
"""

from __future__ import annotations

import msgspec
import numpy as np

from ._types import FloatArray
from .errors import SettingsError

_CI_STEPS = 60


class Equal(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="equal"):
    """The plain mean of the sources."""

    def __call__(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d)."""
        mean, covariance = _checked(mean, covariance)
        s = len(mean)
        return mean.sum(axis=0) / s, covariance.sum(axis=0) / s**2


class TraceWeighted(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="trace"):
    """One weight a source: the inverse of the trace of its position covariance (the first `axes` coordinates)."""

    axes: int = 3

    def __call__(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d)."""
        mean, covariance = _checked(mean, covariance)
        k = min(self.axes, mean.shape[2])
        weight = 1.0 / np.maximum(np.trace(covariance[:, :, :k, :k], axis1=2, axis2=3), 1e-300)
        weight = weight / weight.sum(axis=0)
        return np.einsum("sn,snd->nd", weight, mean), np.einsum("sn,snab->nab", weight**2, covariance)


class DiagonalWeighted(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="diagonal"):
    """Every coordinate by the inverse of its own variance."""

    def __call__(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d)."""
        mean, covariance = _checked(mean, covariance)
        weight = 1.0 / np.maximum(np.diagonal(covariance, axis1=2, axis2=3), 1e-300)
        weight = weight / weight.sum(axis=0)
        return (weight * mean).sum(axis=0), np.einsum("sna,snab,snb->nab", weight, covariance, weight)


class FullWeighted(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="full"):
    """Each source by the inverse of its covariance: the best there is for independent errors.

    With covariances on wrong axes it is worse than the plain mean (METHODS section 1).
    """

    def __call__(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d)."""
        mean, covariance = _checked(mean, covariance)
        return _weighted(mean, covariance, np.ones(mean.shape[:2]))


class CovarianceIntersection(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="covariance-intersection"):
    """A weighted sum of informations, weights summing to 1: never too sure, whatever the sources' errors share.

    The weights minimise the trace of the first `axes` coordinates' covariance, by golden section, source after source.
    """

    axes: int = 3

    def __call__(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d)."""
        mean, covariance = _checked(mean, covariance)
        k = min(self.axes, mean.shape[2])
        fused, spread = mean[0], covariance[0]
        for other, its in zip(mean[1:], covariance[1:], strict=True):
            means, spreads = np.stack([fused, other]), np.stack([spread, its])

            def size(w: FloatArray, means: FloatArray = means, spreads: FloatArray = spreads) -> FloatArray:
                found = _weighted(means, spreads, np.stack([w, 1 - w]))[1]
                return np.asarray(np.trace(found[:, :k, :k], axis1=1, axis2=2))

            # The trace is convex in the weight, so that the ends may be among the answers too.
            low, high = np.full(len(fused), 1e-9), np.full(len(fused), 1 - 1e-9)
            golden = (np.sqrt(5) - 1) / 2
            a, b = high - golden * (high - low), low + golden * (high - low)
            size_a, size_b = size(a), size(b)
            for _ in range(_CI_STEPS):
                left = size_a < size_b
                high, low = np.where(left, b, high), np.where(left, low, a)
                a, b = high - golden * (high - low), low + golden * (high - low)
                size_a, size_b = size(a), size(b)
            w = (low + high) / 2
            fused, spread = _weighted(means, spreads, np.stack([w, 1 - w]))
        return fused, spread


class BarShalomCampo(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="bar-shalom-campo"):
    """Two sources whose errors correlate by a known cross-covariance (n, d, d): E[error 1 error 2'].

    `cross_covariance` of filters that see one target comes from `cross_covariance_step`, from measurement to measurement.
    """

    def __call__(self, mean: FloatArray, covariance: FloatArray, cross: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fused mean (n, d) and covariance (n, d, d).  Raises SettingsError unless there are two sources."""
        mean, covariance = _checked(mean, covariance)
        if len(mean) != 2:
            raise SettingsError(
                f"{len(mean)} sources", where="bar-shalom-campo", remedy="It fuses two; for more use covariance-intersection."
            )
        one, two = covariance
        back = np.swapaxes(cross, 1, 2)
        left = one - cross
        # W = (P1 - P12) (P1 + P2 - P12 - P21)^-1, by a solve of the transposed system.
        try:
            weight = np.swapaxes(np.linalg.solve(np.swapaxes(one + two - cross - back, 1, 2), np.swapaxes(left, 1, 2)), 1, 2)
        except np.linalg.LinAlgError:
            raise SettingsError(
                "the difference of the two tracks has no spread in some direction",
                where="bar-shalom-campo",
                remedy="Tracks that share all their errors are one track: take either.",
            ) from None
        fused = mean[0] + (weight @ (mean[1] - mean[0])[:, :, None])[:, :, 0]
        spread = one - weight @ np.swapaxes(left, 1, 2)
        return fused, (spread + np.swapaxes(spread, 1, 2)) / 2


def cross_covariance_step(
    cross: FloatArray, transition: FloatArray, noise: FloatArray, gain_one: FloatArray, gain_two: FloatArray, observe: FloatArray
) -> FloatArray:
    """The cross-covariance (n, d, d) of two filters' errors after both have taken in a measurement of one instant.

    P12 = (I - K1 H)(F P12 F' + Q)(I - K2 H)'; a gain of zeros is a filter without a measurement.
    """
    d = cross.shape[-1]
    ahead = transition @ cross @ np.swapaxes(transition, -1, -2) + noise
    left, right = np.eye(d) - gain_one @ observe, np.eye(d) - gain_two @ observe
    return np.asarray(left @ ahead @ np.swapaxes(right, -1, -2))


Fusion = Equal | TraceWeighted | DiagonalWeighted | FullWeighted | CovarianceIntersection


def _weighted(mean: FloatArray, covariance: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the weighted sum of informations; `weight` (s, n)."""
    d = mean.shape[2]
    scale = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3)).mean(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    scaled = covariance / scale[:, :, None] / scale[:, None, :]
    try:
        inverse = np.linalg.inv(scaled) * weight[:, :, None, None]
    except np.linalg.LinAlgError:
        raise SettingsError(
            "a covariance is singular", where="fusion", remedy="Leave out coordinates that others tell exactly."
        ) from None
    total = inverse.sum(axis=0)
    spread = np.linalg.solve(total, np.broadcast_to(np.eye(d), total.shape))
    fused = (spread @ np.einsum("snab,snb->na", inverse, mean / scale)[:, :, None])[:, :, 0] * scale
    spread = spread * scale[:, :, None] * scale[:, None, :]
    return fused, (spread + np.swapaxes(spread, 1, 2)) / 2


def _checked(mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean, covariance = np.asarray(mean, np.float64), np.asarray(covariance, np.float64)
    if mean.ndim != 3 or covariance.shape != (*mean.shape, mean.shape[-1]) or not len(mean):
        raise SettingsError(
            f"means {mean.shape} and covariances {covariance.shape} do not fit",
            where="fusion",
            remedy="Give (sources, states, d) and (sources, states, d, d).",
        )
    if not (np.diagonal(covariance, axis1=2, axis2=3) > 0).all():
        raise SettingsError(
            "a variance is zero, negative or no number", where="fusion", remedy="Leave out coordinates that are exactly known."
        )
    return mean, covariance
