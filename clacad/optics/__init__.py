"""The optics of single things: law, surfaces, materials, rays, sequences of surfaces.

Nothing here knows of cells, sheets or designs.
"""
