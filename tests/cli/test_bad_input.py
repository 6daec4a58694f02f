"""Recordings that cannot tell everything, or anything, and mistakes of all kinds: what the command line makes of them.

A recording that tells too little ends in one line that names it and a remedy, or in values with honest sds beside the names of
what nothing tells.  Never in a traceback, a number that is none, or half a result.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
import signal
import warnings
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from boresight.assessment.residuals import Residuals
from boresight.calibration import Accuracy, Calibration, Noise, Summary, TermKey, save_calibration
from boresight.cli import main
from boresight.reading import read
from boresight.registration.methods import METHODS, OnlineMethod
from boresight.writing.tables import write_table

RELATIVE = [name for name, method in METHODS.items() if isinstance(method, OnlineMethod)]
OVER_TIME = {*RELATIVE, "kalman-transform"}
RESULTS = {"calibration.json", "residuals.parquet", "report.html", "run.json"}
TRUE = {"range_bias": 80.0, "azimuth_bias": 0.2}
CORE = {"range_bias", "azimuth_bias", "time_offset"}
NO_NUMBER = re.compile(r"(?<![\w.])[-+]?(nan|inf|infinity)\b", re.IGNORECASE)


class Said:
    """What a command said, and its exit code; every run is held to what all must keep."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> Any:
        def refuse(word: str) -> None:
            raise AssertionError(f"{word} in JSON")

        return json.loads(self.out, parse_constant=refuse)


def run(*arguments: str | Path, numbers: bool = True) -> Said:
    """Run a command in this process.  With `numbers` nothing that it prints may be NaN or infinite."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(SystemExit) as stopped:
            main([str(a) for a in arguments])
    said = Said(int(str(stopped.value.code)), out.getvalue(), err.getvalue())
    assert not [str(w.message) for w in caught if issubclass(w.category, RuntimeWarning)]
    assert said.code in (0, 2, 130), said.err
    assert "Traceback" not in said.err
    if numbers:
        assert not NO_NUMBER.search(said.out + said.err), said.out + said.err
    return said


def worked(*arguments: str | Path) -> Said:
    said = run(*arguments)
    assert said.code == 0, said.err
    return said


def mistake(*arguments: str | Path, numbers: bool = True) -> str:
    """The one line of a command that cannot do what it is asked for; warnings may stand before it."""
    said = run(*arguments, numbers=numbers)
    assert said.code == 2, said.out
    assert said.out == ""
    *before, last = said.err.splitlines()
    assert last.startswith("boresight: "), said.err
    assert all(line.startswith("warning: ") for line in before), said.err
    return last


# -------------------------------------------------------------------------------------------------------------------- scenes
def radar(name: str = "one", sic: int = 1, more: str = "") -> str:
    errors = "" if "errors" in more else "errors = { range_bias = 80.0, azimuth_bias = 0.2 }\n"
    return (
        f'[[radar]]\nname = "{name}"\nsac = 1\nsic = {sic}\nlat_deg = 50.0\nlon_deg = 8.0\nheight_m = 100.0\nscan_s = 4.0\n'
        f"min_range_m = 100.0\nmax_range_m = 200e3\nmin_elevation_deg = -5.0\n{errors}{more}\n"
    )


def aircraft(k: int, far: float = 0.3, height_m: float = 9000.0, speed_mps: float = 200.0, more: str = "") -> str:
    lat, lon = 50 + far * math.sin(k), 8 + 1.4 * far * math.cos(k)
    return (
        f'[[target]]\nname = "t{k}"\nlat_deg = {lat}\nlon_deg = {lon}\nspeed_mps = {speed_mps}\ncourse_deg = {77 * k % 360}\n'
        f"height_m = {height_m}\n{more}\n"
    )


EIGHT = "".join(aircraft(k) for k in range(8))


def scene(*tables: str, duration_s: int = 240, reference: str = "[adsb]\nshare = 1.0\nloss = 0.0\n") -> str:
    return (
        f"duration_s = {duration_s}.0\n[traffic]\naircraft = 0\narrivals = 0.0\ndepartures = 0.0\n" + "".join(tables) + reference
    )


def simulated(folder: Path, text: str, *more: str) -> Path:
    (folder / "scene.toml").write_text(text)
    worked("simulate", folder / "scene.toml", "--out", folder / "out", *more)
    return folder / "out"


def against(made: Path, *radars: str) -> list[str | Path]:
    """The arguments of a calibration against the scene's reference."""
    plots = [next(p for p in (made / f"{name}.ast", made / f"{name}.parquet") if p.exists()) for name in radars or ("one",)]
    reference = next(made / name for name in ("adsb.ast", "rtk.parquet") if (made / name).exists())
    where = ["--sensors", made / "sensors.toml", "--date", "2026-03-01", "--edition", "021=2.4"]
    return ["calibrate", *plots, "--reference", reference, *where]


