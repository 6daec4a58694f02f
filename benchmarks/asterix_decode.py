"""How fast CAT048 records become Plots, beside other libraries in the same run; captures against raw blocks; memory.

    python benchmarks/asterix_decode.py [FILE] [--records N] [--json]

Ours is `decode`: bytes to every column of Plots, in one thread.  libasterix and (where it is importable: it is no dependency)
aviconv-asterix parse the same blocks into their record objects, without columns.  Then the same blocks are read from a file, and
from a pcap file with a block a packet; the peak of the memory is the kernel's word (Linux) on a process that does nothing but
read the raw file, less what it takes to import the package and compile.  Times are of the processor.  Without FILE, and without a
CAT048 recording at $BORESIGHT_DATA, records are made up: a Mode S radar with the items of a typical European one.

Measured on two cores shared with other work, on an hour of a Mode S radar (44,085 records) in three runs: ours 1.00 to 1.34
million records/s, libasterix 3,300 to 4,600 (ratio 260 to 400), aviconv-asterix 0.4.0 19,500 to 31,000 (ratio 43 to 51); a file
of raw blocks 0.83 to 1.00 million/s, the same as pcap 0.71 million/s (0.86 of raw); peak memory 2.2 times the columns of a
million.
"""

from __future__ import annotations

import argparse
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import fields
from pathlib import Path

import numpy as np

from boresight.reading.asterix import DecodeState, decode, read_asterix

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


def blocks_of(data: bytes) -> list[bytes]:
    out, at = [], 0
    while at < len(data):
        end = at + int.from_bytes(data[at + 1 : at + 3], "big")
        out.append(data[at:end])
        at = end
    return out


def ours(data: bytes, seconds: float) -> tuple[float, float]:
    """Records a second (the best of repeated runs), and the seconds of the first run with compilation."""
    begin = DecodeState.begin()
    start = time.process_time()
    records, _, _ = decode(data, begin, final=True)
    first = time.process_time() - start
    best = float("inf")
    stop = time.perf_counter() + seconds
    while time.perf_counter() < stop or best == float("inf"):
        start = time.process_time()
        records, _, _ = decode(data, begin, final=True)
        best = min(best, time.process_time() - start)
    assert len(records.plots) == len(records.offset)
    return len(records.plots) / best, first


def libasterix(blocks: list[bytes], seconds: float) -> float:
    """Records a second that libasterix parses."""
    from asterix.base import Bits
    from asterix.generated import manifest

    uap = manifest["CATS"][48][-1].cv_uap
    done = 0
    start = time.process_time()
    for block in blocks:
        done += len(uap.parse(Bits.from_bytes(block[3:])))
        if time.process_time() - start > seconds:
            break
    return done / (time.process_time() - start)


def aviconv(data: bytes, records: int, blocks: list[bytes], seconds: float) -> float | None:
    """Records a second that aviconv-asterix decodes; None where it is not installed."""
    try:
        from aviconv_asterix import iter_records
    except ImportError:
        return None
    some = b"".join(blocks[: max(1, int(len(blocks) * min(1.0, 20_000 * seconds / records)))])
    start = time.process_time()
    done = sum(1 for _ in iter_records(some))
    return done / (time.process_time() - start)


def captured(blocks: list[bytes]) -> bytes:
    """The blocks as a capture of UDP over Ethernet, one a packet."""
    out = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, 1)]
    for k, block in enumerate(blocks):
        size = len(block)
        udp = struct.pack(">HHHH", 30000, 8600, size + 8, 0)
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, size + 28, k & 0xFFFF, 0, 9, 17, 0, b"\x0a\0\0\1", b"\xe0\0\0\2")
        head = struct.pack("<IIII", 1_700_000_000 + k // 400, k % 400 * 2500, size + 42, size + 42)
        out += [head, bytes(12), b"\x08\0", ip, udp, block]
    return b"".join(out)


def reading(path: Path, seconds: float) -> float:
    """Plots a second from a file (the best of repeated runs)."""
    plots = len(read_asterix(path).plots)
    best, stop = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < stop or best == float("inf"):
        start = time.process_time()
        read_asterix(path)
        best = min(best, time.process_time() - start)
    return plots / best


_PEAK = """
import sys
from boresight.reading.asterix import read_asterix
def told(name):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(name)) * 1024
read_asterix(sys.argv[2])
before = told("VmRSS")
read_asterix(sys.argv[1])
print(told("VmHWM") - before)
"""


def memory(path: Path, small: Path) -> tuple[int, int]:
    """The bytes that reading a file takes at most, and those of the columns that are left; `small` warms up."""
    out = subprocess.run([sys.executable, "-c", _PEAK, str(path), str(small)], check=True, capture_output=True, text=True)
    found = read_asterix(path)
    columns = sum(getattr(found.plots, f.name).nbytes for f in fields(found.plots)) + found.offset.nbytes + found.receive_s.nbytes
    return int(out.stdout), columns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", nargs="?")
    parser.add_argument("--records", type=int, default=50_000, help="how many records to make up")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--memory", type=int, default=1_000_000, help="records of the file whose reading is weighed")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one second each")
    options = parser.parse_args()
    if options.quick:
        options.seconds, options.memory = 1.0, 300_000
    data, what = load(options.file, options.records)
    blocks = blocks_of(data)
    rate, first = ours(data, options.seconds)
    records = len(decode(data, DecodeState.begin(), final=True)[0].offset)
    peers = {
        "libasterix": libasterix(blocks, options.seconds),
        "aviconv-asterix": aviconv(data, records, blocks, options.seconds),
    }
    with tempfile.TemporaryDirectory() as folder:
        small, large, capture = (Path(folder) / name for name in ("small.ast", "large.ast", "large.pcap"))
        small.write_bytes(data)
        times = -(-options.memory // records)
        with large.open("wb") as file:
            for _ in range(times):
                file.write(data)
        capture.write_bytes(captured(blocks * max(1, 300_000 // records)))
        raw = Path(folder) / "raw.ast"
        raw.write_bytes(data * max(1, 300_000 // records))
        from_raw, from_pcap = reading(raw, options.seconds), reading(capture, options.seconds)
        peak, columns = memory(large, small)
    result = {
        "name": "asterix_decode",
        "ours": round(rate),
        "unit": "CAT048 records/s into Plots",
        "peers": {name: round(one) for name, one in peers.items() if one},
        "ratio": {name: round(rate / one, 1) for name, one in peers.items() if one},
        "first_run_s": round(first, 2),
        "raw_file": round(from_raw),
        "pcap_file": round(from_pcap),
        "pcap_to_raw": round(from_pcap / from_raw, 2),
        "peak_to_columns": round(peak / columns, 2),
        "data": what,
    }
    if options.json:
        print(json.dumps(result))
        return
    print(f"{what}: CAT048 records a second of the processor")
    print(f"  boresight, into every column of Plots  {rate:12,.0f}   (first run, with compilation: {first:.1f} s)")
    for name, one in peers.items():
        if one is None:
            print(f"  {name:38s}            -   (not installed)")
        else:
            print(f"  {name + ', into its record objects':38s} {one:12,.0f}   (ours is {rate / one:,.0f} times as fast)")
    print(f"  from a file of raw blocks              {from_raw:12,.0f}")
    print(f"  from a pcap file, a block a packet     {from_pcap:12,.0f}   ({from_pcap / from_raw:.2f} of raw)")
    print(f"  peak memory of {times * records:,} records: {peak / 1e6:,.0f} MB, {peak / columns:.2f} times their columns")


if __name__ == "__main__":
    main()
