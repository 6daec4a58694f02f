"""Error fitting models of paper 000: one linear fit a channel, of constant, first or second order, that no geometry can break.

The fit is of *corrections*, true - measured, as in the paper; `register_per_channel` turns them into biases, measured - true.
METHODS section 3 has the design rows with the paper's misprints put right.  The printed inverse of MᵀM is never formed: near
the horizon its condition number is 1e15 and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import msgspec
import numpy as np

from .._parallel import slices
from .._types import BoolArray, FloatArray, IntArray
from ..calibration import Accuracy, Calibration, Noise, NotDetermined, Summary, TermKey
from ..errors import NothingToDo, SettingsError
from ..model import Pairs, Sensor, Sensors
from ..terms import DEG, TERMS, Geometry, Term, Whose
from .least_squares import typical_own
from .observe import CHUNK, Observed, distances, geometry, linearise, observe, unusable

Order = Literal["constant", "first-order", "second-order"]
Select = Literal["none", "bic", "cross-validation", "correlation"]
ORDERS: tuple[Order, ...] = get_args(Order)
CHANNELS = ("range", "azimuth", "elevation")
# Where an antenna stands, whose columns are those of a tilt where all targets are at one height: these then stay.
_PLACE = ("site_east", "site_north")
# Columns smaller than this are zero: tan E of a target at the antenna's own height.
_NOTHING = 1e-12
# Blocks that stand in for tracks where these are fewer, and folds of the cross-validation.
_BLOCKS = 20
_FOLDS = 5
# With fewer targets, what a target keeps for itself is also assumed, not only seen.
FEW_TARGETS = 12
_PASSES = 20
# A column, scaled, of which less than this is left beside the others makes the joint fit useless.
_JOINT_TOLERANCE = 1e-5
# What the other blocks tell of a value counts as at least so much of the whole, or one block that tells it alone would weigh all.
_LEAST_OTHERS = 0.1


class Column(NamedTuple):
    """One column of a fitting model: the parameter's name in the paper, and the term that it is here.

    Where there is a term, its value is `sign` times the parameter: the paper's corrections have the other sign than biases, and a
    time that is added to a correction is the lateness of the stamp.
    """

    name: str
    term: str
    sign: float


def _columns(order: Order, channel: int, jerk: bool, parallax: bool) -> tuple[Column, ...]:
    """The columns of a model; the first is the constant."""
    first, second = order == "first-order", order == "second-order"
    out: list[Column] = []
    if channel == 0:
        out = [Column("R0", "range_bias", -1)]
        if second:
            out += [Column("Δt1+Δt2", "time_offset", 1), Column("α", "", -1)]
            out += [Column("1/Kc", "range_lag", -1), Column("1/Kf", "range_jerk", -1)] if jerk else []
    elif channel == 1:
        out = [Column("A0", "azimuth_bias", -1)]
        if second:
            out += [Column("Δt1+Δt2+1/Kv", "time_offset", 1), Column("1/Ka", "azimuth_lag", -1)]
        if first or second:
            east = Column("θ sin Amax", "tilt_east", -1) if first else Column("-θ sin Amax", "tilt_east", 1)
            out += [Column("θ cos Amax", "tilt_north", -1), east]
            out += [Column("δ" if first else "λ", "nonorthogonality", -1)]
            out += [Column("Vaz" if first else "Kz+Kb", "collimation", -1)]
        if parallax and (first or second):
            out += [Column("site east", "site_east", 1), Column("site north", "site_north", -1)]
        out += [Column("1/Kj", "azimuth_jerk", -1)] if second and jerk else []
    else:
        out = [Column("E0+Kn" if second else "E0+Ve" if first else "E0", "elevation_bias", -1)]
        if first:
            out += [Column("θ cos Amax", "tilt_north", -1), Column("θ sin Amax", "tilt_east", -1)]
        if second:
            out += [Column("Δt1+Δt2+1/Kv", "time_offset", 1), Column("1/Ka", "elevation_lag", -1)]
            out += [Column("θ sin Amax", "tilt_east", -1), Column("θ cos Amax", "tilt_north", -1)]
            out += [Column("Kg", "elevation_sag", -1), Column("β", "elevation_refraction", -1)]
            out += [Column("1/Kj", "elevation_jerk", -1)] if jerk else []
    return tuple(out)


def design(
    place: Geometry, channel: int, order: Order, *, jerk: bool = False, parallax: bool = False
) -> tuple[tuple[Column, ...], FloatArray]:
    """The columns of one channel's model (0 range, 1 azimuth, 2 elevation), and their values (n, p): m or rad a unit.

    METHODS section 3: the paper's rows with its misprints put right (the elevation has Ė and Ë, not Ë twice; the tilt of
    its Table 8 has the signs exchanged).  `jerk` adds the columns of Kf and Kj (and Kc), `parallax` those of an antenna that
    stands elsewhere, which is what tilt columns fit at low elevation.  cot E is bounded at the horizon.  The geometry must hold
    the second rates for the second order, the third for `jerk`.
    """
    columns = _columns(order, channel, jerk, parallax)
    x = np.empty((len(place.range_m), len(columns)))
    for k, column in enumerate(columns):
        if column.term:
            x[:, k] = -column.sign * TERMS[column.term].columns(place)[:, channel]
        else:
            x[:, k] = 1 / np.cos(np.clip(place.elevation_rad, -80 * DEG, 80 * DEG))
    return columns, x


def rates_needed(orders: Sequence[Order], jerk: bool) -> int:
    """The order of the rates that the columns of these models need."""
    return (3 if jerk else 2) if "second-order" in orders else 0


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFit:
    """One channel's model as fitted: correction = columns · value.

    `columns` (p,) are those that were kept, the constant first, `value` (p,) and `covariance` (p, p) SI; `dropped` names those
    that were not, and why.  `rank` is that of all `offered` columns; `rmse` is of the residuals of the inliers, `noise_sd` with
    the degrees of freedom taken off.
    """

    channel: int
    order: Order
    columns: tuple[Column, ...]
    value: FloatArray
    covariance: FloatArray
    dropped: tuple[tuple[str, str], ...]
    offered: int
    rank: int
    rmse: float
    noise_sd: float
    jerk: bool = False
    parallax: bool = False

    def correction(self, place: Geometry) -> FloatArray:
        """The correction (n,), true - measured, m or rad, at these places."""
        columns, x = design(place, self.channel, self.order, jerk=self.jerk, parallax=self.parallax)
        at = {column.name: k for k, column in enumerate(columns)}
        return np.asarray(x[:, [at[column.name] for column in self.columns]] @ self.value)


class Solved(NamedTuple):
    """Values (p,) of the kept columns, covariance (p, p) for white noise of unit sd, which columns were kept, and why not."""

    value: FloatArray
    unit: FloatArray
    kept: IntArray
    dropped: dict[int, str]
    rank: int


def solve_safely(
    x: FloatArray, y: FloatArray, names: Sequence[str], weight: FloatArray | None = None, *, tolerance: float = 1e-2,
    ridge: float = 1e-8, first: Sequence[int] = (),
) -> Solved:  # fmt: skip
    """Least squares of `y` (n,) on the columns of `x` (n, p), the first of them constant, whatever their rank.

    Columns are centred and scaled; one that varies by less than `tolerance` of its size is the constant by another name, and one
    of which column-pivoted QR leaves less than `tolerance` is made of others: both are left out.  A `ridge` relative to the
    scaled columns keeps what is left finite.  With `tolerance` 0 only what is zero to machine precision is left out.  The columns
    `first` stay where they and others are made of each other.
    """
    from scipy.linalg import qr

    n, p = x.shape
    w = np.ones(n) if weight is None else weight
    root, total = np.sqrt(w), w.sum()
    mean = w @ x / total
    size = np.sqrt(w @ x**2 / total)
    off = x - mean
    spread = np.sqrt(w @ off**2 / total)
    dropped: dict[int, str] = {}
    free = []
    for k in range(1, p):
        if not np.isfinite(size[k]) or size[k] < _NOTHING:
            dropped[k] = "its column is zero everywhere"
        elif spread[k] < max(tolerance, 1e-13) * size[k]:
            dropped[k] = f"its column varies by {spread[k] / size[k]:.1e} of its size: it looks like {names[0]}"
        else:
            free.append(k)
    rank = 1
    if free:
        scaled = off[:, free] / spread[free] * root[:, None] / np.sqrt(total)
        least = max(tolerance, 1e-11) * float(np.sqrt((scaled**2).sum(axis=0)).max())
        before = [k in first for k in free]
        left, pivot, good = scaled, np.empty(0, np.int64), np.empty(0, bool)
        for some in (np.flatnonzero(before), np.flatnonzero(~np.array(before))):
            basis, r, order = qr(left[:, some], mode="economic", pivoting=True)
            diagonal = np.zeros(len(some))
            diagonal[: min(r.shape)] = np.abs(np.diag(r))
            pivot, good = np.r_[pivot, some[order]], np.r_[good, diagonal >= least]
            basis = basis[:, : int((diagonal >= least).sum())]
            left = left - basis @ (basis.T @ left)
        rank = 1 + int(good.sum())
        for j in np.flatnonzero(~good):
            k = free[pivot[j]]
            beside = np.abs(scaled[:, pivot[good]].T @ scaled[:, pivot[j]])
            dropped[k] = f"its column is made of others, most of {names[free[pivot[good][int(np.argmax(beside))]]]}"
        free = sorted(free[pivot[j]] for j in np.flatnonzero(good))
    kept = np.array([0, *free], np.int64)
    q = len(free)
    scaled = off[:, free] / spread[free] * root[:, None]
    middle = float(w @ y / total)
    # The ridge as rows below the data; orthogonal factors instead of normal equations.
    stacked = np.concatenate([scaled, np.sqrt(ridge * total) * np.eye(q)])
    basis, r = qr(stacked, mode="economic") if q else (np.zeros((n, 0)), np.zeros((0, 0)))
    # Of seven columns at most: no triangular solver is faster than this.
    solved = np.linalg.solve(r, np.column_stack([np.eye(q), basis[:n].T @ (root * (y - middle))])) / spread[free][:, None]
    slope, inverse = solved[:, -1], solved[:, :-1]
    value = np.r_[middle - mean[free] @ slope, slope]
    # The constant is the mean less what the other columns have at theirs.
    back = np.zeros((1 + q, 1 + q))
    back[1:, 1:] = inverse
    back[0, 1:] = -mean[free] @ inverse
    back[0, 0] = 1 / np.sqrt(total)
    return Solved(value, back @ back.T, kept, dropped, rank)


def blocks_of(cluster: IntArray, time_s: FloatArray) -> IntArray:
    """Which rows (n,) share their errors: the tracks; where these are few, pieces of them in the order of time."""
    tracks = np.unique(cluster, return_inverse=True)[1]
    count = int(tracks.max(initial=-1)) + 1
    if count >= _BLOCKS or len(tracks) < 2 * _BLOCKS:
        return tracks
    order = np.lexsort((time_s, tracks))
    pieces = -(-_BLOCKS // count)
    place = np.empty(len(tracks), np.int64)
    place[order] = np.arange(len(tracks))
    number = np.bincount(tracks)
    start = np.r_[0, np.cumsum(number)[:-1]]
    return np.asarray(tracks * pieces + (place - start[tracks]) * pieces // number[tracks])


def inflation(residual: FloatArray, block: IntArray) -> float:
    """By how much the variance of means exceeds that of white noise, from the means of blocks; at least 1."""
    number = np.bincount(block)
    some = number > 0
    if some.sum() < 3 or not np.any(residual):
        return 1.0
    total = np.bincount(block, residual)[some]
    # Of blocks with n plots each: E (sum)² = n σ² for white noise.
    return float(max(1.0, (total**2).sum() / (number[some].sum() * np.mean(residual**2))))


def own_sd(seen: Observed) -> FloatArray:
    """The typical sd (3,) of what a target keeps for itself, in range, azimuth and elevation."""
    typical, far = typical_own(seen), max(float(np.median(seen.measured[:, 0])), 1.0)
    return np.array(
        [
            np.hypot(typical["range_bias"], typical["site_east"]),
            np.hypot(typical["azimuth_bias"], typical["site_east"] / far),
            np.hypot(typical.get("elevation_bias", 0.0), typical.get("site_up", 0.0) / far),
        ]
    )


class PerChannel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="per-channel"):
    """Paper 000's method: each channel by itself, by a linear model of one of three orders.

    `model` is one order for all channels, or one each for range, azimuth, elevation.  `select` takes the order at most as high as
    these by "bic" (on tracks: what errors of one track share counts once), by blocked "cross-validation", or by "correlation",
    the paper's own rule: the order whose corrections of the two best seen targets are most alike.  `tolerance` and `ridge` as for
    `solve_safely`; plots beyond `gate_sd` robust sd of the residuals are no inliers (0: all are).
    """

    model: Order | tuple[Order, Order, Order] = "second-order"
    select: Select = "none"
    jerk: bool = False
    parallax: bool = False
    tolerance: float = 1e-2
    ridge: float = 1e-8
    gate_sd: float = 5.0

    @property
    def orders(self) -> tuple[Order, Order, Order]:
        """The order of each channel's model."""
        return (self.model,) * 3 if isinstance(self.model, str) else self.model

    def __call__(self, seen: Observed, *, named: bool = False) -> PerChannelFit:
        """Fit one sensor's pairs; where `named`, by columns that are terms alone.

        Raises NothingToDo without pairs, and where the rule needs two targets and there is one.
        """
        check_per_channel(self)
        if not len(seen):
            raise NothingToDo("there are no pairs to fit")
        place = geometry(seen, slice(None), None, rates_needed(self.orders, self.jerk))
        true = np.stack([place.range_m, place.azimuth_rad, place.elevation_rad], axis=1)
        y = true - seen.measured
        y[:, 1] = (y[:, 1] + np.pi) % (2 * np.pi) - np.pi
        return self.fit(place, y, seen.cluster, seen.weight, named=named)

    def fit(
        self,
        place: Geometry,
        correction: FloatArray,
        cluster: IntArray | None = None,
        weight: FloatArray | None = None,
        *,
        named: bool = False,
    ) -> PerChannelFit:
        """The same of corrections (n, 3), true - measured, at these places; a channel that is NaN throughout is not fitted."""
        n = len(correction)
        cluster = np.zeros(n, np.int64) if cluster is None else cluster
        weight = np.ones(n) if weight is None else weight
        block = blocks_of(cluster, place.time_s)
        fits: list[ChannelFit | None] = []
        inliers = np.zeros((n, 3), bool)
        ended, scores = [], []
        for channel in range(3):
            known = np.isfinite(correction[:, channel])
            if not known.any():
                fits.append(None)
                continue
            rows = np.flatnonzero(known)
            some = rows_of(place, rows)
            y, w = correction[rows, channel], weight[rows]
            order, score = self._order(channel, some, y, w, cluster[rows], block[rows], named)
            found, good, passes, calm = self._fit(channel, order, some, y, w, block[rows], named)
            fits.append(found)
            scores.append(score)
            inliers[rows, channel] = good
            ended.append(f"{CHANNELS[channel]} " + (f"settled in pass {passes}" if calm else f"not settled in {passes} passes"))
        return PerChannelFit((fits[0], fits[1], fits[2]), inliers, "; ".join(ended), tuple(scores))

    def _fit(
        self, channel: int, order: Order, place: Geometry, y: FloatArray, weight: FloatArray, block: IntArray, named: bool
    ) -> tuple[ChannelFit, BoolArray, int, bool]:
        columns, x = design(place, channel, order, jerk=self.jerk, parallax=self.parallax)
        unnamed = [k for k, column in enumerate(columns) if named and not column.term]
        names = [column.name for column in columns]
        offered = [k for k in range(len(columns)) if k not in unnamed]
        good = _within(y - np.median(y), 3 * self.gate_sd)
        calm, passes = False, 0
        while not calm and passes < _PASSES:
            passes += 1
            solved = solve_safely(
                x[good][:, offered], y[good], [names[k] for k in offered], weight[good], tolerance=self.tolerance,
                ridge=self.ridge, first=[offered.index(k) for k in offered if columns[k].term in _PLACE],
            )  # fmt: skip
            kept = [offered[k] for k in solved.kept]
            residual = y - x[:, kept] @ solved.value
            now = _within(residual, self.gate_sd)
            calm = bool((now == good).all())
            good = now if not calm else good
        freedom = max(int(good.sum()) - len(kept), 1)
        squares = weight[good] / weight[good].mean() * residual[good] ** 2
        noise = float(np.sqrt(squares.sum() / freedom))
        wider = inflation(residual[good], block[good])
        dropped = [(names[offered[k]], why) for k, why in sorted(solved.dropped.items())]
        dropped += [(names[k], "no term acts like it; range_refraction is the air's delay") for k in unnamed]
        found = ChannelFit(
            channel=channel,
            order=order,
            columns=tuple(columns[k] for k in kept),
            value=solved.value,
            covariance=solved.unit * (noise**2 * wider * weight[good].mean()),
            dropped=tuple(dropped),
            offered=len(offered),
            rank=solved.rank,
            rmse=float(np.sqrt(np.mean(residual[good] ** 2))),
            noise_sd=noise,
            jerk=self.jerk,
            parallax=self.parallax,
        )
        return found, good, passes, calm

    def _order(
        self, channel: int, place: Geometry, y: FloatArray, weight: FloatArray, cluster: IntArray, block: IntArray, named: bool
    ) -> tuple[Order, dict[Order, float]]:
        """The order of a channel's model, and what the rule says of each (smaller is better)."""
        most = self.orders[channel]
        offered = ORDERS[: ORDERS.index(most) + 1]
        if self.select == "none" or len(offered) == 1:
            return most, {}
        if self.select == "bic":
            score = self._bic(channel, offered, place, y, weight, block, named)
        elif self.select == "cross-validation":
            score = self._held_out(channel, offered, place, y, weight, block, named)
        else:
            score = self._unlike(channel, offered, place, y, weight, cluster, named)
        # Of equal ones the simplest: a first-order range is a constant.
        best = min(score.values())
        chosen = next(o for o in offered if score[o] <= best + 1e-9 * max(abs(best), 1.0))
        return chosen, score

    def _bic(
        self,
        channel: int,
        offered: Sequence[Order],
        place: Geometry,
        y: FloatArray,
        weight: FloatArray,
        block: IntArray,
        named: bool,
    ) -> dict[Order, float]:
        fits = {o: self._fit(channel, o, place, y, weight, block, named) for o in offered}
        largest, good, _, _ = fits[offered[-1]]
        residual = {o: y - f[0].correction(place) for o, f in fits.items()}
        wider = inflation(residual[offered[-1]][good], block[good])
        effective = max(good.sum() / wider, 2.0)
        variance = max(largest.noise_sd**2, 1e-300)
        return {
            o: float((residual[o][good] ** 2).sum() / (variance * wider) + len(fits[o][0].value) * np.log(effective))
            for o in offered
        }

    def _held_out(
        self,
        channel: int,
        offered: Sequence[Order],
        place: Geometry,
        y: FloatArray,
        weight: FloatArray,
        block: IntArray,
        named: bool,
    ) -> dict[Order, float]:
        fold = np.unique(block, return_inverse=True)[1] % _FOLDS
        out: dict[Order, float] = {}
        for o in offered:
            lost, count = 0.0, 0
            for f in range(_FOLDS):
                test, train = np.flatnonzero(fold == f), np.flatnonzero(fold != f)
                if not len(test) or not len(train):
                    continue
                found = self._fit(channel, o, rows_of(place, train), y[train], weight[train], block[train], named)[0]
                off = y[test] - found.correction(rows_of(place, test))
                lost += float(np.minimum(off**2, (max(self.gate_sd, 3.0) * max(found.noise_sd, 1e-300)) ** 2).sum())
                count += len(test)
            out[o] = float(np.sqrt(lost / max(count, 1)))
        return out

    def _unlike(
        self,
        channel: int,
        offered: Sequence[Order],
        place: Geometry,
        y: FloatArray,
        weight: FloatArray,
        cluster: IntArray,
        named: bool,
    ) -> dict[Order, float]:
        keys, count = np.unique(cluster, return_counts=True)
        if len(keys) < 2:
            raise NothingToDo("select = correlation compares two targets, and there is one", remedy="Say bic, or none.")
        mine = [np.flatnonzero(cluster == keys[k]) for k in np.argsort(-count, kind="stable")[:2]]
        short = min(len(rows) for rows in mine)
        out: dict[Order, float] = {}
        for o in offered:
            series = []
            for rows in mine:
                some = rows_of(place, rows)
                block = blocks_of(np.zeros(len(rows), np.int64), some.time_s)
                series.append(self._fit(channel, o, some, y[rows], weight[rows], block, named)[0].correction(some)[:short])
            out[o] = normalised_distance(*series)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class PerChannelFit:
    """The channels' models (None: not measured), which plots (n, 3) are inliers, how it ended, and the scores of the orders."""

    channels: tuple[ChannelFit | None, ChannelFit | None, ChannelFit | None]
    inliers: BoolArray
    ended: str
    scores: tuple[dict[Order, float], ...] = ()

    @property
    def fitted(self) -> tuple[ChannelFit, ...]:
        """The channels that are measured."""
        return tuple(fit for fit in self.channels if fit is not None)


