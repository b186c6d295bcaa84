"""Letters, which fail

A network of 3 x 32 sines holds smooth shapes. Sharp letters are beyond it, and both the prediction and the edit say so.
"""

import compare
import implicit
from implicit import Along, Box, Handle, shapes

field = shapes.bundled("cactus")

# Regions combine by `|`, `&` and `~`: a T of two boxes that reach into the front of the trunk.
letter = Box((-0.16, 0.3, 0.0), (0.16, 0.4, 1.0)) | Box((-0.05, 0.0, 0.0), (0.05, 0.4, 1.0))
raised = Handle(letter, Along(0.03))

# %%
# The verdict is NO before any work was done, with the share that is out of reach and where most is missed.
prediction = implicit.expressibility(field, raised, steps=3, points=2000)
print(prediction.verdict.name, prediction.sentence(), sep=": ")

# %%
# Edited all the same, the letter comes out as a soft hump. The edit does not hide it.
edit = implicit.geometric_edit(field, raised, steps=3, points=2000)
print(edit.status.name, edit.status.value, sep=": ")

compare.draw(edit, before=field, azimuth=0, path="letters.png")
