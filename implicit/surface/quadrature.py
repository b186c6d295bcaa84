"""Points, normals and weights on the surface, so that an integral over it is a weighted sum.

The quadrature replaces the marching-cubes triangles by six-node curved ones whose corners and mid-edge nodes
all lie on f = 0, and integrates over each by a rule exact for polynomials of degree 4. Its error falls with
the fourth power of the cell (measured on tori); flat triangles would give the second. In the plane the same
is done with three-node curved segments. Where the gradient jumps the cells are first split along the crease, or left
flat, and the order falls to the second.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int, Int8
from torch import Tensor

from implicit.arguments import counted, kind_of
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.creases import edges_of, split_at_creases
from implicit.surface.extraction import LOST, PlacedOnGrid, placed_on_grid
from implicit.surface.marching import Grid
from implicit.surface.projection import discontinuous, in_working_precision, place_on_surface

# Six-point rule of degree 4 on the triangle (Dunavant 1985): two orbits (1 - 2a, a, a) and their weights.
_TRIANGLE_ORBITS = ((0.445948490915965, 0.223381589678011), (0.091576213509771, 0.109951743655322))

# Least slope of a field beside the median, where it is taken to vanish; as in Field.gradient_length.
LEVEL = 1e-7

# A quadrature is kept, or carried along, where its surface has moved by no more than so many cells at PROBED nodes.
KEPT = 1e-4
CARRIED = 1 / 8
PROBED = 500

# A middle node farther from the middle of its chord than this share of it makes no cell that follows the surface: an
# edge over half a circle has its middle there. On a mesh with creases the gradient may lead a middle astray, along the
# surface: there an edge stays straight from where it would follow a quarter of a circle.
MOST_BULGE = 0.5
MOST_BULGE_BY_CREASES = 0.1


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Points on the surface with outward unit normals and quadrature weights.

    sum(weights) is the area (the length, in the plane), and sum(weights * g(points)) the integral of g.

    Attributes:
        points: Points (N, D) in the field's coordinates.
        normals: Outward unit normal at each.
        weights: Area (or length) that each stands for.

    Raises:
        ValueError: The shapes of the three do not fit each other.
    """

    points: Float[Tensor, "n d"]
    normals: Float[Tensor, "n d"]
    weights: Float[Tensor, " n"]

    def __post_init__(self) -> None:
        if self.normals.shape != self.points.shape or self.weights.shape != self.points.shape[:1]:
            raise ValueError(
                f"normals and weights must fit the {len(self.points)} points, of shapes {tuple(self.points.shape)} and "
                f"{tuple(self.points.shape[:1])}, but have {tuple(self.normals.shape)} and {tuple(self.weights.shape)}."
            )

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        n, dimension = self.points.shape
        content = "area" if dimension == 3 else "length"
        sum_of_weights = f"{content} {float(self.weights.sum()):.6g}"
        return f"SurfaceSample: {counted(n, 'point')} in {dimension}D, {sum_of_weights} ({kind_of(self.points)})"

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> SurfaceSample:
        """Return the same sample in another precision or on another device."""
        parts = (self.points, self.normals, self.weights)
        return SurfaceSample(*(part.to(dtype=dtype, device=device) for part in parts))

    def integrate(self, density: Float[Tensor, " n"]) -> float:
        """Return the integral over the surface of a density given at the points, (N,)."""
        return float(self.weights @ density)


def require_sample(field: Field, sample: SurfaceSample) -> SurfaceSample:
    """Return the sample as given, or refuse what is no sample of this field's surface."""
    require_field(field)
    if not isinstance(sample, SurfaceSample):
        raise TypeError(
            f"sample must be a SurfaceSample, but is a {type(sample).__name__}. Make one with surface_quadrature or "
            "sample_surface."
        )
    field.require_points(sample.points, "sample.points")
    return sample


