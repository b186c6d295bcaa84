"""The rows of a record: by attribute and by name, frozen, and the rows that earlier versions wrote."""

import copy
import dataclasses
import json
import pickle
from pathlib import Path

import pytest

from compare import Case, Record
from compare.runs.records import FILE, append, read
from compare.runs.rows import CurveRow, SideRow

# Written by `run cactus --quick` when a record's rows were dictionaries; what tells of the machine is taken out.
BEFORE = Path(__file__).parent / "rows_of_dictionaries.jsonl"


def test_rows_of_before_are_read_and_written_as_they_were(tmp_path):
    lines = BEFORE.read_text().splitlines()
    records = read(BEFORE)
    assert [record.case.operation for record in records] == ["geometric", "smooth", "rigid", "geometric"]
    for record, line in zip(records, lines, strict=True):
        append(tmp_path / FILE, record)
        assert record.key == record.case.key
        assert record.to_dict() == json.loads(line)
    assert (tmp_path / FILE).read_text().splitlines() == lines  # with their keys in the same order


def test_numbers_of_before_are_had_by_name_and_by_attribute():
    rows = [json.loads(line) for line in BEFORE.read_text().splitlines()]
    for record, row in zip(read(BEFORE), rows, strict=True):
        for side, numbers in row["sides"].items():
            assert record.sides[side] == numbers
            for name, value in numbers.items():
                assert record.sides[side][name] == value
                assert getattr(record.sides[side], name) == value
        assert record.subject == row["subject"]
        assert record.between == row["between"]
    assert read(BEFORE)[0].sides["implicit"].curve[0].seconds == 0.0
    assert read(BEFORE)[3].failed


def test_a_number_that_a_row_lacks_is_no_key_and_no_attribute():
    row = SideRow(killing_energy=1.0, peak_memory=None)
    assert list(row) == ["killing_energy", "peak_memory"]
    assert row.peak_memory is None
    assert row.get("strain_rms") is None
    with pytest.raises(KeyError):
        row["strain_rms"]
    with pytest.raises(AttributeError, match="This SideRow has no strain_rms; it has killing_energy, peak_memory"):
        _ = row.strain_rms


def test_a_row_keeps_names_that_no_field_is_for_and_is_frozen():
    row = SideRow.from_row({"bend_rms": 2.0, "killing_energy": 1.0, "more": 3})
    assert dict(row) == {"killing_energy": 1.0, "bend_rms": 2.0, "more": 3}
    with pytest.raises(dataclasses.FrozenInstanceError):
        row.killing_energy = 2.0
    with pytest.raises(TypeError, match="must be a dictionary, but is 3"):
        SideRow.from_row(3)


def test_a_row_is_copied_and_sent_to_other_processes_whole():
    row = SideRow(status="Done.", curve=[{"step": 0.0}], bend=1)
    for twin in (copy.deepcopy(row), pickle.loads(pickle.dumps(row))):
        assert twin == row
        assert isinstance(twin.curve[0], CurveRow)


def test_a_record_is_printed_in_a_few_lines():
    record = read(BEFORE)[2]
    lines = repr(record).splitlines()
    assert len(lines) == 1 + len(record.sides)
    assert all(len(line) < 400 for line in lines)
    assert lines[0].startswith(f"Record({record.key}, Case(cactus, rigid, 2 handles, vertices=1200")
    assert "killing_energy" in lines[1]
    assert len(repr(record.sides["implicit"])) < 1200
    assert repr(Record(Case("spot", "smooth"), "0", "Failed.", failed=True)).count("\n") == 0
