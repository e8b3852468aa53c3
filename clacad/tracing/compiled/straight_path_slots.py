"""Rows of a block's scratch array: one quantity of every ray each."""

from __future__ import annotations

X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, CI0, CJ0, LEFT_X, LEFT_Y, GX, GY, GZ = range(18)
SHARE, OVER, DEPTH, STEEP, HALF, AX, AY, SCRATCH = range(18, 26)
"""Light let through is SHARE/OVER; DEPTH sums attenuation times length, STEEP is attenuation/N; HALF numbers half bins.
(AX, AY): how far the lens of a ray's cell stands from where the face's do, where cells differ."""

XL, YL = GX, GY
"""What rounding takes from positions, on the way to another cell."""

RANGE = ROOT
"""Distances, where facets take the place of a smooth face."""

BLOCK = 256
"""Rays in a block: the rows that one face works on take 24 KB, which the first-level cache holds."""
