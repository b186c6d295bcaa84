"""The README is true: its snippets run, its commands run, its set-up lines are those of the continuous integration.

Commands and snippets run in an empty folder, on fewer operations, shapes, figures, points and steps than they name, and
but for the first in this process; with IMPLICIT_VS_MESH_README=full all run as they are written, each in a process of
its own, as a nightly job wants. What sets up an environment or runs these very tests is not run from here; .ci/run does
it, and must say the same words.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import implicit
import implicit.shapes
import meshref
from compare.commands.cli import main

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
SET_UP = ("python3 -m venv", "pip install", "pytest")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, flags=re.DOTALL | re.MULTILINE)


PYTHON = blocks("python")
LINES = [line for block in blocks("bash") for line in block.splitlines() if line.strip()]
COMMANDS = list(dict.fromkeys(line for line in LINES if not line.startswith(SET_UP)))


def environment():
    """The command of this very environment first, wherever it is activated or not."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return {**os.environ, "PATH": path}


def execute(arguments, folder, **options):
    result = subprocess.run(
        arguments,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(),
        timeout=1800,
        check=False,
        **options,
    )
    assert result.returncode == 0, result.stdout
    return result.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a mesh of the reader's own, a stretched ball in other units than the field's, and a field."""
    folder = tmp_path_factory.mktemp("readme")
    V, F = meshref.icosphere(3)
    meshref.write_mesh(folder / "my-shape.obj", V * [20.0, 35.0, 25.0] + 100, F)
    implicit.save_field(
        implicit.shapes.sphere(0.6), folder / "ball.safetensors"
    )  # for what is not there to be looked at
    return folder


def test_there_is_something_to_run():
    assert len(PYTHON) == 5
    assert any(command.startswith("implicit-vs-mesh run") for command in COMMANDS)


@pytest.mark.parametrize("snippet", PYTHON, ids=lambda text: re.search(r"import (\w+)|from (\w+)", text)[0].split()[1])
def test_a_snippet_runs_and_prints(snippet, folder, monkeypatch, capsys):
    if as_written():
        assert execute([sys.executable, "-c", snippet], folder).strip()
        return
    monkeypatch.chdir(folder)
    exec(compile(in_a_step(snippet), "README.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip()


def as_written():
    return os.environ.get("IMPLICIT_VS_MESH_README") == "full"


def in_a_step(snippet):
    """The snippet with one step for several, and a third of the points and vertices."""
    fewer = re.sub(r"(\bsteps\b\W+)\d+", r"\g<1>1", snippet)
    return re.sub(r"\b((?:points|vertices)\b\W+)1000\b", r"\g<1>300", fewer)


def in_short(command):
    """The command at less cost, unless the variable asks for all of it."""
    if as_written():
        return command
    cheaper = {
        "implicit-vs-mesh run": " --quick --operations geometric",
        "implicit-vs-mesh fit": " --width 8 --steps 200",
        "implicit-vs-mesh study points": " --shapes ball.safetensors",
    }
    more = next((more for start, more in cheaper.items() if command.startswith(start)), "")
    fewer = {
        "paper basis semantic_basis": "paper rope",
        "implicit-vs-mesh run --": "implicit-vs-mesh run ball.safetensors --",
        " --workers 2": "",
    }
    command += more
    for long, short in fewer.items():
        command = command.replace(long, short)
    return command


def test_every_command_runs(folder, monkeypatch):
    """In the order of the page, for later ones use what earlier ones wrote."""
    monkeypatch.chdir(folder)
    for k, command in enumerate(COMMANDS):
        if as_written() or k == 0:
            execute(in_short(command), folder, shell=True)
            continue
        program, *arguments = shlex.split(in_short(command))
        assert program == "implicit-vs-mesh"
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0, command
    runs = sorted(path.parent for path in folder.glob("results/*/results.jsonl"))
    assert len(runs) >= 2
    for run in runs:
        page = (run / "report.html").read_text(encoding="utf-8")
        assert len(page) > 1e5
        assert "What was found" in page


def test_the_set_up_of_the_tests_is_what_the_continuous_integration_does():
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert 'pip install -c constraints.txt ".[test]"' in LINES
    assert re.search(r'pip install .*-c constraints\.txt "\.\[test\]"$', script, flags=re.MULTILINE)
    assert "pytest" in LINES
    assert re.search(r"^pytest$", script, flags=re.MULTILINE)


def test_every_file_it_links_to_is_there():
    for target in re.findall(r"\]\(([^)]+)\)", TEXT):
        if not target.startswith("http"):
            assert (ROOT / target).is_file(), target
