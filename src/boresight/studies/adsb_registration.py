"""Paper 001: a primary radar registered on ADS-B traffic, in four scenes, by the paper's method, its rivals and ours.

Ninety airliners within 100 km train each method, ninety others at the same time test it.  METHODS section 4.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import frames
from .._types import FloatArray
from ..assessment.distribution import distribution
from ..association import search
from ..association.cluster import Traces, TrackMatch
from ..calibration import Calibration
from ..compute import Result
from ..correction import correct
from ..errors import SettingsError
from ..filters import (
    AlphaBeta,
    ConstantVelocity,
    ExpectedMode,
    alpha_beta_filter,
    imm_filter,
    kalman_filter,
    matrices,
    one_point,
    smooth_models,
)
from ..geodesy import ecef_from_geodetic, rotate, rotate_back
from ..measure import enu_from_polar, polar_from_enu, site_of, wrap_rad
from ..model import Pairs, Plots, Sensor, Sensors
from ..registration import LeastSquares, register
from ..registration.likelihood import KalmanTransform, MaximumLikelihood
from ..registration.rigid import Clouds, Genetic, RansacIcp, Rigid, joint_fit
from ..report.drawing import (
    AFTER,
    AFTER_LIGHT,
    BEFORE,
    BEFORE_LIGHT,
    INK,
    QUIET,
    Drawing,
    axes_grid,
    band,
    legend,
    line,
    style,
    to_svg,
)
from ..simulation import Simulated, association_scene, simulate
from ..targets import targets_of
from ..terms import TERMS, Geometry
from .table import Row, Settings, Study, row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DEG = np.pi / 180
PAPER = "Zhang & Huang 2024, Error registration for primary radar based on ADS-B data (paper 001)"
RADAR = Sensor(name="radar", sac=1, sic=1, lat_deg=31.0, lon_deg=121.0, height_m=50.0)
SENSORS = Sensors((RADAR,))
SITE, ROTATION = site_of(RADAR)
TRACKS, SCANS, SCAN_S = 90, 90, 4.0
# Nearer ones would make the raw angles larger than those that METHODS states.
NEAR_M, FAR_M = 20e3, 100e3
_EARTH_M = 6371e3
_EPOCH_S = 1.7e9
TIME_S = SCAN_S * np.arange(SCANS, dtype=np.float64)
OFFSET_M = np.array([200.0, 200.0, 400.0])
LATE_S = 0.3
SCENES = ("scene 1", "scene 2", "white", "time")
METHODS = ("raw", "paper's method", "maximum likelihood [6]", "transform matrix [7]", "alpha-beta", "NLS online", "NLS offline")
QUANTITIES = (("range", "m"), ("elevation", "°"), ("azimuth", "°"))
_HEIGHT = 3
# One model for all four scenes: what a scene does not have must come out as nothing.
MODEL = (
    "range_bias", "azimuth_bias", "elevation_bias", "tilt_north", "tilt_east", "site_east", "site_north", "site_up",
    "time_offset",
)  # fmt: skip
# An antenna 400 m too low and an elevation bias are both wanted, though in some traffic their estimates correlate by 0.95.
ESTIMATOR = LeastSquares(max_correlation=0.99)
# METHODS section 4: mean absolute errors that must be kept, in range m, elevation °, azimuth °.
LIMITS = {
    "NLS online": {
        "scene 1": (30.0, 0.032, 0.035),
        "scene 2": (45.0, 0.055, 0.048),
        "white": (34.0, 0.085, 0.045),
        "time": (18.0, 0.085, 0.045),
    },
    "NLS offline": {
        "scene 1": (14.0, 0.010, 0.018),
        "scene 2": (21.0, 0.018, 0.025),
        "white": (17.0, 0.032, 0.025),
        "time": (8.0, 0.032, 0.023),
    },
}
# The paper's table 1, of a real radar whose raw errors are those of the scene "white"; and seconds per 100 tracks.
PRINTED: dict[str, tuple[float, float, float]] = {
    "raw": (51.56, 0.24, 0.18),
    "paper's method": (52.81, 0.04, 0.07),
    "maximum likelihood [6]": (55.26, 0.19, 0.07),
    "transform matrix [7]": (58.44, 0.09, 0.07),
    "alpha-beta": (53.69, 0.18, 0.13),
}
PRINTED_S = {"transform matrix [7]": 2.23, "maximum likelihood [6]": 0.22, "alpha-beta": 0.04, "paper's method": 2.07}
# Section 3.1: seconds for about 90 tracks of the simulated scenes.
SIMULATED_S = {"transform matrix [7]": 2.08, "maximum likelihood [6]": 0.20, "alpha-beta": 0.035, "paper's method": 1.88}
REFERENCE_HEIGHT_M = 800.0
# Airliners fly straight, climb steadily, and turn by up to a degree and a half a second.
FILTER = ExpectedMode(rates_deg_s=(-3.0, -1.5, 0.0, 1.5, 3.0), group=3, noise=0.03, noise_up=1e-3, stay=0.99)
_SPEED_SD, _CLIMB_SD = 200.0, 10.0


# Of 90 radar tracks so many have ADS-B, and every so many scans are clustered.
_WITH_ADSB, _EVERY = 72, 3
_RADIAL_M, _RADIAL_MPS, _RADIAL_HEIGHT_M = 26.5e3, 150.0, 9e3


def run(settings: Settings) -> Study:
    """Table 1, figures 1 and 3 to 5, the scenes of the paper's section 3, its association, and what the data cannot tell."""
    rows: list[Row] = []
    runs, fits = (2, 4) if settings.quick else (12, 32)
    table: dict[str, FloatArray] = {}
    courses: dict[str, FloatArray] = {}
    seconds: dict[str, FloatArray] = {}
    ratios: dict[str, float] = {}
    estimates: list[Row] = []
    for scene in SCENES:
        course, ratio, cost = settings.runs(Trial(scene), runs, f"{scene}, all methods", chunk=1)
        courses[scene] = course.mean(axis=0)
        table[scene] = courses[scene].mean(axis=1)
        # The least: the first run compiles kernels, and other programs may run at the same time.
        seconds[scene] = cost.min(axis=0)
        ratios[scene] = float(ratio.max())
        off, covariance, kept = settings.runs(Fits(scene), fits, f"{scene}, our estimates", chunk=2)
        _estimates(scene, off, covariance, kept, settings.quick, estimates)
    every_s = np.min(list(seconds.values()), axis=0)
    _table_1(table["white"], every_s, rows)
    for scene in SCENES:
        _errors(scene, table[scene], rows)
    _compare(table, rows)
    rows += estimates
    _verdicts(table, every_s, rows)
    _times(np.minimum(seconds["scene 1"], seconds["scene 2"]), rows)
    _genetic(ratios, rows)
    _bias_in_prediction(settings, rows)
    angles = _distributions(settings, rows)
    _association(settings, rows)
    _limits(settings, rows)
    figures = (
        _figure_1(angles),
        *(_course_figure(*which, courses[which[1]]) for which in _COURSES),
        _figure(table),
    )
    return Study(
        name="adsb-registration",
        title="A primary radar registered on ADS-B traffic",
        paper=PAPER,
        summary=(
            "Least squares of named terms in measurement space, with the same filter behind it, is at least as good as the "
            "paper's rigid transform where the errors are a rigid transform, and better where they are the radar's own: a "
            "rigid transform cannot represent a polar bias, and knows no time.",
            "The genetic algorithm over the tracks' transforms finds what one joint rigid fit finds.",
            "The bias in every prediction (eq. 7) corrects nothing: the filter's velocity absorbs it.",
            "K-medoids pairs the tracks that have ADS-B, and a third of those that have none; the search over biases pairs "
            "the former only, at ten times the bias.",
        ),
        rows=tuple(rows),
        figures=figures,
        remarks=(
            "Table 1 and figure 5 of the paper are of a real radar; the scene “white” has its raw errors, and so stands beside "
            "them. Figures 3 to 5 print no numbers.",
            "The columns of Table 1 are range, elevation and azimuth; “Gaussian noise of mean 50 m” is noise of that sd; eq. 7's "
            "bias is applied to the measurement once.",
            "Table 1's ranges do not reproduce: all four methods are printed worse than no correction at all. Noise of 64 m has "
            "a mean size of 51 m, which any filter takes down; only one without a filter stays there, as [6] does here.",
            "The paper's elevation of 0.04° does not reproduce with its own method: a rigid transform leaves 0.09° of a bias of "
            "0.18°. What is left of noise of 0.24° after our own correction is 0.03° with the smoother, 0.07° online.",
            "The scene “time” is to have raw errors of 40 m in range: with 64 m of noise and 0.3 s they are 61 m, so its noise "
            "is 30 m here; angles as in “white”.",
            "Offsets of hundreds of metres are not linear in polar coordinates at short range: ours is fitted a second time "
            "about the antenna's position found first.",
            "Figure 1's mixture needs several parts only where there are outliers: one bias and normal noise are one normal.",
            "Height of the antenna and elevation bias correlate by 0.95 in some traffic: ours keeps both (max_correlation = "
            "0.99, where the default would name one of them as not determined).",
            "The equations of [6] and [7] are not in the paper: ours are the plain readings of what it says of them. Ours of [7] "
            "takes milliseconds where 2.23 s are printed: the times tell of the programs, not of the methods.",
            "The paper does not say of what a track's percentage of matches is taken. Of its votes: a third of the tracks "
            "without ADS-B are paired with whatever flies nearest. Of all its plots: they vote too seldom to be paired, but "
            "neither are the tracks whose height is measured too badly for the screen.",
        ),
    )


