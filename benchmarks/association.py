"""Association without any identity on 90 aircraft: right tracks, wrong pairs, over many seeds.

    python benchmarks/association.py [--seeds 10] [--quick]

The scene is `boresight.simulation.association_scene`: 90 aircraft within 100 km, a primary radar with track numbers and no
identity, azimuth biases to 2.8°, a fifth of the aircraft without ADS-B.  Every declared pair of plot and target is counted
against the simulator's truth, whatever its track.  Claims: at least 98 % of the radar tracks that have a reference go to it,
at most 1 % of the declared pairs are wrong.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from boresight.association import Association, search
from boresight.simulation import Simulated, simulate
from boresight.simulation.demo import association_scene
from boresight.targets import targets_of


def score(run: Simulated, found: Association) -> dict[str, float]:
    """What was right and what was wrong.

    A track "has a reference" if its aircraft (of most of its plots) sent ADS-B while the track lasted, for at least half of
    its plots; it is right if most of its pairs are with that aircraft.  Pairs are counted one by one.
    """
    fix_target = targets_of(run.fixes)
    owner = np.full(int(fix_target.max()) + 1, -2)
    owner[fix_target] = run.fix_target
    pairs = found.pairs
    true = run.plot_target[pairs.plot]
    wrong = owner[pairs.target] != true

    plots = run.plots
    numbers, track = np.unique(plots.track, return_inverse=True)
    paired = np.zeros(len(plots), bool)
    paired[pairs.plot] = True
    has, right = 0, 0
    for k in range(len(numbers)):
        rows = np.flatnonzero((track == k) & (plots.track >= 0))
        aircraft = run.plot_target[rows]
        aircraft = aircraft[aircraft >= 0]
        if not len(aircraft):
            continue
        mine = int(np.bincount(aircraft).argmax())
        stamps = run.fixes.time_s[run.fix_target == mine]
        if not len(stamps):
            continue
        gap = np.min(np.abs(plots.time_s[rows][:, None] - np.sort(stamps)[None, :]), axis=1)
        if np.mean(gap < 5.0) < 0.5 or len(rows) < 3:
            continue
        has += 1
        here = np.isin(pairs.plot, rows)
        right += bool(here.any() and np.mean(owner[pairs.target[here]] == mine) > 0.5)
    return {"pairs": len(pairs), "wrong": int(wrong.sum()), "tracks": has, "right": right}


def main(seeds: int) -> int:
    """Print one row a seed and the totals; 1 where a claim does not hold."""
    total = {"pairs": 0.0, "wrong": 0.0, "tracks": 0.0, "right": 0.0}
    print("seed  tracks with reference  right       pairs  wrong     bias true -> found (m, deg, s)          time s")
    for seed in range(1, seeds + 1):
        run = simulate(association_scene(seed), seed)
        start = time.perf_counter()
        found = search(run.plots, run.fixes, run.sensors)
        took = time.perf_counter() - start
        s = score(run, found)
        total = {key: total[key] + s[key] for key in total}
        b, e = found.bias[0], run.errors["primary"]
        print(
            f"{seed:4d}  {s['tracks']:21.0f}  {s['right']:5.0f}  {s['pairs']:10.0f}  {s['wrong']:5.0f}     "
            f"{e['range_bias']:6.0f} {e['azimuth_bias']:6.2f} {e['time_offset']:5.2f} -> "
            f"{b.range_m:6.0f} {np.degrees(b.azimuth_rad):6.2f} {b.time_s:5.2f}  {took:8.2f}"
        )
    right, wrong = total["right"] / total["tracks"], total["wrong"] / total["pairs"]
    print(f"right tracks {100 * right:.2f} % (at least 98), wrong pairs {100 * wrong:.3f} % (at most 1)")
    return int(right < 0.98 or wrong > 0.01)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="2 seeds")
    given = parser.parse_args()
    sys.exit(main(2 if given.quick else given.seeds))
