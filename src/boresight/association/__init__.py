"""Association: which plot is which target of the reference, and where that target was at the plot's stamp.

Identity proposes pairs where both sides carry one; a search of the coarse biases (`hough`) makes geometry comparable; whole
tracks are then compared and assigned (`assign`).  METHODS sections 4, 6 and 7.

The last gate is wide on purpose, about six standard deviations of everything that is not yet known, and centred on the biases
found: a gate near the noise, or centred on zero, would cut off one side of the errors and bias whatever is estimated from the
pairs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from .. import alignment, measure
from .._types import AnyArray, BoolArray, FloatArray, IntArray
from ..errors import NothingToDo, SettingsError
from ..model import EXCLUDED, Fixes, Pairs, Plots, Sensor, Sensors, _column, _float, _Table
from . import hough, identity, singles, tracklets
from .assign import Decision, assign, track_cost
from .cluster import Traces, TrackMatch
from .coarse import CoarseBias, clock_words, coarse, farthest_travelled, span_of
from .hough import Window
from .scene import Reference, Scene, Units, expand, meeting, reference_of, units_of
from .settings import ASSOCIATIONS, AssociationSettings, association_of, assumed, window_of

__all__ = [
    "ASSOCIATIONS", "REASONS", "Association", "AssociationSettings", "CoarseBias", "Decisions", "associate", "association_of",
    "search",
]  # fmt: skip

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


@dataclass(frozen=True, slots=True, eq=False)
class Decisions(_Table):
    """What was decided for each tracklet.

    `track` is the number that `Pairs.track` carries, `number` the radar's own; `target` -1 means that none was found.  `by`:
    -1 nothing, 0 … 3 an identity (row of `identity.KINDS`), 4 geometry.  `cost` and `runner_up` are mean truncated d² of the
    best and the next target; `used` of `plots` plots are in the pairs.
    """

    track: IntArray = _column(np.int64)  # noqa: RUF009
    sensor: AnyArray = _column(np.int32)  # noqa: RUF009
    number: IntArray = _column(np.int64)  # noqa: RUF009
    start_s: FloatArray = _float()  # noqa: RUF009
    end_s: FloatArray = _float()  # noqa: RUF009
    plots: IntArray = _column(np.int64)  # noqa: RUF009
    used: IntArray = _column(np.int64, 0)  # noqa: RUF009
    target: IntArray = _column(np.int64)  # noqa: RUF009
    by: AnyArray = _column(np.int8)  # noqa: RUF009
    cost: FloatArray = _float()  # noqa: RUF009
    runner_up: FloatArray = _float()  # noqa: RUF009


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

    `plots` (n,) of any of the `sensors`; `fixes` (m,) geodetic (`alignment.locate` makes them so).  The pairs are in the order of
    the plots.

    Raises NothingToDo, with the reason and the remedy, where nothing can be paired: no overlap in time, a reference out of
    reach, clocks farther apart than the window, or nothing that agrees better than chance; SettingsError for a sensor without
    a position.
    """
    return search(plots, fixes, sensors, settings).pairs


