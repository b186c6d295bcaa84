"""The pace of edits: ten pieces of work beside the seconds, or the ratio in one run, that each is to come to.

    python benchmarks/pace.py                       all rows by the wall clock, printed
    python benchmarks/pace.py --cpu rigid "8 x 64"  rows whose names hold a word, by the processor's seconds
    python benchmarks/pace.py --write               and kept in docs/pace.json; the page docs/pace.md is made anew

Rows of networks train them first, to the distances of a capsule; --networks FOLDER keeps them from run to run.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch is imported; see side_by_side.py

import numpy as np
import torch
from skimage.measure import marching_cubes

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import implicit
import meshref
from benchmarks import whole_edits
from compare import Case, Subject, default_cases, prepare_subject
from compare.paper.rigidity import mesh_of, pulled_case
from compare.runs.operations import target_motion
from implicit import shapes

ROOT = Path(__file__).resolve().parents[1]
RESULTS, PAGE = ROOT / "docs" / "pace.json", ROOT / "docs" / "pace.md"

clock = time.perf_counter
folder: Path | None = None  # where trained networks are kept


class Found(NamedTuple):
    """What a row came to: seconds of ours, those of the other side if there is one, and at what accuracy."""

    ours: float
    theirs: float | None
    words: str


def seconds(work: Callable[[], object], repeats: int = 1) -> tuple[float, object]:
    """Return the least seconds of some runs, and the last result."""
    taken, result = [], None
    for _ in range(repeats):
        start = clock()
        result = work()
        taken.append(clock() - start)
    return min(taken), result


@cache
def cow() -> Subject:
    return prepare_subject(Case("spot", "smooth"))


# The rows


def geometric_edit() -> Found:
    """The bump of the comparison on the bundled cow, 6 % of its longest side, with default options."""
    field = shapes.bundled("spot")
    (case,) = default_cases("spot", cow().V, cow().N, operations=("geometric",))
    handles = [spec.build() for spec in case.handles]
    spent, edit = seconds(lambda: implicit.geometric_edit(field, handles))
    error = edit.error_field(implicit.sample_surface(field, 3000, seed=11))
    words = f"{100 * float(error.square().mean().sqrt()):.2g} % of the bump (rms, at other points)"
    return Found(spent, None, words)


def drag_update() -> Found:
    """The linear preview of a drag by 2 % of the box on the editor's mesh; editor_pace.py tells it with the drawing."""
    from compare.editor.motion import Motion  # needs the extra of the editor
    from compare.editor.session import EditSession

    session = EditSession.open("spot")
    session.pick({"kind": "ball", "center": session.surface.V[0].tolist(), "radius": 0.1, "falloff": 0.2})
    moves = [Motion(translation=(0.0, 0.02 * session.field.size * k / 8, 0.0)) for k in range(1, 9)]
    session.preview(moves[0])
    spent, _ = seconds(lambda: [session.preview(move) for move in moves])
    return Found(spent / len(moves), None, f"{len(session.surface.V):,} vertices; without drawing and browser")


def rigid_step() -> Found:
    """One linear step of 2000 points given, and the mesh's least squares at 3300 vertices."""
    subject = cow()
    case = pulled_case("spot", subject)
    handles = [spec.build() for spec in case.handles]
    sample = implicit.sample_surface(subject.field, 2000, "farthest")
    step = partial(implicit.rigid_edit, subject.field, handles, method="linear", points=sample)
    ours, edit = seconds(step, 2)
    V, F = mesh_of(subject.field, 3500)
    normals = subject.field.normal(torch.from_numpy(V)).numpy()
    target = target_motion(case, replace(subject, V=V, F=F, N=normals))
    at = np.flatnonzero(target.at)
    mesh = partial(meshref.killing, V, F, at, target.displacement[at])
    mesh()
    theirs, result = seconds(mesh, 3)
    error = edit.error_field()
    missed = float(error[error.isfinite()].square().mean().sqrt())
    return Found(ours, theirs, f"{len(V):,} vertices ({result.solver}); handles missed by {100 * missed:.2g} %")


