"""Sections [law], [pair], [lattice] and [light] of a design file: each field is a key of the file.

Lengths are multiples of `Design.unit_m` metres, wavelengths metres, angles radians; the Euler angles are kept
in degrees, as written, so that 90 degrees stays exact. `clacad explain pair.web` prints what a key means.

The module also lists all keys of a design file, those of `design.body` and `design.limit_sections` included:
`PAIR.separation` is the path "pair.separation".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from clacad.config import key_reader as schema
from clacad.config.compound_kinds import (
    REQUIRED,
    Key,
    KeyPaths,
    ListOf,
    ListOr,
    Record,
    Several,
    WordOr,
    key,
    keys_of,
)
from clacad.config.key_reader import FileForm, head_keys
from clacad.config.value_kinds import (
    LARGEST_COUNT,
    LENGTH,
    LENGTH_ABOVE_0,
    LENGTH_FROM_0,
    Flag,
    Quantity,
    Text,
    Whole,
    Word,
)
from clacad.design.body import OUTLINE, BodySpec, Outline
from clacad.design.faces import CONIC, FaceSpec, SearchRecord
from clacad.design.limit_sections import CheckSpec, ProcessSpec, TolerancesSpec
from clacad.design.varying import VARYING, Planes, VaryingSpec

if TYPE_CHECKING:
    from clacad.base.types import Pair2


_ETA: Final = Quantity("ratio", "a number, not 0, from -1e6 to 1e6", least=-1e6, most=1e6)
_DELTA: Final = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)
_EULER: Final = Quantity(
    "angle", "an angle from -36000 to 36000 deg", least=-36000.0, most=36000.0, degrees=True
)
_SLOPE: Final = Quantity("ratio", "a slope from -100 to 100", least=-100.0, most=100.0)
_INDEX: Final = Quantity("ratio", "a number > 1, at most 10", above=1.0, most=10.0)
_WAVELENGTH: Final = Quantity("wavelength", "a wavelength from 10 nm to 1 mm", least=1e-8, most=1e-3)
_TURN: Final = Quantity(
    "angle", "an angle from -45 to 45 deg", least=-math.pi / 4, most=math.pi / 4, bare=False
)
_XY: Final = ("x", "y")
_LENSES: Final = ("lens 1", "lens 2")


@dataclass(frozen=True, slots=True, kw_only=True)
class LawSpec:
    """Section [law]: the requested law of refraction, paper eqs (4), (5) and section 3.

    η_i = −f2_i/f1_i and δ_i = d_i/f1_i for i = x, y in the lens frame. `euler_degrees` are φ, θ, ψ as
    written: R = Rz(ψ) Rx(θ) Rz(φ) for fixed axes, Rz(φ) Rx(θ) Rz(ψ) for moving ones. `varying` None: all
    cells obey one law.
    """

    eta: Pair2 = key(
        Several(_ETA, _XY, not_all=(0.0, 1.0), example="[-1.0, -1.0]"),
        "eta_i = -f2_i/f1_i in the lens frame",
        REQUIRED,
    )
    delta: Pair2 = key(Several(_DELTA, _XY), "delta_i = d_i/f1_i, offset of lens 2", (0.0, 0.0))
    euler_degrees: tuple[float, float, float] = key(
        Several(_EULER, ("phi", "theta", "psi")), "turns about z, x, z", (0.0, 0.0, 0.0), name="euler"
    )
    euler_axes: Literal["fixed", "moving"] = key(
        Word(("fixed", "moving")), "whether the turns are about fixed or moving axes", "fixed"
    )
    varying: VaryingSpec | None = key(
        VARYING, "how delta varies over the sheet: f_image, conjugates, gradient or table"
    )

    @property
    def cylinders(self) -> bool:
        """Whether the lenses of the law have power along one of their axes only."""
        return 1.0 in self.eta

    @property
    def euler(self) -> tuple[float, float, float]:
        """φ, θ, ψ in radians."""
        phi, theta, psi = (math.radians(angle) for angle in self.euler_degrees)
        return phi, theta, psi

    def words(self, turned: bool = False) -> str:
        """Requested law as text: "eta = (-0.25, -1), phi = 45°, theta = 0.5°, psi = 90°".

        Parameters
        ----------
        turned : bool
            Whether to write the three angles even if all are 0; a non-zero offset is always written.
        """
        parts = [f"eta = ({self.eta[0]:.4g}, {self.eta[1]:.4g})"]
        if any(self.delta):
            parts.append(f"delta = ({self.delta[0]:.4g}, {self.delta[1]:.4g})")
        if turned or any(self.euler_degrees):
            names = zip(("phi", "theta", "psi"), self.euler_degrees, strict=True)
            parts += [f"{name} = {angle:.5g}°" for name, angle in names]
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """Requested properties of the field lens.

    `conic` None: 0 between the two plates of a slab, −n² on a plate in air. `gap` None: the larger of
    pitch/25 and 1.25 times the clearance limit.
    """

    conic: float | None = key(CONIC, "conic constant of the faces of the field lens")
    gap: float | None = key(LENGTH_ABOVE_0, "air gap between the plates of a slab, vertex to vertex")


def _derived(pair: PairSpec, value: Any) -> Any:
    """Write keys of the recipes where the recipe solves for the faces."""
    return None if pair.given or pair.layers else value


def _of_layers(pair: PairSpec, value: Any) -> Any:
    """Write keys of the recipes that layers have, too."""
    return None if pair.given else value


def _plano(pair: PairSpec, curved: str) -> str | None:
    """Write which faces are curved where there is a choice."""
    return curved if pair.form == "plano" else None


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSpec:
    """Section [pair]: construction of a lenslet pair. Lengths in design units, wavelength in metres.

    Two biconvex lenses, two plano-convex ones, both faces of one slab, or any plates, listed face by face
    with the medium behind each. None means: of `separation`, given
    by `thickness`; of `web`, 0, or the neck where there is a seam; of `conic`, the form's default; of `depth`
    (1/κ of lens 1 and 2), sqrt(|R_x R_y|); of `index`, from `material`; of `vertex`, δ f1; of `offset`,
    traced on non-uniform sheets; of `focus`, afocal. The given faces are 2 for a slab, else 4. A field lens
    has two more; a slab that the field lens cuts in three has the faces of plano lenses.
    """

    form: Literal["biconvex", "plano", "slab", "plates"] = key(
        Word(("biconvex", "plano", "slab", "plates")), "how a lenslet pair is built", REQUIRED
    )
    separation: float | None = key(
        LENGTH_ABOVE_0, "biconvex: centre to centre; plano: f1 + f2 in air; slab: thickness / index"
    )
    thickness: Literal["auto"] | float | Pair2 = key(
        WordOr(("auto",), Several(LENGTH_ABOVE_0, _LENSES, single=True, alone=True)),
        "centre thickness",
        "auto",
    )
    web: float | None = key(
        LENGTH_FROM_0, "biconvex: thickness of the plate that joins the lenslets of an array"
    )
    confocal: Literal["exact", "thin", "best"] = key(
        Word(("exact", "thin", "best")), "recipe for the radii", "exact", written=_derived
    )
    surface: Literal["ellipsoid", "biconic"] = key(
        Word(("ellipsoid", "biconic")), "shape of the lens faces", "ellipsoid", written=_derived
    )
    conic: Pair2 | None = key(Several(CONIC, _XY), "biconic, layers: conic constants", written=_of_layers)
    depth: Pair2 | None = key(
        Several(LENGTH_ABOVE_0, _LENSES, single=True),
        "ellipsoid: semi-axis along the optical axis",
        written=_derived,
    )
    curved: Literal["outside", "inside"] = key(
        Word(("outside", "inside")), "plano: which faces are curved", "outside", written=_plano
    )
    index: float | None = key(_INDEX, "refractive index")
    material: str | None = key(Text("the name of a material", 60), "material instead of an index")
    wavelength: float = key(_WAVELENGTH, "design wavelength", 550e-9)
    prescription: Literal["derived", "given"] = key(
        Word(("derived", "given")),
        "derived: faces follow from eta and delta; given: they are listed in [[pair.face]]",
        "derived",
        later=True,
    )
    face: tuple[FaceSpec, ...] = key(
        ListOf(Record(FaceSpec), "tables"),
        "given: the faces in the order light meets them, in their own lens frames",
        (),
    )
    vertex: Pair2 | None = key(Several(LENGTH, _XY), "given: lens 2's offset (d_x, d_y) instead of delta f1")
    offset: Literal["paraxial", "traced"] | None = key(
        Word(("paraxial", "traced")),
        "place of lens 2: by paraxial rays, or where the mean traced light of its cell obeys the law"
        " (default for non-uniform sheets)",
    )
    search: SearchRecord | None = key(
        Record(SearchRecord),
        "given: where the faces come from; clacad optimise writes it, nothing is built from it",
    )
    field_lens: bool = key(
        Flag(), "lenses at the common focus, which image lens 1 onto lens 2", False, later=True
    )
    field: FieldSpec = key(
        Record(FieldSpec),
        "field lens: conic constant of its faces, and air gap between the plates of a slab",
        FieldSpec(),
        later=True,
    )
    focus: Planes | None = key(
        WordOr(("afocal",), Record(Planes), absent="afocal"),
        "afocal: parallel light leaves parallel; or two planes that every pair images sharply to one another",
    )

    layers: tuple[str, ...] = key(
        ListOf(Text("the name of a material", 60), "texts"),
        "slab: outer, inner and outer material of flat layers, whose thicknesses keep white light afocal",
        (),
    )

    @property
    def given(self) -> bool:
        """Whether the faces are given."""
        return self.prescription == "given" or self.form == "plates"

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


OF_RECIPES: Final = tuple(
    name for name, one in keys_of(PairSpec).items() if one.written in (_derived, _of_layers)
)
"""Keys of the recipes that solve for faces."""


@dataclass(frozen=True, slots=True)
class AimedAt:
    """Viewer's position a sheet is aimed at: a point of the sheet frame, lengths; z < 0 before array 1."""

    point: tuple[float, float, float] = key(Several(LENGTH, ("x", "y", "z")), "where the viewer is", REQUIRED)


