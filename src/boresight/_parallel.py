"""Pieces of one computation on several threads.

NumPy, SciPy and the kernels let go of the interpreter's lock while they compute.  How work is cut never depends on the number
of processors, and results come back in order, so the same input gives the same bytes on every machine.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

_In = TypeVar("_In")
_Out = TypeVar("_Out")


def threads() -> int:
    """How many threads are worth while: the processors that this process may use, at most 8 (memory is shared by all).

    ``BORESIGHT_THREADS`` in the environment sets another number: 1 in worker processes, of which there is one a processor.
    """
    told = os.environ.get("BORESIGHT_THREADS", "")
    if told.isdigit() and int(told) > 0:
        return int(told)
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    return max(1, min(allowed, 8))


def in_threads(function: Callable[[_In], _Out], pieces: Iterable[_In]) -> list[_Out]:
    """``[function(piece) for piece in pieces]``, several at a time.  The first error, in the order of the pieces, is raised."""
    work = list(pieces)
    if len(work) < 2 or threads() < 2:
        return [function(piece) for piece in work]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(min(threads(), len(work))) as pool:
        return list(pool.map(function, work))


def slices(n: int, rows: int) -> Iterator[slice]:
    """Slices of so many rows that cover n rows."""
    for k in range(0, n, rows):
        yield slice(k, min(k + rows, n))
