"""Conformity: what a result says about the figures of a requirement document: pass, fail or undecided.

A requirement is a TOML file: the document with its edition, and one ``[[figure]]`` for each of its figures, with the clause.
A figure is met where the whole confidence interval of the quantity lies within the limit, and failed where none of it does.
Between the two it is undecided, as it is where the quantity was not determined.  Targets are the independent units of every
interval, not plots.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from .._files import write_bytes
from .._types import BoolArray, FloatArray, IntArray
from ..calibration import Calibration, Summary
from ..errors import SettingsError
from ..model import KINDS, Channel, Sensors
from ..terms import DEG, TERMS
from .residuals import Residuals

Outcome = Literal["pass", "fail", "undecided"]
_NAN = float("nan")


class Conformity(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of a requirement, judged for one sensor.

    `requirement` names the document with its edition, `clause` the place in it.  `limit`, `value` and the interval `low` … `high`
    are in `unit`; value and interval are NaN where the quantity was not determined.  `verdict` is "undecided" where the interval
    straddles the limit or there is no value; `why` says it in words.
    """

    requirement: str
    clause: str
    sensor: str
    quantity: str
    unit: str
    limit: float
    value: float
    low: float
    high: float
    verdict: Outcome
    why: str


class Figure(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One figure of a requirement: `quantity` stays within `max` (its size; `min`: reaches it), in `unit`, says `clause`.

    `kinds` and `channels` are the kinds of sensor and the channels of plots that it is about (none given: all), `to_range` (in
    `range_unit`) the range up to which it holds.  `text` quotes the document, `confidence` is that of the interval.
    """

    clause: str
    quantity: str
    unit: str
    max: float | None = None
    min: float | None = None
    kinds: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    to_range: float | None = None
    range_unit: str = "NM"
    confidence: float = 0.95
    text: str = ""


class Requirement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A requirement document: its name, where its figures come from, the edition, and the figures.

    `example` marks figures that are not vouched for: they show the form, or were taken from memory or second hand.
    """

    name: str
    source: str
    edition: str
    figure: tuple[Figure, ...]
    example: bool = False
    url: str = ""
    note: str = ""

    @property
    def title(self) -> str:
        """Name and edition, and whether it is only an example."""
        return f"{self.name}, {self.edition}{' (example)' if self.example else ''}"


_UNITS: dict[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "km": ("length", 1000.0),
    "NM": ("length", 1852.0),
    "ft": ("length", 0.3048),
    "deg": ("angle", DEG),
    "mrad": ("angle", 1e-3),
    "rad": ("angle", 1.0),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "m/km": ("ratio", 1e-3),
    "m/NM": ("ratio", 1 / 1852.0),
    "m/m": ("ratio", 1.0),
    "%": ("ratio", 1e-2),
}
# What is taken from the pairs: name -> (column of the residuals without its "before" or "after", statistic, dimension).
_OF_PAIRS: dict[str, tuple[str, str, str]] = {
    f"{what}_{statistic}": (column, statistic, dimension)
    for what, column, dimension in (
        ("range", "range", "length"),
        ("azimuth", "azimuth", "angle"),
        ("elevation", "elevation", "angle"),
        ("position", "distance", "length"),
    )
    for statistic in ("rms", "median", "p95", "p99")
}
_CORRECTED = "_corrected"
_NOISE = {"range_noise_sd": "length", "azimuth_noise_sd": "angle", "elevation_noise_sd": "angle"}
# What requirement documents ask for and no calibration tells: named, so that a verdict is not taken for more than it is.
_NOT_MEASURED = {
    "detection_probability": "the calibration counts the plots that are there, not those that are missing",
    "false_plots_per_scan": "the calibration judges the plots of known targets only",
    "position_jumps": "the calibration leaves out plots far from their target and does not tell jumps from false plots",
    "range_resolution": "the calibration does not judge targets close to each other",
    "azimuth_resolution": "the calibration does not judge targets close to each other",
}


def quantities() -> dict[str, str]:
    """The quantities that a figure may be about: name -> dimension ("length", "angle", "time", "ratio", or a unit)."""
    known = {name: _dimension(term.unit) for name, term in TERMS.items()}
    known |= _NOISE
    for name, (_, _, dimension) in _OF_PAIRS.items():
        known |= {name: dimension, name + _CORRECTED: dimension}
    return known | dict.fromkeys(_NOT_MEASURED, "not measured")


def _dimension(unit: str) -> str:
    return _UNITS[unit][0] if unit in _UNITS else unit


def shipped_requirements() -> tuple[str, ...]:
    """The names of the requirement files that come with Boresight."""
    folder = resources.files(__package__) / "requirements"
    return tuple(sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")))


def load_requirement(path: str | Path) -> Requirement:
    """Read a requirement file, or one that comes with Boresight, by its name.

    Raises SettingsError, which names the file and the figure and tells what there is, for a file that cannot be read, an unknown
    key, quantity, unit, kind or channel, a missing clause, and a limit that makes no sense.
    """
    where, shipped = str(path), shipped_requirements()
    if not Path(path).exists() and where in shipped:
        text = (resources.files(__package__) / "requirements" / f"{where}.toml").read_text("utf-8")
    else:
        try:
            text = Path(path).read_text("utf-8")
        except OSError as error:
            remedy = f"Give a requirement file, or one of: {', '.join(shipped)}."
            raise SettingsError(f"cannot be read ({error.strerror})", where=where, remedy=remedy) from error
        except UnicodeDecodeError as error:
            raise SettingsError("is not TOML: it is not UTF-8", where=where) from error
    try:
        requirement = msgspec.convert(tomllib.loads(text), Requirement)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"is not TOML: {error}", where=where) from error
    except msgspec.ValidationError as error:
        known = Figure if "$.figure" in str(error) else Requirement
        remedy = f"Each figure is a table headed [[figure]]; keys: {', '.join(known.__struct_fields__)}."
        raise SettingsError(str(error), where=where, remedy=remedy) from error
    check_requirement(requirement, where)
    return requirement


def check_requirement(requirement: Requirement, where: str = "requirement") -> None:
    """Raise SettingsError for figures that cannot be judged."""
    known = quantities()
    if not requirement.figure:
        raise SettingsError("has no figure", where=where, remedy="Each figure is a table headed [[figure]].")
    for name in ("name", "source", "edition"):
        if not getattr(requirement, name).strip():
            raise SettingsError(f"{name} is empty", where=where, remedy="A verdict names the document that it is about.")
    for number, figure in enumerate(requirement.figure):
        place = f"{where}: figure {number + 1} ({figure.quantity!r})"
        if not figure.clause.strip():
            raise SettingsError("clause is empty", where=place, remedy="Name the place in the document where the figure stands.")
        if figure.quantity not in known:
            raise SettingsError("there is no such quantity", where=place, remedy=f"Quantities: {', '.join(known)}.")
        dimension = known[figure.quantity]
        if dimension != "not measured" and _dimension(figure.unit) != dimension:
            units = [unit for unit, (kind, _) in _UNITS.items() if kind == dimension] or [dimension]
            raise SettingsError(f"{figure.unit!r} is no unit of it", where=place, remedy=f"Units: {', '.join(units)}.")
        limits = [limit for limit in (figure.max, figure.min) if limit is not None]
        if len(limits) != 1 or not math.isfinite(limits[0]) or limits[0] < 0:
            raise SettingsError("needs one limit, max or min, of 0 or more", where=place)
        if figure.min is not None and dimension != "not measured":
            raise SettingsError("min is no limit of an error", where=place, remedy="Give max.")
        for kind in figure.kinds:
            if kind not in KINDS:
                raise SettingsError(f"there is no kind of sensor {kind!r}", where=place, remedy=f"Kinds: {', '.join(KINDS)}.")
        for channel in figure.channels:
            if channel not in _CHANNELS:
                remedy = f"Channels: {', '.join(_CHANNELS)}."
                raise SettingsError(f"there is no channel {channel!r}", where=place, remedy=remedy)
        if figure.to_range is not None and (figure.quantity not in known or not _from_pairs(figure.quantity)):
            raise SettingsError(
                "to_range limits the pairs, and this quantity is not taken from them",
                where=place,
                remedy=f"It goes with: {', '.join(name for name in known if _from_pairs(name))}.",
            )
        if _dimension(figure.range_unit) != "length" or not (figure.to_range is None or figure.to_range > 0):
            raise SettingsError("to_range must be positive, and range_unit a unit of length", where=place)
        if not 0.5 <= figure.confidence < 1:
            raise SettingsError(
                f"confidence = {figure.confidence} is not within 0.5 … 1", where=place, remedy="For example 0.95."
            )


_CHANNELS = {channel.name.lower(): channel.value for channel in Channel}


def _from_pairs(quantity: str) -> bool:
    return quantity.removesuffix(_CORRECTED) in _OF_PAIRS


class _Measured(NamedTuple):
    """A quantity in SI with its interval; `label` is its name with the channel, `why` is filled where there is no value."""

    label: str
    value: float = _NAN
    low: float = _NAN
    high: float = _NAN
    why: str = ""


def assess_requirement(
    calibration: Calibration, residuals: Residuals | None, sensors: Sensors | None, requirement: Requirement
) -> tuple[Conformity, ...]:
    """Judge every sensor of a calibration by the figures of a requirement that are about its kind.

    Biases are those of the radar as recorded, with the intervals of the calibration (`Calibration.interval`; of a calibration
    over time, where they are largest).  Noise is net of the reference's; what is taken from the pairs holds the reference's
    errors.
    `residuals` and `sensors` may be missing: then what needs them is undecided.

    Raises SettingsError for a calibration that is relative to another radar: it says nothing of what is required.
    """
    if calibration.settings.get("main"):
        raise SettingsError(
            f"the calibration is relative to {calibration.settings['main']}, and a requirement is on the errors themselves",
            where="requirement",
            remedy="Calibrate against a reference (--reference).",
        )
    kinds = {s.key: s.kind for s in sensors or ()}
    out = []
    for summary in calibration.sensors:
        kind = kinds.get(summary.sensor)
        for figure in requirement.figure:
            if figure.kinds and kind is not None and kind not in figure.kinds:
                continue
            if figure.kinds and kind is None:
                unknown = f"the kind of {summary.name} is not known: give sensors.toml"
                found: Sequence[_Measured] = (_Measured(figure.quantity, why=unknown),)
            else:
                found = _measure(calibration, summary, residuals, figure)
            out += [_judge(requirement, figure, summary.name, measured) for measured in found]
    return tuple(out)


def _judge(requirement: Requirement, figure: Figure, sensor: str, found: _Measured) -> Conformity:
    """The verdict from the interval of the quantity's size."""
    scale = (
        _UNITS[figure.unit][1] if figure.unit in _UNITS else next(t.si_per_unit for t in TERMS.values() if t.unit == figure.unit)
    )
    limit = figure.max if figure.max is not None else figure.min
    assert limit is not None
    value, low, high = found.value / scale, found.low / scale, found.high / scale
    least = 0.0 if low <= 0 <= high else min(abs(low), abs(high))
    most = max(abs(low), abs(high))
    level = f"{100 * figure.confidence:.3g} % interval"
    verdict: Outcome = "undecided"
    if found.why:
        why = found.why
    elif most <= limit:
        verdict, why = "pass", f"the whole {level} lies within the limit"
    elif least > limit:
        verdict, why = "fail", f"the whole {level} lies beyond the limit"
    else:
        why = f"the {level} straddles the limit: more targets would decide"
    return Conformity(
        requirement=requirement.title,
        clause=figure.clause,
        sensor=sensor,
        quantity=found.label + (f" up to {figure.to_range:g} {figure.range_unit}" if figure.to_range else ""),
        unit=figure.unit,
        limit=limit,
        value=value,
        low=low,
        high=high,
        verdict=verdict,
        why=why,
    )


def _measure(calibration: Calibration, s: Summary, residuals: Residuals | None, figure: Figure) -> Sequence[_Measured]:
    """The figure's quantity for one sensor: one value, or one for each channel where the calibration has them apart."""
    name = figure.quantity
    if name in _NOT_MEASURED:
        return (_Measured(name, why=f"not measured: {_NOT_MEASURED[name]}"),)
    mine = None if residuals is None else residuals[residuals.sensor == s.sensor]
    wanted = [_CHANNELS[c] for c in figure.channels]
    about = None if mine is None else mine[np.isin(mine.channel, wanted)] if wanted else mine
    if about is not None and not len(about):
        channels = f" of channel {' or '.join(figure.channels)}" if wanted else ""
        return (_Measured(name, why=f"no plot{channels} was paired"),)
    if wanted and about is None:
        return (_Measured(name, why="which channels the plots are of is not known: residuals.parquet is missing"),)
    share = len(about) / len(mine) if about is not None and mine is not None else 1.0
    if name in TERMS:
        return _term(calibration, s, figure, share)
    if about is None:
        return (_Measured(name, why="residuals.parquet is missing"),)
    if name in _NOISE:
        if share < _MOSTLY:
            return (_Measured(name, why=_TOGETHER.format(share, " or ".join(figure.channels), "noise")),)
        return (_noise(s, about, name, figure.confidence),)
    return (_of_pairs(about, figure),)


# Channels that make up this share of a sensor's plots speak for all of them; what all share speaks for a channel of the other.
_MOSTLY, _HARDLY = 0.9, 0.1
_TOGETHER = "only {:.0%} of the plots are of channel {}, and the {} was estimated over all channels together"


def _term(calibration: Calibration, s: Summary, figure: Figure, share: float) -> Sequence[_Measured]:
    """The term by its interval; the figure's channels make up `share` of the plots."""
    mine = [k for k, key in enumerate(calibration.terms) if key.sensor == s.sensor and key.name == figure.quantity]
    shared = [k for k in mine if calibration.terms[k].channel == "all"]
    apart = [k for k in mine if calibration.terms[k].channel != "all"]
    half = calibration.interval(figure.confidence)[-1, :, 1] - calibration.value[-1]
    out = []
    for own in [*([None] if shared else []), *apart]:
        channel = "all" if own is None else calibration.terms[own].channel
        if figure.channels and own is not None and channel not in figure.channels:
            continue
        if own is None and any(calibration.terms[k].channel in figure.channels for k in apart):
            continue
        label = figure.quantity if own is None else f"{figure.quantity} ({channel})"
        if own is None and share < _HARDLY:
            out.append(_Measured(label, why=_TOGETHER.format(share, " or ".join(figure.channels), "error")))
            continue
        # A channel's own error comes on top of what all share.
        parts = [*shared, *([] if own is None else [own])]
        spread = np.sqrt(np.maximum(calibration.covariance[:, parts][:, :, parts].sum(axis=(1, 2)), 0.0))
        at = _worst(calibration.value[:, parts].sum(axis=1), spread)
        value, sd = float(calibration.value[at, parts].sum()), float(spread[at])
        wide = sd * float(half[parts[0]] / calibration.sd[-1, parts[0]]) if sd > 0 else 0.0
        label += " (its largest over time)" if len(spread) > 1 else ""
        out.append(_Measured(label, value, value - wide, value + wide))
    if out:
        return out
    why = next((n.why for n in calibration.not_determined if n.sensor == s.sensor and n.term == figure.quantity), None)
    why = f"not determined: {why}" if why else f"the model ({s.model}) has no {figure.quantity}"
    return (_Measured(figure.quantity, why=why),)


def _worst(value: FloatArray, sd: FloatArray) -> int:
    """The epoch (of k) at which an error is largest, of those at which it is about as well known as it usually is."""
    known = np.flatnonzero(sd <= 2 * np.median(sd))
    return int(known[np.abs(value[known]).argmax()])


def _noise(s: Summary, mine: Residuals, name: str, confidence: float) -> _Measured:
    """The noise of the calibration; how well it is known, from how the targets' own scatter differs.

    Successive differences within a target hold the noise and little else; their mean squares are compared over targets.
    """
    column = name.removesuffix("_noise_sd")
    value = float(getattr(s.noise, f"{column}_m" if column == "range" else f"{column}_rad"))
    if not math.isfinite(value):
        return _Measured(name, why=f"{column} is not measured")
    error = getattr(mine, f"{column}_after_m" if column == "range" else f"{column}_after_rad")
    target = _clusters(mine)
    order = np.lexsort((mine.time_s, target))
    step, own = np.diff(error[order]), target[order][1:]
    good = (np.diff(target[order]) == 0) & np.isfinite(step)
    step, own = step[good], own[good]
    if len(step) < 2:
        return _Measured(name, why="no target has two plots to compare")
    # A wrong pair must not pass for noise.
    far = 6 * 1.4826 * float(np.median(np.abs(step)))
    spread = _mean_of_squares(np.clip(step, -far, far) if far > 0 else step, own, confidence)
    if spread is None:
        return _Measured(name, why=_ONE_TARGET)
    _, relative = spread
    return _Measured(name, value, value * math.exp(-relative / 2), value * math.exp(relative / 2))


_ONE_TARGET = "only one target: how far others would differ is not known"


def _of_pairs(mine: Residuals, figure: Figure) -> _Measured:
    """A statistic of the pairs' errors, as recorded or corrected."""
    column, statistic, _ = _OF_PAIRS[figure.quantity.removesuffix(_CORRECTED)]
    when = "after" if figure.quantity.endswith(_CORRECTED) else "before"
    unit = "rad" if column in ("azimuth", "elevation") else "m"
    error: FloatArray = np.abs(getattr(mine, f"{column}_{when}_{unit}"))
    good: BoolArray = np.isfinite(error)
    if figure.to_range is not None:
        good &= mine.reference_range_m <= figure.to_range * _UNITS[figure.range_unit][1]
    if not good.any():
        return _Measured(figure.quantity, why=f"no pair has a {column} error" + (" at such ranges" if figure.to_range else ""))
    error, target = error[good], _clusters(mine)[good]
    if statistic == "rms":
        spread = _mean_of_squares(error, target, figure.confidence)
        value = math.sqrt(float(np.mean(error**2)))
        low, high = (_NAN, _NAN) if spread is None else (value * math.exp(sign * spread[1] / 2) for sign in (-1, 1))
    else:
        level = {"median": 0.5, "p95": 0.95, "p99": 0.99}[statistic]
        value = float(np.quantile(error, level))
        low, high = quantile_interval(error, target, level, figure.confidence)
    why = "" if math.isfinite(low) else _ONE_TARGET
    return _Measured(figure.quantity, value, low, high, why)


def _clusters(mine: Residuals) -> IntArray:
    """A number for each pair's target; pairs without one count by their track, else each by itself."""
    alone = np.where(mine.track >= 0, 2 * mine.track, 2 * np.arange(len(mine)) + 1)
    return np.asarray(np.where(mine.target >= 0, mine.target, -2 - alone), np.int64)


def _by_target(values: FloatArray, target: IntArray, confidence: float) -> tuple[float, float] | None:
    """The half width of the mean's interval (its targets the units) and the mean of `values`; None with one target."""
    from scipy.special import stdtrit

    _, number = np.unique(target, return_inverse=True)
    count = np.bincount(number).astype(np.float64)
    groups = len(count)
    if groups < 2:
        return None
    mean = float(values.mean())
    sums = np.bincount(number, values - mean)
    sd = math.sqrt(float(sums @ sums) * groups / (groups - 1)) / len(values)
    # Targets of unequal numbers of plots tell as much as fewer equal ones (Kish 1965).
    freedom = max(float(count.sum() ** 2 / (count @ count)) - 1.0, 1.0)
    return float(stdtrit(freedom, (1 + confidence) / 2)) * sd, mean


def _mean_of_squares(values: FloatArray, target: IntArray, confidence: float) -> tuple[float, float] | None:
    """The mean square, and the half width of its logarithm's interval; None with one target."""
    found = _by_target(values**2, target, confidence)
    if found is None:
        return None
    half, mean = found
    return mean, half / mean if mean > 0 else 0.0


def quantile_interval(values: FloatArray, target: IntArray, level: float, confidence: float) -> tuple[float, float]:
    """The interval of a quantile of `values` (n,) that come in clusters `target` (n,).

    The share of values below the quantile is a mean with a clustered sd; its interval, read off the distribution, is that of the
    quantile (Woodruff 1952).  Where the share's interval reaches 1, the quantile has no upper bound (infinite); NaN with one
    target.
    """
    spot = float(np.quantile(values, level))
    found = _by_target((values <= spot).astype(np.float64), target, confidence)
    if found is None:
        return _NAN, _NAN
    half = found[0]
    low = float(np.quantile(values, max(level - half, 0.0)))
    return low, float(np.quantile(values, level + half)) if level + half < 1 else math.inf


def conformity_json(found: Sequence[Conformity]) -> list[dict[str, object]]:
    """The verdicts as plain values: what is not known is None, an interval without an end is open there."""
    return [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in msgspec.structs.asdict(c).items()}
        for c in found
    ]


