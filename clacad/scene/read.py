"""Read a file, a dictionary or changed keys into the checked sections of a scene.

Report every mistake at once.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from clacad.base import units
from clacad.base.text import DEEPEST, plain
from clacad.base.units import Unit
from clacad.base.whole_numbers import whole_number
from clacad.config import overrides as override
from clacad.config.design_error import DesignError, DesignTooLarge
from clacad.config.key_positions import located, split_key
from clacad.config.mistakes import Mistake, in_order
from clacad.config.toml_text import parse, read_text, too_deep
from clacad.config.value_kinds import Refusal, kind_of, not_this, shown
from clacad.design.keys import REQUIRED, Key
from clacad.scene import keys
from clacad.scene.key_table import Reader
from clacad.scene.rules import broken
from clacad.scene.scene_error import SceneError
from clacad.scene.sections import (
    Animation,
    Background,
    Camera,
    EffectsSpec,
    Light,
    Move,
    SceneObject,
    SheetSpec,
)

MOST_SHEETS = 26
"""Largest number of sheets in a scene, as in a stack."""


def read_file(path: str | os.PathLike[str], overrides: Sequence[str]) -> dict[str, Any]:
    """Read a scene file; the fields of a `Scene`, see `load_scene`."""
    name = os.fspath(path)
    try:
        text = read_text(name, "scene")
        data = parse(text, name, "scene")
    except DesignTooLarge:
        raise
    except DesignError as error:
        raise SceneError(error.mistakes) from None
    return _read(data, tuple(overrides), text, name)


def read_dict(data: Mapping[str, Any], overrides: Sequence[str], folder: str) -> dict[str, Any]:
    """Read nested dictionaries; the fields of a `Scene`, see `Scene.from_dict`."""
    given = plain(data, float)
    if not isinstance(given, dict):
        raise SceneError([Mistake("CL104", f"a scene is a table, not {kind_of(given)}")])
    if too_deep(given):
        raise SceneError([Mistake("CL100", f"nested more than {DEEPEST} deep")])
    return _read(given, tuple(overrides), None, os.path.join(folder, ""))


def read_changed(given: Mapping[str, Any], path: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Read a scene's keys as written, with some changed; the fields of a `Scene`, see `Scene.replace`."""
    data: Any = given
    mistakes = []
    for key, value in changes.items():
        try:
            data = put(data, key, plain(value, float))
        except LookupError as problem:
            mistakes.append(Mistake("CL118", str(problem.args[0]), key=key, path=path))
    if mistakes:
        raise SceneError(mistakes)
    return _read(data, (), None, path)


def put(data: Any, key: str, value: Any) -> Any:
    """Return the data with one key replaced; objects are found by id, design keys go into [sheet] set.

    Raises
    ------
    LookupError
        If there is no such part; the message names it.
    """
    steps = key.split(".")
    several = isinstance(data, Mapping) and isinstance(data.get("sheet"), list)
    if steps[0] == "sheet" and several and len(steps) > 1:
        if len(steps) == 2 or steps[1] in keys.SHEET:
            raise LookupError(f"the scene has several sheets: say whose, sheet.<id>.{'.'.join(steps[1:])}")
        steps[1] = _numbered(data, "sheet", steps[1])
        if steps[2] == "set" and len(steps) > 3:
            return override.put(data, ("sheet", int(steps[1]), "set", ".".join(steps[3:])), value)
    if steps[:2] == ["sheet", "set"] and len(steps) > 2:
        return override.put(data, ("sheet", "set", ".".join(steps[2:])), value)
    if steps[0] == "object" and len(steps) > 2:
        steps[1] = _numbered(data, "object", steps[1])
    return override.put(data, split_key(".".join(steps)), value)


def _numbered(data: Any, kind: str, name: str) -> str:
    """Number, as text, of an object or sheet that is named by its id.

    Raises
    ------
    LookupError
    """
    found = data.get(kind) if isinstance(data, Mapping) else None
    listed = found if isinstance(found, list) else []
    names = [o.get("id") if isinstance(o, dict) else None for o in listed]
    if name in names:
        return str(names.index(name))
    if whole_number(name) is None:
        known = ", ".join(str(name) for name in names if name) or "none has an id"
        raise LookupError(f"there is no {kind} {name}; {kind}s: {known}")
    return name


def _read(data: dict[str, Any], texts: tuple[str, ...], source: str | None, path: str) -> dict[str, Any]:
    """Lay overrides over the data, check and convert everything; every mistake with its place."""
    mistakes: list[Mistake] = []
    for text in texts:
        parsed = override.parse(text)
        if isinstance(parsed, Mistake):
            mistakes.append(parsed)
            continue
        try:
            data = put(data, *parsed)
        except LookupError as problem:
            mistakes.append(Mistake("CL118", str(problem.args[0]), key=parsed[0], path="--set", source_line=text,
                                    column=1, width=len(parsed[0])))  # fmt: skip
    fields, found = _checked(data, None if texts else source, path)
    mistakes += found
    if mistakes or fields is None:
        raise SceneError(in_order(located(mistakes, None if texts else source, path, ())))
    return fields


