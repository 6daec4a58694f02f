"""The category tables and the decoder against libasterix: item by item, bit by bit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.model import unpack_callsigns
from boresight.reading import capture, read, uap
from boresight.reading.asterix import ItemRecord, decode_items

base = pytest.importorskip("asterix.base")
generated = pytest.importorskip("asterix.generated")

# Editions of libasterix that each of our tables must agree with.
EDITIONS = {
    (1, "1.x"): [(1, 2), (1, 3), (1, 4)],
    (2, "1.x"): [(1, 0), (1, 1), (1, 2)],
    (10, "1.1"): [(1, 1)],
    (19, "1.3"): [(1, 3)],
    (20, "1.x"): [(1, 9), (1, 10), (1, 11)],
    (21, "2.x"): [(2, 2), (2, 3), (2, 4), (2, 5), (2, 6), (2, 7)],
    (21, "2.1"): [(2, 1)],
    (21, "0.23"): [(0, 23)],
    (21, "0.25"): [(0, 24), (0, 25)],
    (21, "0.26"): [(0, 26)],
    (34, "1.x"): [(1, 27), (1, 28), (1, 29)],
    (48, "1.x"): [(1, n) for n in range(27, 33)],
    (62, "1.x"): [(1, n) for n in range(16, 22)],
    (63, "1.x"): [(1, 6), (1, 7)],
    (65, "1.x"): [(1, 4), (1, 5), (1, 6)],
}
# Where we differ on purpose.  EUROCONTROL's category 010 has velocity at 0.25 m/s and acceleration at 0.25 m/s2 (ranges of 8,192
# m/s and 31 m/s2 in 16 and 8 bits); libasterix has a quarter of that.  `test_the_velocity_of_category_010…` shows who is right.
LSB = {("010", "202"): 4.0, ("010", "210"): 4.0}
# What later editions call by another name.
RENAMED = {"ISA": "SAL", "MB": "BDSDATA", "MBDATA": "BDSDATA", "BDSREGISTER": "BDSDATA"}
# The flight level of category 048 is signed; the earlier editions of libasterix have it unsigned.  The position accuracy of
# category 021 before edition 1 is a class, and its number has no sign.
UNSIGNED_OR_NOT = {(48, "090", "FL"), (21, "090", "PA"), (62, "HEIGHT", "HEIGHT")}


def spec_of(category: int, edition: tuple[int, int]) -> Any:
    return next(c for c in generated.manifest["CATS"][category] if c.cv_edition == edition)


# ------------------------------------------------------------------------------------------------- what libasterix has, flat


def variation_of(rule: Any) -> Any:
    return rule.cv_default_variation if issubclass(rule, base.RuleVariationDependent) else rule.cv_variation


def leaves(entry: Any, prefix: str = "") -> Iterator[tuple[str, int, Any]]:
    """(name, bits, content) of an item of a group, spares as None; groups inside are joined with an underscore."""
    if isinstance(entry, tuple):
        entry = entry[0]
    if issubclass(entry, base.Spare):
        yield "", entry.cv_bit_size, None
        return
    spec = entry.cv_non_spare
    variation = variation_of(spec.cv_rule)
    name = f"{prefix}{spec.cv_name}"
    if issubclass(variation, base.Group):
        for inner in variation.cv_items_list:
            yield from leaves(inner, f"{name}_")
    else:
        yield name, variation.cv_bit_size, variation.cv_rule


def layout(spec: Any) -> tuple[str, int, list[list[tuple[str, int, Any]]]]:
    """(kind, bytes of the first part or of a repetition, leaves by part) of a NonSpare of libasterix."""
    variation = variation_of(spec.cv_rule)
    return flat(variation, spec.cv_name)


def flat(variation: Any, name: str) -> tuple[str, int, list[list[tuple[str, int, Any]]]]:
    if issubclass(variation, base.Element):
        return "fixed", variation.cv_bit_size // 8, [[(name, variation.cv_bit_size, variation.cv_rule)]]
    if issubclass(variation, base.Group):
        found = [leaf for entry in variation.cv_items_list for leaf in leaves(entry)]
        return "fixed", sum(bits for _, bits, _ in found) // 8, [found]
    if issubclass(variation, base.Extended):
        parts = [[leaf for entry in part if entry is not None for leaf in leaves(entry)] for part in variation.cv_items_list]
        closed = [None in part for part in variation.cv_items_list]
        return "extended", (sum(bits for _, bits, _ in parts[0]) + closed[0]) // 8, parts
    if issubclass(variation, base.Repetitive):
        _, size, parts = flat(variation.cv_variation, name)
        if variation.cv_rep_bytes is None:
            return "extended", (sum(bits for _, bits, _ in parts[0]) + 1) // 8, parts
        return "repetitive", size or sum(bits for _, bits, _ in parts[0]) // 8, parts
    if issubclass(variation, base.Explicit):
        return "explicit", 0, []
    assert issubclass(variation, base.Compound)
    return "compound", 0, []


KINDS = ("undefined", "fixed", "extended", "repetitive", "explicit", "compound")


def records_of(category: int, edition: tuple[int, int]) -> dict[int, Any]:
    """The lists of items of a category of libasterix, by the number that ours has."""
    found = spec_of(category, edition).cv_uap
    if issubclass(found, base.UapMultiple):
        return {category: found.cv_uaps["plot"], uap.SECOND[category]: found.cv_uaps["track"]}
    return {category: found.cv_record}


def check_item(category: int, item: uap.Item, spec: Any, path: str) -> int:
    """Compare one item with libasterix's; returns how many fields were compared."""
    kind, size, parts = layout(spec)
    assert (KINDS[item.kind], item.size) == (kind, size), path
    if kind == "compound":
        theirs = variation_of(spec.cv_rule).cv_items_list
        assert len(theirs) == len(item.subitems), path
        count = 0
        for ours, other in zip(item.subitems, theirs, strict=True):
            assert (ours is None) == (other is None), path
            if ours is not None:
                assert ours.name in (other.cv_name, RENAMED.get(other.cv_name)), path
                count += check_item(category, ours, other, f"{path}/{ours.name}")
        return count
    count = 0
    for number, part in enumerate(parts):
        at = 0 if number == 0 else 8 * (item.size + (number - 1) * item.step)
        for name, bits, rule in part:
            mine = [f for f in item.fields if f.bit == at]
            at += bits
            if not name:
                continue
            if not mine:
                # A bit that is spare in our table may have been given a meaning in another edition only.
                raise AssertionError(f"{path}.{name} is missing")
            assert (mine[0].bits, mine[0].part) == (bits, number), f"{path}.{name}"
            assert mine[0].name in (name, RENAMED.get(name)), f"{path}.{name}"
            check_content(category, mine[0], rule, f"{path}.{name}", item.name)
            count += 1
    return count


