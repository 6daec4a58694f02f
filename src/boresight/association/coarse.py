"""The biases at which a radar's plots and the reference agree, or the reason why there are none.

By identity where both sides carry one, else by votes of all candidates, judged against chance (METHODS section 4).
"""

from __future__ import annotations

import msgspec
import numpy as np

from .. import alignment
from .._types import BoolArray, FloatArray, IntArray
from ..errors import NothingToDo
from . import drift, hough, identity, tracklets
from .hough import Bias, Candidates, Peak, Window
from .scene import Scene, Units, meeting, units_of

# A clock that is farther off than this is worth a sentence.
_CLOCK_WARNING_S = 0.5
# As many plots tell how well the clock is known.
_TOLD_BY = 3000
# Where single plots vote, fewer than this many agreeing ones decide nothing.
_FEWEST_PLOTS = 20
# Where votes as wide as the noise do not meet, gain or eccentricity may be in the way: votes so many times as wide are tried.
_WIDE = 3.0


class CoarseBias(msgspec.Struct, frozen=True, kw_only=True):
    """The biases at which a sensor's pairs were found: measured - true, and stamp - true (positive: stamped late).

    `range_gain` (m per m) and the eccentricity (rad per cosine and sine of the azimuth) only tell where the last gate was.

    `by` is "identity" or "geometry".  `score` of `tracks` units (tracks, or single plots where the radar has no tracks) agree;
    `chance` is what the same search gathers on average with spoilt clocks or north (NaN where identity made that needless).
    """

    sensor: int
    name: str
    range_m: float
    azimuth_rad: float
    time_s: float
    range_gain: float = 0.0
    azimuth_cos_rad: float = 0.0
    azimuth_sin_rad: float = 0.0
    by: str
    score: float
    tracks: int
    chance: float

    @property
    def errors(self) -> Bias:
        """The biases as the search computes with them."""
        return Bias(self.range_m, self.azimuth_rad, self.time_s, self.range_gain, self.azimuth_cos_rad, self.azimuth_sin_rad)


def coarse(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names) -> tuple[CoarseBias, list[str], Scene]:
    """The coarse biases of a radar, by identity if both sides carry one, else by votes; what is to be said; and the scene.

    The scene is the one given, but where the biases change over time: then what changes was taken off its plots (`drift`).
    Raises NothingToDo where nothing agrees, with what was searched and what to do.
    """
    said: list[str] = []
    start, end = span_of(scene, tracks)
    named: CoarseBias | None = None
    units = _units(scene, tracks)
    if scene.settings.use_identity and len(tracks):
        meets = meeting(start, end, scene.reference, scene.window.time_s)
        links = identity.links(names, scene.reference.names, meets & ~identity.conflict(names, scene.reference.names))
        strong = links.kind < identity.MODE_3A
        if np.any(strong):
            same = links.track[strong], links.target[strong]
            peak, compared = _by_identity(scene, tracks, *same)
            noisy = scene
            if compared and not _agreed(scene, peak, compared):
                noisy = drift.as_noisy_as_shown(scene, tracks, *same)
                peak, compared = _by_identity(noisy, tracks, *same)
            noisy, peak, compared, changes = _followed(noisy, tracks, same, peak, compared)
            if _agreed(noisy, peak, compared):
                scene, said = noisy, changes
                named = _bias(scene, peak, "identity", compared, np.nan)
                # One or two tracks may carry a wrong address: where others could contradict them, they are heard.
                if compared >= 3 or len(np.unique(units.unit)) < 2 * compared:
                    return named, said, scene
            elif compared:
                why = (
                    f"{f'only {peak.tracks}' if peak.tracks else 'none'} of them agree on the biases, within "
                    f"±{3 * scene.window.range_m:.0f} m and ±{np.degrees(3 * scene.window.azimuth_rad):.1f}°"
                )
                if _at_edge(peak, scene):
                    why = "the time bias on which they agree lies at the edge of the window or beyond"
                said.append(f"{scene.sensor.name}: identity pairs {compared} track{'s' * (compared != 1)}, but {why}")
    needed = _FEWEST_PLOTS if _single(tracks, units) else scene.settings.min_tracks
    looked_at = len(np.unique(units.unit))
    ballots = _ballots(scene, tracks, names, units)
    outcome: list[tuple[Peak, float]] = []
    for width in (1.0, _WIDE):
        peak, *spoilt = (
            (hough.search_peak(hough.widened(c, width), scene.window) for c in ballots) if ballots else [hough.NO_PEAK]
        )
        outcome.append((peak, float(np.mean([p.score for p in spoilt])) if spoilt else 0.0))
        if not hough.is_significant(peak, spoilt, needed):
            continue
        if width > 1.0:
            peak = hough.bent(ballots[0], scene.window, peak.bias, width)
        if peak.tracks >= needed and not _at_edge(peak, scene):
            return _bias(scene, peak, "geometry", looked_at, outcome[-1][1]), said, scene
    peak, chance = outcome[0]
    if named is not None:
        return named, said, scene
    raise _refusal(scene, tracks, names, units, peak, chance, looked_at, needed, said)


