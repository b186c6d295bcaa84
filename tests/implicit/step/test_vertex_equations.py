"""Steps whose points are free along the surface, against the dense least squares of the same energy."""

import numpy as np
import pytest
import torch
from scipy import sparse

from implicit import Field, basis, sample_surface, shapes
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step import vertex_equations as module
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import FieldTarget, NormalTarget, VectorTarget
from implicit.step.least_squares import LeastSquares, Rows, SolveStatus
from implicit.step.mesh_killing import MeshKilling
from implicit.step.off_surface import off_surface
from implicit.step.point_rows import PointRows
from implicit.step.vertex_equations import vertex_equations
from implicit.step.vertex_motion import VertexMotion
from implicit.surface.even_mesh import even_mesh
from implicit.surface.quadrature import SurfaceSample

TURN = np.array([0.3, -0.2, 0.5])


class Scene:
    """A mesh of a field's surface, its two ends as handles, and the field off it."""

    def __init__(self, field: Field, count: int, turn: np.ndarray | None = None) -> None:
        points, faces = even_mesh(field, count)
        self.space = VertexMotion(field, points, faces.numpy())
        height = points[:, 2]
        held = (height - height.mean()).abs() > 0.5 * (height.amax() - height.mean())
        target = torch.zeros(int(held.sum()), 3, dtype=torch.float64)
        target[points[held][:, 2] > height.mean(), 0] = 0.02
        if turn is not None:
            target = torch.linalg.cross(torch.from_numpy(turn).expand_as(target), points[held])
        sample = SurfaceSample(points, field.normal(points), torch.from_numpy(self.space.surface.masses))
        self.off = off_surface(field, sample, strength=0.3, points=60)
        self.off = FieldTarget(
            self.off.points, self.off.target + 1e-3, self.off.weights, self.off.scale, self.off.tied
        )  # so that not all that is asked for off the surface is zero
        self.killing = MeshKilling(self.space.surface, 0.1)
        self.target = VectorTarget(points[held], target, torch.full_like(height[held], 0.5))
        self.energies = [self.killing, self.target, self.off]
        self.held = held

    def dense(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The same equations as one matrix and right-hand side, weighted, from parts that know no vertices."""
        space, field = self.space, self.space.field
        V, P = len(space.points), len(field.theta)
        motions = torch.zeros(V, 3, space.size, dtype=torch.float64)
        motions[:, :, :P] = field.normal(space.points)[:, :, None] * basis(field, space.points)[:, None]
        for a in range(2):
            motions[torch.arange(V), :, P + 2 * torch.arange(V) + a] = space.axes[:, a]
        k = self.killing
        strains = torch.from_numpy(sparse.vstack([k.strains, k.bending**0.5 * k.turns]).toarray())
        handles = self.target.weights[0] ** 0.5 * motions[self.held].flatten(0, 1)
        (off,) = self.off.rows(DeformationSpace(field))
        beyond = torch.nn.functional.pad(off.rooted(), (0, 2 * V))
        matrix = torch.cat([strains @ motions.flatten(0, 1), handles, beyond])
        right = torch.cat(
            [
                strains.new_zeros(len(strains)),
                self.target.weights[0] ** 0.5 * self.target.target.flatten(),
                off.weights.sqrt() * off.target,
            ]
        )
        return matrix, right

    def damped(self, damping: float) -> torch.Tensor:
        """The normal matrix with the parameters damped."""
        matrix, _ = self.dense()
        normal = matrix.T @ matrix
        normal.diagonal()[: self.space.parameters] += damping
        return normal


@pytest.fixture
def scene(wobbly):
    return Scene(wobbly.to(torch.float64), 120)


def test_the_minimiser_is_that_of_the_dense_least_squares(scene, monkeypatch):
    monkeypatch.setattr(module, "GAP", 1e-10)
    system = LeastSquares.of(vertex_equations(scene.space, scene.energies))
    damping = 1e-6 * system.trace()
    solution = system.solve(damping)
    matrix, right = scene.dense()
    exact = torch.linalg.solve(scene.damped(damping), matrix.T @ right)
    assert solution.status is SolveStatus.SOLVED
    assert float((solution.x - exact).norm() / exact.norm()) < 1e-4
    assert solution.objective == pytest.approx(float((matrix @ exact - right).square().sum()), rel=1e-8)


def test_the_gap_to_the_least_energy_is_not_above_what_is_told(scene, monkeypatch):
    system = LeastSquares.of(vertex_equations(scene.space, scene.energies))
    damping = 1e-7 * system.trace()
    matrix, right = scene.dense()
    exact = torch.linalg.solve(scene.damped(damping), matrix.T @ right)

    def energy(x):
        return float((matrix @ x - right).square().sum()) + damping * float(x[: scene.space.parameters].square().sum())

    gaps = []
    for allowed in (0.95, 1e-4):
        monkeypatch.setattr(module, "GAP", allowed)
        solution = system.solve(damping)
        told = solution.factorised.factor.gap
        gaps.append(1 - energy(exact) / energy(solution.x))
        assert -1e-9 <= gaps[-1] <= 1.001 * told <= 1.001 * allowed
    assert gaps[1] < gaps[0]


def test_functionals_are_met_by_the_least_change_of_the_dense_system(scene):
    system = LeastSquares.of(vertex_equations(scene.space, scene.energies))
    damping = 1e-6 * system.trace()
    C = torch.zeros(2, scene.space.size, dtype=torch.float64)
    C[:, : scene.space.parameters] = basis(scene.space.field, scene.space.points[:2])
    r = torch.tensor([0.01, -0.02], dtype=torch.float64)
    solution = system.solve(damping, (C, r))
    normal = scene.damped(damping)
    lifted = torch.linalg.solve(normal, C.T)
    assert float((C @ solution.x - r).abs().max()) < 1e-10
    change = solution.factorised.correction(C, r)
    exact = lifted @ torch.linalg.solve(C @ lifted, r)
    assert float((change - exact).norm() / exact.norm()) < 1e-5


def test_handles_that_turn_as_one_body_take_all_with_them_for_nothing():
    """On a ball about its own centre: the parameters stay, and each vertex goes along the surface by the turn."""
    scene = Scene(shapes.sphere(0.5), 150, 0.02 * TURN)
    points = scene.space.points
    solution = LeastSquares.of(vertex_equations(scene.space, [scene.killing, scene.target])).solve(1e-8)
    turned = torch.linalg.cross(torch.from_numpy(0.02 * TURN).expand_as(points), points)
    assert solution.status is SolveStatus.SOLVED
    assert solution.objective < 1e-12 * float(turned.square().sum())
    torch.testing.assert_close(scene.space.displacement(points, solution.x), turned, rtol=0, atol=1e-8)


def test_a_piece_that_nothing_holds_stays():
    balls = [shapes.sphere(0.3, center=(side, 0.0, 0.0)) for side in (-0.5, 0.5)]
    field = shapes.smooth_union(*balls, blend=0.05)
    points, faces = even_mesh(field, 150)
    space = VertexMotion(field, points, faces.numpy())
    left = points[:, 0] < 0
    target = VectorTarget(points[left], torch.full_like(points[left], 0.01), torch.ones_like(points[left][:, 0]))
    solution = LeastSquares.of(vertex_equations(space, [MeshKilling(space.surface, 0.1), target])).solve(1e-6)
    moved = space.displacement(points, solution.x)
    assert solution.status is SolveStatus.SOLVED
    torch.testing.assert_close(moved[left], torch.full_like(moved[left], 0.01), rtol=0, atol=1e-4)
    assert float(moved[~left].abs().max()) < 1e-4


def test_rows_with_others_added_have_the_products_of_their_matrix(wobbly):
    field = wobbly.to(torch.float64)
    points = sample_surface(field, 40, seed=1).points
    own, tied = torch.linspace(-2, 1, 40, dtype=torch.float64), torch.linspace(0.5, 3, 15, dtype=torch.float64)
    other = torch.randint(0, 25, (15,), generator=torch.Generator().manual_seed(0))
    rows = PointRows.of(field, points, own, tied, other)
    matrix = own[:, None] * basis(field, points) * -field.gradient(points).norm(dim=1, keepdim=True)
    matrix[25:] += tied[:, None] * matrix[other]
    torch.testing.assert_close(rows.gram().tril(), (matrix @ matrix.T).tril(), rtol=1e-10, atol=1e-10)
    step = torch.linspace(-1, 1, len(field.theta), dtype=torch.float64)
    torch.testing.assert_close(rows.times(step), matrix @ step, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(rows.transposed(own), matrix.T @ own, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("bending", [0.0, 0.3])
def test_the_matrix_along_axes_has_the_energy_of_the_displacement(bending):
    points, faces = even_mesh(shapes.torus(0.6, 0.25), 200)
    killing = MeshKilling(WeakSurface.of(points, faces), bending)
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(len(points), 3, 3)))[0]
    along = np.random.default_rng(1).normal(size=(len(points), 3))
    moved = np.einsum("va,vax->vx", along, axes)
    found = along.ravel() @ (killing.matrix(axes) @ along.ravel())
    assert found == pytest.approx(killing.energy(moved), rel=1e-10)


def test_between_the_vertices_rigid_motions_are_exact_and_others_of_third_order():
    """D = (x y, y z, z x) at points of a ball, along its surface; the spacing falls by 2 from mesh to mesh."""
    field = shapes.sphere(0.5)
    points = sample_surface(field, 200, seed=3).points
    errors = []
    for count in (200, 800):
        vertices, faces = even_mesh(field, count)
        space = VertexMotion(field, vertices, faces.numpy())
        turned = torch.linalg.cross(torch.from_numpy(TURN).expand_as(vertices), vertices)
        exact = torch.linalg.cross(torch.from_numpy(TURN).expand_as(points), points)
        assert np.abs(space._between(points, turned) - exact.numpy()).max() < 1e-14
        x = torch.zeros(space.size, dtype=torch.float64)
        x[space.parameters :] = torch.einsum("vax,vx->va", space.axes[:, :2], _products(vertices)).flatten()
        wanted = _products(points)
        wanted = wanted - field.normal(points) * (wanted * field.normal(points)).sum(dim=1, keepdim=True)
        errors.append(float((space.displacement(points, x) - wanted).norm(dim=1).square().mean().sqrt()))
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] > 5


def _products(x):
    return torch.stack([x[:, 0] * x[:, 1], x[:, 1] * x[:, 2], x[:, 2] * x[:, 0]], dim=1)


def test_the_displacement_of_the_vertices_is_the_same_alone_and_among_others(scene):
    space = scene.space
    x = torch.linspace(-1e-3, 1e-3, space.size, dtype=torch.float64)
    others = sample_surface(space.field, 30, seed=2).points
    alone = space.displacement(space.points, x)
    together = space.displacement(torch.cat([space.points, others]), x)
    torch.testing.assert_close(together[: len(alone)], alone, rtol=0, atol=1e-15)
    torch.testing.assert_close(together[len(alone) :], space.displacement(others, x), rtol=0, atol=1e-15)


def test_what_has_no_place_among_the_vertices_is_refused(scene):
    space, field = scene.space, scene.space.field
    away = space.points[:2] + 0.1
    ones = torch.ones(2, dtype=torch.float64)
    with pytest.raises(ValueError, match="must be vertices of the mesh, but 2 of 2 are not"):
        vertex_equations(space, [VectorTarget(away, torch.zeros_like(away), ones)])
    with pytest.raises(TypeError, match="given a NormalTarget"):
        vertex_equations(space, [NormalTarget(space.points[:2], ones, ones)])
    system = LeastSquares.of(vertex_equations(space, scene.energies))
    with pytest.raises(TypeError, match="takes no further equations"):
        system.add(Rows(field.theta.new_zeros(1, space.size), ones[:1], ones[:1]))
