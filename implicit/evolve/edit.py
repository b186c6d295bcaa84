"""The result of an edit: the edited field, how it ended, and the evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from html import escape

import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor

from implicit.arguments import counted, kind_of, require_callable, require_positive, require_whole
from implicit.field.field import Field, require_field
from implicit.step.problem import Row
from implicit.step.rest_shape import Deformation
from implicit.surface.extraction import SurfaceError, require_resolution
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample, require_sample
from implicit.surface.soundness import Soundness, changes, confirmed, field_soundness, has_changed

Progress = Callable[[int, int, Row], None]
Asked = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]

# Of the angle between a point's normal and the edited surface's up to which an error is measured along the former.
LEAST_COSINE = 0.5

# An edit whose error field has at most this root mean square, over the area that was to move, has reached its target.
REACHED_SHARE = 0.1


def require_options(
    field: Field,
    *,
    damping: float | None = None,
    resolution: int = 48,
    track: Tensor | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> None:
    """Refuse what no edit can use, before any work."""
    require_field(field)
    if damping is not None:
        require_positive("damping", damping, or_zero=True)
    require_resolution("resolution", resolution)
    if track is not None:
        field.require_points(track, "track")
    if progress is not None:
        require_callable("progress", progress, "a function of the step, the number of steps and the record")
    require_whole("seed", seed, 0)


class EditStatus(Enum):
    """Outcome of an edit; the value is the sentence a user reads."""

    DONE = "All steps were taken."
    REACHED = "The stopping rule was met before the last step."
    NOT_REACHED = "All steps were taken, but the prescribed displacement was not reached; see the error field."
    NOT_FOLLOWED = "All steps were taken, but the surface did not move as the flow asked; see the notes."
    NOT_FINITE = "Stopped before a step that would not be finite; the field is as it was before that step."
    SURFACE_LOST = "Stopped before a step after which the surface would vanish or leave the bounds of the field."
    CONSTRAINT_NOT_HELD = "Stopped before a step after which a constraint could not be restored to its tolerance."
    STRAY_PIECES = "All steps were taken, but stray pieces of surface have appeared; see the notes."
    TOPOLOGY_CHANGED = (
        "All steps were taken, but pieces of the surface have merged or vanished, or handles have opened or closed; "
        "see the notes."
    )
    SELF_CROSSING = (
        "Stopped before the field was changed: the points of least energy pass through each other, which no field can "
        "show; see the notes."
    )
    UNSTABLE = "Stopped because the steps grew beyond what a linear prediction holds for; take smaller steps."


@dataclass(frozen=True, eq=False, repr=False)
class Edit:
    """An edited field and the evidence of how it came about.

    Attributes:
        field: The edited field. `field.write_back()` stores it in the module that the edit began from.
        points: Starting points (I, D) on the unedited surface, with their `normals` and quadrature `weights`.
        displacement: Of the starting points, to the end (I, D), a length.
        wanted: Displacement asked for at the starting points (I, D); NaN where nothing was asked.
        tracked: Where the `track` points of the caller ended (M, D), or None.
        trail: Where they were after each step, (M, D) each; the last is `tracked`. Empty without them.
        history: One row a step: energies, constraint values, residuals, step norms, seconds.
        status: How it ended.
        seconds: Wall time.
        asked: From points and normals of the unedited surface (N, D) to what was asked there: the displacement, NaN
            where nothing was, and the unit normals the points take along. None where only `wanted` is known.
        before, after: How sound the field was and is, of geometric and rigid edits.
        notes: What has become worse, a sentence each.
        deformation: Of the shape at rest, by a rigid edit with finite rotations: what `rigid_edit(..., rest=edit)` goes
            on from.
    """

    field: Field
    points: Float[Tensor, "i d"]
    normals: Float[Tensor, "i d"]
    weights: Float[Tensor, " i"]
    displacement: Float[Tensor, "i d"]
    wanted: Float[Tensor, "i d"]
    tracked: Float[Tensor, "m d"] | None
    trail: tuple[Float[Tensor, "m d"], ...]
    history: list[Row]
    status: EditStatus
    seconds: float
    asked: Asked | None = None
    before: Soundness | None = None
    after: Soundness | None = None
    notes: tuple[str, ...] = ()
    deformation: Deformation | None = None

    def frames(
        self, V: Float[Tensor, "m d"] | Float[ndarray, "m d"], F: Int[ndarray, "k d"], *, units: str = "field"
    ) -> list[tuple[Float[ndarray, "m d"], Int[ndarray, "k d"]]]:
        """Return the meshes on the way: the given one, and it carried along by each step.

        Its vertices are what the edit was to carry along, as in V, F = extract_mesh(field), track=torch.from_numpy(V).
        A rigid edit by finite rotations has one for each stage of the points' way, and the end: on the way they are
        where the points would take them, for the field goes straight to the end.

        Args:
            V: The points that were given as `track`, (M, D).
            F: Faces between them, (K, D).
            units: Of what is returned: "field", or "user", those of the file that the field was fitted to.

        Raises:
            ValueError: Nothing was carried along, or other points than V were; or units is another word.
        """
        if units not in ("field", "user"):
            raise ValueError(f'units must be "field" or "user", but is {units!r}.')
        if not self.trail:
            raise ValueError(
                "The edit carried no points along. Give it the vertices of a mesh: V, F = extract_mesh(field), then "
                "track=torch.from_numpy(V)."
            )
        first = torch.as_tensor(V).to(self.trail[0])
        if first.shape != self.trail[0].shape:
            raise ValueError(
                f"V must be the points that were given as track, {tuple(self.trail[0].shape)}, but has shape "
                f"{tuple(first.shape)}."
            )
        ways = (first, *self.trail)
        places = [self.field.units.to_user(points) if units == "user" else points for points in ways]
        return [(points.detach().cpu().double().numpy(), F) for points in places]

    def error_field(self, sample: SurfaceSample | None = None) -> Float[Tensor, " n"]:
        """Return achieved minus wanted normal displacement over the largest wanted one [paper, error fields of fig. 4].

        Achieved is measured on the edited field: each point x is put at its goal g = x + wanted, and projected from
        there to the edited surface. The signed way e along the edited surface's normal n' is the gap between the two
        surfaces; along the normal n that x takes along the gap is e / (n . n'), to second order in e. Beyond 60 degrees
        between the normals, where the goal folds, that line says nothing any more, and e / cos 60 is taken. An edit
        that was asked for positions alone (a rigid one) has no such normals; there e itself is the error.

        Args:
            sample: Points of the unedited surface; None takes the starting points. A geometric edit answers for any,
                so a dense quadrature of the unedited field shows the error between the points that carried the target.

        Returns:
            A pure number each, positive where the surface is too far out; NaN where nothing was asked.

        Raises:
            ValueError: Another sample was given, but the edit knows only of its starting points.
            TypeError: It is no SurfaceSample.
        """
        points, normals, wanted, along = self.points, self.normals, self.wanted, None
        if sample is not None:
            if self.asked is None:
                raise ValueError("This edit knows what was asked at its starting points only; leave sample out.")
            sample = require_sample(self.field, sample)
            points, normals = sample.points, sample.normals
        if self.asked is not None:
            wanted, along = self.asked(points, normals)
        targeted = torch.isfinite(wanted).all(dim=1)
        error = torch.full_like(points[:, 0], float("nan"))
        if not bool(targeted.any()):
            return error
        # A rigid edit works in float64 whatever the field is in, and its points stay so.
        goal = self.field.in_precision(points[targeted] + wanted[targeted])
        largest = (wanted[targeted] * normals[targeted]).sum(dim=1).abs().max()
        surface, arrived = newton_to_surface(self.field, goal, reach=self.field.size / 2)
        facing = self.field.normal(surface)
        gap = ((surface - goal) * facing).sum(dim=1)
        if along is not None:
            gap = gap / (along[targeted].to(facing) * facing).sum(dim=1).clamp(min=LEAST_COSINE)
        gap = torch.where(arrived, gap, torch.full_like(gap, float("nan")))
        error[targeted] = gap.to(error) / largest.clamp(min=torch.finfo(error.dtype).tiny)
        return error

    def __repr__(self) -> str:
        """Return how it ended and how far the surface moved, in two lines."""
        facts = dict(self._facts())
        came_to = f"{facts['motion']}, {facts['points']}"
        return f"Edit: {self.status.name} after {facts['steps']}: {self.status.value}\n  {came_to}"

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in self._facts())
        return f"<table><caption>Edit</caption>{rows}</table>"

    def _facts(self) -> list[tuple[str, str]]:
        """Return what a reader asks first of an edit: a name and a text for each row of the table."""
        count, dimension = self.points.shape
        lengths = self.displacement.norm(dim=1)
        largest = float(lengths.max()) if count else 0.0
        facts = [
            ("status", f"{self.status.name}: {self.status.value}"),
            ("steps", f"{counted(len(self.history), 'step')}, {self.seconds:.3g} s"),
            ("motion", f"moved by {largest:.3g} at most"),
            ("points", f"{counted(count, 'point')} in {dimension}D ({kind_of(self.points)})"),
            ("theta", f"P = {len(self.field.theta):,}"),
        ]
        if self.before is not None and self.after is not None:
            pieces = f"{self.before.pieces} before, {self.after.pieces} after"
            facts.append(("pieces", pieces))
        return [*facts, *(("note", note) for note in self.notes)]


def edit_status(
    ended: EditStatus,
    *,
    reached: bool = True,
    followed: bool = True,
    meshed: bool = True,
    more_pieces: bool = False,
    other_type: bool = False,
) -> EditStatus:
    """Return how an edit ended: the one place where that is decided.

    Facts that come to light later are told of in a further call, with what the one before gave.

    Args:
        ended: How the loop did: DONE, REACHED, or why a step was not taken.
        reached: Whether the prescribed displacement was reached.
        followed: Whether the surface moved as a flow asked.
        meshed: Whether the edited field's surface can be meshed.
        more_pieces: Whether that has more pieces than before, where none was to appear.
        other_type: Whether it has fewer pieces, or other handles, than before.
    """
    if not meshed:
        return EditStatus.STRAY_PIECES
    if ended not in (EditStatus.DONE, EditStatus.REACHED):
        return ended
    if not reached:
        return EditStatus.NOT_REACHED
    if not followed:
        return EditStatus.NOT_FOLLOWED
    if ended is EditStatus.DONE and more_pieces:
        return EditStatus.STRAY_PIECES
    if ended is EditStatus.DONE and other_type:
        return EditStatus.TOPOLOGY_CHANGED
    return ended


def reached_target(edit: Edit, way: float = 0.0) -> bool:
    """Return whether the error field is within REACHED_SHARE (root mean square) where a displacement was asked for.

    Args:
        edit: The edit.
        way: Largest motion on the way, a length: a path that leads back, as a whole turn, is judged by it.
    """
    error = edit.error_field()
    targeted = torch.isfinite(edit.wanted).all(dim=1)
    moved = targeted & (edit.wanted.norm(dim=1) > 0)
    if not bool(moved.any()):
        return True
    longer = max(1.0, way / float(edit.wanted[moved].norm(dim=1).max()))
    allowed = REACHED_SHARE * longer * edit.weights[moved].sum().sqrt()
    return bool((error[targeted] * edit.weights[targeted].sqrt()).norm() <= allowed)


def with_evidence(edit: Edit, field: Field, before: Soundness, resolution: int, after: Soundness | None = None) -> Edit:
    """Return the edit with how sound its field was and is, in numbers and in words.

    Args:
        field: At the start.
        before: How sound it was.
        resolution: Cells along the longest side of the bounds.
        after: How sound the edited field is, where that has been measured; None measures it.
    """
    try:
        after = field_soundness(edit.field, resolution) if after is None else after
    except SurfaceError as error:
        notes = (*edit.notes, f"The edited field cannot be meshed as it is: {error}")
        return replace(edit, before=before, notes=notes, status=edit_status(edit.status, meshed=False))
    before, after = confirmed(before, after, (field, edit.field), resolution)
    more, other = after.pieces > before.pieces, has_changed(before, after)
    status = edit_status(edit.status, more_pieces=more, other_type=other)
    return replace(edit, before=before, after=after, notes=(*edit.notes, *changes(before, after)), status=status)
