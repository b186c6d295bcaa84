"""The energy of planar shapes: libigl's in two dimensions, zero for rigid motions, and areas with their derivatives."""

import math

import igl
import numpy as np
import pytest
from scipy.spatial import Delaunay

from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.local_global import Hold, LocalGlobal, MinimumStatus
from implicit.step.planar_rigidity import EnclosedArea, PlanarSpokesAndRims
from implicit.step.surface_map import SurfaceMap


@pytest.fixture(scope="module")
def plate():
    """A rectangle of 2 by 0.5 in triangles (V, 2), (m, 3), its boundary last; corners of a slightly uneven lattice."""
    x, y = np.meshgrid(np.linspace(0, 2, 21), np.linspace(0, 0.5, 6))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    inner = (points[:, 0] > 0) & (points[:, 0] < 2) & (points[:, 1] > 0) & (points[:, 1] < 0.5)
    points[inner] += 0.01 * np.random.default_rng(0).normal(size=(int(inner.sum()), 2))
    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    across = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    kept = np.abs(across) > 1e-9
    return points, np.where(across[:, None] < 0, faces[:, ::-1], faces)[kept]


def planar(points):
    return np.pad(points, ((0, 0), (0, 1)))


def turn(angle):
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


@pytest.mark.parametrize("angle", [0.0, 2.0, math.pi])
def test_a_rigid_motion_of_any_size_costs_nothing(plate, angle):
    V, F = plate
    energy = PlanarSpokesAndRims(planar(V), F)
    there = planar(V @ turn(angle).T + [3.0, -1.0])
    assert energy.energy(there) < 1e-24
    found = energy.rotations(there)[:, :2, :2]
    np.testing.assert_allclose(found, np.broadcast_to(turn(angle), (len(V), 2, 2)), atol=1e-9)


def test_a_reflection_is_no_rigid_motion(plate):
    """As a half turn out of the plane it would cost nothing."""
    V, F = plate
    energy = PlanarSpokesAndRims(planar(V), F)
    mirrored = planar(V * [1.0, -1.0])
    assert energy.energy(mirrored) > 0.1 * float(
        energy.edge_weights @ (energy.differences @ planar(V) ** 2).sum(axis=1)
    )
    np.testing.assert_allclose(energy.rotations(mirrored)[:, 2, 2], 1.0, atol=1e-9)


def test_its_minimum_is_that_of_libigl_in_two_dimensions(plate):
    """One end held, the other turned by 60 degrees and moved; libigl iterates until it rests."""
    V, F = plate
    held = np.flatnonzero((V[:, 0] < 0.05) | (V[:, 0] > 1.95)).astype(np.int32)
    goals = V.copy()
    right = V[:, 0] > 1.95
    goals[right] = (V[right] - [2.0, 0.25]) @ turn(1.0).T + [1.6, 1.2]
    data = igl.ARAPData()
    data.energy = igl.ARAP_ENERGY_TYPE_SPOKES_AND_RIMS
    data.max_iter = 500
    igl.arap_precomputation(V, F, 2, held, data)
    theirs = igl.arap_solve(goals[held], data, V.copy())
    energy = PlanarSpokesAndRims(planar(V), F)
    mask = np.zeros(len(V), dtype=bool)
    mask[held] = True
    ours = LocalGlobal(energy, Hold(mask, np.zeros(len(V)))).minimum(
        lambda fraction: planar(V + fraction * (goals - V)), planar(V), tolerance=1e-8, iterations=2000
    )
    assert ours.status is MinimumStatus.CONVERGED
    assert ours.energy <= energy.energy(planar(theirs)) * (1 + 1e-6)
    np.testing.assert_allclose(ours.positions[:, :2], theirs, atol=2e-3)
    assert (ours.positions[:, 2] == 0).all()


def test_the_energy_of_the_boundary_is_that_of_the_best_inside(plate):
    """x . L_B x is the least of x . L x over what lies inside."""
    V, F = plate
    ends = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    codes = ends[:, 0] * len(V) + ends[:, 1]
    boundary = np.unique(ends[~np.isin(codes, ends[:, 1] * len(V) + ends[:, 0])])
    order = np.concatenate([boundary, np.setdiff1d(np.arange(len(V)), boundary)])
    renamed = np.argsort(order)
    energy = PlanarSpokesAndRims(planar(V[order]), renamed[F])
    B = len(boundary)
    L = energy.laplacian.toarray()
    x = np.random.default_rng(1).normal(size=B)
    inside = np.linalg.solve(L[B:, B:], -L[B:, :B] @ x)
    best = np.concatenate([x, inside])
    assert x @ (energy.of_curve(B) @ x) == pytest.approx(best @ L @ best, rel=1e-10)


def test_the_area_has_its_derivative_and_is_reached():
    n = 40
    at = 2 * np.pi * np.arange(n) / n
    circle = planar(np.stack([np.cos(at), np.sin(at)], axis=1))
    area = EnclosedArea(np.stack([np.arange(n), np.roll(np.arange(n), -1)], axis=1))
    assert area.value(circle) == pytest.approx(n / 2 * math.sin(2 * math.pi / n), rel=1e-12)
    way = planar(np.random.default_rng(0).normal(size=(n, 2)))
    difference = (area.value(circle + 1e-5 * way) - area.value(circle - 1e-5 * way)) / 2e-5
    assert np.vdot(area.gradient(circle), way) == pytest.approx(difference, rel=1e-8)
    for wanted in (2.0, 3.5):
        reached = area.reached(circle, area.gradient(circle), wanted)
        assert area.value(reached) == pytest.approx(wanted, rel=1e-12)


def test_a_map_of_a_curve_is_exact_for_rigid_motions_and_turns_normals():
    n = 30
    at = 2 * np.pi * np.arange(n) / n
    curve = WeakSurface(
        np.stack([np.cos(at), 0.5 * np.sin(at)], axis=1), np.stack([np.arange(n), np.roll(np.arange(n), -1)], axis=1)
    )
    R, shift = turn(2.5), np.array([0.3, -0.7])
    rigid = SurfaceMap(curve, curve.vertices @ R.T + shift, np.broadcast_to(R, (n, 2, 2)))
    points = 1.1 * curve.vertices + 0.01
    foot = rigid.foot(points)
    np.testing.assert_allclose(rigid.at(foot), points @ R.T + shift, atol=1e-12)
    np.testing.assert_allclose(rigid.turned(foot, curve.normals), curve.normals @ R.T, atol=1e-12)
