"""Association end to end, on scenes whose every plot's aircraft is known: right pairs, counts, and bad input."""

import numpy as np
import pytest
from association_traffic import LAT, LON, Scene, radar, scene, wrong

from boresight.association import AssociationSettings, associate, search
from boresight.errors import InputError, NothingToDo, SettingsError
from boresight.model import Fixes, Flag, Pairs, Plots, Sensors, pack_callsigns
from boresight.simulation import simulate
from boresight.simulation.demo import association_scene
from boresight.targets import targets_of


def find(s: Scene, **options):
    return search(s.plots, s.fixes, s.sensors, AssociationSettings(**options))


def errors(s: Scene, found) -> int:
    return int(wrong(found.pairs.plot, found.pairs.target, targets_of(s.fixes), s).sum())


def pairable(s: Scene) -> int:
    return int(np.isin(s.plot_of, s.fix_of).sum())


def only(s: Scene, rows) -> Scene:
    return Scene(s.plots[rows], s.fixes, s.sensors, s.plot_of[rows], s.fix_of)


class TestRightPairs:
    @pytest.mark.parametrize("seed", [1, 2, 3])
    def test_ninety_aircraft_without_identity(self, seed):
        """The simulator's scene, every declared pair counted: >= 98 % of pairable plots found, <= 1 % of the pairs wrong."""
        run = simulate(association_scene(seed), seed)
        found = search(run.plots, run.fixes, run.sensors)
        owner = np.full(int(targets_of(run.fixes).max()) + 1, -2)
        owner[targets_of(run.fixes)] = run.fix_target
        true = run.plot_target[found.pairs.plot]
        assert np.mean(owner[found.pairs.target] != true) <= 0.01
        # Tracks that have a reference: the aircraft of most plots sends ADS-B, and did so while the track lasted.
        plots, right, all_tracks = run.plots, 0, 0
        for number in np.unique(plots.track[plots.track >= 0]):
            rows = np.flatnonzero(plots.track == number)
            mine = np.bincount(run.plot_target[rows] + 1).argmax() - 1
            stamps = np.sort(run.fixes.time_s[run.fix_target == mine])
            near = len(stamps) and np.mean([np.min(np.abs(stamps - t)) < 5 for t in plots.time_s[rows]]) > 0.5
            if len(rows) >= 3 and near:
                all_tracks += 1
                here = np.isin(found.pairs.plot, rows)
                right += bool(here.any() and np.mean(owner[found.pairs.target[here]] == mine) > 0.5)
        assert all_tracks > 50
        assert right >= 0.98 * all_tracks
        bias, true_errors = found.bias[0], run.errors["primary"]
        assert abs(bias.range_m - true_errors["range_bias"]) < 30
        assert abs(np.degrees(bias.azimuth_rad) - true_errors["azimuth_bias"]) < 0.03
        assert abs(bias.time_s - true_errors["time_offset"]) < 0.1

    @pytest.mark.parametrize("azimuth_deg", [-2.8, 0.0, 2.8])
    def test_biases_do_not_matter(self, azimuth_deg):
        """At any azimuth bias of the window the same share is found, and none is wrong."""
        s = scene(seed=5, aircraft=60, azimuth_bias_deg=azimuth_deg, range_bias_m=-700, late_s=0.8)
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.98 * pairable(s)
        assert np.degrees(found.bias[0].azimuth_rad) == pytest.approx(azimuth_deg, abs=0.02)
        assert found.bias[0].time_s == pytest.approx(0.8, abs=0.1)

    def test_the_gate_does_not_cut_the_errors(self):
        """The pairs' errors have the sd and the mean that were put in: no side of them is cut off."""
        s = scene(seed=9, aircraft=60, range_bias_m=900, azimuth_bias_deg=-2.0, range_sd_m=90, azimuth_sd_deg=0.15)
        found = find(s)
        reach = found.pairs.position - _site()
        error = found.pairs.plots.range_m - np.linalg.norm(reach, axis=1)
        assert np.mean(error) == pytest.approx(900, abs=4 * 90 / np.sqrt(len(error)))
        assert np.std(error) == pytest.approx(90, rel=0.05)

    @pytest.mark.parametrize(("identity", "numbers"), [(True, True), (False, True), (False, False)])
    def test_large_gain_and_eccentricity(self, identity, numbers):
        """3 m/km of range gain and half a degree of eccentricity: all of the coverage is paired, not just one sector."""
        s = scene(seed=12, aircraft=50, identity=identity, numbers=numbers, unknown=0)
        distance, azimuth = s.plots.range_m, s.plots.azimuth_rad
        bent = azimuth + np.radians(0.5) * np.cos(azimuth)
        s.plots = s.plots.replace(range_m=1.003 * distance, azimuth_rad=bent % (2 * np.pi))
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.98 * pairable(s)
        assert found.bias[0].range_gain == pytest.approx(0.003, abs=0.0008)

    def test_plots_without_track_numbers(self):
        """Single plots among twice as much clutter: nearest target after the search, one plot per target and scan."""
        s = scene(seed=4, aircraft=40, numbers=False, clutter=2000)
        found = find(s)
        assert errors(s, found) <= 0.01 * len(found.pairs)
        assert len(found.pairs) >= 0.98 * pairable(s)
        order = np.lexsort((found.pairs.plots.time_s, found.pairs.target))
        same = np.diff(found.pairs.target[order]) == 0
        assert np.diff(found.pairs.plots.time_s[order])[same].min() >= 2.0
        assert np.array_equal(np.unique(found.pairs.track), found.decisions.track[found.decisions.used > 0])

    def test_track_numbers_that_change(self):
        """Tracks broken every 100 s: each piece finds its target, several share one."""
        s = scene(seed=6, aircraft=60)
        number = s.plots.track + 200 * ((s.plots.time_s - s.plots.time_s[0]) // 100).astype(np.int32)
        s.plots = s.plots.replace(track=number)
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.98 * pairable(s)
        pieces = np.bincount(found.decisions.target[found.decisions.target >= 0])
        assert np.median(pieces[pieces > 0]) >= 3

    def test_the_reference_is_that_of_the_plots_stamp(self):
        """The pairs' positions are the truth at the stamp, unshifted: range error = bias + noise for stamps that are right."""
        s = scene(seed=7, aircraft=20, range_bias_m=0, azimuth_bias_deg=0, range_sd_m=1.0)
        found = find(s)
        error = found.pairs.plots.range_m - np.linalg.norm(found.pairs.position - _site(), axis=1)
        assert np.median(np.abs(error)) < 6
        assert np.all(np.diff(found.pairs.plot) > 0)
        assert np.isfinite(found.pairs.heading_rad).mean() > 0.95
        assert np.array_equal(found.pairs.plots.range_m, s.plots.range_m[found.pairs.plot])

    def test_the_order_of_records_does_not_matter(self):
        """Shuffled plots and fixes give the same pairs."""
        s = scene(seed=8, aircraft=20)
        rng = np.random.default_rng(0)
        p, f = rng.permutation(len(s.plots)), rng.permutation(len(s.fixes))
        straight, mixed = find(s), search(s.plots.take(p), s.fixes.take(f), s.sensors)
        back = np.argsort(p[mixed.pairs.plot])
        assert np.array_equal(p[mixed.pairs.plot][back], straight.pairs.plot)
        assert np.array_equal(mixed.pairs.target[back], straight.pairs.target)

    def test_pressure_altitude_tells_stacked_aircraft_apart(self):
        """Two aircraft on one ground track, 300 m apart in height, their identities unknown: heights decide."""
        s = scene(seed=11, aircraft=12, unknown=0, range_bias_m=0, azimuth_bias_deg=0)
        truth = targets_of(s.fixes)
        level = np.linspace(2000, 11000, 12)
        fixes = s.fixes.replace(pressure_altitude_m=level[s.fix_of])
        plots = s.plots.replace(pressure_altitude_m=level[s.plot_of])
        # A twin of aircraft 0, 300 m higher, in both recordings.
        up = s.fixes.take(np.flatnonzero(s.fix_of == 0))
        up = up.replace(
            mode_s=np.full(len(up), 0x400000), height_m=up.height_m + 300, pressure_altitude_m=np.full(len(up), level[0] + 300)
        )
        mine = np.flatnonzero(s.plot_of == 0)
        rng = np.random.default_rng(1)
        twin = plots.take(mine).replace(
            track=np.full(len(mine), 999), pressure_altitude_m=np.full(len(mine), level[0] + 300),
            range_m=plots.range_m[mine] + rng.normal(0, 40, len(mine)),
        )  # fmt: skip
        both, fixes = Plots.concat([plots, twin]), Fixes.concat([fixes, up])
        found = search(both, fixes, s.sensors)
        targets = targets_of(fixes)
        higher = targets[-1]
        at = found.pairs.plot >= len(plots)
        assert at.any()
        assert np.all(found.pairs.target[at] == higher)
        assert not np.any(found.pairs.target[~at] == higher)
        assert len(truth) < len(targets)


def _site():
    from boresight.geodesy import ecef_from_geodetic

    return ecef_from_geodetic(np.radians(LAT), np.radians(LON), 50.0)


class TestIdentity:
    def test_addresses_pair_at_once(self):
        """Both sides carry Mode S: found by identity, with biases outside of the search window, and no pair is wrong."""
        s = scene(seed=2, identity=True, azimuth_bias_deg=6.0, range_bias_m=3000)
        found = find(s)
        assert found.bias[0].by == "identity"
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.99 * pairable(s)
        assert set(found.decisions.by[found.decisions.target >= 0].tolist()) == {0}

    @pytest.mark.parametrize("kind", ["callsign", "mmsi", "mode_3a"])
    def test_other_identities(self, kind):
        """Callsigns, MMSI and discrete Mode 3/A codes pair as well; what is not an identity does not."""
        s = scene(seed=3, aircraft=30, unknown=0)
        values = {
            "callsign": pack_callsigns([f"ABC{k:02d}" for k in range(30)]),
            "mmsi": 211_000_000 + np.arange(30),
            "mode_3a": 0o0401 + np.arange(30),
        }[kind]
        s.plots = s.plots.replace(**{kind: values[s.plot_of]})
        s.fixes = s.fixes.replace(**{kind: values[s.fix_of]})
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.99 * pairable(s)
        expected = {"callsign": 2, "mmsi": 1, "mode_3a": 3}[kind]
        assert np.mean(found.decisions.by[found.decisions.target >= 0] == expected) > 0.9

    def test_wrong_addresses_do_not_poison(self):
        """A quarter of the aircraft carry each other's address: none of these is paired with the wrong one."""
        s = scene(seed=5, aircraft=40, identity=True)
        rng = np.random.default_rng(1)
        victims = rng.permutation(40)[:10]
        address = {int(a): s.plots.mode_s[s.plot_of == a][0] for a in range(40)}
        mode_s = s.plots.mode_s.copy()
        for a, b in zip(victims, np.roll(victims, 1), strict=True):
            mode_s[s.plot_of == a] = address[int(b)]
        s.plots = s.plots.replace(mode_s=mode_s)
        found = find(s)
        assert errors(s, found) == 0
        honest = np.isin(s.plot_of, s.fix_of) & ~np.isin(s.plot_of, victims)
        assert np.isin(np.flatnonzero(honest), found.pairs.plot).mean() > 0.99

    def test_garbled_replies_do_not_poison(self):
        """A tenth of the plots carry any other aircraft's address: tracks keep their majority's."""
        s = scene(seed=6, aircraft=30, identity=True)
        rng = np.random.default_rng(2)
        mode_s = np.where(rng.random(len(s.plots)) < 0.1, rng.permutation(s.plots.mode_s), s.plots.mode_s)
        s.plots = s.plots.replace(mode_s=mode_s)
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.99 * pairable(s)

    def test_two_tracks_with_one_address(self):
        """Two aircraft of one address: only the one whose geometry agrees is paired."""
        s = scene(seed=7, aircraft=20, unknown=0, identity=True)
        s.fixes, s.fix_of = s.fixes[s.fix_of != 3], s.fix_of[s.fix_of != 3]
        mode_s = s.plots.mode_s.copy()
        mode_s[s.plot_of == 3] = mode_s[s.plot_of == 4][0]
        s.plots = s.plots.replace(mode_s=mode_s)
        found = find(s)
        assert errors(s, found) == 0
        assert not np.any(s.plot_of[found.pairs.plot] == 3)
        assert np.sum(s.plot_of[found.pairs.plot] == 4) > 60

    def test_one_wrong_address_does_not_decide(self):
        """A single aircraft with Mode S, and its address is another's: the many without identity are believed."""
        s = scene(seed=9, aircraft=30, unknown=0.2)
        sent = np.unique(s.fix_of)
        mode_s = np.full(len(s.plots), -1)
        mode_s[s.plot_of == sent[0]] = s.fixes.mode_s[s.fix_of == sent[1]][0]
        s.plots = s.plots.replace(mode_s=mode_s)
        found = find(s)
        assert found.bias[0].by == "geometry"
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.94 * pairable(s)

    def test_reused_codes_need_geometry(self):
        """All aircraft share two Mode 3/A codes: codes alone would pair anything; geometry keeps every pair right."""
        s = scene(seed=8, aircraft=30, unknown=0.2)
        code = np.array([0o4521, 0o4522])
        s.plots = s.plots.replace(mode_3a=code[s.plot_of % 2])
        s.fixes = s.fixes.replace(mode_3a=code[s.fix_of % 2])
        found = find(s)
        assert errors(s, found) == 0
        assert len(found.pairs) >= 0.98 * pairable(s)


class TestCounts:
    def test_every_plot_has_one_fate(self):
        """Flags, NaN, limits, duplicates and strangers are counted by reason, and all counts add up."""
        s = scene(seed=1, aircraft=20)
        n = len(s.plots)
        flags, distance, sensor = np.zeros(n, np.uint32), s.plots.range_m.copy(), s.plots.sensor.copy()
        flags[:10] = Flag.SIMULATED
        flags[10:15] = Flag.REFLECTION | Flag.GROUND
        distance[20:30] = np.nan
        distance[30:33] = -5.0
        distance[33:40] = 300e3
        sensor[40:44] = 77
        plots = Plots.concat([s.plots.replace(flags=flags, range_m=distance, sensor=sensor), s.plots[100:150]])
        found = search(plots, s.fixes, Sensors((radar(max_range_m=200e3),)))
        lost = found.not_used
        assert lost["flag"] == 15
        assert lost["NaN"] == 10
        assert lost["out of limits"] == 10
        assert lost["no sensor"] == 4
        assert lost["duplicate"] == 50
        assert sum(lost.values()) + len(found.pairs) == len(plots)
        assert any("SAC/SIC 0/77" in said for said in found.warnings)
        assert found.decisions.used.sum() == len(found.pairs)

    def test_associate_is_the_pairs_of_search(self):
        """The plain verb gives the same table, and twice the same bytes."""
        s = scene(seed=2, aircraft=15)
        pairs = associate(s.plots, s.fixes, s.sensors)
        again = find(s).pairs
        assert isinstance(pairs, Pairs)
        for (name, a), (_, b) in zip(pairs._flat(), again._flat(), strict=True):
            assert a.tobytes() == b.tobytes(), name

    def test_length_of_the_target(self):
        """Where the reference has no length, the median of what the radar says of its own track is taken."""
        s = scene(seed=3, aircraft=10, unknown=0)
        length = np.where(s.plot_of == 4, 40.0 + np.resize([-3.0, 0.0, 3.0], len(s.plots)), np.nan)
        s.plots = s.plots.replace(length_m=length)
        found = find(s)
        mine = s.plot_of[found.pairs.plot] == 4
        assert np.allclose(found.pairs.length_m[mine], 40.0, atol=3.0)
        assert len(np.unique(found.pairs.length_m[mine])) == 1
        assert np.isnan(found.pairs.length_m[~mine]).all()

    def test_two_radars(self):
        """Two radars with different errors: each has its own biases, tracks are not mixed."""
        a, b = scene(seed=4, aircraft=25, azimuth_bias_deg=2.0), scene(seed=4, aircraft=25, azimuth_bias_deg=-1.0)
        second = radar(name="S", sac=20, sic=130)
        plots = Plots.concat([a.plots, b.plots.replace(sensor=np.full(len(b.plots), 20 << 8 | 130))])
        found = search(plots, a.fixes, Sensors((radar(), second)))
        assert [round(float(np.degrees(x.azimuth_rad))) for x in found.bias] == [2, -1]
        one = set(found.pairs.track[found.pairs.plots.sensor == second.key].tolist())
        other = set(found.pairs.track[found.pairs.plots.sensor != second.key].tolist())
        assert not one & other
        assert one | other == set(found.decisions.track[found.decisions.used > 0].tolist())


class TestBadInput:
    def test_clocks_1_3_s_apart_are_found_and_said(self):
        s = scene(seed=1, late_s=1.3)
        found = find(s)
        assert errors(s, found) == 0
        assert found.bias[0].time_s == pytest.approx(1.3, abs=0.1)
        assert any("1.3 s late" in said for said in found.warnings)

    @pytest.mark.parametrize("identity", [False, True])
    @pytest.mark.parametrize("late_s", [1560.0, -1560.0, 20.0])
    def test_clocks_far_apart_are_refused(self, late_s, identity):
        """26 minutes: refused, the window and the probable offset are named, and the way to give it; given, it works."""
        s = scene(seed=8, seconds=2400, aircraft=40, identity=identity, late_s=late_s)
        with pytest.raises(NothingToDo) as caught:
            find(s)
        text = str(caught.value)
        assert "±2.5 s" in text
        assert "time_offset_s" in text
        assert ("late" if late_s > 0 else "early") in text
        named = float(text.split("time_offset_s = ")[1].split()[0])
        assert named == pytest.approx(late_s, abs=0.3)
        s.plots = s.plots.replace(time_s=s.plots.time_s - named)
        repaired = find(s)
        assert errors(s, repaired) == 0
        assert len(repaired.pairs) > 0.98 * pairable(s)

    def test_a_day_apart(self):
        s = scene(seed=1, aircraft=10)
        with pytest.raises(NothingToDo, match="24 h"):
            search(s.plots.replace(time_s=s.plots.time_s + 86400), s.fixes, s.sensors)

    def test_a_reference_far_away(self):
        s = scene(seed=1, aircraft=10)
        with pytest.raises(NothingToDo, match=r"1\d\d\d\.\d km from the radar"):
            search(s.plots, s.fixes.replace(latitude_rad=s.fixes.latitude_rad + 0.2), s.sensors)

    @pytest.mark.parametrize("numbers", [True, False])
    @pytest.mark.parametrize("seed", range(3))
    def test_other_traffic_is_refused(self, seed, numbers):
        """The reference of another day's sky: nothing that is there agrees better than chance."""
        s, other = scene(seed=seed, aircraft=60, numbers=numbers), scene(seed=100 + seed, aircraft=60)
        with pytest.raises(NothingToDo, match="better than chance"):
            search(s.plots, other.fixes, s.sensors)

    def test_all_outliers(self):
        s = scene(seed=1, numbers=False)
        rng = np.random.default_rng(1)
        plots = s.plots.replace(azimuth_rad=rng.uniform(0, 6.28, len(s.plots)), range_m=rng.uniform(5e3, 1e5, len(s.plots)))
        with pytest.raises(NothingToDo, match="better than chance"):
            search(plots, s.fixes, s.sensors)

    def test_one_plot_and_one_track(self):
        """Too little to judge without identity; one track with an address is enough."""
        s = scene(seed=1, unknown=0, identity=True)
        one = only(s, s.plot_of == 2)
        bare = only(s, s.plot_of == 2)
        bare.plots = bare.plots.replace(mode_s=np.full(len(bare.plots), -1))
        with pytest.raises(NothingToDo, match="1 track of at least 3 plots"):
            find(bare)
        with pytest.raises(NothingToDo, match="3 plots"):
            find(only(s, np.flatnonzero(s.plot_of == 2)[:1]))
        found = find(one)
        assert errors(one, found) == 0
        assert len(found.pairs) > 60

    def test_nothing_at_all(self):
        s = scene(seed=1, aircraft=5)
        with pytest.raises(NothingToDo, match="no plots"):
            search(Plots(), s.fixes, s.sensors)
        with pytest.raises(NothingToDo, match="no position"):
            search(s.plots, Fixes(), s.sensors)
        with pytest.raises(NothingToDo, match="plots can be used"):
            search(s.plots.replace(flags=np.full(len(s.plots), Flag.TEST)), s.fixes, s.sensors)

    def test_sensors_that_are_not_described(self):
        s = scene(seed=1, aircraft=5)
        with pytest.raises(SettingsError, match="20/129"):
            search(s.plots, s.fixes, Sensors((radar(sac=1, sic=2),)))
        with pytest.raises(SettingsError, match="no position"):
            search(s.plots, s.fixes, Sensors((radar(lat_deg=None),)))

    def test_cartesian_fixes_are_named(self):
        s = scene(seed=1, aircraft=5)
        fixes = Fixes(time_s=s.fixes.time_s, x_m=np.zeros(len(s.fixes)), y_m=np.zeros(len(s.fixes)), mode_s=s.fixes.mode_s)
        with pytest.raises(InputError, match="locate"):
            search(s.plots, fixes, s.sensors)

    @pytest.mark.parametrize("option", [{"gate_sd": 0.0}, {"gate_m": -1.0}, {"points": 1}, {"range_window_m": 0.0}])
    def test_settings_that_make_no_sense(self, option):
        with pytest.raises(SettingsError, match=next(iter(option))):
            AssociationSettings(**option)


@pytest.fixture(scope="module")
def recordings(data):
    """The radar's plots, and both references made geodetic."""
    import datetime

    from boresight.alignment import locate
    from boresight.model import Sensor
    from boresight.reading import read

    day = datetime.date(2016, 5, 10)
    folder = data / "lebl-2016"
    sensors = Sensors((
        Sensor(name="SMR", sac=0, sic=7, lat_deg=41.29561833, lon_deg=2.095114167, height_m=85.0, kind="surface", scan_s=1.0),
        Sensor(name="MLAT", sac=0, sic=107, lat_deg=41.297079, lon_deg=2.078463, height_m=51.0, kind="mlat"),
    ))  # fmt: skip
    smr = read(folder / "smr_cat010_160510-lebl-220001.ast", date=day)
    mlat = read(folder / "mlat_cat010_160510-lebl-220001.ast", date=day)
    adsb = read(folder / "adsb_cat021v023_160510-lebl-220001.ast", date=day, editions={21: "0.23"})
    return {
        "plots": smr.plots,
        "sensors": sensors,
        "mlat": locate(mlat.fixes, sensors, mlat.sources)[0],
        "adsb": locate(adsb.fixes, sensors, adsb.sources)[0],
    }


@pytest.mark.real
class TestBarcelona:
    """The surface radar of Barcelona against multilateration and ADS-B (METHODS section 7)."""

    @pytest.mark.parametrize(("name", "plots", "targets"), [("mlat", 9000, 26), ("adsb", 6000, 20)])
    def test_pairs(self, recordings, name, plots, targets):
        """Enough moving targets on the ground, all within the gate about the biases, and the biases where others found them."""
        found = search(recordings["plots"], recordings[name], recordings["sensors"])
        assert len(found.pairs) >= plots
        assert len(np.unique(found.pairs.target)) >= targets
        bias = found.bias[0]
        assert abs(bias.range_m) < 6
        assert 0.08 < np.degrees(bias.azimuth_rad) < 0.4
        assert abs(bias.time_s) < 0.6
        assert np.median(np.linalg.norm(found.pairs.velocity, axis=1)) > 4
        assert found.not_used["parked"] > 30_000
        assert sum(found.not_used.values()) + len(found.pairs) == len(recordings["plots"])

    def test_both_references_agree(self, recordings):
        """A plot that both references claim is the same aircraft in both: association without identity, judged by identity."""
        both = {}
        for name in ("mlat", "adsb"):
            fixes = recordings[name]
            target = targets_of(fixes)
            address = np.full(int(target.max()) + 1, -1, np.int64)
            address[target[target >= 0]] = fixes.mode_s[target >= 0]
            found = search(recordings["plots"], fixes, recordings["sensors"])
            both[name] = dict(zip(found.pairs.plot.tolist(), address[found.pairs.target].tolist(), strict=True))
        shared = [p for p in both["mlat"] if p in both["adsb"] and both["mlat"][p] > 0 and both["adsb"][p] > 0]
        assert len(shared) > 3000
        assert np.mean([both["mlat"][p] == both["adsb"][p] for p in shared]) > 0.99

    def test_clocks_of_a_surface_radar(self, recordings):
        """Stamps 26 minutes late: refused, with the offset named; 1.3 s late: found."""
        plots = recordings["plots"]
        with pytest.raises(NothingToDo, match=r"26\.0 minutes"):
            search(plots.replace(time_s=plots.time_s + 1560), recordings["mlat"], recordings["sensors"])
        late = search(plots.replace(time_s=plots.time_s + 1.3), recordings["adsb"], recordings["sensors"])
        here = search(plots, recordings["adsb"], recordings["sensors"])
        assert late.bias[0].time_s - here.bias[0].time_s == pytest.approx(1.3, abs=0.15)
