"""Light through triangles: a mesh's own tiles, looked up by place, and triangles from anywhere, in trees of boxes.

Traces and the judges of files search by `compiled_search`. Tiles stay beside it: 16 ns a ray and face against 450 (128
facets) to 2000 (131,072) in a tree. So does the `median_tree` of pictures: their rays go any way, upwards is assumed in
the other. `embree` serves both. Triangles are made in `mesh` and read from files in `formats.mesh`.
"""
