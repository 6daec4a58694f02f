"""Values and covariances from any frame to any other: geodetic, Earth-centred, east-north-up and polar about a site.

A frame knows only its way to Earth-centred axes and back, with the Jacobian of each; `convert` composes the two, so that every
pair of frames is served by one function (paper 004 section 2; METHODS section 1).  How a covariance goes through that map is the
method's affair.  `Linear` is R2 = J R1 J', exact for linear maps and good for one plot while `nonlinearity` is below 0.2, in a
filter below 0.05; `Unbiased`, `Multiplicative` and `Decorrelated` use the exact moments of a polar measurement;
`Automatic` chooses plot by plot.

A flat scene is the same with sites on a plane: ``Polar(site=(x, y, 0), rotation=I)``, whose "Earth-centred" axes are the
plane's.  Values (n, 2) are measurements without a third coordinate: it is zero and exactly known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ._jit import kernel
from ._parallel import in_threads, slices
from ._types import AnyArray, BoolArray, FloatArray, IntArray
from .errors import SettingsError
from .geodesy import E2, SEMI_MAJOR_M, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate, rotate_back
from .measure import enu_from_polar, enu_jacobian, polar_from_enu, polar_jacobian, wrap_rad

Map = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Values (n, 3) to values (n, 3) in another frame and the Jacobian (n, 3, 3) there."""

PLOT_LIMIT = 0.2
"""`nonlinearity` up to which one plot may be converted by `Linear` (its NEES is 3 + 2 beta^2; METHODS section 1)."""
TRACK_LIMIT = 0.05
"""`nonlinearity` up to which the plots of a filter may be converted by `Linear` (60 plots at 0.197 have a NEES of 3.92)."""
_CHUNK = 1 << 15
_PIECE = 1 << 11
# Nearer to the axis there is no azimuth (m).
_AXIS_M = 1e-2
# The mean square of any azimuth about one.
_ANY_AZIMUTH_RAD2 = np.pi**2 / 3
# An even number of nodes an axis: none lies on the vertical, where azimuth jumps.
_NODES = 14


