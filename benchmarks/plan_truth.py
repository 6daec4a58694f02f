"""Does a recording made as `boresight plan` advises reach the wanted sd?

    python benchmarks/plan_truth.py [--seeds 10] [--same] [--quick] [--out FILE.md]

A radar (Mode S, 4 s, 150 km, six errors) and 25 aircraft with ADS-B are simulated for 40 minutes and calibrated.  For each goal
the plan is asked for a smaller sd of one or two errors.  Then flights are simulated as advised: so many through each sector, ring
and level, in the direction named, with places, courses and heights drawn within what the advice leaves open, and with
transponders, clocks and receivers of their own.  Both recordings are calibrated together (or, `alone`, the new one by itself),
and the sd that is reported then is compared with the wanted one.  `--same` tries the other advice too: so many more targets of
the same traffic.

The claim: reported over wanted within 0.8 ... 1.2, for every goal in the mean over the seeds and in at least 85 % of the single
recordings.  What is missed is missed because a dozen sizes of effects are estimated from 25 targets.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import msgspec
import numpy as np
from scipy.interpolate import make_interp_spline

import boresight as bs
from boresight.assessment.plan import Leg, Plan, plan
from boresight.calibration import Calibration
from boresight.geodesy import ecef_from_geodetic
from boresight.model import Pairs
from boresight.simulation import (
    Adsb,
    Airport,
    Atmosphere,
    Radar,
    Scenario,
    Simulated,
    Traffic,
    Truth,
    observe_adsb,
    observe_radar,
    simulate,
)
from boresight.simulation.reference import equip_aircraft

ERRORS = {
    "range_bias": 70.0,
    "range_gain": -0.5,
    "azimuth_bias": 0.2,
    "azimuth_cos": 0.05,
    "azimuth_sin": -0.06,
    "time_offset": 0.3,
}
# What is wanted: error -> part of the present sd; and whether the new recording is to do it alone.
GOALS: dict[str, tuple[dict[str, float], bool]] = {
    "azimuth_bias / 2": ({"azimuth_bias": 0.5}, False),
    "range_gain / 2": ({"range_gain": 0.5}, False),
    "time_offset / 1.6": ({"time_offset": 0.625}, False),
    "azimuth_bias, range_bias / 1.8": ({"azimuth_bias": 0.55, "range_bias": 0.55}, False),
    "azimuth_cos / 1.5, alone": ({"azimuth_cos": 0.67}, True),
}


def scene(aircraft: int = 25, duration_s: float = 2400.0) -> Scenario:
    """One radar, ADS-B, and traffic of all kinds."""
    return Scenario(
        name="plan",
        duration_s=duration_s,
        traffic=Traffic(aircraft=aircraft, lat_deg=41.4, lon_deg=2.0, radius_m=170e3),
        airport=(Airport(lat_deg=41.2971, lon_deg=2.0785, height_m=54.0, runway_deg=246.0),),
        atmosphere=Atmosphere(isa_deviation_k=6.0, shift_m=85.0),
        radar=(
            Radar(
                name="radar", sac=20, sic=1, lat_deg=41.42, lon_deg=2.0, height_m=400.0, kind="mode_s", scan_s=4.0,
                max_range_m=150e3, range_sd_m=25.0, azimuth_sd_deg=0.06, errors=ERRORS,
            ),
        ),
        adsb=Adsb(share=1.0),
    )  # fmt: skip


def fly(found: Plan, like: Scenario, rng: np.random.Generator) -> Simulated:
    """A recording as advised: the plan's flights, each drawn within what its line leaves open, at any time of some hours."""
    radar = like.radar[0]
    lines = [leg for leg in found.legs for _ in range(leg.targets)]
    duration = 3600.0 + 60.0 * len(lines)
    begin = msgspec.structs.replace(
        like, start=like.start.replace(hour=16), duration_s=min(duration, 80_000.0),
        traffic=msgspec.structs.replace(like.traffic, aircraft=len(lines)),
    )  # fmt: skip
    aircraft = equip_aircraft(len(lines), begin.traffic, begin.adsb, rng)
    first, last, curves = [], [], []
    for leg in lines:
        start = rng.uniform(60.0, begin.duration_s - 60.0 * leg.minutes - 60.0)
        first.append(start)
        last.append(start + 60.0 * leg.minutes)
        curves.append(make_interp_spline(*way(leg, radar, start, rng), k=5))
    truth = Truth(
        epoch_s=begin.start.timestamp(), first_s=np.array(first), last_s=np.array(last), aircraft=aircraft,
        atmosphere=like.atmosphere, curves=tuple(curves),
    )  # fmt: skip
    fixes, whose = observe_adsb(truth, like.adsb, rng)
    return Simulated(begin, truth, (observe_radar(truth, radar, rng),), fixes, whose)


