"""Scenarios: traffic, shipping, radars, ADS-B and AIS as one value, read from TOML, and the run that makes tables of it."""

from __future__ import annotations

import datetime
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from .._types import FloatArray, IntArray
from ..errors import SettingsError
from ..model import Fixes, Plots, Sensors
from ..terms import CHANNELS, TERMS, term_of
from ..writing.asterix import Marks
from ..writing.rtklib import FIXED_SD_M, FLOAT_SD_M
from .drift import Drift, Sine
from .lint import Mistake, Place, decode, line_of, lines_of, nearest
from .radar import NOISES, Clutter, Gaps, Noise, Observation, Radar, observe_radar, radar_mistakes
from .reference import (
    Adsb,
    Ais,
    AisLog,
    Mlat,
    Receiver,
    Rtk,
    check_mlat,
    check_rtk,
    equip_aircraft,
    observe_adsb,
    observe_ais,
    observe_mlat,
    observe_rtk,
)
from .targets import Target, is_ship, script_targets, target_faults
from .truth import Airport, Atmosphere, Shipping, Traffic, Truth, fly_traffic, sail_shipping
from .vessel import Vessel

_KINDS = ("psr", "ssr", "mode_s", "combined", "marine")


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene: who flies and sails where, who watches, and what tells where the targets are.

    `start` is UTC.  `traffic` and `shipping` are drawn, `target` are given one by one.
    """

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
    target: tuple[Target, ...] = ()
    mlat: Mlat | None = None
    rtk: Rtk | None = None

    @property
    def summary(self) -> str:
        """What there is, in words: radars, targets, references and the length."""
        told = [_number(len(self.radar), "radar")]
        aircraft = self.traffic.aircraft + sum(t.count for t in self.target if t.kind != "replay" and not is_ship(t))
        ships = (self.shipping.ships if self.shipping else 0) + sum(t.count for t in self.target if is_ship(t))
        told += [f"{aircraft:,} aircraft"] if aircraft else []
        told += [_number(ships, "ship")] if ships else []
        replays = sum(t.count for t in self.target if t.kind == "replay" and not is_ship(t))
        told += [_number(replays, "replayed target")] if replays else []
        names = {"ADS-B": self.adsb, "AIS": self.ais, "multilateration": self.mlat, "RTK": self.rtk}
        told += [name for name, reference in names.items() if reference is not None]
        return f"{', '.join(told)}, {self.duration_s:,g} s"


def _number(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What a scene gave, and what is true of it.

    `observations` are in the order of the scenario's radars, each in the order of stamps.  `fix_target` (m,) tells whose each fix
    is.  A radar's file holds its plots in the same order, so row numbers agree before and after writing.  `ais` is what the ships
    sent, where the scene has AIS; `mlat` and `rtk` are what multilateration and receivers on board tell.
    """

    scenario: Scenario
    truth: Truth
    observations: tuple[Observation, ...]
    fixes: Fixes
    fix_target: IntArray
    ais: AisLog | None = None
    mlat: Fixes = field(default_factory=Fixes)
    mlat_target: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    rtk: Fixes = field(default_factory=Fixes)
    rtk_target: IntArray = field(default_factory=lambda: np.empty(0, np.int64))

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
        """The true errors: radar, term, value in the term's unit; of one that changes, its mean over the radar's plots."""
        return {
            radar.name: {
                name: error if isinstance(error, (int, float)) else _mean(seen.errors[name](seen.seconds), error)
                for name, error in radar.errors.items()
            }
            for radar, seen in zip(self.scenario.radar, self.observations, strict=True)
        }


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


