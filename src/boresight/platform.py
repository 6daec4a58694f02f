"""A radar that moves: everything about its platform, so that the steps after it need not know.

A moving radar measures where targets are from its antenna, about axes that turn with the ship.  Its reference is therefore
looked at from the antenna, in the axes that it measures in, at each plot's own time, and put about one fixed point: `View` does
this to what `alignment.states` tells.  Rates come out right too: what a late stamp, or any other term, does to a measured range
or azimuth depends on the motion of the target relative to the antenna and its axes, not over ground.  METHODS section 3: own
ship's roll, pitch, heading and the antenna's lever arm are inputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np

from ._parallel import slices
from ._types import BoolArray, FloatArray, IntArray
from .alignment import States, Trajectories, states, trajectories
from .errors import SettingsError
from .geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, height_and_up, rotate, rotate_back
from .measure import enu_jacobian, from_true_north, position_from_polar, wrap_turn
from .model import Fixes, Flag, Platform, Plots, Sensor, Sensors

# Neither position nor heading is interpolated across a longer silence; ships roll and pitch faster than they turn.
_MAX_GAP_S, _SWING_GAP_S = 10.0, 3.0
# Rates are differences (of fourth order) of places this far apart: noise of own ship's attitude must not look like motion.
_RATE_S = 0.25
# Only what own ship's positions tell of their own scatter counts: a value to begin with.
_OWN_SD_M = 3.0
# Reports on either side that an angle of own ship may be averaged over, and the median of the square of a normal variable.
_NEIGHBOURS = (2, 3, 4, 6, 8, 12, 16, 24, 32)
_ROWS = 20_000
_MEDIAN_CHI2 = 0.4549
_NEWTON_STEPS = 8


# ------------------------------------------------------------------------------------------------------------------- frames


def deck_from_enu(heading_rad: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """The rotation (n, 3, 3) from east, north, up to a ship's starboard, bow and up, at its heading, roll and pitch (n,), rad.

    Roll is positive to starboard (starboard side down), pitch with the bow up.  Heading turns first, then pitch, then roll.
    Starboard, bow and up are what east, north and up are to an antenna on land: azimuths in these axes count from the bow.
    """
    sin_h, cos_h = np.sin(heading_rad), np.cos(heading_rad)
    sin_r, cos_r, sin_p, cos_p = np.sin(roll_rad), np.cos(roll_rad), np.sin(pitch_rad), np.cos(pitch_rad)
    # Level: starboard (cos h, -sin h, 0), ahead (sin h, cos h, 0); the deck's up at no roll is across both.
    out = np.empty((*np.shape(heading_rad), 3, 3))
    out[..., 0, 0], out[..., 0, 1] = cos_r * cos_h + sin_r * sin_p * sin_h, -cos_r * sin_h + sin_r * sin_p * cos_h
    out[..., 0, 2] = -sin_r * cos_p
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = cos_p * sin_h, cos_p * cos_h, sin_p
    out[..., 2, 0], out[..., 2, 1] = sin_r * cos_h - cos_r * sin_p * sin_h, -sin_r * sin_h - cos_r * sin_p * cos_h
    out[..., 2, 2] = cos_r * cos_p
    return out


def antenna_axes(angles: str, heading_rad: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """The rotation (n, 3, 3) from east, north, up to the axes that an antenna measures in, by `angles` (north, bow or deck)."""
    if angles == "north":
        return np.broadcast_to(np.eye(3), (*np.shape(heading_rad), 3, 3))
    if angles == "bow":
        return deck_from_enu(heading_rad, np.zeros_like(heading_rad), np.zeros_like(heading_rad))
    return deck_from_enu(heading_rad, roll_rad, pitch_rad)


# ----------------------------------------------------------------------------------------------------------------- own ship


class _Curve(NamedTuple):
    """An angle of own ship over time: cubic pieces through its reports (k,), where it was not silent for longer than `gap_s`.

    `reported` (k,) are the reports as they were, `value` and `slope` those without their noise.
    """

    time_s: FloatArray
    reported: FloatArray
    value: FloatArray
    slope: FloatArray
    gap_s: float

    def at(self, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The angle (n,) at times (n,), NaN where it is not known, and where it is."""
        t = self.time_s
        if len(t) < 2:
            return np.full(len(time_s), np.nan), np.zeros(len(time_s), bool)
        k = np.clip(np.searchsorted(t, time_s, side="right"), 1, len(t) - 1)
        step = t[k] - t[k - 1]
        known = (time_s >= t[0]) & (time_s <= t[-1]) & (step <= self.gap_s)
        w = (time_s - t[k - 1]) / step
        a, b = self.value[k - 1], self.value[k]
        h10, h11 = w * (1 - w) * (1 - w) * step, w * w * (w - 1) * step
        both = w * w * (3 - 2 * w)
        return np.where(known, (1 - both) * a + both * b + h10 * self.slope[k - 1] + h11 * self.slope[k], np.nan), known

    def ahead(self, time_s: FloatArray, ahead_s: float) -> FloatArray:
        """The angle (n,) `ahead_s` after times (n,); where only the time itself is known, by the motion on its other side."""
        now = self.at(time_s)[0]
        if ahead_s == 0.0:
            return now
        then, there = self.at(time_s + ahead_s)
        mirrored, known = self.at(time_s - ahead_s)
        return np.where(np.isnan(now) | there, np.where(np.isnan(now), np.nan, then), np.where(known, 2 * now - mirrored, now))


