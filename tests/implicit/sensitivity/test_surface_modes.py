"""Basis functions of a ball, whose parameters move it in ways known in closed form."""

import math

import pytest
import torch

import implicit
from implicit import families, shapes
from implicit.sensitivity.surface_modes import mirror_symmetry, surface_modes


def test_a_ball_grows_evenly_and_shifts_oddly():
    """Its theta are the radius, u = 1, and the centre, u = n."""
    field = shapes.sphere(0.5)
    sample = implicit.surface_quadrature(field, 32)
    names = [block.name for block in field.layout for _ in range(block.shape.numel())]
    symmetry = mirror_symmetry(field, sample, torch.eye(4, dtype=torch.float64))
    expected = [1.0 if name == "radius" else None for name in names]
    centre = iter([-1.0, 1.0, 1.0])  # along x, y, z, mirrored in x
    expected = [next(centre) if e is None else e for e in expected]
    torch.testing.assert_close(symmetry, torch.tensor(expected, dtype=torch.float64), atol=1e-5, rtol=0)


def test_modes_are_orthonormal_and_as_strong_as_they_should_be():
    """int 1 = 4 pi r^2 for the radius, int n_i^2 = 4 pi r^2 / 3 for each coordinate of the centre."""
    field = shapes.sphere(0.5)
    sample = implicit.surface_quadrature(field, 32)
    modes = surface_modes(field, sample, 4)
    area = math.pi
    expected = torch.tensor([area, area / 3, area / 3, area / 3], dtype=torch.float64).sqrt()
    torch.testing.assert_close(modes.strengths, expected, atol=1e-4, rtol=0)
    gram = modes.motions.T @ (sample.weights[:, None] * modes.motions)
    torch.testing.assert_close(gram, torch.eye(4, dtype=torch.float64), atol=1e-9, rtol=0)


def test_a_shape_without_the_mirror_plane_is_refused():
    field = shapes.sphere(0.3, center=(0.3, 0.0, 0.0))
    sample = implicit.surface_quadrature(field, 32)
    with pytest.raises(ValueError, match="mirror image"):
        mirror_symmetry(field, sample, torch.eye(4, dtype=torch.float64))
    with pytest.raises(ValueError, match="count must be at least 1, at most"):
        surface_modes(field, sample, 9)


def test_what_was_learned_from_symmetric_chairs_moves_symmetrically():
    model = families.bundled("deepsdf-chairs")
    field = model.field(model.latents[0])
    sample = implicit.sample_surface(field, 1000)
    modes = surface_modes(field, sample, 4)
    assert float(mirror_symmetry(field, sample, modes.directions).min()) > 0.9
