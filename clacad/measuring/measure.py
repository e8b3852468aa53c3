"""Measure a made part: maps in, lenslets, light and verdict out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, log, prod
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.interactive import shown_progress
from clacad.base.types import Progress
from clacad.base.vectors import doubled_normals
from clacad.formats.mesh.compare_instances import body_facing, levels
from clacad.measuring.find_lattice import NotMeasurable, plane_of, thinned
from clacad.measuring.fit_lenslets import Lenslets, fit_lenslets
from clacad.measuring.form_and_seams import Surface, surface_of
from clacad.measuring.judge_scan import Scanned, scan_checks
from clacad.measuring.light_through_form import light_through_form, texture_share
from clacad.measuring.measured import Measured
from clacad.measuring.read_map import STEEP, MeasuredMap, cloud_map, read_map
from clacad.measuring.scales import HEIGHTS, LATERAL, Scale, Stated, scale_by_tilt, scale_of
from clacad.measuring.sides import (
    Name,
    ShownCells,
    Side,
    cells_in_map,
    first_cells,
    placed_cells,
    sides_of,
)
from clacad.prescription.prescribe import prescribe
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.formats.mesh.file_mesh import FileMesh
    from clacad.judging.pose_fit import PartPose
    from clacad.sheet.window import Window

Path = str | os.PathLike[str]
Given = Path | MeasuredMap | tuple[Path | MeasuredMap, tuple[int, int]]


@dataclass(frozen=True)
class Maps:
    """Maps of one part and the scales of the instrument, as `measure` takes them."""

    front: Given | None = None
    back: Given | None = None
    tilted: Path | None = None
    z_scale: Stated = None
    lateral_scale: Stated = None
    unit: str | None = None
    cell: tuple[int, int] | None = None
    named: bool = True

    def of(self, side: Name, measured: Given) -> Maps:
        """The scales with the map of one side."""
        return replace(self, front=measured) if side == "front" else replace(self, back=measured)

    def measured(self, design: Design, progress: Progress) -> Measured:
        """Measure the part; see `measure`.

        named : Whether the sides of the files are known; else they follow from the curvature of the maps.
        """
        given = [self.front, self.back] if self.named else [*self._by_curvature(design)]
        first = 0 if given[0] is not None else 1
        path = given[first]
        if self.cell is not None and path is not None and not isinstance(path, tuple):
            given[first] = path, self.cell
        return _measured(design, prescribe(design), replace(self, front=given[0], back=given[1]), progress)

    @property
    def scales(self) -> tuple[Scale, Scale]:
        """Scale of heights and lateral scale. Raises BadRequest."""
        heights = scale_of(self.z_scale, HEIGHTS, "z_scale")
        return heights, scale_of(self.lateral_scale, LATERAL, "lateral_scale")

    def _by_curvature(self, design: Design) -> tuple[Given | None, Given | None]:
        """The files, exchanged where their radii are nearer to those of the other sides of the design."""
        sides = sides_of(prescribe(design), 1e-3 / design.unit_m)
        apart = abs(log(sides["front"].lenslet[3] / sides["back"].lenslet[3]))
        if apart < APART:
            return self.front, self.back
        heights, lateral = self.scales
        kept: list[float] = []
        swapped: list[float] = []
        read: list[Given | None] = [self.front, self.back]
        for k, name in enumerate(SIDES):
            path = read[k]
            if isinstance(path, (str, os.PathLike)):
                one = read[k] = read_map(path, self.unit, name)
                for other in SIDES:
                    miss = _miss(one, sides[other], heights.value, lateral.value, design.unit_m)
                    (kept if other == name else swapped).append(miss)
        front, back = read
        return (back, front) if sum(swapped) < sum(kept) else (front, back)


SIDES: tuple[Name, Name] = ("front", "back")
APART = 0.03
"""Least relative difference of the radii of front and back by which their maps are recognized."""


def _miss(measured: MeasuredMap, side: Side, height: float, lateral: float, unit_m: float) -> float:
    """Relative difference of the radius of a map to that of a side; 1 where the map is not measurable."""
    try:
        lens = _fitted(measured, side, height, lateral, unit_m)[1]
    except NotMeasurable:
        return 1.0
    return abs(log(float(np.median(lens.values[:, 3])) / side.lenslet[3]))


SURE = 2e-5
"""Relative difference of the pitches by which a lateral scale that is not stated is borne out at best."""

LIKE = (0.5, 2.0)
"""Range of heights of a square as large as a cell over that of the design's lenslets."""

