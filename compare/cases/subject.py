"""The shape of a case, made ready: a field, and the common mesh on its surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field as default
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

if TYPE_CHECKING:  # torch takes seconds to import
    from implicit import Field, Integral


@dataclass(frozen=True, eq=False, repr=False)
class Subject:
    """A field, its surface as a mesh, and how they came about."""

    field: Field
    V: Float[ndarray, "n 3"]  # on the surface, in the field's coordinates
    F: Int[ndarray, "m 3"]
    N: Float[ndarray, "n 3"]  # the field's outward normals at V
    notes: tuple[str, ...] = ()  # sentences: what was mended, what the fit says of itself
    fit: Mapping[str, Any] | None = None
    seconds: Mapping[str, float] = default(default_factory=dict)
    resolution: int = 0  # cells along the bounds at which the field's surface is whole, where the case's are too few

    def __repr__(self) -> str:
        """Return the sizes of field and mesh in one line."""
        fit = "" if self.fit is None else f", fit {'good' if self.fit.get('good') else 'below the stated quality'}"
        return (
            f"Subject(field of {self.field.theta.numel()} parameters, common mesh of {len(self.V)} vertices and "
            f"{len(self.F)} faces, scale {self.scale:.6g}{fit}, {len(self.notes)} notes)"
        )

    def cells(self, resolution: int) -> int:
        """Return the cells to extract the surface with, where a case has so many: these, or as many as it needs."""
        return max(resolution, self.resolution)

    @cached_property
    def integrals(self) -> tuple[Integral, ...]:
        """Volume and area of the field itself, with their errors, measured once for all cases."""
        return volume_and_area(self.field)

    @property
    def scale(self) -> float:
        """Number of the user's units in a unit of the field."""
        return float(self.field.units.scale)

    def to_user(self, points: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        """Return points of the field in the user's units."""
        return points * self.scale + np.asarray(self.field.units.offset)


def volume_and_area(field: Field) -> tuple[Integral, ...]:
    """Return the two of a field's surface, by fourth-order quadrature, with their errors."""
    import implicit

    return implicit.integrate(field, (implicit.Volume(), implicit.Area()))
