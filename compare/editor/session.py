"""A session of editing one field, with no viewer: what a page, a notebook or a script drives.

    session = EditSession.open("spot")
    session.pick(ball([0.1, 0.5, 0.2], radius=0.1))
    session.preview(Motion(translation=(0, 0.1, 0)))        a frame of a drag, by the linear model
    session.drag(Motion(translation=(0, 0.1, 0)))           the edit itself
    session.undo()

An edit that is refused or called off leaves the field as it was, to the bit: a field is never changed, only followed by
another. With a folder, every edit is on disk before the call returns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from compare.cases.handles import HandleSpec
from compare.editor.evidence import Evidence
from compare.editor.history import Entry, Folder, digest, renamed
from compare.editor.linear import LinearModel, Missed, Preview, Surface
from compare.editor.motion import Motion, Triple, carried
from compare.editor.regions import Picked, Role
from compare.editor.source import Opening, Source, open_source
from compare.editor.tools import Progress, Settings, Tool, carrying_sample, prior_of, run_tool, settled
from compare.errors import InputError, Progress as Told
from implicit.evolve.edit import REACHED_SHARE, EditStatus, edit_status, reached_target
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import meshed_quadrature
from implicit.surface.soundness import changes, confirmed, field_soundness, has_changed

# Cells along the longest side: of the drawn mesh and the quadrature, and of the count of pieces that nobody waits for.
DRAWN, FINE = 40, 48

COMPLETE = (EditStatus.DONE, EditStatus.REACHED)
OF_SOUNDNESS = (EditStatus.STRAY_PIECES, EditStatus.TOPOLOGY_CHANGED)


class CalledOffError(InputError):
    """An edit that the user has called off."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A field with what is drawn and measured of it.

    Attributes:
        field: The field.
        surface: As drawn.
        quadrature: Of its surface.
        volume, area: In the field's units.
        pieces: Connected pieces of the drawn mesh.
    """

    field: implicit.Field
    surface: Surface
    quadrature: implicit.SurfaceSample
    volume: float
    area: float
    pieces: int


class EditSession:
    """A field, the regions picked on it, and its history.

    Args:
        source: What it begins with.
        folder: Where the session is kept after each edit; None keeps it in memory alone.
        settings: Of edits that name no others.
        drawn: Cells along the longest side of the drawn mesh and of the quadrature. The same edits give the same field
            at the same number of them.

    Attributes:
        source: What it began with.
        settings: Of edits that name no others.
        regions: What was picked.
        entries: All edits, those undone included.
        position: How many of them stand.

    Raises:
        InputError: The folder holds a session already.
        implicit.SurfaceError: The field has no closed surface in its bounds.
    """

    def __init__(
        self,
        source: Source,
        folder: str | PathLike[str] | None = None,
        settings: Settings | None = None,
        *,
        drawn: int = DRAWN,
    ) -> None:
        self.source = source
        self.drawn = drawn
        self.settings = Settings() if settings is None else settings
        self.regions: list[Picked] = []
        self.entries: list[Entry] = []
        self.position = 0
        self._folder = None if folder is None else Folder(Path(folder))
        self._fields = [source.field]
        self._last: tuple[int, Measured, Evidence] | None = None  # of the edit that was made last
        self._models: dict[Any, LinearModel] = {}
        self._called_off = Event()
        self._measured = self._measure(source.field)
        if self._folder is not None:
            if self._folder.holds_session:
                raise InputError(f"{self._folder.path} holds a session already. Go on with it, or name another folder.")
            self._folder.write_field(0, source.field, source)
            self._folder.write(source, [], 0)

    @classmethod
    def open(
        cls,
        shape: str,
        folder: str | PathLike[str] | None = None,
        *,
        opening: Opening | None = None,
        settings: Settings | None = None,
        progress: Told | None = None,
        drawn: int = DRAWN,
    ) -> EditSession:
        """Begin a session with a shape, or go on with the one in the folder.

        Args:
            shape: A bundled shape or family model, a file, or a function of the user's own; see compare.editor.source.
            folder: Where the session is kept; None keeps it in memory alone.
            opening: How the shape is taken in.
            settings: Of edits that name no others.
            progress: Called as progress(step, steps, what) while a field is fitted to a mesh.
            drawn: Cells along the longest side of the drawn mesh and of the quadrature.

        Raises:
            InputError: The shape cannot be used, or the folder holds a session of another shape.
        """
        if folder is not None and Folder(Path(folder)).holds_session:
            module = None if opening is None else opening.module
            return cls.load(folder, shape=shape, module=module, settings=settings, drawn=drawn)
        return cls(open_source(shape, opening, progress), folder, settings, drawn=drawn)

    @classmethod
    def load(
        cls,
        folder: str | PathLike[str],
        *,
        shape: str | None = None,
        module: str | None = None,
        settings: Settings | None = None,
        drawn: int = DRAWN,
    ) -> EditSession:
        """Go on with a session that was saved.

        Args:
            folder: Of the session.
            shape: The shape that it must be of; None takes any. Code of the user's own is run only where it is named
                here.
            module: What builds the network of a field's file, if something does.
            settings: Of edits that name no others.
            drawn: As for open.

        Raises:
            InputError: There is none, it cannot be read, or it is of another shape.
        """
        kept = Folder(Path(folder))
        row = kept.read()
        if shape is not None and shape != row["shape"]:
            raise InputError(
                f"{kept.path} holds a session of {row['shape']}, but the shape is {shape}. Name another folder."
            )
        source = _source_of(kept, row, shape, module)
        session = cls(source, None, settings, drawn=drawn)
        session._folder = kept
        session.entries = list(row["edits"])
        session._fields = [source.field]
        for number in range(1, len(session.entries) + 1):
            theta = kept.read_theta_of(number, source.field)
            session._fields.append(source.field.with_theta(theta))
        session._stand_at(row["position"], save=False)
        return session

    # What it shows

    @property
    def field(self) -> implicit.Field:
        """Field after all edits that stand."""
        return self._fields[self.position]

    @property
    def surface(self) -> Surface:
        """Surface of the field, as drawn."""
        return self._measured.surface

    @property
    def history(self) -> tuple[Entry, ...]:
        """Edits that stand."""
        return tuple(self.entries[: self.position])

    @property
    def folder(self) -> Path | None:
        """Folder in which the session is kept."""
        return None if self._folder is None else self._folder.path

    def measures(self) -> dict[str, float]:
        """Return volume, area and pieces in the user's units, and how far a code is from those of training."""
        return _measures(self.source, self._measured)

    # What it picks

    def pick(self, region: dict[str, Any], role: Role = "moves", grip: Sequence[float] | None = None) -> Picked:
        """Pick a region.

        Args:
            region: As compare.editor.regions makes it.
            role: "moves" with the hand, or "held".
            grip: Place on the surface by which it is held; None is the vertex nearest to the region's middle.

        Raises:
            InputError: No point of the surface lies in it, or the role is another word.
        """
        if role not in ("moves", "held"):
            raise InputError(f'A region "moves" or is "held", but the role is {role!r}.')
        V = self.surface.V
        try:
            weights = (
                HandleSpec(region, {"kind": "vector", "vector": [0.0, 0.0, 0.0]}).build().weights(torch.from_numpy(V))
            )
        except (ValueError, TypeError) as error:
            raise InputError(str(error)) from error
        inside = weights.numpy() > 0
        if not inside.any():
            raise InputError("No point of the surface lies in this region. Pick one on the shape, or make it larger.")
        if grip is None:
            middle = np.average(V[inside], axis=0, weights=weights.numpy()[inside])
            own = np.flatnonzero(inside)
            grip = V[own[((V[own] - middle) ** 2).sum(axis=1).argmin()]].tolist()
        x, y, z = (float(part) for part in grip)
        picked = Picked(region, role, (x, y, z))
        self.regions.append(picked)
        return picked

    def drop_regions(self) -> None:
        """Let go of all that was picked."""
        self.regions.clear()

    # What a drag shows

    def prepare(self, tool: Tool = "geometric", settings: Settings | None = None) -> LinearModel:
        """Return the linear model of an edit of what is picked; the same is kept until something changes.

        Raises:
            InputError: Nothing that moves is picked, or the field does not move there.
        """
        settings = self.settings if settings is None else settings
        key = (self.position, digest(self.field), repr(self.regions), tool == "semantic", settings)
        if key not in self._models:
            still = Motion(along=1.0)  # of any motion the points are the same
            handles = [still.spec(picked) for picked in self.regions]
            try:
                if not any(picked.role == "moves" for picked in self.regions):
                    raise InputError("Nothing is to move. Pick a region on the shape first.")
                sample = carrying_sample(self.field, self._measured.quadrature, handles, settings.points, settings.seed)
                rest = "free" if tool == "semantic" else "fixed"
                hold = settings.hold if tool != "semantic" else ()
                model = LinearModel(self.field, sample, self.surface, self.regions, rest=rest, hold=hold)
            except (ValueError, TypeError, RuntimeError) as error:
                raise _in_words(error) from error
            self._models = {key: model}
        return self._models[key]

    def preview(self, motion: Motion, tool: Tool = "geometric", settings: Settings | None = None) -> Preview:
        """Return a frame of a drag, by the linear model of what is picked.

        Raises:
            InputError: As for prepare.
        """
        model = self.prepare(tool, settings)
        try:
            return model.preview(motion)
        except (ValueError, RuntimeError) as error:
            raise _in_words(error) from error

    def missed(self, motion: Motion, tool: Tool = "geometric", settings: Settings | None = None) -> Missed:
        """Return what the field cannot do of a motion, before it is done.

        Raises:
            InputError: As for prepare.
        """
        return self.prepare(tool, settings).missed(motion)

    def expressibility(self, motion: Motion) -> implicit.Expressibility:
        """Return the same by implicit.expressibility, which takes longer and knows more.

        Raises:
            InputError: As for prepare.
        """
        handles = [motion.spec(picked).build() for picked in self.regions]
        try:
            return implicit.expressibility(
                self.field, handles, steps=self.settings.steps or 3, points=self.settings.points
            )
        except (ValueError, TypeError, RuntimeError) as error:
            raise _in_words(error) from error

    # What it does

    def drag(
        self,
        motion: Motion,
        tool: Tool = "geometric",
        settings: Settings | None = None,
        *,
        name: str | None = None,
        progress: Progress | None = None,
    ) -> Entry:
        """Edit the field as the hand has moved what is picked, and take the regions along.

        Args:
            motion: What the hand did.
            tool: Which edit.
            settings: Its settings; None takes those of the session.
            name: What the history calls it.
            progress: Called as progress(step, steps, row) after each step.

        Raises:
            InputError: It cannot be done, with the reason; the field is as it was.
        """
        if motion.at_rest and tool != "smooth":
            raise InputError("Nothing has moved. Drag a region away from where it is.")
        if tool == "smooth":
            handles = [Motion(along=1.0).spec(picked) for picked in self.regions if picked.role == "moves"]
        else:
            handles = [motion.spec(picked) for picked in self.regions]
        entry = self.do(handles, tool, settings, name=name, progress=progress)
        if tool != "smooth":
            self.regions = [carried(picked, motion, self._grip(picked, motion)) for picked in self.regions]
        return entry

    def do(
        self,
        handles: Sequence[HandleSpec],
        tool: Tool = "geometric",
        settings: Settings | None = None,
        *,
        name: str | None = None,
        progress: Progress | None = None,
    ) -> Entry:
        """Edit the field by handles in its own coordinates; what was undone is forgotten.

        The same handles and settings give the same field, to the bit, on the same machine.

        Args:
            handles: What goes where.
            tool, settings, name, progress: As for drag.

        Raises:
            InputError: It cannot be done, with the reason; the field is as it was.
            CalledOffError: It was called off.
        """
        settings = self.settings if settings is None else settings
        before = self._measured
        self._called_off.clear()

        def tell(step: int, steps: int, row: dict[str, Any]) -> None:
            if self._called_off.is_set():
                raise CalledOffError("The edit was called off; the field is as it was before it.")
            if progress is not None:
                progress(step, steps, row)

        try:
            settings = settled(settings, tool, self.field, handles, self.surface)
            edit = run_tool(
                tool,
                self.field,
                handles,
                settings,
                quadrature=before.quadrature,
                codes=self.source.codes,
                progress=tell,
            )
            if not edit.history:
                raise InputError(f"{edit.status.value} No step could be taken, and the field is as it was.")
            after = self._measure(edit.field)
            evidence = Evidence.of(before.surface, edit)
        except (ValueError, TypeError, RuntimeError) as error:
            raise _in_words(error) from error
        number = self.position + 1
        entry = Entry(
            number,
            name or f"{tool} {number}",
            tool,
            tuple(handles),
            settings,
            edit.status.value,
            tuple(edit.notes),
            edit.status in COMPLETE,
            False,
            edit.seconds,
            _numbers(self.source, before, after, evidence),
            digest(edit.field),
        )
        self._take(entry, before, after, evidence)
        return self.entries[-1]

    def call_off(self) -> None:
        """Call off the edit that another thread is at, before its next step."""
        self._called_off.set()

    def judge(self) -> Entry:
        """Return the last edit with pieces and handles of the surface counted on fine cells, its status amended.

        Raises:
            InputError: No edit stands.
        """
        if self.position == 0:
            raise InputError("There is no edit to judge.")
        entry = self.entries[self.position - 1]
        if entry.judged or self._last is None or self._last[0] != self.position:
            return entry
        _, before, evidence = self._last
        status, notes = _judged(before.field, evidence)
        entry = replace(entry, status=status.value, notes=notes, done=status in COMPLETE, judged=True)
        self.entries[self.position - 1] = entry
        self._save()
        return entry

    # What it takes back

    def undo(self) -> Entry:
        """Take the last edit back and return it; the field is as it was before, to the bit.

        Raises:
            InputError: None stands.
        """
        if self.position == 0:
            raise InputError("There is nothing to undo.")
        self._stand_at(self.position - 1)
        return self.entries[self.position]

    def redo(self) -> Entry:
        """Do the edit again that was taken back last, and return it.

        Raises:
            InputError: There is none.
        """
        if self.position == len(self.entries):
            raise InputError("There is nothing to redo.")
        self._stand_at(self.position + 1)
        return self.entries[self.position - 1]

    def rename(self, number: int, name: str) -> Entry:
        """Give an edit another name.

        Raises:
            InputError: There is no such edit, or the name is empty.
        """
        entry = renamed(self.entry(number), name)
        self.entries[number - 1] = entry
        self._save()
        return entry

    def entry(self, number: int) -> Entry:
        """Return an edit by its number.

        Raises:
            InputError: There is none.
        """
        if number not in range(1, len(self.entries) + 1):
            raise InputError(f"There is no edit {number}; there are {len(self.entries)}.")
        return self.entries[number - 1]

    def field_before(self, number: int) -> implicit.Field:
        """Return the field before an edit."""
        return self._fields[self.entry(number).number - 1]

    def field_file(self, number: int) -> Path | None:
        """Return the file of the field after so many edits, 0 for the start; None if none describes it."""
        if self._folder is None or not self._folder.is_described(number):
            return None
        return self._folder.field_path(number)

    def replay(self, progress: Progress | None = None) -> EditSession:
        """Return a session in memory with the same shape in which all edits that stand were done again.

        Raises:
            InputError: An edit cannot be done again.
        """
        again = EditSession(self.source, None, self.settings, drawn=self.drawn)
        for entry in self.history:
            again.do(entry.handles, entry.tool, entry.settings, name=entry.name, progress=progress)
        return again

    def evidence(self) -> Evidence | None:
        """Return the evidence of the last edit that stands; None if it is not the one that was made last."""
        return self._last[2] if self._last is not None and self._last[0] == self.position else None

    # Within

    def _take(self, entry: Entry, before: Measured, after: Measured, evidence: Evidence) -> None:
        del self.entries[self.position :]
        del self._fields[self.position + 1 :]
        self.entries.append(entry)
        self._fields.append(after.field)
        self.position += 1
        self._measured = after
        self._last = (self.position, before, evidence)
        try:
            if self._folder is not None:
                self._folder.write_field(self.position, after.field, self.source)
                self._folder.write_handles(entry)
            self._save()
        except OSError as error:  # a full disk, say: the edit stands all the same
            kept = f"The edit is not on disk, and would be lost with this process: {error}"
            self.entries[-1] = replace(entry, notes=(*entry.notes, kept))

    def _stand_at(self, position: int, *, save: bool = True) -> None:
        # To measure it first leaves all as it is where it cannot be.
        if self._last is not None and self._last[0] == position + 1:
            measured = self._last[1]
        else:
            measured = self._measure(self._fields[position])
        self.position, self._measured = position, measured
        if save:
            self._save()

    def _save(self) -> None:
        if self._folder is not None:
            self._folder.write(self.source, self.entries, self.position)

    def _measure(self, field: implicit.Field) -> Measured:
        meshed = meshed_quadrature(field, self.drawn)
        quadrature = meshed.sample
        N = field.normal(meshed.vertices).double().numpy()
        V, F = meshed.vertices.double().numpy(), meshed.faces.numpy()
        surface = Surface(V, F, N, meshref.vertex_areas(V, F))
        volume, area = implicit.Volume().value(field, quadrature), float(quadrature.weights.sum())
        return Measured(field, surface, quadrature, volume, area, meshref.component_count(V, F))

    def _grip(self, picked: Picked, motion: Motion) -> Triple:
        """Return where the place by which a region is held is on the surface, once the motion is done."""
        if picked.role == "held":
            return picked.grip
        start = torch.tensor([picked.grip], dtype=self.field.dtype)
        goal = start + torch.tensor([motion.translation], dtype=self.field.dtype)
        if motion.along != 0:
            goal = start + motion.along * self.field.normal(start)
        found, arrived = newton_to_surface(self.field, goal, reach=0.25 * self.field.size)
        if not bool(arrived.all()):
            V = self.surface.V
            found = torch.from_numpy(V[((V - goal.double().numpy()) ** 2).sum(axis=1).argmin()][None])
        x, y, z = found[0].tolist()
        return (x, y, z)


