"""``boresight correct`` as a user meets it: what is written, what is said, and what is refused."""

from __future__ import annotations

import io
import json
import shutil
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from barcelona import SENSORS
from boresight import flow
from boresight.calibration import load_calibration, save_calibration
from boresight.cli import main
from boresight.errors import InputError
from boresight.model import load_sensors
from boresight.reading import read, sha256_of
from boresight.simulation import write_demo
from boresight.writing.sidecar import Provenance, find_sidecar, sidecar_of


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def run(*arguments: str | Path) -> Done:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
        main([str(a) for a in arguments])
    return Done(int(end.value.code or 0), out.getvalue(), err.getvalue())


def mistake(*arguments: str | Path) -> str:
    """Run what must fail as a user's mistake; returns the one line that it says."""
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = [line for line in done.stderr.strip().splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0].removeprefix("boresight: ")


class Scene:
    """The demonstration's terminal radar, calibrated once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files = write_demo(folder / "demo", seed=1)
        self.radar = folder / "demo" / "terminal.ast"
        self.adsb = folder / "demo" / "adsb.ast"
        self.calibration = folder / "result" / "calibration.json"
        self.run = self.calibrate(self.radar)
        (folder / "result").mkdir()
        save_calibration(self.run.calibration, self.calibration)

    def calibrate(self, radar: Path) -> flow.Run:
        sensors = load_sensors(self.files.sensors)
        return flow.calibrate([radar], [self.adsb], sensors, date=self.files.date, model="atc")

    def options(self, *more: str | Path) -> list[str | Path]:
        return ["--calibration", self.calibration, "--sensors", self.files.sensors, "--date", str(self.files.date), *more]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("correct"))


@pytest.fixture(scope="module")
def corrected(scene: Scene) -> Path:
    """The terminal radar's recording, corrected."""
    out = scene.folder / "corrected" / "terminal.ast"
    out.parent.mkdir()
    flow.correct_files([scene.radar], scene.calibration, out, sensors=scene.files.sensors, date=scene.files.date, terms="all")
    return out


def test_the_corrected_recording_has_no_error_left_and_says_where_it_is_from(scene: Scene, corrected: Path) -> None:
    """Every term that was applied is zero within 2 sd; what is left of the truth is what the calibration was off by."""
    again = scene.calibrate(corrected)
    found = again.calibration
    assert len(found.terms) == len(scene.run.calibration.terms) >= 6
    assert (np.abs(found.value[0]) < 2 * found.sd[0]).all(), str(found)
    before, after = scene.run.calibration.sensors[0], found.sensors[0]
    assert abs(after.before.median_m - before.after.median_m) < 0.05 * before.after.median_m
    assert after.before.median_m < 0.5 * before.before.median_m
    (said,) = [w for w in found.warnings if "was corrected by" in w]
    assert "errors that remain" in said
    assert str(scene.calibration) in said
    assert "azimuth_bias" in said
    assert not any("was corrected by" in w for w in scene.run.calibration.warnings)


def test_the_sidecar_holds_inputs_calibration_terms_and_output(scene: Scene, corrected: Path) -> None:
    told = msgspec.json.decode(sidecar_of(corrected).read_bytes(), type=Provenance)
    assert told.output.sha256 == sha256_of(corrected)
    assert [i.sha256 for i in told.inputs] == [sha256_of(scene.radar)]
    assert told.calibration.sha256 == sha256_of(scene.calibration)
    calibration = load_calibration(scene.calibration)
    assert {t.term for t in told.terms} == {k.name for k in calibration.terms}
    assert {t.sensor for t in told.terms} == {"terminal"}
    assert not any(t.held for t in told.terms)
    assert told.version
    assert told.rounding["I048/140"].endswith(" s")


