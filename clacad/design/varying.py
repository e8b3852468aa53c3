"""Variation of the law over the sheet (`[law.varying]`):
kinds of its values, the value they are read into, and its K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from clacad.base.units import Unit
from clacad.config.compound_kinds import InlineTable, Several
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import JsonSchema, Refusal, Text
from clacad.design.cell_table import TableSpec

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2
    from clacad.optics.law.varying import Gradient

_XY: Final = ("x", "y")
MAGNIFIED: Final = 1e-9
"""Relative tolerance between law.eta and the η required by a magnification."""


@dataclass(frozen=True, slots=True)
class Conjugates:
    """Two planes that are images of one another.

    Parameters
    ----------
    object : float, length
        Height before array 1, < 0; −inf for parallel light.
    image : float, length
        Distance behind array 2; negative: virtual, inf: parallel light leaves.
    magnification : (2,) tuple of float or None
        Magnification along the lens axes; None: it follows from η.
    """

    object: float
    image: float
    magnification: Pair2 | None = None


@dataclass(frozen=True, slots=True)
class VaryingSpec:
    """Variation of δ over the sheet; exactly one of the four is given.

    Parameters
    ----------
    f_image : (2,) tuple of float or None, lengths
        Distance behind array 2 at which parallel light is focused, along the lens axes.
    conjugates : Conjugates or None
    gradient : ((K_xx, K_xy), (K_yx, K_yy)) or None, 1/length
        dδ/d(x, y): lens axes by sheet axes.
    table : TableSpec or None
        Table of δ, and optionally η, of every cell.
    """

    f_image: Pair2 | None = None
    conjugates: Conjugates | None = None
    gradient: Gradient | None = None
    table: TableSpec | None = None


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

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return f'{Quantity("length", self.what).allowed(unit)}, or "inf"'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a number or text."""
        return {"description": self.what, "anyOf": [{"type": "number"}, {"type": "string"}]}


@dataclass(frozen=True, slots=True)
class TableFileName:
    """The name of a table of cells, alone or with its required SHA-256."""

    name: Text = Text("the name of a CSV or NPZ file in the design's folder", 200)
    stated: Text = Text("a SHA-256 in hexadecimal", 64, pattern="[0-9a-f]{64}")

    def read(self, value: object, unit: Unit) -> TableSpec:
        """Return the name and hash; the hash is "" where none is stated."""
        if isinstance(value, str):
            return TableSpec(self._named(value, unit), "")
        kinds = (("file", self.name), ("sha256", self.stated))
        found = dict(InlineTable(kinds, required=("file", "sha256")).read(value, unit))
        return TableSpec(self._named(found["file"], unit), found["sha256"])

    def _named(self, value: str, unit: Unit) -> str:
        name = self.name.read(value, unit)
        if not name.lower().endswith((".csv", ".npz")):
            raise Refusal("CL106", "is neither CSV nor NPZ", value, self.allowed(unit))
        return name

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.name.what + ', or {file = "...", sha256 = "..."}'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a text, or of a table of two keys."""
        both = InlineTable((("file", self.name), ("sha256", self.stated)), required=("file", "sha256"))
        return {"anyOf": [self.name.schema(), both.schema()]}


_NUMBER = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)
_REACH = Reach("a length, not 0")
_PLANES: Final = (("object", Reach("a length < 0", most=-1e-300)), ("image", _REACH))
PLANES: Final = InlineTable(_PLANES, required=("object", "image"))
"""Kind of a value that gives two planes."""
VARYING: Final = InlineTable(
    (
        ("f_image", Several(_REACH, _XY, single=True)),
        (
            "conjugates",
            InlineTable(
                (*_PLANES, ("magnification", Several(_NUMBER, _XY, single=True))),
                required=("object", "image"),
            ),
        ),
        ("gradient", Several(Several(_NUMBER, _XY), ("delta_x", "delta_y"))),
        ("table", TableFileName()),
    ),
    exactly_one=True,
)
"""Kind of the value of `law.varying`."""


def varying_read(pairs: tuple[tuple[str, Any], ...]) -> VaryingSpec:
    """Variation from the value read by `VARYING`."""
    ((name, value),) = pairs
    found: dict[str, Any] = {name: Conjugates(**dict(value)) if name == "conjugates" else value}
    return VaryingSpec(**found)


def varying_table(spec: VaryingSpec) -> dict[str, Any]:
    """The variation as a table of a design file; `VARYING` reads it back."""
    if spec.f_image is not None:
        return {"f_image": [_reach(v) for v in spec.f_image]}
    if spec.gradient is not None:
        return {"gradient": [list(row) for row in spec.gradient]}
    if spec.table is not None:
        return {"table": {"file": spec.table.file, "sha256": spec.table.sha256}}
    assert spec.conjugates is not None  # one of the four is given
    return {"conjugates": planes_table(spec.conjugates)}


def planes_table(planes: Conjugates) -> dict[str, Any]:
    """Two planes as a table of a design file; `PLANES` reads it back."""
    made: dict[str, Any] = {"object": _reach(planes.object), "image": _reach(planes.image)}
    return made if planes.magnification is None else made | {"magnification": list(planes.magnification)}


def _reach(length: float) -> float | str:
    return length if math.isfinite(length) else "inf" if length > 0.0 else "-inf"


def needed_eta(planes: Conjugates, separation: float) -> Pair2 | None:
    """η required by the magnifications of two planes (lengths); None where no magnification is given."""
    from clacad.optics.law.focusing import imaging_scaled

    if planes.magnification is None:
        return None
    x, y = (imaging_scaled(planes.object, planes.image, m, separation)[0] for m in planes.magnification)
    return x, y


def gradient_of(spec: VaryingSpec, eta: Pair2, separation: float) -> Gradient | None:
    """K, 1/length: lens axes by lens axes for f_image and conjugates, by sheet axes as given; None for a table.

    Parameters
    ----------
    spec : VaryingSpec
    eta : (2,) numbers
    separation : float, length
        Separation of the arrays, in air.
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
