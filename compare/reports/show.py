"""A look at fields, edits and meshes, beside each other: to turn in a notebook or a browser, or as a still picture."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from compare.files import replace_file
from compare.reports.figures import COLOURS, paint
from compare.reports.show_panels import Colours, Panel, limit_of, panels_of, vertex_colours
from compare.reports.views import Camera
from implicit import Field

if TYPE_CHECKING:
    import plotly.graph_objects

AZIMUTH = 25.0
WIDTH = 380  # pixels of a panel

# In a file, whichever panel is turned leads the others.
LINK = """
const box = document.getElementById("{plot_id}");
const scenes = Object.keys(box._fullLayout).filter(name => /^scene[0-9]*$/.test(name));
let following = false;
box.on("plotly_relayout", change => {
  const leader = scenes.find(name => change[name + ".camera"]);
  if (!leader || following) return;
  following = true;
  const camera = change[leader + ".camera"];
  Plotly.relayout(box, Object.fromEntries(scenes.map(name => [name + ".camera", camera]))).then(() => {
    following = false;
  });
});
"""


def show(
    *things: Any,
    before: Field | None = None,
    titles: Sequence[str] | None = None,
    colours: Colours = "auto",
    resolution: int = 64,
    azimuth: float = AZIMUTH,
    path: str | PathLike[str] | None = None,
) -> plotly.graph_objects.Figure:
    """Return a figure of fields, edits and meshes beside each other, to turn in a notebook or a browser.

    Args:
        things: Each a Field, an Edit, or a mesh as (V, F) or (V, F, values) with a number a vertex.
        before: Field that the edits began from: drawn before each of them, held parts blue, moved parts orange.
        titles: Words above the panels.
        colours: Of edits: "error" (achieved minus wanted normal motion, over the largest wanted), "motion" (how far the
            surface has moved; along the normal where nothing was told where to go, as in smoothing), "plain", or
            "auto": the error where most of the surface was told where to go, else the motion.
        resolution: Cells along the longest side of a field's bounds, of the mesh that is drawn.
        azimuth: Degrees about the y axis from where to look at first; 0 looks along -z.
        path: HTML file to write too, of some 5 MB: it holds all it needs, opens offline, and its panels turn together.

    Returns:
        A plotly figure. A notebook shows it; `figure.show()` opens a browser.

    Raises:
        TypeError: Something cannot be drawn.
        ValueError: There is nothing to draw, or a field has no surface or is in the plane.
        ImportError: plotly, of the extra "notebook", is not installed.
    """
    try:
        from plotly.graph_objects import Mesh3d, Scatter3d
        from plotly.subplots import make_subplots
    except ModuleNotFoundError as error:
        raise ImportError(
            'show draws by plotly, which is not installed: pip install ".[notebook]". draw writes a picture without it.'
        ) from error

    panels = panels_of(things, before=before, titles=titles, colours=colours, resolution=resolution)
    limit = limit_of(panels)
    figure = make_subplots(
        cols=len(panels),
        specs=[[{"type": "scene"}] * len(panels)],
        subplot_titles=[panel.title for panel in panels],
        horizontal_spacing=0.01,
    )
    back = Camera(azimuth).axes()[2]
    light = {"ambient": 0.6, "diffuse": 0.55, "specular": 0.08, "roughness": 0.9}
    for column, panel in enumerate(panels, start=1):
        V, F = panel.view.V.astype(np.float32), panel.view.F.astype(np.int32)
        hints: dict[str, Any] = {"hoverinfo": "skip"}
        if panel.label is not None:
            hints = {"text": [f"{value:.3g}" for value in panel.view.values], "hoverinfo": "text"}
        trace = Mesh3d(
            **dict(zip("xyz", V.T, strict=True)),
            **dict(zip("ijk", F.T, strict=True)),
            vertexcolor=[f"rgb({r},{g},{b})" for r, g, b in (255 * vertex_colours(panel, limit)).astype(int)],
            flatshading=False,
            lighting=light,
            lightposition={"x": 500, "y": 2000, "z": 2000},
            **hints,
        )
        figure.add_trace(trace, row=1, col=column)
    label = _label(panels)
    if label is not None:  # a point that is not drawn has the colour bar
        bar = {"colorscale": _scale(limit), "cmin": limit[0], "cmax": limit[1], "showscale": True, "opacity": 0}
        bar["colorbar"] = {"title": {"text": label, "side": "right"}, "len": 0.8, "thickness": 12}
        figure.add_trace(Scatter3d(x=[None], y=[None], z=[None], mode="markers", marker=bar), row=1, col=1)
    half = _half(panels)
    axes = {f"{name}axis": {"visible": False, "range": half[k].tolist()} for k, name in enumerate("xyz")}
    camera = {"eye": dict(zip("xyz", (1.75 * back).tolist(), strict=True)), "up": {"x": 0, "y": 1, "z": 0}}
    sides = (half[:, 1] - half[:, 0]) / np.ptp(half, axis=1).max()
    aspect = {"aspectmode": "manual", "aspectratio": dict(zip("xyz", (1.3 * sides).tolist(), strict=True))}
    figure.update_scenes(**axes, **aspect, camera=camera, dragmode="orbit")
    figure.update_layout(
        width=WIDTH * len(panels) + 110, height=WIDTH + 40, margin={"l": 0, "r": 0, "t": 40, "b": 0}, showlegend=False
    )
    if path is not None:
        page = figure.to_html(include_plotlyjs=True, full_html=True, post_script=LINK)
        replace_file(Path(path), page.encode("utf-8"))
    return figure


def draw(
    *things: Any,
    before: Field | None = None,
    titles: Sequence[str] | None = None,
    colours: Colours = "auto",
    resolution: int = 64,
    azimuth: float = AZIMUTH,
    path: str | PathLike[str] | None = None,
) -> Figure:
    """Return a still picture of fields, edits and meshes beside each other.

    Args:
        things: Each a Field, an Edit, or a mesh as (V, F) or (V, F, values), as for show.
        before: Field that the edits began from: drawn before each of them, held parts blue, moved parts orange.
        titles: Words above the panels.
        colours: Of edits, as for show: "error", "motion", "plain" or "auto".
        resolution: Cells along the longest side of a field's bounds, of the mesh that is drawn.
        azimuth: Degrees about the y axis from where to look; 0 looks along -z.
        path: File to write too, of a kind that matplotlib knows: .png, .pdf, .svg.

    Returns:
        A matplotlib figure. It needs no display.

    Raises:
        TypeError: Something cannot be drawn.
        ValueError: There is nothing to draw, or a field has no surface or is in the plane.
    """
    panels = panels_of(things, before=before, titles=titles, colours=colours, resolution=resolution)
    limit = limit_of(panels)
    figure = Figure(figsize=(2.7 * len(panels) + 0.6, 2.9), layout="constrained")
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    camera = Camera(azimuth)
    flat = np.concatenate([panel.view.V for panel in panels]) @ camera.axes()[:2].T
    frame = np.stack([flat.min(axis=0), flat.max(axis=0)], axis=1)  # one for all, so that sizes can be compared
    for axes, panel in zip(row, panels, strict=True):
        paint(axes, panel.view, vertex_colours(panel, limit)[panel.view.F].mean(axis=1), camera)
        axes.set(title=panel.title, xlim=frame[0], ylim=frame[1])
        axes.title.set_fontsize(9)
    label = _label(panels)
    if label is not None:
        bar = figure.colorbar(
            ScalarMappable(Normalize(-limit[1], limit[1]), COLOURS), ax=list(row), shrink=0.8, pad=0.01
        )
        bar.ax.set_ylim(*limit)
        bar.set_label(label, fontsize=6)
        bar.ax.tick_params(labelsize=6)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _label(panels: Sequence[Panel]) -> str | None:
    """Return what the colours mean, where they mean something."""
    labels = list(dict.fromkeys(panel.label for panel in panels if panel.label is not None))
    return "; ".join(labels) or None


def _half(panels: Sequence[Panel]) -> np.ndarray:
    """Return the box of all panels together, (3, 2), a little wider."""
    every = np.concatenate([panel.view.V for panel in panels])
    lower, upper = every.min(axis=0), every.max(axis=0)
    rim = 0.02 * (upper - lower).max()
    return np.stack([lower - rim, upper + rim], axis=1)


def _scale(limit: tuple[float, float]) -> list[tuple[float, str]]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    low = 0.5 if limit[0] == 0 else 0.0
    return [(float(t), to_hex(colormaps[COLOURS](low + (1 - low) * t))) for t in np.linspace(0, 1, 17)]
