"""Tables: shapes, selection, joining, frames; sensors.toml and its mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import InputError, SettingsError
from boresight.model import Pairs, Plots, load_sensors, pack_callsigns, unpack_callsigns


def test_absent_columns_are_nan_or_minus_one() -> None:
    plots = Plots(time_s=[1.0, 2.0])
    assert np.isnan(plots.range_m).all()
    assert (plots.mode_s == -1).all()
    assert (plots.flags == 0).all()
    assert plots.range_m.dtype == np.float64
    assert plots.sensor.dtype == np.int32


def test_selection_and_joining_keep_every_column() -> None:
    plots = Plots(time_s=np.arange(5.0), track=np.arange(5), range_m=np.arange(5) * 10.0)
    both = Plots.concat([plots[plots.time_s > 2], plots.take(np.array([0]))])
    assert both.track.tolist() == [3, 4, 0]
    assert both.range_m.tolist() == [30, 40, 0]
    assert len(Plots.concat([])) == 0
    pairs = Pairs(plot=np.arange(5), plots=plots)[np.array([4, 1])]
    assert pairs.plots.track.tolist() == [4, 1]
    assert pairs.position.shape == (2, 3)
    assert pairs.weight.tolist() == [1, 1]


def test_columns_of_other_lengths_are_refused_by_name() -> None:
    with pytest.raises(InputError, match="range_m"):
        Plots(time_s=[1.0, 2.0], range_m=[1.0])
    with pytest.raises(InputError, match="position"):
        Pairs(plot=[1], plots=Plots(time_s=[1.0]), position=[[1.0, 2.0]])


def test_frames_round_trip_and_name_unknown_columns() -> None:
    plots = Plots(time_s=[1.0, 2.0], range_m=[3.0, np.nan], mode_s=[5, -1])
    again = Plots.from_frame(dict(plots._flat()))
    assert [np.array_equal(a, b, equal_nan=True) for (_, a), (_, b) in zip(plots._flat(), again._flat(), strict=True)].count(
        False
    ) == 0
    flat = dict(Pairs(plot=[1, 2], plots=plots, covariance=np.arange(18.0).reshape(2, 3, 3))._flat())
    assert flat["covariance_5"].tolist() == [5.0, 14.0]
    assert flat["plots_mode_s"].tolist() == [5, -1]
    with pytest.raises(InputError, match=r"no column 'rnage_m'; it has: time_s"):
        Plots.from_frame({"rnage_m": [1.0]})


@given(st.lists(st.text(alphabet="ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 ", max_size=8), max_size=20))
def test_callsigns_round_trip(names: list[str]) -> None:
    assert unpack_callsigns(pack_callsigns(names)) == [name.rstrip() for name in names]


GOOD = """
[[sensor]]
name = "A"
sac = 1
sic = 2
lat_deg = 41.0
lon_deg = 2.0
height_m = 85.0
kind = "surface"
"""


def test_sensors_are_read(tmp_path: Path) -> None:
    path = tmp_path / "sensors.toml"
    path.write_text(GOOD)
    sensors = load_sensors(path)
    assert [s.name for s in sensors] == ["A"]
    found = sensors.find(1 << 8 | 2)
    assert found is not None
    assert found.ellipsoidal_height_m == 85.0
    assert sensors.find(7) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("lat_deg = 41.0", "lat_deg = 91.0"), r"sensor 1 \('A'\): lat_deg = 91.0 is not within"),
        (("lat_deg = 41.0", "lat_deg = nan"), "lat_deg = nan is not within"),
        (("height_m = 85.0", "height_m = inf"), "height_m = inf is not a number"),
        (("height_m = 85.0", "height_m = 85.0\ntime_offset_s = nan"), "time_offset_s = nan is not a number"),
        (("kind = ", "knid = "), "knid"),
        (('kind = "surface"', 'kind = "sonar"'), "Known kinds: psr"),
        (("sac = 1", "sac = 300"), "sac = 300 is not within 0 … 255"),
        (("sac = 1\nsic = 2", ""), "neither sac and sic nor an id"),
        (('name = "A"', ""), "name"),
        (("lat_deg = 41.0", 'lat_deg = "north"'), "Expected `float"),
        (("[[sensor]]", "[[sensor"), "is not TOML"),
        (('kind = "surface"', 'kind = "surface"\n' + GOOD), "used before"),
    ],
)
def test_mistakes_in_sensors_are_named(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = tmp_path / "sensors.toml"
    path.write_text(GOOD.replace(*change))
    with pytest.raises(SettingsError, match=said) as caught:
        load_sensors(path)
    assert "sensors.toml" in str(caught.value)


def test_missing_sensors_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"nowhere.toml: cannot be read"):
        load_sensors(tmp_path / "nowhere.toml")
