"""Correct the shape that a machine is commanded to make, by a height map of the part that it made.

The next command is the last one plus target less measured form. The form is what all measured lenslets share,
and in a sheet of differing lenslets also what each has of its own: Legendre polynomials to degree 8, each
coefficient less the part that noise may have made, carried on to the rim of the cell. Height and tilt of a
single lenslet are no property of a map and are not corrected.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from clacad.base.text import percent_text, printable
from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.config.mistakes import DesignError
from clacad.design.process import process_of
from clacad.exporting.compensation import TERMS, form_name, form_rows
from clacad.formats.maps.dose import Calibration, read_calibration
from clacad.making.texture import level_step, step_rms
from clacad.measuring.find_lattice import Found
from clacad.measuring.fit_lenslets import Aperture, conic, fit_heights, pooled_form
from clacad.measuring.form_and_seams import Surface
from clacad.measuring.light_through_form import law_rms_of_form
from clacad.measuring.measure import Maps, fitted_sides
from clacad.measuring.measured import NUMBERS
from clacad.measuring.read_map import MeasuredMap, read_map
from clacad.measuring.scales import HEIGHTS, Scale, Stated
from clacad.measuring.sides import AXES, OTHER, Name, ShownCells, Side, sides_of
from clacad.optics.fit import legendre, nearest_polynomial
from clacad.prescription.bodies import face_spec, given_design
from clacad.prescription.prescribe import prescribe
from clacad.storage.atomic import canonical_json, file_hash, write_set
from clacad.storage.errors import BadRequest, NotPossible

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

FORMAT = 1
NEXT = "next.toml"
"""Name of the design whose faces are the commands."""

NODES = 128
"""Heights of a command along each side of the box around a cell; the next cell begins after the last."""

FARTHEST = 1.5
"""Largest correction at the rim, over its range inside the measured aperture."""

OUTSIDE = 0.1
"""Weight of heights outside the measured aperture where polynomials are fitted to a command."""

FIRST = 3
"""Number of polynomials of degree 0 and 1: height and tilt of a lenslet, which a map does not show."""

MOST_CELLS = 1024
"""Most cells whose heights are written one by one."""

LONGEST = 1 << 26
"""Longest file of numbers (bytes) of a measured part that is read."""


@dataclass(frozen=True, eq=False)
class Correction:
    """A command after one more measured part.

    Attributes
    ----------
    design : Design
    side : "front" or "back"
    round : int
        Number of corrections that the command holds.
    heights : (128, 128) array, design units
        Command over the box around one cell, out of the material, seen from outside; NaN off the cell. The
        height in row i, column k belongs to ((k − 64) / 128, (i − 64) / 128) of the box.
    rms, doubt : float, design units
        Rms of the deviation that this round takes off, and its standard uncertainty.
    history : tuple of mapping
        What each round found: file, SHA-256 of its content, rms deviation, law_rms where light was traced.
    stopped : str
        Why no correction was made; "" where one was.
    notes : tuple of str
    own : mapping (i, j) → (c,) coefficients, design units
        Form that the command of a cell has besides that of all cells; empty where all lenslets are alike.
    """

    design: Design
    side: Name
    round: int
    heights: Floats
    rms: float = 0.0
    doubt: float = 0.0
    history: tuple[Mapping[str, Any], ...] = ()
    stopped: str = ""
    notes: tuple[str, ...] = ()
    own: Mapping[tuple[int, int], Floats] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Correction({self.design.name!r}, {self.side}, round {self.round}): {self.summary}"

    @property
    def summary(self) -> str:
        """What was done, in a sentence."""
        if self.stopped:
            return self.stopped
        nano = 1e9 * self.design.unit_m
        return f"{nano * self.rms:.3g} nm rms of form taken off (known to {nano * self.doubt:.2g} nm)"

    @cached_property
    def _window(self) -> Window:
        """The sheet as designed."""
        return prescribe(self.design)

    @cached_property
    def _side(self) -> Side:
        """The side as designed."""
        return _side(self._window, self.side, self.design.unit_m)

    @cached_property
    def face(self) -> dict[str, float]:
        """Conic nearest to the command: radius, conic constant, and the rms (design units) that it leaves."""
        side = self._side
        u, v = places(side)
        inside = side.aperture.holds(u, v)
        u, v, z = u[inside], v[inside], self.heights.ravel()[inside]
        spline = _surface(self.heights, side)
        found = fit_heights(side.aperture, lambda x, y: spline(x, y), side.lenslet)
        rest = z - conic(found, u, v, slopes=False)[0]
        return {
            "radius": 1.0 / float(found[3]),
            "conic": float(found[4]),
            "astigmatism": 2.0 * float(found[5]),
            "rms": float(np.sqrt(np.mean((rest - rest.mean()) ** 2))),
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready state: lengths in the design's unit."""
        return {
            "format": FORMAT,
            "design": {"name": self.design.name, "sha256": self.design.sha256, "unit_m": self.design.unit_m},
            "side": self.side,
            "round": self.round,
            "rms": self.rms,
            "u_rms": self.doubt,
            "face": self.face,
            "history": [dict(one) for one in self.history],
            "notes": list(self.notes),
        }

    def added(self) -> Floats:
        """Command less the design (128, 128), length, of every cell; NaN off the cell."""
        return np.asarray(self.heights - _designed(self._side))

    def _in_cell(self, cell: tuple[int, int]) -> Floats:
        """Command (128, 128), length, of a cell of the sheet, above the plane of the apexes; NaN off it."""
        side = self._side
        heights = side.heights(np.array(cell), *places(side)).reshape(NODES, NODES) + self.added()
        return heights + _added(self.own[cell], side) if cell in self.own else heights

    def _form_rows(self) -> Floats:
        """Forms that the command adds to the faces of the sheet, as `process.command` reads them."""
        side, half = self._side, 0.5 * _box(self._side)
        u, v = places(side)
        added = self.added().ravel()
        held = np.isfinite(added)
        near = np.where(side.aperture.holds(u[held], v[held]), 1.0, OUTSIDE)
        base = legendre(u[held] / half[0], v[held] / half[1], TERMS)
        fit = -side.face.side * np.linalg.pinv(base * near[:, None]) * near
        own = [[*cell, *(fit @ _added(form, side).ravel()[held])] for cell, form in sorted(self.own.items())]
        count = self._window.lattice.count
        return form_rows(half * side.signs, count, fit @ added[held], np.array(own))

    def next_design(self, others: Sequence[Correction] = ()) -> tuple[Design, Floats]:
        """Design whose faces are the commands, and what they leave of this side's, (128, 128) lengths.

        Each face is the nearest even polynomial: radii, conic constants as before, terms a4, a6, a8. The
        height of its apex is no part of a command.

        others : Correction of the other side, where it has one.

        Raises NotPossible: Cells of their own, tilted lenses, or faces that no design file lists.
        """
        window = self._window
        if not (window.uniform and all(face.untilted for face in window.faces)):
            raise NotPossible(
                f"no next design: {self.design.name} has lenses of its own in each cell, or tilted ones; the"
                " command of each is its own design plus the added form (added-*.npy); process.command adds"
                " it in tooling"
            )
        found = [face.surface for face in window.faces]
        rest = np.full((NODES, NODES), np.nan)
        for one in (*others, self):  # this side last: what is left is its own
            side = one._side
            (u, v), heights = places(side), one.heights.ravel()
            held = np.isfinite(heights)
            x, y = (sign * w[held] - at for sign, w, at in zip(side.signs, (u, v), side.face.vertex))
            z = -side.face.side * heights[held]
            fitted, rise, _ = nearest_polynomial(side.face.surface, x, y, z)
            found[side.number] = fitted
            left = heights[held] + side.face.side * (fitted.sag(x, y) + rise)
        rest.ravel()[held] = left
        offset = window.faces[-1].vertex[:2]
        try:
            faces = tuple(face_spec(one) for one in found)
            design = given_design(self.design, window, faces, offset if any(offset) else None)
        except DesignError as error:
            raise NotPossible(f"no next design: {str(error).splitlines()[0]}") from error
        return design, rest

    @cached_property
    def no_next_design(self) -> str:
        """Why no design file can hold the command; "" where one can."""
        try:
            self.next_design()
        except NotPossible as error:
            return str(error)
        return ""

    def dose(self, calibration: str | os.PathLike[str] | None = None) -> Ints:
        """Levels (128, 128) of the command for greyscale exposure, 0 to 255; 0 outside the cell.

        calibration : Table by `clacad calibrate`; None: levels in proportion to depth.
        Raises BadRequest: A depth lies outside the table.
        """
        depth = (np.nanmax(self.heights) - self.heights) * self.design.unit_m
        held = np.isfinite(depth)
        deepest = float(depth[held].max())
        table = Calibration.straight(deepest) if calibration is None else read_calibration(Path(calibration))
        levels, _ = table.level_of(np.where(held, depth, table.depths[0]))
        return np.where(held, levels, 0)

    def write(
        self,
        folder: str | os.PathLike[str],
        *,
        overwrite: bool = False,
        calibration: str | os.PathLike[str] | None = None,
    ) -> list[Path]:
        """Write the command as a height map (NPY, JSON) and the state of the loop; return their paths.

        Next to it the form that is added to the design of every cell and, where a design file can hold the
        commands of all corrected sides, `next.toml` and what its face leaves of the command. Of differing
        lenslets the own form of each measured one: a row i, j, coefficients of `cells-front.npy`, and its
        command at the same place of `command-cells-front.npy`. `form-front.npy` holds the added forms for
        `process.command`. For greyscale
        also the levels of its dose, a PNG whose first row has the largest y. Files of an earlier round of the
        same side are replaced.

        Raises CannotWrite, ExportRefused; BadRequest, UnreadableFile: As `dose`.
        """
        state, command = _names(self.side)
        scale = millimetres(self.design.unit_m)
        steps = _box(self._side) / NODES * scale
        scales = {"pixel_mm": steps.tolist(), "z_step_mm": scale, "z_at_0_mm": 0.0, "row_0": "bottom"}
        maps = {command: self.heights, f"added-{self.side}.npy": self.added()}
        contents: dict[str, str | bytes] = {command: _npy(self.heights)}
        if not self.no_next_design:
            design, maps[f"rest-{self.side}.npy"] = self.next_design(self._other(folder))
            contents[NEXT] = design.canonical_toml()
        if self.own:
            cells = sorted(self.own)
            contents[_of_cells(self.side)] = _npy(np.array([[*cell, *self.own[cell]] for cell in cells]))
            maps[f"command-cells-{self.side}.npy"] = np.array([self._in_cell(c) for c in cells[:MOST_CELLS]])
        contents[form_name(self.side)] = _npy(self._form_rows())
        for name, heights in maps.items():
            contents[name] = _npy(heights)
            contents[f"{name}.json"] = json.dumps(scales, indent=1, sort_keys=True) + "\n"
        contents[state] = canonical_json(self.to_dict())
        if self.design.check.process == "greyscale" or calibration is not None:
            from PIL import Image

            picture = io.BytesIO()
            Image.fromarray(self.dose(calibration)[::-1].astype(np.uint8)).save(picture, "PNG")
            contents[f"dose-{self.side}.png"] = picture.getvalue()
        known = [path for path in (Path(folder) / _names(side)[0] for side in AXES) if _ours(path)]
        write_set(folder, contents, overwrite=overwrite, replace=lambda _path: bool(known))
        return [Path(folder) / name for name in contents]

    def _other(self, folder: str | os.PathLike[str]) -> list[Correction]:
        """Correction of the other side in a folder, of the same design."""
        other = OTHER[self.side]
        if not (Path(folder) / _names(other)[0]).exists():
            return []
        side = _side(self._window, other, self.design.unit_m)
        return [_previous(self.design, other, folder, side)]


