"""Optical materials: index against wavelength, the bundled catalogue, the refractiveindex.info database.

The choice of a body's material belongs to `sheet`; absorption along a path is an effect.
"""
