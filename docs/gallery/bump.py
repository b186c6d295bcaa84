"""Raise a bump

Ask first whether the network can do it, then push a part of the surface out along its normals, with the volume held.
"""

import compare
import implicit
from implicit import shapes

field = shapes.bundled("cactus")  # or implicit.Field(your_torch_module), or implicit.load_field(path)

# A handle is a region and a motion. This one is a ball about a place of the trunk, whose weight sinks to 0 over the
# falloff, and whose points are to move 0.08 along their normals. Lengths are the field's: it lives in [-1, 1]^3.
bump = implicit.Handle(implicit.Ball((0.0, -0.5, 0.19), 0.05, falloff=0.4), implicit.Along(0.08))

# %%
# The prediction takes one matrix and one factor, and no edit.
print(implicit.expressibility(field, bump, rest="free", steps=3, points=800).sentence())

# %%
# What is in no region stays where it is by default (`rest="fixed"`). Free, it gives the volume that the bump takes.
edit = implicit.geometric_edit(field, bump, rest="free", steps=3, points=800, constraints=[implicit.Volume()])
error = edit.error_field().nan_to_num()  # NaN where nothing was asked
print(edit.status.value)
print(f"Largest error {float(error.abs().max()):.1%} of the bump.")
for row in edit.history:
    print(f"{row['fraction']:.2f} of the way: volume {row['volume']:.7f}, damping {row['damping']:.1e}")

compare.draw(edit, before=field, colours="error", azimuth=10, path="bump.png")
