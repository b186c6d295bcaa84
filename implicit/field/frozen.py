"""Frozen copies of modules and functions, which share nothing that can change with the originals.

`copy.deepcopy` fails on modules that hold tensors with a history (the older weight norm, spectral norm, pruning), and
makes others anew where they define it themselves. Here every tensor is detached and copied, every module is rebuilt
part by part around its copied tensors, and functions are rebuilt around what they close over; no code of the module's
own is run. What holds no tensor is shared.

A frozen copy is called with other tensors in the places of its parameters, and is after each call as it was before:
what its forward stores in it (a derived weight, a cache) is taken back.
"""

from __future__ import annotations

import copy
import functools
import operator
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from types import CellType, CodeType, FunctionType, MethodType, SimpleNamespace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

# What stands round a module to run it on several devices or compiled, and the name of the module within.
_WRAPPERS = {
    "OptimizedModule": "_orig_mod",
    "DataParallel": "module",
    "DistributedDataParallel": "module",
}
_INTERNAL = frozenset(nn.Module().__dict__)
_PLAIN = (type(None), bool, int, float, complex, str, bytes, torch.dtype, torch.device, torch.Size, torch.Generator)
# Packages whose objects hold nothing of a user's.
_FOREIGN = frozenset({*sys.stdlib_module_names, "torch", "numpy", "scipy"}) - {"__main__"}

_WRITABLE = (list, dict, OrderedDict)

# Where a tensor stands: a dictionary, a list, or what looks like one, and the key in it.
Place = tuple[Any, Any]


class Frozen:
    """A frozen copy of a module or function, and the places of its parameters in it.

    Args:
        source: A module, or any function.
        dtype: Precision of all floating tensors in the copy; None keeps each as it is.
        device: Device of all tensors in the copy; None keeps each where it is.
    """

    def __init__(
        self,
        source: Callable[..., Any],
        dtype: torch.dtype | None = None,
        device: torch.device | str | None = None,
    ) -> None:
        copying = _Copying(dtype, device)
        self.function: Callable[..., Any] = copying.of(source)
        self._copying = copying
        self._lock = threading.RLock()
        self._kept = [kept for part in copying.modules for kept in _kept(part)]

    def also(self, value: Any) -> Any:
        """Return the copy of something else that may hold parts of the source, such as a function round it."""
        known = len(self._copying.modules)
        made = self._copying.of(value)
        self._kept += [kept for part in self._copying.modules[known:] for kept in _kept(part)]
        return made

    def forget(self) -> None:
        """Let go of the source, once all that is wanted of it is known."""
        self._copying = _Copying(None, None)

    def copied(self, tensor: Tensor) -> Tensor | None:
        """Return the copy of a tensor of the source, None where there is none."""
        found = self._copying.memo.get(id(tensor))
        return None if found is None else found[1]

    def places(self, tensor: Tensor) -> list[Place]:
        """Return all places at which a tensor of the copy stands in it."""
        return self._copying.places.get(id(tensor), [])

    def __call__(self, edited: Iterable[tuple[list[Place], Tensor]], *arguments: Any) -> Any:
        """Return what the function gives with other tensors in some of its places."""
        before = []
        with self._lock:  # another thread's parameters must not stand there meanwhile
            try:
                for places, tensor in edited:
                    for where, key in places:
                        before.append((where, key, where[key]))
                        where[key] = tensor
                return self.function(*arguments)
            finally:
                for where, key, tensor in reversed(before):
                    where[key] = tensor
                _put_back(self._kept)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.RLock())


def unwrapped(module: nn.Module) -> nn.Module:
    """Return the module within what runs it compiled or on several devices, or the module itself."""
    while type(module).__name__ in _WRAPPERS and type(module).__module__.startswith("torch."):
        module = getattr(module, _WRAPPERS[type(module).__name__])
    return module


def is_compiled(module: nn.Module) -> bool:
    """Return whether calling a module would compile some of it, which takes seconds."""
    copying = _Copying(None, None)
    return any(
        type(part).__name__ == "OptimizedModule"
        or part.__dict__.get("_compiled_call_impl") is not None
        or bool(copying.compiled(type(part)))
        for part in module.modules()
    )


