"""Tables written as Parquet and CSV, read back by DuckDB and by the csv module."""

from __future__ import annotations

import csv
import datetime
from dataclasses import dataclass
from pathlib import Path

import duckdb
import numpy as np
import pytest

from boresight._types import FloatArray
from boresight.errors import InputError
from boresight.model import Channel, Fixes, Pairs, Plots, pack_callsigns
from boresight.writing.tables import write_table

PLOTS = Plots(
    time_s=[1_772_323_200.0 + 1 / 128, 1_772_323_201.5, np.nan],
    sensor=[5249, 5249, 7],
    channel=[Channel.MODE_S, Channel.PSR, Channel.UNKNOWN],
    range_m=[1000.25, 2e5, 3.0],
    azimuth_rad=np.radians([359.9945068359375, 10.0, 0.0]),
    mode_s=[0x34510F, -1, 0],
    mode_3a=[0o7000, 0o21, -1],
    callsign=pack_callsigns(["IBE3166", "", "VLG8301"]),
    track=[4095, -1, 0],
)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_csv_speaks_degrees_and_iso_time(tmp_path: Path) -> None:
    path = tmp_path / "plots.csv"
    assert write_table(path, PLOTS) == 3
    first, second, third = rows_of(path)
    assert first["time"] == "2026-03-01T00:00:00.007813Z"
    assert datetime.datetime.fromisoformat(second["time"]).timestamp() == PLOTS.time_s[1]
    assert third["time"] == ""
    assert float(first["azimuth_deg"]) == pytest.approx(359.9945068359375, abs=1e-12)
    assert "azimuth_rad" not in first
    assert [row["mode_s"] for row in (first, second, third)] == ["34510F", "", "000000"]
    assert [row["mode_3a"] for row in (first, second, third)] == ["7000", "0021", ""]
    assert [row["callsign"] for row in (first, second, third)] == ["IBE3166", "", "VLG8301"]
    assert [row["track"] for row in (first, second, third)] == ["4095", "", "0"]
    assert [row["channel"] for row in (first, second, third)] == ["mode_s", "psr", "unknown"]
    assert float(first["range_m"]) == 1000.25
    assert first["elevation_deg"] == ""


def test_parquet_types_and_values(tmp_path: Path) -> None:
    path = tmp_path / "plots.parquet"
    write_table(path, PLOTS)
    types = {row[0]: row[1] for row in duckdb.sql(f"DESCRIBE SELECT * FROM '{path}'").fetchall()}
    assert (types["time"], types["azimuth_deg"], types["mode_s"]) == ("TIMESTAMP", "DOUBLE", "VARCHAR")
    found = duckdb.sql(f"SELECT time, azimuth_deg, mode_s, height_m FROM '{path}'").fetchall()
    moment = datetime.datetime(2026, 3, 1, 0, 0, 1, 500000)
    assert found[1] == (moment, pytest.approx(10.0, abs=1e-12), None, None)
    assert found[2][0] is None


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_same_table_same_bytes(tmp_path: Path, ending: str) -> None:
    n = 20_000
    rng = np.random.default_rng(5)
    fixes = Fixes(time_s=1.7e9 + np.arange(n), latitude_rad=rng.uniform(-1, 1, n), mode_s=rng.integers(0, 1 << 24, n))
    for name in "ab":
        write_table(tmp_path / f"{name}.{ending}", fixes)
    assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    found = duckdb.sql(f"SELECT latitude_deg FROM '{tmp_path}/a.{ending}'").fetchnumpy()["latitude_deg"]
    np.testing.assert_allclose(found, np.degrees(fixes.latitude_rad), rtol=0, atol=1e-12)


def test_inner_tables_and_wide_columns(tmp_path: Path) -> None:
    pairs = Pairs(plot=[0, 1], plots=PLOTS[:2], target=[3, -1], position=np.arange(6.0).reshape(2, 3))
    write_table(tmp_path / "pairs.csv", pairs)
    first, second = rows_of(tmp_path / "pairs.csv")
    assert (first["target"], second["target"]) == ("3", "")
    assert [float(second[f"position_{k}"]) for k in range(3)] == [3, 4, 5]
    assert first["plots_mode_s"] == "34510F"
    assert first["plots_time"].startswith("2026-03-01T00:00:00")
    assert float(second["plots_azimuth_deg"]) == pytest.approx(10.0)


def test_mappings_and_dataclasses(tmp_path: Path) -> None:
    @dataclass
    class Residuals:
        before_rad: FloatArray
        name: list[str]

    write_table(tmp_path / "a.csv", {'say "it"': np.array([1, -1]), "who": ["O'Hare", "ü"], "good": np.array([True, False])})
    assert rows_of(tmp_path / "a.csv") == [
        {'say "it"': "1", "who": "O'Hare", "good": "true"},
        {'say "it"': "-1", "who": "ü", "good": "false"},
    ]
    write_table(tmp_path / "b.csv", Residuals(np.array([np.pi]), ["x"]))
    assert rows_of(tmp_path / "b.csv") == [{"before_deg": "180.0", "name": "x"}]


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_an_empty_table_keeps_its_columns(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"empty.{ending}"
    assert write_table(path, Plots()) == 0
    assert "azimuth_deg" in duckdb.sql(f"SELECT * FROM '{path}'").columns


def test_clear_messages(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Name it .parquet or .csv"):
        write_table(tmp_path / "a.xlsx", PLOTS)
    with pytest.raises(InputError, match="columns of one length"):
        write_table(tmp_path / "a.csv", {"a": [1, 2], "b": [1]})
    with pytest.raises(InputError, match="does not exist"):
        write_table(tmp_path / "no" / "a.csv", PLOTS)
    assert list(tmp_path.iterdir()) == []
