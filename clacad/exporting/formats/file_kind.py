"""Kinds of files: how each is recognised, and how its numbers are compared with the design."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal

from clacad.base.units import millimetres

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.base.types import Floats
    from clacad.formats.maps.sag import HeightMap
    from clacad.sheet.window import Body, Face, Window

Misfit = tuple[float, float, str]
"""Greatest deviation in millimetres (or relative, for tables), its allowance for writing, and the compared
quantity."""


@dataclass(frozen=True, eq=False)
class FaceFile:
    """A file of one face: the face, its body, its name in files ("array1.front"), and the path."""

    window: Window
    body: Body
    face: Face
    label: str
    path: Path

    @property
    def scale(self) -> float:
        """Millimetres per design unit."""
        return millimetres(self.window.unit)

    def map(self) -> HeightMap:
        """Map of the face as an export writes it."""
        from clacad.formats.maps.sag import height_map, samples_per_cell

        per_cell = samples_per_cell(self.window, None)
        return height_map(self.window, self.body, self.face, self.label, per_cell)


@dataclass(frozen=True, eq=False)
class Samples:
    """Heights of one cell.

    points : (m, 3) lengths
        x and y in the cell frame, z in the sheet frame.
    step : (2,) lengths
    """

    points: Floats
    step: Floats


@dataclass(frozen=True, eq=False)
class Reading:
    """Comparison of a file of heights, points, places or numbers with the design; see `map_reading`.

    Attributes
    ----------
    face : callable or None
        `face(file)` → misfit of a file of one face.
    sheet : callable or None
        `sheet(window, path)` → misfit of a file of the whole window.
    samples : callable or None
        `samples(file, cell)` → heights of one cell of a face, through which light is traced.
    unit : str
        Unit of the misfit; "": relative.
    """

    face: Callable[[FaceFile], Misfit] | None = None
    sheet: Callable[[Window, Path], Misfit] | None = None
    samples: Callable[[FaceFile, tuple[int, int]], Samples] | None = None
    unit: str = "mm"


@dataclass(frozen=True, eq=False)
class FileKind:
    """Files under one word of the manifest; a format writes one kind of file, or several.

    Attributes
    ----------
    word : str
        Format in manifests and reports.
    family : "mesh", "solid", "map" or "other"
        Triangles; exact solids; a file that is compared by `readings`; everything else is judged by its
        bytes.
    ends : tuple of str
        Endings by which a file without a manifest is recognised.
    bytes_a_facet : float
        Approximate size of a mesh.
    states_unit : bool
        Whether every reader interprets its unit alike.
    native : bool
        Whether a native library reads it, in a process of its own.
    like : str
        Format that stores a mesh alike; "": its own word.
    text_budget : str
        Reader (`clacad.base.untrusted_files`) of the text of a file that is too large for OCC; "": no text
        is read.
    older : bool
        Whether words that begin with this one are older words of the same kind.
    readings : str
        Module with a mapping `READINGS` from words to `Reading`; imported on first use.
    """

    word: str
    family: Literal["mesh", "solid", "map", "other"]
    ends: tuple[str, ...] = ()
    bytes_a_facet: float = 50.0
    states_unit: bool = False
    native: bool = False
    like: str = ""
    text_budget: str = ""
    older: bool = False
    readings: str = ""

    @property
    def reading(self) -> Reading:
        """Comparison with the design; none of its parts for files that are not compared by numbers."""
        if not self.readings:
            return Reading()
        found: Reading = import_module(self.readings).READINGS[self.word]
        return found
