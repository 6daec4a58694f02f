"""The page: numbers in words and tables around the figures, as one HTML file that needs no network."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._files import write_text
from .._types import FloatArray
from ..terms import TERMS, Geometry, Whose, table_of, term_of, touches
from . import charts, figures
from .drawing import MAX_PAIRS, Drawing, group_quantiles, sample, term_label
from .over_time import bias_figure

if TYPE_CHECKING:
    from ..assessment.requirement import Conformity
    from ..assessment.residuals import Residuals
    from ..association import Association
    from ..calibration import Calibration, Summary, TermKey, Verdict
    from ..heights import HeightProfile
    from ..model import Sensors
    from ..registration.mean_shift import Samples
    from .evidence import Clock, Evidence

_MINUS = "\u2212"
_THIN = "\u202f"

# What a positive and a negative value mean, for the sentence that opens the report: {} is the amount with its unit.
_WORDS: dict[str, tuple[str, str]] = {
    "range_bias": ("measures ranges {} too long", "measures ranges {} too short"),
    "range_gain": ("stretches ranges by {}", "shrinks ranges by {}"),
    "azimuth_bias": ("reads azimuths {} too far clockwise", "reads azimuths {} too far anticlockwise"),
    "elevation_bias": ("reads elevations {} too high", "reads elevations {} too low"),
    "time_offset": ("stamps its plots {} late", "stamps its plots {} early"),
    "site_east": ("stands {} east of the position given", "stands {} west of the position given"),
    "site_north": ("stands {} north of the position given", "stands {} south of the position given"),
    "site_up": ("stands {} above the height given", "stands {} below the height given"),
    "along_heading": (
        "sees echoes {} ahead of the reference's antenna on the target",
        "sees echoes {} behind the reference's antenna on the target",
    ),
    "along_heading_per_length": (
        "sees echoes ahead of the reference's antenna by {} of the target's length",
        "sees echoes behind the reference's antenna by {} of the target's length",
    ),
    "tilt_north": (
        "leans so that elevations in the north are {} too high",
        "leans so that elevations in the north are {} too low",
    ),
    "tilt_east": ("leans so that elevations in the east are {} too high", "leans so that elevations in the east are {} too low"),
    "rotation_up": ("turns the picture {} anticlockwise", "turns the picture {} clockwise"),
    "rotation_east": (
        "turns the picture {} about the east axis (up in the north)",
        "turns the picture {} about the east axis (down in the north)",
    ),
    "rotation_north": (
        "turns the picture {} about the north axis (down in the east)",
        "turns the picture {} about the north axis (up in the east)",
    ),
}

# Why a plot took no part, in words that need no knowledge of the program.
_REASONS = {
    "flag": "marked by the radar as simulated, test, garbled, reflection, side lobe, second-time-around, monitor or extrapolated",
    "NaN": "without a usable time, range or azimuth",
    "no sensor": "of a sensor that sensors.toml does not name",
    "out of limits": "outside the sensor's range limits",
    "duplicate": "the same measurement twice",
    "airborne": "of targets in the air (a surface radar is judged by those on the ground)",
    "parked": "of targets that do not move",
    "no reference at that time": "no reference position near enough in time",
    "unassigned track": "of tracks for which no reference target was found",
    "outside the gate": "farther from the reference than the gate allows",
}

_KINDS = {
    "psr": "primary radar",
    "ssr": "secondary radar",
    "combined": "combined primary and secondary radar",
    "mode_s": "Mode S radar",
    "surface": "surface movement radar",
    "marine": "marine radar",
    "mlat": "multilateration",
    "adsb": "ADS-B",
    "ais": "AIS",
    "system": "system tracks",
}

# What each method of registration is, for who is handed the report.
METHODS_ABOUT = {
    "least-squares": "the values of all errors together that leave the least of the plots' differences from the reference, with "
    "outliers held down.",
    "per-channel": "range, azimuth and elevation each by itself, with a linear model of up to the second order.",
    "maximum-likelihood": "one constant error of each axis, and a noise, that make the differences from the reference likeliest.",
    "kalman-transform": "a matrix that turns, shifts and stretches the picture onto the reference, followed by a Kalman filter.",
    "ransac-icp": "one turn and one shift of the whole picture: random samples give a start, and closest points refine it.",
    "genetic": "one turn and one shift of the whole picture, the best of many generations bred from those of single tracks.",
    "kalman-bank": "biases followed over time by a bank of Kalman filters, each with a memory of its own, mixed by how well they "
    "predict.",
    "igmsr": "biases followed over time as the place where the differences gather most, the newer ones counting more.",
    "mean-shift": "biases as the place where the differences gather most, over all that has been seen so far.",
    "alpha-beta": "biases followed over time by a filter of fixed gains, the simplest one there is.",
    "exponential-average": "biases over time as averages of the differences, the newer ones counting more.",
}

# What the settings of an estimate mean, for who is handed the report.
_SETTINGS = {
    "method": "how the errors were estimated",
    "soft_sd": "a pair within so many standard deviations has its full weight",
    "hard_sd": "a pair beyond so many standard deviations has none",
    "max_correlation": "two terms that correlate by this or more are not told apart",
    "rank_tolerance": "a term of which less than this share is left beside the others is not determined",
    "well_known": "a term known to better than this part of what is plausible stays in spite of its correlation",
    "short_block_s": "quick errors of a target are taken as constant over so many seconds (0: by the kind of sensor)",
    "long_block_s": "slow errors of a target are taken as constant over so many seconds (0: by the kind of sensor)",
    "agreement": "probability below which the weights of a target's plots count as wrong, and every plot counts for itself",
    "criterion": "by what the terms of a model are chosen where none is given",
    "max_iterations": "steps that the estimate may take",
    "kind": "what the values are",
    "online": "biases were followed over time",
    "select": "by what the order of each channel is chosen",
    "gate_sd": "a pair further off than so many standard deviations takes no part",
    "iterations": "random samples that were tried",
    "distance_m": "a pair further apart than this after a trial does not support it",
    "inlier_share": "share of supporting pairs at which trials end",
    "pairing": "what is paired: positions at one time, or those that are nearest",
    "max_refinements": "refinements that the start may get",
    "population": "transforms in a generation",
    "generations": "generations that may be bred",
    "seed": "where random choices begin: the same seed gives the same result",
    "memory_s": "how far back is remembered, seconds",
    "members": "filters in the bank, from the fastest to the slowest",
    "judged_s": "filters are mixed by how well they predicted over so many seconds",
    "huber": "a difference beyond so many standard deviations counts by its sign",
    "reject": "a difference beyond so many standard deviations does not count",
    "streak": "so many on one side are taken for a step",
    "tau_s": "a difference this many seconds old counts for a third (1/e)",
    "model": "the order of the models, or that of range, azimuth and elevation",
    "jerk": "lags with the third derivatives are in the models",
    "parallax": "a shift of the antenna is in the models",
    "tolerance": "a column of which less than this share is left beside the others is dropped",
    "ridge": "what is added to the normal equations, so that they can be solved",
    "sd_m": "what one difference from the reference is taken to be known by",
    "prior_sd_m": "what is assumed of the entries of the matrix beforehand",
    "slot_s": "differences of so many seconds are taken as one",
    "tracking_index": "how fast the bias is taken to change, against its noise: sets alpha and beta where they are 0",
    "alpha": "share of a difference that goes into the bias",
    "beta": "share of a difference that goes into its rate",
    "bandwidth": "differences nearer than so many of their standard deviations gather",
    "multi_start": "several starts are searched from, so that a crowd of outliers does not hold the search",
    "main": "the radar that the others are compared with",
}

GLOSSARY: tuple[tuple[str, str], ...] = (
    ("bias", "measured minus true. The correction is its opposite."),
    ("range error", "positive: the radar measures too long a distance."),
    ("azimuth error", "positive: the radar points too far clockwise, seen from above, from true north."),
    ("elevation error", "positive: the radar points too high."),
    ("time offset", "stamp minus true time. Positive: plots are stamped late, and lie behind where the target is at the stamp."),
    ("along heading", "positive: the echo lies ahead of the reference's antenna on the target; negative: behind it."),
    ("sd", "standard deviation of an estimate (1 sigma), with plots of one target counted as dependent."),
    ("95 % interval", "the true value lies in it in 95 of 100 such calibrations (by Student's t for the number of targets)."),
    ("random error", "scatter of single plots, without the systematic errors and without the reference's own uncertainty."),
    ("held out", "errors of targets that took no part in the estimate with which they were corrected."),
    ("distance", "horizontal distance between plot and reference, with the plot put at the reference's height."),
    ("apply", "the term improves targets that took no part in the estimate: take it out of the plots."),
    ("hold", "the term is known, but taking it out does not clearly improve anything: leave it in."),
    ("insufficient", "the data cannot tell whether taking it out would improve or spoil: record more before deciding."),
    ("PSR − SSR", "where the primary radar saw a target, less where the secondary radar did."),
    ("robust sd", "1.4826 times the median absolute deviation: the sd without the say of outliers."),
)


def write_report(
    path: str | Path,
    calibration: Calibration,
    residuals: Residuals,
    sensors: Sensors,
    *,
    title: str,
    truth: Mapping[str, Mapping[str, float]] | None = None,
    warnings: Sequence[str] = (),
    association: Association | None = None,
    targets: Mapping[int, str] | None = None,
    reference: Sequence[str] = (),
    evidence: Evidence | None = None,
    conformity: Sequence[Conformity] = (),
    heights: HeightProfile | None = None,
    samples: Mapping[int, Samples] | None = None,
) -> Path:
    """Write the report of a calibration as one self-contained HTML file, and return its path.

    `truth` holds the true values of a simulated scene, sensor name -> term -> value in the term's unit.  `warnings` come on
    top of the calibration's own.  `association` gives the plots not used and the coarse biases.  `targets` names the targets
    (number -> address or callsign); `reference` are the paths among the inputs that are the reference.  `evidence` is what the
    recordings tell besides the pairs (`gather`), `conformity` the verdicts on requirements, `heights` what stood for unknown
    heights, `samples` the single differences that errors over time were found from, by sensor.  The file is written beside and
    then renamed; the same arguments give the same bytes.

    Raises InputError where the file cannot be written.
    """
    text = render(
        calibration, residuals, sensors, title=title, truth=truth, warnings=warnings, association=association, targets=targets,
        reference=reference, evidence=evidence, conformity=conformity, heights=heights, samples=samples,
    )  # fmt: skip
    target = Path(path)
    write_text(target, text)
    return target


def render(
    calibration: Calibration,
    residuals: Residuals,
    sensors: Sensors,
    *,
    title: str,
    truth: Mapping[str, Mapping[str, float]] | None = None,
    warnings: Sequence[str] = (),
    association: Association | None = None,
    targets: Mapping[int, str] | None = None,
    reference: Sequence[str] = (),
    evidence: Evidence | None = None,
    conformity: Sequence[Conformity] = (),
    heights: HeightProfile | None = None,
    samples: Mapping[int, Samples] | None = None,
) -> str:
    """The report of `write_report` as text."""
    truth = truth or {}
    drawn = Numbered()
    names = unique_names(targets or {})
    sections = [
        _section(
            calibration,
            summary,
            residuals[residuals.sensor == summary.sensor],
            sensors,
            truth.get(summary.name, {}),
            drawn,
            names,
            evidence,
            [c for c in conformity if c.sensor == summary.name],
            (samples or {}).get(summary.sensor),
        )
        for summary in calibration.sensors
    ]
    sensor_names = {s.sensor: s.name for s in calibration.sensors}
    correlation = drawn.add(figures.correlation_figure(calibration, "correlation", sensor_names))
    alarming, telling = messages([_short(text, calibration) for text in dict.fromkeys([*warnings, *calibration.warnings])])
    text: str = template("template.html").render(
        title=title,
        version=calibration.version,
        sections=sections,
        correlation=correlation,
        heights=drawn.add(charts.height_figure(heights, "heights")) if heights is not None else None,
        simulated=bool(truth),
        warnings=alarming,
        information=telling,
        unused=_unused(association),
        used=len(residuals),
        coarse=_coarse(association),
        inputs=[{"file": i, "role": "reference" if i.path in reference else "radar"} for i in calibration.inputs],
        roles=bool(reference),
        sites=_sites(calibration, sensors),
        settings=[
            (name, _plain(value), _SETTINGS.get(name.rpartition(".")[2], "")) for name, value in calibration.settings.items()
        ],
        span=_time_span(residuals.time_s),
        glossary=GLOSSARY,
        epochs=len(calibration.epoch_s),
        against=calibration.against,
        relative=_relative(calibration),
        method=_method(calibration),
        markup=Markup(),
    )
    return text


def template(name: str) -> Any:
    """A template of this package, with what all pages share."""
    from importlib.resources import files

    import jinja2

    folder = files(__package__)
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda part: (folder / part).read_text(encoding="utf-8")),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["count"] = count
    environment.filters["words"] = term_label
    return environment.get_template(name)


class Markup:
    """What the template may put in unescaped: only drawings made here."""

    def __call__(self, svg: str) -> Any:
        import markupsafe

        return markupsafe.Markup(svg)


class Numbered:
    """Counts the figures of a page."""

    def __init__(self) -> None:
        self.number = 0

    def add(self, drawing: Drawing | None) -> dict[str, Any] | None:
        if drawing is None:
            return None
        self.number += 1
        return {"number": self.number, "name": drawing.name, "svg": drawing.svg, "caption": drawing.caption, "alt": drawing.alt}


# ------------------------------------------------------------------------------------------------------------ numbers in words


def count(n: int) -> str:
    """A whole number with its thousands apart."""
    return f"{n:,}".replace(",", _THIN)


def decimals(sd: float) -> int:
    """Decimal places that show a standard deviation to two significant digits."""
    if not np.isfinite(sd) or sd <= 0:
        return 3
    places = 1 - int(np.floor(np.log10(sd)))
    if round(sd, places) >= 10.0 ** (2 - places):  # 0.0996 is 0.10, not 0.100
        places -= 1
    return max(0, min(places, 9))


def number(value: float, places: int, *, sign: bool = False) -> str:
    """A number with a proper minus sign; NaN is a dash."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:+.{places}f}" if sign else f"{value:.{places}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", _MINUS)


