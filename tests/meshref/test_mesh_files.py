"""Files: what is written comes back, and what is broken is refused with one clear error."""

import json
import re
import sys
import zipfile

import numpy as np
import pytest
import trimesh

from meshref import MeshError, box, check_mesh, icosphere, read_mesh, torus, volume, write_mesh


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".PLY"])
def test_meshes_come_back_to_the_last_bit(tmp_path, suffix, rng):
    V, F = torus(9, 7)
    V = V * np.pi + 1e5 * rng.standard_normal(3)
    write_mesh(tmp_path / f"mesh{suffix}", V, F)
    read_V, read_F = read_mesh(tmp_path / f"mesh{suffix}")
    np.testing.assert_array_equal(read_V, V)
    np.testing.assert_array_equal(read_F, F)


def test_stl_comes_back_in_single_precision_and_closed(tmp_path):
    V, F = icosphere(2)
    write_mesh(tmp_path / "mesh.stl", V, F)
    read_V, read_F = read_mesh(tmp_path / "mesh.stl")
    check_mesh(read_V, read_F, closed=True)
    np.testing.assert_array_equal(read_V[read_F], V.astype(np.float32)[F])


@pytest.mark.parametrize("kind", ["obj", "off", "ply", "stl", "stl_ascii"])
def test_files_of_trimesh_are_read(tmp_path, kind):
    V, F = icosphere(2)
    path = tmp_path / f"mesh.{kind[:3]}"
    trimesh.Trimesh(V, F, process=False).export(path, file_type=kind)
    read_V, read_F = read_mesh(path)
    check_mesh(read_V, read_F, closed=True)
    assert volume(read_V, read_F) == pytest.approx(volume(V, F), rel=1e-6)


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "stl"])
def test_trimesh_reads_our_files(tmp_path, suffix):
    V, F = icosphere(2)
    write_mesh(tmp_path / f"mesh.{suffix}", V, F)
    other = trimesh.load_mesh(tmp_path / f"mesh.{suffix}")
    assert other.is_watertight
    assert other.volume == pytest.approx(volume(V, F), rel=1e-6)


def test_quality_reaches_meshlab(tmp_path):
    pymeshlab = pytest.importorskip("pymeshlab", reason="pymeshlab is not installed")
    V, F = icosphere(1)
    write_mesh(tmp_path / "mesh.ply", V, F, quality=V[:, 0])
    mesh_set = pymeshlab.MeshSet()
    mesh_set.load_new_mesh(str(tmp_path / "mesh.ply"))
    np.testing.assert_allclose(mesh_set.current_mesh().vertex_scalar_array(), V[:, 0], atol=1e-7)
    np.testing.assert_array_equal(read_mesh(tmp_path / "mesh.ply")[0], V)


SQUARE = {
    "obj": "# a square\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2//1 3/1 4\n",
    "obj, backwards": "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n",
    "off": "OFF\n# a square\n4 1 0\n\n0 0 0\n1 0 0\n1 1 0 # third\n0 1 0\n4 0 1 2 3 255 0 0\n",
    "off, short header": "OFF 4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
    "obj, over several lines": "v 0 0 0\nv 1 0 \\\n  0\nv 1 1 0\nv 0 1 0\nf 1 2 \\\n3 4\n",
    "obj, with a byte-order mark": "\ufeffv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n",
    "off, all in the first line": "OFF4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
    "off, in small letters": "off\n4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
    "off, faces over several lines": "OFF\n4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0\n1 2\n3\n",
    "off, counts over several lines": "OFF\n4\n1\n0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
    "off, with colours": "COFF\n4 1 4\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n1 1 0 1 0 0 1\n0 1 0 1 0 0 1\n4 0 1 2 3 0.5\n",
    "stl of a facet with four corners": "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
    "vertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid x\n",
    "ply of a strip": "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n1 1 0\n0 1 0\n9 0 1 2 -1 0 2 3 -1 3\n",
    "ply": "ply\nformat ascii 1.0\ncomment a square\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nproperty uchar red\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
    "0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 0 9\n4 0 1 2 3\n",
}


