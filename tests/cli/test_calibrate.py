"""``boresight calibrate`` end to end on a small simulated scene: every method, over time, and radars without a reference."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from boresight import flow
from boresight.assessment.residuals import load_residuals
from boresight.association import ASSOCIATIONS
from boresight.calibration import load_calibration
from boresight.cli import main
from boresight.cli.calibrate import calibrate
from boresight.model import Sensors, load_sensors
from boresight.registration.methods import METHODS
from boresight.simulation import Adsb, Radar, Scenario, Traffic, simulate
from boresight.simulation.files import write_scene
from boresight.terms import MODELS

TRUE = {"R": {"range_bias": 50.0, "azimuth_bias": 0.1}, "S": {"range_bias": 200.0, "azimuth_bias": -0.2}}


def run(*arguments: str | Path) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command, in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    return int(str(stopped.value.code)), out.getvalue(), err.getvalue()


def mistake(*arguments: str | Path) -> str:
    """The one line of a user's mistake."""
    code, out, err = run(*arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1), err
    return err


def worked(*arguments: str | Path) -> str:
    """What a command that works prints."""
    code, out, err = run(*arguments)
    assert code == 0, err
    return out


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two radars 50 m apart, 14 aircraft with ADS-B, 15 minutes."""
    folder = tmp_path_factory.mktemp("scene")
    places = {"R": (41.3, 2.1), "S": (41.3003, 2.1005)}
    radars = tuple(
        Radar(name=name, sac=20, sic=k + 1, lat_deg=lat, lon_deg=lon, max_range_m=120e3, errors=TRUE[name])
        for k, (name, (lat, lon)) in enumerate(places.items())
    )
    traffic = Traffic(aircraft=14, radius_m=90e3, arrivals=0.0, departures=0.0)
    write_scene(simulate(Scenario(duration_s=900.0, traffic=traffic, radar=radars, adsb=Adsb()), 1), folder)
    return folder


def against(scene: Path, *radars: str) -> list[str | Path]:
    """The arguments of a calibration against ADS-B."""
    return [
        "calibrate", *(scene / f"{name}.ast" for name in radars or ("R",)), "--reference", scene / "adsb.ast",
        "--sensors", scene / "sensors.toml", "--date", "2026-03-01", "--edition", "021=2.4",
    ]  # fmt: skip


def alone(scene: Path, *radars: str) -> list[str | Path]:
    """The arguments of a calibration without a reference."""
    return ["calibrate", *(scene / f"{name}.ast" for name in radars), "--sensors", scene / "sensors.toml", "--date", "2026-03-01"]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_errors_by_its_name(scene: Path, method: str) -> None:
    model = {"least-squares": ["--model", "constant"], "per-channel": ["--model", "constant"]}.get(method, [])
    quick = {"genetic": ["--option", "generations=40", "rough.iterations=20"]}.get(method, [])
    found = json.loads(worked(*against(scene), "--method", method, *model, *quick, "--json"))
    assert found["method"] == method
    sensor = found["sensors"]["R"]
    terms = sensor["terms"]
    true = TRUE["R"] | {"rotation_up": -TRUE["R"]["azimuth_bias"]}
    told = [name for name in terms if name in true]
    assert told
    for name in told:
        # An exponential average of ten seconds knows no better than its scatter, which its sd tells.
        assert abs(terms[name]["value"] - true[name]) < 4 * terms[name]["sd"] + 1e-3, name
    assert sensor["held_out"]["after_median_m"] < sensor["held_out"]["before_median_m"]
    missing = {n["term"] for n in sensor["not_determined"]}
    assert set(TRUE["R"]) <= missing | set(terms)


@pytest.fixture(scope="module")
def online(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of a calibration over time."""
    out = tmp_path_factory.mktemp("online") / "out"
    worked(*against(scene, "R", "S"), "--online", "--model", "constant", "--out", out)
    return out


