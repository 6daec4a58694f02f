"""A simulated scene as files: recordings in real formats, sensors.toml, and what is true of them."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from .._files import together
from .._types import AnyArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from ..geodesy import enu_from_ecef, geodetic_from_ecef, rotate
from ..model import Sensor, Sensors, unpack_callsigns
from ..terms import Whose, term_of
from ..writing import write_text
from ..writing.asterix import write_asterix
from ..writing.nmea import write_ais, write_nmea
from ..writing.rtklib import write_rtklib
from ..writing.tables import write_table
from .drift import Drift
from .radar import Observation, Radar, geometry_at
from .scenario import Scenario, Simulated

# As which files plots are written: what each radar would send, all as ASTERIX, marine radars as NMEA, all as Parquet.
Form = Literal["auto", "asterix", "nmea", "table"]
# A log of NMEA has no SAC/SIC; the reader calls its radar this.
_NMEA_ID = 65536
_TABLES = ("truth_plots.parquet", "truth_errors.csv", "truth_targets.parquet")
# The truth of targets is told every second, or less often in scenes so large that there would be more rows than this.
_MOST_ROWS = 1_000_000
_ERROR_STEPS = 1000


class SceneFiles(msgspec.Struct, frozen=True):
    """Where a scene was written, the UTC date of its first record, and its true errors (radar, term, value in its unit).

    `plots` are the files of the radars that saw anything, and of own ships' ways.  `counts` tells of each file how many rows and
    targets it holds; `empty` why a radar has no file.
    """

    plots: tuple[Path, ...]
    reference: tuple[Path, ...]
    sensors: Path
    truth_file: Path
    date: datetime.date
    truth: dict[str, dict[str, float]]
    tables: tuple[Path, ...] = ()
    counts: dict[str, dict[str, int]] = {}
    empty: dict[str, str] = {}

    def command(self, out: str | Path) -> tuple[str, ...]:
        """The words of the command line that finds the errors again, with results in `out`; none where there is no reference."""
        if not self.reference:
            return ()
        adsb = any(path.name == "adsb.ast" for path in self.reference)
        return (
            *("boresight", "calibrate", *map(str, self.plots), "--reference", *map(str, self.reference)),
            *("--sensors", str(self.sensors), "--date", self.date.isoformat()),
            # Records do not tell their edition.
            *(("--edition", "021=2.4") if adsb else ()),
            *("--out", str(out)),
        )


def plots_file(radar: Radar, form: Form = "auto") -> str:
    """The name of the file of a radar's plots.

    CAT048 and CAT010 have no item for an elevation: such plots become a table.  A ship's log of NMEA holds her own way too.
    """
    if form == "table" or (form == "auto" and radar.elevation_sd_deg is not None):
        return f"{radar.name}.parquet"
    log = form == "nmea" or (form == "auto" and radar.platform is not None)
    return f"{radar.name}.nmea" if log and radar.kind == "marine" else f"{radar.name}.ast"


def _ship_file(radar: Radar, form: Form) -> str | None:
    """The name of the file of own ship's reports, where a radar sails and its plots do not hold them."""
    if radar.platform is None or plots_file(radar, form).endswith(".nmea"):
        return None
    return f"{radar.name}-own-ship.parquet"


def scene_files(scenario: Scenario, form: Form = "auto", *, tables: bool = False) -> tuple[str, ...]:
    """The names of the files that `write_scene` writes."""
    return (
        *(plots_file(radar, form) for radar in scenario.radar),
        *(name for radar in scenario.radar if (name := _ship_file(radar, form)) is not None),
        *(("adsb.ast",) if scenario.adsb is not None else ()),
        *(("ais.nmea",) if scenario.ais is not None else ()),
        *(("mlat.ast",) if scenario.mlat is not None else ()),
        *(_receiver_files(scenario) if scenario.rtk is not None else ()),
        "sensors.toml",
        "truth.json",
        *(_TABLES if tables else ()),
    )


