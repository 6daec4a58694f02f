"""What to record next: the sectors, ranges, levels, and numbers of targets that bring a wanted standard deviation.

What a target tells is its generalised least squares information with random effects (`registration.mixed`): a thousand plots of
one target share its transponder, its clock and its receiver, and cannot tell more than these let them.  The information of
targets that have not been recorded yet follows from where they would be and how they would fly; that of the recording at hand
follows from its residuals in the same way, and what the calibration reports against it scales the forecast.

The recording that is advised is found greedily: flights are added, a few at a time, where they bring the wanted sd down most
(c-optimal design; Pukelsheim 2006 has the theory).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from .._types import AnyArray, FloatArray, IntArray
from ..calibration import Calibration, Effect, Summary, TermKey
from ..errors import NothingToDo, SettingsError
from ..measure import enu_from_polar, polar_motion
from ..registration import mixed
from ..registration.least_squares import _AIR as AIR
from ..registration.least_squares import _GROUND as GROUND
from ..terms import DEG, Geometry, Term, Whose, known_names, order_of, precision, term_of, terms_of
from .residuals import Residuals

_EARTH_M = 6371e3
# Rows of the recording at hand that are looked at, and plots of an advised flight: enough to tell what they tell.
_MOST_ROWS, _MOST_PLOTS = 150_000, 120
_SECTORS, _RINGS = 12, (0.05, 0.25, 0.5, 0.75, 1.0)
# Radars see no plots straight above them, nor any below the horizon.
_STEEPEST_RAD, _LOWEST_RAD = 45 * DEG, 0.2 * DEG
_WAYS = ("outbound", "inbound", "clockwise", "anticlockwise")
_WAY_RAD = (0.0, math.pi, math.pi / 2, -math.pi / 2)
# More than this is no advice.
_MOST_TARGETS = 5_000
# The typical length of a target where a term asks for it: the pairs' own are not among the residuals.
_LENGTH_M = 35.0
# How many times as many targets may be needed where there is traffic as would do elsewhere.
_RATHER_SEEN = 3.0
# Lines of a table that is read.
_MOST_LINES = 16
# How many targets the typical sizes of effects count for.
_TYPICAL = 3.0
# How many times the time is lengthened by half in which the traffic that comes is to do it.
_LONGER = 8


class Goal(msgspec.Struct, frozen=True, kw_only=True):
    """One wanted sd: what it is now, what the advised recording would bring, both in `unit`; `why` where it cannot be reached.

    NaN where the calibration does not have the term, or the sd cannot be reached.
    """

    term: str
    unit: str
    wanted: float
    now: float
    expected: float
    reachable: bool
    why: str = ""


class Leg(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the advice: so many targets through the middle of this sector (deg), ring (m) and level, flying this way.

    `minutes` is how long each is seen.  `seen_per_hour` is how many came through there in the recording at hand, `hours` how long
    it takes for the targets to come (NaN: none came).
    """

    from_deg: float
    to_deg: float
    from_m: float
    to_m: float
    height_m: float
    flying: str
    speed_mps: float
    targets: int
    minutes: float
    seen_per_hour: float
    hours: float


class Same(msgspec.Struct, frozen=True, kw_only=True):
    """More of the traffic at hand: so many targets, in so many hours (NaN: not known), would bring every wanted sd."""

    targets: int
    hours: float


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What to record next for one sensor.

    `alone`: the advised recording counts by itself; else it is calibrated together with the one at hand.  `same` is more of the
    same traffic, `legs` what would do it with the fewest targets; both are empty where a goal cannot be reached.
    """

    sensor: str
    alone: bool
    goals: tuple[Goal, ...]
    same: Same | None
    legs: tuple[Leg, ...]
    hours: float
    notes: tuple[str, ...]

    @property
    def targets(self) -> int:
        """How many targets the legs have together."""
        return sum(leg.targets for leg in self.legs)


class Paths(NamedTuple):
    """Targets on their ways, one row a plot, target after target in time.

    `enu` and `velocity` (n, 3) are local to the antenna, `time_s` (n,), `target` (n,) numbers them from 0, `heading_rad` and
    `length_m` are NaN where not known, `channel` (n,) is the plots'.  `plots` (n,) is how many plots a row stands for.
    """

    enu: FloatArray
    velocity: FloatArray
    time_s: FloatArray
    target: IntArray
    heading_rad: FloatArray
    length_m: FloatArray
    channel: AnyArray
    plots: FloatArray


class Errors(NamedTuple):
    """What is random: the noise's sd of range, azimuth and elevation (NaN: not measured), and the effects of targets."""

    noise: tuple[float, float, float]
    effects: tuple[Effect, ...]


