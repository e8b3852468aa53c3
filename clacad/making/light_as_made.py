"""Light through a sheet as its process makes it, next to the same light through the sheet as designed.

Two numbers of error: of all light, and of light clear of rounded seams, with the share that met a rounding.
Texture is a third number, a share of light that is left undisturbed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import exp, inf, nan, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, percent_text, plain, table
from clacad.base.types import Floats
from clacad.checks.check import Check
from clacad.checks.file_kinds import MADE_LIGHT, MADE_SEAM, MADE_TEXTURE
from clacad.design.process import Process, process_of
from clacad.light.measure import Light, measure
from clacad.making.texture import texture_of, texture_phase
from clacad.measuring.light_through_form import PHASE, mean_error
from clacad.optics.rays import Fate, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, launched
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH
from clacad.sheet.window import Body, Window
from clacad.storage.errors import NotPossible
from clacad.tracing.facets.made_surface import Lenslet, MadeSurface, made_face, made_surface, read_curve
from clacad.tracing.facets.telescopelet import FacetBody, trace_facets
from clacad.tracing.worst_cell import worst_cell

if TYPE_CHECKING:
    from clacad.design import Design

RAYS = 8192
"""Rays of the cell, as in a check."""

ON_A_BASE = ("two-photon", "greyscale")
"""Processes whose lenslets shrink on a base that keeps its thickness."""

TRIAL_RAYS = 1024
"""Rays by which each parameter of the process is tried alone."""


@dataclass(frozen=True, eq=False)
class Made:
    """The faces of one cell as made, ready for light; `window` is the sheet as designed, uniform."""

    window: Window
    process: Process
    faces: tuple[tuple[MadeSurface, MadeSurface], ...]

    @staticmethod
    def of(window: Window, process: Process, curve: str | None = None) -> Made:
        """Prepare every face of a sheet of identical cells.

        curve : Path of the table of `process.curve`.
        Raises NotPossible.
        """
        if window.lattice_of(0) != window.lattice_of(1):
            raise NotPossible(
                "a sheet whose arrays have different cells (lattice.pitch_2, rotation_2) is not judged as"
                " made; leave them out"
            )
        depths = None if curve is None else read_curve(curve)

        def both(body: Body) -> tuple[MadeSurface, MadeSurface]:
            front, back = (made_surface(window, face, process, depths) for face in (body.front, body.back))
            return front, back

        return Made(window, process, tuple(both(body) for body in window.bodies))

    @property
    def lateral(self) -> Floats:
        """1 − shrinkage along x and y, (2,)."""
        return 1.0 - np.asarray(self.process.shrinkage[:2])

    def bundle(self, lit: Bundle) -> Bundle:
        """The bundle over the made cell, about the same centre."""
        if (self.lateral == 1.0).all():
            return lit
        return launched(
            self.window,
            lit.points * self.lateral,
            lit.rays.direction,
            lit.cell,
            lit.middle,
            lit.field,
            lit.aperture,
        )

    def __call__(self, lit: Bundle) -> TraceResult:
        """Send a bundle through the cell as made; `Send`."""
        return trace_facets(self.bodies(lit.cell), lit.rays)

    def bodies(self, cell: tuple[int, int]) -> tuple[FacetBody, ...]:
        """The bodies of one cell for `trace_facets`."""
        found = []
        for body, (front, back) in zip(self.window.bodies, self.faces, strict=True):
            faces = [made_face(one, np.array([*self._centre(one, cell), 0.0])) for one in (front, back)]
            found.append(FacetBody(faces[0], faces[1], body))
        return tuple(found)

    def _centre(self, one: MadeSurface, cell: tuple[int, int]) -> Floats:
        """Centre (2,) of the made cell of a face: the sheet shrinks about the centre of its first cell."""
        index = np.array(cell, dtype=np.int64)
        first = np.asarray(self.window.centres(0, index))
        return np.asarray(first + (self.window.centres(one.face.array or 0, index) - first) * self.lateral)


@dataclass(frozen=True, slots=True)
class LightAsMade:
    """Numbers of light through a sheet as designed and as made.

    Parameters
    ----------
    process : Process
        Lengths in metres.
    designed : float, radians
        Rms error to the law as designed.
    formed, everything : float, radians
        Rms error as made: of light clear of roundings, and of all light.
    bias : float, radians
        Mean difference of direction to the law of light clear of roundings, as made.
    share_designed, share_formed, share_rounded : float
        Shares of all light that pass as designed; clear of roundings; and that pass but met one.
    texture : float, metres
        Largest rms height of texture on one face.
    phase : float, radians
        Its rms phase.
    undisturbed : float
        Share of light that all faces' texture leaves; NaN above 1 rad.
    """

    process: Process
    designed: float
    formed: float
    everything: float
    bias: float
    share_designed: float
    share_formed: float
    share_rounded: float
    texture: float
    phase: float
    undisturbed: float

    @property
    def share_of_passing(self) -> float:
        """Rounded light over all light that passes."""
        passing = self.share_formed + self.share_rounded
        return self.share_rounded / passing if passing else nan

    def rows(self) -> list[tuple[str, str, str]]:
        """Table: quantity, as designed, as made."""
        made = f"{self.texture * 1e9:.3g} nm, phase {self.phase:.2g} rad"
        kept = (
            "not known above 1 rad"
            if self.undisturbed != self.undisturbed
            else percent_text(self.undisturbed, 2)
        )
        return [
            ("error of light clear of roundings, rms", mrad_text(self.designed), mrad_text(self.formed)),
            ("error of all light, rms", mrad_text(self.designed), mrad_text(self.everything)),
            ("mean error of light clear of roundings", "", mrad_text(self.bias)),
            (
                "light that passes clear of roundings",
                percent_text(self.share_designed),
                percent_text(self.share_formed),
            ),
            ("light that passes but met a rounding", percent_text(0.0), percent_text(self.share_rounded)),
            ("texture of a face, rms", "", made),
            ("light that texture leaves undisturbed", percent_text(1.0), kept),
        ]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready mapping; radians and metres, shares of all light."""
        found = {name: getattr(self, name) for name in self.__slots__ if name != "process"}
        plain_: dict[str, Any] = plain({"process": asdict(self.process), **found})
        return plain_


