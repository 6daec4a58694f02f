"""``boresight simulate``: mistakes with lines, files that appear together, truth that fits the files, errors found again."""

from __future__ import annotations

import datetime
import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any, get_args, get_type_hints

import duckdb
import msgspec
import numpy as np
import pytest

from boresight._files import together
from boresight.cli import main
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.measure import wrap_rad
from boresight.model import load_sensors
from boresight.reading import read
from boresight.simulation import Radar, Scenario, Traffic, load_scenario, simulate
from boresight.simulation.files import lost_in, scene_files, write_scene
from boresight.simulation.scenario import lint_scenario

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
SMALL = """
duration_s = 300.0
[traffic]
aircraft = 6
lat_deg = 50.0
lon_deg = 8.5
radius_m = 60e3
arrivals = 0.0
departures = 0.0
[[radar]]
name = "one"
sac = 1
sic = 2
lat_deg = 50.1
lon_deg = 8.6
errors = { range_bias = 80.0, azimuth_bias = { value = 0.2, ramp_per_h = 1.0 } }
[adsb]
"""


def run(*arguments: str | Path) -> int:
    """Run the command line in this process and return its exit code."""
    with pytest.raises(SystemExit) as done:
        main([str(a) for a in arguments])
    code = done.value.code
    assert isinstance(code, int)
    return code


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a table; what is empty is NaN, or -1."""
    columns = duckdb.sql(f"FROM '{path}'").fetchnumpy()
    return {
        k: np.ma.filled(v, -1 if v.dtype.kind in "iu" else np.nan) if v.dtype.kind in "iuf" else v for k, v in columns.items()
    }


def test_check_tells_all_mistakes_and_writes_nothing(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("simulate", small, "--check") == 0
    assert capsys.readouterr().out == f"{small}: fine: 1 radar, 6 aircraft, ADS-B, 300 s\n"
    small.write_text(SMALL.replace("sic = 2", "sic = 2000").replace("aircraft = 6", "aircrafts = 6"))
    assert run("simulate", small, "--check") == 2
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[0] for line in lines] == [f"{small}:4", f"{small}:13"]
    assert run("simulate", small, "--check", "--json") == 2
    view = json.loads(capsys.readouterr().out)
    assert [m["line"] for m in view["mistakes"]] == [4, 13]
    assert not view["fine"]
    assert run("simulate", small, "--out", small.parent / "out") == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(f"boresight: {small}: 2 mistakes\n{small}:4: ")
    assert not (small.parent / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "--out"),
        (("--out", "x", "--seed", "-1"), "--seed"),
        (("--out", "x", "--duration", "3"), "--duration 3"),
        (("--out", "x", "--format", "pdf"), "format"),
        (("--out", "x", "--format", "nmea"), "--format: NMEA logs are those of marine radars, and the scene has none"),
    ],
)
def test_options_that_make_no_sense(
    small: Path, options: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(small.parent)
    assert run("simulate", small, *options) == 2
    said = capsys.readouterr().err.strip()
    assert says in said
    assert "\n" not in said
    assert not Path("x").exists()


def test_a_scene_without_any_plot_names_why(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cases = {
        "m away, not": ("lon_deg = 8.6", "lon_deg = 20.0"),
        "stand at elevations": ("lon_deg = 8.6", "lon_deg = 8.6\nmin_elevation_deg = 85.0\nmax_elevation_deg = 86.0"),
        "an outage covers all": ("[adsb]", "[radar.gaps]\noutage_s = [[-10.0, 400.0]]\n[adsb]"),
        "detects too little": ("lon_deg = 8.6", "lon_deg = 8.6\ndetection = 0.00001"),
    }
    for why, (old, new) in cases.items():
        small.write_text(SMALL.replace(old, new))
        assert run("simulate", small, "--out", small.parent / "out") == 2
        said = capsys.readouterr().err.splitlines()[-1]
        assert said.startswith("boresight: scene: no plot is simulated: one: "), said
        assert why in said
        assert not (small.parent / "out").exists()
    with pytest.raises(NothingToDo, match="there is no radar"):
        write_scene(simulate(Scenario(traffic=Traffic(aircraft=2, arrivals=0, departures=0)), 1), small.parent / "out")


def test_a_radar_that_sees_nothing_has_no_file(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far = '[[radar]]\nname = "far"\nsac = 1\nsic = 3\nlat_deg = 10.0\nlon_deg = 8.6\n[adsb]'
    small.write_text(SMALL.replace("[adsb]", far))
    out = small.parent / "out"
    assert run("simulate", small, "--out", out) == 0
    said = capsys.readouterr()
    assert "warning: far has no file: the aircraft are" in said.err
    assert f"{small}:17: radar 2 ('far'): max_range_m" in said.err
    assert "far.ast" not in said.out
    assert not (out / "far.ast").exists()
    assert [s.name for s in load_sensors(out / "sensors.toml")] == ["one", "far"]


def test_what_was_there_is_kept_and_the_same_seed_gives_the_same_bytes(small: Path) -> None:
    out = small.parent / "out"
    for seed in ("1", "1", "2"):
        assert run("simulate", small, "--out", out, "--seed", seed, "--json") == 0
    names = {p.name for p in out.iterdir() if p.is_file()}
    assert names == set(scene_files(load_scenario(small), tables=True))
    for name in names:
        first, again, other = (p.read_bytes() for p in (out / "earlier-1" / name, out / "earlier-2" / name, out / name))
        assert first == again, name
        assert first != other or name == "sensors.toml" or name == "truth_errors.csv", name


def test_a_run_that_fails_leaves_nothing(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted, or on a full disk: no folder, or the folder as it was."""
    scene = simulate(load_scenario(small), 1)
    new, old = small.parent / "a" / "new", small.parent / "old"
    write_scene(scene, old)
    before = {p.name: p.read_bytes() for p in old.iterdir()}
    for error, raised in ((KeyboardInterrupt(), KeyboardInterrupt), (OSError(28, "No space left on device"), InputError)):

        def broken(*_: object, error: BaseException = error) -> None:
            raise error

        monkeypatch.setattr("boresight.simulation.files.write_text", broken)
        for folder in (new, old):
            with pytest.raises(raised):
                write_scene(scene, folder)
        assert not (small.parent / "a").exists()
        assert {p.name: p.read_bytes() for p in old.iterdir()} == before


