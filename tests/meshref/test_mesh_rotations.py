"""Nearest rotations: those of the singular values, by Newton's method where it may, and rigid fits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshref.rotations import nearest_rotations, rigid_fit


def traces(R, S):
    return np.einsum("kij,kij->k", R, S)


def test_no_rotation_is_nearer(rng):
    """Against 2000 random rotations, for matrices of either sign of the determinant."""
    S = rng.standard_normal((30, 3, 3))
    R = nearest_rotations(S)
    np.testing.assert_allclose(np.linalg.det(R), 1)
    others = Rotation.random(2000, random_state=0).as_matrix()
    assert (traces(R, S) >= np.einsum("rij,kij->kr", others, S).max(axis=1)).all()


@pytest.mark.parametrize("off", [0.0, 0.05, 0.5, 3.0])
def test_a_start_changes_the_way_and_not_the_answer(off, rng):
    """However far off: what Newton's method cannot bring to the global maximum is left to the singular values."""
    S = np.concatenate([rng.standard_normal((200, 3, 3)), np.zeros((1, 3, 3)), np.diag([1.0, 0, 0])[None]])
    exact = nearest_rotations(S)
    start = exact @ Rotation.from_rotvec(off * rng.standard_normal((len(S), 3)) / 2).as_matrix()
    found = nearest_rotations(S, start)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.broadcast_to(np.eye(3), S.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(found), 1)
    np.testing.assert_allclose(traces(found, S), traces(exact, S), atol=1e-12)
    sharp = np.linalg.svd(S, compute_uv=False)[:, 2] > 0.05
    np.testing.assert_allclose(found[sharp], exact[sharp], atol=1e-9)


def test_a_start_is_not_changed(rng):
    S = rng.standard_normal((10, 3, 3))
    start = np.broadcast_to(np.eye(3), S.shape).copy()
    nearest_rotations(S, start)
    np.testing.assert_array_equal(start, np.broadcast_to(np.eye(3), S.shape))


def test_the_rigid_fit_takes_the_smallest_turn_left_open():
    P = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    for direction in ([0, 1, 0], [1, 0, 0], [-1, 0, 0]):
        rotation, translation = rigid_fit(P, P[:, :1] * np.array(direction) + 5.0)
        np.testing.assert_allclose(P @ rotation.T + translation, P[:, :1] * np.array(direction) + 5.0, atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rigid_fit(P, P[:, [1, 0, 2]])[0] @ [0, 0, 1], [0, 0, 1], atol=1e-12)
