"""Mutated data blocks: files of them in every wrapping, and what must hold of every such file.

Sound blocks come from the product's own writer, from the tables of the categories that it does not write, and from recordings.
A mutation spoils one block (or the packet that it lies in); the others must all be read, as in the sound file.
"""

from __future__ import annotations

import datetime
import random
import struct
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from test_asterix import block, blocks_of, number, old_plot, old_track, record, tod
from test_capture import ethernet, ip4, udp

from boresight.errors import InputError
from boresight.model import Channel, Fixes, Flag, Plots, Recording
from boresight.reading import uap
from boresight.reading.asterix import DecodeState, decode, decode_items, read_asterix
from boresight.reading.capture import Tally, kind_of, portions
from boresight.writing.asterix import Marks, encode_asterix

DATE = datetime.date(2016, 5, 10)
MIDNIGHT = 1462838400.0
KINDS = (
    "cut", "zeros", "random bytes", "bit flips", "bytes put in", "wrong length", "endless FSPEC", "huge repetition",
    "wrong category", "dropped", "doubled",
)  # fmt: skip
PACKET_KINDS = ("packet header", "packet cut", "packet time", "bytes between")
FORMATS = ("raw", "pcap", "pcapng", "final", "gps")
TABLES = ("plots", "fixes", "tracks", "marks")
CPU_LIMIT_S = 20.0
KNOWN = frozenset(uap.categories())


# ------------------------------------------------------------------------------------------------------------- sound blocks


def written_pool(seed: int, n: int = 3000) -> list[bytes]:
    """Blocks of the product's own writer: two radars of categories 048 and 010 with their marks (034), and ADS-B (021)."""
    rng = np.random.default_rng(seed)
    t = MIDNIGHT + 7200.0 + np.sort(rng.uniform(0, n / 10, n))
    target = rng.integers(0, 60, n)
    some = rng.random(n) < 0.7
    plots = Plots(
        time_s=t, sensor=np.full(n, 20 << 8 | 129), channel=rng.choice([Channel.PSR, Channel.MODE_S, Channel.MODE_S_PSR], n),
        range_m=rng.uniform(1e3, 4e5, n), azimuth_rad=rng.uniform(0, 6.28, n), mode_s=np.where(some, 0x340000 + target, -1),
        mode_3a=np.where(some, target * 8 + 1, -1), pressure_altitude_m=np.where(some, rng.uniform(0, 12e3, n), np.nan),
        psr_ssr_range_m=np.where(some, rng.normal(190, 60, n), np.nan), track=target, speed_mps=rng.uniform(50, 250, n),
        heading_rad=rng.uniform(0, 6.28, n), flags=np.where(rng.random(n) < 0.02, int(Flag.TEST), 0),
    )  # fmt: skip
    surface = Plots(
        time_s=t, sensor=np.full(n, 7), channel=np.full(n, Channel.PSR), range_m=rng.uniform(50, 3e3, n),
        azimuth_rad=rng.uniform(0, 6.28, n), length_m=rng.integers(5, 70, n), track=target,
    )  # fmt: skip
    fixes = Fixes(
        time_s=t, source=np.full(n, 20 << 8 | 3), channel=np.full(n, Channel.ADS_B), mode_s=0x340000 + target,
        latitude_rad=np.radians(rng.uniform(40, 43, n)), longitude_rad=np.radians(rng.uniform(0, 4, n)),
        height_m=rng.uniform(0, 12e3, n), pressure_altitude_m=rng.uniform(0, 12e3, n), horizontal_sd_m=np.full(n, 4.0),
        velocity_east_mps=rng.normal(0, 100, n), velocity_north_mps=rng.normal(0, 100, n),
    )  # fmt: skip
    turns = np.arange(t[0], t[-1], 0.5)
    sector = np.where(np.arange(len(turns)) % 8, np.arange(len(turns)) % 8 * np.pi / 4, np.nan)
    marks = Marks(
        turns, np.full(len(turns), 20 << 8 | 129), sector, np.full(len(turns), 4.0), *(np.full(len(turns), np.nan),) * 3
    )
    out: list[tuple[float, int, bytes]] = []
    for tables, category in (({"plots": plots, "fixes": fixes, "marks": marks}, 48), ({"plots": surface}, 10)):
        data, _ = encode_asterix(**tables, category=category, records_per_block=3)
        out += [(stamp_of(one), k, one) for k, one in enumerate(blocks_of(data))]
    return [one for _, _, one in sorted(out)]


