"""The energy of finite rotations about its minimum, as an energy of a step: how far the field is from it, in strain.

Near the positions u of least energy, at which its derivative by free vertices is zero, the energy of spokes and rims
for fixed rotations is E(u) + (p - u)^T L (p - u). With the vertices at y on the field's surface, u - y = g n beside
them, and the surface moving by (b . d_theta) n, a step minimises

    sum over i, j   (b_i . d_theta - g_i) n_i . L_ij n_j (b_j . d_theta - g_j)

over what the field can express: the gaps g count by how much they strain and bend the surface, not by their size. So
ripples go first, which a fit to values or distances leaves. Exact under any rotation, for the rest shape's L is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu
from torch import Tensor

from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import Rows

# Added to the diagonal of the metric, relative to its largest entry: translations cost nothing, and a matrix that is
# singular has no triangular factor.
LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class RigidityTarget:
    """The energy of what is left between a field's surface and the positions of least energy.

    Attributes:
        points: Vertices on the field's surface (V, D).
        normals: Outward unit normals there (V, D).
        gaps: How far outward each is to go (V,), a length.
        laplacian: L of the energy (V, V).
    """

    points: Float[Tensor, "v d"]
    normals: Float[Tensor, "v d"]
    gaps: Float[Tensor, " v"]
    laplacian: sparse.csc_array

    @cached_property
    def metric(self) -> sparse.csc_array:
        """n_i . L_ij n_j, (V, V)."""
        axes = [sparse.diags_array(axis) for axis in self.normals.double().cpu().numpy().T]
        total = sum(axis @ self.laplacian @ axis for axis in axes)
        return sparse.csc_array((total + total.T) / 2)

    @cached_property
    def factor(self) -> sparse.csr_array:
        """U (V, V) with U^T U the metric."""
        M = sparse.csc_array(self.metric + LEAST * self.metric.diagonal().max() * sparse.eye_array(len(self.points)))
        lu = splu(M, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        pivots = np.maximum(lu.U.diagonal(), 0.0)  # P M P^T = L D L^T; rounding may leave one negative
        return sparse.csr_array((sparse.diags_array(np.sqrt(pivots)) @ lu.L.T).tocsc()[:, lu.perm_c])

    def energy(self, gaps: Float[Tensor, " v"] | None = None) -> float:
        """Return the energy of gaps (V,), a squared length; None takes those that are there."""
        g = (self.gaps if gaps is None else gaps).double().cpu().numpy()
        return float(g @ (self.metric @ g))

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        """Yield one weighted equation a vertex over the unknowns of the normal part."""
        rows = torch.cat([part for _, part in space.normal_rows(self.points)])
        matrix = torch.from_numpy(self.factor @ rows.double().cpu().numpy()).to(rows)
        target = torch.from_numpy(self.factor @ self.gaps.double().cpu().numpy()).to(rows)
        yield Rows(matrix, target, torch.ones_like(target))
