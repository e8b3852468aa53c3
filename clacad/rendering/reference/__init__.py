"""Objects that rays meet in a scene, in numpy: primitives, trees of triangles, light.

Files of the same name in `compiled` are the twins.
"""
