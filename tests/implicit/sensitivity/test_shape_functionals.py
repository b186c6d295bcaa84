"""Values against closed forms and sensitivities against differences of the re-measured value."""

import math

import pytest
import torch

from implicit import Area, Field, SurfaceIntegral, Volume, VolumeIntegral, integrate, shapes, surface_quadrature
from implicit.sensitivity.shape_functionals import volume_terms


def moment(points):
    return points[:, 0] ** 2 + points[:, 1] ** 2


@pytest.mark.parametrize(
    "functional",
    [
        Volume(),
        Area(),
        VolumeIntegral(lambda x: x[:, 0] ** 2 + x[:, 1]),
        SurfaceIntegral(lambda x: moment(x) + x[:, 2]),
    ],
    ids=["volume", "area", "volume-integral", "surface-integral"],
)
def test_sensitivity_matches_differences(wobbly, functional):
    sample = surface_quadrature(wobbly, 48)
    direction = torch.randn(len(wobbly.theta), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    step = 1e-5

    def at(sign):
        field = wobbly.with_theta(wobbly.theta + sign * step * direction)
        return functional.value(field, surface_quadrature(field, 48))

    measured = (at(1) - at(-1)) / (2 * step)
    assert float(functional.sensitivity(wobbly, sample) @ direction) == pytest.approx(measured, rel=1e-4)


def test_values_on_a_ball():
    field = shapes.sphere(radius=0.5)
    sample = surface_quadrature(field, 48)
    r = 0.5
    assert Volume().value(field, sample) == pytest.approx(4 / 3 * math.pi * r**3, rel=1e-5)
    assert Area().value(field, sample) == pytest.approx(4 * math.pi * r**2, rel=1e-5)
    assert VolumeIntegral(moment).value(field, sample) == pytest.approx(8 / 15 * math.pi * r**5, rel=1e-4)
    assert SurfaceIntegral(moment).value(field, sample) == pytest.approx(8 / 3 * math.pi * r**4, rel=1e-5)


def test_volume_is_the_volume_integral_of_one(wobbly):
    sample = surface_quadrature(wobbly, 32)
    one = VolumeIntegral(lambda x: torch.ones_like(x[:, 0]))
    assert one.value(wobbly, sample) == pytest.approx(Volume().value(wobbly, sample), rel=1e-5)


def test_mean_curvature_of_a_torus_is_the_sum_of_the_principal_ones():
    field = shapes.torus(0.6, 0.2)
    sample = surface_quadrature(field, 24, exact_points=True)
    x, y, _ = sample.points.T
    ring = (x**2 + y**2).sqrt()
    # 1/r along the tube, cos(v) / (R + r cos(v)) around it.
    expected = 1 / 0.2 + ((ring - 0.6) / 0.2) / ring
    torch.testing.assert_close(field.mean_curvature(sample.points), expected, rtol=1e-7, atol=1e-7)


def test_mean_curvature_does_not_ask_for_a_distance():
    """f = |x|^2 - r^2, whose second derivative along the normal is not zero: 2/r all the same."""

    class Quadric(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.radius = torch.nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

        def forward(self, x):
            return x.square().sum(dim=1) - self.radius**2

    points = 0.5 * torch.nn.functional.normalize(torch.randn(20, 3, dtype=torch.float64), dim=1)
    torch.testing.assert_close(Field(Quadric()).mean_curvature(points), torch.full_like(points[:, 0], 4.0))


def test_mean_curvature_of_a_circle_is_one_over_r():
    field = shapes.circle(0.25)
    points = surface_quadrature(field, 16, exact_points=True).points
    torch.testing.assert_close(field.mean_curvature(points), torch.full_like(points[:, 0], 4.0))


def test_a_density_of_the_wrong_shape_is_refused(wobbly):
    sample = surface_quadrature(wobbly, 16)
    with pytest.raises(ValueError, match="h must give one value a point"):
        VolumeIntegral(lambda x: x).value(wobbly, sample)


@pytest.mark.parametrize("resolution", [24, 48, 96])
def test_the_error_estimate_bounds_the_error(resolution):
    field = shapes.torus(0.6, 0.25)
    for functional, exact in ((Volume(), 2 * math.pi**2 * 0.6 * 0.25**2), (Area(), 4 * math.pi**2 * 0.6 * 0.25)):
        found = integrate(field, functional, resolution)
        assert abs(found.value - exact) <= found.error < 1e-3 * exact


def test_the_distance_to_the_surface_takes_most_of_the_cells_error_out():
    ball = shapes.sphere(0.5)
    sample = surface_quadrature(ball, 10)
    for functional, cells, exact in (
        (Volume(), float(volume_terms(sample).sum()), math.pi / 6),
        (Area(), float(sample.weights.sum()), math.pi),
    ):
        assert abs(functional.value(ball, sample) - exact) < 0.3 * abs(cells - exact)
