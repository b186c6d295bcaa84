"""The rotation nearest to each of many 3 x 3 matrices, by Newton's method from a first guess.

R maximises tr(R S) over all rotations. With B = R S, a turn by w changes tr by  w . a - w . (tr(B) I - sym B) w / 2,
a the axial vector of B^T - B, so each Newton step is a 3 x 3 solve. Of the stationary points of tr(R S) the global
maximum is the only local one, so where tr(B) I - sym B is positive definite at the end the answer is the best rotation;
elsewhere it is made anew from the singular values [Kabsch 1976]. From the rotations of the iteration before, one or two
steps reach rounding, at a tenth of the cost of as many singular value decompositions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from implicit.sensitivity.weak_curvature import FloatArray

# Newton steps before the singular value decomposition takes over.
STEPS = 4

# Least of the second and third leading minors of tr(B) I - sym B, relative to its trace, at which it is well posed.
DEFINITE = 1e-9


def best_rotations(matrices: FloatArray, start: FloatArray | None = None, *, accuracy: float = 1e-12) -> FloatArray:
    """Return for each matrix S the rotation R with the largest tr(R S).

    Args:
        matrices: S, (n, 3, 3).
        start: Rotations near to the answer (n, 3, 3); None takes none.
        accuracy: Angle that the answers may be off, in radians, where a start is given.

    Returns:
        (n, 3, 3), each orthogonal to rounding, with determinant +1.
    """
    if start is None:
        return _from_singular_values(matrices)
    found = start.copy()
    going = np.arange(len(matrices))
    lost = np.zeros(len(matrices), dtype=bool)
    for _ in range(STEPS):
        turned = found[going] @ matrices[going]
        turns, definite = _newton_turns(turned)
        if not definite.all():
            lost[going[~definite]] = True
            going, turns = going[definite], turns[definite]
        found[going] = _rotations_by(turns) @ found[going]
        # A step of length w leaves about w^2.
        going = going[(turns**2).sum(axis=1) > accuracy]
        if len(going) == 0:
            break
    lost[going] = True  # those not arrived by then
    if lost.any():
        found[lost] = _from_singular_values(matrices[lost])
    return found


def _newton_turns(turned: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (tr(B) I - sym B)^-1 a for each B (n, 3), and where that matrix is positive definite (n,)."""
    B = np.ascontiguousarray(turned.reshape(-1, 9).T)
    a, d, f = B[4] + B[8], B[0] + B[8], B[0] + B[4]
    b, c, e = -(B[1] + B[3]) / 2, -(B[2] + B[6]) / 2, -(B[5] + B[7]) / 2
    # The matrix is (a b c; b d e; c e f); its adjugate:
    A, D, F = d * f - e * e, a * f - c * c, a * d - b * b
    Bc, C, Ec = c * e - b * f, b * e - c * d, b * c - a * e
    determinant = a * A + b * Bc + c * C
    x, y, z = B[5] - B[7], B[6] - B[2], B[1] - B[3]
    size = np.maximum(a + d + f, 1e-300)
    definite = (a > 0) & (DEFINITE * size**2 < F) & (determinant > DEFINITE * size**3)
    scale = 1 / np.where(definite, determinant, 1.0)
    turns = np.stack([A * x + Bc * y + C * z, Bc * x + D * y + Ec * z, C * x + Ec * y + F * z], axis=1)
    return turns * scale[:, None], definite


def _rotations_by(vectors: FloatArray) -> FloatArray:
    """Return the rotations about vectors by about their lengths: exact rotations, to the second order in the angle."""
    # From the quaternion (1, w / 2), made a unit one.
    half = vectors / 2
    scale = 1 / np.sqrt(1 + (half**2).sum(axis=1))
    w, (x, y, z) = scale, (half * scale[:, None]).T
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(entries, axis=1).reshape(-1, 3, 3)


def _from_singular_values(matrices: FloatArray) -> FloatArray:
    U, _, Vt = np.linalg.svd(matrices)
    turn = np.ones((len(matrices), 3))
    turn[:, 2] = np.linalg.det(U) * np.linalg.det(Vt)  # a reflection is no rotation
    return np.asarray(np.einsum("nki,nk,njk->nij", Vt, turn, U))
