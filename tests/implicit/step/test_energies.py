"""Each energy against a closed form on a sphere or a torus, and none for rigid motions."""

import math

import pytest
import torch

from implicit import project_to_surface, shapes, surface_quadrature
from implicit.sensitivity.frame import Frame, normal_component, tangential_component
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import FieldTarget, Killing, NormalTarget, Smoothness, VectorTarget, total_energy, united
from implicit.step.tangential_basis import CosineFeatures

R = 0.5


def vector(*numbers):
    return torch.tensor(numbers, dtype=torch.float64)


def affine(space, shift, matrix):
    """The unknowns of a space over affine functions of x: c with T(x) = shift + matrix x, the field given apart."""
    c = torch.zeros(3, 4, dtype=torch.float64)
    c[:, 0] = shift
    c[:, 1:] = matrix * float(space.field.size) / 2  # the functions count in halves of the field's size
    return c.flatten()


@pytest.fixture(scope="module")
def ball():
    """A ball whose centre moves it: u = n . v."""
    field = shapes.sphere(R, parameters=["center"])
    return DeformationSpace(field), surface_quadrature(field, 32)


@pytest.fixture(scope="module")
def torus():
    """A torus whose minor radius alone moves it: u = 1."""
    field = shapes.torus(0.6, 0.2, parameters=["r"])
    return DeformationSpace(field), surface_quadrature(field, 48)


def test_a_normal_target_on_a_ball_is_the_integral_of_the_squared_miss(ball):
    """u = n . v against t: int (n . v - t)^2 = 4 pi r^2 (|v|^2 / 3 + t^2)."""
    space, sample = ball
    v, t = vector(0.3, -0.2, 0.1), 0.25
    energy = NormalTarget(sample.points, torch.full_like(sample.weights, t), sample.weights)
    expected = 4 * math.pi * R**2 * (float(v @ v) / 3 + t**2)
    assert total_energy([energy], space, v) == pytest.approx(expected, rel=1e-5)


def test_a_normal_target_on_a_torus_is_its_area_times_the_square(torus):
    space, sample = torus
    energy = NormalTarget(sample.points, torch.full_like(sample.weights, 0.1), sample.weights)
    area = 4 * math.pi**2 * 0.6 * 0.2
    assert total_energy([energy], space, vector(0.3)) == pytest.approx(area * 0.2**2, rel=1e-5)


def test_a_vector_target_counts_what_lies_along_the_surface(ball):
    """Normal motion n (n . v) misses v by its tangential part: int |v|^2 - (n . v)^2 = 4 pi r^2 . 2/3 |v|^2."""
    space, sample = ball
    v = vector(0.3, -0.2, 0.1)
    energy = VectorTarget(sample.points, v.expand_as(sample.points), sample.weights)
    assert total_energy([energy], space, v) == pytest.approx(8 / 3 * math.pi * R**2 * float(v @ v), rel=1e-5)


def test_a_field_target_is_that_of_the_field_anywhere(ball):
    """f = |x - c| - r changes by -x . v / |x|; over the scale 2 it is to change by 0.1."""
    space, _ = ball
    points = vector(0.9, 0.0, 0.0)[None]
    energy = FieldTarget(points, vector(0.1), vector(3.0), vector(2.0))
    assert total_energy([energy], space, vector(0.4, 0.7, 0.7)) == pytest.approx(3 * (-0.4 / 2 - 0.1) ** 2)


def test_a_normal_target_is_the_same_as_changes_of_the_field(torus):
    space, sample = torus
    energy = NormalTarget(sample.points, sample.points[:, 1], sample.weights)
    (as_field,) = united(space.field, [energy])
    x = vector(0.3)
    assert total_energy([as_field], space, x) == pytest.approx(total_energy([energy], space, x), rel=1e-12)


def test_smoothness_is_the_dirichlet_energy(ball, torus):
    """u = n . v has the slope (v - n (n . v)) / r: int |grad u|^2 = 8 pi / 3 |v|^2; even motion has none."""
    space, sample = ball
    v = vector(0.3, -0.2, 0.1)
    expected = 8 / 3 * math.pi * float(v @ v)
    assert total_energy([Smoothness(sample.points, sample.weights)], space, v) == pytest.approx(expected, rel=1e-5)
    radius = sample.points.norm(dim=1)[:, None]
    slope = tangential_component(v.expand_as(sample.points), sample.points / radius) / radius
    assert total_energy([Smoothness(sample.points, sample.weights, slope)], space, v) < 1e-12
    space, sample = torus
    assert total_energy([Smoothness(sample.points, sample.weights)], space, vector(1.0)) < 1e-20