def checked(said: Said, *names: str, true: dict[str, float] | None = None) -> dict[str, Any]:
    """The JSON of a calibration: finite values and sds, every core term told or named, and what is told true within 4 sd."""
    found: dict[str, Any] = said.json
    true = TRUE if true is None else true
    for name in names or ("one",):
        sensor = found["sensors"][name]
        missing = {n["term"]: n["why"] for n in sensor["not_determined"]}
        assert all(missing.values())
        assert set(sensor["terms"]) or missing
        assert not set(sensor["terms"]) & set(missing)
        assert set(sensor["terms"]) | set(missing) >= CORE
        for term, told in sensor["terms"].items():
            assert math.isfinite(told["value"])
            assert told["sd"] > 0, term
            if term in true:
                assert abs(told["value"] - true[term]) < 4 * told["sd"], (term, told)
    return found


def nothing_left(folder: Path) -> None:
    assert not folder.exists()
    assert not [p.name for p in folder.parent.iterdir() if p.name.startswith(".boresight")]


# -------------------------------------------------------------------------------------------------- too little, all methods
@pytest.fixture(scope="module")
def one_plot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    more = "gaps = { outage_s = [[0.0, 20.0], [24.1, 60.0]] }\n"
    made = simulated(tmp_path_factory.mktemp("plot"), scene(radar(more=more), aircraft(1), duration_s=60))
    assert len(read(made / "one.ast").plots) == 1
    return made


@pytest.mark.parametrize("method", METHODS)
def test_one_plot_is_refused(one_plot: Path, tmp_path: Path, method: str) -> None:
    for json_too in ([], ["--json"]):
        said = mistake(*against(one_plot), "--method", method, "--out", tmp_path / "out", *json_too)
        assert said == (
            "boresight: one: only 1 of its plots can be used, and at least 3 plots of one target are needed. Record longer."
        )
        nothing_left(tmp_path / "out")


@pytest.mark.parametrize("method", METHODS)
def test_one_plot_that_clusters_pair_is_told_for_no_more_than_it_is_worth(one_plot: Path, tmp_path: Path, method: str) -> None:
    """K-medoids take as many medoids as there are targets, and there are more of these than points."""
    written = ["--out", tmp_path / "out"] if method in ("least-squares", "kalman-bank", "genetic") else []
    arguments = [*against(one_plot), "--associate", "k-medoids", "--method", method, *written]
    said = run(*arguments, "--json")
    if said.code == 2:
        assert "one" in mistake(*arguments)
        nothing_left(tmp_path / "out")
        return
    found = checked(said)
    assert "time_offset" not in found["sensors"]["one"]["terms"]
    names = RESULTS | ({"biases.csv"} if method in OVER_TIME else set())
    assert not written or {p.name for p in (tmp_path / "out").iterdir()} == names


@pytest.fixture(scope="module")
def one_track(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("track"), scene(radar(), aircraft(1), duration_s=300))


