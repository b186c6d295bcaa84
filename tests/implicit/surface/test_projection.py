"""Points on surfaces of fields whose gradient jumps, vanishes, or lies: known by their shape."""

import math

import pytest
import torch
from torch import Tensor, nn

from implicit import Field, SurfaceError, project_to_surface, shapes
from implicit.surface.projection import _newton, newton_to_surface, place_on_surface
from tests.implicit.surface.polytopes import CUBE, OCTAHEDRON, distance_out, polytope


class OfDistance(nn.Module):
    """A function of the signed distance to a sphere of radius 0.5."""

    def __init__(self, function) -> None:
        super().__init__()
        self.radius = nn.Parameter(torch.tensor(0.5, dtype=torch.float64))
        self.function = function

    def forward(self, points: Tensor) -> Tensor:
        return self.function(points.norm(dim=1) - self.radius)


OF_DISTANCE = {
    "occupancy": (lambda d: torch.sigmoid(-100 * d), {"level": 0.5, "inside": "positive"}),
    "sharp occupancy": (lambda d: torch.sigmoid(-5000 * d), {"level": 0.5, "inside": "positive"}),
    "saturated": (lambda d: torch.tanh(d / 0.02), {}),
    "truncated": (lambda d: d.clamp(-0.01, 0.01), {}),
    "kinked at the surface": (lambda d: torch.where(d < 0, d, 50 * d), {}),
    "cube": (lambda d: d**3, {}),
}


def of_distance(name):
    function, options = OF_DISTANCE[name]
    return Field(OfDistance(function), **options)


def around(n=300, low=0.05, high=0.85, seed=0):
    """Points at distances from low to high of the origin."""
    generator = torch.Generator().manual_seed(seed)
    ways = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=1)
    return ways * (low + (high - low) * torch.rand(n, 1, generator=generator, dtype=torch.float64))


@pytest.mark.parametrize("name", OF_DISTANCE)
def test_points_off_any_continuous_field_of_a_sphere_reach_it(name):
    placed = project_to_surface(of_distance(name), around())
    assert float((placed.norm(dim=1) - 0.5).abs().max()) < 1e-8


@pytest.mark.parametrize("spread", [1.0, 100.0, 1e4])
@pytest.mark.parametrize("shape", [CUBE, OCTAHEDRON], ids=["cube", "octahedron"])
def test_points_reach_a_polytope_whatever_the_slopes_of_its_faces(shape, spread):
    normals, offset, _, _ = shape
    placed = project_to_surface(polytope(normals, offset, spread), around(low=0.3))
    assert float(distance_out(normals, offset, placed).abs().max()) < 1e-10


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_placed_in_single_and_told_in_half(dtype):
    placed, arrived = newton_to_surface(shapes.sphere(radius=0.5).to(dtype), around().to(dtype), reach=1.0)
    assert bool(arrived.all())
    assert placed.dtype == dtype
    # As near as the coordinates, below one, can be told.
    assert float((placed.double().norm(dim=1) - 0.5).abs().max()) < 0.87 * torch.finfo(dtype).eps


def test_a_point_with_no_gradient_and_no_zero_has_not_arrived():
    """No step at all once was a step of less than the tolerance."""
    field = Field(OfDistance(lambda d: 0.3 + torch.relu(d - 0.2) + 0 * d))
    _, arrived = newton_to_surface(field, around(), reach=0.5)
    assert not bool(arrived.any())


def test_a_step_across_a_kink_is_no_arrival_though_it_was_short():
    """Slope 1 to a kink 1e-7 off the surface, 1e-3 beyond: the last step of Newton's method stops far from zero."""
    field = Field(OfDistance(lambda d: torch.where(d > 1e-7, d - 1e-7 + 1e-10, 1e-3 * d)))
    placed = project_to_surface(field, around(50, 0.50000012, 0.5000003))
    assert float((placed.norm(dim=1) - 0.5).abs().max()) < 2e-11


def test_a_jump_is_told_from_a_zero():
    for function in (lambda d: torch.sign(d) + 0 * d, lambda d: d + 0.1 * torch.sign(d)):
        field = Field(OfDistance(function))
        found = place_on_surface(field, around(), reach=1.0)
        assert bool(found.jumps.all())
        assert not bool(found.arrived.any())
        with pytest.raises(SurfaceError, match=r"discontinuous in torch\.float64: it jumps"):
            project_to_surface(field, around())


def test_no_point_goes_beyond_its_reach():
    start = around(high=0.95)
    for name in OF_DISTANCE:
        placed, arrived = newton_to_surface(of_distance(name), start, reach=0.2)
        assert float((placed - start).norm(dim=1).max()) <= 0.2 * (1 + 1e-9)
        near = (start.norm(dim=1) - 0.5).abs() < 0.1
        assert bool(arrived[near].all())
        far = (start.norm(dim=1) - 0.5).abs() > 0.2
        assert not bool(arrived[far].any())


def test_a_point_that_newtons_method_takes_off_its_segment_is_placed_on_it():
    """Of two sheets, at x = 0 and x = 0.4, the gradient of a wave points to the farther one."""

    class Wave(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.shift = nn.Parameter(torch.zeros(1, dtype=torch.float64))

        def forward(self, points: Tensor) -> Tensor:
            return torch.sin(points[:, 0] * math.pi / 0.4 - self.shift)

    start = torch.tensor([[0.21, 0.0, 0.0]], dtype=torch.float64)
    segments = (start - start.new_tensor([0.22, 0, 0]), start)
    found = place_on_surface(Field(Wave()), start, reach=1.0, segments=segments)
    assert bool(found.arrived.all())
    assert found.points[0].tolist() == pytest.approx([0, 0, 0], abs=1e-12)
    free = place_on_surface(Field(Wave()), start, reach=1.0)
    assert float(free.points[0, 0]) != pytest.approx(0, abs=0.1)


def test_newtons_method_alone_takes_points_to_a_sphere():
    """With no bracket to fall back upon; along the gradient, so each stays on its ray."""
    generator = torch.Generator().manual_seed(0)
    rays = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator, dtype=torch.float64), dim=1)
    lengths = 0.4 + 0.2 * torch.rand(20, 1, generator=generator, dtype=torch.float64)
    moved, arrived, _ = _newton(shapes.sphere(0.5), lengths * rays, 0.2, 1e-12, 20)
    assert bool(arrived.all())
    torch.testing.assert_close(moved, 0.5 * rays)