def check_content(category: int, mine: uap.Field, rule: Any, path: str, item: str) -> None:
    if issubclass(rule, base.RuleContentDependent):
        return
    content = rule.cv_content
    if issubclass(content, base.ContentQuantity):
        factor = LSB.get((f"{category:03d}", item), 1.0)
        assert mine.scaled or (content.cv_lsb, content.cv_unit) == (1, ""), path
        assert mine.lsb == pytest.approx(content.cv_lsb * factor, rel=1e-12), path
        assert UNITS[mine.unit] == content.cv_unit or (mine.unit == "" and content.cv_unit == ""), path
        if (category, item, mine.name) not in UNSIGNED_OR_NOT:
            assert mine.signed == (content.cv_signedness is base.Signed), path
    assert mine.text == (issubclass(content, base.ContentString) and content.cv_string_type is base.StringICAO), path


UNITS = {
    "": "", "NM": "NM", "m": "m", "deg": "°", "s": "s", "FL": "FL", "ft": "ft", "kt": "kt", "m/s": "m/s", "m/s2": "m/s²",
    "NM/s": "NM/s", "ft/min": "ft/min", "deg/s": "°/s", "C": "°C", "dBm": "dBm", "MHz": "MHz",
    "Mach": "Mach", "mb": "mb", "ms": "ms",
}  # fmt: skip


@pytest.mark.parametrize(("category", "table", "edition"), [(c, t, e) for (c, t), es in EDITIONS.items() for e in es])
def test_every_table_has_the_items_lengths_fields_and_units_of_libasterix(
    category: int, table: str, edition: tuple[int, int]
) -> None:
    compared = 0
    for form, theirs in records_of(category, edition).items():
        items = uap.items_of(form, table)
        for mine, other in zip(items, theirs.cv_items_list, strict=True):
            if issubclass(other, base.UapItemRFS):
                assert mine is not None
                assert mine.kind == uap.RANDOM
                continue
            if not issubclass(other, base.UapItem):
                assert mine is None
                continue
            spec = other.cv_non_spare
            assert mine is not None
            assert mine.name == spec.cv_name
            compared += check_item(form, mine, spec, f"{form:03d}/{mine.name}")
    assert compared >= (12 if category in (2, 65) else 20)
    assert uap.table_of(category, f"{edition[0]}.{edition[1]}") == table


