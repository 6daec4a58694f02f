"""The calibration's file: what goes in comes out, in the units of the terms; what is no calibration is refused with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from boresight.calibration import (
    SCHEMA,
    Accuracy,
    Calibration,
    Choice,
    Effect,
    Input,
    Noise,
    NotDetermined,
    Share,
    Summary,
    TermKey,
    Verdict,
    load_calibration,
    save_calibration,
    summary_json,
)
from boresight.errors import InputError
from boresight.terms import DEG, TERMS

NAMES = ("range_bias", "range_gain", "azimuth_bias", "time_offset")


def example(epochs: int = 1) -> Calibration:
    rng = np.random.default_rng(5)
    units = np.array([TERMS[n].si_per_unit for n in NAMES])
    root = rng.normal(size=(epochs, 4, 4))
    return Calibration(
        terms=tuple(TermKey(257, "all", n, TERMS[n].unit) for n in NAMES),
        epoch_s=1.7e9 + np.arange(epochs) * 60.0,
        value=np.tile(np.array([-37.25, 0.4, 0.162, -0.05]) * units, (epochs, 1)),
        covariance=root @ np.swapaxes(root, 1, 2) * np.outer(units, units) * 1e-2,
        sensors=(
            Summary(
                sensor=257, name="A", model="atc", noise=Noise(31.25, 0.07 * DEG), plots=12345, tracks=31, targets=30,
                before=Accuracy(812.5, 1500.0), after=Accuracy(70.0, 210.0), held_out_before_median_m=812.5,
                held_out_after_median_m=71.0, effective_targets=24.5, notes=("a note",),
                effects=(Effect("azimuth_bias", 100.0, 0.0075 * DEG), Effect("time_offset", np.inf, 0.125)),
                verdicts=(
                    Verdict(channel="all", term="azimuth_bias", decision="apply", why="it helps", gain_m=12.5, gain_low_m=8.0,
                            gain_high_m=17.0),
                    Verdict(channel="all", term="range_gain", decision="insufficient", why="one target"),
                ),
                criterion="cross-validation",
                choices=(Choice(action="start", term="", criterion=4.5), Choice(action="add", term="range_gain", criterion=4.25,
                                                                                change=-0.25, change_sd=0.125, why="better")),
                budget=(Share("bias", 37.5, 220.0), Share("timing", np.nan, 3.0)),
            ),
        ),
        not_determined=(NotDetermined(257, "elevation_bias", "the sensor measures no elevation"),),
        inputs=(Input("radar.ast", "ab" * 32, 10),),
        warnings=("a warning",),
        settings={"method": "least-squares", "hard_sd": 6.0},
        version="0.1.0",
    )  # fmt: skip


@pytest.mark.parametrize("epochs", [1, 3])
def test_round_trip(tmp_path: Path, epochs: int) -> None:
    before = example(epochs)
    save_calibration(before, tmp_path / "c.json")
    after = load_calibration(tmp_path / "c.json")
    assert after.terms == before.terms
    assert np.allclose(after.value, before.value, rtol=1e-15, atol=0)
    assert np.allclose(after.covariance, before.covariance, rtol=1e-14, atol=0)
    assert np.array_equal(after.epoch_s, before.epoch_s)
    s, t = before.sensors[0], after.sensors[0]
    assert np.isnan(t.noise.elevation_rad)
    assert t.noise.azimuth_rad == pytest.approx(s.noise.azimuth_rad, rel=1e-15)
    assert (t.name, t.before, t.held_out_after_median_m, t.notes) == (s.name, s.before, s.held_out_after_median_m, s.notes)
    assert np.isnan(t.held_out_after_p95_m)
    # NaN equals nothing, so what may hold one is compared as text.
    for field in ("effects", "verdicts", "criterion", "choices", "budget"):
        assert repr(getattr(t, field)) == repr(getattr(s, field))
    assert (after.not_determined, after.inputs, after.warnings, after.settings, after.version) == (
        before.not_determined, before.inputs, before.warnings, before.settings, before.version,
    )  # fmt: skip
    # The same calibration gives the same bytes.
    save_calibration(before, tmp_path / "d.json")
    assert (tmp_path / "c.json").read_bytes() == (tmp_path / "d.json").read_bytes()
    # Nothing else is left behind.
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json", "d.json"]


def test_the_file_is_in_the_units_of_the_terms(tmp_path: Path) -> None:
    c = example()
    save_calibration(c, tmp_path / "c.json")
    data = json.loads((tmp_path / "c.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert data["schema"] == SCHEMA
    assert data["epoch"] == ["2023-11-14T22:13:20Z"]
    assert data["value"][0] == pytest.approx([-37.25, 0.4, 0.162, -0.05])
    covariance = np.array(data["covariance"][0])
    assert data["sd"][0] == pytest.approx(np.sqrt(np.diag(covariance)))
    assert covariance[0, 2] == pytest.approx(c.covariance[0, 0, 2] / DEG)
    assert data["sensors"][0]["noise"] == {"range_m": 31.25, "azimuth_deg": pytest.approx(0.07), "elevation_deg": None}


def test_json_of_calibrate() -> None:
    out = json.loads(json.dumps(summary_json(example()), allow_nan=False))
    a = out["sensors"]["A"]
    assert a["terms"]["azimuth_bias"] == {
        "value": pytest.approx(0.162),
        "sd": pytest.approx(a["terms"]["azimuth_bias"]["sd"]),
        "unit": "deg",
    }
    assert set(a) == {
        "model", "terms", "noise", "plots", "tracks", "targets", "before", "after", "held_out", "not_determined", "verdicts",
        "criterion", "choices",
    }  # fmt: skip
    assert a["noise"] == {"range_m": 31.25, "azimuth_deg": pytest.approx(0.07)}
    assert (a["plots"], a["tracks"], a["targets"]) == (12345, 31, 30)
    assert a["before"] == {"median_m": 812.5, "p95_m": 1500.0}
    assert (a["held_out"]["before_median_m"], a["held_out"]["after_median_m"]) == (812.5, 71.0)
    assert a["not_determined"] == [{"term": "elevation_bias", "why": "the sensor measures no elevation"}]
    assert a["verdicts"][0] == {
        "term": "azimuth_bias", "decision": "apply", "gain_m": 12.5, "gain_95_m": [8.0, 17.0], "why": "it helps",
    }  # fmt: skip
    assert a["verdicts"][1]["gain_m"] is None
    assert out["inputs"] == [{"path": "radar.ast", "sha256": "ab" * 32, "bytes": 10}]
    assert out["warnings"] == ["a warning", "A: a note"]


def test_the_table_to_read() -> None:
    text = str(example())
    assert "A (atc): 12,345 plots, 31 tracks, 30 targets" in text
    row = next(line for line in text.splitlines() if "azimuth_bias" in line).split()
    assert row[0] == "azimuth_bias"
    assert row[-1] == "deg"
    # Value and sd have the same number of decimals.
    assert len(row[1].split(".")[1]) == len(row[2].split(".")[1])
    assert "not determined: elevation_bias: the sensor measures no elevation" in text
    assert "note: a note" in text
    assert str(Calibration((), np.zeros(1), np.zeros((1, 0)), np.zeros((1, 0, 0)))) == "no sensor was calibrated"


def test_intervals_are_those_of_the_t_distribution() -> None:
    """23.5 degrees of freedom: t 0.975 is 2.066; its sd is sqrt(23.5 / 21.5) scales (tables of the t distribution)."""
    c = example()
    low, high = np.moveaxis(c.interval(0.95), -1, 0)
    assert np.allclose((low + high) / 2, c.value)
    assert np.allclose((high - low) / 2 / c.sd, 2.0662 * np.sqrt(21.5 / 23.5), rtol=1e-3)
    assert c.index(257, "time_offset") == 3
    assert c.index(257, "site_up") is None


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d.update(schema="boresight-calibration/99"), "schema"),
        (lambda d: d.pop("value"), "value"),
        (lambda d: d["terms"][0].update(term="warp_drive"), "warp_drive"),
        (lambda d: d["terms"][0].update(unit="km"), "unit"),
        (lambda d: d["terms"][1].update(sensor=5), "sensor 5"),
        (lambda d: d["covariance"][0].pop(), "covariance"),
        (lambda d: d["value"][0].append(1.0), "value"),
        (lambda d: d.update(more=1), "more"),
        (lambda d: d["sensors"][0]["effects"][0].update(term="warp_drive"), "warp_drive"),
        (lambda d: d["sensors"][0]["verdicts"][0].update(decision="maybe"), "maybe"),
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path: Path, change, match: str) -> None:
    path = tmp_path / "c.json"
    save_calibration(example(), path)
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match=match) as caught:
        load_calibration(path)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("text", [b"", b"not json", b"[1, 2]", b'{"a": 1}', b"\xff\xfe\x00"])
def test_other_files_are_refused(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(text)
    with pytest.raises(InputError, match="is no calibration"):
        load_calibration(path)


def test_places_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        load_calibration(tmp_path / "absent.json")
    with pytest.raises(InputError, match="does not exist"):
        save_calibration(example(), tmp_path / "no folder" / "c.json")
    # A file that is replaced is whole at every moment: a failing save leaves the old one.
    path = tmp_path / "c.json"
    save_calibration(example(), path)
    old = path.read_bytes()
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError):
        save_calibration(example(), tmp_path / "folder")
    assert path.read_bytes() == old
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json", "folder"]
