"""How errors are distributed: normality, skew, kurtosis, Student t, a mixture of normals, and the step of their quantisation.

METHODS sections 3 and 4; figure 1 of paper 001.  A mixture of one normal wins unless there are outliers.  Residuals of one target
are alike, and tests that take them for independent find something wherever there is enough: here they count for what they are
worth (`Memory`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import msgspec
import numpy as np

from .._types import AnyArray, FloatArray
from ..errors import InputError, NothingToDo, SettingsError
from ..model import Channel
from ..terms import DEG
from .residuals import Residuals, load_residuals

Component = Literal["range", "azimuth", "elevation", "east", "north", "along", "cross"]
COMPONENTS: tuple[Component, ...] = get_args(Component)
_COLUMN = {"cross": "across"}
_ANGLES = ("azimuth", "elevation")
_POLAR: tuple[Component, ...] = ("range", "azimuth", "elevation")
_LEAST = 8
# So many are needed to say of a recording what its errors are like, and to be worth so many independent ones.
_FEW = 10
_WORTH = 20.0
# Distributions are fitted to so many values at most, drawn evenly: more cost time and change nothing.
_MOST = 5000
# A correlation at each of the first lags, and at so many of the longer ones.
_LAGS = 64
_LONG_LAGS = 40
_STARTS = 4
_EM_STEPS = 500
_EM_SAME = 1e-7
# A part of a mixture is never narrower than this share of the core: else one value alone has an infinite likelihood.
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


class Memory(msgspec.Struct, frozen=True):
    """How alike the errors of one target are: their correlation so many plots apart, and what the series is worth for that.

    `lag` (plots), `lag_s` (the median time between such plots), `correlation` and `pairs` (how many tell it) have one entry a
    lag; what all plots of a target share is in every lag.  Of n values with the correlations rho_ij, `effective` =
    n^2 / sum(rho_ij) independent ones would tell the mean as well, and `effective_shape` = n^2 / sum(rho_ij^3) the skew (that of
    normal errors: Lomnicki 1961), and the kurtosis at least.
    """

    lag: tuple[int, ...]
    lag_s: tuple[float, ...]
    correlation: tuple[float, ...]
    pairs: tuple[int, ...]
    effective: float
    effective_shape: float


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """What a series of errors is like.  All is in the unit of the values.

    `skew` and excess `kurtosis` are 0 for normal errors; `shapiro`, `anderson` (A² with mean and sd estimated) and `jarque_bera`
    are tests of normality, the first and last as p-values, the second with its 5 % point `anderson_5_percent`.  `normal_bic`,
    `student` and `mixtures` (by K) compete by BIC, and `best` names the least.  `step` is the quantisation found (0: none), and
    `step_sd` what it adds to the errors.

    With a `memory` the values are no independent ones: Jarque and Bera's test and the criteria count `effective_shape` values,
    the other two tests are of `tested` values, so many plots apart.
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
    robust_sd: float
    memory: Memory
    tested: int

    @property
    def mixture(self) -> Mixture:
        """The mixture of the least BIC."""
        return min(self.mixtures, key=lambda m: m.bic)


