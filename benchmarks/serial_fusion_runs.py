"""Monte Carlo runs of two radars fused in one filter: draw the noise, convert 240 plots, filter them.

    python benchmarks/serial_fusion_runs.py [--quick] [--json] [--peers DIR]

Two radars at one place (75 m, 0.4 degrees) see a target every 1.212 s in turn, 120 scans of 2.424 s, from (63, 63) km at
(-100, -100) m/s; constant velocity with white acceleration of 0.1 m^2/s^3, plots converted by the linear rule, start at the first
plot with 200 m/s.  Everybody filters the same plots: the RMSE of the first four runs (plots 60 on) must be the same.  Goal: at
least twice the rate of dynamax, about 20,000 runs/s on two cores.
"""

from __future__ import annotations

import time

import numpy as np

import _peers
from boresight._parallel import in_threads
from boresight.filters import ConstantVelocity, kalman_filter, one_point
from boresight.frames import Ecef, Polar, convert

SCANS, SCAN_S = 120, 2.424
CHUNK = 250
STEPS, DT = 2 * SCANS, SCAN_S / 2
SD = np.array([75.0, np.radians(0.4)])
NOISE, SPEED_SD = 0.1, 200.0
TIME = np.arange(STEPS) * DT
TRUTH = np.array([63e3, 63e3]) + TIME[:, None] * [-100.0, -100.0]
POLAR = np.stack([np.hypot(*TRUTH.T), np.arctan2(*TRUTH.T)], axis=1)
RADAR = Polar(np.zeros(3), np.eye(3))


def plots(runs: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, K, 2) and their covariances of so many runs: noise drawn, converted by the product."""
    value = POLAR + SD * np.random.default_rng(seed).standard_normal((runs, STEPS, 2))
    rows = runs * STEPS
    z, r = convert(value.reshape(rows, 2), np.broadcast_to(np.diag(SD**2), (rows, 2, 2)), RADAR, Ecef())
    return z.reshape(runs, STEPS, 2), r.reshape(runs, STEPS, 2, 2)


def filtered(z: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Positions (n, K, 2) by our filter."""
    start = one_point(z[:, 0], r[:, 0], 4, SPEED_SD)
    return kalman_filter(z, r, TIME, ConstantVelocity(noise=NOISE), start, covariances=False).mean[..., :2]


