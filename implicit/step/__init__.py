"""The problem of one step: energies, displacements to choose from, and the solve [paper, eq. 4 and 5, appendix B]."""
