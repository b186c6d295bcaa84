"""Rows of a deformation space against differences of the displacement that they belong to."""

import math

import numpy as np
import pytest
import torch

from implicit import Field, sample_surface, shapes, surface_quadrature
from implicit.sensitivity.frame import Frame
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Killing, NormalTarget, Smoothness, VectorTarget, total_energy
from implicit.step.tangential_basis import CosineFeatures


@pytest.fixture
def space(wobbly):
    return DeformationSpace(wobbly, CosineFeatures(wobbly, waves=15, seed=1))


@pytest.fixture
def x(space):
    return torch.randn(space.size, generator=torch.Generator().manual_seed(2), dtype=torch.float64)


def gathered(blocks, dim=0):
    return torch.cat([rows for _, rows in blocks], dim=dim)


def test_normal_and_tangent_rows_give_the_displacement(space, x):
    sample = sample_surface(space.field, 20)
    moved = space.displacement(sample.points, x)
    speed = gathered(space.normal_rows(sample.points)) @ x[: space.parameters]
    torch.testing.assert_close(speed, (moved * sample.normals).sum(dim=1))
    ((_, axes, rows),) = space.tangent_rows(sample.points)
    torch.testing.assert_close(rows @ x[space.parameters :], (axes @ moved[:, :, None])[:, :, 0])


@pytest.mark.parametrize("left_out", [(), ((2, 2),), ((0, 2), (1, 2), (2, 2))], ids=["all", "no-normal", "tangential"])
def test_strain_rows_match_differences_of_the_displacement(space, x, left_out):
    """Of each point the weighted sum of squares over its entries; two or more rows are free of the parameters."""
    points = sample_surface(space.field, 12).points
    step, eye = 1e-5, torch.eye(3, dtype=torch.float64)
    columns = [
        (space.displacement(points + step * e, x) - space.displacement(points - step * e, x)) / (2 * step) for e in eye
    ]
    J = torch.stack(columns, dim=2)
    axes = Frame.at(space.field, points).axes
    strain = axes @ (J + J.transpose(1, 2)) @ axes.transpose(1, 2)
    shares = {(a, b): 1.0 + a + 2 * b for a in range(3) for b in range(a, 3) if (a, b) not in left_out}
    expected = sum(share * strain[:, a, b] ** 2 for (a, b), share in shares.items())
    ((_, rows, rest),) = space.strain_rows(points, shares)
    assert len(rest) == 2
    found = (rows @ x).square().sum(dim=0) + (rest @ x[space.parameters :]).square().sum(dim=0)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


def test_slope_rows_match_differences_of_the_normal_speed(wobbly):
    space = DeformationSpace(wobbly)
    x = torch.randn(space.size, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    points = sample_surface(wobbly, 12).points
    axes = Frame.at(wobbly, points).axes
    rows = torch.cat([rows for _, _, rows in space.normal_slope_rows(points)]) @ x
    step = 1e-5
    for t in range(2):
        ends = [gathered(space.normal_rows(points + sign * step * axes[:, t])) @ x for sign in (1, -1)]
        torch.testing.assert_close(rows[:, t], (ends[0] - ends[1]) / (2 * step), rtol=1e-5, atol=1e-5)


def growing_sphere():
    """A unit ball's field and the unknowns that move its surface outward at speed one."""
    field = shapes.sphere(radius=0.5)
    space = DeformationSpace(field)
    column = (gathered(space.normal_rows(sample_surface(field, 9).points)) - 1).abs().amax(dim=0).argmin()
    return space, torch.nn.functional.one_hot(column, space.size).double()


def test_killing_energy_of_a_growing_sphere_is_that_of_its_parts():
    """D = n: tangential part 8/r^2 a point (32 pi over the sphere); the extension x/|x| adds nothing."""
    space, x = growing_sphere()
    sample = surface_quadrature(space.field, 32)
    for bending, thickness in ((0.0, 0.0), (1.0, 1.0)):
        energy = total_energy([Killing(sample.points, sample.weights, bending, thickness)], space, x)
        assert energy == pytest.approx(32 * math.pi, rel=1e-4)


def test_bending_alone_of_a_spherical_harmonic_is_its_dirichlet_energy():
    """u = n_x^2 - n_y^2, of degree 2: 2 int |grad u|^2 = 2 . 6 . 16 pi / 15. A ball grows by its three radii."""
    field = shapes.ellipsoid((0.5, 0.5, 0.5), parameters=["radii"])
    sample = surface_quadrature(field, 32)
    bending = Killing(sample.points, sample.weights, bending=1.0, thickness=0.0, stretch=0.0)
    x = torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64)
    assert total_energy([bending], DeformationSpace(field), x) == pytest.approx(64 * math.pi / 5, rel=1e-4)
    # and an offset turns no normal
    assert total_energy([bending], DeformationSpace(field), torch.ones_like(x)) < 1e-15


