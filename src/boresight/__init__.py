"""Boresight finds, removes and proves the systematic errors of radars.

The way of the data: read, align, associate, register, correct, assess, report.  Each step is one function of tables to tables::

    import boresight as bs

    radar = bs.read("radar.ast")
    reference = bs.read("adsb.ast")
    sensors = bs.load_sensors("sensors.toml")
    fixes, notes = bs.locate(reference.fixes, sensors, reference.sources)
    pairs = bs.associate(radar.plots, fixes, sensors)
    found = bs.register(pairs, sensors)
    clean = bs.correct(radar.plots, found)

A name is imported when it is first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .alignment import locate, states, trajectories
    from .assessment.residuals import Residuals, residuals
    from .association import Association, associate, search
    from .calibration import Calibration, load_calibration, save_calibration
    from .correction import correct
    from .errors import BoresightError, InputError, NothingToDo, SettingsError
    from .model import Channel, Fixes, Flag, Pairs, Plots, Recording, Sensor, Sensors, load_sensors
    from .reading import read
    from .registration import register
    from .report import write_report
    from .terms import MODELS, TERMS, Term

__version__ = "0.1.0"

_HOME = {
    "alignment": ("locate", "states", "trajectories"),
    "assessment.residuals": ("Residuals", "residuals"),
    "association": ("Association", "associate", "search"),
    "calibration": ("Calibration", "load_calibration", "save_calibration"),
    "correction": ("correct",),
    "errors": ("BoresightError", "InputError", "NothingToDo", "SettingsError"),
    "model": ("Channel", "Fixes", "Flag", "Pairs", "Plots", "Recording", "Sensor", "Sensors", "load_sensors"),
    "reading": ("read",),
    "registration": ("register",),
    "report": ("write_report",),
    "terms": ("MODELS", "TERMS", "Term"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "MODELS",
    "TERMS",
    "Association",
    "BoresightError",
    "Calibration",
    "Channel",
    "Fixes",
    "Flag",
    "InputError",
    "NothingToDo",
    "Pairs",
    "Plots",
    "Recording",
    "Residuals",
    "Sensor",
    "Sensors",
    "SettingsError",
    "Term",
    "associate",
    "correct",
    "load_calibration",
    "load_sensors",
    "locate",
    "read",
    "register",
    "residuals",
    "save_calibration",
    "search",
    "states",
    "trajectories",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'boresight' has no attribute {name!r}")
    return getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
