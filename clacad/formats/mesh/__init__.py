"""Triangles in files: STL, PLY, OBJ, GLB, 3MF, and the stream of triangles that all of them are read as.

Triangles are made in `mesh`; light goes through them in `tracing.facets`.
"""