def chunked(runs: int) -> np.ndarray:
    """The same in chunks of runs, each with its own seed, as Monte Carlo studies are: what a chunk needs stays in the cache."""
    return np.concatenate(in_threads(lambda seed: filtered(*plots(CHUNK, seed)), range(1, runs // CHUNK + 1)))


def rmse(position: np.ndarray) -> float:
    """Of the first four runs, plots 60 on; positions (n, K, 2)."""
    return float(np.sqrt(((position[:4, 60:] - TRUTH[60:]) ** 2).sum(axis=-1).mean()))


# ------------------------------------------------------------------------------- the peers, state east, velocity, north, velocity
def _matrices() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    one = np.array([[1, DT], [0, 1]])
    q = NOISE * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    return np.kron(np.eye(2), one), np.kron(np.eye(2), q), np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])


def _start(z: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, p = np.array([z[0], 0.0, z[1], 0.0]), np.diag([0.0, SPEED_SD**2, 0.0, SPEED_SD**2])
    p[np.ix_([0, 2], [0, 2])] = r
    return x, p


def dynamax(runs: int, rounds: int) -> _peers.Rate:
    """lgssm_filter, compiled over all runs, double precision."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from dynamax.linear_gaussian_ssm.inference import (
        ParamsLGSSM,
        ParamsLGSSMDynamics,
        ParamsLGSSMEmissions,
        ParamsLGSSMInitial,
        lgssm_filter,
    )

    f, q, h = (jnp.asarray(a) for a in _matrices())
    place = jnp.array([0, 2])

    def one(z, r):
        x = jnp.zeros(4).at[place].set(z[0])
        p = jnp.diag(jnp.array([0.0, SPEED_SD**2, 0.0, SPEED_SD**2])).at[jnp.ix_(place, place)].set(r[0])
        model = ParamsLGSSM(
            ParamsLGSSMInitial(f @ x, f @ p @ f.T + q),
            ParamsLGSSMDynamics(f, jnp.zeros(4), jnp.zeros((4, 0)), q),
            ParamsLGSSMEmissions(h, jnp.zeros(2), jnp.zeros((2, 0)), r[1:]),
        )
        return jnp.concatenate([x[None], lgssm_filter(model, z[1:]).filtered_means])

    all_runs = jax.jit(jax.vmap(one))

    def work() -> np.ndarray:
        z, r = plots(runs)
        return np.asarray(all_runs(jnp.asarray(z), jnp.asarray(r)))[..., [0, 2]]

    return _peers.rate(work, runs, rounds, rmse)


def _one_by_one(run, runs: int, rounds: int) -> _peers.Rate:
    def work() -> np.ndarray:
        return np.stack([run(z, r) for z, r in zip(*plots(runs), strict=True)])

    return _peers.rate(work, runs, rounds, rmse)


def filterpy(runs: int, rounds: int) -> _peers.Rate:
    """KalmanFilter, an R for each update."""
    from filterpy.kalman import KalmanFilter

    f, q, h = _matrices()

    def run(z, r):
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.x, kf.P = _start(z[0], r[0])
        kf.F, kf.Q, kf.H = f, q, h
        out = [z[0]]
        for k in range(1, STEPS):
            kf.predict()
            kf.update(z[k], R=r[k])
            out.append(kf.x[[0, 2]])
        return np.array(out)

    return _one_by_one(run, runs, rounds)


def kalbee(runs: int, rounds: int) -> _peers.Rate:
    """VectorizedKalmanFilter over all runs."""
    from kalbee import VectorizedKalmanFilter

    f, q, h = _matrices()

    def work() -> np.ndarray:
        z, r = plots(runs)
        both = [_start(a, b) for a, b in zip(z[:, 0], r[:, 0], strict=True)]
        kf = VectorizedKalmanFilter(np.stack([b[0] for b in both])[..., None], np.stack([b[1] for b in both]), f, q, h, r[:, 0])
        out = [z[:, 0]]
        for k in range(1, STEPS):
            kf.predict()
            kf.measurement_covariance = r[:, k]
            kf.update(z[:, k][..., None])
            out.append(np.array(kf.state[:, [0, 2], 0]))
        return np.stack(out, axis=1)

    return _peers.rate(work, runs, rounds, rmse)


def stone_soup(runs: int, rounds: int) -> _peers.Rate:
    """KalmanPredictor and KalmanUpdater, a measurement model for each plot."""
    from datetime import datetime, timedelta

    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel
    from stonesoup.models.transition.linear import ConstantVelocity as Velocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([Velocity(NOISE), Velocity(NOISE)]))
    updater = KalmanUpdater(None)
    stamps = [datetime(2026, 1, 1) + timedelta(seconds=float(t)) for t in TIME]

    def run(z, r):
        state = GaussianState(*_start(z[0], r[0]), timestamp=stamps[0])
        out = [z[0]]
        for k in range(1, STEPS):
            plot = Detection(z[k], timestamp=stamps[k], measurement_model=LinearGaussian(4, (0, 2), r[k]))
            state = updater.update(SingleHypothesis(predictor.predict(state, timestamp=stamps[k]), plot))
            out.append(np.asarray(state.state_vector, float)[[0, 2], 0])
        return np.array(out)

    return _one_by_one(run, runs, rounds)


def main() -> None:
    """Measure ourselves and whoever is there."""
    given = _peers.options(__doc__ or "")
    runs, rounds = (1000, 2) if given.quick else (5000, 5)
    begin = time.perf_counter()
    filtered(*plots(4))
    first = time.perf_counter() - begin
    ours = _peers.rate(lambda: chunked(runs), runs, rounds, rmse)
    few = 4 if given.quick else 12
    others = _peers.peers(
        {
            "dynamax": lambda: dynamax(1000 if given.quick else 2000, rounds),
            "kalbee": lambda: kalbee(500 if given.quick else 2000, 2),
            "FilterPy": lambda: filterpy(few, 2),
            "Stone Soup": lambda: stone_soup(4, 1),
        }
    )
    others |= _peers.script_peers(given.peers, "bench_a_serial_fusion", ("ref_numba", "ref_numba_parallel"), "mc_runs", "rmse4_m")
    note = f"{runs:,} runs of {STEPS} plots: noise, conversion and filter"
    _peers.tell("serial_fusion_runs", "runs/s", ours, others, first, given.json, note)


if __name__ == "__main__":
    main()
