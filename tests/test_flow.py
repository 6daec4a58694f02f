"""The whole chain on a simulated scene: files in, results out, and what users do wrong with good files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from boresight import flow
from boresight.errors import InputError, NothingToDo
from boresight.model import load_sensors
from boresight.simulation import write_demo


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, object]:
    folder = tmp_path_factory.mktemp("scene")
    return folder, write_demo(folder, seed=3)


def test_demo_finds_the_true_errors(tmp_path: Path) -> None:
    run = flow.demo(tmp_path, seed=2)
    rows = [row for rows in run.truth.values() for row in rows]
    errors = np.array([(row.found - row.true) / row.sd for row in rows])
    assert len(rows) >= 8
    assert np.isfinite(errors).all()
    # One term in four hundred is beyond 3.5 sd by chance when the sd are right.
    assert (np.abs(errors) < 3.5).all()
    assert sum(abs(row.true) > 5 * row.sd for row in rows) >= 6
    page = (tmp_path / "report.html").read_text()
    assert not re.search(r'(?:src|href)="https?:', page)
    stored = json.loads((tmp_path / "calibration.json").read_text())
    assert stored["schema"] == "boresight-calibration/1"


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    a, b, c = (write_demo(tmp_path / name, seed) for name, seed in (("a", 1), ("b", 1), ("c", 2)))
    for first, second, third in zip([*a.plots, *a.reference], [*b.plots, *b.reference], [*c.plots, *c.reference], strict=True):
        assert first.read_bytes() == second.read_bytes()
        assert first.read_bytes() != third.read_bytes()


def test_an_earlier_result_is_kept(tmp_path: Path) -> None:
    flow.demo(tmp_path, seed=2)
    first = (tmp_path / "calibration.json").read_bytes()
    flow.demo(tmp_path, seed=4)
    assert (tmp_path / "earlier-1" / "calibration.json").read_bytes() == first
    assert (tmp_path / "calibration.json").read_bytes() != first


def test_exchanged_arguments_are_said(scene) -> None:  # type: ignore[no-untyped-def]
    _, files = scene
    with pytest.raises(NothingToDo, match="exchanged"):
        flow.calibrate(files.reference, files.plots, load_sensors(files.sensors), date=files.date)


def test_unknown_radar_is_named_with_its_codes(scene, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, files = scene
    path = tmp_path / "sensors.toml"
    path.write_text('[[sensor]]\nname = "X"\nsac = 250\nsic = 251\nlat_deg = 0.0\nlon_deg = 0.0\nheight_m = 0.0\n')
    with pytest.raises(NothingToDo, match=r"no entry for any radar .*SAC/SIC \d+/\d+"):
        flow.calibrate(files.plots, files.reference, load_sensors(path), date=files.date)


def test_recordings_of_other_days_are_refused(scene, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The same bytes read as of two dates cannot overlap: the distance in time is named."""
    _, files = scene
    import datetime

    from boresight.alignment import overlap
    from boresight.reading import read

    radar = read(files.plots[0], date=files.date)
    later = read(files.reference[0], date=files.date + datetime.timedelta(days=1))
    with pytest.raises(NothingToDo, match="24"):
        overlap(radar.plots, later.fixes)


def test_an_unwritable_folder_is_said(scene, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, files = scene
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.raises(InputError, match="no folder"):
        flow.calibrate(files.plots, files.reference, load_sensors(files.sensors), date=files.date, out=blocked / "out")
