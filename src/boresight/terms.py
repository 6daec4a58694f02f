"""The named error terms: what each systematic error of a radar does to its range, azimuth and elevation.

``measured = h(truth at t - late) + sum of value * column(geometry)``, bias = measured - true.  A term is written once,
here, and is thereby available to every model, estimator, report and the simulator.  Every column is finite at elevation 0.
Values are SI inside (metres, radians, seconds); `unit` and `si_per_unit` are for files and people.

``range_bias@psr`` is the range bias of one channel (`CHANNELS`): it acts on that channel's plots only, on top of what the
model has for all.  The tables (`TABLES`) are many terms, one a node; a model names them together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ._types import AnyArray, BoolArray, FloatArray
from .errors import SettingsError
from .model import Channel, Flag

DEG = np.pi / 180.0
# Terms that act by shifting the stamps, not by a column at the true place.
TIME_TERMS = frozenset({"time_offset", "clock_drift"})
# The channels that may have errors of their own.  The position of a combined plot is the secondary radar's.  The chains are those
# that process the plots, told by a flag: what does not say that it is of the second is of the first.
CHANNELS: dict[str, tuple[Channel, ...]] = {
    "psr": (Channel.PSR,),
    "ssr": (Channel.SSR, Channel.SSR_PSR),
    "mode_s": (Channel.MODE_S, Channel.MODE_S_PSR),
    "chain1": (),
    "chain2": (),
}
# Elevations beyond this are treated as this where a column has a pole over the antenna (tan E, 1 / cos E).
_STEEPEST_RAD = 80 * DEG
# The height over which the air's refractivity falls by a factor of e (ITU-R P.453, global mean), and the earth's mean radius.
_AIR_M = 7350.0
_EARTH_M = 6371e3
# Nodes and weights of Gauss's rule: the path through the air is smooth enough for 1e-6 of it.
_PATH_AT, _PATH_WEIGHT = np.polynomial.legendre.leggauss(10)
_REFERENCE = "reference_time_offset"
# The nodes of the tables.
_AZIMUTH_NODES_DEG = tuple(range(0, 360, 15))
_AZIMUTH_STEP_RAD = 15 * DEG
_RANGE_NODES_M = (
    0, 500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 48_000, 64_000, 96_000, 128_000, 160_000, 192_000, 224_000, 256_000,
    320_000, 384_000, 448_000,
)  # fmt: skip


class Whose(NamedTuple):
    """Whose each row (n,) is: the plot's channel and flags, and the id of the reference's source."""

    channel: AnyArray
    flags: AnyArray
    source: AnyArray


class Geometry(NamedTuple):
    """Where the target truly is, as the radar sees it, and how that changes.

    `range_m`, `azimuth_rad`, `elevation_rad`, `time_s` (since the epoch), `heading_rad` and `length_m` are (n,); `rate`, `second`
    and `third` are (n, 3): derivatives of (range, azimuth, elevation) in SI units, NaN beyond the `order_of` the terms in use.
    The heading is clockwise from the antenna's north (`measure.heading_about`).  Heading and length are NaN where unknown.
    Terms of one channel ask `whose` the rows are; without it they act on all.
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
    whose: Whose | None = None


@dataclass(frozen=True, slots=True)
class Term:
    """One systematic error.

    `columns(geometry)` gives (n, 3): d(range m, azimuth rad, elevation rad) per SI unit of the value.  `prior_sd` is how large the
    error may plausibly be (SI): it scales the column and gives the ridge.  `needs` names what must be known of the target:
    heading, length, elevation (measured), and which of its rates (rate, second, third).  A term of one `channel` has a `name`
    like ``range_bias@psr``, and the `base` range_bias.
    """

    name: str
    unit: str
    si_per_unit: float
    prior_sd: float
    needs: frozenset[str]
    columns: Callable[[Geometry], FloatArray]
    meaning: str
    channel: str = "all"

    @property
    def base(self) -> str:
        """The name without the channel."""
        return self.name.partition("@")[0]

    @property
    def is_time(self) -> bool:
        """Whether the term acts by shifting stamps."""
        return self.base in TIME_TERMS or self.is_nuisance

    @property
    def is_nuisance(self) -> bool:
        """Whether the value is the reference's, not the radar's: estimated with the others, and no part of a calibration."""
        return self.base == _REFERENCE


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


