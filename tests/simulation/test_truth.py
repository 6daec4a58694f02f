"""Are simulated flights flyable, and is the truth one smooth function of time?"""

from __future__ import annotations

import numpy as np
import pytest

from boresight.geodesy import enu_from_ecef, geodetic_from_ecef, rotate
from boresight.simulation import Adsb, Airport, Atmosphere, Scenario, Traffic, Truth, simulate
from boresight.simulation.reference import equip_aircraft
from boresight.simulation.truth import fly_traffic

AIRPORT = Airport(lat_deg=41.297, lon_deg=2.083, height_m=50.0, runway_deg=246.0)
ATMOSPHERE = Atmosphere(isa_deviation_k=8.0, shift_m=62.0)


@pytest.fixture(scope="module", params=[1, 2])
def truth(request: pytest.FixtureRequest) -> Truth:
    return simulate(Scenario(duration_s=2400.0, airport=(AIRPORT,), atmosphere=ATMOSPHERE), request.param).truth


def sampled(truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Targets and times every 0.37 s of every flight."""
    when = [np.arange(a, b, 0.37) for a, b in zip(truth.first_s, truth.last_s, strict=True)]
    return np.repeat(np.arange(len(truth)), [len(w) for w in when]), np.concatenate(when)


def test_flights_are_flyable(truth: Truth) -> None:
    target, when = sampled(truth)
    motion = truth.motion(target, when)
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    local = enu_from_ecef(latitude, longitude)
    velocity, acceleration = rotate(local, motion.velocity), rotate(local, motion.acceleration)
    ground = np.hypot(velocity[:, 0], velocity[:, 1])
    across = (velocity[:, 1] * acceleration[:, 0] - velocity[:, 0] * acceleration[:, 1]) / ground
    along = (velocity[:, 0] * acceleration[:, 0] + velocity[:, 1] * acceleration[:, 1]) / ground
    assert ground.min() > 45
    assert ground.max() < 265
    assert np.degrees(np.arctan(np.abs(across) / 9.81)).max() < 28
    assert np.abs(along).max() < 1.3
    assert velocity[:, 2].min() > -18
    assert velocity[:, 2].max() < 18
    assert height.min() > 60
    assert height.max() < 13_000
    # Roll, not steps: bank builds up over seconds.
    assert np.abs(rotate(local, motion.jerk)).max() < 2.5


def test_all_kinds_of_flights_are_there(truth: Truth) -> None:
    target, when = sampled(truth)
    position = truth.motion(target, when, 0).position
    level = truth.geodetic(position)[2]
    lowest = np.array([level[target == k].min() for k in range(len(truth))])
    highest = np.array([level[target == k].max() for k in range(len(truth))])
    assert np.count_nonzero(lowest > 7000) >= 10, "overflights"
    assert np.count_nonzero((lowest < 300) & (highest > 3000)) >= 5, "arrivals and departures"
    assert np.count_nonzero(highest < 2500) == 3, "local flights"
    turned = np.zeros(len(truth))
    for k in range(len(truth)):
        motion = truth.motion(np.full(2000, k), np.linspace(truth.first_s[k], truth.last_s[k], 2000), 1)
        turned[k] = np.abs(np.diff(np.unwrap(truth.course_rad(motion.position, motion.velocity)))).sum()
    assert np.degrees(turned.max()) > 420, "a holding turns more than a full circle"


def test_level_flight_keeps_its_pressure_level(truth: Truth) -> None:
    k = len(truth) - 1  # the last flights are overflights
    when = np.linspace(truth.last_s[k] - 300, truth.last_s[k], 50)
    level = truth.geodetic(truth.motion(np.full(50, k), when, 0).position)[2]
    assert np.ptp(level) < 0.5
    assert level.mean() / 304.8 == pytest.approx(round(level.mean() / 304.8), abs=0.02)


def test_derivatives_are_those_of_the_position(truth: Truth) -> None:
    rng = np.random.default_rng(3)
    target = rng.integers(0, len(truth), 400)
    when = truth.first_s[target] + rng.uniform(0.05, 0.95, 400) * (truth.last_s - truth.first_s)[target]
    h = 0.02
    before, at, after = (truth.motion(target, when + d) for d in (-h, 0.0, h))
    for lower, upper in ((0, 1), (1, 2), (2, 3)):
        numeric = (after[lower] - before[lower]) / (2 * h)
        np.testing.assert_allclose(numeric, at[upper], rtol=0, atol=2e-3)


def test_outside_its_flight_a_target_is_nowhere(truth: Truth) -> None:
    motion = truth.motion(np.array([0, 0]), np.array([truth.first_s[0] - 1, truth.last_s[0] + 1]))
    assert np.isnan(motion.position).all()


def test_atmosphere_against_the_hydrostatic_integral() -> None:
    # Each pressure layer dh_p is T / T_isa thick; integrated in steps of a metre (ISO 2533 temperatures).
    layers = np.arange(0.0, 13_000.0) + 0.5
    isa = np.where(layers < 11_000, 288.15 - 0.0065 * layers, 216.65)
    for deviation in (-20.0, 15.0):
        air = Atmosphere(isa_deviation_k=deviation, shift_m=70.0)
        thick = np.cumsum((isa + deviation) / isa)
        found = air.geometric_m(np.array([3000.0, 10_973.0, 12_500.0]))
        np.testing.assert_allclose(found, 70.0 + thick[[2999, 10_972, 12_499]], atol=0.01)
        np.testing.assert_allclose(air.pressure_m(found), [3000.0, 10_973.0, 12_500.0], atol=1e-6)
    # METHODS section 6: ISA + 15 at FL360 is about 650 m.
    assert Atmosphere(isa_deviation_k=15.0).geometric_m(np.array([10_972.8]))[0] - 10_972.8 == pytest.approx(650, abs=10)


def test_traffic_without_airports_flies_over() -> None:
    scene = Scenario(duration_s=600.0, traffic=Traffic(aircraft=5, arrivals=0.0, departures=0.0, local=0.0))
    truth = simulate(scene, 1).truth
    level = truth.geodetic(truth.motion(np.arange(5), truth.first_s + 1, 0).position)[2]
    assert (level > 7000).all()


def test_there_may_be_no_traffic_at_all() -> None:
    traffic = Traffic(aircraft=0)
    rng = np.random.default_rng(1)
    truth = fly_traffic(traffic, (AIRPORT,), ATMOSPHERE, 0.0, 600.0, equip_aircraft(0, traffic, Adsb(), rng), rng)
    assert (len(truth), truth.flights, len(truth.length_m)) == (0, 0, 0)
    assert len(truth.motion(np.empty(0, np.int64), np.empty(0)).position) == 0
