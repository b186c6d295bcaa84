"""Still pictures of a run, by pyvista where it can draw, otherwise by shaded triangles painted from the back.

A picture has a row for each operation and the columns before, neural field, mesh. Before shows the handles; the two
results show the error, on one colour range that they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, Normalize, to_hex, to_rgb
from matplotlib.figure import Figure
from numpy import ndarray

from compare.cases.handles import HandleSpec
from compare.operations.operation import operation_of
from compare.reports.arrows import arrows_of, with_handles_in_field
from compare.reports.azimuth import azimuth_of
from compare.reports.pyvista_painter import paint_with_pyvista, pyvista_trouble
from compare.reports.views import (
    PANES,
    Camera,
    ColourRange,
    View,
    colour_range,
    load_views,
    simplified,
    up_of,
)
from compare.runs.columns import column_of, error_label, number, text
from compare.runs.records import Record

Painter = Literal["auto", "pyvista", "matplotlib"]

# Moreland's map, made for shaded surfaces: diverging about zero, even in lightness on both sides.
COLOURS = "coolwarm"
Colours = tuple[float, float]  # the part of the map that a range has, from its low end to its high one
ABOUT_ZERO: Colours = (0.0, 1.0)
FROM_ZERO: Colours = (0.5, 1.0)  # zero is the same grey in both
ARROW = {"arrowstyle": "->", "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
SURFACE, HELD, MOVED = to_rgb("#c9ccd1"), to_rgb("#4c72b0"), to_rgb("#dd8452")


def draw_figures(
    records: Sequence[Record],
    folder: str | PathLike[str],
    *,
    output: str | PathLike[str] | None = None,
    formats: Sequence[str] = ("png", "pdf"),
    camera: Camera | None = None,
    painter: Painter = "auto",
) -> list[Path]:
    """Paint a picture for each shape.

    Args:
        records: Of a run; failed ones are left out.
        folder: The run folder, where their meshes are.
        output: Where the pictures go; None is `figures` in the run folder.
        formats: What matplotlib can write: png, pdf, svg.
        camera: Where from; None looks to where most of what moves is seen.
        painter: "pyvista", "matplotlib", or "auto", which is pyvista where it can draw.

    Returns:
        The files written.

    Raises:
        FileNotFoundError: A mesh that a record names is gone.
        ValueError: The painter is "pyvista", but it cannot draw here.
    """
    painter, _ = usable_painter(painter)
    folder = Path(folder)
    target = folder / "figures" if output is None else Path(output)
    by_shape: dict[str, list[Record]] = {}
    for record in (with_handles_in_field(record) for record in records):
        if {"before", "implicit", "mesh"} <= set(record.artefacts):
            by_shape.setdefault(record.case.name, []).append(record)
    written = []
    for name, group in by_shape.items():
        figure = picture(group, folder, camera=camera, painter=painter)
        target.mkdir(parents=True, exist_ok=True)
        for suffix in formats:
            path = target / f"{name}.{suffix}"
            figure.savefig(path, dpi=150)
            written.append(path)
    return written


def write_models(records: Sequence[Record], folder: str | PathLike[str], output: str | PathLike[str]) -> list[Path]:
    """Write the result of each method as a .glb whose vertices have the colours of the error, for any viewer.

    Args:
        records: Of a run; failed ones are left out.
        folder: The run folder, where their meshes are.
        output: The folder where they go.

    Returns:
        The files written.

    Raises:
        FileNotFoundError: A mesh that a record names is gone.
    """
    import meshref

    written = []
    for record in records:
        views = load_views(record, Path(folder))
        colours = colour_range(record, [view for name, view in views.items() if name != "before"])
        for name, view in views.items():
            if name == "before":
                continue
            shown = _map_of(colours)(Normalize(colours.low, colours.limit)(np.nan_to_num(view.values)))[:, :3]
            path = Path(output) / f"{Path(record.artefacts[name].path).stem}.glb"
            path.parent.mkdir(parents=True, exist_ok=True)
            meshref.write_mesh(path, view.V, view.F, colours=shown)
            written.append(path)
    return written


def usable_painter(chosen: Painter) -> tuple[Literal["pyvista", "matplotlib"], str | None]:
    """Return the painter to take, and why it is not pyvista where that was left open.

    Raises:
        ValueError: It is to be pyvista, but that cannot draw here.
    """
    if chosen == "matplotlib":
        return chosen, None
    trouble = pyvista_trouble()
    if trouble is None:
        return "pyvista", None
    if chosen == "pyvista":
        raise ValueError(f"pyvista cannot draw here: {trouble} Or take --painter matplotlib, which needs nothing more.")
    return "matplotlib", trouble


def picture(
    records: Sequence[Record],
    folder: Path,
    *,
    camera: Camera | None = None,
    painter: Literal["pyvista", "matplotlib"] = "matplotlib",
) -> Figure:
    """Return the rows of before, neural field and mesh, a record each."""
    draw = paint_with_pyvista if painter == "pyvista" else paint
    up = up_of(records[0].case.shape)
    camera = camera or Camera(azimuth_of(records, folder, up), up=up)
    figure = Figure(figsize=(8.6, 2.75 * len(records)), layout="constrained")
    grid = figure.subplots(len(records), 3, squeeze=False)
    for row, record in zip(grid, records, strict=True):
        views = {name: view for name, view in load_views(record, folder).items() if name in PANES}
        colours = colour_range(record, [views["implicit"], views["mesh"]])
        for axes, (name, view) in zip(row, views.items(), strict=True):
            if name == "before":
                draw(axes, view, _handle_colours(view, record.case.handles), camera)
                _draw_motion(axes, view, record, camera)
                title = f"{record.case.name}, {record.case.operation}"
            else:
                view = simplified(view, 20_000)
                draw(axes, view, _error_colours(view, colours), camera)
                title = f"{PANES[name]}: {_headline(record, name)}"
            axes.set_title(title, fontsize=8)
        same_frame(row)
        shown = ScalarMappable(Normalize(colours.low, colours.limit), _map_of(colours))
        bar = figure.colorbar(shown, ax=list(row[1:]), shrink=0.8, pad=0.01)
        bar.set_label(_wrapped(error_label(record)), fontsize=6)
        bar.ax.tick_params(labelsize=6)
    return figure


def paint(axes: Axes, view: View, colours: Float[ndarray, "m 3"], camera: Camera) -> None:
    """Draw a closed mesh with a colour for each face: those that look away are left out, the far ones come first."""
    right, up, back = camera.axes()
    corners = view.V[view.F]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    seen = np.flatnonzero(normals @ back > 0)
    order = seen[np.argsort((corners[seen] @ back).mean(axis=1))]
    light = back + 0.5 * up - 0.4 * right
    shade = 0.45 + 0.55 * np.clip(normals[order] @ (light / np.linalg.norm(light)), 0, 1)
    flat = np.stack([corners[order] @ right, corners[order] @ up], axis=-1)
    painted = np.clip(colours[order] * shade[:, None], 0, 1)
    # Edges in the colour of their face close the hairlines between neighbours.
    axes.add_collection(
        PolyCollection(list(flat), facecolors=painted, edgecolors=painted, linewidths=0.3, rasterized=True)
    )
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_axis_off()


def _handle_colours(view: View, handles: Sequence[HandleSpec]) -> Float[ndarray, "m 3"]:
    palette = np.array([SURFACE, *(HELD if h.holds else MOVED for h in handles)])
    return palette[view.values.astype(int)][view.F].mean(axis=1)


def _error_colours(view: View, colours: ColourRange) -> Float[ndarray, "m 3"]:
    values = np.nan_to_num(view.values[view.F].mean(axis=1))
    return _map_of(colours)(Normalize(colours.low, colours.limit)(values))[:, :3]


def _map_of(colours: ColourRange) -> ListedColormap:
    return ListedColormap(colours_of(FROM_ZERO if colours.one_sided else ABOUT_ZERO, np.linspace(0, 1, 257)))


def colours_of(part: Colours, shares: Float[ndarray, " n"]) -> Float[ndarray, "n 3"]:
    """Return the colours (red, green, blue from 0 to 1) at shares of a range, 0 its low end and 1 its high one."""
    return colormaps[COLOURS](part[0] + (part[1] - part[0]) * shares)[:, :3]


def css_gradient(part: Colours) -> str:
    """Return a range of colours as the background of an element of a page."""
    stops = colours_of(part, np.linspace(0, 1, 17))
    return f"linear-gradient(to right, {', '.join(to_hex(tuple(colour)) for colour in stops)})"


def _draw_motion(axes: Axes, view: View, record: Record, camera: Camera) -> None:
    """Draw an arrow for each handle that moves, unless it points too much at the viewer to be seen."""
    screen = camera.axes()[:2]
    size = np.ptp(view.V @ screen.T, axis=0).max()
    for ends in arrows_of(record, view):
        (x, y), (a, b) = ((screen @ end).tolist() for end in ends)
        if np.hypot(a - x, b - y) > 0.02 * size:
            axes.annotate("", (a, b), (x, y), arrowprops=ARROW, zorder=5)


def _headline(record: Record, side: str) -> str:
    headline = operation_of(record.case.operation).headline
    column = column_of(headline.column)
    assert column is not None  # or the operation names a number that no table has
    return headline.words.format(text(number(record.sides[side], column), column))


def same_frame(row: Sequence[Axes]) -> None:
    """Give one extent to all panels of a row, so that sizes can be compared."""
    x, y = (np.array([read(axes) for axes in row]) for read in (Axes.get_xlim, Axes.get_ylim))
    for axes in row:
        axes.set_xlim(x.min(), x.max())
        axes.set_ylim(y.min(), y.max())


def _wrapped(sentence: str) -> str:
    words, lines = sentence.split(), [""]
    for word in words:
        if len(lines[-1]) + len(word) > 34:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n".join(lines)
