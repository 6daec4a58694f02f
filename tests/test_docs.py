"""The documentation tells the truth: its code runs, its commands parse, its tables name what the program has."""

from __future__ import annotations

import re
import shlex
import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from boresight import filters
from boresight.cli import app
from boresight.filters import serial
from boresight.model import KINDS, Sensor
from boresight.reading import uap
from boresight.registration.methods import METHODS, method_of, options_of
from boresight.registration.per_channel import ORDERS, PerChannel, design
from boresight.simulation import write_demo
from boresight.terms import CHANNELS, MODELS, TABLES, TERMS, Geometry, summarised, term_of

ROOT = Path(__file__).parents[1]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])


def blocks(page: Path) -> list[str]:
    """The Python blocks of a page, in order."""
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.S | re.M)


def section(page: Path, heading: str) -> str:
    """What stands under a heading, up to the next."""
    found = re.search(rf"^##+ {re.escape(heading)}\n(.*?)(?=^##+ |\Z)", page.read_text(encoding="utf-8"), re.S | re.M)
    assert found, heading
    return found[1]


def rows(text: str) -> list[list[str]]:
    """The cells of a section's table, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_the_tutorial_runs_block_after_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    page = ROOT / "docs" / "calibrate.md"
    found = blocks(page)
    assert len(found) >= 5
    for k, block in enumerate(found):
        exec(compile(block, f"{page.name}, block {k + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "azimuth_bias" in said
    assert len(names["clean"]) == len(names["radar"].plots)
    table = rows(section(page, "Hand on"))
    # A file of which the page says "where …" is there for some results only, and not for this one.
    listed = {name for row in table if not row[1].startswith("where ") for name in code(row[0])}
    assert {p.name for p in (tmp_path / "result").iterdir()} == listed
    assert {name for row in table for name in code(row[0])} - listed == {"biases.csv"}
    # The command on the page names the files that the page has made.
    for path in re.findall(r"demo/\S+", section(page, "Hand on")):
        assert (tmp_path / path).is_file()
    assert f"--date {names['files'].date.isoformat()}" in page.read_text(encoding="utf-8")


def test_the_page_on_which_method_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """Its code runs, the default leaves the least, and its tables name every method for every radar."""
    page = ROOT / "docs" / "which-method.md"
    names: dict[str, object] = {}
    for k, block in enumerate(blocks(page)):
        exec(compile(block, f"{page.name}, block {k + 1}", "exec"), names)
    left = [int(value) for value in re.findall(r"held out (\d+) m", capsys.readouterr().out)]
    assert len(left) == 4
    assert left[0] == min(left)
    text = page.read_text(encoding="utf-8")
    made = text.split("<!-- made by benchmarks/compare_methods.py -->")
    assert len(made) == 3
    for method in METHODS:
        assert made[1].count(f"\n| {method} |") == 4, method
    for image in re.findall(r"\(images/(\S+)\)", text):
        assert (ROOT / "docs" / "images" / image).is_file()


def test_the_page_on_corrected_recordings_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "correct.md"
    names: dict[str, object] = {}
    for k, block in enumerate(blocks(page)):
        exec(compile(block, f"{page.name}, block {k + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "I048/040 RHO" in said
    assert "corrected.ast.boresight.json" in page.read_text(encoding="utf-8")
    assert (tmp_path / "corrected.ast.boresight.json").is_file()


def test_the_code_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    files = write_demo(tmp_path, seed=1)
    for made, named in ((files.plots[0], "radar.ast"), (files.reference[0], "adsb.ast")):
        if made.name != named:
            shutil.copy(made, tmp_path / named)
    assert files.sensors == tmp_path / "sensors.toml"
    monkeypatch.chdir(tmp_path)
    (block,) = blocks(ROOT / "README.md")
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert "azimuth_bias" in capsys.readouterr().out
    assert len(names["clean"]) > 0


def test_the_page_on_fusion_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    found = blocks(ROOT / "docs" / "fusion.md")
    assert len(found) >= 4
    for k, block in enumerate(found):
        exec(compile(block, f"fusion.md, block {k + 1}", "exec"), names)
    beta, choice, last = capsys.readouterr().out.splitlines()
    assert float(beta.strip("[]")) == pytest.approx(120e3 * np.radians(0.3) ** 2 * (1 + np.cos(np.radians(2.0)) ** 2) / 100)
    assert choice == "decorrelated"
    # The table of methods names what there is.
    listed = {
        c.partition("(")[0]
        for row in rows(section(ROOT / "docs" / "fusion.md", "A covariance in another frame"))
        for c in code(row[0])
    }
    assert all(hasattr(names["frames"], name) for name in listed)
    off, nis = map(float, last.split())
    assert off < 2000
    assert 1 < nis < 6


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_on_a_page_is_understood(page: Path) -> None:
    """Indented lines that begin with the program's name are commands; they are parsed, not run."""
    for line in re.findall(r"^    boresight (.*)$", page.read_text(encoding="utf-8"), re.M):
        tokens = shlex.split(line.split("  #")[0])
        app.parse_args(tokens, exit_on_error=False, print_error=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_the_tables_of_terms_and_models_are_those_of_the_program() -> None:
    page = ROOT / "docs" / "terms.md"
    terms = rows(section(page, "Terms"))
    named = [name for row in terms for name in code(row[0])]
    assert named == summarised(TERMS)
    for row in terms:
        for name in code(row[0]):
            assert row[1] == term_of(TABLES.get(name, (name,))[0]).unit, name
    models = rows(section(page, "Models"))
    assert {name: tuple(code(row[1])) for row in models for name in code(row[0])} == MODELS
    assert [name for row in rows(section(page, "Channels")) for name in code(row[0])] == list(CHANNELS)


def test_the_code_on_the_page_of_terms_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    for block in blocks(ROOT / "docs" / "terms.md"):
        exec(compile(block, "terms.md", "exec"), names)
    assert "rotation_up" in capsys.readouterr().out


def test_the_page_on_filters_runs_and_names_what_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    page = ROOT / "docs" / "filters.md"
    names: dict[str, object] = {}
    for block in blocks(page):
        exec(compile(block, "filters.md", "exec"), names)
    assert "off by" in capsys.readouterr().out
    off = names["found"].mean[0, -1, :3] - names["truth"][-1]
    assert abs(off).max() < 150.0
    listed = {name for row in rows(page.read_text(encoding="utf-8")) for cell in row for name in code(cell)}
    assert listed <= {*filters.__all__, *dir(serial)}


def test_the_page_on_error_models_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    page = ROOT / "docs" / "error-models.md"
    text = page.read_text(encoding="utf-8")
    number = re.compile(r"[-+]?\d+\.?\d*")
    names: dict[str, object] = {}
    shown = re.findall(r"^```\n\nprints\n\n((?:    .*\n)+)", text, re.M)
    found = blocks(page)
    assert len(shown) == len(found) == 3
    for block, expected in zip(found, shown, strict=True):
        exec(compile(block, page.name, "exec"), names)
        said = capsys.readouterr().out
        printed = "".join(f"    {line}\n" for line in said.splitlines())
        assert number.sub("#", printed) == number.sub("#", expected)
        # Libraries may differ in the last digit that is shown.
        ours, theirs = ([float(n) for n in number.findall(what)] for what in (printed, expected))
        assert ours == pytest.approx(theirs, rel=0.02, abs=0.11)


def test_the_tables_of_error_models_are_the_columns_of_the_program() -> None:
    page = ROOT / "docs" / "error-models.md"
    parts = re.split(r"^(Range|Azimuth|Elevation):$", section(page, "The rows"), flags=re.M)
    angles = np.linspace(0.1, 6.1, 40)
    flat = np.full(40, np.nan)
    rates = np.random.default_rng(1).normal(size=(3, 40, 3))
    place = Geometry(20e3 + 1e3 * angles, angles, 0.3 + 0.02 * np.sin(3 * angles), *rates, flat, flat, angles)
    r, a, e = place.range_m, place.azimuth_rad, place.elevation_rad
    cot = term_of("elevation_refraction").columns(place)[:, 2]
    written = {"1": np.ones(40), "sec E": 1 / np.cos(e), "tan E": np.tan(e), "cos E": np.cos(e), "cot E": cot}
    written |= {
        "sin A": np.sin(a),
        "cos A": np.cos(a),
        "sin A tan E": np.sin(a) * np.tan(e),
        "cos A tan E": np.cos(a) * np.tan(e),
    }
    written |= {"−cos A tan E": -np.cos(a) * np.tan(e)}
    written |= {"cos A / (R cos E)": np.cos(a) / (r * np.cos(e)), "sin A / (R cos E)": np.sin(a) / (r * np.cos(e))}
    for k, one in enumerate("RAE"):
        written |= {f"{one}̇": rates[0][:, k], f"{one}̈": rates[1][:, k], f"third derivative of {one}": rates[2][:, k]}
    seen = 0
    for name, table in zip(parts[1::2], parts[2::2], strict=True):
        channel = ("Range", "Azimuth", "Elevation").index(name)
        for order in ORDERS:
            for jerk in (False, True):
                for parallax in (False, True):
                    columns, x = design(place, channel, order, jerk=jerk, parallax=parallax)
                    told = []
                    for row in rows(table):
                        asked = {"jerk": jerk, "parallax": parallax}
                        when = {word.removesuffix("-order") for word in re.findall(r"[\w-]+", row[0])}
                        if when & {"all", order.removesuffix("-order")} and all(asked[w] for w in when & set(asked)):
                            told.append((written[unicodedata.normalize("NFD", row[1].strip("*"))], row[3], row[4]))
                    assert len(told) == len(columns)
                    for column, values in zip(columns, x.T, strict=True):
                        (match,) = [t for t in told if np.allclose(t[0], values, rtol=1e-9, atol=0)]
                        assert code(match[1]) == ([column.term] if column.term else [])
                        if column.term:
                            plus = match[2] in ("+", "the parameter itself")
                            assert plus == (column.sign > 0), match
                        seen += 1
    assert seen > 60
    options = [name for row in rows(section(page, "Options")) for name in code(row[0])]
    assert options == list(options_of(PerChannel()))


def test_every_method_has_a_place_with_its_equations_and_its_options_by_their_defaults() -> None:
    page = ROOT / "docs" / "methods.md"
    table = {name: row for row in rows(section(page, "Methods of registration")) for name in code(row[0])}
    assert set(table) == set(METHODS)
    headings = {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^##+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    }
    for name, row in table.items():
        links = re.findall(r"\]\(([^)]*)\)", row[2])
        assert links, name
        for link in links:
            file, _, anchor = link.partition("#")
            assert (page.parent / file).is_file() if file else anchor in headings, link
    listed = {code(row[0])[0]: code(row[1]) for row in rows(section(page, "Options"))}
    assert set(listed) == set(METHODS)
    for name, options in listed.items():
        given = dict(option.split("=") for option in options)
        assert list(given) == list(options_of(METHODS[name]))
        assert method_of(name, given) == METHODS[name]
    # The page for users names every method too.
    chosen = {name for row in rows(section(ROOT / "docs" / "calibrate.md", "Other methods")) for name in code(row[0])}
    assert chosen == set(METHODS)


def test_every_key_and_kind_of_sensors_toml_is_described() -> None:
    page = ROOT / "docs" / "sensors.md"
    table = rows(section(page, "sensors.toml"))
    described = {name for row in table for name in code(row[0])} | {"height_msl_m", "geoid_m", "id"}
    text = " ".join(row[1] for row in table)
    for inside in ("height_msl_m", "geoid_m", "id"):
        assert f"`{inside}`" in text
    assert described == set(Sensor.__struct_fields__)
    (kinds,) = (row[1] for row in table if row[0] == "`kind`")
    assert set(code(kinds)) == set(KINDS)


def test_every_category_of_asterix_is_listed() -> None:
    listed = {int(c) for row in rows(section(ROOT / "docs" / "sensors.md", "ASTERIX")) for c in re.findall(r"\d{3}", row[0])}
    assert listed == set(uap._TABLES)
