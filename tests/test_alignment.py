"""Alignment against simulated truth: positions, velocities, covariances, gaps, clocks, heights, targets."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight import alignment, geodesy, measure
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.heights import height_profile
from boresight.model import Channel, Fixes, Flag, Plots, Sensor, Sensors, Source
from boresight.targets import targets_of

LAT, LON = np.radians(41.3), np.radians(2.1)
ORIGIN, ROTATION = geodesy.ecef_from_geodetic(LAT, LON, 0.0), geodesy.enu_from_ecef(LAT, LON)
EPOCH = 1.7e9


@dataclass(frozen=True)
class Way:
    """Pieces of constant acceleration along and across the velocity: straight, turning, speeding up; integrated at 20 Hz."""

    time: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    height: float

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        enu = np.stack([*(np.interp(t, self.time, c) for c in self.place.T), np.full(len(t), self.height)], axis=1)
        v = np.stack([*(np.interp(t, self.time, c) for c in self.velocity.T), np.zeros(len(t))], axis=1)
        return ORIGIN + enu @ ROTATION, v @ ROTATION


def _way(rng: np.random.Generator, duration: float, *, ground: bool) -> Way:
    """A taxiing aircraft (8 m/s, turns of 90 deg in 13 s, 0.4 m/s^2) or an airliner (130 m/s, 2 deg/s, 0.3 m/s^2)."""
    speed, turn, pull, lowest, height = (8.0, 0.12, 0.4, 3.0, 50.0) if ground else (130.0, 0.035, 0.3, 80.0, 3000.0)
    dt = 0.05
    time = np.arange(-30, duration + 30, dt)
    omega, accelerate = np.zeros_like(time), np.zeros_like(time)
    start = time[0]
    while start < time[-1]:
        length = rng.uniform(10, 40) if ground else rng.uniform(20, 80)
        piece = (time >= start) & (time < start + length)
        choice = rng.integers(4)
        if choice == 1:
            omega[piece] = turn * rng.choice([-1, 1]) * rng.uniform(0.5, 1)
        elif choice == 2:
            accelerate[piece] = pull * rng.choice([-1, 1])
        start += length
    ease = np.ones(20) / 20
    v = np.maximum(speed + np.cumsum(np.convolve(accelerate, ease, "same")) * dt, lowest)
    course = rng.uniform(0, 2 * np.pi) + np.cumsum(np.convolve(omega, ease, "same")) * dt
    velocity = np.stack([v * np.sin(course), v * np.cos(course)], axis=1)
    return Way(EPOCH + time, rng.uniform(-2e3, 2e3, 2) + np.cumsum(velocity, axis=0) * dt, velocity, height)


def _fixes(position: np.ndarray, time: np.ndarray, target: np.ndarray, sd: float, **columns: object) -> Fixes:
    lat, lon, height = geodesy.geodetic_from_ecef(position)
    n = len(time)
    given = {
        "time_s": time, "source": np.full(n, 5), "mode_s": target + 1,
        "latitude_rad": lat, "longitude_rad": lon, "height_m": height,
        "horizontal_sd_m": np.full(n, sd), "vertical_sd_m": np.full(n, sd),
    }  # fmt: skip
    return Fixes(**(given | columns))


def _traffic(
    seed: int,
    *,
    ground: bool,
    update: float,
    sd: float,
    targets: int = 12,
    duration: float = 600.0,
    velocity_sd: float | None = None,
) -> tuple[Fixes, list[Way]]:
    rng = np.random.default_rng(seed)
    ways = [_way(rng, duration, ground=ground) for _ in range(targets)]
    time = [EPOCH + np.arange(0, duration, update) + rng.uniform(-0.05, 0.05) * update for _ in ways]
    true = [way.at(t) for way, t in zip(ways, time, strict=True)]
    position = np.concatenate([p for p, _ in true])
    position = position + rng.normal(0, sd, position.shape)
    columns: dict[str, object] = {}
    if velocity_sd is not None:
        local = np.concatenate([v for _, v in true]) @ ROTATION.T + rng.normal(0, velocity_sd, position.shape)
        columns = {"velocity_east_mps": local[:, 0], "velocity_north_mps": local[:, 1]}
    fixes = _fixes(position, np.concatenate(time), np.repeat(np.arange(targets), [len(t) for t in time]), sd, **columns)
    return fixes.take(rng.permutation(len(fixes))), ways


def _errors(fixes: Fixes, ways: list[Way], method: str, seed: int = 9) -> tuple[np.ndarray, np.ndarray, alignment.States]:
    """Position and velocity errors (m, 3) at random times, and the states themselves."""
    rng = np.random.default_rng(seed)
    target = rng.integers(0, len(ways), 6000)
    last = fixes.time_s.max() - EPOCH
    time = EPOCH + rng.uniform(12, last - 12, 6000)
    states = alignment.states(alignment.trajectories(fixes, method=method), target, time)
    assert states.valid.all()
    position, velocity = np.empty((6000, 3)), np.empty((6000, 3))
    for k, way in enumerate(ways):
        position[target == k], velocity[target == k] = way.at(time[target == k])
    return states.position - position, states.velocity - velocity, states


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


# ------------------------------------------------------------------------------------------------------ states: accuracy


def test_velocity_on_the_surface_is_well_below_a_metre_per_second() -> None:
    """3 m of noise at 1 Hz: a derivative of the interpolation would be 4 m/s off; the fit is not, straight or turning."""
    fixes, ways = _traffic(1, ground=True, update=1.0, sd=3.0)
    position, velocity, _ = _errors(fixes, ways, "smooth")
    assert _rms(velocity) < 0.65
    assert np.median(np.linalg.norm(velocity, axis=1)) < 0.3
    linear, _, _ = _errors(fixes, ways, "linear")
    cubic, same_velocity, _ = _errors(fixes, ways, "cubic")
    assert _rms(position) < 0.5 * min(_rms(linear), _rms(cubic))
    assert np.array_equal(same_velocity, velocity)


@pytest.mark.parametrize(
    ("ground", "update", "sd", "speed_error"),
    [(True, 1.0, 1.0, 0.35), (False, 1.0, 10.0, 1.4), (False, 4.0, 10.0, 2.1), (False, 5.0, 5.0, 1.4)],
)
def test_smooth_is_the_best_of_the_methods(ground: bool, update: float, sd: float, speed_error: float) -> None:
    fixes, ways = _traffic(2, ground=ground, update=update, sd=sd)
    rms = {method: _rms(_errors(fixes, ways, method)[0]) for method in alignment.METHODS}
    assert rms["smooth"] <= min(rms.values()) * 1.0001
    assert rms["linear"] < rms["nearest"]
    assert _rms(_errors(fixes, ways, "smooth")[1]) < speed_error


def test_cubic_beats_linear_where_fixes_are_sparse_and_good() -> None:
    fixes, ways = _traffic(3, ground=False, update=8.0, sd=1.0)
    assert _rms(_errors(fixes, ways, "cubic")[0]) < 0.5 * _rms(_errors(fixes, ways, "linear")[0])


@pytest.mark.parametrize("method", ["nearest", "linear", "cubic", "smooth"])
@pytest.mark.parametrize(("ground", "update", "sd"), [(True, 1.0, 3.0), (False, 1.0, 10.0), (False, 5.0, 5.0)])
def test_the_covariance_is_honest(method: str, ground: bool, update: float, sd: float) -> None:
    """NEES per dimension of the interpolated position within 0.7 and 1.5 for white noise."""
    fixes, ways = _traffic(4, ground=ground, update=update, sd=sd)
    error, _, states = _errors(fixes, ways, method)
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(states.covariance, error[:, :, None])[:, :, 0]) / 3
    assert 0.7 < nees.mean() < 1.5
    assert np.array_equal(states.covariance, np.swapaxes(states.covariance, 1, 2))
    assert (np.linalg.eigvalsh(states.covariance) > 0).all()


def test_the_covariance_keeps_what_fixes_share() -> None:
    """A fix that says 15 m but jitters by 1 m has an error that its neighbours share: smoothing must not promise it away."""
    fixes, ways = _traffic(5, ground=True, update=1.0, sd=1.0)
    fixes = fixes.replace(horizontal_sd_m=np.full(len(fixes), 15.0), vertical_sd_m=np.full(len(fixes), 30.0))
    _, _, states = _errors(fixes, ways, "smooth")
    local = np.einsum("ij,njk,lk->nil", ROTATION, states.covariance, ROTATION)
    assert np.sqrt(np.median(local[:, 0, 0])) == pytest.approx(15, rel=0.02)
    assert np.sqrt(np.median(local[:, 2, 2])) == pytest.approx(30, rel=0.02)


def test_an_uncertain_stamp_widens_the_covariance_along_the_track() -> None:
    fixes, ways = _traffic(6, ground=False, update=1.0, sd=5.0, targets=3)
    fixes = fixes.replace(time_sd_s=np.full(len(fixes), 0.5))
    _, _, states = _errors(fixes, ways, "cubic")
    along = states.velocity / np.linalg.norm(states.velocity, axis=1)[:, None]
    sd = np.sqrt(np.einsum("ni,nij,nj->n", along, states.covariance, along))
    assert sd == pytest.approx(0.5 * np.linalg.norm(states.velocity, axis=1), rel=0.05)


def test_good_reported_velocities_help_and_bad_ones_do_not_harm() -> None:
    plain, ways = _traffic(7, ground=True, update=1.0, sd=3.0)
    good, same = _traffic(7, ground=True, update=1.0, sd=3.0, velocity_sd=0.5)
    without, with_ = _rms(_errors(plain, ways, "smooth")[1]), _rms(_errors(good, same, "smooth")[1])
    assert with_ < 0.9 * without
    rng = np.random.default_rng(1)
    wrong = plain.replace(velocity_east_mps=rng.normal(0, 30, len(plain)), velocity_north_mps=rng.normal(0, 30, len(plain)))
    assert _rms(_errors(wrong, ways, "smooth")[1]) < 1.05 * without


def test_acceleration_in_a_long_turn() -> None:
    """Towards the centre with v^2 / r = v omega: 130 m/s at 2 deg/s is 4.5 m/s^2."""
    time = np.arange(0, 120, 1.0)
    omega, speed = np.radians(2.0), 130.0
    enu = speed / omega * np.stack([np.sin(omega * time), 1 - np.cos(omega * time), np.zeros(120)], axis=1)
    position = ORIGIN + enu @ ROTATION + np.random.default_rng(2).normal(0, 2, enu.shape)
    trajectories = alignment.trajectories(_fixes(position, EPOCH + time, np.zeros(120, int), 2.0))
    t = np.arange(20, 100, 0.7)
    states = alignment.states(trajectories, np.zeros(len(t), int), EPOCH + t)
    true = -speed * omega * np.stack([np.sin(omega * t), -np.cos(omega * t), 0 * t], axis=1) @ ROTATION
    assert _rms(states.acceleration - true) < 0.6
    assert np.median(np.linalg.norm(states.acceleration, axis=1)) == pytest.approx(speed * omega, rel=0.05)


# --------------------------------------------------------------------------------------------- kernels: plain expressions


@pytest.mark.parametrize("with_velocity", [False, True])
def test_the_fit_is_weighted_least_squares(with_velocity: bool) -> None:
    """One window of +-3 s: NumPy's least squares over the same rows gives the same coefficients and covariance."""
    rng = np.random.default_rng(11)
    n = 40
    time = np.sort(rng.uniform(0, 30, n))
    position, weight = rng.normal(0, 5, (n, 3)) + 6e6, rng.uniform(0.1, 2, n)
    velocity, speed_weight = rng.normal(0, 5, (n, 3)), rng.uniform(0.5, 3, n) * with_velocity
    scale = np.full(n, 0.7)
    found = alignment._fit(
        np.arange(n), time, position, weight, velocity, speed_weight, np.tile([0.0, 0, 1], (n, 1)), np.zeros(n, np.int64),
        np.full(n, n, np.int64), scale, np.array([3.0]), np.array([5], np.int64), 10.0, 240,
    )  # fmt: skip
    for i in range(n):
        t = time - time[i]
        rows = np.flatnonzero(np.abs(t) <= 3.0)
        if len(rows) < 5:
            low = high = i
            while high - low < 4:
                back = t[i] - t[low - 1] if low > 0 else np.inf
                ahead = t[high + 1] if high + 1 < n else np.inf
                low, high = (low - 1, high) if back <= ahead else (low, high + 1)
            rows = np.arange(low, high + 1)
        x = t[rows]
        design = np.stack([np.ones_like(x), x, x * x / 2], axis=1) * np.sqrt(weight[rows])[:, None]
        right = (position[rows] - position[i]) * np.sqrt(weight[rows])[:, None]
        slope = np.stack([0 * x, np.ones_like(x), x], axis=1) * np.sqrt(speed_weight[rows])[:, None]
        prior = np.array([[0.0, 0.0, np.sqrt(scale[i] / alignment._PULL2)]])
        design = np.concatenate([design, slope, prior])
        right = np.concatenate([right, velocity[rows] * np.sqrt(speed_weight[rows])[:, None], np.zeros((1, 3))])
        expected = np.linalg.lstsq(design, right, rcond=None)[0]
        covariance = np.linalg.inv(design.T @ design)
        assert np.allclose(found[0][i] - position[i], expected[0], atol=1e-6)
        assert np.allclose(found[1][i], expected[1], rtol=1e-7, atol=1e-7)
        assert np.allclose(found[2][i], expected[2], rtol=1e-7, atol=1e-7)
        assert [found[4][i], found[3][i]] == pytest.approx(np.diagonal(covariance)[:2], rel=1e-8)


