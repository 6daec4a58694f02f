"""``boresight simulate``: a scene with known errors, as recordings in real formats."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from ..errors import SettingsError
from ._options import Json, Switch, print_json, steps


def simulate(
    scenario: Path,
    /,
    *,
    out: Path | None = None,
    seed: int = 1,
    form: Annotated[Literal["auto", "asterix", "nmea", "table"], Parameter(name="--format")] = "auto",
    duration: float | None = None,
    check: Switch = False,
    json: Json = False,
) -> None:
    """Simulate SCENARIO and write recordings, sensors.toml and the truth to a folder, ready for calibrate.

    Parameters
    ----------
    scenario
        The scene (TOML): who flies and sails where, what the radars and references are like, and the radars' errors.
    out
        Folder for the files, needed but for --check; what is there is kept in earlier-1, earlier-2 and so on.
    seed
        Seed of all that is drawn: the same seed gives the same files.
    form
        How plots are written: auto (CAT048, CAT010 of marine radars, Parquet where elevation is measured), asterix, nmea (TTM of
        marine radars) or table (Parquet).
    duration
        Length of the scene in seconds, instead of the scenario's.
    check
        Only look the scenario over: tell its mistakes and what makes little sense, each with its line.
    json
        Print the result as JSON.
    """
    from msgspec import structs, to_builtins

    from ..simulation.scenario import lint_scenario, load_scenario, mistakes_of

    if check:
        _check(scenario, json)
        return
    if out is None:
        raise SettingsError("there is no folder to write to", where="--out", remedy="Give --out DIR, or --check.")
    if seed < 0:
        raise SettingsError(f"{seed} is no seed", where="--seed", remedy="Give 0 or more.")
    from ..simulation.files import check_form, lost_in, write_scene
    from ..simulation.scenario import simulate as run_scenario

    lint = lint_scenario(scenario)
    scene = lint.scenario or load_scenario(scenario)
    if duration is not None:
        scene = structs.replace(scene, duration_s=duration)
        for mistake in mistakes_of(scene):
            raise SettingsError(mistake.text, where=f"--duration {duration:g}", remedy=mistake.remedy)
    check_form(scene, form)
    warnings = [*map(str, lint.warnings), *lost_in(scene, form)]
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    with steps(quiet=json) as step:
        step(f"simulating {scene.name}")
        run = run_scenario(scene, seed)
        step(f"writing {out}")
        files = write_scene(run, out, form=form, tables=True, seed=seed)
    for name, why in files.empty.items():
        print(f"warning: {name} has no file: {why}", file=sys.stderr)
    command = files.command(out / "result")
    if json:
        view = {
            "scene": scene.name,
            "seed": seed,
            "duration_s": scene.duration_s,
            "files": files.counts,
            "sensors": str(files.sensors),
            "truth": [str(path) for path in (files.truth_file, *files.tables)],
            "errors": to_builtins(files.truth),
            "empty": files.empty,
            "warnings": warnings,
            "calibrate": command,
        }
        print_json(view)
        return
    width = max(map(len, files.counts))
    print(f"{scene.name}: {scene.duration_s:g} s from {scene.start.isoformat().replace('+00:00', 'Z')}, seed {seed}")
    for name, count in files.counts.items():
        what = "plots" if any(path.name == name for path in files.plots) else "reports"
        false = f", {count['false']:,} of them false" if count["false"] else ""
        print(f"  {name:{width}}  {count['rows']:,} {what} of {count['targets']:,} targets{false}")
    told = ", ".join(path.name for path in (files.sensors, files.truth_file, *files.tables))
    print(f"  {told}\n\n{out} holds all of it. To find the errors again:")
    print(f"  {shlex.join(command)}" if command else "  nothing tells where the targets were: there is no reference")


def _check(path: Path, json: bool) -> None:
    """Tell what is wrong with a scenario; the exit code is 2 where it cannot be simulated."""
    from ..simulation.scenario import lint_scenario

    lint = lint_scenario(path)
    if json:
        print_json({"fine": lint.scenario is not None, "mistakes": lint.mistakes, "warnings": lint.warnings})
    else:
        for remark in lint.mistakes:
            print(remark)
        for remark in lint.warnings:
            print(f"warning: {remark}")
        if lint.scenario is not None:
            print(f"{path}: fine: {lint.scenario.summary}")
    if lint.scenario is None:
        raise SystemExit(2)