def information(paths: Paths, terms: Sequence[Term], errors: Errors) -> FloatArray:
    """What each target tells of the terms (G, p, p), in units of the terms' prior sd.

    ``X' V^-1 X`` with the covariance V of its plots: noise, and effects that are constant over their blocks of time.
    """
    p = len(terms)
    measured = [k for k in range(3) if np.isfinite(errors.noise[k])]
    spans = sorted({e.block_s for e in errors.effects if np.isfinite(e.block_s)})
    levels = [[e for e in errors.effects if e.block_s == span] for span in spans]
    levels.append([e for e in errors.effects if not np.isfinite(e.block_s)])
    polar, rate, second, third = polar_motion(
        paths.enu, paths.velocity, np.zeros_like(paths.enu),
        order=order_of([*terms, *(term_of(e.term) for e in errors.effects)]),
    )  # fmt: skip
    none = np.zeros(len(paths.time_s), np.int64)
    place = Geometry(
        polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, paths.heading_rad, paths.length_m, paths.time_s,
        Whose(paths.channel, none, none - 1),
    )  # fmt: skip
    unique: dict[str, FloatArray] = {}
    names: list[str] = []
    for term in [*(term_of(e.term) for level in levels for e in level), *terms]:
        names.append(term.name)
        if term.name not in unique:
            unique[term.name] = term.columns(place)
    order = list(unique)
    index = np.array([order.index(name) for name in names])
    scale = np.r_[np.ones(len(names) - p), [t.prior_sd for t in terms], 0.0]

    # Blocks of the levels, one within the other, as the estimate has them.
    first = np.flatnonzero(np.r_[True, np.diff(paths.target) != 0])
    begin = first
    since = paths.time_s - np.repeat(paths.time_s[first], np.diff(np.r_[first, len(paths.time_s)]))
    starts = [first]
    changed = np.zeros(len(since), bool)
    changed[first] = True
    for span in reversed(spans):
        block = np.floor(since / span)
        changed = changed | np.r_[True, np.diff(block) != 0]
        since = since - block * span
        begin = np.flatnonzero(changed)
        starts.insert(0, begin)
    blocks = starts[0]
    channel = np.zeros((len(measured), len(blocks), len(names) + 1, len(names) + 1))
    for k, axis in enumerate(measured):
        gram = np.zeros((len(blocks), len(order), len(order)))
        columns = [np.ascontiguousarray(unique[name][:, axis]) for name in order]
        for i, column in enumerate(columns):
            if column.any():
                weighted = column * paths.plots
                for j in range(i, len(columns)):
                    gram[:, i, j] = gram[:, j, i] = np.add.reduceat(weighted * columns[j], blocks)
        channel[k, :, :-1, :-1] = gram[:, index[:, None], index]
    channel *= np.outer(scale, scale)
    tiers, variances = [], []
    for number, level in enumerate(levels):
        within = np.arange(len(blocks)) if number == 0 else np.searchsorted(starts[number - 1], starts[number])
        tiers.append(mixed.Level(np.arange(len(level)), np.asarray(within, np.int64)))
        variances.append(np.array([e.sd**2 for e in level]))
    products = mixed.Products(channel, np.ones(len(measured)), tuple(tiers), p, np.ones(len(first)))
    noise = np.array([errors.noise[k] ** 2 for k in measured])
    reduced = mixed.reduce(products, mixed.Variances(noise, tuple(variances)))
    return np.asarray(reduced.terms[:, :p, :p])


@dataclass(frozen=True, slots=True)
class _Seen:
    """The recording at hand: its paths, how many targets each path stands for, and what kind of traffic it was."""

    paths: Paths
    stands_for: float
    targets: int
    hours: float
    farthest_m: float
    site_m: float
    levels_m: FloatArray
    speeds_mps: FloatArray
    minutes: float
    step_s: float
    per_hour: Mapping[tuple[int, int, int, int], float]


