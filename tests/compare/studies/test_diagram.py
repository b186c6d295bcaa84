"""Diagrams of work and precision: what is measured, kept and drawn."""

import json
import math

import numpy as np
import pytest

from compare.commands import exits
from compare.commands.study import Study, study
from compare.errors import InputError
from compare.studies import diagram_run
from compare.studies.diagram import Diagram, DiagramRow, Point, timed
from compare.studies.diagram_page import comparisons, sentences
from compare.studies.diagram_run import read_rows, run_diagram
from compare.studies.diagrams import DIAGRAMS
from compare.studies.work_precision import WorkPrecision


class Made(Diagram):
    """A diagram of two power laws, whose last point fails as often as told."""

    name, title = "made", "Two power laws"
    shapes = quick_shapes = known_shapes = ("sphere",)
    costs = ("seconds", "numbers")

    def __init__(self, failures=0):
        self.panels = {"volume": "error"}
        self.failures, self.measured = failures, []

    def points(self, shapes, quick, folder, progress):
        return [
            Point(
                DiagramRow(f"{side}/{n}", "volume", shapes[0], side, "way", self.costs, {"cells": n}),
                lambda side=side, n=n: self._measure(side, n),
            )
            for side in ("field", "mesh")
            for n in (10, 100, 1000)
        ]

    def _measure(self, side, n):
        self.measured.append((side, n))
        if (side, n) == ("mesh", 1000) and self.failures > 0:
            self.failures -= 1
            raise RuntimeError("The mesh was lost.")
        order = {"field": 2, "mesh": 1}[side]
        return {"error": n**-order, "numbers": n, "seconds": (n / 1e3, n / 900, n / 800)}


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the drawing out, which takes longer than all else."""
    monkeypatch.setattr(diagram_run, "sum_up", lambda diagram, rows, folder: None)


def test_what_was_measured_is_kept_and_what_failed_is_measured_again(tmp_path, undrawn):
    diagram = Made(failures=1)
    first = run_diagram(diagram, tmp_path)
    assert [row.failed for row in first] == [False] * 5 + [True]
    assert first[-1].status == "RuntimeError: The mesh was lost."
    again = run_diagram(diagram, tmp_path)
    assert not any(row.failed for row in again)
    assert diagram.measured[6:] == [("mesh", 1000)]
    assert [row.key for row in read_rows(tmp_path)] == [row.key for row in again]


def test_a_line_that_was_cut_off_is_measured_again(tmp_path, undrawn):
    run_diagram(Made(), tmp_path)
    path = tmp_path / "rows.jsonl"
    path.write_bytes(path.read_bytes()[:-20])
    diagram = Made()
    run_diagram(diagram, tmp_path)
    assert diagram.measured == [("mesh", 1000)]


def test_the_folder_has_the_chart_the_page_and_the_table(tmp_path):
    rows = run_diagram(Made(), tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<svg" in page
    for said in sentences(Made(), rows):
        assert said in page
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "chart.svg").read_text().count("</svg>") == 1
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 7
    assert json.loads((tmp_path / "diagram.json").read_text()) == {
        "diagram": "made",
        "shapes": ["sphere"],
        "quick": False,
    }


def test_a_folder_of_another_diagram_is_refused(tmp_path, undrawn):
    run_diagram(Made(), tmp_path)
    with pytest.raises(InputError, match="quick was False, and is True now"):
        run_diagram(Made(), tmp_path, quick=True)
    with pytest.raises(InputError, match="one of sphere"):
        run_diagram(Made(), tmp_path, shapes=["ball"])


def test_an_error_below_that_of_the_reference_counts_as_that(tmp_path):
    rows = [
        DiagramRow("a", "volume", "s", "field", "m", ("numbers",), {}, numbers=10, error=1e-9, floor=1e-3),
        DiagramRow("b", "volume", "s", "mesh", "m", ("numbers",), {}, numbers=30, error=1e-3, floor=1e-3),
    ]
    found = comparisons(rows, "volume", "numbers")["s"]
    assert found.best == (1e-3, 1e-3)
    assert found.ratios == pytest.approx((3, 3))


def test_no_row_rests_on_one_timing():
    _, seconds = timed(lambda: None, 3)
    assert len(seconds) == 3
    assert all(value >= 0 for value in seconds)


def test_volumes_of_a_torus_fall_with_the_fourth_power_of_the_cell_and_with_the_number_of_vertices(tmp_path):
    """The quadrature is of order 4; the chords of so many vertices are off by one over their number."""
    points = WorkPrecision().points(["torus"], True, tmp_path, None)
    found = {}
    for point in points:
        if point.row.method in ("quadrature", "flat triangles"):
            measured = point.measure()
            assert len(measured["seconds"]) >= 2
            found.setdefault(point.row.side, []).append((measured["error"], measured["numbers"], point.row.at))
    (coarse, _, at), (fine, numbers, at_fine) = found["field"]
    assert numbers == 2
    assert math.log(coarse / fine) / math.log(at_fine["cells"] / at["cells"]) > 3.5
    (coarse, few, _), (fine, many, _) = found["mesh"]
    assert math.log(coarse / fine) / math.log(many / few) == pytest.approx(1, abs=0.35)


def test_the_shrinking_sphere_is_its_own_reference(tmp_path):
    """Radius R^2 - 4 t: a mesh of so many vertices is off by its chords, so by less on more."""
    points = WorkPrecision().points(["sphere"], True, tmp_path, None)
    found = [p.measure() for p in points if p.row.panel == "smoothing" and p.row.method == "converged steps"]
    assert all(row["floor"] < 1e-12 for row in found)
    assert 0 < found[1]["error"] < found[0]["error"] < 0.01


def test_the_command_measures_a_diagram_goes_on_with_its_folder_and_says_who_is_cheaper(
    tmp_path, undrawn, monkeypatch, capsys
):
    diagram = Made(failures=1)
    monkeypatch.setitem(DIAGRAMS, "made", diagram)
    folder = tmp_path / "out"
    assert study(Study(name="made", output=folder, quiet=True)) == exits.FAILED
    assert study(Study(name=str(folder))) == exits.DONE
    assert len(diagram.measured) == 7
    said = capsys.readouterr().out
    assert said.startswith("Volume, sphere, against seconds: ")
    assert "the field" in said
    for refused in (Study(name="made", workers=2), Study(name=str(folder), quick=True)):
        with pytest.raises(InputError, match="Leave the option"):
            study(refused)


@pytest.mark.nightly
@pytest.mark.parametrize("name", sorted(DIAGRAMS))
def test_the_quick_diagram_measures_every_point(name, tmp_path):
    rows = run_diagram(DIAGRAMS[name], tmp_path, quick=True)
    assert [row.status for row in rows if row.failed] == []
    assert all(len(row.seconds) >= 2 for row in rows if "seconds" in row.costs)
    panels = {row.panel for row in rows}
    assert panels == set(DIAGRAMS[name].panels)
    assert len(sentences(DIAGRAMS[name], rows)) == len(panels) * len(DIAGRAMS[name].costs)


def test_networks_are_fitted_to_exact_distances(tmp_path):
    """Of the torus they have a closed form; a mesh alone would be off by its chords, many times more."""
    import meshref
    from compare.studies.workbench import Workbench, exact_distances

    bench = Workbench(tmp_path, fit_steps=1, resolution=32)
    V, F = bench.mesh("torus", 1500)
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (2000, 3))
    points[:500] = meshref.sample_mesh(V, F, 500).points
    x, y, z = points.T
    truth = np.hypot(np.hypot(x, y) - 0.55, z) - 0.25
    near = np.abs(truth) < 0.1
    distance, normal = exact_distances(bench.field("torus"), V, F, points)
    chords = np.abs(meshref.SignedDistanceQuery(V, F)(points).distance - truth)[near]
    assert near.sum() > 600
    assert np.abs(distance - truth)[near].max() < 0.02 * chords.max()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1)
