"""What a radar measures: Jacobians and rates against complex steps, round trips, and plots placed on the ellipsoid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight import geodesy, measure
from boresight.errors import InputError, SettingsError
from boresight.model import Flag, Plots, Sensor, Sensors

TURN = st.floats(-50, 50)


def _radar(**kwargs: object) -> Sensor:
    return Sensor(**({"name": "R", "sac": 1, "sic": 2, "lat_deg": 41.3, "lon_deg": 2.1, "height_m": 80.0} | kwargs))


def _plots(n: int, **columns: object) -> Plots:
    return Plots(**({"time_s": np.arange(n, dtype=float), "sensor": np.full(n, 0x0102)} | columns))


@given(TURN)
def test_wrap_is_the_same_angle_within_half_a_turn(angle: float) -> None:
    wrapped = float(measure.wrap_rad(angle))
    assert -np.pi < wrapped <= np.pi
    assert abs(np.exp(1j * wrapped) - np.exp(1j * angle)) < 1e-13
    assert 0 <= float(measure.wrap_turn(angle)) < 2 * np.pi


def test_wrap_at_the_seam() -> None:
    assert measure.wrap_rad([np.pi, -np.pi, 3 * np.pi, 0.1]).tolist() == [np.pi, np.pi, np.pi, 0.1]
    assert measure.wrap_turn([-1e-20, 2 * np.pi, -0.5]).tolist() == [0.0, 0.0, 2 * np.pi - 0.5]


@given(
    st.floats(1.0, 6e5), st.floats(0, 2 * np.pi, exclude_max=True), st.floats(np.radians(-89), np.radians(89))
)  # fmt: skip
def test_polar_round_trip(r: float, a: float, e: float) -> None:
    polar = np.array([[r, a, e]])
    back = measure.polar_from_enu(measure.enu_from_polar(polar))
    assert abs(back[0, 0] - r) < 1e-12 * r + 1e-12
    assert abs(measure.wrap_rad(back[0, 1] - a)) * np.cos(e) < 1e-14
    assert abs(back[0, 2] - e) < 1e-13


def test_azimuth_is_clockwise_from_north() -> None:
    enu = np.array([[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0], [1, 1, np.sqrt(2)]], float)
    polar = measure.polar_from_enu(enu)
    assert np.allclose(np.degrees(polar[:, 1]), [0, 90, 180, 270, 45])
    assert np.degrees(polar[4, 2]) == pytest.approx(45)
    assert polar[4, 0] == pytest.approx(2)


def _scene(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    polar = np.stack([np.exp(rng.uniform(4, 13, n)), rng.uniform(0, 2 * np.pi, n), rng.uniform(-0.2, 1.4, n)], 1)
    return measure.enu_from_polar(polar)


def test_jacobians_against_differences_and_each_other() -> None:
    enu = _scene(200, 1)
    polar = measure.polar_from_enu(enu)
    jacobian, inverse = measure.polar_jacobian(enu), measure.enu_jacobian(polar)
    unit = jacobian @ inverse
    # Rows and columns of very different units: compare in metres.
    scale = np.stack([np.ones(len(enu)), polar[:, 0], polar[:, 0]], 1)
    assert np.abs(unit * scale[:, :, None] / scale[:, None, :] - np.eye(3)).max() < 1e-12
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1.0
        h = 1e-4 * polar[:, :1]
        difference = measure.polar_from_enu(enu + h * step) - measure.polar_from_enu(enu - h * step)
        difference[:, 1] = measure.wrap_rad(difference[:, 1])
        assert np.abs((difference / (2 * h) - jacobian[:, :, k]) * scale).max() < 1e-5
        h = np.array([1e-3 * polar[:, 0], np.full(len(enu), 1e-4), np.full(len(enu), 1e-4)][k])[:, None]
        difference = measure.enu_from_polar(polar + h * step) - measure.enu_from_polar(polar - h * step)
        per_unit = 1.0 if k == 0 else polar[:, :1]
        assert np.abs((difference / (2 * h) - inverse[:, :, k]) / per_unit).max() < 1e-7


def test_rates_against_the_taylor_series() -> None:
    """The rates predict the position a moment later to the fourth order, and the first rate equals a complex step."""
    rng = np.random.default_rng(2)
    enu = _scene(200, 3)
    velocity, acceleration, jerk = rng.normal(0, 100, enu.shape), rng.normal(0, 5, enu.shape), rng.normal(0, 1, enu.shape)
    polar, first, second, third = measure.polar_motion(enu, velocity, acceleration, jerk)

    def at(t: float) -> np.ndarray:
        return measure.polar_from_enu(enu + velocity * t + acceleration * t * t / 2 + jerk * t**3 / 6)

    metres = np.stack([np.ones(len(enu)), polar[:, 0], polar[:, 0]], 1)
    # Times in units of how fast the picture changes, so that near and far targets are judged alike.
    tau = np.minimum(np.hypot(enu[:, 0], enu[:, 1]) / np.linalg.norm(velocity, axis=1), 30.0)[:, None]
    for f, tolerance in ((0.02, 3e-5), (-0.01, 2e-6)):
        t = f * tau
        moved = np.array([at(float(x))[k] for k, x in enumerate(t[:, 0])])
        gone = moved - polar
        gone[:, 1] = measure.wrap_rad(gone[:, 1])
        predicted = first * t + second * t**2 / 2 + third * t**3 / 6
        assert np.abs((gone - predicted) * metres / polar[:, :1]).max() < tolerance
        # And the third-order term is needed: leaving it out is worse.
        short = first * t + second * t**2 / 2
        assert np.abs((gone - short) * metres).sum() > 5 * np.abs((gone - predicted) * metres).sum()
    h = 1e-20
    assert np.abs((np.imag(_complex_derivative(enu, velocity, h)) - first) * metres).max() < 1e-9


def _complex_derivative(enu: np.ndarray, velocity: np.ndarray, h: float) -> np.ndarray:
    """i times the derivative along `velocity`, by the chain rule of the analytic forms (no subtraction anywhere)."""
    z = enu + 1j * h * velocity
    ground2 = z[:, 0] ** 2 + z[:, 1] ** 2
    range_ = np.sqrt(ground2 + z[:, 2] ** 2)
    azimuth = np.imag(z[:, 0]) * enu[:, 1] - np.imag(z[:, 1]) * enu[:, 0]
    elevation = np.imag(z[:, 2]) * np.real(np.sqrt(ground2)) - np.imag(np.sqrt(ground2)) * enu[:, 2]
    flat2 = np.real(ground2)
    return 1j * np.stack([np.imag(range_), azimuth / flat2, elevation / (flat2 + enu[:, 2] ** 2)], 1) / h


def test_higher_rates_are_the_derivatives_of_the_lower_ones() -> None:
    rng = np.random.default_rng(4)
    enu = _scene(100, 5)
    v, a, j = rng.normal(0, 100, enu.shape), rng.normal(0, 5, enu.shape), rng.normal(0, 1, enu.shape)
    tau = 1e-4 * np.minimum(np.hypot(enu[:, 0], enu[:, 1]) / np.linalg.norm(v, axis=1), 30.0)[:, None]

    def at(t: np.ndarray) -> tuple[np.ndarray, ...]:
        return measure.polar_motion(enu + v * t + a * t**2 / 2 + j * t**3 / 6, v + a * t + j * t**2 / 2, a + j * t, j)

    before, now, after = at(-tau), at(0 * tau), at(tau)
    for lower, higher in ((1, 2), (2, 3)):
        difference = (after[lower] - before[lower]) / (2 * tau)
        size = np.abs(now[higher]).max(axis=0) * 0 + np.abs(now[lower]) / (tau * 1e4) + np.abs(now[higher])
        assert (np.abs(difference - now[higher]) / size).max() < 1e-5


def test_rates_stay_finite_over_the_antenna() -> None:
    polar, *rates = measure.polar_motion(np.array([[0.0, 0, 5000]]), np.array([[100.0, 0, 0]]), np.zeros((1, 3)))
    assert polar[0, 2] == pytest.approx(np.pi / 2)
    assert all(np.isfinite(r).all() for r in rates)
    assert np.isfinite(measure.polar_jacobian(np.array([[0.0, 0, 5000]]))).all()


@given(
    st.floats(-1.5, 1.5), st.floats(-3.1, 3.1), st.floats(-100, 4000), st.floats(10, 5e5), st.floats(0, 6.28),
    st.floats(-500, 1e5),
)  # fmt: skip
def test_position_from_height_holds_range_azimuth_and_height(
    lat: float, lon: float, site_height: float, r: float, a: float, height: float
) -> None:
    site, rotation = geodesy.ecef_from_geodetic(lat, lon, site_height), geodesy.enu_from_ecef(lat, lon)
    found = measure.position_from_height(np.array([r]), np.array([a]), np.array([height]), site, rotation)
    # The ellipsoid's height range at that slant distance: straight up and straight down bound it.
    if r < abs(height - site_height) - 1e-3:
        assert np.isnan(found).all()
    elif r > abs(height - site_height) + 1e-3:
        polar = measure.polar_from_position(found, site, rotation)[0]
        assert abs(polar[0] - r) < 1e-6
        assert abs(measure.wrap_rad(polar[1] - a)) * r * np.cos(polar[2]) < 1e-6
        assert abs(geodesy.geodetic_from_ecef(found)[2][0] - height) < 1e-6


def test_position_from_height_with_nonsense_is_nan() -> None:
    site, rotation = geodesy.ecef_from_geodetic(0.7, 0.1, 0.0), geodesy.enu_from_ecef(0.7, 0.1)
    r, h = np.array([np.nan, 1000.0, -5.0, 1000.0, 5000.0]), np.array([0.0, np.nan, 0.0, 3000.0, 3000.0])
    found = measure.position_from_height(r, np.zeros(5), h, site, rotation)
    assert np.isnan(found[:4]).all()
    assert np.isfinite(found[4]).all()


def test_sites_and_what_they_refuse() -> None:
    plots = _plots(3, sensor=np.array([0x0102, 0x0103, 0x0102]))
    both = Sensors((_radar(), _radar(name="S", sic=3, lat_deg=-10.0, height_m=None, height_msl_m=20.0, geoid_m=-5.0)))
    position, rotation = measure.sites(plots, both)
    lat, lon, height = geodesy.geodetic_from_ecef(position)
    assert np.allclose(np.degrees(lat), [41.3, -10, 41.3])
    assert np.allclose(height, [80, 15, 80])
    assert np.allclose(rotation, geodesy.enu_from_ecef(lat, lon), atol=1e-12)
    with pytest.raises(SettingsError, match=r"SAC/SIC 1/3.*sac = 1 and sic = 3"):
        measure.sites(plots, Sensors((_radar(),)))
    with pytest.raises(SettingsError, match="'R' has no position"):
        measure.sites(plots[:1], Sensors((_radar(lat_deg=None),)))


def test_a_missing_height_is_said_with_its_effect() -> None:
    """100 m of antenna height at 50 km and 10 km up is 100 tan E = 20.4 m of ground range."""
    plots = _plots(5, range_m=np.full(5, 50e3), azimuth_rad=np.zeros(5), pressure_altitude_m=np.full(5, 10e3))
    (text,) = measure.site_warnings(plots, Sensors((_radar(height_m=None),)))
    assert "'R' has no height_m" in text
    assert "20 m along the range" in text
    assert measure.site_warnings(plots, Sensors((_radar(),))) == ()
    sensors = Sensors((_radar(height_m=None),))
    low = measure.plot_positions(plots, sensors)
    high = measure.plot_positions(plots, Sensors((_radar(height_m=100.0),)))
    assert np.linalg.norm(low - high, axis=1) == pytest.approx(20.4, abs=1.0)


def test_ground_and_north_references_are_said() -> None:
    plots = _plots(3, range_m=np.full(3, 500.0), azimuth_rad=np.zeros(3))
    (text,) = measure.site_warnings(plots, Sensors((_radar(kind="surface"),)))
    assert "no ground_height_m" in text
    assert f"{500 - np.sqrt(500**2 - 30**2):.1f} m of range at 500 m" in text
    (text,) = measure.site_warnings(plots, Sensors((_radar(north="magnetic"),)))
    assert "magnetic north" in text


def test_north_offset_is_added_once() -> None:
    plots = _plots(2, range_m=np.full(2, 1e4), azimuth_rad=np.radians([359.5, 10.0]), elevation_rad=np.zeros(2))
    grid = Sensors((_radar(north="grid", north_offset_deg=1.5),))
    assert np.allclose(np.degrees(measure.true_azimuth(plots, grid)), [1.0, 11.5])
    position = measure.plot_positions(plots, grid)
    site, rotation = measure.sites(plots, grid)
    assert np.allclose(np.degrees(measure.polar_from_position(position, site, rotation)[:, 1]), [1.0, 11.5])


def test_what_decides_the_height_of_a_plot() -> None:
    r = np.full(6, 20e3)
    nan = np.nan
    plots = _plots(
        6,
        range_m=r,
        azimuth_rad=np.linspace(0, 5, 6),
        elevation_rad=np.array([0.1, nan, nan, nan, nan, 0.1]),
        height_m=np.array([1000.0, 2000.0, nan, nan, nan, nan]),
        pressure_altitude_m=np.array([nan, 500.0, 3000.0, nan, nan, nan]),
        flags=np.array([0, 0, 0, Flag.GROUND, 0, 0]),
    )
    sensors = Sensors((_radar(ground_height_m=45.0),))
    position = measure.plot_positions(plots, sensors, np.array([nan, nan, nan, nan, nan, 700.0]))
    height = geodesy.geodetic_from_ecef(position)[2]
    site, rotation = measure.sites(plots, sensors)
    assert measure.polar_from_position(position, site, rotation)[0, 2] == pytest.approx(0.1, abs=1e-12)
    assert height[[1, 2, 3, 5]] == pytest.approx([2000, 3000, 45, 700], abs=1e-6)
    assert np.isnan(position[4]).all()
    surface = measure.plot_positions(plots, Sensors((_radar(kind="surface"),)))
    assert geodesy.geodetic_from_ecef(surface)[2][4] == pytest.approx(80, abs=1e-6)
    with pytest.raises(InputError, match="height_m"):
        measure.plot_positions(plots, sensors, np.zeros(2))


def test_rates_that_are_not_asked_for_are_nan() -> None:
    rng = np.random.default_rng(3)
    enu, v, a = rng.normal(0, 1e4, (5, 3)), rng.normal(0, 100, (5, 3)), rng.normal(0, 5, (5, 3))
    whole = measure.polar_motion(enu, v, a)
    for order in range(3):
        some = measure.polar_motion(enu, v, a, order=order)
        for k in range(4):
            if k <= order:
                np.testing.assert_array_equal(some[k], whole[k])
            else:
                assert np.isnan(some[k]).all()


def test_a_heading_about_the_antenna_is_the_direction_in_which_the_target_moves_there() -> None:
    """A small step along the heading, from one geodetic position to the next, seen in the antenna's axes."""
    rng = np.random.default_rng(4)
    lat, lon = np.radians(rng.uniform(40, 50, 40)), np.radians(rng.uniform(8, 20, 40))
    height, heading = rng.uniform(0, 11e3, 40), rng.uniform(0, 2 * np.pi, 40)
    _, rotation = measure.site_of(Sensor(name="A", sac=1, sic=1, lat_deg=45.0, lon_deg=14.0, height_m=200.0))
    here = geodesy.ecef_from_geodetic(lat, lon, height)
    step = 1.0
    # Radii of curvature of the ellipsoid, as any textbook has them.
    w = 1 - geodesy.E2 * np.sin(lat) ** 2
    meridian, normal = 6378137.0 * (1 - geodesy.E2) / w**1.5, 6378137.0 / np.sqrt(w)
    there = geodesy.ecef_from_geodetic(
        lat + step * np.cos(heading) / (meridian + height),
        lon + step * np.sin(heading) / ((normal + height) * np.cos(lat)),
        height,
    )
    moved = (there - here) @ rotation.T
    seen = measure.heading_about(heading, here, rotation)
    np.testing.assert_allclose(measure.wrap_rad(seen - np.arctan2(moved[:, 0], moved[:, 1])), 0.0, atol=1e-6)
    # 90 km east at 45 degrees: the norths differ by 0.8 degrees, and the heading north leans to the west of the antenna's.
    east = geodesy.ecef_from_geodetic(np.radians(45.0), np.radians(14.0 + 90e3 / 111.4e3 / np.cos(np.pi / 4)), 0.0)[None]
    assert np.degrees(measure.wrap_rad(measure.heading_about(np.zeros(1), east, rotation)))[0] == pytest.approx(-0.81, abs=0.02)
    assert np.isnan(measure.heading_about(np.array([np.nan]), east, rotation))[0]
