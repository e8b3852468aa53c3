"""Measures of light through one telescopelet as made, in the terms of lenslet sheets; each is a traced
number.
image shift
    Change of the exit direction of the ray through the middle of lens 1's cell; caused by decentred arrays.
slip, moiré period
    Change of that direction from cell to cell, expressed as the rate at which array 2 slips relative to array
    1 (the change per decentre is traced too). The moiré pattern repeats where the slip reaches one pitch:
    Hutley, Hunt, Stevens, Savander, Pure Appl. Opt. 3, 133 (1994).
residual power
    Convergence: minus the change of exit slope with entrance height of parabasal rays about that ray, less
    the power of a requested focus: 0 for an afocal pair. In dioptres.
blur
    Rms spread of the exit directions of parallel light over a cell.
throughput
    Share of the light of the field that stays in its telescopelet and is not scattered by rough faces.
law_rms, law_bias, eta, delta, kept
    Defined as in the checks of the same names (kept: throughput over the closed form), with fewer rays. Blur,
    law_rms and law_bias are those of the worst of the traced cells, the middle one and the farthest ones.
law_rms_x, law_rms_y
    Centre of the cell with that law_rms.
law_white, colour, temperature
    Defined as in the checks of the same names, of the worst of the traced cells; for designs that state them.

Errors that differ from lenslet to lenslet have a mean of 0 and a standard deviation σ. The mean squares of
law_rms, blur and law_white over all lenslets change by σ² times half their second derivative to the error of
one lenslet. That change is computed in the middle cell from errors of ±σ; those of several errors add up. The
mean throughput does not: light passes the rim of a lenslet from the first error on. Its change is the mean of
lenslets drawn with all errors at once. The other measures are of a mean direction and do not change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.design.sections import KELVIN
from clacad.effects.scatter import haze
from clacad.light.compare import WhiteLight, changed
from clacad.light.measure import FIT_SCALE, Light, Send, fitted_law, measure, rms_angles
from clacad.optics.law import Law, angle_between, difference_of_laws
from clacad.optics.rays import Rays, TraceResult
from clacad.optics.sequence import STEP, unit_directions
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, field_about, middle_direction
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH
from clacad.sheet.like_cell import heated, lit_by
from clacad.sheet.representative_cells import places_of_errors
from clacad.sheet.vignetting import share, thin_cells
from clacad.sheet.window import Window
from clacad.verification.tolerance.misaligned import Errors, telescopelet

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.design.limit_sections import CheckSpec


RAYS = 256
"""Rays of each bundle."""

DRAWN = 32
"""Lenslets drawn for the change of throughput by errors from lenslet to lenslet."""

FEWEST_OF_BEAM = 8
"""Least number of rays of a parallel beam that must get through."""

FEWEST_BY_BUNDLE: Mapping[str, int] = {"cone": 1, "narrow": 64}
"""Least number of rays of the other bundles that must get through."""

MEASURES: Mapping[str, str] = {
    "shift_x": "rad",
    "shift_y": "rad",
    "slip_xx": "",
    "slip_xy": "",
    "slip_yx": "",
    "slip_yy": "",
    "power_xx": "1/m",
    "power_xy": "1/m",
    "power_yx": "1/m",
    "power_yy": "1/m",
    "image_shift": "rad",
    "moire_rate": "",
    "moire_period": "m",
    "residual_power": "1/m",
    "blur": "rad",
    "throughput": "",
    "law_rms": "rad",
    "law_bias": "rad",
    "eta_x": "",
    "eta_y": "",
    "delta_x": "",
    "delta_y": "",
    "eta_error": "",
    "delta_error": "",
    "kept": "",
    "law_rms_x": "m",
    "law_rms_y": "m",
}
"""Name and unit of each measure. Those with an axis are signed and, for small errors, linear; the others are
derived."""

STATED: Mapping[str, str] = {"law_white": "rad", "colour": "rad", "temperature": "rad"}
"""Measures of a design that states its light, or a limit for it."""


def measures_of(design: Design) -> dict[str, str]:
    """Name and unit of each measure of a design's sheets."""
    light, check = design.light, design.check
    white = light.spectrum is not None or check.law_white is not None
    warm = light.temperature is not None or check.temperature is not None
    stated = {name: unit for name, unit in STATED.items() if (warm if name == "temperature" else white)}
    return {**MEASURES, **stated}