class Frame(Protocol):
    """A coordinate frame: the way to Earth-centred axes and back, each with its Jacobian, and how values differ."""

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3), ECEF metres, of values (n, 3), and d(position) / d(value) (n, 3, 3)."""
        ...

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (n, 3) of positions (n, 3), ECEF metres, and d(value) / d(position) (n, 3, 3)."""
        ...

    def difference(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """``value - other`` (n, 3), angles the short way round."""
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

    def difference(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """``value - other`` (n, 3), metres."""
        return np.asarray(value - other)


@dataclass(frozen=True, slots=True)
class Geodetic:
    """Latitude, longitude (rad) and ellipsoidal height (m), WGS-84.  On the axis, longitude and its variance mean nothing."""

    def to_ecef(self, value: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (n, 3), ECEF metres, and d(ECEF) / d(latitude, longitude, height)."""
        lat, lon, h = value[..., 0], value[..., 1], value[..., 2]
        size = self._metres_per_radian(lat, h)
        axes = enu_from_ecef(lat, lon)
        jacobian = np.stack([axes[..., 1, :] * size[..., :1], axes[..., 0, :] * size[..., 1:], axes[..., 2, :]], axis=-1)
        return ecef_from_geodetic(lat, lon, h), jacobian

    def from_ecef(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Latitude, longitude, height (n, 3), and d(latitude, longitude, height) / d(ECEF)."""
        lat, lon, h = geodetic_from_ecef(position)
        size = np.maximum(self._metres_per_radian(lat, h), 1e-3)
        axes = enu_from_ecef(lat, lon)
        jacobian = np.stack([axes[..., 1, :] / size[..., :1], axes[..., 0, :] / size[..., 1:], axes[..., 2, :]], axis=-2)
        return np.stack([lat, lon, h], axis=-1), jacobian

    def difference(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """``value - other`` (n, 3), longitudes the short way round."""
        out = np.asarray(value - other)
        out[..., 1] = wrap_rad(out[..., 1])
        return out

    @staticmethod
    def _metres_per_radian(lat: FloatArray, h: FloatArray) -> FloatArray:
        """Metres per radian of latitude and of longitude (n, 2)."""
        w = 1 - E2 * np.sin(lat) ** 2
        return np.stack([SEMI_MAJOR_M * (1 - E2) / w**1.5 + h, (SEMI_MAJOR_M / np.sqrt(w) + h) * np.cos(lat)], axis=-1)


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

    def difference(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """``value - other`` (n, 3), metres."""
        return np.asarray(value - other)


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

    def difference(self, value: FloatArray, other: FloatArray) -> FloatArray:
        """``value - other`` (n, 3), azimuths the short way round."""
        out = np.asarray(value - other)
        out[..., 1] = wrap_rad(out[..., 1])
        return out


class Method(Protocol):
    """How values and their covariances go from one frame to another."""

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        ...


@dataclass(frozen=True, slots=True)
class Linear:
    """First order: the mapped value, and R2 = J R1 J' with J at the value given (paper 004 eqs. 9 to 13).

    Towards a polar frame, what lies over the radar or at it no further than its own spread has no derivative that means anything:
    its covariance is then that of the directions that the spread allows, up to pi^2 / 3 of an azimuth of which nothing is known.
    """

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        if isinstance(source, Polar) and isinstance(target, Ecef) and np.shape(source.site) == (3,):
            return _polar_to_ecef(value, covariance, source)
        mapped, jacobian = route(source, target)(value)
        spread = propagate(jacobian, covariance)
        if isinstance(target, Polar):
            rows = _overhead(mapped, spread)
            if rows.any():
                spread[rows] = _directions(value[rows], covariance[rows], at_rows(source, rows), at_rows(target, rows))
        return mapped, spread


@dataclass(frozen=True, slots=True)
class SecondOrder:
    """Second order: the mean moves by half the curvature, and the covariance gains half the curvature's square.

    Paper 004 eqs. 20 to 22 for normal errors: ``f + tr(H R) / 2`` and ``J R J' + tr(H_i R H_j R) / 2``.  Over a radar and at it,
    as `Linear`.
    """

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        forward = route(source, target)
        mapped, jacobian = forward(value)
        root = _root(covariance)
        # Curvature along the columns of the root: differences of exact Jacobians over a twentieth of a standard deviation.
        step = 0.05
        curve = np.empty((len(value), 3, 3, 3))
        for k in range(3):
            along = step * root[:, :, k]
            bend = forward(value + along)[1] - forward(value - along)[1]
            curve[:, :, :, k] = (bend @ root) / (2 * step)
        curve = (curve + np.swapaxes(curve, 2, 3)) / 2
        mean = mapped + np.trace(curve, axis1=2, axis2=3) / 2
        more = np.einsum("nabc,ndbc->nad", curve, curve) / 2
        linear = propagate(jacobian, covariance)
        spread = linear + (more + np.swapaxes(more, 1, 2)) / 2
        if isinstance(target, Polar):
            # Where there is no derivative there is no curvature either.
            rows = _overhead(mapped, linear)
            if rows.any():
                mean[rows] = mapped[rows]
                spread[rows] = _directions(value[rows], covariance[rows], at_rows(source, rows), at_rows(target, rows))
        return mean, spread


@dataclass(frozen=True, slots=True)
class Unscented:
    """2 n + 1 sigma points with the centre's weight kappa / (n + kappa), n the coordinates that are not exactly known.

    In hard three-dimensional cases kappa = 0 halves the variance along the line of sight; 1 does not (METHODS section 1).
    """

    kappa: float = 1.0

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame.  Raises SettingsError unless n + kappa > 0."""
        root = _root(covariance)
        used = np.flatnonzero((root != 0).any(axis=(0, 1)))
        n = max(len(used), 1)
        if n + self.kappa <= 0:
            raise SettingsError(
                f"kappa = {self.kappa} is too small for {n} coordinates", where="Unscented", remedy=f"Give more than {-n}."
            )
        spread = np.sqrt(n + self.kappa) * root
        points = [value, *(value + sign * spread[:, :, k] for k in used for sign in (1.0, -1.0))]
        weight = np.full(len(points), 0.5 / (n + self.kappa))
        weight[0] = 1.0 - weight[1:].sum()
        mapped = [target.from_ecef(source.to_ecef(p)[0])[0] for p in points]
        off = np.stack([target.difference(m, mapped[0]) for m in mapped])
        mean = np.einsum("k,kni->ni", weight, off)
        off = off - mean
        spread2 = np.einsum("k,kni,knj->nij", weight, off, off)
        return mapped[0] + mean, (spread2 + np.swapaxes(spread2, 1, 2)) / 2


@dataclass(frozen=True, slots=True)
class Unbiased:
    """A polar measurement divided by its mean shrinking, with the mean square error that is expected given the measurement.

    z / lambda, lambda = exp(-sd^2 / 2) for one angle: unbiased given the truth, and R holds what the measured direction is off by
    (Mo et al. 1998 in paper 004's list; here in three dimensions and for correlated errors).  From other frames, as `Linear`.
    """

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        if not isinstance(source, Polar):
            return Linear()(value, covariance, source, target)
        mean, spread = polar_moments(value, covariance)
        position, _ = _in_pieces(_debiased, value, covariance)
        off = position - mean
        return _from_site(position, spread + off[:, :, None] * off[:, None, :], source, target)


@dataclass(frozen=True, slots=True)
class Multiplicative:
    """The mean and covariance of the target's position given one polar measurement: z lambda, exact moments.

    The right start of a track, before any prediction exists.  From other frames, as `Linear`.
    """

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        if not isinstance(source, Polar):
            return Linear()(value, covariance, source, target)
        return _from_site(*polar_moments(value, covariance), source, target)


@dataclass(frozen=True, slots=True, eq=False)
class Decorrelated:
    """z / lambda with the covariance that the measurement has if the target is where it was `predicted` (n, 3), ECEF metres.

    Measurement and covariance then share no error, which alone keeps a filter consistent where `nonlinearity` is large
    (METHODS section 1).  From other frames, as `Linear`.
    """

    predicted: FloatArray

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        if not isinstance(source, Polar):
            return Linear()(value, covariance, source, target)
        there = source.from_ecef(np.asarray(self.predicted, np.float64))[0]
        position, _ = _in_pieces(_debiased, value, covariance)
        _, spread = _in_pieces(_debiased_spread, there, covariance)
        return _from_site(position, spread, source, target)


@dataclass(frozen=True, slots=True, eq=False)
class Automatic:
    """Plot by plot the simplest method that is good enough for its `nonlinearity`; `choose` tells which.

    A single plot is converted by `Linear` up to 0.2, beyond by `Multiplicative`.  With `in_track`, `Linear` serves up to 0.05,
    and beyond it `Decorrelated` at the `predicted` positions (n, 3), ECEF metres; where they are NaN (a track's first plot) or
    none are given, `Multiplicative`.  Towards a polar frame `SecondOrder` takes the place of both.  METHODS section 1.
    """

    in_track: bool = False
    predicted: FloatArray | None = None

    CHOICES = ("linear", "multiplicative", "decorrelated", "second_order")

    def choose(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> IntArray:
        """Index (n,) into `CHOICES` of each value's method."""
        beta = nonlinearity(value, covariance, source, target)
        hard = beta >= (TRACK_LIMIT if self.in_track else PLOT_LIMIT)
        if not isinstance(source, Polar):
            return np.where(hard, 3, 0)
        if not self.in_track or self.predicted is None:
            return np.where(hard, 1, 0)
        return np.where(hard, np.where(np.isfinite(self.predicted).all(axis=-1), 2, 1), 0)

    def __call__(self, value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> tuple[FloatArray, FloatArray]:
        """The values (n, 3) and covariances (n, 3, 3) in the target frame."""
        chosen = self.choose(value, covariance, source, target)
        out, spread = np.empty_like(value), np.empty_like(covariance)
        for k in np.unique(chosen).tolist():
            rows = chosen == k
            predicted = self.predicted[rows] if self.predicted is not None else value[rows]
            method = (Linear(), Multiplicative(), Decorrelated(predicted), SecondOrder())[k]
            out[rows], spread[rows] = method(value[rows], covariance[rows], at_rows(source, rows), at_rows(target, rows))
        return out, spread


def nonlinearity(value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> FloatArray:
    """How much a covariance bends on its way (n,): the sagitta of the cross-range spread over the sd along the line of sight.

    beta = r (sd_E^2 + sd_A^2 cos^2 E) / (2 sd_r) from a polar frame; the same of the Cartesian spread towards one; else 0.  The
    NEES of one plot converted by `Linear` is 3 + 2 beta^2 (METHODS section 1).  Infinite where only sd_r is 0.
    """
    if isinstance(source, Polar):
        across = value[:, 0] * (covariance[:, 2, 2] + covariance[:, 1, 1] * np.cos(value[:, 2]) ** 2)
        along = covariance[:, 0, 0]
    elif isinstance(target, Polar):
        position, outward = source.to_ecef(value)
        sight = rotate(target.rotation, position - target.site)
        size = np.maximum(np.sqrt((sight**2).sum(axis=-1)), 1e-3)
        spread = propagate(target.rotation @ outward, covariance)
        along = np.einsum("ni,nij,nj->n", sight, spread, sight) / size**2
        across = (np.trace(spread, axis1=1, axis2=2) - along) / size
    else:
        return np.zeros(len(value))
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = np.abs(across) / (2 * np.sqrt(along))
    return np.where(across == 0, 0.0, beta)


def at_rows(frame: Frame, rows: BoolArray | slice | IntArray) -> Frame:
    """The frame of some of the values: where its site is one for each value, only theirs."""
    if isinstance(frame, (Enu, Polar)) and np.ndim(frame.site) == 2:
        return type(frame)(frame.site[rows], frame.rotation[rows])
    return frame


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


def _overhead(mapped: FloatArray, spread: FloatArray) -> BoolArray:
    """Which polar values (n, 3) with `spread` by the linear rule lie so near the axis, or the radar, that the rule fails (n,)."""
    level = np.cos(mapped[:, 2])
    # Three standard deviations, along each of the axes, from a place where directions turn over.
    over = (spread[:, 0, 0] > mapped[:, 0] ** 2 / 9) | (spread[:, 1, 1] > 1 / 9) | (spread[:, 2, 2] > level**2 / 9)
    return np.asarray(over | (mapped[:, 0] * level < _AXIS_M))


def _directions(value: FloatArray, covariance: FloatArray, source: Frame, target: Frame) -> FloatArray:
    """Covariance (n, 3, 3) of range, azimuth, elevation about `target` where a spread reaches over the radar, or holds it.

    Mean squares about the mapped value over a normal position, by Gauss and Hermite's rule; an azimuth's no larger than that of
    any, which it is where even the spread does not tell a direction.
    """
    assert isinstance(target, Polar)
    one, share = np.polynomial.hermite_e.hermegauss(_NODES)
    node = np.stack(np.meshgrid(one, one, one, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = np.einsum("i,j,k->ijk", share, share, share).ravel() / share.sum() ** 3
    position, outward = source.to_ecef(value)
    enu = rotate(target.rotation, position - target.site)
    root = _root(propagate(target.rotation @ outward, covariance))
    mapped = polar_from_enu(enu)
    out = np.empty((len(value), 3, 3))

    def piece(rows: slice) -> None:
        off = polar_from_enu(enu[rows, None] + node @ np.swapaxes(root[rows], 1, 2)) - mapped[rows, None]
        off[..., 1] = wrap_rad(off[..., 1])
        spread = np.swapaxes(off, 1, 2) @ (off * weight[:, None])
        lost = np.hypot(enu[rows, 0], enu[rows, 1]) < _AXIS_M
        spread[lost, 1, :2] = spread[lost, :2, 1] = spread[lost, 1, 2] = spread[lost, 2, 1] = 0.0
        fade = np.sqrt(np.minimum(_ANY_AZIMUTH_RAD2 / np.maximum(spread[:, 1, 1], 1e-300), 1.0))
        spread[:, 1] *= fade[:, None]
        spread[:, :, 1] *= fade[:, None]
        spread[lost, 1, 1] = _ANY_AZIMUTH_RAD2
        out[rows] = (spread + np.swapaxes(spread, 1, 2)) / 2

    in_threads(piece, slices(len(value), _PIECE >> 5))
    return out


_LINEAR = Linear()


def convert(
    value: FloatArray, covariance: FloatArray, source: Frame, target: Frame, *, method: Method = _LINEAR
) -> tuple[FloatArray, FloatArray]:
    """Values (n, 3) and covariances (n, 3, 3) of one frame in another frame.

    Units are each frame's own (metres; metres and radians).  Covariances come out exactly symmetric.  Values (n, 2) with
    covariances (n, 2, 2) have no third coordinate: it is zero and exactly known, and is left out of the result again.  A value
    that is not a number gives no number.  Raises SettingsError for shapes that do not fit and for covariances that are none
    (not symmetric, a negative variance, a correlation beyond 1, a negative variance in another direction), with the row.
    """
    value, covariance = np.asarray(value, np.float64), np.asarray(covariance, np.float64)
    n, d = value.shape if value.ndim == 2 else (0, 0)
    if d not in (2, 3) or covariance.shape != (n, d, d):
        raise SettingsError(
            f"values {value.shape} and covariances {covariance.shape} do not fit",
            where="convert",
            remedy="Give (n, 3) and (n, 3, 3), or (n, 2) and (n, 2, 2).",
        )
    flat = d == 2 and isinstance(method, Linear) and isinstance(target, Ecef)
    if flat and isinstance(source, Polar) and np.shape(source.site) == (3,):
        covariance = np.ascontiguousarray(covariance)
        _check_covariance(covariance)
        return _plane_to_ecef(np.ascontiguousarray(value), covariance, source)
    if d == 2:
        value = np.concatenate([value, np.zeros((n, 1))], axis=1)
        covariance = np.pad(covariance, ((0, 0), (0, 1), (0, 1)))
    _check_covariance(covariance)
    mapped, spread = method(value, covariance, source, target)
    return mapped[:, :d], spread[:, :d, :d]


_FAULTS = (
    "has a negative variance", "is not symmetric", "holds a correlation beyond 1", "is infinite",
    "is not positive semidefinite: its correlations contradict each other",
)  # fmt: skip


def _check_covariance(covariance: FloatArray) -> None:
    """Raise SettingsError, naming the row, for matrices that are no covariances; those that hold NaN pass."""
    found = in_threads(lambda rows: _first_fault(covariance[rows]), slices(len(covariance), _CHUNK))
    for piece, (row, what) in enumerate(found):
        if row >= 0:
            raise SettingsError(
                f"the covariance of row {piece * _CHUNK + row} {_FAULTS[what]}",
                where="convert",
                remedy="Give variances on the diagonal, in the units of the source frame squared.",
            )


@kernel
def _first_fault(covariance: FloatArray) -> tuple[int, int]:
    """The first row of (n, d, d) that is no covariance, and which of `_FAULTS` it has; (-1, 0) for none."""
    for k in range(covariance.shape[0]):
        for i in range(covariance.shape[1]):
            if covariance[k, i, i] < 0:
                return k, 0
            for j in range(i):
                one, other = covariance[k, i, j], covariance[k, j, i]
                square = covariance[k, i, i] * covariance[k, j, j]
                if abs(one - other) > 1e-9 * np.sqrt(square):
                    return k, 1
                if one * one > (1 + 1e-9) * square:
                    return k, 2
        for i in range(covariance.shape[1]):
            if np.isinf(covariance[k, i, i]):
                return k, 3
        if covariance.shape[1] == 3:
            a, b, c = covariance[k, 0, 0], covariance[k, 1, 1], covariance[k, 2, 2]
            d, e, f = covariance[k, 0, 1], covariance[k, 0, 2], covariance[k, 1, 2]
            if a * b * c + 2 * d * e * f - a * f * f - b * e * e - c * d * d < -1e-8 * a * b * c:
                return k, 4
    return -1, 0


def _root(covariance: FloatArray) -> FloatArray:
    """L (n, 3, 3) with L L' the covariance; directions that are exactly known have zero columns, the first ones."""
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    size = np.where(sd > 0, sd, 1.0)
    bad = np.isnan(size.sum(axis=1))
    scaled = np.where(bad[:, None, None], np.eye(3), covariance / size[:, :, None] / size[:, None, :])
    variance, axes = np.linalg.eigh(scaled)
    variance[variance < 1e-13] = 0.0
    out: FloatArray = size[:, :, None] * axes * np.sqrt(variance)[:, None, :]
    out[bad] = np.nan
    return out


# -------------------------------------------------------------------------------------- exact moments of a polar measurement
# East, north and up are sums of terms r exp(i u) with u = a A + b E: their (a, b), and the coefficients of each axis.
_TURNS = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, -1)], np.float64)
_AXES = np.array([[-0.25j, -0.25j, 0.25j, 0.25j, 0, 0], [0.25, 0.25, 0.25, 0.25, 0, 0], [0, 0, 0, 0, -0.5j, 0.5j]])


def _turned(value: FloatArray, covariance: FloatArray) -> tuple[AnyArray, FloatArray, FloatArray, FloatArray]:
    """Of the six terms: exp(i u) (n, 6), covariance of r and u (n, 6), covariances of u (n, 6, 6), and exp(-var u / 2) (n, 6)."""
    phase = np.exp(1j * (value[:, 1:] @ _TURNS.T))
    with_range = covariance[:, 0, 1:] @ _TURNS.T
    among = _TURNS @ covariance[:, 1:, 1:] @ _TURNS.T
    return phase, with_range, among, np.exp(-np.diagonal(among, axis1=1, axis2=2) / 2)


def _spread(terms: AnyArray) -> FloatArray:
    """The covariance (n, 3, 3) of east, north, up from that of their terms (n, 6, 6)."""
    out = np.real(_AXES @ terms @ _AXES.T)
    return np.asarray((out + np.swapaxes(out, 1, 2)) / 2)


def polar_moments(value: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, 3) and covariance (n, 3, 3), east, north, up about the radar, of normally distributed range, azimuth, elevation.

    Exact for any size of error and any correlation: r exp(i u) of a normal (r, u) has closed moments.  Differences of nearly
    equal numbers are taken before they arise, so that small errors keep their digits.
    """
    return _in_pieces(_moments, value, covariance)


def _moments(value: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    phase, c, among, shrink = _turned(value, covariance)
    r, variance = value[:, 0, None, None], covariance[:, 0, 0, None, None]
    mean = np.real(((value[:, :1] + 1j * c) * shrink * phase) @ _AXES.T)
    both, product = c[:, :, None] + c[:, None, :], c[:, :, None] * c[:, None, :]
    square = r**2 + 2j * r * both - both**2 + variance
    terms = np.expm1(-among) * square + (1j * r * both - both**2 + product + variance)
    turned = shrink * phase
    return mean, _spread(turned[:, :, None] * turned[:, None, :] * terms)


def _debiased(value: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The position (n, 3), east, north, up, whose mean over measurements of one target is the target's; no covariance."""
    phase, c, _, shrink = _turned(value, covariance)
    return np.real(((value[:, :1] - 1j * c) * phase / shrink) @ _AXES.T), covariance[:, :0]


def _debiased_spread(truth: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The truth, and the covariance (n, 3, 3) of `_debiased` over measurements of a target there (n, 3), polar."""
    phase, c, among, _ = _turned(truth, covariance)
    r, variance = truth[:, 0, None, None], covariance[:, 0, 0, None, None]
    both, product = c[:, :, None] + c[:, None, :], c[:, :, None] * c[:, None, :]
    terms = r**2 * np.expm1(-among) + np.exp(-among) * (1j * r * both + variance - product)
    return truth, _spread(phase[:, :, None] * phase[:, None, :] * terms)


def _in_pieces(
    function: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]], value: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`function` over all rows, a piece at a time: its terms are thirty times as large as its result."""
    if len(value) <= _PIECE:
        return function(value, covariance)
    parts = in_threads(lambda rows: function(value[rows], covariance[rows]), slices(len(value), _PIECE))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _from_site(enu: FloatArray, spread: FloatArray, source: Polar, target: Frame) -> tuple[FloatArray, FloatArray]:
    return Linear()(enu, spread, Enu(source.site, source.rotation), target)


# ------------------------------------------------------------------------------------------------- the linear rule, in bulk
# The parts of pi / 2, of 33 bits each but the last: the first two times a whole number below 2^20 are exact.
_PI_2 = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
_BLOCK = 256
_FAR_RAD = 1e5


@kernel
def _sines(angle: FloatArray, sine: FloatArray, cosine: FloatArray) -> None:
    """Fill sine and cosine of angles (m,) to the last digit but one, many at a time: no branch keeps the compiler from it."""
    for k in range(angle.shape[0]):
        x = angle[k]
        n = np.floor(x * 0.6366197723675814 + 0.5)
        y = ((x - n * _PI_2[0]) - n * _PI_2[1]) - n * _PI_2[2]
        z = y * y
        # Taylor's series, which end below 5e-17 on +- pi / 4.
        s = ((2.8114572543455206e-15 * z - 7.647163731819816e-13) * z + 1.6059043836821613e-10) * z - 2.505210838544172e-08
        s = ((s * z + 2.7557319223985893e-06) * z - 1.984126984126984e-04) * z + 8.333333333333333e-03
        s = y + y * z * (s * z - 1.6666666666666666e-01)
        c = ((-1.5619206968586225e-16 * z + 4.779477332387385e-14) * z - 1.1470745597729725e-11) * z + 2.08767569878681e-09
        c = ((c * z - 2.755731922398589e-07) * z + 2.48015873015873e-05) * z - 1.388888888888889e-03
        c = 1.0 - 0.5 * z + z * z * (c * z + 4.1666666666666664e-02)
        # Which quarter turn: the two change places in every other one, and signs after two.
        half = np.floor(0.5 * n)
        odd = n - 2.0 * half
        even = 1.0 - odd
        turned = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
        sine[k] = turned * (even * s + odd * c)
        cosine[k] = turned * (even * c - odd * s)


@kernel
def _linear_rows(
    value: FloatArray, covariance: FloatArray, site: FloatArray, rotation: FloatArray, out: FloatArray, spread: FloatArray
) -> None:
    """Fill ECEF positions (n, 3) and J R J' (n, 3, 3) of polar values (n, 3) with covariances (n, 3, 3) about one site."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    sine, cosine, angle = np.empty(2 * _BLOCK), np.empty(2 * _BLOCK), np.zeros(2 * _BLOCK)
    for begin in range(0, value.shape[0], _BLOCK):
        count = min(_BLOCK, value.shape[0] - begin)
        far = False
        for h in range(count):
            angle[h], angle[_BLOCK + h] = value[begin + h, 1], value[begin + h, 2]
            far |= abs(value[begin + h, 1]) > _FAR_RAD or abs(value[begin + h, 2]) > _FAR_RAD
        if far:
            for h in range(2 * _BLOCK):
                sine[h], cosine[h] = np.sin(angle[h]), np.cos(angle[h])
        else:
            _sines(angle, sine, cosine)
        for h in range(count):
            k = begin + h
            r = value[k, 0]
            sa, ca, se, ce = sine[h], cosine[h], sine[_BLOCK + h], cosine[_BLOCK + h]
            # Unit vectors along range, azimuth and elevation, ECEF; the latter two times their arms are the Jacobian's columns.
            x0, x1, x2 = ce * sa, ce * ca, se
            out[k, 0] = site[0] + r * (x0 * r00 + x1 * r10 + x2 * r20)
            out[k, 1] = site[1] + r * (x0 * r01 + x1 * r11 + x2 * r21)
            out[k, 2] = site[2] + r * (x0 * r02 + x1 * r12 + x2 * r22)
            j00, j10, j20 = x0 * r00 + x1 * r10 + x2 * r20, x0 * r01 + x1 * r11 + x2 * r21, x0 * r02 + x1 * r12 + x2 * r22
            g = r * ce
            j01, j11, j21 = g * (ca * r00 - sa * r10), g * (ca * r01 - sa * r11), g * (ca * r02 - sa * r12)
            y0, y1, y2 = -r * se * sa, -r * se * ca, r * ce
            j02, j12, j22 = y0 * r00 + y1 * r10 + y2 * r20, y0 * r01 + y1 * r11 + y2 * r21, y0 * r02 + y1 * r12 + y2 * r22
            p00, p01, p02 = covariance[k, 0, 0], covariance[k, 0, 1], covariance[k, 0, 2]
            p11, p12, p22 = covariance[k, 1, 1], covariance[k, 1, 2], covariance[k, 2, 2]
            m00, m01, m02 = (
                j00 * p00 + j01 * p01 + j02 * p02,
                j00 * p01 + j01 * p11 + j02 * p12,
                j00 * p02 + j01 * p12 + j02 * p22,
            )
            m10, m11, m12 = (
                j10 * p00 + j11 * p01 + j12 * p02,
                j10 * p01 + j11 * p11 + j12 * p12,
                j10 * p02 + j11 * p12 + j12 * p22,
            )
            m20, m21, m22 = (
                j20 * p00 + j21 * p01 + j22 * p02,
                j20 * p01 + j21 * p11 + j22 * p12,
                j20 * p02 + j21 * p12 + j22 * p22,
            )
            spread[k, 0, 0] = m00 * j00 + m01 * j01 + m02 * j02
            spread[k, 1, 1] = m10 * j10 + m11 * j11 + m12 * j12
            spread[k, 2, 2] = m20 * j20 + m21 * j21 + m22 * j22
            s01 = m00 * j10 + m01 * j11 + m02 * j12
            s02 = m00 * j20 + m01 * j21 + m02 * j22
            s12 = m10 * j20 + m11 * j21 + m12 * j22
            spread[k, 0, 1], spread[k, 1, 0] = s01, s01
            spread[k, 0, 2], spread[k, 2, 0] = s02, s02
            spread[k, 1, 2], spread[k, 2, 1] = s12, s12


def _polar_to_ecef(value: FloatArray, covariance: FloatArray, source: Polar) -> tuple[FloatArray, FloatArray]:
    """`Linear` from a polar frame at one site to Earth-centred axes."""
    v, p = np.ascontiguousarray(value, np.float64), np.ascontiguousarray(covariance, np.float64)
    site, rotation = np.ascontiguousarray(source.site, np.float64), np.ascontiguousarray(source.rotation, np.float64)
    out, spread = np.empty((len(v), 3)), np.empty((len(v), 3, 3))

    def piece(part: slice) -> None:
        _linear_rows(v[part], p[part], site, rotation, out[part], spread[part])

    in_threads(piece, slices(len(v), _CHUNK))
    return out, spread


@kernel
def _plane_rows(
    value: FloatArray, covariance: FloatArray, site: FloatArray, rotation: FloatArray, out: FloatArray, spread: FloatArray
) -> None:
    """As `_linear_rows` for range and azimuth (n, 2) at elevation 0: the first two of the Earth-centred axes."""
    sine, cosine, angle = np.empty(_BLOCK), np.empty(_BLOCK), np.zeros(_BLOCK)
    r00, r01, r10, r11 = rotation[0, 0], rotation[0, 1], rotation[1, 0], rotation[1, 1]
    for begin in range(0, value.shape[0], _BLOCK):
        count = min(_BLOCK, value.shape[0] - begin)
        far = False
        for h in range(count):
            angle[h] = value[begin + h, 1]
            far |= abs(angle[h]) > _FAR_RAD
        if far:
            for h in range(_BLOCK):
                sine[h], cosine[h] = np.sin(angle[h]), np.cos(angle[h])
        else:
            _sines(angle, sine, cosine)
        for h in range(count):
            k = begin + h
            r, s, c = value[k, 0], sine[h], cosine[h]
            j00, j10 = s * r00 + c * r10, s * r01 + c * r11
            j01, j11 = r * (c * r00 - s * r10), r * (c * r01 - s * r11)
            p00, p01, p11 = covariance[k, 0, 0], covariance[k, 0, 1], covariance[k, 1, 1]
            m00, m01, m10, m11 = j00 * p00 + j01 * p01, j00 * p01 + j01 * p11, j10 * p00 + j11 * p01, j10 * p01 + j11 * p11
            out[k, 0], out[k, 1] = site[0] + r * j00, site[1] + r * j10
            cross = m00 * j10 + m01 * j11
            spread[k, 0, 0], spread[k, 0, 1] = m00 * j00 + m01 * j01, cross
            spread[k, 1, 0], spread[k, 1, 1] = cross, m10 * j10 + m11 * j11


def _plane_to_ecef(value: FloatArray, covariance: FloatArray, source: Polar) -> tuple[FloatArray, FloatArray]:
    """`Linear` of range and azimuth (n, 2) to the first two of the Earth-centred axes."""
    site, rotation = np.ascontiguousarray(source.site, np.float64), np.ascontiguousarray(source.rotation, np.float64)
    out, spread = np.empty((len(value), 2)), np.empty((len(value), 2, 2))

    def piece(part: slice) -> None:
        _plane_rows(value[part], covariance[part], site, rotation, out[part], spread[part])

    in_threads(piece, slices(len(value), _CHUNK))
    return out, spread
