"""The result of a registration: named terms with values, one joint covariance, and what could not be determined."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from ._files import write_bytes
from ._types import BoolArray, FloatArray
from .errors import InputError, SettingsError
from .terms import DEG, TABLES, TERMS, summarised

SCHEMA = "boresight-calibration/1"
Decision = Literal["apply", "hold", "insufficient"]
Criterion = Literal["cross-validation", "bic", "none"]


class TermKey(msgspec.Struct, frozen=True):
    """Which number of a calibration this is: the sensor's id, the channel ("all" where the channels share it), and the term."""

    sensor: int
    channel: str
    name: str
    unit: str


class Noise(msgspec.Struct, frozen=True):
    """Random error (one sigma) of a sensor's channels, net of the reference's and the interpolation's."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float = float("nan")


class NotDetermined(msgspec.Struct, frozen=True):
    """A term that the data cannot give, and why."""

    sensor: int
    term: str
    why: str


class Accuracy(msgspec.Struct, frozen=True):
    """Horizontal distance (m) between plot and reference over a set of pairs."""

    median_m: float
    p95_m: float


class Effect(msgspec.Struct, frozen=True):
    """A random error that plots of one target share: it acts as `term` does, over blocks of `block_s` (infinite: for good).

    `sd` is over targets (or blocks), SI.
    """

    term: str
    block_s: float
    sd: float


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """What to do with one term: "apply" the correction, "hold" it back, or "insufficient" data to say.

    `gain_m` is by how much the term lowers the error of targets that were held out (root mean square, metres, range and
    cross-range counting by how well each is known; NaN: not measured), with its 95 % interval; `why` is the reason in words.
    """

    channel: str
    term: str
    decision: Decision
    why: str
    gain_m: float = float("nan")
    gain_low_m: float = float("nan")
    gain_high_m: float = float("nan")


class Choice(msgspec.Struct, frozen=True, kw_only=True):
    """One step on the way to a model: the term that was added or dropped, and the criterion after it (smaller is better).

    `change` is the criterion's change by this step with its standard error `change_sd` over targets (NaN: not known).
    """

    action: str
    term: str
    criterion: float
    change: float = float("nan")
    change_sd: float = float("nan")
    why: str = ""


class Share(msgspec.Struct, frozen=True):
    """One cause's part in the error of a plot before correction: root mean square (m) in range and across it.

    Causes are "bias", "noise", "reference", "timing" and "height"; NaN where the data cannot tell.
    """

    cause: str
    range_m: float
    cross_m: float


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """What a calibration says of one sensor besides its terms.

    Held-out figures come from folds by target.  `effective_targets` is how many equally good targets would tell as much.
    `effects` are the random errors that a target's plots share, `verdicts` say what to do with each term, `choices` are the
    steps of the search for the model by `criterion` ("" where the model was given), `budget` is where a plot's error comes from.
    """

    sensor: int
    name: str
    model: str
    noise: Noise
    plots: int
    tracks: int
    targets: int
    before: Accuracy
    after: Accuracy
    held_out_before_median_m: float = float("nan")
    held_out_after_median_m: float = float("nan")
    held_out_before_p95_m: float = float("nan")
    held_out_after_p95_m: float = float("nan")
    effective_targets: float = float("nan")
    notes: tuple[str, ...] = ()
    effects: tuple[Effect, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    criterion: str = ""
    choices: tuple[Choice, ...] = ()
    budget: tuple[Share, ...] = ()


class Input(msgspec.Struct, frozen=True):
    """A file that went in."""

    path: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Systematic errors of one or more sensors.  bias = measured - true; SI inside, the term's unit in JSON.

    `epoch_s` (k,), `value` (k, p) and `covariance` (k, p, p) are over time (k = 1: static) and joint over all sensors and terms.
    """

    terms: tuple[TermKey, ...]
    epoch_s: FloatArray
    value: FloatArray
    covariance: FloatArray
    sensors: tuple[Summary, ...] = ()
    not_determined: tuple[NotDetermined, ...] = ()
    inputs: tuple[Input, ...] = ()
    warnings: tuple[str, ...] = ()
    settings: dict[str, object] = field(default_factory=dict)
    version: str = ""

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (k, p), SI."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def against(self) -> str:
        """What the plots were compared with, in words: the reference, or the main radar's tracks."""
        main = self.settings.get("main")
        return f"{main}'s tracks" if main else "the reference"

    def interval(self, level: float = 0.95) -> FloatArray:
        """Confidence intervals (k, p, 2), SI: the value lies within with probability `level`.

        Errors over their sd follow a t distribution of as many degrees of freedom as there were effective targets, less one.
        """
        from scipy.special import stdtrit

        targets = {s.sensor: s.effective_targets for s in self.sensors}
        freedom = np.array([targets.get(key.sensor, np.nan) for key in self.terms]) - 1.0
        freedom = np.where(np.isfinite(freedom), np.maximum(freedom, 3.0), 1e6)
        # The covariance is that of the t distribution, which is wider than its scale.
        half = self.sd * stdtrit(freedom, (1 + level) / 2) * np.sqrt((freedom - 2) / freedom)
        return np.stack([self.value - half, self.value + half], axis=-1)

    def index(self, sensor: int, term: str, channel: str = "all") -> int | None:
        """Where the term of this sensor and channel stands among `terms`, or None."""
        wanted = (sensor, channel, term)
        return next((k for k, key in enumerate(self.terms) if (key.sensor, key.channel, key.name) == wanted), None)

    def __str__(self) -> str:
        """A table to read: terms in their units with sd, noise, accuracy, what was not determined, notes."""
        return "\n\n".join(self._sensor_text(s) for s in self.sensors) if self.sensors else "no sensor was calibrated"

    def _sensor_text(self, s: Summary) -> str:
        lines = [f"{s.name} ({s.model}): {_count(s.plots, 'plot')}, {_count(s.tracks, 'track')}, {_count(s.targets, 'target')}"]
        rows = [("error", "value", "sd", "unit")]
        for k, key in enumerate(self.terms):
            if key.sensor == s.sensor:
                scale = si_per_unit(key)
                value, sd = _rounded(self.value[-1, k] / scale, self.sd[-1, k] / scale)
                name = key.name if key.channel == "all" else f"{key.name} ({key.channel})"
                rows.append((name, value, sd, key.unit))
        wide = [max(len(row[c]) for row in rows) for c in range(4)]
        lines += [f"  {a:<{wide[0]}}  {b:>{wide[1]}}  {c:>{wide[2]}}  {d}" for a, b, c, d in rows]
        if len(self.epoch_s) > 1:
            lines.append(f"  these are the newest of {len(self.epoch_s)} epochs: {_iso(self.epoch_s[-1])}")
        noise = [f"range {s.noise.range_m:.1f} m", f"azimuth {s.noise.azimuth_rad / DEG:.3f} deg"]
        if np.isfinite(s.noise.elevation_rad):
            noise.append(f"elevation {s.noise.elevation_rad / DEG:.3f} deg")
        lines.append(f"  noise (1 sd): {', '.join(noise)}")
        lines.append(
            f"  distance to {self.against}: median {s.before.median_m:.1f} m, 95 % {s.before.p95_m:.1f} m before; "
            f"{s.after.median_m:.1f} m, {s.after.p95_m:.1f} m after"
        )
        if np.isfinite(s.held_out_after_median_m):
            lines.append(
                f"  on targets that were held out: median {s.held_out_before_median_m:.1f} m before, "
                f"{s.held_out_after_median_m:.1f} m after"
            )
        for v in s.verdicts:
            lines.append(f"  {v.decision}: {v.term if v.channel == 'all' else f'{v.term} ({v.channel})'}: {v.why}")
        if s.criterion:
            few = f"the terms that always stay: {_count(s.targets, 'target')} cannot show what others are worth"
            lines.append(f"  model by {s.criterion}: {_path(s.choices) if s.choices else few}")
        lines += [f"  not determined: {n.term}: {n.why}" for n in self.not_determined if n.sensor == s.sensor]
        lines += [f"  note: {note}" for note in s.notes]
        return "\n".join(lines)


