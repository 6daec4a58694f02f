"""Simulated plots and reports against the truth, with errors, noise and stamps each tested by itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from boresight.alignment import locate
from boresight.assessment.detection import RadarEquation
from boresight.association import search
from boresight.errors import SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.measure import polar_from_enu, wrap_rad
from boresight.model import Channel, Pairs, Sensors
from boresight.platform import platform_views
from boresight.registration import register
from boresight.registration.sequential import online_samples, register_online
from boresight.simulation import Adsb, Airport, Radar, Scenario, Simulated, Traffic, Truth, simulate, vessel
from boresight.simulation.demo import demo_scene
from boresight.simulation.drift import Drift, Sine, Step
from boresight.simulation.radar import Clutter, Gaps, Noise, Observation, check_radar, geometry_at, observe_radar, site
from boresight.simulation.vessel import Vessel
from boresight.terms import DEG, TERMS, TIME_TERMS, Geometry
from boresight.writing.asterix import accuracy_sd_m

AIRPORT = Airport(lat_deg=41.297, lon_deg=2.083, height_m=50.0, runway_deg=246.0)
BARE = Radar(
    name="bare", sac=20, sic=1, lat_deg=41.3, lon_deg=2.0, height_m=300.0, scan_s=4.0, max_range_m=250e3, detection=1.0,
    range_sd_m=1e-12, azimuth_sd_deg=1e-12, elevation_sd_deg=1e-12, range_quantum_m=0.0, azimuth_quantum_deg=0.0,
    time_quantum_s=0.0, first_north_s=1.25,
)  # fmt: skip


def changed(radar: Radar, **fields: object) -> Radar:
    return Radar(**({name: getattr(radar, name) for name in radar.__struct_fields__} | fields))


def scene(*radars: Radar, seed: int = 1, duration_s: float = 900.0, aircraft: int = 12, **other: object) -> Simulated:
    traffic = Traffic(aircraft=aircraft, delay_sd_m=0.0)
    return simulate(Scenario(duration_s=duration_s, traffic=traffic, airport=(AIRPORT,), radar=radars, **other), seed)


def residual(run: Simulated, number: int = 0) -> tuple[np.ndarray, Geometry]:
    """Measured minus h(truth at stamp - late) by plain geometry, and the true geometry."""
    radar, seen = run.scenario.radar[number], run.observations[number]
    drift = radar.errors.get("clock_drift", 0.0) * 1e-3 / 3600
    # Late by an offset and a rate of the true time: stamp = true * (1 + drift) + offset.
    when = ((seen.plots.time_s - run.truth.epoch_s) - radar.errors.get("time_offset", 0.0)) / (1 + drift)
    position = run.truth.motion(seen.target, when, 0).position
    place = np.radians([radar.lat_deg, radar.lon_deg])
    enu = rotate(enu_from_ecef(*place), position - ecef_from_geodetic(*place, radar.height_m))
    polar = polar_from_enu(enu)
    p = seen.plots
    left = np.stack([p.range_m - polar[:, 0], wrap_rad(p.azimuth_rad - polar[:, 1]), p.elevation_rad - polar[:, 2]], axis=1)
    return left, geometry_at(run.truth, radar, seen.target, when)


# Values in units of what is plausible of each term.
sizes = st.dictionaries(st.sampled_from([name for name in TERMS if name != "time_offset"]), st.floats(-1.0, 1.0), max_size=8)


@settings(max_examples=12, deadline=None)
@given(st.floats(-2.0, 2.0), sizes)
def test_any_list_of_terms_is_added_exactly(offset_s: float, parts: dict[str, float]) -> None:
    values = {name: part * TERMS[name].prior_sd / TERMS[name].si_per_unit for name, part in parts.items()}
    values["time_offset"] = offset_s
    run = scene(changed(BARE, errors=values), aircraft=6, duration_s=400.0)
    left, geometry = residual(run)
    assert len(left) > 50
    expected = np.zeros_like(left)
    for name, value in values.items():
        if name not in TIME_TERMS:
            expected += value * TERMS[name].si_per_unit * TERMS[name].columns(geometry)
    expected[:, 1] = wrap_rad(expected[:, 1])
    # Rounding of positions of 6,400 km and of ranges of 250 km; the third derivative of such positions is good to 1e-8 m/s^3.
    jerk = [1e-8 * abs(values.get(f"{name}_jerk", 0.0)) for name in ("range", "azimuth", "elevation")]
    across = np.minimum(geometry.range_m * np.cos(geometry.elevation_rad), geometry.range_m)
    assert (np.abs(left[:, 0] - expected[:, 0]) <= 1e-7 + jerk[0]).all()
    for k in (1, 2):
        assert (np.abs(left[:, k] - expected[:, k]) <= 1e-11 + jerk[k] / across).all()


def test_time_offset_is_the_term_for_small_offsets() -> None:
    """The exact offset and the column of the term (METHODS section 6: -rate) agree to first order."""
    run = scene(changed(BARE, errors={"time_offset": 0.01}))
    seen = run.observations[0]
    stamp = seen.plots.time_s - run.truth.epoch_s
    geometry = geometry_at(run.truth, run.scenario.radar[0], seen.target, stamp)
    by_column = 0.01 * TERMS["time_offset"].columns(geometry)
    np.testing.assert_allclose(seen.plots.range_m - geometry.range_m, by_column[:, 0], atol=2e-3)
    far = geometry.range_m > 5e3
    np.testing.assert_allclose(wrap_rad(seen.plots.azimuth_rad - geometry.azimuth_rad)[far], by_column[far, 1], atol=1e-6)


def test_plots_are_taken_when_the_antenna_points_at_the_target() -> None:
    run = scene(BARE)
    seen = run.observations[0]
    stamp = seen.plots.time_s - run.truth.epoch_s
    antenna = 2 * np.pi * (stamp - 1.25) / 4.0
    assert np.abs(wrap_rad(antenna - seen.plots.azimuth_rad)).max() < 1e-6
    for k in np.unique(seen.target):
        mine = seen.target == k
        steps = np.diff(stamp[mine])
        rates = geometry_at(run.truth, run.scenario.radar[0], seen.target[mine], stamp[mine]).rate[:-1, 1]
        once = steps < 6
        # A target that moves with the antenna is met later.
        np.testing.assert_allclose(steps[once], 4.0 * (1 + rates[once] * 4.0 / (2 * np.pi)), atol=0.02)
        # Detection 1: scans are missing only where the target was out of sight.
        assert np.count_nonzero(~once) <= 2


def test_noise_has_the_given_sd_and_no_mean() -> None:
    run = scene(changed(BARE, range_sd_m=40.0, azimuth_sd_deg=0.07, elevation_sd_deg=0.15), aircraft=40, duration_s=2400.0)
    left, _ = residual(run)
    n = len(left)
    assert n > 8000
    for column, sd in enumerate([40.0, 0.07 * DEG, 0.15 * DEG]):
        assert abs(left[:, column].mean()) < 4 * sd / np.sqrt(n)
        assert left[:, column].std() == pytest.approx(sd, rel=4 / np.sqrt(2 * n))
        assert np.count_nonzero(np.abs(left[:, column]) > 3 * sd) / n == pytest.approx(0.0027, abs=0.003)
    np.testing.assert_allclose(left, run.observations[0].noise, atol=1e-6)


def test_quanta_are_those_of_asterix() -> None:
    run = scene(changed(BARE, range_quantum_m=1852 / 256, azimuth_quantum_deg=360 / 65536, time_quantum_s=1 / 128, detection=0.9))
    plots = run.observations[0].plots
    for values in (plots.range_m * 256 / 1852, plots.azimuth_rad / (2 * np.pi) * 65536, plots.time_s * 128):
        np.testing.assert_allclose(values, np.rint(values), rtol=0, atol=1e-6)
    # The truth is taken at the passing, not at the rounded stamp.
    late = plots.time_s - run.truth.epoch_s - run.observations[0].seconds
    assert np.abs(late).max() <= 0.5001 / 128
    assert late.std() == pytest.approx(1 / 128 / np.sqrt(12), rel=0.1)
    assert plots.azimuth_rad.min() >= 0
    assert plots.azimuth_rad.max() < 2 * np.pi


def test_detection_and_limits() -> None:
    run = scene(changed(BARE, detection=0.8, max_range_m=120e3, min_elevation_deg=0.5), aircraft=40, duration_s=2400.0)
    full = scene(changed(BARE, detection=1.0, max_range_m=120e3, min_elevation_deg=0.5), aircraft=40, duration_s=2400.0)
    n = len(full.plots)
    assert len(run.plots) / n == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / n))
    assert full.plots.range_m.max() <= 120e3 + 1e-6
    assert full.plots.elevation_rad.min() >= 0.5 * DEG - 1e-9


@pytest.mark.parametrize(
    ("kind", "channel", "address", "code", "level"),
    [
        ("psr", Channel.PSR, False, False, False),
        ("ssr", Channel.SSR, False, True, True),
        ("mode_s", Channel.MODE_S, True, True, True),
        ("combined", Channel.MODE_S_PSR, True, True, True),
    ],
)
def test_identity_follows_the_kind(kind: str, channel: Channel, address: bool, code: bool, level: bool) -> None:
    run = scene(changed(BARE, kind=kind))
    plots = run.plots
    assert (plots.channel == channel).all()
    assert ((plots.mode_s >= 0) == address).all()
    assert ((plots.mode_3a >= 0) == code).all()
    assert (np.isfinite(plots.pressure_altitude_m) == level).all()
    if address:
        np.testing.assert_array_equal(plots.mode_s, run.truth.aircraft.mode_s[run.plot_target])
    hidden = scene(changed(BARE, kind=kind, identity=False)).plots
    assert (hidden.mode_s == -1).all()
    assert (hidden.mode_3a == -1).all()
    assert (hidden.callsign == -1).all()
    assert (hidden.track > 0).all()


def test_track_numbers_name_one_target_and_change_after_a_gap() -> None:
    run = scene(changed(BARE, detection=0.5), aircraft=30, duration_s=1800.0)
    seen = run.observations[0]
    tracks = np.unique(seen.plots.track)
    assert tracks.min() > 0
    assert tracks.max() < 4096
    for track in tracks:
        mine = seen.plots.track == track
        assert len(np.unique(seen.target[mine])) == 1
        assert np.diff(seen.seconds[mine]).max(initial=0.0) <= 22.0
    assert len(tracks) > len(np.unique(seen.target))


def test_false_plots_have_no_target() -> None:
    run = scene(changed(BARE, kind="psr", false_plots=20.0))
    seen = run.observations[0]
    false = seen.target < 0
    assert np.count_nonzero(false) == pytest.approx(20.0 * 900 / 4, abs=5 * np.sqrt(4500))
    assert (np.diff(seen.plots.time_s) >= 0).all()
    assert (seen.plots.track[false] == -1).all()
    assert (seen.plots.track[~false] > 0).all()


def test_pressure_altitude_is_not_a_height() -> None:
    from boresight.simulation import Atmosphere

    run = simulate(
        Scenario(
            duration_s=600.0,
            traffic=Traffic(aircraft=10, altimetry_sd_m=0.0),
            airport=(AIRPORT,),
            atmosphere=Atmosphere(isa_deviation_k=15.0, shift_m=-20.0),
            radar=(BARE,),
            adsb=Adsb(share=1.0, height_sd_m=0.0),
        ),
        1,
    )
    seen = run.observations[0]
    height = geodetic_from_ecef(run.truth.motion(seen.target, seen.seconds, 0).position)[2]
    high = height > 8000
    assert (height - seen.plots.pressure_altitude_m)[high].mean() > 400
    expected = run.scenario.atmosphere.geometric_m(seen.plots.pressure_altitude_m)
    assert np.abs(height - expected).max() < 17.0  # half of 100 ft, stretched
    # The traffic's own geometric minus pressure difference tells the same.
    fixes = run.fixes
    own = fixes.height_m - run.scenario.atmosphere.geometric_m(fixes.pressure_altitude_m)
    assert np.abs(own).max() < 18.0


def test_transponder_delay_belongs_to_the_aircraft_and_to_secondary_plots() -> None:
    def run(kind: str) -> Simulated:
        traffic = Traffic(aircraft=10, delay_sd_m=50.0)
        return simulate(Scenario(duration_s=600.0, traffic=traffic, airport=(AIRPORT,), radar=(changed(BARE, kind=kind),)), 1)

    secondary, primary = run("mode_s"), run("psr")
    left, _ = residual(secondary)
    np.testing.assert_allclose(left[:, 0], secondary.truth.aircraft.transponder_delay_m[secondary.plot_target], atol=1e-6)
    assert np.abs(residual(primary)[0][:, 0]).max() < 1e-6


def test_height_of_a_3d_radar_is_the_height_of_what_it_measured() -> None:
    run = scene(changed(BARE, height_from_elevation=True, elevation_sd_deg=0.1))
    seen = run.observations[0]
    origin, rotation = site(run.scenario.radar[0])
    polar = np.stack([seen.plots.range_m, seen.plots.azimuth_rad, seen.plots.elevation_rad], axis=1)
    r, a, e = polar.T
    enu = np.stack([r * np.cos(e) * np.sin(a), r * np.cos(e) * np.cos(a), r * np.sin(e)], axis=1)
    np.testing.assert_allclose(geodetic_from_ecef(origin + enu @ rotation)[2], seen.plots.height_m, atol=1e-5)


@pytest.fixture(scope="module")
def reported() -> Simulated:
    adsb = Adsb(share=0.8, classes={"8": 0.25, "9": 0.25, "10": 0.5}, correlated=0.7, correlation_s=120.0, latency_sd_s=0.2)
    traffic = Traffic(aircraft=60)
    return simulate(Scenario(duration_s=3000.0, traffic=traffic, airport=(AIRPORT,), adsb=adsb), 4)


def adsb_error(run: Simulated) -> np.ndarray:
    """East and north errors (n, 2) of the reports against the truth at the stamp less the latency."""
    craft = run.truth.aircraft
    when = run.fixes.time_s - run.truth.epoch_s - craft.latency_s[run.fix_target]
    truth = run.truth.motion(run.fix_target, when, 0).position
    lat, lon, height = geodetic_from_ecef(truth)
    said = ecef_from_geodetic(run.fixes.latitude_rad, run.fixes.longitude_rad, height)
    return rotate(enu_from_ecef(lat, lon), said - truth)[:, :2]


def test_adsb_errors_follow_the_accuracy_class(reported: Simulated) -> None:
    craft, target = reported.truth.aircraft, reported.fix_target
    assert np.count_nonzero(craft.accuracy > 0) == 48
    error = adsb_error(reported)
    scaled = error / reported.fixes.horizontal_sd_m[:, None]
    np.testing.assert_allclose(reported.fixes.horizontal_sd_m, accuracy_sd_m(craft.accuracy[target]))
    # 48 tracks of about 14 correlation times each, two axes.
    assert scaled.std() == pytest.approx(1.0, abs=0.12)
    # What is new in every report: half the mean squared step from report to report.
    steps, apart = [], []
    for k in np.unique(target):
        mine = np.flatnonzero(target == k)
        near = np.diff(reported.fixes.time_s[mine]) < 1.2
        steps.append(np.diff(scaled[mine], axis=0)[near].ravel())
        later = np.searchsorted(reported.fixes.time_s[mine], reported.fixes.time_s[mine] + 60.0)
        good = later < len(mine)
        apart.append((scaled[mine][later[good]] * scaled[mine][good]).ravel())
    white = np.mean(np.concatenate(steps) ** 2) / 2
    assert white == pytest.approx(0.3 + 0.7 * (1 - np.exp(-0.75 / 120)), rel=0.05)
    assert np.concatenate(apart).mean() == pytest.approx(0.7 * np.exp(-60 / 120), abs=0.15)


def test_adsb_stamps_gaps_and_latency(reported: Simulated) -> None:
    fixes, target = reported.fixes, reported.fix_target
    np.testing.assert_array_equal(fixes.time_s * 128, np.rint(fixes.time_s * 128))
    assert (np.diff(fixes.time_s) >= 0).all()
    each = {k: np.diff(fixes.time_s[target == k]) for k in np.unique(target)}
    for k, mine in each.items():
        assert np.median(mine) == pytest.approx(reported.truth.aircraft.interval_s[k], rel=0.05)
        assert 0.5 <= reported.truth.aircraft.interval_s[k] <= 1.0
    steps = np.concatenate(list(each.values()))
    assert steps.min() > 0.43
    assert np.count_nonzero(steps > 5.0) > 20, "gaps"
    latency = reported.truth.aircraft.latency_s
    assert latency.std() == pytest.approx(0.2, rel=0.35)
    assert ((fixes.mode_s >= 0) & (fixes.track > 0)).all()


def test_same_seed_same_tables_other_seed_others() -> None:
    def tables(seed: int) -> bytes:
        run = scene(changed(BARE, range_sd_m=30.0), adsb=Adsb(), seed=seed)
        return b"".join(np.ascontiguousarray(c).tobytes() for t in (run.plots, run.fixes) for _, c in t._flat())

    assert tables(5) == tables(5)
    assert tables(5) != tables(6)


def test_another_radar_changes_nothing_of_the_first() -> None:
    one, two = scene(changed(BARE, range_sd_m=30.0)), scene(changed(BARE, range_sd_m=30.0), changed(BARE, name="second", sic=2))
    np.testing.assert_array_equal(one.observations[0].plots.range_m, two.observations[0].plots.range_m)


SHIP = Vessel(
    lat_deg=41.0, lon_deg=2.5, height_m=50.0, speed_mps=8.0, course_deg=50.0, turn_degps=0.05, roll_deg=4.0, pitch_deg=1.5,
    yaw_deg=1.0, heave_m=1.0, lever_arm_m=(20.0, 2.0, 15.0), angles="deck", report_s=0.2, position_sd_m=0.5,
    heading_sd_deg=0.05, roll_sd_deg=0.05, pitch_sd_deg=0.05,
)  # fmt: skip


def changed_ship(**fields: object) -> Vessel:
    return Vessel(**{"lat_deg": BARE.lat_deg, "lon_deg": BARE.lon_deg, **fields})


ABOARD = changed(BARE, lat_deg=41.0, lon_deg=2.5, height_m=50.0, platform=SHIP)


def test_a_radar_that_moves_and_swings_measures_in_its_own_axes() -> None:
    """Rates in the antenna's axes against differences of what it measures; plots are taken where its own axes point."""
    run = scene(ABOARD)
    seen = run.observations[0]
    ship = seen.radar.platform
    assert len(seen.plots) > 1000
    antenna = 2 * np.pi * (seen.plots.time_s - run.truth.epoch_s - 1.25) / 4.0
    assert np.abs(wrap_rad(antenna - seen.plots.azimuth_rad)).max() < 1e-6
    rows = np.flatnonzero((seen.plots.range_m > 15e3) & (seen.seconds > 60.0) & (seen.seconds < 800.0))[::9]
    target, when = seen.target[rows], seen.seconds[rows]
    h = 0.02

    def polar(at: np.ndarray) -> np.ndarray:
        origin, rotation = vessel.pose(ship, at)
        return polar_from_enu(rotate(rotation, run.truth.motion(target, at, 0).position - origin))

    g = geometry_at(run.truth, seen.radar, target, when)
    inside = (when - h > run.truth.first_s[target]) & (when + h < run.truth.last_s[target])
    before, now, after = polar(when - h), polar(when), polar(when + h)
    np.testing.assert_allclose(seen.plots.range_m[rows], now[:, 0], atol=1e-6)
    across, bend = after - before, after - 2 * now + before
    across[:, 1], bend[:, 1] = wrap_rad(across[:, 1]), wrap_rad(bend[:, 1])
    # The errors of these plain differences are third and fourth rates times h^2.
    for k, (rate, second) in enumerate([(1e-3, 5e-3), (1e-6, 1e-5), (1e-5, 1e-5)]):
        np.testing.assert_allclose((across / (2 * h))[inside, k], g.rate[inside, k], rtol=1e-3, atol=rate)
        np.testing.assert_allclose((bend / h**2)[inside, k], g.second[inside, k], rtol=1e-3, atol=second)
    ahead, behind = (geometry_at(run.truth, seen.radar, target[inside], when[inside] + d).second for d in (h, -h))
    np.testing.assert_allclose((ahead - behind)[:, 2] / (2 * h), g.third[inside, 2], rtol=2e-3, atol=1e-5)


