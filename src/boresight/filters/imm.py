"""Interacting multiple models, with a fixed set, an expected-mode model, or a set that follows the target through a fan of turns.

One `step` serves the filter here and the tracker.  Sources: Blom & Bar-Shalom 1988 (the filter); Li, Jilkov & Ru 2005 and paper
001 eqs. 2 to 6 (expected-mode augmentation, switching of groups); METHODS section 8.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from .._jit import inlined, kernel
from .._parallel import in_threads, slices
from .._types import FloatArray
from ..errors import SettingsError
from .kalman import check, measured, predict, update
from .motion import NOISE, NOISE_UP, PARAMETER, SAME_S, CoordinatedTurn, Motion, fill, size, table, vertical

_ROWS = 16


class Imm(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="imm"):
    """A fixed set of models; `stay` is the probability that a target keeps its model for `stay_s` seconds.

    The chance of a change grows with the time between measurements; a target that changes takes any other model alike.
    `transition` (rows: from, columns: to) takes the place of both, per measurement, where it is given.
    """

    models: tuple[Motion, ...]
    stay: float = 0.95
    stay_s: float = 4.0
    transition: tuple[tuple[float, ...], ...] | None = None
    start: tuple[float, ...] | None = None


class ExpectedMode(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="ema-imm"):
    """Turns at a fan of rates, of which a group of neighbours is in use, and one turn more at their expected rate.

    `rates_deg_s` are in order; the group is the `group` (odd) rates about its centre.  Where the model that is both the likeliest
    and the most probable stands on the group's boundary, it becomes the centre.  `expected` = false leaves the expected mode
    out: then this is a switching grid.  The defaults were tuned on simulated airliners (benchmarks, `ema_imm`); boats that keep
    turning to and fro want `noise` near 0.01, and a group as large as the fan where they turn quickly.
    """

    rates_deg_s: tuple[float, ...] = (-6.0, -4.5, -3.0, -1.5, 0.0, 1.5, 3.0, 4.5, 6.0)
    group: int = 7
    noise: float = 0.5
    noise_up: float | None = None
    expected: bool = True
    stay: float = 0.9
    stay_s: float = 4.0


class Mixed(NamedTuple):
    """What interacting models say after each measurement: as `kalman.Filtered`, with the models' probabilities (n, K, M).

    `rate_rad_s` (n, K) is the probability-weighted turn rate, positive to the right.
    """

    time_s: FloatArray
    mean: FloatArray
    covariance: FloatArray
    nis: FloatArray
    likelihood: FloatArray
    probability: FloatArray
    rate_rad_s: FloatArray
    kept: Kept | None = None


class Kept(NamedTuple):
    """What the smoother needs of each model after each measurement, once the group has moved.

    `mean` (n, K, M, d), `covariance` (n, K, M, d, d), `probability` (n, K, M), `models` (n, K, M, 4) with which the step to this
    time was predicted, and `change` (K, M, M), the probabilities of a change over it.
    """

    mean: FloatArray
    covariance: FloatArray
    probability: FloatArray
    models: FloatArray
    change: FloatArray


# The least probability of a model ahead of a measurement.
_LEAST = 1e-100


@inlined
def mix(
    x: FloatArray,
    p: FloatArray,
    probability: FloatArray,
    change: FloatArray,
    like: tuple[int, ...],
    count: int,
    mean: FloatArray,
    spread: FloatArray,
    prior: FloatArray,
    weight: FloatArray,
) -> None:
    """The start of every model from all: mixed means and covariances into `mean`, `spread`, probabilities ahead into `prior`."""
    d = len(like)
    for j in range(count):
        s = 0.0
        for i in range(count):
            s += change[i, j] * probability[i]
        prior[j] = s
        scale = 1.0 / s if s > 0.0 else 0.0
        for i in range(count):
            weight[i] = change[i, j] * probability[i] * scale
        for a in range(d):
            t = 0.0
            for i in range(count):
                t += weight[i] * x[i, a]
            mean[j, a] = t
        for a in range(d):
            for b in range(a, d):
                t = 0.0
                for i in range(count):
                    t += weight[i] * (p[i, a, b] + (x[i, a] - mean[j, a]) * (x[i, b] - mean[j, b]))
                spread[j, a, b] = t
                spread[j, b, a] = t


@inlined
def take_in(
    x: FloatArray,
    p: FloatArray,
    prior: FloatArray,
    transition: FloatArray,
    noise: FloatArray,
    z: FloatArray,
    r: FloatArray,
    row: int,
    step: int,
    like: tuple[int, ...],
    axes: tuple[int, ...],
    count: int,
    mixed: FloatArray,
    mixed_spread: FloatArray,
    ahead: FloatArray,
    work: FloatArray,
    gain: FloatArray,
    score: FloatArray,
    probability: FloatArray,
) -> tuple[float, float]:
    """Predict every model from its mixed start and take in ``z[row, step]``; without a measurement only predict.

    Fills `x`, `p`, `probability` and `score` (relative likelihoods), and returns the normalised innovation squared (mean over the
    models' probabilities ahead) and the logarithm of the measurement's density; NaN without a measurement.
    """
    k = len(axes)
    given = measured(z, row, step, axes)
    nearest, nis = np.inf, 0.0
    # Each kernel is called in one place only, so that the compiler puts it in line.
    for m in range(count):
        predict(mixed, mixed_spread, m, transition, noise, like, work, ahead, p)
        if given:
            d2, det = update(ahead, p, m, z, r, row, step, like, axes, gain, x)
            score[m], probability[m] = d2, det
            nis += prior[m] * d2
            nearest = min(nearest, d2)
        else:
            for a in range(len(like)):
                x[m, a] = ahead[m, a]
            probability[m] = prior[m]
    if not given:
        return np.nan, np.nan
    return nis, weigh(prior, score, probability, count, nearest, k)


@inlined
def weigh(prior: FloatArray, score: FloatArray, probability: FloatArray, count: int, nearest: float, components: int) -> float:
    """The models' probabilities after a measurement, from what they were ahead of it; returns the logarithm of its density.

    `score` holds each model's normalised innovation squared (`nearest` is the least) and becomes its relative likelihood;
    `probability` holds the determinant of the innovation's covariance.
    """
    # Relative to the nearest model's exponent: a measurement that is far from all models still tells which is nearest.
    total = 0.0
    for m in range(count):
        score[m] = np.exp(-0.5 * (score[m] - nearest)) / np.sqrt(probability[m])
        # A model that was ruled out to the last digit may be the only one that is near now.
        probability[m] = max(prior[m], _LEAST) * score[m]
        total += probability[m]
    for m in range(count):
        # None is ruled out to nothing: its own state would go with it.
        probability[m] = max(probability[m] / total, _LEAST)
    return float(np.log(total) - 0.5 * (nearest + components * 1.8378770664093453))


@inlined
def combine(x: FloatArray, p: FloatArray, probability: FloatArray, like: tuple[int, ...], count: int, mean: FloatArray) -> None:
    """The probability-weighted mean (d,) of the models' states into `mean`."""
    for a in range(len(like)):
        s = 0.0
        for m in range(count):
            s += probability[m] * x[m, a]
        mean[a] = s


@inlined
def combined_spread(
    x: FloatArray,
    p: FloatArray,
    probability: FloatArray,
    mean: FloatArray,
    like: tuple[int, ...],
    count: int,
    spread: FloatArray,
) -> None:
    """The covariance (d, d) of the mixture about `mean` into `spread`."""
    d = len(like)
    for a in range(d):
        for b in range(a, d):
            s = 0.0
            for m in range(count):
                s += probability[m] * (p[m, a, b] + (x[m, a] - mean[a]) * (x[m, b] - mean[b]))
            spread[a, b] = s
            spread[b, a] = s


@inlined
def fill_change(change: FloatArray, stay: float, stay_s: float, dt: float, count: int) -> None:
    """Probabilities of a change of model over dt, (M, M), rows: from.  Kept with `stay` over `stay_s`; others alike."""
    even = 1.0 / count
    # A chain that is memoryless in time: over two steps it does what it does over one of their sum.
    rate = (stay - even) / (1.0 - even) if count > 1 else 1.0
    keep = even + (1.0 - even) * max(rate, 1e-12) ** (dt / stay_s) if count > 1 else 1.0
    for i in range(count):
        for j in range(count):
            change[i, j] = keep if i == j else (1.0 - keep) / max(count - 1, 1)


@kernel
def regroup(
    x: FloatArray,
    p: FloatArray,
    probability: FloatArray,
    score: FloatArray,
    centre: int,
    rates: int,
    like: tuple[int, ...],
    count: int,
    group: int,
    new_probability: float,
    mean: FloatArray,
    spread: FloatArray,
) -> int:
    """Move the group where its likeliest and most probable model stands on its boundary; returns the new centre.

    Slots 0 … group - 1 hold the rates about `centre`, in order.  Slots that stay in the group keep their states; new ones start
    from the combined state `mean`, `spread` (scratch: filled here) with `new_probability`.  Paper 001 eqs. 4, 5.
    """
    likeliest, probable = 0, 0
    for m in range(1, group):
        if score[m] > score[likeliest]:
            likeliest = m
        if probability[m] > probability[probable]:
            probable = m
    if likeliest != probable or (probable != 0 and probable != group - 1):
        return centre
    half = group // 2
    to = min(max(centre + probable - half, half), rates - 1 - half)
    shift = to - centre
    if shift == 0:
        return centre
    combine(x, p, probability, like, count, mean)
    combined_spread(x, p, probability, mean, like, count, spread)
    d = len(like)
    # In the direction of the shift, so that no slot is written before it is read.
    for q in range(group):
        m = q if shift > 0 else group - 1 - q
        old = m + shift
        for a in range(d):
            x[m, a] = x[old, a] if 0 <= old < group else mean[a]
            for b in range(d):
                p[m, a, b] = p[old, a, b] if 0 <= old < group else spread[a, b]
        probability[m] = probability[old] if 0 <= old < group else new_probability
    total = 0.0
    for m in range(count):
        total += probability[m]
    for m in range(count):
        probability[m] /= total
    return to


@kernel
def _run(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    fan: FloatArray,
    group: int,
    expected: bool,
    stay: float,
    stay_s: float,
    given_change: FloatArray,
    start: FloatArray,
    start_spread: FloatArray,
    start_probability: FloatArray,
    first: int,
    like: tuple[int, ...],
    axes: tuple[int, ...],
    count: int,
    mean: FloatArray,
    covariance: FloatArray,
    nis: FloatArray,
    likelihood: FloatArray,
    probability: FloatArray,
    rate: FloatArray,
    kept_mean: FloatArray,
    kept_covariance: FloatArray,
    kept_probability: FloatArray,
    kept_models: FloatArray,
    kept_change: FloatArray,
) -> None:
    """Interacting models over targets (n, K); what is kept for the smoother only where there is room for it.

    `fan` (F, 4) are all models in order.  Slots 0 … group - 1 hold neighbours of it (all, where group = F), and where
    `expected` the last slot is the turn at the expected rate.
    """
    d, k = len(like), len(axes)
    x, p = np.zeros((count, d)), np.zeros((count, d, d))
    mixed, mixed_spread, ahead = np.zeros((count, d)), np.zeros((count, d, d)), np.zeros((count, d))
    transition, noise, current = np.zeros((count, d, d)), np.zeros((count, d, d)), np.zeros((count, 4))
    change, prior, score, weight = np.zeros((count, count)), np.zeros(count), np.zeros(count), np.zeros(count)
    work, gain, up = np.zeros((d, d)), np.zeros((d, 2 * k)), np.zeros(3)
    one, one_spread = np.zeros(d), np.zeros((d, d))
    up[2] = 1.0
    half = group // 2
    keep = covariance.shape[0] > 0
    last, filled_for = -1.0, -1
    for row in range(z.shape[0]):
        centre = fan.shape[0] // 2 if group < fan.shape[0] else half
        for m in range(count):
            weight[m] = start_probability[m]
            for i in range(d):
                x[m, i] = start[row, i]
                for j in range(d):
                    p[m, i, j] = start_spread[row, i, j]
        for step in range(first, z.shape[1]):
            if step > first:
                dt = time_s[step] - time_s[step - 1]
                if abs(dt - last) > SAME_S:
                    if given_change.shape[0] > 0:
                        for i in range(count):
                            for j in range(count):
                                change[i, j] = given_change[i, j]
                    else:
                        fill_change(change, stay, stay_s, dt, count)
                if k == 3:
                    combine(x, p, weight, like, count, one)
                    for i in range(3):
                        ahead[0, i] = one[i]
                    vertical(ahead, 0, up)
                if k == 3 or abs(dt - last) > SAME_S or centre != filled_for:
                    for m in range(group):
                        for h in range(4):
                            current[m, h] = fan[centre - half + m, h]
                        fill(current, m, dt, up, transition, noise, like, axes)
                    last, filled_for = dt, centre
                if expected:
                    turn, q, q_up = 0.0, 0.0, 0.0
                    for m in range(count):
                        turn += weight[m] * current[m, PARAMETER]
                        q += weight[m] * current[m, NOISE]
                        q_up += weight[m] * current[m, NOISE_UP]
                    if step == first + 1:
                        # The expected model has no rate of its own yet: the group's mean.
                        share = 1.0 - weight[count - 1]
                        turn, q, q_up = turn / share, q / share, q_up / share
                    current[count - 1, 0], current[count - 1, PARAMETER] = 1.0, turn
                    current[count - 1, NOISE], current[count - 1, NOISE_UP] = q, q_up
                    fill(current, count - 1, dt, up, transition, noise, like, axes)
                mix(x, p, weight, change, like, count, mixed, mixed_spread, prior, score)
                d2, density = take_in(
                    x, p, prior, transition, noise, z, r, row, step, like, axes, count, mixed, mixed_spread, ahead, work, gain,
                    score, weight,
                )  # fmt: skip
                nis[row, step], likelihood[row, step] = d2, density
                s = 0.0
                for m in range(count):
                    s += weight[m] * current[m, PARAMETER] if current[m, 0] == 1.0 else 0.0
                rate[row, step] = s
            else:
                for m in range(group):
                    for h in range(4):
                        current[m, h] = fan[centre - half + m, h]
                if expected:
                    for h in range(4):
                        current[count - 1, h] = 0.0
                last = -1.0
            combine(x, p, weight, like, count, one)
            for i in range(d):
                mean[row, step, i] = one[i]
            for m in range(count):
                probability[row, step, m] = weight[m]
            if keep:
                combined_spread(x, p, weight, one, like, count, one_spread)
                for i in range(d):
                    for j in range(d):
                        covariance[row, step, i, j] = one_spread[i, j]
            if group < fan.shape[0] and step > first and measured(z, row, step, axes):
                new = (1.0 - stay) / count
                centre = regroup(
                    x, p, weight, score, centre, fan.shape[0], like, count, group, new, one, one_spread
                )  # fmt: skip
            if kept_mean.shape[0] > 0:
                for m in range(count):
                    kept_probability[row, step, m] = weight[m]
                    for h in range(4):
                        kept_models[row, step, m, h] = current[m, h]
                    for i in range(count):
                        kept_change[step, m, i] = change[m, i]
                    for i in range(d):
                        kept_mean[row, step, m, i] = x[m, i]
                        for j in range(d):
                            kept_covariance[row, step, m, i, j] = p[m, i, j]


def imm_filter(
    z: FloatArray,
    r: FloatArray,
    time_s: FloatArray,
    method: Imm | ExpectedMode,
    start: tuple[FloatArray, FloatArray],
    *,
    first: int = 0,
    covariances: bool = True,
    keep: bool = False,
) -> Mixed:
    """Interacting models over positions `z` (n, K, k) with covariances `r` (n, K, k, k) at `time_s` (K,).

    Arguments as for `kalman.kalman_filter`.  `probability` has one column a model; for `ExpectedMode` one a slot of the group, in
    order of the rates, and the expected mode last.  `keep` keeps each model's states.  Raises SettingsError for settings, shapes,
    times or covariances that make no sense.
    """
    fan, group, expected, motions = _settings(method)
    count = group + expected
    given, begin = np.zeros((0, 0)), np.full(count, 1.0 / count)
    if isinstance(method, Imm):
        _, _, given, begin = changes(method)
    axes = z.shape[-1] if np.ndim(z) == 3 else 3
    z, r, time_s, x, p = check(z, r, time_s, start, first, size(motions, axes))
    n, steps, k = z.shape
    d = x.shape[1]
    out = Mixed(
        time_s,
        np.full((n, steps, d), np.nan),
        np.full((n, steps, d, d) if covariances else (0, 0, 0, 0), np.nan),
        np.full((n, steps), np.nan),
        np.full((n, steps), np.nan),
        np.full((n, steps, count), np.nan),
        np.full((n, steps), np.nan),
    )
    kept = _room(n, steps, count, d) if keep else _room(0, 0, 0, 0)

    def piece(rows: slice) -> None:
        _run(
            z[rows], r[rows], time_s, fan, group, expected, method.stay, method.stay_s, given, x[rows], p[rows], begin, first,
            (0,) * d, (0,) * k, count,
            out.mean[rows], out.covariance[rows] if covariances else out.covariance, out.nis[rows], out.likelihood[rows],
            out.probability[rows], out.rate_rad_s[rows],
            kept.mean[rows], kept.covariance[rows], kept.probability[rows], kept.models[rows], kept.change,
        )  # fmt: skip

    in_threads(piece, slices(n, _ROWS))
    return out._replace(kept=kept) if keep else out


def _room(n: int, steps: int, count: int, d: int) -> Kept:
    return Kept(
        np.full((n, steps, count, d), np.nan),
        np.full((n, steps, count, d, d), np.nan),
        np.full((n, steps, count), np.nan),
        np.full((n, steps, count, 4), np.nan),
        np.full((steps, count, count), np.nan),
    )


def _settings(method: Imm | ExpectedMode) -> tuple[FloatArray, int, bool, Sequence[Motion]]:
    """All models (F, 4), how many are in use, whether with an expected mode, and the models as values."""
    if not 0 < method.stay < 1 or not method.stay_s > 0:
        raise SettingsError(
            f"stay = {method.stay} over {method.stay_s} s makes no sense",
            where="imm",
            remedy="A probability, over a positive time.",
        )
    if isinstance(method, Imm):
        return table(method.models), len(method.models), False, method.models
    rates = method.rates_deg_s
    if method.group % 2 != 1 or not 1 <= method.group <= len(rates):
        raise SettingsError(
            f"a group of {method.group} of {len(rates)} rates makes no sense",
            where="ema-imm",
            remedy="Give an odd number, at most all.",
        )
    if any(b <= a for a, b in itertools.pairwise(rates)):
        raise SettingsError("rates_deg_s must grow", where="ema-imm", remedy="Sort them, each once.")
    turns = tuple(CoordinatedTurn(rate_deg_s=w, noise=method.noise, noise_up=method.noise_up) for w in rates)
    return table(turns), method.group, method.expected, turns


def changes(method: Imm) -> tuple[float, float, FloatArray, FloatArray]:
    """The chance to stay and its time, the transition (M, M) or (0, 0) for none, and the models' chances at the start (M,).

    Raises SettingsError for settings that make no sense.
    """
    _settings(method)
    count = len(method.models)
    given = np.zeros((0, 0)) if method.transition is None else _chances(method.transition, count)
    begin = np.full(count, 1.0 / count) if method.start is None else _chances((method.start,), count)[0]
    return method.stay, method.stay_s, given, begin


def _chances(rows: Sequence[Sequence[float]], count: int) -> FloatArray:
    """Rows of probabilities (n, count); raises SettingsError where they are none."""
    if any(len(row) != count for row in rows):
        raise SettingsError(f"probabilities for {count} models are needed", where="imm", remedy=f"Give {count} numbers a row.")
    out = np.array(rows, np.float64)
    if (out < 0).any() or not np.allclose(out.sum(axis=1), 1.0, atol=1e-9):
        raise SettingsError("probabilities must be 0 or more and sum to 1", where="imm", remedy="Scale each row to the sum 1.")
    if len(rows) > 1 and len(rows) != count:
        raise SettingsError(f"a transition of {count} models needs {count} rows", where="imm", remedy="Rows: from; columns: to.")
    return out