def _path(choices: Sequence[Choice]) -> str:
    """The search for a model in one line."""
    sign = {"add": "+ {}", "drop": "- {}", "replace": "{}", "not tested": "{} not tested"}
    steps = [sign[c.action].format(f"({c.term})" if " + " in c.term else c.term) for c in choices if c.action in sign]
    left = sum(c.action == "leave out" for c in choices)
    return f"{', '.join(steps) or 'as it began'}; {_count(left, 'other')} left out"


def chosen(calibration: Calibration, terms: str | Sequence[str] = "advised") -> tuple[BoolArray, tuple[str, ...]]:
    """Which terms are to be applied (p,), and for each one why not ("" where it is).

    "advised" takes the terms whose verdict is to apply them, and those without a verdict; "all" takes every one; else names are
    taken ("azimuth_bias", or "azimuth_bias@psr" for one channel; a string may be a comma-separated list).  Terms that need the
    target's accelerations are never taken by "advised": plots do not tell them.  Raises SettingsError for a name that the
    calibration does not have.
    """
    keys = calibration.terms
    if terms == "all":
        return np.ones(len(keys), bool), ("",) * len(keys)
    if terms != "advised":
        wanted = [part.strip() for part in terms.split(",") if part.strip()] if isinstance(terms, str) else list(terms)
        names = [{name for base in (key.name, *_tables(key)) for name in (base, f"{base}@{key.channel}")} for key in keys]
        for name in wanted:
            if not any(name in own for own in names):
                raise SettingsError(
                    f"the calibration has no term {name!r}",
                    where="terms",
                    remedy=f"It has: {', '.join(summarised(map(_term_name, keys)))}; or say advised, or all.",
                )
        if not wanted:
            raise SettingsError("no term is named", where="terms", remedy="Say advised, all, or names of terms.")
        take = np.array([any(name in own for name in wanted) for own in names])
        return take, tuple("" if here else "it was not asked for" for here in take.tolist())
    verdicts = {(s.sensor, v.channel, v.term.partition("@")[0]): v for s in calibration.sensors for v in s.verdicts}
    why = []
    for key in keys:
        # A verdict may be on a table as a whole.
        judged = (verdicts.get((key.sensor, key.channel, name)) for name in (key.name, *_tables(key)))
        verdict = next((v for v in judged if v is not None), None)
        if verdict is not None and verdict.decision != "apply":
            word = "the data are insufficient" if verdict.decision == "insufficient" else "the advice is to hold it"
            why.append(f"{word}: {verdict.why}" if verdict.why else word)
        elif TERMS[key.name].needs & {"second", "third"}:
            why.append("plots do not tell the accelerations that it needs")
        else:
            why.append("")
    return np.array([not text for text in why], bool), tuple(why)


