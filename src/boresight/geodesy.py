"""WGS-84: geodetic, Earth-centred (ECEF) and local east-north-up (ENU) coordinates.

Angles are radians, lengths metres, heights ellipsoidal.  Arrays broadcast: n values give (n, 3), scalars give (3,).  Latitude is
geodetic everywhere, never geocentric.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ._types import FloatArray

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1 / 298.257223563
SEMI_MINOR_M = SEMI_MAJOR_M * (1 - FLATTENING)
E2 = FLATTENING * (2 - FLATTENING)
_EP2 = E2 / (1 - E2)


def ecef_from_geodetic(latitude_rad: ArrayLike, longitude_rad: ArrayLike, height_m: ArrayLike) -> FloatArray:
    """The Earth-centred position (n, 3), metres, of latitude, longitude (n,), radians, and ellipsoidal height (n,), metres."""
    lat, lon, h = np.broadcast_arrays(
        np.asarray(latitude_rad, np.float64), np.asarray(longitude_rad, np.float64), np.asarray(height_m, np.float64)
    )
    sin_lat, cos_lat = np.sin(lat), np.cos(lat)
    normal = SEMI_MAJOR_M / np.sqrt(1 - E2 * sin_lat * sin_lat)
    out = np.empty((*lat.shape, 3))
    out[..., 0] = (normal + h) * cos_lat * np.cos(lon)
    out[..., 1] = (normal + h) * cos_lat * np.sin(lon)
    out[..., 2] = (normal * (1 - E2) + h) * sin_lat
    return out


def geodetic_from_ecef(position: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitude, longitude (n,), radians, and ellipsoidal height (n,), metres, of Earth-centred positions (n, 3), metres.

    Bowring's method, two steps: exact to the rounding of the position from 10 km below the ellipsoid to beyond 1,000 km above
    it.  Longitude is within (-pi, pi]; on the axis, where it is not defined, it is that of the rounded position.
    """
    p = np.asarray(position, np.float64)
    rho, out, up, norm = _normal(p)
    return np.arctan2(up, out), np.arctan2(p[..., 1], p[..., 0]), _height(rho, p[..., 2], out / norm, up / norm)


def height_and_up(position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ellipsoidal height (n,), metres, and the ellipsoid's outward normal (n, 3), ECEF axes, at positions (n, 3), ECEF metres."""
    rho, out, up, norm = _normal(position)
    cos_lat, sin_lat = out / norm, up / norm
    side = cos_lat / np.maximum(rho, 1e-300)
    return _height(rho, position[..., 2], cos_lat, sin_lat), np.stack(
        [side * position[..., 0], side * position[..., 1], sin_lat], axis=-1
    )


def _normal(p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Distance from the axis; the normal's components away from the axis and along it, not normalised; their norm."""
    z = p[..., 2]
    rho = np.sqrt(p[..., 0] ** 2 + p[..., 1] ** 2)
    radius = np.sqrt(rho * rho + z * z)
    # The reduced latitude u, as a direction (cos u, sin u) so that the axis and the equator need no special case.
    cos_u = SEMI_MAJOR_M * rho
    sin_u = SEMI_MINOR_M * z * (1 + _EP2 * SEMI_MINOR_M / np.maximum(radius, 1.0))
    norm = np.maximum(np.sqrt(cos_u * cos_u + sin_u * sin_u), 1.0)
    cos_u, sin_u = cos_u / norm, sin_u / norm
    up = z + _EP2 * SEMI_MINOR_M * (sin_u * sin_u * sin_u)
    out = rho - E2 * SEMI_MAJOR_M * (cos_u * cos_u * cos_u)
    sin_u = (1 - FLATTENING) * up
    norm = np.maximum(np.sqrt(out * out + sin_u * sin_u), 1e-300)
    cos_u, sin_u = out / norm, sin_u / norm
    up = z + _EP2 * SEMI_MINOR_M * (sin_u * sin_u * sin_u)
    out = rho - E2 * SEMI_MAJOR_M * (cos_u * cos_u * cos_u)
    return rho, out, up, np.maximum(np.sqrt(out * out + up * up), 1e-300)


def _height(rho: FloatArray, z: FloatArray, cos_lat: FloatArray, sin_lat: FloatArray) -> FloatArray:
    return np.asarray(rho * cos_lat + z * sin_lat - SEMI_MAJOR_M * np.sqrt(1 - E2 * sin_lat * sin_lat))


def enu_from_ecef(latitude_rad: ArrayLike, longitude_rad: ArrayLike) -> FloatArray:
    """The rotation (n, 3, 3) from Earth-centred to local axes: ``enu = R @ (position - origin)``.

    The rows are the unit vectors east, north and up (along the ellipsoid's normal) at the latitude and longitude (n,), radians.
    """
    lat, lon = np.broadcast_arrays(np.asarray(latitude_rad, np.float64), np.asarray(longitude_rad, np.float64))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    out = np.zeros((*lat.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1] = -sin_lon, cos_lon
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = cos_lat * cos_lon, cos_lat * sin_lon, sin_lat
    return out


def rotate(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """``rotation @ vector`` for rotations (n, 3, 3) or (3, 3) and vectors (n, 3) or (3,)."""
    return (rotation @ vector[..., None])[..., 0]


def rotate_back(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """``rotation.T @ vector`` for rotations (n, 3, 3) or (3, 3) and vectors (n, 3) or (3,)."""
    return (vector[..., None, :] @ rotation)[..., 0, :]


def local_enu(
    position: FloatArray, origin_latitude_rad: ArrayLike, origin_longitude_rad: ArrayLike, origin_height_m: ArrayLike
) -> FloatArray:
    """East, north, up (n, 3), metres, of Earth-centred positions (n, 3) about an origin (scalars, or (n,) each)."""
    origin = ecef_from_geodetic(origin_latitude_rad, origin_longitude_rad, origin_height_m)
    return rotate(enu_from_ecef(origin_latitude_rad, origin_longitude_rad), np.asarray(position, np.float64) - origin)
