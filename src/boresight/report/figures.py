"""The figures of the residuals: what plots are off by, before and after correction, as SVG to stand inside a page.

Every function draws one figure from residuals of one sensor and returns a `Drawing`, or None where there is nothing to draw (no
axis is ever empty).  Medians are computed from all the pairs given (of more than `MAX_PAIRS` a page gives a fixed random choice,
and says so); the points behind them are a fixed random choice of `MAX_POINTS`, drawn as pixels, so that a page stays small.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._types import AnyArray, BoolArray, FloatArray, IntArray
from .drawing import (
    AFTER,
    AFTER_LIGHT,
    BEFORE,
    BEFORE_LIGHT,
    DASHED,
    DEG,
    INK,
    MAX_POINTS,
    MAX_TRACKS,
    QUIET,
    TRACK,
    WIDTH_IN,
    Drawing,
    axes_grid,
    azimuth_edges,
    band,
    binned,
    count_text,
    degree_text,
    degree_ticks,
    dot,
    edges_of,
    group_quantiles,
    legend,
    length_text,
    limits_of,
    line,
    outside_of,
    points,
    robust_sd,
    round_number,
    sample,
    style,
    targets_text,
    term_label,
    time_axis,
    to_svg,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..assessment.residuals import Residuals
    from ..calibration import Calibration
    from ..model import Sensor


class Quantity(NamedTuple):
    """One residual channel before and after correction, in the unit that the axis shows."""

    name: str
    unit: str
    before: FloatArray
    after: FloatArray

    @property
    def label(self) -> str:
        """Axis label: what was measured minus the reference."""
        return f"{self.name} error ({self.unit})"


def quantities(r: Residuals) -> tuple[Quantity, ...]:
    """Range (m), azimuth (degrees) and elevation (degrees): those of them that are known."""
    return _known(
        Quantity("range", "m", r.range_before_m, r.range_after_m),
        Quantity("azimuth", "°", r.azimuth_before_rad / DEG, r.azimuth_after_rad / DEG),
        Quantity("elevation", "°", r.elevation_before_rad / DEG, r.elevation_after_rad / DEG),
    )


def _distance(r: Residuals) -> tuple[Quantity, ...]:
    return _known(Quantity("horizontal", "m", r.distance_before_m, r.distance_after_m))


def _known(*quantity: Quantity) -> tuple[Quantity, ...]:
    return tuple(q for q in quantity if np.isfinite(q.before).any() and np.isfinite(q.after).any())


def _median_error(distance_m: FloatArray) -> str:
    known = distance_m[np.isfinite(distance_m)]
    if not len(known):
        return ""
    middle = float(np.median(known))
    return f": median error {middle:.{0 if middle >= 100 else 1}f} m"


def _sampled(n: int) -> str:
    return (
        f" The points are a random choice of {count_text(MAX_POINTS)} of {count_text(n)} plots; medians use all of these."
        if n > MAX_POINTS
        else ""
    )


# ------------------------------------------------------------------------------------------------------------------- maps


def ground(r: Residuals) -> tuple[FloatArray, FloatArray]:
    """East and north (m) of the reference at each plot's stamp, about the radar, in the plane of its horizon."""
    flat = r.reference_range_m * np.cos(r.reference_elevation_rad)
    return flat * np.sin(r.reference_azimuth_rad), flat * np.cos(r.reference_azimuth_rad)


