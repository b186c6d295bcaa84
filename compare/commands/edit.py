"""implicit-vs-mesh edit: drag a neural shape in the browser."""

from __future__ import annotations

import sys
import time
import webbrowser
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import tyro

from compare.cases.case import MESH_SUFFIXES
from compare.commands import exits
from compare.commands.checks import require_folder_for, require_seed
from compare.commands.shown import add_task, progress_bars, speaker, teller
from compare.errors import InputError

LOOPBACK = "127.0.0.1"
MOST_PORT = 65535


@dataclass
class Edit:
    """Drag a neural shape in the browser: a page on this machine alone, with undo, history and exports."""

    shape: tyro.conf.Positional[str]
    """A bundled shape or family model, a mesh, a field, a checkpoint, or your own my_module.py:make_field."""
    port: int = 8080
    """Port of the page; the next free one where it is in use."""
    browser: bool = True
    """Open the page; --no-browser prints its address alone."""
    host: str = LOOPBACK
    """Address to listen on. Any but the default lets others reach the page, and edit: it asks for no password."""
    session: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder in which the session is kept after each edit, and gone on with; by default results/edit- and the time."""
    code: int = 0
    """Number of the code, from 0, of a shape that a decoder generates."""
    module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:FUNCTION")] = None
    """What builds the network of a field of your own, my_nets.py:make or package.module:function; its code is run."""
    quick: bool = False
    """Fit a mesh coarsely, for a first look."""
    seed: int = 0
    """Of every random choice."""
    quiet: bool = False
    """Print nothing but the address, warnings and errors."""


def edit(command: Edit) -> int:
    """Take the shape in, serve the page, and stay until Ctrl-C."""
    _check(command)

    from compare.editor.page import EditorPage

    session = _session(command)
    say = speaker(command.quiet, to_stderr=True)
    for note in session.source.notes:
        say(note)
    if command.host not in (LOOPBACK, "localhost", "::1"):
        print(
            f"implicit-vs-mesh: warning: the page listens on {command.host}; whoever reaches it can edit and download. "
            "Leave out --host to keep it to this machine.",
            file=sys.stderr,
            flush=True,
        )
    page = EditorPage(session, host=command.host, port=command.port)
    try:
        print(page.address, flush=True)
        say(f"Each edit is kept in {session.folder}. Ctrl-C ends.")
        if command.browser:
            webbrowser.open(page.address)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        say(f"\nThe session is in {session.folder}: implicit-vs-mesh edit {command.shape} --session {session.folder}")
        return exits.DONE
    finally:
        page.stop()


def _check(command: Edit) -> None:
    """Refuse what cannot be served, before any work."""
    require_seed(command.seed)
    if not 0 < command.port <= MOST_PORT:
        raise InputError(f"--port must be a number from 1 to {MOST_PORT}, but is {command.port}.")
    if command.code < 0:
        raise InputError(f"--code must be at least 0, but is {command.code}.")
    if find_spec("viser") is None:
        raise InputError(
            'The editor needs viser, which is not installed: pip install "implicit-vs-mesh[editor]", or pip install '
            '".[editor]" in a checkout.'
        )
    if command.session is not None:
        if command.session.exists() and not command.session.is_dir():
            raise InputError(f"A session is kept in a folder, but {command.session} is a file. Name another.")
        require_folder_for(command.session / "session.json")


def _session(command: Edit) -> Any:
    from compare.cases.default_cases import QUICK_FIT
    from compare.editor.session import EditSession
    from compare.editor.source import Opening
    from compare.editor.tools import Settings

    folder = command.session or Path("results") / f"edit-{time.strftime('%Y%m%d-%H%M%S')}"
    fit = {"seed": command.seed, **(QUICK_FIT if command.quick else {})}
    mesh = Path(command.shape).suffix.lower() in MESH_SUFFIXES
    opening = Opening(command.code, command.module, fit if mesh else {})
    with progress_bars(command.quiet) as bars:
        tell = teller(bars, add_task(bars, command.shape, None))
        try:
            return EditSession.open(
                command.shape, folder, opening=opening, settings=Settings(seed=command.seed), progress=tell
            )
        except InputError:
            raise
        except (ValueError, TypeError) as error:  # the field has no surface in its bounds, say
            raise InputError(f"{command.shape}: {error}") from error
