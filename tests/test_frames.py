"""Covariance conversion: against Monte Carlo, closed forms, and itself round a loop of frames."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight import frames, geodesy, measure
from boresight.errors import SettingsError


def _frames() -> dict[str, frames.Frame]:
    one, two = (0.72, 0.04, 80.0), (0.74, 0.01, 500.0)
    out: dict[str, frames.Frame] = {"ecef": frames.Ecef(), "geodetic": frames.Geodetic()}
    for name, (lat, lon, h) in (("1", one), ("2", two)):
        site, rotation = geodesy.ecef_from_geodetic(lat, lon, h), geodesy.enu_from_ecef(lat, lon)
        out["enu" + name], out["polar" + name] = frames.Enu(site, rotation), frames.Polar(site, rotation)
    return out


def _plots(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    value = np.stack([rng.uniform(5e3, 300e3, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(0.01, 0.8, n)], axis=1)
    root = rng.normal(size=(n, 3, 3)) * np.array([30.0, 1e-4, 1e-4])[:, None]
    return value, root @ np.swapaxes(root, 1, 2)


FRAMES = _frames()


@pytest.mark.parametrize(("through", "last"), list(itertools.permutations(FRAMES, 2)))
def test_every_detour_ends_where_the_straight_way_does(through: str, last: str) -> None:
    """Polar of site 1 to any frame by way of any other: the same values and covariances, symmetric to the bit."""
    value, covariance = _plots(50, 1)
    start = FRAMES["polar1"]
    straight = frames.convert(value, covariance, start, FRAMES[last])
    half = frames.convert(value, covariance, start, FRAMES[through])
    detour = frames.convert(*half, FRAMES[through], FRAMES[last])
    assert np.array_equal(detour[1], np.swapaxes(detour[1], 1, 2))
    difference = detour[0] - straight[0]
    if last.startswith("polar"):
        difference[:, 1] = measure.wrap_rad(difference[:, 1])
        difference[:, 1:] *= straight[0][:, :1]
    if last == "geodetic":
        difference[:, :2] *= geodesy.SEMI_MAJOR_M
    assert np.abs(difference).max() < 1e-7
    sd = np.sqrt(np.diagonal(straight[1], axis1=1, axis2=2))
    assert np.abs((detour[1] - straight[1]) / (sd[:, :, None] * sd[:, None, :])).max() < 1e-6


def test_linear_conversion_against_monte_carlo() -> None:
    """Small angles: 400,000 draws agree with J R J' to the sampling error."""
    rng = np.random.default_rng(2)
    value = np.array([[80e3, 1.1, 0.12]])
    covariance = np.diag([40.0, 3e-4, 4e-4])[None] ** 2
    covariance[0, 0, 1] = covariance[0, 1, 0] = 0.5 * 40 * 3e-4
    source, target = FRAMES["polar1"], FRAMES["polar2"]
    found = frames.convert(value, covariance, source, target)
    draws = rng.multivariate_normal(value[0], covariance[0], 400_000)
    mapped = target.from_ecef(source.to_ecef(draws)[0])[0]
    sd = np.sqrt(np.diagonal(found[1][0]))
    assert np.abs((np.cov(mapped.T) - found[1][0]) / np.outer(sd, sd)).max() < 0.01
    assert np.abs((mapped.mean(0) - found[0][0]) / sd).max() < 0.01


def test_a_plot_due_east_has_its_errors_on_the_right_axes() -> None:
    """METHODS section 1: range error lies east, azimuth error north, elevation error up; mixed axes would not."""
    value, covariance = np.array([[50e3, np.pi / 2, 0.0]]), np.diag([10.0, 1e-3, 2e-3])[None] ** 2
    _, enu = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["enu1"])
    assert np.sqrt(np.diagonal(enu[0])) == pytest.approx([10, 50, 100], rel=1e-9)


def test_rotation_keeps_the_eigenvalues() -> None:
    value, covariance = _plots(20, 3)
    enu, covariance = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["enu1"])
    _, ecef = frames.convert(enu, covariance, FRAMES["enu1"], FRAMES["ecef"])
    assert np.allclose(np.linalg.eigvalsh(ecef), np.linalg.eigvalsh(covariance), rtol=1e-9)