def test_every_supported_table_is_compared() -> None:
    """But for the draft of 062, which libasterix does not have: `tests/reading/test_capture.py` judges that by physics."""
    assert {(c, t) for c in uap.categories() for t in uap.editions_of(c)} == set(EDITIONS) | {(62, "0.17")}


# ------------------------------------------------------------------------------------------------------------ real recordings

RECORDINGS = {
    "lebl-2016/smr_cat010_160510-lebl-220001.ast": {},
    "lebl-2016/mlat_cat010_160510-lebl-220001.ast": {},
    "lebl-2016/mlat_cat020_160510-lebl-220001.ast": {},
    "lebl-2016/adsb_cat021v023_160510-lebl-220001.ast": {21: "0.23"},
    "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast": {},
    "croatia/cat048.raw": {},
    "croatia/cat21_re.ast": {21: "2.x"},
    "croatia/cat_001_002.pcap": {},
    "croatia/cat_034_048.pcap": {},
    "croatia/cat_062_065.pcap": {},
    "croatia/parsegps.gps": {},
}
NEWER = {"croatia/cat21_re.ast": {21: (2, 7)}}
LATEST = {
    1: (1, 4),
    2: (1, 2),
    62: (1, 21),
    63: (1, 7),
    65: (1, 6),
    10: (1, 1),
    19: (1, 3),
    20: (1, 11),
    21: (0, 23),
    34: (1, 29),
    48: (1, 32),
}


def blocks_of(data: bytes) -> list[bytes]:
    out, at = [], 0
    while at < len(data):
        end = at + int.from_bytes(data[at + 1 : at + 3], "big")
        out.append(data[at:end])
        at = end
    return out


def blocks_in(path: Path) -> list[bytes]:
    """The blocks of a recording, out of whatever wraps them."""
    known = frozenset(uap.categories())
    head = path.read_bytes()
    kind = capture.kind_of(head, len(head), known)
    if kind == "raw":
        return blocks_of(head)
    mask = np.isin(np.arange(256), list(known))
    parts = [capture.unwrapped(p, mask)[0] for p in capture.portions(path, kind, capture.Tally(), known)]
    return [one for p in parts for one in blocks_of(p.data.tobytes())]


@cache
def uap_of(category: int) -> Any:
    return spec_of(category, LATEST[category]).cv_uap


@cache
def uap_for(category: int, edition: tuple[int, int]) -> Any:
    return spec_of(category, edition).cv_uap


def their_values(variation: Any, name: str) -> list[dict[str, int | float | str]]:
    """The fields of a parsed item of libasterix; one dict a repetition."""
    if isinstance(variation, base.Repetitive):
        return [row for entry in variation.arg for row in their_values(entry, name)]
    out: dict[str, int | float | str] = {}
    collect(variation, name, out)
    return [out]


def collect(variation: Any, name: str, out: dict[str, int | float | str]) -> None:
    if isinstance(variation, base.Element):
        rule = variation.cv_rule
        if issubclass(rule, base.RuleContentDependent):
            return
        content = rule.cv_content(variation.bs)
        if isinstance(content, base.ContentQuantity):
            out[name] = content._as_quantity()
        elif isinstance(content, base.ContentString) and content.cv_string_type is base.StringICAO:
            out[name] = content.as_string()
        else:
            out[name] = content.as_integer() if isinstance(content, base.ContentInteger) else content.as_uint()
        return
    entries = [e for part in variation.arg for e in part] if isinstance(variation, base.Extended) else variation.arg
    for entry in entries:
        if isinstance(entry, base.Item):
            inner = entry.arg.arg.arg
            deeper = entry.arg.cv_name
            if isinstance(inner, base.Group):
                for leaf in inner.arg:
                    if isinstance(leaf, base.Item):
                        collect(leaf.arg.arg.arg, f"{deeper}_{leaf.arg.cv_name}", out)
            else:
                collect(inner, deeper, out)


