"""Facts of a design that the page receives: constants, sliders, presets, and features that it does not show.

The sliders of the explorer: what can be moved, from where to where, and where a design starts.

The design file that the page hands out: the design's own text, with places for what the sliders move.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import asin, atan, atan2, degrees, hypot
from typing import Any

import numpy as np

from clacad.design import Design
from clacad.design.sections import SPECTRA, AimedAt
from clacad.light.compare import paraxial
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH, SEPARATIONS, VIEWING_DISTANCE
from clacad.sheet.like_cell import in_light
from clacad.sheet.plate import Plate
from clacad.sheet.vignetting import aperture_slopes, half_field, thin_cells
from clacad.sheet.window import Window

LAW, SHEET, VIEW = "Law", "Sheet", "View"

FILLS = 0.8
"""Part of the half field that holds the whole sheet at the start, where the design names no eye."""

MARGIN = 1.3
"""Angle of view at the start over the angle the sheet takes."""

SMALLEST_PITCH = 1e-7
"""Metres; finer cells are no matter of rays."""

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Slider:
    """One number that can be moved.

    id : Its name in the page's link.
    start, low, high : Lengths in the design's unit, angles in degrees.
    log : Equal ratios along the slider instead of equal steps.
    about : What it is, one line.
    """

    id: str
    label: str
    group: str
    unit: str
    start: float
    low: float
    high: float
    log: bool
    about: str

    @property
    def step(self) -> float:
        """Of the handle: of a thousand places where ratios are equal, else of 400 in the range, rounded."""
        if self.log:
            return 1.0
        return float(f"{(self.high - self.low) / 400.0:.0e}")


Row = tuple[str, str, str, float, Range, bool, str]
"""Fields of a slider but its group, with its range: id, label, unit, start, (low, high), log, about."""


def sheet_width(window: Window) -> Range:
    """Width and height (lengths) of all cells, including those that an outline cuts off."""
    x0, x1, y0, y1 = window.lattice.with_count(window.lattice.count).extent()
    return x1 - x0, y1 - y0


def places(design: Design, window: Window) -> tuple[tuple[float, float, float], float]:
    """Eye (x, y, z) and distance of what it looks at, lengths, where the page starts.

    Those of [check]; else the viewer that the sheet is aimed at, or the distance from which all of the sheet
    is seen within the field; and ten separations.
    """
    viewer, distance, aimed = design.check.viewer, design.check.object, aim(design)
    eye = (0.0, 0.0, 0.0 if viewer is None else -viewer)
    if viewer is None and aimed is not None and aimed[2] < 0.0:
        eye = aimed
    elif viewer is None:
        reach = min(half_field(thin_cells(window)))
        whole = 0.5 * max(sheet_width(window)) / (FILLS * reach)
        eye = (0.0, 0.0, -float(f"{max(VIEWING_DISTANCE / window.unit, whole):.3g}"))
    return eye, SEPARATIONS * window.thin.separation if distance is None else distance


def aim(design: Design) -> tuple[float, float, float] | None:
    """Point (x, y, z), lengths, at which the sheet is aimed; None where it is not."""
    aperture = design.lattice.aperture
    return aperture.point if isinstance(aperture, AimedAt) else None


def sliders(design: Design, window: Window) -> tuple[Slider, ...]:
    """All sliders of a design, each with a range that holds the design's own value."""
    return tuple(
        Slider(id, label, group, unit, start, min(low, start), max(high, start), log, about)
        for group, rows in (
            (LAW, _of_law(design, window)),
            (SHEET, _of_sheet(design, window)),
            (VIEW, _of_view(design, window)),
        )
        for id, label, unit, start, (low, high), log, about in rows
    )


def _of_law(design: Design, window: Window) -> tuple[Row, ...]:
    """Sliders of the keys of [law], as the file has them."""
    law = design.to_dict()["law"]
    (eta_x, eta_y), (delta_x, delta_y), (phi, theta, psi) = law["eta"], law["delta"], law["euler"]
    reach = max(4.0 * window.lattice.pitch[0] / window.thin.separation, 2.0 * hypot(delta_x, delta_y))
    eta, delta = "−f2/f1: slopes leave as (t − δ)/η", "offset of lens 2 over f1"
    return (
        ("eta_x", "η x", "", eta_x, (-3.0, 3.0), False, eta),
        ("eta_y", "η y", "", eta_y, (-3.0, 3.0), False, eta),
        ("delta_x", "δ x", "", delta_x, (-reach, reach), False, delta),
        ("delta_y", "δ y", "", delta_y, (-reach, reach), False, delta),
        ("phi", "φ", "deg", phi, (-180.0, 180.0), False, "turn of the lenses about z"),
        ("theta", "θ", "deg", theta, (-60.0, 60.0), False, "turn of the lenses about x"),
        ("psi", "ψ", "deg", psi, (-180.0, 180.0), False, "turn of the lenses about z, once more"),
    )


