"""Association: which plot is which target of the reference, and where that target was at the plot's stamp.

Identity proposes pairs where both sides carry one; a search of the coarse biases (`hough`) makes geometry comparable; whole tracks are
then compared and assigned (`assign`).  METHODS sections 4, 6 and 7.

The last gate is wide on purpose, about six standard deviations of everything that is not yet known, and centred on the biases found:
a gate near the noise, or centred on zero, would cut off one side of the errors and bias whatever is estimated from the pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from .. import align, measure
from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from ..model import EXCLUDED, Fixes, Pairs, Plots, Sensor, Sensors, _column, _float, _Table
from . import hough, identity, tracklets
from .assign import Decision, assign, track_cost
from .hough import Candidates, Peak, Window
from .scene import Reference, Scene, Units, expand, meeting, reference_of, units_of
from .settings import AssociationSettings, assumed, window_of

__all__ = ["REASONS", "Association", "AssociationSettings", "CoarseBias", "Decisions", "associate", "search"]

REASONS = (
    "used",
    "flag",
    "NaN",
    "no sensor",
    "out of limits",
    "duplicate",
    "parked",
    "airborne",
    "no reference at that time",
    "unassigned track",
    "outside the gate",
)
_USED, _FLAG, _NAN, _NO_SENSOR, _LIMITS, _DUPLICATE, _PARKED, _AIRBORNE, _NO_REFERENCE, _UNASSIGNED, _GATE = range(len(REASONS))

BY_GEOMETRY = len(identity.KINDS)
# Mean truncated d² per plot above which a track is better left alone; a strong identity may have twice that.
_UNASSIGNED_COST = 12.0
# A clock that is farther off than this is worth a sentence.
_CLOCK_WARNING_S = 0.5


class CoarseBias(msgspec.Struct, frozen=True, kw_only=True):
    """The biases at which a sensor's pairs were found: measured - true, and stamp - true (positive: stamped late).

    `by` is "identity" or "geometry".  `score` of `tracks` units (tracks, or single plots where the radar has no tracks) agree;
    `chance` is what the same search gathers on average with spoilt clocks or north (NaN where identity made that needless).
    """

    sensor: int
    name: str
    range_m: float
    azimuth_rad: float
    time_s: float
    by: str
    score: float
    tracks: int
    chance: float


@dataclass(frozen=True, slots=True, eq=False)
class Decisions(_Table):
    """What was decided for each tracklet.

    `track` is the number that `Pairs.track` carries, `number` the radar's own; `target` -1 means that none was found.  `by`: -1 nothing,
    0 … 3 an identity (row of `identity.KINDS`), 4 geometry.  `cost` and `runner_up` are mean truncated d² of the best and the next
    target; `used` of `plots` plots are in the pairs.
    """

    track: IntArray = _column(np.int64)
    sensor: AnyArray = _column(np.int32)
    number: IntArray = _column(np.int64)
    start_s: FloatArray = _float()
    end_s: FloatArray = _float()
    plots: IntArray = _column(np.int64)
    used: IntArray = _column(np.int64, 0)
    target: IntArray = _column(np.int64)
    by: AnyArray = _column(np.int8)
    cost: FloatArray = _float()
    runner_up: FloatArray = _float()


@dataclass(frozen=True, slots=True, eq=False)
class Association:
    """Everything that association found.

    `bias` holds one entry per sensor that has pairs; `reason` (n,) is what became of each plot, a row of `REASONS`.
    """

    pairs: Pairs
    bias: tuple[CoarseBias, ...]
    reason: AnyArray
    decisions: Decisions
    warnings: tuple[str, ...]

    @property
    def not_used(self) -> dict[str, int]:
        """How many plots took no part, by reason; each plot that is not in `pairs` is counted once."""
        count = np.bincount(self.reason, minlength=len(REASONS))
        return {name: int(count[k]) for k, name in enumerate(REASONS) if k and count[k]}


def associate(plots: Plots, fixes: Fixes, sensors: Sensors, settings: AssociationSettings | None = None) -> Pairs:
    """Say which plot is which target, with the reference at each plot's stamp.

    `plots` (n,) of any of the `sensors`; `fixes` (m,) geodetic (`align.locate` makes them so).  The pairs are in the order of the plots.

    Raises NothingToDo, with the reason and the remedy, where nothing can be paired: no overlap in time, a reference out of reach,
    clocks farther apart than the window, or nothing that agrees better than chance; SettingsError for a sensor without a position.
    """
    return search(plots, fixes, sensors, settings).pairs


def search(plots: Plots, fixes: Fixes, sensors: Sensors, settings: AssociationSettings | None = None) -> Association:
    """`associate` with everything found on the way: coarse biases, decisions, what became of each plot, warnings.

    Raises as `associate`.
    """
    settings = settings or AssociationSettings()
    if not len(plots):
        raise NothingToDo(
            "there are no plots to associate", remedy="Check with `boresight info` that the recording holds polar positions."
        )
    reference = reference_of(fixes, settings)
    align.overlap(plots, fixes)
    reason = np.full(len(plots), _NO_SENSOR, np.int8)
    target = np.full(len(plots), -1, np.int64)
    track = np.full(len(plots), -1, np.int64)
    found: list[_Found] = []
    refused: list[NothingToDo] = []
    said = _strangers(plots, sensors)
    for sensor in sensors:
        rows = np.flatnonzero(plots.sensor == sensor.key)
        if not len(rows):
            continue
        try:
            one = _one_sensor(plots.take(rows), sensor, sensors, reference, settings, sum(len(f.decisions) for f in found))
        except NothingToDo as error:
            reason[rows] = _UNASSIGNED
            refused.append(error)
            continue
        reason[rows], target[rows], track[rows] = one.reason, one.target, one.track
        found.append(one)
        said += one.said
    if not found:
        if len(refused) == 1:
            raise refused[0]
        raise NothingToDo(
            "; ".join(Exception.__str__(e) for e in refused), remedy=" ".join(dict.fromkeys(e.remedy for e in refused))
        )
    said += [f"not used: {e}" for e in refused]
    pairs = _pairs(plots, np.flatnonzero(reason == _USED), target, track, reference)
    return Association(pairs, tuple(f.bias for f in found), reason, Decisions.concat([f.decisions for f in found]), tuple(said))


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What one sensor's association gave: reason, target and track of each of its plots, and the rest."""

    reason: AnyArray
    target: IntArray
    track: IntArray
    bias: CoarseBias
    decisions: Decisions
    said: list[str]


