"""Every term's columns against the physics: move the antenna, shift the time, displace the target, lean the axis, look again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from boresight.errors import SettingsError
from boresight.measure import polar_from_enu, polar_motion, wrap_rad
from boresight.model import Channel, Flag
from boresight.terms import (
    ALIASES,
    CHANNELS,
    DEG,
    MODELS,
    TABLES,
    TERMS,
    Geometry,
    Whose,
    late_s,
    precision,
    reference_term,
    summarised,
    terms_of,
)

# Where targets are: range 200 m to 400 km, elevation -1 to 75 degrees.
places = st.tuples(
    st.floats(200, 4e5), st.floats(0, 2 * np.pi), st.floats(-1 * DEG, 75 * DEG), st.floats(0, 2 * np.pi), st.floats(5, 80)
)
velocities = st.tuples(*[st.floats(-300, 300)] * 2, st.floats(-20, 20))


def enu(r: float, a: float, e: float) -> np.ndarray:
    return r * np.array([[np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)]])


def seen(place: tuple[float, ...], velocity: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Geometry:
    r, a, e, heading, length = place
    polar, rate, second, third = polar_motion(enu(r, a, e), np.array([velocity]), np.zeros((1, 3)))
    return Geometry(*polar.T, rate, second, third, np.array([heading]), np.array([length]), np.zeros(1))


def difference(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    d = polar_from_enu(after) - polar_from_enu(before)
    d[:, 1] = wrap_rad(d[:, 1])
    return d


def close(column: np.ndarray, physical: np.ndarray, r: float, tolerance: float) -> None:
    """Both as metres at the target."""
    assert np.allclose(column * [1, r, r], physical * [1, r, r], rtol=0, atol=tolerance)


@given(places, st.sampled_from(["site_east", "site_north", "site_up"]))
def test_site_terms_are_what_an_antenna_out_of_place_measures(place: tuple[float, ...], name: str) -> None:
    """measured - true: an antenna that stands 1 m east of the position given sees every target 1 m further west."""
    p = enu(*place[:3])
    shift = np.eye(3)[["site_east", "site_north", "site_up"].index(name)]
    h = 1e-3
    physical = (difference(p - h * shift, p + h * shift)) / (2 * h)
    g = seen(place)
    close(TERMS[name].columns(g), physical, place[0], 1e-4)


@given(places)
def test_extent_terms_displace_the_target_along_its_heading(place: tuple[float, ...]) -> None:
    p = enu(*place[:3])
    ahead = np.array([np.sin(place[3]), np.cos(place[3]), 0.0])
    h = 1e-3
    physical = difference(p + h * ahead, p - h * ahead) / (2 * h)
    g = seen(place)
    close(TERMS["along_heading"].columns(g), physical, place[0], 1e-4)
    close(TERMS["along_heading_per_length"].columns(g), physical * place[4], place[0], 1e-2)


@given(places, velocities)
def test_a_late_stamp_puts_the_plot_where_the_target_was(place: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    """A plot stamped t late by d was measured at t - d: measured - true(t) = h(p - v d) - h(p)."""
    p, v, h = enu(*place[:3]), np.array([velocity]), 1e-4
    physical = difference(p - v * h, p + v * h) / (2 * h)
    close(TERMS["time_offset"].columns(seen(place, velocity)), physical, place[0], 1e-2)
    # And stamped late along the track means behind.
    along = float((TERMS["time_offset"].columns(seen(place, velocity))[0, 0]) * np.sign(v[0] @ p[0]))
    assert along <= 1e-6


@given(places, st.sampled_from(["tilt_north", "tilt_east"]))
def test_tilt_terms_lean_the_axis(place: tuple[float, ...], name: str) -> None:
    """An axis that leans away from a direction makes targets in that direction look higher there.

    Independent of the term: rotate the target about the horizontal axis across the direction, and look from the level antenna.
    """
    p = enu(*place[:3])[0]
    toward = np.array([0.0, 1.0, 0.0]) if name == "tilt_north" else np.array([1.0, 0.0, 0.0])
    axis = np.cross(toward, [0.0, 0.0, 1.0])
    h = 1e-5

    def rotated(angle: float) -> np.ndarray:
        return (p * np.cos(angle) + np.cross(axis, p) * np.sin(angle) + axis * (axis @ p) * (1 - np.cos(angle)))[None]

    physical = difference(rotated(h), rotated(-h)) / (2 * h)
    # A rotation leaves the range as it is, but for rounding.
    assert abs(physical[0, 0]) < 1e-9 * place[0] / h
    close(TERMS[name].columns(seen(place)), physical * [0, 1, 1], 1.0, 1e-6)


# Targets that keep away from the antenna, so that a difference over a tenth of a second is a derivative.
motions = st.tuples(
    st.floats(5e3, 2e5), st.floats(0, 2 * np.pi), st.floats(0, 60 * DEG), *[st.floats(-200, 200)] * 2, *[st.floats(-8, 8)] * 3
)


@given(motions)
def test_lag_and_jerk_terms_are_the_rates_of_what_is_measured(motion: tuple[float, ...]) -> None:
    """Second and third derivatives of range, azimuth and elevation, by differences of seven places of a parabola."""
    r, a, e, *rest = motion
    p, v, acceleration = enu(r, a, e), np.array([[*rest[:2], 5.0]]), np.array([rest[2:]])
    h = 0.25
    t = h * np.arange(-3, 4)[:, None]
    polar = polar_from_enu(p + v * t + acceleration * t**2 / 2)
    polar[:, 1] = wrap_rad(polar[:, 1] - polar[3, 1])
    # Central differences of the fourth order and more.
    second = np.array([2, -27, 270, -490, 270, -27, 2]) @ polar / (180 * h**2)
    third = np.array([1, -8, 13, 0, -13, 8, -1]) @ polar / (8 * h**3)
    motion_rates = polar_motion(p, v, acceleration)
    g = Geometry(*motion_rates[0].T, *motion_rates[1:], np.zeros(1), np.zeros(1), np.zeros(1))
    for k, channel in enumerate(("range", "azimuth", "elevation")):
        scale = r if k else 1.0
        unit = np.eye(3)[k] * scale
        for name, derivative, tolerance in ((f"{channel}_lag", second, 1e-3), (f"{channel}_jerk", third, 1e-3)):
            np.testing.assert_allclose(TERMS[name].columns(g)[0] * scale, derivative[k] * unit, rtol=1e-3, atol=tolerance)


@given(places, velocities, st.floats(0, 86400))
def test_a_drifting_clock_is_late_by_more_and_more(place: tuple[float, ...], velocity: tuple[float, ...], since: float) -> None:
    g = seen(place, velocity)._replace(time_s=np.array([since]))
    assert np.allclose(TERMS["clock_drift"].columns(g), TERMS["time_offset"].columns(g) * since)
    terms = terms_of("range_bias,time_offset,clock_drift")
    assert late_s(terms, [7.0, 0.5, 1e-5], g.time_s) == pytest.approx([0.5 + 1e-5 * since])


@given(places, st.sampled_from(["rotation_east", "rotation_north", "rotation_up"]))
def test_rotations_turn_the_picture_by_the_right_hand_rule(place: tuple[float, ...], name: str) -> None:
    p = enu(*place[:3])[0]
    axis = np.eye(3)[["rotation_east", "rotation_north", "rotation_up"].index(name)]
    h = 1e-5
    turned = [(p * np.cos(x) + np.cross(axis, p) * np.sin(x) + axis * (axis @ p) * (1 - np.cos(x)))[None] for x in (h, -h)]
    close(TERMS[name].columns(seen(place)), difference(*turned) / (2 * h) * [0, 1, 1], 1.0, 1e-6)


@given(
    places,
    st.sampled_from(
        [
            ("stretch_east", (0, 0)), ("stretch_north", (1, 1)), ("stretch_up", (2, 2)), ("shear_east_north", (0, 1)),
            ("shear_east_up", (0, 2)), ("shear_north_up", (1, 2)),
        ]
    ),
)  # fmt: skip
def test_stretch_and_shear_distort_the_picture_symmetrically(place: tuple[float, ...], term: tuple[str, tuple[int, int]]) -> None:
    """Measured is p + S p; away from the pole over the antenna, where azimuths have no derivative."""
    p = enu(*place[:3])
    name, (i, j) = term
    strain = np.zeros((3, 3))
    strain[i, j] = strain[j, i] = 1.0
    h = 1e-6
    physical = difference(p + h * p @ strain, p - h * p @ strain) / (2 * h)
    # Per kilometre of range.
    close(TERMS[name].columns(seen(place)) / place[0], physical / place[0], place[0], 1e-5)
    assert TERMS[name].si_per_unit * 1000 == 1


def test_refraction_is_the_path_through_thinning_air() -> None:
    """Against adaptive quadrature, and the figures of METHODS section 6: 35 m at 200 km and flight level 360 for 315 ppm."""
    for r, e in ((2e5, np.arcsin((10973 - 200e3**2 / 2 / 6371e3) / 200e3)), (4e5, 0.002), (50e3, 0.2), (12e3, 1.5), (1e3, -0.05)):

        def density(s: float, e: float = e) -> float:
            return float(np.exp(-(s * np.sin(e) + (s * np.cos(e)) ** 2 / 2 / 6371e3) / 7350))

        expected, _ = quad(density, 0, r, epsabs=1e-6, epsrel=1e-12)
        column = TERMS["range_refraction"].columns(seen((r, 1.0, e, 0.0, 0.0)))
        assert column[0, 0] == pytest.approx(expected, rel=1e-6)
        assert not column[0, 1:].any()
    far = TERMS["range_refraction"].columns(seen((2e5, 1.0, np.arcsin(0.03917), 0.0, 0.0)))
    assert far[0, 0] * 315 * TERMS["range_refraction"].si_per_unit == pytest.approx(35, abs=0.5)


@given(st.floats(-1 * DEG, 89 * DEG))
def test_elevation_refraction_is_the_cotangent_but_for_the_horizon(e: float) -> None:
    column = TERMS["elevation_refraction"].columns(seen((1e4, 1.0, e, 0.0, 0.0)))[0]
    assert not column[:2].any()
    assert -0.01 <= column[2] <= 50
    if e > 15 * DEG:
        assert column[2] == pytest.approx(1 / np.tan(e), rel=0.03, abs=0.003)


@given(st.floats(0, 2 * np.pi), st.floats(0, 5e5))
def test_tables_are_straight_between_their_nodes(a: float, r: float) -> None:
    g = seen((max(r, 1.0), a, 0.1, 0.0, 0.0))
    nodes = {table: np.array([int(n[-6:] if "range" in n else n[-3:]) for n in names], float) for table, names in TABLES.items()}
    rng = np.random.default_rng(0)
    height = rng.normal(size=24)
    got = sum(h * TERMS[n].columns(g)[0] for h, n in zip(height, TABLES["azimuth_table"], strict=True))
    expected = np.interp(a / DEG, [*nodes["azimuth_table"], 360.0], [*height, height[0]])
    assert np.allclose(got, [0, expected, 0], atol=1e-9)
    height = rng.normal(size=len(nodes["range_table"]))
    got = sum(h * TERMS[n].columns(g)[0] for h, n in zip(height, TABLES["range_table"], strict=True))
    assert np.allclose(got, [np.interp(g.range_m[0], nodes["range_table"], height), 0, 0], atol=1e-9)


def test_the_prior_of_a_table_is_smooth_and_keeps_out_what_other_terms_hold() -> None:
    terms = terms_of("azimuth_bias,azimuth_table,range_table")
    covariance = np.linalg.inv(precision(terms))
    assert covariance[0, 0] == pytest.approx(1.0)
    assert not covariance[0, 1:].any()
    azimuth = covariance[1:25, 1:25]
    angle = np.arange(24) * 15 * DEG
    for shape in (np.ones(24), np.cos(angle), np.sin(2 * angle)):
        unit = shape / np.linalg.norm(shape)
        assert unit @ azimuth @ unit < 1.1e-4
    third = np.cos(3 * angle) / np.sqrt(12)
    assert third @ azimuth @ third > 1.0
    # The quicker, the less plausible.
    assert third @ azimuth @ third > 2 * (np.cos(8 * angle) / np.sqrt(12)) @ azimuth @ (np.cos(8 * angle) / np.sqrt(12))
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_terms_of_a_channel_act_on_its_plots_alone() -> None:
    n = 5
    g = seen((1e4, 1.0, 0.1, 0.0, 0.0), (100.0, 50.0, 0.0))
    g = Geometry(*(np.repeat(c, n, axis=0) for c in g if c is not None))
    channel = np.array([Channel.PSR, Channel.SSR, Channel.MODE_S, Channel.SSR_PSR, Channel.MODE_S_PSR])
    flags = np.array([0, Flag.CHAIN_2, 0, Flag.CHAIN_2, Flag.GROUND], np.uint32)
    whose = Whose(channel, flags, np.full(n, 7))
    acts = {
        "psr": [1, 0, 0, 0, 0],
        "ssr": [0, 1, 0, 1, 0],
        "mode_s": [0, 0, 1, 0, 1],
        "chain1": [1, 0, 1, 0, 1],
        "chain2": [0, 1, 0, 1, 0],
    }
    assert set(acts) == set(CHANNELS)
    for name, rows in acts.items():
        (term,) = terms_of([f"range_bias@{name}"])
        assert (term.base, term.channel, term.unit) == ("range_bias", name, "m")
        assert term.columns(g._replace(whose=whose))[:, 0].tolist() == rows
        (late,) = terms_of([f"time_offset@{name}"])
        assert late_s([late], [0.5], np.zeros(n), whose).tolist() == [0.5 * x for x in rows]
        assert np.array_equal(late.columns(g._replace(whose=whose)), -g.rate * np.array(rows)[:, None])
    assert late_s([reference_term(7)], [0.4], np.zeros(n), whose).tolist() == [-0.4] * n
    assert not late_s([reference_term(8)], [0.4], np.zeros(n), whose).any()
    # Primary plots have no transponder in them.
    assert TERMS["transponder_delay"].columns(g._replace(whose=whose))[:, 0].tolist() == [0, 1, 1, 1, 1]


def test_aliases_are_refused_and_named() -> None:
    for alias in ALIASES:
        assert {name for name in alias.names} <= set(summarised(TERMS))
        assert alias.why
        model = [*alias.names]
        if alias.always:
            with pytest.raises(SettingsError, match=alias.names[0]) as told:
                terms_of(model)
            assert alias.names[1] in str(told.value)
            assert alias.why in str(told.value)
            # One of them for a channel and the other for all are not the same.
            terms_of([alias.names[0], f"{alias.names[1]}@psr"])
        else:
            terms_of(model)
    # What is always alike is so at every place, but for the sign.
    g = seen((3e4, 2.0, 0.3, 1.0, 30.0), (100.0, -80.0, 3.0))
    for alias in ALIASES:
        one, two = (TERMS[name].columns(g) if alias.always else None for name in alias.names[:2])
        assert one is None or np.allclose(one, two) or np.allclose(one, -two)


@given(places)
def test_constant_and_proportional_terms(place: tuple[float, ...]) -> None:
    g = seen(place)
    r, a = place[0], place[1]
    expected = {
        "azimuth_cos2": (0, np.cos(2 * a), 0), "azimuth_sin2": (0, np.sin(2 * a), 0), "rotation_up": (0, -1, 0),
        "elevation_sag": (0, 0, np.cos(place[2])), "nonorthogonality": (0, np.tan(place[2]), 0),
        "collimation": (0, 1 / np.cos(place[2]), 0), "transponder_delay": (1, 0, 0),
        "range_bias": (1, 0, 0), "range_gain": (r, 0, 0), "azimuth_bias": (0, 1, 0), "elevation_bias": (0, 0, 1),
        "azimuth_cos": (0, np.cos(a), 0), "azimuth_sin": (0, np.sin(a), 0),
    }  # fmt: skip
    for name, columns in expected.items():
        assert np.allclose(TERMS[name].columns(g), [columns], rtol=1e-9, atol=1e-9), name
    # 1 m/km of gain at 1 km is 1 m.
    assert TERMS["range_gain"].si_per_unit * 1000 == 1


@pytest.mark.parametrize("name", sorted(TERMS))
@pytest.mark.parametrize("elevation", [0.0, -0.0, np.pi / 2, -np.pi / 2, 1e-12])
def test_columns_are_finite_everywhere(name: str, elevation: float) -> None:
    for r in (0.0, 1e-3, 100.0, 4e5):
        g = seen((r, 1.0, elevation, np.nan, np.nan), (100.0, 0.0, 0.0))
        columns = TERMS[name].columns(g)
        assert columns.shape == (1, 3)
        assert np.isfinite(columns).all(), (r, columns)


def test_terms_without_heading_or_length_do_nothing() -> None:
    g = seen((1e4, 1.0, 0.0, np.nan, np.nan))
    assert not TERMS["along_heading"].columns(g).any()
    assert not TERMS["along_heading_per_length"].columns(seen((1e4, 1.0, 0.0, 1.0, np.nan))).any()


def test_every_term_is_whole() -> None:
    for name, term in TERMS.items():
        assert term.name == name
        assert term.si_per_unit > 0
        assert term.prior_sd > 0
        assert term.meaning
        assert term.needs <= {"elevation", "rate", "second", "third", "heading", "length"}
    for model in MODELS:
        assert [t.name for t in terms_of(model)] == list(MODELS[model])


def test_models_and_lists() -> None:
    assert [t.name for t in terms_of("surface")] == list(MODELS["surface"])
    assert [t.name for t in terms_of("range_bias, time_offset")] == ["range_bias", "time_offset"]
    assert [t.name for t in terms_of(["azimuth_bias"])] == ["azimuth_bias"]
    assert [t.name for t in terms_of("azimuth_bias,azimuth_table@psr")][:2] == ["azimuth_bias", "azimuth_table_000@psr"]
    assert summarised(t.name for t in terms_of("azimuth_table@psr,range_bias")) == ["azimuth_table@psr", "range_bias"]
    for bad in ("nothing_of_the_kind", "", "range_bias,range_bias", [], "range_bias@nothing", "range_bias@"):
        with pytest.raises(SettingsError):
            terms_of(bad)
