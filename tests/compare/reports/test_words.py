"""Words of a page: handles in the user's units, plain numbers, findings that hold for the record, and true charts."""

import dataclasses
import re

import numpy as np
import pytest

from compare import HandleSpec
from compare.reports.arrows import arrows_of
from compare.reports.charts import Line, chart, nice_ticks
from compare.reports.findings import finding, range_of
from compare.reports.table import write_table
from compare.reports.views import load_views
from compare.reports.words import asked, handle_in_words, length
from compare.runs.columns import column_of, duration, text

BALL = {"kind": "ball", "center": [0.5, 0.0, 0.0], "radius": 0.1}


def test_handles_are_said_in_the_coordinates_of_the_file():
    """A field of 40 mm a unit, with its origin at (100, 50, -20)."""
    units = 40.0, (100.0, 50.0, -20.0)
    moved = HandleSpec(BALL, {"kind": "vector", "vector": [0.0, 0.3, 0.4]})
    assert handle_in_words(moved, *units) == (
        "Moves what lies within 4 of (120, 50, \u221220) by (0, 12, 16), a length of 20."
    )
    held = HandleSpec({"kind": "box", "lower": [0, 0, 0], "upper": [1, 1, 1]}, {"kind": "vector", "vector": [0, 0, 0]})
    assert handle_in_words(held, *units) == "Holds what lies in the box from (100, 50, \u221220) to (140, 90, 20)."
    out = HandleSpec(BALL | {"falloff": 0.2}, {"kind": "along", "distance": -0.05})
    assert "(sinking to nothing over 8 more) inwards along its normals by 2." in handle_in_words(out, *units)
    turned = HandleSpec(BALL, {"kind": "rigid", "rotation": [0.0, 0.0, np.pi / 2], "center": [0.0, 0.0, 0.0]})
    assert "turned by 90° about (0, 0, 1) through (100, 50, \u221220)" in handle_in_words(turned, *units)


@pytest.mark.parametrize(
    ("value", "words"), [(0, "0"), (-0.5, "\u22120.5"), (1234.5678, "1230"), (1e-7, "1e\u221207"), (99999.0, "100000")]
)
def test_lengths_have_no_powers_of_ten_where_they_are_of_ordinary_size(value, words):
    assert length(value) == words


def test_what_is_too_small_to_count_is_said_to_be_so():
    volume, seconds = column_of("volume_drift"), column_of("seconds")
    assert text(-7.8e-8, volume) == "<0.001 %"
    assert text(1e-12, volume) == "0 %"
    assert text(-0.0123, volume) == "-1.2 %"
    assert [text(value, seconds) for value in (0.0, 0.034, 2.345, 250.2)] == ["<0.01", "0.03", "2.3", "250"]
    assert duration(0.0) == "<0.01"


def test_findings_name_what_was_asked_and_the_numbers_of_the_record(small_run):
    for record in small_run.records:
        found = finding(record)
        assert found.asked == asked(record)
        assert found.asked.startswith("Asked: to ")
        for side in ("implicit", "mesh"):
            assert duration(record.sides[side]["seconds"]) in found.cost
        if record.case.handles:
            missed = record.sides["implicit"]["handle_error_relative"]
            assert text(missed, column_of("handle_error_relative")) in found.came
    rigid = next(r for r in small_run.records if r.case.operation == "rigid")
    energies = [rigid.sides[side]["killing_energy"] for side in ("implicit", "mesh, equal error")]
    assert f"{energies[0] / energies[1]:.2f} times" in finding(rigid).came


def test_notes_of_an_edit_are_among_what_to_mind_and_in_the_table(small_run, tmp_path):
    record = small_run.records[0]
    note = f"{record.case.name}, {record.case.operation}, neural: The points are too few."
    noted = dataclasses.replace(record, notes=(note,))
    assert "Neural: The points are too few." in finding(noted).mind
    write_table([noted], tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text().count(note) == len(record.sides)


def test_a_side_that_failed_is_not_compared(small_run):
    record = small_run.records[0]
    gone = {"method": "", "status": "Failed. RuntimeError: gave up.", "complete": False}
    failed = dataclasses.replace(record, sides={**record.sides, "implicit": gone}, failed=True)
    assert finding(failed).came.startswith("Only mesh")


def test_several_settings_are_summed_up_by_their_range(small_run):
    record = small_run.records[0]
    slower = {**record.sides, "implicit": {**record.sides["implicit"], "seconds": 1234.0, "error_relative": 0.25}}
    words = range_of([record, dataclasses.replace(record, sides=slower)])
    assert words.startswith("2 settings")
    assert "to 25 %" in words
    assert "to 1234 s" in words


def test_arrows_go_from_the_surface_to_where_it_is_pulled(small_run):
    """The bump's is as long as its distance; the rigid pull is its vector, in the file's units."""
    for record in small_run.records:
        before = load_views(record, small_run.folder)["before"]
        arrows = arrows_of(record, before)
        moving = [handle for handle in record.case.handles if not handle.holds]
        assert len(arrows) == len(moving)
        for (start, end), handle in zip(arrows, moving, strict=True):
            assert np.linalg.norm(before.V - start, axis=1).min() == 0
            pull = (end - start) / record.subject.scale
            if handle.motion["kind"] == "vector":
                np.testing.assert_allclose(pull, handle.motion["vector"], atol=1e-12)
            else:
                assert np.linalg.norm(pull) == pytest.approx(handle.motion["distance"])
                assert pull @ (start - before.V.mean(axis=0)) > 0


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-0.01, 0.01), (-3.7, 0.2), (0.0, 0.0603), (1e-9, 2e-9)])
def test_ticks_are_round_and_hold_the_range(low, high):
    ticks = nice_ticks(low, high)
    assert ticks[0] <= low + 1e-12
    assert ticks[-1] >= high - 1e-12
    assert 3 <= len(ticks) <= 7
    step = ticks[1] - ticks[0]
    mantissa = step / 10 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(mantissa - round_one) for round_one in (1, 2, 2.5, 5)) < 1e-6


def test_a_held_value_is_a_level_line_and_a_single_solve_a_dashed_one():
    held = chart("volume", [Line("a", "#000000", [0.0, 1e-6, -1e-6])], least_range=0.01)
    heights = [float(y) for y in re.findall(r'cy="([\d.]+)"', held)]
    assert np.ptp(heights) < 0.2
    assert 'class="level"' in chart("volume", [Line("b", "#000000", [0.0, 3.0])])
    assert "&lt;b&gt;" in chart("<b>", [Line("c", "#000000", [0.0, 3.0])])
