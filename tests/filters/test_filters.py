"""Kalman filter and interacting models against the textbook's equations, and their covariances against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from filter_reference import imm as imm_reference
from filter_reference import kalman as kalman_reference
from hypothesis import example, given, settings
from hypothesis import strategies as st

from boresight.errors import SettingsError
from boresight.filters import (
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    ExpectedMode,
    Imm,
    Singer,
    imm_filter,
    kalman_filter,
    matrices,
    one_point,
    range_rate_start,
    two_point,
)
from boresight.filters.motion import size


def _scene(axes: int, seed: int, n: int = 3, steps: int = 40):
    """Positions with correlated errors, irregular times with repeats, some missing."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.choice([0.0, 0.5, 2.424, 4.0, 11.0], steps))
    root = rng.normal(size=(n, steps, axes, axes)) * 40
    r = root @ np.swapaxes(root, 2, 3) + 100 * np.eye(axes)
    velocity = rng.normal(size=(n, 1, axes)) * 100
    z = rng.normal(size=(n, 1, axes)) * 3e4 + velocity * time_s[:, None] + rng.normal(size=(n, steps, axes)) * 60
    z[:, 5] = np.nan
    z[0, 17:20] = np.nan
    return z, r, time_s


MODELS = (
    ConstantVelocity(noise=2.0), CoordinatedTurn(rate_deg_s=-2.5), ConstantAcceleration(noise=0.05), Singer(sd_mps2=3.0),
)  # fmt: skip


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_kalman_filter_is_the_textbooks(model, axes: int) -> None:
    if axes == 3 and isinstance(model, CoordinatedTurn):
        model = CoordinatedTurn(rate_deg_s=0.0)  # a turn about the vertical where the target is has a test of its own
    z, r, time_s = _scene(axes, 1)
    d = size([model], axes)
    start = one_point(z[:, 0], r[:, 0], d, 200.0)
    found = kalman_filter(z, r, time_s, model, start)
    for row in range(len(z)):
        mean, spread, nis = kalman_reference(
            z[row], r[row], time_s, lambda dt: matrices(model, dt, axes), start[0][row], start[1][row]
        )
        assert found.mean[row] == pytest.approx(mean, rel=1e-9, abs=1e-6)
        assert found.covariance[row] == pytest.approx(spread, rel=1e-7, abs=1e-7)
        assert found.nis[row] == pytest.approx(nis, rel=1e-7, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("axes", [2, 3])
def test_interacting_models_are_the_textbooks(axes: int) -> None:
    z, r, time_s = _scene(axes, 2)
    turns = (-3.0, 0.0, 3.0) if axes == 2 else (0.0,)
    models = (ConstantVelocity(noise=0.5), *(CoordinatedTurn(rate_deg_s=w, noise=2.0) for w in turns))
    count = len(models)
    method = Imm(models=models, stay=0.9, stay_s=4.0)
    start = one_point(z[:, 0], r[:, 0], 2 * axes, 200.0)
    found = imm_filter(z, r, time_s, method, start)

    def change(dt: float) -> np.ndarray:
        even = 1 / count
        keep = even + (1 - even) * ((0.9 - even) / (1 - even)) ** (dt / 4.0)
        return np.where(np.eye(count) > 0, keep, (1 - keep) / (count - 1))

    for row in range(len(z)):
        mean, spread, chance = imm_reference(
            z[row], r[row], time_s, [lambda dt, m=m: matrices(m, dt, axes) for m in models], change,
            start[0][row], start[1][row], [1 / count] * count,
        )  # fmt: skip
        assert found.mean[row] == pytest.approx(mean, rel=1e-9, abs=1e-6)
        assert found.covariance[row] == pytest.approx(spread, rel=1e-7, abs=1e-6)
        assert found.probability[row] == pytest.approx(chance, abs=1e-9)


def test_one_model_alone_is_the_kalman_filter() -> None:
    z, r, time_s = _scene(3, 3)
    start = one_point(z[:, 0], r[:, 0], 6, 200.0)
    alone = imm_filter(z, r, time_s, Imm(models=(ConstantVelocity(),)), start)
    plain = kalman_filter(z, r, time_s, ConstantVelocity(), start)
    assert alone.mean == pytest.approx(plain.mean, rel=1e-12)
    assert alone.likelihood == pytest.approx(plain.likelihood, rel=1e-9, nan_ok=True)


def test_covariance_and_likelihood_are_what_happens() -> None:
    """2,000 targets that move as the model says, two-point start: NEES is d, NIS is k, both to their sampling errors."""
    rng = np.random.default_rng(4)
    n, steps, axes = 2000, 30, 3
    model = ConstantVelocity(noise=4.0, noise_up=0.5)
    f, q = matrices(model, 4.0, axes)
    truth = np.empty((n, steps, 6))
    truth[:, 0] = rng.normal(size=(n, 6)) * [2e4, 2e4, 1e3, 150, 150, 5]
    for k in range(1, steps):
        truth[:, k] = truth[:, k - 1] @ f.T + rng.multivariate_normal(np.zeros(6), q, n, method="cholesky")
    sd = np.array([80.0, 120.0, 60.0])
    z = truth[..., :3] + rng.normal(size=(n, steps, 3)) * sd
    r = np.broadcast_to(np.diag(sd**2), (n, steps, 3, 3))
    time_s = np.arange(steps) * 4.0
    x, p = two_point(z[:, :2], r[:, :2], time_s[:2], 6)
    p[:, 3:, 3:] += q[3:, 3:] * 4.0 / 3.0 / 4.0  # the velocity wanders between the two: q dt / 3 of the mean velocity
    found = kalman_filter(z, r, time_s, model, (x, p), first=1)
    error = found.mean[:, -1] - truth[:, -1]
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(found.covariance[:, -1], error[:, :, None])[:, :, 0])
    assert nees.mean() == pytest.approx(6.0, abs=4 * np.sqrt(12 / n))
    late = found.nis[:, 10:]
    assert late.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / late.size))
    assert np.isnan(found.mean[:, 0]).all()


