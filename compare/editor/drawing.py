"""Drawing on the page: places under the pointer, colours of numbers, and their scale."""

from __future__ import annotations

from html import escape

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from compare.editor.linear import Surface

# Blue to red over white: told apart by those who see no green, and sound on a light page and on a dark one.
NEGATIVE, MIDDLE, POSITIVE = (33, 102, 172), (247, 247, 247), (178, 24, 43)
UNKNOWN = (150, 150, 150)

SHAPE = (150, 175, 205)
REGIONS = ((230, 120, 20), (40, 140, 70), (140, 80, 180), (200, 50, 90), (90, 120, 20), (20, 130, 150))
HELD = (70, 70, 70)


def under_ray(
    V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], origin: Float[ndarray, " 3"], direction: Float[ndarray, " 3"]
) -> Float[ndarray, " 3"] | None:
    """Return the first place of a mesh on a ray [Moeller and Trumbore 1997], or None.

    Args:
        V, F: The mesh.
        origin, direction: Of the ray (3,).
    """
    A, B, C = V[F].transpose(1, 0, 2)
    one, two = B - A, C - A
    across = np.cross(direction, two)
    determinant = (one * across).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / determinant
        away = origin - A
        u = (away * across).sum(axis=1) * inverse
        turned = np.cross(away, one)
        v = (turned @ direction) * inverse
        t = (two * turned).sum(axis=1) * inverse
        hit = (np.abs(determinant) > 1e-15) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    if not hit.any():
        return None
    place: Float[ndarray, " 3"] = origin + t[hit].min() * direction
    return place


def sight(wxyz: Float[ndarray, " 4"], fov: float, aspect: float, screen: tuple[float, float]) -> Float[ndarray, " 3"]:
    """Return the direction in which a place of the screen is seen.

    Args:
        wxyz: Orientation of a camera that looks along its z, its y down.
        fov: Vertical angle of view in radians.
        aspect: Width over height.
        screen: Place on the screen, from (0, 0) at the upper left to (1, 1).
    """
    w, x, y, z = (float(part) for part in wxyz)
    half = np.tan(fov / 2)
    local = np.array([(2 * screen[0] - 1) * half * aspect, (2 * screen[1] - 1) * half, 1.0])
    direction: Float[ndarray, " 3"] = Rotation.from_quat([x, y, z, w]).apply(local / np.linalg.norm(local))
    return direction


def colours(values: Float[ndarray, " n"], largest: float) -> Float[ndarray, "n 3"]:
    """Return a colour (n, 3), 0 to 255, for each number between minus the largest and it; grey for NaN."""
    share = np.clip(values / max(largest, 1e-300), -1, 1)
    ends = np.where((share < 0)[:, None], np.array(NEGATIVE), np.array(POSITIVE))
    mixed = np.array(MIDDLE) + np.abs(share)[:, None] * (ends - np.array(MIDDLE))
    return np.where(np.isfinite(values)[:, None], mixed, np.array(UNKNOWN))


def scale_of_colours(title: str, largest: float) -> str:
    """Return the scale as HTML, with numbers in per cent."""
    stops = ", ".join(f"rgb{colour}" for colour in (NEGATIVE, MIDDLE, POSITIVE))
    top = f"{100 * largest:.3g} %"
    ends = f"<span>-{top}</span><span>0</span><span>+{top}</span>"
    return (
        f'<div style="padding:0.3em 0.8em;font-size:0.85em">{escape(title)}'
        '<div style="height:0.8em;border-radius:3px;margin:0.3em 0;'
        f'background:linear-gradient(to right, {stops})"></div>'
        f'<div style="display:flex;justify-content:space-between">{ends}</div></div>'
    )


def shown_range(values: Float[ndarray, " n"]) -> float:
    """Return the end of the scale for some numbers: their 99th percentile in size, rounded up to 1, 2 or 5."""
    known = np.abs(values[np.isfinite(values)])
    top = float(np.quantile(known, 0.99)) if known.size else 0.0
    if top <= 0:
        return 0.01
    power = 10.0 ** np.floor(np.log10(top))
    return float(power * next(step for step in (1, 2, 5, 10) if step * power >= top * (1 - 1e-9)))


def dots(
    surface: Surface, weights: Float[ndarray, " n"], colour: tuple[int, int, int], size: float
) -> tuple[Float[ndarray, "k 3"], ndarray]:
    """Return places just above the surface where a region's weight is positive, and colours that fade with it.

    Args:
        surface: As drawn.
        weights: Of its vertices.
        colour: Of the region.
        size: Of the field.
    """
    inside = weights > 0
    places = surface.V[inside] + 0.002 * size * surface.N[inside]
    strength = 0.25 + 0.75 * np.clip(weights[inside], 0, 1)[:, None]
    faded = np.array(SHAPE) + strength * (np.array(colour) - np.array(SHAPE))
    return places, faded.astype(np.uint8)
