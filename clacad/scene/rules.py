"""Rules between the keys of a scene, and the error of a scene that is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clacad.config.mistakes import DesignError, Mistake
from clacad.config.toml_text import folder_of, outside

if TYPE_CHECKING:
    from clacad.scene.sections import Camera, EffectsSpec, Light, SceneObject, SheetSpec


class SceneError(DesignError):
    """A scene that cannot be accepted; holds every mistake found, including those of its design."""

    exit_status = 2


def place_of(given: Mapping[str, Any], sheet: SheetSpec) -> str:
    """Dotted key of a sheet in a scene's file; `given`: the keys as written."""
    listed = given["sheet"]
    if not isinstance(listed, list):
        return "sheet"
    return f"sheet.{next(k for k, one in enumerate(listed) if one.get('id') == sheet.id)}"


def in_scene(mistake: Mistake, place: str) -> Mistake:
    """Return a mistake of the changed design with its place in the `set` of a scene's sheet."""
    return replace(mistake, key=f"{place}.set.{mistake.key}", path="", line=None, column=None, source_line="")


def broken(fields: Mapping[str, Any]) -> list[Mistake]:
    """Return the rules that the fields of a `Scene` break."""
    objects, folder = fields["objects"], folder_of(fields["path"])
    return [
        *_camera(fields["camera"]),
        *_light(fields["light"]),
        *_ids(objects),
        *_files(fields, folder),
        *_effects(fields["effects"]),
        *_stacked(fields["sheets"], fields["light"]),
    ]


def _camera(camera: Camera) -> Iterator[Mistake]:
    if (camera.frame is None) == (camera.fov is None):
        found = "neither" if camera.frame is None else "both"
        yield Mistake(
            "CL112",
            f"camera needs exactly one of frame and fov, has {found}",
            "camera" if camera.frame is None else "camera.fov",
            allowed="frame, the width at the target, or fov, the full angle",
        )
    if not camera.position[2] < 0.0:
        yield Mistake(
            "CL106",
            f"camera.position[2] = {camera.position[2]:g} is not before the sheet",
            "camera.position.2",
            allowed="z < 0: rays run towards +z",
        )
    look = [b - a for a, b in zip(camera.position, camera.target)]
    if not any(look):
        yield Mistake("CL106", "camera.target is the camera's own position", "camera.target")
    elif _length(_cross(look, camera.up)) <= 1e-9 * _length(look) * _length(camera.up):
        yield Mistake("CL106", "camera.up points along the line of sight", "camera.up")


def _light(light: Light) -> Iterator[Mistake]:
    if not any(light.direction):
        yield Mistake("CL106", "light.direction is zero", "light.direction")


def _ids(objects: tuple[SceneObject, ...]) -> Iterator[Mistake]:
    seen: dict[str, int] = {}
    for k, thing in enumerate(objects):
        if thing.id in seen:
            yield Mistake(
                "CL112",
                f"object.{k}.id = {thing.id} is also the id of object {seen[thing.id]}",
                f"object.{k}.id",
            )
        seen[thing.id] = k


def _effects(effects: EffectsSpec) -> Iterator[Mistake]:
    if effects.list and effects.mode != "list":
        yield Mistake("CL113", 'effects.list needs mode = "list"', "effects.list")
    for name in ("force", "without"):
        if getattr(effects, name) and effects.mode != "auto":
            yield Mistake("CL113", f'effects.{name} needs mode = "auto"', f"effects.{name}")


def _stacked(sheets: tuple[SheetSpec, ...], light: Light) -> Iterator[Mistake]:
    """Rules for several sheets: distinct names, the first at z = 0, and light without polarisation."""
    if len(sheets) == 1 and not sheets[0].id:
        return
    names = [one.id for one in sheets]
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            yield Mistake("CL112", f"{names.count(name)} sheets have the id {name}", "sheet")
    if sheets[0].z != 0.0:
        yield Mistake(
            "CL106",
            f"no sheet lies at z = 0: the first, {sheets[0].id}, is at {sheets[0].z:g}",
            "sheet",
            allowed="z = 0 for the sheet nearest to the camera",
        )
    if len(sheets) > 1 and (light.polariser is not None or light.analyser is not None):
        yield Mistake(
            "CL112",
            "a polariser or analyser is given, and several sheets: polarisation is not followed from one "
            "to the next",
            "light",
            allowed="one sheet, or neither polariser nor analyser",
        )


def _files(fields: Mapping[str, Any], folder: str) -> Iterator[Mistake]:
    """Files that an object lacks, that have no use, or that lie outside the scene's folder."""
    named: list[tuple[str, str | None, int]] = []
    for sheet in fields["sheets"]:
        home = place_of(fields["given"], sheet)
        named += [(f"{home}.design", sheet.design, 1), (f"{home}.mesh", sheet.mesh, 2)]
        if sheet.mesh is not None and sheet.rung != "mesh":
            yield Mistake("CL113", f'{home}.mesh needs rung = "mesh"', f"{home}.mesh")
        if sheet.continuous and sheet.rung != "law":
            yield Mistake("CL113", f'{home}.continuous needs rung = "law"', f"{home}.continuous")
    for key, thing in _walk(fields["objects"], "object"):
        named.append((f"{key}.file", thing.file, 1))
        needs = thing.kind == "mesh" or (thing.kind == "screen" and thing.pattern == "image")
        if needs and thing.file is None:
            yield Mistake("CL113", f"{key} needs a file", key, allowed="file = a relative path")
        if thing.kind == "screen" and thing.pattern != "image" and thing.file is not None:
            yield Mistake("CL113", f'{key}.file needs pattern = "image"', f"{key}.file")
        if thing.kind == "screen" and thing.pattern == "stripes" and thing.period is None:
            yield Mistake("CL113", f"{key} shows stripes and needs a period", key)
        if thing.kind == "cone" and not (thing.size[2] > 0.0 and max(thing.size[:2]) > 0.0):
            yield Mistake(
                "CL106", f"{key}.size is out of range", f"{key}.size", allowed="height > 0, one diameter > 0"
            )
    for key, name, levels in named:
        why = outside(folder, name, levels, "scene") if name else ""
        if why:
            yield Mistake("CL106", f'{key} = "{name}" {why}', key, allowed="a path relative to the scene")


def _walk(objects: tuple[SceneObject, ...], where: str) -> Iterator[tuple[str, SceneObject]]:
    for k, thing in enumerate(objects):
        yield f"{where}.{k}", thing
        yield from _walk(thing.parts, f"{where}.{k}.parts")


def _cross(a: list[float], b: tuple[float, ...]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _length(v: list[float] | tuple[float, ...]) -> float:
    return math.hypot(*v)
