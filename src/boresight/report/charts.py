"""The figures that stand beside the residuals: the chart of a trial, the budget, the choice of the model, the clocks and chains.

Every function draws one figure and returns a `Drawing`, or None where there is nothing to draw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._types import FloatArray
from .drawing import (
    AFTER,
    AFTER_LIGHT,
    BEFORE,
    BEFORE_LIGHT,
    DASHED,
    DEG,
    INK,
    MAX_POINTS,
    QUIET,
    RULE,
    WIDTH_IN,
    Drawing,
    axes_grid,
    binned,
    count_text,
    degree_text,
    degree_ticks,
    dot,
    edges_of,
    legend,
    length_text,
    limits_of,
    line,
    points,
    round_number,
    sample,
    style,
    term_label,
    time_axis,
    to_svg,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..assessment.psr_ssr import PsrSsr
    from ..assessment.residuals import Residuals
    from ..calibration import Choice, Share, Verdict
    from ..heights import HeightProfile
    from ..model import Platform, Plots, Sensor
    from .evidence import Clock

# Four series that stay apart for every kind of colour blindness, and their markers, for greys.
_SERIES = (("#0a4480", "o"), ("#d1761b", "s"), ("#2a8a6f", "^"), ("#8a5aa5", "D"))


# ------------------------------------------------------------------------------------------------------------------ charts


def own_places(r: Residuals, platform: Platform, sensor: Sensor) -> tuple[FloatArray, FloatArray] | None:
    """Where the reference truly was at each plot of a moving radar: latitude and longitude (n,), rad; None where nothing tells.

    The residuals of a moving radar are about one fixed point; what they hold relative to it is put back about the platform.
    """
    from msgspec import structs

    from ..geodesy import geodetic_from_ecef, rotate_back
    from ..platform import view_of

    own = platform[platform.sensor == sensor.key]
    if not (np.isfinite(own.latitude_rad) & np.isfinite(own.longitude_rad)).any():
        return None
    # At own ship's height: what is drawn lies near the sea.
    origin, axes = view_of(own, structs.replace(sensor, height_m=None, height_msl_m=None))[0].pose(r.time_s)
    flat = r.reference_range_m * np.cos(r.reference_elevation_rad)
    up = r.reference_range_m * np.sin(r.reference_elevation_rad)
    seen = np.stack([flat * np.sin(r.reference_azimuth_rad), flat * np.cos(r.reference_azimuth_rad), up], axis=1)
    latitude, longitude, _ = geodetic_from_ecef(origin + rotate_back(axes, seen))
    return latitude, longitude


def trial_figure(
    r: Residuals, name: str, platform: Platform, sensor: Sensor, targets: Mapping[int, str] | None = None
) -> Drawing | None:
    """A chart of a moving radar's trial: own ship's path, the targets, the plots before and after, on a grid of degrees."""
    found = own_places(r, platform, sensor)
    if found is None or not np.isfinite(found[0]).any():
        return None
    lat, lon = found
    own = platform[(platform.sensor == sensor.key) & np.isfinite(platform.latitude_rad) & np.isfinite(platform.longitude_rad)]
    # Only the stretches of the path in which plots were paired.
    inside = np.zeros(len(own), np.bool_)
    stamps = np.sort(r.time_s[np.isfinite(lat)])
    nearest = np.clip(np.searchsorted(stamps, own.time_s), 1, max(len(stamps) - 1, 1))
    gap = np.minimum(np.abs(own.time_s - stamps[nearest - 1]), np.abs(own.time_s - stamps[np.minimum(nearest, len(stamps) - 1)]))
    inside |= gap <= 30.0
    own = own[inside]
    own = own.take(np.argsort(own.time_s, kind="stable"))
    own = own[:: max(1, len(own) // 4000)]
    middle = float(np.nanmedian(lat))
    north_m, east_m = 6_367_000.0, 6_378_000.0 * float(np.cos(middle))
    plots = []
    for east, north in ((r.east_before_m, r.north_before_m), (r.east_after_m, r.north_after_m)):
        plots.append((lon + east / east_m, lat + north / north_m))
    everything_lat = np.concatenate([lat[np.isfinite(lat)], own.latitude_rad])
    everything_lon = np.concatenate([lon[np.isfinite(lon)], own.longitude_rad])
    low = np.array([everything_lon.min() * east_m, everything_lat.min() * north_m])
    high = np.array([everything_lon.max() * east_m, everything_lat.max() * north_m])
    size = float(max(*(high - low), 50.0))
    centre = (low + high) / 2
    extent = np.maximum(high - low, 0.4 * size) + 0.14 * size
    per_in = extent[0] / ((WIDTH_IN - 0.95 - 0.12 - 0.3) / 2)
    height = float(np.clip(extent[1] / per_in, 2.4, 6.6))
    extent[0] = max(extent[0], extent[0] * extent[1] / per_in / height)
    low, high = centre - extent / 2, centre + extent / 2
    lon_lim, lat_lim = (low[0] / east_m, high[0] / east_m), (low[1] / north_m, high[1] / north_m)
    aspect = north_m / east_m
    with style(name):
        figure, (row,) = axes_grid(1, 2, height + 0.9, left=0.95, gap=(0.3, 0), top=0.55, bottom=0.35)
        order = np.lexsort((r.time_s, r.track, r.target))
        new = np.r_[False, (np.diff(r.target[order]) != 0) | (np.diff(r.track[order]) != 0) | (np.diff(r.time_s[order]) > 20.0)]
        cut = np.flatnonzero(new)
        path = np.insert(lon[order], cut, np.nan), np.insert(lat[order], cut, np.nan)
        breaks = np.flatnonzero(np.diff(own.time_s) > 10.0) + 1
        ship = np.insert(own.longitude_rad, breaks, np.nan), np.insert(own.latitude_rad, breaks, np.nan)
        starts = np.r_[0, breaks] if len(own) else np.zeros(0, np.int64)
        for k, (axes, title, dark, marker) in enumerate(
            zip(row, ("Plots before correction", "Plots after correction"), (BEFORE, AFTER), "os", strict=True)
        ):
            axes.plot(*path, color="#8b949c", linewidth=1.4, zorder=2)
            axes.plot(*ship, color=INK, linewidth=1.1, linestyle=DASHED, zorder=2)
            axes.plot(
                own.longitude_rad[starts], own.latitude_rad[starts], marker="^", linestyle="none", color=INK, markersize=5,
                markeredgecolor="white", markeredgewidth=0.6, zorder=5,
            )  # fmt: skip
            some = sample(len(r))
            axes.plot(
                plots[k][0][some], plots[k][1][some], linestyle="none", marker=marker, markersize=2.4, color=dark,
                markeredgewidth=0, alpha=0.75, rasterized=len(some) > 800, zorder=3,
            )  # fmt: skip
            axes.set_title(title, color=dark)
            axes.set_xlim(*lon_lim)
            axes.set_ylim(*lat_lim)
            axes.set_aspect(aspect, adjustable="box")
            for axis, span, words in ((axes.xaxis, lon_lim, "EW"), (axes.yaxis, lat_lim, "NS")):
                ticks, step = degree_ticks(*span, 4 if words == "EW" else 7)
                axis.set_ticks(ticks.tolist(), [degree_text(float(t), step, words) for t in ticks])
            if k:
                axes.tick_params(labelleft=False)
            _scale_bar(axes, float(extent[0]), lon_lim, lat_lim)
            _north_arrow(axes)
        named = _few_labels(r, lat, lon, targets)
        for text, x, y in named:
            row[0].annotate(
                text, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=6.5, color=INK, zorder=6,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            )  # fmt: skip
        start = dot(INK, "^")
        start.set_markersize(6)
        legend(
            figure,
            [
                (start, "start of own ship"), (line(INK, 1.2, DASHED), "own ship's path"),
                (line("#8b949c", 1.4), "reference targets"),
                (dot(BEFORE), "plots before"), (dot(AFTER, "s"), "plots after"),
            ],
        )  # fmt: skip
        svg = to_svg(figure, name)
    caption = (
        "The trial on latitude and longitude (WGS 84), north up: where own ship went, the targets by the reference, and the "
        "radar's "
        "plots put on the chart from own ship's position and the measured range and azimuth, raw (left) and corrected (right). "
        f"{count_text(int(np.isfinite(lat).sum()))} plots."
    )
    return Drawing(name, svg, caption, "Chart of the trial: own ship, targets, and plots before and after correction")


def _few_labels(
    r: Residuals, lat: FloatArray, lon: FloatArray, targets: Mapping[int, str] | None
) -> list[tuple[str, float, float]]:
    """Names of the targets where their tracks begin; none where they are too many to be read."""
    numbers = np.unique(r.target[np.isfinite(lat)])
    if len(numbers) > 6:
        return []
    out = []
    for number in numbers.tolist():
        mine = np.flatnonzero((r.target == number) & np.isfinite(lat))
        first = mine[np.argmin(r.time_s[mine])]
        out.append(((targets or {}).get(number, str(number)), float(lon[first]), float(lat[first])))
    return out


def _scale_bar(axes: Axes, width_m: float, lon_lim: tuple[float, float], lat_lim: tuple[float, float]) -> None:
    """A bar of a round length in the lower left corner."""
    long = round_number(width_m / 5)
    share = long / width_m
    axes.plot(
        [0.04, 0.04 + share], [0.045, 0.045], color=INK, linewidth=2.2, solid_capstyle="butt", transform=axes.transAxes, zorder=6
    )
    axes.text(
        0.04 + share / 2, 0.06, length_text(long), transform=axes.transAxes, ha="center", va="bottom", fontsize=7.5, zorder=6
    )


def _north_arrow(axes: Axes) -> None:
    axes.annotate(
        "N", (0.955, 0.97), (0.955, 0.87), xycoords="axes fraction", textcoords="axes fraction", ha="center", va="center",
        fontsize=8, fontweight="bold", color=INK,
        arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "shrinkA": 2, "shrinkB": 0},
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------------- model and decisions


_CAUSES = {
    "bias": "systematic errors",
    "noise": "random error of a plot",
    "reference": "the reference's own error",
    "timing": "late or early stamps",
    "height": "unknown heights",
}


def budget_figure(
    budget: Sequence[Share],
    left: Mapping[str, tuple[float, float]],
    seen: tuple[tuple[float, float], tuple[float, float]],
    name: str,
) -> Drawing | None:
    """Where a plot's error comes from, in range and across it, before and after correction (rms, metres).

    `left` is what correction leaves of a cause (its uncertainty) in range and across (m, NaN: not known); `seen` are the rms
    of the residuals before and after, each in range and across.
    """
    shares = [b for b in budget if np.isfinite(b.range_m) or np.isfinite(b.cross_m)]
    if not shares:
        return None
    causes = [b.cause for b in shares]
    before = np.array([[b.range_m, b.cross_m] for b in shares], np.float64)
    after = before.copy()
    for k, cause in enumerate(causes):
        if cause in left:
            after[k] = left[cause]
    rows = len(causes) + 2
    with style(name):
        figure, (row,) = axes_grid(1, 2, 0.95 + 0.36 * rows, left=1.9, gap=(0.35, 0), top=0.52, bottom=0.42)
        at = np.r_[np.arange(len(causes)), len(causes) + 0.35, len(causes) + 1.35]
        for k, (axes, title) in enumerate(zip(row, ("In range", "Across the range"), strict=True)):
            total = [float(np.sqrt(np.nansum(v[:, k] ** 2))) for v in (before, after)]
            low = np.r_[before[:, k], total[0], seen[0][k]]
            high = np.r_[after[:, k], total[1], seen[1][k]]
            for values, shift, dark, light, hatch in ((low, -0.18, BEFORE, BEFORE_LIGHT, "////"), (high, 0.18, AFTER, AFTER, "")):
                axes.barh(
                    at + shift,
                    np.nan_to_num(values),
                    height=0.32,
                    color=light,
                    edgecolor=dark,
                    linewidth=0.6,
                    hatch=hatch,
                    zorder=2,
                )
            top = float(np.nanmax(np.r_[low, high])) or 1.0
            for values, shift, dark in ((low, -0.18, BEFORE), (high, 0.18, AFTER)):
                for y, value in zip(at + shift, values, strict=True):
                    known = np.isfinite(value)
                    axes.text((value if known else 0) + 0.012 * top, y, _metres(value) if known else "not known", va="center",
                              fontsize=6.8, color=dark if known else QUIET)  # fmt: skip
            axes.axhline(len(causes) - 0.33, color=RULE, linewidth=0.8)
            axes.set_xlim(0, 1.16 * top)
            axes.set_ylim(at[-1] + 0.55, -0.55)
            axes.set_title(title)
            axes.set_xlabel("root mean square (m)")
            axes.grid(False, axis="y")
            axes.tick_params(axis="y", length=0)
            axes.set_yticks(
                at, [*(_CAUSES.get(c, c) for c in causes), "sum of these", "seen in the residuals"] if not k else [""] * rows
            )
        legend(figure, [(_box(BEFORE, BEFORE_LIGHT, "////"), "before correction"), (_box(AFTER, AFTER, ""), "after correction")])
        svg = to_svg(figure, name)
    caption = (
        "The error budget: by how much each cause moves a plot, as root mean square in range and across it. Correction takes "
        "away the "
        "systematic errors up to its own uncertainty and nothing else; what is left is for the radar's maker, the reference or "
        "the "
        "clocks. The sum is root of the squares; where the residuals are clearly larger than it, a cause is missing."
    )
    return Drawing(name, svg, caption, "Bars of the error budget in range and across the range, before and after correction")


def _metres(value: float) -> str:
    return f"{value:.0f} m" if value >= 99.5 else f"{value:.1f} m" if value >= 0.95 else f"{value:.2f} m"


def _box(edge: str, face: str, hatch: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=face, edgecolor=edge, hatch=hatch, linewidth=0.6)


def choice_figure(choices: Sequence[Choice], criterion: str, name: str) -> Drawing | None:
    """The way to the model: by how much each step changed the criterion, with twice its standard error."""
    numbered = [(k, c) for k, c in enumerate(choices, 1) if np.isfinite(c.change)]
    steps = [c for _, c in numbered]
    if not steps:
        return None
    change = np.array([c.change for c in steps])
    sd = np.array([c.change_sd if np.isfinite(c.change_sd) else 0.0 for c in steps])
    at = np.arange(len(steps), dtype=np.float64)
    with style(name):
        figure, ((axes,),) = axes_grid(1, 1, 0.75 + 0.24 * len(steps), left=3.1, right=1.2, top=0.2, bottom=0.45)
        axes.axvline(0, color=INK, linewidth=0.7)
        axes.errorbar(
            change, at, xerr=2 * sd, linestyle="none", marker="o", markersize=4.5, color=AFTER, elinewidth=1.2, capsize=2.5
        )
        axes.set_yticks(at, [f"{k}. {c.action} {term_label(c.term)}" for k, c in numbered])
        axes.set_ylim(len(steps) - 0.4, -0.6)
        axes.set_xlim(*limits_of(change - 2 * sd, change + 2 * sd))
        axes.set_xlabel(f"change of the criterion ({criterion}; negative: better)" if criterion else "change of the criterion")
        axes.grid(False, axis="y")
        svg = to_svg(figure, name)
    caption = (
        f"The search for the model, step by step: the change of the criterion{f' ({criterion})' if criterion else ''} by each "
        "step, "
        "with twice its standard error over targets. A step whose bar reaches over zero did not clearly improve the model."
    )
    return Drawing(name, svg, caption, "Changes of the criterion by each step of the model search")


def gain_figure(verdicts: Sequence[Verdict], name: str) -> Drawing | None:
    """By how much each term lowers the error of targets that were held out, with its interval, by what to do with it."""
    shown = [v for v in verdicts if np.isfinite(v.gain_m)]
    if not shown:
        return None
    looks = {"apply": (AFTER, "s", "apply"), "hold": (QUIET, "o", "hold"), "insufficient": (BEFORE, "D", "insufficient data")}
    with style(name):
        figure, ((axes,),) = axes_grid(1, 1, 0.85 + 0.26 * len(shown), left=2.4, right=1.2, top=0.4, bottom=0.45)
        axes.axvline(0, color=INK, linewidth=0.7)
        ends = []
        for k, v in enumerate(shown):
            colour, marker, _ = looks[v.decision]
            low, high = (v.gain_low_m, v.gain_high_m) if np.isfinite(v.gain_low_m + v.gain_high_m) else (v.gain_m, v.gain_m)
            ends += [low, high, v.gain_m]
            axes.plot([low, high], [k, k], color=colour, linewidth=1.3)
            axes.plot([v.gain_m], [k], marker=marker, color=colour, markersize=5, linestyle="none")
        axes.set_yticks(
            range(len(shown)), [term_label(v.term) + ("" if v.channel == "all" else f" ({term_label(v.channel)})") for v in shown]
        )
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_xlim(*limits_of(np.array(ends)))
        axes.set_xlabel("gain on held-out targets (m, root mean square; positive: better with the term)")
        axes.grid(False, axis="y")
        there = list(dict.fromkeys(v.decision for v in shown))
        legend(figure, [(dot(looks[d][0], looks[d][1]), looks[d][2]) for d in there])
        svg = to_svg(figure, name)
    caption = (
        "What each term is worth: by how much it lowers the root mean square error of targets that took no part in the "
        "estimate, with "
        "its 95 % interval. A term is applied where the whole interval lies to the right of zero."
    )
    return Drawing(name, svg, caption, "Gain of each term on held-out targets with intervals")


# -------------------------------------------------------------------------------------------------------- chains and clocks


def psr_ssr_figure(plots: Plots, table: PsrSsr, sensor: int, name: str) -> Drawing | None:
    """PSR - SSR of one radar: range difference over range and azimuth difference over azimuth, by channel, with the fitted lines.

    `plots` may be a choice of the radar's plots; the lines are of `table`, which was made from all.
    """
    from ..assessment.psr_ssr import ALL, CUT, channel_name
    from ..model import EXCLUDED

    rows = [k for k in range(len(table)) if table.sensor[k] == sensor]
    use = (plots.sensor == sensor) & np.isfinite(plots.psr_ssr_range_m) & (plots.flags & int(EXCLUDED) == 0)
    if not rows or not use.any():
        return None
    channels = [k for k in rows if table.channel[k] != ALL][: len(_SERIES)]
    with style(name):
        figure, (row,) = axes_grid(1, 2, 3.5, top=0.5, bottom=0.48, gap=(0.7, 0))
        entries, ends, turns = [], [], []
        for k, (colour, marker) in zip(channels, _SERIES, strict=False):
            mine = np.flatnonzero(use & (plots.channel == table.channel[k]))
            if not len(mine):
                continue
            far, gap = plots.range_m[mine] / 1e3, plots.psr_ssr_range_m[mine]
            angle, turn = plots.azimuth_rad[mine] / DEG % 360, plots.psr_ssr_azimuth_rad[mine] / DEG
            within = np.abs(gap - table.range_median_m[k]) <= CUT * table.range_sd_m[k] if table.plots[k] > 1 else gap == gap
            some = mine[within][sample(int(within.sum()), MAX_POINTS // len(channels))]
            points(row[0], plots.range_m[some] / 1e3, plots.psr_ssr_range_m[some], colour, size=1.7)
            points(row[1], plots.azimuth_rad[some] / DEG % 360, plots.psr_ssr_azimuth_rad[some] / DEG, colour, size=1.7)
            for axes, x, y, edges in (
                (row[0], far, gap, edges_of(far[within], 16)),
                (row[1], angle, turn, np.arange(0.0, 361.0, 20.0 if within.sum() > 1000 else 45.0)),
            ):
                b = binned(x[within], y[within], edges)
                axes.plot(
                    b.centre, b.median, color=colour, marker=marker, markersize=3.4, linewidth=1.2, markeredgecolor="white",
                    markeredgewidth=0.4, zorder=4,
                )  # fmt: skip
            if np.isfinite(table.slope[k]):
                reach = np.array([far[within].min(), far[within].max()])
                middle = far[within].mean()
                row[0].plot(
                    reach, table.range_m[k] + table.slope[k] * 1e3 * (reach - middle), color=colour, linestyle=DASHED, zorder=5
                )
            ends.append(gap[within])
            turns.append(turn[within])
            entries.append((dot(colour, marker), channel_name(int(table.channel[k]))))
        if not entries:
            return None
        for axes, values, label, against in (
            (row[0], ends, "PSR − SSR range (m)", "range (km)"), (row[1], turns, "PSR − SSR azimuth (°)", "azimuth (°)"),
        ):  # fmt: skip
            axes.axhline(0, color=INK, linewidth=0.7)
            axes.set_ylim(*limits_of(*values))
            axes.set_ylabel(label)
            axes.set_xlabel(against)
        row[0].set_xlim(left=0)
        row[1].set_xlim(0, 360)
        row[1].set_xticks(np.arange(0, 361, 45))
        legend(
            figure, [*entries, (line(QUIET, 1.4, DASHED), "line over range"), (dot(QUIET), "plots; with lines: medians of bins")]
        )
        svg = to_svg(figure, name)
    caption = (
        "The radar's two chains compared with each other, without any reference: where the primary radar saw a target, less "
        "where the "
        "secondary did, over range and azimuth by channel. An offset is a difference of delays, a slope one of range gains; what "
        "corrects one chain alone must bring it to zero."
    )
    return Drawing(name, svg, caption, "Range and azimuth difference of primary and secondary radar")


def clock_figure(clock: Clock, name: str) -> Drawing | None:
    """One radar's stamps: against the even turn of its antenna over time and by azimuth, and reception against the stamps."""
    turning, reception = clock.turning, clock.reception
    shown = [k for k, there in enumerate((len(turning.time_s) > 0, len(turning.time_s) > 0, len(reception[0]) > 0)) if there]
    if not shown:
        return None
    with style(name):
        figure, (row,) = axes_grid(1, len(shown), 2.75, top=0.42, bottom=0.48, gap=(0.6, 0))
        for axes, kind in zip(row, shown, strict=True):
            if kind == 0:
                points(axes, turning.time_s, 1e3 * turning.late_s, AFTER_LIGHT, size=1.6)
                axes.plot(turning.time_s, 1e3 * turning.slow_s, color=BEFORE, linewidth=1.4, zorder=4)
                axes.set_xlabel(time_axis(axes, turning.time_s))
                axes.set_ylabel("stamp − even turning (ms)")
                axes.set_ylim(*_around(1e3 * turning.late_s))
            elif kind == 1:
                fast = 1e3 * (turning.late_s - turning.slow_s)
                angle = turning.turn % 1 * 360
                points(axes, angle, fast, AFTER_LIGHT, size=1.6)
                b = binned(angle, fast, np.arange(0.0, 361.0, 15.0))
                axes.plot(b.centre, b.median, color=AFTER, marker="o", markersize=2.6, linewidth=1.3, zorder=4)
                axes.set_xlim(0, 360)
                axes.set_xticks(np.arange(0, 361, 90))
                axes.set_xlabel("part of the turn (°)")
                axes.set_ylabel("without the slow part (ms)")
                axes.set_ylim(*_around(fast))
            else:
                points(axes, reception[0], reception[1], AFTER_LIGHT, size=1.6)
                axes.set_xlabel(time_axis(axes, reception[0]))
                axes.set_ylabel("reception − stamp (s)")
                axes.set_ylim(*_around(reception[1]))
            axes.axhline(0, color=INK, linewidth=0.7)
        legend(
            figure, [(dot(AFTER_LIGHT), "stamps"), (line(BEFORE, 1.4), "slow wander"), (line(AFTER, 1.4), "median by azimuth")]
        )
        svg = to_svg(figure, name)
    caption = (
        "How evenly the stamps follow the antenna's turn: a slope or wave over time is the motor or the clock, a wave over the "
        "turn "
        "an uneven motor or encoder, steps a stamping by sector. A constant offset cannot be seen here; only the reference "
        "shows it."
    )
    return Drawing(name, svg, caption, "Stamps against the even turn of the antenna")


