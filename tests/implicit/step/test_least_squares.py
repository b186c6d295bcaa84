"""The collected equations against the KKT system in full, and what happens when the system is no good."""

import numpy as np
import pytest
import torch

from implicit.step.equations import NormalMatrix
from implicit.step.least_squares import LeastSquares, Operator, Rows, SolveStatus


def problem(rows, columns, seed=0, rank=None):
    generator = torch.Generator().manual_seed(seed)
    rank = columns if rank is None else rank
    left = torch.randn(rows, rank, generator=generator, dtype=torch.float64)
    matrix = left @ torch.randn(rank, columns, generator=generator, dtype=torch.float64)
    target = torch.randn(rows, generator=generator, dtype=torch.float64)
    weights = torch.rand(rows, generator=generator, dtype=torch.float64) + 0.1
    C = torch.randn(2, columns, generator=generator, dtype=torch.float64)
    return Rows(matrix, target, weights), C, torch.tensor([0.3, -1.0], dtype=torch.float64)


def collected(*equations, size):
    system = LeastSquares(size, equations[0].target)
    for some in equations:
        if isinstance(some, Rows):
            system.add(some)
        else:
            system.add_operator(some)
    return system


def by_numpy(rows, damping, C, r):
    """The KKT system in full."""
    A, y, w = (part.numpy() for part in rows[:3])
    n, m = A.shape[1], len(r)
    kkt = np.block([[A.T @ (w[:, None] * A) + damping * np.eye(n), C.numpy().T], [C.numpy(), np.zeros((m, m))]])
    return np.linalg.solve(kkt, np.concatenate([A.T @ (w * y), r.numpy()]))[:n]


def by_products(rows, gram=True):
    A = rows.matrix
    return Operator(lambda x: A @ x, lambda w: A.T @ w, rows.target, rows.weights, (lambda: A @ A.T) if gram else None)


@pytest.mark.parametrize(
    ("shape", "method"), [((60, 20), "primal"), ((30, 30), "primal"), ((20, 60), "dual")], ids=["tall", "even", "wide"]
)
def test_the_smaller_form_is_factored_and_solves_the_kkt_system(shape, method):
    rows, C, r = problem(*shape)
    solution = collected(rows, size=shape[1]).solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.constraint_residual < 1e-10
    assert solution.method == method
    assert solution.status is SolveStatus.SOLVED


@pytest.mark.parametrize("shape", [(40, 10), (10, 40)], ids=["primal", "dual"])
def test_objective_and_residual_are_those_of_the_rows(shape):
    rows, _, _ = problem(*shape)
    solution = collected(rows, size=shape[1]).solve(0.1)
    gap = rows.weights * (rows.matrix @ solution.x - rows.target) ** 2
    assert solution.objective == pytest.approx(float(gap.sum()), rel=1e-10)
    assert solution.residual == pytest.approx(float((gap.sum() / rows.weights.sum()).sqrt()), rel=1e-10)


@pytest.mark.parametrize("shape", [(60, 30), (25, 30)], ids=["primal", "dual"])
def test_rank_is_that_of_the_rows(shape):
    rows, _, _ = problem(*shape, rank=12)
    assert collected(rows, size=30).solve(1e-9).rank == pytest.approx(12, abs=0.01)


def test_products_alone_are_enough():
    rows, C, r = problem(40, 25)
    solution = collected(by_products(rows, gram=False), size=25).solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.method == "cg"


def test_products_of_the_equations_with_each_other_give_the_dual():
    rows, C, r = problem(25, 40)
    system = collected(by_products(rows), size=40)
    assert system.trace() == pytest.approx(float((rows.weights[:, None] * rows.matrix**2).sum()))
    solution = system.solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(rows, 0.05, C, r), rtol=1e-8, atol=1e-10)
    assert solution.method == "dual"
    assert solution.rank == pytest.approx(collected(rows, size=40).solve(0.05).rank)


