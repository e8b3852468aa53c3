"""Figures of the measurements of a report in addition to its checks: foci, caustics, ghosts, errors,
accuracy, effects.

The non-uniform sheet on the report's page: δ, η and steps of its cells, the worst ones, light of the object
point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.checks.light_kinds import LAW_RMS, THROUGHPUT
from clacad.imaging.image_by_rays import RungImage, heights, image, reach_of, spot_at
from clacad.report.figures import ACCENT, BAD, FAINT, INK, SECOND, Margins, panels, room_for, svg
from clacad.sheet.cell_heights import greatest_steps
from clacad.verification.light.error_attribution import NAMES
from clacad.verification.light.special_checks import IMAGE_RAYS as RAYS
from clacad.verification.light.special_checks import asked_image
from clacad.verification.light.viewed import share_map, viewer_of
from clacad.verification.light.viewed import viewed as seen_from

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from clacad.sheet.window import Window
    from clacad.verification import Report
    from clacad.verification.evidence import Evidence, Fan, MeridianFocus
    from clacad.verification.light.error_attribution import Attribution


GREEN = "#2b7a4b"
SHADES = (ACCENT, "#5b9bd5", FAINT, SECOND, "#8a6fb0")
"""Colours of the five parts of the error, in the order of `NAMES`."""


VIEWED_RAYS = 4096
"""Rays that the picture of the sheet shows."""


def foci(report: Report, evidence: Evidence) -> str:
    """Parallel light of either side between the lenses, both meridians, and its caustics about the foci."""
    found = evidence.foci
    if found is None:
        return ""
    mm = millimetres(report.window.unit)

    def draw(figure: Figure) -> None:
        room = Margins(left=0.72, bottom=0.72, top=0.3, across=0.62, down=0.76)
        axes = panels(figure, 2, 2, room, width_ratios=(3, 2))
        for row, (name, focus) in enumerate(zip("xy", found, strict=True)):
            _overview(axes[row][0], focus, mm, name)
            _close_up(axes[row][1], focus, mm)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=2)

    return svg(7.6, 4.8, "foci and caustics of both lenses in both meridians", draw)


def waves(evidence: Evidence) -> str:
    """Far field of one telescopelet as waves and as rays; nothing where no effect calls for waves."""
    found = evidence.waves
    if found is None:
        return ""
    from clacad.waves.wave_report import axis

    def draw(figure: Figure) -> None:
        for k, panel in enumerate(panels(figure, 1, 2, Margins(bottom=0.6))):
            axis(panel, found, k)

    return svg(7.6, 2.9, "far field of one telescopelet as waves and as rays", draw)


def _overview(panel: Any, focus: MeridianFocus, mm: float, name: str) -> None:
    """Draw the fans of rays of both lenses from lens to lens, in one meridian."""
    reach = focus.distance
    low, high = 0.0, reach
    for fan in (focus.lens1, focus.lens2):
        if np.isfinite(fan.focus[0]):
            low, high = min(low, fan.focus[0]), max(high, fan.focus[0])
    low, high = max(low - 0.03 * reach, -2.0 * reach), min(high + 0.03 * reach, 3.0 * reach)
    for fan, colour, ends, label in (
        (focus.lens1, ACCENT, (0.0, high), "light through lens 1"),
        (focus.lens2, SECOND, (low, reach), "light through lens 2, sent backwards"),
    ):
        _rays(panel, fan, ends, mm, colour, 6, label)
    for place, words in ((0.0, "lens 1"), (reach, "lens 2")):
        panel.axvline(place * mm, color=FAINT, lw=1.0, ls=":")
        panel.annotate(
            words,
            (place * mm, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(2, -9),
            textcoords="offset points",
            fontsize=7.5,
            color=INK,
        )
    gap = focus.gap / focus.distance
    panel.set_title(
        f"lens {name}: foci {abs(gap):.2g} of the distance apart"
        if np.isfinite(gap)
        else f"lens {name}: no power in this meridian"
    )
    panel.set_xlabel("along the axis from lens 1 (mm)")
    panel.set_ylabel(f"across, lens {name} (mm)")
    panel.locator_params(nbins=6)


def _rays(
    panel: Any, fan: Fan, ends: tuple[float, float], mm: float, colour: str, step: int, label: str
) -> None:
    shown = np.flatnonzero(np.isfinite(fan.slope))[::step]
    along = np.array(ends)
    for k in shown:
        panel.plot(
            along * mm,
            (fan.place[k] + fan.slope[k] * along) * mm,
            color=colour,
            lw=0.6,
            alpha=0.75,
            label=label if k == shown[0] else None,
        )


def _close_up(panel: Any, focus: MeridianFocus, mm: float) -> None:
    """Draw foci and caustics of both lenses enlarged, or a note that there is no focus."""
    known = [fan for fan in (focus.lens1, focus.lens2) if np.isfinite(fan.focus).all()]
    if not known:
        panel.set_axis_off()
        panel.text(0.5, 0.5, "no focus", ha="center", va="center", transform=panel.transAxes)
        return
    points = np.concatenate([np.vstack([fan.focus, fan.caustic]) for fan in known])
    middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
    half = max(0.75 * float(np.ptp(points[:, 0])), 1e-3 * focus.distance)
    ends = (middle - half, middle + half)
    aside = known[0].focus[1]
    for fan, colour in ((focus.lens1, ACCENT), (focus.lens2, SECOND)):
        if not np.isfinite(fan.focus).all():
            continue
        _rays(panel, fan, ends, mm, colour, 2, "")
        panel.plot(fan.caustic[:, 0] * mm, fan.caustic[:, 1] * mm, color=colour, lw=1.8)
        panel.plot([fan.focus[0] * mm], [fan.focus[1] * mm], "o", ms=4, mfc="white", mec=colour, mew=1.2)
    tall = max(float(np.abs(points[:, 1] - aside).max()), 1e-9) * 1.5
    panel.set_xlim(ends[0] * mm, ends[1] * mm)
    panel.set_ylim((aside - tall) * mm, (aside + tall) * mm)
    panel.set_title("the foci, enlarged")
    panel.set_xlabel("along the axis (mm)")
    panel.ticklabel_format(useOffset=False)
    panel.locator_params(axis="x", nbins=4)
    panel.locator_params(axis="y", nbins=4)


def ghosts(evidence: Evidence) -> str:
    """Maps over both incident slopes: through the partner as traced and in closed form, and as ghosts."""
    found = evidence.ghosts

    def draw(figure: Figure) -> None:
        axes = panels(figure, 1, 3, Margins(top=0.3, across=0.36, right=0.66), sharey=True)
        sx, sy = found.slope
        box = (sx[0], sx[-1], sy[0], sy[-1])
        image: Any = None
        for panel, values, title in zip(
            axes,
            (found.alive, found.closed_form, found.ghost),
            ("traced, through the partner", "closed form, thin lenses", "traced, ghosts"),
            strict=True,
        ):
            image = panel.imshow(
                values, origin="lower", extent=box, aspect="auto", vmin=0.0, vmax=1.0, interpolation="nearest"
            )
            panel.set_title(title, fontsize=8.5)
            panel.set_xlabel("incident slope, lens x")
            panel.grid(False)
            panel.locator_params(nbins=5)
        axes[0].set_ylabel("incident slope, lens y")
        figure.colorbar(image, ax=axes, label="share of the light", shrink=0.9, fraction=0.025, pad=0.02)

    return svg(7.6, 2.9, "share of the light over two incident slopes, partner, closed form and ghosts", draw)


def viewed(report: Report, window: Window) -> str:
    """Share of one eye's light that obeys the law, over the sheet: ideal lenses, and the traced rays."""
    viewer = viewer_of(report.design)
    values, (x0, x1, y0, y1) = share_map(window, viewer)
    rays = seen_from(window, viewer, VIEWED_RAYS)
    mm = window.unit * 1e3

    def draw(figure: Figure) -> None:
        left, right = panels(figure, 1, 2, Margins(top=0.3, across=0.36, right=0.66), sharey=True)
        box = (x0 * mm, x1 * mm, y0 * mm, y1 * mm)
        image = left.imshow(
            values, origin="lower", extent=box, aspect="equal", vmin=0.0, vmax=1.0, interpolation="nearest"
        )
        left.set_title("closed form, thin lenses", fontsize=8.5)
        for alive, colour, label in ((False, FAINT, "other lenslets"), (True, ACCENT, "obeys the law")):
            x, y = rays.position[rays.alive == alive].T * mm
            right.plot(x, y, ".", ms=1.5, color=colour, label=label, rasterized=True)
        right.set_title("traced rays", fontsize=8.5)
        right.set_aspect("equal")
        right.legend(loc="upper right", markerscale=5, frameon=True, framealpha=0.9, edgecolor="none")
        left.set_ylabel("y on the sheet (mm)")
        for panel in (left, right):
            panel.set_xlabel("x on the sheet (mm)")
            panel.grid(False)
        both = [left, right]
        figure.colorbar(image, ax=both, label="share of the light", shrink=0.9, fraction=0.025, pad=0.02)

    return svg(7.6, 3.6, "share of the light of an eye that obeys the law, over the sheet", draw)


