"""The basis against finite differences of the real surface motion, and its products against the matrix."""

import pytest
import torch
from torch import nn

from implicit import Field, adjoint, basis, normal_displacement, sample_surface, shapes
from implicit.sensitivity.boundary_sensitivity import parameter_gradient, parameter_gradient_and_slope
from implicit.sensitivity.few_parameters import MOST, columns_of_few


def motion_along_normals(field, theta, sample):
    """How far the surface of other parameters is along the normals of this one, by Newton in one dimension."""
    moved, t = field.with_theta(theta), torch.zeros_like(sample.weights)
    for _ in range(30):
        value, gradient = moved.value_and_gradient(sample.points + t[:, None] * sample.normals)
        change = value / (gradient * sample.normals).sum(dim=1)
        t = t - change
        if float(change.abs().max()) < 1e-15:
            break
    return t


def test_basis_is_the_derivative_of_the_surface_motion(any_field):
    """Central differences of the actual zero set, in float64, for 40 parameters of each kind of field."""
    sample = sample_surface(any_field, 30)
    rows = basis(any_field, sample.points)
    step = 2e-5
    for p in torch.linspace(0, len(any_field.theta) - 1, 40).long().tolist():
        ends = []
        for sign in (1, -1):
            theta = any_field.theta.clone()
            theta[p] += sign * step
            ends.append(motion_along_normals(any_field, theta, sample))
        measured = (ends[0] - ends[1]) / (2 * step)
        assert (measured - rows[:, p]).norm() <= 1e-6 * rows[:, p].norm() + 1e-9


@pytest.mark.parametrize("radius", [0.1, 0.5])
@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_growing_the_radius_moves_a_sphere_outward_by_as_much(radius, scale):
    field = shapes.sphere(radius=radius, scale=scale)
    rows = basis(field, sample_surface(field, 64).points)
    radius_column = (rows - 1).abs().amax(dim=0).argmin()
    torch.testing.assert_close(rows[:, radius_column], torch.ones(64, dtype=torch.float64))


class Times(nn.Module):
    """Another module times a positive constant."""

    def __init__(self, module, factor):
        super().__init__()
        self.module, self.factor = module, factor

    def forward(self, points):
        return self.factor * self.module(points)


@pytest.mark.parametrize("factor", [0.01, 5.0, 1e4])
def test_multiplying_the_field_changes_nothing(wobbly, factor):
    sample = sample_surface(wobbly, 50)
    scaled = Field(Times(wobbly.module, factor))
    torch.testing.assert_close(basis(scaled, sample.points), basis(wobbly, sample.points), rtol=1e-10, atol=1e-12)