def advised(calibration: Calibration, terms: str | Sequence[str] = "advised") -> Calibration:
    """The calibration with the terms that are to be applied alone, as it would be had the others been held at zero.

    What is left out is not simply dropped: the others had made room for it.  With the estimates v and their covariance C, the
    terms applied (a) become ``v_a - C_ah C_hh^-1 v_h`` with ``C_aa - C_ah C_hh^-1 C_ha`` where the terms h are zero: what
    a least-squares fit without them gives (exactly, for a linear model and weights that stay).  Only terms that may be zero are
    taken for it (`at_zero`); beside the others, values and covariance stay as they were found.  `terms` as in `chosen`, which
    also raises SettingsError.
    """
    take, _ = chosen(calibration, terms)
    if take.all():
        return calibration
    zero = at_zero(calibration, take)
    epochs, count = len(calibration.epoch_s), int(take.sum())
    value, covariance = np.empty((epochs, count)), np.empty((epochs, count, count))
    for k in range(epochs):
        r, scale = _correlation(calibration.covariance[k])
        gain = np.linalg.lstsq(r[np.ix_(zero, zero)], r[np.ix_(zero, take)], rcond=None)[0].T
        value[k] = calibration.value[k, take] - scale[take] * (gain @ (calibration.value[k, zero] / scale[zero]))
        left = (r[np.ix_(take, take)] - gain @ r[np.ix_(zero, take)]) * scale[take][:, None] * scale[take]
        covariance[k] = (left + left.T) / 2
    keys = tuple(key for key, here in zip(calibration.terms, take.tolist(), strict=True) if here)
    return replace(calibration, terms=keys, value=value, covariance=covariance)


