"""The report as a document: decisions, conformity, budget, choices, clocks, chains, charts, messages, print."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from test_report import Page, html_of

from boresight.assessment.clock import Turning
from boresight.assessment.psr_ssr import psr_ssr
from boresight.assessment.requirement import Conformity
from boresight.calibration import Calibration, Choice, Decision, Effect, Share, Verdict
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.heights import HeightProfile
from boresight.model import Channel, Fixes, Platform, Plots, Recording, Sensor, Sensors
from boresight.report import Evidence, gather
from boresight.report.charts import clock_figure, height_figure, own_places, trial_figure
from boresight.report.drawing import degree_text, degree_ticks, style, to_svg
from boresight.report.evidence import Clock
from boresight.report.page import alias_groups, left_by_calibration, messages, render, unique_names
from boresight.terms import TERMS
from conftest import START_S, Scene

NOTHING = Recording("r.ast", Plots(), Fixes(), (), (), (), {}, np.empty(0, np.int64))


def advice(term: str, decision: Decision, why: str, gain: float, low: float, high: float) -> Verdict:
    return Verdict(channel="all", term=term, decision=decision, why=why, gain_m=gain, gain_low_m=low, gain_high_m=high)


def told(scene: Scene) -> Calibration:
    """The scene's calibration with all that may be said of a sensor."""
    summary = msgspec.structs.replace(
        scene.calibration.sensors[0],
        verdicts=(
            advice("range_bias", "apply", "nearer by 99 m", 99.0, 90.0, 108.0),
            advice("azimuth_sin", "hold", "no gain", 0.1, -1.0, 1.2),
            Verdict(channel="all", term="elevation_bias", decision="insufficient", why="nothing tells it"),
        ),
        criterion="cross-validation",
        choices=(
            Choice(action="start", term="range_bias + azimuth_bias", criterion=4321.5),
            Choice(action="add", term="azimuth_cos2", criterion=4300.0, change=-21.5, change_sd=4.0, why="2 terms"),
        ),
        budget=(Share("bias", 150.0, 700.0), Share("noise", 60.0, 80.0), Share("height", float("nan"), 0.0)),
        effects=(Effect("range_bias", float("inf"), 25.0), Effect("azimuth_bias", 60.0, 1e-4)),
    )  # fmt: skip
    return replace(scene.calibration, sensors=(summary,))


def judged(verdict: str, quantity: str) -> Conformity:
    return Conformity(
        requirement="Example, edition 1", clause="4.2", sensor="Alpha", quantity=quantity, unit="m", limit=100.0, value=180.0,
        low=170.0, high=190.0, verdict=verdict, why="the whole interval lies beyond",
    )  # fmt: skip


@pytest.fixture(scope="module")
def few(build: Callable[..., Scene]) -> Scene:
    return build(aircraft=3, plots_each=12)


@pytest.fixture(scope="module")
def document(few: Scene) -> str:
    scene = few
    conformity = (judged("fail", "range_bias"), judged("pass", "azimuth_bias"), judged("undecided", "time_offset"))
    return html_of(replace(scene, calibration=told(scene)), conformity=conformity)


def test_decisions_effects_choices_and_verdicts_are_told(document: str) -> None:
    page = Page(document)
    for words in (
        "nearer by 99 m", "no gain", "nothing tells it", "+99.0 (+90.0 … +108.0)", "add azimuth cos2", "−21.5 ± 4.0", "4321.5",
        "the same in all plots of a target", "another every 60 s", "Example, edition 1", "fails in range bias", "4.2",
        "systematic errors", "not known", "cross-validation",
    ):  # fmt: skip
        assert words in page.text, words
    for decision in ("apply", "hold", "insufficient", "pass", "fail", "undecided"):
        assert f'<b class="{decision}">{decision}</b>' in document
    for kind in ("gain", "budget", "choices"):
        assert any(name.endswith(f"-{kind}") for name in page.ids)
    assert len(page.ids) == len(set(page.ids))


def test_summary_stands_before_all_evidence(document: str) -> None:
    assert document.index('<b class="apply">') < document.index("<nav>") < document.index("<figure")


def test_print_has_a_page_and_no_network(document: str) -> None:
    assert "@page" in document
    assert "@media print" in document
    assert not re.search(r'(href|src)="(?!#|data:image/png)', document)


def test_budget_after_correction_is_the_calibrations_own_uncertainty(scene: Scene) -> None:
    """Against the covariance of one term alone: a range bias moves every plot by its own sd."""
    found = scene.calibration
    k = [key.name for key in found.terms].index("range_bias")
    only = Calibration((found.terms[k],), found.epoch_s, found.value[:, [k]], found.covariance[:, [k]][:, :, [k]])
    assert left_by_calibration(only, scene.residuals, timing=False) == pytest.approx((found.sd[0, k], 0.0))
    assert left_by_calibration(only, scene.residuals, timing=True) == (0.0, 0.0)
    k = [key.name for key in found.terms].index("time_offset")
    late = Calibration((found.terms[k],), found.epoch_s, found.value[:, [k]], found.covariance[:, [k]][:, :, [k]])
    along, across = left_by_calibration(late, scene.residuals, timing=True)
    speed = np.sqrt(np.mean(scene.residuals.reference_speed_mps**2))
    assert np.hypot(along, across) == pytest.approx(speed * found.sd[0, k], rel=0.05)