def _strangers(plots: Plots, sensors: Sensors) -> list[str]:
    """What to say of plots whose sensor is not described.  Raises SettingsError where that is all of them."""
    known = np.array([s.key for s in sensors], np.int64)
    strange = ~np.isin(plots.sensor, known)
    if not np.any(strange):
        return []
    keys = np.unique(plots.sensor[strange]).tolist()
    names = ", ".join(f"SAC/SIC {k >> 8}/{k & 255}" if 0 <= k < 65536 else f"id {k}" for k in keys)
    if np.all(strange):
        raise SettingsError(
            f"the plots come from {names}, which has no entry",
            where="sensors.toml",
            remedy="Add a [[sensor]] with that sac and sic.",
        )
    return [f"{int(strange.sum())} plots of {names} are not used: sensors.toml has no entry for it"]


def _one_sensor(
    plots: Plots, sensor: Sensor, sensors: Sensors, reference: Reference, settings: AssociationSettings, first: int
) -> _Found:
    """Associate one sensor's plots; its tracks are numbered from `first`."""
    site, turn = measure.site_of(sensor)
    assume = assumed(sensor, settings)
    azimuth = measure.true_azimuth(plots, sensors)
    scene = Scene(plots, azimuth, sensor, assume, window_of(assume, settings), settings, site, turn, reference)
    reason = _sound(plots, sensor)
    if not np.any(reason == _USED):
        raise NothingToDo(f"{sensor.name}: none of its {len(plots)} plots can be used ({_counted(reason)})")
    _check_reach(scene, np.flatnonzero(reason == _USED))
    gap = settings.track_gap_s or max(8 * assume.scan_s, 15.0)

    def group(rows: IntArray) -> tracklets.Tracklets:
        return tracklets.build(plots, rows, gap_s=gap, speed_mps=assume.speed_mps, azimuth_sd_rad=assume.azimuth_sd_rad)

    tracks = group(np.flatnonzero(reason == _USED))
    if assume.min_speed_mps > 0:
        # Half the speed, so that what decides in the end is the reference's motion, not the radar's noise.
        reason[tracklets.still(plots, tracks, 0.5 * assume.min_speed_mps)] = _PARKED
        if not np.any(reason == _USED):
            raise NothingToDo(
                f"{sensor.name}: no plot is of a moving target ({_counted(reason)})", remedy="Parked targets cannot serve."
            )
        tracks = group(np.flatnonzero(reason == _USED))
    names = identity.names_of(plots, tracks.order, tracks.start)
    bias, said = _coarse(scene, tracks, names)
    decided, by = _decide(scene, tracks, names, bias)
    bias = _refined(scene, tracks, decided, bias)
    said += _clock_words(sensor, bias)
    target, track = np.full(len(plots), -1, np.int64), np.full(len(plots), -1, np.int64)
    target[tracks.order] = np.repeat(decided.target, tracks.length)
    track[tracks.order] = first + tracks.member()
    alone = tracks.alone
    target[alone] = _nearest(scene, alone, bias)
    reason[(reason == _USED) & (target < 0)] = _UNASSIGNED
    d2 = _gate(scene, reason, target, bias)
    table = Decisions(
        track=first + np.arange(len(tracks)),
        sensor=np.full(len(tracks), sensor.key),
        number=tracks.number,
        start_s=plots.time_s[tracks.order[tracks.start[:-1]]],
        end_s=plots.time_s[tracks.order[tracks.start[1:] - 1]],
        plots=tracks.length,
        target=decided.target,
        by=by,
        cost=decided.cost,
        runner_up=decided.runner_up,
    )
    table = Decisions.concat([table, _group_alone(scene, alone, reason, target, track, d2, first + len(tracks), gap)])
    used = reason == _USED
    table = table.replace(used=np.bincount(track[used] - first, minlength=len(table)))
    if not np.any(used):
        raise NothingToDo(
            f"{sensor.name}: no plot agrees with the reference ({_counted(reason)})",
            remedy="Check the radar's position, both clocks, and that both recordings show the same traffic.",
        )
    return _Found(reason, target, track, bias, table, said)


