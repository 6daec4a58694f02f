"""The quick form of each study: every bound holds, every printed cell is there, pages and JSON hold what they promise."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from boresight.cli import main
from boresight.errors import SettingsError
from boresight.studies import Settings, Study, run_study, study_json, write_study
from boresight.studies.page import bound_text, given, number, study_text
from boresight.studies.table import Bound, row


def quick(name: str) -> Study:
    return run_study(name, Settings(quick=True, seed=3))


@pytest.mark.parametrize(("name", "bounded", "printed"), [("covariance-conversion", 30, 12), ("serial-fusion", 20, 130)])
def test_every_bound_of_the_quick_form_holds(name: str, bounded: int, printed: int, tmp_path: Path) -> None:
    study = quick(name)
    assert not study.failed, "\n".join(f"{r.id}: {r.ours} is not within {bound_text(r.bound)}" for r in study.failed)
    assert sum(r.bound is not None for r in study.rows) >= bounded
    assert sum(r.printed is not None for r in study.rows) >= printed
    out = json.loads(json.dumps(study_json(study), allow_nan=False))
    assert out["study"] == name
    assert set(out["rows"][0]) >= {"id", "table", "row", "quantity", "printed", "ours", "bound", "holds"}
    for r in out["rows"]:
        if r["bound"] is not None:
            low, high = r["bound"]["low"], r["bound"]["high"]
            assert r["holds"] == ((low is None or r["ours"] >= low) and (high is None or r["ours"] <= high))
    page = write_study(study, tmp_path / "study.html").read_text()
    assert page.count("<figure") == len(study.figures) > 0
    assert all(f'id="{r.id}"' in page for r in study.rows)
    assert "http" not in page.replace("http://www.w3.org", "")
    assert all(r.row in study_text(study) for r in study.rows)


def test_studies_that_do_not_exist_are_refused() -> None:
    with pytest.raises(SettingsError, match="Studies: serial-fusion"):
        run_study("cold-fusion")


def test_mistakes_on_the_command_line_are_told_before_anything_is_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken, file = tmp_path / "taken", tmp_path / "file"
    taken.mkdir()
    (taken / "mean-shift.html").touch()
    file.touch()
    for arguments, said in (
        (["cold-fusion", "--out", str(tmp_path / "new")], "there is no study 'cold-fusion'. Studies: serial-fusion"),
        (["all", "--out", str(taken)], "mean-shift.html exists"),
        (["mean-shift", "--out", str(file)], "is a file"),
        (["mean-shift", "--seed", "-1"], "-1 is no seed"),
        (["mean-shift", "--workers", "-2"], "-2 workers are too few"),
        (["mean-shift", "--executor", "threads"], 'Invalid value "threads"'),
        (["mean-shift", "--scheduler", "tcp://127.0.0.1:1"], "a scheduler is for the executor dask"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(["study", *arguments])
        out, err = capsys.readouterr()
        assert (stopped.value.code, out, len(err.splitlines())) == (2, "", 1), err
        assert said in err
    assert not (tmp_path / "new").exists()


def test_lines_with_the_same_quantities_are_a_grid_on_the_page(tmp_path: Path) -> None:
    rows = (
        row("a-r", "t", "one", "range", 12.5, printed=12.0, high=13.0, unit="m", note="first"),
        row("a-e", "t", "one", "elevation", 0.5),
        row("b-r", "t", "two", "range", 14.0, high=13.0, unit="m"),
        row("b-e", "t", "two", "elevation", None, printed=0.25),
        row("c", "t", "three", "share", 0.99996, low=0.5),
    )
    page = write_study(Study("s", "title", "paper", ("text",), rows), tmp_path / "study.html").read_text()
    assert page.count("<table") == 2
    assert page.count("range, m") == 1
    assert "<b>12.50</b><small>paper 12</small><small>≤ 13 <span" in page
    assert page.count(">fails<") == 1
    assert '<td class="n" id="b-e"><small>paper 0.25</small></td>' in page
    assert "<b>1.000</b>" in page
    assert "<b>1 of 3</b>" not in page
    assert "<b>2 of 3</b>" in page


def test_a_row_holds_what_its_bound_says() -> None:
    assert row("a", "t", "r", "q", 1.0, low=0.5).holds is True
    assert row("a", "t", "r", "q", 1.0, high=0.5).holds is False
    assert row("a", "t", "r", "q", float("nan"), high=0.5).holds is False
    assert row("a", "t", "r", "q", "improved", printed="improved").holds is None
    assert bound_text(Bound(None, 0.5)) == "≤ 0.5"
    assert bound_text(Bound(3.0, 3.0)) == "= 3"
    assert bound_text(Bound(-1.5, 2.0)) == "−1.5 … 2"
    assert bound_text(Bound(44.1813 - 1e-9, 44.1813 + 1e-9)) == "44.1813 ± 1e−09"
    assert number(3.0) == "3"
    assert number(0.5) == "0.5000"
    assert given(0.002059) == "0.002059"
    assert given(-44.181) == "−44.181"
    assert number(-0.01234) == "−0.01234"
    assert number(np.nan) == "–"