@dataclass(frozen=True, eq=False)
class BundleLight:
    """Light of one bundle through m cells, each number as `clacad.light.measure.Light` has it.

    alive : (m, n) bool; direction : (m, n, 3). Behind the sheet, without the requested focus.
    into, expected : (n, 3). Before the sheet, and behind it by the law.
    fewest : Least number of ALIVE rays for a result other than NaN.
    """

    alive: Bools
    direction: Floats
    into: Floats
    expected: Floats
    fewest: int

    @property
    def share(self) -> Floats:
        """ALIVE rays over all, (m,)."""
        return np.asarray(self.alive.mean(axis=1))

    @property
    def rms(self) -> Floats:
        """Rms angles (m,) to the law."""
        return self._rms(np.broadcast_to(self.expected, self.direction.shape))

    @cached_property
    def mean(self) -> Floats:
        """Mean exit directions (m, 3); NaN for too few rays."""
        count = self.alive.sum(axis=1)
        total = np.where(self.alive[..., None], self.direction, 0.0).sum(axis=1)
        return np.asarray(total / np.where(count < self.fewest, np.nan, count)[:, None])

    @property
    def bias(self) -> Floats:
        """Angles (m,) of the mean directions of parallel light to the law."""
        return angle_between(self.mean, self.expected[0])

    @property
    def spread(self) -> Floats:
        """Rms angles (m,) to the mean directions."""
        return self._rms(np.broadcast_to(self.mean[:, None], self.direction.shape))

    def _rms(self, to: Floats) -> Floats:
        angle = np.full(self.alive.shape, np.nan)
        angle[self.alive] = angle_between(self.direction[self.alive], to[self.alive])
        few = np.isfinite(angle).sum(axis=1) < self.fewest
        return np.where(few, np.nan, rms_angles(angle))

    def fitted(self, law: Law) -> Law | None:
        """Law of the light of the first cell in the axes of another; None for too few rays."""
        on = self.alive[0]
        return None if on.sum() < self.fewest else fitted_law(self.into[on], self.direction[0, on], law)


def _aside(errors: Errors) -> Floats:
    """Displacement (3,) of cell 1 as made: the light covers the whole sheet, so that it follows."""
    return np.array([errors.get("decentre.1.x", 0.0), errors.get("decentre.1.y", 0.0), 0.0])


