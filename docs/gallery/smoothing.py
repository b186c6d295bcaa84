"""Smooth, with the volume or the area held

Mean-curvature flow shrinks what it smooths. Any integral can be held to its digits while it flows.
"""

import compare
import implicit
from implicit import Area, Holding, Volume, shapes

cow = shapes.bundled("spot")

# %%
# One flow, three times: free, at constant volume, at constant area. The flow is the steepest descent of the area, so
# that little of it is left where the area is held.
options = {"steps": 3, "step_size": 1.5e-3, "points": 200, "directions": 100, "resolution": 24}
options["holding"] = Holding(resolution=24, fine_resolution=32, finest_resolution=32)  # coarse; the defaults are finer
edits = {
    "free": implicit.smooth(cow, **options),
    "volume held": implicit.smooth(cow, constraints=[Volume()], **options),
    "area held": implicit.smooth(cow, constraints=[Area()], **options),
}

# %%
# `integrate` measures with an estimate of its own error.
before = {one: implicit.integrate(cow, one(), 32).value for one in (Volume, Area)}
for name, edit in edits.items():
    change = {one.__name__: implicit.integrate(edit.field, one(), 32).value / before[one] - 1 for one in before}
    print(f"{name}: " + ", ".join(f"{what} {100 * by:+.2g} %" for what, by in change.items()))

compare.draw(cow, *edits.values(), titles=["before", *edits], path="smoothing.png")
