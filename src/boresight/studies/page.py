"""A study as one HTML page, and as text for a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .. import __version__
from .._files import write_text
from .table import Bound, Row, Study


def write_study(study: Study, path: str | Path) -> Path:
    """Write the study as one self-contained HTML page; the file is written beside and then renamed.  Raises InputError."""
    from importlib.resources import files

    import jinja2
    import markupsafe

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string((files(__package__) / "study.html").read_text(encoding="utf-8"))
    css = (files("boresight.report") / "style.css").read_text(encoding="utf-8")
    bounded = [r for r in study.rows if r.holds is not None]
    text = template.render(
        study=study,
        version=__version__,
        css=markupsafe.Markup(css),
        tables=[(name, [_cells(r) for r in rows]) for name, rows in by_table(study)],
        figures=study.figures,
        held=sum(bool(r.holds) for r in bounded),
        bounded=len(bounded),
        failed=study.failed,
        printed=sum(r.printed is not None for r in study.rows),
        markup=markupsafe.Markup,
    )
    target = Path(path)
    write_text(target, text)
    return target


def by_table(study: Study) -> Iterator[tuple[str, list[Row]]]:
    """The rows of each table, in the order in which the tables first appear."""
    for name in dict.fromkeys(r.table for r in study.rows):
        yield name, [r for r in study.rows if r.table == name]


def study_text(study: Study) -> str:
    """The study as a table to read in a terminal."""
    lines = [f"{study.title}  ({study.paper})"]
    for name, rows in by_table(study):
        lines += ["", name]
        cells = [("", "quantity", "printed", "ours", "bound", "")] + [
            (
                r.row,
                f"{r.quantity}{', ' + r.unit if r.unit else ''}",
                number(r.printed),
                number(r.ours),
                bound_text(r.bound),
                "" if r.holds is None else "holds" if r.holds else "FAILS",
            )
            for r in rows
        ]
        wide = [max(len(c[k]) for c in cells) for k in range(6)]
        lines += [
            f"  {a:<{wide[0]}}  {b:<{wide[1]}}  {c:>{wide[2]}}  {d:>{wide[3]}}  {e:>{wide[4]}}  {f}".rstrip()
            for a, b, c, d, e, f in cells
        ]
    bounded = [r for r in study.rows if r.holds is not None]
    lines += ["", f"{sum(bool(r.holds) for r in bounded)} of {len(bounded)} bounded numbers hold"]
    lines += [f"  {text}" for text in study.remarks]
    return "\n".join(lines)


def _cells(r: Row) -> dict[str, object]:
    return {
        "id": r.id, "row": r.row, "quantity": r.quantity, "unit": r.unit, "printed": number(r.printed), "ours": number(r.ours),
        "bound": bound_text(r.bound), "holds": r.holds, "note": r.note,
    }  # fmt: skip


def number(value: float | str | None) -> str:
    """Four significant digits, words as they are, and nothing where there is none."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if not np.isfinite(value):
        return "–"
    size = abs(value)
    places = 0 if size >= 1000 else int(np.clip(3 - np.floor(np.log10(size)), 0, 6)) if size > 0 else 0
    text = f"{value:.{places}f}" if size == 0 or size >= 1e-5 else f"{value:.2e}"
    return text.replace("-", "\u2212")


def bound_text(bound: Bound | None) -> str:
    """The bound in signs."""
    if bound is None:
        return ""
    if bound.low is not None and bound.high is not None:
        return f"{number(bound.low)} … {number(bound.high)}"
    return f"≥ {number(bound.low)}" if bound.low is not None else f"≤ {number(bound.high)}"
