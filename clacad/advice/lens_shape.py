"""Lens shapes that keep off-axis light on the law, for offset and tilted pairs; layers that keep white light.

The error of a window at the centre of its field is measured with nine rays: fast enough for the choice.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, tan
from typing import Final

import numpy as np

from clacad.advice.candidate import (
    CURVED,
    FORMS,
    Variant,
    apertures,
    built,
    index_of,
    powers,
    undistorted_conic,
)
from clacad.advice.judged import Judged
from clacad.advice.wish import Wish
from clacad.base.sobol import sobol
from clacad.base.text import mrad_text
from clacad.base.types import Floats
from clacad.checks.light_kinds import LAW_WHITE
from clacad.design import Design, DesignError
from clacad.design.process_profiles import profile
from clacad.design.sections import LightSpec
from clacad.light.measure import FIT_SCALE, measure
from clacad.optics.material.catalogue import find
from clacad.optics.rays import Rays
from clacad.optics.sequence import trace_sequence
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, of_rays
from clacad.sheet.like_cell import interfaces
from clacad.sheet.vignetting import aperture_slope
from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class CentreErrors:
    """Errors at the centre of the field, and along the axis ray.

    law, decollimation : radians. Residual of the recipe along the axis ray (`Window.residual`).
    eta : Largest relative error of the change of exit slopes with entry slopes, over the directions of the
        fit of η.
    """

    law: float
    decollimation: float
    eta: float

    def lasting(self, design: Design) -> float:
        """Errors independent of the separation, over the design's limits; below 1 the limits are kept."""
        return max(self.law / design.check.law_rms, self.eta / design.check.eta)

    def shrinking(self, design: Design) -> float:
        """Errors that fall as pitch over separation, over the design's limits."""
        return self.decollimation / design.check.law_rms


def centre_errors(window: Window, field: float) -> CentreErrors:
    """Trace the centre of lens 1 at the centre of the field and around it.

    field : radians. Half angle of the cone of test rays; the fit of η takes a tenth.
    """
    left = window.residual
    return CentreErrors(left.get("law", inf), left.get("decollimation", inf), _eta_error(window, field))


