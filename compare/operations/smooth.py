"""Smoothing by mean curvature flow that keeps the volume.

| neural field | mesh |
|---|---|
| implicit.converged_smooth, Volume() held | meshref.converged_curvature_flow, held by a uniform normal speed |

Both follow dx/dt = (mean kappa - kappa) n for the same time, each in as many steps as it takes for their number not to
matter, or in so many that are allowed; what their number still does is estimated on both sides. The conformalised flow,
rescaled to its volume, is another equation: it stands beside under its own name. A case that names a flow of the mesh
(its method, what keeps its volume, its cotangents) has that one, in its own steps. The field, whose steps are dear, is
allowed no more than the case's steps, unless the case says most_steps, as those of `run` do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import isfinite
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import (
    Column,
    Editor,
    Halfway,
    Headline,
    Operation,
    Outcome,
    Target,
    normal_part,
    teller,
)

# Options of a case's mesh with which its flow is still the default one, and the most steps for that.
CONVERGED = {"tolerance", "most_steps", "solver"}
MOST_STEPS = 128


class Smooth(Operation):
    """No vertex has a target; both sides follow the same flow for the same time."""

    name = "smooth"
    takes_handles = False
    settings = ("steps", "step_size")
    # Sixteen steps leave spot 0.3 % of its diagonal from the flow; each halving takes twice the time for a third of it.
    full: Mapping[str, Any] = {"steps": 8, "step_size": 1e-3, "implicit": {"points": 2000, "most_steps": 16}}
    quick: Mapping[str, Any] = {
        "steps": 4,
        "step_size": 1e-3,
        "implicit": {"points": 500, "resolution": 32, "most_steps": 4},
    }
    error_means = "motion along the normal minus that of the other representation"
    headline = Headline("volume_drift", "volume {}")
    columns = (
        Column(
            "flow_error_relative",
            "flow±",
            "estimated error of the steps of a flow, rms along the normal, over the diagonal of the shape's box",
            percent=True,
            brief=False,
            label="estimated error of the flow's steps, relative",
        ),
    )

    def option_sources(self) -> Mapping[str, tuple[Callable[..., Any], ...]]:
        """Return the two flows."""
        import implicit
        import meshref

        flows = (meshref.converged_curvature_flow, meshref.mean_curvature_flow)
        return {"implicit": (implicit.smooth, implicit.converged_smooth), "mesh": flows}

    def edit_field(self, case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
        """Smooth the field with its volume held."""
        import implicit
        from compare.operations.neural import run_edit
        from implicit.renamed import current_names

        steps, step_size = (case.parameters[name] for name in Smooth.settings)
        time, found = steps * step_size, []

        def flow(field: implicit.Field, **options: Any) -> implicit.Edit:
            options = {"most_steps": steps, **current_names(implicit.smooth, options)}
            found.append(implicit.converged_smooth(field, time=time, steps=steps, **options))
            return found[-1].edit

        method = "curvature flow, volume held"
        outcome = run_edit(flow, case, subject, method, progress, constraints=(implicit.Volume(),))
        flowed, scale = found[-1], subject.scale
        status = outcome.status
        if outcome.complete and not flowed.converged:
            status = _not_converged(flowed.time_error_max * scale)
        every = max(1, flowed.steps // steps)
        details = {
            **outcome.details,
            "time_error_rms": flowed.time_error_rms * scale,
            "time_error_max": flowed.time_error_max * scale,
            "area_error": flowed.area_error * scale**2,
        }
        estimates = {**outcome.estimates, "flow_error_relative": flowed.time_error_rms / _diagonal(subject)}
        path = list(outcome.path)[every - 1 :: every]
        return replace(outcome, status=status, path=path, details=details, estimates=estimates)

    def mesh_editors(self) -> Mapping[str, Editor]:
        """Return the same flow on the mesh, and the conformalised one."""
        return {"mesh": _flow, "mesh, conformalised": _conformalised}

    def error_field(self, subject: Subject, target: Target, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
        """Return the motion along the normal beyond that of the other representation."""
        return normal_part(subject, own.displacement - other.displacement)


def _steps(case: Case) -> dict[str, Any]:
    return {name: case.parameters[name] for name in Smooth.settings}


def _diagonal(subject: Subject) -> float:
    return float(np.linalg.norm(np.ptp(subject.V, axis=0)))


def _not_converged(error: float) -> str:
    if not isfinite(error):
        return "All steps were taken, but nothing tells what twice as many would change."
    return f"All steps were taken, but twice as many may move it by {error:.2g}."


def _flow(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome:
    options = dict(case.parameters.get("mesh", {}))
    if not set(options) <= CONVERGED:
        return _in_steps(case, subject, {"method": "semi-implicit", "preserve_volume": "newton", **options}, progress)
    import meshref

    steps, step_size = (case.parameters[name] for name in Smooth.settings)
    tell = teller(progress, f"{case.operation}, mesh")
    start = perf_counter()
    found = meshref.converged_curvature_flow(
        subject.V,
        subject.F,
        time=steps * step_size,
        steps=steps,
        progress=lambda step, all_steps: tell(step, all_steps, None),
        **{"most_steps": max(MOST_STEPS, 4 * steps), **options},
    )
    seconds, flow = perf_counter() - start, found.flow
    finished = flow.status is meshref.FlowStatus.FINISHED
    status = flow.status.value
    if finished and not found.converged:
        status = _not_converged(found.time_error_max * subject.scale)
    every = found.steps // steps
    path = [Halfway(V - subject.V, flow.history[k * every].seconds) for k, V in enumerate(flow.snapshots[1:], start=1)]
    if finished:
        path[-1] = Halfway(flow.V - subject.V, path[-1].seconds)  # extrapolated
    return Outcome(
        flow.V - subject.V,
        "curvature flow, volume held",
        status,
        finished,
        seconds,
        seconds_by_phase={"steps": seconds},
        path=path,
        details={
            "steps": found.steps,
            "time_error_rms": found.time_error_rms * subject.scale,
            "time_error_max": found.time_error_max * subject.scale,
        },
        estimates={"flow_error_relative": found.time_error_rms / _diagonal(subject)},
    )


def _conformalised(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome | None:
    if not set(case.parameters.get("mesh", {})) <= CONVERGED:
        return None  # the case names the flow that it wants
    return _in_steps(case, subject, {"method": "conformalised", "preserve_volume": "rescale"}, progress)


def _in_steps(case: Case, subject: Subject, options: dict[str, Any], progress: Progress | None) -> Outcome:
    import meshref

    options = {**options, "snapshot_every": 1}
    tell = teller(progress, f"{case.operation}, mesh")
    start = perf_counter()
    flow = meshref.mean_curvature_flow(
        subject.V,
        subject.F,
        progress=lambda step, steps: tell(step, steps, None),
        **_steps(case),
        **options,
    )
    seconds = perf_counter() - start
    kept = {None: "", "newton": ", volume held", "rescale": ", rescaled"}[options["preserve_volume"]]
    return Outcome(
        flow.V - subject.V,
        f"{options['method']} curvature flow{kept}",
        flow.status.value,
        flow.status is meshref.FlowStatus.FINISHED,
        seconds,
        seconds_by_phase={"steps": seconds},
        path=[Halfway(V - subject.V, row.seconds) for V, row in zip(flow.snapshots[1:], flow.history[1:], strict=True)],
        details={"steps": flow.steps_taken},
    )
