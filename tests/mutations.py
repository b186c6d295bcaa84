"""Break one formula at a time, a sign, a factor, a weight, and see that a test notices: python tests/mutations.py

Each mutation is made in a copy of the sources, in a process of its own, and the one test named beside it is run. It is
caught if that test fails. The table goes to docs/mutations.md with --write. Exit code 1 if one is missed.
"""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "mutations.md"
SECONDS_A_TEST = 900


@dataclass(frozen=True)
class Mutation:
    """One change that makes a formula wrong, and the test that must fail by it.

    Attributes:
        formula: What is broken, in words.
        path: The file.
        old: Text that occurs exactly once in it.
        new: What takes its place.
        test: A test file and a test of it, under tests/.
    """

    formula: str
    path: str
    old: str
    new: str
    test: str


def _test_file(short: str) -> str:
    """Return "edits/test_rigid.py" of "edits/rigid"."""
    folder, _, name = short.rpartition("/")
    return f"{folder}/test_{name}.py" if folder else f"test_{name}.py"


def _of(package: str, rows: list[tuple[str, str, str, str, str]]) -> list[Mutation]:
    """Mutations of one package, their files and tests named without folder and ending."""
    found = []
    for formula, module, old, new, short in rows:
        file, name = short.split("::")
        found.append(
            Mutation(formula, f"{package}/{module}.py", old, new, f"tests/{package}/{_test_file(file)}::test_{name}")
        )
    return found