@pytest.mark.parametrize("kind", SQUARE)
def test_squares_are_read_in_all_spellings(tmp_path, kind):
    path = tmp_path / f"square.{kind[:3]}"
    path.write_text(SQUARE[kind], encoding="utf-8")
    V, F = read_mesh(path)
    np.testing.assert_array_equal(V, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(F, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_of_mixed_polygons(tmp_path, order):
    name = {"<": "little", ">": "big"}[order]
    header = (
        f"ply\nformat binary_{name}_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 2\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n"
    )
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], dtype=order + "f4")
    faces = b""
    for polygon in ([0, 1, 2, 3], [1, 4, 2]):
        faces += bytes([7, len(polygon)]) + np.array(polygon, dtype=order + "i4").tobytes()
    (tmp_path / "mesh.ply").write_bytes(header.encode() + points.tobytes() + faces)
    V, F = read_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(V, points)
    np.testing.assert_array_equal(F, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_of_a_ply_end_as_on_any_system_and_comments_may_name_its_end(tmp_path, end):
    """The first coordinate is a byte of 13 and three of 10: a line that ends in one of them ends there."""
    lines = ["ply", "format binary_little_endian 1.0", "comment before end_header stands this", "element vertex 3"]
    lines += [f"property float {x}" for x in "xyz"]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header", ""]
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")
    points[0, 0] = np.frombuffer(b"\x0d\x0a\x0a\x0a", dtype="<f4")[0]
    faces = bytes([3]) + np.array([0, 1, 2], dtype="<i4").tobytes()
    (tmp_path / "mesh.ply").write_bytes(end.join(lines).encode() + points.tobytes() + faces)
    V, F = read_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(V, points)
    np.testing.assert_array_equal(F, [[0, 1, 2]])


@pytest.mark.parametrize("kind", ["off", "obj", "stl_ascii"])
def test_letters_of_two_bytes_end_no_line(tmp_path, kind):
    """The second byte of an Å ends a line where a text in latin-1 is split: what follows would be read as numbers."""
    V, F = box()
    content = trimesh.Trimesh(V, F, process=False).export(file_type=kind)
    before = {"off": "OFF\n# by Å 8 6 0\n", "obj": "g Å f 1 2 3\n", "stl_ascii": "solid Å vertex 9 9 9\n"}[kind]
    text = before + (content.removeprefix("OFF\n") if kind == "off" else content.removeprefix("solid \n"))
    path = tmp_path / f"a.{kind[:3]}"
    path.write_text(text, encoding="utf-8")
    assert volume(*read_mesh(path)) == pytest.approx(1)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY_FACES = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.obj", "", "is empty"),
        ("blank.off", " \n\n", "is empty"),
        ("letter.obj", "Dear friend,\nfor all I know this is no mesh.\n", "holds no triangle mesh: it has 0 vertices"),
        ("vague.obj", "v is for vendetta\nf is for fake\n", "line 1 has 'is for vendetta'"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "3 vertices and 0 faces.*point cloud"),
        ("far.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "corner 2 of triangle 0 is vertex 3.*3 vertices"),
        ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4 names vertex 0"),
        ("back.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n", "line 4 names vertex"),
        ("two.obj", "v 0 0 0\nv 1 0\n", "line 2 has 2 coordinates"),
        ("edge.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3 has a face with 2 corners"),
        ("text.off", "Dear friend,\n", "must begin with the word OFF"),
        ("short.off", "OFF\n4 2 0\n0 0 0\n1 0 0\n", "ends after 2 of 4 vertices"),
        ("count.off", "OFF\n", "numbers of vertices and faces are missing"),
        ("binary.off", "OFF BINARY\n", "binary variant"),
        ("far.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "corner 2 of triangle 0 is vertex 7"),
        ("text.ply", "Dear friend,\n", "must begin with the word ply"),
        ("head.ply", "ply\nformat ascii 1.0\n", "header does not end"),
        ("type.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n", "line 4 of its header"),
        ("format.ply", "ply\nformat morse 1.0\nend_header\n", "format is 'morse'"),
        ("short.ply", PLY + PLY_FACES + "0 0 0\n1 0 0\n", "ends in its vertex table"),
        ("words.ply", PLY + PLY_FACES + "0 0 0\n1 0 nought\n", "'1 0 nought'|'nought'"),
        ("far.ply", PLY + PLY_FACES + "0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", "corner 2 of triangle 0 is vertex 9"),
        ("bare.ply", PLY + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "3 vertices and 0 faces"),
        ("text.stl", "Dear friend,\n", "neither text nor binary"),
        ("short.stl", "solid x\nvertex 0 0 0\nvertex 1 0 0\n", "2 corners"),
        ("mesh.xyz", "0 0 0\n", r"must end in .obj, .off, .ply, .stl, .glb"),
        ("four.off", "4OFF\n3 1 0\n0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2\n", "4OFF, whose vertices do not have three"),
        ("facet.stl", "solid x\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\n", "line 5 ends a facet with less"),
        ("text.gltf", "Dear friend,\n", "no description in JSON"),
        ("list.gltf", "[]", "its description is no object"),
        ("short.glb", "glTF....", "no description in JSON"),
        ("draco.gltf", '{"extensionsRequired": ["KHR_draco_mesh_compression"]}', "needs KHR_draco_mesh_compression"),
        ("mesh", "0 0 0\n", r"must end in .obj"),
    ],
)
def test_broken_files_are_refused_with_the_place(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshError, match=message):
        read_mesh(tmp_path / name)


def test_missing_files_and_directories_are_refused(tmp_path):
    with pytest.raises(MeshError, match=r"there is no file '.*missing.obj'"):
        read_mesh(tmp_path / "missing.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshError, match="is a directory"):
        read_mesh(tmp_path / "folder.obj")


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "stl", "glb", "gltf", "3mf", "dae"])
def test_random_bytes_end_in_a_mesh_error(tmp_path, suffix, rng):
    path = tmp_path / f"noise.{suffix}"
    path.write_bytes(rng.bytes(2000))
    with pytest.raises(MeshError):
        read_mesh(path)


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "stl"])
def test_files_cut_short_end_in_a_mesh_error_or_an_open_mesh(tmp_path, suffix):
    V, F = icosphere(1)
    path = tmp_path / f"mesh.{suffix}"
    write_mesh(path, V, F)
    content = path.read_bytes()
    for part in (0.05, 0.3, 0.6, 0.95):
        path.write_bytes(content[: int(part * len(content))])
        with pytest.raises(MeshError):  # a text may end between two faces: then the mesh is open
            check_mesh(*read_mesh(path), closed=True)


