"""Mending: each flaw alone, said in the report; the meshes found in the wild; and what cannot be mended."""

import numpy as np
import pytest

from meshref import MeshError, box, check_mesh, cylinder, icosphere, mend_mesh, torus, volume


def mended(V, F, **options):
    V, F, report = mend_mesh(V, F, **options)
    check_mesh(V, F, closed=not report.open_holes)
    return V, F, report


def test_a_good_mesh_is_left_as_it_is():
    V, F = torus(12, 9)
    mended_V, mended_F, report = mended(V, F)
    np.testing.assert_array_equal(mended_V, V)
    np.testing.assert_array_equal(mended_F, F)
    assert report.steps == ()
    assert not report.changed
    np.testing.assert_array_equal(report.vertex_map, np.arange(len(V)))


def test_unreferenced_vertices_are_dropped_and_said():
    V, F = icosphere(1)
    V2 = np.concatenate([[[9.0, 9, 9]], V, V[:1]])
    mended_V, _, report = mended(V2, F + 1)
    np.testing.assert_array_equal(mended_V, V)
    assert report.steps == ("dropped 2 unreferenced vertices",)
    assert report.dropped_vertices == 2
    np.testing.assert_array_equal(report.vertex_map, [-1, *range(len(V)), -1])


@pytest.mark.parametrize("jitter", [0.0, 1e-10])
def test_triangles_that_share_no_vertex_are_sewn(jitter, rng):
    V, F = icosphere(2)
    soup = V[F].reshape(-1, 3)
    soup = soup + jitter * rng.standard_normal(soup.shape)
    mended_V, mended_F, report = mended(soup, np.arange(len(soup)).reshape(-1, 3))
    assert (len(mended_V), len(mended_F)) == (len(V), len(F))
    assert report.steps == (f"merged {len(soup) - len(V)} duplicate vertices",)
    np.testing.assert_allclose(mended_V[report.vertex_map], soup, atol=1e-9)


def test_a_wider_merge_distance_is_obeyed(rng):
    V, F = icosphere(1)
    soup = V[F].reshape(-1, 3) + 1e-3 * rng.uniform(-1, 1, (3 * len(F), 3))
    faces = np.arange(len(soup)).reshape(-1, 3)
    mended_V, _, _ = mended(soup, faces, merge_distance=0.01)
    assert len(mended_V) == len(V)


def test_inward_faces_are_turned_and_said():
    V, F = icosphere(1)
    _, mended_F, report = mended(V, F[:, ::-1])
    assert report.steps == ("turned all 80 faces that looked the wrong way",)
    assert volume(V, mended_F) > 0


def test_random_turns_are_undone(rng):
    V, F = torus(12, 9)
    turned = np.where(rng.random((len(F), 1)) < 0.4, F[:, [0, 2, 1]], F)
    _, mended_F, report = mended(V, turned)
    np.testing.assert_array_equal(mended_F, F)
    assert report.turned_faces == np.count_nonzero((turned != F).any(axis=1))


def test_holes_are_closed_and_said():
    V, F = cylinder(12, 4)
    pipe = F[(len(V) - 2 > F).all(axis=1)]  # without the caps
    _, mended_F, report = mended(V[:-2], pipe, hole_limit=3)
    assert report.steps == ("closed 2 holes (of 12, 12 edges)",)
    assert report.holes == (12, 12)
    np.testing.assert_array_equal(mended_F[: len(pipe)], pipe)
    assert volume(V[:-2], mended_F) == pytest.approx(volume(V, F), rel=1e-13)
    assert report.self_intersections == 0


@pytest.mark.parametrize("missing", [1, 2, 7, 30])
def test_holes_of_any_form_are_closed(missing):
    V, F = icosphere(2)
    hole = np.argsort(V[F].mean(axis=1) @ [1.0, 0.3, 0.2])[-missing:]
    V, F, report = mended(V, np.delete(F, hole, axis=0), hole_limit=2)
    assert len(report.holes) >= 1
    assert report.self_intersections == 0


def test_a_hole_longer_than_the_limit_is_refused_or_left_open():
    V, F = box(subdivisions=2)
    F = F[~(V[F][:, :, 2] == 1).all(axis=1)]
    used = np.unique(F)
    V, F = V[used], np.searchsorted(used, F)
    with pytest.raises(MeshError, match=r"hole of 16 edges at .* 4 round, longer than the limit of 1\.732.*hole_limit"):
        mend_mesh(V, F)
    _, _, report = mended(V, F, closed=False)
    assert report.steps == ("left 1 hole open (of 16 edges)",)
    assert report.open_holes == (16,)
    closed_V, closed_F, _ = mended(V, F, hole_limit=2.5)
    assert volume(closed_V, closed_F) == pytest.approx(1, rel=1e-13)


