"""The paper's figures and numbers, made again with shapes at hand: a file a figure, each with one function `draw`.

A figure is asked for by name (`PARTS`), draws its pictures into the folder of the request, and returns what it
measured beside what the paper says. docs/paper.md says which figure of the paper each of them makes.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time

from compare.files import replace_file
from compare.paper.findings import FILE, Finding, Measured, read_measured, table, write_measured
from compare.paper.request import Request, Tell
from compare.runs.provenance import surroundings

__all__ = ["PARTS", "Finding", "Measured", "Request", "draw_parts", "pictures"]

# Modules of this package, in the order of the paper, with about the processor seconds that each takes, quick and full
# with the meshes: for the first guess at what is left, which the parts that are done then put right.
PARTS: dict[str, tuple[float, float]] = {
    "basis": (20, 50),
    "geometric": (30, 240),
    "splitting": (15, 60),
    "semantic": (20, 30),
    "semantic_basis": (5, 10),
    "semantic_spheres": (20, 30),
    "semantic_damping": (5, 60),
    "rope": (5, 20),
    "smoothing": (20, 320),
    "rigid": (10, 600),
    "rigid_bends": (60, 250),
}


def draw_parts(
    request: Request, parts: Sequence[str] = tuple(PARTS), *, resume: bool = False, progress: Tell | None = None
) -> list[Finding]:
    """Draw parts of the paper, one after the other, keeping the findings of each as soon as it is done.

    Args:
        request: Where to, on which shapes, how finely.
        parts: Names out of PARTS.
        resume: Leave out those that the folder already holds with the same settings.
        progress: Told before each part how many are done, how many there are, and its name with the time left.

    Returns:
        The findings of these parts, which are also in findings.json and findings.md of the folder, beside the pictures
        and the findings of other parts that are there already.

    Raises:
        ValueError: The folder holds a findings.json of something else.
    """
    file = request.folder / FILE
    kept = {measured.part: measured for measured in read_measured(file)}
    settings = request.settings
    todo = [part for part in parts if not (resume and part in kept and kept[part].settings == settings)]
    begin = perf_counter()
    for done, part in enumerate(todo):
        if progress is not None:
            left = _left(todo, done, perf_counter() - begin, quick=request.quick)
            progress(len(parts) - len(todo) + done, len(parts), f"{part}, {left}")
        kept[part] = _draw(request, part)
        ordered = [kept[name] for name in PARTS if name in kept]
        write_measured(ordered, file)
        replace_file(request.folder / "findings.md", table(ordered).encode())
    if progress is not None:
        progress(len(parts), len(parts), "done")
    return [finding for part in parts for finding in kept[part].findings]


def pictures(folder: Path) -> list[Path]:
    """Return the pictures that are in a folder."""
    return sorted(path for path in folder.iterdir() if path.suffix in (".png", ".pdf"))


def _draw(request: Request, part: str) -> Measured:
    start, start_of_processor = perf_counter(), process_time()
    findings = import_module(f"compare.paper.{part}").draw(request)
    where = {name: value for name, value in surroundings().items() if name != "host"}  # findings are published
    return Measured(
        part,
        tuple(findings),
        request.settings,
        where,
        round(perf_counter() - start, 1),
        round(process_time() - start_of_processor, 1),
    )


def _left(todo: Sequence[str], done: int, elapsed: float, *, quick: bool) -> str:
    """Return what the parts from `done` on will take, at the pace of those before."""
    expected = [PARTS[part][0 if quick else 1] for part in todo]
    pace = elapsed / sum(expected[:done]) if done else 1.0
    seconds = pace * sum(expected[done:])
    return f"about {seconds / 60:.0f} min left" if seconds >= 90 else f"about {seconds:.0f} s left"