class guarded:
    """Run a live module in evaluation mode, and leave all that it holds as it was."""

    def __init__(self, module: nn.Module) -> None:
        parts = [part for part in module.modules() if not isinstance(part, torch.jit.ScriptModule)]
        self._kept = [kept for part in parts for kept in _kept(part)]
        self._parts = parts

    def __enter__(self) -> None:
        for part in self._parts:
            part.__dict__["training"] = False

    def __exit__(self, *_: object) -> None:
        _put_back(self._kept)


class _Kept(NamedTuple):
    """A dictionary or list that a forward may write to, and the values that were there, with a dictionary's keys."""

    holder: Any
    keys: list[Any] | None
    values: list[Any]

    @staticmethod
    def of(holder: dict[Any, Any] | list[Any]) -> _Kept:
        """Return what is there now."""
        if isinstance(holder, list):
            return _Kept(holder, None, list(holder))
        return _Kept(holder, list(holder), list(holder.values()))


def _put_back(kept: Iterable[_Kept]) -> None:
    """Put back what was there, where anything has changed; one loop, for it follows each evaluation."""
    for holder, keys, values in kept:
        entries = holder if keys is None else holder.values()
        if len(holder) == len(values) and all(map(operator.is_, entries, values)):
            continue
        holder.clear()
        if keys is None:
            holder.extend(values)
        else:
            holder.update(zip(keys, values, strict=True))


def _kept(part: nn.Module) -> Iterator[_Kept]:
    """Yield what a module's forward may write to: its attributes, its buffers, and its own lists and dictionaries."""
    if isinstance(part, torch.jit.ScriptModule):
        return
    yield _Kept.of(part.__dict__)
    yield _Kept.of(part._buffers)
    for name, value in part.__dict__.items():
        if name not in _INTERNAL and type(value) in (list, dict):
            yield _Kept.of(value)