def test_a_ship_at_rest_is_a_site_and_reports_it() -> None:
    site_alone = changed(ABOARD, platform=None, range_sd_m=30.0)
    rest = Vessel(lat_deg=41.0, lon_deg=2.5, height_m=50.0, speed_mps=0.0)
    still, moored = (scene(r).observations[0] for r in (site_alone, changed(site_alone, platform=rest)))
    np.testing.assert_array_equal(still.target, moored.target)
    np.testing.assert_allclose(still.plots.range_m, moored.plots.range_m, atol=1e-5)
    np.testing.assert_allclose(still.plots.azimuth_rad, moored.plots.azimuth_rad, atol=1e-9)
    np.testing.assert_allclose(moored.marks.latitude_rad, still.marks.latitude_rad, atol=1e-12)
    assert len(still.own_ship) == 0
    np.testing.assert_allclose(np.degrees(moored.own_ship.latitude_rad), 41.0, atol=1e-9)
    assert (moored.own_ship.sensor == moored.plots.sensor[0]).all()


def test_errors_are_found_from_aboard() -> None:
    errors = {"range_bias": 40.0, "azimuth_bias": 0.5, "time_offset": 0.2}
    radar = changed(ABOARD, range_sd_m=30.0, azimuth_sd_deg=0.1, elevation_sd_deg=None, max_range_m=60e3, errors=errors)
    run = scene(radar, aircraft=30, adsb=Adsb(share=1.0, latency_sd_s=0.0))
    seen = run.observations[0]
    assert len(np.unique(seen.target)) > 10
    plots, views, sensors, _ = platform_views(seen.plots, seen.own_ship, run.sensors)
    pairs = search(plots, locate(run.fixes, sensors)[0], sensors, views=views).pairs
    found = register(pairs, sensors, model=tuple(errors))
    for name, true in errors.items():
        k = found.index(radar.sensor.key, name)
        assert k is not None
        assert abs(found.value[0, k] - true * TERMS[name].si_per_unit) < 4 * found.sd[0, k], name
        assert found.sd[0, k] < 0.2 * abs(true) * TERMS[name].si_per_unit