def smoothing() -> Found:
    """30 steps with the volume held, and the mesh's semi-implicit flow at 36,000 vertices."""
    field = shapes.bundled("spot")
    V, F = mesh_of(field.to(torch.float64), 35_000)
    size = 1e-4 * meshref.area(V, F)
    options = {"steps": 30, "step_size": size}
    flow = partial(meshref.mean_curvature_flow, V, F, method="semi-implicit", preserve_volume="newton", **options)
    holding = implicit.Holding(resolution=32, fine_resolution=128)
    implicit.smooth(field, steps=1)
    theirs, _ = seconds(flow)
    ours, edit = seconds(lambda: implicit.smooth(field, constraints=(implicit.Volume(),), holding=holding, **options))
    after, before = (implicit.integrate(f, implicit.Volume(), 160).value for f in (edit.field, field))
    return Found(ours, theirs, f"volume drift {abs(after / before - 1):.1e}")


def small_semantic_edit() -> Found:
    """A chair's foot raised until 5 % is left: the formula at the paper's damping, and ours adapting its own."""
    from benchmarks.rows.semantic_edit import DAMPING, RaisedFoot

    scene = RaisedFoot()
    scene.published(), scene.ours(None)
    theirs_s, code = seconds(scene.published, 7)
    same_s, _ = seconds(partial(scene.ours, DAMPING), 7)
    ours_s, ours = seconds(partial(scene.ours, None), 7)
    words = f"goals missed by {100 * scene.missed(code):.1f} %, {100 * scene.missed(ours):.1f} %; at the formula's own "
    return Found(ours_s, theirs_s, words + f"damping ours takes {same_s:.2g} s")


def mesh_at_256() -> Found:
    """A mesh of 256 cells a side, and all nodes with scikit-image."""
    field, cells = shapes.bundled("spot"), 256

    def dense() -> tuple[np.ndarray, np.ndarray]:
        axis = torch.linspace(-1, 1, cells + 1)
        slab = torch.cartesian_prod(axis, axis)
        values = torch.stack(
            [field.value(torch.cat([x.expand(len(slab), 1), slab], dim=1)).view(cells + 1, -1) for x in axis]
        )
        return marching_cubes(values.numpy(), 0.0)[:2]

    ours, _ = seconds(lambda: implicit.extract_mesh(field, cells), 3)
    theirs, _ = seconds(dense, 2)
    return Found(ours, theirs, "two-sided Hausdorff distance in side-by-side.md")


def of_network(network: str, edit: str) -> Found:
    """A row of whole-edits.md, in this process."""
    module = whole_edits.NETWORKS[network]()
    kept = None if folder is None else folder / f"{network.replace(' ', '').replace(',', '-')}.pt"
    if kept is not None and kept.exists():
        module.load_state_dict(torch.load(kept, weights_only=True))
    else:
        module = whole_edits.fitted(network, "cpu")
        if kept is not None:
            torch.save(module.state_dict(), kept)
    field = implicit.Field(module)
    implicit.sample_surface(field, 100)
    spent, found = seconds(lambda: whole_edits.EDITS[edit](field))
    words = f"{found['off']:.1e} off, {found['status']}; with judging by other points; memory is in whole-edits.md"
    return Found(spent, None, words)


class Row(NamedTuple):
    """A row of the table: what is wanted of it, and what stands between where it is missed."""

    work: Callable[[], Found]
    at_most: float | None  # seconds
    at_least: float | None  # times the other side
    floor: str