def search(
    plots: Plots,
    fixes: Fixes,
    sensors: Sensors,
    settings: AssociationSettings | None = None,
    views: Mapping[int, alignment.Viewer] | None = None,
) -> Association:
    """`associate` with everything found on the way: coarse biases, decisions, what became of each plot, warnings.

    `views`, by sensor id, are how radars that move see the reference (`platform.platform_views`).  Raises as `associate`.
    """
    views = views or {}
    settings = settings or AssociationSettings()
    if not len(plots):
        raise NothingToDo(
            "there are no plots to associate", remedy="Check with `boresight info` that the recording holds polar positions."
        )
    reference = reference_of(fixes, settings)
    alignment.overlap(plots, fixes)
    reason = np.full(len(plots), _NO_SENSOR, np.int8)
    target = np.full(len(plots), -1, np.int64)
    track = np.full(len(plots), -1, np.int64)
    found: list[_Found] = []
    refused: list[NothingToDo] = []
    said = [*reference.trajectories.warnings, *_strangers(plots, sensors)]
    for sensor in sensors:
        rows = np.flatnonzero(plots.sensor == sensor.key)
        if not len(rows):
            continue
        try:
            seen = reference.seen_by(views.get(sensor.key))
            one = _one_sensor(plots.take(rows), sensor, sensors, seen, settings, sum(len(f.decisions) for f in found))
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
    pairs = _pairs(plots, np.flatnonzero(reason == _USED), target, track, reference, views)
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

    view = reference.trajectories.view
    followed = plots if view is None else view.steady(plots)

    def group(rows: IntArray) -> tracklets.Tracklets:
        return tracklets.build(followed, rows, gap_s=gap, speed_mps=assume.speed_mps, azimuth_sd_rad=assume.azimuth_sd_rad)

    tracks = group(np.flatnonzero(reason == _USED))
    if assume.min_speed_mps > 0:
        # Half the speed, so that what decides in the end is the reference's motion, not the radar's noise.
        reason[tracklets.still(followed, tracks, 0.5 * assume.min_speed_mps)] = _PARKED
        if not np.any(reason == _USED):
            raise NothingToDo(
                f"{sensor.name}: no plot is of a moving target ({_counted(reason)})", remedy="Parked targets cannot serve."
            )
        tracks = group(np.flatnonzero(reason == _USED))
    said: list[str] = []
    if settings.matching is not None:
        bias, decided, by = _by_clusters(scene, tracks, settings.matching)
    else:
        names = identity.names_of(plots, tracks.order, tracks.start)
        bias, said, scene = coarse(scene, tracks, names)
        decided, by = _decide(scene, tracks, names, bias)
    for _ in range(6):
        before, bias = bias, _refined(scene, tracks, decided, bias)
        if settings.matching is not None or not _moved(scene, before, bias):
            break
        # Large gain, eccentricity, or biases at the window's edge are found in steps: what they now explain is looked at again.
        decided, by = _decide(scene, tracks, names, bias)
    # Clusters tell of tracks only.
    alone = tracks.alone if settings.matching is None else tracks.alone[:0]
    nearest = singles.nearest(scene, alone, bias)
    if settings.matching is None and np.count_nonzero(decided.target >= 0) < settings.min_tracks:
        for _ in range(6):
            before, bias = bias, _refined_alone(scene, alone, nearest, bias)
            if not _moved(scene, before, bias):
                break
            nearest = singles.nearest(scene, alone, bias)
    target, track = np.full(len(plots), -1, np.int64), np.full(len(plots), -1, np.int64)
    target[tracks.order] = np.repeat(decided.target, tracks.length)
    track[tracks.order] = first + tracks.member()
    target[alone] = nearest
    reason[(reason == _USED) & (target < 0)] = _UNASSIGNED
    d2 = _gate(scene, reason, target, bias)
    alone = alone[reason[alone] == _USED]
    spans = singles.spans(scene, alone, target[alone], d2[alone], gap)
    reason[np.setdiff1d(alone, spans.row)] = _UNASSIGNED
    track[spans.row] = first + len(tracks) + spans.span
    start, end = span_of(scene, tracks)
    table = Decisions.concat([
        Decisions(
            track=first + np.arange(len(tracks)), number=tracks.number, start_s=start, end_s=end, plots=tracks.length,
            target=decided.target, by=by, cost=decided.cost, runner_up=decided.runner_up,
        ),
        Decisions(
            track=first + len(tracks) + np.arange(len(spans.target)), start_s=spans.start_s, end_s=spans.end_s,
            plots=np.bincount(spans.span, minlength=len(spans.target)), target=spans.target,
            by=np.full(len(spans.target), BY_GEOMETRY), cost=spans.cost,
        ),
    ])  # fmt: skip
    table = table.replace(sensor=np.full(len(table), sensor.key))
    used = reason == _USED
    table = table.replace(used=np.bincount(track[used] - first, minlength=len(table)))
    if not np.any(used):
        raise NothingToDo(
            f"{sensor.name}: no plot agrees with the reference ({_counted(reason)})",
            remedy="Check the radar's position, both clocks, and that both recordings show the same traffic.",
        )
    said += clock_words(scene, np.flatnonzero(used), track, target, bias)
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
    same = np.flatnonzero(np.diff(time[by]) == 0)
    shared = by[np.union1d(same, same + 1)]
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
    if scene.reference.trajectories.view is not None:
        seen = alignment.states(scene.reference.trajectories, scene.reference.target[use], fixes.time_s[use])
        if not seen.valid.any():
            return
        position = seen.position[seen.valid]
    distance = np.linalg.norm(position - scene.site, axis=1)
    farthest = float(scene.plots.range_m[rows].max())
    if not np.any(distance <= 1.1 * farthest + scene.window.range_m + 1000.0):
        raise NothingToDo(
            f"{scene.sensor.name}: the reference's nearest position is {distance.min() / 1000:.1f} km from the radar, "
            f"whose plots reach {farthest / 1000:.1f} km: the two do not see the same traffic",
            remedy="Check lat_deg and lon_deg in sensors.toml, the reference's edition and that it is of the same region.",
        )


