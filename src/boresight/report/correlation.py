"""The figures of a correlation of two targets' errors, and its page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import __version__
from .._files import write_text
from .._types import FloatArray
from ..assessment.correlation import Correlation, Trace, correlation_text
from .drawing import AFTER, AFTER_LIGHT, BEFORE, BEFORE_LIGHT, INK, Drawing, axes_grid, dot, legend, line, style, to_svg

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title><style>{{ css }}
pre { white-space: pre-wrap; font-size: .85rem; line-height: 1.35; }</style></head>
<body><h1>{{ title }}</h1><p class="meta"><span>Boresight {{ version }}</span></p>
{% if table %}
<div class="wide"><table><thead><tr>{% for cell in table[0] %}<th>{{ cell }}</th>{% endfor %}</tr></thead><tbody>
{% for row in table[1:] %}
<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</tbody></table></div>
{% endif %}
{% for word in words %}
<p>{{ word }}</p>
{% endfor %}
{% for f in figures %}
<figure id="{{ f.name }}" role="img" aria-label="{{ f.alt }}">{{ markup(f.svg) }}<figcaption><b>Figure {{ loop.index }}.</b>
{{ f.caption }}</figcaption></figure>
{% endfor %}
<h2>Numbers</h2><pre>{{ text }}</pre></body></html>
"""


def correlation_figures(found: Correlation) -> tuple[Drawing, ...]:
    """The traces with their segments, and the errors of range and azimuth with their difference, raw and filtered."""
    drawings = [trace_figure((found.first, found.second))]
    one, two = found.rows
    time_s = found.first.time_s[one]
    for c in found.found.channels:
        k = ("range", "azimuth", "elevation").index(c.channel)
        raw = found.first.error[one, k], found.second.error[two, k]
        filtered = found.first.filtered[one, k], found.second.filtered[two, k]
        drawings.append(errors_figure(f"errors-{c.channel}", c.channel, time_s, raw, filtered, found.found.targets))
    return tuple(drawings)


