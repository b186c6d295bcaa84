"""Odd modules that people bring, each a disc of radius about 0.5 with a small network on top, made by code and seed.

They are of the plane, where an edit costs a fifth of one in space; what is odd about them knows no dimension. BODIES
times AROUND, and some of them times CUTTING, are made from these for the tests of combinations.
"""

from __future__ import annotations

import functools
import threading
import types
from collections import namedtuple
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils import parametrizations, prune, spectral_norm, weight_norm
from torch.utils.checkpoint import checkpoint


def seeded(module: nn.Module, std: float = 0.4) -> nn.Module:
    """Fill all parameters from one seed."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.copy_(std * torch.randn(parameter.shape, generator=generator))
    return module


def layers(activation: type[nn.Module] = nn.Tanh, width: int = 8) -> nn.Sequential:
    network = nn.Sequential(
        nn.Linear(2, width), activation(), nn.Linear(width, width), activation(), nn.Linear(width, 1)
    )
    return seeded(network)


class Ball(nn.Module):
    """|x| - 0.5 + 0.1 network(x)."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, points):
        return points.norm(dim=-1) - 0.5 + 0.1 * self.network(points).squeeze(-1)


def each_linear(wrap, activation: type[nn.Module] = nn.Tanh) -> nn.Module:
    network = layers(activation)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(3)  # spectral norm draws its vectors
        for k, part in enumerate(network):
            if isinstance(part, nn.Linear):
                network[k] = wrap(part)
        for _ in range(20):  # brings those vectors home, and leaves a product with a history in the older norms
            network(torch.ones(1, 2))
    return Ball(network)


def pruned() -> nn.Module:
    network = layers()
    for part in network:
        if isinstance(part, nn.Linear):
            prune.l1_unstructured(part, "weight", amount=0.3)
    return Ball(network)


class Twice(nn.Module):
    """The same layers in a list and in a sequence."""

    def __init__(self) -> None:
        super().__init__()
        network = layers()
        self.parts = nn.ModuleList([weight_norm(part) if isinstance(part, nn.Linear) else part for part in network])
        self.sequence = nn.Sequential(*self.parts)

    def forward(self, points):
        return points.norm(dim=-1) - 0.5 + 0.1 * self.sequence(points).squeeze(-1)


def tied(kind: str) -> nn.Module:
    network = nn.Sequential(nn.Linear(2, 6), nn.Tanh(), nn.Linear(6, 6), nn.Tanh(), nn.Linear(6, 6), nn.Linear(6, 1))
    seeded(network)
    if kind == "object":
        network[4].weight = network[2].weight
    else:
        network[4].weight.data = network[2].weight.data
    return Ball(network)


