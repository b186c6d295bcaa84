"""Motion of the surface and of its integrals with the parameters [paper, eq. 3 and 7]."""
