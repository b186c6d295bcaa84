"""Smoothing by mean curvature flow that keeps the volume.

| neural field | mesh |
|---|---|
| implicit.smooth with Volume() held | conformalised mean-curvature flow, rescaled to its volume |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import (
    Editor,
    Halfway,
    Headline,
    Operation,
    Outcome,
    Target,
    normal_part,
    teller,
)


class Smooth(Operation):
    """No vertex has a target; both sides take the same steps of the same flow."""

    name = "smooth"
    takes_handles = False
    settings = ("steps", "step_size")
    full: Mapping[str, Any] = {"steps": 8, "step_size": 1e-3, "implicit": {"points": 2000}}
    quick: Mapping[str, Any] = {"steps": 4, "step_size": 1e-3, "implicit": {"points": 500, "resolution": 32}}
    error_means = "motion along the normal minus that of the other representation"
    headline = Headline("volume_drift", "volume {}")

    def option_sources(self) -> Mapping[str, tuple[Callable[..., Any], ...]]:
        """Return the two flows."""
        import implicit
        import meshref

        return {"implicit": (implicit.smooth,), "mesh": (meshref.mean_curvature_flow,)}

    def edit_field(self, case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
        """Smooth the field with its volume held."""
        import implicit
        from compare.operations.neural import run_edit

        volume, method = (implicit.Volume(),), "curvature flow, volume held"
        return run_edit(implicit.smooth, case, subject, method, progress, constraints=volume, **_steps(case))

    def mesh_editors(self) -> Mapping[str, Editor]:
        """Return the flow of the mesh."""
        return {"mesh": _flow}

    def error_field(self, subject: Subject, target: Target, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
        """Return the motion along the normal beyond that of the other representation."""
        return normal_part(subject, own.displacement - other.displacement)


def _steps(case: Case) -> dict[str, Any]:
    return {name: case.parameters[name] for name in Smooth.settings}


def _flow(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome:
    import meshref

    options = {"method": "conformalised", "preserve_volume": "rescale", **case.parameters.get("mesh", {})}
    options["snapshot_every"] = 1
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
    return Outcome(
        flow.V - subject.V,
        f"{options['method']} curvature flow{', volume kept' if options['preserve_volume'] else ''}",
        flow.status.value,
        flow.status is meshref.FlowStatus.FINISHED,
        seconds,
        seconds_by_phase={"steps": seconds},
        path=[Halfway(V - subject.V, row.seconds) for V, row in zip(flow.snapshots[1:], flow.history[1:], strict=True)],
        details={"steps": flow.steps_taken},
    )