def _pitch_of_kind(lattice: LatticeSpec, pitch: Pair2 | None) -> Pair2 | float | None:
    """Write one pitch where the lattice has one."""
    return pitch if pitch is None or lattice.kind == "rectangular" else pitch[0]


@dataclass(frozen=True, slots=True)
class OpaqueLine:
    """Opaque line along the borders of all cells, printed or etched on one face; `face` counts from 1."""

    face: int = key(Whole("a whole number from 1 to 40", 1, 40), "face, in the order of the light", REQUIRED)
    width: float = key(LENGTH_ABOVE_0, "width of the line", REQUIRED)


@dataclass(frozen=True, slots=True, kw_only=True)
class LatticeSpec:
    """Section [lattice]: number and positions of the pairs. Lengths in design units, `rotation_2` in radians.

    A hexagonal pitch is the distance of centres, given twice; its count is cells per row, rows. None means:
    of `seam_depth`, pitch/50; of `outline`, the lattice's own; of `pitch_2`, that of array 1. Lenses of array
    2 with a pitch or rotation of its own lie in the centres of their cells and keep the law's axes. Cell 2 is
    cell 1 displaced by the height of centre 2 over centre 1 times the slope `aperture`, or times that of a
    viewer's light.
    """

    kind: Literal["square", "rectangular", "hexagonal"] = key(
        Word(("square", "rectangular", "hexagonal")), "pattern of the cells", "square"
    )
    pitch: Pair2 = key(
        Several(LENGTH_ABOVE_0, _XY, single=True), "size of a cell", REQUIRED, written=_pitch_of_kind
    )
    count: tuple[int, int] = key(
        Several(Whole(f"a whole number from 1 to {LARGEST_COUNT}"), ("n1", "n2"), single=True),
        "number of cells; may be left out with an outline, which is then filled",
    )
    seam: float = key(LENGTH_FROM_0, "width of the land along cell borders", 0.0)
    seam_depth: float | None = key(
        LENGTH_ABOVE_0, "plano, slab: how far the land lies below the deepest optical point"
    )
    outline: Outline | None = key(OUTLINE, "outer shape of the cells; cells wholly inside are kept")
    aperture: Literal["centred", "aligned"] | Pair2 | AimedAt = key(
        WordOr(("centred", "aligned"), ListOr(Several(_SLOPE, _XY), Record(AimedAt))),
        "place of cell 2 of a telescopelet; point: where the light of a viewer there arrives",
        "centred",
    )
    land: Literal["clear", "opaque"] = key(
        Word(("clear", "opaque")), "whether land lets light through", "clear"
    )
    line: OpaqueLine | None = key(
        Record(OpaqueLine),
        "opaque line along the borders of all cells, printed or etched on one face",
        later=True,
    )
    pitch_2: Pair2 | None = key(
        Several(LENGTH_ABOVE_0, _XY, single=True),
        "size of a cell of array 2, where it is another: a superlens",
        written=_pitch_of_kind,
    )
    rotation_2: float = key(
        _TURN, "turn of array 2 against array 1 about the sheet's normal: a moire magnifier", 0.0, later=True
    )