def _receiver_files(scenario: Scenario) -> list[str]:
    """The names of the files of receivers on board: one a scripted target at most, and all in one table."""
    return ["rtk.parquet", *(f"rtk-{n + 1}.pos" for n in range(sum(target.count for target in scenario.target)))]


def check_form(scenario: Scenario, form: Form) -> None:
    """Raise SettingsError where a scene cannot be written in this form."""
    if form == "nmea" and not any(radar.kind == "marine" for radar in scenario.radar):
        raise SettingsError(
            "NMEA logs are those of marine radars, and the scene has none",
            where="--format",
            remedy='Take auto, asterix or table, or give a radar kind = "marine".',
        )
    logs = [radar.name for radar in scenario.radar if plots_file(radar, form).endswith(".nmea")]
    if len(logs) > 1:
        raise SettingsError(
            f"an NMEA log does not tell whose it is, so only one radar can have one, not {', '.join(logs)}",
            where="--format",
            remedy="Take asterix or table.",
        )


def lost_in(scenario: Scenario, form: Form) -> list[str]:
    """What a scene loses in this form: elevations, which ASTERIX and NMEA have no item for."""
    return [
        f"{radar.name}: its elevations are not in {name}, which has no item for them (--format auto or table writes them)"
        for radar in scenario.radar
        if radar.elevation_sd_deg is not None and not (name := plots_file(radar, form)).endswith(".parquet")
    ]


def write_scene(
    run: Simulated, folder: str | Path, *, form: Form = "auto", tables: bool = False, seed: int | None = None
) -> SceneFiles:
    """Write a simulated scene to `folder`, which is made where it does not exist: all files together or none.

    One file a radar: CAT048 with CAT034; of a marine radar CAT010, which coastal stations send (plots, not the smoothed targets
    of NMEA's TTM); Parquet where it measures elevation.  ``adsb.ast`` (CAT021), ``ais.nmea`` (AIVDM), ``sensors.toml`` and
    ``truth.json``; with `tables` the truth of every plot, error and target too.  What was there is moved to ``earlier-1`` …
    The same scene gives the same bytes.

    Raises InputError where it cannot be written, SettingsError where not in this form, NothingToDo where no radar saw anything.
    """
    scenario, folder = run.scenario, Path(folder)
    check_form(scenario, form)
    empty = {
        radar.name: why_nothing(run, k)
        for k, (radar, seen) in enumerate(zip(scenario.radar, run.observations, strict=True))
        if not len(seen.plots)
    }
    if len(empty) == len(scenario.radar):
        why = "; ".join(f"{name}: {reason}" for name, reason in empty.items()) or "there is no radar"
        raise NothingToDo(f"{scenario.name}: no plot is simulated: {why}", remedy="Give radars that see targets.")
    plots: list[Path] = []
    ways: list[Path] = []
    reference: list[Path] = []
    counts: dict[str, dict[str, int]] = {}
    with together(folder, scene_files(scenario, form, tables=tables)) as beside:
        for radar, seen in zip(scenario.radar, run.observations, strict=True):
            if len(seen.plots):
                name = plots_file(radar, form)
                plots.append(folder / name)
                _write_plots(beside / name, radar, seen)
                counts[name] = _count(seen.target)
                ship = _ship_file(radar, form)
                if ship is not None:
                    ways.append(folder / ship)
                    write_table(beside / ship, seen.own_ship)
        if scenario.adsb is not None and len(run.fixes):
            reference.append(folder / "adsb.ast")
            write_asterix(beside / "adsb.ast", fixes=run.fixes)
            counts["adsb.ast"] = _count(run.fix_target)
        if run.ais is not None and len(run.ais.target):
            reference.append(folder / "ais.nmea")
            write_ais(beside / "ais.nmea", run.ais.positions, run.ais.statics)
            counts["ais.nmea"] = _count(run.ais.target)
        if len(run.mlat):
            reference.append(folder / "mlat.ast")
            write_asterix(beside / "mlat.ast", fixes=run.mlat)
            counts["mlat.ast"] = _count(run.mlat_target)
        receivers = np.unique(run.rtk.track).tolist()
        for number in receivers:
            mine = run.rtk.track == number
            name = f"rtk-{number}.pos"
            write_rtklib(beside / name, run.rtk[mine])
            counts[name] = _count(run.rtk_target[mine])
        if len(receivers) > 1:
            # Solutions do not tell whose they are: read together they would be one target.
            write_table(beside / "rtk.parquet", run.rtk)
            counts["rtk.parquet"] = _count(run.rtk_target)
        if receivers:
            reference.append(folder / ("rtk.parquet" if len(receivers) > 1 else f"rtk-{receivers[0]}.pos"))
        write_text(beside / "sensors.toml", sensors_toml(_as_written(run.sensors, scenario, form)))
        told: dict[str, Any] = {"scene": scenario.name, "sensors": _errors_told(run)}
        if tables:
            told |= {"seed": seed, "start": scenario.start, "duration_s": scenario.duration_s, "files": counts, "empty": empty}
            _write_tables(run, beside, form)
        write_text(beside / "truth.json", msgspec.json.format(msgspec.json.encode(told), indent=2).decode() + "\n")
    return SceneFiles(
        plots=(*plots, *ways),
        reference=tuple(reference),
        sensors=folder / "sensors.toml",
        truth_file=folder / "truth.json",
        date=_first_date(run),
        truth=run.errors,
        tables=tuple(folder / name for name in _TABLES) if tables else (),
        counts=counts,
        empty=empty,
    )