def correct(
    design: Design,
    measured: Map | tuple[Map, tuple[int, int]],
    *,
    side: str = "front",
    previous: str | os.PathLike[str] | Correction | None = None,
    z_scale: Stated = None,
    lateral_scale: Stated = None,
    tilted: str | os.PathLike[str] | None = None,
    unit: str | None = None,
) -> Correction:
    """Correct the commanded shape of one side by a height map of the part that was made with it.

    Parameters
    ----------
    design : Design
    measured : path or MeasuredMap
        Height map of the made part as `measure` reads it, or a deviation map next to the measured.json that
        `verify -o` wrote; with (i, j) of the cell nearest to its middle: the map, the cell.
    side : "front" or "back"
        Side that the map shows.
    previous : path, Correction or None
        Folder of the last round, or its result; None: the part was made from the design itself.
    z_scale, lateral_scale, tilted, unit
        As `measure` takes them. Without a known scale of heights one round is made, no second.

    Returns
    -------
    Correction
        With `stopped` where no correction can be made.

    Raises
    ------
    UnreadableFile, OverBudget, NotPossible
        As `measure`.
    BadRequest
        The state of the last round is of another design, or the map was used before.

    Examples
    --------
    >>> import numpy as np
    >>> import clacad
    >>> from clacad.measuring.read_map import cloud_map
    >>> design = clacad.load("window-100mm")
    >>> x, y = np.meshgrid(8e-6 * np.arange(200), 8e-6 * np.arange(200))  # three cells, metres
    >>> u, v = (x + 250e-6) % 500e-6 - 250e-6, (y + 250e-6) % 500e-6 - 250e-6
    >>> z = 0.97 * (np.sqrt(2468.14e-6**2 - u**2 - v**2) - 2468.14e-6)  # 3 % lower than commanded
    >>> made = cloud_map("made", np.stack([x.ravel(), y.ravel(), z.ravel()]))
    >>> found = clacad.correct(design, made, z_scale="1 +- 1e-4")
    >>> found.round, round(found.face["radius"], 2)  # the designed sag over 0.97 once more
    (1, 2.4)
    """
    if side not in ("front", "back"):
        raise BadRequest(f"side {printable(str(side))[:40]}: it is front or back")
    name = cast(Name, side)
    design = replace(design, process=replace(design.process, command=None))
    measured, cell = measured if isinstance(measured, tuple) else (measured, None)
    window = prescribe(design)
    of = _side(window, name, design.unit_m)
    last = _previous(design, name, previous, of)
    digest = "" if isinstance(measured, MeasuredMap) else file_hash(Path(measured))
    if digest and any(one.get("sha256") == digest for one in last.history):
        raise BadRequest(
            f"{Path(cast(str, measured)).name} was corrected in an earlier round; measure the next part"
        )
    maps = Maps(None, None, tilted, z_scale, lateral_scale, unit, cell)
    points, heights, facts, cells = _deviation(design, window, of, measured, maps)
    facts |= {"sha256": digest} if digest else {}
    found, doubt = _form(points, of)
    each = {} if cells is None else _forms(points, cells, of)
    alone = [*each.values()] or [(found, doubt)]
    rms = [np.array([_rms(one, of.aperture, k == 1) for one in pair]) for k, pair in enumerate(zip(*alone))]
    made = replace(last, round=last.round + 1, rms=_mean(rms[0]), doubt=_mean(rms[1]))
    facts |= {"round": made.round, "rms": made.rms}
    notes = tuple(_notes(design, of, heights, each))
    why = _why_stopped(last, made, heights)
    if why:
        return replace(made, round=last.round, stopped=why, notes=notes)
    own = dict(last.own) | {
        at: last.own.get(at, np.zeros(TERMS)) + np.pad(found - form, (0, TERMS - len(found)))
        for at, (form, _) in each.items()
    }
    commanded = last.heights - _added(found, of)
    return replace(made, heights=commanded, history=(*last.history, facts), notes=notes, own=own)


