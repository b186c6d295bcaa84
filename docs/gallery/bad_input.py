"""Bad input, and what it says

Nothing is guessed and nothing half done: what cannot be used is refused before any work, with what was wanted, what
came, and what to do. A mesh that can be mended is mended, and every change is told.
"""

import numpy as np

import compare
import implicit
import meshref
from implicit import Ball, Handle, shapes

field = shapes.bundled("cactus")


def told(make):
    """Print the message of what is refused."""
    try:
        make()
    except (ValueError, TypeError) as error:
        print(f"{type(error).__name__}: {error}\n")


# %%
# A region that misses the surface, a displacement that is none, an unknown word, points off the surface.
told(lambda: implicit.geometric_edit(field, Handle(Ball((2.0, 2.0, 2.0), 0.1), (0.0, 0.1, 0.0))))
told(lambda: Handle(Ball((0.0, 0.3, 0.2), 0.1), (0.0, float("nan"), 0.0)))
told(lambda: implicit.smooth(field, steps=2, method="fast"))
told(lambda: implicit.basis(field, field.theta.new_zeros(4, 3)))

# %%
# A mesh with a hole, a flipped face and a doubled vertex.
V, F = meshref.icosphere(3)
broken = F[np.linalg.norm(V[F].mean(axis=1) - [0.5, 0.4, 0.75], axis=1) > 0.3].copy()
broken[7] = broken[7][::-1]
told(lambda: meshref.volume(V, broken))
told(lambda: meshref.hausdorff(V, F, V[:3], F))

# %%
# Mended, with a sentence for each change.
W, G, mended = meshref.mend_mesh(V, broken)
print(*mended.steps, sep="\n")

compare.draw((V, broken), (W, G), titles=["as it came", "mended"], path="bad_input.png")
