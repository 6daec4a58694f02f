"""The batch run: the steps in their order, from files to a report.

    read -> align -> associate -> register -> correct -> assess -> report

Nothing is computed here; each step is the public verb of its own module.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from . import __version__
from .errors import InputError, NothingToDo, SettingsError
from .model import Fixes, Pairs, Platform, Plots, Recording, Sensor, Sensors, Source, load_sensors

if TYPE_CHECKING:
    from ._types import AnyArray, FloatArray, IntArray
    from .assessment.requirement import Conformity, Requirement
    from .assessment.residuals import Residuals
    from .association import Association, AssociationSettings
    from .calibration import Calibration, Criterion, Input, Summary
    from .frozen import Frozen, Settings
    from .heights import HeightProfile
    from .registration.mean_shift import Online, Samples
    from .registration.methods import Method
    from .report import Evidence
    from .writing.reencode import Original, Reencoded
    from .writing.sidecar import Provenance

Progress = Callable[[str], None]
# conformity.json is there where a requirement was given, biases.csv where the errors are over time.
_RESULTS = ("calibration.json", "residuals.parquet", "report.html", "run.json", "conformity.json", "biases.csv")
_BIASES = ("range_bias", "azimuth_bias", "elevation_bias")


def _silent(_: str) -> None:
    pass


@dataclass(frozen=True, slots=True)
class TruthRow:
    """One term of a simulated sensor: its true and its found value and the reported sd, in `unit` (NaN: not determined)."""

    term: str
    true: float
    found: float
    sd: float
    unit: str


@dataclass(frozen=True, slots=True)
class Run:
    """What one run found.

    `targets` names the targets of the pairs (number -> Mode S address, MMSI, callsign or track number), `reference` the files
    that were the reference; `truth` is filled where the scene was simulated, `conformity` where a requirement was given.
    `evidence` is what the recordings tell besides the pairs: clocks, PSR - SSR, the path of a moving radar.
    `frozen` is what the run was made from, for run.json; `heights` is what stood for the height of what tells only pressure.
    Where the errors are over time, `samples` are the single differences that they were found from, by sensor.  Where radars were
    compared with a main one, `association` is None, and the residuals are against the main radar's tracks.
    """

    calibration: Calibration
    association: Association | None
    residuals: Residuals
    targets: Mapping[int, str] = field(default_factory=dict)
    reference: tuple[str, ...] = ()
    truth: Mapping[str, tuple[TruthRow, ...]] = field(default_factory=dict)
    conformity: tuple[Conformity, ...] = ()
    evidence: Evidence | None = None
    frozen: Frozen | None = None
    heights: HeightProfile | None = None
    samples: Mapping[int, Samples] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Corrected:
    """What became of recordings that were corrected.

    `plots` rows were written; `provenance` is what `sidecar` holds; `encoded` tells of a recording of ASTERIX that was written
    again (None: a table).
    """

    plots: int
    provenance: Provenance
    sidecar: Path
    encoded: Reencoded | None
    warnings: tuple[str, ...]


def calibrate(
    plots: Sequence[str | Path],
    reference: Sequence[str | Path],
    sensors: Sensors,
    *,
    model: str | Sequence[str] = "auto",
    method: str | None = None,
    options: Mapping[str, str] | None = None,
    online: bool = False,
    associate: str = "hough",
    associate_options: Mapping[str, str] | None = None,
    main: str = "",
    date: datetime.date | None = None,
    editions: Mapping[int, str] | None = None,
    criterion: Criterion = "cross-validation",
    out: str | Path | None = None,
    truth: Mapping[str, Mapping[str, float]] | None = None,
    title: str = "",
    requirement: Requirement | None = None,
    progress: Progress = _silent,
) -> Run:
    """Find the systematic errors of the radars in `plots` against the positions in `reference`.

    `method` is a name of `registration.methods.METHODS` (None: least squares), with its `options` as text; with `online` the
    biases are followed over time.  `associate` is a name of `association.ASSOCIATIONS`, with options likewise.  The model "auto"
    is searched by `criterion`, which is of least squares alone.

    Without a reference (an empty list) the radars are compared with the `main` one (by default the first in `sensors` that has
    plots), by a method that follows biases over time (None: the Kalman bank): the values are then relative
    (`registration.sequential.register_relative`).

    With `out` (a folder), writes calibration.json, residuals.parquet, report.html and run.json there, and biases.csv where the
    errors are over time, each whole or not at all; files of those names that were there are moved to ``earlier-1``,
    ``earlier-2`` …  With `requirement`, judges the radars by it and writes conformity.json too.  `truth` holds the true values of
    a simulated scene: sensor name -> term -> value in its unit.

    Raises InputError for files that cannot be used, SettingsError for sensors or options that make no sense, NothingToDo where
    the recordings do not overlap or nothing in them can be paired.
    """
    from .alignment import apply_time_offsets
    from .assessment.requirement import assess_requirement
    from .assessment.residuals import residuals
    from .frozen import Settings, freeze
    from .reading.site import site_disagreements
    from .report import gather
    from .writing.sidecar import corrected_before

    settings = Settings(
        sensors=sensors,
        model=model if isinstance(model, str) else tuple(model),
        method=method or ("least-squares" if reference else "kalman-bank"),
        options=dict(options or {}),
        online=online,
        associate=associate,
        associate_options=dict(associate_options or {}),
        main=main,
        date=date,
        editions=dict(editions or {}),
        criterion=criterion,
        truth={name: dict(terms) for name, terms in (truth or {}).items()},
        title=title,
        requirement=requirement,
    )
    way = _way(settings, relative=not reference)
    if not plots:
        raise InputError("at least one recording of plots is needed")
    if out is not None:
        _check_folder(Path(out))
    warnings: list[str] = []
    plots, reference = _once(plots, warnings), _once(reference, warnings)
    recordings = _read_all([*plots, *reference], editions, date, warnings, progress)
    radar, trusted = recordings[: len(plots)], recordings[len(plots) :]
    warnings += [text for path in plots for file in _files_of(path) for text in corrected_before(file)]
    measured = _with_known_sensor(Plots.concat([r.plots for r in radar]), sensors, radar, warnings)
    warnings += site_disagreements([s for r in radar for s in r.sources], sensors)
    # Only the report asks for it, so that it is gathered while the steps go on.
    aside = ThreadPoolExecutor(1)
    evidence = aside.submit(gather, measured, radar, sensors) if out is not None else None
    aside.shutdown(wait=False)
    measured = apply_time_offsets(measured, sensors)
    if reference:
        step = _against_reference(measured, trusted, radar, settings, way, warnings, progress)
    else:
        step = _against_main(measured, settings, way, warnings, progress)
    found = replace(
        step.found,
        inputs=tuple(_input(file) for path in [*plots, *reference] for file in _files_of(path)),
        warnings=tuple(dict.fromkeys([*warnings, *step.found.warnings])),
        version=__version__,
    )
    left = residuals(step.pairs, step.sensors, found)
    if not reference:
        # Distances to the main radar's tracks are those that the figures show, not those to its single plots.
        found = replace(found, sensors=tuple(_with_distances(s, left) for s in found.sensors))
    conformity = () if requirement is None else assess_requirement(found, left, step.sensors, requirement)
    if requirement is not None and not conformity:
        said = (f"{requirement.title} has no figure for the kinds of these sensors",)
        found = replace(found, warnings=(*found.warnings, *said))
    run = Run(
        found,
        step.association,
        left,
        targets=step.targets,
        reference=tuple(str(file) for path in reference for file in _files_of(path)),
        truth=_truth_rows(found, truth or {}),
        evidence=evidence.result() if evidence is not None else None,
        heights=step.heights,
        conformity=conformity,
        frozen=freeze(plots, reference, settings, found.inputs),
        samples=step.samples,
    )
    if out is not None:
        progress("writing the report")
        write_results(run, step.sensors, Path(out), title=title)
    return run


@dataclass(frozen=True, slots=True)
class _Way:
    """How a run goes about it: the method and the association, and without a reference what follows which biases."""

    method: Method
    association: AssociationSettings
    follows: Online | None = None
    terms: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Step:
    """What registration leaves to the steps after it; `sensors` are those whose platforms stand still."""

    found: Calibration
    pairs: Pairs
    sensors: Sensors
    targets: Mapping[int, str]
    association: Association | None = None
    heights: HeightProfile | None = None
    samples: Mapping[int, Samples] = field(default_factory=dict)


def _way(settings: Settings, *, relative: bool) -> _Way:
    """Raise SettingsError for options that make no sense, before minutes are spent on the recordings."""
    from .assessment.requirement import check_requirement
    from .association import association_of
    from .registration.methods import METHODS, OnlineMethod, method_of, register_with
    from .registration.per_channel import PerChannel, register_per_channel

    options = dict(settings.options)
    if settings.method == "least-squares":
        options.setdefault("criterion", settings.criterion)
    elif settings.criterion != "cross-validation":
        raise SettingsError(f"the method {settings.method} searches no model", where="--select", remedy="Leave it out.")
    method = method_of(settings.method, options)
    association = association_of(settings.associate, settings.associate_options)
    if settings.requirement is not None:
        check_requirement(settings.requirement)
    if not relative:
        if settings.main:
            raise SettingsError("there is a reference, by which every radar is judged", where="--main", remedy="Leave it out.")
        # Without pairs a method only looks at what it is asked for.
        with contextlib.suppress(NothingToDo):
            if isinstance(method, PerChannel) and isinstance(settings.model, str) and not settings.online:
                register_per_channel(Pairs(), settings.sensors, model=settings.model, settings=method)
            register_with(method, Pairs(), settings.sensors, model=settings.model, online=settings.online)
        return _Way(method, association)
    if not isinstance(method, OnlineMethod):
        known = ", ".join(name for name, one in METHODS.items() if isinstance(one, OnlineMethod))
        raise SettingsError(
            f"the method {settings.method} needs a reference", where="--method", remedy=f"Give --reference, or one of {known}."
        )
    if settings.requirement is not None:
        raise SettingsError(
            "radars compared with each other tell nothing of what is required of one",
            where="--requirement",
            remedy="Give --reference.",
        )
    names = [s.name for s in settings.sensors]
    if settings.main and settings.main not in names:
        raise SettingsError(
            f"there is no sensor {settings.main!r}", where="--main", remedy=f"sensors.toml has: {', '.join(names)}."
        )
    return _Way(method, association, method, _relative_terms(settings.model))


def _relative_terms(model: str | Sequence[str]) -> tuple[str, ...]:
    """The biases that are asked for where radars are compared with each other.  Raises SettingsError for anything else."""
    from .registration.sequential import BIASES
    from .terms import terms_of

    if model in ("auto", "constant"):
        return BIASES
    names = tuple(term.name for term in terms_of(model))
    wrong = [name for name in names if name not in BIASES]
    if wrong:
        raise SettingsError(
            f"without a reference only differences of {', '.join(BIASES)} can be told, not {', '.join(wrong)}: what radars have "
            "in common leaves no trace in what they differ by",
            where="--model",
            remedy="Give --reference, or leave the model out.",
        )
    return names


def _against_reference(
    measured: Plots,
    trusted: Sequence[Recording],
    radar: Sequence[Recording],
    settings: Settings,
    way: _Way,
    warnings: list[str],
    progress: Progress,
) -> _Step:
    """Align, associate and register against the positions in the recordings `trusted`."""
    from .alignment import apply_time_offsets, locate, overlap
    from .association import search
    from .heights import height_profile
    from .measure import site_warnings
    from .platform import platform_views
    from .registration.methods import register_with
    from .registration.sequential import online_samples

    sensors = settings.sensors
    fixes = _others(trusted, measured, warnings)
    if not len(fixes):
        raise NothingToDo(
            f"no record of {_names(trusted)} holds a position", remedy="--reference needs ADS-B or multilateration reports."
        )
    progress("aligning the reference")
    sources: tuple[Source, ...] = tuple(s for r in trusted for s in r.sources)
    fixes = apply_time_offsets(fixes, sensors)
    heights = height_profile(fixes, sensors)
    fixes, said = locate(fixes, sensors, sources, heights=heights)
    warnings += said
    measured, views, sensors, said = platform_views(measured, Platform.concat([r.platform for r in radar]), sensors)
    warnings += said
    warnings += site_warnings(measured, sensors, positions=False)
    check = overlap(measured, fixes)
    warnings += [check.message] if check.message else []
    progress("associating plots and targets")
    association = search(measured, fixes, sensors, way.association, views=views)
    warnings += association.warnings
    progress("estimating the errors")
    pairs = association.pairs
    found = register_with(way.method, pairs, sensors, model=settings.model, online=settings.online)
    samples = online_samples(pairs, sensors, beside=found) if len(found.epoch_s) > 1 else {}
    return _Step(found, pairs, sensors, _target_names(fixes, pairs.target), association, heights, samples)


def _against_main(measured: Plots, settings: Settings, way: _Way, warnings: list[str], progress: Progress) -> _Step:
    """Register radars against a main one: what they see in common, its differences, and these over time."""
    from .association.radars import pairs_against, shared_targets
    from .measure import site_warnings
    from .registration.mean_shift import relative_samples
    from .registration.sequential import register_relative

    sensors = settings.sensors
    main = _main_of(measured, settings, warnings)
    for sensor in sensors:
        if sensor.lat_deg is None and (measured.sensor == sensor.key).any():
            raise SettingsError(
                f"the sensor {sensor.name!r} has no position, and without a reference radars are compared from where they stand: "
                "one that sails cannot be",
                where="sensors.toml",
                remedy="Give --reference; or lat_deg, lon_deg and height_m (ellipsoidal), where its antenna stands still.",
            )
    warnings += site_warnings(measured, sensors, positions=False)
    progress("associating the radars' plots")
    a = way.association
    shared = shared_targets(measured, sensors, main, a)
    warnings += shared.said
    progress("estimating the errors")
    window = (a.range_window_m or 5e3, math.radians(a.azimuth_window_deg or 10.0), math.radians(10.0))
    samples = relative_samples(
        measured, sensors, main, target=shared.target, gap_s=a.reference_gap_s or max(15.0, 1.5 * (main.scan_s or 0.0)),
        window=window,
    )  # fmt: skip
    for sensor in sensors:
        if sensor.key not in samples and sensor.key != main.key and (measured.sensor == sensor.key).any():
            warnings.append(
                f"{sensor.name} is left out: it and {main.name} have no target in common, or differ in all by more than "
                f"{window[0]:,.0f} m or {math.degrees(window[1]):g}° (--associate-option range_window_m=…, azimuth_window_deg=…)"
            )
    found = register_relative(samples, sensors, main, method=way.follows, terms=way.terms)
    pairs = pairs_against(measured, sensors, main, shared.target)
    names = {}
    if shared.by == "identity":
        names = {k: f"{k:06X}" if k <= 0xFFFFFF else str(k) for k in set(pairs.target.tolist())}
    return _Step(found, pairs, sensors, names, samples=samples)


def _with_distances(summary: Summary, left: Residuals) -> Summary:
    """A sensor's summary with the distances that its residuals show."""
    import numpy as np
    from msgspec import structs

    from .calibration import Accuracy

    def accuracy(distance_m: FloatArray) -> Accuracy:
        known = distance_m[(left.sensor == summary.sensor) & np.isfinite(distance_m)]
        return Accuracy(*np.percentile(known, [50, 95]).tolist()) if len(known) else Accuracy(math.nan, math.nan)

    return structs.replace(summary, before=accuracy(left.distance_before_m), after=accuracy(left.distance_after_m))


