"""The whole chain on a simulated scene: files in, results out, and what users do wrong with good files."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from boresight import flow
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.model import Fixes, Plots, Recording, Source, load_sensors
from boresight.simulation import write_demo
from boresight.targets import targets_of


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, object]:
    folder = tmp_path_factory.mktemp("scene")
    return folder, write_demo(folder, seed=3)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, flow.Run]:
    folder = tmp_path_factory.mktemp("demo")
    return folder, flow.demo(folder, seed=2)


def test_demo_finds_the_true_errors(demo: tuple[Path, flow.Run]) -> None:
    folder, run = demo
    rows = [row for rows in run.truth.values() for row in rows]
    errors = np.array([(row.found - row.true) / row.sd for row in rows])
    assert len(rows) >= 8
    assert np.isfinite(errors).all()
    # One term in four hundred is beyond 3.5 sd by chance when the sd are right.
    assert (np.abs(errors) < 3.5).all()
    assert sum(abs(row.true) > 5 * row.sd for row in rows) >= 6
    page = (folder / "report.html").read_text()
    assert not re.search(r'(?:src|href)="https?:', page)
    stored = json.loads((folder / "calibration.json").read_text())
    assert stored["schema"] == "boresight-calibration/1"


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    a, b, c = (write_demo(tmp_path / name, seed) for name, seed in (("a", 1), ("b", 1), ("c", 2)))
    for first, second, third in zip([*a.plots, *a.reference], [*b.plots, *b.reference], [*c.plots, *c.reference], strict=True):
        assert first.read_bytes() == second.read_bytes()
        assert first.read_bytes() != third.read_bytes()


def test_an_earlier_result_is_kept(demo: tuple[Path, flow.Run], tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    shutil.copytree(demo[0], folder)
    first = {p.name: p.read_bytes() for p in folder.iterdir()}
    flow.demo(folder, seed=4)
    assert {p.name: p.read_bytes() for p in (folder / "earlier-1").iterdir()} == first
    assert (folder / "calibration.json").read_bytes() != first["calibration.json"]


def test_an_interrupted_demonstration_leaves_nothing_and_loses_nothing(
    demo: tuple[Path, flow.Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "demo"
    shutil.copytree(demo[0], folder)
    first = {p.name: p.read_bytes() for p in folder.iterdir()}

    def stopped(*_: object, **__: object) -> flow.Run:
        raise KeyboardInterrupt

    monkeypatch.setattr(flow, "calibrate", stopped)
    for out in (folder, tmp_path / "new" / "demo"):
        with pytest.raises(KeyboardInterrupt):
            flow.demo(out, seed=4)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == first
    assert not (tmp_path / "new").exists()


def test_exchanged_arguments_are_said(scene) -> None:
    _, files = scene
    with pytest.raises(NothingToDo, match="exchanged"):
        flow.calibrate(files.reference, files.plots, load_sensors(files.sensors), date=files.date)


def test_unknown_radar_is_named_with_its_codes(scene, tmp_path: Path) -> None:
    _, files = scene
    path = tmp_path / "sensors.toml"
    path.write_text('[[sensor]]\nname = "X"\nsac = 250\nsic = 251\nlat_deg = 0.0\nlon_deg = 0.0\nheight_m = 0.0\n')
    with pytest.raises(NothingToDo, match=r"no entry for any radar .*SAC/SIC \d+/\d+"):
        flow.calibrate(files.plots, files.reference, load_sensors(path), date=files.date)


def test_recordings_of_other_days_are_refused(scene, tmp_path: Path) -> None:
    """The same bytes read as of two dates cannot overlap: the distance in time is named."""
    _, files = scene
    import datetime

    from boresight.alignment import overlap
    from boresight.reading import read

    radar = read(files.plots[0], date=files.date)
    later = read(files.reference[0], date=files.date + datetime.timedelta(days=1))
    with pytest.raises(NothingToDo, match="24"):
        overlap(radar.plots, later.fixes)


def test_an_unwritable_folder_is_said(scene, tmp_path: Path) -> None:
    _, files = scene
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.raises(InputError, match="no folder"):
        flow.calibrate(files.plots, files.reference, load_sensors(files.sensors), date=files.date, out=blocked / "out")


def test_options_that_make_no_sense_are_told_before_anything_is_read(scene, tmp_path: Path) -> None:
    """The recordings named here do not exist: whoever reads first complains of that instead."""
    _, files = scene
    sensors = load_sensors(files.sensors)
    nowhere = tmp_path / "nowhere.ast"
    with pytest.raises(SettingsError, match="no term or model named 'foo'"):
        flow.calibrate([nowhere], [nowhere], sensors, model="foo")
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.raises(InputError, match="no folder"):
        flow.calibrate([nowhere], [nowhere], sensors, out=blocked)
    with pytest.raises(InputError, match=r"nowhere\.ast"):
        flow.calibrate([nowhere], [nowhere], sensors, out=tmp_path / "new" / "out")
    assert not (tmp_path / "new").exists()
    with pytest.raises(SettingsError, match="-1 is no seed"):
        flow.demo(tmp_path / "demo", seed=-1)
    assert not (tmp_path / "demo").exists()


def test_receivers_that_say_no_name_are_told_apart_by_their_files() -> None:
    """Two satellite receivers at one time are two targets; one receiver's next file goes on with it, and names count."""

    def file(begin: float, **columns: int) -> Fixes:
        return Fixes(
            time_s=begin + np.arange(5.0), source=np.full(5, 65537), track=np.zeros(5),
            latitude_rad=np.full(5, 0.7), longitude_rad=np.full(5, 0.1), **{k: np.full(5, v) for k, v in columns.items()},
        )  # fmt: skip

    def count(*files: Fixes) -> int:
        return len(np.unique(targets_of(Fixes.concat(flow._apart(files)))))

    assert count(file(0.0), file(0.0)) == 2
    assert count(file(0.0), file(2.0), file(1.0)) == 3
    assert count(file(0.0), file(5.0)) == 1
    assert count(file(0.0, mode_s=0xABCDEF), file(0.0, mode_s=0xABCDEF)) == 1


