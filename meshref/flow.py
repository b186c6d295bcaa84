"""Mean-curvature flow of a closed mesh, with the volume held if wanted.

    dx/dt = -kappa n        kappa = div n, the sum of the principal curvatures: a sphere shrinks as R^2 = R0^2 - 4 t

With L the (positive semidefinite) cotangent Laplacian and M the Voronoi areas, kappa n = M^-1 L x, and a step is

    "semi-implicit"   (M + dt L) x' = M x      both of the present shape
    "explicit"        x' = x - dt M^-1 L x     stable only below explicit_step_limit
    "conformalised"   (M + dt L0) x' = M x     M of the present shape, L0 of the first: another flow, smooth to the end

The first two are the flow above, of order one in dt. It is the steepest descent of the area, with the volume held too,
if that is done by a uniform normal speed: where a step makes the area grow, it was too long, or is no step of the flow.
A semi-implicit step cannot, whatever dt, as long as the volume is free and the cotangents are as they are:

    area(x') <= D(x') <= D(x) = area(x)        D(y) = y^T L y / 2, Dirichlet's energy of y over the present shape

Sources: Desbrun, Meyer, Schroeder, Barr 1999 (implicit fairing); Kazhdan, Solomon, Ben-Chen 2012 (conformalised).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from meshref.measures import (
    face_areas,
    lumped_areas,
    solid_centroid,
    sphericity_of,
    summed_normals,
    unit_or_zero,
    volume_gradient,
)
from meshref.printing import brief
from meshref.topology import FloatArray, IntArray

Method = Literal["conformalised", "semi-implicit", "explicit"]

# Limited cotangents go on where a neck or an ear has shrunk to a thread: without, the free flow of the bunny ends there
# after 21 steps of 1e-4 at unit area. (From [-5, 5] it does too: only from 0 up is the matrix surely definite.) But
# triangles with angles below 11 degrees or above 90 follow another equation: a rod of slender triangles loses 0.2 % of
# its area instead of 8 %, or gains 60 %.
CLAMP = (0.0, 5.0)

# Part by which limited cotangents may change the rate at which the area falls at first. (Later they may be at work on
# the threads for which they are there, whose curvature is large.)
RATE = 0.2

# Growth of the area, relative, that is none: at rest a discrete surface with its volume held wavers by less.
GROWTH = 1e-6

# Times that a step is halved where it does not do what the flow promises.
HALVINGS = 6

# A shape below this part of its first volume is a point for all that can be seen of it.
COLLAPSED = 1e-6


class FlowStatus(Enum):
    """End of a flow; the value is the sentence a user reads."""

    FINISHED = "All steps were taken."
    AREA_GREW = (
        "The area grew, which a curvature flow never does, in steps of a 64th too; the shape before it is returned. "
        "Rescaling and limited cotangents make it grow: take preserve_volume='newton', cotangents=None."
    )
    COLLAPSED = "The shape has shrunk to a point; the shape before that is returned. Take fewer or smaller steps."
    PINCHED = (
        "A step gave a shape without a finite volume and area; the last good one is returned. Something thin has "
        "shrunk to a point: take smaller steps, method='conformalised', or cotangents=(0, 5)."
    )
    NOT_DEFINITE = (
        "The matrix of a step is not positive definite; the shape before it is returned. Something thin has shrunk to "
        "a point: take smaller steps, method='conformalised', or cotangents=(0, 5)."
    )
    LIMITED = (
        "Limited cotangents change by more than a fifth how fast the area falls at first, which makes another flow on "
        "these triangles; the shape is returned as it was. Take cotangents=None, or remesh."
    )
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
    substeps: int = 1  # that the step was taken in, more than one where a whole one would have made the area grow


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
    cotangents: tuple[float, float] | None = None,
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
        preserve_volume: None lets the volume shrink; "newton" moves along the normals by an amount that is the same
            everywhere, which makes it the flow of dx/dt = (mean kappa - kappa) n; "rescale" scales about the centroid
            after each step, which is gentler on the triangles but another flow, and on what is thin makes the area
            grow. Both restore the volume to 1e-12.
        cotangents: Lowest and highest cotangent for "semi-implicit", as CLAMP of this file; None uses them as they are.
        snapshot_every: Steps between the snapshots; None keeps none.
        solver: Library that factorises, see factorise.
        progress: Called with (steps done, steps) after each step.

    Returns:
        The result. A step after which the area has grown, the volume cannot be restored, or nothing finite is left is
        taken in halves, down to a 64th (all but explicit ones); where these fail too the flow stops, and its status
        says so. It never returns nan.

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
    flow = _Flow(X, F, method, preserve_volume, cotangents, solver)
    history = [_row(0, 0.0, X, F, begin)]
    snapshots = [V.copy()] if snapshot_every else []
    status = FlowStatus.FINISHED
    for step in range(1, steps + 1):
        taken = flow.refusal or flow.advance(X, step_size)
        if isinstance(taken, FlowStatus):
            status = taken
            break
        X, substeps = taken
        history.append(_row(step, step * step_size, X, F, begin)._replace(substeps=substeps))
        if snapshot_every and step % snapshot_every == 0:
            snapshots.append(X + origin)
        if progress is not None:
            progress(step, steps)
    return FlowResult(X + origin, tuple(history), status, len(history) - 1, tuple(snapshots))


@dataclass(frozen=True, eq=False)
class ConvergedFlow:
    """A flow whose steps have been halved until they hardly matter, and what they still do."""

    flow: FlowResult  # of the finest steps; if converged, its last vertices are extrapolated to steps of length zero
    steps: int  # of the finest flow
    time_error_rms: float  # estimate of the error of the steps: rms over the area of that along the normal, a length
    time_error_max: float  # the largest of it
    converged: bool  # the rms is below the tolerance, and every step was taken

    __repr__ = brief


def converged_curvature_flow(
    V: ArrayLike,
    F: ArrayLike,
    *,
    time: float,
    steps: int = 8,
    tolerance: float = 2e-4,
    most_steps: int = 256,
    method: Literal["semi-implicit", "conformalised"] = "semi-implicit",
    preserve_volume: Literal["newton", "rescale"] | None = "newton",
    solver: Solver = "auto",
    progress: Callable[[int, int], None] | None = None,
) -> ConvergedFlow:
    """Smooth a closed mesh for a time, in twice as many steps again and again until the number does not matter.

    The error of n steps falls as 1/n, so that 2 X(2n) - X(n) has one of order two; two of these in a row give the
    estimate, and the last of them, its volume restored where it is held, is the result. Where most_steps do not bring
    the estimate below the tolerance the result is the finest flow, and the estimate how far it is from half its steps.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3), closed, oriented outwards.
        time: Length of the flow, a squared length of V's unit.
        steps: Fewest steps, with which it begins; snapshots are kept at these times.
        tolerance: Of the rms of the error in time, as a part of the diagonal of the mesh's box.
        most_steps: No flow of more steps is begun.
        method, preserve_volume, solver: See mean_curvature_flow.
        progress: Called with (steps done, steps) of the flow at work.

    Raises:
        MeshError: See mean_curvature_flow, or most_steps is below four times the steps, which an estimate needs.
    """
    V, F = check_mesh(V, F, closed=True)
    require_positive("time", time, "time, a squared length")
    require_whole("steps", steps)
    require_whole("most_steps", most_steps, 4 * steps)
    require_positive("tolerance", tolerance)
    require_choice("method", method, ("semi-implicit", "conformalised"))
    size = float(np.linalg.norm(np.ptp(V, axis=0)))
    error: tuple[float, float] = (np.inf, np.inf)
    count, last, before = steps, None, None
    while True:
        flow = mean_curvature_flow(
            V,
            F,
            steps=count,
            step_size=time / count,
            method=method,
            preserve_volume=preserve_volume,
            snapshot_every=count // steps,
            solver=solver,
            progress=progress,
        )
        finished = flow.status is FlowStatus.FINISHED
        X = None
        if finished and last is not None:
            X = 2 * flow.V - last.V
            if preserve_volume is not None:
                X = _restore(X, F, signed_volume(V, F), preserve_volume)
        if X is not None and before is not None:
            error = _normal_distance(X, before, F)
        converged = finished and error[0] <= tolerance * size
        if converged or 2 * count > most_steps or (not finished and last is not None):
            break
        last, before, count = flow if finished else None, X, 2 * count
    if converged and X is not None:
        return ConvergedFlow(replace(flow, V=X), count, *error, converged=True)
    if last is not None and finished:  # what cannot be extrapolated is returned as it is, with its own error
        error = _normal_distance(flow.V, last.V, F)
    return ConvergedFlow(flow, count, *error, converged=False)


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


class _Flow:
    """One flow, and the least area that it has had."""

    def __init__(
        self,
        X: FloatArray,
        F: IntArray,
        method: Method,
        preserve: Literal["newton", "rescale"] | None,
        cotangents: tuple[float, float] | None,
        solver: Solver,
    ) -> None:
        self._F, self._method, self._preserve = F, method, preserve
        self._cotangents, self._solver = cotangents, solver
        self._frozen = laplacian(X, F) if method == "conformalised" else None
        self._volume = signed_volume(X, F)
        self._least_area = float(face_areas(X, F).sum())
        self.refusal = FlowStatus.LIMITED if method == "semi-implicit" and self._is_another(X) else None

    def _is_another(self, X: FloatArray) -> bool:
        """Return True if the limits of the cotangents change the rate at which the area falls at a shape."""
        if self._cotangents is None:
            return False
        masses, exact = voronoi_areas(X, self._F)[:, None], laplacian(X, self._F) @ X
        limited = laplacian(X, self._F, self._cotangents) @ X
        rate = float((exact * exact / masses).sum())
        return abs(float((exact * limited / masses).sum()) - rate) > RATE * rate

    def advance(self, X: FloatArray, dt: float, halvings: int = HALVINGS) -> tuple[FloatArray, int] | FlowStatus:
        """Return the shape a time later and the steps that were taken to it, or the reason why there is none."""
        moved = self._kept(self._step(X, dt))
        if not isinstance(moved, FlowStatus):
            self._least_area = min(self._least_area, float(face_areas(moved, self._F).sum()))
            return moved, 1
        if halvings == 0 or self._method == "explicit" or moved is FlowStatus.COLLAPSED:
            return moved
        first = self.advance(X, dt / 2, halvings - 1)
        if isinstance(first, FlowStatus):
            return first
        second = self.advance(first[0], dt / 2, halvings - 1)
        return second if isinstance(second, FlowStatus) else (second[0], first[1] + second[1])

    def _step(self, X: FloatArray, dt: float) -> FloatArray | FlowStatus:
        F = self._F
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # what comes of it is looked at
            masses = voronoi_areas(X, F)
            if self._method == "explicit":
                return np.asarray(X - dt * (laplacian(X, F) @ X) / masses[:, None])
            L = laplacian(X, F, self._cotangents) if self._frozen is None else self._frozen
            A = sparse.csc_array(sparse.diags_array(masses) + dt * L)
        if not np.isfinite(A.data).all():
            return FlowStatus.PINCHED
        try:
            return np.asarray(factorise(A, self._solver).solve(masses[:, None] * X))
        except NotPositiveDefiniteError:
            return FlowStatus.NOT_DEFINITE

    def _kept(self, X: FloatArray | FlowStatus) -> FloatArray | FlowStatus:
        """Return a shape with its volume restored, or what it breaks of the promises of the flow."""
        if isinstance(X, FlowStatus):
            return X
        if not np.isfinite(X).all():
            return FlowStatus.PINCHED
        with np.errstate(over="ignore", invalid="ignore"):
            enclosed, area = signed_volume(X, self._F), float(face_areas(X, self._F).sum())
        if not (np.isfinite(enclosed) and np.isfinite(area)):
            return FlowStatus.PINCHED
        if self._method == "explicit" and area > self._least_area * (1 + GROWTH):
            return FlowStatus.UNSTABLE
        if enclosed <= COLLAPSED * self._volume:
            return FlowStatus.COLLAPSED
        if self._preserve is not None:
            restored = _restore(X, self._F, self._volume, self._preserve)
            if restored is None:
                return FlowStatus.VOLUME_LOST
            X, area = restored, float(face_areas(restored, self._F).sum())
        return X if area <= self._least_area * (1 + GROWTH) else FlowStatus.AREA_GREW


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


def _normal_distance(X: FloatArray, Y: FloatArray, F: IntArray) -> tuple[float, float]:
    """Return how far two shapes of one mesh are apart along the normals of the first, rms over the area and most."""
    apart = ((X - Y) * unit_or_zero(summed_normals(X, F, "area"))).sum(axis=1)
    return float(np.sqrt(np.average(apart**2, weights=lumped_areas(X, F)))), float(np.abs(apart).max())


def _row(step: int, time: float, X: FloatArray, F: IntArray, begin: float) -> FlowStep:
    volume, area = signed_volume(X, F), float(face_areas(X, F).sum())
    return FlowStep(step, time, volume, area, sphericity_of(volume, area), perf_counter() - begin)