def light_as_made(
    design: Design, window: Window, rays: int = RAYS, process: Process | None = None
) -> LightAsMade:
    """Measure light through a sheet as its process makes it.

    Parameters
    ----------
    design : Design
        Gives the field, and the process where none is given.
    window : Window
        Sheet of identical cells, or the uniform equivalent of one cell.
    rays : int
    process : Process or None

    Returns
    -------
    LightAsMade

    Raises
    ------
    NotPossible
        The tool does not fit, or the sheet cannot be judged as made.

    Examples
    --------
    >>> import clacad
    >>> from clacad.making.light_as_made import light_as_made
    >>> design = clacad.load("window-100mm", ["lattice.count = [3, 3]"])
    >>> found = light_as_made(design, clacad.prescribe(design), rays=1024)
    >>> found.share_formed < found.share_designed
    True
    """
    chosen = process_of(design) if process is None else process
    ideal, _ = _lit(design, Made.of(window, Process()), rays)
    formed, everything = _lit(design, made_of(design, window, chosen), rays)
    texture, phase, kept = _texture(window, chosen)
    return LightAsMade(
        chosen,
        ideal.rms,
        formed.rms,
        everything.rms,
        mean_error([formed]),
        ideal.share,
        formed.share,
        everything.share - formed.share,
        texture,
        phase,
        kept,
    )


def made_of(design: Design, window: Window, process: Process | None = None) -> Made:
    """Prepare a sheet of identical cells as made; the table of `process.curve` lies next to the design.

    Raises NotPossible.
    """
    one = process_of(design) if process is None else process
    curve = None if one.curve is None else os.path.join(os.path.dirname(design.path), one.curve)
    return Made.of(window, one, curve)


def _lit(design: Design, made: Made, rays: int) -> tuple[Light, Light]:
    """Light clear of roundings, and all light, over one cell."""
    window, spec = made.window, design.check
    lit = made.bundle(bundle(window, rays, spec.field, spec.field_centre))
    formed = measure(made, lit, RequestedLaw.of(window))
    fate = np.where(formed.seen.fate == Fate.LAND, np.uint8(Fate.ALIVE), formed.seen.fate)
    return formed, replace(formed, seen=replace(formed.seen, fate=fate))


def _texture(window: Window, process: Process) -> tuple[float, float, float]:
    """Largest rms height of texture, metres; its phase, radians; share that all faces' texture keeps."""
    wave = window.wavelength or DEFAULT_WAVELENGTH
    found = []
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array is not None:
                low, high = Lenslet(window, face).span
                texture = texture_of(process, (high - low) * window.unit)
                found.append((texture, texture_phase(texture, body.index, wave)))
    total = sum(phase * phase for _, phase in found)
    kept = exp(-total) if all(phase <= PHASE for _, phase in found) else nan
    return max((one for one, _ in found), default=0.0), max((one for _, one in found), default=0.0), kept