def test_products_go_to_conjugate_gradients_where_the_dual_cannot_take_them():
    rows, _, _ = problem(25, 40)
    uneven = torch.linspace(0.1, 1, 40, dtype=torch.float64)
    assert collected(by_products(rows), size=40).solve(uneven).method == "cg"
    assert collected(by_products(rows), by_products(rows), size=40).solve(0.1).method == "cg"


def test_rows_after_products_count_however_many_they_are():
    """More rows than unknowns would be added up in a normal matrix, which knows no products."""
    first, C, r = problem(10, 20, seed=1)
    second, _, _ = problem(50, 20, seed=2)
    both = Rows(*(torch.cat(parts) for parts in zip(first[:3], second[:3], strict=True)))
    solution = collected(by_products(first), second, size=20).solve(0.05, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(both, 0.05, C, r), rtol=1e-8, atol=1e-10)


def test_products_after_a_normal_matrix_are_refused():
    rows, _, _ = problem(40, 20)
    system = collected(rows, size=20)
    with pytest.raises(ValueError, match="before those with a matrix"):
        system.add_operator(by_products(rows))


@pytest.mark.parametrize("shape", [(60, 20), (9, 20)], ids=["primal", "dual"])
def test_rows_may_leave_out_the_first_unknowns(shape):
    rows, C, r = problem(*shape)
    late = Rows(rows.matrix[:, 8:], rows.target, rows.weights, first=8)
    whole = torch.nn.functional.pad(late.matrix, (8, 0))
    both = Rows(torch.cat([rows.matrix, whole]), rows.target.repeat(2), rows.weights.repeat(2))
    solution = collected(rows, late, size=20).solve(0.1, (C, r))
    np.testing.assert_allclose(solution.x.numpy(), by_numpy(both, 0.1, C, r), rtol=1e-8, atol=1e-10)


def test_blocks_add_up():
    rows, C, r = problem(60, 20)
    parts = [Rows(*(part[k : k + 7] for part in rows[:3])) for k in range(0, 60, 7)]
    whole, split = (collected(*blocks, size=20).solve(0.1, (C, r)) for blocks in ([rows], parts))
    torch.testing.assert_close(split.x, whole.x)


def test_one_factor_serves_any_constraints_and_is_that_of_a_solve_in_one_call():
    rows, C, r = problem(40, 20)
    factorised = collected(rows, size=20).factorise(0.1)
    for constraints in (None, (C, r), (C[:1], r[:1])):
        alone = collected(rows, size=20).solve(0.1, constraints)
        assert torch.equal(factorised.solve(constraints).x, alone.x)


def test_nothing_is_added_to_what_has_been_factored():
    rows, _, _ = problem(40, 20)
    for use in (lambda system: system.factorise(0.1), lambda system: system.trace()):
        system = collected(rows, size=20)
        use(system)
        with pytest.raises(RuntimeError, match="no more can be added"):
            system.add(rows)
        with pytest.raises(RuntimeError, match="no more can be added"):
            system.add_operator(by_products(rows))


def test_damping_of_zero_on_a_singular_system_is_raised_and_said():
    rows, _, _ = problem(40, 20, rank=5)
    solution = collected(rows, size=20).solve(0.0)
    assert torch.isfinite(solution.x).all()
    assert solution.status is SolveStatus.DAMPED
    assert solution.damping > 0


def test_a_constraint_given_twice_is_met_once_and_said():
    rows, C, r = problem(40, 20)
    twice = (torch.cat([C, C[:1]]), torch.cat([r, r[:1]]))
    solution = collected(rows, size=20).solve(0.1, twice)
    assert solution.status is SolveStatus.REDUNDANT_CONSTRAINTS
    assert solution.constraint_residual < 1e-9


@pytest.mark.parametrize("where", ["target", "constraint"])
def test_a_system_with_nan_fails_without_a_step(where):
    rows, C, r = problem(40, 20)
    (rows.target if where == "target" else C)[1] = float("nan")
    solution = collected(rows, size=20).solve(0.1, (C, r))
    assert solution.status is SolveStatus.FAILED
    assert solution.factorised is None
    assert torch.equal(solution.x, torch.zeros(20, dtype=torch.float64))


