"""Break one formula at a time, a sign, a factor, a weight, and see that a test notices: python tests/mutations.py

Each mutation is made in a copy of the sources, in a process of its own, and the one test named beside it is run. It is
caught if that test fails. Exit code 1 if one is missed.

    python tests/mutations.py                 all of them
    python tests/mutations.py frame flow      those whose file, function or formula holds a word
    python tests/mutations.py --random 3      three, drawn by the sources: the same for the same commit
    python tests/mutations.py --write         those not run since their function or test changed; the page is made anew

What was found is kept in docs/mutations.json after each of them, with hashes of the function and of the test, so a run
that is interrupted goes on where it was, and a page that is older than the sources is known by it.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import hashlib
import importlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("implicit", "meshref", "compare")
PAGE = ROOT / "docs" / "mutations.md"
RESULTS = ROOT / "docs" / "mutations.json"
SECONDS_A_TEST = 900


@dataclass(frozen=True)
class Mutation:
    """One change that makes a formula wrong, and the test that must fail by it.

    Attributes:
        formula: What is broken, in words.
        path: The file.
        function: The function of it, `method` of a class as `Class.method`; empty where the text is in the file once.
        old: Text that occurs exactly once in the function.
        new: What takes its place.
        test: A test file and a test of it, under tests/.
    """

    formula: str
    path: str
    function: str
    old: str
    new: str
    test: str

    def place(self) -> tuple[int, int]:
        """Return where in the file the text stands."""
        source = (ROOT / self.path).read_text()
        start, end = _span(source, self.function) if self.function else (0, len(source))
        times = source.count(self.old, start, end)
        if times != 1:
            raise LookupError(
                f"{self.path}, {self.function or 'all of it'}, holds {self.old!r} {times} times, not once."
            )
        found = source.index(self.old, start, end)
        return found, found + len(self.old)

    def mutated(self) -> str:
        """Return the source of the file with the change made."""
        source = (ROOT / self.path).read_text()
        start, end = self.place()
        return source[:start] + self.new + source[end:]

    def where(self) -> str:
        """Return the function that holds the text, by name even where the row names none; empty between functions."""
        source = (ROOT / self.path).read_text()
        at = self.place()[0]
        spans = [(name, start) for name, (start, end) in _functions(source) if start <= at < end]
        return max(spans, key=lambda span: span[1])[0] if spans else ""

    def hashes(self) -> tuple[str, str]:
        """Return the hashes of the function, or of the text alone between functions, and of the test."""
        source, function = (ROOT / self.path).read_text(), self.where()
        start, end = _span(source, function) if function else self.place()
        path, name = self.test.split("::")
        tests = (ROOT / path).read_text()
        begin, stop = _span(tests, name)
        return _hash(source[start:end]), _hash(tests[begin:stop])


@dataclass(frozen=True)
class Result:
    """How a mutation ended, and of which sources that is true.

    Attributes:
        formula, path, function, old, new, test: The mutation.
        function_hash: Hash of the source of the function before the change.
        test_hash: Hash of the source of the test.
        caught: Whether the test failed.
    """

    formula: str
    path: str
    function: str
    old: str
    new: str
    test: str
    function_hash: str
    test_hash: str
    caught: bool


def result_of(mutation: Mutation, caught: bool) -> Result:
    """Return the result of a mutation of the sources as they are."""
    named = dataclasses.replace(mutation, function=mutation.where())
    return Result(
        **dataclasses.asdict(named), **dict(zip(("function_hash", "test_hash"), mutation.hashes())), caught=caught
    )


def stored() -> list[Result]:
    """Return what was found so far, of whatever sources."""
    return [Result(**row) for row in json.loads(RESULTS.read_text())] if RESULTS.exists() else []


def is_known(mutation: Mutation, results: Iterable[Result]) -> Result | None:
    """Return the result of a mutation if it is among these, of the sources as they are."""
    wanted = result_of(mutation, True)
    return next((result for result in results if dataclasses.replace(result, caught=True) == wanted), None)


@lru_cache
def _functions(source: str) -> list[tuple[str, tuple[int, int]]]:
    """Return the name and the span of each function and method; what is inside a function belongs to it."""
    starts, found = [0], []
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    todo: list[tuple[str, ast.AST]] = [("", ast.parse(source))]
    while todo:
        outer, node = todo.pop()
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef):
                todo.append((f"{outer}{child.name}.", child))
            elif isinstance(child, ast.FunctionDef):
                first = min([child.lineno, *(d.lineno for d in child.decorator_list)])
                found.append((outer + child.name, (starts[first - 1], starts[child.end_lineno or first])))
    return found


def _span(source: str, function: str) -> tuple[int, int]:
    spans = [span for name, span in _functions(source) if name == function]
    if len(spans) != 1:
        raise LookupError(f"There are {len(spans)} functions {function}; name one that is there once.")
    return spans[0]


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _test_file(short: str) -> str:
    """Return "edits/test_rigid.py" of "edits/rigid"."""
    folder, _, name = short.rpartition("/")
    return f"{folder}/test_{name}.py" if folder else f"test_{name}.py"


def _of(package: str, rows: list[tuple[str, str, str, str, str]]) -> list[Mutation]:
    """Return the mutations of one package, their files and tests named without folder and ending.

    A row is: formula, "file" or "file::function", old text, new text, "test file::test".
    """
    found = []
    for formula, place, old, new, short in rows:
        module, _, function = place.partition("::")
        file, name = short.split("::")
        test = f"tests/{package}/{_test_file(file)}::test_{name}"
        found.append(Mutation(formula, f"{package}/{module}.py", function, old, new, test))
    return found


IMPLICIT = [
    ("sign of the boundary sensitivity", "sensitivity/boundary_sensitivity::basis_block",
     "return parameter_gradient(field, points).div_(-length[:, None])",
     "return parameter_gradient(field, points).div_(length[:, None])",
     "sensitivity/boundary_sensitivity::growing_the_radius_moves_a_sphere_outward_by_as_much"),
    ("sign of the normal displacement", "sensitivity/boundary_sensitivity::normal_displacement",
     "return -torch.cat(change) / lengths", "return torch.cat(change) / lengths",
     "sensitivity/boundary_sensitivity::products_agree_with_the_matrix"),
    ("slope of the field in the transposed product", "sensitivity/boundary_sensitivity::adjoint",
     "scaled = -weights / lengths", "scaled = -weights",
     "sensitivity/boundary_sensitivity::products_agree_with_the_matrix"),
    ("quotient rule of the sensitivity's slope", "sensitivity/frame::Frame.quotient_rule",
     "rule[:, 1:, 0] = torch.einsum(", "rule[:, 1:, 0] = -torch.einsum(",
     "step/deformation::slope_rows_match_differences_of_the_normal_speed"),
    ("projection in the slope of the normal", "sensitivity/frame::Frame.normal_slopes",
     "return scaled - self.normals[:, :, None]", "return scaled + self.normals[:, :, None]",
     "step/deformation::strain_rows_match_differences_of_the_displacement"),
    ("slope of the normal in the strain of a tangential motion", "step/strain::normal_slopes",
     "[:, -1, b, :, 0] = -turning[:, b]", "[:, -1, b, :, 0] = turning[:, b]",
     "step/deformation::strain_rows_match_differences_of_the_displacement"),
    ("both halves of J + J^T", "step/strain::sym",
     "return matrix + matrix.transpose(1, 2)", "return matrix",
     "step/deformation::killing_energy_of_a_growing_sphere_is_that_of_its_parts"),
    ("sign of the normal part of a motion", "step/deformation::DeformationSpace.normal_rows",
     ".div_(-length[:, None])", ".div_(length[:, None])",
     "step/deformation::normal_and_tangent_rows_give_the_displacement"),
    ("entries off the diagonal count twice", "step/energies::Killing.rows",
     "(1.0 if a == b else 2.0) * self.share", "(1.0 if a == b else 1.0) * self.share",
     "edits/trained_rigid_step::the_energies_are_those_of_the_rows_of_the_least_squares"),
    ("share of bending and thickness", "step/energies::Killing.share",
     "return self.bending if a < normal else self.thickness", "return self.thickness if a < normal else self.bending",
     "step/deformation::bending_alone_of_a_spherical_harmonic_is_its_dirichlet_energy"),
    ("weights of a target along the normal", "step/energies::NormalTarget.rows",
     "yield Rows(matrix, self.target[where], self.weights[where])",
     "yield Rows(matrix, self.target[where], torch.ones_like(self.weights[where]))",
     "step/deformation::targets_measure_the_weighted_miss"),
    ("sign of the stretch along the surface", "step/strain::tangential_slopes",
     "form.tangential_coefficients[:, :, b, :, 1 + b] = frame.axes",
     "form.tangential_coefficients[:, :, b, :, 1 + b] = -frame.axes",
     "step/deformation::strain_rows_match_differences_of_the_displacement"),
    ("tangential part of a vector", "sensitivity/frame::tangential_component",
     "return vectors - normal_component(vectors, normals)", "return vectors + normal_component(vectors, normals)",
     "step/energies::components_add_up_and_are_orthogonal"),
    ("scale of a target of the field", "step/energies::FieldTarget.rows",
     "matrix.div_(self.scale[where, None])", "matrix.mul_(self.scale[where, None])",
     "step/energies::a_field_target_is_that_of_the_field_anywhere"),
    ("half the cotangent in a cell of spokes and rims", "step/spokes_and_rims::SpokesAndRims.cells",
     "(2 * np.maximum(across, 1e-300)[:, None])",
     "np.maximum(across, 1e-300)[:, None]",
     "step/spokes_and_rims::the_matrix_is_that_of_libigl"),
    ("best rotation by Newton's method", "step/rotations::_newton_turns",
     "B[6] - B[2]",
     "B[2] - B[6]",
     "step/spokes_and_rims::from_near_by_newtons_method_arrives_alone"),
    ("right-hand side of the global step", "step/spokes_and_rims::SpokesAndRims.right_hand_side",
     '"eij,ej->ei"',
     '"eji,ej->ei"',
     "step/spokes_and_rims::the_gradient_is_that_of_the_energy"),
    ("direction in which a volume is held", "step/local_global::_Run._state",
     "one.functional.gradient(u)[solver._free]",
     "u[solver._free]",
     "step/local_global::the_volume_is_held_at_the_minimum_under_it"),
    ("change of the area by a vertex", "step/surface_area::SurfaceArea.gradient",
     "np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)",
     "np.roll(corners, -2, axis=1) - corners",
     "step/local_global::the_area_of_a_box_and_its_change"),
    ("affine maps about their centres", "models/warp::Warp.warped",
     "self.maps[:, D] - (self.centres[:, None] @ turned)[:, 0]",
     "self.maps[:, D]",
     "edits/warp::maps_that_are_all_one_rigid_motion_move_the_field_by_it"),
    ("inverse of the Hessian learned from steps", "step/preconditioned::Descent.direction",
     "(share - float(np.vdot(pair.change, solved)) / pair.product)",
     "share",
     "step/preconditioned::a_quadratic_is_minimised_in_as_many_steps_as_it_has_unknowns"),
    ("motion along the surface in coupled steps", "edits/coupled_rigid::_Motion.displacement",
     "(out - (along * self.normals).sum(axis=1))",
     "(out + (along * self.normals).sum(axis=1))",
     "edits/finite_rigid::coupled_steps_find_what_points_and_field_find_one_after_the_other"),
    ("normals of a scaled surface", "edits/handles::Scaling.turned",
     "vectors / self._factors(vectors)",
     "vectors * self._factors(vectors)",
     "edits/handles::scaling_turns_normals_as_an_ellipsoid_has_them"),
    ("rotation of a point about the corners of its triangle", "step/surface_map::SurfaceMap._from_corners",
     '"nkij,nkj->nki"',
     '"nkji,nkj->nki"',
     "step/surface_map::points_and_normals_go_along_with_a_rigid_motion"),
    ("rotations of a planar shape that stay in the plane", "step/planar_rigidity::PlanarSpokesAndRims.covariances",
     "found[:, 2, 2] = self._upright",
     "found[:, 2, 2] = 0.0",
     "step/planar_rigidity::a_reflection_is_no_rigid_motion"),
    ("what lies inside a curve in its energy", "step/planar_rigidity::PlanarSpokesAndRims.of_curve",
     "own.todense() - across @ solved",
     "own.todense() + across @ solved",
     "step/planar_rigidity::the_energy_of_the_boundary_is_that_of_the_best_inside"),
    ("derivative of the area inside a curve", "step/planar_rigidity::EnclosedArea.gradient",
     "-sign * vertices[other, 0]",
     "sign * vertices[other, 0]",
     "step/planar_rigidity::the_area_has_its_derivative_and_is_reached"),
    ("normals of a field in the metric of the energy", "step/rigidity_target::RigidityTarget.metric",
     "axis @ self.laplacian @ axis",
     "self.laplacian",
     "step/rigidity_target::the_energy_of_gaps_is_that_of_the_motion_along_the_normals"),
    ("slope that a motion is to have", "step/energies::Smoothness.rows",
     'target = torch.einsum("nai,ni->na", axes, self.target[where])',
     'target = -torch.einsum("nai,ni->na", axes, self.target[where])',
     "step/energies::smoothness_is_the_dirichlet_energy"),
    ("weights of a target for vectors", "step/energies::VectorTarget.rows",
     "self.weights[where].repeat_interleave(along.shape[1])", "self.weights[where].repeat(along.shape[1])",
     "step/deformation::targets_measure_the_weighted_miss"),
    ("shape gradient of the volume", "sensitivity/shape_functionals::Volume.shape_gradient",
     "return torch.ones_like(sample.weights)", "return 2 * torch.ones_like(sample.weights)",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("shape gradient of the area", "sensitivity/shape_functionals::Area.shape_gradient",
     "return surface_mean_curvature(field, sample.points)\n", "return -surface_mean_curvature(field, sample.points)\n",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("curvature in the shape gradient of a surface integral",
     "sensitivity/shape_functionals::SurfaceIntegral.shape_gradient",
     ".sum(dim=1) + surface_mean_curvature(field, sample.points) * values",
     ".sum(dim=1) - surface_mean_curvature(field, sample.points) * values",
     "sensitivity/shape_functionals::sensitivity_matches_differences"),
    ("divergence theorem for the volume", "sensitivity/shape_functionals::volume_terms",
     ".sum(dim=1) / sample.points.shape[1]", ".sum(dim=1) / 2",
     "sensitivity/shape_functionals::values_on_a_ball"),
    ("weight along the ray of a volume integral", "sensitivity/shape_functionals::VolumeIntegral.value",
     "t ** (field.dimension - 1)", "t**field.dimension",
     "sensitivity/shape_functionals::volume_is_the_volume_integral_of_one"),
    ("distance from the cells to the surface", "sensitivity/shape_functionals::_Distance.of",
     "distance = (-value / slope)", "distance = (value / slope)",
     "sensitivity/shape_functionals::the_distance_to_the_surface_takes_most_of_the_cells_error_out"),
    ("area carried to the surface", "sensitivity/shape_functionals::_Distance.surface_weights",
     "(1 + curvature.to(self.weights) * self.distance)",
     "(1 - curvature.to(self.weights) * self.distance)",
     "sensitivity/shape_functionals::the_distance_to_the_surface_takes_most_of_the_cells_error_out"),
    ("weights of the quadrature", "surface/quadrature::_triangle_rule",
     "weights.append(w / 2)", "weights.append(w)",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("points of the quadrature", "surface/quadrature::_triangle_rule",
     "point[corner] = 1 - 2 * a", "point[corner] = 1 - 1.9 * a",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("shape functions of a curved cell", "surface/quadrature::_triangle_shapes",
     "4 * L0 * L1, 4 * L1 * L2, 4 * L2 * L0], dim=1", "4 * L0 * L1, 4 * L1 * L2, 2 * L2 * L0], dim=1",
     "surface/quadrature::torus_area_and_volume_are_within_1e_5"),
    ("mean curvature without the normal's part", "field/field::Field.mean_curvature",
     '- torch.einsum("ni,nij,nj->n", n, hessians, n)) / length',
     '+ torch.einsum("ni,nij,nj->n", n, hessians, n)) / length',
     "sensitivity/shape_functionals::mean_curvature_does_not_ask_for_a_distance"),
    ("level of an occupancy", "field/field::Field.function",
     "- self.level) * self.sign", "+ self.level) * self.sign",
     "field/field::inside_is_negative_for_an_occupancy"),
    ("Newton projection to the surface", "surface/projection::_newton",
     "step = -(f / square", "step = (f / square",
     "surface/projection::newtons_method_alone_takes_points_to_a_sphere"),
    ("which half of a bracket holds the zero", "surface/bracketing::bracketed_zeros",
     "same = (f < 0) == (ha < 0)", "same = (f < 0) != (ha < 0)",
     "surface/bracketing::the_zero_is_that_of_brents_method"),
    ("where the tangents at a crease meet", "surface/creases::_apex",
     "-aw * bu / det, au * bu * length / det", "-aw * bu / det, au * bw * length / det",
     "surface/extraction::area_and_volume_of_a_polytope_are_of_second_order"),
    ("right-hand side of a KKT row", "step/least_squares::Factorised.solve",
     "least_change(factor, C, r - C @ x)", "least_change(factor, C, r + C @ x)",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("multipliers of the constraints", "step/kkt::least_change",
     "(vectors[:, keep].T @ gap) / values[keep]", "(vectors[:, keep].T @ gap) * values[keep]",
     "step/factors::the_least_change_solves_the_kkt_system"),
    ("weights on the right-hand side", "step/equations::Equations._sum",
     "equations.add_adjoint(self.right, equations.weights * equations.target)",
     "equations.add_adjoint(self.right, equations.target)",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("weights in the normal matrix", "step/equations::Rows.rooted",
     "return self.matrix * self.weights.sqrt()[:, None]", "return self.matrix * self.weights[:, None]",
     "step/least_squares::the_smaller_form_is_factored_and_solves_the_kkt_system"),
    ("damping of the normal matrix", "step/factors/primal::Primal.of",
     "damped.diagonal().add_(ridge)", "damped.diagonal().add_(2 * ridge)",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("rank by the primal", "step/factors/primal::Primal.rank",
     "self._ridge[:, None] * self.inverse(z)", "self.inverse(z)",
     "step/factors::the_rank_is_the_trace_of_what_the_equations_decide"),
    ("damping of the dual", "step/factors/dual::Dual.of",
     "gram.diagonal().add_(1.0)", "gram.diagonal().add_(2.0)",
     "step/factors::the_minimiser_is_that_of_the_stacked_rows"),
    ("sign in Woodbury's formula", "step/factors/dual::Dual.inverse",
     "return scaled - torch.stack(", "return scaled + torch.stack(",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("damping in conjugate gradients", "step/factors/conjugate_gradients::ConjugateGradients._one",
     "self._scaled(direction) + direction", "self._scaled(direction)",
     "step/factors::the_inverse_is_that_of_the_dense_matrix"),
    ("gap in a constraint's row", "evolve/constraints::ConstraintSet.linearised",
     "gap = [t - v for t, v in zip(self.targets, measured.values, strict=True)]",
     "gap = [v - t for t, v in zip(self.targets, measured.values, strict=True)]",
     "evolve/constraints::the_row_of_a_constraint_leads_to_its_target"),
    ("estimated error of what is held", "evolve/constraints::ConstraintSet.error",
     "max((a + b for a, b", "max((a - b for a, b",
     "sensitivity/integral_error::an_edit_says_by_how_much_it_does_not_know_what_it_holds"),
    ("density of what is unseen", "sensitivity/shape_functionals::VolumeIntegral.unseen",
     "parts.volumes @", "parts.areas @",
     "sensitivity/integral_error::a_density_counts_in_what_is_unseen"),
    ("side of a thin sheet that a vertex belongs to", "surface/extraction::on_their_side",
     "* outward).sum(dim=1) < 0)", "* outward).sum(dim=1) > 1e9)",
     "surface/extraction::both_sides_of_a_sheet_thinner_than_a_cell_keep_their_vertices"),
    ("which bounds a step would break", "evolve/constraints::LinearConstraints.active",
     "((self.matrix @ x - self.gap) * self.signs < 0)", "((self.matrix @ x - self.gap) * self.signs > 0)",
     "evolve/constraints::hard_rows_take_the_nearest_point_that_the_bounds_allow"),
    ("projection on the kernel of the constraints", "evolve/constraints::KernelProjection.solve",
     "x - torch.linalg.pinv(linear.matrix)", "x + torch.linalg.pinv(linear.matrix)",
     "evolve/constraints::the_projection_leaves_the_functionals_as_they_are_to_first_order"),
    ("scale of a penalty", "evolve/constraints::Penalty.penalty_rows",
     "linear.gap / linear.scales, price", "linear.gap, price",
     "evolve/constraints::a_penalty_weighs_squared_relative_gaps_against_the_step"),
    ("bounds that are met", "evolve/constraints::ConstraintSet._gaps",
     "g if s == 0 or g * s > 0 else 0.0", "g if s == 0 or g * s < 0 else 0.0",
     "evolve/constraints::the_violation_is_the_gap_over_the_target_where_the_bound_is_broken"),
    ("direction of the damping", "evolve/damping::AdaptiveDamping.increase",
     "value=self.current * FACTOR", "value=self.current / FACTOR",
     "evolve/damping::damping_grows_and_falls_by_half_a_decade"),
    ("linearisation error", "evolve/damping::linearisation_error",
     "squares = (achieved - predicted)[arrived]", "squares = achieved[arrived]",
     "evolve/damping::points_sent_along_a_tangent_miss_a_sphere_by_its_sagitta"),
    ("what a step may miss of its prediction", "evolve/trial::allowed_miss",
     "undone = min(trial.solution.residual, UNDONE * size)", "undone = max(trial.solution.residual, UNDONE * size)",
     "evolve/trial::the_damping_grows_until_the_exponential_is_straight_enough"),
    ("where a correction brings the surface", "evolve/trial::normal_correction",
     "goal = points + trial.predicted[:count]", "goal = points - trial.predicted[:count]",
     "evolve/trial::what_a_step_misses_of_a_translation_is_made_up_along_the_normals"),
    ("part of a step that divides nothing", "evolve/pieces::undivided_part",
     "split(part * x)", "split(x / part)",
     "evolve/pieces::the_largest_part_of_a_step_is_taken_that_divides_nothing"),
    ("pieces on a finer mesh", "surface/topology::confirmed_topology",
     "if before is None or found.same_type(before):", "if before is None or not found.same_type(before):",
     "evolve/pieces::pieces_that_a_coarse_mesh_joins_are_told_apart_by_a_finer_one"),
    ("displacement of the starting points", "evolve/evolve::evolve",
     "displacement=state.points - start.points", "displacement=start.points - state.points",
     "evolve/evolve::a_ball_grows_by_what_each_step_asks_and_its_points_ride_along"),
    ("restoration at the end of a step", "evolve/evolve::Loop._restored",
     "return replace(moved, x=x, measured=measured)", "return replace(moved, measured=measured)",
     "evolve/evolve::a_volume_is_restored_within_each_step"),
    ("sign of the error field", "evolve/edit::Edit.error_field",
     "gap = ((surface - goal) * facing)", "gap = ((goal - surface) * facing)",
     "evolve/edit::the_error_field_of_a_ball_is_its_missing_radius"),
    ("order of the facts in a status", "evolve/edit::edit_status",
     "if ended is EditStatus.DONE and more_pieces:", "if more_pieces:",
     "evolve/edit::the_facts_decide_the_status"),
    ("motion along the surface in a prediction", "step/problem::predicted_displacement",
     "displacement[: len(along)] + along", "displacement[: len(along)] - along",
     "step/problem::tangential_motion_adds_to_that_of_the_space"),
    ("shares of the parts of a geometric edit", "edits/geometric_parts::PartSchedule.advance",
     "now + left / more", "now + left / (more + 1)",
     "evolve/evolve::equal_parts_and_parts_by_the_error_end_at_one"),
    ("direction of the pull to the training codes", "edits/code_prior::_Pull.rows",
     "away = inverse @ (self.prior.mean.to(self.code) - self.code)",
     "away = inverse @ (self.code - self.prior.mean.to(self.code))",
     "edits/semantic::a_strong_prior_pulls_the_code_to_its_mean"),
    ("sensitivities of the semantic rows", "edits/semantic::PointSpace._linearise",
     "self._rows = -rows / lengths[:, None]", "self._rows = rows / lengths[:, None]",
     "edits/semantic::one_step_is_the_ridge_regression_of_the_paper"),
    ("target of the semantic rows", "edits/semantic::SemanticOperation.step",
     "inward = (aim * space.normals).sum(dim=1)", "inward = 2 * (aim * space.normals).sum(dim=1)",
     "edits/semantic::one_step_is_the_ridge_regression_of_the_paper"),
    ("placement of a network", "sensitivity/moved_as_a_whole::moved_as_a_whole",
     "constant @ (part - new) - translation @ turned", "constant @ (part - new) + translation @ turned",
     "edits/rigid::a_placed_network_has_the_values_of_where_its_points_came_from"),
    ("no reflections in a placement", "edits/rigid_placement::Placement.fitting",
     "turn[-1] = torch.linalg.det(U @ Vt)", "turn[-1] = 1.0",
     "edits/rigid::a_placement_of_mirrored_points_is_no_reflection"),
    ("direction of mean-curvature flow", "edits/flows::MeanCurvature.energies",
     "-time * share * (kappa - mean) / left", "time * share * (kappa - mean) / left",
     "edits/smoothing::a_sphere_shrinks_by_its_law"),
    ("bending flow", "edits/flows::Bending.energies",
     "(kappa**3 / 2 - total * kappa)", "(kappa**3 - total * kappa)",
     "edits/flows::a_ball_is_at_rest_under_bending"),
    ("first variation of area", "sensitivity/weak_curvature::WeakSurface.curvature_vectors",
     "self._gathered(np.cross(self.cell_normals[:, None, :], self._opposite) / 2)",
     "self._gathered(np.cross(self.cell_normals[:, None, :], self._opposite))",
     "sensitivity/weak_curvature::the_curvature_vector_is_the_first_variation_of_area"),
    ("mixed Voronoi areas", "sensitivity/weak_curvature::WeakSurface.masses",
     "np.where(obtuse, 1 / 2, 1 / 4)", "np.where(obtuse, 1 / 4, 1 / 2)",
     "sensitivity/weak_curvature::the_masses_share_out_the_area_and_are_positive"),
    ("angle that is missing at a vertex", "sensitivity/weak_curvature::WeakSurface.integrated_gauss_curvature",
     "2 * np.pi - self._gathered(angles)", "np.pi - self._gathered(angles)",
     "sensitivity/weak_curvature::gauss_curvature_adds_up_to_the_euler_number"),
    ("principal curvatures in weak form", "sensitivity/weak_curvature::WeakSurface.squared_curvatures",
     "self.mean_curvature**2 - 2 * gauss", "self.mean_curvature**2 - gauss",
     "sensitivity/weak_curvature::squared_curvatures_of_a_ball_are_two_over_the_squared_radius"),
    ("curvature averaged over cells", "sensitivity/weak_curvature::WeakSurface._heat_step",
     "sparse.diags_array(self.masses) + spread", "sparse.diags_array(2 * self.masses) + spread",
     "sensitivity/weak_curvature::averaged_curvature_of_a_torus_tends_to_its_closed_form"),
    ("motion of facets along the normals of the mesh", "sensitivity/weak_curvature::weak_mean_curvature",
     "return mesh.at(points, mesh.mean_curvature) / cosines", "return mesh.at(points, mesh.mean_curvature) * cosines",
     "sensitivity/weak_curvature::area_of_a_polytope_changes_with_scale_and_place_as_it_must"),
    ("turning that second derivatives explain", "sensitivity/pointwise_curvature::normal_turning",
     "(slopes[0] + 4 * slopes[1] + slopes[2]) / 3", "(slopes[0] + slopes[1] + slopes[2]) / 3",
     "sensitivity/weak_curvature::second_derivatives_tell_how_smooth_surfaces_bend"),
    ("Dirichlet energy on a mesh", "sensitivity/weak_curvature::WeakSurface._hat_gradients",
     "self._opposite) / (2 * size)", "self._opposite) / size",
     "step/mesh_energies::the_dirichlet_energy_of_a_shifted_ball_tends_to_its_closed_form"),
    ("best rotation of a face", "step/mesh_killing::MeshKilling._rotation_entries",
     "(along_e * f - along_f * e) / 2", "along_e * f - along_f * e",
     "step/mesh_energies::a_rigid_motion_costs_nothing"),
    ("shear in the membrane energy", "step/mesh_killing::MeshKilling._strain_entries",
     "2**0.5 * root * shear", "root * shear",
     "step/mesh_energies::the_membrane_energy_of_stretching_a_ball_along_an_axis_has_its_closed_form"),
    ("what vertices share of the bending", "step/mesh_killing::MeshKilling.matrix",
     "weight / 3 * (joined.T @ joined)", "weight * (joined.T @ joined)",
     "step/vertex_equations::the_matrix_along_axes_has_the_energy_of_the_displacement"),
    ("compliance in the equations of the vertices", "step/vertex_equations::VertexFactor._solve",
     "product + self._damping * yielding", "product + yielding",
     "step/vertex_equations::the_minimiser_is_that_of_the_dense_least_squares"),
    ("least energy by the dual", "step/vertex_equations::VertexFactor.minimiser",
     "float(y @ c + c @ left)", "float(y @ c + 2 * (c @ left))",
     "step/vertex_equations::the_gap_to_the_least_energy_is_not_above_what_is_told"),
    ("what the rows do not make of a right-hand side", "step/vertex_equations::VertexFactor._one",
     "yielding - rows.times(beyond)", "yielding",
     "step/vertex_equations::functionals_are_met_by_the_least_change_of_the_dense_system"),
    ("slopes between the vertices", "step/vertex_motion::VertexMotion._between",
     "slopes, ways) / 2", "slopes, ways)",
     "step/vertex_equations::between_the_vertices_rigid_motions_are_exact_and_others_of_third_order"),
    ("products of rows with others added", "step/point_rows::PointRows.gram",
     "mixed + mixed.T", "mixed",
     "step/vertex_equations::rows_with_others_added_have_the_products_of_their_matrix"),
    ("triangular factor of the mesh's energy", "step/mesh_killing::MeshKilling._factor",
     "np.sqrt(pivots)", "pivots",
     "step/mesh_energies::the_rows_have_the_energy_of_the_displacement_they_stand_for"),
    ("direction of mean-curvature flow in weak form", "edits/flows::MeanCurvature.weak_energies",
     "-time * share * (kappa - mean) / left", "time * share * (kappa - mean) / left",
     "edits/weak_smoothing::a_round_polytope_shrinks_by_the_law_of_its_ball"),
    ("bending flow in weak form", "edits/flows::Bending.weak_energies",
     "(kappa**3 / 2 - total * kappa)", "(kappa**3 - total * kappa)",
     "edits/weak_smoothing::a_round_polytope_is_nearly_at_rest_under_bending"),
    ("a surface that stood still", "edits/flow_promises::_stood_still",
     "if moved >= STOOD_STILL * wanted:", "if moved >= 0 * wanted:",
     "edits/weak_smoothing::points_see_no_curvature_of_a_polytope_and_it_is_said"),
    ("slide that keeps the normals", "edits/tangential_motion::ConstantNormals.__call__",
     "inverse = curvatures / (curvatures**2 + least**2)", "inverse = -curvatures / (curvatures**2 + least**2)",
     "edits/tangential_motion::constant_normals_translate_a_convex_shape_as_a_whole"),
    ("slopes of the tangential basis", "step/tangential_basis::CosineFeatures.slopes",
     "waves = -torch.sin(", "waves = torch.sin(",
     "step/deformation::feature_slopes_match_differences"),
    ("length unit of the tangential basis", "step/tangential_basis::CosineFeatures.slopes",
     "dim=2) / self._half", "dim=2)",
     "step/deformation::feature_slopes_match_differences"),
    ("closed form of a network's slopes", "sensitivity/nodes::Elementwise.pull",
     "scaled(here.moved[0], second * e[0])", "scaled(here.moved[0], -second * e[0])",
     "sensitivity/closed_form::closed_form_is_what_automatic_differentiation_gives"),
    ("products of a network's rows", "sensitivity/row_factors::_padded",
     "value=float(ones)", "value=0.0",
     "sensitivity/closed_form::gram_matrix_is_that_of_the_rows"),
    ("products of rows at two parameters", "sensitivity/row_products::_add_normed",
     "(-1.0, mixed * s, other_q * other_s)", "(-1.0, q * s, other_q * other_s)",
     "sensitivity/row_products::products_of_rows_at_two_parameters_are_those_of_the_rows"),
    ("combinations of sensitivities of length one", "step/parameter_basis::PointSensitivities.__init__",
     "/ eigenvalues[kept].sqrt()", "/ eigenvalues[kept]",
     "step/parameter_basis::both_forms_span_the_same_changes_by_orthonormal_ones"),
    ("products of rows under weight norm", "sensitivity/row_factors::RowFactors._kernel",
     "(-1.0, q * s)", "(1.0, q * s)",
     "sensitivity/closed_form::products_of_factors_are_those_of_the_rows"),
    ("second derivative of the sine", "sensitivity/elementwise::_sin",
     "return wave, torch.cos(z), -wave", "return wave, torch.cos(z), wave",
     "sensitivity/closed_form::closed_form_is_what_automatic_differentiation_gives"),
    ("falloff of a region", "edits/regions::_sink",
     "(10 - 15 * t + 6 * t**2)", "(10 - 15 * t + 5 * t**2)",
     "edits/regions::falloff_sinks_smoothly_to_zero"),
    ("direction of a motion along the normal", "edits/handles::Along.at",
     "return points + fraction * distance.reshape(-1, 1) * normals",
     "return points - fraction * distance.reshape(-1, 1) * normals",
     "edits/handles::motion_along_normals"),
    ("share of a turn at a fraction", "edits/handles::RigidMotion.at",
     "_rotation_generator(self.rotation, dimension).to(points) * fraction",
     "_rotation_generator(self.rotation, dimension).to(points)",
     "edits/handles::rigid_motion_turns_by_even_angles"),
    ("weight of a handle's displacement", "edits/targets::SummedTargets.displacement",
     "total = total + weights[:, None] * (handle", "total = total + (handle",
     "edits/targets::a_weight_scales_the_displacement"),
    ("weights of an average of handles", "edits/targets::AveragedTargets.positions",
     "total += weights[:, None] * handle", "total += handle",
     "edits/targets::an_average_of_two_handles_lies_between_them"),
    ("weight of the points in no region", "edits/targets::SummedTargets.__init__",
     "torch.where(self.prescribed, 1.0, float(weight))", "torch.where(self.prescribed, 1.0, 1.0)",
     "edits/targets::points_in_no_region_have_the_weight_of_the_rest"),
    ("sign of the motion off the surface", "step/off_surface::off_surface",
     "target = target - torch.nan_to_num(motion)[nearest]", "target = target + torch.nan_to_num(motion)[nearest]",
     "step/off_surface::a_sphere_told_to_grow_does_so_from_its_off_surface_points_alone"),
]  # fmt: skip

MESHREF = [
    ("half cotangents of the Laplacian", "curvature::laplacian",
     "half = cot.ravel() / 2", "half = cot.ravel()",
     "mesh_curvature::the_laplacian_is_minus_that_of_libigl"),
    ("cotangents", "curvature::corner_cotangents",
     "(to_next * to_last).sum(axis=2) / doubled_area", "(to_next * to_last).sum(axis=2) / (2 * doubled_area)",
     "mesh_curvature::the_laplacian_is_minus_that_of_libigl"),
    ("Voronoi areas", "curvature::voronoi_areas",
     "part = squared * cot / 8", "part = squared * cot / 4",
     "mesh_curvature::voronoi_masses_are_those_of_libigl_and_add_up"),
    ("mass in the mean curvature", "curvature::mean_curvature",
     "(laplacian(V, F) @ V) / voronoi_areas(V, F)[:, None]", "(laplacian(V, F) @ V) / lumped_areas(V, F)[:, None]",
     "mesh_curvature::kappa_is_two_over_r_on_a_sphere"),
    ("volume", "check::signed_volume",
     "np.cross(B, C)) / 6)", "np.cross(B, C)) / 3)",
     "mesh_measures::boxes_are_exact"),
    ("a third of the area to each corner", "measures::lumped_areas",
     "thirds = np.repeat(face_areas(V, F) / 3, 3)", "thirds = np.repeat(face_areas(V, F) / 2, 3)",
     "mesh_measures::vertex_areas_add_up"),
    ("gradient of the volume", "measures::volume_gradient",
     "np.repeat(doubled_area_vectors(V, F) / 6, 3, axis=0)", "np.repeat(doubled_area_vectors(V, F) / 3, 3, axis=0)",
     "mesh_measures::the_gradient_of_the_volume_matches_differences"),
    ("second moment", "measures::second_moment",
     "six_volumes, corners, corners) / 120", "six_volumes, corners, corners) / 60",
     "mesh_measures::boxes_are_exact"),
    ("centroid", "measures::solid_centroid",
     "(4 * six_volumes.sum())", "(3 * six_volumes.sum())",
     "mesh_measures::the_centroid_of_a_pyramid_is_a_quarter_up"),
    ("sphericity", "measures::sphericity_of",
     "(6 * abs(volume)) ** (2 / 3)", "(6 * abs(volume)) ** (1 / 3)",
     "mesh_measures::only_the_sphere_has_sphericity_one"),
    ("both halves of J + J^T on a face", "killing::_membrane_density",
     "((strain + strain.transpose(0, 2, 1)) ** 2)", "((strain + strain) ** 2)",
     "mesh_killing::rigid_motions_cost_nothing_at_any_resolution"),
    ("entries off the diagonal count twice on a face", "killing::_strain_operator",
     "1.0 if a == b else 2.0 for a, b in pairs", "1.0 if a == b else 1.0 for a, b in pairs",
     "mesh_killing::the_matrix_is_the_energy"),
    ("side opposite to a corner", "measures::opposite_sides",
     "V[np.roll(F, -2, axis=1)] - V[np.roll(F, -1, axis=1)]", "V[np.roll(F, -1, axis=1)] - V[np.roll(F, -2, axis=1)]",
     "mesh_killing::the_gradient_of_a_linear_displacement_is_its_matrix"),
    ("gradient of a hat function", "killing::hat_gradients",
     "np.cross(scaled_normal[:, None, :], opposite)", "np.cross(opposite, scaled_normal[:, None, :])",
     "mesh_killing::the_gradient_of_a_linear_displacement_is_its_matrix"),
    ("factor of spokes and rims in the energy", "killing::_spokes_and_rims_energy",
     "return 4 / 3 * total", "return total",
     "mesh_killing::growing_a_unit_sphere_costs_32_pi"),
    ("factor of spokes and rims in the matrix", "killing::_cell_matrix",
     "_rim_moment_arms(V, F), 4 / 3, 3", "_rim_moment_arms(V, F), 1.0, 3",
     "mesh_killing::the_matrix_is_the_energy"),
    ("moments of a cell", "killing::_rim_moments",
     "doubled[:, None, :] / (4 * area)", "doubled[:, None, :] / (2 * area)",
     "mesh_killing::the_matrix_is_the_energy"),
    ("factor of spokes", "killing::_spokes_energy",
     'return 2 * float(np.einsum("k,kx,kx->"', 'return float(np.einsum("k,kx,kx->"',
     "mesh_killing::growing_a_unit_sphere_costs_32_pi"),
    ("area of the soft handles", "springs::spring_weights",
     "return areas[handles]", "return np.ones(len(handles))",
     "mesh_killing::soft_handles_weigh_by_their_area"),
    ("half cotangents of the ARAP energy", "arap::_energy",
     "half = corner_cotangents(V, F) / 2\n    at_rest", "half = corner_cotangents(V, F)\n    at_rest",
     "mesh_arap::doubling_the_size_costs_the_length_of_all_edges"),
    ("no reflections among rotations", "rotations::_from_singular_values",
     "left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]", "left[:, :, 2] *= 1.0",
     "mesh_arap::a_mirrored_mesh_is_not_a_rigid_motion_for_arap"),
    ("global step of the ARAP iteration", "arap::_cell_matrices",
     "3 * laplacian(V, F)", "2 * laplacian(V, F)",
     "mesh_arap::a_plain_iteration_is_libigls"),
    ("springs of the ARAP iteration", "arap::_Course._state",
     "springs[:, None] * pulled", "springs[:, None] * u",
     "mesh_arap::springs_are_at_the_minimum_of_energy_and_pull"),
    ("steps that have more energy", "arap::_Course._step",
     "if after.energy <=", "if -np.inf <=",
     "mesh_arap::the_energy_never_rises_however_far_the_start"),
    ("best rotation by Newton's method", "rotations::_newton_turn",
     "definite = (p > 0) & ", "definite = (p > -np.inf) | ",
     "mesh_rotations::a_start_changes_the_way_and_not_the_answer"),
    ("second loop of quasi-Newton directions", "quasi_newton::QuasiNewton.direction",
     "(part - float(", "(part + float(",
     "mesh_quasi_newton::a_quadratic_is_minimised_in_as_many_steps_as_unknowns"),
    ("direction of the explicit flow", "flow::_Flow._step",
     "X - dt * (laplacian(X, F) @ X)", "X + dt * (laplacian(X, F) @ X)",
     "mesh_flow::explicit_spheres_shrink_as_the_square_root_of_time"),
    ("sign in the matrix of the implicit flow", "flow::_Flow._step",
     "sparse.diags_array(masses) + dt * L", "sparse.diags_array(masses) - dt * L",
     "mesh_flow::implicit_spheres_do_so_with_order_one_in_the_step"),
    ("area that grows in a flow", "flow::_Flow._kept",
     "area <= self._least_area * (1 + GROWTH) else", "True else",
     "mesh_flow::rescaling_a_thin_torus_is_refused_and_a_uniform_speed_is_not"),
    ("extrapolation to steps of length zero", "flow::converged_curvature_flow",
     "X = 2 * flow.V - last.V", "X = flow.V",
     "mesh_flow::a_converged_flow_is_that_of_many_steps_and_its_estimate_is_honest"),
    ("stability limit of the explicit flow", "flow::explicit_step_limit",
     "float(2 / eigsh(", "float(4 / eigsh(",
     "mesh_flow::the_explicit_limit_is_that_of_the_largest_eigenvalue"),
    ("sign of the distance", "distance::SignedDistanceQuery.__call__",
     "self._winding_number(points) > 0.5, -1.0, 1.0", "self._winding_number(points) > 0.5, 1.0, -1.0",
     "mesh_distance::the_distance_to_a_cube_is_exact"),
    ("mass in the biharmonic energy", "biharmonic::biharmonic",
     "sparse.diags_array(1 / lumped_areas(V, F))", "sparse.diags_array(lumped_areas(V, F))",
     "mesh_biharmonic::the_free_vertices_balance_on_an_uneven_mesh"),
    ("even sampling of a triangle", "metrics::sample_mesh",
     "folded = s + t > 1", "folded = s + t > 2",
     "mesh_metrics::samples_lie_on_the_surface_evenly"),
]  # fmt: skip

MUTATIONS = [*_of("implicit", IMPLICIT), *_of("meshref", MESHREF)]


def main() -> int:
    """Run all mutations, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="only mutations whose file, function or formula holds one of these")
    parser.add_argument("--random", type=int, metavar="N", help="so many of them, the same for the same sources")
    parser.add_argument(
        "--write", action="store_true", help=f"only what is not in {RESULTS.name} yet; {PAGE.name} anew"
    )
    parser.add_argument("--processes", type=int, default=2, help="how many to run at a time (2)")
    parser.add_argument("--suite-passed", action="store_true", help="do not run the tests as they are first")
    arguments = parser.parse_args()
    chosen = [
        m
        for m in MUTATIONS
        if not arguments.words or any(w in f"{m.path} {m.where()} {m.formula}" for w in arguments.words)
    ]
    if arguments.random:
        chosen = at_random(chosen, arguments.random)
    found = stored()
    if arguments.write:
        chosen = [mutation for mutation in chosen if is_known(mutation, found) is None]
    missed = 0
    # Those at random are run by the suite, which runs the tests as they are as well.
    tests_first = not (arguments.random or arguments.suite_passed)
    for mutation, caught in run(chosen, arguments.processes, tests_first):
        missed += not caught
        print(f"{'caught' if caught else 'MISSED'}  {mutation.path} {mutation.where()}: {mutation.formula}", flush=True)
        if arguments.write:
            found.append(result_of(mutation, caught))
            _keep(found)
    print(f"{len(chosen) - missed} of {len(chosen)} caught.")
    if arguments.write:
        current = _keep(found)
        missed = sum(not result.caught for result in current)
        PAGE.write_text(page(current))
        print(f"{len(MUTATIONS) - len(current)} are still to be run.")
    return 1 if missed else 0


