"""Multilateration and RTK receivers: are they as good as they say, and do their files read back as they are?"""

from __future__ import annotations

import datetime
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from boresight.errors import InputError, SettingsError
from boresight.geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from boresight.model import Channel, Fixes, Flag
from boresight.reading import read
from boresight.simulation.reference import (
    Mlat,
    Receiver,
    Rtk,
    check_rtk,
    equip_aircraft,
    mlat_covariance,
    observe_mlat,
    observe_rtk,
)
from boresight.simulation.targets import Target, Waypoint, script_targets
from boresight.simulation.truth import Atmosphere, Traffic, Truth, fly_traffic
from boresight.writing.asterix import write_asterix
from boresight.writing.nmea import write_nmea
from boresight.writing.rtklib import write_rtklib

EPOCH_S = 1_772_359_200.0  # 2026-03-01 10:00
DATE = datetime.date(2026, 3, 1)
PLACE = (math.radians(41.3), math.radians(2.1))
TARGETS = (
    Target(name="racetrack", kind="turning", lat_deg=41.35, lon_deg=2.2, height_m=1500.0, speed_mps=120.0, course_deg=10.0,
           turn_dps=0.9),
    Target(name="high", lat_deg=41.0, lon_deg=1.9, height_m=9000.0, speed_mps=200.0, course_deg=20.0),
    Target(name="truck", kind="waypoints", speed_mps=8.0, height_m=54.0, waypoint=(
        Waypoint(lat_deg=41.29, lon_deg=2.07), Waypoint(lat_deg=41.30, lon_deg=2.09), Waypoint(lat_deg=41.305, lon_deg=2.06))),
    Target(name="boat", craft="ship", lat_deg=41.33, lon_deg=2.25, speed_mps=6.0, course_deg=120.0, length_m=34.0),
)  # fmt: skip


def scene(duration_s: float = 600.0) -> Truth:
    craft = equip_aircraft(0, Traffic(), None, np.random.default_rng(1))
    none = fly_traffic(Traffic(aircraft=0), (), Atmosphere(), EPOCH_S, duration_s, craft, np.random.default_rng(1))
    return script_targets(TARGETS, none, duration_s, (), np.random.default_rng(2), sea_level_m=49.5)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return scene()


def mlat_off(truth: Truth, fixes: Fixes, target: np.ndarray, late_s: float = 0.0) -> np.ndarray:
    """East and north of the truth, metres, of each report."""
    position = truth.motion(target, fixes.time_s - EPOCH_S - late_s, 0).position
    latitude, longitude, height = geodetic_from_ecef(position)
    off = ecef_from_geodetic(fixes.latitude_rad, fixes.longitude_rad, height) - position
    return rotate(enu_from_ecef(latitude, longitude), off)[:, :2]


def test_mlat_is_as_good_as_it_says(truth: Truth) -> None:
    mlat = Mlat(lat_deg=41.3, lon_deg=2.1, height_m=54.0, horizontal_sd_m=6.0, latency_s=0.4, loss=0.1, radius_m=300e3)
    parts = [observe_mlat(scene(), mlat, np.random.default_rng(seed)) for seed in range(6)]
    off = np.concatenate([mlat_off(truth, fixes, target, 0.4) for fixes, target in parts])
    np.testing.assert_allclose(off.std(axis=0), 6.0, rtol=0.08)
    assert np.abs(off.mean(axis=0)).max() < 0.6
    fixes, target = parts[0]
    assert (fixes.horizontal_sd_m == 6.0).all()
    # 0.4 s at 120 m/s: it is late, and would be 48 m off without that.
    fast = target == 0
    assert 40 < np.nanmedian(np.linalg.norm(mlat_off(truth, fixes, target)[fast], axis=1)) < 56
    assert set(target.tolist()) == {0, 1, 2}, "ships have no transponder"
    assert len(fixes) == pytest.approx(0.9 * (truth.last_s - truth.first_s)[:3].sum(), rel=0.03)
    np.testing.assert_array_equal(fixes.mode_s, truth.aircraft.mode_s[target])
    assert (np.diff(fixes.time_s) >= 0).all()
    assert ((fixes.flags == int(Flag.GROUND)) == (target == 2)).all()
    # The correlated part: neighbouring errors share 0.3 of the variance, but for what a second wanders.
    mine = mlat_off(truth, fixes[fast], target[fast], 0.4)
    assert np.mean(mine[1:] * mine[:-1]) / 36.0 == pytest.approx(0.3, abs=0.15)