SHOWN = 0.2
"""Least share of such squares with heights of lenslets, not of land or letters."""

STEEPEST = 0.25
"""Largest tilt (radians) of a map."""

LIT = 550e-9
"""Wavelength (metres) of the texture's phase where the design states none."""


def measure(
    design: Design,
    front: Given | None = None,
    back: Given | None = None,
    *,
    tilted: Path | None = None,
    z_scale: Stated = None,
    lateral_scale: Stated = None,
    unit: str | None = None,
    progress: Progress | None = None,
) -> Measured:
    """Measure a made part by height maps of its sides, and judge it by its light.

    Every whole lenslet of a map is fitted: middle, radius, conic constant, astigmatism, texture, each with
    its
    uncertainty. Light is sent through the fitted form; sides without a map, thickness and wedge are as
    designed.

    Parameters
    ----------
    design : Design
    front, back : path, (path, (i, j)) or None
        Map of the side that light reaches first, and of the other: X3P, SDF, a cloud x y z, or NPY, TIFF or
        PNG with a JSON file next to it. (i, j): cell of the sheet nearest to its middle; without it, it is
        found where an edge of the array is in the map, and is else the middle of a non-uniform sheet.
    tilted : path or None
        A second map of the field of `front` (without one: of `back`), the specimen tilted by about 8
        degrees: it
        gives the scale of heights.
    z_scale, lateral_scale : str, float, (float, float) or None
        Length in the file over the true one, with the half width of its uncertainty (95 %): "1.0063 +- 1e-4".
        None: 1 +- 0.01 for heights; laterally as the pitch bears it out.
    unit : str or None
        Length unit of a cloud that states none, such as "um".
    progress : callable or None
        Called with a stage's name and the fraction done, 0 … 1.

    Returns
    -------
    Measured

    Raises
    ------
    UnreadableFile, OverBudget
        A map is damaged, larger than is read, or holds no lenslets of the design.
    NotPossible
        Its reader is not installed (extra: clacad[metrology]), or the sheet cannot be compared with maps.
    BadRequest
        No map; a scale that cannot be understood; or a unit that is needed and not stated.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import numpy as np
    >>> import clacad
    >>> design = clacad.load("window-100mm")
    >>> at = (np.arange(150) - 74.5) * 0.01  # three cells of 0.5 mm, pixels of 0.01 mm
    >>> cell = (at + 0.25) % 0.5 - 0.25
    >>> scan = Path(mkdtemp()) / "front.npy"
    >>> np.save(scan, -clacad.prescribe(design).faces[0].surface.sag(*np.meshgrid(cell, cell)))
    >>> scales = '{"pixel_mm": 0.01, "z_step_mm": 1.0, "row_0": "bottom"}'
    >>> _ = scan.with_name("front.npy.json").write_text(scales)
    >>> clacad.measure(design, scan)
    window-100mm
      front  R 2.46814 +- 0.012, K ...
      pass  5 checks
    pass: light through the measured form leaves 0.166 mrad rms from the law ...
    """
    maps = Maps(front, back, tilted, z_scale, lateral_scale, unit)
    return _measured(design, prescribe(design), maps, progress)


def _measured(design: Design, window: Window, maps: Maps, progress: Progress | None) -> Measured:
    """Measure a part of a window by its maps."""
    told = shown_progress(progress)
    found, heights, lateral = fitted_sides(design, window, maps, progress)
    told("sending light through the measured form", 0.6)
    light = light_through_form(
        window, {name: one.lit for name, one in found.items()}, design.check.field, design.check.field_centre
    )
    wavelength = window.wavelength or LIT
    shares = [
        texture_share(one.texture * design.unit_m, one.lit.side.body.index, wavelength)
        for one in found.values()
    ]
    judged = Scanned(design, found, light, heights, lateral, wavelength)
    told("done", 1.0)
    return Measured(design, found, heights, lateral, light, prod(shares), scan_checks(judged))


