"""The exceptions of Boresight.

::

    BoresightError                 everything below; the command line prints it as one line and exits with 2
      InputError(ValueError)       a file, table or recording that cannot be used: `path`, `offset`, `record`, `remedy`
      SettingsError(ValueError)    an option, a sensors.toml or a model that makes no sense: `where`, `remedy`
      NothingToDo                  inputs are sound but nothing can be computed from them (no overlap, no pairs): `remedy`
      WorkersLost                  worker processes of a long computation died again and again: `remedy`

Errors carry their data as attributes, so that a program need not parse the sentence.
"""

from __future__ import annotations

from pathlib import Path


class BoresightError(Exception):
    """Base of every error that Boresight raises on purpose.  `remedy` says what to do about it."""

    def __init__(self, message: str, *, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy

    def __str__(self) -> str:
        message = super().__str__()
        if not self.remedy:
            return message
        return f"{message}{'' if message.endswith(('.', '?', '!')) else '.'} {self.remedy}"


class InputError(BoresightError, ValueError):
    """A file or table cannot be used.  `path`, byte `offset` and `record` number are None where they do not apply."""

    def __init__(
        self,
        message: str,
        *,
        path: str | Path | None = None,
        offset: int | None = None,
        record: int | None = None,
        remedy: str = "",
    ) -> None:
        place = "" if path is None else f"{path}: "
        if offset is not None:
            place += f"byte {offset}: "
        if record is not None:
            place += f"record {record}: "
        super().__init__(place + message, remedy=remedy)
        self.path, self.offset, self.record = path, offset, record


class SettingsError(BoresightError, ValueError):
    """A setting makes no sense.  `where` names it (``sensors.toml: $.sensor[1].lat_deg``)."""

    def __init__(self, message: str, *, where: str = "", remedy: str = "") -> None:
        super().__init__(f"{where}: {message}" if where else message, remedy=remedy)
        self.where = where


class NothingToDo(BoresightError):
    """The inputs are sound, but nothing can be computed from them."""


class WorkersLost(BoresightError):
    """Worker processes died again and again: too little memory, usually."""
