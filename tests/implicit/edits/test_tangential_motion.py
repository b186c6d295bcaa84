"""Motions along the surface that follow from the normal motion, against rigid motions and the support function."""

import pytest
import torch
from torch import nn

from implicit import ConstantNormals, Field, NearIsometric, normal_displacement, sample_surface, shapes
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Killing, total_energy
from implicit.step.parameter_basis import Directions
from implicit.step.tangential_basis import CosineFeatures

WAY = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
RADII = torch.tensor([0.7, 0.5, 0.4], dtype=torch.float64)


class Turned(nn.Module):
    """A shape turned by the vector `turn` (axis times angle, radians), to first order about no turn."""

    def __init__(self, shape: Field) -> None:
        super().__init__()
        self.shape = shape.module
        self.turn = nn.Parameter(torch.zeros(3, dtype=torch.float64))

    def forward(self, points):
        back = points - torch.linalg.cross(self.turn.expand_as(points), points)
        return self.shape(back)


def moved(field, slide, d_theta, points):
    """D = u n + t."""
    u = normal_displacement(field, points, d_theta)
    return field.normal(points) * u[:, None] + slide(field, d_theta, points)


def shift_of(field):
    """The parameter change that translates a shape with a centre by WAY."""
    d_theta = torch.zeros_like(field.theta)
    d_theta[-3:] = WAY
    return d_theta


def on(field, n=60):
    return sample_surface(field, n, seed=3)


@pytest.mark.parametrize(
    "make", [lambda: shapes.sphere(0.5), lambda: shapes.ellipsoid(RADII.tolist())], ids=["sphere", "ellipsoid"]
)
def test_constant_normals_translate_a_convex_shape_as_a_whole(make):
    field = make()
    names = list(dict(field.module.named_parameters()))
    assert names[-1] == "center", names
    points = on(field).points
    found = moved(field, ConstantNormals(1e-5), shift_of(field), points)
    torch.testing.assert_close(found, WAY.expand_as(points), rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("slide", "error"), [(ConstantNormals(1e-4), 1e-4), (NearIsometric(), 1e-4)], ids=["constant normals", "isometric"]
)
def test_a_network_that_translates_its_surface_takes_every_point_along(spot, slide, error):
    """f(x - v) is the network with the biases of its first layer lowered by W v, to all orders."""
    layer = spot.module.layers[0]
    d_theta = torch.zeros_like(spot.theta)
    (bias,) = (part.where for part in spot.layout if part.name == "layers.0.bias")
    d_theta[bias] = -(layer.weight.detach() @ WAY)
    points = on(spot, 100).points
    missed = (moved(spot, slide, d_theta, points) - WAY).norm(dim=1)
    assert float(missed.square().mean().sqrt()) < error


def test_constant_normals_of_a_turning_ellipsoid_follow_its_support_function():
    """x(n) = M n / sqrt(n . M n) has the normal n; turning by w changes M at the rate [w] M - M [w]."""
    field = Field(Turned(shapes.ellipsoid(RADII.tolist())), parameters=["turn"])
    points = on(field).points
    n = field.normal(points)
    M = torch.diag(RADII**2)
    W = torch.linalg.cross(WAY.expand(3, 3), torch.eye(3, dtype=torch.float64)).T
    rate = W @ M - M @ W
    h = torch.einsum("ni,ij,nj->n", n, M, n).sqrt()[:, None]
    expected = n @ rate / h - n @ M * torch.einsum("ni,ij,nj->n", n, rate, n)[:, None] / (2 * h**3)
    torch.testing.assert_close(moved(field, ConstantNormals(1e-5), WAY, points), expected, rtol=0, atol=1e-8)


def test_constant_normals_keep_the_normals_of_any_field_to_second_order(wobbly):
    """The normal at x + h D of the field at theta + h d_theta differs from that at x by O(h^2)."""
    points = on(wobbly).points
    generator = torch.Generator().manual_seed(5)
    d_theta = torch.randn(len(wobbly.theta), generator=generator, dtype=torch.float64)
    D = moved(wobbly, ConstantNormals(1e-6), d_theta, points)
    # Of the points where the motion is not too long for the steps below.
    calm = D.norm(dim=1) < D.norm(dim=1).median()
    points, D = points[calm], D[calm]
    turned = [
        float((wobbly.with_theta(wobbly.theta + h * d_theta).normal(points + h * D) - wobbly.normal(points)).norm())
        for h in (1e-3, 5e-4)
    ]
    assert turned[0] / turned[1] == pytest.approx(4, rel=0.05)


