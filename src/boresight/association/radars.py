"""One radar as the reference of others: which plots of several radars are of the same target (METHODS section 5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import alignment
from .._types import IntArray
from ..errors import NothingToDo, SettingsError
from ..geodesy import geodetic_from_ecef
from ..measure import plot_positions
from ..model import EXCLUDED, Fixes, Pairs, Plots, Sensor, Sensors
from ..targets import targets_of
from . import search
from .settings import AssociationSettings, assumed

# Addresses that number the targets of one radar's plots.
_FIRST = 1


class Shared(NamedTuple):
    """The target (n,) of each plot (-1: of none that the main radar sees), by what it was told, and what is to be said of it."""

    target: IntArray
    by: str
    said: tuple[str, ...]


def shared_targets(plots: Plots, sensors: Sensors, main: Sensor, settings: AssociationSettings | None = None) -> Shared:
    """Say which plots of several radars are of the same target.

    By the Mode S address or the MMSI where the main radar and another one have some in common.  Else, and where `settings` ask
    for it (`use_identity` off, or `matching`), the main radar's own tracks are the reference for `search`.

    Raises NothingToDo where the main radar has no plot, or no other one a target in common with it; SettingsError for a radar
    without a fixed place.
    """
    settings = settings or AssociationSettings()
    others = [s for s in sensors if s.key != main.key and (plots.sensor == s.key).any()]
    if not (plots.sensor == main.key).any():
        raise NothingToDo(
            f"there is no plot of the main radar {main.name!r}", remedy="Name a main radar that the recordings hold."
        )
    if not others:
        raise NothingToDo(
            f"there are plots of one radar only, {main.name!r}: nothing to compare it with",
            remedy="Give a reference (--reference), or recordings of at least two radars that see the same targets.",
        )
    for sensor in (main, *others):
        if sensor.lat_deg is None or sensor.lon_deg is None:
            raise SettingsError(
                f"{sensor.name!r} has no fixed place, and radars are compared with each other by their places",
                where="sensors.toml",
                remedy="Give its lat_deg and lon_deg, or calibrate against a reference.",
            )
    sound = plots.flags & np.uint32(int(EXCLUDED)) == 0
    address = np.where((plots.mode_s > 0) & (plots.mode_s < 0xFFFFFF), plots.mode_s.astype(np.int64), -1)
    identity = np.where(address >= 0, address, np.where(plots.mmsi > 0, plots.mmsi.astype(np.int64), -1))
    identity = np.where(sound, identity, -1)
    theirs = np.unique(identity[(plots.sensor == main.key) & (identity >= 0)])
    common = (plots.sensor != main.key) & np.isin(identity, theirs) & (identity >= 0)
    if settings.use_identity and settings.matching is None and common.any():
        return Shared(identity, "identity", ())
    mine = np.flatnonzero((plots.sensor == main.key) & sound)
    fixes = fixes_of(plots.take(mine), sensors, main)
    if not np.isfinite(fixes.latitude_rad).any():
        raise NothingToDo(
            f"no plot of the main radar {main.name!r} tells a height, so that none can be placed",
            remedy="Elevations or pressure altitudes are needed, or a reference (--reference).",
        )
    own = targets_of(fixes)
    if not (own >= 0).any():
        raise NothingToDo(
            f"the radars have no identity in common, and the plots of {main.name!r} carry no track numbers",
            remedy="Give recordings with Mode S addresses or tracks, or a reference (--reference).",
        )
    rest = np.flatnonzero(plots.sensor != main.key)
    found = search(plots.take(rest), fixes, Sensors(tuple(others), sensors.atmosphere), settings)
    target = np.full(len(plots), -1, np.int64)
    target[mine] = own
    target[rest[found.pairs.plot]] = found.pairs.target
    return Shared(target, "tracks", found.warnings)


def fixes_of(plots: Plots, sensors: Sensors, main: Sensor) -> Fixes:
    """The plots (n,) of one radar as positions of a reference, with their sd; NaN where nothing tells a height."""
    latitude, longitude, height = geodetic_from_ecef(plot_positions(plots, sensors))
    a = assumed(main, AssociationSettings())
    own_range = np.where(np.isfinite(plots.range_sd_m), plots.range_sd_m, a.range_sd_m)
    own_azimuth = np.where(np.isfinite(plots.azimuth_sd_rad), plots.azimuth_sd_rad, a.azimuth_sd_rad)
    return Fixes(
        time_s=plots.time_s,
        source=plots.sensor,
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
        pressure_altitude_m=plots.pressure_altitude_m,
        mode_s=plots.mode_s,
        mode_3a=plots.mode_3a,
        callsign=plots.callsign,
        mmsi=plots.mmsi,
        track=plots.track,
        length_m=plots.length_m,
        horizontal_sd_m=np.sqrt((own_range**2 + (plots.range_m * own_azimuth) ** 2) / 2),
        vertical_sd_m=np.full(len(plots), 50.0),
        flags=plots.flags,
        record=plots.record,
    )


def pairs_against(plots: Plots, sensors: Sensors, main: Sensor, target: IntArray) -> Pairs:
    """The plots of the other radars with the main radar's smoothed tracks at their stamps, for residuals.

    `target` (n,) is that of `shared_targets`.
    """
    mine = np.flatnonzero((plots.sensor == main.key) & (target >= 0))
    names, number = np.unique(target[mine], return_inverse=True)
    # One target a number, whatever the radar itself called it on the way.
    alike = fixes_of(plots.take(mine), sensors, main).replace(
        mode_s=(number + _FIRST).astype(np.int32), mmsi=np.full(len(mine), -1, np.int32), track=np.full(len(mine), -1, np.int32),
        callsign=np.full(len(mine), -1, np.int64),
    )  # fmt: skip
    trajectories = alignment.trajectories(alike, max_gap_s=4 * assumed(main, AssociationSettings()).scan_s)
    as_numbered = np.full(len(names), -1, np.int64)
    as_numbered[number] = trajectories.target
    rows = np.flatnonzero((plots.sensor != main.key) & np.isin(target, names) & np.isfinite(plots.time_s))
    which = np.searchsorted(names, target[rows])
    state = alignment.states(trajectories, as_numbered[which], plots.time_s[rows])
    valid = np.flatnonzero(state.valid)
    rows = rows[valid]
    return Pairs(
        plot=rows,
        plots=plots.take(rows),
        target=target[rows],
        track=target[rows],
        position=state.position[valid],
        velocity=state.velocity[valid],
        acceleration=state.acceleration[valid],
        covariance=state.covariance[valid],
        heading_rad=state.heading_rad[valid],
        length_m=plots.length_m[rows],
        source=np.full(len(rows), main.key, np.int32),
    )
