"""How errors are distributed: normality, skew, kurtosis, Student t, a mixture of normals, and the step of their quantisation.

METHODS sections 3 and 4; figure 1 of paper 001.  A mixture of one normal wins unless there are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from .._types import FloatArray
from ..errors import NothingToDo, SettingsError

_LEAST = 8
_STARTS = 3
_EM_STEPS = 500
_EM_SAME = 1e-9
# A part of a mixture is never narrower than this share of the whole: else one value alone has an infinite likelihood.
_NARROWEST = 1e-2
# Shapiro and Wilk's test is made for so many values at most; more are drawn from evenly.
_SHAPIRO = 5000
_STEP_TOLERANCE = 0.02
_STEP_SHARE = 0.98


class Student(msgspec.Struct, frozen=True):
    """A Student t distribution: location, scale, degrees of freedom, and its Bayesian information criterion."""

    location: float
    scale: float
    freedom: float
    bic: float


class Mixture(msgspec.Struct, frozen=True):
    """A mixture of normals, widest share first: shares, means, sd; its Bayesian information criterion; how the search ended."""

    share: tuple[float, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    bic: float
    iterations: int
    ended: str

    def density(self, value: FloatArray) -> FloatArray:
        """The density at values of any shape."""
        z = (np.asarray(value, np.float64)[..., None] - np.array(self.mean)) / np.array(self.sd)
        return np.asarray((np.exp(-0.5 * z**2) * np.array(self.share) / np.array(self.sd)).sum(axis=-1) / np.sqrt(2 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """What a series of errors is like.  All is in the unit of the values.

    `skew` and excess `kurtosis` are 0 for normal errors; `shapiro`, `anderson` (A² with mean and sd estimated) and `jarque_bera`
    are tests of normality, the first and last as p-values, the second with its 5 % point `anderson_5_percent`.  `normal_bic`,
    `student` and `mixtures` (by K) compete by BIC, and `best` names the least.  `step` is the quantisation found (0: none), and
    `step_sd` what it adds to the errors.
    """

    count: int
    mean: float
    sd: float
    skew: float
    kurtosis: float
    shapiro: float
    anderson: float
    anderson_5_percent: float
    jarque_bera: float
    normal_bic: float
    student: Student
    mixtures: tuple[Mixture, ...]
    best: str
    step: float
    step_sd: float

    @property
    def mixture(self) -> Mixture:
        """The mixture of the least BIC."""
        return min(self.mixtures, key=lambda m: m.bic)


def distribution(values: FloatArray, *, most: int = 4, seed: int = 1) -> Distribution:
    """Describe errors (n,); what is not a number is left out.  `most` is the greatest K of a mixture.

    Equal values have a defined result: sd 0, no skew, no kurtosis, and a normal of no width, which no test rejects.  Raises
    NothingToDo for fewer than eight values, SettingsError for a `most` that makes no sense.
    """
    x = np.asarray(values, np.float64).ravel()
    x = x[np.isfinite(x)]
    n = len(x)
    if most < 1 or seed < 0:
        raise SettingsError(f"most = {most}, seed = {seed} make no sense", where="distribution", remedy="Give at least 1 and 0.")
    if n < _LEAST:
        raise NothingToDo(f"{n} values tell nothing of a distribution", remedy=f"Give at least {_LEAST}.")
    mean, sd = float(x.mean()), float(x.std())
    if sd <= 1e-12 * max(abs(mean), 1e-300):
        flat = Mixture((1.0,), (mean,), (0.0,), -np.inf, 0, "equal values")
        return Distribution(
            n, mean, 0.0, 0.0, 0.0, 1.0, 0.0, _anderson_limit(n), 1.0, -np.inf, Student(mean, 0.0, np.inf, -np.inf), (flat,),
            "normal", 0.0, 0.0,
        )  # fmt: skip
    from scipy import stats

    rng = np.random.default_rng(seed)
    z = (x - mean) / sd
    skew, kurtosis = float((z**3).mean()), float((z**4).mean() - 3)
    some = x if n <= _SHAPIRO else x[np.linspace(0, n - 1, _SHAPIRO).astype(np.int64)]
    jarque_bera = n / 6 * (skew**2 + kurtosis**2 / 4)
    normal_bic = 2 * np.log(n) - 2 * float(stats.norm.logpdf(x, mean, sd).sum())
    student = student_fit(x)
    # More parts than distinct values cannot be told.
    mixtures = tuple(mixture_fit(x, k, rng) for k in range(1, min(most, len(np.unique(x))) + 1))
    candidates = {"normal": normal_bic, "Student t": student.bic}
    candidates |= {f"mixture of {len(m.share)}": m.bic for m in mixtures[1:]}
    step = quantisation_step(x)
    return Distribution(
        count=n,
        mean=mean,
        sd=sd,
        skew=skew,
        kurtosis=kurtosis,
        shapiro=float(stats.shapiro(some).pvalue),
        anderson=_anderson(z * np.sqrt((n - 1) / n)),
        anderson_5_percent=_anderson_limit(n),
        jarque_bera=float(stats.chi2.sf(jarque_bera, 2)),
        normal_bic=normal_bic,
        student=student,
        mixtures=mixtures,
        best=min(candidates, key=lambda name: candidates[name]),
        step=step,
        step_sd=step / np.sqrt(12),
    )


def _anderson(z: FloatArray) -> float:
    """Anderson and Darling's A² of standardised values (n,)."""
    from scipy.special import log_ndtr

    ordered, n = np.sort(z), len(z)
    odd = 2 * np.arange(1, n + 1) - 1
    return float(-n - (odd * (log_ndtr(ordered) + log_ndtr(-ordered[::-1]))).mean())