def _strain(g: Geometry, stretch: tuple[int, int, int], shear: tuple[int, int, int]) -> FloatArray:
    """A linear, symmetric distortion of the picture about the antenna: what an affine map has beside shift and turn.

    The displacement is S p of the target's place p, east, north, up; `stretch` is the diagonal of S, `shear` its elements east-north,
    east-up and north-up.
    """
    flat = g.range_m * np.cos(g.elevation_rad)
    east, north, up = flat * np.sin(g.azimuth_rad), flat * np.cos(g.azimuth_rad), g.range_m * np.sin(g.elevation_rad)
    return _displace(
        g,
        stretch[0] * east + shear[0] * north + shear[1] * up,
        shear[0] * east + stretch[1] * north + shear[2] * up,
        shear[1] * east + shear[2] * north + stretch[2] * up,
    )


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


def _air_path(g: Geometry) -> FloatArray:
    """The path to the target (n,), m, each part counted by the air's density there over that at the antenna."""
    sin_e, cos_e = np.sin(g.elevation_rad), np.cos(g.elevation_rad)
    out = np.zeros(len(g.range_m))
    for at, weight in zip(_PATH_AT, _PATH_WEIGHT, strict=True):
        along = (at + 1) / 2 * g.range_m
        # Below the antenna the air is thicker; far below it there is ground.
        height = np.maximum(along * sin_e + (along * cos_e) ** 2 / (2 * _EARTH_M), -1000.0)
        out += weight / 2 * np.exp(-height / _AIR_M)
    return out * g.range_m


def _bounded_cot(g: Geometry) -> FloatArray:
    """cot E, brought to a finite value at the horizon as the bending of rays through all the air is (Bennett 1982)."""
    degrees = np.clip(g.elevation_rad / DEG, -1.0, 90.0)
    return np.asarray(1.0 / np.tan((degrees + 7.31 / (degrees + 4.4)) * DEG))


def _azimuth_node(node_rad: float) -> Callable[[Geometry], FloatArray]:
    """1 at the node, 0 at its neighbours, straight between."""

    def hat(g: Geometry) -> FloatArray:
        off = np.abs((g.azimuth_rad - node_rad + np.pi) % (2 * np.pi) - np.pi)
        return _azimuth(np.maximum(1.0 - off / _AZIMUTH_STEP_RAD, 0.0), g)

    return hat


def _range_node(k: int) -> Callable[[Geometry], FloatArray]:
    """The same over range; the first and the last node go on beyond."""

    def hat(g: Geometry) -> FloatArray:
        return _range(np.interp(g.range_m, _RANGE_NODES_M, np.eye(len(_RANGE_NODES_M))[k]), g)

    return hat