def table(seen: Observation) -> bytes:
    columns = [column for _, column in seen.plots._flat()] + [seen.target, seen.seconds, seen.noise, *seen.marks]
    return b"".join(np.ascontiguousarray(column).tobytes() for column in columns)


def test_options_that_say_nothing_new_give_the_same_bytes() -> None:
    """A drift that is a constant, noise that is white, gaps that never come: all go the new ways, and to the same plots."""
    plain = demo_scene(2)
    idle: dict[str, object] = {"noise": {"all": Noise()}, "gaps": Gaps(outage_s=((9e6, 9.1e6),), blind_deg=((50.0, 50.0),))}
    radars = tuple(
        changed(radar, **idle, false_plots=3.0, errors={n: Drift(value=v) for n, v in radar.errors.items()})
        for radar in plain.radar
    )
    noisy = tuple(changed(radar, false_plots=3.0) for radar in plain.radar)
    before = simulate(changed_scene(plain, duration_s=600.0, radar=noisy), 5)
    after = simulate(changed_scene(plain, duration_s=600.0, radar=radars), 5)
    assert [table(o) for o in before.observations] == [table(o) for o in after.observations]
    assert len(before.plots) > 2000


def changed_scene(scenario: Scenario, **fields: object) -> Scenario:
    return Scenario(**({name: getattr(scenario, name) for name in scenario.__struct_fields__} | fields))


