"""Detection and initiation: how probable a plot is by range, and at what range an M-of-N rule has made a track of the plots.

The probability of detection is that of a square-law detector that adds pulses without phase, for Swerling's five cases, as one
sum: given its energy the target's number of "extra" degrees is Poisson, and over the fluctuations negative binomial.  Where a
track begins comes exactly from a Markov chain over the last looks, and by Monte Carlo.  Paper 003 section 3.3; METHODS section 2.
"""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from .._types import FloatArray, IntArray
from ..errors import SettingsError

Swerling = Literal[0, 1, 2, 3, 4]


def detection_probability(snr: ArrayLike, *, pfa: float, swerling: Swerling = 0, pulses: int = 1) -> FloatArray:
    """The probability of detection (n,) at a mean signal-to-noise ratio of one pulse (n,), a ratio of powers, not dB.

    `pfa` is the probability of false alarm of the sum of `pulses`.  Swerling 0 is steady; 1 and 3 keep their energy over the
    pulses, 2 and 4 change it from pulse to pulse; 1 and 2 are exponential, 3 and 4 have four degrees of freedom.  Exact.  Source:
    DiFranco & Rubin 1968, chapters 9 to 11.  Raises SettingsError for a pfa outside (0, 1), fewer than one pulse, another case.
    """
    from scipy.special import gammainc, gammainccinv, gammaln, xlog1py, xlogy

    if not 0 < pfa < 1 or pulses < 1 or swerling not in (0, 1, 2, 3, 4):
        raise SettingsError(
            f"pfa = {pfa}, pulses = {pulses}, swerling = {swerling} make no sense",
            where="detection",
            remedy="A pfa within (0, 1), at least one pulse, and a case 0 … 4.",
        )
    s = np.asarray(snr, np.float64)
    threshold = float(gammainccinv(pulses, pfa))
    # Terms beyond are as good as certain detections, which the sum of misses leaves out.
    j = np.arange(int(threshold + 12 * np.sqrt(threshold) + 60), dtype=np.float64)
    miss = gammainc(pulses + j, threshold)
    energy = np.maximum(s, 0.0)[..., None] * pulses
    if swerling == 0:
        log_chance = xlogy(j, energy) - energy - gammaln(j + 1)
    else:
        shape = float({1: 1, 2: pulses, 3: 2, 4: 2 * pulses}[swerling])
        log_chance = (
            gammaln(j + shape) - gammaln(shape) - gammaln(j + 1) + xlogy(j, energy) - xlog1py(j + shape, energy / shape)
            - xlogy(j, shape)
        )  # fmt: skip
    return np.asarray(np.clip(1.0 - np.exp(log_chance) @ miss, 0.0, 1.0))


class RadarEquation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A radar that detects with probability `pd` at `range_m`: its signal falls with the fourth power of the range."""

    pd: float = 0.85
    range_m: float = 100e3
    pfa: float = 1e-6
    swerling: Swerling = 0
    pulses: int = 1

    def snr(self) -> float:
        """The signal-to-noise ratio of one pulse at `range_m`.  Raises SettingsError where no signal gives this `pd`."""
        from scipy.optimize import brentq

        if not self.pfa < self.pd < 1 or not self.range_m > 0:
            raise SettingsError(
                f"pd = {self.pd} at {self.range_m} m with pfa = {self.pfa} makes no sense",
                where="radar equation",
                remedy="pd lies between pfa and 1, the range is positive.",
            )

        def off(log_snr: float) -> float:
            found = detection_probability(np.exp(log_snr), pfa=self.pfa, swerling=self.swerling, pulses=self.pulses)
            return float(found) - self.pd

        return float(np.exp(brentq(off, -30.0, 30.0, xtol=1e-12)))

    def probability(self, range_m: ArrayLike, *, pfa: float | None = None) -> FloatArray:
        """The probability of detection (n,) at ranges (n,), metres; `pfa` is another threshold on the same signal."""
        s = self.snr() * (self.range_m / np.maximum(np.asarray(range_m, np.float64), 1.0)) ** 4
        # Beyond this the sum has nothing to add.
        return detection_probability(
            np.minimum(s, 1e9), pfa=self.pfa if pfa is None else pfa, swerling=self.swerling, pulses=self.pulses
        )


class MOfN(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A track begins at the look that is the `hits`-th detection within the last `looks` looks."""

    hits: int = 3
    looks: int = 6

    def check(self) -> None:
        """Raise SettingsError for a rule that makes no sense or needs too many states."""
        if not 1 <= self.hits <= self.looks or self.looks > 20:
            raise SettingsError(
                f"{self.hits} of {self.looks} makes no sense", where="initiation", remedy="M of N with 1 <= M <= N <= 20."
            )


