"""What all figures share: colours, one style, axes at fixed margins, small SVG, and the statistics behind medians and bands.

Colours differ in brightness too, and what was before and what is after also differ by line and marker, so that a page printed in
grey can be read.  The same input gives the same bytes.
"""

from __future__ import annotations

import base64
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_POINTS = 4000
MAX_PAIRS = 250_000
MAX_TRACKS = 300
WIDTH_IN = 9.6
DEG = np.pi / 180.0

# Orange and blue stay apart for every kind of colour blindness, and light orange and dark blue in grey too; the dark shades
# carry lines, the light ones points.
BEFORE, BEFORE_LIGHT = "#c2560c", "#f0a05e"
AFTER, AFTER_LIGHT = "#0a4480", "#4a98d9"
INK, QUIET, RULE, TRACK = "#1c2126", "#6b737c", "#d9dde1", "#b9bfc6"
DASHED = (0, (4.5, 1.6))
_MINUTE = DEG / 60
_NORMAL_SD_PER_MAD = 1.4826
_BARE = re.compile(r"<metadata>.*?</metadata>\s*", re.DOTALL)
_PNG = re.compile(r"data:image/png;base64,\s*([A-Za-z0-9+/=\s]+)")
_TAG = re.compile(r"<[^>]*>")
_LONG = re.compile(r"(-?\d+\.\d{2})\d+")
_PATH = re.compile(r'<path d="([^"]*)"')
_SAME = re.compile(r'<path d="[^"]*"((?: [a-z-]+="[^"]*")*)/>(?:<path d="[^"]*"\1/>)+')
_FONT = re.compile(r"'DejaVu Sans'(?:, [^;\"]*)?(?=[;\"])")


@dataclass(frozen=True, slots=True)
class Drawing:
    """One figure: its name (an anchor), the SVG element, a caption, and what a reader who cannot see it is told."""

    name: str
    svg: str
    caption: str
    alt: str


def robust_sd(values: FloatArray) -> float:
    """1.4826 times the median absolute deviation: one sigma where the errors are normal; NaN for fewer than two values."""
    known = values[np.isfinite(values)]
    return float(_NORMAL_SD_PER_MAD * np.median(np.abs(known - np.median(known)))) if len(known) > 1 else float("nan")


class Bins(NamedTuple):
    """Medians and the middle 68 % of each bin's values; NaN in bins of too few values, so that lines break there."""

    centre: FloatArray
    median: FloatArray
    low: FloatArray
    high: FloatArray
    number: IntArray


def group_quantiles(values: FloatArray, group: IntArray, groups: int, shares: Sequence[float]) -> tuple[FloatArray, IntArray]:
    """Quantiles of the `values` (n,) of each of so many groups, linearly interpolated as NumPy does, and the numbers of values.

    `group` (n,) counts from 0.  Gives (shares, groups), NaN for a group without values, and (groups,).  NaN values do not count.
    """
    known = np.isfinite(values)
    values, group = values[known], group[known].astype(np.int16 if groups < 1 << 15 else np.int32)
    by_value = np.argsort(values)
    order = by_value[np.argsort(group[by_value], kind="stable")]
    values, bounds = values[order], np.searchsorted(group[order], np.arange(groups + 1))
    number = np.diff(bounds)
    out = np.full((len(shares), groups), np.nan)
    filled = number > 0
    for k, share in enumerate(shares):
        place = share * (number[filled] - 1)
        low = np.floor(place).astype(np.int64)
        first, second = bounds[:-1][filled] + low, bounds[:-1][filled] + np.minimum(low + 1, number[filled] - 1)
        out[k, filled] = values[first] + (place - low) * (values[second] - values[first])
    return out, number