# --- checks and advice --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Cost:
    """What one parameter of a process costs alone.

    Parameters
    ----------
    key : str
        Its key of section [process].
    error : float, radians
        Rms error of light clear of roundings that it adds in squares; 0 for what bends no light.
    light : float
        Share of light that it takes: rounded, or disturbed by texture.
    needed : str
        Tolerance or limit it needs, as text; "" where none follows.
    """

    key: str
    error: float
    light: float
    needed: str

    def __str__(self) -> str:
        """What it costs, in a few words."""
        costs = [mrad_text(self.error, 3)] if self.error else []
        costs += [f"{percent_text(self.light, 2)} of the light"] if self.light else []
        return f"process.{self.key} {' and '.join(costs) or 'nothing'}"


@dataclass(frozen=True)
class JudgedAsMade:
    """A design as made: its numbers, checks, and what each parameter of the process costs."""

    light: LightAsMade
    checks: tuple[Check, ...]
    costs: tuple[Cost, ...]

    @property
    def advice(self) -> tuple[str, ...]:
        """Sentences: the parameter that costs most error, and the one that costs most light."""
        found = []
        error = max(self.costs, key=lambda one: one.error, default=None)
        light = max(self.costs, key=lambda one: one.light, default=None)
        if error is not None and (
            error.error > 0.1 * self.light.designed or light is None or not light.light
        ):
            text = f"process.{error.key} costs most error: alone it adds {mrad_text(error.error)} rms"
            found.append(text + (f"; {error.needed}" if error.needed else ""))
        if light is not None and light.light > 0.0:
            text = f"process.{light.key} costs most light: {percent_text(light.light, 2)}"
            found.append(text + (f"; {light.needed}" if light.needed else ""))
        return tuple(found)

    def lines(self) -> list[str]:
        """Table of the numbers, and the advice."""
        head = (f"as made by {self.light.process.name}", "designed", "made")
        return [table([head, *self.light.rows()]), *(f"  {one}" for one in self.advice)]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready mapping."""
        return {
            **self.light.to_dict(),
            "costs": [plain(asdict(one)) for one in self.costs],
            "advice": list(self.advice),
        }


def judge_as_made(design: Design, window: Window, rays: int = RAYS) -> JudgedAsMade:
    """Judge light through a sheet as its process makes it; of a non-uniform sheet through its worst cell.

    Parameters
    ----------
    design : Design
    window : Window
        As built from it.
    rays : int

    Returns
    -------
    JudgedAsMade

    Raises
    ------
    NotPossible
        The tool does not fit, or the sheet cannot be judged as made.

    Examples
    --------
    >>> import clacad
    >>> from clacad.making.light_as_made import judge_as_made
    >>> design = clacad.load("window-100mm", ["lattice.count = [3, 3]"])
    >>> [check.id for check in judge_as_made(design, clacad.prescribe(design), rays=1024).checks]
    ['made_light', 'made_seam', 'made_texture']
    """
    seen = worst_cell(window, design.check.field)
    found = light_as_made(design, seen.like, rays)
    return JudgedAsMade(
        found, _checks(design, found, seen.words), tuple(costs_alone(design, seen.like, found))
    )


def _checks(design: Design, found: LightAsMade, cell: str) -> tuple[Check, ...]:
    """Three checks: error, rounded share, texture."""
    spec, name = design.check, found.process.name
    start = f"{cell}: " if cell else ""
    text = (
        f"{start}as made by {name}, light clear of roundings leaves {mrad_text(found.formed)} rms from the"
        f" law (designed {mrad_text(found.designed)}); all light {mrad_text(found.everything)}"
    )
    if found.formed != found.formed:
        text = f"{start}as made by {name}, too little light passes clear of roundings to say"
    seam = (
        f"{start}{percent_text(found.share_of_passing, 2)} of the light that passes meets a rounded seam:"
        f" {found.share_formed:.3f} of all light passes clear of it (designed {found.share_designed:.3f})"
    )
    texture = f"texture of {found.texture * 1e9:.3g} nm rms on a face, phase {found.phase:.2g} rad: "
    if found.undisturbed == found.undisturbed:
        texture += f"{found.undisturbed:.4f} of the light stays undisturbed"
    else:
        texture += f"above {PHASE:g} rad the share of undisturbed light is not known"
    bundle_text = f"{RAYS} Sobol rays over one cell"
    return (
        MADE_LIGHT.judge(found.formed, spec.law_rms, text, bundle=bundle_text),
        MADE_SEAM.judge(found.share_of_passing, spec.scan_seam, seam, bundle=bundle_text),
        MADE_TEXTURE.judge(found.phase, PHASE, texture, detail={"undisturbed": plain(found.undisturbed)}),
    )


def costs_alone(design: Design, window: Window, found: LightAsMade) -> Iterator[Cost]:
    """Cost of each parameter of the process, each alone on the sheet as designed."""
    process, spec = found.process, design.check
    limit = spec.law_rms

    def alone(**changes: Any) -> tuple[float, float]:
        """Added mean square error (radians²) and rounded share of passing light of parameters alone."""
        one = Process(process.name, **changes)
        formed, every = _lit(design, made_of(design, window, one), TRIAL_RAYS)
        added = formed.rms**2 - base**2
        return added, 1.0 - formed.share / every.share if every.share else nan

    base = _lit(design, Made.of(window, Process()), TRIAL_RAYS)[0].rms
    room = sqrt(limit * limit - base * base) if limit > base else 0.0
    for key, changes, written, step, tried in _bends(process):
        added = alone(**changes)[0] if changes else 0.0
        error = sqrt(max(0.0, added)) if added == added else inf
        needed = ""
        if tried is not None and room:
            allowed = _tolerance([alone(**tried(sign * step))[0] for sign in (1.0, -1.0)], step, room)
            needed = (
                f"known to {written(allowed)}, it leaves light within {mrad_text(limit)}" if allowed else ""
            )
        elif tried is not None:
            needed = f"the design itself has {mrad_text(base)} of {mrad_text(limit)}: no room for it"
        yield Cost(key, error, 0.0, needed)
    for key in ("nose", "spot"):
        if value := getattr(process, key):
            only = not (process.nose and process.spot)
            share = found.share_of_passing if only else alone(**{key: value})[1]
            largest = value * spec.scan_seam / share if share > 0.0 else inf
            needed = (
                f"up to {length_words(largest)} it takes less than {percent_text(spec.scan_seam)}"
                if share
                else ""
            )
            yield Cost(key, 0.0, share, needed)
    yield from _textures(window, process)


def length_words(metres: float) -> str:
    """A length as text with two digits."""
    return f"{metres * 1e9:.3g} nm" if metres < 1e-6 else f"{metres * 1e6:.3g} um"


def _tolerance(added: Sequence[float], step: float, room: float) -> float:
    """Error of a parameter at which the rms error reaches a limit; 0 where it never does.

    added : Mean square errors (radians²) that the errors +step and −step add: a parabola.
    room : radians. Error that the limit leaves, in squares.
    """
    up, down = added
    bend, slope = 0.5 * (up + down) / step**2, 0.5 * abs(up - down) / step
    if not bend > 0.0:
        return 0.0
    return 2.0 * room**2 / (slope + sqrt(slope**2 + 4.0 * bend * room**2))


def _bends(process: Process) -> Iterator[_Bend]:
    """Parameters that change the form: key, alone, text of a tolerance, a step, and errors of it alone."""
    follows = process.thickness == process.shrinkage[2] and process.name not in ON_A_BASE
    if any((*process.shrinkage, process.thickness)):
        changes = {"shrinkage": process.shrinkage, "thickness": process.thickness}

        def taller(error: float) -> dict[str, Any]:
            return {"shrinkage": (0.0, 0.0, error), "thickness": error if follows else 0.0}

        yield "shrinkage", changes, lambda one: f"{100 * one:.2g} %", 0.01, taller
    if process.gamma != 1.0 or process.name == "greyscale":
        changes = {"gamma": process.gamma} if process.gamma != 1.0 else {}
        yield "gamma", changes, lambda one: f"{one:.2g}", 0.02, lambda error: {"gamma": 1.0 + error}
    if process.curve is not None:
        yield "curve", {"curve": process.curve}, str, 1.0, None
    if process.sink:
        yield "sink", {"sink": process.sink}, length_words, process.sink, lambda error: {"sink": error}


def _textures(window: Window, process: Process) -> Iterator[Cost]:
    """Cost of feed, layer and levels: the light that their texture disturbs."""
    parts = {
        "feed": replace(process, layer=0.0, levels=0),
        "layer": replace(process, feed=0.0, levels=0),
        "levels": replace(process, feed=0.0, layer=0.0),
    }
    for key, one in parts.items():
        if getattr(process, key):
            _, phase, kept = _texture(window, one)
            known = kept == kept
            needed = "" if known else f"its phase of {phase:.2g} rad must be below {PHASE:g}"
            yield Cost(key, 0.0, 1.0 - kept if known else 1.0, needed)


_Bend = tuple[str, dict[str, Any], Callable[[float], str], float, Callable[[float], dict[str, Any]] | None]
