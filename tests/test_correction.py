"""Correction undoes what the error model does: simulate with errors, correct, and be at the truth."""

from __future__ import annotations

import logging

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.calibration import Accuracy, Calibration, Noise, Summary, TermKey, Verdict, advised, chosen
from boresight.correction import correct, correct_and_say
from boresight.errors import InputError, SettingsError
from boresight.measure import heading_about, position_from_polar, site_of, wrap_rad
from boresight.model import Channel, Flag, Plots, Sensor, Sensors
from boresight.terms import DEG, TERMS, TIME_TERMS, Geometry

SENSORS = Sensors(
    (Sensor(name="A", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=0.0, north="magnetic", north_offset_deg=3.0),)
)
# Terms that plots alone can have taken out, by their place.
STILL = [n for n in TERMS if not TERMS[n].needs & {"rate", "second", "third"}]


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
        if name not in TIME_TERMS:
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
    g = Geometry(*(c[keep] for c in g[:9]))
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
    assert distance_m(full, g).max() < 1e-3
    # A track has one length: the median of what its plots measured.
    mean = np.repeat(g.length_m[22:].reshape(-1, 2).mean(axis=1), 2)
    other = measured(g, values)[22:].replace(length_m=mean)
    assert np.allclose(clean.range_m[22:], correct(other, calibration(values)).range_m)
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
    # A combined plot's position is the secondary radar's; a processing chain is a channel too.
    plots = plots.replace(channel=np.array([1, 2, 3, 4, 0, 0]), flags=np.array([0, 0, int(Flag.CHAIN_2), 0, 0, 0]))
    for channel, moved in (("psr", [0]), ("ssr", [1, 3]), ("mode_s", [2]), ("chain2", [2]), ("chain1", [0, 1, 3])):
        clean = correct(plots, calibration(values, channel=channel))
        assert np.flatnonzero(clean.range_m != plots.range_m).tolist() == moved, channel
    with pytest.raises(InputError, match=r"a channel 'chain7'.*psr"):
        correct(plots, calibration(values, channel="chain7"))
    clean, said = correct_and_say(plots, calibration(values, channel="PSR"))
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


def test_offset_and_drift_of_the_clock_are_out_of_the_stamps() -> None:
    """A drift counts from the calibration's epoch; over its epochs it is interpolated like any other term."""
    n = 50
    true = 1.7e9 + np.linspace(0, 7200, n)
    stamp = true + 0.7 + 30e-3 / 3600 * (true - 1.7e9)
    plots = Plots(time_s=stamp, sensor=np.full(n, 257), range_m=np.full(n, 5e4), azimuth_rad=np.zeros(n))
    clean = correct(plots, calibration({"time_offset": 0.7, "clock_drift": 30e-3 / 3600}))
    assert np.allclose(clean.time_s, true, rtol=0, atol=1e-5)
    assert np.array_equal(clean.range_m, plots.range_m)
    # A plot without a time is corrected in place.
    unknown = plots.replace(time_s=np.full(n, np.nan))
    assert np.allclose(correct(unknown, calibration({"range_bias": 10.0, "time_offset": 0.7})).range_m, 5e4 - 10)


