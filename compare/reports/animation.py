"""Animated pictures of a mesh on its way, such as that of an edit or of a flow: .gif, .webp or .mp4."""

from __future__ import annotations

import io
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.files import replace_file
from compare.reports.views import Camera, View, simplified_alike

Frame = tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]
SUFFIXES = (".gif", ".webp", ".mp4")
MOST_FACES = 8000  # in a frame: more cannot be told apart
MARGIN = 0.03  # round all frames, of the longer side
DPI = 100


def write_animation(
    path: str | PathLike[str],
    frames: Sequence[Frame],
    *,
    values: Sequence[Float[ndarray, " n"]] | None = None,
    frames_per_second: float = 8.0,
    hold: int = 6,
    pixels: int = 480,
    camera: Camera | None = None,
) -> Path:
    """Write meshes as an animated picture, seen from one place.

    Args:
        path: Where to; .gif, .webp, or .mp4, which needs the extra "animation".
        frames: Vertices (n, 3) and faces (m, 3) of each, as `Edit.frames` gives them, or (V, F) for each of the
            snapshots of a flow.
        values: A number a vertex for each frame, shown by colours about zero; None shows the shape alone.
        frames_per_second: Speed.
        hold: Frames for which the last one stands still.
        pixels: Width and height.
        camera: Where from; None looks from the front and a little from the side, y up.

    Returns:
        The path.

    Raises:
        ValueError: The ending is another, there are no frames, or a number makes no sense.
        ImportError: An .mp4 is asked for, and what writes it is not installed.
        meshref.MeshError: A frame is no mesh.
    """
    import meshref

    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"An animation is written to a file ending in {', '.join(SUFFIXES)}, but got {path.name!r}.")
    if not isinstance(frames, list | tuple) or not frames:
        raise ValueError("frames must be a list of (V, F), at least one, as Edit.frames gives them.")
    if not frames_per_second > 0 or pixels < 16 or hold < 0:
        raise ValueError(
            f"frames_per_second must be above 0, pixels at least 16 and hold at least 0, but are {frames_per_second}, "
            f"{pixels} and {hold}."
        )
    if values is not None and len(values) != len(frames):
        raise ValueError(f"values must be given for each of the {len(frames)} frames, but are {len(values)}.")
    meshes = [meshref.as_mesh(frame) for frame in frames]
    numbers = [np.zeros(len(V)) for V, _ in meshes] if values is None else [np.asarray(v, dtype=float) for v in values]
    views = _views(meshes, numbers)
    pictures = _painted(views, camera or Camera(30.0), pixels, coloured=values is not None)
    replace_file(path, _encoded(suffix, [*pictures, *[pictures[-1]] * hold], frames_per_second))
    return path


def _views(meshes: Sequence[Frame], numbers: Sequence[Float[ndarray, " n"]]) -> list[View]:
    views = [View(V, F, v) for (V, F), v in zip(meshes, numbers, strict=True)]
    if all(np.array_equal(view.F, views[0].F) for view in views):
        return simplified_alike(views, MOST_FACES)
    return [simplified_alike([view], MOST_FACES)[0] for view in views]


def _painted(views: Sequence[View], camera: Camera, pixels: int, *, coloured: bool) -> list[ndarray]:
    """Return the pictures, (pixels, pixels, 3) of whole numbers to 255, all with the same frame and colours."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from compare.reports.figures import ABOUT_ZERO, SURFACE, colours_of, paint
    from compare.reports.views import colour_limit

    screen = camera.axes()[:2]
    every = np.concatenate([view.V @ screen.T for view in views])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    half = (0.5 + MARGIN) * float(np.ptp(every, axis=0).max())
    limit = colour_limit(views) if coloured else 1.0
    pictures = []
    for view in views:
        shares = (view.values[view.F].mean(axis=1) / limit).clip(-1, 1) / 2 + 0.5
        colours = colours_of(ABOUT_ZERO, shares) if coloured else np.tile(SURFACE, (len(view.F), 1))
        figure = Figure(figsize=(pixels / DPI, pixels / DPI), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        paint(axes, view, colours, camera)
        axes.set_xlim(middle[0] - half, middle[0] + half)
        axes.set_ylim(middle[1] - half, middle[1] + half)
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return pictures


def _encoded(suffix: str, pictures: Sequence[ndarray], frames_per_second: float) -> bytes:
    import imageio.v3 as imageio

    if suffix == ".mp4":
        options: dict[str, Any] = {"extension": ".mp4", "fps": frames_per_second, "plugin": _film_writer()}
        even = [picture[: len(picture) // 2 * 2, : picture.shape[1] // 2 * 2] for picture in pictures]  # as H.264 wants
        return bytes(imageio.imwrite("<bytes>", np.stack(even), **options))
    file = io.BytesIO()
    options = {"duration": round(1000 / frames_per_second), "loop": 0}
    imageio.imwrite(file, np.stack(pictures), extension=suffix, plugin="pillow", **options)
    return file.getvalue()


def _film_writer() -> str:
    from importlib.util import find_spec

    if find_spec("imageio_ffmpeg") is None:
        raise ImportError('an .mp4 needs imageio-ffmpeg, which is not installed: pip install ".[animation]"')
    return "FFMPEG"
