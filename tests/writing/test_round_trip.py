"""What is written is what is read: random tables through the writer and `boresight.reading`."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest
from random_tables import MIDNIGHT_S, some_fixes, some_plots

from boresight.measure import wrap_rad
from boresight.model import Channel, Fixes, Flag, Plots
from boresight.reading import read
from boresight.writing.asterix import accuracy_sd_m, write_asterix

DATE = datetime.date(2026, 3, 1)
COLUMNS = {
    48: {"pressure_altitude_m": 7.62, "height_m": 7.62, "psr_ssr_range_m": 1852 / 256, "psr_ssr_azimuth_rad": 2 * np.pi / 16384},
    10: {"pressure_altitude_m": 7.62, "length_m": 1.0},
}


def same(found: np.ndarray, given: np.ndarray, quantum: float, name: str) -> None:
    np.testing.assert_array_equal(np.isnan(found), np.isnan(given), err_msg=name)
    np.testing.assert_allclose(found, given, rtol=0, atol=0.501 * quantum, err_msg=name)


@pytest.mark.parametrize("category", [48, 10])
def test_plots(tmp_path: Path, category: int) -> None:
    plots = some_plots(11, 400, 60e3)
    if category == 10:
        plots = plots.replace(
            channel=np.full(len(plots), Channel.PSR), flags=plots.flags & int(Flag.SIMULATED | Flag.TEST | Flag.TRACK_END)
        )
    path = tmp_path / "plots.ast"
    write_asterix(path, plots, category=category)
    recording = read(path, date=DATE)
    found = recording.plots
    assert not recording.damaged
    assert len(found) == len(plots)
    same(found.time_s, plots.time_s, 1 / 128, "time_s")
    same(found.range_m, plots.range_m, 1852 / 256 if category == 48 else 1.0, "range_m")
    assert np.abs(wrap_rad(found.azimuth_rad - plots.azimuth_rad)).max() <= 0.501 * 2 * np.pi / 65536
    for name, quantum in COLUMNS[category].items():
        same(getattr(found, name), getattr(plots, name), quantum, name)
    for name in ("sensor", "channel", "mode_s", "mode_3a", "callsign", "track", "flags"):
        given = getattr(plots, name)
        if name == "mode_3a" and category == 48:
            # A garbled code is no identity: the reader leaves it out.
            given = np.where(plots.flags & int(Flag.GARBLED) > 0, -1, given)
        np.testing.assert_array_equal(getattr(found, name), given, err_msg=name)
    if category == 48:
        moving = np.isfinite(plots.speed_mps) & np.isfinite(plots.heading_rad)
        same(found.speed_mps, np.where(moving, plots.speed_mps, np.nan), 1852 / 16384, "speed_mps")
        np.testing.assert_allclose(wrap_rad(found.heading_rad - plots.heading_rad)[moving], 0, atol=5e-5)


def test_fixes(tmp_path: Path) -> None:
    fixes = some_fixes(12, 400)
    # 180 degrees east is written, and so read, as 180 degrees west.
    fixes = fixes.replace(longitude_rad=np.where(fixes.longitude_rad == np.pi, -np.pi, fixes.longitude_rad))
    path = tmp_path / "fixes.ast"
    write_asterix(path, fixes=fixes)
    recording = read(path, date=DATE, editions={21: "2.4"})
    found = recording.fixes
    assert not recording.damaged
    assert len(found) == len(fixes)
    same(found.time_s, fixes.time_s, 1 / 128, "time_s")
    for name, quantum in (
        ("latitude_rad", np.radians(180 / 2**30)),
        ("longitude_rad", np.radians(180 / 2**30)),
        ("height_m", 6.25 * 0.3048),
        ("pressure_altitude_m", 7.62),
        ("velocity_up_mps", 6.25 * 0.3048 / 60),
    ):
        same(getattr(found, name), getattr(fixes, name), quantum, name)
    moving = np.isfinite(fixes.velocity_east_mps) & np.isfinite(fixes.velocity_north_mps)
    for name in ("velocity_east_mps", "velocity_north_mps"):
        same(getattr(found, name), np.where(moving, getattr(fixes, name), np.nan), 0.2, name)
    for name in ("source", "mode_s", "mode_3a", "callsign", "track", "flags"):
        np.testing.assert_array_equal(getattr(found, name), getattr(fixes, name), err_msg=name)
    # Accuracy comes back as the bound of the class that holds it.
    known = np.isfinite(found.horizontal_sd_m)
    assert (found.horizontal_sd_m[known] >= fixes.horizontal_sd_m[known] * 0.998).all()
    assert known.sum() > 100


def test_accuracy_classes_come_back_as_they_were(tmp_path: Path) -> None:
    classes = np.arange(1, 12)
    fixes = Fixes(
        time_s=MIDNIGHT_S + classes, source=np.full(11, 7), latitude_rad=np.full(11, 0.7), longitude_rad=np.full(11, 0.03),
        horizontal_sd_m=accuracy_sd_m(classes), mode_s=classes,
    )  # fmt: skip
    write_asterix(tmp_path / "a.ast", fixes=fixes)
    np.testing.assert_allclose(read(tmp_path / "a.ast", date=DATE).fixes.horizontal_sd_m, fixes.horizontal_sd_m, rtol=1e-3)


@pytest.mark.real
def test_a_real_recording_written_and_read_again(tmp_path: Path, data: Path) -> None:
    """Real CAT048 columns survive the writer exactly: they are whole quanta already."""
    original = read(data / "bcn-2023" / "230502-est-080001_BCN_60MN_08_09.ast", date=datetime.date(2023, 5, 2)).plots[:5000]
    original = original.take(np.argsort(original.time_s, kind="stable"))
    write_asterix(tmp_path / "again.ast", original)
    again = read(tmp_path / "again.ast", date=datetime.date(2023, 5, 2)).plots
    assert isinstance(again, Plots)
    for name in (
        "time_s",
        "range_m",
        "azimuth_rad",
        "pressure_altitude_m",
        "psr_ssr_range_m",
        "psr_ssr_azimuth_rad",
        "speed_mps",
    ):
        np.testing.assert_allclose(getattr(again, name), getattr(original, name), rtol=0, atol=1e-6, err_msg=name)
    for name in ("sensor", "channel", "mode_s", "mode_3a", "callsign", "track"):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name), err_msg=name)