def _form(points: Points, side: Side) -> tuple[Floats, Floats]:
    """Coefficients (c,) of the form of deviations, without height and tilt, and their uncertainty."""
    u, v, off, pixel = points
    found, doubt = pooled_form(u, v, off, side.aperture, pixel)
    found, doubt = found * np.maximum(0.0, 1.0 - doubt**2 / np.maximum(found**2, 1e-300)), doubt.copy()
    found[:FIRST] = doubt[:FIRST] = 0.0
    return found, doubt


def _forms(points: Points, cells: Ints, side: Side) -> dict[tuple[int, int], tuple[Floats, Floats]]:
    """The form of each cell's deviations, as `_form`; cells (n, 2) of the points."""
    u, v, off, pixel = points
    found, number = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(number.ravel(), kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(number.ravel()))[:-1])
    return {
        (int(i), int(j)): _form((u[rows], v[rows], off[rows], pixel), side)
        for (i, j), rows in zip(found, parts, strict=True)
    }


def _mean(one: Floats) -> float:
    return float(np.sqrt(np.mean(one**2)))


def _why_stopped(last: Correction, made: Correction, heights: Scale) -> str:
    """Reason for no correction; "" where one is made."""
    nano = 1e9 * made.design.unit_m
    if made.rms <= made.doubt:
        return (
            f"nothing to correct: the form is {nano * made.rms:.2g} nm rms off, its uncertainty is"
            f" {nano * made.doubt:.2g} nm"
        )
    if last.round and heights.origin == HEIGHTS.origin:
        return (
            f"stopped after round {last.round}: the scale of heights is assumed to be {heights.value:g} ±"
            f" {percent_text(heights.half, 2)}, a second round would follow its error: state it (--z-scale)"
            " or give a tilted map (--tilted)"
        )
    return ""