def way(leg: Leg, radar: Radar, start: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions (n, 3) of one flight through a place within the line's cell."""
    azimuth = math.radians(rng.uniform(leg.from_deg, leg.to_deg))
    far = rng.uniform(leg.from_m, leg.to_m)
    turn = {"outbound": 0.0, "inbound": 180.0, "clockwise": 90.0, "anticlockwise": -90.0}[leg.flying]
    course = azimuth + math.radians(turn + rng.uniform(-25.0, 25.0))
    height = leg.height_m * rng.uniform(0.9, 1.1)
    ground = math.sqrt(max(far**2 - height**2, (0.5 * far) ** 2))
    time = np.arange(-60.0, 60.0 * leg.minutes + 61.0, 10.0)
    off = (time - 30.0 * leg.minutes) * leg.speed_mps * rng.uniform(0.93, 1.07)
    east, north = ground * math.sin(azimuth) + off * math.sin(course), ground * math.cos(azimuth) + off * math.cos(course)
    latitude = math.radians(radar.lat_deg) + north / 6371e3
    longitude = math.radians(radar.lon_deg) + east / (6371e3 * np.cos(latitude))
    return start + time, ecef_from_geodetic(latitude, longitude, np.full(len(time), height))


def pairs_of(run: Simulated, number: int) -> Pairs:
    """The pairs of a recording; targets and tracks of different recordings have different numbers."""
    pairs = bs.associate(run.observations[0].plots, run.fixes, run.sensors)
    away = 1_000_000 * number
    return pairs.replace(target=pairs.target + away, track=np.where(pairs.track >= 0, pairs.track + away, -1))


def sd_of(found: Calibration, term: str) -> float:
    """The reported sd of a term in its unit."""
    k = found.index(found.sensors[0].sensor, term)
    return math.nan if k is None else float(found.sd[0, k]) / bs.TERMS[term].si_per_unit


def one(seed: int, goals: dict[str, tuple[dict[str, float], bool]], *, same: bool = True) -> list[dict[str, object]]:
    """For each goal: how many targets were advised, forecast over wanted, and reported over wanted of both advices."""
    here = simulate(scene(), seed)
    pairs = pairs_of(here, 0)
    model = tuple(ERRORS)
    before = bs.register(pairs, here.sensors, model=model)
    left = bs.residuals(pairs, here.sensors, before)
    rows = []
    for number, (name, (parts, alone)) in enumerate(goals.items()):
        wanted = {term: sd_of(before, term) * part for term, part in parts.items()}
        found = plan(before, wanted, left, alone=alone)
        rng = np.random.default_rng([seed, number])

        def reached(new: Pairs, wanted: dict[str, float] = wanted, alone: bool = alone) -> float:
            both = new if alone else Pairs.concat([pairs, new])
            after = bs.register(both, here.sensors, model=model)
            return max(sd_of(after, term) / sd for term, sd in wanted.items())

        row: dict[str, object] = {
            "goal": name,
            "targets": found.targets,
            "forecast": max(g.expected / g.wanted for g in found.goals),
            "advised": reached(pairs_of(fly(found, here.scenario, rng), 1)),
        }
        if same and found.same is not None:
            # As many aircraft and hours as advised, of the same kind of traffic.
            more = scene(
                max(round(found.same.targets * 25 / before.sensors[0].targets), 3), max(found.same.hours * 3600.0, 600.0)
            )
            later = msgspec.structs.replace(more, start=more.start.replace(day=2))
            row["same"] = reached(pairs_of(simulate(later, rng), 2))
        rows.append(row)
    return rows


def table(rows: list[dict[str, object]], seeds: range) -> tuple[list[str], bool]:
    """The lines of the table, and whether the claim holds."""
    lines = [
        f"Seeds {seeds[0]} to {seeds[-1]}: the sd that is reported after a recording as advised, over the one that was wanted.",
        "",
        "| goal | targets | forecast / wanted | reported / wanted: mean | least | most | within 20 % | same traffic: mean "
        "| within 20 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    inside, means = 0, []
    for name in dict.fromkeys(str(row["goal"]) for row in rows):
        mine = [r for r in rows if r["goal"] == name]
        ratio = np.array([r["advised"] for r in mine], np.float64)
        again = np.array([r.get("same", math.nan) for r in mine], np.float64)
        other = again[np.isfinite(again)]
        text = f"{other.mean():.2f} | {_inside(other)} of {len(other)}" if len(other) else "- | -"
        lines.append(
            f"| {name} | {np.mean([r['targets'] for r in mine]):.0f} | {np.mean([r['forecast'] for r in mine]):.2f} "
            f"| {ratio.mean():.2f} | {ratio.min():.2f} | {ratio.max():.2f} | {_inside(ratio)} of {len(ratio)} | {text} |"
        )
        inside += _inside(ratio)
        means.append(ratio.mean())
    claims = [
        (f"the mean of every goal within 20 % (largest miss {100 * max(abs(m - 1) for m in means):.0f} %)",
         _inside(np.array(means)) == len(means)),
        (f"{inside} of {len(rows)} single recordings within 20 % (at least 85 %)", inside >= 0.85 * len(rows)),
    ]  # fmt: skip
    lines += ["", *(f"* {'holds' if good else 'FAILS'}: {text}" for text, good in claims)]
    return lines, all(good for _, good in claims)


def _inside(ratio: np.ndarray) -> int:
    return int(((ratio >= 0.8) & (ratio <= 1.2)).sum())


def main() -> int:
    """Print the table; 1 where a claim fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--same", action="store_true", help="the other advice too")
    parser.add_argument("--quick", action="store_true", help="2 seeds of 2 goals")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    goals = dict(list(GOALS.items())[:2]) if options.quick else GOALS
    seeds = range(1, 1 + (2 if options.quick else options.seeds))
    rows = []
    for seed in seeds:
        rows += one(seed, goals, same=options.same)
        done = ", ".join(f"{row['advised']:.2f}" for row in rows[-len(goals) :])
        print(f"seed {seed}: {done}", file=sys.stderr, flush=True)
    lines, holds = table(rows, seeds)
    print("\n".join(lines))
    if options.out:
        options.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return int(not holds)


if __name__ == "__main__":
    sys.exit(main())