def _curve(time_s: FloatArray, value: FloatArray, gap_s: float) -> _Curve:
    """Reports (n,) of an angle, NaN where there is none, as a curve; the slopes are those of parabolas through three reports."""
    good = np.flatnonzero(np.isfinite(time_s) & np.isfinite(value))
    t, first = np.unique(time_s[good], return_index=True)
    v = np.unwrap(value[good[first]])
    if len(t) < 2:
        return _Curve(t, v, v, np.zeros(len(t)), gap_s)
    step = np.diff(t)
    whole = step <= gap_s
    reported = v
    v, smooth = _without_noise(t, v, np.r_[0, np.cumsum(~whole)])
    rise = np.diff(v) / step
    left, right = np.r_[False, whole], np.r_[whole, False]
    before, after = np.r_[rise[0], rise], np.r_[rise, rise[-1]]
    gone, coming = np.r_[step[0], step], np.r_[step, step[-1]]
    middle = (before * coming + after * gone) / (gone + coming)
    slope = np.where(left & right, middle, np.where(left, before, np.where(right, after, 0.0)))
    return _Curve(t, reported, v, np.where(np.isfinite(smooth), smooth, slope), gap_s)


def _without_noise(time_s: FloatArray, value: FloatArray, piece: IntArray) -> tuple[FloatArray, FloatArray]:
    """Reports (n,) of an angle without their noise, and slopes (n,), NaN where they are as they were.

    Noise of a twentieth of a degree, five times a second, looks like a ship that turns to and fro by a third of a degree a
    second, and hides what a late stamp does.  Cubics through more and more neighbours of one `piece` (n,) are tried; taken are
    those whose misfit, noise and bias together, is the least, if it is less than the noise of the reports themselves.
    """
    best, slopes = value.copy(), np.full(len(value), np.nan)
    rough = _local(time_s, value, piece, 3, 4)
    if rough is None:
        return best, slopes
    # Of a polynomial that follows everything but noise.
    noise = float(np.median(rough.residual**2 / rough.freedom)) / _MEDIAN_CHI2
    least = noise
    for half in _NEIGHBOURS:
        fit = _local(time_s, value, piece, half, 3)
        if fit is None:
            break
        misfit = float(np.mean(fit.residual**2))
        bias = max(misfit - noise * float(np.mean(fit.freedom)), 0.0)
        left = bias + noise * float(np.mean(1.0 - fit.freedom))
        if left < least:
            least = left
            best[fit.rows], slopes[fit.rows] = value[fit.rows] - fit.residual, fit.slope
    return best, slopes


