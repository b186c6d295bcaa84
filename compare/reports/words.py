"""Handles and edits in words, in the units of the shape's file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from compare.cases.handles import HandleSpec
from compare.runs.columns import percentage
from compare.runs.records import Record

DIGITS = 3


def handle_in_words(handle: HandleSpec, scale: float = 1.0, offset: Sequence[float] = (0.0, 0.0, 0.0)) -> str:
    """Return what a handle does, a sentence.

    Args:
        handle: In a field's coordinates x.
        scale, offset: Of the user's, in which it is said: scale * x + offset.
    """
    back = 1 / scale, [-x / scale for x in offset]
    of_user = handle.in_field(*back)
    motion, region = of_user.motion, _region(of_user.region)
    if handle.holds:
        return f"Holds {region}."
    if motion["kind"] == "vector":
        return f"Moves {region} by {place(motion['vector'])}, a length of {length(np.linalg.norm(motion['vector']))}."
    if motion["kind"] == "along":
        way = "outwards" if motion["distance"] >= 0 else "inwards"
        return f"Moves {region} {way} along its normals by {length(abs(motion['distance']))}."
    return f"Moves {region} rigidly: {_rigid(motion)}."


def asked(record: Record) -> str:
    """Return what the case asked for, a sentence in lengths rather than places."""
    case = record.case
    if not case.handles:
        return (
            _flow(case.parameters) if case.operation == "smooth" else f"Asked: an edit of the kind {case.operation!r}."
        )
    longest = max(record.subject.get("sides") or [0.0])
    scale = float(record.subject.get("scale") or 1.0)
    moving = [h for h in case.handles if not h.holds]
    held = len(case.handles) - len(moving)
    parts = [_pull(handle, scale, longest) for handle in moving]
    parts += [f"hold {_count(held, 'part', 'parts')} in place"] if held else []
    rest = {"geometric": "keep the rest as it is", "rigid": "bend what lies between as little as possible"}
    parts += [rest[case.operation]] if case.operation in rest else []
    return f"Asked: to {_joined(parts)}."


def place(point: Sequence[float]) -> str:
    """Return a point or a vector as one writes it."""
    return f"({', '.join(length(x) for x in point)})"


def length(value: Any) -> str:
    """Return a number with few digits and without powers of ten where it is of ordinary size."""
    value = float(value)
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e6:
        return f"{float(f'{value:.{DIGITS}g}'):.10g}".replace("-", "\u2212")
    return f"{value:.{DIGITS}g}".replace("-", "\u2212")


def _region(region: Mapping[str, Any]) -> str:
    within = f"what lies within {length(region.get('radius', 0))} of "
    words = {
        "ball": lambda r: within + place(r["center"]),
        "box": lambda r: f"what lies in the box from {place(r['lower'])} to {place(r['upper'])}",
        "halfspace": lambda r: f"what lies beyond {place(r['point'])} in the direction {place(r['normal'])}",
        "points": lambda r: within + _count(len(r["points"]), "point", "points"),
        "nearest": lambda r: f"{within}the surface's nearest place to {place(r['point'])}",
        "vertices": lambda r: within + _count(len(r["vertices"]), "vertex", "vertices"),
    }
    kind = str(region["kind"])
    said = words[kind](region) if kind in words else f"a region of the kind {kind}"
    return f"{said} (sinking to nothing over {length(region['falloff'])} more)" if region.get("falloff") else said


def _rigid(motion: Mapping[str, Any]) -> str:
    said = []
    angle = float(np.degrees(np.linalg.norm(motion.get("rotation", 0.0))))
    if angle:
        axis = np.asarray(motion["rotation"]) / np.radians(angle)
        said.append(f"turned by {angle:.3g}° about {place(axis)} through {place(motion.get('center', [0.0] * 3))}")
    if np.any(motion.get("translation", 0.0)):
        said.append(f"shifted by {place(motion['translation'])}")
    return ", then ".join(said) or "by nothing"


def _pull(handle: HandleSpec, scale: float, longest: float) -> str:
    motion = handle.motion
    if motion["kind"] == "rigid":
        angle = float(np.degrees(np.linalg.norm(motion.get("rotation", 0.0))))
        shift = scale * float(np.linalg.norm(motion.get("translation", 0.0)))
        said = [f"turn a part by {angle:.3g}°"] if angle else []
        by = _sized(shift, longest)
        return " and ".join([*said, *([f"shift {'it' if angle else 'a part'} by {by}"] if shift or not angle else [])])
    if motion["kind"] == "along":
        size, way = scale * abs(motion["distance"]), "out" if motion["distance"] >= 0 else "in"
        return f"move a part {way} along its normals by {_sized(size, longest)}"
    return f"move a part by {_sized(scale * float(np.linalg.norm(motion['vector'])), longest)}"


def _sized(size: float, longest: float) -> str:
    return length(size) + (f" ({percentage(size / longest)} of the longest side)" if longest else "")


def _flow(parameters: Mapping[str, Any]) -> str:
    steps, step = parameters.get("steps"), parameters.get("step_size")
    time = f" for a time of {length(steps * step)} (in {steps} steps)" if steps and step else ""
    return f"Asked: to let the surface flow by its mean curvature{time}, with its volume held."


def _count(number: int, one: str, many: str) -> str:
    return f"one {one}" if number == 1 else f"{number} {many}"


def _joined(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
