"""How long does it take to calibrate a radar on a million plots against ADS-B, from files to report, and in how much memory?

    python benchmarks/calibrate_million.py [--plots 1000000] [--quick] [--interval 3 5] [--profile FILE] [--json]

One Mode S radar (4 s, 240 km, known errors) and an ADS-B station with a report of each aircraft every 3 to 5 s are simulated,
about 100,000 plots at a time, each piece with aircraft of its own, and written as CAT048 and CAT021.  That is not timed.  Then
``flow.calibrate(..., out=...)`` runs in a process of its own, so that its peak memory is its own; kernels are compiled (or
loaded from the cache) on a tenth of a piece before the clock starts.  Aim (1,000,000 plots, two cores): 15 s and 2 GiB.

Measured on two cores shared with much other work, where only the processor time says anything, seconds by step:

    plots       reading  aligning  associating  estimating  report  all    peak
    1,000,000       2.7       2.1          6.6        12.9     6.7   31.0  1.85 GiB
    4,000,000      11.5      14.3         43.0        40.8    16.6  126.1  6.18 GiB

Four times the plots take 4.1 times the processor time.  The aim of 15 s is not reached: 31 s of processor time cannot pass in
less than 15.5 s on two cores, and estimating and the report's figures mostly use one.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from boresight import flow
from boresight.model import Fixes, Plots, load_sensors
from boresight.simulation import Adsb, Radar, Scenario, Traffic, simulate
from boresight.simulation.files import sensors_toml
from boresight.simulation.scenario import Simulated
from boresight.writing.asterix import write_asterix

ERRORS = {
    "range_bias": 75.0, "range_gain": 0.4, "azimuth_bias": 0.21, "azimuth_cos": 0.05, "azimuth_sin": -0.04, "time_offset": 0.35,
}  # fmt: skip
PIECE = 100_000


def piece(number: int, plots: int, interval_s: tuple[float, float]) -> Simulated:
    """One hour of traffic that gives about so many plots."""
    radar = Radar(
        name="en-route", sac=20, sic=1, lat_deg=41.5312, lon_deg=1.8846, height_m=782.0, kind="mode_s", scan_s=4.0,
        max_range_m=240e3, range_sd_m=30.0, azimuth_sd_deg=0.05, errors=ERRORS,
    )  # fmt: skip
    aircraft = max(round(200 * plots / PIECE), 5)
    scene = Scenario(
        duration_s=3600.0,
        traffic=Traffic(aircraft=aircraft, lat_deg=41.5, lon_deg=1.9, radius_m=230e3, arrivals=0.0, departures=0.0, local=0.2),
        radar=(radar,),
        adsb=Adsb(share=1.0, interval_s=interval_s),
    )
    return simulate(scene, np.random.default_rng([7, number]))


def write_scene(folder: Path, plots: int, interval_s: tuple[float, float]) -> tuple[int, int]:
    """Write radar.ast, adsb.ast and sensors.toml; the numbers of plots and of reports."""
    found, fixes, number, seen = [], [], 0, 0
    while seen < plots:
        run = piece(number, min(plots, PIECE), interval_s)
        later = 3600.0 * number
        p = run.observations[0].plots
        found.append(p.replace(time_s=p.time_s + later))
        fixes.append(run.fixes.replace(time_s=run.fixes.time_s + later))
        number, seen = number + 1, seen + len(p)
    (folder / "sensors.toml").write_text(sensors_toml(run.sensors), encoding="utf-8")
    table, reports = Plots.concat(found), Fixes.concat(fixes)
    table = table[:plots]
    reports = reports[reports.time_s <= table.time_s[-1] + 10.0]
    write_asterix(folder / "radar.ast", table)
    write_asterix(folder / "adsb.ast", fixes=reports)
    return len(table), len(reports)


def calibrate(folder: Path, out: Path) -> tuple[Any, dict[str, tuple[float, float]]]:
    """One run and the seconds that each step took: by the clock, and of processor time."""
    steps: dict[str, tuple[float, float]] = {}
    here = [""]
    last = start = np.array([time.perf_counter(), time.process_time()])

    def progress(step: str) -> None:
        nonlocal last
        now = np.array([time.perf_counter(), time.process_time()])
        if here[0]:
            steps[here[0]] = (round(now[0] - last[0], 3), round(now[1] - last[1], 3))
        here[0], last = step.replace(str(folder) + "/", ""), now

    run = flow.calibrate(
        [folder / "radar.ast"],
        [folder / "adsb.ast"],
        load_sensors(folder / "sensors.toml"),
        date=Scenario().start.date(),
        editions={21: "2.4"},
        out=out,
        progress=progress,
    )
    progress("end")
    steps["all"] = (round(last[0] - start[0], 3), round(last[1] - start[1], 3))
    return run, steps


def measure(folder: str, warm: str, profile: str, pipe: Any) -> None:
    """In a process of its own: steps, peak memory, and the terms over their sd."""
    calibrate(Path(warm), Path(warm) / "out")
    if profile:
        import cProfile

        profiler = cProfile.Profile()
        run, steps = profiler.runcall(calibrate, Path(folder), Path(folder) / "out")
        profiler.dump_stats(profile)
    else:
        run, steps = calibrate(Path(folder), Path(folder) / "out")
    found = run.calibration
    unit = np.array([_si(key.name) for key in found.terms])
    error = (found.value[0] - unit * np.array([ERRORS.get(key.name, 0.0) for key in found.terms])) / found.sd[0]
    # What getrusage tells of a process that was started by another one begins with that one's memory.
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024**2
    errors = {key.name: round(float(e), 2) for key, e in zip(found.terms, error, strict=True)}
    pipe.send((steps, peak, len(run.residuals), errors))


def _si(term: str) -> float:
    from boresight.terms import TERMS

    return TERMS[term].si_per_unit


def main() -> int:
    """Print the table; 1 where a million plots take more than the claim."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plots", type=int, default=1_000_000)
    parser.add_argument("--quick", action="store_true", help="100,000 plots")
    parser.add_argument("--interval", type=float, nargs=2, default=(3.0, 5.0), help="seconds between reports, least and most")
    parser.add_argument("--profile", default="", help="write a profile of the timed run here")
    parser.add_argument("--keep", type=Path, help="write the scene here, or take it from here if it is there")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    plots = 100_000 if options.quick else options.plots
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary) / "scene"
        warm = Path(temporary) / "warm"
        warm.mkdir()
        write_scene(warm, 10_000, tuple(options.interval))
        if not (folder / "sensors.toml").exists():
            folder.mkdir(parents=True, exist_ok=True)
            write_scene(folder, plots, tuple(options.interval))
        sizes = {name: (folder / name).stat().st_size for name in ("radar.ast", "adsb.ast")}
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=measure, args=(str(folder), str(warm), options.profile, theirs))
        process.start()
        theirs.close()
        try:
            steps, peak, pairs, error = ours.recv()
        finally:
            process.join()
    result = {
        "plots": plots, "pairs": pairs, "bytes": sizes, "seconds": steps, "peak_gib": round(peak, 2), "error_over_sd": error,
    }  # fmt: skip
    if options.json:
        print(json.dumps(result))
    else:
        print(f"{plots:,} plots, {pairs:,} pairs, files of {sum(sizes.values()) / 1e6:.0f} MB")
        for step, (seconds, processor) in steps.items():
            print(f"  {step:<40} {seconds:7.2f} s, {processor:7.2f} s of processor time")
        print(f"  peak memory {peak:.2f} GiB; errors over their sd: {error}")
    return int(plots == 1_000_000 and (steps["all"][0] > 15 or peak > 2))


if __name__ == "__main__":
    sys.exit(main())
