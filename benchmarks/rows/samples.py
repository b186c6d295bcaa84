"""Uniform random points on a network's surface: the rays of `iarap`, or ours."""

from __future__ import annotations

import math

import numpy as np
import torch
from rows.table import best, row

import implicit
from implicit import shapes


def samples(n: int = 50_000) -> None:
    """Uniform random points: the ray sampler of iarap, and ours."""
    from iarap.sampling import uniform_sample

    field = shapes.bundled("spot")
    with torch.no_grad():
        few = uniform_sample(field.value, 2000, device="cpu")
        rays = math.ceil(2000 * n / len(few))

        def theirs() -> torch.Tensor:
            return uniform_sample(field.value, rays, device="cpu")

        (theirs_s, points), (ours_s, sample) = best(
            theirs, lambda: implicit.sample_surface(field, n, "uniform", seed=1), repeats=2
        )
    chance = uniformity(sample.points)
    name = f"{n:,} uniform points: the ray sampler of `iarap` ({len(points):,})"
    row(name, theirs_s, ours_s, f"chi-square over a fine mesh, p = {chance:.2f}", chance > 1e-3)


def uniformity(points: torch.Tensor) -> float:
    """Probability that a uniform draw is as uneven: counts in patches of a fine mesh against their areas."""
    from scipy.spatial import cKDTree
    from scipy.stats import chi2

    V, F = implicit.extract_mesh(shapes.bundled("spot").to(torch.float64), 192)
    centers, areas = (
        V[F].mean(axis=1),
        np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1),
    )
    seeds = centers[np.random.default_rng(0).choice(len(F), 400, replace=False)]
    tree = cKDTree(seeds)
    share = np.bincount(tree.query(centers)[1], areas, 400)
    counts = np.bincount(tree.query(points.double().numpy())[1], minlength=400)
    wanted = len(points) * share / share.sum()
    return float(chi2.sf(((counts - wanted) ** 2 / wanted).sum(), 399))
