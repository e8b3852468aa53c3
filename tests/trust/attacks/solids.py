"""Mutants of STEP and BREP files, each made from its number alone; and whether one still describes the same part."""

from __future__ import annotations

import random
import re
from pathlib import Path
from typing import Any

import numpy as np
from fuzz.bytes_of import mutated
from fuzz.grow import recipe
from trust.attacks.mutants import WHOLE
from trust.spoiling import Floats

_NUMBER = re.compile(rb"[-+]?\d+\.\d*(?:[eE][-+]?\d+)?")
_POINT = re.compile(rb"CARTESIAN_POINT\('[^']*',\(([^()]*)\)\)")
_LOOKS = re.compile(
    rb"COLOUR|STYLE|PRESENTATION|DRAUGHTING|MECHANICAL|PRODUCT|APPLICATION|DATE|PERSON|APPROVAL|UNCERTAINTY"
)
ENTITIES = (b"ADVANCED_FACE", b"ORIENTED_EDGE", b"EDGE_CURVE", b"VERTEX_POINT", b"CLOSED_SHELL", b"EDGE_LOOP",
            b"B_SPLINE_SURFACE_WITH_KNOTS", b"MANIFOLD_SOLID_BREP", b"AXIS2_PLACEMENT_3D")  # fmt: skip


SAME_SOLID = 1e-7
"""Relative difference of area and volume."""


def step_mutant(good: bytes, number: int) -> bytes:
    """Bytes changed anywhere; a coordinate moved; a reference led astray; a flag turned; an entity left out."""
    chance = random.Random(number)
    match number % 5:
        case 0:
            return mutated(good, recipe(chance), good, WHOLE)
        case 1:
            return _moved(good, chance, _POINT)
        case 2:
            found = [m for m in re.finditer(rb"#(\d+)", good)]
            one, other = chance.sample(found, 2)
            return good[: one.start()] + other[0] + good[one.end() :]
        case 3:
            flag = chance.choice([m for m in re.finditer(rb"\.[TF]\.", good)])
            return good[: flag.start()] + (b".F." if flag[0] == b".T." else b".T.") + good[flag.end() :]
        case _:
            kind = chance.choice([k for k in ENTITIES if k in good])
            line = chance.choice([m for m in re.finditer(rb"#\d+=[^;]*%s[^;]*;\n?" % kind, good)])
            return good[: line.start()] + good[line.end() :]


def brep_mutant(good: bytes, number: int) -> bytes:
    """Bytes changed anywhere; a number moved; a line left out."""
    chance = random.Random(number)
    match number % 3:
        case 0:
            return mutated(good, recipe(chance), good, WHOLE)
        case 1:
            return _moved(good, chance, re.compile(rb"\n([^\n]*\d\.\d[^\n]*)\n"))
        case _:
            lines = good.split(b"\n")
            del lines[chance.randrange(len(lines))]
            return b"\n".join(lines)


def _moved(good: bytes, chance: random.Random, pattern: re.Pattern[bytes]) -> bytes:
    """One number of one match is greater by a hundredth to one millimetre."""
    place = chance.choice([m for m in pattern.finditer(good) if _NUMBER.search(m[1])])
    word = chance.choice([m for m in _NUMBER.finditer(place[1])])
    at = place.start(1) + word.start()
    value = float(word[0]) + 10.0 ** chance.uniform(-2.0, 0.0)
    return good[:at] + repr(value).encode() + good[at + len(word[0]) :]


def same_step(good: bytes, mutant: bytes, room: float) -> bool:
    """Whether all that is no name, colour or administration reads the same, numbers within `room`."""
    return same_numbers(_shape(good), _shape(mutant), room)


def _shape(text: bytes) -> bytes:
    data = text.partition(b"DATA;")[2]
    lines = (line for line in data.split(b";") if not _LOOKS.search(line))
    return b";".join(re.sub(rb"'[^']*'|\s", b"", line) for line in lines)


def same_numbers(good: bytes, mutant: bytes, room: float) -> bool:
    """Whether two texts are the same but for numbers with a decimal point, and those within `room`."""
    one, other = (_NUMBER.sub(b"@", text) for text in (good, mutant))
    if one != other:
        return False
    values = ([float(v) for v in _NUMBER.findall(text)] for text in (good, mutant))
    return all(abs(a - b) <= room for a, b in zip(*values, strict=True))


def same_solid(good: Path, mutant: Path, room: float) -> bool:
    """Whether a CAD kernel, called directly, reads one and the same solid: faces, vertices, area and volume to 1e-7.

    It mends redundant data: the sense of an edge, a curve in the parameters of a face, a flag of a spline. An edge
    between two faces that is drawn again slightly differently, as other programs fit it, takes 1e-8 of the volume.
    """
    (faces, points, *one), (others, corners, *other) = _measured(good), _measured(mutant)
    return (
        faces == others
        and points.shape == corners.shape
        and float(np.abs(points - corners).max()) <= room
        and all(abs(a - b) <= SAME_SOLID * abs(a) for a, b in zip(one, other, strict=True))
    )


def _measured(path: Path) -> tuple[int, Floats, float, float]:
    """Number of faces, different vertices (n, 3) in order of their places, area and volume of a STEP file, in mm."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    shape = reader.OneShape()
    found: dict[TopAbs_ShapeEnum, list[Any]] = {}
    for kind in (TopAbs_ShapeEnum.TopAbs_FACE, TopAbs_ShapeEnum.TopAbs_VERTEX):
        each, found[kind] = TopExp_Explorer(shape, kind), []
        while each.More():
            found[kind].append(each.Current())
            each.Next()
    faces, vertices = found.values()
    places = (BRep_Tool.Pnt_s(TopoDS.Vertex(vertex)) for vertex in vertices)
    points = np.unique(np.round([[p.X(), p.Y(), p.Z()] for p in places], 6), axis=0)
    area, volume = GProp_GProps(), GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, area)
    BRepGProp.VolumeProperties_s(shape, volume)
    return len(faces), points, area.Mass(), volume.Mass()
