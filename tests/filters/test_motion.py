"""Motion models against the matrix exponential of the differential equations that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from boresight.errors import SettingsError
from boresight.filters import ConstantAcceleration, ConstantVelocity, CoordinatedTurn, Singer, kalman_filter, matrices
from boresight.filters.motion import table
from boresight.frames import Enu
from boresight.geodesy import E2, SEMI_MAJOR_M, ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef


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


@pytest.mark.parametrize("away", [(0.0, 0.0), (5e5, 0.0), (-3e5, 4e5)])
def test_turns_are_level_where_the_target_is(away: tuple[float, float]) -> None:
    """A level turn, integrated on the ellipsoid: heading and position in latitude and longitude, 500 km from the anchor too.

    One and a half turns of the filter's own prediction, step by step.  It differs by v^2 t^2 / 2 R upwards, because no motion
    model follows the Earth's curve (0.008 m/s^2), and by next to nothing else; about the anchor's own vertical the target
    would climb and sink by hundreds of metres there.
    """
    rate, speed, height, dt, steps = np.radians(3.0), 230.0, 10_000.0, 1.0, 180
    anchor = Enu(ecef_from_geodetic(0.8, 0.2, 0.0), enu_from_ecef(0.8, 0.2))
    below = anchor.to_ecef(np.array([[*away, 0.0]]))[0]
    latitude, longitude, _ = geodetic_from_ecef(below[0])

    def flown(_: float, s: np.ndarray) -> list[float]:
        lat, _, heading = s
        w = np.sqrt(1 - E2 * np.sin(lat) ** 2)
        north, east = speed * np.cos(heading), speed * np.sin(heading)
        normal = SEMI_MAJOR_M / w + height
        # Along a straight course the heading turns with the meridians.
        return [
            north / (SEMI_MAJOR_M * (1 - E2) / w**3 + height),
            east / (normal * np.cos(lat)),
            rate + east * np.tan(lat) / normal,
        ]

    time_s = np.arange(steps + 1) * dt
    lat, lon, heading = solve_ivp(
        flown, (0, time_s[-1]), [float(latitude), float(longitude), 0.3], t_eval=time_s, rtol=1e-11, atol=1e-13
    ).y
    truth = anchor.from_ecef(ecef_from_geodetic(lat, lon, np.full(steps + 1, height)))[0]
    axes = enu_from_ecef(lat[0], lon[0])
    velocity = anchor.rotation @ (speed * np.array([np.sin(heading[0]), np.cos(heading[0]), 0.0]) @ axes)
    start = (np.concatenate([truth[0], velocity])[None], np.eye(6)[None])
    # No measurement is taken in: the filter's own prediction.
    z = np.full((1, steps + 1, 3), np.nan)
    r = np.broadcast_to(np.eye(3), (1, steps + 1, 3, 3))
    model = CoordinatedTurn(rate_deg_s=3.0)
    found = kalman_filter(z, r, time_s, model, start).mean[0, :, :3]
    up = anchor.rotation @ axes[2]
    lifted = truth + (speed * time_s)[:, None] ** 2 / (2 * 6371e3) * up
    assert np.linalg.norm(found - lifted, axis=1).max() < 2.0
    fixed = np.stack([start[0][0] @ matrices(model, t, 3)[0].T for t in time_s])[:, :3]
    if away != (0.0, 0.0):
        assert np.linalg.norm(fixed - truth, axis=1).max() > 300.0