@pytest.fixture(scope="module")
def radial_track(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One aircraft straight towards the radar."""
    target = (
        '[[target]]\nkind = "approaching"\nrange_m = 120e3\nazimuth_deg = 30.0\nspeed_mps = 220.0\ntowards = "one"\n'
        "height_m = 9e3\n"
    )
    return simulated(tmp_path_factory.mktemp("radial"), scene(radar(), target, duration_s=300))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["one_track", "radial_track"])
def test_one_track_gives_what_it_tells_and_names_the_rest(kind: str, method: str, request: pytest.FixtureRequest) -> None:
    made = request.getfixturevalue(kind)
    said = worked(*against(made), "--method", method, "--json")
    found = checked(said, true={**TRUE, "time_offset": 0.0})
    sensor = found["sensors"]["one"]
    # A track that curves about the radar tells a little of the clock, a radial one nothing: then nothing is said of it either.
    assert "time_offset" not in sensor["terms"] or (kind, method) == ("one_track", "least-squares")
    assert "stamps are" not in said.err + "".join(found["warnings"])
    text = worked(*against(made), "--method", method).out
    assert ("not determined: time_offset: " in text) == ("time_offset" not in sensor["terms"])
    assert "not determined: elevation_bias: " in text
    assert "too few targets to hold some out" in text or "at least 5 are needed to hold some out" in text
    # Nobody knows of one target what it keeps for itself: a transponder's delay is tens of metres.
    for term in ("range_bias", "site_east", "site_north"):
        assert sensor["terms"].get(term, {"sd": 99.0})["sd"] > 15.0, term


def test_a_radial_track_says_what_its_range_bias_holds(radial_track: Path) -> None:
    text = worked(*against(radial_track), "--method", "least-squares").out
    assert re.search(r"range_bias also holds what there is of time_offset: [+-]2\d\d m for each s", text)


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All targets at the antenna's own height, measured with elevation; the reference knows heights to a centimetre."""
    low = "".join(aircraft(k, 0.03, 100.0, 30.0) for k in range(8))
    more = "elevation_sd_deg = 0.05\n"
    return simulated(tmp_path_factory.mktemp("flat"), scene(radar(more=more), low, reference="[rtk]\n"))


@pytest.mark.parametrize("method", METHODS)
def test_elevation_zero_everywhere(flat: Path, method: str) -> None:
    elevation = read(flat / "one.parquet").plots.elevation_rad
    assert np.abs(np.median(elevation)) < 5e-4
    found = checked(
        worked(*against(flat), "--method", method, "--json"), true={**TRUE, "elevation_bias": 0.0, "time_offset": 0.0}
    )
    # What is sec E or cot E of nothing is not told apart from a constant.
    assert not {"elevation_sag", "collimation", "nonorthogonality"} & set(found["sensors"]["one"]["terms"])
    if method == "least-squares":
        worked(*against(flat), "--method", method)


def test_every_order_of_error_fitting_at_elevation_zero(flat: Path) -> None:
    for order in ("constant", "first-order", "second-order"):
        found = worked(*against(flat), "--method", "per-channel", "--model", order, "--json").json
        assert all(math.isfinite(t["value"]) and t["sd"] > 0 for t in found["sensors"]["one"]["terms"].values())


# ------------------------------------------------------------------------------------------------------------ identical radars
@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two radars of the same errors on one mast."""
    return simulated(tmp_path_factory.mktemp("twins"), scene(radar(), radar("two", 2), EIGHT))


@pytest.mark.parametrize("method", RELATIVE)
def test_identical_radars_differ_by_nothing_and_tell_nothing_absolute(twins: Path, tmp_path: Path, method: str) -> None:
    arguments = ["calibrate", twins / "one.ast", twins / "two.ast", "--sensors", twins / "sensors.toml", "--method", method]
    found = worked(*arguments, "--date", "2026-03-01", "--json").json
    assert found["relative_to"] == "one"
    assert set(found["sensors"]) == {"two"}
    for told in found["sensors"]["two"]["terms"].values():
        assert abs(told["value"]) < 4 * told["sd"]
    if method not in ("kalman-bank", "mean-shift"):
        return
    assert "all values are relative" in worked(*arguments, "--date", "2026-03-01", "--out", tmp_path / "out").out
    whole = json.loads((tmp_path / "out" / "calibration.json").read_text())
    absolute = [n for n in whole["not_determined"] if n["term"] in TRUE]
    assert absolute
    assert all("reference" in n["why"] for n in absolute)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {*RESULTS, "biases.csv"}


@pytest.mark.parametrize("method", METHODS)
def test_identical_radars_against_a_reference(twins: Path, method: str) -> None:
    checked(worked(*against(twins, "one", "two"), "--method", method, "--json"), "one", "two")


def test_one_radar_under_two_names_is_one(twins: Path, tmp_path: Path) -> None:
    text = (twins / "sensors.toml").read_text()
    (tmp_path / "sensors.toml").write_text(text.replace("sic = 2", "sic = 1"))
    said = mistake("calibrate", twins / "one.ast", "--sensors", tmp_path / "sensors.toml", "--reference", twins / "adsb.ast")
    assert "sensors.toml" in said
    assert "two" in said


# -------------------------------------------------------------------------------------------------- outliers, and large biases
@pytest.fixture(scope="module", params=["far off", "clutter alone"])
def outliers(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    more = {
        "far off": "noise = { all = { outliers = 1.0, outlier_factor = 30.0 } }\n",
        "clutter alone": "detection = 1e-6\nfalse_plots = 100.0\n",
    }[request.param]
    return simulated(tmp_path_factory.mktemp("outliers"), scene(radar(more=more), EIGHT))


@pytest.mark.parametrize("method", METHODS)
def test_nothing_but_outliers_is_refused_or_told_for_what_it_is(outliers: Path, tmp_path: Path, method: str) -> None:
    arguments = [*against(outliers), "--method", method]
    said = run(*arguments, "--json")
    if said.code == 0:
        # A radar whose every plot is 900 m off is a noisy one: its noise is told, and nothing comes nearer by what is found.
        found = checked(said)["sensors"]["one"]
        assert found["noise"]["range_m"] > 300.0
        assert "come no nearer" in said.out or "insufficient" in said.out
        return
    line = mistake(*arguments, "--out", tmp_path / "out")
    assert "boresight: one: " in line
    assert "nothing agrees with the reference better than chance" in line
    assert "Check the radar's position" in line
    nothing_left(tmp_path / "out")


def test_a_tenth_of_outliers_is_left_out(tmp_path: Path) -> None:
    more = "noise = { all = { outliers = 0.1, outlier_factor = 30.0 } }\n"
    made = simulated(tmp_path, scene(radar(more=more), EIGHT))
    for method in ("least-squares", "maximum-likelihood", "genetic", "igmsr", "kalman-bank"):
        checked(worked(*against(made), "--method", method, "--json"))


@pytest.mark.parametrize(
    ("term", "value", "identity", "windows"),
    [
        ("range_bias", 9000.0, True, ["range_window_m=4000"]),
        ("azimuth_bias", 15.0, True, ["azimuth_window_deg=6"]),
        ("range_bias", 4000.0, False, ["range_window_m=5000"]),
        ("time_offset", 20.0, True, None),
    ],
)
def test_a_bias_beyond_the_window_is_said_and_found_in_a_wider_one(
    tmp_path: Path, term: str, value: float, identity: bool, windows: list[str] | None
) -> None:
    more = f"identity = {str(identity).lower()}\nerrors = {{ {term} = {value} }}\n"
    made = simulated(tmp_path, scene(radar(more=more), EIGHT))
    said = mistake(*against(made), "--out", tmp_path / "result")
    assert "boresight: one: " in said
    nothing_left(tmp_path / "result")
    assert mistake(*against(made), "--online", "--json") == said
    if windows is None:
        # A clock so far off is found by itself, and the line that mends it is told.
        match = re.search(r"time_offset_s = ([\d.]+) for 'one' in sensors.toml", said)
        assert match
        assert abs(float(match[1]) - value) < 0.5
        with open(made / "sensors.toml", "a") as file:
            file.write(f"time_offset_s = {match[1]}\n")
        checked(worked(*against(made), "--method", "least-squares", "--json"), true={})
        return
    assert "--associate-option range_window_m=" in said
    found = worked(
        *against(made), "--method", "least-squares", "--model", "constant", "--associate-option", *windows, "--json"
    ).json
    told = found["sensors"]["one"]["terms"][term]
    assert abs(told["value"] - value) < 4 * told["sd"]


# ------------------------------------------------------------------------------------------------------------- moving platforms
@pytest.fixture(scope="module")
def ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A radar 72 m from the point of its rolling ship whose position is known, and eight boats with receivers."""
    boats = "".join(
        f'[[target]]\nname = "s{k}"\ncraft = "ship"\nlat_deg = {50 + 0.05 * math.sin(0.9 * k)}\n'
        f"lon_deg = {8 + 0.08 * math.cos(0.9 * k)}\nspeed_mps = {5 + k % 4}\ncourse_deg = {67 * k % 360}\nlength_m = 12.0\n"
        for k in range(8)
    )
    own = (
        '[[radar]]\nname = "one"\nsac = 1\nsic = 1\nlat_deg = 50.0\nlon_deg = 8.0\nkind = "marine"\nscan_s = 2.5\n'
        "min_range_m = 200.0\nmax_range_m = 20e3\nmin_elevation_deg = -45.0\nrange_sd_m = 8.0\nazimuth_sd_deg = 0.2\n"
        "ground_height_m = 0.0\nerrors = { range_bias = 80.0, azimuth_bias = 0.2 }\n[radar.platform]\nlat_deg = 50.0\n"
        "lon_deg = 8.0\nspeed_mps = 5.0\ncourse_deg = 60.0\nroll_deg = 8.0\npitch_deg = 2.0\nlever_arm_m = [60.0, 0.0, 40.0]\n"
    )
    return simulated(tmp_path_factory.mktemp("ship"), scene(boats, own, duration_s=300, reference="[rtk]\n"), "--format", "table")


def held_out_m(found: dict[str, Any]) -> float:
    return float(found["sensors"]["one"]["after"]["median_m"])


@pytest.mark.parametrize("method", ["least-squares", "kalman-bank"])
def test_what_is_not_known_of_a_platform_is_said_and_its_loss_shown(ship: Path, tmp_path: Path, method: str) -> None:
    way = ship / "one-own-ship.parquet"
    head, *rest = against(ship)

    def calibrated(own: Path, sensors: Path = ship / "sensors.toml") -> tuple[dict[str, Any], str]:
        arguments = [head, rest[0], own, *rest[1:], "--method", method]
        arguments[arguments.index("--sensors") + 1] = sensors
        found = worked(*arguments, "--json").json
        return found, " ".join(found["warnings"])

    whole, said = calibrated(way)
    assert "level deck" not in said
    assert "lever" not in said
    for term, value in TRUE.items():
        told = whole["sensors"]["one"]["terms"][term]
        assert abs(told["value"] - value) < 4 * told["sd"]
    own = read(way).platform
    nothing = np.full(len(own), np.nan)
    # Without roll and pitch: what a degree of them does is said, and they show.
    write_table(tmp_path / "level.parquet", own.replace(roll_rad=nothing, pitch_rad=nothing))
    level, said = calibrated(tmp_path / "level.parquet")
    assert (
        "nothing tells own ship's roll and pitch, so a level deck is assumed: each degree moves the antenna by up to 1.26 m"
        in said
    )
    # Without a heading, or without the lever arm itself, the antenna is 72 m from where it is taken to be.
    write_table(tmp_path / "nohead.parquet", own.replace(roll_rad=nothing, pitch_rad=nothing, heading_rad=nothing))
    unturned, said = calibrated(tmp_path / "nohead.parquet")
    assert "the lever arm is not applied: the antenna is up to 72.1 m from where it is taken to be" in said
    (tmp_path / "sensors.toml").write_text(re.sub(r"lever_arm_m.*\n", "", (ship / "sensors.toml").read_text()))
    unknown, said = calibrated(way, tmp_path / "sensors.toml")
    assert "sensors.toml has no lever_arm_m, so the antenna is taken to be where own ship's position is told" in said
    for worse in (level, unturned, unknown):
        assert held_out_m(worse) > held_out_m(whole)
    assert min(held_out_m(unturned), held_out_m(unknown)) > 1.15 * held_out_m(whole)
    # An error of the position itself looks like the radar's own: only the distances that are left tell of it.
    write_table(tmp_path / "off.parquet", own.replace(latitude_rad=own.latitude_rad + 100 / 6.371e6))
    assert held_out_m(calibrated(tmp_path / "off.parquet")[0]) > 1.5 * held_out_m(whole)


def test_a_radar_that_moves_and_whose_way_nothing_tells(ship: Path, tmp_path: Path) -> None:
    said = mistake(*against(ship), "--out", tmp_path / "out")
    assert "sensors.toml: the sensor 'one' has no position" in said
    assert "a recording of its way" in said
    nothing_left(tmp_path / "out")


# ------------------------------------------------------------------------------------------------------------- assess: constants
def result(folder: Path, before_m: np.ndarray, after_m: np.ndarray, plots: int) -> Path:
    """A result with these range errors of targets T0, T1, … of so many plots each; azimuths are off by nothing at all."""
    n = len(after_m)
    columns: dict[str, Any] = {f.name: np.zeros(n, f.metadata["dtype"]) for f in fields(Residuals)}
    target, step = np.arange(n) // plots, np.arange(n) % plots
    columns |= {
        "time_s": 1.7e9 + 4.0 * step, "sensor": np.full(n, 1, np.int32), "channel": np.full(n, 3, np.int8), "target": target,
        "reference_range_m": 3e4 + 400.0 * step + 5e3 * target, "reference_azimuth_rad": 0.3 + 0.001 * step + 0.1 * target,
        "range_before_m": before_m, "range_after_m": after_m,
    }  # fmt: skip
    columns["target_name"] = np.array([f"T{k}" for k in target.tolist()], object)
    folder.mkdir(exist_ok=True)
    write_table(folder / "residuals.parquet", columns)
    near = Accuracy(1.0, 2.0)
    summary = Summary(sensor=1, name="one", model="constant", noise=Noise(5.0, 0.001), plots=n, tracks=2, targets=2,
                      before=near, after=near)  # fmt: skip
    term = (TermKey(1, "all", "range_bias", "m"),)
    save_calibration(
        Calibration(term, np.zeros(1), np.zeros((1, 1)), np.ones((1, 1, 1)), (summary,)), folder / "calibration.json"
    )
    return folder


SERIES = {
    "constant": (np.full(200, 5.0), np.full(200, 5.0)),
    "zero": (np.zeros(200), np.zeros(200)),
    "two constants": (np.full(200, 5.0), np.full(200, -9.0)),
    "equal": (20 * np.sin(np.arange(200) / 9), 20 * np.sin(np.arange(200) / 9)),
    "all equal but one": (np.r_[np.zeros(199), 1e3], np.zeros(200)),
    "tiny": (1e-12 * np.cos(np.arange(200)), 1e-12 * np.sin(np.arange(200))),
}


@pytest.mark.parametrize("name", SERIES)
def test_equal_and_constant_series_have_defined_values(name: str, tmp_path: Path) -> None:
    first, second = SERIES[name]
    both = np.concatenate([first, second])
    folder = result(tmp_path / "result", both, both, 200)
    drawn = name == "constant"
    for more in ([], ["--json"], ["--raw"], *([["--out", tmp_path / "errors.html"]] if drawn else [])):
        said = worked("assess", "distribution", folder, *more)
        if more == ["--json"]:
            found = {d["component"]: d for d in said.json["distribution"]}
            assert found["azimuth"]["verdict"].startswith("constant: all values are equal")
            assert found["range"]["sd"] == pytest.approx(float(np.std(both)))
            assert found["range"]["verdict"].startswith("constant") == (np.ptp(both) == 0)
    for more in ([], ["--json"], ["--motion", "all"], *([["--out", tmp_path / "pair.html"]] if drawn else [])):
        said = worked("assess", "correlation", folder, "--targets", "T0", "T1", *more)
        if more == ["--json"]:
            text = json.dumps(said.json)
            for k, channel in enumerate(said.json["correlation"]["channels"]):
                for model in channel["models"]:
                    assert 0 <= model["theil"] <= 1, text
                    assert 0 < model["r"] <= 1
                if k == 1 or name in ("constant", "zero", "equal"):
                    assert all(model["distance"] == 0 and model["r"] == 1 for model in channel["models"])
    for page in ("errors.html", "pair.html") if drawn else ():
        text = re.sub(r"<svg.*?</svg>", "", (tmp_path / page).read_text(), flags=re.DOTALL)
        assert not NO_NUMBER.search(re.sub(r"<(style|script).*?</\1>", "", text, flags=re.DOTALL))


def test_more_parts_than_values(tmp_path: Path) -> None:
    values = np.random.default_rng(1).normal(size=13)
    for n in (2, 9):
        folder = result(tmp_path / f"{n}", values[:n], values[:n], n)
        said = mistake("assess", "distribution", folder, "--component", "range", "--out", tmp_path / "never.html")
        assert f"{n} residuals: too few, at least 10 are needed" in said
        assert str(folder) in said
    for n in (10, 13):
        folder = result(tmp_path / f"{n}", values[:n], values[:n], n)
        (found,) = worked("assess", "distribution", folder, "--component", "range", "--json").json["distribution"]
        # Every part of a mixture must have something to rest on.
        assert all(len(m["mean"]) <= n // 3 for m in found["mixtures"])
    assert not (tmp_path / "never.html").exists()


def test_values_that_no_radar_measures_are_refused(tmp_path: Path) -> None:
    huge = 1e150 * np.cos(np.arange(400))
    folder = result(tmp_path / "result", huge, huge, 200)
    for command in (["distribution"], ["correlation", "--targets", "T0", "T1"]):
        said = mistake("assess", command[0], folder, *command[1:])
        assert "residuals.parquet" in said
        assert "no radar can measure" in said


def test_more_clusters_than_points(tmp_path: Path) -> None:
    made = simulated(tmp_path, scene(radar(), *(aircraft(k) for k in range(3)), duration_s=16))
    for option in ("period_s=1", "period_s=1000", "threshold=0.01"):
        arguments = [*against(made), "--associate", "k-medoids", "--associate-option", option]
        said = run(*arguments, "--json")
        if said.code == 2:
            assert "one" in mistake(*arguments)
        else:
            checked(said, true={})


# ------------------------------------------------------------------------------------------------------------ a sceptical user
def test_a_scenario_that_simulates_no_plot(tmp_path: Path) -> None:
    for text, why in (
        (
            scene(radar(), EIGHT).replace("lat_deg = 50.0\nlon_deg = 8.0\nheight", "lat_deg = -50.0\nlon_deg = 8.0\nheight"),
            "m away",
        ),
        (scene(radar(more="gaps = { outage_s = [[0.0, 999.0]] }\n"), EIGHT), "an outage covers all the time"),
        (scene(radar()), "nothing to see"),
        (scene(EIGHT), "there is no radar"),
        (
            scene(
                radar(more="max_elevation_deg = 86.0\n").replace("min_elevation_deg = -5.0", "min_elevation_deg = 85.0"), EIGHT
            ),
            "stand at elevations",
        ),
    ):
        (tmp_path / "s.toml").write_text(text)
        assert why in mistake("simulate", tmp_path / "s.toml", "--out", tmp_path / "out")
        nothing_left(tmp_path / "out")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("range_bias = 80.0", "range_bias = nan", "range_bias = nan is not a finite number"),
        ("range_bias = 80.0", "range_bias = { value = 1.0, ramp_per_h = inf }", "ramp_per_h = inf is not a finite number"),
        ("range_bias = 80.0", "range_bias = 1e300", "range_bias comes to 1e+300 m, which no radar can be off by"),
        ("range_bias = 80.0", "time_offset = 1e18", "time_offset comes to 1e+18 s, which no radar can be off by"),
        ("duration_s = 240.0", "duration_s = inf", "duration_s = inf is not a finite number"),
        ("lat_deg = 50.0", "lat_deg = nan", "lat_deg = nan is not a finite number"),
        ("sic = 1", "sic = 123456789012345678901234567890", "is not within 0 … 255"),
        ('name = "one"', 'name = "../one"', "cannot be the name of a file"),
        ("[[radar]]", "[[radar", "is not TOML"),
        ("[adsb]", '[[target]]\nkind = "replay"\nrecording = "nowhere.ast"\n[adsb]', "there is no such file"),
        ("[adsb]", '[[target]]\nkind = "replay"\nrecording = "."\n[adsb]', "is a folder"),
    ],
)
def test_scenarios_with_numbers_that_are_none(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "s.toml"
    path.write_text(scene(radar(), EIGHT).replace(old, new, 1))
    line = mistake("simulate", path, "--out", tmp_path / "out", numbers=False)
    assert said in line
    nothing_left(tmp_path / "out")


def test_files_and_options_that_simulate_cannot_use(tmp_path: Path) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "out"
    path.write_text(scene(radar(), EIGHT))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "file").write_text("precious")
    for arguments, said in (
        ([tmp_path / "nowhere.toml", "--out", out], "No such file"),
        ([tmp_path, "--out", out], "Is a directory"),
        ([tmp_path / "binary.toml", "--out", out], "is not TOML"),
        ([path, "--out", tmp_path / "file"], "cannot be made or written to"),
        ([path, "--out", tmp_path / "file" / "below"], "cannot be made or written to"),
        ([path, "--out", out, "--duration", "nan"], "--duration nan"),
        ([path, "--out", out, "--duration", "-5"], "--duration -5"),
        ([path, "--out", out, "--seed", "abc"], "--seed"),
        ([path], "--out"),
    ):
        assert said in mistake("simulate", *arguments, numbers=False)
    assert (tmp_path / "file").read_text() == "precious"
    nothing_left(out)