def their_records(found: Any, body: bytes) -> list[Any]:
    """The records of a block; where the category has two lists of items, the selector of libasterix tells which."""
    bits = base.Bits.from_bytes(body)
    if not issubclass(found, base.UapMultiple):
        records = found.parse(bits)
        assert not isinstance(records, ValueError)
        return list(records)
    (item, field), choices = found.cv_selector
    out = []
    while len(bits):
        for name, record in found.cv_uaps.items():
            parsed = record._parse(base.ParsingMode.StrictParsing, bits)
            if isinstance(parsed, ValueError):
                continue
            if choices[their_values(parsed[0].items_regular[item].arg.arg, item)[0][field]] == name:
                break
        out.append(parsed[0])
        bits = parsed[1]
    return out


def compare(block: bytes, ours: list[ItemRecord], values: bool, found: Any = None) -> tuple[int, int]:
    """Compare the records of a block; returns the numbers of items and of values that were compared."""
    category = block[0]
    theirs = their_records(found or uap_of(category), block[3:])
    assert len(theirs) == len(ours)
    items = count = 0
    for mine, record in zip(ours, theirs, strict=True):
        top = {name: raw for name, raw in mine.items.items() if "/" not in name and name != "RFS"}
        assert top == {name: item.unparse().to_bytes() for name, item in record.items_regular.items()}
        items += len(top)
        for name, item in record.items_regular.items():
            inner = item.arg.arg
            if isinstance(inner, base.Compound):
                ours_has = {k[4:] for k in mine.items if k[:4] == f"{name}/"}
                subs = {f"{name}/{k if k in ours_has else RENAMED[k]}": v for k, v in inner.arg.items()}
                assert {k: v.unparse().to_bytes() for k, v in subs.items()} == {
                    k: v for k, v in mine.items.items() if k[:4] == f"{name}/"
                }
                if values:
                    for path, sub in subs.items():
                        count += same(category, name, mine.values(path), their_values(sub.arg.arg, sub.cv_name), path)
            elif values and not isinstance(inner, base.Explicit):
                count += same(category, name, mine.values(name), their_values(inner, name), name)
    return items, count


def same(category: int, item: str, ours: list[Any], theirs: list[Any], path: str) -> int:
    assert len(ours) == len(theirs), path
    factor = LSB.get((f"{category:03d}", item), 1.0)
    for mine, other in zip(ours, theirs, strict=True):
        for name, value in other.items():
            got = mine[RENAMED.get(name, name) if name not in mine else name]
            if (category, item, name) == (21, "090", "PA"):
                assert (got - value) % 16 == 0
            elif isinstance(value, str):
                assert got == value.rstrip() or "?" in got, path
            else:
                assert math.isclose(got, value * factor, rel_tol=1e-12), f"{category:03d}/{path}.{name}: {got} against {value}"
    return sum(len(other) for other in theirs)


def compare_all(
    blocks: list[bytes], editions: dict[int, str], every_value: int, newer: dict[int, tuple[int, int]] | None = None
) -> tuple[int, int, int]:
    """Compare blocks; every `every_value`-th block also value by value.  Returns the numbers of records, items and values."""
    found = decode_items(b"".join(blocks), editions)
    records = items = values = at = 0
    waiting: ItemRecord | None = next(found, None)
    for number, block in enumerate(blocks):
        mine: list[ItemRecord] = []
        while waiting is not None and waiting.offset < at + len(block):
            mine.append(waiting)
            waiting = next(found, None)
        at += len(block)
        theirs = uap_for(block[0], newer[block[0]]) if newer and block[0] in newer else None
        more = compare(block, mine, number % every_value == 0, theirs)
        records, items, values = records + len(mine), items + more[0], values + more[1]
    assert waiting is None
    return records, items, values


def accepted(blocks: list[bytes]) -> tuple[list[bytes], int]:
    """The blocks, those of category 019 with a third octet of I019/553 without it, and how many these are.

    The item goes on while FX is set, and the multilateration of Barcelona tells of six reference transponders in three octets;
    libasterix knows two octets and refuses the whole block.  Without the third octet everything else can be compared.
    """
    out, shortened = [], 0
    for block in blocks:
        if block[0] == 19:
            (record,) = decode_items(block)
            item = record.items.get("553", b"")
            if len(item) > 2:
                at = record.offset + sum(len(raw) for name, raw in record.items.items() if name < "553") + 2
                assert block[at : at + len(item)] == item
                body = block[3 : at + 1] + bytes([item[1] & 0xFE]) + block[at + len(item) :]
                block = bytes([19]) + (len(body) + 3).to_bytes(2, "big") + body
                shortened += 1
        out.append(block)
    return out, shortened


