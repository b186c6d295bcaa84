"""Signed distance against closed forms, on closed and open meshes, and far from the origin."""

import numpy as np
import pytest

from meshref import MeshError, SignedDistanceQuery, box, icosphere, mend_mesh, signed_distance


def distance_to_unit_cube(P):
    q = np.abs(P - 0.5) - 0.5
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_the_distance_to_a_cube_is_exact(offset, rng):
    V, F = box(subdivisions=1)
    P = rng.uniform(-1, 2, (500, 3))
    answer = signed_distance(V + offset, F, P + offset)
    np.testing.assert_allclose(answer.distance, distance_to_unit_cube(P), atol=1e-15 + 1e-15 * offset)
    np.testing.assert_allclose(np.linalg.norm(P + offset - answer.closest, axis=1), np.abs(answer.distance), atol=1e-9)


def test_normals_are_the_gradient_of_the_distance(rng):
    V, F = box()
    P = rng.uniform(-1, 2, (300, 3))
    P = P[np.abs(distance_to_unit_cube(P)) > 1e-2]
    answer = signed_distance(V, F, P)
    h = 1e-6
    gradient = np.stack(
        [(distance_to_unit_cube(P + h * e) - distance_to_unit_cube(P - h * e)) / (2 * h) for e in np.eye(3)], 1
    )
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1) < 1e-4  # off the medial axis
    assert smooth.mean() > 0.95
    np.testing.assert_allclose(answer.normal[smooth], gradient[smooth], atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(answer.normal, axis=1), 1, rtol=1e-14)


def test_on_the_surface_the_normal_is_that_of_face_edge_or_vertex():
    V, F = box()
    P = np.array([[0.25, 0.6, 1.0], [0.5, 1.0, 1.0], [1.0, 1.0, 1.0], [0.3, 0.3, 0.0]])
    answer = signed_distance(V, F, P)
    np.testing.assert_allclose(answer.distance, 0, atol=1e-15)
    expected = np.array([[0, 0, 1], [0, 1, 1], [1, 1, 1], [0, 0, -1]]) / np.sqrt([1, 2, 3, 1])[:, None]
    np.testing.assert_allclose(answer.normal, expected, atol=1e-14)


def test_a_hole_does_not_disturb_the_sign(rng):
    """The sign is that of the whole sphere, except near the missing face."""
    V, F = icosphere(3)
    hole = V[F[0]].mean(axis=0)
    P = rng.uniform(-1.5, 1.5, (2000, 3))
    P = P[np.linalg.norm(P - hole, axis=1) > 0.3]
    P = P[np.abs(np.linalg.norm(P, axis=1) - 1) > 0.02]
    answer = signed_distance(V, F[1:], P)
    np.testing.assert_array_equal(answer.distance < 0, np.linalg.norm(P, axis=1) < 1)
    np.testing.assert_allclose(np.abs(answer.distance), np.abs(np.linalg.norm(P, axis=1) - 1), atol=1e-2)


@pytest.mark.nightly
def test_the_open_bunny_agrees_with_the_mended_one(real_mesh, rng):
    V, F = real_mesh("bunny-35k.obj")
    mended_V, mended_F, report = mend_mesh(V, F)
    used = np.unique(F)
    P = rng.uniform(V.min(axis=0), V.max(axis=0), (1000, 3))
    open_answer = signed_distance(V[used], np.searchsorted(used, F), P)
    closed_answer = signed_distance(mended_V, mended_F, P)
    assert len(report.holes) == 5
    assert np.mean((open_answer.distance < 0) == (closed_answer.distance < 0)) > 0.995


def test_a_query_can_be_asked_again_and_in_parts(rng):
    V, F = icosphere(2)
    query = SignedDistanceQuery(V, F)
    P = rng.standard_normal((50, 3))
    whole, parts = query(P), [query(P[:20]), query(P[20:])]
    np.testing.assert_array_equal(whole.distance, np.concatenate([p.distance for p in parts]))
    np.testing.assert_array_equal(query.distance(P)[0], np.abs(whole.distance))
    np.testing.assert_array_equal(query.inside(P), whole.distance < 0)


def test_no_points_give_no_answers():
    query = SignedDistanceQuery(*icosphere(1))
    nothing = np.zeros((0, 3))
    assert [len(a) for a in query(nothing)] == [0, 0, 0, 0]
    assert len(query.inside(nothing)) == len(query.distance(nothing)[0]) == 0


def test_bad_points_are_refused():
    V, F = icosphere(1)
    with pytest.raises(MeshError, match=r"P must be finite.*P\[1\]"):
        signed_distance(V, F, [[0, 0, 0], [0, np.nan, 0]])
    with pytest.raises(MeshError, match=r"P must have shape \(k, 3\)"):
        signed_distance(V, F, np.zeros((4, 2)))


@pytest.mark.parametrize("beside", [False, True])
@pytest.mark.parametrize("hole", [0, 3])
def test_a_surface_that_is_inside_out_is_refused(beside, hole):
    """Alone or beside one that is right, and where some of its faces are missing."""
    V, F = icosphere(2)
    inverted = F[hole:, ::-1]
    used = np.unique(inverted)
    V2, F2 = V[used], np.searchsorted(used, inverted)
    if beside:
        V2, F2 = np.concatenate([V + np.array([5.0, 0, 0]), V2]), np.concatenate([F, F2 + len(V)])
    with pytest.raises(MeshError, match="must be oriented outwards, but those of the part of face"):
        signed_distance(V2, F2, np.zeros((1, 3)))


def test_a_cavity_is_not_inside_out():
    V, F = icosphere(2)
    hollow = np.concatenate([V, V / 2]), np.concatenate([F, F[:, ::-1] + len(V)])
    assert signed_distance(*hollow, np.array([[0.0, 0, 0], [0.75, 0, 0]])).distance == pytest.approx(
        [0.48, -0.25], abs=0.03
    )
