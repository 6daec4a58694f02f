"""``boresight warm``: compile the kernels once, before the first recording."""

from __future__ import annotations

import time


def warm() -> None:
    """Compile the kernels and cache them, so that the next command starts at once."""
    import tempfile
    from pathlib import Path

    from .. import flow
    from .._jit import cache_folder
    from ._options import steps

    start = time.perf_counter()
    with steps(quiet=False) as step, tempfile.TemporaryDirectory() as folder:
        flow.demo(Path(folder), seed=0, progress=step)
    where = cache_folder()
    kept = f"kept in {where}" if where else "but no folder to keep them in is writable: set XDG_CACHE_HOME"
    print(f"Kernels compiled and tried in {time.perf_counter() - start:.1f} s; {kept}")
