"""What a recording tells of its clocks: the antenna's turn against the stamps, and the stamps against the time of reception.

An antenna turns evenly: azimuth against time is a straight line of turns, and what departs from it is the stamping (jitter,
quantisation, sectors that are stamped as one), the motor (ripple over a turn, a slow wander) or a gap.  North and sector marks
tell it where a radar sends them, else its plots do.  None of this needs a reference; a constant time offset stays hidden.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import NothingToDo
from ..model import EXCLUDED, Recording, Sensors

TURN = 2 * np.pi
# Periods of rotation that are looked for, s.
_SHORTEST, _LONGEST = 0.4, 20.0
# The window in which the period is found first, and how well azimuths must fall on one line there.
_WINDOW_S, _COHERENT = 60.0, 0.6
# Turns over which the slow wander is smoothed: what is faster is jitter.
_SMOOTH = 11
# A gap: so many turns without anything.
_GAP_TURNS = 3.0
_LEAST = 50
# A share of the variance from which on a cause is said.
_SHARE = 0.3


class Gap(msgspec.Struct, frozen=True):
    """A time without anything from a radar (UTC s)."""

    start_s: float
    end_s: float


class Rotation(msgspec.Struct, frozen=True, kw_only=True):
    """The turn of one radar's antenna.

    `told_by` is "marks" or "plots".  `jitter_s` is the robust sd of the stamps about the turn, `jitter_999_s` what 99.9 % of them
    keep to, `wander_s` the sd of the slow part (over some eleven turns).  `ripple_deg` are the amplitudes of one and two cycles a
    turn, in azimuth.  `sectors` is the number of sectors that are stamped as one (0: none), `step_s` the step of the stamps.
    In `stretches_off` stretches of half a turn or more all stamps are late or early together, by `shift_s`
    (median).  `period_told_s` is what the radar itself says (I034/041, I002/041).
    """

    sensor: int
    told_by: str
    samples: int
    turns: int
    period_s: float
    period_se_s: float
    jitter_s: float
    jitter_999_s: float
    wander_s: float
    ripple_deg: tuple[float, float]
    sectors: int
    step_s: float
    gaps: tuple[Gap, ...]
    stretches_off: int = 0
    shift_s: float = float("nan")
    period_told_s: float = float("nan")


class Reception(msgspec.Struct, frozen=True, kw_only=True):
    """Time of reception minus stamp of one radar: its median, robust sd, extremes, and how it drifts (ms an hour)."""

    sensor: int
    samples: int
    median_s: float
    sd_s: float
    least_s: float
    most_s: float
    late_999_s: float
    drift_ms_per_h: float


class ClockAudit(msgspec.Struct, frozen=True):
    """What was found of the clocks; `remarks` says in words what a user should look at."""

    rotations: tuple[Rotation, ...]
    receptions: tuple[Reception, ...]
    remarks: tuple[str, ...]


class Turning(NamedTuple):
    """Samples of a turning antenna in order of time: stamp (UTC s), turns so far, stamp minus even turning, its slow part."""

    sensor: int
    time_s: FloatArray
    turn: FloatArray
    late_s: FloatArray
    slow_s: FloatArray


def audit(recording: Recording, sensors: Sensors | None = None) -> ClockAudit:
    """Look at a recording's clocks.  `sensors` gives names and the expected `scan_s`.

    Raises NothingToDo where the recording has neither plots nor marks with times, nor times of reception.
    """
    return examine(recording, sensors)[0]


def examine(recording: Recording, sensors: Sensors | None = None) -> tuple[ClockAudit, tuple[Turning, ...]]:
    """`audit`, and the samples of each turning antenna that it was made from."""
    rotations: list[Rotation] = []
    turning: list[Turning] = []
    remarks: list[str] = []
    ids = np.unique(np.concatenate([recording.plots.sensor, recording.marks.sensor])).tolist()
    for sensor in ids:
        name = _name(sensor, sensors)
        found = rotation(recording, sensor)
        if found is None:
            count = int(max(np.count_nonzero(t.sensor == sensor) for t in (recording.plots, recording.marks)))
            few = f"{count} plots or marks are too few to tell its rotation"
            remarks.append(f"{name}: {few if count < _LEAST else 'no even rotation is found in its azimuths and times'}")
            continue
        rotations.append(found[0])
        turning.append(found[1])
        remarks += _say(found[0], name, None if sensors is None else getattr(sensors.find(sensor), "scan_s", None))
    receptions = _receptions(recording)
    for one in receptions:
        remarks += _say_reception(one, _name(one.sensor, sensors))
    if not ids and not receptions:
        raise NothingToDo(
            f"{recording.path}: there is nothing to tell of its clocks: no plots, marks or times of reception",
            remedy="Give a radar's recording, or a packet capture.",
        )
    return ClockAudit(tuple(rotations), tuple(receptions), tuple(remarks)), tuple(turning)


def _name(sensor: int, sensors: Sensors | None) -> str:
    known = None if sensors is None else sensors.find(sensor)
    if known is not None:
        return known.name
    return f"SAC/SIC {sensor >> 8}/{sensor & 255}" if sensor < 65536 else f"sensor {sensor}"


# ------------------------------------------------------------------------------------------------------------------ rotation


def rotation(recording: Recording, sensor: int) -> tuple[Rotation, Turning] | None:
    """The turn of a radar's antenna, and its samples; None where nothing turns evenly.

    Its marks tell where there are enough, else its plots (those with a flag of `EXCLUDED` left out).
    """
    marks, plots = recording.marks, recording.plots
    mine = (marks.sensor == sensor) & np.isfinite(marks.time_s)
    use = (plots.sensor == sensor) & (plots.flags & int(EXCLUDED) == 0)
    use &= np.isfinite(plots.time_s) & np.isfinite(plots.azimuth_rad)
    period = marks.period_s[mine]
    told = float(np.median(period[np.isfinite(period)])) if np.isfinite(period).any() else float("nan")
    for name, time_s, azimuth in (
        ("marks", marks.time_s[mine], marks.azimuth_rad[mine]), ("plots", plots.time_s[use], plots.azimuth_rad[use]),
    ):  # fmt: skip
        if len(time_s) < _LEAST:
            continue
        order = np.argsort(time_s, kind="stable")
        found = _turns(time_s[order], azimuth[order])
        if found is not None:
            return _rotation(sensor, name, time_s[order], azimuth[order], *found, told)
    return None


def _turns(time_s: FloatArray, azimuth: FloatArray) -> tuple[FloatArray, float] | None:
    """The azimuth counted on over turns (rad), and the period (s); None where azimuths do not turn evenly clockwise."""
    t = time_s - time_s[0]
    period = _coarse(t, azimuth)
    if period is None:
        return None
    # The line is followed from window to window, each long enough to tell the rate well enough for the next.
    end = _WINDOW_S
    count = np.zeros(len(t))
    while True:
        w = t <= end
        phase = np.angle(np.mean(np.exp(1j * (azimuth[w] - TURN * t[w] / period))))
        count[w] = np.round((TURN * t[w] / period + phase - azimuth[w]) / TURN)
        period = _fit(azimuth[w] + TURN * count[w], t[w])[0] * TURN
        if end >= t[-1] or end > 20 * _WINDOW_S:
            break
        end *= 3
    # From there on block by block: the motor may wander by more than half a turn over a day.
    unwrapped = azimuth + TURN * count
    done = int(np.searchsorted(t, end, side="right"))
    rate = TURN / period
    while done < len(t):
        back = np.searchsorted(t, t[done - 1] - 20 * period)
        level = np.median(unwrapped[back:done] - rate * t[back:done])
        stop = int(np.searchsorted(t, t[done] + 10 * period, side="right"))
        here = slice(done, stop)
        unwrapped[here] = azimuth[here] + TURN * np.round((rate * t[here] + level - azimuth[here]) / TURN)
        done = stop
    return unwrapped, period


def _coarse(t: FloatArray, azimuth: FloatArray) -> float | None:
    """The period in which azimuths of the busiest minute fall on one line."""
    counts = np.searchsorted(t, t + _WINDOW_S) - np.arange(len(t))
    first = int(np.argmax(counts))
    w = slice(first, first + min(int(counts[first]), 3000))
    here, angle = t[w] - t[first], azimuth[w]
    if len(here) < 10 or np.ptp(here) < 2 * _SHORTEST or abs(np.mean(np.exp(1j * angle))) > 0.95:
        return None
    frequency = np.arange(1 / _LONGEST, 1 / _SHORTEST, 1 / (4 * max(np.ptp(here), 1.0)))
    together = np.abs(np.exp(1j * (angle[None] - TURN * frequency[:, None] * here[None])).mean(axis=1))
    best = int(np.argmax(together))
    if together[best] < _COHERENT:
        return None
    fine = frequency[best] + np.linspace(-0.5, 0.5, 41) / (4 * max(np.ptp(here), 1.0))
    together = np.abs(np.exp(1j * (angle[None] - TURN * fine[:, None] * here[None])).mean(axis=1))
    return float(1 / fine[np.argmax(together)])


def _fit(x: FloatArray, y: FloatArray) -> tuple[float, float, BoolArray]:
    """Slope and level of a line, and what it was fitted to: twice without what lies beyond five robust sd."""
    use = np.ones(len(x), bool)
    slope = level = 0.0
    for _ in range(3):
        middle = x[use].mean()
        slope, level = (float(v) for v in np.polyfit(x[use] - middle, y[use], 1))
        level -= slope * middle
        rest = y - slope * x - level
        use = np.abs(rest - np.median(rest)) <= 5 * _sd(rest) + 1e-6
    return slope, level, use


def _sd(value: FloatArray) -> float:
    """The robust sd: from the median distance to the median."""
    return float(1.4826 * np.median(np.abs(value - np.median(value)))) if len(value) else float("nan")


def _rotation(
    sensor: int, told_by: str, time_s: FloatArray, azimuth: FloatArray, unwrapped: FloatArray, period: float, told: float
) -> tuple[Rotation, Turning]:
    t = time_s - time_s[0]
    slope, level, _ = _fit(unwrapped, t)
    period = slope * TURN
    late = t - slope * unwrapped - level
    turn = (unwrapped - unwrapped[0]) / TURN
    slow = _slow(turn, late)
    fast = late - slow
    jitter = _sd(fast)
    # One and two cycles a turn, as azimuth: an eccentric encoder, a motor that pulls unevenly, wind.
    use = np.abs(fast) <= 5 * jitter + 1e-6
    waves = np.column_stack([f(k * azimuth[use]) for k in (1, 2) for f in (np.cos, np.sin)])
    found = np.linalg.lstsq(waves, fast[use], rcond=None)[0] if use.sum() > 20 else np.zeros(4)
    ripple = tuple(float(np.hypot(found[2 * k], found[2 * k + 1]) * 360 / period) for k in (0, 1))
    gaps = np.flatnonzero(np.diff(t) > _GAP_TURNS * period)
    # The period's uncertainty: the slow wander is one sample every `_SMOOTH` turns.
    span = max(float(np.ptp(turn)), 1.0)
    spread = np.hypot(np.std(slow), jitter / np.sqrt(max(len(t) / span * _SMOOTH, 1.0)))
    samples = max(span / _SMOOTH, 2.0)
    shifts = _shifts(turn, fast, jitter)
    return (
        Rotation(
            sensor=sensor, told_by=told_by, samples=len(t), turns=round(span), period_s=period,
            period_se_s=float(spread * np.sqrt(12 / samples) / span), jitter_s=jitter,
            jitter_999_s=float(np.quantile(np.abs(fast), 0.999)), wander_s=float(np.std(slow)), ripple_deg=(ripple[0], ripple[1]),
            sectors=_sectors(azimuth, fast, period) if told_by == "plots" else 0, step_s=_step(t), stretches_off=len(shifts),
            shift_s=float(np.median(shifts)) if len(shifts) else float("nan"),
            gaps=tuple(Gap(float(time_s[k]), float(time_s[k + 1])) for k in gaps.tolist()), period_told_s=told,
        ),
        Turning(sensor, time_s, turn, late, slow),
    )  # fmt: skip


def _slow(turn: FloatArray, late: FloatArray) -> FloatArray:
    """The part of the lateness that is slower than some turns: medians of turns under a running median, joined by lines."""
    whole = np.floor(turn).astype(np.int64)
    order = np.lexsort((late, whole))
    number, first, count = np.unique(whole[order], return_index=True, return_counts=True)
    ranked = late[order]
    medians = (ranked[first + (count - 1) // 2] + ranked[first + count // 2]) / 2
    if len(medians) < 3:
        return np.full(len(late), np.median(late))
    half = min(_SMOOTH, len(medians) - (len(medians) + 1) % 2) // 2
    padded = np.pad(medians, half, mode="edge")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    return np.asarray(np.interp(turn, number + 0.5, smooth))


def _shifts(turn: FloatArray, fast: FloatArray, jitter: float) -> FloatArray:
    """The lateness of stretches of the turn in which all stamps are late (or early) together, beyond three sd of jitter.

    Eighths of turns are looked at; those that follow each other are one stretch, and a stretch is at least half a turn.
    """
    eighth, whose = np.unique(np.floor(turn * 8), return_inverse=True)
    count = np.bincount(whose)
    out = []
    for sign in (1.0, -1.0):
        beyond = np.bincount(whose, sign * fast > 3 * jitter, len(eighth)) > 0.8 * count
        edges = np.flatnonzero(np.diff(np.r_[False, beyond, False]))
        for low, high in edges.reshape(-1, 2).tolist():
            inside = (whose >= low) & (whose < high)
            if eighth[high - 1] - eighth[low] >= 3 and np.count_nonzero(inside) >= 5:
                out.append(float(np.median(fast[inside])))
    return np.array(out)


def _sectors(azimuth: FloatArray, fast: FloatArray, period: float) -> int:
    """How many sectors are stamped as one: within each the lateness falls by the time that the antenna takes to cross it."""
    for sectors in (4, 8, 12, 16, 18, 24, 32, 36, 64, 72, 128, 256):
        inside = azimuth * sectors / TURN % 1.0
        fall = -period / sectors
        left = fast - fall * (inside - 0.5)
        if np.var(fast) > 0 and np.mean((left - left.mean()) ** 2) < (1 - _SHARE) * np.var(fast) and abs(fall) > 2e-3:
            slope = np.polyfit(inside, fast, 1)[0]
            if 0.7 < slope / fall < 1.3:
                return sectors
    return 0


def _step(t: FloatArray) -> float:
    """The step of the stamps: the least difference of which all others are multiples (0: none from 1/256 s on)."""
    for step in (1.0, 0.5, 0.25, 0.1, 0.01, 1 / 128, 1 / 256):
        if np.all(np.abs(t / step - np.round(t / step)) < 1e-3):
            return step
    return 0.0


def _say(found: Rotation, name: str, expected: float | None) -> list[str]:
    out = []
    if np.isfinite(found.period_told_s) and abs(found.period_told_s - found.period_s) > max(0.01, 5 * found.period_se_s):
        out.append(f"{name}: it says that it turns in {found.period_told_s:.3f} s, its {found.told_by} in {found.period_s:.4f} s")
    if expected is not None and abs(expected - found.period_s) > 0.02 * expected:
        out.append(f"{name}: sensors.toml says scan_s = {expected:g}, but it turns in {found.period_s:.4f} s")
    if found.sectors:
        out.append(
            f"{name}: plots are stamped by sector ({found.sectors} a turn): the stamp of a plot is off by up to "
            f"{found.period_s / found.sectors * 500:.0f} ms"
        )
    if found.stretches_off:
        out.append(
            f"{name}: in {found.stretches_off} stretches of about a turn all stamps are off together, by "
            f"{found.shift_s * 1e3:+.0f} ms (median)"
        )
    if found.jitter_999_s > max(0.05, 8 * found.jitter_s):
        out.append(f"{name}: one stamp in a thousand is off by {found.jitter_999_s * 1e3:.0f} ms or more")
    for k, amplitude in enumerate(found.ripple_deg):
        if amplitude > 0.2:
            cycle = ("once", "twice")[k]
            out.append(
                f"{name}: its turn is uneven {cycle} a turn, by {amplitude:.2f} degrees: motor, wind or an eccentric encoder"
            )
    if found.gaps:
        longest = max(found.gaps, key=lambda g: g.end_s - g.start_s)
        out.append(f"{name}: {len(found.gaps)} gaps, the longest of {longest.end_s - longest.start_s:.0f} s")
    return out


# ----------------------------------------------------------------------------------------------------------------- reception


def _stamped(recording: Recording) -> tuple[IntArray, FloatArray, FloatArray]:
    """Source, stamp and time of reception of what has both."""
    if not len(recording.receive_s):
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    tables = (
        (recording.plots.sensor, recording.plots), (recording.marks.sensor, recording.marks),
        (recording.fixes.source, recording.fixes), (recording.tracks.source, recording.tracks),
    )  # fmt: skip
    source = np.concatenate([s.astype(np.int64) for s, _ in tables])
    time_s = np.concatenate([t.time_s for _, t in tables])
    record = np.concatenate([t.record for _, t in tables])
    received = recording.receive_s[record]
    # A record that is a plot and a fix counts once.
    _, first = np.unique(record, return_index=True)
    first = first[np.isfinite(time_s[first]) & np.isfinite(received[first])]
    return source[first], time_s[first], received[first]


def _receptions(recording: Recording) -> list[Reception]:
    source, time_s, received = _stamped(recording)
    out = []
    for sensor in np.unique(source).tolist():
        mine = source == sensor
        late, at = received[mine] - time_s[mine], time_s[mine]
        drift = float("nan")
        if len(late) >= 20 and np.ptp(at) > 60:
            drift = _fit(at - at[0], late)[0] * 3600e3
        out.append(
            Reception(
                sensor=sensor,
                samples=len(late),
                median_s=float(np.median(late)),
                sd_s=_sd(late),
                least_s=float(late.min()),
                most_s=float(late.max()),
                late_999_s=float(np.quantile(late, 0.999)),
                drift_ms_per_h=drift,
            )
        )
    return out


def _say_reception(one: Reception, name: str) -> list[str]:
    out = []
    if one.median_s < 0:
        out.append(f"{name}: it is received {-one.median_s:.3f} s before it is stamped (median): one of the two clocks is wrong")
    elif one.median_s > 5:
        out.append(
            f"{name}: it is received {one.median_s:.2f} s after it is stamped (median): its clock or the receiver's is off"
        )
    if abs(one.drift_ms_per_h) > 50:
        out.append(f"{name}: reception drifts by {one.drift_ms_per_h:+.0f} ms an hour against the stamps")
    return out


# -------------------------------------------------------------------------------------------------------------------- figure


def figure(recording: Recording, path: str | Path, sensors: Sensors | None = None) -> None:
    """Draw the lateness of stamps over time and azimuth, and of reception, to a file (SVG, PNG or PDF by its name).

    One row a radar: stamps against even turning over time with the slow wander, what is left of it by azimuth, and reception
    minus stamp.  Raises NothingToDo where there is nothing to draw, InputError where the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from .._files import atomic

    ids = np.unique(np.concatenate([recording.plots.sensor, recording.marks.sensor])).tolist()
    turning = [(sensor, found[1]) for sensor in ids if (found := rotation(recording, sensor)) is not None]
    source, stamps, received = _stamped(recording)
    shown = [s for s, _ in turning] + [s for s in np.unique(source).tolist() if s not in dict(turning)]
    if not shown:
        raise NothingToDo(f"{recording.path}: there is nothing to draw of its clocks", remedy="Give a radar's recording.")
    shown = shown[:8]
    drawing = Figure(figsize=(12, 2.8 * len(shown) + 0.4), layout="constrained")
    FigureCanvasAgg(drawing)
    axes = drawing.subplots(len(shown), 3, squeeze=False)
    rng = np.random.default_rng(0)
    for row, sensor in zip(axes, shown, strict=True):
        one = dict(turning).get(sensor)
        row[0].set_ylabel(f"{_name(sensor, sensors)}\nstamp - even turning, ms")
        row[1].set_ylabel("without the slow part, ms")
        row[2].set_ylabel("reception - stamp, s")
        row[0].set_xlabel("minutes since the first")
        row[1].set_xlabel("azimuth, degrees")
        row[2].set_xlabel("minutes since the first")
        if one is not None:
            some = np.sort(rng.choice(len(one.time_s), min(len(one.time_s), 20_000), replace=False))
            minutes = (one.time_s - one.time_s[0]) / 60
            limit = 1e3 * max(float(np.quantile(np.abs(one.late_s), 0.995)), 1e-3) * 1.3
            row[0].plot(minutes[some], 1e3 * one.late_s[some], ".", markersize=1, color="0.6", rasterized=True)
            row[0].plot(minutes[some], 1e3 * one.slow_s[some], "-", linewidth=1.2, color="C3")
            row[0].set_ylim(-limit, limit)
            fast = 1e3 * (one.late_s - one.slow_s)
            limit = max(float(np.quantile(np.abs(fast), 0.995)), 1.0) * 1.3
            row[1].plot(one.turn[some] % 1 * 360, fast[some], ".", markersize=1, color="C0", rasterized=True)
            row[1].set_xlim(0, 360)
            row[1].set_ylim(-limit, limit)
        mine = source == sensor
        if mine.any():
            row[2].plot(
                (stamps[mine] - stamps[mine].min()) / 60,
                (received - stamps)[mine],
                ".",
                markersize=2,
                color="C2",
                rasterized=True,
            )
        else:
            row[2].text(0.5, 0.5, "no times of reception", ha="center", va="center", transform=row[2].transAxes, color="0.4")
    drawing.suptitle("Clocks: stamps against the antenna's turn, and reception against the stamps", fontsize=11)
    with atomic(path) as beside:
        kind = Path(path).suffix.lstrip(".").lower() or "png"
        # Without dates, so that the same input gives the same bytes.
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        drawing.savefig(beside, format=kind, dpi=120, metadata=dates.get(kind))