def _counted(reason: AnyArray) -> str:
    count = np.bincount(reason, minlength=len(REASONS))
    return ", ".join(f"{int(count[k])} {REASONS[k]}" for k in range(1, len(REASONS)) if count[k]) or "none left out"


def _sound(plots: Plots, sensor: Sensor) -> AnyArray:
    """Why each plot cannot be used, looked at alone: `_USED` where nothing speaks against it."""
    reason = np.full(len(plots), _USED, np.int8)
    most = np.inf if sensor.max_range_m is None else sensor.max_range_m
    with np.errstate(invalid="ignore"):
        reason[~((plots.range_m >= max(sensor.min_range_m, 0.0)) & (plots.range_m <= most))] = _LIMITS
    reason[~(np.isfinite(plots.time_s) & np.isfinite(plots.range_m) & np.isfinite(plots.azimuth_rad))] = _NAN
    reason[plots.flags & np.uint32(EXCLUDED) != 0] = _FLAG
    rows = np.flatnonzero(reason == _USED)
    reason[rows[_repeated(plots, rows)]] = _DUPLICATE
    return reason


def _repeated(plots: Plots, rows: IntArray) -> BoolArray:
    """Which of the `rows` (m,) repeat an earlier plot: same stamp, range, azimuth, and identity."""
    out = np.zeros(len(rows), bool)
    time = plots.time_s[rows]
    by = np.argsort(time, kind="stable") if np.any(np.diff(time) < 0) else np.arange(len(rows))
    # Only plots that share their stamp with another need the full comparison.
    same = np.diff(time[by]) == 0
    shared = by[np.r_[False, same] | np.r_[same, False]]
    if not len(shared):
        return out
    at = rows[shared]
    columns = [plots.time_s, plots.range_m, plots.azimuth_rad, plots.mode_s, plots.mmsi, plots.track, plots.mode_3a]
    order = np.lexsort((shared, *(column[at] for column in columns)))
    equal = np.ones(len(order) - 1, bool)
    for column in columns:
        value = column[at][order]
        equal &= value[1:] == value[:-1]
    out[shared[order[1:][equal]]] = True
    return out


def _check_reach(scene: Scene, rows: IntArray) -> None:
    """Raise NothingToDo where no position of the reference lies within the radar's coverage."""
    from ..geodesy import ecef_from_geodetic

    fixes = scene.reference.fixes
    use = scene.reference.order
    height = np.nan_to_num(np.where(np.isfinite(fixes.height_m), fixes.height_m, fixes.pressure_altitude_m)[use])
    position = ecef_from_geodetic(fixes.latitude_rad[use], fixes.longitude_rad[use], height)
    distance = np.linalg.norm(position - scene.site, axis=1)
    farthest = float(scene.plots.range_m[rows].max())
    if not np.any(distance <= 1.1 * farthest + scene.window.range_m + 1000.0):
        raise NothingToDo(
            f"{scene.sensor.name}: the reference's nearest position is {distance.min() / 1000:.1f} km from the radar, "
            f"whose plots reach {farthest / 1000:.1f} km: the two do not see the same traffic",
            remedy="Check lat_deg and lon_deg in sensors.toml, the reference's edition and that it is of the same region.",
        )


# ------------------------------------------------------------------------------------------------------------- coarse biases


def _coarse(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names) -> tuple[CoarseBias, list[str]]:
    """The coarse biases of a radar, by identity if both sides carry one, else by votes.  Raises NothingToDo where nothing agrees."""
    said: list[str] = []
    start, end = _span(scene, tracks)
    strong = None
    if scene.settings.use_identity and len(tracks):
        meets = meeting(start, end, scene.reference, scene.window.time_s)
        links = identity.links(names, scene.reference.names, meets & ~identity.conflict(names, scene.reference.names))
        strong = links.kind < identity.MODE_3A
        if np.any(strong):
            peak, compared = _by_identity(scene, tracks, links.track[strong], links.target[strong])
            if peak.tracks >= max(1, 0.4 * compared) and not _at_edge(peak, scene.window):
                return _bias(scene, peak, "identity", compared, np.nan), said
            if compared:
                said.append(
                    f"{scene.sensor.name}: identity pairs {compared} tracks, but only {peak.tracks} of them agree with one set of biases"
                )
    units = _units(scene, tracks)
    peak, spoilt, looked_at = _by_votes(scene, tracks, names, units)
    alone = looked_at > 0 and len(tracks) == 0
    needed = max(20, scene.settings.min_tracks) if alone else scene.settings.min_tracks
    chance = float(np.mean([p.score for p in spoilt])) if spoilt else 0.0
    if hough.is_significant(peak, spoilt, needed) and not _at_edge(peak, scene.window):
        return _bias(scene, peak, "geometry", looked_at, chance), said
    raise _refusal(scene, tracks, names, units, peak, chance, looked_at, needed, said)