def distribution(
    values: FloatArray,
    *,
    target: AnyArray | None = None,
    time_s: FloatArray | None = None,
    measured: FloatArray | None = None,
    most: int = 4,
    seed: int = 1,
) -> Distribution:
    """Describe errors (n,); what is not a number is left out.  `most` is the greatest K of a mixture.

    `target` (n,) and `time_s` (n,) tell which errors belong to one target and in which order; without them all are independent.
    The quantisation is sought in `measured` (n,), what was measured, where it is given: errors against a fine reference hide it.

    Equal values have a defined result: sd 0, no skew, no kurtosis, and a normal of no width, which no test rejects.  Raises
    NothingToDo for fewer than eight values, SettingsError for a `most` that makes no sense.
    """
    x = np.asarray(values, np.float64).ravel()
    known = np.flatnonzero(np.isfinite(x))
    n = len(known)
    if most < 1 or seed < 0:
        raise SettingsError(f"most = {most}, seed = {seed} make no sense", where="distribution", remedy="Give at least 1 and 0.")
    if n < _LEAST:
        raise NothingToDo(f"{n} values tell nothing of a distribution", remedy=f"Give at least {_LEAST}.")
    if target is not None:
        when = np.arange(len(x), dtype=np.float64) if time_s is None else np.asarray(time_s, np.float64)
        known = known[np.lexsort((when[known], np.asarray(target)[known]))]
        x = x[known]
        remembered = memory(x, np.asarray(target)[known], when[known])
    else:
        x = x[known]
        remembered = Memory((), (), (), (), float(n), float(n))
    step = quantisation_step(x if measured is None else np.asarray(measured, np.float64).ravel()[known])
    worth = remembered.effective_shape
    mean, sd = float(x.mean()), float(x.std())
    if sd <= 1e-12 * max(abs(mean), 1e-300):
        flat = Mixture((1.0,), (mean,), (0.0,), -np.inf, 0, "equal values")
        return Distribution(
            n, mean, 0.0, 0.0, 0.0, 1.0, 0.0, _anderson_limit(n), 1.0, -np.inf, Student(mean, 0.0, np.inf, -np.inf), (flat,),
            "normal", step, step / np.sqrt(12), 0.0, remembered, n,
        )  # fmt: skip
    from scipy import stats

    rng = np.random.default_rng(seed)
    z = (x - mean) / sd
    skew, kurtosis = float((z**3).mean()), float((z**4).mean() - 3)
    # So far apart that what is left of their likeness does not sway a test.
    thin = x[:: max(round(n / np.sqrt(worth * remembered.effective)), 1)]
    thin = thin if len(thin) >= _LEAST else _evenly(x, _LEAST)
    few = _evenly(thin, _SHAPIRO)
    scaled = (thin - thin.mean()) / (thin.std(ddof=1) or 1.0)
    jarque_bera = worth / 6 * (skew**2 + kurtosis**2 / 4)
    some = _evenly(x, _MOST)
    normal_bic = 2 * np.log(max(worth, 2.0)) - 2 * worth * float(stats.norm.logpdf(some, some.mean(), some.std() or sd).mean())
    student = student_fit(some, worth=worth)
    # More parts than distinct values, or with more parameters than there is to learn from, cannot be told; and where one part
    # more does not help, the next does not either.
    mixtures: list[Mixture] = []
    for k in range(1, min(most, len(np.unique(some)), max(int(worth / 3), 1)) + 1):
        mixtures.append(mixture_fit(some, k, rng, worth=worth))
        if k > 1 and mixtures[-1].bic > mixtures[-2].bic:
            break
    candidates = {"normal": normal_bic, "Student t": student.bic}
    candidates |= {f"mixture of {len(m.share)}": m.bic for m in mixtures[1:]}
    return Distribution(
        count=n,
        mean=mean,
        sd=sd,
        skew=skew,
        kurtosis=kurtosis,
        shapiro=float(stats.shapiro(few).pvalue) if np.ptp(few) > 0 else 1.0,
        anderson=_anderson(scaled),
        anderson_5_percent=_anderson_limit(len(thin)),
        jarque_bera=float(stats.chi2.sf(jarque_bera, 2)),
        normal_bic=float(normal_bic),
        student=student,
        mixtures=tuple(mixtures),
        best=min(candidates, key=lambda name: candidates[name]),
        step=step,
        step_sd=float(step / np.sqrt(12)),
        robust_sd=_robust(x),
        memory=remembered,
        tested=len(thin),
    )


def _evenly(x: FloatArray, most: int) -> FloatArray:
    """At most so many of values (n,), drawn evenly."""
    return x if len(x) <= most else x[np.linspace(0, len(x) - 1, most).astype(np.int64)]


def _robust(x: FloatArray) -> float:
    """1.4826 times the median absolute deviation."""
    return float(1.4826 * np.median(np.abs(x - np.median(x))))


