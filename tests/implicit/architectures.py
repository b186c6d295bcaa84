"""Architectures that people bring, all operations on each, and the page of what came of it.

    python tests/implicit/architectures.py                 all rows at the sizes of the page, printed
    python tests/implicit/architectures.py ELU hash        rows whose name holds a word
    python tests/implicit/architectures.py --write         and kept in docs/architectures.json; the page is made anew

`ARCHITECTURES` says how each is made, small for the tests or as large as people have it, and how its rows are found.
Each is fitted to a body that is known, and `measure` takes it through all operations of OPERATIONS. What it returns is
numbers, held against truths of other origin: points that carried no target, differences of the real motion of the
surface, the mesh flow of the same surface. test_architectures.py holds them to bounds.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field as entry
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from implicit import (
    Along,
    Ball,
    Field,
    HalfSpace,
    Handle,
    Holding,
    Siren,
    SurfaceSample,
    Volume,
    basis,
    basis_function,
    decoder_field,
    expressibility,
    extract_mesh,
    fit_field,
    geometric_edit,
    load_field,
    one_weight_per_layer,
    project_to_surface,
    rigid_edit,
    sample_surface,
    save_field,
    semantic_edit,
    shapes,
    smooth,
    surface_modes,
    surface_quadrature,
)
from implicit.models import DenseGrid, HashGrid, TriPlane
from implicit.sensitivity.boundary_sensitivity import parameter_gradient
from implicit.sensitivity.closed_form import has_closed_form
from implicit.sensitivity.sparse_rows import has_sparse_rows
from implicit.step.tangential_basis import CosineFeatures
from meshref import area, check_mesh, mean_curvature_flow
from tests.implicit.foreign import DeepSdf, Fourier, ImplicitGeometricRegularisation, Residual, Sine, chain

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architectures.md"
RESULTS = ROOT / "docs" / "architectures.json"

# The architectures


def as_published(width: int, depth: int, frequency: float) -> nn.Sequential:
    """Sines of one frequency throughout, started as Sitzmann et al. 2020 do."""
    network = chain(width, depth, lambda: Sine(frequency))
    with torch.no_grad():
        for k, layer in enumerate(part for part in network if isinstance(part, nn.Linear)):
            reach = 1 / layer.in_features if k == 0 else (6 / layer.in_features) ** 0.5 / frequency
            layer.weight.uniform_(-reach, reach)
    return network


def normed_chain(width: int, depth: int, norm: Callable[[nn.Module], nn.Module]) -> nn.Sequential:
    layers = chain(width, depth, nn.ReLU)
    return nn.Sequential(*(norm(part) if isinstance(part, nn.Linear) else part for part in layers))


class FourierFeatures(nn.Module):
    """Gaussian Fourier features in a buffer before ReLU layers [Tancik et al. 2020]."""

    def __init__(self, features: int, width: int, depth: int, scale: float) -> None:
        super().__init__()
        self.register_buffer("B", scale * torch.randn(3, features))
        layers: list[nn.Module] = []
        for a, b in pairwise([2 * features] + [width] * depth):
            layers += [nn.Linear(a, b), nn.ReLU()]
        self.network = nn.Sequential(*layers, nn.Linear(width, 1))

    def forward(self, points: Tensor) -> Tensor:
        angles = 2 * math.pi * points @ self.B
        return self.network(torch.cat([angles.sin(), angles.cos()], dim=-1))


def nerf(width: int, depth: int, octaves: int) -> nn.Module:
    layers: list[nn.Module] = []
    for a, b in pairwise([3 + 6 * octaves] + [width] * depth):
        layers += [nn.Linear(a, b), nn.Softplus(10.0)]
    return Fourier(nn.Sequential(*layers, nn.Linear(width, 1)), octaves)


class Occupancy(nn.Module):
    """Sigmoid of a network of distances: 1 inside, 0 outside, 1/2 on the surface."""

    def __init__(self, network: nn.Module, sharpness: float = 20.0) -> None:
        super().__init__()
        self.network, self.sharpness = network, sharpness

    def forward(self, points: Tensor) -> Tensor:
        return torch.sigmoid(-self.sharpness * self.network(points))


class Checking(nn.Module):
    """Looks at its data before it computes, as an assertion does: no graph to be traced, and no vmap."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, points: Tensor) -> Tensor:
        assert float(points.detach().abs().max()) < 100
        return self.network(points)


