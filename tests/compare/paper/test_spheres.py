"""DualSDF's own editing, on a bundled model."""

import pytest
import torch

from compare.paper.spheres import sphere_edit, spheres_near
from implicit import families


def test_spheres_go_where_they_are_sent():
    model = families.bundled("dualsdf-chairs")
    code = model.latents[0]
    centers = model.decoder.spheres(code)[1]
    chosen = centers[:, 1].argmin()[None]  # at the end of a leg
    ways = torch.tensor([[0.0, 0.05, 0.0]])
    edit = sphere_edit(model.decoder, code, chosen, ways)
    left = model.decoder.spheres(edit.code)[1][chosen] - centers[chosen] - ways
    assert edit.reached
    assert float(left.norm()) == pytest.approx(edit.missed * 0.05, rel=1e-4)
    assert edit.missed <= 0.1


def test_a_sphere_is_grasped_at_its_surface():
    model = families.bundled("dualsdf-chairs")
    code = model.latents[0]
    radii, centers = model.decoder.spheres(code)
    far = int(centers[:, 1].argmin())
    point = centers[far] - torch.tensor([0.0, 1.0, 0.0]) * radii[far]
    chosen = spheres_near(model.decoder, code, point[None])
    misses = ((point - centers).norm(dim=1) - radii).abs()
    assert float(misses[chosen]) <= float(misses.min()) + 1e-6


def test_ways_that_fit_no_spheres_are_refused():
    model = families.bundled("dualsdf-chairs")
    with pytest.raises(ValueError, match="a way for each of the 2 chosen spheres"):
        sphere_edit(model.decoder, model.latents[0], torch.tensor([0, 1]), torch.ones(1, 3))
