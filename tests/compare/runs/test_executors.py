"""Where a study runs changes nothing but its times; what becomes of a worker that is killed."""

import json
import os
import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

import implicit
import implicit.shapes
from compare import Case, HandleSpec, Workers, run_cases
from compare.errors import InputError
from compare.runs.executors import WorkerDiedError, dask_executor, executor_of
from compare.runs.records import read

TOP = HandleSpec(
    {"kind": "halfspace", "point": [0, 0.4, 0], "normal": [0, 1, 0]}, {"kind": "vector", "vector": [0.1, 0, 0]}
)
FOOT = HandleSpec(
    {"kind": "halfspace", "point": [0, -0.4, 0], "normal": [0, -1, 0]}, {"kind": "vector", "vector": [0, 0, 0]}
)


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Two cases on two subjects, each at little cost."""
    path = tmp_path_factory.mktemp("shapes") / "ball.safetensors"
    implicit.save_field(implicit.shapes.sphere(0.6), path)
    return [
        Case(str(path), "geometric", (FOOT, TOP), {"implicit": {"steps": 1, "points": points}}, vertices, 16)
        for vertices, points in ((150, 60), (200, 60))
    ]


ONE_PROCESS = """
import json, sys, torch
from compare import Case, run_cases
torch.set_num_threads(1)  # as workers have: sums over several threads differ in their last digits
run_cases([Case.from_dict(row) for row in json.load(sys.stdin)], folder=sys.argv[1])
"""


@pytest.fixture(scope="module")
def in_process(cases, tmp_path_factory):
    """What the cases give in one process, one after another.

    In a fresh one: where the memory of arrays begins decides last digits, and that of the tests has a history.
    """
    folder = tmp_path_factory.mktemp("here")
    rows = json.dumps([case.to_dict() for case in cases])
    subprocess.run([sys.executable, "-c", ONE_PROCESS, folder], input=rows, text=True, check=True)
    return read(folder)


def without_times(record):
    """All of a record but what it cost and its origin; the hashes of its files are left in."""

    def strip(value):
        if isinstance(value, dict):
            kept = (key for key in value if not key.startswith(("seconds", "peak_memory", "provenance")))
            return {key: strip(value[key]) for key in kept}
        return [strip(item) for item in value] if isinstance(value, list) else value

    return strip(record.to_dict())


def assert_complete_and_equal(records, in_process, folder):
    assert [record.status for record in records if record.failed] == []
    assert [without_times(record) for record in records] == [without_times(record) for record in in_process]
    assert sorted(record.key for record in read(folder)) == sorted(record.key for record in in_process)


@pytest.mark.nightly
def test_two_processes_give_what_one_gives_even_if_one_is_killed(cases, in_process, tmp_path):
    killed = []
    with Workers(2) as workers:

        def kill_one(_):
            if not killed:
                killed.append(active_children()[0].pid)
                os.kill(killed[0], signal.SIGKILL)

        records = run_cases(cases, workers, folder=tmp_path, on_record=kill_one)
    assert killed
    assert_complete_and_equal(records, in_process, tmp_path)
    assert {record.provenance["threads"] for record in records} == {1}


@pytest.mark.nightly
# What distributed itself leaves behind when one of its workers is killed under it.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_dask_cluster_gives_what_one_process_gives_even_if_a_worker_is_killed(cases, in_process, tmp_path):
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    killed = []
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs="CRITICAL"
    ) as cluster:
        address = cluster.scheduler_address

        def kill_one(_):
            if not killed:
                with distributed.Client(address, set_as_default=False) as client:
                    killed.append(min(client.run(os.getpid).values()))
                os.kill(killed[0], signal.SIGKILL)

        with dask_executor(address) as executor:
            records = run_cases(cases, executor, folder=tmp_path, on_record=kill_one)
    assert killed
    assert_complete_and_equal(records, in_process, tmp_path)


# As text, for the processes cannot import this file.
DIE = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
DIE_ONCE = f"""
import pathlib
if not pathlib.Path(flag).exists():
    pathlib.Path(flag).touch()
    {DIE}
"""


def test_a_task_whose_process_is_killed_is_done_by_a_fresh_one_and_gives_up_in_the_end(tmp_path):
    flag = tmp_path / "flag"
    with Workers(1) as workers:
        assert workers.submit(exec, DIE_ONCE, {"flag": str(flag)}).result() is None
        assert flag.exists()
        with pytest.raises(WorkerDiedError, match="2 times; the last exit code was -9"):
            workers.submit(exec, DIE).result()
        assert workers.submit(len, "abc").result() == 3


def test_what_a_task_raises_is_raised_here(tmp_path):
    """An OSError too, which is also what a broken pipe would raise."""
    with Workers(1) as workers:
        with pytest.raises(FileNotFoundError):
            workers.submit(Path.read_bytes, tmp_path / "gone").result()
        (child,) = active_children()
        assert workers.submit(os.getpid).result() == child.pid, "the process was taken for dead"


def test_an_interruption_ends_the_processes_at_once():
    workers = Workers(1)
    pid = workers.submit(os.getpid).result()
    futures = [workers.submit(time.sleep, 1000) for _ in range(3)]

    def interrupted():
        with workers:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert all(future.done() for future in futures)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": -1}, "0 .this process. or more"),
        ({"workers": 2, "dask": "tcp://127.0.0.1:1"}, "Name one"),
    ],
)
def test_a_place_that_cannot_be_had_is_refused(options, message):
    with pytest.raises(InputError, match=message), executor_of(**options):
        pass


def test_neither_workers_nor_dask_is_this_process():
    with executor_of() as executor:
        assert executor is None
