"""Values and covariances from any frame to any other: polar about a site, east-north-up about a site, Earth-centred.

A frame knows only its way to Earth-centred axes and back, with the Jacobian of each; `convert` composes the two, so that every
pair of frames is served by one function (paper 004 section 2; METHODS section 1).  How a covariance goes through that map is the
method's affair: `Linear` is R2 = J R1 J', exact for linear maps and good for a single plot while
r (sd_E^2 + sd_A^2 cos^2 E) / (2 sd_r) is below about 0.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ._types import FloatArray
from .geodesy import rotate, rotate_back
from .measure import enu_from_polar, enu_jacobian, polar_from_enu, polar_jacobian

Map = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Values (n, 3) to values (n, 3) in another frame and the Jacobian (n, 3, 3) there."""


class Frame(Protocol):
    """A coordinate frame: the way to Earth-centred axes and back, each with its Jacobian."""

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3), ECEF metres, of values (n, 3), and d(position) / d(value) (n, 3, 3)."""
        ...

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (n, 3) of positions (n, 3), ECEF metres, and d(value) / d(position) (n, 3, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Ecef:
    """Earth-centred, Earth-fixed axes, metres."""

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The values themselves (n, 3), and unit matrices."""
        return value, np.broadcast_to(np.eye(3), (*value.shape, 3))

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The positions themselves (n, 3), and unit matrices."""
        return position, np.broadcast_to(np.eye(3), (*position.shape, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Enu:
    """East, north, up about a site, metres.  `site` is (3,) or (n, 3), ECEF; `rotation` is its ``enu_from_ecef``."""

    site: FloatArray
    rotation: FloatArray

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3), ECEF metres, and d(ECEF) / d(ENU)."""
        return self.site + rotate_back(self.rotation, value), np.broadcast_to(
            np.swapaxes(self.rotation, -1, -2), (*value.shape, 3)
        )

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """East, north, up (n, 3), and d(ENU) / d(ECEF)."""
        return rotate(self.rotation, position - self.site), np.broadcast_to(self.rotation, (*position.shape, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Polar:
    """Slant range, azimuth, elevation about a site (m, rad, rad).  `site` and `rotation` as for `Enu`."""

    site: FloatArray
    rotation: FloatArray

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3), ECEF metres, and d(ECEF) / d(range, azimuth, elevation)."""
        return (
            self.site + rotate_back(self.rotation, enu_from_polar(value)),
            np.swapaxes(self.rotation, -1, -2) @ enu_jacobian(value),
        )

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Range, azimuth, elevation (n, 3), and d(range, azimuth, elevation) / d(ECEF)."""
        enu = rotate(self.rotation, position - self.site)
        return polar_from_enu(enu), polar_jacobian(enu) @ self.rotation


class Method(Protocol):
    """How a value and its covariance go through a map."""

    def __call__(self, value: FloatArray, covariance: FloatArray, forward: Map) -> tuple[FloatArray, FloatArray]:
        """The value (n, 3) and covariance (n, 3, 3) behind the map."""
        ...


@dataclass(frozen=True, slots=True)
class Linear:
    """First order: the mapped value, and R2 = J R1 J' with J at the value given (paper 004 eq. 9)."""

    def __call__(self, value: FloatArray, covariance: FloatArray, forward: Map) -> tuple[FloatArray, FloatArray]:
        """The mapped value (n, 3) and its covariance (n, 3, 3)."""
        mapped, jacobian = forward(value)
        return mapped, propagate(jacobian, covariance)


def propagate(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """J R J' (n, m, m), exactly symmetric, of Jacobians (n, m, k) and covariances (n, k, k)."""
    out = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
    return np.asarray(0.5 * (out + np.swapaxes(out, -1, -2)))


def route(source: Frame, target: Frame) -> Map:
    """The map from one frame to another, with its Jacobian by the chain rule."""

    def forward(value: FloatArray) -> tuple[FloatArray, FloatArray]:
        position, outward = source.to_ecef(value)
        mapped, inward = target.from_ecef(position)
        return mapped, inward @ outward

    return forward


_LINEAR = Linear()


def convert(
    value: FloatArray, covariance: FloatArray, source: Frame, target: Frame, *, method: Method = _LINEAR
) -> tuple[FloatArray, FloatArray]:
    """Values (n, 3) and covariances (n, 3, 3) of one frame in another frame.

    Units are each frame's own (metres; metres and radians).  Covariances come out exactly symmetric.
    """
    return method(value, covariance, route(source, target))
