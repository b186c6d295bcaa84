"""The field off the surface follows the surface."""

import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from implicit import Along, Ball, Field, Handle, Siren, geometric_edit, sample_surface, shapes
from implicit.models import Mlp
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.least_squares import DENSE_LIMIT, LeastSquares
from implicit.step.off_surface import off_surface
from implicit.step.problem import StepProblem, assemble
from implicit.surface.quadrature import SurfaceSample


def solved(field, energy):
    space = DeformationSpace(field)
    system = LeastSquares(space.size, field.theta)
    for rows in energy.rows(space):
        system.add(rows)
    return field.with_theta(field.theta + system.solve(relative_damping=1e-12).x)


@pytest.mark.parametrize("scale", [1.0, 5.0], ids=["distance", "not-a-distance"])
def test_a_sphere_told_to_grow_does_so_from_its_off_surface_points_alone(scale):
    """f = scale (|x| - r): every point off the surface agrees that r grows by just what the surface was told."""
    field = shapes.sphere(radius=0.4, scale=scale, parameters=["radius"])
    sample = sample_surface(field, 200)
    energy = off_surface(field, sample, torch.full((200,), 0.03, dtype=torch.float64))
    assert float(solved(field, energy).theta) == pytest.approx(0.43, rel=1e-9)


def test_a_tied_field_follows_the_step_that_the_surface_takes():
    """Two parameters, the radius and a height added to f: raising it alone would tear the field off its surface."""
    field = shapes.sphere(radius=0.4)
    sample = sample_surface(field, 200)
    energy = off_surface(field, sample, points=50)
    (rows,) = energy.rows(DeformationSpace(field))
    grown = torch.zeros_like(field.theta)
    grown[0] = 0.03
    torch.testing.assert_close(rows.matrix @ grown, energy.target, rtol=0, atol=1e-12)


def test_no_motion_asked_for_means_none():
    field = shapes.sphere(radius=0.4)
    asked = torch.full((100,), float("nan"), dtype=torch.float64)
    moved = solved(field, off_surface(field, sample_surface(field, 100), asked))
    torch.testing.assert_close(moved.theta, field.theta, rtol=0, atol=1e-12)


@pytest.mark.parametrize("motion", [None, torch.zeros(100, dtype=torch.float64)], ids=["tied", "told"])
def test_the_products_are_those_of_the_rows(wobbly, motion):
    space = DeformationSpace(wobbly)
    energy = off_surface(wobbly, sample_surface(wobbly, 100), motion, points=20)
    (rows,) = energy.rows(space)
    operator = energy.operator(space)
    x, y = torch.randn(space.size, dtype=torch.float64), torch.randn(20, dtype=torch.float64)
    torch.testing.assert_close(operator.forward(x), rows.matrix @ x)
    torch.testing.assert_close(operator.adjoint(y), rows.matrix.T @ y)


def test_targets_on_the_surface_and_off_it_unite_to_the_same_step():
    """By the products of the layers, of both kinds of points together, as by the rows of each."""
    torch.manual_seed(0)
    field = Field(Siren(width=24, depth=2).to(torch.float64))
    points = 1.6 * torch.rand(40, 3, dtype=torch.float64) - 0.8
    sample = SurfaceSample(points, field.normal(points), torch.rand(40, dtype=torch.float64) + 0.5)
    motion = 0.02 * torch.randn(40, dtype=torch.float64)
    energies = [NormalTarget(points, motion, sample.weights), off_surface(field, sample, motion, points=30)]
    together = assemble(StepProblem(DeformationSpace(field), energies))
    ours = together.solve(1e-6)
    assert ours.method == "dual"
    # numpy's, of the rows of each above the root of the damping
    blocks = [rows for energy in energies for rows in energy.rows(DeformationSpace(field))]
    A, y = (
        torch.cat([rows.rooted() for rows in blocks]),
        torch.cat([rows.weights.sqrt() * rows.target for rows in blocks]),
    )
    n = A.shape[1]
    stacked, target = np.vstack([A.numpy(), 1e-3 * np.eye(n)]), np.concatenate([y.numpy(), np.zeros(n)])
    truth = np.linalg.lstsq(stacked, target)[0]
    np.testing.assert_allclose(ours.x, truth, rtol=1e-6, atol=1e-9)
    assert ours.objective == pytest.approx(float(np.sum((A.numpy() @ truth - y.numpy()) ** 2)), rel=1e-6)


def test_a_large_network_at_few_points_is_solved_among_the_points():
    """The default edit of 33,665 parameters, whose dense normal matrix nobody wants, has no need of iterations."""
    torch.manual_seed(0)
    module = Mlp(width=128, depth=3)
    with torch.no_grad():
        level = float(module(0.5 * normalize(torch.randn(500, 3))).median())
    field = Field(module, level=level)
    bump = Handle(Ball((0.0, 0.5, 0.0), 0.3), Along(0.01))
    edit = geometric_edit(field, bump, steps=1, points=300, resolution=24)
    assert len(field.theta) > DENSE_LIMIT
    assert edit.history[0]["method"] == "dual"


def test_a_distorted_distance_is_restored():
    """f = r^2 / R - r and the like have slope one on the surface only: the rest asks for its deviation back."""
    field = shapes.ellipsoid((0.5, 0.5, 0.5))
    sample = sample_surface(field, 4000)
    energy = off_surface(field, sample, restore=0.5, points=50)
    value, distance = field.value(energy.points), energy.points.norm(dim=1) - 0.5
    torch.testing.assert_close(energy.target, 0.5 * (distance - value), rtol=0, atol=5e-3)
