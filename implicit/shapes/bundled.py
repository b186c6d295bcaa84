"""Networks fitted to shapes, which come with the package."""

from __future__ import annotations

from importlib import resources

from implicit.field.field import Field
from implicit.models.field_file import load_field

BUNDLED = ("spot", "cactus", "bracket")


def bundled(name: str) -> Field:
    """Return a network of 3 hidden layers of 32 sines fitted to a shape, one of BUNDLED; float32.

    "spot" is Keenan Crane's cow (public domain), "cactus" and "bracket" the shapes of that name in this file.
    How well each fits stands in data/<name>.json; `python -m compare.fitting.bundle` makes them again.
    """
    if name not in BUNDLED:
        raise ValueError(f"There is no bundled field {name!r}; there are {', '.join(BUNDLED)}. Choose one of them.")
    with resources.as_file(resources.files("implicit") / "data" / f"{name}.safetensors") as path:
        return load_field(path)
