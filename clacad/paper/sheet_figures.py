"""Figures of sheets beyond the paper: non-uniform sheets and field lenses.

Figures of non-uniform sheets, beyond the paper's: aimed at an eye, imaging, magnifying, shaping a beam.

Expected numbers are closed forms of thin lenses. A ray from the eye (0, 0, −D) through x of the sheet has the
slope t = x/D. The sheet's lenses are a distance s apart, its body is T thick. The ray leaves with t' = (t − κ
C)/η, C the centre of its cell, at x' = x + s t, and meets a screen in z at x' + (z − T) t'. Where cells are
not aimed at the eye their light fills one side only. Light through corresponding lenslets then arrives, on
average, s t/2 from C, and leaves as far on the other side of C + s t.

A window off its axis, with and without a field lens: the light that obeys the law, and the ghosts.

window-100mm (η = −1) is seen from 20 m, so all its rays have nearly one slope t. With ideal lenses a share
1 − |t| s/p of them finds its partner; the others leave with slopes that differ by p/f2. With a field lens at
the common focus all do, up to t = p/s.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.optics.rays import Fate, Rays
from clacad.paper.paper_figures import RAYS, AtlasFinding, Figure, Loader
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, rays
from clacad.rendering.picture import Picture, view_through
from clacad.rendering.screen_measure import WIDE, coordinate_scene, measure, sheet_points
from clacad.rendering.sheet_passage import geometry_alone
from clacad.scene import Scene
from clacad.sheet.vignetting import partner_share
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder

if TYPE_CHECKING:
    from clacad.imaging.shape import Rendered


NEAR, FAR, FARTHER, FOCAL = 400.0, 1500.0, 2000.0, 200.0
"""Distances of the eye from window, glens and moiré magnifier; of the glens's image of parallel light, mm."""

SHAPED_CELLS, SHAPED_DISTANCE, SHAPED_WIDTH = (60, 60), 500.0, 40.0
"""Cells of the beam-shaping sheet, distance of the screen and width of its picture, mm."""

SHAPED_RAYS = 200_000


def _window(load: Loader) -> Iterator[AtlasFinding]:
    """The eye's light through corresponding lenslets, before and after the cells of array 2 are aimed."""
    for stem, label in (("window-400mm", "not aimed"), ("window-400mm-aimed", "aimed")):
        scene = load(stem)
        found = measure(scene, 200.0, RAYS, compiled=True)
        yield AtlasFinding(
            f"{label}: share of the eye's light through corresponding lenslets",
            found.direct,
            _share(scene),
            0.02,
        )
        if label == "aimed":
            for axis, name in ((0, "x"), (1, "y")):
                body = prescribe(scene.design())
                expected = 1.0 + (body.thin.separation - (200.0 - _thickness(body))) / NEAR
                yield AtlasFinding(
                    f"aimed, z = 200: 1/stretch in {name}", float(found.matrix[axis, axis]), expected, 0.01
                )


def _share(scene: Scene) -> float:
    """Mean share, over the sheet, of the camera's light that thin lenses transmit, closed form."""
    window = prescribe(scene.design())
    plain = coordinate_scene(scene, 1.0, RAYS)
    x0, inside = sheet_points(plain, window, (plain.camera.pixels[1], plain.camera.pixels[0]))
    view = aim(plain.camera)
    _, direction = rays(view, np.arange(len(x0)), np.full((len(x0), 1, 4), 0.5))
    index, _, _ = window.lattice.locate(*(x0[inside] * (scene.unit_m / window.unit)).T)
    return float(partner_share(window, index, direction[inside]).mean())


def _glens(load: Loader) -> Iterator[AtlasFinding]:
    """The map from the glens to screens behind it, by exact surfaces and by its law."""
    cells, smooth = load("glens-knight"), load("glens-knight-law")
    window = prescribe(cells.design())
    middle = (
        1.0 - 0.5 * window.thin.separation / FAR
    )  # of the cell, relative to where its light comes through
    for z in (100.0, 300.0):
        real = 1.0 - (z - _thickness(window)) * (1.0 / FAR + middle / FOCAL)
        ideal = 1.0 - z * (1.0 / FAR + 1.0 / FOCAL)
        for scene, label, expected, slack in (
            (cells, "cells, exact surfaces", real, 0.04),
            (smooth, "smooth law", ideal, 1e-9),
        ):
            found = measure(scene, z, RAYS, compiled=True).matrix
            for axis, name in ((0, "x"), (1, "y")):
                yield AtlasFinding(
                    f"{label}, z = {z:g}: 1/stretch in {name}", float(found[axis, axis]), expected, slack
                )


def _thickness(window: Window) -> float:
    """Height of the last face over the first, at their vertices, lengths."""
    faces = window.faces
    return float(faces[-1].vertex[2] - faces[0].vertex[2])


