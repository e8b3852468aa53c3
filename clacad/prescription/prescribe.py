"""Bridge from intent to geometry: turns a design's request into radii, poses and bodies.

Only `prescribe` turns η, δ and the Euler angles into surfaces. All later code reads the `Window`.

Recipes
-------
biconvex "exact": centres s apart, both meridians afocal with exactly η (thick lenses).
biconvex "thin": the paper's R = 2(n − 1)f. slab, plano: one curved face per lens, exact for any thickness.
"best": radii scaled for the least rms law error (biconvex: the thin ones), `clacad.prescription.best_recipe`.
given: nothing is solved, the faces are those of the design, `clacad.prescription.given`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.design.keys import PAIR
from clacad.prescription.radii import NoSuchLens

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

__all__ = ["NoSuchLens", "prescribe"]


def prescribe(design: Design) -> Window:
    """Build the window that realises a design.

    Parameters
    ----------
    design : Design

    Returns
    -------
    Window
        Lengths in the design's unit.

    Raises
    ------
    DesignError
        The pair cannot exist; the message gives the number that would make it work. A design that is merely
        unwise (for example a lens that does not cover its cell) is built and left to the checks.
    """
    from clacad.design import DesignError
    from clacad.prescription.assemble import build_window

    try:
        return build_window(design)
    except NoSuchLens as error:
        raise DesignError.at(design, error.key, error.message, code=error.code, hint=error.hint) from error
    except ArithmeticError as error:  # lengths too far apart in size
        message = f"the lengths of this design are too far apart in size to be computed with ({error})"
        raise DesignError.at(design, PAIR.separation, message) from error
