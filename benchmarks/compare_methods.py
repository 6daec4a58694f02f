"""What do the methods of registration find on the same pairs, how long do they take, and what do they leave?

    python benchmarks/compare_methods.py [--data FOLDER] [--page PAGE.md] [--figures FOLDER] [--quick] [--json]

Three recordings: Barcelona's surface movement radar of 2016 against multilateration (real; only where `--data` or
$BORESIGHT_DATA points to the recordings), the demonstration's three radars with constant errors, and one radar whose azimuth and
range errors drift and step.  Each is read or simulated and associated once; every method of `METHODS` is then given the same
pairs with its defaults.  Printed are seconds of processor time, the terms with their sd, the median and 95th percentile of the
horizontal distance to targets held out (the same folds for all) and, where the scene is simulated, what is left of the
radar's own errors after correction, without the plots' noise: root mean square over all plots, along range and across it.

The claim: of the errors that stay least squares leaves the least, of those that drift least squares with `--online`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

import boresight as bs
from boresight.association import search
from boresight.calibration import Calibration, si_per_unit
from boresight.errors import BoresightError
from boresight.geodesy import rotate
from boresight.measure import polar_from_enu, wrap_rad
from boresight.model import Pairs, Sensor, Sensors
from boresight.registration.methods import METHODS, register_with
from boresight.simulation import Adsb, Radar, Scenario, Simulated, Traffic, demo_scene, simulate
from boresight.simulation.drift import Drift, Sine, Step
from boresight.simulation.radar import site

# Barcelona airport in 2016: where the radar and the multilateration's origin stand.
_LEBL = (
    Sensor(name="SMR", sac=0, sic=7, lat_deg=41.29561833, lon_deg=2.095114167, height_m=85.0, kind="surface", scan_s=1.0),
    Sensor(name="MLAT", sac=0, sic=107, lat_deg=41.297079, lon_deg=2.078463, height_m=51.0, kind="mlat"),
)
# Least squares may be asked for values over time too.
ONLINE = "least-squares --online"
TRIED = (*METHODS, ONLINE)
MARK = "<!-- made by benchmarks/compare_methods.py -->"


class Scene(NamedTuple):
    """A recording: its pairs, its sensors, and the simulation where it is one."""

    name: str
    pairs: Pairs
    sensors: Sensors
    run: Simulated | None


class Outcome(NamedTuple):
    """What one method gave for one sensor."""

    method: str
    sensor: str
    seconds: float
    terms: dict[str, tuple[float, float, str]]
    held_out: tuple[float, float, float, float]
    left: tuple[float, float]
    ended: str
    why: str


def drifting(seed: int, duration_s: float = 3600.0, aircraft: int = 40) -> Scenario:
    """A radar whose azimuth goes to and fro and steps, and whose range drifts, among aircraft with good ADS-B."""
    azimuth = Drift(
        value=0.15, sine=(Sine(amplitude=0.08, period_s=duration_s / 2.4),), step=(Step(at_s=0.6 * duration_s, by=-0.25),)
    )
    radar = Radar(
        name="drifting", sac=20, sic=5, lat_deg=41.3007, lon_deg=2.1021, height_m=77.0, kind="mode_s", scan_s=4.0,
        max_range_m=120e3, range_sd_m=25.0, azimuth_sd_deg=0.06,
        errors={"range_bias": Drift(value=40.0, ramp_per_h=60.0), "azimuth_bias": azimuth, "time_offset": 0.2},
    )  # fmt: skip
    traffic = Traffic(aircraft=aircraft, lat_deg=41.3, lon_deg=2.1, radius_m=110e3, arrivals=0.0, departures=0.0)
    return Scenario(name=f"drifting, seed {seed}", duration_s=duration_s, traffic=traffic, radar=(radar,), adsb=Adsb(share=0.95))


def from_memory(scenario: Scenario, seed: int) -> Scene:
    """Simulate and associate."""
    run = simulate(scenario, np.random.default_rng([seed, 3]))
    fixes, _ = bs.locate(run.fixes, run.sensors, ())
    return Scene(scenario.name, search(run.plots, fixes, run.sensors).pairs, run.sensors, run)


def barcelona(data: Path) -> Scene:
    """The pairs of the real recording."""
    from datetime import date

    folder = data / "lebl-2016"
    day = date(2016, 5, 10)
    radar = bs.read(folder / "smr_cat010_160510-lebl-220001.ast", date=day)
    reference = bs.read(folder / "mlat_cat010_160510-lebl-220001.ast", date=day)
    sensors = Sensors(_LEBL)
    fixes, _ = bs.locate(reference.fixes, sensors, reference.sources)
    plots = radar.plots[radar.plots.sensor == _LEBL[0].key]
    return Scene("Barcelona 2016, SMR against MLAT", search(plots, fixes, sensors).pairs, sensors, None)


def left_over(scene: Scene, found: Calibration, sensor: Sensor) -> tuple[float, float]:
    """Root mean square, metres, of what correction leaves of a simulated radar's errors along range and across it.

    A corrected plot is compared with where its target truly was at the corrected stamp, with the plot's own noise taken off.
    """
    run = scene.run
    assert run is not None
    number = next(k for k, radar in enumerate(run.scenario.radar) if radar.name == sensor.name)
    seen, radar = run.observations[number], run.scenario.radar[number]
    rows = np.flatnonzero(seen.target >= 0)
    plots = bs.correct(seen.plots[rows], found)
    origin, rotation = site(radar)
    motion = run.truth.motion(seen.target[rows], plots.time_s - run.truth.epoch_s, derivatives=0)
    truth = polar_from_enu(rotate(rotation, motion.position - origin))
    noise = seen.noise[rows]
    along = plots.range_m - truth[:, 0] - noise[:, 0]
    across = wrap_rad(plots.azimuth_rad - truth[:, 1] - noise[:, 1]) * truth[:, 0] * np.cos(truth[:, 2])
    # Of a target that has just appeared or left nobody knows where it is at a stamp that is still late.
    known = np.isfinite(along + across)
    return float(np.sqrt(np.mean(along[known] ** 2))), float(np.sqrt(np.mean(across[known] ** 2)))


def tried(scene: Scene, method: str) -> tuple[list[Outcome], Calibration | None]:
    """One method on a scene: an outcome for each sensor."""
    nothing = (math.nan,) * 4
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            name, _, online = method.partition(" --")
            found = register_with(METHODS[name], scene.pairs, scene.sensors, online=bool(online))
    except BoresightError as error:
        took = time.process_time() - start
        return [Outcome(method, "", took, {}, nothing, nothing[:2], "", str(error))], None
    took = time.process_time() - start
    out = []
    for s in found.sensors:
        terms = {}
        for k, key in enumerate(found.terms):
            if key.sensor == s.sensor:
                scale = si_per_unit(key)
                name = key.name if key.channel == "all" else f"{key.name}@{key.channel}"
                terms[name] = (float(found.value[-1, k] / scale), float(found.sd[-1, k] / scale), key.unit)
        held = (s.held_out_before_median_m, s.held_out_after_median_m, s.held_out_before_p95_m, s.held_out_after_p95_m)
        sensor = next(x for x in scene.sensors if x.key == s.sensor)
        left = left_over(scene, found, sensor) if scene.run is not None else nothing[:2]
        ended = next((note.removeprefix("how it ended: ") for note in s.notes if note.startswith("how it ended")), "")
        out.append(Outcome(method, s.name, took, terms, held, left, ended, ""))
    return out, found


def table(scene: Scene, outcomes: list[Outcome]) -> list[str]:
    """The outcomes of a scene as Markdown."""
    lines = [f"### {scene.name}", "", f"{len(scene.pairs):,} pairs of {len(np.unique(scene.pairs.target)):,} targets.", ""]
    names = list(dict.fromkeys(o.sensor for o in outcomes if o.sensor))
    for name in names:
        mine = [o for o in outcomes if o.sensor in (name, "")]
        before = next(o.held_out for o in mine if o.sensor)
        lines += [f"**{name}**: as measured, held-out targets are {before[0]:.1f} m off (median), {before[2]:.1f} m (95 %).", ""]
        simulated = scene.run is not None
        more = " left along / across range |" if simulated else ""
        lines += [
            f"| method | CPU s | held out: median | 95 % |{more} terms |",
            f"|---|---|---|---|{'---|' if simulated else ''}---|",
        ]
        for o in mine:
            if o.why:
                lines.append(f"| {o.method} | {o.seconds:.1f} | - | - |{' - |' if simulated else ''} {o.why} |")
                continue
            terms = ", ".join(f"{name} {value:.3g} ± {_two_digits(sd)} {unit}" for name, (value, sd, unit) in o.terms.items())
            left = f" {o.left[0]:.1f} / {o.left[1]:.1f} m |" if simulated else ""
            lines.append(f"| {o.method} | {o.seconds:.1f} | {o.held_out[1]:.1f} m | {o.held_out[3]:.1f} m |{left} {terms} |")
        lines.append("")
    return lines


def _two_digits(sd: float) -> str:
    """A standard deviation with two digits, never as a power of ten where it is large."""
    return f"{sd:.2g}" if sd < 99.5 else f"{float(f'{sd:.2g}'):.0f}"


def held_out_figure(results: list[tuple[Scene, list[Outcome]]]) -> str:
    """For every sensor of every scene: the held-out median by method, with what it was as measured."""
    from boresight.report.drawing import AFTER, BEFORE, axes_grid, dot, legend, line, style, to_svg

    panels = [(scene, name) for scene, outcomes in results for name in dict.fromkeys(o.sensor for o in outcomes if o.sensor)]
    methods = list(TRIED)
    with style("methods-held-out"):
        figure, axes = axes_grid(1, len(panels), 3.4, left=1.52, top=0.42, bottom=0.72, gap=(0.22, 0.3))
        for k, ((scene, name), panel) in enumerate(zip(panels, axes[0], strict=True)):
            outcomes = next(o for s, o in results if s is scene)
            mine = {o.method: o for o in outcomes if o.sensor == name}
            place = np.arange(len(methods))[::-1]
            after = np.array([mine[m].held_out[1] if m in mine else np.nan for m in methods])
            before = next(o.held_out[0] for o in mine.values())
            panel.axvline(before, color=BEFORE, linewidth=1.4, zorder=3)
            panel.hlines(place, 0, after, color=AFTER, linewidth=1.0, alpha=0.4)
            panel.plot(after, place, "o", color=AFTER, markersize=4.5, zorder=4)
            panel.set_xlim(0, 1.12 * max(before, float(np.nanmax(after))))
            panel.set_ylim(-0.6, len(methods) - 0.4)
            panel.set_yticks(place, methods if k == 0 else [""] * len(methods))
            panel.set_title(name)
            panel.set_xlabel("m")
        legend(figure, [(dot(AFTER), "median distance of held-out targets, corrected"), (line(BEFORE), "as measured")])
        return to_svg(figure, "methods-held-out")


def drift_figure(scene: Scene, found: dict[str, Calibration]) -> str:
    """Azimuth bias over time: the truth and what each method says at each time."""
    from boresight.report.drawing import INK, axes_grid, legend, line, style, to_svg

    assert scene.run is not None
    truth = scene.run.observations[0]
    colours = ("#6b737c", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
    shown = [m for m in ("least-squares", ONLINE, "kalman-bank", "igmsr", "mean-shift", "alpha-beta") if m in found]
    with style("methods-drift"):
        figure, axes = axes_grid(1, 1, 3.4, top=0.3, bottom=0.85, left=0.8)
        panel = axes[0][0]
        start = scene.run.truth.epoch_s
        grid = np.linspace(0.0, scene.run.scenario.duration_s, 721)
        true = truth.errors["azimuth_bias"](grid)
        entries = [(line(INK, 2.2), "truth")]
        panel.plot(grid / 60, true, color=INK, linewidth=2.2, zorder=6)
        for colour, method in zip(colours, shown, strict=False):
            c = found[method]
            k = c.index(scene.sensors.sensor[0].key, "azimuth_bias")
            if k is None:
                continue
            value = c.value[:, k] / si_per_unit(c.terms[k])
            when = grid / 60 if len(c.epoch_s) == 1 else (c.epoch_s - start) / 60
            panel.plot(when, np.broadcast_to(value, when.shape), color=colour, linewidth=1.3, zorder=4)
            entries.append((line(colour), method))
        panel.set_ylim(float(true.min()) - 0.12, float(true.max()) + 0.12)
        panel.set_xlim(0, grid[-1] / 60)
        panel.set_xlabel("minutes")
        panel.set_ylabel("azimuth bias (°)")
        legend(figure, entries)
        return to_svg(figure, "methods-drift")


def main() -> int:
    """Print the tables; 1 where a method fails in a way that no message tells, or the defaults lose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("BORESIGHT_DATA"))
    parser.add_argument("--page", type=Path, help="a page whose part between its two marks becomes these tables")
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="one short drifting scene")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.quick:
        scenes = [from_memory(drifting(options.seed, 600.0, 15), options.seed)]
    else:
        scenes = [barcelona(options.data)] if options.data is not None else []
        scenes += [from_memory(demo_scene(options.seed), options.seed), from_memory(drifting(options.seed), options.seed)]
    lines: list[str] = []
    results: list[tuple[Scene, list[Outcome]]] = []
    calibrations: dict[str, Calibration] = {}
    for scene in scenes:
        outcomes: list[Outcome] = []
        for method in TRIED:
            mine, found = tried(scene, method)
            outcomes += mine
            if found is not None and scene is scenes[-1]:
                calibrations[method] = found
        results.append((scene, outcomes))
        lines += table(scene, outcomes)
    text = "\n".join(lines)
    if options.json:
        print(json.dumps([{"scene": scene.name, "outcomes": [o._asdict() for o in out]} for scene, out in results]))
    else:
        print(text)
    if options.page is not None:
        before, _, rest = options.page.read_text(encoding="utf-8").partition(MARK)
        options.page.write_text(f"{before}{MARK}\n\n{text}\n{MARK}{rest.partition(MARK)[2]}", encoding="utf-8")
    if options.figures is not None:
        (options.figures / "methods_held_out.svg").write_text(held_out_figure(results), encoding="utf-8")
        (options.figures / "methods_drift.svg").write_text(drift_figure(scenes[-1], calibrations), encoding="utf-8")
    return verdict(results)


def verdict(results: list[tuple[Scene, list[Outcome]]]) -> int:
    """0 where the default leaves the least: of a simulated radar's errors, or to the real one's targets that were held out."""
    failed = 0
    for scene, outcomes in results:
        for name in dict.fromkeys(o.sensor for o in outcomes if o.sensor):
            mine = [o for o in outcomes if o.sensor == name]
            left = {o.method: o.held_out[1] if scene.run is None else math.hypot(*o.left) for o in mine}
            # Half a per cent and a tenth of a metre are chance.
            ours = left[ONLINE if "drifting" in scene.name else "least-squares"]
            better = [m for m, value in left.items() if value < ours * 0.995 - 0.1]
            print(f"{scene.name}, {name}: {'the default is not beaten' if not better else f'better: {better}'}", file=sys.stderr)
            failed += bool(better)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
