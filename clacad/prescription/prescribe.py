"""The bridge from intent to geometry: what a design asks becomes radii, poses and bodies here, once.

`prescribe` is the only place where η, δ and the Euler angles turn into surfaces. Everything after it
reads the `Window`.

Recipes
-------
biconvex "exact": centres s apart, both meridians afocal with exactly η (thick lenses).
biconvex "thin": the paper's R = 2(n − 1)f. slab, plano: one curved face a lens, exact for any thickness.
"best": radii scaled for the least rms law error (biconvex: the thin ones), `clacad.prescription.best_recipe`.
given: nothing is solved, the faces stand as the design says, `clacad.prescription.given`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.prescription.radii import NoSuchLens

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

__all__ = ["NoSuchLens", "prescribe"]


def prescribe(design: Design) -> Window:
    """Turn a design into the window that realises it.

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
        The pair cannot exist; the message gives the number that would make it work. What is merely
        unwise (a lens that does not cover its cell, say) is built, and left to the checks.
    """
    from clacad.design import DesignError
    from clacad.prescription.assemble import build_window

    try:
        return build_window(design)
    except NoSuchLens as error:
        raise DesignError.at(design, error.key, error.message, code=error.code, hint=error.hint) from error
    except ArithmeticError as error:  # a quotient of numbers that no sheet has
        message = f"the lengths of this design are too far apart in size to be computed with ({error})"
        raise DesignError.at(design, "pair.separation", message) from error
