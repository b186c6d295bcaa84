"""Anderson's acceleration of a fixed-point iteration x -> G(x).

Of the last iterates, those weights (with sum one) are found for which the residuals G(x) - x, so combined, are least,
and their images G(x) are combined alike: on a linear iteration this is GMRES. It may overshoot where G is not linear,
so that its user has to judge each result and, where it is no better, to take G(x) and forget.
Sources: Anderson 1965; Walker and Ni 2011.
"""

from __future__ import annotations

import numpy as np

from meshref.topology import FloatArray


class Anderson:
    """The iterates kept of one iteration."""

    def __init__(self, window: int) -> None:
        """Begin with none.

        Args:
            window: Most differences of iterates to combine, at least 1.
        """
        self._window = window
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._residual_changes: list[FloatArray] = []
        self._image_changes: list[FloatArray] = []

    def combined(self, x: FloatArray, image: FloatArray) -> FloatArray:
        """Return the iterate to go on from: the combination, or the image itself where there is nothing to combine.

        Args:
            x: Iterate, of any shape.
            image: G(x).
        """
        residual = image - x
        if self._last is not None:
            self._residual_changes = [*self._residual_changes, residual - self._last[0]][-self._window :]
            self._image_changes = [*self._image_changes, image - self._last[1]][-self._window :]
        self._last = (residual, image)
        if not self._residual_changes:
            return image
        changes = np.stack([change.ravel() for change in self._residual_changes])
        gram = changes @ changes.T
        gram += 1e-12 * np.trace(gram) * np.eye(len(gram))  # differences may repeat each other
        try:
            weights = np.linalg.solve(gram, changes @ residual.ravel())
        except np.linalg.LinAlgError:  # all differences are zero
            return image
        result = image.copy()
        for weight, change in zip(weights, self._image_changes, strict=True):
            result -= weight * change
        return result
