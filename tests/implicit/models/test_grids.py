"""Fields of features on grids: what they reproduce, their derivatives, and what acts at a point."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch.func import grad, hessian, jvp, vmap

from implicit import Field, load_field, save_field
from implicit.models import DenseGrid, HashGrid, TriPlane, build
from implicit.models.splines import peaks, stencil

GRIDS = {
    "dense": lambda degree: DenseGrid(resolution=7, degree=degree),
    "dense, decoded": lambda degree: DenseGrid(resolution=6, features=3, degree=degree, width=8, depth=1),
    "dense in the plane": lambda degree: DenseGrid(2, 8, 2, degree=degree, width=8, depth=2),
    "hash": lambda degree: HashGrid(levels=4, table=64, degree=degree, width=8),
    "hash, not decoded": lambda degree: HashGrid(levels=3, table=128, degree=degree, depth=0),
    "tri-plane": lambda degree: TriPlane(8, 4, degree=degree, width=8),
    "tri-plane, side by side": lambda degree: TriPlane(8, 2, degree=degree, combine="concatenate", width=8),
    "tri-plane, product": lambda degree: TriPlane(8, 4, degree=degree, combine="product", width=8),
}

CASES = [
    pytest.param(make, degree, id=f"{name}, degree {degree}") for name, make in GRIDS.items() for degree in (1, 2, 3)
]


def points_in_box(n, dimension, seed=0):
    return torch.rand(n, dimension, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 1.8 - 0.9


def grid_and_points(make, degree, n=5):
    grid = make(degree).double().requires_grad_(False)
    return grid, points_in_box(n, grid.dimension)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("dimension", [2, 3])
def test_splines_reproduce_polynomials_of_their_degree(degree, dimension):
    """The coefficients are found by collocation at a few more points than there are; the fit is exact everywhere."""
    cells = 3
    u = (points_in_box(400, dimension) + 0.9) / 1.8 * cells
    nodes, weights = stencil(u, cells, degree)
    side = cells + degree
    flat = sum(nodes[..., axis] * side ** (dimension - 1 - axis) for axis in range(dimension))
    matrix = torch.zeros(len(u), side**dimension, dtype=torch.float64).scatter_add_(1, flat, weights)
    for powers in itertools.product(range(degree + 1), repeat=dimension):
        values = torch.stack([u[:, axis] ** power for axis, power in enumerate(powers)]).prod(dim=0)
        fitted = torch.linalg.lstsq(matrix, values[:, None], driver="gelsd").solution
        torch.testing.assert_close((matrix @ fitted)[:, 0], values, rtol=0, atol=1e-9)
    assert torch.allclose(weights.sum(dim=1), torch.ones(len(u), dtype=torch.float64))
    assert len(peaks(cells, degree, dimension)) == side**dimension


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_grid_set_to_a_linear_function_is_that_function_also_outside_its_box(degree):
    slope = torch.tensor([0.3, -1.2, 0.7], dtype=torch.float64)
    grid = DenseGrid(resolution=6, degree=degree, bounds=[[-1, -1, -0.5], [1, 2, 1]]).double()
    grid.set_values(lambda x: x @ slope + 0.2)
    points = 2 * points_in_box(50, 3)
    torch.testing.assert_close(grid(points), points @ slope + 0.2)


@pytest.mark.parametrize(("make", "degree"), CASES)
def test_gradients_and_hessians_agree_with_finite_differences(make, degree):
    grid, points = grid_and_points(make, degree)
    step = 1e-5

    def value(point):
        return grid(point[None])[0]

    slopes, curvatures = vmap(grad(value))(points), vmap(hessian(value))(points)
    for axis in range(grid.dimension):
        shift = torch.zeros(grid.dimension, dtype=torch.float64)
        shift[axis] = step
        torch.testing.assert_close(
            (grid(points + shift) - grid(points - shift)) / (2 * step), slopes[:, axis], rtol=1e-6, atol=1e-8
        )
        ahead, behind = vmap(grad(value))(points + shift), vmap(grad(value))(points - shift)
        torch.testing.assert_close((ahead - behind) / (2 * step), curvatures[:, axis], rtol=1e-5, atol=1e-7)
    along = torch.ones_like(points)
    torch.testing.assert_close(jvp(grid, (points,), (along,))[1], slopes.sum(dim=1))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_derivatives_below_the_degree_do_not_jump_from_cell_to_cell(degree):
    """At the border x = 0 of a cell: values agree at any degree, normals from degree 2 on, curvatures from 3 on."""
    grid = DenseGrid(resolution=4 + degree, degree=degree).double().requires_grad_(False)
    grid.values.add_(torch.rand(grid.values.shape, generator=torch.Generator().manual_seed(1)))
    border = torch.tensor([0.0, 0.1, 0.2], dtype=torch.float64)
    shift = torch.tensor([1e-9, 0.0, 0.0], dtype=torch.float64)

    def value(point):
        return grid(point[None])[0]

    for order, derivative in enumerate((value, grad(value), hessian(value))):
        jump = (derivative(border + shift) - derivative(border - shift)).abs().max()
        assert (jump < 1e-6) == (order < degree)


@pytest.mark.parametrize(("make", "degree"), CASES)
def test_the_parameters_named_for_a_point_are_those_that_act_there(make, degree):
    grid, points = grid_and_points(make, degree)
    values = grid.values.detach()
    named = grid.local_parameters(points)["values"]

    def at(table, point):
        return torch.func.functional_call(grid, {"values": table}, (point[None],))[0]

    of_table = vmap(grad(at), in_dims=(None, 0))(values, points).flatten(1)
    for row, places in zip(of_table, named, strict=True):
        others = torch.ones(len(row), dtype=torch.bool)
        others[places] = False
        assert bool((row[others] == 0).all())
    local = {"values": values.flatten()[named]}
    torch.testing.assert_close(grid(points, local), grid(points), rtol=0, atol=0)


@pytest.mark.parametrize(("make", "degree"), CASES)
def test_a_saved_grid_comes_back(make, degree, tmp_path):
    grid, points = grid_and_points(make, degree)
    assert type(build(grid.describe())) is type(grid)
    field = Field(grid, bounds=([-1] * grid.dimension, [1] * grid.dimension))
    save_field(field, tmp_path / "grid.safetensors")
    torch.testing.assert_close(
        load_field(tmp_path / "grid.safetensors").value(points), field.value(points), rtol=0, atol=0
    )


def test_coarse_levels_of_a_hash_grid_hold_every_node_and_fine_ones_share():
    grid = HashGrid(levels=5, table=200, coarsest=4, growth=1.5)
    assert grid.cells == (4, 6, 9, 13, 20)
    assert grid.sizes == (125, 200, 200, 200, 200)
    assert grid.values.shape == (925, 2)
    rows = grid.stencils(torch.rand(500, 3))[0]
    for level, (start, size) in enumerate(zip((0, 125, 325, 525, 725), grid.sizes, strict=True)):
        assert int(rows[:, level].min()) >= start
        assert int(rows[:, level].max()) < start + size


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: DenseGrid(resolution=2, degree=2), "resolution must be above the degree 2"),
        (lambda: DenseGrid(degree=4), "degree must be"),
        (lambda: DenseGrid(bounds=[[0, 0, 0], [1, 1, 0]]), "bounds must be a lower and an upper corner in 3"),
        (lambda: HashGrid(growth=0.5), "growth must be a number of at least 1"),
        (lambda: TriPlane(combine="mean"), "combine must be one of sum, concatenate, product"),
    ],
)
def test_sizes_that_are_none_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
