"""Panels of surfaces with a number at each vertex, as the pictures of edits share them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy import ndarray

import implicit
from compare.reports.figures import COLOURS, SURFACE, paint
from compare.reports.views import Camera, View

# Of shapes that face another way than most, so that they are not seen from behind.
AZIMUTH = {"spot": 300.0}


def camera_of(shape: str) -> Camera:
    """Return where a shape is seen best from, by its name or that of its file."""
    return Camera(AZIMUTH.get(Path(shape).stem, 30.0))


def surface_view(
    field: implicit.Field, values: Callable[[ndarray], ndarray] | None = None, resolution: int = 96
) -> View:
    """Return a field's surface with a number a vertex, or zeros; even where it is flat, as numbers may have detail."""
    V, F = implicit.extract_mesh(field, resolution)
    return View(V, F, np.zeros(len(V)) if values is None else values(V))


def coloured(view: View, limit: float) -> Float[ndarray, "m 3"]:
    """Colours of the faces on the diverging map about zero; white where the number is NaN."""
    numbers = view.values[view.F].mean(axis=1)
    colours = colormaps[COLOURS](Normalize(-limit, limit)(np.nan_to_num(numbers)))[:, :3]
    return np.where(np.isfinite(numbers)[:, None], colours, SURFACE)


def plain_colours(view: View) -> Float[ndarray, "m 3"]:
    """Return the colour of a surface without numbers."""
    return np.tile(np.array(SURFACE), (len(view.F), 1))


def panel(axes: Axes, view: View, camera: Camera, limit: float | None, title: str) -> None:
    """Paint a view; without a limit in one colour."""
    paint(axes, view, plain_colours(view) if limit is None else coloured(view, limit), camera)
    axes.set_title(title, fontsize=7)


def colour_bar(figure: Figure, axes: Sequence[Axes], limit: float, label: str, *, beyond: bool = False) -> None:
    """Draw a colour bar beside the axes, for numbers up to the limit, or with arrows where some are beyond it."""
    colours = ScalarMappable(Normalize(-limit, limit), COLOURS)
    bar = figure.colorbar(colours, ax=list(axes), shrink=0.8, pad=0.01, extend="both" if beyond else "neither")
    bar.set_label(label, fontsize=7)
    bar.ax.tick_params(labelsize=6)
