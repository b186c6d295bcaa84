"""Modules that people bring: each is either right, against the live module itself, or refused with a remedy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrizations, spectral_norm, weight_norm

from implicit import (
    Along,
    Field,
    HalfSpace,
    Handle,
    adjoint,
    basis,
    decoder_field,
    expressibility,
    extract_mesh,
    geometric_edit,
    normal_displacement,
    sample_surface,
    smooth,
)
from implicit.sensitivity.boundary_sensitivity import parameter_gradient, parameter_gradient_and_slope
from tests.implicit.field.foreign_modules import (
    AROUND,
    BODIES,
    CUTTING,
    Autocast,
    Ball,
    Branches,
    By,
    Caches,
    Checkpointed,
    ClosesOverItself,
    ComplexWaves,
    Cut,
    Cutting,
    Encoded,
    Form,
    FunctionalDropout,
    InCompany,
    InPlace,
    Listed,
    MadeAnew,
    Merges,
    NewSine,
    Noisy,
    Not,
    OldSine,
    OnceSine,
    Recurrent,
    Scripted,
    SilentlyOnceSine,
    Skip,
    Twice,
    TwoArguments,
    Uncopyable,
    Unused,
    Voxels,
    WithConv,
    WrongSine,
    compiled_method,
    each_linear,
    layers,
    pruned,
    tied,
    with_batch_norm,
    with_hooks,
)

pytestmark = [
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:The module cannot be vectorised"),
    pytest.mark.filterwarnings("ignore:None of the inputs have requires_grad"),
]

Make = Callable[[], nn.Module]

SQUARE = ((-1.0, -1.0), (1.0, 1.0))

# A handle on a part of the disc, and options that keep an edit small.
HANDLE = Handle(HalfSpace((0, 0.2), (0, 1)), Along(0.01))
SMALL = {"steps": 1, "points": 16, "resolution": 10}


def field_of(module: nn.Module, **options: Any) -> Field:
    return Field(module, bounds=SQUARE, **options)


def in_place_compiled() -> nn.Module:
    module = Ball(layers())
    module.compile(backend="eager")
    return module


def first(result: Any) -> torch.Tensor:
    return result[0]


def encoded_plainly(module: Any, points: torch.Tensor) -> torch.Tensor:
    """The same function as all encodings, whose live module takes no float64 itself."""
    phases = points @ torch.randn(2, 12, generator=torch.Generator().manual_seed(1)).double()
    return points.norm(dim=1) - 0.5 + 0.1 * module.last(torch.cat([phases.sin(), phases.cos()], dim=1))[:, 0]


def complex_plainly(module: Any, points: torch.Tensor) -> torch.Tensor:
    """The same in double precision, which `double()` gives no complex buffer."""
    waves = torch.exp(1j * (points.to(torch.complex128) @ module.matrix.to(torch.complex128))).real
    return points.norm(dim=1) - 0.5 + 0.02 * module.last(waves)[:, 0]


# Name: the module, the options of Field, and how it is called plainly at points (N, 3), where not as module(points).
RIGHT: dict[str, tuple[Make, dict[str, Any], Callable[[Any, torch.Tensor], torch.Tensor] | None]] = {
    "plain": (lambda: Ball(layers()), {}, None),
    "relu": (lambda: Ball(layers(nn.ReLU)), {}, None),
    "older weight norm": (lambda: each_linear(weight_norm), {}, None),
    "weight norm": (lambda: each_linear(parametrizations.weight_norm), {}, None),
    "older spectral norm": (lambda: each_linear(spectral_norm), {}, None),
    "spectral norm": (lambda: each_linear(parametrizations.spectral_norm), {}, None),
    "pruned": (pruned, {}, None),
    "registered twice": (Twice, {}, None),
    "tied": (lambda: tied("object"), {}, None),
    "tied by memory": (lambda: tied("memory"), {}, None),
    "skip, softplus 100": (Skip, {}, None),
    **{
        f"encoding in a {way}": (lambda way=way: Encoded(way), {}, encoded_plainly)
        for way in (
            "buffer", "attribute", "list", "dictionary", "object", "closure", "partial", "cell", "namespace", "method"
        )
    },
    "a lambda over itself": (ClosesOverItself, {}, None),
    "copying makes it anew": (MadeAnew, {}, None),
    "copying fails": (Uncopyable, {}, None),
    "batched": (lambda: Form("batched"), {"inputs": "batched"}, lambda m, x: m(x[None])),
    "columns": (lambda: Form("columns"), {"inputs": "columns"}, lambda m, x: m(x.T)),
    "batched columns": (
        lambda: Form("batched columns"), {"inputs": "batched columns"}, lambda m, x: m(x.T[None])
    ),
    "dictionary in": (
        lambda: Form("dictionary"), {"inputs": lambda x: {"coords": x}}, lambda m, x: m({"coords": x})
    ),
    "batched out": (lambda: Form("batched", "batched"), {"inputs": "batched"}, lambda m, x: m(x[None])),
    "tuple out": (lambda: Form("", "tuple"), {"output": 0}, lambda m, x: m(x)[0]),
    "dictionary out": (lambda: Form("", "dictionary"), {"output": "sdf"}, lambda m, x: m(x)["sdf"]),
    "many values": (lambda: Form("", "many"), {"output": 0}, lambda m, x: m(x)[:, 0]),
    "named tuple out": (lambda: Form("", "named"), {"output": "sdf"}, lambda m, x: m(x).sdf),
    "dataclass out": (lambda: Form("", "object"), {"output": "sdf"}, lambda m, x: m(x).sdf),
    "nested out": (lambda: Form("", "nested"), {"output": ("out", 1, 1)}, lambda m, x: m(x)["out"][1][:, 1]),
    "chosen by a function": (lambda: Form("", "tuple"), {"output": first}, lambda m, x: m(x)[0]),
    "rows out": (lambda: Form("columns", "row"), {"inputs": "columns", "output": 0}, lambda m, x: m(x.T)[0]),
    "convolutions": (WithConv, {"inputs": "batched columns"}, lambda m, x: m(x.T[None])),
    "compiled": (lambda: torch.compile(Ball(layers()), backend="eager"), {}, lambda m, x: m._orig_mod(x)),
    "compiled in place": (in_place_compiled, {}, lambda m, x: m.forward(x)),
    "compiled within": (
        lambda: Ball(torch.compile(layers(), backend="eager")),
        {},
        lambda m, x: x.norm(dim=1) - 0.5 + 0.1 * m.network._orig_mod(x)[:, 0],
    ),
    "compiled method": (
        compiled_method, {}, lambda m, x: x.norm(dim=1) - 0.5 + 0.1 * m.network(x)[:, 0]
    ),
    "data parallel": (lambda: nn.DataParallel(Ball(layers())), {}, None),
    "traced": (lambda: torch.jit.trace(Ball(layers()).double(), torch.rand(4, 2).double()), {}, None),
    "scripted within": (Scripted, {}, None),
    "autograd.Function of the old style": (lambda: By(OldSine), {}, None),
    "autograd.Function": (lambda: By(NewSine), {}, None),
    "differentiable once": (lambda: By(OnceSine), {}, None),
    "differentiable once, unsaid": (lambda: By(SilentlyOnceSine), {}, None),
    "branches on its data": (Branches, {}, None),
    "in place": (InPlace, {}, None),
    "parameters in a list beside": (Listed, {}, None),
    "recurrent": (Recurrent, {}, None),
    "voxels": (Voxels, {}, None),
    "complex waves": (ComplexWaves, {}, complex_plainly),
    "batch norm and dropout in training": (with_batch_norm, {}, None),
    "functional dropout": (lambda: FunctionalDropout(always=False), {}, None),
    "a head that is not used": (Unused, {}, None),
}  # fmt: skip


def made(name: str) -> tuple[nn.Module, Field, Callable[[torch.Tensor], torch.Tensor]]:
    """Return a module in float64, its field, and the values of the live module in evaluation mode."""
    make, options, call = RIGHT[name]
    module = make().double()

    def plainly(points: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            result = module(points) if call is None else call(module, points)
        return result.reshape(-1).double()

    field = field_of(module, **options)
    return module.eval(), field, plainly


def differences(field: Field, plainly: Callable[[torch.Tensor], torch.Tensor], points: torch.Tensor, way: torch.Tensor):
    """Return the change of the live module's own values along a change of its parameters, really written."""
    step = 1e-6
    ends = []
    for sign in (1, -1):
        field.with_theta(field.theta + sign * step * way).write_back()
        ends.append(plainly(points))
    field.write_back()
    return (ends[0] - ends[1]) / (2 * step)


