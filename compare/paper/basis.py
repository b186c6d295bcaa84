"""Basis functions: the motion of the surface that a single weight spans, one for each layer [paper, fig. 3]."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy import ndarray

import implicit
from compare.paper.findings import Finding
from compare.paper.panels import camera_of, colour_bar, panel, surface_view
from compare.paper.request import Request


def draw(request: Request) -> list[Finding]:
    """Draw a random weight of each layer, in increasing depth; all but a hundredth of the surface is on the scale."""
    shapes = request.shapes("bunny.off", bundled=("spot",))
    subjects = [request.subject(shape) for shape in shapes]
    depth = max(len(implicit.one_weight_per_layer(subject.field)) for subject in subjects)
    figure = Figure(figsize=(2.1 * depth, 2.3 * len(shapes)), layout="constrained")
    grid = figure.subplots(len(shapes), depth, squeeze=False)
    findings = []
    for row, shape, subject in zip(grid, shapes, subjects, strict=True):
        name = Path(shape).stem
        sample = implicit.surface_quadrature(subject.field, 48)
        for axes, function in zip(row, implicit.one_weight_per_layer(subject.field, request.seed), strict=False):
            # Where the slope of the field is small, a function may be many times what it is elsewhere.
            scale = float(function(sample.points).abs().quantile(0.99))

            def values(V: ndarray, function: implicit.BasisFunction = function, scale: float = scale) -> ndarray:
                return np.asarray(function(torch.from_numpy(V)).numpy()) / scale

            panel(axes, surface_view(subject.field, values), camera_of(shape), 1.0, f"{name}: {function.name}")
            waves = _wave_number(subject.field, function, sample)
            what = (
                f"{name}, {function.name}: wave number of its motion b, sqrt(int |grad b|² / int b²) [radians/length]"
            )
            findings.append(Finding("basis", what, waves))
        count = subject.field.theta.numel()
        what = f"{name}: parameters of the network, 3 hidden layers of 32 sines [count]"
        findings.append(Finding("basis", what, count, 2273, headline=name == "spot"))
        colour_bar(figure, list(row), 1.0, "normal motion / its 99 % quantile", beyond=True)
    request.save(figure, "basis")
    return findings


def _wave_number(
    field: implicit.Field, function: implicit.BasisFunction, sample: implicit.SurfaceSample, step: float = 1e-4
) -> float:
    """Return how fast a function varies along the surface: sqrt(int |grad_surface b|^2 / int b^2)."""
    square = torch.zeros_like(sample.weights)
    for axis in torch.eye(3, dtype=sample.points.dtype):
        tangent = axis - sample.normals * (sample.normals @ axis)[:, None]
        ahead = implicit.project_to_surface(field, sample.points + step * tangent)
        behind = implicit.project_to_surface(field, sample.points - step * tangent)
        square += ((function(ahead) - function(behind)) / (2 * step)) ** 2
    return float((sample.weights @ square / (sample.weights @ function(sample.points) ** 2)).sqrt())
