"""Every term alone: simulated as the radar's only error, and found within 4 of its sd.  No files, no association."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from boresight.calibration import Calibration
from boresight.correction import correct
from boresight.model import Pairs, Sensors
from boresight.registration import register
from boresight.simulation.radar import Radar, observe_radar
from boresight.simulation.scenario import Scenario, simulate
from boresight.simulation.truth import Traffic, Truth
from boresight.terms import DEG, TABLES, TERMS, Geometry

RADAR = Radar(
    name="R", sac=1, sic=1, lat_deg=41.3, lon_deg=2.1, height_m=100.0, kind="mode_s", scan_s=6.0, time_quantum_s=0.0,
    range_quantum_m=0.0, azimuth_quantum_deg=0.0, range_sd_m=5.0, azimuth_sd_deg=0.02, elevation_sd_deg=0.02,
    max_elevation_deg=60.0, min_elevation_deg=0.2, max_range_m=120e3,
)  # fmt: skip
# The true value of each in its own unit, large enough to be seen in a quarter of an hour.
TRUE = {
    "range_bias": 40.0, "range_gain": 0.6, "range_refraction": 300.0, "azimuth_bias": -0.2, "azimuth_cos": 0.08,
    "azimuth_sin": -0.06, "azimuth_cos2": 0.05, "azimuth_sin2": 0.04, "nonorthogonality": 0.2, "collimation": -0.15,
    "elevation_bias": 0.1, "elevation_sag": 0.15, "elevation_refraction": 0.02, "tilt_north": 0.1, "tilt_east": -0.1,
    "time_offset": 0.4, "clock_drift": 600.0, "range_lag": 40.0, "azimuth_lag": 60.0, "elevation_lag": 100.0,
    "range_jerk": 800.0, "azimuth_jerk": 800.0, "elevation_jerk": 1500.0, "site_east": 60.0, "site_north": -50.0,
    "site_up": 80.0, "rotation_east": 0.1, "rotation_north": 0.1, "rotation_up": 0.2, "stretch_east": 1.0,
    "stretch_north": -1.0, "stretch_up": 30.0, "shear_east_north": 0.5, "shear_east_up": 2.0, "shear_north_up": 2.0,
    "along_heading": -30.0,
    "along_heading_per_length": -0.6, "transponder_delay": 20.0,
}  # fmt: skip
# Somewhere, for columns that ask the range alone.
PLACE = Geometry(np.zeros(5), np.zeros(5), np.zeros(5), *[np.zeros((5, 3))] * 3, np.zeros(5), np.zeros(5), np.zeros(5))


@pytest.fixture(scope="module")
def truth() -> Truth:
    traffic = Traffic(lat_deg=41.3, lon_deg=2.1, radius_m=90e3, aircraft=24, local=0.3, arrivals=0.0, departures=0.0)
    scene = Scenario(duration_s=900.0, traffic=traffic, radar=(RADAR,))
    return simulate(scene, 5).truth


def pairs_of(truth: Truth, radar: Radar, seed: int = 1, late_s: float = 0.0) -> Pairs:
    """The radar's plots with the truth itself as the reference, its stamps late by `late_s`."""
    seen = observe_radar(truth, radar, np.random.default_rng(seed))
    since = seen.plots.time_s - truth.epoch_s - late_s
    inside = (since > truth.first_s[seen.target]) & (since < truth.last_s[seen.target])
    plots, target, since = seen.plots[inside], seen.target[inside], since[inside]
    motion = truth.motion(target, since)
    return Pairs(
        plot=np.arange(len(plots)), plots=plots, target=target, track=target, position=motion.position,
        velocity=motion.velocity, acceleration=motion.acceleration, covariance=np.zeros((len(plots), 3, 3)),
        heading_rad=truth.course_rad(motion.position, motion.velocity), length_m=truth.aircraft.length_m[target],
        source=np.full(len(plots), 5339),
    )  # fmt: skip


def found_of(found: Calibration, name: str) -> tuple[float, float]:
    """Value and sd in the term's unit."""
    base, _, channel = name.partition("@")
    k = next(i for i, key in enumerate(found.terms) if (key.name, key.channel) == (base, channel or "all"))
    unit = TERMS[base].si_per_unit
    return float(found.value[0, k] / unit), float(found.sd[0, k] / unit)


