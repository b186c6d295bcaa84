"""Rigid motions in closed form: the one that fits moved points best, and a network's field moved by one.

    f'(x) = f(R^T (x - t)):    W_1' = W_1 R^T,    b_1' = b_1 - W_1 R^T t

so what a rigid edit moves as a whole needs no linearisation (see implicit.sensitivity.moved_as_a_whole).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.moved_as_a_whole import moved_as_a_whole
from implicit.surface.quadrature import SurfaceSample


@dataclass(frozen=True, eq=False)
class Placement:
    """Rigid motion x -> R x + t."""

    rotation: Float[Tensor, "d d"]
    translation: Float[Tensor, " d"]

    @classmethod
    def none(cls, like: Tensor) -> Placement:
        """Return the motion that leaves all where it is."""
        D = like.shape[-1]
        return cls(torch.eye(D).to(like), torch.zeros(D).to(like))

    @classmethod
    def fitting(
        cls, start: Float[Tensor, "n d"], target: Float[Tensor, "n d"], weights: Float[Tensor, " n"]
    ) -> Placement:
        """Return the rigid motion that takes points nearest to their targets in the weighted mean square [Kabsch 1976].

        Args:
            start, target: Positions before and after (N, D).
            weights: Weight of each point in the mean (N,).
        """
        share = weights / weights.sum()
        a, b = share @ start, share @ target
        U, _, Vt = torch.linalg.svd((target - b).T @ (share[:, None] * (start - a)))
        turn = torch.ones_like(a)
        turn[-1] = torch.linalg.det(U @ Vt)  # a reflection is no rigid motion
        rotation = (U * turn) @ Vt
        return cls(rotation, b - rotation @ a)

    def at(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return the points moved (N, D)."""
        return points @ self.rotation.T + self.translation

    def undone(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return the points moved back (N, D)."""
        return (points - self.translation) @ self.rotation

    def sample(self, sample: SurfaceSample) -> SurfaceSample:
        """Return a sample moved along."""
        return SurfaceSample(self.at(sample.points), sample.normals @ self.rotation.T, sample.weights)

    def field(self, field: Field) -> Field:
        """Return the field moved along.

        Raises:
            ValueError: The points enter it otherwise than by linear layers whose weights and biases are edited.
        """
        theta = moved_as_a_whole(field, self.rotation, self.translation)
        if theta is None:
            raise ValueError(
                "Only a field whose points enter linear layers, with weights and biases that are edited, can be moved "
                "in closed form."
            )
        return field.with_theta(theta)
