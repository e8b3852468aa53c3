"""Reading of designs from a file, a dictionary or changed keys into checked sections;
all mistakes are reported at once.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from clacad.base import units
from clacad.config import edit_text as override
from clacad.config.compound_kinds import attributes_of
from clacad.config.key_reader import KeyReader
from clacad.config.mistakes import DesignError, Mistake, in_order, located
from clacad.config.toml_text import given_table, parse, read_text
from clacad.design.body import filling_count
from clacad.design.cell_table import digest, table_path
from clacad.design.drawn_outline import with_points
from clacad.design.process_profiles import TOLERANCE_CLASSES
from clacad.design.rules import Asked
from clacad.design.sections import DESIGN, SECTIONS, SPECS
from clacad.design.sheet_rules import broken
from clacad.design.varying import VaryingSpec


def read_file(path: str | os.PathLike[str], overrides: Sequence[str]) -> dict[str, Any]:
    """Read a design file; return the fields of a `Design`, see `load`."""
    name = os.fspath(path)
    text = read_text(name)
    return _read(parse(text, name), tuple(overrides), text, name)


def read_shipped(name: str, overrides: Sequence[str]) -> dict[str, Any] | None:
    """Read a template or shipped design by its name, as `read_file`; None where none has the name."""
    from clacad.design.starter_designs import file_of, template

    file = file_of(name)
    if file is None:
        return None
    text = template(name, name)
    return _read(parse(text, str(file)), tuple(overrides), text, str(file))


def read_dict(data: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Read nested dictionaries; return the fields of a `Design`, see `Design.from_dict`."""
    return _read(given_table(data), tuple(overrides), None, "")


def read_changed(given: Mapping[str, Any], path: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Read a design's keys as written, some changed; return fields of a `Design`, see `Design.replace`."""
    return _read(override.with_changes(given, changes, override.put_dotted, ""), (), None, path)


# --- checking ---------------------------------------------------------------------------------------------


def _read(data: dict[str, Any], texts: tuple[str, ...], source: str | None, path: str) -> dict[str, Any]:
    """Apply overrides to the data, check and convert everything; every mistake has its position."""
    changed, places, mistakes = override.apply(data, texts, override.put_dotted)
    resolved, unread = with_points(changed, path)
    values, found = _checked(resolved)
    mistakes += found + unread
    if mistakes:
        raise DesignError(in_order(located(mistakes, source, path, places)))
    return _built(values, resolved, None if texts or resolved is not changed else source, path)


def _checked(data: dict[str, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Return converted values by dotted key, and every mistake.

    For a faulty design, all convertible values of its sections are returned, so that the rules check the
    rest.
    """
    word = data.get("unit")
    reader = KeyReader(DESIGN, units.design_unit(word) if isinstance(word, str) else None)
    values = reader.top(data)
    for section in SECTIONS:
        values |= {f"{section}.{name}": value for name, value in reader.section(section, data).items()}
    written = {
        f"{section}.{name}": value
        for section in SECTIONS
        if isinstance(data.get(section), dict)
        for name, value in data[section].items()
    }
    mistakes = reader.mistakes
    whole = {section for section in SECTIONS if section in data and not isinstance(data[section], dict)}
    missing = {m.key for m in mistakes if m.code == "CL103"} | whole
    meant = {m.hint for m in mistakes if m.code == "CL102"}  # a misspelt key is not reported as missing too
    mistakes += [
        m
        for m in broken(Asked(values, written, reader.unit))
        if m.key.split(".")[0] not in missing and (m.code != "CL103" or m.key not in meant)
    ]
    return values, mistakes


# --- building ---------------------------------------------------------------------------------------------


def _built(values: dict[str, Any], data: dict[str, Any], source: str | None, path: str) -> dict[str, Any]:
    """Fields of a `Design` from converted values by dotted key, with defaults that depend on other keys."""
    part = {
        section: {name: values[f"{section}.{name}"] for name in keys} for section, keys in SECTIONS.items()
    }
    law, pair, lattice, body, check, *_ = part.values()
    if pair["web"] is None and pair["form"] == "biconvex" and lattice["seam"] == 0.0:
        pair["web"] = 0.0
    law["varying"] = _hashed(law["varying"], path, source)
    for section in (lattice, body):
        if section["outline"] is not None:
            section["outline"] = replace(section["outline"], size=section["outline"].box)
    if lattice["outline"] is not None and lattice["count"] is None:
        lattice["count"] = filling_count(lattice["kind"], lattice["pitch"], lattice["outline"].size)
    if check["confocality"] is None:
        by_construction = pair["confocal"] == "exact" and pair["prescription"] == "derived"
        check["confocality"] = 0.002 if by_construction else 0.02
    unit = units.design_unit(values["unit"])
    assert unit is not None, values["unit"]  # UnitWord accepted it
    tolerances = part["tolerances"]
    if tolerances["class"] is not None:
        for name, value in TOLERANCE_CLASSES[tolerances["class"]].values.items():
            if name not in data["tolerances"]:
                tolerances[name] = SECTIONS["tolerances"][name].kind.read(value, unit)
    specs = {name: spec(**attributes_of(spec, part[name])) for name, spec in SPECS.items()}
    specs["law_spec"] = specs.pop("law")
    head = {
        "name": values["name"],
        "unit": values["unit"],
        "unit_m": float(unit.metres),
        "notes": values["notes"],
    }
    return {**head, **specs, "given": data, "source": source, "path": path}


def _hashed(spec: VaryingSpec | None, path: str, source: str | None) -> VaryingSpec | None:
    """Variation of the law; a table without a stated hash is hashed here."""
    if spec is None or spec.table is None or spec.table.sha256:
        return spec
    try:
        found = digest(table_path(path, spec.table.file))
    except DesignError as error:
        raise type(error)(located(error.mistakes, source, path, ())) from None
    return VaryingSpec(table=replace(spec.table, sha256=found))