RESTLESS = Drift(
    value=0.2, ramp_per_h=0.4, sine=(Sine(amplitude=0.1, period_s=200.0),), step=(Step(at_s=500.0, by=0.3),), walk_per_sqrt_h=0.1
)


def off_truth(truth: Truth, radar: Radar, seen: Observation) -> np.ndarray:
    """Measured minus the truth at the passings (n, 3)."""
    g = geometry_at(truth, radar, seen.target, seen.seconds)
    p = seen.plots
    left = [p.range_m - g.range_m, wrap_rad(p.azimuth_rad - g.azimuth_rad), p.elevation_rad - g.elevation_rad]
    return np.stack(left, axis=1)


def left_over(run: Simulated) -> tuple[np.ndarray, Observation]:
    """The same of a scene's first radar, and its observation."""
    return off_truth(run.truth, run.scenario.radar[0], run.observations[0]), run.observations[0]


def test_a_drifting_term_is_in_every_plot_as_its_history_says() -> None:
    run = scene(changed(BARE, errors={"azimuth_bias": RESTLESS, "range_gain": Drift(ramp_per_h=2.0), "elevation_bias": -0.1}))
    left, seen = left_over(run)
    t = seen.seconds
    np.testing.assert_allclose(left[:, 1] / DEG, seen.errors["azimuth_bias"](t), atol=1e-9)
    gain = 2.0 * t / 3600 * 1e-3
    np.testing.assert_allclose(left[:, 0], gain * (seen.plots.range_m - left[:, 0]), atol=1e-6)
    np.testing.assert_allclose(left[:, 2] / DEG, -0.1, atol=1e-9)
    known = 0.2 + 0.4 * t / 3600 + 0.1 * np.sin(2 * np.pi * t / 200) + 0.3 * (t >= 500)
    walk = left[:, 1] / DEG - known
    assert 0.003 < np.abs(walk).max() < 0.3
    order = np.argsort(t)
    assert np.abs(np.diff(walk[order]) / np.sqrt(np.diff(t[order]) + 1.0)).max() < 6 * 0.1 / 60


