"""Shorten one leg of a chair

A semantic edit prescribes how a few points move and changes only the code of a generative model. The other legs follow,
as the model has learned it.
"""

import compare
import implicit
from implicit import families

# Six small models come along. Published IM-NET, DualSDF and DeepSDF checkpoints load by implicit.load_checkpoint.
model = families.bundled("deepsdf-chairs")
chair = model.field(model.latents[3].clone())

# %%
# The foot: a ball about the lowest vertex, to be moved up by 0.1.
V, F = implicit.extract_mesh(chair, resolution=48)
foot = implicit.Handle(implicit.Ball(V[V[:, 1].argmin()], 0.1), (0.0, 0.1, 0.0))
edit = implicit.semantic_edit(chair, *implicit.prescribe(chair, foot, points=60))
print(edit.status.value, f"{len(edit.history)} steps.")
print("The lowest point of the chair went from", round(float(V[:, 1].min()), 3), end=" to ")
print(round(float(implicit.extract_mesh(edit.field, resolution=48)[0][:, 1].min()), 3))

compare.draw(chair, edit, titles=["before", "one leg 0.1 shorter"], colours="plain", azimuth=35, path="chair_leg.png")
