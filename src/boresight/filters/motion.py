"""How targets move between measurements: constant velocity, constant acceleration, coordinated turn, Singer.

The state holds position, velocity and, where a model needs it, acceleration: blocks of `axes` coordinates (2: east, north of a
plane; 3: east, north, up about an anchor), metres and seconds.  Every model of a set has the same state; what a model does
not use stays as it is predicted: a model without acceleration sets it to zero.

A model is a value; what the kernels get of it is one row of numbers (`table`).  Process noise is white: of acceleration for
models of velocity (m^2/s^3), of jerk for constant acceleration (m^2/s^5).
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from .._jit import kernel
from .._types import FloatArray
from ..errors import SettingsError

VELOCITY, TURN, ACCELERATION, SINGER = 0.0, 1.0, 2.0, 3.0
KIND, PARAMETER, NOISE, NOISE_UP = 0, 1, 2, 3
# Mean radius of the Earth: it only says which way is up some hundred kilometres from the anchor.
_EARTH_M = 6371e3
SAME_S = 1e-9
"""Steps of time that differ by less, as sums of one step do, are one step: it is below the resolution of a time of day."""


class ConstantVelocity(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="constant-velocity"):
    """Straight and steady but for white acceleration of density `noise` (m^2/s^3; `noise_up` vertically, else the same)."""

    noise: float = 1.0
    noise_up: float | None = None


class CoordinatedTurn(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="coordinated-turn"):
    """A level turn at a known rate, positive to the right (heading grows), about the vertical where the target is.

    `rate_deg_s` in degrees a second; `noise` as for `ConstantVelocity`.
    """

    rate_deg_s: float
    noise: float = 1.0
    noise_up: float | None = None


class ConstantAcceleration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="constant-acceleration"):
    """Steady acceleration but for white jerk of density `noise` (m^2/s^5; `noise_up` vertically, else the same)."""

    noise: float = 0.1
    noise_up: float | None = None


class Singer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="singer"):
    """Acceleration of standard deviation `sd_mps2` that is forgotten over `time_constant_s` (Singer 1970)."""

    time_constant_s: float = 20.0
    sd_mps2: float = 2.0
    sd_up_mps2: float | None = None


Motion = ConstantVelocity | CoordinatedTurn | ConstantAcceleration | Singer


def table(models: Sequence[Motion]) -> FloatArray:
    """The models as numbers (m, 4): kind, parameter (turn rate rad/s, or 1 / time constant), noise, vertical noise.

    Raises SettingsError for noise that is negative or not a number, and for an empty set.
    """
    if not models:
        raise SettingsError("a set of models is empty", where="models", remedy="Give at least one, as ConstantVelocity().")
    rows = []
    for number, model in enumerate(models):
        match model:
            case ConstantVelocity():
                row = (VELOCITY, 0.0, model.noise, _or(model.noise_up, model.noise))
            case CoordinatedTurn():
                row = (TURN, np.radians(model.rate_deg_s), model.noise, _or(model.noise_up, model.noise))
            case ConstantAcceleration():
                row = (ACCELERATION, 0.0, model.noise, _or(model.noise_up, model.noise))
            case Singer():
                rate = 1.0 / model.time_constant_s if model.time_constant_s > 0 else np.nan
                up = _or(model.sd_up_mps2, model.sd_mps2)
                # White noise that drives a first-order process of this sd and rate.
                row = (SINGER, rate, 2 * rate * model.sd_mps2**2, 2 * rate * up**2)
        if not np.isfinite(row).all() or row[NOISE] < 0 or row[NOISE_UP] < 0:
            raise SettingsError(
                f"{model} makes no sense", where=f"models[{number}]", remedy="Noise is 0 or more, time constants are positive."
            )
        rows.append(row)
    return np.array(rows, np.float64)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def size(models: Sequence[Motion], axes: int) -> int:
    """The length of the state that a set of models needs."""
    return axes * (3 if any(isinstance(m, ConstantAcceleration | Singer) for m in models) else 2)


def matrices(model: Motion, dt_s: float, axes: int = 3, *, state: int = 0) -> tuple[FloatArray, FloatArray]:
    """Transition and process noise (d, d) of one model over `dt_s` seconds, about the anchor; `state` is d (0: what it needs)."""
    d = state or size([model], axes)
    transition, noise = np.zeros((1, d, d)), np.zeros((1, d, d))
    up = np.array([0.0, 0.0, 1.0])
    fill(table([model]), 0, dt_s, up, transition, noise, (0,) * d, (0,) * axes)
    return transition[0], noise[0]


@kernel
def vertical(x: FloatArray, m: int, up: FloatArray) -> None:
    """Fill `up` (3,) with the vertical where state m of `x` (M, d) is, in axes about the anchor."""
    e, n, h = x[m, 0], x[m, 1], x[m, 2] + _EARTH_M
    norm = np.sqrt(e * e + n * n + h * h)
    up[0], up[1], up[2] = e / norm, n / norm, h / norm


@kernel
def fill(
    models: FloatArray,
    m: int,
    dt: float,
    up: FloatArray,
    transition: FloatArray,
    noise: FloatArray,
    like: tuple[int, ...],
    axes: tuple[int, ...],
) -> None:
    """Fill transition and noise [m] (M, d, d) of model m over dt; `like` and `axes` are tuples of length d and of the axes.

    Lengths of tuples are constants to the compiler, which unrolls by them.  Sources: Bar-Shalom, Li & Kirubarajan 2001,
    chapters 6 and 11; Singer 1970.
    """
    d, k = len(like), len(axes)
    for i in range(d):
        for j in range(d):
            transition[m, i, j] = 0.0
            noise[m, i, j] = 0.0
    kind, parameter = models[m, KIND], models[m, PARAMETER]
    for i in range(k):
        transition[m, i, i] = 1.0
        q = models[m, NOISE_UP] if i == 2 else models[m, NOISE]
        if kind <= TURN:
            transition[m, i, k + i] = dt
            transition[m, k + i, k + i] = 1.0
            noise[m, i, i] = q * dt**3 / 3
            noise[m, i, k + i] = q * dt**2 / 2
            noise[m, k + i, i] = q * dt**2 / 2
            noise[m, k + i, k + i] = q * dt
        elif kind == ACCELERATION:
            transition[m, i, k + i] = dt
            transition[m, k + i, k + i] = 1.0
            transition[m, i, 2 * k + i] = dt * dt / 2
            transition[m, k + i, 2 * k + i] = dt
            transition[m, 2 * k + i, 2 * k + i] = 1.0
            noise[m, i, i] = q * dt**5 / 20
            noise[m, i, k + i] = q * dt**4 / 8
            noise[m, i, 2 * k + i] = q * dt**3 / 6
            noise[m, k + i, k + i] = q * dt**3 / 3
            noise[m, k + i, 2 * k + i] = q * dt**2 / 2
            noise[m, 2 * k + i, 2 * k + i] = q * dt
            noise[m, k + i, i] = noise[m, i, k + i]
            noise[m, 2 * k + i, i] = noise[m, i, 2 * k + i]
            noise[m, 2 * k + i, k + i] = noise[m, k + i, 2 * k + i]
        else:
            _fill_singer(transition, noise, m, i, k, parameter, q, dt)
    if kind == TURN and parameter != 0.0:
        _fill_turn(transition, m, parameter, dt, up, axes)


@kernel
def _fill_turn(transition: FloatArray, m: int, rate: float, dt: float, up: FloatArray, axes: tuple[int, ...]) -> None:
    """Velocity turns by ``-rate dt`` about `up` (to the right), and the position follows: Rodrigues' formula and its integral."""
    k = len(axes)
    a = rate * dt
    s, c = np.sin(a), np.cos(a)
    if abs(a) < 1e-4:
        # Series: sin a / rate and (1 - cos a) / rate lose their digits where the turn is next to nothing.
        along, across = dt * (1 - a * a / 6), dt * a / 2 * (1 - a * a / 12)
    else:
        along, across = s / rate, (1 - c) / rate
    if k == 2:
        transition[m, 0, 2], transition[m, 0, 3] = along, across
        transition[m, 1, 2], transition[m, 1, 3] = -across, along
        transition[m, 2, 2], transition[m, 2, 3] = c, s
        transition[m, 3, 2], transition[m, 3, 3] = -s, c
        return
    for i in range(3):
        for j in range(3):
            outer = up[i] * up[j]
            same = 1.0 if i == j else 0.0
            # The matrix of the cross product with -up.
            cross = 0.0
            if i != j:
                other = 3 - i - j
                cross = up[other] if (j - i) % 3 == 1 else -up[other]
            transition[m, i, 3 + j] = along * (same - outer) + across * cross + dt * outer
            transition[m, 3 + i, 3 + j] = c * (same - outer) + s * cross + outer