def at_random(mutations: list[Mutation], number: int) -> list[Mutation]:
    """Return so many of them, drawn with a hash of all sources of the packages for a seed."""
    files = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    seed = _hash("".join(path.read_text() for path in files))
    print(f"seed {seed}")
    return random.Random(seed).sample(mutations, number)


def _keep(found: list[Result]) -> list[Result]:
    """Write down the results that are true of the sources as they are, in the order of the list, and return them."""
    current = [result for mutation in MUTATIONS if (result := is_known(mutation, found))]
    half = RESULTS.with_suffix(".part")
    half.write_text(json.dumps([dataclasses.asdict(result) for result in current], indent=1, ensure_ascii=False) + "\n")
    half.replace(RESULTS)
    return current


def run(mutations: list[Mutation], processes: int, tests_first: bool) -> Iterator[tuple[Mutation, bool]]:
    """Yield each mutation and whether it is caught, as they end; first see that the tests pass, if asked."""
    with tempfile.TemporaryDirectory() as folder:
        trees = [_copy_of_sources(Path(folder) / str(k)) for k in range(max(1, min(processes, len(mutations))))]
        _import_what_tests_need()
        tests = dict.fromkeys(mutation.test for mutation in mutations if tests_first)
        for (_, test), code in _exit_codes([(None, test) for test in tests], trees):
            if code != 0:
                raise SystemExit(f"{test} does not pass as it is, so it can tell nothing: exit code {code} of pytest.")
        for (mutation, test), code in _exit_codes([(m, m.test) for m in mutations], trees):
            if code not in (0, 1):
                raise SystemExit(f"{test} could not be run: exit code {code} of pytest.")
            assert mutation is not None
            yield mutation, code == 1


