"""A family: shapes told apart by a few lengths, each an exact signed distance to a union of solids."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import counted
from implicit.field.field import Field

Shape = Callable[[Mapping[str, Tensor], Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class Family:
    """Shapes within [-0.9, 0.9]^3, symmetric about the plane x = 0, y up.

    Attributes:
        name: Name, such as "chairs".
        ranges: The parameters by name, in the order of a table's columns, and from where to where they are drawn.
        shape: Parameters by name and coordinates to signed distances; all broadcast against each other.
    """

    name: str
    ranges: Mapping[str, tuple[float, float]]
    shape: Shape

    def __repr__(self) -> str:
        return f"Family: {self.name}, {counted(len(self.ranges), 'parameter')} ({', '.join(self.ranges)})"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.ranges)

    def draw(self, count: int, seed: int = 0) -> Float[Tensor, "s p"]:
        """Return parameters of so many shapes, spread evenly over the ranges (a scrambled Sobol sequence), float64."""
        engine = torch.quasirandom.SobolEngine(len(self.ranges), scramble=True, seed=seed)
        lower, upper = torch.tensor(list(self.ranges.values()), dtype=torch.float64).T
        return lower + engine.draw(count, dtype=torch.float64) * (upper - lower)

    def distance(self, parameters: Float[Tensor, "*s p"], points: Float[Tensor, "*s n 3"]) -> Float[Tensor, "*s n"]:
        """Return signed distances of points to one shape, or of each shape's points to it; negative inside."""
        if parameters.shape[-1] != len(self.ranges):
            raise ValueError(
                f"{self.name} have {len(self.ranges)} parameters ({', '.join(self.ranges)}), but got "
                f"{parameters.shape[-1]}."
            )
        named = {name: parameters[..., k, None].to(points) for k, name in enumerate(self.ranges)}
        return self.shape(named, points[..., 0], points[..., 1], points[..., 2])

    def field(self, parameters: Float[Tensor, " p"]) -> Field:
        """Return one shape as a field whose theta are the parameters."""
        from implicit.field.decoder import decoder_field

        return decoder_field(lambda points, theta: self.distance(theta, points), parameters)

    def nearest(
        self,
        inside: Callable[[Float[Tensor, "n 3"]], Tensor],
        surface: Float[Tensor, "m 3"],
        start: Float[Tensor, " p"],
        *,
        resolution: int = 24,
    ) -> tuple[Float[Tensor, " p"], float]:
        """Return the member nearest to a shape: the parameters that an edited one has come to.

        First the smoothed insides are matched on a grid, from coarse to fine, so that a part that is too long is seen
        all along; then the distances of surface points are made small. Both by Levenberg and Marquardt's method.

        Args:
            inside: From points (N, 3) to True where they lie inside the shape (N,), in the family's coordinates.
            surface: Points all over its surface, such as the vertices of an extracted mesh.
            start: Parameters to begin from.
            resolution: Cells along each side of the grid over [-1, 1]^3.

        Returns:
            The parameters, float64, and the root-mean-square distance of the surface points to that member, a length.
        """
        middles = (torch.arange(resolution, dtype=torch.float64) + 0.5) * (2 / resolution) - 1
        grid = torch.stack(torch.meshgrid(middles, middles, middles, indexing="ij"), dim=-1).reshape(-1, 3)
        truth = inside(grid).double()
        surface, theta = surface.double(), start.double()
        # Wider than the ranges, for an edit may leave them, but no part may turn inside out.
        lower, upper = torch.tensor(list(self.ranges.values()), dtype=torch.float64).T
        bounds = (torch.maximum(lower - (upper - lower), 0.3 * lower), 2 * upper - lower)
        for width in (0.06, 0.03):
            near = (self.distance(theta, grid).abs() < 4 * width) | (truth > 0.5)

            def misses(theta: Tensor, x: Tensor = grid[near], y: Tensor = truth[near], h: float = width) -> Tensor:
                return torch.sigmoid(-self.distance(theta, x) / h) - y

            theta = _least_squares(misses, theta, bounds)
        theta = _least_squares(lambda theta: self.distance(theta, surface), theta, bounds)
        return theta, float(self.distance(theta, surface).square().mean().sqrt())


def _least_squares(
    misses: Callable[[Tensor], Tensor], theta: Tensor, bounds: tuple[Tensor, Tensor], iterations: int = 30
) -> Tensor:
    miss, damping = misses(theta), 1e-3
    for _ in range(iterations):
        J = torch.func.jacfwd(misses)(theta)
        normal = J.T @ J
        diagonal = normal.diagonal() + 1e-9 * normal.diagonal().max()
        step = torch.linalg.solve(normal + damping * torch.diag(diagonal), -(J.T @ miss))
        step = torch.minimum(torch.maximum(theta + step, bounds[0]), bounds[1]) - theta
        tried = misses(theta + step)
        if float(tried.square().sum()) < float(miss.square().sum()):
            theta, miss, damping = theta + step, tried, damping / 5
            if float(step.norm()) < 1e-9:
                break
        else:
            damping *= 4
            if damping > 1e6:
                break
    return theta