@pytest.mark.parametrize("method", ["linear", "cubic"])
def test_interpolation_is_scipy_s(method: str) -> None:
    scipy = pytest.importorskip("scipy.interpolate")
    fixes, _ = _traffic(12, ground=False, update=4.0, sd=10.0, targets=1)
    trajectories = alignment.trajectories(fixes, method=method)
    t = np.random.default_rng(1).uniform(5, 590, 300)
    found = alignment.states(trajectories, np.zeros(300, int), EPOCH + t)
    knot = trajectories.time_s - EPOCH
    if method == "cubic":
        expected = scipy.CubicHermiteSpline(knot, trajectories.position, trajectories.velocity)(t)
    else:
        expected = scipy.make_interp_spline(knot, trajectories.position, k=1)(t)
    assert np.abs(found.position - expected).max() < 1e-4


# -------------------------------------------------------------------------------------------------- states: what is valid


def _straight(time: np.ndarray, **columns: object) -> Fixes:
    enu = np.stack([20.0 * time, 10.0 * time, np.full(len(time), 100.0)], axis=1)
    return _fixes(ORIGIN + enu @ ROTATION, EPOCH + time, np.zeros(len(time), int), 5.0, **columns)


@pytest.mark.parametrize("method", ["linear", "cubic", "smooth"])
def test_an_exact_straight_line_is_found_exactly(method: str) -> None:
    trajectories = alignment.trajectories(_straight(np.arange(0.0, 60, 1)), method=method)
    t = np.linspace(-0.4, 59.4, 500)
    states = alignment.states(trajectories, np.zeros(500, int), EPOCH + t)
    true = ORIGIN + np.stack([20 * t, 10 * t, np.full(500, 100.0)], axis=1) @ ROTATION
    assert states.valid.all()
    # The stamps themselves are only known to 0.12 us (1.7e9 s in a double): 5 um at 22 m/s.
    assert np.abs(states.position - true).max() < 2e-5
    assert np.abs(states.velocity - np.array([20, 10, 0]) @ ROTATION).max() < 1e-5
    assert np.degrees(states.heading_rad) == pytest.approx(np.degrees(np.arctan2(2, 1)), abs=0.02)


