"""What a radar measures: range, azimuth and elevation of a position, their rates and Jacobians, and the way back.

Polar triples (n, 3) are (slant range m, azimuth rad clockwise from true north in [0, 2 pi), elevation rad above the local
horizontal), about the antenna; ENU triples are metres about the antenna.  METHODS section 6: slant range and height give the
position by true geometry on the ellipsoid, never over a flat earth (785 m off at 100 km).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ._types import FloatArray
from .errors import InputError, SettingsError
from .geodesy import E2, SEMI_MAJOR_M, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, height_and_up, rotate, rotate_back
from .model import Fixes, Flag, Plots, Sensor, Sensors

TWO_PI = 2 * np.pi
# Azimuth has no derivative over the antenna: closer to the axis than a millimetre its rates are those of a millimetre.
_AXIS_M2 = 1e-6
_NEWTON_M = 1e-7
_SURE_M = 0.5
_NEWTON_STEPS = 12


def wrap_rad(angle: ArrayLike) -> FloatArray:
    """The same angle (n,), radians, within (-pi, pi]."""
    a = np.asarray(angle, np.float64)
    turned = np.pi - np.mod(np.pi - a, TWO_PI)
    # Angles that are already within are returned bit for bit; rounding in mod could also give -pi.
    return np.where((a > -np.pi) & (a <= np.pi), a, np.where(turned <= -np.pi, np.pi, turned))


def wrap_turn(angle: ArrayLike) -> FloatArray:
    """The same angle (n,), radians, within [0, 2 pi)."""
    turned = np.mod(np.asarray(angle, np.float64), TWO_PI)
    return np.where(turned >= TWO_PI, 0.0, turned)


def polar_from_enu(enu: FloatArray) -> FloatArray:
    """Slant range, azimuth and elevation (n, 3) of local positions (n, 3), metres."""
    e, n, u = enu[..., 0], enu[..., 1], enu[..., 2]
    ground = np.hypot(e, n)
    return np.stack([np.hypot(ground, u), wrap_turn(np.arctan2(e, n)), np.arctan2(u, ground)], axis=-1)


def enu_from_polar(polar: FloatArray) -> FloatArray:
    """Local positions (n, 3), metres, of slant range, azimuth and elevation (n, 3)."""
    r, a, el = polar[..., 0], polar[..., 1], polar[..., 2]
    ground = r * np.cos(el)
    return np.stack([ground * np.sin(a), ground * np.cos(a), r * np.sin(el)], axis=-1)


def polar_motion(
    enu: FloatArray, velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray | None = None, *, order: int = 3
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Slant range, azimuth and elevation, and their first, second and third rates, of a moving target.

    All arguments are (n, 3), local axes, SI; all four results (n, 3) with columns (range, azimuth, elevation).  The derivatives
    are exact.  `jerk` only enters the third; without it the target's jerk is taken as zero.  Rates beyond the `order` (0 … 3)
    are not computed, and NaN.
    """
    p, v, a = enu, velocity, acceleration
    polar = polar_from_enu(p)
    unknown = np.broadcast_to(np.nan, p.shape)
    if order < 1:
        return polar, unknown, unknown, unknown
    r = np.maximum(polar[:, 0], 1e-3)

    def dot(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("ij,ij->i", x, y))

    r1 = dot(p, v) / r
    # The angle of a plane vector (x up, y along) obeys angle' * s = c, with s its squared length and c the cross product;
    # differentiating that product gives the higher rates.
    h, hv = p[:, :2], v[:, :2]
    s0 = np.maximum(dot(h, h), _AXIS_M2)
    s1 = 2 * dot(h, hv)
    a1 = (p[:, 1] * v[:, 0] - p[:, 0] * v[:, 1]) / s0
    g = np.sqrt(s0)
    g1 = s1 / (2 * g)
    u, u1, q0 = p[:, 2], v[:, 2], r * r
    e1 = (g * u1 - u * g1) / q0
    first = np.stack([r1, a1, e1], axis=1)
    if order < 2:
        return polar, first, unknown, unknown

    r2 = (dot(v, v) + dot(p, a) - r1 * r1) / r
    ha = a[:, :2]
    s2 = 2 * (dot(hv, hv) + dot(h, ha))
    a2 = (p[:, 1] * a[:, 0] - p[:, 0] * a[:, 1] - a1 * s1) / s0
    g2 = (s2 / 2 - g1 * g1) / g
    u2, q1 = a[:, 2], 2 * r * r1
    e2 = (g * u2 - u * g2 - e1 * q1) / q0
    second = np.stack([r2, a2, e2], axis=1)
    if order < 3:
        return polar, first, second, unknown

    j = np.zeros_like(p) if jerk is None else jerk
    hj = j[:, :2]
    r3 = (3 * dot(v, a) + dot(p, j) - 3 * r1 * r2) / r
    s3 = 2 * (3 * dot(hv, ha) + dot(h, hj))
    c2 = v[:, 1] * a[:, 0] + p[:, 1] * j[:, 0] - v[:, 0] * a[:, 1] - p[:, 0] * j[:, 1]
    a3 = (c2 - 2 * a2 * s1 - a1 * s2) / s0
    g3 = (s3 / 2 - 3 * g1 * g2) / g
    q2 = 2 * (r1 * r1 + r * r2)
    e3 = (g1 * u2 + g * j[:, 2] - u1 * g2 - u * g3 - 2 * e2 * q1 - e1 * q2) / q0
    return polar, first, second, np.stack([r3, a3, e3], axis=1)


