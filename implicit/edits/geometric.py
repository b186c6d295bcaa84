"""Geometric editing: prescribe how far parts of the surface move, and keep or free the rest.

Each step minimises E_C + damping |d_theta|^2 [paper, eq. 4, 5]. A large displacement is split into parts, and
each part aims at where the points should be by then rather than repeating its share, so what one part missed
the next makes up for.
"""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.geometric_parts import MOST_PARTS, OFF_SURFACE_STRENGTH, GeometricOperation, PartSchedule
from implicit.edits.handles import Handle
from implicit.edits.targets import Goal, Rest, checked_handles
from implicit.evolve.constraints import checked_constraints
from implicit.evolve.edit import Edit, Progress, require_options, with_evidence
from implicit.evolve.evolve import evolve
from implicit.field.field import Field
from implicit.sensitivity.shape_functionals import Functional
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import carrying_points
from implicit.surface.soundness import field_soundness


def geometric_edit(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Rest = "fixed",
    *,
    parts: int | None = None,
    points: int | SurfaceSample = 4000,
    damping: float | None = None,
    constraints: Sequence[Functional] = (),
    least_alignment: float = 0.0,
    off_surface_strength: float = OFF_SURFACE_STRENGTH,
    resolution: int = 48,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Edit:
    """Move parts of the surface by prescribed displacements.

    Args:
        field: The field to edit; the caller's own stays as it is until `edit.field.write_back()`.
        handles: Regions and their displacements. A region's weight between 0 and 1 scales the displacement; where
            several overlap, displacements add. Vectors are projected on the current normal in each part.
        rest: What becomes of points in no region: "fixed" at zero, "free", or fixed with this weight.
        parts: Equal sub-steps; None chooses their number as the edit goes, from the linearity error of each.
        points: How many points carry the target, or the sample itself. They travel with the surface, and are drawn
            anew, more of them, where they have thinned out.
        damping: Penalty on |d_theta|^2; None adapts it to the linearity error.
        constraints: Functionals to hold during the edit, such as Volume() or Area().
        least_alignment: Points whose displacement makes a smaller cosine than this with the normal are left free.
        off_surface_strength: How firmly the field away from the surface is tied to the surface's motion, which keeps
            stray pieces from arising there; 0 leaves it to chance, as the paper does.
        resolution: Of the quadrature that measures the constraints, and of the pieces of the surface that are counted.
        track: Further surface points (M, D) to carry along.
        progress: Called after each part.
        seed: Of the random points.

    Returns:
        The edit. `before` and `after` say how sound the field is, `notes` what has become worse.

    Raises:
        ValueError: No point of the surface lies in any region, or a displacement is not finite.
    """
    require_options(field, damping=damping, resolution=resolution, track=track, progress=progress, seed=seed)
    listed = checked_handles(handles)
    constraints = checked_constraints(constraints)
    if parts is not None:
        require_whole("parts", parts)
    require_positive("off_surface_strength", off_surface_strength, or_zero=True)
    sample = carrying_points(field, points, seed=seed)

    def goal_of(points: Tensor, normals: Tensor) -> Goal:
        return Goal(listed, points, normals, rest, least_alignment=least_alignment)

    goal = goal_of(sample.points, sample.normals)
    goal.require_points_in_each_region()
    before = field_soundness(field, resolution)
    schedule = PartSchedule.of(parts, goal.largest() / field.size)
    operation = GeometricOperation(field, goal_of, sample, schedule, damping, off_surface_strength, track, seed)
    edit = evolve(
        field,
        operation,
        sample,
        steps=MOST_PARTS if parts is None else parts,
        constraints=constraints,
        resolution=resolution,
        track=track,
        wanted=goal.wanted(),
        asked=lambda points, normals: _asked(goal_of(points, normals)),
        progress=progress,
    )
    return with_evidence(edit, before, resolution)


def _asked(goal: Goal) -> tuple[Tensor, Tensor]:
    return goal.wanted(), goal.directions()
