"""The diagrams that come along, by name."""

from __future__ import annotations

from compare.studies.diagram import Diagram
from compare.studies.representation import Representation
from compare.studies.work_precision import WorkPrecision

DIAGRAMS: dict[str, Diagram] = {diagram.name: diagram for diagram in (WorkPrecision(), Representation())}
