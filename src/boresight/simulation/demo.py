"""Ready-made scenes: the demonstration, as files too, and a hard one for association."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .drift import Drift
from .files import SceneFiles, scene_files, write_scene
from .radar import Radar
from .reference import Adsb, Ais
from .scenario import Scenario, simulate
from .truth import Airport, Atmosphere, Shipping, Traffic

_AIRPORT = Airport(lat_deg=41.2971, lon_deg=2.0785, height_m=54.0, runway_deg=246.0)
_AIR = Atmosphere(isa_deviation_k=6.0, shift_m=85.0)
# Of the sea's surface above the ellipsoid, off Barcelona.
_SEA_M = 49.5
# Smallest and largest true value of each error, in the term's unit; the sign is drawn.
_ERRORS = {
    "range_bias": (40.0, 120.0),
    "range_gain": (0.3, 0.9),
    "azimuth_bias": (0.08, 0.4),
    "azimuth_cos": (0.03, 0.09),
    "azimuth_sin": (0.03, 0.09),
    "time_offset": (0.15, 0.6),
}
_MARINE_ERRORS = {"range_bias": (15.0, 45.0), "azimuth_bias": (0.3, 0.9), "time_offset": (0.5, 1.5)}


def _draw(rng: np.random.Generator, bounds: dict[str, tuple[float, float]]) -> dict[str, float | Drift]:
    """Errors of either sign within the bounds, rounded to what a person can read."""
    return {name: round(float(rng.choice([-1, 1]) * rng.uniform(*limits)), 4) for name, limits in bounds.items()}


def demo_scene(seed: int) -> Scenario:
    """Three radars whose errors are drawn with `seed`, 60 aircraft with ADS-B, 20 ships with AIS, 50 minutes.

    "en-route" is a Mode S radar on a hill (10 s, 240 km), "terminal" a combined PSR and Mode S radar at the airport (4 s,
    110 km), "coastal" a 2-D marine radar above the port (3 s, 45 km) that sees ships and no identity; their echoes lie aft of
    the middle of the hull, in proportion to their length.  None measures elevation: CAT048 has no item for it (I048/110 is a
    height already computed with some model of refraction and above some sea level), so terms of elevation are left to scenes
    that do not go through files.
    """
    rng = np.random.default_rng([seed, 1])
    errors = [_draw(rng, _ERRORS), _draw(rng, _ERRORS), _draw(rng, _MARINE_ERRORS)]
    # The superstructure of most ships is aft.
    errors[2]["along_heading_per_length"] = round(-float(rng.uniform(0.12, 0.35)), 4)
    return Scenario(
        name=f"demonstration, seed {seed}",
        duration_s=3000.0,
        traffic=Traffic(aircraft=60, lat_deg=41.4, lon_deg=2.0, radius_m=220e3),
        airport=(_AIRPORT,),
        atmosphere=_AIR,
        radar=(
            Radar(
                name="en-route", sac=20, sic=1, lat_deg=41.5312, lon_deg=1.8846, height_m=782.0, kind="mode_s", scan_s=10.0,
                max_range_m=240e3, range_sd_m=30.0, azimuth_sd_deg=0.05, errors=errors[0],
            ),
            Radar(
                name="terminal", sac=20, sic=2, lat_deg=41.3007, lon_deg=2.1021, height_m=77.0, kind="combined", scan_s=4.0,
                max_range_m=110e3, range_sd_m=25.0, azimuth_sd_deg=0.07, errors=errors[1],
            ),
            Radar(
                name="coastal", sac=20, sic=4, lat_deg=41.3631, lon_deg=2.1662, height_m=_SEA_M + 105.0, kind="marine",
                scan_s=3.0, min_range_m=300.0, max_range_m=45e3, min_elevation_deg=-20.0, detection=0.95, range_sd_m=8.0,
                azimuth_sd_deg=0.12, range_quantum_m=1.0, ground_height_m=_SEA_M, errors=errors[2],
            ),
        ),
        adsb=Adsb(share=0.9),
        shipping=Shipping(ships=20, lat_deg=41.335, lon_deg=2.18, seaward_deg=140.0, radius_m=30e3, sea_level_m=_SEA_M),
        ais=Ais(),
    )  # fmt: skip


def association_scene(seed: int, *, largest_azimuth_deg: float = 2.8) -> Scenario:
    """A hard scene for association: 90 aircraft within 100 km, 18 of them without ADS-B, a primary radar without any identity.

    The azimuth bias is drawn up to `largest_azimuth_deg` of either sign, the range bias up to 800 m, the time offset up to 0.5 s.
    Both sides carry track numbers.  METHODS section 4.
    """
    rng = np.random.default_rng([seed, 2])
    half = largest_azimuth_deg / 2
    return Scenario(
        name=f"association, seed {seed}",
        duration_s=1200.0,
        traffic=Traffic(aircraft=90, lat_deg=41.3, lon_deg=2.1, radius_m=100e3),
        airport=(_AIRPORT,),
        atmosphere=_AIR,
        radar=(
            Radar(
                name="primary", sac=20, sic=3, lat_deg=41.3007, lon_deg=2.1021, height_m=77.0, kind="psr", scan_s=4.0,
                max_range_m=105e3, detection=0.9, range_sd_m=50.0, azimuth_sd_deg=0.12,
                errors=_draw(rng, {"range_bias": (100.0, 800.0), "azimuth_bias": (half, 2 * half), "time_offset": (0.1, 0.5)}),
            ),
        ),
        adsb=Adsb(share=0.8),
    )  # fmt: skip


def demo_files(folder: str | Path) -> tuple[Path, ...]:
    """The files that `write_demo` writes into `folder`."""
    return tuple(Path(folder) / name for name in scene_files(demo_scene(0)))


def write_demo(folder: str | Path, seed: int = 1) -> SceneFiles:
    """Simulate the demonstration and write it to `folder` as `write_scene` does.

    One ASTERIX file a radar, ``adsb.ast``, ``ais.nmea``, ``sensors.toml`` and ``truth.json``.  The same seed gives the same
    bytes.  Raises InputError where it cannot be written.
    """
    return write_scene(simulate(demo_scene(seed), np.random.default_rng([seed, 3])), folder)
