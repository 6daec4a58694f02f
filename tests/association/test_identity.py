"""Identities of tracks and targets, against plain counting."""

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from boresight.association import identity
from boresight.model import Fixes, Plots, pack_callsigns


@settings(max_examples=80, deadline=None)
@given(st.lists(st.lists(st.integers(-1, 4), min_size=1, max_size=12), min_size=1, max_size=8))
def test_modal_is_the_commonest_value(groups):
    """Against Counter; of equally common values the smallest, -1 never counts."""
    start = np.r_[0, np.cumsum([len(g) for g in groups])]
    found = identity.modal(np.concatenate([np.array(g) for g in groups]), start)
    for value, group in zip(found, groups, strict=True):
        count = Counter(v for v in group if v >= 0)
        assert value == (min(count, key=lambda v: (-count[v], v)) if count else -1)


def test_shared_codes_are_not_an_identity():
    """Conspicuity, emergency and non-discrete codes belong to nobody; -1 is no code."""
    shared = [0o1000, 0o2000, 0o7000, 0o7500, 0o7600, 0o7700, 0o4700, 0, -1, 0o7777]
    assert not identity.is_discrete(np.array(shared)).any()
    assert identity.is_discrete(np.array([0o1234, 0o4521, 0o0363])).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000))
def test_links_and_conflicts_are_the_naive_comparison(seed):
    """All pairs by two loops: linked by the most trusted kind that agrees, in conflict where addresses or MMSI differ."""
    rng = np.random.default_rng(seed)
    tracks, targets = identity.Names(rng.integers(-1, 5, (4, 9))), identity.Names(rng.integers(-1, 5, (4, 6)))
    compatible = rng.random((9, 6)) < 0.8
    found = identity.links(tracks, targets, compatible)
    got = {(i, j): k for i, j, k in zip(found.track.tolist(), found.target.tolist(), found.kind.tolist(), strict=True)}
    conflict = identity.conflict(tracks, targets)
    want = {}
    for i in range(9):
        for j in range(6):
            a, b = tracks.value[:, i], targets.value[:, j]
            agree = [k for k in range(4) if a[k] >= 0 and a[k] == b[k]]
            if agree and compatible[i, j]:
                want[i, j] = agree[0]
            assert conflict[i, j] == any(a[k] >= 0 and b[k] >= 0 and a[k] != b[k] for k in (0, 1))
    assert got == want


def test_names_of_tables():
    """Every kind of identity is read from plots and fixes; fixes of no target, and targets without fixes, are harmless."""
    plots = Plots(
        time_s=np.arange(4.0), mode_s=[7, 7, -1, -1], mode_3a=[0o1234, 0o1234, 0o7000, 0o7000],
        callsign=pack_callsigns(["ABC1", "ABC1", "", "XYZ"]), mmsi=[-1, -1, 211, 211],
    )  # fmt: skip
    names = identity.names_of(plots, np.arange(4), np.array([0, 2, 4]))
    assert names.value.tolist() == [[7, -1], [-1, 211], pack_callsigns(["ABC1", "XYZ"]).tolist(), [0o1234, -1]]
    fixes = Fixes(time_s=np.arange(4.0), mode_s=[9, 9, 8, 5])
    found = identity.names_of_targets(fixes, np.array([0, 0, 2, -1]))
    assert found.value[0].tolist() == [9, -1, 8]
