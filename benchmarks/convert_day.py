"""How long does `boresight convert` take for a day of eight radars, and in how much memory?

    python benchmarks/convert_day.py [--plots 80000000] [--quick] [--out parquet|csv] [--json]

An hour of eight Mode S radars (4 s, 240 km) is simulated once and laid 24 times behind itself, with stamps over a whole day, into
one CAT048 file.  That is not timed.  Then the command runs in a process of its own, whose peak memory is the kernel's word on it.

Measured on two cores shared with much other work, so that the time by the clock says little: 8,000,000 plots take 27 s of
processor time and 567 MB at most.  The whole day of 80,000,000 (2.37 GB of CAT048 to 1.26 GB of Parquet) takes 245 s of processor
time (517 s by the clock) and 604 MB at most: the parts are joined on one thread, because two took 784 MB.
"""

from __future__ import annotations

import argparse
import datetime
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from boresight.model import Plots
from boresight.reading.asterix import DecodeState, decode
from boresight.simulation import Radar, Scenario, Traffic, simulate
from boresight.writing.asterix import encode_asterix

DAY = datetime.datetime(2026, 3, 1, tzinfo=datetime.UTC)
RADARS = 8
HOURS = 24
# So many plots of an aircraft one radar has in an hour, or a little more.
PLOTS_PER_AIRCRAFT = 280
# Bytes a plot in the file made here, in what is written and in its pieces, together and rounded up.
DISK_BYTES = {"parquet": 90, "csv": 300}


def hour(plots: int) -> Plots:
    """`plots` plots of eight radars in the first hour of the day, in the order of time."""
    radars = tuple(
        Radar(
            name=f"radar-{k}", sac=20, sic=k + 1, lat_deg=40.6 + 0.6 * (k // 4), lon_deg=0.4 + 0.8 * (k % 4), height_m=500.0,
            kind="mode_s", scan_s=4.0, max_range_m=240e3, range_sd_m=30.0, azimuth_sd_deg=0.05,
        )
        for k in range(RADARS)
    )  # fmt: skip
    aircraft = max(round(plots / RADARS / PLOTS_PER_AIRCRAFT), 5)
    while True:
        traffic = Traffic(aircraft=aircraft, lat_deg=40.9, lon_deg=1.6, radius_m=230e3, arrivals=0.0, departures=0.0, local=0.2)
        table = simulate(Scenario(start=DAY, duration_s=3600.0, traffic=traffic, radar=radars), 7).plots
        table = table[(table.time_s >= DAY.timestamp()) & (table.time_s < DAY.timestamp() + 3599.9)]
        if len(table) >= plots:
            break
        aircraft = round(1.1 * aircraft * plots / max(len(table), 1)) + 1
    table = table[np.argsort(table.time_s, kind="stable")]
    return table[np.sort(np.random.default_rng(7).permutation(len(table))[:plots])]


def write_day(path: Path, plots: int) -> int:
    """Write the day to `path` and return its number of plots."""
    data, _ = encode_asterix(hour(-(-plots // HOURS)))
    records, _, _ = decode(data, DecodeState.begin(), final=True)
    octets, begin = np.frombuffer(data, np.uint8), records.offset
    # The time of day (three bytes, I048/140) follows the list of items (FSPEC) and the source (I048/010).
    at, more = begin + 1, (octets[begin] & 1).astype(bool)
    while more.any():
        more, at = more & (octets[at] & 1).astype(bool), at + more
    at += 2
    stamps = sum(octets[at + k].astype(np.int64) << 16 - 8 * k for k in range(3))
    # Only whole blocks are written; their first records are three bytes behind their beginning.
    ends = np.append(begin[1:][np.diff(begin) != records.length[:-1]] - 3, len(data))
    done = 0
    with open(path, "wb") as file:
        for turn in range(HOURS):
            moved = stamps + turn * 3600 * 128
            out = octets.copy()
            for k in range(3):
                out[at + k] = moved >> 16 - 8 * k & 255
            wanted = min(plots - done, len(begin))
            if wanted <= 0:
                break
            end = len(data) if wanted == len(begin) else int(ends[np.searchsorted(ends, begin[wanted - 1])])
            file.write(out[:end])
            done += int(np.searchsorted(begin, end))
    return done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--plots", type=int, default=80_000_000)
    parser.add_argument("--out", choices=("parquet", "csv"), default="parquet")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="a million plots")
    options = parser.parse_args()
    plots = 1_000_000 if options.quick else options.plots
    with tempfile.TemporaryDirectory(prefix="convert-day-") as name:
        folder = Path(name)
        free, needed = shutil.disk_usage(folder).free, plots * DISK_BYTES[options.out]
        if free < needed:
            sys.exit(f"{plots:,} plots need about {needed / 1e9:.0f} GB in {folder.parent}, {free / 1e9:.0f} GB are free")
        start = time.perf_counter()
        # In a process of its own: a process that is started here begins with this one's memory as its peak.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            made = pool.apply(write_day, (folder / "day.ast", plots))
        making = time.perf_counter() - start
        size = (folder / "day.ast").stat().st_size
        out = folder / f"day.{options.out}"
        command = [sys.executable, "-m", "boresight", "convert", str(folder / "day.ast"), str(out), "--date", f"{DAY:%Y-%m-%d}"]
        start = time.perf_counter()
        with open(folder / "told.json", "w+b") as told:
            run = subprocess.Popen([*command, "--json"], stdout=told)
            _, status, used = os.wait4(run.pid, 0)
            seconds = time.perf_counter() - start
            if status:
                sys.exit(f"convert ended with {os.waitstatus_to_exitcode(status)}")
            told.seek(0)
            assert json.load(told)["rows"] == {"plots": made}
        peak = used.ru_maxrss * 1024
        result = {
            "name": "convert_day",
            "plots": made,
            "input_bytes": size,
            "output_bytes": out.stat().st_size,
            "seconds": round(seconds, 1),
            "cpu_s": round(used.ru_utime + used.ru_stime, 1),
            "plots_per_s": round(made / seconds),
            "peak_bytes": peak,
            "making_s": round(making, 1),
        }
    if options.json:
        print(json.dumps(result))
        return
    print(f"{made:,} plots of eight radars, {size / 1e6:,.0f} MB of CAT048, made in {making:.1f} s")
    print(f"  to {options.out}: {seconds:,.1f} s, {made / seconds:,.0f} plots/s, {result['output_bytes'] / 1e6:,.0f} MB")
    print(f"  processor time {result['cpu_s']:,.1f} s")
    print(f"  peak memory {peak / 1e6:,.0f} MB")


if __name__ == "__main__":
    main()
