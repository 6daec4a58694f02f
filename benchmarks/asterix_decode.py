"""How fast CAT048 records become Plots, beside libasterix in the same run.

    python benchmarks/asterix_decode.py [FILE] [--records N] [--json]

Ours is `decode`: bytes to every column of Plots, in one thread.  libasterix parses the same blocks into its record objects (no
columns).  Without FILE, and without a CAT048 recording at $BORESIGHT_DATA, records are made up: a Mode S radar with the items of
a typical European one.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

from boresight.reading.asterix import DecodeState, decode

RECORDING = "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast"


def made_up(records: int) -> bytes:
    """CAT048 blocks of one record: the items 010, 140, 020, 040, 070, 090, 130, 220, 240, 250, 161, 200, 170 and 230."""
    rng = np.random.default_rng(1)
    out = bytearray()
    for k in range(records):
        body = bytes([0xFF, 0xF7, 0x02, 20, 129]) + int(k * 0.08 * 128 % (86400 * 128)).to_bytes(3, "big") + b"\xe0"
        body += rng.bytes(4) + b"\x08\x04\x05\xc8" + b"\xfe" + rng.bytes(7) + rng.bytes(3) + b"\x48\xf5\x34\xc7\x58\x20"
        body += b"\x02" + rng.bytes(16) + b"\x07\x83" + rng.bytes(4) + b"\x06" + b"\x20\xfd"
        # FSPEC: 010 140 020 040 070 090 130 | 220 240 250 161 - 200 170 | 230.
        out += b"\x30" + (len(body) + 3).to_bytes(2, "big") + body
    return bytes(out)


def load(path: str | None, records: int) -> tuple[bytes, str]:
    folder = os.environ.get("BORESIGHT_DATA")
    if path is None and folder and (Path(folder) / RECORDING).is_file():
        path = str(Path(folder) / RECORDING)
    if path is None:
        return made_up(records), f"{records} made-up records"
    return Path(path).read_bytes(), Path(path).name


def ours(data: bytes, seconds: float) -> tuple[float, float]:
    """Records a second (the best of repeated runs), and the seconds of the first run with compilation."""
    begin = DecodeState.begin()
    start = time.perf_counter()
    records, _, _ = decode(data, begin, final=True)
    first = time.perf_counter() - start
    best = float("inf")
    stop = time.perf_counter() + seconds
    while time.perf_counter() < stop or best == float("inf"):
        start = time.perf_counter()
        records, _, _ = decode(data, begin, final=True)
        best = min(best, time.perf_counter() - start)
    assert len(records.plots) == len(records.offset)
    return len(records.plots) / best, first


def libasterix(data: bytes, seconds: float) -> float:
    """Records a second that libasterix parses."""
    from asterix.base import Bits
    from asterix.generated import manifest

    uap = manifest["CATS"][48][-1].cv_uap
    at = done = 0
    start = time.perf_counter()
    while at < len(data) and time.perf_counter() - start < seconds:
        end = at + int.from_bytes(data[at + 1 : at + 3], "big")
        done += len(uap.parse(Bits.from_bytes(data[at + 3 : end])))
        at = end
    return done / (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", nargs="?")
    parser.add_argument("--records", type=int, default=50_000)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one second each")
    options = parser.parse_args()
    if options.quick:
        options.seconds = 1.0
    data, what = load(options.file, options.records)
    rate, first = ours(data, options.seconds)
    peer = libasterix(data, options.seconds)
    if options.json:
        result = {
            "name": "asterix_decode",
            "ours": round(rate),
            "unit": "CAT048 records/s into Plots",
            "peers": {"libasterix": round(peer)},
            "ratio": {"libasterix": round(rate / peer, 1)},
            "first_run_s": round(first, 2),
            "data": what,
        }
        print(json.dumps(result))
        return
    print(f"{what}: CAT048 records a second")
    print(f"  boresight, into every column of Plots  {rate:12,.0f}   (first run, with compilation: {first:.1f} s)")
    print(f"  libasterix, into its record objects    {peer:12,.0f}")
    print(f"  ratio                                  {rate / peer:12,.0f}")


if __name__ == "__main__":
    main()
