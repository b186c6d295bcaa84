"""Curvature in weak form against closed forms, with its order; and where it is taken."""

import math

import numpy as np
import pytest
import torch

from implicit import Area, Field, SurfaceIntegral, extract_mesh, shapes, surface_quadrature, surface_topology
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.sensitivity.weak_curvature import WeakSurface, weak_mean_curvature


def mesh_of(field, resolution):
    return WeakSurface(*extract_mesh(field, resolution))


@pytest.mark.parametrize("field", [shapes.torus(0.6, 0.25), shapes.circle(0.5)], ids=["space", "plane"])
def test_the_curvature_vector_is_the_first_variation_of_area(field):
    """Against differences of the sum of the areas of the cells, where the vertices move at random."""
    surface = mesh_of(field, 12)
    direction = np.random.default_rng(0).normal(size=surface.vertices.shape)
    step = 1e-6
    sides = [WeakSurface(surface.vertices + s * step * direction, surface.faces).contents.sum() for s in (1, -1)]
    exact = (sides[0] - sides[1]) / (2 * step)
    assert (surface.curvature_vectors * direction).sum() == pytest.approx(exact, rel=1e-6)


def test_the_laplacian_of_the_vertices_is_the_curvature_vector():
    """L X by cotangents is the first variation, on a mesh without needles: an octahedron cut four times."""
    surface = WeakSurface(*_round_octahedron(4))
    np.testing.assert_allclose(surface.laplacian @ surface.vertices, surface.curvature_vectors, atol=1e-13)


def _round_octahedron(times):
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(times):
        x = vertices[faces]
        middles = (x + np.roll(x, -1, axis=1)) / 2
        corners = np.concatenate([x, middles], axis=1)  # 0 1 2, then the middles of 01, 12, 20
        parts = corners[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)
        vertices, inverse = np.unique(parts.round(12), axis=0, return_inverse=True)
        faces = inverse.reshape(-1, 3)
        vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, faces


@pytest.mark.parametrize("field", [shapes.torus(0.6, 0.25), shapes.sphere(0.5), shapes.circle(0.5)])
def test_the_masses_share_out_the_area_and_are_positive(field):
    surface = mesh_of(field, 20)
    assert surface.masses.sum() == pytest.approx(surface.contents.sum(), rel=1e-12)
    assert surface.masses.min() > 0


@pytest.mark.parametrize(("field", "euler"), [(shapes.torus(0.6, 0.25), 0), (shapes.sphere(0.5), 2)])
def test_gauss_curvature_adds_up_to_the_euler_number(field, euler):
    assert mesh_of(field, 20).integrated_gauss_curvature.sum() == pytest.approx(2 * math.pi * euler, abs=1e-9)


@pytest.mark.parametrize("corners", [3, 4, 12])
def test_the_curvature_of_a_regular_polygon_is_its_turning(corners):
    """2 sin of half the turning angle 2 pi / n at each corner; and 2 pi in all, to second order."""
    angle = 2 * np.pi * np.arange(corners) / corners
    k = np.arange(corners)
    polygon = WeakSurface(np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([k, (k + 1) % corners], axis=1))
    np.testing.assert_allclose(polygon.integrated_curvature, 2 * math.sin(math.pi / corners), rtol=1e-12)


def test_averaged_curvature_of_a_torus_tends_to_its_closed_form():
    """kappa = 1/r + cos(v) / (R + r cos(v)): the root mean square error falls by 3 at least where the cells halve."""
    errors = []
    for resolution in (24, 48):
        surface = mesh_of(shapes.torus(0.6, 0.25), resolution)
        ring = np.linalg.norm(surface.vertices[:, :2], axis=1)
        exact = 1 / 0.25 + (ring - 0.6) / 0.25 / ring
        errors.append(math.sqrt(surface.masses @ (surface.mean_curvature - exact) ** 2 / surface.masses.sum()))
    assert errors[1] < 0.25
    assert errors[0] / errors[1] > 2.5


def test_squared_curvatures_of_a_ball_are_two_over_the_squared_radius():
    surface = mesh_of(shapes.sphere(0.5), 32)
    mean = surface.masses @ surface.squared_curvatures / surface.masses.sum()
    assert mean == pytest.approx(8.0, rel=0.02)


