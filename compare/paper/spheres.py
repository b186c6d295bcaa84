"""DualSDF's own way to edit: move some of its spheres, and let gradient steps on the code follow them.

    minimise over z   mean over chosen m of |c_m(z) - c_m*|^2  +  pull |z|^2       by Adam, learning rate 0.1

It is the baseline of Berzins et al. 2023, appendix A. Source: Hao et al., "DualSDF", CVPR 2020, section 3.4.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.models import DualSdf


@dataclass(frozen=True, eq=False)
class SphereEdit:
    """A code after its spheres were moved."""

    code: Float[Tensor, " l"]
    steps: int
    missed: float  # rms distance of the chosen centres from where they were sent, over the largest way asked for
    reached: bool  # whether that fell to the tolerance
    seconds: float


def sphere_edit(
    decoder: DualSdf,
    code: Float[Tensor, " l"],
    chosen: Int[Tensor, " k"],
    ways: Float[Tensor, "k 3"],
    *,
    steps: int = 500,
    learning_rate: float = 0.1,
    pull: float = 1e-5,
    tolerance: float = 0.1,
) -> SphereEdit:
    """Move the centres of some spheres.

    Args:
        decoder: With the spheres.
        code: To start from.
        chosen: Which spheres.
        ways: How each is to move; their radii are free.
        steps: Most steps.
        learning_rate: Of Adam.
        pull: Weight of the squared length of the code, the prior being centred at zero.
        tolerance: When to stop, in the measure of `missed`.
    """
    if len(chosen) == 0 or ways.shape != (len(chosen), 3) or not bool(ways.any()):
        raise ValueError(
            f"There must be a way for each of the {len(chosen)} chosen spheres, not all zero, but they have shape "
            f"{tuple(ways.shape)}. Choose spheres where the shape is to move."
        )
    began = time.perf_counter()
    goal = decoder.spheres(code.detach())[1][chosen] + ways
    largest = float(ways.norm(dim=1).max())
    z = code.detach().clone().requires_grad_()
    optimiser = torch.optim.Adam([z], lr=learning_rate)
    step = 0
    while True:
        square = (decoder.spheres(z)[1][chosen] - goal).square().sum(dim=1).mean()
        missed = float(square.detach().sqrt()) / largest
        if missed <= tolerance or step == steps:
            break
        (z.grad,) = torch.autograd.grad(square + pull * z.square().sum(), z)
        optimiser.step()
        step += 1
    return SphereEdit(z.detach(), step, missed, missed <= tolerance, time.perf_counter() - began)


def spheres_near(decoder: DualSdf, code: Float[Tensor, " l"], points: Float[Tensor, "n 3"]) -> Int[Tensor, " k"]:
    """Return the spheres whose surface is the nearest to one of the points: what a user would grasp there."""
    with torch.no_grad():
        radii, centers = decoder.spheres(code)
        return ((points[:, None] - centers).norm(dim=2) - radii).abs().argmin(dim=1).unique()
