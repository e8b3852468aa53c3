"""Arithmetic, tables and services without optics; this package imports nothing else of clacad.

It contains no geometry, no file format and no code that knows a design.
"""
