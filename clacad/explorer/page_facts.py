"""Facts of a design that the page receives: constants, sliders, presets, and features that it does not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from clacad.design import Design
from clacad.design.sections import AimedAt
from clacad.explorer.design_text import lines
from clacad.explorer.sliders import Slider, sheet_width
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.plate import Plate
from clacad.sheet.window import Window

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
    """All that the page's script needs, as plain JSON; lengths in the design's unit, wavelength and `unitM` in metres."""
    need_equal_cells(window, "the page of sliders", "`clacad verify -o` writes a page that shows it")
    lattice, aperture = window.lattice, design.lattice.aperture
    assert not isinstance(aperture, AimedAt)  # a non-uniform sheet
    return {
        "kind": lattice.kind, "form": window.form, "pitch": list(lattice.pitch), "count": list(lattice.count),
        "outline": _outline(design), "seam": window.land.seam, "border": window.land.border, "opaque": window.land.opaque,
        "given": design.pair.prescription == "given", "plate": isinstance(window.outline, Plate), "baffle": None if window.baffle is None else window.baffle.wall,
        "aperture": aperture if isinstance(aperture, str) else list(aperture), "axes": design.law_spec.euler_axes,
        "field": bool(window.thin.field), "index": window.bodies[0].index, "unitM": window.unit, "wavelength": window.wavelength or DEFAULT_WAVELENGTH,
        "card": CARD * min(sheet_width(window)), "sliders": [asdict(one) for one in moved],
        "presets": [[name, dict(changes)] for name, changes in PRESETS], "toml": lines(design),
    }  # fmt: skip


def _outline(design: Design) -> list[Any] | None:
    spec = design.lattice.outline
    if spec is not None and spec.shape == "polygon":
        return ["rectangle", *spec.size]
    return None if spec is None else [spec.shape, *spec.size[: 1 if spec.shape == "circle" else 2]]


def not_shown(design: Design, window: Window) -> tuple[str, ...]:
    """What of a design the page leaves out, one phrase each."""
    found = [
        "aberration, reflections, diffraction, colour and the walls between cells: its lenses are thin and ideal"
    ]
    if window.form != "biconvex":
        glass = "slab" if window.form == "slab" else "plano lenses"
        found.append(
            f"the glass of the {glass} between the lenses: light crosses the pair in air that it stands for"
        )
    if design.pair.prescription == "given":
        found.append(
            "the faces as given: the design file keeps them until the law, the separation or the field lens is moved, then "
            "they follow from these"
        )
    if design.body.frame is not None:
        found.append("the frame")
    if isinstance(window.outline, Plate):
        found.append("the plate's own boundary and holes: cells fill the rectangle round it")
    if design.body.roughness > 0.0 or design.body.slope_rms > 0.0:
        found.append("what rough faces scatter")
    if max(window.lattice.count) > MOST_CELLS:
        found.append(
            f"which of two neighbours a ray meets, for certain, more than {MOST_CELLS // 2} cells from the middle"
        )
    return tuple(found)