def _mean(values: FloatArray, error: Drift) -> float:
    return float(values.mean()) if len(values) else error.value


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
        # A recording lies beside the scenario.
        beside = [
            t if t.recording is None else replace(t, recording=str(Path(path).parent / t.recording)) for t in scenario.target
        ]
        scenario = replace(scenario, target=tuple(beside))
        told = list(found)
        placed = (mistake._replace(place=decoded.in_file(mistake.place)) for mistake in mistakes_of(scenario))
        found += [mistake for mistake in placed if not any(_follows(mistake, other) for other in told)]
    lines = lines_of(text)

    def remarks(mistakes: Iterable[Mistake]) -> tuple[Remark, ...]:
        made = (Remark(str(path), line_of(lines, m.place), _table(data, m.place) + m.text, m.remedy) for m in mistakes)
        return tuple(sorted(made, key=lambda remark: remark.line))

    if scenario is None or found:
        return Lint(None, remarks(found), ())
    return Lint(scenario, (), remarks(warnings_of(scenario)))


def _follows(mistake: Mistake, first: Mistake) -> bool:
    """Whether a mistake is but what a key that could not be read leads to: of the same place, or about that key of its table."""
    if mistake.place == first.place:
        return True
    about = first.place[:-1] in (mistake.place, mistake.place[:-1])
    return about and re.search(rf"\b{re.escape(str(first.place[-1]))}\b", mistake.text) is not None


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
    Vessel: {
        "lat_deg": (-80, 80), "lon_deg": (-360, 360), "height_m": (-500, 6000), "speed_mps": (0, 60), "turn_degps": (-10, 10),
        "max_turn_degps": (1e-3, 10), "roll_deg": (0, 45), "pitch_deg": (0, 30), "yaw_deg": (0, 45), "heave_m": (0, 20),
        "roll_period_s": (1, 600), "pitch_period_s": (1, 600), "yaw_period_s": (1, 600), "heave_period_s": (1, 600),
        "report_s": (0.01, 600), "position_sd_m": (0, 1000), "heading_sd_deg": (0, 45), "roll_sd_deg": (0, 45),
        "pitch_sd_deg": (0, 45),
    },
    Noise: {
        "correlated": (0, 1), "correlation_s": (1e-3, 1e6), "t_degrees": (2.001, 1e6), "outliers": (0, 1),
        "outlier_factor": (0, 1e4),
    },
    Clutter: {"plots": (1e-6, 1e5), "places": (1, 1e6), "scatter_m": (0, 1e5)},
    Gaps: {"every_s": (0, 1e9), "length_s": (1e-3, 1e6)},
    Drift: {"walk_per_sqrt_h": (0, 1e9)},
    Sine: {"period_s": (1e-3, 1e9)},
    Mlat: {
        "sac": (0, 255), "sic": (0, 255), "lat_deg": (-89, 89), "lon_deg": (-180, 180), "radius_m": (100, 500e3), "share": (0, 1),
        "loss": (0, 0.999), "correlated": (0, 1), "correlation_s": (1e-3, 1e6), "interval_s": (0.1, 600), "latency_s": (-60, 60),
        "horizontal_sd_m": (1e-3, 1e4), "arrival_sd_m": (1e-3, 1e4), "altitude_sd_m": (1e-3, 1e4), "worst_sd_m": (1e-3, 1e5),
        "height_sd_m": (1e-3, 1e4),
    },
    Receiver: {"lat_deg": (-89, 89), "lon_deg": (-180, 180), "height_m": (-500, 9000)},
    Rtk: {
        "interval_s": (0.05, 60), "fixed_sd_m": (1e-4, FIXED_SD_M), "float_sd_m": (FIXED_SD_M, FLOAT_SD_M),
        "float_share": (0, 0.999), "float_s": (1e-3, 1e6), "correlated": (0, 1), "correlation_s": (1e-3, 1e6),
        "velocity_sd_mps": (0, 100),
        "gap_every_s": (0, 1e9), "gap_s": (0, 1e6),
    },
}  # fmt: skip
# What the folder of a simulation has besides the radars' files, without the ending.
_TAKEN = ("adsb", "ais", "mlat", "rtk", "truth", "truth_plots", "truth_errors", "truth_targets")


def mistakes_of(scenario: Scenario) -> Iterator[Mistake]:
    """What of a scene cannot be simulated, each with its place in the scenario, and once."""
    yield from dict.fromkeys(_mistakes(scenario))


