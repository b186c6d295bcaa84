"""Sparse equations against the dense ones: the same minimiser whatever the form, and zero where nothing acts."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.sparse import csr_array, random_array

from implicit import Field, sample_surface
from implicit.models import DenseGrid, HashGrid
from implicit.step import problem, sparse_equations
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.least_squares import LeastSquares, Rows
from implicit.step.off_surface import off_surface
from implicit.step.problem import StepProblem, assemble
from implicit.step.sparse_equations import SparseRows

LIKE = torch.zeros(1, dtype=torch.float64)


def equations(count: int, unknowns: int = 60) -> SparseRows:
    """Random ones: two unknowns in all equations, most in few, the last ten in none."""
    generator = np.random.default_rng(0)
    matrix = random_array((count, unknowns), density=0.08, rng=generator).toarray()
    matrix[:, :2] = generator.normal(size=(count, 2))
    matrix[:, -10:] = 0
    target, weights = (torch.from_numpy(generator.uniform(0.5, 1.5, count)) for _ in range(2))
    return SparseRows(csr_array(matrix), target, weights)


def systems(rows: SparseRows) -> tuple[LeastSquares, LeastSquares]:
    sparse, dense = (LeastSquares(rows.matrix.shape[1], LIKE, sparse=sparse) for sparse in (True, False))
    sparse.add(rows)
    dense.add(Rows(torch.from_numpy(rows.matrix.toarray()), rows.target, rows.weights))
    return sparse, dense


@pytest.mark.parametrize(
    ("count", "limit", "method"), [(200, 3000, "primal"), (30, 3000, "dual"), (30, 0, "cg"), (200, 0, "cg")]
)
@pytest.mark.parametrize("held", [False, True], ids=["free", "constrained"])
def test_every_form_gives_the_minimiser_of_the_normal_equations(count, limit, method, held, monkeypatch):
    monkeypatch.setattr(sparse_equations, "DIRECT_LIMIT", limit)
    rows = equations(count)
    sparse, _ = systems(rows)
    constraint = (torch.arange(60, dtype=torch.float64)[None] / 60, torch.tensor([0.7], dtype=torch.float64))
    solution = sparse.solve(1e-3, constraint if held else None)
    assert solution.method == method
    a = torch.from_numpy(rows.matrix.toarray())
    normal = a.T @ (rows.weights[:, None] * a) + 1e-3 * torch.eye(60, dtype=torch.float64)
    right = a.T @ (rows.weights * rows.target)
    by_hand = torch.linalg.solve(normal, right)
    if held:
        C, r = constraint
        kkt = torch.cat([torch.cat([normal, C.T], dim=1), torch.cat([C, torch.zeros(1, 1)], dim=1)])
        by_hand = torch.linalg.solve(kkt, torch.cat([right, r]))[:-1]
    torch.testing.assert_close(solution.x, by_hand, rtol=1e-9, atol=1e-10)
    assert held or bool((solution.x[-10:] == 0).all())


@pytest.mark.parametrize("count", [200, 30])
def test_what_is_said_of_a_solve_is_what_the_dense_one_says(count):
    solved = [system.solve(1e-3) for system in systems(equations(count))]
    sparse, dense = solved
    assert sparse.method == dense.method
    for name in ("residual", "objective", "rank"):
        assert getattr(sparse, name) == pytest.approx(getattr(dense, name), rel=1e-9)
    first, second = systems(equations(count))
    assert first.trace() == pytest.approx(second.trace(), rel=1e-12)


def test_dense_equations_join_sparse_ones():
    rows = equations(30)
    extra = Rows(torch.ones(2, 5, dtype=torch.float64), torch.ones(2).double(), torch.ones(2).double(), 50)
    sparse, dense = systems(rows)
    sparse.add(extra)
    dense.add(extra)
    torch.testing.assert_close(sparse.solve(1e-3).x, dense.solve(1e-3).x, rtol=1e-9, atol=1e-11)


def test_sparse_equations_are_refused_by_a_system_that_is_dense():
    with pytest.raises(TypeError, match="sparse=True"):
        LeastSquares(60, LIKE).add(equations(5))


@pytest.mark.parametrize(
    "make", [lambda: DenseGrid(resolution=10), lambda: HashGrid(levels=3, table=40, width=8)], ids=["dense", "hash"]
)
@pytest.mark.parametrize("tied", [False, True], ids=["told", "tied"])
def test_a_step_of_a_grid_is_that_of_its_dense_rows(make, tied, monkeypatch):
    """To 1e-12 of the step, on and off the surface; in float64."""
    grid = make().double()
    ball = DenseGrid(resolution=10).double()
    field = Field(grid) if isinstance(grid, DenseGrid) else Field(_Sum(ball, grid), parameters=["grid.*"])
    sample = sample_surface(field, 60, resolution=16)
    target = torch.linspace(0, 0.1, 60, dtype=torch.float64)
    energies = [
        NormalTarget(sample.points, target, sample.weights),
        off_surface(field, sample, None if tied else target, points=20, strength=0.1),
    ]
    step = StepProblem(DeformationSpace(field), energies)
    sparse = assemble(step).solve(relative_damping=1e-3)
    monkeypatch.setattr(problem, "has_sparse_rows", lambda field, points: False)
    dense = assemble(step).solve(relative_damping=1e-3)
    torch.testing.assert_close(sparse.x, dense.x, rtol=0, atol=1e-12 * float(dense.x.abs().max()))
    assert sparse.damping == pytest.approx(dense.damping, rel=1e-12)


class _Sum(torch.nn.Module):
    """A ball whose parameters stay, and a hash grid added to it."""

    def __init__(self, ball: DenseGrid, grid: HashGrid) -> None:
        super().__init__()
        self.grid, self.ball = grid, ball

    def forward(self, points, local=None):
        inner = None if local is None else {"values": local["grid.values"]}
        return self.ball(points) + 0.01 * self.grid(points, inner)

    def local_parameters(self, points):
        return {"grid.values": self.grid.local_parameters(points)["values"]}
