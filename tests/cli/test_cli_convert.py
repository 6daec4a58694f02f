"""`boresight convert`: what it writes, what it refuses, and what it says was not carried."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from boresight.cli.convert import convert
from boresight.errors import SettingsError
from boresight.model import Plots
from boresight.reading.tables import read_table
from boresight.writing.asterix import write_asterix

TABLE = "ts,Rng,Brg\n1000,1,10\n2000,x,20\n3000,3,30\n"
COLUMNS = '[plots]\ntime = {column="ts", unit="ms"}\nrange = {column="Rng", unit="km"}\nazimuth = {column="Brg", unit="deg"}\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in.csv").write_text(TABLE)
    (tmp_path / "map.toml").write_text(COLUMNS)
    plots = Plots(time_s=1.7e9 + np.arange(9), sensor=[0x0102] * 9, channel=[2] * 9, range_m=[5e3] * 9, azimuth_rad=[1.0] * 9)
    write_asterix(tmp_path / "in.ast", plots.replace(length_m=np.full(9, 12.0)))
    return tmp_path


def test_table_with_a_map(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    convert(folder / "in.csv", folder / "out.parquet", columns=folder / "map.toml")
    out, err = capsys.readouterr()
    assert "2 plots" in out
    assert "1 damaged places, the first at 21" in err
    np.testing.assert_allclose(read_table(folder / "out.parquet").plots.range_m, [1000, 3000])


def test_asterix_to_json_result(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    convert(folder / "in.ast", folder / "out.nmea", json=True)
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == {"plots": 9}
    assert told["left_out"]["channel"] == 9
    convert(folder / "in.csv", folder / "out.ast", columns=folder / "map.toml", source="1/2", json=True)
    assert json.loads(capsys.readouterr().out)["rows"] == {"plots": 2}


def test_refusals(folder: Path) -> None:
    columns = folder / "map.toml"
    with pytest.raises(SettingsError, match="ends in none of"):
        convert(folder / "in.csv", folder / "out.xls", columns=columns)
    with pytest.raises(SettingsError, match="inputs"):
        convert(folder / "in.csv", folder / "in.csv", columns=columns, overwrite=True)
    (folder / "out.csv").write_text("mine")
    with pytest.raises(SettingsError, match="--overwrite"):
        convert(folder / "in.csv", folder / "out.csv", columns=columns)
    assert (folder / "out.csv").read_text() == "mine"
    convert(folder / "in.csv", folder / "out.csv", columns=columns, overwrite=True)
    assert len(read_table(folder / "out.csv").plots) == 2
    with pytest.raises(SettingsError, match=r"sensors\.toml"):
        convert(folder / "in.csv", folder / "out.geojson", columns=columns)
    with pytest.raises(SettingsError, match="SAC/SIC"):
        convert(folder / "in.csv", folder / "out.ast", columns=columns, source="300/1")
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]