def test_jacobian_of_the_route_against_differences() -> None:
    value, _ = _plots(30, 4)
    forward = frames.route(FRAMES["polar1"], FRAMES["polar2"])
    mapped, jacobian = forward(value)
    metres_in, metres_out = (np.stack([np.ones(30), v[:, 0], v[:, 0]], axis=1) for v in (value, mapped))
    for k in range(3):
        step = np.zeros_like(value)
        step[:, k] = 10.0 / metres_in[:, k]
        difference = forward(value + step)[0] - forward(value - step)[0]
        difference[:, 1] = measure.wrap_rad(difference[:, 1])
        expected = jacobian[:, :, k] * metres_out / metres_in[:, k : k + 1]
        assert np.abs(difference * metres_out / 20.0 - expected).max() < 1e-4


def test_a_method_is_a_value_that_sees_the_whole_route() -> None:
    """Another method needs nothing but the frames: here, one that ignores the Jacobian and differences the map itself."""

    def differenced(
        value: np.ndarray, covariance: np.ndarray, source: frames.Frame, target: frames.Frame
    ) -> tuple[np.ndarray, np.ndarray]:
        forward = frames.route(source, target)
        columns = []
        for k, h in enumerate((1.0, 1e-6, 1e-6)):
            step = np.zeros(3)
            step[k] = h
            columns.append((forward(value + step)[0] - forward(value - step)[0]) / (2 * h))
        return forward(value)[0], frames.propagate(np.stack(columns, axis=2), covariance)

    value, covariance = _plots(10, 5)
    ours = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["ecef"])
    theirs = frames.convert(value, covariance, FRAMES["polar1"], FRAMES["ecef"], method=differenced)
    assert np.allclose(ours[1], theirs[1], rtol=1e-5, atol=1e-5 * np.abs(ours[1]).max())


# ------------------------------------------------------------------------------------------------ large errors: the exact moments
FLAT = frames.Polar(np.zeros(3), np.eye(3))
HARD = (
    (300e3, 1.0, 0.05, 50.0, 3.0, 3.0),
    (300e3, 4.0, 0.3, 50.0, 2.0, 2.0),
    (100e3, 2.5, 0.02, 50.0, 3.0, 1.0),
    (10e3, 0.3, 1.0, 500.0, 1.0, 0.1),
)


def _covariance(sd_r: float, sd_a_deg: float, sd_e_deg: float) -> np.ndarray:
    return np.diag([sd_r, np.radians(sd_a_deg), np.radians(sd_e_deg)]) ** 2


def _nees(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.mean(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])))


def test_moments_of_a_polar_measurement_are_exact() -> None:
    """Against integration over the errors (Gauss-Hermite, 40 points an axis), with every coordinate correlated."""
    sd = np.array([2000.0, 0.3, 0.2])
    correlation = np.array([[1, 0.5, -0.3], [0.5, 1, 0.4], [-0.3, 0.4, 1]])
    covariance = correlation * sd[:, None] * sd
    centre = np.array([80e3, 2.2, 0.4])
    x, w = np.polynomial.hermite_e.hermegauss(40)
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = np.einsum("i,j,k->ijk", w, w, w).ravel() / (2 * np.pi) ** 1.5
    enu = measure.enu_from_polar(centre + grid @ np.linalg.cholesky(covariance).T)
    mean = weight @ enu
    spread = (enu - mean).T @ ((enu - mean) * weight[:, None])
    found = frames.polar_moments(centre[None], covariance[None])
    assert found[0][0] == pytest.approx(mean, rel=1e-10)
    assert found[1][0] == pytest.approx(spread, rel=1e-9, abs=1e-9 * spread.max())


def test_moments_keep_their_digits_when_errors_are_small() -> None:
    """A millimetre at 300 km: the linear rule is exact there to the square of the angles' sd, and J R J' has no cancellation."""
    value = np.array([[300e3, 0.7, 0.1]])
    covariance = np.diag([1e-3, 1e-8, 1e-8])[None] ** 2
    _, linear = frames.convert(value, covariance, FLAT, frames.Ecef())
    _, exact = frames.convert(value, covariance, FLAT, frames.Ecef(), method=frames.Multiplicative())
    assert np.abs(np.linalg.solve(linear[0], exact[0]) - np.eye(3)).max() < 1e-5