def _main_of(measured: Plots, settings: Settings, warnings: list[str]) -> Sensor:
    """The radar that the others are compared with: the one that is named, else the first of sensors.toml that has plots."""
    there = set(measured.sensor.tolist())
    if settings.main:
        return next(s for s in settings.sensors if s.name == settings.main)
    main = next(s for s in settings.sensors if s.key in there)
    if len(there) > 1:
        warnings.append(
            f"there is no reference: all errors are relative to {main.name}, the first in sensors.toml (--main names another)"
        )
    return main


def write_results(run: Run, sensors: Sensors, out: Path, *, title: str = "") -> None:
    """Write calibration.json, residuals.parquet, report.html and run.json into the folder `out`, keeping what was there.

    They appear together or not at all: on a full disk or Ctrl-C an earlier result stays as it was.  Raises InputError.
    """
    from ._files import together
    from .frozen import save_frozen
    from .report import write_report

    with together(out, _RESULTS) as beside, ThreadPoolExecutor(1) as writer:
        # While the figures are drawn.
        data = writer.submit(_write_data, run, beside)
        write_report(
            beside / "report.html",
            run.calibration,
            run.residuals,
            sensors,
            title=title or "Radar calibration",
            truth={name: {row.term: row.true for row in rows} for name, rows in run.truth.items()},
            association=run.association,
            targets=run.targets,
            reference=run.reference,
            evidence=run.evidence,
            conformity=run.conformity,
            heights=run.heights,
            samples=run.samples,
        )
        data.result()
        if run.frozen is not None:
            save_frozen(run.frozen, beside, out)


