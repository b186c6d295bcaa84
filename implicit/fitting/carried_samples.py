"""Samples of a field whose surface has been deformed: what a map of the surface says of the space about it.

Points x of the surface, drawn by area, go to y(x) with their normals n' (implicit.step.surface_map). A point p of space
belongs to the nearest of them, and has there either of two values:

    distance    the distance to the planes of the nearest y near the surface, to the nearest y elsewhere, signed by n'
    carried     f(x + R^T (p - y)), the field's own value as it was there, with the sign of the distance

A field that is a distance stays one by the first. By the second, one that is none (an occupancy, a truncated distance)
keeps its own shape off the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.surface_map import Foot, SurfaceMap
from implicit.surface.projection import newton_to_surface

# How far off the surface samples are drawn, over the field's size, and how many of each beside one of the surface.
SPREADS = (0.0025, 0.01, 0.03)
PART_AWAY = 0.75

# Samples of the surface that a point near it asks, and how near that is, over the size.
ASKED = 4
NEAR = 0.02

# How far outside of the surface one looks for another part of it, in spacings of the samples.
OUTSIDE = 1.0

# How far beyond the bounds the samples reach, over the size.
MARGIN = 0.03


@dataclass(frozen=True, eq=False)
class CarriedSamples:
    """Samples of the field that is wanted.

    Attributes:
        points: In space (N, D), the first `on_surface` of them on the surface.
        values: Wanted of the field there, 0 on the surface (N,).
        distances: Signed distances to the surface (N,).
        gradients: Wanted df/dx, of the points near the surface (N, D).
        on_surface: How many are on the surface.
        slope: Median of |df/dx| on the surface before, units of the field to a length.
        crossed: Part of the wanted surface that lies inside another part of it, beyond what does so before: no field
            has such a surface.
    """

    points: Float[Tensor, "n d"]
    values: Float[Tensor, " n"]
    distances: Float[Tensor, " n"]
    gradients: Float[Tensor, "n d"]
    on_surface: int
    slope: float
    crossed: float


def carried_samples(
    field: Field, surface_map: SurfaceMap, count: int = 40_000, *, as_distance: bool, seed: int = 0
) -> CarriedSamples:
    """Return samples about the surface that a map says.

    Args:
        field: Whose surface the map begins from.
        surface_map: Where the surface goes.
        count: Samples of the surface; those off it are more than twice as many again.
        as_distance: Whether the field is wanted to be a distance, else its own values are carried along.
        seed: Of the random samples.

    Raises:
        ValueError: The gradient of the field vanishes at one of them.
    """
    generator = np.random.default_rng(seed)
    foot = _drawn(field, surface_map, count, generator)
    x = torch.from_numpy(foot.points).to(field.theta)
    slopes = field.gradient(x)
    lengths = field.gradient_length(slopes)
    normals = (slopes / lengths[:, None]).double().cpu().numpy()
    y, turned = surface_map.at(foot), surface_map.turned(foot, normals)
    off = OUTSIDE * (float(surface_map.rest.contents.sum()) / len(y)) ** (1 / (field.dimension - 1))
    before = _Space(cKDTree(foot.points), foot.points, normals, field.size)
    space = _Space(cKDTree(y), y, turned, field.size)
    away = max(1, round(PART_AWAY * len(y)))
    parts = [space.about(spread, away, generator) for spread in SPREADS]
    low, high = field.bounds.double().cpu().numpy() + MARGIN * field.size * np.array([[-1.0], [1.0]])
    parts.append(generator.uniform(low, high, (away, field.dimension)))
    points = np.concatenate(parts)
    distances, nearest, directions = space.distances(points)
    slope = float(lengths.double().median())
    if as_distance:
        values, on, beside = distances, turned, directions
    else:
        size = lengths.double().cpu().numpy()
        rotations = surface_map.rotation(foot)[nearest]
        pulled = foot.points[nearest] + np.einsum("nji,nj->ni", rotations, points - y[nearest])
        own = field.value(torch.from_numpy(pulled).to(field.theta)).double().cpu().numpy()
        # Where parts come near each other or fold, the place that a point came from may lie on the other side.
        agree = np.sign(own) == np.sign(distances)
        values = np.where(agree, own, size[nearest] * distances)
        on, beside = size[:, None] * turned, size[nearest][:, None] * directions

    def joined(first: FloatArray, second: FloatArray) -> Tensor:
        return torch.from_numpy(np.concatenate([first, second])).to(field.theta)

    zero = np.zeros(len(y))
    return CarriedSamples(
        joined(y, points),
        joined(zero, values),
        joined(zero, distances),
        joined(on, beside),
        len(y),
        slope,
        max(0.0, space.hidden(off) - before.hidden(off)),
    )


def _drawn(field: Field, surface_map: SurfaceMap, count: int, generator: np.random.Generator) -> Foot:
    """Return points of the surface, drawn by area on the triangles and brought onto it."""
    rest = surface_map.rest
    # One in each of as many equal strips of the area: even, and no triangle is left out by chance.
    strips = (np.arange(count) + generator.uniform(size=count)) / count
    faces = np.minimum(np.searchsorted(np.cumsum(rest.contents) / rest.contents.sum(), strips), len(rest.faces) - 1)
    first, second = generator.uniform(size=count), generator.uniform(size=count)
    if field.dimension == 2:
        shares = np.stack([1 - first, first], axis=1)
    else:
        root = np.sqrt(first)
        shares = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    on_mesh = np.einsum("nk,nkd->nd", shares, rest.vertices[rest.faces[faces]])
    start = torch.from_numpy(on_mesh).to(field.theta)
    found, arrived = newton_to_surface(field, start, reach=2 * rest.width, tolerance=1e-6 * field.size)
    kept = arrived.cpu().numpy()
    return Foot(found.double().cpu().numpy()[kept], faces[kept], shares[kept])


@dataclass(frozen=True, eq=False)
class _Space:
    """Points of the deformed surface with their normals, for the space about them."""

    tree: cKDTree
    points: FloatArray
    normals: FloatArray
    size: float

    def about(self, spread: float, count: int, generator: np.random.Generator) -> FloatArray:
        """Return points about random ones of the surface, normally distributed."""
        chosen = generator.integers(len(self.points), size=count)
        return self.points[chosen] + spread * self.size * generator.normal(size=(count, self.points.shape[1]))

    def hidden(self, off: float) -> float:
        """Return the part of the surface just outside of which one is inside, by every second of the points.

        Args:
            off: How far outside to look, a length.
        """
        return float((self.distances((self.points + off * self.normals)[::2])[0] < 0).mean())

    def distances(self, points: FloatArray) -> tuple[FloatArray, np.ndarray, FloatArray]:
        """Return signed distances, the nearest point of the surface, and the directions of the distance."""
        apart, found = self.tree.query(points, k=min(ASKED, len(self.points)))
        apart, found = np.asarray(apart).reshape(len(points), -1), np.asarray(found).reshape(len(points), -1)
        heights = np.einsum("nkd,nkd->nk", points[:, None] - self.points[found], self.normals[found])
        nearest = found[:, 0]
        # Of planes those count most whose points are nearest: the weights fall to nothing at the last.
        weights = 1 / (apart**2 + 1e-18 * self.size**2)
        weights /= weights.sum(axis=1, keepdims=True)
        plane = (weights * heights).sum(axis=1)
        signs = np.where(plane < 0, -1.0, 1.0)
        near = apart[:, 0] < NEAR * self.size
        by_planes = near & (np.abs(plane) > 0.7 * apart[:, 0]) | (apart[:, 0] < 0.25 * NEAR * self.size)
        distances = np.where(by_planes, plane, signs * apart[:, 0])
        mean = np.einsum("nk,nkd->nd", weights, self.normals[found])
        directions = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
        return distances, nearest, directions