Job = tuple[Mutation | None, str]


def _exit_codes(jobs: list[Job], trees: list[Path]) -> Iterator[tuple[Job, int]]:
    """Yield each job and the exit code of its test, which runs in a process of its own on a tree of its own."""
    todo, free, running = list(reversed(jobs)), list(trees), dict[int, tuple[Job, Path]]()
    try:
        while todo or running:
            while todo and free:
                job, tree = todo.pop(), free.pop()
                mutation, test = job
                if mutation is not None:
                    (tree / mutation.path).write_text(mutation.mutated())
                running[_begin(test, tree)] = job, tree
            process, status = os.wait()
            job, tree = running.pop(process)
            if job[0] is not None:
                shutil.copy(ROOT / job[0].path, tree / job[0].path)
            free.append(tree)
            yield job, os.waitstatus_to_exitcode(status)
    finally:
        for process in running:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)


def _copy_of_sources(tree: Path) -> Path:
    for part in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / part, tree / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tree)
    return tree


def _import_what_tests_need() -> None:
    """Once, here, so that the processes that are forked off need not; nothing of the packages themselves."""
    sys.dont_write_bytecode = True
    sys.path[:] = [entry for entry in sys.path if Path(entry or ".").resolve() not in (ROOT, ROOT / "tests")]
    for name in ("torch", "numpy", "scipy.sparse.linalg", "scipy.spatial", "igl", "skimage.measure", "beartype"):
        importlib.import_module(name)


