"""The paper's own method for a rigid step: a second network for the motion along the surface, trained [section 4.3].

    D(x) = n u + (I - n n^T) T(x),    u = b . d_theta,    T a sine network R^3 -> R^3

d_theta and the weights of T are trained together, by Adam on E_K + alpha E_C. What the parameters of the field
contribute, u and its slope, is linear in d_theta and computed once; the network's Jacobian is computed anew in each
iteration. `rigid_edit` puts a linear basis in T's place, which makes the whole one least squares; `trained_rigid_step`
solves that too, on the same points, and gives both energies.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.func import jvp, vmap

from implicit.arguments import require_whole
from implicit.edits.handles import Handle
from implicit.edits.rigid import RigidSettings, prepare
from implicit.evolve.operation import State
from implicit.field.field import Field, require_field
from implicit.models.siren import Siren
from implicit.sensitivity.boundary_sensitivity import normal_displacement
from implicit.sensitivity.frame import Frame, speed_and_slope
from implicit.step.energies import Killing, VectorTarget, total_energy
from implicit.step.least_squares import LeastSquares
from implicit.step.tangential_basis import TangentialModel
from implicit.surface.quadrature import SurfaceSample

# Adam knows no scale: handles are trained as if the longest motion were this part of the field's size, which the rates
# below suit, and the result is scaled back. The step is linear, and so is the network's last layer.
MOTION = 0.05

# Adam's step lengths at the start, of the network's weights and of the field's parameters; they fall to zero by half a
# cosine. Of the bundled cow's step, with 200 to 2000 iterations: 1e-4 for the field stays ten times above the least
# squares, 1e-3 for both 3.2 (200) and 1.65 times (1000), these 1.39 times (2000).
NETWORK_RATE = 2e-3
FIELD_RATE = 3e-3


class TrainingStatus(Enum):
    """End of a training; the value is the sentence a user reads."""

    TRAINED = "All iterations were taken."
    NOT_FINITE = "The training ran into numbers that are not finite; the weights are those of the iteration before."


@dataclass(frozen=True, eq=False, repr=False)
class TrainedStep:
    """One linear step of a rigid edit by a trained network, beside the least squares on the same points.

    Attributes:
        field: The unedited field, in float64 like all that follows.
        d_theta: Add it to field.theta.
        network: T, points (N, 3) to vectors (N, 3); its projection to the tangent plane counts.
        energy, strain: E_K + alpha E_C, and E_K alone, of the trained motion.
        linear_energy, linear_strain: The same of the least squares over d_theta and the linear tangential basis.
        losses: E_K + alpha E_C in each iteration.
        seconds, linear_seconds: Wall time of the training and of the least squares, each with its derivatives.
        status: End of the training.
    """

    field: Field
    d_theta: Float[Tensor, " p"]
    network: Siren
    energy: float
    strain: float
    linear_energy: float
    linear_strain: float
    losses: list[float]
    seconds: float
    linear_seconds: float
    status: TrainingStatus

    def __repr__(self) -> str:
        precision = str(self.d_theta.dtype).removeprefix("torch.")
        return (
            f"TrainedStep: {self.status.name}, iterations {len(self.losses):,}, of {len(self.d_theta):,} parameters "
            f"({precision}, {self.d_theta.device})\n"
            f"  energy {self.energy:.4g}, of it strain {self.strain:.4g}, in {self.seconds:.3g} s; least squares: "
            f"{self.linear_energy:.4g}, {self.linear_strain:.4g}, {self.linear_seconds:.3g} s"
        )

    def displacement(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Return D at surface points (N, 3), a length."""
        n = self.field.normal(points)
        with torch.no_grad():
            T = self.network(points)
        return T + n * (normal_displacement(self.field, points, self.d_theta) - (n * T).sum(dim=1))[:, None]


