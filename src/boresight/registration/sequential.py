"""Biases as functions of time: a bank of robust Kalman filters, and calibrations with many epochs (METHODS section 5).

`register_relative` sets radars against a main one without any reference, `register_online` follows one radar's bias against a
trusted reference.  Both take any method of `METHODS`; the Kalman bank is the default.  Every estimate rests on the past alone,
as in live operation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from .._jit import kernel
from .._parallel import in_threads, slices
from .._types import BoolArray, FloatArray, IntArray
from ..calibration import Accuracy, Calibration, Noise, NotDetermined, Summary, TermKey
from ..errors import NothingToDo, SettingsError
from ..filters.alpha_beta import AlphaBeta, alpha_beta_covariance, alpha_beta_filter
from ..model import Pairs, Sensor, Sensors
from ..terms import DEG, TERMS, Term, term_of
from .mean_shift import (
    Estimate,
    ExponentialAverage,
    Igmsr,
    MeanShift,
    Online,
    Samples,
    absolute_condition,
    checked,
    joined,
)
from .observe import look, observe, unusable

BIASES = ("range_bias", "azimuth_bias", "elevation_bias")
# Of so many samples a bias can be told; at least this share must agree with it.
_LEAST = 5
_AGREE = 0.5
_INLIER_SD = 3.0
_OUTLIER_SD = 4.0
# A member of the bank remembers at least so many samples that are worth something of their own.
_TELLING = 15.0
# And so many turns of the antenna.
_TURNS = 3.0
# Of so many targets at a time offsets are followed (of more, the mean is well known); a target's own errors fade with this time.
_SLOTS = 64
_FADE_S = 600.0
# After so many such times nothing worth keeping is left of it.
_FADED = 2.0
_MINUTE_S = 60.0
_EPOCHS = 400
_BLOCK_S = 300.0
# Below this condition number the absolute biases of both radars show in their differences.
_NETWORK = 100.0
# A normal variable's sd over its median absolute value.
_SD_PER_MEDIAN = 1.4826
# The median of the square of a normal variable.
_MEDIAN_CHI2 = 0.4549
# The median of fewer squares says nothing.
_TELL_RATIO = 8
# The floor under a variance that the samples do not show: metres and radians.
_FLOOR = np.array([1e-3, 1e-8, 1e-8])


class KalmanBank(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="kalman-bank"):
    """A bank of local-linear-trend Kalman filters with Huber innovations, one for each of several speeds of change.

    Each filter has a bias and its rate; the rate's random walk is such that the filter remembers `memory_s`, a geometric series
    of `members` from the fastest to the slowest.  Their estimates are mixed by how well each has predicted the samples of the
    last `judged_s`.  Innovations beyond `huber` sd count by their sign, beyond `reject` sd not at all; `streak` of them
    on one side (ordinary ones taken off) are a step, and the filter starts
    anew at their median.
    """

    memory_s: tuple[float, float] = (10.0, 2560.0)
    members: int = 9
    judged_s: float = 60.0
    huber: float = 2.5
    reject: float = 5.0
    streak: int = 5

    def __call__(
        self,
        time_s: FloatArray,
        value: FloatArray,
        variance: FloatArray,
        epoch_s: FloatArray,
        target: IntArray | None = None,
        own: FloatArray | None = None,
    ) -> Estimate:
        """See `Online`.

        With `target` (n,) and `own` (m,), variances, the samples of a target share an error of their own, which fades within ten
        minutes: every filter then has a state for each of the targets seen last.  What changes for all targets at once is the
        bias, and followed as fast as ever; its level is averaged over targets.
        """
        low, high = self.memory_s
        if not (0 < low <= high) or self.members < 1 or not self.judged_s > 0 or not 0 < self.huber <= self.reject:
            raise SettingsError(
                f"{self} makes no sense", where="kalman-bank", remedy="memory_s must rise, huber be at most reject, all positive."
            )
        if self.streak < 2:
            raise SettingsError(f"streak = {self.streak} takes every outlier for a step", where="kalman-bank", remedy="Give 5.")
        t, z, r, e = checked(time_s, value, variance, epoch_s, "kalman-bank")
        memory = np.geomspace(low, high, self.members)
        whose, shared = np.zeros(len(t), np.int64), np.zeros(len(z))
        if target is not None and own is not None:
            whose, shared = np.ascontiguousarray(target, np.int64), np.ascontiguousarray(own, np.float64)

        def part(rows: slice) -> Estimate:
            mine, noise = np.ascontiguousarray(z[rows]), np.ascontiguousarray(r[rows])
            # A trend filter whose rate walks by q remembers (r / q)^(1/4), with r the samples' variance times their spacing.
            walk = np.array([_density(t, a, b) for a, b in zip(mine, noise, strict=True)])[:, None] / memory**4
            out, spread = np.full((len(mine), len(e)), np.nan), np.full((len(mine), len(e)), np.nan)
            limits = self.judged_s, self.huber, self.reject, self.streak
            _bank(t, mine, noise, whose, shared[rows], e, memory, walk, *limits, _SLOTS, _FADE_S, out, spread)
            return Estimate(out, spread, np.zeros(len(mine), np.int64))

        return joined(in_threads(part, slices(len(z), 1 if shared.any() else 8)))

    def no_faster(self, memory_s: float) -> KalmanBank:
        """The bank with no member that remembers less than so many seconds."""
        low, high = self.memory_s
        if memory_s <= low:
            return self
        return msgspec.structs.replace(
            self, memory_s=(memory_s, max(high, 8 * memory_s)), judged_s=max(self.judged_s, 6 * memory_s)
        )


class AlphaBetaBias(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="alpha-beta"):
    """The alpha-beta filter of each bias and its rate, the baseline: fixed gains, and nothing done about outliers.

    The samples of `slot_s` seconds are averaged and taken in as one.  Gains `alpha` and `beta` are as given, else (0) those of
    the steady-state Kalman filter for a `tracking_index` (Kalata 1984): how far a slot's change of the rate moves the bias
    within a slot, over the sd of a slot's average.  The variance is what the samples' noise leaves; a bias that changes faster
    than the gains follow is not in it.
    """

    tracking_index: float = 0.01
    alpha: float = 0.0
    beta: float = 0.0
    slot_s: float = 10.0

    @property
    def gains(self) -> AlphaBeta:
        """The gains of a slot.  Raises SettingsError for settings that make no sense."""
        if not (self.slot_s > 0 and self.tracking_index > 0 and self.alpha >= 0 and self.beta >= 0) or (
            self.beta and not self.alpha
        ):
            raise SettingsError(
                f"{self} makes no sense",
                where="alpha-beta",
                remedy="Give a positive tracking_index and slot_s, or alpha and beta themselves.",
            )
        return AlphaBeta(alpha=self.alpha, beta=self.beta) if self.alpha else AlphaBeta.steady(self.tracking_index, 1.0, 1.0)

    def __call__(self, time_s: FloatArray, value: FloatArray, variance: FloatArray, epoch_s: FloatArray) -> Estimate:
        """See `Online`."""
        gains = self.gains
        t, z, r, e = checked(time_s, value, variance, epoch_s, "alpha-beta")
        out, square = np.full((len(z), len(e)), np.nan), np.full((len(z), len(e)), np.nan)
        for s in range(len(z)):
            known = np.isfinite(z[s])
            if known.any():
                out[s], square[s] = self._series(gains, t[known], z[s, known], r[s, known], e)
        return Estimate(out, square, np.zeros(len(z), np.int64))

    def _series(
        self, gains: AlphaBeta, t: FloatArray, z: FloatArray, r: FloatArray, e: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """One series' values and variances at the epochs (k,), of samples that are all numbers."""
        slot = np.floor((t - t[0]) / self.slot_s).astype(np.int64)
        first = np.flatnonzero(np.diff(slot, prepend=-1))
        weight, weighted, timed = (np.r_[0.0, np.cumsum(column)] for column in (1 / r, z / r, t - t[0]))
        edge = np.r_[first, len(t)]
        total, middle = np.diff(weight[edge]), np.diff(timed[edge]) / np.diff(edge)
        mean = np.diff(weighted[edge]) / total
        state = alpha_beta_filter(mean[None, :, None], middle, gains)[0]
        spread = alpha_beta_covariance(1 / total[None], middle, gains)[0]
        # The slot that an epoch falls into has taken in its samples so far: from the slot before, one step to their mean.
        end = np.searchsorted(t, e, side="right")
        some = end > 0
        end = end[some]
        now = np.searchsorted(first, end - 1, side="right") - 1
        begin, before = first[now], np.maximum(now - 1, 0)
        precision = weight[end] - weight[begin]
        seen, at = (weighted[end] - weighted[begin]) / precision, (timed[end] - timed[begin]) / (end - begin)
        begun = now > 0
        dt = np.where(begun, at - middle[before], 1.0)
        gain = np.stack([np.where(begun, gains.alpha, 1.0), np.where(begun, gains.beta / dt, 0.0)], axis=1)
        forward = np.tile(np.eye(2), (len(dt), 1, 1))
        forward[:, 0, 1] = dt
        x = np.einsum("kij,kj->ki", forward, np.where(begun[:, None], state[before], 0.0))
        x = x + gain * (seen - x[:, 0])[:, None]
        p = forward @ np.where(begun[:, None, None], spread[before], 0.0) @ np.swapaxes(forward, 1, 2)
        left = np.eye(2) - gain[:, :, None] * np.array([1.0, 0.0])
        p = left @ p @ np.swapaxes(left, 1, 2) + gain[:, :, None] * gain[:, None] / precision[:, None, None]
        ahead = e[some] - t[0] - at
        out, square = np.full(len(e), np.nan), np.full(len(e), np.nan)
        out[some] = x[:, 0] + ahead * x[:, 1]
        square[some] = p[:, 0, 0] + ahead * (2 * p[:, 0, 1] + ahead * p[:, 1, 1])
        return out, square


