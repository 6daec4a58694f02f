"""Geodesy and position reconstruction against pyproj (PROJ), an independent implementation."""

from __future__ import annotations

import numpy as np
import pytest

from boresight import geodesy, measure

pyproj = pytest.importorskip("pyproj")

TO_ECEF = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
FROM_ECEF = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)


def _globe(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude and longitude (deg) and height (m) over the globe, with the poles, equator and date line to the last bit."""
    rng = np.random.default_rng(seed)
    lat = np.degrees(np.arcsin(rng.uniform(-1, 1, n)))
    lon = rng.uniform(-180, 180, n)
    height = rng.uniform(-500, 100e3, n)
    corner = np.array([-90, -90 + 1e-9, -89.9999, -45, -1e-9, 0, 1e-9, 30, 45, 89.9999, 90 - 1e-7, 90.0])
    edge = np.array([-180, -180 + 1e-9, -90, -1e-10, 0, 90, 180 - 1e-9, 180.0])
    tall = np.array([-500.0, 0.0, 100e3])
    a, b, c = (v.ravel() for v in np.meshgrid(corner, edge, tall))
    return np.r_[lat, a], np.r_[lon, b], np.r_[height, c]


def _ecef(lat: np.ndarray, lon: np.ndarray, height: np.ndarray) -> np.ndarray:
    return np.stack(TO_ECEF.transform(lon, lat, height), axis=1)


def _topocentric(lat: float, lon: float, height: float) -> pyproj.Transformer:
    """ECEF to east, north, up."""
    where = f"+lon_0={float(lon)!r} +lat_0={float(lat)!r} +h_0={float(height)!r}"
    return pyproj.Transformer.from_pipeline(f"+proj=pipeline +step +proj=topocentric +ellps=WGS84 {where}")


def test_ecef_from_geodetic_over_the_globe() -> None:
    lat, lon, height = _globe(20000, 1)
    ours = geodesy.ecef_from_geodetic(np.radians(lat), np.radians(lon), height)
    assert np.abs(ours - _ecef(lat, lon, height)).max() < 1e-8


def test_geodetic_from_ecef_over_the_globe() -> None:
    """1e-11 deg in latitude and longitude, 1e-6 m in height, to 100 km height, back from PROJ's forward conversion.

    PROJ's own inverse is one step of Bowring's and is itself 8e-10 deg and 1e-4 m off at 100 km, so it is only the second judge.
    """
    lat, lon, height = _globe(20000, 2)
    position = _ecef(lat, lon, height)
    ours = geodesy.geodetic_from_ecef(position)
    rho = np.hypot(position[:, 0], position[:, 1])
    turn = np.degrees(ours[1]) - lon
    turn -= 360 * np.round(turn / 360)
    assert np.abs(np.degrees(ours[0]) - lat).max() < 1e-11
    assert np.abs(turn[rho > 1.0]).max() < 1e-11
    # On the axis longitude means nothing, but the distance that it turns through must still vanish.
    assert np.abs(np.radians(turn) * rho).max() < 1e-6
    assert np.abs(ours[2] - height).max() < 1e-6
    theirs = FROM_ECEF.transform(*position.T)
    assert np.abs(np.degrees(ours[0]) - theirs[1]).max() < 1e-9
    assert np.abs(ours[2] - theirs[2]).max() < 2e-4


def test_enu_against_the_topocentric_conversion() -> None:
    rng = np.random.default_rng(3)
    lat, lon, height = _globe(30, 4)
    for k in rng.choice(len(lat), 40, replace=False):
        pipeline = _topocentric(lat[k], lon[k], height[k])
        origin = _ecef(lat[k : k + 1], lon[k : k + 1], height[k : k + 1])
        position = origin + rng.normal(0, 200e3, (50, 3))
        theirs = np.stack(pipeline.transform(*position.T), axis=1)
        ours = geodesy.local_enu(position, np.radians(lat[k]), np.radians(lon[k]), height[k])
        assert np.abs(ours - theirs).max() < 1e-6


def _scene(n: int, seed: int) -> tuple[np.ndarray, ...]:
    """Radars anywhere and targets within 500 km of them, from pyproj's geodesic and geocentric conversions alone."""
    rng = np.random.default_rng(seed)
    lat, lon, _ = _globe(n, seed)
    pick = rng.permutation(len(lat))[:n]
    lat, lon = lat[pick], lon[pick]
    site_height = rng.uniform(-50, 4000, n)
    there_lon, there_lat, _ = pyproj.Geod(ellps="WGS84").fwd(lon, lat, rng.uniform(0, 360, n), rng.uniform(50, 500e3, n))
    height = rng.uniform(-100, 100e3, n)
    return lat, lon, site_height, np.asarray(there_lat), np.asarray(there_lon), height


def test_polar_against_pyproj_to_500_km() -> None:
    """Range, angle x range and the way back to 1e-6 m."""
    lat, lon, site_height, there_lat, there_lon, height = _scene(400, 5)
    site, target = _ecef(lat, lon, site_height), _ecef(there_lat, there_lon, height)
    rotation = geodesy.enu_from_ecef(np.radians(lat), np.radians(lon))
    polar = measure.polar_from_position(target, site, rotation)
    for k in range(len(lat)):
        pipeline = _topocentric(lat[k], lon[k], site_height[k])
        e, n, u = pipeline.transform(*target[k])
        r = np.sqrt(e * e + n * n + u * u)
        turn = measure.wrap_rad(polar[k, 1] - np.arctan2(e, n))
        assert abs(polar[k, 0] - r) < 1e-6
        assert abs(turn) * np.hypot(e, n) < 1e-6
        assert abs(polar[k, 2] - np.arctan2(u, np.hypot(e, n))) * r < 1e-6
    assert np.abs(measure.position_from_polar(polar, site, rotation) - target).max() < 1e-6


def test_position_from_height_against_pyproj() -> None:
    """Slant range, azimuth and height of a known target give the target back: heights to 1e-6 m, place as the geometry allows."""
    lat, lon, site_height, there_lat, there_lon, height = _scene(4000, 6)
    site, target = _ecef(lat, lon, site_height), _ecef(there_lat, there_lon, height)
    rotation = geodesy.enu_from_ecef(np.radians(lat), np.radians(lon))
    polar = measure.polar_from_position(target, site, rotation)
    found = measure.position_from_height(polar[:, 0], polar[:, 1], height, site, rotation)
    assert not np.isnan(found).any()
    assert np.abs(geodesy.geodetic_from_ecef(found)[2] - height).max() < 1e-6
    assert np.abs(np.linalg.norm(found - site, axis=1) - polar[:, 0]).max() < 1e-6
    # An error of height (1e-7 m) becomes one of ground range times tan E.
    allowed = 1e-6 * np.maximum(1.0, np.abs(np.tan(polar[:, 2])))
    assert (np.linalg.norm(found - target, axis=1) < allowed).all()


def test_flat_earth_is_785_m_off_where_we_are_not() -> None:
    """METHODS section 8's figure: at 100 km the earth has fallen away by 785 m."""
    lat, lon = np.array([45.0]), np.array([10.0])
    there_lon, there_lat, _ = pyproj.Geod(ellps="WGS84").fwd(lon, lat, [90.0], [100e3])
    site, target = _ecef(lat, lon, np.zeros(1)), _ecef(np.asarray(there_lat), np.asarray(there_lon), np.zeros(1))
    rotation = geodesy.enu_from_ecef(np.radians(lat), np.radians(lon))
    enu = geodesy.rotate(rotation, target - site)
    assert enu[0, 2] == pytest.approx(-785, abs=3)
    polar = measure.polar_from_enu(enu)
    found = measure.position_from_height(polar[:, 0], polar[:, 1], np.zeros(1), site, rotation)
    assert np.linalg.norm(found - target) < 1e-6


def test_position_from_plane_against_pyproj() -> None:
    lat, lon, site_height, there_lat, there_lon, height = _scene(200, 7)
    target = _ecef(there_lat, there_lon, height)
    for k in range(len(lat)):
        site = _ecef(lat[k : k + 1], lon[k : k + 1], site_height[k : k + 1])[0]
        rotation = geodesy.enu_from_ecef(np.radians(lat[k]), np.radians(lon[k]))
        enu = geodesy.rotate(rotation, target[k] - site)
        found = measure.position_from_plane(enu[:1], enu[1:2], height[k : k + 1], site, rotation)
        assert np.linalg.norm(found[0] - target[k]) < 1e-6
