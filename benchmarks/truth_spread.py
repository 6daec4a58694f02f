"""Are the reported standard deviations true over a spread of geometries, and how far is the estimate from the best there is?

    python benchmarks/truth_spread.py [--seeds 500] [--jobs 2] [--out benchmarks/truth_spread.md] [--quick]

Every recording is another scene: 60 to 90 aircraft seen by two radars out to 60 … 250 km, scans of 4 to 12 s, noise of 15 … 70 m
and 0.03 … 0.12 degrees, of which 0 … 40 % wanders over 20 … 300 s, transponder delays, latencies and receiver offsets of random
size.  Six errors a radar are drawn; the model is given.  Held are

* NEES over its degrees of freedom within 0.9 … 1.1, one radar at a time and both jointly;
* at least 99 % of all errors within 3 of their sd;
* for white noise alone, the root mean square error at most 1.1 of the Cramér-Rao bound.

Printed beside is the same ratio for correlated noise, against generalised least squares that knows every covariance: the bound
that no estimate can beat without being told what is random.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "registration"))

from synthetic import RADARS, Errors, airliner, random_truth, scene

from boresight.registration import LeastSquares, _Found, _joint
from boresight.registration.least_squares import fit
from boresight.registration.observe import linearise, observe
from boresight.terms import DEG, TERMS, terms_of

NAMES = ("range_bias", "range_gain", "azimuth_bias", "azimuth_cos", "azimuth_sin", "time_offset")
# How a target's own errors show: its transponder's delay, its latency, its receiver's offset east and north.
_OWN = ("range_bias", "time_offset", "site_east", "site_north")


def errors_of(seed: int) -> tuple[Errors, dict[str, float]]:
    """What is random in recording `seed`, and how it is seen."""
    rng = np.random.default_rng([seed, 41])
    errors = Errors(
        range_m=rng.uniform(15, 70),
        azimuth_rad=rng.uniform(0.03, 0.12) * DEG,
        delay_m=rng.uniform(2, 15),
        latency_s=rng.uniform(0.02, 0.15),
        offset_m=rng.uniform(2, 12),
        offset_memory_s=rng.uniform(200, 2000),
        coloured=rng.uniform(0.0, 0.4),
        memory_s=rng.uniform(20, 300),
    )
    return errors, {
        "far_m": float(rng.uniform(60e3, 250e3)),
        "scan_s": float(rng.choice([4.0, 5.0, 6.0, 10.0, 12.0])),
        "targets": int(rng.integers(60, 91)),
    }


def bound(seen, terms, value: np.ndarray, errors: Errors) -> np.ndarray:
    """The covariance of generalised least squares that knows every covariance (white noise: the Cramér-Rao bound)."""
    _, _, x = linearise(seen, slice(None), terms, value)
    _, _, own = linearise(seen, slice(None), tuple(TERMS[n] for n in _OWN), np.zeros(len(_OWN)))
    information = np.zeros((len(terms), len(terms)))
    noise = np.array([errors.range_m, errors.azimuth_rad]) ** 2
    for g in range(len(seen.cluster_key)):
        rows = np.flatnonzero(seen.cluster == g)
        apart = np.abs(seen.time_s[rows][:, None] - seen.time_s[rows])
        n = len(rows)
        random = errors.coloured * np.exp(-apart / errors.memory_s) + (1 - errors.coloured) * np.eye(n)
        v = np.zeros((2 * n, 2 * n))
        for c in range(2):
            v[c * n : (c + 1) * n, c * n : (c + 1) * n] = noise[c] * random
        column = [own[rows][:, :2, k].T.ravel() for k in range(4)]
        v += errors.delay_m**2 * np.outer(column[0], column[0]) + errors.latency_s**2 * np.outer(column[1], column[1])
        wander = np.tile(errors.offset_m**2 * np.exp(-apart / errors.offset_memory_s), (2, 2))
        for k in (2, 3):
            v += wander * np.outer(column[k], column[k])
        size = np.sqrt(np.diag(v))
        a = np.concatenate([x[rows][:, 0], x[rows][:, 1]]) / size[:, None]
        information += a.T @ np.linalg.solve(v / np.outer(size, size), a)
    scale = np.sqrt(np.diag(information))
    return np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)


def one(job: tuple[int, bool, bool]) -> dict[str, list]:
    """One recording: NEES by radar and jointly, errors in sd, and errors in sd of the bound (where asked for)."""
    seed, white, with_bound = job
    errors, seen_as = errors_of(seed)
    if white:
        errors = Errors(range_m=errors.range_m, azimuth_rad=errors.azimuth_rad)
        seen_as = seen_as | {"targets": 30}
    truth = random_truth(seed)
    data = scene(seed, truth, errors=errors, track=airliner, sensors=RADARS, **seen_as)
    found, off, out = [], [], {"nees": [], "z": [], "bound": []}
    terms = terms_of(NAMES)
    for sensor in data.sensors:
        rows = np.flatnonzero(data.pairs.plots.sensor == sensor.key)
        seen = observe(data.pairs, rows, sensor, float(data.pairs.plots.time_s.min()))
        fitted = fit(seen, terms, LeastSquares())
        true = np.array([truth[sensor.name][t.name] for t in fitted.terms])
        error = fitted.value - true
        scale = np.sqrt(np.diag(fitted.covariance))
        z = error / scale
        out["nees"].append(float(z @ np.linalg.solve(fitted.covariance / np.outer(scale, scale), z)) / len(z))
        out["z"].append(z.tolist())
        if with_bound and len(fitted.terms) == len(NAMES):
            out["bound"].append((error / np.sqrt(np.diag(bound(seen, fitted.terms, true, errors)))).tolist())
        found.append(_Found(seen, fitted, None, []))
        off.append(error)
    joint = _joint(found)
    error = np.concatenate(off)
    scale = np.sqrt(np.diag(joint))
    out["joint"] = [float(error / scale @ np.linalg.solve(joint / np.outer(scale, scale), error / scale)) / len(error)]
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=500)
    parser.add_argument("--bounds", type=int, default=60, help="recordings whose bound is computed, white and correlated each")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--quick", action="store_true", help="3 recordings, nothing held")
    given = parser.parse_args()
    if given.quick:
        given.seeds, given.bounds, given.jobs = 3, 1, 1
    begin = time.perf_counter()
    jobs = [(seed, False, seed < given.bounds) for seed in range(given.seeds)]
    jobs += [(100_000 + seed, True, True) for seed in range(2 * given.bounds)]
    if given.jobs > 1:
        with ProcessPoolExecutor(given.jobs, mp_context=get_context("forkserver")) as pool:
            results = list(pool.map(one, jobs, chunksize=4))
    else:
        results = [one(job) for job in jobs]
    main_part, white = results[: given.seeds], results[given.seeds :]
    nees = np.concatenate([r["nees"] for r in main_part])
    joint = np.concatenate([r["joint"] for r in main_part])
    z = np.abs(np.concatenate([np.concatenate(r["z"]) for r in main_part]))
    own = np.array([b for r in main_part for b in r["bound"]])
    ratio = np.array([b for r in white for b in r["bound"]])
    lines = [
        f"Seeds 0 to {given.seeds - 1}, two radars each: {len(nees):,} registrations, {len(z):,} errors.",
        "",
        "| quantity | found | bound | |",
        "|---|---|---|---|",
    ]
    failed = False

    def hold(what: str, value: float, text: str, low: float, high: float) -> None:
        nonlocal failed
        good = low <= value <= high
        failed |= not good
        lines.append(f"| {what} | {text} | {low:g} … {high:g} | {'holds' if good else '**fails**'} |")

    def error_of(values: np.ndarray) -> float:
        return float(values.std() / np.sqrt(len(values)))

    hold("NEES/dof, one radar", float(nees.mean()), f"{nees.mean():.3f} ± {error_of(nees):.3f}", 0.9, 1.1)
    hold("NEES/dof, both jointly", float(joint.mean()), f"{joint.mean():.3f} ± {error_of(joint):.3f}", 0.9, 1.1)
    hold("errors within 3 sd", float((z <= 3).mean()), f"{100 * (z <= 3).mean():.2f} %", 0.99, 1.0)
    lines.append(f"| errors within 2 sd | {100 * (z <= 2).mean():.2f} % | | |")
    # One ratio a recording and term; their mean square's root over all.
    white_rms = float(np.sqrt((ratio**2).mean()))
    se = white_rms * np.sqrt(0.5 / len(ratio) / len(NAMES) * 2)
    hold("RMSE over the Cramér-Rao bound, white noise", white_rms, f"{white_rms:.3f} ± {se:.3f}", 0.0, 1.1)
    own_rms = float(np.sqrt((own**2).mean()))
    lines.append(f"| RMSE over the generalised least-squares bound, correlated noise | {own_rms:.3f} | | |")
    lines += ["", "| term | RMSE over the bound, white | correlated |", "|---|---|---|"]
    for k, name in enumerate(NAMES):
        lines.append(f"| {name} | {np.sqrt((ratio[:, k] ** 2).mean()):.3f} | {np.sqrt((own[:, k] ** 2).mean()):.3f} |")
    lines += ["", f"{time.perf_counter() - begin:.0f} s with {given.jobs} processes."]
    print("\n".join(lines))
    if given.out:
        given.out.write_text("# Truthfulness over a spread of geometries\n\n" + "\n".join(lines) + "\n")
    return int(failed and not given.quick)


if __name__ == "__main__":
    sys.exit(main())
