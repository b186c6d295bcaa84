"""Fields, edits and meshes as panels to look at: a surface each, with a colour for what matters on it.

An edit has its edited surface, coloured by its error where most of the surface was told where to go, and else by how
far it moved; with the field from which it began, that one before it, its handles in the colours of the report.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import Normalize
from numpy import ndarray
from scipy.spatial import cKDTree

import implicit
import meshref
from compare.reports.figures import COLOURS, HELD, MOVED, SURFACE
from compare.reports.views import View, simplified
from implicit import Edit, Field

Colours = Literal["auto", "error", "motion", "plain"]
MOST_FACES = 20_000  # more cannot be told apart in a panel
LABELS = {
    "error": "error, of the largest motion asked for",
    "motion": "motion",
    "along": "motion along the normal, outward",
    "given": "values",
}


@dataclass(frozen=True, eq=False)
class Panel:
    """A surface to look at.

    Attributes:
        title: Words above it.
        view: Its mesh and a number a vertex, NaN where there is none.
        label: Meaning of the numbers; None where they are none to read.
        colours: Of the vertices where they do not stand for numbers.
    """

    title: str
    view: View
    label: str | None = None
    colours: Float[ndarray, "n 3"] | None = None


def panels_of(
    things: Sequence[object],
    *,
    before: Field | None,
    titles: Sequence[str] | None,
    colours: Colours,
    resolution: int,
) -> list[Panel]:
    """Return the panels of fields, edits and meshes, in their order.

    Raises:
        TypeError: Something is none of these.
        ValueError: There is nothing to draw, it is in the plane, or there are not as many titles as panels.
    """
    if not things:
        raise ValueError("There is nothing to draw. Give a Field, an Edit, or a mesh as (V, F) or (V, F, values).")
    if colours not in get_args(Colours):
        raise ValueError(f"colours must be one of {', '.join(get_args(Colours))}, but is {colours!r}.")
    if before is not None and not isinstance(before, Field):
        raise TypeError(f"before must be the Field that the edits began from, but is {type(before).__name__}.")
    panels: list[Panel] = []
    for place, thing in enumerate(things):
        if isinstance(thing, Edit):
            if before is not None:
                panels.append(_before(before, thing, resolution))
            panels.append(_after(thing, colours, resolution))
        elif isinstance(thing, Field):
            panels.append(Panel("field", _view(thing, resolution)))
        else:
            panels.append(_mesh(thing, place))
    if titles is not None:
        if isinstance(titles, str) or len(titles) != len(panels):
            raise ValueError(f"titles must be {len(panels)} words, one for each panel, but are {titles!r}.")
        panels = [Panel(str(title), p.view, p.label, p.colours) for title, p in zip(titles, panels, strict=True)]
    return panels


def limit_of(panels: Sequence[Panel]) -> tuple[float, float]:
    """Return the range of colours that panels share: about zero, or from zero where nothing is below."""
    finite = [p.view.values[np.isfinite(p.view.values)] for p in panels if p.label is not None]
    finite = [values for values in finite if len(values)]
    if not finite:
        return 0.0, 1.0
    values = np.concatenate(finite)
    # Not the largest, which is often one vertex at a sharp edge and would leave the rest without colour.
    limit = float(np.quantile(np.abs(values), 0.99)) or float(np.abs(values).max()) or 1.0
    return (0.0 if values.min() >= 0 else -limit), limit


def vertex_colours(panel: Panel, limit: tuple[float, float]) -> Float[ndarray, "n 3"]:
    """Return the colour of each vertex: of its number, or of the surface where it has none."""
    if panel.colours is not None:
        return panel.colours
    plain = np.tile(SURFACE, (len(panel.view.V), 1))
    if panel.label is None:
        return plain
    # What cannot be negative has the upper half of the map, so that zero is the same grey everywhere.
    shades = colormaps[COLOURS](Normalize(-limit[1], limit[1])(panel.view.values))[:, :3]
    return np.where(np.isfinite(panel.view.values)[:, None], shades, plain)


def _view(field: Field, resolution: int) -> View:
    if field.dimension != 3:
        raise ValueError(
            "Surfaces in three dimensions are drawn, but this field is in the plane. Its curve is "
            "implicit.extract_mesh(field): points and segments, which matplotlib draws."
        )
    V, F = implicit.extract_mesh(field, resolution)
    return simplified(View(V, F, np.full(len(V), np.nan)), MOST_FACES)


def _before(field: Field, edit: Edit, resolution: int) -> Panel:
    """Return the surface that an edit began from: what is held in blue, what is sent somewhere in orange."""
    view = _view(field, resolution)
    if edit.asked is not None:  # at any point; other edits know it of theirs, and the nearest will do
        points = torch.from_numpy(view.V).to(edit.points)
        wanted = _array(edit.asked(points, field.normal(points.to(field.dtype)).to(points))[0])
    else:
        wanted = _array(edit.wanted)[cKDTree(_array(edit.points)).query(view.V)[1]]
    asked = np.isfinite(wanted).all(axis=1)
    moves = asked & (np.linalg.norm(wanted, axis=1) > 0)
    return Panel("before", view, colours=np.array([SURFACE, HELD, MOVED])[asked.astype(int) + moves])


def _after(edit: Edit, colours: Colours, resolution: int) -> Panel:
    """Return the edited surface, each vertex with the number of the nearest point that the edit has carried there."""
    view = _view(edit.field, resolution)
    values, label = _numbers(edit, colours)
    if label is None:
        return Panel("after", view)
    nearest = cKDTree(_array(edit.points + edit.displacement)).query(view.V)[1]
    return Panel("after", View(view.V, view.F, values[nearest]), label)


def _numbers(edit: Edit, colours: Colours) -> tuple[Float[ndarray, " n"], str | None]:
    asked = torch.isfinite(edit.wanted).all(dim=1)
    share = float(edit.weights[asked].sum() / edit.weights.sum())
    if colours == "auto":
        colours = "error" if share > 0.5 else "motion"
    if colours == "plain":
        return np.zeros(0), None
    if colours == "error":
        if not bool(asked.any()):
            raise ValueError('Nothing was told where to go in this edit, so it has no error. Take colours="motion".')
        return _array(edit.error_field()), LABELS["error"]
    if share == 0:  # a flow: inwards and outwards are what tells
        return _array((edit.displacement * edit.normals).sum(dim=1)), LABELS["along"]
    return _array(edit.displacement.norm(dim=1)), LABELS["motion"]


def _mesh(thing: object, place: int) -> Panel:
    if not isinstance(thing, tuple) or len(thing) not in (2, 3):
        raise TypeError(
            f"A Field, an Edit, or a mesh as (V, F) or (V, F, values) can be drawn, but number {place} is a "
            f"{type(thing).__name__}."
        )
    V, F = np.asarray(thing[0]), np.asarray(thing[1])
    values = np.full(V.shape[:1], np.nan) if len(thing) == 2 else np.asarray(thing[2], dtype=np.float64)
    if values.shape != V.shape[:1]:
        raise ValueError(f"values must be a number for each of the {len(V)} vertices, but have shape {values.shape}.")
    if V.ndim == 2 and F.ndim == 2 and F.dtype.kind in "iu" and F.size and F.min() >= 0 and F.max() < len(V):
        used, places = np.unique(
            F, return_inverse=True
        )  # what no face has is not drawn, and no reason to refuse the rest
        V, F, values = V[used], places.reshape(F.shape), values[used]
    V, F = meshref.check_mesh(V, F, degenerate="allow")
    return Panel("mesh", simplified(View(V, F, values), MOST_FACES), None if len(thing) == 2 else LABELS["given"])


def _array(tensor: torch.Tensor) -> ndarray:
    return tensor.detach().double().cpu().numpy()
