"""Search for wide fields: forms of two and three plates, chosen by their Petzval number.

The field curvature of a form leaves rms ≈ 0.059 p P t² at the best defocus, with P its Petzval number, p the
pitch and t the slope of the cone. Faces balance a part of it: searches with all terms got each form down to a
known share of that number. A form whose share exceeds the wish is hopeless and is not built. The others start
from a starter scaled to the wish, which is searched where it does not keep the wish yet.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf, radians, sqrt, tan
from typing import Any, Final

from clacad.advice.candidate import (
    PitchBound,
    Variant,
    check_keys,
    lattice_keys,
    round_to,
    wanted_pitch,
)
from clacad.advice.judged import fault, judge
from clacad.advice.wish import Wish, angle_text, mrad_value, wavelength_text
from clacad.advice.wish_search import Tried
from clacad.base.text import mrad_text
from clacad.base.types import Progress
from clacad.checks.light_kinds import LAW_RMS, RESIDUAL, THROUGHPUT
from clacad.design import Design, DesignError
from clacad.design.sections import CHECK
from clacad.design.starter_designs import template
from clacad.optics.material.catalogue import find
from clacad.prescription.prescribe import prescribe
from clacad.sheet.face_order import refractions
from clacad.sheet.window import Window

WIDE: Final = radians(5.0)
"""Half angle of a cone from which on a wish is for a wide field."""

FORMS: Final = {
    "two-plates-10deg": (2, 0.66),
    "three-plates-10deg": (3, 0.24),
    "three-plates-15deg": (3, 0.44),
}
"""Starter of each form, in the order of trial; its plates; least rms error that was reached, by searches of
radii, conic, a4, a6, a8 and thickness, over the error by the starter's Petzval number."""

BEST_DEFOCUS: Final = 0.059
"""Rms error over p P t² at the best defocus: of a field that is curved alone."""

FREE: Final = (("radii", "conic"), ("radii", "conic", "a4", "a6", "thickness"))
"""Words of the searches of a form, one after the other: conics are exact in STEP files."""


def is_wide(wish: Wish) -> bool:
    """Whether a wish is for a wide field that forms of several plates can serve."""
    return (
        wish.field >= WIDE
        and wish.straight
        and wish.form == "any"
        and wish.index is None
        and wish.white is None
        and wish.eta[0] == wish.eta[1] < 0.0
        and wish.flange is None
    )


def petzval_number(window: Window) -> float:
    """Petzval number (1/length) of the faces: |Σ (n′ − n) c/(n n′)|, mean of both meridians."""
    return abs(
        sum(
            (after - before)
            / (before * after)
            * face.side
            * 0.5
            * (face.surface.curvature_x + face.surface.curvature_y)
            for _, face, before, after in refractions(window.bodies)
            if face.array is not None
        )
    )


def petzval_error(window: Window, cone: float) -> float:
    """Rms error (radians) that the Petzval number leaves over a cone (half angle, radians)."""
    return BEST_DEFOCUS * min(window.lattice.pitch) * petzval_number(window) * tan(cone) ** 2