def _eta_error(window: Window, field: float) -> float:
    """Largest deviation of ∂(exit slope)/∂(required exit slope) from 1; infinite where light is lost."""
    step = tan(FIT_SCALE * field)
    slopes = np.array([(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)]) + aperture_slope(window)
    direction = np.column_stack([slopes, np.ones(4)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    low, _ = window.z_range
    middle = np.array([*window.shifts[0], window.bodies[0].front.vertex[2]])
    start = middle - direction * ((middle[2] - low + 1.0) / direction[:, 2:])
    faces = interfaces(window)
    light = measure(
        lambda lit: trace_sequence(faces, lit.rays),
        of_rays(Rays(start, direction)),
        RequestedLaw(window.law),
        fewest=4,
    )
    if light.dark:
        return inf
    found, asked = _change(light.direction), _change(light.expected)
    if not (np.isfinite(found).all() and np.isfinite(asked).all()):
        return inf
    return float(np.linalg.svd(found @ np.linalg.inv(asked) - np.eye(2), compute_uv=False).max())


def _change(direction: Floats) -> Floats:
    """Differences (2, 2) of exit slopes (rows) between the rays of each pair (columns)."""
    slope = direction[:, :2] / direction[:, 2:]
    return np.stack([slope[0] - slope[1], slope[2] - slope[3]], axis=1)


RAYS = 4096
"""Rays of the closed form of the error of one material."""

FLAT: Final = (("N-BK7", "N-SF6"), ("Fused silica", "N-SF6"), ("P-BK7", "P-SF68"))
"""Outer and inner material of slabs with flat joints, the least error first."""


def least_of_one_material(wish: Wish) -> float:
    """Mean error (radians) over the lines that any faces of the wish's one material leave.

    At the largest separation, in pitches, at which the cone lies in the field of view: there it is least. A
    ray that enters at x with slope t and meets its partner, |η x + s t| ≤ p/2, turns along each axis by
    ε |1 − η|/|η| (t − x/f1), ε = (n − n0)/(n0 (n0 − 1)) about the line of median index.
    """
    if wish.index is not None:
        return inf
    material, lines = find(wish.material), LightSpec().lines
    index = np.array([float(material.index(wave)) for wave in lines])
    middle = float(np.sort(index)[len(index) // 2])
    epsilon = np.abs(index - middle) / (middle * (middle - 1.0))
    points, eta = sobol(RAYS, 4), np.array(wish.eta)
    ratio = (1.0 + np.abs(eta).min()) / (2.0 * tan(wish.field))
    x, turn = points[:, :2] - 0.5, 2.0 * np.pi * points[:, 3]
    t = (tan(wish.field) * np.sqrt(points[:, 2])[:, None]) * np.column_stack([np.cos(turn), np.sin(turn)])
    met = (np.abs(eta * x + ratio * t) <= 0.5).all(axis=1)
    turned = ((1.0 - eta) / eta * (t - x * (1.0 - eta) / ratio))[met]
    rms = float(np.sqrt((turned**2).sum(axis=1).mean()))
    return float(np.average(epsilon, weights=list(lines.values()))) * rms


def layered(wish: Wish, refused: list[str]) -> Iterator[Variant]:
    """Slabs of two materials that the process works, the wish's own material outside first."""
    if not wish.straight or wish.form not in ("any", "slab"):
        refused.append("layers: made for slabs whose lens axes are the sheet's normal, without offset")
        return
    rules = profile(wish.process)
    curved = CURVED if wish.eta == (-1.0, -1.0) else {}
    pairs = sorted((*FLAT, *curved), key=lambda pair: pair[0] != wish.material)
    worked = [pair for pair in pairs if all(rules.works(find(name)) for name in pair)]
    if not worked:
        refused.append(
            f"layers: {wish.process} works none of {', '.join('|'.join(pair) for pair in pairs)} at this eta"
        )
    for outer, inner in worked:
        yield Variant("slab", layers=(outer, inner, outer))


def reasons_for_white(wish: Wish, judged: Judged) -> Iterator[str]:
    """Error of a wish for white light, what one material would leave, and what layers cost."""
    if wish.white is None:
        return
    least = least_of_one_material(wish)
    yield (
        f"white light: {mrad_text(judged.measured(LAW_WHITE), 3)} rms, mean of F, e, d and C, of"
        f" {mrad_text(wish.white, 3)}; one material ({wish.material}) leaves {mrad_text(least, 3)} or more,"
        " for any faces and any separation with this field"
    )
    bodies = judged.window.bodies
    if len(bodies) < 2:
        return
    thick = bodies[-1].back.vertex[2] - bodies[0].front.vertex[2]
    n = float(find(wish.material).index(wish.wavelength))
    flat = all(body.front.array is None for body in bodies[1:])
    yield (
        f"cost: {len(bodies)} layers, {', '.join(body.material.name for body in bodies if body.material)},"
        f" cemented along {len(bodies) - 1} {'flat' if flat else 'curved'} joints, {thick:.3g} mm thick"
        f" (one slab of {wish.material}: {n * judged.window.thin.separation:.3g} mm)"
    )


ENOUGH = 0.9
"""Share of the limits that errors at the centre of the field may use."""

WITHIN = 0.95
"""Share of the limits beyond which a shape is not traced further."""

SPREAD = (0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.5, -0.5, 0.7, -0.7)
"""Trial conic constants, relative to that of the closed formula."""

FINE = (0.025, -0.025, 0.05, -0.05, 0.075, -0.075)
"""Finer trial values, relative to the best of `SPREAD`."""

RATIO = 20.0
"""Separation (pitches) at which shapes are compared."""

FARTHEST = 2.0
"""Largest distance (pitches) from its vertex at which light may hit lens 2."""


JUDGEMENT, AXIS, FAULTS = 40, 20, 4
"""Work of judging a design, its axis ray and errors at its field's centre, in shares of thin lenses."""

UNEQUAL = 5
"""Work of judging a non-uniform sheet, in judgements of a uniform one: outer cells are judged singly."""


@dataclass
class Work:
    """Count of what a search did, so that it ends at the same design on every machine.

    most : The search ends beyond it.
    done : In shares of thin lenses (hundredths of a second each).
    """

    most: int
    done: int = 0

    @property
    def over(self) -> bool:
        """Whether no more may be done."""
        return self.done >= self.most


@dataclass(frozen=True, slots=True)
class Faults:
    """Errors at the field's centre over the design's limits: lasting ones, and those a separation reduces."""

    lasting: float
    shrinking: float

    @property
    def cost(self) -> tuple[float, float]:
        """Cost, smaller is better: first the excess over ENOUGH, then the required separation."""
        return max(0.0, self.lasting - ENOUGH), self.shrinking


@dataclass(frozen=True, slots=True)
class LensShapes:
    """Forms and shapes for a wish.

    pitch : millimetres. Pitch at which they are compared; the result hardly depends on it.
    overrides : "key=value" of the design, as with --set.
    refused : Receives a sentence for each form that is rejected without tracing.
    work : Counts what is done here.
    """

    wish: Wish
    pitch: float
    overrides: Sequence[str]
    refused: list[str]
    work: Work

    def variants(self) -> Iterator[tuple[Variant, float]]:
        """Candidate variants, the best first, each with its least separation in pitches."""
        white = self.wish.white
        if white is not None and least_of_one_material(self.wish) > white:
            self.refused.append(
                f"one material: faces of {self.wish.material} leave"
                f" {mrad_text(least_of_one_material(self.wish), 3)} of white light or more, for any faces"
                " and any separation with this field"
            )
            yield from ((one, 0.0) for one in layered(self.wish, self.refused))
            return
        for aperture in apertures(self.wish):
            for form, curved in FORMS:
                if self.wish.form in ("any", form):
                    variant = Variant(form, curved, None, aperture)
                    for shaped, needed in (
                        self._straight(variant) if self.wish.straight else self._offset(variant)
                    ):
                        yield from ((one, needed) for one in self._for_the_eye(shaped))

    def _for_the_eye(self, variant: Variant) -> Iterator[Variant]:
        """The variant; for a stated eye also with field lenses, and with aimed cells if steps can be made."""
        yield variant
        if self.wish.viewing is None:
            return
        sharp = variant
        if (
            variant.form == "slab" and variant.conic is None
        ):  # lenses close to each other are sharper with it, at no cost
            sharp = replace(variant, conic=round(-1.0 / index_of(self.wish) ** 2, 4))
            yield sharp
        if max(powers(self.wish)) < 0.0:
            conic = sharp.conic  # a field lens undoes half of what keeps oblique light on the law without it
            halved = variant.form == "plano" and conic is not None
            yield replace(sharp, eye="field lens", conic=round(0.5 * conic, 3) if halved and conic else conic)
        if profile(self.wish.process).wall == inf and variant.aperture == apertures(self.wish)[0]:
            yield replace(sharp, eye="aimed")

    def _straight(self, variant: Variant) -> Iterator[tuple[Variant, float]]:
        """Spheres or ellipsoids first, then the conic without distortion."""
        yield variant, 0.0
        conic = undistorted_conic(variant.form, variant.curved, index_of(self.wish))
        if conic is not None:
            yield replace(variant, conic=round(conic, 3)), 0.0

    def _offset(self, variant: Variant) -> Iterator[tuple[Variant, float]]:
        """The variant with a conic that keeps the law at the field's centre and on the axis ray, if any."""
        self.work.done += AXIS
        try:
            x, y = aperture_slope(prescribe(self._design(replace(variant, aperture=1.0))))
        except DesignError as problem:
            self.refused.append(f"{variant.form}: {problem.mistakes[0].message}")
            return
        if (1.0 - variant.aperture) * RATIO * max(abs(x), abs(y)) > FARTHEST:
            return
        variant = replace(variant, slope=(float(x), float(y)))
        faults = self._compared(variant)
        chosen = min(faults, key=lambda conic: faults[conic].cost)
        found = faults[chosen]
        if found.lasting <= WITHIN:
            yield replace(variant, conic=chosen), RATIO * found.shrinking / ENOUGH
            return
        missed = (
            f"is missed by {found.lasting:.3g} times what the design allows"
            if found.lasting < inf
            else "is not met: no light passes"
        )
        self.refused.append(
            f"{variant.form}: in the middle of the field and along the axis ray the law {missed}, for any"
            " conic constant and separation; less offset or less tilt would help"
        )

    def _compared(self, variant: Variant) -> dict[float | None, Faults]:
        """Faults by conic constant: of the ellipsoid and, unless that suffices, near the closed formula's."""
        faults: dict[float | None, Faults] = {None: self._faults(variant)}
        start = undistorted_conic(variant.form, variant.curved, index_of(self.wish))
        if start is None or faults[None].cost <= (0.0, ENOUGH):
            return faults
        conics = [round(start + step, 3) for step in SPREAD]
        faults |= {conic: self._faults(replace(variant, conic=conic)) for conic in conics}
        best = min(conics, key=lambda conic: faults[conic].cost)
        return faults | {
            conic: self._faults(replace(variant, conic=conic))
            for conic in (round(best + step, 3) for step in FINE)
        }

    def _faults(self, variant: Variant) -> Faults:
        self.work.done += FAULTS
        try:
            design = self._design(variant)
            found = centre_errors(prescribe(design), self.wish.field)
        except DesignError:
            return Faults(inf, inf)
        return Faults(found.lasting(design), found.shrinking(design))

    def _design(self, variant: Variant) -> Design:
        return built(self.wish, variant, self.pitch, RATIO, "trial", self.overrides)
