"""The difference of a radar's two chains: against what was put in, and the real radar of Barcelona."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from boresight.assessment.psr_ssr import ALL, NM, psr_ssr
from boresight.model import Channel, Flag, Plots
from boresight.reading import read


def scene(rng: np.random.Generator, n: int = 4000) -> Plots:
    """Two channels with +100 m - 1.5 m/NM about 30 NM and +260 m, a delay a target, and one in a hundred wrong."""
    target = rng.integers(0, 80, n)
    delay = rng.normal(0, 20, 80)[target]
    distance = rng.uniform(5, 55, n) * NM
    channel = np.where(rng.random(n) < 0.8, Channel.MODE_S_PSR, Channel.SSR_PSR)
    difference = np.where(channel == Channel.MODE_S_PSR, 100 - 1.5 * (distance / NM - 30), 260.0) + delay + rng.normal(0, 40, n)
    difference = np.where(rng.random(n) < 0.01, rng.uniform(-900, 900, n), difference)
    return Plots(
        sensor=np.full(n, 5), channel=channel, range_m=distance, psr_ssr_range_m=difference,
        psr_ssr_azimuth_rad=np.radians(rng.normal(0.02, 0.06, n)), mode_s=target, flags=np.zeros(n),
    )  # fmt: skip


def test_means_slopes_and_their_uncertainties_are_those_that_were_put_in() -> None:
    wrong = []
    for seed in range(40):
        found = psr_ssr(scene(np.random.default_rng(seed)))
        assert found.channel.tolist() == [Channel.SSR_PSR, Channel.MODE_S_PSR, ALL]
        one = found[found.channel == Channel.MODE_S_PSR]
        wrong.append(
            [
                (one.range_m[0] - 100) / one.range_se_m[0],
                (one.slope[0] * NM + 1.5) / (one.slope_se[0] * NM),
                (np.degrees(one.azimuth_rad[0]) - 0.02) / np.degrees(one.azimuth_se_rad[0]),
            ]
        )
        assert found.range_m[0] == pytest.approx(260, abs=15)
        assert 0.003 < found.outliers[2] / 4000 < 0.015
        assert one.range_sd_m[0] == pytest.approx(np.hypot(np.hypot(40, 20), 1.5 * 50 / np.sqrt(12)), rel=0.2)
    # Reported uncertainties are true: sd of the normalised errors near 1 (40 scenes: within 0.7 to 1.35 at 99 %).
    spread = np.std(wrong, axis=0)
    assert np.all((spread > 0.7) & (spread < 1.4))
    assert np.all(np.abs(np.mean(wrong, axis=0)) < 0.6)


def test_plots_that_are_no_targets_and_plots_without_the_difference_take_no_part() -> None:
    plots = scene(np.random.default_rng(1), 200)
    flags = np.where(np.arange(200) < 100, int(Flag.SIMULATED), 0)
    assert psr_ssr(plots.replace(flags=flags)).plots[-1] <= 100
    assert len(psr_ssr(plots.replace(psr_ssr_range_m=np.full(200, np.nan)))) == 0
    assert len(psr_ssr(Plots())) == 0


def test_one_plot_and_no_azimuth_give_no_spread_but_no_failure() -> None:
    found = psr_ssr(Plots(sensor=[5], channel=[5], range_m=[1000.0], psr_ssr_range_m=[10.0], flags=[0]))
    assert (found.plots[0], found.range_m[0]) == (1, 10.0)
    assert np.isnan([found.range_sd_m[0], found.range_se_m[0], found.slope[0], found.azimuth_rad[0]]).all()


@pytest.mark.real
def test_the_radar_of_barcelona(data: Path) -> None:
    """METHODS section 7: +185 to +200 m, +0.01 to +0.03 degrees, -0.8 m/NM, +265 m for combined plots without Mode S (TYP 3)."""
    plots = read(data / "bcn-2023/230502-est-080001_BCN_60MN_08_09.ast", date=datetime.date(2023, 5, 2)).plots
    found = psr_ssr(plots)
    every = found[found.channel == ALL]
    assert 185 < every.range_m[0] < 200
    assert 0.01 < np.degrees(every.azimuth_rad[0]) < 0.03
    assert every.slope[0] * NM == pytest.approx(-0.8, abs=0.15)
    assert abs(every.slope[0]) > 2 * every.slope_se[0]
    assert every.plots[0] + every.outliers[0] == pytest.approx(28949, abs=100)
    assert every.range_sd_m[0] == pytest.approx(59, abs=4)
    typ3 = found[found.channel == Channel.SSR_PSR]
    assert typ3.range_m[0] == pytest.approx(265, abs=5)
