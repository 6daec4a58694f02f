"""The coarse biases of a radar that nobody has calibrated yet, by votes of candidate pairs (METHODS section 4).

Every radar plot that may be a reference target votes for the range, azimuth and time bias that would make it so.  True
candidates agree, false ones scatter: the biases are where the votes of many *tracks* meet.  A vote is counted by track, so that
one long track cannot speak for all, and what chance alone gathers is measured on the same data with the clocks or the north
deliberately spoilt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import BoolArray, FloatArray, IntArray


class Candidates(NamedTuple):
    """Radar plots against reference targets, one row per plot and target that might be it.

    `track` and `target` (m,) number the pair, `weight` is 1 / (plots looked at of that track), so that a track's weights sum
    to 1 per target that is there all the time.  `range_error_m` and `azimuth_error_rad` are measured - reference at the
    plot's stamp, `range_rate_mps` and `azimuth_rate_radps` how the reference moves as the radar sees it.  The sd are how far
    a true candidate may lie off once the biases are known: noise of both sides, and what the biases cannot describe.
    `range_m` and `azimuth_rad` are where the reference is.
    """

    track: IntArray
    target: IntArray
    weight: FloatArray
    range_error_m: FloatArray
    azimuth_error_rad: FloatArray
    range_rate_mps: FloatArray
    azimuth_rate_radps: FloatArray
    range_sd_m: FloatArray
    azimuth_sd_rad: FloatArray
    range_m: FloatArray
    azimuth_rad: FloatArray

    def keep(self, rows: BoolArray) -> Candidates:
        """The rows of a mask."""
        return Candidates(
            self.track[rows], self.target[rows], self.weight[rows], self.range_error_m[rows], self.azimuth_error_rad[rows],
            self.range_rate_mps[rows], self.azimuth_rate_radps[rows], self.range_sd_m[rows], self.azimuth_sd_rad[rows],
            self.range_m[rows], self.azimuth_rad[rows],
        )  # fmt: skip


class Window(NamedTuple):
    """How far the search looks for the biases: half widths (m, rad, s)."""

    range_m: float
    azimuth_rad: float
    time_s: float


class Bias(NamedTuple):
    """Coarse errors of a radar: measured - true; time: stamp - true.

    The search finds the first three.  `refine` adds, where asked to, what bends them: `range_gain` (m per m) and the
    eccentricity `azimuth_cos_rad`, `azimuth_sin_rad` (rad per cosine and sine of the azimuth).
    """

    range_m: float = 0.0
    azimuth_rad: float = 0.0
    time_s: float = 0.0
    range_gain: float = 0.0
    azimuth_cos_rad: float = 0.0
    azimuth_sin_rad: float = 0.0

    def at(self, range_m: FloatArray, azimuth_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Range (m) and azimuth (rad) errors (n,) of plots whose stamps are right, at ranges and azimuths (n,)."""
        return (
            self.range_m + self.range_gain * range_m,
            self.azimuth_rad + self.azimuth_cos_rad * np.cos(azimuth_rad) + self.azimuth_sin_rad * np.sin(azimuth_rad),
        )


class Peak(NamedTuple):
    """Biases that candidates agree on, and how well.

    `score` is the sum over tracks of how well the best target explains the whole track (0 to 1 each); `tracks` counts those
    that are explained at least by half.
    """

    bias: Bias
    score: float
    tracks: int


NO_PEAK = Peak(Bias(), 0.0, 0)
# As large as range gain (m/m) and eccentricity (rad) may get; their prior sd is a quarter of that.
_BENDS = (0.015, float(np.radians(2.0)), float(np.radians(2.0)))


def residuals(c: Candidates, bias: Bias) -> tuple[FloatArray, FloatArray]:
    """What is left of the range (m) and azimuth (rad) errors (m,) once the biases are taken off.

    A plot stamped late by t shows the target where it was that much earlier, p - v t, hence error = bias - rate t.
    """
    range_bias, azimuth_bias = bias.at(c.range_m, c.azimuth_rad)
    return (
        c.range_error_m + bias.time_s * c.range_rate_mps - range_bias,
        c.azimuth_error_rad + bias.time_s * c.azimuth_rate_radps - azimuth_bias,
    )


