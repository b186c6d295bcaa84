"""Factorise a symmetric positive definite matrix once, solve many times, and notice if it is not definite.

A plain LU of a singular matrix returns numbers with a small residual and no warning: here the pivots are looked
at. Measured on one thread, seconds for the 84k unknowns of a 35k-vertex Killing matrix: CHOLMOD 1.8, SuperLU with
the ordering below 5.7, cholespy 10.7, SuperLU with its default ordering 31; for 8k unknowns: cholespy 0.11,
CHOLMOD 0.14, SuperLU 0.30. In another run, beside other work: PARDISO 2.9 where SuperLU
took 19, and for 8k unknowns 0.16, SuperLU 0.35, cholespy 0.43.
"""

from __future__ import annotations

import importlib
import importlib.util
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from meshref.check import MeshError, require_choice
from meshref.topology import FloatArray

Solver = Literal["auto", "superlu", "cholespy", "cholmod", "pardiso"]

# Unknowns up to which cholespy's simplicial factorisation is the faster one.
SMALL_SYSTEM = 30_000

# Least pivot over diagonal entry, measured: 3e-4 and 1e-7 for membranes of 3.5k and 35k vertices that are definite,
# no more than 4e-15 for Laplacians of spheres and an open membrane, which are singular.
SMALLEST_PIVOT = 1e-12


class NotPositiveDefiniteError(MeshError):
    """The matrix of a quadratic energy has a direction that costs nothing, or less than nothing."""


class Factor(NamedTuple):
    """A factorised matrix."""

    solve: Callable[[FloatArray], FloatArray]  # right-hand side (n,) or (n, k) to solution of the same shape
    solver: str  # the library that did it


def factorise(A: sparse.csc_array, solver: Solver = "auto", *, surely_definite: bool = False) -> Factor:
    """Factorise a symmetric matrix that should be positive definite.

    Args:
        A: Sparse symmetric matrix, (n, n), both triangles stored.
        solver: "superlu" (in scipy, always there), "cholespy", "cholmod" (scikit-sparse) or "pardiso" (pypardiso),
            where installed; "auto" takes pardiso for matrices that are surely definite if it is there, then cholmod,
            then cholespy for small ones that are surely definite, else superlu.
        surely_definite: Theory says that A is definite, so the pivots of superlu need not be looked at. Where it does
            not, "auto" keeps away from cholespy, which writes to the standard error stream on failure.

    Raises:
        NotPositiveDefiniteError: A pivot is not positive, or lost in rounding.
        MeshError: The solver is unknown or not installed.
    """
    require_choice("solver", solver, get_args(Solver))
    if solver == "auto":
        solver = _best_solver(A.shape[0], surely_definite)
    if solver == "superlu":
        return _superlu(A, look_at_pivots=not surely_definite)
    if solver == "pardiso":
        return _pardiso(A)
    return _cholespy(A) if solver == "cholespy" else _cholmod(A)


def _best_solver(size: int, surely_definite: bool) -> Literal["superlu", "cholespy", "cholmod", "pardiso"]:
    if surely_definite and _has_pardiso():
        return "pardiso"
    if importlib.util.find_spec("sksparse") is not None:
        return "cholmod"
    if surely_definite and size <= SMALL_SYSTEM and importlib.util.find_spec("cholespy") is not None:
        return "cholespy"
    return "superlu"


def _superlu(A: sparse.csc_array, *, look_at_pivots: bool) -> Factor:
    options = {"SymmetricMode": True}
    try:
        lu: Any = splu(sparse.csc_matrix(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:  # "Factor is exactly singular"
        raise _not_definite(str(error)) from None
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise _not_definite("a pivot on the diagonal is zero")
    diagonal = A.diagonal()
    if not diagonal.min() > 0:
        raise _not_definite(f"it has {diagonal.min():.2g} on its diagonal")
    if look_at_pivots:  # copies the whole factor, which takes a fifth of the time
        relative = lu.U.diagonal()[lu.perm_c] / diagonal
        if not relative.min() > SMALLEST_PIVOT:
            raise _not_definite(f"the smallest pivot is {relative.min():.2g} of its diagonal entry")
    return Factor(lu.solve, "superlu")


def _cholespy(A: sparse.csc_array) -> Factor:
    library: Any = _optional("cholespy", "cholespy")
    A.sort_indices()
    n = A.shape[0]
    try:
        chol = library.CholeskySolverD(
            n, A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data, library.MatrixType.CSC
        )
    except ValueError as error:
        raise _not_definite(str(error)) from None

    def solve(b: FloatArray) -> FloatArray:
        b = np.ascontiguousarray(b, dtype=np.float64)
        x = np.zeros_like(b)
        chol.solve(b, x)
        return x

    return Factor(solve, "cholespy")


def _cholmod(A: sparse.csc_array) -> Factor:
    library: Any = _optional("sksparse.cholmod", "scikit-sparse")
    try:
        chol = library.cholesky(sparse.csc_matrix(A), ordering_method="amd")
    except library.CholmodNotPositiveDefiniteError as error:
        raise _not_definite(str(error)) from None
    return Factor(chol, "cholmod")


def _pardiso(A: sparse.csc_array) -> Factor:
    library: Any = _optional("pypardiso", "pypardiso")
    upper = sparse.csr_matrix(sparse.triu(A, format="csr"))
    solver = library.PyPardisoSolver(mtype=2)  # real, symmetric, positive definite
    try:
        solver.factorize(upper)
    except library.pardiso_wrapper.PyPardisoError as error:
        solver.free_memory(everything=True)
        raise _not_definite(str(error)) from None

    def solve(b: FloatArray) -> FloatArray:
        return np.asarray(solver.solve(upper, np.ascontiguousarray(b, dtype=np.float64)))

    weakref.finalize(solve, solver.free_memory, everything=True)  # what MKL holds, no collector knows of
    return Factor(solve, "pardiso")


@cache
def _has_pardiso() -> bool:
    """Return whether pypardiso can be imported, which takes its library MKL too."""
    try:
        importlib.import_module("pypardiso")
    except ImportError:
        return False
    return True


def _optional(module: str, distribution: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MeshError(
            f"this solver needs {distribution}, which cannot be imported ({error}). Install it, or take "
            "solver='superlu'."
        ) from None


def _not_definite(reason: str) -> NotPositiveDefiniteError:
    return NotPositiveDefiniteError(
        f"the energy does not determine the displacement: its matrix is not positive definite ({reason}). Move more "
        "vertices by handles, or take the form 'spokes-and-rims', which is definite on every mesh."
    )
