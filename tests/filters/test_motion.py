"""Motion models against the matrix exponential of the differential equations that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from boresight.errors import SettingsError
from boresight.filters import ConstantAcceleration, ConstantVelocity, CoordinatedTurn, Singer, matrices
from boresight.filters.motion import table


def _discrete(a: np.ndarray, noise: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise of ``x' = A x + w`` with white w of density `noise` (Van Loan 1978)."""
    d = len(a)
    block = np.zeros((2 * d, 2 * d))
    block[:d, :d], block[:d, d:], block[d:, d:] = -a, noise, a.T
    e = expm(block * dt)
    f = e[d:, d:].T
    return f, f @ e[:d, d:]


def _system(name: str, axes: int) -> tuple[object, np.ndarray, np.ndarray]:
    """A model, its generator and its noise density, states in blocks of axes."""
    one = np.eye(axes)
    up = 3 if axes == 3 else 2
    density = [2.0] * min(axes, 2) + [0.5] * (axes - 2)
    if name in ("velocity", "turn"):
        a = np.zeros((2 * axes, 2 * axes))
        a[:axes, axes:] = one
        noise = np.diag([0.0] * axes + density)
        if name == "velocity":
            return ConstantVelocity(noise=2.0, noise_up=0.5), a, noise
        w = np.radians(4.0)
        a[axes, axes + 1], a[axes + 1, axes] = w, -w
        return CoordinatedTurn(rate_deg_s=4.0, noise=2.0, noise_up=0.5), a, noise
    a = np.zeros((3 * axes, 3 * axes))
    a[:axes, axes : 2 * axes] = one
    a[axes : 2 * axes, 2 * axes :] = one
    noise = np.diag([0.0] * 2 * axes + density)
    if name == "acceleration":
        return ConstantAcceleration(noise=2.0, noise_up=0.5), a, noise
    assert up in (2, 3)
    tau = {"singer": 15.0, "slow singer": 5e4, "quick singer": 1.5}[name]
    a[2 * axes :, 2 * axes :] = -one / tau
    sd = [np.sqrt(q * tau / 2) for q in density]
    return Singer(time_constant_s=tau, sd_mps2=sd[0], sd_up_mps2=sd[-1]), a, noise


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("dt", [1e-3, 0.7, 4.0, 12.0])
@pytest.mark.parametrize("name", ["velocity", "turn", "acceleration", "singer", "slow singer", "quick singer"])
def test_transition_and_noise_solve_the_differential_equation(name: str, dt: float, axes: int) -> None:
    model, a, noise = _system(name, axes)
    expected_f, expected_q = _discrete(a, noise, dt)
    f, q = matrices(model, dt, axes)
    scale = np.sqrt(np.diag(expected_q))
    assert f == pytest.approx(expected_f, rel=1e-9, abs=1e-9 * np.abs(expected_f).max())
    if name == "turn":
        # White noise of acceleration is taken as along fixed axes over one step: equal to first order in the turn.
        assert np.abs((q - expected_q) / np.outer(scale, scale)).max() < max(np.radians(4.0) * dt, 1e-9)
    else:
        # Van Loan's exponential itself loses digits where dt is many time constants.
        assert np.abs((q - expected_q) / np.outer(scale, scale)).max() < 1e-6
    assert np.array_equal(q, q.T)


def test_a_full_turn_comes_back() -> None:
    """3 degrees a second to the right: after 30 s north has become east; after 120 s the target is where it was."""
    turn = CoordinatedTurn(rate_deg_s=3.0)
    quarter, _ = matrices(turn, 30.0, 3)
    north = np.array([0, 0, 0, 0, 200.0, 5.0])
    radius = 200.0 / np.radians(3.0)
    assert quarter @ north == pytest.approx([radius, radius, 150.0, 200.0, 0.0, 5.0], abs=1e-6)
    full, _ = matrices(turn, 120.0, 3)
    assert full @ north == pytest.approx([0, 0, 600.0, 0, 200.0, 5.0], abs=1e-6)


def test_models_that_make_no_sense_are_refused() -> None:
    for model in (ConstantVelocity(noise=-1.0), Singer(time_constant_s=0.0), ConstantAcceleration(noise=float("nan"))):
        with pytest.raises(SettingsError, match="makes no sense"):
            table([model])
    with pytest.raises(SettingsError, match="empty"):
        table([])
