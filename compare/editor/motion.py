"""The motion of the hand: one motion for all regions that go with it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from compare.cases.handles import HandleSpec
from compare.editor.regions import Picked, held

# Of a motion as a column of numbers: a matrix, the translation, and the distance along the normal.
COLUMNS = 13

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Motion:
    """A motion about the grip of a region: x -> factor R (x - grip) + grip + translation, or along the normal.

    Attributes:
        translation: Vector, a length each.
        rotation: Axis times angle in radians.
        factor: Scaling, positive.
        along: Distance outward along the normal; then the others must be left at rest.

    Raises:
        ValueError: A number is not finite, the factor is not positive, or both kinds are given.
    """

    translation: Triple = (0.0, 0.0, 0.0)
    rotation: Triple = (0.0, 0.0, 0.0)
    factor: float = 1.0
    along: float = 0.0

    def __post_init__(self) -> None:
        for part in fields(self):
            value = getattr(self, part.name)
            count = 3 if part.name in ("translation", "rotation") else 1
            try:
                numbers = np.asarray(value, dtype=float).ravel()
            except (TypeError, ValueError):
                numbers = np.empty(0)
            if len(numbers) != count or not np.isfinite(numbers).all():
                wanted = "three finite numbers" if count == 3 else "a finite number"
                raise ValueError(f"The {part.name} of a motion must be {wanted}, but is {value!r:.200}.")
            object.__setattr__(self, part.name, tuple(map(float, numbers)) if count == 3 else float(numbers[0]))
        if not self.factor > 0:
            raise ValueError(f"The factor of a motion must be positive, but is {self.factor!r}.")
        if self.along != 0 and not self._of_space_at_rest:
            raise ValueError("A motion goes along the normal or through space, but both are given. Leave one out.")

    @property
    def _of_space_at_rest(self) -> bool:
        return not any(self.translation) and not any(self.rotation) and self.factor == 1

    @property
    def at_rest(self) -> bool:
        """Return whether nothing moves."""
        return self._of_space_at_rest and self.along == 0

    @property
    def matrix(self) -> Float[ndarray, "3 3"]:
        """Return the linear part, factor R."""
        return self.factor * Rotation.from_rotvec(self.rotation).as_matrix()

    def column(self) -> Float[ndarray, " c"]:
        """Return the motion as COLUMNS numbers, in which the displacement of every point is linear.

        Of a rotation these are its velocity: its chord has a part along the normal even of a ball that turns on itself.
        """
        x, y, z = self.rotation
        velocity = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) + (self.factor - 1) * np.eye(3)
        return np.concatenate([velocity.ravel(), self.translation, [self.along]])

    def spec(self, picked: Picked) -> HandleSpec:
        """Return the handle that this motion makes of a region."""
        if picked.role == "held":
            return held(picked.region)
        return HandleSpec(picked.region, self._words(picked.grip))

    def _words(self, grip: Iterable[float]) -> dict[str, Any]:
        if self.along != 0:
            return {"kind": "along", "distance": self.along}
        if not any(self.rotation) and self.factor == 1:
            return {"kind": "vector", "vector": list(self.translation)}
        turn = {"rotation": list(self.rotation), "translation": list(self.translation), "center": list(grip)}
        return {"kind": "rigid", **turn} if self.factor == 1 else {"kind": "similar", "factor": self.factor, **turn}


def carried(picked: Picked, motion: Motion, grip: Triple) -> Picked:
    """Return a region after an edit that took it along.

    Args:
        picked: Before.
        motion: What the hand did.
        grip: Where the place by which it is held is on the edited surface.
    """
    if picked.role == "held" or motion.at_rest:
        return picked
    start, end, matrix = np.asarray(picked.grip), np.asarray(grip), motion.matrix
    region = dict(picked.region)
    for name in ("center", "centers", "point"):
        if name in region:
            region[name] = ((np.asarray(region[name]) - start) @ matrix.T + end).tolist()
    if "normal" in region:
        region["normal"] = (matrix @ np.asarray(region["normal"])).tolist()
    if "lower" in region:  # a box stays along the axes
        middle = (np.asarray(region["lower"]) + np.asarray(region["upper"])) / 2
        half = motion.factor * (np.asarray(region["upper"]) - middle)
        middle = (middle - start) @ matrix.T + end
        region |= {"lower": (middle - half).tolist(), "upper": (middle + half).tolist()}
    for name in ("radius", "falloff"):
        if name in region:
            region[name] = motion.factor * region[name]
    return Picked(region, picked.role, grip)
