"""``boresight info`` on the real recordings: it tells what is known of each (data/README.md), its chains and its clocks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "boresight", *map(str, arguments)], capture_output=True, text=True, timeout=300)


def view(*arguments: str | Path) -> list[dict[str, Any]]:
    done = run("info", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    files: list[dict[str, Any]] = json.loads(done.stdout)["files"]
    return files


@pytest.mark.real
def test_the_terminal_radar_with_its_two_chains_and_its_clock(data: Path, tmp_path: Path) -> None:
    path = data / "bcn-2023" / "230502-est-080001_BCN_60MN_08_09.ast"
    (file,) = view(path, "--date", "2023-05-02", "--clock", "--out", tmp_path / "clock.svg")
    (source,) = file["sources"]
    assert (source["sac"], source["sic"], source["category"]) == (20, 129, "048")
    assert (source["plots"], source["targets"]) == (44085, 177)
    every = next(row for row in file["psr_minus_ssr"] if row["channel"] == "all")
    assert 185 < every["range_m"] < 200
    assert 0.01 < every["azimuth_deg"] < 0.03
    assert every["slope_m_per_nm"] == pytest.approx(-0.8, abs=0.15)
    combined = next(row for row in file["psr_minus_ssr"] if row["channel"] == "SSR + PSR")
    assert combined["range_m"] == pytest.approx(265, abs=5)
    (rotation,) = file["clocks"]["rotations"]
    assert rotation["period_s"] == pytest.approx(4.0015, abs=1e-4)
    assert rotation["jitter_s"] == pytest.approx(0.0032, abs=2e-4)
    assert "<svg" in (tmp_path / "clock.svg").read_text()
    said = run("info", path, "--date", "2023-05-02", "--clock").stdout
    for words in ("PSR - SSR", "SSR + PSR", "turns in 4.00153 s", "jitter by 3.2 ms", "44,085 plots", "177"):
        assert words in said
    assert "…" not in said


@pytest.mark.real
def test_the_small_samples(data: Path) -> None:
    folder = data / "croatia"
    names = [
        "asterix.pcap",
        "cat048.raw",
        "cat21_re.ast",
        "cat_001_002.pcap",
        "cat_034_048.pcap",
        "cat_062_065.pcap",
        "parsegps.gps",
    ]
    files = view(*(folder / name for name in names))
    assert [f["by_category"] for f in files] == [
        {"062": 100}, {"048": 1}, {"021": 2}, {"001": 7, "002": 1}, {"034": 34, "048": 128}, {"062": 2, "065": 1},
        {"034": 3, "048": 15},
    ]  # fmt: skip
    assert all(f["damaged"] == [] for f in files)
    assert [f["tracks"] for f in files] == [100, 0, 0, 0, 0, 2, 0]
    assert files[0]["sources"][0]["edition"] == "0.17"
    assert files[0]["sources"][0]["start"].startswith("2008-05-15T12:47:45.75")
    assert files[3]["sources"][0]["start"].startswith("2014-02-25T12:43:44")
    split = next(s for s in files[4]["sources"] if (s["sic"], s["category"]) == (12, "034"))
    assert (split["latitude_deg"], split["height_m"]) == (pytest.approx(43.571, abs=1e-3), 780)


@pytest.mark.parametrize("arguments", [("a.ast", "b.ast", "--out", "c.png"), ("a.ast", "--out", "c.txt")])
def test_a_figure_that_cannot_be_is_one_line(arguments: tuple[str, ...]) -> None:
    done = run("info", *arguments)
    assert done.returncode == 2
    assert "--out" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