def _mistakes(scenario: Scenario) -> Iterator[Mistake]:
    if scenario.start.tzinfo is None:
        yield Mistake(("start",), "start has no time zone", "Write it as 2026-03-01T10:00:00Z.")
    elif not 1971 <= scenario.start.year <= 2199:
        yield Mistake(("start",), f"start lies in {scenario.start.year}, not within 1971 … 2199")
    yield from _outside(scenario, ())
    yield from _scene_mistakes(scenario)
    yield from _target_mistakes(scenario)
    names, keys = dict[str, int](), dict[int, int]()
    for k, radar in enumerate(scenario.radar):
        place: Place = ("radar", k)
        for mistake in _radar_mistakes(radar):
            yield mistake._replace(place=(*place, *mistake.place))
        if radar.kind == "marine" and not _ships(scenario):
            yield Mistake((*place, "kind"), "a marine radar sees ships, and there are none", "Give [shipping].")
        first = names.setdefault(radar.name.casefold(), k)
        if first != k:
            yield Mistake((*place, "name"), f"name = {radar.name!r} was used before, by radar {first + 1}", "Each has its own.")
        key = keys.setdefault(radar.sac << 8 | radar.sic, k)
        if key != k:
            text = f"sac and sic = {radar.sac}/{radar.sic} were used before, by radar {key + 1} ({scenario.radar[key].name!r})"
            yield Mistake((*place, "sic"), text, "Each has its own.")


def _ships(scenario: Scenario) -> bool:
    """Whether there are ships; a replay tells only when it is read."""
    return scenario.shipping is not None or any(is_ship(t) or t.kind == "replay" for t in scenario.target)


def _aircraft(scenario: Scenario) -> bool:
    return scenario.traffic.aircraft > 0 or any(not is_ship(t) for t in scenario.target)


def _outside(table: Any, place: Place) -> Iterator[Mistake]:
    """The numbers of a table, and of the tables in it, that are not finite or not within their limits."""
    limits = _LIMITS.get(type(table), {})
    for name in table.__struct_fields__:
        value = getattr(table, name)
        low, high = limits.get(name, (-math.inf, math.inf))
        if isinstance(value, (int, float)) and not low <= value <= high:
            yield Mistake((*place, name), f"{name} = {value} is not within {low:,g} … {high:,g}")
        elif isinstance(value, msgspec.Struct):
            yield from _outside(value, (*place, name))
        else:
            parts: Iterable[tuple[str | int, Any]] = value.items() if isinstance(value, dict) else ()
            for key, item in enumerate(value) if isinstance(value, tuple) else parts:
                if isinstance(item, msgspec.Struct):
                    yield from _outside(item, (*place, name, key))
                elif not all(math.isfinite(x) for x in (item if isinstance(item, tuple) else (item,)) if isinstance(x, float)):
                    yield Mistake((*place, name, key), f"{name}: {item} is not a finite number")


def _said(check: Callable[[], None], fields: Sequence[str], place: Place) -> Iterator[Mistake]:
    """The mistake that a check raises, at the key that it names."""
    try:
        check()
    except SettingsError as error:
        text = str(error.args[0]).removeprefix(f"{error.where}: ")
        yield Mistake((*place, *_key_in(text, fields)), text, error.remedy)


def _narrowed(table: Any, place: Place, text: str) -> Place:
    """The place of the key that a message about a table is about, where it names one."""
    for part in place:
        table = getattr(table, part) if isinstance(table, msgspec.Struct) and isinstance(part, str) else table[part]
    return (*place, *_key_in(text, table.__struct_fields__)) if isinstance(table, msgspec.Struct) else place


def _key_in(text: str, fields: Sequence[str]) -> tuple[str, ...]:
    """The key that a message is about: before an equals sign, or a word that only a key can be, or its first word."""
    words = [*re.findall(r"(\w+) =", text), *re.findall(r"[a-z0-9]+_\w+", text), *re.findall(r"^\w+", text)]
    return tuple([word for word in words if word in fields][:1])


