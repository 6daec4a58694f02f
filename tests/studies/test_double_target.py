"""The quick form of the study of two targets: its bounds hold with several seeds, every cell of the paper is there."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from boresight.studies import Settings, Study, run_study, study_json, write_study
from boresight.studies.double_target import SCANS, scene
from boresight.studies.page import bound_text, study_text


@pytest.fixture(scope="module")
def study() -> Study:
    return run_study("double-target", Settings(quick=True, seed=3))


def test_every_bound_holds(study: Study) -> None:
    assert not study.failed, "\n".join(f"{r.id}: {r.ours} is not within {bound_text(r.bound)}" for r in study.failed)
    assert sum(r.bound is not None for r in study.rows) >= 100


@pytest.mark.parametrize(
    ("table", "cells"),
    [("Table 1.", 10), ("Table 2.", 10), ("Table 3.", 6), ("Table 4.", 6), ("Table 5.", 12), ("Table 6.", 12)],
)
def test_every_printed_cell_is_there_in_both_scenes(study: Study, table: str, cells: int) -> None:
    printed = [r for r in study.rows if r.table.startswith(table) and r.printed is not None and "≤" not in r.row]
    assert len(printed) == 2 * cells


def test_printed_numbers_are_the_papers(study: Study) -> None:
    by_id = {r.id: r.printed for r in study.rows}
    assert by_id["t2-original-range-as-stated"] == 30.847
    assert by_id["t3-first-order-azimuth-as-stated"] == 0.001559
    assert by_id["t4-second-order-azimuth-as-recorded"] == 0.0893
    assert by_id["t5-second-order-azimuth-as-stated"] == 38.773
    assert by_id["t6-gain-first-order-azimuth-as-stated"] == 32.07


def test_the_scene_holds_as_many_scans_as_the_papers_distance_tells() -> None:
    lake = scene()
    assert len(lake.rows) == SCANS
    assert pytest.approx(44.181, abs=5e-4) == 2 * SCANS**0.5
    for boat in lake.boats:
        assert 900 < boat.place.range_m.min() < boat.place.range_m.max() < 2300
        # Seven legs, and the turns between them.
        assert sum(not s.curved for s in boat.segments) == 7


def test_page_and_json(study: Study, tmp_path: Path) -> None:
    out = json.loads(msgspec.json.encode(study_json(study)))
    assert out == json.loads(json.dumps(study_json(study), allow_nan=False))
    assert out["study"] == "double-target"
    page = write_study(study, tmp_path / "study.html").read_text()
    assert page.count("<figure") == len(study.figures) == 5
    assert all(f'id="{r.id}"' in page for r in study.rows)
    assert "FAILS" not in study_text(study)


def test_same_seed_same_numbers(study: Study) -> None:
    again = run_study("double-target", Settings(quick=True, seed=3))
    assert [r.ours for r in again.rows] == [r.ours for r in study.rows]
    assert [f.svg for f in again.figures] == [f.svg for f in study.figures]
