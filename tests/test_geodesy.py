"""Geodesy against closed forms; pyproj is the oracle in tests/oracles/test_pyproj.py."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from boresight import geodesy

LATITUDE = st.floats(-np.pi / 2, np.pi / 2)
LONGITUDE = st.floats(-np.pi, np.pi)
HEIGHT = st.floats(-5000, 1e6)


@given(LATITUDE, LONGITUDE, HEIGHT)
def test_round_trip(lat: float, lon: float, height: float) -> None:
    position = geodesy.ecef_from_geodetic(lat, lon, height)
    back = geodesy.geodetic_from_ecef(position)
    again = geodesy.ecef_from_geodetic(*back)
    assert np.abs(again - position).max() < 2e-8
    assert abs(back[0] - lat) < 2e-13
    assert abs(back[2] - height) < 1e-7


@given(LATITUDE, LONGITUDE)
def test_rotation_is_orthonormal_and_right_handed(lat: float, lon: float) -> None:
    rotation = geodesy.enu_from_ecef(lat, lon)
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-15
    assert abs(np.linalg.det(rotation) - 1) < 1e-14


@given(LATITUDE, LONGITUDE, HEIGHT)
def test_up_is_the_gradient_of_height(lat: float, lon: float, height: float) -> None:
    position = geodesy.ecef_from_geodetic(lat, lon, height)
    value, up = geodesy.height_and_up(position)
    assert abs(value - height) < 1e-7
    assert np.abs(up - geodesy.enu_from_ecef(lat, lon)[2]).max() < 1e-9
    assert abs(geodesy.geodetic_from_ecef(position + 100 * up)[2] - height - 100) < 1e-7


def test_the_axes_have_their_lengths() -> None:
    equator, pole = geodesy.ecef_from_geodetic(0.0, 0.0, 0.0), geodesy.ecef_from_geodetic(np.pi / 2, 0.3, 10.0)
    assert np.abs(equator - [6378137.0, 0, 0]).max() < 1e-9
    assert np.abs(pole - [0, 0, 6356752.314245179 + 10]).max() < 1e-8


def test_local_enu_points_the_right_way() -> None:
    """A little north, east and up of Barcelona, by the radii of curvature."""
    lat, lon = np.radians(41.3), np.radians(2.1)
    step = 1e-6
    meridian = 6378137.0 * (1 - geodesy.E2) / (1 - geodesy.E2 * np.sin(lat) ** 2) ** 1.5
    normal = 6378137.0 / np.sqrt(1 - geodesy.E2 * np.sin(lat) ** 2)
    position = geodesy.ecef_from_geodetic([lat + step, lat, lat], [lon, lon + step, lon], [0.0, 0.0, 1.0])
    enu = geodesy.local_enu(position, lat, lon, 0.0)
    expected = np.diag([0.0, 0.0, 1.0])
    expected[0, 1], expected[1, 0] = meridian * step, normal * np.cos(lat) * step
    assert np.abs(enu - expected).max() < 1e-4


def test_scalars_and_arrays_agree() -> None:
    rng = np.random.default_rng(1)
    lat, lon, height = rng.uniform(-1.5, 1.5, 7), rng.uniform(-3, 3, 7), rng.uniform(0, 1e4, 7)
    many = geodesy.ecef_from_geodetic(lat, lon, height)
    back = geodesy.geodetic_from_ecef(many)
    turned = geodesy.enu_from_ecef(lat, lon)
    for k in range(7):
        one = geodesy.ecef_from_geodetic(lat[k], lon[k], height[k])
        assert one.shape == (3,)
        assert np.abs(one - many[k]).max() < 1e-8
        assert np.abs(np.array(geodesy.geodetic_from_ecef(one)) - np.array(back)[:, k]).max() < 1e-8
        assert np.abs(geodesy.enu_from_ecef(lat[k], lon[k]) - turned[k]).max() < 1e-15


def test_rotate_and_back() -> None:
    rng = np.random.default_rng(2)
    rotation = geodesy.enu_from_ecef(rng.uniform(-1.5, 1.5, 9), rng.uniform(-3, 3, 9))
    vector = rng.normal(size=(9, 3))
    turned = geodesy.rotate(rotation, vector)
    assert np.allclose(turned, [r @ v for r, v in zip(rotation, vector, strict=True)], atol=1e-15)
    assert np.abs(geodesy.rotate_back(rotation, turned) - vector).max() < 1e-14


def test_nan_stays_nan_and_does_not_spread() -> None:
    position = geodesy.ecef_from_geodetic([0.1, np.nan], [0.2, 0.3], [5.0, 6.0])
    lat, _, height = geodesy.geodetic_from_ecef(position)
    assert np.isnan(lat[1])
    assert np.isnan(height[1])
    assert abs(lat[0] - 0.1) < 1e-14