# -------------------------------------------------------------------------------------------------------- constructed records


def content(rng: np.random.Generator, item: uap.Item, frns: list[uap.Item | None], parts: dict[str, int]) -> bytes:
    """Random bytes that make an item; an extended one has at most as many parts as libasterix knows of it."""
    if item.kind == uap.FIXED:
        return rng.bytes(item.size)
    if item.kind == uap.EXTENDED:
        listed = item.size == 3 or (len(item.fields) == 1 and item.fields[0].bits == 7)
        more = int(rng.integers(4)) if listed else int(rng.integers(parts.get(item.name, 1)))
        out = bytearray(rng.bytes(item.size + more * item.step))
        for k in range(more + 1):
            last = item.size + k * item.step - 1
            if not (item.most and k == 1):
                out[last] = out[last] & 0xFE | (k < more)
        return bytes(out)
    if item.kind == uap.REPETITIVE:
        count = int(rng.integers(1, 4))
        return bytes([count]) + rng.bytes(count * item.size)
    if item.kind == uap.EXPLICIT:
        length = int(rng.integers(1, 20))
        return bytes([length]) + rng.bytes(length - 1)
    if item.kind == uap.RANDOM:
        choices = [k for k, one in enumerate(frns) if one is not None and one.kind < uap.COMPOUND]
        some = rng.choice(choices, 3)
        return b"\3" + b"".join(bytes([k + 1]) + content(rng, frns[k], [], parts) for k in some)
    subs = [k for k, one in enumerate(item.subitems) if one is not None and rng.random() < 0.5]
    subs = subs or [next(k for k, one in enumerate(item.subitems) if one is not None)]
    return presence(subs) + b"".join(content(rng, item.subitems[k], [], {}) for k in subs)