def test_range_rate_is_known_along_the_line_of_sight_only() -> None:
    site = np.array([0.0, 0.0, 0.0])
    z = np.array([[3e4, 4e4, 0.0]])
    x, p = range_rate_start(z, np.eye(3)[None] * 100, 6, site, np.array([-150.0]), 2.0, 200.0)
    sight = z[0] / 5e4
    assert x[0, 3:] == pytest.approx(-150 * sight)
    assert sight @ p[0, 3:, 3:] @ sight == pytest.approx(4.0)
    across = np.array([sight[1], -sight[0], 0])
    assert across @ p[0, 3:, 3:] @ across == pytest.approx(200.0**2)


@settings(max_examples=40)
@given(
    gaps=st.lists(st.sampled_from([0.0, 1e-6, 0.1, 4.0, 60.0, 7200.0, 36000.0]), min_size=3, max_size=12),
    sd=st.tuples(st.floats(0.01, 1e4), st.floats(0.01, 1e4), st.floats(0.01, 1e4)),
    jump=st.floats(0.0, 1e6),
    axes=st.sampled_from([2, 3]),
    which=st.integers(0, 5),
)
@example(gaps=[0.1, 0.1, 0.0, 0.0], sd=(1.0, 2.0, 1.0), jump=1066.0, axes=3, which=5)
@example(gaps=[0.1, 0.1, 0.0, 0.0], sd=(1.0, 2.0, 1.0), jump=1044.0, axes=2, which=5)
def test_covariances_stay_symmetric_positive_definite(gaps, sd, jump, axes, which) -> None:
    """Equal times, gaps of hours, absurd measurements of absurd accuracy: symmetric to the bit, no negative variance anywhere."""
    time_s = np.cumsum([0.0, *gaps])
    steps = len(time_s)
    z = np.zeros((1, steps, axes))
    z[0, steps // 2] = jump
    z[0, -2] = np.nan
    r = np.broadcast_to(np.diag(np.array(sd[:axes]) ** 2), (1, steps, axes, axes))
    methods = (*MODELS, Imm(models=(ConstantVelocity(), CoordinatedTurn(rate_deg_s=3.0))), ExpectedMode())
    method = methods[which]
    d = size([method], axes) if which < 4 else 2 * axes
    start = one_point(z[:, 0], r[:, 0], d, 300.0)
    found = (kalman_filter if which < 4 else imm_filter)(z, r, time_s, method, start)
    assert np.isfinite(found.mean).all()
    spread = found.covariance[0]
    assert np.array_equal(spread, np.swapaxes(spread, 1, 2))
    scale = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    assert (scale > 0).all()
    assert np.linalg.eigvalsh(spread / scale[:, :, None] / scale[:, None, :]).min() > -1e-7


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda a: a.update(time_s=a["time_s"][::-1]), "time goes backwards at measurement"),
        (lambda a: a["time_s"].__setitem__(3, np.nan), "a time is not a number"),
        (lambda a: a["r"].__setitem__((1, 4), np.zeros((2, 2))), "measurement 4 of target 1 is not symmetric with positive"),
        (lambda a: a["r"].__setitem__((1, 4, 0, 1), 1e3), "measurement 4 of target 1 is not symmetric"),
        (
            lambda a: a["r"].__setitem__((1, 4), [[1.0, 2.0], [2.0, 1.0]]),
            "measurement 4 of target 1 holds a correlation beyond 1",
        ),
        (lambda a: a.update(z=a["z"][:, :, :1]), "do not fit"),
    ],
)
def test_measurements_that_make_no_sense_are_refused(change, match: str) -> None:
    z, r, time_s = _scene(2, 5)
    arguments = {"z": z, "r": r, "time_s": time_s + np.arange(len(time_s))}
    start = one_point(z[:, 0], r[:, 0], 4, 200.0)
    change(arguments)
    with pytest.raises(SettingsError, match=match):
        kalman_filter(**arguments, motion=ConstantVelocity(), start=start)
    with pytest.raises(SettingsError, match=match):
        imm_filter(**arguments, method=Imm(models=(ConstantVelocity(), CoordinatedTurn(rate_deg_s=1.0))), start=start)