def test_late_stamps_may_drift_and_jump() -> None:
    late = Drift(value=0.4, ramp_per_h=2.0, sine=(Sine(amplitude=0.05, period_s=100.0),), step=(Step(at_s=400.0, by=-90.0),))
    run = scene(changed(BARE, kind="combined", false_plots=10.0, errors={"time_offset": late}))
    seen = run.observations[0]
    t = seen.seconds
    told = 0.4 + 2.0 * t / 3600 + 0.05 * np.sin(2 * np.pi * t / 100) - 90.0 * (t >= 400)
    np.testing.assert_allclose(seen.plots.time_s - run.truth.epoch_s - t, told, atol=5e-7)
    false = seen.target < 0
    assert np.count_nonzero(false) > 500
    assert np.abs(left_over(run)[0][~false]).max() < 1e-6, "the truth is that of the passing"
    # A radar tells its plots in the order of measuring, whatever its clock does.
    assert (np.diff(t) >= 0).all()
    assert np.diff(seen.plots.time_s).min() < -80
    marks = seen.marks.time_s - run.truth.epoch_s
    assert marks[0] == pytest.approx(1.25 + 0.4 + 2.0 * 1.25 / 3600 + 0.05 * np.sin(2 * np.pi * 1.25 / 100), abs=1e-6)
    assert np.diff(marks).min() < -80


def test_a_clock_s_rate_adds_up() -> None:
    rate = Drift(value=200.0, ramp_per_h=4000.0, step=(Step(at_s=300.0, by=-500.0),))
    seen = (run := scene(changed(BARE, errors={"clock_drift": rate}))).observations[0]
    t = seen.seconds / 3600
    late = 200.0 * t + 4000.0 * t**2 / 2 - 500.0 * np.maximum(t - 300 / 3600, 0)
    np.testing.assert_allclose(seen.plots.time_s - run.truth.epoch_s - seen.seconds, late * 1e-3, atol=5e-7)
    assert np.abs(left_over(run)[0]).max() < 1e-6


