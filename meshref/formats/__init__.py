"""File formats of meshes, one a module, each with `read` of a file's content and `written` for it.

The readers are our own, for libigl returns empty arrays for a text that is no mesh, and crashes on wrong indices. What
is wrong inside a file is a DamageError, which names the line.
"""