def presence(numbers: list[int]) -> bytes:
    """A field specification with the bits of these numbers (from 0)."""
    octets = bytearray(numbers[-1] // 7 + 1)
    for k in numbers:
        octets[k // 7] |= 0x80 >> k % 7
    for k in range(len(octets) - 1):
        octets[k] |= 1
    return bytes(octets)


def made(rng: np.random.Generator, form: int, table: str, second: bool | None, parts: dict[str, int]) -> bytes:
    """A random record that has item 010, and 020 with the bit that chooses the list of items where there are two."""
    items = list(uap.items_of(form, table))
    needed = {"010"} if second is None else {"010", "020"}
    chosen = [k for k, one in enumerate(items) if one is not None and (one.name in needed or rng.random() < 0.6)]
    out = b""
    for k in chosen:
        item = items[k]
        assert item is not None
        raw = bytearray(content(rng, item, items, parts))
        if item.name == "020" and second is not None:
            raw[0] = raw[0] & 0x7F | second << 7
        out += bytes(raw)
    return presence(chosen) + out


@pytest.mark.parametrize(("category", "table", "edition"), [(c, t, es[-1]) for (c, t), es in EDITIONS.items()])
def test_every_item_of_made_records_equals_libasterix(category: int, table: str, edition: tuple[int, int]) -> None:
    rng = np.random.default_rng(category)
    forms = [(category, None)] if category not in uap.SECOND else [(category, False), (uap.SECOND[category], True)]
    blocks, seen = [], set()
    parts = {
        form: {name: len(layout(spec)[2]) for name, spec in record.cv_items_dict.items()}
        for form, record in records_of(category, edition).items()
    }
    for k in range(300):
        records = [made(rng, form, table, second, parts[form]) for form, second in forms for _ in range(1 + k % 2)]
        body = b"".join(records)
        blocks.append(bytes([category]) + (len(body) + 3).to_bytes(2, "big") + body)
    items = values = 0
    found = uap_for(category, edition)
    for block in blocks:
        mine = list(decode_items(block, {category: table}))
        more = compare(block, mine, True, found)
        items, values = items + more[0], values + more[1]
        seen |= {(one.form, name) for one in mine for name in one.items}
    wanted = {
        (form, name)
        for form, _ in forms
        for item in uap.items_of(form, table)
        if item is not None
        for name in [item.name, *(f"{item.name}/{sub.name}" for sub in item.subitems if sub is not None)]
    }
    assert seen == wanted
    assert items > 1500
    assert values > 3000


@pytest.mark.real
@pytest.mark.parametrize("name", RECORDINGS)
def test_every_item_of_every_tenth_block_equals_libasterix(data: Path, name: str) -> None:
    blocks = blocks_in(data / name)
    blocks, shortened = accepted(blocks[:: 10 if len(blocks) > 1000 else 1])
    assert (shortened > 0) == ("cat020" in name)
    records, items, values = compare_all(blocks, RECORDINGS[name], 10 if len(blocks) > 1000 else 1, NEWER.get(name))
    assert records >= len(blocks)
    assert items >= 4 * records
    assert values >= records / 10


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_every_item_of_every_block_equals_libasterix(data: Path, name: str) -> None:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    blocks, _ = accepted(blocks_in(data / name))
    parts = [blocks[k : k + 4000] for k in range(0, len(blocks), 4000)]
    with ProcessPoolExecutor(2, mp_context=get_context("forkserver")) as pool:
        n = len(parts)
        done = list(pool.map(compare_all, parts, [RECORDINGS[name]] * n, [10] * n, [NEWER.get(name)] * n))
    assert sum(records for records, _, _ in done) == len(read(data / name).offset)


@pytest.mark.real
def test_the_columns_are_the_scaled_values_of_libasterix(data: Path) -> None:
    """From file to column, for the quantities that the chain lives on, on records spread over two recordings."""
    path = data / "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast"
    plots = read(path).plots
    blocks = blocks_of(path.read_bytes())
    assert len(blocks) == len(plots)
    for k in range(0, len(blocks), 997):
        record = uap_of(48).parse(base.Bits.from_bytes(blocks[k][3:]))[0]
        items = {
            name: their_values(item.arg.arg, name)[0]
            for name, item in record.items_regular.items()
            if name in ("040", "140", "161", "200", "220")
        }
        row = plots[k : k + 1]
        assert row.range_m[0] == pytest.approx(items["040"]["RHO"] * 1852, rel=1e-12)
        assert row.azimuth_rad[0] == pytest.approx(math.radians(items["040"]["THETA"]), rel=1e-9)
        assert row.time_s[0] % 86400 == pytest.approx(items["140"]["140"], abs=1e-9)
        assert row.track[0] == items["161"]["TRN"]
        assert row.speed_mps[0] == pytest.approx(items["200"]["GSP"] * 1852, rel=1e-12)
        assert row.mode_s[0] == items.get("220", {"220": -1})["220"]
        if "090" in record.items_regular:
            level = their_values(record.items_regular["090"].arg.arg, "090")[0]
            expected = math.nan if level["V"] or level["G"] else level["FL"] * 30.48
            assert row.pressure_altitude_m[0] == pytest.approx(expected, nan_ok=True)
        if "070" in record.items_regular:
            code = their_values(record.items_regular["070"].arg.arg, "070")[0]
            assert row.mode_3a[0] == (-1 if code["V"] or code["G"] else code["MODE3A"])
        if "240" in record.items_regular:
            assert (
                unpack_callsigns(row.callsign)[0]
                == record.items_regular["240"]
                .arg.arg.cv_rule.cv_content(record.items_regular["240"].unparse())
                .as_string()
                .rstrip()
            )
        if "130" in record.items_regular and "RPD" in record.items_regular["130"].arg.arg.arg:
            parts = record.items_regular["130"].arg.arg.arg
            rpd = their_values(parts["RPD"].arg.arg, "RPD")[0]["RPD"]
            assert row.psr_ssr_range_m[0] == pytest.approx(rpd * 1852, rel=1e-12)


@pytest.mark.real
def test_the_velocity_of_category_010_is_in_quarters_of_a_metre_a_second(data: Path) -> None:
    """I010/202 against how far the same targets moved: the slope is 1 with our unit, and would be 4 with libasterix's."""
    fixes = read(data / "lebl-2016/mlat_cat010_160510-lebl-220001.ast").fixes
    told, moved = [], []
    for address in np.unique(fixes.mode_s):
        one = fixes[fixes.mode_s == address]
        step = np.diff(one.time_s)
        fast = np.abs(one.velocity_east_mps[1:]) > 20
        use = (step > 0.5) & (step < 2) & fast
        told.append(one.velocity_east_mps[1:][use])
        moved.append(np.diff(one.x_m)[use] / step[use])
    v, w = np.concatenate(told), np.concatenate(moved)
    assert len(v) > 1000
    assert np.sum(v * w) / np.sum(v * v) == pytest.approx(1.0, abs=0.02)
