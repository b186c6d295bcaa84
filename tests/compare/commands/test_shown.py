"""Bars say what is being done with a clock of its own; tables keep words whole; a finished run is known at once."""

import dataclasses
import shutil
import subprocess
import sys

import numpy as np
import pytest
from rich.progress import Progress

import meshref
from compare.commands import shown
from compare.commands.run import Run
from compare.commands.run_settings import finished_records, keep_settings
from compare.commands.shown import print_markdown, print_table, teller
from compare.reports.table import write_table
from compare.runs.run import run_case
from compare.runs.subject import check_shape


def test_the_clock_of_a_bar_begins_anew_with_each_thing_and_is_at_work_until_a_step_is_done():
    now = [0.0]
    bars = Progress(get_time=lambda: now[0], disable=True)
    tell = teller(bars, bars.add_task("", total=None))
    tell(0, 1, "spot, rigid, neural")
    now[0] = 26.0
    task = bars.tasks[0]
    assert (task.description, task.total, task.elapsed) == ("spot, rigid, neural", None, 26.0)
    tell(1, 3, "spot, rigid, neural field")
    assert (task.completed, task.total, task.elapsed) == (1, 3, 26.0)
    tell(0, 1, "spot, rigid, ARAP")
    now[0] = 30.0
    assert (task.description, task.total, task.elapsed) == ("spot, rigid, ARAP", None, 4.0)


def test_progress_names_the_shape_the_edit_and_each_side_before_its_first_step(small_cases, monkeypatch):
    """The neural editor gives up at once, to be quick: it is named all the same."""

    def failing(*arguments):
        raise RuntimeError("The solver gave up.")

    monkeypatch.setattr("compare.runs.operations._edit_field", failing)
    said = []
    case = next(case for case in small_cases if case.operation == "geometric")
    record = run_case(case, progress=lambda step, steps, what: said.append((step, what)))
    begun = [what for step, what in said if step == 0]
    assert begun[0] == "bulb, the common mesh"
    assert [f"bulb, geometric, {name}" for name in ("neural", "mesh", "biharmonic")] == begun[1:4]
    assert all(what.startswith("bulb, ") for _, what in said)
    assert len(record.sides) == 3


def test_a_bar_names_what_is_done_while_a_large_mesh_is_mended(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(shown, "LARGE_FILE", 10_000)
    told, sentences = [], []
    monkeypatch.setattr(shown, "teller", lambda *_: lambda step, steps, what: told.append((step, what)))
    names = [str(tmp_path / "small.ply"), str(tmp_path / "large.ply")]
    meshref.write_mesh(names[0], *meshref.icosphere(1))
    V, F = meshref.icosphere(4)
    meshref.write_mesh(names[1], np.concatenate([V, V + 0.5]), np.concatenate([F, F + len(V)]))
    said = shown.say_mending(sentences.append, names, lambda name, tell: check_shape(name, progress=tell), quiet=False)
    assert sentences[0].endswith("large.ply: reading and mending 0 MB.")
    assert sentences[1:] == said
    assert [what for _, what in told] == [f"large, {what}" for what in ("reading", *meshref.mend.PARTS)]
    assert [step for step, _ in told] == [0, *range(5)]


@pytest.mark.parametrize("width", ["60", "80", "200"])
def test_a_table_fits_the_terminal_in_whole_words_and_names_what_it_leaves_out(small_run, monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", width)
    print_table(small_run.records)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= int(width)
    assert "…" not in printed
    assert "ARAP, as far off" in printed
    assert ("Left out for want of room" in printed) == (width == "60")


def test_findings_are_rendered_on_a_terminal_and_raw_elsewhere(monkeypatch, capsys):
    text = "# Title\n\n| a | b |\n|---|---|\n| 1 | 2 |\n"
    print_markdown(text)
    assert capsys.readouterr().out == text + "\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    print_markdown(text)
    printed = capsys.readouterr().out
    assert "Title" in printed
    assert "|---|" not in printed


@pytest.fixture
def finished_run(small_run, shape_file, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(small_run.folder, folder)
    write_table(small_run.records, folder / "table.csv")
    command = Run(shapes=(str(shape_file),), output=folder, resume=True)
    keep_settings(command, small_run.cases, folder)
    return command, folder


def test_a_finished_run_is_known_by_its_settings_files_and_records(finished_run, small_run, shape_file, tmp_path):
    command, folder = finished_run
    assert finished_records(command, folder) == small_run.records
    assert finished_records(dataclasses.replace(command, quiet=True, workers=2), folder) is not None
    assert finished_records(dataclasses.replace(command, seed=1), folder) is None
    other = tmp_path / "other.toml"
    other.write_text("")
    assert finished_records(dataclasses.replace(command, handles=other), folder) is None
    rows = (folder / "results.jsonl").read_text().splitlines(keepends=True)
    (folder / "results.jsonl").write_text("".join(rows[:-1]))
    assert finished_records(command, folder) is None
    (folder / "results.jsonl").write_text("".join(rows))
    (folder / "report.html").unlink()
    assert finished_records(command, folder) is None


def test_a_finished_run_is_shown_again_without_torch_or_the_mesh_libraries(finished_run, shape_file):
    _, folder = finished_run
    code = (
        "import sys\nfrom compare.commands.cli import main\n"
        f"try: main(['run', {str(shape_file)!r}, '-o', {str(folder)!r}, '--resume'])\n"
        "except SystemExit as ended: assert ended.code == 0, ended.code\n"
        "assert not sys.modules.keys() & {'torch', 'igl', 'matplotlib'}\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert "biharmonic" in result.stdout