def test_a_stuck_clock_and_one_of_another_day() -> None:
    run = scene(changed(BARE, time_sd_s=0.01, stuck_s=((200.0, 260.0),), errors={"time_offset": -86400.0}))
    seen = run.observations[0]
    since = seen.plots.time_s - run.truth.epoch_s + 86400.0
    stuck = (seen.seconds >= 200) & (seen.seconds < 260)
    assert np.count_nonzero(stuck) > 50
    np.testing.assert_allclose(since[stuck], 200.0, atol=1e-6)
    assert (since - seen.seconds)[~stuck].std() == pytest.approx(0.01, rel=0.1)
    assert (np.diff(seen.seconds) >= 0).all()
    np.testing.assert_allclose(left_over(run)[0][:, 1], 0.0, atol=1e-9)


@cache
def sky() -> Truth:
    """Flights enough for the laws of chance."""
    return scene(aircraft=60, duration_s=1500.0).truth


def busy(**fields: object) -> tuple[np.ndarray, Observation]:
    """What is left of many plots, in sds of 10 m, 0.1 degrees and 0.2 degrees, and the observation."""
    radar = changed(BARE, scan_s=2.0, range_sd_m=10.0, azimuth_sd_deg=0.1, elevation_sd_deg=0.2, **fields)
    seen = observe_radar(sky(), radar, np.random.default_rng(1))
    left = off_truth(sky(), radar, seen)
    np.testing.assert_allclose(left, seen.noise, atol=1e-6)
    return left / [10.0, 0.1 * DEG, 0.2 * DEG], seen


def test_noise_of_student_t_has_its_sd_and_tails() -> None:
    left, _ = busy(noise={"range": Noise(t_degrees=5.0)})
    n = len(left)
    assert n > 15_000
    assert left[:, 0].std() == pytest.approx(1.0, abs=0.03)
    # The law itself: Kolmogorov's distance to t with 5 degrees and unit variance, and to the normal law.
    assert stats.kstest(left[:, 0] / np.sqrt(3 / 5), stats.t(5).cdf).pvalue > 1e-3
    assert stats.kstest(left[:, 0], stats.norm.cdf).pvalue < 1e-6
    # Of 5 degrees the excess is 6, of which a sample shows a part; the others stay normal.
    assert stats.kurtosis(left[:, 0]) > 2
    assert np.abs(stats.kurtosis(left[:, 1:])).max() < 6 * np.sqrt(24 / n)


def test_noise_of_a_track_is_correlated_as_told() -> None:
    left, seen = busy(noise={"all": Noise(correlated=0.7, correlation_s=20.0), "elevation": Noise()})
    assert left.std(axis=0) == pytest.approx(1.0, abs=0.05)
    order = np.lexsort((seen.seconds, seen.target))
    left, target, t = left[order], seen.target[order], seen.seconds[order]
    for lag in (1, 5, 15):
        apart = t[lag:] - t[:-lag]
        both = (target[lag:] == target[:-lag]) & (apart < 2.1 * lag)
        mine = (left[lag:] * left[:-lag])[both].mean(axis=0)
        expected = 0.7 * np.exp(-apart[both] / 20.0).mean()
        assert mine[:2] == pytest.approx(expected, abs=0.06)
        assert mine[2] == pytest.approx(0.0, abs=0.04)


def test_outliers_are_a_share_and_come_on_top() -> None:
    left, _ = busy(noise={"azimuth": Noise(outliers=0.1, outlier_factor=8.0)})
    n = len(left)
    assert left[:, 1].var() == pytest.approx(1 + 0.1 * 63, rel=0.1)
    # Beyond 4 sds of the others there are, of the outliers, all beyond half their own sd.
    share = 0.1 * 2 * stats.norm.sf(0.5)
    assert np.mean(np.abs(left[:, 1]) > 4) == pytest.approx(share, abs=4 * np.sqrt(share / n))
    assert left[:, 0].std() == pytest.approx(1.0, abs=0.03)
    seen = observe_radar(sky(), changed(BARE, time_sd_s=0.02, noise={"time": Noise(t_degrees=4.0)}), np.random.default_rng(1))
    late = (seen.plots.time_s - sky().epoch_s - seen.seconds) / 0.02
    assert stats.kstest(late * np.sqrt(2), stats.t(4).cdf).pvalue > 1e-3


def test_detection_falls_with_range_as_the_radar_equation_says() -> None:
    law = RadarEquation(pd=0.8, range_m=90e3, pfa=1e-6, swerling=1)
    radar = changed(BARE, scan_s=2.0, max_range_m=200e3)
    every, some = (observe_radar(sky(), r, np.random.default_rng(1)) for r in (radar, changed(radar, detection=law)))
    edges = np.arange(20e3, 200e3, 15e3)
    total, seen = (np.histogram(o.plots.range_m, edges)[0] for o in (every, some))
    chance = np.histogram(every.plots.range_m, edges, weights=law.probability(every.plots.range_m))[0]
    assert (total > 200).all()
    sd = np.sqrt(np.maximum(chance * (1 - chance / total), 1.0))
    assert (np.abs(seen - chance) < 4 * sd).all()
    assert seen[0] / total[0] > 0.99
    assert seen[-1] / total[-1] < 0.25