def _alike(
    fitted: Mapping[Name, tuple[MeasuredMap, Lenslets, ShownCells]],
) -> dict[Name, tuple[MeasuredMap, Lenslets, ShownCells]]:
    """Maps of both sides whose middles show one cell, unless edges show others."""
    cells = [of for _, _, of in fitted.values()]
    first, known = list(cells[0].first), list(cells[0].known)
    for of in cells:
        for k in (0, 1):
            if known[k] == "assumed":
                first[k], known[k] = of.first[k], of.known[k]
    found = {}
    for name, (measured, lenslets, of) in fitted.items():
        own = [first[k] if of.known[k] == "assumed" else of.first[k] for k in (0, 1)]
        found[name] = measured, lenslets, replace(of, first=(own[0], own[1]))
    return found


def fitted_sides(
    design: Design, window: Window, of: Maps, progress: Progress | None = None
) -> tuple[dict[Name, Surface], Scale, Scale]:
    """Fit every whole lenslet of the maps of a part; no light is sent.

    Returns measured sides, scale of heights, and lateral scale. Raises as `measure`.
    """
    given: dict[Name, Given | None] = {"front": of.front, "back": of.back}
    stated = {
        name: one if isinstance(one, tuple) else (one, None) for name, one in given.items() if one is not None
    }
    maps = {name: one for name, (one, _) in stated.items()}
    if not maps:
        raise BadRequest("no map to measure: give front, back or both")
    told = shown_progress(progress)
    heights, lateral = of.scales
    sides = sides_of(window, 1e-3 / design.unit_m)
    read: dict[Name, MeasuredMap] = {}
    for name, one in maps.items():
        told(f"reading the {name}", 0.0)
        read[name] = one if isinstance(one, MeasuredMap) else read_map(one, of.unit, name)
    if of.tilted is not None:
        told("finding the scale of heights", 0.2)
        first = next(iter(read))
        heights = _by_tilt(
            read[first], read_map(of.tilted, of.unit), sides[first], heights, lateral.value, design.unit_m
        )
    fitted: dict[Name, tuple[MeasuredMap, Lenslets, ShownCells]] = {}
    for name, one in read.items():
        told(f"fitting the lenslets of the {name}", 0.3)
        fitted[name] = _fitted(one, sides[name], heights.value, lateral.value, design.unit_m, stated[name][1])
    return _surfaces(_alike(fitted), sides, heights, lateral), heights, lateral


def _surfaces(
    fitted: Mapping[Name, tuple[MeasuredMap, Lenslets, ShownCells]],
    sides: Mapping[Name, Side],
    heights: Scale,
    lateral: Scale,
) -> dict[Name, Surface]:
    """Measured sides; all radii together are uncertain by both scales."""
    found = {}
    for name, (measured, lenslets, cells) in fitted.items():
        half = lateral.half
        if lateral.origin == "assumed":  # a pitch that agrees with the design's bears the scale out
            wanted = [hypot(*sides[name].lattice.a1), hypot(*sides[name].lattice.a2)]
            off = max(abs(p / q - 1.0) for p, q in zip(lenslets.pitch, wanted, strict=True))
            half = min(half, max(off, SURE))
        found[name] = surface_of(measured, cells, lenslets, hypot(heights.half, 2.0 * half))
    return found


def _fitted(
    measured: MeasuredMap,
    side: Side,
    height: float,
    lateral: float,
    unit_m: float,
    stated: tuple[int, int] | None = None,
) -> tuple[MeasuredMap, Lenslets, ShownCells]:
    """Map in design units with its scales taken off, its lenslets, and the cells that they are."""
    one = measured.scaled(lateral * unit_m, height * unit_m)
    _refuse_heights(one, side)
    cells = first_cells(side, stated)
    for _ in range(2):
        lenslets = fit_lenslets(one, side.lattice, side.aperture, cells.numbers)
        before = cells
        if stated is None:
            seen, land = partial(lenslets.seen, one), partial(lenslets.land, one)
            placed = placed_cells(side, one.middle, lenslets.lattice.origin)
            cells = placed or cells_in_map(side, lenslets.index, lenslets.empty, seen, land)
        if side.alike or cells.first == before.first:
            break
    _, a, b = lenslets.pose
    if hypot(a, b) > STEEPEST:
        raise NotMeasurable(
            f"{one.name}: it is tilted by {hypot(a, b):.2g} rad; {STEEPEST:g} rad is the most"
        )
    return one, lenslets, cells