def check_per_channel(settings: PerChannel) -> None:
    """Raises SettingsError for settings that make no sense."""
    for order in settings.orders:
        if order not in ORDERS:
            raise SettingsError(f"there is no model {order!r}", where="--model", remedy=f"Models: {', '.join(ORDERS)}.")
    if settings.select not in get_args(Select):
        raise SettingsError(
            f"there is no rule {settings.select!r}", where="select", remedy=f"Rules: {', '.join(get_args(Select))}."
        )
    if not 0 <= settings.tolerance < 1 or not settings.ridge >= 0 or not settings.gate_sd >= 0:
        raise SettingsError(
            f"tolerance = {settings.tolerance}, ridge = {settings.ridge}, gate_sd = {settings.gate_sd} make no sense",
            where="per-channel",
            remedy="A tolerance from 0 to 1, and the others 0 or more.",
        )


def normalised_distance(u: FloatArray, v: FloatArray) -> float:
    """The normalised Euclidean distance of two series (n,): root of the sum of (u - v)² over their pooled population variance.

    Paper 000, eq. 8.  Two different constants give 2 √n whatever they are, equal series 0.
    """
    u, v = np.asarray(u, np.float64), np.asarray(v, np.float64)
    squares = float(((u - v) ** 2).sum())
    variance = float(np.var(np.concatenate([u, v]))) if len(u) else 0.0
    size = float(np.mean(u**2) + np.mean(v**2)) if len(u) else 0.0
    # What rounding leaves of equal constants is no variance.
    return 0.0 if variance <= 1e-28 * size or squares == 0 else float(np.sqrt(squares / variance))


