"""What a call needs at its peak is seen, whichever library takes it and whether or not it gives it back."""

import sys
import threading

import numpy as np
import pytest
import torch

from compare.runs import memory
from compare.runs.memory import with_peak_memory

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the peak can be forgotten on Linux alone")

LARGE = 25_000_000  # numbers of 8 bytes: 200 MB, which every allocator gives back at once


@pytest.mark.parametrize("allocate", [np.ones, lambda n: torch.ones(n, dtype=torch.float64)], ids=["numpy", "torch"])
def test_memory_that_is_given_back_within_the_call_counts(allocate):
    total, peak = with_peak_memory(lambda: float(allocate(LARGE)[0]))
    assert total == 1
    assert peak == pytest.approx(200, abs=10)


def test_the_largest_of_two_counts_and_not_their_sum():
    _, peak = with_peak_memory(lambda: [float(np.ones(n)[0]) for n in (LARGE, LARGE // 2)])
    assert peak == pytest.approx(200, abs=10)


def test_a_peak_before_the_call_does_not_count():
    np.ones(LARGE)
    _, peak = with_peak_memory(lambda: None)
    assert peak < 10


def test_what_an_earlier_call_left_free_is_counted_when_it_is_taken_again():
    """Small blocks below one that is kept stay with the allocator when they are freed, and a second call takes them."""

    def many_small():
        return [np.ones(1000) for _ in range(12_500)][-1]

    kept, peaks = zip(*(with_peak_memory(many_small) for _ in range(3)), strict=True)
    assert len(kept) == 3
    assert peaks == pytest.approx([100] * 3, abs=10)


def test_two_calls_at_once_are_not_known():
    """Each waits for the other to have begun, so that they surely overlap; a later one is known again."""
    meet = threading.Barrier(2)
    found = []
    threads = [threading.Thread(target=lambda: found.append(with_peak_memory(meet.wait)[1])) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [None, None]
    assert with_peak_memory(lambda: None)[1] is not None


def test_where_the_system_cannot_forget_the_peak_it_is_not_known(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "FORGET", tmp_path / "clear_refs")
    assert with_peak_memory(lambda: 3) == (3, None)


def test_a_call_that_fails_leaves_nothing_behind():
    with pytest.raises(ZeroDivisionError):
        with_peak_memory(lambda: 1 / 0)
    assert with_peak_memory(lambda: None)[1] is not None
