"""Bad input for the public functions of compare, and for its commands."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from corpus import Bad, BadCase, choices, counts, numpy_points, positives, refusals

import compare
import meshref
from compare import Case, HandleSpec, Record
from compare.commands import cli

BALL = {"kind": "ball", "center": [0.0, 0.3, 0.2], "radius": 0.05, "falloff": 0.2}
UP = {"kind": "vector", "vector": [0.0, 0.0, 0.1]}
HANDLE = HandleSpec(BALL, UP)
CASE = Case("spot", "geometric", (HANDLE,))
V, F = meshref.icosphere(1)


def cases() -> Iterator[BadCase]:
    yield from _of_cases()
    yield from _of_shapes()
    yield from _of_records()
    yield from _of_fits()
    yield from _of_commands()


def _of_cases() -> Iterator[BadCase]:
    regions: list[Bad] = [
        ("None", None),
        ("a word", "ball"),
        ("a list", [1, 2]),
        ("of no kind", {"center": [0, 0, 0], "radius": 1}),
        ("of an unknown kind", {"kind": "cone"}),
        ("with an unknown number", {**BALL, "height": 3}),
        ("with NaN", {**BALL, "center": [0, 0, np.nan]}),
        ("with words", {**BALL, "radius": "wide"}),
        ("without its radius", {"kind": "ball", "center": [0, 0, 0]}),
        ("with no radius", {**BALL, "radius": 0.0}),
        ("with a negative falloff", {**BALL, "falloff": -1.0}),
        ("in the plane", {**BALL, "center": [0.0, 0.0]}),
        ("with None", {**BALL, "center": None}),
        ("upside down", {"kind": "box", "lower": [1, 1, 1], "upper": [0, 0, 0]}),
        ("without direction", {"kind": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 0]}),
    ]
    yield from refusals("HandleSpec", "region", regions, lambda x: HandleSpec(x, UP))
    motions: list[Bad] = [
        ("None", None),
        ("a word", "up"),
        ("of an unknown kind", {"kind": "spin"}),
        ("without its vector", {"kind": "vector"}),
        ("with NaN", {"kind": "along", "distance": np.nan}),
        ("of two numbers", {"kind": "vector", "vector": [0.0, 1.0]}),
        ("with words", {"kind": "along", "distance": "far"}),
        ("with a short rotation", {"kind": "rigid", "rotation": [0.0, 1.0]}),
    ]
    yield from refusals("HandleSpec", "motion", motions, lambda x: HandleSpec(BALL, x))
    yield from refusals("Case", "operation", choices(), lambda x: Case("spot", x, (HANDLE,)))
    yield from refusals("Case", "shape", [("None", None), ("a number", 3), ("empty", "")], lambda x: Case(x, "smooth"))
    handles: list[Bad] = [("none", ()), ("words", ("top",)), ("one alone", HANDLE), ("None", None)]
    yield from refusals("Case", "handles", handles, lambda x: Case("spot", "rigid", x))
    yield BadCase("Case: handles for smoothing", lambda: Case("spot", "smooth", (HANDLE,)), ("takes no handles",))
    yield from refusals("Case", "vertices", counts(100), lambda x: Case("spot", "rigid", (HANDLE,), vertices=x))
    yield from refusals("Case", "resolution", counts(8), lambda x: Case("spot", "rigid", (HANDLE,), resolution=x))
    yield from refusals("Case", "seed", counts(0), lambda x: Case("spot", "rigid", (HANDLE,), seed=x))
    parameters: list[Bad] = [
        ("None", None),
        ("a list", [1]),
        ("without JSON", {"steps": object()}),
        ("NaN", {"steps": np.nan}),
    ]
    yield from refusals("Case", "parameters", parameters, lambda x: Case("spot", "rigid", (HANDLE,), x))
    row = CASE.to_dict()
    rows: list[Bad] = [
        ("without shape", {k: v for k, v in row.items() if k != "shape"}),
        ("with more", {**row, "colour": "red"}),
        ("of no handles", {**row, "handles": None}),
        ("None", None),
    ]
    yield from refusals("Case.from_dict", "row", rows, Case.from_dict, "case")
    texts: list[Bad] = [("prose", "Dear all"), ("a list", "[]"), ("cut short", CASE.to_json()[:-9]), ("None", None)]
    yield from refusals("Case.from_json", "text", texts, Case.from_json, "case")


def _of_shapes() -> Iterator[BadCase]:
    names: list[Bad] = [
        ("unknown", "spto"),
        ("missing", "gone.obj"),
        ("a missing field", "gone.safetensors"),
        ("of another kind", "shape.x3d"),
    ]
    for function, call in {"prepare_subject": compare.prepare_subject, "run_case": compare.run_case}.items():
        yield from refusals(function, "shape", names, lambda x, call=call: call(Case(x, "smooth")), "shape")
        yield from refusals(function, "case", [("None", None), ("a word", "spot")], call)

    def written(name: str, content: bytes) -> object:
        Path(name).write_bytes(content)
        return compare.prepare_subject(Case(name, "smooth"))

    contents = {
        "a.obj": b"Dear all",
        "a.off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n",
        "a.ply": b"",
        "a.stl": b"solid",
        "a.safetensors": b"Dear all, please find the field attached",
    }
    for name, content in contents.items():
        yield BadCase(f"prepare_subject: file {name}", lambda n=name, c=content: written(n, c), (name,))

    def two_bodies() -> object:
        meshref.write_mesh("two.off", np.vstack([V, V + 5]), np.vstack([F, F + len(V)]))
        return compare.prepare_subject(Case("two.off", "smooth"))

    yield BadCase("prepare_subject: file of two bodies", two_bodies, ("two.off", "one body"))
    yield from refusals(
        "default_cases", "V", [*numpy_points(), ("none", V[:0])], lambda v: compare.default_cases("spot", v, V)
    )
    yield from refusals("default_cases", "N", numpy_points(42), lambda n: compare.default_cases("spot", V, n))
    yield from refusals(
        "default_cases", "operations", [("unknown", ["grow"]), ("a word", "smooth"), ("None", None)],
        lambda o: compare.default_cases("spot", V, V, operations=o),
    )  # fmt: skip


def _of_records() -> Iterator[BadCase]:
    record = Record(CASE, "0" * 16, "Failed.", failed=True)
    yield from refusals(
        "report", "records", [("none", []), ("None", None), ("words", ["a"])], lambda r: compare.report(r, "a.html")
    )
    nowhere: list[Bad] = [("in no folder", "gone/a.html"), ("under a device", "/dev/null/a.html"), ("a folder", ".")]
    yield from refusals("report", "path", nowhere, lambda p: compare.report([record], p), "written")
    row = record.to_dict()
    rows: list[Bad] = [
        ("None", None),
        ("empty", {}),
        ("of another schema", {**row, "schema": 99}),
        ("without its case", {k: v for k, v in row.items() if k != "case"}),
        ("with a bad case", {**row, "case": {"shape": "spot"}}),
        ("without artefacts", {**row, "artefacts": None}),
    ]
    yield from refusals("Record.from_dict", "row", rows, Record.from_dict)
    yield from refusals(
        "run_cases", "cases", [("None", None), ("words", ["spot"]), ("one alone", CASE)], compare.run_cases
    )
    yield from refusals("run_cases", "executor", [("a number", 3)], lambda e: compare.run_cases([CASE], e))


def _of_fits() -> Iterator[BadCase]:
    def fit(**options: Any) -> object:
        return compare.fit_mesh(V, F, **options)

    yield from refusals("fit_mesh", "V", numpy_points(len(V)), lambda v: compare.fit_mesh(v, F))
    yield from refusals(
        "fit_mesh", "F", [("beyond", F + 1), ("none", F[:0]), ("None", None)], lambda f: compare.fit_mesh(V, f)
    )
    for name in ("width", "depth", "steps", "seed"):
        yield from refusals("fit_mesh", name, counts(0 if name == "seed" else 1), lambda x, name=name: fit(**{name: x}))
    yield from refusals("fit_mesh", "seconds", positives(), lambda x: fit(seconds=x))
    yield from refusals("fit_mesh", "activation", choices(), lambda x: fit(activation=x))
    yield from refusals("fit_mesh", "bodies", choices(), lambda x: fit(bodies=x))


def _command(*arguments: str) -> None:
    """Run the command line here; a refusal of it becomes an error."""
    said = StringIO()
    try:
        with redirect_stderr(said):
            cli.main(list(arguments))
    except SystemExit as end:
        if end.code != 2:
            raise AssertionError(f"exit code {end.code}: {said.getvalue()}") from None
        words = said.getvalue().strip()
        if not words.startswith("implicit-vs-mesh: ") or "\n" in words:
            raise AssertionError(f"it said: {words}") from None
        raise ValueError(words) from None


def _prepared() -> None:
    """What commands find in their folder."""
    if Path("ball.off").exists():
        return
    meshref.write_mesh("ball.off", V, F)
    meshref.write_mesh("open.off", V, F[:-30])
    Path("empty.obj").write_bytes(b"")
    Path("old.safetensors").write_bytes(b"precious")
    Path("words.txt").write_text("Dear all")
    Path("full").mkdir()
    (Path("full") / "letter.txt").write_text("precious")
    Path("run").mkdir()
    (Path("run") / "results.jsonl").write_text('{"precious": 1}\n')
    Path("torn").mkdir()
    (Path("torn") / "results.jsonl").write_text("Dear all\nDear all\n")
    row = Record(Case("spot", "smooth"), "0" * 16, "done").to_dict()
    Path("newer").mkdir()
    (Path("newer") / "results.jsonl").write_text(json.dumps({**row, "schema": 99}) + "\n")


COMMANDS: dict[str, tuple[str, ...]] = {
    "run gone.obj -o out": ("gone.obj",),
    "run spto -o out": ("spot",),
    "run empty.obj -o out": ("empty.obj",),
    "run words.txt -o out": ("words.txt",),
    "run old.safetensors -o out": ("old.safetensors",),
    "run spot spot -o out": ("twice",),
    "run spot gone.obj -o out": ("gone.obj",),
    "run spot -o full": ("full", "not empty"),
    "run spot -o run": ("run", "already holds"),
    "run spot -o torn --resume": ("Line 1",),
    "run spot -o newer --resume": ("schema 99",),
    "run spot -o words.txt": ("is a file",),
    "run spot -o words.txt/run": ("not a folder",),
    "run spot -o /dev/null/run": ("not a folder",),
    "run spot -o out --seed -1": ("seed",),
    "run spot -o out --workers -1": ("workers",),
    "fit gone.off -o new.safetensors": ("gone.off",),
    "fit words.txt -o new.safetensors": ("words.txt",),
    "fit empty.obj -o new.safetensors": ("empty.obj",),
    "fit open.off -o words.txt": (".safetensors",),
    "fit ball.off -o old.safetensors": ("old.safetensors",),
    "fit ball.off -o words.txt/new.safetensors": ("folder",),
    "fit ball.off -o new.safetensors --width 0": ("--width",),
    "fit ball.off -o new.safetensors --depth -1": ("--depth",),
    "fit ball.off -o new.safetensors --steps 0": ("--steps",),
    "fit ball.off -o new.safetensors --seed -1": ("seed",),
    "fit ball.off -o new.safetensors --checkpoint words.txt/a": ("words.txt",),
    "report gone": ("gone",),
    "report words.txt": ("record",),
    "report full": ("full",),
    "report torn": ("Line 1",),
    "report newer": ("schema 99",),
    "figures gone": ("gone",),
    "figures torn": ("Line 1",),
    "figures newer": ("schema 99",),
    "paper basi": ("basi",),
    "paper basis --meshes gone": ("gone",),
    "paper basis -o words.txt": ("words.txt",),
    "study gone": ("gone",),
    "study words.txt": ("words.txt",),
    "train-family deepsdf chairs -o words.txt": (".safetensors",),
    "train-family deepsdf chairs -o old.safetensors": ("old.safetensors",),
    "train-family deepsdf chairs -o new.safetensors --shapes 0": ("--shapes",),
    "train-family deepsdf chairs -o new.safetensors --steps -5": ("--steps",),
    "train-family deepsdf chairs -o new.safetensors --batch 0": ("--batch",),
    "train-family deepsdf chairs -o new.safetensors --device cuda": ("cuda",),
    "train-family deepsdf chairs -o new.safetensors --device abacus": ("abacus",),
}
Call = Callable[..., object]


def _of_commands() -> Iterator[BadCase]:
    for line, says in COMMANDS.items():

        def call(line: str = line) -> None:
            _prepared()
            _command(*line.split())

        yield BadCase(f"command: {line}", call, says)
