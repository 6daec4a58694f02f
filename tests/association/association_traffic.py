"""A small scene for the tests of association: aircraft over a radar, with all truth.  Not the product's simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef
from boresight.model import Fixes, Plots, Sensor, Sensors

LAT, LON, HEIGHT = 41.3, 2.1, 50.0


@dataclass
class Scene:
    """Plots and fixes with the aircraft that each belongs to (`plot_of`, `fix_of`); -1 in `plot_of` is clutter."""

    plots: Plots
    fixes: Fixes
    sensors: Sensors
    plot_of: np.ndarray
    fix_of: np.ndarray


def radar(**change: object) -> Sensor:
    """The radar of the scenes."""
    values = {
        "name": "R",
        "sac": 20,
        "sic": 129,
        "lat_deg": LAT,
        "lon_deg": LON,
        "height_m": HEIGHT,
        "scan_s": 4.0,
        "kind": "ssr",
    }
    return Sensor(**(values | change))


def scene(
    seed: int = 1,
    aircraft: int = 30,
    seconds: float = 300.0,
    range_bias_m: float = 150.0,
    azimuth_bias_deg: float = 1.0,
    late_s: float = 0.0,
    unknown: float = 0.2,
    identity: bool = False,
    numbers: bool = True,
    scan_s: float = 4.0,
    range_sd_m: float = 40.0,
    azimuth_sd_deg: float = 0.06,
    radius_m: float = 100e3,
    clutter: int = 0,
    begin_s: float = 1.6e9,
) -> Scene:
    """`aircraft` in level turns or straight flight, a share `unknown` of them without ADS-B; stamps are `late_s` late."""
    rng = np.random.default_rng(seed)
    distance, bearing = radius_m * np.sqrt(rng.uniform(0.02, 1, aircraft)), rng.uniform(0, 2 * np.pi, aircraft)
    east, north, up = distance * np.sin(bearing), distance * np.cos(bearing), rng.uniform(2e3, 11e3, aircraft)
    course, speed = rng.uniform(0, 2 * np.pi, aircraft), rng.uniform(100, 250, aircraft)
    turn = np.where(rng.random(aircraft) < 0.4, rng.uniform(-0.01, 0.01, aircraft), 1e-9)
    known = rng.random(aircraft) >= unknown
    site = ecef_from_geodetic(np.radians(LAT), np.radians(LON), HEIGHT)
    rotation = enu_from_ecef(np.radians(LAT), np.radians(LON))

    def where(who: np.ndarray, t: np.ndarray) -> np.ndarray:
        e = east[who] + speed[who] / turn[who] * (np.cos(course[who]) - np.cos(course[who] + turn[who] * t))
        n = north[who] + speed[who] / turn[who] * (np.sin(course[who] + turn[who] * t) - np.sin(course[who]))
        # A sphere's drop is near enough: what matters is that both sides see the same truth.
        return np.stack([e, n, up[who] - (e**2 + n**2) / 2 / 6.371e6], axis=1)

    fix_of = np.repeat(np.flatnonzero(known), int(seconds))
    fix_time = np.tile(np.arange(int(seconds)), known.sum()) + np.repeat(rng.uniform(0, 1, known.sum()), int(seconds))
    position = where(fix_of, fix_time) + rng.normal(0, 5, (len(fix_of), 3))
    lat, lon, height = geodetic_from_ecef(site + position @ rotation)
    order = np.argsort(fix_time, kind="stable")
    address = 0x340000 + rng.permutation(aircraft)
    fixes = Fixes(
        time_s=begin_s + fix_time, source=np.full(len(fix_of), 99), latitude_rad=lat, longitude_rad=lon, height_m=height,
        mode_s=address[fix_of], horizontal_sd_m=np.full(len(fix_of), 5.0), vertical_sd_m=np.full(len(fix_of), 10.0),
    ).take(order)  # fmt: skip

    scans = int(seconds / scan_s)
    who = np.repeat(np.arange(aircraft), scans)
    time = np.tile(np.arange(scans) * scan_s, aircraft)
    first = where(who, time)
    time = time + scan_s * (np.arctan2(first[:, 0], first[:, 1]) % (2 * np.pi)) / (2 * np.pi)
    seen = rng.random(len(who)) < 0.95
    who, time = who[seen], time[seen]
    enu = where(who, time)
    distance = np.linalg.norm(enu, axis=1) + range_bias_m + rng.normal(0, range_sd_m, len(who))
    azimuth = np.arctan2(enu[:, 0], enu[:, 1]) + np.radians(azimuth_bias_deg + rng.normal(0, azimuth_sd_deg, len(who)))
    if clutter:
        who = np.r_[who, np.full(clutter, -1)]
        time = np.r_[time, rng.uniform(0, seconds, clutter)]
        distance = np.r_[distance, radius_m * np.sqrt(rng.random(clutter))]
        azimuth = np.r_[azimuth, rng.uniform(0, 2 * np.pi, clutter)]
    order = np.argsort(time, kind="stable")
    number = rng.permutation(aircraft) + 100
    plots = Plots(
        time_s=begin_s + time + late_s, sensor=np.full(len(who), 20 << 8 | 129), range_m=distance,
        azimuth_rad=azimuth % (2 * np.pi),
        mode_s=np.where(who >= 0, address[who], -1) if identity else None,
        track=np.where(who >= 0, number[who], -1) if numbers else None,
        record=np.arange(len(who)),
    ).take(order)  # fmt: skip
    return Scene(plots, fixes, Sensors((radar(scan_s=scan_s),)), who[order], fix_of[np.argsort(fix_time, kind="stable")])


def wrong(pairs_plot: np.ndarray, pairs_target: np.ndarray, target_of_fix: np.ndarray, s: Scene) -> np.ndarray:
    """Which declared pairs (n,) are not the aircraft that the plot is of."""
    owner = np.full(int(target_of_fix.max()) + 1, -2)
    owner[target_of_fix] = s.fix_of
    return owner[pairs_target] != s.plot_of[pairs_plot]