class Attention(nn.Module):
    """Values weighted by a softmax of the point: smooth, with no chain of layers to be found."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.keys, self.values, self.last = nn.Linear(3, width), nn.Linear(3, width), nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        shares = torch.softmax(3 * self.keys(points), dim=-1)
        return self.last(shares * torch.sin(2 * self.values(points)))


class WithCode(nn.Module):
    """DeepSDF's decoder of points and a code, of which the code is kept."""

    def __init__(self, width: int, depth: int, skip: int, code: int) -> None:
        super().__init__()
        self.code = nn.Parameter(0.1 * torch.randn(code))
        widths = [3 + code] + [width] * depth + [1]
        self.layers = nn.ModuleList(
            nn.Linear(a, b - 3 - code if k + 1 == skip else b) for k, (a, b) in enumerate(pairwise(widths))
        )
        self.skip = skip

    def forward(self, points: Tensor, code: Tensor | None = None) -> Tensor:
        joined = torch.cat([points, (self.code if code is None else code).expand(len(points), -1)], dim=-1)
        x = joined
        for k, layer in enumerate(self.layers):
            if k == self.skip:
                x = torch.cat([x, joined], dim=-1)
            x = layer(x)
            if k < len(self.layers) - 1:
                x = functional.softplus(x, beta=20.0)
        return x.squeeze(-1)


@dataclass(frozen=True)
class Architecture:
    """One row of the table.

    Attributes:
        name: What people call it.
        make: Returns the module to train, small or as large as people have it.
        rows: How its rows are found: "closed form", "sparse", "vmap" or "point by point".
        wrap: What stands round the trained module; None is nothing.
        options: Of its Field.
        code: Whether the parameters are the code of a decoder.
        smooth: Whether curvature can be taken at points; else in weak form.
    """

    name: str
    make: Callable[[bool], nn.Module]
    rows: str = "closed form"
    wrap: Callable[[nn.Module], nn.Module] | None = None
    options: dict[str, Any] = entry(default_factory=dict)
    code: bool = False
    smooth: bool = True

    def module(self, small: bool = True) -> nn.Module:
        """Return the module to train, the same each time."""
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the older weight norm says that it is old
            torch.manual_seed(1)
            return self.make(small)

    def field(self, module: nn.Module, dtype: torch.dtype) -> Field:
        """Return the field of a trained module in this precision, where it has none of its own."""
        if self.code:
            module = module.to(dtype)
            return decoder_field(module, module.code.detach().clone())
        if self.wrap is not None:
            module = self.wrap(module.to(dtype))
        else:
            module = module.to(dtype)
        return Field(module, **self.options)


_RELU_NORM = nn.utils.parametrizations.weight_norm


def _either(small: Callable[[], nn.Module], large: Callable[[], nn.Module]) -> Callable[[bool], nn.Module]:
    """Return a function that makes the small one, or the large one."""
    return lambda is_small: small() if is_small else large()