def test_killing_energy_of_a_growing_torus_is_that_of_its_curvatures(torus):
    """u = 1 strains by 2 k1 and 2 k2: 4 int k1^2 + k2^2, with k1 = 1/r and k2 = cos t / (R + r cos t)."""
    space, sample = torus
    major, minor = 0.6, 0.2
    # int cos^2 t / (R + r cos t) dt over a turn, from int 1 / (R + r cos t) dt = 2 pi / sqrt(R^2 - r^2)
    root = math.sqrt(major**2 - minor**2)
    second = 2 * math.pi * minor * (2 * math.pi * major / minor**2) * (major / root - 1)
    first = 4 * math.pi**2 * major / minor
    for thickness in (0.0, 1.0):
        killing = Killing(sample.points, sample.weights, bending=1.0, thickness=thickness)
        assert total_energy([killing], space, vector(1.0)) == pytest.approx(4 * (first + second), rel=1e-4)


@pytest.mark.parametrize("parts", [(1.0, 1.0, 1.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, 2.0, 0.7)])
def test_rigid_motions_have_no_killing_energy(parts):
    """A translation moves the ball's centre along; a rotation about it is all in the tangential part."""
    field = shapes.sphere(R, parameters=["center"])
    space = DeformationSpace(field, CosineFeatures(field, waves=0))
    sample = surface_quadrature(field, 12)
    bending, thickness, stretch = parts
    killing = Killing(sample.points, sample.weights, bending, thickness, stretch)
    v, spin = vector(0.3, -0.2, 0.1), vector(0.5, 0.4, -0.7)
    zero, none = torch.zeros(3, 3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    cross = torch.linalg.cross(spin.expand(3, 3), torch.eye(3, dtype=torch.float64)).T
    for d_theta, T in ((v, affine(space, v, zero)), (none, affine(space, none, cross)), (v, affine(space, v, cross))):
        x = torch.cat([d_theta, T])
        assert float(space.displacement(sample.points, x).norm(dim=1).max()) > 0.1
        assert total_energy([killing], space, x) < 1e-20
    # The tangential part of a translation alone, without the field's, is no rigid motion.
    assert total_energy([killing], space, torch.cat([none, affine(space, v, zero)])) > 0.1


def test_the_shape_operator_of_a_torus_has_its_curvatures(torus):
    space, sample = torus
    points = project_to_surface(space.field, sample.points[:50])
    axis = int(torch.argmin(points.abs().amax(dim=0)))  # the torus is thinnest along its axis
    away = torch.cat([points[:, :axis], points[:, axis + 1 :]], dim=1).norm(dim=1)
    expected = torch.stack([(away - 0.6) / 0.2 / away, torch.full_like(away, 1 / 0.2)], dim=1)
    found = torch.linalg.eigvalsh(Frame.at(space.field, points).shape_operator)
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6)


def test_components_add_up_and_are_orthogonal(ball):
    _, sample = ball
    v = torch.randn(sample.points.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    along, across = tangential_component(v, sample.normals), normal_component(v, sample.normals)
    torch.testing.assert_close(along + across, v)
    torch.testing.assert_close((along * sample.normals).sum(dim=1), torch.zeros(len(v), dtype=torch.float64))


def test_energies_print_as_one_line(ball):
    space, sample = ball
    slope = torch.zeros_like(sample.points)
    normal = NormalTarget(sample.points, sample.weights, sample.weights)
    energies = [
        normal,
        normal.of_field(space.field),
        VectorTarget(sample.points, slope, sample.weights),
        Smoothness(sample.points, sample.weights),
        Killing(sample.points, sample.weights),
    ]
    for thing in [*energies, space, Frame.at(space.field, sample.points), CosineFeatures(space.field, waves=3)]:
        assert repr(thing).startswith(type(thing).__name__ + "(")
        assert "\n" not in repr(thing)
        assert "tensor" not in repr(thing)
