"""Each form of the inverse of H = A^T W A + D against dense matrices, and the KKT system that it solves."""

import numpy as np
import pytest
import torch
from scipy import linalg

from implicit import sample_surface
from implicit.sensitivity.boundary_sensitivity import basis
from implicit.step.equations import KeptEquations, NormalMatrix, Rows
from implicit.step.factors import ConjugateGradients, Dual, Primal, conjugate_gradients
from implicit.step.kkt import least_change
from implicit.step.least_squares import Factorised, SolveStatus
from implicit.step.symmetric import add_gram, gram, times

FORMS = ("primal", "dual", "cg")


def random(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def made(form, R, ridge, tolerance=1e-13):
    """A factor of R^T R + diag(ridge), R = W^1/2 A."""
    if form == "primal":
        return Primal.of((R.T @ R).tril(), ridge)
    if form == "dual":
        return Dual.of((R / ridge @ R.T).tril(), lambda x: R @ x, lambda y: R.T @ y, ridge)
    return ConjugateGradients(lambda x: R.T @ (R @ x), ridge, R, tolerance)


@pytest.fixture(params=[(60, 20), (20, 60), (30, 30)], ids=["tall", "wide", "square"])
def R(request):
    return random(*request.param)


@pytest.fixture(params=["even", "uneven"])
def ridge(request, R):
    n = R.shape[1]
    return (
        torch.full((n,), 0.05, dtype=torch.float64) if request.param == "even" else torch.linspace(0.05, 2, n).double()
    )


def dense(R, ridge):
    return R.numpy().T @ R.numpy() + np.diag(ridge.numpy())


@pytest.mark.parametrize("form", FORMS)
def test_the_inverse_is_that_of_the_dense_matrix(form, R, ridge):
    right = random(R.shape[1], 3, seed=1)
    truth = linalg.solve(dense(R, ridge), right.numpy(), assume_a="pos")
    np.testing.assert_allclose(made(form, R, ridge).inverse(right).numpy(), truth, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("form", FORMS)
def test_the_minimiser_is_that_of_the_stacked_rows(form, R, ridge):
    """By scipy's orthogonal factors of the rows above the roots of the damping, which square no condition."""
    y = random(R.shape[0], seed=2)
    stacked = np.vstack([R.numpy(), np.diag(np.sqrt(ridge.numpy()))])
    truth = linalg.lstsq(stacked, np.concatenate([y.numpy(), np.zeros(R.shape[1])]))[0]
    x = made(form, R, ridge).minimiser(R.T @ y, y)
    np.testing.assert_allclose(x.numpy(), truth, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("form", FORMS)
def test_the_least_change_solves_the_kkt_system(form, R, ridge):
    n = R.shape[1]
    C, r = random(3, n, seed=3), random(3, seed=4)
    kkt = np.block([[dense(R, ridge), C.numpy().T], [C.numpy(), np.zeros((3, 3))]])
    truth = linalg.solve(kkt, np.concatenate([np.zeros(n), r.numpy()]))[:n]
    x, redundant = least_change(made(form, R, ridge), C, r)
    np.testing.assert_allclose(x.numpy(), truth, rtol=1e-8, atol=1e-10)
    assert not redundant


@pytest.mark.parametrize("form", FORMS)
def test_redundant_constraints_are_met_in_the_least_squares_sense(form):
    R = random(20, 10)
    factor = made(form, R, torch.ones(10, dtype=torch.float64))
    C, r = random(2, 10, seed=3), random(2, seed=4)
    alone, _ = least_change(factor, C, r)
    doubled, redundant = least_change(
        factor, torch.cat([C, 5 * C[:1], 0 * C[:1]]), torch.cat([r, 5 * r[:1], 0 * r[:1]])
    )
    assert redundant
    torch.testing.assert_close(doubled, alone)
    nothing, redundant = least_change(factor, 0 * C, r)
    assert redundant
    assert torch.equal(nothing, torch.zeros(10, dtype=torch.float64))


@pytest.mark.parametrize("form", ["primal", "dual"])
def test_the_rank_is_the_trace_of_what_the_equations_decide(form, R, ridge):
    H = dense(R, ridge)
    truth = np.trace(linalg.solve(H, R.numpy().T @ R.numpy()))
    assert made(form, R, ridge).rank() == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("form", ["primal", "dual"])
def test_the_rank_of_a_large_system_is_estimated(form):
    """Beyond 256 unknowns by random signs: 20 large singular values, within four standard deviations."""
    R = 100 * random(400, 20) @ random(20, 400, seed=1)
    assert made(form, R, torch.full((400,), 1e-2, dtype=torch.float64)).rank() == pytest.approx(20, abs=9)


def test_the_condition_is_estimated_from_below_and_exact_for_a_diagonal():
    R = torch.diag(torch.tensor([3.0, 1.0, 0.0], dtype=torch.float64))
    ridge = torch.full((3,), 0.5, dtype=torch.float64)
    assert made("primal", R, ridge).condition == pytest.approx(9.5 / 0.5)
    assert made("dual", R, ridge).condition == pytest.approx(1 + 9 / 0.5)
    R = random(30, 30)
    assert 1 < made("primal", R, torch.ones(30)).condition <= np.linalg.cond(dense(R, torch.ones(30))) * (1 + 1e-9)


def test_an_indefinite_matrix_has_no_factor():
    indefinite = torch.diag(torch.tensor([1.0, -2.0], dtype=torch.float64))
    assert Primal.of(indefinite, torch.ones(2, dtype=torch.float64)) is None
    assert Primal.of(indefinite, torch.full((2,), 3.0, dtype=torch.float64)) is not None
    assert Dual.of(indefinite, lambda x: x, lambda y: y, torch.ones(2, dtype=torch.float64)) is None


def test_an_iteration_that_stops_short_says_so(monkeypatch):
    R = random(60, 40)
    rows = Rows(R, random(60, seed=1), torch.ones(60, dtype=torch.float64))
    kept = KeptEquations(40, R)
    kept.add(rows)
    ridge = torch.full((40,), 1e-3, dtype=torch.float64)
    assert Factorised(kept, kept.conjugate_gradients(ridge), ridge).solve().status is SolveStatus.SOLVED
    monkeypatch.setattr(conjugate_gradients, "ITERATIONS", 3)
    assert Factorised(kept, kept.conjugate_gradients(ridge), ridge).solve().status is SolveStatus.SLOW


def test_all_forms_agree_on_the_sensitivities_of_a_network(wobbly):
    """A system as edits have it, whose singular values fall fast: to 1e-6 in the damped objective, the volume held."""
    sample = sample_surface(wobbly, 700)
    B = basis(wobbly, sample.points)
    rows = Rows(B, 0.05 * torch.exp(-((sample.points[:, 1] - 0.5) ** 2) / 0.1), sample.weights)
    constraint = (sample.weights @ B)[None], torch.tensor([0.01], dtype=torch.float64)
    ridge = torch.full((625,), 1e-4, dtype=torch.float64)
    kept, normal = KeptEquations(625, B), NormalMatrix(625, B)
    for equations in (kept, normal):
        equations.add(rows)
    assert normal.trace() == pytest.approx(kept.trace(), rel=1e-10)
    singular = np.linalg.svd(rows.rooted().numpy(), compute_uv=False)
    decided = float(np.sum(singular**2 / (singular**2 + 1e-4)))
    totals = []
    for equations, factor in (
        (normal, normal.factorise(ridge)),
        (kept, kept.dual(ridge)),
        (kept, kept.conjugate_gradients(ridge)),
    ):
        solution = Factorised(equations, factor, ridge).solve(constraint)
        totals.append(solution.objective + 1e-4 * float(solution.x @ solution.x))
        assert solution.constraint_residual < 1e-10
        assert solution.status is SolveStatus.SOLVED
        assert solution.method == "cg" or solution.rank == pytest.approx(decided, rel=0.1)
    assert max(totals) <= min(totals) * (1 + 1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_symmetric_products_are_the_lower_triangles_of_full_ones(dtype):
    rows, x = random(9, 5).to(dtype), random(5, seed=1).to(dtype)
    total = torch.ones(5, 5, dtype=dtype)
    add_gram(total, rows)
    add_gram(total, rows)
    torch.testing.assert_close(total.tril(), (1 + 2 * rows.T @ rows).tril())
    torch.testing.assert_close(gram(rows).tril(), (rows @ rows.T).tril())
    torch.testing.assert_close(times((rows.T @ rows).tril(), x), rows.T @ (rows @ x))
