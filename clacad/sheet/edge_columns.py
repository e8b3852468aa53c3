"""Columns of the table of a plate's edges: start, end, centre and radius of an arc, and its sense.

The columns are separate from `clacad.sheet.plate`: a change to a module whose constants are compiled in
causes recompilation.
"""

X0, Y0, X1, Y1, CX, CY, RADIUS, SENSE, EDGE_NUMBERS = range(9)
"""SENSE is +1 for a counter-clockwise arc, -1 for a clockwise arc, 0 for a straight edge."""
