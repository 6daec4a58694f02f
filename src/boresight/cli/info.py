"""``boresight info``: what a recording holds."""

from __future__ import annotations

import datetime
import math
import sys
from pathlib import Path
from typing import Any

from ..errors import SettingsError
from ._options import Date, Editions, Files, Json, Switch, date_of, editions_of, print_json, steps


def info(
    files: Files,
    /,
    *,
    date: Date = None,
    edition: Editions | None = None,
    clock: Switch = False,
    out: Path | None = None,
    json: Json = False,
) -> None:
    """Tell what recordings hold: categories, editions, sensors, time span, counts, damage, PSR - SSR and clocks.

    Parameters
    ----------
    files
        Recordings.
    date
        UTC date of the first record, as 2016-05-10.
    edition
        Edition of an ASTERIX category, as 021=0.23.
    clock
        Look at the clocks: the antenna's turn against the stamps, reception against the stamps.
    out
        Draw the clocks to this file (SVG, PNG or PDF); one recording only.
    json
        Print the result as JSON.
    """
    from ..reading import read

    if out is not None and len(files) != 1:
        raise SettingsError("one figure shows one recording", where="--out", remedy="Give one file, or no --out.")
    if out is not None and out.suffix.lower() not in (".svg", ".png", ".pdf"):
        raise SettingsError(f"{out.name!r} is no kind of figure", where="--out", remedy="Its name ends in .svg, .png or .pdf.")
    if out is not None and out.exists():
        raise SettingsError(f"{out} exists", where="--out", remedy="Name another file.")
    chosen, day = editions_of(edition), date_of(date)
    recordings: list[Any] = []
    audits: list[Any] = []
    with steps(quiet=json) as step:
        for path in files:
            step(f"reading {path}")
            recordings.append(read(path, editions=chosen, date=day))
            audits.append(None)
            if clock or out is not None:
                from ..assessment.clock import audit, figure

                step(f"looking at the clocks of {path}")
                audits[-1] = audit(recordings[-1])
                if out is not None:
                    figure(recordings[-1], out)
    if json:
        print_json({"files": [_view(r, a) for r, a in zip(recordings, audits, strict=True)]})
        return
    for r, a in zip(recordings, audits, strict=True):
        _print(r, a)
        if out is not None:
            print(f"figure: {out}")


