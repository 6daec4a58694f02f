"""``boresight plan``: what to record next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..errors import SettingsError
from ._options import Json, Switch, print_json


def plan(
    calibration: Path,
    /,
    *,
    sd: Annotated[list[str], Parameter(name="--sd", consume_multiple=True, negative="")],
    sensor: str | None = None,
    alone: Switch = False,
    json: Json = False,
) -> None:
    """Tell what to record next, so that errors of CALIBRATION are known as well as wanted.

    Where the information came from is read from the residuals.parquet beside the calibration.

    Parameters
    ----------
    calibration
        calibration.json, as calibrate writes it, or the folder that holds it.
    sd
        Wanted standard deviation of an error in its unit, as azimuth_bias=0.005; several may be given.
    sensor
        Name of the sensor, where the calibration has several.
    alone
        The new recording is to do it by itself, because the radar has been adjusted since.
    json
        Print the plan as JSON.
    """
    from ..assessment.plan import plan as make
    from ..assessment.plan import plan_json, plan_text
    from ..assessment.residuals import load_residuals
    from ..calibration import load_calibration

    wanted: dict[str, float] = {}
    for text in sd:
        name, equals, value = text.partition("=")
        try:
            wanted[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise SettingsError(f"{text!r} is no error and its sd", where="--sd", remedy="Example: --sd azimuth_bias=0.005")
    if calibration.is_dir():
        calibration = calibration / "calibration.json"
    found = load_calibration(calibration)
    beside = calibration.parent / "residuals.parquet"
    made = make(found, wanted, load_residuals(beside) if beside.exists() else None, sensor=sensor, alone=alone)
    if json:
        print_json(plan_json(made))
    else:
        print(plan_text(made))
