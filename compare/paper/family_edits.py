"""The semantic edits that the figures and studies share: which region of which model goes where.

A chair's front leg at +x is made shorter or longer; an airplane's wing at +x is made longer; and, which no airplane of
the family can do, the wing at +x longer and the other shorter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import implicit
from implicit import families

AMOUNT = 0.12  # of each edit, in the family's units


@dataclass(frozen=True, eq=False)
class FamilyEdit:
    """Regions of a shape and where they are to go."""

    name: str
    model: families.FamilyModel
    shape: int  # row of the model's tables
    handles: tuple[implicit.Handle, ...]

    @property
    def field(self) -> implicit.Field:
        """Field of the shape before."""
        return self.model.field(self.model.latents[self.shape].clone())

    def points(self, count: int = 100) -> tuple[Tensor, Tensor]:
        """Return prescribed points and their displacements, in the field's units."""
        return implicit.prescribe(self.field, self.handles, count)

    def free_points(self, count: int = 1000) -> Tensor:
        """Return points outside the regions."""
        points = implicit.sample_surface(self.field, count).points
        return points[torch.stack([handle.weights(points) for handle in self.handles]).amax(dim=0) == 0]

    def parameters_after(self, field: implicit.Field, resolution: int = 96) -> dict[str, float]:
        """Return the family's parameters of an edited shape, by the nearest member."""
        V, _ = implicit.extract_mesh(field, resolution)
        scale, dtype = self.model.scale, field.dtype
        nearest, _ = self.model.family.nearest(
            lambda x: field.value((x * scale).to(dtype)) < 0,
            torch.from_numpy(V) / scale,
            self.model.parameters[self.shape],
        )
        return dict(zip(self.model.family.parameters, nearest.tolist(), strict=True))

    def parameters_before(self) -> dict[str, float]:
        """Return the parameters that the shape was learned from."""
        return dict(zip(self.model.family.parameters, self.model.parameters[self.shape].tolist(), strict=True))


def chair_leg(model: families.FamilyModel, shape: int | None = None, amount: float = AMOUNT) -> FamilyEdit:
    """Return the edit that makes one leg shorter by the amount; by default of the shape nearest to the middle."""
    shape = _middle(model) if shape is None else shape
    p = dict(zip(model.family.parameters, model.parameters[shape].tolist(), strict=True))
    x, z, foot = p["seat_width"] / 2, p["seat_depth"] / 2, -p["seat_thickness"] - p["leg_length"]
    thick = p["leg_thickness"]
    region = _box(model, (x - thick - 0.05, foot - 0.05, z - thick - 0.05), (x + 0.05, foot + 0.06, z + 0.05))
    name = "one leg shorter" if amount > 0 else "one leg longer"
    return FamilyEdit(name, model, shape, (implicit.Handle(region, (0.0, amount * model.scale, 0.0)),))


def longer_wing(model: families.FamilyModel, shape: int | None = None, amount: float = AMOUNT) -> FamilyEdit:
    """Return the edit that makes the wing at +x longer by the amount."""
    shape = _middle(model) if shape is None else shape
    return FamilyEdit("one wing longer", model, shape, (_wing_tip(model, shape, 1, amount),))


def uneven_wings(model: families.FamilyModel, shape: int | None = None, amount: float = AMOUNT) -> FamilyEdit:
    """Return the edit that makes the wing at +x longer and the other shorter, by the same amount."""
    shape = _middle(model) if shape is None else shape
    tips = tuple(_wing_tip(model, shape, side, amount) for side in (1, -1))
    return FamilyEdit("one wing longer, one shorter", model, shape, tips)


def leg_ends(model: families.FamilyModel, field: implicit.Field, resolution: int = 128) -> np.ndarray:
    """Return the lowest y of the four legs (+x+z, +x-z, -x+z, -x-z) on the extracted mesh, in the family's units."""
    V = implicit.extract_mesh(field, resolution)[0] / model.scale
    sides = [(x, z) for x in (1, -1) for z in (1, -1)]
    return np.array([V[(V[:, 0] * x > 0.1) & (V[:, 2] * z > 0.1), 1].min() for x, z in sides])


def wing_ends(model: families.FamilyModel, field: implicit.Field, resolution: int = 128) -> np.ndarray:
    """Return how far the wings reach (+x, -x) on the extracted mesh, in the family's units."""
    V = implicit.extract_mesh(field, resolution)[0] / model.scale
    return np.array([V[:, 0].max(), -V[:, 0].min()])


def _wing_tip(model: families.FamilyModel, shape: int, side: int, amount: float) -> implicit.Handle:
    tip = float(model.parameters[shape, model.family.parameters.index("wing_span")]) / 2
    inner, outer = sorted((side * (tip - 0.04), side * 1.0))
    region = _box(model, (inner, -0.2, -1.0), (outer, 0.2, 1.0))
    return implicit.Handle(region, (amount * model.scale, 0.0, 0.0))


def _box(
    model: families.FamilyModel, lower: tuple[float, float, float], upper: tuple[float, float, float]
) -> implicit.Box:
    return implicit.Box([model.scale * c for c in lower], [model.scale * c for c in upper])


def _middle(model: families.FamilyModel) -> int:
    return model.nearest(torch.tensor(list(model.family.ranges.values())).double().mean(dim=1))
