"""Both forms of the least squares against numpy's, and what happens when the system is no good."""

import numpy as np
import pytest
import torch

from implicit.step.least_squares import LeastSquares, Operator, Rows, SolveStatus, add_gram, least_squares


def problem(rows, columns, seed=0, rank=None):
    generator = torch.Generator().manual_seed(seed)
    rank = columns if rank is None else rank
    left = torch.randn(rows, rank, generator=generator, dtype=torch.float64)
    matrix = left @ torch.randn(rank, columns, generator=generator, dtype=torch.float64)
    target = torch.randn(rows, generator=generator, dtype=torch.float64)
    weights = torch.rand(rows, generator=generator, dtype=torch.float64) + 0.1
    C = torch.randn(2, columns, generator=generator, dtype=torch.float64)
    return Rows(matrix, target, weights), C, torch.tensor([0.3, -1.0], dtype=torch.float64)


def by_numpy(rows, damping, C, r):
    """The KKT system in full."""
    A, y, w = (part.numpy() for part in rows[:3])
    n, m = A.shape[1], len(r)
    kkt = np.block([[A.T @ (w[:, None] * A) + damping * np.eye(n), C.numpy().T], [C.numpy(), np.zeros((m, m))]])
    return np.linalg.solve(kkt, np.concatenate([A.T @ (w * y), r.numpy()]))[:n]


def by_products(rows, gram=True):
    A = rows.matrix
    return Operator(lambda x: A @ x, lambda w: A.T @ w, rows.target, rows.weights, (lambda: A @ A.T) if gram else None)


@pytest.mark.parametrize("method", ["primal", "dual", "qr", "cg"])
@pytest.mark.parametrize("shape", [(60, 20), (20, 60), (30, 30)])
def test_every_method_solves_the_kkt_system(method, shape):
    rows, C, r = problem(*shape)
    solution = least_squares([rows], shape[1], rows.matrix, damping=0.05, constraints=(C, r), method=method)
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.constraint_residual < 1e-10
    assert solution.method == method
    assert solution.status is SolveStatus.SOLVED


@pytest.mark.parametrize("method", ["primal", "dual", "qr", "cg"])
def test_objective_and_residual_are_those_of_the_rows(method):
    rows, _, _ = problem(40, 10)
    solution = least_squares([rows], 10, rows.matrix, damping=0.1, method=method)
    gap = rows.weights * (rows.matrix @ solution.x - rows.target) ** 2
    assert solution.objective == pytest.approx(float(gap.sum()), rel=1e-10)
    assert solution.residual == pytest.approx(float((gap.sum() / rows.weights.sum()).sqrt()), rel=1e-10)


def sensitivities():
    """A system as edits have it: the paper's network on a real shape, singular values falling fast."""
    from implicit import sample_surface
    from implicit.sensitivity.boundary_sensitivity import basis
    from implicit.shapes import bundled

    field = bundled("spot").to(torch.float64)
    sample = sample_surface(field, 2600)
    target = 0.05 * torch.exp(-((sample.points[:, 1] - 0.5) ** 2) / 0.1)
    C = torch.stack([sample.weights @ basis(field, sample.points)])
    return Rows(basis(field, sample.points), target, sample.weights), C, torch.tensor([0.01], dtype=torch.float64)


def test_all_methods_agree_on_a_real_system():
    """To 1e-6 in the damped objective, with the constraint held to 1e-10."""
    rows, C, r = sensitivities()
    totals = {}
    for method in ("primal", "dual", "qr", "cg"):
        system = LeastSquares(2273, rows.matrix, method=method)
        system.add(rows)
        solution = system.solve(1e-4, (C, r))
        totals[method] = solution.objective + 1e-4 * float(solution.x @ solution.x)
        assert solution.constraint_residual < 1e-10, method
        assert solution.method == method
        assert 50 < solution.rank < 1500
    assert max(totals.values()) <= min(totals.values()) * (1 + 1e-6)


def test_rank_is_that_of_the_rows():
    rows, _, _ = problem(60, 30, rank=12)
    for method in ("primal", "dual", "qr", "cg"):
        solution = least_squares([rows], 30, rows.matrix, damping=1e-9, method=method)
        assert solution.rank == pytest.approx(12, abs=0.01)


def test_products_alone_are_enough():
    rows, C, r = problem(40, 25)
    system = LeastSquares(25, rows.matrix, rank=5)
    system.add_operator(by_products(rows, gram=False))
    solution = system.solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.method == "cg"


def test_products_of_the_equations_with_each_other_give_the_dual():
    rows, C, r = problem(25, 40)
    system = LeastSquares(40, rows.matrix)
    system.add_operator(by_products(rows))
    assert system.trace() == pytest.approx(float((rows.weights[:, None] * rows.matrix**2).sum()))
    solution = system.solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.method == "dual"
    assert solution.rank == pytest.approx(least_squares([rows], 40, rows.matrix, damping=0.05).rank)