def _anderson_limit(n: int) -> float:
    """The 5 % point of A² with mean and sd estimated (Stephens 1974)."""
    return 0.752 / (1 + 0.75 / n + 2.25 / n**2)


def student_fit(x: FloatArray) -> Student:
    """Maximum likelihood of a Student t for values (n,): EM in location and scale, the degrees of freedom by a search."""
    from scipy import optimize, stats

    def fitted(log_freedom: float) -> tuple[float, float]:
        freedom = float(np.exp(log_freedom))
        location = float(np.median(x))
        scale2 = float(max(np.median(np.abs(x - location)) * 1.4826, x.std() * 1e-3) ** 2)
        for _ in range(200):
            weight = (freedom + 1) / (freedom + (x - location) ** 2 / scale2)
            new = float((weight * x).sum() / weight.sum())
            new2 = float((weight * (x - new) ** 2).mean())
            done = abs(new2 / scale2 - 1) < 1e-8 and abs(new - location) < 1e-8 * np.sqrt(scale2)
            location, scale2 = new, new2
            if done:
                break
        return location, float(np.sqrt(scale2))

    def loss(log_freedom: float) -> float:
        location, scale = fitted(log_freedom)
        return -float(stats.t.logpdf(x, np.exp(log_freedom), location, scale).sum())

    found = optimize.minimize_scalar(loss, bounds=(np.log(0.5), np.log(1000.0)), method="bounded", options={"xatol": 1e-4})
    location, scale = fitted(float(found.x))
    return Student(location, scale, float(np.exp(found.x)), float(3 * np.log(len(x)) + 2 * found.fun))


def mixture_fit(x: FloatArray, parts: int, rng: np.random.Generator) -> Mixture:
    """Maximum likelihood of a mixture of so many normals for values (n,): EM from several starts, the likeliest kept.

    Raises SettingsError for more parts than values.
    """
    n, whole = len(x), float(x.std())
    if not 1 <= parts <= n:
        raise SettingsError(
            f"a mixture of {parts} for {n} values", where="parts", remedy="Give at least 1, and no more than values."
        )
    best: tuple[float, FloatArray, FloatArray, FloatArray, int, str] | None = None
    for start in range(_STARTS if parts > 1 else 1):
        share = np.full(parts, 1.0 / parts)
        if start == 0:
            # One mean for all, widths apart: outliers on both sides.
            mean, sd = np.full(parts, np.median(x)) + 1e-3 * whole * np.arange(parts), whole * 2.0 ** np.arange(-1, parts - 1)
        elif start == 1:
            mean, sd = np.quantile(x, (np.arange(parts) + 0.5) / parts), np.full(parts, whole / parts)
        else:
            mean, sd = rng.choice(x, parts, replace=False), np.full(parts, whole / parts)
        before, ended, steps = -np.inf, "iteration limit", 0
        while steps < _EM_STEPS:
            steps += 1
            log_part = np.log(share)[:, None] - 0.5 * ((x - mean[:, None]) / sd[:, None]) ** 2 - np.log(sd)[:, None]
            top = log_part.max(axis=0)
            weight = np.exp(log_part - top)
            total = weight.sum(axis=0)
            likelihood = float((np.log(total) + top).sum()) - n / 2 * np.log(2 * np.pi)
            weight /= total
            size = np.maximum(weight.sum(axis=1), 1e-300)
            share = np.maximum(size / n, 1e-12)
            mean = weight @ x / size
            sd = np.sqrt(np.maximum((weight * (x - mean[:, None]) ** 2).sum(axis=1) / size, (_NARROWEST * whole) ** 2))
            if abs(likelihood - before) < _EM_SAME * n:
                ended = "converged"
                break
            before = likelihood
        if best is None or likelihood > best[0]:
            best = (likelihood, share, np.asarray(mean, np.float64), np.asarray(sd, np.float64), steps, ended)
    assert best is not None
    likelihood, share, mean, sd, steps, ended = best
    order = np.argsort(-share, kind="stable")
    bic = (3 * parts - 1) * np.log(n) - 2 * likelihood
    return Mixture(tuple(share[order].tolist()), tuple(mean[order].tolist()), tuple(sd[order].tolist()), float(bic), steps, ended)


def quantisation_step(values: FloatArray) -> float:
    """The step that values are whole multiples of, up to an offset; 0 where there is none.

    The most frequent differences of neighbouring distinct values propose steps; one is found where nearly all values lie within
    two per cent of it from a multiple.
    """
    x = np.unique(np.asarray(values, np.float64))
    x = x[np.isfinite(x)]
    if len(x) < _LEAST:
        return 0.0
    span = float(x[-1] - x[0])
    gaps = np.diff(x)
    gaps = gaps[gaps > 1e-9 * span]
    if len(gaps) < _LEAST - 1:
        return 0.0
    # Values written with few digits differ by rounding alone: the least gap that is no mere rounding.
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    for _ in range(3):
        # Long spans tell the step better than one gap does, once the count of steps between is sure.
        near = np.rint((x - x[0]) / step)
        sure = (near > 0) & (np.abs((x - x[0]) / step - near) < 0.25)
        if not sure.any():
            return 0.0
        step = float((near[sure] * (x - x[0])[sure]).sum() / (near[sure] ** 2).sum())
    off = np.abs((x - x[0]) / step - np.rint((x - x[0]) / step))
    # Distinct values of errors that are not quantised are as many as there is room for.
    return step if (off < _STEP_TOLERANCE).mean() >= _STEP_SHARE and len(values) > len(x) else 0.0