def memory(values: FloatArray, target: AnyArray, time_s: FloatArray) -> Memory:
    """How alike the errors (n,) of one target are; rows sorted by target and, within it, by time.

    The correlation is about the mean of all, so that what a target's plots share for good counts.  Beyond the first lag at which
    it is not positive there is none.
    """
    n = len(values)
    u = values - values.mean()
    variance = float(np.mean(u**2))
    size = np.diff(np.flatnonzero(np.r_[True, target[1:] != target[:-1], True]))
    longest = int(size.max()) - 1
    if not variance > 0 or longest < 1:
        return Memory((), (), (), (), float(n), float(n))
    long = np.geomspace(_LAGS, max(longest, _LAGS), _LONG_LAGS).astype(np.int64)
    lags = np.unique(np.r_[np.arange(1, _LAGS + 1), long])
    lags = lags[lags <= longest]
    lag_s, correlation, told = np.zeros(len(lags)), np.zeros(len(lags)), np.zeros(len(lags), np.int64)
    for k, lag in enumerate(lags.tolist()):
        both = target[lag:] == target[:-lag]
        told[k] = np.count_nonzero(both)
        correlation[k] = float(np.mean((u[lag:] * u[:-lag])[both])) / variance
        lag_s[k] = float(np.median((time_s[lag:] - time_s[:-lag])[both]))
    over = np.flatnonzero(correlation <= 0)
    last = int(over[0]) if len(over) else len(lags)
    if last:
        each = np.arange(1, lags[last - 1] + 1)
        rho = np.minimum(np.interp(each, lags[:last], correlation[:last]), 1.0)
        # Pairs so many plots apart, over all targets that are longer.
        ordered = np.sort(size)
        first = np.searchsorted(ordered, each, "right")
        rest = np.r_[np.cumsum(ordered[::-1])[::-1], 0]
        pairs = rest[first] - each * (len(ordered) - first)
        effective, shape = (float(n**2 / (n + 2 * (pairs @ rho**power))) for power in (1, 3))
    else:
        effective = shape = float(n)
    return Memory(
        tuple(lags.tolist()),
        tuple(lag_s.tolist()),
        tuple(correlation.tolist()),
        tuple(told.tolist()),
        max(effective, 1.0),
        max(shape, 1.0),
    )


# ------------------------------------------------------------------------------------------------------------------- in words
def shape_words(found: Distribution) -> str:
    """Which shape the errors have: constant, not decided, normal, heavy-tailed, or a mixture."""
    if not found.sd > 0:
        return "constant: all values are equal"
    m, t, worth = found.mixture, found.student, found.memory.effective_shape
    if worth < _WORTH:
        return f"not decided: what a target's plots share leaves {worth:.0f} independent values' worth of shape"
    if found.best == "normal":
        chance, test = min((found.jarque_bera, "Jarque-Bera"), (found.shapiro, "Shapiro-Wilk"))
        return "normal" if chance >= 0.01 else (
            f"nearly normal: no other shape is worth its parameters, though a test tells it from a normal one ({test}, p "
            f"{_chance(chance)})"
        )  # fmt: skip
    if found.best == "Student t":
        return f"heavy-tailed: Student t with {t.freedom:.1f} degrees of freedom"
    middle = float(np.dot(m.share, m.mean))
    between = float(np.dot(m.share, (np.array(m.mean) - middle) ** 2))
    # Parts about one place differ in width alone: tails.
    kind = "heavy-tailed: mixture" if between < 0.05 * found.sd**2 else "mixture"
    return f"{kind} of {len(m.share)}"


def step_words(step: float, unit: str) -> str:
    """A step of quantisation with the name that it goes by: 18.52 m is 0.01 NM, 0.0055 deg is a turn over 65,536."""
    size = f"{step:.4g} {unit}"
    if unit == "m":
        for count in (1, 2, 4, 8, 10, 16, 32, 64, 100, 128, 256, 512, 1024):
            if abs(step * count / 1852.0 - 1) < 1e-3:
                return f"{size} = {f'1/{count}' if count & (count - 1) == 0 and count > 1 else f'{1 / count:g}'} NM"
        return size
    power = round(float(np.log2(360.0 / step)))
    return f"{size} = 360 deg / {1 << power:,}" if 3 <= power <= 24 and abs(step * 2.0**power / 360.0 - 1) < 1e-3 else size


def verdict(found: Distribution, unit: str) -> str:
    """The shape of the errors, and the step in which they were measured, in words."""
    words = shape_words(found)
    if found.step > 0:
        share = ""
        if found.sd > 0:
            percent = min(100 * (found.step_sd / found.sd) ** 2, 100.0)
            share = f", {percent:{'.0f' if percent >= 10 else '.2g'}} % of the variance"
        words += f"; measured in steps of {step_words(found.step, unit)} (sd {found.step_sd:.2g} {unit}{share})"
    return words


# -------------------------------------------------------------------------------------------------------------------- of a result
@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """One component of one sensor's and channel's errors: the values (n,) in `unit`, and what they are like.

    Without `found`, `why` says what stands against it.
    """

    sensor: str
    channel: str
    component: Component
    unit: str
    corrected: bool
    targets: int
    values: FloatArray
    found: Distribution | None
    why: str = ""

    @property
    def name(self) -> str:
        """What it is of: sensor, channel, component."""
        return f"{self.sensor}, {self.channel}, {self.component}"


