"""Draw the moving picture of the first page, docs/drag.gif: python docs/site/draw_drag.py

A cow's head is dragged while its feet are held: a rigid edit of the bundled network. Each frame is the surface after a
step, the vertices of one mesh as the edit carries them.
"""

import io
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image

import implicit
from compare.reports.figures import HELD, MOVED, SURFACE, paint
from compare.reports.views import Camera, View
from implicit import Ball, HalfSpace, Handle, shapes

TARGET = Path(__file__).resolve().parent.parent / "drag.gif"
STEPS, POINTS = 8, 1000
DRAG = np.array([0.0, 0.2, -0.22])
CAMERA = Camera(60.0, 12.0)
FRAME = (-1.05, 1.0), (-0.86, 1.12)


def main() -> None:
    """Edit, paint each step, and write the frames there and back."""
    field = shapes.bundled("spot")
    V, F = implicit.extract_mesh(field, 72)
    top = V[V[:, 1] > 0.4 * V[:, 1].max()].mean(axis=0)  # the middle of the head
    feet = HalfSpace((0.0, float(V[:, 1].min()) + 0.2, 0.0), (0, -1, 0))
    grasped = Ball(tuple(top), 0.42)
    handles = [Handle(feet, (0.0, 0.0, 0.0)), Handle(grasped, tuple(DRAG))]
    track = torch.from_numpy(V)
    edit = implicit.rigid_edit(field, handles, method="linear", steps=STEPS, points=POINTS, track=track)
    print(edit.status.value, *edit.notes)
    colours = np.tile(SURFACE, (len(V), 1))
    colours[feet(track).numpy() > 0] = HELD
    colours[grasped(track).numpy() > 0] = MOVED
    frames = [V, *(places.numpy() for places in edit.trail)]
    images = [_image(frame, F, colours, top, top + DRAG * k / STEPS) for k, frame in enumerate(frames)]
    there_and_back = [*images, *images[-2:0:-1]]
    seconds = [700, *[90] * (STEPS - 1), 900, *[60] * (STEPS - 1)]
    palette = images[-1].quantize(96)
    quantized = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in there_and_back]
    quantized[0].save(TARGET, save_all=True, append_images=quantized[1:], duration=seconds, loop=0, optimize=True)
    print(TARGET, TARGET.stat().st_size, "bytes")


def _image(V: np.ndarray, F: np.ndarray, colours: np.ndarray, start: np.ndarray, end: np.ndarray) -> Image.Image:
    figure = Figure(figsize=(3.9, 3.7))
    axes = figure.add_axes((0, 0, 1, 1))
    paint(axes, View(V, F, np.zeros(len(V))), colours[F].mean(axis=1), CAMERA)
    axes.set(xlim=FRAME[0], ylim=FRAME[1])
    screen = CAMERA.axes()[:2]
    if np.any(end != start):
        axes.annotate("", screen @ end, screen @ start, arrowprops={"arrowstyle": "-|>", "lw": 1.6}, zorder=5)
    content = io.BytesIO()
    figure.savefig(content, dpi=110)
    return Image.open(content).convert("RGB")


if __name__ == "__main__":
    main()
