"""Barcelona 2016: a surface movement radar against multilateration and against ADS-B, from file to result.

The bounds are those of an independent first fit of the same recordings.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from barcelona import SENSORS

pytestmark = pytest.mark.real


def calibrate(data: Path, folder: Path, reference: str, *options: str) -> dict[str, Any]:
    """The result for the radar, from the command that a user gives."""
    (folder / "sensors.toml").write_text(SENSORS)
    lebl = data / "lebl-2016"
    arguments = ["calibrate", lebl / "smr_cat010_160510-lebl-220001.ast", "--reference", lebl / reference]
    arguments += ["--sensors", folder / "sensors.toml", "--date", "2016-05-10", "--out", folder / "out", "--json", *options]
    done = subprocess.run([sys.executable, "-m", "boresight", *map(str, arguments)], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    for name in ("calibration.json", "residuals.parquet", "report.html"):
        assert (folder / "out" / name).stat().st_size > 1000
    return dict(result["sensors"]["SMR"])


def value(result: dict[str, Any], term: str) -> float:
    return float(result["terms"][term]["value"])


def extent_at_mean_length(result: dict[str, Any]) -> float:
    """Echo behind the transponder's antenna (m) for a target of 33 m, the mean of the recording."""
    terms = result["terms"]
    return sum(terms[t]["value"] * k for t, k in (("along_heading", 1.0), ("along_heading_per_length", 33.0)) if t in terms)


def test_against_multilateration(data: Path, tmp_path: Path) -> None:
    result = calibrate(data, tmp_path, "mlat_cat010_160510-lebl-220001.ast")
    assert result["plots"] >= 6000
    assert 0.08 <= value(result, "azimuth_bias") <= 0.26
    assert abs(value(result, "range_bias")) <= 4
    assert abs(value(result, "time_offset")) <= 0.3
    per_metre = result["terms"].get("along_heading_per_length", {}).get("value", 0.0)
    assert -16 <= extent_at_mean_length(result) <= -5 or -0.55 <= per_metre <= -0.25
    held_out = result["held_out"]
    assert held_out["after_median_m"] <= held_out["before_median_m"] / 2
    assert held_out["after_median_m"] <= 5.6
    assert held_out["after_p95_m"] < held_out["before_p95_m"]
    # The extent by length wins over a constant one, and is to be applied.
    assert "along_heading_per_length" in result["terms"]
    assert {v["term"]: v["decision"] for v in result["verdicts"]}["along_heading_per_length"] == "apply"
    assert result["after"]["p95_m"] <= result["before"]["p95_m"]
    for term in result["terms"].values():
        assert term["sd"] > 0


def test_against_ads_b(data: Path, tmp_path: Path) -> None:
    result = calibrate(data, tmp_path, "adsb_cat021v023_160510-lebl-220001.ast", "--edition", "021=0.23")
    assert result["plots"] >= 4000
    assert 0.08 <= value(result, "azimuth_bias") <= 0.26
    assert abs(value(result, "range_bias")) <= 4
    assert -0.85 <= value(result, "time_offset") <= -0.1


def test_without_extent_the_confounding_is_said(data: Path, tmp_path: Path) -> None:
    result = calibrate(data, tmp_path, "mlat_cat010_160510-lebl-220001.ast", "--model", "range_bias,azimuth_bias,time_offset")
    said = json.dumps(result, ensure_ascii=False)
    assert "extent" in said
    assert "time" in said
    assert "confounded" in said