def parts_of_error(found: Attribution, limit: float) -> str:
    """Five bars of the error, each alone, and one bar of what they add up to."""

    def draw(figure: Figure) -> None:
        margins = Margins(left=room_for(list(NAMES)), down=0.56)
        top, bottom = panels(figure, 2, 1, margins, height_ratios=(3.2, 1))
        alone = np.array([max(1e3 * p.rms, 1e-15) for p in found.parts])[::-1]
        top.barh(NAMES[::-1], alone, color=SHADES[::-1], height=0.62)
        top.set_xscale("log")
        top.set_xlim(min(1e-3, max(alone.min() * 0.2, 1e-15)), max(alone.max(), 1e3 * limit) * 12)
        top.axvline(1e3 * limit, color=BAD, lw=1.0, ls="--")
        for k, value in enumerate(alone):
            room = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
            top.text(value * 1.35, k, f"{value:.3g}", va="center", fontsize=8, bbox=room)
        top.set_xlabel("rms alone, mrad, logarithmic (dashed: limit of law_rms)")
        top.grid(axis="y", visible=False)
        _stack(bottom, found)

    return svg(7.6, 3.6, f"error separated into five parts: {found.about[:40]}", draw)


def _stack(panel: Any, found: Attribution) -> None:
    right = left = 0.0
    for part, colour in zip(found.parts, SHADES, strict=True):
        share = 1e3 * part.share
        panel.barh(
            [0], [share], left=right if share >= 0 else left, color=colour, height=0.55, label=part.name
        )
        right, left = (right + share, left) if share >= 0 else (right, left + share)
    panel.axvline(1e3 * found.rms, color=INK, lw=1.0)
    panel.set_yticks([0], ["shares"])
    panel.set_xlabel(f"shares, mrad: they add up to the whole, {mrad_text(found.rms, unit='')} (line)")
    panel.grid(axis="y", visible=False)


