"""The lines of TOML, and a scenario's mistakes: every one is told, each with the line that it stands in."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.errors import SettingsError
from boresight.simulation import Radar, Scenario, Traffic, load_scenario, simulate
from boresight.simulation.lint import line_of, lines_of
from boresight.simulation.scenario import check_scenario, lint_scenario

HARD = '''# the line of each thing is written beside it
name = "a # b [[c]] \\" = "       # 2
long = """
[[radar]]
x = 1 \\""" quoted
"""                              # 3
raw = \'\'\'a = "\'\'                 # 7
[traffic]\'\'\'
list = [                         # 9
  1, # one                       # 10
  [2, "]"],                      # 11

  { a = 1, b = [ "}", 5 ] },     # 13
]
dotted.one = 1                   # 15
dotted . "t.wo" = 2              # 16
when = 2026-01-01 10:00:00Z      # 17

[traffic]                        # 19
"quoted \\u00e4 key" = 1          # 20
'lit"eral' = true                # 21

[a.b.c]                          # 23
x = { y.z = 1, "w w" = [1, 2] }  # 24

[[radar]]                        # 26
name = "one"                     # 27

[radar.errors]                   # 29
range_bias = 1                   # 30

[[radar]]                        # 32
errors.time_offset = 2           # 33
errors.range_bias = 3            # 34

