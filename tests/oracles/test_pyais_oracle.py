"""Every AIS message of the shared logs against pyais' own stream reader, and hull centres against pyproj's geodesics."""

from __future__ import annotations

import re
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.reading.nmea import read_nmea

pyais = pytest.importorskip("pyais")
pyproj = pytest.importorskip("pyproj")

LOGS = ("ais/pyais_nmea_data_sample.txt", "nmea/opencpn_Go_to_Guernesey.txt", "nmea/signalk_gofree-merrimac.log")


def sound(raw: bytes) -> list[bytes]:
    """The AIVDM sentences whose checksum is right.

    What a receiver adds behind the six fields is taken off: pyais takes the last field for the number of fill bits.
    """
    out = []
    for found in re.finditer(rb"!(AIVDM[^*\r\n]*)\*([0-9A-F]{2})", raw):
        if reduce(lambda a, b: a ^ b, found[1]) == int(found[2], 16):
            body = b",".join(found[1].split(b",")[:7])
            out.append(b"!%b*%02X" % (body, reduce(lambda a, b: a ^ b, body)))
    return out


def oracle(raw: bytes) -> list[Any]:
    out = []
    for m in pyais.stream.IterMessages(sound(raw)):
        try:
            out.append(m.decode())
        except (pyais.exceptions.AISBaseException, ValueError):
            continue
    return out


@pytest.mark.real
@pytest.mark.parametrize("name", LOGS)
def test_every_position_and_dimension(data: Path, name: str) -> None:
    path = data / name
    messages = oracle(path.read_bytes())
    assert len(messages) > 700
    want = [m for m in messages if m.msg_type in (1, 2, 3, 18, 19, 27) and abs(m.lat) <= 90 and abs(m.lon) <= 180]
    recording = read_nmea(path)
    f = recording.fixes[recording.fixes.mmsi >= 0]
    assert f.mmsi.tolist() == [m.mmsi for m in want]

    # Dimensions: the last ones before a report, else the first after it.
    size: dict[int, list[tuple[int, tuple[int, int, int, int]]]] = {}
    order = {id(m): k for k, m in enumerate(messages)}
    for k, m in enumerate(messages):
        known = m.msg_type in (5, 19) or (m.msg_type == 24 and m.partno == 1 and m.mmsi // 10_000_000 != 98)
        if known and m.to_starboard is not None:
            size.setdefault(m.mmsi, []).append((k, (m.to_bow, m.to_stern, m.to_port, m.to_starboard)))
    geod = pyproj.Geod(ellps="WGS84")
    nothing = (0, 0, 0, 0)
    dims, shift, lon2, lat2 = [], [], [], []
    for m in want:
        mine = size.get(m.mmsi, [])
        before = [d for k, d in mine if k <= order[id(m)]]
        a, b, c, d = before[-1] if before else mine[0][1] if mine else nothing
        heading = m.heading if m.heading < 360 else m.course if 3 / (1852 / 3600) < m.speed < 102.25 and m.course < 360 else None
        move = heading is not None and a + b > 0 and not (a == 0 and c == 0)
        forward, right = ((a - b) / 2, (d - c) / 2) if move else (0.0, 0.0)
        azimuth = (heading if move else 0) + np.degrees(np.arctan2(right, forward))
        x, y, _ = geod.fwd(m.lon, m.lat, azimuth, np.hypot(forward, right))
        dims.append((a + b or np.nan, c + d if a + b and c + d else np.nan))
        shift.append(np.hypot(forward, right))
        lon2.append(x)
        lat2.append(y)
    _, _, off = geod.inv(lon2, lat2, np.degrees(f.longitude_rad), np.degrees(f.latitude_rad))
    # pyais rounds positions to 1e-6 degrees, ours are exact: half a step in both axes is 0.08 m.
    assert np.max(off) < 0.085
    np.testing.assert_array_equal(np.stack([f.length_m, f.width_m], 1), dims)
    if "opencpn" in name:
        assert max(shift) > 50

    speed = np.array([m.speed if m.speed < 102.25 else np.nan for m in want]) * 1852 / 3600
    course = np.radians([m.course if m.course < 360 else np.nan for m in want])
    moving = np.isfinite(course) & (speed > 0)
    np.testing.assert_allclose(f.velocity_east_mps[moving], (speed * np.sin(course))[moving], atol=1e-9)
    np.testing.assert_allclose(f.velocity_north_mps[moving], (speed * np.cos(course))[moving], atol=1e-9)
    heading = np.array([m.heading if m.msg_type != 27 and m.heading < 360 else np.nan for m in want])
    np.testing.assert_allclose(np.degrees(f.heading_rad), heading, atol=1e-9)
    stamped = np.array([m.second < 60 for m in want]) & (f.time_sd_s < 0.5)
    assert np.count_nonzero(stamped) > 0.9 * sum(m.second < 60 for m in want)
    np.testing.assert_array_equal(f.time_s[stamped] % 60, np.array([m.second for m in want])[stamped])

    counts = {s.edition: s.records for s in recording.sources if s.edition.startswith("AIS ")}
    types = [m.msg_type for m in messages]
    assert counts == {f"AIS {t}": types.count(t) for t in sorted(set(types))}