def test_products_agree_with_the_matrix(any_field):
    sample = sample_surface(any_field, 40)
    generator = torch.Generator().manual_seed(3)
    rows = basis(any_field, sample.points)
    change = torch.randn(len(any_field.theta), generator=generator, dtype=torch.float64)
    weights = torch.randn(40, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(normal_displacement(any_field, sample.points, change), rows @ change)
    torch.testing.assert_close(adjoint(any_field, sample.points, weights), rows.T @ weights)


def test_chunks_do_not_change_the_basis(wobbly, monkeypatch):
    points = sample_surface(wobbly, 50).points
    whole = basis(wobbly, points)
    monkeypatch.setattr("implicit.sensitivity.boundary_sensitivity.BLOCK", 7 * len(wobbly.theta))
    torch.testing.assert_close(basis(wobbly, points), whole, rtol=0, atol=1e-14)


def test_slopes_of_the_parameter_gradient_match_differences(any_field):
    points = sample_surface(any_field, 10).points
    both = parameter_gradient_and_slope(any_field, points)
    torch.testing.assert_close(both[:, 0], parameter_gradient(any_field, points))
    step = 1e-5
    for axis in range(3):
        way = step * torch.eye(3, dtype=torch.float64)[axis]
        measured = (parameter_gradient(any_field, points + way) - parameter_gradient(any_field, points - way)) / (
            2 * step
        )
        torch.testing.assert_close(both[:, 1 + axis], measured, rtol=1e-5, atol=1e-6)


def test_only_named_parameters_are_in_the_basis():
    whole = Field(nn.Sequential(nn.Linear(3, 5), nn.Tanh(), nn.Linear(5, 1)))
    part = Field(whole.module, parameters=["2.*"])
    assert [block.name for block in part.layout] == ["2.weight", "2.bias"]
    points = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(basis(part, points), basis(whole, points)[:, -6:])


def test_points_of_another_precision_are_refused(wobbly):
    with pytest.raises(ValueError, match=r"must be torch\.float64.*but are torch.float32"):
        basis(wobbly, torch.zeros(3, 3))


def test_a_point_without_gradient_is_refused():
    field = Field(nn.Sequential(nn.Linear(3, 4), nn.ReLU(), nn.Linear(4, 1)))
    with torch.no_grad():
        for parameter in field.module.parameters():
            parameter.fill_(-1.0)
    with pytest.raises(ValueError, match="gradient of the field vanishes"):
        basis(Field(field.module), torch.ones(2, 3))


class Stubborn(nn.Module):
    """A module that vmap cannot take: it branches on its data."""

    def __init__(self, idle: int = 0):
        super().__init__()
        self.radius = nn.Parameter(torch.tensor(0.5, dtype=torch.float64))
        self.stretch = nn.Parameter(torch.ones(3, dtype=torch.float64))
        self.idle = nn.Parameter(torch.ones(idle, dtype=torch.float64))

    def forward(self, points):
        f = (points * self.stretch).norm(dim=1) - self.radius
        return f if float(f.detach().sum()) < 1e9 else -f


def test_a_module_that_cannot_be_vectorised_is_taken_point_by_point():
    field = Field(Stubborn(idle=MOST))
    points = sample_surface(field, 5).points
    with pytest.warns(RuntimeWarning, match="one by one, which is slow"):
        rows = basis(field, points)
    with pytest.warns(RuntimeWarning, match="one by one"):
        slopes = parameter_gradient_and_slope(field, points)[:, 1:]
    assert_rows_of_the_stretched_ball(rows, slopes, points)


def test_a_module_of_few_parameters_need_not_be_vectorised():
    """Nor does it take torch's compiler, which its function transforms load."""
    field = Field(Stubborn())
    points = sample_surface(field, 5).points
    assert_rows_of_the_stretched_ball(basis(field, points), parameter_gradient_and_slope(field, points)[:, 1:], points)


def assert_rows_of_the_stretched_ball(rows, slopes, points):
    # Growing the radius moves points by 1, stretching axis i by -x_i^2 / r.
    expected = torch.cat([torch.ones(5, 1), -(points**2) / 0.5], dim=1).double()
    torch.testing.assert_close(rows[:, :4], expected)
    # d/dx_j of df/dstretch_i = x_i^2 / |x|: 2 x_i d_ij / r - x_i^2 x_j / r^3.
    x, r = points, 0.5
    by_hand = 2 * torch.diag_embed(x) / r - x[:, None, :] ** 2 * x[:, :, None] / r**3
    torch.testing.assert_close(slopes[:, :, 1:4], by_hand)
    assert not rows[:, 4:].any()
    assert not slopes[:, :, 4:].any()


class Forgetful(torch.autograd.Function):
    """A square whose derivative is taken for a constant."""

    generate_vmap_rule = True

    @staticmethod
    def forward(x):
        return x**2

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(inputs[0])

    @staticmethod
    def backward(ctx, grad):
        return (2 * ctx.saved_tensors[0] * grad).detach()


def test_a_module_whose_second_derivatives_are_wrong_is_differentiated_once():
    class Ball(nn.Module):
        def __init__(self):
            super().__init__()
            self.stretch = nn.Parameter(torch.ones(3, dtype=torch.float64))

        def forward(self, points):
            return Forgetful.apply(points * self.stretch).sum(dim=1) - 0.25

    field = Field(Ball())
    points = sample_surface(field, 5).points
    assert columns_of_few(field, points) is None
    torch.testing.assert_close(parameter_gradient(field, points), 2 * points**2)


def test_columns_of_few_parameters_are_the_rows_of_the_function_transforms():
    field = shapes.smooth_union(shapes.capsule(), shapes.sphere(0.25, (0.3, 0.0, 0.0)))
    points = sample_surface(field, 20, resolution=16).points
    one = torch.func.grad(lambda theta, point: field.function(theta, point[None])[0])
    rows = torch.func.vmap(one, in_dims=(None, 0))(field.theta, points)
    slopes = torch.func.vmap(torch.func.jacfwd(one, argnums=1), in_dims=(None, 0))(field.theta, points)
    found = columns_of_few(field, points, slopes=True)
    torch.testing.assert_close(found[:, 0], rows)
    torch.testing.assert_close(found[:, 1:], slopes.transpose(1, 2))