def trained_rigid_step(
    field: Field,
    handles: Sequence[Handle],
    *,
    iterations: int = 2000,
    alpha: float = 1e3,
    bending: float = 0.1,
    thickness: float = 0.0,
    width: int = 32,
    depth: int = 3,
    tangential: TangentialModel | None = None,
    points: int | SurfaceSample = 1000,
    seed: int = 0,
    progress: Callable[[int, int, float], None] | None = None,
) -> TrainedStep:
    """Take one step of a rigid edit with a trained network for the motion along the surface.

    Args:
        field: A field in 3D. It is not changed: the step is d_theta of the result.
        handles, alpha, bending, thickness, points, seed: See rigid_edit. The seed is that of the network too. Four
            numbers a point and parameter are kept throughout.
        iterations: Number of iterations of Adam. The energy still falls, slowly, after thousands.
        width, depth: Size and number of the network's hidden layers.
        tangential: Basis of the least squares beside it; None takes CosineFeatures(field).
        progress: Called after each iteration with its number, the number of iterations and the energy, of the motion
            as scaled for the training.

    Raises:
        ValueError: As rigid_edit, or there are no iterations.
    """
    for name, value in (("iterations", iterations), ("width", width), ("depth", depth)):
        require_whole(name, value)
    precise = require_field(field).to(torch.float64)
    settings = RigidSettings(alpha=alpha, bending=bending, thickness=thickness, seed=seed)
    operation = prepare(precise, handles, settings, tangential, points)
    sample = operation.sample
    problem = operation.step(State(precise, 0, sample.points, len(sample), None))
    strain, reach = problem.energies
    assert isinstance(strain, Killing)
    assert isinstance(reach, VectorTarget)

    clock = time.perf_counter()
    system = LeastSquares(problem.space.size, precise.theta)
    for energy in problem.energies:
        for rows in energy.rows(problem.space):
            system.add(rows)
    linear = system.solve(relative_damping=problem.damping.first)
    linear_seconds = time.perf_counter() - clock

    clock = time.perf_counter()
    network = vector_siren(width, depth, seed)
    energies = StepEnergies.at(precise, strain, reach, operation.targets.prescribed)
    scale = float(reach.target.norm(dim=1).max()) / (MOTION * precise.size) or 1.0  # 1 where all handles are anchors
    # In single precision, as trainings are; the energies of the result are taken in double.
    unit = replace(energies, target=energies.target / scale).to(torch.float32)
    d_theta, losses, status = _train(network, unit, iterations, progress)
    with torch.no_grad():
        for parameter in network.layers[-1].parameters():
            parameter.mul_(scale)
    seconds = time.perf_counter() - clock

    network = network.to(torch.float64)
    d_theta = scale * d_theta.to(torch.float64)
    with torch.no_grad():
        T, dT = value_and_slope(network, sample.points)
        E_K, E_C = (float(energy) for energy in energies.values(d_theta, T, dT))
    return TrainedStep(
        field=precise,
        d_theta=d_theta,
        network=network,
        energy=E_K + E_C,
        strain=E_K,
        linear_energy=linear.objective,
        linear_strain=total_energy([strain], problem.space, linear.x),
        losses=[scale**2 * loss for loss in losses],
        seconds=seconds,
        linear_seconds=linear_seconds,
        status=status,
    )


