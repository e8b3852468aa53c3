"""Arithmetic, tables and services without optics: anything may use them, they use nothing of clacad.

No geometry lives here, no file format, and nothing that knows a design.
"""
