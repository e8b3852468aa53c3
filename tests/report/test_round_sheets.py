"""The report of a round sheet counts the kept cells and measures the sheet as `check` does, whether it is not uniform or not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clacad.advice import judge
from clacad.design import Design
from clacad.report.content import Content
from clacad.sheet.feasibility import describe
from clacad.verification.verification_report import Report, of_worst_cell

ROUND = {
    "format": 1, "name": "round", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 5.0, "index": 1.5}, "lattice": {"pitch": 0.5, "outline": {"circle": 12.0}},
}  # fmt: skip


def kept_squares(scale):
    """Squares of a lattice of 24 x 24, 0.5 mm, that are wholly inside a circle of 12 mm, as they are and `scale` times as large."""
    low = 0.5 * (np.arange(24) - 12.0)
    far = np.maximum(np.abs(low), np.abs(low + 0.5))
    return int((max(scale, 1.0) * np.hypot(far[:, None], far[None, :]) <= 6.0 * (1.0 + 1e-12)).sum())


@pytest.fixture(scope="module", params=["plain", "aimed"])
def shown(request):
    """The window that `check` judges, and the content of the page."""
    changes = {} if request.param == "plain" else {"lattice.aperture": {"point": [0, 0, -400]}}
    judged = judge(Design.from_dict(ROUND).replace(changes))
    dark = SimpleNamespace(fitted=None, lit="no rays")
    unlit = SimpleNamespace(narrow=dark, main=dark)
    report = Report(judged.design, judged.window, judged.facts, (), unlit, ())
    like, words = of_worst_cell(report)
    return judged, Content(like, None, None, whole=judged.window, of_one_cell=words)


def test_check_and_report_tell_the_same_sheet(shown):
    judged, content = shown
    checked = [row for row in describe(judged.window, judged.facts) if row.about == "sheet"]
    assert [row for row in content.described if row.about == "sheet"][:4] == checked[:4]
    values = {row.name: row.value for row in checked}
    assert values["outer size"] == "12 round"
    assert (
        values["cells"]
        == f"{kept_squares(judged.window.placements[1].scale(judged.window.lattice)[0])} of 24 x 24"
    )


def test_every_count_and_width_of_the_report_is_that_of_the_kept_cells(shown):
    judged, content = shown
    count = kept_squares(judged.window.placements[1].scale(judged.window.lattice)[0])
    assert content.cells == f"{count} of 24 × 24"
    lines = {line.name: line.value for _, group in content.fabrication for line in group}
    assert lines["cells"] == f"{count} of 24 × 24"
    assert lines["sheet: width, height, thickness"][:2] == pytest.approx((12.0, 12.0), abs=1e-12)
    assert dict((name, built) for name, _, built in content.asked)["cells"] == str(count)
    across = lines["extent of the cells x, y"]
    assert across == pytest.approx((11.0, 11.0), abs=1e-12)  # 22 squares in the rows next to the middle
    assert 0.8 * np.pi * 36.0 * lines["sheet: width, height, thickness"][2] < lines["volume"][0]
    assert lines["volume"][0] <= np.pi * 36.0 * lines["sheet: width, height, thickness"][2]