def _moire(load: Loader) -> Iterator[AtlasFinding]:
    """Apparent distance of the lenses of the moiré magnifier, seen by the eye."""
    scene = load("moire-magnifier")
    window = prescribe(scene.design())
    first, second = window.lattice.pitch[0], window.lattice_of(1).pitch[0]
    expected = second / (1.0 + window.thin.separation / FARTHER - second / first)
    for axis, name in ((0, "x"), (1, "y")):
        found = _period(scene, axis)
        yield AtlasFinding(f"period of the lenses in {name}, mm", found, expected, 0.02 * expected)


def _period(scene: Scene, axis: int) -> float:
    """Length on the sheet over which light changes by one order, from a line through the rays' orders."""
    from clacad.tracing.trace import trace

    window = prescribe(scene.design())
    x0, x1 = window.lattice.extent()[2 * axis : 2 * axis + 2]
    across = np.linspace(0.95 * x0, 0.95 * x1, 8 * RAYS)
    place = np.zeros((len(across), 3))
    place[:, axis] = across
    eye = np.array([0.0, 0.0, -FARTHER])
    result = trace(window, Rays(np.broadcast_to(eye, place.shape).copy(), place - eye), path="numpy")
    through = result.fate <= Fate.GHOST
    line: Floats = np.polyfit(across[through], result.order[through, axis].astype(np.float64), 1)
    return abs(1.0 / float(line[0]))


@cache
def _shaped() -> Rendered:
    """Parallel light traced through a sheet of cells that direct it into the outline of a knight."""
    from clacad.design import Design, load
    from clacad.design.asked_cells import lattice_of
    from clacad.imaging.shape import rendered, shaped, table_text
    from clacad.imaging.target import of_picture

    data = {
        "format": 1,
        "name": "shaped",
        "unit": "mm",
        "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "slab", "separation": 10, "material": "PMMA", "wavelength": 550},
        "lattice": {"pitch": 0.5, "count": list(SHAPED_CELLS)},
        "check": {"process": "none"},
    }
    design = Design.from_dict(data)
    found = shaped(design, lattice_of(design), of_picture(_silhouette(), SHAPED_WIDTH), SHAPED_DISTANCE)
    with scratch_folder() as folder:
        (folder / "cells.csv").write_text(table_text(found), encoding="ascii", newline="\n")
        text = (
            Design.from_dict(data)
            .canonical_toml()
            .replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n')
        )
        (folder / "design.toml").write_text(text, encoding="utf-8", newline="\n")
        window = prescribe(load(folder / "design.toml"))
    return rendered(window, found, SHAPED_DISTANCE, SHAPED_RAYS)


def _silhouette(pixels: int = 48) -> Floats:
    """The outline of the chess knight as a picture (h, w) of 0 and 1, by the even-odd rule."""
    from clacad.scene.chess_knight import PROFILE

    low, high = PROFILE.min(axis=0), PROFILE.max(axis=0)
    step = (high[1] - low[1]) / pixels
    x = np.arange(low[0] + 0.5 * step, high[0], step)
    y = high[1] - (np.arange(pixels) + 0.5) * step
    across, up = (one.ravel() for one in np.meshgrid(x, y))
    inside = np.zeros(across.shape, dtype=bool)
    for (ax, ay), (bx, by) in zip(PROFILE, np.roll(PROFILE, -1, axis=0), strict=True):
        if ay != by:
            inside ^= ((ay > up) != (by > up)) & (across < ax + (up - ay) * (bx - ax) / (by - ay))
    return inside.reshape(len(y), len(x)).astype(np.float64)


def _shaped_picture() -> bytes:
    from clacad.imaging.shape import plot_png

    return plot_png(_shaped(), "parallel light shaped into a knight", "mm")


def _beam(load: Loader) -> Iterator[AtlasFinding]:
    """Share of the light that reaches its target."""
    seen = _shaped()
    yield AtlasFinding("shaped beam: light within one blur of its target", seen.within, 1.0, 0.2)
    yield AtlasFinding("shaped beam: light through corresponding lenslets", seen.through, 1.0, 0.05)


DIFFERING: tuple[Figure, ...] = (
    Figure(
        "V1",
        "A window for one eye",
        "The 100 mm window from 400 mm. Of a sheet made for an eye at infinity most of the light "
        "meets other lenslets than the partner; aimed at the eye, all of it obeys the law.",
        (("window-400mm", "not aimed"), ("window-400mm-aimed", "aimed at the eye")),
        _window,
    ),
    Figure(
        "V2",
        "A glens",
        "f = 200 mm with eta = -1: cells that differ by the place of lens 2 image like a lens that has both"
        " foci on one side; next to it the smooth law.",
        (("glens-knight", "cells, exact surfaces"), ("glens-knight-law", "smooth law")),
        _glens,
    ),
    Figure(
        "V3",
        "A moiré magnifier",
        "Arrays of two pitches, 0.5 and 0.49 mm, make a lattice of lenses, each of many lenslets; behind it"
        " three knights, and each is seen by a lens of its own.",
        (("moire-magnifier", "pitch 0.5 and 0.49 mm"),),
        _moire,
    ),
    Figure(
        "V4",
        "A shaped beam",
        "A table of cells sends parallel light into the outline of a knight, 500 mm behind the sheet.",
        (),
        _beam,
        drawn=(("shaped-beam", "specified; by rays through the sheet; the difference", _shaped_picture),),
    ),
)
"""Figures of non-uniform sheets."""


