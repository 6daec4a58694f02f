"""``boresight assess``: judge a result."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

from ..errors import NothingToDo, SettingsError
from ._options import Json, print_json

Component = Literal["range", "azimuth", "elevation", "east", "north", "along", "cross"]

assess = App(
    name="assess",
    help="Judge a result: against a requirement, by how its errors are distributed, or by two targets.",
    help_format="markdown",
)


@assess.command
def requirement(
    result: Path,
    /,
    *,
    requirement: Annotated[str, Parameter(name="--requirement")],
    sensors: Annotated[Path | None, Parameter(name="--sensors")] = None,
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Say of each figure of a requirement whether the radars of RESULT pass, fail, or cannot be decided upon.

    A figure is decided where the whole confidence interval lies on one side of the limit.

    Parameters
    ----------
    result
        Folder that calibrate --out has written.
    requirement
        Requirement file (TOML), or the name of one that comes with Boresight.
    sensors
        sensors.toml, where the folder has no run.json that tells the kinds of the sensors.
    out
        Write the verdicts to this JSON file.
    json
        Print the verdicts as JSON.
    """
    from ..assessment.requirement import (
        assess_requirement,
        conformity_json,
        conformity_text,
        load_requirement,
        save_conformity,
    )
    from ..assessment.residuals import load_residuals
    from ..calibration import load_calibration
    from ..errors import InputError
    from ..frozen import load_frozen
    from ..model import load_sensors

    if out is not None and out.exists():
        raise SettingsError(f"{out} exists", where="--out", remedy="Name another file.")
    wanted = load_requirement(requirement)
    if not result.is_dir():
        raise InputError("is no folder" if result.exists() else "does not exist", path=result, remedy="Give a folder of results.")
    found = load_calibration(result / "calibration.json")
    pairs = load_residuals(result / "residuals.parquet") if (result / "residuals.parquet").exists() else None
    known = load_sensors(sensors) if sensors is not None else None
    if known is None and (result / "run.json").exists():
        known = load_frozen(result).settings.sensors
    verdicts = assess_requirement(found, pairs, known, wanted)
    if not verdicts:
        raise NothingToDo(f"{wanted.title} has no figure for the kinds of the sensors in {result}")
    if out is not None:
        save_conformity(verdicts, out)
    if json:
        print_json({"conformity": conformity_json(verdicts)})
    else:
        print(conformity_text(verdicts))
    if wanted.example:
        note = (wanted.note or "its figures are vouched for by nobody").rstrip(". ")
        print(
            f"\nwarning: {wanted.name} is marked as an example: {note}. "
            "Compare them with the document before a verdict is handed on.",
            file=sys.stderr,
        )


@assess.command
def correlation(
    result: Path,
    /,
    *,
    targets: Annotated[list[str], Parameter(name="--targets", consume_multiple=True, negative="")],
    sensor: str | None = None,
    motion: Literal["straight", "curved", "all"] = "straight",
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Correlate the errors of two targets that the radar of RESULT saw at the same time: does one tell the other's?

    Parameters
    ----------
    result
        Folder that calibrate --out has written.
    targets
        Two targets, by name or number as in residuals.parquet.
    sensor
        Name of the radar, where the result has several.
    motion
        straight, curved, or all: the segments of both traces that are compared.
    out
        Write figures and numbers to this HTML file (.html), or the numbers to this JSON file (.json).
    json
        Print the numbers as JSON.
    """
    from ..assessment.correlation import correlate, correlation_json, correlation_text, traces_of_result

    _check_out(out)
    if len(targets) != 2 or targets[0] == targets[1]:
        raise SettingsError("two different targets are needed", where="--targets", remedy="Give two names, as --targets A B.")
    found = correlate(*traces_of_result(result, (targets[0], targets[1]), sensor), motion=motion)
    if out is not None and out.suffix.lower() == ".html":
        from ..report.correlation import write_correlation

        write_correlation(found, out)
    elif out is not None:
        _write_json(out, correlation_json(found.found))
    if json:
        print_json({"correlation": correlation_json(found.found)})
        return
    print(correlation_text(found.found))


@assess.command
def distribution(
    result: Path,
    /,
    *,
    sensor: str | None = None,
    channel: str | None = None,
    component: Annotated[list[Component] | None, Parameter(name="--component", consume_multiple=True, negative="")] = None,
    corrected: Annotated[bool, Parameter(name="--corrected", negative="--raw")] = True,
    targets: Annotated[list[str] | None, Parameter(name="--targets", consume_multiple=True, negative="")] = None,
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Say how the errors of RESULT are distributed: normal, heavy-tailed, a mixture; and in which steps they were measured.

    Plots of one target are alike: tests and criteria count them for what they are worth.

    Parameters
    ----------
    result
        Folder that calibrate --out has written.
    sensor
        Name of a sensor; all without it.
    channel
        psr, ssr, mode_s, ssr_psr, mode_s_psr, …: only plots of this channel.
    component
        range, azimuth, elevation (these without it), east, north, along, cross.
    corrected
        Errors after correction, or as they were recorded (--raw).
    targets
        Only plots of these targets, by name or number as in residuals.parquet.
    out
        Write figures and numbers to this HTML file (.html), or the numbers to this JSON file (.json).
    json
        Print the numbers as JSON.
    """
    from ..assessment.distribution import describe_result, distribution_json, distribution_text

    _check_out(out)
    described = describe_result(
        result, sensor=sensor, channel=channel, components=component or (), corrected=corrected, targets=targets or ()
    )
    if out is not None and out.suffix.lower() == ".html":
        from ..report.distribution import write_distribution

        write_distribution(described, out)
    elif out is not None:
        _write_json(out, distribution_json(described))
    if json:
        print_json({"distribution": distribution_json(described)})
        return
    print(distribution_text(described))


def _check_out(out: Path | None) -> None:
    """Raise SettingsError for a file that is there already, or is neither a page nor JSON."""
    if out is not None and out.suffix.lower() not in (".html", ".json"):
        raise SettingsError(f"{out} is neither .html nor .json", where="--out", remedy="Name a page or a JSON file.")
    if out is not None and out.exists():
        raise SettingsError(f"{out} exists", where="--out", remedy="Name another file.")


def _write_json(out: Path, value: object) -> None:
    """Write one JSON document: not-a-number is null."""
    import msgspec

    from .._files import write_bytes

    write_bytes(out, msgspec.json.format(msgspec.json.encode(value), indent=2))
