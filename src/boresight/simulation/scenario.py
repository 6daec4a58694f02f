"""Scenarios: traffic, shipping, radars, ADS-B and AIS as one value, read from TOML, and the run that makes tables of it."""

from __future__ import annotations

import datetime
import math
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .._types import IntArray
from ..errors import SettingsError
from ..model import Fixes, Plots, Sensors, pack_callsigns
from ..terms import CHANNELS, TERMS, term_of
from ..writing.asterix import Marks
from .lint import Mistake, Place, decode, line_of, lines_of, nearest
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


class Remark(msgspec.Struct, frozen=True):
    """What is wrong with a scenario file, or makes little sense: the line of its table or key, what it is, and the remedy."""

    path: str
    line: int
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        return str(SettingsError(self.text, where=f"{self.path}:{self.line}", remedy=self.remedy))


class Lint(msgspec.Struct, frozen=True):
    """A scenario file looked over.  `scenario` is None where there are `mistakes`; `warnings` are of what makes little sense."""

    scenario: Scenario | None
    mistakes: tuple[Remark, ...]
    warnings: tuple[Remark, ...]


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from TOML.

    Raises SettingsError for a missing file, TOML that is not TOML, and with every mistake of `lint_scenario`, a line each.
    """
    lint = lint_scenario(path)
    if lint.scenario is None:
        found = lint.mistakes
        if len(found) == 1:
            raise SettingsError(found[0].text, where=f"{path}:{found[0].line}", remedy=found[0].remedy)
        raise SettingsError("\n".join([f"{path}: {len(found)} mistakes", *map(str, found)]))
    return lint.scenario


def lint_scenario(path: str | Path) -> Lint:
    """Look a scenario file over: every mistake of names, types and values and of what does not go together, with its line.

    Raises SettingsError for a missing file, and for TOML that is not TOML (with the place).
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except OSError as error:
        raise SettingsError(f"cannot be read ({error.strerror})", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"is not TOML: {error}", where=str(path)) from error
    decoded = decode(Scenario, data)
    scenario: Scenario | None = decoded.value
    found = list(decoded.mistakes)
    if scenario is not None:
        told = {mistake.place for mistake in found}
        placed = (mistake._replace(place=decoded.in_file(mistake.place)) for mistake in mistakes_of(scenario))
        found += [mistake for mistake in placed if mistake.place not in told]
    lines = lines_of(text)

    def remarks(mistakes: Iterable[Mistake]) -> tuple[Remark, ...]:
        made = (Remark(str(path), line_of(lines, m.place), _table(data, m.place) + m.text, m.remedy) for m in mistakes)
        return tuple(sorted(made, key=lambda remark: remark.line))

    if scenario is None or found:
        return Lint(None, remarks(found), ())
    return Lint(scenario, (), remarks(warnings_of(scenario)))


def _table(data: Any, place: Place) -> str:
    """``radar 2 ('two'): `` for what stands in such a table, ``traffic: `` in a plain one, nothing at the top."""
    if not place or (len(place) == 1 and not isinstance(data.get(place[0]), dict)):
        return ""
    if len(place) == 1 or not isinstance(place[1], int):
        return f"{place[0]}: "
    table = data[place[0]][place[1]]
    name = f" ({table['name']!r})" if isinstance(table, dict) and isinstance(table.get("name"), str) else ""
    return f"{place[0]} {place[1] + 1}{name}: "


def check_scenario(scenario: Scenario, where: str = "scenario") -> None:
    """Raise SettingsError for what cannot be simulated, naming the places and what would do."""
    found = list(mistakes_of(scenario))
    if not found:
        return
    data = msgspec.to_builtins(scenario)
    said = [str(SettingsError(_table(data, m.place) + m.text, where=where, remedy=m.remedy)) for m in found]
    raise SettingsError(said[0] if len(said) == 1 else "\n".join([f"{where}: {len(said)} mistakes", *said]))