def within(c: Candidates, window: Window, margin: float = 3.0) -> BoolArray:
    """Which candidates (m,) can vote at all: some bias inside the window explains them."""
    return (
        np.abs(c.range_error_m) <= window.range_m + window.time_s * np.abs(c.range_rate_mps) + margin * c.range_sd_m
    ) & (
        np.abs(c.azimuth_error_rad)
        <= window.azimuth_rad + window.time_s * np.abs(c.azimuth_rate_radps) + margin * c.azimuth_sd_rad
    )  # fmt: skip


def _vote_width(c: Candidates) -> tuple[float, float]:
    return float(np.median(c.range_sd_m)), float(np.median(c.azimuth_sd_rad))


def time_steps(c: Candidates, window: Window) -> FloatArray:
    """The time biases to try (k,): so close that the fastest of the candidates moves about one vote's width between two."""
    if not len(c.track) or window.time_s <= 0:
        return np.zeros(1)
    range_sd, azimuth_sd = _vote_width(c)
    speed = max(float(np.quantile(np.abs(c.range_rate_mps), 0.9)), 1e-3)
    turn = max(float(np.quantile(np.abs(c.azimuth_rate_radps), 0.9)), 1e-9)
    step = min(1.5 * range_sd / speed, 1.5 * azimuth_sd / turn, window.time_s)
    half = int(np.clip(np.ceil(window.time_s / step), 1, 20))
    return np.linspace(-window.time_s, window.time_s, 2 * half + 1)


def search_peak(c: Candidates, window: Window, starts: int = 6) -> Peak:
    """Find the biases on which most tracks agree.

    The votes of each trial of the time bias are gathered in a grid of range and azimuth bias whose cells are one vote wide;
    the best cells are then refined (`refine`) and judged by the tracks that they explain.  Returns `NO_PEAK` where no
    candidate can vote.
    """
    c = c.keep(within(c, window))
    if not len(c.track):
        return NO_PEAK
    found: list[tuple[float, float, float, float]] = []
    range_sd, azimuth_sd = _vote_width(c)
    # Never more than 400 cells across: a sharp radar in a wide window is refined afterwards anyhow.
    width_r, width_a = max(1.5 * range_sd, window.range_m / 200), max(1.5 * azimuth_sd, window.azimuth_rad / 200)
    half_r, half_a = int(np.ceil(window.range_m / width_r)), int(np.ceil(window.azimuth_rad / width_a))
    shape = (2 * half_r + 3, 2 * half_a + 3)
    for late in time_steps(c, window):
        range_left, azimuth_left = residuals(c, Bias(time_s=float(late)))
        i = np.rint(range_left / width_r).astype(np.int64) + half_r + 1
        j = np.rint(azimuth_left / width_a).astype(np.int64) + half_a + 1
        inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
        grid = np.bincount(i[inside] * shape[1] + j[inside], c.weight[inside], shape[0] * shape[1]).reshape(shape)
        summed = np.cumsum(np.cumsum(np.pad(grid, ((1, 0), (1, 0))), axis=0), axis=1)
        # Sums over 3 x 3 cells: a peak on the border of two cells must not lose half of its votes.
        box = summed[3:, 3:] - summed[:-3, 3:] - summed[3:, :-3] + summed[:-3, :-3]
        for _ in range(2):
            at = int(np.argmax(box))
            k, m = divmod(at, box.shape[1])
            if box[k, m] <= 0:
                break
            found.append((float(box[k, m]), (k - half_r) * width_r, (m - half_a) * width_a, float(late)))
            box[max(k - 2, 0) : k + 3, max(m - 2, 0) : m + 3] = 0.0
    found.sort(reverse=True)
    best = NO_PEAK
    for _, range_bias, azimuth_bias, late in found[:starts]:
        peak = refine(c, window, Bias(range_bias, azimuth_bias, late))
        if peak.score > best.score:
            best = peak
    return best


