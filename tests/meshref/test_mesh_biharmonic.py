"""Biharmonic deformation against displacements it must reproduce, and against libigl."""

import igl
import numpy as np
import pytest

import meshref
from meshref import BiharmonicStatus, MeshError, biharmonic, icosphere


def grid(n=12):
    """A flat square of 2 (n - 1)^2 triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    V = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    F = np.concatenate(
        [np.stack([corner, corner + n, corner + 1], 1), np.stack([corner + n, corner + n + 1, corner + 1], 1)]
    )
    return V, F


def test_a_translation_of_the_handles_moves_all():
    V, F = icosphere(2)
    result = biharmonic(V, F, [0, 5, 9], np.tile([0.1, -0.2, 0.3], (3, 1)))
    np.testing.assert_allclose(result.displacement, np.tile([0.1, -0.2, 0.3], (len(V), 1)), atol=1e-9)
    assert result.energy < 1e-12
    assert result.status is BiharmonicStatus.SOLVED


def test_a_linear_displacement_of_two_rings_of_a_flat_border_is_continued_linearly():
    """Linear functions have no Laplacian, so with two rings held they are the only minimiser."""
    V, F = grid()
    edge = (V[:, :2] < 1.5 / 11).any(axis=1) | (V[:, :2] > 9.5 / 11).any(axis=1)
    linear = V @ np.array([[0.3, 0.1, 0.5], [0.0, -0.2, 0.1], [0.0, 0.0, 0.0]])
    result = biharmonic(V, F, np.flatnonzero(edge), linear[edge])
    np.testing.assert_allclose(result.displacement, linear, atol=1e-9)


def test_it_agrees_with_libigl():
    V, F = icosphere(3)
    held = np.flatnonzero((V[:, 2] > 0.9) | (V[:, 2] < 0.2))
    wanted = np.where(V[held, 2:] > 0.9, [[0.0, 0.1, 0.3]], 0.0)
    ours = biharmonic(V, F, held, wanted).displacement
    theirs = np.asarray(igl.harmonic(V, F, held, wanted, 2))
    # libigl takes Voronoi areas for the masses, here they are thirds of the faces: alike to the order of the mesh.
    assert np.abs(ours - theirs).max() < 0.02 * np.abs(theirs).max()


def test_a_part_without_a_handle_is_refused():
    V, F = icosphere(1)
    two = np.concatenate([V, V + 3]), np.concatenate([F, F + len(V)])
    with pytest.raises(MeshError, match="needs a handle vertex, but 1 of 2 have none, first the part of vertex"):
        biharmonic(*two, [0], [[0.1, 0, 0]])


def test_the_free_vertices_balance_on_an_uneven_mesh():
    """L M^-1 L d vanishes there, with the areas of the vertices in M."""
    V, F = meshref.torus(10, 7)
    V = V + 0.05 * np.random.default_rng(0).standard_normal(V.shape)
    held = np.array([0, 20, 45])
    d = meshref.biharmonic(V, F, held, np.eye(3)).displacement
    L = meshref.cotangent_laplacian(V, F)
    force = L @ ((L @ d) / meshref.vertex_areas(V, F)[:, None])
    assert np.abs(np.delete(force, held, axis=0)).max() < 1e-8 * np.abs(force).max()
