"""Requirements: verdicts from intervals, intervals that cover, and files with mistakes in them."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.assessment.requirement import (
    Figure,
    Requirement,
    assess_requirement,
    check_requirement,
    conformity_json,
    conformity_text,
    load_requirement,
    quantile_interval,
    quantities,
    save_conformity,
    shipped_requirements,
)
from boresight.assessment.residuals import Residuals
from boresight.calibration import Accuracy, Calibration, Noise, NotDetermined, Summary, TermKey
from boresight.errors import SettingsError
from boresight.model import Channel, Sensor, Sensors
from boresight.terms import DEG, TERMS

SENSOR = 20 << 8 | 1
SENSORS = Sensors((Sensor(name="R", sac=20, sic=1, lat_deg=41.0, lon_deg=2.0, height_m=0.0, kind="ssr"),))


def calibration(value: float, sd: float, term: str = "azimuth_bias", channel: str = "all", **more: object) -> Calibration:
    """One term in its unit, known from very many targets, so that the interval is the normal one."""
    scale = TERMS[term].si_per_unit
    summary = Summary(
        sensor=SENSOR, name="R", model="constant", noise=Noise(25.0, 0.06 * DEG), plots=1000, tracks=50, targets=50,
        before=Accuracy(1.0, 2.0), after=Accuracy(1.0, 2.0), effective_targets=1e6,
    )  # fmt: skip
    return Calibration(
        terms=(TermKey(SENSOR, channel, term, TERMS[term].unit),),
        epoch_s=np.zeros(1),
        value=np.array([[value * scale]]),
        covariance=np.array([[[(sd * scale) ** 2]]]),
        sensors=(summary,),
        **more,
    )


def pairs(error_m: np.ndarray, target: np.ndarray, **more: object) -> Residuals:
    """Residuals whose distance and range error are these, before and after."""
    n = len(error_m)
    columns = {
        f.name: np.zeros(n, f.metadata["dtype"]) for f in dataclasses.fields(Residuals)
    } | {
        "sensor": np.full(n, SENSOR, np.int32), "channel": np.full(n, Channel.SSR, np.int8), "target": target,
        "time_s": np.arange(float(n)), "range_before_m": error_m, "range_after_m": error_m, "distance_before_m": np.abs(error_m),
        "reference_range_m": np.full(n, 50e3),
    }  # fmt: skip
    return Residuals(**columns | more)


def requirement(**figure: object) -> Requirement:
    base: dict[str, object] = {"clause": "1", "quantity": "azimuth_bias", "unit": "deg", "max": 0.1}
    return Requirement(name="Spec", source="here", edition="1", figure=(Figure(**base | figure),))


@given(
    value=st.floats(-1, 1),
    sd=st.floats(1e-4, 0.3),
    limit=st.floats(0.0, 1.0),
    unit=st.sampled_from([("deg", 1.0), ("mrad", DEG * 1e3)]),
)
def test_the_verdict_is_that_of_the_interval(value: float, sd: float, limit: float, unit: tuple[str, float]) -> None:
    """Against the definition: the interval of 1.96 sd on one side of both limits, on the other, or across one of them."""
    (found,) = assess_requirement(calibration(value, sd), None, SENSORS, requirement(max=limit * unit[1], unit=unit[0]))
    low, high = value - 1.959964 * sd, value + 1.959964 * sd
    margin = min(abs(abs(low) - limit), abs(abs(high) - limit))
    if margin < 1e-5:
        return
    if max(-low, high) <= limit:
        assert found.verdict == "pass"
    elif low > limit or high < -limit:
        assert found.verdict == "fail"
    else:
        assert found.verdict == "undecided"
        assert "straddles" in found.why
    assert found.value == pytest.approx(value * unit[1], abs=1e-12)
    assert (found.low, found.high) == pytest.approx((low * unit[1], high * unit[1]), abs=1e-5)


def test_what_is_not_known_is_undecided_with_the_reason() -> None:
    known = calibration(0.0, 0.01, not_determined=(NotDetermined(SENSOR, "range_gain", "cannot be told from range_bias"),))
    for figure, reason in (
        ({"quantity": "range_gain", "unit": "m/NM"}, "cannot be told from range_bias"),
        ({"quantity": "time_offset", "unit": "ms"}, "has no time_offset"),
        ({"quantity": "position_p95", "unit": "m"}, "residuals.parquet is missing"),
        ({"quantity": "detection_probability", "unit": "%", "max": None, "min": 97.0}, "not measured"),
        ({"channels": ("psr",)}, "which channels"),
    ):
        (found,) = assess_requirement(known, None, SENSORS, requirement(**figure))
        assert (found.verdict, math.isnan(found.value)) == ("undecided", True)
        assert reason in found.why
    one = pairs(np.ones(50), np.zeros(50, np.int64))
    (found,) = assess_requirement(known, one, SENSORS, requirement(quantity="position_p95", unit="m", max=5.0))
    assert (found.verdict, found.value) == ("undecided", 1.0)
    assert "one target" in found.why
    (found,) = assess_requirement(known, one, SENSORS, requirement(channels=("psr",)))
    assert "no plot of channel psr" in found.why
    (found,) = assess_requirement(known, None, None, requirement(kinds=("ssr",)))
    assert "kind of R is not known" in found.why
    assert assess_requirement(known, None, SENSORS, requirement(kinds=("marine",))) == ()


def test_a_channel_has_its_own_error_on_top_of_what_all_share() -> None:
    both = dataclasses.replace(
        calibration(0.0, 0.01),
        terms=(TermKey(SENSOR, "all", "range_bias", "m"), TermKey(SENSOR, "psr", "range_bias", "m")),
        value=np.array([[30.0, 50.0]]),
        covariance=np.array([[[9.0, -8.0], [-8.0, 16.0]]]),
    )
    seen = pairs(np.ones(40), np.arange(40), channel=np.repeat([Channel.SSR, Channel.PSR], 20).astype(np.int8))
    ask = requirement(quantity="range_bias", unit="m", max=100.0)
    plain, psr = assess_requirement(both, seen, SENSORS, ask)
    assert (plain.quantity, plain.value) == ("range_bias", 30.0)
    assert (psr.quantity, psr.value) == ("range_bias (psr)", 80.0)
    # var(a + b) = 9 + 16 - 2 * 8
    assert psr.high - psr.low == pytest.approx(2 * 1.959964 * 3.0, rel=1e-4)
    (found,) = assess_requirement(both, seen, SENSORS, requirement(quantity="range_bias", unit="m", channels=("psr",)))
    assert found.value == 80.0
    (found,) = assess_requirement(both, seen, SENSORS, requirement(quantity="range_bias", unit="m", channels=("ssr",)))
    assert found.value == 30.0


def test_the_interval_of_a_quantile_covers_the_truth() -> None:
    """Targets with errors of their own: the 95 % interval of p95 holds the population's p95 in about 95 of 100 recordings."""
    rng = np.random.default_rng(5)
    big = np.abs(np.repeat(rng.normal(0, 3, 200_000), 5) + rng.normal(0, 4, 1_000_000))
    truth = float(np.quantile(big, 0.95))
    assert truth == pytest.approx(1.959964 * 5.0, rel=0.01)
    inside, plots = 0, 0
    for _ in range(300):
        target = np.repeat(np.arange(40), rng.integers(20, 60, 40))
        error = np.abs(rng.normal(0, 3, 40)[target] + rng.normal(0, 4, len(target)))
        low, high = quantile_interval(error, target, 0.95, 0.95)
        inside += low <= truth <= high
        # The same as if every plot were a target of its own: far too narrow.
        low, high = quantile_interval(error, np.arange(len(error)), 0.95, 0.95)
        plots += low <= truth <= high
    assert 0.89 <= inside / 300 <= 0.985
    assert plots < inside