@dataclass(frozen=True, eq=False)
class CurvedCells:
    """Quadratic cells by the places that they share.

    Attributes:
        places: Corners of the cells, then middles of their edges, each once (K, D).
        index: The nodes of each cell among these: six of a triangle, or in the plane three of a segment.
        slopes: |df/dx| at the places, or near (K,); None where the cells were split along creases, across which it
            jumps and which share no middles.
    """

    places: Float[Tensor, "k d"]
    index: Int[Tensor, "m n"]
    slopes: Float[Tensor, " k"] | None

    @property
    def nodes(self) -> Float[Tensor, "m n d"]:
        """Nodes of each cell."""
        return self.places[self.index]

    def slopes_at_points(self) -> Float[Tensor, " q"] | None:
        """Return about |df/dx| at the points of the quadrature, no less than the least at a cell's nodes.

        None where it is not known, or vanishes.
        """
        if self.slopes is None or not bool((self.slopes > LEVEL * self.slopes.median()).all()):
            return None
        shape, _, _ = _segment_rule() if self.places.shape[1] == 2 else _triangle_rule()
        at_nodes = self.slopes[self.index]
        least = functools.reduce(torch.minimum, at_nodes.unbind(dim=1))  # amin over few neighbours in memory is slow
        return torch.maximum(at_nodes @ shape.to(at_nodes).T, least[:, None]).flatten()


Entered = tuple[Int[Tensor, "n d"], Float[Tensor, "n d"]]  # cells, and a point of the surface in each


@dataclass(frozen=True, eq=False)
class MeshedSample:
    """A quadrature, the mesh whose cells it came from, and the grid that this was marched on."""

    sample: SurfaceSample
    vertices: Float[Tensor, "v d"]  # on the surface
    faces: Int[Tensor, "m d"]  # corners of the cells
    grid: Grid
    signs: Int8[Tensor, "*nodes"]  # of f at the nodes of the grid, zero where the surface is far
    curved: CurvedCells | None = None  # the cells beneath the quadrature
    slopes: Float[Tensor, " q"] | None = None  # about |df/dx| at its points, where that is known
    refined: int = 0  # cells of the grid that the quadrature has finer than the mesh
    entered: Entered | None = None  # cells of one sign with the surface in them, where these have been looked for

    def __repr__(self) -> str:
        cells = counted(len(self.faces), "triangle" if self.faces.shape[1] == 3 else "segment")
        return f"MeshedSample: {cells} on {len(self.vertices):,} vertices\n  {self.sample!r}"


def surface_quadrature(field: Field, resolution: int = 64, *, exact_points: bool = False) -> SurfaceSample:
    """Return a fourth-order quadrature of the surface.

    Args:
        field: A field in 3D, or in 2D for a curve.
        resolution: Cells along the longest side of the bounds.
        exact_points: True moves the points from the curved cells to the surface, a distance of third order in the
            cell. Left on the cells, with the cells' normals, they cost a third and give volumes ten times better.

    Returns:
        Six points a triangle of the extracted mesh (three a segment in the plane).

    Raises:
        SurfaceError: There is no surface in the bounds, it leaves them, or the gradient vanishes on it.
    """
    sample = meshed_quadrature(field, resolution).sample
    return placed(field, sample, 2 * field.size / resolution) if exact_points else sample


def meshed_quadrature(field: Field, resolution: int) -> MeshedSample:
    """Return the quadrature of surface_quadrature, its points left on the cells, with the marched mesh."""
    curved = curved_mesh(field, resolution)
    return meshed_sample(field, curved.cells, curved.marched)


def meshed_sample(field: Field, cells: CurvedCells, marched: PlacedOnGrid) -> MeshedSample:
    """Return the quadrature over curved cells, with the marched mesh beneath."""
    sample, slopes = _sample_of(field, cells)
    vertices = marched.placement.points.to(field.dtype)
    return MeshedSample(sample, vertices, marched.faces, marched.grid, marched.signs, cells, slopes)


def _sample_of(field: Field, cells: CurvedCells) -> tuple[SurfaceSample, Float[Tensor, " n"] | None]:
    """Return the quadrature over cells, and about |df/dx| at its points."""
    points, normals, weights = _curved_rule(cells.nodes)
    slopes = cells.slopes_at_points()
    keep = weights > 0
    if not bool(keep.all()):
        points, normals, weights = points[keep], normals[keep], weights[keep]
        slopes = None if slopes is None else slopes[keep]
    sample = SurfaceSample(points, normals, weights).to(field.dtype)
    return sample, None if slopes is None else slopes.to(field.dtype)


