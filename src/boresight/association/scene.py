"""One radar's plots beside the reference: who could be whom, and by how much they differ."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import alignment, measure
from .._parallel import in_threads, slices
from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..errors import InputError, NothingToDo
from ..model import Fixes, Flag, Plots, Sensor
from . import identity
from .hough import Bias, Candidates, Window, residuals, within
from .settings import AssociationSettings, Assumed

NO_BIAS = Bias()
# Candidates are made in pieces of this many, which bounds the memory, and compared in smaller ones, which the processor's cache
# holds.
_CHUNK = 400_000
_ROWS = 1 << 15
# Over this long a target must have moved on average, so that the noise of a reference is not taken for motion.
_MOTION_S = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The reference, prepared once for all sensors.

    `target` (n,) is the target of each fix (-1: unusable), `order` sorts the fixes by target and time; spans and names are by
    target.
    """

    fixes: Fixes
    trajectories: alignment.Trajectories
    target: IntArray
    order: IntArray
    start_s: FloatArray
    end_s: FloatArray
    names: identity.Names

    def seen_by(self, view: alignment.Viewer | None) -> Reference:
        """The same reference as a moving radar sees it; itself where there is no `view`."""
        return self if view is None else replace(self, trajectories=replace(self.trajectories, view=view))

    def nearest_fix(self, target: IntArray, time_s: FloatArray) -> IntArray:
        """The row of the target's fix (m,) that is nearest in time."""
        low, high = float(np.min(self.start_s)) - 10.0, float(np.max(self.end_s)) + 10.0
        width = 2 * (high - low)
        key = self.target[self.order] * width + (self.fixes.time_s[self.order] - low)
        ask = target * width + np.clip(time_s - low, 0.0, high - low)
        after = np.clip(np.searchsorted(key, ask), 1, max(len(key) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(key) - 1)
        return self.order[np.where(np.abs(key[before] - ask) <= np.abs(key[after] - ask), before, after)]


def reference_of(fixes: Fixes, settings: AssociationSettings) -> Reference:
    """Prepare the reference.  Raises InputError for Cartesian fixes, NothingToDo where there is no position."""
    placed = np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad) & np.isfinite(fixes.time_s)
    if not np.any(placed):
        if np.any(np.isfinite(fixes.x_m)):
            raise InputError(
                "the reference's positions are still Cartesian", remedy="Call alignment.locate(fixes, sensors, sources) first."
            )
        raise NothingToDo("the reference holds no position", remedy="It needs ADS-B or multilateration reports with positions.")
    trajectories = alignment.trajectories(fixes, method=settings.interpolation, max_gap_s=settings.reference_gap_s)
    target = np.where(placed, trajectories.target, -1)
    rows = np.flatnonzero(target >= 0)
    if not len(rows):
        raise NothingToDo(
            "no position of the reference belongs to a target",
            remedy="Targets are told by Mode S, MMSI, callsign or track number.",
        )
    order = rows[np.lexsort((fixes.time_s[rows], target[rows]))]
    count = int(target.max()) + 1
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, target[rows], fixes.time_s[rows])
    np.maximum.at(high, target[rows], fixes.time_s[rows])
    # A target that lost all its fixes overlaps with nothing.
    low[~np.isfinite(low)], high[~np.isfinite(high)] = fixes.time_s[rows].max() + 1e6, fixes.time_s[rows].max() + 1e6
    return Reference(fixes, trajectories, target, order, low, high, identity.names_of_targets(fixes, target))


class Units(NamedTuple):
    """What is compared: tracklets or single plots.  `unit` (m,) ascending, plot `row` (m,), `weight` 1 / points of the unit."""

    unit: IntArray
    row: IntArray
    weight: FloatArray