# One of each way in which a module is held, copied and differentiated, which whole edits are made of.
EDITED = (
    "plain", "older spectral norm", "registered twice", "encoding in a closure", "copying makes it anew",
    "batched columns", "nested out", "compiled method", "traced", "scripted within", "branches on its data", "in place",
    "autograd.Function of the old style", "differentiable once, unsaid", "recurrent", "complex waves",
    "batch norm and dropout in training",
)  # fmt: skip


@pytest.mark.parametrize("name", list(RIGHT))
def test_a_foreign_module_is_right(name):
    """Value, gradient, basis, products, a small edit and what is written back, against the live module's own values."""
    _, field, plainly = made(name)
    generator = torch.Generator().manual_seed(4)
    points = sample_surface(field, 12, resolution=10).points
    torch.testing.assert_close(field.value(points), plainly(points), rtol=1e-6, atol=1e-7)  # float32 in some attributes
    gradients = field.gradient(points)
    for axis in range(2):
        step = 1e-6 * torch.eye(2, dtype=torch.float64)[axis]
        slope = (plainly(points + step) - plainly(points - step)) / 2e-6
        torch.testing.assert_close(gradients[:, axis], slope, rtol=1e-5, atol=1e-6)
    way = torch.randn(len(field.theta), generator=generator, dtype=torch.float64)
    rows = basis(field, points)
    change = -differences(field, plainly, points, way) / gradients.norm(dim=1)
    assert (rows @ way - change).norm() <= 1e-5 * change.norm()
    torch.testing.assert_close(normal_displacement(field, points, way), rows @ way)
    torch.testing.assert_close(adjoint(field, points, points[:, 0]), rows.T @ points[:, 0])
    assert not rows.requires_grad

    # An edited field, by an edit or at hand, is seen by nobody until it is written back.
    before = plainly(points)
    edited_field = (
        geometric_edit(field, HANDLE, **SMALL).field if name in EDITED else field.with_theta(field.theta + 0.01 * way)
    )
    assert torch.equal(plainly(points), before)
    edited = edited_field.value(points)
    assert float((edited - before).abs().max()) > 1e-4
    edited_field.write_back()
    torch.testing.assert_close(plainly(points), edited, rtol=1e-6, atol=1e-7)


