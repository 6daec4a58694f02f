"""Frozen results: what a result was made from and how, so that it can be made again and compared.

``run.json`` stands beside a result.  It holds the paths and SHA-256 of the inputs, every setting (sensors.toml and the
requirement by their content), the versions of the software, and the SHA-256 of the result's own files.  `flow.verify` finds the
inputs, makes the result again and compares.
"""

from __future__ import annotations

import datetime
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from . import __version__
from ._files import write_bytes
from ._types import AnyArray
from .assessment.requirement import Requirement
from .calibration import Calibration, Criterion, Input
from .errors import InputError
from .model import Sensors

SCHEMA = "boresight-run/1"
FILE = "run.json"
# The files that a rerun must give again.  The report is made of them.
MADE = ("calibration.json", "residuals.parquet")
# What is handed on is made of them; it must be as it was written.
HANDED = ("report.html", "conformity.json", "biases.csv")
# Beyond the same versions on the same kind of machine sums are added up in another order: what still counts as the same.
OF_SD, OF_SPREAD = 1e-3, 1e-3


class Given(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A recording as it was given: its path, its path from the result's folder, and its file, or the files of its folder."""

    path: str
    relative: str
    folder: bool
    files: tuple[Input, ...]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that `flow.calibrate` was told besides the recordings and the place of the results."""

    sensors: Sensors
    model: str | tuple[str, ...]
    date: datetime.date | None
    editions: dict[int, str]
    truth: dict[str, dict[str, float]]
    title: str
    requirement: Requirement | None
    criterion: Criterion = "cross-validation"
    method: str = "least-squares"
    options: dict[str, str] = {}
    online: bool = False
    associate: str = "hough"
    associate_options: dict[str, str] = {}
    main: str = ""


class Frozen(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """run.json: the recordings, the settings, the versions, and the SHA-256 of the result's files by their names."""

    schema: str
    plots: tuple[Given, ...]
    reference: tuple[Given, ...]
    settings: Settings
    versions: dict[str, str]
    made: dict[str, str]


def versions() -> dict[str, str]:
    """The versions of the software that a result's last digits depend on, and the kind of machine."""
    return {
        "boresight": __version__,
        "python": ".".join(map(str, sys.version_info[:3])),
        **{name: metadata.version(name) for name in ("numpy", "scipy", "numba")},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def freeze(plots: Sequence[str | Path], reference: Sequence[str | Path], settings: Settings, inputs: Iterable[Input]) -> Frozen:
    """What a run is made from; `inputs` are its files, hashed, in the order of the recordings (those of a folder sorted)."""
    rest = iter(inputs)

    def given(path: str | Path) -> Given:
        folder = Path(path).is_dir()
        count = sum(p.is_file() for p in Path(path).iterdir()) if folder else 1
        return Given(str(path), "", folder, tuple(next(rest) for _ in range(count)))

    return Frozen(
        schema=SCHEMA,
        plots=tuple(given(path) for path in plots),
        reference=tuple(given(path) for path in reference),
        settings=settings,
        versions=versions(),
        made={},
    )


def save_frozen(frozen: Frozen, folder: Path, result: Path) -> None:
    """Write run.json into `folder`, beside the result's files that lie there; the result will stand at `result`.

    Raises InputError where a file cannot be read or written.
    """
    from .reading import sha256_of

    def placed(given: Given) -> Given:
        try:
            relative = os.path.relpath(Path(given.path).resolve(), result.resolve())
        except ValueError:  # another drive
            relative = ""
        return msgspec.structs.replace(given, relative=Path(relative).as_posix() if relative else "")

    whole = msgspec.structs.replace(
        frozen,
        plots=tuple(placed(g) for g in frozen.plots),
        reference=tuple(placed(g) for g in frozen.reference),
        made={name: sha256_of(folder / name) for name in (*MADE, *HANDED) if name in MADE or (folder / name).exists()},
    )
    write_bytes(folder / FILE, msgspec.json.format(msgspec.json.encode(whole), indent=1) + b"\n")


def load_frozen(folder: str | Path) -> Frozen:
    """Read the run.json of a result.

    Raises InputError for a folder that is none or holds no result, for a result without run.json, and for a run.json that is
    damaged or of another schema.
    """
    folder = Path(folder)
    path = folder / FILE
    if not folder.is_dir():
        raise InputError("is no folder" if folder.exists() else "does not exist", path=folder, remedy="Give a folder of results.")
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        has = (folder / MADE[0]).exists()
        raise InputError(
            f"holds a {MADE[0]} but no {FILE}: it was not made by boresight calibrate --out, or by an earlier version"
            if has
            else "holds no result",
            path=folder,
            remedy="Calibrate again with --out." if has else "Give the folder that boresight calibrate --out has written.",
        ) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", path=path) from error
    remedy = "It is written beside a result and not meant to be changed: calibrate again."
    try:
        schema = msgspec.json.decode(data, type=_Schema).schema
        if schema != SCHEMA:
            raise InputError(f"its schema is {schema!r}, but {SCHEMA!r} is needed", path=path, remedy="Calibrate again.")
        return msgspec.json.decode(data, type=Frozen)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"is damaged: {error}", path=path, remedy=remedy) from error


class _Schema(msgspec.Struct, frozen=True):
    schema: str


def find_inputs(frozen: Frozen, folder: Path, inputs: Path | None) -> tuple[list[Path], list[Path]]:
    """Where the recordings of plots and of the reference are now, with the very bytes that they had.

    Looked for in the folder `inputs`, if it is given, at the path as it was given, at the path from the result's folder, and in
    that folder itself.  Raises InputError that names every input that is missing or has changed.
    """
    if inputs is not None and not inputs.is_dir():
        raise InputError("is no folder", path=inputs, remedy="--inputs names the folder of the original recordings.")
    wrong: list[str] = []

    def found(given: Given) -> Path:
        own = Path(given.path)
        parts = [p for p in own.parts if p not in ("..", own.anchor)]
        places = [inputs / Path(*parts[k:]) for k in range(len(parts))] if inputs is not None else []
        places += [own, *([folder / given.relative] if given.relative else []), folder / own.name]
        why = ""
        for place in places:
            if place.exists():
                problem = _changed(given, place)
                if not problem:
                    return place
                why = why or problem
        wrong.append(why or f"{given.path} is missing")
        return own

    result = [found(g) for g in frozen.plots], [found(g) for g in frozen.reference]
    if wrong:
        raise InputError(
            f"cannot be made again: {'; '.join(wrong)}",
            path=folder,
            remedy="Name the folder of the original recordings with --inputs.",
        )
    return result


def _changed(given: Given, place: Path) -> str:
    """What is not as it was in a recording that stands at `place`; "" where all is."""
    from .reading import sha256_of

    if given.folder != place.is_dir():
        return f"{place} is {'a folder' if place.is_dir() else 'a file'}, and was {'a folder' if given.folder else 'a file'}"
    if not given.folder:
        return "" if _same(given.files[0], place, sha256_of) else f"{place} has changed"
    names = {Path(i.path).name: i for i in given.files}
    now = {p.name for p in place.iterdir() if p.is_file()}
    said = [f"{place / name} is missing" for name in names if name not in now]
    said += [f"{place / name} is new" for name in sorted(now - set(names))]
    said += [f"{place / name} has changed" for name, i in names.items() if name in now and not _same(i, place / name, sha256_of)]
    return "; ".join(said)


def _same(then: Input, place: Path, sha256_of: object) -> bool:
    assert callable(sha256_of)
    return place.stat().st_size == then.bytes and sha256_of(place) == then.sha256


class Comparison(NamedTuple):
    """Two results compared: `exact` to the last bit, `same` within the tolerance, and what differs, in words."""

    exact: bool
    same: bool
    differences: tuple[str, ...]


class Result(NamedTuple):
    """A result as its files hold it."""

    calibration: Calibration
    residuals: Mapping[str, AnyArray]


def load_result(folder: Path) -> Result:
    """Read calibration.json and residuals.parquet.  Raises InputError for a file that is missing or damaged."""
    from .calibration import load_calibration
    from .reading.tables import parquet_columns

    return Result(load_calibration(folder / MADE[0]), parquet_columns(folder / MADE[1]))


def compare(then: Result, now: Result) -> Comparison:
    """Compare two results.

    Within the tolerance are values that differ by `OF_SD` of their sd, covariances by as much, and residuals that differ by
    `OF_SPREAD` of the spread of their column.  Paths and words are not compared.
    """
    exact, said = _compare_calibrations(then.calibration, now.calibration)
    rows_exact, rows_said = _compare_columns(then.residuals, now.residuals)
    return Comparison(exact and rows_exact, not said and not rows_said, tuple(said + rows_said))


def _compare_calibrations(then: Calibration, now: Calibration) -> tuple[bool, list[str]]:
    if then.terms != now.terms:
        names = [{f"{key.name} of {key.sensor >> 8}/{key.sensor & 255}" for key in c.terms} for c in (then, now)]
        return False, [f"the terms: {', '.join(sorted(names[0] ^ names[1])) or 'their order'}"]
    said: list[str] = []
    exact = then.value.shape == now.value.shape and all(
        np.array_equal(a, b) for a, b in ((then.epoch_s, now.epoch_s), (then.value, now.value), (then.covariance, now.covariance))
    )
    if then.value.shape != now.value.shape or not np.array_equal(then.epoch_s, now.epoch_s):
        said.append("the epochs")
    elif not exact:
        sd = np.sqrt(np.abs(np.diagonal(now.covariance, axis1=1, axis2=2)))
        off = np.nan_to_num(np.abs(then.value - now.value) / sd, nan=np.inf).max(axis=0)
        for key, o in zip(now.terms, off.tolist(), strict=True):
            if o > OF_SD:
                said.append(f"{key.name} of {key.sensor >> 8}/{key.sensor & 255} by {o:.3g} of its sd")
        spread = np.abs(then.covariance - now.covariance) / (sd[:, :, None] * sd[:, None, :])
        if not np.nan_to_num(spread, nan=np.inf).max() <= 2 * OF_SD:
            said.append("the covariance")
    for a, b in zip(then.sensors, now.sensors, strict=False):
        for what, x, y, size in (
            ("noise", a.noise.range_m, b.noise.range_m, b.noise.range_m),
            ("noise", a.noise.azimuth_rad, b.noise.azimuth_rad, b.noise.azimuth_rad),
            ("noise", a.noise.elevation_rad, b.noise.elevation_rad, b.noise.elevation_rad),
            ("distance before", a.before.median_m, b.before.median_m, b.before.median_m),
            ("distance after", a.after.median_m, b.after.median_m, b.after.median_m),
        ):
            exact &= np.array_equal(x, y, equal_nan=True)
            if not np.isclose(x, y, rtol=0, atol=OF_SD * abs(size) if np.isfinite(size) else 0, equal_nan=True):
                said.append(f"{what} of {b.name}")
        if (a.name, a.plots, a.targets, a.tracks) != (b.name, b.plots, b.targets, b.tracks):
            said.append(f"the number of plots, tracks or targets of {b.name}")
    missing = [{(n.sensor, n.term) for n in c.not_determined} for c in (then, now)]
    if missing[0] != missing[1] or len(then.sensors) != len(now.sensors):
        said.append("what was not determined")
    return bool(exact and not said), list(dict.fromkeys(said))


def _compare_columns(then: Mapping[str, AnyArray], now: Mapping[str, AnyArray]) -> tuple[bool, list[str]]:
    if list(then) != list(now):
        return False, [f"the columns of {MADE[1]}"]
    sizes = {len(c) for c in (*then.values(), *now.values())}
    if len(sizes) > 1:
        return False, [f"the number of pairs in {MADE[1]}"]
    exact, said = True, []
    for name, a in then.items():
        b = now[name]
        if a.dtype.kind != "f" or b.dtype.kind != "f":
            same = bool(np.array_equal(a, b))
            exact &= same
            said += [] if same else [f"{name} in {MADE[1]}"]
        elif not np.array_equal(a, b, equal_nan=True):
            exact = False
            there = np.isfinite(a)
            spread = float(np.std(b[np.isfinite(b)])) if np.isfinite(b).any() else 0.0
            if not np.array_equal(there, np.isfinite(b)) or (there.any() and np.abs(a - b)[there].max() > OF_SPREAD * spread):
                said.append(f"{name} in {MADE[1]}")
    return exact, said


def hand_made(frozen: Frozen, folder: Path) -> list[str]:
    """The files of a result that are not as they were written.  Raises InputError where calibration or residuals are missing."""
    from .reading import sha256_of

    gone = [name for name in frozen.made if name in HANDED and not (folder / name).exists()]
    return [name for name, then in frozen.made.items() if name in gone or sha256_of(folder / name) != then]
