"""What a notebook shows of a design, a window or a report: a section with rays, and the transfer curve.

`plot` gives a matplotlib figure, `as_html` the output below a cell that ends in one of these objects. Their
methods of these names come here through `clacad.plot` and `clacad.as_html`, the package's own door, so that
no room above imports this one.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from clacad.base.text import digits
from clacad.report.figures import ACCENT, FAINT, INK, SECOND, Margins, draw_section, panels, svg
from clacad.sheet.feasibility.as_rows import length_unit
from clacad.sheet.window import Window
from clacad.verification.light.through_window import Meridian, meridians

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.design import Design
    from clacad.verification import Report

SIZE = (9.0, 3.1)
"""Inches."""


def plot(thing: Design | Window | Report, figure: Figure | None = None) -> Figure:
    """Draw a section with rays, and exit slope against incident slope along both lens axes.

    Parameters
    ----------
    thing : Design, Window or Report
        A design is prescribed first; a report shows the curves that it holds.
    figure : matplotlib.figure.Figure or None
        To draw on; None makes one.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    DesignError, NoSuchLens
        The design cannot be built.
    TypeError
        Something else.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> figure = clacad.plot(design)
    >>> [axes.get_xlabel() for axes in figure.axes]
    ['z (mm)', 'incident slope']
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE) if figure is None else figure
    window, curves = _shown(thing)
    left, right = panels(figure, 1, 2, Margins(top=0.3, across=0.95))
    _section(left, window)
    _transfer(right, curves)
    return figure


def as_html(thing: Design | Window | Report) -> str:
    """Return what a notebook shows of a design, window or report: its text and a picture, as HTML
    that holds all of it.

    A design that cannot be built is shown with the reason.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> clacad.as_html(design).startswith("<div><pre>Design(")
    True
    """
    from clacad.config.mistakes import DesignError
    from clacad.prescription.radii import NoSuchLens

    said = f"<pre>{escape(repr(thing))}</pre>"
    try:
        drawn = svg(*SIZE, "section with rays, and transfer curve", lambda figure: _drawn(thing, figure))
    except (DesignError, NoSuchLens) as why:
        return f"{said}<pre>{escape(str(why))}</pre>"
    return f"<div>{said}{drawn}</div>"


def _drawn(thing: Design | Window | Report, figure: Figure) -> None:
    plot(thing, figure)


def _shown(thing: Any) -> tuple[Window, tuple[Meridian, Meridian]]:
    """The window, and its curves."""
    from clacad.design import Design
    from clacad.tracing.trace import trace
    from clacad.verification import Report

    if isinstance(thing, Report):
        return thing.window, thing.curves
    if isinstance(thing, Design):
        from clacad.prescription.prescribe import prescribe

        thing = prescribe(thing)
    if not isinstance(thing, Window):
        raise TypeError(f"a {type(thing).__name__} is neither a Design, a Window nor a Report")
    return thing, meridians(thing, lambda lit: trace(thing, lit.rays, path="numpy"))


def _section(axes: Any, window: Window) -> None:
    """Three cells cut along x, to scale, with rays along the middle of the field."""
    unit, name = length_unit(window.unit)
    draw_section(axes, window.with_cells((3, 3)), window.unit / unit, name)
    axes.set_aspect("auto")  # to scale, lenses of a long pair could not be distinguished from lines
    axes.set_title("section, five rays; x stretched")


def _transfer(axes: Any, curves: tuple[Meridian, Meridian]) -> None:
    """Exit slope against incident slope: the law as a line, traced means as points."""
    for name, curve, colour in zip("xy", curves, (ACCENT, SECOND), strict=True):
        axes.plot(curve.slope, curve.law, color=colour, lw=0.9)
        axes.plot(curve.slope, curve.mean, ".", color=colour, ms=3.5, label=f"lens {name}")
    axes.axhline(0.0, color=FAINT, lw=0.5)
    axes.set_title(f"line: the law; points: traced; {_passing(curves[0])} pass")
    axes.set_xlabel("incident slope")
    axes.set_ylabel("exit slope")
    axes.legend(fontsize=7, labelcolor=INK)


def _passing(curve: Meridian) -> str:
    """Share of the light that gets through in the middle of the field."""
    return f"{digits(100.0 * float(curve.alive[len(curve.alive) // 2]), count=3)} %"
