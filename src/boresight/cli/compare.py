"""``boresight compare``: do two calibrations agree?"""

from __future__ import annotations

from pathlib import Path

from ._options import Json, print_json


def compare(first: Path, second: Path, /, *, out: Path | None = None, json: Json = False) -> None:
    """Compare two calibrations of the same radars: differences with their sd, a test of agreement, and what has drifted.

    Parameters
    ----------
    first
        calibration.json of the one, the older by custom.
    second
        calibration.json of the other; differences are second minus first.
    out
        Write the comparison to this HTML file.
    json
        Print the comparison as JSON.
    """
    from ..calibration import load_calibration
    from ..errors import SettingsError
    from ..report.compare import compare as compared
    from ..report.compare import comparison_json, comparison_text, write_comparison

    if out is not None and out.exists():
        raise SettingsError(f"{out} exists", where="--out", remedy="Name another file.")
    one, other = load_calibration(first), load_calibration(second)
    names = _names(first, second)
    found = compared(one, other, names) if out is None else write_comparison(out, one, other, names)
    if json:
        print_json(comparison_json(found) | ({"report": str(out)} if out is not None else {}))
        return
    print(comparison_text(found))
    if out is not None:
        print(f"\nComparison: {out}")


def _names(first: Path, second: Path) -> tuple[str, str]:
    """What to call the two: the first parts from the end of their paths that differ."""
    a, b = first.resolve().with_suffix("").parts, second.resolve().with_suffix("").parts
    for x, y in zip(reversed(a), reversed(b), strict=False):
        if x != y:
            return x, y
    return f"{first.stem} (1)", f"{second.stem} (2)"
