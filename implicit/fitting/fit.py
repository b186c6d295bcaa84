"""Fit a network to distances and normals sampled in space. Nothing here knows of meshes.

With d the distance of a sample x (negative inside) and n its gradient there, the loss is the mean over samples of

    w(d)^2 (f(x) - d)^2  +  band^2 |df/dx - n|^2  where |d| < band,     w(d) = band / (band + |d|)

so far from the surface only the ratio of error to distance counts: that is enough for the sign, which keeps the space
free of stray pieces, and leaves the network to the surface.

Which training wins was measured on 3 layers of 32 sines, mean distance from the surface in % of the diagonal of its box
after so many seconds of one core (fandisk, bunny; the better of several batch sizes):

    Adam                                         8 s   0.044, 0.069     30 s   0.040, 0.049
    SOAP (implicit.fitting.soap)                         8 s   0.037, 0.056     30 s   0.028, 0.047
    SOAP for 8 s, then Levenberg-Marquardt                              30 s   0.036, 0.064

A Levenberg-Marquardt step on all 2273 parameters takes a second, and lowers the loss of 8000 samples more than that of
the rest; begun at once it is far behind. So SOAP it is, and nothing after it.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import counted, require_choice, require_numbers, require_positive, require_whole
from implicit.field.field import Bounds, Field, Units
from implicit.files import as_path
from implicit.fitting.subjects import NewNetwork, StartedField, starting_field, unit_box
from implicit.fitting.training import Checkpoint, FitStatus, Progress, Schedule, TrainingRun
from implicit.models import Mlp, Siren

FORMAT = "implicit-training-1"

# Part of a batch that is drawn within the band and compared in its gradient too, which costs twice a value.
NEAR_PART = 0.25


@dataclass(frozen=True, eq=False)
class Training:
    """Course and accuracy of a fit."""

    steps: int
    seconds: float
    history: tuple[Progress, ...]  # about 100 rows; of an interrupted fit, those since it went on
    value_error: float  # mean |f - d| over the samples within the band, a length
    normal_error: float  # mean angle between df/dx and n over the same samples, in degrees
    band: float
    status: FitStatus

    def __repr__(self) -> str:
        return (
            f"Training: {self.status.name} after {counted(self.steps, 'step')}, {self.seconds:.1f} s\n"
            f"  mean |f - d| {self.value_error:.3g}, normals off by {self.normal_error:.3g} degrees, "
            f"within the band of {self.band:.3g}"
        )


def fit_field(
    points: Float[Tensor, "n d"],
    distances: Float[Tensor, " n"],
    normals: Float[Tensor, "n d"],
    *,
    module: nn.Module | None = None,
    start: Field | None = None,
    width: int = 32,
    depth: int = 3,
    activation: Literal["sine", "softplus", "relu"] = "sine",
    first_frequency: float = 12.0,
    frequency: float = 6.0,
    steps: int = 4000,
    seconds: float | None = None,
    batch: int = 2048,
    learning_rate: float | None = None,
    method: Literal["soap", "adam"] = "soap",
    band: float | None = None,
    bounds: Bounds | None = None,
    units: Units | None = None,
    seed: int = 0,
    dtype: torch.dtype | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    checkpoint: str | PathLike[str] | None = None,
) -> tuple[Field, Training]:
    """Train a network on signed distances and their gradients: one of ours, any module, or a field to go on from.

    The samples should crowd near the surface and also fill the bounds, and a little beyond: where there are none, the
    sign of the field is left to chance. A quarter of a million makes a good fit of a shape in the unit cube.

    Args:
        points: Samples (N, D), D 2 or 3, of any floating dtype; the work is done where they live.
        distances: Signed distance of each to the surface, negative inside.
        normals: Unit gradient of the distance at each, on the surface its outward normal. Only those of samples within
            the band are used; rows elsewhere may be anything.
        module: A module of one's own to train in place of a Siren or an Mlp, from the parameters that it has: those
            that require gradients. It must be differentiable twice. It is not touched: the field holds what was
            trained, and its `write_back` stores it in the module. Dropout is off and the statistics of batch norm are
            fixed.
        start: A field to go on from: its parameters are trained, its code if it has one, and level, inside, bounds and
            units are its own.
        width: Units in each hidden layer.
        depth: Hidden layers.
        activation: "sine" makes a Siren, "softplus" or "relu" an Mlp.
        first_frequency: Half waves of a Siren that cross the bounds in the first layer at the start, about. Siren
            says how 12 was chosen; raise it for fine detail, and check that no stray pieces come.
        frequency: Factor of a Siren in the later layers.
        steps: Steps to take. With the same seed, data and number of threads they give the same bits.
        seconds: Stop after this time even if steps are left; the schedule then follows the time where it is ahead, so
            the result depends on the speed of the machine.
        batch: Samples drawn for each step.
        learning_rate: Largest step length; None takes what does well for the method and the activation, and for a
            module of one's own 0.005 for its linear layers and 0.01 for all else, which Adam moves.
        method: "soap" (see implicit.fitting.soap) or "adam".
        band: Distance up to which gradients are compared and errors count fully, a length. None takes 1 % of the
            longest side of the bounds.
        bounds: A box that holds the surface; the default is [-1, 1]^D, or that of the start.
        units: Change from the field's coordinates to the user's; kept in the field. None is no change, or the start's.
        seed: Seed of the first weights and of the batches.
        dtype: Precision of the network and the training; None is float32, or that of the module or the start.
        progress: Called as progress(step, steps, loss) up to 100 times.
        checkpoint: A file to write the state of the training to, twenty times on the way and at the end. If it is
            there already, the training goes on from it, and ends with the same bits as one that was never interrupted.

    Returns:
        The field, and the course of the training.

    Raises:
        ValueError: The samples do not fit each other, are not finite, lie all on one side of the surface or all away
            from it; an option is out of range or of another network; the module cannot be trained; or the checkpoint
            belongs to another fit.
        TypeError: The module does not map points (N, D) to N values, or the start is no field.
        FileNotFoundError: The folder of the checkpoint is missing.
    """
    begun = perf_counter()
    dimension = _check_samples(points, distances, normals)
    options: dict[str, Any] = {
        "steps": steps,
        "seconds": seconds,
        "batch": batch,
        "method": method,
        "learning_rate": learning_rate,
    }
    options |= {"width": width, "depth": depth, "activation": activation}
    options |= {"first_frequency": first_frequency, "frequency": frequency}
    kept = {"band": band, "units": units, "seed": seed, "dtype": dtype, "checkpoint": checkpoint}
    require_training({**options, **kept, "module": module, "start": start})
    own = None
    if module is not None or start is not None:
        own = starting_field(module, start, dimension=dimension, bounds=bounds, units=units, dtype=dtype)
        if own.device != points.device:
            raise ValueError(f"The points must be where the module is, on {own.device}, but are on {points.device}.")
    box = _check_bounds(bounds, dimension) if own is None else own.bounds.double().cpu()

    # The samples are brought to [-1, 1]^D, where the training happens.
    middle, half = box.mean(dim=0), float((box[1] - box[0]).max()) / 2
    band = 0.02 if band is None else band / half
    dtype = (torch.float32 if own is None else own.dtype) if dtype is None else dtype
    data = _Samples(
        ((points - middle.to(points)) / half).to(dtype), (distances / half).to(dtype), normals.to(dtype), band
    )
    generator = torch.Generator().manual_seed(seed)
    subject: NewNetwork | StartedField
    if own is None:
        network = _network(activation, first_frequency, frequency, (dimension, width, depth), generator)
        subject = NewNetwork(network.to(device=points.device, dtype=dtype), middle, half, units)
    else:
        subject = StartedField(own, middle, half)
        subject.require_derivatives(data.points[: min(batch, 16)])
    rates = _rates(subject, method, activation) if learning_rate is None else (learning_rate, learning_rate)
    file = None
    if checkpoint is not None:
        settings = [subject.describe(), steps, batch, rates[0], method, band, seed, str(dtype), data.fingerprint()]
        fingerprint = hashlib.sha256(json.dumps(settings).encode()).hexdigest()
        difference = "the samples, the network or the options differ"
        file = Checkpoint(Path(checkpoint), FORMAT, fingerprint, "fit", "optimiser", "fit", difference)
    schedule = Schedule(steps, *rates, seconds=seconds)
    run = TrainingRun(
        _Distance(subject, data, batch, half), generator, schedule, file, rotate=method == "soap", start=begun
    )
    status = run.train(progress)
    value_error, normal_error = data.errors(subject)
    training = Training(
        run.step, run.seconds, tuple(run.history), value_error * half, normal_error, band * half, status
    )
    return subject.field(box), training


def require_training(options: Mapping[str, Any]) -> None:
    """Refuse options of fit_field, by their names, that cannot be meant, before any work."""
    for name, least in {"width": 1, "depth": 1, "steps": 1, "batch": 4, "seed": 0}.items():
        if name in options:
            require_whole(name, options[name], least)
    for name in ("seconds", "learning_rate", "band", "first_frequency", "frequency"):
        if options.get(name) is not None:
            require_positive(name, options[name])
    require_choice("method", options.get("method", "soap"), ("soap", "adam"))
    require_choice("activation", options.get("activation", "sine"), ("sine", "softplus", "relu"))
    if options.get("module") is not None or options.get("start") is not None:
        _require_no_network(options)
    dtype, units = options.get("dtype"), options.get("units")
    if dtype is not None and not (isinstance(dtype, torch.dtype) and dtype.is_floating_point):
        raise TypeError(f"dtype must be a floating one such as torch.float32, but is {dtype!r}.")
    if units is not None and not isinstance(units, Units):
        raise TypeError(f"units must be None or Units(scale, offset), but are {units!r}.")
    if options.get("checkpoint") is not None:
        _require_place(as_path(options["checkpoint"]))


def _require_place(path: Path) -> None:
    """Refuse a checkpoint that could not be written."""
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(
            f"There is no folder {path.parent} to write the checkpoint {path.name} to. Make it first."
        )
    if path.is_dir():
        raise ValueError(f"The checkpoint must be a file, but {path} is a folder. Name a file in it.")


def _require_no_network(options: Mapping[str, Any]) -> None:
    """Refuse options of a new network beside a module or a start, where they would do nothing."""
    defaults = {name: parameter.default for name, parameter in inspect.signature(fit_field).parameters.items()}
    for name in ("width", "depth", "activation", "first_frequency", "frequency"):
        if name in options and options[name] != defaults[name]:
            what = "module" if options.get("module") is not None else "start"
            raise ValueError(f"{name} must be left out where {what} brings the network: it is an option of a new one.")


_LEARNING_RATES = {
    ("soap", "sine"): 1e-2,
    ("adam", "sine"): 1e-2,
    ("soap", "softplus"): 2e-3,
    ("adam", "softplus"): 1e-3,
    ("soap", "relu"): 2e-3,
    ("adam", "relu"): 1e-3,
}

# Of a module of one's own: its linear layers, and all else. After 300 steps on a torus, tanh, ELU, weight norm, an
# encoding and a dense grid all end lower with 1e-2 for both than with 2e-3; half of it leaves room for deeper ones.
_OF_OTHERS = (5e-3, 1e-2)


def _rates(subject: NewNetwork | StartedField, method: str, activation: str) -> tuple[float, float]:
    """Return the largest learning rates of the linear layers and of all else."""
    if isinstance(subject, NewNetwork):
        return _LEARNING_RATES[method, activation], 0.0
    return _OF_OTHERS


def _network(
    activation: Literal["sine", "softplus", "relu"],
    first_frequency: float,
    frequency: float,
    sizes: tuple[int, int, int],
    generator: torch.Generator,
) -> Siren | Mlp:
    """Return a network of an activation, its sizes being the dimension, the width and the depth."""
    if activation == "sine":
        return Siren(*sizes, first_frequency=first_frequency, frequency=frequency, generator=generator)
    return Mlp(*sizes, activation=activation, generator=generator)


class _Samples:
    """The samples in [-1, 1]^D, and the loss of a batch of them."""

    def __init__(self, points: Tensor, distances: Tensor, normals: Tensor, band: float) -> None:
        self.points, self.distances, self.band = points, distances, band
        near = (distances.abs() < band).nonzero()[:, 0]
        if len(near) == 0:
            raise ValueError(
                f"Some samples must lie within the band of {band:.3g} (in bounds of [-1, 1]), but the nearest has "
                f"|distance| = {float(distances.abs().min()):.3g}. Sample the surface too, or widen the band."
            )
        self.near_points, self.near_distances, self.near_normals = points[near], distances[near], normals[near]
        if not bool(torch.isfinite(self.near_normals).all()):
            i = int(near[(~torch.isfinite(self.near_normals)).any(dim=1).nonzero()[0, 0]])
            raise ValueError(f"normals[{i}] is not finite, though the sample is near the surface. Leave it out.")
        self.weights = band / (band + distances.abs())

    def loss(self, subject: NewNetwork | StartedField, batch: int, generator: torch.Generator) -> Tensor:
        """Return the loss at the head of this file, over a fresh batch."""
        near = max(1, int(batch * NEAR_PART))
        i = torch.randint(len(self.points), (batch - near,), generator=generator).to(self.points.device)
        j = torch.randint(len(self.near_points), (near,), generator=generator).to(self.points.device)
        x = self.near_points[j].requires_grad_()
        f = subject.value(x)
        (gradient,) = torch.autograd.grad(f.sum(), x, create_graph=True)
        away = self.weights[i] * (subject.value(self.points[i]) - self.distances[i])
        errors = torch.cat([f - self.near_distances[j], away])
        turns = (gradient - self.near_normals[j]).square().sum(dim=1)
        return errors.square().mean() + self.band**2 * turns.mean()

    def errors(self, subject: NewNetwork | StartedField) -> tuple[float, float]:
        """Return the mean |f - d| and the mean angle in degrees over the samples within the band."""
        values, gradients = subject.value_and_gradient(self.near_points)
        cosine = nn.functional.cosine_similarity(gradients, self.near_normals, dim=1).clamp(-1, 1)
        return float((values - self.near_distances).abs().mean()), float(torch.rad2deg(cosine.acos()).mean())

    def fingerprint(self) -> str:
        """Return a hash of the samples."""
        digest = hashlib.sha256()
        for part in (self.points, self.distances, self.near_normals):
            digest.update(part.detach().cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()


class _Distance:
    """A network that learns the samples' distance, its losses reported as lengths in the user's coordinates."""

    def __init__(self, subject: NewNetwork | StartedField, samples: _Samples, batch: int, unit: float) -> None:
        self._subject, self._samples, self._batch, self._unit = subject, samples, batch, unit

    def modules(self) -> dict[str, nn.Module]:
        return self._subject.modules()

    def others(self) -> list[Tensor]:
        return self._subject.others()

    def loss(self, generator: torch.Generator) -> Tensor:
        return self._samples.loss(self._subject, self._batch, generator)

    def reported(self, loss: Tensor) -> float:
        """Return the root of the loss, a length: the typical error near the surface."""
        return float(loss.sqrt()) * self._unit


def _check_samples(points: Tensor, distances: Tensor, normals: Tensor) -> int:
    for name, value in (("points", points), ("distances", distances), ("normals", normals)):
        if not isinstance(value, Tensor) or not value.is_floating_point():
            raise TypeError(f"{name} must be a floating torch tensor, but is {getattr(value, 'dtype', type(value))}.")
        if value.is_meta or value.device != points.device:
            raise ValueError(f"{name} must be on the CPU or a GPU, all on one, but are on {value.device}.")
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) == 0:
        raise ValueError(f"points must have shape (N, 2) or (N, 3), N > 0, but have {tuple(points.shape)}.")
    if distances.shape != points.shape[:1] or normals.shape != points.shape:
        raise ValueError(
            f"distances and normals must be one for each of the {len(points)} points, of shapes "
            f"{tuple(points.shape[:1])} and {tuple(points.shape)}, but they have {tuple(distances.shape)} and "
            f"{tuple(normals.shape)}."
        )
    for name, value in (("points", points), ("distances", distances)):
        bad = ~torch.isfinite(value.reshape(len(points), -1)).all(dim=1)
        if bool(bad.any()):
            i = int(bad.nonzero()[0, 0])
            raise ValueError(f"{name}[{i}] is not finite: {value[i].tolist()}. Leave that sample out.")
    if not bool((distances < 0).any()) or not bool((distances > 0).any()):
        raise ValueError(
            "Samples must lie on both sides of the surface, but all distances are "
            f"{'>= 0' if bool((distances >= 0).all()) else '<= 0'}. Sample inside (negative) and outside (positive)."
        )
    return points.shape[1]


def _check_bounds(bounds: Bounds | None, dimension: int) -> Float[Tensor, "2 d"]:
    box = require_numbers("bounds", unit_box(dimension) if bounds is None else bounds, "a lower and an upper corner")
    if box.shape != (2, dimension) or not bool((box[0] < box[1]).all()):
        raise ValueError(
            f"bounds must be a lower and an upper corner in {dimension} dimensions like the points, but are {bounds}."
        )
    return box.double()
