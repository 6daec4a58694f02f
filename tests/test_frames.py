"""Covariance conversion: against Monte Carlo, closed forms, and itself round a loop of frames."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from boresight import frames, geodesy, measure


def _frames() -> dict[str, frames.Frame]:
    one, two = (0.72, 0.04, 80.0), (0.74, 0.01, 500.0)
    out: dict[str, frames.Frame] = {"ecef": frames.Ecef()}
    for name, (lat, lon, h) in (("1", one), ("2", two)):
        site, rotation = geodesy.ecef_from_geodetic(lat, lon, h), geodesy.enu_from_ecef(lat, lon)
        out["enu" + name], out["polar" + name] = frames.Enu(site, rotation), frames.Polar(site, rotation)
    return out


def _plots(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    value = np.stack([rng.uniform(5e3, 300e3, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0.01, 0.8, n)], axis=1)
    root = rng.normal(size=(n, 3, 3)) * np.array([30.0, 1e-4, 1e-4])[:, None]
    return value, root @ np.swapaxes(root, 1, 2)


FRAMES = _frames()


@pytest.mark.parametrize(("through", "last"), list(itertools.permutations(FRAMES, 2)))
def test_every_detour_ends_where_the_straight_way_does(through: str, last: str) -> None:
    """Polar of site 1 to any frame by way of any other: the same values and covariances, symmetric to the bit."""
    value, covariance = _plots(50, 1)
    start = FRAMES["polar1"]
    straight = frames.convert(value, covariance, start, FRAMES[last])
    half = frames.convert(value, covariance, start, FRAMES[through])
    detour = frames.convert(*half, FRAMES[through], FRAMES[last])
    assert np.array_equal(detour[1], np.swapaxes(detour[1], 1, 2))
    difference = detour[0] - straight[0]
    if last.startswith("polar"):
        difference[:, 1] = measure.wrap_rad(difference[:, 1])
        difference[:, 1:] *= straight[0][:, :1]
    assert np.abs(difference).max() < 1e-7
    sd = np.sqrt(np.diagonal(straight[1], axis1=1, axis2=2))
    assert np.abs((detour[1] - straight[1]) / (sd[:, :, None] * sd[:, None, :])).max() < 1e-6


def test_linear_conversion_against_monte_carlo() -> None:
    """Small angles: 400,000 draws agree with J R J' to the sampling error."""
    rng = np.random.default_rng(2)
    value = np.array([[80e3, 1.1, 0.12]])
    covariance = np.diag([40.0, 3e-4, 4e-4])[None] ** 2
    covariance[0, 0, 1] = covariance[0, 1, 0] = 0.5 * 40 * 3e-4
    source, target = FRAMES["polar1"], FRAMES["polar2"]
    found = frames.convert(value, covariance, source, target)
    draws = rng.multivariate_normal(value[0], covariance[0], 400_000)
    mapped = target.from_ecef(source.to_ecef(draws)[0])[0]
    sd = np.sqrt(np.diagonal(found[1][0]))
    assert np.abs((np.cov(mapped.T) - found[1][0]) / np.outer(sd, sd)).max() < 0.01
    assert np.abs((mapped.mean(0) - found[0][0]) / sd).max() < 0.01


def test_a_plot_due_east_has_its_errors_on_the_right_axes() -> None:
    """METHODS section 1: range error lies east, azimuth error north, elevation error up; mixed axes would not."""
    value, covariance = np.array([[50e3, np.pi / 2, 0.0]]), np.diag([10.0, 1e-3, 2e-3])[None] ** 2
    _, enu = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["enu1"])
    assert np.sqrt(np.diagonal(enu[0])) == pytest.approx([10, 50, 100], rel=1e-9)


def test_rotation_keeps_the_eigenvalues() -> None:
    value, covariance = _plots(20, 3)
    enu, covariance = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["enu1"])
    _, ecef = frames.convert(enu, covariance, FRAMES["enu1"], FRAMES["ecef"])
    assert np.allclose(np.linalg.eigvalsh(ecef), np.linalg.eigvalsh(covariance), rtol=1e-9)


def test_jacobian_of_the_route_against_differences() -> None:
    value, _ = _plots(30, 4)
    forward = frames.route(FRAMES["polar1"], FRAMES["polar2"])
    mapped, jacobian = forward(value)
    metres_in, metres_out = (np.stack([np.ones(30), v[:, 0], v[:, 0]], axis=1) for v in (value, mapped))
    for k in range(3):
        step = np.zeros_like(value)
        step[:, k] = 10.0 / metres_in[:, k]
        difference = forward(value + step)[0] - forward(value - step)[0]
        difference[:, 1] = measure.wrap_rad(difference[:, 1])
        expected = jacobian[:, :, k] * metres_out / metres_in[:, k : k + 1]
        assert np.abs(difference * metres_out / 20.0 - expected).max() < 1e-4


def test_a_method_is_a_value_that_sees_the_whole_route() -> None:
    """Another method needs nothing but the map: here, one that ignores the Jacobian and differences the map itself."""

    def differenced(value: np.ndarray, covariance: np.ndarray, forward: frames.Map) -> tuple[np.ndarray, np.ndarray]:
        columns = []
        for k, h in enumerate((1.0, 1e-6, 1e-6)):
            step = np.zeros(3)
            step[k] = h
            columns.append((forward(value + step)[0] - forward(value - step)[0]) / (2 * h))
        return forward(value)[0], frames.propagate(np.stack(columns, axis=2), covariance)

    value, covariance = _plots(10, 5)
    ours = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["ecef"])
    theirs = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["ecef"], method=differenced)
    assert np.allclose(ours[1], theirs[1], rtol=1e-5, atol=1e-5 * np.abs(ours[1]).max())
