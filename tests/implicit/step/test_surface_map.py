"""A deformation of a mesh taken on to the points about it: exact for rigid motions, between the vertices else."""

import igl
import numpy as np
import pytest

import meshref
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.surface_map import SurfaceMap, nearest_in_triangles


@pytest.fixture(scope="module")
def torus():
    return WeakSurface(*meshref.torus(40, 24))


def some_points(surface, count=300):
    """Return points on and off a mesh."""
    generator = np.random.default_rng(0)
    faces = generator.integers(len(surface.faces), size=count)
    shares = generator.dirichlet((1, 1, 1), size=count)
    on = np.einsum("nk,nkd->nd", shares, surface.vertices[surface.faces[faces]])
    return on + 0.02 * generator.normal(size=on.shape)


def test_points_and_normals_go_along_with_a_rigid_motion(torus):
    turn = np.array([[0.0, -1.0, 0.0], [0.8, 0.0, -0.6], [0.6, 0.0, 0.8]])
    shift, points = np.array([1.0, 2.0, 3.0]), some_points(torus)
    rigid = SurfaceMap(torus, torus.vertices @ turn.T + shift, np.broadcast_to(turn, (len(torus.vertices), 3, 3)))
    foot = rigid.foot(points)
    normals = torus.cell_normals[foot.faces]
    np.testing.assert_allclose(rigid.at(foot), points @ turn.T + shift, atol=1e-12)
    np.testing.assert_allclose(rigid.turned(foot, normals), normals @ turn.T, atol=1e-12)


def test_the_nearest_points_are_those_of_libigl(torus):
    points = some_points(torus)
    foot = SurfaceMap(torus, torus.vertices, np.zeros((len(torus.vertices), 3, 3))).foot(points)
    nearest = np.einsum("nk,nkd->nd", foot.shares, torus.vertices[torus.faces[foot.faces]])
    squares = igl.point_mesh_squared_distance(points, torus.vertices, torus.faces)[0]
    np.testing.assert_allclose(((nearest - points) ** 2).sum(axis=1), squares, atol=1e-12)


def test_a_point_beyond_a_corner_is_nearest_to_the_corner():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    for point, shares in (([-1, -1, 1], [1, 0, 0]), ([0.5, -2, 0], [0.5, 0.5, 0]), ([0.2, 0.2, 3], [0.6, 0.2, 0.2])):
        np.testing.assert_allclose(nearest_in_triangles(np.array([point], float), corners)[0], shares, atol=1e-12)


def test_normals_follow_a_stretch(torus):
    """Of x -> A x, without rotations: A^-T n."""
    stretch = np.diag([1.0, 2.0, 0.5])
    still = np.broadcast_to(stretch, (len(torus.vertices), 3, 3))
    foot = SurfaceMap(torus, torus.vertices @ stretch, still).foot(torus.vertices[torus.faces].mean(axis=1))
    normals = torus.cell_normals[foot.faces]
    wanted = normals @ np.linalg.inv(stretch)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    found = SurfaceMap(torus, torus.vertices @ stretch, still).turned(foot, normals)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
