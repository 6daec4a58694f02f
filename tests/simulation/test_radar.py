"""Simulated plots and reports against the truth, with errors, noise and stamps each tested by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.measure import polar_from_enu, wrap_rad
from boresight.model import Channel
from boresight.simulation import Adsb, Airport, Radar, Scenario, Simulated, Traffic, Truth, simulate
from boresight.simulation.radar import geometry_at, site
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
    when = ((seen.plots.time_s - run.truth.epoch_s) - radar.time_offset_s) / (1 + drift)
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


def test_a_radar_that_moves_and_swings_measures_in_its_own_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rates in the antenna's axes against differences of what it measures; plots are taken where its own axes point."""
    from boresight.simulation import radar as module

    def swinging(radar: Radar, truth: Truth, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        origin, level = site(radar)
        way = np.stack([8.0 * seconds, 300.0 * np.sin(seconds / 40.0), 2.0 * np.sin(seconds)], axis=-1)
        roll, zero, one = 0.06 * np.sin(seconds / 1.3), np.zeros_like(seconds), np.ones_like(seconds)
        lean = np.array([[np.cos(roll), zero, -np.sin(roll)], [zero, one, zero], [np.sin(roll), zero, np.cos(roll)]])
        return origin + way @ level, np.moveaxis(lean, -1, 0) @ level

    monkeypatch.setattr(module, "pose", swinging)
    run = scene(BARE)
    seen = run.observations[0]
    assert len(seen.plots) > 1000
    antenna = 2 * np.pi * (seen.plots.time_s - run.truth.epoch_s - 1.25) / 4.0
    assert np.abs(wrap_rad(antenna - seen.plots.azimuth_rad)).max() < 1e-6
    rows = np.flatnonzero((seen.plots.range_m > 15e3) & (seen.seconds > 60.0) & (seen.seconds < 800.0))[::9]
    target, when = seen.target[rows], seen.seconds[rows]
    h = 0.02

    def polar(at: np.ndarray) -> np.ndarray:
        origin, rotation = swinging(BARE, run.truth, at)
        return polar_from_enu(rotate(rotation, run.truth.motion(target, at, 0).position - origin))

    g = geometry_at(run.truth, BARE, target, when)
    inside = (when - h > run.truth.first_s[target]) & (when + h < run.truth.last_s[target])
    before, now, after = polar(when - h), polar(when), polar(when + h)
    across, bend = after - before, after - 2 * now + before
    across[:, 1], bend[:, 1] = wrap_rad(across[:, 1]), wrap_rad(bend[:, 1])
    np.testing.assert_array_equal(now[:, 0], g.range_m)
    # The errors of these plain differences are third and fourth rates times h^2.
    for k, (rate, second) in enumerate([(1e-3, 5e-3), (1e-6, 1e-5), (1e-5, 1e-5)]):
        np.testing.assert_allclose((across / (2 * h))[inside, k], g.rate[inside, k], rtol=1e-3, atol=rate)
        np.testing.assert_allclose((bend / h**2)[inside, k], g.second[inside, k], rtol=1e-3, atol=second)
    ahead, behind = (geometry_at(run.truth, BARE, target[inside], when[inside] + d).second for d in (h, -h))
    np.testing.assert_allclose((ahead - behind)[:, 2] / (2 * h), g.third[inside, 2], rtol=2e-3, atol=1e-5)
