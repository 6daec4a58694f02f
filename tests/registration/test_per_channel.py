"""Paper 000's fitting models: rows against closed forms, ranks at the horizon, the choice of the order, known errors found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import DEG, RADARS, Errors, scene

from boresight import associate, locate
from boresight.errors import NothingToDo, SettingsError
from boresight.measure import polar_motion, site_of
from boresight.model import Sensors
from boresight.registration.observe import observe
from boresight.registration.per_channel import (
    ORDERS,
    PerChannel,
    design,
    distance_correlation,
    normalised_distance,
    register_per_channel,
    solve_safely,
)
from boresight.simulation import Adsb, Radar, Scenario, Traffic, simulate
from boresight.terms import TERMS, Geometry


def place(enu: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> Geometry:
    polar, rate, second, third = polar_motion(enu, velocity, acceleration, order=3)
    n = len(enu)
    return Geometry(
        polar[:, 0],
        polar[:, 1],
        polar[:, 2],
        rate,
        second,
        third,
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.arange(n, dtype=float),
    )


def turning(n: int, up: float = 800.0, rate: float = 0.02) -> Geometry:
    """A turn with a climb near the antenna: all columns differ."""
    t = np.arange(n, dtype=float)
    enu = np.stack([2000 * np.sin(rate * t) + 500, 1500 - 1500 * np.cos(rate * t), up + up / 400 * t], axis=1)
    velocity = np.stack([2000 * rate * np.cos(rate * t), 1500 * rate * np.sin(rate * t), np.full(n, up / 400)], axis=1)
    acceleration = np.stack([-2000 * rate**2 * np.sin(rate * t), 1500 * rate**2 * np.cos(rate * t), np.zeros(n)], axis=1)
    return place(enu, velocity, acceleration)


def at_sea(n: int, rng: np.random.Generator) -> Geometry:
    """A target exactly at the antenna's height, between 1 and 2 km."""
    t = np.arange(n, dtype=float)
    enu = np.stack([900 + 4 * t + rng.normal(size=n), 1200 - 6 * t, np.zeros(n)], axis=1)
    velocity = np.tile([4.0, -6.0, 0.0], (n, 1)) + rng.normal(size=(n, 3)) * [0.3, 0.3, 0]
    acceleration = rng.normal(size=(n, 3)) * [0.1, 0.1, 0]
    return place(enu, velocity, acceleration)


def test_rows_are_those_of_methods_section_3() -> None:
    g = turning(50)
    a, e, one = g.azimuth_rad, g.elevation_rad, np.ones(50)
    r, tan, sec = g.rate, np.tan(e), 1 / np.cos(e)
    first = {
        0: [one],
        1: [one, np.sin(a) * tan, -np.cos(a) * tan, tan, sec],
        2: [one, np.cos(a), np.sin(a)],
    }
    second = {
        0: [one, r[:, 0], sec],
        1: [one, r[:, 1], g.second[:, 1], np.sin(a) * tan, np.cos(a) * tan, tan, sec],
        2: [one, r[:, 2], g.second[:, 2], np.sin(a), np.cos(a), np.cos(e)],
    }
    for order, rows in (("first-order", first), ("second-order", second)):
        for channel, expected in rows.items():
            x = design(g, channel, order)[1]
            for k, column in enumerate(expected):
                np.testing.assert_allclose(x[:, k], column, rtol=1e-12, atol=1e-15)
    # cot E, bounded at the horizon; well above it the printed column.
    assert design(g, 2, "second-order")[1].shape[1] == 7
    high = turning(50, up=4000.0)
    np.testing.assert_allclose(design(high, 2, "second-order")[1][:, 6], 1 / np.tan(high.elevation_rad), rtol=0.02)
    assert [c.name for c in design(g, 1, "second-order", jerk=True)[0]][-1] == "1/Kj"
    assert np.array_equal(design(g, 1, "second-order", jerk=True)[1][:, -1], g.third[:, 1])
    parallax = dict(
        zip(
            [c.name for c in design(g, 1, "first-order", parallax=True)[0]],
            design(g, 1, "first-order", parallax=True)[1].T,
            strict=True,
        )
    )
    np.testing.assert_allclose(parallax["site east"], np.cos(a) / (g.range_m * np.cos(e)), rtol=1e-12)
    np.testing.assert_allclose(parallax["site north"], np.sin(a) / (g.range_m * np.cos(e)), rtol=1e-12)