def distance_correlation(distance: float) -> float:
    """r = 1 / (1 + d / 100): what paper 000's Table 5 holds, where its eq. 9 prints 1 - d / 100."""
    return 1.0 / (1.0 + distance / 100.0)


def register_per_channel(
    pairs: Pairs, sensors: Sensors, *, model: str = "auto", settings: PerChannel | None = None
) -> Calibration:
    """Find the systematic errors of every sensor in `pairs` by paper 000's models.  bias = measured - true.

    `model` is an order for all channels, three orders with commas for range, azimuth and elevation, or "auto": at most second
    order, each channel's by BIC on tracks.  The models choose the terms; what channels share (a late stamp, a tilt) is then
    estimated once, over all of them, because a calibration's terms act on every channel.  Columns that are no term (α sec E) or
    that look like others are named in `not_determined`.

    Raises SettingsError for a model that does not exist or a sensor without an entry; NothingToDo where no pair can be used.
    """
    settings = _settings_of(model, settings)
    check_per_channel(settings)
    if not len(pairs):
        raise NothingToDo("there are no pairs of plots and reference positions", remedy="Do the recordings share time and area?")
    warnings: list[str] = []
    usable = np.ones(len(pairs), bool)
    for reason, left_out in unusable(pairs).items():
        usable &= ~left_out
        warnings.append(f"{left_out.sum():,} of {len(pairs):,} pairs were left out: {reason}")
    if not usable.any():
        raise NothingToDo(f"none of the {len(pairs):,} pairs can be used: {'; '.join(warnings)}")
    epoch = float(np.floor(pairs.plots.time_s[usable].min()))
    found = []
    for sensor in sensors:
        rows = np.flatnonzero(usable & (pairs.plots.sensor == sensor.key))
        if len(rows):
            found.append(_one(pairs, rows, sensor, epoch, settings))
    missing = sorted(set(pairs.plots.sensor[usable].tolist()) - {s.key for s in sensors})
    if missing:
        key = int(missing[0])
        raise SettingsError(
            f"the pairs hold a sensor {key >> 8}/{key & 255} that has no entry", where="sensors.toml", remedy="Add a [[sensor]]."
        )
    sizes = [len(f.terms) for f in found]
    covariance = np.zeros((sum(sizes), sum(sizes)))
    start = 0
    for f, p in zip(found, sizes, strict=True):
        covariance[start : start + p, start : start + p] = f.covariance
        start += p
    return Calibration(
        terms=tuple(TermKey(f.summary.sensor, "all", t.name, t.unit) for f in found for t in f.terms),
        epoch_s=np.array([epoch]),
        value=np.concatenate([f.value for f in found])[None],
        covariance=covariance[None],
        sensors=tuple(f.summary for f in found),
        not_determined=tuple(n for f in found for n in f.not_determined),
        warnings=tuple(warnings),
        settings={
            "method": "per-channel",
            **{k: list(v) if isinstance(v, tuple) else v for k, v in msgspec.structs.asdict(settings).items()},
        },
    )


