"""Both painters draw what faces the camera, the near over the far, at the same place; and the pictures hold it."""

import os

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from skimage.color import deltaE_ciede2000, rgb2lab

import meshref
from compare.reports import pyvista_painter
from compare.reports.figures import COLOURS, draw_figures, paint, picture, usable_painter
from compare.reports.pyvista_painter import paint_with_pyvista, pyvista_trouble
from compare.reports.views import Camera, View

RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
PAINTERS = {"matplotlib": paint, "pyvista": paint_with_pyvista}


@pytest.fixture(params=list(PAINTERS))
def painter(request):
    if request.param == "pyvista" and (trouble := pyvista_trouble()) is not None:
        pytest.skip(trouble)
    return PAINTERS[request.param]


def drawn(painter, V, F, colours, azimuth, frame=None):
    """A picture of 200 x 200 pixels as numbers."""
    figure = Figure(figsize=(2, 2))
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    painter(axes, View(V, F, np.zeros(len(V))), colours, Camera(azimuth, 0.0))
    if frame is not None:
        axes.set_xlim(-frame, frame)
        axes.set_ylim(-frame, frame)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(float)


def red_and_blue(pixels):
    red = (pixels[..., 0] > 80) & (pixels[..., 2] < 40)
    blue = (pixels[..., 2] > 80) & (pixels[..., 0] < 40)
    return red.sum(), blue.sum()


@pytest.mark.parametrize(("azimuth", "front"), [(0, "red"), (180, "blue"), (90, "both")])
def test_only_the_side_that_faces_the_camera_is_seen(painter, azimuth, front):
    """A sphere, red towards +z and blue towards -z; at azimuth 0 one looks along -z."""
    V, F = meshref.icosphere(3)
    colours = np.where(V[F].mean(axis=1)[:, 2:] > 0, RED, BLUE)
    red, blue = red_and_blue(drawn(painter, V, F, colours, azimuth))
    expected = {"red": red > 50 * max(blue, 1), "blue": blue > 50 * max(red, 1), "both": 0.7 * blue < red < 1.4 * blue}
    assert expected[front]


def test_the_near_body_covers_the_far_one(painter):
    V, F = meshref.icosphere(2)
    both = np.vstack([V + np.array([0, 0, 3]), V]), np.vstack([F, F + len(V)])
    colours = np.vstack([np.tile(RED, (len(F), 1)), np.tile(BLUE, (len(F), 1))])
    assert red_and_blue(drawn(painter, *both, colours, 0))[1] == 0
    assert red_and_blue(drawn(painter, *both, colours, 180))[0] == 0


def test_a_shape_stands_where_it_is_and_the_right_way_up(painter):
    """A ball at (1, 2, 0) in a frame from -4 to 4: its disk is right of and above the middle, of radius 25 pixels."""
    V, F = meshref.icosphere(4)
    pixels = drawn(painter, V + np.array([1.0, 2.0, 0.0]), F, np.tile(BLUE, (len(F), 1)), 0, frame=4.0)
    rows, columns = np.nonzero(pixels[..., 0] < 128)
    assert columns.mean() == pytest.approx(100 + 25, abs=1)
    assert rows.mean() == pytest.approx(100 - 50, abs=1)
    assert np.sqrt(len(rows) / np.pi) == pytest.approx(25, abs=1)


@pytest.mark.nightly
@pytest.mark.parametrize("painter_name", list(PAINTERS))
def test_a_picture_is_written_for_each_shape_and_format(small_run, tmp_path, painter_name):
    if painter_name == "pyvista" and (trouble := pyvista_trouble()) is not None:
        pytest.skip(trouble)
    formats = ("png", "pdf")
    written = draw_figures(small_run.records, small_run.folder, output=tmp_path, formats=formats, painter=painter_name)
    assert [path.name for path in written] == ["bulb.png", "bulb.pdf"]
    pixels = imread(written[0])
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 500
    assert written[1].read_bytes().startswith(b"%PDF")