def test_ranks_at_the_horizon_are_1_2_and_3_and_all_is_finite() -> None:
    rng = np.random.default_rng(3)
    g = at_sea(300, rng)
    y = np.stack([rng.normal(size=300) * 50 + 5, rng.normal(size=300) * 0.5 * DEG - 0.009, np.full(300, np.nan)], axis=1)
    first = PerChannel(model="first-order").fit(g, y)
    second = PerChannel(model="second-order").fit(g, y)
    assert (first.channels[1].rank, first.channels[1].offered) == (1, 5)
    assert (second.channels[0].rank, second.channels[0].offered) == (2, 3)
    assert (second.channels[1].rank, second.channels[1].offered) == (3, 7)
    assert second.channels[2] is None
    for found in (*first.fitted, *second.fitted):
        assert np.isfinite(found.value).all()
        assert np.isfinite(found.covariance).all()
        assert np.linalg.eigvalsh(found.covariance / np.sqrt(np.outer(*[np.diag(found.covariance)] * 2))).min() > 0
        assert np.isfinite(found.correction(g)).all()
        assert len(found.dropped) == found.offered - found.rank
    assert {name for name, _ in second.channels[1].dropped} == {"θ cos Amax", "-θ sin Amax", "λ", "Kz+Kb"}
    # Elevation 0 in the elevation channel too.
    third = PerChannel(model="second-order").fit(g, np.full((300, 3), [np.nan, np.nan, 0.0]))
    assert np.isfinite(third.channels[2].value).all()


@given(seed=st.integers(0, 10_000), up=st.sampled_from([0.0, -15.0, 30.0, 2000.0]))
@settings(max_examples=15, deadline=None)
def test_more_columns_never_fit_worse(seed: int, up: float) -> None:
    rng = np.random.default_rng(seed)
    g = turning(120, up=up)
    y = np.stack([rng.standard_t(3, 120) * 20, rng.normal(size=120) * 0.01, rng.normal(size=120) * 0.01], axis=1)
    fits = [PerChannel(model=order, tolerance=0.0, ridge=0.0, gate_sd=0.0).fit(g, y) for order in ORDERS]
    for channel in range(3):
        constant, first, second = (f.channels[channel].rmse for f in fits)
        assert second <= first * (1 + 1e-9)
        assert first <= constant * (1 + 1e-9)
        assert constant == pytest.approx(y[:, channel].std(), rel=1e-12)