def plan(
    calibration: Calibration,
    wanted: Mapping[str, float],
    residuals: Residuals | None,
    *,
    sensor: str | None = None,
    alone: bool = False,
) -> Plan:
    """What to record next so that the terms of a sensor have the `wanted` sd: name -> sd in the term's unit.

    `residuals` are those of the calibration: where its information came from.  Without them, only more of the same traffic can be
    advised.  `sensor` is its name, needed where there are several.  With `alone`, the new recording is to do it by itself (the
    radar has been adjusted since), else together with the one at hand.

    Raises SettingsError for unknown sensors and terms, for an sd that is not positive, and where nothing is wanted; NothingToDo
    for a calibration over time.
    """
    if len(calibration.epoch_s) > 1:
        raise NothingToDo(
            "how well errors that change with time are known depends on how fast they change, not on how much is recorded",
            remedy="Calibrate without --online to plan a recording.",
        )
    s = _sensor(calibration, sensor)
    goals = _wishes(wanted)
    keys = [(k, key) for k, key in enumerate(calibration.terms) if key.sensor == s.sensor]
    notes: list[str] = []
    known, rows = _known_terms(keys, notes)
    names = [t.name for t in known]
    covariance = calibration.covariance[-1][np.ix_(rows, rows)]
    mine = None if residuals is None else residuals[residuals.sensor == s.sensor]
    if mine is not None and len(mine) < 3:
        mine = None
    now = {name: math.sqrt(covariance[k, k]) for k, name in enumerate(names)}

    impossible: dict[str, str] = {}
    extra: list[Term] = []
    for name in goals:
        if name not in names:
            why = _cannot(calibration, s, known, name)
            if why or mine is None:
                reason = next((n.why for n in calibration.not_determined if n.sensor == s.sensor and n.term == name), "")
                impossible[name] = why or reason or f"the model ({s.model}) has no {name}"
            else:
                extra.append(term_of(name))
                notes.append(f"the calibration does not have {name}: calibrate with a model that does, for it to be estimated")
    terms = [*known, *extra]
    target_sd = {t.name: goals[t.name] * t.si_per_unit for t in terms if t.name in goals}
    _caveats(s, target_sd, notes)
    if impossible or not target_sd:
        return _refused(s, goals, terms, now, impossible, alone, notes)
    if mine is None:
        return _more_of_the_same(s, goals, now, alone, notes)

    seen = _look(mine, terms)
    noise = (s.noise.range_m, s.noise.azimuth_rad, s.noise.elevation_rad)
    prior = precision(terms)
    size = np.array([t.prior_sd for t in terms])
    reported = covariance / np.outer(size[: len(known)], size[: len(known)])
    errors = Errors(noise, tuple(e for e in s.effects if e.sd > 0))
    if not errors.effects:
        errors = _tuned(seen, known, noise, reported, precision(known))
        notes.append(
            "the calibration does not tell what plots of one target share (an earlier version wrote it): one such error of range "
            "and one of azimuth are assumed, as large as the reported covariance asks for"
        )
    # What is reported against what the model forecasts for the recording at hand: outliers, the reference, few targets.
    own = np.linalg.inv(information(seen.paths, known, errors).sum(axis=0) * seen.stands_for + precision(known))
    ratio = np.diag(reported) / np.diag(own)
    factor = float(np.exp(np.mean(np.log(ratio))))
    # Each term's own ratio is uncertain by the number of targets; it counts as far as they are many, and wholly where the effects
    # are only assumed.
    trust = seen.targets / (seen.targets + 30.0) if s.effects else 1.0
    grow = np.full(len(terms), factor)
    grow[: len(known)] = factor * (ratio / factor) ** trust
    errors = _believed(errors, s) if s.effects else errors
    here = information(seen.paths, terms, errors).sum(axis=0) * seen.stands_for

    limit = np.array([(target_sd[t.name] / t.prior_sd) ** 2 if t.name in target_sd else np.inf for t in terms]) / grow
    if not extra:
        # The recording at hand tells what is reported, not what the model makes of it.
        root = np.sqrt(grow)
        here = np.linalg.inv(reported / np.outer(root, root)) - prior
    start = prior if alone else prior + here
    legs, tells = _candidates(seen, terms, errors)
    rate = np.array([_rate(seen, leg) for leg in legs])
    same = _same(seen, here, prior, limit, alone)
    chosen = _greedy(start, tells, limit, np.full(len(legs), _MOST_TARGETS))
    if chosen is None:
        return _refused(s, goals, terms, now, _unreached(start, tells, terms, limit), alone, notes)
    # Rather of the traffic that comes than of such as would have to be flown: as long as it takes, within reason.
    hours = same.hours if same is not None else 1.0
    for _ in range(_LONGER):
        coming = _greedy(start, tells, limit, np.floor(rate * hours + 1e-9).astype(np.int64))
        if coming is not None:
            chosen = coming if coming.sum() <= _RATHER_SEEN * max(chosen.sum(), 1) else chosen
            break
        hours *= 1.5
    if chosen.any() and not (rate[chosen > 0] > 0).all():
        notes.append("no such traffic came through some of these places in this recording: wait for it, or fly there")
    after = np.diag(np.linalg.inv(start + np.einsum("c,cij->ij", chosen.astype(np.float64), tells)))
    sd = np.sqrt(after * grow) * size
    advice = tuple(_leg(seen, leg, int(n)) for leg, n in zip(legs, chosen, strict=True) if n)
    each = [leg.hours for leg in advice]
    return Plan(
        sensor=s.name,
        alone=alone,
        goals=tuple(
            Goal(
                term=t.name,
                unit=t.unit,
                wanted=goals[t.name],
                now=now.get(t.name, math.nan) / t.si_per_unit,
                expected=float(sd[k]) / t.si_per_unit,
                reachable=True,
            )
            for k, t in enumerate(terms)
            if t.name in goals
        ),
        same=same,
        legs=advice,
        hours=max(each, default=0.0) if np.isfinite(each).all() else math.nan,
        notes=tuple(notes),
    )