def table_pool(seed: int, n: int = 3000) -> list[bytes]:
    """Blocks of the categories that the product does not write: 001, 002, 062, 063, 065, with many items each."""
    rng = np.random.default_rng(seed)

    def old() -> dict[str, bytes]:
        return {"070": rng.bytes(2), "090": number(int(rng.integers(0, 1600)), 2), "131": rng.bytes(1)}

    out = []
    for k in range(n):
        t = 7200.0 + k * 0.1
        if k % 6 < 2:
            out.append(block(1, *(old_plot(t, old()) if j % 2 else old_track(t, old()) for j in range(1 + k % 3))))
        elif k % 6 == 2:
            mark = {"010": b"\x19\xc9", "000": b"\2", "030": tod(t), "020": rng.bytes(1), "041": rng.bytes(2)}
            out.append(block(2, record(2, "1.x", mark | ({"070": b"\2" + rng.bytes(4)} if k % 4 else {}))))
        elif k % 6 == 3:
            status = {"010": b"\x19\x64", "030": tod(t), "050": b"\x19\xc9", "060": b"\0", "081": rng.bytes(2)}
            out.append(block(63, record(63, "1.x", status)))
        elif k % 6 == 4:
            status = {"010": b"\x19\x64", "000": b"\2", "015": b"\1", "030": tod(t), "020": rng.bytes(1)}
            out.append(block(65, record(65, "1.x", status)))
        else:
            place = [number(round(rng.uniform(-80, 80) * 2**25 / 180), 4) for _ in range(2)]
            track = {
                "010": b"\x19\x64", "070": tod(t), "105": b"".join(place),
                "185": rng.bytes(4), "380": b"\xc0" + rng.bytes(9), "040": rng.bytes(2), "080": b"\0",
                "290": b"\x60" + rng.bytes(2), "136": number(int(rng.integers(0, 1600)), 2), "500": b"\x80" + rng.bytes(4),
            }  # fmt: skip
            out.append(block(62, record(62, "1.x", track), record(62, "1.x", track | {"510": b"\3\5\4"})))
    return out


