"""Several radars in one filter, gates, pairs and merged plots: against one-shot filters, brute force and statistics."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from boresight.errors import SettingsError
from boresight.filters import ConstantVelocity, kalman_filter, one_point
from boresight.filters.serial import (
    CONVERSIONS,
    Elliptical,
    PolarPlots,
    Rectangular,
    compress,
    in_order,
    pair_plots,
    serial_filter,
    statistical_distance,
)
from boresight.frames import Ecef, Enu, Linear, Polar, convert
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef

DEG = np.pi / 180
FLAT = Polar(np.zeros(3), np.eye(3))


def _radar(n: int, seed: int, first_s: float, sd: tuple[float, float], radar: int, k: int = 2) -> PolarPlots:
    """Plots of one flat radar at the origin of a target that flies straight."""
    rng = np.random.default_rng(seed)
    time_s = first_s + np.arange(15) * 4.0
    position = np.array([4e4, 3e4]) + time_s[:, None] * [-120.0, 60.0]
    value = np.zeros((n, 15, k))
    value[..., 0] = np.hypot(*position.T) + rng.normal(size=(n, 15)) * sd[0]
    value[..., 1] = np.arctan2(*position.T) + rng.normal(size=(n, 15)) * sd[1]
    covariance = np.broadcast_to(np.diag([sd[0] ** 2, sd[1] ** 2, 1e-10][:k]), (15, k, k))
    return PolarPlots(value, covariance, time_s, np.full(15, radar))


def test_plots_of_several_radars_stand_in_order_of_time() -> None:
    one, two, three = (_radar(3, s, t, (50.0, 1e-3), s) for s, t in ((0, 0.0), (1, 1.5), (2, 1.5)))
    found = in_order(one, two, three)
    rows = sorted(((t, part, k) for part, p in enumerate((one, two, three)) for k, t in enumerate(p.time_s)), key=lambda r: r[0])
    assert found.time_s.tolist() == [r[0] for r in rows]
    assert found.radar.tolist() == [r[1] for r in rows]
    for k, (_, part, step) in enumerate(rows):
        assert np.array_equal(found.value[:, k], (one, two, three)[part].value[:, step])
        assert np.array_equal(found.covariance[k], (one, two, three)[part].covariance[step])


def test_linear_serial_filter_is_one_filter_over_converted_plots() -> None:
    plots = in_order(_radar(4, 1, 0.0, (50.0, 2e-3), 0), _radar(4, 2, 2.0, (150.0, 5e-3), 1))
    motion = ConstantVelocity(noise=0.5)
    found = serial_filter(plots, [FLAT, FLAT], motion, conversion="linear", speed_sd_mps=200.0)
    r, a = plots.value[..., 0], plots.value[..., 1]
    z = np.stack([r * np.sin(a), r * np.cos(a)], axis=-1)
    turn = np.stack([np.stack([np.sin(a), r * np.cos(a)], -1), np.stack([np.cos(a), -r * np.sin(a)], -1)], axis=-2)
    spread = turn @ plots.covariance @ np.swapaxes(turn, -1, -2)
    expected = kalman_filter(z, (spread + np.swapaxes(spread, -1, -2)) / 2, plots.time_s, motion,
                             one_point(z[:, 0], spread[:, 0], 4, 200.0))  # fmt: skip
    assert found.mean == pytest.approx(expected.mean, rel=1e-9, abs=1e-6)
    assert found.covariance == pytest.approx(expected.covariance, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("conversion", CONVERSIONS)
def test_all_conversions_agree_where_plots_are_accurate(conversion: str) -> None:
    """Three axes, two radars on the Earth, errors so small that no bend counts: every conversion is the linear one."""
    rng = np.random.default_rng(3)
    sites = [(50.0, 10.0), (50.4, 10.6)]
    radars = [
        Polar(ecef_from_geodetic(a * DEG, b * DEG, 100.0), enu_from_ecef(a * DEG, b * DEG)) for a, b in sites
    ]  # fmt: skip
    frame = Enu(radars[0].site, radars[0].rotation)
    time_s = np.arange(20) * 3.0
    truth = np.array([3e4, 1e4, 8e3]) + time_s[:, None] * [100.0, 150.0, 0.0]
    radar = np.arange(20) % 2
    ecef = frame.to_ecef(truth)[0]
    sd = np.array([20.0, 1e-4, 1e-4])
    value = np.stack([radars[j].from_ecef(ecef[k : k + 1])[0][0] for k, j in enumerate(radar)]) + rng.normal(size=(5, 20, 3)) * sd
    value[2, 7] = np.nan
    plots = PolarPlots(value, np.broadcast_to(np.diag(sd**2), (20, 3, 3)), time_s, radar)
    found = serial_filter(plots, radars, ConstantVelocity(), frame=frame, conversion=conversion)
    linear = serial_filter(plots, radars, ConstantVelocity(), frame=frame, conversion="linear")
    assert np.abs(found.mean - linear.mean)[..., :3].max() < 0.5
    assert np.abs(found.mean[:, -1, :3] - truth[-1]).max() < 60.0
    assert np.isnan(found.nis[2, 7])
    assert np.isfinite(found.mean).all()


def _sixty(conversion: str, range_m: float, angle: float, runs: int, seed: int) -> float:
    """NEES of position after 60 plots at 4 s (METHODS section 1), of a target that crosses the line of sight."""
    rng = np.random.default_rng(seed)
    sd = np.array([50.0, angle, angle])
    time_s = np.arange(60) * 4.0
    truth = FLAT.to_ecef(np.array([[range_m, 1.0, 0.1]]))[0] + time_s[:, None] * [-100.0, 150.0, 0.0]
    value = FLAT.from_ecef(truth)[0] + rng.normal(size=(runs, 60, 3)) * sd
    plots = PolarPlots(value, np.broadcast_to(np.diag(sd**2), (60, 3, 3)), time_s, np.zeros(60, np.int64))
    found = serial_filter(plots, [FLAT], ConstantVelocity(noise=1e-4), conversion=conversion)
    off = found.mean[:, -1, :3] - truth[-1]
    spread = found.covariance[:, -1, :3, :3]
    return float(np.einsum("ni,ni->n", off, np.linalg.solve(spread, off[:, :, None])[:, :, 0]).mean())


def test_decorrelated_plots_keep_a_filter_honest() -> None:
    """300 km, 2 degrees: at most 3.5 (3 is ideal) where the linear conversion is at hundreds."""
    assert _sixty("decorrelated", 300e3, 2 * DEG, 8000, 1) <= 3.5
    assert _sixty("linear", 300e3, 2 * DEG, 100, 1) > 100.0


def test_linear_plots_are_over_confident_before_they_bend_much() -> None:
    """At beta = 0.197 one plot is fine, 60 of them in a filter are not: 3.9."""
    angle = np.sqrt(0.197 * 2 * 50.0 / (100e3 * (1 + np.cos(0.1) ** 2)))
    assert _sixty("linear", 100e3, angle, 1500, 2) == pytest.approx(3.9, abs=0.35)
    assert _sixty("decorrelated", 100e3, angle, 600, 2) <= 3.3


def _pairs(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, 3, 3))
    spread = root @ np.swapaxes(root, 1, 2) * 1e4 + 100 * np.eye(3)
    return np.einsum("nij,nj->ni", np.linalg.cholesky(spread), rng.normal(size=(n, 3))), spread, rng.normal(size=(n, 3))


@pytest.mark.parametrize("share", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("k", [2, 3])
def test_the_ellipse_holds_its_share_of_own_plots(share: float, k: int) -> None:
    off, spread, _ = _pairs(40_000, 4)
    inside = Elliptical(share)(off[:, :k], spread[:, :k, :k])
    assert inside.mean() == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 40_000))


def test_distance_and_rectangle_by_hand() -> None:
    spread = np.array([[4.0, 0.0], [0.0, 9.0]])
    assert statistical_distance(np.array([2.0, 3.0]), spread) == pytest.approx(2.0)
    off = np.array([[10.0, -10.0], [10.1, 0.0], [0.0, -11.0]])
    assert Rectangular(10.0)(off, spread).tolist() == [True, False, False]


@pytest.mark.parametrize("seed", range(12))
def test_pairs_are_the_best_of_all_pairings(seed: int) -> None:
    """Of all one-to-one pairings within the gate: as many as can be, and of those the least sum of distances."""
    rng = np.random.default_rng(seed)
    n, m = (int(v) for v in rng.integers(1, 5, 2))
    one, two = rng.normal(size=(n, 2)) * 150, rng.normal(size=(m, 2)) * 150
    one_r, two_r = (np.broadcast_to(np.diag(sd), (len(a), 2, 2)) for sd, a in (([4e3, 2e3], one), ([1e3, 5e3], two)))
    gate = (Elliptical(0.8), Rectangular(120.0))[seed % 2]
    off = two[None] - one[:, None]
    spread = one_r[:, None] + two_r[None]
    within, distance = gate(off, spread), statistical_distance(off, spread)

    def cost(choice: tuple[int, ...]) -> tuple[int, float]:
        pairs = [(i, j) for i, j in enumerate(choice) if j >= 0]
        return -len(pairs), float(sum(distance[i, j] for i, j in pairs))

    allowed = [
        c
        for c in itertools.product(range(-1, m), repeat=n)
        if len({j for j in c if j >= 0}) == sum(j >= 0 for j in c) and all(j < 0 or within[i, j] for i, j in enumerate(c))
    ]
    best = min(allowed, key=cost)
    found = pair_plots(one, one_r, two, two_r, gate)
    assert cost(tuple(found.tolist())) == pytest.approx(cost(best))
    assert pair_plots(one[:0], one_r[:0], two, two_r, gate).shape == (0,)
    assert pair_plots(one, one_r, two[:0], two_r[:0], gate).tolist() == [-1] * n


def test_merged_plots_are_the_mean_weighted_by_inverse_covariances() -> None:
    one, one_r, _ = _pairs(50, 5)
    two, two_r, _ = _pairs(50, 6)
    mean, spread = compress(one, one_r, two, two_r)
    a, b = np.linalg.inv(one_r), np.linalg.inv(two_r)
    expected = np.linalg.inv(a + b)
    assert spread == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert mean == pytest.approx((expected @ (a @ one[:, :, None] + b @ two[:, :, None]))[:, :, 0], rel=1e-6, abs=1e-6)
    assert np.array_equal(spread, np.swapaxes(spread, 1, 2))


def test_what_makes_no_sense_is_refused() -> None:
    plots = _radar(2, 1, 0.0, (50.0, 2e-3), 0)
    motion = ConstantVelocity()
    for change, radars, options, match in (
        (plots, [FLAT], {"frame": FLAT}, "Cartesian"),
        (plots, [FLAT], {"conversion": "best"}, "no conversion 'best'"),
        (plots._replace(radar=plots.radar + 1), [FLAT], {}, "do not fit"),
        (plots._replace(covariance=plots.covariance[:-1]), [FLAT], {}, "do not fit"),
        (plots._replace(time_s=plots.time_s[::-1]), [FLAT], {}, "backwards"),
        (plots._replace(time_s=plots.time_s[::-1]), [FLAT], {"conversion": "linear"}, "backwards"),
        (plots._replace(covariance=-plots.covariance), [FLAT], {}, "variance"),
    ):
        with pytest.raises(SettingsError, match=match):
            serial_filter(change, radars, motion, **options)


def test_one_position_is_the_frames_conversion() -> None:
    plots = _radar(2, 7, 0.0, (50.0, 2e-3), 0)
    found = serial_filter(plots, [FLAT], ConstantVelocity(), conversion="linear")
    z, r = convert(plots.value[:, 0], np.broadcast_to(plots.covariance[0], (2, 2, 2)), FLAT, Ecef(), method=Linear())
    assert found.mean[:, 0, :2] == pytest.approx(z)
    assert found.covariance[:, 0, :2, :2] == pytest.approx(r)
