"""The numerical core: sensitivities, integrals, solvers and extraction."""

import math

import torch

import implicit
from implicit import shapes
from implicit.sensitivity import basis, parameter_gradient_and_slope
from implicit.solve import LeastSquares, Rows


class Basis:
    """B and its slopes in space at points of a network of P = 2273."""

    params = ([1000, 10000], ["float32", "float64"])
    param_names = ("points", "dtype")

    def setup(self, points, dtype):
        torch.set_num_threads(1)
        self.field = shapes.bundled("spot").to(getattr(torch, dtype))
        self.points = implicit.sample_surface(self.field, points).points

    def time_basis(self, points, dtype):
        basis(self.field, self.points)

    def time_basis_and_slopes(self, points, dtype):
        parameter_gradient_and_slope(self.field, self.points[:1000])

    def peakmem_setup(self, points, dtype):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_adjoint(self, points, dtype):
        implicit.adjoint(self.field, self.points, torch.ones_like(self.points[:, 0]))


class Quadrature:
    """Area and volume of a torus, against their closed forms."""

    params = (24, 48, 96)
    param_names = ("resolution",)

    def setup(self, resolution):
        torch.set_num_threads(1)
        self.field = shapes.torus(0.7, 0.25)
        self.sample = implicit.surface_quadrature(self.field, resolution)

    def time_quadrature(self, resolution):
        implicit.surface_quadrature(self.field, resolution)

    def time_volume(self, resolution):
        implicit.Volume().value(self.field, self.sample)

    def track_area_error(self, resolution):
        area = 4 * math.pi**2 * 0.7 * 0.25
        return abs(float(implicit.surface_quadrature(self.field, resolution).weights.sum()) / area - 1)

    def track_volume_error(self, resolution):
        sample = implicit.surface_quadrature(self.field, resolution)
        return abs(implicit.Volume().value(self.field, sample) / (2 * math.pi**2 * 0.7 * 0.25**2) - 1)

    track_area_error.unit = "relative error"
    track_volume_error.unit = "relative error"


class Solvers:
    """Each method on the same real system of 3000 rows and 2273 unknowns, with a volume constraint."""

    params = ("primal", "dual", "qr", "cg")
    param_names = ("method",)

    def setup(self, method):
        torch.set_num_threads(1)
        field = shapes.bundled("spot").to(torch.float64)
        sample = implicit.sample_surface(field, 3000)
        rows = basis(field, sample.points)
        target = 0.05 * torch.exp(-((sample.points[:, 1] - 0.5) ** 2) / 0.1)
        self.rows = Rows(rows, target, sample.weights)
        self.fixed = (sample.weights @ rows)[None], torch.zeros(1, dtype=torch.float64)

    def solution(self, method):
        system = LeastSquares(self.rows.matrix.shape[1], self.rows.matrix, method=method)
        system.add(self.rows)
        return system.solve(1e-4, self.fixed)

    def time_solve(self, method):
        self.solution(method)

    def track_objective(self, method):
        solution = self.solution(method)
        return solution.objective + 1e-4 * float(solution.x @ solution.x)

    def track_constraint_residual(self, method):
        return self.solution(method).constraint_residual

    track_objective.unit = "damped objective"
    track_constraint_residual.unit = "length cubed"


class Extraction:
    """Meshes of a bundled field."""

    params = (64, 128, 256)
    param_names = ("resolution",)

    def setup(self, resolution):
        torch.set_num_threads(1)
        self.field = shapes.bundled("spot")

    def time_extract(self, resolution):
        implicit.extract_mesh(self.field, resolution)
