"""Choice between the two ways of a rigid edit, linear steps or finite rotations: measured where none is asked for.

A linear step forgets what earlier ones have strained and stretches what turns by an angle a by a^2 / 2. Up to a few
degrees that is nothing, and its optimum is exact among what the network can express; beyond, finite rotations are
nearer by far. What counts is what is left of the motion after the rigid motion of all that comes nearest to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import Literal, get_args

from implicit.arguments import require_choice
from implicit.edits.finite_rigid import turning
from implicit.edits.rigid_placement import Placement
from implicit.edits.targets import AveragedTargets
from implicit.surface.quadrature import SurfaceSample

Method = Literal["auto", "linear", "finite", "warp", "coupled"]

# Those that take finite rotations and have none of the options of linear steps.
BY_ROTATIONS = ("finite", "warp", "coupled")

# Measured on the bundled cow, whose head is pulled by a part of its length; energies over that of converged ARAP on its
# common mesh, of one linear step and of finite rotations: 1.09 and 1.12 at 1 %, 1.009 and 1.013 at 3 %, 1.014 and 1.009
# at 6 %, 1.031 and 1.011 at 10 %, 1.067 and 1.006 at 15 %. Of 6 %, 0.015 of the side and 3.5 degrees are left.
#
# Longest way that is left to a handle, over the longest side of the surface, and largest angle by which the handles
# turn against each other along their path, in radians, up to which linear steps are taken.
LONG = 0.012
TURNED = 0.06

# Fewest parameters of a field that can be trained to another shape; for a formula's few a step's optimum is the best.
FEWEST = 200


@dataclass(frozen=True)
class Choice:
    """Choice of the way that a rigid edit goes, and why.

    Attributes:
        finite: True for finite rotations.
        coupled: True for finite rotations of field and points together.
        warp: True where the space before the field is warped, and its parameters stay.
        notes: What the edit is to say of it: nothing where the caller has chosen.
    """

    finite: bool
    notes: tuple[str, ...] = ()
    coupled: bool = False
    warp: bool = False


def chosen(method: Method, parameters: int, linear_options: list[str]) -> Choice | None:
    """Return the way to go where that is told, or None where it is to be measured.

    Args:
        method: What the caller asks for.
        parameters: How many the field has.
        linear_options: Names of the options that the caller has set and that finite rotations have not.

    Raises:
        ValueError: The method is none, or finite rotations are asked for with options that they have not.
    """
    require_choice("method", method, get_args(Method))
    own = [name for name in linear_options if method != "coupled" or name != "tangential"]
    if method in BY_ROTATIONS and own:
        raise ValueError(
            f'{", ".join(own)} must be left out with method="{method}": the energy of finite rotations has no '
            'such option. Leave it out, or take method="linear".'
        )
    if method != "auto" or linear_options:
        return Choice(method in BY_ROTATIONS, coupled=method == "coupled", warp=method == "warp")
    if parameters < FEWEST:
        return Choice(False, (f"Linear steps were taken, for the field has but {parameters} parameters.",))
    return None


def measured(sample: SurfaceSample, targets: AveragedTargets, whole: Placement) -> Choice:
    """Return the way to go by how much of the motion is left to the handles.

    Args:
        sample: Points of the unedited surface.
        targets: What the handles ask of them.
        whole: The rigid motion that goes nearest to it.
    """
    held = targets.prescribed
    left = (targets.positions(1.0) - whole.at(sample.points))[held].norm(dim=1).max()
    side = (sample.points.amax(dim=0) - sample.points.amin(dim=0)).max()
    long, angle = float(left / side), turning(targets)
    finite = long > LONG or angle > TURNED
    what = "Finite rotations were taken" if finite else "Linear steps were taken"
    return Choice(
        finite,
        (
            f"{what}: after the best rigid motion of the whole, {long:.2g} of the longest side and "
            f"{degrees(angle):.2g} degrees are left to the handles (up to {LONG:g} and {degrees(TURNED):.2g} linear "
            "steps do).",
        ),
    )