[[radar.clutter]]                # 36
plots = 1                        # 37
[[radar.clutter]]                # 38
[radar.clutter.deep]             # 39
x = 1                            # 40
[a]                              # 41
'''
WHERE = {
    ("name",): 2, ("long",): 3, ("raw",): 7, ("list",): 9, ("list", 0): 10, ("list", 1): 11, ("list", 1, 1): 11,
    ("list", 2): 13, ("list", 2, "a"): 13, ("list", 2, "b", 1): 13, ("dotted",): 15, ("dotted", "one"): 15,
    ("dotted", "t.wo"): 16, ("when",): 17, ("traffic",): 19, ("traffic", "quoted \u00e4 key"): 20, ("traffic", 'lit"eral'): 21,
    ("a",): 41, ("a", "b"): 23, ("a", "b", "c"): 23, ("a", "b", "c", "x"): 24, ("a", "b", "c", "x", "y", "z"): 24,
    ("a", "b", "c", "x", "w w", 1): 24, ("radar", 0): 26, ("radar", 0, "name"): 27, ("radar", 0, "errors"): 29,
    ("radar", 0, "errors", "range_bias"): 30, ("radar", 1): 32, ("radar", 1, "errors"): 33,
    ("radar", 1, "errors", "time_offset"): 33, ("radar", 1, "errors", "range_bias"): 34, ("radar", 1, "clutter", 0): 36,
    ("radar", 1, "clutter", 0, "plots"): 37, ("radar", 1, "clutter", 1): 38, ("radar", 1, "clutter", 1, "deep"): 39,
    ("radar", 1, "clutter", 1, "deep", "x"): 40,
}  # fmt: skip


def leaves(data: object, place: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The places of everything in tables and lists."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [inner for key, item in items for inner in ((*place, key), *leaves(item, (*place, key)))]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_key_has_its_line(end: str) -> None:
    text = HARD.replace("\n", end)
    lines = lines_of(text)
    assert {place: lines[place] for place in WHERE} == WHERE
    assert set(leaves(tomllib.loads(text))) <= set(lines)


def test_places_that_are_not_written_have_the_line_of_their_table() -> None:
    lines = lines_of(HARD)
    assert line_of(lines, ("radar", 1, "lat_deg")) == 32
    assert line_of(lines, ("radar", 0, "errors", "site_up", "value")) == 29
    assert line_of(lines, ("nothing", 3)) == 1


words = st.text("abc-_ \u00e4.#[]=\"'\\", min_size=1, max_size=6)
values = st.recursive(
    st.one_of(st.integers(-9, 9), st.booleans(), st.text("ab#[]{}=,\"'\\\n", max_size=8), st.floats(-5, 5)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(words, inner, max_size=3)),
    max_leaves=8,
)


class Writer:
    """Writes tables as TOML in one of its many forms, and notes the line of everything that it writes."""

    def __init__(self, draw: st.DataObject) -> None:
        self.draw, self.text, self.lines = draw, "", dict[tuple[str | int, ...], int]()

    def one(self, *choices: str) -> str:
        return self.draw.draw(st.sampled_from(choices))

    def note(self, place: tuple[str | int, ...]) -> None:
        self.lines[place] = self.text.count("\n") + 1

    def key(self, key: str) -> str:
        plain = key.isascii() and key.replace("-", "").replace("_", "").isalnum()
        forms = [json.dumps(key), *([key] if plain else []), *([f"'{key}'"] if "'" not in key else [])]
        return self.one(*forms)

    def value(self, value: object, place: tuple[str | int, ...]) -> None:
        if isinstance(value, dict):
            self.text += "{"
            for number, (key, item) in enumerate(value.items()):
                self.text += ", " if number else " "
                self.note((*place, key))
                self.text += f"{self.key(key)} = "
                self.value(item, (*place, key))
            self.text += self.one("}", " }")
        elif isinstance(value, list):
            self.text += "["
            for number, item in enumerate(value):
                self.text += self.one("", "\n  ", " # ] a, comment\n\n", "  ")
                self.note((*place, number))
                self.value(item, (*place, number))
                self.text += self.one(",", " ,", "\n,")
            self.text += self.one("]", "\n]", " # [\n]")
        elif isinstance(value, str):
            plain = json.dumps(value)
            long = '"""\n' + plain[1:-1].replace("\\n", "\n") + '"""'
            literal = f"'''\n{value}'''" if "'" not in value else plain
            self.text += self.one(plain, long, literal)
        else:
            self.text += json.dumps(value)

    def table(self, table: dict[str, object], place: tuple[str | int, ...], names: tuple[str, ...]) -> None:
        later: list[tuple[str, object, bool]] = []
        for key, item in table.items():
            many = isinstance(item, list) and len(item) > 0 and all(isinstance(one, dict) for one in item)
            if (isinstance(item, dict) or many) and self.one("here", "later") == "later":
                later.append((key, item, many))
                continue
            self.text += self.one("", "\n", "# [comment] = 1\n", "   ")
            self.note((*place, key))
            self.text += f"{self.key(key)}{self.one('=', ' = ')}"
            self.value(item, (*place, key))
            self.text += self.one("\n", " # a = 1\n", "  \n\n")
        for key, item, many in later:
            inner = (*names, json.dumps(key))
            for number, one in enumerate(item if many else [item]):
                here = (*place, key, number) if many else (*place, key)
                self.note(here)
                self.text += f"[[{'.'.join(inner)}]]\n" if many else f"[ {' . '.join(inner)} ] # x\n"
                self.table(one, here, inner)


@settings(max_examples=150)
@given(st.dictionaries(words, values, max_size=5), st.data())
def test_lines_of_any_toml_are_those_it_was_written_in(table: dict[str, object], draw: st.DataObject) -> None:
    writer = Writer(draw)
    writer.table(table, (), ())
    assert tomllib.loads(writer.text) == table
    found = lines_of(writer.text)
    assert {place: found.get(place) for place in writer.lines} == writer.lines


SCENE = """name = "all of it"
start = 2026-05-04T10:00:00Z
duration_s = 600.0

[traffic]
aircraft = 4
lat_deg = 50.0
lon_deg = 8.5
arrivals = 0.0
departures = 0.0

[atmosphere]
isa_deviation_k = 5.0

[shipping]
ships = 3
lat_deg = 50.0
lon_deg = 8.5

[[target]]
name = "boat"
craft = "ship"
lat_deg = 50.01
lon_deg = 8.51
speed_mps = 5.0
course_deg = 90.0

[[target]]
name = "jet"
lat_deg = 50.2
lon_deg = 8.0
height_m = 9000.0
speed_mps = 220.0
course_deg = 90.0

[[radar]]
name = "one"
sac = 1
sic = 1
lat_deg = 50.1
lon_deg = 8.6
elevation_sd_deg = 0.1
errors = { range_bias = 80.0, time_offset = { value = 0.2, ramp_per_h = 0.1, sine = [{ amplitude = 0.1, period_s = 300.0 }] } }

[radar.noise]
range = { correlated = 0.5 }
time = { outliers = 0.01 }

[[radar.clutter]]
range_m = [2000.0, 9000.0]
plots = 2.0

[[radar]]
name = "two"
sac = 1
sic = 2
lat_deg = 50.0
lon_deg = 8.4
kind = "marine"

[radar.errors]
range_bias = 20.0
azimuth_bias = 0.4

[radar.gaps]
outage_s = [[100.0, 120.0]]

[adsb]
classes = { "9" = 1.0 }

[ais]
loss = 0.1

[mlat]
lat_deg = 50.0
lon_deg = 8.5
radius_m = 50000.0

[rtk]
targets = ["boat"]
"""

# What is written instead of what, in which line that stands in the scene above, and what must be said.
MISTAKES = [
    ('name = "all of it"', "nmae = 1", "nmae.*Did you mean name"),
    ("2026-05-04T10:00:00Z", "2026-05-04T10:00:00", "time zone"),
    ("2026-05-04T10:00:00Z", '"tomorrow"', "start"),
    ("2026-05-04T10:00:00Z", "1900-05-04T10:00:00Z", "1900"),
    ("duration_s = 600.0", "duration_s = 5", "duration_s = 5.* 10 … 86,400"),
    ("duration_s = 600.0", "duration_s = nan", "finite"),
    ("aircraft = 4", "aircraft = 4.5", "whole number"),
    ("aircraft = 4", "aircraft = -1", "aircraft = -1"),
    ("aircraft = 4", "air_craft = 4", "Did you mean aircraft"),
    ("isa_deviation_k = 5.0", "isa_deviation_k = 500.0", "isa_deviation_k"),
    ("ships = 3", "ships = true", "whole number"),
    ("ships = 3", "ships = 0", "ships = 0"),
    ('craft = "ship"', 'craft = "boat"', "craft = 'boat'"),
    ("speed_mps = 5.0", "speed_mps = 500.0", "speed_mps = 500"),
    ("speed_mps = 220.0", 'speed_mps = "fast"', "number"),
    ('name = "jet"', 'name = "boat"', "used before"),
    ('name = "one"', 'name = "../one"', "name of a file"),
    ('name = "one"', 'name = "adsb"', "another file"),
    ("sic = 2", "sic = 1", "1/1 were used before, by radar 1"),
    ("sic = 2", "sic = 256", "sic = 256"),
    ('name = "two"', 'name = "One"', "used before, by radar 1"),
    ("lat_deg = 50.1", "lat_deg = 95.0", "lat_deg = 95"),
    ('kind = "marine"', 'kind = "marin"', "Did you mean marine"),
    ("range_bias = 80.0", "range_bais = 80.0", "Did you mean range_bias"),
    ("range_bias = 80.0", "range_bias = inf", "finite"),
    ("range_bias = 80.0", '"range_bias@prs" = 1.0', "Did you mean psr"),
    ("ramp_per_h = 0.1", "ramp_per_hour = 0.1", "Did you mean ramp_per_h"),
    ("period_s = 300.0", "period_s = 0.0", "period_s = 0"),
    ("azimuth_bias = 0.4", "elevation_bias = 0.4", "measures elevation"),
    ("azimuth_bias = 0.4", 'azimuth_bias = "0.4"', "number"),
    ("range = { correlated = 0.5 }", "range = { correlated = 1.5 }", "correlated = 1.5"),
    ("time = { outliers = 0.01 }", "tmie = { outliers = 0.01 }", "Did you mean time"),
    ("range_m = [2000.0, 9000.0]", "range_m = [2000.0]", "2 values, not 1"),
    ("range_m = [2000.0, 9000.0]", "range_m = [9000.0, 2000.0]", "range_m must rise"),
    ("plots = 2.0", "plots = 200.0", "places"),
    ("outage_s = [[100.0, 120.0]]", "outage_s = [[120.0, 100.0]]", "from, to"),
    ('"9" = 1.0', '"12" = 1.0', "NACp"),
    ('"9" = 1.0', '"9" = -1.0', "negative"),
    ("loss = 0.1", "loss = 1.0", "loss = 1.0"),
    ("radius_m = 50000.0", "radius_m = 5.0", "radius_m = 5.0"),
    ('targets = ["boat"]', 'targets = ["bout"]', "no target 'bout'"),
]  # fmt: skip


def line_in(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_a_scene_with_all_there_is_has_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    lint = lint_scenario(path)
    assert lint.mistakes == ()
    assert lint.warnings == ()
    assert lint.scenario == load_scenario(path)
    assert "2 radars, 5 aircraft, 4 ships" in lint.scenario.summary


@pytest.mark.parametrize(("old", "new", "says"), MISTAKES)
def test_each_mistake_has_its_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "scene.toml"
    text = SCENE.replace(old, new, 1)
    assert text != SCENE
    path.write_text(text)
    with pytest.raises(SettingsError, match=says) as caught:
        load_scenario(path)
    (mistake,) = lint_scenario(path).mistakes
    assert str(caught.value) == str(mistake)
    assert mistake.line == line_in(SCENE, old), mistake


@settings(max_examples=40)
@given(st.sets(st.sampled_from(range(len(MISTAKES))), min_size=2, max_size=6))
def test_all_mistakes_are_told_at_once(tmp_path_factory: pytest.TempPathFactory, which: set[int]) -> None:
    text, expected = SCENE, set[int]()
    for number in which:
        old, new, _ = MISTAKES[number]
        # Of two mistakes of one place the first is made.  What a target is and what it is called decides about others, and a
        # table without what it needs is not looked at further.
        if text.count(old) == SCENE.count(old) and old.split(" ")[0] not in ("name", "craft", "range_m"):
            text = text.replace(old, new, 1)
            expected.add(number)
    path = tmp_path_factory.mktemp("lint") / "scene.toml"
    path.write_text(text)
    found = {mistake.line for mistake in lint_scenario(path).mistakes}
    assert {line_in(SCENE, MISTAKES[number][0]) for number in expected} <= found
    if expected:
        with pytest.raises(SettingsError) as caught:
            load_scenario(path)
        assert all(f"scene.toml:{line}: " in str(caught.value) for line in found)


def test_a_table_that_cannot_be_made_does_not_move_the_others(tmp_path: Path) -> None:
    """The first radar lacks its place: the second one's mistake has its own number and line."""
    path = tmp_path / "scene.toml"
    text = SCENE.replace("lat_deg = 50.1\n", "", 1).replace("azimuth_bias = 0.4", "azimuth_bais = 0.4")
    path.write_text(text)
    first, second = lint_scenario(path).mistakes
    assert (first.line, first.text) == (line_in(text, '[[radar]]\nname = "one"'), "radar 1 ('one'): lat_deg is missing")
    assert second.line == line_in(text, "azimuth_bais")
    assert second.text.startswith("radar 2 ('two'): ")


def test_a_replay_needs_its_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    text = SCENE + '\n[[target]]\nname = "again"\nkind = "replay"\nrecording = "gone.ast"\n'
    path.write_text(text)
    (mistake,) = lint_scenario(path).mistakes
    assert mistake.line == line_in(text, "recording")
    assert "no such file" in mistake.text
    # It is looked for beside the scenario.
    (tmp_path / "gone.ast").write_bytes(b"there")
    scenario = lint_scenario(path).scenario
    assert scenario is not None
    assert scenario.target[-1].recording == str(tmp_path / "gone.ast")


@pytest.mark.parametrize(
    ("old", "new", "line_of_part", "says"),
    [
        ("duration_s = 600.0", "duration_s = 30.0\n", 'name = "one"', "turns only 7.5 times"),
        ("lat_deg = 50.1", "lat_deg = 20.0", "", ""),
        ("range_bias = 80.0", "range_bias = 80000.0", "range_bias = 80000", "far beyond what radars have"),
        ("ramp_per_h = 0.1", "ramp_per_h = 1000.0", "time_offset = ", "far beyond"),
        ("[mlat]\n", "[mlat]\nshare = 0.0\n", "[mlat]", "multilaterated"),
        ("10:00:00Z", "23:59:59.9Z", "start = ", "one stamps its first plots with another date"),
    ],
)
def test_what_makes_little_sense_is_warned_of(tmp_path: Path, old: str, new: str, line_of_part: str, says: str) -> None:
    path = tmp_path / "scene.toml"
    text = SCENE.replace("outage_s = [[100.0, 120.0]]", "outage_s = []").replace(old, new, 1)
    path.write_text(text)
    lint = lint_scenario(path)
    assert lint.mistakes == ()
    if not says:
        assert lint.warnings == ()  # A scripted target may come near: what is drawn is not known before.
        return
    lines = {line_in(text, part) for part in ([line_of_part] if line_of_part != 'name = "one"' else ["[[radar]]"])}
    assert any(w.line in lines and says in w.text for w in lint.warnings), [str(w) for w in lint.warnings]
    assert load_scenario(path) == lint.scenario


def test_scenes_without_any_use_are_warned_of() -> None:
    from boresight.simulation.scenario import warnings_of

    radar = Radar(name="far", sac=1, sic=1, lat_deg=41.3, lon_deg=2.1)
    quiet = Traffic(aircraft=4, arrivals=0.0, departures=0.0)
    said = [m.text for m in warnings_of(Scenario(traffic=quiet, radar=(radar,)))]
    assert said == ["there is no reference to calibrate against"]
    away = Traffic(aircraft=4, arrivals=0.0, departures=0.0, lat_deg=10.0)
    texts = " ".join(m.text for m in warnings_of(Scenario(traffic=away, radar=(radar,))))
    assert "reaches no target" in texts
    assert [m.text for m in warnings_of(Scenario(traffic=quiet))] == ["there is no radar"]


def test_scenes_made_in_python_are_checked_too() -> None:
    radars = (
        Radar(name="a", sac=1, sic=1, lat_deg=math.nan, lon_deg=2.1),
        Radar(name="a", sac=1, sic=1, lat_deg=41.3, lon_deg=2.1, kind="sonar"),
    )
    with pytest.raises(SettingsError) as caught:
        check_scenario(Scenario(radar=radars, traffic=Traffic(arrivals=0.0, departures=0.0)))
    for part in ("4 mistakes", "lat_deg = nan", "kind = 'sonar'", "name = 'a' was used before", "1/1 were used before"):
        assert part in str(caught.value)
    with pytest.raises(SettingsError, match="nothing to see"):
        simulate(Scenario(traffic=Traffic(aircraft=0)), 1)
