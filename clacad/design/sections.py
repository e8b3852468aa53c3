"""The sections of a design file as frozen values in the design's unit.

Lengths are multiples of `Design.unit_m` metres, wavelengths metres, angles radians; the Euler angles are
kept in degrees too, as written, so that 90 degrees stays exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from clacad.design.given_faces import FaceSpec
from clacad.design.plate_keys import CornersSpec, HoleSpec, PinsSpec, Vertex
from clacad.design.search_record import SearchRecord
from clacad.design.varying import Conjugates, VaryingSpec

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2


@dataclass(frozen=True, slots=True)
class LawSpec:
    """The requested law of refraction, paper eqs (4), (5) and section 3.

    Parameters
    ----------
    eta, delta : (2,) tuple of float
        η_i = −f2_i/f1_i and δ_i = d_i/f1_i for i = x, y in the lens frame.
    euler_degrees : (3,) tuple of float, degrees
        φ, θ, ψ as written.
    euler_axes : {"fixed", "moving"}
        R = Rz(ψ) Rx(θ) Rz(φ) for fixed axes, Rz(φ) Rx(θ) Rz(ψ) for moving ones.
    varying : VaryingSpec or None
        Variation of δ over the sheet; None: all cells obey one law.
    """

    eta: Pair2
    delta: Pair2
    euler_degrees: tuple[float, float, float]
    euler_axes: Literal["fixed", "moving"]
    varying: VaryingSpec | None = None

    @property
    def cylinders(self) -> bool:
        """Whether the lenses of the law have power along one of their axes only."""
        return 1.0 in self.eta

    @property
    def euler(self) -> tuple[float, float, float]:
        """φ, θ, ψ in radians."""
        phi, theta, psi = (math.radians(angle) for angle in self.euler_degrees)
        return phi, theta, psi


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """Requested properties of the field lens.

    Parameters
    ----------
    conic : float or None
        Conic constant of its faces; None: 0 between the two plates of a slab, −n² on a plate in air.
    gap : float or None, length
        Air gap between the plates of a slab, vertex to vertex; None: the larger of pitch/25 and 1.25 times
        the clearance limit.
    """

    conic: float | None = None
    gap: float | None = None


@dataclass(frozen=True, slots=True)
class PairSpec:
    """Construction of a lenslet pair.

    Parameters
    ----------
    form : {"biconvex", "plano", "slab"}
        Two biconvex lenses, two plano-convex ones, or both faces of one slab.
    separation : float or None, length
        Biconvex: centre to centre; plano: f1 + f2 in air; slab: T/n (None: given by `thickness`).
    thickness : "auto", float or (2,) tuple of float, length
        Centre thickness of both lenses, or of lens 1 and lens 2; slab: thickness of the slab.
    web : float or None, length
        Plate joining the lenslets (biconvex); None: 0, or the neck where there is a seam.
    confocal : {"exact", "thin", "best"}
        Recipe for the radii.
    surface : {"ellipsoid", "biconic"}
        Shape of the faces.
    conic : (2,) tuple of float or None
        Conic constants of a biconic; None: the form's default.
    depth : (2,) tuple of float or None, length
        1/κ of lens 1 and 2; None: sqrt(|R_x R_y|).
    curved : {"outside", "inside"}
        Plano: which faces are curved.
    index : float or None
        Refractive index; None: from `material`.
    material : str or None
        Name in the table of materials.
    wavelength : float, metres
        Design wavelength.
    prescription : {"derived", "given"}
        Whether the recipe solves for the faces, or `face` gives them.
    face : tuple of FaceSpec
        The given faces in the order light reaches them: 2 for a slab, else 4. A field lens has two more. A
        slab that the field lens cuts in three has the faces of plano lenses.
    vertex : (2,) tuple of float or None, length
        Given offset of lens 2 in the lens frame; None: δ f1.
    offset : {"paraxial", "traced"} or None
        Position of lens 2: by paraxial rays, or so that traced light obeys the law; None: traced on
        non-uniform sheets.
    search : SearchRecord or None
        Origin of given faces.
    field_lens : bool
        Whether an array of lenses at the common focus images lens 1 onto lens 2.
    field : FieldSpec
        Properties of the field lens.
    focus : Conjugates or None
        Planes that every pair images sharply onto one another; None: the pair is afocal.
    """

    form: Literal["biconvex", "plano", "slab"]
    separation: float | None
    thickness: Literal["auto"] | float | Pair2
    web: float | None
    confocal: Literal["exact", "thin", "best"]
    surface: Literal["ellipsoid", "biconic"]
    conic: Pair2 | None
    depth: Pair2 | None
    curved: Literal["outside", "inside"]
    index: float | None
    material: str | None
    wavelength: float
    prescription: Literal["derived", "given"] = "derived"
    face: tuple[FaceSpec, ...] = ()
    vertex: Pair2 | None = None
    offset: Literal["paraxial", "traced"] | None = None
    search: SearchRecord | None = None
    field_lens: bool = False
    field: FieldSpec = FieldSpec()
    focus: Conjugates | None = None

    @property
    def given(self) -> bool:
        """Whether the faces are given."""
        return self.prescription == "given"

    def lens_faces(self, lens: int) -> slice:
        """Indices of the faces of lens 0 or 1, plane sides included, among the given faces."""
        if self.form == "slab" and len(self.face) < 6:
            return slice(0, 1) if lens == 0 else slice(-1, None)
        return slice(0, 2) if lens == 0 else slice(-2, None)

    @property
    def thicknesses(self) -> Pair2 | None:
        """Centre thickness of lens 1 and lens 2, None for "auto"."""
        if isinstance(self.thickness, str):
            return None
        return self.thickness if isinstance(self.thickness, tuple) else (self.thickness, self.thickness)


@dataclass(frozen=True, slots=True)
class Outline:
    """Outer shape of the sheet: a circle of diameter size[0], a rectangle size[0] by size[1], or a closed polygon.

    For a polygon, `points` are the corners (x, y, bulge of the side that begins there), lengths; `size` is
    that of the box centred on the origin that contains it.
    """

    shape: Literal["circle", "rectangle", "polygon"]
    size: Pair2
    points: tuple[Vertex, ...] = ()


@dataclass(frozen=True, slots=True)
class AimedAt:
    """Position of the viewer that a sheet is aimed at: a point of the sheet frame, lengths;
    z < 0 before array 1.
    """

    point: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class LatticeSpec:
    """Number and positions of the pairs.

    Parameters
    ----------
    kind : {"square", "rectangular", "hexagonal"}
        Pattern of the cells.
    pitch : (2,) tuple of float, length
        Cell size in x and y; hexagonal: centre to centre, given twice.
    count : (2,) tuple of int
        Cells along the two lattice vectors (hexagonal: cells per row, rows); by default the count that fills
        the outline.
    seam : float, length
        Width of the land along cell borders.
    seam_depth : float or None, length
        Plano, slab: land below the deepest optical point; None: pitch/50.
    outline : Outline or None
        Cells wholly inside are kept; None: the lattice's own outline.
    pitch_2 : (2,) tuple of float or None, length
        Pitch of array 2, whose lenses lie in the centres of their own cells; None: that of array 1.
    rotation_2 : float, radians
        Rotation of array 2's cells and of the positions of their lenses about its centre; lenses keep the
        law's axes.
    aperture : "centred", "aligned", (2,) tuple of float or AimedAt
        Cell 2 is cell 1 displaced by the height of centre 2 over centre 1 times this slope, or times that of
        a viewer's light.
    land : {"clear", "opaque"}
        Whether land transmits light.
    """

    kind: Literal["square", "rectangular", "hexagonal"]
    pitch: Pair2
    count: tuple[int, int]
    seam: float
    seam_depth: float | None
    outline: Outline | None
    aperture: Literal["centred", "aligned"] | Pair2 | AimedAt
    land: Literal["clear", "opaque"]
    pitch_2: Pair2 | None = None
    rotation_2: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """Opaque frame around the sheet: width beyond the border, height along z (None: as high as the sheet)."""

    width: float
    height: float | None


@dataclass(frozen=True, slots=True)
class BodySpec:
    """Parts in addition to the lenses.

    Parameters
    ----------
    border : float, length
        Width of the land around the sheet: around its cells, or beyond `lattice.outline`.
    neck : float or None, length
        Least thickness at an inner border; None: max(process minimum, pitch/50).
    baffle : bool
        Opaque honeycomb between the arrays.
    baffle_wall : float or None, length
        Wall thickness of the baffle; given if `baffle`.
    frame : Frame or None
        Opaque frame.
    roughness : float, length
        Rms height of the optical faces' roughness.
    slope_rms : float, radians
        Rms slope error of the optical faces.
    corners : CornersSpec or None
        Corners of a rectangular plate; None: sharp.
    holes : tuple of HoleSpec
    pins : PinsSpec or None
    outline : Outline or None
        Edge of the plate where it is not that of the cells; instead of `border`.
    """

    border: float
    neck: float | None
    baffle: bool
    baffle_wall: float | None
    frame: Frame | None
    roughness: float
    slope_rms: float
    corners: CornersSpec | None = None
    holes: tuple[HoleSpec, ...] = ()
    pins: PinsSpec | None = None
    outline: Outline | None = None

    @property
    def apart(self) -> bool:
        """Whether the plate has its own edge, separate from `lattice.outline`."""
        return self.border > 0.0 or self.outline is not None

    @property
    def shaped(self) -> bool:
        """Whether corners, holes or pins are requested."""
        return self.corners is not None or bool(self.holes) or self.pins is not None


@dataclass(frozen=True, slots=True)
class Allowed:
    """A warning that the designer accepts, with a reason."""

    code: str
    reason: str


@dataclass(frozen=True, slots=True)
class CheckSpec:
    """Limits for checks of the built design and its files. Angles in radians, lengths in design units.

    None means that the process profile gives the limit (`clearance edge neck radius sag part_height
    part_width materials pitch tool wall draft slope voxel layer aspect`), or that `law_rms` applies
    (`mesh_law_rms`).

    Parameters
    ----------
    field : float, radians
        Half angle of the cone of test rays.
    field_centre : {"axis", "normal"}
        Centre of that cone: the axis of the field (aperture slope), or the sheet's normal.
    process : str
        Name of the process profile.
    confocality : float
        Afocal defect over the separation; default .002 for exact recipes, .02 for thin, best and given faces.
    viewed : float
        Least share of the viewer's light that must obey the law, mean over the whole sheet.
    viewer, object : float, lengths
        Distance from the sheet to the eye before array 1 (see the check `viewed`), and to the object behind
        array 2.
    allow : tuple of Allowed
        Accepted warnings.
    """

    field: float
    field_centre: Literal["axis", "normal"]
    process: str
    law_rms: float
    law_bias: float
    mesh_law_rms: float | None
    eta: float
    delta: float
    confocality: float
    throughput: float
    cover: float
    clearance: float | None
    graph: float
    edge: float | None
    neck: float | None
    radius: float | None
    sag: float | None
    part_height: float | None
    part_width: float | None
    materials: tuple[str, ...] | None
    pitch: float | None
    tool: float | None
    wall: float | None
    draft: float | None
    slope: float | None
    voxel: float | None
    layer: float | None
    aspect: float | None
    volume: float
    shape: float
    file_rms: float
    pose: float
    scale: float
    fresnel_number: float
    viewed: float
    viewer: float | None
    object: float | None
    allow: tuple[Allowed, ...]

    @property
    def of_light(self) -> tuple[float, float, float, float, float]:
        """Limits for light through a file: rms and bias (radians), relative error of eta, error of delta,
        confocality.
        """
        rms = self.law_rms if self.mesh_law_rms is None else self.mesh_law_rms
        return rms, self.law_bias, self.eta, self.delta, self.confocality


@dataclass(frozen=True, slots=True)
class TolerancesSpec:
    """Fabrication errors, and limits of a good sheet. Lengths in design units, angles in radians.

    A field lens on its own plate has the larger tolerance of the two arrays. Each tolerance t means ±t
    (roughness: 0 … t); 0 means no error.

    Parameters
    ----------
    decentre : (2,) tuple of float, length
        Displacement of array 1 and array 2 as wholes, in x and in y.
    rotation : float, radians
        Rotation of array 2 relative to array 1 about the sheet's normal.
    separation : float, length
        Displacement of array 2 along the sheet's normal.
    radius : (2,) tuple of float
        Relative error of all radii of a face of array 1 and array 2.
    index : float
        Error of the refractive index of each body.
    thickness : (2,) tuple of float, length
        Error of the centre thickness of each body.
    tilt : float, radians
        Tilt of array 2 relative to array 1 about x and about y.
    roughness : float, length
        Rms height.
    distribution : {"normal", "uniform"}
        Normal: t is two standard deviations; uniform: t is the limit.
    samples, seed : int
        Number of samples and seed of the Monte-Carlo run.
    image_shift, blur, residual_power, moire_period : float or None
        Limits of a good sheet in addition to those of [check]: radians, radians, 1/m, length.
    """

    decentre: Pair2
    rotation: float
    separation: float
    radius: Pair2
    index: float
    thickness: Pair2
    tilt: float
    roughness: float
    distribution: Literal["normal", "uniform"]
    samples: int
    seed: int
    image_shift: float | None
    blur: float | None
    residual_power: float | None
    moire_period: float | None

    @staticmethod
    def of_array(halves: Pair2, array: int) -> float:
        """Tolerance of array 0 or 1; for a field lens, which has none of its own, the larger of the two."""
        return halves[array] if array < 2 else max(halves)

    def of_body(self, number: int, bodies: int) -> float:
        """Tolerance (length) of the thickness of body 1, 2 …;
        for a plate between two, the larger of theirs.
        """
        middle = bodies == 3 and number == 2
        return max(self.thickness) if middle else self.thickness[min(number, 2) - 1]


@dataclass(frozen=True, slots=True)
class LightSpec:
    """Light that illuminates the sheet.

    Parameters
    ----------
    coherent : bool
        Whether the light is coherent over many cells.
    """

    coherent: bool


DAYLIGHT = LightSpec(coherent=False)
"""Light of a design without a [light] section."""

NO_TOLERANCES = TolerancesSpec(
    (0.0, 0.0), 0.0, 0.0, (0.0, 0.0), 0.0, (0.0, 0.0), 0.0, 0.0, "normal", 1000, 0, None, None, None, None
)
"""Tolerances of a design without a [tolerances] section."""
