"""Refusals of arguments that are numbers, words or tensors: each names the argument, the limits and what came."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor


def require_whole(name: str, value: Any, least: int = 1, unit: str = "", most: int | None = None) -> None:
    """Refuse what is no whole number within the limits."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if isinstance(value, bool) or number < least or (most is not None and number > most):
        limits = f"at least {least}{unit and ' ' + unit}" + ("" if most is None else f", at most {most}")
        raise ValueError(f"{name} must be {limits}, a whole number, but is {value!r}.")


def require_positive(name: str, value: Any, what: str = "number", *, or_zero: bool = False) -> None:
    """Refuse what is no positive, finite number."""
    number = _number(value)
    if not (0 < number < math.inf or (or_zero and number == 0)):
        limits = f"a {what} of at least 0" if or_zero else f"a positive {what}"
        raise ValueError(f"{name} must be {limits}, but is {value!r}.")


def require_finite(name: str, value: Any, what: str = "number") -> None:
    """Refuse what is no finite number."""
    if not math.isfinite(_number(value)):
        raise ValueError(f"{name} must be a finite {what}, but is {value!r}.")


def require_between(name: str, value: Any, lowest: float, below: float) -> None:
    """Refuse what is no number of at least `lowest` and less than `below`."""
    if not lowest <= _number(value) < below:
        raise ValueError(f"{name} must be a number of at least {lowest:g} and below {below:g}, but is {value!r}.")


def require_choice(name: str, value: Any, options: Sequence[str]) -> None:
    """Refuse what is none of the options."""
    if not isinstance(value, str) or value not in options:
        raise ValueError(f"{name} must be one of {', '.join(options)}, but is {value!r}.")


def require_callable(name: str, value: Any, what: str) -> None:
    """Refuse what cannot be called."""
    if not callable(value):
        raise TypeError(f"{name} must be {what}, but is {value!r}.")


def require_numbers(name: str, value: Any, shape: str) -> Tensor:
    """Return the value as a tensor of finite numbers in float64, to be looked at; `shape` is for the message alone."""
    try:
        numbers = torch.as_tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name} must be {shape}, but is {value!r} ({error}).") from error
    if numbers.is_meta or not bool(torch.isfinite(numbers).all()):
        raise ValueError(f"{name} must be {shape}, all finite, but is {value!r}.")
    return numbers


def require_tensor(name: str, value: Any, shape: Sequence[int], device: torch.device) -> None:
    """Refuse what is no tensor of finite numbers of this shape on this device."""
    if not isinstance(value, Tensor) or not value.is_floating_point():
        came = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name} must be a floating tensor of shape {tuple(shape)}, but is {came}.")
    if value.shape != torch.Size(shape):
        raise ValueError(f"{name} must have shape {tuple(shape)}, but has {tuple(value.shape)}.")
    if value.device != device:
        raise ValueError(f"{name} must be on {device} like the field, but is on {value.device}. Use {name}.to(...).")
    if not bool(torch.isfinite(value).all()):
        raise ValueError(f"{name} must be finite, but holds NaN or infinite numbers. Mend or leave out what made them.")


def kind_of(tensor: Tensor) -> str:
    """Return the precision and the device of a tensor in a few letters, such as "float32, cpu"."""
    return f"{str(tensor.dtype).removeprefix('torch.')}, {tensor.device}"


def counted(number: int, thing: str) -> str:
    """Return a number with its noun, such as "1 point" or "2,273 points"."""
    return f"{number:,} {thing}" if number == 1 else f"{number:,} {thing}s"


def _number(value: Any) -> float:
    """Return the value as a number; NaN, which fits no limits, where it is none."""
    if isinstance(value, str | bool):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, RuntimeError):
        return math.nan
