"""Peak memory of a call, as the operating system sees it.

Memory of torch, of CHOLMOD and of igl is not Python's, so no tracer of Python's allocations knows it; and the largest
size of a process since its start says nothing of a call that comes late. Linux can forget that largest size (writing 5
to /proc/self/clear_refs), so that afterwards it is the largest since then:

    peak memory  =  largest resident memory during the call  -  resident memory before it

What the process holds but does not use would be taken again unseen (a second smoothing seemed to need nothing), so it
is given back before: Python's cycles, and the free memory of glibc, whose allocator torch and numpy use too. The same
call then differs by some 5 % from one time to the next, and the first of a process also counts the libraries that it
loads. The number is of the whole process: where two calls are watched at once, as in a pool of threads, neither is
known.
"""

from __future__ import annotations

import ctypes
import gc
import re
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import TypeVar

T = TypeVar("T")

STATUS = Path("/proc/self/status")
FORGET = Path("/proc/self/clear_refs")

_lock = Lock()
_watched: list[_Watch] = []


class _Watch:
    alone = True


def with_peak_memory(call: Callable[[], T]) -> tuple[T, float | None]:
    """Return the result of a call and its peak memory in megabytes (1e6 bytes).

    The second is None where it cannot be known: not on Linux, or when another call was watched meanwhile.
    """
    watch = _Watch()
    with _lock:
        _watched.append(watch)
        if len(_watched) > 1:
            for other in _watched:
                other.alone = False
        before = _forget_largest()
    try:
        result = call()
        largest = None if before is None else _megabytes("VmHWM")
    finally:
        with _lock:
            _watched.remove(watch)
    if before is None or largest is None or not watch.alone:
        return result, None
    return result, max(largest - before, 0.0)


def _forget_largest() -> float | None:
    """Make the largest resident memory the present one, and return that; None where the system cannot."""
    if not FORGET.exists():
        return None
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc has it, musl not
    if trim is not None:
        trim(0)
    try:
        FORGET.write_text("5")
    except OSError:
        return None
    return _megabytes("VmRSS")


def _megabytes(name: str) -> float | None:
    found = re.search(rf"^{name}:\s+(\d+) kB$", STATUS.read_text(), flags=re.MULTILINE)
    return None if found is None else int(found[1]) * 1024 / 1e6
