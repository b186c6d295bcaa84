"""python -m compare is the command implicit-vs-mesh."""

from compare.commands.cli import main

if __name__ == "__main__":
    main()
