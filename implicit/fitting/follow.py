"""A field brought to where its surface is to be: trained, from where it stands, on samples of the map of its surface.

With v and g the wanted value and gradient of a sample, d its distance from the wanted surface and s the median slope of
the field, the loss is that of implicit.fitting.fit in units of s,

    w(d)^2 (f(x) - v)^2 / s^2  +  band^2 |df/dx - g|^2 / s^2  where |d| < band,     w(d) = band / (band + |d|)

so that it takes any field, whatever its module, and whatever its values are off the surface. Linear layers are moved by
SOAP, all else by Adam. It starts where the surface has been brought as a whole, so that a tenth of the steps of a fit
from scratch do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor, nn

from implicit.arguments import require_choice, require_whole
from implicit.field.field import Field, require_field
from implicit.fitting.carried_samples import CarriedSamples, carried_samples
from implicit.fitting.subjects import StartedField
from implicit.fitting.training import FitStatus, Schedule, TrainingRun
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.step.surface_map import SurfaceMap
from implicit.surface.projection import newton_to_surface

Values = Literal["auto", "distance", "carried"]

# Part of a batch that is drawn within the band and compared in its gradient too, which costs twice a value.
NEAR_PART = 0.25

# Band about the surface, over the field's size, as in implicit.fitting.fit.
BAND = 0.01

# A field whose slope on its surface is that near to 1, at the 5th and 95th percentile, is taken for a distance.
DISTANCE_SLOPE = 0.25

# Largest learning rates of linear layers and of all else, and those where the surface starts within NEARBY of where it
# is to be (root mean square over the field's size): there the larger ones only stir up what is in place already. On the
# bundled cow pulled by 15 % they leave the same strain after 150 steps, and two thirds of it after 150 steps and two
# steps of boundary sensitivity.
RATES = (3e-3, 3e-3)
RATES_NEARBY = (1e-3, 1e-3)
NEARBY = 0.015

# Root mean square distance of the surface from where it is to be, over the field's size, up to which it has followed.
FOLLOWED = 2e-3


@dataclass(frozen=True)
class Following:
    """Course of a field brought to a deformed surface, and how near it came.

    Attributes:
        values: "distance" or "carried": what the field was brought to off the surface.
        steps: Of the optimiser.
        seconds: Wall time.
        miss_rms, miss_max: Distance of the field's surface from the wanted one, a length: root mean square and largest
            over samples of it. Where a sample finds no surface near it, it counts as far as was looked.
        lost: Part of the samples that found none.
        crossed: Part of the wanted surface that lies inside another part of it: no field has such a surface.
        status: How the training ended.
    """

    values: str
    steps: int
    seconds: float
    miss_rms: float
    miss_max: float
    lost: float
    crossed: float
    status: FitStatus


def follow_surface(
    field: Field,
    vertices: Float[ndarray, "v 3"],
    faces: Int[ndarray, "m 3"],
    positions: Float[ndarray, "v 3"],
    *,
    rotations: Float[ndarray, "v 3 3"] | None = None,
    values: Values = "auto",
    start: Field | None = None,
    samples: int = 40_000,
    steps: int = 500,
    batch: int = 2048,
    seed: int = 0,
    progress: Callable[[int, int, float], None] | None = None,
) -> tuple[Field, Following]:
    """Bring a field to where a mesh of its surface is to be, however far that is.

    Args:
        field: Any field in 3D; it stays as it is.
        vertices: Mesh of its surface (V, 3), as by extract_mesh, with sides as short as the deformation needs.
        faces: Its triangles (m, 3).
        positions: Where the vertices are to be (V, 3).
        rotations: How the surface about each vertex turns (V, 3, 3); None takes the best of its neighbours.
        values: What the field is to be off the surface: "distance", its own values "carried" along with it, or "auto":
            a distance where its slope on the surface is near to 1.
        start: The field with the parameters to start from, such as those after the rigid motion that goes nearest;
            None is the field itself.
        samples: Points of the surface; more than twice as many again are drawn off it.
        steps: Of the optimiser.
        batch: Samples drawn for each.
        seed: Of the samples and the batches.
        progress: Called as progress(step, steps, loss) up to 100 times.

    Returns:
        The field, and how near it came.

    Raises:
        ValueError: The arrays do not fit each other or are not finite, or the field cannot be trained.
    """
    for name, number in (("samples", samples), ("steps", steps), ("batch", batch)):
        require_whole(name, number, 4 if name == "batch" else 1)
    require_choice("values", values, ("auto", "distance", "carried"))
    if require_field(field).dimension != 3:
        raise ValueError(f"follow_surface needs a field in 3 dimensions, but this one has {field.dimension}.")
    rest = WeakSurface(*_checked_mesh(vertices, faces))
    moved = _checked("positions", positions, rest.vertices.shape)
    if rotations is None:
        turns = SpokesAndRims(rest.vertices, rest.faces).rotations(moved)
    else:
        turns = _checked("rotations", rotations, (len(moved), 3, 3))
    follower = Follower(
        field,
        SurfaceMap(rest, moved, turns),
        values=values,
        start=field if start is None else start,
        samples=samples,
        batch=batch,
        seed=seed,
    )
    return follower.train(steps, progress)


class Follower:
    """A field on its way to where a map takes its surface; see follow_surface for the arguments.

    Args:
        field: Whose surface the map begins from.
        surface_map: Where it goes.
        values, start, samples, batch, seed: As for follow_surface.

    Raises:
        ValueError: The field cannot be trained.
    """

    def __init__(
        self,
        field: Field,
        surface_map: SurfaceMap,
        *,
        values: Values,
        start: Field,
        samples: int,
        batch: int,
        seed: int,
    ) -> None:
        self._began = perf_counter()
        self._field, self._seed = field, seed
        as_distance = values == "distance" or (values == "auto" and is_distance(field, surface_map.rest))
        self._values = "distance" if as_distance else "carried"
        self._wanted = carried_samples(field, surface_map, samples, as_distance=as_distance, seed=seed)
        middle, half = field.bounds.mean(dim=0), field.size / 2
        self._subject = StartedField(field.with_theta(start.theta), middle, half)
        self._subject.require_derivatives((self._wanted.points[: min(batch, 16)] - middle) / half)
        self._learner = _Wanted(self._subject, self._wanted, batch, half)
        apart, _, _ = surface_miss(field.with_theta(start.theta), self._wanted)
        self._rates = RATES_NEARBY if apart <= NEARBY * field.size else RATES
        self._steps = 0

    @property
    def crossed(self) -> float:
        """Part of the wanted surface that lies inside another part of it."""
        return self._wanted.crossed

    def train(self, steps: int, progress: Callable[[int, int, float], None] | None = None) -> tuple[Field, Following]:
        """Return the field after so many steps more, and how near it came; the learning rate rises and falls once."""
        generator = torch.Generator().manual_seed(self._seed + self._steps)
        run = TrainingRun(self._learner, generator, Schedule(steps, *self._rates))
        status = run.train(progress)
        self._steps += run.step
        found = self._subject.field(self._field.bounds)
        miss = surface_miss(found, self._wanted)
        return found, Following(
            self._values, self._steps, perf_counter() - self._began, *miss, self._wanted.crossed, status
        )

    def judged(self, field: Field) -> Following:
        """Return how near another field comes to where this one is to be, as one that took no step of the optimiser."""
        miss = surface_miss(field.to(self._field.dtype), self._wanted)
        return Following("carried", 0, perf_counter() - self._began, *miss, self._wanted.crossed, FitStatus.DONE)


def is_distance(field: Field, surface: WeakSurface) -> bool:
    """Return whether the slope of a field on its surface is near to 1, all over."""
    some = surface.vertices[:: max(1, len(surface.vertices) // 1000)]
    slopes = field.gradient(torch.from_numpy(some).to(field.theta)).norm(dim=1).double()
    low, high = (float(torch.quantile(slopes, q)) for q in (0.05, 0.95))
    return low > 1 - DISTANCE_SLOPE and high < 1 + DISTANCE_SLOPE


def surface_miss(field: Field, wanted: CarriedSamples, count: int = 4000) -> tuple[float, float, float]:
    """Return how far a field's surface is from samples of the wanted one, and which part of them finds none.

    Returns:
        Root mean square and largest distance, lengths, and the part that is lost.
    """
    every = max(1, wanted.on_surface // count)
    goal = wanted.points[: wanted.on_surface : every]
    reach = field.size / 20
    found, arrived = newton_to_surface(field, goal, reach=reach, tolerance=1e-6 * field.size)
    apart = torch.where(arrived, (found - goal).norm(dim=1), reach)
    return float(apart.square().mean().sqrt()), float(apart.max()), float((~arrived).double().mean())


class _Wanted:
    """A field that learns the samples of another surface, its losses reported as lengths."""

    def __init__(self, subject: StartedField, wanted: CarriedSamples, batch: int, half: float) -> None:
        self._subject, self._batch, self._half = subject, batch, half
        middle = subject.own.bounds.mean(dim=0)
        # The subject's coordinates are those of [-1, 1]^D, its values f over half the size.
        self._points = (wanted.points - middle) / half
        self._values = wanted.values / (half * wanted.slope)
        self._slope = wanted.slope
        distances = wanted.distances / half
        self._band = 2 * BAND
        self._weights = self._band / (self._band + distances.abs())
        self._near = (distances.abs() < self._band).nonzero()[:, 0]
        self._gradients = wanted.gradients / wanted.slope

    def modules(self) -> dict[str, nn.Module]:
        return self._subject.modules()

    def others(self) -> list[Tensor]:
        return self._subject.others()

    def loss(self, generator: torch.Generator) -> Tensor:
        near = max(1, int(self._batch * NEAR_PART))
        device = self._points.device
        i = torch.randint(len(self._points), (self._batch - near,), generator=generator).to(device)
        j = self._near[torch.randint(len(self._near), (near,), generator=generator).to(device)]
        x = self._points[j].requires_grad_()
        f = self._subject.value(x) / self._slope
        (gradient,) = torch.autograd.grad(f.sum(), x, create_graph=True)
        away = self._weights[i] * (self._subject.value(self._points[i]) / self._slope - self._values[i])
        errors = torch.cat([f - self._values[j], away])
        turns = (gradient - self._gradients[j]).square().sum(dim=1)
        return errors.square().mean() + self._band**2 * turns.mean()

    def reported(self, loss: Tensor) -> float:
        """Return the root of the loss, a length: the typical error near the surface."""
        return float(loss.sqrt()) * self._half


def _checked_mesh(vertices: ndarray, faces: ndarray) -> tuple[ndarray, ndarray]:
    V, F = np.asarray(vertices), np.asarray(faces)
    if V.ndim != 2 or V.shape[1] != 3 or V.dtype.kind != "f" or not np.isfinite(V).all():
        raise ValueError(
            f"vertices must be finite positions (V, 3), but are {V.dtype} of shape {V.shape}. Take those of "
            "extract_mesh."
        )
    if F.ndim != 2 or F.shape[1] != 3 or F.dtype.kind not in "iu" or len(F) == 0 or F.min() < 0 or F.max() >= len(V):
        raise ValueError(
            f"faces must be triangles (m, 3) of the {len(V)} vertices, but are {F.dtype} of shape {F.shape}. Take "
            "those of extract_mesh."
        )
    return V.astype(np.float64), F.astype(np.int64)


def _checked(name: str, array: ndarray, shape: tuple[int, ...]) -> ndarray:
    given = np.asarray(array)
    if given.shape != shape or given.dtype.kind != "f" or not np.isfinite(given).all():
        raise ValueError(
            f"{name} must be finite numbers of shape {shape}, one for each vertex, but are {given.dtype} of shape "
            f"{given.shape}. Mend them before the field follows."
        )
    return given.astype(np.float64)
