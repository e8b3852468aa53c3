"""The title of the deviation plot: quantity, unit, sign, and room for it at every width."""

from __future__ import annotations

import numpy as np
import pytest

from clacad.judging.deviation_map import BINS, DeviationMap, FaceMap, _draw


def mapped(faces):
    rng = np.random.default_rng(3)
    maps = tuple(
        FaceMap(
            f"array{number // 2 + 1} {('front', 'back')[number % 2]}",
            rng.normal(0.0, 1e-4, (BINS, BINS)), np.full((BINS, BINS), 50), 1e-4,
            np.full((4, 4), 1e-4), np.full((4, 4), 3e-4), number,
        )
        for number in range(faces)
    )  # fmt: skip
    box = np.array([0.25, 0.25])
    return DeviationMap("mm", -box, box, maps, np.zeros(2, dtype=np.int64), 1e-3, steps=(0.5, 0.5))


@pytest.mark.daily_cases("part.stl-1", "scan of the second sheet of the third delivery, turned over.stl-1")
@pytest.mark.parametrize("faces", [1, 2, 4])
@pytest.mark.parametrize(
    "name", ["part.stl", "scan of the second sheet of the third delivery, turned over.stl"]
)
def test_the_title_of_the_deviation_plot_names_quantity_unit_and_sign_and_fits_the_figure(faces, name):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.6 * faces, 6.8), layout="constrained", dpi=100)
    canvas = FigureCanvasAgg(figure)
    _draw(figure, mapped(faces), name)
    canvas.draw()
    title = figure._suptitle
    said = " ".join(title.get_text().split())
    for words in (
        name,
        "design",
        "surface normal",
        "µm",
        "positive: too much material",
        "negative: too little",
    ):
        assert words in said
    box, page = title.get_window_extent(), figure.bbox
    assert page.x0 <= box.x0 < box.x1 <= page.x1
    assert box.y1 <= page.y1