def _sensor(calibration: Calibration, name: str | None) -> Summary:
    names = [s.name for s in calibration.sensors]
    if name is None and len(names) == 1:
        return calibration.sensors[0]
    if name is None:
        raise SettingsError(
            f"the calibration has {len(names)} sensors", where="--sensor", remedy=f"Name one: {', '.join(names)}."
        )
    if name not in names:
        raise SettingsError(f"the calibration has no sensor {name!r}", where="--sensor", remedy=f"Sensors: {', '.join(names)}.")
    return calibration.sensors[names.index(name)]


def _wishes(wanted: Mapping[str, float]) -> dict[str, float]:
    if not wanted:
        raise SettingsError("no sd is wanted", where="--sd", remedy="For example --sd azimuth_bias=0.005.")
    for name, sd in wanted.items():
        try:
            term_of(name)
        except SettingsError:
            raise SettingsError(f"there is no term {name!r}", where="--sd", remedy=known_names()) from None
        if not (math.isfinite(sd) and sd > 0):
            raise SettingsError(f"{name}={sd} is no sd", where="--sd", remedy="Give a positive number in the unit of the term.")
    return dict(wanted)


def _known_terms(keys: Sequence[tuple[int, TermKey]], notes: list[str]) -> tuple[list[Term], list[int]]:
    """The calibration's terms that depend on what the residuals tell, and where they stand."""
    terms, rows, left = [], [], []
    for k, key in keys:
        name = key.name if key.channel == "all" or "@" in key.name else f"{key.name}@{key.channel}"
        channel = name.partition("@")[2]
        if channel.startswith(("chain", "source ")):
            left.append(name)
        else:
            terms.append(term_of(name))
            rows.append(k)
    if left:
        notes.append(f"taken as known, because the residuals do not tell the chain of a plot: {', '.join(left)}")
    return terms, rows


def _cannot(calibration: Calibration, s: Summary, known: Sequence[Term], name: str) -> str:
    """Why no recording can bring the sd of a term that the calibration does not have; "" where one might."""
    term = term_of(name)
    if "elevation" in term.needs and not np.isfinite(s.noise.elevation_rad):
        return "the sensor measures no elevation"
    try:
        terms_of([*(t.name for t in known), name])
    except SettingsError as error:
        return f"it cannot be told from what the model has: {error}"
    if "length" in term.needs or "heading" in term.needs:
        return next((n.why for n in calibration.not_determined if n.sensor == s.sensor and n.term == name), "")
    return ""


def _caveats(s: Summary, wanted: Mapping[str, float], notes: list[str]) -> None:
    """What all targets share, and no number of them takes away."""
    if any(name.startswith("range_bias") for name in wanted) and any("transponders" in note for note in s.notes):
        notes.append(
            "range_bias holds what the delays of all transponders have in common, which no number of aircraft takes away "
            "(each may be off by 37 m with Mode S, by 75 m with Mode A/C)"
        )
    if any(name.startswith("time_offset") for name in wanted):
        notes.append("time_offset is against the reference's clock: what all its stamps are late by is in it")


def _refused(
    s: Summary,
    goals: Mapping[str, float],
    terms: Sequence[Term],
    now: Mapping[str, float],
    why: Mapping[str, str],
    alone: bool,
    notes: Sequence[str],
) -> Plan:
    """The plan that is none: which goals cannot be reached, and why."""
    by_name = {t.name: t for t in terms}
    rows = []
    for name, sd in goals.items():
        term = by_name.get(name) or term_of(name)
        rows.append(
            Goal(
                term=name,
                unit=term.unit,
                wanted=sd,
                now=now.get(name, math.nan) / term.si_per_unit,
                expected=math.nan,
                reachable=name not in why,
                why=why.get(name, ""),
            )
        )
    return Plan(sensor=s.name, alone=alone, goals=tuple(rows), same=None, legs=(), hours=math.nan, notes=tuple(notes))


