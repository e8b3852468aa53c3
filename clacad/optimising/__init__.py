"""Which faces should be cut: a search for those that keep best to the law, within the walls of the workshop.

The least squares themselves live with the mathematics (`clacad.optics.fit`); here is what may change, what must hold,
and the design file that comes of it. Nothing of the law, the lattice, the separation or the thickness is free: a larger
separation would lessen the error for ever, as the cube of pitch over separation.
"""

from __future__ import annotations

from clacad.optimising.aim import Aim
from clacad.optimising.measured_light import Seen
from clacad.optimising.search import Optimised, optimise, outlook

__all__ = ["Aim", "Optimised", "Seen", "optimise", "outlook"]