def _checked(
    data: dict[str, Any], source: str | None, path: str
) -> tuple[dict[str, Any] | None, list[Mistake]]:
    """Fields of a `Scene`, None if some cannot be read, and every mistake."""
    word = data.get("unit")
    unit = (units.design_unit(word) if isinstance(word, str) else None) or Unit("1", units.LENGTHS["m"])
    reader = Reader(unit)
    top = {name: value for name, value in data.items() if name not in keys.SECTIONS and name != "object"}
    root = reader.table("", top, keys.ROOT)
    several = isinstance(data.get("sheet"), list)
    parts = {
        name: _section(reader, data, name) for name in keys.SECTIONS if not (several and name == "sheet")
    }
    sheets = _sheets(reader, data["sheet"]) if several else [parts["sheet"]]
    objects = _objects(reader, data.get("object", []), "object")
    moves = _moves(reader, parts.get("animation", {}).pop("move", None), data)
    if reader.mistakes:
        return None, reader.mistakes
    for sheet in sheets:
        sheet["set"] = _flat(sheet["set"])
    in_line = sorted((SheetSpec(**sheet) for sheet in sheets), key=lambda one: one.z)
    effects = parts["effects"]
    effects["angle"] = None if effects["angle"] == "auto" else effects["angle"]
    animation = Animation(**parts["animation"], moves=moves) if "animation" in data else None
    fields = {
        "name": root["name"], "unit": root["unit"], "unit_m": float(unit.metres), "sheets": tuple(in_line),
        "camera": Camera(**parts["camera"]), "light": Light(**parts["light"]),
        "background": Background(**parts["background"]), "objects": objects, "effects": EffectsSpec(**effects),
        "animation": animation, "notes": root["notes"], "given": data, "source": source, "path": path,
    }  # fmt: skip
    return fields, broken(fields)


def _section(reader: Reader, data: dict[str, Any], name: str) -> dict[str, Any]:
    """One section's values; {} where it is missing or no table."""
    table = data.get(name)
    if table is None and name in keys.OPTIONAL:
        return reader.table(name, {}, keys.SECTIONS[name]) if name != "animation" else {}
    if table is None:
        needed = [key for key, one in keys.SECTIONS[name].items() if one.default is REQUIRED]
        text = f"a table with at least {', '.join(needed)}"
        reader.mistakes.append(Mistake("CL103", f"missing section [{name}]", name, allowed=text))
        return {}
    if not isinstance(table, dict):
        reader.mistakes.append(
            Mistake("CL104", f"{name} {not_this(table, 'a table')}", name, found=shown(table))
        )
        return {}
    values = reader.table(name, table, keys.SECTIONS[name])
    if name == "sheet":
        _refuse_set(reader, table, name)
    return values


def _refuse_set(reader: Reader, table: dict[str, Any], where: str) -> None:
    """Refuse changes of a sheet's design that are not a table."""
    if not (table.get("set") is None or isinstance(table["set"], dict)):
        reader.refused(f"{where}.set", Refusal("CL104", not_this(table["set"], "a table"), table["set"],
                                               keys.SHEET["set"].kind.allowed(reader.unit)))  # fmt: skip


def _sheets(reader: Reader, listed: list[Any]) -> list[dict[str, Any]]:
    """Values of every [[sheet]]; those that cannot be read are left out."""
    if not listed or not all(isinstance(one, dict) for one in listed) or len(listed) > MOST_SHEETS:
        allowed = f"[[sheet]] for each, 1 to {MOST_SHEETS}"
        reader.mistakes.append(Mistake("CL104", "sheet is not a list of tables", "sheet", allowed=allowed))
        return []
    found = []
    for k, table in enumerate(listed):
        before = len(reader.mistakes)
        values = reader.table(f"sheet.{k}", table, keys.STACKED)
        _refuse_set(reader, table, f"sheet.{k}")
        if len(reader.mistakes) == before:
            found.append(values)
    return found


def _flat(table: Mapping[str, Any] | None, prefix: str = "") -> dict[str, Any]:
    """Dotted keys of nested tables: {law: {eta: …}} and {"law.eta": …} are equivalent."""
    found: dict[str, Any] = {}
    for key, value in (table or {}).items():
        if isinstance(value, dict) and prefix + key in ("law", "pair", "lattice", "body", "check"):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found


def _objects(reader: Reader, listed: Any, where: str) -> tuple[SceneObject, ...]:
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        complaint = (
            "is not a list of tables" if isinstance(listed, list) else not_this(listed, "a list of tables")
        )
        mistake = Mistake("CL104", f"{where} {complaint}", where, allowed=f"[[{where}]] for each")
        reader.mistakes.append(mistake)
        return ()
    if len(listed) > 1000:
        reader.mistakes.append(
            Mistake("CL108", f"{where} has {len(listed)} tables", where, allowed="at most 1000")
        )
        return ()
    found = [_object(reader, one, f"{where}.{k}") for k, one in enumerate(listed)]
    return tuple(one for one in found if one is not None)