def _bias(scene: Scene, peak: Peak, by: str, tracks: int, chance: float) -> CoarseBias:
    return CoarseBias(
        sensor=scene.sensor.key, name=scene.sensor.name, range_m=peak.range_m, azimuth_rad=peak.azimuth_rad, time_s=peak.time_s,
        by=by, score=peak.score, tracks=tracks, chance=chance,
    )  # fmt: skip


def _at_edge(peak: Peak, window: Window) -> bool:
    """Whether the time bias lies at the edge of its window: the true one may be anywhere beyond."""
    return window.time_s > 0 and abs(peak.time_s) >= 0.98 * window.time_s


def _span(scene: Scene, tracks: tracklets.Tracklets) -> tuple[FloatArray, FloatArray]:
    time = scene.plots.time_s
    return time[tracks.order[tracks.start[:-1]]], time[tracks.order[tracks.start[1:] - 1]]


def _chosen(scene: Scene, tracks: tracklets.Tracklets, which: IntArray) -> IntArray:
    """At most `search_tracks` of the tracklets `which`: those that travel farthest say most."""
    if len(which) <= scene.settings.search_tracks:
        return which
    first, last = tracks.order[tracks.start[which]], tracks.order[tracks.start[which + 1] - 1]
    distance, azimuth = scene.plots.range_m, scene.plots.azimuth_rad
    travel = np.hypot(
        distance[last] * np.sin(azimuth[last]) - distance[first] * np.sin(azimuth[first]),
        distance[last] * np.cos(azimuth[last]) - distance[first] * np.cos(azimuth[first]),
    )
    return np.sort(which[np.argsort(-travel, kind="stable")[: scene.settings.search_tracks]])


def _by_identity(scene: Scene, tracks: tracklets.Tracklets, track: IntArray, target: IntArray) -> tuple[Peak, int]:
    """The peak of the pairs that identity proposes, and how many tracks could be compared.

    Ranges and azimuths are searched three times as far as without identity, because no false candidate is in the way.
    """
    which = _chosen(scene, tracks, np.unique(track))
    use = np.isin(track, which)
    units = units_of(*tracklets.sample(tracks, scene.settings.points, which))
    c = scene.candidates(units, (track[use], target[use]), window=None)
    wide = Window(3 * scene.window.range_m, 3 * scene.window.azimuth_rad, scene.window.time_s)
    share = np.bincount(c.track, c.weight, minlength=1)
    return hough.search_peak(c, wide), int(np.sum(share >= 0.3))


def _units(scene: Scene, tracks: tracklets.Tracklets) -> Units:
    """What votes without identity: tracklets, or single plots where there are hardly any tracklets."""
    long = np.flatnonzero(tracks.length >= scene.settings.min_plots)
    if len(long) >= scene.settings.min_tracks or not len(tracks.alone):
        return units_of(*tracklets.sample(tracks, scene.settings.points, _chosen(scene, tracks, long)))
    alone = tracks.alone
    some = alone[np.linspace(0, len(alone) - 1, min(len(alone), 1500)).astype(np.int64)]
    return units_of(len(tracks) + np.arange(len(some)), some)


def _votes(
    scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, units: Units, window: Window, **change: object
) -> Candidates:
    """Every unit against every target that its identity does not exclude."""
    who = np.unique(units.unit)
    targets = len(scene.reference.start_s)
    possible = np.ones((len(who), targets), bool)
    if scene.settings.use_identity and len(who) and who[0] < len(tracks):
        possible = ~identity.conflict(identity.Names(names.value[:, who]), scene.reference.names)
    if not change:
        time = scene.plots.time_s[units.row]
        low, high = np.full(len(who), np.inf), np.full(len(who), -np.inf)
        at = np.searchsorted(who, units.unit)
        np.minimum.at(low, at, time)
        np.maximum.at(high, at, time)
        possible &= meeting(low, high, scene.reference, window.time_s)
    unit, target = np.nonzero(possible)
    return scene.candidates(units, (who[unit], target), window=window, **change)  # type: ignore[arg-type]


def _by_votes(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, units: Units) -> tuple[Peak, list[Peak], int]:
    """The peak of all candidates, the peaks with spoilt clocks and north, and how many units took part."""
    looked_at = len(np.unique(units.unit))
    if not looked_at:
        return hough.NO_PEAK, [], 0
    peak = hough.search_peak(_votes(scene, tracks, names, units, scene.window), scene.window)
    if peak.tracks == 0:
        return peak, [], looked_at
    # Chance, measured: the same traffic at other times (routes stay, company changes), and turned about the radar.
    first = max(float(scene.plots.time_s[units.row].min()), float(scene.reference.start_s.min()))
    last = min(float(scene.plots.time_s[units.row].max()), float(scene.reference.fixes.time_s[scene.reference.order].max()))
    spoilt = []
    for part in (0.23, 0.41, 0.59, 0.77):
        if last - first > 4 * scene.window.time_s:
            change = {"shift_s": part * (last - first), "cycle_s": (first, last)}
            spoilt.append(hough.search_peak(_votes(scene, tracks, names, units, scene.window, **change), scene.window))
    for turn in (50.0, 140.0, 215.0, 305.0):
        spoilt.append(
            hough.search_peak(_votes(scene, tracks, names, units, scene.window, turn_rad=np.radians(turn)), scene.window)
        )
    return peak, spoilt, looked_at


