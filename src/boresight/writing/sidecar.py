"""Where a corrected recording came from: a small JSON file beside it, and the search for one.

A correction that is applied twice makes errors of the other sign, and nothing in an ASTERIX file could show it.  The sidecar
names the recording by its SHA-256, so that a renamed one is known as long as its sidecar lies in the same folder.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from ..calibration import Calibration, Input, advised, at_zero, chosen, si_per_unit
from ..errors import InputError
from ..terms import summarised
from . import write_bytes

SCHEMA: Literal["boresight-corrected/1"] = "boresight-corrected/1"
ENDING = ".boresight.json"
_KEY = "boresight-corrected"


class TermDone(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One term of a calibration and what became of it: `value` and `sd` (in `unit`) as applied, or why it was `held` back."""

    sensor: str
    channel: str
    term: str
    unit: str
    value: float | None
    sd: float | None
    held: str = ""


class Provenance(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a corrected recording was made from, by which version, and what was done.

    `fixed_time_offset_s` are the offsets of sensors.toml (by SAC/SIC) that were taken from the stamps as well.
    """

    schema: Literal["boresight-corrected/1"] = SCHEMA
    version: str
    output: Input
    inputs: tuple[Input, ...]
    calibration: Input
    terms: tuple[TermDone, ...]
    fixed_time_offset_s: Mapping[str, float] = {}
    rounding: Mapping[str, str] = {}


def terms_done(
    calibration: Calibration, sensors: Collection[int], terms: str | Sequence[str] = "advised"
) -> tuple[TermDone, ...]:
    """What a correction by `terms` (as in `calibration.chosen`) does with the terms of `sensors`, at its last epoch."""
    take, why = chosen(calibration, terms)
    used = advised(calibration, terms)
    zero = at_zero(calibration, take)
    names = {s.sensor: s.name for s in calibration.sensors}
    at = np.cumsum(take) - 1
    out = []
    for k, key in enumerate(calibration.terms):
        if key.sensor not in sensors:
            continue
        scale = si_per_unit(key)
        value, sd = (float(column[-1, at[k]] / scale) if take[k] else None for column in (used.value, used.sd))
        name = names.get(key.sensor, f"{key.sensor >> 8}/{key.sensor & 255}")
        held = (
            why[k]
            if take[k] or zero[k]
            else f"{why[k]}; the other terms stay as they were found beside it ({_found(calibration, k)})"
        )
        out.append(TermDone(name, key.channel, key.name, key.unit, value, sd, held))
    return tuple(out)


def _found(calibration: Calibration, k: int) -> str:
    key = calibration.terms[k]
    value, sd = (column[-1, k] / si_per_unit(key) for column in (calibration.value, calibration.sd))
    return f"{value:+.3g} ± {sd:.2g} {key.unit}"


def describe(provenance: Provenance) -> str:
    """With which calibration a recording was corrected, and for what, in words."""
    applied: dict[str, list[str]] = {}
    for term in provenance.terms:
        if not term.held:
            applied.setdefault(term.sensor, []).append(term.term if term.channel == "all" else f"{term.term}@{term.channel}")
    what = "; ".join(f"{sensor}: {', '.join(summarised(names))}" for sensor, names in applied.items())
    return f"by {provenance.calibration.path} (SHA-256 {provenance.calibration.sha256[:12]}…) for {what}"


def corrected_before(path: str | Path) -> list[str]:
    """What must be said where a corrected recording is calibrated."""
    found = find_sidecar(path)
    if found is None:
        return []
    said = [f"{path} was corrected {describe(found[1])}: what is found here are the errors that remain"]
    said += [
        f"{path}: the fixed time offset of {place} ({offset:g} s) is out of its stamps already: it must not stand in sensors.toml"
        for place, offset in found[1].fixed_time_offset_s.items()
    ]
    return said


def sidecar_of(path: str | Path) -> Path:
    """Where the sidecar of a recording lies."""
    path = Path(path)
    return path.with_name(path.name + ENDING)


def write_sidecar(provenance: Provenance, path: str | Path) -> None:
    """Write a sidecar.  Raises InputError where it cannot be written."""
    write_bytes(path, msgspec.json.format(msgspec.json.encode(provenance), indent=1) + b"\n")


def find_sidecar(path: str | Path) -> tuple[Path, Provenance] | None:
    """The sidecar that tells of this very file (by its SHA-256), and what it says; None where there is none in its folder.

    The folder's sidecars are asked all, so that a file that was renamed is found; what is no sidecar is passed over.  A Parquet
    file tells by itself, too.  Raises InputError where the file itself cannot be read.
    """
    from ..reading import sha256_of

    path = Path(path)
    own = ""
    try:
        size = path.stat().st_size
        candidates = sorted(path.parent.glob(f"*{ENDING}"), key=lambda p: (p != sidecar_of(path), p.name))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", path=path) from error
    for candidate in candidates:
        try:
            told = msgspec.json.decode(candidate.read_bytes(), type=Provenance)
        except (OSError, msgspec.DecodeError, UnicodeDecodeError):
            continue
        # The hash of a long recording takes a second: asked for only where the size agrees.
        if told.output.bytes != size:
            continue
        own = own or sha256_of(path)
        if told.output.sha256 == own:
            return candidate, told
    return _inside(path)


def inner(provenance: Provenance) -> dict[str, str]:
    """The provenance as metadata of a Parquet file, which cannot hold its own hash."""
    return {_KEY: msgspec.json.encode(provenance).decode()}


def _inside(path: Path) -> tuple[Path, Provenance] | None:
    """What a Parquet file says of itself, wherever it was moved to."""
    from .tables import metadata_of

    with open(path, "rb") as file:
        if file.read(4) != b"PAR1":
            return None
    try:
        return path, msgspec.json.decode(metadata_of(path)[_KEY], type=Provenance)
    except (KeyError, msgspec.DecodeError):
        return None
