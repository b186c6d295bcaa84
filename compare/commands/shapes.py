"""implicit-vs-mesh shapes: what the bundled shapes are, and how well their fields fit."""

from __future__ import annotations

from dataclasses import dataclass

from compare.cases.case import BUNDLED


@dataclass
class Shapes:
    """List the bundled shapes."""

    json: bool = False
    """As JSON."""


def shapes(command: Shapes) -> int:
    """Print what the fits say of themselves."""
    import json
    from importlib.util import find_spec
    from pathlib import Path

    package = find_spec("implicit")  # found without being imported, which takes as long as all else here ten times over
    assert package is not None
    assert package.origin is not None
    data = Path(package.origin).parent / "data"
    rows = {name: json.loads((data / f"{name}.json").read_text()) for name in BUNDLED}
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
