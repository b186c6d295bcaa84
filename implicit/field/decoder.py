"""Fields of generative models: f(x; z) by a decoder, where an edit moves the latent code z."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_callable
from implicit.field.evaluator import parametrised_by_code
from implicit.field.field import CUBE, Bounds, Field, Units
from implicit.field.forms import Form, Inputs, Output
from implicit.field.frozen import unwrapped


def decoder_field(
    decoder: nn.Module | Callable[[Tensor, Tensor], Tensor],
    latent: Float[Tensor, " l"],
    *,
    output: Output | None = None,
    inputs: Inputs | None = None,
    level: float | None = None,
    inside: Literal["negative", "positive"] | None = None,
    bounds: Bounds | None = None,
    units: Units | None = None,
    weights: Iterable[str] | None = None,
    check: bool = True,
) -> Field:
    """Return a field whose parameters are the latent code of a generative model; the decoder itself stays as it is.

    Of a decoder that is a function, the modules and tensors that it closes over or names are copied like a module's
    parts: what is trained later does not change the field.

    Args:
        decoder: Maps points (N, D) and one code (L,) to values (N,) or (N, 1).
        latent: The code (L,) to start from; `write_back` stores the edited code in it.
        output: As for Field.
        inputs: As for Field; a function here takes points (N, D) and the code (L,).
        level, inside, bounds: As for Field; None takes the decoder's attribute of that name if it has one, else 0,
            "negative" and the cube [-1, 1]^3.
        units: As for Field.
        weights: Names or patterns of the decoder's own parameters to edit together with the code; None edits the code
            alone.
        check: As for Field.

    Raises:
        TypeError: The decoder cannot be called, the code is no floating tensor, or weights are asked of no module.
        ValueError: The code is not one row of finite numbers, or no weight fits the patterns.
    """
    require_callable("decoder", decoder, "a function or module of points (N, D) and a code (L,)")
    if not isinstance(latent, Tensor) or not latent.is_floating_point():
        raise TypeError(f"latent must be a floating tensor of shape (L,), but is {getattr(latent, 'dtype', latent)!r}.")
    if latent.ndim != 1 or len(latent) == 0 or latent.is_meta or not bool(torch.isfinite(latent).all()):
        raise ValueError(
            f"latent must be one code of shape (L,), of finite numbers, but has shape {tuple(latent.shape)} and is "
            f"{latent}."
        )
    level = getattr(decoder, "level", 0.0) if level is None else level
    side: Literal["negative", "positive"] = getattr(decoder, "inside", "negative") if inside is None else inside
    bounds = getattr(decoder, "bounds", CUBE) if bounds is None else bounds
    if weights is not None:
        if not isinstance(decoder, nn.Module):
            raise TypeError(f"weights need a decoder that is a torch module, but it is a {type(decoder).__name__}.")
        patterns = [weights] if isinstance(weights, str) else list(weights)
        chosen = ["latent", *(f"decoder.{pattern}" for pattern in patterns)]
        both = _WithCode(unwrapped(decoder), latent, Form(inputs, output))
        return Field(both, parameters=chosen, level=level, inside=side, bounds=bounds, units=units, check=check)
    source = parametrised_by_code(decoder, latent, Form(inputs, output))
    return Field(source, level=level, inside=side, bounds=bounds, units=units, check=check)


class _WithCode(nn.Module):
    """A decoder with its code as one more parameter, which shares the caller's memory."""

    def __init__(self, decoder: nn.Module, latent: Tensor, form: Form) -> None:
        super().__init__()
        self._form = form
        self.latent = nn.Parameter(latent.detach(), requires_grad=False)
        self.decoder = decoder

    def forward(self, points: Tensor) -> Tensor:
        return self._form.values(self.decoder(*self._form.arguments(points, self.latent)))
