"""Killing energies against closed forms on the sphere, rigid motions, and each other."""

import sys

import numpy as np
import pytest

from meshref import (
    KillingSolver,
    KillingStatus,
    MeshError,
    NotPositiveDefiniteError,
    arap_energy,
    area,
    box,
    cylinder,
    face_normals,
    icosphere,
    killing,
    killing_energy,
    killing_energy_density,
    torus,
    vertex_areas,
)
from meshref.measures import face_areas

FORMS = ("membrane", "spokes-and-rims", "spokes", "ambient", "notebook")
TANGENTIAL = FORMS[:3]
killing_module = sys.modules["meshref.killing"]  # the package's name "killing" is the function


def rigid_motion(V, rng):
    a, w = rng.standard_normal((2, 3))
    return a + np.cross(w, V)


@pytest.mark.parametrize("form", TANGENTIAL)
@pytest.mark.parametrize("subdivisions", [2, 3, 4], ids=["320 faces", "1280 faces", "5120 faces"])
def test_rigid_motions_cost_nothing_at_any_resolution(subdivisions, form, rng):
    V, F = icosphere(subdivisions)
    unit = rng.standard_normal(V.shape)
    unit /= np.linalg.norm(unit)
    assert killing_energy(V, F, rigid_motion(V, rng), form) < 1e-20 * killing_energy(V, F, unit, form)


@pytest.mark.parametrize("form", TANGENTIAL)
def test_rigid_motions_cost_nothing_on_an_open_mesh(form, rng):
    V, F = cylinder(20, 10)
    V, F = V[:-2], F[(len(V) - 2 > F).all(axis=1)]
    field = rng.standard_normal(V.shape)
    assert killing_energy(V, F, rigid_motion(V, rng), form) < 1e-20 * killing_energy(V, F, field, form)


def orders(error):
    return np.log2(np.abs(np.divide(error[:-1], error[1:])))


@pytest.mark.parametrize("form", FORMS[:4])
def test_growing_a_unit_sphere_costs_32_pi(form):
    """d = n: J = P, so |2 P|^2 = 8 over the area 4 pi."""
    error = [killing_energy(V, F, V, form) / (32 * np.pi) - 1 for V, F in map(icosphere, (2, 3, 4))]
    assert abs(error[-1]) < 1.3e-3
    np.testing.assert_allclose(orders(error), 2, atol=0.05)


@pytest.mark.parametrize("form", TANGENTIAL)
def test_stretching_a_unit_sphere_costs_128_pi_over_15(form):
    """d = (x, 0, 0): the strain is 2 (1 - x^2) along one direction, 4 (1 - x^2)^2 in all."""
    error = []
    for V, F in map(icosphere, (2, 3, 4)):
        error.append(killing_energy(V, F, V * [1, 0, 0], form) / (128 * np.pi / 15) - 1)
    assert abs(error[-1]) < 1.3e-3
    assert orders(error)[-1] == pytest.approx(2, abs=0.1)


def test_the_ambient_form_charges_rotations():
    """J = [w] P on a sphere: |J + J^T|^2 = 2 |w x n|^2, 4/3 on average, for a turn by one radian."""
    V, F = icosphere(4)
    turn = np.cross([0, 0, 1.0], V)
    assert killing_energy(V, F, turn, "ambient") == pytest.approx(16 * np.pi / 3, rel=2e-3)


@pytest.mark.parametrize(("subdivisions", "charge"), [(2, 427), (3, 1707), (4, 6827)])
def test_the_notebook_form_charges_rotations_by_the_face(subdivisions, charge):
    V, F = icosphere(subdivisions)
    assert round(killing_energy(V, F, np.cross([0, 0, 1.0], V), "notebook")) == charge