def accuracy(report: Report, evidence: Evidence, timings: bool) -> str:
    """Error against time over the rungs, log–log."""
    from clacad.verification.accuracy.accuracy_plot import label_points

    ladder = evidence.ladder
    style = {"law": (FAINT, "D"), "thin": ("#b07aa1", "s"), "surfaces": (GREEN, "*"), "mesh": (SECOND, "o")}

    def draw(figure: Figure) -> None:
        panel = panels(figure)
        labels = []
        for row, us in zip(ladder.rows, ladder.forecast, strict=True):
            if not (np.isfinite(row.model_rms) and row.model_rms > 0.0):
                continue
            time = 1e6 * row.seconds / row.rays if timings else us
            colour, marker = style[row.rung]
            fill, size = "white" if row.normals == "vertex" else colour, 9 if marker == "*" else 6
            panel.loglog([time], [1e3 * row.model_rms], marker, color=colour, ms=size, mfc=fill)
            words = row.rung if row.quads is None else f"{row.quads}"
            labels.append((words, (time, 1e3 * row.model_rms)))
        limit = 1e3 * report.design.check.law_rms
        panel.axhline(limit, color=BAD, lw=0.9, ls="--")
        panel.set_xlabel("microseconds a ray, " + ("measured in this run" if timings else "forecast"))
        panel.set_ylabel("rms direction error to the exact trace (mrad)")
        panel.margins(0.14, 0.12)
        _name_limit(panel, limit, [point for _, point in labels])
        label_points(panel, labels)
        from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        panel.xaxis.set_major_formatter(ScalarFormatter())
        panel.xaxis.set_minor_formatter(NullFormatter())

    return svg(7.6, 3.6, "accuracy against time over the rungs", draw)