def target_numbers(found: Residuals, named: AnyArray | None, targets: Sequence[str]) -> list[int]:
    """The numbers of targets that are given by name or number; `named` (n,) are the names, None where there are none.

    Raises SettingsError for a target that is not there, with those that have most plots.
    """
    names = np.full(len(found), None, object) if named is None else named
    by_name = {str(name): int(k) for name, k in zip(names.tolist(), found.target.tolist(), strict=True) if name is not None}
    numbers = set(found.target.tolist())
    wanted = []
    for target in targets:
        number = by_name.get(target, int(target) if target.isdigit() and int(target) in numbers else None)
        if number is None:
            keys, count = np.unique(found.target, return_counts=True)
            known = {k: name for name, k in by_name.items()}
            most = [known.get(int(k), str(k)) for k in keys[np.argsort(-count, kind="stable")[:8]]]
            raise SettingsError(
                f"no target is called {target!r}",
                where="--targets",
                remedy=f"Those with most plots: {', '.join(most) or 'none'}.",
            )
        wanted.append(number)
    return wanted


def result_residuals(folder: str | Path) -> tuple[Residuals, AnyArray | None, dict[str, int]]:
    """The residuals of a folder that `calibrate` has written, the names of their targets, and the sensors' numbers by name.

    Raises InputError for a folder without them.
    """
    from ..calibration import load_calibration
    from ..reading.tables import parquet_columns

    folder = Path(folder)
    path = folder / "residuals.parquet"
    if not path.is_file():
        raise InputError("has no residuals.parquet", path=folder, remedy="Give the folder that calibrate --out has written.")
    sensors = {s.name: s.sensor for s in load_calibration(folder / "calibration.json").sensors}
    return load_residuals(path), parquet_columns(path).get("target_name"), sensors


def describe_result(
    folder: str | Path,
    *,
    sensor: str | None = None,
    channel: str | None = None,
    components: Sequence[Component] = (),
    corrected: bool = True,
    targets: Sequence[str] = (),
    most: int = 4,
    seed: int = 1,
) -> tuple[Described, ...]:
    """What the errors of a result are like, for each sensor, channel and component (none named: range, azimuth, elevation).

    Errors are measured - reference, in metres and degrees, after the calibration's correction unless `corrected` is false.
    Components that cannot be described say why.  Raises InputError for a folder without residuals, SettingsError for a sensor,
    channel, component or target that is not there, NothingToDo where nothing can be described.
    """
    found, named, sensors = result_residuals(folder)
    for component in components:
        if component not in COMPONENTS:
            raise SettingsError(
                f"there is no component {component!r}", where="--component", remedy=f"Components: {', '.join(COMPONENTS)}."
            )
    if sensor is not None and sensor not in sensors:
        raise SettingsError(f"there is no sensor {sensor!r}", where="--sensor", remedy=f"Sensors: {', '.join(sensors)}.")
    if targets:
        keep = np.isin(found.target, target_numbers(found, named, targets))
        found = found[keep]
    names = {key: name for name, key in sensors.items()}
    if sensor is not None:
        found = found[found.sensor == sensors[sensor]]
    if not len(found):
        raise NothingToDo(f"no plots of {sensor or 'any sensor'}{' and these targets' if targets else ''} in {folder}")
    seen = [Channel(k).name.lower() for k in np.unique(found.channel).tolist()]
    if channel is not None:
        if channel not in seen:
            raise SettingsError(
                f"no plots of channel {channel!r}", where="--channel", remedy=f"Channels: {', '.join(seen) or 'none'}."
            )
        found = found[found.channel == Channel[channel.upper()].value]
    out = []
    for key in np.unique(found.sensor).tolist():
        of_sensor = found[found.sensor == key]
        for kind in np.unique(of_sensor.channel).tolist():
            rows = of_sensor[of_sensor.channel == kind]
            for component in components or _POLAR:
                where = names.get(key, str(key)), Channel(kind).name.lower(), component
                out.append(_described(rows, *where, corrected=corrected, most=most, seed=seed))
    if not any(d.found for d in out):
        why = "; ".join(f"{d.name}: {d.why}" for d in out[:3]) or "no plots"
        raise NothingToDo(
            f"nothing can be said of the errors in {folder} ({why})", remedy="Give more plots, or another component."
        )
    return tuple(out)


