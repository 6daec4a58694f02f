"""Monte Carlo: the same numbers on one core, on processes and on a cluster; workers that die; what makes no sense."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from boresight.compute import monte_carlo
from boresight.errors import SettingsError, WorkersLost


def walk(rng: np.random.Generator, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Where random walks end, and how far they went."""
    steps = rng.normal(size=(runs, 30))
    return steps.sum(axis=1), np.abs(steps.cumsum(axis=1)).max(axis=1)


class Mortal:
    """Kills its worker the first time that a chunk is run on it: a file remembers."""

    def __init__(self, folder: Path, always: bool = False) -> None:
        self.folder, self.always = folder, always

    def __call__(self, rng: np.random.Generator, runs: int) -> tuple[np.ndarray]:
        draw = rng.normal(size=runs)
        mark = self.folder / f"{draw[0]:.6f}"
        if (self.always or draw[0] > 1.0) and (self.always or not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return (draw,)


def boom(rng: np.random.Generator, runs: int) -> tuple[np.ndarray]:
    raise ValueError("an experiment's own mistake")


def test_processes_give_what_one_core_gives() -> None:
    seen: list[tuple[int, int]] = []
    one = monte_carlo(walk, 2_030, seed=7, chunk=100, progress=lambda done, runs: seen.append((done, runs)))
    assert [len(a) for a in one] == [2030, 2030]
    assert seen[-1] == (2030, 2030)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    many = monte_carlo(walk, 2_030, seed=7, chunk=100, executor="processes", workers=2)
    assert all(np.array_equal(a, b) for a, b in zip(one, many, strict=True))
    assert not np.array_equal(one[0], monte_carlo(walk, 2_030, seed=8, chunk=100)[0])
    # No two chunks draw the same numbers.
    assert len(np.unique(one[0])) == 2030


def test_ten_thousand_runs_on_a_cluster_are_the_same_table() -> None:
    cluster = monte_carlo(walk, 10_000, seed=3, executor="dask", workers=2)
    processes = monte_carlo(walk, 10_000, seed=3, executor="processes", workers=2)
    assert all(np.array_equal(a, b) for a, b in zip(cluster, processes, strict=True))


def test_a_worker_that_dies_costs_only_time(tmp_path: Path) -> None:
    one = np.concatenate([np.random.default_rng([5, k]).normal(size=10) for k in range(8)])
    assert 0 < (one[::10] > 1.0).sum() <= 3
    found = monte_carlo(Mortal(tmp_path), 80, seed=5, chunk=10, executor="processes", workers=1)
    assert np.array_equal(found[0], one)
    assert list(tmp_path.iterdir())


def test_workers_that_always_die_are_told(tmp_path: Path) -> None:
    with pytest.raises(WorkersLost, match="died 4 times"):
        monte_carlo(Mortal(tmp_path, always=True), 20, seed=5, chunk=10, executor="processes", workers=1)


def test_an_experiments_own_mistake_comes_through() -> None:
    for executor in ("serial", "processes"):
        with pytest.raises(ValueError, match="own mistake"):
            monte_carlo(boom, 4, seed=1, chunk=2, executor=executor, workers=1)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"runs": 0}, "runs = 0"),
        ({"chunk": 0}, "chunk = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"executor": "cloud"}, "no executor 'cloud'"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "a scheduler is for the executor dask"),
        ({"executor": "dask", "scheduler": "nowhere"}, "no scheduler answers"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, match: str) -> None:
    with pytest.raises(SettingsError, match=match):
        monte_carlo(walk, **{"runs": 10, "seed": 1, **settings})
