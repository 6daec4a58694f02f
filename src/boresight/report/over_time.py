"""A radar's errors as functions of time: samples, estimate and its band."""

from __future__ import annotations

import numpy as np

from ..calibration import Calibration, TermKey, si_per_unit
from ..registration.mean_shift import Samples
from ..registration.sequential import BIASES
from .drawing import (
    AFTER,
    INK,
    TRACK,
    Drawing,
    axes_grid,
    band,
    dot,
    legend,
    line,
    points,
    sample,
    style,
    term_label,
    time_axis,
    to_svg,
)

# More panels than this make no figure.
_MOST = 6


def bias_figure(calibration: Calibration, samples: Samples | None, sensor: int, name: str) -> Drawing | None:
    """The errors of one sensor that change over time, with their 95 % band; None where none does.

    `samples` are those that `register_relative` or `register_online` was given: single differences, which lie under the biases.
    """
    changing = [
        k
        for k, key in enumerate(calibration.terms)
        if key.sensor == sensor and (np.ptp(calibration.value[:, k]) > 0 or np.ptp(calibration.sd[:, k]) > 0)
    ]
    rows = [(BIASES.index(calibration.terms[k].name) if _plain(calibration.terms[k]) else -1, k) for k in changing][:_MOST]
    if not rows or len(calibration.epoch_s) < 2:
        return None
    some = sample(0 if samples is None else len(samples))
    with style(name):
        figure, axes = axes_grid(len(rows), 1, 0.75 + 1.75 * len(rows), gap=(0.3, 0.3), top=0.35, left=0.85)
        dots = False
        for (c, k), (panel,) in zip(rows, axes, strict=True):
            key = calibration.terms[k]
            scale = si_per_unit(key)
            value, sd = calibration.value[:, k] / scale, calibration.sd[:, k] / scale
            panel.fill_between(
                calibration.epoch_s, value - 1.96 * sd, value + 1.96 * sd, color=AFTER, alpha=0.25, linewidth=0, zorder=3
            )
            panel.plot(calibration.epoch_s, value, color=AFTER, zorder=4)
            panel.axhline(0.0, color=INK, linewidth=0.6)
            bulk = np.array([float(np.percentile(v, q)) for v, q in ((value - 2 * sd, 5), (value + 2 * sd, 95))])
            if samples is not None and c >= 0 and np.isfinite(samples.value[:, c]).any():
                dots = True
                points(panel, samples.time_s[some], samples.value[some, c] / scale, TRACK, size=2.2)
                bulk = np.nanpercentile(samples.value[:, c] / scale, (1, 99))
            # Gross errors may lie outside: what matters is the bias and the bulk about it.
            low, high = min(bulk[0], float(value.min()), 0.0), max(bulk[1], float(value.max()), 0.0)
            panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
            panel.set_ylabel(f"{term_label(key.name)} ({'°' if key.unit == 'deg' else key.unit})")
            label = time_axis(panel, calibration.epoch_s)
        axes[-1][0].set_xlabel(label)
        what = "main radar" if calibration.settings.get("kind") == "relative" else "reference"
        entries = [(line(AFTER), "error"), (band(AFTER), "95 %")]
        legend(figure, [*entries, (dot(TRACK), f"single plots against the {what}")] if dots else entries)
        svg = to_svg(figure, name)
    main = calibration.settings.get("main")
    summary = next(s for s in calibration.sensors if s.sensor == sensor)
    return Drawing(
        name,
        svg,
        f"Errors of {summary.name} over time{f', relative to {main}' if main else ''}: each value rests on the plots up to its "
        "time. The band holds what is not known of them (95 %).",
        f"Errors of {summary.name} over time",
    )


def _plain(key: TermKey) -> bool:
    return key.name in BIASES and key.channel == "all"
