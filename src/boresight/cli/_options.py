"""Options that several commands share, and how their text becomes values."""

from __future__ import annotations

import datetime
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable

Files = Annotated[list[Path], Parameter(consume_multiple=True, negative="")]
Editions = Annotated[list[str], Parameter(name="--edition", consume_multiple=True, negative="")]
Named = Annotated[list[str], Parameter(consume_multiple=True, negative="")]
Date = Annotated[str | None, Parameter(name="--date")]
Switch = Annotated[bool, Parameter(negative="", show_default=False)]
Json = Annotated[bool, Parameter(name="--json", negative="", show_default=False)]


def editions_of(texts: Sequence[str] | None) -> dict[int, str]:
    """``["021=0.23"]`` as ``{21: "0.23"}``; raises SettingsError with the form that is needed."""
    editions: dict[int, str] = {}
    for text in texts or ():
        category, equals, edition = text.partition("=")
        if not equals or not category.strip().isdigit() or not edition.strip():
            raise SettingsError(
                f"{text!r} is not a category and its edition", where="--edition", remedy="Example: --edition 021=0.23"
            )
        editions[int(category)] = edition.strip()
    return editions


def named_values(texts: Sequence[str] | None, where: str) -> dict[str, str]:
    """``["tau_s=20"]`` as ``{"tau_s": "20"}``; raises SettingsError with the form that is needed."""
    values: dict[str, str] = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        name, value = name.strip(), value.strip()
        if not equals or not name or not value:
            raise SettingsError(f"{text!r} is no name and its value", where=where, remedy=f"Example: {where} tau_s=20")
        if name in values:
            raise SettingsError(f"{name} is given twice", where=where, remedy="Give it once.")
        values[name] = value
    return values


def date_of(text: str | None) -> datetime.date | None:
    """``2016-05-10`` as a date; raises SettingsError with the form that is needed."""
    if text is None:
        return None
    remedy = "It is the UTC date of the file's first record, as 2016-05-10."
    try:
        date = datetime.date.fromisoformat(text)
    except ValueError:
        raise SettingsError(f"{text!r} is not a date", where="--date", remedy=remedy) from None
    # Stamps count from 1970, and arithmetic with days must stay within the calendar.
    if not 1970 <= date.year <= 2200:
        raise SettingsError(f"{text} lies outside 1970 … 2200", where="--date", remedy=remedy)
    return date


@contextmanager
def steps(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Show the step under way on standard error (a spinner on a terminal, nothing elsewhere)."""
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(text)


def print_json(value: Any) -> None:
    """Print one JSON document on standard output: not-a-number is null, keys keep their order."""
    import msgspec

    sys.stdout.write(msgspec.json.format(msgspec.json.encode(value), indent=2).decode() + "\n")