class _Copying:
    """One copy in the making: what has been copied, so that what is shared stays shared."""

    def __init__(self, dtype: torch.dtype | None, device: torch.device | str | None) -> None:
        self._dtype, self._device = dtype, device
        # The original is kept beside its copy, so that no other object can get its id meanwhile.
        self.memo: dict[int, tuple[Any, Any]] = {}
        self.places: dict[int, list[Place]] = {}
        self.modules: list[nn.Module] = []
        self._tied: dict[Any, Tensor] = {}
        self._globals: dict[int, dict[str, Any]] = {}
        self._classes: dict[type, dict[str, FunctionType]] = {}

    def of(self, value: Any) -> Any:
        """Return the frozen copy of anything; itself where nothing in it need be copied."""
        if isinstance(value, _PLAIN):
            return value
        if id(value) in self.memo:
            return self.memo[id(value)][1]
        made = self._made(value)
        self.memo[id(value)] = (value, made)
        return made

    def _made(self, value: Any) -> Any:
        if isinstance(value, Tensor):
            return self._tensor(value)
        if isinstance(value, nn.Module):
            return self._module(value)
        if isinstance(value, list | dict):
            return self._container(value)
        if isinstance(value, tuple | set | frozenset):
            return self._collection(value)
        if isinstance(value, functools.partial):
            parts = (value.func, value.args, value.keywords)
            made = [self.of(part) for part in parts]
            changed = any(a is not b for a, b in zip(parts, made, strict=True))
            return functools.partial(made[0], *made[1], **made[2]) if changed else value
        if isinstance(value, MethodType):
            owner = self.of(value.__self__)
            return value if owner is value.__self__ else MethodType(value.__func__, owner)
        if isinstance(value, FunctionType):
            return self._function(value)
        return self._object(value)

    def _tensor(self, value: Tensor) -> Tensor:
        tie = _memory_of(value)
        if tie is not None and tie in self._tied:
            return self._tied[tie]
        dtype = self._dtype if value.is_floating_point() else None
        if value.is_complex() and self._dtype is not None:
            dtype = self._dtype.to_complex()
        try:
            with torch.no_grad():
                found = value.detach()
                moved = found.to(dtype=dtype, device=self._device)
                moved = found.clone() if moved is found or moved.data_ptr() == found.data_ptr() else moved
        except (RuntimeError, NotImplementedError):
            # A dead tensor of a transform that is over, which the module's own forward replaces before it is read.
            return value
        made = nn.Parameter(moved, requires_grad=False) if isinstance(value, nn.Parameter) else moved
        if tie is not None:
            self._tied[tie] = made
        return made

    def _module(self, value: nn.Module) -> nn.Module:
        inner = unwrapped(value)
        if inner is not value:
            made: nn.Module = self.of(inner)
            return made
        if isinstance(value, torch.jit.ScriptModule):
            return self._script(value)
        made = object.__new__(type(value))
        self.memo[id(value)] = (value, made)
        self.modules.append(made)
        for name, part in value.__dict__.items():
            if name in ("_backward_hooks", "_backward_pre_hooks", "_compiled_call_impl"):
                # Hooks on gradients watch or change a training; here gradients are those of the function.
                made.__dict__[name] = type(part)() if isinstance(part, dict) else None
            elif name in ("_parameters", "_buffers", "_modules"):
                made.__dict__[name] = {key: self.of(entry) for key, entry in part.items()}
                if name != "_modules":
                    self._note(made.__dict__[name])
            else:
                other = self.of(part)
                # A list or dictionary that forward may write to: the copy has its own in any case.
                made.__dict__[name] = part.copy() if other is part and type(part) in _WRITABLE else other
        made.__dict__["training"] = False
        for name, plain in self.compiled(type(value)).items():
            made.__dict__[name] = MethodType(plain, made)
        return made

    def compiled(self, kind: type) -> dict[str, FunctionType]:
        """Return the methods of a class that are compiled, as they were written."""
        if kind not in self._classes:
            self._classes[kind] = {
                name: plain
                for base in reversed(kind.__mro__)
                if not _is_foreign(base.__module__)
                for name, method in vars(base).items()
                if isinstance(plain := getattr(method, "_torchdynamo_orig_callable", None), FunctionType)
            }
        return self._classes[kind]

    def _script(self, value: torch.jit.ScriptModule) -> nn.Module:
        made = copy.deepcopy(value).eval()
        for old, new in zip(value.modules(), made.modules(), strict=True):
            attributes = _Attributes(new)
            for name, tensor in [*old.named_parameters(recurse=False), *old.named_buffers(recurse=False)]:
                setattr(new, name, self._tensor(tensor).detach())
            for name, parameter in old.named_parameters(recurse=False):
                frozen = getattr(new, name)
                self.memo[id(parameter)] = (parameter, frozen)
                self.places.setdefault(id(frozen), []).append((attributes, name))
        return made

    def _note(self, holder: MutableMapping[Any, Any] | list[Any]) -> None:
        """Remember where parameters stand in a dictionary or list of the copy."""
        entries = enumerate(holder) if isinstance(holder, list) else holder.items()
        for key, entry in entries:
            if isinstance(entry, nn.Parameter):
                self.places.setdefault(id(entry), []).append((holder, key))

    def _container(self, value: Any) -> Any:
        if not value:
            return value
        try:
            made = value.copy() if type(value) in _WRITABLE else copy.copy(value)
        except Exception:  # a class of the user's own whose copying fails: it is shared
            return value
        self.memo[id(value)] = (value, made)
        changed = False
        for key, entry in list(enumerate(value) if isinstance(value, list) else value.items()):
            other = self.of(entry)
            if other is not entry:
                made[key] = other
                changed = True
        if changed:
            self._note(made)
        return made if changed else value

    def _collection(self, value: Any) -> Any:
        entries = list(value)
        made = [self.of(entry) for entry in entries]
        if all(map(operator.is_, entries, made)):
            return value
        return type(value)(*made) if hasattr(value, "_fields") else type(value)(made)

    def _function(self, value: FunctionType) -> Any:
        plain = getattr(value, "_torchdynamo_orig_callable", None)
        if plain is not None:
            return self.of(plain)
        if _is_foreign(value.__module__):
            return value
        old = value.__closure__ or ()
        cells = tuple(self._cell(cell) for cell in old)
        names = _names(value.__code__)
        known = self._globals.setdefault(id(value.__globals__), dict(value.__globals__))
        made = FunctionType(value.__code__, known, value.__name__, value.__defaults__, cells or None)
        self.memo[id(value)] = (value, made)
        made.__dict__.update(value.__dict__)
        made.__kwdefaults__ = self.of(value.__kwdefaults__)
        made.__defaults__ = self.of(value.__defaults__)
        changed = made.__defaults__ is not value.__defaults__ or made.__kwdefaults__ is not value.__kwdefaults__
        for cell, other in zip(old, cells, strict=True):
            changed = self._fill(cell, other) or changed
        for name in names & value.__globals__.keys():
            entry = value.__globals__[name]
            if isinstance(entry, FunctionType) and entry.__globals__ is not value.__globals__:
                continue
            other = self.of(entry)
            if other is not entry:
                known[name] = other
                changed = True
                if isinstance(other, nn.Parameter):
                    self.places.setdefault(id(other), []).append((known, name))
        return made if changed else value

    def _cell(self, cell: CellType) -> CellType:
        if id(cell) not in self.memo:
            self.memo[id(cell)] = (cell, CellType())
        made: CellType = self.memo[id(cell)][1]
        return made

    def _fill(self, cell: CellType, other: CellType) -> bool:
        """Copy what a function closes over, and return whether it differs."""
        try:
            entry = cell.cell_contents
        except ValueError:  # not yet filled
            return False
        made = self.of(entry)
        other.cell_contents = made
        if isinstance(made, nn.Parameter):
            self.places.setdefault(id(made), []).append((_Contents(other), None))
        return made is not entry

    def _object(self, value: Any) -> Any:
        kind = type(value)
        if isinstance(value, type) or not hasattr(value, "__dict__"):
            return value
        if _is_foreign(kind.__module__) and kind is not SimpleNamespace:
            return value
        try:
            made = SimpleNamespace() if kind is SimpleNamespace else object.__new__(kind)
            made.__dict__.update(value.__dict__)
        except (TypeError, AttributeError):
            return value
        self.memo[id(value)] = (value, made)
        changed = False
        for name, entry in value.__dict__.items():
            other = self.of(entry)
            if other is not entry:
                made.__dict__[name] = other
                changed = True
        if changed:
            self._note(made.__dict__)
        return made if changed else value


