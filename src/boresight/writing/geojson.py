"""GeoJSON (RFC 7946): longitude before latitude, degrees on WGS-84, at most seven decimals, heights ellipsoidal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ..model import Platform, Sensors
from . import atomic
from .features import BLOCK, GAP_S, Features, features_of, iso

_Tables = Any


def write_geojson(
    path: str | Path,
    tables: _Tables,
    *,
    sensors: Sensors | None = None,
    platform: Platform | None = None,
    points: bool = True,
    lines: bool = False,
    gap_s: float = GAP_S,
) -> dict[str, int]:
    """Write tables to one GeoJSON file, as a whole or not at all, and return the number of features of each kind.

    `tables` is a table (Plots, Fixes, Tracks, Platform, or any dataclass or mapping of arrays with latitudes and longitudes),
    or a sequence of them, or a mapping of names to them.  Each row with a position becomes a point; its other columns are
    properties with units in their names (`range_m`, `azimuth_deg`, `time` in ISO 8601); what is absent is not named.  With
    `lines` each target becomes a line too, broken where it was not seen for `gap_s` seconds and cut at the antimeridian as
    the RFC asks.  Plots are placed by `sensors`.  The result also counts rows that have no position ("without position").  It
    is written a block at a time.

    Raises SettingsError where plots come without sensors, InputError for tables without positions and for the file.
    """
    counts: dict[str, int] = {}
    encode = msgspec.json.Encoder().encode
    with atomic(path) as beside, open(beside, "wb") as file:
        file.write(b'{"type":"FeatureCollection","features":[')
        first = True
        for name, table in named(tables):
            features = features_of(table, sensors, kind=name, platform=platform)
            count = 0
            for part in _parts(features, points, lines, gap_s):
                text = b",\n".join(encode(feature) for feature in part)
                if text:
                    file.write((b"\n" if first else b",\n") + text)
                    first = False
                    count += len(part)
            counts[features.kind] = counts.get(features.kind, 0) + count
            if features.without:
                counts["without position"] = counts.get("without position", 0) + features.without
        file.write(b"\n]}\n")
    return counts


def named(tables: _Tables) -> Iterator[tuple[str | None, Any]]:
    """Tables with their names, of one table, a sequence of tables, or a mapping of names to tables."""
    if isinstance(tables, Mapping) and all(hasattr(t, "time_s") or isinstance(t, Mapping) for t in tables.values()):
        yield from tables.items()
    elif isinstance(tables, Sequence):
        yield from ((None, table) for table in tables)
    else:
        yield ("table" if isinstance(tables, Mapping) else None), tables


def _parts(features: Features, points: bool, lines: bool, gap_s: float) -> Iterator[list[dict[str, Any]]]:
    """Features, a block at a time."""
    longitude, latitude = np.round(features.longitude_deg, 7), np.round(features.latitude_deg, 7)
    height = np.round(features.height_m, 3)
    for begin in range(0, len(features) if points else 0, BLOCK):
        end = min(begin + BLOCK, len(features))
        x, y, z = longitude[begin:end].tolist(), latitude[begin:end].tolist(), height[begin:end].tolist()
        part = []
        for k, properties in enumerate(features.properties(begin, end)):
            place = [x[k], y[k]] if z[k] != z[k] else [x[k], y[k], z[k]]
            part.append(
                {
                    "type": "Feature",
                    "geometry": {"type": "Point", "coordinates": place},
                    "properties": {"kind": features.kind} | properties,
                }
            )
        yield part
    if not lines:
        return
    part = []
    for target, rows in features.lines(gap_s):
        pieces = _cut(longitude[rows], latitude[rows])
        geometry = {"type": "LineString", "coordinates": pieces[0]}
        if len(pieces) > 1:
            geometry = {"type": "MultiLineString", "coordinates": pieces}
        part.append(
            {
                "type": "Feature",
                "geometry": geometry,
                "properties": {
                    "kind": features.kind,
                    "target": features.names[target],
                    "from": iso(float(features.time_s[rows[0]])),
                    "to": iso(float(features.time_s[rows[-1]])),
                    "points": len(rows),
                },
            }
        )
        if len(part) >= 256:
            yield part
            part = []
    yield part


def _cut(longitude: Any, latitude: Any) -> list[list[list[float]]]:
    """A line as one piece, or as several that end at the antimeridian where it crosses that."""
    pieces: list[list[list[float]]] = [[]]
    before: tuple[float, float] | None = None
    for x, y in zip(longitude.tolist(), latitude.tolist(), strict=True):
        if before is not None and abs(x - before[0]) > 180:
            side = 180.0 if before[0] > 0 else -180.0
            there = x + 2 * side
            share = (side - before[0]) / (there - before[0]) if there != before[0] else 0.0
            at = round(before[1] + share * (y - before[1]), 7)
            pieces[-1].append([side, at])
            pieces.append([[-side, at]])
        pieces[-1].append([x, y])
        before = (x, y)
    return pieces
