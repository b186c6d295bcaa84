"""Polygons of files as triangles: areas and volumes in closed form, and no edge of more than two faces."""

import numpy as np
import pytest

from meshref import MeshError, area, check_mesh, mend_mesh, read_mesh, volume, write_mesh
from meshref.formats.polygons import triangulated
from meshref.measures import doubled_area_vectors
from meshref.topology import edge_table

# A C of area 10 x 6 - 5 x 6 = 30: a square ring of width 1 and 2 with a gap.
C_SHAPE = np.array([[0, 0], [6, 0], [6, 2], [2, 2], [2, 7], [6, 7], [6, 9], [0, 9], [0, 8.5], [0, 1]], dtype=float)


def doubled_area(polygon):
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def prism(polygon, height=1.0):
    """Return vertices and polygons of a prism over a polygon that runs counterclockwise."""
    n = len(polygon)
    V = np.concatenate([np.column_stack([polygon, np.full(n, z)]) for z in (0.0, height)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return V, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def write_obj(path, V, polygons):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in V.tolist()]
    path.write_text("\n".join([*lines, *("f " + " ".join(str(i + 1) for i in p) for p in polygons), ""]))


def turned_in_space(rng):
    return np.linalg.qr(rng.standard_normal((3, 3)))[0]


@pytest.mark.parametrize("start", range(10))
@pytest.mark.parametrize("place", ["here", "turned", "far"])
def test_a_prism_over_a_c_has_its_volume_and_area(tmp_path, start, place, rng):
    """Wherever the polygon's first corner is. A fan has more area, and faces that pass through each other."""
    V, polygons = prism(np.roll(C_SHAPE, start, axis=0))
    inside = doubled_area(C_SHAPE) / 2
    around = np.linalg.norm(C_SHAPE - np.roll(C_SHAPE, 1, axis=0), axis=1).sum()
    if place == "turned":
        R = turned_in_space(rng)
        V = V @ (R if np.linalg.det(R) > 0 else -R)
    elif place == "far":
        V = V + np.array([7.7e5, -7.7e5, 3e5])
    write_obj(tmp_path / "c.obj", V, polygons)
    V, F, report = mend_mesh(*read_mesh(tmp_path / "c.obj"))
    assert report.self_intersections == 0
    assert volume(V, F) == pytest.approx(inside, rel=1e-9)
    assert area(V, F) == pytest.approx(2 * inside + around, rel=1e-9)


@pytest.mark.parametrize("corners", [5, 8, 30, 200])
@pytest.mark.parametrize("offset", [0.0, 7.7e5])
def test_random_stars_are_filled_once(corners, offset, rng):
    """Every triangle turns with the polygon, and their areas add up to it."""
    for _ in range(5):
        angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
        radius = rng.uniform(0.2, 3, corners)[:, None]
        flat = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        R = turned_in_space(rng)
        V = np.column_stack([flat, np.zeros(corners)]) @ R + offset
        F = triangulated(V, [list(range(corners))])
        along = doubled_area_vectors(V, F) @ R[2] * np.sign(doubled_area(flat))
        wanted = abs(doubled_area(flat))
        assert len(F) == corners - 2
        assert along.min() > -1e-7 * (1 + offset / 1e5)
        assert along.sum() == pytest.approx(wanted, rel=1e-12 if offset == 0 else 1e-8)
        assert np.linalg.norm(doubled_area_vectors(V, F), axis=1).sum() == pytest.approx(wanted, rel=1e-8)


def test_a_dart_is_split_at_its_reflex_corner():
    V = np.array([[0, 0, 0], [4, 0, 0], [1, 1, 0], [0, 4, 0]], dtype=float)
    for turn in range(4):
        F = triangulated(V, [np.roll(np.arange(4), turn).tolist()])
        assert all(2 in face for face in F.tolist())
        assert doubled_area_vectors(V, F)[:, 2].sum() == pytest.approx(8)


def test_a_quad_that_shares_three_corners_with_a_neighbour_is_split_otherwise():
    """Both fans would have the diagonal 0 to 2, an edge of four faces."""
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.4, 0.4, 1]], dtype=float)
    F = triangulated(V, [[0, 1, 2, 3], [2, 1, 0, 4], [0, 3, 4], [3, 2, 4]])
    assert edge_table(F, 5).faces.max() == 2
    check_mesh(V, F[:, ::-1], closed=True)
    assert [set(face) for face in F[:2].tolist()] in ([{0, 1, 3}, {1, 2, 3}], [{0, 1, 2}, {0, 2, 3}])