# ------------------------------------------------------------------------------------------------------------------ the scenes
@dataclass(frozen=True)
class Traffic:
    """Airliners (n,): straight, a third with one turn, a third climbing or descending; positions of any times."""

    start: FloatArray
    course: FloatArray
    speed: FloatArray
    turn: FloatArray
    begin: FloatArray
    lasts: FloatArray
    height: FloatArray
    climb: FloatArray

    def ecef(self, time_s: FloatArray) -> FloatArray:
        """Positions (n, K, 3) at times (n, K)."""
        course, speed, turn = self.course[:, None], self.speed[:, None], self.turn[:, None]
        begin, end = self.begin[:, None], (self.begin + self.lasts)[:, None]
        turning = np.clip(time_s, begin, end) - begin
        way = _arc(course, speed, 0.0 * turn, np.minimum(time_s, begin)) + _arc(course, speed, turn, turning)
        way += _arc(course + turn * turning, speed, 0.0 * turn, np.maximum(time_s - end, 0.0))
        east, north = np.moveaxis(way + self.start[:, None], -1, 0)
        latitude = np.radians(RADAR.lat_deg or 0.0) + north / _EARTH_M
        longitude = np.radians(RADAR.lon_deg or 0.0) + east / _EARTH_M / np.cos(latitude)
        return ecef_from_geodetic(latitude, longitude, self.height[:, None] + self.climb[:, None] * time_s)

    def enu(self, time_s: FloatArray) -> FloatArray:
        """Positions (n, K, 3) at times (n, K), east, north, up about the radar."""
        return rotate(ROTATION, self.ecef(time_s) - SITE)


def _arc(course: FloatArray, speed: FloatArray, turn: FloatArray, time_s: FloatArray) -> FloatArray:
    """Way (..., 2), east and north, from a course at a turn rate: the chord of the arc."""
    half = turn * time_s / 2
    chord = speed * time_s * np.sinc(half / np.pi)
    return np.stack([chord * np.sin(course + half), chord * np.cos(course + half)], axis=-1)


def draw(rng: np.random.Generator, tracks: int = TRACKS) -> Traffic:
    """Traffic that stays between 20 and 100 km of the radar, spread evenly over that area."""
    n, lasts = tracks * 16, SCAN_S * SCANS
    far, bearing = FAR_M * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    course, speed = rng.uniform(0, 2 * np.pi, n), rng.uniform(190, 250, n)
    turn = np.where(rng.random(n) < 1 / 3, rng.uniform(0.5, 1.5, n) * rng.choice((-1.0, 1.0), n) * DEG, 0.0)
    climb = np.where(rng.random(n) < 1 / 3, rng.uniform(-8, 8, n), 0.0)
    middle = np.stack([far * np.sin(bearing), far * np.cos(bearing)], axis=1)
    half = np.full(n, lasts / 2)
    every = Traffic(
        start=middle - _arc(course, speed, np.zeros(n), half), course=course, speed=speed, turn=turn,
        begin=rng.uniform(0.2, 0.6, n) * lasts, lasts=rng.uniform(20, 60, n), height=rng.uniform(6e3, 11e3, n) - climb * half,
        climb=climb,
    )  # fmt: skip
    distance = np.linalg.norm(every.enu(np.broadcast_to(TIME_S, (n, SCANS))), axis=2)
    inside = np.flatnonzero((distance.max(axis=1) < FAR_M) & (distance.min(axis=1) > NEAR_M))[:tracks]
    return Traffic(*(getattr(every, name)[inside] for name in Traffic.__dataclass_fields__))


@dataclass(frozen=True)
class Errors:
    """A scene's errors: shift (3,) m and rotation vector (3,) rad of the picture, polar bias (3,), lateness, and the noise's sd,
    in metres east, north, up or polar."""

    shift_m: FloatArray
    turn_rad: FloatArray
    polar: FloatArray
    late_s: float
    sd: FloatArray
    cartesian: bool

    def measure(self, rng: np.random.Generator, traffic: Traffic) -> FloatArray:
        """Polar plots (n, K, 3) stamped at `TIME_S`."""
        truth = traffic.enu(np.broadcast_to(TIME_S - self.late_s, (len(traffic.course), SCANS)))
        noise = rng.normal(size=truth.shape) * self.sd
        if not self.cartesian:
            return polar_from_enu(truth) + self.polar + noise
        turned = truth @ rotation_of(self.turn_rad).T
        return polar_from_enu(turned + self.shift_m + noise)

    def covariance(self, plots: FloatArray) -> FloatArray:
        """Covariances (n, K, 3, 3), east, north, up, of polar plots (n, K, 3)."""
        if self.cartesian:
            return np.tile(np.diag(self.sd**2), (*plots.shape[:2], 1, 1))
        flat = plots.reshape(-1, 3)
        spread = np.broadcast_to(np.diag(self.sd**2), (len(flat), 3, 3))
        _, out = frames.convert(flat, spread, frames.Polar(np.zeros(3), np.eye(3)), frames.Ecef())
        return np.asarray(out.reshape(*plots.shape[:2], 3, 3))

    def truth(self) -> FloatArray:
        """The values of `MODEL`, SI.  A turn about the vertical is an azimuth bias, one about the others is tilt."""
        range_m, azimuth, elevation = self.polar
        east, north, up = self.turn_rad
        # The picture is shifted after it was turned; the antenna's displacement is of what is turned.
        site = -rotation_of(self.turn_rad).T @ self.shift_m
        return np.array([range_m, azimuth - up, elevation, east, -north, *site, self.late_s])