def test_never_across_a_gap_and_never_beyond_half_an_update() -> None:
    time = np.r_[np.arange(0.0, 30, 1), np.arange(60.0, 90, 1)]
    trajectories = alignment.trajectories(_straight(time))
    ask = np.array([-0.6, -0.4, 10.5, 29.4, 29.6, 45.0, 59.4, 59.6, 70.2, 89.4, 89.6, np.nan])
    states = alignment.states(trajectories, np.zeros(len(ask), int), EPOCH + ask)
    assert states.valid.tolist() == [False, True, True, True, False, False, False, True, True, True, False, False]
    assert np.isnan(states.position[~states.valid]).all()
    assert np.isnan(states.covariance[~states.valid]).all()
    wide = alignment.trajectories(_straight(time), max_gap_s=40.0)
    assert alignment.states(wide, np.zeros(1, int), EPOCH + np.array([45.0])).valid.all()


def test_the_gap_limit_follows_the_update_rate() -> None:
    for update, limit in ((0.5, 3.0), (1.0, 4.0), (4.0, 16.0), (10.0, 20.0)):
        assert alignment.trajectories(_straight(np.arange(0, 200, update))).max_gap_s == pytest.approx([limit])
    for update, limit in ((2.0, 8.0), (10.0, 40.0), (30.0, 120.0), (180.0, 120.0)):
        fixes = _straight(np.arange(0, 900, update))
        ship = fixes.replace(mmsi=np.full(len(fixes), 224000001), mode_s=np.full(len(fixes), -1))
        assert alignment.trajectories(ship).max_gap_s == pytest.approx([limit])


