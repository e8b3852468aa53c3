"""Panels of the report's figures keep their positions."""

from __future__ import annotations

import re
import warnings
from types import SimpleNamespace

import numpy as np

from clacad.report.figures import Margins, convergence_caption, panels, svg
from clacad.verification.light.facet_convergence import Convergence


def test_panels_keep_their_margins_and_nobody_complains():
    placed = []

    def draw(figure):
        panel = panels(figure, margins=Margins(left=0.5, right=0.25, bottom=0.4, top=0.2))
        panel.set_ylabel("a label that is longer than its margin has room for")
        figure.canvas.draw()
        placed.append(panel.get_position().bounds)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = svg(4.0, 2.0, "a figure", draw)
    assert re.match(r'<svg role="img" aria-label="a figure" ', text)
    left, bottom, width, height = placed[0]
    assert abs(4.0 * left - 0.5) + abs(2.0 * bottom - 0.4) < 1e-12
    assert abs(4.0 * width - 3.25) + abs(2.0 * height - 1.4) < 1e-12


def test_the_caption_of_the_refinement_plot_tells_the_plots_own_numbers():
    found = Convergence(np.array([4, 8]), np.array([20e-3, 10.4e-3]), np.array([0.08, 0.03]), 0.943, 1.415)
    said = convergence_caption(SimpleNamespace(convergence=found))
    for words in (
        "4, 8 quads",
        "from 20 to 10 mrad",
        "to the power 0.94",
        "from 8 to 3 %",
        "to the power 1.42",
        "expected is 1",
    ):
        assert words in said
    assert convergence_caption(SimpleNamespace(convergence=None)) == ""