METHODS: dict[str, Online] = {
    "kalman-bank": KalmanBank(),
    "igmsr": Igmsr(),
    "mean-shift": MeanShift(),
    "alpha-beta": AlphaBetaBias(),
    "exponential-average": ExponentialAverage(),
}
"""The methods that follow a bias, by the name that an option gives, with their defaults."""


def _density(time_s: FloatArray, value: FloatArray, variance: FloatArray) -> float:
    """The samples' variance times their spacing."""
    known = np.isfinite(value)
    if not known.any():
        return 1.0
    return float(np.median(variance[known])) * (_spacing(time_s[known]) or 1.0)


def _spacing(time_s: FloatArray) -> float:
    """The mean time from one sample to the next (s), gaps aside; 0 where all are at one time."""
    step = np.diff(time_s)
    if not (step > 0).any():
        return 0.0
    usual = 10 * float(np.median(step[step > 0]))
    return float(np.minimum(step, usual).sum() / len(step))


@kernel
def _bank(
    time: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    target: IntArray,
    own: FloatArray,
    epoch: FloatArray,
    memory: FloatArray,
    walk: FloatArray,
    judged: float,
    huber: float,
    reject: float,
    streak: int,
    slots: int,
    fade: float,
    out: FloatArray,
    spread: FloatArray,
) -> None:
    """Fill mixed biases (m, k) and variances (m, k) at the epochs; `walk` (m, j) is the rates' noise (value^2 / s^3).

    The state is the bias, its rate, and with `own` (m,) variances the offsets of at most `slots` targets.  Of the covariances
    only the lower triangle is held and read, so that they cannot become unsymmetric.
    """
    members = len(memory)
    score, run, far = np.zeros(members), np.zeros(members), np.zeros((members, streak))
    whose = np.zeros((members, streak), np.int64)
    for s in range(value.shape[0]):
        wide = slots if own[s] > 0.0 else 0
        x, p = np.zeros((members, 2 + wide)), np.zeros((members, 2 + wide, 2 + wide))
        hp, gain = np.zeros(2 + wide), np.zeros(2 + wide)
        holder, last, used = np.zeros(wide, np.int64), np.zeros(wide), 0
        begun, at, i = False, 0.0, 0
        for k in range(len(epoch)):
            while i < len(time) and time[i] <= epoch[k]:
                z, r, t = value[s, i], variance[s, i], time[i]
                i += 1
                if np.isnan(z):
                    continue
                c = -1
                if wide:
                    for g in range(used):
                        if holder[g] == target[i - 1]:
                            c = g
                    if c < 0:
                        # A target that is new takes the place of the one not seen for longest: its error has faded, or none
                        # is free.
                        oldest = int(np.argmin(last[:used])) if used else 0
                        if used and (used == wide or t - last[oldest] > _FADED * fade):
                            c = oldest
                        else:
                            c, used = used, used + 1
                        stay, fresh = 0.0, own[s]
                        holder[c] = target[i - 1]
                    else:
                        stay = np.exp(-(t - last[c]) / fade)
                        fresh = (1.0 - stay * stay) * own[s]
                    last[c], c = t, c + 2
                    for j in range(members):
                        x[j, c] *= stay
                        for g in range(c):
                            p[j, c, g] *= stay
                        for g in range(c + 1, 2 + used):
                            p[j, g, c] *= stay
                        p[j, c, c] = p[j, c, c] * stay * stay + fresh
                if not begun:
                    begun, at = True, t
                    for j in range(members):
                        x[j, 0], x[j, 1], score[j], run[j] = z, 0.0, 0.0, 0.0
                        p[j, 0, 0], p[j, 1, 0], p[j, 1, 1] = r, 0.0, r / memory[j] ** 2
                        if c >= 0:
                            p[j, 0, 0] += own[s]
                            p[j, c, 0] = -own[s]
                    continue
                dt, at = t - at, t
                forget, top = np.exp(-dt / judged), -np.inf
                for j in range(members):
                    q = walk[s, j]
                    x[j, 0] += dt * x[j, 1]
                    p[j, 0, 0] += dt * (2 * p[j, 1, 0] + dt * p[j, 1, 1]) + q * dt**3 / 3
                    p[j, 1, 0] += dt * p[j, 1, 1] + q * dt**2 / 2
                    p[j, 1, 1] += q * dt
                    for g in range(2, 2 + used):
                        p[j, g, 0] += dt * p[j, g, 1]
                    offset = 0.0
                    for g in range(2 + used):
                        hp[g] = p[j, g, 0]
                    size = hp[0]
                    if c >= 0:
                        offset = x[j, c]
                        for g in range(c):
                            hp[g] += p[j, c, g]
                        for g in range(c, 2 + used):
                            hp[g] += p[j, g, c]
                        size = hp[0] + hp[c]
                    size += r
                    y = z - x[j, 0] - offset
                    v = y / np.sqrt(size)
                    a = abs(v)
                    loss = 0.5 * v * v if a <= huber else huber * min(a, reject) - 0.5 * huber * huber
                    score[j] = forget * score[j] - 0.5 * np.log(size) - loss
                    weight = 1.0 if a <= huber else huber / a if a <= reject else 0.0
                    # Outliers come now and then; a step makes all innovations large on one side.
                    if a > 3.0:
                        side = 1.0 if v > 0 else -1.0
                        run[j] = run[j] + side if run[j] * side >= 0 else side
                        far[j, int(abs(run[j])) - 1], whose[j, int(abs(run[j])) - 1] = z - offset, c
                    else:
                        run[j] = np.sign(run[j]) * max(abs(run[j]) - 1.0, 0.0)
                    if abs(run[j]) >= streak:
                        # The step's new level may have its outliers too.
                        x[j, 0], run[j], weight = np.median(far[j]), 0.0, 0.0
                        p[j, 0, 0] = 0.5 * np.pi * r / streak
                        for g in range(1, 2 + used):
                            p[j, g, 0] = 0.0
                        if c >= 0:
                            # It is wrong by what its targets' offsets are wrong by, the other way.
                            for one in whose[j]:
                                for g in range(1, 2 + used):
                                    p[j, g, 0] -= p[j, max(g, one), min(g, one)] / streak
                            for one in whose[j]:
                                p[j, 0, 0] -= p[j, one, 0] / streak
                        p[j, 1, 1] += r / memory[j] ** 2
                    if weight > 0.0:
                        total = size - r + r / weight
                        for g in range(2 + used):
                            gain[g] = hp[g] / total
                            x[j, g] += gain[g] * y
                        for g in range(2 + used):
                            row, much = p[j, g, : g + 1], gain[g]
                            for h in range(len(row)):
                                row[h] -= much * hp[h]
                    top = max(top, score[j])
                for j in range(members):
                    # None is ruled out for good: the law of change may change.
                    score[j] = max(score[j] - top, -20.0)
            if not begun:
                continue
            ahead, total, mean, square = epoch[k] - at, 0.0, 0.0, 0.0
            for j in range(members):
                w = np.exp(score[j])
                total += w
                # A rate is not carried on for longer than the filter remembers: through a gap it would go anywhere.
                mean += w * (x[j, 0] + min(ahead, memory[j]) * x[j, 1])
            mean /= total
            for j in range(members):
                ours = p[j, 0, 0] + ahead * (2 * p[j, 1, 0] + ahead * p[j, 1, 1]) + walk[s, j] * ahead**3 / 3
                square += np.exp(score[j]) / total * (ours + (x[j, 0] + ahead * x[j, 1] - mean) ** 2)
            out[s, k], spread[s, k] = mean, square


