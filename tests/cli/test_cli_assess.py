"""``boresight assess distribution``: on a made result, on the demo (whose samples the pages print), and a user's mistakes."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from boresight.assessment.residuals import Residuals
from boresight.calibration import Accuracy, Calibration, Noise, Summary, TermKey, save_calibration
from boresight.cli import main
from boresight.writing.tables import write_table

DOCS = Path(__file__).parents[2] / "docs"
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*arguments: str) -> tuple[int, str, str]:
        status = 0
        try:
            main(arguments)
        except SystemExit as stop:
            status = int(stop.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return call


def made(folder: Path, parts: list[tuple[int, str, int, np.ndarray]]) -> Path:
    """A result: sensor number, channel, plots a target, and range errors after correction of each part."""
    rng = np.random.default_rng(1)
    tables = []
    for sensor, channel, plots, error in parts:
        n = len(error)
        columns = {f.name: np.zeros(n, f.metadata["dtype"]) for f in fields(Residuals)}
        target = np.arange(n) // plots
        true = rng.uniform(2e4, 1e5, n)
        columns |= {
            "time_s": 1.7e9 + 4.0 * (np.arange(n) % plots),
            "sensor": np.full(n, sensor, np.int32),
            "channel": np.full(n, {"psr": 1, "mode_s": 3}[channel], np.int8),
            "target": target,
            "reference_range_m": true,
            "range_before_m": np.round((true + error + 60) / 18.52) * 18.52 - true,
            "range_after_m": error,
            "azimuth_before_rad": np.full(n, 0.01),
            "azimuth_after_rad": np.zeros(n),
            "elevation_before_rad": np.full(n, np.nan),
            "elevation_after_rad": np.full(n, np.nan),
            "along_after_m": np.where(target == 0, np.nan, error),
        }
        columns["target_name"] = np.array([f"T{k}" for k in target.tolist()], object)
        tables.append(columns)
    write_table(folder / "residuals.parquet", {name: np.concatenate([t[name] for t in tables]) for name in tables[0]})
    nothing = Accuracy(1.0, 2.0)
    summaries = tuple(
        Summary(sensor=key, name=f"radar {key}", model="constant", noise=Noise(5.0, 0.001), plots=600, tracks=2, targets=2,
                before=nothing, after=nothing)
        for key in sorted({part[0] for part in parts})
    )  # fmt: skip
    save_calibration(
        Calibration((TermKey(1, "all", "range_bias", "m"),), np.zeros(1), np.zeros((1, 1)), np.ones((1, 1, 1)), summaries),
        folder / "calibration.json",
    )
    return folder


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One radar with normal errors and few plots of another channel, one with heavy tails."""
    rng = np.random.default_rng(2)
    parts = [
        (1, "mode_s", 50, 20 * rng.normal(size=1500)),
        (1, "psr", 7, rng.normal(size=7)),
        (2, "psr", 40, 20 * rng.standard_t(3, 1200)),
    ]
    return made(tmp_path_factory.mktemp("distribution"), parts)


def test_the_command_prints_text_json_and_a_page(result: Path, run: Run, tmp_path: Path) -> None:
    page, numbers = tmp_path / "page.html", tmp_path / "numbers.json"
    status, out, err = run("assess", "distribution", str(result), "--out", str(page))
    assert (status, err) == (0, "")
    text = page.read_text(encoding="utf-8")
    # Range and azimuth (constant) of two radars; what was not measured and what is too little has no figure.
    assert text.count("<figure") == 4
    assert "http" not in text.replace("http://www.w3.org", "")
    assert not re.search(r"\b(nan|inf)\b", out + re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL), re.IGNORECASE)
    for said in (
        "elevation (deg)\n  not measured",
        "7 residuals: too few",
        "constant: all values are equal",
        "18.52 m = 0.01 NM",
    ):
        assert said in out
    status, out, _ = run("assess", "distribution", str(result), "--json", "--out", str(numbers))
    assert status == 0
    found = json.loads(out)["distribution"]
    assert found == json.loads(numbers.read_text())
    by_name = {(d["sensor"], d["channel"], d["component"]): d for d in found}
    assert by_name["radar 1", "mode_s", "range"]["verdict"].startswith("normal;")
    assert by_name["radar 2", "psr", "range"]["verdict"].startswith("heavy-tailed: Student t")
    assert by_name["radar 2", "psr", "range"]["student"]["freedom"] == pytest.approx(3, rel=0.35)
    assert by_name["radar 1", "mode_s", "range"]["step"] == pytest.approx(18.52, rel=1e-6)
    assert by_name["radar 1", "mode_s", "elevation"]["why"] == "not measured"
    assert by_name["radar 1", "mode_s", "azimuth"]["sd"] == 0