def _measures(source: Source, measured: Measured) -> dict[str, float]:
    scale = source.field.units.scale
    row = {
        "volume": measured.volume * scale**3,
        "area": measured.area * scale**2,
        "pieces": float(measured.pieces),
    }
    if source.codes is not None and len(source.codes) > 1 and measured.field.takes_code:
        prior = prior_of(source.codes)
        row["prior_distance"] = prior.distance(measured.field.theta[: len(prior.mean)])
    return row


def _numbers(source: Source, before: Measured, after: Measured, evidence: Evidence) -> dict[str, Any]:
    old, new = _measures(source, before), _measures(source, after)
    row: dict[str, Any] = {name: [old[name], new[name]] for name in new}
    if evidence.missed is not None:
        row["missed"] = evidence.missed
    return row


def _judged(before: implicit.Field, evidence: Evidence) -> tuple[EditStatus, tuple[str, ...]]:
    """Return status and notes of an edit by what is missed between its points, and by pieces counted on fine cells."""
    edit = evidence.edit
    coarse = () if edit.before is None or edit.after is None else changes(edit.before, edit.after)
    notes = [note for note in edit.notes if note not in coarse]
    ended = edit.status
    if ended in OF_SOUNDNESS:  # which is what is judged anew
        ended = edit_status(EditStatus.DONE, reached=reached_target(edit))
    if edit.asked is not None and evidence.missed is not None and evidence.missed > REACHED_SHARE:
        ended = edit_status(ended, reached=False)
        notes.append(
            f"On the drawn surface {100 * evidence.missed:.2g} % of the target is missed; more points or steps come "
            "closer."
        )
    try:
        old, new = confirmed(
            field_soundness(before, FINE), field_soundness(edit.field, FINE), (before, edit.field), FINE
        )
    except implicit.SurfaceError as error:
        status = edit_status(ended, meshed=False)
        return status, (*notes, f"The surface cannot be meshed on fine cells: {error}")
    status = edit_status(ended, more_pieces=new.pieces > old.pieces, other_type=has_changed(old, new))
    return status, (*notes, *changes(old, new))


