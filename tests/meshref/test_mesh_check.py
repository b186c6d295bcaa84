"""The gate: what passes, and that each refusal names the place and the remedy."""

import numpy as np
import pytest

from meshref import MeshError, box, check_mesh, icosphere, torus


def test_good_meshes_pass_unchanged():
    for V, F in (icosphere(1), torus(12, 8), box()):
        checked_V, checked_F = check_mesh(V, F, closed=True, self_intersections="refuse")
        assert checked_V is V
        np.testing.assert_array_equal(checked_F, F)


def test_lists_other_types_and_orders_are_converted():
    V, F = box()
    for vertices, faces in (
        (V.tolist(), F.tolist()),
        (V.astype(np.float32), F.astype(np.uint8)),
        (np.asfortranarray(V), np.asfortranarray(F)),
        (V, F.astype(float)),
        (V.astype(int), F),
    ):
        checked_V, checked_F = check_mesh(vertices, faces, closed=True)
        assert checked_V.dtype == np.float64
        assert checked_F.dtype == np.int64
        assert checked_V.flags.c_contiguous
        assert checked_F.flags.c_contiguous
        np.testing.assert_array_equal(checked_F, F)


def _with(array, at, value):
    """A copy with one entry changed."""
    changed = np.array(array)
    changed[at] = value
    return changed


BREAK = {
    "nan": lambda V, F: (_with(V, (7, 1), np.nan), F),
    "infinite": lambda V, F: (_with(V, (3, 0), np.inf), F),
    "too large an index": lambda V, F: (V, _with(F, (5, 2), len(V))),
    "negative index": lambda V, F: (V, _with(F, (5, 2), -1)),
    "unreferenced": lambda V, F: (np.concatenate([V, [[0, 0, 0]]]), F),
    "repeated corner": lambda V, F: (V, _with(F, (4, 1), F[4, 0])),
    "flat": lambda V, F: (
        np.concatenate([V, [(V[F[0, 0]] + V[F[0, 1]]) / 2]]),
        np.concatenate([F, [[F[0, 0], F[0, 1], len(V)]]]),
    ),
    "fractions": lambda V, F: (V, F + 0.5),
    "2d": lambda V, F: (V[:, :2], F),
    "quads": lambda V, F: (V, np.zeros((2, 4), dtype=int)),
    "no faces": lambda V, F: (V, F[:0]),
    "no vertices": lambda V, F: (V[:0], F),
    "complex": lambda V, F: (V + 1j, F),
    "words": lambda V, F: (np.full(V.shape, "x"), F),
    "ragged": lambda V, F: ([[0, 0, 0], [1, 0]], F),
}


def broken(what):
    return BREAK[what](*icosphere(1))


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("nan", r"must be finite.*V\[7\] = \(.*nan"),
        ("infinite", r"must be finite.*V\[3\] = \(inf"),
        ("too large an index", r"F must index the 42 rows.*F\[5, 2\] = 42"),
        ("negative index", r"F\[5, 2\] = -1"),
        ("unreferenced", r"one is unreferenced, first vertex 42.*mend_mesh"),
        ("repeated corner", r"one is degenerate, first face 4 .*mend_mesh"),
        ("flat", r"one is degenerate, first face 80 "),
        ("fractions", r"whole numbers, but F\[0, 0\]"),
        ("2d", r"V must have shape \(k, 3\).*\(42, 2\)"),
        ("quads", r"F must have shape \(m, 3\).*\(2, 4\).*triangles"),
        ("no faces", r"needs vertices and faces.*F has 0"),
        ("no vertices", r"V has 0"),
        ("complex", r"real numbers"),
        ("words", r"real numbers"),
        ("ragged", r"real numbers"),
    ],
)
def test_unusable_arrays_are_refused_with_the_place(what, message):
    with pytest.raises(MeshError, match=message):
        check_mesh(*broken(what))


def test_degenerate_faces_are_let_through_on_request():
    V, F = broken("flat")
    check_mesh(V, F, degenerate="allow")


def test_an_open_mesh_is_no_solid():
    V, F = icosphere(2)
    check_mesh(V, F[1:], oriented=True)
    with pytest.raises(MeshError, match=r"must be closed, but 3 edges .* first the edge of vertices \d+ and \d+ near"):
        check_mesh(V, F[1:], closed=True)


def test_inward_faces_are_no_solid():
    V, F = icosphere(2)
    with pytest.raises(MeshError, match=r"outwards, but the signed volume is -4\.0.*mend_mesh"):
        check_mesh(V, F[:, ::-1], closed=True)


def test_one_turned_face_is_found():
    V, F = icosphere(2)
    F[17] = F[17, ::-1]
    with pytest.raises(MeshError, match=r"oriented alike, but 3 pairs are not, .* 17 .*mend_mesh"):
        check_mesh(V, F, oriented=True)


def test_an_edge_of_three_faces_is_found():
    V, F = box()
    V, F = np.concatenate([V, [[2.0, 2.0, 2.0]]]), np.concatenate([F, [[F[0, 0], F[0, 1], 8]]])
    with pytest.raises(MeshError, match=rf"at most two faces.* edge of vertices {min(F[0, :2])} and {max(F[0, :2])} "):
        check_mesh(V, F, oriented=True)


def test_two_bodies_that_share_a_vertex_are_pinched():
    V, F = box()
    second = np.where(F == 7, 0, 8 + F)  # corner 7 of the second, moved by -1, is corner 0 of the first
    V2, F2 = np.concatenate([V, V[:7] - 1]), np.concatenate([F, second])
    with pytest.raises(MeshError, match=r"one fan, but one vertex joins several sheets, first vertex 0 at \(0, 0, 0\)"):
        check_mesh(V2, F2, closed=True)


def test_faces_that_pass_through_each_other_are_found_on_request():
    V, F = icosphere(1)
    V2, F2 = np.concatenate([V, V + np.array([1.0, 0.1, 0.03])]), np.concatenate([F, F + len(V)])
    check_mesh(V2, F2, closed=True)
    with pytest.raises(MeshError, match=r"must not pass through each other, but \d+ pairs do"):
        check_mesh(V2, F2, self_intersections="refuse")
