"""Errors that change: a term's value as a function of time, drawn once where it wanders.

All times are seconds after the scene's start, all values in the term's own unit.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from .._jit import kernel
from .._types import FloatArray, IntArray

_WALK_STEP_S = 1.0
_HOUR_S = 3600.0


class Sine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``amplitude * sin(2 pi t / period_s + phase)``."""

    amplitude: float
    period_s: float
    phase_deg: float = 0.0


class Step(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From `at_s` on the value is greater by `by`."""

    at_s: float
    by: float


class Drift(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An error that changes with time: the sum of a constant, a ramp, sines, steps and a random walk that begins at 0.

    All in the unit of the term.  The walk's sd after an hour is `walk_per_sqrt_h`, and it grows with the root of the time.
    """

    value: float = 0.0
    ramp_per_h: float = 0.0
    sine: tuple[Sine, ...] = ()
    step: tuple[Step, ...] = ()
    walk_per_sqrt_h: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """What an error truly was: a function of time.  `walk` is the drawn walk at every whole second, empty where there is none."""

    drift: Drift
    walk: FloatArray

    def __call__(self, seconds: FloatArray) -> FloatArray:
        """The values (n,) at times (n,), in the unit of the term."""
        drift = self.drift
        out = np.full(len(seconds), drift.value, np.float64)
        if drift.ramp_per_h:
            out += drift.ramp_per_h / _HOUR_S * seconds
        for wave in drift.sine:
            out += wave.amplitude * np.sin(2 * np.pi * seconds / wave.period_s + math.radians(wave.phase_deg))
        for step in drift.step:
            out += np.where(seconds >= step.at_s, step.by, 0.0)
        if len(self.walk):
            out += np.interp(seconds, _WALK_STEP_S * np.arange(len(self.walk)), self.walk)
        return out

    def mean(self, seconds: FloatArray) -> FloatArray:
        """The means (n,) of the values from the scene's start to times (n,): a rate's sum up to a time, over that time."""
        drift = self.drift
        since = np.maximum(seconds, 1e-6)
        out = np.full(len(seconds), drift.value, np.float64)
        if drift.ramp_per_h:
            out += drift.ramp_per_h / _HOUR_S * since / 2
        for wave in drift.sine:
            turn, phase = 2 * np.pi * since / wave.period_s, math.radians(wave.phase_deg)
            # cos(phase) - cos(phase + turn), without its loss of digits for small turns.
            out += wave.amplitude * 2 * np.sin(phase + turn / 2) * np.sin(turn / 2) / turn
        for step in drift.step:
            out += step.by * np.clip(since - step.at_s, 0.0, since) / since
        if len(self.walk):
            at = np.clip(since / _WALK_STEP_S, 0.0, len(self.walk) - 1.0)
            k = np.minimum(at.astype(np.int64), len(self.walk) - 2)
            part = at - k
            summed = np.concatenate([[0.0], np.cumsum((self.walk[1:] + self.walk[:-1]) / 2)])
            out += (summed[k] + part * self.walk[k] + part * part / 2 * (self.walk[k + 1] - self.walk[k])) * _WALK_STEP_S / since
        return out


def history(error: float | Drift, span_s: float, rng: np.random.Generator) -> History:
    """The error over a scene of `span_s`; a longer scene's begins alike.  A walk has normal steps of a second."""
    drift = error if isinstance(error, Drift) else Drift(value=error)
    if not drift.walk_per_sqrt_h:
        return History(drift, np.empty(0))
    steps = rng.normal(0.0, drift.walk_per_sqrt_h * math.sqrt(_WALK_STEP_S / _HOUR_S), int(span_s / _WALK_STEP_S) + 2)
    return History(drift, np.concatenate([[0.0], np.cumsum(steps)]))


def drift_mistakes(drift: Drift) -> Iterator[str]:
    """What is wrong with a drift: numbers that are none, periods that are not positive, a negative walk."""
    parts = [drift.value, drift.ramp_per_h, drift.walk_per_sqrt_h]
    parts += [x for wave in drift.sine for x in (wave.amplitude, wave.period_s, wave.phase_deg)]
    parts += [x for step in drift.step for x in (step.at_s, step.by)]
    if not all(map(math.isfinite, parts)):
        yield "a part of it is no finite number"
    if any(not wave.period_s > 0 for wave in drift.sine):
        yield "a sine needs a period_s above 0"
    if drift.walk_per_sqrt_h < 0:
        yield "walk_per_sqrt_h is an sd and cannot be negative"


class Streams:
    """Random numbers by purpose: what is drawn for one name is the same whatever is drawn for others, or from `rng` itself."""

    def __init__(self, rng: np.random.Generator) -> None:
        # A child of its own, so that `rng` goes on as if nothing had been taken.
        self._seed = rng.spawn(1)[0].integers(0, 2**63, 2).tolist()

    def __call__(self, name: str) -> np.random.Generator:
        """The generator of this name, at its beginning."""
        return np.random.default_rng([*self._seed, zlib.crc32(name.encode())])


def gauss_markov(track: IntArray, seconds: FloatArray, correlation_s: float, rng: np.random.Generator) -> FloatArray:
    """A variable (n,) of mean 0 and variance 1 that wanders along each track: correlated by exp(-time apart / correlation_s).

    `track` (n,) is any number of the track, `seconds` (n,) the time; in any order.  Exact for uneven times.
    """
    order = np.lexsort((seconds, track))
    keep = np.zeros(len(order))
    same = np.diff(track[order]) == 0
    keep[1:][same] = np.exp(-np.diff(seconds[order])[same] / correlation_s)
    draw = rng.normal(0.0, 1.0, len(order))
    out = np.empty(len(order))
    out[order] = _wandering(keep, draw)
    return out


@kernel
def _wandering(keep: FloatArray, draw: FloatArray) -> FloatArray:
    """Each value (n,) keeps a part of the one before, and what is missing of variance 1 is new."""
    out = np.empty_like(draw)
    last = 0.0
    for k in range(len(draw)):
        last = keep[k] * last + np.sqrt(1.0 - keep[k] * keep[k]) * draw[k]
        out[k] = last
    return out
