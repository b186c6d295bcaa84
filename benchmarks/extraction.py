"""Meshes of a network's surface."""

import numpy as np
import torch

import implicit
from benchmarks.common import DEVICES, evaluations, sizes, spot


class Extraction:
    """Coarse to fine, and what of the grid is evaluated."""

    params = sizes([64, 128, 256], ["float32", "float64"], DEVICES)
    param_names = ("resolution", "dtype", "device")

    def setup(self, resolution, dtype, device):
        self.field = spot(dtype, device)

    def time_extract(self, resolution, dtype, device):
        implicit.extract_mesh(self.field, resolution)

    def peakmem_setup(self, resolution, dtype, device):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_extract(self, resolution, dtype, device):
        implicit.extract_mesh(self.field, resolution)

    def track_evaluations(self, resolution, dtype, device):
        with evaluations() as counts:
            implicit.extract_mesh(self.field, resolution)
        return sum(counts) / (resolution + 1) ** 3

    def track_distance(self, resolution, dtype, device):
        """Largest distance of the middles of the triangles from the surface, to first order: of second order."""
        V, F = implicit.extract_mesh(self.field, resolution)
        middles = torch.from_numpy(V[F].mean(axis=1)).to(self.field.theta)
        value, gradient = self.field.value_and_gradient(middles)
        return float(np.max((value.abs() / gradient.norm(dim=1)).cpu().numpy()))

    track_evaluations.unit = "of the nodes of the grid"
    track_distance.unit = "length"
