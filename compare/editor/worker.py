"""The one thread that computes for a page, so that the page itself never waits.

Three kinds of work: a frame of a drag, of which only the newest counts; jobs, done in turn; and what is done when there
is nothing else. All of torch runs in this one thread, for its forward-mode derivatives stand no second one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition, Thread

Work = Callable[[], None]


class Worker:
    """A thread with a place for the newest frame, a queue of jobs, and one for idle times.

    Args:
        on_error: Called with what a piece of work raises; the thread goes on.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._frame: Work | None = None
        self._jobs: deque[Work] = deque()
        self._idle: deque[Work] = deque()
        self._busy = self._ended = False
        self._changed = Condition()
        self._thread = Thread(target=self._run, name="editor", daemon=True)
        self._thread.start()

    def show(self, frame: Work) -> None:
        """Do a frame next; one that waits already is dropped."""
        with self._changed:
            self._frame = frame
            self._changed.notify_all()

    def do(self, job: Work) -> None:
        """Do a job after those before it. Frames that wait are of the state before it, and dropped."""
        with self._changed:
            self._frame = None
            self._jobs.append(job)
            self._changed.notify_all()

    def when_idle(self, job: Work) -> None:
        """Do something when nothing else waits."""
        with self._changed:
            self._idle.append(job)
            self._changed.notify_all()

    @property
    def waiting(self) -> int:
        """Number of jobs that wait or are done now, without frames and what is done when idle."""
        with self._changed:
            return len(self._jobs) + self._busy

    def wait(self, seconds: float) -> bool:
        """Return whether all is done, once it is or the time is over."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._busy or self._jobs or self._idle or self._frame is not None), seconds
            )

    def stop(self) -> None:
        """End the thread once what it is at is done."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=60)

    def _next(self) -> Work | None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._ended or self._frame is not None or self._jobs or self._idle)
            if self._ended:
                return None
            self._busy = True
            if self._jobs:
                return self._jobs.popleft()
            if self._frame is not None:
                frame, self._frame = self._frame, None
                return frame
            return self._idle.popleft()

    def _run(self) -> None:
        while (work := self._next()) is not None:
            try:
                work()
            except Exception as error:
                self._on_error(error)