def _write_data(run: Run, folder: Path) -> None:
    """Write what programs read of a run: calibration.json, residuals.parquet; conformity.json, biases.csv where there are."""
    from .assessment.requirement import save_conformity
    from .calibration import save_calibration
    from .writing.tables import write_table

    save_calibration(run.calibration, folder / "calibration.json")
    write_table(folder / "residuals.parquet", _with_names(run))
    if run.conformity:
        save_conformity(run.conformity, folder / "conformity.json")
    if len(run.calibration.epoch_s) > 1:
        write_table(folder / "biases.csv", _over_time(run.calibration))


def _over_time(found: Calibration) -> dict[str, AnyArray]:
    """Every error at every epoch, a row each: time, sensor, term, value, sd and unit."""
    import numpy as np

    from .calibration import si_per_unit

    names = {s.sensor: s.name for s in found.sensors}
    k, p = found.value.shape
    scale = np.array([si_per_unit(key) for key in found.terms])

    def each(words: list[str]) -> AnyArray:
        return np.repeat(np.array(words, object), k)

    return {
        "time_s": np.tile(found.epoch_s, p),
        "sensor": each([names[key.sensor] for key in found.terms]),
        "term": each([key.name if key.channel == "all" else f"{key.name}@{key.channel}" for key in found.terms]),
        "value": (found.value / scale).T.ravel(),
        "sd": (found.sd / scale).T.ravel(),
        "unit": each([key.unit for key in found.terms]),
    }


