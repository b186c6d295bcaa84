"""Exports of a session: meshes, fields, handles, cases, and a script that does it all again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import implicit
import meshref
from compare.cases.case import BUNDLED, Case
from compare.cases.handles import HandleSpec
from compare.cases.handles_file import handles_text
from compare.editor.history import Entry
from compare.editor.session import EditSession
from compare.errors import InputError
from compare.files import replace_file
from implicit.models.field_file import builder_of

MESHES = (".obj", ".ply", ".stl", ".glb")

# Cells along the longest side of a mesh that is written, unless told otherwise.
RESOLUTION = 128


def export_mesh(session: EditSession, path: Path, resolution: int = RESOLUTION) -> None:
    """Write the surface as a mesh, in the user's units.

    Args:
        session: The session.
        path: A file ending in one of MESHES.
        resolution: Cells along the longest side of the bounds.

    Raises:
        InputError: The ending is another, or the file cannot be written.
    """
    if path.suffix.lower() not in MESHES:
        raise InputError(f"A mesh is written to a file ending in {', '.join(MESHES)}, but it is called {path.name!r}.")
    V, F = implicit.extract_mesh(session.field, resolution, units="user")
    try:
        if path.suffix.lower() != ".glb":
            meshref.write_mesh(path, V, F)
            return
        import trimesh

        content = trimesh.Trimesh(V, F, process=False).export(file_type="glb")
        assert isinstance(content, bytes)
        replace_file(path, content)
    except (meshref.MeshError, OSError) as error:
        raise InputError(str(error)) from error


def export_field(session: EditSession, path: Path) -> None:
    """Write the field as implicit.save_field does.

    Raises:
        InputError: The ending is not .safetensors, or nothing says how the field's module is made.
    """
    if path.suffix != ".safetensors":
        raise InputError(f"A field is written to a file ending in .safetensors, but it is called {path.name!r}.")
    source = session.source
    options: dict[str, Any] = {}
    if source.opening.module is not None:
        built = builder_of(source.shape)
        options = {"builder": source.opening.module, "arguments": {} if built is None else built[1]}
    try:
        implicit.save_field(session.field, path, **options)
    except (TypeError, ValueError, OSError) as error:
        raise InputError(str(error)) from error


def export_handles(session: EditSession, number: int, path: Path) -> None:
    """Write the handles of an edit as `run --handles` takes them, in the coordinates of the shape's file.

    Raises:
        InputError: There is no such edit, or it has no handles.
    """
    entry = session.entry(number)
    if not entry.handles:
        raise InputError(
            f"Edit {number} ({entry.name}) has no handles, for it is a {entry.tool} edit of all the surface."
        )
    units = session.source.field.units
    back = 1 / units.scale, [-x / units.scale for x in units.offset]  # the user's as seen from the field's
    replace_file(path, handles_text([handle.in_field(*back) for handle in entry.handles], "user").encode())


def case_of(session: EditSession, number: int, vertices: int = 4000) -> Case:
    """Return an edit as a case, which `compare.run_case` and studies make on the field and on a mesh.

    Args:
        session: The session.
        number: Of the edit.
        vertices: About how many the common mesh has.

    Raises:
        InputError: No case can say the edit, or the field before it is in no file.
    """
    entry = session.entry(number)
    shape: str
    if number == 1 and session.source.shape in BUNDLED:
        shape = session.source.shape
    else:
        file = session.field_file(number - 1)
        if file is None:
            raise InputError(
                f"A case needs the field before edit {number} in a file. Give the session a folder, or save the field."
            )
        shape = str(file)
    parameters = _parameters(entry, session.source.field.units.scale)
    handles: tuple[HandleSpec, ...] = entry.handles if entry.tool != "smooth" else ()
    module = session.source.opening.module if shape.endswith(".safetensors") else None
    return Case(shape, entry.tool, handles, parameters, vertices, seed=entry.settings.seed, module=module)


def _parameters(entry: Entry, scale: float) -> dict[str, Any]:
    settings = entry.settings
    if entry.tool == "semantic":
        raise InputError("No case can say a semantic edit, for no mesh method has its like. Take the script.")
    if entry.tool != "smooth":
        return {"implicit": {"points": settings.points, "steps": settings.steps}}
    if entry.handles:
        raise InputError("No case can say that only a region is smoothed. Take the script.")
    before, _ = entry.numbers["area"]  # in the user's units, where the time of a step is one of the field's
    return {"steps": settings.steps, "step_size": settings.time * 1e-4 * before / scale**2}


SCRIPT = '''"""Edits of {shape}, as they were made in the editor. Run it to make them again: python {name}"""

from compare import HandleSpec
from compare.editor import EditSession, Opening, Settings

session = EditSession.open({shape!r}{opening}, drawn={drawn})
{edits}
if __name__ == "__main__":
    from pathlib import Path

    from compare.editor.exports import export_field, export_mesh

    export_field(session, Path({stem!r} + ".safetensors"))
    export_mesh(session, Path({stem!r} + ".ply"))
    for entry in session.history:
        print(entry.name, entry.status)
'''


def script(session: EditSession, name: str = "edits.py") -> str:
    """Return a Python script that makes all edits that stand again, with the same result to the bit.

    Args:
        session: The session.
        name: Of the file, for its first line.
    """
    opening = session.source.opening
    words = "" if opening == type(opening)() else f", opening={opening!r}"
    edits = "".join(_call(entry) for entry in session.history)
    stem = f"{Path(session.source.shape).stem.replace(':', '-')}-edited"
    return SCRIPT.format(
        shape=session.source.shape, name=name, opening=words, drawn=session.drawn, edits=edits, stem=stem
    )


def _call(entry: Entry) -> str:
    handles = "".join(f"        HandleSpec({h.region!r}, {h.motion!r}),\n" for h in entry.handles)
    options = f"    {entry.tool!r},\n    {entry.settings!r},\n    name={entry.name!r},\n"
    return f"session.do(\n    [\n{handles}    ],\n{options})\n"