def sensors(radar: Radar) -> Sensors:
    return Sensors((radar.sensor,))


def test_the_list_has_every_term() -> None:
    nodes = {name for table in TABLES.values() for name in table}
    assert set(TRUE) == set(TERMS) - nodes


@pytest.mark.parametrize("name", list(TRUE))
def test_a_term_alone_is_found(truth: Truth, name: str) -> None:
    radar = msgspec.structs.replace(RADAR, errors={name: TRUE[name]})
    others = [n for n in ("range_bias", "azimuth_bias", "elevation_bias") if not alike(n, name)]
    others += ["time_offset"] if name == "clock_drift" else []
    found = register(pairs_of(truth, radar), sensors(radar), model=[*others, name])
    value, sd = found_of(found, name)
    assert abs(value - TRUE[name]) <= 4 * sd
    assert sd < abs(TRUE[name]) / 4, "not seen at all"


def alike(one: str, two: str) -> bool:
    """Whether the geometry of this scene cannot tell the two well apart (or nothing can)."""
    pairs = {
        "range_bias": {"range_bias", "transponder_delay"},
        "azimuth_bias": {"azimuth_bias", "rotation_up", "collimation"},
        "elevation_bias": {"elevation_bias", "elevation_sag"},
    }
    return two in pairs[one]


@pytest.mark.parametrize(
    ("name", "true", "share"),
    [
        ("range_bias@psr", 60.0, {"primary_only": 0.4}),
        ("azimuth_bias@mode_s", 0.1, {"primary_only": 0.4}),
        ("time_offset@psr", 0.3, {"primary_only": 0.4}),
        ("range_bias@chain2", -30.0, {"second_chain": 0.5}),
        ("azimuth_bias@chain1", 0.1, {"second_chain": 0.5}),
    ],
)
def test_a_term_of_one_channel_is_found_and_corrected_there(
    truth: Truth, name: str, true: float, share: dict[str, float]
) -> None:
    common = {"range_bias": 25.0, "azimuth_bias": -0.1, "time_offset": 0.2}
    radar = msgspec.structs.replace(RADAR, kind="combined", errors=common | {name: true}, **share)
    pairs = pairs_of(truth, radar)
    found = register(pairs, sensors(radar), model=[*common, name])
    for term, value in (common | {name: true}).items():
        got, sd = found_of(found, term)
        assert abs(got - value) <= 4 * sd, term
    assert found_of(found, name)[1] < abs(true) / 4
    base, _, channel = name.partition("@")
    assert f"{base} ({channel})" in str(found)
    # Corrected, the plots have none of it left.
    clean = pairs.replace(plots=correct(pairs.plots, found, sensors=sensors(radar), terms="all"))
    since = np.clip(clean.plots.time_s - truth.epoch_s, truth.first_s[pairs.target], truth.last_s[pairs.target])
    moved = truth.motion(pairs.target, since)
    again = register(
        clean.replace(position=moved.position, velocity=moved.velocity, acceleration=moved.acceleration),
        sensors(radar), model=[*common, name],
    )  # fmt: skip
    for term in (*common, name):
        got, _ = found_of(again, term)
        assert abs(got) <= 2 * found_of(found, term)[1], term


def test_a_channel_without_plots_is_named(truth: Truth) -> None:
    found = register(pairs_of(truth, RADAR), sensors(RADAR), model="range_bias,range_bias@psr,azimuth_bias")
    assert next(n.why for n in found.not_determined if n.term == "range_bias@psr") == "no plot is of the channel psr"
    # All plots are of one channel: its term is the common one by another name.
    found = register(pairs_of(truth, RADAR), sensors(RADAR), model="range_bias,range_bias@mode_s,azimuth_bias")
    assert any(n.term == "range_bias@mode_s" for n in found.not_determined)


