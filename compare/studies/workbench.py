"""Shapes of the diagrams, each with the field that is the truth, networks fitted to it, and even meshes on it.

    sphere, torus, capsule  closed forms; the field is the exact distance
    a bundled shape         its network; a file of a field its field; a file of a mesh the fit of a network to it

Everything is made when it is first asked for, and kept; fitted networks in a folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.cases.case import BUNDLED, FIELD_SUFFIX
from compare.errors import Progress
from compare.files import plain, replace_file

if TYPE_CHECKING:
    from implicit import Field

EXACT = ("sphere", "torus", "capsule")
SPHERE_RADIUS = 0.6
CAPSULE = ((-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), 0.25)  # ends of its axis, and radius

# Vertices of the mesh that networks are fitted to, and cells of the grid that meshes are taken from.
TARGET_VERTICES = 16_000
RESOLUTION = 128

# Points nearer to a mesh than this are moved to the surface along the field's own gradient.
NEAR = 0.004

# Steps along the surface by which the nearest point is bettered.
SLIDES = 3


class Workbench:
    """Shapes, meshes and networks that the points of one diagram share.

    Args:
        folder: For fitted networks.
        fit_steps: Steps of training of each.
        batch: Samples in each of these steps.
        target_vertices: Of the mesh that they are fitted to.
        resolution: Cells of the grid from which meshes are taken.
        progress: Called as progress(step, steps, what) in a fit.
    """

    def __init__(
        self,
        folder: Path,
        *,
        fit_steps: int,
        batch: int = 2048,
        target_vertices: int = TARGET_VERTICES,
        resolution: int = RESOLUTION,
        progress: Progress | None = None,
    ) -> None:
        self._folder, self._fit_steps, self._batch = folder, fit_steps, batch
        self.target_vertices, self._resolution, self._progress = target_vertices, resolution, progress
        self._kept: dict[tuple[Any, ...], Any] = {}

    def kept(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """Return what was made for a key, or make it."""
        if key not in self._kept:
            self._kept[key] = make()
        return self._kept[key]

    def field(self, shape: str) -> Field:
        """Return the field that is the truth of a shape, in float64."""
        return self.kept(("field", shape), lambda: self._field(shape))

    def mesh(self, shape: str, vertices: int) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]:
        """Return even triangles with about so many vertices, all on the surface of the field of a shape."""
        from compare.runs.subject import common_mesh

        return self.kept(
            ("mesh", shape, vertices),
            lambda: common_mesh(self.field(shape), vertices, self._resolution)[:2],
        )

    def network(self, shape: str, width: int) -> Field:
        """Return a network of three layers so wide, fitted to a shape, in float64 and in the shape's coordinates."""
        return self.kept(("network", shape, width), lambda: self._network(shape, width))

    def _field(self, shape: str) -> Field:
        import torch

        import implicit
        from implicit.shapes import bundled, capsule, sphere, torus

        if shape in EXACT:
            exact = {"sphere": sphere(SPHERE_RADIUS), "torus": torus(), "capsule": capsule(*CAPSULE)}
            return exact[shape]
        if shape in BUNDLED:
            return bundled(shape).to(torch.float64)
        if Path(shape).suffix.lower() == FIELD_SUFFIX:
            return implicit.load_field(shape).to(torch.float64)
        from compare.fitting.fit import fit_mesh
        from compare.runs.subject import load_mesh

        def make() -> Field:
            V, F, _ = load_mesh(shape)
            return fit_mesh(V, F, progress=self._tell)[0]

        return self._in_file(f"{Path(shape).stem}-itself", make)

    def _network(self, shape: str, width: int) -> Field:
        def make() -> Field:
            return self._fitted(self.field(shape), *self.mesh(shape, self.target_vertices), width)

        return self._in_file(f"{Path(shape).stem}-{width}", make)

    def _fitted(self, field: Field, V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], width: int) -> Field:
        """Fit as compare.fit_mesh does, but to the surface of a field, which is in [-1, 1]^3 and stays where it is."""
        import torch

        from compare.fitting.fit import sample_space
        from implicit.fitting.fit import fit_field

        if np.abs(V).max() > 1:
            raise ValueError("A network is fitted in [-1, 1]^3, but the shape leaves it. Scale it.")
        points = sample_space(V, F, 0)
        tensors = [torch.from_numpy(array) for array in exact_distances(field, V, F, points)]
        options: dict[str, Any] = {"width": width, "steps": self._fit_steps, "batch": self._batch}
        return fit_field(torch.from_numpy(points), *tensors, **options, progress=self._tell)[0]

    def _in_file(self, name: str, make: Callable[[], Field]) -> Field:
        import torch

        import implicit

        stem = self._folder / f"{name}-{self._fit_steps}"
        path, whole = stem.with_suffix(FIELD_SUFFIX), stem.with_suffix(".json")
        if not whole.is_file():
            self._folder.mkdir(parents=True, exist_ok=True)
            implicit.save_field(make(), path)
            replace_file(whole, json.dumps(plain({"steps": self._fit_steps})).encode())
        return implicit.load_field(path).to(torch.float64)

    def _tell(self, step: int, steps: int, _: Any) -> None:
        if self._progress is not None:
            self._progress(step, steps, "fitting a network")


def exact_distances(
    field: Field, V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], points: Float[ndarray, "k 3"]
) -> tuple[Float[ndarray, " k"], Float[ndarray, "k 3"]]:
    """Return signed distances of points to the surface of a field, and the normals there.

    The nearest points of a mesh are moved to the surface and along it; what lies as near to it as the mesh's flat
    triangles do is moved there itself. A fit to the triangles would have their volume: of 16,000 vertices 4e-4 too
    little. Far off, where it decides nothing, the distance is that of the mesh to a part of its edges' sagitta.

    Args:
        field: The field, which need not be a distance.
        V, F: A mesh with its vertices on the surface.
        points: Anywhere.
    """
    import torch

    import implicit
    import meshref

    answer = meshref.SignedDistanceQuery(V, F)(points)
    P = torch.from_numpy(points)
    near = torch.from_numpy(np.abs(answer.distance) < NEAR)
    closest = implicit.project_to_surface(field, torch.where(near[:, None], P, torch.from_numpy(answer.closest)))
    for _ in range(SLIDES):  # to where the surface is square to the way to the point, as far as that is nearer
        normal, way = field.normal(closest), P - closest
        slid = closest + way - (way * normal).sum(dim=1, keepdim=True) * normal
        reach = 0.2 * way.norm(dim=1, keepdim=True) / (slid - closest).norm(dim=1, keepdim=True).clamp(min=1e-300)
        other = implicit.project_to_surface(field, closest + reach.clamp(max=1) * (slid - closest))
        nearer = (P - other).norm(dim=1) < way.norm(dim=1)
        closest = torch.where(nearer[:, None], other, closest)
    distance = (P - closest).norm(dim=1)
    return torch.where(field.value(P) < 0, -distance, distance).numpy(), field.normal(closest).numpy()
