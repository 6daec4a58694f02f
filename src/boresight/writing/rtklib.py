"""Positions of a GNSS receiver as RTKLIB writes them (``.pos``).

Quanta: position 1e-9 deg (0.1 mm), height, sd and velocity 0.1 mm or less, time 0.001 s of GPS time.
"""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np

from .._types import FloatArray, IntArray
from ..errors import InputError
from ..model import Fixes
from ..reading.gpstime import LEAP_UTC_S
from . import write_text

# The quality that RTKLIB would tell for an accuracy, per axis in metres: fixed, float; beyond them a single solution.
FIXED_SD_M, FLOAT_SD_M = 0.2, 1.0
_FIXED, _FLOAT, _SINGLE = 1, 2, 5
_HEADER = (
    "% program   : Boresight\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)\n"
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)  sdeu(m)"
    "  sdun(m) age(s)  ratio"
)
_VELOCITY = "    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu    sdvne    sdveu    sdvun"


def quality_of(horizontal_sd_m: FloatArray) -> IntArray:
    """RTKLIB's Q (n,) for an accuracy per axis: 1 fixed, 2 float, 5 single, which is also what an unknown accuracy gives."""
    sd = np.where(np.isfinite(horizontal_sd_m), horizontal_sd_m, np.inf)
    return np.where(sd <= FIXED_SD_M, _FIXED, np.where(sd <= FLOAT_SD_M, _FLOAT, _SINGLE))


def write_rtklib(path: str | Path, fixes: Fixes) -> int:
    """Write the fixes of one receiver as an RTKLIB solution, as a whole or not at all; return the number of positions.

    Rows go in the order of time.  Horizontal sd stand for both axes; an unknown sd is written as 0.  Velocities are written where
    all rows have one.  RTKLIB has no place for identities, pressure altitudes and headings.

    Raises InputError for rows without time, position or ellipsoidal height, for fixes of several track numbers, and where the
    file cannot be written.
    """
    placed = np.isfinite(fixes.time_s + fixes.latitude_rad + fixes.longitude_rad + fixes.height_m)
    if not len(fixes) or not placed.all():
        what = f"{np.count_nonzero(~placed)} positions lack" if len(fixes) else "there are no positions that have"
        raise InputError(f"{what} a time, latitude, longitude or height", path=path, remedy="Leave such rows out.")
    if len(np.unique(fixes.track)) > 1:
        raise InputError(
            "an RTKLIB solution is of one receiver, and here are several", path=path, remedy="Write a file for each."
        )
    fixes = fixes[np.argsort(fixes.time_s, kind="stable")]
    velocity = np.stack([fixes.velocity_north_mps, fixes.velocity_east_mps, fixes.velocity_up_mps], axis=1)
    moving = bool(np.isfinite(velocity).all())
    gps = fixes.time_s + np.searchsorted(LEAP_UTC_S, fixes.time_s, side="right")
    # Whole milliseconds: a rounded second is never 60.
    stamp = np.rint(gps * 1000.0).astype(np.int64)
    sd, up = np.nan_to_num(fixes.horizontal_sd_m), np.nan_to_num(fixes.vertical_sd_m)
    columns = (
        stamp, np.degrees(fixes.latitude_rad), np.degrees(fixes.longitude_rad), fixes.height_m, quality_of(fixes.horizontal_sd_m),
        sd, up,
    )  # fmt: skip
    lines = [_HEADER + (_VELOCITY if moving else "")]
    epoch = datetime.datetime(1970, 1, 1)
    for (ms, latitude, longitude, height, quality, h, v), speed in zip(
        zip(*(c.tolist() for c in columns), strict=True), velocity.tolist(), strict=True
    ):
        clock = epoch + datetime.timedelta(milliseconds=ms)
        line = (
            f"{clock:%Y/%m/%d %H:%M:%S}.{ms % 1000:03d} {latitude:14.9f} {longitude:14.9f} {height:10.4f} {quality:3d}   0 "
            f"{h:8.4f} {h:8.4f} {v:8.4f} {0:8.4f} {0:8.4f} {0:8.4f} {0:6.2f} {0:6.1f}"
        )
        if moving:
            line += "".join(f" {value:10.5f}" for value in speed) + f" {0:9.5f}" + f" {0:8.5f}" * 5
        lines.append(line)
    write_text(path, "\n".join(lines) + "\n")
    return len(fixes)
