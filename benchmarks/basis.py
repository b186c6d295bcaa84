"""The basis of boundary sensitivity: rows of B, their slopes in space, and products with B that never form it."""

import torch

import implicit
from benchmarks.common import DEVICES, require, sizes
from implicit.sensitivity.boundary_sensitivity import basis, parameter_gradient_and_slope

ROOM = 2**30  # bytes that B may take here


class Basis:
    """At random points, in the network of the paper (width 32, P = 2273) and in one of 18,817 parameters."""

    params = sizes([1000, 10000], [32, 96], ["float32", "float64"], DEVICES)
    param_names = ("points", "width", "dtype", "device")

    def setup(self, points, width, dtype, device):
        require(device)
        kind = getattr(torch, dtype)
        self.field = implicit.Field(implicit.Siren(width=width)).to(kind, device)
        if points * len(self.field.theta) * kind.itemsize > ROOM:
            raise NotImplementedError("B takes more memory than is given to it here")
        generator = torch.Generator().manual_seed(0)
        self.points = (2 * torch.rand(points, 3, generator=generator) - 1).to(self.field.theta)
        self.step = torch.ones_like(self.field.theta)
        self.ones = torch.ones_like(self.points[:, 0])

    def time_basis(self, points, width, dtype, device):
        basis(self.field, self.points)
        self._wait(device)

    def time_basis_and_slopes(self, points, width, dtype, device):
        parameter_gradient_and_slope(self.field, self.points[:500])
        self._wait(device)

    def time_normal_displacement(self, points, width, dtype, device):
        implicit.normal_displacement(self.field, self.points, self.step)
        self._wait(device)

    def time_adjoint(self, points, width, dtype, device):
        implicit.adjoint(self.field, self.points, self.ones)
        self._wait(device)

    def peakmem_setup(self, points, width, dtype, device):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_basis(self, points, width, dtype, device):
        basis(self.field, self.points)

    def peakmem_adjoint(self, points, width, dtype, device):
        implicit.adjoint(self.field, self.points, self.ones)

    def track_error_of_the_product(self, points, width, dtype, device):
        """B d_theta formed row by row against the product that never forms B, relative."""
        formed = basis(self.field, self.points) @ self.step
        product = implicit.normal_displacement(self.field, self.points, self.step)
        return float((formed - product).norm() / formed.norm())

    track_error_of_the_product.unit = "relative error"

    @staticmethod
    def _wait(device):
        if device == "cuda":
            torch.cuda.synchronize()