@dataclass(frozen=True, slots=True)
class Verified:
    """A result that was made again.

    `same` within the tolerance, `exact` to the last bit; `differences` and the `changed` files (those that are not as they were
    written) in words; `versions` are those that differ: name -> then and now.
    """

    same: bool
    exact: bool
    differences: tuple[str, ...]
    changed: tuple[str, ...]
    versions: Mapping[str, tuple[str, str]]


def verify(folder: str | Path, *, inputs: str | Path | None = None, progress: Progress = _silent) -> Verified:
    """Make the result in `folder` again from its frozen inputs and settings, in a temporary place, and compare.

    `inputs` is a folder to look for the recordings in, where they are no longer where they were.  Raises InputError where the
    folder holds no whole result, and for recordings that are missing or not those that the result was made from, each named.
    """
    from .frozen import compare, find_inputs, hand_made, load_frozen, load_result, versions

    folder = Path(folder)
    frozen = load_frozen(folder)
    changed, then = hand_made(frozen, folder), load_result(folder)
    progress("looking for the recordings")
    plots, reference = find_inputs(frozen, folder, None if inputs is None else Path(inputs))
    settings = frozen.settings
    run = calibrate(
        plots,
        reference,
        settings.sensors,
        model=settings.model,
        method=settings.method,
        options=settings.options,
        online=settings.online,
        associate=settings.associate,
        associate_options=settings.associate_options,
        main=settings.main,
        date=settings.date,
        editions=settings.editions,
        criterion=settings.criterion,
        truth=settings.truth,
        title=settings.title,
        requirement=settings.requirement,
        progress=progress,
    )
    progress("comparing")
    with tempfile.TemporaryDirectory(prefix="boresight-") as part:
        _write_data(run, Path(part))
        compared = compare(then, load_result(Path(part)))
    now = versions()
    return Verified(
        same=compared.same and not changed,
        exact=compared.exact and not changed,
        differences=compared.differences,
        changed=tuple(changed),
        versions={name: (old, now.get(name, "")) for name, old in frozen.versions.items() if old != now.get(name, "")},
    )


