"""A semantic edit: the published formula repeated with small tools of torch, or ours."""

from __future__ import annotations

import torch
from rows.table import best, row
from torch.func import grad, vmap

import implicit
from implicit import families

DAMPING = 0.1
LEFT = 0.05  # of the way, where both stop


def semantic_edit() -> None:
    """A foot of a chair raised by a tenth of its height, until a twentieth of the way is left.

    The published formula takes a gradient by the code and one by the place for each point, and stacks them on the root
    of the damping; its points follow by what the step says of them and one step of Newton's method.
    """
    model = families.bundled("deepsdf-chairs")
    chair = model.field(model.latents[3].clone())
    V, _ = implicit.extract_mesh(chair, resolution=64)
    foot = implicit.Handle(implicit.Ball(V[V[:, 1].argmin()], 0.1), (0.0, 0.1, 0.0))
    points, ways = implicit.prescribe(chair, foot)
    goals = points + ways

    def value(code: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        return chair.function(code, x[None])[0]

    by_code, by_place = (vmap(grad(value, argnums=k), in_dims=(None, 0)) for k in (0, 1))

    def published() -> torch.Tensor:
        code, x = chair.theta.clone(), points.clone()
        for _ in range(50):
            slopes = by_place(code, x)
            length = slopes.norm(dim=1, keepdim=True)
            B, normals = -by_code(code, x) / length, slopes / length
            left = ((goals - x) * normals).sum(dim=1)
            stacked = torch.cat([B, DAMPING**0.5 * torch.eye(B.shape[1])])
            wanted = torch.cat([left, torch.zeros(B.shape[1])])
            d_code = torch.linalg.lstsq(stacked, wanted[:, None], driver="gels").solution[:, 0]
            along = (goals - x) - left[:, None] * normals
            code, x = code + d_code, x + (B @ d_code)[:, None] * normals + along
            x = x - (chair.function(code, x) / length[:, 0])[:, None] * normals
            if (((goals - x) * normals).sum(dim=1)).norm() <= LEFT * (ways * normals).sum(dim=1).norm():
                break
        return code

    def ours() -> torch.Tensor:
        return implicit.semantic_edit(chair, points, ways, damping=DAMPING, tolerance=LEFT).field.theta

    def missed(code: torch.Tensor) -> float:
        """Distance of the goals from the surface, root mean square, over the way."""
        f, slopes = chair.with_theta(code).value_and_gradient(goals)
        return float((f / slopes.norm(dim=1)).norm() / ways.norm())

    published(), ours()  # the first derivative of its kind makes torch import half of itself
    (theirs_s, theirs), (ours_s, mine) = best(published, ours, repeats=7)
    a, b = missed(theirs), missed(mine)
    words = f"goals missed by {100 * a:.1f} %, {100 * b:.1f} % of the way"
    row(f"semantic edit, {len(points)} points: the published formula", theirs_s, ours_s, words, b <= max(LEFT, a))