IMPLICIT = [
    ("sign of the boundary sensitivity", "sensitivity/boundary_sensitivity",
     "return parameter_gradient(field, points).div_(-length[:, None])",
     "return parameter_gradient(field, points).div_(length[:, None])",
     "sensitivity/boundary_sensitivity::growing_the_radius_moves_a_sphere_outward_by_as_much"),
    ("sign of the normal displacement", "sensitivity/boundary_sensitivity",
     "return -torch.cat(change) / lengths", "return torch.cat(change) / lengths",
     "sensitivity/boundary_sensitivity::products_agree_with_the_matrix"),
    ("slope of the field in the transposed product", "sensitivity/boundary_sensitivity",
     "scaled = -weights / lengths", "scaled = -weights",
     "sensitivity/boundary_sensitivity::products_agree_with_the_matrix"),
    ("quotient rule of the sensitivity's slope", "sensitivity/frame",
     "rule[:, 1:, 0] = torch.einsum(", "rule[:, 1:, 0] = -torch.einsum(",
     "step/deformation::slope_rows_match_differences_of_the_normal_speed"),
    ("projection in the slope of the normal", "sensitivity/frame",
     "return scaled - self.normals[:, :, None]", "return scaled + self.normals[:, :, None]",
     "step/deformation::strain_rows_match_differences_of_the_displacement"),
    ("slope of the normal in a slide's strain", "step/deformation",
     "of_slide[:, e, :, 0] -= swing[:, there]", "of_slide[:, e, :, 0] += swing[:, there]",
     "step/deformation::strain_rows_match_differences_of_the_displacement"),
    ("both halves of J + J^T", "step/deformation",
     "bend = shape[:, a, b] + shape[:, b, a]", "bend = shape[:, a, b]",
     "step/deformation::killing_energy_of_a_growing_sphere_is_that_of_its_parts"),
    ("sign of the normal part of a motion", "step/deformation",
     "parameter_gradient(self.field, part).div_(-length[:, None])",
     "parameter_gradient(self.field, part).div_(length[:, None])",
     "step/deformation::normal_and_tangent_rows_give_the_displacement"),
    ("entries off the diagonal count twice", "step/energies",
     "(1.0 if a == b else 2.0) * self.share", "(1.0 if a == b else 1.0) * self.share",
     "edits/trained_rigid_step::the_energies_are_those_of_the_rows_of_the_least_squares"),
    ("share of bending and thickness", "step/energies",
     "return self.bending if a < normal else self.thickness", "return self.thickness if a < normal else self.bending",
     "step/deformation::bending_alone_of_a_spherical_harmonic_is_its_dirichlet_energy"),
    ("weights of a target along the normal", "step/energies",
     "yield Rows(matrix, self.target[where], self.weights[where])",
     "yield Rows(matrix, self.target[where], torch.ones_like(self.weights[where]))",
     "step/deformation::targets_measure_the_weighted_miss"),
    ("weights of a target for vectors", "step/energies",
     "self.weights[where].repeat_interleave(along.shape[1])", "self.weights[where].repeat(along.shape[1])",
     "step/deformation::targets_measure_the_weighted_miss"),
    ("shape gradient of the volume", "sensitivity/shape_functionals",
     "return torch.ones_like(sample.weights)", "return 2 * torch.ones_like(sample.weights)",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("shape gradient of the area", "sensitivity/shape_functionals",
     "return field.mean_curvature(sample.points)\n", "return -field.mean_curvature(sample.points)\n",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("curvature in the shape gradient of a surface integral", "sensitivity/shape_functionals",
     ".sum(dim=1) + field.mean_curvature(sample.points) * values",
     ".sum(dim=1) - field.mean_curvature(sample.points) * values",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("divergence theorem for the volume", "sensitivity/shape_functionals",
     ".sum(dim=1) / sample.points.shape[1]", ".sum(dim=1) / 2",
     "sensitivity/shape_functionals::values_on_a_ball"),
    ("weight along the ray of a volume integral", "sensitivity/shape_functionals",
     "t ** (field.dimension - 1)", "t**field.dimension",
     "sensitivity/shape_functionals::volume_is_the_volume_integral_of_one"),
    ("distance from the cells to the surface", "sensitivity/shape_functionals",
     "distance = (-value / slope)", "distance = (value / slope)",
     "sensitivity/shape_functionals::the_distance_to_the_surface_takes_most_of_the_cells_error_out"),
    ("area carried to the surface", "sensitivity/shape_functionals",
     "(1 + field.mean_curvature(sample.points) * self.distance)",
     "(1 - field.mean_curvature(sample.points) * self.distance)",
     "sensitivity/shape_functionals::the_distance_to_the_surface_takes_most_of_the_cells_error_out"),
    ("weights of the quadrature", "surface/quadrature",
     "weights.append(w / 2)", "weights.append(w)",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("points of the quadrature", "surface/quadrature",
     "point[corner] = 1 - 2 * a", "point[corner] = 1 - 1.9 * a",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("shape functions of a curved cell", "surface/quadrature",
     "4 * L0 * L1, 4 * L1 * L2, 4 * L2 * L0], dim=1", "4 * L0 * L1, 4 * L1 * L2, 2 * L2 * L0], dim=1",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("mean curvature without the normal's part", "field/field",
     '- torch.einsum("ni,nij,nj->n", n, hessians, n)) / length',
     '+ torch.einsum("ni,nij,nj->n", n, hessians, n)) / length',
     "sensitivity/shape_functionals::mean_curvature_does_not_ask_for_a_distance"),
    ("level of an occupancy", "field/field",
     "- self.level) * self.sign", "+ self.level) * self.sign",
     "field/field::inside_is_negative_for_an_occupancy"),
    ("Newton projection to the surface", "surface/projection",
     "step = -(f / square", "step = (f / square",
     "surface/quadrature::mesh_of_a_sphere_faces_outward_and_lies_on_it"),
    ("right-hand side of a KKT row", "step/least_squares",
     "least_change(factor, C, r - C @ x)", "least_change(factor, C, r + C @ x)",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("multipliers of the constraints", "step/kkt",
     "(vectors[:, keep].T @ gap) / values[keep]", "(vectors[:, keep].T @ gap) * values[keep]",
     "step/factors::the_least_change_solves_the_kkt_system"),
    ("weights on the right-hand side", "step/equations",
     "equations.add_adjoint(self.right, equations.weights * equations.target)",
     "equations.add_adjoint(self.right, equations.target)",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("weights in the normal matrix", "step/equations",
     "return self.matrix * self.weights.sqrt()[:, None]", "return self.matrix * self.weights[:, None]",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("damping of the normal matrix", "step/factors/primal",
     "damped.diagonal().add_(ridge)", "damped.diagonal().add_(2 * ridge)",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("rank by the primal", "step/factors/primal",
     "self._ridge[:, None] * self.inverse(z)", "self.inverse(z)",
     "step/factors::the_rank_is_the_trace_of_what_the_equations_decide"),
    ("damping of the dual", "step/factors/dual",
     "damped.diagonal().add_(1.0)", "damped.diagonal().add_(2.0)",
     "step/factors::the_minimiser_is_that_of_the_stacked_rows"),
    ("sign in Woodbury's formula", "step/factors/dual",
     "return scaled - torch.stack(", "return scaled + torch.stack(",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("damping in conjugate gradients", "step/factors/conjugate_gradients",
     "self._scaled(direction) + direction", "self._scaled(direction)",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("gap in a constraint's row", "evolve/constraints",
     "r = [t - v for t, v in zip(self._targets, self._values, strict=True)]",
     "r = [v - t for t, v in zip(self._targets, self._values, strict=True)]",
     "evolve/constraints::the_row_of_a_constraint_leads_to_its_target"),
    ("direction of the pull to the training codes", "edits/code_prior",
     "away = inverse @ (self.prior.mean.to(self.code) - self.code)",
     "away = inverse @ (self.code - self.prior.mean.to(self.code))",
     "edits/semantic::a_strong_prior_pulls_the_code_to_its_mean"),
    ("sensitivities of the semantic rows", "edits/semantic",
     "self._rows = -rows / lengths[:, None]", "self._rows = rows / lengths[:, None]",
     "edits/semantic::one_step_is_the_ridge_regression_of_the_paper"),
    ("target of the semantic rows", "edits/semantic",
     "inward = (aim * space.normals).sum(dim=1)", "inward = 2 * (aim * space.normals).sum(dim=1)",
     "edits/semantic::one_step_is_the_ridge_regression_of_the_paper"),
    ("placement of a network", "edits/rigid_placement",
     "theta[bias.where] -= turned @ self.translation", "theta[bias.where] += turned @ self.translation",
     "edits/rigid::a_placed_network_has_the_values_of_where_its_points_came_from"),
    ("no reflections in a placement", "edits/rigid_placement",
     "turn[-1] = torch.linalg.det(U @ Vt)", "turn[-1] = 1.0",
     "edits/rigid::a_placement_of_mirrored_points_is_no_reflection"),
    ("direction of mean-curvature flow", "edits/flows",
     "-time * share * (kappa - mean) / left", "time * share * (kappa - mean) / left",
     "edits/smoothing::a_sphere_shrinks_by_its_law"),
    ("bending flow", "edits/flows",
     "(kappa**3 / 2 - total * kappa)", "(kappa**3 - total * kappa)",
     "edits/flows::a_ball_is_at_rest_under_bending"),
    ("slide that keeps the normals", "edits/tangential_motion",
     "inverse = curvatures / (curvatures**2 + least**2)", "inverse = -curvatures / (curvatures**2 + least**2)",
     "edits/tangential_motion::constant_normals_translate_a_convex_shape_as_a_whole"),
    ("slopes of the tangential basis", "step/tangential_basis",
     "waves = -torch.sin(", "waves = torch.sin(",
     "step/deformation::feature_slopes_match_differences"),
    ("length unit of the tangential basis", "step/tangential_basis",
     "dim=2) / self._half", "dim=2)",
     "step/deformation::feature_slopes_match_differences"),
    ("closed form of a network's slopes", "sensitivity/closed_form",
     "+ (bends[k - 1] * back)[:, None]", "- (bends[k - 1] * back)[:, None]",
     "sensitivity/closed_form::closed_form_is_what_automatic_differentiation_gives"),
    ("products of a network's rows", "sensitivity/closed_form",
     "torch.nn.functional.pad(inputs[k], (0, 1), value=1.0)", "torch.nn.functional.pad(inputs[k], (0, 1), value=0.0)",
     "sensitivity/closed_form::gram_matrix_is_that_of_the_rows"),
    ("second derivative of the sine", "models/siren",
     "-(frequency**2) * wave", "(frequency**2) * wave",
     "sensitivity/closed_form::closed_form_is_what_automatic_differentiation_gives"),
    ("falloff of a region", "edits/regions",
     "(10 - 15 * t + 6 * t**2)", "(10 - 15 * t + 5 * t**2)",
     "edits/regions::falloff_sinks_smoothly_to_zero"),
    ("direction of a motion along the normal", "edits/handles",
     "return points + fraction * distance.reshape(-1, 1) * normals",
     "return points - fraction * distance.reshape(-1, 1) * normals",
     "edits/handles::motion_along_normals"),
    ("share of a turn at a fraction", "edits/handles",
     "_rotation_generator(self.rotation, dimension).to(points) * fraction",
     "_rotation_generator(self.rotation, dimension).to(points)",
     "edits/handles::rigid_motion_turns_by_even_angles"),
    ("weight of a handle's displacement", "edits/targets",
     "total = total + weights[:, None] * (handle", "total = total + (handle",
     "edits/targets::a_weight_scales_the_displacement"),
    ("weights of an average of handles", "edits/targets",
     "total += weights[:, None] * handle", "total += handle",
     "edits/targets::an_average_of_two_handles_lies_between_them"),
    ("weight of the points in no region", "edits/targets",
     "torch.where(self.prescribed, 1.0, float(weight))", "torch.where(self.prescribed, 1.0, 1.0)",
     "edits/targets::points_in_no_region_have_the_weight_of_the_rest"),
    ("sign of the motion off the surface", "step/off_surface",
     "target = target - torch.nan_to_num(motion)[nearest]", "target = target + torch.nan_to_num(motion)[nearest]",
     "step/off_surface::a_sphere_told_to_grow_does_so_from_its_off_surface_points_alone"),
]  # fmt: skip

MESHREF = [
    ("half cotangents of the Laplacian", "curvature",
     "half = cot.ravel() / 2", "half = cot.ravel()",
     "mesh_curvature::the_laplacian_is_minus_that_of_libigl"),
    ("cotangents", "curvature",
     "(to_next * to_last).sum(axis=2) / doubled_area", "(to_next * to_last).sum(axis=2) / (2 * doubled_area)",
     "mesh_curvature::the_laplacian_is_minus_that_of_libigl"),
    ("Voronoi areas", "curvature",
     "part = squared * cot / 8", "part = squared * cot / 4",
     "mesh_curvature::voronoi_masses_are_those_of_libigl_and_add_up"),
    ("mass in the mean curvature", "curvature",
     "(laplacian(V, F) @ V) / voronoi_areas(V, F)[:, None]", "(laplacian(V, F) @ V) / lumped_areas(V, F)[:, None]",
     "mesh_curvature::kappa_is_two_over_r_on_a_sphere"),
    ("volume", "check",
     "np.cross(B, C)) / 6)", "np.cross(B, C)) / 3)",
     "mesh_measures::boxes_are_exact"),
    ("a third of the area to each corner", "measures",
     "thirds = np.repeat(face_areas(V, F) / 3, 3)", "thirds = np.repeat(face_areas(V, F) / 2, 3)",
     "mesh_measures::vertex_areas_add_up"),
    ("gradient of the volume", "measures",
     "np.repeat(doubled_area_vectors(V, F) / 6, 3, axis=0)", "np.repeat(doubled_area_vectors(V, F) / 3, 3, axis=0)",
     "mesh_measures::the_gradient_of_the_volume_matches_differences"),
    ("second moment", "measures",
     "six_volumes, corners, corners) / 120", "six_volumes, corners, corners) / 60",
     "mesh_measures::boxes_are_exact"),
    ("centroid", "measures",
     "(4 * six_volumes.sum())", "(3 * six_volumes.sum())",
     "mesh_measures::the_centroid_of_a_pyramid_is_a_quarter_up"),
    ("sphericity", "measures",
     "(6 * abs(volume)) ** (2 / 3)", "(6 * abs(volume)) ** (1 / 3)",
     "mesh_measures::only_the_sphere_has_sphericity_one"),
    ("both halves of J + J^T on a face", "killing",
     "((strain + strain.transpose(0, 2, 1)) ** 2)", "((strain + strain) ** 2)",
     "mesh_killing::rigid_motions_cost_nothing_at_any_resolution"),
    ("entries off the diagonal count twice on a face", "killing",
     "1.0 if a == b else 2.0 for a, b in pairs", "1.0 if a == b else 1.0 for a, b in pairs",
     "mesh_killing::the_matrix_is_the_energy"),
    ("side opposite to a corner", "measures",
     "V[np.roll(F, -2, axis=1)] - V[np.roll(F, -1, axis=1)]", "V[np.roll(F, -1, axis=1)] - V[np.roll(F, -2, axis=1)]",
     "mesh_killing::the_gradient_of_a_linear_displacement_is_its_matrix"),
    ("gradient of a hat function", "killing",
     "np.cross(scaled_normal[:, None, :], opposite)", "np.cross(opposite, scaled_normal[:, None, :])",
     "mesh_killing::the_gradient_of_a_linear_displacement_is_its_matrix"),
    ("factor of spokes and rims in the energy", "killing",
     "return 4 / 3 * total", "return total",
     "mesh_killing::growing_a_unit_sphere_costs_32_pi"),
    ("factor of spokes and rims in the matrix", "killing",
     "_rim_moment_arms(V, F), 4 / 3, 3", "_rim_moment_arms(V, F), 1.0, 3",
     "mesh_killing::the_matrix_is_the_energy"),
    ("moments of a cell", "killing",
     "doubled[:, None, :] / (4 * area)", "doubled[:, None, :] / (2 * area)",
     "mesh_killing::the_matrix_is_the_energy"),
    ("factor of spokes", "killing",
     'return 2 * float(np.einsum("k,kx,kx->"', 'return float(np.einsum("k,kx,kx->"',
     "mesh_killing::growing_a_unit_sphere_costs_32_pi"),
    ("area of the soft handles", "killing",
     "return areas[handles]", "return np.ones(len(handles))",
     "mesh_killing::soft_handles_weigh_by_their_area"),
    ("half cotangents of the ARAP energy", "arap",
     "half = corner_cotangents(V, F) / 2\n    at_rest", "half = corner_cotangents(V, F)\n    at_rest",
     "mesh_arap::doubling_the_size_costs_the_length_of_all_edges"),
    ("no reflections among rotations", "arap",
     "left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]", "left[:, :, 2] *= 1.0",
     "mesh_arap::a_mirrored_mesh_is_not_a_rigid_motion_for_arap"),
    ("direction of the explicit flow", "flow",
     "X - dt * (laplacian(X, F) @ X)", "X + dt * (laplacian(X, F) @ X)",
     "mesh_flow::explicit_spheres_shrink_as_the_square_root_of_time"),
    ("sign in the matrix of the implicit flow", "flow",
     "sparse.diags_array(masses) + dt * L", "sparse.diags_array(masses) - dt * L",
     "mesh_flow::implicit_spheres_do_so_with_order_one_in_the_step"),
    ("stability limit of the explicit flow", "flow",
     "float(2 / eigsh(", "float(4 / eigsh(",
     "mesh_flow::the_explicit_limit_is_that_of_the_largest_eigenvalue"),
    ("sign of the distance", "distance",
     "self._winding_number(points) > 0.5, -1.0, 1.0", "self._winding_number(points) > 0.5, 1.0, -1.0",
     "mesh_distance::the_distance_to_a_cube_is_exact"),
    ("mass in the biharmonic energy", "biharmonic",
     "sparse.diags_array(1 / lumped_areas(V, F))", "sparse.diags_array(lumped_areas(V, F))",
     "mesh_biharmonic::the_free_vertices_balance_on_an_uneven_mesh"),
    ("even sampling of a triangle", "metrics",
     "folded = s + t > 1", "folded = s + t > 2",
     "mesh_metrics::samples_lie_on_the_surface_evenly"),
]  # fmt: skip

MUTATIONS = [*_of("implicit", IMPLICIT), *_of("meshref", MESHREF)]


def main() -> int:
    """Run all mutations, or those whose words are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="only mutations whose file or formula holds one of these words")
    parser.add_argument("--write", action="store_true", help=f"write the table to {PAGE.relative_to(ROOT)}")
    arguments = parser.parse_args()
    chosen = [m for m in MUTATIONS if not arguments.words or any(w in f"{m.path} {m.formula}" for w in arguments.words)]
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        for part in ("implicit", "meshref", "compare", "tests"):
            shutil.copytree(ROOT / part, tree / part, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", tree)
        _import_what_tests_need(tree)
        for test in dict.fromkeys(mutation.test for mutation in chosen):
            if _exit_code(test, tree) != 0:
                raise SystemExit(f"{test} does not pass as it is, so it can tell nothing.")
        results = [(mutation, _caught(mutation, tree)) for mutation in chosen]
    table = _table(results)
    missed = [mutation for mutation, caught in results if not caught]
    print(table)
    print(f"{len(results) - len(missed)} of {len(results)} caught.")
    if arguments.write:
        PAGE.write_text(_page(table, len(results), len(missed)))
    return 1 if missed else 0


def _import_what_tests_need(tree: Path) -> None:
    """Once, here, so that the processes that are forked off need not; nothing of the packages themselves."""
    sys.dont_write_bytecode = True
    os.environ["PYTHONPATH"] = str(tree)
    sys.path[:] = [
        str(tree),
        *(entry for entry in sys.path if Path(entry or ".").resolve() not in (ROOT, ROOT / "tests")),
    ]
    for name in ("torch", "numpy", "scipy.sparse.linalg", "scipy.spatial", "igl", "skimage.measure"):
        importlib.import_module(name)


def _caught(mutation: Mutation, tree: Path) -> bool:
    path = tree / mutation.path
    source = path.read_text()
    if source.count(mutation.old) != 1:
        raise SystemExit(f"{mutation.path} holds {mutation.old!r} {source.count(mutation.old)} times, not once.")
    path.write_text(source.replace(mutation.old, mutation.new))
    start = time.perf_counter()
    code = _exit_code(mutation.test, tree)
    path.write_text(source)
    if code not in (0, 1):
        raise SystemExit(f"{mutation.test} could not be run: exit code {code} of pytest.")
    seconds = time.perf_counter() - start
    print(f"{'caught' if code else 'MISSED'} {seconds:4.0f} s  {mutation.path}: {mutation.formula}", flush=True)
    return code == 1


def _exit_code(test: str, tree: Path) -> int:
    """Of pytest for one test, in a process of its own."""
    process = os.fork()
    if process:
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    code = 3
    try:
        os.chdir(tree)
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        signal.alarm(SECONDS_A_TEST)
        code = int(pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", test]))
    finally:
        os._exit(code)


def _table(results: list[tuple[Mutation, bool]]) -> str:
    rows = ["| file | formula | mutation | test | |", "|---|---|---|---|---|"]
    for m, caught in results:
        test = m.test.split("::")[1].removeprefix("test_").replace("_", " ")
        change = f"`{m.old.strip()}` → `{m.new.strip()}`".replace("|", "\\|").replace("\n", " ")
        rows.append(f"| {m.path} | {m.formula} | {change} | {test} | {'caught' if caught else 'MISSED'} |")
    return "\n".join(rows)


def _page(table: str, total: int, missed: int) -> str:
    return (
        "# Mutations\n\n"
        "Each row breaks one formula, and names the test that fails by it. `python tests/mutations.py --write` makes\n"
        f"this page anew (it forks, so not on Windows). {total - missed} of {total} are caught.\n\n{table}\n"
    )


if __name__ == "__main__":
    sys.exit(main())