def test_files_and_options_that_calibrate_cannot_use(twins: Path, tmp_path: Path) -> None:
    whole = (twins / "one.ast").read_bytes()
    (tmp_path / "empty.ast").touch()
    (tmp_path / "cut.ast").write_bytes(whole[:7])
    (tmp_path / "noise.ast").write_bytes(np.random.default_rng(1).bytes(4000))
    (tmp_path / "file").write_text("precious")
    sensors = (twins / "sensors.toml").read_text()
    (tmp_path / "nan.toml").write_text(sensors.replace("lat_deg = 50.0", "lat_deg = nan", 1))
    (tmp_path / "none.toml").write_text("")
    head, plots, *rest = against(twins)

    def but(**change: str | Path) -> list[str | Path]:
        arguments = [head, change.get("plots", plots), *rest]
        for name, value in change.items():
            if name != "plots":
                arguments[arguments.index(f"--{name}") + 1] = value
        return arguments

    for arguments, said in (
        (but(plots=tmp_path / "nowhere.ast"), "nowhere.ast"),
        (but(plots=tmp_path / "empty.ast"), "empty.ast"),
        (but(plots=tmp_path / "cut.ast"), "cut.ast"),
        (but(plots=tmp_path / "noise.ast"), "noise.ast"),
        (but(plots=tmp_path), "is a folder"),
        (but(reference=tmp_path / "nowhere.ast"), "nowhere.ast"),
        (but(reference=twins / "one.ast"), "one.ast"),
        (but(plots=twins / "adsb.ast", reference=twins / "one.ast"), "are they exchanged?"),
        (but(sensors=tmp_path / "nan.toml"), "nan.toml"),
        (but(sensors=tmp_path / "none.toml"), "none.toml"),
        (but(sensors=tmp_path), str(tmp_path)),
        (but(date="2026-13-01"), "--date"),
        ([*but(), "--out", tmp_path / "file"], "is no folder that can be written to"),
        ([*but(), "--out", tmp_path / "file" / "below"], "is no folder that can be written to"),
        ([*but(), "--method", "igmsr", "--option", "tau_s=nan"], "tau_s"),
        ([*but(), "--method", "igmsr", "--option", "tau_s=-1"], "tau_s"),
        ([*but(), "--method", "genetic", "--option", "generations=0"], "generations"),
        ([*but(), "--associate-option", "range_window_m=nan"], "range_window_m"),
        ([*but(), "--associate-option", "azimuth_window_deg=-3"], "azimuth_window_deg"),
        ([*but(), "--option", "nonsense"], "nonsense"),
        ([*but(), "--requirement", "nowhere.toml"], "nowhere.toml"),
    ):
        assert said in mistake(*arguments, numbers=False), arguments
    assert (tmp_path / "file").read_text() == "precious"
    assert not (tmp_path / "out").exists()


