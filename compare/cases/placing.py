"""Handles of a case placed on its shape: from the user's coordinates, by nearest points, by vertices of a mesh file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import MESH_SUFFIXES, Case
from compare.cases.handles import HandleSpec, rounded
from compare.cases.subject import Subject
from compare.errors import InputError


def placed(case: Case, subject: Subject) -> Case:
    """Return the case with handles that the editors can build, in the coordinates of the subject's field.

    Raises:
        InputError: A handle names vertices of a shape that is no mesh file, or that the file has not.
    """
    units = subject.field.units
    handles = case.handles
    if case.coordinates == "user":
        handles = tuple(handle.in_field(units.scale, units.offset) for handle in handles)
    return replace(case, handles=tuple(_placed(h, case, subject) for h in handles), coordinates="field")


def said_in_field(case: Case, scale: float, offset: tuple[float, ...]) -> Case:
    """Return the case with its handles in a field's coordinates, of which the user's are scale * x + offset."""
    if case.coordinates == "field":
        return case
    handles = tuple(handle.in_field(scale, offset) for handle in case.handles)
    return replace(case, handles=handles, coordinates="field")


def _placed(handle: HandleSpec, case: Case, subject: Subject) -> HandleSpec:
    kind = handle.region["kind"]
    rest = {name: handle.region[name] for name in ("radius", "falloff") if name in handle.region}
    if kind == "nearest":
        center = _nearest(np.asarray(handle.region["point"], dtype=float), subject)
        return replace(handle, region={"kind": "ball", "center": rounded(center), **rest})
    if kind == "vertices":
        points = _vertices(case, handle.region["vertices"], subject)
        return replace(handle, region={"kind": "points", "centers": points.tolist(), **rest})
    return handle


def _nearest(point: Float[ndarray, " 3"], subject: Subject) -> Float[ndarray, " 3"]:
    """Return the place of the field's surface nearest to a point; of one far away, to a part of an edge of the mesh."""
    import igl
    import torch

    import implicit

    _, _, found = igl.point_mesh_squared_distance(point[None], subject.V, subject.F)
    on_mesh = torch.from_numpy(np.ascontiguousarray(found.reshape(1, 3)))
    return implicit.project_to_surface(subject.field, on_mesh)[0].double().numpy()


def _vertices(case: Case, numbers: list[int], subject: Subject) -> Float[ndarray, "n 3"]:
    """Return vertices of the mesh file of a case, in the field's coordinates."""
    import meshref

    if Path(case.shape).suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"A handle names vertices of {case.shape}, which is no mesh file. Give it a ball, or a nearest point."
        )
    V, _ = meshref.read_mesh(case.shape)
    if max(numbers) >= len(V):
        raise InputError(f"A handle names vertex {max(numbers)} of {case.shape}, which has {len(V)}, counted from 0.")
    units = subject.field.units
    return (V[numbers] - np.asarray(units.offset)) / units.scale
