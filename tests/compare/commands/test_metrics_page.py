"""docs/metrics.md explains every number that a record or a table holds, and none that there is not."""

import dataclasses
import re
from pathlib import Path

import pytest

from compare.commands.shown import print_table
from compare.runs.columns import SIDES, columns

PAGE = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")
EXPLAINED = set(re.findall(r"`([^`\n]+)`", PAGE))

# Words in code type that are no names of numbers: where numbers are kept, endings of names, and results of a test.
OTHERS = {"results.jsonl", "report.html", "subject", "null", "_drift", "_relative", "_notebook"}

# Numbers of cases that the small run does not have: a fit, and an event on the way.
ELSEWHERE = {"event"}


def names_in(record):
    """Every name of a number or a word of a record, but those of the case, the fit and the provenance."""
    names = {*record.subject, *record.between, *record.seconds}
    for row in record.sides.values():
        names |= {*row, *row["seconds_by_phase"], *row["details"], *(name for at in row["curve"] for name in at)}
        names |= {name for step in row["details"].get("history", []) for name in step}
    return names


def test_every_name_of_a_record_is_explained(small_run):
    held = set.union(*(names_in(record) for record in small_run.records))
    assert sorted(held - EXPLAINED) == []


def test_nothing_is_explained_that_is_not_there(small_run):
    held = set.union(*(names_in(record) for record in small_run.records))
    assert sorted(EXPLAINED - held - OTHERS - ELSEWHERE) == []


def test_every_column_of_the_tables_is_explained_under_its_title():
    for column in columns():
        assert column.name in EXPLAINED
        assert f'"{column.title}"' in PAGE, column.title


def test_every_kind_of_number_is_in_the_small_run(small_run):
    """Or the tests above would pass for want of anything to explain."""
    assert {record.case.operation for record in small_run.records} == {"geometric", "smooth", "rigid"}
    sides = {side for record in small_run.records for side in record.sides}
    assert sides == set(SIDES)


def test_phases_add_up_to_the_seconds_of_their_side(small_run):
    for record in small_run.records:
        for row in record.sides.values():
            assert all(seconds >= 0 for seconds in row["seconds_by_phase"].values())
            assert sum(row["seconds_by_phase"].values()) <= row["seconds"] * 1.001
        neural = record.sides["implicit"]
        assert sum(neural["seconds_by_phase"].values()) == pytest.approx(neural["seconds"], rel=1e-9)


def test_curves_end_at_the_numbers_of_their_side(small_run):
    """On the mesh side to rounding; the common mesh carried by the field is off by its flat triangles."""
    for record in small_run.records:
        for side, row in record.sides.items():
            start, *_, end = row["curve"]
            assert set(start.values()) == {0.0}
            assert abs(end["killing_energy"] / row["killing_energy"] - 1) < 1e-9
            for name in ("volume_drift", "area_drift"):
                assert abs(end[name] - row[name]) < (5e-3 if side == "implicit" else 1e-12), (side, name)
        assert len(record.sides["implicit"]["curve"]) == record.sides["implicit"]["details"]["steps"] + 1


@pytest.mark.parametrize("width", [60, 80, 300])
def test_a_table_fits_the_terminal_without_cut_words(small_run, width, capsys, monkeypatch):
    """Columns are left out from the last one, and named."""
    monkeypatch.setenv("COLUMNS", str(width))
    print_table([dataclasses.replace(record, notes=()) for record in small_run.records])
    said = capsys.readouterr().out
    assert "\u2026" not in said
    table, _, left_out = said.partition("Left out")
    assert max(len(line.rstrip()) for line in table.splitlines()) <= width
    titles = [column.title for column in columns() if column.brief]
    shown = [title for title in titles if title in table.splitlines()[1].split()]
    assert shown == titles[: len(shown)]
    assert len(shown) >= 1
    assert all(title in " ".join(left_out.split()) for title in titles[len(shown) :])
    assert (width >= 80) == (len(shown) == len(titles))
