"""Light through triangles: the tiles of a mesh made here, looked up by position, and all others in one
hierarchy.

`tiles` are the facets of one cell, repeated; the cells of a non-uniform sheet have heights of their own over
one footprint. A trace through them takes 16 ns a ray and face, 50 ns on such a sheet. Triangles from any
source (files, sheets with turned arrays, meshes of scenes) are in the trees of `hierarchy`, searched by
`compiled_hierarchy`: about 1000 ns. Where they are squares cut along a diagonal, `squares` looks up the
planes that steep rays cross: 30 ns. Triangles are made in `mesh` and read from files in `formats.mesh`.
"""
