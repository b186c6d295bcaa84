"""Results say what they are in a few lines, and dump no array."""

import numpy as np
import pytest

import meshref
from meshref import box, icosphere

V, F = icosphere(2)  # 162 vertices
HANDLES = [0, 5, 9, 30]
SHIFT = np.tile([0.125, 0.0, 0.0], (4, 1))


RESULTS = {
    "KillingResult": (
        lambda: meshref.killing(V, F, HANDLES, SHIFT),
        ["displacement=float64[162, 3]", "status=SOLVED", "solver='superlu'", "solve: "],
    ),
    "ArapResult": (
        lambda: meshref.arap(V, F, HANDLES, V[HANDLES] + SHIFT),
        ["V=float64[162, 3]", "status=CONVERGED", "x ArapStep>"],
    ),
    "BiharmonicResult": (
        lambda: meshref.biharmonic(V, F, HANDLES, SHIFT),
        ["displacement=float64[162, 3]", "status=SOLVED"],
    ),
    "FlowResult": (
        lambda: meshref.mean_curvature_flow(V, F, steps=2, step_size=1e-3, snapshot_every=1),
        ["V=float64[162, 3]", "<3 x FlowStep>", "status=FINISHED", "steps_taken=2", "<3 x ndarray>"],
    ),
    "SignedDistance": (
        lambda: meshref.signed_distance(V, F, np.zeros((5, 3))),
        ["distance=float64[5]", "face=int64[5]", "normal=float64[5, 3]"],
    ),
    "MeshSample": (
        lambda: meshref.sample_mesh(V, F, 7),
        ["(points=float64[7, 3], face=int64[7], normals=float64[7, 3])"],
    ),
    "SurfaceDistance": (
        lambda: meshref.surface_distance(V, F, V + SHIFT[0], F, 50),
        ["(mean_1_to_2=0.0", "max_2_to_1=0.125", "normal_consistency=0.9"],
    ),
    "MeshlabDistance": (
        lambda: meshref.MeshlabDistance(0.5, 0.25, 1 / 3, 0.125),
        ["(max_1_to_2=0.5, max_2_to_1=0.25, mean_1_to_2=0.3333, mean_2_to_1=0.125)"],
    ),
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_one_line_with_shapes_and_status(name):
    make, shown = RESULTS[name]
    text = repr(make())
    assert text.startswith(f"{name}(")
    assert "\n" not in text
    assert len(text) < 260
    for words in shown:
        assert words in text


def test_a_report_of_mending_is_a_line_for_each_thing_done():
    W, G = box()
    assert repr(meshref.mend_mesh(W, G)[2]) == "MendReport(1 body, 8 vertices given, changed=False)"
    torn = np.concatenate([W, W + 3]), np.concatenate([G[1:], G + 8])
    assert repr(meshref.mend_mesh(*torn)[2]).splitlines() == [
        "MendReport(2 bodies, 16 vertices given, changed=True)",
        "  closed 1 hole (of 3 edges)",
        "  kept 2 bodies that are not connected",
    ]
