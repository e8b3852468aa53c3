"""Figures of the report as SVG text: matplotlib's Figure, no global state, the same bytes every time.

Places of the panels of a figure by fixed margins in inches, since finding them by drawing twice is slow.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.drawn_figure import drawn, inline_svg, no_formula
from clacad.base.text import mrad_text, percent_text
from clacad.light.measure import deviation
from clacad.optics.rays import Fate, Rays
from clacad.sheet.feasibility.as_rows import length_unit
from clacad.sheet.pattern import relocate
from clacad.sheet.window import Window, column, face_height
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from clacad.verification import Report


LETTER = 0.078
"""Mean width of a letter of 9 points (inches)."""


@dataclass(frozen=True)
class Margins:
    """Room about the panels of a figure and between them, inches.

    left, right, bottom, top : From the figure's border to the outer panels.
    across, down : Between panels side by side, and above one another.
    """

    left: float = 0.7
    right: float = 0.2
    bottom: float = 0.46
    top: float = 0.12
    across: float = 0.72
    down: float = 0.24


def panels(
    figure: Figure, rows: int = 1, columns: int = 1, margins: Margins | None = None, **options: Any
) -> Any:
    """Axes of a figure in rows and columns; one alone as such, several as an array.

    options : Of `Figure.subplots`.
    """
    room = Margins() if margins is None else margins
    width, height = figure.get_size_inches()
    wide = (width - room.left - room.right - (columns - 1) * room.across) / columns
    tall = (height - room.bottom - room.top - (rows - 1) * room.down) / rows
    figure.subplots_adjust(
        room.left / width,
        room.bottom / height,
        1.0 - room.right / width,
        1.0 - room.top / height,
        room.across / wide,
        room.down / tall,
    )
    return figure.subplots(rows, columns, **options)


def room_for(words: list[str]) -> float:
    """Inches that the longest of some words takes next to an axis."""
    return 0.16 + LETTER * max(map(len, words), default=0)


INK, ACCENT, SECOND, FAINT, BAD = "#1c2733", "#1b6ca8", "#c2571a", "#8b98a5", "#b3261e"
STYLE = {
    "svg.hashsalt": "clacad",
    "svg.fonttype": "path",
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": "#e3e8ec",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "image.cmap": "viridis",
}
SPOT_RAYS = 300


def svg(width: float, height: float, label: str, draw: Callable[[Figure], None]) -> str:
    """Draw a figure of the given size (inches) and return it as one <svg> element with a description."""
    text = drawn("svg", (width, height), draw, STYLE, creator=None, placed=True).decode()
    text = inline_svg(text)
    # names inside one drawing must not meet those of another drawing on the same page
    mark = re.sub(r"[^a-z]+", "-", label.lower())
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{mark}-", text)
    text = _numbered(text)
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1)


def _numbered(text: str) -> str:
    """Give a name that returns (two equal images have one) a number; what refers to it means the first."""
    seen: dict[str, int] = {}

    def once(match: re.Match[str]) -> str:
        name = match[1]
        seen[name] = seen.get(name, 0) + 1
        return match[0] if seen[name] == 1 else f'id="{name}-{seen[name]}"'

    return re.sub(r'\bid="([^"]+)"', once, text)


def transfer(report: Report) -> str:
    """Exit slope against incident slope along both lens axes, and what is left over."""

    def draw(figure: Figure) -> None:
        room = Margins(top=0.3, down=0.14)
        axes = panels(figure, 2, 2, room, sharex="col", height_ratios=(3, 2))
        for k, (name, curve) in enumerate(zip("xy", report.curves, strict=True)):
            top, bottom = axes[0][k], axes[1][k]
            top.plot(curve.slope, curve.law, color=INK, lw=1.2, label="specified law")
            top.errorbar(
                curve.slope,
                curve.mean,
                yerr=curve.spread,
                fmt=".",
                color=ACCENT,
                ms=4,
                lw=0.8,
                label="traced: mean ± rms",
            )
            top.set_title(f"lens {name}")
            top.set_ylabel("exit slope")
            left = 1e3 * (curve.mean - curve.law)
            bottom.fill_between(
                curve.slope,
                left - 1e3 * curve.spread,
                left + 1e3 * curve.spread,
                color=ACCENT,
                alpha=0.18,
                lw=0,
            )
            bottom.plot(curve.slope, left, color=ACCENT, lw=1.2)
            bottom.axhline(0.0, color=INK, lw=0.8)
            bottom.set_xlabel(f"incident slope, lens {name}")
            bottom.locator_params(axis="x", nbins=5)
            bottom.set_ylabel("traced − law (10⁻³)")
            _shade_field(report, (top, bottom), curve)
        axes[0][0].legend(loc="best")

    return svg(7.6, 4.6, "exit slope against incident slope, traced and specified", draw)


def _shade_field(report: Report, axes: Sequence[Axes], curve: Any) -> None:
    middle = 0.5 * (curve.slope[0] + curve.slope[-1])
    reach = np.tan(report.design.check.field)
    for panel in axes:
        panel.axvspan(middle - reach, middle + reach, color=SECOND, alpha=0.10, lw=0)


def transmission(report: Report) -> str:
    """Share of light through the partner lenslet, and into ghosts, against angle, with the closed form."""

    def draw(figure: Figure) -> None:
        axes = panels(figure, 1, 2, Margins(bottom=0.72, across=0.3), sharey=True)
        for k, (name, curve) in enumerate(zip("xy", report.curves, strict=True)):
            panel = axes[k]
            panel.plot(curve.slope, curve.closed_form, color=INK, lw=1.2, label="closed form, thin lenses")
            panel.plot(curve.slope, curve.alive, ".", color=ACCENT, ms=5, label="traced")
            panel.plot(curve.slope, curve.ghost, color=SECOND, lw=1.2, ls="--", label="ghosts, traced")
            panel.set_xlabel(f"incident slope, lens {name}")
            panel.locator_params(axis="x", nbins=6)
            _shade_field(report, (panel,), curve)
        axes[0].set_ylabel("share of the light")
        axes[0].set_ylim(-0.03, 1.05)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3)

    return svg(7.6, 3.0, "share of light transmitted against angle", draw)


def residual_map(report: Report, label: str = "error over aperture and field") -> str:
    """Error of single rays over aperture and field, along both lens axes; `label` differs on one page."""

    def draw(figure: Figure) -> None:
        axes = panels(figure, 1, 2, Margins(left=0.78, right=0.6, across=1.36))
        pitch = min(report.window.lattice.pitch)
        for panel, name, curve in zip(axes, "xy", report.curves, strict=True):
            error = 1e3 * curve.residual
            known = error[np.isfinite(error)]
            top = float(np.percentile(known, 99)) if len(known) else 1.0
            image = panel.imshow(
                error,
                origin="lower",
                aspect="auto",
                vmin=0.0,
                vmax=top or 1.0,
                interpolation="nearest",
                extent=(
                    curve.place[0] / pitch,
                    curve.place[-1] / pitch,
                    curve.map_slope[0],
                    curve.map_slope[-1],
                ),
            )
            panel.set_xlabel(f"place across the cell, lens {name} (pitches)")
            panel.set_ylabel(f"incident slope, lens {name}")
            panel.locator_params(nbins=6)
            panel.grid(False)
            figure.colorbar(image, ax=panel, label="error (mrad)", shrink=0.9, fraction=0.06, pad=0.03)

    return svg(7.6, 3.0, label, draw)


def spots(report: Report, label: str = "spot diagrams over the field") -> str:
    """Exit directions about the law's, for nine incident directions; `label` differs on one page."""

    def draw(figure: Figure) -> None:
        axes = panels(figure, 3, 3, Margins(across=0.26, down=0.16), sharex=True, sharey=True)
        # the middle of the field in the middle, its rim round it as seen: +x to the right, +y up
        place = ((1, 1), (1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (2, 2))
        points = report.optics.points
        turned = [deviation(point) for point in points]
        reach = max(
            (1e3 * float(np.percentile(np.abs(turn), 99)) for turn in turned if len(turn)), default=1.0
        )
        from matplotlib.patches import Ellipse

        blur = [1e3 * b for b in report.facts.diffraction_blur]
        for k, point in enumerate(points):
            panel = axes[place[k]]
            spot = 1e3 * turned[k][:SPOT_RAYS]
            panel.plot(spot[:, 0], spot[:, 1], ".", ms=1.6, color=ACCENT, mec="none")
            panel.add_patch(Ellipse((0, 0), 2 * blur[0], 2 * blur[1], fill=False, color=SECOND, lw=0.8))
            panel.plot([0], [0], "+", color=INK, ms=6, mew=0.8)
            text = (
                "dark"
                if not len(spot)
                else f"bias {mrad_text(point.bias, 2, unit='')}, rms {mrad_text(point.rms, 2, unit='')}"
            )
            box = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}
            panel.text(
                0.03, 0.95, text, transform=panel.transAxes, va="top", fontsize=7.5, zorder=5, bbox=box
            )
            panel.set_xlim(-1.1 * reach, 1.1 * reach)
            panel.set_ylim(-1.1 * reach, 1.1 * reach)
            panel.set_aspect("equal")
        axes[2][1].set_xlabel("direction error in x (mrad)")
        axes[1][0].set_ylabel("direction error in y (mrad)")

    return svg(5.6, 5.6, label, draw)