def _transponder(g: Geometry) -> FloatArray:
    if g.whose is None:
        return _range(1.0, g)
    return _range(np.where(g.whose.channel == Channel.PSR, 0.0, 1.0), g)


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
    Term(
        "range_refraction", "ppm", 1e-6, 300e-6, _NONE, lambda g: _range(_air_path(g), g),
        "refractivity at the antenna that the radar does not correct: the air delays the pulse",
    ),
    Term("azimuth_bias", "deg", DEG, 3 * DEG, _NONE, lambda g: _azimuth(1.0, g), "the picture is turned clockwise (north alignment)"),
    Term("azimuth_cos", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.cos(g.azimuth_rad), g), "encoder eccentricity, cosine part"),
    Term("azimuth_sin", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.sin(g.azimuth_rad), g), "encoder eccentricity, sine part"),
    Term("azimuth_cos2", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.cos(2 * g.azimuth_rad), g), "encoder, second harmonic, cosine"),
    Term("azimuth_sin2", "deg", DEG, DEG, _NONE, lambda g: _azimuth(np.sin(2 * g.azimuth_rad), g), "encoder, second harmonic, sine"),
    Term(
        "nonorthogonality", "deg", DEG, 0.5 * DEG, _NONE, lambda g: _azimuth(_tan(g), g),
        "the elevation axis is not at right angles to the azimuth axis",
    ),
    Term(
        "collimation", "deg", DEG, 0.5 * DEG, _NONE, lambda g: _azimuth(1.0 / _cos(g), g),
        "the beam is not at right angles to the elevation axis",
    ),
    Term(
        "elevation_bias", "deg", DEG, 2 * DEG, frozenset({"elevation"}), lambda g: _stack(0.0, 0.0, 1.0, g),
        "the radar reads too high by this, everywhere",
    ),
    Term(
        "elevation_sag", "deg", DEG, 0.5 * DEG, frozenset({"elevation"}), lambda g: _stack(0.0, 0.0, np.cos(g.elevation_rad), g),
        "the antenna sags under its weight",
    ),
    Term(
        "elevation_refraction", "deg", DEG, 0.1 * DEG, frozenset({"elevation"}), lambda g: _stack(0.0, 0.0, _bounded_cot(g), g),
        "bending of the ray that the radar does not correct",
    ),
    Term("tilt_north", "deg", DEG, DEG, _NONE, lambda g: _tilt(g, 0.0), "the azimuth axis leans: elevation too large in the north"),
    Term("tilt_east", "deg", DEG, DEG, _NONE, lambda g: _tilt(g, np.pi / 2), "the azimuth axis leans: elevation too large in the east"),
    Term("time_offset", "s", 1.0, 5.0, frozenset({"rate"}), lambda g: -g.rate, "stamp minus true time: plots are stamped late"),
    Term(
        "clock_drift", "ms/h", _MS_PER_H, 500 * _MS_PER_H, frozenset({"rate"}), lambda g: -g.rate * g.time_s[:, None],
        "the time offset grows by this, counted from the calibration's epoch",
    ),
    Term(
        "range_lag", "s²", 1.0, 50.0, frozenset({"second"}), lambda g: _stack(g.second[:, 0], 0.0, 0.0, g),
        "the range servo follows an acceleration too far (positive) or lags behind it (negative)",
    ),
    Term("azimuth_lag", "s²", 1.0, 50.0, frozenset({"second"}), lambda g: _azimuth(g.second[:, 1], g), "the same of the azimuth servo"),
    Term(
        "elevation_lag", "s²", 1.0, 50.0, frozenset({"elevation", "second"}), lambda g: _stack(0.0, 0.0, g.second[:, 2], g),
        "the same of the elevation servo",
    ),
    Term(
        "range_jerk", "s³", 1.0, 1000.0, frozenset({"third"}), lambda g: _stack(g.third[:, 0], 0.0, 0.0, g),
        "the range servo's error that follows the change of the acceleration",
    ),
    Term("azimuth_jerk", "s³", 1.0, 1000.0, frozenset({"third"}), lambda g: _azimuth(g.third[:, 1], g), "the same of the azimuth servo"),
    Term(
        "elevation_jerk", "s³", 1.0, 1000.0, frozenset({"elevation", "third"}), lambda g: _stack(0.0, 0.0, g.third[:, 2], g),
        "the same of the elevation servo",
    ),
    Term("site_east", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, -1.0, 0.0, 0.0), "the antenna stands east of the position given"),
    Term("site_north", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, 0.0, -1.0, 0.0), "the antenna stands north of the position given"),
    Term("site_up", "m", 1.0, 100.0, _NONE, lambda g: _displace(g, 0.0, 0.0, -1.0), "the antenna stands above the position given"),
    Term(
        "rotation_east", "deg", DEG, DEG, _NONE, lambda g: _tilt(g, 0.0),
        "the picture is turned about the east axis through the antenna, by the right-hand rule: tilt_north by another name",
    ),
    Term(
        "rotation_north", "deg", DEG, DEG, _NONE, lambda g: -_tilt(g, np.pi / 2),
        "the picture is turned about the north axis, by the right-hand rule: minus tilt_east",
    ),
    Term(
        "rotation_up", "deg", DEG, 3 * DEG, _NONE, lambda g: _azimuth(-1.0, g),
        "the picture is turned about the vertical, by the right-hand rule (anticlockwise): minus azimuth_bias",
    ),
    Term(
        "stretch_east", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (1, 0, 0), (0, 0, 0)),
        "the picture is stretched along the east axis: a target this far east of the antenna is seen further east in proportion",
    ),
    Term("stretch_north", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (0, 1, 0), (0, 0, 0)), "the same along the north axis"),
    Term("stretch_up", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (0, 0, 1), (0, 0, 0)), "the same along the vertical"),
    Term(
        "shear_east_north", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (0, 0, 0), (1, 0, 0)),
        "the picture is sheared: what lies north is seen further east, and what lies east as much further north, without a turn",
    ),
    Term("shear_east_up", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (0, 0, 0), (0, 1, 0)), "the same between east and up"),
    Term("shear_north_up", "m/km", 1e-3, 1e-2, _NONE, lambda g: _strain(g, (0, 0, 0), (0, 0, 1)), "the same between north and up"),
    Term(
        "along_heading", "m", 1.0, 30.0, frozenset({"heading"}), _along_heading,
        "the echo lies ahead of the reference's antenna along the target's heading",
    ),
    Term(
        "along_heading_per_length", "m/m", 1.0, 1.0, frozenset({"heading", "length"}), _along_heading_per_length,
        "the echo lies ahead of the reference's antenna by this share of the target's length",
    ),
    Term(
        "transponder_delay", "m", 1.0, 50.0, _NONE, _transponder,
        "delay of the transponders, as range: each target's own is a random effect, and their common part is all that a model can hold",
    ),
    *(
        Term(
            f"azimuth_table_{node:03d}", "deg", DEG, 0.1 * DEG, _NONE,
            _azimuth_node(node * DEG),
            f"azimuth error at {node} degrees beyond its mean and first two harmonics, straight to the next nodes",
        )
        for node in _AZIMUTH_NODES_DEG
    ),
    *(
        Term(
            f"range_table_{node:06d}", "m", 1.0, 50.0, _NONE, _range_node(k),
            f"range error at {node / 1000:g} km beyond its mean and slope, straight to the next nodes",
        )
        for k, node in enumerate(_RANGE_NODES_M)
    ),
)  # fmt: skip