def _scene_mistakes(scenario: Scenario) -> Iterator[Mistake]:
    """Mistakes of all that is not a radar."""
    traffic = scenario.traffic
    if traffic.aircraft == 0 and scenario.shipping is None and not scenario.target:
        text = "aircraft = 0, and there are no ships or targets: nothing to see"
        yield Mistake(("traffic", "aircraft"), text, "Give [shipping] or [[target]].")
    if traffic.arrivals + traffic.departures + traffic.local > 1 + 1e-9:
        yield Mistake(("traffic",), "arrivals + departures + local are more than 1")
    if (traffic.arrivals or traffic.departures) and traffic.aircraft and not scenario.airport:
        yield Mistake(("traffic",), "arrivals and departures need an [[airport]]", "Give one, or set both to 0.")
    shipping, ais, adsb = scenario.shipping, scenario.ais, scenario.adsb
    if shipping is not None and shipping.passing + shipping.calling + shipping.fishing + shipping.anchored > 1 + 1e-9:
        yield Mistake(("shipping",), "passing + calling + fishing + anchored are more than 1")
    if ais is not None and not _ships(scenario):
        yield Mistake(("ais",), "AIS is of ships, and there are none", "Give [shipping].")
    if adsb is not None:
        for name, share in adsb.classes.items():
            if not (name.isdecimal() and 1 <= int(name) <= 11):
                remedy = 'For example { "9" = 0.5, "10" = 0.5 }.'
                yield Mistake(("adsb", "classes", name), f"classes: {name!r} is no NACp, 1 … 11", remedy)
            elif share < 0:
                yield Mistake(("adsb", "classes", name), f"classes: the share of {name!r} is negative")
        if not any(share != 0 for share in adsb.classes.values()):
            yield Mistake(("adsb", "classes"), "classes must map NACp 1 … 11 to shares")
        if not 0.05 <= adsb.interval_s[0] <= adsb.interval_s[1] <= 3600:
            yield Mistake(("adsb", "interval_s"), f"interval_s = {list(adsb.interval_s)} does not rise within 0.05 … 3,600")


def _target_mistakes(scenario: Scenario) -> Iterator[Mistake]:
    """Mistakes of scripted targets and of what only they carry, or what sees them."""
    taken: dict[str, int] = {}
    names: list[str] = []
    for k, target in enumerate(scenario.target):
        faults = list(target_faults(target, scenario.radar, scenario.duration_s, scenario.adsb is not None))
        # What else there is to say of an unknown craft is said of an aircraft.
        unknown = [fault for fault in faults if fault[0].startswith("craft =")]
        for text, remedy in unknown or faults:
            yield Mistake(("target", k, *_key_in(text, target.__struct_fields__)), text, remedy)
        name = target.name or f"target {k + 1}"
        names += [name] if target.count == 1 else [f"{name}-{n + 1}" for n in range(min(target.count, 1000))]
        if taken.setdefault(name.casefold(), k) != k:
            text = f"name = {target.name!r} was used before, by target {taken[name.casefold()] + 1}"
            yield Mistake(("target", k, "name"), text, "Each has its own.")
        if target.recording is not None and not Path(target.recording).exists():
            yield Mistake(("target", k, "recording"), f"recording = {target.recording!r}: there is no such file")
    if scenario.mlat is not None:
        mlat = scenario.mlat
        if not any(_outside(mlat, ())):
            yield from _said(partial(check_mlat, mlat, "mlat"), mlat.__struct_fields__, ("mlat",))
    if scenario.rtk is not None:
        rtk = scenario.rtk
        strange = [k for k, name in enumerate(rtk.targets) if name not in names]
        for k in strange if names else ():
            remedy = f"{nearest(rtk.targets[k], names)}Known: {', '.join(names)}."
            yield Mistake(("rtk", "targets", k), f"there is no target {rtk.targets[k]!r}", remedy)
        if not any(_outside(rtk, ())) and not (names and strange):
            yield from _said(partial(check_rtk, rtk, tuple(names), "rtk"), rtk.__struct_fields__, ("rtk",))


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
    for name in radar.noise:
        if name not in NOISES:
            remedy = f"{nearest(name, NOISES)}Known: {', '.join(NOISES)}."
            yield Mistake(("noise", name), f"there is no noise {name!r}", remedy)
    # What is but a number outside its limits was said already, at the number.
    outside = [mistake.place for mistake in _outside(radar, ())] + [("noise", name) for name in radar.noise if name not in NOISES]
    for place, text, remedy in radar_mistakes(radar):
        if not any(number[: len(place)] == place for number in outside):
            yield Mistake(_narrowed(radar, place, text), text, remedy)
    for term in radar.errors:
        at: Place = ("errors", term)
        try:
            needs = term_of(term).needs
        except SettingsError as error:
            base, _, channel = term.partition("@")
            like = nearest(channel, CHANNELS) if base in TERMS else nearest(base, TERMS)
            yield Mistake(at, f"there is no error term {term!r}", like + error.remedy)
            continue
        if "elevation" in needs and radar.elevation_sd_deg is None:
            yield Mistake(at, f"{term} needs a radar that measures elevation", "Give elevation_sd_deg.")
        kind = term_of(term)
        largest = _largest(radar.errors[term], 3600.0)
        if largest * kind.si_per_unit > _MOST_USUAL * kind.prior_sd:
            yield Mistake(at, f"{term} comes to {largest:g} {kind.unit}, which no radar can be off by", "Lessen it.")


