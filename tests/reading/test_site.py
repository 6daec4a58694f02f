"""What a station says of its place, against sensors.toml."""

from __future__ import annotations

import math

import pytest

from boresight.model import Sensor, Sensors, Source
from boresight.reading.site import site_disagreements


def source(lat: float, lon: float, height: float, category: int = 34) -> Source:
    return Source(
        sac=20, sic=129, category=category, edition="1.x", records=1, plots=0, start_s=0.0, end_s=1.0, targets=0,
        latitude_rad=math.radians(lat), longitude_rad=math.radians(lon), height_m=height,
    )  # fmt: skip


HERE = Sensors((Sensor(name="bcn", sac=20, sic=129, lat_deg=41.3007, lon_deg=2.1021, height_m=27.0),))


def test_a_station_that_agrees_is_silent() -> None:
    assert site_disagreements([source(41.30071, 2.10212, 29.0)], HERE) == ()
    assert site_disagreements([source(math.nan, math.nan, math.nan)], HERE) == ()
    other = Sensors((Sensor(name="x", sac=1, sic=2, lat_deg=0, lon_deg=0),))
    assert site_disagreements([source(41.3, 2.1, 0.0)], other) == ()


@pytest.mark.parametrize(("lat", "lon", "metres", "bearing"), [(0.001, 0.0, 111.1, 0), (0.0, -0.001, 83.8, 270)])
def test_a_station_that_stands_elsewhere_is_said_once_with_distance_and_direction(
    lat: float, lon: float, metres: float, bearing: int
) -> None:
    """A thousandth of a degree is 111.1 m north, and 83.8 m east at this latitude (WGS-84 radii of curvature)."""
    said = site_disagreements([source(41.3007 + lat, 2.1021 + lon, 27.0, c) for c in (34, 48)], HERE)
    (one,) = said
    assert "bcn (SAC/SIC 20/129)" in one
    assert f"towards {bearing} degrees" in one
    assert float(one.partition("stands ")[2].partition(" m away")[0]) == pytest.approx(metres, abs=0.2)


def test_a_height_that_differs_is_said() -> None:
    (one,) = site_disagreements([source(41.3007, 2.1021, 77.0)], HERE)
    assert "77 m" in one
    assert "27.0 m" in one
