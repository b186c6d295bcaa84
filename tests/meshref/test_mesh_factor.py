"""Factorisations: right where definite, and a clear error where not."""

import importlib.util

import numpy as np
import pytest
from scipy import sparse

from meshref import MeshError, NotPositiveDefiniteError, cotangent_laplacian, icosphere
from meshref.factor import _has_pardiso, factorise


def installed_solvers():
    modules = {"superlu": "scipy", "cholespy": "cholespy", "cholmod": "sksparse"}
    found = [name for name, module in modules.items() if importlib.util.find_spec(module) is not None]
    return [*found, "pardiso"] if _has_pardiso() else found


def laplacian():
    return cotangent_laplacian(*icosphere(3))


@pytest.mark.parametrize("solver", installed_solvers())
@pytest.mark.parametrize("columns", [None, 3])
def test_definite_systems_are_solved(solver, columns, rng):
    A = sparse.csc_array(laplacian() + sparse.eye_array(642))
    x = rng.standard_normal(642 if columns is None else (642, columns))
    factor = factorise(A, solver)
    assert factor.solver == solver
    np.testing.assert_allclose(factor.solve(A @ x), x, atol=1e-11)


@pytest.mark.skipif(not _has_pardiso(), reason="pypardiso is not installed")
def test_pardiso_notices_what_is_indefinite():
    with pytest.raises(NotPositiveDefiniteError, match="not positive definite"):
        factorise(sparse.csc_array(laplacian() - 10.0 * sparse.eye_array(642)), "pardiso")


def test_a_singular_matrix_is_noticed():
    with pytest.raises(NotPositiveDefiniteError, match="not positive definite"):
        factorise(laplacian(), "superlu")  # constants cost nothing


@pytest.mark.parametrize("shift", [-1e-3, -10.0])
def test_an_indefinite_matrix_is_noticed(shift):
    with pytest.raises(NotPositiveDefiniteError, match="not positive definite"):
        factorise(sparse.csc_array(laplacian() + shift * sparse.eye_array(642)), "superlu")


def test_a_zero_on_the_diagonal_is_noticed():
    with pytest.raises(NotPositiveDefiniteError, match="not positive definite"):
        factorise(sparse.csc_array(np.array([[0.0, 1.0], [1.0, 0.0]])), "superlu")


def test_a_missing_solver_is_named():
    if importlib.util.find_spec("sksparse") is not None:
        pytest.skip("scikit-sparse is installed, so nothing is missing")
    with pytest.raises(MeshError, match=r"needs scikit-sparse.*superlu"):
        factorise(laplacian(), "cholmod")
