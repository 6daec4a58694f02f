"""Are the reported standard deviations true?  Candidates for the covariance of a registration, on scenes with known errors.

    python benchmarks/truthfulness.py [--seeds 100] [--scenes full,white] [--targets 30] [--json FILE]

Two radars see 30 aircraft for half an hour; each radar has six errors.  The scenes differ in what the random errors are like:

    full        noise; each aircraft its own transponder delay (10 m), latency (0.1 s) and receiver offset (10 m, which
                wanders over 400 s)
    constant    the same with offsets that never change
    white       independent noise only
    coloured    30 % of the noise's variance wanders over 30 s
    slow        30 % of the noise's variance wanders over 300 s: nothing in the model is quite like it
    gross       full, with 15 % of the pairs wrong by kilometres
    few, many   full, with 12 and with 90 aircraft

and the candidates in how the covariance is made:

    plots       every plot independent (ordinary least squares)
    sandwich    clustered by target, bias-reduced
    model       random effects by level with variances by restricted maximum likelihood
    product     the model, scaled and shaped by the sandwich as far as it differs by more than chance, t variance

For each: NEES over its degrees of freedom (1 is true, more is boastful) of one radar and, for the product, of both jointly; the
share of errors within 2 and within 3 sd (95.4 and 99.7 % if normal).  All numbers are in the terms' own directions and computed
on the same fits.

What the figures say (`truthfulness.md`): independent plots are wrong by factors of 20 and more in variance as soon as targets
have errors of their own.  The sandwich is unbiased entry by entry, but with 30 targets and 6 terms it is so noisy that its
inverse is far too large (NEES 1.5; 3.7 with 12 targets).  The model is steady, and nearly true where it holds; where it does
not (slow) it boasts.  Shrinking one to the other has neither fault.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "registration"))

from synthetic import FULL, WHITE, Errors, random_truth, scene

from boresight.registration import LeastSquares, _Found, _joint
from boresight.registration.least_squares import fit
from boresight.registration.observe import linearise, observe
from boresight.terms import terms_of

NAMES = ("range_bias", "range_gain", "azimuth_bias", "azimuth_cos", "azimuth_sin", "time_offset")
SCENES: dict[str, tuple[Errors, int]] = {
    "full": (FULL, 30),
    "constant": (Errors(delay_m=10.0, latency_s=0.1, offset_m=10.0, offset_memory_s=1e7), 30),
    "white": (WHITE, 30),
    "coloured": (Errors(delay_m=10.0, latency_s=0.1, offset_m=5.0, coloured=0.3, memory_s=30.0), 30),
    "slow": (Errors(delay_m=10.0, latency_s=0.1, offset_m=5.0, coloured=0.3, memory_s=300.0), 30),
    "gross": (Errors(delay_m=10.0, latency_s=0.1, offset_m=10.0, mispaired=0.15), 30),
    "few": (FULL, 12),
    "many": (FULL, 90),
}


def plain_covariance(seen, fitted) -> np.ndarray:
    """The covariance of ordinary least squares, every plot independent, with the noise that its residuals have."""
    _, r, x = linearise(seen, slice(None), fitted.terms, fitted.value)
    sd = np.array([1.4826 * np.median(np.abs(r[:, k])) for k in range(2)])
    a = np.einsum("nki,k,nkj->ij", x[:, :2], 1 / sd**2, x[:, :2])
    return np.linalg.inv(a)


def one(name: str, seed: int) -> dict[str, list[float]]:
    """Error vectors and covariances of one seed, as NEES and normalised errors by candidate."""
    errors, targets = SCENES[name]
    truth = random_truth(seed)
    data = scene(seed, truth, errors=errors, targets=targets)
    out: dict[str, list] = {c: [] for c in ("plots", "sandwich", "model", "product")}
    found, off = [], []
    for sensor in data.sensors:
        rows = np.flatnonzero(data.pairs.plots.sensor == sensor.key)
        seen = observe(data.pairs, rows, sensor, float(data.pairs.plots.time_s.min()))
        fitted = fit(seen, terms_of(NAMES), LeastSquares())
        error = fitted.value - np.array([truth[sensor.name][t.name] for t in fitted.terms])
        p = len(error)
        for candidate, covariance in (
            ("plots", plain_covariance(seen, fitted)),
            ("sandwich", fitted.sandwich),
            ("model", fitted.model_covariance),
            ("product", fitted.covariance),
        ):
            scale = np.sqrt(np.diag(covariance))
            nees = float(error / scale @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale)) / p
            out[candidate].append((nees, *(error / scale)))
        found.append(_Found(seen, fitted, None, []))
        off.append(error)
    joint = _joint(found)
    error = np.concatenate(off)
    scale = np.sqrt(np.diag(joint))
    nees = float(error / scale @ np.linalg.solve(joint / np.outer(scale, scale), error / scale)) / len(error)
    return out | {"joint": [(nees, *(error / scale))], "error": [error.tolist()]}


def run(name: str, seeds: int) -> dict[str, dict[str, float]]:
    """The table's rows of one scene."""
    gathered: dict[str, list] = {}
    for seed in range(seeds):
        for candidate, values in one(name, seed).items():
            gathered.setdefault(candidate, []).extend(values)
    rows: dict[str, dict[str, float]] = {}
    for candidate in ("plots", "sandwich", "model", "product", "joint"):
        values = np.array(gathered[candidate])
        z = np.abs(values[:, 1:])
        rows[candidate] = {
            "nees": float(values[:, 0].mean()),
            "nees_error": float(values[:, 0].std() / np.sqrt(len(values))),
            "within_2": float((z <= 2).mean()),
            "within_3": float((z <= 3).mean()),
            "worst_term_within_3": float((z <= 3).mean(axis=0).min()),
        }
    return rows


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="2 seeds of one scene")
    given = parser.parse_args()
    if given.quick:
        given.seeds, given.scenes = 2, "full"
    tables = {}
    print(f"{'scene':10s} {'candidate':10s} {'NEES/dof':>14s} {'in 2 sd':>8s} {'in 3 sd':>8s} {'worst term':>10s}")
    for name in given.scenes.split(","):
        start = time.perf_counter()
        tables[name] = run(name, given.seeds)
        for candidate, row in tables[name].items():
            print(
                f"{name:10s} {candidate:10s} {row['nees']:7.2f} ± {row['nees_error']:.2f} {100 * row['within_2']:7.1f}% "
                f"{100 * row['within_3']:7.2f}% {100 * row['worst_term_within_3']:9.1f}%"
            )
        print(f"{'':10s} {given.seeds} seeds, {time.perf_counter() - start:.0f} s", flush=True)
    if given.json:
        given.json.write_text(json.dumps(tables, indent=1) + "\n")


if __name__ == "__main__":
    main()