def explained(c: Candidates, bias: Bias, gate: float = 3.0) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """How well each pair of track and target agrees with biases.

    Returns (score (p,), track (p,), target (p,), pair of each candidate (m,)); a score is the mean over the track's plots of
    1 - d² / gate², nothing beyond the gate, d in units of the vote's width.
    """
    range_left, azimuth_left = residuals(c, bias)
    d2 = (range_left / c.range_sd_m) ** 2 + (azimuth_left / c.azimuth_sd_rad) ** 2
    span = int(c.target.max(initial=0)) + 1
    unique, pair = np.unique(c.track * span + c.target, return_inverse=True)
    score: FloatArray = np.bincount(pair, c.weight * np.maximum(0.0, 1.0 - d2 / gate**2), len(unique)).astype(np.float64)
    return score, unique // span, unique % span, pair


def refine(c: Candidates, window: Window, start: Bias, bends: bool = False) -> Peak:
    """Sharpen a peak by robust regression on the pairs that it explains, the gate closing from 4 to 3 widths.

    Errors are regressed on (1, -rate) of range and azimuth together, with `bends` also on range gain and eccentricity; weak
    priors hold what the geometry cannot separate: of one radial track, range and time.  The result is kept inside the window.
    """
    limit = np.array([window.range_m, window.azimuth_rad, max(window.time_s, 1e-9), *_BENDS])
    prior = np.array([1e-3, 1e-3, 0.04, 16.0, 16.0, 16.0]) / limit**2
    free = np.arange(6 if bends else 3)
    estimate = np.array(start)
    best = NO_PEAK
    for gate in (4.0, 4.0, 3.5, 3.0, 3.0):
        now = Bias(*estimate.tolist())
        score, track, _, pair = explained(c, now, gate)
        if gate == 3.0:
            best = max(best, _peak(now, score, track), key=lambda p: p.score)
        best_of_track = np.zeros(int(track.max(initial=-1)) + 1)
        np.maximum.at(best_of_track, track, score)
        use = ((score > 0.2) & (score >= best_of_track[track]))[pair]
        if np.count_nonzero(use) < 3:
            break
        mine = c.keep(use)
        left = residuals(mine, now)
        d2 = (left[0] / mine.range_sd_m) ** 2 + (left[1] / mine.azimuth_sd_rad) ** 2
        # Tukey's biweight in the joint distance: points at the gate's edge say nothing.
        w = mine.weight * np.where(d2 < gate**2, (1 - d2 / gate**2) ** 2, 0.0)
        normal, right = _normal(mine, w, left)
        normal, right = normal + np.diag(prior), right - prior * estimate
        estimate = limit * _bounded(normal * np.outer(limit, limit), right * limit, estimate / limit, free)
    now = Bias(*estimate.tolist())
    score, track, _, _ = explained(c, now)
    return max(best, _peak(now, score, track), key=lambda p: p.score)


