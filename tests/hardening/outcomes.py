"""Run the cases of a module, bad_implicit.py for one, in processes of their own, and collect how they end.

No bad input may crash the interpreter, hang, or get an answer, and every refusal must name the argument and a remedy. A
module is a test file, so that they run side by side.
"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

HERE = Path(__file__).parent
SECONDS_TO_START, SECONDS_A_CASE = 120, 60


def outcomes(module):
    """The name of each case, and why it failed, or None; crashes and hangs are failures like others."""
    found = []
    while True:
        rest = _rest_of(module, len(found))
        found += rest
        if not rest or rest[-1][0] is None:
            return [(name, failure) for name, failure in found if name is not None]


def _rest_of(module, first):
    """The outcomes from one case on, up to a crash or hang; a name of None stands for the end."""
    found, current = [], None
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, str(HERE / "worker.py"), module, str(first)],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "IGL_NUM_THREADS": "1"},
        )
        with process:
            lines = _lines_of(process)
            while (line := lines(SECONDS_A_CASE if found or current else SECONDS_TO_START)) is not None:
                told = json.loads(line)
                if "done" in told:
                    return [*found, (None, None)]
                current = told.get("begin")
                if "end" in told:
                    found.append((told["end"], told["failure"]))
            hung = process.poll() is None
            process.kill()
        errors.seek(0)
        last_words = errors.read().decode(errors="replace")[-800:]
    assert current is not None, f"the worker of {module} ended between two cases: {last_words}"
    why = f"no answer in {SECONDS_A_CASE} s" if hung else f"the interpreter died ({process.returncode}): {last_words}"
    return [*found, (current, why)]


def _lines_of(process):
    """A function that waits so many seconds for the next line; None if none comes, or no more will."""
    waiting = queue.Queue()

    def read():
        for line in process.stdout:
            waiting.put(line)
        process.wait()
        waiting.put(None)

    threading.Thread(target=read, daemon=True).start()

    def next_line(seconds):
        try:
            return waiting.get(timeout=seconds)
        except queue.Empty:
            return None

    return next_line


def assert_all_refused(module):
    """Run a module's cases, and fail with the list of those that were not refused in a sentence that names them."""
    found = outcomes(module)
    failures = [f"{name}\n    {failure}" for name, failure in found if failure is not None]
    assert found
    assert not failures, f"{len(failures)} of {len(found)}:\n" + "\n".join(failures)
