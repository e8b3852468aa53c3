"""The tracer compiled: twins of `reference`, the straight path in blocks, and the plain arrays they read.

What they hand to one another is in `records`, the numbers of a sheet in `packing`; how functions are compiled is in
`base.compiled`; facets are in `triangles`.
"""
