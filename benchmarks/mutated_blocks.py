"""Mutated ASTERIX blocks in files of every wrapping: what is sound must all be read, and nothing implausible may come out.

    python benchmarks/mutated_blocks.py --blocks 1000000 --seed 1 --out benchmarks/mutated_blocks.md

Each file holds 1,000 blocks, of which a twentieth, a fifth or a half are spoilt in one of fifteen ways; some files are also cut,
or (captures) claim a wrong link type.  The blocks are those of the product's own writer, of the categories that it does not
write, and of the recordings at $BORESIGHT_DATA.  The checks are those of tests/reading/mutation.py; the suite runs a short form.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "reading"))

import mutation

# Wall time after which a file counts as hanging: the run ends with the place where it hangs.
HANG_S = 300.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=1_000_000, help="how many mutated blocks")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write the table there")
    parser.add_argument("--quick", action="store_true", help="10,000 mutated blocks")
    given = parser.parse_args()
    if given.quick:
        given.blocks = 10_000
    recordings = os.environ.get("BORESIGHT_DATA")
    totals: dict[tuple[str, str], Counter[str]] = {}
    kinds: Counter[tuple[str, int]] = Counter()
    faults: list[str] = []
    seed = given.seed
    with tempfile.TemporaryDirectory() as folder:
        pools = mutation.pools(Path(recordings) if recordings else None, Path(folder))
        while sum(kinds.values()) < given.blocks:
            for name, pool in pools.items():
                for form in mutation.FORMATS:
                    faulthandler.dump_traceback_later(HANG_S, exit=True)
                    made, sound = mutation.one_file(random.Random(f"{name} {form} {seed}"), pool, form)
                    result = mutation.check(made, sound, Path(folder) / "mutated")
                    kinds.update(made.kinds)
                    count = totals.setdefault((name, form), Counter())
                    mutated = sum(made.kinds.values())
                    count.update(
                        files=1, mutated=mutated, sound=result.sound, damaged=result.damaged, refused=bool(result.refused)
                    )
                    count.update(missed=result.missed, far=result.far, moved=result.moved)
                    count["slowest_ms"] = max(count["slowest_ms"], round(result.cpu_s * 1e3))
                    faults += [f"{name}, {form}, seed {seed}: {fault}" for fault in result.faults]
                    if result.far:
                        faults.append(f"{name}, {form}, seed {seed}: {result.far} sound blocks away from damage were not read")
            seed += 1
        faulthandler.cancel_dump_traceback_later()
    text = table(totals, kinds, faults, given.seed, seed - 1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n")
    missed, moved = (sum(c[name] for c in totals.values()) for name in ("missed", "moved"))
    if faults or moved or missed > mutation.MISSED * sum(kinds.values()):
        raise SystemExit(1)


def table(
    totals: dict[tuple[str, str], Counter[str]], kinds: Counter[tuple[str, int]], faults: list[str], first: int, last: int
) -> str:
    """What was done and found, as Markdown."""
    whole: Counter[str] = Counter()
    for count in totals.values():
        whole.update({name: n for name, n in count.items() if name != "slowest_ms"})
    lines = [
        "# Mutated ASTERIX blocks",
        "",
        f"{sum(kinds.values()):,} mutated blocks in {whole['files']:,} files, seeds {first} to {last} "
        "(`benchmarks/mutated_blocks.py`).",
        "",
        f"* {len(faults):,} faults: exceptions, files over the limit of {mutation.CPU_LIMIT_S:.0f} s of processor time, values "
        "that no target can have, values of sound blocks that differ, wrong link types that go unnoticed.",
        f"* Of {whole['sound']:,} sound blocks {whole['missed']:,} were not read, all but {whole['far']:,} next to a mutated "
        "one: what is left of a block may, with the bytes of the next one, make a valid record.",
        f"* {whole['moved']:,} stamps of sound records were taken for those of another day (not looked at in the samples, which "
        "are pieces of several recordings).",
        f"* {whole['damaged']:,} places were told as damaged; {whole['refused']:,} files were refused (a wrong link type).",
        "",
        "| blocks | file | files | mutated | sound | not read | moved | damage told | slowest file, CPU ms |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for (name, form), c in totals.items():
        row = " | ".join(f"{c[k]:,}" for k in ("files", "mutated", "sound", "missed", "moved", "damaged", "slowest_ms"))
        lines.append(f"| {name} | {form} | {row} |")
    categories = sorted({category for _, category in kinds})
    lines += ["", "| mutation | " + " | ".join(f"{c:03d}" for c in categories) + " | all |"]
    lines.append("|---|" + "---:|" * (len(categories) + 1))
    for kind in (*mutation.KINDS, *mutation.PACKET_KINDS):
        row = [kinds[kind, c] for c in categories]
        lines.append(f"| {kind} | " + " | ".join(f"{n:,}" for n in (*row, sum(row))) + " |")
    lines += ["", *[f"* {fault}" for fault in faults]] if faults else []
    return "\n".join(lines)


if __name__ == "__main__":
    main()