def correct_files(
    plots: Sequence[str | Path],
    calibration: str | Path,
    out: str | Path,
    *,
    sensors: str | Path | None = None,
    date: datetime.date | None = None,
    editions: Mapping[int, str] | None = None,
    terms: str | Sequence[str] = "advised",
    progress: Progress = _silent,
) -> Corrected:
    """Take the errors of a calibration out of recordings and write them to the file `out`, with its provenance beside it.

    An ending .parquet or .csv makes a table of the plots of all recordings.  Another one (that of the recording, or .ast) writes
    a single recording of ASTERIX again, with the measured items encoded anew where they stand and every other byte as it was.
    `terms` are those that the calibration's verdicts advise, "all", or names.  What stood at `out` is replaced.

    Raises SettingsError where `out` is an input or has another ending and for unknown `terms`, InputError for files that cannot
    be used, for a calibration of another radar and for a recording that was corrected before, NothingToDo where there is no plot
    or no term to apply.
    """
    from msgspec import structs

    from ._files import check_place
    from .alignment import apply_time_offsets
    from .calibration import Input, chosen, load_calibration
    from .correction import correct_and_say
    from .reading import sha256_of
    from .writing.reencode import open_original, reencode
    from .writing.sidecar import Provenance, describe, find_sidecar, inner, sidecar_of, terms_done, write_sidecar
    from .writing.tables import write_table

    out = Path(out)
    as_table = _is_table(plots, out)
    given = [Path(p) for p in (*plots, calibration, *([sensors] if sensors is not None else []))]
    if any(out.resolve() == p.resolve() for p in given):
        raise SettingsError(f"{out} is one of the inputs, which are never written to", where="--out")
    check_place(out)
    if Path(calibration).is_dir():
        calibration = Path(calibration) / "calibration.json"
    found = load_calibration(calibration)
    chosen(found, terms)
    warnings: list[str] = []
    if main := found.settings.get("main"):
        warnings.append(f"the calibration is relative to {main}: corrected plots agree with it, right or wrong")
    if len(found.epoch_s) > 1:
        warnings.append(
            "the errors are over time: each plot gets the values of its own time, and those that are told are the last"
        )
    plots = _once(plots, warnings)
    files = [file for path in plots for file in _files_of(path)]
    for file in files:
        before = find_sidecar(file)
        if before is not None:
            raise InputError(
                f"was corrected already: {describe(before[1])} ({before[0].name})",
                path=file,
                remedy=f"Give the original recording, {', '.join(i.path for i in before[1].inputs)}.",
            )
    original = None
    if as_table:
        recordings = _read_all(plots, editions, date, warnings, progress)
        table = Plots.concat([r.plots for r in recordings])
    else:
        progress(f"reading {plots[0]}")
        original = open_original(plots[0], editions=editions, date=date)
        warnings += _said_of(plots[0], original)
        table = original.plots
    if not len(table):
        raise NothingToDo(f"no record of {', '.join(map(str, plots))} holds a measured polar position")
    done = terms_done(found, set(table.sensor.tolist()), terms)
    if done and all(term.held for term in done):
        raise NothingToDo(
            f"no term of {calibration} is to be applied: {'; '.join(f'{t.term}: {t.held}' for t in done)}",
            remedy="--terms all applies them all, --terms NAME,NAME some.",
        )
    known = load_sensors(sensors) if sensors is not None else None
    fixed: dict[str, float] = {}
    measured = table
    if known is not None:
        measured = apply_time_offsets(table, known)
        there = set(table.sensor.tolist())
        fixed = {f"{s.key >> 8}/{s.key & 255}": s.time_offset_s for s in known if s.time_offset_s and s.key in there}
    for place, offset in fixed.items():
        warnings.append(
            f"the fixed time offset of {place} in sensors.toml ({offset:g} s) is taken from the stamps too: with the corrected "
            "recording it must not stand there"
        )
    warnings += _span_of_time(measured, found, calibration)
    progress("correcting")
    clean, said = correct_and_say(measured, found, sensors=known, terms=terms)
    progress(f"writing {out}")
    beside = out
    try:
        with tempfile.TemporaryDirectory(prefix=".boresight-", dir=out.parent) as part:
            beside = Path(part) / out.name
            provenance = Provenance(
                version=__version__,
                output=Input(path=out.name, sha256="", bytes=0),
                inputs=tuple(_input(file) for file in files),
                calibration=_input(calibration),
                terms=done,
                fixed_time_offset_s=fixed,
            )
            encoded = None
            if original is None:
                write_table(beside, clean, metadata=inner(provenance))
            else:
                encoded = reencode(original, clean, beside)
            provenance = structs.replace(
                provenance,
                output=Input(path=out.name, sha256=sha256_of(beside), bytes=beside.stat().st_size),
                rounding={r.item: f"{r.rms:.3g} {r.unit}" for r in encoded.rounding} if encoded is not None else {},
            )
            write_sidecar(provenance, sidecar_of(beside))
            # The provenance first: a corrected recording without it could be corrected again.
            sidecar_of(beside).replace(sidecar_of(out))
            beside.replace(out)
    except InputError as error:
        raise InputError(str(error).replace(str(beside), str(out))) from error
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror or error})", path=out, remedy="Write elsewhere.") from error
    return Corrected(len(clean), provenance, sidecar_of(out), encoded, tuple([*warnings, *said]))


