"""Biases over time: the bank against a plain Kalman filter, honest variances, steps, and whole calibrations."""

from __future__ import annotations

import dataclasses
import datetime
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import DEG, EPOCH, scene
from test_mean_shift import BIAS, FAR, MAIN, NEAR, THREE, recording

from boresight import flow
from boresight.calibration import Calibration, load_calibration, save_calibration, summary_json
from boresight.correction import correct
from boresight.errors import NothingToDo, SettingsError
from boresight.model import Sensor, Sensors, load_sensors
from boresight.registration import register
from boresight.registration.mean_shift import Samples, relative_samples
from boresight.registration.sequential import METHODS, KalmanBank, online_samples, register_online, register_relative


def samples(
    value: np.ndarray, sd: tuple[float, float, float] = (30.0, 1e-3, 1e-3), *, step_s: float = 1.0, targets: int = 4
) -> Samples:
    """Samples (n, 3) as they come from one radar."""
    n = len(value)
    return Samples(
        EPOCH + step_s * np.arange(n), value, np.tile(np.diag(np.square(sd)), (n, 1, 1)), np.tile([40e3, 1.0, 0.1], (n, 1)),
        np.arange(n) % targets, np.full(n, -1), np.zeros((n, 3)), np.full((n, 3, 3), np.nan),
    )  # fmt: skip


def drawn(seed: int, n: int = 400, sd: tuple[float, float, float] = (30.0, 1e-3, 1e-3)) -> np.ndarray:
    return np.array([100.0, 5e-3, -2e-3]) + np.random.default_rng(seed).normal(size=(n, 3)) * sd


def value(found: Calibration, term: str, sensor: int) -> tuple[np.ndarray, np.ndarray]:
    k = found.index(sensor, term)
    assert k is not None
    return found.value[:, k], found.sd[:, k]


def test_one_member_without_robustness_is_a_kalman_filter() -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.5, 2.0, 80))
    z, r = rng.normal(size=80).cumsum() * 0.3, rng.uniform(0.5, 2.0, 80)
    bank = KalmanBank(memory_s=(25.0, 25.0), members=1, huber=1e6, reject=1e6, streak=1000)
    epochs = np.append(t, t[-1] + 5.0)
    found = bank(t, z[None], r, epochs)
    q = np.median(r) * np.diff(t).mean() / 25.0**4
    x, p = np.array([z[0], 0.0]), np.diag([r[0], r[0] / 25.0**2])
    h = np.array([[1.0, 0.0]])
    for k in range(1, 81):
        dt = epochs[k] - epochs[k - 1]
        f = np.array([[1.0, dt], [0.0, 1.0]])
        x, p = f @ x, f @ p @ f.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        if k < 80:
            s = h @ p @ h.T + r[k]
            gain = p @ h.T / s
            x, p = x + gain[:, 0] * (z[k] - x[0]), (np.eye(2) - gain @ h) @ p
        assert found.value[0, k] == pytest.approx(x[0], rel=1e-9)
        assert found.variance[0, k] == pytest.approx(p[0, 0], rel=1e-9)


def test_one_member_with_targets_of_their_own_is_a_kalman_filter() -> None:
    """Against the plain filter of bias, rate and one fading offset a target."""
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.5, 2.0, 120))
    z, r, who = rng.normal(size=120) * 3.0, np.full(120, 1.5), rng.integers(0, 4, 120)
    bank = KalmanBank(memory_s=(25.0, 25.0), members=1, huber=1e6, reject=1e6, streak=1000)
    found = bank(t, z[None], r, t, who, np.array([4.0]))
    q = 1.5 * np.diff(t).mean() / 25.0**4
    # Of the bias nothing is known before the first sample.
    x, p, last = np.zeros(6), np.diag([1e12, 1.5 / 25.0**2, 4.0, 4.0, 4.0, 4.0]), np.full(4, t[0])
    for k in range(120):
        f = np.eye(6)
        f[0, 1] = t[k] - t[k - 1] if k else 0.0
        dt = f[0, 1]
        x, p = f @ x, f @ p @ f.T
        p[:2, :2] += q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        stay = np.diag([1.0, 1.0, *np.exp(-(t[k] - last) / 600.0)])
        x, p = stay @ x, stay @ p @ stay
        p[2:, 2:] += np.diag(4.0 * (1 - np.diag(stay)[2:] ** 2))
        last[:] = t[k]
        h = np.zeros(6)
        h[0] = h[2 + who[k]] = 1.0
        gain = p @ h / (h @ p @ h + r[k])
        x, p = x + gain * (z[k] - h @ x), p - np.outer(gain, h @ p)
        assert found.value[0, k] == pytest.approx(x[0], rel=1e-4, abs=1e-4)
        assert found.variance[0, k] == pytest.approx(p[0, 0], rel=1e-3)