def _table() -> list[Architecture]:
    relu = (16, 2), (48, 4)
    skipped = (16, 3, 2), (64, 6, 3)
    return [
        Architecture(
            "sines of our own",
            _either(lambda: Siren(width=12, depth=2, first_frequency=4.0, frequency=4.0), lambda: Siren(width=48)),
        ),
        Architecture(
            "SIREN as published", _either(lambda: as_published(14, 2, 8.0), lambda: as_published(48, 3, 30.0))
        ),
        Architecture("ReLU", lambda small: chain(*relu[not small], nn.ReLU), smooth=False),
        Architecture("ReLU, weight norm", lambda small: normed_chain(*relu[not small], _RELU_NORM), smooth=False),
        Architecture(
            "ReLU, older weight norm",
            lambda small: normed_chain(*relu[not small], nn.utils.weight_norm),
            smooth=False,
        ),
        Architecture("IGR: softplus 100, skip", lambda small: ImplicitGeometricRegularisation(*skipped[not small])),
        Architecture(
            "DeepSDF: weight norm, skip, tanh",
            lambda small: DeepSdf(*skipped[not small], parametrized=True),
            smooth=False,
        ),
        Architecture("ELU", _either(lambda: chain(12, 2, nn.ELU), lambda: chain(48, 4, nn.ELU))),
        Architecture(
            "occupancy: sigmoid",
            _either(lambda: chain(12, 2, nn.Tanh), lambda: chain(48, 3, nn.Tanh)),
            wrap=Occupancy,
            options={"level": 0.5, "inside": "positive"},
        ),
        Architecture(
            "Fourier features, ReLU",
            _either(lambda: FourierFeatures(8, 16, 2, 0.3), lambda: FourierFeatures(24, 48, 3, 0.7)),
            smooth=False,
        ),
        Architecture("NeRF encoding, softplus", _either(lambda: nerf(12, 1, 2), lambda: nerf(48, 3, 4))),
        Architecture("residual", lambda small: Residual(12 if small else 64)),
        Architecture("dense grid", lambda small: DenseGrid(resolution=6 if small else 20), "sparse"),
        Architecture(
            "hash grid", _either(lambda: HashGrid(levels=2, table=64, degree=2, width=8), lambda: HashGrid()), "sparse"
        ),
        Architecture(
            "tri-plane",
            _either(lambda: TriPlane(5, 3, width=8, depth=1), lambda: TriPlane(24, 6, width=24, depth=2)),
            "sparse",
        ),
        Architecture("attention", lambda small: Attention(16 if small else 64), "vmap"),
        Architecture(
            "a forward that looks at its data",
            lambda small: chain(10 if small else 24, 2, nn.Tanh),
            "point by point",
            Checking,
        ),
        Architecture(
            "ELU in half precision",
            _either(lambda: chain(12, 2, nn.ELU), lambda: chain(48, 4, nn.ELU)),
            wrap=lambda module: module.half(),
        ),
        Architecture(
            "a decoder's code", _either(lambda: WithCode(16, 2, 1, 6), lambda: WithCode(64, 4, 2, 16)), code=True
        ),
    ]


ARCHITECTURES: dict[str, Architecture] = {row.name: row for row in _table()}


def build(name: str, small: bool) -> nn.Module:
    """Return a module of the table, for load_field."""
    row = ARCHITECTURES[name]
    module = row.module(small)
    return module if row.wrap is None else row.wrap(module)


# A fitted field of each


@dataclass(frozen=True)
class Sizes:
    """How much work the operations are given: points, cells a side, steps.

    Attributes:
        small: Whether these are those of the tests.
        points: That carry an edit.
        others: At which it is judged.
        cells: Of meshes and quadratures.
        rigid_points: That carry a rigid edit.
        waves: Cosines of the basis of the motion along the surface, of a rigid edit.
        steps: Of a smoothing.
        held: Steps of one with the volume held.
        parts: Of a geometric edit; None leaves it to the edit.
        fine: Cells of the quadrature on which the volume is held at the end.
        tolerance: To which it is held.
        dtype: Of the fields that have no precision of their own.
    """

    small: bool
    points: int
    others: int
    cells: int
    rigid_points: int
    waves: int
    steps: int
    held: int
    parts: int | None
    fine: int
    tolerance: float | None
    dtype: torch.dtype


SMALL = Sizes(True, 100, 100, 10, 40, 600, 1, 1, 2, 10, 1e-3, torch.float64)
LARGE = Sizes(False, 1000, 1000, 32, 500, 600, 5, 5, None, 64, None, torch.float32)

FIT_STEPS = 800
FEW = 1000  # parameters, of which least squares make more than training does

BODY = shapes.capsule((-0.25, 0.0, 0.0), (0.25, 0.0, 0.0), 0.4)


