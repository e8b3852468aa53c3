"""One fixed text for each design: every key in fixed order, defaults written out, shortest numbers."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from clacad.base import units
from clacad.config.compound_kinds import Several
from clacad.config.edit_text import value_text
from clacad.config.quantities import Quantity
from clacad.design.given_faces import FaceSpec, face_table
from clacad.design.keys import CHECK, FORMAT, SECTIONS, Key
from clacad.design.plate_keys import CornersSpec, HoleSpec, PinsSpec, hole_table, vertex_lists
from clacad.design.search_record import SearchRecord
from clacad.design.sections import (
    DAYLIGHT,
    NO_TOLERANCES,
    AimedAt,
    Allowed,
    FieldSpec,
    Frame,
    Outline,
    PairSpec,
)
from clacad.design.varying import Conjugates, VaryingSpec, planes_table, varying_table

if TYPE_CHECKING:
    from clacad.design.model import Design


def to_dict(design: Design) -> dict[str, Any]:
    """Return the design as nested dictionaries with the keys of a file; None is left out."""
    made: dict[str, Any] = {"format": FORMAT, "name": design.name, "unit": design.unit}
    if design.notes:
        made["notes"] = list(design.notes)
    parts = {"law": design.law_spec, "pair": design.pair, "lattice": design.lattice, "body": design.body,
             "check": design.check, "tolerances": design.tolerances, "light": design.light}  # fmt: skip
    for section, spec in parts.items():
        if spec in (NO_TOLERANCES, DAYLIGHT):
            continue  # the text of a design without these sections must not change
        values: dict[str, Any] = {}
        for name, key in SECTIONS[section].items():
            if section == "pair" and _left_out(name, design.pair):
                continue
            value = getattr(spec, "euler_degrees" if name == "euler" else name)
            if value is not None and value != ():
                values[name] = _written(value, key, design)
        if section == "lattice" and design.lattice.kind != "rectangular":
            values |= {name: values[name][0] for name in ("pitch", "pitch_2") if name in values}
        if section == "lattice" and not design.lattice.rotation_2:
            del values["rotation_2"]  # a key of a later version is left out at its default
        if section == "check":
            _keep_as_before(values, design)
        made[section] = values
    return made


def _keep_as_before(values: dict[str, Any], design: Design) -> None:
    """Keep hashes of earlier designs: leave out `viewed` at its default, write distances with their unit."""
    if design.check.viewed == CHECK["viewed"].default:
        del values["viewed"]
    for name in ("viewer", "object"):
        if name in values:
            values[name] = _with_unit(values[name], design.unit)


OF_RECIPES = ("confocal", "surface", "conic", "depth")
"""Keys of the recipes that solve for faces."""


def _left_out(name: str, pair: PairSpec) -> bool:
    """Whether a key of [pair] is left out of the text;
    a key of a later version is at its default, to keep hashes.
    """
    if name == "curved":
        return pair.form != "plano"
    if name == "field_lens":
        return not pair.field_lens
    if name == "field":
        return pair.field == FieldSpec()
    return name in OF_RECIPES if pair.given else name == "prescription"


def _written(value: Any, key: Key, design: Design) -> Any:
    kind = key.kind
    if isinstance(value, SearchRecord):
        return value.to_dict()
    if isinstance(value, CornersSpec):
        return {value.shape: value.size}
    if isinstance(value, PinsSpec):
        return {"diameter": value.diameter, "at": [list(p) for p in value.at], "play": value.play}
    if isinstance(value, tuple) and value and isinstance(value[0], HoleSpec):
        return [hole_table(hole) for hole in value]
    if isinstance(value, Outline) and value.shape == "polygon":
        return {"polygon": vertex_lists(value.points)}
    if isinstance(value, Outline):
        return {value.shape: value.size[0] if value.shape == "circle" else list(value.size)}
    if isinstance(value, AimedAt):
        return {"point": list(value.point)}
    if isinstance(value, Frame):
        return {"width": value.width} | ({} if value.height is None else {"height": value.height})
    if isinstance(value, VaryingSpec):
        return varying_table(value)
    if isinstance(value, Conjugates):
        return planes_table(value)
    if isinstance(value, FieldSpec):
        return {part: given for part in ("conic", "gap") if (given := getattr(value, part)) is not None}
    if isinstance(value, tuple) and value and isinstance(value[0], FaceSpec):
        return [face_table(face) for face in value]
    if isinstance(value, tuple) and value and isinstance(value[0], Allowed):
        return [{"code": item.code, "reason": item.reason} for item in value]
    if isinstance(kind, Quantity) and isinstance(value, float):
        return _quantity(value, kind, design)
    if isinstance(kind, Several) and isinstance(kind.kind, Quantity) and isinstance(value, tuple):
        return [_quantity(v, kind.kind, design) for v in value]
    return list(value) if isinstance(value, tuple) else value


def _quantity(value: float, kind: Quantity, design: Design) -> float | str:
    if kind.family == "wavelength":
        return units.nanometres(value)
    if kind.family == "angle" and not kind.degrees:
        return f"{value!r} rad"
    if kind.family == "length" and not kind.bare:
        return _with_unit(value, design.unit)
    return value


def _with_unit(value: float, unit: str) -> str:
    """Write a length of `value` units of the design with a unit word, so that it reads back exactly."""
    if unit in units.LENGTHS:
        return f"{value!r} {unit}"
    parts = units.split(unit)
    assert parts is not None, unit  # the unit was validated when the design was made
    return f"{_decimal(Fraction(repr(value)) * parts[0])} {parts[1]}"


def _decimal(number: Fraction) -> str:
    """Return a terminating decimal fraction, digit for digit."""
    tens, whole = 0, number
    while whole.denominator != 1:
        whole, tens = whole * 10, tens + 1
    return f"{whole.numerator}e-{tens}" if tens else str(whole.numerator)


def to_toml(data: Mapping[str, Any]) -> str:
    """Write nested dictionaries (one level of tables) as TOML."""
    lines = [f"{key} = {value_text(value)}" for key, value in data.items() if not isinstance(value, Mapping)]
    for section, values in data.items():
        if isinstance(values, Mapping):
            lines += ["", f"[{section}]", *(f"{key} = {value_text(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"