def test_constant_normals_fade_out_on_flat_parts():
    """The side of a capsule is flat along its axis: nothing moves that way, however the end caps do."""
    field = shapes.capsule((-0.4, 0, 0), (0.4, 0, 0), 0.2)
    points = on(field, 200).points
    side = points[points[:, 0].abs() < 0.35]
    generator = torch.Generator().manual_seed(6)
    d_theta = torch.randn(len(field.theta), generator=generator, dtype=torch.float64)
    assert float(ConstantNormals()(field, d_theta, side)[:, 0].abs().max()) < 1e-9


def test_near_isometry_carries_a_translated_sphere_rigidly():
    """The sphere may turn within itself: D is WAY and a rotation, whose strain is zero."""
    field = shapes.sphere(0.5)
    sample = on(field)
    slide = NearIsometric(CosineFeatures(field, waves=20), sample)
    D = moved(field, slide, shift_of(field), sample.points)
    axes = torch.eye(3, dtype=torch.float64)
    turns = [torch.linalg.cross(e.expand_as(sample.points), sample.points) for e in axes]
    rigid = torch.stack([*[e.expand_as(sample.points) for e in axes], *turns], dim=2).flatten(0, 1)
    motion = torch.linalg.lstsq(rigid, D.flatten()).solution
    torch.testing.assert_close(rigid @ motion, D.flatten(), rtol=0, atol=1e-7)
    torch.testing.assert_close(motion[:3], WAY, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", ["ellipsoid", "torus"])
def test_near_isometry_recovers_the_rotation_from_its_normal_part(kind):
    """A torus turns about its own axis unseen, so there the normal part says the other two components alone."""
    shape = shapes.ellipsoid(RADII.tolist()) if kind == "ellipsoid" else shapes.torus(0.6, 0.25)
    turn = WAY if kind == "ellipsoid" else WAY * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    field = Field(Turned(shape), parameters=["turn"])
    sample = on(field)
    D = moved(field, NearIsometric(CosineFeatures(field, waves=20), sample), turn, sample.points)
    if kind == "torus":  # the least coefficients leave no turn about the axis, but say so only to the damping
        around = torch.stack([-sample.points[:, 1], sample.points[:, 0], torch.zeros(60, dtype=torch.float64)], dim=1)
        D = D - around * (D * around).sum() / around.square().sum()
        expected = torch.linalg.cross(turn.expand_as(D), sample.points)
        expected = expected - around * (expected * around).sum() / around.square().sum()
    else:
        expected = torch.linalg.cross(turn.expand_as(D), sample.points)
    torch.testing.assert_close(D, expected, rtol=0, atol=1e-6)


def test_near_isometry_has_no_more_strain_than_other_slides(wobbly):
    """Of a motion that cannot be free of strain: any change of the coefficients found raises the energy."""
    features = CosineFeatures(wobbly, waves=10)
    sample = on(wobbly, 150)
    d_theta = torch.randn(len(wobbly.theta), generator=torch.Generator().manual_seed(8), dtype=torch.float64)
    slide = NearIsometric(features, sample)
    t = slide(wobbly, d_theta, sample.points)
    space = DeformationSpace(wobbly, features, Directions(d_theta[:, None]))
    ((_, axes, rows),) = space.tangent_rows(sample.points)
    c = torch.linalg.lstsq(rows.flatten(0, 1), (axes @ t[:, :, None]).flatten(), driver="gelsd").solution

    def strain(c):
        x = torch.cat([torch.ones(1, dtype=torch.float64), c])
        return total_energy([Killing(sample.points, sample.weights, 0.0, 0.0)], space, x)

    least = strain(c)
    assert least > 1e-3
    for seed in range(5):
        way = 0.1 * torch.randn(len(c), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        ends = strain(c + way) + strain(c - way) - 2 * least
        assert ends > 0
        assert strain(c + way) - strain(c - way) == pytest.approx(0, abs=1e-5 * ends)


@pytest.mark.parametrize("slide", [ConstantNormals(), NearIsometric()], ids=["constant normals", "near-isometric"])
def test_an_update_of_another_size_is_refused(wobbly, slide):
    with pytest.raises(ValueError, match="d_theta must have shape"):
        slide(wobbly, torch.zeros(3, dtype=torch.float64), on(wobbly, 5).points)


def test_a_curvature_of_zero_cannot_be_the_least():
    with pytest.raises(ValueError, match="least_curvature must be a positive"):
        ConstantNormals(0.0)
