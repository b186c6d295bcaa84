"""The energy of finite rotations: libigl's, its own gradient, and zero for rigid motions of any size."""

import igl
import numpy as np
import pytest

import meshref
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step import rotations
from implicit.step.mesh_killing import MeshKilling
from implicit.step.rotations import best_rotations
from implicit.step.spokes_and_rims import SpokesAndRims


@pytest.fixture(scope="module")
def mesh():
    return meshref.torus(20, 12)


@pytest.fixture(scope="module")
def moved(mesh):
    return mesh[0] + 0.05 * np.random.default_rng(0).normal(size=mesh[0].shape)


@pytest.mark.parametrize("turn", [(0, 0, np.pi), (1.0, -2.0, 0.5), (0.0, 0.0, 0.0)])
def test_a_rigid_motion_of_any_size_costs_nothing(mesh, turn):
    V, F = mesh
    rotation = rotation_by(turn)
    energy = SpokesAndRims(V, F)
    there = V @ rotation.T + np.array([3.0, -1.0, 2.0])
    assert energy.energy(there) < 1e-24
    np.testing.assert_allclose(energy.rotations(there), np.broadcast_to(rotation, (len(V), 3, 3)), atol=1e-9)
    np.testing.assert_allclose(energy.gradient(there), 0, atol=1e-12)


def test_the_gradient_is_that_of_the_energy(mesh, moved):
    energy = SpokesAndRims(*mesh)
    way, h = np.random.default_rng(1).normal(size=moved.shape), 1e-5
    difference = (energy.energy(moved + h * way) - energy.energy(moved - h * way)) / (2 * h)
    assert np.vdot(energy.gradient(moved), way) == pytest.approx(difference, rel=1e-8)


def test_the_matrix_is_that_of_libigl(mesh):
    """Its cotangent Laplacian three times, for each half edge is in the cells of three corners."""
    V, F = mesh
    cotangents = -igl.cotmatrix(V, F).toarray()
    np.testing.assert_allclose(SpokesAndRims(V, F).laplacian.toarray(), 3 * cotangents, atol=1e-12)


def test_its_minimum_is_libigls(mesh):
    """From where libigl's iteration comes to rest, one of ours does not move; its rotations are in single precision."""
    V, F = mesh
    held = np.flatnonzero(np.abs(V[:, 0]) > 0.9 * np.abs(V[:, 0]).max())
    goals = V[held] + np.where(V[held, :1] > 0, np.array([[0.0, 0.2, 0.3]]), 0.0)
    result = meshref.arap(V, F, held, goals, iterations=2000, tolerance=1e-6)
    energy = SpokesAndRims(V, F)
    assert energy.energy(result.V) == pytest.approx(result.energy, rel=1e-9)
    free = np.setdiff1d(np.arange(len(V)), held)
    at_start = V.copy()
    at_start[held] = goals
    assert np.abs(energy.gradient(result.V)[free]).max() < 1e-3 * np.abs(energy.gradient(at_start)[free]).max()


def test_small_motions_cost_three_quarters_of_the_killing_energy_of_a_mesh(mesh):
    V, F = mesh
    way = 1e-5 * np.random.default_rng(2).normal(size=V.shape)
    linear = MeshKilling(WeakSurface(V, F)).energy(way)
    assert SpokesAndRims(V, F).energy(V + way) == pytest.approx(0.75 * linear, rel=1e-3)


def test_rotations_from_a_start_are_those_of_the_singular_values():
    generator = np.random.default_rng(3)
    matrices = generator.normal(size=(200, 3, 3))
    start = best_rotations(matrices)
    changed = matrices + 0.05 * generator.normal(size=matrices.shape)
    np.testing.assert_allclose(best_rotations(changed, start), best_rotations(changed), atol=1e-9)
    wrong = np.broadcast_to(rotation_by((0, 0, np.pi)), start.shape)
    np.testing.assert_allclose(best_rotations(changed, wrong), best_rotations(changed), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(start), 1)


def test_from_near_by_newtons_method_arrives_alone(monkeypatch):
    """Without a singular value decomposition, which makes up for all else."""
    matrices = np.eye(3) + 0.1 * np.random.default_rng(4).normal(size=(50, 3, 3))
    wanted = best_rotations(matrices)

    def refused(_):
        raise AssertionError("Newton's method did not arrive")

    monkeypatch.setattr(rotations, "_from_singular_values", refused)
    start = np.broadcast_to(rotation_by((0.05, 0.1, -0.05)), matrices.shape)
    np.testing.assert_allclose(best_rotations(matrices, start), wanted, atol=1e-9)


def rotation_by(vector):
    """Rodrigues' formula."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
