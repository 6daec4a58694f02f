"""Scenes with known errors, straight as pairs: no file, no association.  The motion is exact, the errors are physical.

A plot stamped t was measured at t - time_offset; the terms are evaluated at the true position.  The reference stands where the
target was its latency ago, displaced by a slowly wandering offset of its receiver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef
from boresight.measure import polar_motion, site_of
from boresight.model import Pairs, Plots, Sensor, Sensors
from boresight.terms import TERMS, Geometry

DEG = np.pi / 180
EPOCH = 1.7e9
RADARS = Sensors(
    (
        Sensor(name="A", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=300.0),
        Sensor(name="B", sac=1, sic=2, lat_deg=46.3, lon_deg=15.6, height_m=500.0),
    )
)
SURFACE = Sensors((Sensor(name="SMR", sac=0, sic=7, lat_deg=41.3, lon_deg=2.1, height_m=80.0, kind="surface"),))


@dataclass(frozen=True)
class Errors:
    """What is random: sd of the noise; of each target's own delay (m), latency (s) and offset (m) with its correlation time (s);
    the share of the noise's variance that is correlated in time, over `memory_s`."""

    range_m: float = 30.0
    azimuth_rad: float = 0.07 * DEG
    elevation_rad: float = 0.15 * DEG
    delay_m: float = 0.0
    latency_s: float = 0.0
    offset_m: float = 0.0
    offset_memory_s: float = 400.0
    coloured: float = 0.0
    memory_s: float = 30.0
    mispaired: float = 0.0


WHITE = Errors()
FULL = Errors(delay_m=10.0, latency_s=0.1, offset_m=10.0)


@dataclass(frozen=True)
class Scene:
    """Pairs, sensors, and the true values in SI: sensor name -> term -> value."""

    pairs: Pairs
    sensors: Sensors
    truth: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def airliner(rng: np.random.Generator, duration_s: float = 1800.0) -> tuple[Callable, float, float, float]:
    """A track over the region: position(t) (n, 3) ECEF, begin, end, and the target's length."""
    length = rng.uniform(0.4, 1.0) * duration_s
    begin = rng.uniform(0, duration_s - length)
    course, speed = rng.uniform(0, 2 * np.pi), rng.uniform(110, 250)
    turn = rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-1, 1) * 0.3 * DEG
    x, y = rng.uniform(-90e3, 90e3, 2)
    height, climb = rng.uniform(3e3, 11e3), rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-3, 3)
    return path(46.15, 14.8, x, y, course, speed, turn, height, climb, begin + length / 2), begin, begin + length, 40.0


def path(
    lat: float,
    lon: float,
    x: float,
    y: float,
    course: float,
    speed: float,
    turn: float,
    height: float,
    climb: float,
    middle: float,
) -> Callable:
    """A level circle or straight line through (x, y) metres about a point at time `middle`, as ECEF positions of time."""

    def position(t: np.ndarray) -> np.ndarray:
        s = np.asarray(t) - middle
        half = turn * s / 2
        # The chord of an arc; np.sinc keeps it exact for straight tracks.
        chord = speed * s * np.sinc(half / np.pi)
        east, north = x + chord * np.sin(course + half), y + chord * np.cos(course + half)
        latitude = np.radians(lat) + north / 6371e3
        return ecef_from_geodetic(latitude, np.radians(lon) + east / 6371e3 / np.cos(latitude), height + climb * s)

    return position


def taxiing(rng: np.random.Generator) -> tuple[Callable, float, float, float]:
    """A target on the ground: taxiing at changing speed along a bent way; its length is 10 to 60 m."""
    begin, speed = rng.uniform(0, 3000), rng.uniform(6, 14)
    length_s = rng.uniform(150, 300)
    course = rng.choice([0.4, 1.3, 2.1, 3.5, 4.4, 5.3]) + rng.normal() * 0.05
    turn = rng.normal() * 0.6 * DEG
    x, y = rng.uniform(-1500, 1500, 2)
    wobble, phase = rng.uniform(0.3, 0.8), rng.uniform(0, 6)
    base = path(41.3, 2.1, x, y, course, 1.0, turn / speed, 50.0, 0.0, 0.0)

    def position(t: np.ndarray) -> np.ndarray:
        s = np.asarray(t) - begin - length_s / 2
        return base(speed * (s + wobble * 20 * np.sin(s / 20 + phase)))

    return position, begin, begin + length_s, rng.choice([10.0, 35.0, 40.0, 60.0])


