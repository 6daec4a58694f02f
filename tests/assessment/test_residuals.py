"""Residuals against pyproj's geometry: what is put in comes out, with its sign."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod, Transformer

from boresight.assessment import Residuals, residuals
from boresight.calibration import Calibration, TermKey
from boresight.errors import SettingsError
from boresight.model import Channel, Pairs, Plots, Sensor, Sensors
from boresight.terms import TERMS

SITE = Sensor(name="Alpha", lat_deg=45.0, lon_deg=7.0, height_m=300.0, sac=1, sic=1)
OTHER = Sensor(name="Bravo", lat_deg=45.3, lon_deg=7.4, height_m=120.0, sac=1, sic=2)
SENSORS = Sensors((SITE, OTHER))
DEG = np.pi / 180
GEOD = Geod(ellps="WGS84")


def topocentric(sensor: Sensor) -> Transformer:
    """pyproj's ECEF -> east, north, up about the sensor."""
    return Transformer.from_pipeline(
        f"+proj=topocentric +ellps=WGS84 +lon_0={sensor.lon_deg} +lat_0={sensor.lat_deg} +h_0={sensor.height_m}"
    )


def polar(enu: np.ndarray) -> np.ndarray:
    e, n, u = enu.T
    return np.stack([np.sqrt(e**2 + n**2 + u**2), np.arctan2(e, n) % (2 * np.pi), np.arctan2(u, np.hypot(e, n))], axis=1)


def scene(n: int = 200, late_s: float = 0.0, sensor: Sensor = SITE, channel: Channel = Channel.SSR, seed: int = 3) -> Pairs:
    """Error-free plots of targets on straight lines, stamped `late_s` late, with the reference at the stamps."""
    random = np.random.default_rng(seed)
    enu = np.stack([random.uniform(-90e3, 90e3, n), random.uniform(-90e3, 90e3, n), random.uniform(500, 10e3, n)], axis=1)
    enu[:, :2] += np.sign(enu[:, :2]) * 3e3
    forward = topocentric(sensor)
    position = np.stack(forward.transform(*enu.T, direction="INVERSE"), axis=1)
    course, speed = random.uniform(0, 2 * np.pi, n), random.uniform(80, 250, n)
    lon, lat, _ = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*position.T)
    lon, lat = np.radians(lon), np.radians(lat)
    east = np.stack([-np.sin(lon), np.cos(lon), 0 * lon], axis=1)
    north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=1)
    velocity = speed[:, None] * (np.sin(course)[:, None] * east + np.cos(course)[:, None] * north)
    measured = polar(np.stack(forward.transform(*(position - late_s * velocity).T), axis=1))
    plots = Plots(
        time_s=1e9 + np.arange(n), sensor=np.full(n, sensor.key), channel=np.full(n, channel),
        range_m=measured[:, 0], azimuth_rad=measured[:, 1], elevation_rad=measured[:, 2],
    )  # fmt: skip
    return Pairs(
        plot=np.arange(n), plots=plots, target=np.arange(n) % 7, track=np.arange(n) % 9, position=position, velocity=velocity,
        acceleration=np.zeros((n, 3)), heading_rad=course, length_m=np.full(n, 35.0),
    )  # fmt: skip


def calibration(values: dict[str, float], sensor: Sensor = SITE, channel: str = "all") -> Calibration:
    terms = tuple(TermKey(sensor.key, channel, name, TERMS[name].unit) for name in values)
    p = len(terms)
    return Calibration(terms, np.array([1e9]), np.array([list(values.values())]).reshape(1, p), np.eye(p)[None] * 1e-6)


def test_error_free_plots_have_no_residual() -> None:
    r = residuals(scene(), SENSORS, calibration({}))
    for name in ("range_before_m", "east_before_m", "north_before_m", "distance_after_m", "along_after_m", "across_after_m"):
        assert np.abs(getattr(r, name)).max() < 2e-5, name
    for name in ("azimuth_before_rad", "elevation_after_rad"):
        assert np.abs(getattr(r, name)).max() < 1e-10, name


