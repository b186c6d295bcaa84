"""Geometric editing: prescribe how far parts of the surface move, and keep or free the rest.

Each step minimises E_C + damping |d_theta|^2 [paper, eq. 4, 5]. A large displacement is split into parts, and
each part aims at where the points should be by then rather than repeating its share, so what one part missed
the next makes up for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.enough_points import carriers
from implicit.edits.geometric_parts import (
    MOST_FINISHING,
    MOST_PARTS,
    OFF_SURFACE_STRENGTH,
    GeometricOperation,
    PartSchedule,
)
from implicit.edits.handles import Handle
from implicit.edits.targets import Rest, SummedTargets, checked_handles
from implicit.evolve.constraints import checked_constraints
from implicit.evolve.edit import Edit, Progress, require_options, with_evidence
from implicit.evolve.evolve import evolve
from implicit.field.field import Field, require_field
from implicit.renamed import renamed
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.sensitivity.shape_functionals import Functional
from implicit.sensitivity.sparse_rows import has_sparse_rows
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.soundness import field_soundness


@renamed(parts="steps")
def geometric_edit(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Rest = "fixed",
    *,
    steps: int | None = None,
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
            several overlap, displacements add. Vectors are projected on the current normal in each step.
        rest: Target of points in no region: "fixed" at zero, "free", or fixed with this weight.
        steps: Equal sub-steps; None chooses their number as the edit goes: a few large ones, each at a share of the
            points, and finishing ones that aim at the goal until what is missed falls no further. A field whose
            gradient jumps (ReLU), or whose parameters act locally (grids), takes exact ones as its linearity allows.
        points: Number of points that carry the target, or the sample itself. They travel with the surface, and are
            drawn anew, more of them, where they have thinned out. Where each parameter acts near its own place alone
            (grids), as many are drawn as hold the surface between them too, up to 32,000, and `notes` says so; a
            sample of one's own is kept, and `notes` says how many would do.
        damping: Penalty on |d_theta|^2; None adapts it to the linearity error.
        constraints: Functionals to hold during the edit, such as Volume() or Area().
        least_alignment: Points whose displacement makes a smaller cosine than this with the normal are left free.
        off_surface_strength: Weight by which the field off the surface is tied to the surface's motion, which keeps
            stray pieces from arising there; 0 leaves it to chance, as the paper does.
        resolution: Cells a side of the quadrature that measures the constraints and counts the pieces of the surface.
        track: Further surface points (M, D) to carry along.
        progress: Called as progress(step, steps, row) after each step: its number from 1, how many there are, and its
            row of the record, as in Edit.record.
        seed: Seed of the random points.

    Returns:
        The edit. `before` and `after` say how sound the field is, `notes` what has become worse.

    Raises:
        ValueError: No point of the surface lies in any region, or a displacement is not finite, or longer than the
            bounds are across.
    """
    require_field(field)
    track = field.in_precision(track)
    require_options(field, damping=damping, resolution=resolution, track=track, progress=progress, seed=seed)
    listed = checked_handles(handles)
    constraints = checked_constraints(constraints)
    if steps is not None:
        require_whole("steps", steps)
    require_positive("off_surface_strength", off_surface_strength, or_zero=True)
    targets_of = partial(SummedTargets, listed, rest=rest, least_alignment=least_alignment)
    carrying = carriers(field, points, targets_of, seed=seed)
    sample = carrying.sample
    targets = targets_of(sample.points, sample.normals)
    _require_within_bounds(field, targets.largest())
    before = field_soundness(field, resolution)
    kinked = steps is None and not normal_turning(field, sample.points).is_smooth
    approaching = steps is None and not kinked and not has_sparse_rows(field, sample.points)
    schedule = PartSchedule.of(steps, targets.largest() / field.size, kinked=kinked, approaching=approaching)
    operation = GeometricOperation(field, targets_of, sample, schedule, damping, off_surface_strength, track, seed)
    edit = evolve(
        field,
        operation,
        sample,
        steps=MOST_PARTS + MOST_FINISHING if steps is None else steps,
        constraints=constraints,
        resolution=resolution,
        track=track,
        wanted=targets.target(),
        asked=lambda points, normals: _target_and_directions(targets_of(points, normals)),
        progress=progress,
    )
    return with_evidence(carrying.judged(edit), field, before, resolution)


def _require_within_bounds(field: Field, largest: float) -> None:
    """Refuse a displacement that would take any surface out of the bounds."""
    across = float((field.bounds[1] - field.bounds[0]).norm())
    if largest > across:
        raise ValueError(
            f"A displacement is {largest:.4g} long where the field's bounds are {across:.4g} from corner to corner, in "
            "the field's coordinates: the surface would leave them. Shorten it, or look at its units."
        )


def _target_and_directions(targets: SummedTargets) -> tuple[Tensor, Tensor]:
    return targets.target(), targets.directions()
