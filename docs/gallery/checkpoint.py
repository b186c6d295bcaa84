"""A published checkpoint

Networks of SIREN, i3d, IGR, NeuS and VolSDF are read as their authors' code saves them. Here a file in the layout of
SIREN is written first, to have one; with a file of yours, begin at `load_network`.
"""

import torch

import compare
import implicit
from implicit import Ball, HalfSpace, Handle, shapes

# The bundled cow is a network of sines: its weights under the names that SIREN's code gives them.
cow = shapes.bundled("spot")
state = {
    name.replace("layers.", "net.net.").replace(".weight", ".0.weight").replace(".bias", ".0.bias"): tensor
    for name, tensor in cow.module.state_dict().items()
}
torch.save(state, "model_final.pth")
print({name: tuple(tensor.shape) for name, tensor in state.items()})

# %%
# The layout is found from the names of the tensors. Which frequencies stand in the sines no tensor tells: SIREN's code
# has 30 in all, the default; this network has others. A surface that looks wrong has the wrong ones.
field = implicit.load_network("model_final.pth", "auto", first_frequency=12, frequency=6)
print(field)

# %%
# Drag the highest place up, the legs held, and keep the result. `save_field` writes weights and architecture, no code.
V, F = implicit.extract_mesh(field, 48)
head = Handle(Ball(V[V[:, 1].argmax()], 0.15, falloff=0.3), (0.0, 0.1, 0.0))
feet = Handle(HalfSpace((0.0, V[:, 1].min() + 0.25, 0.0), (0, -1, 0)), (0.0, 0.0, 0.0))
edit = implicit.rigid_edit(field, [head, feet], method="linear", points=800)
print(edit.status.value)
implicit.save_field(edit.field, "dragged.safetensors")

compare.draw(edit, before=field, azimuth=40, path="checkpoint.png")