class _Local(NamedTuple):
    """Local polynomials at the `rows` (m,): residuals, slopes, and what part of a report's own noise is in its residual."""

    rows: IntArray
    residual: FloatArray
    slope: FloatArray
    freedom: FloatArray


def _local(time_s: FloatArray, value: FloatArray, piece: IntArray, half: int, degree: int) -> _Local | None:
    """Polynomials through 2 `half` + 1 neighbours of each report, within its piece; None where no piece has so many."""
    width = 2 * half + 1
    begin = np.searchsorted(piece, piece, side="left")
    end = np.searchsorted(piece, piece, side="right")
    rows = np.flatnonzero(end - begin >= width)
    if not len(rows):
        return None
    residual, slope, freedom = np.empty(len(rows)), np.empty(len(rows)), np.empty(len(rows))
    ends = np.zeros((degree + 1, 2))
    ends[0, 0] = ends[1, 1] = 1.0
    for part in slices(len(rows), _ROWS):
        mine = rows[part]
        first = np.clip(mine - half, begin[mine], end[mine] - width)
        near = first[:, None] + np.arange(width)
        span = np.maximum(time_s[near[:, -1]] - time_s[near[:, 0]], 1e-9)
        columns = ((time_s[near] - time_s[mine, None]) / span[:, None])[:, :, None] ** np.arange(degree + 1)
        gram = np.swapaxes(columns, 1, 2) @ columns
        weight = columns @ np.linalg.solve(gram, np.broadcast_to(ends, (len(mine), *ends.shape)))
        # Counted from the report itself, so that nothing is lost of large angles.
        fitted = np.einsum("nwk,nw->nk", weight, value[near] - value[mine, None])
        residual[part], slope[part] = -fitted[:, 0], fitted[:, 1] / span
        freedom[part] = np.maximum(1.0 - weight[np.arange(len(mine)), mine - first, 0], 1e-6)
    return _Local(rows, residual, slope, freedom)