def convergence(report: Report) -> str:
    """Error through facets against their number, with the fitted orders."""
    found = report.convergence
    if found is None:
        return ""

    def draw(figure: Figure) -> None:
        left, right = panels(figure, 1, 2, Margins(left=0.36, across=0.5, top=0.3))
        for panel, value, order, label in (
            (left, 1e3 * found.direction, found.order_direction, "direction error, rms (mrad)"),
            (right, 100 * found.fitted, found.order_fitted, "error of measured η (%)"),
        ):
            panel.loglog(found.quads, value, "o-", color=ACCENT, ms=4, lw=1.2)
            panel.set_xlabel("quads along a cell side")
            panel.set_ylabel(label)
            panel.set_title(f"falls as (facet size)^{order:.2f}")
            panel.set_xticks(found.quads, [str(int(q)) for q in found.quads])
            panel.tick_params(axis="y", which="both", left=False, labelleft=False)
            for q, v in zip(found.quads, value, strict=True):
                panel.annotate(f"{v:.2g}", (q, v), xytext=(5, 4), textcoords="offset points", fontsize=8)
            panel.margins(0.15, 0.2)
            panel.minorticks_off()

    return svg(7.6, 2.7, "error against facet size", draw)


def convergence_caption(report: Report) -> str:
    """Numbers of the plot of `convergence`, compared with theory."""
    found = report.convergence
    if found is None:
        return ""
    most, least = 1e3 * found.direction[0], 1e3 * found.direction[-1]
    return (
        f"The same rays through facets of {', '.join(str(int(q)) for q in found.quads)} quads along a cell"
        f" side, against the exact surfaces. Left: the rms direction error falls from {most:.2g} to"
        f" {least:.2g} mrad, as the facet size to the power {found.order_direction:.2f}; a flat facet has the"
        " wrong slope almost everywhere, so the power expected is 1. Right: the error of the measured η"
        f" falls from"
        f" {percent_text(found.fitted[0], 2, unit='')} to {percent_text(found.fitted[-1], 2)}, to the power"
        f" {found.order_fitted:.2f}; the mean slope errs with the square, so 2 is expected."
    )


