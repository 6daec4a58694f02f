"""The report: complete, self-contained, the same every time, and true to the numbers that went in."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student

from boresight.assessment import Residuals
from boresight.calibration import Calibration
from boresight.errors import InputError
from boresight.model import Sensors
from boresight.report import write_report
from boresight.report.drawing import binned, group_quantiles, length_text, robust_sd, term_label
from boresight.report.figures import quantities
from boresight.report.page import decimals, number, render, rows_of, verdict
from boresight.terms import TERMS
from conftest import Scene

FIGURES = ("map", "tracks", "curve", "residuals", "targets", "histograms")
VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """What tests ask of a page: elements in order, ids, references, text; fails on tags that do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            elif name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                self.links.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def html_of(scene: Scene, **more: object) -> str:
    return render(scene.calibration, scene.residuals, scene.sensors, title="Radar calibration", **more)


@pytest.fixture(scope="module")
def html(scene: Scene) -> str:
    return html_of(scene, truth=scene.truth)


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_page_is_self_contained(html: str, page: Page) -> None:
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in page.links)
    assert not re.search(r"@import|url\(\s*['\"]?(?!#)", html)
    outside = {u for u in re.findall(r"https?://[^\s\"'<>]+", html)}
    assert outside <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_every_reference_inside_the_page_has_its_target_and_ids_are_unique(html: str, page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    wanted = {link[1:] for link in page.links if link.startswith("#")} | set(re.findall(r"url\(#([^)]+)\)", html))
    assert wanted <= set(page.ids)


def test_every_figure_term_and_undetermined_term_is_there(scene: Scene, html: str, page: Page) -> None:
    key = scene.calibration.sensors[0].sensor
    for kind in FIGURES:
        assert f"sensor-{key}-{kind}" in page.ids
    assert "correlation" in page.ids
    assert page.tags.count("svg") == len(FIGURES) + 1
    for k in range(1, len(FIGURES) + 2):
        assert f"Figure {k}." in page.text
    for term in scene.calibration.terms:
        assert f"<td>{term.name.replace('_', ' ')}</td>" in html
    for missing in scene.calibration.not_determined:
        assert missing.term.replace("_", " ") in page.text
        assert missing.why in page.text
    for given_file in scene.calibration.inputs:
        assert given_file.sha256 in page.text
    assert "positive: the radar points too far clockwise" in page.text


def test_axes_carry_units_and_words(page: Page) -> None:
    for label in (
        "range error (m)", "azimuth error (°)", "range (km)", "azimuth (°)", "speed (m/s)", "time (UTC, 2023-11-14)",
        "horizontal distance (m)", "east of the radar (km)", "north of the radar (km)", "plots per bin (%)",
        "plot after correction",
    ):  # fmt: skip
        assert label in page.text, label


def test_true_values_and_deviations_are_printed(scene: Scene, page: Page) -> None:
    assert "+180.0" in page.text  # the true range bias, to the decimals of its sd
    assert "−0.3500" in page.text
    k = [key.name for key in scene.calibration.terms].index("range_bias")
    off = (scene.calibration.value[0, k] - 180.0) / scene.calibration.sd[0, k]
    assert number(off, 1, sign=True) in page.text


def test_same_bytes_twice(scene: Scene, html: str) -> None:
    assert html_of(scene, truth=scene.truth) == html


def test_file_is_written_whole(scene: Scene, html: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("earlier", encoding="utf-8")
    calibration, r = scene.calibration, scene.residuals
    assert write_report(path, calibration, r, scene.sensors, title="Radar calibration", truth=scene.truth) == path
    assert path.read_text(encoding="utf-8") == html
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(InputError, match=r"missing/report\.html"):
        write_report(tmp_path / "missing" / "report.html", calibration, r, scene.sensors, title="")


def test_what_files_and_warnings_say_is_not_taken_for_markup(build: Callable[..., Scene]) -> None:
    evil = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
    s = build(aircraft=3, plots_each=10, radars=(evil,), files=(evil, f"{evil}&amp;"), warnings=(evil,))
    s = replace(s, calibration=replace_calibration(s.calibration, settings={evil: [evil]}))
    text = render(s.calibration, s.residuals, s.sensors, title=evil, warnings=[evil + "2"])
    parsed = Page(text)
    assert "script" not in parsed.tags
    assert "img" not in parsed.tags
    assert evil in parsed.text
    assert "&amp;amp;" in text


def replace_calibration(found: Calibration, **changes: object) -> Calibration:
    return replace(found, **changes)


def test_elevation_has_its_own_panels_only_where_measured(build: Callable[..., Scene], page: Page) -> None:
    with_elevation = Page(html_of(build(aircraft=6, plots_each=40, elevation=True)))
    assert "elevation error (°)" in with_elevation.text
    assert "elevation error (°)" not in page.text


def test_three_radars_have_three_sections(build: Callable[..., Scene]) -> None:
    s = build(aircraft=5, plots_each=40, radars=("Alpha", "Bravo", "Charlie"))
    parsed = Page(html_of(s))
    assert parsed.tags.count("svg") == 3 * len(FIGURES) + 1
    assert len(parsed.ids) == len(set(parsed.ids))
    assert "Bravo: azimuth bias" in parsed.text  # the correlation matrix names the radar


def test_three_plots_only(build: Callable[..., Scene]) -> None:
    parsed = Page(html_of(build(aircraft=1, plots_each=3)))
    assert "3 plots" in parsed.text
    assert parsed.tags.count("svg") >= 3


def test_a_radar_without_plots_and_nothing_at_all(scene: Scene) -> None:
    nothing = scene.residuals[:0]
    parsed = Page(render(scene.calibration, nothing, scene.sensors, title="x"))
    assert "could be paired with a reference: there is nothing to draw" in parsed.text
    assert parsed.tags.count("svg") == 1  # the correlation of the terms needs no plots
    empty = Calibration((), np.array([0.0]), np.zeros((1, 0)), np.zeros((1, 0, 0)))
    assert "holds no sensor" in Page(render(empty, Residuals(), Sensors(()), title="x")).text


@pytest.mark.parametrize(
    "column", ["reference_speed_mps", "azimuth_before_rad", "distance_after_m", "reference_elevation_rad", "range_after_m"]
)
def test_unknown_values_never_stop_the_report(scene: Scene, column: str) -> None:
    some = scene.residuals[::20]
    gone = some.replace(**{column: np.full(len(some), np.nan)})
    text = Page(render(scene.calibration, gone, scene.sensors, title="x")).text
    assert "nan" not in text.lower().replace("finance", "")
    if column == "reference_speed_mps":
        assert "speed (m/s)" not in text  # no empty axes


def test_the_page_does_not_grow_with_the_number_of_plots(scene: Scene, html: str) -> None:
    many = Residuals.concat([scene.residuals] * 80)
    text = render(scene.calibration, many, scene.sensors, title="x")
    assert len(text) < 2 * len(html)
    assert "random choice of 4\u202f000 of 250\u202f000 plots" in text
    assert "a fixed random choice of 250\u202f000 of the" in text


@dataclass(frozen=True)
class Said:
    not_used: dict[str, int]
    bias: tuple[object, ...] = ()


def test_plots_not_used_are_counted_in_words(scene: Scene) -> None:
    text = Page(html_of(scene, association=Said({"parked": 3, "outside the gate": 14_112}))).text
    assert re.search(r"14\u202f112\s*farther from the reference than the gate allows\s*3\s*of targets that do not move", text)


# ------------------------------------------------------------------------------------------------------------ numbers in words


@given(st.floats(1e-7, 1e5))
def test_sd_is_shown_with_two_significant_digits(sd: float) -> None:
    text = number(sd, decimals(sd))
    digits = text.replace(".", "").lstrip("0")
    assert len(digits) == 2 or sd >= 10
    assert float(text) == pytest.approx(sd, rel=0.051)


def test_terms_are_told_in_words() -> None:
    assert term_label("range_bias@mode_s_psr") == "range bias (mode s psr)"
    assert term_label("reference_time_offset@source 5227") == "reference time offset (20/107)"
    assert term_label("reference_time_offset@source 65536") == "reference time offset (id 65536)"


def test_numbers_have_a_true_minus_and_no_negative_zero() -> None:
    assert number(-0.04, 1, sign=True) == "0.0"
    assert number(-2.25, 2) == "−2.25"
    assert number(float("nan"), 1) == "–"
    assert decimals(0.0996) == 2
    assert decimals(0.0123) == 3


def test_intervals_and_grey_rows_are_those_of_the_calibration(scene: Scene) -> None:
    """Few targets that tell as much make wide intervals; a row is grey exactly where its interval holds zero."""
    few = msgspec.structs.replace(scene.calibration.sensors[0], effective_targets=5.0)
    found = replace_calibration(scene.calibration, sensors=(few,))
    interval = found.interval(0.95)[0]
    # t of 4 degrees of freedom, by a covariance that is wider than its scale by 4 / (4 - 2)
    half = student.ppf(0.975, 4) * np.sqrt(2 / 4) * found.sd[0]
    np.testing.assert_allclose(interval, np.stack([found.value[0] - half, found.value[0] + half], 1), rtol=1e-9)
    rows = rows_of(found, few, {})
    assert [row.name for row in rows] == [key.name for key in found.terms]
    for row, key, (low, high) in zip(rows, found.terms, interval, strict=True):
        scale = TERMS[key.name].si_per_unit
        places = len(row.sd.partition(".")[2])
        assert (row.low, row.high) == (number(low / scale, places, sign=True), number(high / scale, places, sign=True))
        assert row.significant == (low * high > 0)


def test_who_is_handed_the_report_finds_targets_files_and_sensors(scene: Scene) -> None:
    names = {int(k): f"34{k:04X}" for k in np.unique(scene.residuals.target)}
    html = html_of(scene, targets=names, reference=["adsb.ast"])
    page = Page(html)
    assert all(name in page.text for name in names.values())
    assert "Mode S address" in page.text
    assert "<td>radar.ast</td><td>radar</td>" in html
    assert "<td>adsb.ast</td><td>reference</td>" in html
    sensor = scene.sensors.find(scene.calibration.sensors[0].sensor)
    assert sensor is not None
    assert f"{sensor.lat_deg:.6f}°, {sensor.lon_deg:.6f}°" in page.text
    assert "combined primary and secondary radar, SAC/SIC 1/1" in page.text


@pytest.mark.parametrize(
    ("metres", "text"),
    [(18_133.0, "18 km"), (1_240.0, "1.2 km"), (996.0, "1 km"), (140.2, "140 m"), (9.04, "9 m"), (0.31, "0.31 m")],
)
def test_lengths_in_captions(metres: float, text: str) -> None:
    assert length_text(metres) == text


def test_every_method_and_every_setting_of_it_is_explained() -> None:
    from boresight.registration.methods import METHODS, options_of
    from boresight.report.page import _SETTINGS, METHODS_ABOUT

    options = {name.rpartition(".")[2] for method in METHODS.values() for name in options_of(method)}
    assert set(_SETTINGS) == {"method", "kind", "main", "online", *options}
    assert set(METHODS_ABOUT) == set(METHODS)


def test_errors_over_time_are_drawn_and_their_span_told(scene: Scene) -> None:
    from boresight.report.over_time import bias_figure

    static = scene.calibration
    key = static.terms[0].sensor
    assert bias_figure(static, None, key, "none") is None
    k = 5
    growing = np.linspace(0.5, 1.5, k)[:, None] * static.value
    growing[:, 1] = static.value[0, 1]
    known = np.where(np.arange(k) == 0, 100.0, 1.0)[:, None, None] * static.covariance
    known[:, 1] = static.covariance[0, 1]
    known[:, :, 1] = static.covariance[0, :, 1]
    over_time = replace(
        static, epoch_s=static.epoch_s + 60.0 * np.arange(k), value=growing, covariance=known, settings={"method": "kalman-bank"}
    )
    drawn = bias_figure(over_time, None, key, "over")
    assert drawn is not None
    assert "95" in drawn.svg
    rows = {row.name: row for row in rows_of(over_time, over_time.sensors[0], {})}
    assert rows[static.terms[1].name].over == ""
    # The first epoch, which is hardly known, is not part of the span.
    low, high = (float(v.replace("\u2212", "-")) for v in rows["range_bias"].over.split(" … "))
    np.testing.assert_allclose((low, high), np.array([0.75, 1.5]) * static.value[0, 0], rtol=0.02)
    first, _ = verdict(over_time, over_time.sensors[0])
    assert first.startswith("At the end of the recording, Alpha ")
    text = render(over_time, scene.residuals, scene.sensors, title="x")
    assert "a bank of Kalman filters" in text
    assert "the newest of 5 epochs" in text


def test_a_turned_picture_is_said_in_words(scene: Scene) -> None:
    from boresight.calibration import TermKey

    static = scene.calibration
    key = static.terms[0].sensor
    names = ("rotation_up", "rotation_east", "rotation_north")
    turned = replace(
        static,
        terms=tuple(TermKey(key, "all", name, "deg") for name in names),
        value=np.radians([[0.5, -0.2, 0.3]]),
        covariance=np.radians(0.01) ** 2 * np.eye(3)[None],
    )
    first, _ = verdict(turned, static.sensors[0])
    assert "turns the picture 0.500° anticlockwise" in first
    assert "turns the picture 0.200° about the east axis (down in the north)" in first
    assert "turns the picture 0.300° about the north axis (down in the east)" in first


def test_verdict_says_direction_and_what_is_not_distinguishable(scene: Scene) -> None:
    summary = scene.calibration.sensors[0]
    first, second = verdict(scene.calibration, summary)
    assert re.search(r"measures ranges 1[678]\d\u202fm too long", first)
    assert "reads azimuths 0.35" in first
    assert "too far anticlockwise" in first
    assert re.search(r"stamps its plots 0\.[34]\d*\u202fs late", first)
    assert "azimuth sin" in second  # its true value is 0
    opposite = replace_calibration(scene.calibration, value=-scene.calibration.value)
    first, _ = verdict(opposite, summary)
    for words in ("too short", "too far clockwise", "early"):
        assert words in first


def test_verdict_of_a_radar_without_errors(scene: Scene) -> None:
    clean = replace_calibration(scene.calibration, value=0 * scene.calibration.value)
    first, second = verdict(clean, scene.calibration.sensors[0])
    assert first == "Alpha shows no error that these data can tell from zero."
    assert "range bias" in second


# ---------------------------------------------------------------------------------------------------------------- statistics


def test_binned_medians_are_those_of_numpy() -> None:
    random = np.random.default_rng(5)
    x, y = random.uniform(0, 10, 5000), random.standard_normal(5000)
    y[:7] = np.nan
    edges = np.linspace(0, 10, 11)
    b = binned(x, y, edges)
    assert len(b.median) == 10
    for k in range(10):
        inside = (x >= edges[k]) & (x < edges[k + 1]) & np.isfinite(y)
        assert b.number[k] == inside.sum()
        np.testing.assert_allclose((b.low[k], b.median[k], b.high[k]), np.percentile(y[inside], (16, 50, 84)))
        assert b.centre[k] == pytest.approx(np.median(x[inside]))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 6), st.floats(-1e6, 1e6)), max_size=60), st.floats(0, 1))