def _name_limit(panel: Any, limit: float, points: Sequence[tuple[float, float]]) -> None:
    """Write the name of the limit over its line, where the points near the line leave most room."""
    low, high = np.log(panel.get_xlim())
    near = [(np.log(x) - low) / (high - low) for x, y in points if abs(np.log10(y / limit)) < NEAR]
    room = {at: min((abs(one - at) for one in near), default=1.0) for at in (0.91, 0.5, 0.09)}
    place = {"xycoords": ("axes fraction", "data"), "xytext": (0, 3), "textcoords": "offset points"}
    at = max(room, key=lambda one: room[one])
    panel.annotate("limit of law_rms", (at, limit), **place, ha="center", fontsize=8, color=BAD)


NEAR = 1.5
"""Decades of error within which a point is near the line of the limit."""

ROUNDING = 1e-6
"""Steps (micrometres) that are none."""

ACROSS = 400
"""Pixels along the longer side of a map."""


def varying(report: Report, window: Window) -> str:
    """Maps of δ and steps of cells, the worst ones ringed, light of the object point through focus; "" for a
    uniform sheet.
    """
    laws = window.cell_laws
    if laws is None:
        return ""
    mm = window.unit * 1e3
    maps = _maps(window)
    asked = asked_image(report.design)
    seen = None if asked is None else image(window, asked[0], ("surfaces",), RAYS).rungs[0]
    x0, x1, y0, y1 = (v * mm for v in window.lattice.extent())
    box = x0, x1, y0, y1
    last = "the light of the requested point through focus" if laws.ratios is None else "eta of each cell"

    def draw(figure: Figure) -> None:
        room = Margins(left=0.75, bottom=0.62, top=0.3, across=1.35, down=0.75, right=0.85)
        axes = panels(figure, 2, 2, room).ravel()
        most = max(float(np.nanmax(np.abs(maps[:2]))), 1e-300)
        for k, axis in enumerate("xy"):
            _map(axes[k], maps[k], box, f"delta {axis}", cmap="RdBu_r", vmin=-most, vmax=most)
        high = 1e3 * mm * maps[2]
        top = float(np.nanmax(high)) if np.nanmax(high) > ROUNDING else 1.0
        title = "greatest step to the next cell (\N{MICRO SIGN}m)"
        _map(axes[2], high, box, title, cmap="viridis", vmin=0.0, vmax=top)
        own_eta = laws.ratios is not None
        if own_eta:
            title = "eta x" if laws.ratios is not None and laws.ratios.ndim == 3 else "eta"
            _map(axes[3], maps[3], box, title, cmap="viridis")
        for panel in axes[: 3 + own_eta]:
            panel.grid(False)
            panel.set_xlabel("x on the sheet (mm)")
            panel.set_ylabel("y on the sheet (mm)")
        if words := _named_cells(axes[2], report, window, mm):
            axes[2].set_xlabel(f"x on the sheet (mm)\nringed, the worst: {words}")
        if seen is not None and np.isfinite(seen.found.point).all():
            _through_focus(axes[3], seen, mm)
        elif not own_eta:
            axes[3].set_axis_off()

    return svg(7.6, 6.0, f"delta of each cell, steps between cells, and {last}", draw)


