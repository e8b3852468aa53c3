"""Light through triangles: a mesh's own tiles, looked up by position, and triangles from any source, in trees
of boxes.

Traces and the judges of files search by `compiled_search`. Tiles are kept in addition: 16 ns a ray and face
against 450 (128 facets) to 2000 (131,072) in a tree. The `median_tree` of pictures is kept too: their rays go
in any direction, while the other search assumes upward rays. `embree` serves both. Triangles are made in
`mesh` and read from files in `formats.mesh`.
"""
