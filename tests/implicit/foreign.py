"""Modules such as other people write, one of each kind of structure, small enough for tests in float64.

`ARCHITECTURES` names what makes each: a function of a generator seed that returns a module of points (N, 3). Those in
`GENERAL` have no chain of layers to be found, so that they are differentiated point by point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import prune


def chain(width: int, depth: int, activation: Callable[[], nn.Module]) -> nn.Sequential:
    """Linear layers with an activation between them, nothing else."""
    layers: list[nn.Module] = []
    for a, b in pairwise([3] + [width] * depth):
        layers += [nn.Linear(a, b), activation()]
    return nn.Sequential(*layers, nn.Linear(width, 1))


class Sine(nn.Module):
    """sin(frequency x)."""

    def __init__(self, frequency: float) -> None:
        super().__init__()
        self.frequency = frequency

    def forward(self, x: Tensor) -> Tensor:
        return torch.sin(self.frequency * x)


class ImplicitGeometricRegularisation(nn.Module):
    """The layout of Gropp et al. 2020: softplus, a skip at the middle over sqrt(2), near a sphere at the start."""

    def __init__(
        self, width: int = 256, depth: int = 8, skip: int = 4, *, radius: float = 0.5, beta: float = 100
    ) -> None:
        super().__init__()
        self.skip = skip
        widths = [3] + [width] * depth + [1]
        for k, (a, b) in enumerate(pairwise(widths)):
            layer = nn.Linear(a, b - 3 if k + 1 == skip else b)
            if k == depth:
                nn.init.normal_(layer.weight, mean=math.sqrt(math.pi) / math.sqrt(a), std=1e-5)
                nn.init.constant_(layer.bias, -radius)
            else:
                nn.init.constant_(layer.bias, 0.0)
                nn.init.normal_(layer.weight, 0.0, math.sqrt(2) / math.sqrt(layer.out_features))
            setattr(self, f"lin{k}", layer)
        self.depth = depth
        self.activation = nn.Softplus(beta=beta)

    def forward(self, points: Tensor) -> Tensor:
        x = points
        for k in range(self.depth + 1):
            if k == self.skip:
                x = torch.cat([x, points], -1) / math.sqrt(2)
            x = getattr(self, f"lin{k}")(x)
            if k < self.depth:
                x = self.activation(x)
        return x


class DeepSdf(nn.Module):
    """The layout of Park et al. 2019 without a code: weight norm, ReLU, a skip, tanh at the end."""

    def __init__(
        self, width: int = 512, depth: int = 8, skip: int = 4, *, parametrized: bool = False, last: bool = True
    ) -> None:
        super().__init__()
        normed = nn.utils.parametrizations.weight_norm if parametrized else nn.utils.weight_norm
        widths = [3] + [width] * depth + [1]
        layers = [normed(nn.Linear(a, b - 3 if k + 1 == skip else b)) for k, (a, b) in enumerate(pairwise(widths))]
        self.layers = nn.ModuleList(layers)
        self.skip, self.last = skip, last

    def forward(self, points: Tensor) -> Tensor:
        x = points
        for k, layer in enumerate(self.layers):
            if k == self.skip:
                x = torch.cat([x, points], dim=1)
            x = layer(x)
            if k < len(self.layers) - 1:
                x = functional.relu(x)
        return torch.tanh(x) if self.last else x


class Fourier(nn.Module):
    """Sines and cosines of fixed frequencies before a network, as in NeRF."""

    def __init__(self, network: nn.Module, octaves: int = 3) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("frequencies", math.pi / 2 * 2.0 ** torch.arange(octaves))

    def forward(self, points: Tensor) -> Tensor:
        angles = (points[..., None, :] * self.frequencies[:, None]).flatten(-2)
        return self.network(torch.cat([points, angles.sin(), angles.cos()], dim=-1))


class RandomFourier(nn.Module):
    """Gaussian Fourier features, kept as a plain tensor and no buffer."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.B = torch.randn(3, 6)
        self.network = nn.Sequential(nn.Linear(12, width), nn.Tanh(), nn.Linear(width, 1))

    def forward(self, points: Tensor) -> Tensor:
        angles = 2 * torch.pi * 0.3 * points @ self.B.to(points)
        return self.network(torch.cat([torch.sin(angles), torch.cos(angles)], dim=-1))


class Residual(nn.Module):
    """Blocks that add to what they take."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(3, width)
        self.blocks = nn.ModuleList(nn.Linear(width, width) for _ in range(2))
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        x = torch.tanh(self.first(points))
        for block in self.blocks:
            x = x + 0.5 * functional.silu(block(x))
        return self.last(x)[:, 0]


class Gated(nn.Module):
    """Features multiplied with filters of the points, as in multiplicative filter networks."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.filters = nn.ModuleList(nn.Linear(3, width) for _ in range(3))
        self.mixes = nn.ModuleList(nn.Linear(width, width) for _ in range(2))
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        x = torch.sin(self.filters[0](points))
        for mix, sine in zip(self.mixes, self.filters[1:], strict=True):
            x = mix(x) * torch.sin(2 * sine(points))
        return self.last(x)


