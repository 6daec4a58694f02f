"""Biases that change while a radar records: the course that tracks of known identity have in common.

Where biases drift or jump by more than the noise, no constant explains a whole track.  What differs then is still shared: tracks
that are seen at the same time err alike at that time.  A wrong identity or a clock that is far off gives each track differences
of its own, which agree neither with each other nor for long.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from . import hough, tracklets
from .scene import Scene

# Tracks are set against each other in slices of so many seconds, or of so many scans of a slow radar.
_SLICE_S = 20.0
_SCANS = 4.0
# Fewer slices in which two tracks meet decide nothing: a short while does not tell a drift from chance.
_FEWEST_SLICES = 5
# At most so many plots are looked at, and so many slices to find how late the stamps are.
_ROWS = 60_000
_TRIED = 60
# Tracks agree within so many standard deviations; as large a part of them must, and as large a part of a track's slices.
_GATE = 3.0
_SHARE = 0.5
# Noise so many times as large as assumed is believed; beyond, something else is wrong: a deck that leans, a clock that jitters.
_NOISIEST = 4.0
# The course is followed where its rms exceeds so many sd: of noise where no constant was found, and where one was.
_WORTH = (0.5, 1.0)


class Course(NamedTuple):
    """What the biases of a radar are beside constants: knots (k,) of time (s), range (m) and azimuth (rad), linear between.

    `range_sd_m` and `azimuth_sd_rad` are the noise that the tracks show; `width_s` is how long a slice is.
    """

    time_s: FloatArray
    range_m: FloatArray
    azimuth_rad: FloatArray
    range_sd_m: float
    azimuth_sd_rad: float
    width_s: float

    def taken_off(self, scene: Scene) -> Scene:
        """The scene without it, the noise as wide as shown, and wider where the course turns too fast for its knots."""
        time, half = scene.plots.time_s, self.width_s / 2
        range_m, azimuth = (np.interp(time, self.time_s, v) for v in (self.range_m, self.azimuth_rad))
        # What the course does within a slice is spread as evenly as a step somewhere in it.
        more = [
            np.abs(np.interp(time + half, self.time_s, v) - np.interp(time - half, self.time_s, v)) / np.sqrt(12.0)
            for v in (self.range_m, self.azimuth_rad)
        ]
        return replace(
            _with_noise(scene, self.range_sd_m, self.azimuth_sd_rad),
            plots=scene.plots.replace(range_m=scene.plots.range_m - range_m),
            azimuth_rad=scene.azimuth_rad - azimuth,
            more_range_sd_m=more[0],
            more_azimuth_sd_rad=more[1],
        )

    def words(self, scene: Scene) -> list[str]:
        """What to say of it."""
        span = [0.5 * float(np.ptp(v)) for v in (self.range_m, self.azimuth_rad)]
        parts = [f"range by ±{span[0]:.0f} m"] * (span[0] > 0) + [f"azimuth by ±{np.degrees(span[1]):.2f}°"] * (span[1] > 0)
        return [
            f"{scene.sensor.name}: its biases change while it records ({', '.join(parts)}); tracks of known identity agree on "
            "that, and were paired along it. Constant biases are means only; --online follows them over time"
        ]


class _Slices(NamedTuple):
    """Medians of one pair's differences in one slice of time: numbers of slice, ascending, and pair (m,), and values (m, 2)."""

    slice: IntArray
    pair: IntArray
    error: FloatArray
    rate: FloatArray
    sd: FloatArray


class _Differences(NamedTuple):
    """Plots (m,) against the targets that identity gives them: which pair, when, and errors, rates and sd (m, 2).

    `bends` (m, 2) is what constant biases that were found have besides range, azimuth and time.
    """

    pair: IntArray
    time_s: FloatArray
    error: FloatArray
    rate: FloatArray
    sd: FloatArray
    bends: FloatArray

    def noise(self) -> FloatArray:
        """The sd (2,) of range and azimuth that a plot shows against the line through those before and after; 0 without any."""
        by = np.lexsort((self.time_s, self.pair))
        before, now, after = by[:-2], by[1:-1], by[2:]
        time, error = self.time_s, self.error
        inside = (self.pair[before] == self.pair[after]) & (time[after] > time[before])
        before, now, after = before[inside], now[inside], after[inside]
        if not len(now):
            return np.zeros(2)
        part = ((time[now] - time[before]) / (time[after] - time[before]))[:, None]
        off = error[now] - (1 - part) * error[before] - part * error[after]
        return np.asarray(1.4826 * np.median(np.abs(off) / np.sqrt(1 + part**2 + (1 - part) ** 2), axis=0))


