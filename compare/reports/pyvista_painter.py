"""Still pictures by VTK through pyvista, off the screen: smooth shading and clean outlines.

A picture is drawn into the same axes, in the same coordinates, as by the painter of compare.reports.figures, so that
arrows and frames fit both. VTK needs OpenGL. On Linux it comes through EGL, with or without a graphics card; where EGL
or its driver is missing, VTK ends the whole process instead of raising, so it is tried in a process of its own first.
"""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy import ndarray

from compare.reports.views import View

if TYPE_CHECKING:
    from compare.reports.views import Camera

PIXELS = 1200  # along the longer side of a picture, before it is placed on the page
MARGIN = 0.03  # round the shape, of its longer side
SECONDS = 120.0  # for the trial; it takes three on an idle core

# VTK reads this when it is first imported. Without it, it would look for an X server first and say that there is none.
WINDOW = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"} if sys.platform == "linux" else {}

TRIAL = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))
plotter.add_mesh(pyvista.Sphere())
assert plotter.screenshot(return_img=True).std() > 0
"""


@cache
def pyvista_trouble() -> str | None:
    """Return why pyvista cannot draw here, in a sentence that says what to do, or None if it can."""
    if find_spec("pyvista") is None:
        return 'pyvista is not installed: pip install ".[figures]".'
    if sys.platform == "linux":
        try:
            ctypes.CDLL("libEGL.so.1")
        except OSError:
            return "there is no libEGL.so.1, by which VTK draws: on Debian, apt install libegl1 libgl1-mesa-dri."
    try:
        trial = subprocess.run(
            [sys.executable, "-c", TRIAL],
            capture_output=True,
            text=True,
            timeout=SECONDS,
            env={**os.environ, **WINDOW},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"a trial picture by pyvista was not done after {SECONDS:.0f} s."
    if trial.returncode:
        said = re.sub(r"\x1b\[[0-9;]*m", "", (trial.stderr.strip().splitlines() or ["it said nothing"])[-1])
        return (
            f"a trial picture by pyvista ended with exit code {trial.returncode} ({said}). Is a driver for OpenGL "
            "installed? On Debian: apt install libgl1-mesa-dri."
        )
    return None


def paint_with_pyvista(axes: Axes, view: View, colours: Float[ndarray, "m 3"], camera: Camera) -> None:
    """Draw a closed mesh with a colour for each face, blended at the vertices; for compare.reports.figures.paint.

    Raises:
        ImportError: pyvista is not installed; see pyvista_trouble.
    """
    os.environ.update(WINDOW)
    import pyvista

    right, up, back = camera.axes()
    flat = view.V @ np.stack([right, up]).T
    lower, upper = flat.min(axis=0), flat.max(axis=0)
    room = MARGIN * (upper - lower).max()
    lower, upper = lower - room, upper + room
    width, height = upper - lower
    size = np.maximum(np.round(PIXELS * (upper - lower) / max(width, height)), 16).astype(int)

    mesh = pyvista.PolyData.from_regular_faces(view.V, view.F)
    mesh.cell_data["colours"] = colours
    mesh = mesh.cell_data_to_point_data()
    mesh.point_data["colours"] = np.round(255 * np.clip(mesh.point_data["colours"], 0, 1)).astype(np.uint8)
    plotter = pyvista.Plotter(off_screen=True, window_size=size.tolist(), lighting="none")
    try:
        plotter.add_mesh(
            mesh, scalars="colours", rgb=True, smooth_shading=True, ambient=0.35, diffuse=0.7, specular=0.05
        )
        middle = lower + np.array([width, height]) / 2
        target = middle[0] * right + middle[1] * up + (view.V @ back).mean() * back
        light = back + 0.5 * up - 0.4 * right
        plotter.add_light(pyvista.Light(position=target + 10 * max(width, height) * light, focal_point=target))
        plotter.camera.focal_point = target
        plotter.camera.position = target + 10 * max(width, height) * back
        plotter.camera.up = up
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = height / 2
        plotter.renderer.reset_camera_clipping_range()
        plotter.enable_anti_aliasing("ssaa")
        picture = plotter.screenshot(transparent_background=True, return_img=True)
    finally:
        plotter.close()
    assert picture is not None  # as asked for by return_img
    axes.imshow(picture, extent=(lower[0], upper[0], lower[1], upper[1]), interpolation="antialiased")
    axes.set_aspect("equal")
    axes.set_axis_off()
