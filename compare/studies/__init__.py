"""Studies: grids of cases, their folders and their curves."""
