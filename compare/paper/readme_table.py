"""The tables of results, from the findings of the paper's parts: python -m compare.paper.readme_table [FOLDER]

With a folder, the parts that it holds are first taken over into docs/results.json, where they take the place of older
ones. The tables are made from that file alone, so whoever has the sources can make them again: all findings that are
marked so for docs/results.md, and those of FIRST for README.md. Run it where README.md is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

from compare.paper import PARTS
from compare.paper.findings import FILE, Measured, read_measured, table, write_measured

# The findings of the first page: one of each kind of edit, and what it costs.
FIRST = (
    "bunny, bump: error field, achieved minus wanted normal motion, rms over the surface [of the largest wanted]",
    "dualsdf, one leg shorter: steps [count]",
    "bunny, neural, volume held, after 86 steps: volume, relative change [of that before]",
    "bunny (bunny.off), one small step, neural over mesh Killing: tangential energy [ratio]",
    "bunny (bunny.off), one small step, neural over mesh Killing: time, mesh of 3,469 vertices [ratio]",
)

BEGIN, END = "<!-- results: python -m compare.paper.readme_table -->", "<!-- end of results -->"


def take_over(folder: Path, results: Path) -> None:
    """Put the parts of a folder in the place of those that are kept; parts that the folder has not stay.

    Raises:
        ValueError: The folder has none, they are quick, or were made with other settings than those that stay.
    """
    new = {part.part: part for part in read_measured(folder / FILE)}
    if not new:
        raise ValueError(f"{folder} holds no findings. Name a folder that `implicit-vs-mesh paper` wrote.")
    if quick := [name for name, part in new.items() if part.quick]:
        raise ValueError(f"The findings of {', '.join(quick)} in {folder} are quick ones, which are not for showing.")
    found = {part.part: part for part in read_measured(results)} | new
    settings = next(iter(new.values())).settings
    if others := [name for name, part in found.items() if part.settings != settings]:
        raise ValueError(
            f"{_listed(others)} were made with other settings (seed, meshes) than {_listed(new)}. Make them again with "
            f"the same, or remove {results} to begin anew."
        )
    write_measured([found[name] for name in PARTS if name in found], results)


def section(measured: Sequence[Measured]) -> str:
    """Return when and where the findings were measured, and the table of those marked for it."""
    days = sorted({str(part.provenance["time"])[:10] for part in measured})
    machine = {f"{part.provenance['processor']}, {part.provenance['cores']} cores" for part in measured}
    threads = sorted({int(part.provenance["threads"]) for part in measured})
    hours, of_processor = (
        f"{sum(seconds) / 3600:.1f}"
        for seconds in ([part.seconds for part in measured], [part.processor_seconds for part in measured])
    )
    said = (
        f"`implicit-vs-mesh paper --meshes DIR` with {_listed(measured[0].settings['meshes'])}; "
        f"{' to '.join(dict.fromkeys((days[0], days[-1])))}; {'; '.join(sorted(machine))}, {_listed(threads)} "
        f"{'thread' if threads == [1] else 'threads'}; {hours} h by the clock, {of_processor} h of processor time."
    )
    if missing := [name for name in PARTS if name not in {part.part for part in measured}]:
        said = f"{said} Not measured yet: {_listed(missing)}."
    return f"{fill(said, 125, break_long_words=False, break_on_hyphens=False)}\n\n{table(measured, headlines=True)}"


def first_section(measured: Sequence[Measured]) -> str:
    """Return the table of the first page."""
    chosen = [replace(part, findings=tuple(f for f in part.findings if f.what in FIRST)) for part in measured]
    return table(chosen)


def with_section(text: str, made: str) -> str:
    """Return the text with what is between the two marks replaced.

    Raises:
        ValueError: It has not each mark once, in this order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"The page must hold {BEGIN} and, after it, {END}, each once. Put them where the table goes.")
    before, after = text[: text.index(BEGIN)], text[text.index(END) :]
    return f"{before}{BEGIN}\n\n{made}\n{after}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m compare.paper.readme_table", description=str(__doc__).partition("\n")[0]
    )
    parser.add_argument("folder", nargs="?", type=Path, help="that `paper` wrote; without it, the results stay")
    parser.add_argument("--readme", type=Path, default=Path("README.md"), help="default: %(default)s")
    parser.add_argument("--page", type=Path, default=Path("docs/results.md"), help="default: %(default)s")
    parser.add_argument("--results", type=Path, default=Path("docs/results.json"), help="default: %(default)s")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.folder is not None:
            take_over(chosen.folder, chosen.results)
        measured = read_measured(chosen.results)
        if not measured:
            raise ValueError(f"There is no {chosen.results}. Name a folder that `implicit-vs-mesh paper` wrote.")
        made = {chosen.readme: first_section(measured), chosen.page: section(measured)}
        texts = {path: with_section(path.read_text(encoding="utf-8"), new) for path, new in made.items()}
    except (OSError, ValueError) as error:
        print(f"compare.paper.readme_table: {error}", file=sys.stderr)
        return 2
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return 0


def _listed(things: Iterable[object]) -> str:
    return ", ".join(str(thing) for thing in things) or "none"


if __name__ == "__main__":
    raise SystemExit(main())