def test_unknown_targets_and_lone_fixes_are_invalid_not_errors() -> None:
    trajectories = alignment.trajectories(_straight(np.array([0.0])))
    states = alignment.states(trajectories, np.array([0, -1, 7]), np.full(3, EPOCH))
    assert not states.valid.any()
    empty = alignment.states(alignment.trajectories(Fixes()), np.array([0]), np.array([EPOCH]))
    assert not empty.valid.any()
    assert empty.covariance.shape == (1, 3, 3)
    with pytest.raises(InputError, match="one row each"):
        alignment.states(trajectories, np.zeros(2, int), np.zeros(3))


def test_settings_that_make_no_sense_are_refused() -> None:
    fixes = _straight(np.arange(5.0))
    with pytest.raises(SettingsError, match="nearest, linear, cubic, smooth"):
        alignment.trajectories(fixes, method="quintic")
    with pytest.raises(SettingsError, match="positive"):
        alignment.trajectories(fixes, max_gap_s=0.0)
    with pytest.raises(InputError, match="Cartesian"):
        alignment.trajectories(Fixes(time_s=[0.0], x_m=[1.0], y_m=[2.0], mode_s=[7]))


def test_order_duplicates_and_nan_do_not_change_the_answer() -> None:
    fixes = _straight(np.arange(0.0, 60, 1))
    t = EPOCH + np.linspace(1, 58, 100)
    expected = alignment.states(alignment.trajectories(fixes), np.zeros(100, int), t)
    broken = fixes[:3].replace(latitude_rad=[np.nan, 0.7, 0.7], height_m=[1.0, np.nan, 1.0], time_s=[EPOCH, EPOCH, np.nan])
    messy = Fixes.concat([fixes, fixes[10:30], broken]).take(np.random.default_rng(3).permutation(83))
    trajectories = alignment.trajectories(messy)
    assert (trajectories.unusable, trajectories.duplicates) == (3, 20)
    assert "3 of 83" in trajectories.warnings[0]
    states = alignment.states(trajectories, np.zeros(100, int), t)
    assert np.abs(states.position - expected.position).max() < 1e-5
    again = alignment.states(alignment.trajectories(messy), np.zeros(100, int), t)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(again, states, strict=True))


