"""Rotations nearest to many 3 x 3 matrices, and the rigid motion nearest to pairs of points.

    R maximises tr(R^T S) over rotations: with S = U diag(s) V^T, it is U diag(1, 1, det U V) V^T       [Kabsch 1976]

Near an R known from before, Newton's method is ten times as fast. With B = R^T S, turning R by w changes the trace by

    a . w - w . M w / 2,     a = (B_32 - B_23, B_13 - B_31, B_21 - B_12),     M = tr(B) I - (B + B^T) / 2

so a step is w = M^-1 a. Where M is positive definite the maximum is the global one; all others are left to the
singular values.
"""

from __future__ import annotations

import numpy as np

from meshref.topology import BoolArray, FloatArray

# Newton steps before the singular values take over.
STEPS = 4

# Minors of M, over the like power of its trace, above which it counts as positive definite.
DEFINITE = 1e-9


def nearest_rotations(S: FloatArray, start: FloatArray | None = None, *, accuracy: float = 1e-12) -> FloatArray:
    """Return the rotations R (k, 3, 3) that maximise trace(R^T S) for matrices S (k, 3, 3).

    Args:
        S: Matrices, (k, 3, 3).
        start: Rotations near the answers, (k, 3, 3), from which Newton's method goes on; None takes singular values.
        accuracy: With a start, angle in radians by which an answer may be off.
    """
    if start is None:
        return _from_singular_values(S)
    R, T = _by_entries(start), _by_entries(S)
    going, failed = np.arange(len(S)), np.zeros(len(S), dtype=np.bool_)
    for _ in range(STEPS):
        turn, definite = _newton_turn(_product(R[:, :, going].swapaxes(0, 1), T[:, :, going]))
        if not definite.all():
            failed[going[~definite]] = True
            going, turn = going[definite], turn[:, definite]
        R[:, :, going] = _product(R[:, :, going], _rotations_about(turn))
        going = going[(turn**2).sum(axis=0) > accuracy]  # a step of length w leaves an error of about w^2
        if going.size == 0:
            break
    failed[going] = True
    found = np.ascontiguousarray(R.transpose(2, 0, 1))
    if failed.any():
        found[failed] = _from_singular_values(S[failed])
    return found


def rigid_fit(P: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3, 3) and translation (3,) that bring P @ rotation.T + translation closest to Q.

    Where the points leave a turn open (a single point, or points on a line), the smallest turn is taken.
    """
    from_middle, to_middle = P.mean(axis=0), Q.mean(axis=0)
    covariance = (Q - to_middle).T @ (P - from_middle)
    values = np.linalg.svd(covariance, compute_uv=False)
    if values[1] <= 1e-9 * values[0] or values[0] == 0:
        if values[0] == 0:
            return np.eye(3), to_middle - from_middle
        # Rank one: turn the one direction that is known onto its image by the shortest way.
        left, _, right = np.linalg.svd(covariance)
        rotation = _shortest_turn(right[0], left[:, 0])
        return rotation, to_middle - rotation @ from_middle
    rotation = nearest_rotations(covariance[None])[0]
    return rotation, to_middle - rotation @ from_middle


def _from_singular_values(S: FloatArray) -> FloatArray:
    left, _, right = np.linalg.svd(S)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


def _by_entries(matrices: FloatArray) -> FloatArray:
    """Return matrices (k, 3, 3) as (3, 3, k), in which sums over entries are sums of long rows."""
    return np.ascontiguousarray(matrices.transpose(1, 2, 0))


def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return the products of matrices (3, 3, k)."""
    return np.asarray(A[:, 0, None] * B[None, 0] + A[:, 1, None] * B[None, 1] + A[:, 2, None] * B[None, 2])


def _newton_turn(B: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return M^-1 a of each B (3, 3, k) as (3, k), and where M is positive definite, (k,)."""
    x, y, z = B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]
    # M, symmetric, and its adjugate.
    p, q, r = B[1, 1] + B[2, 2], B[0, 0] + B[2, 2], B[0, 0] + B[1, 1]
    f, g, h = -(B[0, 1] + B[1, 0]) / 2, -(B[0, 2] + B[2, 0]) / 2, -(B[1, 2] + B[2, 1]) / 2
    P, Q, R = q * r - h * h, p * r - g * g, p * q - f * f
    F, G, H = g * h - f * r, f * h - g * q, f * g - h * p
    determinant = p * P + f * F + g * G
    trace = np.maximum(p + q + r, np.finfo(float).tiny)
    definite = (p > 0) & (DEFINITE * trace**2 < R) & (DEFINITE * trace**3 < determinant)
    turn = np.stack([P * x + F * y + G * z, F * x + Q * y + H * z, G * x + H * y + R * z])
    return turn / np.where(definite, determinant, 1.0), definite


def _rotations_about(vectors: FloatArray) -> FloatArray:
    """Return exact rotations (3, 3, k) about vectors (3, k) by their lengths, to the second order in these."""
    # Cayley's map of [w / 2], by its unit quaternion.
    half = vectors / 2
    w = 1 / np.sqrt(1 + (half**2).sum(axis=0))
    x, y, z = half * w
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows)


def _shortest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    # Two mirror images, in the plane normal to a, then in the plane that halves the way from -a to b.
    cosine = float(a @ b)
    if cosine < -1 + 1e-12:
        other = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        other /= np.linalg.norm(other)
        return np.asarray(2 * np.outer(other, other) - np.eye(3))
    half = a + b
    return np.asarray(np.eye(3) - np.outer(half, half) / (1 + cosine) + 2 * np.outer(b, a))
