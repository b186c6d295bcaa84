"""Run cases of the corpus in this process, one after the other, and tell of each before it begins.

    python worker.py MODULE FIRST        writes a line of JSON for each case from number FIRST on

A crash of the interpreter then belongs to the last case that was begun.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import resource
import sys
import tempfile
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any

# What a refusal may be; anything else came from where nobody looked.
REFUSALS = (ValueError, TypeError, MemoryError, OSError)

MOST_MEMORY = 8 * 2**30


def outcome(case: Any) -> str | None:
    """Why a case is not passed, or None."""
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            answer = case.call()
    except REFUSALS as error:
        lacking = case.misses(str(error))
        return None if lacking is None else f"{lacking}: {type(error).__name__}: {error}"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} at {where.filename}:{where.lineno}"
    return f"it gave an answer: {answer!r:.200}"


def main() -> None:
    """Tell of each case on the first standard output, which the cases themselves do not see."""
    module, first = sys.argv[1], int(sys.argv[2])
    told = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    faulthandler.enable()
    # Input that asks for more fails here by itself, and not with the machine.
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    warnings.simplefilter("error")
    warnings.filterwarnings("ignore", ".torch.jit.script. is deprecated", DeprecationWarning)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for number, case in enumerate(importlib.import_module(module).cases()):
            if number < first:
                continue
            print(json.dumps({"begin": case.name}), file=told)
            print(json.dumps({"end": case.name, "failure": outcome(case)}), file=told)
        os.chdir("/")
    print(json.dumps({"done": True}), file=told)
    told.close()


if __name__ == "__main__":
    main()