def save_conformity(found: Sequence[Conformity], path: str | Path) -> None:
    """Write the verdicts as JSON, whole or not at all.  Raises InputError where the file cannot be written."""
    write_bytes(path, msgspec.json.format(msgspec.json.encode({"conformity": conformity_json(found)}), indent=1) + b"\n")


def conformity_text(found: Sequence[Conformity]) -> str:
    """A table to read: one line a figure, and a line that counts the verdicts."""
    lines: list[str] = []
    for title in dict.fromkeys(c.requirement for c in found):
        rows = [("sensor", "quantity", "limit", "found", "interval", "unit", "verdict", "clause")]
        of = [c for c in found if c.requirement == title]
        for c in of:
            known = math.isfinite(c.value)
            value = _number(c.value, c) if known else "–"
            interval = f"{_number(c.low, c)} … {_number(c.high, c)}" if known and math.isfinite(c.low) else "–"
            rows.append((c.sensor, c.quantity, f"{c.limit:g}", value, interval, c.unit, c.verdict, c.clause))
        wide = [max(len(row[k]) for row in rows) for k in range(8)]
        left = (True, True, False, False, False, True, True, True)
        lines += ["", title] if lines else [title]
        align: list[Callable[[str, int], str]] = [str.ljust if is_left else str.rjust for is_left in left]
        lines += ["  " + "  ".join(a(cell, w) for a, cell, w in zip(align, row, wide, strict=True)).rstrip() for row in rows]
        lines += [f"  {c.sensor}, {c.quantity}: {c.why}" for c in of if c.verdict == "undecided"]
        count = {verdict: sum(c.verdict == verdict for c in of) for verdict in ("pass", "fail", "undecided")}
        lines.append(f"  {count['pass']} passed, {count['fail']} failed, {count['undecided']} undecided")
    return "\n".join(lines)


def _number(value: float, c: Conformity) -> str:
    """With a hundredth of the limit as the last digit, or finer where the interval is narrow."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "–"
    size = max(min(c.limit or 1.0, abs(c.high - c.low) if math.isfinite(c.high - c.low) and c.high > c.low else c.limit), 1e-9)
    return f"{value:.{int(np.clip(2 - math.floor(math.log10(size)), 0, 6)) if size < 100 else 0}f}"
