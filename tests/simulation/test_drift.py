"""Errors over time against closed forms: ramps, sines, steps, walks and wandering noise."""

from __future__ import annotations

import numpy as np
import pytest

from boresight.simulation.drift import Drift, History, Sine, Step, Streams, drift_mistakes, gauss_markov, history

HOUR = 3600.0
RIGHT = Drift(value=-1.0, sine=(Sine(amplitude=-1.0, period_s=2.0),), step=(Step(at_s=3.0, by=-1.0),), walk_per_sqrt_h=1.0)


def of(drift: float | Drift, span_s: float = HOUR, seed: int = 1) -> History:
    return history(drift, span_s, np.random.default_rng(seed))


def test_a_number_is_the_same_at_all_times() -> None:
    seconds = np.array([0.0, 0.3, 1000.0])
    np.testing.assert_array_equal(of(0.3)(seconds), 0.3)
    np.testing.assert_array_equal(of(0.3).mean(seconds), 0.3)


def test_parts_are_what_they_are_called_and_add_up() -> None:
    t = np.linspace(0.0, 5000.0, 777)
    ramp = 0.1 * t / HOUR
    wave = 0.2 * np.sin(2 * np.pi * t / 400.0 + np.pi / 6) + 0.05 * np.cos(2 * np.pi * t / 70.0)
    jumps = 0.3 * (t >= 600.0) - 0.7 * (t >= 2000.5)
    sines = (Sine(amplitude=0.2, period_s=400.0, phase_deg=30.0), Sine(amplitude=0.05, period_s=70.0, phase_deg=90.0))
    steps = (Step(at_s=600.0, by=0.3), Step(at_s=2000.5, by=-0.7))
    np.testing.assert_allclose(of(Drift(ramp_per_h=0.1))(t), ramp, atol=1e-15)
    np.testing.assert_allclose(of(Drift(sine=sines))(t), wave, atol=1e-15)
    np.testing.assert_allclose(of(Drift(step=steps))(t), jumps, atol=1e-15)
    whole = of(Drift(value=-2.0, ramp_per_h=0.1, sine=sines, step=steps, walk_per_sqrt_h=0.5))
    walk = of(Drift(walk_per_sqrt_h=0.5))
    np.testing.assert_allclose(whole(t), -2.0 + ramp + wave + jumps + walk(t), atol=1e-14)


def test_the_mean_is_the_integral_over_the_time() -> None:
    drift = Drift(
        value=1.0, ramp_per_h=3.0, walk_per_sqrt_h=5.0, step=(Step(at_s=100.25, by=-4.0),),
        sine=(Sine(amplitude=2.0, period_s=333.0, phase_deg=20.0),),
    )  # fmt: skip
    error = of(drift)
    for end in (0.5, 77.7, 100.25, 1234.5, 3600.0):
        middle = (np.arange(400_000) + 0.5) * end / 400_000
        assert error.mean(np.array([end]))[0] == pytest.approx(error(middle).mean(), abs=2e-5)
    at_once = error.mean(np.array([0.0]))
    assert at_once == pytest.approx(error(np.array([0.0])), abs=1e-6)


def test_a_walk_starts_at_nothing_and_its_variance_grows_in_proportion_to_the_time() -> None:
    at = np.array([0.0, 900.0, 1800.0, 3600.0])
    runs = np.array([of(Drift(walk_per_sqrt_h=0.4), seed=k)(at) for k in range(1500)])
    np.testing.assert_array_equal(runs[:, 0], 0.0)
    # Each variance of 1,500 is good to 3.7 %.
    np.testing.assert_allclose(runs.var(axis=0)[1:], 0.16 * at[1:] / HOUR, rtol=0.12)
    steps = np.diff(runs, axis=1)
    assert abs(np.corrcoef(steps[:, 1], steps[:, 2])[0, 1]) < 0.1


def test_a_longer_scene_begins_with_the_same_walk() -> None:
    t = np.linspace(0.0, 600.0, 50)
    np.testing.assert_array_equal(
        of(Drift(walk_per_sqrt_h=1.0), span_s=600.0)(t), of(Drift(walk_per_sqrt_h=1.0), span_s=9000.0)(t)
    )


def test_streams_depend_on_their_name_alone() -> None:
    one, two, plain = (np.random.default_rng(7) for _ in range(3))
    first, second = Streams(one), Streams(two)
    second("something else").normal(size=100)
    np.testing.assert_array_equal(first("error a").normal(size=9), second("error a").normal(size=9))
    assert first("error a").normal() != first("error b").normal()
    # And what is drawn from the generator itself is as if there were none.
    np.testing.assert_array_equal(one.normal(size=9), plain.normal(size=9))
    assert Streams(np.random.default_rng(8))("error a").normal() != first("error a").normal()
    assert Streams(one)("error a").normal() != first("error a").normal(), "the same generator once more"


def test_wandering_noise_has_variance_one_and_an_exponential_correlation() -> None:
    rng = np.random.default_rng(3)
    track = np.repeat(np.arange(400), 300)
    # Uneven times, and rows in no order.
    seconds = np.cumsum(rng.uniform(1.0, 9.0, (400, 300)), axis=1).ravel()
    shuffled = rng.permutation(len(track))
    wander = np.empty(len(track))
    wander[shuffled] = gauss_markov(track[shuffled], seconds[shuffled], 25.0, rng)
    assert wander.std() == pytest.approx(1.0, abs=0.02)
    assert abs(wander.mean()) < 0.03
    rows, times = wander.reshape(400, 300), seconds.reshape(400, 300)
    assert rows[:, 0].std() == pytest.approx(1.0, abs=0.15), "from the first plot on"
    for lag in (1, 3, 8):
        expected = np.exp(-(times[:, lag:] - times[:, :-lag]) / 25.0).mean()
        assert (rows[:, lag:] * rows[:, :-lag]).mean() == pytest.approx(expected, abs=0.03)
    assert abs((rows[1:] * rows[:-1]).mean()) < 0.02, "tracks know nothing of each other"
    assert len(gauss_markov(np.empty(0, np.int64), np.empty(0), 5.0, rng)) == 0


@pytest.mark.parametrize(
    ("drift", "text"),
    [
        (Drift(value=float("nan")), "no finite number"),
        (Drift(step=(Step(at_s=float("inf"), by=1.0),)), "no finite number"),
        (Drift(sine=(Sine(amplitude=1.0, period_s=0.0),)), "period_s above 0"),
        (Drift(walk_per_sqrt_h=-1.0), "walk_per_sqrt_h"),
    ],
)
def test_what_makes_no_sense_is_said(drift: Drift, text: str) -> None:
    assert list(drift_mistakes(RIGHT)) == []
    (said,) = drift_mistakes(drift)
    assert text in said