@pytest.mark.parametrize("case", HARD)
@pytest.mark.parametrize("name", ["unbiased", "multiplicative", "decorrelated"])
def test_unbiased_forms_are_consistent_for_one_plot(name: str, case: tuple[float, ...]) -> None:
    """METHODS section 1: NEES 3.00 +- 0.03 up to 300 km / 3 degrees, where the linear rule has 3 + 2 beta^2 = 500 and more."""
    rng = np.random.default_rng(11)
    r, a, e, *sds = case
    n = 120_000
    covariance = np.broadcast_to(_covariance(*sds), (n, 3, 3))
    if name == "decorrelated":
        truth = np.tile([r, a, e], (n, 1))
        measured = rng.multivariate_normal([r, a, e], covariance[0], n)
        method: frames.Method = frames.Decorrelated(FLAT.to_ecef(truth)[0])
    else:
        # These are conditioned on the measurement: the truth is spread about it.
        measured = np.tile([r, a, e], (n, 1))
        truth = rng.multivariate_normal([r, a, e], covariance[0], n)
        method = frames.Unbiased() if name == "unbiased" else frames.Multiplicative()
    position, spread = frames.convert(measured, covariance, FLAT, frames.Ecef(), method=method)
    assert _nees(position - FLAT.to_ecef(truth)[0], spread) == pytest.approx(3.0, abs=0.03)


def test_debiased_positions_have_the_truth_as_their_mean() -> None:
    """z / lambda over 100,000 measurements of one target, with errors of azimuth and elevation that correlate."""
    rng = np.random.default_rng(12)
    truth = np.array([200e3, 1.2, 0.25])
    covariance = _covariance(100.0, 3.0, 3.0)
    covariance[1, 2] = covariance[2, 1] = 0.6 * covariance[1, 1]
    measured = rng.multivariate_normal(truth, covariance, 100_000)
    tiled = np.broadcast_to(covariance, (len(measured), 3, 3))
    position, _ = frames.convert(measured, tiled, FLAT, frames.Ecef(), method=frames.Unbiased())
    at = np.tile(FLAT.to_ecef(truth[None])[0], (1, 1))
    _, spread = frames.convert(truth[None], covariance[None], FLAT, frames.Ecef(), method=frames.Decorrelated(at))
    standard_error = np.sqrt(np.diag(spread[0]) / len(measured))
    assert np.abs((position.mean(axis=0) - at[0]) / standard_error).max() < 4
    assert np.cov(position.T) == pytest.approx(spread[0], rel=0.03, abs=0.03 * np.diag(spread[0]).min())


def test_linear_nees_is_three_plus_twice_beta_squared() -> None:
    """METHODS section 1: 3.18 at beta 0.3, 5 at 1 (one angle's error only would give less)."""
    rng = np.random.default_rng(13)
    n = 200_000
    for beta, expected in ((0.3, 3.18), (1.0, 5.0)):
        angle = np.sqrt(beta * 2 * 50.0 / (2 * 100e3))
        covariance = np.broadcast_to(np.diag([50.0, angle, angle]) ** 2, (n, 3, 3))
        measured = np.tile([100e3, 0.5, 0.0], (n, 1))
        assert frames.nonlinearity(measured[:1], covariance[:1], FLAT, frames.Ecef())[0] == pytest.approx(beta)
        truth = rng.multivariate_normal(measured[0], covariance[0], n)
        position, spread = frames.convert(measured, covariance, FLAT, frames.Ecef())
        assert _nees(position - FLAT.to_ecef(truth)[0], spread) == pytest.approx(expected, rel=0.02)


