"""Write the explorer page of a design, with the numbers of its first verdict line.

The closed forms of the sheet give those numbers.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Pair2
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH, viewing
from clacad.sheet.lattice import inside_outline
from clacad.sheet.vignetting import (
    aperture_slope,
    focal_ratio,
    ghost_onset,
    half_field,
    partner_share,
    partner_zone,
    share,
    thin_cells,
)
from clacad.sheet.window import Window
from clacad.storage.errors import BadRequest, ExportRefused

if TYPE_CHECKING:
    from clacad.design import Design


GRID = 9
"""Points a side of the sheet over which the share that the eye sees is averaged."""


@dataclass(frozen=True, slots=True)
class FirstVerdict:
    """What an eye may expect of a thin pair.

    share, share_from_eye : 0 … 1. Of the light on a cell, what meets the partner: along the middle of the
        field, and of the light that reaches the eye as a mean over the sheet.
    half_field, ghost_onset : (x, y), slopes in the lens frame
    sharpest_pitch : (x, y), lengths
    advised_pitch : length. The sharpest pitch of the axis that is blurred more.
    """

    share: float
    share_from_eye: float
    half_field: Pair2
    ghost_onset: Pair2
    sharpest_pitch: Pair2
    advised_pitch: float

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self)


def first_verdict(window: Window, eye: tuple[float, float, float], distance: float) -> FirstVerdict:
    """Judge a window as the page does: an aimed sheet by its middle cell, and over the sheet from the eye.

    eye, distance : lengths. The eye (x, y, z), and the distance from the sheet to what it looks at.
    """
    cells = thin_cells(window)
    cells = replace(cells, zone=partner_zone(cells))
    middle = np.array([[*aperture_slope(window), 1.0]])
    sharp = viewing(
        focal_ratio(window.thin),
        (np.inf, np.inf),
        hypot(*eye) * window.unit,
        distance * window.unit,
        window.wavelength or DEFAULT_WAVELENGTH,
    )
    x, y = (pitch / window.unit for pitch in sharp.sharpest)
    return FirstVerdict(
        share=float(share(cells, middle)[0]),
        share_from_eye=share_from_eye(window, eye),
        half_field=half_field(cells),
        ghost_onset=ghost_onset(cells),
        sharpest_pitch=(x, y),
        advised_pitch=sharp.advised / window.unit,
    )


def share_from_eye(window: Window, eye: tuple[float, float, float]) -> float:
    """Mean over the sheet of the share of an eye's (x, y, z) light that meets its partner; lengths."""
    lattice = window.lattice
    wide, tall = lattice.count[0] * lattice.a1[0], lattice.count[1] * lattice.a2[1]
    at = (np.arange(GRID) + 0.5) / GRID - 0.5
    points = np.stack(np.meshgrid(at * wide, at * tall, indexing="ij"), axis=-1).reshape(-1, 2)
    if lattice.outline is not None:
        points = points[inside_outline(lattice.outline, points)]
    if len(points) == 0:
        return 0.0
    directions = np.column_stack([points, np.zeros(len(points))]) - np.array(eye)
    return float(partner_share(window, window.locate(0, *points.T)[0], directions).mean())


HERE = Path(__file__).parent

LARGEST = 400_000
"""Most bytes of a page; a test checks them."""

SECONDS = 0.3
"""Processor seconds a page takes on the reference machine, nearly all of them for templates."""


@dataclass(frozen=True, slots=True)
class Explored:
    """A page that was made.

    Parameters
    ----------
    file : Path
    bytes : int
    written : bool
        False after a dry run.
    verdict : FirstVerdict
        Verdict of the page before a slider is moved.
    not_shown : tuple of str
        What of the design its view leaves out.
    """

    file: Path
    bytes: int
    written: bool
    verdict: FirstVerdict
    not_shown: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "file": str(self.file),
            "bytes": self.bytes,
            "written": self.written,
            "verdict": self.verdict.to_dict(),
            "not_shown": list(self.not_shown),
        }


def explore(
    design: Design,
    out: str | os.PathLike[str],
    overwrite: bool = False,
    *,
    cell: tuple[int, int] | None = None,
    dry_run: bool = False,
) -> Explored:
    """Write one web page with sliders for the numbers of a design: the view through the sheet follows
    them live.

    The page is one file and loads nothing from a network.

    Parameters
    ----------
    design : Design
    out : path
        Ends in .html; its folder is made if missing. The file appears whole or not at all.
    overwrite, dry_run : bool
        Replace a file that is there; make the page and report its size, but write nothing.
    cell : (i, j), optional
        Show the uniform sheet of this cell of a non-uniform sheet; by default of the middle one. A sheet that
        is only aimed is shown as it is.

    Returns
    -------
    Explored

    Raises
    ------
    BadRequest, ExportRefused, CannotWrite
        `out` is no page, or cannot be written.
    LimitRefused, NoSuchLens, DesignError
        The design has too many lenslets, or cannot be built.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> made = clacad.explore(design, "page.html", dry_run=True)
    >>> made.bytes < 1_000_000
    True
    """
    from clacad.explorer.page_facts import chosen_cell, not_shown, places
    from clacad.exporting.limits import refuse_uncountable
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import write_content

    file = Path(out)
    if file.suffix.lower() not in (".html", ".htm"):
        raise BadRequest(f"{file}: the page is one file that ends in .html")
    refuse_uncountable(design)
    design, others = chosen_cell(design, cell)
    window, text = prescribe(design), page(design, others)
    if dry_run and file.exists() and not overwrite:
        raise ExportRefused(f"{file} exists; choose another name, or ask to overwrite")
    if not dry_run:
        write_content(file, text, overwrite=overwrite)
    verdict = first_verdict(window, *places(design, window))
    missing = (*others, *not_shown(design, window))
    return Explored(file, len(text.encode()), not dry_run, verdict, missing)


def page(design: Design, others: tuple[str, ...] = ()) -> str:
    """The page as one HTML text that needs no network; every text of the design is escaped in it.

    others : Which cell of a non-uniform sheet it shows, and how the others differ.
    Raises NoSuchLens, DesignError.
    """
    import json

    from markupsafe import Markup

    from clacad.explorer.page_facts import LAW, PRESETS, SHEET, VIEW, aim, facts, not_shown, sliders
    from clacad.prescription.prescribe import prescribe
    from clacad.report.self_contained import environment, one_script

    window = prescribe(design)
    moved = sliders(design, window)
    script, digest = one_script(HERE / "closed_forms.js", HERE / "explorer.js")
    count, aimed = " × ".join(map(str, window.lattice.count)), aim(design)
    towards = "" if aimed is None else ", aimed at ({:g}, {:g}, {:g}) ".format(*aimed) + design.unit
    return (
        environment(HERE)
        .get_template("page.html.j2")
        .render(
            name=design.name,
            about=(
                f"confocal lenslet array pair, {window.form}, {window.lattice.kind} lattice of {count} cells"
                f"{towards}"
            ),
            facts=json.dumps(facts(design, window, moved), sort_keys=True, allow_nan=False),
            groups=[(name, [one for one in moved if one.group == name]) for name in (LAW, SHEET, VIEW)],
            presets=[name for name, _ in PRESETS],
            others=others,
            not_shown=not_shown(design, window),
            fine=FINE,
            digest=digest,
            script=Markup(script),
            shader=Markup((HERE / "thin_sheet.glsl").read_text(encoding="utf-8")),
        )
    )


FINE = 12
"""Rays a pixel of a still picture, as in explorer.js."""