def _span_of_time(plots: Plots, found: Calibration, path: str | Path) -> list[str]:
    """What is to be said of plots beyond the epochs of errors over time.  Raises InputError where all come before the first."""
    import numpy as np

    if len(found.epoch_s) < 2:
        return []
    own = np.isin(plots.sensor, [key.sensor for key in found.terms]) & np.isfinite(plots.time_s)
    early, late = own & (plots.time_s < found.epoch_s[0]), own & (plots.time_s > found.epoch_s[-1])
    first, last = (f"{datetime.datetime.fromtimestamp(float(t), datetime.UTC):%Y-%m-%d %H:%M:%S}" for t in found.epoch_s[[0, -1]])
    if early.any() and early.sum() == own.sum():
        when = datetime.datetime.fromtimestamp(float(plots.time_s[early].max()), datetime.UTC)
        raise InputError(
            f"its errors over time begin at {first} UTC, and all plots are before: the last is of {when:%Y-%m-%d %H:%M:%S}",
            path=path,
            remedy="--date gives the day of a recording that does not tell it.",
        )
    said = []
    for rows, what, epoch in ((early, "before the first", first), (late, "after the last", last)):
        if rows.any():
            said.append(f"{int(rows.sum()):,} plots are {what} epoch of the calibration: they get the values of {epoch} UTC")
    return said


def _is_table(plots: Sequence[str | Path], out: Path) -> bool:
    """Whether `out` is to be a table; raises SettingsError where it can be neither that nor a recording of ASTERIX."""
    from .reading import is_asterix

    ending = out.suffix.lower()
    if ending in (".parquet", ".csv"):
        return True
    what = f"{out}: the ending {ending} cannot be written" if ending else f"{out} has no ending"
    table = "Name it .parquet or .csv for a table of the plots"
    if len({Path(p).resolve() for p in plots}) != 1:
        raise SettingsError(what, where="--out", remedy=f"{table}; only a single recording can be written again as ASTERIX.")
    own = Path(plots[0]).suffix
    if not Path(plots[0]).is_file() or not is_asterix(plots[0]):
        # What is no recording at all is told by who reads it.
        if Path(plots[0]).is_file() or Path(plots[0]).is_dir():
            raise SettingsError(what, where="--out", remedy=f"{table}; {plots[0]} is no ASTERIX, which could be written again.")
        return False
    if ending not in (own.lower(), ".ast"):
        endings = " or ".join(dict.fromkeys([own or ".ast", ".ast"]))
        raise SettingsError(what, where="--out", remedy=f"{table}, or {endings} for the ASTERIX recording again.")
    return False


