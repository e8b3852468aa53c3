"""The drawings of a report: the views that `exporting.drawing` makes of the part, with the light that was
measured, as SVG.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.exporting.drawing import views
from clacad.exporting.drawing.notes import allowances

if TYPE_CHECKING:
    from clacad.sheet.window import Window
    from clacad.verification import Report


def assembly(sheet: Window) -> str:
    """The whole sheet from the side, cut through a row of cells."""
    return views.assembly(sheet).svg()


def plan(sheet: Window) -> str:
    """The sheet seen along the light."""
    return views.plan(sheet).svg()


def telescopelet(report: Report) -> str:
    """One telescopelet cut along x, with rays and the focal plane where they were measured."""
    from clacad.report.figures import ray_fan

    light = None
    if report.evidence is not None and report.evidence.foci is not None:
        focus = report.evidence.foci[0].lens1.focus[0] * report.window.thin.rotation[2, 2]
        light = views.DrawnLight(ray_fan(report.window), float(focus))
    return views.telescopelet(report.window, report.facts, light, allowances(report.design)).svg()


def lens_detail(report: Report, array: int) -> str:
    """One lens over its cell, enlarged."""
    return views.lens_detail(report.window, report.facts, array, allowances(report.design)).svg()