def _first_date(run: Simulated) -> datetime.date:
    """The UTC date of the first record: late or early stamps can put it on the day before the scene's begin, or after."""
    first = [float(seen.plots.time_s.min()) for seen in run.observations if len(seen.plots)]
    first += [float(seen.marks.time_s.min()) for seen in run.observations if len(seen.marks.time_s)]
    return datetime.datetime.fromtimestamp(min(first), datetime.UTC).date()


def _count(target: IntArray) -> dict[str, int]:
    known = np.unique(target[target >= 0])
    return {"rows": len(target), "targets": len(known), "false": int(np.count_nonzero(target < 0))}


def _write_plots(path: Path, radar: Radar, seen: Observation) -> None:
    if path.suffix == ".parquet":
        write_table(path, seen.plots)
    elif path.suffix == ".nmea":
        write_nmea(path, seen.plots, platform=seen.own_ship, sensors=Sensors((radar.sensor,)))
    else:
        marks = seen.marks if len(seen.marks.time_s) else None
        write_asterix(path, seen.plots, marks=marks, category=10 if radar.kind == "marine" else 48)


def _as_written(sensors: Sensors, scenario: Scenario, form: Form) -> Sensors:
    """The sensors as the files name them: a log of NMEA knows no SAC/SIC."""
    return Sensors(
        tuple(
            msgspec.structs.replace(sensor, sac=None, sic=None, id=_NMEA_ID)
            if plots_file(radar, form).endswith(".nmea")
            else sensor
            for radar, sensor in zip(scenario.radar, sensors, strict=True)
        )
    )


def _errors_told(run: Simulated) -> dict[str, dict[str, Any]]:
    """The true errors; of one that changes, its mean over the plots and how it changes."""
    told: dict[str, dict[str, Any]] = {}
    for radar in run.scenario.radar:
        terms = told[radar.name] = dict[str, Any]()
        for term, value in run.errors[radar.name].items():
            error = radar.errors[term]
            terms[term] = {"true": value, "unit": term_of(term).unit}
            if isinstance(error, Drift):
                terms[term] |= {"mean_of": "the plots", "drift": error}
    return told


