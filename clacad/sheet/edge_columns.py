"""Columns of the table of a plate's edges: from, to, centre and radius of an arc, and its sense.

Apart from `clacad.sheet.plate`, for what compiled code takes names from makes it compile anew.
"""

X0, Y0, X1, Y1, CX, CY, RADIUS, SENSE, EDGE_NUMBERS = range(9)
"""SENSE is +1 where an arc runs counter-clockwise, -1 clockwise, 0 of a straight edge."""