def test_a_step_of_the_bias_is_told_from_targets_that_come_and_go() -> None:
    """Twenty targets with errors of their own, ten at a time, a bias that goes to and fro and steps: followed, and honestly."""
    wrong, steps = [], []
    for seed in range(6):
        rng = np.random.default_rng([seed, 77])
        t = np.arange(0.0, 3600.0, 0.5)
        who = (np.arange(len(t)) % 10) + 10 * (t > 1800)
        truth = 100 + 40 * np.sin(2 * np.pi * t / 1800) - 80 * (t > 2400)
        own = rng.normal(size=20) * 15
        z = np.full((len(t), 3), np.nan)
        z[:, 0] = truth + own[who] + rng.normal(size=len(t)) * 20
        z[:, 1] = rng.normal(size=len(t)) * 1e-3
        mine = samples(z, (20.0, 1e-3, np.nan), step_s=0.5)
        found = register_online(dataclasses.replace(mine, target=who), MAIN, step_s=10.0)
        got, sd = value(found, "range_bias", MAIN.key)
        off = got - np.interp(found.epoch_s - found.epoch_s[0], t, truth)
        settled = found.epoch_s - found.epoch_s[0] > 300
        wrong.append(np.mean((off / sd)[settled] ** 2))
        after = np.abs(found.epoch_s - found.epoch_s[0] - 2430) < 1
        steps.append(np.abs(off[after]).max())
    assert 0.4 < np.mean(wrong) < 2.0
    # Half a minute after a step of 80 m what is left is what the targets' own errors leave.
    assert np.mean(steps) < 15


def traffic(
    seed: int, *, own_m: float = 15.0, coloured: float = 0.0, outliers: float = 0.0, together: int = 10, life_s: float = 900.0
) -> tuple[Samples, np.ndarray]:
    """An hour of samples of a constant 100 m (sd 20 m, every 4 s, `together` targets at a time), and which are outliers.

    Each target keeps an error of its own; a share of the noise's variance may have a memory of 20 s.
    """
    rng = np.random.default_rng([seed, 5])
    t = np.arange(0.0, 3600.0, 4.0 / together)
    lane = np.arange(len(t)) % together
    turn = np.floor(t / life_s + lane / together).astype(int)
    _, who = np.unique(lane + together * turn, return_inverse=True)
    slow = np.empty(len(t))
    keep = np.exp(-4.0 / 20.0)
    for k in range(len(t)):
        before = slow[k - together] if k >= together else rng.normal()
        slow[k] = keep * before + np.sqrt(1 - keep**2) * rng.normal()
    wild = rng.random(len(t)) < outliers
    z = np.full((len(t), 3), np.nan)
    noise = np.sqrt(1 - coloured) * rng.normal(size=len(t)) + np.sqrt(coloured) * slow
    z[:, 0] = 100.0 + own_m * rng.normal(size=who.max() + 1)[who] + 20.0 * noise + wild * rng.uniform(100, 300, len(t))
    z[:, 1] = rng.normal(size=len(t)) * 1e-3
    return dataclasses.replace(samples(z, (20.0, 1e-3, np.nan), step_s=4.0 / together), target=who), wild


