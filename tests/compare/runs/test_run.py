"""Running cases: what is written, what is kept, what is not done twice."""

import dataclasses
import hashlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

import implicit
import meshref
from compare import Case, HandleSpec, report, run_case, run_cases
from compare.reports.views import load_views, read_view
from compare.runs.records import FILE, read


def by_operation(small_run, operation):
    return next(r for r in small_run.records if r.case.operation == operation)


def test_every_row_and_file_is_there_with_its_hash(small_run):
    assert read(small_run.folder) == small_run.records
    for record in small_run.records:
        assert set(record.artefacts) == {"field", "before", *record.sides}
        for artefact in record.artefacts.values():
            content = (small_run.folder / artefact.path).read_bytes()
            assert hashlib.sha256(content).hexdigest() == artefact.sha256


@pytest.mark.parametrize("operation", ["smooth", "rigid"])
def test_the_energy_of_the_mesh_result_can_be_had_from_its_files(small_run, operation):
    """before.ply and mesh.ply share their faces: their difference is the displacement that was judged."""
    record = by_operation(small_run, operation)
    views = load_views(record, small_run.folder)
    before, after = views["before"], views["mesh"]
    np.testing.assert_array_equal(before.F, after.F)
    energy = meshref.killing_energy(before.V, before.F, after.V - before.V, form="membrane")
    assert record.sides["mesh"]["killing_energy"] == pytest.approx(energy, rel=1e-9)


def test_the_common_mesh_lies_on_the_field_and_has_even_triangles(small_run):
    record = by_operation(small_run, "smooth")
    field = implicit.load_field(record.case.shape)
    V, F = meshref.read_mesh(small_run.folder / record.artefacts["before"].path)
    assert field.value(torch.from_numpy(V)).abs().max() < 1e-9
    wanted = record.case.vertices
    assert 0.7 * wanted < len(V) < 1.4 * wanted
    sides = np.linalg.norm(V[F] - V[np.roll(F, 1, axis=1)], axis=2)
    assert sides.max() / sides.min() < 6


def test_the_implicit_mesh_is_the_surface_of_the_edited_field(small_run):
    for record in small_run.records:
        field = implicit.load_field(small_run.folder / record.artefacts["field"].path)
        V = read_view(small_run.folder / record.artefacts["implicit"].path).V
        assert field.value(torch.from_numpy(V)).abs().max() < 1e-6


def test_volume_is_held_by_both_flows_and_both_shrink_the_area(small_run):
    sides = by_operation(small_run, "smooth").sides
    for side in sides.values():
        assert abs(side["volume_drift"]) < 1e-3
        assert side["area_drift"] < -1e-3


def test_the_mesh_follows_the_flow_of_the_field_to_its_end_and_says_how_well(small_run):
    """One equation on both sides; the conformalised flow is another, under its own name."""
    sides = by_operation(small_run, "smooth").sides
    assert set(sides) == {"implicit", "mesh", "mesh, conformalised"}
    mesh = sides["mesh"]
    assert mesh["method"] == "curvature flow, volume held"
    assert sides["mesh, conformalised"]["method"] == "conformalised curvature flow, rescaled"
    assert 0 < mesh["details"]["time_error_rms"] <= mesh["details"]["time_error_max"] < 0.1 * mesh["displacement_max"]
    assert mesh["details"]["steps"] >= 4 * (len(mesh["curve"]) - 1)
    assert abs(mesh["volume_drift"]) < 1e-11


def test_the_mesh_reaches_its_handles_exactly_and_has_less_energy_than_the_restricted_field(small_run):
    """The mesh minimises the spokes-and-rims form over all displacements that reach the handles."""
    sides = by_operation(small_run, "rigid").sides
    assert sides["mesh"]["handle_error_max"] < 1e-12
    assert sides["mesh"]["killing_spokes_and_rims"] <= sides["mesh, ARAP"]["killing_spokes_and_rims"]


def test_a_biharmonic_mesh_meets_the_core_and_stays_near_the_falloff(small_run):
    """Core and rest are held to rounding; between them the smoothest way is within a fifth of the quintic falloff."""
    sides = by_operation(small_run, "geometric").sides
    assert sides["mesh"]["error_max"] < 1e-12
    assert 1e-3 < sides["mesh, biharmonic"]["error_relative"] < 0.2


def test_what_is_done_is_not_done_again(small_run, small_cases):
    content = (small_run.folder / FILE).read_bytes()
    told = []
    records = run_cases(small_cases, folder=small_run.folder, on_record=told.append)
    assert records == small_run.records
    assert told == []
    assert (small_run.folder / FILE).read_bytes() == content


def test_a_case_that_fails_is_a_row_with_its_reason_and_ends_nothing(small_cases, tmp_path):
    off = HandleSpec({"kind": "ball", "center": [9.0, 0.0, 0.0], "radius": 0.1}, {"kind": "along", "distance": 0.1})
    bad = dataclasses.replace(small_cases[0], handles=(off,))
    good = small_cases[0]
    with pytest.warns(UserWarning, match=r"geometric: Failed\. ValueError: Handle 1 .* holds no vertex"):
        records = run_cases([bad, good], folder=tmp_path)
    assert [r.failed for r in records] == [True, False]
    assert "holds no vertex" in records[0].status
    assert len(read(tmp_path)) == 2
    with pytest.raises(RuntimeError, match="holds no vertex"):
        run_cases([bad, good], on_failure="raise")
    assert run_cases([bad], on_failure="record")[0].sides == {}
    with pytest.raises(ValueError, match='on_failure must be "warn", "raise" or "record", but is None'):
        run_cases([good], on_failure=None)


