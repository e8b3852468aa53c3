"""A matplotlib figure as bytes: no global state, no user settings, the same bytes for the same numbers."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.untrusted_files import without_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[["Figure"], None]


def no_formula(text: str) -> str:
    """Escape untrusted text for a label: matplotlib would typeset text between dollar signs as a formula."""
    return text.replace("$", r"\$")


def inline_svg(text: str) -> str:
    """Return the <svg> element of a picture, without XML head and metadata, to be put into a page."""
    text = text[text.index("<svg") :]
    start, end = text.find("<metadata>"), text.find("</metadata>")
    return text if start < 0 else text[:start] + text[end + len("</metadata>") :].lstrip()


@contextmanager
def _style(changes: Mapping[str, Any]) -> Iterator[None]:
    """Apply matplotlib's defaults and the changes within the block; no matplotlibrc is read."""
    matplotlib = without_settings("matplotlib")
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(changes)
        yield


def drawn(
    format: Literal["svg", "png"],
    size: tuple[float, float],
    draw: Draw,
    style: Mapping[str, Any],
    creator: str | None = "clacad",
    placed: bool = False,
) -> bytes:
    """Draw a figure and return the bytes of its file.

    format : {"svg", "png"}
    size : (width, height), inches
    draw : Draws on the figure it is given.
    style : Changes to matplotlib's defaults.
    creator : Program named in the file; None writes no name.
    placed : Whether `draw` positions everything itself; otherwise the layout is found by drawing twice.
    """
    with _style(style):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure

        figure = Figure(figsize=size, layout=None if placed else "constrained", dpi=100)
        (FigureCanvasAgg if format == "png" else FigureCanvasSVG)(figure)
        draw(figure)
        out = io.BytesIO()
        # no date: the same numbers give the same bytes
        about = {"Software": creator} if format == "png" else {"Date": None, "Creator": creator}
        figure.savefig(out, format=format, metadata=about)
    return out.getvalue()
