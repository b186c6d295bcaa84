"""A record says where it is from, down to the commit of its input."""

import hashlib
import json
import shutil
import subprocess

import pytest

import meshref
from compare import Case
from compare.runs.provenance import input_of, provenance


def test_it_names_what_a_number_may_depend_on():
    row = provenance(Case("spot", "smooth", seed=3))
    assert row["seed"] == 3
    assert row["threads"] >= 1
    assert row["device"] == "cpu"
    assert row["versions"]["torch"]
    assert row["input"] == {"content": "spot", "git": None}
    assert json.dumps(row)


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_an_input_in_a_checkout_has_its_commit_and_whether_it_is_as_committed(tmp_path):
    path = tmp_path / "ball.off"
    meshref.write_mesh(path, *meshref.icosphere(1))

    def git(*arguments):
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        done = subprocess.run(["git", "-C", tmp_path, *who, *arguments], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    content = "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()
    assert input_of(str(path)) == {"content": content, "git": None}
    git("init")
    git("add", "ball.off")
    git("commit", "-m", "A ball")
    commit = git("rev-parse", "HEAD")
    assert input_of(str(path)) == {"content": content, "git": {"commit": commit, "as_committed": True}}
    meshref.write_mesh(path, *meshref.icosphere(2))
    changed = input_of(str(path))
    assert changed["git"] == {"commit": commit, "as_committed": False}
    assert changed["content"] != content
    path.unlink()
    assert input_of(str(path)) == {"content": None, "git": None}