def _refusal(
    scene: Scene,
    tracks: tracklets.Tracklets,
    names: identity.Names,
    units: Units,
    peak: Peak,
    chance: float,
    looked_at: int,
    needed: int,
    said: list[str],
) -> NothingToDo:
    """Why no biases were found, and what to do; the clock offset where something tells it."""
    window, name = scene.window, scene.sensor.name
    searched = f"{window.range_m:.0f} m, ±{np.degrees(window.azimuth_rad):.1f}° and ±{window.time_s:.1f} s"
    what = "tracks" if len(tracks) else "plots"
    because = f"{said[-1]}; " if said else f"{name}: "
    late = _probable_offset(scene, tracks, names, units)
    if late is not None:
        way = "late" if late > 0 else "early"
        return NothingToDo(
            f"{because}the clocks of the radar and the reference look {_duration(abs(late))} apart (the radar's stamps are {way}), "
            f"and only ±{window.time_s:.1f} s was searched",
            remedy=f"If that is so, set time_offset_s = {late + scene.sensor.time_offset_s:.1f} for {name!r} in sensors.toml.",
        )
    if looked_at < needed and len(tracks):
        return NothingToDo(
            f"{because}{looked_at} track{'s' * (looked_at != 1)} of at least {scene.settings.min_plots} plots cannot be told from chance "
            f"without an identity; {needed} are needed",
            remedy="Record longer, or use a reference and a radar that both give an identity (Mode S address, MMSI, callsign).",
        )
    return NothingToDo(
        f"{because}nothing agrees with the reference better than chance: within ±{searched} the best biases explain {peak.score:.1f} of "
        f"{looked_at} {what}, where spoilt clocks or north explain {chance:.1f}",
        remedy="Check the radar's position and both clocks; a known clock offset is given as time_offset_s in sensors.toml.",
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds:.0f} s ({seconds / 60:.1f} minutes)"


def _probable_offset(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, units: Units) -> float | None:
    """The clock offset (stamp - true) that would make tracks meet targets at the same places, if it explains them; else None."""
    from scipy.spatial import cKDTree

    reach = scene.settings.clock_search_s
    if reach <= scene.window.time_s or not len(units.unit):
        return None
    plots, reference = scene.plots, scene.reference
    first, last = float(plots.time_s[units.row].min()) - reach, float(plots.time_s[units.row].max()) + reach
    step = 5.0
    low, high = np.maximum(reference.start_s, first), np.minimum(reference.end_s, last)
    count = np.maximum(np.floor((high - low) / step).astype(np.int64) + 1, 0)
    if not 0 < count.sum() <= 2_000_000:
        return None
    target = np.repeat(np.arange(len(low)), count)
    time = low[target] + step * (np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count))
    states = align.states(reference.trajectories, target, time)
    moving = states.valid & (np.linalg.norm(states.velocity, axis=1) >= scene.assumed.min_speed_mps)
    target, time = target[moving], time[moving]
    enu = (states.position[moving] - scene.site) @ scene.enu_from_ecef.T
    slant = np.linalg.norm(enu, axis=1) / np.maximum(np.hypot(enu[:, 0], enu[:, 1]), 1.0)
    distance, azimuth = plots.range_m[units.row], scene.azimuth_rad[units.row]
    radius = scene.window.range_m + 0.5 * scene.window.azimuth_rad * float(np.median(distance))
    here = np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth)], axis=1)
    there = enu[:, :2] * slant[:, None]
    if not len(there):
        return None
    lists = cKDTree(there).query_ball_point(here, radius)
    point = np.repeat(np.arange(len(here)), [len(one) for one in lists])
    fix = np.concatenate([np.asarray(one, np.int64) for one in lists]) if len(point) else np.empty(0, np.int64)
    known = _known_pairs(scene, tracks, names, units)
    if known is not None:
        keep = known[units.unit[point], target[fix]]
        point, fix = point[keep], fix[keep]
    # Of each pass of a target only the nearest approach votes: the passes' lengths would blur the offset.
    gap = np.linalg.norm(here[point] - there[fix], axis=1)
    by = np.lexsort((gap, target[fix], point))
    nearest = by[np.r_[True, (np.diff(point[by]) != 0) | (np.diff(target[fix][by]) != 0)]] if len(by) else by
    point, fix = point[nearest], fix[nearest]
    late, agree, chance = hough.shared_offset(plots.time_s[units.row], units.unit, time, (point, fix), 2 * step)
    if agree < (1 if known is not None else 3) or (known is None and agree < 2 * chance):
        return None
    # The meeting only says where to look: the biases themselves must then agree.
    around = scene.window._replace(time_s=max(scene.window.time_s, 4 * step))
    who = np.unique(units.unit)
    possible = known[who] if known is not None else np.ones((len(who), len(low)), bool)
    unit, j = np.nonzero(possible)
    peak = hough.search_peak(scene.candidates(units, (who[unit], j), window=around, shift_s=-late), around)
    if peak.tracks < max(scene.settings.min_tracks if known is None else 1, 0.5 * agree):
        return None
    return late + peak.time_s