def _normal(c: Candidates, weight: FloatArray, left: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (6, 6) and right side (6,) of the errors that are `left`, in the order of `Bias`."""
    one, nil = np.ones(len(weight)), np.zeros(len(weight))
    rows = (
        np.stack([one, nil, -c.range_rate_mps, c.range_m, nil, nil]),
        np.stack([nil, one, -c.azimuth_rate_radps, nil, np.cos(c.azimuth_rad), np.sin(c.azimuth_rad)]),
    )
    normal, right = np.zeros((6, 6)), np.zeros(6)
    for row, error, sd in zip(rows, left, (c.range_sd_m, c.azimuth_sd_rad), strict=True):
        normal += (row * (weight / sd**2)) @ row.T
        right += (row * (weight / sd**2)) @ error
    return normal, right


def _bounded(normal: FloatArray, right: FloatArray, at: FloatArray, free: IntArray) -> FloatArray:
    """One step of the normal equations from `at` (6,), within -1 … 1: what would leave is held, and the others solved for again.

    Cutting off alone would tear apart what holds together: a time and the range that goes with it.
    """
    out = at.copy()
    while len(free):
        held = out - at
        held[free] = 0.0
        want = at[free] + np.linalg.solve(normal[np.ix_(free, free)], (right - normal @ held)[free])
        beyond = np.abs(want) > 1.0
        out[free] = np.clip(want, -1.0, 1.0)
        if not beyond.any():
            break
        free = free[~beyond]
    return out


def time_sd_s(c: Candidates) -> float:
    """How well candidates that are all true tell the time bias beside those of range and azimuth; a track is one observation."""
    normal, _ = _normal(c, c.weight, (c.range_error_m, c.azimuth_error_rad))
    scale = np.sqrt(np.maximum(np.diag(normal)[:3], 1e-300))
    size, basis = np.linalg.eigh(normal[:3, :3] / np.outer(scale, scale))
    return float(np.sqrt(np.sum(basis[2] ** 2 / np.maximum(size, 1e-12))) / scale[2])


def widened(c: Candidates, width: float) -> Candidates:
    """The candidates with votes `width` times as wide."""
    return c._replace(range_sd_m=width * c.range_sd_m, azimuth_sd_rad=width * c.azimuth_sd_rad)


def bent(c: Candidates, window: Window, start: Bias, width: float) -> Peak:
    """Follow a peak of votes `width` wide down to their proper width, with range gain and eccentricity set free.

    Such errors spread the votes of constant biases; the wide peak shows where they are, and each narrower one shows them
    better.
    """
    bias = start
    for w in (10.0, 5.0, 3.0, 2.0, 1.0):
        if w <= width:
            for _ in range(3):
                bias = refine(widened(c, w), window, bias, bends=True).bias
    score, track, _, _ = explained(c, bias)
    return _peak(bias, score, track)


def _peak(bias: Bias, score: FloatArray, track: IntArray) -> Peak:
    best_of_track = np.zeros(int(track.max(initial=-1)) + 1)
    np.maximum.at(best_of_track, track, score)
    return Peak(bias, float(best_of_track.sum()), int(np.sum(best_of_track > 0.5)))


def is_significant(peak: Peak, spoilt: list[Peak], tracks: int) -> bool:
    """Whether a peak is more than chance gathers.

    `spoilt` are the peaks of the same search with clocks or north spoilt, so that no candidate can be true.  At least `tracks`
    tracks must be explained, more than in any spoilt search, and the score must exceed their mean by three of its standard
    deviations as a count (Poisson) and by a half.
    """
    if peak.tracks < tracks:
        return False
    if not spoilt:
        return True
    mean = float(np.mean([p.score for p in spoilt]))
    most = max(p.score for p in spoilt)
    return peak.score > 1.5 * mean and peak.score > mean + 3 * np.sqrt(mean) and peak.score > most + min(1.0, 0.25 * most + 0.5)


def shared_offset(
    plot_time_s: FloatArray,
    plot_track: IntArray,
    fix_time_s: FloatArray,
    near: tuple[IntArray, IntArray],
    width_s: float,
) -> tuple[float, int, float]:
    """The clock offset that most tracks share, for clocks farther apart than the window.

    `near` = (plot (m,), fix (m,)): a plot and a fix at the same place, at whatever times.  Each such meeting votes, once per
    track, for its time difference in bins of `width_s`.  Returns (plot - fix in seconds, tracks that agree, tracks that
    chance gives).
    """
    if not len(near[0]):
        return 0.0, 0, 0.0
    late = plot_time_s[near[0]] - fix_time_s[near[1]]
    at = np.rint(late / width_s).astype(np.int64)
    low = int(at.min())
    span = int(at.max()) - low + 3
    # A vote counts in its own bin and the two beside it, for offsets on a border.
    key = np.unique((plot_track[near[0]][:, None] * span + (at - low)[:, None] + np.arange(3)).ravel())
    counts = np.bincount(key % span, minlength=span)
    best = int(np.argmax(counts))
    around = np.abs(np.arange(span) - best) > 2
    # What chance gives is taken where there is any meeting at all; empty bins would flatter the peak.
    background = counts[around & (counts > 0)]
    inside = np.abs(at - low + 1 - best) <= 1
    return float(np.median(late[inside])), int(counts[best]), float(np.mean(background)) if len(background) else 0.0
