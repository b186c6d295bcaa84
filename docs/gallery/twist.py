"""Twist

The top of a cactus is turned by 60 degrees about its axis; the foot is held, and the rest follows as rigidly as it can.
"""

import math

import compare
import implicit
from implicit import HalfSpace, Handle, RigidMotion, shapes

field = shapes.bundled("cactus")
foot = Handle(HalfSpace((0, -0.6, 0), (0, -1, 0)), (0.0, 0.0, 0.0))

# A rotation vector: its direction is the axis, its length the angle in radians.
top = Handle(HalfSpace((0, 0.62, 0), (0, 1, 0)), RigidMotion(rotation=(0.0, math.radians(60), 0.0)))

# %%
# Linear steps turn points along their path: one for every 15 degrees or so. `method="finite"` minimises the energy of
# finite rotations instead, for motions of any size, at more cost; `"auto"` chooses.
edit = implicit.rigid_edit(field, [foot, top], method="linear", steps=4, points=900)
print(edit.status.value, *edit.notes)

compare.draw(edit, before=field, path="twist.png")
