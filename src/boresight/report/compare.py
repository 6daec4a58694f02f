"""Two calibrations of the same radars, term by term: do they agree, and what does only one of them have?

The difference of two estimates has the sum of their covariances where they are independent.  Where they share recordings they
are alike for that reason too: the difference is then smaller than its sd says, and the test errs on the side of agreement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .._files import write_text
from .._types import FloatArray
from ..calibration import Calibration, Summary, TermKey
from ..errors import NothingToDo
from ..terms import TERMS
from . import charts
from .drawing import term_label
from .page import Markup, Numbered, count, decimals, metres, number, template, unit_text, with_unit

# A term whose difference is less likely than this by chance is said to differ.
LEVEL = 0.05
_NAN = float("nan")
_DAY_S = 86400.0


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """One term that both calibrations have, in `unit`: values and sds, second minus first with its sd, and the test.

    `p` is how likely so large a difference is by chance (Student's t); the term differs where it is below `LEVEL`.
    """

    sensor: str
    channel: str
    term: str
    unit: str
    first: float
    first_sd: float
    second: float
    second_sd: float
    difference: float
    difference_sd: float
    p: float
    agrees: bool


class Alone(msgspec.Struct, frozen=True, kw_only=True):
    """A term that one calibration has alone, in `unit`; `why` is the other's reason for not having it."""

    calibration: str
    sensor: str
    channel: str
    term: str
    unit: str
    value: float
    sd: float
    why: str


class Together(msgspec.Struct, frozen=True, kw_only=True):
    """All common terms of a sensor ("" for all sensors) at once: chi-square of the differences, its degrees of freedom and p."""

    sensor: str
    chi_square: float
    freedom: int
    p: float
    agrees: bool


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """How two calibrations compare.  `names` are what they are called, `days` the time from the first to the second.

    `shared` are the names of the recordings that went into both, `notes` what else must be known to read the figures.
    """

    names: tuple[str, str]
    days: float
    terms: tuple[Compared, ...]
    together: tuple[Together, ...]
    alone: tuple[Alone, ...]
    shared: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def overall(self) -> Together:
        """The test of all common terms of all sensors."""
        return self.together[-1]


def compare(first: Calibration, second: Calibration, names: tuple[str, str] = ("first", "second")) -> Comparison:
    """Compare two calibrations, each at its newest epoch.

    Raises NothingToDo where they have no sensor in common, and where one is relative to a radar that the other is not relative
    to.
    """
    to = [str(c.settings.get("main", "")) for c in (first, second)]
    if to[0] != to[1]:
        said = " and ".join(f"{name} is {f'relative to {m}' if m else 'absolute'}" for name, m in zip(names, to, strict=True))
        raise NothingToDo(
            f"{said}: their values cannot be compared", remedy="Compare calibrations against one reference, or one main radar."
        )
    summaries = {s.sensor: s for s in first.sensors}
    sensors = [s for s in second.sensors if s.sensor in summaries]
    if not sensors:
        have = " and ".join(f"{name} has {_names(c)}" for name, c in zip(names, (first, second), strict=True))
        raise NothingToDo(
            f"the two calibrations have no radar in common: {have}", remedy="Compare calibrations of the same SAC/SIC or id."
        )
    index = {key: k for k, key in enumerate(second.terms)}
    common = [(i, index[key]) for i, key in enumerate(first.terms) if key in index]
    keys = [first.terms[i] for i, _ in common]
    a, b = [i for i, _ in common], [j for _, j in common]
    gap = second.value[-1, b] - first.value[-1, a]
    covariance = first.covariance[-1][np.ix_(a, a)] + second.covariance[-1][np.ix_(b, b)]
    sd_a, sd_b = first.sd[-1, a], second.sd[-1, b]
    freedom = np.array([_freedom(first, second, key, x, y) for key, x, y in zip(keys, sd_a, sd_b, strict=True)])
    sd = np.sqrt(np.diagonal(covariance)) if keys else np.empty(0)
    labels = {s.sensor: s.name for s in sensors}
    terms = []
    for k, key in enumerate(keys):
        scale = TERMS[key.name].si_per_unit
        p = _two_sided(float(gap[k]), float(sd[k]), float(freedom[k]))
        terms.append(
            Compared(
                sensor=labels.get(key.sensor, str(key.sensor)), channel=key.channel, term=key.name, unit=key.unit,
                first=float(first.value[-1, a[k]] / scale), first_sd=float(sd_a[k] / scale),
                second=float(second.value[-1, b[k]] / scale), second_sd=float(sd_b[k] / scale),
                difference=float(gap[k] / scale), difference_sd=float(sd[k] / scale), p=p, agrees=not p < LEVEL,
            )
        )  # fmt: skip
    together = [
        _together(labels[s.sensor], gap, covariance, freedom, [k for k, key in enumerate(keys) if key.sensor == s.sensor])
        for s in sensors
    ]
    together.append(_together("", gap, covariance, freedom, list(range(len(keys)))))
    hashes = {i.sha256: Path(i.path).name for i in first.inputs}
    shared = tuple(dict.fromkeys(hashes[i.sha256] for i in second.inputs if i.sha256 in hashes))
    alone = [*_alone(first, second, names[0]), *_alone(second, first, names[1])]
    return Comparison(
        names=names,
        days=float(second.epoch_s[-1] - first.epoch_s[-1]) / _DAY_S,
        terms=tuple(terms),
        together=tuple(together),
        alone=tuple(alone),
        shared=shared,
        notes=tuple(_notes(summaries, sensors, first, second, names, shared)),
    )


def _names(c: Calibration) -> str:
    return ", ".join(f"{s.name} ({s.sensor >> 8}/{s.sensor & 255})" if s.sensor < 65536 else s.name for s in c.sensors) or "none"


def _effective(c: Calibration, sensor: int) -> float:
    found = next((s.effective_targets for s in c.sensors if s.sensor == sensor), _NAN)
    return max(found - 1.0, 3.0) if math.isfinite(found) else 1e6


def _freedom(first: Calibration, second: Calibration, key: TermKey, sd_a: float, sd_b: float) -> float:
    """Degrees of freedom of a difference (Welch and Satterthwaite) from the effective targets of both."""
    if sd_a <= 0 and sd_b <= 0:
        return 1e6
    parts = sd_a**4 / _effective(first, key.sensor) + sd_b**4 / _effective(second, key.sensor)
    return float((sd_a**2 + sd_b**2) ** 2 / parts)


def _two_sided(gap: float, sd: float, freedom: float) -> float:
    """How likely a difference this large is by chance; the sd is that of the t distribution, wider than its scale."""
    from scipy.special import stdtr

    if sd <= 0 or not math.isfinite(gap):
        return 1.0 if gap == 0 else 0.0 if math.isfinite(gap) else _NAN
    return float(2 * stdtr(freedom, -abs(gap) / sd * math.sqrt(freedom / (freedom - 2))))


def _together(sensor: str, gap: FloatArray, covariance: FloatArray, freedom: FloatArray, rows: Sequence[int]) -> Together:
    """Chi-square of the differences at `rows`, judged as F because the covariance is itself estimated."""
    from scipy.special import fdtrc

    known = [k for k in rows if math.isfinite(gap[k]) and covariance[k, k] > 0]
    if not known:
        return Together(sensor=sensor, chi_square=_NAN, freedom=0, p=_NAN, agrees=True)
    scale = np.sqrt(np.diagonal(covariance)[known])
    correlation = covariance[np.ix_(known, known)] / np.outer(scale, scale)
    size, axes = np.linalg.eigh((correlation + correlation.T) / 2)
    # Directions that neither knows (terms tied to each other in both) tell nothing of a difference.
    good = size > 1e-10 * size[-1]
    along = axes[:, good].T @ (gap[known] / scale)
    chi = float(np.sum(along**2 / size[good]))
    n, targets = int(good.sum()), float(np.min(freedom[known]))
    p = float(fdtrc(n, targets, chi / n * targets / (targets - 2)))
    return Together(sensor=sensor, chi_square=chi, freedom=n, p=p, agrees=not p < LEVEL)


def _alone(own: Calibration, other: Calibration, name: str) -> list[Alone]:
    theirs = {s.sensor for s in other.sensors}
    why = {(n.sensor, n.term): n.why for n in other.not_determined}
    labels = {s.sensor: s.name for s in own.sensors}
    out = []
    for k, key in enumerate(own.terms):
        if key in other.terms:
            continue
        scale = TERMS[key.name].si_per_unit
        reason = why.get((key.sensor, key.name), "its model has no such term")
        out.append(
            Alone(
                calibration=name, sensor=labels.get(key.sensor, str(key.sensor)), channel=key.channel, term=key.name,
                unit=key.unit, value=float(own.value[-1, k] / scale), sd=float(own.sd[-1, k] / scale),
                why=reason if key.sensor in theirs else "it does not have this radar",
            )
        )  # fmt: skip
    return out


def _notes(
    summaries: dict[int, Summary], sensors: Sequence[Summary], first: Calibration, second: Calibration, names: tuple[str, str],
    shared: Sequence[str],
) -> list[str]:  # fmt: skip
    out = []
    if shared:
        out.append(
            f"both were made from {', '.join(shared)}: they are not independent, the differences are smaller than their sds "
            "say, and "
            "only large disagreements are found"
        )
    for s in sensors:
        one = summaries[s.sensor]
        if one.name != s.name:
            out.append(f"{one.name} of {names[0]} is called {s.name} in {names[1]}: the same SAC/SIC or id")
        ours = {(k.channel, k.name) for k in first.terms if k.sensor == s.sensor}
        if ours != {(k.channel, k.name) for k in second.terms if k.sensor == s.sensor}:
            out.append(f"{s.name}: the models have different terms; what one leaves out, its other terms have taken up")
    out += [f"{name} has {len(c.epoch_s)} epochs: the newest is compared" for name, c in zip(names, (first, second), strict=True)
            if len(c.epoch_s) > 1]  # fmt: skip
    return out


# ----------------------------------------------------------------------------------------------------------------- in words


def conclusion(c: Comparison) -> str:
    """Whether the two agree, in a sentence."""
    if not c.terms:
        return "The two calibrations have no term in common."
    differ = [t for t in c.terms if not t.agrees]
    # Of many terms one in twenty differs by chance: all of them together decide.
    if c.overall.agrees:
        if not differ:
            return f"The two calibrations agree in all {len(c.terms)} common terms."
        named = ", ".join(dict.fromkeys(_label(c, t) for t in differ))
        return (
            f"The two calibrations agree as a whole; {named} alone would be taken to differ, as one term in twenty is by chance."
        )
    if not differ:
        return "The two calibrations differ by more than chance, though no term by itself does: look at terms that hang together."
    return f"The two calibrations differ by more than chance, in {', '.join(dict.fromkeys(_label(c, t) for t in differ))}."


def drift(c: Comparison) -> list[str]:
    """What has changed from the one to the other, a sentence a term that differs."""
    days = abs(c.days)
    span = f"{days:.1f} days" if days >= 2 else f"{24 * days:.1f} hours"
    out = []
    for t in c.terms:
        if t.agrees or not math.isfinite(t.p):
            continue
        places = decimals(t.difference_sd)
        amount = with_unit(number(abs(t.difference), places), t.unit)
        moved, sd = "rose" if t.difference > 0 else "fell", with_unit(number(t.difference_sd, places), t.unit)
        text = f"{_label(c, t)} {moved} by {amount} ± {sd}"
        if days >= 1:
            rate, rate_sd = t.difference / c.days, t.difference_sd / days
            there = decimals(rate_sd)
            text += f" in {span}: {number(rate, there, sign=True)} ± {with_unit(number(rate_sd, there), t.unit)} a day"
        elif days > 0.01:
            text += f" within {span}"
        out.append(f"{text} (p = {t.p:.2g}).")
    if out and c.days < -0.01:
        out.append(f"The second calibration, {c.names[1]}, is the older one: read the signs backwards in time.")
    return out


def _label(c: Comparison, t: Compared | Alone) -> str:
    text = term_label(t.term) + ("" if t.channel == "all" else f" ({term_label(t.channel)})")
    return f"{t.sensor}: {text}" if len({one.sensor for one in c.terms}) > 1 else text


def comparison_text(c: Comparison) -> str:
    """The comparison as a table to read."""
    rows: list[tuple[str, ...]] = [("term", c.names[0], c.names[1], "difference", "unit", "p", "")]
    for t in c.terms:
        places = decimals(t.difference_sd)
        values = [f"{v:+.{places}f} ± {s:.{places}f}"
                  for v, s in ((t.first, t.first_sd), (t.second, t.second_sd), (t.difference, t.difference_sd))]  # fmt: skip
        rows.append((_label(c, t), *values, t.unit, f"{t.p:.2g}", "" if t.agrees else "differs"))
    wide = [max(len(row[k]) for row in rows) for k in range(7)]
    lines = [
        "  ".join(f"{text:<{w}}" if k in (0, 4, 6) else f"{text:>{w}}" for k, (text, w) in enumerate(zip(row, wide, strict=True)))
        for row in rows
    ]
    lines += [f"only in {a.calibration}: {_label(c, a)}: {a.value:.4g} ± {a.sd:.2g} {a.unit} ({a.why})" for a in c.alone]
    if c.overall.freedom:
        lines.append(f"chi-square {c.overall.chi_square:.1f} of {c.overall.freedom}, p = {c.overall.p:.2g}")
    lines += [conclusion(c), *drift(c)]
    return "\n".join([*(line.rstrip() for line in lines), *(f"note: {note}" for note in c.notes)])


def comparison_json(c: Comparison) -> dict[str, Any]:
    """The comparison for programs: units as in calibration.json, not-a-number as null."""
    return {"agrees": c.overall.agrees, "conclusion": conclusion(c), "drift": drift(c), **msgspec.to_builtins(c)}


def write_comparison(path: str | Path, first: Calibration, second: Calibration, names: tuple[str, str]) -> Comparison:
    """Write the comparison of two calibrations as one self-contained HTML file, and return it.

    The same calibrations give the same bytes.  Raises NothingToDo where they have no radar in common, InputError where the file
    cannot be written.
    """
    c = compare(first, second, names)
    write_text(path, render_comparison(c, first, second))
    return c


def render_comparison(c: Comparison, first: Calibration, second: Calibration) -> str:
    """The page of `write_comparison` as text."""
    forest = charts.forest_figure(
        [charts.Forest(_label(c, t), unit_text(t.unit), t.first, t.first_sd, t.second, t.second_sd, t.agrees) for t in c.terms],
        c.names,
        "forest",
    )
    drawn = Numbered()
    text: str = template("compare.html").render(
        title="Comparison of two calibrations",
        names=c.names,
        version=second.version or first.version,
        conclusion=conclusion(c),
        drift=drift(c),
        agrees=c.overall.agrees,
        terms=[_row(c, t) for t in c.terms],
        several=len({t.sensor for t in c.terms}) > 1,
        together=[_test(t) for t in c.together if t.freedom and (len(c.together) > 2 or not t.sensor)],
        alone=[_alone_row(a) for a in c.alone],
        notes=c.notes,
        forest=drawn.add(forest),
        sides=[_side(name, found) for name, found in zip(c.names, (first, second), strict=True)],
        shared={i.sha256 for i in first.inputs} & {i.sha256 for i in second.inputs},
        level=LEVEL,
        markup=Markup(),
    )
    return text


def _row(c: Comparison, t: Compared) -> dict[str, Any]:
    places = decimals(t.difference_sd)
    return {
        "sensor": t.sensor,
        "term": term_label(t.term) + ("" if t.channel == "all" else f" ({term_label(t.channel)})"),
        "values": [(number(v, places, sign=True), number(s, places)) for v, s in
                   ((t.first, t.first_sd), (t.second, t.second_sd), (t.difference, t.difference_sd))],
        "apart": number(t.difference / t.difference_sd, 1, sign=True) if t.difference_sd > 0 else "–",
        "p": _chance(t.p),
        "unit": unit_text(t.unit),
        "agrees": t.agrees,
    }  # fmt: skip


def _chance(p: float) -> str:
    if not math.isfinite(p):
        return "–"
    return f"{p:.3f}" if p >= 0.001 else "< 0.001"


def _test(t: Together) -> dict[str, str | bool]:
    return {
        "sensor": t.sensor or "all radars together",
        "chi": number(t.chi_square, 1),
        "freedom": str(t.freedom),
        "p": _chance(t.p),
        "agrees": t.agrees,
    }


def _alone_row(a: Alone) -> dict[str, str]:
    places = decimals(a.sd)
    return {
        "calibration": a.calibration,
        "sensor": a.sensor,
        "term": term_label(a.term) + ("" if a.channel == "all" else f" ({term_label(a.channel)})"),
        "value": f"{number(a.value, places, sign=True)} ± {number(a.sd, places)}",
        "unit": unit_text(a.unit),
        "why": a.why,
    }


def _side(name: str, c: Calibration) -> dict[str, Any]:
    """What a calibration was made from and how well it did."""
    stamp = datetime.fromtimestamp(float(c.epoch_s[-1]), UTC) if len(c.epoch_s) else None
    return {
        "name": name,
        "epoch": f"{stamp:%Y-%m-%d %H:%M:%S} UTC" if stamp is not None and c.epoch_s[-1] >= _DAY_S else "day unknown",
        "version": c.version,
        "sensors": [
            {
                "name": s.name, "model": s.model, "plots": count(s.plots), "targets": count(s.targets),
                "before": metres(s.before.median_m) if math.isfinite(s.before.median_m) else "–",
                "after": metres(s.after.median_m) if math.isfinite(s.after.median_m) else "–",
                "held": metres(s.held_out_after_median_m) if math.isfinite(s.held_out_after_median_m) else "–",
                "range": number(s.noise.range_m, 1), "azimuth": number(float(np.degrees(s.noise.azimuth_rad)), 3),
            }
            for s in c.sensors
        ],
        "inputs": [{"name": Path(i.path).name, "bytes": i.bytes, "sha256": i.sha256} for i in c.inputs],
    }  # fmt: skip
