"""Examination of what a module must be to be a field, before any work, in milliseconds.

Each value must be that of its own point, the same each time, and its derivatives by the point and by the parameters
must be those of the values. Modules that pool over the batch, draw at random, or cut their gradients off look right
until an edit goes wrong; here they are refused, with what is missing.

Values and gradients are held against central differences at several steps, on the surface where it is found, and a
point speaks against a module only if no step agrees: kinks, saturation and roundoff speak against none.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from implicit.field.differentiable import Differentiable
from implicit.field.evaluator import OfDecoder, OfModule
from implicit.field.forms import SHAPES, Form, described
from implicit.field.frozen import guarded, is_compiled, unwrapped
from implicit.field.torch_errors import first_line, in_our_words, meaning

# Points drawn in the bounds, points of them looked at closely, points of those alone, and halvings that bring points
# near the surface: to 1/256 of a segment, where an occupancy that saturates still has a slope.
DRAWN, CLOSE, ALONE, HALVINGS = 64, 8, 2, 8

# Steps of the differences: in space over the size of the bounds, of the parameters over their own size.
STEPS = (1e-2, 1e-3, 1e-4, 1e-5)

# Largest share by which a derivative may differ from the best of its differences, which are taken in float64 where the
# module can: there they miss by 1e-6 on smooth fields, in float32 by several per cent.
TOLERANCES = {torch.float64: 0.01, torch.float32: 0.2}

_BATCH = (
    "Its value at a point must depend on that point alone: pooling over the points, batch norm without running "
    "statistics (track_running_stats=False), instance norm or a mean over the batch do not. Use layer norm, or running "
    "statistics, and train again"
)
_CUT = "Remove detach(), .data, numpy, round-offs and torch.no_grad() from its forward"


def examine(
    field: Differentiable, live: nn.Module | None, *, derivatives: bool = True
) -> tuple[Tensor, tuple[str, ...]]:
    """Return points near the field's surface, where it was looked at, and notes of what a reader should know.

    Args:
        field: A field whose function has not been looked at.
        live: The module that the field was made from, None where there is none to compare with.
        derivatives: False looks at the shape of the values alone.

    Raises:
        TypeError: The function is none of single points, is drawn at random, or its derivatives are not its own.
    """
    evaluator = field._evaluator
    with torch.random.fork_rng(devices=[]):
        points = _drawn(field, DRAWN)
        _require_values(field, evaluator)
        if not derivatives:
            return points, ()
        with torch.no_grad():
            values = field.function(field.theta, points)
        _require_settled(field, points, values)
        if live is not None:
            _require_same_as(field, live, points, values)
        points = _near_surface(field, points, values)
        notes = _require_derivatives(*_in_double(field, points))
    return points, notes


# Values


def _require_values(field: Differentiable, evaluator: OfModule | OfDecoder) -> None:
    """Refuse what does not map 5 points to 5 real values, and say in which form it would."""
    points = _drawn(field, 5)
    with torch.no_grad():
        try:
            result = evaluator.raw(field.theta, points)
        except Exception as error:
            meant = meaning(error)
            hint = _other_forms(field, points) or (
                f"{meant and ' '}{meant} If it takes them otherwise, such as in a dictionary, give inputs=, a function "
                "from points to what it takes."
            )
            raise TypeError(
                f"The module or decoder could not be evaluated at points of shape {tuple(points.shape)}, dtype "
                f"{field.dtype} ({first_line(error)}). It must map points (N, {field.dimension}) to N values.{hint}"
            ) from error
        form = evaluator.form
        try:
            values = form.values(result)
        except Exception as error:
            raise TypeError(
                f"output={form.output!r} must name the place of N values in what the module gives, but that is "
                f"{described(result)} at 5 points ({first_line(error)}).{_places(form, result)}"
            ) from error
    if not isinstance(values, Tensor) or values.numel() != 5 or not values.is_floating_point():
        came = described(values if form.output is not None else result)
        hint = _places(form, result) or _other_forms(field, points) or " Wrap it so that it does."
        raise TypeError(f"The module must map 5 points to 5 real values, but gave {came}.{hint}")
    if values.dtype.itemsize < 4:
        raise TypeError(
            f"The module must compute in {field.dtype} like its parameters, but gave {values.dtype}, too coarse to "
            "place a surface. Leave autocast and half() out of its forward."
        )


def _places(form: Form, result: object) -> str:
    found = form.places(result, 5)
    return f" Say which of them are the values: {' or '.join(found)}." if found else ""


def _other_forms(field: Differentiable, points: Tensor) -> str:
    """Return in which other form the module takes points and gives each its own value, in words; "" where in none."""
    evaluator = field._evaluator
    if evaluator.form.inputs is not None:
        return ""
    some = ""
    for name, shape in SHAPES.items():
        form = Form(name, evaluator.form.output)  # type: ignore[arg-type]
        other = evaluator.in_form(form)
        try:
            with torch.no_grad():
                result = other.raw(field.theta, points)
                values = form.values(result)
                exact = isinstance(values, Tensor) and values.numel() == len(points) and values.is_floating_point()
                if exact and _gap(other(field.theta, points[:1]).reshape(1), values.reshape(-1)[:1]) < 1e-3:
                    return f' It takes points {shape}: give inputs="{name}".'
        except Exception:
            continue
        if not exact and not some and (places := form.places(result, len(points))):
            some = f' It takes points {shape}: give inputs="{name}" and {" or ".join(places)}.'
    return some


def _require_settled(field: Differentiable, points: Tensor, values: Tensor) -> None:
    """Refuse values that differ from one call to the next, or with the points beside them."""
    finite = values[torch.isfinite(values)]
    if len(finite) == 0:
        raise ValueError(
            f"The module must give finite values within its bounds, but gave NaN or infinite ones at all of {DRAWN} "
            "points. Load or train it again, or give the bounds that it was trained in."
        )
    rounding = 1e3 * torch.finfo(field.dtype).eps * float(finite.abs().max())
    with torch.no_grad():
        again = field.function(field.theta, points)
        if _gap(values, again) > rounding:
            raise TypeError(
                "The module must give the same values each time, but gave others at the same points. Take what is "
                "drawn at random out of its forward (functional dropout without training=self.training, noise), or "
                "seed it there."
            )
        # Products of matrices round differently by the number of rows, which a steep network multiplies.
        allowed = rounding + 1e-3 * float(finite.max() - finite.min())
        try:
            alone = torch.cat([field.function(field.theta, point[None]) for point in points[:ALONE]])
            turned = field.function(field.theta, points.flip(0)).flip(0)
            differs = max(_gap(values[:ALONE], alone), _gap(values, turned)) > allowed
            found = f"gave another alone than among {DRAWN}, or in another order"
        except TypeError as error:
            differs, found = True, f"fails at one alone or in another order ({first_line(error.__cause__ or error)})"
    if not differs:
        differs, found = _is_crossed(field, points), "its gradient by another point is not zero"
    if differs:
        raise TypeError(
            f"The module must give a point the same value in whatever company, but {found}. {_BATCH}."
            f"{_other_forms(field, points[:5])}"
        )


def _is_crossed(field: Differentiable, points: Tensor) -> bool:
    """Return whether the values at some points have a gradient by other points, which is exactly zero otherwise."""
    x = points[:CLOSE].clone().requires_grad_()
    with torch.enable_grad(), in_our_words("be differentiated by the points"):
        f = field.function(field.theta, x)
        if not f.requires_grad:
            return False
        (crossed,) = torch.autograd.grad(f[: CLOSE // 2].sum(), x, allow_unused=True)
    return crossed is not None and bool((crossed[CLOSE // 2 :].nan_to_num(0.0) != 0).any())


def _require_same_as(field: Differentiable, live: nn.Module, points: Tensor, values: Tensor) -> None:
    """Refuse a module whose frozen copy is another function than itself."""
    if any(parameter.dtype != field.dtype for parameter in live.parameters()) or is_compiled(live := unwrapped(live)):
        return
    try:
        with guarded(live), torch.no_grad():
            form = field._evaluator.form
            own = form.values(live(*form.arguments(points))).reshape(len(points))
    except Exception:  # its wrapper wants other devices, say; the copy has been looked at already
        return
    own = (own - field.level) * field.sign
    finite = values[torch.isfinite(values)]
    if _gap(values, own) > 1e-3 * float(finite.max() - finite.min()) + 1e-3 * float(finite.abs().max()):
        raise TypeError(
            "The module's copy must be the same function, but gives other values than the module in evaluation mode. "
            "What it holds outside of parameters, buffers and attributes (globals, files, closures of compiled code) "
            "cannot be copied: make it a buffer."
        )


# Derivatives


def _require_derivatives(field: Differentiable, points: Tensor) -> tuple[str, ...]:
    """Refuse derivatives that are cut off or not those of the values; return a note of parameters that move nothing."""
    x, theta = points.clone().requires_grad_(), field.theta.detach().clone().requires_grad_()
    weights = _signs(len(points), 3, 7).to(points)
    with torch.enable_grad(), in_our_words("be differentiated"):
        f = field.function(theta, x)
        of_x = torch.autograd.grad(f.sum(), x, allow_unused=True)[0] if f.requires_grad else None
        by_theta = []
        for row in weights.T:
            f = field.function(theta, x.detach())
            found = torch.autograd.grad(f @ row, theta, allow_unused=True)[0] if f.requires_grad else None
            by_theta.append(torch.zeros_like(theta) if found is None else found)
    if of_x is None:
        raise TypeError(
            f"The module's gradient by its points must be there, but its values are cut off from them. {_CUT}, and "
            "take points as they come in."
        )
    if not _slopes_agree(field, points, of_x):
        raise TypeError(
            "The module's gradient by its points must be that of its values, but differs from their differences at "
            f"most of {len(points)} points. Part of it is cut off from the points, or an autograd.Function in it has a "
            f"wrong backward. {_CUT}, or leave this check out by check=False."
        )
    gradients = torch.stack(by_theta)
    still = [block for block in field.layout if not bool((gradients[:, block.where] != 0).any())]
    moved = _moved_unseen(field, points, still) if still else []
    if moved:
        raise TypeError(
            f"The module's gradient by {', '.join(moved[:5])} must be there, but is zero although the values change "
            f"with them. {_CUT}, and let it use its parameters as it holds them."
        )
    if not _products_agree(field, points, gradients, weights):
        raise TypeError(
            "The module's gradient by its parameters must be that of its values, but differs from their differences. "
            "Part of it is cut off from them, or an autograd.Function in it has a wrong backward. "
            f"{_CUT}, or leave this check out by check=False."
        )
    if len(still) == len(field.layout) and not _reaches(field, points):
        raise TypeError(
            "The decoder's values must depend on its code, but do not. Let it use its second argument."
            if field.takes_code
            else "The module's values must depend on the parameters to edit, but depend on none of them. Choose "
            "parameters that its forward uses, by parameters=[...]."
        )
    if not still or field.takes_code:
        return ()
    names = [block.name for block in still]
    return (f"Some parameters do not move the surface at {len(points)} points of it: {', '.join(names[:5])}.",)


def _in_double(field: Differentiable, points: Tensor) -> tuple[Differentiable, Tensor]:
    """Return field and points in float64, or as they are where the module cannot work in it."""
    if field.dtype != torch.float32:
        return field, points
    try:
        double = field.to(torch.float64)
        with torch.no_grad():
            raw = double._evaluator.raw(double.theta, points.double())
            values = double._evaluator.form.values(raw)
            mine = field._evaluator(field.theta, points).reshape(-1)
    except Exception:  # a kernel of its own for float32 alone
        return field, points
    size = float(mine.abs().nan_to_num(0.0).max()) + 1e-3
    if values.dtype != torch.float64 or _gap(values.reshape(-1), mine.double()) > 1e-2 * size:
        return field, points
    return double, points.double()


def _reaches(field: Differentiable, points: Tensor) -> bool:
    """Return whether the values have any graph to the parameters."""
    theta = field.theta.detach().clone().requires_grad_()
    with torch.enable_grad():
        return bool(field.function(theta, points).requires_grad)


def _slopes_agree(field: Differentiable, points: Tensor, gradients: Tensor) -> bool:
    directions = torch.nn.functional.normalize(_signs(len(points), points.shape[1], 3).to(points), dim=1)
    steps = torch.tensor(STEPS, dtype=torch.float64).to(points) * field.size
    way = steps[:, None, None] * directions
    ends = torch.cat([points + way, points - way]).reshape(-1, points.shape[1])
    with torch.no_grad():
        ahead, behind = field.function(field.theta, ends).view(2, len(steps), len(points))
    slopes = (gradients * directions).sum(dim=1)
    return _agree((ahead - behind) / (2 * steps[:, None]), slopes.expand(len(steps), -1), ahead.abs(), steps)


def _products_agree(field: Differentiable, points: Tensor, gradients: Tensor, weights: Tensor) -> bool:
    """Compare products of df/dtheta, summed with weights, with differences along one direction of the parameters."""
    direction = _of_own_size(field) * _signs(len(field.theta), 1, 5)[:, 0].to(field.theta)
    steps = torch.tensor(STEPS, dtype=torch.float64).to(points)
    differences, sizes = [], []
    with torch.no_grad():
        for step in steps:
            ahead, behind = (field.function(field.theta + sign * step * direction, points) for sign in (1.0, -1.0))
            differences.append(weights.T @ (ahead - behind) / (2 * step))
            sizes.append(ahead.abs().sum().expand(weights.shape[1]))
    slopes = (gradients @ direction).expand(len(steps), -1)
    return _agree(torch.stack(differences), slopes, torch.stack(sizes), steps)


def _agree(differences: Tensor, slopes: Tensor, sizes: Tensor, steps: Tensor) -> bool:
    """Return whether at least half of the slopes are near one of their differences, which are a row a step."""
    tolerance = TOLERANCES.get(slopes.dtype, 0.2)
    noise = 30 * torch.finfo(slopes.dtype).eps * sizes / steps[:, None]
    gap = (differences - slopes).abs()
    near = gap <= tolerance * torch.maximum(differences.abs(), slopes.abs()) + noise
    agreed = near.any(dim=0) | ~torch.isfinite(gap).any(dim=0)
    return int(agreed.sum()) * 2 >= len(agreed)


def _moved_unseen(field: Differentiable, points: Tensor, still: list) -> list[str]:  # type: ignore[type-arg]
    """Return the names of parameters that move the values, although no gradient by them was found."""
    names = []
    size = _of_own_size(field)
    with torch.no_grad():
        values = field.function(field.theta, points)
        for block in still[:20]:
            theta = field.theta.clone()
            theta[block.where] += 1e-3 * size[block.where]
            change = [field.function(theta, points)]
            if isinstance(field._evaluator, OfModule):
                # What holds the parameter in a way that no replacement reaches shows once it is really written.
                module, form = field._evaluator.written(theta), field._evaluator.form
                raw = form.values(module(*form.arguments(points))).reshape(len(points))
                change.append((raw.to(points.dtype) - field.level) * field.sign)
            noise = 1e3 * torch.finfo(field.dtype).eps * float(values.abs().nan_to_num(0.0).max())
            # One unit of a dead layer may wake at a point; what is used moves the values at most.
            if any(int(((other - values).abs() > noise).sum()) * 2 > len(points) for other in change):
                names.append(block.name)
    return names


def _of_own_size(field: Differentiable) -> Tensor:
    """Return the size of each parameter, or of the others of its tensor where that is more."""
    size = field.theta.abs()
    rest = float(size.square().mean().sqrt()) or 1.0
    for block in field.layout:
        own = float(size[block.where].square().mean().sqrt()) if size[block.where].numel() else 0.0
        size[block.where] += own or rest
    return size


# Points


def _drawn(field: Differentiable, n: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    draw = torch.rand(n, field.dimension, generator=generator, dtype=torch.float64).to(field.theta)
    return field.bounds[0] + draw * (field.bounds[1] - field.bounds[0])


def _signs(n: int, columns: int, seed: int) -> Tensor:
    """Return numbers of both signs, none near zero, (n, columns)."""
    generator = torch.Generator().manual_seed(seed)
    draw = 2 * torch.rand(n, columns, generator=generator, dtype=torch.float64) - 1
    return draw.sign() * (0.5 + draw.abs() / 2)


def _near_surface(field: Differentiable, points: Tensor, values: Tensor) -> Tensor:
    """Return CLOSE points near f = 0, by halving between points of either sign; any points where there is one alone."""
    inside, outside = points[values < 0], points[values > 0]
    if len(inside) == 0 or len(outside) == 0:
        return points[:CLOSE]
    low, high = (side[torch.arange(CLOSE, device=side.device) % len(side)].clone() for side in (inside, outside))
    with torch.no_grad():
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            negative = (field.function(field.theta, middle) < 0)[:, None]
            low, high = torch.where(negative, middle, low), torch.where(negative, high, middle)
    return (low + high) / 2


def _gap(a: Tensor, b: Tensor) -> float:
    """Return the largest difference, infinite where one alone is not finite."""
    gap = (a - b).abs()
    gap = torch.where(a == b, torch.zeros_like(gap), gap)
    return float(torch.where(torch.isnan(a) & torch.isnan(b), torch.zeros_like(gap), gap).nan_to_num(torch.inf).max())
