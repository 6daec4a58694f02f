"""Does the demonstration tell the truth?  The whole chain, from files to terms with sd, on scenes whose errors are known.

    python benchmarks/demo_truth.py [--seeds 100] [--first 1] [--jobs 1] [--quick] [--out FILE]

Each seed draws other traffic, other ships, other noise and other errors.  The files are written, read, associated and registered
as `boresight demo` does.  Claims: each term is within 3 reported sd in at least 97 of 100 seeds; pooled, 93 ... 97.5 % of the
errors are within 2 sd; the NEES of the radars' terms over its degrees of freedom is 0.9 ... 1.1 on average; in every seed at
least 6 terms have a true value beyond 5 sd.  A term that was not determined in a seed is not counted there, and said.  Ends with
1 where a claim does not hold (with fewer than 100 seeds, by more than chance).
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from boresight import flow
from boresight.model import load_sensors
from boresight.simulation.demo import write_demo
from boresight.terms import TERMS


def one(seed: int) -> dict[str, Any]:
    """Run the demonstration of one seed: true, found and sd of each term, and each radar's NEES."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        files = write_demo(folder, seed)
        wrote = time.perf_counter()
        run = flow.calibrate(
            files.plots,
            files.reference,
            load_sensors(files.sensors),
            date=files.date,
            truth=files.truth,
            editions={21: "2.4"},
        )
    rows = [(name, r.term, r.true, r.found, r.sd) for name, terms in run.truth.items() for r in terms]
    nees = {}
    for sensor in run.calibration.sensors:
        mine = [k for k, key in enumerate(run.calibration.terms) if key.sensor == sensor.sensor]
        names = [run.calibration.terms[k].name for k in mine]
        true = np.array([files.truth[sensor.name].get(n, 0.0) * TERMS[n].si_per_unit for n in names])
        error = run.calibration.value[0, mine] - true
        covariance = run.calibration.covariance[0][np.ix_(mine, mine)]
        nees[sensor.name] = (float(error @ np.linalg.solve(covariance, error)), len(mine))
    return {"seed": seed, "rows": rows, "nees": nees, "write_s": wrote - start, "all_s": time.perf_counter() - start}


def main() -> int:
    """Print the table of all terms and the claims; 1 where one does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="4 seeds")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seeds = range(options.first, options.first + (4 if options.quick else options.seeds))
    if options.jobs > 1:
        pool: Executor = ProcessPoolExecutor(options.jobs, mp_context=get_context("forkserver"))
        with pool:
            runs = list(pool.map(one, seeds))
    else:
        runs = [one(seed) for seed in seeds]
    lines, good = table_of(runs)
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return int(not good)


def table_of(runs: Sequence[dict[str, Any]]) -> tuple[list[str], bool]:
    """The table of all terms and the claims, as lines of Markdown, and whether all claims hold."""
    n = len(runs)
    lines = [
        f"Demonstration, seeds {runs[0]['seed']} to {runs[-1]['seed']}: found against true, from ASTERIX and AIS files.",
        "",
        "| radar | term | unit | determined | mean error | rms error | mean sd | within 2 sd | within 3 sd | true beyond 5 sd |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    table: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for run in runs:
        for name, term, true, found, sd in run["rows"]:
            table.setdefault((name, term), []).append((true, found, sd))
    scaled = []
    worst = 0
    for (name, term), values in table.items():
        rows = np.array(values)
        true, found, sd = rows[np.isfinite(rows).all(axis=1)].T
        z = (found - true) / sd
        scaled.append(z)
        three = int(np.count_nonzero(np.abs(z) <= 3))
        worst = max(worst, len(z) - three)
        error = found - true
        lines.append(
            f"| {name} | {term} | {TERMS[term].unit} | {len(z)} | {error.mean():.4f} | {np.sqrt(np.mean(error**2)):.4f} "
            f"| {sd.mean():.4f} | {np.count_nonzero(np.abs(z) <= 2)} | {three} | {np.count_nonzero(np.abs(true) > 5 * sd)} |"
        )
    pooled = np.concatenate(scaled)
    two = float(np.mean(np.abs(pooled) <= 2))
    per_radar = {
        name: sum(run["nees"][name][0] for run in runs) / sum(run["nees"][name][1] for run in runs) for name in runs[0]["nees"]
    }
    nees = sum(v[0] for run in runs for v in run["nees"].values()) / sum(v[1] for run in runs for v in run["nees"].values())
    apart = ", ".join(f"{name} {value:.2f}" for name, value in per_radar.items())
    large = [sum(abs(true) > 5 * sd for _, _, true, _, sd in run["rows"]) for run in runs]
    # What chance allows: the claims are about many seeds; a few seeds scatter (terms of one seed are correlated: half count).
    effective = max(len(pooled) / 2, 1)
    slack = 0.0 if n >= 100 else 3 * math.sqrt(0.05 * 0.95 / effective)
    spread = 0.0 if n >= 100 else 3 * math.sqrt(2 / effective)
    claims = [
        (f"most often beyond 3 sd: {worst} of {n} (at most 3 %)", worst <= (0.03 * n if n >= 100 else max(1, 0.05 * n))),
        (f"within 2 sd, pooled: {100 * two:.1f} % (93 ... 97.5)", 0.93 - slack <= two <= 0.975 + slack),
        (f"NEES over degrees of freedom: {nees:.3f} (0.9 ... 1.1); {apart}", 0.9 - spread <= nees <= 1.1 + spread),
        (f"terms beyond 5 sd: at least {min(large)} of {len(table)} (at least 6)", min(large) >= 6),
    ]
    verdict = "holds" if n >= 100 else f"not contradicted by {n} seeds"
    lines += ["", *(f"* {verdict if good else 'FAILS'}: {text}" for text, good in claims)]
    lines.append(
        f"* simulate and write {np.median([r['write_s'] for r in runs]):.2f} s, "
        f"with read to register {np.median([r['all_s'] for r in runs]):.2f} s (medians)"
    )
    return lines, all(good for _, good in claims)


if __name__ == "__main__":
    sys.exit(main())
