"""The face of a lenslet as a process makes it: a height over its cell, exact where a closed form exists.

In order: the ball nose of a tool closes the valleys between convex lenslets (sphere, torus along a seam, ball
in a corner); a power or table changes heights; moulded lenslets sink in the middle; a Gaussian spot blurs;
shrinkage scales. Shrinkage alone leaves a conic or polynomial face one, with other numbers.
Texture is not part of the surface, see `making.texture`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from pathlib import Path

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.design.process import Process
from clacad.formats.maps.tool_path import HALVINGS, Nose, over_land
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

SLOPE = 1e-4
"""Distance over half a cell at which slopes of a form are taken."""

IN_CORNER = 17
"""Positions of the tool on the way into the corner of a lens."""

SHARP = 1e-12
"""Relative distance past a crease that rounding makes."""

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


@dataclass(frozen=True, eq=False)
class Crease:
    """Places along a side of a lens past which the tool touches something else than the lens.

    t : (k,). Along the side.
    share : (k,). Part of the way from the middle of the lens to the side.
    centres : (m, 3). Centre of the tool there, and on the way from the corner of the lens to the first place.
    """

    t: Floats
    share: Floats
    centres: Floats


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
        """At which places (n,) the centre of the tool that touches the lens lies past a crease."""
        sector, share, along = self._sector(*self._tool_over(x, y))
        if self.land is None:
            return np.asarray(share > 1.0)
        most = np.empty(np.shape(share))
        for number, crease in enumerate(self._creases):
            here = sector == number
            most[here] = np.interp(along[here], crease.t, crease.share)
        return np.asarray(share > most * (1.0 + SHARP))

    def _sector(self, x: Floats, y: Floats) -> tuple[Ints, Floats, Floats]:
        """Side of the lens (n,) towards which places lie from its middle, their part of the way there, and
        where along that side the way ends.
        """
        part = np.stack([(normal[0] * x + normal[1] * y) / width for normal, width, *_ in self.own.sides])
        sector = part.argmax(axis=0)
        share = part.max(axis=0)
        normal = np.array([one[0] for one in self.own.sides])[sector]
        along = (normal[..., 0] * y - normal[..., 1] * x) / np.where(share > 0.0, share, 1.0)
        return sector, share, along

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
        """Lowest ball of a tool whose centre is on a crease, over places (n,); infinite out of its reach."""
        best: list[Floats] = [np.full(len(x), np.inf), np.zeros(len(x)), np.zeros(len(x))]
        for number in range(len(self.own.sides)):
            centre_x, centre_y, centre = self._centre_on(number, x, y)
            u, v = x - centre_x, y - centre_y
            square = self.nose**2 - u**2 - v**2
            root = np.sqrt(np.where(square > 0.0, square, 1.0))
            height = np.where(square > 0.0, centre - root, np.inf)
            lower = height < best[0]
            for k, one in enumerate((height, u / root, v / root)):
                best[k] = np.where(lower, one, best[k])
        return best[0], best[1], best[2]

    def _centre_on(self, number: int, x: Floats, y: Floats) -> Heights:
        """Centre (n,) of the tool on a crease whose ball is lowest over places."""
        normal, width, low_t, high_t = self.own.sides[number]
        sphere = self.own.sphere
        if sphere is not None and self.land is None:
            p_n, p_t = normal[0] * x + normal[1] * y - width, normal[0] * y - normal[1] * x
            ring = sqrt((sphere + self.nose) ** 2 - width**2)
            tube = np.sqrt(np.maximum(self.nose**2 - p_n**2, 0.0))
            t = np.clip(p_t * ring / (ring - tube), low_t, high_t)
            at = width * normal[0] - t * normal[1], width * normal[1] + t * normal[0]
            return *at, np.sqrt(ring**2 - t**2) - sphere
        line = self._creases[number].centres
        square = self.nose**2 - ((np.stack([x, y], axis=1)[:, None] - line[:, :2]) ** 2).sum(axis=2)
        drop = np.where(square > 0.0, line[:, 2] - np.sqrt(np.maximum(square, 0.0)), np.inf)
        lowest = np.argmin(drop, axis=1)
        k = np.clip(lowest, 1, len(line) - 2)
        rows = np.arange(len(x))
        a, b, c = (drop[rows, k + shift] for shift in (-1, 0, 1))
        with np.errstate(invalid="ignore"):
            bend = a - 2.0 * b + c
            part = np.where(np.isfinite(bend) & (bend > 0.0), 0.5 * (a - c) / bend, lowest - k)
        part = np.clip(np.nan_to_num(part), -1.0, 1.0)[:, None]
        low, middle, high = line[k - 1], line[k], line[k + 1]
        found = middle + 0.5 * part * (high - low) + 0.5 * part**2 * (high - 2.0 * middle + low)
        return found[:, 0], found[:, 1], found[:, 2]

    @cached_property
    def _creases(self) -> list[Crease]:
        """Where the tool, going out from the middle to each side, touches something else."""
        t = np.stack([np.linspace(low, high, ON_SEAM) for *_, low, high in self.own.sides])
        (nx, ny), width = (np.array([one[k] for one in self.own.sides]).T[..., None] for k in (0, 1))
        x, y = width * nx - t * ny, width * ny + t * nx
        share = np.ones(t.shape)
        if self.land is not None:
            share = self._leaves(x.ravel(), y.ravel()).reshape(t.shape)
            out = np.linspace(1.0, share[:, :1], IN_CORNER, axis=1)[..., 0]  # in a corner, between two walls
            x, y = (np.hstack([out[:, :-1] * one[:, :1], share * one]) for one in (x, y))
        heights = self.path_height(x.ravel(), y.ravel()).reshape(x.shape)
        return [Crease(*one) for one in zip(t, share, np.stack([x, y, heights], axis=2), strict=True)]

    def _leaves(self, x: Floats, y: Floats) -> Floats:
        """Part of the way to places (n,) on the border of lenses up to which the tool touches its lens alone.

        It ends at land, or on the border of the cell, where a tool touches the next lens as well.
        """
        half = np.array(self.lattice.half_widths)[:, None]
        high = 1.0 / (1.0 + self.lattice.past_borders(x, y) / half).max(axis=0)
        low = np.where(self._free(high * x, high * y), high, 0.0)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            clear = self._free(middle * x, middle * y)
            low, high = np.where(clear, middle, low), np.where(clear, high, middle)
        return low

    def _free(self, x: Floats, y: Floats) -> Bools:
        """Whether (n,) a tool with its centre over places touches its own lens, and no land."""
        return np.asarray(self.rolled(x, y, None) >= over_land(self, x, y))


@dataclass(frozen=True, eq=False)
class MadeSurface:
    """One face of a sheet as made, over one cell; lengths of the design, heights outward from the material.

    window, face : The sheet as designed, and its face.
    process : Lengths in metres.
    depths : Made depth (metres) over the share of the deepest requested one, or its derivative of an order;
        None without `curve`.
    off : Outward height (n,) over places (n,) that the command has besides the face, smooth; None: nothing.
    """

    window: Window
    face: Face
    process: Process
    depths: Callable[[Floats, int], Floats] | None = None
    off: Callable[[Floats, Floats], Floats] | None = None

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
        """The tool that rolls in the valleys of this face; None: there is none, or only ridges."""
        sign = -1.0 if self.process.cut_as_insert else 1.0
        tool = BallNose(self.window, self.face, self.process.nose / self.window.unit, out=sign)
        return tool if self.process.nose and (self.convex or tool.land is not None) else None

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
        if self.off is not None:
            step = SLOPE * float(np.abs(self.lens.tile).max())
            (right, left), (up, down) = (
                [self.off(x + way * a, y + way * b) for way in (0.5, -0.5)]
                for a, b in ((step, 0.0), (0.0, step))
            )
            made = made[0] + self.off(x, y), made[1] + (right - left) / step, made[2] + (up - down) / step
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
    if nose and not made.convex and np.isfinite(made.lens.sharpest) and nose >= abs(made.lens.sharpest):
        cut = "insert of a face" if process.cut_as_insert else "concave face"
        raise NotPossible(
            f"process.nose {nose * unit:g} um is not smaller than the radius"
            f" {abs(made.lens.sharpest) * unit:.4g} um of a {cut}: the tool does not fit; make process.nose"
            " smaller"
        )
    return made


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