CHANGING = [
    "older weight norm", "weight norm", "older spectral norm", "spectral norm", "pruned", "registered twice", "tied",
    "tied by memory", "caches", "recurrent", "a lambda over itself",
]  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.nightly) if "older" in name else name for name in CHANGING]
)
def test_no_call_leaves_a_trace_in_the_next(name):
    """Each operation after each other, twice: the same bits, and nothing of it in the caller's module."""
    make = Caches if name == "caches" else RIGHT[name][0]
    module = make().double()
    field = field_of(module)
    points = sample_surface(field, 12, resolution=10).points
    operations = {
        "value": lambda: field.value(points),
        "hessian": lambda: field.hessian(points),
        "basis": lambda: basis(field, points),
        "slopes": lambda: parameter_gradient_and_slope(field, points),
        "displacement": lambda: normal_displacement(field, points, torch.ones_like(field.theta)),
        "expressibility": lambda: torch.as_tensor(expressibility(field, HANDLE, steps=1, points=16).error),
        "float64": lambda: basis(field.to(torch.float32).to(torch.float64), points),
        "mesh": lambda: torch.as_tensor(extract_mesh(field, 10)[0]),
        "edit": lambda: geometric_edit(field, HANDLE, **SMALL).field.theta,
    }
    if name not in ("older weight norm", "older spectral norm", "tied"):
        del operations["expressibility"]  # the slowest, kept where it once spoiled the field
    if name not in ("older weight norm", "older spectral norm", "tied", "caches", "recurrent"):
        del operations["edit"]
    state = {key: value.clone() for key, value in module.state_dict().items()}
    alone = {key: operation() for key, operation in operations.items()}
    quick = [key for key in operations if key not in ("expressibility", "edit")]
    for key in [*reversed(operations), *quick[::2], *quick[1::2]]:
        assert torch.equal(operations[key](), alone[key]), key
    assert all(torch.equal(value, module.state_dict()[key]) for key, value in state.items())
    kept = [v for part in module.modules() for v in part.__dict__.values() if isinstance(v, torch.Tensor)]
    assert all(torch.isfinite(tensor).all() for tensor in kept)  # none is dead