SPECTRA: Final[dict[str, dict[float, float]]] = {
    "visible": dict.fromkeys((486.1e-9, 546.1e-9, 587.6e-9, 656.3e-9), 1.0),
    "photopic": {470e-9: 0.091, 510e-9: 0.503, 555e-9: 1.0, 610e-9: 0.503, 650e-9: 0.107},
    "rgb": dict.fromkeys((611.4e-9, 549.1e-9, 464.2e-9), 1.0),
    "D65": dict.fromkeys((1e-9 * (440.0 + 26.25 * k) for k in range(9)), 1.0),
}
"""Lines of white light: wavelength in metres → weight. Designs and pictures have visible: F, e, d and C, and
photopic: V(λ) of CIE 1924. Pictures alone have rgb: dominant wavelengths of the sRGB primaries (ITU-R BT.709)
under D65, and D65: nine samples of daylight, nearly all of the eye's response."""

KELVIN: Final = 20.0
"""Change of temperature at which the law is measured where the design states none."""


_PER_KELVIN: Final = Quantity("ratio", "a number from -0.01 to 0.01, per kelvin", least=-0.01, most=0.01)


@dataclass(frozen=True, slots=True)
class LineSpec:
    """One line of white light; its wavelength in metres."""

    wavelength: float = key(_WAVELENGTH, "wavelength of the line", REQUIRED)
    weight: float = key(Quantity("ratio", "a number > 0", above=0.0), "weight of the line", 1.0)


