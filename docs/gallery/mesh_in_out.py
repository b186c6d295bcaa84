"""A mesh in, a mesh out, in its own units

A mesh in millimetres becomes a field, is edited at places given in millimetres, and goes back as a mesh in millimetres.
"""

import numpy as np

import compare
import implicit
import meshref
from implicit import Along, Ball, Handle

# A file of yours would do: .obj, .off, .ply, .stl, .glb and more. This is a ring of 74 by 104 mm, far from the origin.
V, F = meshref.torus(64, 32, major_radius=28.0, minor_radius=9.0)
meshref.write_mesh("ring.obj", V * [1.0, 1.4, 1.0] + [500.0, 20.0, -100.0], F)

# %%
# `fit_mesh` mends it, moves and scales it into [-1, 1]^3, trains a network, and measures how good that is.
V, F = meshref.read_mesh("ring.obj")
field, fit = compare.fit_mesh(V, F, steps=500)
print(fit)

# %%
# `field.units` is the way between both coordinates. Places go by `to_field`, lengths are divided by the scale.
place = V[V[:, 0].argmax()]
center = field.units.to_field(field.theta.new_tensor(place)).tolist()
mm = 1 / field.units.scale
edit = implicit.geometric_edit(field, Handle(Ball(center, 3 * mm, falloff=18 * mm), Along(3 * mm)), points=1000)
print(edit.status.value)

# %%
# And out again.
W, G = implicit.extract_mesh(edit.field, resolution=64, units="user")
meshref.write_mesh("ring-with-bump.ply", W, G)
print(f"It reached to x = {V[:, 0].max():.1f} mm, and does to {W[:, 0].max():.1f} mm.")
print(f"Volume {meshref.volume(V, F):.0f} -> {meshref.volume(W, G):.0f} cubic mm.")

distance = np.linalg.norm(W - place, axis=1)
compare.draw((V, F), (W, G, np.clip(18 - distance, 0, None)), titles=["in", "out"], azimuth=30, path="mesh_in_out.png")