ROWS: dict[str, Row] = {
    "geometric edit, bundled field": Row(
        geometric_edit,
        2.0,
        None,
        "eight systems of 1250 to 2250 equations are half, their Cholesky factors a fifth; two looks at 128 cells "
        "are a fifth, the sample a tenth",
    ),
    "a drag's update": Row(drag_update, 0.1, None, ""),
    "rigid step, 3 x 32": Row(
        rigid_step,
        0.3,
        0.5,
        "of a step from a field whose soundness is known a third is the soundness after it, on 128 cells; a twelfth "
        "the connection of the points; the rest is linear algebra of 2000 points and 500 off the surface: the factor "
        "of the mesh's energy, that of 2500 products of sensitivities (5e9 operations), these products, each about a "
        "tenth. Half as many points take 0.7 of the time and leave 8 % more energy",
    ),
    "smoothing": Row(
        smoothing,
        None,
        3.0,
        "a third are the start and the end, each on 128 cells and for the estimate on 85 and 64. Of a step a third is "
        "the mesh at 32 cells (all its 36,000 values, and 7000 places by Newton's method), a fifth one correction of "
        "the volume on the same cells carried along, a fifth the rows in 200 combinations; the rest are some forty "
        "calls at a few hundred points",
    ),
    "small semantic edit": Row(
        small_semantic_edit,
        None,
        1.5,
        "calls of small operations: some 10 ms a step whatever its size, of which the network is a third, and as much "
        "before and after",
    ),
    "mesh at 256^3": Row(
        mesh_at_256,
        None,
        15.0,
        "400,000 values and 115,000 gradients are half, and of these the sines alone half; marching cubes, and telling "
        "which nodes are near, a seventh each. Were the evaluations all, it would be 19 times the dense one",
    ),
    "geometric edit, 8 x 256 with a skip": Row(
        partial(of_network, "8 x 256 softplus, skip", "geometric_edit"),
        20.0,
        None,
        "passes of the network: two looks at 128 cells take two fifths, the sample and its judging a fourth",
    ),
    "rigid step, 8 x 64": Row(
        partial(of_network, "8 x 64 ELU", "rigid_edit, one linear step"),
        3.0,
        None,
        "passes of the network are half: soundness before and after, the placing of points; then the choice of the "
        "points, and the products of 2500 sensitivities with each other, a tenth each",
    ),
    "geometric edit, 8 x 512": Row(
        partial(of_network, "8 x 512 ReLU, weight norm, skip", "geometric_edit"),
        60.0,
        None,
        "three parts; at 8 x 128, where they can be told apart, passes of the network for two looks and two samples "
        "are two fifths and the products of the sensitivities a third. With both threads of the core it took 62 s",
    ),
}


def text_of(name: str, found: dict[str, object]) -> str:
    """Return a row of the table."""
    row = ROWS[name]
    ours, theirs = float(found["ours"]), found["theirs"]  # type: ignore[arg-type]
    ratio = None if theirs is None else float(theirs) / ours  # type: ignore[arg-type]
    wanted, met = [], True
    if row.at_most is not None:
        wanted.append(f"at most {row.at_most:g} s")
        met = met and ours <= row.at_most
    if row.at_least is not None and ratio is not None:
        wanted.append(f"at least {row.at_least:g} x")
        met = met and ratio >= row.at_least
    came = f"{ours:.3g} s" + ("" if ratio is None else f" beside {theirs:.3g} s: {ratio:.2g} x")
    return f"| {name} | {' and '.join(wanted)} | {came} | {'yes' if met else 'no'} | {found['words']} |"


PROSE = """# The pace of edits

Made by `python benchmarks/pace.py --write`: what each piece of work is to come to, and what it came to on this machine.
*Beside* is the other side in the same run: the mesh's Killing least squares by the solver named, the mesh's flow at
36,000 vertices, the published formula, dense evaluation with scikit-image. Of a machine that others share, as here,
seconds vary by a third from hour to hour; ratios are of one run.

"""


def page(kept: dict[str, object]) -> str:
    """Return the text of the page."""
    rows: dict[str, dict[str, object]] = kept["rows"]  # type: ignore[assignment]
    lines = [PROSE, f"{kept['machine']}\n\n", "| work | wanted | came to | met | at |\n|---|---|---|---|---|\n"]
    lines += [
        (text_of(name, rows[name]) if name in rows else f"| {name} | | not measured | | |") + "\n" for name in ROWS
    ]
    missed = [name for name in ROWS if name in rows and "| no |" in text_of(name, rows[name]) and ROWS[name].floor]
    if missed:
        lines.append("\nWhat stands between, where it is missed:\n\n")
        lines += [f"- *{name}*: {ROWS[name].floor}.\n" for name in missed]
    return "".join(lines)


def main() -> None:
    global clock, folder
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="of the rows to measure; all if none is given")
    parser.add_argument("--cpu", action="store_true", help="the processor's seconds, for a machine with other work")
    parser.add_argument("--networks", type=Path, help="folder in which trained networks are kept")
    parser.add_argument("--write", action="store_true", help="keep what was measured and make the page anew")
    given = parser.parse_args()
    folder = given.networks
    if given.cpu:
        clock = time.process_time
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"machine": "", "rows": {}}
    by = "seconds of the processor, on a machine with other work" if given.cpu else "seconds of the clock"
    kept["machine"] = f"Here {whole_edits.machine_of('cpu')}, torch {torch.__version__}; {by}."
    for name, row in ROWS.items():
        if given.words and not any(word in name for word in given.words):
            continue
        kept["rows"][name] = row.work()._asdict()
        print(text_of(name, kept["rows"][name]), flush=True)
    if given.write:
        RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
        PAGE.write_text(page(kept))


if __name__ == "__main__":
    main()