def at_zero(calibration: Calibration, take: BoolArray) -> BoolArray:
    """Which of the terms that are not applied (``~take``) the others are re-estimated for as if they were zero (p,).

    Not those that the data say are there (alone beyond 2.6 sd at some epoch, or together, by sensor, beyond the 1 % point of
    chi-squared): to force them to zero would spoil the others.  Nor those that are real but need what plots do not tell.
    """
    from scipy.special import chdtri

    apart = np.abs(calibration.value) / np.maximum(calibration.sd, np.finfo(float).tiny)
    lost = np.array([bool(TERMS[key.name].needs & {"second", "third"}) for key in calibration.terms], bool)
    zero: BoolArray = ~take & ~lost & (apart <= _THERE_SD).all(axis=0)
    sensor = np.array([key.sensor for key in calibration.terms])
    for one in np.unique(sensor[zero]):
        mine = zero & (sensor == one)
        for k in range(len(calibration.epoch_s)):
            r, scale = _correlation(calibration.covariance[k][np.ix_(mine, mine)])
            z = calibration.value[k, mine] / scale
            if z @ np.linalg.lstsq(r, z, rcond=None)[0] > chdtri(int(mine.sum()), 0.01):
                zero &= sensor != one
    return zero


# Beyond this a term is there, whatever it gains (1 % of terms that are not).
_THERE_SD = 2.576