def test_biases_over_time_are_a_result_as_any_other(scene: Path, online: Path, tmp_path: Path) -> None:
    found = load_calibration(online / "calibration.json")
    assert len(found.epoch_s) > 100
    with open(online / "biases.csv") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time", "sensor", "term", "value", "sd", "unit"]
    assert len(rows) == found.value.size
    last = {(r["sensor"], r["term"]): r for r in rows}
    for name, terms in TRUE.items():
        for term, true in terms.items():
            row = last[name, term]
            assert row["time"].startswith("2026-03-01T10:1")
            assert abs(float(row["value"]) - true) < 4 * float(row["sd"])
            k = found.index(next(s.sensor for s in found.sensors if s.name == name), term)
            assert k is not None
            assert found.terms[k].unit == row["unit"]
    page = (online / "report.html").read_text()
    assert page.count("each value rests on the plots up to its time") == 2
    assert "At the end of the recording, R measures ranges" in page
    assert "biases followed over time" not in page
    assert "the newest of 401 epochs" in page
    # The steps after it take it as they take a static one, or say why not.
    said = mistake("correct", scene / "R.ast", "--calibration", online, "--out", tmp_path / "R.ast")
    assert "begin at 2026-03-01 10:00:01 UTC, and all plots are before" in said
    assert "--date" in said
    worked("correct", scene / "R.ast", "--calibration", online, "--out", tmp_path / "R.ast", "--date", "2026-03-01")
    again = json.loads(
        worked(
            "calibrate", tmp_path / "R.ast", "--reference", scene / "adsb.ast", "--sensors", scene / "sensors.toml",
            "--date", "2026-03-01", "--model", "constant", "--json",
        )
    )  # fmt: skip
    left = again["sensors"]["R"]["terms"]
    assert all(abs(left[name]["value"]) < 4 * left[name]["sd"] for name in TRUE["R"])
    assert flow.verify(online).exact
    assert "without --online" in mistake("plan", online, "--sd", "range_bias=1", "--sensor", "R")
    assert (
        "401 epochs: the newest is compared"
        in worked("compare", online / "calibration.json", online / "calibration.json", "--out", tmp_path / "c.html")
        + (tmp_path / "c.html").read_text()
    )
    (tmp_path / "r.toml").write_text(
        'name = "Spec"\nsource = "here"\nedition = "1"\n[[figure]]\nclause = "1"\nquantity = "range_bias"\nmax = 100.0\n'
        'unit = "m"\nkinds = ["mode_s"]\n'
    )
    verdicts = json.loads(worked("assess", "requirement", online, "--requirement", tmp_path / "r.toml", "--json"))["conformity"]
    assert {v["sensor"]: v["verdict"] for v in verdicts} == {"R": "pass", "S": "fail"}
    assert all("largest over time" in v["quantity"] for v in verdicts)


