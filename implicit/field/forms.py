"""The form of a module's calls: how points go in, and where its values are in what comes out.

A field's function takes points (N, D) and gives N values. Modules take them in a batch, as columns or in a dictionary,
and give tuples, dictionaries or many values a point; `inputs` and `output` say so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from torch import Tensor

Inputs = Literal["batched", "columns", "batched columns"] | Callable[..., Any]
Output = int | str | Sequence[int | str] | Callable[[Any], Tensor]

SHAPES = {"batched": "(1, N, D)", "columns": "(D, N)", "batched columns": "(1, D, N)"}


@dataclass(frozen=True)
class Form:
    """The shape in which a module takes points and the place of its values.

    Attributes:
        inputs: None gives points (N, D); "batched" (1, N, D); "columns" (D, N); "batched columns" (1, D, N); a function
            from points (and a code) to the argument, or to the tuple of arguments, gives what it returns.
        output: None takes all that comes; a number the channel of that number of a tensor, or the entry of a tuple; a
            name the entry of a dictionary or the attribute; several of these one after the other; a function from what
            comes to N values.
    """

    inputs: Inputs | None = None
    output: Output | None = None

    def __post_init__(self) -> None:
        if self.inputs is not None and not callable(self.inputs) and self.inputs not in SHAPES:
            raise ValueError(
                f"inputs must be None, one of {', '.join(SHAPES)}, or a function from points (N, D) to what the module "
                f'takes, but is {self.inputs!r}. For a dictionary: inputs=lambda points: {{"coords": points}}.'
            )
        steps = self._steps()
        if not callable(self.output) and not all(
            isinstance(step, int | str) and not isinstance(step, bool) for step in steps
        ):
            raise TypeError(
                "output must be None, a number, a name, several of these, or a function from what the module gives "
                f"to N values, but is {self.output!r}."
            )

    def arguments(self, points: Tensor, *code: Tensor) -> tuple[Any, ...]:
        """Return the arguments of the module for points (N, D), and for a code where there is one."""
        if self.inputs is None:
            return (points, *code)
        if callable(self.inputs):
            made = self.inputs(points, *code)
            return made if isinstance(made, tuple) else (made,)
        shaped = points.transpose(-1, -2) if "columns" in self.inputs else points
        return (shaped.unsqueeze(0) if "batched" in self.inputs else shaped, *code)

    def values(self, result: Any) -> Any:
        """Return what stands at the place of the values in what the module gave."""
        if self.output is None:
            return result
        if callable(self.output):
            return self.output(result)
        for step in self._steps():
            if isinstance(result, Tensor):
                result = result.select(self._channels, step)
            elif isinstance(step, str) and not isinstance(result, Mapping):
                result = getattr(result, step)
            else:
                result = result[step]
        return result

    @property
    def _channels(self) -> int:
        """The axis of a tensor that comes along which the channels of a point are."""
        return -2 if isinstance(self.inputs, str) and "columns" in self.inputs else -1

    def _steps(self) -> Sequence[Any]:
        if self.output is None or callable(self.output):
            return ()
        several = isinstance(self.output, Sequence) and not isinstance(self.output, str)
        return tuple(self.output) if several else (self.output,)  # type: ignore[arg-type]

    # What may be meant where it does not fit

    def places(self, result: Any, n: int) -> list[str]:
        """Return the `output=` at which n values stand in what a module gave, the first few."""
        paths = []
        for path in self._paths(result, n, 3):
            paths.append(f"output={path[0]!r}" if len(path) == 1 else f"output={path!r}")
        return paths[:4]

    def _paths(self, result: Any, n: int, depth: int) -> Iterator[tuple[int | str, ...]]:
        """Yield the steps to n values in what a module gave: entries that are n values, then channels of others."""
        if isinstance(result, Tensor):
            count = result.shape[self._channels] if result.ndim >= 2 else 0
            if count > 1 and result.numel() == n * count:
                yield from ((k,) for k in range(min(count, 3)))
            return
        entries = list(_entries(result)) if depth else []
        yield from ((key,) for key, entry in entries if isinstance(entry, Tensor) and entry.numel() == n)
        for key, entry in entries:
            yield from ((key, *path) for path in self._paths(entry, n, depth - 1))


def _entries(result: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the names or numbers of what is in a result, with it."""
    if isinstance(result, Mapping):
        yield from result.items()
    elif hasattr(result, "_fields"):
        yield from ((name, getattr(result, name)) for name in result._fields)
    elif isinstance(result, list | tuple):
        yield from enumerate(result)
    elif hasattr(result, "__dict__"):
        yield from vars(result).items()


def described(result: Any) -> str:
    """Return what a module gave in a few words: its kind, and the shapes in it."""
    if isinstance(result, Tensor):
        return f"{tuple(result.shape)}, {result.dtype}"
    if isinstance(result, Mapping):
        return f"a {type(result).__name__} of " + ", ".join(f"{k!r}: {_short(v)}" for k, v in result.items())
    if isinstance(result, list | tuple):
        return f"a {type(result).__name__} of " + ", ".join(map(_short, result))
    return f"a {type(result).__name__}"


def _short(entry: Any) -> str:
    return str(tuple(entry.shape)) if isinstance(entry, Tensor) else type(entry).__name__