class Tied(nn.Module):
    """One layer used twice, and once more transposed."""

    def __init__(self, width: int, *, transposed: bool = False) -> None:
        super().__init__()
        self.first, self.middle, self.last = nn.Linear(3, width), nn.Linear(width, width), nn.Linear(width, 1)
        self.transposed = transposed

    def forward(self, points: Tensor) -> Tensor:
        x = torch.tanh(self.first(points))
        x = torch.tanh(self.middle(x))
        x = x @ self.middle.weight if self.transposed else self.middle(x)
        return self.last(torch.sin(x)).squeeze(-1)


class Selected(nn.Module):
    """Distance and features, of which the first counts; a fixed scaling before, a learned one after."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.network = nn.Sequential(
            nn.Linear(3, width), nn.Dropout(0.3), nn.GELU(), nn.Identity(), nn.Linear(width, 5)
        )
        self.scale, self.shift = nn.Parameter(torch.tensor(1.3)), nn.Parameter(torch.zeros(1) + 0.1)

    def forward(self, points: Tensor) -> Tensor:
        features = self.network((points - 0.1) / 1.5)
        return features[..., 0] * self.scale - self.shift


class Convolved(nn.Module):
    """Convolutions one wide, as in occupancy networks, with the points along the last axis."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.middle, self.last = nn.Conv1d(3, width, 1), nn.Conv1d(width, width, 1), nn.Conv1d(width, 1, 1)

    def forward(self, points: Tensor) -> Tensor:
        x = points.T[None]
        x = functional.softplus(self.first(x), beta=4)
        x = x + functional.elu(self.middle(x))
        return self.last(x)[0, 0]


class Batched(nn.Module):
    """A network of batches (1, N, 3), with in-place activations."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.network = nn.Sequential(
            nn.Linear(3, width), nn.LeakyReLU(0.1, inplace=True), nn.Linear(width, width), nn.ELU(inplace=True)
        )
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        return self.last(self.network(points[None])).squeeze(0)


class Matrices(nn.Module):
    """Parameters multiplied by hand, a bias added by hand, slices of one large parameter."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.all = nn.Parameter(torch.randn(width * 6) / 2)
        self.weight = nn.Parameter(torch.randn(width, width) / 3)
        self.width = width

    def forward(self, points: Tensor) -> Tensor:
        w = self.width
        x = torch.sigmoid(points @ self.all[: 3 * w].view(3, w) + self.all[3 * w : 4 * w])
        x = torch.exp(-((x @ self.weight) ** 2))
        x = torch.einsum("ni,i->n", x, self.all[4 * w : 5 * w]) + (x * self.all[5 * w :]).sum(dim=-1)
        return x - points.norm(dim=1).clamp(0.05, 3.0)


class Normed(nn.Module):
    """A norm of the weights on every hidden layer."""

    def __init__(self, width: int, norm: Callable[[nn.Module], nn.Module]) -> None:
        super().__init__()
        self.layers = nn.ModuleList([norm(nn.Linear(3, width)), norm(nn.Linear(width, width))])
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        x = points
        for layer in self.layers:
            x = functional.selu(layer(x))
        return self.last(x)


class Modulated(nn.Module):
    """A code of its own, repeated for each point, joined with it and shifting a layer."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.code = nn.Parameter(torch.randn(4) / 2)
        self.first, self.shift = nn.Linear(7, width), nn.Linear(4, width)
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        code = self.code.expand(len(points), -1)
        x = torch.tanh(self.first(torch.cat([points, code], dim=-1)))
        return self.last(torch.sin(x + self.shift(code)))


class HyperNetwork(nn.Module):
    """A layer whose weights another network computes."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.code = nn.Parameter(torch.randn(3))
        self.maker = nn.Sequential(nn.Linear(3, 5), nn.Tanh(), nn.Linear(5, 4 * width))
        self.last = nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        made = self.maker(self.code)
        n = self.last.in_features
        return self.last(torch.tanh(functional.linear(points, made[: 3 * n].view(n, 3), made[3 * n :])))


# No chain of layers to be found


class DenseGrid(nn.Module):
    """Values on a lattice, interpolated."""

    def __init__(self) -> None:
        super().__init__()
        self.grid = nn.Parameter(_ball(6)[None, None])

    def forward(self, points: Tensor) -> Tensor:
        return functional.grid_sample(self.grid, points[None, None, None], align_corners=True)[0, 0, 0, 0]