def _described(
    rows: Residuals, sensor: str, channel: str, component: Component, *, corrected: bool, most: int, seed: int
) -> Described:
    """One component of the residuals of one sensor and channel."""
    unit, angle = ("deg", DEG) if component in _ANGLES else ("m", 1.0)
    column = _COLUMN.get(component, component)
    suffix = "rad" if unit == "deg" else "m"
    values = getattr(rows, f"{column}_{'after' if corrected else 'before'}_{suffix}") / angle
    measured = None
    if component in _POLAR:
        measured = (getattr(rows, f"reference_{component}_{suffix}") + getattr(rows, f"{component}_before_{suffix}")) / angle
        if component == "azimuth":
            measured = measured % 360.0
    known = np.isfinite(values)
    count, targets = int(known.sum()), len(np.unique(rows.target[known]))
    why = "" if count >= _FEW else f"{count} residuals: too few, at least {_FEW} are needed"
    if not count:
        why = "not measured" if component in _POLAR else "not known (no course, or not measured)"
    told = None if why else distribution(
        values, target=rows.target, time_s=rows.time_s, measured=measured, most=most, seed=seed
    )  # fmt: skip
    return Described(sensor, channel, component, unit, corrected, targets, values[known], told, why)


# --------------------------------------------------------------------------------------------------------------------- text, JSON
def distribution_text(described: Sequence[Described]) -> str:
    """The numbers as tables for a terminal, with the verdicts."""
    after = "after correction" if described[0].corrected else "as recorded"
    lines = [f"errors (measured - reference), {after}"]
    for d in described:
        lines += ["", f"{d.name} ({d.unit})"]
        if d.found is None:
            lines.append(f"  {d.why}")
            continue
        f, digits = d.found, 2 if d.unit == "m" else 4
        lines.append(f"  {verdict(f, d.unit)}")
        lines.append(
            f"  {f.count:,} plots of {d.targets:,} targets, worth {f.memory.effective:,.0f} independent ones for the mean, "
            f"{f.memory.effective_shape:,.0f} for the shape"
        )
        lines.append(f"  mean {f.mean:.{digits}f}, sd {f.sd:.{digits}f}, from the median deviation {f.robust_sd:.{digits}f}; "
                     f"skew {f.skew:+.3f}, excess kurtosis {f.kurtosis:+.3f}")  # fmt: skip
        if not f.sd > 0:
            continue
        lines.append(
            f"  normal? Jarque-Bera p {_chance(f.jarque_bera)}; of {f.tested:,} plots far apart: Shapiro-Wilk p "
            f"{_chance(f.shapiro)}, Anderson-Darling {f.anderson:.2f} (5 %: {f.anderson_5_percent:.2f})"
        )
        t = f.student
        best = min([f.normal_bic, t.bic, *(m.bic for m in f.mixtures[1:])])
        lines.append(f"  normal: BIC +{f.normal_bic - best:.1f}")
        lines.append(
            f"  Student t: BIC +{t.bic - best:.1f}; location {t.location:.{digits}f}, scale {t.scale:.{digits}f}, "
            f"{t.freedom:.1f} degrees of freedom"
        )
        for m in f.mixtures[1:]:
            parts = ", ".join(
                f"{100 * a:.1f} % at {b:.{digits}f} with sd {c:.{digits}f}" for a, b, c in zip(m.share, m.mean, m.sd, strict=True)
            )
            lines.append(f"  mixture of {len(m.share)}: BIC +{m.bic - best:.1f}; {parts}")
    return "\n".join(lines)


def _chance(p: float) -> str:
    return f"= {p:.3f}" if p >= 0.001 else "< 0.001"


def distribution_json(described: Sequence[Described]) -> list[dict[str, object]]:
    """The numbers for programs: metres and degrees; what is not known or not finite is null."""
    out: list[dict[str, object]] = []
    for d in described:
        one: dict[str, object] = {
            "sensor": d.sensor, "channel": d.channel, "component": d.component, "unit": d.unit, "corrected": d.corrected,
            "targets": d.targets, "plots": len(d.values),
        }  # fmt: skip
        f = d.found
        if f is None:
            out.append(one | {"verdict": None, "why": d.why})
            continue
        out.append(
            one
            | {
                "verdict": verdict(f, d.unit),
                "best": f.best,
                "effective": f.memory.effective,
                "effective_shape": f.memory.effective_shape,
                "mean": f.mean,
                "sd": f.sd,
                "robust_sd": f.robust_sd,
                "skew": f.skew,
                "kurtosis": f.kurtosis,
                "jarque_bera_p": f.jarque_bera,
                "tested": f.tested,
                "shapiro_p": f.shapiro,
                "anderson": f.anderson,
                "anderson_5_percent": f.anderson_5_percent,
                "normal_bic": f.normal_bic,
                "student": msgspec.to_builtins(f.student),
                "mixtures": msgspec.to_builtins(f.mixtures),
                "step": f.step or None,
                "memory": {"lag": f.memory.lag, "lag_s": f.memory.lag_s, "correlation": f.memory.correlation},
            }
        )
    return out


