"""Which terms a model needs, and what to do with each: search by held-out targets, verdicts, the error budget.

Everything here is done on the targets' normal equations, of which a model's are a part: a thousand models cost no more than one
pass over the plots.  Whatever is judged is judged on targets that did not take part in estimating it.

Sources: Breiman, Friedman, Olshen & Stone 1984 (the rule of one standard error), Chen & Chen 2008 (BIC for many candidates),
Buckland, Burnham & Augustin 1997 (uncertainty of the choice), Efron & Tibshirani 1993 (jackknife); METHODS section 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .._parallel import in_threads, slices
from .._types import FloatArray, IntArray
from ..calibration import Choice, Decision, Share, Verdict
from ..terms import CHANNELS, Term, precision, table_of, term_of, touches
from . import mixed
from .least_squares import GROUND_KINDS, Dropped, Fit, LeastSquares, Searched, folds, grams, pair_check, rank_check
from .observe import CHUNK, Observed, look, take, whose

# Never dropped by selection.
CORE = ("range_bias", "azimuth_bias", "elevation_bias", "time_offset")
# The extent of targets on the ground: exactly one of these stays.
EXTENTS = ("along_heading_per_length", "along_heading")
# Terms that come and go together: the phase of a harmonic and the direction of a tilt are not ours to choose.
_TOGETHER = (
    ("range_gain",), ("range_refraction",), ("azimuth_cos", "azimuth_sin"), ("azimuth_cos2", "azimuth_sin2"),
    ("tilt_north", "tilt_east"), ("nonorthogonality",), ("collimation",), ("elevation_sag",), ("elevation_refraction",),
    ("clock_drift",), ("range_lag",), ("azimuth_lag",), ("elevation_lag",), ("site_east", "site_north"), ("site_up",),
)  # fmt: skip
_POLAR = ("range_bias", "azimuth_bias", "elevation_bias")
# Terms that say the same in other words: at most one of each is in a model.
_RIVALS = (("range_gain", "range_refraction"),)
# The chance that a search adds anything at all to a model that lacks nothing.
_FALSE_ALARM = 0.02
# How much each term that is nothing adds to the loss on held-out targets: 1, and 1 / 0.8 for four folds of training.
_CV_COST = 2.25
_FEWEST_TARGETS = 5
_ENOUGH_TARGETS = 10
_MOST_STEPS = 30
# The least share of the plots of a channel that may have errors of its own.
_CHANNEL_SHARE = 0.05
# A term that is zero looks like none by this chance only.
_BEYOND_DOUBT = 0.001
# Plots that verdicts and budget are made of.
_PLOTS = 150_000


def candidates(seen: Observed) -> tuple[Term, ...]:
    """The terms that a search may add to the model of what the sensor saw; their needs are not looked at.

    Tables, jerks, rotations and the transponders' common delay are fitted where they are asked for by name: the first are not
    one error, the second drown in the reference's noise, the others are aliases.
    """
    names = [name for group in _TOGETHER for name in group]
    if seen.sensor.kind in GROUND_KINDS:
        names = [*EXTENTS, *names]
    owner = whose(seen, slice(None))
    # Of the channels and of the chains the commonest has the terms of all; the others may differ from it.
    for family in (tuple(c for c in CHANNELS if not c.startswith("chain")), tuple(c for c in CHANNELS if c.startswith("chain"))):
        share = {channel: float(np.mean(touches(channel, owner))) for channel in family}
        present = sorted((c for c in share if share[c] >= _CHANNEL_SHARE), key=lambda c: -share[c])
        names += [f"{base}@{channel}" for channel in present[1:] for base in ("range_bias", "azimuth_bias")]
    return tuple(map(term_of, names))


def units(terms: Sequence[Term]) -> list[tuple[int, ...]]:
    """The numbers of the terms, those that come and go together in one tuple."""
    key: dict[str, list[int]] = {}
    for k, term in enumerate(terms):
        group = table_of(term) or next((g[0] for g in _TOGETHER if term.base in g), term.base)
        key.setdefault(f"{group}@{term.channel}", []).append(k)
    return [tuple(members) for members in key.values()]


class _Scored(NamedTuple):
    """A model's loss on each target (G,) that took no part in its estimate (BIC: that did), its values and covariance."""

    loss: FloatArray
    value: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class _Bench:
    """The targets' normal equations and what a search needs to judge a model by them."""

    normal: FloatArray
    wide: tuple[Term, ...]
    fold: IntArray
    scale: float
    targets: float
    rivals: int
    settings: LeastSquares

    @property
    def by_bic(self) -> bool:
        return self.settings.criterion == "bic"

    def score(self, members: Sequence[int]) -> _Scored:
        normal = part(self.normal, members)
        prior = precision([self.wide[k] for k in members])
        value, covariance = _solve(normal, prior)
        held = np.tile(value, (len(normal), 1)) if self.by_bic else held_out(normal, prior, self.fold)
        return _Scored(misfit(normal, held), value, covariance)

    def criterion(self, scored: _Scored) -> float:
        """Smaller is better."""
        loss = float(scored.loss.sum())
        return loss / self.scale + len(scored.value) * self._price() if self.by_bic else loss

    def _price(self) -> float:
        """What a term costs by BIC: the targets are the sample, and each of the rivals might have been taken (extended BIC)."""
        return float(np.log(max(self.targets, 2.0)) + 2 * np.log(max(self.rivals, 1)))

    def gain(self, without: _Scored, with_: _Scored, width: int) -> tuple[float, float, bool]:
        """How much the loss falls by a unit of `width` terms, its standard error over targets, and whether that is enough."""
        apart = without.loss - with_.loss
        total = float(apart.sum())
        count = int((np.abs(apart) > 0).sum())
        sd = float(np.sqrt(count / max(count - 1, 1) * ((apart - total / max(count, 1))[np.abs(apart) > 0] ** 2).sum()))
        if self.by_bic:
            n = max(self.targets, 2.0)
            # The scale is estimated too: the likelihood of the t distribution.
            better = n * float(np.log1p(max(total, 0.0) / self.scale / n)) - width * self._price()
            return better, float("nan"), better > 0
        # A gain that a few targets make is known as well as few targets tell.
        squares = float((apart**2).sum())
        targets = min(self.targets, 1.5 * float(np.abs(apart).sum()) ** 2 / squares) if squares > 0 else 0.0
        return total, sd, total > self.errors(width, targets) * sd

    def errors(self, width: int, targets: float) -> float:
        """How many standard errors a gain must have that so many targets tell of.

        One standard error is the test ``z^2 - 2.25 > 2 z`` of a single term, that is z > 2.8, with a false alarm of half a per
        cent; with many candidates and few targets more are needed for the same safety of the whole search.
        """
        from scipy.special import fdtri

        bound = width * float(fdtri(width, max(targets - 1.0, 2.0), 1 - _FALSE_ALARM / max(self.rivals, 1)))
        return max(1.0, (bound - _CV_COST * width) / (2 * float(np.sqrt(bound))))

    def separable(self, members: Sequence[int]) -> str:
        """Why the model cannot be told apart by these targets; "" where it can."""
        terms = [self.wide[k] for k in members]
        p = len(members)
        total = part(self.normal, members)[:, :p, :p].sum(axis=0)
        size = np.array([t.prior_sd for t in terms])
        bad = rank_check(total / size[:, None] / size, terms, self.settings)
        if bad is None:
            root = np.sqrt(np.maximum(np.diag(total), 1e-300))
            unit = np.linalg.pinv(total / root[:, None] / root, rcond=1e-12, hermitian=True)
            bad = pair_check(unit / root[:, None] / root, terms, self.settings)
        return "" if bad is None else bad.why


