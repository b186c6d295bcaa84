"""Boxes of a grid that share corners, edges and faces, as one mesh: held against sums over the grid's cells."""

import numpy as np
import pytest
from nasty_solids import of_boxes

import meshref
from meshref.check import MeshError, intersecting_faces

QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
SIDES = np.array([1.0, 0.7, 1.3])


def of_cells(cells, *, walls):
    """Return the faces of cells of a grid, each corner once; with walls between two there once for each."""
    filled = set(map(tuple, cells))
    quads = []
    for cell in filled:
        for axis, end in ((2, -1), (2, 1), (1, -1), (1, 1), (0, -1), (0, 1)):
            beside = list(cell)
            beside[axis] += end
            if walls or tuple(beside) not in filled:
                quads.append(
                    CORNERS[QUADS[[(2, -1), (2, 1), (1, -1), (1, 1), (0, -1), (0, 1)].index((axis, end))]] + cell
                )
    places, number = np.unique(np.concatenate(quads), axis=0, return_inverse=True)
    corners = number.reshape(-1, 4)
    return places * SIDES + 0.1, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


@pytest.mark.parametrize(
    ("other", "bodies", "said"),
    [
        ((1, 0, 0), 1, "removed 4 faces of walls between solids"),
        ((1, 1, 0), 2, "cut the surface apart in edges where solids touch, at 2 vertices"),
        ((1, 1, 1), 2, "separated sheets that touched in 1 vertex"),
    ],
    ids=["face", "edge", "corner"],
)
@pytest.mark.parametrize("inside_out", [False, True])
def test_two_boxes_that_share_corners_are_told_apart(other, bodies, said, inside_out):
    V, F = of_cells([(0, 0, 0), other], walls=True)
    V, F, report = meshref.mend_mesh(V, F[:, ::-1] if inside_out else F)
    assert report.steps[0] == said
    assert (report.bodies, report.united_parts, report.self_intersections) == (bodies, 0, 0)
    assert meshref.volume(V, F) == pytest.approx(2 * SIDES.prod(), rel=1e-12)
    assert meshref.genus(V, F) == 0


def test_a_ring_of_boxes_closed_by_an_edge_is_open_there():
    """Seven of the eight cells round a hole, and the eighth moved up: it touches both its neighbours in edges."""
    ring = [(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)]
    V, F, _ = meshref.mend_mesh(*of_cells(ring, walls=False))
    assert meshref.genus(V, F) == 1
    V, F, report = meshref.mend_mesh(*of_cells([*ring[:-2], (2, 1, 1), (2, 2, 0)], walls=False))
    assert (report.bodies, meshref.genus(V, F)) == (2, 0)


@pytest.mark.parametrize(
    "seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(4, 200))]
)
def test_random_cells_have_their_volume_area_and_bodies_or_are_refused(seed):
    rng = np.random.default_rng(seed)
    cells = np.argwhere(rng.random((3, 3, 2 + seed % 2)) < rng.choice([0.3, 0.5, 0.7]))
    V, F = of_cells(cells, walls=seed % 3 == 0)
    want = of_boxes([(cell * SIDES, (cell + 1) * SIDES, 1) for cell in cells])
    try:
        V, F, report = meshref.mend_mesh(V, F)
    except MeshError:
        with pytest.raises(MeshError, match="more than two faces meet"):
            meshref.mend_mesh(V, F)
        return
    assert meshref.volume(V, F) == pytest.approx(want["volume"], rel=1e-9)
    assert meshref.area(V, F) == pytest.approx(want["area"], rel=1e-9)
    assert report.bodies == want["bodies"]


def test_faces_on_both_sides_of_an_edge_in_one_plane_do_not_cross_whichever_way_they_run():
    V = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0.5, 0], [0.5, 0.5, 0]], dtype=float)
    for second in ([0, 1, 3], [1, 0, 3]):
        assert len(intersecting_faces(V, np.array([[0, 1, 2], second]))) == 0
        folded = np.where(np.array(second) == 3, 4, second)
        assert len(intersecting_faces(V, np.array([[0, 1, 2], folded]))) == 1
