"""Bend

A cactus bent forward by 60 degrees as a neural field, by finite rotations, beside ARAP on a mesh with the same handles.
"""

import math

import numpy as np
import torch

import compare
import implicit
import meshref
from implicit import HalfSpace, Handle, RigidMotion, shapes

field = shapes.bundled("cactus")
foot = Handle(HalfSpace((0, -0.6, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
# Forward, to where the trunk ends if it bends to an arc and keeps its length.
bent = RigidMotion(rotation=(math.radians(60), 0.0, 0.0), translation=(0.0, 0.09, 0.05))
top = Handle(HalfSpace((0, 0.6, 0), (0, 1, 0)), bent)

# %%
# Linear steps, `method="linear"`, forget what earlier ones have strained: good for small motions and quick. Finite
# rotations are held against the shape at rest, and the field is led there. `method="auto"` chooses.
edit = implicit.rigid_edit(field, [foot, top], method="finite", resolution=32)
print(edit.status.value, *edit.notes)

# %%
# The same on the vertices of a mesh, each of them told where to go that lies in a handle's region.
V, F = implicit.extract_mesh(field, resolution=48)
points = torch.from_numpy(V)
held, moved = (np.flatnonzero(handle.weights(points) > 0) for handle in (foot, top))
handles = np.concatenate([held, moved])
targets = np.concatenate([V[held], bent.at(1.0, points[moved]).numpy()])
result = meshref.arap(V, F, handles, targets)
print(result.status.value, f"ARAP energy {result.energy:.4f}.")

# %%
# How far the two surfaces are apart.
W, G = implicit.extract_mesh(edit.field, resolution=48)
print(f"Largest distance between both {meshref.hausdorff(W, G, result.V, F, n=4000):.3f}, of a cactus 1.6 long.")

compare.draw(field, edit, (result.V, F), titles=["before", "neural field", "mesh"], azimuth=65, path="bend.png")