BATCH = "same value in whatever company"
REFUSED: dict[str, tuple[Make, dict[str, Any], str]] = {
    "detached points": (lambda: Cut("detached points"), {}, r"cut off from them\. Remove detach"),
    "no_grad": (lambda: Cut("no_grad"), {}, "cut off from them.*no_grad"),
    "inference mode": (lambda: Cut("inference mode"), {}, "cut off from them"),
    "numpy": (lambda: Cut("numpy"), {}, "cut off from them.*numpy"),
    "detached encoding": (lambda: Cut("detached encoding"), {}, "gradient by its points must be that of its values"),
    "a layer under no_grad": (lambda: Cut("frozen layer"), {}, "gradient by first.weight must be there"),
    "a weight by its data": (lambda: Cut("data"), {}, "gradient by last.weight must be there"),
    "inside or outside": (lambda: Cut("hard"), {}, "cut off from them"),
    "a wrong backward": (lambda: By(WrongSine), {}, "gradient by its p.* must be that of its values"),
    "mean": (lambda: InCompany("mean"), {}, BATCH),
    "a little of the mean": (lambda: InCompany("a little of the mean"), {}, f"{BATCH}.*gradient by another point"),
    "detached mean": (lambda: InCompany("detached mean"), {}, BATCH),
    "largest": (lambda: InCompany("largest"), {}, BATCH),
    "softmax": (lambda: InCompany("softmax"), {}, BATCH),
    "attention": (lambda: InCompany("attention"), {}, BATCH),
    "instance norm": (lambda: InCompany("instance norm"), {}, f"{BATCH}.*instance norm"),
    "order": (lambda: InCompany("order"), {}, BATCH),
    "batch norm": (lambda: with_batch_norm(track_running_stats=False), {}, f"{BATCH}.*track_running_stats"),
    "noise": (Noisy, {}, "same values each time.*drawn at random"),
    "dropout": (lambda: FunctionalDropout(always=True), {}, "same values each time.*functional dropout"),
    "autocast": (Autocast, {}, "bfloat16, too coarse.*autocast"),
    "two arguments": (TwoArguments, {}, "other arguments than points alone: give inputs="),
    "takes (1, N, D)": (lambda: Form("batched"), {}, 'give inputs="batched"'),
    "takes (D, N)": (lambda: Form("columns"), {}, r'takes points \(D, N\): give inputs="columns"'),
    "takes (1, D, N)": (lambda: Form("batched columns"), {}, 'give inputs="batched columns"'),
    "convolutions": (WithConv, {}, 'give inputs="batched columns"'),
    "takes a dictionary": (lambda: Form("dictionary"), {}, "such as in a dictionary, give inputs="),
    "gives a tuple": (lambda: Form("", "tuple"), {}, "a tuple of .* output=0"),
    "gives a dictionary": (lambda: Form("", "dictionary"), {}, "a dict of 'sdf': .* output='sdf'"),
    "gives many values": (lambda: Form("", "many"), {}, r"gave \(5, 5\).* output=0 or output=1"),
    "gives a named tuple": (lambda: Form("", "named"), {}, "output='sdf'"),
    "gives a dataclass": (lambda: Form("", "object"), {}, "gave a Result.* output='sdf'"),
    "gives a nest": (lambda: Form("", "nested"), {}, r"output=\('out', 0, 0\)"),
    "takes a batch, gives many": (lambda: Form("batched", "many"), {}, 'inputs="batched" and output=0'),
    "no such output": (lambda: Form("", "dictionary"), {"output": "udf"}, "output='udf' must name.* output='sdf'"),
    "no such channel": (lambda: Form("", "many"), {"output": 7}, "output=7 must name the place"),
    "no such inputs": (lambda: Form(), {"inputs": "rows"}, "inputs must be None, one of batched"),
    "an output of no kind": (lambda: Form(), {"output": 1.5}, "output must be None, a number, a name"),
    "not a number": (lambda: Not("nan"), {}, "finite values within its bounds"),
    "whole numbers": (lambda: Not("whole numbers"), {}, "5 real values, but gave.*int64"),
    "nothing": (lambda: Not("nothing"), {}, "but gave a NoneType"),
    "an error of its own": (lambda: Not("raises"), {}, "KeyError: 'sdf'"),
    "a sum": (lambda: Not("sum"), {}, "5 real values"),
    "no values": (lambda: Not("empty"), {}, "5 real values"),
    "text": (lambda: Not("text"), {}, "but gave a str"),
    "lazy": (lambda: nn.Sequential(nn.LazyLinear(4), nn.Linear(4, 1)), {}, "is lazy. Call it once"),
    "sparse": (lambda: sparse(), {}, "must be dense"),
    "meta": (lambda: Ball(layers()).to("meta"), {}, "meta device"),
    "a head that is not used": (Unused, {"parameters": ["head.*"]}, "depend on none of them"),
    "checkpointed": (lambda: Checkpointed(reentrant=False), {}, "turn gradient checkpointing off"),
    "checkpointed, older": (lambda: Checkpointed(reentrant=True), {}, "turn gradient checkpointing off"),
    # torch rounds the diagonal of its raw weights to whole signs, so that any step of them makes another matrix.
    "orthogonal weights": (
        lambda: each_linear(parametrizations.orthogonal), {}, "gradient by its parameters must be that of its values"
    ),
}  # fmt: skip