def test_a_clock_that_is_not_well_known_widens_the_sd_along_the_motion() -> None:
    """Against draws: clocks as uncertain as the calibration says scatter the positions of the track by what the sd grow."""
    n, rng = 21, np.random.default_rng(0)
    t = np.arange(n) * 4.0

    def place(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        east, north = 20e3 + 150.0 * t, 30e3 - 200.0 * t
        return np.hypot(east, north), np.arctan2(east, north)

    r, a = place(t)
    plots = Plots(time_s=1.7e9 + t, sensor=np.full(n, 257), range_m=r, azimuth_rad=a, track=np.full(n, 7),
                  range_sd_m=np.full(n, 1e-3), azimuth_sd_rad=np.full(n, 1e-9))  # fmt: skip
    one = calibration({"time_offset": 0.5, "range_bias": 40.0})
    # The two errors are known jointly: of traffic that flies away, a late clock looks like a shorter range.
    sd_s, sd_m, correlation = 0.1, 20.0, 0.8
    covariance = np.array([[sd_s**2, correlation * sd_s * sd_m], [correlation * sd_s * sd_m, sd_m**2]])
    clean, said = correct_and_say(plots, Calibration(one.terms, one.epoch_s, one.value, covariance[None], sensors=one.sensors))
    assert said == ()
    late, far = rng.multivariate_normal(np.zeros(2), covariance, 20_000).T
    # What is left when the clock is later by `late`, and the range longer by `far`, than the calibration has it.
    left = [place(t[k] - late)[0] + far - r[k] for k in (0, n // 2, n - 1)]
    turned = [place(t[k] - late)[1] - a[k] for k in (0, n // 2, n - 1)]
    assert np.allclose(clean.range_sd_m[[0, n // 2, n - 1]], [x.std() for x in left], rtol=0.03)
    assert np.allclose(clean.azimuth_sd_rad[[0, n // 2, n - 1]], [x.std() for x in turned], rtol=0.03)
    # A single plot's motion nothing tells.
    _, said = correct_and_say(plots.replace(track=np.arange(n)), one)
    assert "of the clock is not in the sd of 21 of 21 plots" in said[0]
    # Its own speed and heading do.
    course = np.full(n, np.arctan2(150.0, -200.0))
    carried = plots.replace(track=np.arange(n), speed_mps=np.full(n, 250.0), heading_rad=course)
    alone, said = correct_and_say(carried, Calibration(one.terms, one.epoch_s, one.value, covariance[None], sensors=one.sensors))
    assert said == ()
    assert np.allclose(alone.range_sd_m, clean.range_sd_m, rtol=1e-3)


def test_the_course_of_a_track_tells_where_its_target_points() -> None:
    """An echo has no front: half of these carry the heading of its stern."""
    n = 40
    t = np.arange(n) * 1.0
    east, north = 500 + 8.0 * t, 900 - 6.0 * t
    heading = np.full(n, np.arctan2(8.0, -6.0))
    zero = np.zeros((n, 3))
    g = Geometry(np.hypot(east, north), np.arctan2(east, north), np.zeros(n), zero, zero, zero, heading, np.full(n, 40.0), t)
    values = {"along_heading_per_length": -0.4}
    plots = measured(g, values).replace(
        track=np.zeros(n), length_m=40.0 + 15.0 * np.resize([-1, 0, 1], n)[:n], heading_rad=heading + np.pi * (np.arange(n) % 2)
    )
    assert distance_m(correct(plots, calibration(values)), g).max() < 0.2
    # A target that stands points where its record says, and so does one seen from a radar that moves itself.
    still = plots.replace(track=np.arange(n))
    assert distance_m(correct(still, calibration(values)), g).max() > 20
    moving = Sensors((Sensor(name="A", sac=1, sic=1),))
    assert distance_m(correct(plots, calibration(values), sensors=moving), g).max() > 20
    # Neither a jump nor a number that was given again is motion.
    jump = plots.replace(azimuth_rad=np.resize([0.0, 3.0], n), range_m=np.full(n, 9e4), heading_rad=heading, length_m=g.length_m)
    alone = correct(jump.replace(track=np.arange(n)), calibration(values))
    assert np.array_equal(correct(jump, calibration(values)).range_m.round(6), alone.range_m.round(6))


def test_held_terms_are_not_applied_and_the_others_make_up_for_it() -> None:
    values = {"range_bias": 100.0, "range_gain": 1e-3}
    one = calibration(values)
    verdict = Verdict(channel="all", term="range_gain", decision="hold", why="it gains nothing")
    covariance = np.array([[[100.0, -9e-3], [-9e-3, 1e-6]]])  # correlation -0.9; the gain is 1 sd from zero
    held = Calibration(
        one.terms, one.epoch_s, one.value, covariance,
        sensors=(msgspec.structs.replace(one.sensors[0], verdicts=(verdict,)),),
    )  # fmt: skip
    g = truth(20)
    plots = measured(g, {})
    # Conditional mean by hand: 100 - (-9e-3 / 1e-6) * 1e-3.
    assert np.allclose(plots.range_m - correct(plots, held).range_m, 109.0)
    assert np.allclose(plots.range_m - correct(plots, held, terms="range_bias").range_m, 109.0)
    both = correct(plots, held, terms="all")
    assert np.allclose(plots.range_m - both.range_m, (100 + 1e-3 * plots.range_m) / 1.001)


def test_a_term_of_accelerations_is_said_not_to_be_applied() -> None:
    g = truth(5)
    plots = measured(g, {})
    clean, said = correct_and_say(plots, calibration({"range_lag": 1.0, "range_bias": 10.0}), terms="all")
    assert any("range_lag was not applied" in text for text in said)
    assert np.allclose(plots.range_m - clean.range_m, 10.0)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 7))
def test_what_is_advised_is_what_a_fit_without_the_held_terms_gives(seed: int, held: int) -> None:
    """Least squares with all columns, cut down, against least squares with the kept columns alone; units far apart."""
    rng = np.random.default_rng(seed)
    names = ["range_bias", "range_gain", "azimuth_bias", "azimuth_cos", "azimuth_sin", "time_offset", "site_east", "site_north"]
    scale = np.array([1.0, 1e-3, 1e-3, 1e-4, 1e-4, 0.1, 1.0, 1.0])
    design = rng.normal(size=(60, 8)) @ (np.eye(8) + 0.7 * rng.normal(size=(8, 8))) / scale
    keep = np.ones(8, bool)
    keep[rng.choice(8, held, replace=False)] = False
    # The held ones are not there, and the noise is a third of what the covariance says: nothing contradicts that they are zero.
    y = design @ (scale * rng.normal(size=8) * keep) + rng.normal(size=60) / 3
    full = np.linalg.inv(design.T @ design)
    verdicts = tuple(
        Verdict(channel="all", term=n, decision="apply" if k else rng.choice(["hold", "insufficient"]), why="")
        for n, k in zip(names, keep, strict=True)
    )
    one = calibration(dict.fromkeys(names, 0.0))
    summary = msgspec.structs.replace(one.sensors[0], verdicts=verdicts)
    found = Calibration(one.terms, one.epoch_s, (full @ design.T @ y)[None], full[None], sensors=(summary,))
    less = advised(found)
    own = np.linalg.inv(design[:, keep].T @ design[:, keep])
    assert [k.name for k in less.terms] == [n for n, k in zip(names, keep, strict=True) if k]
    assert np.allclose(less.value[0] / scale[keep], own @ design[:, keep].T @ y / scale[keep], rtol=1e-6, atol=1e-9)
    size = np.sqrt(np.diag(own))
    assert np.allclose(less.covariance[0] / size[:, None] / size, own / size[:, None] / size, atol=1e-7)
    assert np.array_equal(less.covariance[0], less.covariance[0].T)
    by_name = advised(found, [n for n, k in zip(names, keep, strict=True) if k])
    assert np.array_equal(by_name.value, less.value)
    assert advised(found, "all") is found


def test_terms_are_chosen_by_verdict_or_by_name() -> None:
    one = calibration({"range_bias": 1.0, "azimuth_bias": 0.1, "range_lag": 1.0})
    keys = (*one.terms, TermKey(257, "psr", "range_bias", "m"))
    verdicts = (
        Verdict(channel="all", term="azimuth_bias", decision="hold", why="its gain is 0.1 m"),
        Verdict(channel="psr", term="range_bias", decision="insufficient", why=""),
    )
    found = Calibration(
        keys, one.epoch_s, np.ones((1, 4)), np.eye(4)[None],
        sensors=(msgspec.structs.replace(one.sensors[0], verdicts=verdicts),),
    )  # fmt: skip
    take, why = chosen(found)
    assert take.tolist() == [True, False, False, False]
    assert why[1] == "the advice is to hold it: its gain is 0.1 m"
    assert "accelerations" in why[2]
    assert why[3] == "the data are insufficient"
    assert chosen(found, "range_bias")[0].tolist() == [True, False, False, True]
    assert chosen(found, "range_bias@psr, range_lag")[0].tolist() == [False, False, True, True]
    assert chosen(found, "all")[0].all()
    for wrong in ("range_bais", "azimuth_bias@psr", ","):
        with pytest.raises(SettingsError, match=r"range_bias@psr|no term is named"):
            chosen(found, wrong)
    assert len(advised(found, "azimuth_bias").terms) == 1


def test_a_held_term_that_is_there_does_not_spoil_the_others() -> None:
    """A gain of ten sd that is not applied is not zero for that: the others stay as they were found beside it."""
    one = calibration({"range_bias": 100.0, "range_gain": 1e-2, "azimuth_bias": 0.1, "range_lag": 5.0})
    covariance = np.diag([100.0, 1e-6, 1e-4, 1.0])
    covariance[0, 1] = covariance[1, 0] = -9e-3
    covariance[0, 3] = covariance[3, 0] = 8.0
    found = Calibration(one.terms, one.epoch_s, one.value, covariance[None], sensors=one.sensors)
    for terms in ("range_bias,azimuth_bias,range_lag", "range_bias,azimuth_bias"):
        less = advised(found, terms)
        assert less.value[0, 0] == 100.0
        assert less.covariance[0, 0, 0] == pytest.approx(100.0)
    # Several that are each within their sd may together be there all the same.
    both = np.array([[1.0, -0.99], [-0.99, 1.0]])
    pair = calibration({"site_east": 2.0, "site_north": 2.0, "range_bias": 5.0})
    covariance = np.eye(3)
    covariance[:2, :2] = both
    covariance[2, 0] = covariance[0, 2] = 0.05
    found = Calibration(pair.terms, pair.epoch_s, pair.value, covariance[None], sensors=pair.sensors)
    assert advised(found, "range_bias").value[0, 0] == 5.0


def test_plots_without_range_or_azimuth_are_counted() -> None:
    found = calibration({"range_bias": 40.0})
    plots = measured(truth(6), {"range_bias": 40.0})
    plots = plots.replace(range_m=np.where(np.arange(6) < 2, np.nan, plots.range_m))
    clean, said = correct_and_say(plots, found)
    assert any(text.startswith("2 plots have no range or no azimuth") for text in said)
    assert np.isnan(clean.range_m[:2]).all()