def test_files_appear_together_or_not_at_all(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    with together(folder, ["a"]) as beside:
        (beside / "a").write_text("1")
        assert not (folder / "a").exists()
    with together(folder, ["a", "gone"]) as beside:
        (beside / "b").write_text("2")
    assert {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()} == {"b", "earlier-1/a"}
    with pytest.raises(InputError, match="file"), together(folder / "b" / "c", []):
        pass


def near(found: np.ndarray, given: np.ndarray, atol: float) -> None:
    np.testing.assert_allclose(found, given, rtol=0, atol=atol)


def check_truth(out: Path) -> None:
    """The truth tables fit the recordings: row by row, stamp = true time + late, measured = true + errors + noise."""
    truth = json.loads((out / "truth.json").read_text())
    plots, sensors = table(out / "truth_plots.parquet"), load_sensors(out / "sensors.toml")
    day = datetime.date.fromisoformat(truth["start"][:10])
    for file in sorted(set(plots["file"].tolist())):
        rows = plots["file"] == file
        recording = read(out / file, date=day)
        found = recording.plots
        assert not recording.damaged
        assert len(found) == rows.sum() == truth["files"][file]["rows"]
        assert plots["plot"][rows].tolist() == list(range(len(found)))
        stamp = plots["true_time"][rows].astype("datetime64[us]").astype(np.int64) / 1e6 + plots["late_s"][rows]
        near(found.time_s, stamp, 2e-3 if file.endswith(".nmea") else 2e-6)
        known = np.asarray(plots["target"][rows]) >= 0
        range_m = (plots["range_m"] + plots["error_range_m"] + plots["noise_range_m"])[rows]
        azimuth = np.radians((plots["azimuth_deg"] + plots["error_azimuth_deg"] + plots["noise_azimuth_deg"])[rows])
        # Beside errors and noise: the transponders' delays (sd 10 m) and the steps of the formats.
        near(found.range_m[known], range_m[known], 50.0)
        near(wrap_rad(found.azimuth_rad - azimuth)[known], np.zeros(known.sum()), np.radians(360 / 65536))
        assert (np.median(np.abs(found.range_m - range_m)[known])) < 12.0
        sensor = sensors.find(int(found.sensor[0]))
        assert sensor is not None
        assert sensor.name == file.rpartition(".")[0]
    targets = table(out / "truth_targets.parquet")
    assert set(targets["kind"].tolist()) <= {"aircraft", "ship"}
    assert np.isfinite(targets["latitude_deg"].astype(float)).all()
    values = table(out / "truth_errors.csv")
    assert set(values["sensor_name"].tolist()) == set(truth["sensors"])
    for name, terms in truth["sensors"].items():
        assert set(values["term"][values["sensor_name"] == name].tolist()) == set(terms)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_every_example_runs(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lint = lint_scenario(path)
    assert lint.mistakes == lint.warnings == ()
    out = tmp_path / "out"
    assert run("simulate", path, "--out", out, "--duration", "240", "--json") == 0
    view = json.loads(capsys.readouterr().out)
    assert view["empty"] == {}
    assert all(count["rows"] > 50 for count in view["files"].values())
    check_truth(out)


@pytest.mark.parametrize("form", ["asterix", "table"])
def test_a_sailing_radar_in_other_formats(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (harbour,) = (p for p in EXAMPLES if p.stem == "harbour")
    assert run("simulate", harbour, "--out", tmp_path / "out", "--duration", "120", "--format", form, "--json") == 0
    view = json.loads(capsys.readouterr().out)
    way = tmp_path / "out" / "ship-own-ship.parquet"
    assert str(way) in view["calibrate"]
    assert len(read(way).platform) > 100
    check_truth(tmp_path / "out")


def test_an_elevation_goes_into_a_table_and_one_log_is_enough(tmp_path: Path) -> None:
    plain = {"sac": 1, "lat_deg": 41.3, "lon_deg": 2.1}
    quiet = Traffic(aircraft=4, arrivals=0.0, departures=0.0, radius_m=60e3)
    scene = Scenario(duration_s=120.0, traffic=quiet, radar=(Radar(name="up", sic=1, elevation_sd_deg=0.1, **plain),))
    files = write_scene(simulate(scene, 1), tmp_path / "a")
    assert [p.name for p in files.plots] == ["up.parquet"]
    assert np.isfinite(read(files.plots[0]).plots.elevation_rad).all()
    assert files.command("x") == ()
    assert not lost_in(scene, "auto")
    (lost,) = lost_in(scene, "asterix")
    assert lost.startswith("up: its elevations are not in up.ast")
    logs = load_scenario(next(p for p in EXAMPLES if p.stem == "harbour"))
    with pytest.raises(SettingsError, match="only one radar can have one, not ship, quay"):
        write_scene(simulate(Scenario(**{k: getattr(logs, k) for k in logs.__struct_fields__} | {"duration_s": 30.0}), 1),
                    tmp_path / "b", form="nmea")  # fmt: skip


def found_again(path: Path, out: Path, capsys: pytest.CaptureFixture[str], worst_sd: float = 4.0) -> None:
    """Simulate, run the very command that is printed, and compare what is found with the truth."""
    assert run("simulate", path, "--out", out) == 0
    said = capsys.readouterr().out
    words = shlex.split(said.splitlines()[-1])
    assert words[0] == "boresight"
    assert run(*words[1:]) == 0
    found: dict[str, Any] = json.loads((out / "result" / "calibration.json").read_text())
    truth = json.loads((out / "truth.json").read_text())["sensors"]
    names = {(s["sensor"]): s["name"] for s in found["sensors"]}
    capsys.readouterr()
    compared = 0
    for term, value, sd in zip(found["terms"], found["value"][0], found["sd"][0], strict=True):
        name = term["term"] + ("" if term["channel"] == "all" else f"@{term['channel']}")
        told = truth[names[term["sensor"]]].get(name, {"true": 0.0})
        if "drift" not in told:
            assert abs(value - told["true"]) <= worst_sd * sd, (names[term["sensor"]], name, value, sd, told)
            compared += 1
    assert compared >= 2


def test_the_printed_command_finds_the_errors_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (lake,) = (p for p in EXAMPLES if p.stem == "lake")
    found_again(shutil.copy(lake, tmp_path / "lake.toml"), tmp_path / "out", capsys)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three-radars", "harbour", "drifting", "two-radars-at-one-place"])
def test_the_errors_of_every_example_are_found_again(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (path,) = (p for p in EXAMPLES if p.stem == name)
    found_again(path, tmp_path / "out", capsys)


PAGE = Path(__file__).parents[2] / "docs" / "simulate.md"


def structs_of(kind: Any, place: tuple[str, ...] = ()) -> dict[str, type]:
    """Every struct that a scenario is made of, by the path of keys that leads to it."""
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        found: dict[str, type] = {}
        for part in get_args(kind):
            found |= structs_of(part, place)
        return found
    found = {".".join(place) or "The scene": kind}
    for name, hint in get_type_hints(kind).items():
        found |= structs_of(hint, (*place, name))
    return found


def in_toml(value: object) -> str:
    """A default as one would write it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, datetime.datetime):
        return value.strftime("%Y-%m-%dT%H:%M:%SZ")
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{k}" = {v}' for k, v in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(list(value))


def test_every_key_is_on_the_page_with_its_default() -> None:
    sections = {title: body for title, body in re.findall(r"^### ([^\n]+)\n(.*?)(?=^#|\Z)", PAGE.read_text("utf-8"), re.S | re.M)}
    structs = structs_of(Scenario)
    assert set(sections) == set(structs)
    assert len(structs) >= 20
    for title, kind in structs.items():
        rows = [
            [c.strip() for c in line.strip("|").split("|")] for line in sections[title].splitlines() if line.startswith("| `")
        ]
        assert [row[0].strip("`") for row in rows] == list(kind.__struct_fields__), title
        for row, field in zip(rows, msgspec.structs.fields(kind), strict=True):
            assert row[3], (title, field.name)
            value = field.default_factory() if field.default_factory is not msgspec.NODEFAULT else field.default
            if field.required:
                assert row[2] == "needed", (title, row)
            elif value is None or value == "":
                assert row[2] == "", (title, row)
            elif isinstance(value, msgspec.Struct) or value in ((), {}):
                assert row[2] == ("as below" if isinstance(value, msgspec.Struct) else "none"), (title, row)
            else:
                shown = row[2].strip("`")
                same = str(value) if isinstance(value, int) and not isinstance(value, bool) else in_toml(value)
                assert shown == same, (title, row)
            for end, unit in (("_m", "m"), ("_deg", "deg"), ("_s", "s"), ("_mps", "m/s")):
                assert row[1] == unit or not field.name.endswith(end), (title, row)


def test_the_code_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text("utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.S | re.M):
        exec(compile(block, PAGE.name, "exec"), names)
    said = capsys.readouterr().out.splitlines()
    assert "plots of 12 aircraft" in said[0]
    # What is printed of the mistakes stands on the page.
    assert len(said) == 4
    assert all(f"    {line}\n" in text for line in said[2:])
    assert run("simulate", "scene.toml", "--check") == 0
    for path in EXAMPLES:
        assert f"`examples/{path.name}`" in text