@dataclass(frozen=True, eq=False)
class Bench:
    """A design's window with the rays and reference values that all samples share.

    window : Window
    law : RequestedLaw
    bundles : mapping
        Name to bundle, its rays about the cell's centre: the cone, the parallel beams, the narrow fit bundle,
        the parabasal rays.
    places : (m, 2) lengths
        Traced cells: the middle one and the farthest ones, nominal centres of cell 1.
    chief : (2,) slopes
        Nominal exit slopes of the chief ray, lens frame.
    per_decentre : (2, 2) 1/length
        Change of those slopes with the decentre of array 2.
    closed_form : float
        Share of the field's light that thin lenses keep.
    wavelength : float, metres
    lines : mapping of metres to weight. Lines of white light; empty where none are stated.
    kelvin : Change of temperature, up and down; 0 where none is stated.
    """

    window: Window
    law: RequestedLaw
    bundles: Mapping[str, Bundle]
    places: Floats
    chief: Floats
    per_decentre: Floats
    closed_form: float
    wavelength: float
    lines: Mapping[float, float] = field(default_factory=dict)
    kelvin: float = 0.0
    _sent: dict[tuple[tuple[str, int], ...], tuple[Any, ...]] = field(
        init=False, default_factory=dict, repr=False
    )
    _known: dict[tuple[str, float], Floats] = field(init=False, default_factory=dict, repr=False)
    _shares: dict[tuple[tuple[str, float], ...], float] = field(init=False, default_factory=dict, repr=False)

    def measured(self, errors: Errors) -> dict[str, float]:
        """All measures of the sheet made with these errors; NaN where too little light is transmitted."""
        errors, scatter = split(errors)
        step = np.array(self.window.lattice.pitch) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        beams = [name for name in self.bundles if name.startswith("beam")]
        asked = {name: self.places for name in ("cone", *beams)}
        seen = self.cells(errors, asked | {"narrow": self.places[:1], "chief": step})
        found = self._chief_measures(_slopes(seen["chief"], self.window))
        found |= _fitted(seen["narrow"].fitted(self.law.law), self.law.law)
        if self.lines or self.kelvin:
            stated = [self._stated(errors, place) for place in self.places]
            found |= {name: _worst([one[name] for one in stated]) for name in stated[0]}
        clear = 1.0 - self._haze(errors)
        added = self.scattered(scatter)
        rms = _with_squares(seen["cone"].rms.tolist(), added["law_rms"])
        kept = float(seen["cone"].share.min()) * clear + clear * added["throughput"]
        x, y = self.window.unit * self.places[_first_worst(rms)]
        if "law_white" in found:
            found["law_white"] = _with_squares([found["law_white"]], added["law_rms"])[0]
        return found | {
            "blur": _worst(_with_squares(seen["beam"].spread.tolist(), added["blur"])),
            "throughput": kept,
            "law_rms": _worst(rms),
            "law_bias": _worst([float(np.max(seen[name].bias)) for name in beams]),
            "kept": kept / self.closed_form if self.closed_form > 0.0 else np.nan,
            "law_rms_x": float(x),
            "law_rms_y": float(y),
        }

    def law_rms(self, errors: Errors) -> float:
        """The measure of that name alone."""
        errors, scatter = split(errors)
        rms = self.cells(errors, {"cone": self.places})["cone"].rms.tolist()
        return _worst(_with_squares(rms, self.scattered(scatter)["law_rms"]))

    @cached_property
    def expected(self) -> dict[str, Floats]:
        """Exit directions (n, 3) of the law for each bundle."""
        return {name: self.law.refract(one.rays.direction) for name, one in self.bundles.items()}

    def cells(self, errors: Errors, asked: Mapping[str, Floats]) -> dict[str, BundleLight]:
        """Light of bundles, each through cells at places (m, 2), of a sheet with these errors; one trace."""
        key = tuple((name, len(places)) for name, places in asked.items())
        if key not in self._sent:
            lit = [(self.bundles[name], m) for name, m in key]
            firsts = np.cumsum([0] + [m for _, m in key])
            which = [np.repeat(np.arange(m), len(b.rays)) + at for (b, m), at in zip(lit, firsts)]
            columns = ((b.rays.position, unit_directions(b.rays.direction)[0], b.points) for b, _ in lit)
            tiled = ([np.tile(one, (m, 1)) for one in three] for three, (_, m) in zip(columns, key))
            self._sent[key] = (*map(np.concatenate, zip(*tiled)), np.concatenate(which))
        start, way, points, cells = self._sent[key]
        made = telescopelet(self.window, errors, np.concatenate(list(asked.values())))
        seen, alive = made.through(start + _aside(errors), way, cells)
        out = self.law.without_focus(points, seen)
        found, at = {}, 0
        for name, m in key:
            into, wished = self.bundles[name].rays.direction, self.expected[name]
            n, few = len(into), FEWEST_BY_BUNDLE.get(name, FEWEST_OF_BEAM)
            part = slice(at, at + m * n)
            found[name] = BundleLight(
                alive[part].reshape(m, n), out[part].reshape(m, n, 3), into, wished, few
            )
            at += m * n
        return found

    def scattered(self, scatter: Errors) -> dict[str, float]:
        """Changes of mean squares of law_rms and blur, and of throughput, by errors of each lenslet."""
        total = np.zeros(2)
        for name, sigma in scatter.items():
            key = (name, sigma)
            if sigma and key not in self._known:
                here, up, down = (self._squares({name: way * sigma}) for way in (0.0, 1.0, -1.0))
                self._known[key] = 0.5 * (up + down) - here
            total = total + self._known.get(key, 0.0)
        return {"law_rms": float(total[0]), "blur": float(total[1]), "throughput": self._lost(scatter)}

    def _squares(self, errors: Errors) -> Floats:
        """Mean squares of law_rms and of angles to the mean direction as designed."""
        light, designed = self.in_middle(errors), self.in_middle({})["beam"].mean[0]
        blur = light["beam"].spread[0] ** 2 + float(np.sum((light["beam"].mean[0] - designed) ** 2))
        return np.array([light["cone"].rms[0] ** 2, blur])

    def _lost(self, scatter: Errors) -> float:
        """Change of throughput: the mean of `DRAWN` lenslets of the middle cell, always the same ones."""
        sigmas = {name: sigma for name, sigma in scatter.items() if sigma}
        key = tuple(sorted(sigmas.items()))
        if key and key not in self._shares:
            drawn = np.random.default_rng(0).standard_normal((DRAWN, len(key)))
            lenslets = ({name: sigma * x for (name, sigma), x in zip(key, row)} for row in drawn.tolist())
            shares = [self.in_middle(one)["cone"].share[0] for one in lenslets]
            self._shares[key] = float(np.mean(shares) - self.in_middle({})["cone"].share[0])
        return self._shares.get(key, 0.0)

    def in_middle(self, errors: Errors) -> dict[str, BundleLight]:
        """Light of the cone and of parallel light through the middle cell of a sheet with these errors."""
        return self.cells(errors, dict.fromkeys(("cone", "beam"), self.places[:1]))

    def _stated(self, errors: Errors, place: Floats) -> dict[str, float]:
        """Measures of white light and temperature of one cell, against the design's wavelength."""
        found: dict[str, float] = {}
        lit = self.bundles["cone"]
        cone = Light(lit, self._sender(errors, place)(lit), self.law, FEWEST_BY_BUNDLE["cone"])
        if self.lines:
            light = measure(self._sender(errors, place), cone.lit, self.law, self.lines, fewest=cone.fewest)
            white = WhiteLight(cone, light, self.lines)
            found |= {"law_white": white.mean(white.law_rms), "colour": white.mean(white.change)}
        if self.kelvin:
            ends = [
                Light(cone.lit, self._sender(errors, place, heated(self.window, hot))(cone.lit), self.law)
                for hot in (-self.kelvin, self.kelvin)
            ]
            found["temperature"] = max(changed(cone, one) for one in ends)
        return found

    def _sender(self, errors: Errors, place: Floats, window: Window | None = None) -> Send:
        """Sender through one cell, over cell 1 at its actual position: the light covers the whole sheet."""
        sheet = self.window if window is None else window
        cell = telescopelet(sheet, errors, place)
        aside = _aside(errors)

        def send(lit: Bundle) -> TraceResult:
            line = lit.rays.wavelength
            through = cell if line is None else telescopelet(lit_by(sheet, lit.rays), errors, place)
            return through.send(Rays(lit.rays.position + aside, lit.rays.direction))

        return send

    def _haze(self, errors: Errors) -> float:
        rough = errors.get("roughness", 0.0) * self.window.unit
        return haze(self.window, rough, self.wavelength) if rough else 0.0

    def _chief_measures(self, slopes: Floats) -> dict[str, float]:
        """Image shift, slip and power, from slopes (5, 5, 2) of chief rays: of a cell and its neighbours."""
        window, unit = self.window, self.window.unit
        here = slopes[0]
        shift = here[0] - self.chief
        size = STEP * window.lattice.circumradius
        power = -np.stack([here[1] - here[2], here[3] - here[4]], axis=1) / (2.0 * size * unit)
        if self.law.power is not None:
            power = power - np.diag(self.law.power) / unit
        step = np.array(window.lattice.pitch)
        across = ((slopes[1::2, 0] - slopes[2::2, 0]) / (2.0 * step)[:, None]).T
        slip = np.full((2, 2), np.nan)
        if np.isfinite(self.per_decentre).all():  # a meridian without power cannot slip
            slip = np.linalg.pinv(self.per_decentre, rcond=1e-9) @ across
        rate = _norm(slip)
        found = {f"shift_{a}": float(shift[k]) for k, a in enumerate("xy")}
        for name, matrix in (("slip", slip), ("power", power)):
            found |= {
                f"{name}_{a}{b}": float(matrix[i, k]) for i, a in enumerate("xy") for k, b in enumerate("xy")
            }
        return found | {
            "image_shift": hypot(*shift),
            "moire_rate": rate,
            "residual_power": _norm(power),
            "moire_period": min(window.lattice.pitch) * unit / rate if rate > 1e-12 else np.inf,
        }

    def chief_slopes(self, errors: Errors) -> Floats:
        """Exit slopes (2,), lens frame, of the chief ray of the middle; NaN for a lost ray."""
        middle = self.cells(errors, {"chief": np.zeros((1, 2))})
        return np.asarray(_slopes(middle["chief"], self.window)[0, 0])


