"""``boresight convert``: a recording in another format."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ..errors import SettingsError
from ._options import Date, Editions, Json, Switch, date_of, editions_of, print_json, steps


def convert(
    recording: Path,
    out: Path,
    /,
    *,
    kind: str | None = None,
    sensors: Annotated[Path | None, Parameter(name="--sensors")] = None,
    columns: Path | None = None,
    lines: Switch = False,
    source: str | None = None,
    date: Date = None,
    edition: Editions | None = None,
    overwrite: Switch = False,
    json: Json = False,
) -> None:
    """Write a recording in another format: Parquet, CSV, GeoJSON, KML, ASTERIX or NMEA.

    Rows keep the order of the records in the file.  ASTERIX of any length goes to Parquet and CSV part by part, in less than
    0.7 GB of memory; all else is held as a whole.

    Parameters
    ----------
    recording
        Recording in any format that can be read.
    out
        File to write; its ending chooses the format: .parquet .csv .geojson .json .kml .ast .nmea.
    kind
        Table to write: plots, fixes, tracks or platform; all writes each to its own file where the format holds only one.
    sensors
        sensors.toml: where the radars stand, for plots on a map.
    columns
        Column map (TOML) of a CSV or Parquet file whose columns are not known.
    lines
        Add each target's track as a line (GeoJSON).
    source
        SAC/SIC of what has none, as 20/129 (ASTERIX).
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    overwrite
        Replace OUT where it exists.
    json
        Print what was written as JSON.
    """
    import msgspec

    from ..model import Recording, load_sensors
    from ..reading import is_asterix, read
    from ..reading.asterix import Stream
    from ..reading.tables import read_table
    from ..writing.anyfile import ENDINGS, files_for, write_any, write_parts

    # The ending is looked at before a long file is read.
    if out.suffix.lower() not in ENDINGS:
        raise SettingsError(f"{out} ends in none of {' '.join(ENDINGS)}", where="OUT")
    known = load_sensors(sensors) if sensors is not None else None
    inputs = [p.resolve() for p in (recording, sensors, columns) if p is not None]

    def check(file: Path) -> None:
        if file.resolve() in inputs:
            raise SettingsError(f"{file} is one of the inputs, which are never written to", where="OUT")
        if file.exists() and not overwrite:
            raise SettingsError(f"{file} exists", where="OUT", remedy="Name another file, or add --overwrite.")

    day, own = date_of(date), _sac_sic(source)
    table: Recording | Stream
    with steps(quiet=json) as step:
        if columns is None and out.suffix.lower() in (".parquet", ".csv") and is_asterix(recording):
            step(f"converting {recording}")
            table = Stream.open(recording, editions=editions_of(edition), date=day)
            written = write_parts(out, table, name=str(recording), kind=kind, check=check)
        else:
            step(f"reading {recording}")
            if columns is not None:
                table = read_table(recording, columns, date=day)
            else:
                table = read(recording, editions=editions_of(edition), date=day)
            for file in files_for(out, table, kind=kind):
                check(file)
            step(f"writing {out}")
            written = write_any(out, table, sensors=known, kind=kind, lines=lines, source=own)
    if json:
        print_json(
            {
                "input": str(recording),
                **msgspec.to_builtins(written),
                "damaged": len(table.damaged),
                "warnings": list(table.warnings),
            }
        )
        return
    for warning in table.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if table.damaged:
        first = table.damaged[0]
        print(f"warning: {len(table.damaged):,} damaged places, the first at {first.offset}: {first.why}", file=sys.stderr)
    if written.left_out:
        lost = ", ".join(f"{name} ({count:,})" for name, count in written.left_out.items())
        print(f"warning: not carried, with the number of rows: {lost}", file=sys.stderr)
    print(f"{', '.join(written.files)}: " + ", ".join(f"{count:,} {name}" for name, count in written.rows.items()))


def _sac_sic(text: str | None) -> int | None:
    """``20/129`` as the id of a sensor; raises SettingsError with the form that is needed."""
    if text is None:
        return None
    sac, _, sic = text.partition("/")
    if not (sac.isdigit() and sic.isdigit() and int(sac) < 256 and int(sic) < 256):
        raise SettingsError(f"{text!r} is no SAC/SIC", where="--source", remedy="Example: --source 20/129")
    return int(sac) << 8 | int(sic)