def test_equal_stamps_that_disagree_are_averaged_or_the_better_one_kept() -> None:
    fixes = _straight(np.arange(0.0, 20, 1))
    near, far = fixes[5:6].replace(height_m=fixes.height_m[5:6] + 8), fixes[9:10].replace(height_m=fixes.height_m[9:10] + 500)
    far = far.replace(horizontal_sd_m=[50.0])
    trajectories = alignment.trajectories(Fixes.concat([far, near, fixes]), method="linear")
    found = alignment.states(trajectories, np.zeros(2, int), EPOCH + np.array([5.0, 9.0])).position
    up = geodesy.geodetic_from_ecef(found)[2] - fixes.height_m[[5, 9]]
    assert up[0] == pytest.approx(4, abs=0.01)
    # Within five of its own sd (50 m) of a 5 m fix it would be averaged; 500 m is not.
    assert abs(up[1]) < 0.01


def test_impossible_jumps_are_dropped_and_counted() -> None:
    """Single jumps, a run of them, and one in the first fix; the rest of the target is untouched."""
    fixes = _straight(np.arange(0.0, 100, 1))
    lat = fixes.latitude_rad.copy()
    wrong = np.array([0, 30, 31, 32, 70])
    lat[wrong] += 0.01
    trajectories = alignment.trajectories(fixes.replace(latitude_rad=lat))
    assert trajectories.jumps == 5
    assert set(range(100)) - set(trajectories.row.tolist()) == set(wrong.tolist())
    assert "5 of 100" in trajectories.warnings[0]
    assert alignment.trajectories(fixes).jumps == 0


def test_a_lone_spike_that_is_no_impossible_jump_is_dropped_too() -> None:
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 200, 1)
    enu = np.stack([20.0 * time, 10.0 * time, np.zeros(200)], axis=1) + rng.normal(0, 2, (200, 3))
    enu[77, 1] += 120
    trajectories = alignment.trajectories(_fixes(ORIGIN + enu @ ROTATION, EPOCH + time, np.zeros(200, int), 5.0))
    assert (trajectories.jumps, trajectories.spikes) == (0, 1)
    assert 77 not in trajectories.row


def test_heading_and_length() -> None:
    time = np.arange(0.0, 20, 1)
    heading = np.radians(np.where(time % 2 == 0, 350.0, 10.0))
    carried = alignment.trajectories(_straight(time, heading_rad=heading, length_m=np.r_[37.0, np.full(19, 38.0)]))
    states = alignment.states(carried, np.zeros(2, int), EPOCH + np.array([4.5, 4.0]))
    # Half way between 350 and 10 deg is north, not south.
    assert abs(measure.wrap_rad(states.heading_rad[0])) < 1e-6
    assert np.degrees(states.heading_rad[1]) == pytest.approx(350)
    assert states.length_m.tolist() == [38.0, 38.0]
    slow = _fixes(ORIGIN + np.stack([0.5 * time, 0 * time, 0 * time], axis=1) @ ROTATION, EPOCH + time, np.zeros(20, int), 1.0)
    states = alignment.states(alignment.trajectories(slow), np.zeros(1, int), EPOCH + np.array([4.0]))
    assert np.isnan(states.heading_rad).all()
    assert np.isnan(states.length_m).all()


def test_of_two_sources_the_better_one_answers() -> None:
    """Two sources that disagree by 30 m do not make a zigzag: the more accurate answers while it is there."""
    time = np.arange(0.0, 60, 1)
    good, poor = _straight(time[:40]), _straight(time + 0.5, source=np.full(60, 6), horizontal_sd_m=np.full(60, 40.0))
    poor = poor.replace(height_m=poor.height_m + 30)
    trajectories = alignment.trajectories(Fixes.concat([poor, good]))
    assert trajectories.targets == 1
    states = alignment.states(trajectories, np.zeros(2, int), EPOCH + np.array([20.2, 55.2]))
    height = geodesy.geodetic_from_ecef(states.position)[2]
    assert height - 100 == pytest.approx([0, 30], abs=0.5)


# --------------------------------------------------------------------------------------------------------------- targets


def _named(**columns: object) -> Fixes:
    n = max(len(v) for v in columns.values())
    return Fixes(**({"time_s": np.zeros(n), "source": np.full(n, 5)} | columns))