def test_a_measurement_whose_correlations_contradict_each_other_is_refused() -> None:
    z, time_s = np.zeros((2, 4, 3)), np.arange(4.0)
    r = np.broadcast_to(np.eye(3), (2, 4, 3, 3)).copy()
    r[1, 2] = [[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]]
    start = one_point(z[:, 0], r[:, 0], 6, 100.0)
    with pytest.raises(SettingsError, match="measurement 2 of target 1 is not positive semidefinite"):
        kalman_filter(z, r, time_s, ConstantVelocity(), start)
    # What is not measured needs no covariance.
    z[1, 2] = np.nan
    assert np.isfinite(kalman_filter(z, r, time_s, ConstantVelocity(), start).mean).all()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda x, p: x.__setitem__((2, 1), np.nan), "start of target 2 is not a number"),
        (lambda x, p: p.__setitem__((2, 3, 3), -1.0), "start of target 2 has a covariance that is not symmetric with variances"),
        (
            lambda x, p: p.__setitem__((2, 3, 3), np.inf),
            "start of target 2 has a covariance that is not symmetric with variances",
        ),
        (lambda x, p: p.__setitem__((2, 0, 2), 1.0), "start of target 2 has a covariance that is not symmetric"),
        (lambda x, p: p.__setitem__((2, [0, 2], [2, 0]), 1e6), "start of target 2 has a covariance that holds a correlation"),
        (lambda x, p: p.__setitem__(2, np.full((4, 4), -0.9) + 1.9 * np.eye(4)), "start of target 2 has .* not positive semidef"),
    ],
)
def test_starts_that_make_no_sense_are_refused(change, match: str) -> None:
    z, r, time_s = _scene(2, 5)
    x, p = one_point(z[:, 0], r[:, 0], 4, 200.0)
    # Exactly known coordinates, and rounding, are a start like others.
    p[0, 3, 3], p[1, 0, 1], p[1, 1, 0] = 0.0, *2 * [np.sqrt(p[1, 0, 0] * p[1, 1, 1])]
    kalman_filter(z, r, time_s, ConstantVelocity(), (x, p))
    change(x, p)
    with pytest.raises(SettingsError, match=match):
        kalman_filter(z, r, time_s, ConstantVelocity(), (x, p))
    with pytest.raises(SettingsError, match=match):
        imm_filter(z, r, time_s, Imm(models=(ConstantVelocity(), CoordinatedTurn(rate_deg_s=1.0))), (x, p))