TERMS: dict[str, Term] = {term.name: term for term in _LIST}
# What a model asks for by one name: the nodes of a table.
TABLES: dict[str, tuple[str, ...]] = {
    table: tuple(name for name in TERMS if name.startswith(f"{table}_")) for table in ("azimuth_table", "range_table")
}
_TABLE_OF = {name: table for table, nodes in TABLES.items() for name in nodes}


class Alias(NamedTuple):
    """Terms that look alike: by their nature where `always`, and are then refused together; else where the geometry is poor."""

    names: tuple[str, ...]
    always: bool
    why: str


ALIASES: tuple[Alias, ...] = (
    Alias(("azimuth_bias", "rotation_up"), True, "a turn about the vertical is an azimuth bias of the other sign"),
    Alias(("tilt_north", "rotation_east"), True, "a turn about the east axis is the tilt toward the north"),
    Alias(("tilt_east", "rotation_north"), True, "a turn about the north axis is the tilt toward the east, of the other sign"),
    Alias(
        ("range_bias", "transponder_delay"), True,
        "what all transponders have in common is a range bias; what each has of its own is estimated in every registration",
    ),
    Alias(("range_bias", "time_offset"), False, "where all traffic is radial, late stamps look like a range error"),
    Alias(("range_bias", "range_gain"), False, "where all traffic is about as far away, a gain looks like a bias"),
    Alias(("range_gain", "range_refraction"), False, "at low elevations the air's delay grows all but in proportion to the range"),
    Alias(("azimuth_bias", "collimation"), False, "sec E is 1 at low elevations"),
    Alias(("nonorthogonality", "collimation", "tilt_north", "tilt_east"), False, "at high elevations tan E and sec E are alike, "
          "and in a sector a tilt's azimuth part is in proportion to tan E"),
    Alias(("elevation_bias", "elevation_sag", "elevation_refraction"), False, "cos E is 1 and cot E all but one number at low elevations"),
    Alias(("elevation_bias", "tilt_north", "tilt_east"), False, "in a sector a tilt is an elevation bias"),
    Alias(("elevation_bias", "site_up"), False, "where all targets are about as far away, a height error is an elevation bias"),
    Alias(("site_east", "site_north", "range_bias", "azimuth_bias"), False, "in a sector a shift of the antenna is a range and azimuth bias"),
    Alias(("site_up", "range_bias"), False, "at high elevations a height error is a range bias"),
    Alias(
        ("azimuth_bias", "azimuth_cos", "azimuth_sin", "azimuth_cos2", "azimuth_sin2", "azimuth_table"), False,
        "in a sector harmonics look like a bias; the table leaves them out only over the full circle",
    ),
    Alias(("range_bias", "range_gain", "range_refraction", "range_table"), False, "the table leaves out only a mean and a slope"),
    Alias(
        ("range_gain", "stretch_east", "stretch_north"), False,
        "east and north stretched alike is all but a gain of the range: low targets do not tell the two",
    ),
    Alias(("stretch_up", "elevation_bias", "site_up"), False, "low targets hardly show what happens to their height"),
    Alias(("shear_east_up", "rotation_north"), False, "at low elevations a shear to the vertical is a tilt"),
    Alias(("shear_north_up", "rotation_east"), False, "at low elevations a shear to the vertical is a tilt"),
    Alias(("time_offset", "along_heading", "along_heading_per_length"), False, "both move plots along the track, at one speed alike"),
    Alias(("time_offset", "clock_drift"), False, "in a short recording a drift is an offset"),
    Alias(("azimuth_lag", "elevation_lag", "range_lag", "time_offset"), False, "on a steady turn a lag is in proportion to the rate"),
)  # fmt: skip

