"""A family: shapes told apart by a few lengths, each an exact signed distance to a union of solids."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field import Field

Shape = Callable[[Mapping[str, Tensor], Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes within [-0.85, 0.85]^3, symmetric about the plane x = 0, y up.

    Attributes:
        name: Such as "chairs".
        ranges: The parameters by name, in the order of a table's columns, and from where to where they are drawn.
        shape: Parameters by name and coordinates to signed distances; all broadcast against each other.
    """

    name: str
    ranges: Mapping[str, tuple[float, float]]
    shape: Shape

    @property
    def parameters(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self.ranges)

    def draw(self, count: int, seed: int = 0) -> Float[Tensor, "s p"]:
        """Parameters of so many shapes, spread evenly over the ranges (a scrambled Sobol sequence), float64."""
        engine = torch.quasirandom.SobolEngine(len(self.ranges), scramble=True, seed=seed)
        lower, upper = torch.tensor(list(self.ranges.values()), dtype=torch.float64).T
        return lower + engine.draw(count, dtype=torch.float64) * (upper - lower)

    def distance(self, parameters: Float[Tensor, "*s p"], points: Float[Tensor, "*s n 3"]) -> Float[Tensor, "*s n"]:
        """Signed distances of points to one shape, or of each shape's points to it; negative inside."""
        if parameters.shape[-1] != len(self.ranges):
            raise ValueError(
                f"{self.name} have {len(self.ranges)} parameters ({', '.join(self.ranges)}), but got "
                f"{parameters.shape[-1]}."
            )
        named = {name: parameters[..., k, None].to(points) for k, name in enumerate(self.ranges)}
        return self.shape(named, points[..., 0], points[..., 1], points[..., 2])

    def field(self, parameters: Float[Tensor, " p"]) -> Field:
        """One shape as a field whose theta are the parameters."""
        from implicit.field import decoder_field

        return decoder_field(lambda points, theta: self.distance(theta, points), parameters)

    def nearest(
        self, points: Float[Tensor, "n 3"], start: Float[Tensor, " p"], *, iterations: int = 50
    ) -> tuple[Float[Tensor, " p"], float]:
        """The member whose surface the points lie on, in the least-squares sense: what an edited shape has become.

        Levenberg and Marquardt's method on the distances of the points, from parameters nearby.

        Args:
            points: All over a surface, such as the vertices of an extracted mesh.
            start: Parameters to begin from.
            iterations: Most steps.

        Returns:
            The parameters, float64, and the root-mean-square distance of the points to that member, a length.
        """
        points, theta = points.double(), start.double().clone()

        def misses(theta: Tensor) -> Tensor:
            return self.distance(theta, points)

        miss, damping = misses(theta), 1e-3
        for _ in range(iterations):
            J = torch.func.jacfwd(misses)(theta)
            normal = J.T @ J
            diagonal = normal.diagonal() + 1e-9 * normal.diagonal().max()
            step = torch.linalg.solve(normal + damping * torch.diag(diagonal), -(J.T @ miss))
            tried = misses(theta + step)
            if float(tried.square().sum()) < float(miss.square().sum()):
                theta, miss, damping = theta + step, tried, damping / 5
                if float(step.norm()) < 1e-9:
                    break
            else:
                damping *= 4
                if damping > 1e6:
                    break
        return theta, float(miss.square().mean().sqrt())
