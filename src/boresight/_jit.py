"""The one wrapper of Numba.

Every kernel of Boresight is compiled through `kernel`.  Compiled code is cached in
``<user cache>/boresight/<hash of all kernel sources>``, because Numba's own cache does not see edits in a file that a
kernel calls into.  Where no folder is writable the kernels still run: they are compiled anew, and that is said once.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

log = logging.getLogger(__name__)
_F = TypeVar("_F", bound=Callable[..., Any])


def _source_hash() -> str:
    """A hash of every source file of the package that mentions this wrapper, so that any edit empties the cache."""
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        text = path.read_bytes()
        if b"_jit" in text:
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """The writable folder of compiled kernels, or None where there is none (said once in the log)."""
    base = os.environ.get("XDG_CACHE_HOME")
    candidates = [Path(base)] if base else []
    home = os.environ.get("LOCALAPPDATA") or os.environ.get("HOME")
    if home:
        candidates.append(Path(home) if os.name == "nt" else Path(home) / ".cache")
    candidates.append(Path(tempfile.gettempdir()) / f"boresight-{os.getuid() if hasattr(os, 'getuid') else 'user'}")
    name = _source_hash()
    for candidate in candidates:
        folder = candidate / "boresight" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    log.warning("No folder for compiled kernels is writable; they are compiled anew in every run (set XDG_CACHE_HOME).")
    return None


def inlined(function: _F) -> _F:
    """Compile `function` into every kernel that calls it: the compiler then knows which arrays cannot overlap.

    For the small kernels of inner loops; from Python it is called as any kernel is.  With ``NUMBA_DISABLE_JIT=1`` the plain
    Python function runs instead.
    """
    import numba

    return cast("_F", numba.njit(nogil=True, inline="always")(function))


def kernel(function: _F) -> _F:
    """Compile `function` with Numba on first use (cached, without the GIL, no fastmath), keeping its type for mypy.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead.
    """
    import numba

    folder = cache_folder()
    if folder is None:
        return cast("_F", numba.njit(nogil=True)(function))
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        return cast("_F", numba.njit(cache=True, nogil=True)(function))
    finally:
        config.CACHE_DIR = before
