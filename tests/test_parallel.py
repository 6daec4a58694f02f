"""Work in threads: order, errors, and how it is cut."""

import threading

import pytest

from boresight import _parallel


@pytest.mark.parametrize("count", [1, 2, 3])
def test_results_come_in_the_order_of_the_pieces(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(_parallel, "threads", lambda: count)
    late = threading.Event()

    def work(k: int) -> int:
        # The first piece waits for a later one, where there is another thread to do it.
        if k == 0 and count > 1:
            assert late.wait(10)
        if k == 1:
            late.set()
        return k * k

    assert _parallel.in_threads(work, range(20)) == [k * k for k in range(20)]


def test_the_first_error_is_raised() -> None:
    def work(k: int) -> None:
        if k >= 3:
            raise ValueError(k)

    with pytest.raises(ValueError, match="3"):
        _parallel.in_threads(work, range(10))


def test_slices_cover_all_rows_once() -> None:
    for n in (0, 1, 5, 10, 11):
        assert [k for part in _parallel.slices(n, 5) for k in range(n)[part]] == list(range(n))