def test_a_recording_is_not_corrected_twice_not_even_by_another_name(scene: Scene, corrected: Path, tmp_path: Path) -> None:
    line = mistake("correct", corrected, *scene.options("--out", tmp_path / "twice.ast"))
    assert "was corrected already" in line
    assert str(scene.radar) in line
    # Renamed in its folder, and as a table too.
    folder = tmp_path / "moved"
    folder.mkdir()
    shutil.copy(corrected, folder / "monday.ast")
    shutil.copy(sidecar_of(corrected), folder / "any.boresight.json")
    (folder / "broken.boresight.json").write_text("{")
    assert "any.boresight.json" in mistake("correct", folder / "monday.ast", *scene.options("--out", tmp_path / "twice.parquet"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["moved"]
    # Another recording beside it is not meant.
    shutil.copy(scene.radar, folder / "tuesday.ast")
    assert find_sidecar(folder / "tuesday.ast") is None
    with pytest.raises(InputError, match="cannot be read"):
        find_sidecar(folder / "wednesday.ast")


def test_the_command_says_what_it_did(scene: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out.ast"
    done = run("correct", scene.radar, *scene.options("--out", out))
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "records corrected in ASTERIX data blocks; every other byte is as it was" in said
    assert "rounding added: I048/040 RHO" in said
    assert "applied: terminal azimuth_bias" in said
    assert "hold no measured polar position (north marks, status)" in said
    assert str(sidecar_of(out)) in said
    assert out.stat().st_size == scene.radar.stat().st_size
    # An existing output is kept, and so is its provenance.
    kept = out.read_bytes()
    assert "--overwrite" in mistake("correct", scene.radar, *scene.options("--out", out))
    out.unlink()
    assert "out.ast.boresight.json exists" in mistake("correct", scene.radar, *scene.options("--out", out))
    done = run("correct", scene.radar, *scene.options("--out", out, "--overwrite", "--json"))
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert out.read_bytes() == kept
    assert told["asterix"]["container"] == "raw"
    assert {"term", "value", "sd", "held", "unit", "sensor", "channel"} == set(told["terms"][0])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.ast", "out.ast.boresight.json"]


def test_held_terms_are_named_with_the_reason_and_terms_can_be_chosen(scene: Scene, tmp_path: Path) -> None:
    text = json.loads(scene.calibration.read_text())
    verdict = {
        "channel": "all", "term": "azimuth_cos", "decision": "hold", "why": "it gains 0.1 m", "gain_m": 0.1, "gain_low_m": None,
        "gain_high_m": None,
    }  # fmt: skip
    text["sensors"][0]["verdicts"] = [verdict]
    path = tmp_path / "held.json"
    path.write_text(json.dumps(text))
    held = flow.correct_files([scene.radar], path, tmp_path / "held.ast", date=scene.files.date)
    (one,) = [t for t in held.provenance.terms if t.held]
    assert one.term == "azimuth_cos"
    assert one.held.startswith(
        "the advice is to hold it: it gains 0.1 m; the other terms stay as they were found beside it (-0.0"
    )
    everything = flow.correct_files([scene.radar], path, tmp_path / "all.csv", date=scene.files.date, terms="all")
    assert not any(t.held for t in everything.provenance.terms)
    # This one is there, by 18 sd: the others are what they are beside it.
    value = {t.term: (t.value, t.sd) for t in held.provenance.terms}
    for t in everything.provenance.terms:
        assert t.term == "azimuth_cos" or value[t.term] == (t.value, t.sd)
    # One that may be zero: the others are what they are without it.
    k = [t["term"] for t in text["terms"]].index("azimuth_cos")
    text["value"][0][k] = 2 * text["sd"][0][k]
    path.write_text(json.dumps(text))
    zero = flow.correct_files([scene.radar], path, tmp_path / "zero.ast", date=scene.files.date)
    assert [t.held for t in zero.provenance.terms if t.held] == ["the advice is to hold it: it gains 0.1 m"]
    assert any(value[t.term][0] != t.value for t in zero.provenance.terms if not t.held)
    for t in zero.provenance.terms:
        assert t.held or (abs(value[t.term][0] - t.value) < 2 * t.sd and t.sd <= value[t.term][1] * (1 + 1e-9))
    options = ["--terms", "range_bias,time_offset", "--date", str(scene.files.date)]
    done = run("correct", scene.radar, "--calibration", path, "--out", tmp_path / "named.ast", *options)
    assert done.returncode == 0, done.stderr
    assert "held: terminal azimuth_bias: it was not asked for" in done.stdout
    line = mistake("correct", scene.radar, "--calibration", path, "--out", tmp_path / "no.ast", "--terms", "range_bais")
    assert "range_bais" in line
    assert "azimuth_cos" in line
    text["sensors"][0]["verdicts"] = [verdict | {"term": t["term"]} for t in text["terms"]]
    path.write_text(json.dumps(text))
    line = mistake("correct", scene.radar, "--calibration", path, "--out", tmp_path / "no.ast")
    assert "no term of" in line
    assert "--terms all" in line
    assert not (tmp_path / "no.ast").exists()


def test_calibrations_that_do_not_fit_are_refused(scene: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out.ast"
    other = mistake("correct", scene.folder / "demo" / "en-route.ast", *scene.options("--out", out))
    assert "the calibration has no sensor of these plots: they are of SAC/SIC 20/1, it is of terminal (20/2)" in other
    text = json.loads(scene.calibration.read_text())
    path = tmp_path / "calibration.json"

    def refused(**changes: object) -> str:
        path.write_text(json.dumps(text | changes))
        return mistake("correct", scene.radar, "--calibration", path, "--out", out)

    assert "its schema is 'boresight-calibration/9'" in refused(schema="boresight-calibration/9")
    terms = [dict(t) for t in text["terms"]]
    terms[0]["unit"] = "NM"
    assert f"the unit of {terms[0]['term']} is" in refused(terms=terms)
    terms = [dict(t) for t in text["terms"]]
    terms[0]["channel"] = "chain7"
    assert "a channel 'chain7'" in refused(terms=terms)
    assert "is no calibration" in mistake("correct", scene.radar, "--calibration", scene.radar, "--out", out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calibration.json"]


def test_outputs_that_make_no_sense_are_refused(scene: Scene, tmp_path: Path) -> None:
    plots = [scene.radar, scene.folder / "demo" / "en-route.ast"]
    assert "one of the inputs" in mistake("correct", scene.radar, *scene.options("--out", scene.radar))
    assert "one of the inputs" in mistake(
        "correct", scene.radar, *scene.options("--out", scene.radar.parent / "." / "terminal.ast")
    )
    assert "only a single recording" in mistake("correct", *plots, *scene.options("--out", tmp_path / "both.ast"))
    assert ".ast" in mistake("correct", scene.radar, *scene.options("--out", tmp_path / "out.kml"))
    table = tmp_path / "table.parquet"
    flow.correct_files([scene.radar], scene.calibration, table, date=scene.files.date)
    copy = tmp_path / "copy" / "table.parquet"
    copy.parent.mkdir()
    shutil.copy(table, copy)
    assert "is no ASTERIX" in mistake("correct", copy, *scene.options("--out", tmp_path / "out.ast"))
    # A Parquet file tells it without its sidecar.
    assert "was corrected already" in mistake("correct", copy, *scene.options("--out", tmp_path / "again.parquet"))
    assert "does not exist" in mistake("correct", scene.radar, *scene.options("--out", tmp_path / "nowhere" / "out.ast"))
    assert "was corrected already" in mistake("correct", table, *scene.options("--out", tmp_path / "again.parquet"))


def test_fixed_offsets_of_sensors_toml_are_out_of_the_stamps_and_said(scene: Scene, tmp_path: Path) -> None:
    sensors = tmp_path / "sensors.toml"
    text = scene.files.sensors.read_text()
    sensors.write_text(text.replace("sic = 2\n", "sic = 2\ntime_offset_s = 1.5\n"))
    assert "time_offset_s" in sensors.read_text()
    out = tmp_path / "out.ast"
    done = flow.correct_files([scene.radar], scene.calibration, out, sensors=sensors, date=scene.files.date, terms="range_bias")
    assert done.provenance.fixed_time_offset_s == {"20/2": 1.5}
    assert any("fixed time offset of 20/2" in w and "must not stand there" in w for w in done.warnings)
    plain, moved = (read(p, date=scene.files.date).plots.time_s for p in (scene.radar, out))
    assert np.allclose(plain - moved, 1.5)
    again = scene.calibrate(out)
    assert any("is out of its stamps already" in w for w in again.calibration.warnings)


@pytest.mark.real
def test_the_surface_radar_of_barcelona_against_multilateration(data: Path, tmp_path: Path) -> None:
    """The corrected recording is as good as the report claims, and has no term left."""
    lebl = data / "lebl-2016"
    radar, mlat = lebl / "smr_cat010_160510-lebl-220001.ast", lebl / "mlat_cat010_160510-lebl-220001.ast"
    (tmp_path / "sensors.toml").write_text(SENSORS)
    sensors = load_sensors(tmp_path / "sensors.toml")

    def calibrate(path: Path) -> flow.Run:
        return flow.calibrate([path], [mlat], sensors, model="surface")

    first = calibrate(radar)
    save_calibration(first.calibration, tmp_path / "calibration.json")
    out = tmp_path / "smr.ast"
    done = flow.correct_files([radar], tmp_path / "calibration.json", out, sensors=tmp_path / "sensors.toml", terms="all")
    assert done.encoded is not None
    assert done.encoded.changed == 62_097
    second = calibrate(out).calibration
    assert (np.abs(second.value[0]) < 2 * second.sd[0]).all(), str(second)
    raw, claimed = first.calibration.sensors[0].before, first.calibration.sensors[0].after
    reached = second.sensors[0].before
    assert raw.median_m > 12
    assert reached.median_m < 1.1 * claimed.median_m < 5.6
    assert reached.p95_m < raw.p95_m
