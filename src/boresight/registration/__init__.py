"""Registration: from pairs of plots and reference positions to a radar's systematic errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from .._parallel import slices
from .._types import FloatArray, IntArray
from ..calibration import Accuracy, Calibration, Noise, NotDetermined, Summary, TermKey
from ..errors import NothingToDo, SettingsError
from ..model import EXCLUDED, Pairs, Plots, Sensor, Sensors
from ..terms import MODELS, TERMS, Term, Whose, kept_out, reference_term, summarised, table_of, terms_of, touches
from .least_squares import GROUND_KINDS, Dropped, Fit, LeastSquares, accuracy, check_settings, default_model, fit
from .observe import CHUNK, Observed, fill_lengths, geometry, linearise, observe, take, unusable
from .select import candidates, judge, search

__all__ = ["LeastSquares", "fill_lengths", "register"]

_EXTENT = ("along_heading", "along_heading_per_length")
_REFERENCE = "reference_time_offset"
# A node of a table needs so many plots; a further source of references so many, and such a share of them.
_NODE_PLOTS = 5
_SOURCE_PLOTS = 30
_SOURCE_SHARE = 0.02
# Offsets are one and the same where chance would let them differ more with this probability, and are there beyond so many sd
# and seconds.
_ALIKE = 0.01
_LATE_SD = 4.0
_LATE_S = 0.05


class _Found(NamedTuple):
    seen: Observed
    fitted: Fit
    summary: Summary
    not_determined: list[NotDetermined]


def register(
    pairs: Pairs, sensors: Sensors, *, model: str | Sequence[str] = "auto", settings: LeastSquares | None = None
) -> Calibration:
    """Find the systematic errors of every sensor in `pairs`.

    `model` is "auto" (each sensor's own `model`, else by its kind), the name of a model, a comma-separated list of terms, or a
    list of names.  Each sensor's values depend on its own pairs only; the covariance is joint, because the sensors see the same
    targets.  Terms that the data cannot give are named in `not_determined`.  bias = measured - true (METHODS sections 4, 6).

    Raises SettingsError for unknown terms, settings that make no sense, or a sensor without a position; NothingToDo where no
    pair can be used or no error of any sensor determined.
    """
    settings = LeastSquares() if settings is None else settings
    check_settings(settings)
    if not isinstance(model, str) or model != "auto":
        terms_of(model)
    if not len(pairs):
        raise NothingToDo("there are no pairs of plots and reference positions", remedy="Do the recordings share time and area?")
    pairs = fill_lengths(pairs)
    warnings: list[str] = []
    bad = unusable(pairs)
    usable = np.ones(len(pairs), bool)
    for reason, left_out in bad.items():
        usable &= ~left_out
        warnings.append(f"{left_out.sum():,} of {len(pairs):,} pairs were left out: {reason}")
    if not usable.any():
        raise NothingToDo(f"none of the {len(pairs):,} pairs can be used: {'; '.join(warnings)}")
    epoch = float(np.floor(pairs.plots.time_s[usable].min()))
    found: list[_Found] = []
    failed: list[str] = []
    for key in np.unique(pairs.plots.sensor[usable]).tolist():
        sensor = sensors.find(int(key))
        if sensor is None:
            raise SettingsError(
                f"the pairs hold a sensor {key >> 8}/{key & 255} that has no entry",
                where="sensors.toml",
                remedy="Add a [[sensor]].",
            )
        rows = np.flatnonzero(usable & (pairs.plots.sensor == key))
        try:
            found.append(_one(pairs, rows, sensor, epoch, model, settings))
        except NothingToDo as error:
            failed.append(str(error))
    if not found:
        raise NothingToDo("; ".join(failed))
    order = {s.key: k for k, s in enumerate(sensors)}
    found.sort(key=lambda f: order[f.summary.sensor])
    every = [(f.summary.sensor, t) for f in found for t in f.fitted.terms]
    value, covariance = np.concatenate([f.fitted.value for f in found]), _joint(found)
    warnings += _late_reference(every, value, covariance)
    # What is the references' own has done its work, and is no error of a radar.
    kept = np.array([k for k, (_, t) in enumerate(every) if not t.is_nuisance])
    return Calibration(
        terms=tuple(TermKey(key, t.channel, t.base, t.unit) for key, t in (every[k] for k in kept)),
        epoch_s=np.array([epoch]),
        value=value[None, kept],
        covariance=covariance[None, kept[:, None], kept],
        sensors=tuple(f.summary for f in found),
        not_determined=tuple(n for f in found for n in f.not_determined),
        warnings=tuple([*warnings, *failed]),
        settings={"method": "least-squares", **msgspec.structs.asdict(settings)},
    )


def _one(
    pairs: Pairs, rows: IntArray, sensor: Sensor, epoch: float, model: str | Sequence[str], settings: LeastSquares
) -> _Found:
    """One sensor's registration and what is said of it."""
    seen = observe(pairs, rows, sensor, epoch)
    name, wanted = _wanted(sensor, model)
    terms, dropped, notes = _fitting(wanted, seen)
    searched = _is_auto(sensor, model) and settings.criterion != "none"
    offered = _fitting(candidates(seen), seen)[0] if searched else ()
    terms = (*terms, *_late_sources(terms, seen, pairs))
    if not terms:
        raise NothingToDo(f"sensor {sensor.name!r}: no error can be determined: {'; '.join(d.why for d in dropped)}")
    lengths = seen.length_m
    if any(t.name == "along_heading_per_length" for t in (*terms, *offered)):
        typical = float(np.nanmedian(lengths))
        unknown = ~np.isfinite(lengths)
        if unknown.any():
            notes.append(f"{unknown.sum():,} pairs are of targets of unknown length: {typical:.0f} m, the median, is taken")
            seen = _with_length(seen, np.where(unknown, typical, lengths))
    if searched:
        name = "auto"
        likely = frozenset(t.name for t in terms)
        find = partial(search, likely=likely, settings=settings)
        fitted = fit(seen, terms, settings, candidates=offered, search=find)
        untested = [c for c in fitted.choices if c.action == "not tested"]
        dropped += [Dropped(term, c.why) for c in untested for term in c.term.split(" + ")]
    else:
        fitted = fit(seen, terms, settings)
    dropped += [d for d in fitted.dropped if not d.term.startswith(_REFERENCE)]
    notes += _said_of_sources(fitted, seen, pairs)
    notes += [*(d.note for d in fitted.dropped if d.note), *fitted.notes]
    names = {t.name for t in fitted.terms}
    if sensor.kind in GROUND_KINDS and "time_offset" in names and not names & set(_EXTENT):
        if not any(d.term in _EXTENT for d in dropped):
            dropped.append(
                Dropped(
                    "along_heading",
                    "the targets' extent is not in the model; it is confounded with time_offset: both move plots along the track",
                )
            )
        speed = float(np.median(np.sqrt((seen.velocity**2).sum(axis=1))))
        notes.append(
            "time_offset is confounded with the extent of the targets, which the model lacks: an echo 10 m behind the "
            f"reference's antenna looks like {10 / max(speed, 0.1):+.2f} s at the median speed of {speed:.0f} m/s"
        )
    notes += _alike(seen, fitted)
    if "range_bias" in names and sensor.kind not in GROUND_KINDS:
        delay = [e.sd for e in fitted.effects if e.term == "transponder_delay"]
        sd = (
            f" (each target's own has a sd of {delay[-1]:.3g} m, its position's offset along the range included)" if delay else ""
        )
        notes.append(f"range_bias holds the common part of the transponders' delays, which nothing can tell from it{sd}")
    notes += _primary(pairs.plots, rows, fitted)
    vertical = np.einsum("i,nij,j->n", seen.rotation[2], pairs.covariance[seen.row], seen.rotation[2])
    verdicts, budget = judge(seen, fitted, dropped, vertical)
    before, after, held = accuracy(seen, fitted)
    noise = fitted.noise_sd
    summary = Summary(
        sensor=sensor.key,
        name=sensor.name,
        model=name,
        noise=Noise(float(noise[0]), float(noise[1]), float(noise[2])),
        plots=len(seen),
        tracks=len(np.unique(pairs.track[rows])),
        targets=len(seen.cluster_key),
        effective_targets=fitted.effective,
        before=_accuracy(before),
        after=_accuracy(after),
        held_out_before_median_m=_accuracy(before[np.isfinite(held)]).median_m,
        held_out_after_median_m=_accuracy(held).median_m,
        held_out_before_p95_m=_accuracy(before[np.isfinite(held)]).p95_m,
        held_out_after_p95_m=_accuracy(held).p95_m,
        notes=tuple(notes),
        criterion=settings.criterion if searched else "",
        choices=fitted.choices,
        verdicts=verdicts,
        budget=budget,
        effects=fitted.effects,
    )
    return _Found(seen, fitted, summary, [NotDetermined(sensor.key, d.term, d.why) for d in dropped])


def _alike(seen: Observed, fitted: Fit) -> list[str]:
    """What is to be said of terms that move plots alike: time and extent on the ground, lags of range and azimuth."""
    said = []
    names = [t.name for t in fitted.terms]
    extent = next((k for k, name in enumerate(names) if name in _EXTENT), None)
    if "time_offset" in names and extent is not None:
        k = names.index("time_offset")
        some = take(seen, np.arange(0, len(seen), -(-len(seen) // CHUNK)))
        place, _, x = linearise(some, slice(None), fitted.terms, fitted.value)
        metres = np.stack([x[:, 0], x[:, 1] * (place.range_m * np.cos(place.elevation_rad))[:, None]])
        size = np.maximum(np.sqrt((metres**2).sum(axis=(0, 1))), 1e-300)
        unit = np.einsum("cni,cnj->ij", metres / size, metres / size)
        columns = np.linalg.inv(unit + 1e-9 * np.eye(len(names)))
        # Half of what one does, the other can do too.
        alike = max(abs(float(c[k, extent] / np.sqrt(c[k, k] * c[extent, extent]))) for c in (columns, fitted.covariance))
        if alike**2 >= 0.5:
            speed = float(np.median(np.sqrt((seen.velocity**2).sum(axis=1))))
            grown = 1 / np.sqrt(max(1 - alike**2, 1e-4))
            said.append(
                f"time_offset and {names[extent]} can hardly be told apart: both move plots along the track, and their effects "
                f"correlate by {alike:.2f}, which makes the sd of time_offset {grown:.1f} times what it would be; at the median "
                f"speed of {speed:.1f} m/s an echo 1 m further back looks like {1 / max(speed, 0.1):+.2f} s"
            )
    lags = [names.index(name) for name in ("range_lag", "azimuth_lag") if name in names]
    if len(lags) == 2:
        one, two = fitted.value[lags]
        c = fitted.covariance[np.ix_(lags, lags)]
        if one * two > 0 and abs(one - two) <= 2 * np.sqrt(max(c[0, 0] + c[1, 1] - 2 * c[0, 1], 0.0)):
            said.append(
                "range_lag and azimuth_lag are alike: what follows the targets' accelerations in every direction may be the "
                "reference's smoothing rather than a servo of the radar"
            )
    return said


def _with_length(seen: Observed, length: FloatArray) -> Observed:
    return replace(seen, length_m=length)


def _is_auto(sensor: Sensor, model: str | Sequence[str]) -> bool:
    """Whether nobody has said what the model of this sensor is."""
    return isinstance(model, str) and model == "auto" and sensor.model in (None, "auto")


def _wanted(sensor: Sensor, model: str | Sequence[str]) -> tuple[str, tuple[Term, ...]]:
    """Name and terms of the model for this sensor."""
    if isinstance(model, str) and model == "auto":
        model = sensor.model if sensor.model is not None and sensor.model != "auto" else default_model(sensor)
    terms = terms_of(model)
    if isinstance(model, str) and model in MODELS:
        return model, terms
    return ",".join(summarised(t.name for t in terms)), terms


def _fitting(wanted: Sequence[Term], seen: Observed) -> tuple[tuple[Term, ...], list[Dropped], list[str]]:
    """The terms whose needs are met; why others are not; what is to be said."""
    terms: list[Term] = []
    dropped: list[Dropped] = []
    notes: list[str] = []
    heading = np.isfinite(seen.heading_rad)
    length = float(np.mean(np.isfinite(seen.length_m[heading]))) if heading.any() else 0.0
    tables = _tables(wanted, seen)
    for term in wanted:
        if term.channel != "all" and not np.any(touches(term.channel, Whose(seen.channel, seen.flags, seen.source))):
            dropped.append(Dropped(term.name, f"no plot is of the channel {term.channel}"))
        elif term.name in tables:
            why = tables[term.name]
            if why and not any(d.term == table_of(term) for d in dropped):
                dropped.append(Dropped(table_of(term), why))
        elif "elevation" in term.needs and not seen.has_elevation:
            dropped.append(Dropped(term.name, "the sensor measures no elevation"))
        elif "heading" in term.needs and not heading.any():
            dropped.append(Dropped(term.name, "no target's heading is known: none carries one or moves faster than 3 m/s"))
        elif "length" in term.needs and length < 0.5:
            known = f"the length of only {100 * length:.0f} % of the targets' plots is known"
            known = "no target's length is known" if length == 0 else known
            dropped.append(Dropped(term.name, f"{known}; along_heading, the same for all, takes its place"))
            if not any(t.name == "along_heading" for t in wanted):
                terms.append(TERMS["along_heading"])
                notes.append(f"{known}: along_heading, one extent for all, is fitted in place of {term.name}")
        else:
            terms.append(term)
    return tuple(terms), dropped, notes


def _tables(wanted: Sequence[Term], seen: Observed) -> dict[str, str]:
    """The nodes of tables that have no plots, or too few beside them to mean anything, and why."""
    nodes = [t for t in wanted if table_of(t)]
    if not nodes:
        return {}
    count = np.zeros(len(nodes))
    for part in slices(len(seen), CHUNK):
        place = geometry(seen, part, None, 0)
        count += [np.count_nonzero(np.abs(t.columns(place)).max(axis=1) > 0.2) for t in nodes]
    out: dict[str, str] = {}
    for table in dict.fromkeys(table_of(t) for t in nodes):
        mine = {t.name: t.base.rpartition("_")[2] for t in nodes if table_of(t) == table}
        empty = [t.name for t, n in zip(nodes, count, strict=True) if table_of(t) == table and n < _NODE_PLOTS]
        own = len(kept_out(table))
        if len(mine) - len(empty) <= own:
            why = f"only {len(mine) - len(empty)} of its {len(mine)} nodes have plots, and {own} numbers of them are other terms"
            out |= dict.fromkeys(mine, why)
        elif empty:
            out |= dict.fromkeys(empty, f"its nodes {', '.join(mine[name] for name in empty)} have no plots")
    return out


def _late_sources(terms: Sequence[Term], seen: Observed, pairs: Pairs) -> tuple[Term, ...]:
    """A nuisance for each further source of references that a good part of the plots are paired with."""
    sources = _sources(pairs)
    if len(sources) < 2 or not any(t.is_time for t in terms):
        return ()
    here = {int(key): int(n) for key, n in zip(*np.unique(seen.source, return_counts=True), strict=True)}
    enough = {key for key, n in here.items() if n >= max(_SOURCE_PLOTS, _SOURCE_SHARE * len(seen))}
    return tuple(reference_term(key) for key in sources[1:] if key in enough and enough != {key})


def _sources(pairs: Pairs) -> list[int]:
    """The ids of the references' sources, the one with most pairs first."""
    keys, counts = np.unique(pairs.source[pairs.source >= 0], return_counts=True)
    return [int(key) for key in keys[np.argsort(-counts, kind="stable")]]


def _place(key: int) -> str:
    return f"{key >> 8}/{key & 255}" if 0 <= key < 65536 else f"id {key}"


def _said_of_sources(fitted: Fit, seen: Observed, pairs: Pairs) -> list[str]:
    """By how much the further references are later than the first, and which could not be told."""
    out = []
    for k, term in enumerate(fitted.terms):
        if term.is_nuisance:
            sd = float(np.sqrt(fitted.covariance[k, k]))
            out.append(
                f"the reference {_place(int(term.channel.split()[1]))} is stamped {fitted.value[k]:+.3f} ± {sd:.3f} s later than "
                f"{_place(_sources(pairs)[0])}: corrected for here; time_offset is relative to the latter"
            )
    for d in fitted.dropped:
        if d.term.startswith(_REFERENCE):
            out.append(f"whether the reference {_place(int(d.term.split()[1]))} is later than the other cannot be told: {d.why}")
    return out


def _late_reference(every: Sequence[tuple[int, Term]], value: FloatArray, covariance: FloatArray) -> list[str]:
    """A warning where all radars show one and the same time offset: it may be the reference's."""
    from scipy.special import chdtrc

    k = np.array([i for i, (_, t) in enumerate(every) if t.name == "time_offset"], np.int64)
    if not len(k):
        return []
    inside = covariance[np.ix_(k, k)]
    weight = np.linalg.solve(inside, np.ones(len(k)))
    sd = float(1 / np.sqrt(weight.sum()))
    mean = float(weight @ value[k] / weight.sum())
    off = value[k] - mean
    alike = float(chdtrc(len(k) - 1, off @ np.linalg.solve(inside, off))) if len(k) > 1 else 1.0
    if alike < _ALIKE or abs(mean) < max(_LATE_SD * sd, _LATE_S):
        return []
    if len(k) > 1:
        which = f"{'both' if len(k) == 2 else f'all {len(k)}'} radars show the same time offset"
    elif mean < 0:
        which = "the time offset is that of stamps before the measurement"
    else:
        return []
    later = "late" if mean < 0 else "early"
    return [f"{which} ({mean:+.3f} ± {sd:.3f} s): the reference may be stamped {later} by as much; nothing here can tell"]


def _primary(plots: Plots, rows: IntArray, fitted: Fit) -> list[str]:
    """The primary's own biases, where combined plots tell primary minus secondary (I048/130)."""
    flags = plots.flags[rows] & np.uint32(EXCLUDED)
    told = rows[np.isfinite(plots.psr_ssr_range_m[rows]) & np.isfinite(plots.psr_ssr_azimuth_rad[rows]) & (flags == 0)]
    if len(told) < _SOURCE_PLOTS:
        return []
    value = {t.name: (v, s) for t, v, s in zip(fitted.terms, fitted.value, np.sqrt(np.diag(fitted.covariance)), strict=True)}
    parts = []
    for name, column, unit, digits in (
        ("range_bias", plots.psr_ssr_range_m[told], TERMS["range_bias"], 1),
        ("azimuth_bias", plots.psr_ssr_azimuth_rad[told], TERMS["azimuth_bias"], 4),
    ):
        middle = float(np.median(column))
        scatter = float(1.4826 * np.median(np.abs(column - middle)))
        scale = unit.si_per_unit
        text = f"{middle / scale:+.{digits}f} {unit.unit} (sd of a plot {scatter / scale:.{digits}f})"
        if name in value:
            text += f", so that the primary's own {name} is {(middle + value[name][0]) / scale:+.{digits}f} {unit.unit}"
        parts.append(text)
    return [f"primary minus secondary of {len(told):,} combined plots (I048/130), median: {'; '.join(parts)}"]


def _accuracy(distance: FloatArray) -> Accuracy:
    good = distance[np.isfinite(distance)]
    if not len(good):
        return Accuracy(float("nan"), float("nan"))
    median, p95 = np.percentile(good, [50, 95])
    return Accuracy(float(median), float(p95))


def _joint(found: Sequence[_Found]) -> FloatArray:
    """The covariance (p, p) over all sensors' terms.

    A target's own errors (its reference's offset and latency, its transponder) enter every sensor's estimate.  How much of
    them the sensors share is estimated from the products of their scores over common targets.
    """
    sizes = [len(f.fitted.terms) for f in found]
    edges = np.r_[0, np.cumsum(sizes)]
    out = np.zeros((edges[-1], edges[-1]))
    grow = []
    for k, f in enumerate(found):
        own = slice(edges[k], edges[k + 1])
        out[own, own] = f.fitted.covariance
        root, model_root = (_scaled_cholesky(c, f.fitted.terms) for c in (f.fitted.covariance, f.fitted.model_covariance))
        grow.append(root @ np.linalg.inv(model_root))
    for i in range(len(found)):
        for j in range(i + 1, len(found)):
            cross = grow[i] @ _cross(found[i], found[j]) @ grow[j].T
            out[edges[i] : edges[i + 1], edges[j] : edges[j + 1]] = cross
            out[edges[j] : edges[j + 1], edges[i] : edges[i + 1]] = cross.T
    if len(found) > 2:
        # Shares are estimated pair by pair; together they could contradict each other.
        sd = np.sqrt(np.diag(out))
        value, axes = np.linalg.eigh(out / sd[:, None] / sd)
        if value.min() < 1e-9:
            fixed = (axes * np.maximum(value, 1e-9)) @ axes.T
            size = np.sqrt(np.diag(fixed))
            out = fixed / size[:, None] / size * sd[:, None] * sd
    return (out + out.T) / 2


def _scaled_cholesky(covariance: FloatArray, terms: Sequence[Term]) -> FloatArray:
    size = np.array([t.prior_sd for t in terms])
    root: FloatArray = np.linalg.cholesky(covariance / size[:, None] / size) * size[:, None]
    return root


def _cross(one: _Found, two: _Found) -> FloatArray:
    """The model's covariance (p1, p2) between two sensors' values, from the effects that they share."""
    from scipy.optimize import nnls

    a, b = one.fitted, two.fitted
    _, i, j = np.intersect1d(one.seen.cluster_key, two.seen.cluster_key, assume_unique=True, return_indices=True)
    # Negative keys are tracks of one radar, which no other knows.
    common = one.seen.cluster_key[i] >= 0
    i, j = i[common], j[common]
    names = [n for n in a.effect_names if n in b.effect_names]
    if len(i) < 2 or not names:
        return np.zeros((len(a.terms), len(b.terms)))
    ka, kb = [a.effect_names.index(n) for n in names], [b.effect_names.index(n) for n in names]
    limit = np.sqrt(a.effect_variance[ka] * b.effect_variance[kb])
    scale = np.sqrt(np.maximum(limit, 1e-300))
    products = (a.scores[i][:, ka] * b.scores[j][:, kb]).sum(axis=0) * scale**2
    matrix = (a.information[i][:, ka][:, :, ka] * b.information[j][:, kb][:, :, kb]).sum(axis=0) * np.outer(scale**2, scale**2)
    size = np.maximum(np.diag(matrix), 1e-300)
    share = np.minimum(nnls(matrix / size[:, None], products / size)[0], 1.0)
    shared = share * limit
    left = a.bread @ np.swapaxes(a.influence[i][:, ka], 1, 2)
    right = b.influence[j][:, kb] @ b.bread
    cross: FloatArray = np.einsum("gpk,k,gkq->pq", left, shared, right)
    return cross
