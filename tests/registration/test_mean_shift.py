"""Relative registration: exact differences, mean shift against closed forms and SciPy, and what differences cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from synthetic import DEG, EPOCH, path

from boresight import frames
from boresight.errors import NothingToDo, SettingsError
from boresight.measure import polar_from_position, site_of
from boresight.model import Plots, Sensor, Sensors
from boresight.registration.mean_shift import (
    ExponentialAverage,
    Igmsr,
    MeanShift,
    Online,
    absolute_condition,
    first_order_difference,
    polar_difference,
    relative_samples,
)
from boresight.registration.sequential import METHODS, KalmanBank

MAIN = Sensor(
    name="M", id=70001, lat_deg=46.0, lon_deg=14.0, height_m=300.0, range_sd_m=20.0, azimuth_sd_deg=0.05, elevation_sd_deg=0.05
)
NEAR = Sensor(
    name="N",
    id=70002,
    lat_deg=46.0003,
    lon_deg=14.0004,
    height_m=302.0,
    range_sd_m=20.0,
    azimuth_sd_deg=0.05,
    elevation_sd_deg=0.05,
)
FAR = Sensor(
    name="F", id=70003, lat_deg=46.9, lon_deg=15.2, height_m=500.0, range_sd_m=20.0, azimuth_sd_deg=0.05, elevation_sd_deg=0.05
)
THREE = Sensors((MAIN, NEAR, FAR))
BIAS = {
    MAIN.key: np.array([30.0, 0.1 * DEG, -0.05 * DEG]),
    NEAR.key: np.array([-90.0, 0.4 * DEG, 0.1 * DEG]),
    FAR.key: np.zeros(3),
}


def recording(
    sensors: tuple[Sensor, ...] = (MAIN, NEAR),
    *,
    targets: int = 6,
    duration_s: float = 600.0,
    noise: float = 1.0,
    seed: int = 1,
    together: bool = False,
) -> Plots:
    """Plots of aircraft by radars with the biases `BIAS`, at times of their own (or `together`)."""
    rng = np.random.default_rng(seed)
    parts = []
    for g in range(targets):
        where = path(46.0, 14.0, *rng.uniform(-60e3, 60e3, 2), rng.uniform(0, 6), 200.0, 0.0, 9e3, 0.0, duration_s / 2)
        for k, sensor in enumerate(sensors):
            t = np.arange(0.0 if together else 1.3 * k, duration_s, 4.0)
            polar = polar_from_position(where(t), *site_of(sensor)) + BIAS[sensor.key]
            sd = np.array([sensor.range_sd_m, sensor.azimuth_sd_deg * DEG, sensor.elevation_sd_deg * DEG])
            polar += noise * sd * rng.normal(size=polar.shape)
            parts.append(
                Plots(
                    time_s=EPOCH + t,
                    sensor=np.full(len(t), sensor.key),
                    range_m=polar[:, 0],
                    azimuth_rad=polar[:, 1] % (2 * np.pi),
                    elevation_rad=polar[:, 2],
                    mode_s=np.full(len(t), 0x400000 + g),
                    record=np.arange(len(t)),
                )
            )
    return Plots.concat(parts)


# ------------------------------------------------------------------------------------------------------------------- samples
def test_a_difference_of_radars_without_bias_is_nothing_wherever_they_stand() -> None:
    position = path(46.0, 14.0, 20e3, 30e3, 1.0, 200.0, 0.01, 9e3, 5.0, 0.0)(np.arange(50.0))
    stand = [frames.Polar(*site_of(s)) for s in (NEAR, FAR)]
    polar = [s.from_ecef(position)[0] for s in stand]
    none = np.zeros((50, 3, 3))
    difference, _, turn = polar_difference(polar[0], none, stand[0], polar[1], none, stand[1])
    assert np.abs(difference * [1, 1e5, 1e5]).max() < 1e-5
    # The Jacobian is that of the way there, by differences.
    step = np.array([1.0, 1e-5, 1e-5])
    for c in range(3):
        moved = [polar[1] + sign * step[c] * np.eye(3)[c] for sign in (1, -1)]
        ends = [polar_difference(polar[0], none, stand[0], m, none, stand[1])[0] for m in moved]
        np.testing.assert_allclose(
            (ends[1] - ends[0]) / (2 * step[c]), turn[:, :, c], rtol=1e-5, atol=1e-7 * np.abs(turn[:, :, c]).max()
        )


def test_the_first_order_difference_is_off_by_the_curvature() -> None:
    frame = frames.Polar(np.zeros(3), np.eye(3))
    main = np.array([[110e3, 0.7, 0.0]])
    seen = main + np.array([0.0, DEG, 0.0])
    exact = polar_difference(seen, np.zeros((1, 3, 3)), frame, main, np.zeros((1, 3, 3)), frame)[0]
    np.testing.assert_allclose(exact, [[0.0, DEG, 0.0]], atol=1e-9)
    assert first_order_difference(seen, frame, main, frame)[0, 0] == pytest.approx(110e3 * (1 - np.cos(DEG)), rel=1e-6)


def test_plots_of_two_radars_give_their_relative_bias() -> None:
    plots = recording(noise=1e-6)
    samples = relative_samples(plots, THREE, MAIN)[NEAR.key]
    assert len(samples) > 800
    assert (np.diff(samples.time_s) >= 0).all()
    # Biases of both at once: the main radar's moves its plots, which the polar frame of the other one sees slightly turned.
    off = np.median(samples.value, axis=0) - (BIAS[NEAR.key] - BIAS[MAIN.key])
    assert (np.abs(off) < [0.5, 2e-5, 2e-5]).all()
    together = relative_samples(recording(noise=1e-6, together=True), THREE, MAIN)[NEAR.key]
    assert (np.abs(together.value - (BIAS[NEAR.key] - BIAS[MAIN.key])).max(axis=0) < [0.3, 1e-4, 1e-4]).all()


def test_the_covariance_of_a_sample_is_true() -> None:
    samples = relative_samples(recording(targets=12, seed=5), THREE, MAIN)[NEAR.key]
    off = samples.value - (BIAS[NEAR.key] - BIAS[MAIN.key])
    honest = np.einsum("ni,nij,nj->n", off, np.linalg.inv(samples.covariance), off).mean() / 3
    # One interpolated plot has less noise than its weights here say; averages of many have what they say.
    assert 0.7 < honest < 1.1
    halves = [samples.take(samples.target == name) for name in np.unique(samples.target)]
    z = np.array(
        [
            (h.value - (BIAS[NEAR.key] - BIAS[MAIN.key])).mean(axis=0) * np.sqrt(len(h) / np.diag(h.covariance.mean(axis=0)))
            for h in halves
        ]
    )
    assert 0.4 < (z**2).mean() < 1.8


def test_what_cannot_be_compared_is_said() -> None:
    plots = recording()
    with pytest.raises(NothingToDo, match="one radar only"):
        relative_samples(plots[plots.sensor == MAIN.key], THREE, MAIN)
    with pytest.raises(NothingToDo, match="main radar 'M'"):
        relative_samples(plots[plots.sensor == NEAR.key], THREE, MAIN)
    late = plots.replace(time_s=plots.time_s + np.where(plots.sensor == NEAR.key, 1e5, 0.0))
    with pytest.raises(NothingToDo, match="no target in common within 15 s"):
        relative_samples(late, THREE, MAIN)
    with pytest.raises(NothingToDo, match=r"outside the window: the median is 12\d m"):
        relative_samples(recording(noise=0.01), THREE, MAIN, window=(50.0, DEG, DEG))
    with pytest.raises(SettingsError, match="positive"):
        relative_samples(plots, THREE, MAIN, gap_s=0.0)
    assert not len(Plots())
    with pytest.raises(NothingToDo):
        relative_samples(Plots(), THREE, MAIN)


def test_absolute_biases_are_not_observable_from_one_place() -> None:
    at_one = Sensors((MAIN, Sensor(name="N", id=NEAR.key, lat_deg=46.0, lon_deg=14.0, height_m=300.0)))
    plots = recording((MAIN, NEAR, FAR))
    same = relative_samples(plots[plots.sensor != FAR.key], at_one, MAIN)[NEAR.key]
    assert absolute_condition(same) > 1e12
    found = relative_samples(plots, THREE, MAIN, window=(50e3, 1.0, 1.0))
    assert absolute_condition(found[NEAR.key]) > 1e5
    assert absolute_condition(found[FAR.key]) < 1e3


# ------------------------------------------------------------------------------------------------------------------- methods
def series(seed: int, n: int = 200, m: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 100, n))
    r = rng.uniform(0.5, 2.0, (m, n))
    z = 3.0 + np.sqrt(r) * rng.normal(size=(m, n))
    z[:, ::9] += 12.0
    return t, z, r


def test_an_infinite_bandwidth_is_the_exponential_average() -> None:
    t, z, r = series(1)
    epochs = np.array([30.0, 77.0, 100.0])
    found = ExponentialAverage(tau_s=7.0)(t, z, r, epochs)
    for k, e in enumerate(epochs):
        seen = t <= e
        w = np.exp(-(t[seen].max() - t[seen]) / 7.0) / r[:, seen]
        w[:, t[seen] < t[seen].max() - 42.0] = 0.0
        np.testing.assert_allclose(found.value[:, k], (w * z[:, seen]).sum(axis=1) / w.sum(axis=1), rtol=1e-9)
        np.testing.assert_allclose(found.variance[:, k], (w**2 * r[:, seen]).sum(axis=1) / w.sum(axis=1) ** 2, rtol=1e-9)
    np.testing.assert_allclose(Igmsr(tau_s=7.0, bandwidth=1e7)(t, z, r, epochs).value, found.value, rtol=1e-6)


def test_igmsr_finds_the_highest_peak_of_the_weighted_density() -> None:
    t, z, r = series(2)
    method = Igmsr(tau_s=20.0, bandwidth=1.5)
    found = method(t, z, r, np.array([60.0, 100.0]))
    for k, e in enumerate((60.0, 100.0)):
        seen = t <= e
        for s in range(len(z)):
            w = np.exp(-(t[seen].max() - t[seen]) / 20.0)

            def density(x: float, w: np.ndarray = w, z: np.ndarray = z[s, seen], r: np.ndarray = r[s, seen]) -> float:
                return -float((w * np.exp(-0.5 * (z - x) ** 2 / (1.5**2 * r))).sum())

            start = min(np.linspace(-5, 25, 400), key=density)
            best = minimize_scalar(density, bounds=(start - 0.5, start + 0.5), method="bounded", options={"xatol": 1e-9}).x
            assert found.value[s, k] == pytest.approx(best, abs=1e-3)
    assert not found.missed.any()


def test_the_flat_kernel_ends_on_the_mean_of_what_lies_within() -> None:
    t, z, r = series(3)
    found = MeanShift(bandwidth=2.0)(t, z, r, np.array([100.0]))
    for s in range(len(z)):
        inside = (z[s] - found.value[s, 0]) ** 2 <= 4.0 * r[s]
        assert np.average(z[s, inside], weights=1 / r[s, inside]) == pytest.approx(found.value[s, 0], abs=1e-3)
        assert abs(found.value[s, 0] - 3.0) < 0.5


@pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
@given(shift=st.floats(-1e3, 1e3), size=st.floats(1e-3, 1e3), later=st.floats(-1e4, 1e4))
@settings(max_examples=15, deadline=None)
def test_units_and_origins_do_not_matter(method: Online, shift: float, size: float, later: float) -> None:
    t, z, r = series(4, 60)
    t = np.round(t, 3)
    epochs = np.array([20.0, 60.0, 100.0])
    plain = method(t, z, r, epochs)
    moved = method(t + round(later), shift + size * z, size**2 * r, epochs + round(later))
    np.testing.assert_allclose(moved.value, shift + size * plain.value, atol=2e-3 * size + 1e-9 * abs(shift), rtol=1e-9)
    np.testing.assert_allclose(moved.variance, size**2 * plain.variance, rtol=1e-2)


@pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
def test_samples_that_are_no_numbers_might_as_well_not_be_there(method: Online) -> None:
    t, z, r = series(5)
    holes = np.random.default_rng(0).random(len(t)) < 0.3
    holed = np.where(holes, np.nan, z[:1])
    np.testing.assert_allclose(
        method(t, holed, r[:1], np.array([50.0, 100.0])).value,
        method(t[~holes], z[:1, ~holes], r[:1, ~holes], np.array([50.0, 100.0])).value,
    )
    none = method(t, np.full_like(z, np.nan), r, np.array([50.0]))
    assert np.isnan(none.value).all()


@pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
def test_constant_series_equal_times_and_single_samples_have_defined_values(method: Online) -> None:
    t = np.arange(50.0)
    same = method(t, np.full((1, 50), 7.0), 1e-6, t)
    np.testing.assert_allclose(same.value, 7.0, atol=1e-9)
    assert np.isfinite(same.variance).all()
    assert (same.variance > 0).all()
    at_once = method(np.zeros(50), np.linspace(-1, 1, 50)[None], 1.0, np.zeros(1))
    assert abs(at_once.value[0, 0]) < 0.6
    one = method(np.zeros(1), np.array([[4.0]]), 1.0, np.array([0.0, 1e6]))
    np.testing.assert_allclose(one.value, 4.0)
    # Nothing gathers anywhere: still a number.
    spread = method(t, np.linspace(-1e6, 1e6, 50)[None], 1.0, t)
    assert np.isfinite(spread.value).all()
    # After a gap, and before any sample.
    gap = method(np.array([0.0, 1.0, 2.0]), np.ones((1, 3)), 1.0, np.array([-1.0, 2.0, 1e7]))
    assert np.isnan(gap.value[0, 0])
    np.testing.assert_allclose(gap.value[0, 1:], 1.0)


def test_an_outlier_at_the_beginning_is_left_again() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(400.0)
    z = rng.normal(size=(20, 400))
    z[:, 0] = 20.0
    assert (np.abs(Igmsr(multi_start=False, tau_s=1e6)(t, z, 1.0, t).value[:, -1]) > 10).all()
    for method in (Igmsr(tau_s=1e6), Igmsr(), KalmanBank()):
        assert (np.abs(method(t, z, 1.0, t).value[:, 10:]) < 2.0).mean() > 0.99


def test_the_variance_of_a_mean_shift_is_true_where_the_bias_stays() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(300.0)
    z = rng.normal(size=(400, 300)) * 2.0
    for method in (Igmsr(tau_s=30.0), Igmsr(tau_s=30.0, bandwidth=1.5), MeanShift(), ExponentialAverage(tau_s=30.0)):
        found = method(t, z, 4.0, np.array([299.0]))
        assert (found.value**2 / found.variance).mean() == pytest.approx(1.0, abs=0.25)


def test_settings_and_arrays_that_make_no_sense_are_refused() -> None:
    t = np.arange(3.0)
    for method, words in ((Igmsr(tau_s=0.0), "tau_s"), (MeanShift(bandwidth=-1.0), "bandwidth"), (KalmanBank(streak=1), "streak"),
                          (KalmanBank(huber=6.0), "huber"), (KalmanBank(memory_s=(20.0, 10.0)), "memory_s")):  # fmt: skip
        with pytest.raises(SettingsError, match=words):
            method(t, np.zeros((1, 3)), 1.0, t)
    for method in METHODS.values():
        with pytest.raises(SettingsError, match="do not fit"):
            method(t, np.zeros((1, 4)), 1.0, t)
        with pytest.raises(SettingsError, match="in order"):
            method(t[::-1], np.zeros((1, 3)), 1.0, t)
        with pytest.raises(SettingsError, match="positive"):
            method(t, np.zeros((1, 3)), 0.0, t)