MODELS: dict[str, tuple[str, ...]] = {
    "constant": ("range_bias", "azimuth_bias", "elevation_bias"),
    "atc": ("range_bias", "range_gain", "azimuth_bias", "azimuth_cos", "azimuth_sin", "elevation_bias", "time_offset"),
    "surface": ("range_bias", "azimuth_bias", "time_offset", "along_heading_per_length"),
    "marine": ("range_bias", "range_gain", "azimuth_bias", "time_offset", "along_heading_per_length"),
    "tracker": (
        "range_bias", "range_refraction", "azimuth_bias", "azimuth_cos", "azimuth_sin", "nonorthogonality", "collimation",
        "elevation_bias", "elevation_sag", "elevation_refraction", "tilt_north", "tilt_east", "time_offset", "range_lag",
        "azimuth_lag", "elevation_lag",
    ),
    "full": (
        "range_bias", "range_gain", "range_refraction", "azimuth_bias", "azimuth_cos", "azimuth_sin", "azimuth_cos2",
        "azimuth_sin2", "elevation_bias", "elevation_sag", "elevation_refraction", "tilt_north", "tilt_east", "time_offset",
        "clock_drift", "site_east", "site_north", "site_up",
    ),
}  # fmt: skip


def touches(channel: str, whose: Whose | None) -> BoolArray | bool:
    """Whether a term of this channel ("all", a name of `CHANNELS` or of a `Channel`) acts on each row (n,)."""
    if whose is None or channel == "all":
        return True
    name = channel.lower()
    if name in ("chain1", "chain2"):
        return np.asarray(((np.asarray(whose.flags) & np.uint32(Flag.CHAIN_2)) != 0) == (name == "chain2"))
    if name.startswith("source "):
        return np.asarray(whose.source == int(name.split()[1]))
    codes = CHANNELS.get(name) or tuple(c for c in Channel if c.name.lower() == name)
    return np.isin(whose.channel, [c.value for c in codes])


def late_s(
    terms: Sequence[Term], value: Sequence[FloatArray | float] | FloatArray, time_s: FloatArray, whose: Whose | None = None
) -> FloatArray:
    """Stamp minus true time (n,), s, by the terms among these that shift stamps; each value is a number or (n,), SI.

    `time_s` (n,) counts from the calibration's epoch.  A term of one channel shifts that channel's stamps only (all, without
    `whose`).
    """
    out = np.zeros(len(time_s))
    for term, v in zip(terms, value, strict=True):
        if term.is_time:
            # A reference that is late is left behind by a target that the radar sees in time.
            by = v * time_s if term.base == "clock_drift" else -v if term.is_nuisance else v
            out += by * touches(term.channel, whose)
    return out


def order_of(terms: Iterable[Term]) -> int:
    """The highest rate of the target's motion that the columns of these terms need, 0 … 3."""
    needs = frozenset[str]().union(*(term.needs for term in terms))
    return max((k for k, name in enumerate(("", "rate", "second", "third")) if name in needs), default=0)


def on_channel(term: Term, channel: str) -> Term:
    """The term for one channel alone."""
    return replace(term, name=f"{term.base}@{channel}", channel=channel, columns=_only_on(term.columns, channel))


def _only_on(columns: Callable[[Geometry], FloatArray], channel: str) -> Callable[[Geometry], FloatArray]:
    def own(g: Geometry) -> FloatArray:
        mine = touches(channel, g.whose)
        return columns(g) if mine is True else columns(g) * np.asarray(mine)[:, None]

    return own


def reference_term(source: int) -> Term:
    """The nuisance of a further source of references (its id): by how much its stamps are later than the first one's."""
    term = Term(
        _REFERENCE, "s", 1.0, 1.0, frozenset({"rate"}), lambda g: g.rate, "this reference's stamps are later than the others'"
    )
    return on_channel(term, f"source {source}")


@lru_cache(maxsize=512)
def term_of(name: str) -> Term:
    """The term of this name, which may end in ``@channel``.

    Raises SettingsError for names and channels that do not exist, with those that do.
    """
    base, at, channel = name.partition("@")
    if base not in TERMS:
        raise SettingsError(f"there is no term or model named {base!r}", where="model", remedy=known_names())
    if not at:
        return TERMS[base]
    if channel not in CHANNELS:
        raise SettingsError(f"{name!r} names no channel", where="model", remedy=f"Channels: {', '.join(CHANNELS)}.")
    return on_channel(TERMS[base], channel)


