"""The direction from which one first looks at a shape."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compare.reports.arrows import arrows_of
from compare.reports.views import ELEVATION, Camera, Up, read_view
from compare.runs.records import Record

FIRST_AZIMUTH = 30.0  # degrees, where nothing says from where to look


def azimuth_of(records: Sequence[Record], folder: Path, up: Up = "y") -> float:
    """Degrees about the axis that is up, from where what moves is seen, and how it moves: not towards the viewer."""
    angles = 15.0 * np.arange(24)
    axes = np.stack([Camera(angle, ELEVATION, up).axes() for angle in angles])
    seen, across = np.zeros(24), np.zeros(24)
    for record in records:
        moves = [0, *(0 if handle.holds else 1 for handle in record.case.handles)]
        if any(moves):
            view = read_view(folder / record.artefacts["before"].path)
            face = np.array(moves)[view.values.astype(int)][view.F].all(axis=1)
            corners = view.V[view.F[face]]
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            visible = np.clip(areas @ axes[:, 2].T, 0, None).sum(axis=0)
            seen += visible / max(float(visible.max()), 1e-300)
            for start, end in arrows_of(record, view):
                on_screen = np.linalg.norm(axes[:, :2] @ (end - start), axis=1)
                across += on_screen / max(float(np.linalg.norm(end - start)), 1e-300)
    if not seen.any():
        return FIRST_AZIMUTH
    return float(angles[np.argmax(seen / seen.max() + across / max(float(across.max()), 1e-300))])
