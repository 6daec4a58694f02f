"""Random tables with holes, for the tests of the writer."""

from __future__ import annotations

from typing import Any

import numpy as np

from boresight.model import Fixes, Flag, Plots, pack_callsigns

MIDNIGHT_S = 1_772_323_200.0  # 2026-03-01
NAMES = ["IBE3166", "VLG8301", "RYR1", "AFR 7"]


def some(rng: np.random.Generator, values: Any, share: float = 0.7) -> Any:
    """Values with holes: NaN or -1."""
    values = np.asarray(values)
    return np.where(rng.random(len(values)) < share, values, np.nan if values.dtype.kind == "f" else -1)


def some_plots(seed: int, n: int = 200, furthest_m: float = 470e3) -> Plots:
    rng = np.random.default_rng(seed)
    chosen = [
        Flag.SIMULATED,
        Flag.TEST,
        Flag.GARBLED,
        Flag.REFLECTION,
        Flag.SIDE_LOBE,
        Flag.SECOND_TIME,
        Flag.FIELD_MONITOR,
        Flag.TRACK_END,
    ]
    flags = sum(np.where(rng.random(n) < 0.15, int(flag), 0) for flag in chosen)
    return Plots(
        time_s=MIDNIGHT_S + 86_300.0 + np.sort(rng.uniform(0, 200.0, n)),
        sensor=rng.choice([0x14 << 8 | 129, 7], n),
        channel=rng.integers(1, 6, n),
        range_m=rng.uniform(0, furthest_m, n),
        azimuth_rad=rng.uniform(-1.0, 2 * np.pi, n),
        height_m=some(rng, rng.uniform(-100, 20e3, n)),
        pressure_altitude_m=some(rng, rng.uniform(-300, 15e3, n)),
        mode_s=some(rng, rng.integers(1, 1 << 24, n)),
        mode_3a=some(rng, rng.integers(0, 4096, n)),
        callsign=some(rng, pack_callsigns(NAMES)[rng.integers(0, len(NAMES), n)]),
        track=some(rng, rng.integers(0, 4096, n)),
        psr_ssr_range_m=some(rng, rng.uniform(-900, 900, n)),
        psr_ssr_azimuth_rad=some(rng, np.radians(rng.uniform(-2.7, 2.7, n))),
        speed_mps=some(rng, rng.uniform(0, 300, n)),
        heading_rad=some(rng, rng.uniform(0, 2 * np.pi, n)),
        length_m=some(rng, rng.uniform(3, 75, n)),
        width_m=some(rng, rng.uniform(3, 75, n)),
        flags=flags,
    )


def some_fixes(seed: int, n: int = 200) -> Fixes:
    rng = np.random.default_rng(seed)
    chosen = [Flag.SIMULATED, Flag.TEST, Flag.GROUND, Flag.FIELD_MONITOR, Flag.TIME_OF_RECEPTION, Flag.VEHICLE]
    return Fixes(
        time_s=MIDNIGHT_S + np.sort(rng.uniform(0, 86400.0, n)),
        source=np.full(n, 0x14 << 8 | 219),
        latitude_rad=rng.uniform(-np.pi / 2, np.pi / 2, n),
        longitude_rad=np.where(np.arange(n) % 50 == 0, np.pi, rng.uniform(-np.pi, np.pi, n)),
        height_m=some(rng, rng.uniform(-100, 15e3, n)),
        pressure_altitude_m=some(rng, rng.uniform(-300, 15e3, n)),
        velocity_east_mps=some(rng, rng.normal(0, 150, n)),
        velocity_north_mps=some(rng, rng.normal(0, 150, n)),
        velocity_up_mps=some(rng, rng.normal(0, 10, n)),
        mode_s=some(rng, rng.integers(1, 1 << 24, n)),
        mode_3a=some(rng, rng.integers(0, 4096, n)),
        callsign=some(rng, pack_callsigns(NAMES)[rng.integers(0, len(NAMES), n)]),
        track=some(rng, rng.integers(0, 4096, n)),
        horizontal_sd_m=some(rng, np.exp(rng.uniform(-1, 9, n))),
        vertical_sd_m=some(rng, rng.uniform(3, 120, n)),
        flags=sum(np.where(rng.random(n) < 0.2, int(flag), 0) for flag in chosen),
    )
