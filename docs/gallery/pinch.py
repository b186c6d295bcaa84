"""A dumbbell that pinches

A thin neck between two balls gets thinner under mean-curvature flow until it breaks. The flow goes on with two bodies,
and its record says in which step there were two.
"""

import torch

import compare
import implicit
from implicit import Holding, Volume, shapes

# Two balls on a bar, as a formula, and a network fitted to it: points on the surface, near it, and all over the box.
balls = [shapes.sphere(0.28, (x, 0.0, 0.0)) for x in (-0.5, 0.5)]
body = shapes.smooth_union(*balls, shapes.capsule((-0.5, 0, 0), (0.5, 0, 0), 0.06), blend=0.06)
random = torch.Generator().manual_seed(0)
on = implicit.sample_surface(body, 3000).points
near = on + 0.03 * torch.randn(on.shape, generator=random, dtype=torch.float64)
far = 2.2 * torch.rand(3000, 3, generator=random, dtype=torch.float64) - 1.1
points = torch.cat([on, near, far])
dumbbell, training = implicit.fit_field(points, body.value(points), body.normal(points), steps=300)
print(training)

# %%
holding = Holding(resolution=20, fine_resolution=32, finest_resolution=32)
options = {"step_size": 5e-4, "points": 200, "directions": 100, "resolution": 24}
edit = implicit.smooth(dumbbell, steps=8, constraints=[Volume()], holding=holding, **options)
for step, row in enumerate(edit.history, start=1):
    print(f"step {step}: {row['components']} component(s), volume {row['volume']:.6f}", row.get("event", ""))

compare.draw(dumbbell, edit, titles=["before", "after 8 steps"], azimuth=0, path="pinch.png")
