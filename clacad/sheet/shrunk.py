"""Sheets before a part shrinks, and the inserts that mould its faces.

A process makes part = file × (1 − s) in each axis, about the middle of the sheet in x and y and about a plane
z = constant; z of an insert is counted from the apex plane of its face. A quadric stays a quadric:

    R' = R (1 − s_z)/(1 − s_l)²,   1 + K' = (1 + K) ((1 − s_z)/(1 − s_l))²

from part to file, with s_l along x or y. A file made to compensate the shrinkage is the part over (1 − s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import comb
from typing import Any, cast

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import A4, A6, A8
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, Surface
from clacad.sheet.cell_places import CellPlacement, VertexChange
from clacad.sheet.lattice import Circle, Lattice, Outline, Rectangle
from clacad.sheet.plate import Hole, Plate
from clacad.sheet.window import PLANE, Body, Face, Window

Three = tuple[float, float, float]

STEEL = 2.0
"""Thickness of an insert below its lowest point, over the pitch, at least."""

TURN = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x."""


class CannotShrink(ValueError):
    """A shrinkage that leaves no part, or a sheet that cannot be scaled, bent or turned for it."""

    exit_status = 2


def growth(shrinkage: Sequence[float]) -> Three:
    """Size of a file over that of the part it makes, along x, y and z.

    Raises CannotShrink: A shrinkage of 1 or more, or below −1, leaves no part.
    """
    for axis, value in zip("xyz", shrinkage, strict=True):
        if not -1.0 < value < 1.0:
            raise CannotShrink(
                f"shrinkage of {value:g} along {axis}: it is a part of the length, above -1 and below 1;"
                " .6 % is 0.006"
            )
    x, y, z = (1.0 / (1.0 - value) for value in shrinkage)
    return x, y, z


def grown_surface(surface: Surface, size: Three) -> Surface:
    """Points (x, y, z) of a surface moved to (size_x x, size_y y, size_z z); exact.

    R' = R size_l²/size_z, 1 + K' = (1 + K)(size_l/size_z)², and a term x^i y^j has the factor
    size_z/(size_x^i size_y^j).

    Examples
    --------
    >>> from clacad.optics.surface import Quadric
    >>> from clacad.sheet.shrunk import grown_surface
    >>> grown_surface(Quadric(0.5, 0.5, 0.5), (1.0, 1.0, 0.5)).curvature_x
    0.25
    """
    sx, sy, sz = size
    cx, cy = surface.curvature_x * (sz / sx) / sx, surface.curvature_y * (sz / sy) / sy
    if isinstance(surface, Quadric):
        return Quadric(cx, cy, surface.kappa / sz, surface.side)
    conics = [
        one if ratio == 1.0 else (1.0 + one) * ratio * ratio - 1.0
        for one, ratio in zip((surface.conic_x, surface.conic_y), (sx / sz, sy / sz), strict=True)
    ]
    if isinstance(surface, Biconic):
        return Biconic(cx, cy, conics[0], conics[1], surface.side)
    changed: dict[str, Any] = {
        name: tuple(
            term * sz / (sx ** (order - 2 * k) * sy ** (2 * k))
            for k, term in enumerate(getattr(surface, name))
        )
        for name, order in (("a4", 4), ("a6", 6), ("a8", 8))
    }
    return EvenPolynomial(cx, cy, conics[0], conics[1], side=surface.side, **changed)


def grown_window(window: Window, size: Three, apart: float | None = None) -> Window:
    """The sheet larger by `size` along x, y and z, about the origin.

    apart : Growth of the distances between faces; None: that along z.
    Raises CannotShrink: Different sizes along the axes for cells or lenses that they would deform.
    """
    kx, ky, kz = size
    apart = kz if apart is None else apart
    if size == (1.0, 1.0, 1.0) and apart == 1.0:
        return window
    turned = window.lattice.hexagonal or any(place.turn for place in window.placements)
    if kx != ky and (turned or window.land.seam or window.land.border):
        what = "hexagonal cells, turned arrays and land of one width"
        raise CannotShrink(
            f"{window.name}: {what} take one shrinkage along x and y, not {kx:g} and {ky:g} of growth"
        )
    if not kx == ky == kz and not all(face.untilted and not face.own_axes for face in window.faces):
        raise CannotShrink(f"{window.name}: tilted and turned lenses take one shrinkage along x, y and z")
    widths = {name: kx * getattr(window.land, name) for name in ("seam", "border", "line")}
    land = replace(window.land, **widths)
    bodies = tuple(
        replace(body, front=_grown(body.front, size, apart), back=_grown(body.back, size, apart))
        for body in window.bodies
    )
    return replace(
        window,
        bodies=bodies,
        lattice=_grown_lattice(window.lattice, size),
        placements=tuple(_grown_place(place, size) for place in window.placements),
        land=land,
        baffle=None if window.baffle is None else replace(window.baffle, wall=window.baffle.wall * kx),
        outline=_grown_outline(window.outline, size),
        z_range=(window.z_range[0] * max(kz, apart), window.z_range[1] * max(kz, apart)),
    )