def test_clutter_has_places_of_its_own() -> None:
    area = Clutter(range_m=(8e3, 20e3), azimuth_deg=(340.0, 30.0), plots=12.0, places=40, scatter_m=20.0)
    radar = changed(BARE, kind="psr", min_range_m=1000.0, errors={"range_bias": 500.0}, clutter=(area,))
    seen = (run := scene(radar)).observations[0]
    clutter = seen.target < 0
    scans = 900.0 / 4.0
    # Each scan a binomial number out of 40.
    assert np.count_nonzero(clutter) == pytest.approx(12.0 * scans, abs=5 * np.sqrt(scans * 12 * (1 - 12 / 40)))
    p = seen.plots[clutter]
    assert p.range_m.min() > 8e3 + 500 - 120
    assert p.range_m.max() < 20e3 + 500 + 120
    assert (((np.degrees(p.azimuth_rad) + 21.5) % 360) < 53).all(), "across north"
    assert (p.track == -1).all()
    assert np.isfinite(p.elevation_rad).all()
    antenna = 2 * np.pi * (p.time_s - run.truth.epoch_s - 1.25) / 4.0
    assert np.abs(wrap_rad(antenna - p.azimuth_rad)).max() < 1e-5
    # The same 40 places in the first and in the second half: none of the second is far from all of the first.
    east, north = (p.range_m - 500) * np.sin(p.azimuth_rad), (p.range_m - 500) * np.cos(p.azimuth_rad)
    first = p.time_s - run.truth.epoch_s < 450
    apart = np.hypot(east[~first, None] - east[first], north[~first, None] - north[first]).min(axis=1)
    assert np.quantile(apart, 0.99) < 60.0
    assert (np.diff(seen.plots.time_s) >= 0).all()


def test_nothing_comes_in_gaps_and_blind_sectors() -> None:
    gaps = Gaps(outage_s=((100.0, 160.0),), every_s=60.0, length_s=15.0, blind_deg=((350.0, 20.0), (90.0, 95.0)))
    area = Clutter(range_m=(2e3, 90e3), plots=20.0, places=200)
    radar = changed(BARE, kind="psr", scan_s=2.0, false_plots=20.0, clutter=(area,))
    full, seen = (observe_radar(sky(), r, np.random.default_rng(1)) for r in (radar, changed(radar, gaps=gaps)))
    begin, end = seen.outage_s.T
    assert len(full.outage_s) == 0
    assert len(begin) - 1 == pytest.approx(25, abs=4 * 5)
    assert (100.0, 160.0) in set(map(tuple, seen.outage_s))
    for times in (seen.seconds, seen.marks.time_s - sky().epoch_s):
        silent = ((times[:, None] >= begin) & (times[:, None] < end)).any(axis=1)
        assert not silent.any()
    azimuth = np.degrees(seen.plots.azimuth_rad)
    for first, width in ((350.0, 30.0), (90.0, 5.0)):
        # Clutter stands still while it is measured; its scatter is a part of where it is.
        assert not ((azimuth - first - 1e-6) % 360 < width - 2e-6).any()
    # What is left is what there was, without these.
    silent = ((full.seconds[:, None] >= begin) & (full.seconds[:, None] < end)).any(axis=1)
    where = np.degrees(full.plots.azimuth_rad)
    blind = ((where - 350.0) % 360 <= 30.0) | ((where - 90.0) % 360 <= 5.0)
    np.testing.assert_array_equal(seen.plots.range_m, full.plots.range_m[~silent & ~blind])


ALL_AT_ONCE: dict[str, object] = {
    "range_sd_m": 20.0, "azimuth_sd_deg": 0.05, "elevation_sd_deg": 0.1, "detection": RadarEquation(), "time_sd_s": 0.01,
    "noise": {"all": Noise(correlated=0.5, t_degrees=6.0, outliers=0.02)}, "clutter": (Clutter(range_m=(5e3, 20e3)),),
    "gaps": Gaps(every_s=200.0, blind_deg=((10.0, 20.0),)), "false_plots": 5.0,
    "errors": {"azimuth_bias": RESTLESS, "time_offset": Drift(walk_per_sqrt_h=0.2)},
}  # fmt: skip


def test_what_one_radar_and_one_term_draw_is_theirs_alone() -> None:
    radar = changed(BARE, **ALL_AT_ONCE)
    alone, again, beside = scene(radar), scene(radar), scene(radar, changed(radar, name="second", sic=2))
    assert table(alone.observations[0]) == table(again.observations[0]) == table(beside.observations[0])
    assert table(scene(radar, seed=2).observations[0]) != table(alone.observations[0])
    t = np.linspace(0.0, 900.0, 100)
    mine, second = (o.errors["azimuth_bias"](t) for o in beside.observations)
    assert np.abs(mine - second).max() > 1e-3, "the second radar walks its own way"
    more = changed(
        BARE, errors={"range_bias": Drift(walk_per_sqrt_h=5.0), "azimuth_bias": RESTLESS}, noise={"all": Noise(outliers=0.5)}
    )
    np.testing.assert_array_equal(scene(more).observations[0].errors["azimuth_bias"](t), mine)


def pairs_of(run: Simulated) -> Pairs:
    """The first radar's plots with the truth itself as the reference, taken when the stamps say."""
    seen = run.observations[0]
    since = seen.plots.time_s - run.truth.epoch_s
    inside = (seen.target >= 0) & (since > run.truth.first_s[seen.target]) & (since < run.truth.last_s[seen.target])
    plots, target, since = seen.plots[inside], seen.target[inside], since[inside]
    motion = run.truth.motion(target, since)
    n = len(plots)
    return Pairs(
        plot=np.arange(n), plots=plots, target=target, track=target, position=motion.position, velocity=motion.velocity,
        acceleration=motion.acceleration, covariance=np.zeros((n, 3, 3)), length_m=run.truth.length_m[target],
        heading_rad=run.truth.course_rad(motion.position, motion.velocity), source=np.full(n, 5339),
    )  # fmt: skip


