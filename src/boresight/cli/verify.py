"""``boresight verify``: make a result again and compare."""

from __future__ import annotations

from pathlib import Path

from ._options import Json, print_json, steps


def verify(result: Path, /, *, inputs: Path | None = None, json: Json = False) -> None:
    """Make RESULT again from its frozen inputs and settings, and compare.

    The recordings must be, byte for byte, those that the result was made from. The exit code is 0 where the result is the same,
    1 where it differs, and 2 where it cannot be made again.

    Parameters
    ----------
    result
        Folder that calibrate --out has written.
    inputs
        Folder to look for the recordings in, where they have been moved.
    json
        Print the outcome as JSON.
    """
    from .. import flow
    from ..frozen import OF_SD, OF_SPREAD

    with steps(quiet=json) as step:
        found = flow.verify(result, inputs=inputs, progress=step)
    tolerance = f"values within {OF_SD:g} of their sd, residuals within {OF_SPREAD:g} of their spread"
    if json:
        print_json(
            {
                "same": found.same,
                "exact": found.exact,
                "differences": found.differences,
                "changed": found.changed,
                "versions": {name: {"then": then, "now": now} for name, (then, now) in found.versions.items()},
                "tolerance": {"value_of_sd": OF_SD, "residual_of_spread": OF_SPREAD},
            }
        )
    else:
        for name, (then, now) in found.versions.items():
            print(f"{name} was {then}, now {now}")
        for name in found.changed:
            print(f"{result / name} is not as it was written")
        for text in found.differences:
            print(f"differs: {text}")
        if found.exact:
            print(f"{result}: the same, bit for bit")
        elif found.same:
            print(f"{result}: the same within the tolerance ({tolerance}), not bit for bit")
        elif found.differences:
            print(f"{result}: different (tolerance: {tolerance})")
        else:
            print(f"{result}: made again it is the same within the tolerance, but its files were changed since")
    if not found.same:
        raise SystemExit(1)
