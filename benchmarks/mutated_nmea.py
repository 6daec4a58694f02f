"""Mutated NMEA lines: half of a log's lines are damaged, the rest must all be read, and nothing implausible may come out.

    python benchmarks/mutated_nmea.py --lines 100000 --seed 1

Prints a table; the checks are those of tests/reading/test_nmea.py, which runs the short form.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "reading"))

from test_nmea import check_mutated


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lines", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="4,000 lines")
    given = parser.parse_args()
    if given.quick:
        given.lines = 4_000
    print(f"{'seed':>6} {'lines':>8} {'untouched':>10} {'all read':>9} {'damage said':>12} {'plots, fixes':>13} {'s':>6}")
    done, seed, most = 0, given.seed, 10_000
    with tempfile.TemporaryDirectory() as folder:
        while done < given.lines:
            lines = min(most, given.lines - done)
            begin = time.perf_counter()
            sound, damaged, rows = check_mutated(lines, seed, Path(folder) / "mutated.nmea")
            print(f"{seed:>6} {lines:>8,} {sound:>10,} {'yes':>9} {damaged:>12,} {rows:>13,} {time.perf_counter() - begin:>6.2f}")
            done, seed = done + lines, seed + 1


if __name__ == "__main__":
    main()