def _known_pairs(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, units: Units) -> BoolArray | None:
    """Which units and targets carry the same strong identity, whenever they were seen; None where no two do."""
    if not scene.settings.use_identity or not len(tracks) or units.unit[0] >= len(tracks):
        return None
    anywhen = np.ones((len(tracks), len(scene.reference.start_s)), bool)
    found = identity.links(names, scene.reference.names, anywhen)
    strong = found.kind < identity.MODE_3A
    if not np.any(np.isin(found.track[strong], units.unit)):
        return None
    out = np.zeros_like(anywhen)
    out[found.track[strong], found.target[strong]] = True
    return out


def _clock_words(sensor: Sensor, bias: CoarseBias) -> list[str]:
    if abs(bias.time_s) < _CLOCK_WARNING_S:
        return []
    way = "late" if bias.time_s > 0 else "early"
    return [
        f"{sensor.name}: the radar's stamps are about {abs(bias.time_s):.1f} s {way} against the reference; "
        "pairs keep their stamps, and a model with time_offset estimates it"
    ]


# ------------------------------------------------------------------------------------------------------------------ decisions


def _decide(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, bias: CoarseBias) -> tuple[Decision, AnyArray]:
    """The target of each tracklet, and by what it was found."""
    count, targets = len(tracks), len(scene.reference.start_s)
    start, end = _span(scene, tracks)
    by = np.full(count, -1, np.int8)
    possible = meeting(start, end, scene.reference, 0.0)
    kind = np.full((count, targets), -1, np.int8)
    differs = np.zeros((count, targets), bool)
    linked = np.zeros(count, bool)
    if scene.settings.use_identity and count:
        possible &= ~identity.conflict(names, scene.reference.names)
        links = identity.links(names, scene.reference.names, possible)
        kind[links.track, links.target] = links.kind
        strong = (kind >= 0) & (kind < identity.MODE_3A)
        linked = np.any(strong, axis=1)
        possible[linked] &= strong[linked]
        code, theirs = names.value[identity.MODE_3A][:, None], scene.reference.names.value[identity.MODE_3A][None, :]
        differs = (code >= 0) & (theirs >= 0) & (code != theirs)
    possible[(tracks.length < scene.settings.min_plots) & ~linked] = False
    pair = np.nonzero(possible)
    nobody = Decision(np.full(count, -1, np.int64), np.full(count, np.nan), np.full(count, np.nan))
    if not len(pair[0]):
        return nobody, by
    units = units_of(*tracklets.sample(tracks, scene.settings.points))
    centre = (bias.range_m, bias.azimuth_rad, bias.time_s)
    c = scene.candidates(units, pair, window=Window(0.0, 0.0, 0.0), centre=centre, margin=scene.settings.gate_sd)
    if not len(c.track):
        return nobody, by
    left = hough.residuals(c, *centre)
    d2 = (left[0] / c.range_sd_m) ** 2 + (left[1] / c.azimuth_sd_rad) ** 2
    track, target, cost, share, seen = track_cost(c.track, c.target, d2, c.weight, scene.settings.gate_sd**2)
    # A pair that shares hardly any time, or agrees in less than half of what it shares, is no candidate.
    keep = (share >= 0.5) & ((seen >= 0.2) | (seen * tracks.length[track] >= 10))
    track, target, cost, seen = track[keep], target[keep], cost[keep], seen[keep]
    who = kind[track, target]
    cost = np.where((who >= 0) & (who < identity.MODE_3A), 0.5 * cost, cost)
    cost = cost - 1.0 * (who == identity.MODE_3A) + 3.0 * differs[track, target] + _height_cost(scene, units, track, target)
    decided = assign(
        track,
        target,
        cost,
        seen * tracks.length[track],
        _UNASSIGNED_COST,
        start,
        end,
        overlap_s=1.5 * scene.assumed.scan_s,
        margin=2.0,
    )
    found = np.flatnonzero(decided.target >= 0)
    how = kind[found, decided.target[found]]
    by[found] = np.where(how >= 0, how, BY_GEOMETRY)
    return decided, by


def _height_cost(scene: Scene, units: Units, track: IntArray, target: IntArray) -> FloatArray:
    """What a difference of pressure altitude adds to the cost of pairs (p,): 0 up to 150 m, growing to 9."""
    out = np.zeros(len(track))
    if not np.isfinite(scene.plots.pressure_altitude_m).any():
        return out
    for u, j, point in expand(units, track, target):
        error = np.abs(scene.height_error(units.row[point], j))
        ok = np.isfinite(error)
        span = len(scene.reference.start_s)
        key = u[ok] * span + j[ok]
        excess = np.clip((error[ok] - 150.0) / 150.0, 0.0, 3.0) ** 2
        unique, at = np.unique(key, return_inverse=True)
        mean = np.bincount(at, excess, len(unique)) / np.maximum(np.bincount(at, minlength=len(unique)), 1)
        mine = track * span + target
        where = np.searchsorted(unique, mine)
        where = np.minimum(where, max(len(unique) - 1, 0))
        if len(unique):
            out += np.where(unique[where] == mine, mean[where], 0.0)
    return out