@dataclass(frozen=True, slots=True)
class ThermalSpec:
    """Thermal numbers of one material (1/K), in place of those of the table."""

    material: str = key(Text("the name of a material", 60), "material whose numbers are stated", REQUIRED)
    dn_dt: float | None = key(_PER_KELVIN, "change of the index with temperature, 1/K")
    expansion: float | None = key(_PER_KELVIN, "linear thermal expansion, 1/K")
    source: str = key(Text("a source", 200), "source of the numbers", "the design")


LINES: Final = ListOf(Record(LineSpec), "tables", least=1)
"""A list of lines, as designs and scenes state them."""


def lines_of(spectrum: str | float | tuple[LineSpec, ...]) -> dict[float, float]:
    """Lines of light (wavelength in metres → weight) by a word of `SPECTRA`, one wavelength, or a list."""
    if isinstance(spectrum, str):
        return SPECTRA[spectrum]
    if isinstance(spectrum, float):
        return {spectrum: 1.0}
    found: dict[float, float] = {}
    for line in spectrum:
        found[line.wavelength] = found.get(line.wavelength, 0.0) + line.weight
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class LightSpec:
    """Section [light]: light that illuminates the sheet. `temperature` in kelvin.

    `spectrum` None: the lines F e d C, in light that is not coherent, where every material has an index at
    them that depends on the wavelength.
    """

    coherent: bool = key(Flag(), "whether the light is one wave over many cells, as a laser's", False)
    spectrum: Literal["visible", "photopic"] | tuple[LineSpec, ...] | None = key(
        WordOr(("visible", "photopic"), LINES),
        "lines of white light: F e d C with equal weights, five lines weighted by V(lambda), or a list",
    )
    temperature: float | None = key(
        Quantity(
            "temperature", "a difference of temperature > 0, at most 200 K", above=0.0, most=200.0, bare=False
        ),
        "change of temperature, up and down, at which the law is measured (20 K)",
    )
    thermal: tuple[ThermalSpec, ...] | None = key(
        ListOf(Record(ThermalSpec), "tables", least=1),
        "dn/dT and expansion of materials of the sheet, in place of those of the table",
    )

    @property
    def lines(self) -> dict[float, float]:
        """Lines of white light: wavelength in metres → weight."""
        return lines_of(self.spectrum or "visible")


