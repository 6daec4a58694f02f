"""Heights of what tells only its pressure altitude: the atmosphere's difference, found from the traffic itself.

Pressure altitude is never a height (METHODS section 6): an atmosphere 15 K warmer than the standard is 650 m thicker up to
FL360, and 10 hPa of pressure are 80 m everywhere.  Aircraft with ADS-B tell both altitudes, and thereby what the difference is at
their level and time.  `height_profile` makes one smooth profile of all of them, whose sd grows where there is no traffic; where
none tells, what `sensors.toml` says of the pressure and the temperature is taken, else the standard atmosphere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ._types import FloatArray, IntArray
from .model import Fixes, Flag, Plots, Sensors
from .targets import targets_of

TRAFFIC, SENSORS_TOML, STANDARD = "traffic", "sensors.toml", "standard atmosphere"

_HOUR_S = 3600.0
# The profile's nodes: straight between them, it misses the curve of an atmosphere 15 K off the standard by 0.2 m.
_LEVELS_M = np.arange(-1000.0, 16_001.0, 1000.0)
_MOST_HOURS = 48
# Reports of one target are averaged over this; its altimeter's error stays the same in all of them.
_CELL_M, _CELL_S = 250.0, 900.0
_FEWEST_REPORTS = 20
# More reports than these say nothing more of an average over a quarter of an hour: every so many-th is taken.
_MOST_REPORTS = 300_000
# What is not known of an atmosphere before anybody tells: the pressure (as metres), the mean departure of temperature from the
# standard, departures of single layers (with the height over which they are alike), and how fast all of these change.
_SHIFT_SD_M, _KNOWN_SHIFT_SD_M = 80.0, 10.0
_MEAN_SD_K, _KNOWN_MEAN_SD_K = 10.0, 2.0
_LAYER_SD_K, _LAYER_M = 4.0, 2500.0
_SHIFT_HOURS, _MEAN_HOURS, _LAYER_HOURS = 500.0, 3000.0, 100.0
# Of a target: its altimeter and its GNSS height; of one of its cells: quantisation, turbulence, what wanders.
_TARGET_SD_M, _CELL_SD_M = 20.0, 6.0
_TARGETS_WORTH = 5.0
_ROUNDS = 8
# Beyond this many sd a target (or a cell) loses weight, and beyond the second figure all of it.
_SOFT_SD, _HARD_SD = 2.5, 6.0
# Where nothing but the standard atmosphere tells (METHODS section 6).
_STANDARD_SD_M, _STANDARD_SD_SHARE = 30.0, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class HeightProfile:
    """Geometric height (above the ellipsoid) minus pressure altitude, by level and hour.

    Rows (k,) are the nodes of a grid, level by level within each hour: `level_m` of pressure altitude, `hour` that begins (UTC,
    hours since 1970; the node is in the middle between it and the next), `difference_m`, its `sd_m`, and `n`, how many targets
    told it within the node's cell.  `spread_m` is the sd of one target about the profile (its altimeter, and the error of its
    geometric height).  `source` is "traffic", "sensors.toml" or "standard atmosphere" (one hour, 0, stands for all then);
    `targets` have told both altitudes, `outliers` of them were given no weight.
    """

    source: str
    level_m: FloatArray
    hour: IntArray
    difference_m: FloatArray
    sd_m: FloatArray
    n: IntArray
    spread_m: float
    targets: int = 0
    outliers: int = 0

    def __len__(self) -> int:
        return len(self.level_m)

    def at(self, level_m: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The difference at pressure altitudes and times (m,), UTC seconds, and the sd (m,) of one target's height taken from it.

        Straight between nodes; beyond the first and last hour it is held, with 5 m more for the root of each hour.  A time that
        is not known counts as the middle of the profile's span, with what the profile changes over it.
        """
        levels = len(np.unique(self.level_m))
        begins = self.hour[::levels]
        hours = begins + 0.5 * (begins[1] - begins[0] if len(begins) > 1 else 1)
        value, sd = self.difference_m.reshape(-1, levels), self.sd_m.reshape(-1, levels)
        edge = self.level_m[:levels]
        level = np.asarray(level_m, np.float64)
        asked = np.asarray(time_s, np.float64) / _HOUR_S
        timeless = ~np.isfinite(asked)
        asked = np.where(timeless, hours[len(hours) // 2], asked)
        j = np.clip(np.searchsorted(edge, level) - 1, 0, levels - 2)
        v = np.clip((level - edge[j]) / (edge[j + 1] - edge[j]), 0.0, 1.0)
        if len(hours) > 1:
            i = np.clip(np.searchsorted(hours, asked) - 1, 0, len(hours) - 2)
            w = np.clip((asked - hours[i]) / (hours[i + 1] - hours[i]), 0.0, 1.0)
            after = i + 1
        else:
            i, w = np.zeros(len(level), np.int64), np.zeros(len(level))
            after = i

        def between(table: FloatArray) -> FloatArray:
            early = (1 - v) * table[i, j] + v * table[i, j + 1]
            late = (1 - v) * table[after, j] + v * table[after, j + 1]
            return np.asarray((1 - w) * early + w * late)

        away_h = np.maximum(np.maximum(hours[0] - asked, asked - hours[-1]) - 0.5, 0.0)
        change = np.where(timeless, np.ptp(value[:, j], axis=0), 0.0)
        away_m = np.maximum(np.maximum(edge[0] - level, level - edge[-1]), 0.0)
        if self.source != TRAFFIC:
            away_h = np.zeros(len(level))
        variance = between(sd) ** 2 + self.spread_m**2 + 25.0 * away_h + (0.05 * away_m) ** 2 + change**2
        return between(value), np.sqrt(variance)


def stretch_m_per_k(level_m: FloatArray) -> FloatArray:
    """How much thicker the air below pressure altitudes (n,) is for each kelvin above the standard atmosphere (hydrostatic)."""
    low = np.minimum(level_m, 11_000.0)
    return np.asarray(np.log(288.15 / (288.15 - 0.0065 * low)) / 0.0065 + np.maximum(level_m - 11_000.0, 0.0) / 216.65)


class _Prior(NamedTuple):
    """What is expected before the traffic tells: the difference (levels,), and the sd of shift and mean departure."""

    source: str
    difference_m: FloatArray
    shift_sd_m: float
    mean_sd_k: float


def _prior(level_m: FloatArray, sensors: Sensors | None) -> _Prior:
    air = sensors.atmosphere if sensors is not None else None
    geoids = [s.geoid_m for s in sensors if s.geoid_m is not None] if sensors is not None else []
    geoid = float(np.median(geoids)) if geoids else 0.0
    if air is None:
        return _Prior(STANDARD, np.full(len(level_m), geoid), _SHIFT_SD_M, _MEAN_SD_K)
    if air.geoid_m is not None:
        geoid = air.geoid_m
    shift, warm = geoid, 0.0
    if air.qnh_hpa is not None:
        # The pressure altitude of mean sea level (ICAO Doc 7488).
        shift -= 44_330.77 * (1 - (air.qnh_hpa / 1013.25) ** 0.190263)
    if air.isa_deviation_k is not None:
        warm = air.isa_deviation_k
    geopotential = level_m + shift - geoid + warm * stretch_m_per_k(level_m)
    # Metres of geopotential are shorter than metres above: 19 m at 11 km.
    height = 6_356_766.0 * geopotential / (6_356_766.0 - geopotential) + geoid
    return _Prior(
        SENSORS_TOML,
        height - level_m,
        _SHIFT_SD_M if air.qnh_hpa is None else _KNOWN_SHIFT_SD_M,
        _MEAN_SD_K if air.isa_deviation_k is None else _KNOWN_MEAN_SD_K,
    )


def _given(prior: _Prior) -> HeightProfile:
    """The profile where no traffic tells."""
    level = _LEVELS_M
    shift = _STANDARD_SD_M if prior.shift_sd_m == _SHIFT_SD_M else _KNOWN_SHIFT_SD_M
    share = _STANDARD_SD_SHARE if prior.mean_sd_k == _MEAN_SD_K else 0.01
    return HeightProfile(
        source=prior.source,
        level_m=level,
        hour=np.zeros(len(level), np.int64),
        difference_m=prior.difference_m,
        sd_m=shift + share * np.abs(level),
        n=np.zeros(len(level), np.int64),
        spread_m=0.0,
    )


class _Cells(NamedTuple):
    """Medians of one target's reports within one level and quarter of an hour (m,)."""

    target: IntArray
    level_m: FloatArray
    hour: FloatArray
    difference_m: FloatArray


def _cells(fixes: Fixes) -> _Cells | None:
    """The cells of all targets that tell both altitudes; None where too few reports do."""
    both = np.isfinite(fixes.height_m) & np.isfinite(fixes.pressure_altitude_m) & np.isfinite(fixes.time_s)
    both &= (fixes.flags & np.uint32(Flag.GROUND)) == 0
    rows = np.flatnonzero(both)
    if len(rows) < _FEWEST_REPORTS:
        return None
    rows = rows[:: max(1, len(rows) // _MOST_REPORTS)]
    target = targets_of(fixes[rows])
    rows, target = rows[target >= 0], target[target >= 0]
    if len(rows) < _FEWEST_REPORTS:
        return None
    level, time = fixes.pressure_altitude_m[rows], fixes.time_s[rows]
    difference = fixes.height_m[rows] - level
    bin_level, bin_time = np.floor(level / _CELL_M), np.floor(time / _CELL_S)
    order = np.lexsort((difference, bin_level, bin_time, target))
    change = (np.diff(target[order]) != 0) | (np.diff(bin_time[order]) != 0) | (np.diff(bin_level[order]) != 0)
    start = np.flatnonzero(np.r_[True, change])
    count = np.diff(np.r_[start, len(order)])
    # Sorted by difference within each cell: the median is in the middle.
    low, high = difference[order[start + (count - 1) // 2]], difference[order[start + count // 2]]
    return _Cells(
        target=np.unique(target[order[start]], return_inverse=True)[1].astype(np.int64),
        level_m=np.add.reduceat(level[order], start) / count,
        hour=np.add.reduceat(time[order] - time[0], start) / count / _HOUR_S + time[0] / _HOUR_S,
        difference_m=0.5 * (low + high),
    )


def _hats(value: FloatArray, node: FloatArray) -> tuple[IntArray, FloatArray]:
    """The node below each value (m,), clipped, and how much of the way to the next one it has gone."""
    if len(node) == 1:
        return np.zeros(len(value), np.int64), np.zeros(len(value))
    k = np.clip(np.searchsorted(node, value) - 1, 0, len(node) - 2)
    return k, np.clip((value - node[k]) / (node[k + 1] - node[k]), 0.0, 1.0)


def _covariance(level_m: FloatArray, hour: FloatArray, prior: _Prior) -> FloatArray:
    """What may differ from the prior (hours × levels, squared): pressure, mean temperature, layers, each changing slowly."""
    apart = np.abs(hour[:, None] - hour[None, :])
    grow = stretch_m_per_k(level_m)
    # A layer that is warmer by dT is thicker by dT / T of itself; thickness adds up from the sea's level.
    fine = np.linspace(level_m[0], level_m[-1], 10 * (len(level_m) - 1) + 1)
    temperature = np.maximum(288.15 - 0.0065 * fine, 216.65)
    step = fine[1] - fine[0]
    total = np.tri(len(fine)) * (step / temperature)[None, :]
    total -= total[np.argmin(np.abs(fine))][None, :]
    layers = _LAYER_SD_K**2 * np.exp(-np.abs(fine[:, None] - fine[None, :]) / _LAYER_M)
    thick = (total @ layers @ total.T)[::10, ::10]
    shift = prior.shift_sd_m**2 * np.exp(-apart / _SHIFT_HOURS)
    mean = prior.mean_sd_k**2 * np.exp(-apart / _MEAN_HOURS)
    fast = np.exp(-apart / _LAYER_HOURS)
    return np.asarray(
        np.kron(shift, np.ones((len(level_m), len(level_m)))) + np.kron(mean, np.outer(grow, grow)) + np.kron(fast, thick)
    )


def _trust(u: FloatArray) -> FloatArray:
    """The weight at u sd: 1 up to `_SOFT_SD`, falling smoothly to nothing at `_HARD_SD`."""
    far = np.clip((np.abs(u) - _SOFT_SD) / (_HARD_SD - _SOFT_SD), 0.0, 1.0)
    return np.asarray((1 - far * far) ** 2)


def height_profile(fixes: Fixes, sensors: Sensors | None = None) -> HeightProfile:
    """The difference of geometric height and pressure altitude that the traffic in `fixes` tells, smooth over level and time.

    `fixes` are as they were read (before `alignment.locate` fills in heights).  Every target has an offset of its own (altimeter,
    GNSS), every layer of the air a departure of temperature that lasts for hours, and the pressure drifts: the profile is the
    best linear estimate under these, robust against targets whose altimeters or encodings are wrong.  Its sd grows with the
    distance from the traffic.  What `sensors` tells of the atmosphere is the starting point, and all there is without traffic.
    Source: METHODS section 6.
    """
    from scipy.linalg import cho_factor, cho_solve

    prior = _prior(_LEVELS_M, sensors)
    cells = _cells(fixes)
    if cells is None:
        return _given(prior)
    first, last = math.floor(cells.hour.min()), math.floor(cells.hour.max())
    step = max(1, math.ceil((last - first + 1) / _MOST_HOURS))
    begins = first + step * np.arange((last - first) // step + 1)
    hour = begins + 0.5 * step
    levels = len(_LEVELS_M)
    size = len(hour) * levels

    i, w = _hats(cells.hour, hour)
    j, v = _hats(cells.level_m, _LEVELS_M)
    later = np.minimum(i + 1, len(hour) - 1)
    node = np.stack([i * levels + j, i * levels + j + 1, later * levels + j, later * levels + j + 1], axis=1)
    share = np.stack([(1 - w) * (1 - v), (1 - w) * v, w * (1 - v), w * v], axis=1)
    off = cells.difference_m - (share * prior.difference_m[node % levels]).sum(axis=1)

    covariance = _covariance(_LEVELS_M, hour, prior)
    covariance[np.diag_indices(size)] += 1e-6
    precision = cho_solve(cho_factor(covariance, lower=True), np.eye(size))
    targets = int(cells.target.max()) + 1
    target_sd, cell_sd = _TARGET_SD_M, _CELL_SD_M
    trust, sure = np.ones(targets), np.ones(len(off))
    value = np.zeros(size)
    for _ in range(_ROUNDS):
        weight = sure / cell_sd**2
        own = np.zeros((targets, size))
        np.add.at(own, (cells.target[:, None], node), weight[:, None] * share)
        sum_weight = np.bincount(cells.target, weight, targets)
        # A target's own offset is eliminated; one that is not trusted is let go wherever it is.
        shrink = 1 / (sum_weight + 1 / (target_sd**2 / np.maximum(trust, 1e-6)))
        normal = precision.copy()
        for a in range(4):
            for b in range(4):
                np.add.at(normal, (node[:, a], node[:, b]), weight * share[:, a] * share[:, b])
        normal -= own.T @ (shrink[:, None] * own)
        normal = (normal + normal.T) / 2
        right = np.zeros(size)
        np.add.at(right, node, (weight * off)[:, None] * share)
        right -= own.T @ (shrink * np.bincount(cells.target, weight * off, targets))
        factor = cho_factor(normal, lower=True)
        value = cho_solve(factor, right)
        left = off - (share * value[node]).sum(axis=1)
        mean = np.bincount(cells.target, weight * left, targets) / np.maximum(sum_weight, 1e-12)
        # Few targets cannot tell how much they differ: a typical figure counts as some more of them.
        seen = (1.4826 * np.median(np.abs(mean))) ** 2
        target_sd = math.sqrt((targets * seen + _TARGETS_WORTH * _TARGET_SD_M**2) / (targets + _TARGETS_WORTH))
        rest = left - mean[cells.target]
        inside = rest[np.bincount(cells.target, minlength=targets)[cells.target] > 2]
        if len(inside) > 10:
            cell_sd = max(1.4826 * float(np.median(np.abs(inside))), 2.0)
        trust, sure = _trust(mean / target_sd), np.maximum(_trust(rest / max(cell_sd, 1e-3)), 1e-3)
    sd = np.sqrt(np.diag(cho_solve(factor, np.eye(size))))
    near = np.rint(i + w).astype(np.int64) * levels + np.rint(j + v).astype(np.int64)
    counted = np.unique(near * targets + cells.target) // targets
    return HeightProfile(
        source=TRAFFIC,
        level_m=np.tile(_LEVELS_M, len(hour)),
        hour=np.repeat(begins, levels),
        difference_m=value + np.tile(prior.difference_m, len(hour)),
        sd_m=np.asarray(sd, np.float64),
        n=np.bincount(counted, minlength=size).astype(np.int64),
        spread_m=math.hypot(target_sd, cell_sd),
        targets=targets,
        outliers=int(np.count_nonzero(trust < 0.1)),
    )


def plot_heights(plots: Plots, heights: HeightProfile) -> tuple[FloatArray, FloatArray]:
    """Ellipsoidal heights (n,) of plots by their pressure altitude (Mode C) and the profile, and the sd of each (n,).

    A plot's own `height_m` is kept (its sd is NaN); where there is neither, both are NaN.
    """
    height, sd = plots.height_m.copy(), np.full(len(plots), np.nan)
    rows = np.flatnonzero(~np.isfinite(height) & np.isfinite(plots.pressure_altitude_m))
    if len(rows):
        difference, sd[rows] = heights.at(plots.pressure_altitude_m[rows], plots.time_s[rows])
        height[rows] = plots.pressure_altitude_m[rows] + difference
    return height, sd
