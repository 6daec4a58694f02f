"""KML 2.2: placemarks with time stamps, a folder for each target with its track, for viewers of maps and globes."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from .._types import IntArray
from ..model import Platform, Sensors
from . import atomic
from .features import BLOCK, GAP_S, Features, features_of, iso
from .geojson import named

_COLOURS = ("ff4f8cff", "ffd18a2e", "ff57b05a", "ffb667c0", "ff3fc3d6", "ff8a8a8a")


def write_kml(
    path: str | Path,
    tables: Any,
    *,
    sensors: Sensors | None = None,
    platform: Platform | None = None,
    points: bool = True,
    gap_s: float = GAP_S,
) -> dict[str, int]:
    """Write tables to one KML file, as a whole or not at all, and return the number of placemarks of each kind.

    `tables` is as in `write_geojson`.  Each target is a folder: its track, broken where it was not seen for `gap_s` seconds,
    and (with `points`) a placemark for each row with its UTC time stamp and the row's columns.  Rows of no known target are
    in one folder at the end.  KML counts heights from the sea: ours are ellipsoidal and are named so, and positions lie on
    the ground.  Names are escaped, characters that XML cannot hold are left out.  The result also counts rows without a
    position.

    Raises SettingsError where plots come without sensors, InputError for tables without positions and for the file.
    """
    counts: dict[str, int] = {}
    with atomic(path) as beside, open(beside, "w", encoding="utf-8", newline="\n") as file:
        file.write('<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n')
        for k, colour in enumerate(_COLOURS):
            file.write(
                f'<Style id="s{k}"><LineStyle><color>{colour}</color><width>2</width></LineStyle>'
                f"<IconStyle><color>{colour}</color><scale>0.4</scale></IconStyle><LabelStyle><scale>0</scale></LabelStyle></Style>\n"
            )
        for name, table in named(tables):
            features = features_of(table, sensors, kind=name, platform=platform)
            file.write(f"<Folder><name>{_text(features.kind)}</name>\n")
            counts[features.kind] = counts.get(features.kind, 0) + _targets(file, features, points, gap_s)
            file.write("</Folder>\n")
            if features.without:
                counts["without position"] = counts.get("without position", 0) + features.without
        file.write("</Document>\n</kml>\n")
    return counts


# Everything but what XML 1.0 can hold: most control characters, lone surrogates and two non-characters.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def _text(value: object) -> str:
    """Text for XML: escaped, and without the characters that it cannot hold."""
    return escape(_NOT_XML.sub("", str(value)))


def _targets(file: TextIO, features: Features, points: bool, gap_s: float) -> int:
    """Write a folder for each target, those of no known target last; the number of placemarks."""
    lines: dict[int, list[str]] = {}
    for target, rows in features.lines(gap_s):
        lines.setdefault(target, []).append(_line(features, rows, target))
    order = np.argsort(np.where(features.target < 0, len(features.names), features.target), kind="stable")
    features = replace(
        features, longitude_deg=features.longitude_deg[order], latitude_deg=features.latitude_deg[order],
        height_m=features.height_m[order], time_s=features.time_s[order], target=features.target[order],
        columns=tuple((name, column[order], write) for name, column, write in features.columns),
    )  # fmt: skip
    count, now = 0, -2
    name = style = ""
    for begin in range(0, len(features), BLOCK):
        end = min(begin + BLOCK, len(features))
        for k, properties in zip(range(begin, end), features.properties(begin, end), strict=True):
            target = int(features.target[k])
            if target != now:
                file.write("</Folder>\n" if now > -2 else "")
                name, style, now = _name(features, target), _style(target), target
                mine = lines.get(target, [])
                file.write(f"<Folder><name>{name}</name>\n" + "".join(mine))
                count += len(mine)
            if points:
                file.write(_point(features, k, name, style, properties))
                count += 1
    file.write("</Folder>\n" if now > -2 else "")
    return count


def _name(features: Features, target: int) -> str:
    return _text(features.names[target]) if target >= 0 else "no target known"


def _style(target: int) -> str:
    return f"<styleUrl>#s{max(target, 0) % len(_COLOURS)}</styleUrl>"


def _line(features: Features, rows: IntArray, target: int) -> str:
    begin, end = iso(float(features.time_s[rows[0]])), iso(float(features.time_s[rows[-1]]))
    places = " ".join(_place(features, int(k)) for k in rows)
    return (
        f"<Placemark><name>{_name(features, target)}</name><TimeSpan><begin>{begin}</begin><end>{end}</end></TimeSpan>"
        f"{_style(target)}<LineString><tessellate>1</tessellate><coordinates>{places}</coordinates></LineString></Placemark>\n"
    )


def _place(features: Features, k: int) -> str:
    return f"{features.longitude_deg[k]:.7f},{features.latitude_deg[k]:.7f}"


def _point(features: Features, k: int, name: str, style: str, properties: dict[str, Any]) -> str:
    properties.pop("time", None)
    height = float(features.height_m[k])
    properties.pop("height_m", None)
    if math.isfinite(height):
        properties["ellipsoidal_height_m"] = round(height, 3)
    data = "".join(f"<Data name={quoteattr(n)}><value>{_text(v)}</value></Data>" for n, v in properties.items())
    when = iso(float(features.time_s[k]))
    stamp = f"<TimeStamp><when>{when}</when></TimeStamp>" if when else ""
    return (
        f"<Placemark><name>{name}</name>{stamp}{style}<ExtendedData>{data}</ExtendedData>"
        f"<Point><coordinates>{_place(features, k)}</coordinates></Point></Placemark>\n"
    )