ROOT: Final = head_keys(
    "name of the design, used for files and reports", "unit of every bare length", "remarks the report prints"
)

SPECS: Final[dict[str, type]] = {
    "law": LawSpec,
    "pair": PairSpec,
    "lattice": LatticeSpec,
    "body": BodySpec,
    "check": CheckSpec,
    "tolerances": TolerancesSpec,
    "light": LightSpec,
    "process": ProcessSpec,
}
"""Section → the dataclass whose fields are its keys."""

SECTIONS: Final[dict[str, dict[str, Key]]] = {name: keys_of(spec) for name, spec in SPECS.items()}

LAW, PAIR, LATTICE, BODY, CHECK, TOLERANCES, LIGHT, PROCESS = (
    KeyPaths(name, keys) for name, keys in SECTIONS.items()
)

DESIGN: Final = FileForm(
    ROOT,
    SECTIONS,
    optional=("body", "check", "tolerances", "light", "process"),
    synonyms={
        **dict.fromkeys(("phi", "theta", "psi", "tilt", "angles"), LAW.euler),
        **dict.fromkeys(("eta_x", "eta_y"), LAW.eta),
        **dict.fromkeys(("delta_x", "delta_y", "offset"), LAW.delta),
        **dict.fromkeys(("n", "refractive_index"), PAIR.index),
        **dict.fromkeys(("gap", "distance"), PAIR.separation),
        **dict.fromkeys(("size", "cells"), LATTICE.count),
        "glass": PAIR.material,
        "lambda": PAIR.wavelength,
        "recipe": PAIR.confocal,
        "type": PAIR.form,
        "period": LATTICE.pitch,
        "shape": LATTICE.outline,
        "wall": BODY.baffle_wall,
        "dowels": BODY.pins,
        "mounting": BODY.holes,
        "chamfer": BODY.corners,
        "units": "unit",
        "version": "format",
        "title": "name",
    },
    elsewhere=dict.fromkeys(
        ("sheet", "camera", "background", "object", "effects", "animation"), ("scene", "")
    ),
)
"""Keys of a design file, their other names, and the sections of a scene file."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a design file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused.
    """
    titles = {name: name.capitalize() for name in SECTIONS}
    properties = schema.properties_of(ROOT) | {
        name: {"$ref": f"#/$defs/{title}"} for name, title in titles.items()
    }
    required = schema.required_of(ROOT) + [name for name in SECTIONS if name not in DESIGN.optional]
    definitions = {title: schema.table(SECTIONS[name], title) for name, title in titles.items()}
    return schema.document("clacad design", properties, required, definitions)
