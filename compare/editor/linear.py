"""The linear model of an edit, prepared once at the pick, so that every frame of a drag costs a small product.

The displacement that a motion asks of a point is linear in the motion's COLUMNS numbers m, and the least squares of an
edit is linear in what is asked. So with B the sensitivities at the sample, W its weights and Y what each number of m
asks of each point along the normal,

    x = X m,    X = B^T W^1/2 a,    a the dual solution of  (B^T W B + damping) X = B^T W Y

and the drawn vertices go out by U m, U = B(vertices) X. An edit of several parts, each of which makes up for what those
before have missed, is linear as well [implicit.edits.expressibility]; three are taken here as in the edit itself.

Where the model ends is measured at some points of the sample in each frame: how far the surface of theta + x lies from
where the model says. The share of that in the motion grows with the motion, so the motion is shortened to where it is
MOST_ERROR.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor

import implicit
from compare.editor.motion import COLUMNS, Motion
from compare.editor.regions import Picked, Role, held
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import StepProblem, assemble
from implicit.surface.projection import newton_to_surface

# Damping relative to the trace, at which least is missed between the points that carry the target (1e-4 and 1e-6 miss
# more on the cow), and the parts of an edit.
DAMPING = 1e-5
PARTS = 3

# Entries of B up to which the dual system is made of it.
DENSE_ENTRIES = 40_000_000

# Share of the motion, root mean square, by which the true surface may miss the model, and the points that tell.
MOST_ERROR = 0.3
PROBES = 160
LEAST_FRACTION = 0.02


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface as it is drawn.

    Attributes:
        V: Vertices on the surface (n, 3), in the field's coordinates.
        F: Triangles.
        N: Outward unit normals at the vertices.
        areas: Area that belongs to each vertex.
    """

    V: Float[ndarray, "n 3"]
    F: Int[ndarray, "m 3"]
    N: Float[ndarray, "n 3"]
    areas: Float[ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Missed:
    """Prediction of what a field cannot do of a motion, before any edit.

    Attributes:
        share: Root of the share of the squared target that will be missed: 0 for all met, 1 for nothing met.
        largest: Largest miss at a vertex, over the largest target.
        worst: Vertex (3,) where that is.
        error: Predicted minus wanted motion along the normal over the largest wanted one, at each vertex.
    """

    share: float
    largest: float
    worst: tuple[float, float, float]
    error: Float[ndarray, " n"]

    def sentence(self) -> str:
        """Return the prediction in words."""
        if self.share < 0.1:
            return f"This network can make that: {100 * self.share:.2g} % will be missed."
        at = ", ".join(f"{x:.2f}" for x in self.worst)
        return (
            f"This network cannot make that: {100 * self.share:.2g} % will be missed, most at ({at}), by "
            f"{100 * self.largest:.2g} % of the drag."
        )


@dataclass(frozen=True, eq=False)
class Preview:
    """A frame of a drag.

    Attributes:
        V: Vertices where the linear model takes them (n, 3).
        fraction: Part of the motion that is shown: 1, or less where the linear model ends before.
        error: Root mean square of the miss of the model over the motion that was asked for; NaN where it lost the
            surface.
        missed: What the field cannot do of the motion.
    """

    V: Float[ndarray, "n 3"]
    fraction: float
    error: float
    missed: Missed

    @property
    def capped(self) -> bool:
        """Return whether the motion is longer than the linear model holds."""
        return self.fraction < 1

    def sentence(self) -> str:
        """Return what is shown, in words."""
        if not self.capped:
            return self.missed.sentence()
        return (
            f"The preview ends at {100 * self.fraction:.0f} % of the drag, where the linear model does; the edit on "
            f"release goes all the way. {self.missed.sentence()}"
        )


class LinearModel:
    """The linear model of an edit of some regions.

    Args:
        field: The field as it is.
        sample: Points of its surface that carry the target.
        surface: The same surface, as drawn.
        regions: What moves with the hand, and what is held.
        rest: "fixed" where the rest of the surface is to stay, as in geometric edits; "free" as in semantic ones.
        hold: Of "volume" and "area", what is held to first order.

    Raises:
        ValueError: A region holds no point of the surface, or the field's gradient vanishes there.
    """

    def __init__(
        self,
        field: implicit.Field,
        sample: implicit.SurfaceSample,
        surface: Surface,
        regions: Sequence[Picked],
        *,
        rest: str = "fixed",
        hold: Sequence[str] = (),
    ) -> None:
        self.field, self.sample, self.surface, self.regions = field, sample, surface, tuple(regions)
        moving = region_weights(regions, "moves", sample.points)
        if not bool((moving > 0).any()):
            raise ValueError(
                "No point of the surface lies in a region that moves. Pick one on the shape, or a larger one."
            )
        anchored = region_weights(regions, "held", sample.points)
        weights = sample.weights if rest == "fixed" else ((moving > 0) | (anchored > 0)).to(sample.weights)
        self.grip = next(picked.grip for picked in regions if picked.role == "moves")
        asked = _asked(sample.points, sample.normals, moving, self.grip)
        self.changes = _solved(field, sample, weights, asked, _Held(surface, hold))
        V, N = (torch.from_numpy(x).to(field.theta) for x in (surface.V, surface.N))
        lengths = field.gradient_length(field.gradient(V))
        columns = [implicit.normal_displacement(field, V, x, lengths) for x in self.changes.T.contiguous()]
        self.speeds: Float[ndarray, "n c"] = torch.stack(columns, dim=1).double().numpy()
        self.wanted: Float[ndarray, "n c"] = (
            _asked(V, N, region_weights(regions, "moves", V), self.grip).double().numpy()
        )
        counted = surface.areas.copy()
        if rest == "free":
            anchors = region_weights(regions, "held", V).numpy()
            counted = counted * ((self.wanted[:, -1] > 0) | (anchors > 0))
        self._counted = counted
        strongest = torch.argsort(moving, descending=True)[:PROBES]
        self._probes = sample.points[strongest], sample.normals[strongest]
        own = [implicit.normal_displacement(field, self._probes[0], x) for x in self.changes.T.contiguous()]
        self._probe_speeds = torch.stack(own, dim=1)

    def change(self, motion: Motion) -> Tensor:
        """Return the change of theta (P,) that a motion makes to first order."""
        return self.changes @ torch.from_numpy(motion.column()).to(self.changes)

    def speed(self, motion: Motion) -> Float[ndarray, " n"]:
        """Return how far each drawn vertex goes out along its normal, a length."""
        return self.speeds @ motion.column()

    def missed(self, motion: Motion) -> Missed:
        """Return what the field cannot do of a motion, as far as the linear model tells."""
        wanted = self.wanted @ motion.column()
        miss, largest = self.speed(motion) - wanted, float(np.abs(wanted).max())
        miss = np.where(self._counted > 0, miss, 0.0)
        if largest == 0:
            return Missed(0.0, 0.0, self.grip, np.zeros_like(miss))
        worst = int(np.abs(miss).argmax())
        share = float((self._counted @ miss**2 / (self._counted @ wanted**2)) ** 0.5)
        x, y, z = self.surface.V[worst].tolist()
        return Missed(share, float(abs(miss[worst])) / largest, (x, y, z), miss / largest)

    def preview(self, motion: Motion) -> Preview:
        """Return the frame of a drag: where the vertices go, as far as the linear model holds."""
        error = self._error(motion)
        fraction = 1.0
        if not error <= MOST_ERROR:
            # Where points are lost the share says nothing; then a quarter is tried, and a quarter of that.
            fraction = MOST_ERROR / error if np.isfinite(error) else self._found_again(motion)
        speed = fraction * self.speed(motion)
        V = self.surface.V + speed[:, None] * self.surface.N
        return Preview(V, fraction, error, self.missed(motion))

    def _found_again(self, motion: Motion) -> float:
        fraction = 0.25
        while fraction > LEAST_FRACTION:
            error = self._error(motion, fraction)
            if np.isfinite(error):
                return fraction * min(1.0, MOST_ERROR / max(error, 1e-12))
            fraction /= 4
        return LEAST_FRACTION

    def _error(self, motion: Motion, fraction: float = 1.0) -> float:
        """Return by which share of the motion the true surface misses the model; NaN where points are lost."""
        points, normals = self._probes
        along = fraction * (self._probe_speeds @ torch.from_numpy(motion.column()).to(self._probe_speeds))
        size = float(along.square().mean().sqrt())
        if size == 0:
            return 0.0
        moved = self.field.with_theta(self.field.theta + fraction * self.change(motion))
        predicted = points + along[:, None] * normals
        if not bool(torch.isfinite(moved.theta).all() and torch.isfinite(predicted).all()):
            return float("nan")
        reach = 2 * float(along.abs().max()) + 0.02 * self.field.size
        found, arrived = newton_to_surface(moved, predicted, reach=min(reach, self.field.size), iterations=12)
        if float(arrived.double().mean()) < 0.98:
            return float("nan")
        miss = (found - predicted)[arrived].square().sum(dim=1).mean().sqrt()
        return float(miss) / size


def region_weights(regions: Sequence[Picked], role: Role, points: Tensor) -> Tensor:
    """Return the sum of the weights (N,) of the regions of a role at points (N, 3)."""
    total = torch.zeros_like(points[:, 0])
    for picked in regions:
        if picked.role == role:
            total = total + held(picked.region).build().weights(points)
    return total


def _asked(points: Tensor, normals: Tensor, weights: Tensor, grip: Sequence[float]) -> Tensor:
    """Return the displacement along the normal (N, C) that each number of a motion asks of each point."""
    away = points - points.new_tensor(grip)
    turned = (normals[:, :, None] * away[:, None, :]).flatten(1)
    asked = torch.cat([turned, normals, torch.ones_like(weights)[:, None]], dim=1)
    assert asked.shape[1] == COLUMNS
    return weights[:, None] * asked


def _solved(
    field: implicit.Field,
    sample: implicit.SurfaceSample,
    weights: Tensor,
    asked: Tensor,
    held: _Held,
) -> Tensor:
    """Return the changes of theta (P, C) that come nearest to what is asked, those that hold what is held."""
    used = weights > 0
    points, weights, asked = sample.points[used], weights[used], asked[used]
    if len(points) * len(field.theta) > DENSE_ENTRIES:
        return _solved_one_by_one(field, points, weights, asked)
    rows = implicit.basis(field, points) * weights.sqrt()[:, None]
    rows = rows.double()
    gram = rows @ rows.T
    damping = DAMPING * float(gram.trace())
    if not np.isfinite(damping) or damping <= 0:
        raise ValueError("The parameters do not move the surface there, or its gradient vanishes. Pick another region.")
    factor = torch.linalg.cholesky(gram + damping * torch.eye(len(gram), dtype=torch.float64))
    target = (asked * weights.sqrt()[:, None]).double()
    dual = torch.zeros_like(target)
    for part in range(1, PARTS + 1):
        dual = dual + torch.cholesky_solve(target * part / PARTS - gram @ dual, factor)
    changes = rows.T @ dual
    if held.names:
        # The least change of the objective that the sample's points see, as far as the whole surface asks for it.
        away = rows.T @ torch.cholesky_solve(held.curvatures(field, points) * weights.sqrt()[:, None].double(), factor)
        rates = held.rates(field)
        changes = changes - away @ torch.linalg.lstsq(rates @ away, rates @ changes).solution
    return changes.to(sample.points)


@dataclass(frozen=True, eq=False)
class _Held:
    """Volume and area, held to first order: their rates are integrals of 1 and of kappa times b [paper, eq. 7].

    Attributes:
        surface: On which they are integrated.
        names: Of "volume" and "area".
    """

    surface: Surface
    names: Sequence[str]

    def curvatures(self, field: implicit.Field, points: Tensor) -> Tensor:
        """Return what the speed of each point (N, H) is weighed by in the rates."""
        ones = torch.ones_like(points[:, 0])
        parts = [ones if name == "volume" else field.mean_curvature(points) for name in self.names]
        return torch.stack(parts, dim=1).double()

    def rates(self, field: implicit.Field) -> Tensor:
        """Return the rates (H, P) for each parameter."""
        V, areas = (torch.from_numpy(x).to(field.theta) for x in (self.surface.V, self.surface.areas))
        weighed = self.curvatures(field, V).to(areas) * areas[:, None]
        return torch.stack([implicit.adjoint(field, V, column) for column in weighed.T.contiguous()]).double()


def _solved_one_by_one(field: implicit.Field, points: Tensor, weights: Tensor, asked: Tensor) -> Tensor:
    """Return the same of a field of so many parameters that its rows do not fit in memory, nothing held."""
    changes = []
    for target in asked.T.contiguous():
        system = assemble(StepProblem(DeformationSpace(field), [NormalTarget(points, target, weights)]))
        changes.append(system.solve(relative_damping=DAMPING).x)
    return torch.stack(changes, dim=1)
