"""Semantic edits of decoders whose codes mean something known, and of the models that come with the package."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import mahalanobis
from torch import nn

import implicit
from implicit import CodePrior, EditStatus, families, prescribe, semantic_edit
from implicit.families import AIRPLANES, CHAIRS

F64 = torch.float64


class Ball(nn.Module):
    """|x - shift| - 1/2 - z_0: a code of one number that is the growth of the radius, and a weight that is a place."""

    def __init__(self):
        super().__init__()
        self.shift = nn.Parameter(torch.zeros(3, dtype=F64))

    def forward(self, points, latent):
        return (points - self.shift).norm(dim=1) - 0.5 - latent[0]


def sphere_points(n, radius=0.5, seed=0):
    x = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=F64)
    return radius * x / x.norm(dim=1, keepdim=True)


def ball(**options):
    return implicit.decoder_field(Ball(), torch.zeros(1, dtype=F64), **options)


def test_a_few_points_of_a_ball_take_all_of_it_along():
    points = sphere_points(5)
    edit = semantic_edit(ball(), points, 0.2 * points, tolerance=1e-6)
    assert edit.status is EditStatus.REACHED
    torch.testing.assert_close(edit.field.theta, torch.tensor([0.1], dtype=F64), atol=1e-6, rtol=0)
    torch.testing.assert_close(edit.displacement, 0.2 * points, atol=1e-4, rtol=0)


def test_one_step_is_the_ridge_regression_of_the_paper():
    """d_z = (B^T B + damping I)^-1 B^T y with weights of one, whatever the number of points."""
    family, damping = CHAIRS, 0.3
    field = family.field(family.draw(1)[0])
    points, ways = prescribe(field, implicit.Handle(implicit.HalfSpace((0, -0.3, 0), (0, -1, 0)), (0, 0.02, 0)), 40)
    edit = semantic_edit(field, points, ways, steps=1, damping=damping, stride=1.0, least_alignment=0.0)
    B, n = implicit.basis(field, points).numpy(), field.normal(points)
    y = (ways * n).sum(dim=1).numpy()
    expected = np.linalg.solve(B.T @ B + damping * np.eye(B.shape[1]), B.T @ y)
    np.testing.assert_allclose((edit.field.theta - field.theta).numpy(), expected, atol=1e-12)


def foot(p, half_height=0.04):
    """The end of the leg at +x +z of a chair."""
    x, z, y = p["seat_width"] / 2, p["seat_depth"] / 2, -p["seat_thickness"] - p["leg_length"]
    t = p["leg_thickness"]
    lower, upper = (x - t - 0.02, y - half_height, z - t - 0.02), (x + 0.02, y + half_height, z + 0.02)
    return implicit.Box(lower, upper)


def test_on_the_exact_family_only_the_length_of_the_legs_changes():
    """One leg is pushed up, the underside of the seat and its rims are held: leg_length alone does that."""
    theta = CHAIRS.draw(3)[2]
    field, p = CHAIRS.field(theta), dict(zip(CHAIRS.parameters, CHAIRS.draw(3)[2].tolist()))
    push = implicit.Handle(foot(p), (0.0, 0.05, 0.0))
    hold = implicit.Handle(implicit.Box((-1, -p["seat_thickness"] - 0.03, -1), (1, 1, 1)), (0.0, 0.0, 0.0))
    points, ways = prescribe(field, [push, hold], 400)
    edit = semantic_edit(field, points, ways, tolerance=1e-3, damping=1e-6)
    assert edit.status is EditStatus.REACHED
    expected = theta.clone()
    expected[CHAIRS.parameters.index("leg_length")] -= 0.05
    torch.testing.assert_close(edit.field.theta, expected, atol=1e-3, rtol=0)


def test_several_regions_go_to_targets_of_their_own():
    theta = AIRPLANES.draw(2)[1]
    field, p = AIRPLANES.field(theta), dict(zip(AIRPLANES.parameters, AIRPLANES.draw(2)[1].tolist()))
    tip = implicit.Box((p["wing_span"] / 2 - 0.02, -1, -1), (1, 1, 1))
    nose = implicit.Box((-1, -1, p["fuselage_length"] / 2 - 0.03), (1, 1, 1))
    handles = [implicit.Handle(tip, (0.06, 0.0, 0.0)), implicit.Handle(nose, (0.0, 0.0, -0.04))]
    points, ways = prescribe(field, handles, 120)
    edit = semantic_edit(field, points, ways, tolerance=0.01)
    change = dict(zip(AIRPLANES.parameters, (edit.field.theta - theta).tolist()))
    assert edit.status is EditStatus.REACHED
    assert change["wing_span"] == pytest.approx(0.12, abs=0.004)
    assert change["fuselage_length"] == pytest.approx(-0.08, abs=0.004)


def test_what_the_code_cannot_do_is_not_reached_and_weights_can_be_asked_to_help():
    """Opposite ends of a ball sent the same way: no radius does it, a shift does."""
    points = torch.tensor([[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]], dtype=F64)
    ways = torch.tensor([[0.1, 0.0, 0.0], [0.1, 0.0, 0.0]], dtype=F64)
    edit = semantic_edit(ball(), points, ways)
    assert edit.status is EditStatus.NOT_REACHED
    assert edit.history[-1]["missed"] == pytest.approx(1.0)
    assert "not reached" in edit.status.value
    both = ball(weights="shift")
    edit = semantic_edit(both, points, ways)
    assert edit.status is EditStatus.REACHED
    expected = torch.tensor([0.0, 0.1, 0.0, 0.0], dtype=F64)
    torch.testing.assert_close(edit.field.theta, expected, atol=5e-3, rtol=0)


def test_write_back_reaches_code_and_weights():
    decoder, code = Ball(), torch.zeros(1, dtype=F64)
    field = implicit.decoder_field(decoder, code, weights=["shift"])
    field.with_theta(torch.tensor([0.1, 0.2, 0.3, 0.4], dtype=F64)).write_back()
    torch.testing.assert_close(code, torch.tensor([0.1], dtype=F64))
    torch.testing.assert_close(decoder.shift.detach(), torch.tensor([0.2, 0.3, 0.4], dtype=F64))


def test_points_with_normals_across_their_way_are_left_out():
    points = torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.5, 0.0]], dtype=F64)
    ways = torch.tensor([[0.1, 0.0, 0.0]], dtype=F64).repeat(2, 1)
    edit = semantic_edit(ball(), points, ways)
    assert torch.isfinite(edit.wanted).all(dim=1).tolist() == [True, False]
    assert [row["points_used"] for row in edit.history] == [1] * len(edit.history)
    with pytest.raises(ValueError, match="No point is to move along its normal"):
        semantic_edit(ball(), points[1:], ways[1:])


def test_a_trust_region_bounds_the_change_of_the_code_in_each_step():
    family, radius = CHAIRS, 0.01
    field = family.field(family.draw(1)[0])
    points, ways = prescribe(field, implicit.Handle(implicit.HalfSpace((0, -0.3, 0), (0, -1, 0)), (0, 0.1, 0)), 40)
    edit = semantic_edit(field, points, ways, trust_region=radius, steps=3)
    for row in edit.history:
        assert row["d_theta_norm"] == pytest.approx(radius, rel=1e-6)


def test_the_prior_is_the_gaussian_of_the_codes():
    codes = torch.randn(50, 4, generator=torch.Generator().manual_seed(2), dtype=F64) * torch.tensor([1.0, 2, 3, 4])
    prior = CodePrior.of(codes, weight=0.1)
    expected = mahalanobis(codes[3], codes.mean(dim=0), np.linalg.inv(np.cov(codes.T)))
    assert prior.distance(codes[3]) == pytest.approx(expected, rel=1e-3)


def test_a_strong_prior_pulls_the_code_to_its_mean():
    """With the pull w, the code z and the target t of n points the minimiser is (n t + w m / s^2) / (n + w / s^2)."""
    codes = torch.tensor([[0.01], [0.03]], dtype=F64)  # mean 0.02, variance 2e-4
    points = sphere_points(10)
    for weight in (1e-4, 1e-2, 1e3):
        prior = CodePrior.of(codes, weight)
        edit = semantic_edit(ball(), points, 0.1 * points, prior=prior, damping=0.0, steps=12, tolerance=1e-9)
        pull = weight / (2e-4 * (1 + 1e-6))
        expected = (10 * 0.05 + pull * 0.02) / (10 + pull)
        assert float(edit.field.theta) == pytest.approx(expected, rel=1e-3)
        assert "prior_distance" in edit.history[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"displacements": torch.zeros(4, 3, dtype=F64)}, "displacement for each"),
        ({"displacements": torch.full((5, 3), float("nan"), dtype=F64)}, r"displacements\[0\] is not finite"),
        ({"points": 2 * sphere_points(5)}, "must lie on the surface"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"damping": -1.0}, "damping must be a number of at least 0"),
        ({"stride": 0.0}, "stride must be a positive length"),
        ({"tolerance": 1.0}, "tolerance must be a number of at least 0 and below 1"),
        ({"prior": CodePrior.of(torch.eye(3, dtype=F64))}, "The prior is one of codes of 3 numbers"),
    ],
)
def test_bad_input_is_refused_with_what_to_do(change, message):
    arguments = {"points": sphere_points(5), "displacements": 0.1 * sphere_points(5)} | change
    with pytest.raises(ValueError, match=message):
        semantic_edit(ball(), **arguments)


def test_prescribed_points_are_shared_out_among_the_regions():
    top, bottom = implicit.HalfSpace((0, 0.3, 0), (0, 1, 0)), implicit.HalfSpace((0, -0.3, 0), (0, -1, 0))
    handles = [implicit.Handle(top, implicit.Along(0.1)), implicit.Handle(bottom, (0.0, 0.2, 0.0))]
    points, ways = prescribe(ball(), handles, 31)
    assert (points[:, 1] >= 0.3).sum() == 16
    assert (points[:, 1] <= -0.3).sum() == 15
    torch.testing.assert_close(ways[:16], 0.2 * points[:16], atol=1e-6, rtol=0)
    with pytest.raises(ValueError, match=r"handles\[0\]"):
        prescribe(ball(), implicit.Handle(implicit.Ball((3.0, 0.0, 0.0), 0.1), (0.1, 0.0, 0.0)))


def test_an_edited_code_is_saved_and_loaded(tmp_path):
    model = families.bundled("deepsdf-chairs")
    field = model.field(model.latents[0])
    implicit.save_field(field, tmp_path / "chair.safetensors")
    again = implicit.load_field(tmp_path / "chair.safetensors")
    points = torch.rand(100, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(again.value(points), field.value(points), rtol=0, atol=0)
    torch.testing.assert_close(again.theta, field.theta, rtol=0, atol=0)
    assert again.layout[0].name == "latent"


# The models that come with the package


def middle(model):
    p = torch.tensor(list(model.family.ranges.values())).double().mean(dim=1)
    k = model.nearest(p)
    return k, dict(zip(model.family.parameters, model.parameters[k].tolist()))


def scaled(box, scale):
    return implicit.Box([scale * c for c in box.lower], [scale * c for c in box.upper])


@pytest.mark.parametrize(
    "name",
    ["imnet-chairs", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("dualsdf-chairs", "deepsdf-chairs"))],
)
def test_when_one_leg_is_shortened_the_other_three_follow(name):
    model = families.bundled(name)
    k, p = middle(model)
    field, s = model.field(model.latents[k]), model.scale
    points, ways = prescribe(field, implicit.Handle(scaled(foot(p, 0.05), s), (0.0, 0.12 * s, 0.0)), 60, resolution=48)
    edit = semantic_edit(field, points, ways)
    assert edit.status is EditStatus.REACHED
    assert len(edit.history) <= 15
    change = legs(edit.field, s) - legs(field, s)
    assert change[0] == pytest.approx(0.12, rel=0.1)
    np.testing.assert_allclose(change[1:], change[0], rtol=0.05)


def legs(field, scale):
    """Lowest y of the legs, the one at +x +z first, on the extracted mesh."""
    V = implicit.extract_mesh(field, 56)[0] / scale
    return np.array([V[(V[:, 0] * x > 0.1) & (V[:, 2] * z > 0.1), 1].min() for x in (1, -1) for z in (1, -1)])


def wing_tip(model, p, side, way):
    inner, outer = sorted((side * (p["wing_span"] / 2 - 0.04), side * 1.0))
    return implicit.Handle(implicit.Box((inner, -0.2, -1.0), (outer, 0.2, 1.0)), (way, 0.0, 0.0))


@pytest.mark.parametrize("name", ["deepsdf-airplanes", pytest.param("dualsdf-airplanes", marks=pytest.mark.nightly)])
def test_when_one_wing_is_lengthened_the_other_follows_and_uneven_wings_are_not_reached(name):
    model = families.bundled(name)
    k, p = middle(model)
    field = model.field(model.latents[k])
    points, ways = prescribe(field, [wing_tip(model, p, side, 0.1) for side in (1, -1)], 120, resolution=48)
    right = points[:, 0] > 0
    edit = semantic_edit(field, points[right], ways[right])
    assert edit.status is EditStatus.REACHED
    ends = [implicit.extract_mesh(f, 56)[0][:, 0] for f in (field, edit.field)]
    longer = ends[1].max() - ends[0].max(), ends[0].min() - ends[1].min()
    assert longer[0] == pytest.approx(0.1, rel=0.1)
    assert longer[1] == pytest.approx(longer[0], rel=0.1)
    edit = semantic_edit(field, points, ways)
    assert edit.status is EditStatus.NOT_REACHED
    assert min(row["missed"] for row in edit.history) > 0.5
