"""Recommended pitch for an eye before array 1: trade-off of diffraction and cell size.

Light returned to the viewer leaves a cell of array 1 in a beam of width w = p·min(1, 1/|η|). Each cell is a
telescope of its own, whose image of a point at z lies at z/η², while the sheet's lies at z/η. Seen through
the sheet, the light of one cell is therefore out of focus. A small cell blurs by diffraction, a large one by
that defocus. The blur is least where the defocus is a quarter wave at the beam's edge, (w/2)²/2 · |η(η −
1)/z| = λ/4. Waves through a row of cells that do not interfere put the least blur between .90 and 1.05 of
that pitch, for η from −2 to 1/2 and z from .05 to 3 m. Half that pitch blurs 1.55 times as much and twice
that pitch 2.5 times.

Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, pi, sqrt

from clacad.base.types import Pair2

VIEWING_DISTANCE = 1.0
"""Default distance from the sheet to the eye, metres."""

SEPARATIONS = 10.0
"""Default distance of the object, in separations of the pair."""

ARC_MINUTE = pi / 10800.0
"""Resolution of an eye, radians."""

HALF_ENERGY = 0.72
"""Width that contains half of the light at the sharpest pitch,
over λ/w as the eye sees it (waves: .70 to .75).
"""

LOST = 0.164
"""Share of light that diffraction moves to the partner's neighbours, times √N,
for a beam that fills its cell.
"""


@dataclass(frozen=True, slots=True)
class EyeAdvice:
    """Recommended pitches for one position of the eye and one of the object.

    viewer, object : float, metres
        Distance from the sheet to the eye before array 1, and to the object behind array 2.
    sharpest : (x, y), metres
        Pitch of least blur along each lens axis; infinite for η = 1, where no cell is out of focus.
    blur : (x, y), radians
        Width at that pitch that contains half of the light, at the eye; infinite where the image lies in the
        eye.
    invisible : float, metres
        Pitch that subtends one minute of arc.
    fine : (x, y), metres
        Pitch whose diffraction is one minute of arc.
    lost : (x, y)
        Greatest share of the light that diffraction may move to cells other than the partner.
    """

    viewer: float
    object: float
    sharpest: Pair2
    blur: Pair2
    invisible: float
    fine: Pair2
    lost: Pair2

    @property
    def advised(self) -> float:
        """Sharpest pitch of the lens axis with more blur."""
        return pitch_of_more_blurred(self.sharpest, self.blur)


def pitch_of_more_blurred(sharpest: Sequence[float], blur: Sequence[float]) -> float:
    """Sharpest pitch of the axis with the greatest blur; of equal blurs the last."""
    worse = max(range(len(blur)), key=lambda k: (blur[k], k))
    return sharpest[worse]


def sharpest_pitch(eta: float, distance: float, wavelength: float) -> float:
    """Pitch of least blur: √(2λz/|η(1 − η)|)·max(1, |η|), metres.

    Parameters
    ----------
    eta : float
    distance : float, metres
        Distance z from the sheet to the object behind it.
    wavelength : float, metres
    """
    defocus = abs(eta * (1.0 - eta))
    return sqrt(2.0 * wavelength * distance / defocus) * max(1.0, abs(eta)) if defocus > 0.0 else inf


def sharpest_blur(eta: float, distance: float, viewer: float, wavelength: float) -> float:
    """Angle at the eye that contains half of the light of a point at the sharpest pitch:
    .72 λ|z/η|/(w |D + z/η|).
    """
    beam = sharpest_pitch(eta, distance, wavelength) * min(1.0, 1.0 / abs(eta))
    image = distance / eta
    if not isfinite(beam):
        return 0.0
    return HALF_ENERGY * wavelength * abs(image) / (beam * abs(viewer + image)) if viewer + image else inf


def diffraction_loss(fresnel: Sequence[float]) -> Pair2:
    """Greatest share of light that diffraction moves to the partner's neighbours along two axes: .164/√N, at
    most 1.

    The share is reached within 12 % from Fresnel number 1.5 on where the beam fills its cell (|η| ≥ 1);
    otherwise less.
    """
    x, y = (min(1.0, LOST / sqrt(n)) for n in fresnel)
    return x, y


def viewing(
    etas: Sequence[float], fresnel: Sequence[float], viewer: float, distance: float, wavelength: float
) -> EyeAdvice:
    """All advice for a pair of these η along lens x and y,
    and Fresnel numbers of the lit part (infinite: no lens).
    """
    x, y = etas
    fine = tuple(wavelength / ARC_MINUTE * max(1.0, abs(eta)) for eta in (x, y))
    return EyeAdvice(
        viewer=viewer,
        object=distance,
        sharpest=(sharpest_pitch(x, distance, wavelength), sharpest_pitch(y, distance, wavelength)),
        blur=(sharpest_blur(x, distance, viewer, wavelength), sharpest_blur(y, distance, viewer, wavelength)),
        invisible=viewer * ARC_MINUTE,
        fine=(fine[0], fine[1]),
        lost=diffraction_loss(fresnel),
    )
