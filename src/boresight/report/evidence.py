"""What the recordings tell besides the pairs: the radars' clocks, PSR - SSR, and where a moving radar's platform went.

It is gathered while the recordings are in memory, and thinned: a report needs a few thousand points of a million.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._types import FloatArray
from ..model import EXCLUDED, Platform, Plots, Recording, Sensors
from .drawing import MAX_POINTS, sample

if TYPE_CHECKING:
    from ..assessment.clock import Reception, Rotation, Turning
    from ..assessment.psr_ssr import PsrSsr

_NOTHING = np.empty(0)


class Clock(NamedTuple):
    """One radar's clock in one recording: what was found, remarks in words, and a choice of samples for its figure.

    `reception` holds stamps and reception minus stamp (UTC s, s).
    """

    sensor: int
    path: str
    rotation: Rotation | None
    received: Reception | None
    remarks: tuple[str, ...]
    turning: Turning
    reception: tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a report shows of the recordings themselves; everything may be empty.

    `chains` is a choice of the plots that tell PSR - SSR, whose table of all is `psr_ssr`; `platform` is where moving radars
    were.
    """

    clocks: tuple[Clock, ...] = ()
    psr_ssr: PsrSsr | None = None
    chains: Plots = field(default_factory=Plots)
    platform: Platform = field(default_factory=Platform)


def gather(plots: Plots, recordings: Sequence[Recording], sensors: Sensors) -> Evidence:
    """The evidence of the radars under calibration: `plots` are those of all `recordings`."""
    from ..assessment.psr_ssr import psr_ssr

    told = np.flatnonzero(np.isfinite(plots.psr_ssr_range_m) & (plots.flags & int(EXCLUDED) == 0))
    keys = np.unique(plots.sensor).tolist()
    chains = [told[plots.sensor[told] == key] for key in keys]
    chosen = np.concatenate([mine[sample(len(mine), 10 * MAX_POINTS)] for mine in chains]) if len(told) else told
    platform = Platform.concat([r.platform for r in recordings])
    return Evidence(
        clocks=tuple(clock for r in recordings for clock in _clocks(r, sensors, keys)),
        psr_ssr=psr_ssr(plots) if len(told) else None,
        chains=plots.take(chosen),
        platform=platform[np.isin(platform.sensor, keys)],
    )


def _clocks(recording: Recording, sensors: Sensors, keys: Sequence[int]) -> list[Clock]:
    from ..assessment.clock import Turning, examine
    from ..errors import NothingToDo

    try:
        found, turning = examine(recording, sensors)
    except NothingToDo:
        return []
    out = []
    for key in keys:
        sensor = sensors.find(key)
        rotation = next((one for one in found.rotations if one.sensor == key), None)
        received = next((one for one in found.receptions if one.sensor == key), None)
        name = f"{sensor.name}: " if sensor is not None else ""
        remarks = tuple(text.removeprefix(name) for text in found.remarks if name and text.startswith(name))
        if rotation is None and received is None:
            continue
        samples = next((one for one in turning if one.sensor == key), Turning(key, *[_NOTHING] * 4))
        some = sample(len(samples.time_s))
        thin = Turning(key, *(column[some] for column in samples[1:]))
        out.append(Clock(key, recording.path, rotation, received, remarks, thin, _received(recording, key)))
    return out


def _received(recording: Recording, key: int) -> tuple[FloatArray, FloatArray]:
    if not len(recording.receive_s):
        return _NOTHING, _NOTHING
    mine = np.flatnonzero((recording.plots.sensor == key) & np.isfinite(recording.plots.time_s))
    mine = mine[sample(len(mine))]
    stamp = recording.plots.time_s[mine]
    late = recording.receive_s[recording.plots.record[mine]] - stamp
    known = np.isfinite(late)
    return stamp[known], late[known]
