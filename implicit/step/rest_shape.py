"""The shape whose energy of finite rotations an edit minimises: a mesh of the surface, in the plane of its inside.

In space the surface is a shell, whose mesh carries the energy. In the plane the curve bounds a domain, whose triangles
do; positions are then (V, 3) with z = 0, and the first vertices are those of the curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from implicit.field.field import Field
from implicit.sensitivity.weak_curvature import FloatArray, WeakSurface
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.local_global import Minimum
from implicit.step.planar_rigidity import EnclosedArea, PlanarSpokesAndRims
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.step.surface_map import SurfaceMap
from implicit.surface.even_mesh import even_mesh
from implicit.surface.planar_domain import planar_domain


@dataclass(frozen=True, eq=False)
class RestShape:
    """A shape before it is deformed.

    Attributes:
        surface: Its surface, whose B vertices are the first of the energy's.
        energy: Of its deformations.
        volume: What it encloses; the area, in the plane.
        laplacian: L over the vertices of the surface alone, those inside where they cost least (B, B).
    """

    surface: WeakSurface
    energy: SpokesAndRims
    volume: EnclosedVolume | EnclosedArea
    laplacian: sparse.csc_array

    @classmethod
    def of(cls, field: Field, count: int) -> RestShape:
        """Return the shape of a field with about so many vertices.

        Raises:
            SurfaceError: There is no surface in the bounds, it leaves them, or it is too fine for so many vertices.
        """
        if field.dimension == 3:
            surface = WeakSurface.of(*even_mesh(field, count))
            energy = SpokesAndRims(surface.vertices, surface.faces)
            return cls(surface, energy, EnclosedVolume(surface.faces, len(surface.vertices)), energy.laplacian)
        domain = planar_domain(field, count)
        of_curve = len(domain.sides)
        planar = PlanarSpokesAndRims(np.pad(domain.vertices, ((0, 0), (0, 1))), domain.triangles)
        curve = WeakSurface(domain.vertices[:of_curve], domain.sides)
        return cls(curve, planar, EnclosedArea(domain.sides), planar.of_curve(of_curve))

    def spread(self, values: FloatArray) -> FloatArray:
        """Return what belongs to the vertices of the surface (B,) or (B, D) for all of the energy's, elsewhere 0."""
        inner = len(self.energy.vertices) - len(values)
        beyond = () if values.ndim == 1 else ((0, 3 - values.shape[1]),)
        return np.pad(values, ((0, inner), *beyond))

    def of_surface(self, positions: FloatArray) -> FloatArray:
        """Return the positions of the vertices of the surface (B, D), of those of all (V, 3)."""
        return positions[: len(self.surface.vertices), : self.surface.dimension]


@dataclass(frozen=True, eq=False)
class Deformation:
    """A shape and where it has been taken: what a further edit goes on from, against the same rest shape.

    Attributes:
        field: The field of the shape at rest: what followers carry along, so that nothing adds up.
        rest: The shape before.
        positions: Of all vertices of its energy (V, 3).
    """

    field: Field
    rest: RestShape
    positions: FloatArray

    @classmethod
    def none(cls, field: Field, rest: RestShape) -> Deformation:
        """Return that of a shape as it is."""
        return cls(field, rest, rest.energy.vertices)

    @cached_property
    def surface(self) -> WeakSurface:
        """The surface as deformed."""
        return WeakSurface(self.rest.of_surface(self.positions), self.rest.surface.faces)

    @cached_property
    def _rotations(self) -> FloatArray:
        return self.rest.energy.rotations(self.positions)

    def carried(self, points: FloatArray) -> FloatArray:
        """Return where points near the shape at rest (N, D) are taken with it."""
        B, D = self.rest.surface.vertices.shape
        rotations = self._rotations[:B, :D, :D]
        return np.asarray(SurfaceMap(self.rest.surface, self.surface.vertices, rotations).at(points))

    def map_to(self, minimum: Minimum) -> SurfaceMap:
        """Return the map of the surface as deformed now to another deformation of the same shape."""
        return self._map(self.surface, minimum.positions, minimum.rotations @ self._rotations.transpose(0, 2, 1))

    def map_from_rest(self, minimum: Minimum) -> SurfaceMap:
        """Return the map of the surface at rest to a deformation of it."""
        return self._map(self.rest.surface, minimum.positions, minimum.rotations)

    def _map(self, start: WeakSurface, positions: FloatArray, rotations: FloatArray) -> SurfaceMap:
        B, D = start.vertices.shape
        return SurfaceMap(start, self.rest.of_surface(positions), rotations[:B, :D, :D])