def test_polygons_that_are_there_twice_have_the_same_triangles_whichever_way_they_go_round():
    """With another diagonal for the second, each edge would have four faces and nothing could be dropped."""
    V, polygons = prism(np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
    again = [np.roll(polygon[::-1] if k % 2 else polygon, k).tolist() for k, polygon in enumerate(polygons)]
    V, F, report = mend_mesh(V, triangulated(V, [*polygons, *again]))
    assert volume(V, F) == pytest.approx(1, rel=1e-14)
    assert report.dropped_faces == 12


def test_a_diagonal_that_is_a_side_of_another_polygon_is_not_taken():
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.9, 0.1, 1]], dtype=float)
    F = triangulated(V, [[0, 1, 2, 3], [0, 2, 4]])
    assert not any({0, 2} <= set(face) for face in F[:2].tolist())


def test_corners_on_a_line_and_repeated_ones_make_no_hole():
    square = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])
    V, polygons = prism(square)
    polygons[1] = [polygons[1][0], *polygons[1]]
    F = triangulated(V, polygons)
    V, F, _ = mend_mesh(V, F)
    assert volume(V, F) == pytest.approx(1, rel=1e-14)
    assert area(V, F) == pytest.approx(6, rel=1e-14)


def test_triangles_stay_in_the_order_of_their_polygons():
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [3, 1, 0], [2, 3, 0]], dtype=float)
    F = triangulated(V, [[1, 4, 2], [0, 1, 2, 3], [4, 5, 6, 2, 1], [4, 5, 2]])
    np.testing.assert_array_equal(F[0], [1, 4, 2])
    np.testing.assert_array_equal(F[1:3], [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(F[-1], [4, 5, 2])
    assert len(F) == 7


def test_a_polygon_through_a_corner_twice_is_filled_or_refused(tmp_path):
    """A frame, its inner and outer edges joined by a cut, is one polygon; a figure of eight through a corner is not."""
    V = np.array([[0, 0], [3, 0], [3, 3], [0, 3], [1, 1], [1, 2], [2, 2], [2, 1]], dtype=float)
    V = np.column_stack([V, np.zeros(8)])
    F = triangulated(V, [[0, 1, 2, 3, 0, 4, 5, 6, 7, 4]])
    assert np.linalg.norm(doubled_area_vectors(V, F), axis=1).sum() / 2 == pytest.approx(8)
    write_obj(tmp_path / "eight.obj", V, [[0, 1, 6, 4, 7, 6, 3]])
    try:
        V, F = read_mesh(tmp_path / "eight.obj")
    except MeshError as error:
        assert "how it is meant to be filled cannot be told" in str(error)  # noqa: PT017


def test_polygons_of_all_formats_are_filled_alike(tmp_path):
    V, polygons = prism(C_SHAPE)
    n, m = len(V), len(polygons)
    points = "\n".join(" ".join(map(repr, p)) for p in V.tolist())
    faces = "\n".join(" ".join(map(str, [len(p), *p])) for p in polygons)
    (tmp_path / "c.off").write_text(f"OFF\n{n} {m} 0\n{points}\n{faces}\n")
    head = f"ply\nformat ascii 1.0\nelement vertex {n}\n" + "".join(f"property double {x}\n" for x in "xyz")
    (tmp_path / "c.ply").write_text(
        f"{head}element face {m}\nproperty list uchar int vertex_indices\nend_header\n{points}\n{faces}\n"
    )
    write_obj(tmp_path / "c.obj", V, polygons)
    wanted = read_mesh(tmp_path / "c.obj")
    for name in ("c.off", "c.ply"):
        for a, b in zip(read_mesh(tmp_path / name), wanted):
            np.testing.assert_array_equal(a, b)
    write_mesh(tmp_path / "again.off", *wanted)
