"""Rows of df/dtheta by the few parameters of each point against the dense rows."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from implicit import Field, Siren, shapes
from implicit.models import DenseGrid, HashGrid, TriPlane
from implicit.sensitivity.boundary_sensitivity import parameter_gradient
from implicit.sensitivity.sparse_rows import has_sparse_rows, sparse_parameter_gradient

GRIDS = {
    "dense": lambda: DenseGrid(resolution=6),
    "dense, decoded": lambda: DenseGrid(resolution=6, features=2, width=8, depth=1),
    "hash": lambda: HashGrid(levels=4, table=50, width=8),
    "tri-plane": lambda: TriPlane(6, 3, width=8),
}


class Sampled(nn.Module):
    """A foreign grid: trilinear values by torch's own look-up, which does not say which parameters act."""

    def __init__(self, resolution: int = 17) -> None:
        super().__init__()
        axis = torch.linspace(-1, 1, resolution, dtype=torch.float64)
        z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
        self.grid = nn.Parameter((x**2 + y**2 + z**2).sqrt()[None, None] - 0.5)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return nn.functional.grid_sample(self.grid, points[None, None, None], align_corners=True).flatten()


def points_in_box(n: int) -> torch.Tensor:
    return torch.rand(n, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64) * 1.8 - 0.9


@pytest.mark.parametrize("inside", ["negative", "positive"])
@pytest.mark.parametrize("make", GRIDS.values(), ids=GRIDS.keys())
def test_the_rows_of_a_grid_are_the_dense_ones(make, inside):
    """Whatever the sign; nodes that share an entry of a hash table add up."""
    field, points = Field(make().double(), inside=inside), points_in_box(40)
    assert has_sparse_rows(field, points)
    rows = torch.from_numpy(sparse_parameter_gradient(field, points).toarray())
    torch.testing.assert_close(rows, parameter_gradient(field, points), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("patterns", [["values"], ["decoder.layers.0.*"]], ids=["values", "decoder"])
def test_a_part_of_the_parameters_has_its_own_rows(patterns):
    field, points = Field(TriPlane(6, 3, width=8).double(), parameters=patterns), points_in_box(20)
    assert has_sparse_rows(field, points) == (patterns == ["values"])
    rows = torch.from_numpy(sparse_parameter_gradient(field, points).toarray())
    torch.testing.assert_close(rows, parameter_gradient(field, points), rtol=1e-12, atol=1e-13)


def test_a_grid_that_is_given_its_points_otherwise_has_the_rows_of_those():
    """What the module says of its parameters is of the points as it takes them."""
    field = Field(DenseGrid(resolution=6).double(), inputs=lambda points: 0.7 * points.flip(1))
    points = points_in_box(20)
    rows = torch.from_numpy(sparse_parameter_gradient(field, points).toarray())
    torch.testing.assert_close(rows, parameter_gradient(field, points), rtol=1e-12, atol=1e-13)


def test_a_grid_holds_few_entries_a_row():
    """27 nodes of a triquadratic cell, and no more, of 8000."""
    field, points = Field(DenseGrid(resolution=20).double()), points_in_box(40)
    assert sparse_parameter_gradient(field, points).nnz == 27 * 40


def test_a_foreign_grid_is_found_by_the_zeros_of_its_rows(monkeypatch):
    monkeypatch.setattr("implicit.sensitivity.sparse_rows.BLOCK", 17**3 * 7)  # blocks of seven points, the last of two
    field, points = Field(Sampled()), points_in_box(30)
    assert has_sparse_rows(field, points)
    rows = sparse_parameter_gradient(field, points)
    assert rows.nnz <= 8 * 30
    torch.testing.assert_close(torch.from_numpy(rows.toarray()), parameter_gradient(field, points), rtol=0, atol=0)


def test_parameters_that_act_everywhere_have_no_sparse_rows():
    for field in (Field(Siren(width=48).double()), shapes.sphere(0.5)):
        assert not has_sparse_rows(field, points_in_box(30))
    assert not has_sparse_rows(Field(DenseGrid(resolution=6).double()), points_in_box(0))


def test_no_points_have_no_rows():
    assert sparse_parameter_gradient(Field(DenseGrid(resolution=6).double()), points_in_box(0)).shape == (0, 216)