@pytest.mark.parametrize("shape", [(40, 20), (12, 20)], ids=["primal", "dual"])
def test_correction_meets_new_constraints_at_least_cost(shape):
    rows, C, r = problem(*shape)
    change = collected(rows, size=20).factorise(0.1).correction(C, r)
    torch.testing.assert_close(C @ change, r)
    # Least cost in the metric H of the problem: H change lies in the span of the rows of C.
    H = rows.matrix.T @ (rows.weights[:, None] * rows.matrix) + 0.1 * torch.eye(20, dtype=torch.float64)
    multipliers = torch.linalg.lstsq(C.T, (H @ change)[:, None]).solution
    torch.testing.assert_close(C.T @ multipliers, (H @ change)[:, None], rtol=1e-8, atol=1e-8)


def test_negative_damping_is_refused():
    rows, _, _ = problem(40, 20)
    with pytest.raises(ValueError, match="damping must not be negative"):
        collected(rows, size=20).solve(-1.0)


def test_the_relative_damping_is_in_units_of_the_trace():
    rows, _, _ = problem(40, 20)
    trace = float((rows.weights[:, None] * rows.matrix**2).sum())
    assert collected(rows, size=20).solve(relative_damping=1e-3).damping == pytest.approx(1e-3 * trace, rel=1e-12)


def test_each_prints_as_one_line():
    rows, C, r = problem(40, 20)
    system = collected(rows, size=20)
    shown = [rows, by_products(rows), system, system.factorise(0.1), system.solve(0.1, (C, r))]
    for thing in shown:
        assert "\n" not in repr(thing)
        assert "tensor" not in repr(thing)
        assert len(repr(thing)) < 200
    assert repr(rows) == "Rows(40 equations in unknowns 0 to 19, float64)"
    assert repr(system) == "LeastSquares(NormalMatrix(20 unknowns, float64))"


def decaying(rng, equations=700, unknowns=400, worst=-4.0):
    """Rows whose singular values fall by some decades, as those of sensitivities do."""
    left = torch.from_numpy(rng.standard_normal((equations, unknowns)))
    right = torch.linalg.qr(torch.from_numpy(rng.standard_normal((unknowns, unknowns)))).Q
    return left @ torch.diag(torch.logspace(0, worst, unknowns, dtype=torch.float64)) @ right


@pytest.mark.parametrize("single", [False, True])
def test_products_in_single_precision_leave_the_objective_of_a_damped_system(single):
    """The minimum of |A x - y|^2 + damping |x|^2 by numpy's factors; at 1e-8 of the trace rounding costs nothing."""
    rng = np.random.default_rng(5)
    A, y = decaying(rng), torch.from_numpy(rng.standard_normal(700))
    system = LeastSquares(400, A, single_products=single)
    system.add(Rows(A, y, torch.ones(700, dtype=torch.float64)))
    damping = 1e-8 * float(A.square().sum())
    x = system.solve(damping).x
    stacked = np.concatenate([A.numpy(), damping**0.5 * np.eye(400)])
    best = np.linalg.lstsq(stacked, np.concatenate([y.numpy(), np.zeros(400)]), rcond=None)[0]

    def objective(x):
        return float((A @ x - y).square().sum() + damping * x.square().sum())

    assert objective(x) / objective(torch.from_numpy(best)) - 1 == pytest.approx(0, abs=1e-4 if single else 1e-10)
    assert torch.equal(x, system.solve(damping).x)


def test_products_that_single_precision_would_spoil_are_summed_in_double():
    """All rows all but the same: their products round alike, and the measured error of the sum is too large."""
    rng = np.random.default_rng(5)
    same = torch.from_numpy(rng.standard_normal((1, 400))) + 1e-9 * torch.from_numpy(rng.standard_normal((700, 400)))
    equations = NormalMatrix(400, same)
    equations.single_products = True
    equations.add(Rows(same, same[:, 0], torch.ones(700, dtype=torch.float64)))
    torch.testing.assert_close(equations._matrix.tril(), (same.T @ same).tril(), rtol=1e-12, atol=0)