@pytest.mark.parametrize("form", FORMS)
def test_energy_scales_as_a_squared_length(form, rng):
    V, F = torus(12, 9)
    D = rng.standard_normal(V.shape)
    power = 0 if form == "notebook" else 2
    unscaled = killing_energy(V, F, D, form)
    assert killing_energy(3 * V, F, 3 * D, form) == pytest.approx(unscaled * 3**power, rel=1e-12)
    assert killing_energy(V, F, 2 * D, form) == pytest.approx(4 * unscaled, rel=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_the_matrix_is_the_energy(form, rng):
    V, F = torus(12, 9)
    V = V + 0.03 * rng.standard_normal(V.shape)
    d = rng.standard_normal(V.size)
    Q = killing_module.energy_matrix(V, F, form)
    assert abs(Q - Q.T).max() < 1e-13 * abs(Q).max()
    assert d @ (Q @ d) == pytest.approx(killing_energy(V, F, d.reshape(-1, 3), form), rel=1e-12)


@pytest.mark.parametrize("form", ["membrane", "spokes-and-rims"])
def test_only_the_six_rigid_motions_of_a_sphere_are_free(form, rng):
    V, F = icosphere(1)
    V = V + 0.05 * rng.standard_normal(V.shape)
    values = np.linalg.eigvalsh(killing_module.energy_matrix(V, F, form).toarray())
    assert values[0] > -1e-13 * values[-1]
    assert values[5] < 1e-13 * values[-1] < 1e-6 * values[-1] < values[6]


def test_membrane_is_four_times_the_best_rotation_of_each_face(rng):
    """The identity at the top of killing.py: |P (J + J^T) P|^2 = 4 min over w |(J - [w]) P|^2."""
    V, F = icosphere(1)
    D = rng.standard_normal(V.shape)
    J = killing_module.displacement_gradients(V, F, D)
    normal = np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    P = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    best = []
    for f in range(len(F)):
        rotations = np.stack([(killing_module.cross_matrices(w[None])[0] @ P[f]).ravel() for w in np.eye(3)], axis=1)
        left = np.linalg.lstsq(rotations, (J[f] @ P[f]).ravel(), rcond=None)[0]
        best.append(((J[f] @ P[f]).ravel() - rotations @ left) @ ((J[f] @ P[f]).ravel() - rotations @ left))
    np.testing.assert_allclose(killing_energy_density(V, F, D), 4 * np.array(best), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("form", ["membrane", "ambient"])
def test_the_density_adds_up_to_the_energy(form, rng):
    V, F = torus(12, 9)
    D = rng.standard_normal(V.shape)
    total = face_areas(V, F) @ killing_energy_density(V, F, D, form)
    assert total == pytest.approx(killing_energy(V, F, D, form), rel=1e-13)


def test_spokes_and_rims_is_the_small_displacement_limit_of_arap(rng):
    V, F = torus(12, 9)
    D = rng.standard_normal(V.shape)
    arap = arap_energy(V, F, V + 1e-6 * D) / 1e-12
    assert arap == pytest.approx(3 / 4 * killing_energy(V, F, D, "spokes-and-rims"), rel=1e-4)


def held_and_moved(V):
    """Handles: the lowest tenth of the vertices, and the highest."""
    z = V[:, 2]
    low, high = np.flatnonzero(z < np.quantile(z, 0.1)), np.flatnonzero(z > np.quantile(z, 0.9))
    return low, high


@pytest.mark.parametrize("solver", ["superlu", "cholespy"])
@pytest.mark.parametrize("method", ["hard", "soft"])
@pytest.mark.parametrize("form", ["membrane", "spokes-and-rims"])
def test_rigid_motions_of_the_handles_move_everything_rigidly(form, method, solver, rng):
    if solver == "cholespy":
        pytest.importorskip("cholespy", reason="the optional solver cholespy is not installed")
    V, F = icosphere(3)
    V = V + np.array([5, -3, 2])
    handles = np.concatenate(held_and_moved(V))
    motion = rigid_motion(V, rng)
    result = killing(V, F, handles, motion[handles], form=form, method=method, solver=solver)
    np.testing.assert_allclose(result.displacement, motion, atol=1e-9)
    assert result.status is KillingStatus.SOLVED
    assert result.handle_error < 1e-9
    stretch = killing_energy(V, F, np.abs(motion).max() * (V - V.mean(axis=0)))
    assert result.energy < 1e-14 * stretch  # the rounding of the sum of squares of numbers as large
    assert result.solver == solver
    assert set(result.seconds) == {"assembly", "factorisation", "solve"}


@pytest.mark.parametrize("form", ["membrane", "spokes-and-rims", "ambient", "notebook"])
def test_no_other_field_with_these_handles_costs_less(form, rng):
    V, F = icosphere(2)
    low, high = held_and_moved(V)
    handles = np.concatenate([low, high])
    wanted = np.where(np.isin(handles, high)[:, None], [0.3, 0, 0.1], [0, 0, 0.0])
    result = killing(V, F, handles, wanted, form=form)
    np.testing.assert_array_equal(result.displacement[handles], wanted)
    assert result.energy == pytest.approx(killing_energy(V, F, result.displacement, form), rel=1e-9)
    for _ in range(5):
        other = 1e-3 * rng.standard_normal(V.shape)
        other[handles] = 0
        assert killing_energy(V, F, result.displacement + other, form) > result.energy


def test_soft_handles_tend_to_hard_ones():
    V, F = cylinder(16, 12)
    low, high = held_and_moved(V)
    handles = np.concatenate([low, high])
    wanted = np.where(np.isin(handles, high)[:, None], [0.5, 0, 0.0], [0, 0, 0.0])
    hard = killing(V, F, handles, wanted)
    error = []
    for penalty in (1e3, 1e5, 1e7):
        soft = killing(V, F, handles, wanted, method="soft", penalty=penalty)
        assert soft.energy < hard.energy
        error.append(np.abs(soft.displacement - hard.displacement).max())
    np.testing.assert_allclose(np.divide(error[:-1], error[1:]), 100, rtol=0.2)


def test_one_factorisation_serves_many_displacements(rng):
    V, F = icosphere(2)
    handles = np.concatenate(held_and_moved(V))
    solver = KillingSolver(V, F, handles)
    wanted = rng.standard_normal((2, len(handles), 3))
    both = solver.solve(wanted[0]) + 2 * solver.solve(wanted[1])
    np.testing.assert_allclose(solver.solve(wanted[0] + 2 * wanted[1]), both, atol=1e-11)


def test_all_vertices_may_be_handles(rng):
    V, F = icosphere(1)
    D = rng.standard_normal(V.shape)
    result = killing(V, F, np.arange(len(V)), D)
    np.testing.assert_array_equal(result.displacement, D)
    assert result.energy == pytest.approx(killing_energy(V, F, D, "spokes-and-rims"), rel=1e-12)


def test_the_published_notebook_scene(real_mesh):
    """Its energy, its unweighted penalty of 1e4 on the square: 22.15, solved to convergence."""
    V, F = real_mesh("bunny.off")
    ear = np.flatnonzero(np.linalg.norm(V - [-0.02, 0.17, -0.015], axis=1) < 0.03)
    base = np.flatnonzero(V[:, 1] < V[:, 1].min() + 0.002)
    handles = np.concatenate([ear, base])
    wanted = np.concatenate([np.tile([0.01, 0, 0.01], (len(ear), 1)), np.zeros((len(base), 3))])
    ones = np.ones(len(handles))
    result = killing(V, F, handles, wanted, form="notebook", method="soft", penalty=1e4, handle_weights=ones)
    assert result.energy == pytest.approx(22.15, abs=0.005)


@pytest.mark.parametrize(
    ("handles", "message"),
    [
        ([], "one or more vertex numbers"),
        ([3, 4], r"at least three handle vertices.* has 2: it could turn freely.*Add handles"),
        ([0, 1, 0], "name each vertex once, but vertex 0 appears 2 times"),
        ([0, 1, 162], r"from 0 to 161, but handle_vertices\[2\] = 162"),
        ([0, 1, -1], r"handle_vertices\[2\] = -1"),
        ([0.5, 1, 2], "whole numbers"),
    ],
)
def test_handles_that_cannot_work_are_refused(handles, message):
    V, F = icosphere(2)
    with pytest.raises(MeshError, match=message):
        KillingSolver(V, F, handles)


def test_handles_on_one_line_are_refused():
    V, F = box(subdivisions=2)
    line = np.flatnonzero((V[:, 0] == 0) & (V[:, 1] == 0))
    assert len(line) == 5
    with pytest.raises(MeshError, match=r"not on one line .* has 5 on one line: it could turn"):
        KillingSolver(V, F, line)


def test_each_body_needs_handles():
    V, F = icosphere(1)
    V2, F2 = np.concatenate([V, V + 5]), np.concatenate([F, F + len(V)])
    with pytest.raises(MeshError, match=r"each of the 2 connected parts .* part of vertex 42 at .* has 0"):
        KillingSolver(V2, F2, [0, 1, 2, 3])


def test_a_membrane_that_can_fold_freely_is_reported():
    """A flat sheet has no resistance at all out of its plane in the membrane form."""
    V, F = box(subdivisions=3)
    top = np.flatnonzero(V[:, 2] == 1)
    sheet = F[np.isin(F, top).all(axis=1)]
    V, F = V[top], np.searchsorted(top, sheet)
    handles = np.flatnonzero(V[:, 0] == 0)[:2].tolist() + np.flatnonzero(V[:, 0] == 1)[:2].tolist()
    with pytest.raises(NotPositiveDefiniteError, match=r"not positive definite.*spokes-and-rims"):
        KillingSolver(V, F, handles, form="membrane")
    assert killing(V, F, handles, V[handles] * 0.1).status is KillingStatus.SOLVED


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"form": "thin shell"}, "form must be one of 'membrane'"),
        ({"method": "medium"}, "method must be one of 'hard', 'soft'"),
        ({"method": "soft", "penalty": -1.0}, "penalty must be a positive number"),
        ({"penalty": 1.0}, "penalty must go with method='soft'"),
        ({"handle_weights": [1, 1, 1, 1]}, "handle_weights belong to method='soft'"),
        ({"method": "soft", "handle_weights": [1, 1]}, "handle_weights must be 4 positive numbers"),
        ({"solver": "abacus"}, "solver must be one of 'auto'"),
    ],
)
def test_unknown_options_are_refused(options, message):
    with pytest.raises(MeshError, match=message):
        KillingSolver(*icosphere(1), [0, 5, 9, 11], **options)