@given(seed=st.integers(0, 10_000), columns=st.integers(1, 6))
@settings(max_examples=15, deadline=None)
def test_full_rank_is_plain_least_squares(seed: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.column_stack([np.ones(60), rng.normal(size=(60, columns)) * 10.0 ** rng.integers(-6, 6, columns) + 1e-3])
    y = rng.normal(size=60)
    solved = solve_safely(x, y, [str(k) for k in range(columns + 1)], tolerance=1e-9, ridge=0.0)
    scale = np.abs(x).max(axis=0)
    expected = np.linalg.lstsq(x / scale, y, rcond=None)[0] / scale
    assert solved.rank == columns + 1 == len(solved.kept)
    np.testing.assert_allclose(solved.value, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(
        solved.unit * np.outer(scale, scale), np.linalg.inv((x / scale).T @ (x / scale)), rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("select", ["bic", "cross-validation"])
def test_the_order_is_constant_where_the_truth_is(select: str) -> None:
    g = turning(400)
    right = total = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=(400, 3)) * [50, 0.01, 0.01] + [5, 0.01, 0.0]
        found = PerChannel(select=select).fit(g, y, cluster=np.arange(400) // 20)
        right += sum(f.order == "constant" for f in found.fitted)
        total += 3
    # Cross-validation keeps what does no harm more often.
    assert right / total >= (0.9 if select == "bic" else 0.6)


def test_bic_on_tracks_is_not_taken_in_by_errors_that_a_track_shares() -> None:
    g = turning(600)
    cluster = np.arange(600) // 20
    right = plots = 0
    for seed in range(15):
        rng = np.random.default_rng(seed)
        y = (rng.normal(size=(30, 3))[cluster] + 0.5 * rng.normal(size=(600, 3))) * [50, 0.01, 0.01]
        right += sum(f.order == "constant" for f in PerChannel(select="bic").fit(g, y, cluster=cluster).fitted)
        plots += sum(f.order == "constant" for f in PerChannel(select="bic").fit(g, y, cluster=np.arange(600)).fitted)
    assert right >= 0.9 * 45 > plots


def test_bic_takes_the_second_order_where_stamps_are_late() -> None:
    g = turning(400)
    rng = np.random.default_rng(1)
    y = np.stack([rng.normal(size=400) * 5 + 0.5 * g.rate[:, 0], rng.normal(size=400) * 0.002, np.full(400, np.nan)], axis=1)
    found = PerChannel(select="bic").fit(g, y)
    assert [f.order for f in found.fitted] == ["second-order", "constant"]
    assert found.channels[0].value[1] == pytest.approx(0.5, abs=5 * np.sqrt(found.channels[0].covariance[1, 1]))


def test_the_papers_rule_takes_the_order_that_is_most_alike_for_two_targets() -> None:
    g = turning(400)
    y = np.random.default_rng(0).normal(size=(400, 3)) * [50, 0.01, 0.01]
    found = PerChannel(select="correlation").fit(g, y, cluster=np.arange(400) // 200)
    for scores, fit in zip(found.scores, found.fitted, strict=True):
        # Constants of two targets are 2 √n apart whatever they are.
        assert scores["constant"] == pytest.approx(2 * np.sqrt(200), abs=1e-9)
        assert scores[fit.order] == pytest.approx(min(scores.values()))
    with pytest.raises(NothingToDo, match="two targets"):
        PerChannel(select="correlation").fit(g, y)


@pytest.mark.parametrize(("distance", "r"), [(44.181, 0.694), (37.922, 0.725), (38.592, 0.722), (38.773, 0.721)])
def test_r_is_what_table_5_holds(distance: float, r: float) -> None:
    assert round(distance_correlation(distance), 3) == r


def test_distance_of_constants() -> None:
    assert normalised_distance(np.full(488, 3.0), np.full(488, -0.1)) == pytest.approx(2 * np.sqrt(488), abs=1e-9)
    assert normalised_distance(np.full(10, 0.1 + 0.2), np.full(10, 0.3)) == 0.0
    assert normalised_distance(np.zeros(5), np.zeros(5)) == 0.0
    assert normalised_distance(np.zeros(0), np.zeros(0)) == 0.0


TRUTH = {
    "A": {
        "range_bias": 80.0,
        "azimuth_bias": 0.4 * DEG,
        "time_offset": 0.6,
        "tilt_north": 0.1 * DEG,
        "elevation_bias": 0.2 * DEG,
    },
    "B": {"range_bias": -80.0, "azimuth_bias": 0.1 * DEG},
}


def test_known_errors_come_out_with_our_signs() -> None:
    made = scene(1, TRUTH, elevation=True, errors=Errors(mispaired=0.02))
    found = register_per_channel(made.pairs, made.sensors, model="auto")
    for sensor in made.sensors:
        for k, key in enumerate(found.terms):
            if key.sensor == sensor.key:
                true = TRUTH[sensor.name].get(key.name, 0.0)
                assert abs(found.value[0, k] - true) < 4.5 * found.sd[0, k], (sensor.name, key.name)
    names = {key.name for key in found.terms if key.sensor == made.sensors.sensor[0].key}
    assert names >= {"range_bias", "azimuth_bias", "elevation_bias", "time_offset", "tilt_north", "tilt_east"}
    assert [key.name for key in found.terms if key.sensor == made.sensors.sensor[1].key] == [
        "range_bias",
        "azimuth_bias",
        "elevation_bias",
    ]
    assert found.settings["method"] == "per-channel"
    # The 2 % that are paired wrongly are no inliers.
    assert any("inliers" in note for note in found.sensors[0].notes)
    assert any("settled" in note for note in found.sensors[0].notes)
    assert {n.term for n in found.not_determined} == {"α sec E"}


def test_each_order_by_name_and_an_order_a_channel() -> None:
    made = scene(2, TRUTH, elevation=False, errors=Errors(), targets=8)
    for model in ORDERS:
        found = register_per_channel(made.pairs, made.sensors, model=model)
        assert np.isfinite(found.value).all()
        assert np.linalg.eigvalsh(found.covariance[0] / np.outer(found.sd[0], found.sd[0])).min() > 0
    mixed = register_per_channel(made.pairs, made.sensors, model="second-order, first-order, constant")
    assert mixed.sensors[0].model == "second-order / first-order"
    assert mixed.index(made.sensors.sensor[0].key, "time_offset") is not None
    constant = register_per_channel(made.pairs, made.sensors, model="constant")
    assert [key.name for key in constant.terms[:2]] == ["range_bias", "azimuth_bias"]


def test_bad_input_is_a_message() -> None:
    made = scene(2, TRUTH, errors=Errors(), targets=2)
    with pytest.raises(SettingsError, match="no model"):
        register_per_channel(made.pairs, made.sensors, model="third-order")
    with pytest.raises(SettingsError, match="no rule"):
        register_per_channel(made.pairs, made.sensors, settings=PerChannel(select="luck"))
    with pytest.raises(SettingsError, match="make no sense"):
        register_per_channel(made.pairs, made.sensors, settings=PerChannel(tolerance=2.0))
    with pytest.raises(NothingToDo, match="no pairs"):
        register_per_channel(made.pairs[:0], made.sensors)
    with pytest.raises(NothingToDo, match="1 usable plots"):
        register_per_channel(made.pairs[:1], made.sensors, model="constant")
    one = made.pairs[made.pairs.target == made.pairs.target[0]]
    found = register_per_channel(one, made.sensors)
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.sd).all()


def test_one_radial_track_cannot_tell_late_stamps_from_range() -> None:
    t = np.arange(200.0)
    line = np.array([0.6, 0.79, 0.0]) * 8
    g = place((800 + t[:, None] * 8) * line / np.linalg.norm(line), np.tile(line, (200, 1)), np.zeros((200, 3)))
    y = np.random.default_rng(0).normal(size=(200, 3)) * [5, 0.01, np.nan] + [4.0, 0.0, 0.0]
    found = PerChannel().fit(g, y)
    assert [c.name for c in found.channels[0].columns] == ["R0"]
    assert dict(found.channels[0].dropped)["Δt1+Δt2"].startswith("its column varies by")
    assert "zero everywhere" in dict(found.channels[1].dropped)["Δt1+Δt2+1/Kv"]
    assert found.channels[0].value[0] == pytest.approx(4.0, abs=2.0)


def test_values_beyond_what_is_plausible_are_said() -> None:
    made = scene(3, {"A": {"tilt_north": 8 * DEG}}, elevation=True, errors=Errors(), targets=8)
    found = register_per_channel(made.pairs, made.sensors, model="first-order")
    assert any("tilt_north of +" in note and "parallax" in note for note in found.sensors[0].notes)


@pytest.mark.parametrize("order", ["first-order", "second-order"])
@pytest.mark.parametrize("up", [-11.0, 40.0, 300.0])
def test_targets_at_one_height_tell_where_the_antenna_stands_not_how_it_leans(order: str, up: float) -> None:
    """The columns are then the same: those of the place stay, whatever noise and the order of rows are, and are found."""
    angle = 2 * np.pi * np.arange(900) / 900
    for seed in range(6):
        rng = np.random.default_rng(seed)
        radius = rng.uniform(800, 1500, 2)
        enu = np.stack([radius[0] * np.sin(angle), radius[1] * np.cos(angle) + 300, np.full(900, up)], axis=1)[
            rng.permutation(900)
        ]
        g = place(enu, rng.normal(size=(900, 3)) * [6, 6, 0], rng.normal(size=(900, 3)) * [0.5, 0.5, 0])
        y = -10.0 * TERMS["site_east"].columns(g) + rng.normal(size=(900, 3)) * [10, 0.002, np.nan]
        fit = PerChannel(model=order, parallax=True).fit(g, y).channels[1]
        found = {
            c.term: (c.sign * v, sd) for c, v, sd in zip(fit.columns, fit.value, np.sqrt(np.diag(fit.covariance)), strict=True)
        }
        assert {"site_east", "site_north"} <= set(found)
        assert not {"tilt_north", "tilt_east"} & set(found)
        assert all("most of site" in why for name, why in fit.dropped if name.removeprefix("-").startswith("θ"))
        assert abs(found["site_east"][0] - 10.0) < 4 * found["site_east"][1] < 16.0


def test_a_calibration_says_that_the_place_was_taken_for_the_tilt() -> None:
    """Targets on the antenna's own level 600 m up: the note names the columns, and what is not determined the tilts."""
    site, rotation = site_of(RADARS.find(257))

    def level(rng: np.random.Generator) -> tuple[Callable[[np.ndarray], np.ndarray], float, float, float]:
        away, phase, rate = rng.uniform(4e3, 15e3), rng.uniform(0, 6.28), rng.uniform(-0.004, 0.004)

        def position(t: np.ndarray) -> np.ndarray:
            angle = phase + rate * t
            return site + np.stack([away * np.sin(angle), away * np.cos(angle), np.full(len(t), 600.0)], axis=1) @ rotation

        return position, 0.0, 900.0, 40.0

    made = scene(3, {"A": {"site_east": 60.0}}, sensors=Sensors((RADARS.find(257),)), targets=12, track=level, errors=Errors())
    found = register_per_channel(made.pairs, made.sensors, model="first-order", settings=PerChannel(parallax=True))
    terms = [key.name for key in found.terms]
    assert {"site_east", "site_north"} <= set(terms)
    assert {"tilt_north", "tilt_east"} <= {missing.term for missing in found.not_determined}
    assert sum("where the antenna stands" in note for note in found.sensors[0].notes) == 2
    k = terms.index("site_east")
    assert abs(found.value[0, k] - 60.0) < 4 * found.sd[0, k]


def test_a_calibration_offers_named_columns_only() -> None:
    """There is no option for it, in a method's settings or a result's: α is named as not determined, and takes no part."""
    assert "named_only" not in PerChannel.__struct_fields__
    made = scene(3, {}, elevation=True, errors=Errors(), targets=8)
    found = register_per_channel(made.pairs, made.sensors, model="second-order")
    assert set(found.settings) == {"method", *PerChannel.__struct_fields__}
    assert any(missing.term == "α sec E" for missing in found.not_determined)
    seen = observe(made.pairs, np.flatnonzero(made.pairs.plots.sensor == 257), RADARS.find(257), 0.0)
    fits = [PerChannel()(seen, named=named).channels[0] for named in (False, True)]
    assert [fit.offered for fit in fits if fit is not None] == [3, 2]


@pytest.mark.slow
def test_sds_are_honest_term_by_term() -> None:
    """24 scenes of the page's kind, with latencies and delays of each target: sd and covariance say what the errors are."""
    errors = {"range_bias": 40.0, "azimuth_bias": 0.2, "elevation_bias": 0.1, "tilt_north": 0.15, "time_offset": 0.3}
    radar = Radar(
        name="tracker", sac=1, sic=1, lat_deg=46.0, lon_deg=14.0, height_m=300.0, kind="mode_s", max_range_m=60e3,
        max_elevation_deg=60.0, range_sd_m=20.0, azimuth_sd_deg=0.05, elevation_sd_deg=0.05, errors=errors,
    )  # fmt: skip
    traffic = Traffic(aircraft=40, lat_deg=46.0, lon_deg=14.0, radius_m=50e3, arrivals=0.0, departures=0.0)
    scenario = Scenario(duration_s=1200.0, traffic=traffic, radar=(radar,), adsb=Adsb(share=1.0))
    off: dict[str, list[float]] = {}
    squared = []
    for seed in range(101, 125):
        run = simulate(scenario, seed=seed)
        pairs = associate(run.plots, locate(run.fixes, run.sensors, ())[0], run.sensors)
        found = register_per_channel(pairs, run.sensors, model="second-order")
        truth = np.array([errors.get(key.name, 0.0) * TERMS[key.name].si_per_unit for key in found.terms])
        error = found.value[0] - truth
        squared.append(float(error @ np.linalg.solve(found.covariance[0], error)) / len(error))
        for key, value in zip(found.terms, error / found.sd[0], strict=True):
            off.setdefault(key.name, []).append(float(value))
    assert 0.7 <= np.mean(squared) <= 1.5
    rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in off.items()}
    assert len(rms) >= 10
    assert max(rms.values()) <= 1.5, rms
