"""Whole edits, from call to result, of networks of the sizes that people have, on each device at hand.

    python benchmarks/whole_edits.py                        all rows, printed
    python benchmarks/whole_edits.py "8 x 256" geometric    rows and columns whose names hold a word
    python benchmarks/whole_edits.py --write                and kept in docs/whole-edits.json; the page is made anew

Each cell is a process of its own, which says its wall clock's seconds, how far the edit is from what was asked, and the
most memory that it held. The networks are trained here first, to the distances of a capsule.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch is imported; see side_by_side.py

import torch
from torch import nn

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from implicit import (
    Along,
    Ball,
    Field,
    HalfSpace,
    Handle,
    Siren,
    Volume,
    basis,
    fit_field,
    geometric_edit,
    rigid_edit,
    sample_surface,
    semantic_edit,
    smooth,
    surface_quadrature,
)
from implicit.models import HashGrid
from implicit.shapes import capsule
from tests.implicit.foreign import DeepSdf, ImplicitGeometricRegularisation, chain

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "whole-edits.json"
PAGE = ROOT / "docs" / "whole-edits.md"


def as_he(network: DeepSdf) -> DeepSdf:
    """Start a network as He et al. 2015 do: as torch starts them, eight layers of ReLU pass nothing on."""
    with torch.no_grad():
        for layer in network.layers:
            layer.weight = torch.randn_like(layer.weight) * (2 / layer.in_features) ** 0.5
            layer.bias.zero_()
        network.layers[-1].weight = network.layers[-1].weight * 0.1
    return network


NETWORKS: dict[str, Callable[[], nn.Module]] = {
    "3 x 32 sines": lambda: Siren(width=32, depth=3),
    "8 x 64 ELU": lambda: chain(64, 8, nn.ELU),
    "8 x 256 softplus, skip": ImplicitGeometricRegularisation,
    "8 x 512 ReLU, weight norm, skip": lambda: as_he(DeepSdf(parametrized=True)),
    "hash grid": HashGrid,
}
BODY = capsule((-0.25, 0.0, 0.0), (0.25, 0.0, 0.0), 0.4)
FIT_STEPS = {"8 x 512 ReLU, weight norm, skip": 1500}  # of the others 400


def fitted(network: str, device: str) -> nn.Module:
    """Return a network trained to the distances of the body."""
    torch.manual_seed(1)
    module = NETWORKS[network]()
    near = sample_surface(BODY, 20_000, resolution=16).points
    near = near + 0.05 * torch.randn(near.shape, dtype=torch.float64)
    away = torch.rand(5_000, 3, dtype=torch.float64) * 2.2 - 1.1
    points = torch.cat([near, away])
    samples = [x.float().to(device) for x in (points, BODY.value(points), BODY.normal(points))]
    field, _ = fit_field(*samples, module=module.to(device), steps=FIT_STEPS.get(network, 400), batch=1024)
    field.write_back()
    return module


# The edits: each returns how far it is from what was asked, and what it says


def geometric(field: Field) -> dict[str, Any]:
    """A bump of 4 % on half of the body: error at points that carried none over the largest target."""
    edit = geometric_edit(field, Handle(Ball((0.0, 0.4, 0.0), 0.9), Along(0.04)), points=2000)
    error = edit.error_field(sample_surface(field, 1000, seed=11))
    return {"off": float(error.square().mean().sqrt()), "status": edit.status.name}


def ends(distance: float) -> list[Handle]:
    """One end held, the other moved aside."""
    return [
        Handle(HalfSpace((-0.4, 0.0, 0.0), (-1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
        Handle(HalfSpace((0.4, 0.0, 0.0), (1.0, 0.0, 0.0)), (0.0, distance, 0.0)),
    ]


def rigid(field: Field, distance: float, **options: Any) -> dict[str, Any]:
    edit = rigid_edit(field, ends(distance), **options)
    error = edit.error_field()
    return {"off": float(error[error.isfinite()].square().mean().sqrt()), "status": edit.status.name}


def smoothed(field: Field) -> dict[str, Any]:
    """Five steps of smoothing with the volume held: drift of the volume on another quadrature."""
    before = Volume().value(field, surface_quadrature(field, 48))
    edit = smooth(field, steps=5, step_size=1e-3, constraints=[Volume()], points=1000)
    after = Volume().value(edit.field, surface_quadrature(edit.field, 48))
    return {"off": abs(after / before - 1), "status": edit.status.name}


def semantic(field: Field) -> dict[str, Any]:
    """60 points towards a motion of 3 % that the parameters have."""
    sample = sample_surface(field, 60)
    way = torch.randn(len(field.theta), generator=torch.Generator().manual_seed(7)).to(field.theta)
    speed = basis(field, sample.points) @ way
    speed = speed * (0.03 / float(speed.abs().max()))
    edit = semantic_edit(field, sample.points, speed[:, None] * sample.normals, damping=None)
    missed = (edit.displacement * sample.normals).sum(dim=1) - speed
    return {"off": float(missed.norm() / speed.norm()), "status": edit.status.name}


EDITS: dict[str, Callable[[Field], dict[str, Any]]] = {
    "geometric_edit": geometric,
    "smooth, volume held": smoothed,
    "rigid_edit, one linear step": lambda field: rigid(field, 0.02, method="linear", steps=1, points=2000),
    "rigid_edit, far": lambda field: rigid(field, 0.25, method="finite"),
    "semantic_edit": semantic,
}


# Measured, a process a cell


def measure(state: Path, network: str, edit: str, device: str) -> dict[str, Any]:
    """Return what an edit of a trained network took on a device."""
    module = NETWORKS[network]()
    module.load_state_dict(torch.load(state, weights_only=True))
    field = Field(module.to(device))
    points = sample_surface(field, 100).points
    torch.linalg.cholesky(points.T @ points + torch.eye(3, device=device))  # the libraries of the device are loaded
    held_before = most_held(anew=True)
    start = time.perf_counter()
    found = EDITS[edit](field)
    if device == "cuda":
        torch.cuda.synchronize()
        memory = torch.cuda.max_memory_allocated() / 1e9
    else:
        memory = (most_held() - held_before) / 1e6
    return {"seconds": time.perf_counter() - start, "memory": memory, **found}


def most_held(*, anew: bool = False) -> int:
    """Return the most memory that this process held, in kB, since it started or was last counted anew."""
    if anew:
        with suppress(OSError), open("/proc/self/clear_refs", "w") as counter:
            counter.write("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))


def in_a_process(*cell: str, limit: float) -> dict[str, Any]:
    """Return what a process of its own measured, or why it did not."""
    try:
        run = subprocess.run(
            [sys.executable, __file__, "--cell", *cell], capture_output=True, text=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return {"refused": f"more than {limit:.0f} s"}
    return json.loads(run.stdout) if run.returncode == 0 else {"refused": run.stderr.strip().splitlines()[-1]}


def text_of(found: dict[str, Any]) -> str:
    if "refused" in found:
        return found["refused"]
    said = "" if found["status"] in ("DONE", "REACHED") else f", {found['status']}"
    memory = "" if found["memory"] is None else f" {found['memory']:.2f} GB,"
    return f"{found['seconds']:.2f} s,{memory} {found['off']:.1e} off{said}"


def page(rows: list[dict[str, Any]], machines: dict[str, str]) -> str:
    """Return the text of the page of these cells."""
    lines = [PROSE]
    lines += [f"- *{name}*: {machine}\n" for name, machine in machines.items()]
    lines.append("\n| network | edit | " + " | ".join(machines) + " |\n|---|---|" + "---|" * len(machines) + "\n")
    cells = {(row["network"], row["edit"], row["on"]): row for row in rows}
    for network in NETWORKS:
        for edit in EDITS:
            found = [cells.get((network, edit, machine)) for machine in machines]
            if any(found):
                lines.append(f"| {network} | {edit} | {' | '.join(text_of(f) if f else '' for f in found)} |\n")
    return "".join(lines)


PROSE = """# How long whole edits take

