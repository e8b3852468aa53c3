"""Reading of designs from a file, a dictionary or changed keys into checked sections;
all mistakes are reported at once.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clacad.base import units
from clacad.base.text import DEEPEST, did_you_mean, plain
from clacad.base.units import Unit
from clacad.config import overrides as override
from clacad.config.design_error import DesignError
from clacad.config.key_positions import KeyPath, located, split_key
from clacad.config.mistakes import Mistake, in_order
from clacad.config.toml_text import parse, read_text, too_deep
from clacad.config.value_kinds import Refusal, kind_of, not_this, shown
from clacad.design.cell_table import TableSpec, digest, table_path
from clacad.design.drawn_outline import with_points
from clacad.design.filled_outline import filling_count
from clacad.design.given_faces import faces_read
from clacad.design.keys import OPTIONAL, REQUIRED, ROOT, SCENE_SECTIONS, SECTIONS, Key, known_in, suggestion
from clacad.design.plate_keys import box_about_origin, corners_read, holes_read, pins_read
from clacad.design.rules import Asked, broken
from clacad.design.search_record import search_read
from clacad.design.sections import (
    AimedAt,
    Allowed,
    BodySpec,
    CheckSpec,
    FieldSpec,
    Frame,
    LatticeSpec,
    LawSpec,
    LightSpec,
    Outline,
    PairSpec,
    TolerancesSpec,
)
from clacad.design.varying import Conjugates, VaryingSpec, varying_read


def read_file(path: str | os.PathLike[str], overrides: Sequence[str]) -> dict[str, Any]:
    """Read a design file; return the fields of a `Design`, see `load`."""
    name = os.fspath(path)
    text = read_text(name)
    return _read(parse(text, name), tuple(overrides), text, name)


def read_dict(data: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Read nested dictionaries; return the fields of a `Design`, see `Design.from_dict`."""
    given = plain(data, float)
    if not isinstance(given, dict):
        raise DesignError([Mistake("CL104", f"a design is a table, not {kind_of(given)}")])
    if too_deep(given):
        raise DesignError([Mistake("CL100", f"nested more than {DEEPEST} deep")])
    return _read(given, tuple(overrides), None, "")


def values_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """Values by dotted key of a valid design, from its keys as written: the input of the rules."""
    return _checked(dict(given))[0]