def _settings_of(model: str, settings: PerChannel | None) -> PerChannel:
    if model == "auto":
        return settings or PerChannel(select="bic")
    names = [name.strip() for name in model.split(",")]
    bad = [name for name in names if name not in ORDERS]
    if bad or len(names) not in (1, 3):
        raise SettingsError(
            f"{model!r} is no model of the method per-channel",
            where="--model",
            remedy=f"Say one of {', '.join(ORDERS)}, or three with commas for range, azimuth, elevation.",
        )
    orders = [ORDERS[ORDERS.index(name)] for name in names]
    wanted: Order | tuple[Order, Order, Order] = orders[0] if len(orders) == 1 else (orders[0], orders[1], orders[2])
    return msgspec.structs.replace(settings or PerChannel(), model=wanted)


class _Found(NamedTuple):
    terms: tuple[Term, ...]
    value: FloatArray
    covariance: FloatArray
    summary: Summary
    not_determined: list[NotDetermined]


def _one(pairs: Pairs, rows: IntArray, sensor: Sensor, epoch: float, settings: PerChannel) -> _Found:
    seen = observe(pairs, rows, sensor, epoch)
    fitted = settings(seen, named=True)
    for f in fitted.fitted:
        count = int(fitted.inliers[:, f.channel].sum())
        if count <= len(f.columns):
            raise NothingToDo(
                f"sensor {sensor.name!r}: {count} usable plots cannot tell {len(f.columns)} errors of the {CHANNELS[f.channel]} "
                "and its noise",
                remedy="Take a longer recording, or a lower order.",
            )
    terms = tuple(TERMS[name] for name in dict.fromkeys(c.term for f in fitted.fitted for c in f.columns))
    by_term: dict[str, list[str]] = {}
    for f in fitted.fitted:
        for name, why in f.dropped:
            column = next(c for c in _columns(f.order, f.channel, f.jerk, f.parallax) if c.name == name)
            if not any(t.name == column.term for t in terms):
                by_term.setdefault(column.term or f"{name} sec E", []).append(f"{CHANNELS[f.channel]}: {why}")
    value, covariance, kept, lost = _joint(seen, terms, fitted)
    for term, why in lost:
        by_term.setdefault(term.name, []).append(why)
    terms = tuple(terms[k] for k in kept)
    nothing: tuple[Term, ...] = ()
    before, after = (
        np.concatenate([distances(seen, part, t, v) for part in slices(len(seen), CHUNK)])
        for t, v in ((nothing, np.zeros(0)), (terms, value))
    )
    notes = [f"{CHANNELS[f.channel]}: {f.order}, {f.rank} of {f.offered} columns" for f in fitted.fitted]
    used = fitted.inliers.sum(axis=0)
    notes.append("inliers: " + ", ".join(f"{used[f.channel]:,} of {len(seen):,} in {CHANNELS[f.channel]}" for f in fitted.fitted))
    notes.append(f"how it ended: {fitted.ended}")
    notes += [
        f"{CHANNELS[f.channel]}: the column of {name} is all but made of those of where the antenna stands, as where all targets "
        "are at one height, and these are taken"
        for f in fitted.fitted
        for name, why in f.dropped
        if f.parallax and name.removeprefix("-").startswith("θ") and "most of site" in why
    ]
    notes += _apart(fitted)
    for t, v in zip(terms, value, strict=True):
        if abs(v) > 3 * t.prior_sd:
            parallax = (
                "; at low elevations tilts fit the parallax of an antenna that stands elsewhere" if "tilt" in t.name else ""
            )
            notes.append(
                f"{t.name} of {v / t.si_per_unit:+.3g} {t.unit} is larger than such errors are: the columns are too much alike "
                f"to tell it{parallax}"
            )
    noise = [f.noise_sd if f is not None else float("nan") for f in fitted.channels]
    summary = Summary(
        sensor=sensor.key,
        name=sensor.name,
        model=" / ".join(f.order for f in fitted.fitted),
        noise=Noise(*noise),
        plots=len(seen),
        tracks=len(np.unique(pairs.track[rows])),
        targets=len(seen.cluster_key),
        effective_targets=float(len(seen.cluster_key)),
        before=_accuracy(before),
        after=_accuracy(after),
        notes=tuple(notes),
    )
    return _Found(
        terms, value, covariance, summary, [NotDetermined(sensor.key, name, "; ".join(why)) for name, why in by_term.items()]
    )


