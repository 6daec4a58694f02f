"""The figures of how errors are distributed, and their page: histogram with what was fitted, quantiles, likeness in a track."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._types import FloatArray
from ..assessment.distribution import Described, Distribution, distribution_text, shape_words, step_words
from .correlation import write_figures
from .drawing import AFTER, BEFORE, DASHED, INK, QUIET, RULE, Drawing, axes_grid, count_text, legend, line, points, style, to_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BARS = 60


def write_distribution(described: Sequence[Described], path: str | Path) -> Path:
    """Write how errors are distributed as one self-contained HTML page; beside, then renamed.  Raises InputError."""
    after = "after correction" if described[0].corrected else "as recorded"
    table = [("sensor", "channel", "error", "plots", "targets", "worth", "mean", "sd", "shape", "steps")]
    for d in described:
        if d.found is None:
            table.append(
                (d.sensor, d.channel, d.component, count_text(len(d.values)), count_text(d.targets), "–", "–", "–", d.why, "–")
            )
            continue
        f, digits = d.found, 2 if d.unit == "m" else 4
        step = step_words(f.step, d.unit).replace(" deg", "°") if f.step > 0 else "none found"
        mean, sd = (
            f"{value:.{digits}f} {d.unit}".replace(" deg", "°").replace("-", "−").replace(" ", "\u00a0")
            for value in (f.mean, f.sd)
        )
        worth = f"{count_text(round(f.memory.effective))}\u00a0/\u00a0{count_text(round(f.memory.effective_shape))}"
        table.append(
            (d.sensor, d.channel, d.component, count_text(f.count), count_text(d.targets), worth, mean, sd, shape_words(f), step)
        )
    words = (
        "Errors are measured − reference. Plots of one target are alike, and worth fewer independent ones than there are: "
        "“worth” tells for how many they count in the mean, and in the shape (its tests and criteria). Steps are those of the "
        "measured values, not of the errors.",
    )
    figures = [distribution_figure(d, f"errors-{k}") for k, d in enumerate(described, 1) if d.found is not None]
    return write_figures(
        f"How the errors are distributed, {after}", figures, distribution_text(described), path, table=table, words=words
    )


def distribution_figure(d: Described, name: str) -> Drawing:
    """One component: the histogram with normal, Student t and mixture over it (paper 001, figure 1), quantiles against the
    normal's, and how alike plots of one target are by the time between them."""
    f = d.found
    assert f is not None
    with style(name):
        figure, ((left, middle, right),) = axes_grid(1, 3, 3.1, top=0.6, gap=(0.62, 0))
        outside = _histogram(left, d, f)
        _quantiles(middle, d, f)
        _likeness(right, f)
        left.set_title("Distribution")
        middle.set_title("Quantiles against the normal's")
        right.set_title("Likeness within a target")
        entries = [(line(QUIET), "normal"), (line(BEFORE, style=DASHED), "Student t")]
        if len(f.mixture.share) > 1:
            entries.append((line(AFTER), f"mixture of {len(f.mixture.share)}"))
        legend(figure, entries)
        svg = to_svg(figure, name)
    away = f" {count_text(outside)} lie outside the histogram." if outside else ""
    caption = (
        f"{d.name}, {'corrected' if d.corrected else 'as recorded'}: {shape_words(f)}. "
        f"{count_text(f.count)} plots of {count_text(d.targets)} targets, worth {count_text(round(f.memory.effective))} "
        f"independent ones for the mean and {count_text(round(f.memory.effective_shape))} for the shape.{away}"
    )
    return Drawing(name, svg, caption, f"Histogram, quantiles and correlation of errors: {d.name}")