@pytest.fixture(scope="module")
def relative(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of two radars without a reference."""
    out = tmp_path_factory.mktemp("relative") / "out"
    code, text, err = run(*alone(scene, "R", "S"), "--out", out)
    assert code == 0
    assert "all errors are relative to R, the first in sensors.toml (--main names another)" in err
    assert "S (relative to R)" in text
    assert "distance to R's tracks" in text
    return out


def test_radars_without_a_reference_are_set_against_a_main_one(scene: Path, relative: Path, tmp_path: Path) -> None:
    found = load_calibration(relative / "calibration.json")
    (s,) = found.sensors
    assert (s.name, found.settings["main"], found.settings["method"]) == ("S", "R", "kalman-bank")
    for term, true in TRUE["S"].items():
        k = found.index(s.sensor, term)
        assert k is not None
        scale = {"range_bias": 1.0, "azimuth_bias": np.pi / 180}[term]
        assert abs(found.value[-1, k] / scale - (true - TRUE["R"][term])) < 4 * found.sd[-1, k] / scale
    # What is absolute is refused, with the reason.
    absolute = [n for n in found.not_determined if n.sensor != s.sensor]
    assert {n.term for n in absolute} == {"range_bias", "azimuth_bias", "elevation_bias"}
    assert all("condition number" in n.why and "need a trusted reference" in n.why for n in absolute)
    page = (relative / "report.html").read_text()
    assert "All values are relative to R" in page
    assert "absolute ones need a trusted reference" in page
    assert "compared with R, S measures ranges" in page
    assert "error (S − R)" in page
    assert "measured − true)" not in page
    # The distances are those to the main radar's tracks, as the figures and the residuals have them.
    left = load_residuals(relative / "residuals.parquet")
    for told, seen in ((s.before, left.distance_before_m), (s.after, left.distance_after_m)):
        assert (told.median_m, told.p95_m) == pytest.approx(np.nanpercentile(seen, [50, 95]), rel=1e-6)
    assert (relative / "biases.csv").read_text().startswith("time,sensor,term,value,sd,unit\n")
    assert flow.verify(relative).exact
    shutil.copytree(relative, tmp_path / "changed")
    (tmp_path / "changed" / "biases.csv").write_text("time\n")
    assert flow.verify(tmp_path / "changed").changed == ("biases.csv",)
    # So corrected, S agrees with R: nothing is left between them.
    code, _, err = run("correct", scene / "S.ast", "--calibration", relative, "--out", tmp_path / "S.ast", "--date", "2026-03-01")
    assert (code, "relative to R: corrected plots agree with it" in err) == (0, True)
    assert "each plot gets the values of its own time" in err
    again = json.loads(
        worked(
            "calibrate",
            scene / "R.ast",
            tmp_path / "S.ast",
            "--sensors",
            scene / "sensors.toml",
            "--date",
            "2026-03-01",
            "--json",
        )
    )
    assert again["relative_to"] == "R"
    left = again["sensors"]["S"]["terms"]
    assert all(abs(t["value"]) < 4 * t["sd"] for t in left.values())


def test_the_main_radar_can_be_named_and_methods_have_options(scene: Path) -> None:
    found = json.loads(
        worked(*alone(scene, "R", "S"), "--main", "S", "--method", "igmsr", "--option", "tau_s=300", "multi_start=true", "--json")
    )
    assert found["relative_to"] == "S"
    terms = found["sensors"]["R"]["terms"]
    assert abs(terms["range_bias"]["value"] + 150.0) < 20.0
    assert abs(terms["azimuth_bias"]["value"] - 0.3) < 0.05


def test_without_a_reference_a_radar_that_sails_is_refused_with_the_reason(scene: Path, tmp_path: Path) -> None:
    entries = (scene / "sensors.toml").read_text().split("[[sensor]]")
    (own,) = [k for k, entry in enumerate(entries) if 'name = "S"' in entry]
    kept = [line for line in entries[own].splitlines() if not line.startswith(("lat_deg", "lon_deg", "height_m"))]
    entries[own] = "\n".join([*kept, ""])
    (tmp_path / "sensors.toml").write_text("[[sensor]]".join(entries))
    radars = scene / "R.ast", scene / "S.ast"
    said = mistake("calibrate", *radars, "--sensors", tmp_path / "sensors.toml", "--date", "2026-03-01")
    assert "'S' has no position" in said
    assert "one that sails cannot be" in said


def test_relative_values_are_not_taken_for_absolute_ones(scene: Path, online: Path, relative: Path, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(
        'name = "Spec"\nsource = "here"\nedition = "1"\n[[figure]]\nclause = "1"\nquantity = "range_bias"\nmax = 100.0\n'
        'unit = "m"\nkinds = ["mode_s"]\n'
    )
    assert "relative to R" in mistake("assess", "requirement", relative, "--requirement", tmp_path / "r.toml")
    assert "--reference" in mistake(*alone(scene, "R", "S"), "--requirement", tmp_path / "r.toml")
    both = online / "calibration.json", relative / "calibration.json"
    said = mistake("compare", *both, "--out", tmp_path / "c.html")
    assert "is absolute and" in said
    assert "is relative to R: their values cannot be compared" in said


def test_one_radar_and_no_reference(scene: Path) -> None:
    said = mistake(*alone(scene, "R"))
    assert "one radar only, 'R'" in said
    assert "--reference" in said
    assert "no plot of the main radar 'S'" in mistake(*alone(scene, "R"), "--main", "S")


def test_options_that_make_no_sense_are_told_before_anything_is_read(scene: Path) -> None:
    """The recordings named here do not exist: whoever reads first complains of that instead."""
    radar = ["calibrate", "nowhere.ast", "--sensors", scene / "sensors.toml"]
    reference = ["--reference", "nowhere-either.ast"]
    for more, *said in (
        ([*reference, "--method", "ransack"], "'ransack'", "ransac-icp"),
        ([*reference, "--method", "ransac-icp", "--option", "tau_s=1"], "no option 'tau_s'", "iterations"),
        ([*reference, "--method", "ransac-icp", "--option", "iterations=many"], "iterations"),
        ([*reference, "--option", "iterations"], "'iterations' is no name and its value", "tau_s=20"),
        ([*reference, "--option", "max_iterations=1", "max_iterations=2"], "given twice"),
        ([*reference, "--model", "foo"], "no term or model named 'foo'"),
        ([*reference, "--method", "per-channel", "--model", "atc"], "'atc' is no model of the method per-channel", "first-order"),
        ([*reference, "--method", "genetic", "--model", "constant"], "one model only"),
        ([*reference, "--method", "genetic", "--online"], "one value for all time", "kalman-bank"),
        ([*reference, "--method", "genetic", "--select", "bic"], "searches no model"),
        ([*reference, "--associate", "medoids"], "Known: hough, k-medoids"),
        ([*reference, "--associate-option", "threshold=0.9"], "no option 'threshold'", "range_window_m"),
        ([*reference, "--associate", "k-medoids", "--associate-option", "threshold=7"], "threshold = 7.0 makes no sense"),
        ([*reference, "--main", "R"], "there is a reference"),
        (["--main", "T"], "no sensor 'T'", "R, S"),
        (["--method", "least-squares"], "needs a reference", "kalman-bank, igmsr"),
        (["--model", "atc"], "can be told, not range_gain", "--reference"),
    ):
        text = mistake(*radar, *more)
        assert all(words in text for words in said), text
        assert "nowhere" not in text


def test_help_lists_every_method_and_every_model() -> None:
    doc = " ".join((calibrate.__doc__ or "").split())
    for name in (*METHODS, *MODELS, *ASSOCIATIONS):
        assert name in doc, name


def test_errors_larger_than_the_search_are_said_and_can_be_searched_for(scene: Path, tmp_path: Path) -> None:
    """A north that is 25 degrees off is beyond what is searched, even where identities pair the tracks."""
    text = (scene / "sensors.toml").read_text()
    (tmp_path / "sensors.toml").write_text(
        text.replace('name = "R"', 'name = "R"\nnorth = "magnetic"\nnorth_offset_deg = 25.0', 1)
    )
    arguments = [tmp_path / "sensors.toml" if str(a).endswith("sensors.toml") else a for a in against(scene)]
    said = mistake(*arguments, "--model", "constant")
    assert "within ±6000 m and ±10.5°" in said
    assert "--associate-option" in said
    assert "azimuth_window_deg" in said
    wide = ["--associate-option", "azimuth_window_deg=12"]
    found = json.loads(worked(*arguments, "--model", "constant", *wide, "--json"))
    assert abs(found["sensors"]["R"]["terms"]["azimuth_bias"]["value"] - 25.1) < 0.1


def test_association_by_clusters_in_place_of_identities(scene: Path) -> None:
    options = ["--associate", "k-medoids", "--associate-option", "period_s=5", "threshold=0.7"]
    found = json.loads(worked(*against(scene), "--model", "constant", *options, "--json"))
    terms = found["sensors"]["R"]["terms"]
    assert all(abs(terms[name]["value"] - true) < 4 * terms[name]["sd"] for name, true in TRUE["R"].items())


def test_folders_and_endings_are_told(scene: Path, online: Path, tmp_path: Path) -> None:
    correct = ["correct", scene / "R.ast", "--calibration", online]
    said = mistake(*correct, "--out", tmp_path / "t.xyz")
    assert "the ending .xyz cannot be written" in said
    assert ".parquet or .csv for a table of the plots, or .ast for the ASTERIX recording again" in said
    assert "is a folder" in mistake(*correct, "--out", tmp_path)
    assert "is a folder, not a recording" in mistake("correct", scene, "--calibration", online, "--out", tmp_path / "t.csv")
    assert "is a folder, not a recording" in mistake(
        "calibrate", scene, "--reference", scene / "adsb.ast", "--sensors", scene / "sensors.toml"
    )
    table = tmp_path / "R.parquet"
    worked(*correct, "--out", table, "--date", "2026-03-01")
    said = mistake("correct", table, "--calibration", online, "--out", tmp_path / "t.ast")
    assert "R.parquet is no ASTERIX" in said
    assert "only a single recording" in mistake("correct", scene / "S.ast", *correct[1:], "--out", tmp_path / "t.ast").replace(
        "\n", " "
    )


def test_radars_whose_plots_carry_no_identity_are_paired_by_their_tracks(scene: Path) -> None:
    from boresight.association.radars import pairs_against, shared_targets
    from boresight.model import Plots
    from boresight.reading import read

    sensors = load_sensors(scene / "sensors.toml")
    r, s = (read(scene / f"{name}.ast") for name in "RS")
    plots = Plots.concat([r.plots, s.plots])
    by_identity = shared_targets(plots, sensors, next(iter(sensors)))
    assert by_identity.by == "identity"
    nothing = np.full(len(plots), -1)
    bare = plots.replace(mode_s=nothing, mode_3a=nothing, callsign=nothing)
    found = shared_targets(bare, sensors, next(iter(sensors)))
    assert found.by == "tracks"
    pairs = pairs_against(bare, sensors, next(iter(sensors)), found.target)
    assert len(pairs) > 0.8 * len(s.plots)
    # The tracks that are paired are of one aircraft: the address, which was taken away, says so.
    mains = found.target[: len(r.plots)]
    owner = {int(t): int(np.bincount(r.plots.mode_s[mains == t]).argmax()) for t in np.unique(mains[mains >= 0])}
    right = np.array([owner[int(t)] for t in pairs.target]) == plots.mode_s[pairs.plot]
    assert right.mean() > 0.97


def test_every_run_of_before_can_still_be_read(online: Path, tmp_path: Path) -> None:
    """A run.json without the options of methods is of a time when there was one."""
    from boresight.frozen import load_frozen

    shutil.copytree(online, tmp_path / "old")
    path = tmp_path / "old" / "run.json"
    whole = json.loads(path.read_text())
    for name in ("method", "options", "online", "associate", "associate_options", "main"):
        del whole["settings"][name]
    path.write_text(json.dumps(whole))
    settings = load_frozen(tmp_path / "old").settings
    assert (settings.method, settings.online, settings.associate, settings.main) == ("least-squares", False, "hough", "")
    assert isinstance(settings.sensors, Sensors)
