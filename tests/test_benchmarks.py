"""Each benchmark runs: asv shows one that is broken only to whoever runs asv."""

import importlib
import inspect
import json
import math
import numbers
from pathlib import Path

import pytest

import implicit

ROOT = Path(__file__).parent.parent
FILES = sorted(file.stem for file in (ROOT / "benchmarks").glob("[a-z]*.py"))
SCRIPTS = {
    "common",
    "diagram_page",
    "editor_pace",
    "editor_picture",
    "flat_memory",
    "flows_agree",
    "hard_meshes",
    "large_rigid",
    "pace",
    "pages",
    "side_by_side",
    "whole_edits",
}
SHORT = {"basis", "extraction", "import_time", "mesh_flows", "quadrature", "solvers"}
LARGE = pytest.mark.nightly  # of published sizes, or with many solves of the mesh beside
KINDS = ("time_", "timeraw_", "peakmem_", "track_")


@pytest.fixture
def benchmarks(monkeypatch):
    """The folder as asv imports it: a package beside the sources; it pins threads, for its own process only."""
    monkeypatch.syspath_prepend(ROOT)
    monkeypatch.setenv("BENCHMARKS_QUICK", "1")
    for name in ("OMP_NUM_THREADS", "OMP_WAIT_POLICY"):
        monkeypatch.setenv(name, "1")  # so that what the package sets goes when the test ends
    return lambda name: importlib.import_module(f"benchmarks.{name}")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in SHORT else LARGE) for name in FILES if name not in SCRIPTS],
)
def test_every_benchmark_runs_on_its_first_parameters(benchmarks, name):
    """Setup and each method; what is tracked is a finite number, and has a unit."""
    module = benchmarks(name)
    classes = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
    methods = [(c, m) for c in classes for m in dir(c) if m.startswith(KINDS)]
    assert methods
    ready = {}
    for c in {c for c, _ in methods}:
        given = tuple(values[0] for values in getattr(c, "params", ()))
        benchmark = c()
        if hasattr(benchmark, "setup_cache"):
            given = (benchmark.setup_cache(), *given)
        try:
            getattr(benchmark, "setup", lambda *_: None)(*given)
        except NotImplementedError:
            continue  # asv leaves it out as well
        ready[c] = benchmark, given
    assert ready
    for c, method in methods:
        if c in ready and not method.startswith("peakmem_"):
            benchmark, given = ready[c]
            result = getattr(benchmark, method)(*given)
            if method.startswith("track_"):
                assert isinstance(result, numbers.Real)
                assert math.isfinite(result)
                assert getattr(c, method).unit
            if method.startswith("timeraw_"):
                compile(inspect.cleandoc(result), method, "exec")
    for benchmark, given in ready.values():
        getattr(benchmark, "teardown", lambda *_: None)(*given)


def test_the_page_of_the_pace_is_that_of_its_rows(benchmarks):
    module = benchmarks("pace")
    kept = json.loads(module.RESULTS.read_text())
    assert set(kept["rows"]) <= set(module.ROWS)
    assert module.PAGE.read_text() == module.page(kept)


def test_the_page_of_whole_edits_is_that_of_its_rows_and_a_cell_runs(benchmarks):
    module = benchmarks("whole_edits")
    kept = json.loads(module.RESULTS.read_text())
    assert module.PAGE.read_text() == module.page(kept["rows"], kept["machines"])
    found = module.EDITS["semantic_edit"](implicit.shapes.bundled("spot"))
    assert found["status"] == "REACHED"
    assert "off" in module.text_of({"seconds": 1.0, "memory": None, **found})
