"""How the surface and its integrals move with the parameters [paper, eq. 3 and 7]."""
