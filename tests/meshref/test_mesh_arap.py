"""As-rigid-as-possible deformation: rigid motions, descent, and its limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshref import ArapSolver, ArapStatus, MeshError, arap, arap_energy, cylinder, icosphere, torus
from meshref.arap import rigid_fit


def turn(degrees, axis=(1.0, 2.0, 3.0)):
    axis = np.array(axis) / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()


@pytest.mark.parametrize("degrees", [0, 60, 120, 175, 180])
def test_rigid_motions_of_the_handles_move_everything_rigidly(degrees):
    """To 1e-5 of the size: libigl fits its rotations in single precision, with a floor near 2e-6."""
    V, F = torus(24, 12)
    moved = V @ turn(degrees).T + [3, -2, 1]
    handles = np.arange(0, len(V), 17)
    result = arap(V, F, handles, moved[handles])
    size = np.linalg.norm(np.ptp(V, axis=0))
    assert np.abs(result.V - moved).max() < 1e-5 * size
    assert result.status is ArapStatus.CONVERGED
    np.testing.assert_array_equal(result.V[handles], moved[handles])


def bent_cylinder():
    V, F = cylinder(16, 20, 0.3, 2.0)
    low, high = np.flatnonzero(V[:, 2] < -0.85), np.flatnonzero(V[:, 2] > 0.85)
    targets = np.concatenate([V[low], V[high] @ turn(90, (0, 1, 0)).T])
    return V, F, np.concatenate([low, high]), targets


def test_the_energy_falls_to_the_end():
    V, F, handles, targets = bent_cylinder()
    result = arap(V, F, handles, targets, iterations=1000, tolerance=1e-5, energy_every=1)
    energies = [row.energy for row in result.history]
    assert result.status is ArapStatus.CONVERGED
    assert np.diff(energies).max() < 1e-9 * energies[0]
    assert len(energies) == result.iterations + 1
    assert result.energy == energies[-1] == pytest.approx(arap_energy(V, F, result.V), rel=1e-12)
    assert result.history[-1].step <= 1e-5 < result.history[-2].step
    assert set(result.seconds) == {"factorisation", "start", "iterations"}


def test_too_few_iterations_are_reported():
    V, F, handles, targets = bent_cylinder()
    seen = []
    result = arap(V, F, handles, targets, iterations=3, progress=lambda done, most: seen.append((done, most)))
    assert result.status is ArapStatus.ITERATIONS_SPENT
    assert result.iterations == 3
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_going_on_from_a_result_is_the_same_as_not_stopping():
    V, F, handles, targets = bent_cylinder()
    solver = ArapSolver(V, F, handles)
    halfway = solver.solve(targets, iterations=20, tolerance=1e-12)
    further = solver.solve(targets, start=halfway, iterations=20, tolerance=1e-12)
    np.testing.assert_allclose(further, solver.solve(targets, iterations=40, tolerance=1e-12), atol=1e-9)


def test_the_energy_of_rigid_motions_is_zero_and_scales_as_a_squared_length(rng):
    V, F = torus(12, 9)
    assert arap_energy(V, F, V @ turn(200).T + [1, 2, 3]) < 1e-25
    U = V + 0.1 * rng.standard_normal(V.shape)
    assert arap_energy(3 * V, F, 3 * U) == pytest.approx(9 * arap_energy(V, F, U), rel=1e-12)
    assert arap_energy(V, F, U @ turn(50).T) == pytest.approx(arap_energy(V, F, U), rel=1e-12)


def test_doubling_the_size_costs_the_length_of_all_edges():
    """U = 2 V: the best rotation is none. Half a cotangent times |e|^2, summed over a face, is twice its area."""
    V, F = icosphere(3)
    expected = 3 * 2 * (np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1) / 2).sum()
    assert arap_energy(V, F, 2 * V) == pytest.approx(expected, rel=1e-12)


def test_the_result_does_not_depend_on_place_and_unit():
    V, F, handles, targets = bent_cylinder()
    first = arap(V, F, handles, targets, iterations=20)
    scaled = arap(1e3 * V + 1e4, F, handles, 1e3 * targets + 1e4, iterations=20)
    np.testing.assert_allclose((scaled.V - 1e4) / 1e3, first.V, atol=2e-5)


def test_one_handle_carries_the_mesh_along():
    V, F = icosphere(2)
    result = arap(V, F, [7], V[[7]] + [1, 2, 3])
    np.testing.assert_allclose(result.V, V + np.array([1, 2, 3]), atol=1e-5)


def test_all_vertices_may_be_handles(rng):
    V, F = icosphere(1)
    U = V + 0.1 * rng.standard_normal(V.shape)
    result = arap(V, F, np.arange(len(V)), U)
    np.testing.assert_array_equal(result.V, U)
    assert result.status is ArapStatus.CONVERGED


def test_the_rigid_fit_takes_the_smallest_turn_left_open():
    P = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    for direction in ([0, 1, 0], [1, 0, 0], [-1, 0, 0]):
        rotation, translation = rigid_fit(P, P[:, :1] * np.array(direction) + 5.0)
        np.testing.assert_allclose(P @ rotation.T + translation, P[:, :1] * np.array(direction) + 5.0, atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rigid_fit(P, P[:, [1, 0, 2]])[0] @ [0, 0, 1], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"handles": [0, 0, 1]}, "vertex 0 appears 2 times"),
        ({"handles": [0, 1, 999]}, r"handle_vertices\[2\] = 999"),
        ({"handles": [0, 1]}, "targets must have a row for each of the 2 handles, but has 3"),
        ({"iterations": 0}, "iterations must be a whole number, at least 1"),
        ({"tolerance": 0.0}, "tolerance must be a positive number"),
        ({"start": np.zeros((2, 3))}, "start must have a row for each of the 42 vertices"),
    ],
)
def test_bad_requests_are_refused(change, message):
    V, F = icosphere(1)
    arguments = {"handles": [0, 1, 2], "targets": np.zeros((3, 3)), **change}
    with pytest.raises(MeshError, match=message):
        arap(V, F, **arguments)


def test_each_body_needs_a_handle():
    V, F = icosphere(1)
    V2, F2 = np.concatenate([V, V + 5]), np.concatenate([F, F + len(V)])
    with pytest.raises(MeshError, match=r"needs a handle vertex, but 1 of 2 have none, first the part of vertex 42"):
        ArapSolver(V2, F2, [0, 1, 2])


def test_a_mirrored_mesh_is_not_a_rigid_motion_for_arap():
    """A reflection would explain the mirror image at no cost; no rotation does."""
    V, F = torus(8, 6)
    assert arap_energy(V, F, V @ turn(40).T) == pytest.approx(0, abs=1e-12)
    assert arap_energy(V, F, V * (-1, 1, 1)) > 1
