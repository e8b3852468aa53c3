"""The scene, read and checked: what is viewed, from which position, in which light.

Lengths are multiples of `Scene.unit_m` metres; see `clacad.scene.sections`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.config.edit_text import changed_keys
from clacad.config.mistakes import DesignError, Mistake, located
from clacad.config.toml_text import folder_of, outside
from clacad.scene.read import read_changed, read_dict, read_file
from clacad.scene.rules import SceneError, in_scene, place_of
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