def _begin(test: str, tree: Path) -> int:
    """Start pytest for one test in a process of its own, and return its number."""
    process = os.fork()
    if process:
        return process
    code = 3
    try:
        os.chdir(tree)
        os.environ["PYTHONPATH"] = str(tree)
        sys.path.insert(0, str(tree))
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        signal.alarm(SECONDS_A_TEST)
        code = int(pytest.main(["-q", "-x", "-n", "0", "-m", "", "-p", "no:cacheprovider", test]))
    finally:
        os._exit(code)


def page(results: list[Result]) -> str:
    """Return the text of the page of these results."""
    caught = sum(result.caught for result in results)
    rows = ["| file | function | formula | mutation | test | |", "|---|---|---|---|---|---|"]
    for r in results:
        test = r.test.split("::")[1].removeprefix("test_").replace("_", " ")
        change = f"`{r.old.strip()}` → `{r.new.strip()}`".replace("|", "\\|").replace("\n", " ")
        ended = "caught" if r.caught else "MISSED"
        rows.append(f"| {r.path} | {r.function} | {r.formula} | {change} | {test} | {ended} |")
    return (
        (
            "# Mutations\n\n"
            "Each row breaks one formula, and names the test that fails by it. `python tests/mutations.py --write`\n"
            "runs what has changed since and makes this page of what it finds (it forks, so not on Windows);\n"
            "mutations.json keeps the results with hashes of the sources they are true of.\n"
            f"{caught} of the {len(results)} that were run on these sources are caught; "
            f"{len(MUTATIONS) - len(results)} more are in the list and still to be run.\n\n"
        )
        + "\n".join(rows)
        + "\n"
    )


if __name__ == "__main__":
    sys.exit(main())
