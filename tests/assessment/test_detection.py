"""Detection against closed forms, an independent distribution and Monte Carlo; initiation by chain, by enumeration, by draws."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import ncx2

from boresight.assessment.detection import (
    MOfN,
    RadarEquation,
    detection_probability,
    equal_false_tracks,
    false_track_rate,
    initiation_chances,
    initiation_looks,
    range_gain_db,
)
from boresight.errors import SettingsError

SNR = np.array([0.0, 0.3, 1.0, 3.0, 10.0, 40.0, 1000.0])


def test_steady_target_is_marcums() -> None:
    from scipy.special import gammainccinv

    for pulses, pfa in itertools.product((1, 3, 20), (1e-3, 1e-6)):
        expected = ncx2.sf(2 * gammainccinv(pulses, pfa), 2 * pulses, np.maximum(2 * pulses * SNR, 1e-12))
        assert detection_probability(SNR, pfa=pfa, pulses=pulses) == pytest.approx(expected, abs=1e-11)


def test_one_pulse_of_an_exponential_target_has_a_closed_form() -> None:
    """Pd = Pfa^(1 / (1 + S)), and cases 1 and 2 are the same."""
    for swerling in (1, 2):
        found = detection_probability(SNR, pfa=1e-6, swerling=swerling)
        assert found == pytest.approx(1e-6 ** (1 / (1 + SNR)), abs=1e-12)
    # Four degrees of freedom: [1 + 2 S T / (2 + S)^2] exp(-2 T / (2 + S)), T = -ln Pfa.
    t = -np.log(1e-6)
    expected = (1 + 2 * SNR * t / (2 + SNR) ** 2) * np.exp(-2 * t / (2 + SNR))
    for swerling in (3, 4):
        assert detection_probability(SNR, pfa=1e-6, swerling=swerling) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("swerling", [0, 1, 2, 3, 4])
def test_several_pulses_against_draws_of_the_detector(swerling: int) -> None:
    """Complex noise and a target whose energy fluctuates as each case says: 200,000 sums of three pulses."""
    rng = np.random.default_rng(swerling)
    n, pulses, snr, pfa = 200_000, 3, 4.0, 1e-3
    energy = np.full((n, pulses), snr)
    if swerling in (1, 3):
        k = (swerling + 1) // 2
        energy = np.repeat(rng.gamma(k, snr / k, (n, 1)), pulses, axis=1)
    elif swerling in (2, 4):
        k = swerling // 2
        energy = rng.gamma(k, snr / k, (n, pulses))
    signal = np.sqrt(energy) * np.exp(2j * np.pi * rng.random((n, pulses)))
    power = (np.abs(signal + (rng.normal(size=(n, pulses)) + 1j * rng.normal(size=(n, pulses))) / np.sqrt(2)) ** 2).sum(axis=1)
    from scipy.special import gammainccinv

    found = float((power > gammainccinv(pulses, pfa)).mean())
    expected = float(detection_probability(snr, pfa=pfa, swerling=swerling, pulses=pulses))
    assert found == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / n))


def test_radar_equation_gives_its_pd_at_its_range() -> None:
    for swerling, pulses in itertools.product((0, 1, 4), (1, 3)):
        radar = RadarEquation(swerling=swerling, pulses=pulses)
        assert float(radar.probability(100e3)) == pytest.approx(0.85, abs=1e-9)
        at = radar.probability(np.array([1.0, 50e3, 80e3, 120e3, 400e3]))
        assert (np.diff(at) <= 0).all()
        assert at[0] == pytest.approx(1.0, abs=1e-7)
        assert radar.probability(1e12) == pytest.approx(1e-6, rel=1e-6)


def test_initiation_chain_is_the_sum_over_all_histories() -> None:
    """Every sequence of ten looks enumerated."""
    p = np.array([0.1, 0.9, 0.4, 0.3, 0.7, 0.2, 0.6, 0.5, 0.8, 0.25])
    for rule in (MOfN(1, 1), MOfN(2, 2), MOfN(2, 3), MOfN(3, 5), MOfN(3, 6)):
        expected = np.zeros(len(p))
        for looks in itertools.product((0, 1), repeat=len(p)):
            chance = np.prod(np.where(looks, p, 1 - p))
            for k in range(len(p)):
                if looks[k] and sum(looks[max(0, k - rule.looks + 1) : k + 1]) >= rule.hits:
                    expected[k] += chance
                    break
        assert initiation_chances(p, rule) == pytest.approx(expected, abs=1e-12)


def test_chain_and_draws_agree() -> None:
    """METHODS section 2: the mean initiation range to 0.1 km."""
    rng = np.random.default_rng(3)
    range_m = np.sqrt(2) * (125e3 - 200 * 4.848 * np.arange(110))
    p = RadarEquation(pulses=2).probability(range_m)
    for rule in (MOfN(3, 6), MOfN(3, 12)):
        chance = initiation_chances(p, rule)
        assert chance.sum() == pytest.approx(1.0, abs=1e-9)
        look = initiation_looks(rng, p, rule, 40_000)
        assert (look >= 0).all()
        assert range_m[look].mean() / 1e3 == pytest.approx(float(chance @ range_m) / 1e3, abs=0.1)


def test_papers_initiation_range_and_gain() -> None:
    """Paper 003 section 3.3 at its nearest reading: 3 of 6 alone, 3 of 12 on the merged stream, two steady pulses."""
    scan = 4.848
    radar = RadarEquation(pulses=2)

    def mean_range(times: np.ndarray, rule: MOfN) -> float:
        range_m = np.sqrt(2) * np.abs(125e3 - 200 * times)
        near = range_m > 20e3
        return float(initiation_chances(radar.probability(range_m[near]), rule) @ range_m[near])

    alone = mean_range(scan * np.arange(150), MOfN(3, 6))
    fused = mean_range(scan / 2 * np.arange(300), MOfN(3, 12))
    assert alone / 1e3 == pytest.approx(109.4, abs=0.7)
    assert range_gain_db(fused, alone) == pytest.approx(1.07, abs=0.15)


def test_false_tracks_against_draws() -> None:
    rng = np.random.default_rng(4)
    p, rule = 0.01, MOfN(2, 4)
    hit = rng.random(2_000_000) < p
    window = np.convolve(hit, np.ones(3), mode="full")[: len(hit)]
    begins = hit & (np.r_[0, window[:-1]] == 1)
    assert begins.mean() == pytest.approx(false_track_rate(p, rule), rel=0.1)
    other = equal_false_tracks(p, rule, MOfN(2, 8), looks=2.0)
    assert 2 * false_track_rate(other, MOfN(2, 8)) == pytest.approx(false_track_rate(p, rule))
    assert other < p


def test_what_makes_no_sense_is_refused() -> None:
    for call in (
        lambda: detection_probability(1.0, pfa=0.0),
        lambda: detection_probability(1.0, pfa=1e-6, pulses=0),
        lambda: RadarEquation(pd=1.0).probability(1e3),
        lambda: initiation_chances(np.ones(3), MOfN(4, 3)),
        lambda: initiation_looks(np.random.default_rng(1), np.ones(3), MOfN(0, 3), 1),
    ):
        with pytest.raises(SettingsError, match=r"makes? no sense"):
            call()
