"""The measured smoothness of fields whose smoothness is known."""

import pytest
import torch
from torch import nn

from implicit import Field, Siren, shapes
from implicit.field.smoothness import gradient_jumps


def on_sphere(n: int = 200, radius: float = 0.5, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    draw = torch.randn(n, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return (radius * nn.functional.normalize(draw, dim=1)).to(dtype)


def network(activation: nn.Module) -> nn.Module:
    layers = nn.Sequential(nn.Linear(3, 48), activation, nn.Linear(48, 48), activation, nn.Linear(48, 1))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in layers.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) / parameter.shape[-1] ** 0.5)
    return layers.double()


class Cells(nn.Module):
    """A grid of values with straight lines between them along each axis, as hash grids have: a kink at every cell."""

    def __init__(self, cells: int = 16) -> None:
        super().__init__()
        draw = torch.randn(1, 1, *[cells + 1] * 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        self.grid = nn.Parameter(0.05 * draw)

    def forward(self, points):
        at = (points + 1) / 2 * (self.grid.shape[-1] - 1)
        low = at.detach().floor().clamp(0, self.grid.shape[-1] - 2)
        part, low = at - low, low.long()
        total = torch.zeros_like(points[:, 0])
        for corner in range(8):
            offset = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2])
            weight = torch.where(offset.bool(), part, 1 - part).prod(dim=1)
            i, j, k = (low + offset).unbind(dim=1)
            total = total + weight * self.grid[0, 0, i, j, k]
        return points.norm(dim=1) - 0.5 + total


def test_a_sphere_is_smooth_to_second_order_in_the_spacing():
    """The share is that of the trapezoidal rule, O(h^2)."""
    shares = [gradient_jumps(shapes.sphere(0.5), on_sphere(), h).share for h in (0.1, 0.05, 0.025)]
    assert shares[0] < 0.05
    assert shares[0] / shares[1] == pytest.approx(4, rel=0.1)
    assert shares[1] / shares[2] == pytest.approx(4, rel=0.1)


def test_the_change_of_the_gradient_of_a_sphere_is_the_angle_between_its_normals():
    """Over a step h along the tangent the normal turns by atan(h / r), a chord of 2 sin(angle / 2)."""
    found = gradient_jumps(shapes.sphere(0.5), on_sphere(7), 0.1)
    chord = 2 * torch.sin(torch.atan(torch.tensor(0.1 / 0.5, dtype=torch.float64)) / 2)
    torch.testing.assert_close(found.changes, (2 * chord).expand(7))


def test_a_plane_has_no_change_to_explain():
    field = Field(nn.Linear(3, 1).double())
    found = gradient_jumps(field, on_sphere(), 0.05)
    assert found.share == 0
    assert float(found.changes.max()) < 1e-15


def test_sines_are_smooth_where_the_spacing_resolves_them():
    field = Field(Siren(width=16, first_frequency=6.0).double())
    assert gradient_jumps(field, on_sphere(), 1e-3).share < 1e-3


@pytest.mark.parametrize("spacing", [0.1, 0.01, 1e-3])
def test_all_change_of_a_piecewise_linear_field_is_in_its_jumps(spacing):
    field = Field(network(nn.ReLU()))
    assert gradient_jumps(field, on_sphere(400), spacing).share == pytest.approx(1.0)
    assert field.twice_differentiable  # its second derivatives are those of its gradient: zero between the kinks


def test_a_sharp_softplus_jumps_at_wide_spacings_and_is_smooth_at_narrow_ones():
    """softplus(100 z) / 100 bends within about 0.05: at twice that it is a ReLU, at a fiftieth of it smooth."""
    field = Field(network(nn.Softplus(beta=100)))
    assert gradient_jumps(field, on_sphere(), 0.1).share > 0.5
    assert gradient_jumps(field, on_sphere(), 1e-3).share < 0.02
    assert field.twice_differentiable


def test_a_grid_jumps_at_its_cells():
    field = Field(Cells())
    assert gradient_jumps(field, on_sphere(), 0.2).share > 0.5  # 1.6 cells
    assert field.twice_differentiable


def test_single_precision_sees_the_same():
    points = on_sphere(dtype=torch.float32)
    assert gradient_jumps(shapes.sphere(0.5).to(torch.float32), points, 0.025).share < 0.01
    assert gradient_jumps(Field(network(nn.ReLU()).float()), points, 0.05).share == pytest.approx(1.0)


def test_the_plane_has_one_direction_a_point():
    field = shapes.circle(0.5)
    angle = torch.arange(5, dtype=torch.float64)
    points = 0.5 * torch.stack([angle.cos(), angle.sin()], dim=1)
    found = gradient_jumps(field, points, 0.1)
    chord = 2 * torch.sin(torch.atan(torch.tensor(0.1 / 0.5, dtype=torch.float64)) / 2)
    torch.testing.assert_close(found.changes, chord.expand(5))
    assert float(found) == found.share < 0.05


def test_the_seed_gives_the_same_directions_again():
    field = Field(Cells())
    first, again, other = (gradient_jumps(field, on_sphere(20), 0.1, seed=seed) for seed in (0, 0, 1))
    assert torch.equal(first.unexplained, again.unexplained)
    assert not torch.equal(first.unexplained, other.unexplained)


@pytest.mark.parametrize("spacing", [0.0, -1.0, float("nan"), "wide"])
def test_a_spacing_that_is_no_length_is_refused(spacing):
    with pytest.raises(ValueError, match="spacing must be a positive length"):
        gradient_jumps(shapes.sphere(0.5), on_sphere(5), spacing)
