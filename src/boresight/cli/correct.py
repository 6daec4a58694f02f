"""``boresight correct``: a recording without the errors that a calibration found."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from ..errors import SettingsError
from ._options import Date, Editions, Files, Json, Switch, date_of, editions_of, print_json, steps

if TYPE_CHECKING:
    from ..flow import Corrected
    from ..writing.sidecar import TermDone


def correct(
    plots: Files,
    /,
    *,
    calibration: Path,
    out: Path,
    terms: Annotated[str, Parameter(name="--terms")] = "advised",
    sensors: Annotated[Path | None, Parameter(name="--sensors")] = None,
    date: Date = None,
    edition: Editions | None = None,
    overwrite: Switch = False,
    json: Json = False,
) -> None:
    """Take the errors of a calibration out of PLOTS: the same ASTERIX recording again, or a table (Parquet, CSV).

    Of an ASTERIX recording only the measured items change (time, polar and Cartesian position); every other byte stays. Beside
    OUT its provenance is written, OUT.boresight.json.

    Parameters
    ----------
    plots
        Recordings of the radars that were calibrated; one, where ASTERIX is written.
    calibration
        calibration.json, as calibrate writes it, or the folder that holds it.
    out
        File to write. The ending .parquet or .csv makes a table; that of PLOTS, or .ast, writes the ASTERIX recording again.
    terms
        advised (those that the calibration says to apply), all, or a comma-separated list of terms.
    sensors
        sensors.toml, where the azimuths need a north offset.
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    overwrite
        Replace OUT where it exists.
    json
        Print what was done as JSON.
    """
    from .. import flow
    from ..writing.sidecar import sidecar_of

    if any(out.resolve() == p.resolve() for p in [*plots, calibration]):
        raise SettingsError(f"{out} is one of the inputs, which are never written to", where="--out")
    if out.is_dir():
        raise SettingsError(f"{out} is a folder", where="--out", remedy="Name a file to write.")
    for path in (out, sidecar_of(out)):
        if path.exists() and not overwrite:
            raise SettingsError(f"{path} exists", where="--out", remedy="Name another file, or add --overwrite.")
    with steps(quiet=json) as step:
        done = flow.correct_files(
            plots,
            calibration,
            out,
            sensors=sensors,
            date=date_of(date),
            editions=editions_of(edition),
            terms=terms,
            progress=step,
        )
    if json:
        print_json(_json(done, out))
        return
    for warning in done.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(_text(done, out))


_CONTAINERS = {
    "raw": "ASTERIX data blocks",
    "pcap": "a packet capture (pcap)",
    "pcapng": "a packet capture (pcapng)",
    "final": "a final-format file",
    "gps": "a GPS-stamped file",
}


def _text(done: Corrected, out: Path) -> str:
    """What was done, in lines to read."""
    encoded = done.encoded
    if encoded is None:
        lines = [f"{out}: {done.plots:,} corrected plots"]
    else:
        what = "the UDP checksums follow, every other byte" if encoded.kind.startswith("pcap") else "every other byte"
        lines = [
            f"{out}: {encoded.changed:,} of {encoded.records:,} records corrected in {_CONTAINERS[encoded.kind]}; "
            f"{what} is as it was"
        ]
        lines += [f"  left as they were: {count:,} records that {why}" for why, count in encoded.left.items()]
        lines += [f"  note: {note}" for note in encoded.notes]
    lines += [f"  applied: {_term(t)} {t.value:+.4g} ± {t.sd:.2g} {t.unit}" for t in done.provenance.terms if not t.held]
    lines += [f"  held: {_term(t)}: {t.held}" for t in done.provenance.terms if t.held]
    if encoded is not None:
        lines += [f"  rounding added: {r.item} {r.rms:.2g} {r.unit} rms (1 LSB = {r.lsb:.3g} {r.unit})" for r in encoded.rounding]
    lines.append(f"  provenance: {done.sidecar}")
    return "\n".join(lines)


def _term(term: TermDone) -> str:
    return f"{term.sensor} {term.term}" + ("" if term.channel == "all" else f"@{term.channel}")


def _json(done: Corrected, out: Path) -> dict[str, object]:
    import msgspec

    encoded = None
    if done.encoded is not None:
        encoded = {
            "container": done.encoded.kind,
            "records": done.encoded.records,
            "changed": done.encoded.changed,
            "left": dict(done.encoded.left),
            "notes": list(done.encoded.notes),
            "rounding": [{"item": r.item, "unit": r.unit, "lsb": r.lsb, "rms": r.rms} for r in done.encoded.rounding],
        }
    return {
        "output": str(out),
        "provenance": str(done.sidecar),
        "plots": done.plots,
        "asterix": encoded,
        "terms": [msgspec.to_builtins(t) for t in done.provenance.terms],
        "warnings": list(done.warnings),
    }
