"""The difference of the two chains of a combined radar: primary minus secondary, as its own plots tell it (I048/130).

The position of a combined plot is the secondary radar's; RPD and APD say where the primary radar saw the same target.  The
difference needs no reference: it is known before any registration, and what corrects one chain must move it (METHODS section 6).
"""

# ruff: noqa: RUF009  (columns are declared by a call that returns a dataclass field)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..model import EXCLUDED, Channel, Plots, _column, _float, _Table

NM = 1852.0
# A difference this many robust sd away from the middle says nothing of the chains: another target, or a wrong pairing of plots.
CUT = 5.0
# The channel of the row for all channels together.
ALL = -1


@dataclass(frozen=True, slots=True, eq=False)
class PsrSsr(_Table):
    """PSR - SSR, one row a radar and channel; `channel` -1 stands for all channels of the radar together.

    `plots` is the number of plots that tell the difference and are used, `outliers` of those left out beyond 5 robust sd,
    `targets` of the aircraft.  The sd is that of one plot; `…_se` is the uncertainty of a mean, with one error a target.
    The slope is that of the range difference over range (m per metre), the middle the difference at the mean range.
    """

    sensor: AnyArray = _column(np.int32)
    channel: AnyArray = _column(np.int8, 0)
    plots: IntArray = _column(np.int64)
    outliers: IntArray = _column(np.int64)
    targets: IntArray = _column(np.int64)
    range_m: FloatArray = _float()
    range_se_m: FloatArray = _float()
    range_median_m: FloatArray = _float()
    range_sd_m: FloatArray = _float()
    slope: FloatArray = _float()
    slope_se: FloatArray = _float()
    azimuth_rad: FloatArray = _float()
    azimuth_se_rad: FloatArray = _float()
    azimuth_sd_rad: FloatArray = _float()


def psr_ssr(plots: Plots) -> PsrSsr:
    """The difference PSR - SSR in range (m) and azimuth (rad) by radar and channel, with its slope over range.

    Plots with a flag of `EXCLUDED` take no part.  Empty where no plot tells the difference.
    """
    told = np.isfinite(plots.psr_ssr_range_m) & (plots.flags & int(EXCLUDED) == 0)
    rows: list[dict[str, float]] = []
    for sensor in np.unique(plots.sensor[told]).tolist():
        mine = told & (plots.sensor == sensor)
        channels = np.unique(plots.channel[mine]).tolist()
        for channel in [*channels, *([ALL] if len(channels) > 1 else [])]:
            use = mine if channel == ALL else mine & (plots.channel == channel)
            rows.append({"sensor": sensor, "channel": channel} | _row(plots, np.flatnonzero(use)))
    names = rows[0] if rows else {}
    return PsrSsr(**{name: np.array([row[name] for row in rows]) for name in names})


def _row(plots: Plots, use: IntArray) -> dict[str, float]:
    kept = _within(plots.psr_ssr_range_m[use]) & _within(plots.psr_ssr_azimuth_rad[use])
    outliers = int(np.count_nonzero(~kept))
    use = use[kept]
    difference, azimuth, distance = plots.psr_ssr_range_m[use], plots.psr_ssr_azimuth_rad[use], plots.range_m[use]
    # One aircraft is one sample of the chains' difference: its transponder's delay is in all its plots.
    whose = np.where(plots.mode_s[use] >= 0, plots.mode_s[use].astype(np.int64), -2 - plots.track[use].astype(np.int64))
    _, target = np.unique(whose, return_inverse=True)
    mean, mean_se = _clustered(np.ones((len(use), 1)), difference, target)
    angle, angle_se = _clustered(np.ones((len(use), 1)), azimuth, target)
    spread = np.ptp(distance) > 0 if len(use) else False
    middle = distance - distance.mean() if len(use) else distance
    line, line_se = (
        _clustered(np.column_stack([np.ones(len(use)), middle]), difference, target) if spread else ([np.nan] * 2,) * 2
    )
    several = len(use) > 1
    return {
        "plots": len(use), "outliers": outliers, "targets": int(target.max(initial=-1)) + 1,
        "range_m": mean[0], "range_se_m": mean_se[0], "range_median_m": float(np.median(difference)) if len(use) else np.nan,
        "range_sd_m": float(np.std(difference, ddof=1)) if several else np.nan,
        "slope": line[1], "slope_se": line_se[1],
        "azimuth_rad": angle[0], "azimuth_se_rad": angle_se[0],
        "azimuth_sd_rad": float(np.nanstd(azimuth, ddof=1)) if several and np.isfinite(azimuth).any() else np.nan,
    }  # fmt: skip


def _within(value: FloatArray) -> BoolArray:
    """What lies within `CUT` robust sd of the median, or is absent."""
    known = value[np.isfinite(value)]
    if not len(known):
        return np.ones(len(value), bool)
    middle = np.median(known)
    # Values come in steps of RPD and APD: a sd of nothing would cut all but the most frequent one.
    spread = 1.4826 * np.median(np.abs(known - middle))
    spread = spread if spread > 0 else np.std(known)
    return np.asarray(np.isnan(value) | (np.abs(value - middle) <= CUT * spread + 1e-12))


def _clustered(columns: FloatArray, value: FloatArray, target: IntArray) -> tuple[FloatArray, FloatArray]:
    """Least squares and the sd of its coefficients, with errors that one target's rows share (sandwich, G / (G - 1))."""
    known = np.isfinite(value)
    x, y, whose = columns[known], value[known], target[known]
    p = x.shape[1]
    if len(y) < p or not len(y):
        return np.full(p, np.nan), np.full(p, np.nan)
    scale = np.sqrt(np.mean(x**2, axis=0))
    found, _, rank, _ = np.linalg.lstsq(x / scale, y, rcond=None)
    _, cluster = np.unique(whose, return_inverse=True)
    groups = int(cluster.max()) + 1
    if rank < p or groups < 2:
        return np.asarray(found / scale), np.full(p, np.nan)
    residual = y - x / scale @ found
    score = np.column_stack([np.bincount(cluster, x[:, k] / scale[k] * residual, groups) for k in range(p)])
    bread = np.linalg.pinv((x / scale).T @ (x / scale))
    covariance = bread @ (score.T @ score) @ bread * groups / (groups - 1)
    return np.asarray(found / scale), np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0)) / scale)


def channel_name(channel: int) -> str:
    """The name of a row's channel, as a person reads it."""
    names = {
        ALL: "all", Channel.UNKNOWN: "unknown", Channel.PSR: "PSR", Channel.SSR: "SSR", Channel.MODE_S: "Mode S",
        Channel.SSR_PSR: "SSR + PSR", Channel.MODE_S_PSR: "Mode S + PSR", Channel.MLAT: "MLAT", Channel.ADS_B: "ADS-B",
    }  # fmt: skip
    return names.get(channel, str(channel))
