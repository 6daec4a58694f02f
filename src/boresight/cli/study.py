"""``boresight study``: a paper's tables, printed against ours."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from ._options import Json, Switch, print_json, steps


def study(
    name: str,
    /,
    *,
    quick: Switch = False,
    out: Path | None = None,
    seed: int = 1,
    executor: Literal["serial", "processes", "dask"] = "serial",
    workers: int = 0,
    scheduler: str | None = None,
    json: Json = False,
) -> None:
    """Run a paper's scenes with our methods, and print every number of its tables beside ours.

    Exit code 1 where a bounded number does not hold.

    Parameters
    ----------
    name
        serial-fusion, covariance-conversion, double-target, mean-shift, adsb-registration, or all.
    quick
        Fewer draws: under a minute a study.
    out
        Folder for one HTML page a study; nothing there is overwritten.
    seed
        Seed of all random draws.
    executor
        serial (kernels use all cores), processes, or dask.
    workers
        Number of worker processes; 0: one a processor.
    scheduler
        Address of a Dask scheduler, as tcp://host:8786.
    json
        Print the rows as JSON.
    """
    from ..errors import SettingsError
    from ..studies import Settings, check_name, run_study, study_json, study_names, write_study
    from ..studies.page import study_text

    if seed < 0:
        raise SettingsError(f"{seed} is no seed", where="--seed", remedy="Give 0 or more.")
    if workers < 0:
        raise SettingsError(
            f"{workers} workers are too few", where="--workers", remedy="Give 1 or more, or 0 for one a processor."
        )
    names = study_names() if name == "all" else (check_name(name),)
    pages = {n: out / f"{n}.html" for n in names} if out is not None else {}
    for page in pages.values():
        if page.exists():
            raise SettingsError(f"{page} exists", where="--out", remedy="Name another folder.")
    if out is not None:
        if out.exists() and not out.is_dir():
            raise SettingsError(f"{out} is a file", where="--out", remedy="Name a folder.")
        out.mkdir(parents=True, exist_ok=True)
        # Told now, not after minutes of work.
        if not os.access(out, os.W_OK):
            raise SettingsError(f"{out} cannot be written to", where="--out", remedy="Name another folder.")
    done = []
    for one in names:
        with steps(quiet=json) as step:
            found = run_study(
                one,
                Settings(quick=quick, seed=seed, executor=executor, workers=workers, scheduler=scheduler, progress=step),
            )
        done.append(found)
        if not json:
            print(study_text(found) + "\n")
        if one in pages:
            write_study(found, pages[one])
            if not json:
                print(f"Page: {pages[one]}\n")
    if json:
        print_json(study_json(done[0]) if name != "all" else {"studies": [study_json(s) for s in done]})
    if any(s.failed for s in done):
        raise SystemExit(1)
