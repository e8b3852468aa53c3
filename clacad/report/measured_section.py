"""Sections of the page about a sheet as its process makes it, and about a part as measured."""

from __future__ import annotations

from dataclasses import asdict
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.design.process import Process
from clacad.measuring.form_and_seams import Surface
from clacad.measuring.measured import Measured, iso_rows
from clacad.report.content import data_uri
from clacad.report.report_files import Section

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.making.light_as_made import JudgedAsMade

__all__ = ["made_section", "measured_section"]

SHOWN = 40
"""Most lenslets of the table on the page."""

COLUMNS = ("side", "i", "j", "x", "y", "radius", "u_radius", "conic", "u_conic", "astigmatism", "sq")


def made_section(found: JudgedAsMade) -> Section:
    """The sheet as its process makes it, next to the design."""
    light = found.light
    head = "".join(f"<th>{name}</th>" for name in ("", "designed", "made"))
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td class='num'>{escape(of)}</td>"
        f"<td class='num'>{escape(made)}</td></tr>"
        for name, of, made in light.rows()
    )
    left = {name: value for name, value in asdict(light.process).items() if value != getattr(Process(), name)}
    words = ", ".join(f"{name} {value}" for name, value in left.items() if name != "name") or "nothing"
    advice = "".join(f"<p>{escape(one)}.</p>" for one in found.advice)
    return Section(
        "made",
        "The sheet as made",
        f"<p>Process {escape(light.process.name)} leaves (metres and ratios): {escape(words)}.</p>"
        f"<div class='scroll'><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
        f"{advice}",
    )


def measured_section(found: Measured) -> Section:
    """The part as measured, next to the design."""
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td>{escape(unit)}</td><td class='num'>{escape(of)}</td>"
        f"<td class='num'>{escape(made)}</td></tr>"
        for name, unit, of, made in iso_rows(found)
    )
    names = ("in the terms of ISO 14880", "unit", "design", "measured")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    scales = f"Scale of heights {found.z_scale}, lateral scale {found.lateral_scale}."
    body = [
        f"<p>{escape(found.summary)}. {escape(scales)} Thickness, wedge and sides without a map are"
        f" as designed.</p>",
        f"<div class='scroll'><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>",
    ]
    for name, one in found.sides.items():
        picture = data_uri(_picture(one, found.design.unit_m * 1e9))
        words = (
            f"{name}: measured surface less the design's, in nm; white: not measured, or no whole lenslet."
        )
        body.append(
            f"<figure><img src='{picture}' width='620'"
            f" alt='{escape(words)}'><figcaption>{escape(words)}</figcaption>"
            "</figure>"
        )
    body.append(_lenslets(found))
    return Section("measured", "The part as measured", "\n".join(body))


def _lenslets(found: Measured) -> str:
    """Table of the first lenslets."""
    columns = found.to_columns()
    count = len(columns["i"])
    head = "".join(f"<th>{escape(name)}</th>" for name in COLUMNS)
    rows = "".join(
        "<tr>" + "".join(f"<td class='num'>{_shown(columns[name][k])}</td>" for name in COLUMNS) + "</tr>"
        for k in range(min(count, SHOWN))
    )
    more = f"<p>{count - SHOWN} more in lenslets.csv.</p>" if count > SHOWN else ""
    return (
        f"<details><summary>{count} lenslets</summary><div"
        f" class='scroll'><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div>{more}</details>"
    )


def _shown(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else escape(str(value))


def _picture(one: Surface, nano: float) -> bytes:
    """Deviation map as PNG, its range that of most points."""
    step = max(1, max(one.deviation.shape) // 600)
    map_ = one.deviation[::step, ::step] * nano
    known = map_[np.isfinite(map_)]
    most = float(np.percentile(np.abs(known), 99.0)) if len(known) else 1.0
    size = [
        0.5 * count * pixel for count, pixel in zip(one.measured.shape[::-1], one.measured.pixel, strict=True)
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        image = axes.imshow(
            map_,
            origin="lower",
            cmap="RdBu_r",
            vmin=-most,
            vmax=most,
            extent=(-size[0], size[0], -size[1], size[1]),
        )
        axes.set(xlabel="x of the map", ylabel="y of the map", title=no_formula(one.measured.name))
        figure.colorbar(image, ax=axes, label="deviation / nm")

    return drawn("png", (6.2, 5.2), draw, {"font.size": 8.0})