# Lowest and highest value of each key, both allowed.
_LIMITS: dict[type, dict[str, tuple[float, float]]] = {
    Scenario: {"duration_s": (10.0, 86400.0)},
    Traffic: {
        "aircraft": (0, 4000), "lat_deg": (-75, 75), "lon_deg": (-360, 360), "radius_m": (20e3, 600e3), "arrivals": (0, 1),
        "departures": (0, 1), "local": (0, 1), "holding": (0, 1), "delay_sd_m": (0, 1000), "altimetry_sd_m": (0, 1000),
    },
    Airport: {"lat_deg": (-80, 80), "lon_deg": (-360, 360), "height_m": (-500, 6000), "runway_deg": (0, 360)},
    Atmosphere: {"isa_deviation_k": (-60, 60), "shift_m": (-1500, 1500)},
    Shipping: {
        "ships": (1, 2000), "lat_deg": (-75, 75), "lon_deg": (-360, 360), "seaward_deg": (-360, 360), "radius_m": (5e3, 100e3),
        "passing": (0, 1), "calling": (0, 1), "fishing": (0, 1), "anchored": (0, 1), "sea_level_m": (-500, 6000),
        "current_mps": (0, 5),
    },
    Adsb: {
        "sac": (0, 255), "sic": (0, 255), "share": (0, 1), "correlated": (0, 1), "correlation_s": (1, 1e6),
        "height_sd_m": (0, 1000), "velocity_sd_mps": (0, 100), "latency_mean_s": (-60, 60), "latency_sd_s": (0, 10),
        "loss": (0, 0.999), "gap_every_s": (0, 1e9), "gap_s": (0, 86400), "time_quantum_s": (0, 1),
    },
    Ais: {
        "loss": (0, 0.999), "static_s": (1, 86400), "latency_mean_s": (-60, 60), "latency_sd_s": (0, 10), "correlated": (0, 1),
        "correlation_s": (1, 1e6),
    },
    Radar: {
        "sac": (0, 255), "sic": (0, 255), "lat_deg": (-90, 90), "lon_deg": (-360, 360), "height_m": (-500, 20e3),
        "scan_s": (0.1, 120), "min_range_m": (0, 1e6), "max_range_m": (1, 1e6), "min_elevation_deg": (-90, 90),
        "max_elevation_deg": (-90, 90), "detection": (1e-6, 1), "range_sd_m": (0, 1e5), "azimuth_sd_deg": (0, 90),
        "elevation_sd_deg": (0, 90), "time_sd_s": (0, 10), "range_quantum_m": (0, 1e4), "azimuth_quantum_deg": (0, 90),
        "elevation_quantum_deg": (0, 90), "time_quantum_s": (0, 10), "false_plots": (0, 1e5), "ground_height_m": (-500, 9000),
        "primary_only": (0, 1), "second_chain": (0, 1),
    },
}  # fmt: skip
# What the folder of a simulation has besides the radars' files, without the ending.
_TAKEN = ("adsb", "ais", "truth", "truth_plots", "truth_errors", "truth_targets")


def mistakes_of(scenario: Scenario) -> Iterator[Mistake]:
    """What of a scene cannot be simulated, each with its place in the scenario."""
    if scenario.start.tzinfo is None:
        yield Mistake(("start",), "start has no time zone", "Write it as 2026-03-01T10:00:00Z.")
    elif not 1971 <= scenario.start.year <= 2199:
        yield Mistake(("start",), f"start lies in {scenario.start.year}, not within 1971 … 2199")
    yield from _outside(scenario, ())
    yield from _scene_mistakes(scenario)
    names, keys = dict[str, int](), dict[int, int]()
    for k, radar in enumerate(scenario.radar):
        place: Place = ("radar", k)
        yield from _outside(radar, place)
        for mistake in _radar_mistakes(radar):
            yield mistake._replace(place=(*place, *mistake.place))
        if radar.kind == "marine" and scenario.shipping is None:
            yield Mistake((*place, "kind"), "a marine radar sees ships, and there are none", "Give [shipping].")
        first = names.setdefault(radar.name.casefold(), k)
        if first != k:
            yield Mistake((*place, "name"), f"name = {radar.name!r} was used before, by radar {first + 1}", "Each has its own.")
        key = keys.setdefault(radar.sac << 8 | radar.sic, k)
        if key != k:
            text = f"sac and sic = {radar.sac}/{radar.sic} were used before, by radar {key + 1} ({scenario.radar[key].name!r})"
            yield Mistake((*place, "sic"), text, "Each has its own.")


