"""Fit a neural field to a mesh: samples from the mesh, training by `implicit`, and a report of how good it is.

The mesh is mended, moved and scaled uniformly so that its box is centred and its longest side is 1.6: the field lives
in [-1, 1]^3. `field.units` is the way back to the user's coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from time import perf_counter
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import nn

import implicit
import meshref
from compare.fitting.mending import Mending, mended
from implicit.field.field import Field, Units
from implicit.fitting.fit import FitStatus, Training, fit_field, require_training
from implicit.fitting.subjects import starting_field
from meshref.distance import SignedDistance
from meshref.printing import counted
from meshref.solids import hidden_points

SIDE = 1.6  # longest side of the mesh's box in the field's coordinates

# What a fit must reach to be called good. Beyond, the errors of a study would be those of the fit.
GOOD_DISTANCE = 0.004  # mean distance between the surfaces, in diagonals of the mesh's box
GOOD_VOLUME = 0.01  # error of the volume, relative

# With a budget, networks get wider up to this. A network twice as wide takes about 2.5 times as long; in less than this
# many times the last one's seconds, which then end it, it would come out no better.
WIDEST = 256
LEAST_SHARE_OF_A_WIDER_FIT = 1.5

# Samples on the surface; about it, moved by a normal random vector of each spread (in the field's units); and all over
# a cube a little larger than the bounds, one every 0.064, so that no stray piece of the field finds room.
ON_SURFACE = 60_000
ABOUT_SURFACE = ((50_000, 0.005), (50_000, 0.02), (50_000, 0.06))
IN_CUBE = 40_000
CUBE_REACH = 1.1

# Cells along the bounds: of the extracted mesh that distances, genus and bodies are measured on, and of the quadrature
# that volume and area come from. Flat triangles inscribed in the surface would miss 0.4 % of the volume of a thin limb
# at 128 cells; the quadrature, whose triangles are curved, misses less than 0.01 %. But a plate no thicker than a cell
# has holes in both: of a blade 0.016 thick the quadrature misses 10 % at 128 cells and 0.01 % at 192. So both are taken
# finer, by these factors, until the volume settles: two quadratures agree, and the mesh agrees with them.
RESOLUTION = 192
QUADRATURE = 128
FINER = (1.0, 1.5, 2.0, 3.0, 4.0)
SEEN_BY = 2.0  # a surface that is not there with so many times the cells is not there
SETTLED_QUADRATURE = 0.2 * GOOD_VOLUME
SETTLED_MESH = GOOD_VOLUME


@dataclass(frozen=True, repr=False)
class FitReport:
    """Measures of how well a field fits its mesh. Lengths are in diagonals of the mesh's box unless they say otherwise.

    A number that could not be measured, because the field has no closed surface in its bounds, is nan, and None in
    `to_dict`.
    """

    good: bool  # whether the stated quality is met
    verdict: str  # the same in words, with the reasons
    mended: tuple[str, ...]  # what was done to the mesh, in sentences
    samples: int  # points drawn on each surface for the distances, the values and the angles
    mean_distance: float  # mean of the two mean distances (Chamfer) between the field's surface and the mesh
    max_distance: float  # Hausdorff distance, the larger of both ways
    mean_distance_user: float  # the two above in the user's units
    max_distance_user: float
    mean_value: float  # |f| at points of the mesh
    max_value: float
    normal_error: float  # mean angle between grad f and the mesh's normal at points of the mesh, in degrees
    volume_error: float  # (field - mesh) / mesh
    area_error: float  # likewise
    gradient_mean: float  # |grad f| at points about 1 % of the diagonal off the surface; that of a distance is 1
    gradient_low: float  # its 1st percentile
    gradient_high: float  # its 99th percentile
    components: int  # connected surfaces of the field in its bounds
    components_mesh: int
    genus: int | None  # handles of the field's surface, components together
    genus_mesh: int
    diagonal: float  # of the mesh's box, in the user's units
    scale: float  # user's coordinates = scale * field's coordinates + offset
    offset: tuple[float, ...]
    parameters: int  # of the network
    steps: int  # of the training
    seconds: float  # all of it: mending, sampling, training and this report
    seconds_training: float
    training: str  # how the training ended
    seed: int
    attempts: tuple[str, ...] = ()  # with a budget: the networks that were tried, and what came of each

    def __repr__(self) -> str:
        """Return the verdict and the main numbers in two lines."""
        return (
            f"FitReport({self.verdict}\n  mean distance {self.mean_distance:.3%} of the diagonal, volume "
            f"{self.volume_error:+.2%}, normals {self.normal_error:.1f} degrees, {self.parameters} parameters, "
            f"{self.steps} steps, {self.seconds:.0f} s)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {key: _plain(value) for key, value in asdict(self).items()}


def fit_mesh(
    V: Float[ndarray, "n 3"] | Any,
    F: Int[ndarray, "m 3"] | None = None,
    *,
    module: nn.Module | None = None,
    width: int = 32,
    depth: int = 3,
    activation: Literal["sine", "softplus", "relu"] = "sine",
    steps: int = 4000,
    seconds: float | None = None,
    seed: int = 0,
    bodies: Literal["keep", "largest", "refuse"] = "keep",
    hole_limit: float = 1.0,
    quality: float = GOOD_DISTANCE,
    budget: float | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    checkpoint: str | PathLike[str] | None = None,
    **training: Any,
) -> tuple[Field, FitReport]:
    """Return a neural field whose zero set is the mesh, and how good it is.

    Args:
        V: Vertices (n, 3), in any units and anywhere; or a whole mesh: what meshref.as_mesh takes, such as a
            trimesh.Trimesh, a pyvista.PolyData or the name of a file.
        F: Triangles (m, 3), None after a whole mesh. The mesh may be as found in the wild; mend_mesh makes a solid of
            it.
        module: A module of one's own to train in place of a Siren or an Mlp, from points (N, 3) in [-1, 1]^3 to signed
            distances. It is not touched: the field's `write_back` stores what was trained in it. See fit_field.
        width, depth, activation: The network; the default has 2273 parameters. Knotty or sharp shapes come out better
            with 64 or 128 wide.
        steps: Steps of training.
        seconds: Most time for the training; see fit_field.
        seed: Of the samples, the first weights and the batches. The same seed gives the same weights.
        bodies: Whether several separate solids are kept, only the largest is, or they are refused. Parts that overlap
            or touch are united first, and a cavity belongs to its body.
        hole_limit: Longest boundary of a hole that is closed, in diagonals of the box round the mesh.
        quality: Largest mean distance between the surfaces of a good fit, in diagonals of the mesh's box. It must also
            have GOOD_VOLUME, the mesh's bodies, cavities and genus.
        budget: Seconds in which a fit that is not good begins anew, twice as wide each time, up to WIDEST; the best is
            returned, and the report's `attempts` name all. None fits once, as wide as told.
        progress: Called as progress(step, steps, loss), from the first step again for each network.
        checkpoint: File from which an interrupted training goes on; see fit_field.
        **training: Further options of fit_field, such as start, a field in [-1, 1]^3 to go on from.

    Returns:
        The field, float32 or in the module's precision, in [-1, 1]^3, and the report.

    Raises:
        meshref.MeshError: The mesh cannot be mended; the message says why and where.
        ValueError: An option of the training is out of range, the module cannot be trained, or a budget is given where
            the network is fixed: by a module, a start or a checkpoint.
        TypeError: The module does not map points (N, 3) to N values.
    """
    begun = perf_counter()
    if F is None:
        V, F = meshref.as_mesh(V)
    options: dict[str, Any] = {"width": width, "depth": depth, "activation": activation, "steps": steps, "seed": seed}
    fixed = {"module": module, "start": training.get("start"), "checkpoint": checkpoint}
    require_training({**options, "seconds": seconds, **training, **fixed})
    _require_quality(quality, budget, fixed)
    if module is not None or training.get("start") is not None:
        starting_field(module, training.get("start"), dimension=3)  # refused before the mesh is mended and sampled
    V, F, mending = mended(V, F, Mending(bodies, hole_limit))
    V, units = place_in_cube(V)
    query = meshref.SignedDistanceQuery(V, F)
    points = sample_space(V, F, seed)
    answer = query(points)
    if mending.hidden_area > 0:
        # The distance to a wall within the solid is none to its surface: the field would have a sheet there.
        seen = ~hidden_points(V, F, answer.closest, answer.face)
        points = points[seen]
        answer = SignedDistance(answer.distance[seen], answer.closest[seen], answer.face[seen], answer.normal[seen])
    tensors = [torch.from_numpy(array) for array in (points, answer.distance, answer.normal)]
    training |= {"module": module, "units": units, "progress": progress, "checkpoint": checkpoint}
    attempts: list[tuple[Field, FitReport]] = []
    while True:
        start = perf_counter()
        time_limit = _shorter(seconds, None if budget is None else budget - (start - begun))
        field, how = fit_field(tensors[0], tensors[1], tensors[2], **options, seconds=time_limit, **training)
        attempts.append((field, _report(field, how, V, F, mending.steps, seed, begun, quality=quality)))
        last, spent = perf_counter() - start, perf_counter() - begun
        if attempts[-1][1].good or budget is None or options["width"] >= WIDEST:
            break
        if budget - spent < LEAST_SHARE_OF_A_WIDER_FIT * last:
            break
        options["width"] = min(2 * options["width"], WIDEST)
    field, report = min(attempts, key=lambda attempt: _merit(attempt[1]))
    if budget is None:
        return field, report
    tried = tuple(f"{depth} layers, {r.parameters} parameters, {r.steps} steps: {r.verdict}" for _, r in attempts)
    return field, replace(report, attempts=tried, seconds=perf_counter() - begun)


def _require_quality(quality: float, budget: float | None, fixed: Mapping[str, Any]) -> None:
    for name, value in {"quality": quality, "budget": 1.0 if budget is None else budget}.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise ValueError(f"{name} must be a positive number, but is {value!r}.")
    given = [name for name, value in fixed.items() if value is not None]
    if budget is not None and given:
        raise ValueError(f"A budget widens the network, but {given[0]} fixes it. Leave one of them out.")


def _shorter(*seconds: float | None) -> float | None:
    """Return the shortest of some times, of which None has no end."""
    return min((max(s, 1.0) for s in seconds if s is not None), default=None)


def _merit(report: FitReport) -> tuple[bool, bool, float]:
    """Return what is less for the better fit: a good one, then one of the right pieces, then a near one."""
    pieces = (report.components, report.genus) != (report.components_mesh, report.genus_mesh)
    return not report.good, pieces, math.inf if math.isnan(report.mean_distance) else report.mean_distance


def place_in_cube(V: Float[ndarray, "n 3"]) -> tuple[Float[ndarray, "n 3"], Units]:
    """Vertices moved and scaled so that their box is centred with longest side SIDE, and the way back."""
    lower, upper = V.min(axis=0), V.max(axis=0)
    units = Units(float((upper - lower).max()) / SIDE, tuple(((lower + upper) / 2).tolist()))
    return (V - (lower + upper) / 2) / units.scale, units


def sample_space(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], seed: int) -> Float[ndarray, "k 3"]:
    """Points to train at, for a mesh that fits in [-0.8, 0.8]^3: on the surface, about it, and all over the cube."""
    rng = np.random.default_rng(seed)
    parts = [meshref.sample_mesh(V, F, ON_SURFACE, _further(rng)).points]
    for number, spread in ABOUT_SURFACE:
        parts.append(meshref.sample_mesh(V, F, number, _further(rng)).points + rng.normal(0, spread, (number, 3)))
    return np.concatenate([*parts, rng.uniform(-CUBE_REACH, CUBE_REACH, (IN_CUBE, 3))])


def _further(rng: np.random.Generator) -> int:
    return int(rng.integers(2**32))


def _report(
    field: Field,
    training: Training,
    V: Float[ndarray, "n 3"],
    F: Int[ndarray, "m 3"],
    mended: Sequence[str],
    seed: int,
    start: float,
    samples: int = 20_000,
    quality: float = GOOD_DISTANCE,
) -> FitReport:
    diagonal = float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
    scale = field.units.scale
    on_mesh = meshref.sample_mesh(V, F, samples, seed)
    values, gradients = field.value_and_gradient(_tensor(on_mesh.points, field))
    normals = torch.nn.functional.cosine_similarity(gradients, _tensor(on_mesh.normals, field), dim=1)
    nearby = on_mesh.points + np.random.default_rng(seed).normal(0, 0.01 * diagonal, on_mesh.points.shape)
    lengths = field.gradient(_tensor(nearby, field)).norm(dim=1).double()
    surface = _compare_surfaces(field, V, F, samples, seed, quality)
    faults = [*surface.faults]
    if training.status is not FitStatus.DONE:
        faults.append(training.status.value.rstrip(".").lower())
    if faults:
        verdict = f"Below the stated quality: {'; '.join(faults)}. Take a wider network, more steps, or a budget."
    else:
        verdict = (
            f"Good: the mean distance is {surface.mean / diagonal:.3%} of the diagonal (at most {quality:.1%}), "
            f"the volume is off by {surface.volume_error:+.2%} (at most {GOOD_VOLUME:.0%}), bodies and genus are right."
        )
    return FitReport(
        good=not faults,
        verdict=verdict,
        mended=tuple(mended),
        samples=samples,
        mean_distance=surface.mean / diagonal,
        max_distance=surface.largest / diagonal,
        mean_distance_user=surface.mean * scale,
        max_distance_user=surface.largest * scale,
        mean_value=float(values.abs().mean()) / diagonal,
        max_value=float(values.abs().max()) / diagonal,
        normal_error=float(torch.rad2deg(normals.double().clamp(-1, 1).acos()).mean()),
        volume_error=surface.volume_error,
        area_error=surface.area_error,
        gradient_mean=float(lengths.mean()),
        gradient_low=float(lengths.quantile(0.01)),
        gradient_high=float(lengths.quantile(0.99)),
        components=surface.components,
        components_mesh=meshref.component_count(V, F),
        genus=surface.genus,
        genus_mesh=meshref.genus(V, F),
        diagonal=diagonal * scale,
        scale=scale,
        offset=tuple(field.units.offset),
        parameters=field.theta.numel(),
        steps=training.steps,
        seconds=perf_counter() - start,
        seconds_training=training.seconds,
        training=training.status.value,
        seed=seed,
    )


@dataclass
class _Surfaces:
    """The field's surface against the mesh, in the field's units; nan until measured."""

    faults: list[str]
    mean: float = math.nan
    largest: float = math.nan
    volume_error: float = math.nan
    area_error: float = math.nan
    components: int = 0
    genus: int | None = None


def _compare_surfaces(
    field: Field, V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], samples: int, seed: int, quality: float
) -> _Surfaces:
    try:
        enclosed, area = _settled_integrals(field)
        V2, F2 = _settled_mesh(field, enclosed)
    except implicit.SurfaceError as error:
        return _Surfaces([f"the field has no closed surface ({error})"])
    diagonal = float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
    distance = meshref.surface_distance(V2, F2, V, F, samples, seed)
    found = _Surfaces(
        faults=[],
        mean=distance.chamfer,
        largest=distance.hausdorff,
        volume_error=enclosed / meshref.volume(V, F) - 1,
        area_error=area / meshref.area(V, F) - 1,
        components=meshref.component_count(V2, F2),
    )
    if not found.mean <= quality * diagonal:
        found.faults.append(
            f"the mean distance is {found.mean / diagonal:.2%} of the diagonal, more than {quality:.1%}"
        )
    if not abs(found.volume_error) <= GOOD_VOLUME:
        found.faults.append(f"the volume is off by {found.volume_error:+.1%}, more than {GOOD_VOLUME:.0%}")
    components, genus = meshref.component_count(V, F), meshref.genus(V, F)
    if found.components != components:
        found.faults.append(
            f"the field has {counted(found.components, 'surface', 'separate surfaces')}, the mesh {components}"
        )
    try:
        found.genus = meshref.genus(V2, F2)
        if found.genus != genus:
            found.faults.append(f"the field has genus {found.genus}, the mesh {genus}")
    except meshref.MeshError as error:  # two sheets within a cell of each other can share an edge
        found.faults.append(f"the genus could not be measured ({error})")
    return found


def _settled_integrals(field: Field) -> tuple[float, float]:
    """Return the volume and the area of a field, from the first quadrature that agrees with the one before."""
    before = math.nan
    for factor in FINER:
        try:
            quadrature = implicit.surface_quadrature(field, round(QUADRATURE * factor))
        except implicit.SurfaceError:
            if factor < SEEN_BY:
                continue  # a plate between the nodes of the grid is not seen at all
            raise
        # The divergence theorem: 3 volume = integral of x . n.
        enclosed = float(quadrature.integrate((quadrature.points * quadrature.normals).sum(dim=1))) / 3
        if abs(enclosed - before) <= SETTLED_QUADRATURE * abs(enclosed):
            break
        before = enclosed
    return enclosed, float(quadrature.weights.sum())


def _settled_mesh(field: Field, enclosed: float) -> tuple[Float[ndarray, "k 3"], Int[ndarray, "l 3"]]:
    """Return the surface of a field as a mesh fine enough to have its volume, or the finest."""
    for factor in FINER[::2]:
        try:
            V, F = implicit.extract_mesh(field, round(RESOLUTION * factor))
        except implicit.SurfaceError:
            if factor < SEEN_BY:
                continue
            raise
        # By hand: two sheets within a cell of each other can share an edge, and meshref.volume would refuse them.
        A, B, C = (V - V[F[0, 0]])[F].transpose(1, 0, 2)
        if abs((A * np.cross(B, C)).sum() / 6 - enclosed) <= SETTLED_MESH * abs(enclosed):
            break
    return V, F


def _tensor(array: ndarray, field: Field) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array)).to(field.theta)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
