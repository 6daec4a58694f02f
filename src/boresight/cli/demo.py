"""``boresight demo``: the whole chain on a simulated region whose errors are known."""

from __future__ import annotations

import sys
from pathlib import Path

from ._options import Json, print_json, steps


def demo(*, out: Path = Path("boresight-demo"), seed: int = 1, json: Json = False) -> None:
    """Simulate radars with known errors, write real ASTERIX and AIS, calibrate, compare with the truth, write the report.

    Parameters
    ----------
    out
        Folder for the recordings and the report.
    seed
        Seed of the scene: another seed, other traffic, other ships and other errors.
    json
        Print the result as JSON.
    """
    from .. import flow

    with steps(quiet=json) as step:
        run = flow.demo(out, seed=seed, progress=step)
    report = str(out / "report.html")
    if json:
        sensors = {
            name: {"terms": {row.term: {"true": row.true, "found": row.found, "sd": row.sd, "unit": row.unit} for row in rows}}
            for name, rows in run.truth.items()
        }
        print_json({"sensors": sensors, "report": report})
        return
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    for name, rows in run.truth.items():
        table = Table(title=name, title_justify="left", box=None, pad_edge=False)
        for heading in ("error", "true", "found", "sd", "unit", "off by"):
            table.add_column(heading, justify="left" if heading in ("error", "unit") else "right")
        for row in rows:
            off = f"{abs(row.found - row.true) / row.sd:.1f} sd" if row.sd > 0 else "not determined"
            table.add_row(row.term, f"{row.true:.4f}", f"{row.found:.4f}", f"{row.sd:.4f}", row.unit, off)
        console.print(table)
        console.print()
    for warning in run.calibration.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    console.print(f"Recordings, sensors.toml and truth: {out}\nReport: {report}", soft_wrap=True)