def _refined(scene: Scene, tracks: tracklets.Tracklets, decided: Decision, bias: CoarseBias) -> CoarseBias:
    """The biases again, from the assigned pairs alone: the gate's centre must not lean on what the search's cells left open."""
    found = np.flatnonzero(decided.target >= 0)
    if not len(found):
        return bias
    which = _chosen(scene, tracks, found)
    units = units_of(*tracklets.sample(tracks, scene.settings.points, which))
    c = scene.candidates(units, (which, decided.target[which]), window=None)
    if not len(c.track):
        return bias
    wide = Window(4 * scene.window.range_m, 4 * scene.window.azimuth_rad, 1.2 * scene.window.time_s)
    peak = hough.refine(c, wide, bias.range_m, bias.azimuth_rad, bias.time_s)
    if peak.tracks < 0.5 * len(which):
        return bias
    return msgspec.structs.replace(bias, range_m=peak.range_m, azimuth_rad=peak.azimuth_rad, time_s=peak.time_s)


def _gate(scene: Scene, reason: AnyArray, target: IntArray, bias: CoarseBias) -> FloatArray:
    """Look at every plot that has a target; writes the reason of those that do not stay.  Returns d² (n,), NaN where none."""
    d2 = np.full(len(reason), np.nan)
    rows = np.flatnonzero((reason == _USED) & (target >= 0))
    if not len(rows):
        return d2
    c = scene.compare(rows, target[rows], late_s=bias.time_s)
    across, along = measure.wrap_rad(c.azimuth_error_rad - bias.azimuth_rad), c.range_error_m - bias.range_m
    d2[rows] = (along / c.range_sd_m) ** 2 + (across / c.azimuth_sd_rad) ** 2
    if scene.assumed.gate_m is not None:
        outside = np.hypot(along, across * c.ground_m) > scene.assumed.gate_m
    else:
        outside = d2[rows] > scene.settings.gate_sd**2
    reason[rows[outside]] = _GATE
    if scene.assumed.min_speed_mps > 0:
        moving, grounded = scene.fits_surface(rows, target[rows])
        reason[rows[~moving]] = _PARKED
        if scene.on_ground:
            reason[rows[~grounded]] = _AIRBORNE
    reason[rows[~c.valid]] = _NO_REFERENCE
    return d2


# ------------------------------------------------------------------------------------------------- plots without track numbers


def _nearest(scene: Scene, rows: IntArray, bias: CoarseBias) -> IntArray:
    """The target nearest to each of the `rows` (m,) once the biases are taken off, -1 where none is within the gate."""
    from scipy.spatial import cKDTree

    out = np.full(len(rows), -1, np.int64)
    if not len(rows):
        return out
    reference, plots = scene.reference, scene.plots
    first, last = float(plots.time_s[rows].min()) - 10.0, float(plots.time_s[rows].max()) + 10.0
    low, high = np.maximum(reference.start_s, first), np.minimum(reference.end_s, last)
    length = np.maximum(high - low, 0.0)
    step = max(0.5 * scene.assumed.scan_s, float(length.sum()) / 500_000)
    count = np.where(high >= low, np.floor(length / step).astype(np.int64) + 2, 0)
    target = np.repeat(np.arange(len(low)), count)
    if not len(target):
        return out
    time = low[target] + step * (np.arange(len(target)) - np.repeat(np.cumsum(count) - count, count))
    states = align.states(reference.trajectories, target, time)
    target, time = target[states.valid], time[states.valid]
    enu = (states.position[states.valid] - scene.site) @ scene.enu_from_ecef.T
    if not len(enu):
        return out
    polar = measure.polar_from_enu(enu)
    # Time is a third axis: a sample a step away costs as much as half of what the fastest target moves in it.
    slow = 0.5 * scene.assumed.speed_mps

    def place(distance: FloatArray, azimuth: FloatArray, at: FloatArray) -> FloatArray:
        return np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth), slow * (at - first)], axis=1)

    tree = cKDTree(place(polar[:, 0] + bias.range_m, polar[:, 1] + bias.azimuth_rad, time + bias.time_s))
    a, farthest, gate = scene.assumed, float(plots.range_m[rows].max()), scene.settings.gate_sd
    bound = (
        gate * np.hypot(a.range_sd_m, farthest * (a.azimuth_sd_rad + a.unmodelled_rad)) + gate * a.extent_m + a.speed_mps * step
    )
    _, near = tree.query(
        place(plots.range_m[rows], scene.azimuth_rad[rows], plots.time_s[rows]), k=min(6, len(target)), distance_upper_bound=bound
    )
    near = near.reshape(len(rows), -1)
    best = np.full(len(rows), gate**2)
    done = np.full(near.shape, -1, np.int64)
    code = np.where(identity.is_discrete(plots.mode_3a[rows]), plots.mode_3a[rows], -1)
    for k in range(near.shape[1]):
        hit = near[:, k] < len(target)
        j = np.where(hit, target[np.minimum(near[:, k], len(target) - 1)], -1)
        fresh = np.flatnonzero(hit & ~np.any(done[:, :k] == j[:, None], axis=1))
        done[:, k] = j
        c = scene.compare(rows[fresh], j[fresh], late_s=bias.time_s)
        d2 = ((c.range_error_m - bias.range_m) / c.range_sd_m) ** 2
        d2 += (measure.wrap_rad(c.azimuth_error_rad - bias.azimuth_rad) / c.azimuth_sd_rad) ** 2
        theirs = reference.names.value[identity.MODE_3A][j[fresh]]
        d2 += np.where((code[fresh] >= 0) & (theirs >= 0) & (code[fresh] != theirs), 9.0, 0.0)
        better = c.valid & (d2 < best[fresh])
        out[fresh[better]], best[fresh[better]] = j[fresh[better]], d2[better]
    return out