def motion(position: Callable, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity, acceleration (n, 3), ECEF, by central differences."""
    h = 0.5
    p, before, after = position(t), position(t - h), position(t + h)
    return p, (after - before) / (2 * h), (after - 2 * p + before) / h**2


def geometry(sensor: Sensor, position: Callable, t: np.ndarray, length: float) -> Geometry:
    """The target as the sensor sees it at its true times."""
    site, rotation = site_of(sensor)
    p, v, a = motion(position, t)
    polar, rate, second, third = polar_motion((p - site) @ rotation.T, v @ rotation.T, a @ rotation.T)
    # Seen from the antenna the target points where its velocity does, in the antenna's own axes.
    bearing = np.arctan2(*(v @ rotation.T)[:, :2].T) % (2 * np.pi)
    return Geometry(polar[:, 0], polar[:, 1], polar[:, 2], rate, second, third, bearing, np.full(len(t), length), t)


def heading(p: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The course (n,)."""
    lat, lon, _ = geodetic_from_ecef(p)
    east, north, _ = np.einsum("nij,nj->ni", enu_from_ecef(lat, lon), v).T
    return np.arctan2(east, north) % (2 * np.pi)


def wander(rng: np.random.Generator, t: np.ndarray, sd: float, memory_s: float) -> np.ndarray:
    """A Gauss-Markov process (n,) at the times t."""
    out = np.empty(len(t))
    x = rng.normal() * sd
    last = t[0] if len(t) else 0.0
    for k in range(len(t)):
        f = np.exp(-(t[k] - last) / memory_s)
        x = f * x + np.sqrt(max(1 - f * f, 0)) * sd * rng.normal()
        out[k], last = x, t[k]
    return out


def scene(
    seed: int,
    truth: Mapping[str, Mapping[str, float]],
    *,
    sensors: Sensors = RADARS,
    targets: int = 30,
    errors: Errors = FULL,
    track: Callable = airliner,
    scan_s: float = 4.0,
    far_m: float = 150e3,
    near_m: float = 3e3,
    elevation: bool = False,
    stated_sd_m: float = 0.0,
) -> Scene:
    """Pairs of all sensors with targets of `track`; `truth` in SI, sensor name -> term -> value."""
    rng = np.random.default_rng(seed)
    parts = []
    for g in range(targets):
        position, begin, end, length = track(rng)
        delay, latency = rng.normal() * errors.delay_m, rng.normal() * errors.latency_s
        grid = np.arange(begin - 20, end + 21, 5.0)
        offset = np.stack([wander(rng, grid, errors.offset_m, errors.offset_memory_s) for _ in range(2)], axis=1)
        for sensor in sensors:
            t = np.arange(begin + rng.uniform(0, scan_s), end, scan_s)
            place = geometry(sensor, position, t, length)
            keep = (place.range_m < far_m) & (place.range_m > near_m)
            if keep.sum() < 5:
                continue
            t, place = t[keep], Geometry(*(c[keep] for c in place if c is not None))
            n = len(t)
            measured = np.stack([place.range_m + delay, place.azimuth_rad, place.elevation_rad], axis=1)
            late = 0.0
            for name, value in truth.get(sensor.name, {}).items():
                if name == "time_offset":
                    late = value
                else:
                    measured += TERMS[name].columns(place) * value
            for k, sd in enumerate((errors.range_m, errors.azimuth_rad, errors.elevation_rad)):
                measured[:, k] += sd * np.sqrt(1 - errors.coloured) * rng.normal(size=n)
                if errors.coloured:
                    measured[:, k] += wander(rng, t, sd * np.sqrt(errors.coloured), errors.memory_s)
            stamp = t + late
            p, v, a = motion(position, stamp - latency)
            lat, lon, _ = geodetic_from_ecef(p)
            local = enu_from_ecef(lat, lon)
            moved = np.stack([np.interp(stamp, grid, offset[:, 0]), np.interp(stamp, grid, offset[:, 1]), np.zeros(n)], axis=1)
            bad = rng.random(n) < errors.mispaired
            if bad.any():
                # A wrong target: one-sided, so that it would pull, and near enough to hurt.
                measured[bad, 0] += rng.uniform(300, 5000, bad.sum())
                measured[bad, 1] += rng.uniform(0.5 * DEG, 5 * DEG, bad.sum())
            parts.append(
                Pairs(
                    plots=Plots(
                        time_s=EPOCH + stamp,
                        sensor=np.full(n, sensor.key),
                        range_m=measured[:, 0],
                        azimuth_rad=measured[:, 1] % (2 * np.pi),
                        elevation_rad=measured[:, 2] if elevation else np.full(n, np.nan),
                        heading_rad=heading(*motion(position, t)[:2]),
                        length_m=place.length_m,
                        track=np.full(n, g),
                    ),
                    target=np.full(n, g),
                    track=np.full(n, g),
                    position=p + np.einsum("nji,nj->ni", local, moved),
                    velocity=v,
                    acceleration=a,
                    covariance=np.tile(np.eye(3) * stated_sd_m**2, (n, 1, 1)),
                    heading_rad=heading(p, v),
                    length_m=np.full(n, length),
                    plot=np.arange(n),
                )
            )
    pairs = Pairs.concat(parts)
    return Scene(pairs.replace(plot=np.arange(len(pairs))), sensors, truth)


def random_truth(seed: int, *, elevation: bool = False) -> dict[str, dict[str, float]]:
    """Errors of radars A and B, as large as radars have them."""
    rng = np.random.default_rng([seed, 99])
    out = {}
    for name in ("A", "B"):
        out[name] = {
            "range_bias": rng.uniform(-150, 150),
            "range_gain": rng.uniform(-1e-3, 1e-3),
            "azimuth_bias": rng.uniform(-0.6, 0.6) * DEG,
            "azimuth_cos": rng.uniform(-0.1, 0.1) * DEG,
            "azimuth_sin": rng.uniform(-0.1, 0.1) * DEG,
            "time_offset": rng.uniform(-1.0, 1.0),
        } | ({"elevation_bias": rng.uniform(-0.3, 0.3) * DEG} if elevation else {})
    return out
