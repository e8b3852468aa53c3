"""Light through triangles: a mesh's own tiles, and triangles from anywhere in a tree of boxes.

Triangles are made in `mesh` and read from files in `formats.mesh`.
"""
