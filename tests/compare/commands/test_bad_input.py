"""Every input that cannot be used ends in one clear sentence and exit code 2, with nothing written or written over.

Input that can be mended goes on, and what was mended is said first.
"""

from pathlib import Path

import numpy as np
import pytest

import implicit
import meshref
from implicit import shapes


def files_under(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(result):
    """The one sentence of a refusal."""
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("implicit-vs-mesh: ")
    assert line.endswith((".", "?"))
    return line


def sphere():
    return meshref.icosphere(2)


def write_off(path, V, F):
    """As any program might write it, right or wrong."""
    lines = ["OFF", f"{len(V)} {len(F)} 0", *(" ".join(map(repr, map(float, v))) for v in V)]
    path.write_text("\n".join([*lines, *("3 " + " ".join(map(str, f)) for f in F)]) + "\n")


def with_nan(path):
    V, F = sphere()
    V[7, 1] = np.nan
    write_off(path, V, F)


def with_wrong_index(path):
    V, F = sphere()
    F[3, 2] = len(V)
    write_off(path, V, F)


def with_two_bodies(path):
    V, F = sphere()
    write_off(path, np.vstack([V, V + 5]), np.vstack([F, F + len(V)]))


def with_a_long_hole(path):
    V, F = sphere()
    F = F[(V[F][:, :, 2] < 0.15).all(axis=1)]
    used = np.unique(F)
    write_off(path, V[used], np.searchsorted(used, F))


def with_a_point_cloud(path):
    write_off(path, sphere()[0], [])


def empty(path):
    path.write_bytes(b"")


def with_text(path):
    path.write_text("Dear all,\nplease find the mesh attached.\n")


BROKEN = {
    "empty file": ("a.obj", empty, "is empty"),
    "text named .obj": ("a.obj", with_text, "a.obj"),
    "text named .off": ("a.off", with_text, "must begin with the word OFF"),
    "text named .ply": ("a.ply", with_text, "must begin with the word ply"),
    "text named .stl": ("a.stl", with_text, "fits neither text nor binary"),
    "text named .safetensors": ("a.safetensors", with_text, "a.safetensors"),
    "NaN coordinates": ("a.off", with_nan, "must be finite"),
    "index out of range": ("a.off", with_wrong_index, "vertex 162"),
    "two bodies": ("a.off", with_two_bodies, "Take the largest with --bodies largest"),
    "a long hole": ("a.off", with_a_long_hole, "Raise --hole-limit"),
    "no faces": ("a.off", with_a_point_cloud, "0 faces"),
}


@pytest.mark.parametrize("case", BROKEN, ids=list(BROKEN))
def test_a_broken_file_is_refused(command, case, tmp_path):
    name, write, message = BROKEN[case]
    write(tmp_path / name)
    before = files_under(tmp_path)
    assert message in refused(command("run", name, "-o", "out", cwd=tmp_path))
    assert files_under(tmp_path) == before
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone.obj"], "There is no file gone.obj"),
        (["spto"], "Did you mean spot?"),
        (["shape.x3d"], "ending in .obj, .off, .ply, .stl, .glb, .gltf, .3mf, .dae or .safetensors"),
        (["spot", "spot"], "spot is named twice"),
        (["spot", "gone.obj"], "There is no file gone.obj"),
    ],
)
def test_a_shape_that_is_not_there_is_refused(command, arguments, message, tmp_path):
    assert message in refused(command("run", *arguments, "-o", "out", cwd=tmp_path))
    assert files_under(tmp_path) == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "spot", "--operations", "-o", "out"], "--operations names nothing. Name one or more of geometric,"),
        (["figures", "run", "--formats", "-o", "out"], "--formats names nothing. Name one or more of png, pdf, svg"),
        (["study", "points", "--shapes", "-o", "out"], "--shapes names nothing. Name one or more after it"),
    ],
)
def test_an_option_that_names_nothing_is_refused(command, arguments, message, tmp_path):
    assert message in refused(command(*arguments, cwd=tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_an_output_folder_that_holds_a_run_is_refused(command, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "results.jsonl").write_text('{"precious": 1}\n')
    before = files_under(tmp_path)
    assert "already holds a run" in refused(command("run", "spot", "-o", "out", cwd=tmp_path))
    assert files_under(tmp_path) == before


def test_an_output_that_is_a_file_or_a_folder_of_other_things_is_refused(command, tmp_path):
    (tmp_path / "file").write_text("precious")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "letter.txt").write_text("precious")
    before = files_under(tmp_path)
    assert "is a file" in refused(command("run", "spot", "-o", "file", cwd=tmp_path))
    assert "is not empty" in refused(command("run", "spot", "-o", "folder", cwd=tmp_path))
    assert "not a folder" in refused(command("run", "spot", "-o", "file/run", cwd=tmp_path))
    assert files_under(tmp_path) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fit", "ball.off", "-o", "field.txt"], "ending in .safetensors"),
        (["fit", "ball.off", "-o", "old.safetensors"], "is not written over"),
        (["fit", "gone.off", "-o", "new.safetensors"], "There is no file gone.off"),
        (["fit", "field.txt", "-o", "new.safetensors"], "A mesh is a file ending in"),
        (["report", "gone"], "There is no"),
        (["figures", "gone"], "There is no"),
    ],
)
def test_other_commands_refuse_as_clearly(command, arguments, message, tmp_path):
    write_off(tmp_path / "ball.off", *sphere())
    (tmp_path / "old.safetensors").write_text("precious")
    (tmp_path / "field.txt").write_text("words")
    before = files_under(tmp_path)
    assert message in refused(command(*arguments, cwd=tmp_path))
    assert files_under(tmp_path) == before