def _apart(fitted: PerChannelFit) -> list[str]:
    """What each channel alone says of a term that channels share."""
    said = []
    shared: dict[str, list[tuple[int, float, float]]] = {}
    for f in fitted.fitted:
        for k, column in enumerate(f.columns):
            one = (f.channel, column.sign * float(f.value[k]), float(np.sqrt(f.covariance[k, k])))
            shared.setdefault(column.term, []).append(one)
    for name, each in shared.items():
        if len(each) > 1:
            scale, unit = TERMS[name].si_per_unit, TERMS[name].unit
            parts = [f"{CHANNELS[c]} {v / scale:+.3g} ± {sd / scale:.2g} {unit}" for c, v, sd in each]
            unlike = ", which disagree" if abs(each[0][1] - each[1][1]) > 3 * np.hypot(each[0][2], each[1][2]) else ""
            said.append(f"{name} by each channel alone: {', '.join(parts)}{unlike}")
    return said


def _joint(
    seen: Observed, terms: tuple[Term, ...], fitted: PerChannelFit
) -> tuple[FloatArray, FloatArray, list[int], list[tuple[Term, str]]]:
    """Values and covariance of the terms over all channels at once, which of them could be kept, and which not and why."""
    from scipy.linalg import qr, solve_triangular

    sd = np.array([max(f.noise_sd, 1e-300) if f is not None else np.inf for f in fitted.channels])
    floor = np.array([1e-6, 1e-9, 1e-9])
    sd = np.maximum(sd, floor)
    kept = list(range(len(terms)))
    lost: list[tuple[Term, str]] = []
    value = np.zeros(len(terms))
    block = blocks_of(seen.cluster, seen.time_s)
    while True:
        mine = tuple(terms[k] for k in kept)
        size = np.array([t.prior_sd for t in mine])
        failed = None
        # A late stamp moves the place at which everything else is evaluated.
        for _ in range(3):
            r = np.zeros((0, len(kept) + 1))
            for part in slices(len(seen), CHUNK):
                a, b = _weighted(seen, part, mine, value[kept], fitted, sd)
                r = qr(np.concatenate([r, np.column_stack([a * size, b])]), mode="r")[0][: len(kept) + 1]
            square = r[: len(kept), : len(kept)]
            length = np.sqrt((square**2).sum(axis=0))
            left = np.abs(np.diag(square)) / np.maximum(length, 1e-300)
            if (left < _JOINT_TOLERANCE).any():
                failed = int(np.flatnonzero(left < _JOINT_TOLERANCE)[-1])
                break
            value[kept] += solve_triangular(square, r[: len(kept), -1]) * size
        if failed is None:
            break
        lost.append((terms[kept[failed]], "over all channels together it cannot be told from the others"))
        value[kept[failed]] = 0.0
        del kept[failed]
    root = solve_triangular(square, np.eye(len(kept)))
    # What each block pushes, and how much it tells, where all of them together tell the unit matrix.
    blocks = int(block.max()) + 1
    push, told = np.zeros((blocks, len(kept))), np.zeros((blocks, len(kept), len(kept)))
    for part in slices(len(seen), CHUNK):
        a, b = _weighted(seen, part, mine, value[kept], fitted, sd)
        white, owner = (a * size) @ root, np.tile(block[part], 3)
        np.add.at(push, owner, white * b[:, None])
        by = np.argsort(owner, kind="stable")
        for rows in np.split(by, np.flatnonzero(np.diff(owner[by])) + 1):
            told[owner[rows[0]]] += white[rows].T @ white[rows]
    some = np.trace(told, axis1=1, axis2=2) > 0
    shape = (root @ root.T) * size[:, None] * size
    back = root * size[:, None]
    covariance = back @ _spread(push[some], told[some]) @ back.T
    targets = len(seen.cluster_key)
    if targets < FEW_TARGETS:
        # A handful of targets does not show how targets differ: what each keeps for itself moves the values so.
        shared = np.zeros((targets, 3, len(kept)))
        for part in slices(len(seen), CHUNK):
            weight = seen.weight[part, None] * fitted.inliers[part] / sd**2
            columns = np.nan_to_num(linearise(seen, part, mine, value[kept])[2])
            np.add.at(shared, seen.cluster[part], np.where(weight[:, :, None] > 0, columns * weight[:, :, None], 0.0))
        moved = shared @ shape * own_sd(seen)[:, None]
        covariance = covariance + np.einsum("tcp,tcq->pq", moved, moved)
    return value[kept], (covariance + covariance.T) / 2, kept, lost


