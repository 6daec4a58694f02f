"""The front door: what the package exports, and that looking at it costs nothing."""

from __future__ import annotations

import subprocess
import sys

import pytest

import boresight


def test_public_names_are_sorted_and_exist() -> None:
    # Constants, then types, then verbs, each in the order of the alphabet.
    assert boresight.__all__ == sorted(boresight.__all__, key=lambda name: (not name.isupper(), name[0].islower(), name))
    for name in boresight.__all__:
        assert getattr(boresight, name) is not None


def test_verbs_stay_functions_after_their_modules_are_imported() -> None:
    code = "import boresight as bs, boresight.flow, boresight.registration; assert callable(bs.register) and callable(bs.read)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_verb"):
        _ = boresight.no_such_verb


@pytest.mark.parametrize("statement", ["import boresight", "import boresight.cli"])
def test_import_is_light(statement: str) -> None:
    """Neither the package nor its command line may pull in what takes a user's time: numba, scipy, matplotlib, duckdb."""
    code = (
        f"{statement}; import sys; print([m for m in ('numba', 'scipy', 'matplotlib', 'duckdb', 'jinja2') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert out.strip() == "[]"
