"""What one step minimises, over which displacements, and how it is solved [paper, eq. 4 and 5, appendix B]."""
