"""The tracer compiled: twins of `reference`, the straight path in blocks, and the plain arrays they read.

How functions are compiled is in `base.compiled`; facets are in `triangles`.
"""
