"""Bad input for every public function of implicit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from corpus import Bad, BadCase, choices, counts, not_negatives, positives, refusals
from torch import nn

import implicit
from implicit import families, shapes

BALL = shapes.sphere(0.5)
CIRCLE = shapes.circle(0.5)
SIREN = implicit.Field(implicit.Siren(width=4, depth=1).double())
POINTS = torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, -0.5], [0.0, -0.5, 0.0]], dtype=torch.float64)
SAMPLE = implicit.SurfaceSample(POINTS, 2 * POINTS, torch.full((4,), 0.7, dtype=torch.float64))
EVERYWHERE = implicit.Ball((0, 0, 0), 2.0)
HANDLE = implicit.Handle(EVERYWHERE, implicit.Along(0.1))
WAYS = torch.zeros_like(POINTS)
Call = Callable[..., object]


def cases() -> Iterator[BadCase]:
    yield from _of_the_field()
    yield from _of_points()
    yield from _of_fields()
    yield from _of_regions()
    yield from _of_handles()
    yield from _of_converged()
    yield from _of_edits()
    yield from _of_samples()
    yield from _of_functionals()
    yield from _of_fits()
    yield from _of_files()
    yield from _of_own_modules()
    yield from _of_shapes()


def no_fields() -> list[Bad]:
    """What is no Field."""
    return [("None", None), ("a module", implicit.Siren(width=4, depth=1)), ("a mesh", (np.zeros((3, 3)), [[0, 1, 2]]))]


def bad_points(good: torch.Tensor = POINTS) -> list[Bad]:
    """For points (N, 3) in float64."""
    with_nan, with_infinity = good.clone(), good.clone()
    with_nan[1, 2], with_infinity[0, 0] = torch.nan, torch.inf
    return [
        ("NaN", with_nan),
        ("infinite", with_infinity),
        ("of two columns", good[:, :2]),
        ("of one axis", good.reshape(-1)),
        ("of three axes", good[None]),
        ("float32", good.float()),
        ("float16", good.half()),
        ("whole numbers", good.long()),
        ("complex", good.to(torch.complex128)),
        ("on another device", good.to("meta")),
        ("an array", good.numpy()),
        ("a list", good.tolist()),
        ("None", None),
        ("a word", "surface"),
    ]


def vectors(*like: int) -> list[Bad]:
    """For a tensor of numbers of this shape, in float64."""
    good = torch.zeros(like, dtype=torch.float64)
    return [
        ("NaN", torch.full_like(good, torch.nan)),
        ("infinite", torch.full_like(good, torch.inf)),
        ("too long", torch.cat([good, good])),
        ("of one axis more", good[None]),
        ("on another device", good.to("meta")),
        ("an array", good.numpy()),
        ("a word", "zero"),
    ]


# Every function that takes a field first, with the rest of its arguments good

TAKES_A_FIELD: dict[str, Call] = {
    "extract_mesh": implicit.extract_mesh,
    "project_to_surface": lambda f: implicit.project_to_surface(f, POINTS),
    "surface_quadrature": implicit.surface_quadrature,
    "sample_surface": lambda f: implicit.sample_surface(f, 10),
    "transport": lambda f: implicit.transport(f, SAMPLE, WAYS),
    "basis": lambda f: implicit.basis(f, POINTS),
    "normal_displacement": lambda f: implicit.normal_displacement(f, POINTS, torch.zeros(4, dtype=torch.float64)),
    "adjoint": lambda f: implicit.adjoint(f, POINTS, SAMPLE.weights),
    "integrate": lambda f: implicit.integrate(f, implicit.Volume()),
    "field_soundness": implicit.field_soundness,
    "surface_topology": implicit.surface_topology,
    "surface_modes": lambda f: implicit.surface_modes(f, SAMPLE, 1),
    "mirror_symmetry": lambda f: implicit.mirror_symmetry(f, SAMPLE, torch.zeros(4, 1)),
    "explicit_step_limit": implicit.explicit_step_limit,
    "expressibility": lambda f: implicit.expressibility(f, HANDLE),
    "basis_function": lambda f: implicit.basis_function(f, 0),
    "one_weight_per_layer": implicit.one_weight_per_layer,
    "geometric_edit": lambda f: implicit.geometric_edit(f, HANDLE),
    "rigid_edit": lambda f: implicit.rigid_edit(f, [HANDLE]),
    "semantic_edit": lambda f: implicit.semantic_edit(f, POINTS, WAYS),
    "prescribe": lambda f: implicit.prescribe(f, HANDLE),
    "smooth": lambda f: implicit.smooth(f, steps=1),
    "converged_smooth": lambda f: implicit.converged_smooth(f, time=1e-4),
    "trained_rigid_step": lambda f: implicit.trained_rigid_step(f, [HANDLE]),
    "save_field": lambda f: implicit.save_field(f, "a.safetensors"),
    "Volume.value": lambda f: implicit.Volume().value(f, SAMPLE),
    "Area.sensitivity": lambda f: implicit.Area().sensitivity(f, SAMPLE),
    "ConstantNormals": lambda f: implicit.ConstantNormals()(f, BALL.theta, POINTS),
    "NearIsometric": lambda f: implicit.NearIsometric()(f, BALL.theta, POINTS),
    "smooth_union": lambda f: shapes.smooth_union(f, BALL),
}


def _of_the_field() -> Iterator[BadCase]:
    for function, call in TAKES_A_FIELD.items():
        yield from refusals(function, "field", no_fields(), call, "field", "Field")


def _of_points() -> Iterator[BadCase]:
    takers: dict[str, Call] = {
        "Field.value": BALL.value,
        "Field.gradient": BALL.gradient,
        "Field.value_and_gradient": BALL.value_and_gradient,
        "Field.hessian": BALL.hessian,
        "Field.normal": BALL.normal,
        "Field.mean_curvature": BALL.mean_curvature,
        "project_to_surface": lambda x: implicit.project_to_surface(BALL, x),
        "basis": lambda x: implicit.basis(BALL, x),
        "normal_displacement": lambda x: implicit.normal_displacement(BALL, x, BALL.theta),
        "adjoint": lambda x: implicit.adjoint(BALL, x, SAMPLE.weights),
        "BasisFunction": implicit.basis_function(BALL, 0),
        "ConstantNormals": lambda x: implicit.ConstantNormals()(BALL, BALL.theta, x),
        "semantic_edit": lambda x: implicit.semantic_edit(BALL, x, WAYS),
    }
    for function, call in takers.items():
        yield from refusals(function, "points", bad_points(), call)
    yield from refusals(
        "NearIsometric", "points",
        [bad for bad in bad_points() if bad[0] not in ("float32", "float16")],
        lambda x: implicit.NearIsometric()(BALL, BALL.theta, x),
    )  # fmt: skip
    bad_tracks = [bad for bad in bad_points() if bad[1] is not None and "float" not in bad[0]]  # None carries nothing
    edits: dict[str, Call] = {
        "geometric_edit": lambda t: implicit.geometric_edit(BALL, HANDLE, points=SAMPLE, track=t),
        "semantic_edit": lambda t: implicit.semantic_edit(BALL, POINTS, 0.1 * POINTS, track=t),
        "smooth": lambda t: implicit.smooth(BALL, steps=1, step_size=1e-4, points=20, resolution=16, track=t),
        "converged_smooth": lambda t: implicit.converged_smooth(BALL, time=1e-4, steps=1, points=20, track=t),
    }
    for function, call in edits.items():
        yield from refusals(function, "track", bad_tracks, call)
        yield from refusals(function, "track", [("off the surface", 3 * POINTS)], call, "surface")
    yield from refusals(
        "rigid_edit",
        "track",
        bad_tracks,
        _rigid("track"),
    )
    center: list[Bad] = [("where the gradient vanishes", torch.zeros(1, 3, dtype=torch.float64))]
    torus = shapes.torus(0.5, 0.2)
    for function, call in {"Field.normal": torus.normal, "basis": lambda x: implicit.basis(torus, x)}.items():
        yield from refusals(function, "points", center, call, "points", "gradient")
    yield from refusals(
        "project_to_surface",
        "points",
        [("far away", 100 * POINTS)],
        lambda x: implicit.project_to_surface(BALL, x),
        "points",
        "reach",
    )
    yield from refusals(
        "project_to_surface", "reach", positives(), lambda x: implicit.project_to_surface(BALL, POINTS, reach=x)
    )
    yield from refusals(
        "project_to_surface", "tolerance", positives(), lambda x: implicit.project_to_surface(BALL, POINTS, tolerance=x)
    )
    yield from refusals(
        "normal_displacement", "d_theta", vectors(4), lambda x: implicit.normal_displacement(BALL, POINTS, x)
    )
    yield from refusals(
        "normal_displacement",
        "lengths",
        vectors(4),
        lambda x: implicit.normal_displacement(BALL, POINTS, BALL.theta, x),
    )
    yield from refusals("adjoint", "weights", vectors(4), lambda x: implicit.adjoint(BALL, POINTS, x))
    yield from refusals("adjoint", "lengths", vectors(4), lambda x: implicit.adjoint(BALL, POINTS, SAMPLE.weights, x))
    yield from refusals("ConstantNormals", "d_theta", vectors(4), lambda x: implicit.ConstantNormals()(BALL, x, POINTS))
    yield from refusals("NearIsometric", "d_theta", vectors(4), lambda x: implicit.NearIsometric()(BALL, x, POINTS))
    yield from refusals("ConstantNormals", "least_curvature", positives(), implicit.ConstantNormals)
    yield from refusals("Field.with_theta", "theta", vectors(4)[2:], BALL.with_theta)


class _Raising(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(1))

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        raise RuntimeError("no")


class _Wrong(nn.Module):
    """Gives whatever it is made with."""

    def __init__(self, answer: Callable[[torch.Tensor], Any]) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(1))
        self.answer = answer

    def forward(self, points: torch.Tensor) -> Any:
        return self.answer(points)


def _with_nan() -> nn.Module:
    module = implicit.Siren(width=4, depth=1)
    with torch.no_grad():
        module.layers[0].weight[0, 0] = torch.nan
    return module


def _of_fields() -> Iterator[BadCase]:
    siren = implicit.Siren(width=4, depth=1)
    mixed = implicit.Siren(width=4, depth=1)
    mixed.layers[0].double()
    modules: list[Bad] = [
        ("None", None),
        ("a function", lambda x: x[:, 0]),
        ("a field", BALL),
        ("without parameters", nn.Tanh()),
        ("with NaN", _with_nan()),
        ("without numbers, on the meta device", implicit.Siren(width=4, depth=1).to("meta")),
        ("of two precisions", mixed),
        ("complex", nn.Linear(3, 1, dtype=torch.complex64)),
        ("that raises", _Raising()),
        ("of three values a point", _Wrong(lambda x: x)),
        ("of one value for all", _Wrong(lambda x: x.sum())),
        ("of no tensor", _Wrong(lambda x: "0")),
        ("of whole numbers", _Wrong(lambda x: x[:, 0].long())),
        ("of complex numbers", _Wrong(lambda x: x[:, 0] * 1j)),
    ]
    yield from refusals("Field", "module", modules, implicit.Field, "must")
    modules = [("for other points", nn.Linear(2, 1)), ("a decoder", _Wrong(lambda x, z: x))]
    yield from refusals("Field", "module", modules, implicit.Field, "module")
    parameters: list[Bad] = [("unknown", ["no.such"]), ("none", []), ("a number", 3), ("numbers", [3])]
    yield from refusals("Field", "parameters", parameters, lambda x: implicit.Field(siren, parameters=x), "parameter")
    levels: list[Bad] = [("NaN", np.nan), ("infinite", np.inf), ("a word", "zero"), ("None", None)]
    yield from refusals("Field", "level", levels, lambda x: implicit.Field(siren, level=x))
    yield from refusals("Field", "inside", choices(), lambda x: implicit.Field(siren, inside=x))
    bounds: list[Bad] = [
        ("upside down", ((1, 1, 1), (-1, -1, -1))),
        ("flat", ((-1, -1, 0), (1, 1, 0))),
        ("NaN", ((-1, -1, np.nan), (1, 1, 1))),
        ("infinite", ((-np.inf, -1, -1), (1, 1, 1))),
        ("in four dimensions", ((-1,) * 4, (1,) * 4)),
        ("in one dimension", ((-1,), (1,))),
        ("one corner", (1, 1, 1)),
        ("ragged", ((-1, -1), (1, 1, 1))),
        ("a word", "cube"),
        ("None", None),
    ]
    yield from refusals("Field", "bounds", bounds, lambda x: implicit.Field(siren, bounds=x))
    yield from refusals(
        "Field", "units", [("a number", 2.0), ("a word", "mm")], lambda x: implicit.Field(siren, units=x)
    )
    yield from refusals(
        "Field", "units", [("in the plane", implicit.Units(1.0, (0.0, 0.0)))], lambda x: implicit.Field(siren, units=x)
    )
    yield from refusals("Units", "scale", positives(), implicit.Units)
    offsets: list[Bad] = [("NaN", (0.0, 0.0, np.nan)), ("a word", "far"), ("one number", 3.0)]
    yield from refusals("Units", "offset", offsets, lambda x: implicit.Units(1.0, x))
    dtypes: list[Bad] = [("of whole numbers", torch.int64), ("complex", torch.complex64), ("a word", "double")]
    yield from refusals("Field.to", "dtype", dtypes, SIREN.to)
    yield from refusals(
        "Field.to", "device", [("without numbers", "meta"), ("unknown", "abacus")], lambda x: SIREN.to(device=x)
    )

    def decoder(points: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
        return points.norm(dim=1) - code[0]

    code = torch.tensor([0.5, 0.1])
    latents: list[Bad] = [
        ("of two axes", code[None]),
        ("empty", code[:0]),
        ("whole numbers", torch.tensor([1, 2])),
        ("NaN", code * torch.nan),
        ("a list", [0.5, 0.1]),
        ("None", None),
        ("on the meta device", code.to("meta")),
    ]
    yield from refusals("decoder_field", "latent", latents, lambda x: implicit.decoder_field(decoder, x))
    decoders: list[Bad] = [("None", None), ("a number", 3), ("of one argument", lambda points: points[:, 0])]
    yield from refusals("decoder_field", "decoder", decoders, lambda x: implicit.decoder_field(x, code))
    yield from refusals(
        "decoder_field",
        "weights",
        [("of a function", ["*"])],
        lambda x: implicit.decoder_field(decoder, code, weights=x),
    )
    names: list[Bad] = [
        ("unknown", "no.such"),
        ("beyond its shape", "layers.0.weight[99, 0]"),
        ("of too few axes", "layers.0.weight[1]"),
        ("beyond theta", 10**6),
        ("negative", -1),
        ("a fraction", 0.5),
        ("None", None),
    ]
    yield from refusals(
        "basis_function", "parameter", names[:1] + names[3:], lambda x: implicit.basis_function(SIREN, x)
    )
    yield from refusals(
        "basis_function",
        "parameter",
        names[1:3],
        lambda x: implicit.basis_function(SIREN, x),
        "shape",
        "layers.0.weight",
    )
    sizes: dict[str, list[Bad]] = {
        "dimension": [("four", 4), ("a fraction", 2.5)],
        "width": counts(),
        "depth": counts(),
    }
    for name, values in sizes.items():
        yield from refusals("Siren", name, values, lambda x, name=name: implicit.Siren(**{name: x}))
    for name in ("first_frequency", "frequency"):
        yield from refusals("Siren", name, positives(), lambda x, name=name: implicit.Siren(**{name: x}))


def _of_regions() -> Iterator[BadCase]:
    centers: list[Bad] = [
        ("NaN", (0.0, 0.0, np.nan)),
        ("a word", "middle"),
        ("None", None),
        ("one number", 0.0),
        ("ragged", (0.0, (1.0, 2.0), 3.0)),
    ]
    flat: list[Bad] = [("in the plane", (0.0, 0.0))]
    yield from refusals("Ball", "radius", positives()[:3] + positives()[4:], lambda x: implicit.Ball((0, 0, 0), x))
    yield from refusals("Ball", "center", centers, lambda x: implicit.Ball(x, 1.0))
    yield from refusals("Ball", "center", flat, lambda x: implicit.Ball(x, 1.0)(POINTS), "dimensions")
    yield from refusals("Ball", "falloff", not_negatives(), lambda x: implicit.Ball((0, 0, 0), 1.0, x))
    yield from refusals(
        "Box", "lower", [("above upper", (2, 2, 2)), *centers, *flat], lambda x: implicit.Box(x, (1, 1, 1))
    )
    yield from refusals("Box", "falloff", not_negatives(), lambda x: implicit.Box((0, 0, 0), (1, 1, 1), x))
    yield from refusals(
        "HalfSpace", "normal", [("zero", (0, 0, 0)), *centers], lambda x: implicit.HalfSpace((0, 0, 0), x)
    )
    yield from refusals("HalfSpace", "point", centers, lambda x: implicit.HalfSpace(x, (0, 0, 1)))
    yield from refusals("HalfSpace", "falloff", not_negatives(), lambda x: implicit.HalfSpace((0, 0, 0), (0, 0, 1), x))
    near: list[Bad] = [
        ("none", POINTS[:0]),
        ("of one axis", POINTS[0]),
        ("NaN", POINTS * np.nan),
        ("None", None),
        ("words", [["a", "b", "c"]]),
    ]
    yield from refusals("NearPoints", "centers", near, lambda x: implicit.NearPoints(x, 0.1))
    yield from refusals("NearPoints", "radius", positives()[:3], lambda x: implicit.NearPoints(POINTS, x))
    yield from refusals("NearPoints", "falloff", not_negatives(), lambda x: implicit.NearPoints(POINTS, 0.1, x))
    picked: list[Bad] = [("none", []), ("too large", [10**6]), ("negative", [-1]), ("a word", "all"), ("NaN", [np.nan])]
    yield from refusals("PickedVertices", "picked", picked, lambda x: implicit.PickedVertices(POINTS, x))
    yield from refusals("PickedVertices", "vertices", near[:2], lambda x: implicit.PickedVertices(x, [0]))
    others: list[Bad] = [("a number", 3), ("None", None)]
    yield from refusals("Region &", "other", others, lambda x: EVERYWHERE & x, "region")
    yield from refusals("Region |", "other", others, lambda x: EVERYWHERE | x, "region")


def _of_handles() -> Iterator[BadCase]:
    def edit(handle: object) -> object:
        return implicit.geometric_edit(BALL, handle, points=SAMPLE)  # type: ignore[arg-type]

    yield from refusals(
        "Handle",
        "region",
        [("None", None), ("a number", 3), ("a list", [0, 1])],
        lambda x: implicit.Handle(x, (0, 0, 1)),
    )
    displacements: list[Bad] = [("None", None), ("a word", "up"), ("NaN", (0.0, 0.0, np.nan)), ("a dictionary", {})]
    yield from refusals("Handle", "displacement", displacements, lambda x: implicit.Handle(EVERYWHERE, x))
    in_use: list[Bad] = [
        ("of two numbers", (0.0, 1.0)),
        ("a function of the wrong shape", lambda x: x[:, :2]),
        ("a function of NaN", lambda x: x * np.nan),
        ("a function of nothing", lambda x: None),
        ("along NaN", implicit.Along(lambda x: x[:, 0] * np.nan)),
        ("along vectors", implicit.Along(lambda x: x)),
    ]
    yield from refusals("Handle", "displacement", in_use, lambda x: edit(implicit.Handle(EVERYWHERE, x)))
    distances: list[Bad] = [("NaN", np.nan), ("infinite", np.inf), ("a word", "far"), ("None", None)]
    yield from refusals("Along", "distance", distances, implicit.Along)
    rotations: list[Bad] = [
        ("a reflection", np.diag([1.0, 1.0, -1.0])),
        ("no rotation", np.ones((3, 3))),
        ("of two numbers", (0.0, 1.0)),
        ("NaN", (0.0, 0.0, np.nan)),
        ("a word", "left"),
        ("an angle in space", 0.5),
    ]
    yield from refusals(
        "RigidMotion", "rotation", rotations, lambda x: edit(implicit.Handle(EVERYWHERE, implicit.RigidMotion(x)))
    )
    shifts: list[Bad] = [("of two numbers", (0.0, 1.0)), ("NaN", (0.0, 0.0, np.nan)), ("a word", "left")]
    for name in ("translation", "center"):
        yield from refusals(
            "RigidMotion", name, shifts,
            lambda x, name=name: edit(implicit.Handle(EVERYWHERE, implicit.RigidMotion((0, 0, 0.1), **{name: x}))),
        )  # fmt: skip
    factors: list[Bad] = [("zero", 0.0), ("negative", -1.0), ("NaN", np.nan), ("a word", "twice"), ("None", None)]
    yield from refusals("Scaling", "factor", factors, implicit.Scaling)
    yield from refusals(
        "Scaling", "center", shifts, lambda x: edit(implicit.Handle(EVERYWHERE, implicit.Scaling(2.0, x)))
    )
    regions: list[Bad] = [
        ("of the wrong shape", lambda x: x),
        ("above one", lambda x: 2 + x[:, 0]),
        ("NaN", lambda x: x[:, 0] * np.nan),
        ("of nothing", lambda x: None),
    ]
    yield from refusals("Handle", "region", regions, lambda x: edit(implicit.Handle(x, (0, 0, 1))))
    away: list[Bad] = [("off the surface", implicit.Ball((5, 5, 5), 0.1))]
    missed = ("No point of the surface lies in the region of handles[0]", "move or widen the region")
    yield from refusals("Handle", "region", away, lambda x: edit(implicit.Handle(x, (0, 0, 1))), *missed)
    handles: list[Bad] = [
        ("none", []),
        ("None", None),
        ("a region", EVERYWHERE),
        ("regions", [EVERYWHERE]),
        ("a word", "top"),
    ]
    takers: dict[str, Call] = {
        "geometric_edit": edit,
        "rigid_edit": lambda x: implicit.rigid_edit(BALL, x, points=SAMPLE),
        "expressibility": lambda x: implicit.expressibility(BALL, x),
        "prescribe": lambda x: implicit.prescribe(BALL, x),
        "trained_rigid_step": lambda x: implicit.trained_rigid_step(BALL, x, points=SAMPLE),
    }
    for function, call in takers.items():
        yield from refusals(function, "handles", handles, call)


def _geometric(name: str) -> Call:
    return lambda x: implicit.geometric_edit(BALL, HANDLE, **{"points": SAMPLE, name: x})


def _rigid(name: str) -> Call:
    return lambda x: implicit.rigid_edit(BALL, [HANDLE], **{"points": SAMPLE, name: x})


def _smooth(name: str) -> Call:
    return lambda x: implicit.smooth(BALL, **{"steps": 1, "step_size": 1e-4, "points": 20, "resolution": 16, name: x})


def _converged(name: str) -> Call:
    return lambda x: implicit.converged_smooth(BALL, **{"time": 1e-4, "steps": 1, "points": 20, name: x})


def _semantic(name: str) -> Call:
    return lambda x: implicit.semantic_edit(BALL, POINTS, 0.1 * POINTS, **{name: x})


def _of_converged() -> Iterator[BadCase]:
    for name in ("time", "tolerance"):
        yield from refusals("converged_smooth", name, positives(), _converged(name))
    for name in ("steps", "most_steps"):
        yield from refusals("converged_smooth", name, counts(), _converged(name))


def _of_edits() -> Iterator[BadCase]:
    bad_numbers: list[Bad] = [bad for bad in counts() if bad[0] != "a list"]
    held: list[Bad] = [
        ("None", None),
        ("a word", "volume"),
        ("words", ["volume"]),
        ("a class", [implicit.Volume]),
        ("one alone", implicit.Volume()),
    ]
    for function, make in (("geometric_edit", _geometric), ("rigid_edit", _rigid), ("smooth", _smooth)):
        yield from refusals(function, "constraints", held, make("constraints"))
        yield from refusals(function, "damping", not_negatives(), make("damping"))
        yield from refusals(function, "resolution", counts(4), make("resolution"))
        yield from refusals(function, "points", [*bad_numbers, ("None", None)], make("points"))
        yield from refusals(function, "seed", counts(0), make("seed"))
        yield from refusals(function, "progress", [("a word", "bar"), ("a number", 3)], make("progress"))
    yield from refusals(
        "geometric_edit", "rest", [*choices()[:1], *not_negatives()[:3], ("None", None)], _geometric("rest")
    )
    yield from refusals("geometric_edit", "steps", counts(), _geometric("steps"))
    cosines: list[Bad] = [("one", 1.0), ("negative", -0.5), ("NaN", np.nan), ("a word", "steep")]
    yield from refusals("geometric_edit", "least_alignment", cosines, _geometric("least_alignment"))
    yield from refusals("geometric_edit", "off_surface_strength", not_negatives(), _geometric("off_surface_strength"))
    yield from refusals("rigid_edit", "steps", counts(), _rigid("steps"))
    for name in ("alpha",):
        yield from refusals("rigid_edit", name, positives(), _rigid(name))
    for name in ("bending", "thickness"):
        yield from refusals("rigid_edit", name, not_negatives(), _rigid(name))
    yield from refusals("rigid_edit", "tangential", [("a word", "cosines"), ("a number", 3)], _rigid("tangential"))
    yield from refusals(
        "rigid_edit", "field", [("in the plane", CIRCLE)], lambda f: implicit.rigid_edit(f, [HANDLE]), "in 3 dimensions"
    )
    small = implicit.Handle(implicit.Ball(POINTS[0], 0.01), (0.1, 0.0, 0.0))
    yield BadCase(
        "rigid_edit: handles at one point",
        lambda: implicit.rigid_edit(BALL, [small], points=SAMPLE),
        ("handles", "three"),
    )
    yield from refusals("smooth", "steps", counts(), _smooth("steps"))
    yield from refusals("smooth", "step_size", positives(), _smooth("step_size"))
    yield from refusals("smooth", "method", choices(), _smooth("method"))
    yield from refusals("smooth", "flow", [("a word", "willmore"), ("a class", implicit.Bending)], _smooth("flow"))
    yield from refusals("smooth", "where", [("a word", "top"), ("a number", 3)], _smooth("where"))
    yield from refusals("smooth", "until", [("a word", "round"), ("a number", 3)], _smooth("until"))
    yield from refusals("smooth", "holding", [("a word", "rows")], _smooth("holding"))
    yield from refusals("smooth", "off_surface_strength", not_negatives(), _smooth("off_surface_strength"))
    yield from refusals("smooth", "restore", not_negatives(), _smooth("restore"))
    yield from refusals("smooth", "directions", counts(), _smooth("directions"))
    yield from refusals(
        "explicit_step_limit", "points", counts(), lambda x: implicit.explicit_step_limit(BALL, points=x)
    )
    yield from refusals(
        "explicit_step_limit", "directions", counts(), lambda x: implicit.explicit_step_limit(BALL, directions=x)
    )
    for name in ("time", "area", "sphericity"):
        yield from refusals("Until", name, positives(), lambda x, name=name: implicit.Until(**{name: x}))
    yield from refusals(
        "MeanCurvature", "level", [("unknown", "median"), ("NaN", np.nan), ("None", None)], implicit.MeanCurvature
    )
    yield from refusals("Offset", "speed", [("NaN", np.nan), ("a word", "fast"), ("None", None)], implicit.Offset)
    yield from refusals("Holding", "enforce", choices(), implicit.Holding)
    for name in ("tolerance", "penalty"):
        yield from refusals("Holding", name, positives(), lambda x, name=name: implicit.Holding(**{name: x}))
    for name in ("resolution", "fine_resolution", "finest_resolution"):
        yield from refusals("Holding", name, counts(4), lambda x, name=name: implicit.Holding(**{name: x}))
    yield from refusals(
        "semantic_edit",
        "displacements",
        bad_points(WAYS)[:1] + bad_points()[1:],
        lambda d: implicit.semantic_edit(BALL, POINTS, d),
    )
    yield from refusals(
        "semantic_edit",
        "displacements",
        [("too few", WAYS[:2]), ("zero", WAYS)],
        lambda d: implicit.semantic_edit(BALL, POINTS, d),
        "displacement",
    )
    yield from refusals(
        "semantic_edit",
        "points",
        [("off the surface", 3 * POINTS), ("none", POINTS[:0])],
        lambda x: implicit.semantic_edit(BALL, x, WAYS[: len(x)]),
    )
    yield from refusals("semantic_edit", "steps", counts(), _semantic("steps"))
    yield from refusals("semantic_edit", "damping", not_negatives(), _semantic("damping"))
    for name in ("stride", "trust_region"):
        yield from refusals("semantic_edit", name, positives(), _semantic(name))
    for name in ("least_alignment", "tolerance"):
        yield from refusals("semantic_edit", name, [("two", 2.0), *not_negatives()], _semantic(name))
    yield from refusals("semantic_edit", "prior", [("a word", "gauss")], _semantic("prior"))
    codes = torch.randn(5, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    yield from refusals(
        "semantic_edit", "prior", [("of a field without code", implicit.CodePrior.of(codes))], _semantic("prior")
    )
    bad_codes: list[Bad] = [
        ("one", codes[:1]),
        ("of one axis", codes[0]),
        ("NaN", codes * np.nan),
        ("a list", codes.tolist()),
        ("None", None),
    ]
    yield from refusals("CodePrior.of", "codes", bad_codes, implicit.CodePrior.of)
    yield from refusals("CodePrior.of", "weight", not_negatives(), lambda x: implicit.CodePrior.of(codes, x))
    yield from refusals("prescribe", "points", counts(), lambda x: implicit.prescribe(BALL, HANDLE, x))
    yield from refusals("prescribe", "resolution", counts(4), lambda x: implicit.prescribe(BALL, HANDLE, resolution=x))
    yield from refusals("expressibility", "steps", counts(), lambda x: implicit.expressibility(BALL, HANDLE, steps=x))
    yield from refusals("expressibility", "points", counts(), lambda x: implicit.expressibility(BALL, HANDLE, points=x))
    yield from refusals(
        "expressibility", "damping", not_negatives(), lambda x: implicit.expressibility(BALL, HANDLE, damping=x)
    )
    for name in ("iterations", "width", "depth"):
        yield from refusals(
            "trained_rigid_step",
            name,
            counts(),
            lambda x, name=name: implicit.trained_rigid_step(BALL, [HANDLE], points=SAMPLE, **{name: x}),
        )
    yield from refusals("LearnedFeatures", "network", [("None", None), ("a field", BALL)], implicit.LearnedFeatures)


def _of_samples() -> Iterator[BadCase]:
    yield from refusals("sample_surface", "n", counts(), lambda x: implicit.sample_surface(BALL, x))
    yield from refusals("sample_surface", "method", choices(), lambda x: implicit.sample_surface(BALL, 5, x))
    yield from refusals(
        "sample_surface",
        "resolution",
        [*counts(4), ("enormous", 10**5)],
        lambda x: implicit.sample_surface(BALL, 5, resolution=x),
    )
    yield from refusals(
        "sample_surface",
        "resolution of rejection",
        counts(4),
        lambda x: implicit.sample_surface(BALL, 5, "rejection", resolution=x),
        "resolution",
    )
    yield from refusals("sample_surface", "seed", counts(0), lambda x: implicit.sample_surface(BALL, 5, seed=x))
    yield from refusals(
        "sample_surface",
        "generator",
        [("of numpy", np.random.default_rng(0)), ("a number", 3)],
        lambda x: implicit.sample_surface(BALL, 5, generator=x),
    )
    densities: list[Bad] = [
        ("negative", lambda x: -torch.ones(len(x))),
        ("NaN", lambda x: torch.full((len(x),), torch.nan)),
        ("of one number", lambda x: torch.tensor(1.0)),
        ("of nothing", lambda x: None),
        ("a number", 2.0),
    ]
    yield from refusals(
        "sample_surface", "density", densities, lambda x: implicit.sample_surface(BALL, 5, density=x, resolution=16)
    )
    yield BadCase(
        "sample_surface: density for farthest",
        lambda: implicit.sample_surface(BALL, 5, "farthest", density=lambda x: x[:, 0]),
        ("density", "method"),
    )
    yield from refusals(
        "integrate", "tolerance", positives(), lambda x: implicit.integrate(BALL, implicit.Volume(), 8, tolerance=x)
    )
    yield from refusals(
        "integrate", "finest", counts(4), lambda x: implicit.integrate(BALL, implicit.Volume(), 8, finest=x)
    )
    takers: dict[str, Call] = {
        "extract_mesh": lambda x: implicit.extract_mesh(BALL, x),
        "surface_quadrature": lambda x: implicit.surface_quadrature(BALL, x),
        "integrate": lambda x: implicit.integrate(BALL, implicit.Volume(), x),
        "field_soundness": lambda x: implicit.field_soundness(BALL, x),
        "surface_topology": lambda x: implicit.surface_topology(BALL, x),
    }
    for function, call in takers.items():
        yield from refusals(function, "resolution", [*counts(4), ("enormous", 10**5), ("astronomical", 10**30)], call)
    yield from refusals(
        "extract_mesh",
        "resolution in the plane",
        [*counts(4), ("enormous", 10**7)],
        lambda x: implicit.extract_mesh(CIRCLE, x),
        "resolution",
    )
    yield from refusals(
        "extract_mesh",
        "memory_limit",
        positives()[:3] + positives()[4:],
        lambda x: implicit.extract_mesh(BALL, 8, memory_limit=x),
    )
    inside_out = implicit.Field(BALL.module, inside="positive")
    empty, full = shapes.sphere(0.5, bounds=((2, 2, 2), (3, 3, 3))), shapes.sphere(5.0, bounds=((-1,) * 3, (1,) * 3))
    broken = BALL.with_theta(BALL.theta)
    broken.theta[0] = torch.nan
    for function, call in {**takers, "sample_surface": lambda f: None}.items():
        for what, field in (("outside its bounds", empty), ("full", full), ("inside out", inside_out), ("NaN", broken)):
            calls: dict[str, Call] = {
                "extract_mesh": lambda f: implicit.extract_mesh(f, 16),
                "surface_quadrature": lambda f: implicit.surface_quadrature(f, 16),
                "integrate": lambda f: implicit.integrate(f, implicit.Area(), 16),
                "field_soundness": lambda f: implicit.field_soundness(f, 16),
                "surface_topology": lambda f: implicit.surface_topology(f, 16),
                "sample_surface": lambda f: implicit.sample_surface(f, 10, resolution=16),
            }
            yield BadCase(
                f"{function}: field {what}", lambda call=calls[function], field=field: call(field), ("bounds",)
            )
    yield BadCase(
        "sample_surface: field empty, by rejection",
        lambda: implicit.sample_surface(empty, 10, "rejection"),
        ("bounds",),
    )
    no_samples: list[Bad] = [
        ("None", None),
        ("points", POINTS),
        ("of another precision", SAMPLE.to(torch.float32)),
        ("of another device", SAMPLE.to(device="meta")),
    ]
    takes_samples: dict[str, Call] = {
        "Volume.value": lambda s: implicit.Volume().value(BALL, s),
        "Area.value": lambda s: implicit.Area().value(BALL, s),
        "Volume.sensitivity": lambda s: implicit.Volume().sensitivity(BALL, s),
        "VolumeIntegral.value": lambda s: implicit.VolumeIntegral(lambda x: x[:, 0]).value(BALL, s),
        "SurfaceIntegral.value": lambda s: implicit.SurfaceIntegral(lambda x: x[:, 0]).value(BALL, s),
        "SurfaceIntegral.sensitivity": lambda s: implicit.SurfaceIntegral(lambda x: x[:, 0]).sensitivity(BALL, s),
        "surface_modes": lambda s: implicit.surface_modes(BALL, s, 1),
        "mirror_symmetry": lambda s: implicit.mirror_symmetry(BALL, s, torch.zeros(4, 1)),
        "transport": lambda s: implicit.transport(BALL, s, WAYS),
        "geometric_edit": lambda s: implicit.geometric_edit(BALL, HANDLE, points=s),
    }
    for function, call in takes_samples.items():
        yield from refusals(
            function, "sample", no_samples, call, "points" if function == "geometric_edit" else "sample"
        )
    parts: dict[str, list[Bad]] = {
        "points": [("NaN", POINTS * np.nan)],
        "normals": [("too few", POINTS[:2])],
        "weights": [("too few", SAMPLE.weights[:2]), ("of two axes", SAMPLE.weights[None])],
    }
    for name, values in parts.items():
        yield from refusals(
            "SurfaceSample",
            name,
            values,
            lambda x, name=name: implicit.Volume().value(BALL, replace(SAMPLE, **{name: x})),
        )
    yield from refusals(
        "transport",
        "displacement",
        [("too few", WAYS[:2]), ("NaN", WAYS * np.nan), ("an array", WAYS.numpy()), ("None", None)],
        lambda d: implicit.transport(BALL, SAMPLE, d),
    )
    yield BadCase(
        "transport: displacement to nowhere", lambda: implicit.transport(shapes.sphere(0.1), SAMPLE, WAYS), ("reach",)
    )
    yield from refusals(
        "surface_modes", "count", [*counts(), ("too large", 99)], lambda x: implicit.surface_modes(BALL, SAMPLE, x)
    )
    yield from refusals(
        "mirror_symmetry",
        "axis",
        [*counts(0), ("too large", 3)],
        lambda x: implicit.mirror_symmetry(BALL, SAMPLE, torch.zeros(4, 1, dtype=torch.float64), axis=x),
    )
    yield from refusals(
        "mirror_symmetry", "directions", vectors(4, 1)[2:], lambda x: implicit.mirror_symmetry(BALL, SAMPLE, x)
    )
    away = shapes.sphere(0.3, (0.4, 0.1, 0.0))
    shifted = implicit.sample_surface(away, 50, resolution=16)
    yield BadCase(
        "mirror_symmetry: surface not symmetric",
        lambda: implicit.mirror_symmetry(away, shifted, torch.zeros(4, 1, dtype=torch.float64)),
        ("symmetric", "axis"),
    )
    V, F = np.zeros((3, 3)), np.array([[0, 1, 2]])
    meshes: list[Bad] = [
        ("beyond the vertices", F + 1),
        ("negative", F - 1),
        ("of four corners", [[0, 1, 2, 0]]),
        ("fractions", F + 0.5),
        ("None", None),
    ]
    yield from refusals("mesh_topology", "F", meshes, lambda f: implicit.mesh_topology(V, f))
    yield from refusals(
        "mesh_topology", "V", [("of one axis", V[0]), ("None", None)], lambda v: implicit.mesh_topology(v, F)
    )


def _of_functionals() -> Iterator[BadCase]:
    kinds: dict[str, Call] = {
        "Volume": implicit.Volume,
        "Area": implicit.Area,
        "VolumeIntegral": lambda **k: implicit.VolumeIntegral(lambda x: x[:, 0], **k),
        "SurfaceIntegral": lambda **k: implicit.SurfaceIntegral(lambda x: x[:, 0], **k),
    }
    for function, make in kinds.items():
        targets: list[Bad] = [("NaN", np.nan), ("infinite", np.inf), ("a word", "large")]
        yield from refusals(function, "target", targets, lambda x, make=make: make(target=x))
        yield from refusals(function, "bound", choices(), lambda x, make=make: make(bound=x))
    yield from refusals(
        "VolumeIntegral", "nodes", counts(), lambda x: implicit.VolumeIntegral(lambda p: p[:, 0], nodes=x)
    )
    densities: list[Bad] = [
        ("of the wrong shape", lambda x: x),
        ("of one number", lambda x: x.sum()),
        ("of nothing", lambda x: None),
        ("of NaN", lambda x: x[:, 0] * np.nan),
    ]
    yield from refusals("VolumeIntegral", "h", [("a number", 1.0), ("None", None)], implicit.VolumeIntegral, "h must")
    yield from refusals("SurfaceIntegral", "g", [("a number", 1.0), ("None", None)], implicit.SurfaceIntegral, "g must")
    yield from refusals(
        "VolumeIntegral", "h in use", densities, lambda x: implicit.VolumeIntegral(x).value(BALL, SAMPLE), "h must"
    )
    yield from refusals(
        "SurfaceIntegral", "g in use", densities, lambda x: implicit.SurfaceIntegral(x).value(BALL, SAMPLE), "g must"
    )
    yield from refusals(
        "integrate",
        "functional",
        [("None", None), ("a word", "volume"), ("a class", implicit.Volume)],
        lambda x: implicit.integrate(BALL, x, 16),
    )


def _of_fits() -> Iterator[BadCase]:
    points = torch.tensor(np.random.default_rng(0).uniform(-1, 1, (200, 3)))
    distances = points.norm(dim=1) - 0.5
    distances[:20] *= 1e-2
    normals = points / points.norm(dim=1, keepdim=True)

    def fit(points: Any = points, distances: Any = distances, normals: Any = normals, **options: Any) -> object:
        return implicit.fit_field(points, distances, normals, **{"steps": 1, "width": 2, "depth": 1, **options})

    free = [bad for bad in bad_points(points) if bad[0] not in ("float32", "float16", "of two columns")]
    yield from refusals(
        "fit_field", "points", [*free, ("none", points[:0]), ("of two columns", points[:, :2])], lambda x: fit(points=x)
    )
    bad_distances: list[Bad] = [
        ("NaN", distances * np.nan), ("too few", distances[:9]), ("of two axes", distances[:, None]), ("None", None),
        ("an array", distances.numpy()), ("whole numbers", distances.long()),
        ("on another device", distances.to("meta")),
    ]  # fmt: skip
    yield from refusals("fit_field", "distances", bad_distances, lambda x: fit(distances=x))
    yield from refusals(
        "fit_field",
        "distances",
        [("all outside", distances.abs()), ("all inside", -distances.abs()), ("all far", distances + distances.sign())],
        lambda x: fit(distances=x),
        "surface",
    )
    bad_normals: list[Bad] = [
        ("NaN", normals * np.nan),
        ("too few", normals[:9]),
        ("of one axis", normals[:, 0]),
        ("None", None),
        ("on another device", normals.to("meta")),
    ]
    yield from refusals("fit_field", "normals", bad_normals, lambda x: fit(normals=x))
    for name, least in (("width", 1), ("depth", 1), ("steps", 1), ("batch", 4), ("seed", 0)):
        yield from refusals("fit_field", name, counts(least), lambda x, name=name: fit(**{name: x}))
    for name in ("seconds", "learning_rate", "band", "first_frequency", "frequency"):
        yield from refusals("fit_field", name, positives(), lambda x, name=name: fit(**{name: x}))
    for name in ("activation", "method"):
        yield from refusals("fit_field", name, choices(), lambda x, name=name: fit(**{name: x}))
    bounds: list[Bad] = [
        ("in the plane", ((-1, -1), (1, 1))),
        ("upside down", ((1, 1, 1), (-1, -1, -1))),
        ("NaN", ((np.nan,) * 3, (1,) * 3)),
        ("infinite", ((-np.inf,) * 3, (1,) * 3)),
        ("a word", "cube"),
        ("one corner", (1, 1, 1)),
    ]
    yield from refusals("fit_field", "bounds", bounds, lambda x: fit(bounds=x))
    yield from refusals(
        "fit_field", "dtype", [("of whole numbers", torch.int64), ("a word", "float")], lambda x: fit(dtype=x)
    )
    yield from refusals("fit_field", "units", [("a number", 3.0)], lambda x: fit(units=x))
    modules: list[Bad] = [
        ("a word", "my_nets.py:make"), ("a class", nn.Linear), ("a function", torch.sin), ("a field", BALL),
        ("frozen", nn.Linear(3, 1).requires_grad_(False)), ("of two coordinates", nn.Linear(2, 1)),
        ("of four values", nn.Linear(3, 4)), ("without parameters", nn.ReLU()),
        ("on another device", nn.Linear(3, 1).to("meta")),
    ]  # fmt: skip
    own = {"width": 32, "depth": 3}
    yield from refusals("fit_field", "module", modules, lambda x: fit(module=x, **own))
    starts: list[Bad] = [("a word", "spot"), ("a module", nn.Linear(3, 1)), ("in the plane", shapes.circle(0.5))]
    yield from refusals("fit_field", "start", starts, lambda x: fit(start=x, **own))
    yield BadCase("fit_field: module and start", lambda: fit(module=nn.Linear(3, 1), start=BALL, **own), ("module",))
    yield BadCase("fit_field: width beside a module", lambda: fit(module=nn.Linear(3, 1)), ("width", "module"))
    yield from refusals(
        "fit_field",
        "checkpoint",
        [("in no folder", "gone/fit.safetensors"), ("a folder", ".")],
        lambda x: fit(checkpoint=x),
        "checkpoint",
    )

    def from_prose() -> object:
        Path("prose.safetensors").write_text("Dear all")
        return fit(checkpoint="prose.safetensors")

    yield BadCase("fit_field: checkpoint prose", from_prose, ("prose.safetensors", "checkpoint"))


def _prose(name: str, read: Call) -> object:
    Path(name).write_text("Dear all, please find the field attached, as agreed.")
    return read(name)


def _of_own_modules() -> Iterator[BadCase]:
    foreign = implicit.Field(nn.Sequential(nn.Linear(3, 1)))
    names: list[Bad] = [
        ("without a function", "my_nets.py"), ("of no file", "gone.py:make"), ("of no module", "gone.nets:make"),
        ("of another function", "json:make"), ("that builds none", "json:dumps"), ("with a space", "json:ma ke"),
        ("empty", ""), ("a number", 3), ("a path", "/:make"), ("a class", nn.Linear),
    ]  # fmt: skip
    yield from refusals(
        "save_field", "builder", names, lambda n: implicit.save_field(foreign, "a.safetensors", builder=n)
    )
    bad_arguments: list[Bad] = [
        ("a list", [3]), ("a word", "width"), ("of an array", {"width": np.zeros(3)}), ("of NaN", {"width": np.nan}),
        ("unknown", {"widht": 3}),
    ]  # fmt: skip
    yield from refusals(
        "save_field", "arguments", bad_arguments,
        lambda a: implicit.save_field(foreign, "a.safetensors", builder="torch.nn:Linear", arguments=a),
    )  # fmt: skip

    def of_a_builder(module: Any) -> object:
        linear = implicit.Field(nn.Linear(3, 1))
        implicit.save_field(
            linear, "own.safetensors", builder="torch.nn:Linear", arguments={"in_features": 3, "out_features": 1}
        )
        return implicit.load_field("own.safetensors", module=module)

    makers: list[Bad] = [
        ("not named", None), *[bad for bad in names if bad[0] != "a class"], ("of other shapes", nn.Linear(3, 2)),
        ("of other tensors", nn.Sequential(nn.Linear(3, 1))),
    ]  # fmt: skip
    yield from refusals("load_field", "module", makers, of_a_builder)
    yield from refusals("load_network", "architecture", choices(), lambda a: implicit.load_network("gone.pt", a))
    for network in ("auto", "siren", "neus"):
        yield BadCase(
            f"load_network: {network} prose.pt",
            lambda network=network: _prose("prose.pt", lambda p: implicit.load_network(p, network)),
            ("prose.pt",),
        )
    for option in ("first_frequency", "frequency", "scale", "sharpness"):
        yield from refusals(
            "load_network", option, [bad for bad in positives() if bad[1] is not None],
            lambda x, option=option: implicit.load_network("gone.pt", **{option: x}),
        )  # fmt: skip


def _of_files() -> Iterator[BadCase]:
    def cut(length: int) -> object:
        implicit.save_field(SIREN, "whole.safetensors")
        Path("cut.safetensors").write_bytes(Path("whole.safetensors").read_bytes()[:length])
        return implicit.load_field("cut.safetensors")

    def swapped(old: bytes, new: bytes) -> object:
        implicit.save_field(SIREN, "whole.safetensors")
        content = Path("whole.safetensors").read_bytes()
        assert old in content
        assert len(old) == len(new)
        Path("swapped.safetensors").write_bytes(content.replace(old, new))
        return implicit.load_field("swapped.safetensors")

    for length in (0, 4, 8, 100, 300, 500):
        yield BadCase(
            f"load_field: file cut to {length} bytes", lambda length=length: cut(length), ("cut.safetensors",)
        )
    changes = {
        "of another format": (b"implicit-field-1", b"implicit-field-9"),
        "of an unknown network": (b"siren", b"sirup"),
        "of no side": (b"negative", b"negatine"),
        "of another width": (b'\\"width\\": 4', b'\\"width\\": 5'),
        "of no JSON": (b'{\\"format', b'[\\"format'),
        "of an argument unknown": (b'\\"depth\\"', b'\\"dupth\\"'),
        "of no units": (b'\\"units\\": [1.0', b'\\"units\\": [0.0'),
    }
    for what, (old, new) in changes.items():
        yield BadCase(f"load_field: file {what}", lambda old=old, new=new: swapped(old, new), ("swapped.safetensors",))

    yield BadCase(
        "load_field: file prose", lambda: _prose("prose.safetensors", implicit.load_field), ("prose.safetensors",)
    )
    paths: list[Bad] = [("missing", "gone.safetensors"), ("a folder", "."), ("a device", "/dev/null")]
    yield from refusals("load_field", "path", paths, implicit.load_field, "file")
    yield from refusals("load_field", "path", [("None", None), ("a number", 10**6)], implicit.load_field)
    nowhere: list[Bad] = [
        ("in no folder", "gone/a.safetensors"),
        ("under a device", "/dev/null/a.safetensors"),
        ("a folder", "/"),
    ]
    yield from refusals("save_field", "path", nowhere, lambda p: implicit.save_field(SIREN, p), "written", "folder")
    yield from refusals(
        "save_field", "path", [("None", None), ("a number", 10**6)], lambda p: implicit.save_field(SIREN, p)
    )
    foreign = implicit.Field(nn.Sequential(nn.Linear(3, 1)))
    yield BadCase(
        "save_field: field of a foreign module",
        lambda: implicit.save_field(foreign, "a.safetensors"),
        ("describes itself",),
    )
    yield from refusals("load_checkpoint", "architecture", choices(), lambda a: implicit.load_checkpoint("gone.pt", a))
    for architecture in ("imnet", "dualsdf", "deepsdf"):
        load = lambda p, architecture=architecture: implicit.load_checkpoint(p, architecture)  # noqa: E731
        for name in ("prose.pt", "prose.safetensors"):
            yield BadCase(
                f"load_checkpoint: {architecture} {name}", lambda name=name, load=load: _prose(name, load), (name,)
            )
        yield from refusals(
            f"load_checkpoint {architecture}", "path", [("missing", "gone.pt"), ("a folder", ".")], load, "checkpoint"
        )
        yield from refusals(f"load_checkpoint {architecture}", "path", [("None", None)], load)

        def saved(content: object, load: Call = load) -> object:
            torch.save(content, "saved.pt")
            return load("saved.pt")

        contents: list[Bad] = [
            ("a tensor", torch.zeros(3)),
            ("an empty dictionary", {}),
            ("other tensors", {"a.weight": torch.zeros(3, 3)}),
            ("a function", {"f": print}),
        ]
        yield from refusals(f"load_checkpoint {architecture}", "file", contents, saved, "saved.pt")
    yield from refusals("families.bundled", "name", choices(), families.bundled, "there are")


def _of_shapes() -> Iterator[BadCase]:
    yield from refusals("bundled", "name", choices(), shapes.bundled, "there are")
    makers: dict[str, Call] = {
        "sphere: radius": shapes.sphere,
        "sphere: scale": lambda x: shapes.sphere(scale=x),
        "circle: radius": shapes.circle,
        "torus: R": lambda x: shapes.torus(x, 0.1),
        "torus: r": lambda x: shapes.torus(0.5, x),
        "cylinder: radius": lambda x: shapes.cylinder(radius=x),
        "ellipsoid: radii": lambda x: shapes.ellipsoid((0.3, 0.4, x)),
        "smooth_union: blend": lambda x: shapes.smooth_union(BALL, BALL, blend=x),
    }
    for name, make in makers.items():
        function, argument = name.split(": ")
        yield from refusals(function, argument, positives(), make)
    yield from refusals(
        "smooth_union", "others", [("in the plane", CIRCLE)], lambda f: shapes.smooth_union(BALL, f), "dimension"
    )
    centers: list[Bad] = [("in the plane", (0.0, 0.0)), ("NaN", (0.0, 0.0, np.nan)), ("a word", "middle")]
    yield from refusals("sphere", "center", centers, lambda x: shapes.sphere(0.5, x))
    yield from refusals("exact_area", "field", [("a network", SIREN), ("None", None)], shapes.exact_area, "field")
    yield from refusals("exact_volume", "field", [("a network", SIREN), ("None", None)], shapes.exact_volume, "field")
