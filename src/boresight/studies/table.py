"""What a study gives: rows that set a printed number beside ours, figures, and what does not reproduce and why."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import msgspec
import numpy as np

from ..compute import ExecutorName, Experiment, Result, monte_carlo
from ..errors import SettingsError
from ..report.drawing import Drawing

# The name on the command line, and the module of `studies` that holds its `run`.
_MODULES = {
    "serial-fusion": "serial_fusion",
    "covariance-conversion": "covariance_conversion",
    "double-target": "double_target",
    "mean-shift": "mean_shift",
    "adsb-registration": "adsb_registration",
}


class Bound(msgspec.Struct, frozen=True):
    """What our number must lie within; one end may be open."""

    low: float | None = None
    high: float | None = None

    def holds(self, value: float) -> bool:
        """Whether a number lies within.  One that is not a number does not."""
        return bool(np.isfinite(value) and (self.low is None or value >= self.low) and (self.high is None or value <= self.high))


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One cell of a paper's table (or a claim of its text, or a point of a figure) and ours.

    `printed` is None where the paper prints none; verdicts are words.  `holds` is whether ours lies within `bound`; None without.
    `note` says in a sentence why a number does not reproduce, or what it needs.
    """

    id: str
    table: str
    row: str
    quantity: str
    printed: float | str | None
    ours: float | str | None
    bound: Bound | None = None
    holds: bool | None = None
    unit: str = ""
    note: str = ""


def row(
    id: str,
    table: str,
    name: str,
    quantity: str,
    ours: float | str | None,
    *,
    printed: float | str | None = None,
    low: float | None = None,
    high: float | None = None,
    unit: str = "",
    note: str = "",
) -> Row:
    """A row; with `low` or `high` it is bounded, and says whether ours holds."""
    ends = [None if end is None else float(end) for end in (low, high)]
    bound = None if low is None and high is None else Bound(*ends)
    holds = None
    if bound is not None:
        holds = isinstance(ours, int | float) and bound.holds(float(ours))
    value = float(ours) if isinstance(ours, int | float) and not isinstance(ours, bool) else ours
    return Row(
        id=id,
        table=table,
        row=name,
        quantity=quantity,
        printed=printed,
        ours=value,
        bound=bound,
        holds=holds,
        unit=unit,
        note=note,
    )


@dataclass(frozen=True, slots=True)
class Settings:
    """How a study is run: `quick` takes fewer draws (bounds are widened by their sampling errors, and rows say so)."""

    quick: bool = False
    seed: int = 1
    executor: ExecutorName = "serial"
    workers: int = 0
    scheduler: str | None = None
    progress: Callable[[str], None] = field(default=lambda _: None)

    def runs(self, experiment: Experiment, runs: int, what: str, *, chunk: int = 250) -> Result:
        """`compute.monte_carlo` of this study's settings; `what` is told with the progress."""
        return monte_carlo(
            experiment,
            runs,
            seed=self.seed,
            chunk=chunk,
            executor=self.executor,
            workers=self.workers,
            scheduler=self.scheduler,
            progress=lambda done, of: self.progress(f"{what}: {done:,} of {of:,} runs"),
        )


@dataclass(frozen=True, slots=True)
class Study:
    """The outcome: `paper` is the citation, `summary` sentences in plain words, `remarks` what does not reproduce and why."""

    name: str
    title: str
    paper: str
    summary: tuple[str, ...]
    rows: tuple[Row, ...]
    figures: tuple[Drawing, ...] = ()
    remarks: tuple[str, ...] = ()
    quick: bool = False
    seed: int = 1
    seconds: float = 0.0

    @property
    def failed(self) -> tuple[Row, ...]:
        """The rows whose bound does not hold."""
        return tuple(r for r in self.rows if r.holds is False)


def study_names() -> tuple[str, ...]:
    """The names of all studies."""
    return tuple(_MODULES)


def check_name(name: str) -> str:
    """The name itself.  Raises SettingsError where there is no such study."""
    if name not in _MODULES:
        raise SettingsError(f"there is no study {name!r}", where="study", remedy=f"Studies: {', '.join(_MODULES)}, or all.")
    return name


def run_study(name: str, settings: Settings | None = None) -> Study:
    """Run a study by its name.  Raises SettingsError for a name that does not exist."""
    check_name(name)
    started = time.perf_counter()
    settings = settings or Settings()
    found: Study = import_module(f".{_MODULES[name]}", __package__).run(settings)
    ids = [r.id for r in found.rows]
    if len(set(ids)) != len(ids):
        raise AssertionError(f"rows of {name} share an id: {sorted({i for i in ids if ids.count(i) > 1})}")
    return replace(found, quick=settings.quick, seed=settings.seed, seconds=time.perf_counter() - started)


def study_json(study: Study) -> dict[str, Any]:
    """What ``boresight study NAME --json`` prints."""
    return {
        "study": study.name,
        "quick": study.quick,
        "seed": study.seed,
        "rows": [
            {
                "id": r.id,
                "table": r.table,
                "row": r.row,
                "quantity": r.quantity,
                "unit": r.unit,
                "printed": r.printed,
                "ours": None if isinstance(r.ours, float) and not np.isfinite(r.ours) else r.ours,
                "bound": None if r.bound is None else {"low": r.bound.low, "high": r.bound.high},
                "holds": r.holds,
                "note": r.note,
            }
            for r in study.rows
        ],
    }
