"""Animated pictures have a frame for each mesh, seen from one place; models in 3D have the colours of their error."""

import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence

import implicit
import meshref
from compare import write_animation
from compare.reports.figures import write_models

V, F = meshref.icosphere(2)


def pictures_of(path):
    with Image.open(path) as file:
        return np.stack([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(file)]).astype(int)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_a_growing_ball_fills_more_of_each_frame(tmp_path, suffix):
    """Of radii 1, 2 and 4: the disk covers 1/16, 1/4 and all of what it covers at last."""
    frames = [(radius * V, F) for radius in (1.0, 2.0, 4.0)]
    path = write_animation(tmp_path / f"ball{suffix}", frames, pixels=120, hold=0)
    pictures = pictures_of(path)
    assert pictures.shape == (3, 120, 120, 3)
    covered = (pictures.min(axis=3) < 230).sum(axis=(1, 2))
    assert covered[:2] / covered[2] == pytest.approx([1 / 16, 1 / 4], abs=0.03)


def test_the_last_frame_stands_still_and_values_have_colours(tmp_path):
    path = write_animation(tmp_path / "a.gif", [(V, F)] * 2, values=[V[:, 0], -V[:, 0]], pixels=80, hold=3)
    pictures = pictures_of(path)
    left, right = pictures[:, :, :40].mean(axis=(1, 2)), pictures[:, :, 40:].mean(axis=(1, 2))
    assert left[0, 0] < left[0, 2]  # blue: from 30 degrees aside, x is to the right
    assert right[0, 0] > right[0, 2]
    assert left[-1, 0] > left[-1, 2]


def test_what_is_no_animation_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"ending in \.gif, \.webp, \.mp4"):
        write_animation(tmp_path / "a.avi", [(V, F)])
    with pytest.raises(ValueError, match="at least one"):
        write_animation(tmp_path / "a.gif", [])
    with pytest.raises(ValueError, match="for each of the 2 frames"):
        write_animation(tmp_path / "a.gif", [(V, F)] * 2, values=[V[:, 0]])
    with pytest.raises(meshref.MeshError, match="is a int"):
        write_animation(tmp_path / "a.gif", [3])
    assert list(tmp_path.iterdir()) == []


def test_frames_of_an_edit_are_the_mesh_given_and_it_after_each_step():
    """A sphere that flows by its mean curvature stays one, and shrinks."""
    field = implicit.shapes.sphere(0.5)
    start, faces = implicit.extract_mesh(field, 16)
    edit = implicit.smooth(
        field, steps=2, step_size=1e-3, points=60, resolution=16, track=torch.from_numpy(start).to(field.theta)
    )
    frames = edit.frames(start, faces)
    assert len(frames) == 3
    radii = [np.linalg.norm(points, axis=1) for points, _ in frames]
    assert radii[0].mean() > radii[1].mean() > radii[2].mean()
    assert max(np.ptp(radius) for radius in radii[1:]) < 1e-3
    assert all(found is faces for _, found in frames)
    scaled = implicit.Field(field.module, bounds=((-1,) * 3, (1,) * 3), units=implicit.Units(10.0, (1.0, 0.0, 0.0)))
    in_user = implicit.smooth(
        scaled, steps=2, step_size=1e-3, points=60, resolution=16, track=torch.from_numpy(start).to(field.theta)
    )
    (first, _), *_ = in_user.frames(start, faces, units="user")
    np.testing.assert_allclose(first, 10 * start + [1.0, 0.0, 0.0], atol=1e-5)
    with pytest.raises(ValueError, match="carried no points along"):
        implicit.smooth(field, steps=1, step_size=1e-3, points=60, resolution=16).frames(start, faces)
    with pytest.raises(ValueError, match="must be the points that were given as track"):
        edit.frames(start[:5], faces)
    assert len(repr(edit)) < 300
    assert repr(edit).startswith("Edit('All steps were taken.' 2 steps, 60 points") or "2 steps" in repr(edit)


def test_models_have_the_colours_of_their_error(small_run, tmp_path):
    record = next(r for r in small_run.records if r.case.operation == "geometric")
    written = write_models([record], small_run.folder, tmp_path)
    assert len(written) == len(record.sides)
    import trimesh

    exact = trimesh.load(next(path for path in written if path.stem.endswith("-mesh")), force="mesh", process=False)
    colours = np.unique(exact.visual.vertex_colors, axis=0)
    assert len(colours) == 1  # of no error, everywhere
    assert np.ptp(colours[0, :3].astype(int)) < 5  # grey
    neural = trimesh.load(next(path for path in written if path.stem.endswith("-implicit")), force="mesh")
    assert len(np.unique(neural.visual.vertex_colors, axis=0)) > 5
