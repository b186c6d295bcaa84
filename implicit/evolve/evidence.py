"""What an edit has made of the field: its soundness before and after, in the result and in words."""

from __future__ import annotations

from dataclasses import replace

from implicit.evolve.edit import Edit, EditStatus
from implicit.surface.extraction import SurfaceError
from implicit.surface.soundness import Soundness, changes, field_soundness


def with_evidence(edit: Edit, before: Soundness, resolution: int) -> Edit:
    """The edit with how sound its field was and is."""
    try:
        after = field_soundness(edit.field, resolution)
    except SurfaceError as error:
        notes = (*edit.notes, f"The edited field cannot be meshed as it is: {error}")
        return replace(edit, before=before, notes=notes, status=EditStatus.STRAY_PIECES)
    edit = replace(edit, before=before, after=after, notes=(*edit.notes, *changes(before, after)))
    if edit.status is EditStatus.DONE and after.pieces > before.pieces:
        edit = replace(edit, status=EditStatus.STRAY_PIECES)
    return edit
