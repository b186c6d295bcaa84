"""Polytopes as small ReLU networks: their surface, area and volume are known, and the gradient jumps at every edge."""

import math

import torch
from torch import Tensor, nn

from implicit import Field

# A rotation with no axis along the grid.
TURN = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))[0]
AXES = torch.cat([torch.eye(3, dtype=torch.float64), -torch.eye(3, dtype=torch.float64)])
DIAGONALS = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * 3) / math.sqrt(3)


class LargestOf(nn.Module):
    """The largest of scale_i (normal_i . x - offset), two at a time by max(a, b) = b + relu(a - b)."""

    def __init__(self, normals: Tensor, offset: float, scales: Tensor) -> None:
        super().__init__()
        self.normals, self.offset = (
            nn.Parameter(normals.clone()),
            nn.Parameter(torch.tensor(offset, dtype=normals.dtype)),
        )
        self.register_buffer("scales", scales.to(normals))

    def forward(self, x: Tensor) -> Tensor:
        left = self.scales * (x @ self.normals.T - self.offset)
        while left.shape[1] > 1:
            if left.shape[1] % 2:
                left = torch.cat([left, left[:, -1:]], dim=1)
            left = left[:, 1::2] + torch.relu(left[:, ::2] - left[:, 1::2])
        return left[:, 0]


def polytope(normals: Tensor, offset: float, spread: float = 1.0) -> Field:
    """Return the field of a polytope whose faces all touch a sphere; their slopes are spread over such a factor."""
    return Field(LargestOf(normals, offset, torch.logspace(0, math.log10(spread), len(normals))))


def distance_out(normals: Tensor, offset: float, points: Tensor) -> Tensor:
    """Return by how much each point exceeds the face that it exceeds most; 0 on the surface, whatever the slopes."""
    return (points.double() @ normals.T - offset).amax(dim=1)


# Normals, radius of the inscribed sphere, area, volume.
CUBE = (AXES @ TURN, 0.51, 24 * 0.51**2, 8 * 0.51**3)
OCTAHEDRON = (DIAGONALS @ TURN, 0.45, 12 * math.sqrt(3) * 0.45**2, 4 * math.sqrt(3) * 0.45**3)
