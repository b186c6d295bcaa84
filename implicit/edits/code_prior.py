"""A Gaussian prior of latent codes, as an energy that keeps a code near those of training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_tensor
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy
from implicit.step.least_squares import Rows


@dataclass(frozen=True, eq=False)
class CodePrior:
    """The Gaussian of a model's training codes, and how strongly an edit is pulled towards it.

    Attributes:
        mean: m (L,).
        spread: S (L, L), lower triangular, S S^T the covariance.
        weight: w of the pull. A code one standard deviation out costs w, as much as one point missed by the root of w.
    """

    mean: Float[Tensor, " l"]
    spread: Float[Tensor, "l l"]
    weight: float

    @classmethod
    def of(cls, codes: Float[Tensor, "s l"], weight: float = 1e-4) -> CodePrior:
        """Return the prior of some codes (S, L); directions in which they do not vary get 1e-3 of the largest spread.

        Raises:
            TypeError: The codes are no floating tensor.
            ValueError: They are fewer than two, or not finite, or the weight is negative.
        """
        require_positive("weight", weight, or_zero=True)
        if not isinstance(codes, Tensor) or codes.ndim != 2 or len(codes) < 2:
            came = f"shape {tuple(codes.shape)}" if isinstance(codes, Tensor) else f"a {type(codes).__name__}"
            raise ValueError(f"codes must be a tensor of at least two codes, a row each, but are {came}.")
        require_tensor("codes", codes, codes.shape, codes.device)
        mean = codes.mean(dim=0)
        away = (codes - mean).double()
        covariance = away.T @ away / (len(codes) - 1)
        floor = 1e-6 * torch.linalg.eigvalsh(covariance).amax().clamp(min=1e-300)
        covariance.diagonal().add_(floor)
        return cls(mean, torch.linalg.cholesky(covariance).to(codes), weight)

    def distance(self, code: Float[Tensor, " l"]) -> float:
        """Return a code's standard deviations from the mean (Mahalanobis); of a typical one, about sqrt(L)."""
        return float(self._whitened(code - self.mean).norm())

    def energy(self, field: Field) -> Energy:
        """Return the pull as an energy of the step from the field's code.

        Raises:
            ValueError: The field edits no code of the prior's length.
        """
        block = next((block for block in field.layout if block.name == "latent"), None)
        if block is None or block.shape != self.mean.shape:
            raise ValueError(
                f"The prior is one of codes of {len(self.mean)} numbers, but the field edits "
                f"{', '.join(f'{b.name} {tuple(b.shape)}' for b in field.layout)}. Make it with decoder_field."
            )
        return _Pull(self, field.theta[block.where], block.where)

    def _whitened(self, away: Tensor) -> Tensor:
        return torch.linalg.solve_triangular(self.spread, away.to(self.spread)[:, None], upper=False)[:, 0]


@dataclass(frozen=True, eq=False)
class _Pull:
    """Energy w |S^-1 (z + d_z - m)|^2."""

    prior: CodePrior
    code: Tensor
    where: slice

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        """Yield the energy's rows."""
        spread = self.prior.spread.to(self.code)
        inverse = torch.linalg.solve_triangular(spread, torch.eye(len(spread)).to(spread), upper=False)
        matrix = self.code.new_zeros(len(self.code), space.size)
        matrix[:, self.where] = inverse
        away = inverse @ (self.prior.mean.to(self.code) - self.code)
        yield Rows(matrix, away, torch.full_like(away, self.prior.weight))