def _outside(table: Any, place: Place) -> Iterator[Mistake]:
    """The numbers of a table that are not finite, or not within their limits."""
    limits = _LIMITS.get(type(table), {})
    for name in table.__struct_fields__:
        value = getattr(table, name)
        for item in value.values() if isinstance(value, dict) else [value]:
            if isinstance(item, float) and not math.isfinite(item):
                yield Mistake((*place, name), f"{name} = {value} is not a finite number")
                break
        else:
            low, high = limits.get(name, (-math.inf, math.inf))
            if isinstance(value, (int, float)) and not low <= value <= high:
                yield Mistake((*place, name), f"{name} = {value} is not within {low:,g} … {high:,g}")


def _scene_mistakes(scenario: Scenario) -> Iterator[Mistake]:
    """Mistakes of all that is not a radar."""
    traffic = scenario.traffic
    yield from _outside(traffic, ("traffic",))
    if traffic.aircraft == 0 and scenario.shipping is None:
        yield Mistake(("traffic", "aircraft"), "aircraft = 0, and there are no ships: nothing to see", "Give [shipping].")
    if traffic.arrivals + traffic.departures + traffic.local > 1 + 1e-9:
        yield Mistake(("traffic",), "arrivals + departures + local are more than 1")
    if (traffic.arrivals or traffic.departures) and traffic.aircraft and not scenario.airport:
        yield Mistake(("traffic",), "arrivals and departures need an [[airport]]", "Give one, or set both to 0.")
    for k, airport in enumerate(scenario.airport):
        yield from _outside(airport, ("airport", k))
    yield from _outside(scenario.atmosphere, ("atmosphere",))
    shipping, ais, adsb = scenario.shipping, scenario.ais, scenario.adsb
    if shipping is not None:
        yield from _outside(shipping, ("shipping",))
        if shipping.passing + shipping.calling + shipping.fishing + shipping.anchored > 1 + 1e-9:
            yield Mistake(("shipping",), "passing + calling + fishing + anchored are more than 1")
    if ais is not None:
        yield from _outside(ais, ("ais",))
        if shipping is None:
            yield Mistake(("ais",), "AIS is of ships, and there are none", "Give [shipping].")
    if adsb is not None:
        yield from _outside(adsb, ("adsb",))
        for name, share in adsb.classes.items():
            if not (name.isdecimal() and 1 <= int(name) <= 11):
                remedy = 'For example { "9" = 0.5, "10" = 0.5 }.'
                yield Mistake(("adsb", "classes", name), f"classes: {name!r} is no NACp, 1 … 11", remedy)
            elif share < 0:
                yield Mistake(("adsb", "classes", name), f"classes: the share of {name!r} is negative")
        if not sum(adsb.classes.values()) > 0:
            yield Mistake(("adsb", "classes"), "classes must map NACp 1 … 11 to shares")
        if not 0.05 <= adsb.interval_s[0] <= adsb.interval_s[1] <= 3600:
            yield Mistake(("adsb", "interval_s"), f"interval_s = {list(adsb.interval_s)} does not rise within 0.05 … 3,600")


def _radar_mistakes(radar: Radar) -> Iterator[Mistake]:
    """Mistakes of one radar, with places within its table."""
    if radar.kind not in _KINDS:
        remedy = f"{nearest(radar.kind, _KINDS)}Known: {', '.join(_KINDS)}."
        yield Mistake(("kind",), f"kind = {radar.kind!r} is not simulated", remedy)
    name = radar.name
    if not name.strip() or name.startswith(".") or len(name) > 100 or any(c in '/\\:*?"<>|' or ord(c) < 32 for c in name):
        yield Mistake(("name",), f"name = {name!r} cannot be the name of a file")
    elif name.casefold() in _TAKEN:
        yield Mistake(("name",), f"name = {name!r} is the name of another file of the simulation")
    if radar.min_range_m >= radar.max_range_m:
        yield Mistake(("max_range_m",), f"max_range_m = {radar.max_range_m:g} is not more than min_range_m")
    if radar.min_elevation_deg >= radar.max_elevation_deg:
        yield Mistake(
            ("max_elevation_deg",), f"max_elevation_deg = {radar.max_elevation_deg:g} is not more than min_elevation_deg"
        )
    if radar.primary_only > 0 and radar.kind != "combined":
        yield Mistake(("primary_only",), "primary_only is of combined radars", 'Give kind = "combined".')
    if radar.height_from_elevation and radar.elevation_sd_deg is None:
        yield Mistake(("height_from_elevation",), "height_from_elevation needs an elevation", "Give elevation_sd_deg.")
    for term in radar.errors:
        place: Place = ("errors", term)
        try:
            needs = term_of(term).needs
        except SettingsError as error:
            base, _, channel = term.partition("@")
            like = nearest(channel, CHANNELS) if base in TERMS else nearest(base, TERMS)
            yield Mistake(place, f"there is no error term {term!r}", like + error.remedy)
            continue
        if "elevation" in needs and radar.elevation_sd_deg is None:
            yield Mistake(place, f"{term} needs a radar that measures elevation", "Give elevation_sd_deg.")