class Compared(NamedTuple):
    """Plots against targets (m,): errors measured - reference at the stamp (or `late_s` before), rates, sd, what is valid.

    `range_m`, `azimuth_rad` and `ground_m` (horizontal distance) are the reference's as the radar sees it.
    """

    range_error_m: FloatArray
    azimuth_error_rad: FloatArray
    range_rate_mps: FloatArray
    azimuth_rate_radps: FloatArray
    range_sd_m: FloatArray
    azimuth_sd_rad: FloatArray
    range_m: FloatArray
    azimuth_rad: FloatArray
    ground_m: FloatArray
    speed_mps: FloatArray
    valid: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One sensor's plots against the reference; `azimuth_rad` is from true north.

    `more_range_sd_m` and `more_azimuth_sd_rad` (n,) are what single plots may be off beyond what is assumed of all.
    """

    plots: Plots
    azimuth_rad: FloatArray
    sensor: Sensor
    assumed: Assumed
    window: Window
    settings: AssociationSettings
    site: FloatArray
    enu_from_ecef: FloatArray
    reference: Reference
    more_range_sd_m: FloatArray | None = None
    more_azimuth_sd_rad: FloatArray | None = None

    @property
    def on_ground(self) -> bool:
        """Whether only targets on the ground are this radar's."""
        return self.sensor.kind == "surface"

    def local(self, vector: FloatArray) -> FloatArray:
        """ECEF vectors (m, 3) in the radar's east, north, up."""
        # Many short rows: einsum is 10 to 20 times faster than a matrix product through BLAS.
        return np.asarray(np.einsum("ij,kj->ki", self.enu_from_ecef, vector))

    def compare(
        self, row: IntArray, target: IntArray, shift_s: AnyArray | float = 0.0, turn_rad: float = 0.0, late_s: float = 0.0
    ) -> Compared:
        """Compare plots (m,) with targets (m,).

        The reference is taken `shift_s` after the stamp (to spoil or repair clocks) and `turn_rad` is added to the azimuth;
        `late_s` moves the reference back along its own motion, p - v late + a late² / 2.
        """
        n = len(row)
        e = np.empty((10, n))
        out = Compared(e[0], e[1], e[2], e[3], e[4], e[5], e[6], e[7], e[8], e[9], np.zeros(n, bool))
        shift = np.broadcast_to(np.asarray(shift_s, np.float64), (n,))

        def compare(piece: slice) -> None:
            for column, value in zip(out, self._compare(row[piece], target[piece], shift[piece], turn_rad, late_s), strict=True):
                column[piece] = value

        in_threads(compare, slices(n, _ROWS))
        return out

    def _compare(self, row: IntArray, target: IntArray, shift_s: FloatArray, turn_rad: float, late_s: float) -> Compared:
        a = self.assumed
        s = alignment.states(self.reference.trajectories, target, self.plots.time_s[row] + shift_s)
        position = s.position - late_s * s.velocity + 0.5 * late_s**2 * np.nan_to_num(s.acceleration)
        enu, velocity = self.local(position - self.site), self.local(s.velocity)
        valid = s.valid & np.isfinite(enu).all(axis=1)
        enu, velocity = np.where(valid[:, None], enu, 1e6), np.where(valid[:, None] & np.isfinite(velocity), velocity, 0.0)
        ground = np.maximum(np.hypot(enu[:, 0], enu[:, 1]), 1.0)
        distance = np.maximum(np.hypot(ground, enu[:, 2]), 1.0)
        range_rate = np.einsum("ij,ij->i", enu, velocity) / distance
        azimuth_rate = (enu[:, 1] * velocity[:, 0] - enu[:, 0] * velocity[:, 1]) / ground**2
        variance = np.nan_to_num(np.einsum("ijj->i", s.covariance) / 3.0, nan=50.0**2, posinf=50.0**2) + a.extent_m**2
        more_r = 0.0 if self.more_range_sd_m is None else self.more_range_sd_m[row]
        more_a = 0.0 if self.more_azimuth_sd_rad is None else self.more_azimuth_sd_rad[row]
        # Over the antenna the azimuth says nothing; beyond a radian its sd has no meaning.
        azimuth_sd = np.minimum(np.sqrt(a.azimuth_sd_rad**2 + a.unmodelled_rad**2 + variance / ground**2 + more_a**2), 1.0)
        azimuth = np.arctan2(enu[:, 0], enu[:, 1])
        return Compared(
            self.plots.range_m[row] - distance,
            measure.wrap_rad(self.azimuth_rad[row] + turn_rad - azimuth),
            range_rate,
            azimuth_rate,
            np.sqrt(a.range_sd_m**2 + (a.unmodelled_per_m * distance) ** 2 + variance + more_r**2),
            azimuth_sd,
            distance,
            azimuth,
            ground,
            np.sqrt(np.einsum("ij,ij->i", velocity, velocity)),
            valid,
        )

    def candidates(
        self,
        units: Units,
        pair: tuple[IntArray, IntArray],
        *,
        window: Window | None,
        centre: Bias = NO_BIAS,
        margin: float = 3.0,
        shift_s: float = 0.0,
        cycle_s: tuple[float, float] | None = None,
        turn_rad: float = 0.0,
    ) -> Candidates:
        """Compare units with targets, `pair` = (unit (p,), target (p,)), point by point.

        With a `window` about the `centre` biases (and `margin` standard deviations), of many pairs only those are looked at
        in full of which some point can vote in it.  `shift_s` moves the clocks; within `cycle_s` (first, last) it wraps
        around.
        """
        unit, target = pair
        if window is not None and len(unit) * self.settings.points > 20_000:
            # Four points of a pair tell whether it is worth the rest.
            near = self._points(_thin(units, 4), unit, target, shift_s, cycle_s, turn_rad)
            left = residuals(near, centre)
            near = near.keep(within(near._replace(range_error_m=left[0], azimuth_error_rad=left[1]), window, margin))
            span = int(target.max(initial=0)) + 1
            keep = np.isin(unit * span + target, np.unique(near.track * span + near.target))
            unit, target = unit[keep], target[keep]
        return self._points(units, unit, target, shift_s, cycle_s, turn_rad)

    def _points(
        self,
        units: Units,
        unit: IntArray,
        target: IntArray,
        shift_s: float,
        cycle_s: tuple[float, float] | None,
        turn_rad: float,
    ) -> Candidates:
        parts = []
        for u, j, point in expand(units, unit, target):
            row = units.row[point]
            time = self.plots.time_s[row]
            move = np.full(len(row), shift_s)
            if cycle_s is not None:
                first, last = cycle_s
                move = first + np.mod(time + shift_s - first, max(last - first, 1e-9)) - time
            # Most pairs of a unit and a target do not meet in time: they need no interpolation.
            meets = (time + move >= self.reference.start_s[j] - 60.0) & (time + move <= self.reference.end_s[j] + 60.0)
            u, j, point, row, move = u[meets], j[meets], point[meets], row[meets], move[meets]
            c = self.compare(row, j, move, turn_rad)
            ok = c.valid if self.assumed.min_speed_mps <= 0 else c.valid & (c.speed_mps >= 0.5 * self.assumed.min_speed_mps)
            found = Candidates(
                u, j, units.weight[point], c.range_error_m, c.azimuth_error_rad, c.range_rate_mps, c.azimuth_rate_radps,
                c.range_sd_m, c.azimuth_sd_rad, c.range_m, c.azimuth_rad,
            )  # fmt: skip
            parts.append(found.keep(ok))
        if not parts:
            empty_i, empty_f = np.empty(0, np.int64), np.empty(0)
            return Candidates(empty_i, empty_i, *[empty_f] * 9)
        return Candidates(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def fits_surface(self, row: IntArray, target: IntArray) -> tuple[BoolArray, BoolArray]:
        """Whether each target (m,) was moving at its plot's stamp, and whether it was on the ground.

        Moving: on average faster than `min_speed_mps` over the 10 s about the stamp.  On the ground: the reference's own
        ground bit where that source ever sets it, else no more than 150 m above the antenna.
        """
        time = self.plots.time_s[row]
        before = alignment.states(self.reference.trajectories, target, time - _MOTION_S)
        now = alignment.states(self.reference.trajectories, target, time)
        after = alignment.states(self.reference.trajectories, target, time + _MOTION_S)
        back = np.linalg.norm(now.position - before.position, axis=1) / _MOTION_S
        ahead = np.linalg.norm(after.position - now.position, axis=1) / _MOTION_S
        whole = np.linalg.norm(after.position - before.position, axis=1) / (2 * _MOTION_S)
        speed = np.where(before.valid & after.valid, whole, np.where(after.valid, ahead, np.where(before.valid, back, 0.0)))
        moving = now.valid & (speed >= self.assumed.min_speed_mps)
        fixes = self.reference.fixes
        grounded = fixes.flags & np.uint32(Flag.GROUND) != 0
        tells = np.isin(fixes.source, np.unique(fixes.source[grounded]))
        near = self.reference.nearest_fix(target, time)
        up = self.local(now.position - self.site)[:, 2]
        on_ground = np.where(tells[near], grounded[near], up < 150.0)
        return moving, on_ground

    def height_error(self, row: IntArray, target: IntArray) -> FloatArray:
        """Radar's minus reference's pressure altitude (m,), metres; NaN where one of them has none within 15 s."""
        own = self.plots.pressure_altitude_m[row]
        if not np.isfinite(own).any() or not np.isfinite(self.reference.fixes.pressure_altitude_m).any():
            return np.full(len(row), np.nan)
        near = self.reference.nearest_fix(target, self.plots.time_s[row])
        fresh = np.abs(self.reference.fixes.time_s[near] - self.plots.time_s[row]) < 15.0
        return np.where(fresh, own - self.reference.fixes.pressure_altitude_m[near], np.nan)


def units_of(unit: IntArray, row: IntArray) -> Units:
    """Units from points (m,) sorted by unit, each unit's weights summing to 1."""
    count = np.bincount(unit, minlength=1)
    return Units(unit, row, 1.0 / count[unit])


def _thin(units: Units, points: int) -> Units:
    """At most `points` points of each unit, evenly spread."""
    first = np.r_[True, units.unit[1:] != units.unit[:-1]]
    start = np.flatnonzero(first)
    count = np.diff(np.r_[start, len(units.unit)])
    inside = np.arange(len(units.unit)) - np.repeat(start, count)
    n = np.repeat(count, count)
    # Point i of n is kept where the part it falls in changes: exactly min(n, points) of them.
    keep = (inside * points // n != (inside - 1) * points // n) | (n <= points)
    return units_of(units.unit[keep], units.row[keep])


def expand(units: Units, unit: IntArray, target: IntArray) -> Iterator[tuple[IntArray, IntArray, IntArray]]:
    """(unit, target, point) of every point of every pair, in pieces of bounded size."""
    low, high = np.searchsorted(units.unit, unit, "left"), np.searchsorted(units.unit, unit, "right")
    count = high - low
    total = np.cumsum(count)
    cuts = np.unique(
        np.r_[0, np.searchsorted(total, np.arange(_CHUNK, int(total[-1]) if len(total) else 0, _CHUNK), "right"), len(unit)]
    )
    for a, b in itertools.pairwise(cuts.tolist()):
        n = count[a:b]
        pair = np.repeat(np.arange(a, b), n)
        inside = np.arange(len(pair)) - np.repeat(np.cumsum(n) - n, n)
        yield unit[pair], target[pair], low[pair] + inside


def meeting(start_s: FloatArray, end_s: FloatArray, reference: Reference, margin_s: float) -> BoolArray:
    """Which spans (k,) and targets (t,) overlap in time, (k, t)."""
    return np.asarray(
        (start_s[:, None] <= reference.end_s[None, :] + margin_s) & (end_s[:, None] >= reference.start_s[None, :] - margin_s)
    )
