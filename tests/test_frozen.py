"""Frozen results: made again they are the same; what was moved is found, what was changed is named."""

from __future__ import annotations

import dataclasses
import inspect
import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from boresight import flow
from boresight.assessment.requirement import Figure, Requirement
from boresight.calibration import load_calibration, save_calibration
from boresight.cli import main
from boresight.errors import InputError
from boresight.frozen import SCHEMA, Settings, load_frozen, save_frozen
from boresight.model import Sensors, load_sensors
from boresight.simulation import Adsb, Radar, Scenario, Traffic, simulate
from boresight.simulation.files import write_scene

REQUIREMENT = Requirement(
    name="Spec",
    source="here",
    edition="1",
    figure=(Figure(clause="1", quantity="range_bias", max=100.0, unit="m", kinds=("mode_s",)),),
)

# The same as a file.
TOML = """
name = "Spec"
source = "here"
edition = "1"
[[figure]]
clause = "1"
quantity = "range_bias"
max = 100.0
unit = "m"
kinds = ["mode_s"]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings in `in` and the result in `out`."""
    folder = tmp_path_factory.mktemp("frozen")
    scene = Scenario(
        duration_s=900.0,
        traffic=Traffic(aircraft=12, radius_m=90e3, arrivals=0.0, departures=0.0),
        radar=(Radar(name="R", sac=20, sic=1, lat_deg=41.3, lon_deg=2.1, max_range_m=120e3, errors={"range_bias": 50.0}),),
        adsb=Adsb(),
    )
    files = write_scene(simulate(scene, 1), folder / "in")
    flow.calibrate(
        files.plots, files.reference, load_sensors(files.sensors), model="range_bias,azimuth_bias", date=files.date,
        editions={21: "2.4"}, out=folder / "out", requirement=REQUIREMENT,
    )  # fmt: skip
    return folder


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "all")
    return tmp_path / "all"


def test_made_again_it_is_the_same_to_the_last_bit(made: Path) -> None:
    found = flow.verify(made / "out")
    assert (found.same, found.exact) == (True, True)
    assert (found.differences, found.changed, dict(found.versions)) == ((), (), {})
    (verdict,) = json.loads((made / "out" / "conformity.json").read_text())["conformity"]
    assert (verdict["verdict"], verdict["clause"]) == ("pass", "1")


def test_every_option_is_frozen() -> None:
    """An option that changes a result but is not frozen would make every verification of it wrong: add it to `Settings`."""
    options = set(inspect.signature(flow.calibrate).parameters) - {"plots", "reference", "out", "progress"}
    assert options == set(Settings.__struct_fields__)