def _more_of_the_same(s: Summary, goals: Mapping[str, float], now: Mapping[str, float], alone: bool, notes: list[str]) -> Plan:
    """Without the residuals: so many targets like those at hand, because the variance goes with their number."""
    notes.append(
        "no residuals of this sensor are beside the calibration: where to record cannot be told, only how many more such targets"
    )
    have = s.effective_targets if np.isfinite(s.effective_targets) else float(s.targets)
    per = s.targets / max(have, 1.0)
    ratio = max((now[name] / (sd * term_of(name).si_per_unit)) ** 2 for name, sd in goals.items())
    more = have * (ratio if alone else max(ratio - 1.0, 0.0))
    total = more + (0.0 if alone else have)
    return Plan(
        sensor=s.name,
        alone=alone,
        goals=tuple(
            Goal(
                term=name,
                unit=term_of(name).unit,
                wanted=sd,
                now=now[name] / term_of(name).si_per_unit,
                expected=now[name] / term_of(name).si_per_unit * math.sqrt(have / total),
                reachable=True,
            )
            for name, sd in goals.items()
        ),
        same=Same(targets=math.ceil(more * per), hours=math.nan),
        legs=(),
        hours=math.nan,
        notes=tuple(notes),
    )


def _look(mine: Residuals, terms: Sequence[Term]) -> _Seen:
    """The recording at hand, from its residuals: where its targets were and how they flew."""
    alone = np.where(mine.track >= 0, 2 * mine.track, 2 * np.arange(len(mine)) + 1)
    key = np.where(mine.target >= 0, mine.target, -2 - alone)
    order = np.lexsort((mine.time_s, key))
    r = mine.take(order)
    _, target = np.unique(key[order], return_inverse=True)
    count = int(target[-1]) + 1
    first = np.flatnonzero(np.r_[True, np.diff(target) != 0])
    last = np.r_[first[1:], len(target)] - 1
    enu = enu_from_polar(np.stack([r.reference_range_m, r.reference_azimuth_rad, r.reference_elevation_rad], axis=1))
    course = np.nan_to_num(r.reference_course_rad)
    speed = np.where(np.isfinite(r.reference_course_rad), np.nan_to_num(r.reference_speed_mps), 0.0)
    velocity = np.stack([speed * np.sin(course), speed * np.cos(course), np.zeros(len(r))], axis=1)
    ground = np.hypot(enu[:, 0], enu[:, 1])
    site = float(np.median(r.reference_height_m - enu[:, 2] - ground**2 / (2 * _EARTH_M)))
    farthest = float(np.quantile(r.reference_range_m, 0.99))
    hours = max(float(r.time_s.max() - r.time_s.min()) / 3600.0, 1 / 60)
    low, high = np.quantile(r.reference_height_m, [0.1, 0.9])
    levels = (
        np.quantile(r.reference_height_m, [0.15, 0.5, 0.85])
        if high - low > 300.0
        else np.array([np.median(r.reference_height_m)])
    )
    level = np.argmin(np.abs(r.reference_height_m[:, None] - levels), axis=1)
    typical = float(np.median(speed[speed > 0])) if (speed > 0).any() else 10.0
    speeds = np.array([np.median(speed[(level == k) & (speed > 0)]) if ((level == k) & (speed > 0)).any() else typical
                       for k in range(len(levels))])  # fmt: skip
    gaps = np.diff(r.time_s)[np.diff(target) == 0]
    gaps = gaps[gaps > 0]
    minutes = float(np.median(r.time_s[last] - r.time_s[first])) / 60.0

    # How many targets an hour came through each cell, with five plots or more there.
    sector, ring = _cell(r.reference_azimuth_rad, r.reference_range_m / farthest)
    away = np.mod(course - r.reference_azimuth_rad + math.pi / 4, 2 * math.pi)
    way = np.array([0, 2, 1, 3])[np.minimum((away // (math.pi / 2)).astype(np.int64), 3)]
    moving = (speed > 0) & (ring >= 0)
    cells, plots = np.unique(np.stack([sector, ring, level, way, target], axis=1)[moving], axis=0, return_counts=True)
    per_hour: dict[tuple[int, int, int, int], float] = {}
    for a, b, c, d, _ in cells[plots >= 5].tolist():
        per_hour[a, b, c, d] = per_hour.get((a, b, c, d), 0.0) + 1 / hours
    every = max(1, -(-len(r) // _MOST_ROWS))
    rows = np.flatnonzero(target % every == 0)
    length = np.full(len(rows), _LENGTH_M)
    return _Seen(
        paths=Paths(
            enu[rows], velocity[rows], r.time_s[rows] - r.time_s.min(), target[rows], r.reference_course_rad[rows], length,
            r.channel[rows], np.ones(len(rows)),
        ),
        stands_for=count / len(np.unique(target[rows])),
        targets=count,
        hours=hours,
        farthest_m=farthest,
        site_m=site,
        levels_m=levels,
        speeds_mps=speeds,
        minutes=minutes,
        step_s=float(np.median(gaps)) if len(gaps) else 10.0,
        per_hour=per_hour,
    )  # fmt: skip


def _cell(azimuth_rad: FloatArray, share: FloatArray) -> tuple[IntArray, IntArray]:
    """The sector and the ring (-1: within none) of each place; `share` is its range over the farthest."""
    sector = np.floor(np.mod(azimuth_rad, 2 * math.pi) / (2 * math.pi / _SECTORS)).astype(np.int64) % _SECTORS
    return sector, np.searchsorted(_RINGS, share, side="right").clip(0, len(_RINGS) - 1) - 1


def _tuned(
    seen: _Seen, terms: Sequence[Term], noise: tuple[float, float, float], reported: FloatArray, prior: FloatArray
) -> Errors:
    """Noise, and effects of targets in proportion to it, as large as the reported covariance (in prior sd) asks for."""

    def errors(times: float) -> Errors:
        kinds = ("range_bias", "azimuth_bias", "elevation_bias")
        effects = [Effect(name, math.inf, times * sd) for name, sd in zip(kinds, noise, strict=True) if np.isfinite(sd)]
        return Errors(noise, tuple(effects))

    def boasts(times: float) -> float:
        here = information(seen.paths, terms, errors(times)).sum(axis=0) * seen.stands_for
        ratio = np.diag(reported) / np.diag(np.linalg.inv(here + prior))
        return float(np.exp(np.mean(np.log(ratio))))

    low, high = 1e-3, 10.0
    for _ in range(12):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if boasts(middle) > 1.0 else (low, middle)
    return errors(high)


def _believed(errors: Errors, s: Summary) -> Errors:
    """The effects with what is typical of the kind of sensor as so many more targets.

    Variances of effects are known badly from a few dozen targets, and a plan would go where they came out too small by chance.
    """
    kind = GROUND if any(e.term == "along_heading" for e in errors.effects) else AIR
    spans = sorted({e.block_s for e in errors.effects})
    have = s.effective_targets if np.isfinite(s.effective_targets) else float(s.targets)
    out = []
    for e in errors.effects:
        level = kind.levels[max(len(kind.levels) - len(spans) + spans.index(e.block_s), 0)]
        name = "range_bias" if e.term == "transponder_delay" else e.term
        typical = next((t.sd for t in level if t.term == name), e.sd)
        out.append(Effect(e.term, e.block_s, math.sqrt((have * e.sd**2 + _TYPICAL * typical**2) / (have + _TYPICAL))))
    return Errors(errors.noise, tuple(out))


class _Way(NamedTuple):
    """A candidate: its cell (sector, ring, level, way), and its straight leg."""

    cell: tuple[int, int, int, int]
    minutes: float


def _candidates(seen: _Seen, terms: Sequence[Term], errors: Errors) -> tuple[list[_Way], FloatArray]:
    """Flights through the middle of every cell in every direction, and what each tells (c, p, p)."""
    parts: list[tuple[FloatArray, FloatArray, FloatArray, float]] = []
    ways: list[_Way] = []
    for level, (height, speed) in enumerate(zip(seen.levels_m.tolist(), seen.speeds_mps.tolist(), strict=True)):
        for ring in range(len(_RINGS) - 1):
            far = (_RINGS[ring] + _RINGS[ring + 1]) / 2 * seen.farthest_m
            for sector in range(_SECTORS):
                azimuth = (sector + 0.5) * 2 * math.pi / _SECTORS
                for way, turn in enumerate(_WAY_RAD):
                    path = _fly(seen, azimuth, far, height, speed, azimuth + turn)
                    if path is not None:
                        parts.append(path)
                        ways.append(_Way((sector, ring, level, way), len(path[2]) * path[3] * seen.step_s / 60.0))
    enu, velocity, time = (np.concatenate([part[k] for part in parts]) for k in range(3))
    count = np.concatenate([np.full(len(part[2]), part[3]) for part in parts])
    target = np.repeat(np.arange(len(parts)), [len(part[2]) for part in parts])
    heading = np.mod(np.arctan2(velocity[:, 0], velocity[:, 1]), 2 * math.pi)
    # Channels as they come in the recording at hand, dealt evenly.
    channel = np.sort(seen.paths.channel)[(np.arange(len(time)) * 0.6180339887 % 1.0 * len(seen.paths.channel)).astype(np.int64)]
    paths = Paths(enu, velocity, time, target, heading, np.full(len(time), _LENGTH_M), channel, count)
    return ways, information(paths, terms, errors)


def _fly(
    seen: _Seen, azimuth: float, far: float, height: float, speed: float, course: float
) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    """A straight and level leg through a place, as long as the targets at hand were seen: positions, velocities, times, and how
    many plots each row stands for.  None where the radar would not see it."""
    seconds = min(seen.minutes * 60.0, 0.8 * seen.farthest_m / speed)
    plots = max(int(seconds / seen.step_s), 5)
    thin = max(1.0, plots / _MOST_PLOTS)
    time = (np.arange(int(plots / thin)) + 0.5) * seen.step_s * thin
    off = (time - time.mean()) * speed
    up = height - seen.site_m
    ground = math.sqrt(max(far**2 - up**2, 0.0))
    east, north = ground * math.sin(azimuth) + off * math.sin(course), ground * math.cos(azimuth) + off * math.cos(course)
    enu = np.stack([east, north, up - (east**2 + north**2) / (2 * _EARTH_M)], axis=1)
    elevation = np.arctan2(enu[:, 2], np.hypot(east, north))
    slant = np.sqrt((enu**2).sum(axis=1))
    # A surface radar looks down on its targets: the horizon is no limit there.
    lowest = _LOWEST_RAD if up > 300.0 else -math.pi
    visible = (slant <= 1.02 * seen.farthest_m) & (np.abs(elevation) <= _STEEPEST_RAD) & (elevation >= lowest)
    if visible.sum() < 5 or ground == 0.0:
        return None
    velocity = np.tile([speed * math.sin(course), speed * math.cos(course), 0.0], (len(time), 1))
    return enu[visible], velocity[visible], time[visible], thin


def _greedy(start: FloatArray, tells: FloatArray, limit: FloatArray, most: IntArray) -> IntArray | None:
    """How many flights of each candidate (c,), at most `most`, bring the variances below their limits (p,); None: none do."""
    chosen = np.zeros(len(tells), np.int64)

    def excess(information: FloatArray) -> FloatArray:
        variance = np.diagonal(np.linalg.inv(information), axis1=-2, axis2=-1)
        return np.asarray(np.log(np.maximum(variance / limit, 1.0)).sum(axis=-1))

    have = start.copy()
    open_ = float(excess(have))
    while open_ > 0:
        some = max(1, int(chosen.sum()) // 20)
        left = np.where(chosen < most, excess(have + some * tells), np.inf)
        best = int(np.argmin(left))
        some = min(some, int(most[best] - chosen[best]))
        if not open_ - left[best] > 1e-9 or chosen.sum() + some > _MOST_TARGETS:
            return None
        # The last few: no more than are needed.
        while some > 1 and float(excess(have + (some - 1) * tells[best])) == 0.0:
            some -= 1
        have += some * tells[best]
        chosen[best] += some
        open_ = float(excess(have))
    return chosen


def _unreached(start: FloatArray, tells: FloatArray, terms: Sequence[Term], limit: FloatArray) -> dict[str, str]:
    """Why the goals that cannot be reached cannot: by what remains after very many targets everywhere."""
    inverse = np.linalg.inv(start + _MOST_TARGETS * tells.mean(axis=0))
    variance = np.diag(inverse)
    correlation = inverse / np.sqrt(np.outer(variance, variance)) - np.eye(len(terms))
    out = {}
    for k, term in enumerate(terms):
        if variance[k] > limit[k]:
            sd = math.sqrt(variance[k]) * term.prior_sd / term.si_per_unit
            why = f"even {_MOST_TARGETS:,} targets over the whole coverage would leave {sd:.2g} {term.unit}"
            j = int(np.argmax(np.abs(correlation[k])))
            if abs(correlation[k, j]) > 0.9:
                why += f"; it can hardly be told from {terms[j].name} (their estimates correlate by {correlation[k, j]:+.3f})"
            out[term.name] = why
    # Each by itself could be reached, but not with as many targets as make sense.
    reason = f"more than {_MOST_TARGETS:,} targets would be needed"
    return out or {term.name: reason for k, term in enumerate(terms) if np.isfinite(limit[k])}


def _same(seen: _Seen, here: FloatArray, prior: FloatArray, limit: FloatArray, alone: bool) -> Same | None:
    """How many more targets like those at hand would do; None where not even very many would."""

    def enough(more: float) -> bool:
        have = prior + here * ((0.0 if alone else 1.0) + more / seen.targets)
        return bool((np.diag(np.linalg.inv(have)) <= limit).all())

    if enough(0):
        return Same(targets=0, hours=0.0)
    low, high = 0, 1
    while not enough(high):
        low, high = high, 2 * high
        if high > 4 * _MOST_TARGETS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return Same(targets=high, hours=high / (seen.targets / seen.hours))


def _rate(seen: _Seen, way: _Way) -> float:
    return seen.per_hour.get(way.cell, 0.0)


def _leg(seen: _Seen, way: _Way, targets: int) -> Leg:
    sector, ring, level, flying = way.cell
    rate = _rate(seen, way)
    return Leg(
        from_deg=sector * 360.0 / _SECTORS,
        to_deg=(sector + 1) * 360.0 / _SECTORS,
        from_m=_RINGS[ring] * seen.farthest_m,
        to_m=_RINGS[ring + 1] * seen.farthest_m,
        height_m=float(seen.levels_m[level]),
        flying=_WAYS[flying],
        speed_mps=float(seen.speeds_mps[level]),
        targets=targets,
        minutes=way.minutes,
        seen_per_hour=rate,
        hours=targets / rate if rate > 0 else math.nan,
    )


def plan_json(found: Plan) -> dict[str, object]:
    """The plan as plain values; what is not known is None."""

    def plain(value: object) -> object:
        if isinstance(value, float):
            return value if math.isfinite(value) else None
        if isinstance(value, dict):
            return {k: plain(v) for k, v in value.items()}
        return [plain(v) for v in value] if isinstance(value, (list, tuple)) else value

    out = plain(msgspec.to_builtins(found))
    assert isinstance(out, dict)
    return out | {"targets": found.targets}


def plan_text(found: Plan) -> str:
    """The plan to read."""
    lines = [f"{found.sensor}: what to record next"]
    rows = [("error", "sd now", "wanted", "expected", "unit")]
    for g in found.goals:
        expected = "–" if not math.isfinite(g.expected) else f"{g.expected:.3g}"
        rows.append((g.term, "–" if not math.isfinite(g.now) else f"{g.now:.3g}", f"{g.wanted:.3g}", expected, g.unit))
    lines += _table(rows, left=(0, 4))
    lines += [f"  {g.term} cannot be brought to {g.wanted:.3g} {g.unit}: {g.why}" for g in found.goals if not g.reachable]
    with_it = "by itself" if found.alone else "together with the recording at hand"
    done = found.same is not None and found.same.targets == 0 and not found.legs
    if done:
        lines.append("The recording at hand is enough.")
    elif all(g.reachable for g in found.goals):
        if found.same is not None:
            time = f", about {_hours(found.same.hours)}" if math.isfinite(found.same.hours) else ""
            lines.append(f"More of the same traffic, calibrated {with_it}: {found.same.targets:,} targets{time}.")
        elif found.legs:
            lines.append("More of the same traffic would not do it.")
        if found.legs:
            fewest = found.same is None or found.targets <= found.same.targets
            lines.append(
                f"The fewest targets that would do it, {with_it}:" if fewest else "Of such traffic, the part that would do it:"
            )
            table = [("sector", "range", "height", "flying", "targets", "minutes each", "came per hour", "time")]
            most = sorted(found.legs, key=lambda leg: -leg.targets)[:_MOST_LINES]
            for leg in [leg for leg in found.legs if leg in most]:
                far = leg.to_m >= 5000
                ring = f"{leg.from_m / 1e3:.0f}–{leg.to_m / 1e3:.0f} km" if far else f"{leg.from_m:.0f}–{leg.to_m:.0f} m"
                table.append(
                    (
                        f"{leg.from_deg:03.0f}°–{leg.to_deg:03.0f}°",
                        ring,
                        f"{leg.height_m:,.0f} m" + (f" (FL{leg.height_m / 30.48:03.0f})" if leg.height_m > 1500 else ""),
                        leg.flying,
                        str(leg.targets),
                        f"{leg.minutes:.0f}" if leg.minutes >= 2 else f"{leg.minutes:.1f}",
                        f"{leg.seen_per_hour:.1f}" if leg.seen_per_hour else "none",
                        _hours(leg.hours) if math.isfinite(leg.hours) else "–",
                    )
                )
            lines += _table(table, left=(0, 2, 3))
            if len(found.legs) > len(most):
                rest = found.targets - sum(leg.targets for leg in most)
                lines.append(f"  … and {rest} in {len(found.legs) - len(most)} other places, which --json lists")
            whole = f", about {_hours(found.hours)} of recording" if math.isfinite(found.hours) else ""
            lines.append(f"  {found.targets:,} targets in all{whole}")
    lines += [f"note: {note}" for note in found.notes]
    return "\n".join(lines)


def _hours(hours: float) -> str:
    return f"{60 * hours:.0f} min" if hours < 2 else f"{hours:.1f} h" if hours < 48 else f"{hours / 24:.1f} days"


def _table(rows: Sequence[tuple[str, ...]], left: Sequence[int]) -> list[str]:
    wide = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  " + "  ".join(c.ljust(w) if k in left else c.rjust(w) for k, (c, w) in enumerate(zip(row, wide, strict=True))).rstrip()
        for row in rows
    ]
