"""Registration by joint robust nonlinear least squares in measurement space (METHODS sections 4 and 6).

One model of named terms over all channels of a sensor, linearised anew with the target's own motion (a time offset of 2 s is
500 m, not small), solved by Gauss-Newton.  Gross errors lose their weight; what is alike within a target is modelled as such
(`mixed`), so that the covariance is honest; what the data cannot determine is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, get_args

import msgspec
import numpy as np

from .._parallel import in_threads, slices
from .._types import BoolArray, FloatArray, IntArray
from ..calibration import Choice, Criterion, Effect
from ..errors import NothingToDo, SettingsError
from ..model import Sensor
from ..terms import CHANNELS, DEG, TERMS, Term, precision, table_of
from . import mixed
from .observe import CHUNK, Observed, distances, linearise, look, take

GROUND_KINDS = ("surface", "marine")
# Which term of an inseparable pair stays: the earlier one (METHODS section 6: range, azimuth, time, extent).
_ORDER = (
    "range_bias", "azimuth_bias", "elevation_bias", "range_gain", "azimuth_cos", "azimuth_sin", "tilt_north", "tilt_east",
    "time_offset", "along_heading_per_length", "along_heading", "site_east", "site_north", "site_up", "azimuth_cos2",
    "azimuth_sin2", "range_refraction", "clock_drift",
)  # fmt: skip
_EXTENT = ("along_heading", "along_heading_per_length")
# Transponders answer early or late by up to 0.5 us (Mode A/C) or 0.25 us (Mode S), evenly spread; half of it is range.
_DELAY_SD_M = {"ssr": 149.9 * 0.5 / np.sqrt(3), "mode_s": 149.9 * 0.25 / np.sqrt(3), "combined": 149.9 * 0.25 / np.sqrt(3)}
# Plots that the robust start is found on; short blocks and plots that the variance components are estimated on.
_START_PLOTS = 60_000
_VARIANCE_BLOCKS = 1_500
_VARIANCE_PLOTS = 120_000
_BATCH_BLOCKS = 2_000
_FOLDS = 5
# How often the search for a model is repeated with what is then known of the random errors.
_ROUNDS = 3


class LeastSquares(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="least-squares"):
    """Settings of the joint robust least squares.

    A pair keeps its full weight up to `soft_sd` standard deviations and has none beyond `hard_sd`.  Two terms whose estimates
    correlate by `max_correlation` or more cannot be told apart (unless the later one's sd is below the part `well_known` of its
    `prior_sd`: range bias and gain of far targets correlate, and are both known); nor can a term of whose column less than
    `rank_tolerance` remains once the others are taken out.  `short_block_s` and `long_block_s` are the times over which slowly
    wandering errors are taken as constant (0: by the kind of sensor).  Where weighting by what a target's plots share changes
    the result by more than chance, at the probability `agreement`, the plots are weighted each for itself.  `criterion` is what
    the model "auto" is searched by: "cross-validation" over targets, "bic" on targets, or "none" (the kind's model as it is).
    """

    soft_sd: float = 3.0
    hard_sd: float = 6.0
    max_correlation: float = 0.95
    rank_tolerance: float = 1e-2
    short_block_s: float = 0.0
    long_block_s: float = 0.0
    well_known: float = 0.02
    agreement: float = 0.005
    max_iterations: int = 40
    criterion: Criterion = "cross-validation"


def check_settings(settings: LeastSquares) -> None:
    """Raise SettingsError for settings that make no sense."""
    for name, ok, remedy in (
        ("soft_sd", settings.soft_sd > 0, "Give a positive number of standard deviations."),
        ("hard_sd", settings.hard_sd > settings.soft_sd, "Give more standard deviations than soft_sd."),
        ("max_correlation", 0 < settings.max_correlation <= 1, "Give a correlation within 0 … 1."),
        ("rank_tolerance", 0 < settings.rank_tolerance < 1, "Give a share within 0 … 1."),
        ("short_block_s", settings.short_block_s >= 0, "Give seconds, or 0 for the default."),
        ("long_block_s", settings.long_block_s >= 0, "Give seconds, or 0 for the default."),
        ("well_known", settings.well_known >= 0, "Give a part of the prior sd, or 0 to go by the correlation alone."),
        ("agreement", 0 <= settings.agreement <= 1, "Give a probability within 0 … 1."),
        ("max_iterations", settings.max_iterations >= 1, "Give at least 1."),
        ("criterion", settings.criterion in get_args(Criterion), f"Give one of {', '.join(get_args(Criterion))}."),
    ):
        if not ok:
            raise SettingsError(f"{name} = {getattr(settings, name)} makes no sense", where="settings", remedy=remedy)


class _Effect(NamedTuple):
    """A random effect: the column of this term, its variance component, and its typical sd (SI)."""

    term: str
    group: int
    sd: float


class _Kind(NamedTuple):
    """What is assumed of a kind of sensor before its data speak: noise sd, effects by level, block times."""

    noise: tuple[float, float, float]
    levels: tuple[tuple[_Effect, ...], ...]
    block_s: tuple[float, float]


_AIR = _Kind(
    (40.0, 0.08 * DEG, 0.2 * DEG),
    (
        (
            _Effect("range_bias", 0, 8.0), _Effect("azimuth_bias", 1, 0.015 * DEG),
            _Effect("site_east", 2, 8.0), _Effect("site_north", 2, 8.0),
        ),
        (
            _Effect("range_bias", 0, 8.0), _Effect("azimuth_bias", 1, 0.015 * DEG),
            _Effect("site_east", 2, 8.0), _Effect("site_north", 2, 8.0),
        ),
        (
            _Effect("range_bias", 0, 10.0), _Effect("azimuth_bias", 1, 0.015 * DEG),
            _Effect("site_east", 2, 10.0), _Effect("site_north", 2, 10.0), _Effect("time_offset", 3, 0.1),
        ),
    ),
    (100.0, 500.0),
)  # fmt: skip
_AIR_ELEVATION = (
    (_Effect("elevation_bias", 0, 0.03 * DEG),),
    (_Effect("elevation_bias", 0, 0.03 * DEG),),
    (_Effect("elevation_bias", 0, 0.03 * DEG), _Effect("site_up", 1, 15.0)),
)
_GROUND = _Kind(
    (3.0, 0.15 * DEG, 0.5 * DEG),
    (
        (
            _Effect("range_bias", 0, 1.0), _Effect("azimuth_bias", 1, 0.05 * DEG),
            _Effect("site_east", 2, 2.0), _Effect("site_north", 2, 2.0),
        ),
        (
            _Effect("range_bias", 0, 1.0), _Effect("azimuth_bias", 1, 0.05 * DEG),
            _Effect("site_east", 2, 2.0), _Effect("site_north", 2, 2.0),
        ),
        (
            _Effect("range_bias", 0, 1.0), _Effect("azimuth_bias", 1, 0.05 * DEG),
            _Effect("site_east", 2, 2.0), _Effect("site_north", 2, 2.0), _Effect("time_offset", 3, 0.2),
            _Effect("along_heading", 4, 4.0),
        ),
    ),
    (20.0, 100.0),
)  # fmt: skip


class Dropped(NamedTuple):
    """A term that could not be determined, why, and what is to be said of the term that takes its place ("" for nothing)."""

    term: str
    why: str
    kept: str = ""
    note: str = ""


class Searched(NamedTuple):
    """What a search for a model found: its terms; the steps that led there; what was left out; and `doubt` (p, p), what not
    knowing the model adds to the covariance of its values, in units of their prior sd."""

    terms: tuple[Term, ...]
    steps: tuple[Choice, ...]
    left_out: tuple[Choice, ...]
    doubt: FloatArray


# Targets' normal equations (G, q + 1, q + 1) of q terms, about zero and in units of their prior sd; those terms; those chosen so
# far; whether it is the first search.
Search = Callable[[FloatArray, tuple[Term, ...], tuple[Term, ...], bool], Searched]


class Fit(NamedTuple):
    """One sensor's solution, SI.

    `value` (p,) and its `covariance` (p, p); what the covariance was made of: the model's own `model_covariance`, the clustered
    `sandwich`, and `bread`, the inverse of the information.  `noise_sd` (3,), NaN where not measured; `weight` (n,) of each
    pair; `effective` the effective number of targets.  What the sensors share in one target: `effect_names`, `effect_variance`
    (w,), `scores` (G, w) with `information` (G, w, w), and `influence` (G, w, p) on the normal equations.  `held_out` (G, p) is
    the value found without the fold of each target; `normal` (G, p + 1, p + 1) are the targets' normal equations, about zero
    and in units of the terms' prior sd.  `choices` are the steps of the search for the model, `effects` the random errors that
    plots share; `reference_share` is how much of the variance that the reference states of itself changes from plot to plot.
    """

    terms: tuple[Term, ...]
    value: FloatArray
    covariance: FloatArray
    model_covariance: FloatArray
    sandwich: FloatArray
    bread: FloatArray
    noise_sd: FloatArray
    weight: FloatArray
    effective: float
    effect_names: tuple[str, ...]
    effect_variance: FloatArray
    scores: FloatArray
    information: FloatArray
    influence: FloatArray
    held_out: FloatArray
    normal: FloatArray
    choices: tuple[Choice, ...]
    dropped: tuple[Dropped, ...]
    notes: tuple[str, ...]
    effects: tuple[Effect, ...]
    reference_share: float


@dataclass(frozen=True, slots=True)
class _Layout:
    """How one sensor's rows fall into short blocks, long blocks and targets, and which effects each level has.

    A level's effects are constant over `block_s`.
    `block` (B + 1,) is the first row of each short block; `long` the first short block of each long one; `target` the first long
    block of each target; `target_block` (G + 1,) the first short block of each target.
    """

    block: IntArray
    long: IntArray
    target: IntArray
    target_block: IntArray
    effects: tuple[tuple[_Effect, ...], ...]
    block_s: tuple[float, float, float]
    channels: int

    @property
    def names(self) -> tuple[str, ...]:
        """The terms whose columns the effects have, each once."""
        return tuple(dict.fromkeys(e.term for level in self.effects for e in level))

    @property
    def groups(self) -> tuple[IntArray, ...]:
        return tuple(np.array([e.group for e in level], np.int64) for level in self.effects)

    @property
    def guess(self) -> tuple[FloatArray, ...]:
        """The typical variances of the groups of each level."""
        return tuple(
            np.array([next(e.sd for e in level if e.group == g) ** 2 for g in sorted({e.group for e in level})])
            for level in self.effects
        )


@dataclass(frozen=True, slots=True)
class _State:
    """What the iterations carry: the value, the variances, how much of the reference's variance is fast, scale and trust; and
    how they `ended`, in words."""

    value: FloatArray
    variances: mixed.Variances
    reference_share: float
    spread: FloatArray
    trust: FloatArray
    ended: str = ""


def fit(
    seen: Observed,
    terms: Sequence[Term],
    settings: LeastSquares,
    *,
    candidates: Sequence[Term] = (),
    search: Search | None = None,
) -> Fit:
    """The errors of one sensor: of these terms, or of those that the `search` chooses from them and the `candidates`.

    Raises NothingToDo where not one term can be determined.
    """
    kind = _kind(seen)
    layout = _layout(seen, kind, settings)
    chosen, dropped = tuple(terms), list[Dropped]()
    sample, some = _sample(seen), _some_targets(seen, layout)
    start = _robust_start(sample, some[0], layout, kind, chosen, settings)
    known = start
    steps: list[Choice] = []
    left_out: tuple[Choice, ...] = ()
    doubt, rounds = np.zeros((len(chosen), len(chosen))), 0
    while True:
        bad = _rank_deficient(sample, layout, chosen, start, settings)
        if bad is None:
            settled = _settle(some, kind, chosen, known, settings)
            if search is not None and rounds < _ROUNDS:
                rounds += 1
                gone = {t.name for t in chosen} | {d.term for d in dropped}
                wide = (*chosen, *(t for t in candidates if t.name not in gone))
                found = search(_wide(some, wide, chosen, start, settled, settings), wide, chosen, rounds == 1)
                steps += found.steps
                left_out, doubt = found.left_out, found.doubt
                if found.terms != chosen:
                    value = dict(zip((t.name for t in chosen), settled.value, strict=True))
                    chosen = found.terms
                    at = np.array([value.get(t.name, 0.0) for t in chosen])
                    start = _robust_start(sample, some[0], layout, kind, chosen, settings, at)
                    known = replace(start, variances=settled.variances)
                    continue
            state, reduced, weight = _whole(seen, layout, some, chosen, settled, settings)
            bad = _inseparable(reduced.terms * state.trust[:, None, None], chosen, settings)
        if bad is None:
            break
        dropped.append(bad)
        keep = [k for k, term in enumerate(chosen) if term.name != bad.term]
        chosen, doubt = tuple(chosen[k] for k in keep), doubt[np.ix_(keep, keep)]
        if not chosen:
            raise NothingToDo(f"sensor {seen.sensor.name!r}: no error can be determined: {bad.why}")
        start = known = _robust_start(sample, some[0], layout, kind, chosen, settings)
    choices = (*steps, *left_out)
    return _finish(seen, layout, chosen, start, state, reduced, weight, dropped, settings, choices, doubt)


def _kind(seen: Observed) -> _Kind:
    kind = _GROUND if seen.sensor.kind in GROUND_KINDS else _AIR
    s = seen.sensor
    noise = (
        s.range_sd_m or kind.noise[0],
        (s.azimuth_sd_deg * DEG) if s.azimuth_sd_deg else kind.noise[1],
        (s.elevation_sd_deg * DEG) if s.elevation_sd_deg else kind.noise[2],
    )
    levels = kind.levels
    delay = _delay_sd_m(seen)
    if delay is not None:
        top = tuple(e._replace(sd=delay) if e.term == "range_bias" else e for e in levels[-1])
        levels = (*levels[:-1], top)
    return kind._replace(noise=noise, levels=levels)


def typical_own(seen: Observed) -> dict[str, float]:
    """How much the errors that a target keeps for itself typically differ between targets (sd, SI), by the term they act as."""
    return {effect.term: effect.sd for effect in _kind(seen).levels[-1]}


def typical_noise(seen: Observed) -> tuple[float, float, float]:
    """The noise (sd, SI) of a plot in range, azimuth and elevation that is assumed before the data speak."""
    return _kind(seen).noise


def _delay_sd_m(seen: Observed) -> float | None:
    """How much the delays of the targets' transponders may plausibly differ, as range; None for a primary radar."""
    if seen.sensor.kind in GROUND_KINDS:
        return None
    counts = {name: int(np.isin(seen.channel, CHANNELS[name]).sum()) for name in ("psr", "ssr", "mode_s")}
    name = max(counts, key=lambda k: counts[k]) if any(counts.values()) else seen.sensor.kind
    return _DELAY_SD_M.get(name)


def _layout(seen: Observed, kind: _Kind, settings: LeastSquares) -> _Layout:
    short, long = settings.short_block_s or kind.block_s[0], settings.long_block_s or kind.block_s[1]
    n, time = len(seen), seen.time_s
    changes = np.flatnonzero(np.diff(seen.cluster)) + 1
    target_row: IntArray = np.r_[0, changes]
    since = time - np.repeat(time[target_row], np.diff(np.r_[target_row, n]))
    # A slow radar would have few plots in a block; blocks of fewer than about 12 cost more than they tell.
    steps = np.diff(time)[np.diff(seen.cluster) == 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    short = max(short, 12 * step) if step > 0 else short
    long = max(long, 3 * short)
    long_number = np.floor(since / long).astype(np.int64)
    short_number = np.floor((since - long_number * long) / short).astype(np.int64)
    new_target = np.zeros(n, bool)
    new_target[target_row] = True
    new_long = new_target | np.r_[True, np.diff(long_number) != 0]
    new_short = new_long | np.r_[True, np.diff(short_number) != 0]
    block = np.flatnonzero(new_short)
    long_row = np.flatnonzero(new_long)
    target_block = np.searchsorted(block, target_row)
    effects = list(kind.levels)
    if seen.has_elevation:
        for k, more in enumerate(_AIR_ELEVATION):
            last = max(e.group for e in effects[k]) + 1
            effects[k] = effects[k] + tuple(e._replace(group=e.group + last) for e in more)
    if not np.isfinite(seen.heading_rad).any():
        effects = [tuple(e for e in level if e.term not in _EXTENT) for level in effects]
    return _Layout(
        block=np.r_[block, n],
        long=np.searchsorted(block, long_row),
        target=np.asarray(np.searchsorted(long_row, target_row), np.int64),
        target_block=np.r_[target_block, len(block)],
        effects=tuple(effects),
        block_s=(short, long, float("inf")),
        channels=3 if seen.has_elevation else 2,
    )


def _robust(u: FloatArray, settings: LeastSquares) -> FloatArray:
    """The weight at u standard deviations: 1 up to `soft_sd`, then falling smoothly to nothing at `hard_sd`."""
    soft, hard = settings.soft_sd, settings.hard_sd
    far = np.clip((u - soft) / (hard - soft), 0.0, 1.0)
    weight: FloatArray = np.where(u <= soft, 1.0, soft / np.maximum(u, soft) * (1 - far * far) ** 2)
    return weight


def _row_variance(
    seen: Observed,
    rows: slice | IntArray,
    columns: Mapping[str, FloatArray],
    layout: _Layout,
    variances: mixed.Variances,
    share: float,
) -> FloatArray:
    """What one plot's residuals (n, channels) vary by, all effects included; `columns` (n, 3) by the term."""
    k = layout.channels
    by_term = dict.fromkeys(layout.names, 0.0)
    for level, variance in zip(layout.effects, variances.effects, strict=True):
        for e in level:
            by_term[e.term] += float(variance[e.group])
    total = variances.noise[:k] / seen.weight[rows, None] + share * seen.reference_variance[rows, :k]
    for term, variance_of_term in by_term.items():
        total += variance_of_term * columns[term][:, :k] ** 2
    return np.asarray(total)


def _effect_terms(layout: _Layout) -> tuple[Term, ...]:
    return tuple(TERMS[name] for name in layout.names)


def _sample(seen: Observed) -> Observed:
    """Every so many-th row: enough to start from."""
    return seen if len(seen) <= _START_PLOTS else take(seen, np.arange(0, len(seen), -(-len(seen) // _START_PLOTS)))


def _row_weights(u: FloatArray, present: BoolArray, settings: LeastSquares, *, convex: bool) -> FloatArray:
    """Weights (n, channels) from standardised residuals: a pair that is wrong in range or azimuth is wrong altogether."""
    size = np.where(present, np.abs(u), 0.0)
    worst = size[:, :2].max(axis=1)
    size = np.concatenate([np.tile(worst[:, None], (1, 2)), np.maximum(size[:, 2:], worst[:, None])], axis=1)
    if convex:
        weight = 1.5 / np.maximum(size, 1.5)
    else:
        weight = _robust(size, settings)
    return np.where(present, weight, 0.0)


def _robust_start(
    sample: Observed,
    whole: Observed,
    layout: _Layout,
    kind: _Kind,
    terms: tuple[Term, ...],
    settings: LeastSquares,
    at: FloatArray | None = None,
) -> _State:
    """A first solution that gross errors do not reach: plain least squares, first with Huber's convex loss, then redescending.

    `sample` are some of the rows, `whole` some of the targets with all their rows.  The effects only widen each plot's variance
    here.  The scale of the residuals is their median's.  From a value `at` that no gross error has reached, the loss redescends
    at once.
    """
    p, c = len(terms), layout.channels
    variances = mixed.Variances(np.array(kind.noise[:c]) ** 2, layout.guess)
    prior, prior_sd = precision(terms), np.array([t.prior_sd for t in terms])
    value, spread = np.zeros(p) if at is None else at, np.ones(c)
    late = 0 if at is None else 1

    share = 1.0

    def piece(part: slice) -> tuple[FloatArray, BoolArray, FloatArray]:
        _, r, columns = look(sample, part, terms, value, _effect_terms(layout))
        s = np.sqrt(_row_variance(sample, part, columns, layout, variances, share))
        present = np.isfinite(r[:, :c])
        x = np.stack([columns[t.name][:, :c] * t.prior_sd for t in terms], axis=2) / s[:, :, None]
        return np.where(present, r[:, :c], 0.0) / s, present, x

    def scale(pieces: Sequence[tuple[FloatArray, BoolArray, FloatArray]]) -> FloatArray:
        sizes = [np.concatenate([np.abs(u[present[:, k], k]) for u, present, _ in pieces]) for k in range(c)]
        return np.asarray(np.maximum([1.4826 * np.median(q) if len(q) else 1.0 for q in sizes], 1e-3))

    for number in range(settings.max_iterations):
        a, b = prior.copy(), -prior @ (value / prior_sd)
        pieces = in_threads(piece, slices(len(sample), CHUNK // 2))
        spread = scale(pieces)
        convex = (number < 6 and at is None) or late == 0
        for u, present, x in pieces:
            w = _row_weights(u / spread, present, settings, convex=convex) / spread**2
            for k in range(c):
                weighted = x[:, k] * w[:, k, None]
                a += weighted.T @ x[:, k]
                b += weighted.T @ u[:, k]
        step = np.linalg.solve(a, b)
        value = value + step * prior_sd
        done = bool(np.all(np.abs(step) <= 0.02 / np.sqrt(np.diag(a)) + 1e-9))
        late = late + 1 if done or number >= 10 else late
        if done and not convex:
            break
    # What a plot varies by depends on the share, and the residuals' scale on that.
    share = _reference_share(whole, terms, value)
    spread = scale(in_threads(piece, slices(len(sample), CHUNK // 2)))
    return _State(value, variances, share, spread, np.ones(len(layout.target)), _ended(done and not convex, number + 1))


def _reference_share(seen: Observed, terms: tuple[Term, ...], value: FloatArray) -> float:
    """How much of the variance that the reference states of itself changes from plot to plot, 0 … 1.

    Stated accuracies (NACp and the like) are mostly slow errors of a receiver, which belong to the target, not to the noise of
    the radar.  The squared differences of successive residuals tell: they are regressed on the stated variance, with 1 as the
    guess where the data say little.
    """
    if len(seen) < 3:
        return 1.0
    pairs = np.flatnonzero((np.diff(seen.cluster) == 0) & (np.diff(seen.time_s) > 0))
    r = np.concatenate([linearise(seen, part, terms, value)[1] for part in slices(len(seen), CHUNK)])
    stated = seen.reference_variance
    top, bottom, limit = 0.0, 0.0, 1.0
    for k in range(2):
        y = (r[pairs, k] - r[pairs + 1, k]) ** 2 / 2
        x = (stated[pairs, k] + stated[pairs + 1, k]) / 2
        if len(y) < 20 or not x.any():
            continue
        # Near targets make the stated variance of the azimuth uneven: each difference is weighed by its own expected size.
        typical = float(np.median(y)) / 0.455
        expected = max(typical - float(np.median(x)), 0.1 * typical) + x
        if not typical > 0:
            continue
        good = y <= 15 * expected
        y, x, w = y[good], x[good], 0.5 / expected[good] ** 2
        level, stated_level = float(w @ y / w.sum()), float(w @ x / w.sum())
        if stated_level > 0:
            limit = min(limit, 0.9 * level / stated_level)
        # Successive residuals of one target are alike in many ways: count a tenth of them.
        top += 0.1 * float((w * (x - stated_level)) @ (y - level))
        bottom += 0.1 * float((w * (x - stated_level)) @ (x - stated_level))
    share = (top + 4.0) / (bottom + 4.0)
    return float(np.clip(share, 0.0, limit))


class _Piece(NamedTuple):
    """Whole short blocks (from … to) and their rows: residuals (n, channels), columns (n, 3), the variance of each plot."""

    blocks: tuple[int, int]
    rows: slice
    residual: FloatArray
    columns: Mapping[str, FloatArray]
    variance: FloatArray


def _blocks(layout: _Layout, targets: tuple[int, int]) -> list[tuple[int, int]]:
    """The short blocks of the targets from … to, in ranges of about half a chunk of rows."""
    begin, end = int(layout.target_block[targets[0]]), int(layout.target_block[targets[1]])
    piece = layout.block[begin:end] // (CHUNK // 2)
    return list(pairwise([begin, *(np.flatnonzero(np.diff(piece) != 0) + begin + 1).tolist(), end]))


def _look_at(
    seen: Observed,
    layout: _Layout,
    terms: tuple[Term, ...],
    state: _State,
    blocks: tuple[int, int],
    also: tuple[Term, ...] = (),
) -> _Piece:
    rows = slice(int(layout.block[blocks[0]]), int(layout.block[blocks[1]]))
    _, r, columns = look(seen, rows, terms, state.value, (*_effect_terms(layout), *also))
    variance = _row_variance(seen, rows, columns, layout, state.variances, state.reference_share)
    return _Piece(blocks, rows, r[:, : layout.channels], columns, variance)


def grams(columns: Sequence[FloatArray], weight: FloatArray, starts: IntArray) -> FloatArray:
    """``C' diag(w) C`` (blocks, u, u) of u columns (n,) over the blocks of rows that begin at `starts` (blocks,)."""
    u = len(columns)
    out = np.zeros((len(starts), u, u))
    for i in range(u):
        left = weight * columns[i]
        # Many columns are nothing in one of the channels.
        if left.any():
            for j in range(i, u):
                out[:, i, j] = out[:, j, i] = np.add.reduceat(left * columns[j], starts)
    return out


def _products(
    seen: Observed,
    layout: _Layout,
    terms: tuple[Term, ...],
    state: _State,
    settings: LeastSquares,
    targets: tuple[int, int],
    pieces: Iterable[_Piece],
    weight_out: FloatArray | None = None,
    *,
    plain: mixed.Variances | None = None,
) -> tuple[mixed.Products, FloatArray]:
    """The cross products of the targets from … to, made of their `pieces`, at the state's value and with its weights.

    With `plain`, the true variances, each plot is weighted by what the state says that it varies by, its effects included; then
    what the noise adds to the meat (blocks, p, p) follows, for `mixed.plain_scores`.
    """
    p, c = len(terms), layout.channels
    effects = [e.term for level in layout.effects for e in level]
    wanted = [*effects, *(t.name for t in terms)]
    # The levels share most of their columns: each is multiplied once.
    names = list(dict.fromkeys(wanted))
    index = np.array([*(names.index(name) for name in wanted), len(names)])
    own_x = index[len(effects) : -1]
    prior_sd = np.array([t.prior_sd for t in terms])
    scale = np.r_[np.ones(len(effects)), prior_sd, 1.0]
    begin, end = int(layout.target_block[targets[0]]), int(layout.target_block[targets[1]])
    out = np.empty((c, end - begin, len(index), len(index)))
    meat = np.zeros((end - begin, p, p))
    count = np.zeros(c)
    for piece in pieces:
        lo, hi = piece.blocks
        starts = layout.block[lo:hi] - layout.block[lo]
        present = np.isfinite(piece.residual)
        r = np.where(present, piece.residual, 0.0)
        robust = _row_weights(r / (np.sqrt(piece.variance) * state.spread), present, settings, convex=False)
        count += state.trust[seen.cluster[piece.rows]] @ robust
        if weight_out is not None:
            weight_out[piece.rows] = robust[:, 0]
        noise = (state.variances if plain is None else plain).noise[:c]
        own = noise / seen.weight[piece.rows, None] + state.reference_share * seen.reference_variance[piece.rows, :c]
        w = robust * noise / own if plain is None else robust / piece.variance
        for k in range(c):
            columns = [np.ascontiguousarray(piece.columns[name][:, k]) for name in names]
            gram = grams([*columns, r[:, k]], w[:, k], starts)
            mine = out[k, lo - begin : hi - begin]
            np.multiply(gram[:, index[:, None], index], np.outer(scale, scale), out=mine)
            if plain is not None:
                added = grams(columns, w[:, k] ** 2 * own[:, k], starts)
                meat[lo - begin : hi - begin] += added[:, own_x[:, None], own_x] * np.outer(prior_sd, prior_sd)
    first_long, last_long = np.searchsorted(layout.long, [begin, end])
    groups = layout.groups
    levels = (
        mixed.Level(groups[0], np.arange(end - begin)),
        mixed.Level(groups[1], layout.long[first_long:last_long] - begin),
        mixed.Level(groups[2], layout.target[targets[0] : targets[1]] - first_long),
    )
    return mixed.Products(out, np.maximum(count, 1e-9), levels, p, state.trust[targets[0] : targets[1]]), meat


def _batches(layout: _Layout) -> list[tuple[int, int]]:
    """Ranges of targets that hold about `_BATCH_BLOCKS` short blocks each."""
    batch = layout.target_block[:-1] // _BATCH_BLOCKS
    edges = np.r_[np.flatnonzero(np.r_[True, np.diff(batch) != 0]), len(layout.target)]
    return list(pairwise(edges.tolist()))


def _all_reduced(
    seen: Observed, layout: _Layout, terms: tuple[Term, ...], state: _State, settings: LeastSquares, weight: FloatArray
) -> mixed.Reduced:
    """Every target, reduced, in batches that bound the memory."""

    def batch(targets: tuple[int, int]) -> mixed.Reduced:
        pieces = (_look_at(seen, layout, terms, state, blocks) for blocks in _blocks(layout, targets))
        products, _ = _products(seen, layout, terms, state, settings, targets, pieces, weight)
        return mixed.reduce(products, state.variances)

    parts = in_threads(batch, _batches(layout))
    return mixed.Reduced(np.concatenate([q.terms for q in parts]), np.concatenate([q.effects for q in parts]))


def _some_targets(seen: Observed, layout: _Layout) -> tuple[Observed, _Layout, IntArray]:
    """Targets enough for the variance components, evenly chosen, with all their rows; and which they are."""
    g, blocks = len(layout.target), len(layout.block) - 1
    every = int(np.ceil(max(blocks / _VARIANCE_BLOCKS, len(seen) / _VARIANCE_PLOTS)))
    which = np.arange(0, g, every)
    if every <= 1:
        return seen, layout, which

    def members(first: IntArray, counts: IntArray) -> IntArray:
        """The numbers first, first + 1, … of each group, one group behind the other."""
        return np.asarray(np.arange(int(counts.sum())) + np.repeat(first - np.r_[0, np.cumsum(counts)[:-1]], counts), np.int64)

    long_count = np.diff(np.r_[layout.target, len(layout.long)])[which]
    longs = members(layout.target[which], long_count)
    block_count = np.diff(np.r_[layout.long, blocks])[longs]
    numbers = members(layout.long[longs], block_count)
    sizes = np.diff(layout.block)[numbers]
    mine = take(seen, members(layout.block[numbers], sizes))
    first_block = np.r_[0, np.cumsum(block_count)]
    first_long = np.r_[0, np.cumsum(long_count)]
    return (
        replace(mine, cluster=np.searchsorted(which, mine.cluster), cluster_key=seen.cluster_key[which]),
        replace(
            layout, block=np.r_[0, np.cumsum(sizes)], long=first_block[:-1], target=first_long[:-1],
            target_block=first_block[first_long],
        ),
        which,
    )  # fmt: skip


def _settle(
    some: tuple[Observed, _Layout, IntArray], kind: _Kind, terms: tuple[Term, ...], start: _State, settings: LeastSquares
) -> _State:
    """Variance components, weights and values in turn, until the values rest, on `some` targets, whose trust it holds."""
    part, part_layout, which = some
    c = part_layout.channels
    prior, prior_sd = precision(terms), np.array([t.prior_sd for t in terms])
    guess = mixed.Variances(np.array(kind.noise[:c]) ** 2, part_layout.guess)
    every = (0, len(which))
    state = replace(start, trust=np.ones(len(which)))
    for number in range(settings.max_iterations):
        at, noise_before = state.value / prior_sd, state.variances.noise
        here = state
        pieces = in_threads(lambda blocks: _look_at(part, part_layout, terms, here, blocks), _blocks(part_layout, every))  # noqa: B023
        state = replace(state, spread=_spread(pieces))
        products, _ = _products(part, part_layout, terms, state, settings, every, pieces)
        variances = mixed.estimate(products, state.variances, prior, at, guess, steps=30 if number == 0 else 8)
        reduced = mixed.reduce(products, variances)
        solution = mixed.solve(reduced.terms * state.trust[:, None, None], prior, at)
        state = _State(
            state.value + solution.value * prior_sd,
            variances,
            state.reference_share,
            state.spread,
            _trust(reduced, solution, settings),
        )
        settled = np.all(np.abs(variances.noise / noise_before - 1) <= 0.02)
        moved = float(np.max(np.abs(solution.value) / np.sqrt(np.diag(solution.covariance)), initial=0.0))
        rests = bool(settled and moved <= 0.02)
        if number >= 2 and rests:
            break
    return replace(state, ended=_ended(rests, number + 1, moved))


def _ended(rests: bool, steps: int, moved: float = 0.0) -> str:
    """How the steps ended; `moved` is by how much of its sd the last one moved a value at most."""
    last = "" if rests or moved == 0 else f": the last one moved values by up to {moved:.2g} of their sd"
    return f"{'converged' if rests else 'not converged'} after {steps} step{'' if steps == 1 else 's'}{last}"


def _whole(
    seen: Observed,
    layout: _Layout,
    some: tuple[Observed, _Layout, IntArray],
    terms: tuple[Term, ...],
    settled: _State,
    settings: LeastSquares,
) -> tuple[_State, mixed.Reduced, FloatArray]:
    """What some targets settled, with all of them: the state, the targets reduced there, and each pair's weight."""
    state, which, prior_sd = settled, some[2], np.array([t.prior_sd for t in terms])
    prior = precision(terms)
    trust = np.ones(len(layout.target))
    trust[which] = state.trust
    state = replace(state, trust=trust)
    weight = np.empty(len(seen))
    reduced = _all_reduced(seen, layout, terms, state, settings, weight)
    if len(which) < len(trust):
        # The others' trust was not known yet.
        trust = _trust(reduced, mixed.solve(reduced.terms * trust[:, None, None], prior, state.value / prior_sd), settings)
        state = replace(state, trust=trust)
    return state, reduced, weight


def _wide(
    some: tuple[Observed, _Layout, IntArray],
    wide: tuple[Term, ...],
    chosen: tuple[Term, ...],
    start: _State,
    state: _State,
    settings: LeastSquares,
) -> FloatArray:
    """The normal equations (G, q + 1, q + 1) of the `wide` model, whose first terms are the `chosen` ones.

    They are about zero, in units of the terms' prior sd, and those of the estimate that the chosen model would get: weighed by
    what plots share, or where that misleads by each plot for itself.
    """
    part, layout, which = some
    p, every = len(chosen), (0, len(which))
    prior_sd = np.array([t.prior_sd for t in chosen])
    pieces = in_threads(lambda blocks: _look_at(part, layout, chosen, state, blocks, wide), _blocks(layout, every))
    products, _ = _products(part, layout, wide, state, settings, every, pieces)
    normal = mixed.reduce(products, state.variances).terms * state.trust[:, None, None]
    at, plain_at = state.value / prior_sd, start.value / prior_sd
    own = np.r_[np.arange(p), len(wide)]
    narrow = normal[:, own[:, None], own]
    start, weight = replace(start, trust=np.ones(len(which))), np.empty(len(part))
    plain, _ = _plain(part, layout, chosen, start, state.variances, settings, weight)
    both = _compare(mixed.Scores(narrow, narrow[:, :p, :p]), at, plain, plain_at, precision(chosen))
    if both.chance < settings.agreement:
        normal, at = _plain(part, layout, chosen, start, state.variances, settings, weight, wide)[0].terms, plain_at
    return about_zero(normal, np.r_[at, np.zeros(len(wide) - p)])


def about_zero(normal: FloatArray, at: FloatArray) -> FloatArray:
    """Normal equations (G, p + 1, p + 1) whose residuals were taken at the values `at` (p,), with the residuals taken at zero."""
    turn = np.eye(len(at) + 1)
    turn[:-1, -1] = at
    result: FloatArray = turn.T @ normal @ turn
    return result


def _spread(pieces: Sequence[_Piece]) -> FloatArray:
    """The median size of each channel's residuals, in units of what the model expects of one plot (1 if it were normal).

    Whole segments of a target can be wrong (multilateration near a hangar).  They widen the variance components, and would
    then look ordinary; the median does not follow them.
    """
    size = np.concatenate([np.abs(q.residual) / np.sqrt(q.variance) for q in pieces])
    out = np.array([1.4826 * np.median(s[np.isfinite(s)]) if np.isfinite(s).any() else 1.0 for s in size.T])
    return np.asarray(np.maximum(out, 0.25))


def _trust(reduced: mixed.Reduced, solution: mixed.Solution, settings: LeastSquares) -> FloatArray:
    """The weight (G,) of each target: one whose own effects are far from what the others have (a wrong pairing, a broken
    transponder) loses it.  With fewer than 8 targets there are no others to tell by."""
    w = reduced.effects.shape[1]
    if len(reduced.terms) < 8:
        return np.ones(len(reduced.terms))
    p = len(solution.value)
    inner = reduced.effects[:, :, :w]
    score = reduced.effects[:, :, w + p] - reduced.effects[:, :, w : w + p] @ solution.value
    scale = np.sqrt(np.maximum(np.einsum("gii->gi", inner), 1e-300))
    inverse = np.linalg.pinv(inner / scale[:, :, None] / scale[:, None, :], rcond=1e-6, hermitian=True)
    rank = np.maximum(np.linalg.matrix_rank(inner / scale[:, :, None] / scale[:, None, :], tol=1e-6, hermitian=True), 1)
    score = score / scale
    square = np.einsum("gi,gij,gj->g", score, inverse, score)
    # Chi-squared to normal (Wilson and Hilferty 1931).
    normal = ((square / rank) ** (1 / 3) - (1 - 2 / (9 * rank))) / np.sqrt(2 / (9 * rank))
    return np.maximum(_robust(np.maximum(normal, 0.0), settings), 1e-6)


def _rank_deficient(
    sample: Observed, layout: _Layout, terms: tuple[Term, ...], state: _State, settings: LeastSquares
) -> Dropped | None:
    """The last term, in the order of `_ORDER`, of whose column too little remains once the earlier ones are taken out of it."""
    p, c = len(terms), layout.channels
    gram = np.zeros((p, p))
    for part in slices(len(sample), CHUNK):
        _, r, columns = look(sample, part, terms, state.value, _effect_terms(layout))
        total = _row_variance(sample, part, columns, layout, state.variances, state.reference_share)
        present = np.isfinite(r[:, :c])
        u = np.where(present, r[:, :c], 0.0) / np.sqrt(total)
        w = _row_weights(u / state.spread, present, settings, convex=False) / total / state.spread**2
        for k in range(c):
            x = np.stack([columns[t.name][:, k] for t in terms], axis=1)
            gram += (x * w[:, k, None]).T @ x
    prior = np.array([t.prior_sd for t in terms])
    information, free = _beside_tables(gram * np.outer(prior, prior), terms)
    if not free:
        return None
    own = np.array([t.prior_sd for t in free])
    bad = rank_check(information / np.outer(own, own) if len(free) < p else gram, free, settings)
    if bad is not None:
        return bad
    return pair_check(np.asarray(np.linalg.inv(information), np.float64), free, settings)


def _beside_tables(information: FloatArray, terms: Sequence[Term]) -> tuple[FloatArray, tuple[Term, ...]]:
    """The information of the terms that are no nodes of a table, with the tables known as far as data and their prior tell.

    `information` (p, p) is in units of the terms' prior sd.  Nodes lean on their neighbours: their rank is not in question.
    """
    node = np.array([bool(table_of(t)) for t in terms])
    if not node.any():
        return information, tuple(terms)
    cross = information[np.ix_(node, ~node)]
    inner = (information + precision(terms))[np.ix_(node, node)]
    rest = information[np.ix_(~node, ~node)] - cross.T @ np.linalg.solve(inner, cross)
    return (rest + rest.T) / 2, tuple(t for t in terms if not table_of(t))


def rank_check(gram: FloatArray, terms: Sequence[Term], settings: LeastSquares) -> Dropped | None:
    """The latest term whose scaled column is a mix of the earlier ones, or is nothing at all; None where the rank is full.

    `gram` (p, p) is ``X' W X``.  What remains of each unit column after the earlier terms are projected out is the diagonal of
    its Cholesky factor: the same number that a QR of the columns, taken in this order, has on its diagonal.
    """
    size = np.sqrt(np.diag(gram))
    order = sorted(range(len(terms)), key=lambda k: _rank_of(terms[k]))
    # A column is nothing where a plausible value (prior sd) would not show in all plots together.
    for k in reversed(order):
        if not size[k] * terms[k].prior_sd > 1e-6:
            return Dropped(terms[k].name, f"{terms[k].name} has no effect on these plots")
    unit = gram / size[:, None] / size
    kept: list[int] = []
    found: Dropped | None = None
    for k in order:
        if kept:
            inner, cross = unit[np.ix_(kept, kept)], unit[kept, k]
            mix = np.asarray(np.linalg.solve(inner, cross), np.float64)
            left = float(np.sqrt(max(1.0 - float(cross @ mix), 0.0)))
        else:
            mix, left = np.zeros(0), 1.0
        if left < settings.rank_tolerance:
            j = kept[int(np.argmax(np.abs(mix)))]
            per = mix[kept.index(j)] * size[k] / size[j]
            others = [terms[i].name for i, a in zip(kept, mix, strict=True) if abs(a) > 0.1 * np.abs(mix).max()]
            found = Dropped(
                terms[k].name,
                f"on these plots {terms[k].name} cannot be told from {_and(others)}: {100 * left:.2f} % of its effect is its own",
                terms[j].name,
                _absorbs(terms[j], terms[k], per),
            )
        else:
            kept.append(k)
    return found


def _inseparable(reduced: FloatArray, terms: tuple[Term, ...], settings: LeastSquares) -> Dropped | None:
    """The term to leave out next: of the most correlated pair the later; else the one that is less certain than its prior."""
    p = len(terms)
    information, free = _beside_tables(reduced[:, :p, :p].sum(axis=0), terms)
    if not free:
        return None
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / size[:, None] / size, rcond=1e-12, hermitian=True) / size[:, None] / size
    return pair_check(covariance, free, settings)


def pair_check(covariance: FloatArray, terms: Sequence[Term], settings: LeastSquares) -> Dropped | None:
    """The term to leave out by the covariance (p, p) of the estimates, in units of the terms' prior sd and without the prior."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.abs(covariance / sd[:, None] / sd)
    close = [
        (correlation[i, j], *sorted((i, j), key=lambda k: _rank_of(terms[k])))
        for i in range(len(terms))
        for j in range(i)
        if correlation[i, j] >= settings.max_correlation
    ]
    # A pair is separable all the same where the later term is known to a small part of what it may plausibly be.
    close = [(r, keep, drop) for r, keep, drop in close if sd[drop] > settings.well_known]
    if close:
        _, keep, drop = max(close)
        ratio = -covariance[keep, drop] / covariance[drop, drop] * terms[keep].prior_sd / terms[drop].prior_sd
        return Dropped(
            terms[drop].name,
            f"{terms[drop].name} cannot be told from {terms[keep].name}: "
            f"their estimates correlate by {covariance[keep, drop] / sd[keep] / sd[drop]:+.3f}",
            terms[keep].name,
            _absorbs(terms[keep], terms[drop], float(ratio)),
        )
    worst = int(np.argmax(sd))
    if sd[worst] > 1.0:
        t = terms[worst]
        return Dropped(
            t.name,
            f"its sd would be {sd[worst] * t.prior_sd / t.si_per_unit:.3g} {t.unit}, more than any plausible {t.name} "
            f"({t.prior_sd / t.si_per_unit:.3g} {t.unit})",
        )
    return None


def _rank_of(term: Term) -> tuple[int, bool]:
    return _ORDER.index(term.base) if term.base in _ORDER else len(_ORDER), term.channel != "all"


def _absorbs(keep: Term, drop: Term, per: float) -> str:
    amount = per * drop.si_per_unit / keep.si_per_unit
    return f"{keep.name} also holds what there is of {drop.name}: {amount:+.3g} {keep.unit} for each {drop.unit}"


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _finish(
    seen: Observed,
    layout: _Layout,
    terms: tuple[Term, ...],
    start: _State,
    state: _State,
    reduced: mixed.Reduced,
    weight: FloatArray,
    dropped: list[Dropped],
    settings: LeastSquares,
    choices: tuple[Choice, ...],
    doubt: FloatArray,
) -> Fit:
    p, c = len(terms), layout.channels
    prior, prior_sd = precision(terms), np.array([t.prior_sd for t in terms])
    w = reduced.effects.shape[1]
    notes = []
    at = state.value / prior_sd
    trusted, ended = state.trust, state.ended
    terms_of_targets = reduced.terms * trusted[:, None, None]
    scores = mixed.Scores(terms_of_targets, terms_of_targets[:, :p, :p])
    plain_weight, plain_at = np.empty(len(seen)), start.value / prior_sd
    plain, plain_influence = _plain(seen, layout, terms, start, state.variances, settings, plain_weight)
    both = _compare(scores, at, plain, plain_at, prior)
    step, honest = both.step, both.honest
    effects = reduced.effects * trusted[:, None, None]
    influence = effects[:, :, w : w + p]
    own_scores = effects[:, :, w + p] - effects[:, :, w : w + p] @ step
    if both.chance < settings.agreement:
        notes.append(
            "the errors that plots of one target share are not as the model has them (weighting by them changes the result by "
            f"more than chance, p = {both.chance:.1g}): every plot counts for itself, and the sd follow the targets' scatter"
        )
        scores, honest, influence, weight = plain, both.plain_honest, plain_influence, plain_weight
        at, step, trusted, ended = plain_at, both.plain_step, start.trust, start.ended
    scale = np.outer(prior_sd, prior_sd)
    noise = np.full(3, np.nan)
    noise[:c] = np.sqrt(state.variances.noise)
    gone = int((weight == 0).sum())
    if gone:
        share = f"{gone:,} of {len(seen):,} pairs ({100 * gone / len(seen):.1f} %)"
        notes.append(f"{share} lie more than {settings.hard_sd:g} sd away and have no weight")
    doubted = int((trusted < 0.5).sum())
    if doubted:
        notes.append(f"{doubted} of {len(state.trust)} targets differ from all others and have little weight")
    notes += [f"inliers: {len(seen) - gone:,} of {len(seen):,}", f"how it ended: {ended}"]
    return Fit(
        terms=terms,
        value=(at + step) * prior_sd,
        covariance=(honest.covariance + doubt) * scale,
        model_covariance=honest.model * scale,
        sandwich=honest.sandwich * scale,
        bread=honest.bread * scale,
        noise_sd=noise,
        weight=weight,
        effective=honest.targets,
        effect_names=tuple(e.term for e in layout.effects[-1]),
        effect_variance=state.variances.effects[-1][layout.groups[-1]],
        scores=own_scores,
        information=effects[:, :, :w],
        influence=influence / prior_sd,
        held_out=(at + _held_out(scores.terms, prior, at, layout)) * prior_sd,
        normal=about_zero(scores.terms, at),
        choices=choices,
        dropped=tuple(dropped),
        notes=tuple(notes),
        effects=_shared_effects(seen, layout, state.variances),
        reference_share=state.reference_share,
    )


def _shared_effects(seen: Observed, layout: _Layout, variances: mixed.Variances) -> tuple[Effect, ...]:
    """The random errors that plots of one target share, by what they act as; those of a target come last."""
    out: list[Effect] = []
    for level, block, variance in zip(layout.effects, layout.block_s, variances.effects, strict=True):
        for e in level:
            # What is a target's own in range for good is its transponder's delay, as far as anything tells.
            delay = e.term == "range_bias" and np.isinf(block) and _delay_sd_m(seen) is not None
            out.append(Effect("transponder_delay" if delay else e.term, block, float(np.sqrt(variance[e.group]))))
    return tuple(out)


def _plain(
    seen: Observed,
    layout: _Layout,
    terms: tuple[Term, ...],
    start: _State,
    variances: mixed.Variances,
    settings: LeastSquares,
    weight: FloatArray,
    wide: tuple[Term, ...] = (),
) -> tuple[mixed.Scores, FloatArray]:
    """The scores (G targets) of least squares in which every plot counts for itself, at the robust start, and their influence;
    of the `wide` model where one is given."""

    def batch(targets: tuple[int, int]) -> tuple[mixed.Scores, FloatArray]:
        pieces = (_look_at(seen, layout, terms, start, blocks, wide) for blocks in _blocks(layout, targets))
        products, meat = _products(seen, layout, wide or terms, start, settings, targets, pieces, weight, plain=variances)
        return mixed.plain_scores(products, meat, variances), mixed.influence(products)

    parts = in_threads(batch, _batches(layout))
    scores = mixed.Scores(*(np.concatenate(q) for q in zip(*(part[0] for part in parts), strict=True)))
    return scores, np.concatenate([part[1] for part in parts])


class _Both(NamedTuple):
    """Two estimates of one model, by what plots share and by each plot for itself, and the chance that they differ so much."""

    step: FloatArray
    honest: mixed.Honest
    plain_step: FloatArray
    plain_honest: mixed.Honest
    chance: float


def _compare(scores: mixed.Scores, at: FloatArray, plain: mixed.Scores, plain_at: FloatArray, prior: FloatArray) -> _Both:
    p = len(at)
    step, plain_step = mixed.solve(scores.terms, prior, at).value, mixed.solve(plain.terms, prior, plain_at).value
    honest, plain_honest = (mixed.honest_covariance(q, prior, d) for q, d in ((scores, step), (plain, plain_step)))
    pulls = [
        (q.terms[:, :p, p] - q.terms[:, :p, :p] @ d) @ h.bread
        for q, d, h in ((plain, plain_step, plain_honest), (scores, step, honest))
    ]
    chance = _agreement((plain_at + plain_step) - (at + step), plain_honest, honest, pulls[0] - pulls[1])
    return _Both(step, honest, plain_step, plain_honest, chance)


def _agreement(difference: FloatArray, plain: mixed.Honest, weighted: mixed.Honest, pulls: FloatArray) -> float:
    """The probability that two estimates differ so much by chance (Hausman 1978).

    Under the model the efficient estimate is uncorrelated with its difference from any other, so the difference's covariance is
    the difference of the covariances (small eigenvalues, where the two are all but equal, are bounded).  What each target
    pulls it by, `pulls` (G, p), gives the same without the model, and outweighs it from some thirty targets on.
    """
    from scipy.special import fdtrc

    p = len(difference)
    root = np.linalg.cholesky(plain.model * plain.scale)
    inner = np.linalg.solve(root, np.linalg.solve(root, weighted.model * weighted.scale).T)
    size, axes = np.linalg.eigh(np.eye(p) - (inner + inner.T) / 2)
    expected = (axes * np.clip(size, 0.1, None)) @ axes.T
    pulls = np.linalg.solve(root, pulls.T)
    spread = (expected * 30 + pulls @ pulls.T * plain.targets) / (30 + plain.targets)
    off = np.linalg.solve(root, difference)
    square = float(off @ np.linalg.solve(spread, off))
    return float(fdtrc(p, max(plain.targets - 1.0, 2.0), square / p))


def folds(size: IntArray) -> IntArray:
    """A fold (0 … 4) for each target (G,), dealt by their numbers of plots so that the folds are alike."""
    fold = np.empty(len(size), np.int64)
    fold[np.argsort(-size, kind="stable")] = np.arange(len(size)) % _FOLDS
    return fold


def _held_out(reduced: FloatArray, prior: FloatArray, at: FloatArray, layout: _Layout) -> FloatArray:
    """The step (G, p) found without the fold that each target is in; NaN where no target would be left."""
    target_rows = layout.block[layout.target_block]
    fold = folds(np.diff(target_rows))
    out = np.full((len(reduced), len(at)), np.nan)
    if len(reduced) > 1:
        for k in range(_FOLDS):
            mine = fold == k
            if mine.any():
                out[mine] = mixed.solve(reduced[~mine], prior, at).value
    return out


def accuracy(seen: Observed, fitted: Fit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Horizontal distances (n,), metres: before, after, and with the value found without the target's own fold (else NaN).

    Terms of acceleration are in the fit, but a correction cannot take them out: plots do not tell accelerations.
    """
    n = len(seen)
    before, after, held = np.empty(n), np.empty(n), np.full(n, np.nan)
    size = np.bincount(seen.cluster, minlength=len(fitted.held_out))
    fold = folds(size)
    zero = np.zeros(len(fitted.terms))
    taken = np.array([not t.needs & {"second", "third"} for t in fitted.terms], np.float64)

    def piece(part: slice) -> None:
        before[part] = distances(seen, part, fitted.terms, zero)
        after[part] = distances(seen, part, fitted.terms, fitted.value * taken)

    in_threads(piece, slices(n, CHUNK))
    for k in range(_FOLDS):
        targets = np.flatnonzero(fold == k)
        if len(targets) and np.isfinite(fitted.held_out[targets[0]]).all():
            rows, value = np.flatnonzero(fold[seen.cluster] == k), fitted.held_out[targets[0]] * taken

            def held_piece(part: slice, rows: IntArray = rows, value: FloatArray = value) -> None:
                held[rows[part]] = distances(seen, rows[part], fitted.terms, value)

            in_threads(held_piece, slices(len(rows), CHUNK))
    return before, after, held


def default_model(sensor: Sensor) -> str:
    """The model of a kind of sensor."""
    return "surface" if sensor.kind in GROUND_KINDS else "atc"