def test_quantiles_of_groups_are_those_of_numpy(pairs: list[tuple[int, float]], share: float) -> None:
    group, values = np.array([p[0] for p in pairs], np.int64), np.array([p[1] for p in pairs], np.float64)
    (found,), number = group_quantiles(values, group, 7, (share,))
    for k in range(7):
        inside = values[group == k]
        assert number[k] == len(inside)
        if len(inside):
            np.testing.assert_allclose(found[k], np.quantile(inside, share), atol=1e-6)
        else:
            assert np.isnan(found[k])


def test_thin_bins_are_left_out() -> None:
    b = binned(np.array([0.5] * 20 + [1.5] * 3), np.ones(23), np.array([0.0, 1.0, 2.0]))
    np.testing.assert_array_equal(b.median, [1, np.nan])


def test_robust_sd_of_normal_errors_and_of_outliers() -> None:
    values = np.random.default_rng(6).standard_normal(200_000) * 3
    assert robust_sd(values) == pytest.approx(3.0, rel=0.01)
    values[:10_000] = 1e6
    assert robust_sd(values) == pytest.approx(3.0, rel=0.08)
    assert np.isnan(robust_sd(np.array([1.0])))


def test_quantities_are_in_degrees_and_metres(scene: Scene) -> None:
    found = {q.name: q for q in quantities(scene.residuals)}
    assert set(found) == {"range", "azimuth"}
    np.testing.assert_allclose(found["azimuth"].before, np.degrees(scene.residuals.azimuth_before_rad))
    assert abs(np.median(found["azimuth"].before) + 0.35) < 0.15


@pytest.fixture(autouse=True)
def _settings_of_matplotlib_stay_as_they_were() -> Iterator[None]:
    import matplotlib

    before = dict(matplotlib.rcParams)
    yield
    assert dict(matplotlib.rcParams) == before
