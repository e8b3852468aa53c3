"""The sheet as built: lattice, faces, bodies, window, and their closed-form properties.

This package contains no design intent (see `prescription`), no triangles and no traced rays.
"""
