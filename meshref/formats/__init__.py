"""File formats of meshes, each with `read` of a file's content and `written` for it; scenes are only read.

The readers of .obj, .off, .ply and .stl are our own, for libigl returns empty arrays for a text that is no mesh and
crashes on wrong indices, and trimesh splits concave polygons into fans. What is wrong inside a file is a DamageError,
which names the line.
"""