@pytest.mark.nightly
def test_a_pool_gives_what_a_loop_gives(small_run, small_cases):
    with ThreadPoolExecutor(2) as pool:
        records = run_cases(small_cases[:2], pool)
    for one, other in zip(records, small_run.records[:2], strict=True):
        assert not one.failed, one.status
        assert one.key == other.key
        assert one.sides["mesh"]["killing_energy"] == pytest.approx(other.sides["mesh"]["killing_energy"], rel=1e-6)
        for name in ("killing_energy", "volume_drift"):
            assert one.sides["implicit"][name] == pytest.approx(other.sides["implicit"][name], rel=1e-3)


@pytest.mark.nightly
def test_the_same_case_gives_the_same_numbers(small_run, small_cases):
    again = run_case(small_cases[0])
    first = small_run.records[0].sides["implicit"]
    for name in ("killing_energy", "volume_after", "error_rms"):
        assert again.sides["implicit"][name] == first[name]


def test_progress_is_told_of_every_step_of_the_neural_edit(small_cases):
    told = []
    rigid = next(c for c in small_cases if c.operation == "rigid")
    run_case(rigid, progress=lambda step, steps, what: told.append((step, steps, what)))
    of_the_field = [(step, steps, what) for step, steps, what in told if what.endswith("neural field") and step > 0]
    assert of_the_field == [(k, 3, "bulb, rigid, neural field") for k in (1, 2, 3)]
    assert told[0][2] == "bulb, the common mesh"
    assert told[-1][2].startswith("bulb, rigid, ")


def test_a_shape_that_does_not_exist_is_a_row(tmp_path):
    """Even its key cannot be had, for that needs the file."""
    with pytest.raises(FileNotFoundError):
        run_cases([Case(str(tmp_path / "gone.obj"), "smooth")])


@pytest.mark.nightly
def test_an_editor_that_stops_short_is_named_in_the_notes(shape_file):
    """The explicit method on the mesh grows instead of shrinking at a step far beyond its limit."""
    parameters = {"steps": 4, "step_size": 0.01, "mesh": {"method": "explicit", "preserve_volume": None}}
    case = Case(str(shape_file), "smooth", parameters=parameters, vertices=500, resolution=32)
    record = run_case(case)
    short = [name for name, side in record.sides.items() if not side["complete"]]
    assert "mesh" in short
    for name in short:
        assert any(record.sides[name]["status"] in note for note in record.notes)


def failing(*_):
    raise RuntimeError("The solver gave up.")


def test_the_mesh_keeps_its_row_where_the_neural_side_fails(small_cases, tmp_path, monkeypatch):
    """For each operation: numbers, a file and a section of the report of the mesh, and the reason of the other side."""
    monkeypatch.setattr("compare.runs.operations._edit_field", failing)
    records = run_cases(small_cases, folder=tmp_path, on_failure="record")
    assert all(record.failed for record in records)
    for record in records:
        assert record.sides["implicit"].status == "Failed. RuntimeError: The solver gave up."
        assert record.sides["mesh"].killing_energy >= 0
        assert set(record.artefacts) == {"before", *record.sides} - {"implicit"}
        assert any("neural: Failed. RuntimeError" in note for note in record.notes)
    assert "error_rms" in next(r for r in records if r.case.operation == "geometric").sides["mesh"]
    assert (
        "error_rms" not in next(r for r in records if r.case.operation == "smooth").sides["mesh"]
    )  # which is judged by the other side
    page = report(records, tmp_path / "report.html").read_text()
    assert page.count('class="case"') == 3
    assert "The solver gave up." in page
    assert read(tmp_path) == records


def test_the_field_keeps_its_row_where_the_mesh_fails(small_cases, tmp_path, monkeypatch):
    from compare.operations.operation import operation_of

    case = next(case for case in small_cases if case.operation == "geometric")
    monkeypatch.setattr(type(operation_of("geometric")), "mesh_editors", lambda _: {"mesh": failing})
    (record,) = run_cases([case], folder=tmp_path, on_failure="record")
    assert record.failed
    assert record.sides["mesh"].status == "Failed. RuntimeError: The solver gave up."
    assert record.sides["implicit"].volume_after > 0
    assert set(record.artefacts) == {"field", "before", "implicit"}
    assert record.between == {}


def test_a_case_fails_where_both_sides_do(small_cases, monkeypatch):
    from compare.operations.operation import operation_of

    monkeypatch.setattr(type(operation_of("geometric")), "mesh_editors", lambda _: {"mesh": failing})
    monkeypatch.setattr("compare.runs.operations._edit_field", failing)
    with pytest.raises(RuntimeError, match="gave up"):
        run_case(next(case for case in small_cases if case.operation == "geometric"))


def test_a_field_that_leaves_its_bounds_costs_the_mesh_nothing(small_run, small_cases, monkeypatch):
    """Its surface cannot be extracted any more, which is known only after the edit."""

    def outside(*_):
        raise implicit.SurfaceError("The surface leaves the bounds.")

    monkeypatch.setattr("compare.runs.run.measure_field", outside)
    case = next(case for case in small_cases if case.operation == "geometric")
    record = run_case(case)
    assert record.failed
    assert "leaves the bounds" in record.sides["implicit"].status
    assert record.sides["mesh"].volume_drift == by_operation(small_run, "geometric").sides["mesh"].volume_drift


def test_what_an_edit_notes_reaches_the_record(small_cases, monkeypatch):
    from dataclasses import replace

    from compare.runs import operations

    edit = operations._edit_field
    monkeypatch.setattr(
        operations, "_edit_field", lambda *given: replace(edit(*given), notes=["Three handles were closed."])
    )
    record = run_case(next(case for case in small_cases if case.operation == "geometric"))
    assert "bulb, geometric, neural: Three handles were closed." in record.notes