def _of_sheet(design: Design, window: Window) -> tuple[Row, ...]:
    """Sliders of the sheet's lengths."""
    unit, pitch, gap, keeps = (
        design.unit,
        window.lattice.pitch[0],
        window.thin.separation,
        "the sheet keeps its size",
    )
    return (
        ("pitch", "pitch", unit, pitch, _pitches(window), True, f"width of a cell; {keeps}"),
        ("separation", "separation", unit, gap, (gap / 8.0, 8.0 * gap), True, "of the two lenses, in air"),
    )


def _of_view(design: Design, window: Window) -> tuple[Row, ...]:
    """Sliders of the eye and of what it looks at."""
    unit, off, sides = design.unit, "angle of the eye off the sheet's normal", (-60.0, 60.0)
    (x, y, z), far = places(design, window)
    eye = float(hypot(x, y, z))
    beside, above = degrees(atan2(x, -z)), degrees(asin(y / eye))
    fov = float(f"{2.0 * degrees(atan(MARGIN * 0.5 * max(sheet_width(window)) / eye)):.3g}")
    least, behind = min(0.05 * fov, 5.0), (far / 50.0, 50.0 * far)
    return (
        ("object", "object behind", unit, far, behind, True, "from array 2 to what is looked at"),
        ("eye", "eye before", unit, eye, (eye / 20.0, 20.0 * eye), True, "from array 1 to the eye"),
        ("azimuth", "eye aside", "deg", beside, sides, False, f"{off}, to x"),
        ("elevation", "eye above", "deg", above, sides, False, f"{off}, to y"),
        (
            "fov",
            "angle of view",
            "deg",
            min(fov, 120.0),
            (least, 120.0),
            True,
            "of the picture's shorter side",
        ),
    )


def _pitches(window: Window) -> Range:
    """Pitches that leave room for seam and walls, and cells within the outline."""
    lattice, wall = window.lattice, 0.0 if window.baffle is None else window.baffle.wall
    aspect = min(1.0, lattice.pitch[1] / lattice.pitch[0])
    least = max(
        lattice.pitch[0] / 8.0,
        4.0 * max(window.land.seam, wall) / aspect,
        SMALLEST_PITCH / window.unit / aspect,
    )
    most = min(8.0 * lattice.pitch[0], 0.25 * min(sheet_width(window)))
    return min(least, lattice.pitch[0]), max(most, lattice.pitch[0])


MOVED = {
    ("law", "eta"): "eta",
    ("law", "delta"): "delta",
    ("law", "euler"): "euler",
    ("pair", "separation"): "separation",
    ("lattice", "pitch"): "pitch",
    ("lattice", "count"): "count",
    ("check", "viewer"): "viewer",
    ("check", "object"): "object",
}
"""Section and key of the file, and what moves it."""

METRES = ("viewer", "object")
"""Written with their unit, since they must have one."""


def lines(design: Design) -> list[str | dict[str, Any]]:
    """Lines of the canonical text, those that sliders move as dictionaries.

    A moved line has `key` (what moves it), `start` (the line as long as nothing is moved; None: there is
    none), `as` (what precedes its value), `single` (one number, not a list) and `metres` (the value is a text
    in metres). With no slider moved, the result is the canonical text. A slab given by its thickness gets the
    separation it is moved to instead.
    """
    found: list[str | dict[str, Any]] = []
    section, missing = "", list(METRES)
    thick = design.pair.form == "slab" and design.pair.separation is None
    for line in [*design.canonical_toml().splitlines(), ""]:
        if not line and section == "check":
            found += [_moved("check", key, key, None, design) for key in missing]
            section = ""
        if line.startswith("["):
            section = line.strip("[]")
        key = line.partition(" = ")[0]
        name = "separation" if thick and (section, key) == ("pair", "thickness") else key
        what = MOVED.get((section, name))
        if what in missing and what is not None:
            missing.remove(what)
        found.append(line if what is None else _moved(section, name, what, line, design))
    return found[:-1]


