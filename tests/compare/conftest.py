"""One small run that the tests of this folder look at: an analytic shape, each operation, few points."""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from filelock import FileLock

import implicit
import implicit.shapes
from compare import Case, Record, default_cases, prepare_subject, report, run_cases
from compare.commands.cli import main
from compare.runs.records import read

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-sync"]

SMALL = {"vertices": 300, "resolution": 24}


@dataclass(frozen=True)
class SmallRun:
    """A run folder and what is in it."""

    folder: Path
    cases: list[Case]
    records: list[Record]


@dataclass(frozen=True)
class Ended:
    """How a command ended and what it printed, named as subprocess does."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """A function that runs the command line in this process: its words, and cwd=, the folder it runs in."""

    def run(*arguments: object, cwd: Path) -> Ended:
        monkeypatch.chdir(cwd)
        monkeypatch.setenv("COLUMNS", "100")
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in arguments])
        printed = capsys.readouterr()
        return Ended(ended.value.code, printed.out, printed.err)

    return run


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the processes of these tests share: where there are several, each has one of its own within it."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def shape_file(shared_folder: Path) -> Path:
    """A field in a file: a capsule with a ball on its side."""
    field = implicit.shapes.smooth_union(implicit.shapes.capsule(), implicit.shapes.sphere(0.25, (0.3, 0.0, 0.0)))
    path = shared_folder / "bulb.safetensors"
    with FileLock(shared_folder / "shape.lock"):
        if not path.exists():
            implicit.save_field(field, path)
    return path


@pytest.fixture(scope="session")
def small_cases(shape_file: Path) -> list[Case]:
    """The three operations on it, at little cost."""
    subject = prepare_subject(Case(str(shape_file), "smooth", **SMALL))
    cases = default_cases(str(shape_file), subject.V, subject.N, quick=True, **SMALL)
    return [
        replace(case, parameters={**case.parameters, "implicit": {**case.parameters["implicit"], "points": 250}})
        for case in cases
    ]


@pytest.fixture(scope="session")
def small_run(small_cases: list[Case], shared_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> SmallRun:
    """The cases run into a folder, with a report: by the first process that wants it; each has a copy of its own."""
    made = shared_folder / "run"
    with FileLock(shared_folder / "run.lock"):
        if not (made / "report.html").exists():
            records = run_cases(small_cases, folder=made)
            assert [r.status for r in records if r.failed] == []
            report(records, made / "report.html")
    folder = tmp_path_factory.mktemp("run") / "small"
    shutil.copytree(made, folder)
    by_key = {record.key: record for record in read(folder)}
    return SmallRun(folder, small_cases, [by_key[case.key] for case in small_cases])


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium, which asks no other host for anything."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()