def test_degenerate_and_doubled_faces_are_removed_and_said():
    V, F = icosphere(1)
    F2 = np.concatenate([F, F[[3]], F[[3]][:, [1, 2, 0]], [[5, 5, 6], [7, 7, 7]]])
    _, mended_F, report = mended(V, F2)
    np.testing.assert_array_equal(mended_F, F)
    assert report.steps == ("removed 2 faces without area", "removed 2 doubled faces")
    assert report.dropped_faces == 4


def test_a_corner_on_the_side_of_its_neighbour_leaves_no_slit():
    """A cube with a vertex in the middle of an edge, joined to it by a face without area."""
    V, F = box()
    middle = len(V)
    i, j, k = F[0]
    V2 = np.concatenate([V, [(V[i] + V[j]) / 2]])
    F2 = np.concatenate([F[1:], [[i, middle, k], [middle, j, k], [i, j, middle]]])
    mended_V, mended_F, report = mended(V2, F2)
    assert report.steps == ("removed 1 face without area",)
    assert volume(mended_V, mended_F) == pytest.approx(1, rel=1e-14)


def test_sheets_that_touch_in_a_vertex_are_separated_and_said():
    V, F = box()
    V2, F2 = np.concatenate([V, V[:7] - 1]), np.concatenate([F, np.where(F == 7, 0, 8 + F)])
    mended_V, mended_F, report = mended(V2, F2)
    assert report.steps == ("separated sheets that touched in 1 vertex", "kept 2 bodies that are not connected")
    assert len(mended_V) == 16
    assert volume(mended_V, mended_F) == pytest.approx(2, rel=1e-14)


def two_bodies():
    V, F = icosphere(2)
    V2, F2 = box((3, 0, 0), (4, 1, 1))
    return np.concatenate([V2, V]), np.concatenate([F2[:, ::-1], F + len(V2)]), volume(V, F)


def test_two_bodies_are_kept_each_facing_outwards():
    V, F, sphere = two_bodies()
    V, F, report = mended(V, F)
    assert report.bodies == 2
    assert report.steps == (
        "turned 12 faces that looked the wrong way",
        "kept 2 bodies that are not connected",
    )
    assert volume(V, F) == pytest.approx(sphere + 1, rel=1e-13)


def test_the_largest_of_two_bodies_is_kept_on_request():
    V, F, sphere = two_bodies()
    kept_V, kept_F, report = mended(V, F, bodies="largest")
    assert volume(kept_V, kept_F) == pytest.approx(sphere, rel=1e-13)
    assert report.steps == ("dropped 1 smaller body",)
    assert (report.dropped_vertices, report.dropped_faces) == (8, 12)
    np.testing.assert_array_equal(report.vertex_map[:8], -1)
    np.testing.assert_array_equal(kept_V[report.vertex_map[8:]], V[8:])


def test_two_bodies_are_refused_on_request():
    V, F, _ = two_bodies()
    with pytest.raises(
        MeshError, match=r"must be one body, but it has 2 .* vertices 0 at .* and 8 at .*bodies='largest'"
    ):
        mend_mesh(V, F, bodies="refuse")


@pytest.mark.parametrize("inner_faces_out", [True, False])
@pytest.mark.parametrize("bodies", ["keep", "largest", "refuse"])
def test_a_cavity_is_part_of_its_body(inner_faces_out, bodies):
    V, F = icosphere(2)
    inner = F if inner_faces_out else F[:, ::-1]
    hollow_V, hollow_F, report = mended(np.concatenate([V, V / 2]), np.concatenate([F, inner + len(V)]), bodies=bodies)
    assert (report.bodies, report.cavities) == (1, 1)
    whole = volume(V, F)
    sentence = f"1 surface inside another for a cavity: volume {whole:.6g} without it, {7 / 8 * whole:.6g} with it"
    assert f"took {sentence}" in report.steps
    assert volume(hollow_V, hollow_F) == pytest.approx(7 / 8 * volume(V, F), rel=1e-13)