def test_mixed_axes_are_caught_by_nees() -> None:
    """The paper's azimuth counts from x: a covariance whose east and north are exchanged has NEES/3 of 7 to 58 somewhere."""
    rng = np.random.default_rng(14)
    n = 20_000
    worst = 0.0
    for azimuth in np.radians([0.0, 30.0, 60.0]):
        covariance = np.broadcast_to(_covariance(50.0, 0.3, 0.3), (n, 3, 3))
        truth = np.array([60e3, azimuth, 0.2])
        measured = rng.multivariate_normal(truth, covariance[0], n)
        position, spread = frames.convert(measured, covariance, FLAT, frames.Ecef())
        error = position - FLAT.to_ecef(truth[None])[0]
        assert _nees(error, spread) / 3 == pytest.approx(1.0, abs=0.03)
        swapped = spread[:, [1, 0, 2]][:, :, [1, 0, 2]]
        worst = max(worst, _nees(error, swapped) / 3)
    assert worst > 7


def test_second_order_and_unscented_against_the_exact_moments() -> None:
    """beta 0.4: the exact covariance to 2 %, where the linear rule misses a tenth of it along the line of sight."""
    value = np.array([[100e3, 0.9, 0.1]])
    covariance = _covariance(50.0, 0.9, 0.3)[None]
    covariance[0, 0, 1] = covariance[0, 1, 0] = 0.3 * np.sqrt(covariance[0, 0, 0] * covariance[0, 1, 1])
    mean, exact = frames.polar_moments(value, covariance)
    sight = FLAT.to_ecef(value)[0][0] / 100e3
    for method in (frames.SecondOrder(), frames.Unscented(0.0), frames.Unscented(1.0)):
        position, spread = frames.convert(value, covariance, FLAT, frames.Ecef(), method=method)
        assert np.abs(position - mean).max() < 0.05 * 100e3 * covariance[0, 1, 1]
        if isinstance(method, frames.SecondOrder):
            assert sight @ spread[0] @ sight == pytest.approx(sight @ exact[0] @ sight, rel=0.02)
        assert np.linalg.eigvalsh(spread[0]).min() > 0


def test_unscented_in_one_plane_counts_its_own_coordinates() -> None:
    """Two coordinates that are not known: five sigma points.  kappa = 1: weights 1/3 and 1/6, points at sqrt(3) sd."""
    value, covariance = np.array([[50e3, 0.0]]), np.diag([100.0, 0.05])[None] ** 2
    position, spread = frames.convert(value, covariance, FLAT, frames.Ecef(), method=frames.Unscented(1.0))
    s = np.sqrt(3) * 0.05
    assert position[0] == pytest.approx([0.0, 50e3 * (2 / 3 + np.cos(s) / 3)], abs=1e-6)
    assert spread[0, 0, 0] == pytest.approx(50e3**2 * np.sin(s) ** 2 / 3)


def test_automatic_choice() -> None:
    """Linear while it is good enough, else the multiplicative form; in a track the decorrelated one if there is a prediction."""
    value = np.array([[50e3, 1.0, 0.1], [200e3, 1.0, 0.1], [300e3, 1.0, 0.1]])
    covariance = np.stack([_covariance(50.0, 0.1, 0.1), _covariance(50.0, 0.3, 0.1), _covariance(50.0, 2.0, 2.0)])
    beta = frames.nonlinearity(value, covariance, FLAT, frames.Ecef())
    assert beta[0] < frames.TRACK_LIMIT < beta[1] < frames.PLOT_LIMIT < beta[2]
    ecef = frames.Ecef()
    alone, track = frames.Automatic(), frames.Automatic(in_track=True, predicted=np.array([[0, 0, 0], [1e5] * 3, [np.nan] * 3]))
    assert [frames.Automatic.CHOICES[k] for k in alone.choose(value, covariance, FLAT, ecef)] == ["linear"] * 2 + [
        "multiplicative"
    ]
    chosen = [frames.Automatic.CHOICES[k] for k in track.choose(value, covariance, FLAT, ecef)]
    assert chosen == ["linear", "decorrelated", "multiplicative"]
    position, spread = frames.convert(value, covariance, FLAT, ecef, method=track)
    assert position[2] == pytest.approx(frames.polar_moments(value, covariance)[0][2])
    assert np.linalg.eigvalsh(spread).min() > 0
    back = frames.Automatic().choose(position, spread, ecef, FLAT)
    assert [frames.Automatic.CHOICES[k] for k in back] == ["linear", "linear", "second_order"]


