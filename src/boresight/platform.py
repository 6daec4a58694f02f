"""A radar that moves: everything about its platform, so that the steps after it need not know.

A moving radar measures where targets are relative to itself.  Its reference is therefore re-expressed relative to the
platform, at each fix's own time, and put about one fixed point that stands for the antenna.  Rates come out right too: what a
late stamp, or any other term, does to a measured range depends on the motion of the target relative to the radar, not over
ground.
"""

from __future__ import annotations

import msgspec
import numpy as np

from ._types import BoolArray, FloatArray
from .errors import SettingsError
from .geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate, rotate_back
from .model import Fixes, Platform, Plots, Sensor, Sensors

# A platform's position is not interpolated across a longer silence.
_MAX_GAP_S = 10.0


def moving(plots: Plots, platform: Platform) -> list[int]:
    """The ids of the sensors among `plots` whose platform moves, in order."""
    return [int(key) for key in np.intersect1d(plots.sensor, platform.sensor)]


def position_at(platform: Platform, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The platform's position (n, 3), ECEF metres, at times (n,), by linear interpolation, and where it is known.

    It is not known beyond the first and last report, nor between two that are more than 10 s apart.
    """
    order = np.argsort(platform.time_s, kind="stable")
    order = order[np.isfinite(platform.latitude_rad[order]) & np.isfinite(platform.longitude_rad[order])]
    stamps, first = np.unique(platform.time_s[order], return_index=True)
    rows = order[first]
    if not len(rows):
        return np.full((len(time_s), 3), np.nan), np.zeros(len(time_s), bool)
    height = np.where(np.isfinite(platform.height_m[rows]), platform.height_m[rows], 0.0)
    place = ecef_from_geodetic(platform.latitude_rad[rows], platform.longitude_rad[rows], height)
    at = np.stack([np.interp(time_s, stamps, place[:, k]) for k in range(3)], axis=1)
    after = np.clip(np.searchsorted(stamps, time_s), 1, max(len(stamps) - 1, 1))
    if len(stamps) == 1:
        return at, np.abs(time_s - stamps[0]) < 1e-3
    gap = stamps[after] - stamps[after - 1]
    return at, (time_s >= stamps[0]) & (time_s <= stamps[-1]) & (gap <= _MAX_GAP_S)


def about_platform(fixes: Fixes, platform: Platform, sensor: Sensor) -> tuple[Fixes, Sensor, tuple[str, ...]]:
    """The fixes as the moving radar sees them, about one fixed point, and the sensor standing there.

    `fixes` are geodetic.  The fixed point is where the platform was first; the antenna's height is the sensor's own `height_m`
    where that is given (ellipsoidal), else the platform's.  Velocities are left to be found from the positions.  Fixes at times
    when the platform's position is not known are left out, and counted.
    """
    own = platform[platform.sensor == sensor.key]
    here, known = position_at(own, fixes.time_s)
    known &= np.isfinite(fixes.latitude_rad) & np.isfinite(fixes.longitude_rad)
    height = np.where(np.isfinite(fixes.height_m), fixes.height_m, 0.0)
    there = ecef_from_geodetic(fixes.latitude_rad, fixes.longitude_rad, height)
    first = int(np.flatnonzero(np.isfinite(own.latitude_rad))[0])
    latitude, longitude = float(own.latitude_rad[first]), float(own.longitude_rad[first])
    level = float(own.height_m[first]) if np.isfinite(own.height_m[first]) else 0.0
    lat, lon, up = geodetic_from_ecef(here)
    # The platform's own height does not enter: heave is not what the antenna's height is about.
    flat = ecef_from_geodetic(lat, lon, np.full(len(lat), level))
    enu = rotate(enu_from_ecef(lat, lon), there - flat)
    site, rotation = ecef_from_geodetic(latitude, longitude, level), enu_from_ecef(latitude, longitude)
    lat, lon, up = geodetic_from_ecef(site + rotate_back(rotation, enu))
    nothing = np.full(len(fixes), np.nan)
    seen = fixes.replace(
        latitude_rad=lat,
        longitude_rad=lon,
        height_m=up,
        velocity_east_mps=nothing,
        velocity_north_mps=nothing,
        velocity_up_mps=nothing,
    )[known]
    antenna = sensor.ellipsoidal_height_m
    fixed = msgspec.structs.replace(
        sensor,
        lat_deg=float(np.degrees(latitude)),
        lon_deg=float(np.degrees(longitude)),
        height_m=level if antenna is None else antenna,
        height_msl_m=None,
    )
    said = [f"{sensor.name}: its platform moves: the reference is taken relative to it, and the map is about the radar"]
    if not known.all():
        count = f"{(~known).sum():,} of {len(fixes):,} reference positions"
        said.append(f"{count} are at times when the platform's own is not known: not used")
    return seen, fixed, tuple(said)


def fix_platforms(plots: Plots, fixes: Fixes, platform: Platform, sensors: Sensors) -> tuple[Fixes, Sensors, tuple[str, ...]]:
    """`about_platform` for the one moving radar among the plots; nothing changes where none moves.

    Raises SettingsError where a moving radar is mixed with others: each has a reference of its own then.
    """
    ids = moving(plots, platform)
    if not ids:
        return fixes, sensors, ()
    others = np.setdiff1d(plots.sensor, ids).tolist()
    if len(ids) > 1 or others:
        names = ", ".join(s.name for s in sensors if s.key in [*ids, *others])
        raise SettingsError(
            f"the radars {names} are given together, and at least one of them moves",
            where="PLOTS",
            remedy="Calibrate a moving radar by itself.",
        )
    sensor = sensors.find(ids[0])
    if sensor is None:
        return fixes, sensors, ()
    seen, fixed, said = about_platform(fixes, platform, sensor)
    return seen, msgspec.structs.replace(sensors, sensor=tuple(fixed if s.key == fixed.key else s for s in sensors)), said
