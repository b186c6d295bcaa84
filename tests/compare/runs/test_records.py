"""Rows survive whatever happens to the writer, and say what JSON can say."""

import json
import math
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from compare import Case, Record
from compare.files import plain
from compare.runs.records import FILE, Artefact, append, read


def a_record(seed=0, **changes):
    case = Case("spot", "smooth", seed=seed)
    return Record(case, case.key, "Done.", **changes)


def test_a_record_comes_back_from_its_row(tmp_path):
    record = a_record(
        subject={"vertices": 4000, "sides": [1.0, 2.0, 3.0]},
        sides={"mesh": {"killing_energy": 1 / 3}},
        artefacts={"mesh": Artefact("meshes/a.ply", "00")},
        notes=("A hole was closed.",),
    )
    append(tmp_path / FILE, record)
    assert read(tmp_path) == [record]


def test_numbers_that_json_cannot_say_become_null(tmp_path):
    append(tmp_path / FILE, a_record(sides={"mesh": {"a": math.nan, "b": math.inf, "c": np.float32(0.5)}}))
    assert read(tmp_path)[0].sides["mesh"] == {"a": None, "b": None, "c": 0.5}
    assert "NaN" not in (tmp_path / FILE).read_text()


def test_arrays_become_lists_and_other_things_are_refused():
    assert plain({"x": np.arange(3), 1: (True, None)}) == {"x": [0, 1, 2], "1": [True, None]}
    with pytest.raises(TypeError, match="got a set"):
        plain({1, 2})


def test_a_torn_last_line_is_skipped_and_then_cut_away(tmp_path):
    path = tmp_path / FILE
    append(path, a_record(0))
    append(path, a_record(1))
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    assert [r.case.seed for r in read(path)] == [0]
    append(path, a_record(2))
    assert [r.case.seed for r in read(path)] == [0, 2]
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_a_broken_line_in_the_middle_is_an_error(tmp_path):
    path = tmp_path / FILE
    append(path, a_record(0))
    path.write_bytes(b"{oops\n" + path.read_bytes())
    with pytest.raises(ValueError, match=r"Line 1 of .* is not JSON"):
        read(path)


def test_a_row_of_another_schema_is_refused(tmp_path):
    path = tmp_path / FILE
    append(path, a_record(0, schema=99))
    with pytest.raises(ValueError, match="schema 99, but this version reads 1"):
        read(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=FILE):
        read(tmp_path)


def test_a_writer_killed_at_any_moment_leaves_whole_rows(tmp_path):
    """Killed three times while it appends as fast as it can, each time later than the last."""
    path = tmp_path / FILE
    program = (
        "import sys; from compare import Case, Record; from compare.runs.records import append\n"
        "case = Case('spot', 'smooth')\n"
        "while True: append(sys.argv[1], Record(case, case.key, 'Done. ' * 20000))\n"
    )
    for delay in (0.01, 0.06, 0.11):
        before = len(read(path)) if path.exists() else 0
        writer = subprocess.Popen([sys.executable, "-c", program, str(path)])
        try:
            deadline = time.monotonic() + 60
            while not path.exists() or path.read_bytes().count(b"\n") <= before:
                assert time.monotonic() < deadline, "The writer wrote nothing."
                time.sleep(0.005)
            time.sleep(delay)
        finally:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
        assert len(read(path)) > before
    append(path, a_record())
    assert read(path)[-1] == a_record()
