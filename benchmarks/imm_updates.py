"""Updates of three interacting models: straight on, and turns of 3 degrees a second to either side.

    python benchmarks/imm_updates.py [--quick] [--json] [--peers DIR]

1,000 targets 40 to 100 km from a radar (75 m, 0.4 degrees), 200 plots at 2.424 s, that switch between the three motions by a
Markov chain (0.97 to stay).  Everybody filters the same plots with the same models (white acceleration of 1 m^2/s^3, 0.96 to
stay) and the same start: the RMSE of the first 20 targets (plots 20 on) must be the same.  Goal: at least 0.65 of a bare compiled
loop over all cores (`ref_numba_parallel` of the peer scripts), about 3,000,000 updates/s on two cores.
"""

from __future__ import annotations

import time

import numpy as np

import _peers
from boresight.filters import ConstantVelocity, CoordinatedTurn, Imm, imm_filter, matrices, one_point
from boresight.frames import Ecef, Polar, convert

TARGETS, STEPS, DT = 1000, 200, 2.424
SD = np.array([75.0, np.radians(0.4)])
STAY = ((0.96, 0.02, 0.02), (0.02, 0.96, 0.02), (0.02, 0.02, 0.96))
BEGIN = (0.8, 0.1, 0.1)
# To the left is the first turn of the peers' scripts.
MOTIONS = (ConstantVelocity(), CoordinatedTurn(rate_deg_s=-3.0), CoordinatedTurn(rate_deg_s=3.0))
METHOD = Imm(models=MOTIONS, transition=STAY, start=BEGIN)
TIME = np.arange(STEPS) * DT


def scene(seed: int = 7) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True positions (n, K, 2), plots (n, K, 2) and their covariances."""
    rng = np.random.default_rng(seed)
    far, bearing, speed, heading = (
        rng.uniform(a, b, TARGETS) for a, b in ((40e3, 100e3), (0, 2 * np.pi), (100, 250), (0, 2 * np.pi))
    )
    x = np.stack([far * np.sin(bearing), far * np.cos(bearing), speed * np.sin(heading), speed * np.cos(heading)], axis=1)
    motion = np.stack([matrices(m, DT, 2)[0] for m in MOTIONS])
    chance = np.cumsum([[0.97, 0.015, 0.015], [0.03, 0.97, 0.0], [0.03, 0.0, 0.97]], axis=1)
    mode = np.zeros(TARGETS, int)
    truth = np.empty((TARGETS, STEPS, 2))
    for k in range(STEPS):
        truth[:, k] = x[:, :2]
        mode = (rng.random(TARGETS)[:, None] > chance[mode]).sum(axis=1)
        x = np.einsum("nij,nj->ni", motion[mode], x)
    polar = np.stack([np.hypot(truth[..., 0], truth[..., 1]), np.arctan2(truth[..., 0], truth[..., 1])], axis=-1)
    value = (polar + rng.standard_normal((TARGETS, STEPS, 2)) * SD).reshape(-1, 2)
    r = np.broadcast_to(np.diag(SD**2), (len(value), 2, 2))
    z, r = convert(value, r, Polar(np.zeros(3), np.eye(3)), Ecef())
    return truth, z.reshape(TARGETS, STEPS, 2), r.reshape(TARGETS, STEPS, 2, 2)


def main() -> None:
    """Measure ourselves and whoever is there."""
    given = _peers.options(__doc__ or "")
    truth, z, r = scene()
    rounds = 2 if given.quick else 7

    def rmse(position: np.ndarray) -> float:
        return float(np.sqrt(((position[:20, 20:] - truth[: len(position[:20]), 20:]) ** 2).sum(axis=-1).mean()))

    def ours(n: int) -> np.ndarray:
        start = one_point(z[:n, 0], r[:n, 0], 4, 200.0)
        return imm_filter(z[:n], r[:n], TIME, METHOD, start, covariances=False).mean[..., :2]

    # The peers' states: east, velocity, north, velocity.
    order = np.ix_([0, 2, 1, 3], [0, 2, 1, 3])
    pairs = [tuple(a[order] for a in matrices(m, DT, 2)) for m in MOTIONS]
    h = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])

    def begin(i: int) -> tuple[np.ndarray, np.ndarray]:
        x, p = np.array([z[i, 0, 0], 0.0, z[i, 0, 1], 0.0]), np.diag([0.0, 200.0**2, 0.0, 200.0**2])
        p[np.ix_([0, 2], [0, 2])] = r[i, 0]
        return x, p

    def filterpy(n: int) -> _peers.Rate:
        from filterpy.kalman import IMMEstimator, KalmanFilter

        def run(i: int) -> np.ndarray:
            bank = []
            for f, q in pairs:
                kf = KalmanFilter(dim_x=4, dim_z=2)
                kf.x, kf.P = begin(i)
                kf.F, kf.Q, kf.H = f, q, h
                bank.append(kf)
            imm = IMMEstimator(bank, np.array(BEGIN), np.array(STAY))
            out = [z[i, 0]]
            for k in range(1, STEPS):
                for kf in bank:
                    kf.R = r[i, k]
                imm.predict()
                imm.update(z[i, k])
                out.append(np.array(imm.x)[[0, 2]])
            return np.array(out)

        return _peers.rate(lambda: np.stack([run(i) for i in range(n)]), n * (STEPS - 1), 1, rmse)

    def kalbee(n: int) -> _peers.Rate:
        from kalbee import InteractingMultipleModel, KalmanFilter

        def run(i: int) -> np.ndarray:
            x, p = begin(i)
            bank = [KalmanFilter(x[:, None], p, f, q, h, r[i, 0]) for f, q in pairs]
            imm = InteractingMultipleModel(bank, np.array(STAY), np.array(BEGIN))
            out = [z[i, 0]]
            for k in range(1, STEPS):
                for kf in bank:
                    kf.measurement_covariance = r[i, k]
                imm.predict()
                imm.update(z[i, k][:, None])
                out.append(np.array(imm.state)[[0, 2], 0])
            return np.array(out)

        return _peers.rate(lambda: np.stack([run(i) for i in range(n)]), n * (STEPS - 1), 1, rmse)

    clock = time.perf_counter()
    ours(2)
    first = time.perf_counter() - clock
    mine = _peers.rate(lambda: ours(TARGETS), TARGETS * (STEPS - 1), rounds, rmse)
    few = 4 if given.quick else 20
    others = _peers.peers({"kalbee": lambda: kalbee(few), "FilterPy": lambda: filterpy(few)})
    others["Stone Soup"] = "absent (it has no interacting models for Gaussian states)"
    others |= _peers.script_peers(given.peers, "bench_b_imm", ("ref_numba", "ref_numba_parallel"), "updates", "rmse20_m")
    _peers.tell("imm_updates", "updates/s", mine, others, first, given.json, f"{TARGETS:,} targets, {STEPS} plots, three models")


if __name__ == "__main__":
    main()
