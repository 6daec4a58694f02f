"""Correction undoes what the error model does: simulate with errors, correct, and be at the truth."""

from __future__ import annotations

import logging

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.calibration import Accuracy, Calibration, Noise, Summary, TermKey
from boresight.correction import correct, correct_and_say
from boresight.errors import InputError
from boresight.measure import heading_about, position_from_polar, site_of, wrap_rad
from boresight.model import Channel, Plots, Sensor, Sensors
from boresight.terms import DEG, TERMS, Geometry

SENSORS = Sensors(
    (Sensor(name="A", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=0.0, north="magnetic", north_offset_deg=3.0),)
)
STILL = [n for n in TERMS if n != "time_offset"]


def calibration(values: dict[str, float], sd: float = 0.1, sensor: int = 257, channel: str = "all") -> Calibration:
    """`values` in SI; each sd is a part of the value."""
    p = len(values)
    value = np.array([list(values.values())])
    return Calibration(
        terms=tuple(TermKey(sensor, channel, n, TERMS[n].unit) for n in values),
        epoch_s=np.array([1.7e9]),
        value=value,
        covariance=np.diag((sd * value[0]) ** 2)[None],
        sensors=(
            Summary(
                sensor=sensor, name="A", model="x", noise=Noise(20.0, 0.05 * DEG, 0.1 * DEG), plots=1, tracks=1, targets=1,
                before=Accuracy(1, 1), after=Accuracy(1, 1),
            ),
        ),
    ) if p else pytest.fail("no terms")  # fmt: skip


def truth(n: int = 200, seed: int = 0) -> Geometry:
    rng = np.random.default_rng(seed)
    zero = np.zeros((n, 3))
    return Geometry(
        rng.uniform(300, 3e5, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0, 70, n) * DEG, zero, zero, zero,
        rng.uniform(0, 2 * np.pi, n), rng.uniform(5, 80, n), np.zeros(n),
    )  # fmt: skip


def measured(g: Geometry, values: dict[str, float], north_rad: float = 0.0, elevation: bool = True) -> Plots:
    polar = np.stack([g.range_m, g.azimuth_rad, g.elevation_rad], axis=1)
    for name, value in values.items():
        if name != "time_offset":
            polar = polar + TERMS[name].columns(g) * value
    n = len(g.range_m)
    return Plots(
        time_s=1.7e9 + np.arange(n) + values.get("time_offset", 0.0),
        sensor=np.full(n, 257),
        range_m=polar[:, 0],
        azimuth_rad=np.mod(polar[:, 1] - north_rad, 2 * np.pi),
        elevation_rad=polar[:, 2] if elevation else np.full(n, np.nan),
        heading_rad=g.heading_rad,
        length_m=g.length_m,
    )


def distance_m(plots: Plots, g: Geometry, north_rad: float = 0.0) -> np.ndarray:
    off = np.stack(
        [
            plots.range_m - g.range_m,
            g.range_m * np.cos(g.elevation_rad) * wrap_rad(plots.azimuth_rad + north_rad - g.azimuth_rad),
            g.range_m * (plots.elevation_rad - g.elevation_rad),
        ],
        axis=1,
    )
    return np.abs(off).max(axis=1)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.sampled_from(STILL), min_size=1, max_size=6, unique=True), st.integers(0, 10**6))