def sensors_toml(sensors: Sensors) -> str:
    """The text of a `sensors.toml` that `load_sensors` reads as these sensors; what stands at its default is left out."""
    tables = []
    for sensor in sensors:
        lines = ["[[sensor]]"]
        for key, value in msgspec.to_builtins(sensor).items():
            if key in ("name", "kind") or value != getattr(_PLAIN, key):
                lines.append(f"{key} = {msgspec.json.encode(value).decode()}")
        tables.append("\n".join(lines) + "\n")
    return "\n".join(tables)


# A sensor of which nothing is told: its fields are the defaults.
_PLAIN = Sensor(name="")


def why_nothing(run: Simulated, number: int) -> str:
    """Why the radar of this number has no plots, in words."""
    truth, radar = run.truth, run.observations[number].radar
    what = "ships" if radar.kind == "marine" else "aircraft"
    first, last = (truth.flights, len(truth)) if radar.kind == "marine" else (0, truth.flights)
    if first == last:
        return f"there are no {what}"
    step = max(5.0, run.scenario.duration_s / 200)
    target, seconds = _grid(truth.first_s[first:last], truth.last_s[first:last], step)
    if not len(target):
        return f"the {what} are there for less than {step:g} s"
    seen = geometry_at(truth, radar, target + first, seconds)
    near, far = float(seen.range_m.min()), float(seen.range_m.max())
    within = (seen.range_m >= radar.min_range_m) & (seen.range_m <= radar.max_range_m)
    if not within.any():
        return f"the {what} are {near:,.0f} to {far:,.0f} m away, not {radar.min_range_m:,.0f} to {radar.max_range_m:,.0f} m"
    silent = np.zeros(len(seconds), np.bool_)
    for begin, end in run.observations[number].outage_s:
        silent |= (seconds >= begin) & (seconds < end)
    if silent[within].all():
        return f"an outage covers all the time that the {what} are in its range"
    height = np.degrees(seen.elevation_rad[within])
    if not ((height >= radar.min_elevation_deg) & (height <= radar.max_elevation_deg)).any():
        return (
            f"the {what} in its range stand at elevations of {height.min():.2f} to {height.max():.2f} degrees, "
            f"not {radar.min_elevation_deg:g} to {radar.max_elevation_deg:g}"
        )
    sectors = ", or they stay in its blind sectors" if radar.gaps.blind_deg else ""
    return f"it turns too slowly or detects too little to see the {what} in its range{sectors}"


def _grid(first_s: FloatArray, last_s: FloatArray, step_s: float) -> tuple[IntArray, FloatArray]:
    """Every `step_s` of each target's time: targets (n,) and times (n,)."""
    times = [np.arange(first, last, step_s) for first, last in zip(first_s.tolist(), last_s.tolist(), strict=True)]
    target = np.repeat(np.arange(len(times)), [len(t) for t in times])
    return target, np.concatenate([np.empty(0), *times])