def _around(values: FloatArray) -> tuple[float, float]:
    low, high = limits_of(values)
    return (low, high) if high - low > 1e-6 else (low - 1.0, high + 1.0)


def height_figure(profile: HeightProfile, name: str) -> Drawing | None:
    """Geometric minus pressure height by level, hour by hour, with its sd, and how many targets told it."""
    hours = np.unique(profile.hour).tolist()
    told = np.array([profile.n[profile.hour == hour].sum() for hour in hours])
    if not len(profile) or not told.sum():
        return None
    # Four hours are as many as can be told apart: those that begin, end and stand between.
    chosen = np.linspace(0, len(hours) - 1, min(len(hours), len(_SERIES))).round().astype(int)
    hours = [hours[k] for k in chosen.tolist()]
    levels = profile.level_m[profile.n > 0]
    top = float(levels.max()) + 1000.0
    with style(name):
        figure, (row,) = axes_grid(1, 2, 3.8, top=0.45, bottom=0.48, gap=(0.75, 0))
        entries = []
        for hour, (colour, marker) in zip(hours, _SERIES, strict=False):
            mine = np.flatnonzero((profile.hour == hour) & (profile.level_m <= top))
            difference, sd, level = profile.difference_m[mine], profile.sd_m[mine], profile.level_m[mine] / 1e3
            row[0].fill_betweenx(level, difference - sd, difference + sd, color=colour, alpha=0.15, linewidth=0)
            row[0].plot(difference, level, color=colour, marker=marker, markersize=3.6, linewidth=1.3)
            row[1].plot(profile.n[mine], level, color=colour, marker=marker, markersize=3.6, linewidth=1.0)
            entries.append((dot(colour, marker), f"{hour % 24:02d}:00 UTC"))
        row[0].axvline(0, color=INK, linewidth=0.7)
        row[0].set_xlabel("geometric − pressure height (m), ± 1 sd")
        row[0].set_ylabel("pressure height (km)")
        row[1].set_xlabel("targets that tell it")
        row[1].set_xlim(left=0)
        for axes in row:
            axes.set_ylim(min(0.0, float(levels.min()) / 1e3) - 0.2, top / 1e3)
        legend(figure, entries)
        svg = to_svg(figure, name)
    caption = (
        "What pressure altitudes are off by: height above the ellipsoid less pressure altitude by level and hour, as the "
        f"{count_text(profile.targets)} targets tell it that send both. It is added to heights that tell only the pressure; of "
        "one "
        f"target, {profile.spread_m:.0f} m (sd) remain, which are its altimeter's."
    )
    return Drawing(name, svg, caption, "Geometric minus pressure height by level and hour")