def test_bending_alone_charges_a_translation_only_without_the_slide():
    """u = n . v: 2 int |grad u|^2 = 16 pi / 3 |v|^2 by the field alone; nothing once the points slide along."""
    field = shapes.sphere(0.5, parameters=["center"])
    sample = surface_quadrature(field, 32)
    bending = Killing(sample.points, sample.weights, bending=1.0, thickness=0.0, stretch=0.0)
    way = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    alone = total_energy([bending], DeformationSpace(field), way)
    assert alone == pytest.approx(16 * math.pi / 3 * float(way @ way), rel=1e-4)
    slide = torch.zeros(3, 4, dtype=torch.float64)
    slide[:, 0] = way  # the constant among the features
    space = DeformationSpace(field, CosineFeatures(field, waves=0))
    assert total_energy([bending], space, torch.cat([way, slide.flatten()])) < 1e-15


def test_smoothness_of_even_motion_is_zero():
    space, x = growing_sphere()
    sample = surface_quadrature(space.field, 16)
    assert total_energy([Smoothness(sample.points, sample.weights)], space, x) < 1e-20


def test_rigid_motion_by_affine_features_has_no_strain(wobbly):
    """The space must hold translations: the sphere's own centre moves the field, the constant feature the rest."""
    field = shapes.sphere(radius=0.5)
    features = CosineFeatures(field, waves=0)
    space = DeformationSpace(field, features)
    sample = sample_surface(field, 40)
    way = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    reach = VectorTarget(sample.points, way.expand(40, 3), sample.weights).rows(space)
    A = torch.cat(
        [torch.nn.functional.pad(rows.matrix, (rows.first, space.size - rows.columns.stop)) for rows in reach]
    )
    y = torch.cat([rows.target for rows in VectorTarget(sample.points, way.expand(40, 3), sample.weights).rows(space)])
    x = torch.from_numpy(np.linalg.lstsq(A.numpy(), y.numpy())[0])
    torch.testing.assert_close(space.displacement(sample.points, x), way.expand(40, 3), rtol=0, atol=1e-9)
    assert total_energy([Killing(sample.points, sample.weights)], space, x) < 1e-15


def test_targets_measure_the_weighted_miss(space, x):
    sample = sample_surface(space.field, 20)
    weights = sample.weights * torch.arange(1, 21)
    moved = space.displacement(sample.points, x)
    zero = torch.zeros_like(sample.points)
    whole = total_energy([VectorTarget(sample.points, zero, weights)], space, x)
    assert whole == pytest.approx(float(weights @ moved.square().sum(dim=1)))
    along = (moved * sample.normals).sum(dim=1)
    part = total_energy([NormalTarget(sample.points, zero[:, 0], weights)], space, x)
    assert part == pytest.approx(float(weights @ along**2))


def test_axes_are_orthonormal_and_end_with_the_normal(wobbly):
    sample = sample_surface(wobbly, 30)
    axes = Frame.at(wobbly, sample.points).axes
    torch.testing.assert_close(axes @ axes.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand(30, 3, 3))
    torch.testing.assert_close(axes[:, 2], sample.normals)


def test_feature_slopes_match_differences(wobbly):
    assert isinstance(wobbly, Field)
    points = sample_surface(wobbly, 5).points
    wider = Field(wobbly.module, bounds=((-1.5, -1.5, -1.5), (2.0, 2.0, 2.0)))  # features count in half of its size
    features = CosineFeatures(wider, waves=10)
    step = 1e-6
    for axis in range(3):
        way = step * torch.eye(3, dtype=torch.float64)[axis]
        measured = (features.values(points + way) - features.values(points - way)) / (2 * step)
        torch.testing.assert_close(features.slopes(points)[:, axis], measured, rtol=1e-6, atol=1e-7)
