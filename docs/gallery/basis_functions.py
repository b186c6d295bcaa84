"""Basis functions and their symmetry

How the surface moves for a unit of one parameter, -(df/dtheta)/|df/dx|, is a function on the surface [paper, eq. 3]. A
weight of each layer has one of its own; directions of a code mean something.
"""

import compare
import implicit
from implicit import families, shapes

cactus = shapes.bundled("cactus")
V, F = implicit.extract_mesh(cactus, resolution=48)
points = cactus.theta.new_tensor(V)

# %%
# A random weight of each layer.
panels, titles = [], []
for function in implicit.one_weight_per_layer(cactus, seed=1):
    values = function(points)
    panels.append((V, F, (values / values.abs().max()).numpy()))
    titles.append(function.name)
    print(function)

# %%
# Of a chair's code, the directions that move the surface most: a motion each, and how mirror-symmetric it is.
model = families.bundled("deepsdf-chairs")
chair = model.field(model.latents[3].clone())
sample = implicit.surface_quadrature(chair, 24)
modes = implicit.surface_modes(chair, sample, 4)
print(modes)
print("Symmetry of each:", [round(float(s), 3) for s in implicit.mirror_symmetry(chair, sample, modes.directions)])

compare.draw(*panels[-4:], titles=titles[-4:], path="basis_functions.png")