def test_noise_and_rms_have_intervals_over_targets() -> None:
    rng = np.random.default_rng(6)
    target = np.repeat(np.arange(60), 40)
    error = rng.normal(0, 25.0, len(target))
    found = {
        name: assess_requirement(
            calibration(0, 1), pairs(error, target), SENSORS, requirement(quantity=name, unit="m", max=30.0)
        )[0]
        for name in ("range_noise_sd", "range_rms")
    }
    for c in found.values():
        # The sd of a sample's sd is sd / sqrt(2 n).
        assert c.high - c.low == pytest.approx(2 * 1.96 * 25 / np.sqrt(2 * len(error)), rel=0.5)
        assert c.verdict == "pass"
    assert found["range_noise_sd"].value == 25.0


def test_pairs_beyond_a_range_do_not_count() -> None:
    far = np.repeat([1000.0, 9000.0], 30)
    error, target = np.repeat([1.0, 100.0], 30), np.arange(60)
    ask = requirement(quantity="range_p95", unit="m", max=30.0, to_range=3.0)
    (found,) = assess_requirement(calibration(0, 1), pairs(error, target, reference_range_m=far), SENSORS, ask)
    assert (found.value, found.quantity) == (1.0, "range_p95 up to 3 NM")
    (found,) = assess_requirement(calibration(0, 1), pairs(error, target), SENSORS, ask)
    assert "at such ranges" in found.why


