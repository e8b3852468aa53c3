"""Data classes of the derived numbers, and the recommended pitch for an eye before array 1.

Lengths are in the window's unit unless a name states metres; angles in radians; slopes are tangents.

Light returned to the viewer leaves a cell of array 1 in a beam of width w = p·min(1, 1/|η|). Each cell is a
telescope of its own, whose image of a point at z lies at z/η², while the sheet's lies at z/η. Seen through
the sheet, the light of one cell is therefore out of focus. A small cell blurs by diffraction, a large one by
that defocus. The blur is least where the defocus is a quarter wave at the beam's edge, (w/2)²/2 · |η(η −
1)/z| = λ/4. Waves through a row of cells that do not interfere put the least blur between .90 and 1.05 of
that pitch, for η from −2 to 1/2 and z from .05 to 3 m. Half that pitch blurs 1.55 times as much and twice
that pitch 2.5 times.

Lengths of that trade-off are in metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, pi, sqrt

from clacad.base.types import Pair2
from clacad.base.units import A4, A6, A8

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

    viewer, object : metres
        Distance from the sheet to the eye before array 1, and to the object behind array 2.
    sharpest : (x, y), metres
        Pitch of least blur along each lens axis; infinite for η = 1, where no cell is out of focus.
    blur : (x, y), radians. Width at that pitch that contains half of the light, at the eye; infinite where
        the image lies in the eye.
    invisible : metres. Pitch that subtends one minute of arc.
    fine : (x, y), metres. Pitch whose diffraction is one minute of arc.
    lost : (x, y). Greatest share of the light that diffraction may move to cells other than the partner.
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

    distance : metres. Distance z from the sheet to the object behind it.
    wavelength : metres
    """
    defocus = abs(eta * (1.0 - eta))
    return sqrt(2.0 * wavelength * distance / defocus) * max(1.0, abs(eta)) if defocus > 0.0 else inf


def sharpest_blur(eta: float, distance: float, viewer: float, wavelength: float) -> float:
    """Angle at the eye of half a point's light at the sharpest pitch: .72 λ|z/η|/(w |D + z/η|)."""
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
    """All advice for a pair of these η and Fresnel numbers along lens x and y (infinite: no lens)."""
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


DEFAULT_WAVELENGTH = 550e-9
"""Wavelength in metres for windows whose index was given as a number."""


@dataclass(frozen=True)
class FaceShape:
    """One face of a lens whose faces differ, or have terms in addition to their conic.

    side : "front" or "back"
    radius : (R_x, R_y), lengths
    conic : (K_x, K_y) or None each
    a4 : (3,) 1/length³, or None
        Coefficients of x⁴, x² y² and y⁴.
    a6, a8 : (4,) 1/length⁵ and (5,) 1/length⁷, or None
        Coefficients of the next orders, where a face has them.
    """

    side: str
    radius: Pair2
    conic: tuple[float | None, float | None]
    a4: A4 | None
    a6: A6 | None = None
    a8: A8 | None = None


@dataclass(frozen=True)
class LensFacts:
    """One lens of a telescopelet, or the part of its field lens on one body.

    array : 0, 1 or 2
        Lens 1, lens 2, field lens.

    radius : (R_x, R_y), lengths
        Apex radii, negative where concave, infinite where flat; of the first face where faces differ.
    conic : (K_x, K_y) or None each
    kappa : float or None, 1/length
        Coefficient of z² of a quadric; None for a biconic.
    focal_length, built_focal_length : (f_x, f_y), lengths
        Of the equivalent thin lens; of the lens as built about its own axis (in air; slab: R/(n − 1)).
    sag : float, length
        Height range of the face over its optical zone.
    thickness : float, length
        Along the axis, apex to apex (plano: apex to plane face; slab: apex to apex of the two lenses).
    least_thickness : float, length
        Smallest thickness at these radii that covers the optical zone; infinite if none does, 0 where
        thickness does not matter (slab).
    corner : float, length
        Least thickness of the lens over its optical zone, along z; negative where it does not reach.
    cover : float
        Share of the optical zone where the lens exists and protrudes from its land.
    rim : (x, y), lengths
        Half width of the lens along its own axes, not cut by the cell; infinite if it has no rim.
    rim_at : (2,) lengths
        Point of the zone where the lens is thinnest, cell frame.
    least_normal_z : float
        Smallest z component of the unit normal over the zone; 0 or less is undercut.
    f_number : (x, y)
        Focal length over the full width of the zone along the lens axes.
    shapes : tuple of FaceShape
        All faces where `radius` and `conic` do not describe all of them; else empty.
    name : str
        "lens 1", "lens 2" or "field lens", with its body where two bodies carry it.
    body : str
        Name of the body that carries it.
    """

    array: int
    radius: Pair2
    conic: tuple[float | None, float | None]
    kappa: float | None
    focal_length: Pair2
    built_focal_length: Pair2
    sag: float
    thickness: float
    least_thickness: float
    corner: float
    cover: float
    rim: Pair2
    rim_at: Pair2
    least_normal_z: float
    f_number: Pair2
    shapes: tuple[FaceShape, ...] = ()
    name: str = ""
    body: str = ""

    @property
    def radii(self) -> tuple[float, ...]:
        """Apex radii of all faces, lengths."""
        return tuple(r for shape in self.shapes for r in shape.radius) or self.radius


