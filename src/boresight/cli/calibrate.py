"""``boresight calibrate``: from recordings to a radar's errors."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from ._options import Date, Editions, Files, Json, Named, Switch, date_of, editions_of, named_values, print_json, steps


def calibrate(
    plots: Files,
    /,
    *,
    reference: Files | None = None,
    sensors: Path,
    out: Path | None = None,
    method: str | None = None,
    option: Annotated[Named | None, Parameter(name="--option")] = None,
    model: Annotated[str, Parameter(name="--model")] = "auto",
    select: Annotated[Literal["cross-validation", "bic", "none"], Parameter(name="--select")] = "cross-validation",
    online: Switch = False,
    main: Annotated[str, Parameter(name="--main", show_default=False)] = "",
    associate: Annotated[str, Parameter(name="--associate")] = "hough",
    associate_option: Annotated[Named | None, Parameter(name="--associate-option")] = None,
    date: Date = None,
    edition: Editions | None = None,
    requirement: str | None = None,
    json: Json = False,
) -> None:
    """Find the systematic errors of the radars in PLOTS against a trusted reference, or of radars against each other.

    Prints the table of errors. With --out, writes calibration.json, residuals.parquet and report.html there, and biases.csv where
    the errors are over time; an earlier result in that folder is kept beside it.

    Parameters
    ----------
    plots
        Recordings of the radars to calibrate.
    reference
        Recordings of targets whose positions are trusted: ADS-B, multilateration, AIS, RTK receivers. Without, radars are
        compared with the --main one, and all errors are relative to it.
    sensors
        sensors.toml: where each radar stands, and what is known of it.
    out
        Folder for the results.
    method
        least-squares (the default against a reference), per-channel, maximum-likelihood, kalman-transform, ransac-icp, genetic;
        over time, and without a reference: kalman-bank (the default there), igmsr, mean-shift, alpha-beta, exponential-average.
    option
        Option of the method, as tau_s=20; several may be given. A name that does not exist is answered by those that do.
    model
        Of least-squares: auto (the error terms that the data show), constant, atc, surface, marine, tracker, full, or a
        comma-separated list of error terms. Of per-channel: constant, first-order, second-order (its auto), or three with commas
        for range, azimuth, elevation.
    select
        How auto chooses: cross-validation (by targets held out), bic (faster), or none (the usual terms of the kind of sensor).
    online
        Follow range, azimuth and elevation bias over time, beside constant other terms.
    main
        Without a reference: the radar that the others are compared with (default: the first in sensors.toml that has plots).
    associate
        How plots find their targets: hough (identities, and a search over the biases), or k-medoids (small errors only).
    associate_option
        Option of the association, as azimuth_window_deg=10; several may be given. A name that does not exist is answered by
        those that do.
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
            reference or [],
            load_sensors(sensors),
            model=model,
            method=method,
            options=named_values(option, "--option"),
            online=online,
            associate=associate,
            associate_options=named_values(associate_option, "--associate-option"),
            main=main,
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