def binned(x: FloatArray, y: FloatArray, edges: FloatArray, least: int = 8) -> Bins:
    """Medians and 16 % and 84 % points of `y` over bins of `x`; `centre` is the median `x` of a bin."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    which = np.clip(np.searchsorted(edges, x, "right") - 1, 0, len(edges) - 2)
    (low, middle, high), number = group_quantiles(y, which, len(edges) - 1, (0.16, 0.5, 0.84))
    (centre,), _ = group_quantiles(x, which, len(edges) - 1, (0.5,))
    thin = number < least
    for column in (centre, middle, low, high):
        column[thin] = np.nan
    return Bins(centre, middle, low, high, number)


def edges_of(x: FloatArray, bins: int) -> FloatArray:
    """Bin edges that hold about equally many values, so that thin ends of an axis do not get wild medians."""
    known = x[np.isfinite(x)]
    if not len(known):
        return np.array([0.0, 1.0])
    bins = max(1, min(bins, len(known) // 24))
    edges: FloatArray = np.unique(np.quantile(known, np.linspace(0, 1, bins + 1)))
    return edges if len(edges) > 1 else np.array([edges[0] - 0.5, edges[0] + 0.5])


def azimuth_edges(n: int) -> FloatArray:
    """Bins of 10° around the compass, or 30° where plots are few (degrees)."""
    edges: FloatArray = np.arange(0.0, 361.0, 10.0 if n >= 1000 else 30.0)
    return edges


# ---------------------------------------------------------------------------------------------------------------- drawing


@contextmanager
def style(name: str) -> Iterator[None]:
    import matplotlib

    settings: dict[str, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": name,
        "font.family": ["DejaVu Sans"],
        "font.size": 8.0,
        "axes.titlesize": 8.5,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.titlepad": 5.0,
        "axes.labelsize": 8.0,
        "axes.labelcolor": INK,
        "axes.edgecolor": "#9aa2aa",
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.unicode_minus": True,
        "axes.formatter.useoffset": False,
        "grid.color": "#e8ebee",
        "grid.linewidth": 0.6,
        "text.color": INK,
        "xtick.color": QUIET,
        "ytick.color": QUIET,
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "xtick.major.size": 3.0,
        "ytick.major.size": 3.0,
        "xtick.major.width": 0.7,
        "ytick.major.width": 0.7,
        "legend.frameon": False,
        "legend.fontsize": 7.5,
        "legend.handlelength": 1.6,
        "lines.solid_capstyle": "round",
        "image.composite_image": True,
    }
    with matplotlib.rc_context(settings):  # type: ignore[arg-type]
        yield


def axes_grid(
    rows: int,
    columns: int,
    height_in: float,
    *,
    left: float = 0.72,
    right: float = 0.12,
    top: float = 0.5,
    bottom: float = 0.5,
    gap: tuple[float, float] = (0.62, 0.45),
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of the page's width with a grid of axes, all margins in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), facecolor="white")
    wide = (WIDTH_IN - left - right - gap[0] * (columns - 1)) / columns
    high = (height_in - top - bottom - gap[1] * (rows - 1)) / rows
    axes = []
    for i in range(rows):
        row = []
        for j in range(columns):
            y = height_in - top - (i + 1) * high - i * gap[1]
            x = left + j * (wide + gap[0])
            row.append(figure.add_axes((x / WIDTH_IN, y / height_in, wide / WIDTH_IN, high / height_in)))
        axes.append(row)
    return figure, axes


def to_svg(figure: Figure, name: str) -> str:
    """The figure as an SVG element, small, with ids and classes that stand in one page beside those of others."""
    out = io.StringIO()
    figure.savefig(out, format="svg", dpi=130, metadata={"Date": None, "Creator": None})
    text = _BARE.sub("", out.getvalue())
    text = _TAG.sub(_rounded, text[text.index("<svg") :])
    text = _shortened(_PNG.sub(_smaller, text), f"f{zlib.crc32(name.encode()):08x}")
    # The page's own typeface is narrower than the one that laid the figure out: nothing can overlap.
    text = _FONT.sub("sans-serif", text)
    return re.sub(r'(<svg[^>]*?) width="[^"]*pt"', r"\1", re.sub(r'(<svg[^>]*?) height="[^"]*pt"', r"\1", text, count=1), count=1)


def _rounded(match: re.Match[str]) -> str:
    """A tag with its coordinates to a hundredth of a point: nobody sees the rest."""
    tag = match[0]
    return tag if "data:" in tag or 'transform="s' in tag else _LONG.sub(r"\1", tag)


def _shortened(text: str, mark: str) -> str:
    """The same drawing in fewer bytes: only the ids that are used, styles as classes (by their content), no empty groups."""
    text = re.sub(r">\s+<", "><", text)
    text = re.sub(r'\s*\n\s*(?=[^<>]*")', " ", text).replace(' transform="rotate(-0 ', ' transform="rotate(0 ')
    text = re.sub(r' transform="rotate\(0 [^)]*\)"', "", text)
    used = {key: f"{mark}-{k}" for k, key in enumerate(dict.fromkeys(re.findall(r'(?:href="|url\()#([^")]+)', text)))}
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{used[m[1]]}"' if m[1] in used else "", text)
    text = re.sub(r'(href="|url\()#([^")]+)', lambda m: f"{m[1]}#{used[m[2]]}", text)
    for _ in range(3):
        text = re.sub(r"<g>((?:<(?:use|path|image)[^>]*/>)*|<text[^>]*>[^<]*</text>)</g>", r"\1", text)
    styles: dict[str, str] = {}
    text = re.sub(r"<style.*?</style>", "", text, flags=re.DOTALL)

    def classed(match: re.Match[str]) -> str:
        style = match[1].replace(": ", ":").replace("; ", ";")
        return f' class="{styles.setdefault(style, f"c{zlib.crc32(style.encode()):08x}")}"'

    text = re.sub(r' style="([^"]*)"', classed, text)
    # Neighbours that look the same are one path: the arrows of a map, the bars of targets.
    text = _SAME.sub(lambda m: f'<path d="{" ".join(_PATH.findall(m[0]))}"{m[1]}/>', text)
    rules = "".join(f".{label}{{{style}}}" for style, label in styles.items())
    start = text.index(">") + 1
    return f'<svg class="{mark}"{text[4:start]}<style>.{mark} *{{stroke-linejoin:round}}{rules}</style>{text[start:]}'


def _smaller(match: re.Match[str]) -> str:
    """An embedded picture in 48 colours: clouds of points lose nothing to the eye and take a third of the room."""
    from PIL import Image

    with Image.open(io.BytesIO(base64.b64decode(match[1]))) as picture:
        few = picture.convert("RGBA").quantize(48, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        out = io.BytesIO()
        few.save(out, "PNG", compress_level=7)
    return (
        f"data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}"
        if len(out.getvalue()) < 0.75 * len(match[1])
        else match[0]
    )


def sample(n: int, most: int = MAX_POINTS) -> IntArray:
    """At most `most` of `n` rows, spread over all of them; always the same ones."""
    if n <= most:
        return np.arange(n)
    return np.sort(np.random.default_rng(20160510).choice(n, most, replace=False))


def points(axes: Axes, x: FloatArray, y: FloatArray, colour: str, *, size: float) -> None:
    axes.plot(
        x, y, linestyle="none", marker="o", markersize=size, markeredgewidth=0, color=colour,
        alpha=float(np.clip(18 / np.sqrt(max(len(x), 1)), 0.15, 0.85)), rasterized=len(x) > 400, zorder=2,
    )  # fmt: skip


def limits_of(*values: FloatArray, share: float = 0.4) -> tuple[float, float]:
    """Limits that hold all but `share` percent of the values at each end, and zero."""
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    if not len(known):
        return -1.0, 1.0
    low, high = np.percentile(known, (share, 100 - share)) if len(known) > 200 else (known.min(), known.max())
    low, high = min(float(low), 0.0), max(float(high), 0.0)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def outside_of(limits: tuple[float, float], *values: FloatArray) -> int:
    return int(sum(np.count_nonzero((v < limits[0]) | (v > limits[1])) for v in values))


def time_axis(axes: Axes, time_s: FloatArray) -> str:
    """Ticks at round times of day; returns the label."""
    from datetime import UTC, datetime

    from matplotlib.ticker import FixedLocator, FuncFormatter

    first, last = float(np.nanmin(time_s)), float(np.nanmax(time_s))
    span = max(last - first, 1.0)
    step = next(
        (s for s in (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 10800, 21600, 43200) if span / s <= 5), 86400
    )
    step = step if span / step <= 8 else int(np.ceil(span / 5 / 86400)) * 86400
    ticks = np.arange(np.ceil(first / step), np.floor(last / step) + 1) * step
    shape = "%H:%M:%S" if step < 60 else "%H:%M" if step < 86400 else "%d %b"

    def say(value: float, _: object) -> str:
        return datetime.fromtimestamp(value, UTC).strftime(shape)

    if not len(ticks):
        ticks = np.array([first])
        shape = "%H:%M:%S"
    axes.xaxis.set_major_locator(FixedLocator(ticks.tolist()))
    axes.xaxis.set_major_formatter(FuncFormatter(say))
    margin = 0.03 * span
    axes.set_xlim(first - margin, last + margin)
    day, end = datetime.fromtimestamp(first, UTC), datetime.fromtimestamp(last, UTC)
    if first < 86400:
        return "time of day (UTC)"
    return f"time (UTC, {day:%Y-%m-%d})" if day.date() == end.date() else f"time (UTC, {day:%Y-%m-%d} to {end:%m-%d})"


def legend(figure: Figure, entries: Sequence[tuple[Any, str]], *, y_in: float = 0.08) -> None:
    """One line of legend along the figure's top edge."""
    figure.legend(
        [handle for handle, _ in entries], [text for _, text in entries], loc="upper left", ncols=len(entries),
        bbox_to_anchor=(0.06, 1 - y_in / figure.get_figheight()), borderaxespad=0, columnspacing=1.8, handletextpad=0.6,
    )  # fmt: skip