@dataclass
class WideSearch:
    """Search for a wish of a wide field.

    why : Reasons for the form that was chosen, and against the others.
    tried : Designs that were judged.
    limit : Largest rms error (radians) over the field that the wish or an override allows.
    """

    wish: Wish
    name: str
    overrides: Sequence[str]
    progress: Progress
    why: list[str] = field(default_factory=list)
    tried: list[Tried] = field(default_factory=list)
    limit: float = inf

    def run(self) -> Tried | None:
        """The first design that passes, forms with few plates first."""
        hopeful = sorted(self._hopeful(), key=lambda pair: FORMS[pair[0]][0])
        for number, (starter, design) in enumerate(hopeful):
            self.progress(f"trying {starter}", number / len(hopeful))
            one = self._judged(starter, design)
            if not self._serves(one):
                self.why.append(f"{starter}, scaled to the wish: {self._faults(one)}")
                # where light leaves its cells, the field is wider than that of the form: no faces mend it
                vignetted = any(check.kind is THROUGHPUT for check in one.judged.failing)
                for words in () if vignetted else FREE:
                    if not self._serves(one):
                        one = self._searched(starter, design, words) or one
            if self._serves(one):
                self.why.append(
                    f"{starter} keeps the law within {mrad_text(one.judged.measured(LAW_RMS))} over"
                    f" {angle_text(self.wish.field)}"
                )
                return one
        self.why += self._nearest()
        return None

    def _nearest(self) -> Iterator[str]:
        """A larger error, over the same field, that a design of those tried keeps with every other limit."""
        for one in sorted(self.tried, key=lambda t: t.judged.measured(LAW_RMS)):
            reached = round_to(1.05 * one.judged.measured(LAW_RMS), 2, up=True)
            if reached > self.limit:
                wider = one.judged.design.replace({CHECK.law_rms: mrad_value(reached)})
                if judge(wider, judged_only=True).passes:
                    yield f"error < {mrad_text(reached)} comes true: {one.variant}"
                    return

    def _serves(self, one: Tried) -> bool:
        """Whether verify will pass and the error is within the wish."""
        return one.judged.passes and one.judged.measured(LAW_RMS) <= self.limit

    def _faults(self, one: Tried) -> str:
        """The error where it is beyond the wish, and the first failing check; the others by name."""
        first, *others = one.judged.failing or (None,)
        failing = [] if first is None or first.kind is LAW_RMS else [fault(first)]
        failing += [", ".join(dict.fromkeys(check.id for check in others))] if others else []
        rms = one.judged.measured(LAW_RMS)
        if rms > self.limit:
            failing.insert(0, f"{mrad_text(rms)} over the field, {mrad_text(self.limit)} are wished")
        return "; ".join(failing)

    def _hopeful(self) -> Iterator[tuple[str, Design]]:
        """Forms that can be built and whose Petzval number allows the wish, scaled to it."""
        for starter in FORMS:
            try:
                design = Design.from_dict(scaled_keys(self.wish, starter, self.name), self.overrides)
                window = prescribe(design)
            except DesignError as problem:
                self.why.append(f"{starter}: {problem.mistakes[0].message}")
                continue
            self.limit = design.check.law_rms
            left, number = petzval_error(window, self.wish.field), petzval_number(window)
            about = (
                f"{starter}: its Petzval number {number:.3g}/mm leaves about {mrad_text(left)} over"
                f" {angle_text(self.wish.field)}"
            )
            reached = FORMS[starter][1] * left
            if reached > self.limit:
                widest = tan(self.wish.field) * sqrt(self.limit / reached)
                self.why.append(
                    f"{about}; searches with all terms got this form to {mrad_text(reached)},"
                    f" {mrad_text(self.limit)} are wished: hopeless; it may keep them to a slope of"
                    f" {widest:.3g}"
                )
                continue
            self.why.append(f"{about} ({mrad_text(self.limit)} are wished)")
            yield starter, design

    def _judged(self, starter: str, design: Design) -> Tried:
        """A design as judged; best over the cone, its axis may leave more than the wish allows the field."""
        judged, pitch = judge(design, judged_only=True), min(design.lattice.pitch)
        if judged.failing and all(check.kind is RESIDUAL for check in judged.failing):
            most = max(float(check.value or 0.0) for check in judged.failing)
            judged = judge(
                design.replace({CHECK.law_rms: mrad_value(round_to(1.05 * most, 2, up=True))}),
                judged_only=True,
            )
            self.why.append(
                f"{starter}: least over the field is not least on the axis, where {mrad_text(most)} are left;"
                " the limit of the rms error allows them"
            )
        ratio = judged.window.thin.separation / pitch
        bound = PitchBound(pitch, wanted_pitch(self.wish).why)
        one = Tried(Variant("slab", starter=starter), ratio, bound, judged)
        self.tried.append(one)
        return one

    def _searched(self, starter: str, design: Design, words: tuple[str, ...]) -> Tried | None:
        """The design after a search over what `words` name; None if it finds nothing better."""
        from clacad.optimising import optimise

        def told(count: int, rms: float) -> None:
            self.progress(f"searching {starter}: {mrad_text(rms)}", 0.5)

        try:
            found = optimise(design, words, self.wish.field, told)
        except DesignError as problem:
            self.why.append(f"{starter}, searched ({', '.join(words)}): {problem.mistakes[0].message}")
            return None
        one = self._judged(starter, found.design)
        self.why.append(
            f"{starter}, searched ({', '.join(words)}): {mrad_text(found.before[-1].law_rms)} ->"
            f" {mrad_text(found.after[-1].law_rms)}; {self._faults(one) or 'passes'}"
        )
        return one


def scaled_keys(wish: Wish, starter: str, name: str) -> dict[str, Any]:
    """Design of a starter scaled to a wish: its pitch, its η and the index of its material."""
    known = tomllib.loads(template("starter", starter))
    pitch = round_to(wanted_pitch(wish).value, 2, up=True)
    scale, eta = pitch / known["lattice"]["pitch"], abs(wish.eta[0])
    own = float(find("PMMA").index(wish.wavelength))
    bend = (float(find(wish.material).index(wish.wavelength)) - 1.0) / (own - 1.0)
    faces, middle = known["pair"]["face"], 0.5 * known["pair"]["face"][-1]["z"]
    for face in faces:
        z = face.get("z", 0.0)
        part = scale * (eta if z > middle else 1.0)
        face["radius"] *= part * bend
        if "z" in face:
            face["z"] = scale * middle + part * (z - middle)
        if face["behind"] != "air":
            face["behind"] = wish.material
    return {
        "format": 1,
        "name": name,
        "unit": "mm",
        "law": {"eta": list(wish.eta)},
        "pair": known["pair"] | {"wavelength": wavelength_text(wish.wavelength)},
        "lattice": lattice_keys(wish, Variant("slab"), pitch),
        "check": {key: value for key, value in known["check"].items() if key != LAW_RMS.id}
        | check_keys(wish),
    }
