"""A rope: a closed curve in the plane that is pulled at one place and keeps its length [constraints, eq. 7].

In the plane the area of the surface is the length of the curve. The paper takes what would change it out of each step,
which is exact to first order; here it is a hard row of each step and is restored after it. Where nothing but the pull
is asked for and the length is held, the rest of the curve must give what the pull takes.
"""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import implicit
from compare.paper.findings import Finding
from compare.paper.request import Request
from compare.reports.figures import HELD, MOVED, SURFACE, same_frame
from implicit import Along, Area, Ball, Edit, Field, Handle

PART = "rope"
RADIUS = 0.5
SQUARE = ((-1.0, -1.0), (1.0, 1.0))
PULL = Handle(Ball((RADIUS, 0.0), 0.05, falloff=0.3), Along(0.15))


def draw(request: Request) -> list[Finding]:
    """Pull the rope with its length free and held, and draw both."""
    rope = _circle(request)
    parts, points = (6, 200) if request.quick else (16, 400)
    edits = []
    for done, constraints in enumerate(((), (Area(),))):
        request.tell(done, 2, "length held" if constraints else "length free")
        edits.append(
            implicit.geometric_edit(
                rope,
                PULL,
                rest="free",
                steps=parts,
                points=points,
                constraints=constraints,
                resolution=128,
                seed=request.seed,
            )
        )
    request.save(_picture(rope, edits), PART)
    return _findings(rope, edits)


def _circle(request: Request) -> Field:
    """Return a network of the paper's kind, in the plane, fitted to the exact distance to a circle."""
    generator = torch.Generator().manual_seed(request.seed)
    count = 20_000
    angles = 2 * torch.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    normals = torch.stack([angles.cos(), angles.sin()], dim=1)
    near = RADIUS + 0.02 * torch.randn(count // 2, generator=generator, dtype=torch.float64)
    anywhere = 1.5 * torch.rand(count - count // 2, generator=generator, dtype=torch.float64)
    radii = torch.cat([near, anywhere])
    field, _ = implicit.fit_field(
        radii[:, None] * normals,
        radii - RADIUS,
        normals,
        steps=300 if request.quick else 1500,
        bounds=SQUARE,
        seed=request.seed,
    )
    return field.to(torch.float64)


def _length(field: Field) -> float:
    return float(Area().value(field, implicit.surface_quadrature(field, 256)))


def _findings(rope: Field, edits: list[Edit]) -> list[Finding]:
    before, findings = _length(rope), []
    for name, edit in zip(("length free", "length held"), edits, strict=True):
        error = edit.error_field()
        missed = float(error[torch.isfinite(error)].square().mean().sqrt())
        drift, held = _length(edit.field) / before - 1, name == "length held"
        findings += [
            Finding(
                PART,
                f"{name}: relative change of length [of that before]",
                drift,
                note=edit.status.value,
                headline=held,
            ),
            Finding(PART, f"{name}: rms of what the pull is missed by [of the pull]", missed),
        ]
    return findings


def _picture(rope: Field, edits: list[Edit]) -> Figure:
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    before = _length(rope)
    for axes, name, edit in zip(figure.subplots(1, 2), ("length free", "length held"), edits, strict=True):
        _outline(axes, rope, SURFACE, "before")
        _outline(axes, edit.field, HELD if name == "length held" else MOVED, "after")
        axes.annotate(
            "", (RADIUS + 0.15, 0.0), (RADIUS, 0.0), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1}
        )
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(f"{name}: {100 * (_length(edit.field) / before - 1):+.2g} %", fontsize=8)
        axes.legend(fontsize=7, loc="center")
    same_frame(figure.axes)
    return figure


def _outline(axes: Axes, field: Field, colour: tuple[float, float, float], label: str) -> None:
    V, E = implicit.extract_mesh(field, 256)
    ends = V[E]
    gaps = np.full((len(ends), 1, 2), np.nan)  # between the segments, so that one call draws them all
    x, y = np.concatenate([ends, gaps], axis=1).reshape(-1, 2).T
    axes.plot(x, y, color=colour, linewidth=2, label=label)