def test_targets_by_address_mmsi_callsign_track() -> None:
    fixes = _named(
        mode_s=[10, 10, -1, -1, -1, -1, -1, -1, 0], mmsi=[-1, -1, 9, 9, -1, -1, -1, -1, -1],
        callsign=[-1, -1, -1, -1, 77, 77, -1, -1, -1],
        track=[-1, -1, -1, -1, -1, -1, 3, 3, -1], source=[5, 6, 5, 6, 5, 6, 5, 6, 5],
    )  # fmt: skip
    target = targets_of(fixes)
    assert target.tolist() == [0, 0, 1, 1, 2, 2, 3, 4, -1]


def test_a_record_without_address_takes_that_of_its_track_or_callsign() -> None:
    fixes = _named(
        time_s=[0.0, 10, 20, 500, 30, 40], mode_s=[10, -1, -1, -1, -1, 11],
        track=[1, 1, 1, 1, -1, -1], callsign=[-1, -1, -1, -1, 77, 77],
        source=[5, 5, 5, 5, 6, 7],
    )  # fmt: skip
    target = targets_of(fixes)
    assert target[1] == target[2] == target[0]
    assert target[3] != target[0]
    assert target[4] == target[5] != target[0]


def test_a_track_number_used_again_after_a_pause_is_another_target() -> None:
    fixes = _named(time_s=[0.0, 100, 200, 600, 700], track=[4, 4, 4, 4, 4])
    assert targets_of(fixes).tolist() == [0, 0, 0, 1, 1]


@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.integers(-1, 3), st.integers(-1, 2), st.integers(0, 900), st.integers(5, 6)), min_size=1, max_size=30),
    st.randoms(),
)
def test_targets_do_not_depend_on_the_order(rows: list[tuple[int, int, int, int]], random: object) -> None:
    mode_s, track, time, source = (np.array(c) for c in zip(*rows, strict=True))
    # Equal stamps of one track have no order of their own.
    fixes = _named(mode_s=mode_s, track=track, time_s=time + np.arange(len(rows)) * 1e-3, source=source)
    order = list(range(len(rows)))
    random.shuffle(order)
    assert np.array_equal(targets_of(fixes.take(np.array(order))), targets_of(fixes)[order])


# ---------------------------------------------------------------------------------------------------------------- locate


def _sensor(**kwargs: object) -> Sensor:
    return Sensor(
        **({"name": "M", "sac": 0, "sic": 5, "kind": "mlat", "lat_deg": 41.3, "lon_deg": 2.1, "height_m": 50.0} | kwargs)
    )


def _cartesian(n: int = 40, **columns: object) -> Fixes:
    rng = np.random.default_rng(8)
    given = {
        "time_s": EPOCH + np.arange(n),
        "source": np.full(n, 5),
        "mode_s": np.full(n, 3),
        "x_m": rng.uniform(-9e4, 9e4, n),
        "y_m": rng.uniform(-9e4, 9e4, n),
    }
    return Fixes(**(given | columns))


def test_cartesian_positions_become_geodetic_on_the_ellipsoid() -> None:
    """ENU about the reference point, at the target's own height: x and y come back to 1 um, 100 km away and 9 km up."""
    fixes = _cartesian(height_m=np.full(40, 9000.0), vertical_sd_m=np.full(40, 4.0), horizontal_sd_m=np.full(40, 4.0))
    located, said = alignment.locate(fixes, Sensors((_sensor(),)))
    assert said == ()
    position = geodesy.ecef_from_geodetic(located.latitude_rad, located.longitude_rad, located.height_m)
    enu = geodesy.local_enu(position, LAT, LON, 50.0)
    assert np.abs(enu[:, :2] - np.stack([fixes.x_m, fixes.y_m], axis=1)).max() < 1e-6
    assert (located.height_m == 9000).all()
    assert (located.horizontal_sd_m == 4).all()


def test_the_reference_point_may_come_from_the_stream_or_is_asked_for() -> None:
    fixes = _cartesian(height_m=np.full(40, 9000.0))
    nothing = dict(sac=0, sic=5, category=20, edition="1.9", records=1, plots=0, start_s=0.0, end_s=1.0, targets=1)
    told = Source(**nothing, latitude_rad=float(LAT), longitude_rad=float(LON), height_m=50.0)
    own, _ = alignment.locate(fixes, Sensors((_sensor(),)))
    other, _ = alignment.locate(fixes, Sensors(()), (Source(**nothing), told))
    assert np.allclose(own.latitude_rad, other.latitude_rad, atol=1e-15)
    with pytest.raises(SettingsError, match=r"SAC/SIC 0/5.*sac = 0, sic = 5"):
        alignment.locate(fixes, Sensors(()))