def _grown(face: Face, size: Three, apart: float) -> Face:
    kx, ky, kz = size
    x, y, z = face.vertex
    land, change = face.land, face.change
    return replace(
        face,
        surface=grown_surface(face.surface, size),
        vertex=(x * kx, y * ky, z * apart),
        land=None if land is None else z * apart + (land - z) * kz,
        change=None if change is None else _grown_change(change, size),
        form=None if face.form is None else face.form.grown(*size),
    )


def _grown_change(change: VertexChange, size: Three) -> VertexChange:
    kx, ky, kz = size
    (xx, xy), (yx, yy) = change.gradient
    (sx, sy), (lx, ly) = change.slope, change.climb
    return replace(
        change,
        gradient=((xx, xy * kx / ky), (yx * ky / kx, yy)),
        table=None if change.table is None else change.table * np.array([kx, ky]),
        slope=(sx * kz / kx, sy * kz / ky),
        climb=(lx * kz / kx, ly * kz / ky),
        lift=None if change.lift is None else change.lift * kz,
    )


def _grown_lattice(lattice: Lattice, size: Three) -> Lattice:
    kx, ky, _ = size
    kind = "rectangular" if lattice.kind == "square" and kx != ky else lattice.kind
    pitch = (lattice.pitch[0] * kx, lattice.pitch[1] * ky)
    return replace(lattice, kind=kind, pitch=pitch, outline=_grown_outline(lattice.outline, size))


def _grown_place(place: CellPlacement, size: Three) -> CellPlacement:
    (x, y), pitch = place.shift, place.pitch
    grown = None if pitch is None else (pitch[0] * size[0], pitch[1] * size[1])
    return replace(place, shift=(x * size[0], y * size[1]), pitch=grown)


def _grown_outline(outline: Outline | None, size: Three) -> Outline | None:
    if outline is None or isinstance(outline, Rectangle):
        return None if outline is None else Rectangle(outline.width * size[0], outline.height * size[1])
    if size[0] == size[1]:
        return Circle(outline.diameter * size[0]) if isinstance(outline, Circle) else _sized(outline, size[0])
    what = "round" if isinstance(outline, Circle) else "drawn"
    raise CannotShrink(
        f"a {what} outline is not scaled by {size[0]:g} and {size[1]:g}; use a rectangular one, or one"
        " shrinkage along x and y"
    )


def _sized(plate: Plate, size: float) -> Plate:
    """The plate larger by `size` about the origin."""
    x, y = plate.moved
    return Plate(
        tuple((x * size, y * size, bulge) for x, y, bulge in plate.vertices),
        tuple(Hole(h.x * size, h.y * size, h.diameter * size, h.purpose, h.play * size) for h in plate.holes),
        (x * size, y * size),
        None if plate.pitch is None else (plate.pitch[0] * size, plate.pitch[1] * size),
        plate.turn,
    )


# -- sink ------------------------------------------------------------------------------------------


def bent_window(window: Window, depth: float) -> Window:
    """The sheet with its lenses raised by what they will sink: depth (1 − u²)(1 − v²), over half a cell.

    The curvature takes the square terms, terms of order 4 to 8 the rest; what is left is of order 10.

    Raises CannotShrink: Lenses other than upright quadrics, each alike.
    """
    if not depth:
        return window
    lenses = [face for face in window.faces if face.array is not None]
    if not all(face.untilted and not face.own_axes and isinstance(face.surface, Quadric) for face in lenses):
        raise CannotShrink(f"{window.name}: sink is compensated for upright lenses that are quadrics")
    bodies = tuple(
        replace(body, front=_bent(window, body.front, depth), back=_bent(window, body.back, depth))
        for body in window.bodies
    )
    low, high = window.z_range
    return replace(window, bodies=bodies, z_range=(low - depth, high + depth))


def _bent(window: Window, face: Face, depth: float) -> Face:
    if face.array is None or not isinstance(face.surface, Quadric):
        return face
    hx, hy = np.abs(window.lattice_of(face.array).tile()).max(axis=0).tolist()
    x, y, z = face.vertex
    one = face.surface
    ax, ay = depth / hx**2, depth / hy**2
    before, after = (
        (one.curvature_x, one.curvature_y),
        (one.curvature_x + 2.0 * ax, one.curvature_y + 2.0 * ay),
    )
    if not all(after):
        raise CannotShrink(f"{window.name}: a lens that is flat along one axis once its sink is compensated")
    a4, a6, a8 = (np.subtract(p, q) for p, q in zip(_series(before, one.kappa), _series(after, one.kappa)))
    a4[1] -= depth / (hx * hy) ** 2
    conics = [one.kappa / c - 1.0 for c in after]
    fourth, sixth, eighth = (tuple(terms.tolist()) for terms in (a4, a6, a8))
    bent = EvenPolynomial(
        *after, conics[0], conics[1], cast("A4", fourth), one.side, cast("A6", sixth), cast("A8", eighth)
    )
    return replace(face, surface=bent, vertex=(x, y, z - face.side * depth))