def _group_alone(
    scene: Scene, alone: IntArray, reason: AnyArray, target: IntArray, track: IntArray, d2: FloatArray, first: int, gap_s: float
) -> Decisions:
    """Make tracks of the plots that were paired one by one: one plot per target and scan, spans without a gap, no stray hits.

    Writes `track` and `reason`; the tracks are numbered from `first`.
    """
    plots = scene.plots
    rows = alone[reason[alone] == _USED]
    if not len(rows):
        return Decisions()
    rows = rows[np.lexsort((plots.time_s[rows], target[rows]))]
    scan = scene.sensor.scan_s or _rotation(plots.time_s[rows], target[rows], scene.assumed.scan_s)
    kept = _one_a_scan(plots.time_s[rows], target[rows], d2[rows], scan)
    reason[rows[~kept]] = _UNASSIGNED
    rows = rows[kept]
    cut = np.r_[True, (np.diff(target[rows]) != 0) | (np.diff(plots.time_s[rows]) > gap_s)]
    start = np.flatnonzero(cut)
    count = np.diff(np.r_[start, len(rows)])
    begin, end = plots.time_s[rows[start]], plots.time_s[rows[start + count - 1]]
    # Clutter hits a gate now and then; a target is seen in most scans.
    enough = (count >= max(scene.settings.min_plots, 5)) & (count >= 0.3 * ((end - begin) / scan + 1))
    reason[rows[~np.repeat(enough, count)]] = _UNASSIGNED
    number = np.cumsum(enough) - 1
    rows, label = rows[np.repeat(enough, count)], np.repeat(number, count)[np.repeat(enough, count)]
    track[rows] = first + label
    n = int(enough.sum())
    mean = np.bincount(label, d2[rows], n) / np.maximum(count[enough], 1)
    return Decisions(
        track=first + np.arange(n), sensor=np.full(n, scene.sensor.key), start_s=begin[enough], end_s=end[enough], plots=count[enough],
        target=target[rows[np.searchsorted(label, np.arange(n))]] if n else np.empty(0, np.int64),
        by=np.full(n, BY_GEOMETRY), cost=mean,
    )  # fmt: skip


def _rotation(time_s: FloatArray, target: IntArray, otherwise: float) -> float:
    """The scan period (s) that plots sorted by target and time show, where sensors.toml does not give it."""
    step = np.diff(time_s)[np.diff(target) == 0]
    step = step[(step > 0.3) & (step < 30.0)]
    return float(np.median(step)) if len(step) >= 20 else otherwise


def _one_a_scan(time_s: FloatArray, target: IntArray, d2: FloatArray, scan_s: float) -> BoolArray:
    """Which plots (m,), sorted by target and time, stay if plots of a target closer than half a scan are one too many."""
    keep = np.ones(len(time_s), bool)
    # Each round drops the worse of two neighbours; three hits in one scan need two rounds.
    for _ in range(8):
        at = np.flatnonzero(keep)
        close = np.flatnonzero((np.diff(target[at]) == 0) & (np.diff(time_s[at]) < 0.5 * scan_s))
        if not len(close):
            break
        worse = np.where(d2[at[close]] > d2[at[close + 1]], close, close + 1)
        keep[at[worse]] = False
    return keep


# ---------------------------------------------------------------------------------------------------------------------- pairs


def _pairs(plots: Plots, rows: IntArray, target: IntArray, track: IntArray, reference: Reference) -> Pairs:
    """The paired plots with the reference at their own stamps."""
    mine = plots.take(rows)
    s = align.states(reference.trajectories, target[rows], mine.time_s)
    length = np.where(np.isfinite(s.length_m), s.length_m, _own_length(mine.length_m, track[rows]))
    return Pairs(
        plot=rows, plots=mine, target=target[rows], track=track[rows], position=s.position, velocity=s.velocity,
        acceleration=s.acceleration, covariance=s.covariance, heading_rad=s.heading_rad, length_m=length,
    )  # fmt: skip


def _own_length(length_m: FloatArray, track: IntArray) -> FloatArray:
    """The median of what the radar itself says of the length, by track (m,)."""
    out = np.full(len(track), np.nan)
    known = np.flatnonzero(np.isfinite(length_m))
    if not len(known):
        return out
    by = known[np.lexsort((length_m[known], track[known]))]
    start = np.flatnonzero(np.r_[True, np.diff(track[by]) != 0])
    count = np.diff(np.r_[start, len(by)])
    middle = 0.5 * (length_m[by[start + (count - 1) // 2]] + length_m[by[start + count // 2]])
    at = np.searchsorted(track[by[start]], track)
    at = np.minimum(at, len(start) - 1)
    return np.where(track[by[start]][at] == track, middle[at], out)
