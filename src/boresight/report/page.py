"""The page: numbers in words and tables around the figures, as one HTML file that needs no network."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._files import write_text
from .._types import FloatArray
from ..terms import TERMS
from . import figures as draw

if TYPE_CHECKING:
    from ..assessment.residuals import Residuals
    from ..association import Association
    from ..calibration import Calibration, Summary
    from ..model import Sensors

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
    "max_iterations": "steps that the estimate may take",
}

GLOSSARY = (
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
    clock: Mapping[str, str] | None = None,
    association: Association | None = None,
    targets: Mapping[int, str] | None = None,
    reference: Sequence[str] = (),
) -> Path:
    """Write the report of a calibration as one self-contained HTML file, and return its path.

    `truth` holds the true values of a simulated scene, sensor name -> term -> value in the term's unit.  `warnings` come on
    top of the calibration's own.  `clock` holds lines (what -> finding) on the clocks; `association` gives the plots not used and
    the coarse biases.  `targets` names the targets (number -> address or callsign); `reference` are the paths among the inputs
    that are the reference.  The file is written beside and then renamed; the same arguments give the same bytes.

    Raises InputError where the file cannot be written.
    """
    text = render(
        calibration, residuals, sensors, title=title, truth=truth, warnings=warnings, clock=clock, association=association,
        targets=targets, reference=reference,
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
    clock: Mapping[str, str] | None = None,
    association: Association | None = None,
    targets: Mapping[int, str] | None = None,
    reference: Sequence[str] = (),
) -> str:
    """The report of `write_report` as text."""
    from importlib.resources import files

    import jinja2

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["count"] = count
    template = environment.from_string((files(__package__) / "template.html").read_text(encoding="utf-8"))
    truth = truth or {}
    drawn = _Numbered()
    sections = [
        _section(
            calibration,
            summary,
            residuals[residuals.sensor == summary.sensor],
            sensors,
            truth.get(summary.name, {}),
            drawn,
            targets or {},
        )
        for summary in calibration.sensors
    ]
    names = {s.sensor: s.name for s in calibration.sensors}
    correlation = drawn.add(draw.correlation_figure(calibration, "correlation", names))
    return template.render(
        title=title,
        version=calibration.version,
        sections=sections,
        correlation=correlation,
        simulated=bool(truth),
        warnings=[_short(text, calibration) for text in dict.fromkeys([*warnings, *calibration.warnings])],
        clock=list((clock or {}).items()),
        unused=_unused(association),
        used=len(residuals),
        coarse=_coarse(association),
        inputs=[{"file": i, "role": "reference" if i.path in reference else "radar"} for i in calibration.inputs],
        roles=bool(reference),
        sites=_sites(calibration, sensors),
        settings=[(name, _plain(value), _SETTINGS.get(name, "")) for name, value in calibration.settings.items()],
        span=_time_span(residuals.time_s),
        glossary=GLOSSARY,
        epochs=len(calibration.epoch_s),
        markup=_Markup(),
    )


class _Markup:
    """What the template may put in unescaped: only drawings made here."""

    def __call__(self, svg: str) -> Any:
        import markupsafe

        return markupsafe.Markup(svg)


class _Numbered:
    """Counts the figures of a page."""

    def __init__(self) -> None:
        self.number = 0

    def add(self, drawing: draw.Drawing | None) -> dict[str, Any] | None:
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


def rows_of(calibration: Calibration, summary: Summary, truth: Mapping[str, float]) -> list[Row]:
    """The terms of one sensor in the units people read, in the calibration's order; the newest epoch."""
    out = []
    interval = calibration.interval(0.95)[-1]
    for k, key in enumerate(calibration.terms):
        if key.sensor != summary.sensor:
            continue
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
            )
        )
    return out


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
            nothing.append(f"{draw.term_label(key.name)}{on} ({amount})")
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
            wrong.append((abs(value) / sd, f"has a {draw.term_label(key.name)} of {signed}{on}"))
    if significant_swing:
        size = float(np.hypot(*swing))
        worst = np.degrees(np.arctan2(swing[1], swing[0])) % 360
        wrong.append((0.0, f"swings by ±{number(size, 3)}° of azimuth in every turn (most clockwise at {number(worst, 0)}°)"))
    if wrong:
        first = f"{summary.name} {_list([text for _, text in wrong])}."
    else:
        first = f"{summary.name} shows no error that these data can tell from zero."
    second = f"Not distinguishable from zero (at 95 %): {_list(nothing)}." if nothing else ""
    return first, second


def _list(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def gain_text(summary: Summary) -> str:
    """What correction does to the horizontal distance, in a sentence."""
    before, after = summary.before.median_m, summary.after.median_m
    if not (np.isfinite(before) and np.isfinite(after)):
        return ""
    text = f"Corrected, half of its plots lie within {metres(after)} m of the reference instead of {metres(before)} m"
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
    drawn: _Numbered,
    targets: Mapping[int, str],
) -> dict[str, Any]:
    """Everything that the template needs of one sensor."""
    slug = f"sensor-{summary.sensor}"
    chosen = r.take(draw.sample(len(r), draw.MAX_PAIRS)) if len(r) > draw.MAX_PAIRS else r
    makers: list[Callable[[str], draw.Drawing | None]] = [
        partial(draw.map_figure, chosen),
        partial(draw.zoom_figure, r, targets=targets),  # a track must be whole
        partial(draw.curve_figure, chosen),
        partial(draw.residual_figure, chosen),
        partial(draw.target_figure, chosen, targets=targets),
        partial(draw.histogram_figure, chosen),
    ]
    kinds = ("map", "tracks", "curve", "residuals", "targets", "histograms")
    shown = [drawn.add(maker(f"{slug}-{kind}")) for kind, maker in zip(kinds, makers, strict=True)]
    sensor = sensors.find(summary.sensor)
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
        "source": _source(summary.sensor),
        "verdict": first,
        "not_significant": second,
        "gain": gain_text(summary),
        "model": summary.model,
        "plots": summary.plots,
        "tracks": summary.tracks,
        "targets": summary.targets,
        "span": _time_span(r.time_s),
        "accuracy": _accuracy_rows(summary),
        "noise": noise,
        "notes": summary.notes,
        "rows": rows,
        "has_channels": any(row.channel for row in rows),
        "has_truth": bool(truth),
        "missed": [(name, number(value, 3, sign=True)) for name, value in truth.items() if name not in have and value != 0],
        "not_determined": [n for n in calibration.not_determined if n.sensor == summary.sensor],
        "figures": [f for f in shown if f is not None],
        "chosen": len(chosen) if len(chosen) < len(r) else 0,
    }
