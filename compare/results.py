"""The README's table of results, from the findings of `implicit-vs-mesh paper`: python -m compare.results [FOLDERS]

Findings of folders that are named are first taken over into docs/results.json. The table is made from that file alone,
so whoever has the sources can make it again. Run it where README.md is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from compare.paper import PARTS
from compare.paper.findings import FILE, Measured, read_measured, table, write_measured

BEGIN, END = "<!-- results: python -m compare.results -->", "<!-- end of results -->"


def take_over(folders: Sequence[Path], results: Path) -> None:
    """Keep the findings of folders as those that the README shows; of a part that several hold, the last.

    Raises:
        ValueError: They are of a quick run, or parts are missing, or were made with different settings.
    """
    found = {part.part: part for folder in folders for part in read_measured(folder / FILE)}
    measured = [found[name] for name in PARTS if name in found]
    where = ", ".join(str(folder) for folder in folders)
    if missing := [name for name in PARTS if name not in found]:
        raise ValueError(f"There are no findings of {', '.join(missing)} in {where}. Make them: paper --resume.")
    if quick := [part.part for part in measured if part.quick]:
        raise ValueError(f"The findings of {', '.join(quick)} in {where} are quick ones, which are not for showing.")
    if any(part.settings != measured[0].settings for part in measured):
        raise ValueError(f"The parts in {where} were made with different settings. Make them again: paper --resume.")
    write_measured(measured, results)


def section(measured: Sequence[Measured]) -> str:
    """When and where the findings were measured, and the table of those marked for the README."""
    days = sorted({str(part.provenance["time"])[:10] for part in measured})
    machine = {f"{part.provenance['processor']}, {part.provenance['cores']} cores" for part in measured}
    threads = sorted({int(part.provenance["threads"]) for part in measured})
    hours, of_processor = (
        f"{sum(seconds) / 3600:.1f}"
        for seconds in ([part.seconds for part in measured], [part.processor_seconds for part in measured])
    )
    return (
        f"`implicit-vs-mesh paper --meshes DIR` with {_listed(measured[0].settings['meshes'])}; "
        f"{' to '.join(dict.fromkeys((days[0], days[-1])))}; {'; '.join(sorted(machine))}, {_listed(threads)} "
        f"{'thread' if threads == [1] else 'threads'}; {hours} h by the clock, {of_processor} h of processor time.\n\n"
        f"{table(measured, headlines=True)}"
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
    parser.add_argument("folders", nargs="*", type=Path, help="that `paper` wrote; without any, the results stay")
    parser.add_argument("--readme", type=Path, default=Path("README.md"), help="default: %(default)s")
    parser.add_argument("--results", type=Path, default=Path("docs/results.json"), help="default: %(default)s")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.folders:
            take_over(chosen.folders, chosen.results)
        measured = read_measured(chosen.results)
        if not measured:
            raise ValueError(f"There is no {chosen.results}. Name a folder that `implicit-vs-mesh paper` wrote.")
        text = with_section(chosen.readme.read_text(encoding="utf-8"), section(measured))
    except (OSError, ValueError) as error:
        print(f"compare.results: {error}", file=sys.stderr)
        return 2
    chosen.readme.write_text(text, encoding="utf-8")
    return 0


def _listed(things: Iterable[object]) -> str:
    return ", ".join(str(thing) for thing in things) or "none"


if __name__ == "__main__":
    raise SystemExit(main())
