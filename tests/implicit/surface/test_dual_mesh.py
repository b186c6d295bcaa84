"""Triangles between points of a surface, from a finer mesh of it."""

import numpy as np
import pytest

from implicit import extract_mesh, sample_surface, shapes
from implicit.surface.dual_mesh import connected_points
from implicit.surface.topology import mesh_topology


@pytest.fixture(scope="module")
def fine():
    V, F = extract_mesh(shapes.torus(0.6, 0.25), 48)
    return V, F, mesh_topology(V, F)


@pytest.fixture(scope="module")
def points():
    sample = sample_surface(shapes.torus(0.6, 0.25), 500, "farthest")
    return sample.points.numpy(), sample.normals.numpy()


def test_points_become_a_closed_mesh_of_the_same_type_that_faces_outward(fine, points):
    P, N = points
    F = connected_points(P, N, *fine)
    found = mesh_topology(P, F)
    assert (found.components, found.euler) == (1, 0)
    assert found.areas[0] == pytest.approx(4 * np.pi**2 * 0.6 * 0.25, rel=0.02)
    across = np.cross(P[F[:, 1]] - P[F[:, 0]], P[F[:, 2]] - P[F[:, 0]])
    assert (np.einsum("mx,mx->m", across, N[F[:, 0]]) > 0).all()
    assert set(F.ravel()) == set(range(500))


def test_the_two_sides_of_a_sheet_thinner_than_the_spacing_are_kept_apart():
    field = shapes.box((0.6, 0.6, 0.04))
    sample = sample_surface(field, 300, "farthest")
    V, F = extract_mesh(field, 96)
    faces = connected_points(sample.points.numpy(), sample.normals.numpy(), V, F, mesh_topology(V, F))
    side = sample.points.numpy()[faces][:, :, 2]
    flat = (np.abs(sample.points.numpy()[faces][:, :, :2]) < 0.45).all(axis=(1, 2))
    assert flat.any()
    assert (np.ptp(side[flat], axis=1) < 0.01).all()


def test_a_mesh_as_coarse_as_the_points_makes_none(fine):
    sample = sample_surface(shapes.torus(0.6, 0.25), 4000, seed=1)
    assert connected_points(sample.points.numpy(), sample.normals.numpy(), *fine) is None