def test_ground_targets_stand_at_the_ground_height_that_is_known_best() -> None:
    fixes = _cartesian(flags=np.full(40, Flag.GROUND), pressure_altitude_m=np.full(40, 300.0))
    radar = Sensor(name="SMR", sac=0, sic=7, lat_deg=41.3, lon_deg=2.1, height_m=85.0, kind="surface")
    cases = (
        ((_sensor(ground_height_m=52.0),), 52, "ground_height_m of 'M'"),
        ((_sensor(), Sensor(name="S", sac=0, sic=7, kind="surface", ground_height_m=53.0)), 53, "ground_height_m of 'S'"),
        ((_sensor(), radar), 50, "height of its reference point"),
        ((_sensor(height_m=None), radar), 85, "antenna of 'SMR'"),
    )
    for sensors, height, why in cases:
        located, said = alignment.locate(fixes, Sensors(sensors))
        assert (located.height_m == height).all()
        assert any(why in text for text in said)
    located, said = alignment.locate(fixes, Sensors((_sensor(height_m=None),)))
    assert np.isnan(located.height_m).all()
    assert any("give ground_height_m" in text for text in said)


def test_targets_without_altitude_are_on_the_ground_only_at_a_surface_site() -> None:
    fixes = _cartesian()
    surface = Sensor(name="SMR", sac=0, sic=7, kind="surface", ground_height_m=51.0)
    assert (alignment.locate(fixes, Sensors((_sensor(), surface)))[0].height_m == 51).all()
    located, said = alignment.locate(fixes, Sensors((_sensor(),)))
    assert np.isnan(located.height_m).all()
    assert any("40 reference positions have no height" in text for text in said)


def test_pressure_altitude_uses_the_traffic_s_own_difference() -> None:
    """A warm day: the geometric height is 20 + 4 % of the pressure altitude above it; the profile itself is test_heights'."""
    rng = np.random.default_rng(9)
    n = 6000
    time = EPOCH - EPOCH % 3600 + rng.uniform(0, 7200, n)
    level = rng.uniform(500, 11000, n)
    true = level + 20 + 0.04 * level
    carries = rng.random(n) < 0.8
    fixes = Fixes(
        time_s=time, source=np.full(n, 5), channel=np.full(n, Channel.ADS_B), mode_s=rng.integers(1, 40, n),
        latitude_rad=np.full(n, LAT), longitude_rad=np.full(n, LON), pressure_altitude_m=level,
        height_m=np.where(carries, true + rng.normal(0, 15, n), np.nan),
    )  # fmt: skip
    located, said = alignment.locate(fixes, Sensors(()))
    error = (located.height_m - true)[~carries]
    assert np.abs(np.mean(error)) < 3
    assert np.sqrt(np.mean(error**2)) < 5
    assert np.mean((error / located.vertical_sd_m[~carries]) ** 2) < 1
    assert any("geometric-minus-pressure" in text for text in said)
    # The same levels in another recording: the profile comes from the table that offers it.
    bare = fixes[~carries]
    alone, said = alignment.locate(bare, Sensors(()))
    assert np.array_equal(alone.height_m, bare.pressure_altitude_m)
    assert alone.vertical_sd_m == pytest.approx(30 + 0.05 * bare.pressure_altitude_m, abs=0.01)
    assert any("standard atmosphere" in text for text in said)
    with_profile, _ = alignment.locate(bare, Sensors(()), heights=height_profile(fixes[carries]))
    assert np.allclose(with_profile.height_m, located.height_m[~carries])


def test_accuracies_that_are_missing_are_filled_by_kind_and_said_once() -> None:
    channel = np.array([Channel.ADS_B, Channel.MLAT, 0, 0])
    fixes = Fixes(
        time_s=EPOCH + np.arange(4.0), source=[5, 6, 8, 9], channel=channel, mmsi=[-1, -1, 123, -1], mode_s=[1, 2, -1, 3],
        latitude_rad=np.full(4, LAT), longitude_rad=np.full(4, LON), height_m=np.full(4, 10.0),
    )  # fmt: skip
    located, said = alignment.locate(fixes, Sensors(()))
    assert located.horizontal_sd_m.tolist() == [15, 5, 10, 25]
    assert (located.vertical_sd_m == 20).all()
    assert sum("m per axis is assumed" in text for text in said) == 4
    kept, said = alignment.locate(fixes.replace(horizontal_sd_m=np.full(4, 3.0), vertical_sd_m=np.full(4, 2.0)), Sensors(()))
    assert (kept.horizontal_sd_m == 3).all()
    assert (kept.vertical_sd_m == 2).all()
    assert said == ()


def test_rows_without_position_or_time_are_counted() -> None:
    fixes = _straight(np.arange(5.0))
    lat, time = fixes.latitude_rad.copy(), fixes.time_s.copy()
    lat[0], time[1] = np.nan, np.nan
    _, said = alignment.locate(fixes.replace(latitude_rad=lat, time_s=time), Sensors(()))
    assert any(text.startswith("1 of 5") and "no position" in text for text in said)
    assert any(text.startswith("1 of 5") and "no time" in text for text in said)