def test_terms_that_hang_together_are_named(scene: Scene) -> None:
    found = scene.calibration
    p = len(found.terms)
    covariance = np.eye(p) * 4.0
    covariance[0, 1] = covariance[1, 0] = -3.9
    groups = alias_groups(replace(found, covariance=covariance[None]), found.terms[0].sensor)
    assert groups == [(["range bias", "range gain"], "−0.97")]


def test_messages_come_by_kind() -> None:
    heed, tell = messages(
        [
            "/a/one.json: 1,669 of 3,814 true positions repeat one already listed; they were dropped",
            "/a/two.json: 12 of 99 true positions repeat one already listed; they were dropped",
            "7,553 reference heights are pressure altitudes",
            "12 reference heights are pressure altitudes",
            "the radar's clock is off",
        ]
    )
    assert [len(m.texts) for m in heed] == [2, 1]
    assert [len(m.texts) for m in tell] == [2]
    assert sum(len(m.texts) for m in heed + tell) == 5


def test_targets_of_one_name_are_told_apart() -> None:
    assert unique_names({0: "track 1", 1: "track 2", 5: "track 1"}) == {0: "track 1 (1)", 1: "track 2", 5: "track 1 (2)"}


# -------------------------------------------------------------------------------------------------------------------- evidence


def spinning(seed: int = 3) -> tuple[Recording, Sensors]:
    """A radar that turns in 4 s, stamps with 2 ms of jitter, and whose primary chain sees 200 m farther."""
    random = np.random.default_rng(seed)
    n = 3000
    turn = np.sort(random.uniform(0, 300, n))
    plots = Plots(
        time_s=START_S + 4.0 * turn + 2e-3 * random.standard_normal(n),
        sensor=np.full(n, 0x0101),
        channel=np.where(np.arange(n) % 2 == 0, Channel.MODE_S_PSR, Channel.SSR_PSR),
        range_m=random.uniform(10e3, 100e3, n),
        azimuth_rad=turn % 1 * 2 * np.pi,
        psr_ssr_range_m=200 + 30 * random.standard_normal(n),
        psr_ssr_azimuth_rad=np.radians(0.02 + 0.1 * random.standard_normal(n)),
        mode_s=random.integers(1, 40, n),
        record=np.arange(n),
    )
    recording = replace(NOTHING, plots=plots, receive_s=plots.time_s + 0.3, offset=np.arange(n))
    return recording, Sensors((Sensor(name="Alpha", lat_deg=45.0, lon_deg=7.0, height_m=300.0, sac=1, sic=1),))


def test_clock_and_chains_are_gathered_and_shown(few: Scene) -> None:
    scene = few
    recording, sensors = spinning()
    evidence = gather(recording.plots, [recording], sensors)
    (clock,) = evidence.clocks
    assert clock.rotation is not None
    assert clock.rotation.period_s == pytest.approx(4.0, abs=1e-4)
    assert clock.received is not None
    assert clock.received.median_s == pytest.approx(0.3, abs=0.01)
    assert evidence.psr_ssr is not None
    assert len(evidence.psr_ssr) == len(psr_ssr(recording.plots))
    page = Page(html_of(scene, evidence=evidence))
    for words in ("Primary minus secondary radar", "Mode S + PSR", "Clock and rotation", "jitter of the stamps",
                  "PSR − SSR range (m)",
                  "stamp − even turning (ms)", "reception − stamp (s)"):  # fmt: skip
        assert words in page.text, words
    assert re.search(r"4\.000\d\d s", page.text)
    assert len(page.ids) == len(set(page.ids))


def test_nothing_to_gather_is_nothing_to_show() -> None:
    evidence = gather(Plots(), [NOTHING], Sensors(()))
    assert evidence.clocks == ()
    assert evidence.psr_ssr is None
    assert clock_figure(Clock(1, "r", None, None, (), Turning(1, *[np.empty(0)] * 4), (np.empty(0), np.empty(0))), "x") is None