def test_bulk_kernel_is_the_linear_rule() -> None:
    """The compiled rule of many plots about one site against the route's own Jacobian."""
    value, covariance = _plots(70_000, 6)
    source = FRAMES["polar1"]
    position, spread = frames.convert(value, covariance, source, FRAMES["ecef"])
    mapped, jacobian = frames.route(source, FRAMES["ecef"])(value)
    expected = frames.propagate(jacobian, covariance)
    assert np.abs(position - mapped).max() < 1e-8
    size = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert np.abs((spread - expected) / (size[:, :, None] * size[:, None, :])).max() < 1e-9
    assert np.array_equal(spread, np.swapaxes(spread, 1, 2))


METHODS = (
    frames.Linear(), frames.SecondOrder(), frames.Unscented(1.0), frames.Unbiased(), frames.Multiplicative(), frames.Automatic(),
)  # fmt: skip


@settings(max_examples=60)
@given(
    r=st.floats(0.0, 500e3),
    a=st.floats(-10.0, 10.0),
    e=st.floats(-np.pi / 2, np.pi / 2),
    sd=st.tuples(st.floats(0.1, 1e3), st.floats(1e-6, 0.1), st.floats(1e-6, 0.1)),
    lat=st.sampled_from([-90.0, -45.0, 0.0, 52.0, 90.0]),
    lon=st.sampled_from([-180.0, 0.0, 179.999, 180.0]),
)
def test_covariances_stay_symmetric_and_not_negative(r, a, e, sd, lat, lon) -> None:
    """Over the radar, at r = 0, at the poles, across the date line: finite, symmetric, no negative variance in any direction."""
    site, rotation = geodesy.ecef_from_geodetic(*np.radians([lat, lon]), 0.0), geodesy.enu_from_ecef(*np.radians([lat, lon]))
    source = frames.Polar(site, rotation)
    value, covariance = np.array([[r, a, e]]), np.diag(np.array(sd) ** 2)[None]
    for method in METHODS:
        for target in (frames.Ecef(), frames.Geodetic(), frames.Enu(site, rotation), FRAMES["polar1"]):
            out, spread = frames.convert(value, covariance, source, target, method=method)
            assert np.isfinite(out).all()
            assert np.isfinite(spread).all()
            assert np.array_equal(spread, np.swapaxes(spread, 1, 2))
            size = np.sqrt(np.diagonal(spread[0])) + 1e-12
            assert np.linalg.eigvalsh(spread[0] / size[:, None] / size).min() > -1e-6


@pytest.mark.parametrize(
    ("covariance", "match"),
    [
        (np.array([[1.0, 0.5, 0], [0.4, 1, 0], [0, 0, 1]]), "row 1 is not symmetric"),
        (np.diag([1.0, -1e-6, 1]), "row 1 has a negative variance"),
        (np.array([[1.0, 2, 0], [2, 1, 0], [0, 0, 1]]), "row 1 holds a correlation beyond 1"),
        (np.diag([np.inf, 1, 1]), "row 1 is infinite"),
    ],
)
def test_what_is_no_covariance_is_refused(covariance: np.ndarray, match: str) -> None:
    good = np.diag([1.0, 1e-6, 1e-6])
    with pytest.raises(SettingsError, match=match):
        frames.convert(np.full((2, 3), 0.5), np.stack([good, covariance]), FLAT, frames.Ecef())
    with pytest.raises(SettingsError, match="do not fit"):
        frames.convert(np.zeros((2, 3)), good[None], FLAT, frames.Ecef())


@pytest.mark.parametrize("method", [frames.Linear(), frames.SecondOrder(), frames.Automatic()])
@pytest.mark.parametrize("place", [(0.0, 0.0, 1e4), (60.0, 0.0, 1e4), (250.0, 100.0, 1e4), (0.0, 0.0, 0.0), (100.0, 0.0, 60.0)])
def test_over_the_radar_and_at_it_directions_are_as_uncertain_as_they_are(method, place: tuple[float, float, float]) -> None:
    """Against the mean squares of 200,000 positions: where the linear rule says that nothing is uncertain, or everything."""
    value, covariance = np.array([place]), np.diag([100.0, 60.0, 50.0])[None] ** 2
    mapped, spread = frames.convert(value, covariance, frames.Ecef(), FLAT, method=method)
    draws = np.random.default_rng(1).multivariate_normal(value[0], covariance[0], 200_000)
    off = measure.polar_from_enu(draws) - mapped
    off[:, 1] = measure.wrap_rad(off[:, 1])
    expected = (off**2).mean(axis=0)
    expected[1] = min(expected[1], np.pi**2 / 3)
    assert np.diagonal(spread[0]) == pytest.approx(expected, rel=0.25)
    assert np.linalg.eigvalsh(spread[0]).min() > 0