def _refuse_heights(measured: MeasuredMap, side: Side) -> None:
    """Refuse a map whose heights about their plane are of another order than those of the design's
    lenslets.
    """
    x, y, z = thinned(measured.points)
    slopes = plane_of(measured.points)[1:]
    column, row = (np.floor((at - at.min()) / min(side.lattice.pitch)).astype(np.int64) for at in (x, y))
    square = row * (int(column.max()) + 1) + column
    order = np.argsort(square)
    first = np.flatnonzero(np.diff(square[order], prepend=-1))
    own = (z - slopes[0] * x - slopes[1] * y)[order]
    ratios = (np.maximum.reduceat(own, first) - np.minimum.reduceat(own, first)) / side.sag
    ratio = float(np.median(ratios))
    if np.mean((ratios >= LIKE[0]) & (ratios <= LIKE[1])) < SHOWN:
        factor = next((f for f in (1000.0, 0.001) if LIKE[0] <= ratio / f <= LIKE[1]), None)
        hint = f": a unit of heights 1000 times too {'small' if ratio < 1.0 else 'large'}" if factor else ""
        raise NotMeasurable(
            f"{measured.name}: its heights range over {ratio:.3g} times those of the design{hint}"
        )


def _by_tilt(
    level: MeasuredMap, tilted: MeasuredMap, side: Side, before: Scale, lateral: float, unit_m: float
) -> Scale:
    """Scale of heights from two maps of one field; found twice, the second time nearly there."""
    scale = before
    for _ in range(2):
        one, two = (_fitted(each, side, scale.value, lateral, unit_m)[1] for each in (level, tilted))
        scale = scale_by_tilt(one, two, scale)
    return scale


def measure_mesh(design: Design, window: Window, name: str, mesh: FileMesh, pose: PartPose) -> Measured:
    """Measure the sides of a part that its mesh shows: by the corners of the facets of each curved face.

    window : with the cells of the part; name : of the file; pose : brings the mesh into the sheet frame. Its
        lengths have one scale along all axes.
    Raises as `measure`; NotMeasurable: no side of it has lenslets that can be fitted.
    """
    corners, faces = [], []
    between, size = levels(window), pose.scale * design.unit_m
    for chunk in mesh.chunks():
        placed = pose.onto_design(chunk)
        normal = doubled_normals(placed) * (-1.0 if pose.mirrored else 1.0)
        level = np.abs(normal[:, 2]) > STEEP * np.linalg.norm(normal, axis=1)
        placed, up = placed[level], normal[level, 2]
        corners.append(placed * size)
        faces.append(2 * body_facing(between, placed[..., 2].mean(axis=1), up) + (up > 0.0))
    number, every = np.concatenate(faces), np.concatenate(corners)
    maps: dict[Name, Given] = {}
    for side_name, side in sides_of(window, 1e-3 / design.unit_m).items():
        points = np.unique(every[number == side.number].reshape(-1, 3), axis=0).T
        if points.shape[1] >= FEWEST_CORNERS:
            maps[side_name] = cloud_map(name, points * np.array([[*side.signs, -side.face.side]]).T, True)
    if not maps:
        raise NotMeasurable(f"{name}: no facets of its curved faces")
    return _measured(design, window, Maps(maps.get("front"), maps.get("back"), z_scale=1.0), None)


FEWEST_CORNERS = 100
"""Fewest corners of facets of a face that is measured."""


def maps_of(paths: Sequence[str | os.PathLike[str]], sides: Mapping[str, str], stated: Maps) -> Maps:
    """Maps of files: their sides as stated, else by their names, else by their curvature.

    sides : File name → "front" or "back".
    Raises BadRequest: Two files of one side, more than two, or a side of a file that is not given.
    """
    found: dict[str, Path] = {}
    told = False
    names = {os.path.basename(path): path for path in paths}
    idle = [name for name in sides if name not in names or sides[name] not in ("front", "back")]
    if idle or len(paths) > 2:
        what = f"--side {idle[0]}={sides[idle[0]]}" if idle else f"{len(paths)} files"
        raise BadRequest(f"{what}: a part has a front and a back, one map each: --side FILE=front")
    for name, path in names.items():
        by_name = [side for side in ("front", "back") if side in name.lower()]
        free = [side for side in ("front", "back") if side not in found]
        told |= name in sides or len(by_name) == 1
        side = sides.get(name) or (by_name[0] if len(by_name) == 1 else free[0])
        if side in found:
            raise BadRequest(
                f"{os.path.basename(found[side])} and {name} are both of the {side}: --side FILE=back"
            )
        found[side] = path
    return replace(stated, front=found.get("front"), back=found.get("back"), named=told)