ANGLES = (0.0, 1.5, 2.5)
"""Degrees off the sheet's normal at which the window is viewed."""

SIDE, PITCH, SEPARATION, BEHIND = 100.0, 0.5, 10.0, 300.0
"""Sizes of window-100mm, and the distance of the piece in its pictures, mm."""

MARK = np.array([1.0, 0.05, 0.5])
"""Colour of ghosts, linear sRGB."""

BRIGHTNESS = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of linear sRGB primaries (IEC 61966-2-1)."""


def ghosts_marked(scene: Scene) -> Picture:
    """The picture of a still with ghosts in one colour, at their own brightness."""
    whole = view_through(scene, compiled=True)
    direct = view_through(replace(scene, effects=replace(scene.effects, mode="none", list=())), compiled=True)
    ghosts = (whole.light - direct.light) @ BRIGHTNESS
    return replace(whole, light=direct.light + ghosts[:, :, None] * MARK)


def _seen(scene: Scene, fate: Fate) -> tuple[float, Floats]:
    """Share of the rays on the sheet with a fate, and their displacements (n, 2), mm.

    A displacement leads from the point on the sheet to the crossing of the plane of the piece.
    """
    plain = coordinate_scene(scene, BEHIND, RAYS)
    passage = replace(geometry_alone(plain, direct=True), shining=(int(fate),))
    picture = view_through(plain, passage=passage, compiled=True)
    x0, inside = sheet_points(plain, prescribe(plain.design()), picture.light.shape[:2])
    light = picture.light.reshape(-1, 3)
    met = inside & (light[:, 2] > 0.5)
    return float(met.sum() / inside.sum()), (light[met, :2] - 0.5) * WIDE - x0[met]


def _share_of_field(slope: float, scene: Scene) -> float:
    """Share of the law's light without a field lens: mean of the closed form over the camera's rays."""
    aside = np.linspace(-0.5, 0.5, 201) * SIDE / -scene.camera.position[2]
    x, y = (
        float(np.clip(1.0 - np.abs(t + aside) * SEPARATION / PITCH, 0.0, 1.0).mean()) for t in (slope, 0.0)
    )
    return x * y


def _field(load: Loader) -> Iterator[AtlasFinding]:
    for angle in ANGLES:
        slope = float(np.tan(np.radians(angle)))
        for field_lens in (False, True):
            label = f"{angle:g} degrees, {'with' if field_lens else 'without'} a field lens"
            scene = load(_stem(angle, field_lens))
            share, there = _seen(scene, Fate.ALIVE)
            ghosts, aside = _seen(scene, Fate.GHOST)
            want = 1.0 if field_lens else _share_of_field(slope, scene)
            slack = (
                0.005 if field_lens else 0.04
            )  # spheres: a fiftieth of a cell's light errs over its border
            yield AtlasFinding(f"{label}: share of light by the law", share, want, slack)
            yield AtlasFinding(f"{label}: share of ghosts", ghosts, 1.0 - want, slack)
            if share > 0.1:
                middle = float(np.median(there[:, 0]))
                yield AtlasFinding(
                    f"{label}: light by the law leaves with the slope", middle / BEHIND, -slope, 0.003
                )
            if angle and not field_lens:
                beside = float(np.median(aside[:, 0])) / BEHIND + slope
                yield AtlasFinding(
                    f"{label}: slope of ghosts next to it", abs(beside), 2.0 * PITCH / SEPARATION, 0.004
                )


def _stem(angle: float, field_lens: bool) -> str:
    return f"{'field-lens' if field_lens else 'no-field-lens'}-{angle:g}"


def _label(angle: float, field_lens: bool) -> str:
    return f"{angle:g} degrees off the normal, {'with' if field_lens else 'without'} a field lens"


FIELD_LENS = Figure(
    "W1",
    "A field lens: window-100mm over its field",
    "Without it ghosts (drawn in pink) take the place of the light that obeys the law; with it all light"
    " obeys, up to 2.8 degrees.",
    tuple(
        (_stem(angle, with_one), _label(angle, with_one)) for with_one in (False, True) for angle in ANGLES
    ),
    _field,
    ghosts_marked=True,
)
"""window-100mm at three angles, without and with a field lens."""