# ---------------------------------------------------------------------------------------------------- calibrations over time
class _Followed(NamedTuple):
    """One radar's biases: which of the three, values and covariances over the epochs, and what is said of them.

    `main_part` is the main radar's share of a sample's variance.
    """

    known: list[int]
    value: FloatArray
    covariance: FloatArray
    main_part: FloatArray
    summary: Summary
    not_determined: list[NotDetermined]


def register_relative(
    samples: Mapping[int, Samples],
    sensors: Sensors,
    main: Sensor,
    *,
    method: Online | None = None,
    step_s: float | None = None,
    terms: Sequence[str] = BIASES,
) -> Calibration:
    """Follow the biases of any number of radars against a main one, of the differences that `relative_samples` gives.

    The values are *relative*: bias of the radar minus bias of the main radar, over epochs of `step_s` (by default a
    four-hundredth of the time).  A radar so corrected agrees with the main one, right or wrong.  The covariance is joint:
    estimates against one main radar share its noise.  Which samples agree, and how the search ended, is in the notes.

    Raises SettingsError for terms that differences cannot tell (any but the three biases: what is common to both radars, so
    all that is absolute, leaves no trace in them); NothingToDo where no bias can be told.
    """
    wrong = [name for name in terms if name not in BIASES]
    if wrong or not terms:
        raise SettingsError(
            f"radars compared with each other tell their relative biases only, not {', '.join(wrong) or 'nothing'}",
            where="terms",
            remedy=f"Ask for {', '.join(BIASES)}; for others, and for absolute values, give a trusted reference.",
        )
    if main.key in samples:
        raise SettingsError(f"the main radar {main.name!r} cannot be registered against itself", where="main")
    method = method or KalmanBank()
    epochs = _epochs(list(samples.values()), step_s)
    found: list[_Followed] = []
    failed: list[str] = []
    conditions = []
    for key, mine in samples.items():
        sensor = sensors.find(key)
        name = sensor.name if sensor is not None else str(key)
        condition = absolute_condition(mine)
        conditions.append(condition)
        notes = [f"all values are relative: bias of {name} minus bias of {main.name}, which is taken to have none"]
        if condition < _NETWORK:
            notes.append(
                f"{name} and {main.name} see targets from places so different (condition number {condition:.0f}) that a constant "
                "relative bias does not describe them: calibrate each of them against a trusted reference"
            )
        try:
            found.append(_follow(mine, key, name, f"relative to {main.name}", method, epochs, notes, terms))
        except NothingToDo as error:
            failed.append(str(error))
    if not found:
        raise NothingToDo(
            "; ".join(failed) or "there are no differences of radars", remedy="Do the recordings share time and area?"
        )
    worst = max((c for c in conditions if not np.isnan(c)), default=np.nan)
    number = "" if np.isnan(worst) else f" (condition number {_power(worst)})"
    why = f"radars at one place tell only the differences of their biases{number}: absolute ones need a trusted reference"
    absolute = [NotDetermined(main.key, name, why) for name in terms]
    covariance = _joint(found, _shared(samples, [f.summary.sensor for f in found]))
    return Calibration(
        terms=tuple(TermKey(f.summary.sensor, "all", BIASES[c], TERMS[BIASES[c]].unit) for f in found for c in f.known),
        epoch_s=epochs,
        value=np.concatenate([f.value for f in found], axis=1),
        covariance=covariance,
        sensors=tuple(f.summary for f in found),
        not_determined=tuple([*absolute, *(n for f in found for n in f.not_determined)]),
        warnings=tuple(failed),
        settings={"kind": "relative", "main": main.name, **_settings(method)},
    )