def test_own_ship_is_where_the_chart_puts_the_targets(scene: Scene) -> None:
    """The relative position put back about the moving ship, against the way through ECEF."""
    r = scene.residuals[::50]
    r = r.replace(reference_range_m=r.reference_range_m / 100, reference_elevation_rad=np.zeros(len(r)))
    order = np.argsort(r.time_s)
    ship = Platform(
        time_s=r.time_s[order], sensor=np.full(len(r), 257), latitude_rad=np.radians(45 + 1e-5 * np.arange(len(r))),
        longitude_rad=np.full(len(r), np.radians(7.0)), height_m=np.zeros(len(r)),
    )  # fmt: skip
    sensor = scene.sensors.find(257)
    assert sensor is not None
    found = own_places(r, ship, sensor)
    assert found is not None
    known = np.isfinite(found[0])
    at = np.searchsorted(ship.time_s, r.time_s[known])
    own = ecef_from_geodetic(ship.latitude_rad[at], ship.longitude_rad[at], ship.height_m[at])
    there = ecef_from_geodetic(found[0][known], found[1][known], np.zeros(known.sum()))
    east, north, _ = rotate(enu_from_ecef(ship.latitude_rad[at], ship.longitude_rad[at]), there - own).T
    np.testing.assert_allclose(np.arctan2(east, north) % (2 * np.pi), r.reference_azimuth_rad[known] % (2 * np.pi), atol=1e-5)
    np.testing.assert_allclose(np.hypot(east, north), r.reference_range_m[known], rtol=1e-5)
    assert geodetic_from_ecef(own)[0] == pytest.approx(ship.latitude_rad[at])
    drawing = trial_figure(r, "trial", ship, sensor, {})
    assert drawing is not None
    assert "own ship" in drawing.svg
    assert Evidence(platform=ship).platform is ship


def test_profile_of_heights_is_drawn() -> None:
    levels = np.tile(np.arange(0.0, 12_001.0, 1000.0), 2)
    hours = np.repeat([472_222, 472_223], 13)
    profile = HeightProfile("traffic", levels, hours, 100 + levels / 100, np.full(26, 12.0), np.full(26, 5), 20.0, targets=31)
    drawing = height_figure(profile, "heights")
    assert drawing is not None
    assert "geometric − pressure height (m)" in drawing.svg
    assert "22:00 UTC" in drawing.svg
    assert "31 targets" in drawing.caption
    assert height_figure(replace(profile, n=np.zeros(26, np.int64)), "heights") is None


@pytest.mark.parametrize(
    ("degrees", "step_min", "words", "text"),
    [
        (63.4385, 0.1, "NS", "63°26.3′N"), (-0.5, 10, "EW", "0°30′W"), (10.0, 60, "EW", "10°E"),
        (-33.999999, 0.01, "NS", "34°00.00′S"), (0.0, 1, "EW", "0°00′E"),
    ],
)  # fmt: skip
def test_degrees_read_as_on_charts(degrees: float, step_min: float, words: str, text: str) -> None:
    assert degree_text(np.radians(degrees), step_min, words) == text


def test_ticks_are_round_minutes_within_the_span() -> None:
    ticks, step = degree_ticks(np.radians(63.4331), np.radians(63.4415), 5)
    assert len(ticks) in (3, 4, 5)
    np.testing.assert_allclose(np.degrees(ticks) * 60 / step, np.round(np.degrees(ticks) * 60 / step), atol=1e-6)


def test_drawings_are_small_and_whole() -> None:
    from matplotlib.figure import Figure

    with style("one"):
        figure = Figure(figsize=(3, 2))
        axes = figure.add_axes((0.2, 0.2, 0.7, 0.7))
        axes.plot(np.linspace(0, 1, 50), np.random.default_rng(1).random(50))
        axes.set_title("0.123456")
        svg = to_svg(figure, "one")
        other = to_svg(figure, "another")
    Page(svg)
    assert ">0.123456<" in svg  # numbers in words stay as they are
    assert not re.search(r'd="[^"]*\.\d{3}', svg)
    assert set(re.findall(r"url\(#([^)]+)\)", svg)) <= set(re.findall(r'id="([^"]+)"', svg))
    assert svg != other


def test_nodes_of_a_table_are_one_row_of_the_summary(build: Callable[..., Scene]) -> None:
    from boresight.calibration import TermKey
    from boresight.terms import TABLES

    s = build(aircraft=4, plots_each=30)
    nodes = TABLES["azimuth_table"]
    keys = tuple(TermKey(257, "all", name, TERMS[name].unit) for name in nodes)
    p = len(keys)
    found = replace(
        s.calibration,
        terms=keys,
        value=np.full((1, p), 1e-3) * np.arange(p),
        covariance=np.eye(p)[None] * 1e-8,
        not_determined=(),
    )
    text = render(found, s.residuals, s.sensors, title="x")
    card = text[text.index("terms short") : text.index("<nav>")]
    assert card.count("<tr") == 2
    assert f"azimuth table, {p} nodes" in card


def test_residuals_name_their_targets(few: Scene, tmp_path: Path) -> None:
    from boresight.association import Association
    from boresight.flow import Run, write_results

    duckdb = pytest.importorskip("duckdb")
    found = Association(few.pairs, (), np.zeros(len(few.pairs), np.int64), None, ())
    run = Run(few.calibration, found, few.residuals, targets={0: "4CA123", 2: "HELLO"})
    write_results(run, few.sensors, tmp_path / "out")
    path = tmp_path / "out" / "residuals.parquet"
    rows = duckdb.sql(f"SELECT DISTINCT target, target_name FROM '{path}' ORDER BY target").fetchall()
    assert rows == [(0, "4CA123"), (1, None), (2, "HELLO")]