def trace_figure(traces: tuple[Trace, Trace], *, text: str = "") -> Drawing:
    """Both traces as the radar sees them, straight segments in colour, curved ones light."""
    with style("traces"):
        figure, ((axes,),) = axes_grid(1, 1, 5.4, left=2.2, right=2.0)
        unit = 1e3 if max(float(np.abs(t.enu[:, :2]).max()) for t in traces) >= 5e3 else 1.0
        for trace, (strong, light) in zip(traces, ((AFTER, AFTER_LIGHT), (BEFORE, BEFORE_LIGHT)), strict=True):
            for s in trace.segments:
                rows = slice(s.first, s.last + 2)
                axes.plot(
                    trace.enu[rows, 0] / unit, trace.enu[rows, 1] / unit, color=light if s.curved else strong,
                    linewidth=1.0 if s.curved else 2.2,
                )  # fmt: skip
        axes.plot(0, 0, marker="^", color=INK, markersize=6)
        label = axes.annotate("radar", (0, 0), (7, -3), textcoords="offset points", fontsize=7.5)
        # A trace may lead past it.
        label.set_bbox({"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 0.8})
        axes.set_aspect("equal", adjustable="datalim")
        name = "km" if unit > 1 else "m"
        axes.set_xlabel(f"east ({name})")
        axes.set_ylabel(f"north ({name})")
        entries = [(line(AFTER, 2.2), f"{traces[0].name}, straight"), (line(AFTER_LIGHT, 1.0), "curved")]
        entries += [(line(BEFORE, 2.2), f"{traces[1].name}, straight"), (line(BEFORE_LIGHT, 1.0), "curved")]
        legend(figure, entries)
        svg = to_svg(figure, "traces")
    count = [sum(not s.curved for s in t.segments) for t in traces]
    caption = text + (
        f"Where the two targets were, with the segments found: straight ones {count[0]} ({traces[0].name}) and {count[1]} "
        f"({traces[1].name})."
    )
    return Drawing("traces", svg, caption, "Traces of two targets with straight and curved segments")


def errors_figure(
    name: str,
    channel: str,
    time_s: FloatArray,
    raw: tuple[FloatArray, FloatArray],
    filtered: tuple[FloatArray, FloatArray],
    targets: tuple[str, str],
    *,
    text: str = "",
) -> Drawing:
    """Errors of both targets over the matched scans and, below, their difference; raw light, filtered strong.

    Angles are drawn in degrees.
    """
    scale, unit = (1.0, "m") if channel == "range" else (np.pi / 180, "°")
    gap = np.diff(time_s) > 5 * np.median(np.diff(time_s)) if len(time_s) > 1 else np.zeros(0, bool)
    at = np.flatnonzero(gap) + 1
    # One after the other, as the paper draws its joined segments; the line breaks between them.
    x = np.insert(np.arange(len(time_s), dtype=float), at, np.nan)
    with style(name):
        figure, ((top,), (low,)) = axes_grid(2, 1, 5.2, top=0.5, gap=(0.6, 0.35))
        size = 3.0 if len(time_s) < 1500 else 1.5
        for k, (strong, light) in enumerate(((AFTER, AFTER_LIGHT), (BEFORE, BEFORE_LIGHT))):
            top.plot(
                np.arange(len(time_s)), raw[k] / scale, color=light, marker="o", markersize=size, markeredgewidth=0, linestyle="",
                alpha=0.75, rasterized=len(time_s) > 1500,
            )  # fmt: skip
            top.plot(x, np.insert(filtered[k], at, np.nan) / scale, color=strong, linewidth=1.5)
        difference, calm = (raw[0] - raw[1]) / scale, (filtered[0] - filtered[1]) / scale
        low.plot(
            np.arange(len(time_s)), difference, color="#9aa2aa", marker="o", markersize=size, markeredgewidth=0, linestyle="",
            alpha=0.8, rasterized=len(time_s) > 1500,
        )  # fmt: skip
        low.plot(x, np.insert(calm, at, np.nan), color=INK, linewidth=1.5)
        top.set_ylabel(f"{channel} error ({unit})")
        low.set_ylabel(f"difference ({unit})")
        low.set_xlabel("scan, counted over the joined segments")
        for axes in (top, low):
            axes.axhline(0, color=INK, linewidth=0.5)
            for place in at:
                axes.axvline(float(place), color="#d9dde1", linewidth=0.8)
        entries = [(dot(AFTER_LIGHT), f"{targets[0]} raw"), (line(AFTER), "filtered"), (dot(BEFORE_LIGHT), f"{targets[1]} raw")]
        entries += [(line(BEFORE), "filtered"), (dot("#9aa2aa"), "difference raw"), (line(INK), "filtered")]
        legend(figure, entries)
        svg = to_svg(figure, name)
    digits, after = (1, " m") if unit == "m" else (3, "°")

    def say(value: float) -> str:
        return f"{round(value, digits) + 0.0:.{digits}f}{after}".replace("-", "−")

    caption = text + (
        f"Difference raw: mean {say(difference.mean())}, peak to peak {say(np.ptp(difference))}; "
        f"filtered: {say(calm.mean())} and {say(np.ptp(calm))}."
    )
    return Drawing(name, svg, caption, f"Errors of {channel} of two targets and their difference, raw and filtered")


def write_correlation(found: Correlation, path: str | Path) -> Path:
    """Write the correlation as one self-contained HTML page; beside, then renamed.  Raises InputError."""
    title = f"Errors of {found.found.targets[0]} and {found.found.targets[1]}"
    return write_figures(title, correlation_figures(found), correlation_text(found.found), path)


def write_figures(
    title: str,
    figures: Sequence[Drawing],
    text: str,
    path: str | Path,
    *,
    table: Sequence[Sequence[str]] = (),
    words: Sequence[str] = (),
) -> Path:
    """Write figures and the numbers behind them as one self-contained HTML page; beside, then renamed.  Raises InputError.

    A `table` (its head first) and paragraphs of `words` stand before the figures.
    """
    from importlib.resources import files

    import jinja2
    import markupsafe

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    css = (files("boresight.report") / "style.css").read_text(encoding="utf-8")
    page = environment.from_string(_PAGE).render(
        title=title,
        version=__version__,
        css=markupsafe.Markup(css),
        table=table,
        words=words,
        figures=figures,
        text=text,
        markup=markupsafe.Markup,
    )
    target = Path(path)
    write_text(target, page)
    return target
