"""Settings for all tests: examples that do not change, arrays held to their annotations, and the slowest files first.

xdist hands files out in the order in which they stand, so the order is that of the processor seconds they took when
`pytest --measure` wrote them down in slow_tests.json: a long file that came last would leave the other processes idle.
Tests of more than SLOW seconds bear the marker of that name: `pytest` leaves them out, `pytest -m slow` runs them
alone, and `pytest -m ""` all. What is marked nightly shows at full size, or on one more example, what others show
smaller; it runs with IMPLICIT_VS_MESH_NIGHTLY=full.
"""

import json
import os
import resource
from collections import Counter
from pathlib import Path

import annotation_check
import pytest
from hypothesis import settings

SLOW = 4.0  # processor seconds of a test function with all its parameters
WORTH_NOTING = 1.0
SECONDS_FILE = Path(__file__).with_name("slow_tests.json")

# OpenMP reads it when torch is imported; see compare.commands.cli.main.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if "PYTEST_XDIST_WORKER" in os.environ:  # there is a process a core already
    os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")

# Before the first import of any of them; see annotation_check.py.
annotation_check.hold(["implicit", "meshref", "compare"])

_measured: Counter[str] = Counter()
_BEFORE = pytest.StashKey[float]()
_SECONDS = "processor seconds"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --measure."""
    parser.addoption("--measure", action="store_true", help=f"write the seconds of slow tests to {SECONDS_FILE.name}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is slow, skip what is nightly, and put the files that took longest first."""
    seconds = json.loads(SECONDS_FILE.read_text())
    of_file: Counter[str] = Counter()
    for test, took in seconds.items():
        of_file[test.split("::")[0]] += took
    nightly = os.environ.get("IMPLICIT_VS_MESH_NIGHTLY") == "full"
    for item in items:
        if not nightly and item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.skip(reason="nightly: IMPLICIT_VS_MESH_NIGHTLY=full runs it"))
        if seconds.get(_function(item.nodeid), 0.0) > SLOW:
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: -of_file[item.nodeid.split("::")[0]])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Begin to check annotations, and to count the processor seconds of a test, its fixtures and child processes."""
    annotation_check.begin_test()
    item.stash[_BEFORE] = _processor_seconds()


def pytest_runtest_teardown(item: pytest.Item) -> None:
    """Pass them on with the report of the end of the test."""
    item.user_properties.append((_SECONDS, _processor_seconds() - item.stash[_BEFORE]))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add them up where the reports of all processes arrive."""
    if report.when == "teardown":
        _measured[_function(report.nodeid)] += dict(report.user_properties).get(_SECONDS, 0.0)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write them down, if asked for."""
    if session.config.getoption("measure") and "PYTEST_XDIST_WORKER" not in os.environ:
        worth = {test: round(took, 1) for test, took in _measured.most_common() if took >= WORTH_NOTING}
        SECONDS_FILE.write_text(json.dumps(worth, indent=1) + "\n")


def _function(nodeid: str) -> str:
    """Return the name of a test without its parameters."""
    return nodeid.split("[")[0]


def _processor_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)
