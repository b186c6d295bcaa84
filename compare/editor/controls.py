"""The controls beside the picture: what can be set, pressed and read on the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import viser

from compare.editor.exports import MESHES
from compare.editor.mesh_side import METHODS
from compare.editor.session import EditSession
from compare.editor.tools import Tool

PICKS = ("ball", "brush", "box", "half-space", "beyond a stroke")
HINTS = {
    "ball": "Click the shape: a ball about the place.",
    "brush": "Click, or hold Shift and drag over the shape: balls about all these places.",
    "box": "Click two corners of a box.",
    "half-space": "Click a place: everything beyond the plane that touches it moves.",
    "beyond a stroke": "Click both ends of a stroke: everything to its left moves.",
}
ROLES = ("moves", "held")
VIEWS = ("shape", "achieved minus wanted", "cannot be made")
NOTHING_BESIDE = "nothing"

# What a hand does, and which tool of a session that is.
DRAG, NORMAL, RIGID, SMOOTH, SEMANTIC = "drag", "along the normal", "drag rigidly", "smooth", "drag the code"
TOOL_OF: dict[str, Tool] = {
    DRAG: "geometric",
    NORMAL: "geometric",
    RIGID: "rigid",
    SMOOTH: "smooth",
    SEMANTIC: "semantic",
}
# Which of them the gizmo does.
BY_GIZMO = (DRAG, RIGID, SEMANTIC)


@dataclass
class Controls:
    """The controls, by what they are for."""

    status: Any
    progress: Any
    cancel: Any
    numbers: Any
    pick: Any
    hint: Any
    role: Any
    radius: Any
    falloff: Any
    forget: Any
    tool: Any
    distance: Any
    factor: Any
    apply: Any
    volume: Any
    area: Any
    points: Any
    steps: Any
    view: Any
    scale: Any
    before: Any
    beside: Any
    energies: Any
    history: Any
    undo: Any
    redo: Any
    which: Any
    name: Any
    rename: Any
    replay: Any
    file_type: Any
    export: Any
    dark: Any


def controls_of(gui: viser.GuiApi, session: EditSession) -> Controls:
    """Return the controls of a session, put on the page."""
    size = session.field.size
    parts: dict[str, Any] = {"status": gui.add_markdown("Pick a region on the shape.")}
    parts["progress"] = gui.add_progress_bar(0.0, visible=False)
    parts["cancel"] = gui.add_button("Cancel", visible=False, icon=viser.Icon.X, color="red")
    parts["numbers"] = gui.add_markdown("")
    with gui.add_folder("Pick"):
        parts |= _picking(gui, size)
    with gui.add_folder("Edit"):
        parts |= _editing(gui, session, size)
    with gui.add_folder("Look"):
        parts |= _looking(gui)
    with gui.add_folder("History"):
        parts |= _history(gui)
    with gui.add_folder("Export", expand_by_default=False):
        types = [*MESHES, "field", "script", "handles", "case"]
        parts["file_type"] = gui.add_dropdown("What", types, hint="Meshes and handles in the units of the shape's file")
        parts["export"] = gui.add_button("Download", icon=viser.Icon.DOWNLOAD)
        parts["dark"] = gui.add_checkbox("Dark page", False)
    return Controls(**parts)


def _picking(gui: viser.GuiApi, size: float) -> dict[str, Any]:
    return {
        "pick": gui.add_dropdown("By", PICKS),
        "hint": gui.add_markdown(HINTS["ball"]),
        "role": gui.add_dropdown("Region", ROLES, hint="Whether it goes with the hand, or is held"),
        "radius": gui.add_slider("Radius", 0.005 * size, 0.25 * size, 0.0025 * size, 0.05 * size),
        "falloff": gui.add_slider("Falloff", 0.0, 0.25 * size, 0.0025 * size, 0.08 * size),
        "forget": gui.add_button("Forget regions", icon=viser.Icon.ERASER),
    }


def _editing(gui: viser.GuiApi, session: EditSession, size: float) -> dict[str, Any]:
    tools = [name for name in TOOL_OF if name != SEMANTIC or session.field.takes_code]
    first = SEMANTIC if session.field.takes_code else DRAG
    return {
        "tool": gui.add_dropdown("Tool", tools, initial_value=first),
        "distance": gui.add_slider("Outward", -0.1 * size, 0.1 * size, 0.001 * size, 0.02 * size, visible=False),
        "factor": gui.add_slider("Scale", 0.5, 2.0, 0.05, 1.0, hint="By which the drag scales the region"),
        "apply": gui.add_button("Apply", icon=viser.Icon.CHECK, visible=False),
        "volume": gui.add_checkbox("Hold the volume", False),
        "area": gui.add_checkbox("Hold the area", False),
        "points": gui.add_dropdown("Points", ("500", "1000", "2000"), hint="More come closer between them"),
        "steps": gui.add_dropdown("Steps", ("auto", "3", "8", "16"), hint="auto takes more for a longer drag"),
    }


def _looking(gui: viser.GuiApi) -> dict[str, Any]:
    return {
        "view": gui.add_dropdown("Colours", VIEWS),
        "scale": gui.add_html("", visible=False),
        "before": gui.add_slider("Before to after", 0.0, 1.0, 0.01, 1.0, disabled=True),
        "beside": gui.add_dropdown("Beside", (NOTHING_BESIDE, *METHODS), hint="The same handles on a mesh"),
        "energies": gui.add_markdown(""),
    }


def _history(gui: viser.GuiApi) -> dict[str, Any]:
    return {
        "undo": gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, disabled=True),
        "redo": gui.add_button("Redo", icon=viser.Icon.ARROW_FORWARD_UP, disabled=True),
        "history": gui.add_markdown("Nothing was done yet."),
        "which": gui.add_dropdown("Edit", ("none",), visible=False),
        "name": gui.add_text("Name", "", visible=False),
        "rename": gui.add_button("Rename", visible=False),
        "replay": gui.add_button("Play again from the start", visible=False, icon=viser.Icon.PLAYER_PLAY),
    }


def history_text(session: EditSession) -> str:
    """Return the table of edits, those undone struck out."""
    if not session.entries:
        return "Nothing was done yet."
    rows = ["| | edit | s | missed |", "|---|---|---|---|"]
    for entry in session.entries:
        missed = entry.numbers.get("missed")
        share = "" if missed is None else f"{100 * missed:.2g} %"
        name = entry.name.replace("|", "/")
        name = name if entry.number <= session.position else f"~~{name}~~"
        rows.append(f"| {entry.number} | {name} | {entry.seconds:.1f} | {share} |")
    return "\n".join(rows)


def numbers_text(now: dict[str, float], start: dict[str, float]) -> str:
    """Return volume, area and pieces as they are, with their change since the start."""
    rows = ["| | now | since the start |", "|---|---|---|"]
    for name in ("volume", "area"):
        change = 100 * (now[name] / start[name] - 1) if start[name] else 0.0
        rows.append(f"| {name} | {now[name]:.5g} | {change:+.2f} % |")
    rows.append(f"| pieces | {now['pieces']:.0f} | {now['pieces'] - start['pieces']:+.0f} |")
    if "prior_distance" in now:
        further = now["prior_distance"] - start["prior_distance"]
        rows.append(f"| code from those of training (deviations) | {now['prior_distance']:.3g} | {further:+.2g} |")
    return "\n".join(rows)


def options_of(entries: Sequence[Any]) -> tuple[str, ...]:
    """Return what the list of edits offers."""
    return tuple(f"{entry.number}: {entry.name}" for entry in entries) or ("none",)