def known_names() -> str:
    """The names that a model may be made of, in words; tables by their one name."""
    names = dict.fromkeys(_TABLE_OF.get(name, name) for name in TERMS)
    return f"Models: {', '.join(MODELS)}. Terms: {', '.join(names)}; @{', @'.join(CHANNELS)} behind a name is for one channel."


def table_of(term: Term) -> str:
    """The table that the term is a node of, with its channel ("azimuth_table@psr"), else ""."""
    table = _TABLE_OF.get(term.base, "")
    return table and table + term.name[len(term.base) :]


def terms_of(model: str | Sequence[str]) -> tuple[Term, ...]:
    """The terms of a named model, or of a list of term names (a string may be a comma-separated list).

    A table stands for all its nodes.  Raises SettingsError for unknown names, with the names that exist, for a term given twice,
    and for terms that are aliases of each other (`ALIASES`).
    """
    if isinstance(model, str):
        asked: Sequence[str] = MODELS[model] if model in MODELS else [part.strip() for part in model.split(",") if part.strip()]
    else:
        asked = model
    names: list[str] = []
    for name in asked:
        base, at, channel = name.partition("@")
        names += [node + at + channel for node in TABLES.get(base, (base,))]
    terms = tuple(term_of(name) for name in names)
    if len(set(names)) != len(names) or not names:
        raise SettingsError("a model needs at least one term, and each once", where="model")
    for alias in ALIASES:
        for channel in {term.channel for term in terms}:
            both = [t.name for t in terms if t.channel == channel and t.base in alias.names]
            if alias.always and len(both) > 1:
                raise SettingsError(
                    f"{' and '.join(both)} are the same error by two names: {alias.why}", where="model", remedy=f"Keep {both[0]}."
                )
    return terms


def summarised(names: Iterable[str]) -> list[str]:
    """The names (terms, in order) as a person writes them: the nodes of a table by its one name."""
    out: dict[str, None] = {}
    for name in names:
        base, at, channel = name.partition("@")
        out[_TABLE_OF.get(base, base) + at + channel] = None
    return list(out)


# The smoothness of a table: neighbours' values correlate by exp(-1 / _SMOOTH).
_SMOOTH = 2.0
# What is kept out of a table is held to this part of the nodes' prior sd.
_KEPT_OUT = 1e-2


def kept_out(table: str) -> tuple[Callable[[FloatArray], FloatArray], ...]:
    """The shapes over the nodes (degrees or metres) that a table has none of, because other terms hold them."""
    if table.startswith("azimuth"):
        return (
            np.ones_like,
            lambda node: np.cos(node * DEG),
            lambda node: np.sin(node * DEG),
            lambda node: np.cos(2 * node * DEG),
            lambda node: np.sin(2 * node * DEG),
        )
    return np.ones_like, lambda node: node / _RANGE_NODES_M[-1]


def precision(terms: Sequence[Term]) -> FloatArray:
    """The prior's inverse covariance (p, p) of the terms' values, each in units of its `prior_sd`.

    Terms are independent, except that neighbouring nodes of a table are alike, and that over the nodes that are there (of the
    model) an azimuth table has no mean and no first two harmonics, a range table no mean and no slope: these are other terms.
    """
    out = np.eye(len(terms))
    groups: dict[str, list[int]] = {}
    for k, term in enumerate(terms):
        if table_of(term):
            groups.setdefault(table_of(term), []).append(k)
    for table, members in groups.items():
        node = np.array([int(terms[k].base.rpartition("_")[2]) for k in members], np.float64)
        if table.startswith("azimuth"):
            apart = np.abs((node[:, None] - node + 180.0) % 360.0 - 180.0) * DEG / _AZIMUTH_STEP_RAD
        else:
            place = np.searchsorted(_RANGE_NODES_M, node).astype(np.float64)
            apart = np.abs(place[:, None] - place)
        kept = np.stack([shape(node) for shape in kept_out(table)], axis=1)
        axes, size, _ = np.linalg.svd(kept, full_matrices=False)
        axes = axes[:, size > 1e-6 * size[0]]
        block = np.linalg.inv(np.exp(-apart / _SMOOTH)) + axes @ axes.T / _KEPT_OUT**2
        out[np.ix_(members, members)] = (block + block.T) / 2
    return out
