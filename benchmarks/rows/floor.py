"""How near a step is to what no step can avoid: a second table."""

from __future__ import annotations

import torch
from rows.table import best

import implicit
from implicit import shapes
from implicit.models import DeepSdf
from implicit.sensitivity.boundary_sensitivity import basis
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import StepProblem, assemble


def floor() -> None:
    """Steps of ours over the one product or pass at their heart."""
    print("\n| step | its floor | floor, s | step, s | step / floor |\n|---|---|---|---|---|", flush=True)
    field = shapes.bundled("spot")
    for points in (1500, 10_000):
        sample = implicit.sample_surface(field, points)
        target = torch.exp(-sample.points.square().sum(dim=1))
        B = basis(field, sample.points)
        product = (lambda B=B: B @ B.T) if points < B.shape[1] else (lambda B=B: B.T @ B)

        def step(sample: implicit.SurfaceSample = sample, target: torch.Tensor = target) -> object:
            reach = NormalTarget(sample.points, target, sample.weights)
            return assemble(StepProblem(DeformationSpace(field), [reach])).solve(1e-5)

        step()
        (least, _), (spent, _) = best(product, step)
        rows, columns = min(points, B.shape[1]), max(points, B.shape[1])
        line(f"geometric, {points:,} points, P = 2,273", f"product {rows:,} x {columns:,} x {rows:,}", least, spent)
    semantic()


def semantic() -> None:
    """100 points of a network of the published size, its weights random."""
    torch.manual_seed(0)
    decoder = DeepSdf().eval().requires_grad_(False)
    code = 0.1 * torch.randn(decoder.latent)
    points, target = torch.rand(100, 3) - 0.5, torch.full((100,), 0.01)
    field = implicit.decoder_field(decoder, code)

    def one_pass() -> object:
        x, codes = points.clone().requires_grad_(), code.repeat(100, 1).requires_grad_()
        return torch.autograd.grad(decoder(x, codes).sum(), (x, codes))

    def step() -> object:
        reach = NormalTarget(points, target, torch.ones(100))
        return assemble(StepProblem(DeformationSpace(field), [reach])).solve(0.1)

    one_pass(), step()
    (least, _), (spent, _) = best(one_pass, step, repeats=7)
    line("semantic, 100 points, DeepSDF as published", "forward and backward pass", least, spent)


def line(name: str, of_what: str, least: float, spent: float) -> None:
    print(f"| {name} | {of_what} | {least:.3g} | {spent:.3g} | {spent / least:.2f} |", flush=True)
