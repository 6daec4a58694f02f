"""Several radars, one target: their plots in one order of time into one filter, or merged into one radar's plots first.

In serial processing each plot carries its own covariance into the filter (paper 003 section 1.3), whatever radar it is from.  The
baseline pairs the plots of two radars by statistical distance within a gate and compresses each pair into one plot (section 1.2;
its eq. 4 needs R^-1 and z2 - z1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import SettingsError
from ..frames import Automatic, Decorrelated, Ecef, Enu, Frame, Linear, Method, Multiplicative, Polar, at_rows, convert
from .kalman import Filtered, kalman_filter, one_point
from .motion import Motion, matrices, size

CONVERSIONS = ("automatic", "linear", "multiplicative", "decorrelated")


class PolarPlots(NamedTuple):
    """Plots of one target by several radars, of n Monte Carlo runs (or targets seen at the same times).

    `value` (n, K, k): range, azimuth and, for k = 3, elevation, NaN for a missed plot; `covariance` (K, k, k) of each plot;
    `time_s` (K,), in order; `radar` (K,) the index of each plot's radar.
    """

    value: FloatArray
    covariance: FloatArray
    time_s: FloatArray
    radar: IntArray


def serial_filter(
    plots: PolarPlots,
    radars: Sequence[Polar],
    motion: Motion,
    *,
    frame: Frame | None = None,
    conversion: str = "automatic",
    speed_sd_mps: float = 300.0,
    start: tuple[FloatArray, FloatArray] | None = None,
    first: int = 0,
) -> Filtered:
    """One Kalman filter over the plots of all radars, in order of time.

    `radars` are the radars' frames; `frame` is where the filter works (Cartesian; None: east, north, up about the first radar,
    or the plane's own axes for flat scenes): turns need its third axis to point up.  `conversion` is how plots become positions:
    "decorrelated" evaluates a plot's covariance at the prediction, "automatic" does so where a plot's own is not good enough.
    Without a `start` at plot number `first`, the filter starts there with velocities of `speed_sd_mps`.  State and results as of
    `kalman.kalman_filter`.

    Raises SettingsError for shapes, times or names that make no sense.
    """
    n, steps, k = plots.value.shape
    target: Frame = _about(radars) if frame is None else frame
    if isinstance(target, Polar):
        raise SettingsError("the filter works on Cartesian axes", where="serial", remedy="Give Enu(...) or Ecef() as the frame.")
    if conversion not in CONVERSIONS:
        raise SettingsError(
            f"there is no conversion {conversion!r}", where="serial", remedy=f"Conversions: {', '.join(CONVERSIONS)}."
        )
    if (
        plots.radar.shape != (steps,)
        or plots.covariance.shape != (steps, k, k)
        or (steps and not 0 <= int(plots.radar.min()) <= int(plots.radar.max()) < len(radars))
    ):
        raise SettingsError(
            f"plots {plots.value.shape}, covariances {plots.covariance.shape} and {len(radars)} radars do not fit",
            where="serial",
            remedy="Give (n, K, k), (K, k, k), and radars numbered from 0.",
        )

    def position(step: int, predicted: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        source = radars[int(plots.radar[step])]
        value = plots.value[:, step]
        spread = np.broadcast_to(plots.covariance[step], (n, k, k))
        method: Method
        if conversion == "linear":
            method = Linear()
        elif conversion == "multiplicative" or (conversion == "decorrelated" and predicted is None):
            method = Multiplicative()
        elif conversion == "decorrelated" and predicted is not None:
            method = Decorrelated(predicted)
        else:
            method = Automatic(in_track=True, predicted=predicted)
        return convert(value, spread, source, target, method=method)

    if conversion in ("linear", "multiplicative"):
        # A plot's covariance is its own affair: the whole run is one call.
        both = [position(step, None) for step in range(steps)]
        z, r = np.stack([b[0] for b in both], axis=1), np.stack([b[1] for b in both], axis=1)
        begin = one_point(z[:, first], r[:, first], size([motion], k), speed_sd_mps) if start is None else start
        return kalman_filter(z, r, plots.time_s, motion, begin, first=first)
    z0, r0 = position(first, None)
    x, p = one_point(z0, r0, size([motion], k), speed_sd_mps) if start is None else start
    d = x.shape[1]
    out = Filtered(
        plots.time_s, np.full((n, steps, d), np.nan), np.full((n, steps, d, d), np.nan), np.full((n, steps), np.nan),
        np.full((n, steps), np.nan),
    )  # fmt: skip
    out.mean[:, first], out.covariance[:, first] = x, p
    for step in range(first + 1, steps):
        dt = float(plots.time_s[step] - plots.time_s[step - 1])
        ahead = x @ matrices(motion, max(dt, 0.0), k, state=d)[0].T
        there = np.zeros((n, 3))
        there[:, :k] = ahead[:, :k]
        z, r = position(step, target.to_ecef(there)[0])
        # The first of the two rows is the present state; it is not taken in.
        pair = np.stack([np.full_like(z, np.nan), z], axis=1), np.stack([r, r], axis=1)
        one = kalman_filter(*pair, plots.time_s[step - 1 : step + 1], motion, (x, p))
        x, p = np.ascontiguousarray(one.mean[:, 1]), np.ascontiguousarray(one.covariance[:, 1])
        out.mean[:, step], out.covariance[:, step] = x, p
        out.nis[:, step], out.likelihood[:, step] = one.nis[:, 1], one.likelihood[:, 1]
    return out


def _about(radars: Sequence[Polar]) -> Frame:
    """Axes about the first radar; those of the plane where the radars stand on one (nowhere near the Earth's surface)."""
    first = at_rows(radars[0], slice(0, 1)) if np.ndim(radars[0].site) == 2 else radars[0]
    assert isinstance(first, Polar)
    site, rotation = np.reshape(first.site, 3), np.reshape(first.rotation, (3, 3))
    return Enu(site, rotation) if np.linalg.norm(site) > 6e6 else Ecef()


# ----------------------------------------------------------------------------------------------------- gates, pairs, merged plots
class Rectangular(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="rectangular"):
    """Within so many metres in each coordinate (paper 003 eq. 3)."""

    half_width_m: float = 1000.0

    def __call__(self, off: FloatArray, covariance: FloatArray) -> BoolArray:
        """Which differences (…, k) are within; the covariance plays no part."""
        return np.asarray((np.abs(off) <= self.half_width_m).all(axis=-1))


class Elliptical(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="elliptical"):
    """Within the ellipse that holds the share `probability` of a target's own plots (paper 003 eq. 2)."""

    probability: float = 0.99

    def __call__(self, off: FloatArray, covariance: FloatArray) -> BoolArray:
        """Which differences (…, k) with covariances (…, k, k) are within."""
        from scipy.special import chdtri

        return np.asarray(statistical_distance(off, covariance) <= chdtri(off.shape[-1], 1 - self.probability))


Gate = Rectangular | Elliptical


def statistical_distance(off: FloatArray, covariance: FloatArray) -> FloatArray:
    """The squared distance off' R^-1 off (…) of differences (…, k) with covariances (…, k, k): paper 003 eq. 4, with R^-1."""
    return np.asarray(np.einsum("...i,...i->...", off, np.linalg.solve(covariance, off[..., None])[..., 0]))


def pair_plots(one: FloatArray, one_r: FloatArray, two: FloatArray, two_r: FloatArray, gate: Gate) -> IntArray:
    """For each plot of one radar (n, k) the nearest of the other's (m, k) within the gate, each used once; -1 for none.

    The distance is statistical, by the sum of both covariances; pairs are made so that their distances sum to the least.
    """
    from scipy.optimize import linear_sum_assignment

    if not len(one) or not len(two):
        return np.full(len(one), -1)
    off = two[None] - one[:, None]
    spread = one_r[:, None] + two_r[None]
    within = gate(off, spread)
    distance = statistical_distance(off, spread)
    # Leaving a plot alone costs more than any pair, so that as many are paired as can be.
    far = float(distance[within].max(initial=0.0)) * (len(one) + 1) + 1.0
    left, right = linear_sum_assignment(np.where(within, distance, far))
    out = np.full(len(one), -1)
    good = within[left, right]
    out[left[good]] = right[good]
    return out


def compress(one: FloatArray, one_r: FloatArray, two: FloatArray, two_r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two plots of one target at one time as one plot: mean (n, k) weighted by the inverse covariances, and its covariance."""
    total = one_r + two_r
    gain = np.swapaxes(np.linalg.solve(total, one_r), -1, -2)
    mean = one + (gain @ (two - one)[..., None])[..., 0]
    spread = one_r - gain @ one_r
    return mean, (spread + np.swapaxes(spread, -1, -2)) / 2


def in_order(*radars: PolarPlots) -> PolarPlots:
    """The plots of several radars as one series in order of time (of one time: in the order given)."""
    time_s = np.concatenate([p.time_s for p in radars])
    order = np.argsort(time_s, kind="stable")
    return PolarPlots(
        np.concatenate([p.value for p in radars], axis=1)[:, order],
        np.concatenate([p.covariance for p in radars])[order],
        time_s[order],
        np.concatenate([p.radar for p in radars])[order],
    )
