"""The evidence of an edit at the vertices that were drawn before it: where they went, and what was missed there.

The points that carry an edit's target say little of the places between them. The drawn vertices are others, and many,
so what is missed is told at these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

import implicit
from compare.editor.linear import Surface
from implicit.surface.projection import newton_to_surface

# Of edits that say what they asked at their own points alone: how many of these tell of a vertex.
NEAREST = 4


@dataclass(frozen=True, eq=False)
class Evidence:
    """An edit at the vertices drawn before it.

    Attributes:
        before: The surface as it was drawn.
        edit: The edit.
        error: Achieved minus wanted motion along the normal over the largest wanted one, at each vertex; NaN where
            nothing was asked.
        missed: Root of the share of the squared target that was missed, at the vertices; None where nothing was asked.
    """

    before: Surface
    edit: implicit.Edit
    error: Float[ndarray, " n"]
    missed: float | None

    @classmethod
    def of(cls, before: Surface, edit: implicit.Edit) -> Evidence:
        """Return the evidence of an edit of a surface."""
        if edit.asked is not None:
            sample = _vertices(before, edit.field)
            error = edit.error_field(sample)
            wanted, _ = edit.asked(sample.points, sample.normals)
            target = (wanted * sample.normals).sum(dim=1)
            return cls(before, edit, error.double().numpy(), _share(error, target, sample.weights))
        asked = torch.isfinite(edit.wanted).all(dim=1)
        if not bool(asked.any()):
            return cls(before, edit, np.full(len(before.V), np.nan), None)
        error = edit.error_field()
        target = (edit.wanted * edit.normals).sum(dim=1)
        near, which = cKDTree(edit.points[asked].double().numpy()).query(before.V)
        far = near > 3 * float(before.areas.max()) ** 0.5 + 0.02 * edit.field.size
        at_vertices = np.where(far, np.nan, error[asked].double().numpy()[which])
        return cls(before, edit, at_vertices, _share(error, target, edit.weights))

    def carried(self) -> Float[ndarray, "n 3"]:
        """Return where the vertices are on the edited surface; those that do not reach it, where they would be."""
        edit, goal = self.edit, self._goal()
        points = torch.from_numpy(goal).to(edit.field.theta)
        found, arrived = newton_to_surface(edit.field, points, reach=0.25 * edit.field.size)
        there: Float[ndarray, "n 3"] = torch.where(arrived[:, None], found, points).double().numpy()
        return there

    def _goal(self) -> Float[ndarray, "n 3"]:
        before, edit = self.before, self.edit
        if edit.asked is not None:
            sample = _vertices(before, edit.field)
            wanted = torch.nan_to_num(edit.asked(sample.points, sample.normals)[0])
            return before.V + wanted.double().numpy()
        own = edit.points.double().numpy()
        near, which = cKDTree(own).query(before.V, k=min(NEAREST, len(own)))
        weight = 1 / np.maximum(near, 1e-9)
        weight /= weight.sum(axis=1, keepdims=True)
        return before.V + (weight[..., None] * edit.displacement.double().numpy()[which]).sum(axis=1)


def _vertices(surface: Surface, field: implicit.Field) -> implicit.SurfaceSample:
    parts = (torch.from_numpy(x).to(field.theta) for x in (surface.V, surface.N, surface.areas))
    return implicit.SurfaceSample(*parts)


def _share(error: torch.Tensor, target: torch.Tensor, weights: torch.Tensor) -> float | None:
    """Return the root of the share of the squared target that an error over the largest target leaves."""
    known = torch.isfinite(error) & torch.isfinite(target)
    largest = target[known].abs().max() if bool(known.any()) else torch.zeros(())
    if float(largest) == 0:
        return None
    missed = float(weights[known] @ error[known].square())
    return (missed / float(weights[known] @ (target[known] / largest).square())) ** 0.5
