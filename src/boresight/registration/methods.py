"""Every way of registration by one interface: a method by its name, its options, and the calibration that it gives.

`register_with` takes any of them; all are judged alike, on the same folds of held-out targets.  METHODS sections 3 to 6.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, get_type_hints

import msgspec
import numpy as np

from .._parallel import in_threads, slices
from .._types import BoolArray, FloatArray, IntArray
from ..calibration import Accuracy, Calibration, Noise, NotDetermined, Summary, TermKey, advised
from ..errors import NothingToDo, SettingsError
from ..geodesy import height_and_up
from ..measure import enu_from_polar, position_from_height
from ..model import Pairs, Sensor, Sensors
from ..terms import TERMS, Term, term_of
from . import register
from .least_squares import LeastSquares, folds, typical_noise
from .likelihood import SCALE_M, KalmanTransform, MaximumLikelihood, Transforms
from .mean_shift import ExponentialAverage, Igmsr, MeanShift
from .observe import CHUNK, Observed, Values, distances, look, observe, take, unusable
from .per_channel import FEW_TARGETS, PerChannel, blocks_of, inflation, own_sd, register_per_channel
from .rigid import Clouds, Genetic, RansacIcp, Rigid
from .sequential import BIASES, AlphaBetaBias, KalmanBank, online_samples, register_online
from .sequential import METHODS as ONLINE

S = TypeVar("S", bound=msgspec.Struct)
Method = (
    LeastSquares
    | PerChannel
    | MaximumLikelihood
    | KalmanTransform
    | RansacIcp
    | Genetic
    | KalmanBank
    | Igmsr
    | MeanShift
    | AlphaBetaBias
    | ExponentialAverage
)
OnlineMethod = KalmanBank | Igmsr | MeanShift | AlphaBetaBias | ExponentialAverage
METHODS: dict[str, Method] = {
    "least-squares": LeastSquares(),
    "per-channel": PerChannel(),
    "maximum-likelihood": MaximumLikelihood(),
    "kalman-transform": KalmanTransform(sd_m=0.0),
    "ransac-icp": RansacIcp(),
    "genetic": Genetic(),
    **{name: method for name, method in ONLINE.items() if isinstance(method, OnlineMethod)},
}
"""Every method by the name that an option gives, with its defaults; the first is the default."""

# Terms of a rigid and of an affine transform, the ones to give up first last; of a radar without elevation, the level ones only.
_LEVEL = ("site_east", "site_north", "rotation_up")
_RIGID = (*_LEVEL, "site_up", "rotation_east", "rotation_north")
_LEVEL_AFFINE = (*_LEVEL, "stretch_east", "stretch_north", "shear_east_north")
_AFFINE = (
    *_RIGID, "stretch_east", "stretch_north", "shear_east_north", "stretch_up", "shear_east_up", "shear_north_up",
)  # fmt: skip
# Elevations of fewer plots than this share are passed over.
_MOST = 0.5
# A term is told by the data where they leave less than this part of what was assumed of it beforehand.
_TOLD = 0.5
_EPOCHS = 400
_FLOOR_POLAR = np.array([1e-3, 1e-8, 1e-8])
_FLOOR_M = 1e-3
# Rows from which the columns of a transform are told apart.
_ROWS = 20_000
# Plots that the likelihood is maximised on.
_PLOTS = 60_000
_SD_PER_MEDIAN = 1.4826


def method_of(name: str, options: Mapping[str, object] | None = None) -> Method:
    """The method of this name, with `options` in place of its defaults; they may be text, as from a command line.

    A list of numbers is text with commas; options of a method inside the method have dots ("rough.iterations").  Raises
    SettingsError for names and options that do not exist, with those that do, and for values that cannot be.
    """
    if name not in METHODS:
        raise SettingsError(f"there is no method {name!r}", where="method", remedy=f"Methods: {', '.join(METHODS)}.")
    default = METHODS[name]
    known = options_of(default)
    given: dict[str, Any] = {}
    for key, value in (options or {}).items():
        if key not in known:
            raise SettingsError(
                f"the method {name} has no option {key!r}", where="method", remedy=f"Its options: {', '.join(known)}."
            )
        *path, last = key.split(".")
        inside = given
        for part in path:
            inside = inside.setdefault(part, {})
        inside[last] = [part.strip() for part in value.split(",")] if isinstance(value, str) and "," in value else value
    return _with(default, given)


def options_of(method: Method) -> dict[str, object]:
    """The options of a method and their values, in plain types; those of a method inside it have dots."""
    out: dict[str, object] = {}
    for key, value in msgspec.structs.asdict(method).items():
        if isinstance(value, msgspec.Struct):
            out |= {f"{key}.{inner}": v for inner, v in msgspec.structs.asdict(value).items()}
        else:
            out[key] = list(value) if isinstance(value, tuple) else value
    return out


def name_of(method: Method) -> str:
    """The name by which `METHODS` knows the method."""
    return str(method.__struct_config__.tag)


def _with(default: S, given: Mapping[str, Any]) -> S:
    hints = get_type_hints(type(default))
    inside: dict[str, Any] = {}
    for key, value in given.items():
        if isinstance(value, dict):
            inside[key] = _with(getattr(default, key), value)
            continue
        try:
            inside[key] = msgspec.convert(value, hints[key], strict=not _has_text(value))
        except msgspec.ValidationError as error:
            raise SettingsError(
                f"{key} = {value!r} cannot be: {str(error)[:1].lower()}{str(error)[1:]}",
                where=str(default.__struct_config__.tag),
                remedy=f"Its default is {getattr(default, key)}.",
            ) from error
    return msgspec.structs.replace(default, **inside)


def _has_text(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and any(isinstance(v, str) for v in value))


def register_with(
    method: Method, pairs: Pairs, sensors: Sensors, *, model: str | Sequence[str] = "auto", online: bool = False
) -> Calibration:
    """Find the systematic errors of every sensor in `pairs` by this method.  bias = measured - true.

    `model` is for "least-squares" (see `register`) and "per-channel" (an order, or three with commas; "auto" is at most the
    second, by BIC, unless the method's own options say otherwise); the others have one model each.  Methods that follow the
    errors over time give a calibration with many epochs; with `online` least squares does too: a Kalman bank follows the three
    biases, beside constant values of the other terms.

    Each sensor is estimated by itself (least squares: jointly in the covariance).  Every summary has the accuracy before and
    after and on held-out targets, on folds that are the same for all methods; of errors over time, held out means that the
    values at a plot's time come from the other targets.  What a method cannot tell is in `not_determined`.

    Raises SettingsError for options or a model that make no sense, or a sensor without an entry; NothingToDo where no pair can be
    used or no error of any sensor told.
    """
    name = name_of(method)
    if online and not isinstance(method, LeastSquares | KalmanTransform | OnlineMethod):
        over_time = [n for n, m in METHODS.items() if isinstance(m, LeastSquares | KalmanTransform | OnlineMethod)]
        raise SettingsError(
            f"the method {name} gives one value for all time", where="online", remedy=f"Over time: {', '.join(over_time)}."
        )
    if isinstance(method, LeastSquares) and not online:
        return register(pairs, sensors, model=model, settings=method)
    if not isinstance(method, LeastSquares | PerChannel) and model != "auto":
        raise SettingsError(
            f"the method {name} has one model only, and none is to be named",
            where="model",
            remedy="Leave the model out, or say least-squares or per-channel.",
        )
    if isinstance(method, PerChannel) and not isinstance(model, str):
        model = ",".join(model)
    if not len(pairs):
        raise NothingToDo("there are no pairs of plots and reference positions", remedy="Do the recordings share time and area?")
    warnings: list[str] = []
    usable = np.ones(len(pairs), bool)
    for reason, left_out in unusable(pairs).items():
        usable &= ~left_out
        warnings.append(f"{left_out.sum():,} of {len(pairs):,} pairs were left out: {reason}")
    if not usable.any():
        raise NothingToDo(f"none of the {len(pairs):,} pairs can be used: {'; '.join(warnings)}")
    pairs = pairs[usable]
    time = pairs.plots.time_s
    epoch = float(np.floor(time.min()))
    epochs = np.r_[epoch, np.linspace(float(time.min()), float(time.max()), _EPOCHS + 1)[1:]]
    job = _Job(method, model, epoch, np.unique(epochs))
    if isinstance(method, LeastSquares):
        job = job._replace(constant=register(pairs, sensors, model=model, settings=method))
        warnings += job.constant.warnings if job.constant is not None else ()
    found: list[Calibration] = []
    failed: list[str] = []
    for key in np.unique(pairs.plots.sensor).tolist():
        sensor = sensors.find(int(key))
        if sensor is None:
            raise SettingsError(
                f"the pairs hold a sensor {key >> 8}/{key & 255} that has no entry",
                where="sensors.toml",
                remedy="Add a [[sensor]].",
            )
        try:
            found.append(_one(job, pairs[pairs.plots.sensor == key], sensor))
        except NothingToDo as error:
            failed.append(str(error) if sensor.name in str(error) else f"sensor {sensor.name!r}: {error}")
    if not found:
        raise NothingToDo("; ".join(failed))
    order = {s.key: k for k, s in enumerate(sensors)}
    found.sort(key=lambda c: order[c.sensors[0].sensor])
    said = [text for c in found for text in c.warnings if text not in warnings]
    return replace(
        _side_by_side(found),
        warnings=tuple([*warnings, *said, *failed]),
        settings={"method": name, **options_of(method), **({"online": True} if online else {})},
    )


class _Job(NamedTuple):
    """What is to be done to each sensor: the method with its model, the epoch, and the epochs of errors over time.

    `constant` is what least squares found of all sensors together, where the biases are followed beside it.
    """

    method: Method
    model: str | Sequence[str]
    epoch_s: float
    epochs_s: FloatArray
    constant: Calibration | None = None


def _side_by_side(found: Sequence[Calibration]) -> Calibration:
    """Calibrations of several sensors with the same epochs as one; their estimates are taken as independent."""
    sizes = [len(c.terms) for c in found]
    edge = np.r_[0, np.cumsum(sizes)]
    covariance = np.zeros((len(found[0].epoch_s), edge[-1], edge[-1]))
    for c, begin, end in zip(found, edge[:-1], edge[1:], strict=True):
        covariance[:, begin:end, begin:end] = c.covariance
    return Calibration(
        terms=tuple(key for c in found for key in c.terms),
        epoch_s=found[0].epoch_s,
        value=np.concatenate([c.value for c in found], axis=1),
        covariance=covariance,
        sensors=tuple(s for c in found for s in c.sensors),
        not_determined=tuple(n for c in found for n in c.not_determined),
    )


# ------------------------------------------------------------------------------------------------------------- one sensor
def _one(job: _Job, pairs: Pairs, sensor: Sensor) -> Calibration:
    """One sensor's calibration, with its accuracy on all targets and on those held out."""
    found = _fit(job, pairs, sensor)
    seen = observe(pairs, np.arange(len(pairs)), sensor, job.epoch_s)
    # The model that was found is what held-out targets judge, not the search for it.
    again = job
    if isinstance(job.method, LeastSquares):
        constant = _constant(job, pairs, sensor)
        names = [name for key, name in zip(constant.terms, _asked(constant), strict=True) if key.sensor == sensor.key]
        again = job._replace(constant=None, model=names)
    held, others = held_out(lambda some: _fit(again, some, sensor), pairs, seen)
    before, after = _distances(seen, None), _distances(seen, found)
    there = np.isfinite(held)
    summary = found.sensors[0]
    notes = list(summary.notes)
    over_time = len(found.epoch_s) > 1
    if over_time:
        found = _widened(found, others, seen)
    if there.any():
        out_before, out_after = _accuracy(before[there]), _accuracy(held[there])
        if over_time:
            notes.append("held out: the values at a plot's time come from the other targets' plots up to then")
        if not out_after.median_m < out_before.median_m:
            notes.append("held-out targets come no nearer with this calibration: nothing speaks for applying it")
    else:
        out_before = out_after = _accuracy(held[:0])
        notes.append("there are too few targets to hold some out")
    told = {key.name for key in found.terms} | {n.term for n in found.not_determined}
    missing = [NotDetermined(sensor.key, term, why) for term, why in _untold(job.method, found, seen).items() if term not in told]
    size = np.bincount(seen.cluster).astype(np.float64)
    summary = msgspec.structs.replace(
        summary,
        plots=len(seen),
        tracks=len(np.unique(pairs.track)),
        targets=len(seen.cluster_key),
        effective_targets=float(size.sum() ** 2 / (size**2).sum()),
        before=_accuracy(before),
        after=_accuracy(after),
        held_out_before_median_m=out_before.median_m,
        held_out_after_median_m=out_after.median_m,
        held_out_before_p95_m=out_before.p95_m,
        held_out_after_p95_m=out_after.p95_m,
        notes=tuple(notes),
    )
    return replace(found, sensors=(summary,), not_determined=(*found.not_determined, *missing))


def _asked(found: Calibration) -> list[str]:
    return [key.name if key.channel == "all" else f"{key.name}@{key.channel}" for key in found.terms]


def _fit(job: _Job, pairs: Pairs, sensor: Sensor) -> Calibration:
    """The calibration of one sensor by the pairs (all of it, all usable), without its accuracy."""
    method = job.method
    if isinstance(method, LeastSquares):
        return _least_squares_online(job, pairs, sensor)
    if isinstance(method, PerChannel):
        if job.model == "auto" and method.select == "none" and method.model == PerChannel().model:
            method = msgspec.structs.replace(method, select="bic")
        assert isinstance(job.model, str)
        return replace(
            register_per_channel(pairs, Sensors((sensor,)), model=job.model, settings=method), epoch_s=np.array([job.epoch_s])
        )
    if isinstance(method, OnlineMethod):
        return _followed(method, job, pairs, sensor)
    seen = observe(pairs, np.arange(len(pairs)), sensor, job.epoch_s)
    if isinstance(method, MaximumLikelihood):
        return _likeliest(method, seen)
    return _transformed(method, job, seen)


def held_out(fit: Callable[[Pairs], Calibration], pairs: Pairs, seen: Observed) -> tuple[FloatArray, list[Calibration]]:
    """Horizontal distances (n,), metres, from the reference of the plots in `seen`, corrected by what the other folds tell.

    The folds are those of least squares: five, of whole targets, alike in their numbers of plots.  `fit` is given the pairs of
    the other folds; what it gave is the second result.  NaN where there is one target only, and for folds without which nothing
    can be told.
    """
    out = np.full(len(seen), np.nan)
    given: list[Calibration] = []
    fold = folds(np.bincount(seen.cluster))[seen.cluster]
    for k in np.unique(fold).tolist():
        train, test = np.sort(seen.row[fold != k]), np.flatnonzero(fold == k)
        if not len(train):
            continue
        try:
            given.append(fit(pairs[train]))
        except NothingToDo:
            continue
        out[test] = _distances(seen, given[-1], test)
    return out, given


def _widened(found: Calibration, others: Sequence[Calibration], seen: Observed) -> Calibration:
    """Errors over time with a covariance that is as wide as it is when targets come and go.

    A filter of samples takes them as independent; what each target keeps for itself shows in how the values change without a
    fold of targets (a jackknife, by the median over the epochs).  Of few targets what such errors typically are is added.
    """
    from scipy.special import chdtri

    covariance = found.covariance.copy()
    targets = len(seen.cluster_key)
    if targets < FEW_TARGETS:
        typical, far = own_sd(seen), float(np.median(seen.measured[:, 0]))
        own = {**dict(zip(BIASES, typical, strict=True)), "rotation_up": typical[1]}
        own |= dict.fromkeys(("site_east", "site_north", "site_up"), np.hypot(typical[0], typical[1] * far))
        for k, key in enumerate(found.terms):
            covariance[:, k, k] += own.get(key.name, 0.0) ** 2 / targets
    for k, key in enumerate(found.terms):
        at = [(c, c.index(key.sensor, key.name, key.channel)) for c in others]
        value = np.array([c.value[:, j] for c, j in at if j is not None and len(c.epoch_s) == len(found.epoch_s)])
        if len(value) < 2:
            continue
        left_out = (len(value) - 1) / len(value) * ((value - value.mean(axis=0)) ** 2).sum(axis=0)
        typical_square = float(chdtri(len(value) - 1, 0.5)) / (len(value) - 1)
        wider = np.sqrt(max(float(np.median(left_out / covariance[:, k, k])) / typical_square, 1.0))
        covariance[:, k] *= wider
        covariance[:, :, k] *= wider
    return replace(found, covariance=covariance)


def _values(seen: Observed, found: Calibration, rows: IntArray) -> tuple[list[Term], Values]:
    """The terms that a correction can take out, and their values at the times of the rows."""
    keep = [k for k, key in enumerate(found.terms) if not TERMS[key.name].needs & {"second", "third"}]
    terms = [term_of(name) for name in (_asked(found)[k] for k in keep)]
    if len(found.epoch_s) == 1:
        return terms, found.value[0, keep]
    time = seen.time_s[rows] + seen.epoch_s
    return terms, [np.interp(time, found.epoch_s, found.value[:, k]) for k in keep]


def _distances(seen: Observed, found: Calibration | None, rows: IntArray | None = None) -> FloatArray:
    """Horizontal distances of the rows (all) from the reference, corrected by what was found (None: as measured)."""
    rows = np.arange(len(seen)) if rows is None else rows
    out = np.empty(len(rows))

    def piece(part: slice) -> None:
        mine = rows[part]
        terms, value = ([], np.zeros(0)) if found is None else _values(seen, found, mine)
        out[part] = distances(seen, mine, terms, value)

    in_threads(piece, slices(len(rows), CHUNK))
    return out


def _accuracy(distance: FloatArray) -> Accuracy:
    good = distance[np.isfinite(distance)]
    return Accuracy(*map(float, np.percentile(good, [50, 95]))) if len(good) else Accuracy(float("nan"), float("nan"))


def _untold(method: Method, found: Calibration, seen: Observed) -> dict[str, str]:
    """The commonest errors that a method has no term for, and why."""
    if isinstance(method, LeastSquares):
        # It says so itself.
        return {}
    name = name_of(method)
    out = {"time_offset": f"{name} has no term for late stamps: what there is of it is in the other values and in the noise"}
    if isinstance(method, PerChannel):
        out["time_offset"] = f"only models of the second order have it, and this one is {found.sensors[0].model}"
    if isinstance(method, RansacIcp | Genetic | KalmanTransform):
        kind = "an affine" if isinstance(method, KalmanTransform) else "a rigid"
        out["range_bias"] = f"{kind} transform of positions has none: what there is of it is in the other values and in the noise"
        out["azimuth_bias"] = "in a transform of positions it is minus rotation_up"
        out["elevation_bias"] = f"{kind} transform of positions has none: see rotation_east and rotation_north"
    if not seen.has_elevation:
        out["elevation_bias"] = "the sensor measures no elevation"
    return out


def _calibration(
    seen: Observed,
    names: Sequence[str],
    epochs: FloatArray,
    value: FloatArray,
    covariance: FloatArray,
    model: str,
    notes: Sequence[str],
    missing: Mapping[str, str],
) -> Calibration:
    """A calibration of one sensor from values (k, p) and covariances (k, p, p); the counts and accuracies are yet to come."""
    blank = Accuracy(float("nan"), float("nan"))
    unknown = Noise(float("nan"), float("nan"))
    key = seen.sensor.key
    summary = Summary(
        sensor=key, name=seen.sensor.name, model=model, noise=unknown, plots=len(seen), tracks=0, targets=0, before=blank,
        after=blank, notes=tuple(notes),
    )  # fmt: skip
    out = Calibration(
        terms=tuple(TermKey(key, "all", name, TERMS[name].unit) for name in names),
        epoch_s=epochs,
        value=value,
        covariance=(covariance + np.swapaxes(covariance, 1, 2)) / 2,
        sensors=(summary,),
        not_determined=tuple(NotDetermined(key, name, why) for name, why in missing.items()),
    )
    return replace(out, sensors=(msgspec.structs.replace(summary, noise=_noise(seen, out)),))


def _noise(seen: Observed, found: Calibration) -> Noise:
    """The plots' own random error: the robust scatter of what is left, net of the reference's."""
    terms, value = _values(seen, found, np.arange(len(seen)))
    _, left, _ = look(seen, slice(None), terms, value)
    sd = np.full(3, np.nan)
    for c in range(3):
        known = np.isfinite(left[:, c])
        if known.any():
            off = left[known, c] - np.median(left[known, c])
            scatter = _SD_PER_MEDIAN * float(np.median(np.abs(off)))
            sd[c] = np.sqrt(max(scatter**2 - float(np.median(seen.reference_variance[known, c])), 0.0))
    return Noise(*map(float, sd))


def _inliers(inliers: BoolArray, of: int) -> str:
    return f"inliers: {int(inliers.sum()):,} of {of:,}"


def _share(measured: BoolArray) -> str:
    return f"only {100 * measured.mean():.0f} % of the plots have an elevation: none is used"


def _with_elevation(seen: Observed) -> bool:
    return float(np.isfinite(seen.measured[:, 2]).mean()) >= _MOST


# ----------------------------------------------------------------------------------------------------------- the covariance
def _honest(influence: FloatArray, residual: FloatArray, own: FloatArray, seen: Observed, floor: FloatArray) -> FloatArray:
    """The covariance (p, p) of values that are a weighted sum of the rows' errors: `influence` (n, p, c) of `residual` (n, c).

    Errors are shared within a target: its rows count together.  A handful of targets does not show how targets differ: what they
    typically keep for themselves (covariance `own` (c, c) of a target) is added, and the whole is as wide as their differences
    say.  What a search missed of the least-squares estimate is in it, and so is a `floor` (c,) below which no row is known.
    """
    n, p, _ = influence.shape
    push = np.einsum("npc,nc->np", influence, residual)
    missed = push.sum(axis=0)
    push = push - missed / n
    targets = int(seen.cluster.max()) + 1
    by_target = _sums(push, seen.cluster, targets)
    present = np.bincount(seen.cluster, minlength=targets) > 0
    count = int(present.sum())
    least = np.einsum("npc,nqc->pq", influence * floor, influence * floor) + np.outer(missed, missed)
    meat = by_target.T @ by_target * (count / max(count - 1, 1))
    if count >= FEW_TARGETS:
        return np.asarray(meat + least)
    pieces = blocks_of(seen.cluster, seen.time_s)
    by_piece = _sums(push, pieces, int(pieces.max()) + 1)
    many = len(np.unique(pieces))
    shared = _sums(influence.reshape(n, -1), seen.cluster, targets).reshape(targets, p, -1)
    out = by_piece.T @ by_piece * (many / max(many - 1, 1)) + np.einsum("gpc,cd,gqd->pq", shared, own, shared) + least
    if count > 1:
        size = np.sqrt(np.diag(out))
        unit = out / size[:, None] / size
        out = out * max(1.0, float(np.trace(np.linalg.pinv(unit, hermitian=True) @ (meat / size[:, None] / size))) / p)
    return np.asarray(out)


def _sums(rows: FloatArray, group: IntArray, groups: int) -> FloatArray:
    out = np.zeros((groups, rows.shape[1]))
    np.add.at(out, group, rows)
    return out


# ---------------------------------------------------------------------------------------------------- maximum likelihood
def _likeliest(method: MaximumLikelihood, whole: Observed) -> Calibration:
    seen = take(whole, _thin(np.arange(len(whole)), _PLOTS))
    _, difference, _ = look(seen, slice(None), (), np.zeros(0))
    missing: dict[str, str] = {}
    if seen.has_elevation and not _with_elevation(seen):
        missing["elevation_bias"] = _share(np.isfinite(difference[:, 2]))
        difference[:, 2] = np.nan
    known = seen.reference_variance[:, :, None] * np.eye(3)
    found = method(difference, known, seen.cluster)
    axes = np.flatnonzero(np.isfinite(found.value))
    rows = np.flatnonzero(found.inliers)
    weight = np.linalg.inv(found.noise[np.ix_(axes, axes)] + known[rows][:, axes[:, None], axes])
    influence = np.linalg.solve(weight.sum(axis=0), weight)
    own = own_sd(seen)
    mine = take(seen, rows)
    covariance = _honest(
        influence, difference[rows][:, axes] - found.value[axes], np.diag(own[axes] ** 2), mine, _FLOOR_POLAR[axes]
    )
    notes = [_inliers(found.inliers, len(seen)), f"how it ended: {found.ended} after {found.iterations} steps"]
    if len(seen) < len(whole):
        notes.append(f"estimated on {len(seen):,} of {len(whole):,} plots, evenly taken: more would tell no more of the targets")
    names = [BIASES[c] for c in axes]
    epoch = np.array([seen.epoch_s])
    return _calibration(whole, names, epoch, found.value[None, axes], covariance[None], "polar bias", notes, missing)


# ------------------------------------------------------------------------------------------------- rigid and affine transforms
def displacement(names: Sequence[str], position: FloatArray) -> FloatArray:
    """What a unit (SI) of each transform term does to positions (n, 3), east, north, up about the antenna: (n, 3, p), metres.

    Shift, turn, stretch and shear of the picture: measured - true.
    """
    out = np.zeros((len(position), 3, len(names)))
    axis = {"east": 0, "north": 1, "up": 2}
    for k, name in enumerate(names):
        kind, *along = name.split("_")
        i = axis[along[0]]
        if kind == "site":
            out[:, i, k] = -1.0
        elif kind == "rotation":
            out[:, :, k] = np.cross(np.eye(3)[i], position)
        elif kind == "stretch":
            out[:, i, k] = position[:, i]
        else:
            j = axis[along[1]]
            out[:, i, k], out[:, j, k] = position[:, j], position[:, i]
    return out


def _clouds(seen: Observed, level: bool) -> tuple[Clouds, BoolArray]:
    """The plots and their references about the antenna, in the level plane alone where `level`; and which can be placed (n,)."""
    if level:
        height, _ = height_and_up(seen.site + seen.enu @ seen.rotation)
        position = position_from_height(seen.measured[:, 0], seen.measured[:, 1], height, seen.site, seen.rotation)
        flat = np.array([1.0, 1.0, 0.0])
        measured, reference = (position - seen.site) @ seen.rotation.T * flat, seen.enu * flat
    else:
        measured, reference = enu_from_polar(seen.measured), seen.enu
    placed = np.isfinite(measured).all(axis=1)
    return Clouds(measured, reference, seen.cluster), placed


def _transformed(method: RansacIcp | Genetic | KalmanTransform, job: _Job, seen: Observed) -> Calibration:
    level = not _with_elevation(seen)
    clouds, placed = _clouds(seen, level)
    notes: list[str] = []
    missing: dict[str, str] = {}
    affine = isinstance(method, KalmanTransform)
    space = _AFFINE if affine else _RIGID
    names = (_LEVEL_AFFINE if affine else _LEVEL) if level else space
    if level:
        why = _share(np.isfinite(seen.measured[:, 2])) if seen.has_elevation else "the sensor measures no elevation"
        missing |= dict.fromkeys((name for name in space if name not in names), why)
    if not placed.all():
        what = "their ranges are too short for the height" if level else "they have no elevation"
        notes.append(f"{(~placed).sum():,} of {len(seen):,} plots take no part: {what}")
    if not placed.any():
        raise NothingToDo(f"sensor {seen.sensor.name!r}: no plot can be placed")
    if isinstance(method, KalmanTransform):
        if not method.sd_m:
            sd = typical_noise(seen)
            method = msgspec.structs.replace(method, sd_m=float(max(sd[0], sd[1] * np.median(seen.measured[:, 0]))))
            notes.append(f"sd_m = {method.sd_m:.3g}, as plots of such a radar have at the median range")
        transforms = method(clouds, np.where(placed, seen.time_s, np.nan))
        notes += [_inliers(transforms.inliers, len(seen)), f"how it ended: {transforms.ended}"]
        return _affine(method, job, seen, clouds, transforms, names, level, notes, missing)
    rigid = method(clouds)
    word = "generations" if isinstance(method, Genetic) else "steps"
    notes += [_inliers(rigid.inliers, len(seen)), f"how it ended: {rigid.ended} after {rigid.iterations} {word}"]
    return _rigid(seen, clouds, rigid, names, notes, missing)


def _level_axes(names: Sequence[str]) -> int:
    """How many coordinates the terms move: two where none is of the vertical."""
    return 3 if "site_up" in names else 2


def _own_m2(seen: Observed, axes: int) -> FloatArray:
    """The typical covariance (m^2) of what a target keeps for itself, in the coordinates."""
    own = own_sd(seen)
    return np.asarray((own[0] ** 2 + (own[1] * float(np.median(seen.measured[:, 0]))) ** 2) * np.eye(axes))


def _thin(rows: IntArray, most: int) -> IntArray:
    return rows[:: max(1, -(-len(rows) // most))]


def _rigid(
    seen: Observed, clouds: Clouds, found: Rigid, names: Sequence[str], notes: list[str], missing: dict[str, str]
) -> Calibration:
    """The transform that puts the plots right, as terms: what it puts right is what they are off by."""
    axes = _level_axes(names)
    whole = dict(zip(("rotation_east", "rotation_north", "rotation_up"), -found.rotation_vector, strict=True))
    whole |= dict(zip(("site_east", "site_north", "site_up"), found.rotation.T @ found.translation, strict=True))
    value = np.array([whole[name] for name in names])
    rows = np.flatnonzero(found.inliers)
    if not len(rows):
        raise NothingToDo(f"sensor {seen.sensor.name!r}: no pair agrees with any transform")
    mine = take(seen, rows)
    columns = displacement(names, clouds.reference[rows])[:, :axes]
    residual = (found(clouds.measured[rows]) - clouds.reference[rows])[:, :axes]
    noise = max(float(np.mean((residual - residual.mean(axis=0)) ** 2)), _FLOOR_M**2)
    block = blocks_of(mine.cluster, mine.time_s)
    grown = float(np.mean([inflation(residual[:, c], block) for c in range(axes)]))
    gram = np.einsum("nci,ncj->ij", columns, columns)
    prior = np.array([TERMS[name].prior_sd for name in names])
    kept, lost = _told(gram[None] / (noise * grown), prior, names)
    missing |= lost
    if not kept:
        raise NothingToDo(f"sensor {seen.sensor.name!r}: the pairs tell no part of the transform")
    # What the others did goes to those that stay, as far as these pairs can show it.
    some = np.linalg.solve(gram[np.ix_(kept, kept)], gram[kept])
    notes += _absorbed(some, prior, names, kept)
    influence = np.linalg.solve(gram[np.ix_(kept, kept)], np.swapaxes(columns[:, :, kept], 1, 2))
    covariance = _honest(influence, residual, _own_m2(mine, axes), mine, np.full(axes, _FLOOR_M))
    own = [names[k] for k in kept]
    model = "rigid transform" if axes == 3 else "rigid transform in the level plane"
    return _calibration(seen, own, np.array([seen.epoch_s]), (some @ value)[None], covariance[None], model, notes, missing)


def _told(information: FloatArray, prior: FloatArray, names: Sequence[str]) -> tuple[list[int], dict[str, str]]:
    """Which terms the data tell, of their information (k, p, p) over k epochs; and of the others why not.

    A term is told where, at the median epoch, they leave less than half of the sd that was assumed of it beforehand, with all
    other terms open; of those that are not, the last goes first.
    """
    kept = list(range(len(names)))
    lost: dict[str, str] = {}
    while kept:
        scaled = information[:, kept][:, :, kept] * prior[kept][:, None] * prior[kept]
        size, basis = np.linalg.eigh(scaled)
        left = np.sqrt(np.einsum("kij,kj->ki", basis**2, 1 / (np.maximum(size, 0.0) + 1)))
        share = np.median(left, axis=0)
        open_ = np.flatnonzero(share > _TOLD)
        if not len(open_):
            break
        k = kept.pop(int(open_[-1]))
        term = TERMS[names[k]]
        sd, before = share[open_[-1]] * prior[k] / term.si_per_unit, prior[k] / term.si_per_unit
        lost[names[k]] = (
            f"these plots leave it uncertain by {sd:.3g} {term.unit}, of the {before:.3g} {term.unit} that were assumed: the "
            "other terms do the same to them, or it does nothing"
        )
    return kept, lost


def _absorbed(some: FloatArray, prior: FloatArray, names: Sequence[str], kept: Sequence[int]) -> list[str]:
    """Which kept term holds what there is of each one that was given up; `some` (k, p) says how much of it goes where."""
    out = []
    for k in sorted(set(range(len(names))) - set(kept)):
        share = np.abs(some[:, k]) * prior[k] / prior[list(kept)]
        j = int(share.argmax())
        if share[j] > 0.01:
            one, other = TERMS[names[k]], TERMS[names[kept[j]]]
            per = some[j, k] * one.si_per_unit / other.si_per_unit
            out.append(f"{other.name} also holds what there is of {one.name}: {per:+.2g} {other.unit} for each {one.unit} of it")
    return out


def _affine(
    method: KalmanTransform,
    job: _Job,
    seen: Observed,
    clouds: Clouds,
    found: Transforms,
    names: Sequence[str],
    level: bool,
    notes: list[str],
    missing: dict[str, str],
) -> Calibration:
    """The matrix over time as terms: corrected = z + A z + b, so that measured - true = ((1 + A)^-1 - 1) true - (1 + A)^-1 b."""
    axes = 2 if level else 3
    rows = np.flatnonzero(found.inliers)
    if not len(rows):
        raise NothingToDo(f"sensor {seen.sensor.name!r}: no pair agrees with any transform")
    mine = take(seen, rows)
    at = np.maximum(np.searchsorted(found.epoch_s + seen.epoch_s, job.epochs_s, side="right") - 1, 0)
    used, place = np.unique(at, return_inverse=True)
    inward = np.linalg.inv(np.eye(3) + found.value[used][:, :, :3] / SCALE_M)
    shape = np.concatenate([inward - np.eye(3), inward @ found.value[used][:, :, 3:]], axis=2)
    linear = _linear(names)
    value = np.einsum("pij,kij->kp", linear, shape)
    # What the filter knows of each row of the matrix by data of this noise, and by its prior alone.
    residual = (found(clouds.measured[rows], mine.time_s) - clouds.reference[rows])[:, :axes]
    noise = max(float(np.mean(residual**2)), _FLOOR_M**2)
    since = np.floor(mine.time_s / method.memory_s).astype(np.int64)
    _, block = np.unique(np.stack([mine.cluster, since]), axis=1, return_inverse=True)
    grown = float(np.mean([inflation(residual[:, c], block) for c in range(axes)]))
    held = (method.sd_m / method.prior_sd_m) ** 2
    known = found.covariance[used] / method.sd_m**2
    data = np.linalg.inv(known) - held * np.eye(4)
    spread = known @ data @ known * (noise * grown) + held * method.sd_m**2 * known @ known
    spread = spread / np.array([SCALE_M] * 3 + [1.0])[:, None] / np.array([SCALE_M] * 3 + [1.0])
    covariance = np.einsum("pij,kjl,qil->kpq", linear, spread, linear)
    # Of the terms among each other: their columns on these pairs, as many of them as the filter remembers at a time.
    typical = displacement(names, clouds.reference[_thin(rows, _ROWS)])[:, :axes]
    gram = np.einsum("nci,ncj->ij", typical, typical)
    prior = _prior(method, names)
    size, basis = np.linalg.eigh(covariance / prior[:, None] / prior)
    information = (basis / np.maximum(size, 1e-15 * size[:, -1:])[:, None]) @ np.swapaxes(basis, 1, 2)
    kept, lost = _told(information / prior[:, None] / prior, prior, names)
    missing |= lost
    if not kept:
        raise NothingToDo(f"sensor {seen.sensor.name!r}: the pairs tell no part of the transform")
    some = np.linalg.solve(gram[np.ix_(kept, kept)], gram[kept])
    notes += _absorbed(some, prior, names, kept)
    own = [names[k] for k in kept]
    model = "affine transform over time" if axes == 3 else "affine transform in the level plane, over time"
    return _calibration(
        seen, own, job.epochs_s, (value @ some.T)[place], (some @ covariance @ some.T)[place], model, notes, missing
    )


def _prior(method: KalmanTransform, names: Sequence[str]) -> FloatArray:
    """The sd that the filter assumes of each term beforehand: half the sum or difference of two entries, or one."""
    entry = method.prior_sd_m / SCALE_M
    kinds = {"site": method.prior_sd_m, "stretch": entry}
    return np.array([kinds.get(name.split("_")[0], entry / np.sqrt(2)) for name in names])


def _linear(names: Sequence[str]) -> FloatArray:
    """The terms as weights (p, 3, 4) of a matrix [G | s] with measured - true = G true - s."""
    axis = {"east": 0, "north": 1, "up": 2}
    out = np.zeros((len(names), 3, 4))
    for k, name in enumerate(names):
        kind, *along = name.split("_")
        i = axis[along[0]]
        if kind == "site":
            out[k, i, 3] = 1.0
        elif kind == "stretch":
            out[k, i, i] = 1.0
        elif kind == "rotation":
            one, two = (i + 2) % 3, (i + 1) % 3
            out[k, one, two], out[k, two, one] = 0.5, -0.5
        else:
            j = axis[along[1]]
            out[k, i, j] = out[k, j, i] = 0.5
    return out


# --------------------------------------------------------------------------------------------------------------- over time
def _followed(method: OnlineMethod, job: _Job, pairs: Pairs, sensor: Sensor, beside: Calibration | None = None) -> Calibration:
    """The three biases over time; before the first sample and after the last the values stay."""
    samples = online_samples(pairs, Sensors((sensor,)), beside=beside)[sensor.key]
    epochs = np.clip(job.epochs_s, samples.time_s[0], samples.time_s[-1])
    found = register_online(samples, sensor, method=method, epoch_s=epochs, beside=beside)
    ended = "how it ended: end of data"
    return replace(
        found,
        epoch_s=job.epochs_s,
        sensors=tuple(msgspec.structs.replace(s, notes=(*_as_inliers(s.notes), ended)) for s in found.sensors),
    )


def _as_inliers(notes: Sequence[str]) -> list[str]:
    return [f"inliers: {note}" if " samples agree within " in note else note for note in notes]


def _constant(job: _Job, pairs: Pairs, sensor: Sensor) -> Calibration:
    """What least squares finds of one sensor's constant errors: as of all together, or by these pairs alone.

    Raises NothingToDo where it can tell none.
    """
    assert isinstance(job.method, LeastSquares)
    found = job.constant
    if found is None:
        return register(pairs, Sensors((sensor,)), model=job.model, settings=job.method)
    keep = np.array([key.sensor == sensor.key for key in found.terms])
    if not keep.any():
        raise NothingToDo(f"sensor {sensor.name!r}: least squares tells none of its errors")
    return replace(
        found,
        terms=tuple(key for key in found.terms if key.sensor == sensor.key),
        value=found.value[:, keep],
        covariance=found.covariance[:, keep][:, :, keep],
        sensors=tuple(s for s in found.sensors if s.sensor == sensor.key),
        not_determined=tuple(n for n in found.not_determined if n.sensor == sensor.key),
        warnings=(),
    )


def _least_squares_online(job: _Job, pairs: Pairs, sensor: Sensor) -> Calibration:
    """Constant terms by least squares, and beside them the biases over time by a Kalman bank."""
    constant = _constant(job, pairs, sensor)
    # What is not to be applied is not to be taken out before the biases are followed either.
    beside = replace(advised(constant), epoch_s=np.array([job.epoch_s]))
    found = _followed(KalmanBank(), job, pairs, sensor, beside)
    first, own = constant.sensors[0], found.sensors[0]
    there = {(key.channel, key.name) for key in found.terms}
    notes = [*own.notes]
    for key, value, sd in zip(constant.terms, constant.value[0], constant.sd[0], strict=True):
        if (key.channel, key.name) not in there:
            scale = TERMS[key.name].si_per_unit
            notes.append(
                f"{key.name} of {value / scale:+.3g} ± {sd / scale:.2g} {key.unit} is held back, and taken as nothing while the "
                "biases are followed"
            )
    summary = msgspec.structs.replace(
        first,
        model=f"{first.model}, biases over time",
        noise=own.noise,
        notes=tuple(_both(first.notes, notes)),
        verdicts=tuple(v for v in first.verdicts if (v.channel, v.term) in there and v.term not in BIASES),
    )
    told = {key.name for key in found.terms}
    missing = {n.term: n for n in (*constant.not_determined, *found.not_determined) if n.term not in told}
    return replace(found, sensors=(summary,), not_determined=tuple(missing.values()))


def _both(constant: Sequence[str], over_time: Sequence[str]) -> list[str]:
    """The notes on constant terms and on biases over time, those on inliers and on the end marked as of the former."""
    marked = ("inliers: ", "how it ended: ")
    return [f"constant terms: {note}" if note.startswith(marked) else note for note in constant] + list(over_time)