@pytest.mark.parametrize(
    ("how", "low", "high", "most_m"),
    [
        ({}, 0.5, 1.5, 7.0),
        ({"outliers": 0.1}, 0.5, 1.5, 7.0),
        ({"coloured": 0.5}, 0.5, 1.5, 8.0),
        ({"coloured": 0.5, "own_m": 0.0}, 0.4, 1.5, 6.0),
        ({"together": 3}, 0.5, 1.7, 12.0),
    ],
    ids=["own", "own and outliers on one side", "own and memory", "memory alone", "three at a time"],
)
def test_the_sd_holds_with_targets_of_their_own(how: dict[str, Any], low: float, high: float, most_m: float) -> None:
    """Squared errors in units of what is said of them, over 12 recordings; and the errors themselves.

    The mixture is cautious where nothing changes.
    """
    off, sd = [], []
    for seed in range(12):
        mine, _ = traffic(seed, **how)
        found = register_online(mine, MAIN, step_s=20.0)
        got, said = value(found, "range_bias", MAIN.key)
        off.append(got[20:] - 100.0)
        sd.append(said[20:])
    assert low < np.mean((np.array(off) / sd) ** 2) < high
    assert np.sqrt(np.mean(np.square(off))) < most_m


@pytest.mark.parametrize("name", ["igmsr", "exponential-average", "alpha-beta", "mean-shift"])
def test_targets_that_come_and_go_widen_every_method(name: str) -> None:
    """The sd counts the targets that are in the estimate, not those of long before."""
    wrong = []
    for seed in range(12):
        mine, _ = traffic(seed, together=4, own_m=40.0)
        # In the last four minutes there is one target.
        last = mine.time_s > mine.time_s[-1] - 240
        keep = ~last | (mine.target == mine.target[-1])
        found = register_online(mine.take(keep), MAIN, method=METHODS[name], step_s=20.0)
        got, sd = value(found, "range_bias", MAIN.key)
        wrong.append(((got - 100.0) / sd)[-1] ** 2)
    assert np.mean(wrong) < 2.2


def test_one_target_at_a_time_is_said() -> None:
    alone, _ = traffic(0, together=1)
    note = "one target at a time"
    assert any(note in said for said in register_online(alone, MAIN).sensors[0].notes)
    several, _ = traffic(0, together=3)
    assert not any(note in said for said in register_online(several, MAIN).sensors[0].notes)


def test_after_a_step_the_level_is_known_no_better_than_its_targets() -> None:
    """One target whose own error is far larger than the noise: a step tells the level no better than that error is known."""
    rng = np.random.default_rng(12)
    t = np.arange(0.0, 400.0)
    z = 40.0 * (t > 200) + rng.normal(size=400)
    bank = KalmanBank(memory_s=(20.0, 20.0), members=1)
    found = bank(t, z[None], 1.0, t, np.zeros(400, int), np.array([100.0]))
    before, after = np.sqrt(found.variance[0, [199, 230]])
    assert found.value[0, 230] - found.value[0, 199] == pytest.approx(40.0, abs=1.5)
    assert after > 0.9 * before > 3.0


def test_a_rate_is_not_carried_through_a_gap() -> None:
    rng = np.random.default_rng(13)
    t = np.arange(0.0, 1200.0)
    z = 100.0 + 40.0 * np.sin(t / 300) + rng.normal(size=1200) * 20
    epochs = np.array([1199.0, 1199.0 + 36000.0])
    found = KalmanBank()(t, z[None], 400.0, epochs)
    # Ten hours at the last rate would be kilometres.
    assert abs(found.value[0, 1] - found.value[0, 0]) < 200
    assert np.sqrt(found.variance[0, 1]) > 1000