def test_mlat_covers_its_region(truth: Truth) -> None:
    wide = Mlat(lat_deg=41.3, lon_deg=2.1, height_m=54.0)
    surface = observe_mlat(truth, msgspec.structs.replace(wide, radius_m=5e3, ceiling_m=200.0), np.random.default_rng(1))[1]
    assert set(surface.tolist()) == {2}
    fixes, target = observe_mlat(truth, msgspec.structs.replace(wide, radius_m=20e3), np.random.default_rng(1))
    centre = ecef_from_geodetic(*PLACE, 54.0)
    away = rotate(enu_from_ecef(*PLACE), truth.motion(target, fixes.time_s - EPOCH_S, 0).position - centre)
    assert np.hypot(away[:, 0], away[:, 1]).max() < 20e3
    assert len(np.unique(observe_mlat(truth, msgspec.structs.replace(wide, share=0.34), np.random.default_rng(1))[1])) == 1
    nobody, _ = observe_mlat(truth, msgspec.structs.replace(wide, lat_deg=10.0, identity=False), np.random.default_rng(1))
    assert len(nobody) == 0
    again = observe_mlat(truth, wide, np.random.default_rng(7))[0]
    np.testing.assert_array_equal(again.latitude_rad, observe_mlat(truth, wide, np.random.default_rng(7))[0].latitude_rad)


def ring(count: int, radius_m: float, height_m: float = 100.0) -> tuple[Receiver, ...]:
    turn = 2 * np.pi * np.arange(count) / count
    lat = 41.3 + np.degrees(radius_m * np.cos(turn) / 6.36e6)
    lon = 2.1 + np.degrees(radius_m * np.sin(turn) / (6.38e6 * math.cos(PLACE[0])))
    return tuple(Receiver(lat_deg=float(a), lon_deg=float(b), height_m=height_m) for a, b in zip(lat, lon, strict=True))


def test_the_geometry_of_the_receivers_gives_the_accuracy(truth: Truth) -> None:
    """In the middle of a ring of n receivers the sd of an axis is that of an arrival times sqrt(2 / n); far outside it grows."""
    mlat = Mlat(lat_deg=41.3, lon_deg=2.1, receiver=ring(8, 20e3), arrival_sd_m=3.0)
    middle = ecef_from_geodetic(*PLACE, 100.0)
    at = mlat_covariance(mlat, middle[None])[0]
    np.testing.assert_allclose(at, np.eye(2) * 9.0 * 2 / 8, atol=0.03)
    east = ecef_from_geodetic(PLACE[0], PLACE[1] + 60e3 / 6.38e6 / math.cos(PLACE[0]), 100.0)
    outside = mlat_covariance(mlat, east[None])[0]
    assert outside[0, 0] > 20 * outside[1, 1], "along the line of sight the differences of distance hardly change"
    assert outside[0, 0] > 40 * at[0, 0]
    # By simulation: solved from noisy times of arrival with the height known, errors have this covariance.
    rng = np.random.default_rng(3)
    place = np.radians([[r.lat_deg, r.lon_deg] for r in mlat.receiver])
    stands = ecef_from_geodetic(place[:, 0], place[:, 1], 100.0)
    where = ecef_from_geodetic(PLACE[0] + 0.003, PLACE[1] + 0.004, 3000.0)
    axes = enu_from_ecef(*geodetic_from_ecef(where)[:2])
    path = where - stands
    design = np.column_stack([(path @ axes.T) / np.linalg.norm(path, axis=1)[:, None], np.ones(8)])
    heights, arrivals = rng.normal(0, 30.0, 20_000), rng.normal(0, 3.0, (20_000, 8))
    rows = np.vstack([design / 3.0, [[0, 0, 1 / 30.0, 0]]])
    solved = np.linalg.lstsq(rows, np.vstack([arrivals.T / 3.0, heights[None] / 30.0]), rcond=None)[0][:2]
    np.testing.assert_allclose(np.cov(solved), mlat_covariance(mlat, where[None])[0], rtol=0.05, atol=0.02)

    fixes, target = observe_mlat(truth, mlat, np.random.default_rng(5))
    off = mlat_off(truth, fixes, target)
    assert np.sqrt(np.mean(off**2, axis=1) / fixes.horizontal_sd_m**2).mean() == pytest.approx(0.85, abs=0.2)
    assert fixes.horizontal_sd_m.max() <= mlat.worst_sd_m
    assert np.ptp(fixes.horizontal_sd_m) > 1.0