# ------------------------------------------------------------------------------------------------------------------ decisions


def _decide(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, bias: CoarseBias) -> tuple[Decision, AnyArray]:
    """The target of each tracklet, and by what it was found."""
    count, targets = len(tracks), len(scene.reference.start_s)
    start, end = span_of(scene, tracks)
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
    rows, columns = np.nonzero(possible)
    pair = rows.astype(np.int64), columns.astype(np.int64)
    nobody = Decision(np.full(count, -1, np.int64), np.full(count, np.nan), np.full(count, np.nan))
    if not len(pair[0]):
        return nobody, by
    units = units_of(*tracklets.sample(tracks, scene.settings.points))
    c = scene.candidates(units, pair, window=Window(0.0, 0.0, 0.0), centre=bias.errors, margin=scene.settings.gate_sd)
    if not len(c.track):
        return nobody, by
    left = hough.residuals(c, bias.errors)
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


def _by_clusters(scene: Scene, tracks: tracklets.Tracklets, method: TrackMatch) -> tuple[CoarseBias, Decision, AnyArray]:
    """The target of each tracklet by K-medoids, from biases of zero.  Raises NothingToDo where no track finds its target.

    Points are compared in space where the radar measures elevation, else in
    the plane of slant range and azimuth.
    """
    rows, number = tracks.order, tracks.member()
    if not len(rows):
        raise NothingToDo(
            f"{scene.sensor.name}: K-medoids pair whole tracks, and its plots carry neither track numbers nor identities",
            remedy="Associate by hough.",
        )
    plots, reference = scene.plots, scene.reference
    margin = 2 * method.period_s
    use = reference.order
    time = reference.fixes.time_s[use]
    use = use[(time >= plots.time_s[rows].min() - margin) & (time <= plots.time_s[rows].max() + margin)]
    which, time = reference.target[use], reference.fixes.time_s[use]
    state = alignment.states(reference.trajectories, which, time)
    use, which, time = use[state.valid], which[state.valid], time[state.valid]
    enu = scene.local(state.position[state.valid] - scene.site)
    distance, azimuth, elevation = plots.range_m[rows], scene.azimuth_rad[rows], plots.elevation_rad[rows]
    solid = bool(np.isfinite(elevation).all())
    if solid:
        flat = distance * np.cos(elevation)
        own = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), distance * np.sin(elevation)], axis=1)
        own_height, height = own[:, 2], enu[:, 2]
    else:
        own = np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth), np.zeros(len(rows))], axis=1)
        slant = np.linalg.norm(enu, axis=1) / np.maximum(np.hypot(enu[:, 0], enu[:, 1]), 1.0)
        enu = np.stack([enu[:, 0] * slant, enu[:, 1] * slant, np.zeros(len(enu))], axis=1)
        own_height, height = plots.pressure_altitude_m[rows], reference.fixes.pressure_altitude_m[use]
    matched = method(Traces(own, own_height, plots.time_s[rows], number), Traces(enu, height, time, which))
    target = np.full(len(tracks), -1, np.int64)
    target[matched.track] = matched.target
    found = int(np.count_nonzero(target >= 0))
    if not found:
        best = float(matched.share.max(initial=0.0))
        raise NothingToDo(
            f"{scene.sensor.name}: K-medoids pair none of its {len(tracks)} tracks with a target: the best percentage of matches "
            f"is {100 * best:.0f} %, and {100 * method.threshold:.0f} % are needed",
            remedy="They work where errors are smaller than the distances of the targets: else associate by hough.",
        )
    bias = CoarseBias(
        sensor=scene.sensor.key, name=scene.sensor.name, range_m=0.0, azimuth_rad=0.0, time_s=0.0, by="k-medoids",
        score=float(found), tracks=len(tracks), chance=np.nan,
    )  # fmt: skip
    by = np.where(target >= 0, BY_GEOMETRY, -1).astype(np.int8)
    return bias, Decision(target, np.full(len(tracks), np.nan), np.full(len(tracks), np.nan)), by


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
    which = farthest_travelled(scene, tracks, np.flatnonzero(decided.target >= 0))
    if not len(which):
        return bias
    units = units_of(*tracklets.sample(tracks, scene.settings.points, which))
    return _fitted(scene, units, (which, decided.target[which]), bias)