def test_a_bank_over_a_long_recording_stays_a_bank() -> None:
    """Sixty targets at a time come and go through 60,000 samples: no variance is lost; the same input, the same bytes."""
    rng = np.random.default_rng(14)
    n = 60_000
    t = np.arange(n) * 0.2
    lane = np.arange(n) % 60
    _, who = np.unique(lane + 60 * np.floor(t / 1800 + lane / 60).astype(int), return_inverse=True)
    z = 5.0 + rng.normal(size=who.max() + 1)[who] * 15 + rng.normal(size=n) * 20
    z[n // 2 :] += 200
    bank = KalmanBank(memory_s=(40.0, 640.0), members=3)
    epochs = np.arange(0.0, t[-1], 60.0)
    found, again = (bank(t, z[None], 400.0, epochs, who, np.array([225.0])) for _ in range(2))
    assert found.value.tobytes() == again.value.tobytes()
    off = found.value[0] - 5.0 - 200 * (epochs >= t[n // 2])
    late = (epochs > 600) & (np.abs(epochs - t[n // 2]) > 90)
    assert 0.3 < np.mean(off[late] ** 2 / found.variance[0, late]) < 2.5
    # Sixty targets with 15 m each leave 2 m; the noise of those seen so far as little again.
    assert 1.0 < np.sqrt(found.variance[0, late].min()) < np.sqrt(found.variance[0, late].max()) < 12


@pytest.mark.parametrize(("period", "high"), [(np.inf, 1.1), (1600.0, 1.3), (400.0, 1.4)])
def test_the_variance_of_the_bank_is_true(period: float, high: float) -> None:
    """Squared errors over 60 series; the mixture is cautious where nothing changes."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 800.0, 0.5)
    phase = rng.uniform(0, 6, (60, 1))
    truth = 3.0 * np.sin(2 * np.pi * t / period + phase)
    found = KalmanBank()(t, truth + rng.normal(size=truth.shape), 1.0, t)
    assert 0.45 < ((found.value - truth)[:, 40:] ** 2 / found.variance[:, 40:]).mean() < high


def test_a_step_is_taken_up_at_once_with_outliers_on_one_side() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(400.0)
    truth = np.where(t < 200, 0.0, 10.0)
    z = truth + rng.normal(size=(60, 400)) + (rng.random((60, 400)) < 0.1) * rng.uniform(5, 15, (60, 400))
    error = np.abs(KalmanBank()(t, z, 1.0, t).value - truth)
    assert np.percentile(error[:, 212:], 99) < 1.0
    assert error[:, 20:200].max() < 2.0
    assert np.percentile(error[:, 20:200], 99) < 0.8


# -------------------------------------------------------------------------------------------------------------- calibrations
@pytest.mark.parametrize("name", METHODS)
def test_radars_are_registered_to_the_main_one(name: str, tmp_path: Path) -> None:
    plots = recording(targets=8)
    differences = relative_samples(plots, THREE, MAIN)
    found = register_relative(differences, THREE, MAIN, method=METHODS[name])
    truth = BIAS[NEAR.key] - BIAS[MAIN.key]
    for term, true in zip(("range_bias", "azimuth_bias", "elevation_bias"), truth, strict=True):
        got, sd = value(found, term, NEAR.key)
        assert abs(got[-1] - true) <= 4 * sd[-1] + 1e-4 * abs(true)
        assert abs(true) > 5 * sd[-1]
    assert found.settings["method"] == name
    assert found.settings["kind"] == "relative"
    # What is absolute is refused, with the reason and the number.
    absolute = [n for n in found.not_determined if n.sensor == MAIN.key]
    assert {n.term for n in absolute} == {"range_bias", "azimuth_bias", "elevation_bias"}
    assert all("condition number" in n.why and "reference" in n.why for n in absolute)
    (summary,) = found.sensors
    assert summary.model == "relative to M"
    assert summary.after.median_m < 0.3 * summary.before.median_m
    assert any("samples agree within 3 sd" in note for note in summary.notes)
    assert any("relative: bias of N minus bias of M" in note for note in summary.notes)
    str(found)
    summary_json(found)
    save_calibration(found, tmp_path / "calibration.json")
    again = load_calibration(tmp_path / "calibration.json")
    np.testing.assert_allclose(again.value, found.value)
    assert again.settings == found.settings


def test_a_corrected_radar_agrees_with_the_main_one() -> None:
    plots = recording(targets=8)
    found = register_relative(relative_samples(plots, THREE, MAIN), THREE, MAIN)
    clean = correct(plots, found)
    left = relative_samples(clean, THREE, MAIN)[NEAR.key]
    sd = np.sqrt(np.diagonal(left.covariance, axis1=1, axis2=2)).mean(axis=0)
    late = left.time_s > left.time_s[0] + 60
    assert (np.abs(left.value[late].mean(axis=0)) < 0.1 * sd).all()


def test_estimates_against_one_main_radar_share_its_noise() -> None:
    """Over 60 recordings the errors correlate as the covariance says."""
    other = Sensor(name="O", id=70009, lat_deg=46.0002, lon_deg=14.0, height_m=300.0, range_sd_m=20.0, azimuth_sd_deg=0.05,
                   elevation_sd_deg=0.05)  # fmt: skip
    BIAS[other.key] = np.zeros(3)
    sensors = Sensors((MAIN, NEAR, other))
    off, said, wide = [], [], []
    for seed in range(60):
        plots = recording((MAIN, NEAR, other), targets=2, duration_s=240.0, seed=100 + seed, together=True)
        found = register_relative(relative_samples(plots, sensors, MAIN), sensors, MAIN)
        k = [found.index(s, "azimuth_bias") for s in (NEAR.key, other.key)]
        truth = np.array([BIAS[s][1] - BIAS[MAIN.key][1] for s in (NEAR.key, other.key)])
        off.append(found.value[-1, k] - truth)
        c = found.covariance[-1][np.ix_(k, k)]
        said.append(c[0, 1] / np.sqrt(c[0, 0] * c[1, 1]))
        wide.append(np.diag(c))
        assert np.linalg.eigvalsh(found.covariance[-1] / np.outer(found.sd[-1], found.sd[-1])).min() > 0
    e = np.array(off)
    assert np.mean(said) == pytest.approx(0.5, abs=0.05)
    assert np.corrcoef(e.T)[0, 1] == pytest.approx(0.5, abs=0.3)
    assert 0.3 < (e**2 / np.array(wide)).mean() < 1.6


def test_terms_that_differences_cannot_tell_are_refused() -> None:
    differences = relative_samples(recording(targets=2), THREE, MAIN)
    with pytest.raises(SettingsError, match="relative biases only, not time_offset"):
        register_relative(differences, THREE, MAIN, terms=("range_bias", "time_offset"))
    with pytest.raises(SettingsError, match="against itself"):
        register_relative({MAIN.key: differences[NEAR.key]}, THREE, MAIN)
    with pytest.raises(SettingsError, match="step_s"):
        register_relative(differences, THREE, MAIN, step_s=0.0)
    with pytest.raises(NothingToDo):
        register_relative({}, THREE, MAIN)
    only = register_relative(differences, THREE, MAIN, terms=("azimuth_bias",))
    assert [k.name for k in only.terms] == ["azimuth_bias"]


def test_radars_far_apart_are_sent_to_the_network() -> None:
    plots = recording((MAIN, FAR), targets=8)
    found = register_relative(relative_samples(plots, THREE, MAIN), THREE, MAIN)
    assert any("against a trusted reference" in note for note in found.sensors[0].notes)
    near = register_relative(relative_samples(recording(), THREE, MAIN), THREE, MAIN)
    assert not any("against a trusted reference" in note for note in near.sensors[0].notes)


def test_a_drifting_bias_is_followed_against_a_reference() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(3000.0)
    drift = 100.0 + 80.0 * np.sin(2 * np.pi * t / 3000.0)
    z = np.stack([drift, np.full(3000, 5e-3), np.full(3000, np.nan)], axis=1) + rng.normal(size=(3000, 3)) * [30.0, 1e-3, 1e-3]
    found = register_online(samples(z), MAIN, step_s=10.0)
    assert len(found.epoch_s) == 301
    assert found.epoch_s[-1] == EPOCH + 2999.0
    got, sd = value(found, "range_bias", MAIN.key)
    truth = np.interp(found.epoch_s - EPOCH, t, drift)
    late = found.epoch_s > EPOCH + 100
    assert np.sqrt(np.mean((got - truth)[late] ** 2)) < 8.0
    assert 0.4 < np.mean(((got - truth) / sd)[late] ** 2) < 1.6
    missing = {n.term: n.why for n in found.not_determined}
    assert missing == {"elevation_bias": "elevation is not measured"}


def test_pairs_give_samples_and_the_other_terms_stay() -> None:
    truth = {"A": {"range_bias": 120.0, "azimuth_bias": 0.3 * DEG, "time_offset": 0.8}}
    s = scene(
        3,
        truth,
        sensors=Sensors((Sensor(name="A", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=300.0),)),
        targets=25,
    )
    static = register(s.pairs, s.sensors, model=("range_bias", "azimuth_bias", "time_offset"))
    sensor = s.sensors.sensor[0]
    mine = online_samples(s.pairs, s.sensors, beside=static)[sensor.key]
    found = register_online(mine, sensor, beside=static)
    assert {k.name for k in found.terms} == {"range_bias", "azimuth_bias", "time_offset"}
    np.testing.assert_allclose(value(found, "time_offset", sensor.key)[0], value(static, "time_offset", sensor.key)[0][0])
    for name in ("range_bias", "azimuth_bias"):
        got, sd = value(found, name, sensor.key)
        wrong = (got - truth["A"][name]) / sd
        # Targets' own delays are not white: sd that took every plot for itself would be several times too small.
        assert np.median(np.abs(wrong)) < 1.5
        assert np.percentile(np.abs(wrong), 95) < 4
    # Without them the time offset spoils the samples.
    raw = online_samples(s.pairs, s.sensors)[sensor.key]
    assert np.std(raw.value[:, 0]) > 1.5 * np.std(mine.value[:, 0])
    clean = correct(s.pairs.plots, found)
    assert len(clean) == len(s.pairs)


def test_what_the_constant_terms_are_wrong_by_is_in_the_biases() -> None:
    """Cov(bias) grows by G C G', with C of the constant terms and G = cov(bias, terms) / C: where C is wide, by a lot."""
    sensors = Sensors((Sensor(name="A", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=300.0),))
    s = scene(3, {"A": {"azimuth_bias": 0.2 * DEG}}, sensors=sensors, targets=12)
    sensor = s.sensors.sensor[0]
    static = register(s.pairs, s.sensors, model=("range_bias", "azimuth_bias", "azimuth_cos", "azimuth_sin"))
    assert [k.name for k in static.terms] == ["range_bias", "azimuth_bias", "azimuth_cos", "azimuth_sin"]
    # As if far fewer plots had told them.
    static = dataclasses.replace(static, covariance=static.covariance * 100)
    mine = online_samples(s.pairs, s.sensors, beside=static)[sensor.key]
    found, alone = register_online(mine, sensor, beside=static), register_online(mine, sensor)
    c = static.covariance[0]
    gain = c[:2, 2:] @ np.linalg.inv(c[2:, 2:])
    for k in (0, 200, 400):
        np.testing.assert_allclose(found.covariance[k, :2, :2], alone.covariance[k] + gain @ c[2:, 2:] @ gain.T, rtol=1e-8)
        np.testing.assert_allclose(found.covariance[k, :2, 2:], c[:2, 2:])
        size = found.sd[k]
        assert np.linalg.eigvalsh(found.covariance[k] / size[:, None] / size).min() > 0
    assert found.sd[-1, 1] > 1.5 * alone.sd[-1, 1]


def test_bad_samples_are_left_out_or_said() -> None:
    z = drawn(5)
    holed = samples(z)
    holed.value[::3, 2] = np.nan
    holed.value[5] = np.nan
    holed.time_s[7] = np.nan
    found = register_online(holed, MAIN)
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.covariance).all()
    assert any("2 of 400 samples were left out" in note for note in found.sensors[0].notes)
    with pytest.raises(NothingToDo, match="too few"):
        register_online(samples(z[:3]), MAIN)
    with pytest.raises(NothingToDo, match="no sample with a time"):
        register_online(samples(z[:0]), MAIN)


def test_nothing_but_outliers_gives_a_number_nobody_can_mistake() -> None:
    wild = np.random.default_rng(6).uniform(-1, 1, (400, 3)) * [1e5, 1.0, 0.5]
    found = register_online(samples(wild), MAIN)
    assert value(found, "range_bias", MAIN.key)[1][-1] > 1e3
    assert sum("times what their sd say" in note for note in found.sensors[0].notes) == 3
    # All history does not follow a drift.
    z = drawn(11) + np.linspace(0, 6000, 400)[:, None] * [1.0, 0.0, 0.0]
    said = register_online(samples(z), MAIN, method=METHODS["mean-shift"]).sensors[0].notes
    assert any("most samples do not agree" in note for note in said)


def test_constant_samples_and_equal_times_have_defined_values() -> None:
    same = register_online(samples(np.tile([50.0, 1e-3, 0.0], (100, 1)), (0.0, 0.0, 0.0)), MAIN)
    np.testing.assert_allclose(same.value[-1], [50.0, 1e-3, 0.0], atol=1e-9)
    assert (same.sd > 0).all()
    assert np.isfinite(same.sd).all()
    at_once = register_online(samples(drawn(8), step_s=0.0), MAIN)
    assert len(at_once.epoch_s) == 1
    assert abs(at_once.value[0, 0] - 100.0) < 5 * at_once.sd[0, 0]


def test_samples_that_scatter_more_than_they_say_are_taken_for_what_they_are() -> None:
    z = drawn(9, sd=(90.0, 1e-3, 1e-3))
    found = register_online(samples(z), MAIN)
    assert any("range_bias: samples scatter by" in note and "times what their sd say" in note for note in found.sensors[0].notes)
    got, sd = value(found, "range_bias", MAIN.key)
    assert abs(got[-1] - 100.0) < 4 * sd[-1]
    assert found.sensors[0].noise.range_m == pytest.approx(90.0, rel=0.15)


def test_errors_that_a_target_keeps_to_itself_widen_the_sd() -> None:
    rng = np.random.default_rng(10)
    z = drawn(10, 4000)
    own = np.repeat(rng.normal(size=(20, 1)) * [60.0, 0.0, 0.0], 200, axis=0).reshape(20, 200, 3)
    mixed = samples(z + own.transpose(1, 0, 2).reshape(4000, 3), targets=20)
    shared = register_online(mixed, MAIN)
    plain = register_online(samples(z), MAIN)
    assert value(shared, "range_bias", MAIN.key)[1][-1] > 2 * value(plain, "range_bias", MAIN.key)[1][-1]
    assert any("samples of one target share errors" in note for note in shared.sensors[0].notes)


def test_the_page_on_relative_registration_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = Path(__file__).parents[2] / "docs" / "relative.md"
    text = page.read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.S | re.M):
        exec(compile(block, page.name, "exec"), names)
    assert "other (relative to main)" in capsys.readouterr().out
    found, figure = names["found"], names["figure"]
    assert isinstance(found, Calibration)
    got, sd = value(found, "range_bias", 70002)
    truth = 80 + 60 * np.sin((found.epoch_s - 1.7e9) / 300)
    assert np.sqrt(np.mean((got - truth)[10:] ** 2)) < 12
    assert np.median(np.abs(got - truth) / sd) < 1.5
    assert figure.svg.startswith("<svg")
    assert all(f"`{name}`" in text for name in METHODS)


@pytest.mark.real
def test_the_bias_of_a_surface_radar_stays_over_two_hours(data: Path, tmp_path: Path) -> None:
    """Barcelona 2016 against multilateration: what is followed agrees with the static fit, through gaps without traffic."""
    (tmp_path / "sensors.toml").write_text(
        '[[sensor]]\nname = "SMR"\nsac = 0\nsic = 7\nlat_deg = 41.29561833\nlon_deg = 2.095114167\nheight_m = 85.0\n'
        'kind = "surface"\n'
        '[[sensor]]\nname = "MLAT"\nsac = 0\nsic = 107\nlat_deg = 41.297079\nlon_deg = 2.078463\nheight_m = 51.0\nkind = "mlat"\n'
    )
    sensors = load_sensors(tmp_path / "sensors.toml")
    folder = data / "lebl-2016"
    run = flow.calibrate(
        [folder / "smr_cat010_160510-lebl-220001.ast"],
        [folder / "mlat_cat020_160510-lebl-220001.ast"],
        sensors,
        date=datetime.date(2016, 5, 10),
        criterion="none",
    )
    mine = online_samples(run.association.pairs, sensors, beside=run.calibration)[7]
    found = register_online(mine, sensors.sensor[0], beside=run.calibration)
    for term, most in (("range_bias", 4.0), ("azimuth_bias", 0.1 * DEG)):
        got, sd = value(found, term, 7)
        (static,), _ = value(run.calibration, term, 7)
        late = found.epoch_s > found.epoch_s[0] + 600
        assert np.median(sd[late]) < most
        assert np.percentile(np.abs(got[late] - static) / sd[late], 95) < 4
    assert {"time_offset", "along_heading_per_length"} <= {k.name for k in found.terms}
