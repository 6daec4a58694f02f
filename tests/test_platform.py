"""A moving radar's reference about one fixed point: ranges, azimuths and elevations are those seen from the platform."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import SettingsError
from boresight.geodesy import ecef_from_geodetic
from boresight.measure import polar_from_position, site_of
from boresight.model import Fixes, Platform, Plots, Sensor, Sensors
from boresight.platform import about_platform, fix_platforms, moving, position_at

FERRY = Sensor(name="ferry", id=65536, kind="marine")


def sail(rng: np.random.Generator, latitude_deg: float, longitude_deg: float) -> tuple[Platform, Fixes]:
    """Own ship reported every second, and a boat seen at other times within some kilometres."""
    t = np.arange(100.0)
    own = Platform(
        time_s=t,
        sensor=np.full(100, 65536),
        latitude_rad=np.radians(latitude_deg) + np.cumsum(rng.uniform(-2e-6, 2e-6, 100)),
        longitude_rad=np.radians(longitude_deg) + np.cumsum(rng.uniform(-2e-6, 2e-6, 100)),
        height_m=np.full(100, 12.0),
    )
    when = rng.uniform(0, 99, 40)
    boat = Fixes(
        time_s=when,
        latitude_rad=np.radians(latitude_deg) + rng.uniform(-5e-4, 5e-4, 40),
        longitude_rad=np.radians(longitude_deg) + rng.uniform(-5e-4, 5e-4, 40),
        height_m=rng.uniform(0, 30, 40),
        mmsi=np.full(40, 257000001),
    )
    return own, boat


@given(st.integers(0, 2**31), st.floats(-75, 75), st.floats(-180, 180))
def test_polar_positions_are_those_from_the_platform(seed: int, latitude_deg: float, longitude_deg: float) -> None:
    rng = np.random.default_rng(seed)
    own, boat = sail(rng, latitude_deg, longitude_deg)
    seen, fixed, said = about_platform(boat, own, FERRY)
    assert len(seen) == len(boat)
    assert "moves" in said[0]
    found = polar_from_position(ecef_from_geodetic(seen.latitude_rad, seen.longitude_rad, seen.height_m), *site_of(fixed))
    at, known = position_at(own, boat.time_s)
    assert known.all()
    place = ecef_from_geodetic(boat.latitude_rad, boat.longitude_rad, boat.height_m)
    # The chord between two reports a second apart lies less than a micrometre below the surface.
    expected = np.linalg.norm(place - at, axis=1)
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-4)


def test_a_still_platform_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    own, boat = sail(rng, 63.0, 10.0)
    still = own.replace(latitude_rad=np.full(100, own.latitude_rad[0]), longitude_rad=np.full(100, own.longitude_rad[0]))
    seen, _, _ = about_platform(boat, still, FERRY)
    np.testing.assert_allclose(seen.latitude_rad, boat.latitude_rad, atol=1e-14)
    np.testing.assert_allclose(seen.longitude_rad, boat.longitude_rad, atol=1e-14)
    np.testing.assert_allclose(seen.height_m, boat.height_m, atol=1e-6)


def test_silence_is_not_bridged_and_is_counted() -> None:
    own, boat = sail(np.random.default_rng(2), 63.0, 10.0)
    silent = own[(own.time_s < 30) | (own.time_s > 60)]
    seen, _, said = about_platform(boat, silent, FERRY)
    gone = (boat.time_s > 29) & (boat.time_s < 61)
    assert len(seen) == np.count_nonzero(~gone)
    assert f"{np.count_nonzero(gone):,} of 40" in said[1]


def test_only_one_moving_radar_at_a_time() -> None:
    own, boat = sail(np.random.default_rng(3), 63.0, 10.0)
    sensors = Sensors((FERRY, Sensor(name="coast", sac=1, sic=1, lat_deg=63.0, lon_deg=10.0, height_m=0.0)))
    plots = Plots(time_s=[1.0, 2.0], sensor=[65536, 257], range_m=[1.0, 2.0], azimuth_rad=[0.0, 1.0])
    assert moving(plots, own) == [65536]
    with pytest.raises(SettingsError, match="ferry, coast"):
        fix_platforms(plots, boat, own, sensors)
    same, still, said = fix_platforms(plots[plots.sensor == 257], boat, own, sensors)
    assert same is boat
    assert still is sensors
    assert said == ()


@pytest.mark.real
def test_autoferry_pooled(data: Path) -> None:
    """Five scenarios of a marine radar on a moving ferry: stamped about 2 s late (an independent fit gave 1.98 ± 0.18 s)."""
    from boresight import flow

    scenarios = sorted((data / "autoferry").glob("scenario*"))
    run = flow.calibrate(scenarios, scenarios, Sensors((FERRY,)))
    k = run.calibration.index(65536, "time_offset")
    assert k is not None
    assert 1.4 <= run.calibration.value[0, k] <= 2.6
    (summary,) = run.calibration.sensors
    assert summary.after.median_m < 0.6 * summary.before.median_m
