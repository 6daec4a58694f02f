"""Tables that come part by part: the files are those that the whole table gives, and nothing half done is left."""

from __future__ import annotations

import datetime
import resource
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import duckdb
import numpy as np
import pytest

from boresight.cli.convert import convert
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.model import Fixes, Plots, pack_callsigns
from boresight.reading import asterix, capture, is_asterix, read, tables
from boresight.reading.asterix import Stream, read_asterix
from boresight.writing import tables as writing_tables
from boresight.writing.anyfile import write_any, write_parts
from boresight.writing.asterix import encode_asterix

DATE = datetime.date(2026, 3, 1)
MIDNIGHT = datetime.datetime(2026, 3, 2, tzinfo=datetime.UTC).timestamp()


def plots_of(n: int, seed: int = 1) -> Plots:
    """Three radars around midnight; some columns are absent in the first half or in all rows."""
    rng = np.random.default_rng(seed)
    mode_s = rng.integers(0, 1 << 24, n)
    mode_s[: n // 2] = -1
    return Plots(
        time_s=MIDNIGHT - 600.0 + np.arange(n) * (1200.0 / n),
        sensor=0x1401 + rng.integers(0, 3, n),
        channel=rng.integers(1, 6, n),
        range_m=rng.uniform(1e3, 2e5, n),
        azimuth_rad=rng.uniform(0, 2 * np.pi, n),
        mode_s=mode_s,
        mode_3a=rng.integers(0, 4096, n),
        callsign=np.where(rng.random(n) < 0.5, pack_callsigns(["ABC123"])[0], -1),
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts, pieces and what is held of digests so small that a short recording has many borders."""
    monkeypatch.setattr(asterix, "CHUNK", 4096)
    monkeypatch.setattr(writing_tables, "PIECE", 2048)
    monkeypatch.setattr(asterix, "_HELD", 1000)


def rows_of(path: Path) -> list[tuple[object, ...]]:
    reader = "read_parquet" if path.suffix == ".parquet" else "read_csv"
    with duckdb.connect(":memory:") as connection:
        return connection.execute(f"SELECT COLUMNS(*)::VARCHAR FROM {reader}('{path}')").fetchall()


def schema_of(path: Path) -> list[tuple[object, ...]]:
    with duckdb.connect(":memory:") as connection:
        return connection.execute(f"DESCRIBE SELECT * FROM read_parquet('{path}')").fetchall()


def damaged_recording() -> bytes:
    """Blocks over midnight with duplicates, zeros between, records out of order and a category that cannot be read."""
    one = encode_asterix(plots_of(12_000))[0]
    two = encode_asterix(plots_of(3_000, seed=2))[0]
    return one + b"\0" * 300 + one[:4000] + two + bytes([0x30, 0, 9, 0xFF, 1, 1, 1, 1, 1]) + two + bytes([250, 0, 5, 1, 1]) * 3


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_streamed_is_what_the_whole_gives(tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in.ast").write_bytes(damaged_recording())
    whole = read(tmp_path / "in.ast", date=DATE)
    write_any(tmp_path / f"whole{ending}", whole)
    convert(tmp_path / "in.ast", tmp_path / f"parts{ending}", date=DATE.isoformat())
    said = capsys.readouterr()
    assert f"{len(whole.plots):,} plots" in said.out
    assert f"{len(whole.damaged):,} damaged places, the first at {whole.damaged[0].offset}" in said.err
    assert whole.warnings
    for warning in whole.warnings:
        assert f"warning: {warning}\n" in said.err
    assert rows_of(tmp_path / f"parts{ending}") == rows_of(tmp_path / f"whole{ending}")
    if ending == ".csv":
        assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    else:
        assert schema_of(tmp_path / "parts.parquet") == schema_of(tmp_path / "whole.parquet")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.ast", f"parts{ending}", f"whole{ending}"]


@pytest.mark.usefixtures("small")
def test_numbers_of_records_and_days_go_on_over_parts(tmp_path: Path) -> None:
    truth = plots_of(12_000)
    (tmp_path / "in.ast").write_bytes(encode_asterix(truth)[0])
    stream = Stream.open(tmp_path / "in.ast", date=DATE)
    parts = list(stream)
    assert len(parts) > 20
    np.testing.assert_array_equal(np.concatenate([p.plots.record for p in parts]), np.arange(12_000))
    np.testing.assert_allclose(np.concatenate([p.plots.time_s for p in parts]), truth.time_s, atol=0.5 / 128)
    assert stream.damaged == ()
    assert stream.warnings == read_asterix(tmp_path / "in.ast", date=DATE).warnings


@pytest.mark.usefixtures("small")
def test_duplicates_on_disk_are_those_in_memory(tmp_path: Path) -> None:
    block = encode_asterix(plots_of(3_000))[0]
    other = encode_asterix(plots_of(3_000, seed=9))[0]
    (tmp_path / "in.ast").write_bytes(block + other + block)
    stream = Stream.open(tmp_path / "in.ast", date=DATE)
    assert sum(len(p.offset) for p in stream) == 9_000
    assert any(w.startswith("3000 records are byte for byte the same") for w in stream.warnings)


def test_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A packet capture, in portions: the same rows, stamped by the capture's own day."""
    monkeypatch.setattr(capture, "CHUNK", 1 << 14)
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    truth = plots_of(4_000)
    for k in range(0, 4_000, 10):
        body = encode_asterix(truth[k : k + 10])[0]
        ip = struct.pack(">BBHHHBBHII", 0x45, 0, 28 + len(body), 0, 0, 9, 17, 0, 1, 2)
        frame = b"\0" * 12 + b"\x08\x00" + ip + struct.pack(">HHHH", 1, 2, 8 + len(body), 0) + body
        t = truth.time_s[k]
        out += struct.pack("<IIII", int(t), int(t % 1 * 1e6), len(frame), len(frame)) + frame
    (tmp_path / "in.pcap").write_bytes(out)
    whole = read(tmp_path / "in.pcap")
    np.testing.assert_allclose(whole.plots.time_s, truth.time_s, atol=0.5 / 128)
    assert sum(1 for _ in Stream.open(tmp_path / "in.pcap")) > 5
    write_any(tmp_path / "whole.csv", whole)
    convert(tmp_path / "in.pcap", tmp_path / "parts.csv", json=True)
    assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_parquet_is_the_same_bytes(tmp_path: Path) -> None:
    """Pieces are whole row groups, so even the bytes do not tell how it was written."""
    table = plots_of(writing_tables.PIECE + 5_000)
    writing_tables.write_table(tmp_path / "whole.parquet", table)
    cuts = [0, 7, 100_000, writing_tables.PIECE + 10, len(table)]
    parts = [SimpleNamespace(plots=table[a:b]) for a, b in pairwise(cuts)]
    told = write_parts(tmp_path / "parts.parquet", parts, name="x")
    assert told.rows == {"plots": len(table)}
    assert (tmp_path / "parts.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def fixes_of(n: int) -> Fixes:
    return Fixes(time_s=np.arange(n) * 1.0, source=[1] * n, latitude_rad=[0.5] * n, longitude_rad=[0.1] * n)


def test_several_tables(tmp_path: Path) -> None:
    parts = [SimpleNamespace(plots=plots_of(5), fixes=fixes_of(0)), SimpleNamespace(plots=Plots(), fixes=fixes_of(4))]
    with pytest.raises(SettingsError, match="holds plots, fixes"):
        write_parts(tmp_path / "out.csv", parts, name="x")
    assert not list(tmp_path.iterdir())
    assert write_parts(tmp_path / "out.csv", parts, name="x", kind="all").rows == {"plots": 5, "fixes": 4}
    assert len(tables.read_table(tmp_path / "out-plots.csv").plots) == 5
    assert len(tables.read_table(tmp_path / "out-fixes.csv").fixes) == 4
    assert write_parts(tmp_path / "one.csv", parts, name="x", kind="fixes").rows == {"fixes": 4}
    with pytest.raises(NothingToDo, match="holds no tracks: it holds plots, fixes"):
        write_parts(tmp_path / "none.csv", parts, name="x", kind="tracks")


@pytest.mark.usefixtures("small")
def test_nothing_is_left_of_what_failed(tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text("mine")

    def broken() -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(plots=plots_of(5_000))
        raise InputError("the disk went away")

    with pytest.raises(InputError, match="went away"):
        write_parts(tmp_path / "out.csv", broken(), name="x")
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]
    assert (tmp_path / "out.csv").read_text() == "mine"
    with pytest.raises(InputError, match="does not exist"):
        write_parts(tmp_path / "no" / "out.csv", broken(), name="x")
    with pytest.raises(SettingsError, match="part by part"):
        write_parts(tmp_path / "out.kml", broken(), name="x")


@contextmanager
def full_disk(octets: int) -> Iterator[None]:
    """No file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (octets, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
@pytest.mark.parametrize("rows_a_piece", [2048, 1 << 20])
def test_full_disk_is_one_plain_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, rows_a_piece: int) -> None:
    """In the first piece, when the pieces are joined, and where the whole is written at once."""
    monkeypatch.setattr(writing_tables, "PIECE", rows_a_piece)
    (tmp_path / "in.ast").write_bytes(encode_asterix(plots_of(12_000))[0])
    (tmp_path / f"out{ending}").write_text("mine")
    for octets in (5_000, 100_000):
        with full_disk(octets), pytest.raises(InputError) as told:
            convert(tmp_path / "in.ast", tmp_path / f"out{ending}", date=DATE.isoformat(), overwrite=True)
        assert str(told.value) == (
            f"{tmp_path / f'out{ending}'}: cannot be written (File too large). "
            "Nothing was changed; free some space or write elsewhere."
        )
        assert (tmp_path / f"out{ending}").read_text() == "mine"
        assert len(list(tmp_path.iterdir())) == 2


def test_refusals_come_first(tmp_path: Path) -> None:
    (tmp_path / "in.ast").write_bytes(encode_asterix(plots_of(50))[0])
    (tmp_path / "out.csv").write_text("mine")
    with pytest.raises(SettingsError, match="--overwrite"):
        convert(tmp_path / "in.ast", tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text() == "mine"
    convert(tmp_path / "in.ast", tmp_path / "out.csv", overwrite=True, json=True)
    assert len(tables.read_table(tmp_path / "out.csv").plots) == 50
    (tmp_path / "zeros.ast").write_bytes(bytes(5_000))
    with pytest.raises(InputError, match="nothing but zeros"):
        convert(tmp_path / "zeros.ast", tmp_path / "zeros.csv")
    assert not (tmp_path / "zeros.csv").exists()


def test_what_is_asterix(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(encode_asterix(plots_of(50))[0])
    (tmp_path / "b").write_text("time,range_m,azimuth_deg\n1,2,3\n")
    assert is_asterix(tmp_path / "a")
    assert not is_asterix(tmp_path / "b")
    assert not is_asterix(tmp_path)