# By turns: each body within every third surrounding, and each surrounding about every third body.
COMBINED = [
    pytest.param(body, around, marks=pytest.mark.nightly if (k + n) % 3 else ())
    for k, body in enumerate(BODIES)
    for n, around in enumerate(AROUND)
]


@pytest.mark.parametrize(("body", "around"), COMBINED)
def test_a_combination_is_right(body, around):
    """Value, slopes, rows, products and what is written back, against the live module's own values."""
    wrap, options, call = AROUND[around]
    inner = BODIES[body]().double()
    module = wrap(inner)
    field = field_of(module, **options)
    inner.eval()

    def plainly(points: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return call(module.eval(), points).reshape(-1).double()

    points = torch.tensor([[0.31, 0.22], [-0.4, 0.37], [0.12, -0.53]], dtype=torch.float64)
    torch.testing.assert_close(field.value(points), plainly(points), rtol=1e-7, atol=1e-8)
    generator = torch.Generator().manual_seed(4)
    way = torch.randn(len(field.theta), generator=generator, dtype=torch.float64)
    gradients = field.gradient(points)
    rows = parameter_gradient(field, points)
    change = differences(field, plainly, points, way)
    assert (rows @ way - change).norm() <= 1e-5 * change.norm()
    step = 1e-6 * torch.ones(2, dtype=torch.float64)
    slopes = (plainly(points + step) - plainly(points - step)) / 2e-6
    torch.testing.assert_close(gradients.sum(dim=1), slopes, rtol=1e-5, atol=1e-6)
    speeds = rows @ way / -gradients.norm(dim=1)
    torch.testing.assert_close(normal_displacement(field, points, way), speeds)
    if body == "tanh":
        single = field.to(torch.float32)
        vertices, _ = extract_mesh(single, 10)
        assert float(single.value(torch.as_tensor(vertices).float()).abs().max()) < 1e-5


@pytest.mark.parametrize("cutting", CUTTING)
@pytest.mark.parametrize("body", list(BODIES)[:5])
def test_a_combination_is_refused_with_a_remedy(body, cutting):
    """Most when the field is made; what is constant on each side of a jump, when its surface is looked for."""
    with pytest.raises((TypeError, ValueError), match=CUTTING[cutting]) as caught:
        sample_surface(field_of(Cutting(BODIES[body](), cutting)), 5, resolution=10)
    assert str(caught.value).rstrip().endswith((".", "that it does."))


def test_there_are_two_hundred_combinations_at_least():
    assert len(COMBINED) + len(CUTTING) * 5 + len(RIGHT) + len(REFUSED) >= 300
    assert len(COMBINED) + len(CUTTING) * 5 >= 200


def sparse() -> nn.Module:
    module = Ball(layers())
    module.table = nn.Parameter(torch.eye(4).to_sparse())
    return module


@pytest.mark.parametrize("name", list(REFUSED))
def test_a_foreign_module_is_refused_with_a_remedy(name):
    make, options, message = REFUSED[name]
    with pytest.raises((TypeError, ValueError), match=message) as caught:
        field_of(make(), **options)
    assert str(caught.value).rstrip().endswith((".", "that it does."))


def test_a_field_is_not_made_in_inference_mode():
    with torch.inference_mode(), pytest.raises(TypeError, match="inference_mode is on"):
        field_of(Ball(layers()))


def test_a_check_can_be_left_out():
    field = field_of(By(WrongSine).double(), check=False)
    assert field.value(torch.zeros(1, 2, dtype=torch.float64)).shape == (1,)


def test_construction_draws_nothing_from_the_global_generator():
    module = Noisy()
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    with pytest.raises(TypeError):
        field_of(module)
    assert torch.equal(torch.rand(3), expected)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_is_worked_on_in_single(dtype):
    module = Ball(layers()).to(dtype)
    field = field_of(module)
    assert field.dtype == torch.float32
    assert "works on float32 copies" in field.notes[0]
    assert field.notes[0] in repr(field)
    points = sample_surface(field, 10, resolution=10).points
    expected = field_of(Ball(layers()).to(dtype).float()).value(points)
    assert torch.equal(field.value(points), expected)
    field.with_theta(field.theta * 1.5).write_back()
    assert all(p.dtype == dtype for p in module.parameters())
    torch.testing.assert_close(
        torch.cat([p.detach().float().reshape(-1) for p in module.parameters()]), field.theta * 1.5, rtol=1e-2, atol=0
    )


def test_training_mode_is_said():
    module = with_batch_norm()
    assert "BatchNorm1d, Dropout: the field takes it in evaluation mode" in field_of(module).notes[0]
    assert module.training
    assert field_of(module.eval()).notes == ()


def test_merging_at_evaluation_is_not_done():
    """The live module in training mode adds its adapter itself; asked for evaluation it would add it to its layer."""
    module = Merges().double()
    field = field_of(module)
    points = torch.rand(5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(field.value(points), module(points).detach())
    assert not module.merged


def test_hooks_on_values_count_and_hooks_on_gradients_do_not():
    module = with_hooks().double()
    field = field_of(module)
    points = sample_surface(field, 8, resolution=10).points
    torch.testing.assert_close(field.value(points), module(points).detach())
    step = 1e-6 * torch.ones(2, dtype=torch.float64)
    slope = (field.value(points + step) - field.value(points - step)) / 2e-6
    torch.testing.assert_close(field.gradient(points).sum(dim=1), slope, rtol=1e-6, atol=1e-7)


def test_parameters_that_move_nothing_are_said_where_they_were_chosen():
    assert field_of(Unused()).notes == ()
    assert "head.weight, head.bias" in field_of(Unused(), parameters=["*"]).notes[0]


@pytest.mark.parametrize("name", ["older weight norm", "compiled", "traced", "tied", "recurrent"])
def test_the_state_of_an_edited_field_is_the_edited_one(name):
    module, field, plainly = made(name)
    edited = field.with_theta(field.theta * 1.05)
    inner = getattr(module, "_orig_mod", module)
    inner.load_state_dict(edited.module.state_dict())
    points = torch.rand(6, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(plainly(points), edited.value(points))
    assert not torch.allclose(field.value(points), edited.value(points))


def test_parameters_that_are_gone_are_not_written_back():
    module = Ball(layers()).double()
    field = field_of(module)
    module.network[0] = nn.Linear(2, 8).double()
    with pytest.raises(ValueError, match=r"network\.0\.weight, network\.0\.bias are no longer in the module"):
        field.write_back()


@pytest.mark.parametrize("function", [OnceSine, SilentlyOnceSine])
def test_missing_second_derivatives_are_refused_and_never_zero(function):
    field = field_of(By(function).double())
    points = sample_surface(field, 10, resolution=10).points
    assert not field.twice_differentiable
    for call in (field.hessian, field.mean_curvature):
        with pytest.raises(ValueError, match="has no second derivatives, and so no curvature"):
            call(points)
    options = {"steps": 1, "step_size": 1e-4, "points": 24, "resolution": 10}
    with pytest.raises(ValueError, match="has no second derivatives"):
        smooth(field, curvature="pointwise", **options)
    assert smooth(field, **options).history[-1]["curvature"] == "weak"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", ["plain", "relu", "skip, softplus 100", "voxels", "autograd.Function"])
def test_second_derivatives_that_are_there_are_taken(name, dtype):
    make, options, _ = RIGHT[name]
    assert field_of(make().to(dtype), **options).twice_differentiable


# Decoders


def network_with_code() -> nn.Module:
    network = nn.Sequential(weight_norm(nn.Linear(4, 8)), nn.Tanh(), nn.Dropout(0.5), weight_norm(nn.Linear(8, 1)))
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.4 * torch.randn(parameter.shape, generator=generator))
    return network


def decoded(network: Any, points: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
    joined = torch.cat([points, code.expand(len(points), -1)], dim=1)
    return points.norm(dim=1) - 0.5 + 0.3 * network(joined)[:, 0]


class Decoder(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.network = network_with_code()

    def forward(self, points, code):
        return decoded(self.network, points, code)


class Trainer:
    """Keeps a network among other things, and decodes by a method."""

    def __init__(self) -> None:
        self.network = network_with_code()
        self.history = [1.0, 2.0]

    def decode(self, points, code):
        return decoded(self.network, points, code)

    __call__ = decode


with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    GLOBAL = network_with_code()


def through_a_global(points: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
    return decoded(GLOBAL, points, code)


def over_a_network() -> Callable[..., torch.Tensor]:
    network = network_with_code()
    return lambda points, code: decoded(network, points, code)


DECODERS: dict[str, Callable[[], Any]] = {
    "a module": Decoder,
    "a function over a network": over_a_network,
    "a function of a global": lambda: through_a_global,
    "a method": lambda: Trainer().decode,
    "an object that is called": Trainer,
    "a partial": lambda: __import__("functools").partial(decoded, network_with_code()),
}


@pytest.mark.parametrize(
    ("name", "dtype"), [*((name, torch.float64) for name in DECODERS), ("a function over a network", torch.float32)]
)
def test_a_decoder_round_a_trained_network_is_right(name, dtype):
    decoder = DECODERS[name]()
    latent = torch.tensor([0.3, -0.2], dtype=dtype)
    field = decoder_field(decoder, latent, bounds=SQUARE)
    points = sample_surface(field, 10, resolution=10).points
    rows = basis(field, points)
    assert rows.shape == (10, 2)
    assert not rows.requires_grad
    step = 1e-2 if dtype == torch.float32 else 1e-6
    for k in range(2):
        way = step * torch.eye(2, dtype=dtype)[k]
        change = field.with_theta(latent + way).value(points) - field.with_theta(latent - way).value(points)
        expected = -change / (2 * step) / field.gradient(points).norm(dim=1)
        torch.testing.assert_close(rows[:, k], expected, rtol=1e-2 if dtype == torch.float32 else 1e-6, atol=1e-4)
    edit = geometric_edit(field, HANDLE, rest="free", **SMALL)
    assert not edit.displacement.requires_grad
    assert field.to(torch.float64).value(points.double()).dtype == torch.float64
    edit.field.write_back()
    assert torch.equal(latent, edit.field.theta)


def test_the_network_in_a_function_is_left_as_it_was():
    network = network_with_code()
    field = decoder_field(lambda points, code: decoded(network, points, code), torch.zeros(2), bounds=SQUARE)
    basis(field, sample_surface(field, 5, resolution=10).points)
    assert network.training
    assert all(parameter.requires_grad for parameter in network.parameters())
    x = torch.rand(4, 4)
    network(x).sum().backward()  # fails where a dead tensor of a transform is left
    before = field.value(torch.ones(1, 2))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
    assert torch.equal(field.value(torch.ones(1, 2)), before)


@pytest.mark.parametrize(
    ("decoder", "options", "message"),
    [
        (lambda x, z: x.norm(dim=1) - 0.5, {}, "depend on its code, but do not"),
        (lambda x, z: x.norm(dim=1) - 0.5 + z.detach().sum(), {}, "must be there"),
        (lambda x, z: (x.norm(dim=1) - 0.5 + z.sum(), x), {}, "output=0"),
        (lambda x, z: x[0].norm(dim=1) - 0.5 + z.sum(), {}, 'inputs="batched"'),
        (lambda x: x.norm(dim=1) - 0.5, {}, "positional argument"),
        (lambda x, z: x.norm(dim=1) - 0.5 + z.sum() + 0.01 * torch.rand(1), {}, "same values each time"),
    ],
    ids=["no code", "detached code", "tuple", "batched", "one argument", "noise"],
)
def test_a_decoder_is_refused_with_a_remedy(decoder, options, message):
    with pytest.raises(TypeError, match=message):
        decoder_field(decoder, torch.zeros(2), bounds=SQUARE, **options)


def test_a_decoder_takes_its_arguments_as_it_wants_them():
    """One joined row a point, values first of two."""
    network = network_with_code().double()

    def joined(points, code):
        return torch.cat([points, code.expand(len(points), -1)], dim=1)

    class Whole(nn.Module):
        def __init__(self):
            super().__init__()
            self.network = network

        def forward(self, row):
            return row[:, :2].norm(dim=1) - 0.5 + 0.3 * self.network(row)[:, 0], row

    latent = torch.tensor([0.3, -0.2], dtype=torch.float64)
    for weights in (None, ["*"]):
        field = decoder_field(Whole(), latent, inputs=joined, output=0, weights=weights, bounds=SQUARE)
        points = sample_surface(field, 6, resolution=10).points
        with torch.no_grad():
            expected = decoded(network.eval(), points, latent)
        torch.testing.assert_close(field.value(points), expected)
        network.train()
