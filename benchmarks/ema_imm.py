"""Expected-mode augmentation against interacting models and one Kalman filter, on airliners and on serpentine boats.

    python benchmarks/ema_imm.py [--quick] [--figure FILE.svg]

Airliners fly straight, turn at a rate drawn between 0.7 and 3.2 degrees a second for 30 to 90 s, and fly on (radar 50 m, 0.08
degrees, 4 s).  Boats sail a serpentine with up to 6 degrees a second (radar 4 m, 0.25 degrees, 2.5 s).  All get the same plots.
Seed 1 was for tuning; the table is of others.  RMSE and NEES (4 is ideal) are of position and of the whole state; a
manoeuvre is where the target turns by more than 0.2 degrees a second; the peak is the mean over targets of the largest error.
"""

from __future__ import annotations

import argparse

import numpy as np

from boresight.filters import (
    ConstantVelocity,
    CoordinatedTurn,
    ExpectedMode,
    Filtered,
    Imm,
    Mixed,
    imm_filter,
    kalman_filter,
    one_point,
)
from boresight.frames import Ecef, Polar, convert

RADAR = Polar(np.zeros(3), np.eye(3))
Scene = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _flown(rate: np.ndarray, speed: np.ndarray, start: np.ndarray, heading: np.ndarray, dt: float) -> np.ndarray:
    """States (n, K, 4) of targets with turn rates (n, K), rad/s, constant from one time to the next."""
    turned = heading[:, None] + np.concatenate([np.zeros((len(rate), 1)), np.cumsum(rate[:, :-1], axis=1) * dt], axis=1)
    velocity = speed[:, None, None] * np.stack([np.sin(turned), np.cos(turned)], axis=-1)
    half = rate[:, :-1] * dt / 2
    chord = np.sinc(half / np.pi)[..., None] * dt * speed[:, None, None]
    step = chord * np.stack([np.sin(turned[:, :-1] + half), np.cos(turned[:, :-1] + half)], axis=-1)
    position = start[:, None] + np.concatenate([np.zeros((len(rate), 1, 2)), np.cumsum(step, axis=1)], axis=1)
    return np.concatenate([position, velocity], axis=2)


def scene(kind: str, n: int, seed: int) -> Scene:
    """True states (n, K, 4), turn rates (n, K), plots (n, K, 2), covariances and times (K,)."""
    rng = np.random.default_rng(seed)
    airliners = kind == "airliners"
    steps, dt = (120, 4.0) if airliners else (160, 2.5)
    time_s = np.arange(steps) * dt
    rate = np.zeros((n, steps))
    if airliners:
        for row in range(n):
            at = rng.uniform(60, 120)
            while at < time_s[-1]:
                length, turn = rng.uniform(30, 90), np.radians(rng.uniform(0.7, 3.2)) * rng.choice([-1, 1])
                rate[row, (time_s >= at) & (time_s < at + length)] = turn
                at += length + rng.uniform(60, 150)
        far, speed, sd = rng.uniform(4e4, 1e5, n), rng.uniform(120, 250, n), np.array([50.0, np.radians(0.08)])
    else:
        period, peak = rng.uniform(60, 140, n), np.radians(rng.uniform(2, 6, n))
        rate = peak[:, None] * np.sin(2 * np.pi * time_s / period[:, None])
        far, speed, sd = rng.uniform(1500, 6000, n), rng.uniform(6, 16, n), np.array([4.0, np.radians(0.25)])
    bearing, heading = rng.uniform(0, 2 * np.pi, (2, n))
    truth = _flown(rate, speed, far[:, None] * np.stack([np.sin(bearing), np.cos(bearing)], axis=1), heading, dt)
    polar = np.stack([np.hypot(truth[..., 0], truth[..., 1]), np.arctan2(truth[..., 0], truth[..., 1])], axis=-1)
    value = (polar + rng.standard_normal((n, steps, 2)) * sd).reshape(-1, 2)
    z, r = convert(value, np.broadcast_to(np.diag(sd**2), (len(value), 2, 2)), RADAR, Ecef())
    return truth, rate, z.reshape(n, steps, 2), r.reshape(n, steps, 2, 2), time_s