def _series(curvatures: tuple[float, float], kappa: float) -> list[Floats]:
    """Coefficients of orders 4, 6 and 8 of a quadric's height: κ Q²/8, κ² Q³/16, 5 κ³ Q⁴/128."""
    cx, cy = curvatures
    return [
        np.array([factor * comb(n, k) * cx ** (n - k) * cy**k for k in range(n + 1)])
        for n, factor in ((2, kappa / 8.0), (3, kappa**2 / 16.0), (4, 5.0 * kappa**3 / 128.0))
    ]


# -- inserts ---------------------------------------------------------------------------------------


def insert_window(
    window: Window, face: Face, label: str, shrinkage: Sequence[float] = (0.0, 0.0, 0.0)
) -> Window:
    """The steel that moulds one face: a body whose back is the cavity's surface, with its apexes at z = 0.

    Of a back face the cavity is turned by 180 degrees about x. A front face looks the other way: turned to be
    seen from outside and turned as a cavity, it lies as in the sheet. Material is below, where no part is.

    shrinkage : Of the process; none for a sheet that is compensated already.

    Raises CannotShrink: A shrinkage of 1 or more; cells or outlines that cannot be scaled or turned.
    """
    size = growth(shrinkage)
    whole = grown_window(window, size)
    cut = whole.faces[window.number_of(face)]
    cut = replace(
        cut, vertex=(*cut.vertex[:2], 0.0), land=None if cut.land is None else cut.land - cut.vertex[2]
    )
    if face.side > 0:
        cut = cut.seen_from_behind
        placements = whole.placements
    else:
        _refuse_turned(whole)
        cut = _turned(cut).seen_from_behind
        lattice = replace(whole.lattice, outline=_turned_outline(whole.lattice.outline))
        whole = replace(whole, lattice=lattice, outline=_turned_outline(whole.outline))
        placements = tuple(
            replace(place, shift=(place.shift[0], 0.0 - place.shift[1]), turn=0.0 - place.turn)
            for place in whole.placements
        )
    deep = max(window.z_range[1] - window.z_range[0], STEEL * min(window.lattice.pitch)) * size[2]
    steel = Body(Face(PLANE, (0.0, 0.0, -deep)), cut, 1.0, label)
    name = f"{window.name}-{label}"
    alone = replace(whole, bodies=(steel,), placements=placements, baffle=None, form="plano", name=name)
    from clacad.sheet.feasibility import body_range

    return replace(alone, z_range=body_range(alone, steel))


def _turned(face: Face) -> Face:
    """A face turned by 180 degrees about x; its lens is even in y."""
    x, y, z = face.vertex
    rotation = face.rotation if face.untilted else TURN @ face.rotation @ TURN
    return replace(
        face,
        surface=replace(face.surface, side=-face.surface.side),
        vertex=(x, 0.0 - y, 0.0 - z),
        rotation=rotation,
        land=None if face.land is None else 0.0 - face.land,
        change=None if face.change is None else face.change.turned,
        form=None if face.form is None else face.form.grown(1.0, -1.0, -1.0),
    )


def _turned_outline(outline: Outline | None) -> Outline | None:
    """An outline turned by 180 degrees about x."""
    if not isinstance(outline, Plate):
        return outline
    corners = outline.vertices
    # a side keeps its bulge: the mirror image changes its sign, and so does running it backwards
    back = reversed(list(enumerate(corners)))
    vertices = tuple((x, 0.0 - y, corners[k - 1][2]) for k, (x, y, _) in back)
    holes = tuple(replace(one, y=0.0 - one.y) for one in outline.holes)
    return Plate(
        vertices, holes, (outline.moved[0], 0.0 - outline.moved[1]), outline.pitch, 0.0 - outline.turn
    )


def _refuse_turned(window: Window) -> None:
    """Refuse sheets whose cells do not lie on those of the sheet turned about x."""
    if window.lattice.hexagonal and window.lattice.count[1] % 2 == 0:
        raise CannotShrink(
            f"insert: {window.lattice.count[1]} rows of hexagonal cells do not lie on themselves when turned"
            " about x; use an odd number of rows (lattice.count, or --cells)"
        )
