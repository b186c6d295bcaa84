"""Arrows that show where handles pull, from a place on the surface to where it is to go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.handles import HandleSpec
from compare.cases.placing import said_in_field
from compare.reports.views import View
from compare.runs.records import Record

Arrow = tuple[Float[ndarray, " 3"], Float[ndarray, " 3"]]
NEIGHBOURS = 12  # vertices whose normals are taken together: one alone may stand on an edge


def arrows_of(record: Record, before: View) -> list[Arrow]:
    """Return an arrow for each handle that moves, in the units of the shape's file.

    Args:
        record: Whose handles.
        before: The shape before, with the number of the handle, counted from 1, at each vertex.
    """
    scale = float(record.subject.get("scale") or 1.0)
    offset = [float(x) for x in record.subject.get("offset") or (0.0, 0.0, 0.0)]
    back = 1 / scale, [-x / scale for x in offset]
    found = []
    for number, handle in enumerate(record.case.handles, start=1):
        held = np.flatnonzero(before.values == number)
        if not handle.holds and held.size:
            found.append(_arrow(handle.in_field(*back), before, held))
    return found


def with_handles_in_field(record: Record) -> Record:
    """Return the record with its handles in the field's coordinates, whichever they were given in."""
    if record.case.coordinates == "field" or "scale" not in record.subject:
        return record
    case = said_in_field(record.case, float(record.subject.scale or 1.0), tuple(record.subject.offset))
    return replace(record, case=case)


def _arrow(handle: HandleSpec, before: View, held: ndarray) -> Arrow:
    """Return the arrow of a handle in the coordinates of the view."""
    points = before.V[held]
    center = handle.region.get("center", handle.region.get("points", points))
    middle = np.atleast_2d(np.asarray(center, dtype=float)).mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    start = points[np.argmin(away)]
    motion = handle.motion
    if motion["kind"] == "vector":
        return start, start + np.asarray(motion["vector"], dtype=float)
    if motion["kind"] == "along":
        normal = _normals(before)[held[np.argsort(away)[:NEIGHBOURS]]].sum(axis=0)
        return start, start + motion["distance"] * normal / max(float(np.linalg.norm(normal)), 1e-300)
    from scipy.spatial.transform import Rotation

    center = np.asarray(motion.get("center", [0.0] * 3), dtype=float)
    turned = Rotation.from_rotvec(np.asarray(motion.get("rotation", [0.0] * 3), dtype=float)).apply(start - center)
    return start, turned + center + np.asarray(motion.get("translation", [0.0] * 3), dtype=float)


def _normals(view: View) -> Float[ndarray, "n 3"]:
    """Return outward normals at the vertices, as long as the area round each."""
    corners = view.V[view.F]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(view.V)
    for corner in range(3):
        np.add.at(normals, view.F[:, corner], faces)
    return normals