class LearnedFeatures:
    """1, the coordinates, and the last hidden layer of a trained network, as a basis for rigid_edit(tangential=...).

    The network's own field is among those that they span, so the least squares over them is at least as good.

    Args:
        network: The network of a TrainedStep.
    """

    def __init__(self, network: Siren) -> None:
        if not isinstance(network, Siren):
            raise TypeError(f"network must be that of a TrainedStep, but is a {type(network).__name__}.")
        last = network.layers[-1]
        assert isinstance(last, nn.Linear)
        self._network, self._count = network, 4 + last.in_features

    @property
    def count(self) -> int:
        """Return the number of basis functions."""
        return self._count

    def values(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n k"]:
        """Return the basis functions at the points."""
        with torch.no_grad():
            return self._functions(points)

    def slopes(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3 k"]:
        """Return their gradients at the points."""
        with torch.no_grad():
            return value_and_slope(self._functions, points)[1].transpose(1, 2)

    def _functions(self, points: Tensor) -> Tensor:
        h = points
        for number, layer in enumerate(self._network.layers[:-1]):
            h = self._network.activate(number, layer(h))
        return torch.cat([torch.ones_like(points[:, :1]), points, h], dim=1)


@dataclass(frozen=True, eq=False)
class StepEnergies:
    """E_K and E_C of one step for any tangential motion given with its slope; they can be differentiated."""

    points: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"]
    normal_slopes: Float[Tensor, "n 3 3"]
    axes: Float[Tensor, "n 3 3"]  # rows: two tangents, then the normal
    speeds: Float[Tensor, "n 4 p"]  # u and its three slopes, for each parameter
    weights: Float[Tensor, " n"]
    shares: Float[Tensor, "3 3"]  # weights of the entries of J + J^T, in the axes
    target_weights: Float[Tensor, " n"]  # zero where there is none
    target: Float[Tensor, "n 3"]

    @classmethod
    def at(cls, field: Field, strain: Killing, reach: VectorTarget, where: Tensor) -> StepEnergies:
        """Return the field's derivatives at the points that carry the strain; `where` marks those of the target."""
        frame = Frame.at(field, strain.points)
        speeds = speed_and_slope(field, frame)
        weights, target = torch.zeros_like(strain.weights), torch.zeros_like(strain.points)
        weights[where], target[where] = reach.weights, reach.target
        shares = [[strain.share(min(a, b), max(a, b), 2) for b in range(3)] for a in range(3)]
        return cls(
            strain.points,
            frame.normals,
            frame.normal_slopes,
            frame.axes,
            speeds,
            strain.weights,
            torch.tensor(shares, dtype=torch.float64).to(speeds),
            weights,
            target,
        )

    def to(self, dtype: torch.dtype) -> StepEnergies:
        """Return the same in another precision."""
        return StepEnergies(*(getattr(self, part.name).to(dtype) for part in fields(self)))

    def values(
        self, d_theta: Float[Tensor, " p"], T: Float[Tensor, "n 3"], dT: Float[Tensor, "n 3 3"]
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """Return E_K and alpha E_C of D = T + n s, s = u - n . T, where dT[:, i, j] is dT_i/dx_j.

        See implicit.step.deformation.
        """
        speeds = self.speeds @ d_theta
        n = self.normals
        s = speeds[:, 0] - (n * T).sum(dim=1)
        ds = speeds[:, 1:] - torch.einsum("nij,ni->nj", self.normal_slopes, T) - torch.einsum("nij,ni->nj", dT, n)
        J = dT + n[:, :, None] * ds[:, None, :] + s[:, None, None] * self.normal_slopes
        strain = self.axes @ (J + J.transpose(1, 2)) @ self.axes.transpose(1, 2)
        E_K = (self.weights[:, None, None] * self.shares * strain.square()).sum()
        E_C = (self.target_weights[:, None] * (T + n * s[:, None] - self.target).square()).sum()
        return E_K, E_C


def vector_siren(width: int, depth: int, seed: int) -> Siren:
    """Return a sine network R^3 -> R^3 that is zero at the start."""
    network = Siren(3, width, depth, generator=torch.Generator().manual_seed(seed))
    network.layers[-1] = nn.Linear(width, 3)
    for parameter in network.layers[-1].parameters():
        nn.init.zeros_(parameter)
    return network


def value_and_slope(
    function: Callable[[Tensor], Tensor], points: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "n k"], Float[Tensor, "n k 3"]]:
    """Return T and dT_i/dx_j at the points, by one forward derivative along each axis."""

    def along(axis: Tensor) -> tuple[Tensor, Tensor]:
        return jvp(function, (points,), (axis.expand_as(points),))  # type: ignore[return-value]

    values, slopes = vmap(along)(torch.eye(3, dtype=points.dtype, device=points.device))
    return values[0], slopes.permute(1, 2, 0)


def _train(
    network: nn.Module, energies: StepEnergies, iterations: int, progress: Callable[[int, int, float], None] | None
) -> tuple[Tensor, list[float], TrainingStatus]:
    """Train the network in place, and d_theta with it."""
    d_theta = torch.zeros_like(energies.speeds[0, 0]).requires_grad_()
    unknowns = [d_theta, *network.parameters()]
    optimiser = torch.optim.Adam(
        [{"params": [d_theta], "lr": FIELD_RATE}, {"params": list(network.parameters()), "lr": NETWORK_RATE}]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    losses: list[float] = []
    kept = [unknown.detach().clone() for unknown in unknowns]
    for iteration in range(1, iterations + 1):
        E_K, E_C = energies.values(d_theta, *value_and_slope(network, energies.points))
        loss = E_K + E_C
        value = float(loss.detach())
        if not math.isfinite(value):
            with torch.no_grad():
                for unknown, before in zip(unknowns, kept, strict=True):
                    unknown.copy_(before)
            return d_theta.detach(), losses, TrainingStatus.NOT_FINITE
        kept = [unknown.detach().clone() for unknown in unknowns]
        losses.append(value)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        if progress is not None:
            progress(iteration, iterations, value)
    return d_theta.detach(), losses, TrainingStatus.TRAINED
