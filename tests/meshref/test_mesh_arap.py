"""As-rigid-as-possible deformation: rigid motions, descent, and its limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshref import ArapSolver, ArapStatus, MeshError, arap, arap_energy, cylinder, icosphere, torus, vertex_areas


def turn(degrees, axis=(1.0, 2.0, 3.0)):
    axis = np.array(axis) / np.linalg.norm(axis)
    return Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()


@pytest.mark.parametrize("minimiser", ["quasi-newton", "libigl"])
@pytest.mark.parametrize("degrees", [0, 60, 120, 175, 180])
def test_rigid_motions_of_the_handles_move_everything_rigidly(degrees, minimiser):
    """libigl fits its rotations in single precision, with a floor near 2e-6 of the size."""
    V, F = torus(24, 12)
    moved = V @ turn(degrees).T + [3, -2, 1]
    handles = np.arange(0, len(V), 17)
    result = arap(V, F, handles, moved[handles], minimiser=minimiser, tolerance=1e-5)
    size = np.linalg.norm(np.ptp(V, axis=0))
    assert np.abs(result.V - moved).max() < (1e-5 if minimiser == "libigl" else 1e-12) * size
    assert result.status is ArapStatus.CONVERGED
    np.testing.assert_array_equal(result.V[handles], moved[handles])


def bent_cylinder():
    V, F = cylinder(16, 20, 0.3, 2.0)
    low, high = np.flatnonzero(V[:, 2] < -0.85), np.flatnonzero(V[:, 2] > 0.85)
    targets = np.concatenate([V[low], V[high] @ turn(90, (0, 1, 0)).T])
    return V, F, np.concatenate([low, high]), targets


@pytest.mark.parametrize("minimiser", ["quasi-newton", "libigl"])
def test_the_energy_falls_to_the_end(minimiser):
    V, F, handles, targets = bent_cylinder()
    result = arap(V, F, handles, targets, iterations=1000, tolerance=1e-5, energy_every=1, minimiser=minimiser)
    energies = [row.energy for row in result.history]
    assert result.status is ArapStatus.CONVERGED
    assert result.converged
    assert np.diff(energies).max() < 1e-9 * energies[0]
    assert len(energies) == result.iterations + 1
    assert result.energy == energies[-1] == pytest.approx(arap_energy(V, F, result.V), rel=1e-12)
    assert result.residual == result.history[-1].step <= 1e-5 < result.history[-2].step
    assert result.energy_change == pytest.approx(energies[-2] / energies[-1] - 1, rel=1e-3, abs=1e-12)
    assert set(result.seconds) == {"factorisation", "start", "iterations"}


def test_a_plain_iteration_is_libigls():
    """To the single precision in which libigl fits its rotations; the first iteration has learned nothing."""
    V, F, handles, targets = bent_cylinder()
    ours, libigl = (arap(V, F, handles, targets, iterations=1, minimiser=name) for name in ("quasi-newton", "libigl"))
    np.testing.assert_allclose(ours.V, libigl.V, atol=5e-6)
    assert ours.residual == pytest.approx(libigl.residual, rel=1e-5)
    assert ours.energy == pytest.approx(libigl.energy, rel=1e-6)
    assert ours.history[0].energy == pytest.approx(libigl.history[0].energy, rel=1e-12)


def test_a_plain_iteration_is_the_least_squares_of_all_edges_with_the_best_rotations(rng):
    """Written out edge by edge, from any start."""
    V, F = torus(5, 4)
    start, handles = V + 0.3 * rng.standard_normal(V.shape), [0, 3, 11]
    start[handles] = V[handles] + 0.1
    edges, weights, cells = [], [], []
    for face in F:
        for k in range(3):
            i, j = face[(k + 1) % 3], face[(k + 2) % 3]
            a, b = V[i] - V[face[k]], V[j] - V[face[k]]
            for cell in face:
                edges.append((i, j))
                weights.append(a @ b / np.linalg.norm(np.cross(a, b)) / 2)
                cells.append(cell)
    rows, wanted = np.zeros((len(edges), len(V))), np.zeros((len(edges), 3))
    sums = np.zeros((len(V), 3, 3))
    for (i, j), weight, cell in zip(edges, weights, cells, strict=True):
        sums[cell] += weight * np.outer(V[j] - V[i], start[j] - start[i])
    best = np.zeros_like(sums)
    for cell, S in enumerate(sums):
        left, _, right = np.linalg.svd(S)
        best[cell] = right.T @ np.diag([1, 1, np.linalg.det(left @ right)]) @ left.T
    for row, ((i, j), cell) in enumerate(zip(edges, cells, strict=True)):
        rows[row, [i, j]] = -1, 1
        wanted[row] = best[cell] @ (V[j] - V[i])
    normal, right = rows.T @ (np.array(weights)[:, None] * rows), rows.T @ (np.array(weights)[:, None] * wanted)
    free = np.setdiff1d(np.arange(len(V)), handles)
    expected = start.copy()
    known = normal[np.ix_(free, handles)] @ start[handles]
    expected[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free] - known)
    found = arap(V, F, handles, start[handles], start=start, iterations=1)
    np.testing.assert_allclose(found.V, expected, atol=1e-12)


def test_libigls_iteration_rests_where_ours_ends():
    """It would need hundreds of iterations to come there."""
    V, F, handles, targets = bent_cylinder()
    ours = arap(V, F, handles, targets, tolerance=1e-7)
    assert ours.converged
    assert ours.iterations < 100
    further = arap(V, F, handles, targets, start=ours.V, iterations=1, minimiser="libigl")
    assert further.residual < 2e-6
    plain = arap(V, F, handles, targets, iterations=100, tolerance=1e-7, minimiser="libigl")
    assert not plain.converged
    assert plain.energy > ours.energy
    much_later = arap(V, F, handles, targets, iterations=1500, tolerance=1e-9, minimiser="libigl")
    np.testing.assert_allclose(much_later.V, ours.V, atol=1e-3)


def test_the_minimum_has_no_force_on_its_free_vertices(rng):
    """By central differences of the energy; at the start there is one."""
    V, F, handles, targets = bent_cylinder()
    result = arap(V, F, handles, targets, tolerance=1e-9)
    way = rng.standard_normal(V.shape)
    way[handles] = 0

    def force(U, h=1e-5):
        return (arap_energy(V, F, U + h * way) - arap_energy(V, F, U - h * way)) / (2 * h)

    start = ArapSolver(V, F, handles).rigid_start(targets)
    assert abs(force(result.V)) < 1e-6 * abs(force(start))


def test_too_few_iterations_are_reported():
    V, F, handles, targets = bent_cylinder()
    seen = []
    result = arap(V, F, handles, targets, iterations=3, progress=lambda done, most: seen.append((done, most)))
    assert result.status is ArapStatus.ITERATIONS_SPENT
    assert not result.converged
    assert result.iterations == 3
    assert result.residual > 1e-4
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_going_on_from_a_result_ends_at_the_same_minimum():
    V, F, handles, targets = bent_cylinder()
    solver = ArapSolver(V, F, handles)
    halfway = solver.solve(targets, iterations=20)
    further = solver.solve(targets, start=halfway, tolerance=1e-8)
    np.testing.assert_allclose(further, solver.solve(targets, tolerance=1e-8), atol=1e-5)


def test_a_way_leads_round_more_than_half_a_turn():
    """The ends of a rod, twisted by 270 degrees: straight to the goal it is taken for a turn by -90."""
    V, F = cylinder(12, 24, 0.2, 2.0)
    low, high = np.flatnonzero(V[:, 2] < -0.9), np.flatnonzero(V[:, 2] > 0.9)
    solver = ArapSolver(V, F, np.concatenate([low, high]))

    def twisted(degrees):
        return np.concatenate([V[low], V[high] @ turn(degrees, (0, 0, 1)).T])

    round_it = solver.run(twisted(270), way=[twisted(30 * k) for k in range(1, 9)])
    straight = solver.run(twisted(270))
    assert round_it.converged
    assert straight.converged
    assert round_it.energy > 3 * straight.energy
    middle = np.flatnonzero(np.abs(V[:, 2]) < 0.01)
    angle = np.angle((round_it.V[middle] - V[middle] + V[middle]) @ [1, 1j, 0] / (V[middle] @ [1, 1j, 0]))
    np.testing.assert_allclose(np.degrees(angle), 135, atol=1)


@pytest.mark.parametrize("degrees", [150, 180])
def test_the_energy_never_rises_however_far_the_start(degrees):
    """A rod at rest whose ends have been twisted: steps as they are learned would raise it by a third of the start."""
    V, F = cylinder(8, 16, 0.15, 2.0)
    low, high = np.flatnonzero(V[:, 2] < -0.9), np.flatnonzero(V[:, 2] > 0.9)
    targets = np.concatenate([V[low], V[high] @ turn(degrees, (0, 0, 1)).T])
    result = arap(V, F, np.concatenate([low, high]), targets, start=V, energy_every=1)
    energies = [row.energy for row in result.history]
    assert result.converged
    assert np.diff(energies).max() < 1e-12 * energies[0]


def test_springs_give_way_by_one_over_their_stiffness():
    V, F, handles, targets = bent_cylinder()
    hard = arap(V, F, handles, targets)
    assert hard.handle_error == 0
    soft = [arap(V, F, handles, targets, penalty=p, tolerance=1e-9) for p in (1e4, 1e5, 1e6)]
    errors = [result.handle_error for result in soft]
    assert errors[1] / errors[2] == pytest.approx(10, rel=0.02)
    assert errors[0] > errors[1]
    energies = [result.energy for result in (*soft, hard)]
    assert np.diff(energies).min() > 0
    np.testing.assert_allclose(soft[-1].V, hard.V, atol=1e-2)


def test_springs_are_at_the_minimum_of_energy_and_pull(rng):
    """Its derivative by central differences, the weights as the areas of the handles."""
    V, F, handles, targets = bent_cylinder()
    result = arap(V, F, handles, targets, penalty=3.0, tolerance=1e-10)
    weight = vertex_areas(V, F)[handles]

    def minimised(U):
        return arap_energy(V, F, U) + 3.0 * float(weight @ ((U[handles] - targets) ** 2).sum(axis=1))

    assert result.history[-1].energy == pytest.approx(minimised(result.V), rel=1e-9)
    way, h = rng.standard_normal(V.shape), 1e-5
    slope = (minimised(result.V + h * way) - minimised(result.V - h * way)) / (2 * h)
    assert abs(slope) < 1e-6 * minimised(result.V)


def test_springs_do_not_depend_on_the_unit_of_length():
    V, F, handles, targets = bent_cylinder()
    small = arap(V, F, handles, targets, penalty=5.0)
    large = arap(100 * V, F, handles, 100 * targets, penalty=5.0 / 100**2)
    np.testing.assert_allclose(large.V, 100 * small.V, atol=1e-4)


def test_what_overflows_ends_in_a_status_and_finite_numbers():
    V, F, handles, targets = bent_cylinder()
    result = arap(1e-60 * V, F, handles, 1e98 * targets)
    assert result.status is ArapStatus.NOT_FINITE
    assert np.isfinite(result.V).all()


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"handles": [0, 0, 1]}, "vertex 0 appears 2 times"),
        ({"handles": [0, 1, 999]}, r"handle_vertices\[2\] = 999"),
        ({"handles": [0, 1]}, "targets must have a row for each of the 2 handles, but has 3"),
        ({"iterations": 0}, "iterations must be a whole number, at least 1"),
        ({"tolerance": 0.0}, "tolerance must be a positive number"),
        ({"penalty": -1.0}, "penalty must be a positive number"),
        ({"penalty": 1.0, "minimiser": "libigl"}, "a penalty must go with minimiser='quasi-newton'"),
        ({"minimiser": "newton"}, "minimiser must be one of 'quasi-newton', 'libigl'"),
        ({"way": [np.zeros((2, 3))]}, r"way\[0\] must have a row for each of the 3 handles, but has 2"),
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
