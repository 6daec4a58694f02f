"""A target that is not trusted counts as little for the variance components as for the errors."""

from __future__ import annotations

import numpy as np

from boresight.registration import mixed

BLOCKS, ROWS, TERMS = 4, 12, 2
SD = {"noise": (2.0, 3.0), "short": 1.0, "long": 0.7, "target": 1.5}


def products(rng: np.random.Generator, targets: int, spoilt: int) -> mixed.Products:
    """Targets of 2 long blocks of 2 short blocks, one effect a level; the first `spoilt` are wrong by 40 sd."""
    width = 3 + TERMS + 1
    channel = np.zeros((2, targets * BLOCKS, width, width))
    for g in range(targets):
        own = rng.normal() * SD["target"] + (60.0 if g < spoilt else 0.0)
        long = rng.normal(size=2) * SD["long"]
        for b in range(BLOCKS):
            effect = own + long[b // 2] + rng.normal() * SD["short"]
            for k, sd in enumerate(SD["noise"]):
                z = np.full(ROWS, 1.0 if k == 0 else 0.5)
                x = rng.normal(size=(ROWS, TERMS))
                r = x @ np.array([5.0, -3.0]) + z * effect + sd * rng.normal(size=ROWS)
                m = np.column_stack([z, z, z, x, r])
                channel[k, g * BLOCKS + b] = m.T @ m
    trust = np.where(np.arange(targets) < spoilt, 1e-9, 1.0)
    one = np.zeros(1, np.int64)
    blocks = np.arange(targets * BLOCKS)
    levels = (
        mixed.Level(one, blocks),
        mixed.Level(one, blocks[::2]),
        mixed.Level(one, np.arange(0, 2 * targets, 2)),
    )
    return mixed.Products(channel, np.full(2, trust.sum() * BLOCKS * ROWS), levels, TERMS, trust)


def without(found: mixed.Products, spoilt: int) -> mixed.Products:
    """The same without the first targets."""
    cut = spoilt * np.array([BLOCKS, BLOCKS, 2])
    return mixed.Products(
        found.channel[:, spoilt * BLOCKS :],
        found.plots,
        tuple(mixed.Level(level.group, level.first[n:] - n0) for level, n, n0 in zip(
            found.levels, spoilt * np.array([4, 2, 1]), cut, strict=True
        )),
        TERMS,
        found.trust[spoilt:],
    )  # fmt: skip


def estimate(found: mixed.Products) -> np.ndarray:
    typical = mixed.Variances(np.full(2, 4.0), (np.ones(1),) * 3)
    out = mixed.estimate(found, typical, np.ones(TERMS), np.zeros(TERMS), typical, steps=200, tolerance=1e-6)
    return np.sqrt(np.concatenate([out.noise, *out.effects]))


def test_components_are_those_of_the_trusted_targets() -> None:
    found = products(np.random.default_rng(1), 60, 8)
    np.testing.assert_allclose(estimate(found), estimate(without(found, 8)), rtol=1e-5)


def test_components_are_the_true_ones() -> None:
    """Over 60 targets an effect's sd is known to about 1 / sqrt(2 * 60) of itself, the noise's to a hundredth."""
    found = estimate(products(np.random.default_rng(2), 60, 8))
    true = np.array([*SD["noise"], SD["short"], SD["long"], SD["target"]])
    assert np.all(np.abs(found / true - 1) <= 3 * np.array([0.015, 0.015, 0.1, 0.2, 0.12]))
