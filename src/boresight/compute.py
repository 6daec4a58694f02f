"""Many runs of one experiment on one core, on all cores, or on a Dask cluster, with the same result to the bit.

Runs are cut into chunks of a fixed size, and each chunk draws from a generator of its own, made of the seed and the chunk's
number.  Neither the number of workers nor the order in which they finish can change anything.  A worker that dies costs only the
time of its chunk, which is run again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, Protocol

import numpy as np

from ._types import AnyArray
from .errors import SettingsError, WorkersLost

ExecutorName = Literal["serial", "processes", "dask"]
Result = tuple[AnyArray, ...]
Progress = Callable[[int, int], None]
_RESTARTS = 3


class Experiment(Protocol):
    """One experiment: `runs` runs at once with one generator, as arrays with a leading axis of runs.

    For other processes it must be a function of a module, or a frozen struct with `__call__`: something that can be pickled.
    """

    def __call__(self, rng: np.random.Generator, runs: int, /) -> Result:
        """Arrays (runs, ...)."""
        ...


def monte_carlo(
    experiment: Experiment,
    runs: int,
    *,
    seed: int,
    chunk: int = 250,
    executor: ExecutorName = "serial",
    workers: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Result:
    """The results of `runs` runs, arrays with a leading axis of runs, in order.

    "serial" runs the chunks one after the other (kernels still use all cores), "processes" on `workers` processes (0: one a
    processor), "dask" on the cluster whose `scheduler` address is given, or on a local one.  `progress(done, runs)` is called
    after each chunk.  The result depends on `seed` and `chunk`, and on nothing else.

    Raises SettingsError for settings that make no sense or a scheduler that cannot be reached, WorkersLost where workers keep
    dying.
    """
    if runs < 1 or chunk < 1 or seed < 0 or workers < 0:
        raise SettingsError(
            f"runs = {runs}, chunk = {chunk}, seed = {seed}, workers = {workers} make no sense",
            where="Monte Carlo",
            remedy="Give at least one run, chunks of at least one, and a seed of 0 or more.",
        )
    if scheduler is not None and executor != "dask":
        raise SettingsError("a scheduler is for the executor dask", where="--scheduler", remedy="Give --executor dask too.")
    sizes = [min(chunk, runs - first) for first in range(0, runs, chunk)]
    done: dict[int, Result] = {}

    def finished(number: int, result: Result) -> None:
        done[number] = result
        if progress is not None:
            progress(sum(sizes[n] for n in done), runs)

    if executor == "serial":
        for number, size in enumerate(sizes):
            finished(number, run_chunk(experiment, seed, number, size))
    elif executor == "processes":
        _on_processes(experiment, seed, sizes, workers, finished)
    elif executor == "dask":
        _on_dask(experiment, seed, sizes, workers, scheduler, finished)
    else:
        raise SettingsError(
            f"there is no executor {executor!r}", where="--executor", remedy="Executors: serial, processes, dask."
        )
    parts = [done[number] for number in range(len(sizes))]
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def run_chunk(experiment: Experiment, seed: int, number: int, runs: int) -> Result:
    """Chunk `number`: the experiment with the chunk's own generator."""
    return experiment(np.random.default_rng([seed, number]), runs)


def _one_thread() -> None:
    os.environ["BORESIGHT_THREADS"] = "1"


def _on_processes(
    experiment: Experiment, seed: int, sizes: Sequence[int], workers: int, finished: Callable[[int, Result], None]
) -> None:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    left = dict(enumerate(sizes))
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    # Compiled kernels may already have threads: a fork of such a process can hang.
    context = multiprocessing.get_context("forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn")
    for _ in range(_RESTARTS + 1):
        pool = ProcessPoolExecutor(min(workers or allowed, len(left)), mp_context=context, initializer=_one_thread)
        try:
            waiting = {pool.submit(run_chunk, experiment, seed, number, size): number for number, size in left.items()}
            for future in as_completed(waiting):
                number = waiting[future]
                finished(number, future.result())
                del left[number]
        except BrokenProcessPool:
            continue
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
        return
    raise WorkersLost(
        f"worker processes died {_RESTARTS + 1} times, with {len(left)} of {len(sizes)} chunks left",
        remedy="Is there memory enough? Use fewer workers, or smaller chunks.",
    )


def _on_dask(
    experiment: Experiment,
    seed: int,
    sizes: Sequence[int],
    workers: int,
    scheduler: str | None,
    finished: Callable[[int, Result], None],
) -> None:
    with _client(scheduler, workers) as client:
        from distributed import as_completed
        from distributed.scheduler import KilledWorker

        waiting = {
            client.submit(run_chunk, experiment, seed, number, size, pure=False, retries=_RESTARTS): number
            for number, size in enumerate(sizes)
        }
        try:
            for future in as_completed(list(waiting)):
                finished(waiting[future], future.result())
        except KilledWorker as error:
            raise WorkersLost(
                f"workers of the cluster died over one chunk ({error})",
                remedy="Is there memory enough? Use fewer threads a worker, or smaller chunks.",
            ) from None


@contextmanager
def _client(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of the cluster at `scheduler`, or of a local one that ends with it."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise SettingsError(
            "the executor dask needs the package distributed", where="--executor", remedy="Install boresight[dask]."
        ) from None
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, TimeoutError, ValueError) as error:
            raise SettingsError(
                f"no scheduler answers at {scheduler} ({error})",
                where="--scheduler",
                remedy="Give its address, as tcp://host:8786.",
            ) from None
        with client:
            yield client
        return
    with (
        LocalCluster(n_workers=workers or None, threads_per_worker=1, dashboard_address=None, host="127.0.0.1") as cluster,
        Client(cluster) as client,
    ):
        yield client
