"""``boresight calibrate``: from recordings to a radar's errors."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from ._options import Date, Editions, Files, Json, date_of, editions_of, print_json, steps


def calibrate(
    plots: Files,
    /,
    *,
    reference: Files,
    sensors: Path,
    out: Path | None = None,
    model: Annotated[str, Parameter(name="--model")] = "auto",
    select: Annotated[Literal["cross-validation", "bic", "none"], Parameter(name="--select")] = "cross-validation",
    date: Date = None,
    edition: Editions | None = None,
    requirement: str | None = None,
    json: Json = False,
) -> None:
    """Find the systematic errors of the radars in PLOTS against a trusted reference.

    Prints the table of errors. With --out, writes calibration.json, residuals.parquet and report.html there; an earlier result
    in that folder is kept beside it.

    Parameters
    ----------
    plots
        Recordings of the radars to calibrate.
    reference
        Recordings of targets whose positions are trusted: ADS-B, multilateration.
    sensors
        sensors.toml: where each radar stands, and what is known of it.
    out
        Folder for the results.
    model
        auto (the error terms that the data show), constant, atc, surface, or a comma-separated list of error terms.
    select
        How auto chooses: cross-validation (by targets held out), bic (faster), or none (the usual terms of the kind of sensor).
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    requirement
        Requirement file (TOML), or the name of one that comes with Boresight, to judge the radars by.
    json
        Print the result as JSON.
    """
    from .. import flow
    from ..assessment.requirement import conformity_json, conformity_text, load_requirement
    from ..calibration import summary_json
    from ..model import load_sensors

    wanted = None if requirement is None else load_requirement(requirement)
    with steps(quiet=json) as step:
        run = flow.calibrate(
            plots,
            reference,
            load_sensors(sensors),
            model=model,
            date=date_of(date),
            editions=editions_of(edition),
            criterion=select,
            out=out,
            requirement=wanted,
            progress=step,
        )
    if json:
        verdicts = {} if wanted is None else {"conformity": conformity_json(run.conformity)}
        print_json(summary_json(run.calibration) | verdicts)
        return
    print(run.calibration)
    if run.conformity:
        print(f"\n{conformity_text(run.conformity)}")
    for warning in run.calibration.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if out is not None:
        print(f"\nReport: {out / 'report.html'}")