def _moved(section: str, key: str, what: str, start: str | None, design: Design) -> dict[str, Any]:
    assert (section, key) in MOVED
    single = what == "pitch" and design.lattice.kind != "rectangular"
    return {"key": what, "as": f"{key} = ", "start": start, "single": single, "metres": what in METRES}


MOST_CELLS = 8192
"""Cells a side beyond which single precision may name the neighbour of a cell near the edge."""

CARD = 0.3
"""Half the side of the card that is looked at, over the shorter side of the sheet."""

_UPRIGHT: Mapping[str, float] = dict.fromkeys(("delta_x", "delta_y", "phi", "theta", "psi"), 0.0)

PRESETS: tuple[tuple[str, Mapping[str, float]], ...] = (
    ("as designed", {}),
    ("negative refraction: η = −1", {**_UPRIGHT, "eta_x": -1.0, "eta_y": -1.0}),
    ("the same with a field lens", {**_UPRIGHT, "eta_x": -1.0, "eta_y": -1.0, "field": 1.0}),
    ("stretched: η = (−1/4, −1)", {**_UPRIGHT, "eta_x": -0.25, "eta_y": -1.0}),
    ("stretched and turned by 45°", {**_UPRIGHT, "eta_x": -0.25, "eta_y": -1.0, "phi": 45.0}),
    ("shifted: δ = (.02, .01)", {**_UPRIGHT, "eta_x": -1.0, "eta_y": -1.0, "delta_x": 0.02, "delta_y": 0.01}),
    ("tilted by 2°", {**_UPRIGHT, "eta_x": -1.0, "eta_y": -1.0, "theta": 2.0}),
    ("Galilean, upright: η = 1/2", {**_UPRIGHT, "eta_x": 0.5, "eta_y": 0.5}),
    ("cylinders: η = (1, −1)", {**_UPRIGHT, "eta_x": 1.0, "eta_y": -1.0}),
    ("seen from aside", {"azimuth": 2.0, "elevation": 1.5}),
)
"""Settings that a visitor may choose, each as what differs from the design."""


def facts(design: Design, window: Window, moved: tuple[Slider, ...]) -> dict[str, Any]:
    """All the page's script needs, as plain JSON; in the design's unit, wavelength and `unitM` in metres."""
    lattice, aperture, aimed = window.lattice, design.lattice.aperture, aim(design)
    return {
        "kind": lattice.kind,
        "form": window.form,
        "pitch": list(lattice.pitch),
        "count": list(lattice.count),
        "outline": _outline(design),
        "seam": window.land.seam,
        "border": window.land.border,
        "opaque": window.land.opaque,
        "given": design.pair.prescription == "given",
        "plate": isinstance(window.outline, Plate),
        "baffle": None if window.baffle is None else window.baffle.wall,
        "aperture": "aligned" if isinstance(aperture, AimedAt) else aperture,
        "aim": aimed,
        "built": _built(window),
        "axes": design.law_spec.euler_axes,
        "field": bool(window.thin.field),
        "index": window.bodies[0].index,
        "colours": colours(window),
        "unitM": window.unit,
        "wavelength": window.wavelength or DEFAULT_WAVELENGTH,
        "card": CARD * min(sheet_width(window)),
        "sliders": [asdict(one) for one in moved],
        "presets": [[name, dict(changes)] for name, changes in PRESETS],
        "toml": lines(design),
    }


def colours(window: Window) -> list[float] | None:
    """Power of the equivalent pair's lenses in red, green and blue over that at the design's wavelength.

    None where the index is not known in the lines "rgb", for a field lens, and for lenses without power.
    Lenses that are stronger by ε, s apart in air, leave C = ε s/(f1 f2): ε follows from C of the real faces.
    """
    lines, thin = tuple(SPECTRA["rgb"]), window.thin
    known = all(body.material and all(map(body.material.knows, lines)) for body in window.bodies)
    power = [thin.separation / (f1 * f2) for f1, f2 in zip(*thin.focal_length, strict=True)]
    axes = [axis for axis in (0, 1) if power[axis] != 0.0]
    if not (known and axes) or thin.field or window.wavelength is None:
        return None
    base, found = paraxial(window), []
    for line in lines:
        other = paraxial(in_light(window, line))
        found.append(1.0 + float(np.mean([(other[k] - base[k])[1, 0] / power[k] for k in axes])))
    return found


