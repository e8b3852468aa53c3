"""Trade-offs of other sizes: each is built, traced and judged like the design itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan, degrees

from clacad.advice.candidate import MILLIMETRES, returning, round_to, sharpest_pitch
from clacad.advice.judged import Judged, judge
from clacad.advice.wish import Wish
from clacad.base.text import digits, mrad_list
from clacad.checks.light_kinds import LAW_RMS
from clacad.design import Design, DesignError
from clacad.design.sections import LATTICE, PAIR
from clacad.sheet.feasibility.derived_numbers import ARC_MINUTE


@dataclass(frozen=True, slots=True)
class Trade:
    """One design with its gains and losses. Lengths in millimetres, angles in radians.

    pitch, separation, height : Height: of the whole sheet.
    rms : Error of the law, traced.
    diffraction, pixel : float
        λ over the width of the light returned from one cell, and the pitch, as the viewer sees them.
    field : Half angle in which the sheet shows the law.
    seen : Width of the sheet in which the viewer sees it.
    step, sag : Highest step between neighbours, and greatest height of a lens.
    verdict : "passes", or the checks that fail or warn.
    """

    name: str
    pitch: float
    separation: float
    height: float
    rms: float
    diffraction: float
    pixel: float
    field: float
    seen: float
    step: float
    sag: float
    verdict: str

    def to_dict(self) -> dict[str, float | str]:
        """JSON-ready."""
        return {name: getattr(self, name) for name in self.__slots__}


def trade_offs(wish: Wish, chosen: Judged) -> tuple[Trade, ...]:
    """The design itself, then half and twice its pitch, and a smaller and a larger separation."""
    pitch, separation = min(chosen.design.lattice.pitch), chosen.window.thin.separation
    rows = [_row("this design", wish, chosen)]
    for name, p, s in (
        ("half the pitch", 0.5, 0.5),
        ("twice the pitch", 2.0, 2.0),
        ("lenses nearer", 1.0, 0.7),
        ("lenses farther apart", 1.0, 1.4),
    ):
        design = _resized(chosen.design, wish, round_to(pitch * p, 3), round_to(separation * s, 3))
        if design is not None:
            try:
                rows.append(_row(name, wish, judge(design, judged_only=True)))
            except DesignError:
                continue
    return tuple(rows)


def _resized(design: Design, wish: Wish, pitch: float, separation: float) -> Design | None:
    changes: dict[str, object] = {LATTICE.pitch: pitch, PAIR.separation: separation}
    if design.lattice.outline is None:
        changes[LATTICE.count] = [max(1, int(side / pitch + 1e-9)) for side in wish.size.size]
    try:
        return design.replace(changes)
    except DesignError:
        return None


def _row(name: str, wish: Wish, judged: Judged) -> Trade:
    facts, design = judged.facts, judged.design
    to_mm = design.unit_m * MILLIMETRES
    pitch = min(design.lattice.pitch) * to_mm
    half = min(facts.half_field)
    faults = list(dict.fromkeys(c.id for c in judged.failing)) or list(
        dict.fromkeys(c.id for c in judged.warning)
    )
    words = "passes" if judged.passes else "fails"
    return Trade(
        name,
        pitch,
        facts.separation * to_mm,
        (max(b.high for b in facts.bodies) - min(b.low for b in facts.bodies)) * to_mm,
        judged.measured(LAW_RMS),
        wish.wavelength * MILLIMETRES / (pitch * returning(wish)),
        pitch / wish.distance,
        atan(half),
        2.0 * half * wish.distance,
        max(b.step for b in facts.bodies) * to_mm,
        max(lens.sag for lens in facts.lenses) * to_mm,
        f"{words}: {', '.join(faults)}" if faults else words,
    )


HEAD = ("", *"pitch separation height error diffraction pixel field seen step sag verdict".split())
UNITS = ("", "mm", "mm", "mm", "mrad rms", "mrad", "mrad", "+- deg", "mm", "um", "um", "")


def rows_of(trades: Sequence[Trade]) -> list[tuple[str, ...]]:
    """The rows as text, after two heading rows."""
    return [HEAD, UNITS, *(_texts(trade) for trade in trades)]


def _texts(t: Trade) -> tuple[str, ...]:
    def short(value: float) -> str:
        return digits(value, count=3)

    return (
        t.name,
        *map(short, (t.pitch, t.separation, t.height)),
        *mrad_list((t.rms, t.diffraction, t.pixel), 3).split(", "),
        *map(short, (degrees(t.field), t.seen, 1e3 * t.step, 1e3 * t.sag)),
        t.verdict,
    )


def sentences(wish: Wish, own: Trade) -> tuple[str, ...]:
    """Sentences on the relations between the numbers, for this wish."""
    wave = wish.wavelength * MILLIMETRES
    fine, sharp = wish.distance * ARC_MINUTE, wave / (ARC_MINUTE * returning(wish))
    found = [
        f"pitch: pixels vanish from {wish.distance:g} mm at {fine:.3g} mm and below, diffraction at"
        f" {sharp:.3g} mm and above; "
        + (
            f"both only from {sharp / ARC_MINUTE / MILLIMETRES:.3g} m on"
            if sharp > fine
            else "both hold between them"
        ),
        f"separation: nearer lenses show the law in a wider field, +-{degrees(own.field):.3g} deg here,"
        f" which is {own.seen:.3g} mm of the sheet seen from {wish.distance:g} mm, but aberration grows"
        " as the third power of pitch over separation",
        (
            "steps: none between neighbours"
            if own.step == 0.0
            else (
                f"steps: neighbours differ by up to {1e3 * own.step:.3g} um in height; tilt makes pitch x"
                " tan(theta), decentred light the rest"
            )
        ),
    ]
    if wish.object is not None:
        best = sharpest_pitch(wish, wish.object)
        found.insert(
            1,
            f"sharpness: what is {wish.object:g} mm behind is least blurred at a pitch of {best:.3g} mm"
            " (within a tenth)",
        )
    return tuple(found)
