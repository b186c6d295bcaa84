"""Lengthen a wing, and a wish that the model cannot grant

An airplane of the family has two like wings. Lengthen one, and both grow; ask for one longer and one shorter, and the
edit says that it was not reached.
"""

import compare
import implicit
from implicit import Ball, Handle, families

model = families.bundled("dualsdf-airplanes")
airplane = model.field(model.latents[0].clone())
V, F = implicit.extract_mesh(airplane, resolution=48)
tips = V[V[:, 0].argmax()], V[V[:, 0].argmin()]

# %%
longer = Handle(Ball(tips[0], 0.12), (0.12, 0.0, 0.0))
edits = {"one wing longer": implicit.semantic_edit(airplane, *implicit.prescribe(airplane, longer, points=60))}

# %%
print(f"Wings to {V[:, 0].min():.2f} and {V[:, 0].max():.2f} before.")
shorter = Handle(Ball(tips[1], 0.12), (0.12, 0.0, 0.0))
points, displacements = implicit.prescribe(airplane, [longer, shorter], points=60)
edits["one longer, one shorter"] = implicit.semantic_edit(airplane, points, displacements)

for name, edit in edits.items():
    W = implicit.extract_mesh(edit.field, resolution=48)[0]
    print(f"{name}: wings to {W[:, 0].min():.2f} and {W[:, 0].max():.2f}.", edit.status.value)

compare.draw(
    airplane,
    *edits.values(),
    titles=["before", *edits],
    colours="plain",
    resolution=80,
    azimuth=35,
    path="airplane_wing.png",
)
