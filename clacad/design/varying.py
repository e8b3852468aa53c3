"""Variation of the law over the sheet (`[law.varying]`), planes that are imaged, and the gradient K."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

from clacad.base.units import Unit
from clacad.config.compound_kinds import REQUIRED, OneOf, Record, Several, key
from clacad.config.value_kinds import JsonSchema, Quantity, Refusal
from clacad.design.cell_table import TABLE_NAME, TableSpec

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2
    from clacad.optics.law.focusing import Gradient

_XY: Final = ("x", "y")
MAGNIFIED: Final = 1e-9
"""Relative tolerance between law.eta and the η required by a magnification."""


@dataclass(frozen=True, slots=True)
class Reach:
    """A length that may be infinite: a number, or "inf"."""

    what: str
    least: float = -1e9
    most: float = 1e9

    def read(self, value: object, unit: Unit) -> float:
        """Return the length in design units."""
        if isinstance(value, float) and math.isinf(value):
            value = "inf" if value > 0.0 else "-inf"
        if isinstance(value, str) and value.strip().lstrip("+-") == "inf":
            number = -math.inf if value.strip().startswith("-") else math.inf
            if (number > 0.0 and self.most <= 0.0) or (number < 0.0 and self.least >= 0.0):
                raise Refusal("CL106", "is out of range", value, self.allowed(unit))
            return number
        found = Quantity("length", self.what, least=self.least, most=self.most).read(value, unit)
        if found == 0.0:
            raise Refusal("CL106", "is out of range", value, self.allowed(unit))
        return found

    def write(self, value: float, unit: Unit) -> float | str:
        """Return the length, or "inf" or "-inf"."""
        return value if math.isfinite(value) else "inf" if value > 0.0 else "-inf"

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return f'{Quantity("length", self.what).allowed(unit)}, or "inf"'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a number or text."""
        return {"description": self.what, "anyOf": [{"type": "number"}, {"type": "string"}]}


@dataclass(frozen=True, slots=True)
class TableFileName:
    """The name of a table of cells, alone or with its required SHA-256."""

    def read(self, value: object, unit: Unit) -> TableSpec:
        """Return the name and hash; the hash is "" where none is stated."""
        found = (
            TableSpec(TABLE_NAME.read(value, unit), "")
            if isinstance(value, str)
            else _TABLE.read(value, unit)
        )
        if not found.file.lower().endswith((".csv", ".npz")):
            raise Refusal("CL106", "is neither CSV nor NPZ", found.file, self.allowed(unit))
        return found

    def write(self, value: TableSpec, unit: Unit) -> dict[str, str]:
        """Return the table of name and hash."""
        return _TABLE.write(value, unit)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return TABLE_NAME.what + ', or {file = "...", sha256 = "..."}'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a text, or of a table of two keys."""
        return {"anyOf": [TABLE_NAME.schema(), _TABLE.schema()]}


_TABLE: Final = Record(TableSpec)


_NUMBER: Final = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)
_REACH: Final = Reach("a length, not 0")


@dataclass(frozen=True, slots=True)
class Planes:
    """Two planes: `object` lies at this height before array 1 (< 0; −inf for parallel light), `image` at this
    distance behind array 2 (negative: virtual, inf: parallel light leaves).
    """

    object: float = key(Reach("a length < 0", most=-1e-300), "height of the object, < 0", REQUIRED)
    image: float = key(_REACH, "distance of the image behind array 2", REQUIRED)


@dataclass(frozen=True, slots=True)
class Conjugates(Planes):
    """Two planes that are images of one another.

    `magnification` along the lens axes; None: it follows from η.
    """

    magnification: Pair2 | None = key(
        Several(_NUMBER, _XY, single=True), "magnification; by default that of eta"
    )


@dataclass(frozen=True, slots=True)
class VaryingSpec:
    """Variation of δ over the sheet; exactly one of the four is given.

    f_image : (2,) tuple of float or None, lengths
        Distance behind array 2 at which parallel light is focused, along the lens axes.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)) or None, 1/length. dδ/d(x, y): lens axes by sheet axes.
    table : Table of δ, and optionally η, of every cell.
    """

    f_image: Pair2 | None = None
    conjugates: Conjugates | None = None
    gradient: Gradient | None = None
    table: TableSpec | None = None

    @property
    def parts(self) -> tuple[str, Any]:
        """Key and value of the one that is given."""
        return next(
            (one.name, found) for one in fields(self) if (found := getattr(self, one.name)) is not None
        )


VARYING: Final = OneOf(
    (
        ("f_image", Several(_REACH, _XY, single=True)),
        ("conjugates", Record(Conjugates)),
        ("gradient", Several(Several(_NUMBER, _XY), ("delta_x", "delta_y"))),
        ("table", TableFileName()),
    ),
    lambda name, value: VaryingSpec(**{name: value}),
    lambda spec: spec.parts,
)
"""Kind of `law.varying`."""


def needed_eta(planes: Conjugates, separation: float) -> Pair2 | None:
    """η required by the magnifications of two planes (lengths); None where no magnification is given."""
    from clacad.optics.law.focusing import imaging_scaled

    if planes.magnification is None:
        return None
    x, y = (imaging_scaled(planes.object, planes.image, m, separation)[0] for m in planes.magnification)
    return x, y


def gradient_of(spec: VaryingSpec, eta: Pair2, separation: float) -> Gradient | None:
    """K, 1/length: lens axes by lens axes for f_image and conjugates, by sheet axes as given; or None.

    eta : (2,) numbers
    separation : length. Separation of the arrays, in air.
    """
    from clacad.optics.law.focusing import focusing_at, imaging, imaging_scaled

    if spec.gradient is not None or spec.table is not None:
        return spec.gradient
    if spec.f_image is not None:
        x, y = (focusing_at(e, f) for e, f in zip(eta, spec.f_image, strict=True))
        return (x, 0.0), (0.0, y)
    planes = spec.conjugates
    assert planes is not None  # one of the four is given
    if planes.magnification is not None:
        x, y = (imaging_scaled(planes.object, planes.image, m, separation)[1] for m in planes.magnification)
    else:
        x, y = (imaging(e, planes.object, planes.image, separation) for e in eta)
    return (x, 0.0), (0.0, y)
