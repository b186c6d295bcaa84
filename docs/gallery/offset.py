"""Thicken and thin

`smooth` takes any flow. `Offset` moves the surface along its normals at one speed: time times speed is the distance.
"""

import compare
import implicit
from implicit import Offset, shapes

bracket = shapes.bundled("bracket")
before = implicit.integrate(bracket, implicit.Volume(), 48).value

# %%
edits = {}
for name, speed in (("thicker", 1.0), ("thinner", -1.0)):
    edit = implicit.smooth(bracket, steps=2, step_size=0.01, flow=Offset(speed), points=300, resolution=32)
    volume = implicit.integrate(edit.field, implicit.Volume(), 48).value
    moved = (edit.displacement * edit.normals).sum(dim=1)
    print(
        f"{name}: the surface moved by {float(moved.mean()):+.4f}, the volume by {100 * (volume / before - 1):+.1f} %"
    )
    edits[name] = edit

compare.draw(bracket, *edits.values(), titles=["before", *edits], path="offset.png")
