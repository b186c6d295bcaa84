"""The damped and constrained least squares of a step, by each form of the inverse of its normal matrix."""

import torch

import implicit
from benchmarks.common import DEVICES, sizes, spot
from implicit.sensitivity.boundary_sensitivity import basis
from implicit.step.equations import KeptEquations, NormalMatrix, Rows
from implicit.step.least_squares import Factorised

METHODS = ("primal", "dual", "cg")
DAMPING = 1e-4


class Solvers:
    """A real system of 3000 rows and 2273 unknowns, with the volume held."""

    params = sizes(METHODS, ["float32", "float64"], DEVICES)
    param_names = ("method", "dtype", "device")

    def setup(self, method, dtype, device):
        field = spot(dtype, device)
        sample = implicit.sample_surface(field, 3000)
        rows = basis(field, sample.points)
        target = 0.05 * torch.exp(-((sample.points[:, 1] - 0.5) ** 2) / 0.1)
        self.rows = Rows(rows, target, sample.weights)
        self.fixed = (sample.weights @ rows)[None], torch.zeros(1).to(rows)
        self.ridge = torch.full((rows.shape[1],), DAMPING, dtype=torch.float64, device=rows.device)

    def solution(self, method):
        matrix = self.rows.matrix
        equations = (NormalMatrix if method == "primal" else KeptEquations)(
            matrix.shape[1], matrix, tolerance=1e-4 if method == "cg" else 1e-12
        )
        equations.add(self.rows)
        if method == "cg":
            factor = equations.conjugate_gradients(self.ridge)  # to the tolerance of a step of a large network
        else:
            factor = equations.factorise(self.ridge)
        return Factorised(equations, factor, self.ridge).solve(self.fixed)

    def time_solve(self, method, dtype, device):
        self.solution(method)

    def peakmem_setup(self, method, dtype, device):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_solve(self, method, dtype, device):
        self.solution(method)

    def track_objective(self, method, dtype, device):
        solution = self.solution(method)
        return solution.objective + DAMPING * float(solution.x @ solution.x)

    def track_constraint_residual(self, method, dtype, device):
        return self.solution(method).constraint_residual

    def track_gradient(self, method, dtype, device):
        """Distance of the solution from a minimum on the constraint: the damped gradient across it, relative."""
        x = self.solution(method).x.double()
        B, y, w = (part.double() for part in self.rows[:3])
        gradient = B.T @ (w * (B @ x - y)) + DAMPING * x
        row = self.fixed[0][0].double()
        across = gradient - (gradient @ row) / (row @ row) * row
        return float(across.norm() / (B.T @ (w * y)).norm())

    track_objective.unit = "damped objective"
    track_constraint_residual.unit = "length cubed"
    track_gradient.unit = "relative"
