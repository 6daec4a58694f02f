"""Every term's columns against the physics: move the antenna, shift the time, displace the target, lean the axis, look again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import SettingsError
from boresight.measure import polar_from_enu, polar_motion, wrap_rad
from boresight.terms import DEG, MODELS, TERMS, Geometry, terms_of

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


@given(places)
def test_constant_and_proportional_terms(place: tuple[float, ...]) -> None:
    g = seen(place)
    r, a = place[0], place[1]
    expected = {
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
    for bad in ("nothing_of_the_kind", "", "range_bias,range_bias", []):
        with pytest.raises(SettingsError):
            terms_of(bad)