def _fitted(law: Law | None, asked: Law) -> dict[str, float]:
    names = ("eta_x", "eta_y", "delta_x", "delta_y", "eta_error", "delta_error")
    if law is None:
        return dict.fromkeys(names, np.nan)
    off = difference_of_laws(law, asked)
    return dict(zip(names, (law.eta_x, law.eta_y, law.delta_x, law.delta_y, *off), strict=True))


def _slopes(chief: BundleLight, window: Window) -> Floats:
    """Exit slopes (m, 5, 2), lens frame, of the chief rays of m cells and their parabasal rays."""
    turned = chief.direction @ window.thin.rotation
    return np.asarray(turned[..., :2] / turned[..., 2:])


def bench(
    design: Design, window: Window, rays: int = RAYS, incident: tuple[float, float] | None = None
) -> Bench:
    """Create the rays and trace the sheet as designed.

    Parameters
    ----------
    design : Design
        Gives the field of the checks.
    window : Window
    rays : int
        Rays of each bundle. The cone, whose rays are counted, has four times as many; the parallel beams
        other than the middle one have a quarter.
    incident : (x, y) slopes or None
        Middle of the field along the sheet's x and y, in place of `check.field_centre`.
    """
    spec = design.check
    bundles = _bundles(window, spec, rays, None if incident is None else sloped(incident))
    kept = float(share(thin_cells(window), bundles["cone"].rays.direction[:64]).mean())
    blank = Bench(
        window,
        RequestedLaw.of(window),
        bundles,
        places_of_errors(window),
        np.zeros(2),
        np.eye(2),
        kept,
        window.wavelength or DEFAULT_WAVELENGTH,
        design.light.lines if "law_white" in measures_of(design) else {},
        (design.light.temperature or KELVIN) if "temperature" in measures_of(design) else 0.0,
    )
    return replace(blank, chief=blank.chief_slopes({}), per_decentre=_per_decentre(blank))