def _paths(r: Residuals, rows: BoolArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The reference's tracks as one line with gaps (NaN) between tracks and where plots are missing for long."""
    index = np.flatnonzero(rows)
    order = index[np.lexsort((r.time_s[index], r.track[index], r.target[index]))]
    keep = max(1, int(np.ceil(len(order) / 20000)))
    track, target, time = r.track[order], r.target[order], r.time_s[order]
    new = np.r_[False, (np.diff(track) != 0) | (np.diff(target) != 0)]
    steps = np.diff(time, prepend=time[:1] if len(time) else 0.0)
    usual = np.median(steps[~new & (steps > 0)]) if (~new & (steps > 0)).any() else 1.0
    new |= steps > 12 * usual
    number = np.cumsum(new)
    chosen = np.zeros(len(order), np.bool_)
    chosen[::keep] = True
    chosen |= new | np.r_[new[1:], True]
    order, number = order[chosen], number[chosen]
    cut = np.flatnonzero(np.diff(number)) + 1
    return np.insert(x[order], cut, np.nan), np.insert(y[order], cut, np.nan)


def _degrees(axes: Axes, sensor: Sensor, *, right: bool) -> None:
    """Latitude and longitude along the right and the top of a map in km about the sensor."""
    from matplotlib.ticker import FixedFormatter, FixedLocator

    from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate_back

    if sensor.lat_deg is None or sensor.lon_deg is None:
        return
    lat, lon = sensor.lat_deg * DEG, sensor.lon_deg * DEG
    x_lim, y_lim = axes.get_xlim(), axes.get_ylim()
    along = np.linspace(0.0, 1.0, 65)
    across, up = axes.secondary_xaxis("top"), axes.secondary_yaxis("right")
    for axis, x, y, column, words, shown in (
        (across.xaxis, x_lim[0] + along * (x_lim[1] - x_lim[0]), np.full(65, y_lim[1]), 1, "EW", True),
        (up.yaxis, np.full(65, x_lim[1]), y_lim[0] + along * (y_lim[1] - y_lim[0]), 0, "NS", right),
    ):
        edge = np.stack([1e3 * x, 1e3 * y, np.zeros(65)], axis=1)
        degrees = geodetic_from_ecef(ecef_from_geodetic(lat, lon, 0.0) + rotate_back(enu_from_ecef(lat, lon), edge))[column]
        if not (np.diff(degrees) > 0).all():
            continue
        ticks, step = degree_ticks(float(degrees[0]), float(degrees[-1]), 4)
        axis.set_major_locator(FixedLocator(np.interp(ticks, degrees, x if column else y).tolist()))
        axis.set_major_formatter(FixedFormatter([degree_text(float(v), step, words) if shown else "" for v in ticks]))
        axis.set_tick_params(labelsize=6.5, length=3, pad=1.5)
    for side in (across, up):
        for spine in side.spines.values():
            spine.set_visible(False)


def map_figure(r: Residuals, name: str, *, sensor: Sensor | None = None) -> Drawing | None:
    """Reference tracks about the radar, with the typical error of each map cell as a magnified arrow, before and after.

    `sensor` tells where the radar stands, for latitude and longitude along the edges.
    """
    from matplotlib.patches import Rectangle

    x, y = ground(r)
    good = np.isfinite(x) & np.isfinite(r.east_before_m) & np.isfinite(r.east_after_m)
    if not good.any():
        return None
    n = int(good.sum())
    x_lim, y_lim = (np.percentile(v[good], (0.1, 99.9)) for v in (x, y))
    low = np.array([min(x_lim[0], 0.0), min(y_lim[0], 0.0)])
    high = np.array([max(x_lim[1], 0.0), max(y_lim[1], 0.0)])
    size = float(max(*(high - low), 100.0))
    centre = (low + high) / 2
    extent = np.maximum(high - low, 0.45 * size) + 0.16 * size
    low, high = centre - extent / 2, centre + extent / 2

    cells = 24
    cell = size / cells
    column, row = np.floor((x[good] - low[0]) / cell).astype(np.int64), np.floor((y[good] - low[1]) / cell).astype(np.int64)
    least = int(np.clip(n / 1000, 3, 10)) if n > 300 else 1
    _, which, number = np.unique(row * 1000 + column, return_inverse=True, return_counts=True)
    columns = (x, y, r.east_before_m, r.north_before_m, r.east_after_m, r.north_after_m)
    arrow = np.stack([group_quantiles(v[good], which, len(number), (0.5,))[0][0] for v in columns], axis=1)[number >= least]
    if not len(arrow):
        return None
    length = np.hypot(arrow[:, 2], arrow[:, 3])
    typical = max(float(np.percentile(length, 75)), 1e-3)
    magnify = round_number(1.5 * cell / typical)
    if magnify < 2:
        magnify = 1.0

    margin = 0.62 if sensor is not None else 0.12
    per_in = extent[0] / ((WIDTH_IN - 0.72 - margin - 0.62) / 2)
    height = float(np.clip(extent[1] / per_in, 2.2, 6.5))
    if extent[1] / per_in > height:  # tall areas: keep the scale equal on both axes by widening the map
        extent[0] *= extent[1] / per_in / height
        low[0], high[0] = centre[0] - extent[0] / 2, centre[0] + extent[0] / 2
    with style(name):
        figure, ((left, right),) = axes_grid(1, 2, height + 1.1, right=margin, top=0.65, bottom=0.45)
        names, which = np.unique(r.track[good] * 1_000_003 + r.target[good], return_inverse=True)
        drawn = np.zeros(len(r), np.bool_)
        drawn[good] = np.isin(which, sample(len(names), MAX_TRACKS))
        line_x, line_y = _paths(r, drawn, x, y)
        key = round_number(typical)
        for axes, title, colour, east, north in (
            (left, f"Before correction{_median_error(r.distance_before_m)}", BEFORE, arrow[:, 2], arrow[:, 3]),
            (right, f"After correction{_median_error(r.distance_after_m)}", AFTER, arrow[:, 4], arrow[:, 5]),
        ):
            axes.plot(line_x / 1e3, line_y / 1e3, color=TRACK, linewidth=0.6, rasterized=len(line_x) > 1500, zorder=1)
            axes.quiver(
                arrow[:, 0] / 1e3, arrow[:, 1] / 1e3, east / 1e3 * magnify, north / 1e3 * magnify, color=colour, angles="xy",
                scale_units="xy", scale=1.0, width=0.0028, headwidth=3.6, headlength=4.2, headaxislength=3.8, minlength=0.6,
                zorder=3,
            )  # fmt: skip
            axes.plot(
                [0],
                [0],
                marker="^",
                markersize=7,
                color=INK,
                markeredgecolor="white",
                markeredgewidth=0.8,
                zorder=5,
                linestyle="none",
            )
            axes.set_xlim(low[0] / 1e3, high[0] / 1e3)
            axes.set_ylim(low[1] / 1e3, high[1] / 1e3)
            axes.set_aspect("equal", adjustable="box")
            axes.set_title(title, color=colour, pad=14.0 if sensor is not None else None)
            axes.set_xlabel("east of the radar (km)")
            end = (low[0] + 0.04 * extent[0]) / 1e3, (high[1] - 0.05 * extent[1]) / 1e3
            long = key * magnify / 1e3
            axes.add_patch(
                Rectangle(
                    (end[0] - 0.02 * extent[0] / 1e3, end[1] - 0.035 * extent[1] / 1e3), max(long, 0.0) + 0.2 * extent[0] / 1e3,
                    0.07 * extent[1] / 1e3, facecolor="white", edgecolor="none", alpha=0.85, zorder=3.5,
                )
            )  # fmt: skip
            axes.plot([end[0], end[0] + long], [end[1], end[1]], color=INK, linewidth=1.6, solid_capstyle="butt", zorder=4)
            axes.text(end[0] + long + 0.012 * extent[0] / 1e3, end[1], f"error of {key:g} m", va="center", fontsize=7.5, zorder=4)
            if sensor is not None:
                _degrees(axes, sensor, right=axes is right)
        left.set_ylabel("north of the radar (km)")
        marker = dot(INK)
        marker.set_marker("^")
        marker.set_markersize(6)
        legend(
            figure,
            [
                (marker, "radar"),
                (line(TRACK, 1.2), "reference tracks"),
                (line(BEFORE, 2.0), "typical error before"),
                (line(AFTER, 2.0), "typical error after"),
            ],
        )
        svg = to_svg(figure, name)
    few = f"cells with fewer than {least} plots have none. " if least > 1 else ""
    scale = f"lengthened {magnify:g} times" if magnify > 1 else "at the map's scale"
    caption = (
        f"Where the plots lie against the reference. Each arrow leads from the reference to the median position "
        "of the radar's plots in "
        f"a map cell of {length_text(cell)}, {scale}, the same in both panels; {few}"
        f"What is left after correction should be short and point in no common direction. {count_text(n)} plots."
    )
    if len(names) > MAX_TRACKS:
        caption += (
            f" Grey lines show a random choice of {count_text(MAX_TRACKS)} of the {count_text(len(names))} tracks; the arrows "
            "use all."
        )
    return Drawing(name, svg, caption, "Two maps of error arrows, before and after correction")


def zoom_figure(r: Residuals, name: str, *, targets: Mapping[int, str] | None = None) -> Drawing | None:
    """Up to three stretches of track at true scale: reference, raw plots, corrected plots; `targets` names the targets."""
    from matplotlib.ticker import MaxNLocator

    x, y = ground(r)
    good = np.isfinite(x) & np.isfinite(r.east_before_m) & np.isfinite(r.east_after_m)
    index = np.flatnonzero(good)
    if len(index) < 3:
        return None
    index = index[np.lexsort((r.time_s[index], r.track[index], r.target[index]))]
    label = np.cumsum(np.r_[True, (np.diff(r.track[index]) != 0) | (np.diff(r.target[index]) != 0)]) - 1
    groups = np.split(index, np.flatnonzero(np.diff(label)) + 1)
    typical = float(np.median(np.hypot(r.east_before_m, r.north_before_m)[index]))
    steps = np.hypot(np.diff(x[index]), np.diff(y[index]))[np.diff(label) == 0]
    steps = steps[steps > 1.0]
    wide = max(7.0 * typical, 6.0 * float(np.median(steps)) if len(steps) else 0.0, 20.0)
    unit, scale = ("km", 1e3) if wide > 4000 else ("m", 1.0)

    # Looking at every track of a long recording would take seconds; of those with most plots, a few dozen are plenty.
    groups = sorted((g for g in groups if len(g) >= 3), key=lambda g: (-len(g), int(g[0])))[:60]
    windows = []
    for rows in groups:
        # A dozen places show a stretch best.  Standing targets fill a window without showing anything: count places, not plots.
        best, places = -1, 0
        for middle in range(len(rows) // 10, max(len(rows) - len(rows) // 10, 1), max(1, len(rows) // 12)):
            pass_by = _pass(x, y, rows, middle, 0.42 * wide)
            apart = len(np.unique(np.round(np.stack((x[pass_by], y[pass_by])) / (0.03 * wide)), axis=1).T)
            if best < 0 or abs(apart - 12) < abs(places - 12):
                best, places = middle, apart
        if places >= 3:
            windows.append((places, best, rows))
    if not windows:
        return None
    far = np.array([r.reference_range_m[rows[middle]] for _, middle, rows in windows])
    parts = [p for p in np.array_split(np.argsort(far, kind="stable"), min(3, len(windows))) if len(p)]
    chosen = [min((windows[k] for k in part), key=lambda w: abs(w[0] - 12)) for part in parts]

    with style(name):
        high = (WIDTH_IN - 0.72 - 0.12 - 2 * 0.62) / 3
        figure, (row,) = axes_grid(1, 3, high + 1.05, top=0.58, bottom=0.47)
        for spare in row[len(chosen) :]:
            spare.remove()
        for axes, (_, start, rows) in zip(row, chosen, strict=False):
            inside = _pass(x, y, rows, start, 0.75 * wide)
            nearest = np.argsort(np.hypot(x[inside] - x[rows[start]], y[inside] - y[rows[start]]), kind="stable")[:80]
            inside = inside[np.sort(nearest)]
            middle = rows[start]
            px, py = (x[inside] - x[middle]) / scale, (y[inside] - y[middle]) / scale
            axes.plot(*_joined(r, inside, px, py), color="#9aa2aa", linewidth=1.3, zorder=1)
            axes.plot(px, py, linestyle="none", marker="o", markersize=2.6, color="#6b737c", markeredgewidth=0, zorder=2)
            for east, north, colour, light, size in (
                (r.east_before_m, r.north_before_m, BEFORE, BEFORE_LIGHT, 4.4),
                (r.east_after_m, r.north_after_m, AFTER, AFTER_LIGHT, 4.4),
            ):
                qx, qy = px + east[inside] / scale, py + north[inside] / scale
                gap = np.full(len(px), np.nan)
                axes.plot(
                    np.stack((px, qx, gap), 1).ravel(), np.stack((py, qy, gap), 1).ravel(), color=light, linewidth=0.6, zorder=2
                )
                axes.plot(
                    qx,
                    qy,
                    linestyle="none",
                    marker="s" if colour == AFTER else "o",
                    markersize=size,
                    color=colour,
                    markeredgecolor="white",
                    markeredgewidth=0.5,
                    zorder=3,
                )
            axes.set_xlim(-wide / 2 / scale, wide / 2 / scale)
            axes.set_ylim(-wide / 2 / scale, wide / 2 / scale)
            axes.xaxis.set_major_locator(MaxNLocator(5))
            axes.yaxis.set_major_locator(MaxNLocator(5))
            axes.set_aspect("equal")
            axes.set_xlabel(f"east ({unit})")
            speed = np.nanmedian(r.reference_speed_mps[inside]) if np.isfinite(r.reference_speed_mps[inside]).any() else np.nan
            moving = f", {speed:.0f} m/s" if np.isfinite(speed) else ""
            axes.set_title(f"{_target_name(int(r.target[middle]), targets)}: {_km(r.reference_range_m[middle])} away{moving}")
        row[0].set_ylabel(f"north ({unit})")
        legend(
            figure,
            [
                (dot(QUIET), "reference at the plot's time"),
                (line("#9aa2aa", 1.4), "reference track"),
                (dot(BEFORE), "plot before correction"),
                (dot(AFTER, "s"), "plot after correction"),
            ],
        )
        svg = to_svg(figure, name)
    several = "each from the near, the middle and the far plots" if len(chosen) == 3 else "of either target"
    whose = several if len(chosen) > 1 else "of one target"
    caption = (
        f"The same at true scale: a stretch of track {whose}. A thin line joins every plot to its reference. After correction "
        "the plots should lie about the reference on all sides."
    )
    return Drawing(name, svg, caption, "Close-ups of tracks with raw and corrected plots")


def _pass(x: FloatArray, y: FloatArray, rows: IntArray, middle: int, reach: float) -> IntArray:
    """The unbroken run of `rows` about ``rows[middle]`` that stays within `reach` (m) of it in east and north."""
    near = (np.abs(x[rows] - x[rows[middle]]) < reach) & (np.abs(y[rows] - y[rows[middle]]) < reach)
    away = np.flatnonzero(~near)
    cut = np.searchsorted(away, middle)
    start = int(away[cut - 1]) + 1 if cut > 0 else 0
    stop = int(away[cut]) if cut < len(away) else len(rows)
    return rows[start:stop]


def _km(metres: float) -> str:
    return f"{metres / 1e3:.0f} km" if metres >= 2e4 else f"{metres / 1e3:.1f} km"


def _target_name(number: int, targets: Mapping[int, str] | None) -> str:
    return f"Target {(targets or {}).get(number, str(number))}"


def _joined(r: Residuals, rows: IntArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    steps = np.diff(r.time_s[rows])
    cut = np.flatnonzero(steps > 12 * (np.median(steps) if len(steps) else 1.0)) + 1
    return np.insert(x, cut, np.nan), np.insert(y, cut, np.nan)


# -------------------------------------------------------------------------------------------------------------- residuals


def residual_figure(r: Residuals, name: str) -> Drawing | None:
    """Every measured channel against range, azimuth, time and speed, before and after correction."""
    if not len(r):
        return None
    against = [
        ("range (km)", r.reference_range_m / 1e3),
        ("azimuth (°)", r.reference_azimuth_rad / DEG % 360),
        ("", r.time_s),
        ("speed (m/s)", r.reference_speed_mps),
    ]
    against = [(label, x) for label, x in against if np.isfinite(x).any()]
    shown = quantities(r)
    outside = 0
    if not shown or not against:
        return None
    with style(name):
        figure, grid = axes_grid(
            len(shown), len(against), 0.98 + 1.95 * len(shown) + 0.16 * (len(shown) - 1), gap=(0.18, 0.16), top=0.45, bottom=0.48
        )
        for i, quantity in enumerate(shown):
            limits = limits_of(quantity.before, quantity.after)
            outside += outside_of(limits, quantity.before, quantity.after)
            for j, (label, x) in enumerate(against):
                axes = grid[i][j]
                some = sample(len(r))
                for values, light in ((quantity.before, BEFORE_LIGHT), (quantity.after, AFTER_LIGHT)):
                    points(axes, x[some], values[some], light, size=1.8 if len(r) > 400 else 3.0)
                axes.axhline(0, color=INK, linewidth=0.7, zorder=2.5)
                edges = (
                    azimuth_edges(len(r)) if label.startswith("azimuth") else edges_of(x, 12 if label.startswith("speed") else 24)
                )
                for values, dark in ((quantity.before, BEFORE), (quantity.after, AFTER)):
                    b = binned(x, values, edges)
                    axes.fill_between(b.centre, b.low, b.high, color=dark, alpha=0.14, linewidth=0, zorder=3)
                    marker = "s" if dark == AFTER else "o"
                    axes.plot(b.centre, b.median, color=dark, linewidth=1.5, marker=marker, markersize=2.4, zorder=4)
                axes.set_ylim(*limits)
                if label:
                    axes.set_xlim(*_span(x, label))
                    if label.startswith("azimuth"):
                        axes.set_xticks(np.arange(0, 361, 90))
                else:
                    label = time_axis(axes, x)
                if j:
                    axes.tick_params(labelleft=False)
                else:
                    axes.set_ylabel(quantity.label)
                if i == len(shown) - 1:
                    axes.set_xlabel(label)
                else:
                    axes.tick_params(labelbottom=False)
        _residual_legend(figure)
        svg = to_svg(figure, name)
    caption = (
        "Measured minus reference, before and after correction, against range, azimuth, time and the target's "
        "speed. Light points "
        "are plots, lines are medians of bins, bands hold the middle 68 % of each bin. A line that still slopes or waves after "
        f"correction is an error that the chosen terms do not describe.{_sampled(len(r))}"
    )
    if outside:
        caption += f" {count_text(outside)} values lie outside the axes."
    return Drawing(name, svg, caption, "Errors against range, azimuth, time and speed")


def _residual_legend(figure: Figure) -> None:
    legend(
        figure,
        [
            (dot(BEFORE_LIGHT), "plots before"),
            (line(BEFORE), "median before"),
            (dot(AFTER_LIGHT), "plots after"),
            (line(AFTER), "median after"),
        ],
    )


def _span(x: FloatArray, label: str) -> tuple[float, float]:
    known = x[np.isfinite(x)]
    if label.startswith("azimuth"):
        return 0.0, 360.0
    low, high = float(known.min()), float(np.percentile(known, 99.9)) if len(known) > 200 else float(known.max())
    low = 0.0 if low < 0.4 * high else low
    margin = 0.03 * (high - low) or 0.5
    return low - (margin if low else 0.0), high + margin


def target_figure(r: Residuals, name: str, *, targets: Mapping[int, str] | None = None) -> Drawing | None:
    """Every target's median error in each channel and in horizontal distance, before and after correction."""
    if not len(r):
        return None
    shown = [*quantities(r), *_distance(r)]
    if not shown:
        return None
    numbers, which = np.unique(r.target, return_inverse=True)
    n = len(numbers)
    rank = np.argsort(group_quantiles(r.distance_before_m, which, n, (0.5,))[0][0], kind="stable")
    named = n <= 48
    at = np.arange(n, dtype=np.float64)
    with style(name):
        words = [(targets or {}).get(int(numbers[k]), str(numbers[k])) for k in rank] if named else []
        bottom = 0.46 + (0.055 * max(map(len, words)) if n > 8 and named else 0.0)
        figure, grid = axes_grid(
            len(shown), 1, 0.45 + bottom + 1.25 * len(shown) + 0.14 * (len(shown) - 1), gap=(0.0, 0.14), top=0.45, bottom=bottom
        )
        for (axes,), quantity in zip(grid, shown, strict=True):
            ends = []
            for values, dark, shift in ((quantity.before, BEFORE, -0.16), (quantity.after, AFTER, 0.16)):
                low, middle, high = group_quantiles(values, which, n, (0.25, 0.5, 0.75))[0][:, rank]
                ends += [low, high]
                # One line that breaks at NaN: a thousand lines would be a thousand paths to draw.
                axes.plot(
                    np.repeat(at + shift, 3), np.stack([low, high, np.full(n, np.nan)], axis=1).ravel(), color=dark, alpha=0.4,
                    linewidth=float(np.clip(90 / n, 0.5, 3.0)), solid_capstyle="butt", rasterized=n > 600,
                )  # fmt: skip
                axes.plot(
                    at + shift, middle, linestyle="none", marker="s" if dark == AFTER else "o",
                    markersize=float(np.clip(120 / n, 1.6, 4.5)), color=dark,
                    markeredgewidth=0, rasterized=n > 600,
                )  # fmt: skip
            axes.axhline(0, color=INK, linewidth=0.7)
            axes.set_ylabel(quantity.label if quantity.name != "horizontal" else "distance (m)")
            axes.set_ylim(*limits_of(*ends, share=0.2))
            spare = max(0.7, (8 - n) / 2)
            axes.set_xlim(-spare, n - 1 + spare)
            axes.grid(False, axis="x")
            axes.set_xticks([])
            axes.margins(y=0.05)
        last = grid[-1][0]
        if named:
            last.set_xticks(at, words, rotation=90 if n > 8 else 0, fontsize=6.5)
        else:
            last.set_xticks(
                np.unique(np.linspace(0, n - 1, 9).astype(int)),
                [count_text(int(v) + 1) for v in np.unique(np.linspace(0, n - 1, 9).astype(int))],
            )
        last.set_xlabel("target" if named else "targets in the order of their distance before correction")
        legend(figure, [(dot(BEFORE), "before"), (dot(AFTER, "s"), "after")])
        svg = to_svg(figure, name)
    caption = (
        f"Every target by itself, in the order of its raw error ({targets_text(n)}): median (dot) and the middle half (bar) "
        "of its plots' errors in each channel, and of the horizontal distance between plot and reference. A "
        "target that stands apart "
        "after correction has an error of its own (transponder, reference, association)."
    )
    if named and targets:
        caption += " A target's name is its Mode S address, else its MMSI, callsign or track number."
    return Drawing(name, svg, caption, "Median errors of each target before and after correction")


def histogram_figure(r: Residuals, name: str) -> Drawing | None:
    """Distribution of each channel with the normal of the same median and robust sd, and of the horizontal distance."""
    shown, distance = quantities(r), _distance(r)
    if len(r) < 20 or not (shown or distance):
        return None
    with style(name):
        figure, (row,) = axes_grid(1, len(shown) + len(distance), 3.6, top=0.82, bottom=0.5, gap=(0.55, 0))
        for axes, quantity in zip(row, shown, strict=False):
            _histogram(axes, quantity)
        row[0].set_ylabel("plots per bin (%)")
        if distance:
            _cumulative(row[-1], distance[0])
        legend(
            figure,
            [
                (line(BEFORE, 3), "before"),
                (line(AFTER, 3), "after"),
                (line(QUIET, 1.2, "--"), "normal distribution of the same median and robust sd"),
            ],
        )
        svg = to_svg(figure, name)
    caption = (
        "How the errors are distributed. sd is the robust standard deviation (1.4826 times the median absolute "
        "deviation), and the "
        "dashed curve the normal distribution that goes with it. Right: the share of plots that lie nearer to "
        "the reference than a "
        "distance; dots mark the median and 95 %."
    )
    return Drawing(name, svg, caption, "Histograms of the errors before and after correction")


def _histogram(axes: Axes, quantity: Quantity) -> None:
    limits = limits_of(quantity.before, quantity.after)
    edges = np.linspace(*limits, 61 if len(quantity.before) > 500 else 25)
    fine = np.linspace(*limits, 301)
    unit, digits = ("°", 3) if quantity.unit == "°" else (f" {quantity.unit}", 1)
    top = 0.0
    for k, (values, dark, light, word) in enumerate(
        ((quantity.before, BEFORE, BEFORE_LIGHT, "before"), (quantity.after, AFTER, AFTER_LIGHT, "after"))
    ):
        known = values[np.isfinite(values)]
        share = np.histogram(known, edges)[0] / len(known)
        axes.stairs(share, edges, fill=True, color=light, alpha=0.45, linewidth=0)
        axes.stairs(share, edges, color=dark, linewidth=0.8)
        top = max(top, float(share.max()))
        centre, sd = float(np.median(known)), robust_sd(known)
        if sd > 0:
            normal = np.exp(-0.5 * ((fine - centre) / sd) ** 2) / (sd * np.sqrt(2 * np.pi)) * (edges[1] - edges[0])
            axes.plot(fine, normal, color=dark, linewidth=1.1, linestyle=(0, (4, 2)))
            top = max(top, float(min(normal.max(), 1.6 * share.max())))
        text = f"{word}: median {centre:.{digits}f}{unit}, sd {sd:.{digits}f}{unit}".replace("-", "−")
        axes.text(0, 1.105 - 0.065 * k, text, transform=axes.transAxes, fontsize=7.5, color=dark)
    axes.axvline(0, color=INK, linewidth=0.7)
    axes.set_xlim(*limits)
    axes.set_ylim(0, 1.06 * top or 1.0)
    axes.set_xlabel(quantity.label)
    _percent(axes)


def _cumulative(axes: Axes, distance: Quantity) -> None:
    most = 0.0
    for k, (values, dark, word) in enumerate(((distance.before, BEFORE, "before"), (distance.after, AFTER, "after"))):
        known = values[np.isfinite(values)]
        levels = np.linspace(0, 1, min(len(known), 401))
        quantiles = np.quantile(known, levels)
        half, nearly = np.quantile(known, (0.5, 0.95))
        most = max(most, float(np.quantile(known, 0.99)))
        axes.plot(quantiles, levels, color=dark, linewidth=1.5, linestyle="-" if dark == AFTER else DASHED)
        axes.plot([half, nearly], [0.5, 0.95], linestyle="none", marker="o", markersize=4, color=dark)
        text = f"{word}: median {half:.1f} m, 95 % within {nearly:.1f} m"
        axes.text(0, 1.105 - 0.065 * k, text, transform=axes.transAxes, fontsize=7.5, color=dark)
    axes.set_xlim(0, most * 1.03 or 1.0)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("horizontal distance (m)")
    axes.set_ylabel("plots nearer than this (%)", labelpad=2)
    _percent(axes)


def _percent(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter

    axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:g}"))


def curve_figure(r: Residuals, name: str) -> Drawing | None:
    """The raw error against azimuth and range, with what the model takes away at the same plots."""
    channel = {q.name: q for q in quantities(r)}
    panels = []
    for label, x, edges, quantity in (
        ("azimuth (°)", r.reference_azimuth_rad / DEG % 360, azimuth_edges(len(r)), channel.get("azimuth")),
        ("range (km)", r.reference_range_m / 1e3, edges_of(r.reference_range_m / 1e3, 30), channel.get("range")),
    ):
        if quantity is not None:
            measured = binned(x, quantity.before, edges)
            taken = binned(x, quantity.before - quantity.after, edges)
            if np.isfinite(measured.centre).any() and np.isfinite(taken.centre).any():
                panels.append((label, x, quantity, measured, taken))
    if not panels:
        return None
    with style(name):
        figure, (row,) = axes_grid(1, len(panels), 3.35, top=0.45, bottom=0.48)
        for axes, (label, x, quantity, measured, taken) in zip(row, panels, strict=True):
            # The sd of a median of normal errors is 1.253 times that of their mean.
            error = 1.253 * (measured.high - measured.low) / 2 / np.sqrt(measured.number)
            axes.axhline(0, color=INK, linewidth=0.7)
            axes.fill_between(measured.centre, measured.low, measured.high, color=BEFORE_LIGHT, alpha=0.18, linewidth=0)
            axes.errorbar(
                measured.centre,
                measured.median,
                yerr=2 * error,
                linestyle="none",
                marker="o",
                markersize=3.6,
                color=BEFORE,
                elinewidth=1.1,
                capsize=0,
            )
            axes.fill_between(taken.centre, taken.low, taken.high, color=AFTER_LIGHT, alpha=0.25, linewidth=0)
            axes.plot(taken.centre, taken.median, color=AFTER, linewidth=1.8)
            axes.set_xlim(*_span(x, label))
            if label.startswith("azimuth"):
                axes.set_xticks(np.arange(0, 361, 45))
            axes.set_ylim(*limits_of(measured.low, measured.high, taken.low, taken.high))
            axes.set_xlabel(label)
            axes.set_ylabel(quantity.label)
        legend(
            figure,
            [
                (dot(BEFORE), "measured − reference, bin median ± 2 standard errors"),
                (band(BEFORE_LIGHT), "middle 68 % of the plots"),
                (line(AFTER, 2.0), "the model's error for the same plots, with its middle 68 %"),
            ],
        )
        svg = to_svg(figure, name)
    caption = (
        "The error that was found, and the model laid over it. The line is the median of what the model takes "
        "from the very plots of "
        "each bin, so that it also holds what depends on the target (time offset, extent); where it leaves the points, a term is "
        "missing. Standard errors take plots as independent, which plots of one target are not."
    )
    return Drawing(name, svg, caption, "Azimuth and range errors with the fitted model")


def correlation_figure(found: Calibration, name: str, names: dict[int, str]) -> Drawing | None:
    """Correlation coefficients between all terms, with numbers."""
    p = len(found.terms)
    if p < 2:
        return None
    covariance = found.covariance[-1]
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = sd > 0
    matrix: AnyArray = np.full((p, p), np.nan)
    matrix[np.ix_(known, known)] = covariance[np.ix_(known, known)] / np.outer(sd[known], sd[known])
    shown = np.where(np.eye(p, dtype=np.bool_), np.nan, matrix)
    several = len({key.sensor for key in found.terms}) > 1
    labels = [(f"{names.get(k.sensor, k.sensor)}: " if several else "") + term_label(k.name) for k in found.terms]
    step = float(np.clip(7.0 / p, 0.3, 0.62))
    left, low = 0.25 + 0.068 * max(map(len, labels)), 0.2
    from matplotlib.figure import Figure

    upright = p > 5 or several
    high = p * step + low + (0.062 if upright else 0.034) * max(map(len, labels)) + 0.25
    wide = max(left + p * step + 1.4, WIDTH_IN)
    with style(name):
        figure = Figure(figsize=(wide, high), facecolor="white")
        axes = figure.add_axes((left / wide, low / high, p * step / wide, p * step / high))
        axes.set_facecolor("#eceef0")
        image = axes.imshow(shown, cmap="PuOr", vmin=-1, vmax=1, aspect="equal", interpolation="nearest", rasterized=False)
        axes.set_xticks(
            np.arange(p),
            labels,
            rotation=90 if upright else 30,
            ha="center" if upright else "left",
            rotation_mode=None if upright else "anchor",
        )
        axes.set_yticks(np.arange(p), labels)
        axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
        axes.grid(False)
        for side in axes.spines.values():
            side.set_visible(False)
        axes.set_xticks(np.arange(p + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(p + 1) - 0.5, minor=True)
        axes.grid(True, which="minor", color="white", linewidth=1.5)
        axes.tick_params(which="minor", length=0)
        for i in range(p):
            for j in range(p):
                value = matrix[i, j]
                if np.isfinite(value):
                    text = "1" if i == j else f"{value + 0.0 if abs(value) >= 0.005 else 0.0:.2f}".replace("-", "−")
                    axes.text(
                        j,
                        i,
                        text,
                        ha="center",
                        va="center",
                        fontsize=min(8.0, 15 * step),
                        color="white" if i != j and abs(value) > 0.62 else QUIET if i == j else INK,
                    )
        bar = figure.add_axes(((left + p * step + 0.25) / wide, low / high, 0.14 / wide, p * step / high))
        figure.colorbar(image, cax=bar, ticks=[-1, -0.5, 0, 0.5, 1])
        bar.set_ylabel("correlation", labelpad=4)
        for side in bar.spines.values():
            side.set_visible(False)
        svg = to_svg(figure, name)
    caption = (
        "Correlation between the estimates of the terms. Near 0, two terms are told apart by these data; near ±1 "
        "only their sum or "
        "difference is known, and a wrong value of one is made up for by the other."
    )
    return Drawing(name, svg, caption, "Correlation matrix of the terms")
