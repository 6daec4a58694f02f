"""A radar's biases as functions of time: samples, estimate and its band."""

from __future__ import annotations

import numpy as np

from ..calibration import Calibration, si_per_unit
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


def bias_figure(calibration: Calibration, samples: Samples, sensor: int, name: str) -> Drawing | None:
    """The biases of one sensor over time with their 95 % band, over the samples they come from; None without a bias over time.

    `samples` are those that `register_relative` or `register_online` was given.
    """
    found = [(c, calibration.index(sensor, term)) for c, term in enumerate(BIASES)]
    rows = [(c, k) for c, k in found if k is not None]
    if not rows or len(calibration.epoch_s) < 2:
        return None
    some = sample(len(samples))
    with style(name):
        figure, axes = axes_grid(len(rows), 1, 0.75 + 1.75 * len(rows), gap=(0.3, 0.3), top=0.35, left=0.85)
        for (c, k), (panel,) in zip(rows, axes, strict=True):
            key = calibration.terms[k]
            scale = si_per_unit(key)
            value, sd = calibration.value[:, k] / scale, calibration.sd[:, k] / scale
            points(panel, samples.time_s[some], samples.value[some, c] / scale, TRACK, size=2.2)
            panel.fill_between(
                calibration.epoch_s, value - 1.96 * sd, value + 1.96 * sd, color=AFTER, alpha=0.25, linewidth=0, zorder=3
            )
            panel.plot(calibration.epoch_s, value, color=AFTER, zorder=4)
            panel.axhline(0.0, color=INK, linewidth=0.6)
            # Gross errors may lie outside: what matters is the bias and the bulk about it.
            bulk = np.nanpercentile(samples.value[:, c] / scale, (1, 99))
            low, high = min(bulk[0], float(value.min()), 0.0), max(bulk[1], float(value.max()), 0.0)
            panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
            panel.set_ylabel(f"{term_label(key.name)} ({'°' if key.unit == 'deg' else key.unit})")
            label = time_axis(panel, calibration.epoch_s)
        axes[-1][0].set_xlabel(label)
        what = "main radar" if calibration.settings.get("kind") == "relative" else "reference"
        entries = [(line(AFTER), "bias"), (band(AFTER), "95 %"), (dot(TRACK), f"single plots against the {what}")]
        legend(figure, entries)
        svg = to_svg(figure, name)
    summary = next(s for s in calibration.sensors if s.sensor == sensor)
    return Drawing(
        name,
        svg,
        f"Biases of {summary.name} {summary.model}: each value rests on the plots up to its time.",
        f"Biases of {summary.name} over time",
    )
