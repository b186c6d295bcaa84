"""The README's table of results, from the findings of `implicit-vs-mesh paper`: python -m compare.results [FOLDER].

With a folder, its findings are first taken over into docs/results.json; the table is made from that file alone, so
whoever has the sources can make it again. Run it where README.md is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from compare.paper import PARTS
from compare.paper.findings import FILE, Measured, read_measured, table, write_measured

BEGIN, END = "<!-- results: python -m compare.results -->", "<!-- end of results -->"


def take_over(folder: Path, results: Path) -> None:
    """Keep the findings of a folder as those that the README shows.

    Raises:
        ValueError: They are of a quick run, or parts are missing, or were made with different settings.
    """
    measured = read_measured(folder / FILE)
    missing = set(PARTS) - {part.part for part in measured}
    if missing:
        raise ValueError(
            f"{folder} has no findings of {', '.join(sorted(missing))}. Add them: paper --resume -o {folder}."
        )
    if quick := [part.part for part in measured if part.quick]:
        raise ValueError(
            f"The findings of {', '.join(quick)} in {folder} are quick ones, which the README does not show."
        )
    if len({str(part.settings) for part in measured}) > 1:
        raise ValueError(f"The parts in {folder} were made with different settings. Make them again: paper --resume.")
    write_measured(measured, results)


def section(measured: Sequence[Measured]) -> str:
    """When and where the findings were measured, and the table of those marked for the README."""
    where = measured[0].provenance
    days = sorted({str(part.provenance["time"])[:10] for part in measured})
    threads = {part.provenance["threads"] for part in measured}
    minutes, of_processor = (
        sum(values) / 60 for values in ([p.seconds for p in measured], [p.processor_seconds for p in measured])
    )
    meshes = ", ".join(sorted(measured[0].settings["meshes"])) or "no meshes"
    return (
        f"`implicit-vs-mesh paper --meshes DIR` with {meshes}; {' to '.join(dict.fromkeys((days[0], days[-1])))}, "
        f"{where['processor']}, {where['cores']} cores, {'/'.join(str(n) for n in sorted(threads))} thread, in "
        f"{minutes:.0f} min, {of_processor:.0f} min of processor time.\n\n{table(measured, headlines=True)}"
    )


def with_section(text: str, made: str) -> str:
    """The text with what is between the two marks replaced.

    Raises:
        ValueError: It has not each mark once, in this order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"README.md must hold {BEGIN} and, after it, {END}, each once. Put them where the table goes.")
    before, after = text[: text.index(BEGIN)], text[text.index(END) :]
    return f"{before}{BEGIN}\n\n{made}\n{after}"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m compare.results", description=str(__doc__).partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, help="what `paper` wrote; without it docs/results.json stays")
    parser.add_argument("--readme", type=Path, default=Path("README.md"), help="default: %(default)s")
    parser.add_argument("--results", type=Path, default=Path("docs/results.json"), help="default: %(default)s")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.folder is not None:
            take_over(chosen.folder, chosen.results)
        measured = read_measured(chosen.results)
        if not measured:
            raise ValueError(f"There is no {chosen.results}. Name a folder that `implicit-vs-mesh paper` wrote.")
        text = with_section(chosen.readme.read_text(encoding="utf-8"), section(measured))
    except (OSError, ValueError) as error:
        print(f"compare.results: {error}", file=sys.stderr)
        return 2
    chosen.readme.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
