"""A study that is killed again and again ends with every row, none torn, none twice.

IMPLICIT_VS_MESH_KILLS="60 20" makes it sixty cases and twenty kills, in place of what a test at every change has time
for.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time

import pytest

import implicit
import implicit.shapes
from compare.runs.records import FILE, read

CASES, KILLS = map(int, os.environ.get("IMPLICIT_VS_MESH_KILLS", "6 1").split())
PATIENCE = 600  # seconds for a step of this test on a machine with much else to do

STUDY = """
shapes = ["ball.safetensors"]
operations = ["rigid"]
[settings]
vertices = 150
resolution = 16
implicit.points = 60
implicit.steps = 1
[grid]
seed = {seeds}
implicit.alpha = [1e3, 1e4]
"""


def begin(folder):
    return subprocess.Popen(
        [sys.executable, "-m", "compare", "study", "cheap.toml", "-o", "out", "--quiet"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Whoever runs in the background of a shell has been told to ignore it, and so would the study.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def rows(folder):
    """Lines that are whole, as anything but this package would count them."""
    path = folder / "out" / FILE
    return path.read_bytes().count(b"\n") if path.exists() else 0


def wait_for_rows(folder, number, process):
    deadline = time.monotonic() + PATIENCE
    while rows(folder) < number and process.poll() is None:
        assert time.monotonic() < deadline, "The study does not get on."
        time.sleep(0.01)


@pytest.mark.nightly
def test_a_study_that_is_killed_and_interrupted_ends_with_every_row_once(tmp_path):
    implicit.save_field(implicit.shapes.sphere(0.6), tmp_path / "ball.safetensors")
    (tmp_path / "cheap.toml").write_text(STUDY.format(seeds=list(range(CASES // 2))))
    moments = random.Random(0)
    for _ in range(KILLS):
        process = begin(tmp_path)
        # Some of the moments lie in the start of the program, most of them between the rows and in the middle of one.
        wait_for_rows(tmp_path, rows(tmp_path) + moments.randint(0, min(2, CASES - rows(tmp_path) - 2)), process)
        time.sleep(moments.uniform(0, 0.3))
        process.kill()
        process.communicate()
        assert process.returncode == -signal.SIGKILL, "The study ended before it was killed."

    # An interruption of the keyboard is kept to in the same way, and says so.
    process = begin(tmp_path)
    wait_for_rows(tmp_path, rows(tmp_path) + 1, process)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 130, said
    assert f"interrupted. {rows(tmp_path)} cases are kept; the same command goes on with the rest." in said
    assert "Traceback" not in said
    assert rows(tmp_path) < CASES

    process = begin(tmp_path)
    said = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 0, said
    lines = (tmp_path / "out" / FILE).read_text().splitlines()
    assert len(lines) == CASES
    assert all(json.loads(line) for line in lines)
    records = read(tmp_path / "out")
    assert len({record.key for record in records}) == CASES
    assert not any(record.failed for record in records)
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_file()) == [
        "report.html",
        "results.jsonl",
        "study.json",
        "table.csv",
    ]
