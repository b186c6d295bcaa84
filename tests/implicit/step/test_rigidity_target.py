"""The energy about its minimum as an energy of a step: its value, its rows, and a step that lowers it."""

import numpy as np
import pytest
import torch

from implicit.edits.towards_points import TowardsPoints
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import total_energy
from implicit.step.rigidity_target import RigidityTarget
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.surface.even_mesh import even_mesh


@pytest.fixture
def rest(wobbly):
    return WeakSurface.of(*even_mesh(wobbly, 400))


def target_of(field, rest, gaps):
    points = torch.from_numpy(rest.vertices)
    laplacian = SpokesAndRims(rest.vertices, rest.faces).laplacian
    return RigidityTarget(points, field.normal(points), gaps, laplacian)


def test_the_energy_of_gaps_is_that_of_the_motion_along_the_normals(wobbly, rest):
    gaps = torch.from_numpy(np.random.default_rng(0).normal(size=len(rest.vertices)))
    target = target_of(wobbly, rest, gaps)
    moved = (gaps[:, None] * target.normals).numpy()
    assert target.energy() == pytest.approx(np.vdot(moved, target.laplacian @ moved), rel=1e-10)


def test_the_rows_give_the_energy_of_what_a_step_leaves(wobbly, rest):
    gaps = torch.from_numpy(0.01 * np.random.default_rng(0).normal(size=len(rest.vertices)))
    target, space = target_of(wobbly, rest, gaps), DeformationSpace(wobbly)
    x = 0.01 * torch.randn(space.size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    moved = torch.cat([rows @ x for _, rows in space.normal_rows(target.points)])
    assert total_energy([target], space, x) == pytest.approx(target.energy(moved - gaps), rel=1e-6)


def test_a_step_lowers_the_energy_of_the_vertices_on_the_field(wobbly, rest):
    """To where they were, from a field whose surface has ripples; counted are the finite rotations themselves."""
    energy = SpokesAndRims(rest.vertices, rest.faces)
    noise = torch.randn(len(wobbly.theta), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    rippled = wobbly.with_theta(wobbly.theta + 0.001 * noise)
    masses = torch.from_numpy(rest.masses)
    operation = TowardsPoints(torch.from_numpy(rest.vertices), masses, energy.laplacian, seed=0)
    target = operation.left(rippled)
    problem = DeformationSpace(rippled)
    (rows,) = target.rows(problem)
    x = torch.linalg.lstsq(rows.matrix, rows.target[:, None], driver="gelsd", rcond=1e-4).solution[:, 0]
    mended = rippled.with_theta(rippled.theta + x)
    before, after = (energy.energy(operation.left(field).points.numpy()) for field in (rippled, mended))
    assert after < 0.2 * before