def initiation_chances(probability: FloatArray, rule: MOfN) -> FloatArray:
    """The probability (K,) that a track begins at each look, of the probabilities of detection (K,) look by look: exact.

    A Markov chain over which of the last looks were hits.  What is missing to 1 is the chance that no track begins.
    """
    rule.check()
    memory = rule.looks - 1
    states = np.arange(1 << memory)
    full = _hits(states, memory) == rule.hits - 1
    after_hit = ((states << 1) | 1) & ((1 << memory) - 1)
    after_miss = (states << 1) & ((1 << memory) - 1)
    chance = np.zeros(1 << memory)
    chance[0] = 1.0
    out = np.zeros(len(probability))
    for k, p in enumerate(np.asarray(probability, np.float64).tolist()):
        out[k] = p * chance[full].sum()
        new = np.zeros_like(chance)
        np.add.at(new, after_miss, (1 - p) * chance)
        np.add.at(new, after_hit[~full], p * chance[~full])
        chance = new
    return out


def _hits(states: IntArray, bits: int) -> IntArray:
    """The number of ones (n,) among the lowest bits of numbers (n,)."""
    return np.asarray(sum((states >> b) & 1 for b in range(bits)) + np.zeros_like(states))


def initiation_looks(rng: np.random.Generator, probability: FloatArray, rule: MOfN, runs: int) -> IntArray:
    """The look (runs,) at which a track begins in each of `runs` draws; -1 where none begins."""
    rule.check()
    hit = rng.random((runs, len(probability))) < probability
    count = np.cumsum(hit, axis=1)
    before = np.zeros_like(count)
    before[:, rule.looks :] = count[:, : -rule.looks]
    begins = hit & (count - before >= rule.hits)
    return np.where(begins.any(axis=1), np.argmax(begins, axis=1), -1)


def false_track_rate(false_plots: float, rule: MOfN) -> float:
    """False tracks per look and gate, where each look has a false plot in the gate with this (small) probability.

    The chance that a look has one and exactly M - 1 of the N - 1 before it had: right to first order of that probability.
    """
    from math import comb

    rule.check()
    m, n = rule.hits, rule.looks
    return comb(n - 1, m - 1) * false_plots**m * (1 - false_plots) ** (n - m)


def equal_false_tracks(false_plots: float, rule: MOfN, other: MOfN, *, looks: float = 1.0) -> float:
    """The probability of a false plot at which `other`, with `looks` times as many looks, has the false tracks of `rule`."""
    from scipy.optimize import brentq

    wanted = false_track_rate(false_plots, rule)

    def off(log_p: float) -> float:
        return float(np.log(looks * false_track_rate(float(np.exp(log_p)), other) / wanted))

    return float(np.exp(brentq(off, np.log(1e-15), np.log(0.1), xtol=1e-12)))


def range_gain_db(fused_m: float, alone_m: float) -> float:
    """The gain in signal-to-noise ratio that a greater initiation range is worth: 10 lg (fused^4 / alone^4), paper 003 eq. 15."""
    return float(40.0 * np.log10(fused_m / alone_m))
