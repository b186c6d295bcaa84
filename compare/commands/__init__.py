"""The commands of implicit-vs-mesh, a file each: what it takes, as a dataclass, and the function that does it."""
