"""The scene, read and checked: what is viewed, from which position, in which light.

Lengths are multiples of `Scene.unit_m` metres; see `clacad.scene.sections`.

Read a file, a dictionary or changed keys into the checked sections of a scene.

Report every mistake at once.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from clacad.base import units
from clacad.base.text import plain, whole_number
from clacad.config import edit_text as override
from clacad.config.edit_text import changed_keys
from clacad.config.key_reader import NO_UNIT, KeyReader
from clacad.config.mistakes import DesignError, DesignTooLarge, Mistake, in_order, located, split_key
from clacad.config.toml_text import folder_of, given_table, outside, parse, read_text
from clacad.config.value_kinds import Refusal, not_this, shown
from clacad.scene import sections as keys
from clacad.scene.rules import SceneError, broken, in_scene, place_of
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

if TYPE_CHECKING:
    from clacad.design import Design


def read_file(path: str | os.PathLike[str], overrides: Sequence[str]) -> dict[str, Any]:
    """Read a scene file; the fields of a `Scene`, see `load_scene`."""
    name = os.fspath(path)
    with _as_scene_error():
        text = read_text(name, "scene")
        data = parse(text, name, "scene")
    return _read(data, tuple(overrides), text, name)


def read_dict(data: Mapping[str, Any], overrides: Sequence[str], folder: str) -> dict[str, Any]:
    """Read nested dictionaries; the fields of a `Scene`, see `Scene.from_dict`."""
    with _as_scene_error():
        given = given_table(data, "scene")
    return _read(given, tuple(overrides), None, os.path.join(folder, ""))


def read_changed(given: Mapping[str, Any], path: str, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Read a scene's keys as written, with some changed; the fields of a `Scene`, see `Scene.replace`."""
    with _as_scene_error():
        data = override.with_changes(given, changes, put, path)
    return _read(data, (), None, path)


@contextmanager
def _as_scene_error() -> Iterator[None]:
    """Turn a `DesignError` into a `SceneError`; a file beyond the size limit stays one."""
    try:
        yield
    except DesignTooLarge:
        raise
    except DesignError as error:
        raise SceneError(error.mistakes) from None


def put(data: Any, key: str, value: Any) -> Any:
    """Return the data with one key replaced; objects are found by id, design keys go into [sheet] set.

    Raises LookupError: If there is no such part; the message names it.
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
    """Number, as text, of an object or sheet that is named by its id."""
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
    data, _, mistakes = override.apply(data, texts, put)
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
    reader = KeyReader(keys.SCENE, units.design_unit(word) if isinstance(word, str) else None)
    root = reader.top(data)
    several = isinstance(data.get("sheet"), list)
    still = "animation" not in data
    parts = {
        name: reader.section(name, data)
        for name in keys.SECTIONS
        if not (several and name == "sheet") and not (still and name == "animation")
    }
    if several:
        sheets = _sheets(reader, data["sheet"])
    else:
        _refuse_set(reader, data.get("sheet"), "sheet")
        sheets = [parts["sheet"]]
    objects = _objects(reader, data.get("object", []), "object")
    moves = _moves(reader, parts.get("animation", {}).pop("move", None), data)
    if reader.mistakes:
        return None, reader.mistakes
    for sheet in sheets:
        sheet["set"] = _flat(sheet["set"])
    fields = {
        **{name: root[name] for name in ("name", "unit", "notes")},
        "unit_m": float(_metres(reader)),
        "sheets": tuple(sorted((keys.SheetSpec(**sheet) for sheet in sheets), key=lambda one: one.z)),
        "camera": keys.Camera(**parts["camera"]),
        "light": keys.Light(**parts["light"]),
        "background": keys.Background(**parts["background"]),
        "objects": objects,
        "effects": keys.EffectsSpec(**parts["effects"]),
        "animation": None if still else keys.Animation(**parts["animation"], moves=moves),
        "given": data,
        "source": source,
        "path": path,
    }
    return fields, broken(fields)


def _metres(reader: KeyReader) -> Fraction:
    """Metres in a unit of the scene."""
    assert reader.unit is not None  # its key was read without a mistake
    return reader.unit.metres


def _refuse_set(reader: KeyReader, table: object, where: str) -> None:
    """Refuse changes of a sheet's design that are not a table."""
    changes = table.get("set") if isinstance(table, dict) else None
    if not (changes is None or isinstance(changes, dict)):
        allowed = keys.SHEET["set"].kind.allowed(NO_UNIT)
        reader.refused(f"{where}.set", Refusal("CL104", not_this(changes, "a table"), changes, allowed))


def _sheets(reader: KeyReader, listed: list[Any]) -> list[dict[str, Any]]:
    """Values of every [[sheet]]; those that cannot be read are left out."""
    if not listed or not all(isinstance(one, dict) for one in listed) or len(listed) > keys.MOST_SHEETS:
        allowed = f"[[sheet]] for each, 1 to {keys.MOST_SHEETS}"
        reader.refuse("CL104", "sheet is not a list of tables", "sheet", allowed=allowed)
        return []
    found = []
    for k, table in enumerate(listed):
        before = len(reader.found)
        values = reader.table(f"sheet.{k}", table, keys.STACKED)
        _refuse_set(reader, table, f"sheet.{k}")
        if len(reader.found) == before:
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