def metres(value: float) -> str:
    """A distance in metres to three digits or a decimetre."""
    return count(round(value)) if abs(value) >= 100 else number(value, 1)


def unit_text(unit: str) -> str:
    """The unit as it is printed."""
    return {"deg": "°"}.get(unit, unit)


def with_unit(text: str, unit: str) -> str:
    """A printed number and its unit; a degree sign takes no space."""
    return f"{text}°" if unit == "deg" else f"{text}{_THIN}{unit}"


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table of terms; texts are ready to print."""

    name: str
    channel: str
    value: str
    sd: str
    low: str
    high: str
    unit: str
    meaning: str
    significant: bool
    true: str
    off: str
    far: bool
    decision: str
    gain: str
    why: str
    table: str = ""
    over: str = ""


def brief(rows: Sequence[Row]) -> list[Row]:
    """The rows with one for all nodes of a table: its value and sd are the least and the most of them."""
    out: list[Row] = []
    for row in rows:
        mine = [r for r in rows if r.table == row.table] if row.table else [row]
        if mine[0] is not row:
            continue
        if row.table:
            numbers = sorted(mine, key=lambda r: float(r.value.replace(_MINUS, "-")) if r.value != "–" else 0.0)
            decisions = {r.decision for r in mine}
            row = replace(
                row, name=f"{row.table.partition('@')[0]}, {len(mine)} nodes", value=f"{numbers[0].value} … {numbers[-1].value}",
                sd=max((r.sd for r in mine), key=len), significant=any(r.significant for r in mine), why="",
                decision=decisions.pop() if len(decisions) == 1 else "", table="",
            )  # fmt: skip
        out.append(row)
    return out


def rows_of(calibration: Calibration, summary: Summary, truth: Mapping[str, float]) -> list[Row]:
    """The terms of one sensor in the units people read, in the calibration's order; the newest epoch."""
    out = []
    interval = calibration.interval(0.95)[-1]
    verdicts = {(v.channel, v.term): v for v in summary.verdicts}
    for k, key in enumerate(calibration.terms):
        if key.sensor != summary.sensor:
            continue
        advice = verdicts.pop((key.channel, key.name), None)
        scale = TERMS[key.name].si_per_unit
        value, sd = float(calibration.value[-1, k]) / scale, float(calibration.sd[-1, k]) / scale
        low, high = (float(v) / scale for v in interval[k])
        places = decimals(sd)
        true = truth.get(key.name, float("nan"))
        off = (value - true) / sd if sd > 0 else float("nan")
        out.append(
            Row(
                name=key.name,
                channel="" if key.channel == "all" else key.channel,
                value=number(value, places, sign=True),
                sd=number(sd, places),
                low=number(low, places, sign=True),
                high=number(high, places, sign=True),
                unit=unit_text(key.unit),
                meaning=TERMS[key.name].meaning,
                significant=bool(low > 0 or high < 0),
                true=number(true, places, sign=True),
                off=number(off, 1, sign=True),
                far=bool(abs(off) > 3),
                decision=advice.decision if advice else "",
                gain=_gain(advice) if advice else "",
                why=advice.why if advice else "",
                table=table_of(term_of(key.name)),
                over=_span_text(calibration.value[:, k] / scale, calibration.sd[:, k] / scale, places),
            )
        )
    # Terms that were looked at and have no number.
    for (channel, name), advice in verdicts.items():
        out.append(
            Row(
                name=name, channel="" if channel == "all" else channel, value="–", sd="–", low="–", high="–",
                unit=unit_text(TERMS[name].unit) if name in TERMS else "",
                meaning=TERMS[name].meaning if name in TERMS else "", significant=False,
                true=number(truth.get(name, math.nan), 3, sign=True), off="–", far=False, decision=advice.decision,
                gain=_gain(advice), why=advice.why,
            )
        )  # fmt: skip
    return out


