"""Rigid editing: some parts are held, some moved, and what lies between is strained as little as possible.

| neural field | mesh |
|---|---|
| implicit.rigid_edit | meshref.killing, linear least squares; meshref.arap beside it |

Both mesh methods place their handles exactly, which a field cannot. They stand in the table a second time with springs
at their handles, as stiff as leaves them as far off as the field's are: those energies are to be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.handles import HandleSpec, rounded
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.equal_error import at_equal_error, handle_miss
from compare.operations.operation import Column, Editor, Headline, Operation, Outcome, Target

if TYPE_CHECKING:
    import meshref


class Rigid(Operation):
    """The vertices of the handles have targets; the error is the strain of the rest."""

    name = "rigid"
    takes_handles = True
    # Three steps: on spot and cactus, five leave 11 and 15 % more energy for 1.6 times the time, as each adds its own
    # ripples, and bring the handles from 0.6 % of the pull to 0.5 %.
    full: Mapping[str, Any] = {"implicit": {"steps": 3, "points": 2000}}
    quick: Mapping[str, Any] = {"implicit": {"steps": 3, "points": 500}}
    error_needs_other = False
    error_means = "local strain: half the root of the Killing energy density"
    error_name = "strain"
    error_is_length = False
    headline = Headline("killing_energy", "Killing energy {}")
    columns = (
        Column("strain_rms", "strain", "rms of the local linear strain, for rigid edits", percent=True, brief=False),
    )

    def default_handles(self, V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"]) -> tuple[HandleSpec, ...]:
        """Return two ends of the longest side: the lowest 12 % held, the uppermost 12 % moved sideways by 15 %."""
        low, high = V.min(axis=0), V.max(axis=0)
        sides = high - low
        up, across = int(np.argmax(sides)), int(np.argmin(sides))
        size = float(sides[up])
        end, shift = np.zeros(3), np.zeros(3)
        end[up], shift[across] = 1.0, 0.15 * size
        low[up] += 0.12 * size
        high[up] -= 0.12 * size
        held = {"kind": "halfspace", "point": rounded(low), "normal": rounded(-end)}
        moved = {"kind": "halfspace", "point": rounded(high), "normal": rounded(end)}
        return (
            HandleSpec(held, {"kind": "vector", "vector": [0.0, 0.0, 0.0]}),
            HandleSpec(moved, {"kind": "vector", "vector": rounded(shift)}),
        )

    def option_sources(self) -> Mapping[str, tuple[Callable[..., Any], ...]]:
        """Return the neural editor and the mesh's least squares."""
        import implicit
        import meshref

        return {"implicit": (implicit.rigid_edit,), "mesh": (meshref.killing,)}

    def edit_field(self, case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
        """Edit the field with as little strain as its network allows.

        The steps are linear as those of the mesh's least squares, like with like, unless the case names a method.
        """
        import implicit
        from compare.operations.neural import run_edit

        arguments: dict[str, Any] = {"handles": [spec.build() for spec in case.handles]}
        if "method" not in case.parameters.get("implicit", {}):
            arguments["method"] = "linear"
        return run_edit(implicit.rigid_edit, case, subject, "AKVF", progress, **arguments)

    def mesh_editors(self) -> Mapping[str, Editor]:
        """Return the linear least squares of the mesh, and as-rigid-as-possible deformation."""
        return {"mesh": killing, "mesh, ARAP": arap}

    def mesh_editors_beside(self, subject: Subject, target: Target, neural: Outcome) -> Mapping[str, Editor]:
        """Return both mesh methods with handles that are as far from their targets as the neural ones."""
        miss = handle_miss(subject, target, neural.displacement)
        return {
            "mesh, equal error": partial(_killing_beside, miss),
            "mesh, ARAP, equal error": partial(_arap_beside, miss),
        }

    def error_field(self, subject: Subject, target: Target, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
        """Return the strain, which both sides minimise."""
        return strain(subject, own.displacement)


def strain(subject: Subject, D: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Return the Frobenius norm of the linear tangential strain at each vertex, the mean over its faces, a pure number.

    Args:
        subject: The common mesh.
        D: A displacement of its vertices.
    """
    import meshref

    V, F = subject.V, subject.F
    # P (J + J^T) P is twice the strain.
    of_face = np.sqrt(meshref.killing_energy_density(V, F, D)) / 2
    area = np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1) / 2
    weight = np.bincount(F.ravel(), np.repeat(area, 3), len(V))
    return np.bincount(F.ravel(), np.repeat(area * of_face, 3), len(V)) / weight


def killing(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome:
    """Move the handles to their targets with the least Killing energy, by linear least squares."""
    import meshref

    start = perf_counter()
    handles = np.flatnonzero(target.at)
    options = case.parameters.get("mesh", {})
    result = meshref.killing(subject.V, subject.F, handles, target.displacement[handles], **options)
    seconds, done = perf_counter() - start, result.status is meshref.KillingStatus.SOLVED
    method = "Killing least squares"
    return Outcome(result.displacement, method, result.status.value, done, seconds, seconds_by_phase=result.seconds)


def arap(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome:
    """Move the handles to their targets as rigidly as possible, the second mesh method."""
    import meshref

    handles = np.flatnonzero(target.at)
    start = perf_counter()
    result = meshref.arap(subject.V, subject.F, handles, subject.V[handles] + target.displacement[handles])
    seconds = perf_counter() - start
    return _of_arap(result, subject, "ARAP", seconds)


def _killing_beside(
    miss: float, case: Case, subject: Subject, target: Target, progress: Progress | None = None
) -> Outcome | None:
    """Return the least squares with springs; None where the case names its own handles, or no spring fits."""
    import meshref

    options = dict(case.parameters.get("mesh", {}))
    if set(options) & {"method", "penalty", "handle_weights"}:
        return None
    handles = np.flatnonzero(target.at)

    start = perf_counter()
    found = at_equal_error(
        lambda penalty: meshref.killing(
            subject.V, subject.F, handles, target.displacement[handles], method="soft", penalty=penalty, **options
        ),
        lambda solved: handle_miss(subject, target, solved.displacement),
        miss,
    )
    if found is None:
        return None
    result, penalty = found
    return Outcome(
        result.displacement,
        "Killing least squares, springs",
        result.status.value,
        result.status is meshref.KillingStatus.SOLVED,
        perf_counter() - start,  # of the whole search
        seconds_by_phase=result.seconds,
        details={"penalty": penalty},
    )


def _arap_beside(
    miss: float, case: Case, subject: Subject, target: Target, progress: Progress | None = None
) -> Outcome | None:
    """Return ARAP with springs; None where no spring fits."""
    import meshref

    handles = np.flatnonzero(target.at)
    goal = subject.V[handles] + target.displacement[handles]
    last: meshref.ArapResult | None = None

    def solve(penalty: float) -> meshref.ArapResult:
        nonlocal last
        last = meshref.arap(
            subject.V, subject.F, handles, goal, penalty=penalty, start=None if last is None else last.V
        )
        return last

    start = perf_counter()
    found = at_equal_error(
        solve,
        lambda solved: handle_miss(subject, target, solved.V - subject.V),
        miss,
    )
    if found is None:
        return None
    result, penalty = found
    seconds = perf_counter() - start  # of the whole search
    return _of_arap(result, subject, "ARAP, springs", seconds, penalty=penalty)


def _of_arap(result: meshref.ArapResult, subject: Subject, method: str, seconds: float, **details: float) -> Outcome:
    return Outcome(
        result.V - subject.V,
        method,
        result.status.value,
        result.converged,
        seconds,
        seconds_by_phase=result.seconds,
        details={
            "iterations": result.iterations,
            "last_move": result.residual,
            "last_energy_change": result.energy_change,
            **details,
        },
    )