def test_weak_and_pointwise_curvature_agree_on_a_smooth_field_with_second_order():
    """int kappa g of a torus, where both are defined, for a g that is not constant on it."""
    field = shapes.torus(0.6, 0.25)
    gaps = []
    for resolution in (16, 32):
        surface = mesh_of(field, resolution)
        points = torch.from_numpy(surface.vertices)
        g = points[:, 0].square().exp().numpy()
        sample = surface_quadrature(field, 64, exact_points=True)
        exact = sample.integrate(field.mean_curvature(sample.points) * sample.points[:, 0].square().exp())
        gaps.append(abs(surface.integrated_curvature @ g - exact))
    assert gaps[1] < 1e-2 * exact
    assert gaps[0] / gaps[1] > 3


def test_area_of_a_polytope_changes_with_scale_and_place_as_it_must(placed_polytope):
    """dA/ds = 2 A, and no change with the place: its curvature is all in edges, where no second derivative sees it."""
    sample = surface_quadrature(placed_polytope, 32)
    area = Area().value(placed_polytope, sample)
    scale, *shift = Area().sensitivity(placed_polytope, sample).tolist()
    assert scale == pytest.approx(2 * area, rel=5e-3)
    assert max(abs(part) for part in shift) < 5e-3 * area


def test_surface_integral_over_a_polytope_changes_with_scale_as_it_must(placed_polytope):
    """int |x|^2 dA grows with the fourth power of the scale."""
    sample = surface_quadrature(placed_polytope, 32)
    functional = SurfaceIntegral(lambda x: x.square().sum(dim=1))
    slope = float(functional.sensitivity(placed_polytope, sample)[0])
    assert slope == pytest.approx(4 * functional.value(placed_polytope, sample), rel=1e-2)


def test_the_weak_curvature_of_a_trained_relu_network_integrates_to_that_of_its_torus(relu_torus):
    """int kappa of a torus is 4 pi^2 R; by second derivatives it is zero. The network is a fiftieth off its torus."""
    sample = surface_quadrature(relu_torus, 32)
    assert surface_topology(relu_torus, 32).euler == 0
    assert float(relu_torus.mean_curvature(sample.points).abs().max()) == 0.0
    surface = mesh_of(relu_torus, 32)
    assert surface.integrated_curvature.sum() == pytest.approx(4 * math.pi**2 * 0.55, rel=0.05)


def test_weak_curvature_at_points_of_a_ball_is_two_over_the_radius(polytope):
    field = polytope(200)
    sample = surface_quadrature(field, 24)
    kappa = weak_mean_curvature(field, sample.points)
    assert sample.integrate(kappa) == pytest.approx(4 * math.pi * 0.5**2 * 4, rel=0.02)


SMOOTH = [shapes.torus(), shapes.capsule(), shapes.box(), shapes.circle(), *map(shapes.bundled, shapes.BUNDLED)]


@pytest.mark.parametrize("field", SMOOTH)
def test_second_derivatives_tell_how_smooth_surfaces_bend(field):
    assert normal_turning(field, surface_quadrature(field, 24).points).explained > 0.9


@pytest.mark.parametrize(("count", "dimension"), [(200, 3), (40, 2)])
def test_second_derivatives_tell_nothing_of_a_polytope(polytope, count, dimension):
    field = polytope(count, dimension)
    turning = normal_turning(field, surface_quadrature(field, 24).points)
    assert turning.explained == pytest.approx(0.0, abs=1e-6)
    assert not turning.is_smooth


def test_second_derivatives_tell_nothing_of_a_trained_relu_network(relu_torus):
    assert not normal_turning(relu_torus, surface_quadrature(relu_torus, 24).points).is_smooth


class Once(torch.autograd.Function):
    """|x|, with a gradient that torch cannot differentiate again."""

    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.norm(dim=1)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad[:, None] * x / x.norm(dim=1, keepdim=True)


def test_an_operation_that_torch_differentiates_once_is_not_taken_for_flat():
    """A ball all the same, whose second derivative is refused: nothing is explained."""

    class OnceBall(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.radius = torch.nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

        def forward(self, x):
            return Once.apply(x) - self.radius

    field = Field(OnceBall())
    points = 0.5 * torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=1)
    assert normal_turning(field, points).explained == 0.0


def test_a_plane_has_no_turning_to_explain():
    field = Field(torch.nn.Linear(3, 1).double())
    points = torch.zeros(10, 3, dtype=torch.float64)
    assert normal_turning(field, points).is_smooth
