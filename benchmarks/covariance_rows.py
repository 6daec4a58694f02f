"""Covariances from a radar's range, azimuth, elevation to Earth-centred axes by the linear rule, through the public `convert`.

    python benchmarks/covariance_rows.py [--quick] [--json]

Beside it the same rule in plain NumPy, whole arrays at a time.  Goal: 20,000,000 plots/s on two quiet cores; on a busy machine
the rate by the processor's clock, times the cores, tells what they would do.  Accuracy is the largest difference between the two
covariances, in units of their standard deviations.
"""

from __future__ import annotations

import time

import numpy as np

import _peers
from boresight.frames import Ecef, Polar, convert
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef
from boresight.measure import enu_from_polar, enu_jacobian

RADAR = Polar(ecef_from_geodetic(0.8, 0.2, 100.0), enu_from_ecef(0.8, 0.2))


def plain(value: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """R2 = J R1 J' in NumPy."""
    turn = RADAR.rotation.T @ enu_jacobian(value)
    assert (RADAR.site + enu_from_polar(value) @ RADAR.rotation).shape == value.shape
    return turn @ covariance @ np.swapaxes(turn, 1, 2)


def main() -> None:
    """Measure both."""
    given = _peers.options(__doc__ or "")
    n = 200_000 if given.quick else 2_000_000
    rng = np.random.default_rng(1)
    value = np.stack([rng.uniform(1e3, 3e5, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0, 0.7, n)], axis=1)
    covariance = np.zeros((n, 3, 3))
    covariance[:, range(3), range(3)] = np.square([50.0, 1e-3, 2e-3])
    begin = time.perf_counter()
    convert(value[:10], covariance[:10], RADAR, Ecef())
    first = time.perf_counter() - begin
    few = 100_000
    expected = plain(value[:few], covariance[:few])
    sd = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))

    def worst(found: tuple[np.ndarray, np.ndarray]) -> float:
        return float(np.abs((found[1][:few] - expected) / sd[:, :, None] / sd[:, None, :]).max())

    ours = _peers.rate(lambda: convert(value, covariance, RADAR, Ecef()), n, 7, worst)
    numpy = _peers.rate(lambda: plain(value[:few], covariance[:few]), few, 3)
    _peers.tell("covariance_rows", "plots/s", ours, {"NumPy": numpy}, first, given.json, f"{n:,} plots, AER to ECEF")


if __name__ == "__main__":
    main()