def register_online(
    samples: Samples,
    sensor: Sensor,
    *,
    method: Online | None = None,
    step_s: float | None = None,
    epoch_s: FloatArray | None = None,
    beside: Calibration | None = None,
) -> Calibration:
    """Follow one radar's biases over time, of its samples measured - true (`online_samples`).

    Epochs are `step_s` apart (by default a four-hundredth of the time), or those of `epoch_s` (k,).  The terms of `beside`,
    which `online_samples` has taken out, go on in the result with the values that they have there; what they are wrong by makes
    the biases wrong, as much as `beside` says of its own biases, and the covariance holds it.  Raises NothingToDo where no bias
    can be told.
    """
    method = method or KalmanBank()
    epochs = _epochs([samples], step_s) if epoch_s is None else epoch_s
    found = _follow(samples, sensor.key, sensor.name, "over time", method, epochs, [], BIASES)
    rows = [] if beside is None else _beside(beside, sensor.key)
    count, k = len(found.known), len(epochs)
    value = np.empty((k, count + len(rows)))
    covariance = np.zeros((k, count + len(rows), count + len(rows)))
    value[:, :count], covariance[:, :count, :count] = found.value, found.covariance
    keys = [TermKey(sensor.key, "all", BIASES[c], TERMS[BIASES[c]].unit) for c in found.known]
    if beside is not None and rows:
        value[:, count:] = beside.value[-1, rows]
        theirs = beside.covariance[-1][np.ix_(rows, rows)]
        with_them = np.zeros((count, len(rows)))
        for j, c in enumerate(found.known):
            row = beside.index(sensor.key, BIASES[c])
            if row is not None:
                with_them[j] = beside.covariance[-1][row, rows]
        size = np.sqrt(np.diag(theirs))
        unit = theirs / size[:, None] / size
        covariance[:, count:, count:] = theirs
        covariance[:, :count, count:] = with_them
        covariance[:, count:, :count] = with_them.T
        covariance[:, :count, :count] += (with_them / size) @ np.linalg.pinv(unit, hermitian=True) @ (with_them / size).T
        keys += [beside.terms[row] for row in rows]
    return Calibration(
        terms=tuple(keys),
        epoch_s=epochs,
        value=value,
        covariance=covariance,
        sensors=(found.summary,),
        not_determined=tuple(found.not_determined),
        settings={"kind": "over time", **_settings(method)},
    )


