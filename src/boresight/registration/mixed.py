"""A linear model whose errors are alike within a target: variance components, generalised least squares, honest covariance.

The residuals of one sensor are ``r = X b + Z0 u0 + Z1 u1 + Z2 u2 + e``.  `b` are the terms (p).  `u2` belongs to one target for
good (transponder delay, latency, position offset of its receiver); `u1` and `u0` wander, and are taken as constant over a
long and a short block of time; `e` is independent noise with the variance of its channel.  A thousand plots of one target
share its `u2`, so they say little more about a range bias than one plot does: least squares that ignores this reports sd that are
several times too small.

Everything works on cross products by channel and short block, which cost one pass over the plots; what follows does not depend
on the number of plots.  Sources: Laird & Ware 1982 (the model), Harville 1977 (restricted likelihood by fixed-point steps),
Bell & McCaffrey 2002 (bias-reduced sandwich), Ledoit & Wolf 2004 (shrinkage); METHODS section 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._types import FloatArray, IntArray

# How many targets the guessed variances of effects count for where there is one target; nothing from `_ENOUGH_TARGETS` on.
_GUESS_TARGETS = 0.3
_ENOUGH_TARGETS = 12
# How many plots the guessed noise counts for.
_GUESS_PLOTS = 0.1
# How many targets the model's own scale counts for.
_SCALE_TARGETS = 3.0


class Level(NamedTuple):
    """One level of random effects.

    `group` (w,) numbers the variance component of each of its w columns.  `first` (n,) is the first group of the level below in
    each of the n groups of this level (below the lowest level: the cross products themselves, one each).
    """

    group: IntArray
    first: IntArray


class Products(NamedTuple):
    """Cross products of the columns ``[Z0 | Z1 | Z2 | X | r]`` (width c) of one sensor.

    `channel` (2 or 3, B, c, c) holds ``M' diag(w) M`` for each channel (range, azimuth, elevation) and short block, `plots`
    (2 or 3,) the sum of the weights, times their target's trust; `levels` goes from short blocks to targets; `terms` is p.
    `trust` (G,) is how much each target counts, 0 … 1: the power of its likelihood.
    """

    channel: FloatArray
    plots: FloatArray
    levels: tuple[Level, ...]
    terms: int
    trust: FloatArray


class Variances(NamedTuple):
    """Variance components: `noise` of each channel, and those of the groups of each level."""

    noise: FloatArray
    effects: tuple[FloatArray, ...]


class Reduced(NamedTuple):
    """What is left of each target once its effects are integrated out; targets of several batches are simply stacked.

    `terms` (G, p + 1, p + 1) is ``[X r]' V^-1 [X r]``; `effects` (G, w, w + p + 1) is ``Z' V^-1 [Z X r]`` of the targets' own
    effects.  Neither holds the targets' trust yet.
    """

    terms: FloatArray
    effects: FloatArray


class Solution(NamedTuple):
    """A generalised least squares step (p,), and its covariance (p, p) under the model, with the prior."""

    value: FloatArray
    covariance: FloatArray


def reduce(products: Products, variances: Variances) -> Reduced:
    """Integrate the effects out of the cross products."""
    _, s, score = _upwards(products, variances, keep=False)
    return Reduced(s, score)


def solve(reduced: FloatArray, prior: FloatArray, at: FloatArray) -> Solution:
    """Generalised least squares over targets `reduced` (G, p + 1, p + 1), linearised at the value `at` (p,).

    `prior` is the ridge about zero: inverse variances (p,), or an inverse covariance (p, p).  The step starts from `at`.
    """
    p, prior = len(prior), ridge(prior)
    total = reduced.sum(axis=0)
    covariance = np.linalg.inv(total[:p, :p] + prior)
    covariance = (covariance + covariance.T) / 2
    return Solution(covariance @ (total[:p, p] - prior @ at), covariance)


def ridge(prior: FloatArray) -> FloatArray:
    """The inverse covariance (p, p) of a prior, given as such or by inverse variances (p,)."""
    return np.diag(prior) if prior.ndim == 1 else prior


def estimate(
    products: Products,
    start: Variances,
    prior: FloatArray,
    at: FloatArray,
    guess: Variances,
    *,
    steps: int,
    tolerance: float = 3e-3,
) -> Variances:
    """Variance components by restricted maximum likelihood, in multiplicative steps, which keep them positive.

    `guess` weighs like a fraction of one target, and less with every target more: it decides only where there is next to
    nothing to learn from.
    """
    variances = start
    typical = np.sqrt(np.concatenate([guess.noise, *guess.effects]))
    for _ in range(steps):
        new = _improve(products, variances, prior, at, guess)
        before, after = (np.sqrt(np.concatenate([v.noise, *v.effects])) for v in (variances, new))
        variances = new
        # What is on its way to nothing gets there ever more slowly, and need not.
        if np.all(np.abs(after - before) <= tolerance * np.maximum(after, 0.1 * typical)):
            break
    return variances


def _shrunk_solve(s: FloatArray, d: FloatArray, y: FloatArray) -> FloatArray:
    """``(D^-1 + S)^-1 Y`` for a stack of S and a diagonal D that may hold zeros."""
    root = np.sqrt(d)
    left = root[:, None] * s * root
    left[:, np.arange(len(d)), np.arange(len(d))] += 1.0
    result: FloatArray = root[:, None] * np.linalg.solve(left, root[:, None] * y)
    return result


class _Rung(NamedTuple):
    """What eliminating one level leaves behind: ``K Z' V^-1 [Z | rest]``, ``Z' V^-1 [Z | rest]``, K, and the parent of each
    group."""

    gain: FloatArray
    score: FloatArray
    kernel: FloatArray
    parent: IntArray


def _upwards(products: Products, variances: Variances, *, keep: bool) -> tuple[list[_Rung], FloatArray, FloatArray]:
    """Eliminate the effects of one level after the other; returns the rungs, the targets' rest and the top level's score."""
    s = np.einsum("k,kbij->bij", 1.0 / variances.noise[: len(products.channel)], products.channel)
    rungs: list[_Rung] = []
    score = s
    for number, level in enumerate(products.levels):
        w = len(level.group)
        if number:
            s = np.add.reduceat(s, level.first, axis=0)
        last = number == len(products.levels) - 1
        d = variances.effects[number][level.group]
        wide = s.shape[2]
        right = s[:, :w, :]
        if keep:
            right = np.concatenate([right, np.broadcast_to(np.eye(w), (len(s), w, w))], axis=2)
        solved = _shrunk_solve(s[:, :w, :w], d, right)
        gain = solved[:, :, :wide]
        if keep or last:
            score = s[:, :w, :] - s[:, :w, :w] @ gain
        if keep:
            kernel = solved[:, :, wide:]
            above = np.zeros(len(s), np.int64) if last else products.levels[number + 1].first
            parent = np.repeat(np.arange(len(above)), np.diff(np.append(above, len(s))))
            rungs.append(_Rung(gain, score, kernel, parent))
        s = s[:, w:, w:] - np.swapaxes(s[:, :w, w:], 1, 2) @ gain[:, :, w:]
    return rungs, s, score


def _improve(products: Products, variances: Variances, prior: FloatArray, at: FloatArray, guess: Variances) -> Variances:
    """One step of the variance components."""
    p, levels = products.terms, products.levels
    rungs, reduced, _ = _upwards(products, variances, keep=True)
    value, covariance = solve(reduced * products.trust[:, None, None], prior, at)
    # What each group of each level counts: as much as its target.
    counts = [products.trust]
    for rung in reversed(rungs[:-1]):
        counts.insert(0, counts[0][rung.parent])
    belief = _GUESS_TARGETS * max(0.0, 1.0 - (len(reduced) - 1) / _ENOUGH_TARGETS)

    # Effects: what the residuals hold of each over what the model expects.
    new_effects = []
    for number, level in enumerate(levels):
        w = len(level.group)
        score = rungs[number].score
        own, score = np.einsum("bii->bi", score[:, :, :w]).copy(), score[:, :, w:]
        index = np.arange(len(score))
        for higher in range(number + 1, len(levels)):
            index = rungs[higher - 1].parent[index]
            w2 = len(levels[higher].group)
            cross = score[:, :, :w2]
            own -= ((cross @ rungs[higher].kernel[index]) * cross).sum(axis=2)
            score = score[:, :, w2:] - cross @ rungs[higher].gain[index][:, :, w2:]
        x = score[:, :, :p]
        up = counts[number] @ (score[:, :, p] - x @ value) ** 2
        down = counts[number] @ (own - ((x @ covariance) * x).sum(axis=2))
        old, typical = variances.effects[number], guess.effects[number]
        old = np.maximum(old, 1e-12 * typical)
        more, less = belief * typical / old**2, belief / old
        down = np.maximum(np.bincount(level.group, down, len(old)), 1e-12 / old)
        ratio = (np.bincount(level.group, up, len(old)) + more) / (down + less)
        new_effects.append(old * np.clip(ratio, 0.1, 10.0))

    # Downwards: predict the effects, and how uncertain each prediction is.
    tail = np.concatenate([np.tile(-value, (len(reduced), 1)), np.ones((len(reduced), 1))], axis=1)
    inner = np.broadcast_to(covariance, (len(reduced), p, p))
    for number in reversed(range(len(levels))):
        rung = rungs[number]
        if number < len(levels) - 1:
            tail, inner = tail[rung.parent], inner[rung.parent]
        w = len(levels[number].group)
        into = rung.gain[:, :, w:]
        tail = np.concatenate([-(into @ tail[:, :, None])[:, :, 0], tail], axis=1)
        into = into[:, :, :-1]
        rest = into.shape[2]
        spread = np.empty((len(inner), w + rest, w + rest))
        cross = into @ inner
        spread[:, :w, :w] = rung.kernel + cross @ np.swapaxes(into, 1, 2)
        spread[:, :w, w:] = -cross
        spread[:, w:, :w] = -np.swapaxes(cross, 1, 2)
        spread[:, w:, w:] = inner
        inner = spread

    # Noise: squares of what is left over the plots less the effective number of parameters.
    noise = variances.noise.copy()
    for k, m in enumerate(products.channel):
        squares = float(counts[0] @ ((m @ tail[:, :, None])[:, :, 0] * tail).sum(axis=1))
        used = float(counts[0] @ (inner * m[:, :-1, :-1]).sum(axis=(1, 2))) / float(variances.noise[k])
        left = max(products.plots[k] - used, 0.05 * products.plots[k])
        noise[k] = (max(squares, 0.0) + _GUESS_PLOTS * guess.noise[k]) / (left + _GUESS_PLOTS)
    return Variances(noise, tuple(new_effects))


class Scores(NamedTuple):
    """The targets' normal equations of any weighted least squares, and what the model expects of them.

    `terms` (G, p + 1, p + 1) is ``[X r]' W [X r]``, `meat` (G, p, p) the model's covariance of ``X' W (r - X b)``.  Where the
    weights are the inverse of the model's covariance, the meat is ``X' W X`` itself.
    """

    terms: FloatArray
    meat: FloatArray


def plain_scores(products: Products, noise_meat: FloatArray, variances: Variances) -> Scores:
    """The scores of least squares with the plots' own weights.

    `noise_meat` (B, p, p) is what the noise adds to the meat in each short block: ``X' W N W X``, N the noise's variances.
    """
    p = products.terms
    widths = [len(level.group) for level in products.levels]
    x = slice(sum(widths), sum(widths) + p)
    total, meat = products.channel.sum(axis=0), noise_meat
    for number, level in enumerate(products.levels):
        if number:
            total, meat = np.add.reduceat(total, level.first, axis=0), np.add.reduceat(meat, level.first, axis=0)
        begin = sum(widths[:number])
        cross = total[:, x, begin : begin + widths[number]]
        meat = meat + (cross * variances.effects[number][level.group]) @ np.swapaxes(cross, 1, 2)
    xr = slice(x.start, x.stop + 1)
    return Scores(total[:, xr, xr], meat)


def influence(products: Products) -> FloatArray:
    """``Z' W X`` (G, w, p) of the targets' own effects, of products as `plain_scores` takes them."""
    total = products.channel.sum(axis=0)
    for level in products.levels[1:]:
        total = np.add.reduceat(total, level.first, axis=0)
    widths = [len(level.group) for level in products.levels]
    begin = sum(widths[:-1])
    result: FloatArray = total[:, begin : begin + widths[-1], sum(widths) : sum(widths) + products.terms]
    return result


class Honest(NamedTuple):
    """Covariances (p, p): what the model expects, and what the targets' scatter supports.

    `bread` (p, p) is the inverse of the information, `scale` how much more the targets scatter than the model expects,
    `targets` the effective number of targets, `sandwich` (p, p) the clustered covariance with its bias removed.
    """

    model: FloatArray
    covariance: FloatArray
    sandwich: FloatArray
    bread: FloatArray
    scale: float
    targets: float


def honest_covariance(scores: Scores, prior: FloatArray, step: FloatArray) -> Honest:
    """The covariance of a weighted least squares that is true where the model is, and follows the targets where it is not.

    The model's covariance has few parameters, so it is steady, but it trusts the model; the sandwich clustered by target trusts
    nothing, but with 30 targets and 6 terms it is itself so uncertain that its NEES/dof is 1.5 where 1 is true (Hotelling).  So
    the sandwich's meat, in coordinates in which the model expects the identity, is shrunk: its trace gives one scale, and its
    shape is followed as far as it differs from a multiple of the identity by more than chance (Ledoit and Wolf 2004).
    `benchmarks/truthfulness.py` has the figures of all the candidates.
    """
    p, prior = len(prior), ridge(prior)
    a = scores.terms[:, :p, :p]
    bread = np.linalg.inv(a.sum(axis=0) + prior)
    bread = (bread + bread.T) / 2
    meat = scores.meat.sum(axis=0) + prior
    model = bread @ meat @ bread
    root = np.linalg.cholesky((model + model.T) / 2)
    # Into coordinates in which the estimate's covariance under the model is the identity.
    into = np.linalg.solve(root, bread)
    off = (scores.terms[:, :p, p] - a @ step) @ into.T
    # The residuals are those at the estimate: what each target pulled it by is missing from its own score.
    hat = a @ bread
    pulled = hat @ scores.meat
    expected = scores.meat - pulled - np.swapaxes(pulled, 1, 2) + hat @ meat @ np.swapaxes(hat, 1, 2)
    expected = into @ expected @ into.T
    shares = into @ scores.meat @ into.T
    share = np.einsum("gii->g", shares)
    targets = float(share.sum() ** 2 / max((share**2).sum(), 1e-300))
    whole = expected.sum(axis=0)
    size, axes = np.linalg.eigh((whole + whole.T) / 2)
    # Where one target alone carries a direction there is no residual: the model speaks for it.
    grow = (axes / np.sqrt(np.clip(size, 0.05, None))) @ axes.T
    off, expected = off @ grow, grow @ expected @ grow
    found = off.T @ off
    whole = expected.sum(axis=0)
    scale = float(np.trace(found) / max(np.trace(whole), 1e-9 * p))
    scale = (targets * scale + _SCALE_TARGETS) / (targets + _SCALE_TARGETS)
    found = found + scale * (np.eye(p) - whole)
    chance = scale**2 * float((share**2).sum() + (shares**2).sum())
    apart = float(((found - scale * np.eye(p)) ** 2).sum())
    follow = max(0.0, 1.0 - chance / apart) if apart > 0 else 0.0
    shape = (1 - follow) * scale * np.eye(p) + follow * found
    # The components were estimated from so many targets: errors over their sd follow a t distribution, whose variance this is.
    freedom = max(targets - 1.0, 3.0)
    covariance = root @ shape @ root.T * freedom / (freedom - 2.0)
    return Honest(model, (covariance + covariance.T) / 2, root @ found @ root.T, bread, scale, targets)