def test_reference_columns_are_those_of_pyproj() -> None:
    pairs = scene()
    r = residuals(pairs, SENSORS, calibration({}))
    expected = polar(np.stack(topocentric(SITE).transform(*pairs.position.T), axis=1))
    np.testing.assert_allclose(r.reference_range_m, expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(r.reference_azimuth_rad, expected[:, 1], atol=1e-11)
    np.testing.assert_allclose(r.reference_elevation_rad, expected[:, 2], atol=1e-11)
    lon, lat, height = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*pairs.position.T)
    np.testing.assert_allclose(np.degrees(r.latitude_rad), lat, atol=1e-11)
    np.testing.assert_allclose(np.degrees(r.longitude_rad), lon, atol=1e-11)
    np.testing.assert_allclose(r.reference_height_m, height, atol=1e-6)
    np.testing.assert_allclose(r.reference_speed_mps, np.linalg.norm(pairs.velocity, axis=1), rtol=1e-9)
    np.testing.assert_allclose(np.cos(r.reference_course_rad - pairs.heading_rad), 1.0, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(range_m=st.floats(-400, 400), azimuth_deg=st.floats(-3, 3), elevation_deg=st.floats(-1, 1))
def test_a_bias_comes_out_as_put_in_and_goes_away(range_m: float, azimuth_deg: float, elevation_deg: float) -> None:
    pairs = scene(60)
    p = pairs.plots
    biased = pairs.replace(
        plots=p.replace(
            range_m=p.range_m + range_m,
            azimuth_rad=(p.azimuth_rad + azimuth_deg * DEG) % (2 * np.pi),
            elevation_rad=p.elevation_rad + elevation_deg * DEG,
        )
    )
    values = {"range_bias": range_m, "azimuth_bias": azimuth_deg * DEG, "elevation_bias": elevation_deg * DEG}
    r = residuals(biased, SENSORS, calibration(values))
    np.testing.assert_allclose(r.range_before_m, range_m, atol=1e-6)
    np.testing.assert_allclose(r.azimuth_before_rad, azimuth_deg * DEG, atol=1e-10)
    np.testing.assert_allclose(r.elevation_before_rad, elevation_deg * DEG, atol=1e-10)
    assert np.nanmax(r.distance_after_m) < 1e-4
    # The plot's latitude and longitude before correction are as far from the reference's as the distance says.
    _, _, along_ground = GEOD.inv(*np.degrees([r.longitude_rad, r.latitude_rad, r.longitude_before_rad, r.latitude_before_rad]))
    np.testing.assert_allclose(along_ground * (1 + r.reference_height_m / 6.37e6), r.distance_before_m, rtol=2e-3, atol=1e-3)


def test_plots_stamped_late_lie_behind_and_come_back() -> None:
    pairs = scene(late_s=2.0)
    r = residuals(pairs, SENSORS, calibration({"time_offset": 2.0}))
    np.testing.assert_allclose(r.along_before_m, -2.0 * r.reference_speed_mps, rtol=1e-3)
    assert np.abs(r.across_before_m).max() < 0.5
    assert r.distance_after_m.max() < 1e-3
    assert np.abs(r.range_after_m).max() < 1e-3


def test_along_and_across_follow_the_course() -> None:
    """An echo 20 m ahead of the antenna: +20 along, 0 across; and a shift to the right is a positive across."""
    pairs = scene()
    step = pairs.velocity / np.linalg.norm(pairs.velocity, axis=1)[:, None]
    measured = polar(np.stack(topocentric(SITE).transform(*(pairs.position + 20.0 * step).T), axis=1))
    ahead = pairs.replace(plots=pairs.plots.replace(range_m=measured[:, 0], azimuth_rad=measured[:, 1]))
    r = residuals(ahead, SENSORS, calibration({"along_heading": 20.0}))
    np.testing.assert_allclose(r.along_before_m, 20.0, atol=0.02)
    np.testing.assert_allclose(r.across_before_m, 0.0, atol=0.02)
    # The term turns the target's heading into the antenna's horizon as it stands; meridians converge by 0.8° over 90 km.
    assert r.distance_after_m.max() < 20.0 * np.radians(1.0)
    turned = residuals(
        pairs.replace(plots=pairs.plots.replace(azimuth_rad=pairs.plots.azimuth_rad + 1e-3)), SENSORS, calibration({})
    )
    outward = np.abs(np.cos(r.reference_course_rad - r.reference_azimuth_rad)) > 0.9
    sign = np.sign(np.cos(r.reference_course_rad - r.reference_azimuth_rad))
    assert outward.sum() > 10
    assert (turned.across_before_m[outward] * sign[outward] > 0).all()


def test_extent_in_proportion_to_length_uses_lengths_measured_by_the_radar() -> None:
    """A target whose length only the radar's plots tell gets its correction, as in registration."""
    pairs = scene().replace(length_m=np.full(200, np.nan))
    pairs = pairs.replace(plots=pairs.plots.replace(length_m=np.where(np.arange(200) % 2 == 0, 40.0, np.nan)))
    r = residuals(pairs, SENSORS, calibration({"along_heading_per_length": -0.5}))
    np.testing.assert_allclose(r.along_after_m, 20.0, atol=0.05)


def test_azimuth_differences_are_taken_on_the_circle() -> None:
    pairs = scene()
    r = residuals(
        pairs.replace(plots=pairs.plots.replace(azimuth_rad=pairs.plots.azimuth_rad + 2 * np.pi - 0.002)),
        SENSORS,
        calibration({}),
    )
    np.testing.assert_allclose(r.azimuth_before_rad, -0.002, atol=1e-9)


def test_terms_touch_only_their_sensor_and_channel() -> None:
    both = Pairs.concat([scene(), scene(sensor=OTHER, channel=Channel.MODE_S)])
    r = residuals(both, SENSORS, calibration({"range_bias": 50.0}, OTHER))
    np.testing.assert_allclose(r.range_after_m, np.repeat([0.0, -50.0], 200), atol=1e-5)
    r = residuals(both, SENSORS, calibration({"range_bias": 50.0}, OTHER, "ssr"))
    np.testing.assert_allclose(r.range_after_m, 0.0, atol=1e-5)
    r = residuals(both, SENSORS, calibration({"range_bias": 50.0}, OTHER, "mode_s"))
    np.testing.assert_allclose(r.range_after_m[200:], -50.0, atol=1e-5)


def test_a_calibration_over_time_is_interpolated_and_held() -> None:
    draft = calibration({"range_bias": 0.0})
    over_time = Calibration(draft.terms, np.array([1e9 + 50, 1e9 + 150]), np.array([[0.0], [100.0]]), np.ones((2, 1, 1)))
    r = residuals(scene(), SENSORS, over_time)
    np.testing.assert_allclose(r.range_after_m, -np.clip(np.arange(200) - 50.0, 0, 100), atol=1e-5)


def test_north_offset_counts() -> None:
    turned = Sensors(
        (Sensor(name="Alpha", lat_deg=45.0, lon_deg=7.0, height_m=300.0, sac=1, sic=1, north="magnetic", north_offset_deg=2.0),)
    )
    np.testing.assert_allclose(residuals(scene(), turned, calibration({})).azimuth_before_rad, 2.0 * DEG, atol=1e-9)


def test_order_length_and_absent_elevation() -> None:
    pairs = scene(20_000)
    pairs = pairs.replace(plots=pairs.plots.replace(elevation_rad=np.full(20_000, np.nan)))
    r = residuals(pairs, SENSORS, calibration({"range_bias": 1.0}))
    assert len(r) == 20_000
    np.testing.assert_array_equal(r.plot, pairs.plot)
    np.testing.assert_array_equal(r.time_s, pairs.plots.time_s)
    assert np.isnan(r.elevation_before_rad).all()
    assert np.isfinite(r.distance_before_m).all()


def test_no_pairs_give_an_empty_table() -> None:
    r = residuals(Pairs(), SENSORS, calibration({"range_bias": 1.0}))
    assert isinstance(r, Residuals)
    assert len(r) == 0


def test_an_unknown_sensor_is_named() -> None:
    with pytest.raises(SettingsError, match="1/2"):
        residuals(scene(sensor=OTHER), Sensors((SITE,)), calibration({}))
