"""GPS time to UTC: weeks, seconds of the week and leap seconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._types import FloatArray

WEEK_S = 604800.0
# 1980-01-06, the start of GPS time, in seconds since 1970.
GPS_EPOCH_S = 315964800.0
# GPS minus UTC grew by one second at each of these UTC instants (IERS Bulletin C).  None is announced after 2017.
LEAP_UTC_S = np.array(
    [
        362793600.0,  # 1981-07-01
        394329600.0,  # 1982-07-01
        425865600.0,  # 1983-07-01
        489024000.0,  # 1985-07-01
        567993600.0,  # 1988-01-01
        631152000.0,  # 1990-01-01
        662688000.0,  # 1991-01-01
        709948800.0,  # 1992-07-01
        741484800.0,  # 1993-07-01
        773020800.0,  # 1994-07-01
        820454400.0,  # 1996-01-01
        867715200.0,  # 1997-07-01
        915148800.0,  # 1999-01-01
        1136073600.0,  # 2006-01-01
        1230768000.0,  # 2009-01-01
        1341100800.0,  # 2012-07-01
        1435708800.0,  # 2015-07-01
        1483228800.0,  # 2017-01-01
    ]
)
# The same instants on the GPS scale, counted as if it had no leap seconds.
_LEAP_GPS_S = LEAP_UTC_S + np.arange(1, len(LEAP_UTC_S) + 1)


def utc_from_gps(gps_s: ArrayLike) -> FloatArray:
    """UTC seconds since 1970 (n,) of GPS time (n,), given as seconds since 1970 on GPS's own calendar, without leap seconds.

    During a leap second itself UTC repeats a second, as POSIX time does.
    """
    gps = np.asarray(gps_s, np.float64)
    return gps - np.searchsorted(_LEAP_GPS_S, gps, side="right")


def gps_from_week(week: ArrayLike, tow_s: ArrayLike) -> FloatArray:
    """Seconds since 1970 on GPS's own calendar (n,) of weeks and seconds of the week (n,)."""
    return np.asarray(GPS_EPOCH_S + np.asarray(week, np.float64) * WEEK_S + np.asarray(tow_s, np.float64))