class TriPlane(nn.Module):
    """Features on three planes, added and decoded."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.planes = nn.Parameter(torch.randn(3, 4, 6, 6) / 3)
        self.decoder = nn.Sequential(nn.Linear(4, width), nn.Softplus(), nn.Linear(width, 1))

    def forward(self, points: Tensor) -> Tensor:
        pairs = torch.stack([points[:, [0, 1]], points[:, [0, 2]], points[:, [1, 2]]])[:, :, None]
        features = functional.grid_sample(self.planes, pairs, align_corners=True)[..., 0].sum(dim=0).T
        return self.decoder(features)


class HashGrid(nn.Module):
    """A hash table of features at several resolutions, in plain torch, decoded."""

    def __init__(self, width: int, levels: int = 2, entries: int = 32) -> None:
        super().__init__()
        self.table = nn.Parameter(torch.randn(levels, entries, 2) / 2)
        self.decoder = nn.Sequential(nn.Linear(2 * levels, width), nn.Softplus(), nn.Linear(width, 1))
        self.entries = entries

    def forward(self, points: Tensor) -> Tensor:
        features = []
        for level, table in enumerate(self.table):
            x = (points + 1) * 2 ** (level + 1)
            low = x.floor().detach()
            rest, total = x - low, 0.0
            for corner in range(8):
                step = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2 & 1], device=points.device)
                at = low.long() + step
                key = (at[:, 0] ^ (at[:, 1] * 2654435761) ^ (at[:, 2] * 805459861)) % self.entries
                share = torch.where(step.bool(), rest, 1 - rest).prod(dim=1, keepdim=True)
                total = total + share * table[key]
            features.append(total)
        return self.decoder(torch.cat(features, dim=1))


class Attention(nn.Module):
    """Values weighted by a softmax of the point."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.keys, self.values, self.last = nn.Linear(3, width), nn.Linear(3, width), nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        return self.last(torch.softmax(self.keys(points), dim=-1) * torch.sin(self.values(points)))


class Branching(nn.Module):
    """A different layer where the numbers say so."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.near, self.far, self.last = nn.Linear(3, width), nn.Linear(3, width), nn.Linear(width, 1)

    def forward(self, points: Tensor) -> Tensor:
        rows = []
        for point in points:
            layer = self.near if float(point.detach().norm()) < 0.7 else self.far
            rows.append(torch.tanh(layer(point)))
        return self.last(torch.stack(rows))


def _ball(size: int) -> Tensor:
    axis = torch.linspace(-1, 1, size)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij")).norm(dim=0) - 0.6


def _pruned(layer: nn.Module) -> nn.Module:
    weights = layer.weight
    mask = (torch.arange(weights.numel()).view(weights.shape) % 3 > 0).to(weights)  # type: ignore[union-attr, arg-type]
    return prune.custom_from_mask(layer, "weight", mask)  # type: ignore[no-any-return]


def _spectral(layer: nn.Module) -> nn.Module:
    return nn.utils.spectral_norm(layer)


def _new_spectral(layer: nn.Module) -> nn.Module:
    return nn.utils.parametrizations.spectral_norm(layer)  # type: ignore[no-any-return]


ARCHITECTURES: dict[str, Callable[[], nn.Module]] = {
    "relu": lambda: chain(9, 3, nn.ReLU),
    "siren": lambda: chain(9, 3, lambda: Sine(5.0)),
    "softplus": lambda: chain(9, 2, lambda: nn.Softplus(beta=100)),
    "elu": lambda: chain(9, 2, nn.ELU),
    "celu": lambda: chain(9, 2, lambda: nn.CELU(0.5)),
    "silu": lambda: chain(9, 2, nn.SiLU),
    "gelu": lambda: chain(9, 2, nn.GELU),
    "gelu-tanh": lambda: chain(9, 2, lambda: nn.GELU("tanh")),
    "mish": lambda: chain(9, 2, nn.Mish),
    "hardtanh": lambda: chain(9, 2, nn.Hardtanh),
    "igr": lambda: ImplicitGeometricRegularisation(12, 4, 2, beta=10.0),
    "deepsdf": lambda: DeepSdf(12, 4, 2),
    "deepsdf-parametrized": lambda: DeepSdf(12, 4, 2, parametrized=True, last=False),
    "nerf": lambda: Fourier(nn.Sequential(nn.Linear(21, 8), nn.Softplus(5.0), nn.Linear(8, 1))),
    "random-fourier": lambda: RandomFourier(8),
    "residual": lambda: Residual(8),
    "gated": lambda: Gated(8),
    "tied": lambda: Tied(8),
    "tied-transposed": lambda: Tied(8, transposed=True),
    "selected": lambda: Selected(8),
    "convolved": lambda: Convolved(8),
    "batched": lambda: Batched(8),
    "matrices": lambda: Matrices(8),
    "spectral": lambda: Normed(8, _spectral),
    "spectral-parametrized": lambda: Normed(8, _new_spectral),
    "pruned": lambda: Normed(8, _pruned),
    "modulated": lambda: Modulated(8),
    "hyper": lambda: HyperNetwork(6),
    "dense-grid": lambda: DenseGrid(),
    "tri-plane": lambda: TriPlane(6),
    "hash-grid": lambda: HashGrid(6),
    "attention": lambda: Attention(8),
    "branching": lambda: Branching(6),
}

GENERAL = ("dense-grid", "tri-plane", "hash-grid", "attention", "branching")


def make(name: str, dtype: torch.dtype = torch.float64) -> nn.Module:
    """The architecture of that name, the same each time."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(list(ARCHITECTURES).index(name))
        return ARCHITECTURES[name]().to(dtype).eval()
