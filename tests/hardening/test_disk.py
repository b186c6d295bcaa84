"""A disk that is full, a folder that is none, a write that is broken off: the old file stays whole, and it is said."""

import json
import os
import subprocess
import sys

import pytest

import implicit
import meshref
from compare import Case, Record
from compare.files import replace_file as replace_text
from compare.runs import records
from implicit import shapes

V, F = meshref.icosphere(2)
RECORD = Record(Case("spot", "smooth"), "0" * 16, "done")
WRITERS = {
    "mesh.ply": lambda path: meshref.write_mesh(path, V, F),
    "field.safetensors": lambda path: implicit.save_field(implicit.Field(implicit.Siren()), path),
    "page.html": lambda path: replace_text(path, b"x" * 100_000),
}

# Write each file where no more than a few hundred bytes find room, and tell what was raised.
FULL_DISK = """
import json, resource, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_disk import RECORD, WRITERS
from compare.runs import records
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
said = {}
writers = {**WRITERS, "results.jsonl": lambda path: records.append(path, RECORD)}
for name, write in writers.items():
    try:
        write(Path(name))
    except (OSError, ValueError) as error:
        said[name] = str(error)
sys.stdout.write(json.dumps(said))
"""


def test_on_a_full_disk_the_old_files_stay_whole(tmp_path):
    for name in (*WRITERS, "results.jsonl"):
        (tmp_path / name).write_text("precious\n")
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, os.path.dirname(__file__)], cwd=tmp_path, capture_output=True, text=True
    )
    said = json.loads(result.stdout or "{}")
    assert set(said) == {*WRITERS, "results.jsonl"}, result.stderr
    for name, message in said.items():
        assert name in message
        assert "cannot be written" in message
        assert message.endswith(".")
        assert (tmp_path / name).read_text().startswith("precious\n")
    assert {path.name for path in tmp_path.iterdir()} == {*WRITERS, "results.jsonl"}


@pytest.mark.parametrize("name", WRITERS)
def test_a_write_that_is_broken_off_leaves_the_old_file(name, tmp_path, monkeypatch):
    path = tmp_path / name
    path.write_text("precious")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        WRITERS[name](path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", WRITERS)
def test_a_folder_that_is_none_is_said(name, tmp_path):
    (tmp_path / "letter").write_text("precious")
    for folder in (tmp_path / "letter", tmp_path / "gone"):
        with pytest.raises((OSError, ValueError), match=r"cannot be written.*folder"):
            WRITERS[name](folder / name)
    assert (tmp_path / "letter").read_text() == "precious"


def test_a_record_that_found_no_room_is_cut_away_by_the_next(tmp_path):
    path = tmp_path / "results.jsonl"
    records.append(path, RECORD)
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:99])
    records.append(path, RECORD)
    assert path.read_bytes() == whole + whole


def test_a_saved_field_is_the_same_bytes_each_time(tmp_path):
    for name in ("a.safetensors", "b.safetensors"):
        implicit.save_field(shapes.sphere(0.5), tmp_path / name)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