def carried(field: Field, meshed: MeshedSample) -> MeshedSample | None:
    """Return the quadrature of a surface that has moved by a small part of a cell: its nodes placed on f = 0 anew.

    Where none has moved by more than KEPT of a cell it comes back as it is, and a node that Newton's method does not
    bring to the surface stays where it is: functionals correct their values for the distance, to first order.

    Args:
        field: With the surface after the motion.
        meshed: The quadrature before it.

    Returns:
        None where the surface has moved farther than CARRIED of a cell, or many nodes are lost: then it is to be
        marched.
    """
    cells, cell = meshed.curved, meshed.grid.cell
    if cells is None or cells.slopes is None:
        return None
    field = in_working_precision(field)
    some = slice(None, None, max(1, len(cells.places) // PROBED))
    moved = (field.value(cells.places[some]) / cells.slopes[some]).abs()
    if not bool((moved <= CARRIED * cell).all()):
        return None
    if bool((moved <= KEPT * cell).all()):
        return meshed
    found = place_on_surface(field, cells.places, reach=2 * CARRIED * cell, brackets=False)
    if int((~found.arrived).sum()) > LOST * len(found.arrived):
        return None
    points = torch.where(found.arrived[:, None], found.points, cells.places)
    cells = CurvedCells(points, cells.index, torch.where(found.arrived, found.gradients.norm(dim=1), cells.slopes))
    sample, slopes = _sample_of(field, cells)
    dtype = meshed.sample.points.dtype
    return replace(
        meshed,
        sample=sample.to(dtype),
        slopes=None if slopes is None else slopes.to(dtype),
        vertices=points[: len(meshed.vertices)].to(dtype),
        curved=cells,
        entered=None,
    )


def curved_cells(field: Field, resolution: int) -> Float[Tensor, "m k d"]:
    """Return the nodes of quadratic cells on the surface: six of a triangle, or in the plane three of a segment."""
    return curved_mesh(field, resolution).cells.nodes


def cell_points(
    nodes: Float[Tensor, "m k d"], at: Float[Tensor, "m t"]
) -> tuple[Float[Tensor, "m d"], Float[Tensor, "m d"]]:
    """Return one point in each quadratic cell, and the vector of its normal times the area (or length) it stands for.

    Args:
        nodes: As curved_cells gives them.
        at: The last barycentric coordinates of each point: two in a triangle, one in a segment.
    """
    shape, slopes = _shapes(at)
    points = torch.einsum("mk,mkd->md", shape, nodes)
    tangents = torch.einsum("mkt,mkd->mtd", slopes, nodes)
    return points, _across(tangents)


def cell_elements(nodes: Float[Tensor, "m k d"], at: Float[Tensor, "q t"]) -> Float[Tensor, "q m"]:
    """Return the area (or length) that each quadratic cell has per unit of barycentric area, at the same places of all.

    Args:
        nodes: As curved_cells gives them.
        at: The last barycentric coordinates of each place: two in a triangle, one in a segment.
    """
    _, slopes = _shapes(at)
    count, k, dimension = nodes.shape
    # One product of matrices for all places and cells.
    tangents = slopes.transpose(1, 2).reshape(-1, k) @ nodes.transpose(0, 1).reshape(k, -1)
    return _across(tangents.view(len(at), -1, count, dimension).transpose(1, 2)).norm(dim=-1)


def _shapes(at: Float[Tensor, "q t"]) -> tuple[Float[Tensor, "q k"], Float[Tensor, "q k t"]]:
    """Return the shape functions of a quadratic cell and their slopes at its last barycentric coordinates."""
    if at.shape[1] == 1:
        return _segment_shapes(at[:, 0])
    return _triangle_shapes(1 - at.sum(dim=1), at[:, 0], at[:, 1])


def placed(field: Field, sample: SurfaceSample, reach: float) -> SurfaceSample:
    """Return the points moved to f = 0, with normals; the distance is of higher order than the weights' error.

    Args:
        field: The field.
        sample: Points on the cells, with the cells' normals, which stay where the field has none.
        reach: Largest distance a point may be moved, a length.

    Raises:
        SurfaceError: More than a hundredth of the surface cannot be placed.
    """
    points, normals, weights = sample.points, sample.normals, sample.weights
    found = place_on_surface(field, points, reach=reach)
    if not bool(found.arrived.all()):
        arrived = found.arrived
        lost = float(weights[~arrived].sum() / weights.sum())
        if lost > 0.01:
            if float(weights[found.jumps].sum()) > 0.5 * float(weights[~arrived].sum()):
                raise discontinuous(field, found)
            raise SurfaceError(
                f"{100 * lost:.1f} % of the surface could not be placed on f = 0. Refit the field, or raise resolution."
            )
        # Drop what cannot be placed and spread its share, at most a hundredth, over the rest.
        points, normals, weights = found.points[arrived], normals[arrived], weights[arrived] / (1 - lost)
    else:
        points = found.points
    return SurfaceSample(points, normals_of(field, points, normals), weights)


def normals_of(field: Field, points: Float[Tensor, "n d"], otherwise: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """Return the outward unit normals df/dx / |df/dx|, and the others where the gradient vanishes or is not finite."""
    gradients = field.gradient(points)
    length = gradients.norm(dim=1)
    known = torch.isfinite(length)
    known &= length > 1e-7 * length[known].median() if bool(known.any()) else known
    return torch.where(known[:, None], gradients / length[:, None], otherwise)


@dataclass(frozen=True, eq=False)
class CurvedMesh:
    """Quadratic cells on the surface.

    Attributes:
        cells: Their nodes, (M, 6, 3), or in the plane (M, 3, 2): the corners, then the middles of its edges.
        marched: The mesh beneath.
        edges: The ends of each of its edges.
        middles: The middle of each edge, on the surface.
        slopes: df/dx at these, or near.
    """

    cells: CurvedCells
    marched: PlacedOnGrid
    edges: Int[Tensor, "e 2"]
    middles: Float[Tensor, "e d"]
    slopes: Float[Tensor, "e d"]


def curved_mesh(field: Field, resolution: int) -> CurvedMesh:
    """Return the curved cells of a field's surface, and the marched mesh beneath."""
    marched = placed_on_grid(field, resolution)
    vertices, cells = marched.placement, marched.faces
    corners, reach = vertices.points, 2 * field.size / resolution
    field = in_working_precision(field)
    edges, edge_of = edges_of(cells, len(corners))
    middles, slopes = middle_nodes(field, corners, edges, reach, MOST_BULGE)
    curved = with_creases(field, (corners, cells, edges, edge_of), middles, (vertices.gradients, slopes), reach)
    return CurvedMesh(curved, marched, edges, middles, slopes)


def with_creases(
    field: Field,
    mesh: tuple[Tensor, Tensor, Tensor, Tensor],
    middles: Float[Tensor, "e d"],
    gradients: tuple[Float[Tensor, "v d"], Float[Tensor, "e d"]],
    reach: float,
    given: Callable[[Tensor, Tensor], Tensor] = lambda _, middles: middles,
) -> CurvedCells:
    """Return curved cells, split along creases where there are any.

    Args:
        field: The field.
        mesh: Its corners and cells; the edges of these, and which each cell has.
        middles: Of the edges.
        gradients: df/dx at the corners, and near the middles.
        reach: Largest distance a middle may be moved, a length.
        given: Puts middles that must be where they are in the place of those of the edges of a mesh that was split.
    """
    corners, cells, edges, edge_of = mesh
    split = split_at_creases(field, corners, cells, edges, edge_of, gradients)
    if len(split[0]) == len(corners):
        slopes = torch.cat(gradients).norm(dim=1)
        return CurvedCells(torch.cat([corners, middles]), torch.cat([cells, edge_of + len(corners)], dim=1), slopes)
    edges, edge_of = edges_of(split[1], len(split[0]))
    middles, _ = middle_nodes(field, split[0], edges, reach, MOST_BULGE_BY_CREASES)
    nodes = unfolded(torch.cat([split[0][split[1]], given(edges, middles)[edge_of]], dim=1))
    index = torch.arange(nodes.shape[0] * nodes.shape[1], device=nodes.device).view(nodes.shape[:2])
    return CurvedCells(nodes.flatten(0, 1), index, None)


def middle_nodes(field: Field, corners: Tensor, edges: Tensor, reach: float, most: float) -> tuple[Tensor, Tensor]:
    """The middle of each edge, on the surface where that is nearer than so many edges; and df/dx there.

    Both triangles at an edge share its middle node, or the curved surface would tear.
    """
    ends = corners[edges]
    start = ends.mean(dim=1)
    found = place_on_surface(field, start, reach=reach)
    bulge = (found.points - start).norm(dim=1)
    near = found.arrived & (bulge <= most * (ends[:, 1] - ends[:, 0]).norm(dim=1))
    return torch.where(near[:, None], found.points, start), found.gradients


def unfolded(nodes: Tensor) -> Tensor:
    """The same cells, but flat where one turns against its own corners, as may happen by the corners of a box."""
    dimension = nodes.shape[2]
    corners, middles = nodes[:, :dimension], nodes.shape[1] - dimension
    _, slopes, _ = _segment_rule() if dimension == 2 else _triangle_rule()
    flat = _across(corners[:, 1:] - corners[:, :1])
    across = _across(torch.einsum("qkt,mkd->mqtd", slopes.to(nodes), nodes))
    folds = ((across * flat[:, None]).sum(dim=2) < 0).any(dim=1, keepdim=True)[..., None]
    straight = (corners + corners.roll(-1, dims=1))[:, :middles] / 2
    return torch.cat([corners, torch.where(folds, straight, nodes[:, dimension:])], dim=1)


def _curved_rule(nodes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Quadrature points (m * q, D), unit normals and weights of quadratic cells given by their nodes."""
    plane = nodes.shape[2] == 2
    shape, slopes, weights = _segment_rule() if plane else _triangle_rule()
    shape, slopes, weights = shape.to(nodes), slopes.to(nodes), weights.to(nodes)
    points = torch.einsum("qk,mkd->mqd", shape, nodes)
    across = _across(torch.einsum("qkt,mkd->mqtd", slopes, nodes))
    content = across.norm(dim=-1)
    normals = across / content.clamp(min=torch.finfo(content.dtype).tiny)[..., None]
    return points.flatten(0, 1), normals.flatten(0, 1), (content * weights).flatten()


def _across(tangents: Float[Tensor, "*n t d"]) -> Float[Tensor, "*n d"]:
    """The outward vector square to the tangents, as long as the area or length that they span."""
    if tangents.shape[-1] == 3:
        return torch.linalg.cross(tangents[..., 0, :], tangents[..., 1, :])
    # The inside is on the left, so outward is the tangent turned right.
    return torch.stack([tangents[..., 0, 1], -tangents[..., 0, 0]], dim=-1)


def _triangle_rule() -> tuple[Tensor, Tensor, Tensor]:
    """Shape functions (q, 6), their slopes along the two sides (q, 6, 2), and weights (q,) summing to 1/2."""
    barycentric, weights = [], []
    for a, w in _TRIANGLE_ORBITS:
        for corner in range(3):
            point = [a, a, a]
            point[corner] = 1 - 2 * a
            barycentric.append(point)
            weights.append(w / 2)
    L0, L1, L2 = torch.tensor(barycentric, dtype=torch.float64).T
    shape, slopes = _triangle_shapes(L0, L1, L2)
    return shape, slopes, torch.tensor(weights, dtype=torch.float64)


def _triangle_shapes(L0: Tensor, L1: Tensor, L2: Tensor) -> tuple[Tensor, Tensor]:
    """The six quadratic shape functions and their slopes along sides 1 and 2, at barycentric coordinates."""
    shape = torch.stack(
        [L0 * (2 * L0 - 1), L1 * (2 * L1 - 1), L2 * (2 * L2 - 1), 4 * L0 * L1, 4 * L1 * L2, 4 * L2 * L0], dim=1
    )
    zero = torch.zeros_like(L0)
    # Along side 1, L1 grows and L0 shrinks; along side 2, L2 grows and L0 shrinks.
    first = torch.stack([1 - 4 * L0, 4 * L1 - 1, zero, 4 * (L0 - L1), 4 * L2, -4 * L2], dim=1)
    second = torch.stack([1 - 4 * L0, zero, 4 * L2 - 1, -4 * L1, 4 * L1, 4 * (L0 - L2)], dim=1)
    return shape, torch.stack([first, second], dim=2)


def _segment_rule() -> tuple[Tensor, Tensor, Tensor]:
    """Shape functions (3, 3) of start, end, middle, their slopes (3, 3, 1), and Gauss weights on [0, 1]."""
    nodes, gauss = np.polynomial.legendre.leggauss(3)
    shape, slopes = _segment_shapes(torch.from_numpy((nodes + 1) / 2))
    return shape, slopes, torch.from_numpy(gauss / 2)


def _segment_shapes(t: Tensor) -> tuple[Tensor, Tensor]:
    """The three quadratic shape functions of a segment and their slopes, at t in [0, 1]."""
    shape = torch.stack([(1 - t) * (1 - 2 * t), t * (2 * t - 1), 4 * t * (1 - t)], dim=1)
    slopes = torch.stack([4 * t - 3, 4 * t - 1, 4 - 8 * t], dim=1)[:, :, None]
    return shape, slopes
