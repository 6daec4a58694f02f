"""Every method by one interface: truth within its uncertainty, the same folds, bad input told in a line and never as a number."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
import numpy as np
import pytest
from synthetic import DEG, RADARS, WHITE, Errors, airliner, path, scene

from boresight.calibration import Calibration, load_calibration, save_calibration, summary_json
from boresight.correction import correct
from boresight.errors import NothingToDo, SettingsError
from boresight.model import Pairs, Sensors
from boresight.registration.methods import METHODS, Method, displacement, method_of, name_of, options_of, register_with

ONE = Sensors((RADARS.sensor[0],))
KEY = ONE.sensor[0].key
BIASES = {"A": {"range_bias": 120.0, "azimuth_bias": 0.2 * DEG}}
UP = {"A": {**BIASES["A"], "elevation_bias": -0.1 * DEG}}
FAST = {"least-squares": {"criterion": "none"}}


def fast(name: str) -> Method:
    """The method, without the search for a model."""
    return method_of(name, FAST.get(name))


def checked(
    name: str, pairs: Pairs, sensors: Sensors = ONE, *, online: bool = False, options: Mapping[str, object] | None = None
) -> Calibration:
    """The result with what every result must hold: finite numbers, honest to print, nothing both told and not told."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = register_with(method_of(name, options) if options else fast(name), pairs, sensors, online=online)
        text = str(found)
    assert "nan" not in text.replace("determinan", "")
    assert np.isfinite(found.value).all()
    assert np.isfinite(found.covariance).all()
    assert (found.sd > 0).all()
    assert len(found.terms) > 0
    for k in range(0, len(found.epoch_s), 50):
        size = found.sd[k]
        assert np.linalg.eigvalsh(found.covariance[k] / size[:, None] / size).min() > -1e-9
    for summary in found.sensors:
        told = {key.name for key in found.terms if key.sensor == summary.sensor}
        missing = [n for n in found.not_determined if n.sensor == summary.sensor]
        assert not told & {n.term for n in missing}
        assert all(n.why for n in missing)
        assert {"range_bias", "azimuth_bias", "time_offset", "elevation_bias"} <= told | {n.term for n in missing}
        for noise in (summary.noise.range_m, summary.noise.azimuth_rad):
            assert np.isfinite(noise)
    assert found.settings["method"] == name
    return found


# ------------------------------------------------------------------------------------------------------------------- bad input
def radial() -> Pairs:
    position = path(46.0, 14.0, 0.0, 60e3, np.pi, 200.0, 0.0, 9e3, 0.0, 400.0)
    return scene(2, BIASES, sensors=ONE, errors=WHITE, targets=1, track=lambda rng: (position, 0.0, 480.0, 40.0)).pairs


def level_track(rng: np.random.Generator) -> tuple[Callable[..., np.ndarray], float, float, float]:
    """At the height of the antenna: tan E is nothing."""
    x, y = rng.uniform(-8e3, 8e3, 2)
    return path(46.0, 14.0, x, y, rng.uniform(0, 6), 12.0, 0.0, 300.0, 0.0, 100.0), 0.0, 200.0, 40.0


def at_the_horizon() -> Pairs:
    pairs = scene(4, UP, sensors=ONE, errors=WHITE, targets=8, track=level_track, near_m=500.0, elevation=True).pairs
    return pairs.replace(plots=pairs.plots.replace(elevation_rad=np.zeros(len(pairs))))


def outliers() -> Pairs:
    rng = np.random.default_rng(0)
    pairs = scene(6, {}, sensors=ONE, targets=6).pairs
    wild = pairs.plots.replace(range_m=rng.uniform(1e3, 150e3, len(pairs)), azimuth_rad=rng.uniform(0, 2 * np.pi, len(pairs)))
    return pairs.replace(plots=wild)


def constant() -> Pairs:
    """No noise at all: every error is the same number."""
    return scene(5, UP, sensors=ONE, errors=Errors(range_m=0.0, azimuth_rad=0.0, elevation_rad=0.0), targets=4,
                 elevation=True).pairs  # fmt: skip


def one_place() -> Pairs:
    """The same plot again and again."""
    return Pairs.concat([radial()[:1]] * 30)


