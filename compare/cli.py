"""The command implicit-vs-mesh.

Everything that can be wrong with what the user gave is found before any work: it ends in one sentence on stderr and
exit code 2, with nothing written. A case that fails while it runs is a row of the table, and exit code 1.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from datetime import datetime
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import tyro

from compare.case import MESH_SUFFIXES, OPERATIONS, Case, default_cases
from compare.records import FILE, Record, read
from compare.subject import BUNDLED, InputError, check_shape, prepare_subject

if TYPE_CHECKING:
    from rich.progress import Progress as Bars

EXIT_FAILED, EXIT_INPUT, EXIT_INTERRUPTED = 1, 2, 130


@dataclass
class Run:
    """Edit shapes as neural fields and as meshes, compare, and write a run folder with a report."""

    shapes: tyro.conf.Positional[tuple[str, ...]] = BUNDLED
    """Bundled shapes, meshes (.obj, .off, .ply, .stl) or fields (.safetensors)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Run folder; by default results/run- and the time."""
    operations: tuple[Literal["geometric", "smooth", "rigid"], ...] = OPERATIONS
    """What to do with each shape."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    seed: int = 0
    """Of every random choice."""
    resume: bool = False
    """Go on with a run folder: only what is missing is done."""
    json: bool = False
    """Print the records as JSON, a line each, in place of the table."""
    quiet: bool = False
    """Print nothing but errors, and the records with --json."""


@dataclass
class Shapes:
    """List the bundled shapes."""

    json: bool = False
    """As JSON."""


@dataclass
class Fit:
    """Fit a neural field to a mesh, and write how good it is beside it, as .json."""

    mesh: tyro.conf.Positional[Path]
    """The mesh: .obj, .off, .ply or .stl."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where the field goes: a file ending in .safetensors that is not there yet."""
    width: int = 32
    """Units in each hidden layer."""
    depth: int = 3
    """Hidden layers."""
    activation: Literal["sine", "softplus", "relu"] = "sine"
    """Of the hidden layers."""
    steps: int = 4000
    """Of the training."""
    checkpoint: Path | None = None
    """A file to keep the state of the training in; if it is there already, the training goes on from it."""
    seed: int = 0
    """Of the samples and the first weights."""
    quiet: bool = False
    """Print nothing but errors."""


@dataclass
class Report:
    """Write report.html of a run folder again."""

    folder: tyro.conf.Positional[Path]
    """What `run` wrote."""


@dataclass
class Figures:
    """Paint the still pictures of a run folder, PNG and PDF, one a shape."""

    folder: tyro.conf.Positional[Path]
    """What `run` wrote."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where the pictures go; by default figures/ in the run folder."""
    formats: tuple[Literal["png", "pdf", "svg"], ...] = ("png", "pdf")
    """Which kinds."""
    azimuth: float | None = None
    """Degrees about the y axis, from where to look; by default where most of what moves is seen."""


@dataclass
class Paper:
    """Make the figures and numbers of the paper again, on bundled shapes and on the paper's own if you have them."""

    parts: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names of figures; all of them by default."""
    meshes: Path | None = None
    """A folder with bunny.off, cactus.off, rocker-arm.obj, as far as you have them."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("results/paper")
    """Where the pictures and the findings go."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    seed: int = 0
    """Of every random choice."""
    quiet: bool = False
    """Print nothing but errors."""


@dataclass
class TrainFamily:
    """Train a generative model on a family of parametric shapes, for semantic edits."""

    architecture: tyro.conf.Positional[Literal["deepsdf", "dualsdf", "imnet"]]
    """The decoder; imnet is trained with its encoder."""
    family: tyro.conf.Positional[Literal["chairs", "airplanes", "lamps"]]
    """What to learn."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where the model goes: a file ending in .safetensors that is not there yet. Its scores go beside it, as .json."""
    shapes: int = 400
    """Shapes to learn."""
    latent: int = 16
    """Numbers in a code."""
    width: int = 128
    """Units in the hidden layers."""
    steps: int = 2500
    """Of the training."""
    batch: int = 9600
    """Points a step."""
    validation: int = 40
    """Further shapes, whose reconstruction is scored."""
    seed: int = 0
    """Of every random choice."""
    device: str = "cpu"
    """Where to train: cpu, cuda."""
    checkpoint: Path | None = None
    """A file to keep the state of the training in; if it is there already, the training goes on from it."""
    half: bool = False
    """Write float16, half the size; the scores are those of what is written."""
    quiet: bool = False
    """Print nothing but errors."""


