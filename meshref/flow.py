"""Mean-curvature flow of a closed mesh, with the volume held if wanted.

    dx/dt = -kappa n        kappa = div n, the sum of the principal curvatures: a sphere shrinks as R^2 = R0^2 - 4 t

With L the (positive semidefinite) cotangent Laplacian and M the Voronoi areas, kappa n = M^-1 L x, and a step is

    "conformalised"   (M + dt L0) x' = M x     M of the present shape, L0 of the first: smooth to the end
    "semi-implicit"   (M + dt L) x' = M x      both of the present shape, cotangents clamped
    "explicit"        x' = x - dt M^-1 L x     stable only below explicit_step_limit

Sources: Desbrun, Meyer, Schroeder, Barr 1999 (implicit fairing); Kazhdan, Solomon, Ben-Chen 2012 (conformalised).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from time import perf_counter
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import eigsh

from meshref.check import check_mesh, require_choice, require_positive, require_whole, signed_volume
from meshref.curvature import laplacian, require_cotangents, voronoi_areas
from meshref.factor import NotPositiveDefiniteError, Solver, factorise
from meshref.measures import face_areas, solid_centroid, sphericity_of, volume_gradient
from meshref.printing import brief
from meshref.topology import FloatArray, IntArray

Method = Literal["conformalised", "semi-implicit", "explicit"]

# Without a limit on large cotangents (5 is an angle of 11 degrees) the flow of the bunny ends in its ears after 21
# steps of 1e-4 at unit area. Limiting them to [-5, 5] is worse: only from 0 up is the matrix surely definite.
CLAMP = (0.0, 5.0)

# A shape below this part of its first volume is a point for all that can be seen of it.
COLLAPSED = 1e-6


class FlowStatus(Enum):
    """End of a flow; the value is the sentence a user reads."""

    FINISHED = "All steps were taken."
    COLLAPSED = "The shape has shrunk to a point; the shape before that is returned. Take fewer or smaller steps."
    PINCHED = "A step gave a shape without a finite volume and area; the last good one is returned. Take smaller steps."
    NOT_DEFINITE = "The matrix of a step is not positive definite; the shape before it is returned. Take smaller steps."
    UNSTABLE = "A step made the area grow, so it is too large for the explicit method; the shape before it is returned."
    VOLUME_LOST = "The volume could not be restored after a step; the shape before it is returned. Take smaller steps."


class FlowStep(NamedTuple):
    """One row of the history: the shape after so many steps."""

    step: int
    time: float  # squared length
    volume: float  # cubed length
    area: float  # squared length
    sphericity: float  # 1 for a sphere
    seconds: float  # since the start


@dataclass(frozen=True, eq=False)
class FlowResult:
    """A smoothed mesh and the history of the flow."""

    V: FloatArray  # (n, 3), the vertices after the last good step; the faces stay
    history: tuple[FlowStep, ...]  # the start and every step taken
    status: FlowStatus
    steps_taken: int
    snapshots: tuple[FloatArray, ...]  # vertices (n, 3) at the start and after every snapshot_every steps, if asked for

    __repr__ = brief


def mean_curvature_flow(
    V: ArrayLike,
    F: ArrayLike,
    *,
    steps: int,
    step_size: float,
    method: Method = "conformalised",
    preserve_volume: Literal["newton", "rescale"] | None = None,
    cotangents: tuple[float, float] | None = CLAMP,
    snapshot_every: int | None = None,
    solver: Solver = "auto",
    progress: Callable[[int, int], None] | None = None,
) -> FlowResult:
    """Smooth a closed mesh by mean-curvature flow.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3), closed, oriented outwards.
        steps: Steps to take.
        step_size: Time of one step, a squared length of V's unit: a sphere of radius R vanishes at the time R^2 / 4.
        method: See the top of this file.
        preserve_volume: None lets the volume shrink; "rescale" scales about the centroid after each step; "newton"
            moves along the normals by an amount that is the same everywhere. Both restore the volume to 1e-12;
            rescaling is gentler on the triangles.
        cotangents: Lowest and highest cotangent for "semi-implicit"; None uses them as they are, and pinches.
        snapshot_every: Steps between the snapshots; None keeps none.
        solver: Library that factorises, see factorise.
        progress: Called with (steps done, steps) after each step.

    Returns:
        The result; a flow that has to stop early says so in its status, and never returns nan.

    Raises:
        MeshError: The mesh is not closed, or an option is not one of those above.
    """
    V, F = check_mesh(V, F, closed=True)
    require_whole("steps", steps, 0)
    require_positive("step_size", step_size, "time, a squared length")
    require_choice("method", method, get_args(Method))
    require_choice("preserve_volume", preserve_volume, (None, "newton", "rescale"))
    require_cotangents(cotangents)
    if snapshot_every is not None:
        require_whole("snapshot_every", snapshot_every)
    begin = perf_counter()
    origin = solid_centroid(V, F)
    X = V - origin
    first_volume = signed_volume(X, F)
    history = [_row(0, 0.0, X, F, begin)]
    snapshots = [V.copy()] if snapshot_every else []
    frozen = laplacian(X, F) if method == "conformalised" else None
    status = FlowStatus.FINISHED
    for step in range(1, steps + 1):
        try:
            moved = _step(X, F, step_size, method, frozen, cotangents, solver)
        except NotPositiveDefiniteError:
            status = FlowStatus.NOT_DEFINITE
            break
        failure = _failure(moved, F, history[-1], first_volume, method)
        if failure is None and preserve_volume is not None:
            restored = _restore(moved, F, first_volume, preserve_volume)
            failure = FlowStatus.VOLUME_LOST if restored is None else None
            moved = moved if restored is None else restored
        if failure is not None:
            status = failure
            break
        X = moved
        history.append(_row(step, step * step_size, X, F, begin))
        if snapshot_every and step % snapshot_every == 0:
            snapshots.append(X + origin)
        if progress is not None:
            progress(step, steps)
    return FlowResult(X + origin, tuple(history), status, len(history) - 1, tuple(snapshots))


def explicit_step_limit(V: ArrayLike, F: ArrayLike) -> float:
    """Return the largest step_size at which the explicit method is stable: 2 / (largest eigenvalue of M^-1 L).

    It is a squared length.

    The worst triangle sets it: for the bunny it is a hundredth of the mean squared edge length.

    Raises:
        MeshError: check_mesh refuses the mesh.
    """
    V, F = check_mesh(V, F)
    root = sparse.diags_array(1 / np.sqrt(voronoi_areas(V, F)))
    matrix: Any = root @ laplacian(V, F) @ root
    if len(V) < 5:  # too few for the iterative method
        return float(2 / np.linalg.eigvalsh(matrix.toarray())[-1])
    start = np.random.default_rng(0).standard_normal(len(V))
    return float(2 / eigsh(matrix, k=1, which="LA", v0=start, tol=1e-6, return_eigenvectors=False)[0])


def _step(
    X: FloatArray,
    F: IntArray,
    dt: float,
    method: Method,
    frozen: sparse.csc_array | None,
    cotangents: tuple[float, float] | None,
    solver: Solver,
) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # _failure looks at what comes of it
        masses = voronoi_areas(X, F)
        if method == "explicit":
            return np.asarray(X - dt * (laplacian(X, F) @ X) / masses[:, None])
        L = frozen if frozen is not None else laplacian(X, F, cotangents)
        A = sparse.csc_array(sparse.diags_array(masses) + dt * L)
    if not np.isfinite(A.data).all():
        return np.full_like(X, np.nan)
    return np.asarray(factorise(A, solver).solve(masses[:, None] * X))


def _failure(X: FloatArray, F: IntArray, last: FlowStep, first_volume: float, method: Method) -> FlowStatus | None:
    if not np.isfinite(X).all():
        return FlowStatus.PINCHED
    with np.errstate(over="ignore", invalid="ignore"):
        enclosed, area = signed_volume(X, F), float(face_areas(X, F).sum())
    if not (np.isfinite(enclosed) and np.isfinite(area)):
        return FlowStatus.PINCHED
    # The flow is the steepest descent of the area: only a step beyond the stability limit makes it grow.
    if method == "explicit" and area > last.area * (1 + 1e-9):
        return FlowStatus.UNSTABLE
    if enclosed <= COLLAPSED * first_volume:
        return FlowStatus.COLLAPSED
    return None


def _restore(X: FloatArray, F: IntArray, wanted: float, how: Literal["newton", "rescale"]) -> FloatArray | None:
    """Return vertices with the wanted volume, to 1e-12, or None."""
    if how == "newton":
        gradient = volume_gradient(X, F)
        direction = gradient / np.linalg.norm(gradient, axis=1, keepdims=True).clip(min=1e-300)  # zero stays zero
    volume = signed_volume(X, F)
    for _ in range(30):
        if abs(wanted - volume) <= 1e-14 * wanted:  # a sum over so many faces is no more exact
            break
        if how == "rescale":
            center = solid_centroid(X, F)
            X = center + (X - center) * (wanted / volume) ** (1 / 3)
        else:
            slope = float((volume_gradient(X, F) * direction).sum())
            X = X + ((wanted - volume) / slope) * direction
        volume = signed_volume(X, F)
        if not 0 < volume < np.inf:
            return None
    return X if abs(volume / wanted - 1) <= 1e-12 else None


def _row(step: int, time: float, X: FloatArray, F: IntArray, begin: float) -> FlowStep:
    volume, area = signed_volume(X, F), float(face_areas(X, F).sum())
    return FlowStep(step, time, volume, area, sphericity_of(volume, area), perf_counter() - begin)