def test_the_azimuth_table_is_what_bias_and_harmonics_leave(truth: Truth) -> None:
    nodes = {name: int(name[-3:]) for name in TABLES["azimuth_table"]}
    shape = {name: 0.08 * np.cos(3 * node * DEG) for name, node in nodes.items()}
    lower = {"azimuth_bias": 0.1, "azimuth_cos": 0.05, "azimuth_sin": -0.05, "azimuth_cos2": 0.03, "azimuth_sin2": 0.03}
    radar = msgspec.structs.replace(RADAR, errors=lower | shape)
    found = register(pairs_of(truth, radar), sensors(radar), model=[*lower, "azimuth_table"])
    wrong = []
    for name, true in (lower | shape).items():
        value, sd = found_of(found, name)
        assert abs(value - true) <= 4 * sd + 0.004, name
        wrong.append(value - true)
    assert np.sqrt(np.mean(np.square(wrong))) < 0.012
    # Without a table's own error the nodes are nothing, and the terms besides are as sure as without it.
    radar = msgspec.structs.replace(RADAR, errors=lower)
    pairs = pairs_of(truth, radar)
    found, bare = (register(pairs, sensors(radar), model=m) for m in ([*lower, "azimuth_table"], list(lower)))
    assert all(abs(found_of(found, n)[0]) <= 4 * found_of(found, n)[1] for n in nodes)
    for name in lower:
        assert abs(found_of(found, name)[0] - found_of(bare, name)[0]) <= 2 * found_of(found, name)[1]


def test_the_range_table_is_found_and_empty_nodes_are_named(truth: Truth) -> None:
    radar = msgspec.structs.replace(RADAR, errors={"range_table_032000": 25.0, "range_table_048000": -25.0})
    found = register(pairs_of(truth, radar), sensors(radar), model="range_bias,range_gain,azimuth_bias,range_table")
    # The mean and the slope of the table are in the bias and the gain: what they all add to is the truth.
    r = np.array([24e3, 32e3, 40e3, 48e3, 56e3])
    true = np.interp(r, [0, 16e3, 32e3, 48e3, 64e3, 1e6], [0, 0, 25.0, -25.0, 0, 0])
    total = np.zeros(len(r))
    for k, key in enumerate(found.terms):
        if key.name != "azimuth_bias":
            place = PLACE._replace(range_m=r)
            total += TERMS[key.name].columns(place)[:, 0] * found.value[0, k]
    assert np.allclose(total, true, atol=4.0)
    why = next(n.why for n in found.not_determined if n.term == "range_table")
    assert "448000" in why
    assert not any(key.name == "range_table_448000" for key in found.terms)


def test_a_table_of_a_narrow_sector_is_left_out(truth: Truth) -> None:
    pairs = pairs_of(truth, RADAR)
    sector = pairs[np.abs(pairs.plots.azimuth_rad - np.pi) < 25 * DEG]
    found = register(sector, sensors(RADAR), model="range_bias,azimuth_bias,azimuth_table")
    assert "nodes have plots" in next(n.why for n in found.not_determined if n.term == "azimuth_table")
    assert [key.name for key in found.terms] == ["range_bias", "azimuth_bias"]


def test_each_transponders_own_delay_is_told_with_its_sd(truth: Truth) -> None:
    found = register(pairs_of(truth, RADAR), sensors(RADAR), model="range_bias,azimuth_bias")
    (effect,) = (e for e in found.sensors[0].effects if e.term == "transponder_delay")
    true = float(np.std(truth.aircraft.transponder_delay_m))
    assert np.isinf(effect.block_s)
    assert effect.sd == pytest.approx(true, rel=0.35)
    assert {e.block_s for e in found.sensors[0].effects} > {np.inf}
    assert any(f"sd of {effect.sd:.3g} m" in note for note in found.sensors[0].notes)
    # A primary radar has no transponders in its ranges.
    radar = msgspec.structs.replace(RADAR, kind="psr")
    bare = register(pairs_of(truth, radar), sensors(radar), model="range_bias,azimuth_bias").sensors[0].effects
    assert not any(e.term == "transponder_delay" for e in bare)