def _refined_alone(scene: Scene, rows: IntArray, target: IntArray, bias: CoarseBias) -> CoarseBias:
    """The same from plots that were paired one by one, `rows` and `target` (m,)."""
    found = np.flatnonzero(target >= 0)
    some = found[np.linspace(0, len(found) - 1, min(len(found), 3000)).astype(np.int64)]
    if not len(some):
        return bias
    number = np.arange(len(some))
    return _fitted(scene, units_of(number, rows[some]), (number, target[some]), bias)


def _fitted(scene: Scene, units: Units, pair: tuple[IntArray, IntArray], bias: CoarseBias) -> CoarseBias:
    c = scene.candidates(units, pair, window=None)
    if not len(c.track):
        return bias
    wide = Window(4 * scene.window.range_m, 4 * scene.window.azimuth_rad, 1.2 * scene.window.time_s)
    peak = hough.refine(c, wide, bias.errors, bends=True)
    if peak.tracks < 0.5 * len(pair[0]):
        return bias
    return msgspec.structs.replace(bias, **peak.bias._asdict())


def _moved(scene: Scene, before: CoarseBias, after: CoarseBias) -> bool:
    """Whether biases changed by more than the noise of one plot, somewhere in the coverage: pairs may then have been missed."""
    a = scene.assumed
    azimuth = np.linspace(0.0, 2 * np.pi, 16)
    ranges = scene.plots.range_m[np.isfinite(scene.plots.range_m)]
    reach = np.linspace(0.0, float(ranges.max(initial=0.0)), 16)
    old, new = before.errors.at(reach, azimuth), after.errors.at(reach, azimuth)
    return bool(
        np.max(np.abs(new[0] - old[0])) > a.range_sd_m
        or np.max(np.abs(new[1] - old[1])) > a.azimuth_sd_rad
        or abs(after.time_s - before.time_s) > 0.3
    )


def _gate(scene: Scene, reason: AnyArray, target: IntArray, bias: CoarseBias) -> FloatArray:
    """Look at every plot that has a target; writes the reason of those that do not stay.  Returns d² (n,), NaN where none."""
    d2 = np.full(len(reason), np.nan)
    rows = np.flatnonzero((reason == _USED) & (target >= 0))
    if not len(rows):
        return d2
    c = scene.compare(rows, target[rows], late_s=bias.time_s)
    along, across = singles.left_over(c, bias)
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


# ---------------------------------------------------------------------------------------------------------------------- pairs


def _pairs(
    plots: Plots,
    rows: IntArray,
    target: IntArray,
    track: IntArray,
    reference: Reference,
    views: Mapping[int, alignment.Viewer],
) -> Pairs:
    """The paired plots with the reference at their own stamps, as their radar sees it."""
    mine = plots.take(rows)
    s = alignment.states(reference.trajectories, target[rows], mine.time_s)
    for key, view in views.items():
        own = mine.sensor == key
        seen = view(alignment.States(*(column[own] for column in s)), mine.time_s[own])
        for column, value in zip(s, seen, strict=True):
            column[own] = value
    length = np.where(np.isfinite(s.length_m), s.length_m, _own_length(mine.length_m, track[rows]))
    return Pairs(
        plot=rows, plots=mine, target=target[rows], track=track[rows], position=s.position, velocity=s.velocity,
        acceleration=s.acceleration, covariance=s.covariance, heading_rad=s.heading_rad, length_m=length,
        source=s.source,
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
