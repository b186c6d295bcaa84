"""The shapes that the other tests rely on."""

import numpy as np
import pytest

from meshref import box, check_mesh, cylinder, genus, icosphere, torus


@pytest.mark.parametrize(
    ("mesh", "faces", "holes"),
    [
        (icosphere(0), 20, 0),
        (icosphere(2), 320, 0),
        (icosphere(3, 2.0, (1, 2, 3)), 1280, 0),
        (torus(9, 7), 126, 1),
        (box(subdivisions=2), 192, 0),
        (cylinder(9, 4), 90, 0),
        (cylinder(3, 1), 12, 0),
    ],
    ids=["icosahedron", "icosphere", "moved icosphere", "torus", "box", "cylinder", "prism"],
)
def test_shapes_are_solids_with_the_stated_faces(mesh, faces, holes):
    V, F = check_mesh(*mesh, closed=True, self_intersections="refuse")
    assert len(F) == faces
    assert genus(V, F) == holes


def test_points_lie_on_the_shapes():
    V, _ = icosphere(3, 2.0, (1, 2, 3))
    np.testing.assert_allclose(np.linalg.norm(V - [1, 2, 3], axis=1), 2, rtol=1e-14)
    V, _ = torus(13, 9, 2.0, 0.5)
    np.testing.assert_allclose(np.hypot(np.hypot(V[:, 0], V[:, 1]) - 2, V[:, 2]), 0.5, rtol=1e-13)
