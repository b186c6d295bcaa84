"""The command implicit-vs-mesh.

Everything that can be wrong with what the user gave is found before any work: it ends in one sentence on stderr and
exit code 2, with nothing written. A case that fails while it runs is a row of the table, and exit code 1.
"""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import reduce
from operator import or_
from typing import Any, NoReturn

import tyro

from compare.commands import exits
from compare.commands.checks import require_lists
from compare.commands.edit import Edit, edit
from compare.commands.figures import Figures, figures
from compare.commands.fit import Fit, fit
from compare.commands.handles import Handles, handles
from compare.commands.paper import Paper, paper
from compare.commands.report import Report, report
from compare.commands.run import Run, run
from compare.commands.shapes import Shapes, shapes
from compare.commands.study import Study, study
from compare.commands.train_family import TrainFamily, train_family
from compare.errors import InputError

# What each command takes, and what does it; in the order of --help.
COMMANDS: dict[type, Callable[[Any], int]] = {
    Run: run,
    Study: study,
    Edit: edit,
    Shapes: shapes,
    Handles: handles,
    Fit: fit,
    Report: report,
    Figures: figures,
    Paper: paper,
    TrainFamily: train_family,
}

DESCRIPTION = """Neural fields and meshes, edited side by side.

Exit codes: 0 done; 1 a case failed, and the others are done; 2 what was given cannot be used, and nothing was done; 130
interrupted, and what was done is kept; 141 whoever read the output has closed it. For completion in the shell:
--tyro-print-completion bash (or zsh, tcsh)."""


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 done, 1 a case failed, 2 the input cannot be used, 130 or 141 broken off."""
    # Threads that wait for each other by spinning starve when anything else runs: on two busy cores, a fit took fifteen
    # times as long. OpenMP reads this when torch is imported, which is later.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        try:
            code = _code(sys.argv[1:] if arguments is None else arguments)
        finally:
            sys.stdout.flush()  # for when the interpreter does it, nobody can say any more that the pipe is closed
    except BrokenPipeError:  # as by `implicit-vs-mesh study --list | head -1`
        _let_go_of_output()
        code = exits.CLOSED
    sys.exit(code)


def _code(arguments: list[str]) -> int:
    """Return the exit code of what the arguments ask for, once it is done or refused."""
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(version("implicit-vs-mesh"))
        return exits.DONE
    try:
        _require_command(arguments)
        command: Any = tyro.cli(
            reduce(or_, COMMANDS),  # Run | Shapes | ...
            prog="implicit-vs-mesh",
            description=DESCRIPTION,
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        require_lists(command, arguments)
        return COMMANDS[type(command)](command)
    except InputError as error:
        print(f"implicit-vs-mesh: {error}", file=sys.stderr)
        return exits.INPUT
    except BrokenPipeError:
        raise
    except OSError as error:  # a disk that is full, a folder that has gone: what is written so far is whole
        print(f"implicit-vs-mesh: {error}", file=sys.stderr)
        return exits.FAILED
    except KeyboardInterrupt as interruption:  # whose words, if any, say what is kept and how to go on
        print(f"implicit-vs-mesh: interrupted. {interruption}".rstrip(), file=sys.stderr)
        return exits.INTERRUPTED


def _let_go_of_output() -> None:
    """Send what is still to be written nowhere, so that the interpreter has nothing to complain of at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _require_command(arguments: Sequence[str]) -> None:
    """Say what was meant by a command that is mistyped; tyro does so for options only."""
    names = [re.sub(r"(?<=[a-z])(?=[A-Z])", "-", command.__name__).lower() for command in COMMANDS]
    if arguments and not arguments[0].startswith("-") and arguments[0] not in names:
        close = difflib.get_close_matches(arguments[0], names, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise InputError(f"There is no command {arguments[0]}; there are {', '.join(names)}.{hint}")