def test_a_doubled_surface_becomes_one():
    V, F = icosphere(1)
    V2, _, report = mended(np.concatenate([V, V]), np.concatenate([F, F + len(V)]))
    assert report.steps == ("merged 42 duplicate vertices", "removed 80 doubled faces")
    assert len(V2) == 42


def test_crossing_faces_of_one_part_are_counted_and_left():
    V, F = cylinder(24, 16)
    bent = V.copy()
    bent[:, 0] += np.where(V[:, 2] > V[:, 2].mean(), 3 * (V[:, 2] - V[:, 2].mean()), 0)
    bent[np.abs(V[:, 2] - V[:, 2].max()) < 1e-12, 2] = V[:, 2].min() + 0.3
    _, mended_F, report = mended(bent, F)
    np.testing.assert_array_equal(mended_F, F)
    assert report.self_intersections > 0
    assert any("pass through each other, and left them so" in step for step in report.steps)


def test_mending_twice_changes_nothing(rng):
    V, F = icosphere(2)
    V, F = V[F].reshape(-1, 3), np.arange(3 * len(F)).reshape(-1, 3)
    V, F, _ = mended(V, F[5:, ::-1])
    _, F2, report = mended(V, F)
    assert not report.changed
    np.testing.assert_array_equal(F2, F)


def moebius():
    n = 12
    u = 2 * np.pi * np.arange(n) / n
    middle = np.stack([np.cos(u), np.sin(u), 0 * u], axis=1)
    across = 0.2 * np.stack([np.cos(u / 2) * np.cos(u), np.cos(u / 2) * np.sin(u), np.sin(u / 2)], axis=1)
    V = np.stack([middle - across, middle + across], axis=1).reshape(-1, 3)
    i = np.arange(n)
    c, d = np.where(i == n - 1, 1, 2 * i + 2), np.where(i == n - 1, 0, 2 * i + 3)
    return V, np.concatenate([np.stack([2 * i, 2 * i + 1, c], axis=1), np.stack([2 * i + 1, d, c], axis=1)])


def three_faces_on_an_edge():
    V, F = box()
    return np.concatenate([V, [[2.0, 2, 2]]]), np.concatenate([F, [[F[0, 0], F[0, 1], 8]]])


def with_nan():
    V, F = box()
    V[4, 2] = np.nan
    return V, F


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (with_nan, r"must be finite.*V\[4\]"),
        (lambda: (box()[0], box()[1] + 1), r"F must index.*= 8"),
        (lambda: (np.zeros((0, 3)), np.zeros((0, 3), dtype=int)), "needs vertices and faces"),
        (lambda: (box()[0], []), r"F must have shape \(m, 3\)"),
        (lambda: (np.ones((8, 3)), box()[1]), "V must span a box"),
        (three_faces_on_an_edge, "more than two faces meet in one edge, first 3 in the edge from"),
        (moebius, "must have two sides.*Moebius"),
        (lambda: (np.eye(3), [[0, 1, 2]]), "cannot be closed|longer than the limit|is flat"),
    ],
    ids=["nan", "out of range", "empty", "no faces", "a point", "three faces on an edge", "moebius", "one triangle"],
)
def test_what_cannot_be_mended_is_refused(make, message):
    V, F = make()
    with pytest.raises(MeshError, match=message):
        mend_mesh(V, F)


def test_an_unknown_choice_of_bodies_is_refused():
    with pytest.raises(MeshError, match="bodies must be one of 'keep'"):
        mend_mesh(*box(), bodies="smallest")


WILD = {
    "armadillo.obj": (),
    "bar.off": ("turned all 1440 faces that looked the wrong way",),
    "bunny-35k.obj": ("dropped 1113 unreferenced vertices", "closed 5 holes (of 22, 39, 40, 42, 80 edges)"),
    "bunny.off": (),
    "cactus.off": (),
    "cactus-highres.off": (),
    "dino.off": ("left 4 duplicate vertices apart, for more than two faces would meet in an edge",),
    "fandisk.obj": (),
    "knight.off": (),
    "rocker-arm.obj": (),
    "spot.obj": (),
}


LARGE = ("armadillo.obj", "bunny-35k.obj")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.nightly) if name in LARGE else name for name in WILD]
)
def test_meshes_found_in_the_wild_become_solids(real_mesh, name):
    _, _, report = mended(*real_mesh(name))
    assert report.steps[: len(WILD[name])] == WILD[name]
    assert report.bodies == 1
    said_of_crossings = any("pass through each other" in step for step in report.steps)
    assert said_of_crossings == (report.self_intersections > 0)