def _histogram(axes: Axes, d: Described, f: Distribution) -> int:
    """Bars, and what was fitted; returns how many values lie outside."""
    x = d.values
    middle = float(np.median(x))
    # All but the far tails: a few gross errors must not press the rest into one bar.
    half = max(float(np.percentile(np.abs(x - middle), 99.7)), 4 * f.robust_sd) * 1.08 or max(abs(middle), 1.0) * 0.01
    low, high = middle - half, middle + half
    bars = int(np.clip(np.sqrt(len(x)), 8, _BARS))
    edges = np.linspace(low, high, bars + 1)
    count = np.histogram(x, edges)[0]
    axes.stairs(count / len(x) / (edges[1] - edges[0]), edges, fill=True, color=RULE)
    axes.set_xlim(low, high)
    axes.set_xlabel(f"{d.component} error ({_unit(d)})")
    axes.set_ylabel(f"density (1/{_unit(d)})")
    if f.sd > 0:
        from scipy import stats

        grid = np.linspace(low, high, 400)
        t = f.student
        axes.plot(grid, stats.norm.pdf(grid, f.mean, f.sd), color=QUIET, linewidth=1.4)
        axes.plot(grid, stats.t.pdf(grid, t.freedom, t.location, t.scale), color=BEFORE, linewidth=1.4, linestyle=DASHED)
        if len(f.mixture.share) > 1:
            axes.plot(grid, f.mixture.density(grid), color=AFTER, linewidth=1.4)
    return int(((x < low) | (x > high)).sum())


def _quantiles(axes: Axes, d: Described, f: Distribution) -> None:
    """Errors in order against a normal's quantiles, and the line of the normal that was fitted."""
    from scipy.special import ndtri

    n = len(d.values)
    shares = (np.arange(n) + 0.5) / n
    ordered = np.sort(d.values)
    some: FloatArray = np.unique(np.r_[np.arange(min(100, n)), np.linspace(0, n - 1, min(n, 600)), np.arange(max(n - 100, 0), n)])
    rows = some.astype(np.int64)
    z = ndtri(shares[rows])
    ends = np.array([z[0], z[-1]])
    axes.plot(ends, f.mean + f.sd * ends, color=QUIET, linewidth=1.4)
    if f.sd > 0:
        from scipy import stats

        t = f.student
        axes.plot(z, stats.t.ppf(shares[rows], t.freedom, t.location, t.scale), color=BEFORE, linewidth=1.2, linestyle=DASHED)
        if len(f.mixture.share) > 1:
            axes.plot(z, _mixture_quantiles(f, shares[rows]), color=AFTER, linewidth=1.2)
    points(axes, z, ordered[rows], INK, size=2.6)
    span = float(ordered[-1] - ordered[0]) or 1.0
    axes.set_ylim(ordered[0] - 0.05 * span, ordered[-1] + 0.05 * span)
    axes.set_xlabel("standard deviations of a normal")
    axes.set_ylabel(f"{d.component} error ({_unit(d)})")


def _mixture_quantiles(f: Distribution, shares: FloatArray) -> FloatArray:
    """The values below which so large shares of the mixture lie."""
    from scipy.special import ndtr

    m = f.mixture
    mean, sd = np.array(m.mean), np.array(m.sd)
    grid = np.unique(np.concatenate([b + c * np.linspace(-8, 8, 801) for b, c in zip(mean, sd, strict=True)]))
    below = (ndtr((grid[:, None] - mean) / sd) * np.array(m.share)).sum(axis=1)
    return np.asarray(np.interp(shares, below, grid))


def _likeness(axes: Axes, f: Distribution) -> None:
    """Correlation of two plots of one target by the time between them."""
    axes.axhline(0, color=INK, linewidth=0.7)
    axes.set_ylim(-0.3, 1.05)
    axes.set_ylabel("correlation")
    axes.set_xlabel("time between plots (s)")
    if not f.memory.lag:
        axes.text(
            0.5, 0.5, "one plot a target" if f.sd > 0 else "no variation", ha="center", color=QUIET, transform=axes.transAxes
        )
        return
    # Of the longest lags a few pairs tell, and nothing is to be seen but chance.
    told = np.array(f.memory.pairs) >= min(0.05 * f.count, max(f.memory.pairs))
    lag_s, correlation = np.array(f.memory.lag_s)[told], np.array(f.memory.correlation)[told]
    axes.plot(np.r_[0, lag_s], np.r_[1, correlation], color=AFTER, linewidth=1.3, marker="o", markersize=2.2)
    # The first lags and the longest do not stand on one even scale.
    if lag_s[-1] > 20 * max(lag_s[0], 1e-9):
        axes.set_xscale("symlog", linthresh=float(lag_s[0]) * 4)
        axes.set_xlim(0, lag_s[-1])
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _unit(d: Described) -> str:
    return "°" if d.unit == "deg" else d.unit