def online_samples(pairs: Pairs, sensors: Sensors, *, beside: Calibration | None = None) -> dict[int, Samples]:
    """The samples measured - true of every sensor in `pairs`, in order of time, by the sensor's id.

    The terms of `beside` other than the three biases (a time offset, a tilt) are taken out first.  The covariance holds the
    radar's noise, as the samples' scatter from one to the next shows it, with the reference's.  Raises NothingToDo without a
    usable pair.
    """
    usable = np.ones(len(pairs), bool)
    for rows in unusable(pairs).values():
        usable &= ~rows
    if not usable.any():
        raise NothingToDo("there are no pairs of plots and reference positions", remedy="Do the recordings share time and area?")
    out: dict[int, Samples] = {}
    epoch = float(beside.epoch_s[0]) if beside is not None else float(np.floor(pairs.plots.time_s[usable].min()))
    for key in np.unique(pairs.plots.sensor[usable]).tolist():
        sensor = sensors.find(int(key))
        if sensor is None:
            raise SettingsError(
                f"the pairs hold a sensor {key} that has no entry", where="sensors.toml", remedy="Add a [[sensor]]."
            )
        seen = observe(pairs, np.flatnonzero(usable & (pairs.plots.sensor == key)), sensor, epoch)
        kept = [] if beside is None else _beside(beside, int(key))
        terms: list[Term] = []
        value = np.empty(0)
        if beside is not None and kept:
            names = [beside.terms[row] for row in kept]
            terms = [term_of(k.name if k.channel == "all" else f"{k.name}@{k.channel}") for k in names]
            value = beside.value[-1, kept]
        order = np.argsort(seen.time_s, kind="stable")
        _, residual, _ = look(seen, order, terms, value)
        noise = _scatter(residual)
        covariance = np.zeros((len(order), 3, 3))
        for c in range(3):
            covariance[:, c, c] = np.maximum(noise[c] ** 2, seen.reference_variance[order, c])
        out[int(key)] = Samples(
            seen.time_s[order] + epoch,
            residual,
            covariance,
            seen.measured[order],
            seen.cluster[order],
            np.full(len(order), -1),
            np.zeros((len(order), 3)),
            np.full((len(order), 3, 3), np.nan),
        )
    return out


def _beside(calibration: Calibration, sensor: int) -> list[int]:
    """Where the terms of one sensor other than its biases stand in a calibration."""
    return [
        k
        for k, key in enumerate(calibration.terms)
        if key.sensor == sensor and not (key.name in BIASES and key.channel == "all") and np.isfinite(calibration.value[-1, k])
    ]


def _scatter(value: FloatArray) -> FloatArray:
    """The sd (3,) of samples (n, 3) about whatever changes slowly: of successive differences, outliers aside; NaN for none."""
    out = np.full(3, np.nan)
    for c in range(3):
        known = value[np.isfinite(value[:, c]), c]
        if len(known) > 1:
            out[c] = max(_SD_PER_MEDIAN * float(np.median(np.abs(np.diff(known)))) / np.sqrt(2), _FLOOR[c])
    return out


def _settings(method: Online) -> dict[str, object]:
    if isinstance(method, msgspec.Struct):
        options = {k: list(v) if isinstance(v, tuple) else v for k, v in msgspec.to_builtins(method).items()}
        return {"method": options.pop("type"), **options}
    return {"method": type(method).__name__}


def _power(number: float) -> str:
    return "beyond 1e14" if np.isinf(number) else f"{number:.0e}".replace("e+0", "e").replace("e+", "e")


