"""Own ship's sentences of the shared logs against pynmeagps.

Where pynmeagps 1.1 is wrong, or differs, and is therefore not asked:

* TLL (and other sentences whose hemisphere follows the second position): the sign of S and W is lost, positions come out north
  and east.
* It raises on the first line of a damaged log unless it is told to pass over it, and cannot say where the damage lies.
* A sentence that begins in the middle of a line (after another one whose line end was lost) is not found.
* Sentences with more fields than its table has lose them; HDT and VTG without a value give "" where a number belongs.
* Its positions are rounded to 1e-10 degrees.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.reading.nmea import read_nmea

pynmeagps = pytest.importorskip("pynmeagps")


def parse(raw: bytes, offset: int) -> Any:
    end = min(k for k in (raw.find(b"\r", offset), raw.find(b"\n", offset), len(raw)) if k >= 0)
    return pynmeagps.NMEAReader.parse(raw[offset:end] + b"\r\n")


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "step", "kinds"),
    [
        ("opencpn_Go_to_Guernesey.txt", 3, {"RMC"}),
        ("signalk_gofree-merrimac.log", 1, {"GGA", "HDG"}),
        ("signalk_plaka.log", 2, {"GLL"}),
    ],
)
def test_own_ship(data: Path, name: str, step: int, kinds: set[str]) -> None:
    """Positions, times, speeds, courses and headings at the sentences that give them."""
    path = data / "nmea" / name
    raw = path.read_bytes()
    r = read_nmea(path, date=datetime.date(2014, 4, 16))
    p = r.platform
    seen: set[str] = set()
    for k in range(0, len(p), step):
        m = parse(raw, int(r.offset[p.record[k]]))
        seen.add(m.msgID)
        if m.msgID in ("GGA", "RMC", "GLL"):
            assert np.degrees(p.latitude_rad[k]) == pytest.approx(m.lat, abs=2e-10)
            assert np.degrees(p.longitude_rad[k]) == pytest.approx(m.lon, abs=2e-10)
            of_day = m.time.hour * 3600 + m.time.minute * 60 + m.time.second + m.time.microsecond / 1e6
            assert p.time_s[k] % 86400 == pytest.approx(of_day, abs=1e-6)
        if m.msgID == "RMC":
            assert p.time_s[k] // 86400 == (m.date - datetime.date(1970, 1, 1)).days
            assert p.speed_mps[k] == pytest.approx(m.spd * 1852 / 3600, abs=1e-9)
        if m.msgID == "RMC" and m.cog != "":
            assert np.degrees(p.course_rad[k]) == pytest.approx(m.cog, abs=1e-6)
        if m.msgID == "HDG":
            assert np.degrees(p.heading_rad[k]) == pytest.approx(
                m.headingM + (1 if m.variationEW == "E" else -1) * m.variation, abs=1e-6
            )
    assert seen == kinds


def test_target_sentence() -> None:
    m = pynmeagps.NMEAReader.parse(b"$RATTM,11,11.4,13.6,T,7.0,20.0,T,0.0,0.0,N,,Q,,154125.82,A,*17\r\n")
    from boresight.reading.nmea import decode_nmea

    records, _, _ = decode_nmea(b"$RATTM,11,11.4,13.6,T,7.0,20.0,T,0.0,0.0,N,,Q,,154125.82,A,*17\r\n")
    p = records.plots
    values = [v for k, v in m.__dict__.items() if not k.startswith("_")]
    assert p.range_m[0] / 1852 == pytest.approx(float(values[1]))
    assert np.degrees(p.azimuth_rad[0]) == pytest.approx(float(values[2]))
    assert p.track[0] == int(values[0])