def _object(reader: Reader, table: dict[str, Any], where: str) -> SceneObject | None:
    """One object with the keys of its kind, a group with its parts; None if it has a mistake."""
    kind = table.get("kind")
    taken = keys.KEYS_OF.get(kind) if isinstance(kind, str) else None
    known: dict[str, Key] = keys.OBJECT
    if taken is not None:
        known = {name: keys.OBJECT[name] for name in ("id", "kind", *taken)}
    before = len(reader.mistakes)
    parts: tuple[SceneObject, ...] = ()
    if kind == "group":
        parts = _objects(reader, table.get("parts", []), f"{where}.parts")
        for k, part in enumerate(parts):
            if part.kind in ("checker", "group"):
                what = "floor" if part.kind == "checker" else "group"
                reader.mistakes.append(
                    Mistake("CL114", f"{where}.parts.{k}: a group holds no {what}", f"{where}.parts.{k}.kind")
                )
        if not table.get("parts"):
            reader.mistakes.append(Mistake("CL103", f"{where} is a group without parts", where))
    values = reader.table(where, {k: v for k, v in table.items() if kind != "group" or k != "parts"}, known)
    if taken is not None:
        _refuse_size(reader, values, where, kind)
    if len(reader.mistakes) > before:
        return None
    every = {name: values.get(name, key.default) for name, key in keys.OBJECT.items() if name != "parts"}
    every["id"] = every["id"] or where.rsplit(".", 1)[-1]
    every["size"] = every["size"] or ()
    return SceneObject(**every, parts=parts)


def _refuse_size(reader: Reader, values: dict[str, Any], where: str, kind: Any) -> None:
    """Refuse a size without the number of lengths of its kind; one length makes a box a cube."""
    if kind not in keys.SIZES:
        return
    count, words = keys.SIZES[kind]
    size = values.get("size")
    if size is None:
        if not any(m.key.startswith(f"{where}.size") for m in reader.mistakes):
            reader.mistakes.append(
                Mistake("CL103", f"missing key {where}.size", where, allowed=f"a {kind}'s size: {words}")
            )
        return
    if len(size) == 1 and kind == "box":
        values["size"] = size * 3
    elif len(size) != count:
        reader.mistakes.append(Mistake("CL108", f"{where}.size has {len(size)} values", f"{where}.size",
                                       allowed=f"a {kind}'s size: {words}"))  # fmt: skip
    elif kind != "cone" and not all(size):
        reader.mistakes.append(
            Mistake(
                "CL106", f"{where}.size is out of range", f"{where}.size", allowed=f"lengths > 0: {words}"
            )
        )


def _moves(reader: Reader, listed: Any, data: dict[str, Any]) -> tuple[Move, ...]:
    if listed is None:
        return ()
    if not isinstance(listed, list) or not listed or not all(isinstance(one, dict) for one in listed):
        reader.mistakes.append(Mistake("CL104", "animation.move is not a list of tables", "animation.move",
                                       allowed="[[animation.move]] for each moved key"))  # fmt: skip
        return ()
    found = [_move(reader, one, f"animation.move.{k}", data) for k, one in enumerate(listed)]
    return tuple(one for one in found if one is not None)


def _move(reader: Reader, table: dict[str, Any], where: str, data: dict[str, Any]) -> Move | None:
    """One animated key with its times and values; None if it has a mistake."""
    before = len(reader.mistakes)
    values = reader.table(where, table, keys.MOVE)
    if len(reader.mistakes) > before:
        return None

    def refuse(code: str, message: str, key: str = "") -> None:
        reader.mistakes.append(Mistake(code, f"{where}{message}", f"{where}.{key}" if key else where))

    ends = values["from"] is not None, values["to"] is not None
    if values["values"] is not None and any(ends):
        refuse("CL112", " has values as well as from and to", "values")
    elif values["values"] is None and not all(ends):
        refuse("CL103", " needs from and to, or values and times")
    elif values["times"] is not None and values["values"] is None:
        refuse("CL113", ".times needs values", "times")
    steps = values["values"] or (values["from"], values["to"])
    times = values["times"] or tuple(k / (len(steps) - 1) for k in range(len(steps)))
    if len(times) != len(steps):
        refuse("CL108", f".times has {len(times)} values, .values has {len(steps)}", "times")
    elif any(b <= a for a, b in zip(times, times[1:])) or not (times[0] >= 0.0 and times[-1] <= 1.0):
        refuse("CL106", ".times does not rise from 0 to 1", "times")
    if len({len(step) if isinstance(step, tuple) else 0 for step in steps}) > 1:
        refuse("CL108", " mixes numbers and lists, or lists of different lengths")
    root = values["key"].split(".")[0]
    if root not in ("object", "sheet", "camera", "light", "background"):
        refuse(
            "CL118",
            f".key = {shown(values['key'])} does not name an object, sheet, camera, light or background",
            "key",
        )
    else:
        try:
            put(data, values["key"], 0.0)
        except LookupError as problem:
            refuse("CL118", f".key = {shown(values['key'])}: {problem.args[0]}", "key")
    return None if len(reader.mistakes) > before else Move(values["key"], times, steps, values["ease"])