def _write_tables(run: Simulated, folder: Path, form: Form) -> None:
    parts = [
        _plot_truth(run, k, plots_file(radar, form))
        for k, (radar, seen) in enumerate(zip(run.scenario.radar, run.observations, strict=True))
        if len(seen.plots)
    ]
    write_table(folder / _TABLES[0], {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    write_table(folder / _TABLES[1], _error_truth(run))
    write_table(folder / _TABLES[2], _target_truth(run))


def _plot_truth(run: Simulated, number: int, file: str) -> dict[str, AnyArray]:
    """What is true of the plots of one radar; row k is the file's k-th plot.

    ``late_s`` is the stamp less the true time, with jitter and rounding; ``error_`` is what the terms did, ``noise_`` what chance
    did.
    """
    seen = run.observations[number]
    radar, plots, n = seen.radar, seen.plots, len(seen.plots)
    rows = np.flatnonzero(seen.target >= 0)
    true, error = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    if len(rows):
        whose = Whose(plots.channel[rows], plots.flags[rows], np.full(len(rows), -1, np.int32))
        geometry = geometry_at(run.truth, radar, seen.target[rows], seen.seconds[rows])._replace(whose=whose)
        true[rows] = np.stack([geometry.range_m, np.mod(geometry.azimuth_rad, 2 * math.pi), geometry.elevation_rad], axis=1)
        error[rows] = 0.0
        for name, history in seen.errors.items():
            term = term_of(name)
            if not term.is_time:
                error[rows] += (history(seen.seconds[rows]) * term.si_per_unit)[:, None] * term.columns(geometry)
    # Records of ASTERIX and NMEA stand in the order of their stamps.
    order = np.arange(n) if file.endswith(".parquet") else np.argsort(plots.time_s, kind="stable")
    columns: dict[str, AnyArray] = {
        "sensor": np.asarray(plots.sensor, np.int64),
        "target": seen.target,
        "true_time_s": run.truth.epoch_s + seen.seconds,
        "late_s": plots.time_s - run.truth.epoch_s - seen.seconds,
    }
    for prefix, values in (("", true), ("error_", error), ("noise_", seen.noise)):
        for k, name in enumerate(("range_m", "azimuth_rad", "elevation_rad")):
            columns[prefix + name] = values[:, k]
    return {"file": np.full(n, file, object), "plot": np.arange(n)} | {name: c[order] for name, c in columns.items()}


def _error_truth(run: Simulated) -> dict[str, AnyArray]:
    """Every error over time, a row an error and time."""
    span = run.scenario.duration_s
    seconds = np.linspace(0.0, span, min(_ERROR_STEPS, math.ceil(span) + 1))
    columns: dict[str, list[AnyArray]] = {"time_s": [], "sensor_name": [], "term": [], "value": [], "unit": []}
    for radar, seen in zip(run.scenario.radar, run.observations, strict=True):
        for name, history in seen.errors.items():
            columns["time_s"].append(run.truth.epoch_s + seconds)
            columns["sensor_name"].append(np.full(len(seconds), radar.name, object))
            columns["term"].append(np.full(len(seconds), name, object))
            columns["value"].append(history(seconds))
            columns["unit"].append(np.full(len(seconds), term_of(name).unit, object))
    return {name: np.concatenate(parts) if parts else np.empty(0, object) for name, parts in columns.items()}


def _target_truth(run: Simulated) -> dict[str, AnyArray]:
    """Where every target was: positions of aircraft, and of the middle of ships' hulls."""
    truth = run.truth
    step = max(1.0, math.ceil(float((truth.last_s - truth.first_s).sum()) / _MOST_ROWS))
    target, seconds = _grid(truth.first_s, truth.last_s, step)
    motion = truth.motion(target, seconds, derivatives=1)
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    velocity = rotate(enu_from_ecef(latitude, longitude), motion.velocity)
    names = np.array([*_target_names(run)], object)
    kinds = np.where(np.arange(len(truth)) < truth.flights, "aircraft", "ship").astype(object)
    return {
        "target": target,
        "kind": kinds[target],
        "name": names[target],
        "time_s": truth.epoch_s + seconds,
        "latitude_rad": latitude,
        "longitude_rad": longitude,
        "height_m": height,
        "velocity_east_mps": velocity[:, 0],
        "velocity_north_mps": velocity[:, 1],
        "velocity_up_mps": velocity[:, 2],
        "heading_rad": np.mod(truth.heading_rad(target, seconds, motion), 2 * math.pi),
    }


def _target_names(run: Simulated) -> Iterator[str]:
    """What each target is called: its own name, else its Mode S address and callsign, or its MMSI."""
    craft, flights = run.truth.aircraft, run.truth.flights
    told = [f"{a:06X} {c}".strip() for a, c in zip(craft.mode_s.tolist(), unpack_callsigns(craft.callsign), strict=True)]
    told = [*told[:flights], *map(str, run.truth.ships.mmsi.tolist())]
    for own, name in zip(run.truth.names or [""] * len(told), told, strict=True):
        yield own or name