def test_round_trip_to_a_millimetre(names: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    # As large as radars' errors are: a third of the prior sd of each term, site and extent at most a sixth of the range.
    values = {n: float(rng.uniform(-1, 1)) * TERMS[n].prior_sd / 3 for n in names} | {"time_offset": 0.7}
    g = truth(seed=seed)
    clean = correct(measured(g, values), calibration(values))
    assert distance_m(clean, g).max() < 1e-3
    assert np.allclose(clean.time_s, 1.7e9 + np.arange(len(g.range_m)), rtol=0, atol=1e-6)


def test_azimuth_terms_count_from_true_north_and_the_result_stays_in_the_sensors() -> None:
    values = {"azimuth_cos": 0.3 * DEG, "azimuth_sin": -0.2 * DEG, "site_east": 30.0}
    g = truth()
    north = 3.0 * DEG
    plots = measured(g, values, north)
    assert distance_m(correct(plots, calibration(values), sensors=SENSORS), g, north).max() < 1e-3
    # Without sensors.toml the harmonics are turned by the declination.
    assert distance_m(correct(plots, calibration(values)), g, north).max() > 1.0


def test_without_elevation_the_height_places_the_target() -> None:
    """A tilt moves the azimuth by tan E: the elevation comes from the height over the sphere, to parts in a hundred."""
    values = {"tilt_north": 0.5 * DEG}
    g = truth()
    keep = (g.elevation_rad > 1 * DEG) & (g.elevation_rad < 30 * DEG) & (g.range_m < 2e5)
    g = Geometry(*(c[keep] for c in g))
    # Height over a sphere, exactly.
    height = np.sqrt(6371e3**2 + g.range_m**2 + 2 * 6371e3 * g.range_m * np.sin(g.elevation_rad)) - 6371e3
    plots = measured(g, values, elevation=False).replace(height_m=height)
    off = g.range_m * wrap_rad(correct(plots, calibration(values)).azimuth_rad - g.azimuth_rad)
    assert np.abs(off).max() < 1e-2
    raw = g.range_m * wrap_rad(plots.azimuth_rad - g.azimuth_rad)
    assert np.abs(raw).max() > 100


def test_heading_terms_apply_only_where_a_heading_is_known_and_say_so(caplog: pytest.LogCaptureFixture) -> None:
    values = {"along_heading_per_length": -0.4, "range_bias": 5.0}
    g = truth(30)
    heading = g.heading_rad.copy()
    heading[:10] = np.nan
    track = np.arange(30) // 2
    length = g.length_m.copy()
    length[10:20:2] = np.nan  # the other plot of the same track tells
    length[20:22] = np.nan  # nothing tells
    plots = measured(g, values).replace(heading_rad=heading, length_m=length, track=track)
    clean, said = correct_and_say(plots, calibration(values))
    assert len(said) == 1
    assert "12 of 30" in said[0]
    assert "heading" in said[0]
    # Those get the other terms only.
    assert np.allclose(clean.range_m[:10], plots.range_m[:10] - 5.0)
    assert np.allclose(clean.range_m[20:22], plots.range_m[20:22] - 5.0)
    full, none = correct_and_say(measured(g, values), calibration(values))
    assert none == ()
    assert np.allclose(clean.range_m[22:], full.range_m[22:])
    with caplog.at_level(logging.WARNING):
        correct(plots, calibration(values))
    assert "12 of 30" in caplog.text


def test_sd_grow_by_what_the_calibration_does_not_know() -> None:
    values = {"range_bias": 40.0, "range_gain": 1e-3, "azimuth_bias": 0.2 * DEG}
    g = truth(5)
    own = measured(g, values).replace(range_sd_m=np.array([10.0, 10.0, 10.0, np.nan, np.nan]))
    clean = correct(own, calibration(values, sd=0.5))
    # Independent sd: 20 m and 0.5 m/km; the plot's own, or else the sensor's noise.
    base = np.array([10.0, 10.0, 10.0, 20.0, 20.0])
    assert np.allclose(clean.range_sd_m, np.sqrt(base**2 + 20.0**2 + (5e-4 * g.range_m) ** 2), rtol=1e-3)
    assert np.allclose(clean.azimuth_sd_rad, np.hypot(0.05, 0.1) * DEG)


def test_channels_and_other_sensors() -> None:
    values = {"range_bias": 100.0}
    g = truth(6)
    plots = measured(g, values).replace(
        sensor=np.array([257, 257, 257, 257, 9, 9]), channel=np.array([Channel.PSR, Channel.PSR, Channel.SSR, Channel.SSR, 0, 0])
    )
    clean, said = correct_and_say(plots, calibration(values, channel="PSR"))
    assert np.allclose(clean.range_m - plots.range_m, [-100, -100, 0, 0, 0, 0], atol=1e-6)
    assert any("2 plots of SAC/SIC 0/9" in s for s in said)
    assert np.array_equal(clean.azimuth_rad[4:], plots.azimuth_rad[4:])
    with pytest.raises(InputError, match=r"0/9.*A \(1/1\)"):
        correct(plots[4:], calibration(values))
    assert len(correct(plots[:0], calibration(values))) == 0


def test_a_calibration_over_time_is_interpolated_and_held() -> None:
    one = calibration({"range_bias": 10.0})
    both = Calibration(
        terms=one.terms,
        epoch_s=np.array([1.7e9 + 2, 1.7e9 + 4]),
        value=np.array([[10.0], [30.0]]),
        covariance=np.tile(one.covariance, (2, 1, 1)),
        sensors=one.sensors,
    )
    g = truth(7)
    plots = measured(g, {})
    assert np.allclose(plots.range_m - correct(plots, both).range_m, [10, 10, 10, 20, 30, 30, 30])


def test_what_is_not_a_number_stays_so_and_spoils_nothing() -> None:
    values = {"site_east": 50.0, "range_bias": 10.0}
    g = truth(20)
    plots = measured(g, values)
    r = plots.range_m.copy()
    r[3], r[4] = np.nan, np.inf
    clean = correct(plots.replace(range_m=r), calibration(values))
    good = np.ones(20, bool)
    good[3:5] = False
    assert distance_m(clean, g)[good].max() < 1e-3
    assert np.isnan(clean.range_m[3])


def test_a_carried_heading_counts_from_the_north_where_the_target_is() -> None:
    """90 km east of the antenna the norths differ by 0.84 degrees: a long displacement along the heading shows it."""
    site, rotation = site_of(SENSORS.sensor[0])
    polar = np.array([[90e3, 90 * DEG, 1 * DEG]])
    position = position_from_polar(polar, site, rotation)
    heading = np.array([0.3])
    values, none = {"along_heading": 2000.0}, np.zeros((1, 3))
    seen = Geometry(*polar.T, none, none, none, heading_about(heading, position, rotation), np.array([30.0]), np.zeros(1))
    plots = measured(seen, values).replace(heading_rad=heading)
    entry = Sensors((msgspec.structs.replace(SENSORS.sensor[0], north="true", north_offset_deg=0.0),))
    # The correction's sphere and the displaced azimuth leave some centimetres of the 29 m.
    assert distance_m(correct(plots, calibration(values), sensors=entry), seen).max() < 1.0
    assert 20.0 < distance_m(correct(plots, calibration(values)), seen).max() < 35.0
