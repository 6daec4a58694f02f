"""The named error terms: what each systematic error of a radar does to its range, azimuth and elevation.

``measured = h(truth at t - time_offset) + sum of value * column(geometry)``, bias = measured - true.  A term is written once,
here, and is thereby available to every model, estimator, report and the simulator.  Every column is finite at elevation 0.
Values are SI inside (metres, radians, seconds); `unit` and `si_per_unit` are for files and people.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ._types import FloatArray
from .errors import SettingsError

DEG = np.pi / 180.0
# Terms that act by shifting the stamps, not by a column at the true place.
TIME_TERMS = frozenset({"time_offset", "clock_drift"})
# Elevations beyond this are treated as this where a column has a pole over the antenna (tan E, 1 / cos E).
_STEEPEST_RAD = 80 * DEG


class Geometry(NamedTuple):
    """Where the target truly is, as the radar sees it, and how that changes.

    `range_m`, `azimuth_rad`, `elevation_rad`, `time_s` (since the epoch), `heading_rad` and `length_m` are (n,); `rate`, `second`
    and `third` are (n, 3): derivatives of (range, azimuth, elevation) in SI units, NaN beyond the `order_of` the terms in use.
    The heading is clockwise from the antenna's north (`measure.heading_about`).  Heading and length are NaN where unknown.
    """

    range_m: FloatArray
    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    rate: FloatArray
    second: FloatArray
    third: FloatArray
    heading_rad: FloatArray
    length_m: FloatArray
    time_s: FloatArray


@dataclass(frozen=True, slots=True)
class Term:
    """One systematic error.

    `columns(geometry)` gives (n, 3): d(range m, azimuth rad, elevation rad) per SI unit of the value.  `prior_sd` is how large the
    error may plausibly be (SI): it scales the column and gives the ridge.  `needs` names what must be known of the target:
    heading, length, elevation (measured), and which of its rates (rate, second, third).
    """

    name: str
    unit: str
    si_per_unit: float
    prior_sd: float
    needs: frozenset[str]
    columns: Callable[[Geometry], FloatArray]
    meaning: str


def _stack(range_m: FloatArray | float, azimuth: FloatArray | float, elevation: FloatArray | float, g: Geometry) -> FloatArray:
    out = np.empty((len(g.range_m), 3))
    out[:, 0], out[:, 1], out[:, 2] = range_m, azimuth, elevation
    return out


def _tan(g: Geometry) -> FloatArray:
    return np.tan(np.clip(g.elevation_rad, -_STEEPEST_RAD, _STEEPEST_RAD))


def _cos(g: Geometry) -> FloatArray:
    return np.cos(np.clip(g.elevation_rad, -_STEEPEST_RAD, _STEEPEST_RAD))


def _displace(g: Geometry, east: FloatArray | float, north: FloatArray | float, up: FloatArray | float) -> FloatArray:
    """What a displacement (m) of the target about the antenna does to its range, azimuth and elevation."""
    sin_a, cos_a, sin_e, cos_e = np.sin(g.azimuth_rad), np.cos(g.azimuth_rad), np.sin(g.elevation_rad), np.cos(g.elevation_rad)
    along, across = east * sin_a + north * cos_a, east * cos_a - north * sin_a
    far = np.maximum(g.range_m, 1.0)
    return _stack(along * cos_e + up * sin_e, across / (far * _cos(g)), (up * cos_e - along * sin_e) / far, g)


def _along_heading(g: Geometry) -> FloatArray:
    known = np.isfinite(g.heading_rad)
    heading = np.where(known, g.heading_rad, 0.0)
    return _displace(g, np.where(known, np.sin(heading), 0.0), np.where(known, np.cos(heading), 0.0), 0.0)


def _range(value: FloatArray | float, g: Geometry) -> FloatArray:
    return _stack(value, 0.0, 0.0, g)


def _azimuth(value: FloatArray | float, g: Geometry) -> FloatArray:
    return _stack(0.0, value, 0.0, g)


def _tilt(g: Geometry, toward_rad: float) -> FloatArray:
    """The azimuth axis leans so that the elevation is read too large toward this azimuth."""
    away = g.azimuth_rad - toward_rad
    return _stack(0.0, np.sin(away) * _tan(g), np.cos(away), g)


def _along_heading_per_length(g: Geometry) -> FloatArray:
    return _along_heading(g) * np.where(np.isfinite(g.length_m), g.length_m, 0.0)[:, None]


_NONE: frozenset[str] = frozenset()
_MS_PER_H = 1e-3 / 3600.0
_LIST = (
    Term("range_bias", "m", 1.0, 500.0, _NONE, lambda g: _range(1.0, g), "the radar reads too far by this, everywhere"),
    Term(
        "range_gain", "m/km", 1e-3, 1e-2, _NONE, lambda g: _range(g.range_m, g),
        "error proportional to the range (clock of the range counter, uncorrected propagation)",
    ),
    Term("azimuth_bias", "deg", DEG, 3 * DEG, _NONE, lambda g: _azimuth(1.0, g), "the picture is turned clockwise (north alignment)"),
    Term("azimuth_cos", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.cos(g.azimuth_rad), g), "encoder eccentricity, cosine part"),
    Term("azimuth_sin", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.sin(g.azimuth_rad), g), "encoder eccentricity, sine part"),
    Term(
        "elevation_bias", "deg", DEG, 2 * DEG, frozenset({"elevation"}), lambda g: _stack(0.0, 0.0, 1.0, g),
        "the radar reads too high by this, everywhere",
    ),
    Term("tilt_north", "deg", DEG, DEG, _NONE, lambda g: _tilt(g, 0.0), "the azimuth axis leans: elevation too large in the north"),
    Term("tilt_east", "deg", DEG, DEG, _NONE, lambda g: _tilt(g, np.pi / 2), "the azimuth axis leans: elevation too large in the east"),
    Term("time_offset", "s", 1.0, 5.0, frozenset({"rate"}), lambda g: -g.rate, "stamp minus true time: plots are stamped late"),
    Term(
        "clock_drift", "ms/h", _MS_PER_H, 100 * _MS_PER_H, frozenset({"rate"}), lambda g: -g.rate * g.time_s[:, None],
        "the time offset grows by this, counted from the calibration's epoch",
    ),
    Term("site_east", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, -1.0, 0.0, 0.0), "the antenna stands east of the position given"),
    Term("site_north", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, 0.0, -1.0, 0.0), "the antenna stands north of the position given"),
    Term("site_up", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, 0.0, 0.0, -1.0), "the antenna stands above the position given"),
    Term(
        "along_heading", "m", 1.0, 30.0, frozenset({"heading"}), _along_heading,
        "the echo lies ahead of the reference's antenna along the target's heading",
    ),
    Term(
        "along_heading_per_length", "m/m", 1.0, 1.0, frozenset({"heading", "length"}), _along_heading_per_length,
        "the echo lies ahead of the reference's antenna by this share of the target's length",
    ),
)  # fmt: skip

TERMS: dict[str, Term] = {term.name: term for term in _LIST}

MODELS: dict[str, tuple[str, ...]] = {
    "constant": ("range_bias", "azimuth_bias", "elevation_bias"),
    "atc": ("range_bias", "range_gain", "azimuth_bias", "azimuth_cos", "azimuth_sin", "elevation_bias", "time_offset"),
    "surface": ("range_bias", "azimuth_bias", "time_offset", "along_heading_per_length"),
}


def late_s(terms: Sequence[Term], value: Sequence[FloatArray | float] | FloatArray, time_s: FloatArray) -> FloatArray:
    """Stamp minus true time (n,), s, by the terms of `TIME_TERMS` among the terms; each value is a number or (n,), SI.

    `time_s` (n,) counts from the calibration's epoch.
    """
    out = np.zeros(len(time_s))
    for term, v in zip(terms, value, strict=True):
        if term.name in TIME_TERMS:
            out += v * time_s if term.name == "clock_drift" else v
    return out


def order_of(terms: Iterable[Term]) -> int:
    """The highest rate of the target's motion that the columns of these terms need, 0 … 3."""
    needs = frozenset[str]().union(*(term.needs for term in terms))
    return max((k for k, name in enumerate(("", "rate", "second", "third")) if name in needs), default=0)


def terms_of(model: str | Sequence[str]) -> tuple[Term, ...]:
    """The terms of a named model, or of a list of term names (a string may be a comma-separated list).

    Raises SettingsError for unknown names, with the names that exist, and for a term given twice.
    """
    if isinstance(model, str):
        names: Sequence[str] = MODELS[model] if model in MODELS else [part.strip() for part in model.split(",") if part.strip()]
    else:
        names = model
    for name in names:
        if name not in TERMS:
            raise SettingsError(
                f"there is no term or model named {name!r}",
                where="model",
                remedy=f"Models: {', '.join(MODELS)}. Terms: {', '.join(TERMS)}.",
            )
    if len(set(names)) != len(names) or not names:
        raise SettingsError("a model needs at least one term, and each once", where="model")
    return tuple(TERMS[name] for name in names)