def with_nan() -> Pairs:
    pairs = scene(7, UP, sensors=ONE, targets=6, elevation=True).pairs
    rng = np.random.default_rng(1)

    def holes(column: np.ndarray) -> np.ndarray:
        out = np.array(column, np.float64)
        out[rng.random(len(out)) < 0.1] = np.nan
        return out

    plots = pairs.plots
    return pairs.replace(
        plots=plots.replace(
            time_s=holes(plots.time_s),
            range_m=holes(plots.range_m),
            azimuth_rad=holes(plots.azimuth_rad),
            elevation_rad=holes(plots.elevation_rad),
        ),
        position=holes(pairs.position),
        covariance=holes(pairs.covariance),
        acceleration=holes(pairs.acceleration),
    )


BAD: dict[str, Callable[[], Pairs]] = {
    "one plot": lambda: radial()[:1],
    "two plots": lambda: radial()[:2],
    "four plots": lambda: radial()[:4],
    "one plot again and again": one_place,
    "one radial track": radial,
    "one track": lambda: scene(8, BIASES, sensors=ONE, targets=1).pairs,
    "one track with elevation": lambda: scene(8, UP, sensors=ONE, targets=1, elevation=True).pairs,
    "the horizon": at_the_horizon,
    "outliers": outliers,
    "constant": constant,
    "no number here and there": with_nan,
    "all at one time": lambda: (p := with_nan()).replace(plots=p.plots.replace(time_s=np.full(len(p), 1.7e9))),
    "no number at all": lambda: (p := radial()).replace(plots=p.plots.replace(range_m=np.full(len(p), np.nan))),
    "none": lambda: radial()[:0],
}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("what", BAD)
def test_bad_input_gives_what_can_be_told_or_a_line(name: str, what: str) -> None:
    said = ""
    try:
        checked(name, BAD[what]())
    except NothingToDo as error:
        said = str(error)
    assert not (said and what in ("constant", "no number here and there", "one track"))
    assert "\n" not in said
    assert "nan" not in said


@pytest.mark.parametrize("name", METHODS)
def test_identical_radars_at_one_place_are_each_found_by_themselves(name: str) -> None:
    twin = msgspec.structs.replace(ONE.sensor[0], name="twin", sic=9)
    pairs = scene(5, BIASES, sensors=ONE, targets=6).pairs
    again = pairs.replace(plots=pairs.plots.replace(sensor=np.full(len(pairs), twin.key)))
    both = Pairs.concat([pairs, again])
    found = checked(name, both.replace(plot=np.arange(len(both))), Sensors((ONE.sensor[0], twin)))
    assert [s.name for s in found.sensors] == ["A", "twin"]
    for key in [k for k in found.terms if k.sensor == KEY]:
        one, two = found.index(KEY, key.name), found.index(twin.key, key.name)
        assert one is not None
        assert two is not None
        np.testing.assert_allclose(found.value[:, one], found.value[:, two], rtol=1e-6, atol=1e-9)


def test_what_makes_no_sense_is_refused_in_a_line() -> None:
    with pytest.raises(SettingsError, match=r"no method 'x'.*least-squares, per-channel.*exponential-average"):
        method_of("x")
    with pytest.raises(SettingsError, match=r"no option 'speed'.*gate_sd, max_iterations"):
        method_of("maximum-likelihood", {"speed": "1"})
    with pytest.raises(SettingsError, match=r"genetic: seed = 'abc' cannot be.*default is 1"):
        method_of("genetic", {"seed": "abc"})
    with pytest.raises(SettingsError, match=r"ransac-icp: pairing = 'far' cannot be"):
        method_of("genetic", {"rough.pairing": "far"})
    pairs = radial()
    for name in METHODS:
        if name not in ("least-squares", "per-channel"):
            with pytest.raises(SettingsError, match="one model only"):
                register_with(METHODS[name], pairs, ONE, model="atc")
        with pytest.raises(SettingsError, match="has no entry"):
            register_with(fast(name), pairs, Sensors((RADARS.sensor[1],)))
    for name in ("per-channel", "maximum-likelihood", "ransac-icp", "genetic"):
        with pytest.raises(SettingsError, match=r"one value for all time.*kalman-bank"):
            register_with(METHODS[name], pairs, ONE, online=True)
    with pytest.raises(SettingsError, match="is no model"):
        register_with(METHODS["per-channel"], pairs, ONE, model="atc")
    for options in ({"alpha": "0.5", "slot_s": "0"}, {"beta": "0.1"}, {"tracking_index": "-1"}):
        with pytest.raises(SettingsError, match="makes no sense"):
            register_with(method_of("alpha-beta", options), pairs, ONE)