# An error beyond so many of its usual sizes, and a scene of fewer turns of the antenna, are more likely slips than wishes.
_USUAL, _TURNS = 5.0, 10.0
_EARTH_M = 6_371_000.0


def warnings_of(scenario: Scenario) -> Iterator[Mistake]:
    """What of a scene can be simulated and makes little sense, each with its place in the scenario."""
    traffic, shipping = scenario.traffic, scenario.shipping
    if not scenario.radar:
        yield Mistake((), "there is no radar", "Give a [[radar]].")
    for k, radar in enumerate(scenario.radar):
        place: Place = ("radar", k)
        if scenario.duration_s < _TURNS * radar.scan_s:
            turns = scenario.duration_s / radar.scan_s
            yield Mistake((*place, "scan_s"), f"the antenna turns only {turns:.1f} times in {scenario.duration_s:g} s")
        region = shipping if radar.kind == "marine" else traffic if traffic.aircraft else None
        if region is not None:
            away = _distance_m(radar.lat_deg, radar.lon_deg, region.lat_deg, region.lon_deg)
            if away - region.radius_m > radar.max_range_m:
                what = "ships" if radar.kind == "marine" else "traffic"
                yield Mistake(
                    (*place, "max_range_m"),
                    f"max_range_m = {radar.max_range_m:g} reaches no target: the {what} is {away - region.radius_m:,.0f} m away",
                )
        if radar.kind != "marine" and not traffic.aircraft:
            yield Mistake((*place, "kind"), f"a radar of kind {radar.kind!r} sees aircraft, and there are none")
        for name, value in radar.errors.items():
            term = term_of(name)
            usual = term.prior_sd / term.si_per_unit
            if abs(value) > _USUAL * usual:
                text = f"{name} = {value:g} {term.unit} is far beyond what radars have (sd {usual:g} {term.unit})"
                yield Mistake((*place, "errors", name), text)
    kinds = {"ships" if radar.kind == "marine" else "aircraft" for radar in scenario.radar}
    if scenario.radar and scenario.adsb is None and scenario.ais is None:
        yield Mistake((), "there is no reference to calibrate against", "Give [adsb], or [ais] for ships.")
    if (
        scenario.radar
        and scenario.adsb is not None
        and not (traffic.aircraft and scenario.adsb.share > 0 and "aircraft" in kinds)
    ):
        yield Mistake(("adsb",), "no radar sees a target that has ADS-B")
    if scenario.radar and scenario.ais is not None and "ships" not in kinds:
        yield Mistake(("ais",), "no radar sees ships, and only they have AIS", 'Ships are seen by kind = "marine".')


def _distance_m(lat_deg: float, lon_deg: float, other_lat_deg: float, other_lon_deg: float) -> float:
    """About how far two places are apart, along a great circle of a sphere."""
    a, b = math.radians(lat_deg), math.radians(other_lat_deg)
    half = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * math.sin(math.radians(other_lon_deg - lon_deg) / 2) ** 2
    return 2 * _EARTH_M * math.asin(min(1.0, math.sqrt(half)))


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
    begin = scenario.start.timestamp()
    if scenario.traffic.aircraft:
        truth = fly_traffic(
            scenario.traffic, scenario.airport, scenario.atmosphere, begin, scenario.duration_s, aircraft, flights
        )
    else:
        truth = Truth(begin, np.empty(0), np.empty(0), aircraft, scenario.atmosphere, ())
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
