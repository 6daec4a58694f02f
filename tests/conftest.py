"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes depends on the machine and on what else it does: speed is measured by the benchmarks, not here.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real recordings, or a skip that says why."""
    folder = os.environ.get("BORESIGHT_DATA")
    if not folder:
        pytest.skip("BORESIGHT_DATA is not set: no real recordings here")
    path = Path(folder)
    if not path.is_dir():
        pytest.skip(f"BORESIGHT_DATA = {folder} is not a folder")
    return path
