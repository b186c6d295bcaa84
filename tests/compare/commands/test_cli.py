"""The command line, from start to end on a small field."""

import json
import os
import subprocess
import sys

import pytest

import meshref
from compare.commands.cli import main
from compare.runs.records import read


def process(*arguments, cwd):
    """The command as a user runs it, without a terminal."""
    return subprocess.run(
        [sys.executable, "-m", "compare", *map(str, arguments)],
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "COLUMNS": "80"},
    )


def test_help_names_every_command(tmp_path):
    result = process("--help", cwd=tmp_path)
    assert result.returncode == 0
    for word in ("run", "study", "shapes", "fit", "report", "figures", "Exit codes", "130 interrupted"):
        assert word in result.stdout


def test_a_refusal_is_one_sentence_and_exit_code_2_in_the_shell(tmp_path):
    result = process("run", "spto", "-o", "out", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("implicit-vs-mesh: ")
    assert result.stderr.count("\n") == 1
    assert "Did you mean spot?" in result.stderr


def test_the_command_imports_neither_torch_nor_the_mesh_libraries(tmp_path):
    code = "import sys, compare.commands.cli; print(sys.modules.keys() & {'torch', 'igl', 'pymeshlab', 'matplotlib'})"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert result.stdout.strip() == "set()"


def test_a_command_that_is_mistyped_is_told_what_was_meant(capsys):
    for word, meant in (("rnu", "run"), ("studdy", "study"), ("trainfamily", "train-family")):
        with pytest.raises(SystemExit) as ended:
            main([word])
        assert ended.value.code == 2
        assert f"Did you mean {meant}?" in capsys.readouterr().err


def test_an_option_that_is_mistyped_is_told_what_was_meant(command, tmp_path):
    result = command("study", "points", "--wrokers", "2", cwd=tmp_path)
    assert result.returncode == 2
    assert "--workers" in result.stderr


def test_the_shell_can_complete_commands_and_options(tmp_path):
    script = process("--tyro-print-completion", "bash", cwd=tmp_path)
    assert script.returncode == 0
    for word in ("study", "--workers", "train-family"):
        assert word in script.stdout


def test_studies_are_listed_with_what_they_show(command, tmp_path):
    rows = json.loads(command("study", "--list", "--json", cwd=tmp_path).stdout)
    assert {"resolution", "points", "width", "damping", "step-size", "work-precision", "representation"} <= set(rows)
    assert "Resolution of the mesh against error" in command("study", "--list", cwd=tmp_path).stdout


def test_parts_of_the_paper_are_listed_with_what_they_hold(command, tmp_path):
    from compare.paper import PARTS

    lines = command("paper", "--list", cwd=tmp_path).stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(PARTS)
    assert all(len(line.split()) > 4 for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_an_interruption_of_the_imports_ends_quietly(tmp_path):
    """Whichever import is interrupted, of the command or of what it needs."""
    code = (
        "import sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == WORD:\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "sys.argv[1:] = ['run', 'spot', '-o', 'out']\n"
        "import implicit_vs_mesh\n"
        "implicit_vs_mesh.main()\n"
    )
    for word in ("compare", "tyro", "implicit.surface"):
        result = subprocess.run(
            [sys.executable, "-c", code.replace("WORD", repr(word))], capture_output=True, text=True, cwd=tmp_path
        )
        assert (result.returncode, result.stdout) == (130, ""), word
        assert result.stderr.strip() == "implicit-vs-mesh: interrupted.", word
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["study", "--list"], ["shapes"], ["--help"], ["--version"]])
def test_a_closed_pipe_ends_quietly(arguments, tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    try:
        result = subprocess.run(
            [sys.executable, "-m", "compare", *arguments],
            stdout=writer,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
        )
    finally:
        os.close(writer)
    assert result.stderr == ""
    assert result.returncode in (1, 141)  # 1 is what rich ends with


def test_shapes_lists_the_bundled_ones_with_their_fit(command, tmp_path):
    rows = json.loads(command("shapes", "--json", cwd=tmp_path).stdout)
    assert list(rows) == ["spot", "cactus", "bracket"]
    assert all(row["parameters"] == 2273 and row["good"] for row in rows.values())
    assert "bracket" in command("shapes", cwd=tmp_path).stdout


@pytest.fixture(scope="module")
def finished(shape_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli")
    arguments = ("run", shape_file, "--quick", "--operations", "geometric", "rigid", "-o", "out")
    return folder, process(*arguments, cwd=folder)


def test_run_prints_a_table_and_writes_the_run_folder(finished):
    folder, result = finished
    assert result.returncode == 0, result.stderr
    for word in ("bulb", "geometric", "rigid", "neural", "mesh", "ARAP", "Killing"):
        assert word in result.stdout
    assert "…" not in result.stdout, "the table is cut at 80 characters"
    assert {path.name for path in (folder / "out").iterdir()} == {
        "results.jsonl",
        "fields",
        "meshes",
        "subjects",
        "report.html",
        "run.json",
        "table.csv",
    }
    assert [r.case.operation for r in read(folder / "out")] == ["geometric", "rigid"]


def test_resume_does_only_what_is_missing(command, finished, shape_file):
    folder, _ = finished
    rows = (folder / "out" / "results.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "out" / "results.jsonl").write_bytes(rows[0])
    arguments = ("run", shape_file, "--quick", "--operations", "geometric", "rigid", "-o", "out", "--resume", "--json")
    result = command(*arguments, cwd=folder)
    assert result.returncode == 0, result.stderr
    assert (folder / "out" / "results.jsonl").read_bytes().startswith(rows[0])
    assert len(read(folder / "out")) == 2
    printed = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["case"]["operation"] for row in printed] == ["geometric", "rigid"]


def test_report_and_figures_can_be_made_again(command, finished):
    folder, _ = finished
    (folder / "out" / "report.html").unlink()
    assert command("report", "out", cwd=folder).returncode == 0
    assert (folder / "out" / "report.html").stat().st_size > 1e5
    result = command("figures", "out", "-o", "pictures", "--formats", "png", cwd=folder)
    assert result.returncode == 0, result.stderr
    assert (folder / "pictures" / "bulb.png").stat().st_size > 10_000


@pytest.mark.nightly
def test_quiet_prints_nothing(command, finished, shape_file, tmp_path):
    result = command("run", shape_file, "--quick", "--operations", "rigid", "-o", "out", "--quiet", cwd=tmp_path)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_the_version_is_that_of_the_distribution(command, tmp_path):
    from importlib.metadata import version

    assert command("--version", cwd=tmp_path).stdout.strip() == version("implicit-vs-mesh")


def test_a_fit_says_how_good_it_is_and_goes_on_from_its_checkpoint(command, tmp_path):
    V, F = meshref.icosphere(3, radius=2.0)
    meshref.write_mesh(tmp_path / "ball.obj", V, F[:, ::-1])
    options = ("--width", "8", "--steps", "60", "--checkpoint", "state.safetensors", "--quiet")
    first = command("fit", "ball.obj", "-o", "a.safetensors", *options, cwd=tmp_path)
    again = command("fit", "ball.obj", "-o", "b.safetensors", *options, cwd=tmp_path)
    assert (first.returncode, again.returncode) == (0, 0), first.stderr + again.stderr
    said = json.loads((tmp_path / "a.json").read_text())
    assert "turned all" in said["mended"][0]
    assert said["steps"] == 60
    # The second had nothing left to train: the same weights, from the checkpoint.
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_a_checkpoint_of_another_fit_is_refused(command, tmp_path):
    V, F = meshref.icosphere(2)
    meshref.write_mesh(tmp_path / "ball.obj", V, F)
    (tmp_path / "state.safetensors").write_bytes(b"no checkpoint")
    result = command(
        "fit", "ball.obj", "-o", "a.safetensors", "--steps", "5", "--checkpoint", "state.safetensors", cwd=tmp_path
    )
    assert result.returncode == 2
    assert "state.safetensors" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "a.safetensors").exists()