def budget_rows(report: Report) -> list[tuple[str, float, str]]:
    """Contributions to the direction error: name, radians, what it is."""
    seen, facts = report.optics, report.facts
    rows = [
        (
            "bias (distortion, defocus)",
            float(np.nanmax([p.bias for p in seen.points])),
            "largest mean error of 9 field points",
        ),
        (
            "spread (aberration)",
            float(np.nanmax([p.spread for p in seen.points])),
            "rms about that mean, worst field point",
        ),
        ("design, all together", seen.main.rms, "rms over cell and field, exact surfaces"),
    ]
    for found in report.files:
        if found.mesh is not None:
            rows.append(
                (
                    f"facets of {found.subject.name}",
                    float(np.nanmax(found.mesh.rms)),
                    "rms against the exact surfaces, worst cell",
                )
            )
    rows.append(
        (
            "diffraction",
            max(facts.diffraction_blur),
            "wavelength over the narrower equivalent width that is lit",
        )
    )
    return [row for row in rows if np.isfinite(row[1])]


def budget(report: Report) -> str:
    """Bars of the error budget, on a logarithmic axis."""
    rows = budget_rows(report)[::-1]

    def draw(figure: Figure) -> None:
        panel = panels(figure, margins=Margins(left=room_for([name for name, _, _ in rows])))
        value = np.array([1e3 * max(v, 1e-9) for _, v, _ in rows])
        colour = [SECOND if name == "diffraction" else ACCENT for name, _, _ in rows]
        panel.barh([no_formula(name) for name, _, _ in rows], value, color=colour, height=0.6, left=0.0)
        panel.set_xscale("log")
        panel.set_xlim(max(value.min() * 0.3, 1e-6), value.max() * 4)
        panel.axvline(1e3 * report.design.check.law_rms, color=BAD, lw=1.0, ls="--")
        panel.set_xlabel("mrad (dashed: limit of law_rms)")
        panel.grid(axis="y", visible=False)
        for k, v in enumerate(value):
            panel.text(v * 1.1, k, f"{v:.3g}", va="center", fontsize=8)

    return svg(7.6, 0.9 + 0.28 * len(rows), "error budget", draw)


