"""Mesh editors alone

`meshref` needs no network: Killing least squares, ARAP and biharmonic deformation on the same handles, and the energies
by which they are told apart.
"""

import numpy as np

import compare
import meshref

V, F = meshref.cylinder(40, 60, radius=0.2, height=2.0)
held = np.flatnonzero(V[:, 2] < -0.85)
moved = np.flatnonzero(V[:, 2] > 0.85)

# %%
# The upper end goes 0.8 aside and down a little. Handles are numbers of vertices; ARAP takes places, the others ways.
handles = np.concatenate([held, moved])
displacements = np.zeros((len(handles), 3))
displacements[len(held) :] = [0.8, 0.0, -0.2]
results = {
    "Killing": meshref.killing(V, F, handles, displacements).displacement,
    "ARAP": meshref.arap(V, F, handles, V[handles] + displacements).V - V,
    "biharmonic": meshref.biharmonic(V, F, handles, displacements).displacement,
}

# %%
# The linear ones stretch what they should turn: ARAP has the least energy of finite rotations.
for name, D in results.items():
    killing, arap = meshref.killing_energy(V, F, D), meshref.arap_energy(V, F, V + D)
    print(f"{name}: Killing energy {killing:.3f}, ARAP energy {arap:.3f}, volume {meshref.volume(V + D, F):.4f}")

upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up in the cylinder, y up in the picture
meshes = [((V + D) @ upright.T, F, np.linalg.norm(D, axis=1)) for D in results.values()]
compare.draw((V @ upright.T, F), *meshes, titles=["before", *results], azimuth=0, path="mesh_editors.png")