def test_a_second_reference_that_is_late_is_found_and_said(truth: Truth) -> None:
    radar = msgspec.structs.replace(RADAR, errors={"time_offset": 0.25})
    good, late = pairs_of(truth, radar), pairs_of(truth, radar, late_s=0.4)
    # Two thirds of the targets are seen by the good one, one third by the late one.
    good, late = good[good.target % 3 != 0], late[late.target % 3 == 0]
    parts = [good, late.replace(source=np.full(len(late), 7000))]
    found = register(Pairs.concat(parts), sensors(radar), model="range_bias,azimuth_bias,time_offset")
    value, sd = found_of(found, "time_offset")
    assert abs(value - 0.25) <= 4 * sd < 0.05
    note = next(n for n in found.sensors[0].notes if "27/88" in n)
    told = float(note.split("stamped ")[1].split()[0])
    assert told == pytest.approx(0.4, abs=0.03)
    assert [key.name for key in found.terms] == ["range_bias", "azimuth_bias", "time_offset"]
    assert found.covariance.shape == (1, 3, 3)


def test_a_single_reference_that_is_late_looks_like_all_radars_and_is_said(truth: Truth) -> None:
    other = msgspec.structs.replace(RADAR, name="S", sic=2, lat_deg=41.6, lon_deg=2.5)
    both = Sensors((RADAR.sensor, other.sensor))
    model = "range_bias,azimuth_bias,time_offset"
    found = register(Pairs.concat([pairs_of(truth, r, late_s=0.4) for r in (RADAR, other)]), both, model=model)
    said = next(w for w in found.warnings if "the reference may be stamped late" in w)
    assert "both radars show the same" in said
    assert float(said.split("(")[1].split()[0]) == pytest.approx(-0.4, abs=0.02)
    # One radar alone cannot have stamped before it measured.
    alone = register(pairs_of(truth, RADAR, late_s=0.4), sensors(RADAR), model=model)
    assert any("may be stamped late" in w for w in alone.warnings)
    # Radars that differ have clocks of their own; and where there is no offset nothing is said.
    slow = msgspec.structs.replace(other, errors={"time_offset": 0.5})
    for second in (slow, other):
        found = register(Pairs.concat([pairs_of(truth, RADAR), pairs_of(truth, second)]), both, model=model)
        assert not any("may be stamped" in w for w in found.warnings)


def test_combined_plots_tell_the_primarys_own_bias(truth: Truth) -> None:
    radar = msgspec.structs.replace(RADAR, kind="combined", errors={"range_bias": 30.0})
    pairs = pairs_of(truth, radar)
    rng = np.random.default_rng(3)
    n = len(pairs)
    plots = pairs.plots.replace(
        psr_ssr_range_m=190.0 + rng.normal(size=n) * 40, psr_ssr_azimuth_rad=(0.02 + rng.normal(size=n) * 0.05) * DEG
    )
    found = register(pairs.replace(plots=plots), sensors(radar), model="range_bias,azimuth_bias")
    note = next(x for x in found.sensors[0].notes if "I048/130" in x)
    own = float(note.split("own range_bias is ")[1].split()[0])
    assert own == pytest.approx(190.0 + found_of(found, "range_bias")[0], abs=4.0)


def test_a_drift_counts_from_the_epoch_and_correct_takes_it_out(truth: Truth) -> None:
    radar = msgspec.structs.replace(RADAR, errors={"time_offset": 0.3, "clock_drift": 600.0})
    pairs = pairs_of(truth, radar)
    found = register(pairs, sensors(radar), model="range_bias,azimuth_bias,time_offset,clock_drift")
    clean = correct(pairs.plots, found, sensors=sensors(radar), terms="all")
    since = pairs.plots.time_s - truth.epoch_s
    k = [i for i, key in enumerate(found.terms) if key.name in ("time_offset", "clock_drift")]
    at = np.stack([np.ones(len(pairs)), pairs.plots.time_s - found.epoch_s[0]])
    sd = np.sqrt(np.einsum("in,ij,jn->n", at, found.covariance[0][np.ix_(k, k)], at))
    true = 0.3 + 0.6 * since / 3600
    assert np.all(np.abs(pairs.plots.time_s - clean.time_s - true) <= 4 * sd)
    assert sd.min() < 0.02
