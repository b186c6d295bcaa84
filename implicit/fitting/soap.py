"""Adam in the eigenbasis of Shampoo's preconditioner, for networks of linear layers.

For the gradient G (out, in + 1) of a layer's weight and bias side by side, with running means over the steps

    L = mean G G^T,   R = mean G^T G,   L = U . U^T,   R = V . V^T
    step = - learning_rate U Adam(U^T G V) V^T

The bases U and V are followed by one step of orthogonal iteration every few steps. It costs a few products of
matrices the size of a layer, and reaches the loss of plain Adam in about a third of the steps (see
`implicit.fitting.fit`).

Source: Vyas, Morwani, Zhao, Kwun, Shapira, Brandfonbrener, Janson, Kakade, "SOAP: improving and stabilizing Shampoo
using Adam", ICLR 2025, arXiv:2409.11321, algorithm 3.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Soap:
    """The optimiser of some linear layers; call `step` after their gradients are there.

    Args:
        layers: Layers with weight and bias.
        decay: Of the running means of the gradient, of its square and of the preconditioner.
        rotate: False leaves the bases at the identity: plain Adam.
        every: Steps between two turns of the bases.
    """

    def __init__(
        self,
        layers: Sequence[nn.Linear],
        *,
        decay: tuple[float, float, float] = (0.95, 0.95, 0.95),
        rotate: bool = True,
        every: int = 10,
    ) -> None:
        self.layers = list(layers)
        self.decay = decay
        self.rotate = rotate
        self.every = every
        self.steps = 0
        self.state: dict[str, Tensor] = {}
        for k, layer in enumerate(self.layers):
            m, n = layer.out_features, layer.in_features + 1
            new = layer.weight.new_zeros
            self.state |= {f"{k}.mean": new(m, n), f"{k}.square": new(m, n)}
            if rotate:
                self.state |= {f"{k}.L": new(m, m), f"{k}.R": new(n, n), f"{k}.U": new(m, m), f"{k}.V": new(n, n)}

    @torch.no_grad()
    def step(self, learning_rate: float) -> None:
        """Move the layers once along their gradients."""
        self.steps += 1
        for k, layer in enumerate(self.layers):
            assert layer.weight.grad is not None
            assert layer.bias.grad is not None
            G = torch.cat([layer.weight.grad, layer.bias.grad[:, None]], dim=1)
            self._move(k, layer, G, learning_rate)

    def _move(self, k: int, layer: nn.Linear, G: Tensor, learning_rate: float) -> None:
        of_mean, of_square, of_basis = self.decay
        if self.rotate:
            L, R, U, V = (self.state[f"{k}.{name}"] for name in "LRUV")
            L.mul_(of_basis).addmm_(G, G.T, alpha=1 - of_basis)
            R.mul_(of_basis).addmm_(G.T, G, alpha=1 - of_basis)
            if self.steps == 1:
                U.copy_(_eigenvectors(L))
                V.copy_(_eigenvectors(R))
                return  # as in the source: the first gradient only sets the bases
        mean, square = self.state[f"{k}.mean"], self.state[f"{k}.square"]
        mean.lerp_(G, 1 - of_mean)
        turned = U.T @ G @ V if self.rotate else G
        square.mul_(of_square).addcmul_(turned, turned, value=1 - of_square)
        scaled = (U.T @ mean @ V if self.rotate else mean) / (1 - of_mean**self.steps)
        scaled /= (square / (1 - of_square**self.steps)).sqrt() + 1e-8
        update = U @ scaled @ V.T if self.rotate else scaled
        layer.weight.sub_(update[:, :-1], alpha=learning_rate)
        layer.bias.sub_(update[:, -1], alpha=learning_rate)
        if self.rotate and self.steps % self.every == 0:
            for basis, moment, axis in ((U, L, 0), (V, R, 1)):
                # In the order of their eigenvalues, so that the orthogonal iteration keeps them apart.
                order = (basis * (moment @ basis)).sum(dim=0).argsort(descending=True)
                square.copy_(square.index_select(axis, order))
                basis.copy_(torch.linalg.qr(moment @ basis[:, order])[0])


def _eigenvectors(moment: Tensor) -> Tensor:
    return torch.linalg.eigh(moment)[1].flip(1)