def sloped(slopes: tuple[float, float]) -> Floats:
    """Unit direction (3,) with the given slopes along the sheet's x and y."""
    direction = np.array([*slopes, 1.0])
    return np.asarray(direction / np.linalg.norm(direction))


def _bundles(window: Window, spec: CheckSpec, rays: int, incident: Floats | None) -> dict[str, Bundle]:
    """Every bundle by its name, its rays about the cell's centre."""
    middle = middle_direction(window, spec.field_centre) if incident is None else incident
    bundles = {"cone": bundle(window, 4 * rays, spec.field, spec.field_centre, middle=incident)}
    for number, direction in enumerate(field_about(middle, spec.field)[[0, 1, 3, 5, 7]]):
        count = rays if number == 0 else max(64, rays // 4)
        bundles["beam" if number == 0 else f"beam {number}"] = bundle(window, count, 0.0, middle=direction)
    bundles["narrow"] = bundle(window, rays, FIT_SCALE * spec.field, spec.field_centre, FIT_SCALE, incident)
    home = np.append(window.lattice.centres(np.array([bundles["cone"].cell]))[0], 0.0)
    bundles = {
        name: replace(one, rays=Rays(one.rays.position - home, one.rays.direction))
        for name, one in bundles.items()
    }
    beam = bundles["beam"]
    chief = _chief_rays(window, middle, beam.rays.position[0, 2])
    return bundles | {"chief": replace(beam, rays=chief, points=np.zeros((len(chief), 2)))}


def _per_decentre(table: Bench) -> Floats:
    """Change (2, 2) of the chief ray's exit slopes with the decentre of array 2, 1/length."""
    step = 1e-4 * min(table.window.lattice.pitch)
    ways = [[table.chief_slopes({f"decentre.2.{a}": way * step}) for way in (1.0, -1.0)] for a in "xy"]
    return np.stack([(up - down) / (2.0 * step) for up, down in ways], axis=1)


def _chief_rays(window: Window, middle: Floats, low: float) -> Rays:
    """Ray through the cell's middle, and four parabasal rays along lens x and y, from below the window."""
    u, v, _ = window.thin.rotation.T
    size = STEP * window.lattice.circumradius
    at = np.array([0.0 * u, u, -u, v, -v]) * size
    start = at + middle * ((low - at[:, 2:]) / middle[2])
    return Rays(start, np.broadcast_to(middle, start.shape).copy())


def split(errors: Errors) -> tuple[Errors, Errors]:
    """Errors of whole arrays, and standard deviations of those from lenslet to lenslet."""
    parts: tuple[dict[str, float], dict[str, float]] = ({}, {})
    for name, value in errors.items():
        parts[name.startswith("scatter_")][name] = value
    return parts


def _with_squares(values: list[float], added: float) -> list[float]:
    """Root mean squares whose mean square is larger by `added`."""
    return [float(np.sqrt(max(0.0, value * value + added))) if added else value for value in values]


def _worst(values: list[float]) -> float:
    """The largest value; NaN if any is NaN."""
    return float(np.max(values))


def _first_worst(values: list[float]) -> int:
    """Index of the first value that is the largest within rounding, or NaN."""
    most = _worst(values)
    return next(k for k, value in enumerate(values) if value != value or value >= most * (1.0 - 1e-9))


def _norm(matrix: Floats) -> float:
    """Largest singular value; NaN where the matrix holds one."""
    return float(np.linalg.norm(matrix, 2)) if np.isfinite(matrix).all() else float("nan")
