"""What the benchmarks of the filters share: options, clocks, peers that may be absent, and the way results are told."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # small matrices: threads of the linear algebra only get in the way


class Rate(NamedTuple):
    """Pieces of work a second, by the wall clock and by the processor's (all threads), and a figure of accuracy."""

    wall: float
    processor: float
    accuracy: float = float("nan")


def options(text: str) -> argparse.Namespace:
    """The command line that all of them have."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer runs and rounds")
    parser.add_argument("--json", action="store_true", help="the result as one JSON object on standard output, and nothing else")
    parser.add_argument(
        "--peers", type=Path, default=os.environ.get("BORESIGHT_PEERS"), help="a folder of peer scripts, whose kernels run too"
    )
    return parser.parse_args()


def rate(work: Callable[[], Any], pieces: int, rounds: int, accuracy: Callable[[Any], float] | None = None) -> Rate:
    """The best of some rounds after one that is not counted."""
    found = work()
    wall, processor = float("inf"), float("inf")
    for _ in range(rounds):
        a, b = time.perf_counter(), time.process_time()
        found = work()
        wall, processor = min(wall, time.perf_counter() - a), min(processor, time.process_time() - b)
    return Rate(pieces / wall, pieces / processor, accuracy(found) if accuracy else float("nan"))


def script_peers(folder: Path | None, script: str, names: tuple[str, ...], unit: str, accuracy: str) -> dict[str, Rate | str]:
    """Kernels of a folder of peer scripts: functions that return `unit`_per_s, `unit`_per_cpu_s and an accuracy."""
    if folder is None:
        return {}
    sys.path.insert(0, str(folder))
    out: dict[str, Rate | str] = {}
    for name in names:
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                found = getattr(importlib.import_module(script), name)()
            out[name] = Rate(found[f"{unit}_per_s"], found[f"{unit}_per_cpu_s"], found[accuracy])
        except Exception as error:
            out[name] = f"absent ({type(error).__name__}: {error})"
    return out


def peers(functions: dict[str, Callable[[], Rate]]) -> dict[str, Rate | str]:
    """Each peer's rate, or why there is none."""
    out: dict[str, Rate | str] = {}
    for name, function in functions.items():
        try:
            out[name] = function()
        except ImportError as error:
            out[name] = f"absent ({error})"
    return out


def tell(name: str, unit: str, ours: Rate, others: dict[str, Rate | str], first_use_s: float, as_json: bool, note: str) -> None:
    """Print the table, or the JSON object."""
    there = {key: value for key, value in others.items() if isinstance(value, Rate)}
    if as_json:
        rates = {key: value.wall for key, value in there.items()}
        ratio = {key: ours.wall / value for key, value in rates.items()}
        print(json.dumps({"name": name, "ours": ours.wall, "unit": unit, "peers": rates, "ratio": ratio}))
        return
    print(f"{name}: {note}\n")
    print(f"| | {unit} | ours / theirs | {unit} of processor time | ours / theirs | accuracy |\n|---|---|---|---|---|---|")
    print(f"| boresight | {ours.wall:,.0f} | | {ours.processor:,.0f} | | {ours.accuracy:.3f} |")
    for key, value in there.items():
        print(
            f"| {key} | {value.wall:,.0f} | {ours.wall / value.wall:.2f} | {value.processor:,.0f} "
            f"| {ours.processor / value.processor:.2f} | {value.accuracy:.3f} |"
        )
    print(f"\nFirst use in this process took {first_use_s:.1f} s (compiled code is kept for the next).")
    for key, value in others.items():
        if isinstance(value, str):
            print(f"{key}: {value}")
