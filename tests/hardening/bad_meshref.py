"""Bad input for every public function of meshref."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from corpus import Bad, BadCase, choices, counts, not_negatives, numpy_points, positives, refusals

import meshref

V, F = meshref.icosphere(1)
OPEN = F[3:]
HANDLES = np.array([0, 5, 9, 20])
WANTED = np.zeros((4, 3))
Call = Callable[..., object]


def cases() -> Iterator[BadCase]:
    yield from _of_the_mesh()
    yield from _of_open_meshes()
    yield from _of_handles()
    yield from _of_options()
    yield from _of_points()
    yield from _of_files()


# Every function that takes V and F first, with the rest of its arguments good

TAKES_A_MESH: dict[str, Call] = {
    "volume": meshref.volume,
    "area": meshref.area,
    "centroid": meshref.centroid,
    "second_moment": meshref.second_moment,
    "sphericity": meshref.sphericity,
    "euler_number": meshref.euler_number,
    "genus": meshref.genus,
    "components": meshref.components,
    "component_count": meshref.component_count,
    "face_normals": meshref.face_normals,
    "vertex_normals": meshref.vertex_normals,
    "vertex_areas": meshref.vertex_areas,
    "mean_curvature": meshref.mean_curvature,
    "cotangent_laplacian": meshref.cotangent_laplacian,
    "mass_matrix": meshref.mass_matrix,
    "check_mesh": meshref.check_mesh,
    "mend_mesh": meshref.mend_mesh,
    "explicit_step_limit": meshref.explicit_step_limit,
    "killing": lambda v, f: meshref.killing(v, f, HANDLES, WANTED),
    "killing_energy": lambda v, f: meshref.killing_energy(v, f, np.zeros((len(V), 3))),
    "killing_energy_density": lambda v, f: meshref.killing_energy_density(v, f, np.zeros((len(V), 3))),
    "KillingSolver": lambda v, f: meshref.KillingSolver(v, f, HANDLES),
    "arap": lambda v, f: meshref.arap(v, f, HANDLES, V[HANDLES]),
    "ArapSolver": lambda v, f: meshref.ArapSolver(v, f, HANDLES),
    "arap_energy": lambda v, f: meshref.arap_energy(v, f, V),
    "biharmonic": lambda v, f: meshref.biharmonic(v, f, HANDLES, WANTED),
    "mean_curvature_flow": lambda v, f: meshref.mean_curvature_flow(v, f, steps=1, step_size=1e-3),
    "converged_curvature_flow": lambda v, f: meshref.converged_curvature_flow(v, f, time=1e-3, steps=1),
    "signed_distance": lambda v, f: meshref.signed_distance(v, f, np.zeros((1, 3))),
    "SignedDistanceQuery": meshref.SignedDistanceQuery,
    "surface_distance": lambda v, f: meshref.surface_distance(V, F, v, f, n=10),
    "chamfer": lambda v, f: meshref.chamfer(v, f, V, F, n=10),
    "hausdorff": lambda v, f: meshref.hausdorff(v, f, V, F, n=10),
    "normal_consistency": lambda v, f: meshref.normal_consistency(v, f, V, F, n=10),
    "iou": lambda v, f: meshref.iou(v, f, V, F, n=10),
    "sample_mesh": lambda v, f: meshref.sample_mesh(v, f, 10),
    "write_mesh": lambda v, f: meshref.write_mesh("mesh.ply", v, f),
    "laplacian_smooth": meshref.laplacian_smooth,
    "taubin_smooth": meshref.taubin_smooth,
    "isotropic_remesh": lambda v, f: meshref.isotropic_remesh(v, f, 0.5),
    "decimate": lambda v, f: meshref.decimate(v, f, 4),
    "hausdorff_distance": lambda v, f: meshref.hausdorff_distance(V, F, v, f, n=10),
}

# These take vertices that no face uses, faces without area, or both.
TAKE_LOOSE_VERTICES = ("mend_mesh", "write_mesh")


def bad_faces() -> list[Bad]:
    """Faces that no mesh of these vertices can have."""
    beyond, before, fraction, with_nan = F.copy(), F.copy(), F.astype(float), F.astype(float)
    beyond[2, 1], before[2, 1], fraction[2, 1], with_nan[2, 1] = len(V), -1, 1.5, np.nan
    return [
        ("beyond the vertices", beyond),
        ("before the vertices", before),
        ("counted from 1", F + 1),
        ("fractions", fraction),
        ("NaN", with_nan),
        ("enormous", np.full_like(F, 2**62)),
        ("beyond 63 bits", np.full(F.shape, 2**64 - 1, dtype=np.uint64)),
        ("beyond 64 bits", [[0, 1, 2**70]]),
        ("of four corners", np.column_stack([F, F[:, 0]])),
        ("of one axis", F.ravel()),
        ("none", F[:0]),
        ("words", F.astype(str)),
        ("None", None),
        ("ragged", [[0, 1, 2], [3, 4]]),
        ("true and false", F > 3),
        ("complex", F.astype(complex)),
    ]


def _of_the_mesh() -> Iterator[BadCase]:
    flat = V.copy()
    flat[F[4, 1]] = flat[F[4, 0]]
    for function, call in TAKES_A_MESH.items():
        bad = [*numpy_points(len(V)), ("none", V[:0]), ("too far apart for their squares", V * 1e160)]
        yield from refusals(function, "V", bad, lambda v, call=call: call(v, F), "V")
        yield from refusals(function, "F", bad_faces(), lambda f, call=call: call(V, f), "F")
        if function not in TAKE_LOOSE_VERTICES:
            loose = np.vstack([V, [[0.0, 0.0, 0.0]]])
            yield from refusals(
                function, "V", [("unused", loose)], lambda v, call=call: call(v, F), "vertex", "mend_mesh"
            )
    for function in ("killing", "arap", "biharmonic", "mean_curvature", "mean_curvature_flow", "laplacian_smooth"):
        call = TAKES_A_MESH[function]
        yield from refusals(
            function, "faces", [("without area", flat)], lambda v, call=call: call(v, F), "area", "mend_mesh"
        )
    collapsed = [("all in one place", np.zeros_like(V)), ("too near for their squares", V * 1e-170)]
    for function in ("mend_mesh", "sample_mesh", "area", "volume", "sphericity", "signed_distance", "chamfer"):
        yield from refusals(function, "V", collapsed, lambda v, call=TAKES_A_MESH[function]: call(v, F), "V")


def _of_open_meshes() -> Iterator[BadCase]:
    moebius = [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 0, 4], [4, 0, 1]]
    for function in ("volume", "centroid", "second_moment", "sphericity", "genus", "mean_curvature_flow"):
        call = TAKES_A_MESH[function]
        yield from refusals(function, "mesh", [("open", OPEN)], lambda f, call=call: call(V, f), "closed", "mend_mesh")
        turned = F.copy()
        turned[3] = turned[3, ::-1]
        yield from refusals(
            function, "mesh", [("of mixed sides", turned)], lambda f, call=call: call(V, f), "alike", "mend_mesh"
        )
    doubled = np.vstack([F, F[:1]])
    for function in ("volume", "mean_curvature", "mean_curvature_flow"):
        call = TAKES_A_MESH[function]
        yield from refusals(
            function, "mesh", [("with a doubled face", doubled)], lambda f, call=call: call(V, f), "at most two faces"
        )
    yield BadCase("mend_mesh: mesh one-sided", lambda: meshref.mend_mesh(V[:5], moebius), ("two sides",))
    inside_out = F[:, ::-1]
    yield BadCase(
        "mean_curvature_flow: mesh inside out",
        lambda: meshref.mean_curvature_flow(V, inside_out, steps=1, step_size=1e-3),
        ("outwards", "mend_mesh"),
    )
    flat = V * (1, 1, 0)
    yield BadCase("centroid: mesh flat", lambda: meshref.centroid(flat, F), ("volume",))


def _of_handles() -> Iterator[BadCase]:
    bad_handles: list[Bad] = [
        ("beyond the vertices", [0, 1, len(V)]),
        ("negative", [0, 1, -1]),
        ("twice", [0, 1, 1]),
        ("none", []),
        ("fractions", [0.5, 1.0, 2.0]),
        ("NaN", [0.0, np.nan, 2.0]),
        ("of two axes", [[0, 1, 2]]),
        ("one number", 3),
        ("words", ["a", "b"]),
        ("None", None),
        ("a mask", np.ones(len(V), dtype=bool)),
    ]
    several = np.zeros((3, 3))
    solvers: dict[str, Call] = {
        "killing": lambda h: meshref.killing(V, F, h, several),
        "arap": lambda h: meshref.arap(V, F, h, several),
        "biharmonic": lambda h: meshref.biharmonic(V, F, h, several),
        "handle_error": lambda h: meshref.handle_error(V, h, several),
    }
    for function, call in solvers.items():
        yield from refusals(function, "handles", bad_handles, call, "handle")
    bad_vectors = [*numpy_points(len(HANDLES)), ("too few", WANTED[:3])]
    yield from refusals("killing", "displacements", bad_vectors, lambda d: meshref.killing(V, F, HANDLES, d))
    yield from refusals("biharmonic", "displacements", bad_vectors, lambda d: meshref.biharmonic(V, F, HANDLES, d))
    yield from refusals("arap", "targets", bad_vectors, lambda d: meshref.arap(V, F, HANDLES, d))
    yield from refusals("handle_error", "wanted", numpy_points(4), lambda d: meshref.handle_error(V, HANDLES, d))
    prepared, rigid = meshref.KillingSolver(V, F, HANDLES), meshref.ArapSolver(V, F, HANDLES)
    yield from refusals("KillingSolver.solve", "displacements", bad_vectors, prepared.solve)
    yield from refusals("KillingSolver.run", "displacements", bad_vectors, prepared.run)
    yield from refusals("ArapSolver.solve", "targets", bad_vectors, rigid.solve)
    yield from refusals("ArapSolver.rigid_start", "targets", bad_vectors, rigid.rigid_start)
    on_a_line = np.array([0, 3])
    yield BadCase("killing: handles two", lambda: meshref.killing(V, F, on_a_line, V[on_a_line]), ("three handle",))
    two = np.vstack([V, V + 5]), np.vstack([F, F + len(V)])
    for function, call in (("killing", meshref.killing), ("arap", meshref.arap), ("biharmonic", meshref.biharmonic)):
        yield BadCase(
            f"{function}: handles on one of two parts",
            lambda call=call: call(*two, HANDLES, WANTED),
            ("handle", "part"),
        )
    fields = [*numpy_points(len(V)), ("too short", V[:-1]), ("too long", np.vstack([V, V]))]
    yield from refusals("killing_energy", "D", fields, lambda d: meshref.killing_energy(V, F, d))
    yield from refusals("killing_energy_density", "D", fields, lambda d: meshref.killing_energy_density(V, F, d))
    yield from refusals("arap_energy", "U", fields, lambda u: meshref.arap_energy(V, F, u))
    yield from refusals("ArapSolver.energy", "U", fields, rigid.energy)
    starts = [bad for bad in fields if bad[1] is not None]
    yield from refusals("arap", "start", starts, lambda s: meshref.arap(V, F, HANDLES, V[HANDLES], start=s))


def _of_options() -> Iterator[BadCase]:
    def killing(**options: object) -> object:
        return meshref.killing(V, F, HANDLES, WANTED, **options)  # type: ignore[arg-type]

    def arap(**options: object) -> object:
        return meshref.arap(V, F, HANDLES, V[HANDLES], **options)  # type: ignore[arg-type]

    def flow(**options: object) -> object:
        return meshref.mean_curvature_flow(V, F, **{"steps": 1, "step_size": 1e-3, **options})  # type: ignore[arg-type]

    yield from refusals("killing", "form", choices(), lambda x: killing(form=x))
    yield from refusals("killing", "method", choices(), lambda x: killing(method=x))
    yield from refusals("killing", "solver", choices(), lambda x: killing(solver=x))
    yield from refusals("killing", "penalty", positives(), lambda x: killing(method="soft", penalty=x))
    yield from refusals("killing", "penalty", [("of hard handles", 1.0)], lambda x: killing(penalty=x))
    weights: list[Bad] = [
        ("too few", [1.0, 1.0]),
        ("negative", [1.0, 1.0, 1.0, -1.0]),
        ("NaN", [1.0, 1.0, 1.0, np.nan]),
        ("words", ["a", "b", "c", "d"]),
        ("zero", np.zeros(4)),
    ]
    yield from refusals("killing", "handle_weights", weights, lambda x: killing(method="soft", handle_weights=x))
    yield from refusals("killing_energy", "form", choices(), lambda x: meshref.killing_energy(V, F, V, form=x))
    yield from refusals(
        "killing_energy_density", "form", [("of cells", "spokes"), *choices()],
        lambda x: meshref.killing_energy_density(V, F, V, form=x),
    )  # fmt: skip
    yield from refusals("arap", "iterations", counts(), lambda x: arap(iterations=x))
    yield from refusals("arap", "energy_every", counts(), lambda x: arap(energy_every=x))
    yield from refusals("arap", "tolerance", positives(), lambda x: arap(tolerance=x))
    yield from refusals("arap", "penalty", positives(), lambda x: arap(penalty=x))
    yield from refusals("arap", "penalty", [("of libigl", 1.0)], lambda x: arap(penalty=x, minimiser="libigl"))
    yield from refusals("arap", "minimiser", choices(), lambda x: arap(minimiser=x))
    yield from refusals(
        "ArapSolver",
        "handle_weights",
        weights,
        lambda x: meshref.ArapSolver(V, F, HANDLES, penalty=1.0, handle_weights=x),
    )
    yield from refusals(
        "biharmonic", "solver", choices(), lambda x: meshref.biharmonic(V, F, HANDLES, WANTED, solver=x)
    )

    def converged(**options: object) -> object:
        return meshref.converged_curvature_flow(V, F, **{"time": 1e-3, **options})  # type: ignore[arg-type]

    yield from refusals("converged_curvature_flow", "time", positives(), lambda x: converged(time=x))
    yield from refusals("converged_curvature_flow", "steps", counts(), lambda x: converged(steps=x))
    yield from refusals("converged_curvature_flow", "most_steps", counts(), lambda x: converged(most_steps=x))
    yield from refusals("converged_curvature_flow", "tolerance", positives(), lambda x: converged(tolerance=x))
    yield from refusals("converged_curvature_flow", "method", choices(), lambda x: converged(method=x))
    yield from refusals(
        "converged_curvature_flow", "preserve_volume", choices(), lambda x: converged(preserve_volume=x)
    )
    yield from refusals("mean_curvature_flow", "steps", counts(0), lambda x: flow(steps=x))
    yield from refusals("mean_curvature_flow", "step_size", positives(), lambda x: flow(step_size=x))
    yield from refusals("mean_curvature_flow", "method", choices(), lambda x: flow(method=x))
    yield from refusals("mean_curvature_flow", "preserve_volume", choices(), lambda x: flow(preserve_volume=x))
    yield from refusals("mean_curvature_flow", "snapshot_every", counts(), lambda x: flow(snapshot_every=x))
    yield from refusals("mean_curvature_flow", "solver", choices(), lambda x: flow(solver=x))
    limits: list[Bad] = [
        ("the wrong way round", (5.0, 0.0)),
        ("NaN", (np.nan, 5.0)),
        ("one number", 3.0),
        ("three numbers", (0.0, 1.0, 2.0)),
        ("words", ("low", "high")),
    ]
    yield from refusals(
        "mean_curvature_flow", "cotangents", limits, lambda x: flow(method="semi-implicit", cotangents=x)
    )
    yield from refusals(
        "cotangent_laplacian", "cotangents", limits, lambda x: meshref.cotangent_laplacian(V, F, cotangents=x)
    )
    yield from refusals("mass_matrix", "kind", choices(), lambda x: meshref.mass_matrix(V, F, x))
    yield from refusals("vertex_normals", "weighting", choices(), lambda x: meshref.vertex_normals(V, F, x))
    yield from refusals("check_mesh", "degenerate", choices(), lambda x: meshref.check_mesh(V, F, degenerate=x))
    yield from refusals(
        "check_mesh", "self_intersections", choices(), lambda x: meshref.check_mesh(V, F, self_intersections=x)
    )
    yield from refusals("mend_mesh", "bodies", choices(), lambda x: meshref.mend_mesh(V, F, bodies=x))
    yield from refusals(
        "mend_mesh", "merge_distance", not_negatives(), lambda x: meshref.mend_mesh(V, F, merge_distance=x)
    )
    holes = [bad for bad in not_negatives() if bad[0] != "infinite"]
    yield from refusals("mend_mesh", "hole_limit", holes, lambda x: meshref.mend_mesh(V, F, hole_limit=x))
    yield from refusals("surface_distance", "n", counts(), lambda x: meshref.surface_distance(V, F, V, F, n=x))
    yield from refusals("iou", "n", counts(), lambda x: meshref.iou(V, F, V, F, n=x))
    yield from refusals("sample_mesh", "n", counts(), lambda x: meshref.sample_mesh(V, F, x))
    yield from refusals("sample_mesh", "seed", counts(0), lambda x: meshref.sample_mesh(V, F, 10, x))
    yield BadCase("iou: solids flat", lambda: meshref.iou(V * (1, 1, 0), F, V * (1, 1, 0), F, n=10), ("inside",))
    yield from refusals("laplacian_smooth", "steps", counts(), lambda x: meshref.laplacian_smooth(V, F, x))
    yield from refusals("taubin_smooth", "steps", counts(), lambda x: meshref.taubin_smooth(V, F, x))
    yield from refusals("taubin_smooth", "shrink", positives(), lambda x: meshref.taubin_smooth(V, F, shrink=x))
    yield from refusals(
        "taubin_smooth",
        "grow",
        [("positive", 0.3), ("NaN", np.nan), ("a word", "up")],
        lambda x: meshref.taubin_smooth(V, F, grow=x),
    )
    yield from refusals("isotropic_remesh", "edge_length", positives(), lambda x: meshref.isotropic_remesh(V, F, x))
    yield from refusals("isotropic_remesh", "iterations", counts(), lambda x: meshref.isotropic_remesh(V, F, 0.5, x))
    yield from refusals("decimate", "faces", counts(4), lambda x: meshref.decimate(V, F, x))
    yield from refusals("hausdorff_distance", "n", counts(), lambda x: meshref.hausdorff_distance(V, F, V, F, x))
    yield from refusals("icosphere", "subdivisions", [*counts(0), ("enormous", 40)], meshref.icosphere)
    yield from refusals("icosphere", "radius", positives(), lambda x: meshref.icosphere(1, x))
    centers: list[Bad] = [("of two numbers", (0, 0)), ("NaN", (0, 0, np.nan)), ("a word", "middle"), ("None", None)]
    yield from refusals("icosphere", "center", centers, lambda x: meshref.icosphere(1, 1.0, x))
    yield from refusals("torus", "around", counts(3), lambda x: meshref.torus(x, 8))
    yield from refusals("torus", "across", counts(3), lambda x: meshref.torus(8, x))
    yield from refusals("torus", "minor_radius", positives(), lambda x: meshref.torus(8, 8, 1.0, x))
    yield from refusals("torus", "major_radius", positives(), lambda x: meshref.torus(8, 8, x))
    yield from refusals("box", "upper", [("below lower", (1, 1, -1)), *centers], lambda x: meshref.box(upper=x))
    yield from refusals("box", "subdivisions", [*counts(0), ("enormous", 40)], lambda x: meshref.box(subdivisions=x))
    yield from refusals("meshref.cylinder", "around", counts(3), lambda x: meshref.cylinder(x, 2))
    yield from refusals("meshref.cylinder", "along", counts(), lambda x: meshref.cylinder(8, x))
    yield from refusals("meshref.cylinder", "radius", positives(), lambda x: meshref.cylinder(8, 2, x))
    yield from refusals("meshref.cylinder", "height", positives(), lambda x: meshref.cylinder(8, 2, 1.0, x))


def _of_points() -> Iterator[BadCase]:
    query = meshref.SignedDistanceQuery(V, F)
    bad = [*numpy_points(), ("too far for their squares", np.full((2, 3), 1e170))]
    yield from refusals("signed_distance", "P", bad, lambda p: meshref.signed_distance(V, F, p))
    yield from refusals("SignedDistanceQuery", "P", bad, query)
    yield from refusals("SignedDistanceQuery.distance", "P", bad, query.distance)
    yield from refusals("SignedDistanceQuery.inside", "P", bad, query.inside)


# Files, written into the folder that the worker runs in

TEXTS: dict[str, tuple[str, bytes]] = {
    "empty": ("a.obj", b""),
    "of spaces": ("a.off", b"   \n \n"),
    "prose as obj": ("a.obj", b"Dear all, the mesh is attached.\n"),
    "prose as off": ("a.off", b"Dear all, the mesh is attached.\n"),
    "prose as ply": ("a.ply", b"Dear all, the mesh is attached.\n"),
    "prose as stl": ("a.stl", b"Dear all, the mesh is attached.\n"),
    "obj with two coordinates": ("a.obj", b"v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "obj with words": ("a.obj", b"v a b c\nf 1 2 3\n"),
    "obj that counts from 0": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"),
    "obj beyond its vertices": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "obj far before its vertices": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9 -2 -1\n"),
    "obj with a face of two": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n"),
    "obj with a huge index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999999\n"),
    "obj of points": ("a.obj", b"v 0 0 0\nv 1 0 0\n"),
    "off without counts": ("a.off", b"OFF\n"),
    "off cut short": ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n"),
    "off with negative counts": ("a.off", b"OFF\n-3 -1 0\n"),
    "off with huge counts": ("a.off", b"OFF\n999999999999 1 0\n0 0 0\n"),
    "off with a face of two": ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n"),
    "off with a negative face": ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n"),
    "off with fractions": ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1.5 2\n"),
    "off in binary": ("a.off", b"OFF BINARY\n\x00\x00"),
    "ply without end of header": ("a.ply", b"ply\nformat ascii 1.0\n"),
    "ply of unknown format": ("a.ply", b"ply\nformat tape 1.0\nelement vertex 1\nend_header\n"),
    "ply of unknown type": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n0\n"),
    "ply without x": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float y\nend_header\n0\n"),
    "ply with negative counts": (
        "a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex -5\nproperty float x\nend_header\n\x00"
    ),
    "ply with huge counts": (
        "a.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999999\nproperty float x\nend_header\n\x00",
    ),
    "ply with a negative list": (
        "a.ply",
        b"ply\nformat binary_little_endian 1.0\nelement face 1\n"
        b"property list char int vertex_indices\nend_header\n\xf0",
    ),
    "ply cut short": (
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n",
    ),
    "ply without a count": ("a.ply", b"ply\nformat ascii 1.0\nelement vertex\nend_header\n"),
    "ply with an infinite list": (
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\ninf 0 0 0\n",
    ),
    "ply with NaN corners": (
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 0 nan\n",
    ),
    "stl cut short": ("a.stl", bytes(80) + (2).to_bytes(4, "little") + bytes(60)),
    "stl without faces": ("a.stl", bytes(84)),
    "stl text with two corners": ("a.stl", b"solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendfacet\nendsolid\n"),
    "stl text with words": ("a.stl", b"solid a\nvertex a b c\nvertex 0 0 0\nvertex 1 0 0\nendsolid\n"),
}  # fmt: skip


def _read(name: str, content: bytes) -> object:
    Path(name).write_bytes(content)
    return meshref.read_mesh(name)


def _of_files() -> Iterator[BadCase]:
    for what, (name, content) in TEXTS.items():
        yield BadCase(
            f"read_mesh: file {what}", lambda name=name, content=content: _read(name, content), ("file", name)
        )
    paths: list[Bad] = [("missing", "gone.obj"), ("of another kind", "shape.gltf"), ("without ending", "shape")]
    yield from refusals("read_mesh", "path", paths, meshref.read_mesh, "file")
    not_paths: list[Bad] = [("a number", 3), ("None", None)]
    yield from refusals("read_mesh", "path", not_paths, meshref.read_mesh)
    yield from refusals("write_mesh", "path", not_paths, lambda p: meshref.write_mesh(p, V, F))

    def read_folder() -> object:
        Path("folder.obj").mkdir(exist_ok=True)
        return meshref.read_mesh("folder.obj")

    def write_over_folder() -> object:
        Path("folder.obj").mkdir(exist_ok=True)
        return meshref.write_mesh("folder.obj", V, F)

    yield BadCase("read_mesh: path a folder", read_folder, ("directory", "folder.obj"))
    yield BadCase("write_mesh: path a folder", write_over_folder, ("folder.obj", "written"))
    where: list[Bad] = [
        ("in no folder", "gone/a.ply"),
        ("under a device", "/dev/null/a.ply"),
        ("of another kind", "a.gltf"),
    ]
    yield from refusals("write_mesh", "path", where, lambda p: meshref.write_mesh(p, V, F), "file")
    qualities: list[Bad] = [
        ("too short", np.zeros(3)),
        ("words", ["a"] * len(V)),
        ("of two axes", np.zeros((len(V), 2))),
    ]
    yield from refusals("write_mesh", "quality", qualities, lambda q: meshref.write_mesh("a.ply", V, F, quality=q))
    yield BadCase(
        "write_mesh: quality in obj",
        lambda: meshref.write_mesh("a.obj", V, F, quality=np.zeros(len(V))),
        ("quality", ".ply"),
    )
    yield BadCase(
        "write_mesh: V too far for stl", lambda: meshref.write_mesh("a.stl", V * 1e39, F), ("single precision",)
    )
