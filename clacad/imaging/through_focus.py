"""Through-focus picture: width of a point's light at each height, and its spot where the width is least."""

from __future__ import annotations

from typing import Any

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.imaging.best_point import spot_at
from clacad.imaging.image_by_rays import Image, RungImage

SIZE = (9.6, 4.2)
COLOURS = {"law": "#7a7a7a", "thin": "#b07aa1", "surfaces": "#1f4e79"}
HEIGHTS = 81
DOTS = 4000
"""Number of rays drawn in a spot."""


def plot_png(image: Image, name: str, unit: str) -> bytes:
    """Picture as PNG, reproducible for equal images; `name` of the design, `unit` of its lengths."""
    return drawn("png", SIZE, lambda figure: _draw(figure, image, name, unit), {"font.size": 9.0})


def plot_svg(image: Image, name: str, unit: str) -> str:
    """Picture as SVG text."""
    style = {"svg.hashsalt": "clacad", "font.size": 9.0, "svg.fonttype": "path"}
    return drawn("svg", SIZE, lambda figure: _draw(figure, image, name, unit), style).decode()


def reach_of(one: RungImage) -> float:
    """Distance (length) from the image at which the light is about five times as wide."""
    slopes = one.direction[:, :2] / one.direction[:, 2:]
    cone = float(np.sqrt(np.mean(np.sum((slopes - slopes.mean(axis=0)) ** 2, axis=1))))
    return 5.0 * float(np.hypot(*one.found.spot)) / cone


def heights(one: RungImage, reach: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Heights (81,), lengths, up to `reach` about the image."""
    return np.asarray(one.found.point[2] + np.linspace(-reach, reach, HEIGHTS))


def _draw(figure: Any, image: Image, name: str, unit: str) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    seen = [one for one in image.rungs if np.isfinite(one.found.point).all()]
    reach = max((reach_of(one) for one in seen), default=0.0)
    for one in seen:
        z = heights(one, reach)
        widths = [spot_at(one.position, one.direction, np.array([*one.found.point[:2], h])) for h in z]
        for k, line in ((0, "-"), (1, ":")):
            left.plot(
                z,
                [w[k] for w in widths],
                line,
                color=COLOURS[one.rung],
                lw=1.1,
                label=f"{one.rung}, {'xy'[k]}",
            )
        left.axvline(one.predicted.point[2], color=COLOURS[one.rung], lw=0.6, ls="--")
    left.set_xlabel(f"height / {unit} (dashed: predicted)")
    left.set_ylabel(f"rms distance from the image point / {unit}")
    left.set_ylim(bottom=0.0)
    left.grid(True, color="#dddddd", lw=0.6)
    if seen:
        left.legend(fontsize=7)
        one = seen[-1]
        some = np.linspace(0, len(one.position), min(DOTS, len(one.position)), endpoint=False).astype(
            np.int64
        )
        reach = (one.found.point[2] - one.position[some, 2]) / one.direction[some, 2]
        at = one.position[some, :2] + reach[:, None] * one.direction[some, :2]
        right.plot(at[:, 0], at[:, 1], ",", color=COLOURS[one.rung])
        right.set_aspect("equal", "datalim")
        right.set_title(f"light of rung {one.rung} at z = {one.found.point[2]:.6g} {unit}", fontsize=8)
    figure.suptitle(no_formula(f"{name}: through focus"), fontsize=10)