def _objects(reader: KeyReader, listed: Any, where: str) -> tuple[keys.SceneObject, ...]:
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        complaint = (
            "is not a list of tables" if isinstance(listed, list) else not_this(listed, "a list of tables")
        )
        reader.refuse("CL104", f"{where} {complaint}", where, allowed=f"[[{where}]] for each")
        return ()
    if len(listed) > 1000:
        reader.refuse("CL108", f"{where} has {len(listed)} tables", where, allowed="at most 1000")
        return ()
    found = [_object(reader, one, f"{where}.{k}") for k, one in enumerate(listed)]
    return tuple(one for one in found if one is not None)


def _object(reader: KeyReader, table: dict[str, Any], where: str) -> keys.SceneObject | None:
    """One object with the keys of its kind, a group with its parts; None if it has a mistake."""
    kind = table.get("kind")
    before = len(reader.found)
    parts: tuple[keys.SceneObject, ...] = ()
    if kind == "group":
        parts = _objects(reader, table.get("parts", []), f"{where}.parts")
        for k, part in enumerate(parts):
            if part.kind in ("checker", "group"):
                what = "floor" if part.kind == "checker" else "group"
                message = f"{where}.parts.{k}: a group holds no {what}"
                reader.refuse("CL114", message, f"{where}.parts.{k}.kind")
        if not table.get("parts"):
            reader.refuse("CL103", f"{where} is a group without parts", where)
    own = {name: value for name, value in table.items() if kind != "group" or name != "parts"}
    values = reader.table(where, own, keys.keys_of_object(kind))
    _refuse_size(reader, values, where, kind)
    if len(reader.found) > before:
        return None
    every = {name: values.get(name, key.default) for name, key in keys.OBJECT.items() if name != "parts"}
    every["id"] = every["id"] or where.rsplit(".", 1)[-1]
    every["size"] = every["size"] or ()
    return keys.SceneObject(**every, parts=parts)


def _refuse_size(reader: KeyReader, values: dict[str, Any], where: str, kind: Any) -> None:
    """Refuse a size without the number of lengths of its kind; one length makes a box a cube."""
    if not isinstance(kind, str) or kind not in keys.SIZES:
        return
    count, words = keys.SIZES[kind]
    size = values.get("size")
    if size is None:
        if not any(m.key.startswith(f"{where}.size") for m in reader.found):
            reader.refuse("CL103", f"missing key {where}.size", where, allowed=f"a {kind}'s size: {words}")
        return
    if len(size) == 1 and kind == "box":
        values["size"] = size * 3
    elif len(size) != count:
        message = f"{where}.size has {len(size)} values"
        reader.refuse("CL108", message, f"{where}.size", allowed=f"a {kind}'s size: {words}")
    elif kind != "cone" and not all(size):
        message = f"{where}.size is out of range"
        reader.refuse("CL106", message, f"{where}.size", allowed=f"lengths > 0: {words}")


def _moves(reader: KeyReader, listed: Any, data: dict[str, Any]) -> tuple[keys.Move, ...]:
    if listed is None:
        return ()
    if not isinstance(listed, list) or not listed or not all(isinstance(one, dict) for one in listed):
        allowed = "[[animation.move]] for each moved key"
        reader.refuse("CL104", "animation.move is not a list of tables", "animation.move", allowed=allowed)
        return ()
    found = [_move(reader, one, f"animation.move.{k}", data) for k, one in enumerate(listed)]
    return tuple(one for one in found if one is not None)


def _move(reader: KeyReader, table: dict[str, Any], where: str, data: dict[str, Any]) -> keys.Move | None:
    """One animated key with its times and values; None if it has a mistake."""
    before = len(reader.found)
    values = reader.table(where, table, keys.MOVE)
    if len(reader.found) > before:
        return None

    def refuse(code: str, message: str, key: str = "") -> None:
        reader.refuse(code, f"{where}{message}", f"{where}.{key}" if key else where)

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
    return None if len(reader.found) > before else keys.Move(values["key"], times, steps, values["ease"])