def dot(colour: str, marker: str = "o") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="none", marker=marker, markersize=4, markeredgewidth=0, color=colour)


def line(colour: str, width: float = 1.6, style: Any = "-") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, linewidth=width, linestyle=style)


def band(colour: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, alpha=0.3, linewidth=0)


def targets_text(n: int) -> str:
    return f"{count_text(n)} {'target' if n == 1 else 'targets'}"


def count_text(n: int) -> str:
    return f"{n:,}".replace(",", "\u202f")


def round_number(value: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(np.log(m * power / value))) * power)


def length_text(metres: float) -> str:
    """A length in words, to two digits."""
    rounded = float(f"{metres:.2g}")
    return f"{rounded / 1e3:g} km" if rounded >= 1e3 else f"{rounded:g} m"


def term_label(name: str) -> str:
    """The name of a term as people read it: ``range_bias@psr`` is "range bias (psr)"; a source has its SAC/SIC."""
    name = re.sub(r"@source (\d+)", lambda m: f" ({_source(int(m[1]))})", name)
    return re.sub(r"@(\w+)", r" (\1)", name).replace("_", " ")


def _source(key: int) -> str:
    return f"{key >> 8}/{key & 255}" if key < 65536 else f"id {key}"


def degree_text(value_rad: float, step_min: float, hemispheres: str) -> str:
    """A latitude or longitude as charts give it: degrees and minutes with the decimals that a step of so many minutes needs."""
    places = max(0, int(np.ceil(-np.log10(step_min) - 1e-9)))
    minutes = round(abs(value_rad) / _MINUTE, places)
    degrees, rest = divmod(minutes, 60)
    rest = round(rest, places)
    half = hemispheres[int(value_rad < 0)] if minutes else hemispheres[0]
    if step_min >= 60:
        return f"{degrees:.0f}°{half}"
    return f"{degrees:.0f}°{rest:0{places + 3 if places else 2}.{places}f}′{half}"


def degree_ticks(low_rad: float, high_rad: float, most: int) -> tuple[FloatArray, float]:
    """Round ticks (rad), at most so many, and their step in minutes of arc."""
    steps = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800)
    span = (high_rad - low_rad) / _MINUTE
    step = next((s for s in steps if span / s <= most), 3600.0)
    ticks = np.arange(np.ceil(low_rad / _MINUTE / step), np.floor(high_rad / _MINUTE / step) + 1) * step * _MINUTE
    return ticks, float(step)