def _span_text(values: FloatArray, sd: FloatArray, places: int) -> str:
    """The least and the most of an error over time, where it is about as well known as usual; "" where it does not change."""
    if not np.ptp(values) > 0:
        return ""
    known = values[sd <= 2 * np.median(sd)]
    return f"{number(float(known.min()), places, sign=True)} … {number(float(known.max()), places, sign=True)}"


def _gain(advice: Verdict) -> str:
    if not np.isfinite(advice.gain_m):
        return ""
    if not np.isfinite(advice.gain_low_m + advice.gain_high_m):
        return number(advice.gain_m, 2, sign=True)
    places = decimals(max(advice.gain_high_m - advice.gain_low_m, 0.04) / 4)
    low, high = (number(v, places, sign=True) for v in (advice.gain_low_m, advice.gain_high_m))
    return f"{number(advice.gain_m, places, sign=True)} ({low} … {high})"


def verdict(calibration: Calibration, summary: Summary) -> tuple[str, str]:
    """What is wrong with a sensor, in a sentence; and a second one on what could not be told from zero (or "")."""
    interval = calibration.interval(0.95)[-1]
    wrong: list[tuple[float, str]] = []
    nothing: list[str] = []
    swing = np.zeros(2)
    significant_swing = False
    for k, key in enumerate(calibration.terms):
        if key.sensor != summary.sensor:
            continue
        term = TERMS[key.name]
        if table_of(term):
            continue
        value, sd = float(calibration.value[-1, k]) / term.si_per_unit, float(calibration.sd[-1, k]) / term.si_per_unit
        if not np.isfinite(value):
            continue
        on = "" if key.channel == "all" else f" ({key.channel.replace('_', ' ')})"
        significant = bool(interval[k, 0] > 0 or interval[k, 1] < 0)
        if key.name in ("azimuth_cos", "azimuth_sin"):
            swing[int(key.name == "azimuth_sin")] = value
            significant_swing = significant_swing or significant
        if not significant:
            amount = f"{number(value, decimals(sd), sign=True)} ± {with_unit(number(sd, decimals(sd)), key.unit)}"
            nothing.append(f"{term_label(key.name)}{on} ({amount})")
            continue
        # In a sentence, three digits are enough, and no more than the uncertainty allows.
        digits = max(0, min(decimals(sd), 2 - int(np.floor(np.log10(abs(value))))))
        amount = with_unit(number(abs(value), digits), key.unit)
        if key.name == "along_heading_per_length":
            amount = f"{number(100 * abs(value), 0)}{_THIN}%"
        if key.name in _WORDS:
            wrong.append((abs(value) / sd, _WORDS[key.name][value < 0].format(amount) + on))
        elif key.name not in ("azimuth_cos", "azimuth_sin"):
            signed = with_unit(number(value, decimals(sd), sign=True), key.unit)
            article = "an" if key.name[0] in "aeiou" else "a"
            wrong.append((abs(value) / sd, f"has {article} {term_label(key.name)} of {signed}{on}"))
    if significant_swing:
        size = float(np.hypot(*swing))
        worst = np.degrees(np.arctan2(swing[1], swing[0])) % 360
        wrong.append((0.0, f"swings by ±{number(size, 3)}° of azimuth in every turn (most clockwise at {number(worst, 0)}°)"))
    main = calibration.settings.get("main")
    parts = ["at the end of the recording"] if len(calibration.epoch_s) > 1 else []
    parts += [f"compared with {main}"] if main else []
    lead = ", ".join([*parts, summary.name])
    lead = lead if not parts else lead[0].upper() + lead[1:]
    if wrong:
        first = f"{lead} {_list([text for _, text in wrong])}."
    else:
        first = f"{lead} shows no error that these data can tell from zero."
    second = f"Not distinguishable from zero (at 95 %): {_list(nothing)}." if nothing else ""
    return first, second