def part(normal: FloatArray, members: Sequence[int]) -> FloatArray:
    """The normal equations of some of the terms."""
    index = np.array([*members, normal.shape[2] - 1])
    return normal[:, index[:, None], index]


def _solve(normal: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (p,) and their covariance (p, p), with the prior's inverse covariance (p, p)."""
    total, p = normal.sum(axis=0), len(prior)
    covariance = np.linalg.inv(total[:p, :p] + prior)
    return covariance @ total[:p, p], (covariance + covariance.T) / 2


def held_out(normal: FloatArray, prior: FloatArray, fold: IntArray) -> FloatArray:
    """The values (G, p) found without the fold of each target, in units of the terms' prior sd."""
    p = normal.shape[2] - 1
    out = np.zeros((len(normal), p))
    total = normal.sum(axis=0)
    for k in np.unique(fold):
        mine = fold == k
        rest = total - normal[mine].sum(axis=0)
        out[mine] = np.linalg.solve(rest[:p, :p] + prior, rest[:p, p])
    return out


def misfit(normal: FloatArray, value: FloatArray) -> FloatArray:
    """The weighted squares (G,) that are left of each target at its value (G, p)."""
    tail = np.concatenate([-value, np.ones((len(value), 1))], axis=1)
    result: FloatArray = np.einsum("gi,gij,gj->g", tail, normal, tail)
    return result


def search(
    normal: FloatArray,
    wide: tuple[Term, ...],
    chosen: tuple[Term, ...],
    first: bool,
    *,
    likely: frozenset[str],
    settings: LeastSquares,
) -> Searched:
    """The model, from the targets' normal equations (G, q + 1, q + 1) of the `wide` one, beginning with the terms `chosen`.

    Units of terms are dropped and added one at a time, the worst and the best first, until each that is in lowers the loss on
    held-out targets by more than chance, and none that is out does.  The extents of ground targets compete with each other.
    `likely` names the terms that sensors of this kind mostly have: left out, they leave more doubt than others.
    """
    names = [t.name for t in wide]
    size = normal[:, -1, -1]
    alive = size > 1e-4 * np.median(size) if len(size) else np.zeros(0, bool)
    normal = normal[alive]
    inside = [k for k in range(len(chosen))]
    core = {k for k, term in enumerate(wide) if term.name in CORE or term.is_nuisance}
    extents = [k for k, name in enumerate(names) if name in EXTENTS]
    free = [u for u in units(wide) if not set(u) & core and not set(u) & set(extents)]
    if len(normal) < _FEWEST_TARGETS:
        why = f"{_targets(len(normal))} cannot show it: at least {_FEWEST_TARGETS} are needed to hold some out"
        left = [u for u in free if set(u) <= set(inside)]
        out = [k for k in inside if not any(k in u for u in left)]
        skipped = [Choice(action="not tested", term=_name(wide, u), criterion=float("nan"), why=why) for u in left]
        return Searched(tuple(wide[k] for k in out), tuple(skipped), (), np.zeros((len(out), len(out))))
    bench = _bench(normal, wide, inside, len(free), settings)
    now = bench.score(inside)
    steps: list[Choice] = []
    if first:
        steps.append(Choice(action="start", term=_name(wide, inside), criterion=bench.criterion(now)))

    def step(action: str, unit: Sequence[int], change: float, sd: float, why: str) -> None:
        steps.append(
            Choice(
                action=action, term=_name(wide, unit), criterion=bench.criterion(now), change=change, change_sd=sd, why=why
            )
        )  # fmt: skip

    seen_models = {frozenset(inside)}
    while len(steps) < _MOST_STEPS:
        rival = _better_extent(bench, inside, extents, now)
        if rival is not None:
            inside, after, (new, old) = rival
            change, sd = _change(now, after)
            now = after
            step("replace", (old, new), change, sd, f"held-out targets fit better with {names[new]}")
            if frozenset(inside) in seen_models:
                break
            seen_models.add(frozenset(inside))
        weak = []
        for unit in free:
            if set(unit) <= set(inside):
                rest = [k for k in inside if k not in unit]
                scored = bench.score(rest)
                gain, sd, enough = bench.gain(scored, now, len(unit))
                if not enough:
                    weak.append((gain / sd if sd > 0 else gain, rest, scored, unit, gain, sd))
        if weak:
            _, inside, now, unit, gain, sd = min(weak, key=lambda w: w[0])
            step("drop", unit, gain, sd, _not_enough(bench, len(unit), gain, sd))
            seen_models.add(frozenset(inside))
            continue
        strong = [o for o in _outside(bench, inside, free, now) if o.enough and frozenset(o.members) not in seen_models]
        if not strong:
            break
        best = max(strong, key=lambda o: o.gain / o.sd if o.sd > 0 else o.gain)
        assert best.scored is not None
        inside, now = list(best.members), best.scored
        step("add", best.unit, -best.gain, best.sd, _enough(bench, len(best.unit), best.gain, best.sd))
        seen_models.add(frozenset(inside))
    left_out, doubt = [], np.zeros((len(inside), len(inside)))
    for o in _outside(bench, inside, free, now):
        why = o.why or _not_enough(bench, len(o.unit), o.gain, o.sd)
        left_out.append(
            Choice(
                action="leave out", term=_name(wide, o.unit), criterion=bench.criterion(o.scored) if o.scored else float("nan"),
                change=-o.gain, change_sd=o.sd, why=why,
            )
        )  # fmt: skip
        if o.scored is not None:
            doubt += _doubt(bench, now, o, inside, likely)
    if any(k in inside for k in extents):
        kept = [k for k in inside if k not in extents]
        none = bench.score(kept)
        change, sd = _change(now, none)
        left_out.append(
            Choice(
                action="leave out", term="no extent", criterion=bench.criterion(none), change=change, change_sd=sd,
                why="an extent of the targets always stays: without it time takes its place",
            )
        )  # fmt: skip
    return Searched(tuple(wide[k] for k in inside), tuple(steps), tuple(left_out), doubt)


def _bench(normal: FloatArray, wide: tuple[Term, ...], inside: Sequence[int], rivals: int, settings: LeastSquares) -> _Bench:
    own = part(normal, inside)
    p = len(inside)
    value = _solve(own, np.eye(p))[0]
    honest = mixed.honest_covariance(mixed.Scores(own, own[:, :p, :p]), np.ones(p), value)
    # The targets' own weights tell which of them are alike in size.
    fold = folds(np.einsum("gii->g", own[:, :p, :p]))
    return _Bench(normal, wide, fold, honest.scale, honest.targets, rivals, settings)


class _Outside(NamedTuple):
    """A unit that is not in the model, and the model with it (None: `why` not)."""

    unit: tuple[int, ...]
    members: tuple[int, ...]
    scored: _Scored | None
    gain: float
    sd: float
    enough: bool
    why: str


def _outside(bench: _Bench, inside: Sequence[int], free: Sequence[tuple[int, ...]], now: _Scored) -> list[_Outside]:
    found = []
    bases = {bench.wide[k].name for k in inside}
    for unit in free:
        if set(unit) & set(inside):
            continue
        members = tuple(sorted([*inside, *unit]))
        names = {bench.wide[k].name for k in unit}
        rival = next((r for pair in _RIVALS for r in pair if names & set(pair) and r in bases - names), "")
        why = f"{rival} is in the model, and says the same" if rival else bench.separable(members)
        if why:
            found.append(_Outside(unit, members, None, float("nan"), float("nan"), False, why))
        else:
            scored = bench.score(members)
            found.append(_Outside(unit, members, scored, *bench.gain(now, scored, len(unit)), ""))
    return found


def _better_extent(
    bench: _Bench, inside: list[int], extents: Sequence[int], now: _Scored
) -> tuple[list[int], _Scored, tuple[int, int]] | None:
    """The model with the other extent, where that fits held-out targets better: members, score, and which took whose place."""
    mine = [k for k in inside if k in extents]
    others = [k for k in extents if k not in inside]
    if len(mine) != 1 or not others:
        return None
    members = sorted([*(k for k in inside if k not in extents), others[0]])
    if bench.separable(members):
        return None
    scored = bench.score(members)
    return (members, scored, (others[0], mine[0])) if scored.loss.sum() < now.loss.sum() else None


def _change(before: _Scored, after: _Scored) -> tuple[float, float]:
    apart = after.loss - before.loss
    return float(apart.sum()), float(np.sqrt(len(apart)) * apart.std(ddof=1)) if len(apart) > 1 else float("nan")


def _doubt(bench: _Bench, now: _Scored, other: _Outside, inside: Sequence[int], likely: frozenset[str]) -> FloatArray:
    """What not knowing whether a unit belongs to the model adds to the covariance (p, p) of the values.

    By the law of total variance, with the probability of the model that has it from its BIC (the many that are not `likely`
    share one chance): the mean change of the covariance and the square of the change of the values.
    """
    assert other.scored is not None
    n = max(bench.targets, 2.0)
    normal = part(bench.normal, other.members)
    full = misfit(normal, np.tile(other.scored.value, (len(normal), 1))).sum()
    own = part(bench.normal, inside)
    better = float(misfit(own, np.tile(now.value, (len(own), 1))).sum() - full) / bench.scale
    expected = all(bench.wide[k].name in likely for k in other.unit)
    price = float(np.log(n) + (0.0 if expected else 2 * np.log(max(bench.rivals, 1))))
    odds = n * np.log1p(max(better, 0.0) / n) - len(other.unit) * price
    chance = float(1 / (1 + np.exp(-odds / 2)))
    place = [other.members.index(k) for k in inside]
    shift = other.scored.value[place] - now.value
    spread = (other.scored.covariance[np.ix_(place, place)] - now.covariance) * bench.scale
    return np.asarray(chance * (spread + np.outer(shift, shift)))


def _name(wide: Sequence[Term], members: Sequence[int]) -> str:
    return " + ".join(wide[k].name for k in members)


def _targets(n: int) -> str:
    return f"{n} target{'' if n == 1 else 's'}"


def _not_enough(bench: _Bench, width: int, gain: float, sd: float) -> str:
    if bench.by_bic:
        return "it is not worth its price by BIC"
    if gain <= 0:
        return "held-out targets fit no better with it"
    return f"held-out targets fit better with it by only {gain / sd:.1f} standard errors"


def _enough(bench: _Bench, width: int, gain: float, sd: float) -> str:
    if bench.by_bic:
        return "it is worth its price by BIC"
    return f"held-out targets fit better with it by {gain / sd:.1f} standard errors"


class _Metres(NamedTuple):
    """Errors in metres by target.

    `horizontal` and `vertical` (G, p + 1, p + 1) are cross products ``[X r]' w [X r]`` of the terms and the residuals about zero,
    each coordinate with its inverse variance; `sharpness` (G,) is half the sum of these over both horizontal ones, so that
    squares over it are those of a distance.  `plots` (G,) is the sum of the plots' weights alone.
    """

    horizontal: FloatArray
    vertical: FloatArray
    plots: FloatArray
    sharpness: FloatArray


def judge(
    seen: Observed, fitted: Fit, dropped: Sequence[Dropped], vertical_variance: FloatArray
) -> tuple[tuple[Verdict, ...], tuple[Share, ...]]:
    """What to do with each term, and where a plot's error comes from before correction.

    `dropped` are the terms that the data cannot give; `vertical_variance` (n,) is how uncertain the reference's height is
    (m^2).  Both are made of at most 150,000 plots, each with the weight that it has in the fit.
    """
    rows = np.arange(0, len(seen), -(-len(seen) // _PLOTS))
    some = take(seen, rows)
    weight, vertical = fitted.weight[rows], vertical_variance[rows]
    effects = tuple(dict.fromkeys(e.term for e in fitted.effects))
    names = [t.name for t in fitted.terms]
    p, count = len(names), len(fitted.normal)
    horizontal, upright = np.zeros((count, p + 1, p + 1)), np.zeros((count, p + 1, p + 1))
    plots, sharpness = np.zeros(count), np.zeros(count)
    noise = np.where(np.isfinite(fitted.noise_sd), fitted.noise_sd, 0.0)
    squares: dict[str, FloatArray] = {cause: np.zeros(2) for cause in ("bias", "noise", "reference", "timing", "height")}

    def piece(at: slice) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, dict[str, FloatArray]]:
        w = np.where(weight[at] > 0, weight[at], 0.0)
        also = tuple(map(term_of, effects))
        place, r, columns = look(some, at, fitted.terms, fitted.value, also)
        metres = np.stack([np.ones(len(w)), place.range_m * np.cos(place.elevation_rad), place.range_m], axis=1)
        r = np.where(np.isfinite(r), r, 0.0)
        x = np.stack([columns[name] for name in names], axis=2)
        starts = np.flatnonzero(np.r_[True, np.diff(some.cluster[at]) != 0])
        # The residuals are put back to zero by the columns: beyond what is linear in a late stamp nothing is left to judge.
        about_zero = r + x @ fitted.value
        flat = [[*(x[:, k, j] * metres[:, k] for j in range(p)), about_zero[:, k] * metres[:, k]] for k in range(3)]
        # Each coordinate counts as it is known: across the range, far plots would drown what all others show.
        sharp = 1.0 / np.maximum((noise**2 + np.nan_to_num(some.reference_variance[at])) * metres**2, 1e-6) * w[:, None]
        sharp[:, 2] = np.where(np.isfinite(some.measured[at, 2]), sharp[:, 2], 0.0)
        level = grams(flat[0], sharp[:, 0], starts) + grams(flat[1], sharp[:, 1], starts)
        up = grams(flat[2], sharp[:, 2], starts)
        sums = _shares(some, at, fitted, columns, place.elevation_rad, vertical[at], metres[:, :2], w)
        known = np.add.reduceat((sharp[:, 0] + sharp[:, 1]) / 2, starts)
        return some.cluster[at][starts], level, up, np.stack([np.add.reduceat(w, starts), known]), sums

    for target, level, up, n, sums in in_threads(piece, slices(len(some), CHUNK // 2)):
        np.add.at(horizontal, target, level)
        np.add.at(upright, target, up)
        np.add.at(plots, target, n[0])
        np.add.at(sharpness, target, n[1])
        for cause, square in sums.items():
            squares[cause] += square
    fold = folds(np.bincount(seen.cluster, minlength=count))
    verdicts = _verdicts(fitted, fold, _Metres(horizontal, upright, plots, sharpness), dropped)
    return verdicts, _budget(squares, float(plots.sum()), bool(np.isfinite(vertical).any()))


def _shares(
    seen: Observed,
    at: slice,
    fitted: Fit,
    columns: Mapping[str, FloatArray],
    elevation_rad: FloatArray,
    vertical: FloatArray,
    metres: FloatArray,
    weight: FloatArray,
) -> dict[str, FloatArray]:
    """Weighted sums of squares (2,), in range and across it, of each cause."""
    moved = {"bias": np.zeros((len(weight), 2)), "timing": np.zeros((len(weight), 2)), "reference": np.zeros((len(weight), 2))}
    for term, value in zip(fitted.terms, fitted.value, strict=True):
        cause = "reference" if term.is_nuisance else "timing" if term.is_time else "bias"
        moved[cause] += columns[term.name][:, :2] * value
    out = {cause: weight @ (m * metres) ** 2 for cause, m in moved.items()}
    # Where late stamps make up for a bias, or add to it, the two share that as they share the rest.
    both, apart = weight @ ((moved["bias"] + moved["timing"]) * metres) ** 2, out["bias"] + out["timing"]
    grown = np.where(apart > 0, both / np.where(apart > 0, apart, 1.0), 1.0)
    out["bias"], out["timing"] = out["bias"] * grown, out["timing"] * grown
    noise = np.tile(fitted.noise_sd[:2] ** 2, (len(weight), 1)) / seen.weight[at, None]
    shared = fitted.reference_share * seen.reference_variance[at, :2]
    for effect in fitted.effects:
        by = effect.sd**2 * columns[effect.term][:, :2] ** 2
        # What wanders in range or azimuth alone is the radar's; what moves a target, or stays with it, is not.
        if effect.term in _POLAR and np.isfinite(effect.block_s):
            noise = noise + by
        else:
            shared = shared + by
    height = np.zeros_like(shared)
    # It is part of what the reference adds, and no larger than that.
    height[:, 0] = np.minimum(np.where(np.isfinite(vertical), vertical, 0.0) * np.sin(elevation_rad) ** 2, shared[:, 0])
    out["noise"] = weight @ (noise * metres**2)
    out["reference"] = out["reference"] + weight @ ((shared - height) * metres**2)
    out["height"] = weight @ (height * metres**2)
    return out


def _budget(squares: Mapping[str, FloatArray], plots: float, height_known: bool) -> tuple[Share, ...]:
    shares = []
    for cause, square in squares.items():
        size = np.sqrt(np.maximum(square, 0.0) / plots) if plots > 0 else np.full(2, np.nan)
        if cause == "height" and not height_known:
            size = np.full(2, np.nan)
        shares.append(Share(cause, float(size[0]), float(size[1])))
    return tuple(shares)


class _Gain(NamedTuple):
    """By how much held-out targets are nearer with a unit of terms: metres, their 95 % interval, and the error with it.

    Root mean squares of distances whose coordinates count by how well they are known.
    """

    unit: tuple[int, ...]
    metres: float
    low: float
    high: float
    left: float
    sd: float


def _verdicts(fitted: Fit, fold: IntArray, metres: _Metres, dropped: Sequence[Dropped]) -> tuple[Verdict, ...]:
    """Each term's verdict, in the order of the terms; then those of core terms that could not be determined.

    The term that helps held-out targets least is put out of the model first, and the others are estimated anew without it: what
    is to be applied then helps without what is held, and of two terms that say the same not both are held.
    """
    terms = fitted.terms
    inside = list(range(len(terms)))
    open_units = [u for u in units(terms) if not any(terms[k].is_nuisance for k in u)]
    n = metres.plots[metres.plots > 0]
    effective = float(n.sum() ** 2 / max((n**2).sum(), 1e-300)) if len(n) else 0.0
    sure = {u for u in open_units if _is_there(fitted, u)}
    found: dict[int, Verdict] = {}
    lacking = _lacking(len(n), effective, n)
    if lacking:
        open_units = []
        for k, term in enumerate(terms):
            if not term.is_nuisance:
                found[k] = Verdict(channel=term.channel, term=term.base, decision="insufficient", why=lacking)
    while open_units:
        gains = [_gain(fitted, inside, unit, fold, metres, effective) for unit in open_units]
        weak = [g for g in gains if not g.low > 0 and not (g.metres > 0 and g.unit in sure)]
        # Of terms that help alike the later in the order of importance goes first.
        done = [min(weak, key=lambda g: g.metres / g.sd if g.sd > 0 else g.metres)] if weak else gains
        for gain in done:
            for k in gain.unit:
                found[k] = _verdict(terms, gain, k, effective, gain.unit in sure)
        if not weak:
            break
        inside = [k for k in inside if k not in done[0].unit]
        open_units = [u for u in open_units if u != done[0].unit]
    missing = [d for d in dropped if d.term in CORE and d.term not in {t.name for t in terms}]
    return (
        *(found[k] for k in sorted(found)),
        *(
            Verdict(channel="all", term=d.term, decision="insufficient", why=d.why)
            for d in missing
            if not d.why.endswith("measures no elevation")
        ),
    )


def _is_there(fitted: Fit, unit: Sequence[int]) -> bool:
    """Whether a unit of terms differs from zero beyond doubt (F test over the effective targets, p < 0.001)."""
    from scipy.special import fdtrc

    index = np.array(unit)
    value, covariance = fitted.value[index], fitted.covariance[np.ix_(index, index)]
    size = np.sqrt(np.diag(covariance))
    square = float(value / size @ np.linalg.solve(covariance / np.outer(size, size), value / size))
    return float(fdtrc(len(unit), max(fitted.effective - 1.0, 2.0), square / len(unit))) < _BEYOND_DOUBT


def _lacking(count: int, effective: float, plots: FloatArray) -> str:
    """What is missing for any verdict; "" for nothing."""
    if count < _FEWEST_TARGETS:
        return f"there {'is' if count == 1 else 'are'} {_targets(count)}: at least {_FEWEST_TARGETS} are needed to hold some out"
    if effective < 3:
        return (
            f"one target has {100 * plots.max() / plots.sum():.0f} % of the plots: the {count} targets count as {effective:.1f}, "
            "and at least 3 must share them"
        )
    return ""


def _gain(fitted: Fit, inside: Sequence[int], unit: tuple[int, ...], fold: IntArray, metres: _Metres, effective: float) -> _Gain:
    """The gain of a unit in the model `inside`, with a jackknife over targets."""
    from scipy.special import stdtrit

    size = np.array([t.prior_sd for t in fitted.terms])
    squares = metres.horizontal
    if any(np.einsum("gii->gi", metres.vertical)[:, k].any() for k in unit):
        squares = squares + metres.vertical

    def left(members: Sequence[int]) -> FloatArray:
        own = part(fitted.normal, members)
        prior = precision([fitted.terms[k] for k in members])
        return np.maximum(misfit(part(squares, members), held_out(own, prior, fold) * size[list(members)]), 0.0)

    rest = [k for k in inside if k not in unit]
    without, with_ = left(rest), left(inside)
    plots, count = metres.sharpness, int((metres.plots > 0).sum())

    def apart(a: FloatArray | float, b: FloatArray | float, n: FloatArray | float) -> FloatArray:
        return np.asarray(np.sqrt(np.maximum(a, 0.0) / n) - np.sqrt(np.maximum(b, 0.0) / n))

    gain = float(apart(without.sum(), with_.sum(), plots.sum()))
    there = metres.plots > 0
    one_less = apart(without.sum() - without[there], with_.sum() - with_[there], plots.sum() - plots[there])
    sd = float(np.sqrt((count - 1) / count * ((one_less - one_less.mean()) ** 2).sum()))
    half = float(stdtrit(max(effective - 1.0, 2.0), 0.975)) * sd
    return _Gain(unit, gain, gain - half, gain + half, float(np.sqrt(with_.sum() / plots.sum())), sd)


def _verdict(terms: Sequence[Term], gain: _Gain, k: int, effective: float, sure: bool) -> Verdict:
    """The verdict on term k of a unit; `sure` is whether the unit is there beyond doubt."""
    others = [terms[j].name for j in gain.unit if j != k]
    together = f" (together with {' and '.join(others)})" if 0 < len(others) < 4 else " (with its table)" if others else ""
    amounts = f"{gain.metres:+.3g} m, 95 % between {gain.low:+.3g} and {gain.high:+.3g} m"
    decision: Decision
    if terms[k].needs & {"second", "third"}:
        decision = "hold"
        why = f"plots do not tell the acceleration that the correction would need ({amounts}){together}"
    elif gain.low > 0:
        decision = "apply"
        why = f"held-out targets come nearer by {gain.metres:.3g} m, to {gain.left:.3g} m{together}"
    elif sure and gain.metres > 0:
        decision = "apply"
        why = f"it is there beyond doubt, though few targets show its gain ({amounts}){together}"
    elif effective < _ENOUGH_TARGETS and gain.high > 0:
        decision = "insufficient"
        more = ""
        if gain.metres > 0:
            needed = effective * ((gain.metres - gain.low) / gain.metres) ** 2
            more = f"; about {max(np.ceil(needed), _ENOUGH_TARGETS):,.0f} like these would show such a gain"
        why = f"the plots count as {effective:.0f} targets, too few to show a gain ({amounts}){together}{more}"
    else:
        decision = "hold"
        less = "held-out targets come no nearer" if gain.metres <= 0 else "that held-out targets come nearer may be chance"
        why = f"{less} ({amounts}){together}"
    return Verdict(
        channel=terms[k].channel, term=terms[k].base, decision=decision, why=why, gain_m=gain.metres, gain_low_m=gain.low,
        gain_high_m=gain.high,
    )  # fmt: skip