# ------------------------------------------------------------------------------------------------------------- comparison


class Forest(NamedTuple):
    """One term in two calibrations: its label, unit, and value and sd of each, in the unit (NaN: not in that one)."""

    label: str
    unit: str
    first: float
    first_sd: float
    second: float
    second_sd: float
    agrees: bool


def forest_figure(rows: Sequence[Forest], names: tuple[str, str], name: str) -> Drawing | None:
    """Every common term in both calibrations with 95 % bars, each about its own middle and in units of its own sd."""
    rows = [r for r in rows if np.isfinite(r.first + r.second)]
    if not rows:
        return None
    with style(name):
        figure, ((axes,),) = axes_grid(1, 1, 0.95 + 0.42 * len(rows), left=2.6, right=2.4, top=0.42, bottom=0.45)
        axes.axvline(0, color=INK, linewidth=0.7)
        for k, r in enumerate(rows):
            unit = max(float(np.hypot(r.first_sd, r.second_sd)), 1e-300)
            middle = (r.first + r.second) / 2
            for value, sd, shift, colour, marker in (
                (r.first, r.first_sd, -0.15, BEFORE, "o"), (r.second, r.second_sd, 0.15, AFTER, "s"),
            ):  # fmt: skip
                at = (value - middle) / unit
                axes.plot([at - 1.96 * sd / unit, at + 1.96 * sd / unit], [k + shift] * 2, color=colour, linewidth=1.4)
                axes.plot([at], [k + shift], marker=marker, color=colour, markersize=4.5, linestyle="none")
            apart = (r.second - r.first) / unit
            places = max(0, min(9, 1 - int(np.floor(np.log10(unit)))))
            text = f"{r.second - r.first:+.{places}f} {r.unit}  ({apart:+.1f} sd)".replace("-", "−")
            axes.text(1.02, k, text, transform=axes.get_yaxis_transform(), va="center", fontsize=7.5,
                      color=INK if r.agrees else BEFORE,
                      fontweight="normal" if r.agrees else "bold")  # fmt: skip
        axes.set_yticks(range(len(rows)), [r.label for r in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        reach = max(3.0, *(abs(v) for v in axes.get_xlim()))
        axes.set_xlim(-reach, reach)
        axes.set_xlabel("from the middle of the two, in sd of their difference")
        axes.grid(False, axis="y")
        axes.text(1.02, 1.02, "difference", transform=axes.transAxes, fontsize=7.5, color=QUIET, va="bottom")
        legend(figure, [(dot(BEFORE), names[0]), (dot(AFTER, "s"), names[1])])
        svg = to_svg(figure, name)
    caption = (
        "Both calibrations side by side: every term's value with its 95 % bar, about the middle of the two and in standard "
        "deviations "
        "of their difference, so that terms of different units can be compared. Terms that differ by more than chance are "
        "printed bold."
    )
    return Drawing(name, svg, caption, "Values of each term in both calibrations")
