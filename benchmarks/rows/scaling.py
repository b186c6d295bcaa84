"""What no other package does: many parameters, many points, and the memory of both."""

from __future__ import annotations

import subprocess
import sys
import time

import torch

import implicit
from compare.runs.memory import with_peak_memory
from implicit import shapes
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget


def scaling() -> None:
    """Seconds over points and parameters: of a product with the normal matrix, and of whole steps.

    The product, a forward and a backward pass, is what conjugate gradients repeat, at no memory that grows with both.
    Steps up to 8000 points or parameters are solved by a factor, of the points' products or of the parameters'.
    """
    fields = [shapes.bundled("spot"), near_sphere(implicit.Field(implicit.Siren(width=157))), decoder_of_8_by_512()]
    heads = " | ".join(f"P = {len(field.theta):,}" for field in fields)
    print(f"\nOne product with the normal matrix, seconds:\n\n| points | {heads} |\n|---|---|---|---|")
    for n in (1000, 10_000, 100_000):
        cells = []
        for field in fields:
            sample = implicit.sample_surface(field, n, resolution=32)
            target = NormalTarget(sample.points, sample.weights, sample.weights).of_field(field)
            operator = target.operator(DeformationSpace(field))
            x = torch.ones_like(field.theta)
            operator.forward(x)  # the first call of a network loads what later ones need
            start = time.perf_counter()
            operator.adjoint(operator.weights * operator.forward(x))
            cells.append(f"{time.perf_counter() - start:.2g}")
        print(f"| {n:,} | {' | '.join(cells)} |", flush=True)
    heads = " | ".join(f"P = {len(field.theta):,}" for field in fields[:2])
    print(f"\nOne whole step, seconds and method:\n\n| points | {heads} |\n|---|---|---|")
    for n in (1000, 10_000):
        cells = []
        for field in fields[:2]:
            sample = implicit.sample_surface(field, n)
            handle = implicit.Handle(implicit.Ball((0.0, 0.5, 0.0), 0.2, falloff=0.3), implicit.Along(0.01))
            start = time.perf_counter()
            edit = implicit.geometric_edit(field, handle, steps=1, points=sample, damping=1e-2)
            cells.append(f"{time.perf_counter() - start:.2f}, {edit.history[0]['method']}")
        print(f"| {n:,} | {' | '.join(cells)} |", flush=True)


def near_sphere(field: implicit.Field) -> implicit.Field:
    """A network trained for a moment to be a ball of radius 0.5, so that it has a surface."""
    module = field.module
    assert module is not None
    module = type(module)(**module.describe()["arguments"])
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-3)
    generator = torch.Generator().manual_seed(0)
    for _ in range(300):
        x = 2.2 * torch.rand(1024, 3, generator=generator) - 1.1
        loss = (module(x) - (x.norm(dim=1) - 0.5)).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return implicit.Field(module)


def memory_of_a_large_decoder() -> None:
    """Peak memory and seconds of a step of an 8 x 512 network, all weights edited, at 20,000 points."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, check=False)
    print("\n" + (done.stdout.strip() or done.stderr.strip()[-500:]), flush=True)


def decoder_of_8_by_512() -> implicit.Field:
    """A network of 1.8 million parameters whose zero set is near a ball of radius 0.5."""
    from implicit.models import Mlp

    module = Mlp(width=512, depth=8)  # starts near the distance to a ball, up to a constant
    ball = shapes.sphere(radius=0.5, dtype=torch.float32)
    with torch.no_grad():
        level = float(module(implicit.sample_surface(ball, 1000).points).median())
    return implicit.Field(module, level=level)


def large_step() -> None:
    field = decoder_of_8_by_512()
    sample = implicit.sample_surface(field, 20_000, resolution=32)
    handle = implicit.Handle(implicit.Ball((0.0, 0.5, 0.0), 0.2, falloff=0.3), implicit.Along(0.01))
    edit, peak = with_peak_memory(lambda: implicit.geometric_edit(field, handle, steps=1, points=sample, damping=1e-2))
    error = edit.error_field()
    known = "memory unknown" if peak is None else f"{peak:.0f} MB beside field and points"
    print(
        f"8 x 512, P = {len(field.theta):,}, 20,000 points: {edit.seconds:.0f} s, {known}, "
        f"rms error {float(error.square().mean().sqrt()):.3f} of the target, {edit.history[0]['solve_status']}"
    )


if __name__ == "__main__":  # in a process of its own, for its peak
    large_step()