# An error beyond so many of its usual sizes, and a scene of fewer turns of the antenna, are more likely slips than wishes.
_USUAL, _TURNS = 5.0, 10.0
# Beyond so many the arithmetic ends, not the sense alone.
_MOST_USUAL = 1e6
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
        sees_ships = radar.kind == "marine"
        # Where a ship sails to is another matter.
        region = None if radar.platform is not None else shipping if sees_ships else traffic if traffic.aircraft else None
        if region is not None and not any(is_ship(t) == sees_ships or t.kind == "replay" for t in scenario.target):
            away = _distance_m(radar.lat_deg, radar.lon_deg, region.lat_deg, region.lon_deg) - region.radius_m
            if away > radar.max_range_m:
                what = "ships are" if sees_ships else "traffic is"
                text = f"max_range_m = {radar.max_range_m:g} reaches no target: the {what} {away:,.0f} m away or further"
                yield Mistake((*place, "max_range_m"), text)
        if not sees_ships and not _aircraft(scenario):
            yield Mistake((*place, "kind"), f"a radar of kind {radar.kind!r} sees aircraft, and there are none")
        for name, error in radar.errors.items():
            term = term_of(name)
            usual = term.prior_sd / term.si_per_unit
            largest = _largest(error, scenario.duration_s)
            if largest > _USUAL * usual:
                text = f"{name} comes to {largest:g} {term.unit}, far beyond what radars have (sd {usual:g} {term.unit})"
                yield Mistake((*place, "errors", name), text)
    kinds = {"ships" if radar.kind == "marine" else "aircraft" for radar in scenario.radar}
    if not kinds:
        return
    for radar in scenario.radar:
        error = radar.errors.get("time_offset", 0.0)
        late = datetime.timedelta(seconds=error.value if isinstance(error, Drift) else error)
        if (scenario.start + late).astimezone(datetime.UTC).date() != scenario.start.astimezone(datetime.UTC).date():
            text = f"{radar.name} stamps its first plots with another date than others: no single --date reads all files"
            yield Mistake(("start",), text, "Begin further from midnight.")
    adsb, ais, mlat, rtk = scenario.adsb, scenario.ais, scenario.mlat, scenario.rtk
    if adsb is None and ais is None and mlat is None and rtk is None:
        yield Mistake((), "there is no reference to calibrate against", "Give [adsb], [mlat], [rtk], or [ais] for ships.")
    carried = _aircraft(scenario) and "aircraft" in kinds
    if adsb is not None and not (carried and (adsb.share > 0 or any(t.adsb for t in scenario.target))):
        yield Mistake(("adsb",), "no radar sees a target that has ADS-B")
    if mlat is not None and not (carried and mlat.share > 0):
        yield Mistake(("mlat",), "no radar sees a target that is multilaterated")
    if ais is not None and "ships" not in kinds:
        yield Mistake(("ais",), "no radar sees ships, and only they have AIS", 'Ships are seen by kind = "marine".')
    if rtk is not None:
        carriers = [t for k, t in enumerate(scenario.target) if not rtk.targets or _carries(t, k, rtk)]
        if not any(t.kind == "replay" or ("ships" if is_ship(t) else "aircraft") in kinds for t in carriers):
            yield Mistake(("rtk",), "no radar sees a target that has a receiver on board")


