"""Rows of a block's scratch array: one quantity of every ray each."""

from __future__ import annotations

X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, CI0, CJ0, LEFT_X, LEFT_Y, GX, GY, GZ = range(18)
SHARE, OVER, DEPTH, STEEP, SCRATCH = range(
    18, 23
)  # light let through: SHARE/OVER; Σ attenuation · length; attenuation/N

BLOCK = 256
"""Rays in a block: the rows that one face works on take 24 KB, which the first-level cache holds."""