def test_colour_bars_are_about_zero_or_of_a_strain_from_it_and_have_their_unit(small_run):
    figure = picture(small_run.records, small_run.folder)
    bars = [axes for axes in figure.axes if axes.get_ylabel()]
    assert len(bars) == len(small_run.records)
    for bar, record in zip(bars, small_run.records, strict=True):
        low, high = bar.get_ylim()
        assert low == (0 if record.case.operation == "rigid" else -high)
        assert high > 0
        unit = "a pure number" if record.case.operation == "rigid" else "in the shape's unit of length"
        assert " ".join(bar.get_ylabel().split()).endswith(unit)


def test_the_colour_map_is_as_light_at_both_ends_and_lightest_at_zero_without_jumps():
    """In CIELAB: lightness rises to the middle and falls from it alike; no step between neighbours stands out."""
    lab = rgb2lab(colormaps[COLOURS](np.linspace(0, 1, 101))[None, :, :3])[0]
    lightness = lab[:, 0]
    assert np.argmax(lightness) == pytest.approx(50, abs=3)
    assert (np.diff(lightness[:48]) > 0).all()
    assert (np.diff(lightness[53:]) < 0).all()
    assert lightness[0] == pytest.approx(lightness[-1], abs=3)
    steps = deltaE_ciede2000(lab[1:], lab[:-1])
    assert steps.max() < 2 * np.median(steps)


# The probe. Each test asks anew, for the answer is kept.


@pytest.fixture
def ask_anew():
    pyvista_trouble.cache_clear()
    yield
    pyvista_trouble.cache_clear()


@pytest.fixture
def dying_pyvista(tmp_path, monkeypatch):
    """A package of that name that ends the process that draws with it, as VTK does without a driver."""
    (tmp_path / "pyvista.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))


@pytest.mark.usefixtures("ask_anew")
def test_without_pyvista_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(pyvista_painter, "find_spec", lambda name: None)
    assert usable_painter("auto") == (
        "matplotlib",
        'pyvista is not installed: pip install ".[figures]".',
    )
    with pytest.raises(ValueError, match=r"pyvista cannot draw here: pyvista is not installed.*--painter matplotlib"):
        usable_painter("pyvista")


@pytest.mark.usefixtures("ask_anew", "dying_pyvista")
def test_without_egl_vtk_is_never_touched(monkeypatch):
    """Where it is, it would end the process: so neither this one nor another may import it."""

    def missing(name):
        raise OSError(f"{name}: cannot open shared object file")

    def forbidden(*args, **options):
        raise AssertionError("VTK was tried")

    monkeypatch.setattr(pyvista_painter.sys, "platform", "linux")
    monkeypatch.setattr(pyvista_painter.ctypes, "CDLL", missing)
    monkeypatch.setattr(pyvista_painter.subprocess, "run", forbidden)
    painter, reason = usable_painter("auto")
    assert painter == "matplotlib"
    assert "no libEGL.so.1" in reason
    assert "apt install" in reason


@pytest.mark.usefixtures("ask_anew", "dying_pyvista")
def test_a_driver_that_ends_the_process_ends_only_the_trial(monkeypatch):
    monkeypatch.setattr(pyvista_painter.ctypes, "CDLL", lambda name: None)
    painter, reason = usable_painter("auto")
    assert painter == "matplotlib"
    assert "exit code -11" in reason


@pytest.mark.usefixtures("dying_pyvista")
def test_the_command_refuses_a_painter_that_cannot_draw_and_writes_nothing(command, small_run, tmp_path):
    result = command("figures", small_run.folder, "-o", "pictures", "--painter", "pyvista", cwd=tmp_path)
    assert result.returncode == 2
    assert "pyvista cannot draw here" in result.stderr
    assert not (tmp_path / "pictures").exists()