def _epochs(samples: Sequence[Samples], step_s: float | None) -> FloatArray:
    """Times (k,) from the first sample to the last; the last is exactly there."""
    times = [s.time_s[np.isfinite(s.time_s)] for s in samples]
    times = [t for t in times if len(t)]
    if not times:
        raise NothingToDo("there is no sample with a time", remedy="Do the recordings share time and area?")
    if step_s is not None and not step_s > 0:
        raise SettingsError(f"step_s = {step_s} is no step", where="step_s", remedy="Give a positive number of seconds.")
    first, last = max(float(t.min()) for t in times), max(float(t.max()) for t in times)
    span = last - first
    step = step_s or max(span / _EPOCHS, 1e-9)
    count = int(np.ceil(span / step - 1e-9))
    if count > 1_000_000:
        raise SettingsError(f"step_s = {step_s} makes {count:,} epochs", where="step_s", remedy="Give a larger step.")
    epochs: FloatArray = last - step * np.arange(count, -1, -1.0)
    return np.maximum(epochs, first)


def _follow(
    samples: Samples,
    key: int,
    name: str,
    model: str,
    method: Online,
    epochs: FloatArray,
    notes: list[str],
    terms: Sequence[str],
) -> _Followed:
    """One radar's biases at the epochs."""
    order = np.argsort(samples.time_s, kind="stable")
    mine = samples.take(order)
    good = np.isfinite(mine.time_s) & np.isfinite(mine.value[:, :2]).any(axis=1)
    if not good.all():
        notes.append(f"{(~good).sum():,} of {len(good):,} samples were left out: no time, or no value")
        mine = mine.take(good)
    variance = np.diagonal(mine.covariance, axis1=1, axis2=2) if len(mine) else np.empty((0, 3))
    z = np.where(np.isfinite(variance) & (variance >= 0), mine.value, np.nan)
    shown = _scatter(z)
    stated = np.array([np.sqrt(np.nanmedian(variance[:, c])) if np.isfinite(z[:, c]).any() else np.nan for c in range(3)])
    known: list[int] = []
    missing: list[NotDetermined] = []
    for c, term in enumerate(BIASES):
        if term not in terms:
            continue
        count = int(np.isfinite(z[:, c]).sum())
        if count >= _LEAST:
            known.append(c)
        elif c < 2 or count or model == "over time":
            why = "elevation is not measured" if c == 2 and not count else f"{count} samples are too few; {_LEAST} are needed"
            missing.append(NotDetermined(key, term, why))
        else:
            missing.append(NotDetermined(key, term, "elevation is not measured"))
    if not known:
        raise NothingToDo(f"{name}: {len(mine)} usable samples are too few for any bias")
    # Samples that scatter more than their sd, and samples that share what is the target's, tell less.
    wider = np.maximum(np.nan_to_num(shown / np.maximum(stated, _FLOOR), nan=1.0), 1.0)
    for c in known:
        if wider[c] > 1.5:
            unit = "m" if c == 0 else "deg"
            value = shown[c] if c == 0 else shown[c] / DEG
            notes.append(f"{BIASES[c]}: samples scatter by {value:.3g} {unit}, {wider[c]:.1f} times what their sd say")
    r = np.maximum(variance * wider**2, _FLOOR**2)
    if isinstance(method, KalmanBank):
        # Who remembers a dozen samples follows their noise, through a gap nothing at all, and within a turn single targets.
        method = method.no_faster(max(_TELLING * _spacing(mine.time_s), _TURNS * _revisit(mine)))
    found = method(mine.time_s, z.T[known], r.T[known], epochs)
    own, worth = _own(mine, z, r, known, epochs, _held_back(found.value))
    extra = np.zeros((len(known), len(epochs)))
    if (own > 0).any() or (worth > 1).any():
        if isinstance(method, KalmanBank):
            method = method.no_faster(_TELLING * _spacing(mine.time_s) * float(worth.max()))
            few = _present(mine, epochs, _FADE_S)[0].max() <= _SLOTS
            shared = (mine.target, own) if few else ()
            found = method(mine.time_s, z.T[known], r.T[known] * worth[:, None], epochs, *shared)
        else:
            few = False
            extra = found.variance * (np.maximum(worth, 1.0) - 1)[:, None]
        if not few:
            # A target's own errors do not average out while it is there: only other targets do.
            extra = extra + own[:, None] / _present(mine, epochs, _window(method))[1]
    value = _held_back(found.value)
    spread = _held_back(found.variance + extra)
    inlier = _agreeing(mine.time_s, z.T[known], r.T[known], epochs, value, _INLIER_SD)
    for j, c in enumerate(known):
        count, agree = int(np.isfinite(z[:, c]).sum()), int(inlier[j].sum())
        ended = "" if not found.missed[j] else f"; at {found.missed[j]:,} of {len(epochs):,} epochs the search did not settle"
        what = ""
        if own[j] > 0:
            size = f"{np.sqrt(own[j]):.3g} m" if c == 0 else f"{np.sqrt(own[j]) / DEG:.3g} deg"
            what = f"; samples of one target share errors of {size}, which only other targets average out"
        notes.append(f"{BIASES[c]}: {agree:,} of {count:,} samples agree within {_INLIER_SD:g} sd{what}{ended}")
        if agree < _AGREE * count:
            notes.append(
                f"{BIASES[c]}: most samples do not agree: they are outliers, or the bias changes faster than the method follows"
            )
    if not (mine.target < 0).any() and np.median(_present(mine, epochs, _MINUTE_S)[0]) < 2:
        notes.append("one target at a time: what it keeps for itself cannot be told from the biases, and is not in their sd")
    k = len(epochs)
    covariance = np.zeros((k, len(known), len(known)))
    # Errors of one sample in range, azimuth and elevation correlate a little where the radars stand apart.
    mean = np.nanmean(mine.covariance[:, known][:, :, known], axis=0)
    size = np.sqrt(np.diag(mean))
    rho = mean / np.maximum(size[:, None] * size, 1e-300)
    np.fill_diagonal(rho, 1.0)
    sd = np.sqrt(spread.T)
    covariance[:] = sd[:, :, None] * rho * sd[:, None, :]
    noise = np.where(np.isfinite(shown), shown, np.nan)
    before, after = _misses(mine, z, known, epochs, value)
    summary = Summary(
        sensor=key,
        name=name,
        model=model,
        noise=Noise(float(noise[0]), float(noise[1]), float(noise[2])),
        plots=len(mine),
        tracks=len(np.unique(mine.target)),
        targets=len(np.unique(mine.target)),
        before=before,
        after=after,
        notes=tuple(notes),
    )
    part = np.median(mine.main_variance[:, known], axis=0) / np.median(r[:, known], axis=0)
    return _Followed(known, value.T, (covariance + np.swapaxes(covariance, 1, 2)) / 2, part, summary, missing)