def test_coordinates_that_are_not_finite_are_left_to_the_gate(tmp_path):
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n")
    V, F = read_mesh(tmp_path / "nan.obj")
    with pytest.raises(MeshError, match=r"V must be finite.*V\[1\]"):
        check_mesh(V, F)


def test_an_interrupted_write_loses_nothing(tmp_path, monkeypatch):
    V, F = icosphere(1)
    path = tmp_path / "mesh.ply"
    write_mesh(path, V, F)

    def power_cut(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", power_cut)
    with pytest.raises(KeyboardInterrupt):
        write_mesh(path, 2 * V, F)
    np.testing.assert_array_equal(read_mesh(path)[0], V)
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


def test_what_cannot_be_written_is_refused(tmp_path):
    V, F = icosphere(1)
    with pytest.raises(MeshError, match="cannot be written: No such file"):
        write_mesh(tmp_path / "nowhere" / "mesh.ply", V, F)
    with pytest.raises(MeshError, match="must end in"):
        write_mesh(tmp_path / "mesh.xyz", V, F)
    with pytest.raises(MeshError, match=r"quality needs a file ending in \.ply"):
        write_mesh(tmp_path / "mesh.obj", V, F, quality=V[:, 0])
    with pytest.raises(MeshError, match=r"quality must have shape \(42,\)"):
        write_mesh(tmp_path / "mesh.ply", V, F, quality=V)
    with pytest.raises(MeshError, match=r"single precision of \.stl"):
        write_mesh(tmp_path / "mesh.stl", 1e50 * V, F)
    assert not list(tmp_path.iterdir())


def test_read_order_is_that_of_the_file(real_mesh):
    V, F = real_mesh("spot.obj")  # texture seams do not tear it
    assert (len(V), len(F)) == (2930, 5856)
    np.testing.assert_array_equal(F[0], [738, 734, 735])


def test_a_plain_obj_reads_as_one_with_more_at_its_corners(tmp_path):
    """The quick way through plain files and the one line by line give the same bits."""
    V, F = torus(24, 12, 0.7, 0.25)
    plain, full = tmp_path / "plain.obj", tmp_path / "full.obj"
    write_mesh(plain, V, F)
    full.write_text(re.sub(r"^f (\d+) (\d+) (\d+)", r"f \1/1 \2//2 \3/3/3", plain.read_text(), flags=re.M))
    assert "//" in full.read_text()
    for wanted, found in zip(read_mesh(plain), read_mesh(full)):
        np.testing.assert_array_equal(wanted, found)


def test_strips_turn_at_every_corner_and_begin_anew(tmp_path):
    """An octahedron of two strips, the first with a corner turned by a triangle without area, against its faces."""
    V = np.concatenate([np.eye(3), -np.eye(3)])
    strips = [0, 1, 2, 3, 3, 5, -1]
    head = "ply\nformat {} 1.0\nelement vertex 6\n" + "".join(f"property double {x}\n" for x in "xyz")
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    text = "\n".join([*(" ".join(map(str, p)) for p in V.tolist()), " ".join(map(str, [len(strips), *strips])), ""])
    (tmp_path / "text.ply").write_text(head.format("ascii") + text)
    binary = V.astype("<f8").tobytes() + np.array([len(strips), *strips], dtype="<i4").tobytes()
    (tmp_path / "binary.ply").write_bytes(head.format("binary_little_endian").encode() + binary)
    for name in ("text.ply", "binary.ply"):
        np.testing.assert_array_equal(read_mesh(tmp_path / name)[1], [[0, 1, 2], [2, 1, 3]])


def test_a_closed_surface_of_strips_is_closed(tmp_path):
    V, F = torus(12, 8)
    strips = []
    for i in range(12):  # round the tube: two rings of vertices by turns
        ring, following = 8 * i + np.arange(9) % 8, 8 * ((i + 1) % 12) + np.arange(9) % 8
        strips += [*np.column_stack([ring, following]).ravel().tolist(), -1]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(V)}\n" + "".join(f"property double {x}\n" for x in "xyz")
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    rows = [" ".join(map(repr, p)) for p in V.tolist()]
    (tmp_path / "torus.ply").write_text(head + "\n".join([*rows, " ".join(map(str, [len(strips), *strips])), ""]))
    read_V, read_F = read_mesh(tmp_path / "torus.ply")
    assert len(read_F) == len(F)
    enclosed = volume(read_V, read_F)  # refuses what is not closed and oriented alike
    assert abs(enclosed) == pytest.approx(volume(V, F), rel=0.02)


