"""A matplotlib figure as bytes: no global state, nobody's settings, the same bytes for the same numbers."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.foreign_settings import without_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[["Figure"], None]


def no_formula(text: str) -> str:
    """Give a stranger's text as a label shows it: matplotlib would set what stands between dollar signs as a formula."""
    return text.replace("$", r"\$")


@contextmanager
def _style(changes: Mapping[str, Any]) -> Iterator[None]:
    """Within the block matplotlib's own defaults hold, but for the changes: no matplotlibrc of folder or user."""
    matplotlib = without_settings("matplotlib")
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(changes)
        yield


def drawn(
    format: Literal["svg", "png"], size: tuple[float, float], draw: Draw, style: Mapping[str, Any],
    creator: str | None = "clacad", placed: bool = False,
) -> bytes:  # fmt: skip
    """Draw a figure and give its file's bytes.

    Parameters
    ----------
    format : {"svg", "png"}
    size : (width, height), inches
    draw : callable
        Draws on the figure it is given.
    style : mapping
        What differs from matplotlib's defaults.
    creator : str or None
        Named in the file; None names nobody.
    placed : bool
        Whether `draw` says where everything stands; else room is found by drawing twice.
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
