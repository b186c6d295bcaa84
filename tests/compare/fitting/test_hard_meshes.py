"""Meshes with thin parts, many handles and several surfaces: what they are, and that fits and runs do not lose it."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

import implicit
import meshref
from compare import Case
from compare.cases.subject import Subject
from compare.fitting import fit
from compare.fitting.fit import fit_mesh, place_in_cube
from compare.operations.neural import run_edit
from compare.runs.subject import common_mesh, sufficient_resolution
from implicit import shapes

# By its file: importing the package of the benchmarks sets variables of the process.
_spec = importlib.util.spec_from_file_location(
    "hard_meshes", Path(__file__).parents[3] / "benchmarks" / "hard_meshes.py"
)
hard_meshes = sys.modules["hard_meshes"] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hard_meshes)
BUDGET, MESHES = hard_meshes.BUDGET, hard_meshes.MESHES


LARGE = ("chain", "screw", "bowl", "knot")  # of more than 10,000 faces


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.nightly] if n in LARGE else []) for n in MESHES])
def test_the_meshes_are_what_their_table_holds_them_against(name):
    hard = MESHES[name]
    V, F, report = meshref.mend_mesh(*hard.make())
    assert report.turned_faces == report.self_intersections == report.united_parts == 0
    assert meshref.component_count(V, F) == hard.surfaces
    assert meshref.genus(V, F) == hard.genus
    if hard.volume is not None:
        assert meshref.volume(V, F) == pytest.approx(hard.volume, rel=1e-12)


PLATE, MIDDLE = (0.2, 0.1, 0.012), (0.0, 0.0, 0.0156)  # half sides, between two nodes of 64 cells along the bounds


def plate():
    """A box as thin as a blade, as an exact field and as a mesh."""
    V, F = meshref.box()
    return shapes.box(PLATE, MIDDLE, edge=0.002), 2 * (V - V.mean(axis=0)) * PLATE + MIDDLE, F


def test_a_plate_thinner_than_a_cell_is_measured_with_finer_cells(monkeypatch):
    monkeypatch.setattr(fit, "QUADRATURE", 64)
    monkeypatch.setattr(fit, "RESOLUTION", 96)
    field, V, F = plate()
    with pytest.raises(implicit.SurfaceError, match="no surface"):
        implicit.surface_quadrature(field, fit.QUADRATURE)
    found = fit._compare_surfaces(field, V, F, samples=500, seed=0, quality=fit.GOOD_DISTANCE)
    assert found.faults == []
    assert abs(found.volume_error) < 0.01  # of its edges, which are round


def test_the_common_mesh_of_a_plate_is_whole_where_the_cells_of_the_case_are_too_few():
    field, V, F = plate()
    cells = sufficient_resolution(field, 32)
    assert cells > 64
    V2, F2, remarks = common_mesh(field, 400, cells)
    assert remarks == []
    assert meshref.volume(V2, F2) == pytest.approx(meshref.volume(V, F), rel=0.1)
    assert sufficient_resolution(shapes.sphere(0.6), 32) == 32


@pytest.mark.parametrize(("needed", "told"), [(0, 48), (32, 48), (64, 64), (256, 96)])
def test_the_editors_of_a_thin_shape_look_at_as_many_cells_as_its_surface_needs(needed, told):
    seen = []

    def editor(field, *, resolution=48, track, progress, seed):
        seen.append(resolution)
        raise InterruptedError

    V, F = meshref.icosphere(1, radius=0.6)
    subject = Subject(shapes.sphere(0.6), V, F, V / 0.6, resolution=needed)
    with pytest.raises(InterruptedError):
        run_edit(editor, Case("ball", "smooth", resolution=32), subject, "none")
    assert seen == [told]
    assert (subject.cells(32), subject.cells(256)) == (max(needed, 32), 256)


@pytest.mark.nightly
@pytest.mark.parametrize("name", MESHES)
def test_each_is_fitted_to_the_stated_quality_with_its_surfaces_and_handles(name):
    hard = MESHES[name]
    V, F = hard.make()
    _, report = fit_mesh(V, F, budget=BUDGET)
    assert report.good, report.verdict
    assert (report.components, report.genus) == (hard.surfaces, hard.genus)
    placed, units = place_in_cube(V)
    assert meshref.volume(placed, F) * units.scale**3 == pytest.approx(meshref.volume(V, F))


@pytest.mark.nightly
@pytest.mark.parametrize("name", MESHES)
def test_a_quick_run_of_each_ends_with_every_row_or_a_reason(name, tmp_path, capsys):
    from compare.commands.cli import main

    path = tmp_path / "mesh.ply"
    meshref.write_mesh(path, *MESHES[name].make())
    main(["run", str(path), "--quick", "--quiet", "--bodies", "largest", "-o", str(tmp_path / "run")])
    rows = [json.loads(line) for line in (tmp_path / "run" / "results.jsonl").read_text().splitlines()]
    assert sorted(row["case"]["operation"] for row in rows) == ["geometric", "rigid", "smooth"]
    for row in rows:
        sides = row["sides"] or {side: {"complete": False, "status": row["status"]} for side in ("implicit", "mesh")}
        assert {"implicit", "mesh"} <= set(sides)
        for side in sides.values():
            assert side["complete"] or side["status"].endswith(".")