@dataclass(frozen=True, slots=True)
class Scene:
    """One scene file, read and checked.

    Parameters
    ----------
    name, unit : str
        As written.
    unit_m : float, metres
        Length of one scene unit.
    sheets : tuple of SheetSpec
        In the order light passes them, the nearest to the camera first.
    camera, light, background, objects, effects, animation
        The sections of the file; `animation` is None for a still.
    notes : tuple of str
    given : mapping
        The keys as written.
    source : str or None
        The file's text; None where it no longer describes the whole scene.
    path : str
        The file's name as the user gave it, "" without a file.
    """

    name: str
    unit: str
    unit_m: float
    sheets: tuple[SheetSpec, ...]
    camera: Camera
    light: Light
    background: Background
    objects: tuple[SceneObject, ...]
    effects: EffectsSpec
    animation: Animation | None
    notes: tuple[str, ...] = ()
    given: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    source: str | None = field(default=None, repr=False, compare=False)
    path: str = field(default="", compare=False)

    @staticmethod
    def from_dict(data: Mapping[str, Any], overrides: Sequence[str] = (), folder: str = ".") -> Scene:
        """Read a scene from nested dictionaries with the keys of a scene file.

        Parameters
        ----------
        data : mapping
            As `tomllib` would return it.
        overrides : sequence of str
            "key.path=value" each, as with --set; an object may be named by its id.
        folder : str
            Folder that files are relative to.

        Raises
        ------
        SceneError
            With every mistake.
        """
        return Scene(**read_dict(data, overrides, folder))

    @property
    def sheet(self) -> SheetSpec:
        """The sheet; the first one if there are several."""
        return self.sheets[0]

    @property
    def folder(self) -> str:
        """Folder that the scene's files are relative to."""
        return folder_of(self.path)

    def design(self) -> Design:
        """Read the sheet's design with the scene's changes; the first sheet's if there are several.

        Raises
        ------
        SceneError
            With every mistake of the design file or of the changes.
        """
        return self._design_of(self.sheet)

    def designs(self) -> tuple[Design, ...]:
        """Read the designs of all sheets, in the order light passes them.

        Raises
        ------
        SceneError
            With every mistake of the first design that has any.
        """
        return tuple(self._design_of(sheet) for sheet in self.sheets)

    def _design_of(self, sheet: SheetSpec) -> Design:
        from clacad.design import load

        path = self.file(sheet.design)
        try:
            design = load(path)
        except DesignError as error:
            raise SceneError(error.mistakes) from None
        if not sheet.set:
            return design
        try:
            return design.replace(sheet.set)
        except DesignError as error:
            mistakes = [in_scene(mistake, place_of(self.given, sheet)) for mistake in error.mistakes]
            raise SceneError(located(mistakes, self.source, self.path, ())) from None

    def file(self, name: str) -> str:
        """Path of a file named in the scene.

        Raises
        ------
        SceneError
            It lies outside the scene's folder and its parent, or does not exist.
        """
        levels = 2 if name in [sheet.mesh for sheet in self.sheets] else 1
        why = outside(self.folder, name, levels, "scene")
        path = os.path.join(self.folder, name)
        if not why and not os.path.isfile(path):
            why = "does not exist"
        if why:
            raise SceneError([Mistake("CL100", f"the file {name} {why}", path=self.path)])
        return path

    def replace(self, changes: Mapping[str, Any] | str, value: Any = None) -> Scene:
        """Return the scene with some keys changed, checked as a file would be.

        Parameters
        ----------
        changes : mapping, or str
            Dotted key to value, as in animations: {"object.knight.at.2": 5.0, "sheet.set.law.euler.0": 45};
            or one such
            key.
        value : any
            New value, if `changes` is one key.

        Raises
        ------
        SceneError
            The result is no valid scene.
        TypeError
            A value in addition to a mapping, or neither a mapping nor a key.
        """
        return Scene(**read_changed(self.given, self.path, changed_keys(changes, value)))

    def at(self, frame: int) -> Scene:
        """Return the still of one frame of the animation, 0 ≤ frame < frames.

        Raises
        ------
        SceneError
            The frame's scene is not valid.
        ValueError
            There is no such frame.
        """
        if self.animation is None:
            raise ValueError(f"the scene {self.name} has no animation")
        moved = self.replace(values_at(self.animation, frame))
        given = {key: value for key, value in moved.given.items() if key != "animation"}
        return replace(moved, animation=None, given=given)


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        TOML, or JSON if the name ends in .json; at most 1 MB, nested at most 64 deep.
    overrides : sequence of str
        "key.path=value" each, as with --set; an object is named by its id ("object.knight.size=0.3").

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        With every mistake, each with path, line and column.
    """
    return Scene(**read_file(path, overrides))


def value_at(move: Move, time: float) -> Any:
    """Value of an animated key at a time 0 … 1, interpolated linearly between the given values."""
    if move.ease == "smooth":
        time = time * time * (3.0 - 2.0 * time)
    times, values = move.times, move.values
    last = len(times) - 1
    k = next((k for k in range(last) if time <= times[k + 1]), last - 1)
    span = times[k + 1] - times[k]
    share = min(1.0, max(0.0, (time - times[k]) / span))
    here, there = values[k], values[k + 1]
    if share in (0.0, 1.0):  # the written value itself, without rounding
        return plain(there if share == 1.0 else here, float)
    if isinstance(here, tuple):
        return [a + (b - a) * share for a, b in zip(here, there, strict=True)]
    return here + (there - here) * share


def time_of(animation: Animation, frame: int) -> float:
    """Time 0 … 1 of a frame; the first frame is at 0, the last at 1."""
    if not 0 <= frame < animation.frames:
        raise ValueError(f"frame {frame} of {animation.frames}: frames are numbered from 0")
    return frame / (animation.frames - 1)


def values_at(animation: Animation, frame: int) -> dict[str, Any]:
    """Animated key → value in a frame."""
    time = time_of(animation, frame)
    return {move.key: value_at(move, time) for move in animation.moves}