class _Attributes:
    """The parameters of a scripted module, set by its attributes."""

    def __init__(self, module: nn.Module) -> None:
        self._module = module

    def __getitem__(self, name: str) -> Any:
        return getattr(self._module, name)

    def __setitem__(self, name: str, value: Any) -> None:
        setattr(self._module, name, value)


class _Contents:
    """The contents that a function closes over, as a place."""

    def __init__(self, cell: CellType) -> None:
        self._cell = cell

    def __getitem__(self, _: None) -> Any:
        return self._cell.cell_contents

    def __setitem__(self, _: None, value: Any) -> None:
        self._cell.cell_contents = value


def _memory_of(value: Tensor) -> Any:
    """Return what two parameters that are one and the same memory have in common; None for anything else."""
    if not isinstance(value, nn.Parameter) or value.layout != torch.strided or value.numel() == 0:
        return None
    try:
        return value.data_ptr(), value.shape, value.stride(), value.dtype, value.device
    except RuntimeError:
        return None


def _names(code: CodeType) -> set[str]:
    """Return the names that a function may read from its module, with those of the functions within it."""
    inner = [_names(part) for part in code.co_consts if isinstance(part, CodeType)]
    return set(code.co_names).union(*inner)


def _is_foreign(package: str | None) -> bool:
    return package is None or package.split(".")[0] in _FOREIGN
