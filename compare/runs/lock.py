"""One run at a time in a folder: a lock that the system takes back when its holder is gone, however it ended."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from compare.errors import InputError

FILE = "running"  # in the folder while a run is on; holds its process id


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Keep others out of a folder that is there.

    Raises:
        InputError: Another process is at work there.
    """
    path = folder / FILE
    descriptor = _locked(path)
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, str(os.getpid()).encode())
        yield
    finally:
        path.unlink(missing_ok=True)  # before it is let go, so that nobody locks a file that is about to vanish
        os.close(descriptor)


def _locked(path: Path) -> int:
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(descriptor, 20, 0).decode() or "unknown"
            os.close(descriptor)
            raise InputError(
                f"The folder {path.parent} is in use by another run, process {holder}. Wait for it, end it, or name "
                "another folder."
            ) from None
        if _is(path, descriptor):
            return descriptor
        os.close(descriptor)  # the holder before removed the file between our opening and locking it


def _is(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