def test_fields_of_the_wrong_size_are_refused():
    V, F = icosphere(1)
    with pytest.raises(MeshError, match="D must have a row for each of the 42 vertices, but has 41"):
        killing_energy(V, F, V[1:])
    with pytest.raises(MeshError, match="displacements must have a row for each of the 4 handles, but has 3"):
        killing(V, F, [0, 5, 9, 11], np.zeros((3, 3)))
    with pytest.raises(MeshError, match="form must be one of 'membrane', 'ambient'"):
        killing_energy_density(V, F, V, "spokes")
    assert area(V, F) > 0


def test_the_gradient_of_a_linear_displacement_is_its_matrix(rng):
    """J = A P, for a linear element knows nothing of the slope along the normal."""
    V, F = torus(8, 6)
    A = rng.standard_normal((3, 3))
    n = face_normals(V, F)
    flat = np.eye(3) - n[:, :, None] * n[:, None, :]
    np.testing.assert_allclose(killing_module.displacement_gradients(V, F, V @ A.T), A @ flat, atol=1e-12)


def test_soft_handles_weigh_by_their_area():
    """At the minimum the slope of the energy balances that of penalty times the squared miss, times the area."""
    V, F = torus(8, 6)
    handles, penalty = np.array([0, 7, 20, 33]), 3.0
    wanted = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, -0.1, 0.0]])
    d = killing(V, F, handles, wanted, method="soft", penalty=penalty).displacement
    slope = (killing_module.energy_matrix(V, F, "spokes-and-rims") @ d.ravel()).reshape(-1, 3)
    pull = np.zeros_like(V)
    pull[handles] = penalty * vertex_areas(V, F)[handles, None] * (d[handles] - wanted)
    np.testing.assert_allclose(slope, -pull, atol=1e-10)