def _notes(design: Design, side: Side, heights: Scale, each: Sized) -> Iterator[str]:
    """What limits the loop."""
    if heights.origin == HEIGHTS.origin:
        yield "the scale of heights is not known: one round only (--z-scale, --tilted)"
    elif heights.half > 1e-3:
        yield f"the loop ends at the error of the scale of heights, {percent_text(heights.half, 2)}"
    if not side.alike:
        words = "the form that all of them share is corrected"
        words += f", and what {len(each)} measured ones have of their own" if each else ""
        yield f"every lenslet is compared with its own cell; {words}"
    process = process_of(design)
    step = process.layer or level_step(process, side.sag * design.unit_m)
    if step:
        what = f"layers of {1e9 * step:.3g} nm" if process.layer else f"{process.levels} levels"
        yield f"{what}: {1e9 * step_rms(step):.3g} nm rms remain in every round"
    if process.nose:
        yield f"the nose of {1e6 * process.nose:.3g} µm rounds every seam: nothing can be commanded there"


def _rms(form: Floats, aperture: Aperture, alone: bool = False) -> float:
    """Rms (length) over the aperture of a form by its coefficients, or of independent errors of them."""
    line = (np.arange(40) + 0.5) / 20.0 - 1.0
    s, t = (one.ravel() for one in np.meshgrid(line, line))
    inside = aperture.holds(s * aperture.half[0], t * aperture.half[1])
    basis = legendre(s[inside], t[inside], len(form))
    square = (basis**2).mean(axis=0) @ form**2 if alone else np.mean((basis @ form) ** 2)
    return float(np.sqrt(square))