def _bias(scene: Scene, peak: Peak, by: str, tracks: int, chance: float) -> CoarseBias:
    who = scene.sensor
    return CoarseBias(sensor=who.key, name=who.name, by=by, score=peak.score, tracks=tracks, chance=chance, **peak.bias._asdict())


def _followed(
    scene: Scene, tracks: tracklets.Tracklets, same: tuple[IntArray, IntArray], peak: Peak, compared: int
) -> tuple[Scene, Peak, int, list[str]]:
    """The scene without what its biases do over time, if more tracks agree there, with their peak; else what is given."""
    calm, best, whole = scene, peak, compared
    said: list[str] = []
    # Once more with what gain, eccentricity and a late stamp are then known to do.
    for _ in range(2):
        course = drift.course_of(scene, tracks, *same, best.bias if _agreed(calm, best, whole) else None)
        if course is None:
            break
        tried = course.taken_off(scene)
        found, count = _by_identity(tried, tracks, *same)
        if not _agreed(tried, found, count) or found.tracks < max(2, best.tracks):
            break
        calm, best, whole, said = tried, found, count, course.words(scene)
    return calm, best, whole, said


def _agreed(scene: Scene, peak: Peak, compared: int) -> bool:
    """Whether enough of the tracks that identity pairs explain the same biases, inside of the window of time."""
    return bool(compared) and peak.tracks >= max(1, 0.4 * compared) and not _at_edge(peak, scene)


def _at_edge(peak: Peak, scene: Scene) -> bool:
    """Whether the time bias lies at the edge of its window: the true one may be anywhere beyond.

    Not of ships: the echo of a long slow one lies as far from the middle of its hull as it sails in ten seconds, so the edge
    tells nothing of the clocks.  Registration, which knows the lengths, tells the two apart.
    """
    if scene.sensor.kind == "marine":
        return False
    return scene.window.time_s > 0 and abs(peak.bias.time_s) >= 0.98 * scene.window.time_s


def span_of(scene: Scene, tracks: tracklets.Tracklets) -> tuple[FloatArray, FloatArray]:
    time = scene.plots.time_s
    return time[tracks.order[tracks.start[:-1]]], time[tracks.order[tracks.start[1:] - 1]]


def farthest_travelled(scene: Scene, tracks: tracklets.Tracklets, which: IntArray) -> IntArray:
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
    which = farthest_travelled(scene, tracks, np.unique(track))
    use = np.isin(track, which)
    units = units_of(*tracklets.sample(tracks, scene.settings.points, which))
    c = scene.candidates(units, (track[use], target[use]), window=None)
    wide = Window(3 * scene.window.range_m, 3 * scene.window.azimuth_rad, scene.window.time_s)
    if len(c.track) < max(3, scene.settings.min_plots):
        # Three biases explain fewer plots than that whatever they are.
        return hough.NO_PEAK, 0
    compared = int(np.sum(np.bincount(c.track, c.weight, minlength=1) >= 0.3))
    best = hough.NO_PEAK
    # Gain and eccentricity may spread the errors far beyond the noise: then wider votes meet where narrow ones do not.
    for width in (1.0, 3.0, 10.0):
        peak = hough.search_peak(hough.widened(c, width), wide)
        if width > 1.0 and peak.tracks > best.tracks:
            peak = hough.bent(c, wide, peak.bias, width)
        if peak.tracks > best.tracks:
            best = peak
        if best.tracks >= 0.8 * compared:
            break
    return best, compared


def _units(scene: Scene, tracks: tracklets.Tracklets) -> Units:
    """What votes without identity: tracklets, or single plots where there are hardly any tracklets."""
    long = np.flatnonzero(tracks.length >= scene.settings.min_plots)
    if len(long) >= scene.settings.min_tracks or not len(tracks.alone):
        return units_of(*tracklets.sample(tracks, scene.settings.points, farthest_travelled(scene, tracks, long)))
    alone = tracks.alone
    some = alone[np.linspace(0, len(alone) - 1, min(len(alone), 1500)).astype(np.int64)]
    return units_of(len(tracks) + np.arange(len(some)), some)


def _single(tracks: tracklets.Tracklets, units: Units) -> bool:
    """Whether single plots vote: their numbers come after the tracklets'."""
    return bool(len(units.unit) and units.unit[0] >= len(tracks))


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


