"""Where a radar says that it stands, against where `sensors.toml` puts it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..geodesy import ecef_from_geodetic, local_enu
from ..model import Sensors, Source

# The steps of I034/120 and I019/600 are up to 2.4 m: twice that is no disagreement.
HORIZONTAL_M, VERTICAL_M = 5.0, 5.0


def site_disagreements(sources: Sequence[Source], sensors: Sensors) -> tuple[str, ...]:
    """One sentence for each source that says it stands elsewhere than `sensors` puts it; none where they agree or one is silent.

    Positions may differ by 5 m (the steps of the items are up to 2.4 m), heights by 5 m.
    """
    out: dict[str, None] = {}
    for source in sources:
        sensor = sensors.find(source.id)
        if sensor is None or sensor.lat_deg is None or sensor.lon_deg is None or not math.isfinite(source.latitude_rad):
            continue
        latitude, longitude = math.radians(sensor.lat_deg), math.radians(sensor.lon_deg)
        there = ecef_from_geodetic(np.array([source.latitude_rad]), np.array([source.longitude_rad]), np.zeros(1))
        east, north, _ = local_enu(there, latitude, longitude, 0.0)[0].tolist()
        apart = math.hypot(east, north)
        name = f"{sensor.name} (SAC/SIC {source.sac}/{source.sic})"
        if apart > HORIZONTAL_M:
            bearing = math.degrees(math.atan2(east, north)) % 360
            out[
                f"{name} says that it stands {apart:,.1f} m away from where sensors.toml puts it, towards {bearing:.0f} degrees: "
                f"at {math.degrees(source.latitude_rad):.6f}, {math.degrees(source.longitude_rad):.6f}"
            ] = None
        height = sensor.height_msl_m if sensor.height_msl_m is not None else sensor.height_m
        if height is not None and math.isfinite(source.height_m) and abs(source.height_m - height) > VERTICAL_M:
            kind = "above mean sea level" if sensor.height_msl_m is not None else "above the ellipsoid"
            out[
                f"{name} says that its height is {source.height_m:.0f} m, sensors.toml says {height:.1f} m {kind} "
                "(stations tell heights above mean sea level or the ellipsoid: the geoid lies between)"
            ] = None
    return tuple(out)