def rotation_of(vector: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) of a rotation vector (3,), rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def errors_of(scene: str, rng: np.random.Generator) -> Errors:
    """The errors of one of `SCENES`; the rotation of scene 2 is drawn."""
    none = np.zeros(3)
    turn = rng.uniform(0.2, 0.3, 3) * rng.choice((-1.0, 1.0), 3) * DEG
    angles = (0.088 * DEG, 0.238 * DEG)
    bias = np.array([0.0, 0.18, 0.18]) * DEG
    return {
        "scene 1": Errors(OFFSET_M, none, none, 0.0, np.array([50.0, 50.0, 50.0]), True),
        "scene 2": Errors(OFFSET_M, turn, none, 0.0, np.array([50.0, 100.0, 100.0]), True),
        "white": Errors(none, none, bias, 0.0, np.array([64.0, *angles]), False),
        "time": Errors(none, none, bias, LATE_S, np.array([30.0, *angles]), False),
    }[scene]


def pairs_of(plots: FloatArray, traffic: Traffic, shift: FloatArray) -> Pairs:
    """Polar plots (n, K, 3) with the exact reference at their stamps, moved by `shift` (3,), east, north, up about the radar."""
    n = plots.shape[0] * plots.shape[1]
    stamp = np.broadcast_to(TIME_S, plots.shape[:2])
    h = 0.5
    now, before, after = (traffic.ecef(stamp + d).reshape(n, 3) for d in (0.0, -h, h))
    track = np.repeat(np.arange(len(plots)), SCANS)
    flat = plots.reshape(n, 3)
    return Pairs(
        plots=Plots(
            time_s=_EPOCH_S + stamp.ravel(), sensor=np.full(n, RADAR.key), range_m=flat[:, 0],
            azimuth_rad=np.mod(flat[:, 1], 2 * np.pi), elevation_rad=flat[:, 2], track=track,
        ),
        target=track, track=track, plot=np.arange(n), position=now + rotate_back(ROTATION, shift[None])[0],
        velocity=(after - before) / (2 * h), acceleration=(after - 2 * now + before) / h**2, covariance=np.zeros((n, 3, 3)),
    )  # fmt: skip


# ----------------------------------------------------------------------------------------------------------------- the methods
@dataclass(frozen=True)
class Found:
    """Our estimate: the terms about the antenna's position found first, and that position (3,), east, north, up."""

    calibration: Calibration
    site: FloatArray

    @property
    def value(self) -> FloatArray:
        """Values of `MODEL` (9,), SI; NaN where a term was not determined."""
        out = np.full(len(MODEL), np.nan)
        for key, value in zip(self.calibration.terms, self.calibration.value[0], strict=True):
            out[MODEL.index(key.name)] = value
        return np.asarray(out + np.array([0.0] * 5 + [*self.site, 0.0]))

    @property
    def covariance(self) -> FloatArray:
        """Covariance (9, 9) of `value`."""
        at = [MODEL.index(key.name) for key in self.calibration.terms]
        out = np.full((len(MODEL), len(MODEL)), np.nan)
        out[np.ix_(at, at)] = self.calibration.covariance[0]
        return out

    def correct(self, plots: FloatArray, traffic: Traffic) -> tuple[FloatArray, FloatArray]:
        """Positions (n, K, 3), east, north, up, of polar plots, and the times (K,) when the targets were there."""
        given = pairs_of(plots, traffic, np.zeros(3)).plots
        clean = correct(given, self.calibration, sensors=SENSORS, terms="all")
        polar = np.stack([clean.range_m, clean.azimuth_rad, clean.elevation_rad], axis=1).reshape(plots.shape)
        moved = clean.time_s.reshape(plots.shape[:2])[0] - _EPOCH_S
        return enu_from_polar(polar) + self.site, moved


def least_squares(plots: FloatArray, traffic: Traffic) -> Found:
    """Our default estimator, fitted a second time about the antenna's position that it found."""
    every = pairs_of(plots, traffic, np.zeros(3))
    # A third of the plots is enough for a position about which the rest is linear.
    site = site_found(register(every[::3], SENSORS, model=list(MODEL), settings=ESTIMATOR))
    return Found(register(pairs_of(plots, traffic, -site), SENSORS, model=list(MODEL), settings=ESTIMATOR), site)


def site_found(found: Calibration) -> FloatArray:
    """The antenna's displacement (3,) of a calibration; 0 where it was not determined."""
    at = [found.index(RADAR.key, name) for name in ("site_east", "site_north", "site_up")]
    return np.array([0.0 if k is None else found.value[0, k] for k in at])


def lifted(position: FloatArray, sign: float) -> FloatArray:
    """Positions (..., 3) whose up is the height above the sphere, or back: level flight is then straight in the filter."""
    up = position[..., 2] + sign * (position[..., 0] ** 2 + position[..., 1] ** 2) / (2 * _EARTH_M)
    return np.stack([position[..., 0], position[..., 1], up], axis=-1)