def test_recordings_are_found_where_they_went(made: Path, copy: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    frozen = load_frozen(copy / "out")
    gone = msgspec.structs.replace(
        frozen,
        plots=tuple(msgspec.structs.replace(g, path=f"nowhere/{Path(g.path).name}") for g in frozen.plots),
        reference=tuple(msgspec.structs.replace(g, path=f"nowhere/{Path(g.path).name}") for g in frozen.reference),
    )
    (copy / "out" / "run.json").write_bytes(msgspec.json.encode(gone))
    # Beside the result as before; then within it; then anywhere that is named.
    assert flow.verify(copy / "out").exact
    (copy / "in").rename(copy / "moved")
    with pytest.raises(InputError, match=r"nowhere/R\.ast is missing; nowhere/adsb\.ast is missing.*--inputs"):
        flow.verify(copy / "out")
    assert flow.verify(copy / "out", inputs=copy / "moved").exact


def test_inputs_that_are_not_the_same_are_named(copy: Path) -> None:
    frozen = load_frozen(copy / "out")
    here = tuple(
        msgspec.structs.replace(g, path=str(copy / "in" / Path(g.path).name)) for g in (*frozen.plots, *frozen.reference)
    )
    frozen = msgspec.structs.replace(frozen, plots=here[:1], reference=here[1:])
    (copy / "out" / "run.json").write_bytes(msgspec.json.encode(frozen))
    data = bytearray((copy / "in" / "adsb.ast").read_bytes())
    data[100] ^= 1
    (copy / "in" / "adsb.ast").write_bytes(data)
    with pytest.raises(InputError, match=r"cannot be made again: .*adsb\.ast has changed") as caught:
        flow.verify(copy / "out")
    assert "R.ast" not in str(caught.value)


@pytest.mark.parametrize("how", ["value", "last digit", "covariance", "residuals"])
def test_a_result_that_was_changed_by_hand_is_different(copy: Path, how: str) -> None:
    path = copy / "out" / "calibration.json"
    found = load_calibration(path)
    if how == "value":
        save_calibration(dataclasses.replace(found, value=found.value + 0.1 * found.sd), path)
    elif how == "covariance":
        save_calibration(dataclasses.replace(found, covariance=1.1 * found.covariance), path)
    elif how == "last digit":
        save_calibration(dataclasses.replace(found, value=np.nextafter(found.value, np.inf)), path)
    else:
        import duckdb

        path = copy / "out" / "residuals.parquet"
        changed = "SELECT * REPLACE (range_after_m + 1.0 AS range_after_m)"
        duckdb.execute(f"COPY ({changed} FROM read_parquet('{path}')) TO '{copy}/new.parquet' (FORMAT parquet)")
        (copy / "new.parquet").replace(path)
    seen = flow.verify(copy / "out")
    assert not seen.same
    assert seen.changed == (("residuals.parquet",) if how == "residuals" else ("calibration.json",))
    said = {"value": "range_bias of 20/1 by 0.1 of its sd", "covariance": "the covariance", "residuals": "range_after_m"}
    # Within the tolerance nothing differs, but the file is not the one that was written.
    assert (how == "last digit") == (not seen.differences)
    assert how == "last digit" or any(said[how] in text for text in seen.differences)


def test_the_commands_and_their_exit_codes(made: Path, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run(*arguments: str | Path) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stopped:
            main([str(a) for a in arguments])
        said = capsys.readouterr()
        return int(str(stopped.value.code)), said.out, said.err

    code, out, _ = run("verify", made / "out")
    assert (code, "the same, bit for bit" in out) == (0, True)
    path = copy / "out" / "calibration.json"
    found = load_calibration(path)
    save_calibration(dataclasses.replace(found, value=found.value + found.sd), path)
    code, out, _ = run("verify", copy / "out", "--json")
    assert (code, json.loads(out)["changed"]) == (1, ["calibration.json"])
    code, out, err = run("verify", tmp_path)
    assert (code, out, len(err.splitlines())) == (2, "", 1)

    (tmp_path / "r.toml").write_text(TOML)
    code, out, _ = run(
        "assess", "requirement", made / "out", "--requirement", tmp_path / "r.toml", "--json", "--out", tmp_path / "c.json"
    )
    assert (code, json.loads(out)) == (0, json.loads((tmp_path / "c.json").read_text()))
    assert json.loads(out) == json.loads((made / "out" / "conformity.json").read_text())
    code, _, err = run("assess", "requirement", made / "out", "--requirement", tmp_path / "r.toml", "--out", tmp_path / "c.json")
    assert (code, "exists" in err) == (2, True)
    code, _, err = run("assess", "requirement", made / "out", "--requirement", "imo-msc192-79")
    assert (code, "no figure for the kinds" in err) == (2, True)
    code, _, err = run("assess", "requirement", tmp_path / "none", "--requirement", tmp_path / "r.toml")
    assert (code, "does not exist" in err) == (2, True)


def test_other_versions_are_said(copy: Path) -> None:
    frozen = load_frozen(copy / "out")
    (copy / "out" / "run.json").write_bytes(
        msgspec.json.encode(msgspec.structs.replace(frozen, versions=frozen.versions | {"numpy": "1.0"}))
    )
    found = flow.verify(copy / "out")
    assert found.versions["numpy"] == ("1.0", np.__version__)
    assert found.same


def test_folders_without_a_whole_result(copy: Path, tmp_path: Path) -> None:
    out = copy / "out"
    for path, said in (
        (tmp_path / "none", "does not exist"),
        (out / "run.json", "is no folder"),
        (copy, "holds no result"),
    ):
        with pytest.raises(InputError, match=said):
            flow.verify(path)
    whole = (out / "run.json").read_bytes()
    for text, said in (
        (b"{", "is damaged"),
        (b"\xff", "is damaged"),
        (b'{"schema": "boresight-run/9"}', "boresight-run/9"),
        (f'{{"schema": "{SCHEMA}"}}'.encode(), "is damaged"),
        (whole.replace(b'"settings"', b'"sittings"'), "is damaged"),
    ):
        (out / "run.json").write_bytes(text)
        with pytest.raises(InputError, match=said):
            flow.verify(out)
    (out / "run.json").unlink()
    with pytest.raises(InputError, match=r"no run\.json"):
        flow.verify(out)
    (out / "run.json").write_bytes(whole)
    (out / "calibration.json").write_text('{"schema": "boresight-calibration/0"}')
    with pytest.raises(InputError, match="boresight-calibration/0"):
        flow.verify(out)
    (out / "calibration.json").unlink()
    with pytest.raises(InputError, match=r"calibration\.json"):
        flow.verify(out)
    shutil.copy(copy.parent / "all" / "out" / "report.html", out / "calibration.json")
    with pytest.raises(InputError, match="is no calibration"):
        flow.verify(out)


def test_a_folder_of_files_is_one_recording(tmp_path: Path) -> None:
    """Each file of it is frozen by itself; one more or one less is named."""
    from boresight.calibration import Input
    from boresight.frozen import find_inputs, freeze
    from boresight.reading import sha256_of

    folder, out = tmp_path / "many", tmp_path / "out"
    folder.mkdir()
    out.mkdir()
    for name in ("a", "b"):
        (folder / name).write_text(name)
    for name in ("calibration.json", "residuals.parquet"):
        (out / name).write_text("")
    inputs = [Input(str(p), sha256_of(p), 1) for p in sorted(folder.iterdir())]
    settings = Settings(sensors=Sensors(()), model="auto", date=None, editions={}, truth={}, title="", requirement=None)
    save_frozen(freeze([folder], [folder], settings, [*inputs, *inputs]), out, out)
    frozen = load_frozen(out)
    assert find_inputs(frozen, out, None) == ([folder], [folder])
    (folder / "c").write_text("c")
    (folder / "a").unlink()
    (folder / "b").write_text("B")
    with pytest.raises(InputError, match=r"a is missing; .*c is new; .*b has changed"):
        find_inputs(frozen, out, None)