@dataclass(frozen=True)
class BorderFacts:
    """One direction of inner borders of one body (all of that direction are congruent).

    step : (i, j)
        Index step across the border.
    neck : float, length
        Least common height of the two columns along the border; negative: there is a gap.
    joint : float, length
        Greatest common height; the two are joined if it is positive.
    joints : int
        Number of separate stretches of the border along which they are joined.
    corners : (bool, bool)
        Whether they are joined at the two ends of the border.
    rise : (front, back), lengths
        Greatest step between the two faces.
    mean_rise : (front, back), lengths
    """

    step: tuple[int, int]
    neck: float
    joint: float
    joints: int
    corners: tuple[bool, bool]
    rise: Pair2
    mean_rise: Pair2


@dataclass(frozen=True)
class BodyFacts:
    """One body.

    edge : float, length
        Least thickness along the true outer side of the body.
    neck : float, length
        Least common height over all inner borders; infinite for a single cell.
    step : float, length
        Highest step at any inner border.
    pieces, holes : int
        Connected pieces, and holes through them.
    low, high : float, lengths
        Height range.
    """

    name: str
    borders: tuple[BorderFacts, ...]
    edge: float
    neck: float
    step: float
    pieces: int
    holes: int
    low: float
    high: float


@dataclass(frozen=True)
class Feasibility:
    """All derived numbers of a window.

    lenses : tuple of LensFacts
        Lens 1, lens 2, then the parts of a field lens.
    clearance : float, length
        Least gap between consecutive bodies: lowest point of a body minus highest of the one before; infinite
        for one.
    aperture, undeviated : (x, y), slopes
        Centre of the field of view; direction through both lens centres. Sheet frame.
    half_field, ghost_onset : (x, y), slopes along lens x, y
    offset_blur : (x, y), lengths
        Full range of the ray offset on the sheet.
    diffraction_blur : (x, y), radians
        λ/w along the lens axes, w the equivalent width of the lit part of lens 2 in the centre of the field:
        the slit whose pattern has the same core (see `clacad.optics.aperture`).
    first_zero : (x, y), radians
        First zero of the Fraunhofer pattern of that zone along the lens axes; λ/w where the zone is a
        rectangle along them.
    fresnel_number : float
        (w/2)²/(λ |f2|), the least over the lens axes, with the same widths.
    viewing : EyeAdvice
        Pitches recommended for an eye before array 1.
    wavelength : float, metres
    """

    lenses: tuple[LensFacts, ...]
    bodies: tuple[BodyFacts, ...]
    clearance: float
    separation: float
    aperture: Pair2
    undeviated: Pair2
    half_field: Pair2
    ghost_onset: Pair2
    offset_blur: Pair2
    diffraction_blur: Pair2
    first_zero: Pair2
    fresnel_number: float
    viewing: EyeAdvice
    wavelength: float

    def with_steps_of(self, whole: Feasibility) -> Feasibility:
        """These numbers of one cell's uniform equivalent, with the steps of the whole sheet."""
        bodies = tuple(replace(one, step=of.step) for one, of in zip(self.bodies, whole.bodies, strict=True))
        return replace(self, bodies=bodies)


def two(values: Iterable[float]) -> Pair2:
    """Two floats from any iterable of two."""
    x, y = values
    return float(x), float(y)