def polar_jacobian(enu: FloatArray) -> FloatArray:
    """d(range, azimuth, elevation) / d(east, north, up), (n, 3, 3), at local positions (n, 3)."""
    e, n, u = enu[..., 0], enu[..., 1], enu[..., 2]
    ground2 = np.maximum(e * e + n * n, _AXIS_M2)
    ground, r2 = np.sqrt(ground2), ground2 + u * u
    r = np.sqrt(r2)
    out = np.zeros((*e.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = e / r, n / r, u / r
    out[..., 1, 0], out[..., 1, 1] = n / ground2, -e / ground2
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = -e * u / (ground * r2), -n * u / (ground * r2), ground / r2
    return out


def enu_jacobian(polar: FloatArray) -> FloatArray:
    """d(east, north, up) / d(range, azimuth, elevation), (n, 3, 3), at slant range, azimuth and elevation (n, 3)."""
    r, a, el = polar[..., 0], polar[..., 1], polar[..., 2]
    sin_a, cos_a, sin_e, cos_e = np.sin(a), np.cos(a), np.sin(el), np.cos(el)
    out = np.zeros((*r.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = cos_e * sin_a, r * cos_e * cos_a, -r * sin_e * sin_a
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = cos_e * cos_a, -r * cos_e * sin_a, -r * sin_e * cos_a
    out[..., 2, 0], out[..., 2, 2] = sin_e, r * cos_e
    return out


def sensors_of(plots: Plots, sensors: Sensors) -> dict[int, Sensor]:
    """The entries of `sensors.toml` that the plots need, by id, in the order of the ids.

    Raises SettingsError for a plot whose sensor has no entry, or an entry without a position; it names the sensor.
    """
    found: dict[int, Sensor] = {}
    for key in np.unique(plots.sensor).tolist():
        sensor = sensors.find(key)
        if sensor is None:
            which = f"SAC/SIC {key >> 8}/{key & 255}" if 0 <= key < 65536 else f"id {key}"
            how = f"sac = {key >> 8} and sic = {key & 255}" if 0 <= key < 65536 else f"id = {key}"
            raise SettingsError(
                f"the plots hold a sensor {which} that has no entry",
                where="sensors.toml",
                remedy=f"Add a [[sensor]] with {how}, lat_deg, lon_deg and height_m, or leave its plots out.",
            )
        if sensor.lat_deg is None or sensor.lon_deg is None:
            raise SettingsError(
                f"the sensor {sensor.name!r} has no position",
                where="sensors.toml",
                remedy="Give lat_deg, lon_deg and height_m (ellipsoidal) of its antenna; if it moves, a recording of its way.",
            )
        found[key] = sensor
    return found


def site_of(sensor: Sensor) -> tuple[FloatArray, FloatArray]:
    """Position (3,), ECEF metres, and ``enu_from_ecef`` (3, 3) of a fixed sensor; a height that is not given is 0.

    Raises SettingsError where the sensor has no position.
    """
    if sensor.lat_deg is None or sensor.lon_deg is None:
        raise SettingsError(
            f"the sensor {sensor.name!r} has no position",
            where="sensors.toml",
            remedy="Give lat_deg, lon_deg and height_m of its antenna.",
        )
    lat, lon = np.radians(sensor.lat_deg), np.radians(sensor.lon_deg)
    return ecef_from_geodetic(lat, lon, sensor.ellipsoidal_height_m or 0.0), enu_from_ecef(lat, lon)


def sites(plots: Plots, sensors: Sensors) -> tuple[FloatArray, FloatArray]:
    """Where each plot's antenna stands: positions (n, 3), ECEF metres, and ``enu_from_ecef`` (n, 3, 3).

    A height that is not given is taken as 0 on the ellipsoid: pass `site_warnings` on to the user.  Raises SettingsError for a
    sensor without an entry or without a position.
    """
    position, rotation = np.empty((len(plots), 3)), np.empty((len(plots), 3, 3))
    for key, sensor in sensors_of(plots, sensors).items():
        rows = plots.sensor == key
        position[rows], rotation[rows] = site_of(sensor)
    return position, rotation


def site_warnings(plots: Plots, sensors: Sensors, *, positions: bool = True) -> tuple[str, ...]:
    """What the user must know of heights and north references that `sensors.toml` does not give, with the effect in metres.

    With `positions`, also of the height of the ground, which matters where plots are to be placed without a reference.
    """
    out: list[str] = []
    for key, sensor in sensors_of(plots, sensors).items():
        mine = plots[plots.sensor == key]
        on_ground = sensor.kind in _ON_GROUND
        if sensor.ellipsoidal_height_m is None:
            above = np.where(np.isfinite(mine.height_m), mine.height_m, mine.pressure_altitude_m)
            rows = np.isfinite(above) & (mine.range_m > np.abs(above))
            if rows.any():
                effect = float(np.median(100 * np.abs(above[rows]) / np.sqrt(mine.range_m[rows] ** 2 - above[rows] ** 2)))
                effect_text = (
                    f"every 100 m of height moves its targets by {effect:.0f} m along the range (median of {rows.sum()} plots)"
                )
            else:
                effect_text = "a target at 10 km height and 50 km range moves by 20 m along the range for every 100 m of height"
            out.append(f"sensor {sensor.name!r} has no height_m; 0 m on the ellipsoid is assumed: {effect_text}")
        elif positions and on_ground and sensor.ground_height_m is None and len(mine) and not np.isfinite(mine.height_m).any():
            near = float(np.nanmedian(mine.range_m)) if np.isfinite(mine.range_m).any() else np.nan
            if np.isfinite(near) and near > 30:
                out.append(
                    f"sensor {sensor.name!r} has no ground_height_m; its targets are taken at its antenna's height: one standing "
                    f"30 m above the ground makes {near - np.sqrt(near**2 - 900):.1f} m of range at {near:.0f} m (the median)"
                )
        if sensor.north != "true" and sensor.north_offset_deg == 0:
            out.append(
                f"sensor {sensor.name!r} measures from {sensor.north} north but has no north_offset_deg (true minus measured "
                "azimuth); 0 is assumed, and the azimuth bias contains it"
            )
    return tuple(out)


_ON_GROUND = ("surface", "marine")


def true_azimuth(plots: Plots, sensors: Sensors) -> FloatArray:
    """The plots' azimuths from true north (n,), radians in [0, 2 pi): measured plus the sensor's `north_offset_deg`.

    Only here and in `from_true_north` is the north reference applied.  Raises SettingsError as `sites` does.
    """
    azimuth = wrap_turn(plots.azimuth_rad)
    for key, sensor in sensors_of(plots, sensors).items():
        if sensor.north_offset_deg != 0:
            rows = plots.sensor == key
            azimuth[rows] = from_true_north(plots.azimuth_rad[rows], sensor)
    return azimuth


def from_true_north(azimuth_rad: FloatArray, sensor: Sensor) -> FloatArray:
    """Azimuths (n,) that `sensor` measured, from true north, radians in [0, 2 pi)."""
    return wrap_turn(azimuth_rad + np.radians(sensor.north_offset_deg))


def heading_about(heading_rad: FloatArray, position: FloatArray, enu_from_ecef: FloatArray) -> FloatArray:
    """Headings (n,), radians from true north where the targets are, as bearings from the antenna's north.

    `position` (n, 3) is the targets', ECEF metres; `enu_from_ecef` is (3, 3) or (n, 3, 3).  The two norths differ by the
    convergence of the meridians: 0.8 degrees at 90 km and 45 degrees of latitude, which is 0.3 m across for a displacement of
    20 m.  NaN stays NaN.
    """
    _, plumb = height_and_up(position)
    side = np.maximum(np.hypot(plumb[:, 0], plumb[:, 1]), 1e-12)
    sin_h, cos_h = np.sin(heading_rad), np.cos(heading_rad)
    ahead = np.empty_like(plumb)
    ahead[:, 0] = (-sin_h * plumb[:, 1] - cos_h * plumb[:, 2] * plumb[:, 0]) / side
    ahead[:, 1] = (sin_h * plumb[:, 0] - cos_h * plumb[:, 2] * plumb[:, 1]) / side
    ahead[:, 2] = cos_h * side
    local = rotate(enu_from_ecef, ahead)
    return wrap_turn(np.arctan2(local[:, 0], local[:, 1]))


def position_from_polar(polar: FloatArray, site: FloatArray, enu_from_ecef: FloatArray) -> FloatArray:
    """Positions (n, 3), ECEF metres, of slant range, azimuth and elevation (n, 3) about antennas.

    `site` is (n, 3) or (3,), ECEF metres; `enu_from_ecef` (n, 3, 3) or (3, 3).
    """
    return site + rotate_back(enu_from_ecef, enu_from_polar(polar))


def polar_from_position(position: FloatArray, site: FloatArray, enu_from_ecef: FloatArray) -> FloatArray:
    """Slant range, azimuth and elevation (n, 3) of positions (n, 3), ECEF metres: `position_from_polar` backwards."""
    return polar_from_enu(rotate(enu_from_ecef, position - site))


def position_from_height(
    range_m: FloatArray, azimuth_rad: FloatArray, height_m: FloatArray, site: FloatArray, enu_from_ecef: FloatArray
) -> FloatArray:
    """Positions (n, 3), ECEF metres, of targets at a slant range, azimuth and ellipsoidal height (n,) each.

    `site` is (n, 3) or (3,), ECEF metres; `enu_from_ecef` (n, 3, 3) or (3, 3).  Solved on the ellipsoid by Newton's method to
    1e-6 m of height; NaN where the slant range is less than the difference of the heights.
    """
    r, a, h = (
        np.ascontiguousarray(v)
        for v in np.broadcast_arrays(*(np.asarray(v, np.float64) for v in (range_m, azimuth_rad, height_m)))
    )
    shape = (len(r), 3)
    origin, rotation = np.broadcast_to(site, shape), np.broadcast_to(enu_from_ecef, (*shape, 3))
    # Azimuth's direction and the vertical, in Earth-centred axes.
    outward = np.sin(a)[:, None] * rotation[:, 0] + np.cos(a)[:, None] * rotation[:, 1]
    vertical = rotation[:, 2]
    latitude, _, site_height = geodetic_from_ecef(site)
    sin2 = np.sin(latitude) ** 2
    # The ellipsoid's radius of curvature in the azimuth's plane (Euler): the start is the closed form on that sphere.
    meridian = SEMI_MAJOR_M * (1 - E2) / (1 - E2 * sin2) ** 1.5
    normal = SEMI_MAJOR_M / np.sqrt(1 - E2 * sin2)
    radius = 1 / (np.cos(a) ** 2 / meridian + np.sin(a) ** 2 / normal)
    centre = radius + site_height
    # The unknown is the height above the antenna's horizontal, not the elevation: the target's height changes with it
    # by nearly 1 everywhere, overhead too.
    up = np.clip(((radius + h) ** 2 - centre**2 - r * r) / (2 * centre), -r, r)
    out = np.full(shape, np.nan)
    rows = np.flatnonzero(np.isfinite(up) & (r >= 0))
    for _ in range(_NEWTON_STEPS):
        u = up[rows]
        ground = np.sqrt(np.maximum(r[rows] ** 2 - u * u, 0.0))
        position = origin[rows] + ground[:, None] * outward[rows] + u[:, None] * vertical[rows]
        height, plumb = height_and_up(position)
        missing = h[rows] - height
        done = np.abs(missing) <= _NEWTON_M
        out[rows[done]] = position[done]
        if done.all():
            break
        slope = np.einsum("ij,ij->i", plumb, vertical[rows]) - np.einsum("ij,ij->i", plumb, outward[rows]) * u / np.maximum(
            ground, 1.0
        )
        moved = np.clip(u + missing / slope, -r[rows], r[rows])
        # A step as short as this ends within the tolerance (what Newton's method leaves is its square over the earth's radius).
        sure = ~done & (np.abs(missing) <= _SURE_M) & (ground > 0.1 * r[rows])
        if sure.any():
            mine, at = rows[sure], moved[sure]
            out[mine] = origin[mine] + np.sqrt(r[mine] ** 2 - at * at)[:, None] * outward[mine] + at[:, None] * vertical[mine]
        # Straight above or below the antenna and still wanting to go on: no such point.
        going = ~done & ~sure & (moved != u)
        up[rows] = moved
        rows = rows[going]
    return out


def position_from_plane(
    x_m: FloatArray, y_m: FloatArray, height_m: FloatArray, site: FloatArray, enu_from_ecef: FloatArray
) -> FloatArray:
    """Positions (n, 3), ECEF metres, from east and north in the plane of a reference point, and ellipsoidal height (n,).

    `site` (3,), ECEF metres, and `enu_from_ecef` (3, 3) belong to the reference point.  Newton's method, to 1e-6 m of height.
    """
    x, y, h = np.broadcast_arrays(*(np.asarray(v, np.float64) for v in (x_m, y_m, height_m)))
    enu = np.stack([x, y, h - geodetic_from_ecef(site)[2]], axis=-1)
    vertical = enu_from_ecef[2]
    position = site + rotate_back(enu_from_ecef, enu)
    for _ in range(_NEWTON_STEPS):
        height, plumb = height_and_up(position)
        missing = h - height
        if not np.any(np.abs(missing) > _NEWTON_M):
            break
        position = position + (missing / (plumb @ vertical))[..., None] * vertical
    return position


def plot_positions(plots: Plots, sensors: Sensors, height_m: FloatArray | None = None) -> FloatArray:
    """Where the plots lie: positions (n, 3), ECEF metres; NaN where nothing gives a height or the geometry is impossible.

    The first of these that a plot has decides: the `height_m` (n,) given here (ellipsoidal, of the reference or the track); the
    measured elevation; the plot's own height; for targets on the ground (surface and marine radars, ground flag) the sensor's
    `ground_height_m`, else the antenna's height; the pressure altitude, by what `sensors` tells of the atmosphere.  Raises
    SettingsError as `sites` does.
    """
    if height_m is not None and np.shape(height_m) != (len(plots),):
        raise InputError(f"height_m has the shape {np.shape(height_m)}, but one height a plot, {(len(plots),)}, is needed")
    from .heights import height_profile, plot_heights

    position, rotation = sites(plots, sensors)
    azimuth = true_azimuth(plots, sensors)
    given = np.full(len(plots), np.nan) if height_m is None else np.asarray(height_m, np.float64)
    height = np.where(np.isfinite(given), given, plots.height_m)
    for key, sensor in sensors_of(plots, sensors).items():
        low = (plots.sensor == key) & ~np.isfinite(height)
        if sensor.kind not in _ON_GROUND:
            low &= (plots.flags & np.uint32(Flag.GROUND)) != 0
        ground = sensor.ground_height_m if sensor.ground_height_m is not None else sensor.ellipsoidal_height_m or 0.0
        height[low] = ground
    height = np.where(np.isfinite(height), height, plot_heights(plots, height_profile(Fixes(), sensors))[0])
    out = np.full((len(plots), 3), np.nan)
    by_elevation = ~np.isfinite(given) & np.isfinite(plots.elevation_rad)
    rows = np.flatnonzero(by_elevation)
    if len(rows):
        polar = np.stack([plots.range_m[rows], azimuth[rows], plots.elevation_rad[rows]], axis=1)
        out[rows] = position_from_polar(polar, position[rows], rotation[rows])
    rows = np.flatnonzero(~by_elevation & np.isfinite(height))
    if len(rows):
        out[rows] = position_from_height(plots.range_m[rows], azimuth[rows], height[rows], position[rows], rotation[rows])
    return out