def methods(kind: str) -> dict[str, ConstantVelocity | Imm | ExpectedMode]:
    """The filters that are compared: noise as it suits each on the tuning seeds."""
    fan = ExpectedMode().rates_deg_s
    noise, straight, side = (0.5, 20.0, 3.0) if kind == "airliners" else (0.01, 0.3, 4.5)

    def turns(rates: tuple[float, ...]) -> Imm:
        return Imm(models=tuple(CoordinatedTurn(rate_deg_s=w, noise=noise) for w in rates), stay=0.9)

    return {
        "Kalman filter": ConstantVelocity(noise=straight),
        "IMM, 3 models": turns((-side, 0.0, side)),
        "IMM, all 9 rates": turns(fan),
        "group of 7, no expected mode": ExpectedMode(noise=noise, expected=False),
        "EMA-IMM, group of 5": ExpectedMode(noise=noise, group=5),
        "EMA-IMM (group of 7)": ExpectedMode(noise=noise),
        "EMA-IMM, all 9 rates": ExpectedMode(noise=noise, group=9),
    }


def run(method: ConstantVelocity | Imm | ExpectedMode, made: Scene, speed_sd: float) -> Filtered | Mixed:
    """The filter over the plots, started at the first."""
    _, _, z, r, time_s = made
    start = one_point(z[:, 0], r[:, 0], 4, speed_sd)
    if isinstance(method, ConstantVelocity):
        return kalman_filter(z, r, time_s, method, start)
    return imm_filter(z, r, time_s, method, start)


def score(found: Filtered | Mixed, made: Scene) -> np.ndarray:
    """RMSE of position in all, in manoeuvres, straight on; velocity; peak; NEES in all, in manoeuvres."""
    truth, rate, *_ = made
    off = found.mean - truth
    late = np.zeros(rate.shape, bool)
    late[:, 10:] = True
    turning = late & (np.abs(rate) > np.radians(0.2))
    square = (off[..., :2] ** 2).sum(axis=-1)
    speed = (off[..., 2:] ** 2).sum(axis=-1)
    nees = np.einsum("nki,nki->nk", off, np.linalg.solve(found.covariance, off[..., None])[..., 0])
    peak = np.sqrt(np.where(late, square, 0).max(axis=1)).mean()
    rms = [np.sqrt(square[m].mean()) if m.any() else np.nan for m in (late, turning, late & ~turning)]
    return np.array([*rms, np.sqrt(speed[late].mean()), peak, nees[late].mean(), nees[turning].mean()])


def figure(path: str) -> None:
    """One airliner's errors and models' probabilities, drawn over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    made = scene("airliners", 200, 11)
    truth, rate, _, _, time_s = made
    ema = run(ExpectedMode(), made, 300.0)
    assert isinstance(ema, Mixed)
    one = int(np.argmax(np.abs(rate).sum(axis=1)))
    fig, (top, middle, low) = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
    for name, method in methods("airliners").items():
        if name in ("Kalman filter", "IMM, all 9 rates", "EMA-IMM (group of 7)"):
            off = run(method, made, 300.0).mean[one, :, :2] - truth[one, :, :2]
            top.plot(time_s, np.hypot(*off.T), label=name, lw=1.2)
    top.set_ylabel("position error, m")
    top.legend(fontsize=8, ncols=3)
    middle.plot(time_s, np.degrees(rate[one]), "k", lw=1, label="true")
    middle.plot(time_s, np.degrees(ema.rate_rad_s[one]), lw=1.2, label="EMA-IMM")
    middle.set_ylabel("turn rate, deg/s")
    middle.legend(fontsize=8, ncols=2)
    slots = ema.probability.shape[2]
    for m in range(slots):
        name = "expected mode" if m == slots - 1 else f"place {m + 1} of the group"
        low.plot(time_s, ema.probability[one, :, m], lw=1, label=name, color="k" if m == slots - 1 else None)
    low.set_ylabel("probability")
    low.set_xlabel("time, s")
    low.legend(fontsize=7, ncols=3)
    matplotlib.rcParams["svg.hashsalt"] = "boresight"
    fig.savefig(path, metadata={"Date": None} if path.endswith(".svg") else None)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer targets and seeds")
    parser.add_argument("--figure", help="draw one airliner's errors, rate and probabilities to this file")
    given = parser.parse_args()
    n, seeds = (60, (11,)) if given.quick else (300, (11, 12, 13))
    for kind, speed_sd in (("airliners", 300.0), ("boats", 20.0)):
        made = [scene(kind, n, seed) for seed in seeds]
        print(f"{kind}: {n * len(seeds)} targets, seeds {', '.join(map(str, seeds))}\n")
        print("| filter | RMSE m | in manoeuvres | straight | velocity m/s | peak m | NEES | in manoeuvres |")
        print("|---|---|---|---|---|---|---|---|")
        for name, method in methods(kind).items():
            row = np.mean([score(run(method, m, speed_sd), m) for m in made], axis=0)
            print(f"| {name} | " + " | ".join(f"{v:.1f}" for v in row) + " |")
        print()
    if given.figure:
        figure(given.figure)


if __name__ == "__main__":
    main()