def test_mlat_reads_back_from_cat020(truth: Truth, tmp_path: Path) -> None:
    mlat = Mlat(lat_deg=41.3, lon_deg=2.1, height_m=54.0, height_sd_m=12.0)
    fixes, _ = observe_mlat(truth, mlat, np.random.default_rng(1))
    write_asterix(tmp_path / "mlat.ast", fixes=fixes)
    recording = read(tmp_path / "mlat.ast", date=DATE)
    again = recording.fixes
    assert recording.by_category == {20: len(fixes)}
    assert not recording.damaged
    np.testing.assert_array_equal(again.time_s, fixes.time_s)
    half_step = math.radians(180 / 2**25) / 2
    assert np.abs(again.latitude_rad - fixes.latitude_rad).max() <= half_step * 1.001
    assert np.abs(again.longitude_rad - fixes.longitude_rad).max() <= half_step * 1.001
    for name in ("source", "channel", "mode_s", "mode_3a", "callsign", "track", "flags"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fixes, name))
    assert (again.channel == Channel.MLAT).all()
    np.testing.assert_allclose(again.height_m, fixes.height_m, atol=1e-6)
    assert np.abs(again.pressure_altitude_m - fixes.pressure_altitude_m).max() <= 3.82
    np.testing.assert_allclose(again.horizontal_sd_m, fixes.horizontal_sd_m, atol=0.126)
    np.testing.assert_allclose(again.vertical_sd_m, fixes.vertical_sd_m, atol=0.251)


def test_rtk_is_as_good_as_it_says(truth: Truth) -> None:
    rtk = Rtk(targets=("boat", "racetrack"), interval_s=0.1, float_share=0.2, float_s=20.0, gap_every_s=100.0, gap_s=10.0)
    normal, shares, gone = [], [], []
    for seed in range(12):
        fixes, target = observe_rtk(truth, rtk, np.random.default_rng(seed))
        assert set(zip(fixes.track.tolist(), target.tolist(), strict=True)) == {(1, 0), (2, 3)}
        position = truth.motion(target, fixes.time_s - EPOCH_S, 0).position
        latitude, longitude, _ = geodetic_from_ecef(position)
        off = ecef_from_geodetic(fixes.latitude_rad, fixes.longitude_rad, fixes.height_m) - position
        local = rotate(enu_from_ecef(latitude, longitude), off)
        normal.append(local / np.stack([fixes.horizontal_sd_m, fixes.horizontal_sd_m, fixes.vertical_sd_m], axis=1))
        shares.append(np.mean(fixes.horizontal_sd_m > 0.2))
        gone.append(1 - len(fixes) / (10 * 600.0 * 2))
    assert set(np.unique(fixes.horizontal_sd_m)) == {0.01, 0.4}
    np.testing.assert_allclose(np.concatenate(normal).std(axis=0), 1.0, atol=0.12)
    assert np.mean(shares) == pytest.approx(0.2, abs=0.07)
    assert np.mean(gone) == pytest.approx(10 / 110, abs=0.04)
    np.testing.assert_allclose(np.mod(fixes.time_s * 10 + 0.5, 1.0), 0.5, atol=1e-4)


