"""Optimisation of lens faces: search for those with the least error to the law, within manufacturing limits.

`clacad.optics.fit` has the least squares; the modules here have the unknowns, the constraints and the
resulting design file. Law, lattice, separation and thickness are fixed: a larger separation would reduce the
error without limit, as the cube of pitch over separation.
"""

from __future__ import annotations

from clacad.optimising.aim import Aim, Seen
from clacad.optimising.face_search import Effort
from clacad.optimising.search import Optimised, optimise, outlook

__all__ = ["Aim", "Effort", "Optimised", "Seen", "optimise", "outlook"]