def test_damage_in_the_middle_is_counted_and_the_rest_is_used(twins: Path, tmp_path: Path) -> None:
    octets = bytearray((twins / "one.ast").read_bytes())
    octets[len(octets) // 2 : len(octets) // 2 + 40] = b"\xff" * 40
    (tmp_path / "one.ast").write_bytes(octets)
    head, _, *rest = against(twins)
    found = checked(worked(head, tmp_path / "one.ast", *rest, "--json"))
    assert any("damaged place" in warning for warning in found["warnings"])


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C interrupts, also where the tests run in the background and the shell has told them to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("way", ["static", "online", "relative", "simulate"])
def test_interrupted_while_it_writes(twins: Path, tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)

    out = tmp_path / "out"
    arguments: list[str | Path] = {
        "static": against(twins),
        "online": [*against(twins), "--online"],
        "relative": ["calibrate", twins / "one.ast", twins / "two.ast", "--sensors", twins / "sensors.toml"],
        "simulate": ["simulate", twins.parent / "scene.toml"],
    }[way]
    monkeypatch.setattr("boresight.report.write_report", interrupted)
    monkeypatch.setattr("boresight.simulation.files.write_text", interrupted)
    said = run(*arguments, "--out", out)
    assert (said.code, said.out) == (130, "")
    assert said.err.splitlines()[-1] == "boresight: interrupted; nothing half-written was left"
    nothing_left(out)