def _spread(push: FloatArray, told: FloatArray) -> FloatArray:
    """The covariance (p, p) of whitened values, from what each block pushes (k, p) and tells (k, p, p; the unit matrix in all).

    Errors that a block shares differ by term: a target's latency is all in the time.  So the blocks show the shape too: each is
    set against the values that the others give (the jackknife, CR3), or it would hide what it has pulled them by.  A few blocks
    show p (p + 1) / 2 covariances badly: the white noise's shape, as wide as the blocks are on average, counts as p more blocks.
    """
    count, p = push.shape
    size, basis = np.linalg.eigh(told)
    alone = np.einsum("kij,kj,klj,kl->ki", basis, 1 / np.maximum(1 - size, _LEAST_OTHERS), basis, push)
    shown = alone.T @ alone * (count - 1) / max(count, 1)
    part = p / (p + count)
    return np.asarray((1 - part) * shown + part * max(float(np.trace(shown)) / p, 1.0) * np.eye(p))


def _weighted(
    seen: Observed, part: slice, terms: tuple[Term, ...], value: FloatArray, fitted: PerChannelFit, sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows (3 m, p) and right side (3 m,) of the normalised equations of a part; what is no inlier is zero."""
    _, residual, columns = linearise(seen, part, terms, value)
    weight = np.sqrt(seen.weight[part])[:, None] * fitted.inliers[part] / sd
    b = np.where(weight > 0, np.nan_to_num(residual) * weight, 0.0)
    a = np.where(weight[:, :, None] > 0, np.nan_to_num(columns) * weight[:, :, None], 0.0)
    return a.transpose(1, 0, 2).reshape(-1, len(terms)), b.T.reshape(-1)


def rows_of(place: Geometry, rows: IntArray) -> Geometry:
    """The geometry of some rows (m,)."""
    whose = place.whose
    return Geometry(
        place.range_m[rows],
        place.azimuth_rad[rows],
        place.elevation_rad[rows],
        place.rate[rows],
        place.second[rows],
        place.third[rows],
        place.heading_rad[rows],
        place.length_m[rows],
        place.time_s[rows],
        None if whose is None else Whose(whose.channel[rows], whose.flags[rows], whose.source[rows]),
    )


def _within(residual: FloatArray, gate_sd: float) -> BoolArray:
    """Which rows lie within so many robust sd of the median; all, where the gate is 0 or nothing varies."""
    off = np.abs(residual - np.median(residual))
    sd = 1.4826 * float(np.median(off))
    if gate_sd == 0 or sd == 0:
        return np.ones(len(residual), bool)
    return np.asarray(off <= gate_sd * sd)


def _accuracy(distance: FloatArray) -> Accuracy:
    known = distance[np.isfinite(distance)]
    return Accuracy(*(float(v) for v in np.percentile(known, [50, 95]))) if len(known) else Accuracy(float("nan"), float("nan"))
