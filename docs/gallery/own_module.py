"""A torch module of your own

Any module that maps points to values is a field: trained, edited, saved with the name of what builds it, read again.
"""

import sys
from pathlib import Path

import compare
import implicit
from implicit import Along, Ball, Handle, shapes

# The module lies in a file, so that a saved field can name the function that builds it.
Path("my_nets.py").write_text("""
import torch
from torch import nn

def make(width=32):
    torch.manual_seed(0)
    soft = nn.Softplus(20)
    return nn.Sequential(nn.Linear(3, width), soft, nn.Linear(width, width), soft, nn.Linear(width, 1))
""")
sys.path.insert(0, "")  # files of this folder
from my_nets import make  # noqa: E402

# %%
# Trained on the signed distances of a torus: points on it and moved off it by a random length.
torus = shapes.torus()
points = implicit.sample_surface(torus, 4000).points
points = points + 0.05 * points.flip(0)
field, training = implicit.fit_field(
    points.float(), torus.value(points).float(), torus.normal(points).float(), module=make(width=48), steps=400
)
print(training)

# %%
# Edited like any other, and written back into a module of yours if you like: edit.field.module.
outermost = implicit.extract_mesh(field, 32)[0]
place = outermost[outermost[:, 0].argmax()]
edit = implicit.geometric_edit(field, Handle(Ball(place, 0.1, falloff=0.3), Along(0.08)), steps=3, points=1000)
print(edit.status.value)

# %%
# A file never runs code: `load_field` wants it named in the call.
implicit.save_field(edit.field, "mine.safetensors", builder="my_nets.py:make", arguments={"width": 48})
again = implicit.load_field("mine.safetensors", module="my_nets.py:make")
print("The same to the last digit:", bool((again.theta == edit.field.theta).all()))

compare.draw(edit, before=field, path="own_module.png")
