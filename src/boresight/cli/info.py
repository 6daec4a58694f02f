"""``boresight info``: what a recording holds."""

from __future__ import annotations

import datetime
import math
from typing import Any

from ._options import Date, Editions, Files, Json, date_of, editions_of, print_json, steps


def info(files: Files, /, *, date: Date = None, edition: Editions | None = None, json: Json = False) -> None:
    """Tell what recordings hold: categories, editions, sensors, time span, counts and damage.

    Parameters
    ----------
    files
        Recordings.
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    json
        Print the result as JSON.
    """
    from ..reading import read

    chosen, day = editions_of(edition), date_of(date)
    recordings = []
    with steps(quiet=json) as step:
        for path in files:
            step(f"reading {path}")
            recordings.append(read(path, editions=chosen, date=day))
    if json:
        print_json({"files": [_view(r) for r in recordings]})
        return
    for r in recordings:
        _print(r)


def _iso(time_s: float) -> str | None:
    if not math.isfinite(time_s):
        return None
    return datetime.datetime.fromtimestamp(time_s, datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _view(r: Any) -> dict[str, Any]:
    return {
        "file": r.path,
        "records": r.records,
        "by_category": {f"{category:03d}": n for category, n in sorted(r.by_category.items())},
        "sources": [
            {
                "sac": s.sac,
                "sic": s.sic,
                "category": f"{s.category:03d}",
                "edition": s.edition,
                "records": s.records,
                "plots": s.plots,
                "start": _iso(s.start_s),
                "end": _iso(s.end_s),
                "targets": s.targets,
            }
            for s in r.sources
        ],
        "damaged": [{"offset": d.offset, "why": d.why} for d in r.damaged],
        "warnings": list(r.warnings),
    }


def _print(r: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    console.print(f"{r.path}: {r.records:,} records, {len(r.plots):,} plots, {len(r.fixes):,} fixes, {len(r.damaged):,} damaged")
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("sac/sic", "category", "edition", "records", "plots", "targets", "from (UTC)", "to (UTC)"):
        table.add_column(name, justify="right" if name in ("records", "plots", "targets") else "left", no_wrap=True)
    for s in r.sources:
        row = (f"{s.sac}/{s.sic}", f"{s.category:03d}", s.edition, f"{s.records:,}", f"{s.plots:,}", f"{s.targets:,}")
        table.add_row(*row, _iso(s.start_s) or "no time", _iso(s.end_s) or "no time")
    console.print(table)
    for warning in r.warnings:
        console.print(f"warning: {warning}", soft_wrap=True)
    for damage in r.damaged[:20]:
        console.print(f"damaged: byte {damage.offset}: {damage.why}", soft_wrap=True)
    if len(r.damaged) > 20:
        console.print(f"damaged: and {len(r.damaged) - 20:,} more (--json lists them all)")
