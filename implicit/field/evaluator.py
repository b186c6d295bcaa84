"""f(x; theta) as a function of both arguments, which a field evaluates and differentiates, and where theta is from."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Protocol, Self

import torch
from torch import Tensor, nn

from implicit.field.forms import Form
from implicit.field.frozen import Frozen

# Numbers of a module up to which it is kept in each precision that is asked for.
KEPT = 4_000_000


@dataclass(frozen=True, eq=False)
class Parameter:
    """One edited tensor of a module: its name, its shape and its place in theta."""

    name: str
    shape: torch.Size
    where: slice


class Evaluator(Protocol):
    """The raw values of a function, before level and sign; usable under torch.func transforms."""

    @property
    def module(self) -> nn.Module | None:
        """The module that is evaluated, frozen; None for a function that is no module."""

    @property
    def takes_code(self) -> bool:
        """True where theta is the latent code of a decoder."""

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        """Return values (N,) or (N, 1) at points (N, D)."""

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> Evaluator:
        """Return the same function in another precision or on another device."""


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """A function with the parameters that it starts from, and the memory that they came from.

    Attributes:
        evaluator: The raw values of the function.
        theta: All edited parameters, one after the other, (P,).
        layout: The blocks of theta, in its order.
        store: Writes a theta to where the parameters came from, in place.
        live: The caller's own module, None for a function that is none.
        notes: What a reader should know of how the function was taken in, a sentence each.
    """

    evaluator: OfModule | OfDecoder
    theta: Tensor
    layout: tuple[Parameter, ...]
    store: Callable[[Tensor], None]
    live: nn.Module | None = None
    notes: tuple[str, ...] = ()


def parametrised(module: nn.Module, patterns: Iterable[str] | None = None, form: Form | None = None) -> Parametrisation:
    """Return a module's function of those of its parameters that fit the patterns, or of all.

    Args:
        module: From points (N, D) to values (N,) or (N, 1), or as the form says. A frozen copy of it is evaluated.
        patterns: Names or shell-style patterns of the parameters; None takes all.
        form: How the module takes points and where its values are.

    Raises:
        TypeError: It is no module, or the patterns are no names.
        ValueError: No parameter fits, or they differ in dtype or device.
    """
    if not isinstance(module, nn.Module):
        raise TypeError(
            f"module must be a torch module, but is a {type(module).__name__}. Wrap a function in one, or give "
            "decoder_field a function of points and a code."
        )
    blocks = _selected(module, patterns)
    first = next(iter(blocks.values()))
    dtype, notes = _working_precision(first.dtype)
    frozen = Frozen(module, dtype, first.device)
    copies = {name: frozen.copied(block) for name, block in blocks.items()}
    assert isinstance(frozen.function, nn.Module)
    names = {id(parameter): name for name, parameter in frozen.function.named_parameters()}
    lost = [name for name, found in copies.items() if id(found) not in names]
    if lost:
        raise ValueError(
            f"The parameters {', '.join(lost)} must be tensors of the module itself, but are made anew each time they "
            "are asked for. Register them as nn.Parameter."
        )
    # Two parameters that share their memory are one; the second would be a copy that is written over.
    kept = {names[id(copies[name])]: block for name, block in reversed(blocks.items())}
    ordered = {name: kept[name] for name in dict.fromkeys(names[id(copies[name])] for name in blocks)}
    layout = _layout({name: block.shape for name, block in ordered.items()})

    def store(theta: Tensor) -> None:
        present = {id(parameter) for parameter in module.parameters()}
        gone = [name for name, block in ordered.items() if id(block) not in present]
        if gone:
            raise ValueError(
                f"write_back must find the parameters that the field was made from, but {', '.join(gone)} are no "
                "longer in the module: its layers were replaced since. Load field.module.state_dict() instead."
            )
        with torch.no_grad():
            for block in layout:
                ordered[block.name].copy_(theta[block.where].view(block.shape))

    theta = torch.cat([block.detach().reshape(-1) for block in ordered.values()]).to(dtype)
    notes += _of_training(module)
    return Parametrisation(OfModule(frozen, layout, _frozen_form(form, frozen)), theta, layout, store, module, notes)


def parametrised_by_code(
    decoder: Callable[[Tensor, Tensor], Tensor], latent: Tensor, form: Form | None = None
) -> Parametrisation:
    """Return a decoder's function of its latent code, (L,).

    Args:
        decoder: From points (N, D) and a code (L,) to values (N,) or (N, 1), or as the form says. A frozen copy of it
            is evaluated; of a function, round frozen copies of the modules and tensors that it reaches.
        latent: The code to start from; edited ones are stored in it.
        form: How the decoder takes points and where its values are.
    """

    def store(theta: Tensor) -> None:
        with torch.no_grad():
            latent.copy_(theta)

    dtype, notes = _working_precision(latent.dtype)
    frozen = Frozen(decoder, dtype, latent.device)
    is_module = isinstance(decoder, nn.Module)
    notes += _of_training(decoder) if isinstance(decoder, nn.Module) else ()
    layout = _layout({"latent": latent.shape})
    evaluator = OfDecoder(frozen, _frozen_form(form, frozen), is_module=is_module)
    return Parametrisation(evaluator, latent.detach().to(dtype), layout, store, None, notes)


class _InForm:
    """A function of theta and points that keeps the form in which they go in and values come out.

    A module of up to KEPT numbers keeps itself in other precisions and on other devices too, so that what is found of
    these, such as their closed form, is found once.
    """

    module: nn.Module | None
    _form: Form

    def in_form(self, form: Form) -> Self:
        """Return the same function with points given and values taken in another way."""
        other = copy.copy(self)
        other._form = form
        other.__dict__.pop("_others", None)
        return other

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> Self:
        """Return the same function in another precision or on another device."""
        size = KEPT + 1 if self.module is None else sum(part.numel() for part in self.module.parameters())
        if size > KEPT:
            return self._converted(dtype, device)
        others: dict[tuple[torch.dtype | None, str | None], Self] = self.__dict__.setdefault("_others", {})
        key = (dtype, None if device is None else str(device))
        if key not in others:
            others[key] = self._converted(dtype, device)
        return others[key]

    def _converted(self, dtype: torch.dtype | None, device: torch.device | str | None) -> Self:
        """Return the same function in another precision or on another device, made anew."""
        raise TypeError(f"A {type(self).__name__} has no other precision.")

    @property
    def form(self) -> Form:
        """The form in which points go in and values come out."""
        return self._form


class OfModule(_InForm):
    """A module, of which theta holds some parameters or all."""

    takes_code = False

    def __init__(self, frozen: Frozen, layout: tuple[Parameter, ...], form: Form) -> None:
        assert isinstance(frozen.function, nn.Module)
        self.module: nn.Module = frozen.function
        self._frozen, self._layout, self._form = frozen, layout, form
        named = dict(self.module.named_parameters())
        self._places = [frozen.places(named[block.name]) for block in layout]
        self._sizes = [block.shape.numel() for block in layout]
        frozen.forget()

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        return _in_precision(self._form.values(self.raw(theta, points)), points)

    def raw(self, theta: Tensor, points: Tensor) -> Any:
        """Return all that the module gives."""
        parts = theta.split(self._sizes)
        edited = [part.view(block.shape) for part, block in zip(parts, self._layout, strict=True)]
        return self._frozen(zip(self._places, edited, strict=True), *self._form.arguments(points))

    def with_values(self, values: Mapping[str, Tensor], *arguments: Any) -> Any:
        """Return what the module gives to arguments of its own, with values of edited parameters by their names."""
        named = zip(self._layout, self._places, strict=True)
        return self._frozen(((places, values[block.name]) for block, places in named), *arguments)

    def written(self, theta: Tensor) -> nn.Module:
        """Return a copy of the module with theta written into its parameters."""
        module = Frozen(self.module).function
        assert isinstance(module, nn.Module)
        named = dict(module.named_parameters())
        with torch.no_grad():
            for block in self._layout:
                named[block.name].copy_(theta[block.where].view(block.shape))
        return module

    def _converted(self, dtype: torch.dtype | None, device: torch.device | str | None) -> OfModule:
        frozen = Frozen(self.module, dtype, device)
        return OfModule(frozen, self._layout, _frozen_form(self._form, frozen))


class OfDecoder(_InForm):
    """A decoder, of which theta is the latent code; a module, or any function of points and a code."""

    takes_code = True

    def __init__(self, frozen: Frozen, form: Form, *, is_module: bool) -> None:
        self.module: nn.Module | None = frozen.function if is_module else None  # type: ignore[assignment]
        self._frozen, self._form = frozen, form
        frozen.forget()

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        return _in_precision(self._form.values(self.raw(theta, points)), points)

    def raw(self, theta: Tensor, points: Tensor) -> Any:
        """Return all that the decoder gives."""
        return self._frozen((), *self._form.arguments(points, theta))

    def written(self, theta: Tensor) -> nn.Module | None:
        """Return the decoder, which holds nothing of the code."""
        return self.module

    def _converted(self, dtype: torch.dtype | None, device: torch.device | str | None) -> OfDecoder:
        frozen = Frozen(self._frozen.function, dtype, device)
        return OfDecoder(frozen, _frozen_form(self._form, frozen), is_module=self.module is not None)


def _frozen_form(form: Form | None, frozen: Frozen) -> Form:
    """Return the form with its functions frozen like the module or decoder."""
    return Form() if form is None else Form(frozen.also(form.inputs), frozen.also(form.output))


def _in_precision(values: Any, points: Tensor) -> Any:
    """Return values in the precision of the points, where they are real numbers at all."""
    if isinstance(values, Tensor) and values.is_floating_point() and values.dtype != points.dtype:
        return values.to(points.dtype)
    return values


def _working_precision(dtype: torch.dtype) -> tuple[torch.dtype, tuple[str, ...]]:
    """Return the precision to work in, and a note where it is not that of the parameters."""
    if dtype.itemsize >= 4:
        return dtype, ()
    name = str(dtype).removeprefix("torch.")
    return torch.float32, (
        f"The parameters are {name}, too coarse to place a surface: the field works on float32 copies, and write_back "
        f"rounds them to {name}.",
    )


def _of_training(module: nn.Module) -> tuple[str, ...]:
    """Return a note where a module in training mode is taken in evaluation mode and that matters."""
    kinds = (nn.modules.dropout._DropoutNd, nn.modules.batchnorm._NormBase)
    found = sorted({type(part).__name__ for part in module.modules() if part.training and isinstance(part, kinds)})
    if not found:
        return ()
    return (
        f"The module is in training mode and has {', '.join(found)}: the field takes it in evaluation mode, with "
        "dropout off and running statistics fixed.",
    )


def _selected(module: nn.Module, patterns: Iterable[str] | None) -> dict[str, nn.Parameter]:
    """Return the parameters to edit, by name, all of one floating dtype on one device."""
    named = dict(module.named_parameters())
    _require_made(module)
    if patterns is not None:
        if not isinstance(patterns, Iterable):
            raise TypeError(f"parameters must be names or patterns of names, but are {patterns!r}.")
        patterns = [patterns] if isinstance(patterns, str) else [str(pattern) for pattern in patterns]
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in named):
                raise ValueError(
                    f"parameters must be names or patterns of the module's own, but {pattern!r} matches none of "
                    f"{', '.join(named) or 'none'}."
                )
        named = {name: p for name, p in named.items() if any(fnmatchcase(name, pattern) for pattern in patterns)}
    if not named:
        raise ValueError("The module must have parameters to edit, but has none. For a latent code use decoder_field.")
    kinds = {(p.dtype, p.device) for p in named.values()}
    if len(kinds) > 1 or not next(iter(kinds))[0].is_floating_point:
        raise ValueError(
            f"The parameters must share one floating dtype and device, but have {sorted(map(str, kinds))}."
        )
    return named


def _require_made(module: nn.Module) -> None:
    """Refuse a module whose tensors hold no numbers yet."""
    for name, tensor in [*module.named_parameters(), *module.named_buffers()]:
        if nn.parameter.is_lazy(tensor):
            raise ValueError(f"The module must be made, but {name} is lazy. Call it once with points, then give it.")
        if tensor.is_meta:
            raise ValueError(
                f"The parameters must hold numbers, but {name} is on the meta device. Load the module to the CPU or a "
                "GPU."
            )
        if tensor.layout != torch.strided:
            raise ValueError(f"The parameters must be dense, but {name} is {tensor.layout}. Use {name}.to_dense().")


def _layout(shapes: dict[str, torch.Size]) -> tuple[Parameter, ...]:
    blocks, start = [], 0
    for name, shape in shapes.items():
        blocks.append(Parameter(name, shape, slice(start, start + shape.numel())))
        start += shape.numel()
    return tuple(blocks)
