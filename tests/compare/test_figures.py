"""The painter draws what faces the camera, the near over the far, and the pictures hold it."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

import meshref
from compare.figures import Camera, draw_figures, paint
from compare.views import View

RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def painted(V, F, colours, azimuth):
    """The picture as numbers, and how many pixels are mostly red and mostly blue."""
    figure = Figure(figsize=(2, 2))
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    paint(axes, View(V, F, np.zeros(len(V))), colours, Camera(azimuth, 0.0))
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(float)
    red = (pixels[..., 0] > 80) & (pixels[..., 2] < 40)
    blue = (pixels[..., 2] > 80) & (pixels[..., 0] < 40)
    return red.sum(), blue.sum()


@pytest.mark.parametrize(("azimuth", "front"), [(0, "red"), (180, "blue"), (90, "both")])
def test_only_the_side_that_faces_the_camera_is_seen(azimuth, front):
    """A sphere, red towards +z and blue towards -z; at azimuth 0 one looks along -z."""
    V, F = meshref.icosphere(3)
    colours = np.where(V[F].mean(axis=1)[:, 2:] > 0, RED, BLUE)
    red, blue = painted(V, F, colours, azimuth)
    expected = {"red": red > 50 * max(blue, 1), "blue": blue > 50 * max(red, 1), "both": 0.7 * blue < red < 1.4 * blue}
    assert expected[front]


def test_the_near_body_covers_the_far_one():
    V, F = meshref.icosphere(2)
    both = np.vstack([V + np.array([0, 0, 3]), V]), np.vstack([F, F + len(V)])
    colours = np.vstack([np.tile(RED, (len(F), 1)), np.tile(BLUE, (len(F), 1))])
    assert painted(*both, colours, 0)[1] == 0
    assert painted(*both, colours, 180)[0] == 0


def test_a_picture_is_written_for_each_shape_and_format(small_run, tmp_path):
    written = draw_figures(small_run.records, small_run.folder, output=tmp_path, formats=("png", "pdf"))
    assert [path.name for path in written] == ["bulb.png", "bulb.pdf"]
    picture = imread(written[0])
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 500
    assert written[1].read_bytes().startswith(b"%PDF")
