"""python -m compare is the command implicit-vs-mesh."""

from implicit_vs_mesh import main

if __name__ == "__main__":
    main()