def distances_of(near: int, far: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return points crowded near the body and spread in the bounds, their distances and the gradients of these."""
    generator = torch.Generator().manual_seed(0)
    on = sample_surface(BODY, near, resolution=16).points
    away = torch.rand(far, 3, generator=generator, dtype=torch.float64) * 2.2 - 1.1
    axis = torch.linspace(-1, 1, 6, dtype=torch.float64)  # with the corners, which a grid leaves to chance otherwise
    near_by = on + 0.05 * torch.randn(on.shape, generator=generator, dtype=torch.float64)
    points = torch.cat([near_by, away, torch.cartesian_prod(axis, axis, axis)])
    return points, BODY.value(points), BODY.normal(points)


def least_squares_fit(field: Field, points: Tensor, distances: Tensor, steps: int = 20) -> Field:
    """Return a small field fitted by Levenberg and Marquardt's method, in a fifth of a second."""
    weights = 1 / (1 + 4 * distances.abs())
    damping, jacobian = 1e-2, None
    missed = weights * (field.value(points) - distances)
    for _ in range(steps):
        if jacobian is None:
            jacobian = weights[:, None] * parameter_gradient(field, points)
            normal, slope = jacobian.T @ jacobian, jacobian.T @ missed
            scale = normal.diagonal() + 1e-2 * normal.diagonal().mean()
        tried = field.with_theta(field.theta - torch.linalg.solve(normal + torch.diag(damping * scale), slope))
        left = weights * (tried.value(points) - distances)
        if float(left.norm()) < float(missed.norm()):
            field, missed, jacobian, damping = tried, left, None, damping / 4
        else:
            damping *= 5
    return field


@dataclass(frozen=True, eq=False)
class Subject:
    """A fitted field of an architecture, and how much work it is given."""

    architecture: Architecture
    field: Field
    sizes: Sizes

    @staticmethod
    def small(name: str) -> Subject:
        """Return the small one of that name."""
        row = ARCHITECTURES[name]
        module = row.module().double()
        points, distances, _ = distances_of(350, 300)
        least_squares_fit(Field(module), points, distances).write_back()
        return Subject(row, row.field(module, SMALL.dtype), SMALL)

    @staticmethod
    def large(name: str) -> Subject:
        """Return the large one of that name, trained on distances for some seconds."""
        row = ARCHITECTURES[name]
        module = row.module(small=False)
        if sum(p.numel() for p in module.parameters()) < FEW:
            points, distances, _ = distances_of(1000, 1000)
            least_squares_fit(Field(module.double()), points, distances).write_back()
            return Subject(row, row.field(module, LARGE.dtype), LARGE)
        points, distances, normals = (x.float() for x in distances_of(40_000, 10_000))
        field, _ = fit_field(points, distances, normals, module=module, steps=FIT_STEPS, batch=1024)
        field.write_back()
        return Subject(row, row.field(module, LARGE.dtype), LARGE)

    @cached_property
    def others(self) -> SurfaceSample:
        """Points of the surface that carry no target."""
        return sample_surface(self.field, self.sizes.others, resolution=self.sizes.cells, seed=11)

    def contents(self, field: Field) -> tuple[float, float]:
        """Return the area and the volume of a field's surface, on cells of a size of their own."""
        surface = surface_quadrature(field, self.sizes.cells + 5)
        return float(surface.weights.double().sum()), Volume().value(field, surface)

    @cached_property
    def area(self) -> float:
        """Area of the surface."""
        return self.contents(self.field)[0]

    @cached_property
    def volume(self) -> float:
        """Volume that it bounds."""
        return self.contents(self.field)[1]

    @cached_property
    def mesh(self) -> tuple[Any, Any]:
        """Vertices and faces of the surface, in float64."""
        V, F = extract_mesh(self.field, 2 * self.sizes.cells)
        return V.astype(float), F


# Operations: each returns what was measured


def mesh(subject: Subject) -> dict[str, Any]:
    """Extract the surface: the vertices lie on it, and its area is that of the sample."""
    V, F = subject.mesh
    vertices = torch.from_numpy(V).to(subject.field.theta)
    values, gradients = subject.field.value_and_gradient(vertices)
    off = float((values / gradients.norm(dim=1)).abs().max())
    return {
        "off": off,
        "area": area(*check_mesh(V, F, closed=True)) / subject.area,
        "distance": float(BODY.value(subject.others.points.double().cpu()).square().mean().sqrt()),
    }


def real_motion(field: Field, points: Tensor, way: Tensor, step: float) -> Tensor:
    """Return how fast the surface at the points moves along its normal when theta moves along a way, by differences.

    The displaced surface is found on the normal, by bisection, secants and nothing of the library's own projection.
    """
    normals = field.normal(points)

    def displaced(amount: float) -> Tensor:
        moved = field.with_theta(field.theta + amount * way)
        low, high = (torch.full_like(points[:, 0], sign * 4e-4) for sign in (-1.0, 1.0))
        at = [moved.value(points + end[:, None] * normals) for end in (low, high)]
        assert all(bool((a * b < 0).all()) for a, b in [(at[0], at[1])])
        f_low, f_high = at
        for k in range(100):
            # Regula falsi in Illinois form, a bisection now and then.
            middle = (low + high) / 2 if k % 4 == 3 else (low * f_high - high * f_low) / (f_high - f_low)
            f = moved.value(points + middle[:, None] * normals)
            below = f * f_low > 0
            low, f_low, f_high = (
                torch.where(below, middle, low),
                torch.where(below, f, f_low / 2),
                torch.where(below, f_high / 2, f),
            )
            high = torch.where(below, high, middle)
            if float((high - low).abs().max()) < 1e-14 or float(f.abs().max()) < 1e-16:
                break
        return middle

    def central(h: float) -> Tensor:
        return (displaced(h) - displaced(-h)) / (2 * h)

    return (4 * central(step / 2) - central(step)) / 3


def motion(subject: Subject) -> dict[str, Any]:
    """Hold rows of the basis against the real motion of the surface in float64."""
    field = subject.field.to(torch.float64)
    points = project_to_surface(field, subject.others.points[:12].double())
    generator = torch.Generator().manual_seed(3)
    way = torch.randn(len(field.theta), generator=generator, dtype=torch.float64).to(field.theta)
    speed = basis(field, points) @ way
    step = 2e-5 / float(speed.abs().max())
    # Where a kink passes through a point on its way, the surface moves at two speeds and no row is right.
    ends = [field.with_theta(field.theta + sign * step * way).gradient(points) for sign in (-1.0, 1.0)]
    even = (ends[0] - ends[1]).norm(dim=1) < 1e-3 * ends[0].norm(dim=1)
    measured = real_motion(field, points[even], way, step)
    gap = float((measured - speed[even]).abs().max() / speed.abs().max())
    return {"motion": gap, "points": int(even.sum())}


def functions(subject: Subject) -> dict[str, Any]:
    """Show single weights' basis functions: they are the columns of the basis."""
    field, points = subject.field, subject.others.points[:20]
    rows = basis(field, points)
    shown = [basis_function(field, 0), *one_weight_per_layer(field)]
    gaps = [float((each(points) - rows[:, each.index]).abs().max()) for each in shown]
    return {"functions": len(shown), "columns": max(gaps) / float(rows.abs().max())}


def modes(subject: Subject) -> dict[str, Any]:
    """Find the motions of the surface that the parameters make most of: orthonormal over the surface."""
    found = surface_modes(subject.field, subject.others, min(4, len(subject.field.theta)))
    products = found.motions.double().T * subject.others.weights.double() @ found.motions.double()
    return {"modes": float((products - torch.eye(len(products)).to(products)).abs().max())}


def bump(distance: float = 0.04) -> list[Handle]:
    """A bump of 4 % of half the bounds on top of the body."""
    return [Handle(Ball((0.0, 0.4, 0.0), 0.9), Along(distance))]


def geometric(subject: Subject) -> dict[str, Any]:
    """Predict a bump, make it, and judge it at other points."""
    sizes = subject.sizes
    predicted = expressibility(subject.field, bump(), points=sizes.points, steps=sizes.parts or 4)
    edit = geometric_edit(subject.field, bump(), steps=sizes.parts, points=sizes.points, resolution=sizes.cells)
    error = edit.error_field(subject.others)
    return {
        "predicted": predicted.rms,
        "rms": float(error.square().mean().sqrt()),
        "status": edit.status.name,
        "parts": len(edit.history),
    }


def rigid(subject: Subject) -> dict[str, Any]:
    """Hold one end and pull the other away."""
    handles = [
        Handle(HalfSpace((-0.4, 0.0, 0.0), (-1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
        Handle(HalfSpace((0.4, 0.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 0.1, 0.0)),
    ]
    sizes = subject.sizes
    along = CosineFeatures(subject.field.to(torch.float64), waves=sizes.waves)
    edit = rigid_edit(subject.field, handles, tangential=along, points=sizes.rigid_points, resolution=sizes.cells)
    error = edit.error_field()
    asked = torch.isfinite(error)
    return {"handles": float(error[asked].square().mean().sqrt()), "status": edit.status.name}


STEP_SIZE = 2e-3


def smoothed(subject: Subject) -> dict[str, Any]:
    """Smooth beside the mesh flow of the same surface."""
    sizes = subject.sizes
    V, F = subject.mesh
    # An eighth of the step leaves the mesh's own error in time below a per cent; of 100 points the field's is ten.
    flow = mean_curvature_flow(V, F, steps=8 * sizes.steps, step_size=STEP_SIZE / 8, method="semi-implicit")
    points = max(sizes.points, 400)
    edit = smooth(subject.field, steps=sizes.steps, step_size=STEP_SIZE, points=points, resolution=sizes.cells)
    lost, of_mesh = 1 - subject.contents(edit.field)[0] / subject.area, 1 - area(flow.V, F) / area(V, F)
    form = edit.history[-1].get("curvature", "pointwise") if edit.history else ""
    return {"lost": lost, "ratio": lost / of_mesh, "form": form, "status": edit.status.name}


def held(subject: Subject) -> dict[str, Any]:
    """Smooth with the volume held, and measure both on another quadrature than the one that held it."""
    sizes = subject.sizes
    edit = smooth(
        subject.field,
        steps=sizes.held,
        step_size=STEP_SIZE * sizes.steps / sizes.held,
        constraints=[Volume()],
        holding=Holding(tolerance=sizes.tolerance, resolution=sizes.cells, fine_resolution=sizes.fine),
        points=sizes.points,
    )
    after, before = subject.contents(edit.field), (subject.area, subject.volume)
    return {"drift": abs(after[1] / before[1] - 1), "lost": 1 - after[0] / before[0], "status": edit.status.name}


def semantic(subject: Subject) -> dict[str, Any]:
    """Move points to where some change of the parameters, or of the code, would bring them."""
    field, sample = subject.field, subject.others
    points, normals = sample.points[:60], sample.normals[:60]
    generator = torch.Generator().manual_seed(7)
    way = torch.randn(len(field.theta), generator=generator, dtype=torch.float64).to(field.theta)
    speed = basis(field, points) @ way
    speed *= 0.03 / float(speed.abs().max())
    edit = semantic_edit(field, points, speed[:, None] * normals, damping=None)
    missed = (edit.displacement * normals).sum(dim=1) - speed
    return {"missed": float(missed.norm() / speed.norm()), "status": edit.status.name, "steps": len(edit.history)}


def start(subject: Subject) -> dict[str, Any]:
    """Train on from the field towards a larger body."""
    points, distances, normals = (x.to(subject.field.theta) for x in distances_of(400, 200))
    grown = distances - 0.02
    _, training = fit_field(points, grown, normals, start=subject.field, steps=10, batch=200)
    near = distances.abs() < training.band
    before = float((subject.field.value(points) - grown)[near].abs().mean())
    return {"before": before, "after": training.value_error}


def file(subject: Subject) -> dict[str, Any]:
    """Keep the field and read it again, by what builds it."""
    name, small = subject.architecture.name, subject.sizes.small
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "field.safetensors"
        save_field(subject.field, path, builder=f"{__name__}:build", arguments={"name": name, "small": small})
        again = load_field(path, module=build, device=subject.field.device)
    points = subject.others.points
    return {"same": bool(torch.equal(again.value(points), subject.field.value(points)))}


OPERATIONS: dict[str, Callable[[Subject], dict[str, Any]]] = {
    "extract_mesh, sample_surface": mesh,
    "basis": motion,
    "basis_function": functions,
    "surface_modes": modes,
    "expressibility, geometric_edit": geometric,
    "rigid_edit": rigid,
    "smooth": smoothed,
    "smooth, volume held": held,
    "semantic_edit": semantic,
    "fit_field from it": start,
    "save_field, load_field": file,
}


def rows_of(field: Field, points: Tensor) -> str:
    """Return how the rows of a field's basis are found."""
    if has_closed_form(field):
        return "closed form"
    if has_sparse_rows(field, points):
        return "sparse"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # says that it goes point by point
        basis(field, points[:2])
    return "point by point" if field.findings.get("not vectorised") else "vmap"


# The page


def measure(name: str) -> dict[str, Any]:
    """Return what all operations give on the large field of that name, with the processor seconds of each."""
    begin = time.process_time()
    subject = Subject.large(name)
    fitted = time.process_time() - begin
    results: dict[str, Any] = {}
    for operation, run in OPERATIONS.items():
        begin = time.process_time()
        try:
            results[operation] = run(subject)
        except (TypeError, ValueError) as error:  # a refusal is a result; anything else is a fault
            results[operation] = {"refused": str(error)}
        results[operation]["seconds"] = time.process_time() - begin
    return {
        "name": name,
        "parameters": len(subject.field.theta),
        "rows": rows_of(subject.field, subject.others.points),
        "fit": fitted,
        "results": results,
    }


def stored() -> list[dict[str, Any]]:
    """Return the rows that were measured, in the order of the table."""
    found = {row["name"]: row for row in json.loads(RESULTS.read_text())} if RESULTS.exists() else {}
    return [found[name] for name in ARCHITECTURES if name in found]


HEADINGS = {
    "network": "",
    "P": "",
    "rows": "",
    "basis off by": "basis",
    "bump: off by": "expressibility, geometric_edit",
    "foretold": "",
    "s": "expressibility, geometric_edit",
    "pull: off by": "rigid_edit",
    "s ": "rigid_edit",
    "smoothing": "smooth",
    "s  ": "smooth",
    "volume off by": "smooth, volume held",
    "s   ": "smooth, volume held",
    "points off by": "semantic_edit",
    "what is lost": "",
}


def page(rows: list[dict[str, Any]]) -> str:
    """Return the text of the page of these rows."""
    lines = ["| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
    for row in rows:
        r = row["results"]
        bump, pull = r["expressibility, geometric_edit"], r["rigid_edit"]
        flow, volume, points = r["smooth"], r["smooth, volume held"], r["semantic_edit"]
        cells = [
            row["name"],
            f"{row['parameters']:,}",
            row["rows"],
            _figure(r["basis"], "motion", "{:.0e}"),
            _figure(bump, "rms", "{:.1%}"),
            _figure(bump, "predicted", "{:.1%}"),
            _seconds(bump),
            _figure(pull, "handles", "{:.1%}"),
            _seconds(pull),
            _figure(flow, "ratio", "{:.3f}"),
            _seconds(flow),
            _figure(volume, "drift", "{:.0e}"),
            _seconds(volume),
            _figure(points, "missed", "{:.0%}"),
            "; ".join(_losses(row)) or "nothing",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    missing = [name for name in ARCHITECTURES if name not in {row["name"] for row in rows}]
    rest = f"\nStill to be measured at this size: {', '.join(missing)}.\n" if missing else ""
    return PROSE + "\n".join(lines) + "\n" + rest


PROSE = """# Which network, which operations, at which cost

Each row is a network that people bring, fitted to the distances of a body (a capsule) and taken through every
operation. `python tests/implicit/architectures.py --write` measures the rows again and makes this page. The same table
at sizes that take a second is a test: [test_architectures.py](../tests/implicit/test_architectures.py). Seconds are
processor seconds of one thread, on a machine that others used at the same time: they compare rows, and are up to twice
what a machine of one's own takes. Edits are of 1000 points, meshes of 32 cells, networks in float32.

- *rows*: how rows of the basis are found. A closed form comes from the layers in the module's graph, sparse rows from
  the few parameters that act near a point; else torch vectorises over points (vmap), or goes point by point.
- *basis off by*: rows against central differences of the real motion of the surface along its normal in float64, by
  root finding, relative to the largest; at points that no kink passes.
- *bump*: `geometric_edit` by 4 % of half the bounds on half the body, the rest fixed: root mean square error over the
  largest target, at points that carried none; *foretold* by `expressibility`. The seconds are those of both.
- *pull*: `rigid_edit`, one end held, the other moved aside by 0.1: error at the handles over that.
- *smoothing*: area lost in five steps of `smooth`, over what the mesh flow of the same surface loses.
- *volume off by*: after five such steps with `Volume()` held, on another quadrature than the one that held it.
- *points off by*: `semantic_edit` of 60 points towards a motion that the parameters have. It stops where it measures
  5 % before a step.

Every field was saved and read again by `save_field(..., builder=...)` to the same bits, its `basis_function`s are
columns of the basis, its `surface_modes` are orthonormal over the surface, and `fit_field(..., start=)` trains on from
it; what did not is said under *what is lost*.

"""


def _figure(result: dict[str, Any], key: str, form: str) -> str:
    return "refused" if "refused" in result else form.format(result[key])


def _seconds(result: dict[str, Any]) -> str:
    return f"{result['seconds']:.1f}"


_STATUSES = {"NOT_REACHED": "not reached", "STRAY_PIECES": "stray pieces", "NOT_FOLLOWED": "flow not followed"}


def _losses(row: dict[str, Any]) -> Iterator[str]:
    """Yield what does not work, or less well, in a row's results."""
    r = row["results"]
    if r["smooth"].get("form") == "weak":
        yield "curvature, in weak form from the mesh"
    if row["rows"] == "point by point":
        yield "speed"
    if abs(r["smooth"].get("ratio", 1.0) - 1) > 0.05:
        yield f"smooth: {abs(1 - r['smooth']['ratio']):.0%} off the mesh flow"
    if ARCHITECTURES[row["name"]].wrap is not None and row["name"].endswith("half precision"):
        yield "digits: it works on float32 copies"
    for operation, result in r.items():
        if "refused" in result:
            yield f"{operation}: {result['refused'].split('. ')[0]}"
        elif result.get("status", "DONE") not in ("DONE", "REACHED"):
            status = result["status"]
            yield f"{operation.split(', ')[-1]}: {_STATUSES.get(status, status.lower().replace('_', ' '))}"
    if r["fit_field from it"].get("after", 0) > r["fit_field from it"].get("before", 1):
        yield "training on: its values are no distances"
    if not r["save_field, load_field"].get("same", False):
        yield "its file"


def main() -> int:
    """Measure the rows asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="only rows whose name holds one of these")
    parser.add_argument("--write", action="store_true", help=f"keep them in {RESULTS.name}; {PAGE.name} anew")
    given = parser.parse_args()
    torch.set_num_threads(1)
    for name in ARCHITECTURES:
        if given.words and not any(word in name for word in given.words):
            continue
        found = measure(name)
        print(json.dumps(found), flush=True)
        if given.write:
            rows = [*(row for row in stored() if row["name"] != name), found]
            RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
            RESULTS.write_text(json.dumps(stored(), indent=1) + "\n")
            PAGE.write_text(page(stored()))
    return 0


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="The module cannot be vectorised")
    sys.exit(main())
