"""``boresight correct``: a recording without the errors that a calibration found."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..errors import SettingsError
from ._options import Date, Editions, Files, date_of, editions_of, steps


def correct(
    plots: Files,
    /,
    *,
    calibration: Path,
    out: Path,
    sensors: Annotated[Path | None, Parameter(name="--sensors")] = None,
    date: Date = None,
    edition: Editions | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Take the errors of a calibration out of PLOTS and write them as Parquet or CSV.

    Parameters
    ----------
    plots
        Recordings of the radars that were calibrated.
    calibration
        calibration.json, as calibrate writes it.
    out
        File to write; its ending, .parquet or .csv, chooses the format.
    sensors
        sensors.toml, where the azimuths need a north offset.
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    overwrite
        Replace OUT where it exists.
    """
    from .. import flow

    if out.suffix.lower() not in (".parquet", ".csv"):
        raise SettingsError(f"{out} ends neither in .parquet nor in .csv", where="--out")
    if any(out.resolve() == p.resolve() for p in [*plots, calibration]):
        raise SettingsError(f"{out} is one of the inputs, which are never written to", where="--out")
    if out.exists() and not overwrite:
        raise SettingsError(f"{out} exists", where="--out", remedy="Name another file, or add --overwrite.")
    with steps(quiet=False) as step:
        rows, warnings = flow.correct_files(
            plots, calibration, out, sensors=sensors, date=date_of(date), editions=editions_of(edition), progress=step
        )
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(f"{out}: {rows:,} corrected plots")