def _held_back(value: FloatArray) -> FloatArray:
    """The series (m, k) with their first number in place of what comes before it."""
    out = value.copy()
    for row in out:
        known = np.flatnonzero(np.isfinite(row))
        if len(known):
            row[: known[0]] = row[known[0]]
    return out


def _own(
    samples: Samples, value: FloatArray, variance: FloatArray, known: list[int], epochs: FloatArray, found: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The variance (m,) of what the samples of a target share beside the bias (m, k) that was found, and their worth (m,).

    The first is of medians over blocks of minutes of the squared difference of neighbouring targets' means, less what their
    noise gives.  The second is by what to multiply the samples' variance, which holds the first and knows of no memory in the
    noise, for the noise alone and as if it had none.
    """
    own, worth = np.zeros(len(known)), np.ones(len(known))
    if not len(samples) or (samples.target < 0).any():
        return own, worth
    block = np.floor((samples.time_s - samples.time_s[0]) / _BLOCK_S).astype(np.int64)
    _, group = np.unique(np.stack([block, samples.target]), axis=1, return_inverse=True)
    groups = int(group.max()) + 1
    own_block = np.zeros(groups, np.int64)
    own_block[group] = block
    order = np.lexsort((samples.time_s, samples.target))
    same = np.diff(samples.target[order]) == 0
    slot = np.floor((samples.time_s - samples.time_s[0]) / _MINUTE_S).astype(np.int64)
    minutes, minute = np.unique(np.stack([samples.target, slot]), axis=1, return_inverse=True)
    for j, c in enumerate(known):
        left = value[:, c] - np.interp(samples.time_s, epochs, found[j])
        # What one sample of a target differs from its next by is its noise; what a minute differs from the next, its memory.
        step = np.diff(left[order])[same & np.isfinite(np.diff(left[order]))]
        usual = float(np.median(variance[np.isfinite(left), c]))
        noise = _SD_PER_MEDIAN**2 * float(np.median(step**2)) / 2 if len(step) >= 8 else usual
        share = min(max(noise / usual, 1e-4), 1.0)
        # Means are of what is no outlier among its target's samples of these minutes.
        with np.errstate(invalid="ignore"):
            left[np.abs(left - _medians(left, group, groups)[group]) > _OUTLIER_SD * np.sqrt(usual)] = np.nan
        memory = _memory(left, share * usual, minute, minutes)
        seen = np.isfinite(left)
        number = np.bincount(group[seen], minlength=groups).astype(np.float64)
        total = np.bincount(group[seen], left[seen], groups)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean, white = total / number, share * memory * usual / number
        near = (own_block[1:] == own_block[:-1]) & (number[1:] >= 5) & (number[:-1] >= 5)
        grown, both = _ratio(np.diff(mean)[near], (white[1:] + white[:-1])[near])
        if grown > 1.0:
            own[j] = (grown - 1.0) * float(np.median(both)) / 2
        if grown > 1.0 or memory > 1.0:
            worth[j] = share * memory
    return own, worth


def _medians(value: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """The (upper) medians (g,) of the numbers in each group, NaN where there is none."""
    seen = np.flatnonzero(np.isfinite(value))
    order = seen[np.lexsort((value[seen], group[seen]))]
    number = np.bincount(group[seen], minlength=groups)
    middle = np.cumsum(number) - number + number // 2
    out = np.full(groups, np.nan)
    out[number > 0] = value[order[middle[number > 0]]]
    return out


def _memory(left: FloatArray, noise: float, minute: IntArray, minutes: IntArray) -> float:
    """By how much the means over one target's neighbouring minutes differ more than white noise would have it, at least 1.

    `left` (n,) with the number of each one's minute (n,); `minutes` (2, m) are the target and the slot of time of each.  Where
    targets are there together one's change is compared with the next one's, so that the bias has no part in it.
    """
    seen = np.isfinite(left)
    number = np.bincount(minute[seen], minlength=minutes.shape[1]).astype(np.float64)
    total = np.bincount(minute[seen], left[seen], minutes.shape[1])
    next_one = (np.diff(minutes[0]) == 0) & (np.diff(minutes[1]) == 1) & (number[1:] >= 3) & (number[:-1] >= 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.diff(total / number)[next_one]
        white = noise * (1 / number[1:] + 1 / number[:-1])[next_one]
    when = minutes[1, 1:][next_one]
    order = np.argsort(when, kind="stable")
    together = np.diff(when[order]) == 0
    if together.sum() >= _TELL_RATIO:
        change, white = np.diff(change[order])[together], (white[order][1:] + white[order][:-1])[together]
    return _ratio(change, white)[0]


def _ratio(difference: FloatArray, variance: FloatArray) -> tuple[float, FloatArray]:
    """By how much differences (n,) are larger in the square than their variances (n,) say, by the median; and the variances.

    1 where it is less, or no more than chance makes it.
    """
    if len(difference) < _TELL_RATIO:
        return 1.0, variance
    ratio = float(np.median(difference**2 / variance)) / _MEDIAN_CHI2
    # What the median of squares of normal variables says is itself uncertain: by 2.33 over the root of their number.
    return (ratio if ratio > 1.0 + 2 * 2.33 / np.sqrt(len(difference)) else 1.0), variance


def _window(method: Online) -> float:
    """The time (s) up to an epoch whose samples count in the method's estimate, as if they counted alike."""
    if isinstance(method, Igmsr | ExponentialAverage):
        return 2 * method.tau_s
    if isinstance(method, AlphaBetaBias):
        return 2 * method.slot_s / method.gains.alpha
    return float("inf") if isinstance(method, MeanShift) else _BLOCK_S


def _present(samples: Samples, epochs: FloatArray, window_s: float) -> tuple[FloatArray, FloatArray]:
    """How many targets (k,) were seen within so many seconds up to each epoch, and as how many with equal shares they count.

    Both are at least one.
    """
    _, code = np.unique(samples.target, return_inverse=True)
    begin, end = (np.searchsorted(samples.time_s, epochs - back, side="right") for back in (window_s, 0.0))
    out = np.ones((2, len(epochs)))
    for k, (low, high) in enumerate(zip(begin, end, strict=True)):
        number = np.bincount(code[low:high]).astype(np.float64)
        if high > low:
            out[:, k] = (number > 0).sum(), number.sum() ** 2 / (number @ number)
    return out[0], out[1]


def _revisit(samples: Samples) -> float:
    """The usual time (s) from one sample of a target to the next; 0 where targets are not known."""
    if not len(samples) or (samples.target < 0).any():
        return 0.0
    order = np.lexsort((samples.time_s, samples.target))
    step = np.diff(samples.time_s[order])[np.diff(samples.target[order]) == 0]
    return float(np.median(step)) if len(step) else 0.0


def _agreeing(
    time_s: FloatArray, value: FloatArray, variance: FloatArray, epochs: FloatArray, found: FloatArray, within_sd: float
) -> BoolArray:
    """Which samples (m, n) lie within so many sd of the bias at their time."""
    out = np.zeros(value.shape, bool)
    for j in range(len(value)):
        known = np.isfinite(found[j])
        at = np.interp(time_s, epochs[known], found[j, known]) if known.any() else np.full(len(time_s), np.nan)
        with np.errstate(invalid="ignore"):
            out[j] = np.abs(value[j] - at) <= within_sd * np.sqrt(variance[j])
    return out


def _misses(
    samples: Samples, value: FloatArray, known: list[int], epochs: FloatArray, found: FloatArray
) -> tuple[Accuracy, Accuracy]:
    """Horizontal differences before and after: along the range, and across it."""
    left = value.copy()
    for j, c in enumerate(known):
        left[:, c] -= np.interp(samples.time_s, epochs, found[j])
    out = []
    for z in (value, left):
        arm = samples.polar[:, 0] * np.cos(np.nan_to_num(samples.polar[:, 2]))
        distance = np.hypot(z[:, 0], arm * z[:, 1])
        distance = distance[np.isfinite(distance)]
        out.append(
            Accuracy(float(np.median(distance)), float(np.percentile(distance, 95)))
            if len(distance)
            else Accuracy(np.nan, np.nan)
        )
    return out[0], out[1]


def _shared(samples: Mapping[int, Samples], keys: list[int]) -> FloatArray:
    """The share (r,) of each radar's samples whose main plot serves another radar too."""
    out = np.zeros(len(keys))
    for j, key in enumerate(keys):
        mine = samples[key].main
        others = [samples[k].main for k in keys if k != key]
        if others and len(mine):
            out[j] = float((np.isin(mine, np.concatenate(others)) & (mine >= 0)).mean())
    return out


def _joint(found: list[_Followed], shared: FloatArray) -> FloatArray:
    """The covariance (k, p, p) over all radars: what the main radar's noise is of each sample's, estimates have in common.

    Two radars' correlation is the root of the product of their parts, so that the whole stays positive definite.
    """
    k, sizes = len(found[0].value), [len(f.known) for f in found]
    out = np.zeros((k, sum(sizes), sum(sizes)))
    at = np.cumsum([0, *sizes])
    part = [np.minimum(f.main_part, 1.0) for f in found]
    for a, one in enumerate(found):
        sd_a = np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2))
        out[:, at[a] : at[a + 1], at[a] : at[a + 1]] = one.covariance
        for b in range(a + 1, len(found)):
            other = found[b]
            sd_b = np.sqrt(np.diagonal(other.covariance, axis1=1, axis2=2))
            for i, c in enumerate(one.known):
                if c in other.known:
                    j = other.known.index(c)
                    rho = np.sqrt(part[a][i] * part[b][j]) * np.sqrt(shared[a] * shared[b])
                    out[:, at[a] + i, at[b] + j] = out[:, at[b] + j, at[a] + i] = rho * sd_a[:, i] * sd_b[:, j]
    return out