def _start(z: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    x, p = one_point(z[:, 0], r[:, 0], 6, _SPEED_SD)
    p[:, 5, 5] = _CLIMB_SD**2
    return x, p


def followed(position: FloatArray, covariance: FloatArray, *, offline: bool = False) -> FloatArray:
    """Positions (n, K, 3) by the EMA-IMM filter, or by its smoother."""
    z = lifted(position, 1.0)
    if offline:
        mean = smooth_models(z, covariance, TIME_S, FILTER, _start(z, covariance), speed_sd_mps=_SPEED_SD).mean
    else:
        mean = imm_filter(z, covariance, TIME_S, FILTER, _start(z, covariance), covariances=False).mean
    return lifted(mean[..., :3], -1.0)


def mean_errors(position: FloatArray, traffic: Traffic, time_s: FloatArray) -> FloatArray:
    """Mean absolute errors (K, 4) over the targets of positions (n, K, 3) at `time_s` (K,): range m, elevation °, azimuth °,
    height m."""
    truth = traffic.enu(np.broadcast_to(time_s, position.shape[:2]))
    off = polar_from_enu(position) - polar_from_enu(truth)
    off[..., 1] = wrap_rad(off[..., 1])
    up = position[..., 2:] - truth[..., 2:]
    every = np.abs(np.concatenate([off[..., [0, 2, 1]] / np.array([1.0, DEG, DEG]), up], axis=-1))
    return np.asarray(every.mean(axis=0))


def clouds(plots: FloatArray, traffic: Traffic) -> tuple[Clouds, FloatArray]:
    """Clouds of polar plots and the reference at their stamps, and those stamps."""
    stamp = np.broadcast_to(TIME_S, plots.shape[:2])
    seen = Clouds(
        enu_from_polar(plots).reshape(-1, 3), traffic.enu(stamp).reshape(-1, 3), np.repeat(np.arange(len(plots)), SCANS)
    )
    return seen, stamp.ravel()


@dataclass(frozen=True)
class Trial:
    """One scene: errors by scan (runs, methods, K, 4), genetic rms over joint rms (runs,), CPU seconds per 100 tracks (runs,
    methods)."""

    scene: str

    def __call__(self, rng: np.random.Generator, runs: int) -> Result:
        """Arrays with a leading axis of runs."""
        found = [self._one(rng) for _ in range(runs)]
        return tuple(np.array([f[k] for f in found]) for k in range(3))

    def _one(self, rng: np.random.Generator) -> tuple[FloatArray, float, FloatArray]:
        errors = errors_of(self.scene, rng)
        train, test = draw(rng), draw(rng)
        learnt, seen = errors.measure(rng, train), errors.measure(rng, test)
        cloud, stamp = clouds(learnt, train)
        raw, spread = enu_from_polar(seen), errors.covariance(seen)
        out, spent = {"raw": mean_errors(raw, test, TIME_S)}, {"raw": 0.0}

        def took(name: str, begun: float) -> None:
            spent[name] = (time.process_time() - begun) * 100 / TRACKS

        begun = time.process_time()
        rigid = Genetic()(cloud)
        out["paper's method"] = mean_errors(followed(rigid(raw), spread), test, TIME_S)
        took("paper's method", begun)
        begun = time.process_time()
        difference = learnt - polar_from_enu(cloud.reference).reshape(learnt.shape)
        difference[..., 1] = wrap_rad(difference[..., 1])
        likely = MaximumLikelihood()(difference.reshape(-1, 3), np.zeros((difference.size // 3, 3, 3)), cloud.track)
        out["maximum likelihood [6]"] = mean_errors(enu_from_polar(seen - likely.value), test, TIME_S)
        took("maximum likelihood [6]", begun)
        begun = time.process_time()
        turned = KalmanTransform()(cloud, stamp)
        at = np.broadcast_to(TIME_S, seen.shape[:2]).ravel()
        z = lifted(turned(raw.reshape(-1, 3), at).reshape(raw.shape), 1.0)
        # One model has to follow turns too: its noise is that much larger.
        motion = ConstantVelocity(noise=1.0, noise_up=FILTER.noise_up)
        filtered = kalman_filter(z, spread, TIME_S, motion, _start(z, spread))
        out["transform matrix [7]"] = mean_errors(lifted(filtered.mean[..., :3], -1.0), test, TIME_S)
        took("transform matrix [7]", begun)
        begun = time.process_time()
        shifted = raw + (cloud.reference - cloud.measured).mean(axis=0)
        velocity = (shifted[:, 2] - shifted[:, 0]) / (2 * SCAN_S)
        plain = alpha_beta_filter(shifted, TIME_S, AlphaBeta(alpha=0.4, beta=0.1), velocity)
        out["alpha-beta"] = mean_errors(plain[..., :3], test, TIME_S)
        took("alpha-beta", begun)
        begun = time.process_time()
        ours = least_squares(learnt, train)
        clean, moved = ours.correct(seen, test)
        fitted = time.process_time() - begun
        for name, offline in (("NLS online", False), ("NLS offline", True)):
            begun = time.process_time() - fitted
            out[name] = mean_errors(followed(clean, spread, offline=offline), test, moved)
            took(name, begun)
        ratio = rigid.rms_m / _joint(cloud, rigid).rms_m
        return np.array([out[m] for m in METHODS]), ratio, np.array([spent[m] for m in METHODS])


def _joint(cloud: Clouds, rigid: Rigid) -> Rigid:
    """The joint rigid fit of the pairs that a transform rests on."""
    return joint_fit(cloud.take(rigid.inliers))


@dataclass(frozen=True)
class Fits:
    """Our estimates of one scene: errors (runs, 9), their covariances (runs, 9, 9), share of the terms determined (runs,)."""

    scene: str

    def __call__(self, rng: np.random.Generator, runs: int) -> Result:
        """Arrays with a leading axis of runs."""
        off, covariance, kept = [], [], []
        for _ in range(runs):
            errors = errors_of(self.scene, rng)
            train = draw(rng)
            found = least_squares(errors.measure(rng, train), train)
            off.append(found.value - errors.truth())
            covariance.append(found.covariance)
            kept.append(len(found.calibration.terms) / len(MODEL))
        return np.array(off), np.array(covariance), np.array(kept)


# -------------------------------------------------------------------------------------------------------------------- the rows
# What an independent reproduction gave: raw, and the paper's method.
_ELSEWHERE = {
    "scene 1": ((200.0, 0.436, 0.216), (23.0, 0.023, 0.027)),
    "scene 2": ((205.0, 0.428, 0.332), (33.0, 0.041, 0.040)),
    "white": ((51.0, 0.242, 0.182), (43.0, 0.105, 0.040)),
    "time": ((40.0, 0.240, 0.187), (50.0, 0.105, 0.070)),
}


def _errors(scene: str, error: FloatArray, rows: list[Row]) -> None:
    for m, name in enumerate(METHODS):
        for k, (quantity, unit) in enumerate(QUANTITIES):
            limit = LIMITS.get(name, {}).get(scene)
            note = f"an independent reproduction: {' / '.join(f'{v:g}' for v in _ELSEWHERE[scene][m])}" if m < 2 else ""
            rows.append(
                row(f"{scene}-{name}-{quantity}".replace(" ", "-"), f"Mean absolute error, {scene}", name, quantity,
                    float(error[m, k]), high=None if limit is None else limit[k], unit=unit, note=note if k == 0 else "")
            )  # fmt: skip


def _compare(table: dict[str, FloatArray], rows: list[Row]) -> None:
    """Ours over the paper's method: nowhere more than 2 % worse, better where the errors are the radar's own."""
    paper = METHODS.index("paper's method")
    for scene, error in table.items():
        for name in ("NLS online", "NLS offline"):
            for k, (quantity, _) in enumerate(QUANTITIES):
                better = name == "NLS offline" or (scene in ("white", "time") and quantity != "azimuth")
                key = f"against-{scene}-{name}-{quantity}".replace(" ", "-")
                ratio = float(error[METHODS.index(name), k] / error[paper, k])
                table_name = "Ours over the paper's method"
                rows.append(row(key, table_name, f"{scene}, {name}", quantity, ratio, high=1.0 if better else 1.02))


def _estimates(scene: str, off: FloatArray, covariance: FloatArray, kept: FloatArray, quick: bool, rows: list[Row]) -> None:
    known, name = np.isfinite(off), scene.replace(" ", "-")
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    nees = []
    for e, p, k in zip(off, covariance, known, strict=True):
        nees.append(float(e[k] @ np.linalg.solve(p[np.ix_(k, k)], e[k]) / k.sum()))
    # The mean of a chi-squared variable over its degrees of freedom scatters by sqrt(2 / (degrees x runs)).
    room = 2 * np.sqrt(2 / (len(MODEL) * len(off))) if quick else 0.0
    table = "Our estimates"
    note = f"Widened by {room:.2f}, twice the sampling error of {len(off)} runs." if quick else ""
    rows += [
        row(
            f"sd-{name}",
            table,
            scene,
            "largest error over its sd",
            float(np.nanmax(np.abs(off) / sd)),
            high=4.0,
            note=f"of all terms in {len(off)} runs",
        ),
        row(
            f"sd-share-{name}",
            table,
            scene,
            "share of errors within four sd",
            float(np.mean(np.abs(off[known]) <= 4 * sd[known])),
            low=0.99,
        ),
        row(
            f"nees-{name}",
            table,
            scene,
            "NEES / degrees of freedom",
            float(np.mean(nees)),
            low=0.7 - room,
            high=1.5 + room,
            note=note,
        ),
        row(f"kept-{name}", table, scene, "share of terms determined", float(kept.mean())),
    ]
    if scene == "time":
        late = off[:, MODEL.index("time_offset")]
        rows += [
            row("time-found", table, scene, "error of the 0.3 s, rms", float(np.sqrt(np.mean(late**2))), high=0.006, unit="s"),
            row("time-bias", table, scene, "error of the 0.3 s, mean", abs(float(late.mean())), high=0.006, unit="s"),
        ]


def _table_1(error: FloatArray, seconds: FloatArray, rows: list[Row]) -> None:
    table = "Table 1"
    columns = ((*QUANTITIES[0], 60.0), (*QUANTITIES[1], 0.30), (*QUANTITIES[2], 0.30), ("height", "m", REFERENCE_HEIGHT_M))
    for quantity, unit, value in columns:
        rows.append(row(f"table-1-reference-{quantity}", table, "reference accuracy", quantity, None, printed=value, unit=unit))
    for m, name in enumerate(METHODS):
        for k, (quantity, unit, _) in enumerate(columns):
            printed = PRINTED[name][k] if name in PRINTED and k < _HEIGHT else None
            key = f"table-1-{name}-{quantity}".replace(" ", "-")
            rows.append(row(key, table, name, quantity, float(error[m, k]), printed=printed, unit=unit))
    for k, (quantity, _, value) in enumerate(columns):
        ratio = float(error[METHODS.index("NLS online"), k]) / value
        key = f"table-1-within-{quantity}"
        rows.append(row(key, table, "NLS online over the reference accuracy", quantity, ratio, high=1.0))
    for m, name in enumerate(METHODS[1:], start=1):
        rows.append(
            row(
                f"time-{name}".replace(" ", "-"),
                "Table 1: processing of 100 tracks",
                name,
                "processor time",
                float(seconds[m]),
                printed=PRINTED_S.get(name),
                unit="s",
                note="learning and testing, the least of all runs; it is of the machine, and changes" if m == 1 else "",
            )
        )


def _times(seconds: FloatArray, rows: list[Row]) -> None:
    """Section 3.1: the times of the simulated scenes."""
    for name, printed in SIMULATED_S.items():
        key = f"time-90-{name}".replace(" ", "-")
        ours = float(seconds[METHODS.index(name)]) * TRACKS / 100
        rows.append(row(key, "Section 3.1: processing of 90 tracks", name, "processor time", ours, printed=printed, unit="s"))


def _genetic(ratios: dict[str, float], rows: list[Row]) -> None:
    for scene, ratio in ratios.items():
        rows.append(
            row(
                f"genetic-{scene}".replace(" ", "-"),
                "Genetic algorithm",
                scene,
                "rms over that of the joint rigid fit, largest",
                ratio,
                high=1.02,
                note="" if scene != SCENES[0] else "kept as a method, never as the default: it finds what one fit does",
            )
        )


def _word(ratio: float) -> str:
    """How an error that is `ratio` times another is called."""
    return "the same" if abs(ratio - 1) <= 0.02 else "better" if ratio < 1 else "much worse" if ratio > 2 else "worse"


def _verdicts(table: dict[str, FloatArray], seconds: FloatArray, rows: list[Row]) -> None:
    """What the paper's sections 3.1 to 3.3 say of the methods, and what the same comparison says here."""
    at = {name: k for k, name in enumerate(METHODS)}
    paper, six, seven, plain = (at[n] for n in ("paper's method", "maximum likelihood [6]", "transform matrix [7]", "alpha-beta"))
    one, two, real = table["scene 1"], table["scene 2"], table["white"]
    found = [
        ("1-range-6", "scene 1: paper's method against [6]", "range", "slightly worse", one[paper, 0] / one[six, 0], ""),
        ("1-range-7", "scene 1: paper's method against [7]", "range", "slightly worse", one[paper, 0] / one[seven, 0], ""),
        ("1-angles-6", "scene 1: paper's method against [6]", "angles", "better", _angles(one, paper, six),
         "three offsets are no polar bias: a constant of range cannot take them out"),
        ("1-angles-7", "scene 1: paper's method against [7]", "angles", "better", _angles(one, paper, seven), ""),
        ("2-6", "scene 2 against scene 1: [6]", "angles", "much worse", two[six, 1:3].mean() / one[six, 1:3].mean(),
         "it fails in both here"),
        ("2-7", "scene 2 against scene 1: [7]", "angles", "worse", two[seven, 1:3].mean() / one[seven, 1:3].mean(), ""),
        ("2-alpha-beta", "scene 2 against scene 1: alpha-beta", "angles", "worse",
         two[plain, 1:3].mean() / one[plain, 1:3].mean(), ""),
        ("2-paper", "scene 2: paper's method against [7]", "angles", "better", _angles(two, paper, seven), ""),
        ("real-elevation-6", "real radar: [6] against [7]", "elevation", "worse", real[six, 1] / real[seven, 1],
         "no filter, all the noise"),
        ("real-elevation-plain", "real radar: alpha-beta against [7]", "elevation", "worse", real[plain, 1] / real[seven, 1], ""),
        ("real-azimuth", "real radar: paper's method against [7]", "azimuth", "better", real[paper, 2] / real[seven, 2],
         "Table 1 prints 0.07° for both"),
        ("real-range", "real radar: paper's method against raw", "range", "worse", real[paper, 0] / real[at["raw"], 0],
         "52.81 and 51.56 m are printed"),
        ("quick", "paper's method against [7]", "processing time", "better", seconds[paper] / seconds[seven],
         "ours of [7] is a few array operations"),
    ]  # fmt: skip
    for key, name, quantity, printed, ratio, note in found:
        said = f"{_word(float(ratio))} (× {float(ratio):.2f})"
        rows.append(row(f"verdict-{key}", "The paper's verdicts", name, quantity, said, printed=printed, note=note))
    fastest = METHODS[1 + int(np.argmin(seconds[1:5]))]
    rows.append(row("verdict-fastest", "The paper's verdicts", "fastest of the four", "method", fastest, printed="alpha-beta"))


def _angles(error: FloatArray, a: int, b: int) -> float:
    return float((error[a, 1:3] / error[b, 1:3]).mean())


def _bias_in_prediction(settings: Settings, rows: list[Row]) -> None:
    """Eq. 7 as printed in scene 1: the correction added in every prediction, against none, and against one on the measurement."""
    rng = np.random.default_rng([settings.seed, 7])
    errors, traffic = errors_of("scene 1", rng), draw(rng)
    z = enu_from_polar(errors.measure(rng, traffic))
    truth = traffic.enu(np.broadcast_to(TIME_S, z.shape[:2]))
    settled = slice(SCANS // 2, None)
    found = {}
    for name, added, once in (("none", 0.0, 0.0), ("in every prediction", 1.0, 0.0), ("on the measurement once", 0.0, 1.0)):
        position = predicted_with_bias(z - once * OFFSET_M, errors.covariance(z), -added * OFFSET_M)
        off = polar_from_enu(position)[..., 0] - polar_from_enu(truth)[..., 0]
        found[name] = float(np.abs(off[:, settled]).mean())
        rows.append(row(f"eq-7-{name}".replace(" ", "-"), "Eq. 7", f"bias {name}", "range error, settled", found[name], unit="m"))
    rows.append(
        row("eq-7-once-ratio", "Eq. 7", "bias on the measurement once over none", "range error",
            found["on the measurement once"] / found["none"], high=0.3)
    )  # fmt: skip
    rows.append(
        row(
            "eq-7-ratio",
            "Eq. 7",
            "bias in every prediction over none",
            "range error",
            found["in every prediction"] / found["none"],
            low=0.99,
            high=1.01,
            note="The velocity absorbs it: 198.4 m with and 198.4 m without in an independent reproduction.",
        )
    )


def predicted_with_bias(z: FloatArray, r: FloatArray, bias: FloatArray) -> FloatArray:
    """Positions (n, K, 3) by a Kalman filter that adds `bias` (3,) to the position in every prediction (paper 001 eq. 7)."""
    transition, noise = matrices(ConstantVelocity(noise=1.0), SCAN_S)
    x, p = one_point(z[:, 0], r[:, 0], 6, _SPEED_SD)
    out = np.empty_like(z)
    out[:, 0] = x[:, :3]
    for k in range(1, z.shape[1]):
        x = x @ transition.T
        x[:, :3] += bias
        p = transition @ p @ transition.T + noise
        gain = np.swapaxes(np.linalg.solve(p[:, :3, :3] + r[:, k], p[:, :3]), 1, 2)
        x = x + np.einsum("nij,nj->ni", gain, z[:, k] - x[:, :3])
        p = p - gain @ p[:, :3]
        p = (p + np.swapaxes(p, 1, 2)) / 2
        out[:, k] = x[:, :3]
    return out


def _distributions(settings: Settings, rows: list[Row]) -> dict[str, FloatArray]:
    """Figure 1: errors of elevation in the scene "white", clean and with one plot in thirty grossly wrong: how many parts win."""
    rng = np.random.default_rng([settings.seed, 1])
    errors, traffic = errors_of("white", rng), draw(rng)
    off = errors.measure(rng, traffic) - polar_from_enu(traffic.enu(np.broadcast_to(TIME_S, (TRACKS, SCANS))))
    clean = off[..., 2].ravel() / DEG
    spoilt = clean + (rng.random(len(clean)) < 1 / 30) * rng.normal(size=len(clean)) * 1.5
    out = {"errors of the scene “white”": clean, "with one gross error in thirty": spoilt}
    table = "Figure 1: what distribution the errors have"
    for (name, values), (low, high) in zip(out.items(), ((1.0, 1.0), (2.0, None)), strict=True):
        found = distribution(values, most=3, seed=settings.seed)
        key = "clean" if low == 1.0 else "spoilt"
        parts = float(len(found.mixture.share))
        rows += [
            row(
                f"figure-1-parts-{key}",
                "Figure 1: what distribution the errors have",
                name,
                "parts of the mixture by BIC",
                parts,
                low=low,
                high=high,
            ),
            row(f"figure-1-best-{key}", table, name, "best by BIC", found.best),
            row(
                f"figure-1-freedom-{key}",
                "Figure 1: what distribution the errors have",
                name,
                "degrees of freedom of Student t",
                found.student.freedom,
            ),
            row(f"figure-1-kurtosis-{key}", table, name, "excess kurtosis", found.kurtosis),
        ]
    return out


def _figure_1(angles: dict[str, FloatArray]) -> Drawing:
    name = "figure-1"
    with style(name):
        figure, (axes,) = axes_grid(1, 2, 2.8, top=0.62)
        for axis, (title, values) in zip(axes, angles.items(), strict=True):
            found = distribution(values, most=3)
            edges = np.linspace(-1.6, 2.0, 73)
            axis.hist(values, bins=edges.tolist(), density=True, color="#d9dde1")
            x = np.linspace(edges[0], edges[-1], 400)
            t = found.student
            for density, colour, dashes in (
                (np.exp(-0.5 * ((x - found.mean) / found.sd) ** 2) / found.sd / np.sqrt(2 * np.pi), QUIET, "-"),
                (student_density(x, t.location, t.scale, t.freedom), BEFORE, (0, (4, 2))),
                (found.mixture.density(x), AFTER, "-"),
            ):
                axis.plot(x, density, color=colour, linewidth=1.4, linestyle=dashes)
            axis.set_title(title, color=INK)
            axis.set_xlabel("elevation error (°)")
        axes[0].set_ylabel("share per degree")
        entries = [
            (line(QUIET), "normal"),
            (line(BEFORE, style=(0, (4, 2))), "Student t"),
            (line(AFTER), "mixture of normals, K by BIC"),
        ]
        legend(figure, entries)
        svg = to_svg(figure, name)
    return Drawing(
        name,
        svg,
        "The paper's figure 1: errors of elevation, and the distributions fitted to them.",
        "Histograms of elevation errors",
    )


def student_density(x: FloatArray, location: float, scale: float, freedom: float) -> FloatArray:
    """The density of a Student t distribution at values of any shape."""
    from scipy.stats import t

    return np.asarray(t.pdf(x, freedom, location, scale))


# ------------------------------------------------------------------------------------------------------------ the association
@dataclass(frozen=True)
class Clustered:
    """K-medoids in one scene: shares (runs, 2, 3) by the denominators votes and plots of tracks without ADS-B that are paired,
    and of those with ADS-B that are paired right and wrong."""

    scene: str

    def __call__(self, rng: np.random.Generator, runs: int) -> Result:
        """Arrays with a leading axis of runs."""
        return (np.array([self._one(rng) for _ in range(runs)]),)

    def _one(self, rng: np.random.Generator) -> FloatArray:
        errors, traffic = errors_of(self.scene, rng), draw(rng)
        seen = enu_from_polar(errors.measure(rng, traffic))[:, ::_EVERY]
        given = traffic.enu(np.broadcast_to(TIME_S, (TRACKS, SCANS)))[:_WITH_ADSB, ::_EVERY]
        radar, reference = (
            Traces(
                at.reshape(-1, 3), lifted(at, 1.0)[..., 2].ravel(), np.tile(TIME_S[::_EVERY], len(at)),
                np.repeat(np.arange(len(at)), at.shape[1]),
            )
            for at in (seen, given)
        )  # fmt: skip
        matched = TrackMatch(period_s=SCAN_S)(radar, reference)
        right = matched.target == matched.track
        by_votes = matched.target >= 0
        # Plots are at least as many as votes: what passes by plots passes by votes.
        by_plots = by_votes & (matched.share * matched.votes >= TrackMatch().threshold * matched.plots)
        out = []
        for paired in (by_votes, by_plots):
            out.append([
                paired[_WITH_ADSB:].mean(), (paired & right)[:_WITH_ADSB].mean(), (paired & ~right)[:_WITH_ADSB].mean(),
            ])  # fmt: skip
        return np.array(out)


@dataclass(frozen=True)
class Searched:
    """The product's association of 90 aircraft: counts (runs, 4) of tracks with ADS-B, those paired right, pairs, wrong pairs;
    and the sizes of the azimuth bias (runs,), degrees."""

    def __call__(self, rng: np.random.Generator, runs: int) -> Result:
        """Arrays with a leading axis of runs."""
        counts, bias = [], []
        for _ in range(runs):
            seed = int(rng.integers(1 << 31))
            given = simulate(association_scene(seed), seed)
            counts.append(_counted(given))
            bias.append(abs(given.errors["primary"]["azimuth_bias"]))
        return np.array(counts), np.array(bias)


def _counted(given: Simulated) -> tuple[int, int, int, int]:
    """Tracks with ADS-B while they last, those of them whose pairs are of the right aircraft, pairs, and wrong pairs."""
    plots, fixes = given.plots, given.fixes
    found = search(plots, fixes, given.sensors)
    number = targets_of(fixes)
    owner = np.full(int(number.max()) + 1, -2)
    owner[number] = given.fix_target
    correct_pair = owner[found.pairs.target] == given.plot_target[found.pairs.plot]
    with_reference = right = 0
    for track in np.unique(plots.track[plots.track >= 0]):
        rows = np.flatnonzero(plots.track == track)
        own = given.plot_target[rows]
        if len(rows) < 3 or not (own >= 0).any():
            continue
        mine = int(np.bincount(own[own >= 0]).argmax())
        stamps = np.sort(fixes.time_s[given.fix_target == mine])
        if not len(stamps):
            continue
        at = plots.time_s[rows]
        if np.mean(np.searchsorted(stamps, at + 5.0) > np.searchsorted(stamps, at - 5.0)) < 0.5:
            continue
        with_reference += 1
        here = np.isin(found.pairs.plot, rows)
        right += bool(here.any() and np.mean(owner[found.pairs.target[here]] == mine) > 0.5)
    return with_reference, right, len(found.pairs), int((~correct_pair).sum())


def _association(settings: Settings, rows: list[Row]) -> None:
    table = "Association: 90 radar tracks, 18 of them without ADS-B"
    runs = 6 if settings.quick else 48
    shares = {s: settings.runs(Clustered(s), runs, f"{s}, K-medoids", chunk=1)[0] for s in ("scene 1", "white")}
    for d, denominator in enumerate(("of the votes", "of all plots")):
        for scene, found in shares.items():
            for k, what in enumerate(("without ADS-B that are paired", "paired right", "paired wrong")):
                rows.append(
                    row(
                        f"medoids-{scene}-{d}-{k}".replace(" ", "-"),
                        table,
                        f"K-medoids, {scene}, 85 % {denominator}",
                        f"share of tracks {what}",
                        float(found[:, d, k].mean()),
                        low=0.95 if (d, k) == (0, 1) else None,
                        high=0.01 if k == 2 else None,
                    )
                )
    every = np.concatenate([found[:, 0, 0] for found in shares.values()])
    room = 2 * float(every.std(ddof=1)) / np.sqrt(len(every)) if settings.quick else 0.0
    rows.append(
        row(
            "medoids-lone",
            table,
            "K-medoids, both scenes, 85 % of the votes",
            "share of tracks without ADS-B that are paired",
            float(every.mean()),
            low=0.30 - room,
            high=0.39 + room,
            note="why it is not the default" + (f"; widened by {room:.2f}, twice the sampling error" if settings.quick else ""),
        )
    )
    counts, bias = settings.runs(Searched(), 2 if settings.quick else 10, "the search over biases", chunk=1)
    tracks, right, pairs, wrong = (float(v) for v in counts.sum(axis=0))
    name = f"the search over biases, azimuth biases to {bias.max():.1f}°"
    rows += [
        row("search-right", table, name, "share of tracks paired right", right / tracks, low=0.98, note="no identities"),
        row("search-wrong", table, name, "share of pairs that are wrong", wrong / pairs, high=0.01,
            note="all pairs counted, those of tracks without ADS-B too"),
    ]  # fmt: skip


# ------------------------------------------------------------------------------------------------------------------ the limits
def _level(start: FloatArray, course: float, speed: float, height: float) -> Traffic:
    """One airliner that flies level and straight."""
    none = np.zeros(1)
    return Traffic(start[None], np.full(1, course), np.full(1, speed), none, none, none, np.full(1, height), none)


def _radial(settings: Settings, rows: list[Row]) -> None:
    """One track that flies away from the radar: what of its range bias is lateness cannot be told."""
    table = "Limits: one radial track"
    rng = np.random.default_rng([settings.seed, 11])
    bearing = 0.7
    traffic = _level(_RADIAL_M * np.array([np.sin(bearing), np.cos(bearing)]), bearing, _RADIAL_MPS, _RADIAL_HEIGHT_M)
    errors = errors_of("white", rng)
    model = ["range_bias", "azimuth_bias", "elevation_bias", "time_offset"]
    sd, alike, named = [], [], 0
    for _ in range(12):
        pairs = pairs_of(errors.measure(rng, traffic), traffic, np.zeros(3))
        both = register(pairs, SENSORS, model=model, settings=LeastSquares(max_correlation=1.0))
        far, late = (both.index(RADAR.key, name) for name in ("range_bias", "time_offset"))
        if far is not None and late is not None:
            part = both.covariance[0][np.ix_([far, late], [far, late])]
            sd.append(np.sqrt(np.diag(part)))
            alike.append(part[0, 1] / np.sqrt(part[0, 0] * part[1, 1]))
        found = register(pairs, SENSORS, model=model)
        named += any(n.term == "time_offset" for n in found.not_determined)
    mean = np.mean(sd, axis=0)
    rows += [
        row("radial-range", table, "both terms kept", "sd of the range bias", float(mean[0]), low=229.0, high=279.0, unit="m",
            note="254 m and 1.74 s in an independent reproduction"),
        row("radial-time", table, "both terms kept", "sd of the time offset", float(mean[1]), low=1.57, high=1.91, unit="s"),
        row("radial-correlation", table, "both terms kept", "correlation of their estimates", float(np.mean(alike)), low=0.95,
            high=1.0),
        row("radial-named", table, "the default", "share of runs that name the time offset as not determined", named / 12,
            low=1.0, high=1.0, note="and print no number for it"),
    ]  # fmt: skip


def _aliases(rows: list[Row]) -> None:
    table = "Limits: what is another's alias"
    r, a, e = (v.ravel() for v in np.meshgrid([20e3, 60e3, 100e3], np.linspace(0, 6, 13), np.radians([0.0, 2.0, 8.0])))
    none = np.zeros((len(r), 3))
    gone = np.full(len(r), np.nan)
    place = Geometry(r, a, e, none, none, none, gone, gone, np.zeros(len(r)))
    turned, biased = TERMS["rotation_up"].columns(place), TERMS["azimuth_bias"].columns(place)
    rows.append(
        row("alias-columns", table, "rotation about the vertical, azimuth bias", "largest difference of their columns",
            float(np.abs(np.abs(turned) - np.abs(biased)).max()), high=1e-12, note="the same error by two names")
    )  # fmt: skip
    traffic = draw(np.random.default_rng(3), 20)
    errors = errors_of("white", np.random.default_rng(3))
    pairs = pairs_of(errors.measure(np.random.default_rng(4), traffic), traffic, np.zeros(3))
    try:
        kept = [key.name for key in register(pairs, SENSORS, model=["azimuth_bias", "rotation_up"]).terms]
    except SettingsError:
        kept = []
    said = "refused" if not kept else f"only {kept[0]}" if len(kept) == 1 else "both fitted"
    rows.append(row("alias-asked", table, "rotation about the vertical, azimuth bias", "both asked for", said))


def _sector(settings: Settings, rows: list[Row]) -> None:
    """Elevation bias and tilt of traffic all around, and of as many tracks in 30°."""
    rng = np.random.default_rng([settings.seed, 13])
    traffic = draw(rng, 480)
    middle = traffic.enu(np.full((480, 1), TIME_S[-1] / 2))[:, 0]
    bearing = np.mod(np.arctan2(middle[:, 0], middle[:, 1]), 2 * np.pi)
    inside = np.flatnonzero(bearing < 30 * DEG)
    around = np.arange(len(inside))
    sd = []
    for which in (around, inside):
        some = Traffic(*(getattr(traffic, name)[which] for name in Traffic.__dataclass_fields__))
        pairs = pairs_of(errors_of("white", rng).measure(rng, some), some, np.zeros(3))[::3]
        model = ["elevation_bias", "tilt_north", "tilt_east"]
        found = register(pairs, SENSORS, model=model, settings=LeastSquares(max_correlation=1.0))
        at = found.index(RADAR.key, "elevation_bias")
        sd.append(np.inf if at is None else float(np.sqrt(found.covariance[0, at, at])) / DEG)
    table = "Limits: elevation bias and tilt"
    name = f"{len(inside)} tracks in a sector of 30°"
    rows += [
        row("sector-around", table, f"{len(inside)} tracks all around", "sd of the elevation bias", sd[0], high=0.02, unit="°"),
        row("sector-inside", table, name, "sd of the elevation bias", sd[1], unit="°"),
        row("sector-ratio", table, name, "sd over that of tracks all around", sd[1] / sd[0], low=5.0),
    ]


def _pairing(settings: Settings, rows: list[Row]) -> None:
    """Iterated closest points on one straight track, paired by place and by time."""
    table = "Limits: one straight track, 206 m off along it"
    rng = np.random.default_rng([settings.seed, 17])
    along, across = np.array([np.sin(0.7), np.cos(0.7), 0.0]), np.array([np.cos(0.7), -np.sin(0.7), 0.0])
    reference = np.array([10e3, 40e3, 9e3]) + 220.0 * np.outer(np.arange(-180.0, 180.0, 0.25), along)
    offset = 206.0 * along + 100.0 * across + np.array([0.0, 0.0, 100.0])
    left: dict[str, list[float]] = {"nearest": [], "time": []}
    for _ in range(5):
        cloud = Clouds(
            reference + offset + rng.normal(size=reference.shape) * 50.0, reference, np.zeros(len(reference), np.int64)
        )
        for pairing, off in left.items():
            found = RansacIcp(pairing="nearest" if pairing == "nearest" else "time")(cloud)
            off.append(abs(float((found(reference + offset) - reference).mean(axis=0) @ along)))
    rows += [
        row("pairing-nearest", table, "paired with the nearest point (the paper)", "what is left along the track",
            float(np.median(left["nearest"])), low=190.0, unit="m", note="201 of 206 m in an independent reproduction"),
        row("pairing-time", table, "paired by time (ours)", "what is left along the track", float(np.max(left["time"])),
            high=10.0, unit="m"),
    ]  # fmt: skip


def _limits(settings: Settings, rows: list[Row]) -> None:
    """What the data cannot tell, or what a wrong model costs."""
    _radial(settings, rows)
    _aliases(rows)
    _sector(settings, rows)
    _pairing(settings, rows)
    table = "Limits: what a wrong model costs"
    below = np.hypot(_EARTH_M, 100e3) - _EARTH_M
    level = 9e3 - below
    tilted = (np.arcsin((level + 300.0) / 100e3) - np.arcsin(level / 100e3)) / DEG
    about_centre = float(np.linalg.norm(SITE)) * 0.25 * DEG / 1e3
    rows += [
        row("limit-flat-earth", table, "a flat earth at 100 km", "height error", float(below), low=784.0, high=786.0, unit="m"),
        row("limit-pressure", table, "a pressure altitude 300 m off at 100 km", "taken for an elevation bias of", float(tilted),
            low=0.168, high=0.177, unit="°"),
        row("limit-centre", table, "0.25° about the Earth's centre, not the radar", "shift of the picture", about_centre,
            low=27.7, high=27.9, unit="km"),
    ]  # fmt: skip


# ----------------------------------------------------------------------------------------------------------------- the figures
# Name, scene, and what the paper's figure is of.
_COURSES = (
    ("figure-3", "scene 1", "Paper's figure 3: errors over time of each method in its scene 1"),
    ("figure-4", "scene 2", "Paper's figure 4: the same in scene 2, where the picture is turned too"),
    (
        "figure-5",
        "white",
        "Paper's figure 5, of a real radar; here the scene “white”, which has its errors",
    ),
)
_COLOURS = (QUIET, BEFORE, BEFORE_LIGHT, "#d9b38c", "#b9bfc6", AFTER_LIGHT, AFTER)


def _course_figure(name: str, scene: str, caption: str, course: FloatArray) -> Drawing:
    """Mean absolute errors (methods, K, 4) over time."""
    with style(name):
        figure, (axes,) = axes_grid(1, 3, 2.7, top=0.62)
        for k, (axis, (quantity, unit)) in enumerate(zip(axes, QUANTITIES, strict=True)):
            for m, colour in enumerate(_COLOURS):
                axis.plot(TIME_S, course[m, :, k], color=colour, linewidth=1.3, zorder=2 + m)
            axis.set_yscale("log")
            axis.set_title(f"{quantity} ({unit})", color=INK)
            axis.set_xlabel("time (s)")
            axis.set_xlim(0, TIME_S[-1])
            plain_log_axis(axis)
        axes[0].set_ylabel("mean absolute error")
        legend(figure, [(line(c), n) for c, n in zip(_COLOURS, METHODS, strict=True)])
        svg = to_svg(figure, name)
    text = f"{caption}. Mean over {TRACKS} tracks that no method was trained on; a filter's first scans are those of the plots."
    return Drawing(name, svg, text, f"Errors of range, elevation and azimuth over time, {scene}")


def plain_log_axis(axis: Axes) -> None:
    """Label a logarithmic axis at 1, 2 and 5 in plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.yaxis.set_major_locator(LogLocator(10, (1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _figure(table: dict[str, FloatArray]) -> Drawing:
    name = "mean-errors"
    with style(name):
        figure, (axes,) = axes_grid(1, 3, 2.7, top=0.62)
        for k, (axis, (quantity, unit)) in enumerate(zip(axes, QUANTITIES, strict=True)):
            for m in range(len(METHODS)):
                at = np.arange(len(SCENES)) + (m - 3) * 0.12
                axis.bar(at, [table[s][m, k] for s in SCENES], 0.11, color=_COLOURS[m])
            axis.set_xticks(range(len(SCENES)), SCENES)
            axis.set_title(f"{quantity} ({unit})", color=INK)
            axis.set_yscale("log")
            plain_log_axis(axis)
        axes[0].set_ylabel("mean absolute error")
        entries = [(band(c), n) for c, n in zip(_COLOURS, METHODS, strict=True)]
        for handle, _ in entries:
            handle.set_alpha(1.0)
        legend(figure, entries)
        svg = to_svg(figure, name)
    return Drawing(
        name,
        svg,
        "Mean absolute errors of each method on tracks that it was not trained on, in all four scenes.",
        "Mean absolute errors of seven methods in four scenes",
    )