def as_noisy_as_shown(scene: Scene, tracks: tracklets.Tracklets, track: IntArray, target: IntArray) -> Scene:
    """The scene with the noise that tracks of equal identity show, where it is greater than what is assumed, but believable."""
    noise = _differences(scene, tracks, track, target, hough.Bias()).noise()
    return _with_noise(scene, *noise.tolist()) if (noise <= _NOISIEST * _assumed(scene)).all() else scene


def course_of(
    scene: Scene, tracks: tracklets.Tracklets, track: IntArray, target: IntArray, found: hough.Bias | None
) -> Course | None:
    """The course of the biases that the pairs (`track`, `target`, (p,)) of equal identity share; None where there is none.

    `found` are constant biases on which most of them agree, if there are such; then only a course that leaves them by more than
    the noise is told.  At least two tracks must be seen at the same time, in five slices of it, and more than half of those seen
    together agree.
    """
    d = _differences(scene, tracks, track, target, found or hough.Bias())
    if len(d.pair) < 3 * _FEWEST_SLICES:
        return None
    noise, own = d.noise(), _assumed(scene)
    if (noise > _NOISIEST * own).any():
        return None
    error, sd = d.error - d.bends, np.sqrt(d.sd**2 + np.maximum(noise**2 - own**2, 0.0))
    width = max(_SLICE_S, _SCANS * scene.assumed.scan_s)
    number = np.floor((d.time_s - d.time_s.min()) / width).astype(np.int64)
    s = _sliced(number, d.pair, error, d.rate, sd)
    starts = np.flatnonzero(np.r_[True, np.diff(s.slice) != 0])
    # Only slices in which two tracks meet can tell whether tracks agree.
    several = [part for part in np.split(np.arange(len(s.pair)), starts[1:]) if len(np.unique(track[s.pair[part]])) >= 2]
    if len(several) < _FEWEST_SLICES:
        return None
    late = _lateness(scene, s, several) if found is None else found.time_s
    agrees = np.zeros(len(s.pair), bool)
    for part in several:
        agrees[part] = _agreeing(s, part, late)[0]
    met = np.concatenate(several)
    seen, with_others = np.bincount(s.pair[met], minlength=len(track)), np.bincount(s.pair[met], agrees[met], len(track))
    trusted = (with_others >= 2) & (with_others > _SHARE * seen)
    some = len(np.unique(track[trusted]))
    if agrees[met].mean() <= _SHARE or some < max(2, 0.4 * len(np.unique(track[seen > 0]))):
        return None
    # A track that agrees with others where they meet is believed where it is alone, and so are its target's that meet nobody.
    mine = (trusted | ((seen == 0) & np.isin(target, target[trusted])))[d.pair]
    moved = error[mine] + late * d.rate[mine]
    return _course(d.time_s[mine], number[mine], moved, sd[mine], noise, width, _WORTH[int(found is not None)])


def _differences(scene: Scene, tracks: tracklets.Tracklets, track: IntArray, target: IntArray, found: hough.Bias) -> _Differences:
    rows, pair = _plots_of(tracks, track)
    c = scene.compare(rows, target[pair])
    ok = c.valid if scene.assumed.min_speed_mps <= 0 else c.valid & (c.speed_mps >= 0.5 * scene.assumed.min_speed_mps)
    bends = found._replace(range_m=0.0, azimuth_rad=0.0, time_s=0.0).at(c.range_m, c.azimuth_rad)
    columns = [
        np.stack(two, axis=1)[ok]
        for two in (
            (c.range_error_m, c.azimuth_error_rad), (c.range_rate_mps, c.azimuth_rate_radps), (c.range_sd_m, c.azimuth_sd_rad),
            bends,
        )
    ]  # fmt: skip
    return _Differences(pair[ok], scene.plots.time_s[rows[ok]], *columns)


def _assumed(scene: Scene) -> FloatArray:
    return np.array([scene.assumed.range_sd_m, scene.assumed.azimuth_sd_rad])


def _with_noise(scene: Scene, range_sd_m: float, azimuth_sd_rad: float) -> Scene:
    a = scene.assumed
    if range_sd_m <= a.range_sd_m and azimuth_sd_rad <= a.azimuth_sd_rad:
        return scene
    wider = replace(a, range_sd_m=max(a.range_sd_m, range_sd_m), azimuth_sd_rad=max(a.azimuth_sd_rad, azimuth_sd_rad))
    return replace(scene, assumed=wider)


