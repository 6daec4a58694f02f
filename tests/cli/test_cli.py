"""The command line as a user meets it: help, mistakes (one line, exit code 2, no traceback), JSON that holds the contract."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from barcelona import SENSORS


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    return subprocess.run([sys.executable, "-m", "boresight", *map(str, arguments)], capture_output=True, text=True, timeout=300)


def mistake(*arguments: str | Path) -> str:
    """Run what must fail as a user's mistake; returns the one line that it says."""
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("boresight: ")
    return lines[0]


@pytest.fixture
def sensors(tmp_path: Path) -> Path:
    path = tmp_path / "sensors.toml"
    path.write_text(SENSORS)
    return path


def test_help_and_version() -> None:
    done = run("--help")
    assert done.returncode == 0
    for command in ("demo", "info", "calibrate", "correct", "warm"):
        assert command in done.stdout
    assert run("--version").stdout.strip() == "0.1.0"


def test_unknown_command_and_option(sensors: Path) -> None:
    assert "calibarte" in mistake("calibarte")
    assert "--referenze" in mistake("calibrate", "a.ast", "--referenze", "b.ast", "--sensors", sensors)
    assert "--sensors" in mistake("calibrate", "a.ast", "--reference", "b.ast")


def test_missing_empty_and_wrong_files(tmp_path: Path, sensors: Path) -> None:
    assert "nowhere.ast" in mistake("info", tmp_path / "nowhere.ast")
    empty = tmp_path / "empty.ast"
    empty.touch()
    assert "empty" in mistake("info", empty)
    text = tmp_path / "letter.ast"
    text.write_text("Dear surveillance engineer,\nthe recording follows by post.\n" * 20)
    assert "letter.ast" in mistake("info", text)
    assert str(tmp_path) in mistake("info", tmp_path)
    assert "sensors.toml" in mistake("calibrate", text, "--reference", text, "--sensors", tmp_path / "other" / "sensors.toml")


def test_bad_dates_and_editions(tmp_path: Path) -> None:
    assert "2016-05-10" in mistake("info", tmp_path, "--date", "10.5.2016")
    assert "1970 … 2200" in mistake("info", tmp_path, "--date", "9999-12-31")
    assert "021=0.23" in mistake("info", tmp_path, "--edition", "0.23")


def test_correct_never_writes_over_an_input(tmp_path: Path) -> None:
    recording = tmp_path / "radar.parquet"
    recording.write_bytes(b"precious")
    assert "one of the inputs" in mistake("correct", recording, "--calibration", tmp_path / "c.json", "--out", recording)
    assert "--overwrite" in mistake("correct", tmp_path / "a.ast", "--calibration", tmp_path / "c.json", "--out", recording)
    assert recording.read_bytes() == b"precious"


@pytest.mark.real
def test_info_on_real_recordings(data: Path) -> None:
    smr = data / "lebl-2016" / "smr_cat010_160510-lebl-220001.ast"
    adsb = data / "lebl-2016" / "adsb_cat021v023_160510-lebl-220001.ast"
    done = run("info", smr, adsb, "--date", "2016-05-10", "--json")
    assert done.returncode == 0, done.stderr
    first, second = json.loads(done.stdout)["files"]
    assert first["records"] == 77_345
    assert first["by_category"] == {"010": 77_345}
    assert sum(s["plots"] for s in first["sources"]) == 62_097
    assert first["sources"][0]["start"].startswith("2016-05-10T22:00:0")
    assert first["sources"][0]["end"].startswith("2016-05-11T00:0")
    assert first["damaged"] == []
    assert second["records"] == 49_330
    assert {s["edition"] for s in second["sources"]} == {"0.23"}


@pytest.mark.parametrize("raised", ["KeyboardInterrupt()", "SystemError('a result with an exception set')"])
def test_an_interruption_is_one_line_and_130(raised: str) -> None:
    """Inside compiled code Ctrl-C comes out as a SystemError whose cause it is."""
    script = f"""
from boresight import cli

def command():
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise {raised} from error

cli.app.command(command, name="stop")
cli.main(["stop"])
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130, done.stderr
    assert done.stderr == "boresight: interrupted; nothing half-written was left\n"


def test_a_seed_is_not_negative(tmp_path: Path) -> None:
    assert "--seed" in mistake("demo", "--seed", "-1", "--out", tmp_path / "demo")
    assert not (tmp_path / "demo").exists()
