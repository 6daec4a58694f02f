"""A small scene with known errors: aircraft past one or more radars, and an estimate of the errors by plain least squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from boresight.assessment import Residuals, residuals
from boresight.calibration import Accuracy, Calibration, Input, Noise, NotDetermined, Summary, TermKey
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, rotate, rotate_back
from boresight.measure import polar_motion, sites
from boresight.model import Channel, Pairs, Plots, Sensor, Sensors
from boresight.terms import TERMS, Geometry

START_S = 1_700_000_000.0
TRUTH = {
    "range_bias": 180.0,
    "range_gain": 0.6,
    "azimuth_bias": -0.35,
    "azimuth_cos": 0.12,
    "azimuth_sin": 0.0,
    "time_offset": 0.4,
}


@dataclass(frozen=True)
class Scene:
    pairs: Pairs
    sensors: Sensors
    calibration: Calibration
    residuals: Residuals
    truth: dict[str, dict[str, float]]


def make_scene(
    aircraft: int = 30,
    plots_each: int = 120,
    radars: Sequence[str] = ("Alpha",),
    elevation: bool = False,
    seed: int = 1,
    files: Sequence[str] = ("radar.ast", "adsb.ast"),
    warnings: Sequence[str] = (),
) -> Scene:
    random = np.random.default_rng(seed)
    places = ((45.0, 7.0), (45.6, 7.9), (44.5, 8.2))
    sensors = Sensors(
        tuple(
            Sensor(name=name, lat_deg=places[k][0], lon_deg=places[k][1], height_m=300.0, sac=1, sic=k + 1, kind="combined")
            for k, name in enumerate(radars)
        )
    )
    parts, truth = [], {}
    for k, sensor in enumerate(sensors):
        n = aircraft * plots_each
        target = np.repeat(np.arange(aircraft), plots_each)
        own = np.tile(np.arange(plots_each) * 4.0, aircraft)
        time = START_S + own + random.uniform(0, 3600, aircraft)[target]
        height = random.uniform(2000, 11500, aircraft)[target]
        course = random.uniform(0, 2 * np.pi, aircraft)[target]
        speed = random.uniform(90, 250, aircraft)[target]
        since = own - 2.0 * plots_each + random.uniform(-200, 200, aircraft)[target]
        aside = random.uniform(-70e3, 70e3, aircraft)[target]
        east = aside * np.cos(course) + since * speed * np.sin(course)
        north = -aside * np.sin(course) + since * speed * np.cos(course)
        lat0, lon0 = np.radians(places[0])
        lat, lon = lat0 + north / 6.37e6, lon0 + east / 6.37e6 / np.cos(lat0)
        position = ecef_from_geodetic(lat, lon, height)
        level = enu_from_ecef(lat, lon)
        velocity = rotate_back(level, np.stack([speed * np.sin(course), speed * np.cos(course), np.zeros(n)], axis=1))
        mine = Plots(
            time_s=time,
            sensor=np.full(n, sensor.key),
            channel=np.full(n, Channel.MODE_S),
            range_m=np.ones(n),
            azimuth_rad=np.zeros(n),
        )
        site, rotation = sites(mine, sensors)
        values = {name: value * (1 - 0.6 * k) for name, value in TRUTH.items()} | ({"elevation_bias": 0.2} if elevation else {})
        truth[sensor.name] = values
        late = values["time_offset"]
        g = _geometry(position - late * velocity, velocity, site, rotation)
        measured = np.stack([g.range_m, g.azimuth_rad, g.elevation_rad], axis=1)
        for name, value in values.items():
            if name != "time_offset":
                measured += TERMS[name].columns(g) * value * TERMS[name].si_per_unit
        measured += random.standard_normal((n, 3)) * (60.0, np.radians(0.06), np.radians(0.1))
        measured[:, 0] += 25.0 * random.standard_normal(aircraft)[target]
        parts.append(
            Pairs(
                plot=np.arange(n) + k * n,
                plots=mine.replace(
                    range_m=measured[:, 0], azimuth_rad=measured[:, 1] % (2 * np.pi),
                    elevation_rad=measured[:, 2] if elevation else np.full(n, np.nan),
                ),
                target=target, track=target + 1000 * k, position=position, velocity=velocity, acceleration=np.zeros((n, 3)),
                covariance=np.tile(np.eye(3) * 25.0, (n, 1, 1)), heading_rad=course, length_m=np.full(n, 40.0),
            )
        )  # fmt: skip
    pairs = Pairs.concat(parts)
    calibration = _estimate(pairs, sensors, truth, files, warnings)
    return Scene(pairs, sensors, calibration, residuals(pairs, sensors, calibration), truth)


def _geometry(position: np.ndarray, velocity: np.ndarray, site: np.ndarray, rotation: np.ndarray) -> Geometry:
    enu, v = rotate(rotation, position - site), rotate(rotation, velocity)
    polar, rate, second, third = polar_motion(enu, v, np.zeros_like(v))
    nothing = np.full(len(polar), np.nan)
    return Geometry(polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, nothing, nothing, np.zeros(len(polar)))


def _estimate(
    pairs: Pairs, sensors: Sensors, truth: dict[str, dict[str, float]], files: Sequence[str], warnings: Sequence[str]
) -> Calibration:
    """Ordinary least squares about the true values, with the covariance that goes with it, ten times for the clustering."""
    keys, values, blocks, summaries, missing = [], [], [], [], []
    for sensor in sensors:
        mine = pairs[pairs.plots.sensor == sensor.key]
        site, rotation = sites(mine.plots, sensors)
        g = _geometry(mine.position, mine.velocity, site, rotation)
        names = list(truth[sensor.name])
        sd = np.array([60.0, np.radians(0.06), np.radians(0.1)])
        design = np.stack([TERMS[name].columns(g) * TERMS[name].si_per_unit / sd for name in names], axis=-1)
        left = np.stack([mine.plots.range_m - g.range_m, (mine.plots.azimuth_rad - g.azimuth_rad + np.pi) % (2 * np.pi) - np.pi,
                         mine.plots.elevation_rad - g.elevation_rad], axis=1) / sd  # fmt: skip
        known = np.isfinite(left)
        normal = design[known].T @ design[known] + 1e-9 * np.eye(len(names))
        found = np.linalg.solve(normal, design[known].T @ left[known])
        scale = np.array([TERMS[name].si_per_unit for name in names])
        keys += [TermKey(sensor.key, "all", name, TERMS[name].unit) for name in names]
        values += list(found * scale)
        blocks.append(10 * np.linalg.inv(normal) * np.outer(scale, scale))
        missing.append(NotDetermined(sensor.key, "site_up", "needs plots nearer than 20 km; correlation 0.99 with range_bias"))
        noise = Noise(60.0, float(np.radians(0.06)), float(np.radians(0.1)) if "elevation_bias" in names else float("nan"))
        targets = len(np.unique(mine.target))
        summaries.append(
            Summary(
                sensor=sensor.key, name=sensor.name, model="atc", noise=noise, plots=len(mine), tracks=targets, targets=targets,
                before=Accuracy(0, 0), after=Accuracy(0, 0), notes=("azimuth is quantised to 0.088 deg",),
            )
        )  # fmt: skip
    covariance = np.zeros((len(keys), len(keys)))
    row = 0
    for block in blocks:
        covariance[row : row + len(block), row : row + len(block)] = block
        row += len(block)
    draft = Calibration(tuple(keys), np.array([START_S]), np.array([values]), covariance[None])
    r = residuals(pairs, sensors, draft)
    full = []
    for s in summaries:
        mine = r[r.sensor == s.sensor]
        figures = [(Accuracy(*np.nanpercentile(v, (50, 95)))) if len(mine) else Accuracy(np.nan, np.nan)
                   for v in (mine.distance_before_m, mine.distance_after_m)]  # fmt: skip
        full.append(
            Summary(
                sensor=s.sensor, name=s.name, model=s.model, noise=s.noise, plots=s.plots, tracks=s.tracks, targets=s.targets,
                before=figures[0], after=figures[1], held_out_before_median_m=figures[0].median_m,
                held_out_after_median_m=figures[1].median_m * 1.05, held_out_before_p95_m=figures[0].p95_m,
                held_out_after_p95_m=figures[1].p95_m * 1.06, notes=s.notes,
            )
        )  # fmt: skip
    return Calibration(
        draft.terms, draft.epoch_s, draft.value, draft.covariance, tuple(full), tuple(missing),
        tuple(Input(name, f"{k:064x}", 1000 * (k + 1)) for k, name in enumerate(files)), tuple(warnings),
        {"model": "atc", "robust": "huber", "held_out_folds": 5}, "0.1.0",
    )  # fmt: skip


@pytest.fixture(scope="session")
def scene() -> Scene:
    return make_scene()


@pytest.fixture(scope="session")
def build() -> Callable[..., Scene]:
    return make_scene