def test_products_go_to_conjugate_gradients_where_the_dual_cannot_take_them():
    rows, _, _ = problem(25, 40)
    uneven = torch.linspace(0.1, 1, 40, dtype=torch.float64)
    system = LeastSquares(40, rows.matrix)
    system.add_operator(by_products(rows))
    assert system.solve(uneven).method == "cg"
    system.add_operator(by_products(rows))
    assert system.solve(0.1).method == "cg"
    dual = LeastSquares(40, rows.matrix, method="dual")
    dual.add_operator(by_products(rows, gram=False))
    with pytest.raises(ValueError, match="know their Gram matrix"):
        dual.solve(0.1)


def test_auto_takes_the_smaller_form():
    few, _, _ = problem(10, 50)
    many, _, _ = problem(100, 50)
    assert least_squares([few], 50, few.matrix, damping=1.0).method == "dual"
    assert least_squares([many], 50, many.matrix, damping=1.0).method == "primal"


@pytest.mark.parametrize("method", ["primal", "dual"])
def test_rows_may_leave_out_the_first_unknowns(method):
    rows, _, _ = problem(60, 20)
    late = Rows(rows.matrix[:, 8:], rows.target, rows.weights, first=8)
    whole = late._replace(matrix=torch.nn.functional.pad(late.matrix, (8, 0)), first=0)
    left, right = (least_squares([rows, extra], 20, rows.matrix, damping=0.1, method=method) for extra in (late, whole))
    torch.testing.assert_close(left.x, right.x)


def test_blocks_add_up():
    rows, C, r = problem(60, 20)
    whole = least_squares([rows], 20, rows.matrix, damping=0.1, constraints=(C, r))
    parts = [Rows(*(part[k : k + 7] for part in rows[:3])) for k in range(0, 60, 7)]
    split = least_squares(parts, 20, rows.matrix, damping=0.1, constraints=(C, r))
    torch.testing.assert_close(split.x, whole.x)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gram_is_the_lower_triangle_of_the_product(dtype):
    rows = torch.randn(9, 5, generator=torch.Generator().manual_seed(0)).to(dtype)
    total = torch.ones(5, 5, dtype=dtype)
    add_gram(total, rows)
    add_gram(total, rows)
    torch.testing.assert_close(total.tril(), (1 + 2 * rows.T @ rows).tril())


def test_damping_of_zero_on_a_singular_system_is_raised_and_said():
    rows, _, _ = problem(40, 20, rank=5)
    solution = least_squares([rows], 20, rows.matrix, damping=0.0)
    assert torch.isfinite(solution.x).all()
    assert solution.status is SolveStatus.DAMPED
    assert solution.damping > 0


def test_a_constraint_given_twice_is_met_once_and_said():
    rows, C, r = problem(40, 20)
    twice = (torch.cat([C, C[:1]]), torch.cat([r, r[:1]]))
    solution = least_squares([rows], 20, rows.matrix, damping=0.1, constraints=twice)
    assert solution.status is SolveStatus.REDUNDANT_CONSTRAINTS
    assert solution.constraint_residual < 1e-9


def test_a_system_with_nan_fails_without_a_step():
    rows, _, _ = problem(40, 20)
    rows.target[3] = float("nan")
    solution = least_squares([rows], 20, rows.matrix)
    assert solution.status is SolveStatus.FAILED
    assert torch.equal(solution.x, torch.zeros(20, dtype=torch.float64))


def test_correction_meets_new_constraints_at_least_cost():
    rows, C, r = problem(40, 20)
    system = LeastSquares(20, rows.matrix)
    system.add(rows)
    system.solve(0.1)
    change = system.correction(C, r)
    torch.testing.assert_close(C @ change, r)
    # Least cost in the metric H of the problem: H change lies in the span of the rows of C.
    H = rows.matrix.T @ (rows.weights[:, None] * rows.matrix) + 0.1 * torch.eye(20, dtype=torch.float64)
    multipliers = torch.linalg.lstsq(C.T, (H @ change)[:, None]).solution
    torch.testing.assert_close(C.T @ multipliers, (H @ change)[:, None], rtol=1e-8, atol=1e-8)


def test_negative_damping_is_refused():
    rows, _, _ = problem(40, 20)
    with pytest.raises(ValueError, match="damping must not be negative"):
        least_squares([rows], 20, rows.matrix, damping=-1.0)


def test_an_unknown_method_is_refused():
    with pytest.raises(ValueError, match="method must be one of"):
        LeastSquares(3, torch.zeros(1), method="magic")
