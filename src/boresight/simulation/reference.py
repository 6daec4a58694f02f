"""What references say of the truth: ADS-B, AIS, multilateration and RTK receivers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..errors import SettingsError
from ..geodesy import ecef_from_geodetic, enu_from_ecef, geodetic_from_ecef, rotate
from ..model import Channel, Fixes, Flag, pack_callsigns
from ..writing.asterix import accuracy_sd_m
from ..writing.nmea import KNOT_MPS, AisPositions, AisStatics
from ..writing.rtklib import FIXED_SD_M, FLOAT_SD_M
from .radar import ASTERIX_TIME_S, rounded
from .truth import STEP_S, Aircraft, Traffic, Truth

# The quantum of heights in CAT020 and CAT021.
_HEIGHT_QUANTUM_M = 6.25 * 0.3048


class Adsb(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An ADS-B ground station and what aircraft tell it.

    `share` of the aircraft have ADS-B.  `classes` maps navigation accuracy categories (NACp) to their shares: an aircraft's
    horizontal error has the sd of its class on each axis, `correlated` of the variance wandering with `correlation_s`, the rest
    new in every report.  `latency_mean_s` and `latency_sd_s` are over aircraft: reports are stamped that much late.  Reports come
    every `interval_s` (lowest, highest mean of an aircraft), each is lost with `loss`, and gaps of `gap_s` on average begin every
    `gap_every_s` on average.
    """

    name: str = "ADS-B"
    sac: int = 20
    sic: int = 219
    share: float = 0.9
    classes: dict[str, float] = msgspec.field(default_factory=lambda: {"8": 0.15, "9": 0.35, "10": 0.4, "11": 0.1})
    correlated: float = 0.8
    correlation_s: float = 600.0
    height_sd_m: float = 10.0
    velocity_sd_mps: float = 0.4
    latency_mean_s: float = 0.0
    latency_sd_s: float = 0.1
    interval_s: tuple[float, float] = (0.5, 1.0)
    loss: float = 0.05
    gap_every_s: float = 600.0
    gap_s: float = 15.0
    time_quantum_s: float = ASTERIX_TIME_S
    identity: bool = True