class Skip(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.first, self.second, self.last = nn.Linear(2, 6), nn.Linear(8, 6), nn.Linear(6, 1)
        seeded(self)

    def forward(self, points):
        h = F.softplus(self.first(points), beta=100)
        h = F.softplus(self.second(torch.cat([h, points], dim=-1) / 2**0.5), beta=100)
        return points.norm(dim=-1) - 0.5 + 0.1 * self.last(h).squeeze(-1)


class Encoded(nn.Module):
    """sin and cos of the points, the frequencies held in one of many ways; held in float32 whatever the rest."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.last = nn.Linear(24, 1)
        seeded(self)
        matrix = torch.randn(2, 12, generator=torch.Generator().manual_seed(1))
        self.way = way
        self.register_buffer("matrix", matrix) if way == "buffer" else setattr(self, "matrix", None)
        kept = {
            "attribute": {"matrix": matrix},
            "list": {"matrices": [matrix[:, :6].clone(), matrix[:, 6:].clone()]},
            "dictionary": {"matrices": {"a": [matrix]}},
            "object": {"holder": Holder(matrix)},
            "closure": {"encode": lambda x, m=matrix: x @ m},
            "partial": {"encode": functools.partial(torch.matmul, other=matrix)},
            "cell": {"encode": closed_over(matrix)},
            "namespace": {"space": types.SimpleNamespace(matrix=matrix)},
            "method": {"matrix": matrix, "encode": self.by_method},
        }
        for name, value in kept.get(way, {}).items():
            setattr(self, name, value)

    def by_method(self, points):
        return points @ self.matrix

    def phases(self, points):
        if self.way in ("buffer", "attribute"):
            return points @ self.matrix
        if self.way == "list":
            return torch.cat([points @ m for m in self.matrices], dim=-1)
        if self.way == "dictionary":
            return points @ self.matrices["a"][0]
        if self.way == "object":
            return self.holder.encode(points)
        if self.way == "namespace":
            return points @ self.space.matrix
        return self.encode(points)

    def forward(self, points):
        phases = self.phases(points)
        waves = torch.cat([phases.sin(), phases.cos()], dim=-1)
        return points.norm(dim=-1) - 0.5 + 0.1 * self.last(waves).squeeze(-1)


class Holder:
    def __init__(self, matrix) -> None:
        self.matrix = matrix
        self.lock = threading.Lock()

    def encode(self, points):
        return points @ self.matrix


def closed_over(matrix):
    def encode(points):
        return points @ matrix

    return encode


class ClosesOverItself(nn.Module):
    """A lambda that calls a layer of the module."""

    def __init__(self) -> None:
        super().__init__()
        self.network = layers()
        self.run = lambda x: self.network(x)
        self.lock = threading.Lock()

    def forward(self, points):
        return points.norm(dim=-1) - 0.5 + 0.1 * self.run(points).squeeze(-1)


class MadeAnew(nn.Module):
    """Its own copying makes its layers anew, as some published editors' networks do."""

    def __init__(self) -> None:
        super().__init__()
        self.network = each_linear(weight_norm)

    def __deepcopy__(self, memo):
        return MadeAnew()

    def forward(self, points):
        return self.network(points)


class Uncopyable(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.network = Ball(layers())

    def __deepcopy__(self, memo):
        raise RuntimeError("no copies")

    def forward(self, points):
        return self.network(points)


class Form(nn.Module):
    """Takes points and gives values in one of many forms."""

    def __init__(self, takes: str = "", gives: str = "", ball: nn.Module | None = None) -> None:
        super().__init__()
        self.ball, self.takes, self.gives = Ball(layers()) if ball is None else ball, takes, gives

    def forward(self, argument):
        return self.given(*self.taken(argument))

    def taken(self, argument):
        if self.takes == "columns":
            assert argument.shape[0] == 2
            return self.ball(argument.T), argument.T
        if self.takes == "dictionary":
            return self.ball(argument["coords"]), argument["coords"]
        if self.takes:
            _, _, _ = argument.shape
        points = {"batched": lambda: argument[0], "batched columns": lambda: argument[0].T}.get(
            self.takes, lambda: argument
        )()
        return self.ball(points), points

    def given(self, f, points):
        forms = {
            "": lambda: f,
            "tuple": lambda: (f, points),
            "dictionary": lambda: {"sdf": f[:, None], "colour": points},
            "many": lambda: torch.cat([f[:, None], points, points.sin()], dim=1),
            "named": lambda: namedtuple("Result", ["features", "sdf"])(points, f),
            "object": lambda: Result(f, points),
            "nested": lambda: {"out": (points, torch.stack([points[:, 0], f], dim=1))},
            "batched": lambda: f[None, :, None],
            "row": lambda: torch.stack([f, 2 * f]),
        }
        return forms[self.gives]()


@dataclass
class Result:
    sdf: torch.Tensor
    colour: torch.Tensor


class WithConv(nn.Module):
    """Layers as convolutions of width one, which take (1, D, N)."""

    def __init__(self) -> None:
        super().__init__()
        self.network = seeded(nn.Sequential(nn.Conv1d(2, 6, 1), nn.Tanh(), nn.Conv1d(6, 1, 1)))

    def forward(self, points):
        return points.norm(dim=1, keepdim=True) - 0.5 + 0.1 * self.network(points)


def compiled_method() -> nn.Module:
    """A module whose method is compiled; torch takes seconds to load its compiler, so not before it is asked for."""

    class CompiledMethod(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = layers()

        @torch.compile(backend="eager")
        def forward(self, points):
            return points.norm(dim=-1) - 0.5 + 0.1 * self.network(points).squeeze(-1)

    return CompiledMethod()


class Scripted(nn.Module):
    """A scripted network within an ordinary one."""

    def __init__(self) -> None:
        super().__init__()
        self.network = torch.jit.script(layers())

    def forward(self, points):
        return points.norm(dim=-1) - 0.5 + 0.1 * self.network(points).squeeze(-1)


class Checkpointed(nn.Module):
    def __init__(self, reentrant: bool) -> None:
        super().__init__()
        self.network, self.reentrant = layers(), reentrant

    def forward(self, points):
        h = checkpoint(self.network, points, use_reentrant=self.reentrant)
        return points.norm(dim=-1) - 0.5 + 0.1 * h.squeeze(-1)


class OldSine(torch.autograd.Function):
    """An autograd.Function of the old style, differentiable as often as one likes."""

    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.sin()

    @staticmethod
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad * x.cos()


class OnceSine(torch.autograd.Function):
    """Differentiable once, and says so."""

    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.sin()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad * x.cos()


class SilentlyOnceSine(torch.autograd.Function):
    """Differentiable once, and says nothing: what it saves has lost its history."""

    @staticmethod
    def forward(ctx, x):
        ctx.cosine = x.detach().cos()
        return x.sin()

    @staticmethod
    def backward(ctx, grad):
        return grad * ctx.cosine


class NewSine(torch.autograd.Function):
    generate_vmap_rule = True

    @staticmethod
    def forward(x):
        return x.sin()

    @staticmethod
    def setup_context(ctx, inputs, output):
        ctx.save_for_backward(*inputs)

    @staticmethod
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad * x.cos()


class WrongSine(torch.autograd.Function):
    """Its backward is another function's."""

    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.sin()

    @staticmethod
    def backward(ctx, grad):
        return grad * 3


class By(nn.Module):
    """A network of one autograd.Function, throughout: the whole value goes through it."""

    def __init__(self, function) -> None:
        super().__init__()
        self.first, self.last, self.function = seeded(nn.Linear(2, 6)), seeded(nn.Linear(6, 1)), function

    def forward(self, points):
        h = self.last(self.function.apply(self.first(points))).squeeze(-1)
        return points.norm(dim=-1) - 0.5 + 0.2 * h


class Branches(nn.Module):
    """Looks at its data."""

    def __init__(self) -> None:
        super().__init__()
        self.ball = Ball(layers())

    def forward(self, points):
        f = self.ball(points)
        return f if float(f.detach().abs().max()) < 1e9 else -f


class InPlace(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.network = layers()

    def forward(self, points):
        f = torch.zeros(points.shape[0], dtype=points.dtype)
        f[:] = points.norm(dim=-1)
        f -= 0.5
        f += 0.1 * self.network(points).squeeze(-1)
        return f


class Caches(nn.Module):
    """Keeps a product of its weights, its last features and a count, as ordinary attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.network = layers()
        self.scale = nn.Parameter(torch.tensor(1.1))
        self.fused, self.features, self.memory, self.count = None, [], {}, 0

    def forward(self, points):
        if self.fused is None:
            self.fused = self.scale**2
        if "bias" not in self.memory:
            self.memory["bias"] = 0.1 * self.scale
        self.count += 1
        self.features.append(self.network(points))
        return points.norm(dim=-1) * self.fused - 0.5 + self.memory["bias"] * self.features[-1].squeeze(-1)


class Listed(nn.Module):
    """Uses its registered parameters through a list and a dictionary of its own."""

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b = nn.Parameter(torch.ones(2)), nn.Parameter(torch.tensor(0.5))
        self.together, self.named = [self.a], {"b": self.b}

    def forward(self, points):
        return (points * self.together[0]).norm(dim=-1) - self.named["b"]


class Recurrent(nn.Module):
    """A recurrent cell of one step, whose weights torch keeps in a list beside."""

    def __init__(self) -> None:
        super().__init__()
        self.cell, self.last = nn.GRU(2, 6, batch_first=True), nn.Linear(6, 1)
        seeded(self)

    def forward(self, points):
        h = self.cell(points[:, None])[0][:, 0]
        return points.norm(dim=-1) - 0.5 + 0.1 * self.last(h).squeeze(-1)


class Merges(nn.Module):
    """A low-rank adapter that merges itself into its layer when evaluation is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.base, self.last = nn.Linear(2, 6), nn.Linear(6, 1)
        self.down, self.up = nn.Parameter(torch.ones(2, 2)), nn.Parameter(torch.ones(6, 2))
        seeded(self)
        self.merged = False

    def train(self, mode=True):
        super().train(mode)
        if not mode and not self.merged:
            self.base.weight.data += self.up.data @ self.down.data
            self.merged = True
        return self

    def forward(self, points):
        h = self.base(points)
        if not self.merged:
            h = h + points @ self.down.T @ self.up.T
        return points.norm(dim=-1) - 0.5 + 0.1 * self.last(h.tanh()).squeeze(-1)


class Voxels(nn.Module):
    """A dense grid of offsets, interpolated by torch's sampler."""

    def __init__(self) -> None:
        super().__init__()
        self.grid = nn.Parameter(torch.randn(1, 1, 5, 5, generator=torch.Generator().manual_seed(2)) * 0.05)

    def forward(self, points):
        at = F.grid_sample(self.grid, points[None, :, None], align_corners=True, padding_mode="border")
        return points.norm(dim=-1) - 0.5 + at.reshape(-1)


class ComplexWaves(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.last = nn.Linear(8, 1)
        seeded(self)
        self.register_buffer(
            "matrix", torch.randn(2, 8, dtype=torch.complex64, generator=torch.Generator().manual_seed(0))
        )

    def forward(self, points):
        waves = torch.exp(1j * (points.to(self.matrix.dtype) @ self.matrix)).real.to(points.dtype)
        return points.norm(dim=-1) - 0.5 + 0.02 * self.last(waves).squeeze(-1)


def with_hooks() -> nn.Module:
    module = Ball(layers())
    module.network[0].register_forward_hook(lambda part, given, result: result * 1.5)
    module.network[2].register_full_backward_hook(lambda part, given, result: (given[0] * 0,))
    module.network[2].weight.register_hook(lambda gradient: gradient * 0)
    return module


def with_batch_norm(**options) -> nn.Module:
    network = nn.Sequential(nn.Linear(2, 6), nn.BatchNorm1d(6, **options), nn.Tanh(), nn.Dropout(0.5), nn.Linear(6, 1))
    seeded(network)
    if network[1].running_mean is not None:
        network[1].running_mean += 0.1
    return Ball(network)


class FunctionalDropout(nn.Module):
    def __init__(self, always: bool) -> None:
        super().__init__()
        self.network, self.always = layers(), always

    def forward(self, points):
        h = F.dropout(self.network(points), 0.5, training=self.always or self.training)
        return points.norm(dim=-1) - 0.5 + 0.1 * h.squeeze(-1)


class Unused(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.ball = Ball(layers())
        self.head = nn.Linear(2, 2)

    def forward(self, points):
        return self.ball(points)


# What is to be refused


class Cut(nn.Module):
    """Cut off from its points or its parameters, in one of many ways."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.first, self.last, self.way = nn.Linear(2, 8), nn.Linear(8, 1), way
        seeded(self, 1.0)

    def forward(self, points):
        x = points
        if self.way == "detached points":
            x = points.clone().detach().requires_grad_(True)
        if self.way == "no_grad":
            with torch.no_grad():
                return self.whole(x)
        if self.way == "inference mode":
            with torch.inference_mode():
                return self.whole(x)
        if self.way == "numpy":
            x = torch.from_numpy(points.detach().numpy())
        if self.way == "detached encoding":
            return points.norm(dim=-1) - 0.5 + 0.5 * self.last(self.first(4 * points.detach()).sin()).squeeze(-1)
        if self.way == "frozen layer":
            with torch.no_grad():
                weight = self.first.weight * 1.0
            return points.norm(dim=-1) - 0.5 + 0.1 * self.last((x @ weight.T).sin()).squeeze(-1)
        if self.way == "data":
            return (
                points.norm(dim=-1) - 0.5 + 0.1 * self.last.weight.data.sum() * (x @ self.first.weight.T).sin().sum(-1)
            )
        if self.way == "hard":
            return (self.whole(x) > 0).to(points.dtype) - 0.5
        return self.whole(x)

    def whole(self, x):
        return x.norm(dim=-1) - 0.5 + 0.1 * self.last(self.first(x).sin()).squeeze(-1)


class InCompany(nn.Module):
    """Values that depend on the other points."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.ball, self.way = Ball(layers()), way

    def forward(self, points):
        f = self.ball(points)
        if self.way == "mean":
            return f - 0.3 * f.mean()
        if self.way == "a little of the mean":
            return f - 1e-5 * f.mean()
        if self.way == "detached mean":
            return f - 0.3 * f.detach().mean()
        if self.way == "largest":
            return f * (1 + points.norm(dim=1).max())
        if self.way == "softmax":
            return f + torch.softmax(points[:, 0], dim=0)
        if self.way == "attention":
            weights = torch.softmax(points @ points.T, dim=1)
            return f + 0.1 * (weights @ points)[:, 0]
        if self.way == "instance norm":
            return f + 0.1 * F.instance_norm(points.T[None])[0, 0]
        return f + 0.01 * torch.arange(len(points), dtype=points.dtype)


class Noisy(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.ball = Ball(layers())

    def forward(self, points):
        return self.ball(points) + 0.01 * torch.randn(len(points), dtype=points.dtype)


class Autocast(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.ball = Ball(layers())

    def forward(self, points):
        with torch.autocast("cpu", torch.bfloat16):
            return self.ball(points).to(torch.bfloat16)


class TwoArguments(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.ball = Ball(layers())

    def forward(self, points, code):
        return self.ball(points) + code.sum()


class Not(nn.Module):
    """No field at all, in one of many ways."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.ball, self.way = Ball(layers()), way
        self.other = nn.Parameter(torch.ones(2))

    def forward(self, points):
        f = self.ball(points)
        if self.way == "nan":
            return f * float("nan")
        if self.way == "whole numbers":
            return (f * 10).long()
        if self.way == "nothing":
            return None
        if self.way == "raises":
            raise KeyError("sdf")
        if self.way == "sum":
            return f.sum()
        if self.way == "empty":
            return f[:0]
        if self.way == "text":
            return "sdf"
        return f


# Combinations: what may stand round any of the bodies


class Around(nn.Module):
    """A module between its points and its values, in one of many ways that are right."""

    def __init__(self, ball: nn.Module, way: str) -> None:
        super().__init__()
        self.ball, self.way = ball, way
        turn = torch.tensor([[0.8, -0.6], [0.6, 0.8]])
        self.run = lambda points: ball(points)
        if way == "turned by a plain tensor":
            self.turn = turn  # in single precision, whatever the rest
        if way == "stretched by a half-precision buffer":
            self.register_buffer("stretch", torch.tensor([1.0, 1.25]).half())

    def forward(self, points):
        if self.way == "turned by a plain tensor":
            return self.ball(points @ self.turn)
        if self.way == "stretched by a half-precision buffer":
            return self.ball(points * self.stretch.to(points.dtype))
        if self.way == "closed over":
            return self.run(points)
        return torch.sigmoid(-8 * self.ball(points))


class Cutting(nn.Module):
    """A module between its points and its values, in one of many ways that no field can be made of."""

    def __init__(self, ball: nn.Module, way: str) -> None:
        super().__init__()
        self.ball, self.way = ball, way

    def forward(self, points):
        if self.way == "detached points":
            return self.ball(points.detach())
        if self.way == "no_grad":
            with torch.no_grad():
                return self.ball(points)
        if self.way == "inference mode":
            with torch.inference_mode():
                return self.ball(points)
        if self.way == "numpy":
            return torch.from_numpy(self.ball(points).detach().numpy())
        f = self.ball(points)
        ways = {
            "hard": lambda: torch.sign(f),
            "mean": lambda: f - 0.3 * f.mean(),
            "order": lambda: f + 0.01 * torch.arange(len(points), dtype=f.dtype),
            "noise": lambda: f + 0.01 * torch.randn(len(points), dtype=f.dtype),
            "half": lambda: f.half(),
            "tuple": lambda: (f, points),
            "sum": lambda: f.sum(),
            "nan": lambda: f * float("nan"),
        }
        return ways[self.way]()


BODIES = {
    "tanh": lambda: Ball(layers()),
    "relu": lambda: Ball(layers(nn.ReLU)),
    "older weight norm": lambda: each_linear(weight_norm),
    "weight norm": lambda: each_linear(parametrizations.weight_norm),
    "older spectral norm": lambda: each_linear(spectral_norm),
    "pruned": pruned,
    "registered twice": Twice,
    "tied by memory": lambda: tied("memory"),
    "skip": Skip,
    "recurrent": Recurrent,
    "voxels": Voxels,
    "autograd.Function of the old style": lambda: By(OldSine),
    "parameters in a list beside": Listed,
    "batch norm and dropout in training": lambda: with_batch_norm(),
}

# Name: what stands round a body, the options of Field, and how the whole is called plainly at points (N, 2).
AROUND = {
    "batched": (lambda m: Form("batched", ball=m), {"inputs": "batched"}, lambda m, x: m(x[None])),
    "columns": (lambda m: Form("columns", ball=m), {"inputs": "columns"}, lambda m, x: m(x.T)),
    "a dictionary in": (
        lambda m: Form("dictionary", ball=m), {"inputs": lambda x: {"coords": x}}, lambda m, x: m({"coords": x})
    ),
    "a tuple out": (lambda m: Form("", "tuple", m), {"output": 0}, lambda m, x: m(x)[0]),
    "a dictionary out": (lambda m: Form("", "dictionary", m), {"output": "sdf"}, lambda m, x: m(x)["sdf"]),
    "many values out": (lambda m: Form("", "many", m), {"output": 0}, lambda m, x: m(x)[:, 0]),
    "a nest out": (lambda m: Form("", "nested", m), {"output": ("out", 1, 1)}, lambda m, x: m(x)["out"][1][:, 1]),
    "data parallel": (nn.DataParallel, {}, lambda m, x: m(x)),
    "compiled": (lambda m: torch.compile(m, backend="eager"), {}, lambda m, x: m._orig_mod(x)),
    "turned by a plain tensor": (
        lambda m: Around(m, "turned by a plain tensor"), {}, lambda m, x: m.ball(x @ m.turn.to(x))
    ),
    "stretched by a half-precision buffer": (
        lambda m: Around(m, "stretched by a half-precision buffer"), {}, lambda m, x: m(x)
    ),
    "closed over": (lambda m: Around(m, "closed over"), {}, lambda m, x: m(x)),
    "occupancy": (
        lambda m: Around(m, "occupancy"), {"level": 0.5, "inside": "positive"}, lambda m, x: 0.5 - m(x)
    ),
}  # fmt: skip

# Name: what the refusal of it says.
CUTTING = {
    "detached points": "cut off from them",
    "no_grad": "cut off from them",
    "inference mode": "cut off from them",
    "numpy": "cut off from them",
    "hard": "discontinuous",
    "mean": "same value in whatever company",
    "order": "same value in whatever company",
    "noise": "same values each time",
    "half": "float16, too coarse",
    "tuple": "output=0",
    "sum": "5 real values",
    "nan": "finite values within its bounds",
}