def _ballots(scene: Scene, tracks: tracklets.Tracklets, names: identity.Names, units: Units) -> list[Candidates]:
    """The candidates as they are, and as they are with clocks or north spoilt, so that none can be true.

    Chance is thereby measured, not modelled: the same traffic at other times (routes stay, company changes), and turned about
    the radar.
    """
    if not len(units.unit):
        return []
    changes: list[dict[str, object]] = [{}]
    first = max(float(scene.plots.time_s[units.row].min()), float(scene.reference.start_s.min()))
    last = min(float(scene.plots.time_s[units.row].max()), float(scene.reference.fixes.time_s[scene.reference.order].max()))
    if last - first > 4 * scene.window.time_s:
        changes += [{"shift_s": part * (last - first), "cycle_s": (first, last)} for part in (0.23, 0.41, 0.59, 0.77)]
    changes += [{"turn_rad": np.radians(turn)} for turn in (50.0, 140.0, 215.0, 305.0)]
    out = []
    for change in changes:
        c = _votes(scene, tracks, names, units, scene.window, **change)
        out.append(c.keep(hough.within(c, scene.window, 3 * _WIDE)))
    return out


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
    what = "plots" if _single(tracks, units) else "tracks"
    because = f"{said[-1]}; " if said else f"{name}: "
    late = _probable_offset(scene, tracks, names, units)
    if late is not None:
        way = "late" if late > 0 else "early"
        return NothingToDo(
            f"{because}the clocks of radar and reference look {_duration(abs(late))} apart (the radar's stamps are {way}), "
            f"and only ±{window.time_s:.1f} s was searched",
            remedy=f"If that is so, set time_offset_s = {late + scene.sensor.time_offset_s:.1f} for {name!r} in sensors.toml.",
        )
    usable = len(tracks.order) + len(tracks.alone)
    if usable < scene.settings.min_plots:
        return NothingToDo(
            f"{name}: only {usable} of its plots can be used, and at least {scene.settings.min_plots} plots of one target are "
            "needed",
            remedy="Record longer.",
        )
    if looked_at < needed and not _single(tracks, units):
        return NothingToDo(
            f"{because}its {len(tracks.order)} plots form {looked_at or 'no'} track{'s' * (looked_at != 1)} of at least "
            f"{scene.settings.min_plots} plots, which cannot be told from chance without an identity; {needed} are needed",
            remedy="Record longer, or use a reference and a radar that both give an identity (Mode S address, MMSI, callsign).",
        )
    return NothingToDo(
        f"{because}nothing agrees with the reference better than chance: within ±{searched} the best biases "
        f"explain {peak.score:.1f} of {looked_at} {what}, where spoilt clocks or north explain {chance:.1f}",
        remedy="Check the radar's position and both clocks; a known clock offset is given as time_offset_s in sensors.toml. "
        "Errors that may be larger are searched farther with --associate-option range_window_m=…, azimuth_window_deg=…, "
        "time_window_s=….",
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
    states = alignment.states(reference.trajectories, target, time)
    moving = states.valid & (np.linalg.norm(states.velocity, axis=1) >= scene.assumed.min_speed_mps)
    target, time = target[moving], time[moving]
    enu = scene.local(states.position[moving] - scene.site)
    slant = np.linalg.norm(enu, axis=1) / np.maximum(np.hypot(enu[:, 0], enu[:, 1]), 1.0)
    distance, azimuth = plots.range_m[units.row], scene.azimuth_rad[units.row]
    radius = scene.window.range_m + 0.5 * scene.window.azimuth_rad * float(np.median(distance))
    here = np.stack([distance * np.sin(azimuth), distance * np.cos(azimuth)], axis=1)
    there = enu[:, :2] * slant[:, None]
    if not len(there):
        return None
    near = cKDTree(here).sparse_distance_matrix(cKDTree(there), radius, output_type="coo_matrix")
    point, fix, gap = near.row.astype(np.int64), near.col.astype(np.int64), near.data
    known = _known_pairs(scene, tracks, names, units)
    if known is not None:
        keep = known[units.unit[point], target[fix]]
        point, fix, gap = point[keep], fix[keep], gap[keep]
    # Of each pass of a target only the nearest approach votes: the passes' lengths would blur the offset.
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
    return late + peak.bias.time_s


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


def clock_words(scene: Scene, rows: IntArray, track: IntArray, target: IntArray, bias: CoarseBias) -> list[str]:
    """What to say of the radar's clock, from the `rows` (m,) of plots that are paired; track and target are of all plots."""
    # Where targets are long and slow, what looks like time may as well be where their echoes lie: registration tells these apart.
    sensor = scene.sensor
    if abs(bias.time_s) < _CLOCK_WARNING_S or sensor.kind in ("surface", "marine"):
        return []
    rows = rows[np.argsort(track[rows], kind="stable")]
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _TOLD_BY)).astype(np.int64)]
    number, first, unit = np.unique(track[rows], return_index=True, return_inverse=True)
    units = units_of(unit, rows)
    c = scene.candidates(units, (np.arange(len(number)), target[rows[first]]), window=None)
    # One straight track does not tell a late stamp from a range bias.
    if abs(bias.time_s) < 2 * hough.time_sd_s(c):
        return []
    way = "late" if bias.time_s > 0 else "early"
    return [
        f"{sensor.name}: the radar's stamps are about {abs(bias.time_s):.1f} s {way} against the reference: "
        "time_offset, where the model has it, says how much, and correction takes it out"
    ]
