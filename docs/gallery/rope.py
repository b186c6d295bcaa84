"""A rope in the plane

Fields in two dimensions are curves. One is pulled at a place, once freely and once with its length held.
"""

import matplotlib.pyplot as plt
import torch
from matplotlib.collections import LineCollection

import implicit
from implicit import Along, Area, Ball, Handle

# A circle held by a network, fitted to its exact distance. The dimension is that of the bounds.
random = torch.Generator().manual_seed(0)
angles = 2 * torch.pi * torch.rand(8000, generator=random)
normals = torch.stack([angles.cos(), angles.sin()], dim=1)
radii = torch.cat([0.5 + 0.02 * torch.randn(4000, generator=random), 1.5 * torch.rand(4000, generator=random)])
square = ((-1.0, -1.0), (1.0, 1.0))
rope, _ = implicit.fit_field(radii[:, None] * normals, radii - 0.5, normals, steps=400, bounds=square)

# %%
# In the plane `Area` is the length of the curve and `Volume` the area inside.
pull = Handle(Ball((0.5, 0.0), 0.05, falloff=0.3), Along(0.15))
edits = {}
for name, constraints in (("length free", []), ("length held", [Area()])):
    edits[name] = implicit.geometric_edit(
        rope, pull, rest="free", steps=8, points=300, constraints=constraints, resolution=96
    )
    length = implicit.integrate(edits[name].field, Area(), 96).value
    print(f"{name}: {length:.5f}, was {implicit.integrate(rope, Area(), 96).value:.5f}. {edits[name].status.value}")

# %%
# `extract_mesh` gives points and segments here.
figure, panes = plt.subplots(1, 2, figsize=(6.4, 3.2), sharex=True, sharey=True, layout="constrained")
for axes, (name, edit) in zip(panes, edits.items(), strict=True):
    for field, colour in ((rope, "#c9ccd1"), (edit.field, "#4c72b0")):
        V, E = implicit.extract_mesh(field, 128)
        axes.add_collection(LineCollection(V[E], colors=colour, linewidths=2))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_title(name, fontsize=9)
    axes.set_axis_off()
figure.savefig("rope.png", dpi=150)
