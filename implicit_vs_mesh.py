"""Entry of the command implicit-vs-mesh: nothing is imported before an interruption can be caught."""

import sys
from typing import NoReturn

INTERRUPTED = 130  # as in compare.commands.exits, which is not there yet


def main() -> NoReturn:
    """Import the command and run it; Ctrl-C before it is there ends as quietly as after."""
    try:
        from compare.commands.cli import main as command
    except KeyboardInterrupt:
        print("implicit-vs-mesh: interrupted.", file=sys.stderr)
        sys.exit(INTERRUPTED)
    command()


if __name__ == "__main__":
    main()
