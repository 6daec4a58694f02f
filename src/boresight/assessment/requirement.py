"""Conformity: what a result says about the figures of a requirement document: pass, fail or undecided."""

from __future__ import annotations

from typing import Literal

import msgspec

Outcome = Literal["pass", "fail", "undecided"]


class Conformity(msgspec.Struct, frozen=True, kw_only=True):
    """One figure of a requirement, judged for one sensor.

    `requirement` names the document with its edition, `clause` the place in it.  `limit`, `value` and the interval `low` … `high`
    are in `unit`; value and interval are NaN where the quantity was not determined.  `verdict` is "undecided" where the interval
    straddles the limit or there is no value; `why` says it in words.
    """

    requirement: str
    clause: str
    sensor: str
    quantity: str
    unit: str
    limit: float
    value: float
    low: float
    high: float
    verdict: Outcome
    why: str
