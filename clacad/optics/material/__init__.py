"""Optical materials: index against wavelength, the bundled catalogue, the refractiveindex.info database.

What a body is made of is the sheet's; absorption along a path is an effect.
"""
