"""Scenarios: traffic, shipping, radars, ADS-B and AIS as one value, read from TOML, and the run that makes tables of it."""

from __future__ import annotations

import datetime
import tomllib
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from .._types import IntArray
from ..errors import SettingsError
from ..model import Fixes, Plots, Sensors, check_sensors, pack_callsigns
from ..terms import term_of
from ..writing.asterix import Marks
from .radar import Adsb, Ais, AisLog, Observation, Radar, observe_adsb, observe_ais, observe_radar
from .truth import Aircraft, Airport, Atmosphere, Shipping, Traffic, Truth, fly_traffic, sail_shipping

_KINDS = ("psr", "ssr", "mode_s", "combined", "marine")
_AIRLINES = ("IBE", "VLG", "RYR", "AFR", "DLH", "BAW", "EZY", "KLM", "SWR", "TAP")


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene: who flies and sails where, who watches.  `start` is UTC; in TOML the radars are ``[[radar]]`` tables."""

    name: str = "scene"
    start: datetime.datetime = datetime.datetime(2026, 3, 1, 10, 0, tzinfo=datetime.UTC)
    duration_s: float = 2400.0
    traffic: Traffic = Traffic()
    airport: tuple[Airport, ...] = ()
    atmosphere: Atmosphere = Atmosphere()
    radar: tuple[Radar, ...] = ()
    adsb: Adsb | None = None
    shipping: Shipping | None = None
    ais: Ais | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a scene gave, and what is true of it.

    `observations` are in the order of the scenario's radars, each in the order of stamps.  `fix_target` (m,) tells whose each fix
    is.  A radar's file holds its plots in the same order, so row numbers agree before and after writing.  `ais` is what the ships
    sent, where the scene has AIS.
    """

    scenario: Scenario
    truth: Truth
    observations: tuple[Observation, ...]
    fixes: Fixes
    fix_target: IntArray
    ais: AisLog | None = None

    @property
    def sensors(self) -> Sensors:
        """The radars as sensors.toml would tell of them."""
        return Sensors(tuple(radar.sensor for radar in self.scenario.radar))

    @property
    def plots(self) -> Plots:
        """The plots of all radars, one radar behind the other."""
        return Plots.concat([o.plots for o in self.observations])

    @property
    def plot_target(self) -> IntArray:
        """Whose each row of `plots` is (n,); -1 for false plots."""
        return np.concatenate([o.target for o in self.observations]) if self.observations else np.empty(0, np.int64)

    @property
    def marks(self) -> Marks:
        """The north marks of all radars."""
        return Marks(*(np.concatenate(column) for column in zip(*(o.marks for o in self.observations), strict=True)))

    @property
    def errors(self) -> dict[str, dict[str, float]]:
        """The true errors: radar, term, value in the term's unit."""
        return {radar.name: dict(radar.errors) for radar in self.scenario.radar}


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from TOML.

    Raises SettingsError with the file, the place and the remedy for a missing file, TOML that is not TOML, an unknown key or an
    impossible value.
    """
    try:
        data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"cannot be read ({error.strerror})", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"is not TOML: {error}", where=str(path)) from error
    try:
        scenario = msgspec.convert(data, Scenario)
    except msgspec.ValidationError as error:
        raise SettingsError(str(error), where=str(path), remedy=f"Known keys: {_known_keys(str(error))}.") from error
    check_scenario(scenario, where=str(path))
    return scenario


def _known_keys(message: str) -> str:
    """The keys of the table that an error message of msgspec points at."""
    tables = {
        "radar": Radar, "adsb": Adsb, "traffic": Traffic, "airport": Airport, "atmosphere": Atmosphere, "shipping": Shipping,
        "ais": Ais,
    }  # fmt: skip
    found = next((table for name, table in tables.items() if f"$.{name}" in message), Scenario)
    return ", ".join(found.__struct_fields__)


def check_scenario(scenario: Scenario, where: str = "scenario") -> None:
    """Raise SettingsError for what cannot be simulated, naming the place and what would do."""
    if scenario.start.tzinfo is None:
        raise SettingsError("start has no time zone", where=where, remedy="Write it as 2026-03-01T10:00:00Z.")
    if not 10.0 <= scenario.duration_s <= 86400.0:
        raise SettingsError(f"duration_s = {scenario.duration_s} is not within 10 … 86,400", where=where)
    traffic = scenario.traffic
    if not 1 <= traffic.aircraft <= 4000:
        raise SettingsError(f"aircraft = {traffic.aircraft} is not within 1 … 4,000", where=f"{where}: traffic")
    shares = (traffic.arrivals, traffic.departures, traffic.local, traffic.holding)
    if min(shares) < 0 or sum(shares[:3]) > 1 or traffic.holding > 1:
        raise SettingsError("shares must be positive, and arrivals + departures + local at most 1", where=f"{where}: traffic")
    if not 20e3 <= traffic.radius_m <= 600e3 or not abs(traffic.lat_deg) <= 75:
        raise SettingsError("needs radius_m within 20,000 … 600,000 and lat_deg within -75 … 75", where=f"{where}: traffic")
    if (traffic.arrivals or traffic.departures) and not scenario.airport:
        raise SettingsError("arrivals and departures need an [[airport]]", where=f"{where}: traffic")
    check_sensors(Sensors(tuple(radar.sensor for radar in scenario.radar)), where=where)
    for number, radar in enumerate(scenario.radar):
        place = f"{where}: radar {number + 1} ({radar.name!r})"
        if radar.kind not in _KINDS:
            raise SettingsError(f"kind = {radar.kind!r} is not simulated", where=place, remedy=f"Known: {', '.join(_KINDS)}.")
        for term in radar.errors:
            try:
                needs = term_of(term).needs
            except SettingsError as error:
                raise SettingsError(f"there is no error term {term!r}", where=place, remedy=error.remedy) from error
            if "elevation" in needs and radar.elevation_sd_deg is None:
                raise SettingsError(f"{term} needs a radar that measures elevation", where=place, remedy="Give elevation_sd_deg.")
        if radar.kind == "marine" and scenario.shipping is None:
            raise SettingsError("a marine radar sees ships, and there are none", where=place, remedy="Give [shipping].")
        if not 0 < radar.detection <= 1 or min(radar.time_sd_s, radar.false_plots) < 0:
            raise SettingsError("detection must be within 0 … 1, time_sd_s and false_plots not negative", where=place)
        if not (0 <= radar.primary_only <= 1 and 0 <= radar.second_chain <= 1):
            raise SettingsError("primary_only and second_chain must be within 0 … 1", where=place)
        if radar.primary_only > 0 and radar.kind != "combined":
            raise SettingsError("primary_only is of combined radars", where=place, remedy='Give kind = "combined".')
    shipping = scenario.shipping
    if shipping is not None:
        place = f"{where}: shipping"
        parts = (shipping.passing, shipping.calling, shipping.fishing, shipping.anchored)
        if not 1 <= shipping.ships <= 2000:
            raise SettingsError(f"ships = {shipping.ships} is not within 1 … 2,000", where=place)
        if min(parts) < 0 or sum(parts) > 1 + 1e-9:
            raise SettingsError("shares must be positive, and together at most 1", where=place)
        if not 5e3 <= shipping.radius_m <= 100e3 or not abs(shipping.lat_deg) <= 75:
            raise SettingsError("needs radius_m within 5,000 … 100,000 and lat_deg within -75 … 75", where=place)
    ais = scenario.ais
    if ais is not None:
        place = f"{where}: ais"
        if shipping is None:
            raise SettingsError("AIS is of ships, and there are none", where=place, remedy="Give [shipping].")
        if not (0 <= ais.loss < 1 and 0 <= ais.correlated <= 1 and ais.static_s > 0 and ais.correlation_s > 0):
            raise SettingsError("loss and correlated are within 0 … 1, static_s and correlation_s positive", where=place)
    adsb = scenario.adsb
    if adsb is not None:
        place = f"{where}: adsb"
        if any(not (name.isdigit() and 1 <= int(name) <= 11) for name in adsb.classes) or not sum(adsb.classes.values()) > 0:
            raise SettingsError(
                "classes must map NACp 1 … 11 to shares", where=place, remedy='For example {"9" = 0.5, "10" = 0.5}.'
            )
        if not (
            0 <= adsb.share <= 1
            and 0 <= adsb.correlated <= 1
            and 0 <= adsb.loss < 1
            and 0 < adsb.interval_s[0] <= adsb.interval_s[1]
        ):
            raise SettingsError("share, correlated and loss are within 0 … 1, interval_s positive and rising", where=place)


def _equip(scenario: Scenario, rng: np.random.Generator) -> Aircraft:
    """Addresses, codes, callsigns and equipment.  Exact shares of ADS-B and of its classes, in random order."""
    n = scenario.traffic.aircraft
    adsb = scenario.adsb
    names = [
        f"{_AIRLINES[int(a)]}{int(b)}"
        for a, b in zip(rng.integers(0, len(_AIRLINES), n), rng.choice(9000, n, replace=False) + 1, strict=True)
    ]
    accuracy = np.full(n, -1, np.int64)
    latency, interval = np.zeros(n), np.full(n, 1.0)
    if adsb is not None:
        equipped = rng.permutation(n)[: round(adsb.share * n)]
        shares = np.array(list(adsb.classes.values()), np.float64)
        bounds = np.rint(np.cumsum(shares) / shares.sum() * len(equipped)).astype(np.int64)
        accuracy[equipped] = np.array([int(c) for c in adsb.classes])[
            np.searchsorted(bounds, np.arange(len(equipped)), side="right")
        ]
        latency = adsb.latency_mean_s + adsb.latency_sd_s * rng.normal(0.0, 1.0, n)
        interval = rng.uniform(*adsb.interval_s, n)
    return Aircraft(
        mode_s=rng.choice(0xEFFFFF, n, replace=False) + 1,
        mode_3a=rng.choice(0o6777, n, replace=False) + 1,
        callsign=pack_callsigns(names),
        length_m=rng.choice([28.0, 33.8, 37.6, 39.5, 44.5, 63.7, 73.9], n, p=[0.1, 0.15, 0.35, 0.2, 0.1, 0.07, 0.03]),
        transponder_delay_m=scenario.traffic.delay_sd_m * rng.normal(0.0, 1.0, n),
        altimetry_m=scenario.traffic.altimetry_sd_m * rng.normal(0.0, 1.0, n),
        altitude_quantum_m=np.where(rng.random(n) < 0.8, 25.0, 100.0) * 0.3048,
        accuracy=accuracy,
        latency_s=latency,
        interval_s=interval,
    )


def simulate(scenario: Scenario, seed: int | np.random.Generator) -> Simulated:
    """Fly the scenario's traffic, sail its ships, and let its radars, ADS-B and AIS watch.

    The same scenario and seed give the same tables; another radar in the list changes neither the traffic nor the other radars'
    noise.  Raises SettingsError for what cannot be simulated.
    """
    check_scenario(scenario)
    flights, equipment, reports, *watches = np.random.default_rng(seed).spawn(3 + len(scenario.radar))
    aircraft = _equip(scenario, equipment)
    truth = fly_traffic(
        scenario.traffic,
        scenario.airport,
        scenario.atmosphere,
        scenario.start.timestamp(),
        scenario.duration_s,
        aircraft,
        flights,
    )
    # Of the equipment's seed, so that neither ships nor radars change what the others draw.
    voyages, messages = equipment.spawn(2)
    ais = scenario.ais
    if scenario.shipping is not None:
        latency = (0.0, 0.0) if ais is None else (ais.latency_mean_s, ais.latency_sd_s)
        truth = sail_shipping(scenario.shipping, truth, scenario.duration_s, latency, voyages)
    observations = tuple(observe_radar(truth, radar, rng) for radar, rng in zip(scenario.radar, watches, strict=True))
    fixes, fix_target = (Fixes(), np.empty(0, np.int64)) if scenario.adsb is None else observe_adsb(truth, scenario.adsb, reports)
    log = None if ais is None else observe_ais(truth, ais, messages)
    return Simulated(scenario, truth, observations, fixes, fix_target, log)
