"""A field brought to where its surface is to be by a warp of its space; its own parameters stay as they are.

    f'(x) = f(phi(x)),      phi takes the moved surface back to where it was (implicit.models.warp)

Centres of phi are set on the moved vertices y, each with the rotation of its cell: first as far apart as can be, then
time and again where y is taken back worst. All maps together are then fitted, by one linear least squares each
coordinate, to

    phi(y) = x                                at the vertices
    phi(p) = x_n + R_n^T (p - y_n)            at points p near the surface, n its nearest vertex
    phi(p) = as the rotations of the centres have it                 far from it, where what counts is the sign of f

What moves rigidly has one and the same map everywhere and keeps its surface, however rough that is, but for the little
that far centres have in it; there a network that is trained ripples, for it does not express the same surface in
another place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree
from torch import nn

from implicit.field.field import Field
from implicit.models.warp import Warp
from implicit.sensitivity.weak_curvature import FloatArray, IntArray
from implicit.step.surface_map import SurfaceMap

# Most centres, and vertices for each; those that are set first, and at a time where the surface is taken back worst.
MOST, EVERY, FIRST, AT_A_TIME = 256, 10, 16, 16

# Error of a vertex, over the size of the surface, below which it needs no centre of its own, and the part of the
# largest error that is worth one.
ENOUGH, WORTH = 5e-4, 0.3

# Least distance of centres set at one time, in widths, and of a new one from all before, in spacings of the vertices.
APART, NEAREST = 1.5, 0.5

# Points off the surface: how far, over the size of the field, how many of each kind, and how many in all of space.
SPREADS = (0.01, 0.03, 0.1)
EACH = 1500

# Distance over the field's size from which only the centres' rotations count, weight of a vertex, distance at which a
# point weighs a quarter of one near the surface, over the size, the least weight, and how firmly the maps are tied to
# the rotations, relative to the mean diagonal of the normal matrix.
NEAR, OF_VERTICES, HALF, LEAST, TIED = 0.04, 4.0, 0.01, 0.01, 1e-6


def require_module(field: Field) -> nn.Module:
    """Return the module of a field, or refuse one whose space cannot be warped.

    Raises:
        ValueError: It has none of its own, or takes a code.
    """
    if field.module is None or field.takes_code:
        raise ValueError(
            'method="warp" needs a field of a module, whose values are those of the places that space is warped '
            'to, but this one is of a decoder with its code. Take method="finite".'
        )
    return field.module


@dataclass(frozen=True, eq=False)
class Back:
    """The way back of a moved surface.

    Attributes:
        surface_map: Of the surface, to where it was moved.
        width: Of the weights of the warp, in spacings of the vertices.
    """

    surface_map: SurfaceMap
    width: float

    @property
    def _moved(self) -> FloatArray:
        return self.surface_map.moved

    @property
    def _rest(self) -> FloatArray:
        return self.surface_map.rest.vertices

    @cached_property
    def _spacing(self) -> float:
        D = self._rest.shape[1]
        return float((self.surface_map.rest.contents.sum() / len(self._rest)) ** (1 / (D - 1)))

    def warped(self, field: Field, seed: int = 0) -> Field:
        """Return the field in warped space, with the maps for parameters, in float64.

        Args:
            field: Whose surface the map begins from; its own module is shared as it is.
            seed: Of the points off the surface.
        """
        precise = field.to(torch.float64)
        module = require_module(precise)
        chosen = self._centres[0]
        D = precise.dimension
        form = getattr(precise._evaluator, "form", None)
        warp = Warp(module, len(chosen), D, width=self.width * self._spacing, form=form).double()
        turned = self.surface_map.rotations[chosen]  # of row vectors, that is R^T
        maps = np.concatenate([turned, self._rest[chosen][:, None]], axis=1)
        with torch.no_grad():
            warp.centres.copy_(torch.from_numpy(self._moved[chosen]))
            warp.bounds.copy_(precise.bounds)
            warp.maps.copy_(torch.from_numpy(maps))
            warp.maps.copy_(torch.from_numpy(self._fitted(warp, maps, precise, seed)))
        return _with_parameters(warp, ["maps"], precise)

    @property
    def missed(self) -> float:
        """Root mean square error, over the size, of the vertices as the centres' rotations alone take them back."""
        return self._centres[1]

    @cached_property
    def _centres(self) -> tuple[IntArray, float]:
        """Vertices that carry a centre (K,), and what their rotations miss."""
        y, x, R = self._moved, self._rest, self.surface_map.rotations
        size = float(np.ptp(x, axis=0).max())
        chosen, apart = [0], np.linalg.norm(y - y[0], axis=1)
        while len(chosen) < min(FIRST, len(y)):
            chosen.append(int(apart.argmax()))
            apart = np.minimum(apart, np.linalg.norm(y - y[chosen[-1]], axis=1))
        width = self.width * self._spacing
        while True:
            here = np.asarray(chosen)
            warp = Warp(torch.nn.Identity(), len(here), y.shape[1], width=width).double()
            with torch.no_grad():
                warp.centres.copy_(torch.from_numpy(y[here]))
                warp.maps.copy_(torch.from_numpy(np.concatenate([R[here], x[here][:, None]], axis=1)))
                back = warp.warped(torch.from_numpy(y)).numpy()
            errors = np.linalg.norm(back - x, axis=1) / size
            more = self._worst(errors, here)
            if not more:
                return here, float(np.sqrt((errors**2).mean()))
            chosen += more

    def _worst(self, errors: FloatArray, chosen: IntArray) -> list[int]:
        """Return the vertices that a further centre is worth, the worst first and apart from each other."""
        y, least = self._moved, max(ENOUGH, WORTH * float(errors.max()))
        free = np.asarray(cKDTree(y[chosen]).query(y)[0]) > NEAREST * self._spacing
        most = max(FIRST, min(MOST, len(y) // EVERY))
        more: list[int] = []
        for v in np.argsort(-errors):
            if errors[v] < least or len(more) == AT_A_TIME or len(chosen) + len(more) >= most:
                break
            far = np.linalg.norm(y[more] - y[v], axis=1) > APART * self.width * self._spacing
            if free[v] and bool(far.all()):
                more.append(int(v))
        return more

    def _fitted(self, warp: Warp, maps: FloatArray, field: Field, seed: int) -> FloatArray:
        """Return the maps of least squares (K, D + 1, D), from those of the rotations."""
        y, x, R = self._moved, self._rest, self.surface_map.rotations
        size, generator, D = field.size, np.random.default_rng(seed), y.shape[1]
        parts = [
            y[generator.integers(len(y), size=EACH)] + spread * size * generator.normal(size=(EACH, D))
            for spread in SPREADS
        ]
        low, high = field.bounds.double().cpu().numpy()
        p = np.concatenate([*parts, generator.uniform(low, high, (EACH, D))])
        apart, nearest = cKDTree(y).query(p)
        goal = x[nearest] + np.einsum("nji,nj->ni", R[nearest], p - y[nearest])
        far = apart > NEAR * size
        with torch.no_grad():
            goal[far] = warp.warped(torch.from_numpy(p[far])).numpy()
            points = torch.from_numpy(np.concatenate([y, p]))
            shares, here = warp.weights(points).numpy(), points.numpy()
            left = np.concatenate([x, goal]) - warp.warped(points).numpy()
        away = np.maximum((HALF / (HALF + apart / size)) ** 2, LEAST)
        roots = np.sqrt(np.concatenate([np.full(len(y), OF_VERTICES), away]))[:, None]
        rows = np.concatenate([here[:, None] - warp.centres.numpy(), np.ones((len(here), len(maps), 1))], axis=2)
        rows = (roots[:, :, None] * shares[:, :, None] * rows).reshape(len(here), -1)
        normal = rows.T @ rows
        normal[np.diag_indices_from(normal)] += TIED * np.trace(normal) / len(normal)
        change = cho_solve(cho_factor(normal, lower=True), rows.T @ (roots * left))
        return np.asarray(maps + change.reshape(maps.shape))


def all_parameters(warped: Field, field: Field) -> Field:
    """Return a field in warped space with the parameters of the field within for its own too, after the maps.

    Args:
        warped: As by Back.warped.
        field: The field that was warped, whose edited parameters these are.
    """
    module = warped.module
    assert module is not None
    return _with_parameters(module, ["maps", *(f"base.{block.name}" for block in field.layout)], warped)


def _with_parameters(module: nn.Module, names: list[str], like: Field) -> Field:
    """Return the field of a module with some of its parameters, in all else like another field."""
    low, high = like.bounds.tolist()
    return Field(
        module,
        parameters=names,
        level=like.level,
        inside=like.inside,
        bounds=(low, high),
        units=like.units,
        check=False,
    )
