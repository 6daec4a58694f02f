"""``boresight warm``: compile the kernels once, before the first recording."""

from __future__ import annotations

import time


def warm() -> None:
    """Compile the kernels and cache them, so that the next command starts at once."""
    import tempfile
    from pathlib import Path

    from .. import flow
    from .._jit import cache_folder
    from ._options import steps

    start = time.perf_counter()
    with steps(quiet=False) as step, tempfile.TemporaryDirectory() as folder:
        flow.demo(Path(folder), seed=0, progress=step)
        flown = time.perf_counter()
        step("compile the filters")
        filters()
    where = cache_folder()
    kept = f"kept in {where}" if where else "but no folder to keep them in is writable: set XDG_CACHE_HOME"
    end = time.perf_counter()
    print(f"Kernels compiled and tried in {end - start:.1f} s (filters: {end - flown:.1f} s); {kept}")


def filters() -> None:
    """Run each filter on a plot or two, on the axes and states that users have: what is not compiled yet is then."""
    import numpy as np

    from ..filters import (
        ConstantAcceleration,
        ConstantVelocity,
        CoordinatedTurn,
        ExpectedMode,
        Imm,
        imm_filter,
        kalman_filter,
        one_point,
        radar_filter,
        radar_plots,
        radar_start,
    )
    from ..frames import Ecef, Enu, Polar, convert

    time_s = np.arange(3.0)
    turns = Imm(models=(ConstantVelocity(), CoordinatedTurn(rate_deg_s=3.0)))
    for axes in (2, 3):
        z = np.zeros((1, 3, axes))
        r = np.broadcast_to(np.eye(axes), (1, 3, axes, axes))
        for motion, d in ((ConstantVelocity(), 2 * axes), (ConstantAcceleration(), 3 * axes)):
            kalman_filter(z, r, time_s, motion, one_point(z[:, 0], r[:, 0], d, 100.0))
        for method in (turns, ExpectedMode()):
            imm_filter(z, r, time_s, method, one_point(z[:, 0], r[:, 0], 2 * axes, 100.0))
    site, rotation = np.array([6378137.0, 0.0, 0.0]), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    anchor, radar = Enu(site, rotation), Polar(site, rotation)
    for k in (2, 3):
        convert(np.full((1, k), 1.0), np.eye(k)[None], radar, Ecef())
    one = np.full((1, 3), 1e4)
    plots = radar_plots(time_s, 0, range_m=one, azimuth_rad=one * 0, range_sd_m=50.0, azimuth_sd_rad=1e-3, height_m=one / 2)
    radar_filter(plots, [radar], anchor, ConstantVelocity(), radar_start(plots, [radar], anchor, 6))
