"""The compiled tracer: twins of `reference`, the straight path in blocks, and the plain arrays they read.

The types that compiled functions exchange are in `records`, the numbers of a sheet in `packing`. How
functions are compiled is in `base.compiled`; facets are in `triangles`.
"""
