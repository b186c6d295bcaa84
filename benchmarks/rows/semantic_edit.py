"""A semantic edit: the published formula repeated with small tools of torch, or ours."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from rows.table import best, row
from torch.func import grad, vmap

import implicit
from implicit import families
from implicit.models import DeepSdf
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import StepProblem, assemble

DAMPING = 0.1
LEFT = 0.05  # of the way, where both stop


def semantic_step() -> None:
    """One step for 100 points of a network of the published size, its weights random."""
    torch.manual_seed(0)
    decoder = DeepSdf().eval().requires_grad_(False)
    field = implicit.decoder_field(decoder, 0.1 * torch.randn(decoder.latent))
    points, wanted = torch.rand(100, 3) - 0.5, torch.full((100,), 0.01)
    slope = field.gradient(points).norm(dim=1).mean()
    damping = DAMPING / float(slope) ** 2  # random weights have small slopes, and large steps for their code

    def ours() -> torch.Tensor:
        reach = NormalTarget(points, wanted, torch.ones(100))
        return assemble(StepProblem(DeformationSpace(field), [reach])).solve(damping).x

    def theirs() -> torch.Tensor:
        return published_step(field, field.theta, points, lambda _: wanted, damping)[0]

    theirs(), ours()  # the first derivative of its kind makes torch import half of itself
    (theirs_s, a), (ours_s, b) = best(theirs, ours, repeats=7)
    apart = float((a - b).norm() / a.norm())
    words = f"updates apart by {apart:.1e} of their length"
    row("semantic step, 100 points, DeepSDF as published: the published formula", theirs_s, ours_s, words, apart < 1e-3)


def published_step(
    field: implicit.Field,
    code: torch.Tensor,
    x: torch.Tensor,
    wanted: Callable[[torch.Tensor], torch.Tensor],
    damping: float,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A gradient by the code and one by the place for each point, stacked on the root of the damping, and solved.

    The update of the code, B, the normals, and the slopes.
    """

    def value(code: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        return field.function(code, x[None])[0]

    by_code, by_place = (vmap(grad(value, argnums=k), in_dims=(None, 0))(code, x) for k in (0, 1))
    slopes = by_place.norm(dim=1, keepdim=True)
    B, normals = -by_code / slopes, by_place / slopes
    stacked = torch.cat([B, damping**0.5 * torch.eye(B.shape[1])])
    target = torch.cat([wanted(normals), torch.zeros(B.shape[1])])
    return torch.linalg.lstsq(stacked, target[:, None], driver="gels").solution[:, 0], B, normals, slopes[:, 0]


class RaisedFoot:
    """A foot of a small chair, to be raised by a tenth of its height until a twentieth of the way is left."""

    def __init__(self) -> None:
        model = families.bundled("deepsdf-chairs")
        self.chair = model.field(model.latents[3].clone())
        V, _ = implicit.extract_mesh(self.chair, resolution=64)
        foot = implicit.Handle(implicit.Ball(V[V[:, 1].argmin()], 0.1), (0.0, 0.1, 0.0))
        self.points, self.ways = implicit.prescribe(self.chair, foot)
        self.goals = self.points + self.ways

    def published(self) -> torch.Tensor:
        """Return the code by the published formula.

        Its points follow by what each step says of them and one step of Newton's method.
        """
        chair, goals, ways = self.chair, self.goals, self.ways
        code, x = chair.theta.clone(), self.points.clone()
        for _ in range(50):
            left = goals - x
            step = published_step(chair, code, x, lambda n, left=left: (left * n).sum(dim=1), DAMPING)
            d_code, B, normals, slopes = step
            along = left - (left * normals).sum(dim=1, keepdim=True) * normals
            code, x = code + d_code, x + (B @ d_code)[:, None] * normals + along
            x = x - (chair.function(code, x) / slopes)[:, None] * normals
            if (((goals - x) * normals).sum(dim=1)).norm() <= LEFT * (ways * normals).sum(dim=1).norm():
                break
        return code

    def ours(self, damping: float | None) -> torch.Tensor:
        """Return the code by implicit.semantic_edit."""
        return implicit.semantic_edit(self.chair, self.points, self.ways, damping=damping, tolerance=LEFT).field.theta

    def missed(self, code: torch.Tensor) -> float:
        """Return the distance of the goals from the surface, root mean square, over the way."""
        f, slopes = self.chair.with_theta(code).value_and_gradient(self.goals)
        return float((f / slopes.norm(dim=1)).norm() / self.ways.norm())


def semantic_edit() -> None:
    """A foot of a chair raised, by the published formula and by ours at its damping."""
    semantic_step()
    scene = RaisedFoot()
    published, ours, missed = scene.published, partial(scene.ours, DAMPING), scene.missed

    published(), ours()  # the first derivative of its kind makes torch import half of itself
    (theirs_s, theirs), (ours_s, mine) = best(published, ours, repeats=7)
    a, b = missed(theirs), missed(mine)
    words = f"goals missed by {100 * a:.1f} %, {100 * b:.1f} % of the way"
    row(f"semantic edit, {len(scene.points)} points: the published formula", theirs_s, ours_s, words, b <= max(LEFT, a))
