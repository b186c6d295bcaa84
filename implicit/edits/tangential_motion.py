"""Motions along the surface that follow from a given motion along the normal.

An update d_theta moves each point along its normal only, at the speed u = b . d_theta; where the point goes along the
surface is a choice. Two choices that need no handles, both linear in d_theta:

    constant normals    S t = grad_surface u           each point keeps its normal [Stam & Schmidt 2011]
    near-isometric      min over t of int |P (J + J^T) P|^2,  J = dD/dx, D = u n + t     [Tao et al. 2016]

with S = dn/dx on the tangent plane, for the normal of a point that moves at u n + t turns by S t - grad_surface u.

Sources: Stam & Schmidt, "On the velocity of an implicit surface", ACM TOG 30(3), 2011; Tao, Solomon & Butscher,
"Near-isometric level set tracking", Computer Graphics Forum 35(5), 2016.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_tensor
from implicit.field.field import Field, require_field
from implicit.sensitivity.boundary_sensitivity import row_blocks
from implicit.sensitivity.frame import Frame, speed_and_slope, tangential_component
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Killing
from implicit.step.least_squares import LeastSquares, Rows
from implicit.step.parameter_basis import Directions
from implicit.step.tangential_basis import CosineFeatures, TangentialModel
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import sample_surface

# Damping of the near-isometric solve, relative to the trace of its normal matrix. The strain of a motion that could be
# free of strain stays at about this part of the motion's square; less, and rounding decides.
DAMPING = 1e-12


@dataclass(frozen=True)
class ConstantNormals:
    """The motion along the surface that keeps every point's normal [Stam & Schmidt 2011].

    Exact for translations of curved shapes, and for offsets. In directions in which the surface is flat no such motion
    exists, and it is long where it is nearly flat; there it fades out.

    Args:
        least_curvature: Principal curvature k at which the motion is halved, times the field's size: 1 / k becomes
            k / (k^2 + least^2). Positive. Of a translation of the bundled cow the default misses 2 % (rms), 1e-3 misses
            0.01 %, and 0.2 misses 9 %.

    Raises:
        ValueError: least_curvature is not positive, or d_theta has another size than theta.
    """

    least_curvature: float = 0.02

    def __post_init__(self) -> None:
        require_positive("least_curvature", self.least_curvature)

    def __call__(
        self, field: Field, d_theta: Float[Tensor, " p"], points: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        _require_update(field, d_theta)
        points = field.require_points(points)
        least = self.least_curvature / field.size
        blocks = []
        for part in row_blocks(points, (field.dimension + 1) * len(d_theta)):
            frame = Frame.at(field, part)
            tangents = frame.axes[:, :-1]
            slope = tangents @ (speed_and_slope(field, frame)[:, 1:] @ d_theta)[:, :, None]
            shape = frame.shape_operator
            curvatures, directions = torch.linalg.eigh((shape + shape.transpose(1, 2)) / 2)
            inverse = curvatures / (curvatures**2 + least**2)
            t = directions @ (inverse[:, :, None] * (directions.transpose(1, 2) @ slope))
            blocks.append((tangents.transpose(1, 2) @ t)[:, :, 0])
        return torch.cat(blocks) if blocks else torch.zeros_like(points)


@dataclass(frozen=True, eq=False)
class NearIsometric:
    """The motion along the surface that stretches it least [Tao et al. 2016], by one least squares in float64.

    Where the given normal motion is that of a rigid motion, so is the whole, up to rigid motions of the surface within
    itself (rotations of a sphere about its centre): of these the solve takes the one with the smallest coefficients.

    Args:
        model: Vector fields to choose from; None takes CosineFeatures of the field.
        sample: Points that carry the energy, with their weights; None draws 1000 of them.

    Raises:
        ValueError: d_theta has another size than theta.
    """

    model: TangentialModel | None = None
    sample: SurfaceSample | None = None

    def __call__(
        self, field: Field, d_theta: Float[Tensor, " p"], points: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        _require_update(field, d_theta)
        precise = field.to(torch.float64)
        at = precise.require_points(precise.in_precision(points))
        model = CosineFeatures(precise) if self.model is None else self.model
        sample = sample_surface(precise, 1000, "farthest") if self.sample is None else self.sample.to(torch.float64)
        # The given motion as the only normal one: its column goes to the right-hand side.
        space = DeformationSpace(precise, model, Directions(d_theta.to(precise.theta)[:, None]))
        system = LeastSquares(space.size - 1, precise.theta)
        for rows in Killing(sample.points, sample.weights, bending=0.0, thickness=0.0).rows(space):
            matrix, target = rows.matrix, rows.target
            if rows.first == 0:
                matrix, target = matrix[:, 1:], target - matrix[:, 0]
            system.add(Rows(matrix, target, rows.weights))
        c = system.solve(relative_damping=DAMPING).x.view(precise.dimension, model.count)
        motion = model.values(at) @ c.T
        n = precise.normal(at)
        return tangential_component(motion, n).to(points)


def _require_update(field: Field, d_theta: Tensor) -> None:
    require_tensor("d_theta", d_theta, require_field(field).theta.shape, field.device)
