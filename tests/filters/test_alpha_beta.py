"""The alpha-beta filter against the steady-state Kalman filter that its gains come from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from boresight.errors import SettingsError
from boresight.filters import AlphaBeta, alpha_beta_filter
from boresight.filters.alpha_beta import alpha_beta_covariance


@pytest.mark.parametrize(("acceleration", "dt", "sd"), [(0.5, 4.0, 60.0), (5.0, 1.0, 20.0), (0.01, 10.0, 100.0)])
def test_steady_gains_solve_the_riccati_equation(acceleration: float, dt: float, sd: float) -> None:
    f, g, h = np.array([[1, dt], [0, 1]]), np.array([[dt**2 / 2], [dt]]), np.array([[1.0, 0]])
    p = solve_discrete_are(f.T, h.T, g @ g.T * acceleration**2, np.array([[sd**2]]))
    gain = p @ h.T / (p[0, 0] + sd**2)
    found = AlphaBeta.steady(acceleration, dt, sd)
    assert found.alpha == pytest.approx(gain[0, 0], rel=1e-8)
    assert found.beta == pytest.approx(gain[1, 0] * dt, rel=1e-8)


def test_steady_motion_is_followed_without_error_and_gaps_are_bridged() -> None:
    time_s = np.array([0.0, 2.0, 4.0, 4.0, 9.0, 10.0])
    truth = np.array([100.0, -50.0]) + time_s[:, None] * [30.0, 12.0]
    z = truth[None].copy()
    z[0, 4] = np.nan
    found = alpha_beta_filter(z, time_s, AlphaBeta(), np.array([[30.0, 12.0]]))
    assert found[0, :, :2] == pytest.approx(truth)
    assert found[0, :, 2:] == pytest.approx(np.tile([30.0, 12.0], (6, 1)))


def test_one_step_by_hand() -> None:
    """Off by 10 m after 2 s: position + 4 m, velocity + 0.2 / 2 * 10 = 1 m/s."""
    found = alpha_beta_filter(np.array([[[0.0], [10.0]]]), np.array([0.0, 2.0]), AlphaBeta(alpha=0.4, beta=0.2))
    assert found[0, 1] == pytest.approx([4.0, 1.0])


def test_what_makes_no_sense_is_refused() -> None:
    z = np.zeros((1, 3, 2))
    with pytest.raises(SettingsError, match="do not settle"):
        alpha_beta_filter(z, np.arange(3.0), AlphaBeta(alpha=0.0))
    with pytest.raises(SettingsError, match="time goes backwards"):
        alpha_beta_filter(z, np.array([0.0, 2.0, 1.0]), AlphaBeta())


@pytest.mark.parametrize(("alpha", "beta"), [(0.5, 0.1), (0.2, 0.02), (0.9, 0.6)])
def test_the_covariance_settles_at_kalatas_and_is_that_of_many_runs(alpha: float, beta: float) -> None:
    gains, time_s = AlphaBeta(alpha=alpha, beta=beta), 2.0 * np.arange(400)
    found = alpha_beta_covariance(np.full((1, 400), 9.0), time_s, gains)
    shrink = alpha * (4 - 2 * alpha - beta)
    assert found[0, -1, 0, 0] == pytest.approx(9.0 * (2 * alpha**2 + beta * (2 - 3 * alpha)) / shrink, rel=1e-6)
    assert found[0, -1, 1, 1] == pytest.approx(9.0 * 2 * beta**2 / shrink / 4.0, rel=1e-6)
    # Uneven times with gaps: against what the filter itself does with noise.
    rng = np.random.default_rng(1)
    uneven = np.cumsum(rng.uniform(0.5, 4.0, 30))
    variance = rng.uniform(1.0, 9.0, 30)
    variance[[4, 5, 17]] = np.nan
    noise = rng.normal(size=(20_000, 30)) * np.sqrt(variance)
    states = alpha_beta_filter(noise[:, :, None], uneven, gains)
    expected = np.einsum("nki,nkj->kij", states, states) / len(states)
    assert alpha_beta_covariance(variance[None], uneven, gains)[0] == pytest.approx(expected, rel=0.06, abs=0.03)
