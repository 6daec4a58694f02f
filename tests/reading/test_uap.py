"""The category tables: what is written there hangs together (what it says is compared with libasterix in tests/oracles)."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from boresight.model import Fixes, Plots, Tracks
from boresight.reading import uap
from boresight.reading.asterix import _slots, _spec_row

TABLES = [(c, e) for c in uap.categories() for e in uap.editions_of(c)] + [(256, "1.x")]
# Names that `asterix` combines into columns.
COMBINED = {
    "orientation", "speed", "course", "vx", "vy", "sd_x", "sd_y", "nacp", "gva", "version", "length_width", "time_bound",
    "sd_latitude", "sd_longitude", *(f"age_{name}" for name in uap.AGES),
}  # fmt: skip


@pytest.mark.parametrize(("category", "edition"), TABLES)
def test_fields_lie_within_their_items_and_do_not_overlap(category: int, edition: str) -> None:
    for item in uap.items_of(category, edition):
        if item is None:
            continue
        for one in [item, *(s for s in item.subitems if s is not None)]:
            taken = np.zeros(8 * 64, bool)
            for f in one.fields:
                bits = slice(f.bit, f.bit + f.bits)
                assert not taken[bits].any(), f"{category}/{one.name}.{f.name}"
                taken[bits] = True
                if one.kind in (uap.FIXED, uap.REPETITIVE):
                    assert f.bit + f.bits <= 8 * one.size
            if one.kind == uap.EXTENDED and not one.most:
                # The last bit of each part is FX.
                assert not taken[8 * one.size - 1 :: 8 * one.step].any(), f"{category}/{one.name}"


@pytest.mark.parametrize(("category", "edition"), TABLES)
def test_every_column_comes_from_a_field_that_exists_and_goes_to_a_column_that_exists(category: int, edition: str) -> None:
    family = uap.family(category, edition)
    plots = uap.PLOTS.get(category)
    fixes = uap.FIXES.get((category, family))
    for columns, table in ((plots, Plots), (fixes, Fixes), (uap.TRACKS.get(category), Tracks)):
        if columns is None:
            continue
        names = {f.name for f in fields(table)}
        for name, text in columns.columns.items():
            assert name in names | COMBINED
            for choice in text.split(" | "):
                row, scale = _spec_row(category, edition, choice, 0, 0)
                assert len(row) == 14
                assert scale > 0
        assert set(columns.needs) <= set(_slots(category, edition))
    for text, _, _ in uap.FLAGS.get((category, family), ()):
        _spec_row(category, edition, text, 2, 0)
    assert (category, family) in uap.TIMES


def test_the_grammar_is_strict() -> None:
    with pytest.raises(ValueError, match="no field"):
        uap._fields(["RHO:16*1/256parsec"], uap.FIXED)
    with pytest.raises(ValueError, match="do not fill bytes"):
        uap._fields(["RHO:15"], uap.FIXED)


def test_accuracy_classes_are_those_of_the_standard() -> None:
    """METHODS section 6: sd per axis for NACp 8 to 11 is 37.8, 12.3, 4.1 and 1.2 m."""
    np.testing.assert_allclose(np.array(uap.EPU_M[8:12]) / 2.448, [37.8, 12.3, 4.1, 1.2], atol=0.06)