Command = Run | Shapes | Fit | Report | Figures | Paper | TrainFamily


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 done, 1 a case failed, 2 the input cannot be used, 130 interrupted."""
    # Threads that wait for each other by spinning starve when anything else runs: on two busy cores, a fit took fifteen
    # times as long. OpenMP reads this when torch is imported, which is later.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(version("implicit-vs-mesh"))
        sys.exit(0)
    command = tyro.cli(
        Command,  # type: ignore[arg-type]
        prog="implicit-vs-mesh",
        description="Neural fields and meshes, edited side by side.",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    act: dict[type, Callable[[Any], int]] = {
        Run: run,
        Shapes: shapes,
        Fit: fit,
        Report: report,
        Figures: figures,
        Paper: paper,
        TrainFamily: train_family,
    }
    try:
        code = act[type(command)](command)
    except InputError as error:
        print(f"implicit-vs-mesh: {error}", file=sys.stderr)
        code = EXIT_INPUT
    except KeyboardInterrupt:
        print("implicit-vs-mesh: interrupted; `run --resume -o FOLDER` goes on with what is done.", file=sys.stderr)
        code = EXIT_INTERRUPTED
    sys.exit(code)


def run(command: Run) -> int:
    """Check everything, then prepare each shape, run its cases, and write the report."""
    folder = command.output or Path("results") / f"run-{datetime.now():%Y%m%d-%H%M%S}"
    _require_run_folder(folder, command.resume)
    say = _silent if command.quiet else _printer(command.json)
    _require_distinct(command.shapes)
    mended = [sentence for name in command.shapes for sentence in check_shape(name)]
    for sentence in mended:
        say(sentence)

    from compare.report import report as write_report
    from compare.run import run_cases

    folder.mkdir(parents=True, exist_ok=True)
    records: list[Record] = []
    fit_options = {"steps": 600} if command.quick else {}
    settings: dict[str, Any] = {"seed": command.seed}
    if command.quick:
        settings |= {"vertices": 1200, "resolution": 48}
    with _bars(command.quiet) as bars:
        total = _task(bars, "all", len(command.shapes) * len(command.operations))
        for name in command.shapes:
            current = _task(bars, Path(name).stem, None)
            tell = _teller(bars, current)
            try:
                # Any case of the shape: what decides the subject is the same for all, and this one needs no handles.
                any_case = Case(name, "smooth", parameters={"fit": fit_options} if fit_options else {}, **settings)
                subject = prepare_subject(any_case, folder=folder, progress=tell)
            except (ValueError, OSError) as error:
                raise InputError(f"{name}: {error}") from error
            cases = default_cases(
                name,
                subject.V,
                subject.N,
                operations=command.operations,
                quick=command.quick,
                fit=fit_options,
                **settings,
            )
            records += run_cases(cases, folder=folder, progress=tell, on_record=lambda _: _advance(bars, total))
            _finish(bars, current)
    page = write_report(records, folder / "report.html")
    if command.json:
        import json

        for record in records:
            print(json.dumps(record.to_dict(), allow_nan=False))
    elif not command.quiet:
        _print_table(records, said=mended)
        say(f"{folder}: {FILE}, edited fields, meshes, and {page.name} to open in a browser.")
    return EXIT_FAILED if any(record.failed for record in records) else 0


def shapes(command: Shapes) -> int:
    """Print what the fits say of themselves."""
    import json
    from importlib import resources

    files = resources.files("implicit") / "data"
    rows = {name: json.loads((files / f"{name}.json").read_text()) for name in BUNDLED}
    if command.json:
        print(json.dumps(rows))
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table("shape", "parameters", "size", "mean distance", "volume error", "genus", title="Bundled shapes")
    for name, row in rows.items():
        table.add_row(
            name,
            str(row["parameters"]),
            f"{row['diagonal']:.4g}",
            f"{100 * row['mean_distance']:.2g} %",
            f"{100 * row['volume_error']:+.2g} %",
            str(row["genus"]),
        )
    console = Console()
    console.print(table)
    console.print("Networks of 3 x 32 sines fitted to each shape; size and mean distance are of its diagonal.")
    return 0


def fit(command: Fit) -> int:
    """Check the mesh and the output, fit, and save."""
    _require_new_safetensors("A field", command.output)
    if command.mesh.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"A mesh is a file ending in {', '.join(MESH_SUFFIXES)}, but got {command.mesh}.")
    if min(command.width, command.depth, command.steps) < 1:
        raise InputError(
            f"--width, --depth and --steps must be at least 1, but are {command.width}, {command.depth} and "
            f"{command.steps}."
        )
    if command.checkpoint is not None:
        _require_folder_for(command.checkpoint)
        command.checkpoint.parent.mkdir(parents=True, exist_ok=True)
    say = _silent if command.quiet else _printer(False)
    for sentence in check_shape(str(command.mesh)):
        say(sentence)

    import implicit
    import meshref
    from compare.fit import fit_mesh
    from compare.records import replace_file

    V, F = meshref.read_mesh(command.mesh)
    with _bars(command.quiet) as bars:
        tell = _teller(bars, _task(bars, command.mesh.name, None))
        try:
            field, quality = fit_mesh(
                V,
                F,
                width=command.width,
                depth=command.depth,
                activation=command.activation,
                steps=command.steps,
                seed=command.seed,
                bodies="refuse",
                checkpoint=command.checkpoint,
                progress=lambda step, steps, _: tell(step, steps, "fitting a field"),
            )
        except ValueError as error:  # a checkpoint of another fit, say
            raise InputError(str(error)) from error
    implicit.save_field(field, command.output)
    replace_file(command.output.with_suffix(".json"), dumps(quality.to_dict(), indent=2).encode())
    say(f"{command.output}: {quality.parameters} parameters, {quality.seconds:.0f} s. {quality.verdict}")
    return 0


def report(command: Report) -> int:
    """Write the page from the rows and meshes that are there."""
    from compare.report import report as write_report

    try:
        page = write_report(_records_of(command.folder), command.folder / "report.html")
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    print(page)
    return 0


def figures(command: Figures) -> int:
    """Paint the pictures from the rows and meshes that are there."""
    from compare.figures import Camera, draw_figures

    camera = None if command.azimuth is None else Camera(command.azimuth)
    try:
        written = draw_figures(
            _records_of(command.folder), command.folder, output=command.output, formats=command.formats, camera=camera
        )
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    for path in written:
        print(path)
    return 0


def paper(command: Paper) -> int:
    """Draw the parts that are asked for, and say where they are and what was found."""
    from compare.paper import PARTS, Request, draw_parts, pictures

    if unknown := [name for name in command.parts if name not in PARTS]:
        raise InputError(f"There is no figure {unknown[0]!r}; there are {', '.join(PARTS)}.")
    if command.meshes is not None and not command.meshes.is_dir():
        raise InputError(f"There is no folder {command.meshes}. Name the one that holds the meshes, or leave it out.")
    if command.output.exists() and not command.output.is_dir():
        raise InputError(f"The output {command.output} is a file, but figures are written to a folder. Name another.")
    _require_folder_for(command.output)
    command.output.mkdir(parents=True, exist_ok=True)
    with _bars(command.quiet) as bars:
        tell = _teller(bars, _task(bars, "paper", None))
        request = Request(command.output, command.meshes, command.quick, command.seed, tell)
        draw_parts(request, command.parts or PARTS)
    if not command.quiet:
        print((command.output / "findings.md").read_text())
        for path in pictures(command.output):
            print(path)
    return 0


def train_family(command: TrainFamily) -> int:
    """Check the output, train, save, and score what was saved."""
    _require_new_safetensors("A model", command.output)
    numbers = ("shapes", "latent", "width", "steps", "batch", "validation")
    if small := [f"--{name}" for name in numbers if getattr(command, name) < 1]:
        raise InputError(f"{' and '.join(small)} must be at least 1.")
    if command.checkpoint is not None:
        _require_folder_for(command.checkpoint)
        command.checkpoint.parent.mkdir(parents=True, exist_ok=True)

    import torch

    from compare.train_family import train_and_save

    if command.device.startswith("cuda") and not torch.cuda.is_available():
        raise InputError(
            f"--device {command.device}: torch finds no CUDA device here. Leave it out to train on the CPU."
        )
    with _bars(command.quiet) as bars:
        tell = _teller(bars, _task(bars, f"{command.architecture}, {command.family}", None))
        try:
            report = train_and_save(
                command.family,
                command.architecture,
                command.output,
                dtype=torch.float16 if command.half else torch.float32,
                progress=lambda step, steps, loss: tell(step, steps, f"loss {loss:.2g}"),
                checkpoint=command.checkpoint,
                device=command.device,
                seed=command.seed,
                **{name: getattr(command, name) for name in numbers},
            )
        except (ValueError, RuntimeError, FloatingPointError) as error:
            raise InputError(str(error)) from error
    if not command.quiet:
        scores = report["validation"]
        print(
            f"{command.output}: IoU {scores['mean_iou']:.3f}, least {scores['least_iou']:.3f}, of {scores['shapes']} "
            f"shapes not learned; {report['seconds']} s."
        )
    return 0


# What is refused before any work


def _require_new_safetensors(what: str, path: Path) -> None:
    if path.suffix != ".safetensors":
        raise InputError(f"{what} is written to a file ending in .safetensors, but the output is {path}.")
    if path.exists():
        raise InputError(f"{path} is there already and is not written over. Name another file or remove it.")
    _require_folder_for(path)


def _require_run_folder(folder: Path, resume: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file, but a run is written to a folder. Name another.")
    if (folder / FILE).exists():
        if not resume:
            raise InputError(
                f"The folder {folder} already holds a run. Name another, or add --resume to go on with it."
            )
        try:
            read(folder)
        except ValueError as error:
            raise InputError(str(error)) from error
    elif folder.is_dir() and any(folder.iterdir()) and not resume:
        raise InputError(f"The folder {folder} is not empty and holds no run. Name another or an empty one.")
    elif not folder.is_dir():
        _require_folder_for(folder)


def _require_folder_for(path: Path) -> None:
    """The nearest folder above that exists must be one, and writable."""
    above = path.absolute().parent
    while not above.exists():
        above = above.parent
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise InputError(f"{path} cannot be written: {above} is not a folder that you may write to. Name another.")


def _require_distinct(names: tuple[str, ...]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{twice[0]} is named twice. Name each shape once.")


def _records_of(folder: Path) -> list[Record]:
    return list({record.key: record for record in read(folder)}.values())  # the last row of a key counts


# What is shown


def _printer(to_stderr: bool) -> Callable[[str], None]:
    def say(sentence: str) -> None:
        print(sentence, file=sys.stderr if to_stderr else sys.stdout, flush=True)

    return say


def _silent(_: str) -> None:
    pass


def _print_table(records: list[Record], said: list[str]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    from compare.table import COLUMNS, lines, text

    columns = [(k, column) for k, column in enumerate(COLUMNS) if column.brief]
    table = Table("shape", "edit", "by", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for _, column in columns:
        table.add_column(column.title, justify="right", no_wrap=True)
    for record in records:
        for shape, operation, side, _, values in lines(record):
            table.add_row(shape, operation, side, *(text(values[k], column) for k, column in columns))
        table.add_section()
    console = Console()
    console.print(table)
    for sentence in dict.fromkeys(note for record in records for note in record.notes if note not in said):
        console.print(sentence, markup=False)
    for record in records:
        if record.failed:
            console.print(f"{record.case.name}, {record.case.operation}: {record.status}", markup=False)


def _bars(quiet: bool) -> AbstractContextManager[Bars | None]:
    if quiet:
        return nullcontext()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    # On stderr, so that --json leaves stdout to the records.
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[what]}", markup=False),
        console=Console(stderr=True),
    )


def _task(bars: Bars | None, name: str, total: int | None) -> Any:
    return None if bars is None else bars.add_task(name, total=total, what="")


def _teller(bars: Bars | None, task: Any) -> Callable[[int, int, str], None]:
    def tell(step: int, steps: int, what: str) -> None:
        if bars is not None:
            bars.update(task, completed=step, total=steps, what=what)

    return tell


def _advance(bars: Bars | None, task: Any) -> None:
    if bars is not None:
        bars.advance(task)


def _finish(bars: Bars | None, task: Any) -> None:
    if bars is not None:
        bars.update(task, completed=1, total=1, what="done")
