"""A rope: a closed curve in the plane that is pulled at one place and keeps its length [constraints, eq. 7].

In the plane the area of the surface is the length of the curve. The paper pulls a rope under this constraint by
projecting each step; here the length is a hard row of each step and is then restored, and the projection, which is
exact to first order only, is beside it.
"""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import implicit
from compare.figures import HELD, MOVED
from compare.paper.findings import Finding
from compare.paper.request import Request
from implicit import Along, Area, Ball, Edit, Field, Handle

PART = "rope"
RADIUS = 0.45
HANDLE = Handle(Ball((RADIUS, 0.0), 0.05, falloff=0.35), Along(0.15))
SQUARE = ((-1.0, -1.0), (1.0, 1.0))
CELLS = 256  # of the quadrature that measures the length, finer than that of the edits


def draw(request: Request) -> list[Finding]:
    """Pull the rope with its length free and held, and draw both."""
