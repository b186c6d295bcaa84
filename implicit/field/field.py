"""A neural field: a function f(x; theta), the parameters that may be edited, and where its surface is.

Conventions, here as everywhere: after `level` and `inside` are applied, f < 0 inside and f > 0 outside;
normals point out; kappa = div n is the sum of the principal curvatures (+2/r on a sphere, +1/r on a circle).
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, overload

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import kind_of, require_choice, require_finite, require_numbers, require_positive
from implicit.field.evaluator import Parameter, Parametrisation, parametrised
from implicit.field.examination import examine
from implicit.field.forms import Form, Inputs, Output
from implicit.field.smoothness import second_derivatives_missing
from implicit.field.torch_errors import in_our_words

Bounds = tuple[Sequence[float], Sequence[float]]
CUBE: Bounds = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))

# Points evaluated at once: large enough to fill the vector units, small enough that the activations of a small network
# stay in the cache of a processor, and those of one 1024 wide within a few hundred megabytes.
CHUNK = 32768
CHUNK_IN_CACHE = 8192


@dataclass(frozen=True)
class Units:
    """Change from the field's own coordinates x to the user's: scale * x + offset.

    Attributes:
        scale: User's lengths in a length of the field, positive.
        offset: Place of the field's origin in the user's coordinates, (D,).
    """

    scale: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_positive("scale of Units", self.scale)
        if require_numbers("offset of Units", self.offset, "a number for each coordinate").ndim != 1:
            raise ValueError(f"offset of Units must be a number for each coordinate, but is {self.offset!r}.")

    def to_user(self, points: Tensor) -> Tensor:
        """Return points (..., D) of the field in the user's units."""
        return points * self.scale + torch.as_tensor(self.offset, dtype=points.dtype, device=points.device)

    def to_field(self, points: Tensor) -> Tensor:
        """Return points (..., D) of the user in the field's units."""
        return (points - torch.as_tensor(self.offset, dtype=points.dtype, device=points.device)) / self.scale


class SurfaceError(ValueError):
    """The field has no usable surface inside its bounds."""