def section(report: Report, label: str = "cross-section with rays") -> str:
    """Cross-section through the middle of three cells, true to scale, with rays through the middle one."""
    window = report.window
    unit, name = length_unit(window.unit)
    low, high = window.z_range
    tall = 3.2 * window.lattice.pitch[0] / ((high - low) + 1.3 * window.lattice.pitch[0])

    def draw(figure: Figure) -> None:
        draw_section(panels(figure), window, window.unit / unit, name)

    return svg(7.6, min(5.0, max(1.7, 7.0 * tall)), label, draw)


def draw_section(panel: Axes, window: Window, scale: float, name: str) -> None:
    """Draw three cells cut along x with rays through the middle one; lengths times `scale` are in `name`."""
    for body in window.bodies:
        x, front, back = _profile(window, body, window.lattice.pitch[0])
        panel.fill_betweenx(x * scale, front * scale, back * scale, color="#bcd9ee", lw=0.7, ec=ACCENT)
    for ray in ray_fan(window):
        panel.plot(ray[:, 2] * scale, ray[:, 0] * scale, color=SECOND, lw=0.7)
    panel.set_aspect("equal")
    panel.set_xlabel(f"z ({name})")
    panel.set_ylabel(f"x ({name})")
    panel.grid(False)
    panel.locator_params(axis="y", nbins=4)


def _profile(window: Window, body: Any, pitch: float) -> tuple[Any, Any, Any]:
    """Heights of front and back over three cells about the middle of the sheet's frame, y = 0."""
    x = np.linspace(-1.5, 1.5, 901) * pitch * (1 - 1e-9)
    heights = []
    for face in (body.front, body.back):
        shift = (0.0, 0.0) if face.array is None else window.shifts[face.array]
        local, aside = relocate(window.lattice, np.column_stack([x, np.zeros_like(x)]) - shift)[1].T
        if body.columnar:
            front, back = column(window, body, local, aside)
            heights.append(front if face is body.front else back)
        else:
            heights.append(face_height(window, face, local, aside))
    return x, heights[0], heights[1]


def ray_fan(window: Window) -> list[Any]:
    """Five parallel rays along the middle of the field through the middle cell: points (k, 3) each."""
    from clacad.sheet.bundle import middle_direction

    one = window.with_cells((1, 1))
    x = np.linspace(-0.4, 0.4, 5) * window.lattice.pitch[0]
    direction = np.tile(middle_direction(window), (5, 1))
    low, high = window.z_range
    away = 0.15 * (high - low) + 0.5 * window.lattice.pitch[0]
    at = np.column_stack([x, np.zeros((5, 2))])
    start = at + direction * ((low - away) / direction[:, 2:])
    result = trace(one, Rays(start, direction), record=True, path="size")
    found = []
    for k in range(5):
        if result.fate[k] != Fate.ALIVE or result.hits is None:
            continue
        end = result.position[k] + result.direction[k] * (away / result.direction[k, 2])
        found.append(np.vstack([start[k], result.hits[:, k], end]))
    return found