def _iso(time_s: float) -> str | None:
    if not math.isfinite(time_s):
        return None
    return datetime.datetime.fromtimestamp(time_s, datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _psr_ssr(r: Any) -> Any:
    """The table of PSR - SSR; None where no plot tells it."""
    import numpy as np

    if not np.isfinite(r.plots.psr_ssr_range_m).any():
        return None
    from ..assessment.psr_ssr import psr_ssr

    return psr_ssr(r.plots)


def _psr_ssr_rows(r: Any) -> list[dict[str, Any]]:
    table = _psr_ssr(r)
    if table is None:
        return []
    from ..assessment.psr_ssr import NM, channel_name

    return [
        {
            "sac": int(table.sensor[k]) >> 8,
            "sic": int(table.sensor[k]) & 255,
            "channel": channel_name(int(table.channel[k])),
            "plots": int(table.plots[k]),
            "outliers": int(table.outliers[k]),
            "targets": int(table.targets[k]),
            "range_m": float(table.range_m[k]),
            "range_se_m": float(table.range_se_m[k]),
            "range_median_m": float(table.range_median_m[k]),
            "range_sd_m": float(table.range_sd_m[k]),
            "slope_m_per_nm": float(table.slope[k]) * NM,
            "slope_se_m_per_nm": float(table.slope_se[k]) * NM,
            "azimuth_deg": math.degrees(table.azimuth_rad[k]),
            "azimuth_se_deg": math.degrees(table.azimuth_se_rad[k]),
            "azimuth_sd_deg": math.degrees(table.azimuth_sd_rad[k]),
        }
        for k in range(len(table))
    ]


def _view(r: Any, clocks: Any) -> dict[str, Any]:
    view = {
        "file": r.path,
        "records": r.records,
        "by_category": {f"{category:03d}": n for category, n in sorted(r.by_category.items())},
        "sources": [
            {
                "sac": s.sac,
                "sic": s.sic,
                "category": f"{s.category:03d}",
                "edition": s.edition,
                "records": s.records,
                "plots": s.plots,
                "start": _iso(s.start_s),
                "end": _iso(s.end_s),
                "targets": s.targets,
                "latitude_deg": math.degrees(s.latitude_rad),
                "longitude_deg": math.degrees(s.longitude_rad),
                "height_m": s.height_m,
                "notes": list(s.notes),
            }
            for s in r.sources
        ],
        "damaged": [{"offset": d.offset, "why": d.why} for d in r.damaged],
        "warnings": list(r.warnings),
        "tracks": len(r.tracks),
        "passed_over": dict(sorted(r.passed_over.items())),
        "marks": len(r.marks),
        "psr_minus_ssr": _psr_ssr_rows(r),
    }
    if clocks is not None:
        view["clocks"] = clocks
    return view


def _print(r: Any, clocks: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    # A pipe has no width: nothing is cut there.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 180)
    console.print(
        f"{r.path}: {r.records:,} records, {len(r.plots):,} plots, {len(r.fixes):,} fixes, "
        f"{f'{len(r.tracks):,} track states, ' if len(r.tracks) else ''}{len(r.damaged):,} damaged"
    )
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("sac/sic", "category", "edition", "records", "plots", "targets", "from (UTC)", "to (UTC)"):
        table.add_column(name, justify="right" if name in ("records", "plots", "targets") else "left", no_wrap=True)
    for s in r.sources:
        row = (f"{s.sac}/{s.sic}", f"{s.category:03d}", s.edition, f"{s.records:,}", f"{s.plots:,}", f"{s.targets:,}")
        table.add_row(*row, _iso(s.start_s) or "no time", _iso(s.end_s) or "no time")
    console.print(table)
    for s in r.sources:
        if math.isfinite(s.latitude_rad) and s.category in (19, 34):
            place = f"{math.degrees(s.latitude_rad):.6f}, {math.degrees(s.longitude_rad):.6f}, {s.height_m:.0f} m"
            console.print(f"{s.sac}/{s.sic} says that it stands at {place}", soft_wrap=True)
        for note in s.notes:
            console.print(f"{s.sac}/{s.sic} says of {note}", soft_wrap=True)
    for sentence in _content(r):
        console.print(sentence, soft_wrap=True)
    _print_psr_ssr(console, r)
    if clocks is not None:
        _print_clocks(console, clocks)
    for warning in r.warnings:
        console.print(f"warning: {warning}", soft_wrap=True)
    for damage in r.damaged[:20]:
        console.print(f"damaged: byte {damage.offset}: {damage.why}", soft_wrap=True)
    if len(r.damaged) > 20:
        console.print(f"damaged: and {len(r.damaged) - 20:,} more (--json lists them all)")


def _content(r: Any) -> list[str]:
    """What the plots and fixes are, a sentence each, and the fields that were passed over."""
    import numpy as np

    from ..assessment.psr_ssr import NM, channel_name
    from ..model import EXCLUDED, Flag

    out: list[str] = []
    for table, key, what in ((r.plots, "sensor", "plots"), (r.fixes, "source", "fixes")):
        if not len(table):
            continue
        kinds = [(channel_name(k), int(np.count_nonzero(table.channel == k))) for k in np.unique(table.channel).tolist() if k]
        words = [f"{name} {count:,}" for name, count in kinds]
        if what == "plots":
            low, high = float(np.nanmin(table.range_m)), float(np.nanmax(table.range_m))
            words.append(f"{low / NM:.1f} to {high / NM:.1f} NM" if high > 20e3 else f"{low:,.0f} to {high:,.0f} m")
        else:
            ground = int(np.count_nonzero(table.flags & int(Flag.GROUND)))
            words += [f"{ground:,} on the ground"] if ground else []
        for name, column in (("Mode S addresses", table.mode_s), ("MMSI", table.mmsi), ("track numbers", table.track)):
            of = np.unique(np.column_stack([getattr(table, key), column])[column >= 0], axis=0)
            words += [f"{len(of):,} {name}"] if len(of) else []
        excluded = int(np.count_nonzero(table.flags & int(EXCLUDED)))
        words += [f"{excluded:,} flagged as unfit for registration"] if excluded else []
        out.append(f"{what}: {', '.join(words)}" if words else "")
    names = {"RE": "reserved expansion fields", "SP": "special purpose fields"}
    for field, count in sorted(r.passed_over.items()):
        category, name = field.split()
        out.append(f"category {category}: {count:,} records have {names[name]} ({name}), which are skipped by their length")
    return [sentence for sentence in out if sentence]


def _print_psr_ssr(console: Any, r: Any) -> None:
    from rich.table import Table

    rows = _psr_ssr_rows(r)
    if not rows:
        return
    table = Table(box=None, header_style="bold", pad_edge=False, title="PSR - SSR", title_justify="left")
    for name in ("sac/sic", "channel", "plots", "range m", "sd", "m/NM", "azimuth deg", "sd"):
        table.add_column(name, justify="left" if name in ("sac/sic", "channel") else "right", no_wrap=True)
    for row in rows:
        table.add_row(
            f"{row['sac']}/{row['sic']}",
            row["channel"],
            f"{row['plots']:,}",
            f"{row['range_m']:+.1f} ± {row['range_se_m']:.1f}",
            f"{row['range_sd_m']:.1f}",
            f"{row['slope_m_per_nm']:+.2f} ± {row['slope_se_m_per_nm']:.2f}",
            f"{row['azimuth_deg']:+.4f} ± {row['azimuth_se_deg']:.4f}",
            f"{row['azimuth_sd_deg']:.3f}",
        )
    console.print(table)


def _who(sensor: int) -> str:
    return f"{sensor >> 8}/{sensor & 255}" if sensor < 65536 else f"sensor {sensor}"


def _print_clocks(console: Any, clocks: Any) -> None:
    for one in clocks.rotations:
        console.print(
            f"{_who(one.sensor)} turns in {one.period_s:.5f} s ± {one.period_se_s * 1e6:.0f} us (by its "
            f"{one.told_by}, {one.turns:,} turns): stamps jitter by {one.jitter_s * 1e3:.1f} ms (robust sd), 99.9 % keep to "
            f"{one.jitter_999_s * 1e3:.0f} ms, slow wander {one.wander_s * 1e3:.1f} ms, ripple {one.ripple_deg[0]:.3f} and "
            f"{one.ripple_deg[1]:.3f} degrees, {len(one.gaps)} gaps",
            soft_wrap=True,
        )
    for one in clocks.receptions:
        drift = "" if math.isnan(one.drift_ms_per_h) else f", drift {one.drift_ms_per_h:+.1f} ms/h"
        console.print(
            f"{_who(one.sensor)} is received {one.median_s:+.3f} s after its stamps (median of {one.samples:,}, "
            f"robust sd {one.sd_s:.3f} s, all within {one.least_s:+.3f} to {one.most_s:+.3f} s{drift})",
            soft_wrap=True,
        )
    for remark in clocks.remarks:
        console.print(f"clock: {remark}", soft_wrap=True)