def recorded_pools(folder: Path) -> dict[str, list[bytes]]:
    """Blocks of all recordings of ASTERIX below a folder; the small ones, of several radars, together."""
    out: dict[str, list[bytes]] = {}
    small: list[bytes] = []
    for path in sorted([*folder.rglob("*.ast"), *folder.rglob("*.raw"), *folder.rglob("*.pcap"), *folder.rglob("*.gps")]):
        data = path.read_bytes()
        kind = kind_of(data[: 1 << 20], len(data), KNOWN)
        parts = [data] if kind == "raw" else [p.data.tobytes() for p in portions(path, kind, Tally(), KNOWN)]
        found: list[bytes] = []
        for part in parts:
            if sum(int.from_bytes(part[k : k + 2], "big") for k in starts(part)) == len(part):
                found += blocks_of(part)
        if len(found) > 1000:
            out[path.stem] = found
        else:
            small += found
    # The small samples have blocks that their category, in the edition of the others, cannot hold; only sound ones serve here.
    small = [one for one in small if one[0] in KNOWN]
    begin = np.cumsum([0, *(len(one) for one in small)])
    wrong = [d.offset for d in decode(b"".join(small), DecodeState.begin(), final=True)[0].damaged]
    spoilt = set((np.searchsorted(begin, wrong, side="right") - 1).tolist())
    small = [one for k, one in enumerate(small) if k not in spoilt]
    out["samples"] = small * (1 + 3000 // max(1, len(small)))
    return {name: blocks for name, blocks in out.items() if blocks}


def starts(data: bytes) -> list[int]:
    """Where the lengths of blocks stand that follow each other from the data's first byte on."""
    out, at = [], 0
    while at + 3 <= len(data):
        out.append(at + 1)
        at += max(3, int.from_bytes(data[at + 1 : at + 3], "big"))
    return out


def stamp_of(one: bytes) -> float:
    """The time of day of a block's first record, where its category tells it in the usual item."""
    place = {48: "140", 10: "140", 20: "140", 34: "030", 21: "071", 2: "030", 62: "070"}.get(one[0], "140")
    items = next(iter(decode_items(one)), None)
    raw = items.items.get(place) if items is not None else None
    return int.from_bytes(raw, "big") / 128 if raw and len(raw) == 3 else 7200.0


# ----------------------------------------------------------------------------------------------------------------- mutations


def repetitions(one: bytes) -> list[int]:
    """Where in a block the counts of its repetitive items stand."""
    out = []
    for rec in decode_items(one):
        items = {item.name: item for item in uap.items_of(rec.form, rec.edition) if item is not None}
        raw = one[rec.offset :]
        for name, content in rec.items.items():
            if "/" not in name and items[name].kind == uap.REPETITIVE:
                at = raw.find(content)
                out.append(rec.offset + at)
    return out


def mutated(rng: random.Random, one: bytes, kind: str) -> bytes:
    """A block spoilt in one way; never the same bytes again, but for "doubled" (twice) and "dropped" (nothing)."""
    b = bytearray(one)
    at = rng.randrange(len(b))
    run = rng.randrange(1, 12)
    if kind == "cut":
        del b[max(1, at) :]
    elif kind == "zeros":
        b[at : at + run] = bytes(len(b[at : at + run]))
    elif kind == "random bytes":
        b[at : at + run] = rng.randbytes(len(b[at : at + run]))
    elif kind == "bit flips":
        for _ in range(rng.choice((1, 1, 2, 5, 16))):
            b[rng.randrange(len(b))] ^= 1 << rng.randrange(8)
    elif kind == "bytes put in":
        b[at:at] = rng.randbytes(run)
    elif kind == "wrong length":
        b[1:3] = rng.choice((rng.randrange(65536), max(0, len(b) + rng.choice((-3, -1, 1, 2, 7, 40))), 0, 65535)).to_bytes(
            2, "big"
        )
    elif kind == "endless FSPEC":
        reach = rng.choice((len(b), 12, 6))
        b[3:reach] = b"\xff" * len(b[3:reach])
    elif kind == "huge repetition":
        places = repetitions(one)
        if places:
            b[rng.choice(places)] = rng.choice((255, 200, 100))
        else:
            # A record with item 250 of category 048, 255 times, where there are but a few bytes.
            more = b"\xf1\x20" + one[4:6] + rng.randbytes(8) + b"\xff" + rng.randbytes(rng.randrange(20))
            b = bytearray(bytes([48]) + (3 + len(more)).to_bytes(2, "big") + more)
    elif kind == "wrong category":
        b[0] = rng.choice([c for c in (*KNOWN, 0, 23, 247, 255) if c != b[0]])
    elif kind == "dropped":
        return b""
    elif kind == "doubled":
        return bytes(one + one)
    if bytes(b) == one:
        b[at] ^= 0x55
    return bytes(b)


# -------------------------------------------------------------------------------------------------------------------- files


@dataclass(slots=True)
class Made:
    """A file of blocks, mutated or not.

    Sound blocks are `block` (k,; their numbers) at `place` (k,; their offset in the file); `kinds` counts the mutated ones by
    kind and category.
    """

    data: bytes
    block: np.ndarray
    place: np.ndarray
    kinds: Counter[tuple[str, int]] = field(default_factory=Counter)
    link: int = 1


def make(rng: random.Random, blocks: list[bytes], stamps: list[float], form: str, share: float, ending: str = "") -> Made:
    """A file of `form` of which about `share` of the blocks are mutated; `ending` "half" cuts it, "link" gives a wrong link."""
    out: list[bytes] = []
    place: list[int] = []
    which: list[int] = []
    kinds: Counter[tuple[str, int]] = Counter()
    at = 0

    def put(part: bytes) -> None:
        nonlocal at
        out.append(part)
        at += len(part)

    link = rng.choice((101, 105, 113, 189)) if ending == "link" else 1
    if form == "pcap":
        put(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 1 << 18, link))
    elif form == "pcapng":
        put(_section(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)) + _section(1, struct.pack("<HHI", link, 0, 0)))
    elif form == "gps":
        put(b"\xcd" * 2200)
    choices = [*KINDS, *(PACKET_KINDS if form in ("pcap", "pcapng") else ())]
    k = 0
    while k < len(blocks):
        group = 1 if form in ("raw", "gps", "final") else rng.choice((1, 1, 1, 2, 3))
        content, sound, spoil = b"", [], ""
        stamp = stamps[k]
        for which_one in range(k, min(k + group, len(blocks))):
            one = blocks[which_one]
            if rng.random() < share:
                kind = rng.choice(choices)
                kinds[kind, one[0]] += 1
                if kind in PACKET_KINDS:
                    spoil = spoil or kind
                    content += one
                    continue
                if kind == "doubled":
                    sound += [(which_one, len(content)), (which_one, len(content) + len(one))]
                    if form == "gps":
                        # Each block has a trailer of its own.
                        sound[1] = (which_one, len(content) + len(one) + 10)
                        content += one + _wrapped(rng, one, stamp, form, "")[1]
                        kind = ""
                content += one if not kind else mutated(rng, one, kind)
            else:
                sound.append((which_one, len(content)))
                content += one
        k += group
        if spoil in ("packet header", "packet cut"):
            # What else is in the packet is mutated with it.
            for which_one, _ in sound:
                kinds[spoil, blocks[which_one][0]] += 1
            sound = []
        if not content:
            continue
        if spoil == "bytes between":
            put(rng.randbytes(rng.randrange(1, 60)))
        head, tail = _wrapped(rng, content, stamp, form, spoil)
        begin = at + len(head)
        put(head + content + tail)
        which += [which_one for which_one, _ in sound]
        place += [begin + p for _, p in sound]
    data = b"".join(out)
    blocks_at, places = np.array(which, np.int64), np.array(place, np.int64)
    if ending == "half":
        data = data[: rng.randrange(len(data) // 3, len(data))]
        sizes = np.array([len(b) for b in blocks])
        # The packet that is cut is lost as a whole.
        there = places + sizes[blocks_at] + 4 + 4 < len(data) - (0 if form == "raw" else 200)
        blocks_at, places = blocks_at[there], places[there]
    return Made(data, blocks_at, places, kinds, link)


def _section(number: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack("<II", number, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def _wrapped(rng: random.Random, content: bytes, stamp: float, form: str, spoil: str) -> tuple[bytes, bytes]:
    """What stands ahead of and behind the content in a file of `form`."""
    if form == "raw":
        return b"", b""
    if form == "final":
        return (len(content) + 12).to_bytes(2, "big") + bytes(3) + round(stamp % 86400 * 100).to_bytes(3, "big"), b"\xa5" * 4
    if form == "gps":
        return b"", b"\x11\xd2\x8f\x0a\0\0" + tod(stamp % 86400) + b"\0"
    frame = ethernet(ip4(udp(content)))
    head = frame[: len(frame) - len(content)]
    moment = stamp + 0.25
    if spoil == "packet time":
        moment = float(rng.choice((0, 2**31, 2**32 - 1)))
    size, pad = len(frame), -len(frame) % 4
    if form == "pcap":
        own = bytearray(struct.pack("<IIII", int(moment), int(moment % 1 * 1e6), size, size))
    else:
        own = bytearray(struct.pack("<IIIIIII", 6, size + 32 + pad, 0, *divmod(int(moment * 1e6), 2**32), size, size))
    if spoil == "packet header":
        own[rng.randrange(len(own))] ^= rng.randrange(1, 256)
    elif spoil == "packet cut":
        # The packet's header is right, the lengths of IP and UDP are not.
        one, two = (rng.randrange(65536).to_bytes(2, "big") for _ in range(2))
        head = head[:16] + one + head[18:38] + two + head[40:]
    return bytes(own) + head, b"" if form == "pcap" else bytes(pad) + struct.pack("<I", size + 32 + pad)


# -------------------------------------------------------------------------------------------------------------------- oracle


@dataclass(slots=True)
class Sound:
    """What the sound file of some blocks gives: of each record its block and its place there, and the rows of its tables.

    `steady` says that its stamps go on as those of one recording do: else nothing tells the day of a damaged one.
    """

    blocks: list[bytes]
    stamps: list[float]
    recording: Recording
    block: np.ndarray
    inside: np.ndarray
    steady: bool

    @classmethod
    def of(cls, blocks: list[bytes], folder: Path) -> Sound:
        path = folder / "sound.ast"
        path.write_bytes(b"".join(blocks))
        recording = read_asterix(path, date=DATE)
        begin = np.cumsum([0, *(len(b) for b in blocks)])
        which = np.searchsorted(begin, recording.offset, side="right") - 1
        assert not recording.damaged, recording.damaged[:3]
        seen = np.full(recording.records, np.nan)
        for name in TABLES:
            table = getattr(recording, name)
            seen[table.record] = table.time_s
        stamps = np.full(len(blocks), np.nan)
        stamps[which[::-1]] = seen[::-1]
        known = np.flatnonzero(np.isfinite(stamps))
        filled = np.interp(np.arange(len(blocks)), known, stamps[known]) if len(known) else np.full(len(blocks), MIDNIGHT + 7200)
        steady = bool((np.abs(np.diff(stamps[known])) < 60).all())
        return cls(blocks, filled.tolist(), recording, which, recording.offset - begin[which], steady)


# A stamp that was mutated can move the completed time of what follows it, where only parts of a time are told.
TRUNCATED = {1}


@dataclass(slots=True)
class Result:
    """What came of one file."""

    sound: int = 0
    missed: int = 0
    far: int = 0
    moved: int = 0
    damaged: int = 0
    records: int = 0
    refused: str = ""
    cpu_s: float = 0.0
    faults: list[str] = field(default_factory=list)


def check(made: Made, sound: Sound, path: Path) -> Result:
    """Read a made file and hold it against the sound one; `faults` names what must not be."""
    out = Result(sound=len(made.block))
    path.write_bytes(made.data)
    begin = time.process_time()
    try:
        found = read_asterix(path, date=DATE)
    except InputError as error:
        out.refused = str(error).partition(": ")[2]
        out.cpu_s = time.process_time() - begin
        if made.link == 1 and len(made.block):
            out.faults.append(f"refused: {out.refused}")
        return out
    out.cpu_s = time.process_time() - begin
    if out.cpu_s > CPU_LIMIT_S:
        out.faults.append(f"took {out.cpu_s:.1f} s of processor time")
    out.damaged, out.records = len(found.damaged), found.records
    out.faults += [fault for fault in implausible(found) if sound.steady or "time_s" not in fault]
    if made.link != 1:
        out.faults.append("a wrong link type went unnoticed")
        return out
    # Every record of a sound block is there.
    order = np.argsort(sound.block, kind="stable")
    counts = np.bincount(sound.block, minlength=len(sound.blocks))
    first = np.cumsum(counts) - counts
    each = counts[made.block]
    row = order[np.repeat(first[made.block] - (np.cumsum(each) - each), each) + np.arange(each.sum())]
    expected = np.repeat(made.place, each) + sound.inside[row]
    there = np.isin(expected, found.offset)
    owner = np.repeat(np.arange(len(made.block)), each)
    read = np.ones(len(made.block), bool)
    np.logical_and.at(read, owner, there)
    # And its rows are those of the sound file.
    back = np.full(sound.recording.records, -1, np.int64)
    at = {int(o): k for k, o in enumerate(found.offset.tolist())}
    for name in TABLES:
        mine, theirs = getattr(found, name), getattr(sound.recording, name)
        of_record = np.full(found.records + 1, -1, np.int64)
        of_record[mine.record] = np.arange(len(mine))
        back[:] = -1
        back[theirs.record] = np.arange(len(theirs))
        wanted = back[row]
        use = there & (wanted >= 0)
        here = of_record[np.array([at[o] for o in expected[use].tolist()], np.int64)]
        # Bytes of a mutated block ahead may make another record at the same place.
        read[owner[use][here < 0]] = False
        use[np.flatnonzero(use)[here < 0]] = False
        here = here[here >= 0]
        for (column, x), (_, y) in zip(mine._flat(), theirs._flat(), strict=True):
            if column == "record" or (column == "time_s" and not sound.steady):
                continue
            x, y = x[here], y[wanted[use]]
            same = (x == y) | ((x != x) & (y != y))
            if same.all():
                continue
            if column == "time_s":
                whose = np.array([sound.blocks[b][0] for b in made.block[owner[use]]])
                out.moved += int(np.count_nonzero(~same & ~np.isin(whose, list(TRUNCATED))))
            else:
                out.faults.append(f"{np.count_nonzero(~same)} values of {name}.{column} of sound blocks differ")
    out.missed = int(np.count_nonzero(~read))
    # A sound block may only be missed right behind (or ahead of) a mutated one.
    joined = made.place[1:] == made.place[:-1] + np.array([len(sound.blocks[b]) for b in made.block[:-1]], np.int64)
    guarded = np.r_[False, joined] & np.r_[joined, False]
    out.far = int(np.count_nonzero(~read & guarded))
    return out


def implausible(found: Recording) -> list[str]:
    """What no target can be, in any row: each is a fault."""
    turn, limits = 2 * np.pi, {}
    limits["time_s"] = (MIDNIGHT - 3 * 86400.0, MIDNIGHT + 3 * 86400.0)
    limits |= {"range_m": (0.0, 512 * 1852.0), "azimuth_rad": (0.0, turn), "heading_rad": (0.0, turn)}
    limits |= {"latitude_rad": (-turn / 4, turn / 4), "longitude_rad": (-turn / 2, turn / 2)}
    limits |= {"pressure_altitude_m": (-457.2, 45720.0), "height_m": (-700.0, 46000.0), "speed_mps": (0.0, 2000.0)}
    limits |= {f"velocity_{name}_mps": (-2000.0, 2000.0) for name in ("east", "north")}
    limits |= {"velocity_up_mps": (-500.0, 500.0), "mode_3a": (-1, 0o7777), "mode_s": (-1, 0xFFFFFF)}
    out = []
    for name in TABLES:
        table: Any = getattr(found, name)
        for column, value in table._flat():
            if value.dtype.kind == "f" and np.isinf(value).any():
                out.append(f"{name}.{column} is infinite")
            if column in limits:
                low, high = limits[column]
                wrong = (value < low) | (value > high)
                if wrong.any():
                    out.append(f"{np.count_nonzero(wrong)} values of {name}.{column} are impossible ({value[wrong][0]})")
    return out


# ---------------------------------------------------------------------------------------------------------------------- runs

# Blocks of a file, and the share of mutated blocks that may cost a sound neighbour.
FILE, MISSED = 1000, 0.01


def pools(recordings: Path | None, folder: Path) -> dict[str, list[Sound]]:
    """Runs of sound blocks with what their sound files give, by where they come from; `recordings` may be none."""
    found = {"written": written_pool(1), "other categories": table_pool(1)}
    if recordings is not None:
        found |= recorded_pools(recordings)
    out: dict[str, list[Sound]] = {}
    for name, blocks in found.items():
        last = max(1, len(blocks) - FILE)
        out[name] = [Sound.of(blocks[k : k + FILE], folder) for k in sorted({0, last // 3, last // 2, last})]
    return out


def one_file(rng: random.Random, pool: list[Sound], form: str) -> tuple[Made, Sound]:
    """A mutated file of some blocks of the pool."""
    sound = rng.choice(pool)
    endings = ("", "", "", "", "half", "link") if form in ("pcap", "pcapng") else ("", "", "", "half")
    return make(rng, sound.blocks, sound.stamps, form, rng.choice((0.05, 0.2, 0.2, 0.5)), rng.choice(endings)), sound