# ---------------------------------------------------------------------------------------------------------------- clocks


def test_time_offsets_are_taken_from_both_tables() -> None:
    sensors = Sensors((_sensor(time_offset_s=0.35), _sensor(name="R", sic=7, kind="psr", time_offset_s=-2.0)))
    plots = alignment.apply_time_offsets(Plots(time_s=[10.0, 20.0], sensor=[7, 9]), sensors)
    fixes = alignment.apply_time_offsets(Fixes(time_s=[10.0, 20.0], source=[5, 7]), sensors)
    assert plots.time_s.tolist() == [12.0, 20.0]
    assert fixes.time_s.tolist() == [9.65, 22.0]


def _clocks(a: tuple[float, float], b: tuple[float, float]) -> tuple[Plots, Fixes]:
    return Plots(time_s=EPOCH + np.linspace(*a, 50)), Fixes(time_s=EPOCH + np.linspace(*b, 50))


def test_overlapping_recordings_pass_quietly() -> None:
    check = alignment.overlap(*_clocks((0, 3600), (-10, 3700)))
    assert check.message == ""
    assert check.overlap_s == pytest.approx(3600)
    assert check.inside == 1.0
    partly = alignment.overlap(*_clocks((0, 3600), (1800, 7200)))
    assert "only 50% of the plots" in partly.message
    assert partly.overlap_s == pytest.approx(1800)


def test_recordings_that_miss_each_other_are_refused_with_by_how_much() -> None:
    with pytest.raises(NothingToDo, match=r"miss each other by 26\.0 min.*time_offset_s"):
        alignment.overlap(*_clocks((0, 3600), (3600 + 1560, 9000)))


def test_a_day_off_is_named() -> None:
    with pytest.raises(NothingToDo, match=r"24 h earlier they would overlap for 60\.0 min.*--date"):
        alignment.overlap(*_clocks((0, 3600), (86400, 90000)))
    with pytest.raises(NothingToDo, match=r"24 h later"):
        alignment.overlap(*_clocks((0, 3600), (-86400, -82800)))


def test_tables_without_stamps_are_refused() -> None:
    plots, fixes = _clocks((0, 10), (0, 10))
    with pytest.raises(NothingToDo, match="no plot record"):
        alignment.overlap(plots.replace(time_s=np.full(50, np.nan)), fixes)
    with pytest.raises(NothingToDo, match="no reference record"):
        alignment.overlap(plots, Fixes())


# ------------------------------------------------------------------------------------------------------- real recordings


@pytest.mark.real
def test_adsb_against_multilateration_at_barcelona(data: Path) -> None:
    """METHODS section 7: on the ground, ADS-B is stamped 0.35 s later than the multilateration and agrees to about 1 m across."""
    from boresight.reading import read

    folder, date = data / "lebl-2016", datetime.date(2016, 5, 10)
    adsb = read(folder / "adsb_cat021v023_160510-lebl-220001.ast", date=date, editions={21: "0.23"}).fixes
    mlat = read(folder / "mlat_cat010_160510-lebl-220001.ast", date=date).fixes
    point = Sensor(name="MLAT", sac=0, sic=107, kind="mlat", lat_deg=41.297079, lon_deg=2.078463, height_m=51.0)
    adsb, _ = alignment.locate(adsb, Sensors((point,)))
    mlat, said = alignment.locate(mlat, Sensors((point,)))
    assert any("height of its reference point" in text for text in said)
    assert alignment.overlap(Plots(time_s=adsb.time_s), mlat).overlap_s == pytest.approx(7260, abs=2)
    trajectories = alignment.trajectories(mlat)
    assert trajectories.targets == 37
    address = np.full(trajectories.targets, -1)
    address[trajectories.target[mlat.mode_s > 0]] = mlat.mode_s[mlat.mode_s > 0]
    low = adsb[(adsb.flags & Flag.GROUND != 0) & np.isin(adsb.mode_s, address)]
    target = np.array([int(np.flatnonzero(address == a)[0]) for a in low.mode_s])
    states = alignment.states(trajectories, target, low.time_s)
    position = geodesy.ecef_from_geodetic(low.latitude_rad, low.longitude_rad, low.height_m)
    speed = np.linalg.norm(states.velocity, axis=1)
    moving = states.valid & (speed > 5)
    assert moving.sum() > 3000
    error = (position - states.position)[moving]
    ahead = states.velocity[moving] / speed[moving][:, None]
    along = np.einsum("ij,ij->i", error, ahead)
    across = np.linalg.norm(error - along[:, None] * ahead, axis=1)
    # Stamped late by d, a fix lies v d behind where the target is at its stamp.
    fast = speed[moving] > 8
    assert 0.2 < np.median(-along[fast] / speed[moving][fast]) < 0.55
    assert np.median(across) < 2.5