def _list(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _relative(calibration: Calibration) -> dict[str, Any] | None:
    """What a report of radars without a reference says of itself: the main radar, and what of it could not be determined."""
    main = calibration.settings.get("main")
    if not main:
        return None
    known = {s.sensor for s in calibration.sensors}
    missed = [n for n in calibration.not_determined if n.sensor not in known]
    return {"main": main, "terms": [n.term for n in missed], "why": missed[0].why if missed else ""}


def _method(calibration: Calibration) -> dict[str, str] | None:
    """The name of the method, and what it is in a sentence; None for a calibration that does not tell."""
    name = calibration.settings.get("method")
    if not isinstance(name, str) or name not in METHODS_ABOUT:
        return None
    about = METHODS_ABOUT[name]
    if name == "least-squares" and calibration.settings.get("online"):
        about = f"{about[:-1]}; range, azimuth and elevation bias are then followed over time by a bank of Kalman filters."
    return {"name": name, "about": about}


def gain_text(summary: Summary, against: str = "the reference") -> str:
    """What correction does to the horizontal distance, in a sentence."""
    before, after = summary.before.median_m, summary.after.median_m
    if not (np.isfinite(before) and np.isfinite(after)):
        return ""
    text = f"Corrected, half of its plots lie within {metres(after)} m of {against} instead of {metres(before)} m"
    held_before, held_after = summary.held_out_before_median_m, summary.held_out_after_median_m
    if np.isfinite(held_before) and np.isfinite(held_after):
        ratio = held_before / held_after if held_after > 0 else float("inf")
        if ratio >= 1.05:
            text += (
                f"; on targets that took no part in the estimate it is {metres(held_after)} m, {number(ratio, 1)} times better"
            )
        else:
            text += f"; on targets that took no part in the estimate it is {metres(held_after)} m,"
            text += f" no better than before ({metres(held_before)} m)"
    return text + "."


def _accuracy_rows(summary: Summary) -> list[dict[str, Any]]:
    rows = [
        ("median", summary.before.median_m, summary.after.median_m),
        ("95 % within", summary.before.p95_m, summary.after.p95_m),
        ("median, held out", summary.held_out_before_median_m, summary.held_out_after_median_m),
        ("95 % within, held out", summary.held_out_before_p95_m, summary.held_out_after_p95_m),
    ]
    known = [v for _, *pair in rows for v in pair if np.isfinite(v)]
    longest = max(known, default=1.0) or 1.0
    return [
        {
            "what": what,
            "before": metres(before),
            "after": metres(after),
            "before_share": round(100 * before / longest, 1),
            "after_share": round(100 * after / longest, 1),
        }
        for what, before, after in rows
        if np.isfinite(before) and np.isfinite(after)
    ]


def _time_span(time_s: FloatArray) -> str:
    known = time_s[np.isfinite(time_s)]
    if not len(known):
        return ""
    first, last = float(known.min()), float(known.max())
    start, end = datetime.fromtimestamp(first, UTC), datetime.fromtimestamp(last, UTC)
    minutes = (last - first) / 60
    long = f"{minutes / 60:.1f} h" if minutes >= 120 else f"{minutes:.0f} min" if minutes >= 2 else f"{last - first:.0f} s"
    if first < 86400:
        return f"{start:%H:%M:%S} to {end:%H:%M:%S} UTC (day unknown), {long}"
    to = f"{end:%H:%M:%S}" if start.date() == end.date() else f"{end:%Y-%m-%d %H:%M:%S}"
    return f"{start:%Y-%m-%d %H:%M:%S} to {to} UTC, {long}"


def _short(text: str, calibration: Calibration) -> str:
    """A warning with the names of files instead of their paths: a report is handed on."""
    for given in sorted({i.path for i in calibration.inputs}, key=len, reverse=True):
        text = text.replace(given, Path(given).name)
    return text


def _source(key: int) -> str:
    return f"SAC/SIC {key >> 8}/{key & 255}" if key < 65536 else f"id {key}"


def _sites(calibration: Calibration, sensors: Sensors) -> list[dict[str, str]]:
    """Where the sensors were taken to stand, and what was given of them."""
    out = []
    for summary in calibration.sensors:
        s = sensors.find(summary.sensor)
        if s is None:
            continue
        place = "not given"
        if s.lat_deg is not None and s.lon_deg is not None:
            place = f"{number(s.lat_deg, 6)}°, {number(s.lon_deg, 6)}°"
        out.append({
            "name": s.name,
            "source": _source(summary.sensor),
            "kind": _KINDS.get(s.kind, s.kind),
            "position": place,
            "height": number(math.nan if s.ellipsoidal_height_m is None else s.ellipsoidal_height_m, 1),
            "scan": number(math.nan if s.scan_s is None else s.scan_s, 2),
            "clock": number(s.time_offset_s, 3, sign=True),
        })  # fmt: skip
    return out


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


def _unused(association: Association | None) -> list[tuple[int, str, str]]:
    if association is None:
        return []
    counted = sorted(association.not_used.items(), key=lambda item: -item[1])
    return [(n, reason, _REASONS.get(reason, reason)) for reason, n in counted]


def _coarse(association: Association | None) -> list[dict[str, str]]:
    if association is None:
        return []
    return [
        {
            "name": bias.name,
            "range": number(bias.range_m, 0, sign=True),
            "azimuth": number(float(np.degrees(bias.azimuth_rad)), 2, sign=True),
            "time": number(bias.time_s, 2, sign=True),
            "by": bias.by,
            "score": f"{number(bias.score, 0)} of {count(bias.tracks)}",
            "chance": number(bias.chance, 0),
        }
        for bias in association.bias
    ]


def _section(
    calibration: Calibration,
    summary: Summary,
    r: Residuals,
    sensors: Sensors,
    truth: Mapping[str, float],
    drawn: Numbered,
    targets: Mapping[int, str],
    evidence: Evidence | None,
    conformity: Sequence[Conformity],
    samples: Samples | None,
) -> dict[str, Any]:
    """Everything that the template needs of one sensor."""
    slug = f"sensor-{summary.sensor}"
    chosen = r.take(sample(len(r), MAX_PAIRS)) if len(r) > MAX_PAIRS else r
    sensor = sensors.find(summary.sensor)

    def add(maker: Callable[[str], Drawing | None], kind: str) -> dict[str, Any] | None:
        return drawn.add(maker(f"{slug}-{kind}"))

    over_time = add(partial(bias_figure, calibration, samples, summary.sensor), "over-time")
    advice = add(partial(charts.gain_figure, summary.verdicts), "gain")
    seen = tuple((_trimmed_rms(along), _trimmed_rms(across)) for along, across in _along_and_across(chosen))
    left = {cause: left_by_calibration(calibration, chosen, timing=cause == "timing") for cause in ("bias", "timing")}
    budget = add(partial(charts.budget_figure, summary.budget, left, (seen[0], seen[1])), "budget")
    choices = add(partial(charts.choice_figure, summary.choices, summary.criterion), "choices")
    makers: list[tuple[str, Callable[[str], Drawing | None]]] = [
        ("map", partial(figures.map_figure, chosen, sensor=None if _moves(evidence, summary.sensor) else sensor)),
        ("tracks", partial(figures.zoom_figure, r, targets=targets)),  # a track must be whole
        ("curve", partial(figures.curve_figure, chosen)),
        ("residuals", partial(figures.residual_figure, chosen)),
        ("targets", partial(figures.target_figure, chosen, targets=targets)),
        ("histograms", partial(figures.histogram_figure, chosen)),
    ]
    if evidence is not None and sensor is not None and _moves(evidence, summary.sensor):
        makers.insert(
            0, ("trial", partial(charts.trial_figure, chosen, platform=evidence.platform, sensor=sensor, targets=targets))
        )
    shown = [add(maker, kind) for kind, maker in makers]
    chains, chains_figure = [], None
    if evidence is not None and evidence.psr_ssr is not None:
        chains = _chain_rows(evidence, summary.sensor)
        chains_figure = add(partial(charts.psr_ssr_figure, evidence.chains, evidence.psr_ssr, summary.sensor), "psr-ssr")
    clocks = [
        {"file": Path(c.path).name, "rows": clock_rows(c), "remarks": c.remarks,
         "figure": add(partial(charts.clock_figure, c), f"clock-{k}")}
        for k, c in enumerate(evidence.clocks if evidence is not None else ())
        if c.sensor == summary.sensor
    ]  # fmt: skip
    first, second = verdict(calibration, summary)
    rows = rows_of(calibration, summary, truth)
    have = {row.name for row in rows}
    noise = [
        (what, text)
        for what, text in (
            ("range", f"{number(summary.noise.range_m, 1)}{_THIN}m"),
            ("azimuth", f"{number(float(np.degrees(summary.noise.azimuth_rad)), 3)}°"),
            ("elevation", f"{number(float(np.degrees(summary.noise.elevation_rad)), 3)}°"),
        )
        if not text.startswith("–")
    ]
    return {
        "anchor": slug,
        "name": summary.name,
        "kind": f"{_KINDS.get(sensor.kind, sensor.kind)}, " if sensor is not None else "",
        "sign": f"{summary.name} − {main}" if (main := calibration.settings.get("main")) else "measured − true",
        "source": _source(summary.sensor),
        "verdict": first,
        "not_significant": second,
        "gain": gain_text(summary, calibration.against),
        "over_time": over_time,
        "changes": any(row.over for row in rows),
        "model": summary.model,
        "plots": summary.plots,
        "tracks": summary.tracks,
        "targets": summary.targets,
        "span": _time_span(r.time_s),
        "accuracy": _accuracy_rows(summary),
        "noise": noise,
        "notes": summary.notes,
        "rows": rows,
        "brief": brief(rows),
        "advised": any(row.decision for row in rows),
        "gains": any(row.gain for row in rows),
        "has_channels": any(row.channel for row in rows),
        "has_truth": bool(truth),
        "missed": [(name, number(value, 3, sign=True)) for name, value in truth.items() if name not in have and value != 0],
        "not_determined": [n for n in calibration.not_determined if n.sensor == summary.sensor],
        "aliases": alias_groups(calibration, summary.sensor),
        "conformity": [_judged(c) for c in conformity],
        "judged": _judged_counts(conformity),
        "advice_figure": advice,
        "budget_figure": budget,
        "criterion": summary.criterion,
        "choices": [_step(c) for c in summary.choices],
        "choices_figure": choices,
        "effects": _effect_table(summary),
        "target_rows": _target_rows(chosen, targets),
        "figures": [f for f in shown if f is not None],
        "chains": chains,
        "chains_figure": chains_figure,
        "clocks": clocks,
        "chosen": len(chosen) if len(chosen) < len(r) else 0,
    }


def _moves(evidence: Evidence | None, sensor: int) -> bool:
    return evidence is not None and bool((evidence.platform.sensor == sensor).any())


# -------------------------------------------------------------------------------------------------------------- what it says


def unique_names(targets: Mapping[int, str]) -> dict[int, str]:
    """The targets' names, with a number behind those that several share (track numbers of several recordings)."""
    times: dict[str, int] = {}
    for name in targets.values():
        times[name] = times.get(name, 0) + 1
    so_far: dict[str, int] = {}
    out = {}
    for key in sorted(targets):
        name = targets[key]
        so_far[name] = so_far.get(name, 0) + 1
        out[key] = f"{name} ({so_far[name]})" if times[name] > 1 else name
    return out


# What tells how the files were read, and asks for nothing.
_TELLS = re.compile(
    r"passed over|repeat (one|a position)|given twice|platform moves|in the order of|order of time|each carries its own sd"
    r"|read line by line|correction takes it out|platform's own is not known|the radar's own: not used|state vectors do not tell"
    r"|there is no reference: all errors are relative"
)


@dataclass(frozen=True, slots=True)
class Message:
    """Messages of one kind: they differ in numbers and files only."""

    first: str
    texts: tuple[str, ...]


def messages(texts: Sequence[str]) -> tuple[list[Message], list[Message]]:
    """Messages by kind, in the order of the first of each: those to heed, and those that only tell how the files were read."""
    kinds: dict[str, list[str]] = {}
    for text in texts:
        key = re.sub(r"^[^:]*\.\w+: |^[^ :]+: ", "", text)
        kinds.setdefault(re.sub(r"[\d][\d,.\u202f]*", "#", key), []).append(text)
    grouped = [Message(same[0], tuple(same)) for same in kinds.values()]
    return [m for m in grouped if not _TELLS.search(m.first)], [m for m in grouped if _TELLS.search(m.first)]


def alias_groups(calibration: Calibration, sensor: int, least: float = 0.9) -> list[tuple[list[str], str]]:
    """Terms of a sensor whose estimates hang together: names of each group, and its strongest correlation as text."""
    index = [k for k, key in enumerate(calibration.terms) if key.sensor == sensor]
    if len(index) < 2:
        return []
    covariance = calibration.covariance[-1][np.ix_(index, index)]
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    correlation = covariance / np.outer(sd, sd)
    group = list(range(len(index)))
    for i in range(len(index)):
        for j in range(i):
            if abs(correlation[i, j]) >= least:
                group = [group[j] if g == group[i] else g for g in group]
    out = []
    for number_ in dict.fromkeys(group):
        members = [i for i, g in enumerate(group) if g == number_]
        if len(members) > 1:
            pairs = [(abs(correlation[i, j]), correlation[i, j]) for i in members for j in members if j < i]
            names = [_key_label(calibration.terms[index[i]]) for i in members]
            out.append((names, number(float(max(pairs)[1]), 2, sign=True)))
    return out


def _key_label(key: TermKey) -> str:
    return term_label(key.name) + ("" if key.channel == "all" else f" ({term_label(key.channel)})")


def _along_and_across(r: Residuals) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Errors in range and across it (m), before and after correction; pairs that were taken for wrong are left out."""
    trusted = r[r.weight > 0]
    wide = trusted.reference_range_m * np.cos(trusted.reference_elevation_rad)
    return (
        (trusted.range_before_m, trusted.azimuth_before_rad * wide),
        (trusted.range_after_m, trusted.azimuth_after_rad * wide),
    )


def _trimmed_rms(values: FloatArray) -> float:
    """Root mean square without the largest hundredth: one wrong pair must not make the figure."""
    known = np.abs(values[np.isfinite(values)])
    if not len(known):
        return math.nan
    return float(np.sqrt(np.mean(known[known <= np.quantile(known, 0.99)] ** 2)))


def left_by_calibration(calibration: Calibration, r: Residuals, *, timing: bool) -> tuple[float, float]:
    """The uncertainty of the correction itself at the plots of one sensor: rms (m) in range and across it; NaN without plots.

    That of the terms that shift stamps (`timing`), else of all others.

    Rates are those of a target that goes straight on at its level; lengths are not known here and count as nothing.
    """
    if not len(r) or not calibration.terms:
        return math.nan, math.nan
    r = r.take(sample(len(r), 2000))
    mine = [(k, key) for k, key in enumerate(calibration.terms) if key.sensor == int(r.sensor[0])]
    keys = [(k, key) for k, key in mine if TERMS[key.name].is_time == timing]
    if not keys:
        return 0.0, 0.0
    flat = np.maximum(r.reference_range_m * np.cos(r.reference_elevation_rad), 1.0)
    speed, turn = np.nan_to_num(r.reference_speed_mps), np.nan_to_num(r.reference_course_rad) - r.reference_azimuth_rad
    rate = np.stack([speed * np.cos(turn), speed * np.sin(turn) / flat, np.zeros(len(r))], axis=1)
    none = np.zeros((len(r), 3))
    place = Geometry(
        r.reference_range_m, r.reference_azimuth_rad, r.reference_elevation_rad, rate, none, none, r.reference_course_rad,
        np.full(len(r), np.nan), r.time_s - calibration.epoch_s[0],
    )  # fmt: skip
    columns = []
    for _, key in keys:
        whose = Whose(r.channel, np.zeros(len(r), np.uint32), np.full(len(r), -1))
        columns.append(np.nan_to_num(TERMS[key.name].columns(place)) * np.reshape(touches(key.channel, whose), (-1, 1)))
    jacobian = np.stack(columns, axis=2)
    index = [k for k, _ in keys]
    covariance = calibration.covariance[-1][np.ix_(index, index)]
    variance = np.einsum("nki,ij,nkj->nk", jacobian, covariance, jacobian)
    return float(np.sqrt(np.mean(variance[:, 0]))), float(np.sqrt(np.mean(variance[:, 1] * flat**2)))


def _judged(c: Conformity) -> dict[str, str]:
    places = min(decimals((c.high - c.low) / 4), 6) if c.high > c.low else 3
    return {
        "requirement": c.requirement,
        "clause": c.clause,
        "quantity": term_label(c.quantity),
        "limit": f"{c.limit:g}",
        "value": number(c.value, places),
        "interval": f"{number(c.low, places)} … {number(c.high, places)}" if np.isfinite(c.low + c.high) else "–",
        "unit": unit_text(c.unit),
        "verdict": c.verdict,
        "why": c.why,
    }


def _judged_counts(conformity: Sequence[Conformity]) -> list[dict[str, Any]]:
    """By requirement: how many figures pass, fail and stay undecided, and which of them do not pass."""
    out = []
    for name in dict.fromkeys(c.requirement for c in conformity):
        mine = [c for c in conformity if c.requirement == name]
        out.append({
            "requirement": name,
            "counts": [(v, n) for v in ("pass", "fail", "undecided") if (n := sum(c.verdict == v for c in mine))],
            "failed": [term_label(c.quantity) for c in mine if c.verdict == "fail"],
        })  # fmt: skip
    return out


def _step(c: Any) -> dict[str, str]:
    sd = c.change_sd if np.isfinite(c.change_sd) else abs(c.change) / 30 if np.isfinite(c.change) else math.nan
    change = number(c.change, decimals(sd), sign=True) if np.isfinite(c.change) else ""
    return {
        "what": f"{c.action} {term_label(c.term)}".strip(),
        "criterion": f"{c.criterion:.6g}".replace("-", _MINUS) if np.isfinite(c.criterion) else "",
        "change": f"{change} ± {number(c.change_sd, decimals(sd))}" if change and np.isfinite(c.change_sd) else change,
        "why": c.why,
    }


def _effect_table(summary: Summary) -> dict[str, Any] | None:
    """The random errors that plots of one target share: a row a term, a column a span of time, the longest first."""
    if not summary.effects:
        return None
    spans = sorted({e.block_s for e in summary.effects}, reverse=True)
    finite = [s for s in spans if math.isfinite(s)]
    words = {s: f"{'slow' if s == finite[0] and len(finite) > 1 else 'quick'}: another every {s:.3g} s" for s in finite}
    rows = []
    for name in dict.fromkeys(e.term for e in summary.effects):
        term = term_of(name)
        sds = {e.block_s: e.sd / term.si_per_unit for e in summary.effects if e.term == name}
        rows.append({
            "what": f"{term_label(name)}, {unit_text(term.unit)}",
            "sds": ["" if s not in sds else number(sds[s], decimals(sds[s])) if sds[s] >= 1e-5 else "0" for s in spans],
        })  # fmt: skip
    return {"spans": [words.get(s, "the same in all plots of a target") for s in spans], "rows": rows}


def _target_rows(r: Residuals, targets: Mapping[int, str], most: int = 12) -> list[dict[str, str]]:
    """The targets that lie farthest off after correction: who they are, how many plots, and their median errors."""
    if not len(r):
        return []
    numbers, which = np.unique(r.target, return_inverse=True)
    n = len(numbers)
    medians = {
        name: group_quantiles(values, which, n, (0.5,))[0][0]
        for name, values in (
            ("range", r.range_after_m), ("azimuth", np.degrees(r.azimuth_after_rad)), ("before", r.distance_before_m),
            ("after", r.distance_after_m),
        )
    }  # fmt: skip
    plots = np.bincount(which, minlength=n)
    order = [k for k in np.argsort(-np.nan_to_num(medians["after"], nan=-1.0), kind="stable").tolist() if plots[k] >= 3][:most]
    return [
        {
            "name": targets.get(int(numbers[k]), str(numbers[k])),
            "plots": count(int(plots[k])),
            "range": number(float(medians["range"][k]), 1, sign=True),
            "azimuth": number(float(medians["azimuth"][k]), 3, sign=True),
            "before": metres(float(medians["before"][k])) if np.isfinite(medians["before"][k]) else "–",
            "after": metres(float(medians["after"][k])) if np.isfinite(medians["after"][k]) else "–",
        }
        for k in order
    ]


def _chain_rows(evidence: Evidence, sensor: int) -> list[dict[str, str]]:
    from ..assessment.psr_ssr import NM, channel_name

    t = evidence.psr_ssr
    assert t is not None

    def with_se(value: float, se: float) -> str:
        places = decimals(se) if np.isfinite(se) else 2
        return f"{number(value, places, sign=True)} ± {number(se, places)}"

    return [
        {
            "channel": channel_name(int(t.channel[k])),
            "plots": count(int(t.plots[k])),
            "outliers": count(int(t.outliers[k])),
            "targets": count(int(t.targets[k])),
            "range": with_se(float(t.range_m[k]), float(t.range_se_m[k])),
            "range_sd": number(float(t.range_sd_m[k]), 1),
            "slope": with_se(float(t.slope[k]) * NM, float(t.slope_se[k]) * NM),
            "azimuth": with_se(float(np.degrees(t.azimuth_rad[k])), float(np.degrees(t.azimuth_se_rad[k]))),
            "azimuth_sd": number(float(np.degrees(t.azimuth_sd_rad[k])), 3),
        }
        for k in range(len(t))
        if int(t.sensor[k]) == sensor
    ]


def clock_rows(c: Clock) -> list[tuple[str, str]]:
    """What was found of a radar's clock, line by line."""
    out: list[tuple[str, str]] = []
    turn = c.rotation
    if turn is not None:
        by = "its north and sector marks" if turn.told_by == "marks" else "its plots"
        out += [
            (
                "turn of the antenna",
                f"{turn.period_s:.5f} s ± {turn.period_se_s * 1e6:.0f} µs, by {by} over {count(turn.turns)} turns",
            ),
            (
                "jitter of the stamps",
                f"{turn.jitter_s * 1e3:.1f} ms (robust sd); 99.9 % keep to {turn.jitter_999_s * 1e3:.0f} ms",
            ),
            ("slow wander", f"{turn.wander_s * 1e3:.1f} ms (sd)"),
            ("uneven turning", f"{turn.ripple_deg[0]:.3f}° once a turn, {turn.ripple_deg[1]:.3f}° twice a turn"),
            ("stamped by sector", f"{turn.sectors} sectors a turn" if turn.sectors else "no"),
        ]
        if turn.step_s:
            out.append(("step of the stamps", f"{turn.step_s * 1e3:.4g} ms"))
        if np.isfinite(turn.period_told_s):
            out.append(("turn as it says itself", f"{turn.period_told_s:.3f} s"))
        longest = max((g.end_s - g.start_s for g in turn.gaps), default=0.0)
        out.append(
            ("gaps", f"{len(turn.gaps)}, the longest of {longest:.0f} s" if turn.gaps else "none of more than three turns")
        )
    late = c.received
    if late is not None:
        drift = "" if math.isnan(late.drift_ms_per_h) else f", drift {number(late.drift_ms_per_h, 1, sign=True)} ms/h"
        out.append((
            "reception after the stamp",
            f"{number(late.median_s, 3, sign=True)} s (median of {count(late.samples)}), robust sd {late.sd_s:.3f} s{drift}",
        ))  # fmt: skip
    return out
