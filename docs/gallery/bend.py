"""Bend

A cactus bent forward by 60 degrees, once by linear steps and once by finite rotations, and the energy that each ends
with.
"""

import math

import torch

import compare
import implicit
import meshref
from implicit import HalfSpace, Handle, RigidMotion, shapes

field = shapes.bundled("cactus")
foot = Handle(HalfSpace((0, -0.6, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
bent = RigidMotion(rotation=(math.radians(60), 0.0, 0.0))  # forward, about the middle
top = Handle(HalfSpace((0, 0.6, 0), (0, 1, 0)), bent)

# %%
# `track` carries the vertices of a mesh along, so that both edits are measured on the same triangles.
V, F = implicit.extract_mesh(field, resolution=24)
edits = {}
for method, steps in (("linear", 3), ("finite", 1)):
    edits[method] = implicit.rigid_edit(
        field, [foot, top], method=method, steps=steps, points=700, track=torch.from_numpy(V)
    )
    energy = meshref.arap_energy(V, F, edits[method].tracked.numpy())
    print(f"{method}: ARAP energy {energy:.4f}, {edits[method].seconds:.0f} s. {edits[method].status.value}")

compare.draw(field, *edits.values(), titles=["before", *edits], azimuth=65, path="bend.png")