class Field:
    """A function f(x; theta) whose zero set is a surface (3D) or a curve (2D), and the parameters to edit.

    The field keeps a frozen copy of the module in evaluation mode (dropout off, batch norm fixed), so editing never
    disturbs the caller's module until `write_back` stores the edited parameters in it. What runs it compiled or on
    several devices is taken off. Buffers and other tensors follow the precision of the parameters; modules in float16
    or bfloat16 are worked on in float32.

    Args:
        module: Any differentiable module from points (N, D) to values (N,) or (N, 1), each point by itself. Of a
            decoder with a code make a field by decoder_field, which gives a Parametrisation here.
        output: The place of the values where the module gives more: the number of a channel or of an entry of a tuple,
            the name of an entry of a dictionary or of an attribute, several of these one after the other, or a
            function from what the module gives to N values. None takes all.
        inputs: The shape in which the module takes points: "batched" (1, N, D), "columns" (D, N), "batched columns"
            (1, D, N), or a function from points (N, D) to its argument, or to the tuple of its arguments. None gives
            points (N, D).
        parameters: Names or shell-style patterns of the parameters to edit; None edits all of them.
        level: The value of the module on the surface, e.g. 0.5 for an occupancy.
        inside: "negative" where the module is below the level inside, "positive" where it is above it.
        bounds: Lower and upper corner of a box that holds the surface; its length gives the dimension D.
        units: How the field's coordinates relate to the user's.
        check: False leaves out the comparison of derivatives with differences, and of the values at points alone with
            those in company, at a few points.

    Attributes:
        notes: What a reader should know of how the module was taken in, a sentence each: its precision, its training
            mode, parameters that do not move the surface.
        findings: What was found of the function itself when it was asked, such as whether torch can vectorise it;
            shared by the same field at other parameters.

    Raises:
        ValueError: The module has no such parameters, or they differ in dtype or device or are not finite.
        TypeError: The module does not map (N, D) points to N values, each of its own point and the same each time, or
            its derivatives are not those of its values.
    """

    def __init__(
        self,
        module: nn.Module | Parametrisation,
        *,
        output: Output | None = None,
        inputs: Inputs | None = None,
        parameters: Iterable[str] | None = None,
        level: float = 0.0,
        inside: Literal["negative", "positive"] = "negative",
        bounds: Bounds = CUBE,
        units: Units | None = None,
        check: bool = True,
    ) -> None:
        if torch.is_inference_mode_enabled():
            raise TypeError("A field needs gradients, but torch.inference_mode is on. Leave it, or use torch.no_grad.")
        if isinstance(module, Parametrisation):
            source = module
        else:
            source = parametrised(module, parameters, Form(inputs, output))
        theta = source.theta
        require_choice("inside", inside, ("negative", "positive"))
        require_finite("level", level)
        if not torch.isfinite(theta).all():
            raise ValueError(
                "The parameters must be finite, but hold NaN or infinite numbers. Load or train the module again."
            )
        box = require_numbers("bounds", bounds, "a lower and an upper corner").to(theta)
        if box.ndim != 2 or box.shape[0] != 2 or box.shape[1] not in (2, 3) or not bool((box[0] < box[1]).all()):
            raise ValueError(
                "bounds must be a lower and an upper corner in 2 or 3 dimensions, the lower one smaller in each "
                f"coordinate, but is {bounds}."
            )
        if units is not None and (not isinstance(units, Units) or len(units.offset) != box.shape[1]):
            raise ValueError(
                f"units must be Units with an offset of {box.shape[1]} numbers, as the bounds, but are {units!r}."
            )
        self.theta: Float[Tensor, " p"] = theta.clone()
        self.level = float(level)
        self.inside = inside
        self.bounds: Float[Tensor, "2 d"] = box
        self.layout: tuple[Parameter, ...] = source.layout
        self.units = units if units is not None else Units(1.0, (0.0,) * self.dimension)
        self.sign: float = 1.0 if inside == "negative" else -1.0
        self._evaluator = source.evaluator
        self._store = source.store
        self.notes: tuple[str, ...] = source.notes
        self._written: nn.Module | None = None
        self.findings: dict[str, Any] = {}
        near, notes = examine(self, source.live, derivatives=check)
        self.findings["near"] = near
        if parameters is not None:
            self.notes += notes

    def __repr__(self) -> str:
        named = ("inside", "bounds", "units")
        return "Field: " + "; ".join(f"{name} {text}" if name in named else text for name, text in self._facts())

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in self._facts())
        return f"<table><caption>Field</caption>{rows}</table>"

    def _facts(self) -> list[tuple[str, str]]:
        """Return what a reader asks first of a field: a name and a text for each row of the table."""
        function = "a function" if self.module is None else type(self.module).__name__
        scale, offset = self.units.scale, [round(x, 6) for x in self.units.offset]
        corners = " to ".join(str([round(x, 6) for x in corner]) for corner in self.bounds.tolist())
        facts = [
            ("function", f"{function} of {self.dimension} coordinates"),
            ("theta", f"P = {len(self.theta):,} {'(a code)' if self.takes_code else ''}".rstrip()),
            ("numbers", kind_of(self.theta)),
            ("inside", f"{'below' if self.inside == 'negative' else 'above'} level {self.level:g}"),
            ("bounds", corners),
        ]
        if scale != 1 or any(offset):
            facts.append(("units", f"{scale:.6g} x + {offset}"))
        facts += [("note", note) for note in self.notes]
        return facts

    # What it is

    @property
    def module(self) -> nn.Module | None:
        """A copy of the module with the field's parameters in it, frozen; None for a function that is no module.

        Its state_dict is that of the edited module, by the names within what ran it compiled or on several devices.
        """
        if self._written is None:
            self._written = self._evaluator.written(self.theta)
        return self._written

    @property
    def takes_code(self) -> bool:
        """True where theta is the latent code of a decoder, False where it holds parameters of a module."""
        return self._evaluator.takes_code

    @property
    def dimension(self) -> int:
        """Number of coordinates D, 2 or 3."""
        return self.bounds.shape[1]

    @property
    def dtype(self) -> torch.dtype:
        """The precision of theta, and of everything computed from it."""
        return self.theta.dtype

    @property
    def device(self) -> torch.device:
        """Device of theta, and of everything computed from it."""
        return self.theta.device

    @property
    def size(self) -> float:
        """Length of the longest side of the bounds, the unit for step lengths and tolerances."""
        return float((self.bounds[1] - self.bounds[0]).max())

    # The function

    def function(self, theta: Float[Tensor, " p"], points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return f(points; theta), differentiable in both arguments and usable under torch.func transforms."""
        with in_our_words(f"be evaluated at points of shape {tuple(points.shape)}"):
            return (self._evaluator(theta, points).reshape(points.shape[0]) - self.level) * self.sign

    def value(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return f at the points, in chunks and without a graph; negative inside."""
        points = self.require_points(points)
        with torch.no_grad():
            return _joined([self.function(self.theta, part) for part in _chunks(points)])

    def gradient(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return df/dx at the points."""
        return self.value_and_gradient(points)[1]

    def value_and_gradient(
        self, points: Float[Tensor, "n d"], *, validate: bool = True
    ) -> tuple[Float[Tensor, " n"], Float[Tensor, "n d"]]:
        """Return f and df/dx at the points, in one pass.

        Args:
            points: Points (N, D).
            validate: False leaves out the check of the points, for a loop that has checked them before it began.
        """
        if validate:
            points = self.require_points(points)
        values, gradients = [], []
        with torch.enable_grad():
            for part in _chunks(points):
                x = part.detach().requires_grad_()
                f = self.function(self.theta, x)
                with in_our_words("be differentiated by the points"):
                    (g,) = torch.autograd.grad(f.sum(), x)
                values.append(f.detach())
                gradients.append(g)
        return _joined(values), _joined(gradients)

    def hessian(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d d"]:
        """Return d2f/dx2 at the points, symmetric.

        Raises:
            ValueError: The module's second derivatives are missing or wrong.
        """
        return self.gradient_and_hessian(points)[1]

    def gradient_and_hessian(self, points: Float[Tensor, "n d"]) -> tuple[Float[Tensor, "n d"], Float[Tensor, "n d d"]]:
        """Return df/dx and d2f/dx2 at the points, in one pass.

        Raises:
            ValueError: The module's second derivatives are missing or wrong.
        """
        points = self.require_points(points)
        if missing := self._second_derivatives_missing(points):
            raise ValueError(
                f"The field has no second derivatives, and so no curvature of this kind ({missing}). Use operations of "
                "plain torch in the module, or what needs first derivatives alone, such as geometric_edit."
            )
        return self.raw_gradient_and_hessian(points)

    def raw_gradient_and_hessian(
        self, points: Float[Tensor, "n d"]
    ) -> tuple[Float[Tensor, "n d"], Float[Tensor, "n d d"]]:
        """Return df/dx and d2f/dx2 as the module gives them, with zeros where it gives none."""
        gradients, hessians = [], []
        with torch.enable_grad(), in_our_words("be differentiated twice by the points"):
            for part in _chunks(points):
                x = part.detach().requires_grad_()
                (g,) = torch.autograd.grad(self.function(self.theta, x).sum(), x, create_graph=True)
                columns = [
                    torch.autograd.grad(g[:, k].sum(), x, retain_graph=True, allow_unused=True)[0]
                    if g.requires_grad
                    else None
                    for k in range(self.dimension)
                ]
                h = torch.stack([torch.zeros_like(x) if c is None else c for c in columns], dim=-1)
                gradients.append(g.detach())
                hessians.append((h + h.transpose(1, 2)) / 2)
        return torch.cat(gradients), torch.cat(hessians)

    @property
    def twice_differentiable(self) -> bool:
        """True where second derivatives are those of the gradient, measured once, near the surface.

        A piecewise linear field's are: zero. For whether its gradient jumps see `gradient_jumps`.
        """
        return not self._second_derivatives_missing(self.findings["near"])

    def _second_derivatives_missing(self, points: Tensor) -> str:
        if "missing" not in self.findings and len(points):
            self.findings["missing"] = second_derivatives_missing(self, points)
        return str(self.findings.get("missing", ""))

    def normal(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return the outward unit normals df/dx / |df/dx|.

        Raises:
            ValueError: The gradient vanishes at a point.
        """
        gradients = self.gradient(points)
        return gradients / self.gradient_length(gradients)[:, None]

    def mean_curvature(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return kappa = div n, the sum of the principal curvatures of the level set through each point."""
        gradients, hessians = self.gradient_and_hessian(points)
        length = self.gradient_length(gradients)
        n = gradients / length[:, None]
        return (hessians.diagonal(dim1=1, dim2=2).sum(1) - torch.einsum("ni,nij,nj->n", n, hessians, n)) / length

    def gradient_length(self, gradients: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return |df/dx|, refused where it vanishes: there the surface has no normal and its motion no meaning."""
        length = gradients.norm(dim=1)
        bad = ~(length > 1e-7 * length.median())
        if bool(bad.any()):
            i = int(bad.nonzero()[0])
            raise ValueError(
                f"The gradient of the field vanishes or is not finite: |df/dx| = {float(length[i]):.3g} at "
                f"points[{i}], median {float(length.median()):.3g}. Leave that point out, or refit the field there."
            )
        return length

    # Other parameters

    def with_theta(self, theta: Float[Tensor, " p"]) -> Field:
        """Return the same field at other parameters; the two share the module, not the parameters."""
        if not isinstance(theta, Tensor) or theta.shape != self.theta.shape or theta.is_meta:
            came = f"{tuple(theta.shape)} on {theta.device}" if isinstance(theta, Tensor) else type(theta).__name__
            raise ValueError(f"theta must be a tensor of shape {tuple(self.theta.shape)}, but is {came}.")
        other = copy.copy(self)
        other.theta = theta.detach().to(self.theta).clone()
        other._written = None
        return other

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> Field:
        """Return the same field in another precision or on another device; `write_back` still reaches the original."""
        if dtype is not None and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
            raise TypeError(f"dtype must be a floating one such as torch.float64, but is {dtype!r}.")
        try:
            target = self.device if device is None else torch.device(device)
        except RuntimeError as error:
            raise ValueError(f"device must be one of torch, such as cpu or cuda, but is {device!r}.") from error
        if target.type == "meta":
            raise ValueError("device must hold numbers, but the meta device holds none. Take cpu or cuda.")
        other = copy.copy(self)
        other.theta = self.theta.to(dtype=dtype, device=device)
        other.bounds = self.bounds.to(dtype=dtype, device=device)
        other._evaluator = self._evaluator.to(dtype, device)
        other._written = None
        other.findings = {"near": self.findings["near"].to(other.theta)}
        if "missing" in self.findings:
            other.findings["missing"] = self.findings["missing"]
        return other

    def write_back(self) -> None:
        """Store theta in the module (or latent code) that the field was made from, in place.

        Raises:
            ValueError: The module no longer has those parameters.
        """
        self._store(self.theta)

    def require_points(self, points: Tensor, name: str = "points") -> Tensor:
        """Return the points as given, or refuse them: shape (N, D), finite, in the field's dtype and device."""
        if not isinstance(points, Tensor):
            raise TypeError(
                f"{name} must be a torch tensor of shape (N, {self.dimension}), but is a {type(points).__name__}. "
                f"Convert it with torch.as_tensor({name}, dtype=field.dtype, device=field.device)."
            )
        if points.ndim != 2 or points.shape[1] != self.dimension:
            raise ValueError(f"{name} must have shape (N, {self.dimension}), but have {tuple(points.shape)}.")
        if points.dtype != self.dtype or points.device != self.device:
            raise ValueError(
                f"{name} must be {self.dtype} on {self.device} like the field, but are {points.dtype} on "
                f"{points.device}. Use {name}.to(field.theta), or field.to(...)."
            )
        if not bool(torch.isfinite(points).all()):
            i = int((~torch.isfinite(points)).any(dim=1).nonzero()[0])
            raise ValueError(f"{name}[{i}] is not finite: {points[i].tolist()}. Remove or mend it.")
        return points

    @overload
    def in_precision(self, points: None) -> None: ...
    @overload
    def in_precision(self, points: Tensor) -> Tensor: ...
    def in_precision(self, points: Tensor | None) -> Tensor | None:
        """Return real points in the field's precision; anything else as it is, for require_points to refuse."""
        if isinstance(points, Tensor) and points.is_floating_point():
            return points.to(self.dtype)
        return points


def require_field(field: Field) -> Field:
    """Return the field as given, or refuse what is none."""
    if not isinstance(field, Field):
        raise TypeError(
            f"field must be a Field, but is a {type(field).__name__}. Make one of a torch module by Field(module), of "
            "a file by load_field(path), of a mesh by compare.fit_mesh(V, F)."
        )
    return field


def _chunks(points: Tensor) -> Iterator[Tensor]:
    """Return parts that are evaluated at once; one empty part for no rows, so that shapes survive."""
    most = CHUNK_IN_CACHE if points.device.type == "cpu" else CHUNK
    return iter(points.split(most)) if points.shape[0] > most else iter([points])


def _joined(parts: list[Tensor]) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts)