def test_options_take_the_part_that_they_name(result: Path, run: Run) -> None:
    begin = ("assess", "distribution", str(result), "--json", "--component")
    raw = json.loads(run(*begin, "range", "--raw", "--sensor", "radar 1", "--channel", "mode_s")[1])["distribution"]
    assert [(d["corrected"], d["component"]) for d in raw] == [(False, "range")]
    assert raw[0]["mean"] == pytest.approx(60, abs=2)
    some = json.loads(run(*begin, "range", "along", "--targets", "T0", "3", "--sensor", "radar 2")[1])["distribution"]
    assert [(d["plots"], d["targets"]) for d in some] == [(80, 2), (40, 1)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sensor", "radar 9"), "no sensor 'radar 9'. Sensors: radar 1, radar 2"),
        (("--channel", "ssr"), "no plots of channel 'ssr'. Channels: psr, mode_s"),
        (("--channel", "PSR", "--sensor", "radar 2"), "no plots of channel 'PSR'. Channels: psr"),
        (("--targets", "T999"), "no target is called 'T999'. Those with most plots: "),
        (("--targets", "T29", "--sensor", "radar 2", "--component", "elevation"), "elevation: not measured"),
        (("--component", "elevation"), "radar 1, mode_s, elevation: not measured"),
        (("--channel", "psr", "--sensor", "radar 1"), "7 residuals: too few, at least 10 are needed"),
        (("--component", "height"), "height"),
        (("--out", "errors.txt"), "neither .html nor .json"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(result: Path, run: Run, arguments: tuple[str, ...], said: str) -> None:
    status, out, err = run("assess", "distribution", str(result), *arguments)
    assert status == 2
    assert out == ""
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_a_folder_without_a_result_and_a_file_that_exists(result: Path, run: Run, tmp_path: Path) -> None:
    status, _, err = run("assess", "distribution", str(tmp_path))
    assert status == 2
    assert "no residuals.parquet" in err
    there = tmp_path / "there.html"
    there.write_text("mine")
    status, _, err = run("assess", "distribution", str(result), "--out", str(there))
    assert status == 2
    assert "exists" in err
    assert there.read_text() == "mine"


def test_heavy_outliers_leave_the_histogram_to_the_rest(run: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    folder = made(tmp_path, [(1, "psr", 40, np.r_[rng.normal(size=400), 1e6, -3e5])])
    status, out, _ = run("assess", "distribution", str(folder), "--component", "range", "--out", str(tmp_path / "page.html"))
    assert status == 0
    assert "heavy-tailed" in out or "mixture" in out
    assert "2 lie outside the histogram" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("json_too", [(), ("--json",)])
def test_an_example_of_a_requirement_is_never_taken_for_the_document(
    result: Path, run: Run, tmp_path: Path, json_too: tuple[str, ...]
) -> None:
    sensors = tmp_path / "sensors.toml"
    sensors.write_text(
        "".join(
            f'[[sensor]]\nname = "radar {k}"\nid = {k}\nlat_deg = 50.0\nlon_deg = 8.0\nheight_m = 100.0\nkind = "mode_s"\n'
            for k in (1, 2)
        )
    )
    status, out, err = run(
        "assess", "requirement", str(result), "--requirement", "eurocontrol-sur-1997", "--sensors", str(sensors), *json_too
    )
    assert status == 0, err
    assert "(example)" in out
    assert "is marked as an example" in err
    assert "Compare them with the document before a verdict is handed on" in err


# ------------------------------------------------------------------------------------------------------------- samples of pages
def printed(page: str) -> list[tuple[list[str], str, list[str]]]:
    """Of a page that shows the demo: its commands in order, and of the output the lines that the page prints (without "…")."""
    blocks = re.findall(r"(?:^    .*\n|^\n(?=    ))+", (DOCS / page).read_text(encoding="utf-8"), re.M)
    told = [[line[4:].rstrip() for line in block.splitlines() if line.strip()] for block in blocks]
    (commands,) = (block for block in told if block[0] == "boresight demo --out demo")
    sample = told[told.index(commands) + 1]
    return [(shlex.split(commands[1])[1:], commands[1], [line for line in sample if line.strip() != "…"])]


def numbers(line: str) -> tuple[str, list[float]]:
    """A line without its numbers and the room about them, and the numbers."""
    found = re.findall(r"[-+]?\d[\d,]*\.?\d*", line)
    words = re.sub(r"\s+", " ", re.sub(r"[-+]?\d[\d,]*\.?\d*", "#", line))
    return words, [float(f.replace(",", "")) for f in found]


@pytest.mark.slow
def test_the_samples_of_the_pages_are_what_the_demo_says(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("demo", "--out", "demo")[0] == 0
    for page in ("correlation.md", "distribution.md", "plan.md"):
        for arguments, command, sample in printed(page):
            status, out, err = run(*arguments)
            assert status == 0, (command, err)
            said = [numbers(line.rstrip()) for line in out.splitlines()]
            assert len(sample) > 5
            for line in sample:
                words, values = numbers(line)
                same = [v for w, v in said if w == words and len(v) == len(values)]
                # Another machine's rounding may turn the last digit.
                assert any(v == pytest.approx(values, rel=0.02, abs=0.02) for v in same), (page, line, out)