def _carries(target: Target, number: int, rtk: Rtk) -> bool:
    name = target.name or f"target {number + 1}"
    return any(wanted == name or (target.count > 1 and wanted.startswith(f"{name}-")) for wanted in rtk.targets)


def _largest(error: float | Drift, span_s: float) -> float:
    """About the largest value that an error can come to in a scene; of a random walk, its sd at the end."""
    if not isinstance(error, Drift):
        return abs(error)
    hours = span_s / 3600.0
    moving = sum(abs(wave.amplitude) for wave in error.sine) + sum(abs(step.by) for step in error.step)
    return abs(error.value) + abs(error.ramp_per_h) * hours + moving + error.walk_per_sqrt_h * math.sqrt(hours)


def _distance_m(lat_deg: float, lon_deg: float, other_lat_deg: float, other_lon_deg: float) -> float:
    """About how far two places are apart, along a great circle of a sphere."""
    a, b = math.radians(lat_deg), math.radians(other_lat_deg)
    half = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * math.sin(math.radians(other_lon_deg - lon_deg) / 2) ** 2
    return 2 * _EARTH_M * math.asin(min(1.0, math.sqrt(half)))


def simulate(scenario: Scenario, seed: int | np.random.Generator) -> Simulated:
    """Fly the scenario's traffic, sail its ships, and let its radars and references watch.

    The same scenario and seed give the same tables; another radar in the list changes neither the traffic nor the other radars'
    noise.  Raises SettingsError for what cannot be simulated.
    """
    check_scenario(scenario)
    begin, span, adsb, ais = scenario.start.timestamp(), scenario.duration_s, scenario.adsb, scenario.ais
    flights, equipment, reports, *watches = np.random.default_rng(seed).spawn(3 + len(scenario.radar))
    aircraft = equip_aircraft(scenario.traffic.aircraft, scenario.traffic, adsb, equipment)
    truth = fly_traffic(scenario.traffic, scenario.airport, scenario.atmosphere, begin, span, aircraft, flights)
    # Of the equipment's seed, so that neither ships nor radars change what the others draw.
    voyages, messages, scripts, stations, receivers = equipment.spawn(5)
    sea_m = 0.0
    if scenario.shipping is not None:
        sea_m = scenario.shipping.sea_level_m
        latency = (0.0, 0.0) if ais is None else (ais.latency_mean_s, ais.latency_sd_s)
        truth = sail_shipping(scenario.shipping, truth, span, latency, voyages)
    truth = script_targets(
        scenario.target, truth, span, scenario.radar, scripts, traffic=scenario.traffic, adsb=adsb, ais=ais, sea_level_m=sea_m
    )
    observations = tuple(observe_radar(truth, radar, rng) for radar, rng in zip(scenario.radar, watches, strict=True))
    nothing: tuple[Fixes, IntArray] = Fixes(), np.empty(0, np.int64)
    return Simulated(
        scenario,
        truth,
        observations,
        *(nothing if adsb is None else observe_adsb(truth, adsb, reports)),
        None if ais is None else observe_ais(truth, ais, messages),
        *(nothing if scenario.mlat is None else observe_mlat(truth, scenario.mlat, stations)),
        *(nothing if scenario.rtk is None else observe_rtk(truth, scenario.rtk, receivers)),
    )