From the call to its result, with all that belongs to it: samples of the surface, measures of how sound the field is
before and after, parts and corrections. Made by `python benchmarks/whole_edits.py --write`; each cell is one run in a
process of its own. Networks in float32, trained for some hundred steps to the distances of a capsule; errors are
relative to the largest target (of volume: relative drift on another quadrature). Memory is what the edit added to the
process at most, on a graphics card the most that torch had allocated.

"""


def machine_of(device: str) -> str:
    """Return the name of what computes."""
    if device == "cuda":
        return f"{torch.cuda.get_device_name()}, torch {torch.__version__}"
    names = [line.split(":")[1].strip() for line in _cpuinfo() if line.startswith("model name")]
    threads = torch.get_num_threads()
    return f"{threads} thread{'s' * (threads > 1)} of {names[0] if names else platform.processor()}"


def _cpuinfo() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="of the networks and edits to measure; all if none is given")
    parser.add_argument("--devices", nargs="+", default=["cpu"] + ["cuda"] * torch.cuda.is_available())
    parser.add_argument("--limit", type=float, default=300.0, help="seconds that a cell may take (default: 300)")
    parser.add_argument("--write", action="store_true", help="keep what was measured and make the page anew")
    parser.add_argument("--cell", nargs=4, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.cell:
        state, network, edit, device = given.cell
        print(json.dumps(measure(Path(state), network, edit, device)))
        return
    networks = [name for name in NETWORKS if not given.words or any(w in name for w in given.words)]
    edits = [name for name in EDITS if any(w in name for w in given.words)] or list(EDITS)
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"machines": {}, "rows": []}
    columns = {device: device if device == "cuda" else f"{torch.get_num_threads()} threads" for device in given.devices}
    kept["machines"].update({columns[device]: machine_of(device) for device in given.devices})
    with tempfile.TemporaryDirectory() as folder:
        for network in networks or NETWORKS:
            state = Path(folder) / "state.pt"
            torch.save(fitted(network, given.devices[-1]).cpu().state_dict(), state)
            for edit in edits:
                for device in given.devices:
                    found = in_a_process(str(state), network, edit, device, limit=given.limit)
                    print(f"| {network} | {edit} | {device} | {text_of(found)} |", flush=True)
                    cell = {"network": network, "edit": edit, "on": columns[device]}
                    kept["rows"] = [row for row in kept["rows"] if not cell.items() <= row.items()]
                    kept["rows"].append(cell | found)
            if given.write:  # what is stopped keeps what it has
                RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
                PAGE.write_text(page(kept["rows"], kept["machines"]))


if __name__ == "__main__":
    main()