def test_a_position_exactly_overhead_has_any_azimuth_however_well_it_is_known() -> None:
    value = np.array([[0.0, 0.0, 8000.0], [3.0, 0.0, 8000.0]])
    for sd in (0.0, 1e-3, 10.0):
        _, spread = frames.convert(value, np.broadcast_to(np.eye(3) * sd**2, (2, 3, 3)), frames.Ecef(), FLAT)
        assert spread[0, 1, 1] == pytest.approx(np.pi**2 / 3)
        assert (spread[0, 1, [0, 2]] == 0).all()
        # Three metres aside, known to a millimetre, it has one.
        if sd < 1:
            assert spread[1, 1, 1] == pytest.approx((sd / 3) ** 2, rel=1e-6)


def test_correlations_that_contradict_each_other_are_refused() -> None:
    """Each of the three is below 1, and no three errors have them."""
    bad = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]])
    with pytest.raises(SettingsError, match="row 1 is not positive semidefinite"):
        frames.convert(np.full((2, 3), 0.5), np.stack([np.abs(bad), bad]), FLAT, frames.Ecef())


def test_a_plot_that_is_not_a_number_stays_alone() -> None:
    value = np.array([[1e4, 1.0, 0.1], [np.nan, 1.0, 0.1], [1e4, 1.0, 0.1]])
    covariance = np.broadcast_to(np.diag([10.0, 1e-3, 1e-3]) ** 2, (3, 3, 3)).copy()
    for method in METHODS:
        out, spread = frames.convert(value, covariance, FLAT, frames.Ecef(), method=method)
        assert np.isfinite(out[[0, 2]]).all()
        assert np.isfinite(spread[[0, 2]]).all()
        assert np.isnan(out[1]).any()


def test_sines_in_bulk_are_sines() -> None:
    """To the last digit but one over all turns that a radar counts, at the axes exactly, and beyond by the library's own."""
    angle = np.concatenate([np.linspace(-1e5, 1e5, 20_001), np.linspace(-7, 7, 20_001), np.arange(-9, 10) * np.pi / 4])
    sine, cosine = np.empty_like(angle), np.empty_like(angle)
    frames._sines(angle, sine, cosine)
    assert np.abs(sine - np.sin(angle)).max() < 3e-16
    assert np.abs(cosine - np.cos(angle)).max() < 3e-16
    far = np.array([[1e4, 3e6, -0.1]])
    plane = frames.Polar(np.zeros(3), np.eye(3))
    position, _ = frames.convert(far, np.diag([1.0, 1e-6, 1e-6])[None], plane, frames.Ecef())
    assert position[0] == pytest.approx(measure.enu_from_polar(far)[0], rel=1e-12)


def test_plots_without_elevation_are_those_at_elevation_zero() -> None:
    """The two-dimensional kernel against the three-dimensional rule with an exactly known elevation, anywhere on the Earth."""
    rng = np.random.default_rng(12)
    value = np.stack([rng.uniform(0, 3e5, 700), rng.uniform(-7, 7, 700)], axis=1)
    root = rng.normal(size=(700, 2, 2)) * [[60.0], [2e-3]]
    spread = root @ np.swapaxes(root, 1, 2)
    for source in (frames.Polar(np.zeros(3), np.eye(3)), FRAMES["polar1"]):
        found = frames.convert(value, spread, source, frames.Ecef())
        full = np.concatenate([value, np.zeros((700, 1))], axis=1), np.pad(spread, ((0, 0), (0, 1), (0, 1)))
        expected = frames.convert(*full, source, frames.Ecef())
        assert found[0] == pytest.approx(expected[0][:, :2], abs=1e-8)
        assert found[1] == pytest.approx(expected[1][:, :2, :2], rel=1e-9, abs=1e-9)
