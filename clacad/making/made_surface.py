"""The face of a lenslet as a process makes it: a height over its cell, exact where a closed form exists.

In order: the ball nose of a tool closes the valleys between convex lenslets (sphere, torus along a seam, ball
in a corner); a power or table changes heights; moulded lenslets sink in the middle; a Gaussian spot blurs;
shrinkage scales. Shrinkage alone leaves a conic or polynomial face one, with other numbers.
Texture is not part of the surface, see `texture`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from pathlib import Path

import numpy as np

from clacad.base.text import percent_text
from clacad.base.types import Bools, Floats
from clacad.design.process import Process
from clacad.formats.maps.tool_path import DEEP, Nose, ToolFace
from clacad.optics.surface.sag_and_normal import (
    EvenPolynomial,
    conic_constants,
    gradient,
    principal_radii,
    sag,
)
from clacad.sheet.shrunk import grown_surface
from clacad.sheet.window import Face, Window, lens_height_and_normal, optical_tile
from clacad.storage.errors import NotPossible
from clacad.tracing.facets.telescopelet import AnyFace, ExactFace, GraphFace

Heights = tuple[Floats, Floats, Floats]
"""Outward height (n,), lengths, and its slopes (n,) along x and y."""

Side = tuple[Floats, float, float, float]
"""Outward unit normal (2,) of a side of a cell, its distance, and its ends along (−normal y, normal x)."""

SEAM_SIGMAS = 4.0
"""Standard deviations of a spot within which a seam changes slopes by more than some microradians."""

ON_SEAM = 65
"""Positions of the tool along a seam between faces that are not spheres."""

NODES = 17
"""Places along each side of the box around a cell at which a face is fitted."""


@dataclass(frozen=True, eq=False)
class Lenslet:
    """One face of a sheet as designed, over one cell; heights outward from the material, 0 at the apex."""

    window: Window
    face: Face

    @cached_property
    def sharpest(self) -> float:
        """Smallest radius of the face, length; positive for one that bulges from the material."""
        radii = [one for one in principal_radii(self.face.surface) if np.isfinite(one)]
        return min(radii, key=abs) if radii else np.inf

    @cached_property
    def tile(self) -> Floats:
        """Corners (m, 2) of the cell, counter-clockwise."""
        return optical_tile(self.window, self.face.array or 0)

    @cached_property
    def sides(self) -> list[Side]:
        """Outward unit normal (2,) of each side of the cell, its distance, and its ends along the side."""
        found = []
        for start, end in zip(self.tile, np.roll(self.tile, -1, axis=0), strict=True):
            along = (end - start) / np.linalg.norm(end - start)
            normal = np.array([along[1], -along[0]])
            normal = normal if normal @ start > 0.0 else -normal
            low, high = sorted(float(normal[0] * c[1] - normal[1] * c[0]) for c in (start, end))
            found.append((normal, float(normal @ start), low, high))
        return found

    @cached_property
    def grid(self) -> tuple[Floats, Floats]:
        """Evenly spread places (n,) of the cell."""
        reach = np.abs(self.tile).max(axis=0)
        x, y = (one.ravel() for one in np.meshgrid(*(np.linspace(-r, r, NODES) for r in reach)))
        held = np.ones(len(x), dtype=bool)
        for normal, width, *_ in self.sides:
            held &= normal[0] * x + normal[1] * y <= width * (1.0 + 1e-12)
        return x[held], y[held]

    @cached_property
    def span(self) -> tuple[float, float]:
        """Lowest and highest height over the cell."""
        line = np.linspace(0.0, 1.0, 33)[:, None]
        ends = np.roll(self.tile, -1, axis=0)
        rim = np.concatenate([a + line * (b - a) for a, b in zip(self.tile, ends, strict=True)])
        points = np.vstack([rim, np.reshape(self.face.vertex[:2], (1, 2)), [[0.0, 0.0]]])
        height = self(points[:, 0], points[:, 1])[0]
        return float(np.nanmin(height)), float(np.nanmax(height))

    @cached_property
    def sphere(self) -> float | None:
        """Radius of a spherical face whose middle is that of its cell; None for any other."""
        surface = self.face.surface
        radii = principal_radii(surface)
        even = not isinstance(surface, EvenPolynomial)
        centred = np.hypot(*self.face.vertex[:2]) < 1e-12 * max(self.window.lattice.pitch)
        alike = radii[0] == radii[1]
        alike &= all(k is not None and abs(k) < 1e-12 for k in conic_constants(surface))
        return abs(radii[0]) if even and alike and centred and np.isfinite(radii[0]) else None

    def __call__(self, x: Floats, y: Floats) -> Heights:
        """Height over places (n,) of the cell, and its slopes; flat beyond the equator."""
        side, face = -float(self.face.side), self.face
        if face.untilted:
            at = x - face.vertex[0], y - face.vertex[1]
            z, normal = face.vertex[2] + sag(face.surface, *at), gradient(face.surface, *at)
        else:
            z, normal = lens_height_and_normal(face, x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            height, dx, dy = (
                side * (z - face.vertex[2]),
                -side * normal[..., 0] / normal[..., 2],
                -side * normal[..., 1] / normal[..., 2],
            )
        if np.isfinite(z).all():
            return height, dx, dy
        return np.nan_to_num(height), np.nan_to_num(dx), np.nan_to_num(dy)


class BallNose(Nose):
    """A nose that rolls over an array of lenslets, or over the insert they are moulded in; what it leaves."""

    @cached_property
    def own(self) -> Lenslet:
        """The face as designed."""
        return Lenslet(self.window, self.face)

    def __call__(self, x: Floats, y: Floats) -> Heights:
        """The lenslet where the tool reaches it, the tool's own ball elsewhere."""
        height, dx, dy = (one.copy() for one in self._seen(x, y))
        rows = np.flatnonzero(self.rounds(x, y))
        if len(rows):
            found = self._lowest_ball(x[rows], y[rows])
            reached = np.isfinite(found[0])  # the others lie beyond the cell
            for one, made in zip((height, dx, dy), found, strict=True):
                one[rows[reached]] = made[reached]
        return self.out * height, self.out * dx, self.out * dy

    def rounds(self, x: Floats, y: Floats) -> Bools:
        """At which places (n,) the tool would have to leave its cell to touch the lenslet."""
        centre_x, centre_y = self._tool_over(x, y)
        found = np.zeros(np.shape(x), dtype=bool)
        for normal, width, *_ in self.own.sides:
            found |= normal[0] * centre_x + normal[1] * centre_y > width
        return found

    def _seen(self, x: Floats, y: Floats) -> Heights:
        """The face as the tool sees it: of an insert, the negative."""
        height, dx, dy = self.own(x, y)
        return self.out * height, self.out * dx, self.out * dy

    def _tool_over(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Centre of the tool that touches the lenslet at places (n,)."""
        _, dx, dy = self._seen(x, y)
        steep = self.nose / np.sqrt(1.0 + dx * dx + dy * dy)
        return x - steep * dx, y - steep * dy

    def _lowest_ball(self, x: Floats, y: Floats) -> Heights:
        """Lowest ball of a tool whose centre is on a seam, over places (n,); infinite out of its reach."""
        best: list[Floats] = [np.full(len(x), np.inf), np.zeros(len(x)), np.zeros(len(x))]
        for number, (normal, *_) in enumerate(self.own.sides):
            across, along, centre = self._centre_on(number, x, y)
            square = self.nose**2 - across**2 - along**2
            root = np.sqrt(np.where(square > 0.0, square, 1.0))
            height = np.where(square > 0.0, centre - root, np.inf)
            slope_x = (normal[0] * across - normal[1] * along) / root
            slope_y = (normal[1] * across + normal[0] * along) / root
            lower = height < best[0]
            for k, one in enumerate((height, slope_x, slope_y)):
                best[k] = np.where(lower, one, best[k])
        return best[0], best[1], best[2]

    def _centre_on(self, number: int, x: Floats, y: Floats) -> Heights:
        """Offset (n,) of places across and along a seam from the tool that touches them, and its height."""
        normal, width, low_t, high_t = self.own.sides[number]
        p_n, p_t = normal[0] * x + normal[1] * y - width, normal[0] * y - normal[1] * x
        sphere = self.own.sphere
        if sphere is not None:
            ring = sqrt((sphere + self.nose) ** 2 - width**2)
            tube = np.sqrt(np.maximum(self.nose**2 - p_n**2, 0.0))
            centre_t = np.clip(p_t * ring / (ring - tube), low_t, high_t)
            return p_n, p_t - centre_t, np.sqrt(ring**2 - centre_t**2) - sphere
        t, height = self._path[number]
        square = self.nose**2 - p_n[:, None] ** 2 - (p_t[:, None] - t) ** 2
        drop = np.where(square > 0.0, height - np.sqrt(np.maximum(square, 0.0)), np.inf)
        k = np.clip(np.argmin(drop, axis=1), 1, len(t) - 2)
        rows = np.arange(len(x))
        a, b, c = (drop[rows, k + shift] for shift in (-1, 0, 1))
        with np.errstate(invalid="ignore"):
            part = np.where(np.isfinite(a) & np.isfinite(c), 0.5 * (a - c) / (a - 2.0 * b + c), 0.0)
        part = np.clip(np.nan_to_num(part), -1.0, 1.0)
        low, middle, high = height[k - 1], height[k], height[k + 1]
        centre = middle + 0.5 * part * (high - low) + 0.5 * part**2 * (high - 2.0 * middle + low)
        return p_n, p_t - t[k] - part * (t[1] - t[0]), centre

    @cached_property
    def _path(self) -> list[tuple[Floats, Floats]]:
        """Positions along each seam and height of the centre of the tool there."""
        found = []
        for normal, width, low, high in self.own.sides:
            t = np.linspace(low, high, ON_SEAM)
            found.append(
                (t, self.path_height(width * normal[0] - t * normal[1], width * normal[1] + t * normal[0]))
            )
        return found


@dataclass(frozen=True, eq=False)
class MadeSurface:
    """One face of a sheet as made, over one cell; lengths of the design, heights outward from the material.

    window, face : The sheet as designed, and its face.
    process : Lengths in metres.
    depths : Made depth (metres) over the share of the deepest requested one, or its derivative of an order;
        None without `curve`.
    """

    window: Window
    face: Face
    process: Process
    depths: Callable[[Floats, int], Floats] | None = None

    @cached_property
    def lens(self) -> Lenslet:
        """The face as designed."""
        return Lenslet(self.window, self.face)

    @cached_property
    def scale(self) -> tuple[float, float, float]:
        """1 − shrinkage along x, y and z."""
        x, y, z = (1.0 - one for one in self.process.shrinkage)
        return x, y, z

    @cached_property
    def convex(self) -> bool:
        """Whether what the tool cuts bulges towards the tool: the part, or the insert it is moulded in."""
        return (self.lens.sharpest > 0.0) != self.process.cut_as_insert

    @cached_property
    def tool(self) -> BallNose | None:
        """The tool that rolls in the valleys of this face; None: there is none, or only ridges or land."""
        if not self.process.nose or not self.convex or self.face.land is not None:
            return None
        sign = -1.0 if self.process.cut_as_insert else 1.0
        return BallNose(self.window, self.face, self.process.nose / self.window.unit, out=sign)

    @cached_property
    def spot(self) -> float:
        """Standard deviation of the writing spot, length."""
        return self.process.spot / self.window.unit

    def __call__(self, x: Floats, y: Floats) -> Heights:
        """Height z (n,) of the sheet frame over places of the made cell, and its slopes."""
        sx, sy, sz = self.scale
        height, dx, dy = self.wished(x / sx, y / sy)
        side = -float(self.face.side)
        apex = self.face.vertex[2] * (1.0 - self.process.thickness)
        return apex + side * sz * height, side * sz / sx * dx, side * sz / sy * dy

    def rounded(self, x: Floats, y: Floats) -> Bools:
        """Which places (n,) of the made cell the tool or the spot rounds."""
        x, y = x / self.scale[0], y / self.scale[1]
        found = np.zeros(np.shape(x), dtype=bool) if self.tool is None else self.tool.rounds(x, y)
        if self.spot:
            for normal, width, *_ in self.lens.sides:
                found |= normal[0] * x + normal[1] * y > width - SEAM_SIGMAS * self.spot
        return found

    def wished(self, x: Floats, y: Floats) -> Heights:
        """The face as made but for shrinkage: outward height (n,), and its slopes."""
        made = self._blurred(x, y) if self.spot else self._pointwise(x, y)
        depth = self.process.sink / self.window.unit
        if not depth:
            return made
        half = np.abs(self.lens.tile).max(axis=0)
        u, v = x / half[0], y / half[1]
        over_x, over_y = 1.0 - u * u, 1.0 - v * v
        slopes = 2.0 * depth * u * over_y / half[0], 2.0 * depth * v * over_x / half[1]
        return made[0] - depth * over_x * over_y, made[1] + slopes[0], made[2] + slopes[1]

    def _pointwise(self, x: Floats, y: Floats) -> Heights:
        """The closed face with its heights changed by gamma or the table."""
        height, dx, dy = self.lens(x, y) if self.tool is None else self.tool(x, y)
        low, high = self.lens.span
        gamma = self.process.gamma
        if high <= low or (gamma == 1.0 and self.depths is None):
            return height, dx, dy
        u = np.clip((height - low) / (high - low), 0.0, None)
        if self.depths is not None:
            share, unit = np.clip(1.0 - u, 0.0, 1.0), self.window.unit
            rate = self.depths(share, 1) / unit / (high - low)
            return high - self.depths(share, 0) / unit, rate * dx, rate * dy
        rate = np.where(u > 0.0, gamma * np.where(u > 0.0, u, 1.0) ** (gamma - 1.0), 0.0)
        return low + (high - low) * u**gamma, rate * dx, rate * dy

    def _blurred(self, x: Floats, y: Floats) -> Heights:
        """Gaussian blur: Gauss-Hermite points over the lenslet (exact to degree 5), and the seams' wedges."""
        from scipy.special import ndtr

        reach = sqrt(3.0) * self.spot
        total = [np.zeros(np.shape(x)) for _ in range(3)]
        for i, in_x in ((-1, 1 / 6), (0, 2 / 3), (1, 1 / 6)):
            for j, in_y in ((-1, 1 / 6), (0, 2 / 3), (1, 1 / 6)):
                part = self._pointwise(x + i * reach, y + j * reach)
                total = [have + in_x * in_y * one for have, one in zip(total, part, strict=True)]
        for normal, width, *_ in self.lens.sides:
            away = (width - normal[0] * x - normal[1] * y) / self.spot
            near = np.flatnonzero(np.abs(away) < 8.0)
            step = away[near] * self.spot
            edge = x[near] + step * normal[0], y[near] + step * normal[1]
            here = self._pointwise(*edge)
            over = self._pointwise(edge[0] - 2.0 * width * normal[0], edge[1] - 2.0 * width * normal[1])
            bend = normal[0] * (over[1] - here[1]) + normal[1] * (over[2] - here[2])
            beyond = ndtr(-away[near])
            bell = np.exp(-0.5 * away[near] ** 2) / sqrt(2.0 * np.pi)
            total[0][near] += bend * self.spot * (bell - away[near] * beyond)
            total[1][near] += bend * beyond * normal[0]
            total[2][near] += bend * beyond * normal[1]
        return total[0], total[1], total[2]


def read_curve(path: str) -> Callable[[Floats, int], Floats]:
    """Made depth (metres) over the share of the deepest requested depth, from a calibration.

    Parameters
    ----------
    path : str
        CSV of `clacad calibrate`. The deepest requested depth is written at the last level.

    Raises
    ------
    NotPossible
        There is no such file.
    UnreadableFile, OverBudget
        As `clacad.formats.maps.dose.read_calibration`.
    """
    from scipy.interpolate import PchipInterpolator

    from clacad.formats.maps.dose import read_calibration

    try:
        table = read_calibration(Path(path))
    except OSError as error:
        raise NotPossible(f"{path}: process.curve cannot be read: {error}") from None
    first, last = table.levels[0], table.levels[-1]
    found: Callable[[Floats, int], Floats] = PchipInterpolator(
        (table.levels - first) / (last - first), table.depths - table.depths[0]
    )
    return found


def made_surface(
    window: Window, face: Face, process: Process, depths: Callable[[Floats, int], Floats] | None
) -> MadeSurface:
    """Prepare a face as made; refuse a tool that does not fit into it.

    Raises NotPossible.
    """
    made = MadeSurface(window, face, process, depths)
    nose, unit = process.nose / window.unit, 1e6 * window.unit
    if nose and window.land.seam > 0.0 and face.array is not None and face.land is not None:
        _refuse_land(window, face, nose, process.cut_as_insert)
    if nose and not made.convex and np.isfinite(made.lens.sharpest) and nose >= abs(made.lens.sharpest):
        cut = "insert of a face" if process.cut_as_insert else "concave face"
        raise NotPossible(
            f"process.nose {nose * unit:g} um is not smaller than the radius"
            f" {abs(made.lens.sharpest) * unit:.4g} um of a {cut}: the tool does not fit; make process.nose"
            " smaller"
        )
    return made


def _refuse_land(window: Window, face: Face, nose: float, insert: bool) -> None:
    """Refuse a tool that rounds lenses next to land; what it leaves on the land meets no light of lenses.

    Raises NotPossible.
    """
    unit = 1e6 * window.unit
    if insert:
        raise NotPossible(
            f"process.nose {nose * unit:g} um with land (lattice.seam): the insert has pits with walls, and"
            ' what a tool leaves at their foot is not known; set process.nose = "0 um" or lattice.seam = 0'
        )
    depths, area, _ = ToolFace(window, face, nose, 1.0).depths
    share = float(((depths > DEEP * min(window.lattice.pitch)) @ area).max())
    if share > 0.0:
        raise NotPossible(
            f"process.nose {nose * unit:g} um does not reach {percent_text(share)} of lenses next to land"
            f" {window.land.seam * unit:g} um wide (lattice.seam), and the rest is not judged as made; take a"
            " smaller nose, or a wider seam"
        )


def made_face(made: MadeSurface, origin: Floats) -> AnyFace:
    """A face of one cell as made, for `trace_facets`; origin (3,): centre of the made cell."""
    process, face = made.process, made.face
    scale = made.scale
    (x, y, z), stays = face.vertex, 1.0 - process.thickness
    apex = (x * scale[0], y * scale[1], z * stays)
    plain = not (made.tool or made.spot or process.sink or made.depths) and process.gamma == 1.0
    round_about = scale[0] == scale[1] and face.rotation[2, 2] == 1.0
    if face.array is None or (plain and face.land is None and (face.untilted or round_about)):
        return ExactFace(
            replace(face, surface=grown_surface(face.surface, scale), vertex=apex),
            origin,
            made.window,
            scale[:2],
        )
    return GraphFace(face, origin, made.window, made, made.rounded, scale[:2])