def test_the_shipped_requirements_are_sound() -> None:
    assert "imo-msc192-79" in shipped_requirements()
    for name in shipped_requirements():
        loaded = load_requirement(name)
        # What is not vouched for says so; what is has its clause by number and the document's words.
        assert loaded.example or all(f.clause[0].isdigit() and f.text for f in loaded.figure)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ('quantity = "azimut"', "no such quantity. Quantities: range_bias"),
        ('unit = "m"', "'m' is no unit of it. Units: deg, mrad, rad"),
        ('unit = "furlong"', "Units: deg"),
        ('clause = " "', "clause is empty"),
        ("max = -1.0", "one limit"),
        ("min = 0.2", "one limit"),
        ("max = nan", "one limit"),
        ('kinds = ["sonar"]', "no kind of sensor 'sonar'"),
        ('channels = ["uhf"]', "no channel 'uhf'"),
        ("to_range = 5.0", "to_range limits the pairs"),
        ("confidence = 95.0", "not within 0.5"),
        ("maximum = 3.0", "maximum"),
    ],
)
def test_mistakes_in_a_file_are_told(tmp_path: Path, change: str, said: str) -> None:
    keys = {"clause": '"1"', "quantity": '"azimuth_bias"', "unit": '"deg"', "max": "0.1"}
    name, _, value = change.partition(" = ")
    text = "\n".join(f"{k} = {v}" for k, v in (keys | {name: value}).items())
    path = tmp_path / "r.toml"
    path.write_text(f'name = "N"\nsource = "S"\nedition = "E"\n[[figure]]\n{text}\n')
    with pytest.raises(SettingsError) as caught:
        load_requirement(path)
    assert said in str(caught.value)
    assert "r.toml" in str(caught.value)


def test_other_mistakes_are_told(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="imo-msc192-79"):
        load_requirement(tmp_path / "none.toml")
    path = tmp_path / "r.toml"
    for text, said in (
        ("name = ", "is not TOML"),
        ('name = "N"\nsource = "S"\nedition = "E"\n[[figure]]\nquantity = "x"\n', "clause"),
        ('name = "N"\nsource = "S"\nedition = "E"\nfigure = []\n', "no figure"),
    ):
        path.write_text(text)
        with pytest.raises(SettingsError, match=said):
            load_requirement(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(SettingsError, match="UTF-8"):
        load_requirement(path)
    with pytest.raises(SettingsError, match="edition is empty"):
        check_requirement(Requirement(name="N", source="S", edition="", figure=requirement().figure))


def test_verdicts_as_text_and_json(tmp_path: Path) -> None:
    found = (
        *assess_requirement(calibration(0.3, 0.01), None, SENSORS, requirement()),
        *assess_requirement(calibration(0.3, 0.01), None, SENSORS, requirement(quantity="time_offset", unit="s")),
    )
    text = conformity_text(found)
    assert "0 passed, 1 failed, 1 undecided" in text
    assert "has no time_offset" in text
    save_conformity(found, tmp_path / "c.json")
    plain = conformity_json(found)
    assert plain[1]["value"] is None
    assert [c["verdict"] for c in plain] == ["fail", "undecided"]
    assert (tmp_path / "c.json").read_text().count('"clause"') == 2


def test_the_page_names_every_quantity_that_is_not_measured() -> None:
    page = (Path(__file__).parents[2] / "docs" / "conformity.md").read_text()
    for name, dimension in quantities().items():
        if dimension == "not measured":
            assert f"`{name}`" in page
    for name in shipped_requirements():
        assert f"`{name}`" in page