def position_at(platform: Platform, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The platform's position (n, 3), ECEF metres, at times (n,), by linear interpolation, and where it is known.

    It is not known beyond the first and last report, nor between two that are more than 10 s apart.
    """
    order = np.argsort(platform.time_s, kind="stable")
    order = order[np.isfinite(platform.latitude_rad[order]) & np.isfinite(platform.longitude_rad[order])]
    stamps, first = np.unique(platform.time_s[order], return_index=True)
    rows = order[first]
    if not len(rows):
        return np.full((len(time_s), 3), np.nan), np.zeros(len(time_s), bool)
    height = np.where(np.isfinite(platform.height_m[rows]), platform.height_m[rows], 0.0)
    place = ecef_from_geodetic(platform.latitude_rad[rows], platform.longitude_rad[rows], height)
    at = np.stack([np.interp(time_s, stamps, place[:, k]) for k in range(3)], axis=1)
    after = np.clip(np.searchsorted(stamps, time_s), 1, max(len(stamps) - 1, 1))
    if len(stamps) == 1:
        return at, np.abs(time_s - stamps[0]) < 1e-3
    gap = stamps[after] - stamps[after - 1]
    return at, (time_s >= stamps[0]) & (time_s <= stamps[-1]) & (gap <= _MAX_GAP_S)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """How one moving antenna sees the reference: `view(states, time_s)` are the states about one fixed point.

    `own` is the way of own ship's reference point; `arm` (3,) the antenna's starboard, forward and up from it, metres.  `site`
    (3,), ECEF metres, and `rotation` (3, 3), enu_from_ecef, are the fixed point's.  `angles` tells what azimuth and elevation are
    measured from: those axes come to lie along the fixed point's east, north and up.
    """

    own: Trajectories
    heading: _Curve
    roll: _Curve | None
    pitch: _Curve | None
    arm: FloatArray
    angles: str
    site: FloatArray
    rotation: FloatArray

    @property
    def turns(self) -> bool:
        """Whether the heading enters."""
        return self.angles != "north" or bool(self.arm.any())

    @property
    def swings(self) -> bool:
        """Whether roll and pitch enter."""
        return self.roll is not None and (self.angles == "deck" or bool(self.arm.any()))

    def known(self, time_s: FloatArray) -> dict[str, BoolArray]:
        """Where (n,) what is needed of own ship is known at times (n,): position, heading, roll and pitch."""
        out = {"position": states(self.own, np.zeros(len(time_s), np.int64), time_s).valid}
        if self.turns:
            out["heading"] = self.heading.at(time_s)[1]
        if self.swings and self.roll is not None and self.pitch is not None:
            out["roll and pitch"] = self.roll.at(time_s)[1] & self.pitch.at(time_s)[1]
        return out

    def _attitude(self, time_s: FloatArray, ahead_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        level = np.zeros(len(time_s))
        heading = self.heading.ahead(time_s, ahead_s) if self.turns else level
        if not self.swings or self.roll is None or self.pitch is None:
            return heading, level, level
        return heading, self.roll.ahead(time_s, ahead_s), self.pitch.ahead(time_s, ahead_s)

    def pose(self, time_s: FloatArray, ahead_s: float = 0.0, own: States | None = None) -> tuple[FloatArray, FloatArray]:
        """Where the antenna is (n, 3), ECEF metres, and the rotation (n, 3, 3) from ECEF to its axes, at times (n,).

        NaN where own ship's position or attitude is not known.  `ahead_s` later by the motion at those times.
        """
        own = states(self.own, np.zeros(len(time_s), np.int64), time_s) if own is None else own
        place = own.position + ahead_s * own.velocity + (0.5 * ahead_s**2) * own.acceleration
        latitude, longitude, _ = geodetic_from_ecef(place)
        level = enu_from_ecef(latitude, longitude)
        attitude = self._attitude(time_s, ahead_s)
        if self.arm.any():
            place = place + rotate_back(level, rotate_back(deck_from_enu(*attitude), self.arm))
        return place, level if self.angles == "north" else antenna_axes(self.angles, *attitude) @ level

    def steady(self, plots: Plots) -> Plots:
        """The plots (n,) with azimuths from north, a level deck assumed: for following them as tracks."""
        if self.angles == "north":
            return plots
        heading, known = self.heading.at(plots.time_s)
        return plots.replace(azimuth_rad=np.where(known, wrap_turn(plots.azimuth_rad + heading), plots.azimuth_rad))

    def __call__(self, seen: States, time_s: FloatArray) -> States:
        """The states (n,) at times (n,) as the antenna sees them; not valid where own ship's place or attitude is not known."""
        own = states(self.own, np.zeros(len(time_s), np.int64), time_s)
        h = _RATE_S
        near: list[FloatArray] = []
        axes = self.rotation
        for ahead in (-2 * h, -h, h, 2 * h, 0.0):
            origin, axes = self.pose(time_s, ahead, own)
            there = seen.position + ahead * seen.velocity + (0.5 * ahead * ahead) * seen.acceleration
            near.append(rotate(axes, there - origin))
        long_before, before, after, long_after, now = near
        rate = (8 * (after - before) - (long_after - long_before)) / (12 * h)
        second = (16 * (after + before) - (long_after + long_before) - 30 * now) / (12 * h * h)
        # From Earth-centred axes to the antenna's, taken for those of the fixed point.
        turn = self.rotation.T @ axes
        valid = seen.valid & np.isfinite(now).all(axis=1)
        nothing = np.where(valid, 0.0, np.nan)
        position = self.site + rotate_back(self.rotation, now)
        return States(
            position=position + nothing[:, None],
            velocity=rotate_back(self.rotation, rate) + nothing[:, None],
            acceleration=rotate_back(self.rotation, second) + nothing[:, None],
            covariance=turn @ seen.covariance @ np.swapaxes(turn, 1, 2) + nothing[:, None, None],
            heading_rad=_turned(seen.heading_rad, seen.position, position, turn) + nothing,
            length_m=seen.length_m + nothing,
            valid=valid,
            source=np.where(valid, seen.source, np.int32(-1)),
        )


def _turned(heading_rad: FloatArray, position: FloatArray, seen: FloatArray, turn: FloatArray) -> FloatArray:
    """Headings (n,) at true positions as headings at those about the fixed point, where everything is turned."""
    ahead = np.stack([np.sin(heading_rad), np.cos(heading_rad), np.zeros(len(heading_rad))], axis=1)
    latitude, longitude, _ = geodetic_from_ecef(position)
    ahead = rotate(turn, rotate_back(enu_from_ecef(latitude, longitude), ahead))
    latitude, longitude, _ = geodetic_from_ecef(seen)
    local = rotate(enu_from_ecef(latitude, longitude), ahead)
    return wrap_turn(np.arctan2(local[:, 0], local[:, 1]))


# -------------------------------------------------------------------------------------------------------------------- radars


def moving(plots: Plots, platform: Platform) -> list[int]:
    """The ids of the sensors among `plots` whose platform moves, in order: those with own ship's position at several times."""
    placed = np.isfinite(platform.time_s) & np.isfinite(platform.latitude_rad) & np.isfinite(platform.longitude_rad)
    keys = np.intersect1d(plots.sensor, platform.sensor[placed])
    return [int(k) for k in keys if len(np.unique(platform.time_s[placed & (platform.sensor == k)])) > 1]


def view_of(platform: Platform, sensor: Sensor) -> tuple[View, Sensor, tuple[str, ...]]:
    """How the moving radar `sensor` sees the reference, the sensor as it stands at the fixed point, and what is to be said.

    The fixed point is where the platform was first.  The antenna's height is the sensor's own `height_m` where that is given
    (ellipsoidal, at rest), else the platform's median and the lever arm: heave is not looked at.

    Raises SettingsError where angles are from the bow and nothing tells own ship's heading.
    """
    own = platform[platform.sensor == sensor.key]
    there = np.isfinite(own.latitude_rad) & np.isfinite(own.longitude_rad) & np.isfinite(own.time_s)
    first = int(np.flatnonzero(there)[np.argmin(own.time_s[there])])
    arm = np.array(sensor.lever_arm_m or (0.0, 0.0, 0.0))[[1, 0, 2]]
    angles = sensor.angles
    heights = own.height_m[there & np.isfinite(own.height_m)]
    antenna = sensor.ellipsoidal_height_m
    level = float(np.median(heights)) if len(heights) else 0.0
    level = level if antenna is None else antenna - float(arm[2])
    said = [f"{sensor.name}: its platform moves: the reference is taken relative to it, and the map is about the radar"]
    if sensor.lever_arm_m is None:
        said[0] += (
            "; sensors.toml has no lever_arm_m, so the antenna is taken to be where own ship's position is told: what lies "
            "between them looks like wrong stamps, an extent of the targets or a shift of the site, and nothing tells which"
        )
    heading = _curve(own.time_s, own.heading_rad, _MAX_GAP_S)
    roll, pitch = (_curve(own.time_s, angle, _SWING_GAP_S) for angle in (own.roll_rad, own.pitch_rad))
    if len(heading.time_s) < 2:
        if angles != "north":
            raise SettingsError(
                f"{sensor.name!r} measures from the bow (angles = {angles!r}), and nothing tells own ship's heading",
                where="sensors.toml",
                remedy='Give a recording with own ship\'s heading (HDT, THS, HDG), or angles = "north" where it is in already.',
            )
        if arm.any():
            size = float(np.linalg.norm(arm))
            said.append(
                f"{sensor.name}: nothing tells own ship's heading, so the lever arm is not applied: the antenna is up to "
                f"{size:.1f} m from where it is taken to be"
            )
            arm = np.zeros(3)
    swings = len(roll.time_s) > 1 and len(pitch.time_s) > 1
    if not swings and (arm.any() or angles == "deck"):
        effect = []
        if angles == "deck":
            effect.append(
                "shifts elevations by up to 1° and azimuths by up to the tangent of the elevation (0.02° at 1°, 0.18° at 10°)"
            )
        if arm.any():
            effect.append(f"moves the antenna by up to {np.radians(float(np.linalg.norm(arm))):.2f} m")
        words = " and ".join(effect)
        said.append(f"{sensor.name}: nothing tells own ship's roll and pitch, so a level deck is assumed: each degree {words}")
    latitude, longitude = float(own.latitude_rad[first]), float(own.longitude_rad[first])
    height = level + float(arm[2])
    way = trajectories(
        Fixes(
            time_s=own.time_s[there],
            source=np.zeros(int(there.sum())),
            latitude_rad=own.latitude_rad[there],
            longitude_rad=own.longitude_rad[there],
            height_m=np.full(int(there.sum()), level),
            # An address, unlike a track number, stays one target over any pause.
            mode_s=np.ones(int(there.sum())),
            horizontal_sd_m=np.full(int(there.sum()), _OWN_SD_M),
        ),
        max_gap_s=_MAX_GAP_S,
    )
    view = View(
        own=way,
        heading=heading,
        roll=roll if swings else None,
        pitch=pitch if swings else None,
        arm=arm,
        angles=angles,
        site=ecef_from_geodetic(latitude, longitude, height),
        rotation=enu_from_ecef(latitude, longitude),
    )
    fixed = msgspec.structs.replace(
        sensor, lat_deg=float(np.degrees(latitude)), lon_deg=float(np.degrees(longitude)), height_m=height, height_msl_m=None
    )
    return view, fixed, tuple(said)


def platform_views(plots: Plots, platform: Platform, sensors: Sensors) -> tuple[Plots, dict[int, View], Sensors, tuple[str, ...]]:
    """What moving radars among the `plots` need: plots and sensors to go on with, a `View` by sensor id, what is to be said.

    Radars that stand still are left as they are; several may move, each with the platform's rows of its own id.  Bearings that a
    reader has turned by own ship's heading (`Flag.FROM_BOW`) are turned back where `angles` say bow or deck: the heading enters
    once, and with its rates.  A radar whose own ship tells one position only stands there.  Plots at times when what is needed of
    own ship is not known are counted; nothing is compared with them.

    Raises SettingsError where angles are from the bow and nothing tells own ship's heading.
    """
    views: dict[int, View] = {}
    said: list[str] = []
    entries = list(sensors)
    ids = moving(plots, platform)
    azimuth = plots.azimuth_rad
    for k, sensor in enumerate(entries):
        rows = plots.sensor == sensor.key
        if not rows.any():
            continue
        if sensor.key not in ids:
            entries[k] = _standing(platform, sensor, said)
            continue
        view, entries[k], words = view_of(platform, sensor)
        views[sensor.key] = view
        said += words
        time = plots.time_s[rows]
        for what, known in view.known(time).items():
            if not known.all():
                count = f"{np.count_nonzero(~known):,} of {len(known):,} plots"
                said.append(f"{sensor.name}: {count} are at times when the platform's own {what} is not known: not used")
        if view.angles != "north" and (plots.flags[rows] & np.uint32(Flag.FROM_BOW)).any():
            azimuth = azimuth.copy()
            azimuth[rows] = _as_measured(plots[rows], view, sensor.time_offset_s)
    if azimuth is not plots.azimuth_rad:
        plots = plots.replace(azimuth_rad=azimuth)
    return plots, views, msgspec.structs.replace(sensors, sensor=tuple(entries)), tuple(said)


def _as_measured(plots: Plots, view: View, moved_s: float = 0.0) -> FloatArray:
    """Azimuths (n,) from what they were measured from: a heading that a reader has added to them is taken off again.

    The stamps were later by `moved_s` when it was added, and it was taken from straight lines between the reports.
    """
    added = (plots.flags & np.uint32(Flag.FROM_BOW)) != 0
    if view.angles == "north" or not added.any():
        return plots.azimuth_rad
    time = plots.time_s + moved_s
    heading = np.where(view.heading.at(time)[1], np.interp(time, view.heading.time_s, view.heading.reported), np.nan)
    return np.where(added, wrap_turn(plots.azimuth_rad - heading), plots.azimuth_rad)


def plot_places(plots: Plots, platform: Platform, sensor: Sensor, height_m: FloatArray) -> FloatArray:
    """Where plots (n,) of one moving radar lie: positions (n, 3), ECEF metres.

    By the elevation where one was measured, else on the ellipsoidal height `height_m` (n,): of a radar on a leaning deck both the
    direction and the height depend on the elevation, which is found by Newton's method.  NaN where own ship's place or attitude
    is not known, or no elevation leads to that height.  Raises SettingsError as `view_of` does.
    """
    view, _, _ = view_of(platform, sensor)
    origin, axes = view.pose(plots.time_s)
    azimuth = from_true_north(_as_measured(plots, view), sensor)
    measured = np.isfinite(plots.elevation_rad)
    _, up = height_and_up(origin)
    lean = rotate(axes, up)
    # Level with the antenna, which a leaning deck is not.
    level = -np.arctan2(np.sin(azimuth) * lean[:, 0] + np.cos(azimuth) * lean[:, 1], lean[:, 2])
    elevation = np.where(measured, plots.elevation_rad, level)
    position, missing = origin, np.zeros(len(plots))
    for _ in range(_NEWTON_STEPS):
        polar = np.stack([plots.range_m, azimuth, elevation], axis=1)
        position = position_from_polar(polar, origin, axes)
        height, up = height_and_up(position)
        missing = np.where(measured, 0.0, height_m - height)
        climb = np.einsum("ni,ni->n", rotate(axes, up), enu_jacobian(polar)[:, :, 2])
        step = missing / np.where(np.abs(climb) > 1e-6, climb, np.nan)
        elevation = np.where(measured, elevation, elevation + np.clip(step, -0.3, 0.3))
    return np.where((np.abs(missing) < 0.01)[:, None], position, np.nan)


def _standing(platform: Platform, sensor: Sensor, said: list[str]) -> Sensor:
    """The entry of a radar that does not move, at own ship's only position where it has none of its own."""
    if sensor.angles != "north":
        raise SettingsError(
            f"{sensor.name!r} measures from the bow (angles = {sensor.angles!r}), and its recording tells nothing of own ship",
            where="sensors.toml",
            remedy="Give a recording with own ship's position and heading, or leave angles out.",
        )
    if sensor.lever_arm_m is not None and any(sensor.lever_arm_m):
        said.append(f"{sensor.name}: its recording tells nothing of a moving platform, so lever_arm_m is not used")
    own = platform[(platform.sensor == sensor.key) & np.isfinite(platform.latitude_rad) & np.isfinite(platform.longitude_rad)]
    if sensor.lat_deg is not None or not len(own):
        return sensor
    said.append(f"{sensor.name}: own ship tells one position: the radar is taken to stand there")
    height = sensor.ellipsoidal_height_m
    reported = float(own.height_m[0]) if np.isfinite(own.height_m[0]) else None
    return msgspec.structs.replace(
        sensor,
        lat_deg=float(np.degrees(own.latitude_rad[0])),
        lon_deg=float(np.degrees(own.longitude_rad[0])),
        height_m=reported if height is None else height,
        height_msl_m=None,
    )