def _source_of(kept: Folder, row: dict[str, Any], shape: str | None, module: str | None) -> Source:
    """Return what a saved session began with."""
    opening: Opening = replace(row["opening"], module=module)
    if row["opening"].module is not None and module is None:
        raise InputError(
            f"{kept.path} says that {row['opening'].module} builds the network of its field. No code is run because a "
            "file names it: if you trust that code, name it yourself, --module on the command line."
        )
    codes = None
    if kept.is_described(0):
        try:
            start = implicit.load_field(kept.field_path(0), module=module)
        except (ValueError, TypeError, OSError) as error:
            raise InputError(str(error)) from error
        if row["kind"] in ("family", "checkpoint"):
            codes = open_source(row["shape"], opening).codes
    else:
        if row["kind"] == "code" and shape is None:
            raise InputError(
                f"{kept.path} holds a session of {row['shape']}, your own code. No code is run because a file names "
                "it: if you trust it, name it as the shape."
            )
        source = open_source(row["shape"], opening)
        start, codes = source.field.with_theta(kept.read_theta_of(0, source.field)), source.codes
    return Source(row["shape"], opening, start, row["kind"], codes, tuple(row["notes"]))


def _in_words(error: Exception) -> InputError:
    """Return what a user reads of an error: the house's own sentence, or one round what a library said."""
    if isinstance(error, InputError):
        return error
    if isinstance(error, ValueError | TypeError):
        return InputError(str(error))
    first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    return InputError(f"The edit could not be computed, and the field is as it was ({first}). Take a smaller drag.")