# Gauss-Legendre points and weights on (0, 1), exact for polynomials of degree 9.
_POINTS = np.array([0.04691007703066800, 0.23076534494715845, 0.5, 0.76923465505284155, 0.95308992296933200])
_WEIGHTS = np.array([0.11846344252809454, 0.23931433524968324, 0.28444444444444444, 0.23931433524968324, 0.11846344252809454])


@kernel
def _fill_singer(transition: FloatArray, noise: FloatArray, m: int, i: int, k: int, rate: float, q: float, dt: float) -> None:
    """Axis i of a first-order acceleration process, q the density of its driving noise.

    The noise is the integral of products of the responses to a kick of acceleration: in closed form, but by quadrature where
    that form's differences lose their digits.
    """
    b = rate * dt
    fade = np.exp(-b)
    g1, g2 = _response(rate, dt)
    if b < 1.0:
        q11, q12, q13, q22, q23, q33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(5):
            s, w = dt * _POINTS[n], q * dt * _WEIGHTS[n]
            p, v = _response(rate, s)
            a = np.exp(-rate * s)
            q11 += w * p * p
            q12 += w * p * v
            q13 += w * p * a
            q22 += w * v * v
            q23 += w * v * a
            q33 += w * a * a
    else:
        fade2 = fade * fade
        q11 = q / (2 * rate**5) * (1 - fade2 + 2 * b + 2 * b**3 / 3 - 2 * b * b - 4 * b * fade)
        q12 = q / (2 * rate**4) * (fade2 + 1 - 2 * fade + 2 * b * fade - 2 * b + b * b)
        q13 = q / (2 * rate**3) * (1 - fade2 - 2 * b * fade)
        q22 = q / (2 * rate**3) * (4 * fade - 3 - fade2 + 2 * b)
        q23 = q / (2 * rate**2) * (fade2 + 1 - 2 * fade)
        q33 = q / (2 * rate) * (1 - fade2)
    transition[m, i, k + i], transition[m, i, 2 * k + i] = dt, g1
    transition[m, k + i, k + i], transition[m, k + i, 2 * k + i] = 1.0, g2
    transition[m, 2 * k + i, 2 * k + i] = fade
    noise[m, i, i], noise[m, i, k + i], noise[m, i, 2 * k + i] = q11, q12, q13
    noise[m, k + i, i], noise[m, k + i, k + i], noise[m, k + i, 2 * k + i] = q12, q22, q23
    noise[m, 2 * k + i, i], noise[m, 2 * k + i, k + i], noise[m, 2 * k + i, 2 * k + i] = q13, q23, q33


@kernel
def _response(rate: float, s: float) -> tuple[float, float]:
    """Position and velocity a time s after a unit of acceleration that fades at `rate`."""
    b = rate * s
    if b < 1e-3:
        return s * s / 2 * (1 - b / 3 * (1 - b / 4)), s * (1 - b / 2 * (1 - b / 3))
    v = -np.expm1(-b) / rate
    return (s - v) / rate, v
