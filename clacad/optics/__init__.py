"""The optics of single objects: law, surfaces, materials, rays, sequences of surfaces.

No module here depends on cells, sheets or designs.
"""