def test_a_file_given_twice_is_read_once(scene) -> None:
    _, files = scene
    sensors = load_sensors(files.sensors)
    once = flow.calibrate(files.plots[:1], files.reference, sensors, date=files.date)
    twice = flow.calibrate([*files.plots[:1], *files.plots[:1]], files.reference, sensors, date=files.date)
    np.testing.assert_array_equal(once.calibration.value, twice.calibration.value)
    assert len(twice.calibration.inputs) == len(once.calibration.inputs)
    assert any("given twice" in text for text in twice.calibration.warnings)


def recording(path: str, *parts: tuple[Source, int]) -> Recording:
    """A recording of sources with so many positions each."""
    source = np.concatenate([np.full(n, s.id, np.int32) for s, n in parts])
    return Recording(
        path=path, plots=Plots(), fixes=Fixes(time_s=np.arange(float(len(source))), source=source), damaged=(), warnings=(),
        sources=tuple(s for s, _ in parts), by_category={}, offset=np.arange(len(source)),
    )  # fmt: skip


def source(sic: int, category: int, plots: int) -> Source:
    return Source(
        sac=1, sic=sic, category=category, edition="", records=9, plots=plots, start_s=0.0, end_s=1.0, targets=1
    )  # fmt: skip


def test_a_radar_is_no_reference_for_itself() -> None:
    radar, station = source(7, 10, plots=5), source(9, 21, plots=0)
    measured = Plots(time_s=np.zeros(3), sensor=np.full(3, radar.id, np.int32))
    warnings: list[str] = []
    with pytest.raises(NothingToDo, match="its own reference"):
        flow._others([recording("smr.ast", (radar, 5))], measured, warnings)
    # In a capture of everything, what the radar did not make stays.
    left = flow._others([recording("all.pcap", (radar, 5), (station, 4))], measured, warnings)
    assert left.source.tolist() == [station.id] * 4
    assert len(warnings) == 1
    assert "5 of 9 positions in all.pcap" in warnings[0]
    # A station beside the radar that uses its SAC/SIC is not the radar.
    shared = source(7, 21, plots=0)
    assert len(flow._others([recording("adsb.ast", (shared, 6))], measured, warnings)) == 6
    assert len(flow._others([recording("other.ast", (source(8, 10, plots=2), 3))], measured, warnings)) == 3
    assert len(warnings) == 1


def test_results_appear_together_or_not_at_all(scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import boresight.report

    _, files = scene
    sensors = load_sensors(files.sensors)
    out = tmp_path / "new" / "out"
    run = flow.calibrate(files.plots[:1], files.reference, sensors, date=files.date, out=out)
    names = ["calibration.json", "report.html", "residuals.parquet", "run.json"]
    first = {name: (out / name).read_bytes() for name in names}

    def stops(problem: BaseException) -> Callable[..., None]:
        def stopped(path: Path, *_: object, **__: object) -> None:
            path.write_text("half a page")
            raise problem

        return stopped

    for problem, said in (
        (OSError(28, "No space left on device"), InputError),
        (InputError("cannot be written", path="report.html"), InputError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):
        monkeypatch.setattr(boresight.report, "write_report", stops(problem))
        with pytest.raises(said):
            flow.write_results(run, sensors, out)
        assert sorted(p.name for p in out.iterdir()) == names
        assert {name: (out / name).read_bytes() for name in names} == first
        with pytest.raises(said):
            flow.write_results(run, sensors, tmp_path / "never" / "was")
        assert not (tmp_path / "never").exists()


def test_a_site_that_the_stream_contradicts_is_said(scene, tmp_path: Path) -> None:
    """The radar's own messages (I034/120) say where it stands; a typing mistake of a hundredth of a degree is seen."""
    _, files = scene
    text = files.sensors.read_text()
    first = re.search(r"lat_deg = ([\d.]+)", text)
    assert first is not None
    path = tmp_path / "sensors.toml"
    path.write_text(text.replace(first[0], f"lat_deg = {float(first[1]) + 0.01}", 1))
    run = flow.calibrate(files.plots, files.reference, load_sensors(path), date=files.date)
    assert any("stands 1,1" in w and "away from where sensors.toml puts it" in w for w in run.calibration.warnings)
    right = flow.calibrate(files.plots, files.reference, load_sensors(files.sensors), date=files.date)
    assert not any("away from where" in w for w in right.calibration.warnings)
