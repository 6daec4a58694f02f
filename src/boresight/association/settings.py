"""What association assumes where nobody says otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import numpy as np

from ..errors import SettingsError
from ..model import Sensor
from .cluster import Traces, TrackMatch
from .hough import Window


class AssociationSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How association looks for pairs.  None takes the default of the sensor's kind.

    The windows are half widths about zero within which biases are searched: 2 km, 3.5° and 2.5 s in the air; 100 m, 1° and
    2.5 s for a surface radar.  The last gate is `gate_sd` standard deviations of noise and of what three constants leave
    over, or `gate_m` metres (60 m for a surface radar).  Targets slower than `min_speed_mps` are left out (surface radars: 2
    m/s).  `points` plots of a track are compared, `search_tracks` tracks take part in the search.  Without identity at least
    `min_tracks` tracks must agree. A track without a strong identity needs `min_plots`; it ends after `track_gap_s` without a
    plot.  `clock_search_s` is how far to look for the clock offset to name in a refusal.  `interpolation` and
    `reference_gap_s` go to `alignment.trajectories`.  With `matching`, whole tracks are paired by K-medoids (paper 001) in place
    of identity and search.

    Raises SettingsError for values that make no sense.
    """

    range_window_m: float | None = None
    azimuth_window_deg: float | None = None
    time_window_s: float = 2.5
    gate_sd: float = 6.0
    gate_m: float | None = None
    min_speed_mps: float | None = None
    points: int = 16
    search_tracks: int = 100
    min_tracks: int = 2
    min_plots: int = 3
    track_gap_s: float | None = None
    use_identity: bool = True
    clock_search_s: float = 5400.0
    interpolation: Literal["nearest", "linear", "cubic", "smooth"] = "smooth"
    reference_gap_s: float | None = None
    matching: TrackMatch | None = None

    def __post_init__(self) -> None:
        for name in ("range_window_m", "azimuth_window_deg", "gate_m", "track_gap_s", "reference_gap_s"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise SettingsError(f"{name} = {value} must be positive", where="association")
        for name, least in (
            ("time_window_s", 0), ("clock_search_s", 0), ("gate_sd", 1), ("points", 2), ("search_tracks", 1), ("min_tracks", 1),
            ("min_plots", 1),
        ):  # fmt: skip
            if not getattr(self, name) >= least:
                raise SettingsError(f"{name} = {getattr(self, name)} must be at least {least}", where="association")


ASSOCIATIONS = ("hough", "k-medoids")
"""The ways of association, by the name that an option gives; the first is the default."""


_ONE = Traces(np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.zeros(1, np.int64))


def association_of(name: str, options: Mapping[str, str]) -> AssociationSettings:
    """The settings that a name of `ASSOCIATIONS` and options as text give.

    K-medoids have the options of `TrackMatch` besides those of `AssociationSettings`.  Raises SettingsError for a name, an option
    or a value that does not exist, with those that do.
    """
    if name not in ASSOCIATIONS:
        raise SettingsError(f"there is no association {name!r}", where="associate", remedy=f"Known: {', '.join(ASSOCIATIONS)}.")
    own = set(TrackMatch.__struct_fields__) if name == "k-medoids" else set()
    common = [f for f in AssociationSettings.__struct_fields__ if f != "matching"]
    known = [*TrackMatch.__struct_fields__, *common] if own else common
    for option in options:
        if option not in known:
            raise SettingsError(
                f"{name} has no option {option!r}", where="associate-option", remedy=f"It has: {', '.join(known)}."
            )
    try:
        settings = msgspec.convert({k: v for k, v in options.items() if k not in own}, AssociationSettings, strict=False)
        if not own:
            return settings
        match = msgspec.convert({k: v for k, v in options.items() if k in own}, TrackMatch, strict=False)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, SettingsError):
            raise error.__cause__ from None
        raise SettingsError(str(error).replace("$.", ""), where="associate-option", remedy="Example: gate_sd=8.") from None
    # A method looks at its settings when it is called.
    match(_ONE, _ONE)
    return msgspec.structs.replace(settings, matching=match)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumed:
    """What is assumed of one sensor's measurements.

    `extent_m` is how far an echo may lie from the reference's antenna; `unmodelled_per_m` and `unmodelled_rad` are what gain,
    eccentricity and the like add to three constant biases; `speed_mps` is faster than any target.
    """

    range_sd_m: float = 60.0
    azimuth_sd_rad: float = float(np.radians(0.1))
    range_window_m: float = 2000.0
    azimuth_window_rad: float = float(np.radians(3.5))
    scan_s: float = 4.0
    speed_mps: float = 450.0
    extent_m: float = 0.0
    unmodelled_per_m: float = 5e-4
    unmodelled_rad: float = float(np.radians(0.06))
    gate_m: float | None = None
    min_speed_mps: float = 0.0


_BY_KIND = {
    "surface": Assumed(
        range_sd_m=5.0, range_window_m=100.0, azimuth_window_rad=float(np.radians(1.0)), scan_s=1.0, speed_mps=120.0,
        extent_m=15.0, unmodelled_per_m=1e-3, unmodelled_rad=float(np.radians(0.03)), gate_m=60.0, min_speed_mps=2.0,
    ),
    "marine": Assumed(
        range_sd_m=15.0, azimuth_sd_rad=float(np.radians(0.5)), range_window_m=300.0, azimuth_window_rad=float(np.radians(5.0)),
        scan_s=2.5, speed_mps=40.0, extent_m=20.0, unmodelled_per_m=1e-3, unmodelled_rad=float(np.radians(0.2)),
    ),
    "psr": Assumed(range_sd_m=80.0, azimuth_sd_rad=float(np.radians(0.15))),
}  # fmt: skip


def assumed(sensor: Sensor, settings: AssociationSettings) -> Assumed:
    """The assumptions for a sensor: its kind's, with what sensors.toml and the settings say."""
    a = _BY_KIND.get(sensor.kind, Assumed())
    given = {
        "range_sd_m": sensor.range_sd_m,
        "azimuth_sd_rad": None if sensor.azimuth_sd_deg is None else float(np.radians(sensor.azimuth_sd_deg)),
        "scan_s": sensor.scan_s,
        "range_window_m": settings.range_window_m,
        "azimuth_window_rad": None if settings.azimuth_window_deg is None else float(np.radians(settings.azimuth_window_deg)),
        "gate_m": settings.gate_m,
        "min_speed_mps": settings.min_speed_mps,
    }
    return replace(a, **{name: value for name, value in given.items() if value is not None})


def window_of(a: Assumed, settings: AssociationSettings) -> Window:
    """The window of the search for coarse biases."""
    return Window(a.range_window_m, a.azimuth_window_rad, settings.time_window_s)