def read_changed(given: Mapping[str, Any], path: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Read a design's keys as written, some of them changed;
    return the fields of a `Design`, see `Design.replace`.
    """
    data: Any = given
    mistakes = []
    for key, value in changes.items():
        try:
            data = override.put(data, split_key(key), plain(value, float))
        except LookupError as problem:
            mistakes.append(Mistake("CL118", str(problem.args[0]), key=key))
    if mistakes:
        raise DesignError(mistakes)
    return _read(data, (), None, path)


# --- checking ---------------------------------------------------------------------------------------------


def _read(data: dict[str, Any], texts: tuple[str, ...], source: str | None, path: str) -> dict[str, Any]:
    """Apply overrides to the data, check and convert everything; every mistake has its position."""
    changed, places, mistakes = override.apply(data, texts)
    resolved, unread = with_points(changed, path)
    values, found = _checked(resolved)
    mistakes += found + unread
    if mistakes:
        raise DesignError(in_order(located(mistakes, source, path, places)))
    return _built(values, resolved, None if texts or resolved is not changed else source, path)


def _checked(data: dict[str, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return converted values by dotted key, and every mistake."""
    word = data.get("unit")
    unit = units.design_unit(word) if isinstance(word, str) else None
    values, mistakes = _converted(data, unit or Unit("1", units.LENGTHS["m"]))
    written = {f"{section}.{name}": value for section in SECTIONS if isinstance(data.get(section), dict)
               for name, value in data[section].items()}  # fmt: skip
    whole = {section for section in SECTIONS if section in data and not isinstance(data[section], dict)}
    asked = Asked(values, written, unit)
    missing = {m.key for m in mistakes if m.code == "CL103"} | whole
    meant = {m.hint for m in mistakes if m.code == "CL102"}  # a misspelt key is not reported as missing too
    mistakes += [
        m
        for m in broken(asked)
        if m.key.split(".")[0] not in missing and (m.code != "CL103" or m.key not in meant)
    ]
    return values, mistakes


def _converted(data: dict[str, Any], unit: Unit) -> tuple[dict[str, Any], list[Mistake]]:
    """Values by dotted key, and mistakes in the shape of the data: unknown or missing keys, values of the
    wrong kind.

    For a faulty design, all convertible values of its sections are returned, so that the rules can check the
    rest. Values are read key by key, not by the models of `clacad.design.schema`: importing pydantic takes
    longer than the whole reading.
    """
    table = _Table(unit, {}, [], [])
    table.read((), ROOT, data)
    for section, keys in SECTIONS.items():
        given = data.get(section, {})
        if not isinstance(given, dict):
            table.mistakes.append(Mistake("CL104", f"{section} {not_this(given, 'a table')}", section, found=shown(given),
                                          allowed=f"a table [{section}] with the keys {known_in(section)}"))  # fmt: skip
        elif section not in data and section not in OPTIONAL:
            table.missing.append(_missing(section))
            table.values.update(
                {
                    f"{section}.{name}": key.default
                    for name, key in keys.items()
                    if key.default is not REQUIRED
                }
            )
        else:
            table.read((section,), keys, given)
    table.mistakes.extend(_unknown((name,)) for name in data if name not in ROOT and name not in SECTIONS)
    # a misspelt key is one mistake, not two: the key it was meant to be is not reported as missing too
    meant = {mistake.hint for mistake in table.mistakes if mistake.code == "CL102"}
    mistakes = table.mistakes + [mistake for mistake in table.missing if mistake.key not in meant]
    if mistakes:
        return {key: value for key, value in table.values.items() if key not in ROOT}, mistakes
    return table.values, []


@dataclass(frozen=True)
class _Table:
    """Result so far: values by dotted key, mistakes, and missing keys."""

    unit: Unit
    values: dict[str, Any]
    mistakes: list[Mistake]
    missing: list[Mistake]

    def read(self, where: KeyPath, known: Mapping[str, Key], given: Mapping[str, Any]) -> None:
        """Read the known keys of a table; for a section, report unknown keys too."""
        for name, key in known.items():
            dotted = ".".join((*map(str, where), name))
            if name not in given:
                if key.default is REQUIRED:
                    self.missing.append(_missing(dotted))
                else:
                    self.values[dotted] = key.default
                continue
            try:
                self.values[dotted] = key.kind.read(given[name], self.unit)
            except Refusal as refusal:
                self.mistakes.extend(_refused(dotted, one) for one in (refusal, *refusal.others))
        if where:
            self.mistakes.extend(_unknown((*where, name)) for name in given if name not in known)


def _unknown(where: KeyPath) -> Mistake:
    section = str(where[0]) if len(where) > 1 else ""
    name = str(where[-1])
    if not section and name in SCENE_SECTIONS:
        return Mistake("CL102", f"unknown key {name}: it belongs in a scene file", name, found=name,
                       allowed=f"here: {known_in('')}")  # fmt: skip
    near = suggestion(section, name)
    key = f"{section}.{name}" if section else name
    message = f"unknown key {key}" + did_you_mean([near] if near else [], before="; ")
    place = f"in [{section}]" if section else "here"
    return Mistake("CL102", message, key, found=name, allowed=f"{place}: {known_in(section)}", hint=near)


def _missing(key: str) -> Mistake:
    if key in SECTIONS:
        needed = [name for name, one in SECTIONS[key].items() if one.default is REQUIRED]
        return Mistake(
            "CL103", f"missing section [{key}]", key, allowed=f"a table with at least {', '.join(needed)}"
        )
    section, _, name = key.rpartition(".")
    kind = (SECTIONS[section] if section else ROOT)[name].kind
    return Mistake("CL103", f"missing key {key}", key, allowed=kind.allowed(Unit("unit", units.LENGTHS["m"])))


def _refused(key: str, refusal: Refusal) -> Mistake:
    is_key = refusal.code in ("CL102", "CL103")  # the message shows the table; the position is the key's
    steps = refusal.where[:-1] if refusal.code == "CL102" else refusal.where
    name = key + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    place = ".".join([key, *map(str, refusal.where)])
    value = kind_of(refusal.value) if is_key else shown(refusal.value)
    message = f"{name} {refusal.complaint}" if is_key else f"{name} = {value} {refusal.complaint}"
    return Mistake(refusal.code, message, place, found=shown(refusal.value), allowed=refusal.allowed,
                   hint=refusal.hint)  # fmt: skip


# --- building ---------------------------------------------------------------------------------------------


def _varying(read: Any, path: str, source: str | None) -> VaryingSpec | None:
    """Variation of the law; a table without a stated hash is hashed here."""
    if read is None:
        return None
    spec = varying_read(read)
    if spec.table is None or spec.table.sha256:
        return spec
    try:
        found = digest(table_path(path, spec.table.file))
    except DesignError as error:
        raise type(error)(located(error.mistakes, source, path, ())) from None
    return VaryingSpec(table=TableSpec(spec.table.file, found))


def _built(values: dict[str, Any], data: dict[str, Any], source: str | None, path: str) -> dict[str, Any]:
    """Fields of a `Design` from converted values by dotted key, with defaults that depend on other keys."""
    part = {
        section: {name: values[f"{section}.{name}"] for name in keys} for section, keys in SECTIONS.items()
    }
    law, pair, lattice, body, check, tolerances, light = (part[section] for section in SECTIONS)
    if isinstance(pair["thickness"], tuple) and not isinstance(data["pair"]["thickness"], list):
        pair["thickness"] = pair["thickness"][0]
    if pair["web"] is None and pair["form"] == "biconvex" and lattice["seam"] == 0.0:
        pair["web"] = 0.0
    pair["face"] = faces_read(pair["face"])
    pair["search"] = None if pair["search"] is None else search_read(pair["search"])
    pair["field"] = FieldSpec(**dict(pair["field"] or ()))
    pair["focus"] = None if pair["focus"] == "afocal" else Conjugates(**dict(pair["focus"]))
    law["euler_degrees"] = law.pop("euler")
    law["varying"] = _varying(law["varying"], path, source)
    for section in (lattice, body):
        section["outline"] = _outline(section["outline"])
    if lattice["outline"] is not None and lattice["count"] is None:
        lattice["count"] = filling_count(lattice["kind"], lattice["pitch"], lattice["outline"].size)
    if not isinstance(lattice["aperture"], str) and isinstance(lattice["aperture"][0], tuple):
        lattice["aperture"] = AimedAt(**dict(lattice["aperture"]))
    if body["frame"] is not None:
        frame = dict(body["frame"])
        body["frame"] = Frame(frame["width"], frame.get("height"))
    body |= {
        "corners": corners_read(body["corners"]),
        "holes": holes_read(body["holes"]),
        "pins": pins_read(body["pins"]),
    }
    if check["confocality"] is None:
        by_construction = pair["confocal"] == "exact" and pair["prescription"] == "derived"
        check["confocality"] = 0.002 if by_construction else 0.02
    check["allow"] = tuple(Allowed(**dict(item)) for item in check["allow"])
    unit = units.design_unit(values["unit"])
    assert unit is not None, values["unit"]  # UnitWord accepted it
    return {
        "name": values["name"], "unit": values["unit"], "unit_m": float(unit.metres), "law_spec": LawSpec(**law),
        "pair": PairSpec(**pair), "lattice": LatticeSpec(**lattice), "body": BodySpec(**body), "check": CheckSpec(**check),
        "tolerances": TolerancesSpec(**tolerances), "light": LightSpec(**light), "notes": values["notes"], "given": data,
        "source": source, "path": path,
    }  # fmt: skip


def _outline(read: Any) -> Outline | None:
    """Outline from a shape and size as read by the keys."""
    if read is None:
        return None
    ((shape, size),) = read
    if shape == "circle":
        return Outline("circle", (size, size))
    if shape == "rectangle":
        return Outline("rectangle", size)
    return Outline("polygon", box_about_origin(size), size)