def test_options_are_text_or_numbers_and_come_back() -> None:
    method = method_of("genetic", {"rough.iterations": "60", "population": "32", "seed": 4})
    assert options_of(method) | {"rough.iterations": 60, "population": 32, "seed": 4} == options_of(method)
    assert method_of("kalman-bank", {"memory_s": "20, 200"}).memory_s == (20.0, 200.0)
    per_channel = method_of("per-channel", {"model": "second-order,first-order,constant", "jerk": "true"})
    assert per_channel.orders == ("second-order", "first-order", "constant")
    assert per_channel.jerk
    for name, each in METHODS.items():
        assert name_of(each) == name
        assert method_of(name, options_of(each)) == each
        assert method_of(name) == each
        told = {k: str(v) for k, v in options_of(each).items() if not isinstance(v, list)}
        assert method_of(name, told) == each


# ------------------------------------------------------------------------------------------------------------- truth, accuracy
@pytest.fixture(scope="module")
def level() -> Pairs:
    return scene(3, BIASES, sensors=ONE, targets=24).pairs


@pytest.fixture(scope="module")
def upright() -> Pairs:
    return scene(3, UP, sensors=ONE, targets=24, elevation=True).pairs


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("elevation", [False, True], ids=["level", "elevation"])
def test_biases_are_found_and_held_out_targets_come_nearer(name: str, elevation: bool, level: Pairs, upright: Pairs) -> None:
    pairs, truth = (upright, UP["A"]) if elevation else (level, BIASES["A"])
    found = checked(name, pairs)
    names = {key.name for key in found.terms}
    if name in ("ransac-icp", "genetic", "kalman-transform"):
        # No transform of positions has a range bias; a turn about the vertical is an azimuth bias.
        k = found.index(KEY, "rotation_up")
        assert k is not None
        late = slice(len(found.epoch_s) // 4, None, 20)
        assert (np.abs(found.value[late, k] + truth["azimuth_bias"]) < 4 * found.sd[late, k]).mean() > 0.8
        assert np.abs(np.median(found.value[:, k]) + truth["azimuth_bias"]) < 0.03 * DEG
        assert ("site_up" in names) == elevation
        assert ("rotation_east" in names) == elevation
    else:
        for term, value in truth.items():
            k = found.index(KEY, term)
            assert k is not None
            late = slice(len(found.epoch_s) // 4, None, 20)
            away = np.abs(found.value[late, k] - value) / found.sd[late, k]
            assert np.median(away) < 2.5, term
            assert (away < 4).mean() > 0.9, term
            limit = 40.0 if term == "range_bias" else 0.1 * DEG
            assert np.median(found.sd[late, k]) < limit
    (summary,) = found.sensors
    # Half of what there was at least; the transforms cannot represent a range bias, and leave 120 m.
    assert summary.after.median_m < 0.6 * summary.before.median_m
    assert summary.held_out_after_median_m < 0.6 * summary.held_out_before_median_m
    assert summary.held_out_after_p95_m < summary.held_out_before_p95_m
    assert summary.after.median_m < 1.02 * summary.held_out_after_median_m
    assert summary.targets == 24 - len(set(range(24)) - set(pairs.target.tolist()))
    assert any(note.startswith("inliers: ") for note in summary.notes)
    assert any(note.startswith("how it ended: ") for note in summary.notes)


def test_the_folds_are_the_same_for_all_methods(level: Pairs) -> None:
    """What is held out has the same errors before, to the last bit, whatever the method."""
    names = ("least-squares", "maximum-likelihood", "ransac-icp", "mean-shift")
    before = [checked(n, level).sensors[0] for n in names]
    assert len({s.held_out_before_median_m for s in before}) == 1
    assert len({s.before.p95_m for s in before}) == 1


@pytest.mark.parametrize("name", ["maximum-likelihood", "kalman-transform", "ransac-icp", "mean-shift"])
def test_a_held_out_target_takes_no_part_in_its_own_correction(name: str) -> None:
    """One target with an error of its own: what is held out of it keeps that error whole."""
    pairs = scene(9, {}, sensors=ONE, errors=Errors(range_m=1.0, azimuth_rad=1e-5), targets=6).pairs
    odd = pairs.target == np.bincount(pairs.target).argmax()
    shifted = pairs.replace(plots=pairs.plots.replace(range_m=pairs.plots.range_m + 300.0 * odd))
    fold = checked(name, shifted).sensors[0]
    assert fold.held_out_after_p95_m > 290.0


def test_a_calibration_is_written_and_read_whatever_the_method(level: Pairs, tmp_path: Path) -> None:
    for name in ("kalman-transform", "genetic", "kalman-bank"):
        found = checked(name, level)
        save_calibration(found, tmp_path / "c.json")
        again = load_calibration(tmp_path / "c.json")
        np.testing.assert_allclose(again.value, found.value, rtol=1e-12)
        assert again.settings == msgspec.to_builtins(found.settings)
        assert method_of(str(again.settings["method"]), {k: v for k, v in again.settings.items() if k != "method"}) == fast(name)
        assert summary_json(again)["sensors"]["A"]["terms"]


@pytest.mark.parametrize("name", ["maximum-likelihood", "ransac-icp", "mean-shift"])
@pytest.mark.parametrize("targets", [3, 16])
def test_the_covariance_is_what_the_errors_are(name: str, targets: int) -> None:
    """Delays of 15 m and offsets of 10 m belong to the targets: their number counts, not that of the plots."""
    nees = []
    for seed in range(24):
        errors = Errors(delay_m=8.0, offset_m=6.0)
        pairs = scene(seed, {}, sensors=ONE, targets=targets, errors=errors, scan_s=10.0).pairs
        found = checked(name, pairs)
        k = found.index(KEY, "rotation_up") if name == "ransac-icp" else found.index(KEY, "range_bias")
        assert k is not None
        nees.append(float(found.value[-1, k] ** 2 / found.covariance[-1, k, k]))
    # With few targets what they typically keep for themselves is assumed, and more than these do.
    assert (0.1 if targets == 3 else 0.4) < np.mean(nees) < 2.0


# ------------------------------------------------------------------------------------------------ transforms as terms, and back
def turned(angle_deg: float, shift_m: float, seed: int = 1) -> tuple[Pairs, np.ndarray, np.ndarray]:
    """Pairs whose plots are the truth turned about the radar and shifted, without noise; the rotation vector and the shift."""
    from scipy.spatial.transform import Rotation

    from boresight.geodesy import rotate
    from boresight.measure import polar_from_enu, site_of

    pairs = scene(11, {}, sensors=ONE, targets=12, elevation=True).pairs
    rng = np.random.default_rng(seed)
    vector, shift = rng.choice((-1, 1), 3) * angle_deg * DEG, rng.choice((-1, 1), 3) * shift_m
    site, rotation = site_of(ONE.sensor[0])
    truth = rotate(rotation, pairs.position - site)
    polar = polar_from_enu(truth @ Rotation.from_rotvec(vector).as_matrix().T + shift)
    plots = pairs.plots.replace(range_m=polar[:, 0], azimuth_rad=polar[:, 1], elevation_rad=polar[:, 2])
    return pairs.replace(plots=plots), vector, shift


@pytest.mark.parametrize("name", ["ransac-icp", "genetic", "kalman-transform"])
def test_a_picture_turned_and_shifted_is_put_right(name: str) -> None:
    """measured = turned truth + shift: the terms are the turn by the right-hand rule and minus the shift; `correct` undoes it."""
    from boresight.geodesy import rotate
    from boresight.measure import enu_from_polar, site_of

    pairs, vector, shift = turned(0.002, 3.0)
    # With a prior that is no rein.
    found = checked(name, pairs, options={"prior_sd_m": 1e6} if name == "kalman-transform" else {})
    for k, axis in enumerate(("east", "north", "up")):
        for term, value, limit in ((f"rotation_{axis}", vector[k], 2e-7), (f"site_{axis}", -shift[k], 0.02)):
            at = found.index(KEY, term)
            assert at is not None
            assert abs(found.value[-1, at] - value) < limit, term
    clean = correct(pairs.plots, found, sensors=ONE, terms="all")
    site, rotation = site_of(ONE.sensor[0])
    position = enu_from_polar(np.stack([clean.range_m, clean.azimuth_rad, clean.elevation_rad], axis=1))
    rows = pairs.plots.time_s > found.epoch_s[len(found.epoch_s) // 10]
    off = np.linalg.norm(position - rotate(rotation, pairs.position - site), axis=1)[rows]
    assert off.max() < (0.15 if name == "kalman-transform" else 0.03)


def test_what_correct_does_is_what_the_transform_does() -> None:
    """Noisy pairs: the plots corrected by the terms lie where `Rigid` puts them."""
    from boresight.measure import enu_from_polar
    from boresight.registration.rigid import RansacIcp, clouds_of

    pairs, _, _ = turned(0.003, 5.0)
    rng = np.random.default_rng(3)
    pairs = pairs.replace(plots=pairs.plots.replace(range_m=pairs.plots.range_m + rng.normal(size=len(pairs))))
    rigid = RansacIcp()(clouds_of(pairs, ONE))
    clean = correct(pairs.plots, checked("ransac-icp", pairs), sensors=ONE, terms="all")
    position = enu_from_polar(np.stack([clean.range_m, clean.azimuth_rad, clean.elevation_rad], axis=1))
    np.testing.assert_allclose(position, rigid(clouds_of(pairs, ONE).measured), atol=0.02)


def test_its_covariance_is_that_of_the_transform_moved_from_the_centroid_to_the_radar() -> None:
    from boresight.registration.rigid import RansacIcp, clouds_of

    pairs = scene(12, {}, sensors=ONE, targets=30, errors=WHITE, elevation=True).pairs
    found = checked("ransac-icp", pairs)
    rigid = RansacIcp()(clouds_of(pairs, ONE))
    # shift about the radar: t = c + s - R c, so dt = ds + c x dw; the terms are minus the turn, and the shift.
    c = rigid.centre
    cross = np.array([[0, -c[2], c[1]], [c[2], 0, -c[0]], [-c[1], c[0], 0]])
    j = np.block([[cross, np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    expected = j @ rigid.covariance @ j.T
    names = ["site_east", "site_north", "site_up", "rotation_east", "rotation_north", "rotation_up"]
    at = [found.index(KEY, name) for name in names]
    got = found.covariance[0][np.ix_(at, at)]
    np.testing.assert_allclose(np.sqrt(np.diag(got)), np.sqrt(np.diag(expected)), rtol=0.03)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(got / size[:, None] / size, expected / size[:, None] / size, atol=0.05)


def test_displacements_are_those_of_the_terms() -> None:
    """Moved as the displacement says, a plot is off by what the term's columns say."""
    from boresight.measure import polar_from_enu, wrap_rad
    from boresight.terms import TERMS, Geometry

    rng = np.random.default_rng(4)
    p = np.concatenate([rng.uniform(5e3, 60e3, (50, 2)) * rng.choice((-1, 1), (50, 2)), rng.uniform(100, 11e3, (50, 1))], axis=1)
    polar = polar_from_enu(p)
    still, none = np.zeros((50, 3)), np.full(50, np.nan)
    place = Geometry(polar[:, 0], polar[:, 1], polar[:, 2], still, still, still, none, none, np.zeros(50))
    names = [name for name in TERMS if name.split("_")[0] in ("site", "rotation", "stretch", "shear")]
    assert len(names) == 12
    moves = displacement(names, p)
    for k, name in enumerate(names):
        h = 1e-3 * TERMS[name].si_per_unit
        off = (polar_from_enu(p + h * moves[:, :, k]) - polar_from_enu(p - h * moves[:, :, k])) / (2 * h)
        off[:, 1] = wrap_rad((polar_from_enu(p + h * moves[:, :, k]) - polar_from_enu(p - h * moves[:, :, k]))[:, 1]) / (2 * h)
        np.testing.assert_allclose(TERMS[name].columns(place), off, rtol=1e-5, atol=1e-5 * np.abs(off).max())


def test_one_straight_track_names_the_turn_that_it_cannot_tell() -> None:
    def straight(rng: np.random.Generator) -> tuple[Callable[..., np.ndarray], float, float, float]:
        return path(46.0, 14.0, 0.0, 30e3, np.pi / 2, 200.0, 0.0, 9e3, 0.0, 200.0), 0.0, 400.0, 40.0

    pairs = scene(2, {}, sensors=ONE, errors=WHITE, targets=1, track=straight, elevation=True).pairs
    for name in ("ransac-icp", "genetic", "kalman-transform"):
        found = checked(name, pairs)
        lost = {n.term: n.why for n in found.not_determined}
        # Due east past the radar: a turn about the east axis is a shift to the north and up, and what it is of it is told.
        given_up = [term for term, why in lost.items() if "uncertain by" in why]
        assert given_up
        assert {"site_up", "rotation_east"} & set(given_up)
        assert any(f"also holds what there is of {given_up[0]}" in note for note in found.sensors[0].notes)


def test_a_transform_follows_a_picture_that_changes(level: Pairs) -> None:
    """The azimuth jumps by 0.3 degrees half way: the transform over time has it after a minute, in the value and not before."""
    middle = float(np.median(level.plots.time_s))
    late = level.plots.time_s > middle
    jump = level.replace(plots=level.plots.replace(azimuth_rad=level.plots.azimuth_rad + 0.3 * DEG * late))
    for name, term, sign in (("kalman-transform", "rotation_up", -1), ("alpha-beta", "azimuth_bias", 1)):
        found = checked(name, jump)
        k = found.index(KEY, term)
        assert k is not None
        before = (found.epoch_s > middle - 400) & (found.epoch_s < middle - 10)
        after = found.epoch_s > middle + 300
        assert abs(sign * np.median(found.value[before, k]) - 0.2 * DEG) < 0.05 * DEG
        assert abs(sign * np.median(found.value[after, k]) - 0.5 * DEG) < 0.05 * DEG


def test_least_squares_over_time_keeps_the_constant_terms_and_follows_the_biases() -> None:
    rng = np.random.default_rng(0)
    truth = {"A": {"range_bias": 100.0, "azimuth_bias": 0.2 * DEG, "time_offset": 0.5}}
    tracks = iter([airliner(rng) for _ in range(24)])
    pairs = scene(3, truth, sensors=ONE, errors=WHITE, targets=24, track=lambda _: next(tracks)).pairs
    phase = (pairs.plots.time_s - pairs.plots.time_s.min()) / 900.0 * 2 * np.pi
    moving = pairs.replace(plots=pairs.plots.replace(range_m=pairs.plots.range_m + 60.0 * np.sin(phase)))
    found = checked("least-squares", moving, online=True)
    k, late = found.index(KEY, "range_bias"), found.index(KEY, "time_offset")
    assert k is not None
    assert late is not None
    assert np.ptp(found.value[:, late]) == 0
    assert abs(found.value[0, late] - 0.5) < 4 * found.sd[0, late]
    true = 100.0 + 60.0 * np.sin((found.epoch_s - pairs.plots.time_s.min()) / 900.0 * 2 * np.pi)
    assert np.sqrt(np.mean((found.value[40:, k] - true[40:]) ** 2)) < 15.0
    still = checked("least-squares", moving)
    assert found.sensors[0].held_out_after_median_m < 0.9 * still.sensors[0].held_out_after_median_m
    assert found.settings["online"] is True


def test_the_transform_takes_its_noise_from_the_kind_of_radar_unless_told(level: Pairs) -> None:
    by_kind = checked("kalman-transform", level)
    assert any(note.startswith("sd_m = ") for note in by_kind.sensors[0].notes)
    told = checked("kalman-transform", level, options={"sd_m": "150"})
    assert not any(note.startswith("sd_m = ") for note in told.sensors[0].notes)
    assert told.settings["sd_m"] == 150.0


def test_an_order_that_is_named_is_the_order_fitted(level: Pairs) -> None:
    """`auto` chooses by BIC, a name is taken as it is."""
    chosen = register_with(METHODS["per-channel"], level, ONE)
    assert chosen.sensors[0].model == "constant / constant"
    named = register_with(METHODS["per-channel"], level, ONE, model="second-order")
    assert named.sensors[0].model == "second-order / second-order"
    own = register_with(method_of("per-channel", {"model": "first-order"}), level, ONE)
    assert own.sensors[0].model == "first-order / first-order"