def _map(
    panel: Axes, values: Floats, box: tuple[float, float, float, float], title: str, **colours: Any
) -> None:
    """Draw a map as it lies on the sheet, with its title and the bar of its colours."""
    shown = panel.imshow(
        values, extent=box, origin="lower", interpolation="nearest", aspect="equal", **colours
    )
    panel.set_title(title, fontsize=8.5)
    panel.figure.colorbar(shown, ax=panel, fraction=0.05, pad=0.03)


def _maps(window: Window) -> Floats:
    """δ_x, δ_y, greatest step (length) and η_x at points over the sheet, (4, h, w); NaN without a cell."""
    assert window.cell_laws is not None  # who calls this has looked
    x0, x1, y0, y1 = window.lattice.extent()
    pixel = max(x1 - x0, y1 - y0) / ACROSS
    width, height = (max(1, round((b - a) / pixel)) for a, b in ((x0, x1), (y0, y1)))
    x = np.linspace(x0, x1, width, endpoint=False) + 0.5 * (x1 - x0) / width
    y = np.linspace(y0, y1, height, endpoint=False) + 0.5 * (y1 - y0) / height
    across, up = (v.ravel() for v in np.meshgrid(x, y))
    index, _, _ = window.locate(0, across, up)
    cells, which = np.unique(index, axis=0, return_inverse=True)
    kept = window.lattice.contains(cells)
    found = np.full((4, len(cells)), np.nan)
    found[:2, kept] = window.cell_laws.deltas(window.lattice, cells[kept]).T
    steps = [greatest_steps(window, face, cells[kept]) for face in window.faces if face.array is not None]
    found[2, kept] = np.max(steps, axis=0)
    found[3, kept] = window.cell_laws.ratios_of(window.lattice, cells[kept])[:, 0]
    return found[:, which.ravel()].reshape(4, height, width)


def _named_cells(panel: Any, report: Report, window: Window, mm: float) -> str:
    """Ring the cells that checks of light name as the worst, with their names."""
    named: dict[tuple[int, int], list[str]] = {}
    for check in report.checks:
        cell = (check.detail or {}).get("cell")
        if cell is not None and check.where == "surfaces" and check.kind in (LAW_RMS, THROUGHPUT):
            named.setdefault((int(cell[0]), int(cell[1])), []).append(check.id)
    for cell in named:
        x, y = window.lattice.centres(np.array(cell)) * mm
        panel.plot(
            [x], [y], "o", ms=9, mfc="none", mec="#d62728", mew=1.4, clip_on=False, scalex=False, scaley=False
        )
    return "; ".join(f"cell {cell} by {', '.join(ids)}" for cell, ids in named.items())


def _through_focus(panel: Any, seen: RungImage, mm: float) -> None:
    """Rms width in x and y at heights about the image."""
    z = heights(seen, reach_of(seen))
    widths = np.array(
        [spot_at(seen.position, seen.direction, np.array([*seen.found.point[:2], h])) for h in z]
    )
    for k, colour, line in ((0, ACCENT, "-"), (1, SECOND, "--")):
        panel.plot(z * mm, widths[:, k] * mm, line, color=colour, lw=1.0, label=f"rms in {'xy'[k]}")
    panel.axvline(seen.predicted.point[2] * mm, color="#888888", lw=0.6, ls="--")
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("height (mm; dashed: by the law)")
    panel.set_title("light of the requested point (mm)", fontsize=8.5)
    panel.legend(fontsize=7)
