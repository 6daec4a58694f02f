"""The result of a registration: named terms with values, one joint covariance, and what could not be determined."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np

from ._types import FloatArray

SCHEMA = "boresight-calibration/1"


class TermKey(msgspec.Struct, frozen=True):
    """Which number of a calibration this is: the sensor's id, the channel ("all" where the channels share it), and the term."""

    sensor: int
    channel: str
    name: str
    unit: str


class Noise(msgspec.Struct, frozen=True):
    """Random error (one sigma) of a sensor's channels, net of the reference's and the interpolation's."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float = float("nan")


class NotDetermined(msgspec.Struct, frozen=True):
    """A term that the data cannot give, and why."""

    sensor: int
    term: str
    why: str


class Accuracy(msgspec.Struct, frozen=True):
    """Horizontal distance (m) between plot and reference over a set of pairs."""

    median_m: float
    p95_m: float


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """What a calibration says of one sensor besides its terms.  Held-out figures come from folds by target."""

    sensor: int
    name: str
    model: str
    noise: Noise
    plots: int
    tracks: int
    targets: int
    before: Accuracy
    after: Accuracy
    held_out_before_median_m: float = float("nan")
    held_out_after_median_m: float = float("nan")
    held_out_before_p95_m: float = float("nan")
    held_out_after_p95_m: float = float("nan")
    notes: tuple[str, ...] = ()


class Input(msgspec.Struct, frozen=True):
    """A file that went in."""

    path: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Systematic errors of one or more sensors.  bias = measured - true; SI inside, the term's unit in JSON.

    `epoch_s` (k,), `value` (k, p) and `covariance` (k, p, p) are over time (k = 1: static) and joint over all sensors and terms.
    """

    terms: tuple[TermKey, ...]
    epoch_s: FloatArray
    value: FloatArray
    covariance: FloatArray
    sensors: tuple[Summary, ...] = ()
    not_determined: tuple[NotDetermined, ...] = ()
    inputs: tuple[Input, ...] = ()
    warnings: tuple[str, ...] = ()
    settings: dict[str, object] = field(default_factory=dict)
    version: str = ""

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (k, p), SI."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