# --------------------------------------------------------------------------------------------------------------------------- fits
def _anderson(z: FloatArray) -> float:
    """Anderson and Darling's A² of standardised values (n,)."""
    from scipy.special import log_ndtr

    ordered, n = np.sort(z), len(z)
    odd = 2 * np.arange(1, n + 1) - 1
    return float(-n - (odd * (log_ndtr(ordered) + log_ndtr(-ordered[::-1]))).mean())


def _anderson_limit(n: int) -> float:
    """The 5 % point of A² with mean and sd estimated (Stephens 1974)."""
    return 0.752 / (1 + 0.75 / n + 2.25 / n**2)


def student_fit(x: FloatArray, *, worth: float | None = None) -> Student:
    """Maximum likelihood of a Student t for values (n,): EM in location and scale, the degrees of freedom by a search.

    The criterion counts them as `worth` independent ones (None: all).
    """
    from scipy import optimize
    from scipy.special import gammaln

    middle = float(np.median(x))
    # Each search begins where the last one ended: the degrees of freedom hardly move the place.
    core = _robust(x)
    at = [middle, float(max(core, x.std() * 1e-3) ** 2)]
    # Where most values are equal, the likeliest scale is none at all.
    least = (1e-3 * (core or float(x.std()))) ** 2

    def fitted(log_freedom: float) -> tuple[float, float]:
        freedom = float(np.exp(log_freedom))
        location, scale2 = at
        for _ in range(200):
            weight = (freedom + 1) / (freedom + (x - location) ** 2 / scale2)
            new = float((weight * x).sum() / weight.sum())
            new2 = max(float((weight * (x - new) ** 2).mean()), least)
            done = abs(new2 / scale2 - 1) < 1e-8 and abs(new - location) < 1e-8 * np.sqrt(scale2)
            location, scale2 = new, new2
            if done:
                break
        at[:] = location, scale2
        return location, float(np.sqrt(scale2))

    def loss(log_freedom: float) -> float:
        location, scale = fitted(log_freedom)
        freedom = float(np.exp(log_freedom))
        constant = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(freedom * np.pi) - np.log(scale)
        off = np.log1p(((x - location) / scale) ** 2 / freedom)
        return float((freedom + 1) / 2 * off.sum() - len(x) * constant)

    found = optimize.minimize_scalar(loss, bounds=(np.log(0.5), np.log(1000.0)), method="bounded", options={"xatol": 1e-4})
    location, scale = fitted(float(found.x))
    count = float(len(x)) if worth is None else worth
    return Student(location, scale, float(np.exp(found.x)), float(3 * np.log(max(count, 2.0)) + 2 * count / len(x) * found.fun))


def mixture_fit(x: FloatArray, parts: int, rng: np.random.Generator, *, worth: float | None = None) -> Mixture:
    """Maximum likelihood of a mixture of so many normals for values (n,): EM from several starts, the likeliest kept.

    The criterion counts them as `worth` independent ones (None: all).  Raises SettingsError for more parts than values.
    """
    n, whole, core = len(x), float(x.std()), _robust(x)
    # A few values far out widen the whole, not what the rest is like.
    core = min(core, whole) if core > 0 else whole
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
            mean, sd = np.full(parts, np.median(x)), np.geomspace(core, max(2 * whole, 4 * core), parts)
        elif start == 2:
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
            sd = np.sqrt(np.maximum((weight * (x - mean[:, None]) ** 2).sum(axis=1) / size, (_NARROWEST * core) ** 2))
            if abs(likelihood - before) < _EM_SAME * n:
                ended = "converged"
                break
            before = likelihood
        if best is None or likelihood > best[0]:
            best = (likelihood, share, np.asarray(mean, np.float64), np.asarray(sd, np.float64), steps, ended)
    assert best is not None
    likelihood, share, mean, sd, steps, ended = best
    order = np.argsort(-share, kind="stable")
    count = float(n) if worth is None else worth
    bic = (3 * parts - 1) * np.log(max(count, 2.0)) - 2 * count / n * likelihood
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