def scene_of_trimesh():
    """A ball, and a box that is mirrored, turned and moved to (5, 0, 0): of volumes known."""
    scene = trimesh.Scene()
    V, F = icosphere(2)
    scene.add_geometry(trimesh.Trimesh(V, F, process=False))
    place = np.diag([-2.0, 1, 1, 1])
    place[:3, 3] = [5, 0, 0]
    box_V, box_F = box()
    scene.add_geometry(trimesh.Trimesh(box_V, box_F, process=False), transform=place)
    return scene, volume(V, F)


@pytest.mark.parametrize("suffix", ["glb", "gltf", "3mf"])
def test_scenes_are_read_with_every_mesh_in_its_place(tmp_path, suffix):
    if suffix == "3mf":
        pytest.importorskip("lxml", reason="lxml is not installed")
    scene, ball = scene_of_trimesh()
    content = scene.export(file_type=suffix)
    files = content if isinstance(content, dict) else {f"scene.{suffix}": content}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    V, F = read_mesh(next(path for path in tmp_path.iterdir() if path.suffix == f".{suffix}"))
    check_mesh(V, F, closed=True)
    assert volume(V, F) == pytest.approx(ball + 2, rel=1e-6)
    np.testing.assert_allclose(V.max(axis=0), [5, 1, 1], atol=1e-6)


def _node_of_a_mesh(header):
    return next(node for node in header["nodes"] if "mesh" in node)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header: header["accessors"][0].update(sparse={}), "sparse"),
        (lambda header: [a.update(componentType=5122) for a in header["accessors"]], "whole numbers"),
        (lambda header: header["meshes"][0]["primitives"][0].update(mode=6), "mode 6"),
        (lambda header: header["meshes"][0].pop("primitives"), "parts that are not there"),
        (lambda header: header.update(buffers=[]), "its reader says IndexError"),
        (lambda header: _node_of_a_mesh(header).update(skin=0), "a skeleton moves its meshes"),
        (lambda header: header["meshes"][0].update(weights=[0.0, 0.5]), "targets move its meshes"),
        (lambda header: _node_of_a_mesh(header).update(extensions={"EXT_mesh_gpu_instancing": {}}), "are repeated by"),
    ],
)
def test_what_would_be_read_wrong_of_a_gltf_is_refused(tmp_path, change, message):
    scene, _ = scene_of_trimesh()
    for name, data in scene.export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    path = next(tmp_path.glob("*.gltf"))
    header = json.loads(path.read_text())
    change(header)
    path.write_text(json.dumps(header))
    with pytest.raises(MeshError, match=message):
        read_mesh(path)


DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="m" meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="24">0 0 0 6 0 0 1 1 0 0 6 0 0 0 1 6 0 1 1 1 1 0 6 1</float_array>
<technique_common><accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><polylist count="6">
<input semantic="VERTEX" source="#v" offset="0"/><vcount>4 4 4 4 4 4</vcount>
<p>3 2 1 0 4 5 6 7 0 1 5 4 1 2 6 5 2 3 7 6 3 0 4 7</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><translate>9 0 0</translate><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_a_dae_of_darts_has_its_volume(tmp_path):
    pytest.importorskip("collada", reason="pycollada is not installed")
    (tmp_path / "dart.dae").write_text(DAE)
    V, F = read_mesh(tmp_path / "dart.dae")
    check_mesh(V, F, closed=True)
    assert volume(V, F) == pytest.approx(6, rel=1e-6)
    assert V[:, 0].min() == pytest.approx(9)


def test_a_mirrored_node_of_a_dae_turns_its_faces_round(tmp_path):
    """Two overlapping copies of which one is mirrored: as they look they are one solid, without a hollow."""
    pytest.importorskip("collada", reason="pycollada is not installed")
    mirrored = DAE.replace("<translate>9 0 0</translate>", "<scale>-1 1 1</scale>")
    (tmp_path / "dart.dae").write_text(mirrored)
    V, F = read_mesh(tmp_path / "dart.dae")
    assert volume(V, F) == pytest.approx(6, rel=1e-6)


SKIN = """<library_controllers><controller id="c"><skin source="#g"><source id="j"><Name_array id="ja" count="1">b
</Name_array><technique_common><accessor source="#ja" count="1" stride="1"><param name="JOINT" type="name"/></accessor>
</technique_common></source><source id="i"><float_array id="ia" count="16">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</float_array>
<technique_common><accessor source="#ia" count="1" stride="16"><param name="T" type="float4x4"/></accessor>
</technique_common></source><source id="w"><float_array id="wa" count="1">1</float_array><technique_common>
<accessor source="#wa" count="1" stride="1"><param name="W" type="float"/></accessor></technique_common></source>
<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#i"/></joints>
<vertex_weights count="8"><input semantic="JOINT" source="#j" offset="0"/>
<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 1 1 1 1 1 1</vcount><v>0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0</v>
</vertex_weights></skin></controller></library_controllers><library_visual_scenes>"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (DAE.replace("<p>3", "<ph><p>3"), "polygons with holes"),
        (
            DAE.replace("<library_visual_scenes>", SKIN).replace(
                "</node>", '</node><node><instance_controller url="#c"/></node>'
            ),
            "a skeleton or targets move",
        ),
    ],
)
def test_what_the_reader_of_dae_leaves_out_is_refused(tmp_path, content, message):
    pytest.importorskip("collada", reason="pycollada is not installed")
    (tmp_path / "a.dae").write_text(content)
    with pytest.raises(MeshError, match=message):
        read_mesh(tmp_path / "a.dae")


THREE_MF = '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{}</resources></model>'


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"a.model": '<object id="1"/><object id="2" type="support"/>'}, "object 2 is of the type support"),
        ({"a.model": '<object id="1"/>', "b.model": '<object id="1"/>'}, "both .*a.model and .*b.model.* object 1"),
        ({"a.model": '<object id="1"/>'}, "no items to be built"),
    ],
)
def test_objects_that_the_reader_of_3mf_takes_for_the_shape_are_refused(tmp_path, files, message):
    pytest.importorskip("lxml", reason="lxml is not installed")
    with zipfile.ZipFile(tmp_path / "a.3mf", "w") as file:
        for name, objects in files.items():
            file.writestr(f"3D/{name}", THREE_MF.format(objects))
    with pytest.raises(MeshError, match=message):
        read_mesh(tmp_path / "a.3mf")


@pytest.mark.parametrize("suffix", ["3mf", "dae"])
def test_scenes_that_need_a_package_say_which(tmp_path, suffix, monkeypatch):
    monkeypatch.setitem(sys.modules, "lxml", None)
    monkeypatch.setitem(sys.modules, "collada", None)
    (tmp_path / f"a.{suffix}").write_text(DAE)
    with pytest.raises(MeshError, match=r'needs lxml.*pip install "\.\[formats\]"'):
        read_mesh(tmp_path / f"a.{suffix}")
