"""Basis functions of a code on the surface [section 4.2]: the same ones on two similar chairs, and their symmetry."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import implicit
from compare.paper.findings import Finding
from compare.paper.panels import colour_bar
from compare.paper.request import Request
from compare.reports.figures import COLOURS, paint
from compare.reports.views import Camera, View
from implicit import families

PART = "semantic_basis"
COUNT = 4
CHAIRS = ("one chair", "its neighbour")
SYMMETRY = "mirror symmetry from side to side, 1 is even and -1 odd [correlation]"


def draw(request: Request) -> list[Finding]:
    """Draw the code's directions of the largest singular values at one chair, on it and on its nearest neighbour."""
    model = families.bundled("deepsdf-chairs")
    first = model.nearest(torch.tensor(list(model.family.ranges.values())).double().mean(dim=1))
    second = int((model.latents - model.latents[first]).norm(dim=1).argsort()[1])
    fields = [model.field(model.latents[k]) for k in (first, second)]
    samples = [implicit.sample_surface(field, 4000) for field in fields]
    directions = implicit.surface_modes(fields[0], samples[0], COUNT).directions
    symmetry = [implicit.mirror_symmetry(f, s, directions) for f, s in zip(fields, samples, strict=True)]
    request.save(_picture(fields, directions, symmetry, 64 if request.quick else 128), PART)
    findings = []
    for k in range(COUNT):
        for name, measure in zip(CHAIRS, symmetry, strict=True):
            findings.append(Finding(PART, f"basis function {k + 1} on {name}: {SYMMETRY}", float(measure[k])))
    own = torch.eye(len(model.latents[0]))
    single = torch.stack([implicit.mirror_symmetry(f, s, own) for f, s in zip(fields, samples, strict=True)])
    what = f"the single numbers of the code, least on both chairs: {SYMMETRY}"
    findings.append(Finding(PART, what, float(single.min())))
    return findings


def _picture(
    fields: list[implicit.Field], directions: torch.Tensor, symmetry: list[torch.Tensor], resolution: int
) -> Figure:
    figure = Figure(figsize=(2.2 * COUNT, 4.8), layout="constrained")
    grid = figure.subplots(2, COUNT)
    camera = Camera(35.0, 15.0)
    meshes = [implicit.extract_mesh(field, resolution) for field in fields]
    for k in range(COUNT):
        motions = []
        for field, (V, _) in zip(fields, meshes, strict=True):
            points = torch.from_numpy(V).to(field.theta)
            motions.append(implicit.normal_displacement(field, points, directions[:, k].to(field.theta)).numpy())
        limit = max(float(np.quantile(np.abs(u), 0.99)) for u in motions)
        for axes, name, (V, F), u, measure in zip(grid[:, k], CHAIRS, meshes, motions, symmetry, strict=True):
            colours = colormaps[COLOURS](Normalize(-limit, limit)(u[F].mean(axis=1)))[:, :3]
            paint(axes, View(V, F, u), colours, camera)
            axes.set_title(f"function {k + 1} on {name}\nsymmetry {float(measure[k]):.4f}", fontsize=8)
    colour_bar(figure, list(grid.ravel()), 1.0, "normal motion / its column's 99 % quantile", beyond=True)
    return figure