def test_an_unknown_option_is_refused_with_code_2(command, tmp_path):
    result = command("run", "spot", "--qick", cwd=tmp_path)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert files_under(tmp_path) == {}


def with_a_hole(path: Path):
    V, F = sphere()
    write_off(path, V, F[5:])


def turned_inwards(path: Path):
    V, F = sphere()
    write_off(path, V, F[:, ::-1])


def with_a_loose_vertex(path: Path):
    V, F = sphere()
    write_off(path, np.vstack([V, [[3.0, 3.0, 3.0]]]), F)


MENDED = {
    "hole": (with_a_hole, "hole"),
    "inwards": (turned_inwards, "looked the wrong way"),
    "unreferenced vertex": (with_a_loose_vertex, "unreferenced"),
}


@pytest.mark.parametrize("case", MENDED, ids=list(MENDED))
def test_what_can_be_mended_is_mended_and_said(case, tmp_path):
    """The check alone: the same that run and fit make before any work."""
    from compare.runs.subject import check_shape, load_mesh

    write, word = MENDED[case]
    write(tmp_path / "ball.off")
    sentences = check_shape(str(tmp_path / "ball.off"))
    assert any(word in sentence for sentence in sentences)
    V, F, _ = load_mesh(str(tmp_path / "ball.off"))
    assert meshref.volume(V, F) > 0
    assert np.abs(V).max() <= 1


def test_the_options_that_refusals_name_are_taken(tmp_path):
    from compare.errors import InputError
    from compare.fitting.mending import Mending
    from compare.runs.subject import check_shape, load_mesh

    path = str(tmp_path / "a.off")
    with_two_bodies(tmp_path / "a.off")
    with pytest.raises(InputError, match="--bodies largest"):
        check_shape(path)
    assert any("dropped 1 smaller body" in said for said in check_shape(path, None, Mending("largest")))
    with_a_long_hole(tmp_path / "a.off")
    with pytest.raises(InputError, match="--hole-limit"):
        check_shape(path)
    V, F, said = load_mesh(path, Mending(hole_limit=3.0))
    assert any("closed 1 hole" in sentence for sentence in said)
    meshref.check_mesh(V, F, closed=True)


@pytest.mark.parametrize("arguments", [["run", "spot"], ["fit", "a.off", "-o", "a.safetensors"]])
def test_a_hole_limit_below_zero_is_refused(command, arguments, tmp_path):
    with_two_bodies(tmp_path / "a.off")
    result = command(*arguments, "--hole-limit", "-1", cwd=tmp_path)
    assert "--hole-limit must be a number of diagonals" in refused(result)


def test_a_mended_mesh_is_fitted_and_the_mending_is_printed(command, tmp_path):
    turned_inwards(tmp_path / "ball.off")
    result = command("fit", "ball.off", "-o", "ball.safetensors", "--width", "8", "--steps", "40", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "looked the wrong way" in result.stdout
    assert (tmp_path / "ball.safetensors").stat().st_size > 0


@pytest.mark.parametrize("words", [("handles",), ("study", "points", "--quick", "--shapes"), ("edit", "--no-browser")])
def test_a_field_whose_surface_leaves_its_bounds_is_refused_in_a_sentence(words, command, tmp_path):
    field = implicit.Field(shapes.sphere(1.2).module, bounds=((-1.0,) * 3, (1.0,) * 3))
    implicit.save_field(field, tmp_path / "large.safetensors")
    ended = command(*words, "large.safetensors", cwd=tmp_path)
    assert ended.returncode == 2
    assert "The surface leaves the bounds" in ended.stderr