def demo(out: str | Path, *, seed: int = 1, progress: Progress = _silent) -> Run:
    """Simulate three radars with known errors, write real ASTERIX and AIS, calibrate from those files; found against true."""
    from ._files import keep_earlier
    from .simulation.demo import demo_files, write_demo

    if seed < 0:
        raise SettingsError(f"{seed} is no seed", where="--seed", remedy="Give 0 or more.")
    progress("simulating three radars, 60 aircraft and 20 ships")
    folder = Path(out)
    _check_folder(folder)
    made = _missing_folders(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names = [p.name for p in demo_files(folder)]
    earlier: Path | None = None
    placed: list[Path] = []
    try:
        with tempfile.TemporaryDirectory(prefix=".boresight-", dir=folder) as part:
            files = write_demo(part, seed)
            earlier = keep_earlier(folder, (*_RESULTS, *names))
            for name in names:
                (Path(part) / name).rename(folder / name)
                placed.append(folder / name)
        return calibrate(
            [folder / p.name for p in files.plots],
            [folder / p.name for p in files.reference],
            load_sensors(folder / files.sensors.name),
            date=files.date,
            editions={21: "2.4"},
            out=folder,
            truth=files.truth,
            title="Demonstration: simulated radars with known errors",
            progress=progress,
        )
    except BaseException:
        # What came of it is nothing without the report; what was there before is there again.
        for path in placed:
            path.unlink(missing_ok=True)
        if earlier is not None:
            for path in earlier.iterdir():
                path.rename(folder / path.name)
            earlier.rmdir()
        _remove_empty(made)
        raise


def _read_all(
    paths: Sequence[str | Path],
    editions: Mapping[int, str] | None,
    date: datetime.date | None,
    warnings: list[str],
    progress: Progress,
) -> list[Recording]:
    """The recordings in their order, several read at a time; what is to be said of them goes into `warnings`."""
    from ._parallel import in_threads
    from .reading import read

    progress(f"reading {', '.join(map(str, paths))}")
    recordings = in_threads(lambda path: read(path, editions=dict(editions or {}), date=date), paths)
    for path, recording in zip(paths, recordings, strict=True):
        warnings += _said_of(path, recording)
    return recordings


def _said_of(path: str | Path, recording: Recording | Original) -> list[str]:
    """A recording's warnings and its damage, in words."""
    said = [f"{path}: {text}" if str(path) not in text else text for text in recording.warnings]
    if recording.damaged:
        first = recording.damaged[0]
        places = len(recording.damaged)
        what = "one damaged place was left out" if places == 1 else f"{places:,} damaged places were left out; the first"
        said.append(f"{path}: {what} at byte {first.offset}: {first.why}")
    return said


def _with_known_sensor(plots: Plots, sensors: Sensors, recordings: Sequence[Recording], warnings: list[str]) -> Plots:
    """The plots whose sensor stands in sensors.toml; the others are counted in a warning."""
    import numpy as np

    if not len(plots):
        raise NothingToDo(
            f"no record of {_names(recordings)} holds a measured polar position",
            remedy="PLOTS come first, then --reference: are they exchanged?",
        )
    ids, counts = np.unique(plots.sensor, return_counts=True)
    known = np.array([sensors.find(int(key)) is not None for key in ids])
    listed = ", ".join(f"{key >> 8}/{key & 255} ({n:,} plots)" for key, n in zip(ids[~known], counts[~known], strict=True))
    if not known.any():
        raise NothingToDo(
            f"sensors.toml has no entry for any radar in {_names(recordings)}: SAC/SIC {listed}",
            remedy="Add a [[sensor]] with its sac, sic, lat_deg, lon_deg and height_m.",
        )
    if not known.all():
        warnings.append(f"sensors.toml has no entry for SAC/SIC {listed}: left out")
        return plots[np.isin(plots.sensor, ids[known])]
    return plots


def _once(paths: Sequence[str | Path], warnings: list[str]) -> list[str | Path]:
    """The paths without those that were given before."""
    kept: dict[Path, str | Path] = {}
    for path in paths:
        real = Path(path).resolve()
        if real in kept:
            warnings.append(f"{path} was given twice: read once")
        kept.setdefault(real, path)
    return list(kept.values())


def _others(recordings: Sequence[Recording], plots: Plots, warnings: list[str]) -> Fixes:
    """The positions of the reference, without those that a radar under calibration made of its own measurements."""
    import numpy as np

    radars = set(np.unique(plots.sensor).tolist())
    kept: list[Fixes] = []
    for r in recordings:
        # A station may share its SAC/SIC with a radar beside it: only a source that itself measures is the radar.
        own = {s.id for s in r.sources if s.plots} - {s.id for s in r.sources if not s.plots}
        mine = np.isin(r.fixes.source, sorted(own & radars))
        if mine.any():
            said = f"{int(mine.sum()):,} of {len(r.fixes):,} positions in {r.path} are the radar's own"
            if mine.all() and len(recordings) == 1:
                raise NothingToDo(
                    f"{said}: a radar cannot be its own reference", remedy="--reference needs ADS-B or multilateration reports."
                )
            warnings.append(f"{said}: not used as a reference")
        kept.append(r.fixes[~mine] if mine.any() else r.fixes)
    return Fixes.concat(_apart(kept))


def _apart(tables: Sequence[Fixes]) -> list[Fixes]:
    """The positions of several files; targets without a name that files of one time number alike get numbers of their own.

    A file of a satellite receiver holds one target and no word of which: two of them are two.
    """
    import numpy as np

    out: list[Fixes] = []
    seen: list[tuple[set[int], float, float]] = []
    free = 1 + max((int(t.track.max()) for t in tables if len(t)), default=0)
    for fixes in tables:
        known = np.isfinite(fixes.time_s)
        nameless = (fixes.mode_s <= 0) & (fixes.mmsi <= 0) & (fixes.callsign < 0) & (fixes.track >= 0) & known
        if nameless.any():
            whose = set(np.unique(fixes.source[nameless]).tolist())
            begin, end = float(fixes.time_s[nameless].min()), float(fixes.time_s[nameless].max())
            if any(whose & other and begin <= last and first <= end for other, first, last in seen):
                fixes = fixes.replace(track=np.where(nameless, fixes.track + free, fixes.track))
                free = 1 + int(fixes.track.max())
            seen.append((whose, begin, end))
        out.append(fixes)
    return out


def _with_names(run: Run) -> dict[str, AnyArray]:
    """The residuals by column, with what each target is called after its number."""
    import numpy as np

    columns: dict[str, AnyArray] = {}
    for f in fields(run.residuals):
        columns[f.name] = getattr(run.residuals, f.name)
        if f.name == "target":
            numbers, which = np.unique(columns["target"], return_inverse=True)
            names = np.array([run.targets.get(int(number)) for number in numbers], object)
            columns["target_name"] = names[which] if len(names) else np.empty(0, object)
    return columns


def _target_names(fixes: Fixes, used: IntArray) -> dict[int, str]:
    """What the reference calls the targets that were paired."""
    import numpy as np

    from .model import unpack_callsigns
    from .targets import targets_of

    target = targets_of(fixes)
    rows = np.flatnonzero(np.isin(target, used))
    names: dict[int, str] = {}
    # Not every record carries everything: the strongest name that any of them does is taken.
    for column, least, text in (
        (np.where(fixes.mode_s < 0xFFFFFF, fixes.mode_s, 0), 1, lambda v: f"{v:06X}"),
        (fixes.mmsi, 1, str),
        (fixes.callsign, 1, lambda v: unpack_callsigns(np.array([v]))[0]),
        (fixes.track, 0, lambda v: f"track {v}"),
    ):
        known = rows[column[rows] >= least]
        found, first = np.unique(target[known], return_index=True)
        for number, row in zip(found.tolist(), known[first].tolist(), strict=True):
            names.setdefault(number, text(int(column[row])))
    return names


def _names(recordings: Sequence[Recording]) -> str:
    return ", ".join(r.path for r in recordings)


def _files_of(path: str | Path) -> list[Path]:
    """The file itself, or the files of a folder that is read as one recording."""
    return sorted(p for p in Path(path).iterdir() if p.is_file()) if Path(path).is_dir() else [Path(path)]


def _input(path: str | Path) -> Input:
    from .calibration import Input
    from .reading import sha256_of

    return Input(path=str(path), sha256=sha256_of(path), bytes=Path(path).stat().st_size)


def _truth_rows(found: Calibration, truth: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[TruthRow, ...]]:
    """True and found values of every simulated term, in the terms' units."""
    from .terms import term_of

    names = {s.sensor: s.name for s in found.sensors}
    rows: dict[str, tuple[TruthRow, ...]] = {}
    main = truth.get(str(found.settings.get("main", "")), {})
    for sensor, terms in truth.items():
        filled = []
        if "main" in found.settings:
            # Of what a radar has beyond its biases the differences tell nothing.
            terms = {name: true - main.get(name, 0.0) for name, true in terms.items() if name in _BIASES}
            if sensor not in names.values():
                continue
        for term, true in terms.items():
            value = sd = float("nan")
            kind = term_of(term)
            for k, key in enumerate(found.terms):
                if (names[key.sensor], key.channel, key.name) == (sensor, kind.channel, kind.base):
                    value, sd = float(found.value[-1, k] / kind.si_per_unit), float(found.sd[-1, k] / kind.si_per_unit)
            filled.append(TruthRow(term, true, value, sd, kind.unit))
        rows[sensor] = tuple(filled)
    return rows


def _no_folder(folder: Path, error: OSError) -> InputError:
    return InputError(f"is no folder that can be written to ({error.strerror})", path=folder, remedy="Name another one.")


def _missing_folders(folder: Path) -> list[Path]:
    """The folder and those above it that do not exist, innermost first."""
    return [p for p in (folder, *folder.parents) if not p.exists()]


def _remove_empty(folders: Sequence[Path]) -> None:
    """Remove what was made for results that never came; a folder that somebody has used stays."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()


def _check_folder(folder: Path) -> None:
    """Raise InputError where results could not be written to this folder; leaves nothing behind."""
    made = _missing_folders(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".boresight-", dir=folder):
            pass
    except OSError as error:
        raise _no_folder(folder, error) from error
    finally:
        _remove_empty(made)