def test_registration_finds_the_mean_of_a_slow_ramp() -> None:
    errors = {"range_bias": Drift(value=60.0, ramp_per_h=-40.0), "azimuth_bias": Drift(value=0.1, ramp_per_h=0.1)}
    radar = changed(BARE, range_sd_m=30.0, azimuth_sd_deg=0.06, elevation_sd_deg=None, errors=errors)
    run = scene(radar, aircraft=40, duration_s=1800.0)
    found = register(pairs_of(run), Sensors((radar.sensor,)), model="range_bias,azimuth_bias")
    seen = run.observations[0]
    for k, key in enumerate(found.terms):
        true = seen.errors[key.name](seen.seconds).mean() * TERMS[key.name].si_per_unit
        assert abs(found.value[0, k] - true) < 4 * found.sd[0, k], key.name
        spread = seen.errors[key.name](seen.seconds).std() * TERMS[key.name].si_per_unit
        assert found.sd[0, k] < spread, "good enough to tell the mean from the ends"


def test_online_registration_follows_a_sine() -> None:
    bias = Drift(value=0.3, sine=(Sine(amplitude=0.25, period_s=900.0),))
    radar = changed(
        BARE, range_sd_m=30.0, azimuth_sd_deg=0.06, elevation_sd_deg=None,
        errors={"azimuth_bias": bias, "range_bias": 80.0},
    )  # fmt: skip
    run = scene(radar, aircraft=40, duration_s=2700.0)
    samples = online_samples(pairs_of(run), Sensors((radar.sensor,)))
    found = register_online(samples[radar.sensor.key], radar.sensor)
    k = next(i for i, key in enumerate(found.terms) if key.name == "azimuth_bias")
    since = found.epoch_s - run.truth.epoch_s
    steady = since > 200.0
    true = run.observations[0].errors["azimuth_bias"](since)
    off = np.degrees(found.value[:, k]) - true
    assert np.count_nonzero(steady) > 50
    assert np.sqrt(np.mean(off[steady] ** 2)) < 0.02, "of an amplitude of 0.25"
    best = np.degrees(found.value[steady, k])
    assert np.corrcoef(best, true[steady])[0, 1] > 0.99


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"errors": {"azimuth_bias": Drift(sine=(Sine(amplitude=1.0, period_s=-3.0),))}}, "errors.azimuth_bias: .*period_s"),
        ({"errors": {"azimuth_bias": float("nan")}}, "errors.azimuth_bias: .*no finite number"),
        ({"detection": 1.5}, "detection: detection = 1.5 is not within"),
        ({"detection": RadarEquation(pd=1.0)}, "detection: radar equation: pd = 1.0 at .* pd lies between"),
        ({"noise": {"doppler": Noise()}}, "noise.doppler: there is no noise 'doppler'. Known: range"),
        ({"noise": {"elevation": Noise()}, "elevation_sd_deg": None}, "noise.elevation: needs a radar that measures"),
        ({"noise": {"all": Noise(t_degrees=2.0)}}, "noise.all: t_degrees = 2 has no sd. Give more than 2"),
        ({"noise": {"all": Noise(correlated=1.2)}}, "noise.all: needs correlated within 0"),
        ({"noise": {"all": Noise(outliers=-0.1)}}, "noise.all: needs outliers within 0"),
        ({"clutter": (Clutter(range_m=(5e3, 900e3)),)}, "clutter.0: range_m must rise"),
        ({"clutter": (Clutter(range_m=(5e3, 9e3), plots=60.0),)}, "clutter.0: plots = 60 a scan cannot come from 50 places"),
        ({"clutter": (Clutter(range_m=(5e3, 9e3), scatter_m=-1.0),)}, "clutter.0: needs .* scatter_m not below 0"),
        ({"gaps": Gaps(outage_s=((30.0, 20.0),))}, "gaps: outage_s needs pairs"),
        ({"gaps": Gaps(every_s=-1.0)}, "gaps: needs every_s"),
        ({"gaps": Gaps(blind_deg=((float("nan"), 20.0),))}, "gaps: blind_deg needs"),
        ({"platform": changed_ship(roll_deg=80.0)}, "platform: roll_deg = 80.0 is not within 0"),
        ({"platform": changed_ship(lat_deg=41.5)}, "platform: starts at lat_deg = 41.5, lon_deg = 2.0, and the radar elsewhere"),
        ({"stuck_s": ((30.0, 30.0),)}, "stuck_s: stuck_s needs pairs"),
    ],
)
def test_what_cannot_be_is_said(fields: dict[str, object], text: str) -> None:
    check_radar(changed(BARE, **ALL_AT_ONCE), "here")
    with pytest.raises(SettingsError, match=f"^here: {text}"):
        check_radar(changed(BARE, **fields), "here")


def test_no_target_and_no_plot_are_no_trouble() -> None:
    radar = changed(BARE, **{**ALL_AT_ONCE, "clutter": (), "false_plots": 0.0, "gaps": Gaps(blind_deg=((0.0, 360.0),))})
    assert len(scene(radar).plots) == 0
    # A marine radar where no ship sails sees its clutter.
    seen = observe_radar(scene(radar).truth, changed(BARE, **ALL_AT_ONCE, kind="marine"), np.random.default_rng(1))
    assert len(seen.plots) > 100
    assert (seen.target == -1).all()