def _built(window: Window) -> float:
    """Drift of the cells of array 2 in glass over that of the thin pair, per displacement of cell 1."""
    thin, built = (
        place.scale(window.lattice)[0] - 1.0 for place in (window.thin.second, window.placements[1])
    )
    return built / thin if thin else 1.0


def _outline(design: Design) -> list[Any] | None:
    spec = design.lattice.outline
    if spec is not None and spec.shape == "polygon":
        return ["rectangle", *spec.size]
    return None if spec is None else [spec.shape, *spec.size[: 1 if spec.shape == "circle" else 2]]


def chosen_cell(design: Design, cell: tuple[int, int] | None) -> tuple[Design, tuple[str, ...]]:
    """Design of the uniform sheet of a cell, and a sentence that names the cell and how the others differ.

    cell : (i, j), or None: the middle one; a sheet that is only aimed is then shown as it is.
    Raises BadRequest, DesignError.
    """
    from clacad.exporting.limits import refuse_no_cell
    from clacad.prescription.prescribe import design_of_cell, prescribe

    window = prescribe(design)
    if cell is not None:
        refuse_no_cell(window, cell)
    if window.uniform or (cell is None and window.cell_laws is None and aim(design) is not None):
        return design, ()
    if cell is None:
        cells = window.lattice.cells()
        i, j = cells[int(np.argmin(np.hypot(*window.lattice.centres(cells).T)))].tolist()
        cell = i, j
    like = design_of_cell(design, window, cell)
    words = f"cell {cell[0]},{cell[1]} of {design.name}; the others differ by {_differences(window, cell)}"
    return like, (words, "the common image of its sharp pairs")[: 1 + (design.pair.focus is not None)]


def _differences(window: Window, cell: tuple[int, int]) -> str:
    """Largest differences of the other cells from one cell: angles of their light, δ and η."""
    cells, own, laws = window.lattice.cells(), np.array(cell), window.cell_laws
    light = aperture_slopes(window, cells) - aperture_slopes(window, own)
    found = {"{:.3g}° in the direction of their light": degrees(atan(float(np.hypot(*light.T).max())))}
    if laws is not None:
        delta = laws.deltas(window.lattice, cells) - laws.deltas(window.lattice, own)
        eta = laws.ratios_of(window.lattice, cells) - laws.ratios_of(window.lattice, own)
        found["{:.3g} in δ"] = float(np.hypot(*delta.T).max())
        found["{:.3g} in η"] = float(np.abs(eta).max())
        turns = laws.angles_of(window.lattice, cells) - laws.angles_of(window.lattice, own)
        found["{:.3g}° in their lens axes"] = degrees(float(np.abs(turns).max()))
    return ", ".join(text.format(most) for text, most in found.items() if most > NO_DIFFERENCE) or "nothing"


NO_DIFFERENCE = 1e-12
"""Of directions (degrees), δ and η: rounding error."""


def not_shown(design: Design, window: Window) -> tuple[str, ...]:
    """What of a design the page leaves out, one phrase each."""
    found = [
        f"aberration, reflections, diffraction{'' if colours(window) else ', colour'} and the walls between"
        " cells: its lenses are thin and ideal"
    ]
    if window.form != "biconvex":
        glass = "slab" if window.form == "slab" else "plates" if window.form == "plates" else "plano lenses"
        found.append(f"the glass of the {glass} between the lenses: light crosses the equivalent pair in air")
    if design.pair.prescription == "given":
        found.append(
            "the faces as given: the design file keeps them until the law, the separation or the field lens"
            " is moved, then they follow from these"
        )
    if design.body.frame is not None:
        found.append("the frame")
    if isinstance(window.outline, Plate):
        found.append("the plate's own boundary and holes: cells fill the rectangle round it")
    if design.body.roughness > 0.0 or design.body.slope_rms > 0.0:
        found.append("what rough faces scatter")
    if max(window.lattice.count) > MOST_CELLS:
        found.append(
            f"which of two neighbours a ray meets, for certain, more than {MOST_CELLS // 2} cells from the"
            " middle"
        )
    return tuple(found)
