"""Exact boundary representation of bodies: rational lens faces, conic edges, no Booleans.

Where cells meet comes from `topology`; files of solids are written by `formats.step`.
"""