def _added(form: Floats, side: Side) -> Floats:
    """Heights (NODES, NODES) of a form over a cell, carried on to its rim within `FARTHEST` of its range."""
    u, v = places(side)
    half = side.aperture.half
    off = legendre((u - side.lenslet[0]) / half[0], (v - side.lenslet[1]) / half[1], len(form)) @ form
    known = off[side.aperture.holds(u, v)]
    middle, reach = 0.5 * (known.max() + known.min()), 0.5 * FARTHEST * float(np.ptp(known))
    return np.clip(off, middle - reach, middle + reach).reshape(NODES, NODES)


# -- the cell ------------------------------------------------------------------------------------------------


def _side(window: Window, name: Name, unit_m: float) -> Side:
    return sides_of(window, 1e-3 / unit_m)[name]


def _box(side: Side) -> Floats:
    """Sides (2,) of the box around a cell."""
    return np.asarray(2.0 * np.abs(side.lattice.tile()).max(axis=0))


def places(side: Side) -> tuple[Floats, Floats]:
    """Places (n,) of a command's heights, in the axes of a map of that side."""
    steps = (np.arange(NODES) - NODES // 2) / NODES
    width, height = _box(side)
    u, v = np.meshgrid(width * steps, height * steps)
    return u.ravel(), v.ravel()


def _designed(side: Side) -> Floats:
    """Command of the design itself; NaN outside the cell."""
    u, v = places(side)
    inside = (side.lattice.past_borders(u, v) <= 1e-9 * side.lattice.circumradius).all(axis=0)
    return np.where(inside, side.outward(u, v), np.nan).reshape(NODES, NODES)


def _surface(heights: Floats, side: Side) -> Any:
    """Bicubic surface through a command, as a function of places; holes are filled by the design."""
    from scipy.interpolate import RectBivariateSpline

    u, v = (one.reshape(NODES, NODES) for one in places(side))
    whole = np.where(np.isfinite(heights), heights, side.outward(u.ravel(), v.ravel()).reshape(u.shape))
    spline = RectBivariateSpline(v[:, 0], u[0], whole)
    return lambda x, y: np.asarray(spline(y, x, grid=False))


# -- the measured part ---------------------------------------------------------------------------------------

Map = str | os.PathLike[str] | MeasuredMap

Points = tuple[Floats, Floats, Floats, float]
"""Places of all measured points in their cells, deviations there, and the distance of neighbouring points."""


def _deviation(
    design: Design,
    window: Window,
    side: Side,
    measured: Map,
    maps: Maps,
) -> tuple[Points, Scale, dict[str, Any], Ints | None]:
    """Deviations of a measured part, its scale of heights, what is recorded of it, and the cells of points.

    The cells are None where all lenslets are alike, or a map does not show which cells are in it.
    """
    if not isinstance(measured, MeasuredMap):
        path = Path(measured)
        if path.name.startswith("deviation") and path.suffix == ".npy":
            return _of_deviation_map(design, side, path)
    found, heights, _ = fitted_sides(
        design, window, maps.of(side.name, measured if maps.cell is None else (measured, maps.cell))
    )
    one = found[side.name]
    check = design.check
    rms = law_rms_of_form(window, {side.name: one.lit}, check.field, check.field_centre)
    number, (u, v, z) = one.lenslets.placed(one.measured.points)
    held = number >= 0
    u, v, z = u[held], v[held], z[held]
    facts = {"file": one.measured.name, "law_rms": rms if isfinite(rms) else None}
    number = number[held]
    points = u, v, z - _wished(one, number, u, v), max(one.measured.pixel)
    return points, heights, facts, _shown(one.lit.cells, one.lenslets.index[number])


def _wished(of: Surface, number: Ints, u: Floats, v: Floats) -> Floats:
    """Designed heights (n,) over places in the cells of lenslets `number`, each of its own cell."""
    side = of.lit.side
    if side.alike:
        return side.outward(u, v)
    found = np.empty(len(u))
    cells = of.lit.cells.of(of.lenslets.index)
    for k in np.unique(number):
        here = number == k
        found[here] = side.heights(cells[k], u[here], v[here])
    return found


def _of_deviation_map(
    design: Design, side: Side, path: Path
) -> tuple[Points, Scale, dict[str, Any], Ints | None]:
    """Deviations of a map that `verify -o` wrote, by the lattice in the measured.json next to it."""
    numbers = _read_json(path.with_name(NUMBERS))
    try:
        if numbers["design"]["sha256"] != design.sha256:
            raise BadRequest(f"{path.name}: it was measured against another design or other keys")
        of = numbers["sides"][side.name]
        origin, *steps = np.array(of["lattice"], dtype=np.float64)
        level, plane = np.array(of["level"]), np.array(of["plane"])
        scale = Scale(numbers["z_scale"], 2.0 * numbers["u_z_scale"], numbers["z_scale_origin"])
        facts = {"file": path.name, "law_rms": numbers["law_rms"]}
        (i, j), (of_i, of_j) = map(int, of["first_cell"]), of["first_cell_known_by"]
    except (KeyError, TypeError, ValueError) as error:
        raise BadRequest(
            f"{path.name}: {NUMBERS} next to it holds no lattice of the {side.name}; measure again with"
            " clacad verify --role scan -o"
        ) from error
    measured = read_map(path).scaled(design.unit_m, design.unit_m)
    lattice = Found(origin, np.column_stack(steps))
    x, y, off = measured.points
    u, v, step = _levelled(lattice, level, plane, side, (x, y, off))
    cells = ShownCells(side, (i, j), (of_i, of_j))
    return (u, v, off, max(measured.pixel)), scale, facts, _shown(cells, step)


def _shown(cells: ShownCells, step: Ints) -> Ints | None:
    """Cells (n, 2) of the sheet at steps (n, 2) of a map's lattice; None where they do not matter, or it does
    not show which they are.
    """
    return None if cells.side.alike or "assumed" in cells.known else cells.of(step)


def _levelled(
    lattice: Found, level: Floats, plane: Floats, side: Side, points: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats, Ints]:
    """Places in their cells of points of a map with the deviations there, and steps (n, 2) of the
    map's lattice to these cells; the map may be tilted.
    """
    x, y, off = points
    along = lattice.basis[:, 0] / np.hypot(*lattice.basis[:, 0])
    axes = np.array([[along[0], -along[1]], [along[1], along[0]]])
    place = np.stack([x, y])
    for _ in range(4):
        cell, aside = lattice.nearest(place[0], place[1])
        u, v = axes.T @ aside
        height = plane[0] + plane[1:] @ place + side.outward(u, v) + off
        seen = level.T @ np.vstack([place, height])
        place = place + np.stack([x, y]) - seen[:2]
    return u, v, cell.T


def _read_json(path: Path) -> dict[str, Any]:
    from clacad.base.untrusted_files import read_regular

    try:
        found = json.loads(read_regular(path, LONGEST))
    except (OSError, ValueError, RecursionError) as error:
        raise BadRequest(f"{path.name} cannot be read: {printable(str(error))[:80]}") from error
    if not isinstance(found, dict):
        raise BadRequest(f"{path.name}: not a JSON object")
    return found


def _npy(heights: Floats) -> bytes:
    data = io.BytesIO()
    np.save(data, heights, allow_pickle=False)
    return data.getvalue()


# -- state of the loop ---------------------------------------------------------------------------------------


def _names(side: Name) -> tuple[str, str]:
    """Names of the files of a side: state of the loop, and command."""
    return f"correction-{side}.json", f"command-{side}.npy"


def _previous(
    design: Design, name: Name, previous: str | os.PathLike[str] | Correction | None, side: Side
) -> Correction:
    """The command that the measured part was made from."""
    if isinstance(previous, Correction):
        if previous.design.sha256 != design.sha256 or previous.side != name:
            raise BadRequest("the last round is of another design or side")
        return replace(previous, stopped="", notes=())
    state, command = _names(name)
    if previous is None or not (Path(previous) / state).exists():
        return Correction(design, name, 0, _designed(side))
    found = _read_json(Path(previous) / state)
    try:
        known = found["design"]["sha256"], found["side"], int(found["round"]), tuple(found["history"])
        heights = np.load(Path(previous) / command, allow_pickle=False)
        if heights.shape != (NODES, NODES) or heights.dtype != np.float64:
            raise ValueError(f"{command} holds other heights")
    except (KeyError, TypeError, ValueError, OSError, EOFError) as error:
        raise BadRequest(f"{state} is no state of a correction: {printable(str(error))[:80]}") from error
    if known[:2] != (design.sha256, name):
        raise BadRequest(
            f"{Path(previous) / state} is of another design, other keys or side; choose another folder"
        )
    return Correction(design, name, known[2], heights, history=known[3], own=_own_of(Path(previous), name))


def _of_cells(side: Name) -> str:
    return f"cells-{side}.npy"


def _own_of(folder: Path, name: Name) -> dict[tuple[int, int], Floats]:
    """Own forms of cells that an earlier round wrote."""
    path = folder / _of_cells(name)
    if not path.exists():
        return {}
    try:
        table = np.load(path, allow_pickle=False)
        if table.ndim != 2 or table.shape[1] != 2 + TERMS or not np.isfinite(table).all():
            raise ValueError("it holds no rows of a cell and its coefficients")
    except (ValueError, OSError, EOFError) as error:
        raise BadRequest(f"{path.name} is no state of a correction: {printable(str(error))[:80]}") from error
    return {(int(i), int(j)): row for (i, j), row in zip(table[:, :2], table[:, 2:], strict=True)}


def _ours(state: Path) -> bool:
    """Whether a folder holds the state of a correction."""
    try:
        return '"u_rms"' in state.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
