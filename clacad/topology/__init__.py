"""Topology of neighbouring cells: borders, nodes and rims of one cell.

`mesh` and `solid` both build from it.
"""