def test_rtk_reads_back_from_rtklib_and_nmea(truth: Truth, tmp_path: Path) -> None:
    fixes, _ = observe_rtk(truth, Rtk(targets=("boat",), float_share=0.3), np.random.default_rng(4))
    assert len(fixes) == pytest.approx(5 * 600, abs=2)
    assert write_rtklib(tmp_path / "boat.pos", fixes) == len(fixes)
    recording = read(tmp_path / "boat.pos")
    again = recording.fixes
    assert not recording.damaged
    counts = {q: int(np.count_nonzero((fixes.horizontal_sd_m > 0.2) == (q == 2))) for q in (1, 2)}
    assert any(f"{counts[1]:,} fixed (Q 1), {counts[2]:,} float (Q 2)" in w for w in recording.warnings)
    np.testing.assert_allclose(again.time_s, fixes.time_s, rtol=0, atol=1e-6)
    assert np.abs(np.degrees(again.latitude_rad - fixes.latitude_rad)).max() < 0.51e-9
    assert np.abs(np.degrees(again.longitude_rad - fixes.longitude_rad)).max() < 0.51e-9
    np.testing.assert_allclose(again.height_m, fixes.height_m, atol=0.51e-4)
    for name in ("horizontal_sd_m", "vertical_sd_m"):
        np.testing.assert_allclose(getattr(again, name), getattr(fixes, name), atol=1e-9)
    for name in ("velocity_east_mps", "velocity_north_mps", "velocity_up_mps"):
        np.testing.assert_allclose(getattr(again, name), getattr(fixes, name), atol=0.51e-5)
    write_nmea(tmp_path / "boat.nmea", fixes=fixes)
    logged = read(tmp_path / "boat.nmea", date=DATE)
    place = logged.platform if len(logged.platform) else logged.fixes
    np.testing.assert_allclose(place.time_s, fixes.time_s, atol=1e-6)
    assert np.abs(np.degrees(place.latitude_rad - fixes.latitude_rad)).max() < 1e-8


def test_what_rtklib_cannot_hold_is_refused(truth: Truth, tmp_path: Path) -> None:
    both, _ = observe_rtk(truth, Rtk(interval_s=1.0), np.random.default_rng(4))
    assert sorted(set(both.track.tolist())) == [1, 2, 3, 4]
    with pytest.raises(InputError, match="several"):
        write_rtklib(tmp_path / "x.pos", both)
    with pytest.raises(InputError, match="1 positions lack a time"):
        write_rtklib(
            tmp_path / "x.pos", both[both.track == 1].replace(height_m=np.r_[np.nan, both.height_m[both.track == 1][1:]])
        )
    with pytest.raises(InputError, match="there are no positions"):
        write_rtklib(tmp_path / "x.pos", Fixes())
    assert not (tmp_path / "x.pos").exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (Mlat(lat_deg=95.0, lon_deg=0.0), "lat_deg"),
        (Mlat(lat_deg=41.0, lon_deg=0.0, receiver=ring(2, 1e4)), "2 receivers do not give a position"),
        (Mlat(lat_deg=41.0, lon_deg=0.0, loss=1.0), "loss"),
        (Mlat(lat_deg=41.0, lon_deg=0.0, interval_s=0.0), "interval_s"),
        (Mlat(lat_deg=41.0, lon_deg=0.0, horizontal_sd_m=math.nan), "positive"),
        (Rtk(targets=("boot",)), "no target 'boot'.*racetrack, high, truck, boat"),
        (Rtk(interval_s=0.0), "interval_s"),
        (Rtk(fixed_sd_m=0.5), "fixed_sd_m"),
        (Rtk(float_share=1.0), "float_share"),
        (Rtk(gap_s=-1.0), "not negative"),
    ],
)  # fmt: skip
def test_mistakes_are_named(truth: Truth, settings: Mlat | Rtk, words: str) -> None:
    observe = (lambda rng: observe_mlat(truth, settings, rng)) if isinstance(settings, Mlat) else (
        lambda rng: observe_rtk(truth, settings, rng)
    )  # fmt: skip
    with pytest.raises(SettingsError, match=words):
        observe(np.random.default_rng(1))
    with pytest.raises(SettingsError, match="there are none"):
        check_rtk(Rtk(), ("", ""))
