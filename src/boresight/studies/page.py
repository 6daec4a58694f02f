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
        tables=[(f"table-{k}", name, list(_blocks(rows))) for k, (name, rows) in enumerate(by_table(study))],
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
                given(r.printed),
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


# A grid of more columns does not fit a page.
_WIDEST = 8


def _blocks(rows: list[Row]) -> Iterator[dict[str, object]]:
    """A table in blocks: grids of the lines that hold the same quantities, and a list of the others, one number a line."""
    lines = {name: [r for r in rows if r.row == name] for name in dict.fromkeys(r.row for r in rows)}

    def heads(line: list[Row]) -> tuple[str, ...]:
        return tuple(f"{r.quantity}{', ' + r.unit if r.unit else ''}" for r in line)

    groups: dict[tuple[str, ...], list[tuple[str, list[Row]]]] = {}
    for name, line in lines.items():
        groups.setdefault(heads(line), []).append((name, line))
    alone: list[list[Row]] = []
    for head, found in groups.items():
        if len(found) > 1 and 2 <= len(head) <= _WIDEST and len(set(head)) == len(head):
            yield {
                "grid": True,
                "heads": head,
                "lines": [(name, [_cells(r) for r in line], _notes(line)) for name, line in found],
                "notes": any(r.note for _, line in found for r in line),
            }
        else:
            alone += [line for _, line in found]
    flat = [r for line in alone for r in line]
    if flat:
        yield {
            "grid": False,
            "lines": [_cells(r) | {"first": k == 0} for line in alone for k, r in enumerate(line)],
            "printed": any(r.printed is not None for r in flat),
            "bounds": any(r.bound is not None for r in flat),
            "notes": any(r.note for r in flat),
        }


def _notes(line: list[Row]) -> str:
    """The notes of a line of a grid, each once, with its quantity where they differ."""
    told = {r.note: r.quantity for r in reversed(line) if r.note}
    return "; ".join(note if len(told) == 1 else f"{quantity}: {note}" for note, quantity in reversed(told.items()))


def _cells(r: Row) -> dict[str, object]:
    return {
        "id": r.id, "row": r.row, "quantity": r.quantity, "unit": r.unit, "printed": given(r.printed), "ours": number(r.ours),
        "bound": bound_text(r.bound), "holds": r.holds, "note": r.note,
    }  # fmt: skip


def number(value: float | str | None) -> str:
    """Four significant digits, whole numbers and words as they are, and nothing where there is none."""
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if not np.isfinite(value):
        return "–"
    # As rounded: 0.99999 has the places of 1.
    size = float(f"{abs(value):.3e}")
    places = 0 if size >= 1000 or value == round(value) else int(np.clip(3 - np.floor(np.log10(size)), 0, 6))
    return _signed(f"{value:.{places}f}" if size == 0 or size >= 1e-4 else f"{value:.2e}")


def given(value: float | str | None, digits: int = 6) -> str:
    """A number as it is written in a paper or a bound: no more digits than it has."""
    return number(value) if value is None or isinstance(value, str) else _signed(f"{value:.{digits}g}")


def _signed(text: str) -> str:
    return text.replace("-", "\u2212")


def bound_text(bound: Bound | None) -> str:
    """The bound in signs."""
    if bound is None:
        return ""
    low, high = (None if end is None else given(end, 4) for end in (bound.low, bound.high))
    if bound.low is not None and bound.high is not None:
        if bound.low == bound.high:
            return f"= {given(bound.low)}"
        if low == high:
            return f"{given((bound.low + bound.high) / 2)} ± {given((bound.high - bound.low) / 2, 1)}"
        return f"{low} … {high}"
    return f"≥ {low}" if low is not None else f"≤ {high}"