def _plots_of(tracks: tracklets.Tracklets, track: IntArray) -> tuple[IntArray, IntArray]:
    """The plots (m,) of tracks (p,), thinned evenly where they are many, and which of the tracks each is of."""
    length = tracks.length[track]
    pair = np.repeat(np.arange(len(track)), length)
    inside = np.arange(len(pair)) - np.repeat(np.cumsum(length) - length, length)
    keep = inside % max(1, -(-len(pair) // _ROWS)) == 0
    return tracks.order[tracks.start[track[pair]] + inside][keep], pair[keep]


def _medians(start: IntArray, group: IntArray, value: FloatArray) -> FloatArray:
    """The median of each group of the values (n,), which begin at `start` (k,) once sorted by `group`."""
    value = value[np.lexsort((value, group))]
    count = np.diff(np.r_[start, len(value)])
    return np.asarray(0.5 * (value[start + (count - 1) // 2] + value[start + count // 2]))


def _grouped(group: IntArray, *columns: FloatArray) -> tuple[IntArray, IntArray, list[FloatArray]]:
    """The numbers of the groups, how many rows each has, and the medians (k, 2) of columns (n, 2)."""
    number, count = np.unique(group, return_counts=True)
    start = np.cumsum(count) - count
    return number, count, [np.stack([_medians(start, group, column[:, k]) for k in range(2)], axis=1) for column in columns]


def _sliced(number: IntArray, pair: IntArray, error: FloatArray, rate: FloatArray, sd: FloatArray) -> _Slices:
    span = int(pair.max()) + 1
    group, _, medians = _grouped(number * span + pair, error, rate, sd)
    return _Slices(group // span, group % span, *medians)


def _agreeing(s: _Slices, part: IntArray, late_s: float) -> tuple[BoolArray, float]:
    """Which differences of a slice lie about the densest place of them, and how well they agree (0 to their number)."""
    at = s.error[part] + late_s * s.rate[part]
    off = (at[:, None] - at) / np.maximum(s.sd[part][:, None], s.sd[part])
    score = np.maximum(0.0, 1.0 - np.einsum("ijk,ijk->ij", off, off) / _GATE**2)
    best = int(np.argmax(score.sum(axis=1)))
    among = score[best] > 0
    # Whoever agrees with itself alone agrees with nobody.
    return among if among.sum() > 1 else np.zeros(len(part), bool), float(score[best].sum() - 1.0)


def _lateness(scene: Scene, s: _Slices, several: list[IntArray]) -> float:
    """How late the stamps are: what makes tracks that meet agree best."""
    if scene.window.time_s <= 0:
        return 0.0
    tried = [several[k] for k in np.unique(np.linspace(0, len(several) - 1, _TRIED).astype(np.int64))]
    fast, turning = np.quantile(np.abs(s.rate), 0.9, axis=0)
    range_sd, azimuth_sd = np.median(s.sd, axis=0)
    step = min(range_sd / max(fast, 1e-3), azimuth_sd / max(turning, 1e-9), scene.window.time_s)
    half = int(np.clip(np.ceil(scene.window.time_s / step), 1, 20))
    times = np.linspace(-scene.window.time_s, scene.window.time_s, 2 * half + 1)
    scores = [sum(_agreeing(s, part, float(late))[1] for part in tried) for late in times]
    return float(times[int(np.argmax(scores))])


def _course(
    time_s: FloatArray, number: IntArray, error: FloatArray, sd: FloatArray, noise: FloatArray, width_s: float, worth: float
) -> Course | None:
    """The medians of slices as knots about zero, of those components whose rms is `worth` it; None where neither is."""
    both = np.stack([time_s, time_s], axis=1)
    _, count, (value, spread, when) = _grouped(number, error, sd, both)
    keep = count >= 3
    if keep.sum() < _FEWEST_SLICES:
        return None
    value, spread, when = value[keep], spread[keep], when[keep, 0]
    value = value - np.median(value, axis=0)
    moves = np.sqrt(np.mean((value / spread) ** 2, axis=0)) > worth
    if not moves.any():
        return None
    value = np.where(moves, value, 0.0)
    return Course(when, value[:, 0], value[:, 1], float(noise[0]), float(noise[1]), width_s)