class Ais(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A shore station and what ships tell it.

    Class A ships report every 10 s, every 6 s above 14 kn and every 2 s above 23 kn, three times as often while they turn, every
    3 minutes at anchor; class B every 30 s (ITU-R M.1371); each report is lost with `loss`.  Static data go out every `static_s`.
    A position is of a whole second of UTC, `latency_mean_s` and `latency_sd_s` (over ships) late; `correlated` of its error's
    variance wanders with `correlation_s`.
    """

    loss: float = 0.05
    static_s: float = 360.0
    latency_mean_s: float = 0.0
    latency_sd_s: float = 0.2
    correlated: float = 0.8
    correlation_s: float = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class AisLog:
    """What the shore station received: reports, the number of the ship's target of each (n,), and static data."""

    positions: AisPositions
    target: IntArray
    statics: AisStatics


class Receiver(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where a receiver of a multilateration system stands; `height_m` is ellipsoidal."""

    lat_deg: float
    lon_deg: float
    height_m: float = 0.0


class Mlat(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A multilateration system and what it says of aircraft.

    It covers `radius_m` about `lat_deg`, `lon_deg`, up to the ellipsoidal height `ceiling_m` (left out: any; a surface system has
    a low one), and `share` of the aircraft.  `height_m` is the ground's, ellipsoidal: within 5 m of it a target is on the ground.
    A position has the sd `horizontal_sd_m` on each axis; with three ``receiver`` tables or more its covariance is instead that
    of the geometry: times of arrival with the sd `arrival_sd_m` each, the time of sending unknown, the height known to
    `altitude_sd_m` from the transponder.  What is then worse than `worst_sd_m` an axis is not sent.  `correlated` of the variance
    wanders with `correlation_s`, the rest is new in each report.

    Reports come every `interval_s`, each is lost with `loss`; their stamps are `latency_s` late.  With `height_sd_m` they tell an
    ellipsoidal height, else pressure altitude only.  ``identity=False`` takes address, code and callsign away.
    """

    name: str = "MLAT"
    sac: int = 20
    sic: int = 107
    lat_deg: float
    lon_deg: float
    height_m: float = 0.0
    radius_m: float = 60e3
    ceiling_m: float | None = None
    share: float = 1.0
    horizontal_sd_m: float = 7.5
    receiver: tuple[Receiver, ...] = ()
    arrival_sd_m: float = 1.5
    altitude_sd_m: float = 30.0
    worst_sd_m: float = 150.0
    correlated: float = 0.3
    correlation_s: float = 60.0
    height_sd_m: float | None = None
    interval_s: float = 1.0
    latency_s: float = 0.0
    loss: float = 0.05
    identity: bool = True


class Rtk(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """GNSS receivers with real-time kinematics on board of scripted targets.

    `targets` are their names; left out, all scripted targets carry one.  Positions come every `interval_s`, on whole multiples of
    it, and are right to `fixed_sd_m` an axis while the ambiguities are fixed and to `float_sd_m` while they are not: for
    `float_share` of the time, `float_s` at once on average.  Heights are half as good.  `correlated` of the variance wanders with
    `correlation_s`.  Gaps of `gap_s` on average begin every `gap_every_s` on average (0: there are none).
    """

    targets: tuple[str, ...] = ()
    interval_s: float = 0.2
    fixed_sd_m: float = 0.01
    float_sd_m: float = 0.4
    float_share: float = 0.05
    float_s: float = 30.0
    correlated: float = 0.7
    correlation_s: float = 60.0
    velocity_sd_mps: float = 0.03
    gap_every_s: float = 0.0
    gap_s: float = 5.0


def check_mlat(mlat: Mlat, where: str = "mlat") -> None:
    """Raise SettingsError for a multilateration system that cannot be simulated."""
    if not (abs(mlat.lat_deg) <= 89 and abs(mlat.lon_deg) <= 180 and 100 <= mlat.radius_m <= 500e3):
        raise SettingsError("needs lat_deg, lon_deg on Earth and radius_m within 100 … 500,000", where=where)
    if not (0 <= mlat.sac <= 255 and 0 <= mlat.sic <= 255):
        raise SettingsError("sac and sic are within 0 … 255", where=where)
    if not (0 <= mlat.share <= 1 and 0 <= mlat.loss < 1 and 0 <= mlat.correlated <= 1 and mlat.correlation_s > 0):
        raise SettingsError("share, loss and correlated are within 0 … 1, correlation_s is positive", where=where)
    if not (0.1 <= mlat.interval_s <= 600 and abs(mlat.latency_s) <= 60):
        raise SettingsError("interval_s is within 0.1 … 600 and latency_s within -60 … 60", where=where)
    sds = (mlat.horizontal_sd_m, mlat.arrival_sd_m, mlat.altitude_sd_m, mlat.worst_sd_m)
    if not (min(sds) > 0 and max(sds) < math.inf and (mlat.height_sd_m is None or 0 < mlat.height_sd_m < math.inf)):
        raise SettingsError("all its sd are positive", where=where)
    if 0 < len(mlat.receiver) < 3:
        raise SettingsError(
            f"{len(mlat.receiver)} receivers do not give a position", where=where, remedy="Give three or more, or none."
        )
    if any(not (abs(r.lat_deg) <= 89 and abs(r.lon_deg) <= 180) for r in mlat.receiver):
        raise SettingsError("a receiver stands nowhere on Earth", where=where)


def check_rtk(rtk: Rtk, names: tuple[str, ...], where: str = "rtk") -> None:
    """Raise SettingsError for receivers that cannot be simulated; `names` are those of the scripted targets (`Truth.names`)."""
    if not any(names):
        raise SettingsError(
            "receivers are on board of scripted targets, and there are none", where=where, remedy="Give [[target]]."
        )
    unknown = [name for name in rtk.targets if not name or name not in names]
    if unknown:
        known = ", ".join(dict.fromkeys(n for n in names if n))
        raise SettingsError(f"there is no target {unknown[0]!r}", where=where, remedy=f"Known: {known}.")
    if not 0.05 <= rtk.interval_s <= 60:
        raise SettingsError(f"interval_s = {rtk.interval_s:g} is not within 0.05 … 60", where=where)
    if not (0 < rtk.fixed_sd_m <= FIXED_SD_M < rtk.float_sd_m <= FLOAT_SD_M):
        raise SettingsError(
            f"fixed_sd_m must be within 0 … {FIXED_SD_M:g} and float_sd_m within {FIXED_SD_M:g} … {FLOAT_SD_M:g}", where=where
        )
    if not (0 <= rtk.float_share < 1 and rtk.float_s > 0 and 0 <= rtk.correlated <= 1 and rtk.correlation_s > 0):
        raise SettingsError("float_share and correlated are within 0 … 1, float_s and correlation_s positive", where=where)
    if min(rtk.velocity_sd_mps, rtk.gap_every_s, rtk.gap_s) < 0:
        raise SettingsError("velocity_sd_mps, gap_every_s and gap_s are not negative", where=where)


def _errors(n: int, step_s: float, correlated: float, correlation_s: float, axes: int, rng: np.random.Generator) -> FloatArray:
    """Errors (n, axes) of unit variance at regular times: `correlated` of it a Gauss-Markov process, the rest white."""
    from scipy.signal import lfilter

    keep = math.exp(-step_s / correlation_s)
    drive = rng.normal(0.0, 1.0, (n, axes)) * math.sqrt(1 - keep * keep)
    drive[:1] /= math.sqrt(1 - keep * keep)
    wander = np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0))
    return math.sqrt(correlated) * wander + math.sqrt(1 - correlated) * rng.normal(0.0, 1.0, (n, axes))


def mlat_covariance(mlat: Mlat, position: FloatArray) -> FloatArray:
    """The covariance (n, 2, 2), east and north in m^2, of multilaterated positions (n, 3), ECEF metres.

    By the geometry of the receivers, else the constant sd.  A geometry that gives no position gives huge values.
    """
    if not mlat.receiver:
        return np.broadcast_to(np.eye(2) * mlat.horizontal_sd_m**2, (len(position), 2, 2))
    lat, lon, up = np.array([(math.radians(r.lat_deg), math.radians(r.lon_deg), r.height_m) for r in mlat.receiver], np.float64).T
    stands = ecef_from_geodetic(lat, lon, up)
    latitude, longitude, _ = geodetic_from_ecef(position)
    path = position[:, None] - stands
    sight = rotate(enu_from_ecef(latitude, longitude)[:, None], path)
    sight = sight / np.linalg.norm(sight, axis=2, keepdims=True)
    # Unknown: east, north, up and when it was sent (as a distance).
    design = np.concatenate([sight, np.ones((*sight.shape[:2], 1))], axis=2)
    information = np.swapaxes(design, 1, 2) @ design / mlat.arrival_sd_m**2
    information[:, 2, 2] += 1.0 / mlat.altitude_sd_m**2
    return np.linalg.inv(information + 1e-12 * np.eye(4))[:, :2, :2]


def observe_mlat(truth: Truth, mlat: Mlat, rng: np.random.Generator) -> tuple[Fixes, IntArray]:
    """The reports of a multilateration system in the order of their stamps, and each report's target (n,).

    Raises SettingsError as `check_mlat` does.
    """
    check_mlat(mlat)
    place = math.radians(mlat.lat_deg), math.radians(mlat.lon_deg)
    centre, axes = ecef_from_geodetic(*place, mlat.height_m), enu_from_ecef(*place)
    n = truth.flights
    equipped = np.zeros(n, np.bool_)
    equipped[rng.permutation(n)[: round(mlat.share * n)]] = True
    numbers = rng.permutation(4095) + 1
    targets: list[IntArray] = []
    stamps: list[FloatArray] = []
    errors: list[FloatArray] = []
    for k, own in enumerate(rng.spawn(n)):
        first, last = float(truth.first_s[k]), float(truth.last_s[k])
        if not equipped[k]:
            continue
        stamp = np.arange(first + own.uniform(0.0, mlat.interval_s), last, mlat.interval_s) + mlat.latency_s
        stamp = np.rint((truth.epoch_s + stamp) / ASTERIX_TIME_S) * ASTERIX_TIME_S - truth.epoch_s
        error = _errors(len(stamp), mlat.interval_s, mlat.correlated, mlat.correlation_s, 3, own)
        kept = own.random(len(stamp)) >= mlat.loss
        kept &= (stamp - mlat.latency_s >= first) & (stamp - mlat.latency_s <= last)
        targets.append(np.full(int(np.count_nonzero(kept)), k, np.int64))
        stamps.append(stamp[kept])
        errors.append(error[kept])
    target, stamp = np.concatenate([np.empty(0, np.int64), *targets]), np.concatenate([np.empty(0), *stamps])
    error = np.concatenate([np.empty((0, 3)), *errors])
    position = truth.motion(target, stamp - mlat.latency_s, derivatives=0).position
    latitude, longitude, height = geodetic_from_ecef(position)
    local = rotate(axes, position - centre)
    seen = np.hypot(local[:, 0], local[:, 1]) <= mlat.radius_m
    if mlat.ceiling_m is not None:
        seen &= height <= mlat.ceiling_m
    covariance = mlat_covariance(mlat, position)
    sd = np.sqrt(np.einsum("nii->n", covariance) / 2)
    seen &= sd <= mlat.worst_sd_m if mlat.receiver else True
    rows = np.flatnonzero(seen)
    rows = rows[np.argsort(stamp[rows], kind="stable")]
    target, stamp, error, position, height, sd = target[rows], stamp[rows], error[rows], position[rows], height[rows], sd[rows]
    root = np.linalg.cholesky(covariance[rows])

    off = np.einsum("nij,nj->ni", root, error[:, :2])
    rotation = enu_from_ecef(latitude[rows], longitude[rows])
    latitude, longitude, _ = geodetic_from_ecef(position + np.einsum("nij,ni->nj", rotation[:, :2], off))
    craft = truth.aircraft
    quantum = craft.altitude_quantum_m[target]
    altitude = truth.atmosphere.pressure_m(height) + craft.altimetry_m[target]
    told, nothing = np.full(len(rows), np.nan), np.full(len(rows), -1)
    vertical = np.full(len(rows), math.nan if mlat.height_sd_m is None else mlat.height_sd_m)
    if mlat.height_sd_m is not None:
        told = np.rint((height + mlat.height_sd_m * error[:, 2]) / _HEIGHT_QUANTUM_M) * _HEIGHT_QUANTUM_M
    fixes = Fixes(
        time_s=truth.epoch_s + stamp,
        source=np.full(len(rows), mlat.sac << 8 | mlat.sic),
        channel=np.full(len(rows), Channel.MLAT),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=told,
        pressure_altitude_m=np.rint(altitude / quantum) * quantum,
        mode_s=craft.mode_s[target] if mlat.identity else nothing,
        mode_3a=craft.mode_3a[target] if mlat.identity else nothing,
        callsign=craft.callsign[target] if mlat.identity else nothing,
        track=numbers[target % 4095],
        horizontal_sd_m=sd,
        vertical_sd_m=vertical,
        flags=np.where(height - mlat.height_m < 5.0, int(Flag.GROUND), 0),
        record=np.arange(len(rows)),
    )
    return fixes, target


def _spells(seconds: FloatArray, every_s: float, lasts_s: float, rng: np.random.Generator) -> BoolArray:
    """Which times (n,) lie in spells of `lasts_s` on average, that begin `every_s` on average after the one before ended."""
    out = np.zeros(len(seconds), np.bool_)
    if not len(seconds) or not 0 < every_s < math.inf or lasts_s <= 0:
        return out
    share = lasts_s / (every_s + lasts_s)
    at = float(seconds[0]) - (rng.exponential(lasts_s) if rng.random() < share else -rng.exponential(every_s))
    while at <= seconds[-1]:
        end = at + rng.exponential(lasts_s)
        out |= (seconds >= at) & (seconds < end)
        at = end + rng.exponential(every_s)
    return out


def observe_rtk(truth: Truth, rtk: Rtk, rng: np.random.Generator) -> tuple[Fixes, IntArray]:
    """The positions of the receivers, one behind the other in time, and each one's target (n,).

    The track number is that of the receiver, from 1 on in the order of the targets; there is no identity, as in a receiver's own
    log.  The place is where the truth is (of a ship the middle of the hull).  Raises SettingsError as `check_rtk` does.
    """
    names = truth.names or ("",) * len(truth)
    check_rtk(rtk, names)
    carriers = [k for k, name in enumerate(names) if name and (not rtk.targets or name in rtk.targets)]
    parts: list[Fixes] = []
    for number, (k, own) in enumerate(zip(carriers, rng.spawn(len(carriers)), strict=True), 1):
        first, last = truth.epoch_s + float(truth.first_s[k]), truth.epoch_s + float(truth.last_s[k])
        # Whole milliseconds of the clock, as files hold them.
        stamp = np.arange(math.ceil(first / rtk.interval_s), math.floor(last / rtk.interval_s) + 1) * rtk.interval_s
        stamp = np.rint(stamp * 1000.0) / 1000.0
        stamp = stamp[(stamp >= first) & (stamp <= last)]
        seconds = stamp - truth.epoch_s
        error = _errors(len(stamp), rtk.interval_s, rtk.correlated, rtk.correlation_s, 3, own)
        white = own.normal(0.0, 1.0, error.shape)
        share = rtk.float_share
        loose = _spells(seconds, rtk.float_s * (1 - share) / share if share else 0.0, rtk.float_s, own)
        kept = ~_spells(seconds, rtk.gap_every_s, rtk.gap_s, own)
        sd = np.where(loose, rtk.float_sd_m, rtk.fixed_sd_m)
        motion = truth.motion(np.full(len(stamp), k), seconds, derivatives=1)
        latitude, longitude, _ = geodetic_from_ecef(motion.position)
        rotation = enu_from_ecef(latitude, longitude)
        error = error * sd[:, None] * [1.0, 1.0, 2.0]
        latitude, longitude, height = geodetic_from_ecef(motion.position + np.einsum("nij,ni->nj", rotation, error))
        velocity = rotate(rotation, motion.velocity) + rtk.velocity_sd_mps * white
        fixes = Fixes(
            time_s=stamp,
            latitude_rad=latitude,
            longitude_rad=longitude,
            height_m=height,
            velocity_east_mps=velocity[:, 0],
            velocity_north_mps=velocity[:, 1],
            velocity_up_mps=velocity[:, 2],
            track=np.full(len(stamp), number),
            horizontal_sd_m=sd,
            vertical_sd_m=2.0 * sd,
        )
        parts.append(fixes[kept])
    fixes = Fixes.concat(parts)
    order = np.argsort(fixes.time_s, kind="stable")
    fixes = fixes[order].replace(record=np.arange(len(order)))
    return fixes, np.array(carriers, np.int64)[fixes.track - 1]


_AIRLINES = ("IBE", "VLG", "RYR", "AFR", "DLH", "BAW", "EZY", "KLM", "SWR", "TAP")


def equip_aircraft(n: int, traffic: Traffic, adsb: Adsb | None, rng: np.random.Generator) -> Aircraft:
    """Addresses, codes, callsigns and equipment of `n` aircraft.  Exact shares of ADS-B and of its classes, in random order."""
    names = [
        f"{_AIRLINES[int(a)]}{int(b)}"
        for a, b in zip(rng.integers(0, len(_AIRLINES), n), rng.choice(9000, n, replace=False) + 1, strict=True)
    ]
    accuracy = np.full(n, -1, np.int64)
    latency, interval = np.zeros(n), np.full(n, 1.0)
    if adsb is not None:
        equipped = rng.permutation(n)[: round(adsb.share * n)]
        shares = np.array(list(adsb.classes.values()), np.float64)
        bounds = np.rint(np.cumsum(shares) / shares.sum() * len(equipped)).astype(np.int64)
        accuracy[equipped] = np.array([int(c) for c in adsb.classes])[
            np.searchsorted(bounds, np.arange(len(equipped)), side="right")
        ]
        latency = adsb.latency_mean_s + adsb.latency_sd_s * rng.normal(0.0, 1.0, n)
        interval = rng.uniform(*adsb.interval_s, n)
    return Aircraft(
        mode_s=rng.choice(0xEFFFFF, n, replace=False) + 1,
        mode_3a=rng.choice(0o6777, n, replace=False) + 1,
        callsign=pack_callsigns(names),
        length_m=rng.choice([28.0, 33.8, 37.6, 39.5, 44.5, 63.7, 73.9], n, p=[0.1, 0.15, 0.35, 0.2, 0.1, 0.07, 0.03]),
        transponder_delay_m=traffic.delay_sd_m * rng.normal(0.0, 1.0, n),
        altimetry_m=traffic.altimetry_sd_m * rng.normal(0.0, 1.0, n),
        altitude_quantum_m=np.where(rng.random(n) < 0.8, 25.0, 100.0) * 0.3048,
        accuracy=accuracy,
        latency_s=latency,
        interval_s=interval,
    )


def _wander(seconds: FloatArray, span_s: float, correlation_s: float, rng: np.random.Generator) -> FloatArray:
    """A Gauss-Markov process (n, 2) of unit variance at times (n,), between values every fortieth of its correlation time."""
    step = correlation_s / 40
    count = int(span_s / step) + 3
    keep = math.exp(-step / correlation_s)
    draws = rng.normal(0.0, 1.0, (count, 2))
    walk = np.empty((count, 2))
    walk[0] = draws[0]
    for k in range(1, count):
        walk[k] = keep * walk[k - 1] + math.sqrt(1 - keep * keep) * draws[k]
    grid = step * np.arange(count)
    return np.stack([np.interp(seconds, grid, walk[:, axis]) for axis in (0, 1)], axis=1)


def _without_gaps(seconds: FloatArray, span_s: float, adsb: Adsb, rng: np.random.Generator) -> BoolArray:
    """Which times lie in no gap."""
    count = int(rng.poisson(span_s / adsb.gap_every_s)) if adsb.gap_every_s > 0 else 0
    begin = rng.uniform(0.0, max(span_s, 1e-9), count)
    length = rng.exponential(max(adsb.gap_s, 1e-9), count)
    kept = np.ones(len(seconds), np.bool_)
    for b, duration in zip(begin, length, strict=True):
        kept &= (seconds < b) | (seconds > b + duration)
    return kept


def observe_adsb(truth: Truth, adsb: Adsb, rng: np.random.Generator) -> tuple[Fixes, IntArray]:
    """The reports of all aircraft that have ADS-B, in the order of their stamps, and each report's target (n,)."""
    targets: list[IntArray] = []
    stamps: list[FloatArray] = []
    errors: list[FloatArray] = []
    craft = truth.aircraft
    for k, own in enumerate(rng.spawn(truth.flights)):
        span = float(truth.last_s[k] - truth.first_s[k])
        if craft.accuracy[k] < 0 or span < 2.0:
            continue
        mean = float(craft.interval_s[k])
        stamp = truth.first_s[k] + np.cumsum(mean * own.uniform(0.9, 1.1, int(span / (0.9 * mean)) + 1))
        stamp = rounded(truth.epoch_s + stamp, adsb.time_quantum_s) - truth.epoch_s
        applies = stamp - craft.latency_s[k]
        kept = (own.random(len(stamp)) >= adsb.loss) & _without_gaps(stamp - truth.first_s[k], span, adsb, own)
        wander = _wander(stamp - truth.first_s[k], span + 2.0, adsb.correlation_s, own)
        white = own.normal(0.0, 1.0, (len(stamp), 6))
        error = np.empty((len(stamp), 6))
        sd = float(accuracy_sd_m(craft.accuracy[k : k + 1])[0])
        error[:, :2] = sd * (math.sqrt(adsb.correlated) * wander + math.sqrt(1 - adsb.correlated) * white[:, :2])
        error[:, 2] = adsb.height_sd_m * white[:, 2]
        error[:, 3:] = adsb.velocity_sd_mps * white[:, 3:]
        kept &= (applies >= truth.first_s[k]) & (applies <= truth.last_s[k])
        targets.append(np.full(np.count_nonzero(kept), k, np.int64))
        stamps.append(stamp[kept])
        errors.append(error[kept])
    if not targets:
        return Fixes(), np.empty(0, np.int64)
    target, stamp, error = np.concatenate(targets), np.concatenate(stamps), np.concatenate(errors)
    order = np.argsort(stamp, kind="stable")
    target, stamp, error = target[order], stamp[order], error[order]

    motion = truth.motion(target, stamp - craft.latency_s[target], derivatives=1)
    latitude, longitude, height = geodetic_from_ecef(motion.position)
    rotation = enu_from_ecef(latitude, longitude)
    shifted = motion.position + np.einsum("nij,ni->nj", rotation[:, :2], error[:, :2])
    velocity = rotate(rotation, motion.velocity) + error[:, 3:]
    quantum = craft.altitude_quantum_m[target]
    altitude = truth.atmosphere.pressure_m(height) + craft.altimetry_m[target]
    latitude, longitude, _ = geodetic_from_ecef(shifted)
    known, nobody = adsb.identity, np.full(len(target), -1)
    accuracy = craft.accuracy[target]
    fixes = Fixes(
        time_s=truth.epoch_s + stamp,
        source=np.full(len(target), adsb.sac << 8 | adsb.sic),
        channel=np.full(len(target), Channel.ADS_B),
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=np.rint((height + error[:, 2]) / _HEIGHT_QUANTUM_M) * _HEIGHT_QUANTUM_M,
        pressure_altitude_m=np.rint(altitude / quantum) * quantum,
        velocity_east_mps=velocity[:, 0],
        velocity_north_mps=velocity[:, 1],
        velocity_up_mps=velocity[:, 2],
        mode_s=craft.mode_s[target] if known else nobody,
        mode_3a=craft.mode_3a[target] if known else nobody,
        callsign=craft.callsign[target] if known else nobody,
        track=rng.permutation(4095)[target] + 1,
        horizontal_sd_m=accuracy_sd_m(accuracy),
        vertical_sd_m=np.full(len(target), adsb.height_sd_m),
        flags=np.full(len(target), int(Flag.TIME_OF_RECEPTION)),
        record=np.arange(len(target)),
    )
    return fixes, target


def observe_ais(truth: Truth, ais: Ais, rng: np.random.Generator) -> AisLog:
    """The reports and static data of all ships, each in the order of sending."""
    ships = truth.ships
    targets: list[IntArray] = []
    applies: list[FloatArray] = []
    sent: list[FloatArray] = []
    errors: list[FloatArray] = []
    told: list[tuple[FloatArray, IntArray]] = []
    for k, own in enumerate(rng.spawn(len(ships))):
        target = truth.flights + k
        span = float(truth.last_s[target] - truth.first_s[target])
        grid = truth.first_s[target] + np.arange(0.0, span, STEP_S)
        motion = truth.motion(np.full(len(grid), target), grid, derivatives=2)
        speed = np.sqrt(np.einsum("ij,ij->i", motion.velocity, motion.velocity)) / KNOT_MPS
        # Turning: more than 5 degrees in 30 seconds, as the standard has it.
        course = np.unwrap(truth.course_rad(motion.position, motion.velocity))
        turned = np.abs(course - course[np.maximum(np.arange(len(grid)) - 30, 0)]) > math.radians(5.0)
        every = np.where(speed > 23.0, 2.0, np.where(speed > 14.0, 6.0, 10.0)) / np.where(turned & (speed <= 23.0), 3.0, 1.0)
        every = np.where(speed <= 3.0, 180.0, 30.0 if ships.class_b[k] else every)
        when: list[float] = []
        now = float(own.uniform(0.0, every[0])) if len(grid) else span
        while now < span - 1.0:
            when.append(now)
            # Slots are taken within a tenth of the interval about the nominal time.
            now += float(every[int(now)]) * (0.9 + 0.2 * own.random())
        going_out = truth.epoch_s + truth.first_s[target] + np.array(when)
        # The receiver's last fix on a whole second.
        fix = np.floor(going_out - own.uniform(0.1, 0.9, len(when)))
        kept = own.random(len(when)) >= ais.loss
        at = fix - ships.latency_s[k] - truth.epoch_s
        kept &= (at >= truth.first_s[target]) & (at <= truth.last_s[target])
        wander = _wander(at[kept] - truth.first_s[target], span + 2.0, ais.correlation_s, own)
        white = own.normal(0.0, 1.0, (len(wander), 2))
        errors.append(ships.position_sd_m[k] * (math.sqrt(ais.correlated) * wander + math.sqrt(1 - ais.correlated) * white))
        targets.append(np.full(len(wander), target, np.int64))
        applies.append(fix[kept])
        sent.append(going_out[kept])
        static = truth.epoch_s + truth.first_s[target] + np.arange(float(own.uniform(0.0, ais.static_s)), span, ais.static_s)
        told.append((static, np.full(len(static), k, np.int64)))
    out = np.concatenate([np.empty(0), *sent])
    order = np.argsort(out, kind="stable")
    out, fix = out[order], np.concatenate([np.empty(0), *applies])[order]
    whose = np.concatenate([np.empty(0, np.int64), *targets])[order]
    error = np.concatenate([np.empty((0, 2)), *errors])[order]
    row = whose - truth.flights

    seconds = fix - ships.latency_s[row] - truth.epoch_s
    motion = truth.motion(whose, seconds, derivatives=1)
    latitude, longitude, _ = geodetic_from_ecef(motion.position)
    rotation = enu_from_ecef(latitude, longitude)
    heading = truth.heading_rad(whose, seconds, motion)
    # The antenna stands ahead of the middle of the hull by `ahead`, and right of it by `right`.
    ahead, right = ships.length_m[row] / 2 - ships.bow_m[row], ships.port_m[row] - ships.width_m[row] / 2
    east = ahead * np.sin(heading) + right * np.cos(heading) + error[:, 0]
    north = ahead * np.cos(heading) - right * np.sin(heading) + error[:, 1]
    antenna = motion.position + east[:, None] * rotation[:, 0] + north[:, None] * rotation[:, 1]
    latitude, longitude, _ = geodetic_from_ecef(antenna)
    velocity = rotate(rotation, motion.velocity)
    positions = AisPositions(
        sent_s=np.asarray(out, np.float64),
        mmsi=ships.mmsi[row],
        class_b=ships.class_b[row],
        latitude_rad=latitude,
        longitude_rad=longitude,
        speed_mps=np.hypot(velocity[:, 0], velocity[:, 1]),
        course_rad=np.arctan2(velocity[:, 0], velocity[:, 1]),
        heading_rad=np.where(ships.class_b[row], np.nan, heading + ships.gyro_rad[row]),
        second=np.asarray(fix % 60, np.int64),
        accurate=ships.position_sd_m[row] < 3.0,
    )
    when_told = np.concatenate([np.empty(0), *(t for t, _ in told)])
    order = np.argsort(when_told, kind="stable")
    row = np.concatenate([np.empty(0, np.int64), *(k for _, k in told)])[order]
    statics = AisStatics(
        sent_s=np.asarray(when_told[order], np.float64),
        mmsi=ships.mmsi[row],
        class_b=ships.class_b[row],
        callsign=ships.callsign[row],
        ship_type=ships.ship_type[row],
        bow_m=ships.bow_m[row],
        stern_m=ships.length_m[row] - ships.bow_m[row],
        port_m=ships.port_m[row],
        starboard_m=ships.width_m[row] - ships.port_m[row],
    )
    return AisLog(positions, whose, statics)
