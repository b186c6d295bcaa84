"""Fit a neural field to a mesh: distances and normals from the mesh, training by `implicit`, and a report of how good it is.

The mesh is mended, moved and scaled uniformly so that its box is centred and its longest side is 1.6: the field lives
in [-1, 1]^3. `field.units` is the way back to the user's coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

import implicit
import meshref
from implicit.field import Field, Units
from implicit.fit import Training, fit_field

SIDE = 1.6  # longest side of the mesh's box in the field's coordinates

# What a fit must reach to be called good: mean distance in parts of the box's diagonal, volume error in parts of
# the volume. Beyond, the errors of a study would be those of the fit.
GOOD_DISTANCE = 0.004
GOOD_VOLUME = 0.01


@dataclass(frozen=True)
class FitReport:
    """How well a field fits its mesh. Lengths are relative to the diagonal of the mesh's box unless they say otherwise."""

    mended: tuple[str, ...]  # what was done to the mesh, in sentences
    good: bool  # whether all of the stated quality is met
    verdict: str  # the same in words, and why
    mean_distance: float  # mean of both mean distances (Chamfer) between the field's surface and the mesh
    max_distance: float  # Hausdorff distance, both ways
    mean_distance_user: float  # the two above in the user's units
    max_distance_user: float
    mean_value: float  # |f| at points of the mesh
    max_value: float
    normal_error: float  # mean angle between the field's gradient and the mesh's normal at points of the mesh, degrees
    samples: int  # points drawn on each surface for the figures above
    volume_error: float  # (field - mesh) / mesh
    area_error: float
    gradient_mean: float  # |grad f| within 2 % of the diagonal of the surface, where a distance has 1
    gradient_low: float  # its 1st percentile
    gradient_high: float  # its 99th percentile
    components: int  # of the field's surface in its bounds
    components_mesh: int
    genus: int | None  # of the field's surface, all components together
    genus_mesh: int
    diagonal: float  # of the mesh's box, in the user's units
    scale: float  # user's coordinates = scale * field's coordinates + offset
    offset: tuple[float, float, float]
    parameters: int
    steps: int
    seconds: float  # all of it: mending, sampling, training and this report
    seconds_training: float
    seed: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def fit_mesh(
    V: Float[ndarray, "n 3"],
    F: Int[ndarray, "m 3"],
    *,
    width: int = 32,
    depth: int = 3,
    seed: int = 0,
    progress: Callable[[int, int, float], None] | None = None,
    **options: Any,
) -> tuple[Field, FitReport]:
    """A neural field with the mesh as its zero set, and how good it is."""
    start = perf_counter()
    V, F, mending = meshref.mend_mesh(V, F)
    lower, upper = V.min(axis=0), V.max(axis=0)
    units = Units(float((upper - lower).max()) / SIDE, tuple(((lower + upper) / 2).tolist()))
    V = (V - np.asarray(units.offset)) / units.scale
    query = meshref.SignedDistanceQuery(V, F)
    points = _sample(V, F, seed)
    answer = query(points)
    as_tensor = lambda a: torch.from_numpy(np.ascontiguousarray(a))  # noqa: E731
    field, training = fit_field(
        as_tensor(points),
        as_tensor(answer.distance),
        as_tensor(answer.normal),
        width=width,
        depth=depth,
        seed=seed,
        progress=progress,
        units=units,
        **options,
    )
    return field, _report(field, training, V, F, query, mending.steps, seed, start)


def _sample(V, F, seed):
    rng = np.random.default_rng(seed)
    surface = meshref.sample_mesh(V, F, 60_000, seed).points
    near = [
        meshref.sample_mesh(V, F, 50_000, seed + 1 + k).points + rng.normal(0, spread, (50_000, 3))
        for k, spread in enumerate((0.005, 0.02, 0.06))
    ]
    return np.concatenate([surface, *near, rng.uniform(-1.1, 1.1, (40_000, 3))])


def _report(field, training: Training, V, F, query, mended, seed, start, samples=20_000) -> FitReport:
    diagonal = float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
    on = meshref.sample_mesh(V, F, samples, seed + 1000)
    f, g = field.value_and_gradient(torch.from_numpy(on.points).to(field.theta))
    length = g.norm(dim=1)
    cosine = (g.double().numpy() * on.normals).sum(axis=1) / length.double().numpy()
    normal_error = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
    V2, F2 = implicit.extract_mesh(field, 128)
    distance = meshref.surface_distance(V2, F2, V, F, samples, seed)
    volume_error = meshref.volume(V2, F2) / meshref.volume(V, F) - 1
    area_error = meshref.area(V2, F2) / meshref.area(V, F) - 1
    near = torch.from_numpy(on.points + np.random.default_rng(seed).normal(0, 0.01 * diagonal, on.points.shape))
    near_length = field.gradient(near.to(field.theta)).norm(dim=1).double()
    components, components_mesh = meshref.component_count(V2, F2), meshref.component_count(V, F)
    genus, genus_mesh = meshref.genus(V2, F2), meshref.genus(V, F)
    mean = distance.chamfer / diagonal
    faults = []
    if mean > GOOD_DISTANCE:
        faults.append(f"the mean distance is {mean:.2%} of the diagonal, above {GOOD_DISTANCE:.1%}")
    if abs(volume_error) > GOOD_VOLUME:
        faults.append(f"the volume is off by {volume_error:+.1%}")
    if components != components_mesh:
        faults.append(f"the field has {components} bodies and the mesh {components_mesh}")
    if genus != genus_mesh:
        faults.append(f"the field has genus {genus} and the mesh {genus_mesh}")
    scale = units_scale = field.units.scale
    return FitReport(
        mended=tuple(mended),
        good=not faults,
        verdict=("Below quality: " + "; ".join(faults) + ". Allow more steps or a wider network.")
        if faults
        else f"Good: mean distance {mean:.3%} of the diagonal.",
        mean_distance=mean,
        max_distance=distance.hausdorff / diagonal,
        mean_distance_user=distance.chamfer * scale,
        max_distance_user=distance.hausdorff * scale,
        mean_value=float(f.abs().mean()) / diagonal,
        max_value=float(f.abs().max()) / diagonal,
        normal_error=normal_error,
        samples=samples,
        volume_error=volume_error,
        area_error=area_error,
        gradient_mean=float(near_length.mean()),
        gradient_low=float(near_length.quantile(0.01)),
        gradient_high=float(near_length.quantile(0.99)),
        components=components,
        components_mesh=components_mesh,
        genus=genus,
        genus_mesh=genus_mesh,
        diagonal=diagonal * units_scale,
        scale=units_scale,
        offset=field.units.offset,  # type: ignore[arg-type]
        parameters=field.theta.numel(),
        steps=training.steps,
        seconds=perf_counter() - start,
        seconds_training=training.seconds,
        seed=seed,
    )
