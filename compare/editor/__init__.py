"""The editor: a session of edits without a viewer, and a page in the browser that drives it."""

from compare.editor.linear import LinearModel, Missed, Preview
from compare.editor.motion import Motion
from compare.editor.regions import ball, beyond_stroke, box, brush, half_space
from compare.editor.session import CalledOffError, EditSession
from compare.editor.source import Opening
from compare.editor.tools import Settings

__all__ = [
    "EditSession", "Opening", "Settings", "Motion", "CalledOffError",
    "ball", "brush", "box", "half_space", "beyond_stroke",
    "LinearModel", "Preview", "Missed",
]  # fmt: skip
