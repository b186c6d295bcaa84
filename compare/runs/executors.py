"""Executors for the cases of a study: processes of this machine or a dask cluster (concurrent.futures).

    Workers(n)              n fresh processes with one thread each; one that dies costs no other its case
    dask_executor(address)  the workers of a running dask scheduler

The standard ProcessPoolExecutor ends as a whole when one of its processes is killed (for want of memory, say), and does
not tell which case it was. Here each process has its own pipe, so the case is known: it is given to a fresh process,
and fails alone if that one dies too.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any

from compare.errors import InputError

ATTEMPTS = 2  # processes that a task may lose before it fails
CONNECT_SECONDS = 10.0  # to reach a scheduler

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_ENVIRONMENT = threading.Lock()


class WorkerDiedError(RuntimeError):
    """The process that did the task was killed, or crashed, as did the ones that tried again."""


class Workers(Executor):
    """Processes that each do one task at a time, in one thread, and are replaced when they die.

    Args:
        workers: How many. Each imports torch, 400 MB.
        attempts: How many processes a task may cost before it fails with WorkerDiedError.

    Leaving the context waits for what was submitted; after an exception, KeyboardInterrupt among them, the processes
    are ended at once. They also end by themselves when this process is gone.
    """

    def __init__(self, workers: int, *, attempts: int = ATTEMPTS) -> None:
        if workers < 1 or attempts < 1:
            raise ValueError(f"workers and attempts must be at least 1, but are {workers} and {attempts}.")
        self.attempts = attempts
        self._stopped = False
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="worker")
        self._idle: SimpleQueue[_Worker | None] = SimpleQueue()  # None: a place whose process is not started
        self._started: list[_Worker] = []
        for _ in range(workers):
            self._idle.put(None)

    def submit(self, task: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Do a task in one of the processes. It, its arguments and its result must be picklable."""
        return self._threads.submit(self._do, task, args, options)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; the processes end with the last one."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for worker in self._started:
                worker.end()

    def stop(self) -> None:
        """End all processes now, in the middle of what they do."""
        self._stopped = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._started:
            worker.kill()
        self.shutdown()

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if kind is None:
            self.shutdown()
        else:
            self.stop()

    def _do(self, task: Callable[..., Any], args: tuple[Any, ...], options: dict[str, Any]) -> Any:
        content = pickle.dumps((task, args, options))
        worker = self._idle.get()
        try:
            for _ in range(self.attempts):
                worker = worker or self._start()
                try:
                    done, value = worker.ask(content)
                    break
                except (EOFError, OSError):  # the other end of the pipe is gone
                    worker.kill()
                    code, worker = worker.exit_code, None
            else:
                raise WorkerDiedError(
                    f"The process that did it was ended from outside, or crashed, {self.attempts} times; the last exit "
                    f"code was {code}. Minus a number is a signal: -9 is often a want of memory, for which take fewer "
                    "workers."
                )
        finally:
            self._idle.put(worker)
        if not done:
            raise value
        return value

    def _start(self) -> _Worker:
        worker = _Worker()
        self._started.append(worker)
        if self._stopped:  # stop() has ended those before, and may not have seen this one
            worker.kill()
            raise WorkerDiedError("The processes were ended before the task was done.")
        return worker


class _Worker:
    """One process and the pipe to it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")  # torch must not be forked
        self._pipe, other = context.Pipe()
        self._process: BaseProcess = context.Process(target=_serve, args=(other,), daemon=True)
        with _one_thread():
            self._process.start()
        other.close()  # the process has it now, and only the process: when it dies, this end says so

    @property
    def exit_code(self) -> int | None:
        return self._process.exitcode

    def ask(self, content: bytes) -> tuple[bool, Any]:
        """Do the pickled task: whether it was done, and its result, or else its exception.

        Raises:
            EOFError, OSError: The process is dead.
        """
        self._pipe.send_bytes(content)
        answer = self._pipe.recv_bytes()
        return pickle.loads(answer)  # of a child of this process, over a pipe that no other has

    def end(self) -> None:
        """Let it go when it is done."""
        self._pipe.close()
        self._process.join()

    def kill(self) -> None:
        self._process.kill()
        self._process.join()


@contextmanager
def _one_thread() -> Iterator[None]:
    """For the moment in which a process starts and takes over the environment: numerical libraries read it once."""
    with _ENVIRONMENT:
        before = {name: os.environ.get(name) for name in THREADS}
        os.environ.update(dict.fromkeys(THREADS, "1"))
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _serve(pipe: Connection) -> None:
    """Serve as a worker process until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group, and the parent sees to the rest
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            content = pipe.recv_bytes()
        except EOFError:
            return
        try:
            task, args, options = pickle.loads(content)
            answer = pickle.dumps((True, task(*args, **options)))
        except Exception as error:
            answer = _pickled(error)
        pipe.send_bytes(answer)


def _pickled(error: Exception) -> bytes:
    try:
        content = pickle.dumps((False, error))
        pickle.loads(content)  # some exceptions can be written, but not read again
        return content
    except Exception:
        return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))


def _end_with_parent() -> None:
    """End with the parent, or workers would write on into a folder which a rerun takes over."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def executor_of(workers: int = 0, dask: str | None = None) -> Iterator[Executor | None]:
    """Yield what the options --workers and --dask ask for; None for neither, to work in this process.

    Raises:
        InputError: They cannot be had.
    """
    if workers < 0:
        raise InputError(f"--workers must be 0 (this process) or more, but is {workers}.")
    if workers and dask is not None:
        raise InputError("--workers and --dask are two places to run in. Name one.")
    if dask is not None:
        with dask_executor(dask) as executor:
            yield executor
    elif workers:
        with Workers(workers) as executor:
            yield executor
    else:
        yield None


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Yield the workers of a dask cluster. They must see the same files as this process, under the same paths.

    Args:
        address: Of the scheduler, such as tcp://host:8786. A Client itself is no Executor.

    Raises:
        InputError: distributed is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError('--dask needs distributed. Install it: pip install ".[dask]".') from error
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No dask scheduler answers at {address} ({error}). Start one with `dask scheduler` and name what it says, "
            "such as tcp://127.0.0.1:8786."
        ) from error
    with client:
        # Not pure: a task writes files, and what it gives depends on their content.
        yield client.get_executor(pure=False)