def _correlation(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The correlation (p, p) and the sd (p,): terms differ by orders of magnitude in size."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return covariance / scale[:, None] / scale, scale


def _term_name(key: TermKey) -> str:
    return key.name if key.channel == "all" else f"{key.name}@{key.channel}"


def _tables(key: TermKey) -> list[str]:
    return [table for table, nodes in TABLES.items() if key.name in nodes]


def si_per_unit(key: TermKey) -> float:
    """SI per unit of a term's value in files."""
    return TERMS[key.name].si_per_unit


def _count(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def _rounded(value: float, sd: float) -> tuple[str, str]:
    """Value and sd with two significant digits of the sd."""
    if not np.isfinite(sd) or sd <= 0:
        return f"{value:.6g}", f"{sd:.3g}"
    digits = int(np.clip(1 - np.floor(np.log10(sd)), 0, 9))
    return f"{value:.{digits}f}", f"{sd:.{digits}f}"


class _TermFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sensor: int
    channel: str
    term: str
    unit: str


class _NoiseFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    range_m: float | None
    azimuth_deg: float | None
    elevation_deg: float | None


class _AccuracyFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    median_m: float | None
    p95_m: float | None


class _EffectFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    term: str
    block_s: float | None
    sd: float
    unit: str


class _VerdictFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    channel: str
    term: str
    decision: Decision
    why: str
    gain_m: float | None
    gain_low_m: float | None
    gain_high_m: float | None


class _ChoiceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    action: str
    term: str
    criterion: float | None
    change: float | None
    change_sd: float | None
    why: str


class _ShareFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    cause: str
    range_m: float | None
    cross_m: float | None


class _SensorFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sensor: int
    name: str
    model: str
    noise: _NoiseFile
    plots: int
    tracks: int
    targets: int
    effective_targets: float | None
    before: _AccuracyFile
    after: _AccuracyFile
    held_out_before: _AccuracyFile
    held_out_after: _AccuracyFile
    notes: tuple[str, ...]
    effects: tuple[_EffectFile, ...] = ()
    verdicts: tuple[_VerdictFile, ...] = ()
    criterion: str = ""
    choices: tuple[_ChoiceFile, ...] = ()
    budget: tuple[_ShareFile, ...] = ()


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """calibration.json: value (k, p), sd (k, p) and covariance (k, p, p) are in the terms' units, epochs UTC seconds since
    1970."""

    schema: str
    version: str
    epoch_s: list[float]
    epoch: list[str]
    terms: tuple[_TermFile, ...]
    value: list[list[float]]
    sd: list[list[float]]
    covariance: list[list[list[float]]]
    sensors: tuple[_SensorFile, ...]
    not_determined: tuple[NotDetermined, ...]
    inputs: tuple[Input, ...]
    warnings: tuple[str, ...]
    settings: dict[str, Any]


def _iso(time_s: float) -> str:
    return datetime.datetime.fromtimestamp(time_s, datetime.UTC).isoformat().replace("+00:00", "Z")


def _null(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _nan(value: float | None) -> float:
    return float("nan") if value is None else value


def _units(terms: tuple[TermKey, ...]) -> FloatArray:
    return np.array([si_per_unit(key) for key in terms], np.float64)


def save_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write calibration.json: whole or not at all, values and covariance in the units of the terms, what is not known null.

    Raises InputError where the file cannot be written.
    """
    units = _units(calibration.terms)

    def accuracy(median: float, p95: float) -> _AccuracyFile:
        return _AccuracyFile(_null(median), _null(p95))

    file = _File(
        schema=SCHEMA,
        version=calibration.version,
        epoch_s=calibration.epoch_s.tolist(),
        epoch=[_iso(t) for t in calibration.epoch_s.tolist()],
        terms=tuple(_TermFile(key.sensor, key.channel, key.name, key.unit) for key in calibration.terms),
        value=(calibration.value / units).tolist(),
        sd=(calibration.sd / units).tolist(),
        covariance=(calibration.covariance / units[:, None] / units).tolist(),
        sensors=tuple(
            _SensorFile(
                sensor=s.sensor,
                name=s.name,
                model=s.model,
                noise=_NoiseFile(_null(s.noise.range_m), _null(s.noise.azimuth_rad / DEG), _null(s.noise.elevation_rad / DEG)),
                plots=s.plots,
                tracks=s.tracks,
                targets=s.targets,
                effective_targets=_null(s.effective_targets),
                before=accuracy(s.before.median_m, s.before.p95_m),
                after=accuracy(s.after.median_m, s.after.p95_m),
                held_out_before=accuracy(s.held_out_before_median_m, s.held_out_before_p95_m),
                held_out_after=accuracy(s.held_out_after_median_m, s.held_out_after_p95_m),
                notes=s.notes,
                effects=tuple(
                    _EffectFile(e.term, _null(e.block_s), e.sd / TERMS[e.term].si_per_unit, TERMS[e.term].unit) for e in s.effects
                ),
                verdicts=tuple(
                    _VerdictFile(v.channel, v.term, v.decision, v.why, _null(v.gain_m), _null(v.gain_low_m), _null(v.gain_high_m))
                    for v in s.verdicts
                ),
                criterion=s.criterion,
                choices=tuple(
                    _ChoiceFile(c.action, c.term, _null(c.criterion), _null(c.change), _null(c.change_sd), c.why)
                    for c in s.choices
                ),
                budget=tuple(_ShareFile(b.cause, _null(b.range_m), _null(b.cross_m)) for b in s.budget),
            )
            for s in calibration.sensors
        ),
        not_determined=calibration.not_determined,
        inputs=calibration.inputs,
        warnings=calibration.warnings,
        settings=calibration.settings,
    )
    text = msgspec.json.format(msgspec.json.encode(file), indent=1) + b"\n"
    write_bytes(path, text)


def load_calibration(path: str | Path) -> Calibration:
    """Read calibration.json.

    Raises InputError, naming the file and the place in it, for a file that cannot be read, is no calibration, is of another
    schema, or contradicts itself.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path=path) from error
    remedy = "Give a calibration.json that boresight calibrate has written."
    try:
        schema = msgspec.json.decode(data, type=_Schema).schema
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is no calibration: {error}", path=path, remedy=remedy) from error
    if schema != SCHEMA:
        raise InputError(
            f"its schema is {schema!r}, but {SCHEMA!r} is needed",
            path=path,
            remedy="Calibrate again with this version of Boresight.",
        )
    try:
        file = msgspec.json.decode(data, type=_File)
    except msgspec.DecodeError as error:
        raise InputError(f"is no whole calibration: {error}", path=path, remedy=remedy) from error
    for number, term in enumerate(file.terms):
        if term.term not in TERMS:
            raise InputError(f"terms[{number}]: there is no term {term.term!r}", path=path, remedy=f"Terms: {', '.join(TERMS)}.")
        if term.unit != TERMS[term.term].unit:
            raise InputError(
                f"terms[{number}]: the unit of {term.term} is {TERMS[term.term].unit}, not {term.unit!r}",
                path=path,
                remedy=remedy,
            )
    for s in file.sensors:
        for effect in s.effects:
            if effect.term not in TERMS:
                raise InputError(
                    f"the effects of {s.name} name a term {effect.term!r}, which does not exist", path=path, remedy=remedy
                )
    known = {s.sensor for s in file.sensors}
    for number, term in enumerate(file.terms):
        if term.sensor not in known:
            raise InputError(f"terms[{number}]: its sensor {term.sensor} is not among the sensors", path=path, remedy=remedy)
    k, p = len(file.epoch_s), len(file.terms)
    keys = tuple(TermKey(t.sensor, t.channel, t.term, t.unit) for t in file.terms)
    units = _units(keys)
    arrays = []
    for name, rows, shape in (("value", file.value, (k, p)), ("covariance", file.covariance, (k, p, p))):
        try:
            array = np.array(rows, np.float64).reshape(shape)
        except ValueError as error:
            raise InputError(f"{name} has not the shape {shape} of epochs and terms", path=path, remedy=remedy) from error
        arrays.append(array)
    value, covariance = arrays
    twice = next((key for number, key in enumerate(keys) if key in keys[:number]), None)
    if twice is not None:
        raise InputError(f"the term {twice.name} of sensor {twice.sensor} stands there twice", path=path, remedy=remedy)
    sizes = np.diagonal(covariance, axis1=1, axis2=2)
    if not np.isfinite(value).all() or not np.isfinite(covariance).all() or (sizes < 0).any():
        raise InputError("value and covariance hold what cannot be: no number, or a negative variance", path=path, remedy=remedy)
    return Calibration(
        terms=keys,
        epoch_s=np.array(file.epoch_s, np.float64),
        value=value * units,
        covariance=covariance * units[:, None] * units,
        sensors=tuple(
            Summary(
                sensor=s.sensor,
                name=s.name,
                model=s.model,
                noise=Noise(_nan(s.noise.range_m), _nan(s.noise.azimuth_deg) * DEG, _nan(s.noise.elevation_deg) * DEG),
                plots=s.plots,
                tracks=s.tracks,
                targets=s.targets,
                effective_targets=_nan(s.effective_targets),
                before=Accuracy(_nan(s.before.median_m), _nan(s.before.p95_m)),
                after=Accuracy(_nan(s.after.median_m), _nan(s.after.p95_m)),
                held_out_before_median_m=_nan(s.held_out_before.median_m),
                held_out_before_p95_m=_nan(s.held_out_before.p95_m),
                held_out_after_median_m=_nan(s.held_out_after.median_m),
                held_out_after_p95_m=_nan(s.held_out_after.p95_m),
                notes=s.notes,
                effects=tuple(
                    Effect(e.term, float("inf") if e.block_s is None else e.block_s, e.sd * TERMS[e.term].si_per_unit)
                    for e in s.effects
                ),
                verdicts=tuple(
                    Verdict(
                        channel=v.channel,
                        term=v.term,
                        decision=v.decision,
                        why=v.why,
                        gain_m=_nan(v.gain_m),
                        gain_low_m=_nan(v.gain_low_m),
                        gain_high_m=_nan(v.gain_high_m),
                    )
                    for v in s.verdicts
                ),
                criterion=s.criterion,
                choices=tuple(
                    Choice(
                        action=c.action,
                        term=c.term,
                        criterion=_nan(c.criterion),
                        change=_nan(c.change),
                        change_sd=_nan(c.change_sd),
                        why=c.why,
                    )
                    for c in s.choices
                ),
                budget=tuple(Share(b.cause, _nan(b.range_m), _nan(b.cross_m)) for b in s.budget),
            )
            for s in file.sensors
        ),
        not_determined=file.not_determined,
        inputs=file.inputs,
        warnings=file.warnings,
        settings=file.settings,
        version=file.version,
    )


class _Schema(msgspec.Struct, frozen=True):
    schema: str


def summary_json(calibration: Calibration) -> dict[str, Any]:
    """What ``boresight calibrate --json`` prints: by sensor the terms in their units, noise, counts, accuracy and what is
    missing.

    Values over time are those of the last epoch.  The notes on a sensor stand among the warnings, after its name.
    """
    sd = calibration.sd
    sensors: dict[str, Any] = {}
    for s in calibration.sensors:
        terms = {}
        for k, key in enumerate(calibration.terms):
            if key.sensor == s.sensor:
                scale = si_per_unit(key)
                name = key.name if key.channel == "all" else f"{key.name}.{key.channel}"
                terms[name] = {"value": _null(calibration.value[-1, k] / scale), "sd": _null(sd[-1, k] / scale), "unit": key.unit}
        noise = {"range_m": _null(s.noise.range_m), "azimuth_deg": _null(s.noise.azimuth_rad / DEG)}
        if np.isfinite(s.noise.elevation_rad):
            noise["elevation_deg"] = s.noise.elevation_rad / DEG
        sensors[s.name] = {
            "model": s.model,
            "terms": terms,
            "noise": noise,
            "plots": s.plots,
            "tracks": s.tracks,
            "targets": s.targets,
            "before": {"median_m": _null(s.before.median_m), "p95_m": _null(s.before.p95_m)},
            "after": {"median_m": _null(s.after.median_m), "p95_m": _null(s.after.p95_m)},
            "held_out": {
                "before_median_m": _null(s.held_out_before_median_m),
                "after_median_m": _null(s.held_out_after_median_m),
                "before_p95_m": _null(s.held_out_before_p95_m),
                "after_p95_m": _null(s.held_out_after_p95_m),
            },
            "not_determined": [{"term": n.term, "why": n.why} for n in calibration.not_determined if n.sensor == s.sensor],
            "verdicts": [
                {
                    "term": v.term if v.channel == "all" else f"{v.term}.{v.channel}",
                    "decision": v.decision,
                    "gain_m": _null(v.gain_m),
                    "gain_95_m": [_null(v.gain_low_m), _null(v.gain_high_m)],
                    "why": v.why,
                }
                for v in s.verdicts
            ],
            "criterion": s.criterion,
            "choices": [
                {
                    "action": c.action,
                    "term": c.term,
                    "criterion": _null(c.criterion),
                    "change": _null(c.change),
                    "change_sd": _null(c.change_sd),
                    "why": c.why,
                }
                for c in s.choices
            ],
        }
    notes = [f"{s.name}: {note}" for s in calibration.sensors for note in s.notes]
    return {
        "method": calibration.settings.get("method", ""),
        "relative_to": calibration.settings.get("main"),
        "epochs": {"count": len(calibration.epoch_s), "last": _iso(float(calibration.epoch_s[-1]))},
        "sensors": sensors,
        "inputs": [msgspec.to_builtins(i) for i in calibration.inputs],
        "warnings": [*calibration.warnings, *notes],
    }
